"""An agent's side of its life on the wire, the same for followers and for the leader: greet, listen, answer, leave."""

from __future__ import annotations

import logging
import os
import queue
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

from agents.errors import AgentError, NotWelcome
from agents.thread_name import CONTROL, name_this_thread
from wire.codec import decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.keys import ArmKeys
from wire.lifecycle import GREETING_S
from wire.link import Link
from wire.messages import Command, End, Goodbye, Hello, LeaderForce, LeaderView, Leaving, Refusal, State, Welcome

log = logging.getLogger("palanquin.agent")

Told = TypeVar("Told", State, LeaderView)

POLL_S = 0.01
RETRY_S = 0.1
"""Between two greetings that nobody answered."""
WOKEN = b""
"""In the inbox instead of a message: somebody outside wants something of this agent."""
IN_LINE_S = 0.2
"""Between two greetings while another instance is in."""
TIME_TO_GREET_S = 5.0
"""For a greeting when the simulator came back at the last moment."""


class SimulatorGone(AgentError):
    """The simulator's sign of life is gone."""


class LostByTheSimulator(AgentError):
    """The simulator counts this agent as lost: start it again to go on."""


class RunEnded(Exception):
    """The simulator said that the run, or this agent's part in it, is over. Not an error."""


class AgentSession(Generic[Told]):
    """Keys, inbox and lease of one agent.

    Args:
        link: an open link to the simulator.
        keys: this agent's four keys.
        sim_alive: key of the simulator's sign of life.
        hello: the greeting, with ``pid`` and ``host`` filled in by :func:`here`.
        told: what the simulator tells such an agent at a tick.
    """

    def __init__(self, link: Link, keys: ArmKeys, sim_alive: str, hello: Hello, told: type[Told]) -> None:
        self._link, self._keys, self._hello = link, keys, hello
        self._told: type[Told] = told
        self._inbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._simulator_is_there = threading.Event()
        self._has_token = self._is_in = False
        self._publisher = link.publisher(keys.command)
        self.refused: Counter[str] = Counter()
        """Messages of the simulator that did not fit, by reason."""
        self._early = 0
        """How many messages in the inbox were there with the welcome."""
        self.lease = 0
        self._turn = threading.RLock()
        """Held while an answer is worked out: it is the transport's thread that works or another one, never both."""
        self._reply: Callable[[bytes], bool] | None = None
        """What the transport's thread does with a message; without, it goes into the inbox."""
        self._failure: BaseException | None = None
        self._thread = 0
        link.subscribe(keys.state, self._on_message)
        link.watch_alive(sim_alive, self._on_simulator)

    def _on_simulator(self, alive: bool) -> None:
        if alive:
            self._simulator_is_there.set()
        else:
            self._simulator_is_there.clear()
            self._inbox.put(None)

    def wake(self) -> bool:
        """Have :meth:`receive` come back; False if no simulator has let this agent in. From any thread, or a signal
        handler."""
        if self._is_in:
            self._inbox.put(WOKEN)
        return self._is_in

    def rejoin(self, timeout_s: float) -> Welcome:
        """Wait for a simulator that is gone to come back, and greet it as :meth:`join` does.

        Raises:
            SimulatorGone: it has not come back within ``timeout_s``.
            NotWelcome, AgentError: as :meth:`join`.
        """
        log.warning("%s: the simulator is gone; waiting %g s for it to come back", self._hello.name, timeout_s)
        deadline = time.monotonic() + timeout_s
        if not self._simulator_is_there.wait(timeout_s):
            raise SimulatorGone(
                f"{self._hello.name}: the simulator is gone and has not come back within {timeout_s:g} s"
            )
        while not self._inbox.empty():  # all of it is from before
            self._inbox.get()
        return self.join(max(TIME_TO_GREET_S, deadline - time.monotonic()), again=True)

    def join(self, timeout_s: float, wait_s: float = 0.0, *, again: bool = False) -> Welcome:
        """Greet the simulator and wait to be let in; while another instance is in, stand in line for ``wait_s``.

        Args:
            timeout_s: for all of it.
            again: this agent was in before, and a simulator that only lost the connection may not have noticed yet.

        Raises:
            NotWelcome: it refused, with its reason.
            RunEnded, SimulatorGone: while this agent stood in line.
            AgentError: no simulator answered within ``timeout_s``.
        """
        deadline = time.monotonic() + timeout_s
        patience, in_line = time.monotonic() + wait_s, False
        while time.monotonic() < deadline:
            reply = self._link.query(self._keys.hello, encode(self._hello), min(GREETING_S, timeout_s))
            if reply is None:  # a transport that sees nobody to ask says so at once
                time.sleep(RETRY_S)
                continue
            message = decode_any(reply)
            if isinstance(message, Refusal):
                if again and message.reason == Reason.TAKEN:
                    time.sleep(RETRY_S)
                    continue
                if message.reason == Reason.TAKEN and time.monotonic() < patience:
                    if not in_line:
                        log.info("another %s is in: standing in line for %g s", self._hello.name, wait_s)
                    in_line = True
                    self._stand_in_line()
                    deadline = time.monotonic() + timeout_s
                    continue
                raise NotWelcome(f"{self._hello.name}: the simulator refused this agent: {message.text}")
            welcome = decode(reply, Welcome)
            self.lease, self._early = welcome.lease, self._inbox.qsize()
            self._is_in = True
            if not self._has_token:  # else the transport has declared it again by itself
                self._link.declare_alive(self._keys.alive)
                self._has_token = True
            while not self._publisher.matched():
                if time.monotonic() > deadline:
                    raise AgentError(f"{self._hello.name}: let in, but nobody listens on {self._keys.command}")
                time.sleep(POLL_S)
            return welcome
        raise AgentError(
            f"{self._hello.name}: no simulator answered on {self._keys.hello} within {timeout_s:g} s; expected one "
            f"that runs {self._hello.run!r} and lets this credential in (one that was revoked or replaced is not heard)"
        )

    def _stand_in_line(self) -> None:
        """Wait a moment. What is said meanwhile is for the instance that is in, all but the end of the run."""
        time.sleep(IN_LINE_S)
        while not self._inbox.empty():
            with suppress(LostByTheSimulator):
                self.receive(0.0)

    def answer_each(self, answer: Callable[[Told], Command | LeaderForce | None]) -> None:
        """Answer every message on the thread that brings it, until ``answer`` gives None or :meth:`wake`.

        For lock-step: it saves two changes of threads per message. A law that hangs there takes the transport with it,
        so after the lease, ten seconds, its sign of life goes as well; its missed ticks have told of it before.

        Args:
            answer: may raise :class:`Refused`, which is counted as in :meth:`receive`, and anything else, which is
                raised here.

        Raises:
            RunEnded, SimulatorGone, LostByTheSimulator: as :meth:`receive`.
        """

        def reply(payload: bytes) -> bool:
            message = self._read(payload)
            if message is None:
                return True
            try:
                answered = answer(message)
            except Refused as refusal:
                self.refuse(refusal)
                return True
            if answered is not None:
                self.send(answered)
            return answered is not None

        with self._turn:
            while not self._inbox.empty():  # what has come meanwhile, in its order
                payload = self._next()
                if payload is None or not reply(payload):
                    return
            self._reply, self._failure = reply, None
        try:
            self._next()
        finally:
            with self._turn:
                self._reply = None
        if self._failure is not None:
            raise self._failure

    def _on_message(self, payload: bytes) -> None:
        with self._turn:
            if self._reply is None:
                self._inbox.put(payload)
                return
            if self._thread != threading.get_ident():
                self._thread = threading.get_ident()
                name_this_thread(CONTROL)
            try:
                if self._reply(payload):
                    return
            except BaseException as error:  # whatever it is, whoever waits in answer_each raises it
                self._failure = error
            self._reply = None
            self._inbox.put(WOKEN)

    def receive(self, timeout_s: float) -> Told | None:
        """The next message of the simulator, or None after ``timeout_s`` without one, or after :meth:`wake`.

        What does not fit is counted, reported in the log once per kind, and skipped.

        Raises:
            RunEnded: the simulator said so.
            SimulatorGone: its sign of life is gone.
            LostByTheSimulator: this agent was too late too often.
        """
        try:
            payload = self._next(timeout_s)
        except queue.Empty:
            return None
        return None if payload is None else self._read(payload)

    def _next(self, timeout_s: float | None = None) -> bytes | None:
        """Out of the inbox; None after :meth:`wake`. Raises :class:`queue.Empty` and :class:`SimulatorGone`."""
        payload = self._inbox.get(timeout=timeout_s)
        if payload is None:
            self._is_in = False
            raise SimulatorGone(f"{self._hello.name}: the simulator is gone")
        return None if payload == WOKEN else payload

    def _read(self, payload: bytes) -> Told | None:
        """What it says, if it is for a law. Raises as :meth:`receive`."""
        early, self._early = self._early > 0, max(0, self._early - 1)
        try:
            message = decode_any(payload)
        except Refused as refusal:
            self.refuse(refusal)
            return None
        if isinstance(message, self._told):
            return message
        if isinstance(message, End):
            if message.kind == "over":
                raise RunEnded(message.reason)
            if not early:
                raise LostByTheSimulator(f"{self._hello.name}: the simulator gave this agent up: {message.reason}")
            return None  # that was the instance before, lost while this one greeted
        got, expected = type(message).__name__, f"{self._told.__name__} or End"
        self.refuse(Refused(Reason.TYPE, "type", got, expected))
        return None

    def receive_newest(self, timeout_s: float) -> Told | None:
        """As :meth:`receive`, but of those that have piled up only that of the newest tick: in real time the others are
        history."""
        message = self.receive(timeout_s)
        while not self._inbox.empty():
            other = self.receive(0.0)
            if other is not None and (message is None or other.tick >= message.tick):
                message = other
        return message

    def refuse(self, refusal: Refused) -> None:
        """Count a message that does not fit and report the first of its kind."""
        self.refused[refusal.reason] += 1
        if self.refused[refusal.reason] == 1:
            log.warning("refused a message of the simulator: %s", refusal)

    def tell_refused(self) -> None:
        """Say in the log how many messages were refused, by reason, if any were."""
        if self.refused:
            counts = ", ".join(f"{times} as {reason}" for reason, times in sorted(self.refused.items()))
            log.warning("%s: refused in all: %s", self._hello.name, counts)

    def send(self, message: Command | LeaderForce) -> None:
        """Publish the answer to a tick."""
        self._publisher.put(encode(message))

    def say_leaving(self, timeout_s: float = 2.0) -> None:
        """Say that this agent puts down what it carries, answering on, and will then go."""
        self._link.query(self._keys.hello, encode(Leaving(self._hello.name, self.lease)), timeout_s)

    def leave(self, timeout_s: float = 2.0) -> None:
        """Say goodbye; a simulator that is gone already is no error."""
        self._link.query(self._keys.hello, encode(Goodbye(self._hello.name, self.lease)), timeout_s)


def here() -> tuple[int, str]:
    """Process id and host name for a greeting."""
    return os.getpid(), socket.gethostname()
