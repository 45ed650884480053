"""A simulator played by hand over the in-memory link, for tests of agents."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Literal

from agents.follower import FollowerSettings, run_follower
from wire.codec import decode, encode
from wire.keys import Keys
from wire.memory import Broker, MemoryQuestion
from wire.messages import Command, Refusal, State, Vector, Welcome

DEADLINE_S = 10.0
KEYS = Keys("test")
SETTINGS = FollowerSettings("test", "a1", "panda", "paper", {}, join_timeout_s=DEADLINE_S, state_timeout_s=0.02)
Q: Vector = (0.0, -0.1, 0.0, -2.1, 0.0, 2.0, 0.785)
ZERO: Vector = (0.0,) * 7


class PlayedSimulator:
    """The simulator's end of one agent's keys: welcomes it, sends what the test says, collects what comes back."""

    def __init__(self, clock: Literal["lock-step", "real-time"], reply: Callable[[], Welcome | Refusal] | None = None):
        self.broker = Broker()
        self.play(clock, reply)

    def play(
        self,
        clock: Literal["lock-step", "real-time"],
        reply: Callable[[], Welcome | Refusal] | None = None,
        strut: Vector = ZERO,
    ) -> None:
        """Be there, from now on."""
        self.link = self.broker.link()
        self.answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        points: dict[str, Vector] = {"front": (0.8, 0.0, 0.7)}
        welcome = Welcome(
            lease=3,
            clock=clock,
            control_period_ns=1_000_000,
            points=points,
            force_max_N=40.0,
            carry_height_m=0.0,
            strut=strut,
        )
        for keys in (KEYS.arm("a1"), KEYS.leader):
            self.link.subscribe(keys.command, self.answers.put)
            self.link.answer_queries(keys.hello, lambda question: self._answer(question, reply() if reply else welcome))
        self.link.declare_alive(KEYS.sim_alive)
        self.state = self.link.publisher(KEYS.arm("a1").state)
        self.view = self.link.publisher(KEYS.leader.state)
        self.ended: queue.SimpleQueue[str | Exception] = queue.SimpleQueue()

    def _answer(self, question: MemoryQuestion, reply: Welcome | Refusal) -> None:
        question.reply(encode(reply))

    def start(self, agent: Callable[[], str]) -> None:
        """Run an agent in a thread; how it ended arrives in ``ended``."""

        def body() -> None:
            try:
                self.ended.put(agent())
            except Exception as error:
                self.ended.put(error)

        threading.Thread(target=body, daemon=True).start()

    def follow(self) -> None:
        """Start the follower of arm a1 and wait until it listens."""
        link = self.broker.link()
        self.start(lambda: run_follower(link, SETTINGS))
        wait_for(self.state.matched)

    def command(self) -> Command:
        return decode(self.answers.get(timeout=DEADLINE_S), Command)


def wait_for(condition: Callable[[], bool]) -> None:
    """Until the condition holds; fails after the deadline."""
    waiter = threading.Event()
    for _ in range(int(DEADLINE_S / 0.005)):
        if condition():
            return
        waiter.wait(0.005)
    raise AssertionError("the condition did not come true in time")


def state(tick: int, arm: str = "a1", q: Vector = Q) -> bytes:
    return encode(State(arm, tick, tick * 1_000_000, q, ZERO, ZERO, (0.0,) * 6, 0.03, (0.0,) * 6))
