"""The lock-step clock: tick k's states go out, every live agent's command for k comes back, the physics steps.

An agent whose sign of life goes is lost at once. One that stays silent for ``answer_timeout_s`` has missed the tick;
while it stays silent it is not waited for again, so that a hung agent costs that time once, and after
``missed_ticks_until_lost`` missed ticks in a row it is lost. Where a message fault takes an answer away, the tick is
missed at once (:mod:`sim_server.faults.edge`).
"""

from __future__ import annotations

import queue
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from sim_server.durations import Durations
from sim_server.faults.edge import Edge
from sim_server.plant import Plant
from sim_server.punctuality import Punctuality
from sim_server.reception import LEADER, Agent, Arrived, Reception, Report
from sim_server.snapshot import Snapshot
from wire.codec import decode, decode_any, encode
from wire.errors import Reason, Refused
from wire.lifecycle import Phase
from wire.messages import Command, Done, End, LeaderForce, LeaderView, Order, State

PARTS = ("send", "wait", "step", "record", "tick", "controller")


@dataclass(slots=True)
class Timings:
    """Wall time of the ticks by part, in ns, and of the controllers' steps as they report them."""

    send: Durations = field(default_factory=Durations)
    """Read the sensors, encode and publish all states."""
    wait: Durations = field(default_factory=Durations)
    """Prepare the step, and wait for, decode and check all commands."""
    step: Durations = field(default_factory=Durations)
    """Motor drivers and physics."""
    record: Durations = field(default_factory=Durations)
    """Trace and progress."""
    tick: Durations = field(default_factory=Durations)
    """All four."""
    controller: Durations = field(default_factory=Durations)
    begun: tuple[int, int] = (0, 0)
    """What sending and waiting took in the tick that goes on."""

    def state(self) -> Snapshot:
        """All of them."""
        return {name: getattr(self, name).state() for name in PARTS}

    def restore(self, saved: Snapshot) -> None:
        """Go on counting from there."""
        for name in PARTS:
            getattr(self, name).restore(saved[name])

    def end_tick(self, step: int, record: int) -> None:
        """The tick that goes on is over; these were its last two parts."""
        send, wait = self.begun
        self.send.append(send)
        self.wait.append(wait)
        self.step.append(step)
        self.record.append(record)
        self.tick.append(send + wait + step + record)


class Stopped(Exception):
    """The operator ordered a stop."""


