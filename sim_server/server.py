"""The simulator process: builds the world of a scenario, lets the agents in, runs the clock, leaves a run folder."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sim_server.audit import Auditor
from sim_server.checkpoint import Checkpoints, Owners
from sim_server.checkpoint_file import FOLDER, Checkpoint
from sim_server.clock import make_clock
from sim_server.connections import connections_of
from sim_server.disk import Disk
from sim_server.errors import PlantFailed, ScenarioError, SimError
from sim_server.happenings import Happenings
from sim_server.layout import LayoutError
from sim_server.lockstep import Stopped
from sim_server.metrics import tilt_deg
from sim_server.mujoco_plant import MujocoPlant
from sim_server.newcomers import Newcomers
from sim_server.process_deeds import Undone
from sim_server.reception import LEADER, Arrived, Reception, Terms
from sim_server.run_description import Ending, describe_agents, describe_run
from sim_server.run_folder import AUDIT, METRICS, RUN, RunFolder, compute_metrics, write_json
from sim_server.scenario_files import NamedScenario
from sim_server.tally import OBSERVERS, OPERATOR, CountedPublisher, Tallies
from sim_server.trace import TraceWriter
from sim_server.trace_rows import Segment
from sim_server.truth import TruthFeed
from sim_server.verdict import Verdict
from sim_server.world import World, build_world
from wire.arms import arm_digest
from wire.arms.limits import arm_limits
from wire.codec import encode
from wire.endpoints import Endpoint
from wire.keys import Keys
from wire.lifecycle import Invitation
from wire.link import Link
from wire.messages import End, Order, Progress

log = logging.getLogger("palanquin.sim")

PROGRESS_S = 0.1
"""Wall time between two reports of progress."""
FAREWELL_S = 2.0
"""Wall time that the agents get to hear the end."""


class NobodyCame(SimError):
    """Not all agents greeted in time."""

    exit_status = 3


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended."""

    verdict: Verdict
    completed: bool
    why: str
    link_hangs: bool = False
    """Nothing may be asked of the link any more, not even to close: leave the process at once."""


