"""Messages that are not what they should be, at everything that takes messages in: no effect, and all are counted."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import MESSAGES
from typer.testing import CliRunner

import wire.codec
from agents.session import AgentSession
from deploy.chaos.commands import app
from deploy.chaos.fuzz.aims import Aim, Moment
from deploy.chaos.fuzz.spoiling import PERHAPS, SURELY
from deploy.chaos.fuzz.trial import AGENTS, SIMULATOR, Found, fuzz
from wire.codec import decode_any, encode
from wire.errors import Reason, Refused
from wire.lifecycle import AgentLink
from wire.messages import Command, LeaderForce, Message, State

MADE = ("hello", "state", "command", "leader_view", "leader_force", "leaving", "goodbye", "order")
SAYS_WHO = ("somebody else's name", "a vector of another length")
"""Wrong for a receiver that knows whom it expects; the decoder does not."""


def fuzzed(folder: Path, messages: int, seed: int = 1) -> Found:
    return fuzz(messages, seed, 2, folder, lambda sent, of: None)


@given(st.sampled_from(MADE), st.data(), st.integers(0, 2**32))
def test_what_is_surely_spoiled_is_refused_by_the_decoder(kind: str, data: st.DataObject, seed: int) -> None:
    message: Message = data.draw(MESSAGES[kind])
    for name, way in SURELY.items():
        spoiled = way(encode(message), random.Random(seed))
        if spoiled is None or name in SAYS_WHO:
            continue
        with pytest.raises(Refused):
            decode_any(spoiled)


@pytest.mark.timeout(300)
def test_twenty_thousand_messages_do_nothing_and_each_is_counted(tmp_path: Path) -> None:
    found = fuzzed(tmp_path, 20_000)
    assert found.problems == ()
    assert found.messages == sum(sum(counts.values()) for counts in found.refused.values()) == 20_000
    assert found.sent.keys() == {
        *SURELY, *PERHAPS, "another tick", "another lease", "the same again", "from another key",
    }  # fmt: skip
    assert set(found.left_out) == set(PERHAPS), "what is whole by chance is told apart"
    # Of the others `phase` needs an agent that is out, and at `point` the leader has answered, which is no fuzz.
    assert set(found.refused[SIMULATOR]) >= set(Reason) - {Reason.PHASE, Reason.POINT}
    assert found.refused[AGENTS].keys() >= {Reason.MALFORMED, Reason.TYPE, Reason.STALE, Reason.ARM, Reason.NOT_FINITE}


def test_the_same_seed_sends_the_same_and_another_another(tmp_path: Path) -> None:
    one, two, other = (fuzzed(tmp_path / name, 1000, seed) for name, seed in (("one", 1), ("two", 1), ("other", 2)))
    assert (one.sent, one.refused, one.left_out) == (two.sent, two.refused, two.left_out)
    assert one.refused != other.refused
    assert one.sha256 == two.sha256 == other.sha256


def believes_any_lease(self: AgentLink, message: Command | LeaderForce) -> None:
    if isinstance(message, Command):
        self._check_command(message)


def falls_over(self: AgentLink, message: Command | LeaderForce) -> None:
    if message.lease != self.lease:
        raise ZeroDivisionError("a lease that nobody has")


def skips_without_counting(self: AgentSession[State], refusal: Refused) -> None:
    pass


@pytest.mark.parametrize(
    ("owner", "name", "broken"),
    [
        (AgentLink, "_check_answer", believes_any_lease),
        (AgentLink, "_check_answer", falls_over),
        (AgentSession, "refuse", skips_without_counting),
        (wire.codec, "isfinite", lambda number: True),
    ],
)
def test_a_receiver_that_believes_too_much_or_does_not_count_is_found_out(
    owner: object, name: str, broken: Callable[..., object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, broken)
    assert fuzzed(tmp_path, 1000).problems


STATE = State("a1", 7, 7_000_000, (0.0,) * 7, (0.0,) * 7, (0.0,) * 7, (0.0,) * 6, 0.0, (0.0,) * 6)
COMMAND = Command("a1", 7, 3, (0.0,) * 7, (0.0,) * 3, 0.0, (0.0,) * 7, 0.0, 0)


def test_a_message_is_whole_for_its_own_receiver_at_its_own_time_only() -> None:
    command, state = encode(COMMAND), encode(STATE)
    now = Moment(tick=7, got={"a1": 6, "a2": 6}, leases={"a1": 3, "a2": 3})
    assert Aim("answer", "a1", "").is_whole(command, now)
    assert Aim("told", "a1", "").is_whole(state, now)
    for sort in ("answer", "told", "greeting", "order"):
        for payload in (command, state):
            assert not Aim(sort, "a2", "").is_whole(payload, now)
    now.answered.add("a1")
    now.got["a1"] = 7
    assert not Aim("answer", "a1", "").is_whole(command, now)
    assert not Aim("told", "a1", "").is_whole(state, now)


@settings(max_examples=20)
@given(st.integers(0, 2**32))
def test_wrong_bits_are_wrong_and_no_more_than_told(seed: int) -> None:
    payload = encode(COMMAND)
    spoiled = PERHAPS["wrong bits"](payload, random.Random(seed))
    assert spoiled is not None
    different = int.from_bytes(spoiled, "big") ^ int.from_bytes(payload, "big")
    assert 1 <= different.bit_count() <= 8


def test_the_verb_prints_what_was_refused_as_what_and_ends_with_0(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["fuzz", "--messages", "400", "--arms", "1", "--out", str(tmp_path / "kept")])
    assert done.exit_code == 0, done.output
    assert "malformed" in done.output
    assert "nobody crashed" in done.output
    assert (tmp_path / "kept" / "fuzzed" / "trace.parquet").exists()
