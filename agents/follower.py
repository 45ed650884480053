"""The follower process: state in, torque and base force out. Knows no other arm, no load, no goal, no count."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.departure import Departure
from agents.reach import Reach
from agents.retreat import Retreat
from agents.safety import CheckedEffort, SafeController, hold_effort
from agents.session import AgentSession, RunEnded, SimulatorGone, here
from wire.errors import Reason, Refused
from wire.keys import Keys
from wire.link import Link
from wire.messages import Command, Hello, State, Welcome

log = logging.getLogger("palanquin.follower")


@dataclass(frozen=True, slots=True)
class FollowerSettings:
    """What a follower is told at its start: its own arm and its law, and nothing of the task."""

    run: str
    arm: str
    arm_model: str
    controller: str
    gains: Mapping[str, object]
    handover_s: float = 1.0
    """Time over which the torque passes from what the arm carried at take-over to what the law wants."""
    leave_s: float = 2.0
    """Time over which the arm lets its share down when it is to leave in order."""
    join_timeout_s: float = 30.0
    state_timeout_s: float = 0.1
    """Real time only: wall time without a state after which the follower holds."""
    reconnect_s: float = 0.0
    """Wall time to wait for a simulator that is gone to come back; 0: end when it goes."""


class Follower:
    """One arm's loop body, without a clock of its own."""

    def __init__(self, settings: FollowerSettings) -> None:
        self.settings = settings
        self.arm = ArmModel(settings.arm_model)
        law = make_controller(settings.controller, self.arm, settings.gains)
        self._controller = SafeController(settings.controller, law, self.arm, settings.handover_s)
        self._last: State | None = None
        self._reach: Reach | None = None
        self._retreat: Retreat | None = None
        self._grip_m = 0.0
        """What was wanted of the fingers last."""

    def begin(self, welcome: Welcome) -> None:
        """Let in: reach for the strut first, if the hand is empty; then carry."""
        if welcome.carry_height_m:
            self._controller.carry_at(welcome.carry_height_m)
        if any(welcome.strut):
            self._reach = Reach(self.arm, welcome.strut)

    def retreat(self) -> None:
        """Told to leave: put the share down, if there is one, and drive clear, from the next state on."""
        self._retreat = Retreat(self.arm, self.settings.leave_s, holds=self._reach is None)
        self._reach = None

    @property
    def is_retreating(self) -> bool:
        """Whether it has been told to leave."""
        return self._retreat is not None

    @property
    def has_retreated(self) -> bool:
        """Whether it stands clear."""
        return self._retreat is not None and self._retreat.is_over

    def hello(self) -> Hello:
        """This follower's greeting."""
        pid, host = here()
        settings = self.settings
        return Hello("follower", settings.run, settings.arm, self.arm.name, self.arm.digest, pid, host)

    def check(self, state: State) -> None:
        """Raises :class:`Refused` if this state is not the next one of this arm."""
        if state.arm != self.settings.arm:
            raise Refused(Reason.ARM, "arm", state.arm, self.settings.arm)
        if self._last is not None and state.tick <= self._last.tick:
            raise Refused(Reason.STALE, "tick", state.tick, f"more than {self._last.tick}")
        for what, vector in (("q", state.q), ("qd", state.qd), ("tau", state.tau)):
            if len(vector) != self.arm.joints:
                raise Refused(Reason.LENGTH, what, len(vector), f"{self.arm.joints} numbers")

    def answer(self, state: State, lease: int, period_s: float) -> Command:
        """The command for one state. Raises :class:`agents.errors.ControllerError` if the law fails."""
        dt_s = period_s if self._last is None else 1e-9 * (state.time_ns - self._last.time_ns)
        self._last = state
        start = time.perf_counter_ns()
        q, qd, self._grip_m = np.array(state.q), np.array(state.qd), 0.0

        def law() -> CheckedEffort:
            return self._controller.step(Sensed(q, qd, np.array(state.tau), np.array(state.wrench)), dt_s)

        if self._retreat is not None:
            effort, self._grip_m = self._retreat.step(law, q, qd, state.grip_m, state.odometry, dt_s)
        elif (reach := self._reach) is not None:
            effort, self._grip_m = reach.step(q, qd, state.grip_m, state.odometry, dt_s)
            if reach.holds:
                log.info("arm %s: holds its strut, carries", self.settings.arm)
                self._reach = None
        else:
            effort = law()
        return self._command(state.tick, lease, effort, time.perf_counter_ns() - start)

    def hold(self, lease: int) -> Command | None:
        """The command for when states stop coming; None if there never was one."""
        if self._last is None:
            return None
        return self._command(self._last.tick, lease, hold_effort(self.arm, np.array(self._last.q)), 0)

    def _command(self, tick: int, lease: int, effort: CheckedEffort, step_ns: int) -> Command:
        return Command(
            arm=self.settings.arm,
            tick=tick,
            lease=lease,
            torque=effort.torque,
            base_force=effort.base_force,
            grip_m=self._grip_m,
            stiffness=effort.stiffness,
            residual_W=effort.residual_W,
            step_ns=step_ns,
        )