class Server:
    """One run of one scenario.

    Args:
        link: a listening link.
        named: the scenario.
        run: name of the run, part of every key.
        folder: where the run's files go.
        names_proven: whether credentials stand behind the agents' names; for the audit.
        listening: where the link listens; None if it is a client of a router.
        checkpoint: from which the run goes on, in the folder that it came from; None for a new run.

    Raises:
        CheckpointError, RowsLost: the run cannot go on from there; nothing has been changed.
    """

    def __init__(
        self,
        link: Link,
        named: NamedScenario,
        run: str,
        folder: RunFolder,
        *,
        names_proven: bool = False,
        listening: Endpoint | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        self._named, self._run_name, self._folder = named, run, folder
        self._scenario = named.scenario
        self._world: World = build_world(self._scenario)
        self._plant = MujocoPlant(self._world)
        keys = Keys(run)
        tallies = Tallies()
        if checkpoint is not None:  # before anybody can be heard
            with checkpoint.taking_back():
                tallies.restore(checkpoint.content["tallies"])
        connections = connections_of(listening, tallies)
        self._truth = TruthFeed(link, keys, tallies)
        self._reception = Reception(link, keys, self._invitations(), self._report, tallies)
        seen = self._reception.tallies.of(OBSERVERS, keys.progress, "to")
        self._progress = CountedPublisher(link.publisher(keys.progress), seen)
        self._auditor = Auditor(
            link,
            keys,
            {name: self._reception.keys_of(name) for name in self._reception.agents},
            connections,
            names_proven=names_proven,
        )
        self._clock = make_clock(self._scenario, self._reception, self._plant, self._report)
        self._trace: TraceWriter | None = None
        self._disk = Disk()
        self._newcomers = Newcomers(self._scenario, self._plant, self._reception, self._invite, self._robots_changed)
        deeds = CountedPublisher(link.publisher(keys.deeds), self._reception.tallies.of(OPERATOR, keys.deeds, "to"))
        self._happenings = Happenings(
            self._scenario.events,
            self._reception,
            self._clock,
            self._plant,
            deeds,
            self._report,
            period_ms=self._scenario.clock.control_period_ms,
            start_s=self._scenario.clock.start_timeout_s,
            newcomers=self._newcomers,
            waits=self._scenario.clock.mode == "lock-step",
            ticks=self._scenario.ticks,
            save=self._disk.wait,
        )
        self._start_wall = 0.0
        self._last_progress = 0.0
        owners = Owners(self._plant, self._reception, self._clock, self._happenings, self._invite)
        self._checkpoints = Checkpoints(folder, run, named, owners, self._disk)
        if checkpoint is not None:
            self._go_on(checkpoint)

    def _invite(self, arm: str) -> None:
        """Expect the agent of a robot that comes, or came before the simulator was killed. While the robot is not there
        the answer to a greeting waits for its tick."""
        if arm not in self._reception.agents:
            self._reception.invite(*self._invitation(arm), hold=arm not in self._plant.met)
            self._auditor.expect(arm, self._reception.keys_of(arm))
            self._newcomers.know(arm)

    def _invitation(self, arm: str) -> tuple[Invitation, Terms]:
        team, clock = self._scenario.team, self._scenario.clock
        digest, joints = arm_digest(team.arm), arm_limits(team.arm).joints
        return (
            Invitation(self._run_name, "follower", arm, team.arm, digest, joints, team.missed_ticks_until_lost),
            Terms(
                clock.mode,
                clock.control_period_ms * 1_000_000,
                {},
                0.0,
                self._plant.carry_height_m,
                partial(self._plant.reach, arm),
            ),
        )

    def _robots_changed(self, names: Sequence[str]) -> None:
        if self._trace is not None:
            self._trace.segment(names)

    def _invitations(self) -> Iterator[tuple[Invitation, Terms]]:
        scenario, team, clock = self._scenario, self._scenario.team, self._scenario.clock
        for arm in scenario.arms:
            yield self._invitation(arm)
        if scenario.leader is not None:
            yield (
                Invitation(self._run_name, "leader", LEADER, "", "", 0, team.missed_ticks_until_lost),
                Terms(
                    clock.mode,
                    scenario.leader.period_ms * 1_000_000,
                    dict(self._plant.points),
                    scenario.leader.force_max_N,
                ),
            )

    def _go_on(self, checkpoint: Checkpoint) -> None:
        """Take the run up where the checkpoint left it. What was written after it is dropped, or marked as undone."""
        rows = self._checkpoints.restore(checkpoint)
        self._trace = self._open_trace(rows)
        with checkpoint.taking_back():
            self._folder.rewind(int(checkpoint.content["events_bytes"]))
        leases = {name: agent.link.lease for name, agent in self._reception.agents.items()}
        self._auditor.go_on(self._plant.time_s, leases)
        self._report("resumed", at=self._checkpoints.story.resumed[-1]["at"])
        self._happenings.survive(self._folder.times("ordered", "sim_kill"), self._plant.tick)

    def _open_trace(self, segments: Sequence[Segment] = ()) -> TraceWriter:
        scenario = self._scenario
        return TraceWriter(
            self._folder.trace, scenario.arms, arm_limits(scenario.team.arm).joints, segments, self._disk
        )

    def _report(self, kind: str, **details: object) -> None:
        self._folder.event(self._plant.tick, self._plant.time_s, kind, **details)
        self._truth.event(self._plant.tick, self._plant.time_s, kind, details)
        log.info("%s %s", kind, details)

    def stop(self) -> None:
        """End the run before the next tick, keeping what was recorded. May be called from any thread or a signal."""
        self._reception.inbox.put(Arrived("order", "", encode(Order("stop", 0))))

    def run(self) -> Outcome:
        """Wait for the agents, run to the end, write the folder.

        Raises:
            NobodyCame: not all agents were there in time; nothing but the events is left.
        """
        is_over = self._trace is None  # a run that has not been gone on with is not over: its agents may wait on
        try:
            try:
                self._wait_for_agents()
            except Stopped:
                raise NobodyCame(
                    "stopped before the first tick: nothing was recorded"
                    if self._trace is None
                    else "stopped before the run went on: it stands where it stood"
                ) from None
            is_over = True
            with self._auditor.connections.watching():
                completed, why = self._run_ticks()
            return self._conclude(completed, why)
        finally:
            if is_over and not self._auditor.hangs:
                self._say_end("the run is over")
            self._folder.close()

    def _wait_for_agents(self) -> None:
        reception = self._reception
        deadline = time.monotonic() + self._scenario.clock.start_timeout_s
        while True:
            while not reception.inbox.empty():
                self._clock.take(reception.inbox.get())
            self._clock.admit()
            missing = reception.missing()
            if not missing:
                return
            if time.monotonic() > deadline:
                raise NobodyCame(
                    f"waited {self._scenario.clock.start_timeout_s:g} s for {', '.join(missing)}: not there; see the "
                    "logs of those agents"
                )
            self._publish_progress("waiting", ", ".join(missing))
            time.sleep(0.005)

    def _run_ticks(self) -> tuple[bool, str]:
        scenario, plant, clock = self._scenario, self._plant, self._clock
        if self._trace is None:
            self._trace = self._open_trace()
            self._report("started")
        trace, checkpoints = self._trace, self._checkpoints
        self._start_wall = time.monotonic() - checkpoints.story.wall_s
        try:
            for tick in range(plant.tick, scenario.ticks):
                if checkpoints.is_due(tick):
                    checkpoints.write(trace, time.monotonic() - self._start_wall)
                self._happenings.before(tick)
                clock.tick(tick)
                before = plant.state_row() if tick % scenario.record.every_ticks == 0 else None
                stepping = time.perf_counter_ns()
                plant.step()
                stepped = time.perf_counter_ns()
                if before is not None:
                    row = plant.force_row(before)
                    trace.append(row)
                    self._truth.row(row, sum(clock.timings.begun) + stepped - stepping, plant.world.arms)
                if time.monotonic() - self._last_progress > PROGRESS_S:
                    self._publish_progress("running", "")
                clock.timings.end_tick(stepped - stepping, time.perf_counter_ns() - stepped)
            self._happenings.finish()
        except Stopped:
            return False, "stopped by the operator"
        except (PlantFailed, Undone) as failure:
            return False, str(failure)
        finally:
            self._newcomers.end()
            trace.flush()
            self._disk.wait()
        return True, "reached its duration"

    def _conclude(self, completed: bool, why: str) -> Outcome:
        wall_s = time.monotonic() - self._start_wall
        folder, trace = self._folder.path, self._trace
        assert trace is not None
        unproven = self._happenings.proofs.missing()
        for each in unproven:
            self._report("unproven", text=each)
        self._report("ended", why=why)
        trace.close()
        ending = Ending(completed, why, wall_s, unproven)
        write_json(
            folder / RUN,
            describe_run(
                self._run_name, self._named, self._plant, self._reception, self._clock, self._checkpoints, ending
            ),
        )
        # The run has ended in order now, and nobody will go on with it.
        trace.forget()
        shutil.rmtree(folder / FOLDER, ignore_errors=True)
        verdict: Verdict = "unknown"
        if self._plant.tick:
            metrics, _ = compute_metrics(folder)
            write_json(folder / METRICS, metrics)
            verdict = metrics["verdict"]
        self._truth.event(self._plant.tick, self._plant.time_s, "judged", {"verdict": verdict, "why": why})
        self._truth.close()
        # All else is on the disk, and the agents wait for the next tick or the end: nobody comes, goes or declares, if
        # all behave. If one does not, and the look hangs, this file alone says less.
        self._auditor.look()
        audit = self._auditor.describe(self._reception.tallies, describe_agents(self._reception))
        write_json(folder / AUDIT, audit)
        if completed and unproven:
            why = f"{why}, but {unproven[0]}" + (f" ({len(unproven) - 1} more)" if len(unproven) > 1 else "")
        return Outcome(verdict, completed, why, self._auditor.hangs)

    def _publish_progress(self, phase: Any, waiting_for: str) -> None:
        now = time.monotonic()
        if now - self._last_progress < PROGRESS_S:
            return
        self._last_progress = now
        pose = self._plant.load_pose()
        leader = self._scenario.leader
        distance = float(np.hypot(*(pose.position[:2] - leader.goal_m))) if leader else -1.0
        wall_s = now - self._start_wall
        self._progress.put(
            encode(
                Progress(
                    phase=phase,
                    waiting_for=waiting_for,
                    tick=self._plant.tick,
                    ticks=self._scenario.ticks,
                    time_s=self._plant.time_s,
                    real_time_factor=self._plant.time_s / wall_s if phase == "running" else 0.0,
                    tilt_deg=float(tilt_deg(pose.quat_wxyz[None])[0]),
                    goal_distance_m=distance,
                    missed_ticks=sum(agent.link.missed for agent in self._reception.followers.values()),
                    age_max_ticks=self._clock.punctuality.oldest,
                )
            )
        )

    def _say_end(self, why: str) -> None:
        """Tell the agents that it is over, and give them time to go."""
        agents, inbox = self._reception.agents, self._reception.inbox
        self._reception.dismiss_those_held(why)
        for agent in agents.values():
            if agent.is_in:
                agent.publisher.put(encode(End("over", why)))
        still_in = {name for name, agent in agents.items() if agent.is_in}
        deadline = time.monotonic() + FAREWELL_S
        while still_in and time.monotonic() < deadline:
            while not inbox.empty():
                arrived = inbox.get()
                if arrived.kind == "gone":
                    still_in.discard(arrived.name)
            time.sleep(0.005)


def default_folder(runs: Path, name: str) -> Path:
    """A dated folder under ``runs`` that does not exist yet."""
    stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    path, k = runs / f"{stamp}_{name}", 1
    while path.exists():
        k += 1
        path = runs / f"{stamp}_{name}_{k}"
    return path


def check_world(named: NamedScenario) -> None:
    """Build the world of a scenario once, to see that it can be. Raises :class:`SimError`."""
    try:
        build_world(named.scenario)
    except LayoutError as error:
        file = Path(named.source).name
        raise ScenarioError(file, error.key, error.problem, expected=error.expected, fix=error.fix) from None
    except ValueError as error:  # MuJoCo's, when it cannot make a model of these numbers
        raise ScenarioError(Path(named.source).name, "", f"no world can be built from it: {error}") from None
