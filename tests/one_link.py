"""One agent's link for tests: its invitation, greetings, answers, and the check that a refusal changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import astuple
from typing import Any

import pytest

from wire.errors import Reason, Refused
from wire.lifecycle import AgentLink, Invitation
from wire.messages import Command, Hello

JOINTS = 7
INVITATION = Invitation("transport", "follower", "a1", "panda", "0a" * 32, JOINTS, lost_after=3)
HELLO = Hello("follower", "transport", "a1", "panda", "0a" * 32, 4711, "bench-7")


def command(tick: int, lease: int) -> Command:
    seven = (0.5,) * JOINTS
    return Command("a1", tick, lease, seven, (0.0, 0.0, 0.0), 0.0, seven, 0.0, 1000)


def unchanged(link: AgentLink, wanted: type[Exception], call: Callable[[], object]) -> Exception:
    """Check that the call raises and leaves every slot of the link as it was; return what it raised."""
    before = deepcopy(astuple(link))
    with pytest.raises(wanted) as raised:
        call()
    assert astuple(link) == before
    return raised.value


def refused(link: AgentLink, call: Callable[[], object]) -> Reason:
    error = unchanged(link, Refused, call)
    assert isinstance(error, Refused)
    return error.reason


WRONG_HELLO: dict[Reason, dict[str, Any]] = {
    Reason.RUN: {"run": "doorway"},
    Reason.ARM: {"name": "a2"},
    Reason.ROLE: {"role": "leader"},
    Reason.MODEL: {"arm_model": "ur5e"},
    Reason.DIGEST: {"digest": "0a" * 31 + "0b"},
}