def run_follower(link: Link, settings: FollowerSettings, departure: Departure | None = None) -> str:
    """Join, answer every state until the run ends or this follower has left, and return why it ended.

    Asked for a ``departure``, it says that it is leaving, puts down what it carries, drives clear, and says goodbye
    instead of answering one more state. Interrupted, it says goodbye at once.

    In lock-step, time stands still while no state comes, so there is nothing to hold. In real time the arm goes on
    falling: after ``state_timeout_s`` without a state the follower sends one hold command.

    Raises:
        NotWelcome, AgentError: not let in, nobody there, or the simulator is gone.
        ControllerError: the law is unknown, its gains are wrong, or it failed.
    """
    follower, departure = Follower(settings), departure or Departure()
    keys = Keys(settings.run)
    session = AgentSession(link, keys.arm(settings.arm), keys.sim_alive, follower.hello(), State)
    departure.heard_by(session.wake)
    try:
        welcome = session.join(settings.join_timeout_s)
        while True:
            try:
                carry(session, follower, welcome, departure)
                session.leave()
                return "left in order"
            except SimulatorGone:
                if not settings.reconnect_s:
                    raise
                follower = Follower(settings)  # what the law remembers need not be true of the time that comes
                welcome = session.rejoin(settings.reconnect_s)
    except RunEnded as ended:
        return str(ended)
    except KeyboardInterrupt:
        if session.lease:
            session.leave()
        return "interrupted"
    finally:
        session.tell_refused()


def carry(session: AgentSession[State], follower: Follower, welcome: Welcome, departure: Departure) -> None:
    """Answer every state until the follower has left all that it carried. Raises as :func:`run_follower`."""
    log.info("arm %s: joined, %s clock, period %d ns", follower.settings.arm, welcome.clock, welcome.control_period_ns)
    follower.begin(welcome)
    period_s = 1e-9 * welcome.control_period_ns
    if welcome.clock == "real-time":
        _carry_in_real_time(session, follower, period_s, departure)
        return

    def answer(state: State) -> Command | None:
        follower.check(state)
        if follower.has_retreated:  # the goodbye is the answer to this state: between which ticks it comes is certain
            return None
        return follower.answer(state, session.lease, period_s)

    while not follower.has_retreated:
        if departure.wanted and not follower.is_retreating:
            _begin_to_leave(session, follower)
        session.answer_each(answer)


def _begin_to_leave(session: AgentSession[State], follower: Follower) -> None:
    follower.retreat()
    log.info("arm %s: leaves", follower.settings.arm)
    session.say_leaving()  # last: whoever ordered it waits for that, and then sends the next state


def _carry_in_real_time(
    session: AgentSession[State], follower: Follower, period_s: float, departure: Departure
) -> None:
    """Of states that have piled up only the newest is answered, and silence with a hold."""
    timeout_s = follower.settings.state_timeout_s
    holding = False
    while True:
        state = session.receive_newest(timeout_s)
        if departure.wanted and not follower.is_retreating:
            _begin_to_leave(session, follower)
            if state is None:
                continue
        if state is None:
            hold = None if holding else follower.hold(session.lease)
            if hold is not None:
                holding = True
                session.send(hold)
                log.warning("arm %s: no state for %g s: holding", follower.settings.arm, timeout_s)
            continue
        try:
            follower.check(state)
        except Refused as refusal:
            session.refuse(refusal)
            continue
        holding = False
        if follower.has_retreated:
            return
        session.send(follower.answer(state, session.lease, period_s))