class Ticker(ABC):
    """What every clock does: drives a plant and its agents tick by tick. How long it waits for whom is the clock's own.

    Args:
        reception: who is in.
        plant: what moves.
        period_ns: simulated time of a tick.
        leader_every: the leader sees and pulls every so many ticks.
        report: where events go.
        edge: where message faults act; by default there are none.
    """

    def __init__(
        self,
        reception: Reception,
        plant: Plant,
        *,
        period_ns: int,
        leader_every: int,
        report: Report,
        edge: Edge | None = None,
    ) -> None:
        self._reception, self._plant, self._report = reception, plant, report
        self._period_ns, self._leader_every = period_ns, leader_every
        self.edge = edge or Edge()
        self._tick = 0
        self._waiting: set[str] = set()
        self._frozen: set[str] = set()
        self._silent: set[str] = set()
        """Agents that have let the time for an answer pass, and have not answered in time since."""
        self.done: dict[int, str] = {}
        """The launcher's reports: number of the deed, and what was in the way."""
        self.wanted: list[int] = []
        """Struts (from 1) that the operator wants a new robot to take; whoever sees to it takes them out."""
        self.timings = Timings()
        self.punctuality = Punctuality()

    @abstractmethod
    def _gather(self, tick: int) -> None:
        """Take in what arrives for this tick, and count as missed what does not."""

    @abstractmethod
    def _accept(self, agent: Agent, message: Command | LeaderForce) -> None:
        """Raises :class:`Refused` if this answer does not count."""

    def tick(self, tick: int) -> None:
        """One tick up to, and without, the plant's step. Raises :class:`Stopped`."""
        start = time.perf_counter_ns()
        self.admit()
        self._tick = tick
        self._send(tick)
        for name in sorted(self.edge.troubled):
            for payload in self.edge.late(name, tick):
                self._take_answer(name, self._reception.agents[name], payload)
        sent = time.perf_counter_ns()
        self._plant.prepare()
        self._gather(tick)
        done = time.perf_counter_ns()
        self.timings.begun = (sent - start, done - sent)

    def admit(self) -> None:
        """Let those in whose links are up; an arm that was lost or left before is driven again."""
        for name in self._reception.match():
            self._silent.discard(name)
            if name != LEADER:
                self._plant.regain(name)

    def freeze(self, name: str) -> None:
        """The agent's process is stopped, and that is known: it cannot answer, so nobody waits for it, and the loss of
        its sign of life (after seconds of wall time) says nothing new. It is lost by its missed ticks."""
        self._frozen.add(name)

    def thaw(self, name: str) -> None:
        """The process runs again, or another takes its place: it is waited for, and its sign of life counts."""
        self._frozen.discard(name)
        self._silent.discard(name)
        agent = self._reception.agents[name]
        if agent.link.phase is Phase.TICKING and not agent.alive:
            self._vanish(name)

    def _send(self, tick: int) -> None:
        time_ns = tick * self._period_ns
        readings = self._plant.read()
        for name, agent in self._reception.agents.items():
            if not agent.is_in:
                continue
            message: State | LeaderView
            if name == LEADER:
                if tick % self._leader_every:
                    self._put_late(agent, name, tick)
                    continue
                pose = self._plant.load_pose()
                message = LeaderView(
                    tick,
                    time_ns,
                    tuple(pose.position.tolist()),
                    tuple(pose.quat_wxyz.tolist()),
                    tuple(pose.linear_velocity.tolist()),
                    tuple(pose.angular_velocity.tolist()),
                )
            else:
                reading = readings[name]
                message = State(
                    name,
                    tick,
                    time_ns,
                    reading.q,
                    reading.qd,
                    reading.tau,
                    reading.wrench,
                    reading.grip_m,
                    reading.odometry,
                )
            agent.link.state_sent(tick)
            payload = encode(message)
            if name in self.edge.troubled:
                self._put_through_faults(agent, name, tick, payload)
            else:
                agent.publisher.put(payload)
                self._wait_for(name)

    def _put_late(self, agent: Agent, name: str, tick: int) -> None:
        """In a tick without a view for the leader: send those that message faults held until now."""
        if name in self.edge.troubled:
            self._put_through_faults(agent, name, tick, None)

    def _put_through_faults(self, agent: Agent, name: str, tick: int, payload: bytes | None) -> None:
        """Send what message faults make of it, and wait if there will be an answer."""
        link = agent.link
        out, answers = self.edge.send(name, tick, link.lease, link.invitation.joints, payload)
        for each in out:
            agent.publisher.put(each)
        if answers:
            self._wait_for(name)

    def _wait_for(self, name: str) -> None:
        if name not in self._frozen and name not in self._silent:
            self._waiting.add(name)

    def take(self, arrived: Arrived) -> None:
        """Deal with one thing from the inbox. Raises :class:`Stopped`."""
        if arrived.kind == "answer":
            self._answer(arrived.name, arrived.payload)
        elif arrived.kind in ("alive", "gone"):
            self._reception.agents[arrived.name].alive = arrived.kind == "alive"
            if arrived.kind == "gone" and arrived.name not in self._frozen:
                self._vanish(arrived.name)
        elif arrived.kind == "question" and arrived.question is not None:
            left = self._reception.answer(arrived.question)
            if left is not None:
                self._waiting.discard(left)
                if left == LEADER:
                    self._stop_pulling()
                else:
                    self._plant.let_down(left, retreated=self._reception.agents[left].link.leaving)
        elif arrived.kind == "order":
            self._obey(arrived.payload)

    def _vanish(self, name: str) -> None:
        if self._reception.agents[name].link.vanish():
            self._lose(name, "its sign of life is gone")

    def _answer(self, name: str, payload: bytes) -> None:
        agent = self._reception.agents[name]
        if name not in self.edge.troubled:
            self._take_answer(name, agent, payload)
            if agent.link.open_tick is None:
                self._waiting.discard(name)
                if not agent.link.missed_in_row:
                    self._silent.discard(name)
            return
        for each in self.edge.receive(name, self._tick, payload):
            self._take_answer(name, agent, each)
        if self.edge.is_last(name, payload):  # should its answer not have counted: there will be no other
            self._waiting.discard(name)
            self._silent.discard(name)

    def _take_answer(self, name: str, agent: Agent, payload: bytes) -> None:
        try:
            if name == LEADER:
                self._pull(agent, decode(payload, LeaderForce))
            else:
                command = decode(payload, Command)
                self._accept(agent, command)
                self._plant.command(
                    name, command.torque, command.base_force, command.stiffness, command.grip_m, command.residual_W
                )
                self.timings.controller.append(command.step_ns)
        except Refused as refusal:
            self._reception.refuse(name, refusal)

    def _pull(self, agent: Agent, force: LeaderForce) -> None:
        self._accept(agent, force)  # in time it is, even if what it wants is refused: the pull before stays
        if force.point not in agent.terms.points:
            raise Refused(Reason.POINT, "point", force.point, ", ".join(sorted(agent.terms.points)))
        size, most = float(np.linalg.norm(force.force)), agent.terms.force_max_N
        if size > most:
            raise Refused(Reason.RANGE, "leader's force", f"{size:.3f} N", f"at most {most:g} N")
        if force.force[2] != 0.0:
            raise Refused(Reason.RANGE, "leader's force", f"{force.force[2]:.3f} N upwards", "a pull in the plane")
        self._plant.pull(force.point, np.array(force.force))

    def _obey(self, payload: bytes) -> None:
        try:
            message = decode_any(payload)
            if not isinstance(message, Order | Done):
                raise Refused(Reason.TYPE, "type", type(message).__name__, "order or done")
        except Refused as refusal:
            self._reception.refuse("", refusal)
            return
        if isinstance(message, Order):
            if message.verb == "stop":
                raise Stopped
            self.wanted.append(message.strut)
            return
        self.done[message.number] = message.problem

    def _miss(self, name: str, agent: Agent) -> None:
        if agent.link.missed_in_row == 0 and name not in self.edge.troubled:
            self._report("missed", agent=name, tick_missed=agent.link.open_tick)
        if agent.link.miss():
            self._lose(name, f"{agent.link.missed_in_row} ticks without an answer")

    def _lose(self, name: str, why: str) -> None:
        self._waiting.discard(name)
        agent = self._reception.agents[name]
        self._frozen.discard(name)
        # Should it still be there (it was stopped, or hung) it must not think that it is in.
        agent.publisher.put(encode(End("lost", why)))
        then = self._stop_pulling() if name == LEADER else self._plant.lose(name)
        self._report("lost", agent=name, why=why, missed_ticks=agent.link.missed_in_row, then=then)

    def _stop_pulling(self) -> str:
        self._plant.pull("centre", np.zeros(3))
        return "stops pulling"


class LockStep(Ticker):
    """Waits for everybody: see the module.

    Args:
        answer_timeout_s: wall time to wait for an answer.
    """

    def __init__(
        self,
        reception: Reception,
        plant: Plant,
        *,
        period_ns: int,
        leader_every: int,
        answer_timeout_s: float,
        report: Report,
        edge: Edge | None = None,
    ) -> None:
        super().__init__(reception, plant, period_ns=period_ns, leader_every=leader_every, report=report, edge=edge)
        self._answer_timeout_s = answer_timeout_s

    def _accept(self, agent: Agent, message: Command | LeaderForce) -> None:
        agent.link.answer(message)

    def _gather(self, tick: int) -> None:
        """Take in what arrives until everybody who is waited for has answered, is gone, or has run out of time."""
        inbox = self._reception.inbox
        deadline = time.monotonic() + self._answer_timeout_s
        while self._waiting:
            try:
                arrived = inbox.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            self.take(arrived)
        while not inbox.empty():
            self.take(inbox.get())
        self._silent |= self._waiting
        self._waiting.clear()
        for name, agent in self._reception.agents.items():
            if agent.link.open_tick is not None:
                self._miss(name, agent)
