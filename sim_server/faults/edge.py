"""The simulator's edge, between its clock and the transport: where message faults act, and who will answer what.

Payloads go through the faults of their arm and direction in the order in which those began. In lock-step nobody may
wait for an answer that will not come, so the edge follows what the arm's agent has got: by the rules of the wire it
answers a state exactly if that fits and is newer than all before (docs/wire.md). So does the leader, under the name
``leader``, with its views. An agent without faults is not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from sim_server.faults import delays, losses, spoiled
from sim_server.faults.event import Seen
from sim_server.faults.message import Direction, MessageEffect, MessageEvent
from sim_server.reception import LEADER
from sim_server.snapshot import Snapshot
from wire.codec import decode
from wire.errors import Refused
from wire.messages import Command, LeaderForce, LeaderView, State

EFFECTS: Mapping[type[MessageEvent], type[MessageEffect]] = {
    **delays.EFFECTS,
    **losses.EFFECTS,
    **spoiled.EFFECTS,
}
SETTINGS = {fault.kind: fault.settings for fault in (*delays.FAULTS, *losses.FAULTS, *spoiled.FAULTS)}


class Edge:
    """The message faults of one run.

    Args:
        seed: the scenario's.
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._effects: list[MessageEffect] = []
        self._begun = 0
        self.troubled: set[str] = set()
        """Arms (and the leader) with a fault, or whose agents still suffer from one."""
        self._newest: dict[str, tuple[int, int]] = {}
        """Lease of the instance that gets an arm's states, and the newest tick that it has taken for good."""
        self._expected: dict[str, int | None] = {}
        """The tick of the last answer that is still to come of what an arm's agent got last."""
        self.news: list[Seen] = []
        """What has been seen of the faults; whoever reports it takes it out."""

    def begin(self, event: MessageEvent, end: int | None) -> None:
        """A fault goes on from now to, and without, the tick ``end``."""
        self._effects.append(self._effect(event, self._begun, end))
        self._begun += 1
        self.troubled.add(event.arm)

    def _effect(self, event: MessageEvent, number: int, end: int | None) -> MessageEffect:
        return EFFECTS[type(event)](event, self._seed, number, end)

    def send(self, arm: str, tick: int, lease: int, joints: int, payload: bytes | None) -> tuple[list[bytes], bool]:
        """What goes out to the agent of an arm in trouble in place of its state, and whether it will answer.

        Without a state of this tick: what was held until now. An arm has one at every tick, the leader has not.
        """
        self._newest.setdefault(arm, (lease, tick - 1))  # until now it has taken every state
        out = self._through(arm, "to", tick, [] if payload is None else [payload], release=True)
        taken = [fits for each in out if (fits := self._taken(arm, lease, joints, each)) is not None]
        if taken or payload is not None:
            self._expected[arm] = taken[-1] if taken else None
        return out, bool(taken)

    def receive(self, arm: str, tick: int, payload: bytes) -> list[bytes]:
        """What comes in from the agent of an arm in trouble in place of its command."""
        return self._through(arm, "from", tick, [payload], release=False)

    def late(self, arm: str, tick: int) -> list[bytes]:
        """Commands that were held until this tick."""
        return self._through(arm, "from", tick, [], release=True)

    def is_last(self, arm: str, payload: bytes) -> bool:
        """Whether nothing more will come after this command, as it came from the agent of an arm in trouble."""
        try:
            answers = decode(payload, LeaderForce).tick if arm == LEADER else decode(payload, Command).tick
        except Refused:
            return False
        expected = self._expected.get(arm)
        return expected is None or answers >= expected

    def settle(self, tick: int) -> None:
        """Before a tick: what has been seen of the faults, and which are over."""
        for each in list(self._effects):
            if each.hit and not each.told:
                each.told = True
                self.news.append(Seen(each.event, f"it acts: {each.count}"))
            if each.has_ended(tick) and not each.holds(tick):
                self._effects.remove(each)
                self.news.append(Seen(each.event, f"it has ended: {each.count}", proves=each.hit > 0))
        troubled = {each.event.arm for each in self._effects}
        for arm in self.troubled - troubled:
            if self._newest.get(arm, (0, -1))[1] < tick:
                self._newest.pop(arm, None)
                self._expected.pop(arm, None)
            else:  # it was made to believe in a tick to come, and takes no state before that
                troubled.add(arm)
        self.troubled = troubled

    def finish(self) -> None:
        """The run is over: tell what the faults that went on have done."""
        for each in self._effects:
            self.news.append(Seen(each.event, f"until the run's end: {each.count}", proves=each.hit > 0))
        self._effects.clear()

    def _through(
        self, arm: str, direction: Direction, tick: int, flow: Sequence[bytes], *, release: bool
    ) -> list[bytes]:
        for each in self._effects:
            if each.event.arm == arm and each.event.direction == direction:
                due = each.due(tick) if release else []
                flow = [*due, *(out for payload in flow for out in each.through(payload, tick))]
        return list(flow)

    def _taken(self, arm: str, lease: int, joints: int, payload: bytes) -> int | None:
        """The tick in a state that the agent will answer; None if it will not."""
        to, newest = self._newest[arm]
        if to != lease:
            newest = -1
        told: State | LeaderView
        try:
            told = decode(payload, LeaderView) if arm == LEADER else decode(payload, State)
        except Refused:
            return None
        if isinstance(told, State) and not (
            told.arm == arm and all(len(vector) == joints for vector in (told.q, told.qd, told.tau))
        ):
            return None
        if told.tick <= newest:
            return None
        self._newest[arm] = lease, told.tick
        return told.tick

    def state(self) -> Snapshot:
        """The faults that go on. What agents have got is not in it: after a restart they are others."""
        return {
            "effects": [
                [each.event.model_dump(mode="json"), each.number, each.end, each.state()] for each in self._effects
            ],
            "begun": self._begun,
            "news": [[each.event.model_dump(mode="json"), each.effect, each.proves] for each in self.news],
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there."""
        self._effects = []
        for event, number, end, state in saved["effects"]:
            effect = self._effect(_event(event), int(number), None if end is None else int(end))
            effect.restore(state)
            self._effects.append(effect)
        self._begun = int(saved["begun"])
        self.news = [Seen(_event(event), str(text), bool(proves)) for event, text, proves in saved["news"]]
        self.troubled = {each.event.arm for each in self._effects}
        self._newest = dict.fromkeys(self.troubled, (0, -1))  # whoever greets has got nothing yet


def _event(saved: Mapping[str, object]) -> MessageEvent:
    """The settings of a message fault as :meth:`Edge.state` has them."""
    event = SETTINGS[str(saved["kind"])].model_validate(saved)
    assert isinstance(event, MessageEvent)
    return event
