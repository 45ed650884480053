"""A clock over the in-memory wire for tests, with agents that behave as they are told.

A `Ledger` stands for the plant: the border to it is `sim_server.plant.Plant`, which a bridge to real arms fills as
well.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_server.lockstep import LockStep, Ticker
from sim_server.plant import LoadPose, Numbers, Reading
from sim_server.reception import LEADER, Reception, Terms
from wire.codec import decode, decode_any, encode
from wire.errors import Refused
from wire.keys import Keys
from wire.lifecycle import Invitation, Phase
from wire.memory import Broker, MemoryQuestion, key_matches
from wire.messages import Command, End, Hello, LeaderForce, LeaderView, Message, State, Vector, Welcome

Array = NDArray[np.float64]

RUN = "memory"
LOST_AFTER = 5
TIMEOUT_S = 0.5
"""Longer than any pause that a loaded machine makes between two lines of this file; ticks here take 0.1 ms."""
LEADER_EVERY = 2
FORCE_MAX_N = 40.0
PERIOD_NS = 1_000_000


class Ledger:
    """A plant that writes down what is asked of it."""

    def __init__(self, arms: tuple[str, ...], book: list[tuple[Any, ...]]) -> None:
        self.arms, self.book, self.tick = arms, book, 0
        self.unled: set[str] = set()

    def read(self) -> Mapping[str, Reading]:
        self.book.append(("read", self.tick))
        return {
            arm: Reading((k + 0.1,) * 7, (k + 0.2,) * 7, (k + 0.3,) * 7, (k + 0.4,) * 6, 0.03, (0.0,) * 6)
            for k, arm in enumerate(self.arms, start=1)
        }

    def load_pose(self) -> LoadPose:
        return LoadPose(np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.full(3, 4.0), np.full(3, 5.0))

    def pull(self, point: str, force: Array) -> None:
        self.book.append(("pull", point, tuple(force.tolist())))

    def command(
        self,
        arm: str,
        torque: Numbers,
        base_force: Numbers,
        stiffness: Numbers,
        grip_m: float = 0.0,
        residual_W: float = 0.0,
    ) -> None:
        self.book.append(("command", arm, float(torque[0])))

    @property
    def carry_height_m(self) -> float:
        return 0.5

    def reach(self, arm: str) -> Vector:
        return (0.0,) * 7

    def lose(self, arm: str) -> str:
        self.unled.add(arm)
        self.book.append(("lose", arm))
        return "limp"

    def let_down(self, arm: str, *, retreated: bool) -> None:
        self.unled.add(arm)
        self.book.append(("stay" if retreated else "let_down", arm))

    def regain(self, arm: str) -> None:
        """Means nothing to an arm that is led."""
        if arm in self.unled:
            self.unled.discard(arm)
            self.book.append(("regain", arm))

    def prepare(self) -> None:
        """Nothing can be done before the commands are there."""

    def step(self) -> None:
        self.book.append(("step", self.tick))
        self.tick += 1


Behaviour = Callable[["MemoryAgent", State | LeaderView], None]


def ask(broker: Broker, key: str, message: Message) -> MemoryQuestion:
    """A query that is answered when the server looks into its inbox, as over a real transport."""
    question = MemoryQuestion(key, encode(message))
    for _, expression, handler in tuple(broker.queryables):
        if key_matches(expression, key):
            handler(question)
    return question


class MemoryAgent:
    """One agent that behaves as it is told, on the caller's thread."""

    def __init__(self, broker: Broker, name: str, behave: Behaviour, hello: Hello | None = None) -> None:
        self.broker, self.name, self.behave = broker, name, behave
        self.keys = Keys(RUN).leader if name == LEADER else Keys(RUN).arm(name)
        self.link = broker.link()
        self.publisher = self.link.publisher(self.keys.command)
        self.seen: list[State | LeaderView] = []
        self.ended = ""
        self.link.subscribe(self.keys.state, self._on_state)
        if hello is None and name == LEADER:
            hello = Hello("leader", RUN, name, "", "", 1, "here")
        self.greeting = ask(
            broker, self.keys.hello, hello or Hello("follower", RUN, name, "panda", "digest", 1, "here")
        )
        self.link.declare_alive(self.keys.alive)

    @property
    def lease(self) -> int:
        (reply,) = self.greeting.replies
        return decode(reply, Welcome).lease

    def _on_state(self, payload: bytes) -> None:
        try:
            message = decode_any(payload)
        except Refused:
            return  # as every agent does
        if isinstance(message, End):
            self.ended = message.reason
            if message.reason == "the run is over":
                self.link.close()
        elif isinstance(message, State | LeaderView):
            self.seen.append(message)
            self.behave(self, message)

    def command(self, tick: int, torque: float = 1.0, *, lease: int | None = None, arm: str = "") -> None:
        own = self.lease if lease is None else lease
        message = Command(arm or self.name, tick, own, (torque,) * 7, (0.0,) * 3, 0.0, (0.0,) * 7, 0.0, 1)
        self.publisher.put(encode(message))

    def force(self, tick: int, force: tuple[float, float, float], point: str = "front") -> None:
        self.publisher.put(encode(LeaderForce(tick, self.lease, point, force)))


