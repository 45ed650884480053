"""An agent that waits to be let in: it asks again and again, but not as fast as it can."""

from __future__ import annotations

import pytest

from agents import session
from agents.errors import AgentError
from agents.session import AgentSession
from wire.keys import Keys
from wire.memory import Broker, MemoryLink
from wire.messages import Hello, State

KEYS = Keys("run")
HELLO = Hello("follower", "run", "a1", "panda", "", 1, "here")


class Deaf(MemoryLink):
    """A link that sees nobody to ask, and says so at once, as Zenoh does."""

    asked = 0

    def query(self, key: str, payload: bytes, timeout_s: float) -> bytes | None:
        self.asked += 1
        return None


def test_who_is_not_answered_asks_at_an_easy_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A credential that was revoked, or a router before its simulator is there: it was a busy loop once."""
    monkeypatch.setattr(session, "RETRY_S", 0.05)
    link = Deaf(Broker())
    agent = AgentSession(link, KEYS.arm("a1"), KEYS.sim_alive, HELLO, State)
    with pytest.raises(AgentError, match="no simulator answered"):
        agent.join(0.5)
    assert 1 < link.asked <= 0.5 / 0.05 + 1