def obedient(agent: MemoryAgent, state: State | LeaderView) -> None:
    if isinstance(state, State):
        agent.command(state.tick, state.tick + 0.5)
    else:
        agent.force(state.tick, (3.0, 0.0, 0.0))


def silent(agent: MemoryAgent, state: State | LeaderView) -> None:
    """Hangs."""


class Bench:
    """A clock, its ledger, and what it reported."""

    def __init__(
        self, arms: tuple[str, ...] = ("a1", "a2"), *, leader: bool = False, timeout_s: float = TIMEOUT_S
    ) -> None:
        self.broker = Broker()
        self.book: list[tuple[Any, ...]] = []
        self.reports: list[tuple[str, dict[str, Any]]] = []
        self.plant = Ledger(arms, self.book)
        follower_terms = Terms("lock-step", PERIOD_NS, {}, 0.0)
        guests = [(Invitation(RUN, "follower", arm, "panda", "digest", 7, LOST_AFTER), follower_terms) for arm in arms]
        if leader:
            points: dict[str, tuple[float, ...]] = {"front": (0.8, 0.0, 0.7)}
            invitation = Invitation(RUN, "leader", LEADER, "", "", 0, LOST_AFTER)
            guests.append((invitation, Terms("lock-step", LEADER_EVERY * PERIOD_NS, points, FORCE_MAX_N)))
        self.reception = Reception(self.broker.link(), Keys(RUN), guests, self._report)
        self.clock: Ticker = LockStep(
            self.reception,
            self.plant,
            period_ns=PERIOD_NS,
            leader_every=LEADER_EVERY,
            answer_timeout_s=timeout_s,
            report=self._report,
        )
        self._tick = 0

    def _report(self, kind: str, **details: object) -> None:
        self.reports.append((kind, details))

    def join(self, name: str, behave: Behaviour = obedient) -> MemoryAgent:
        agent = MemoryAgent(self.broker, name, behave)
        self.settle()
        return agent

    def settle(self) -> None:
        """What the server does between ticks with what has come in."""
        while not self.reception.inbox.empty():
            self.clock.take(self.reception.inbox.get())
        self.clock.admit()

    def run(self, ticks: int) -> float:
        """So many ticks; the wall time they took."""
        start = time.monotonic()
        for _ in range(ticks):
            self.clock.tick(self._tick)
            self.plant.step()
            self._tick += 1
        return time.monotonic() - start

    def phase(self, name: str) -> Phase:
        return self.reception.agents[name].link.phase

    def refused(self, name: str) -> dict[str, int]:
        return self.reception.agents[name].link.refused

    def reported(self, kind: str) -> list[dict[str, Any]]:
        return [details for each, details in self.reports if each == kind]

    def commands(self, arm: str) -> list[float]:
        return [entry[2] for entry in self.book if entry[:2] == ("command", arm)]
