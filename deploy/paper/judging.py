"""Every claim of section VI, in the paper's words, bound to the runs that it is checked on, and its verdict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.controllers.reference import ReferenceGains
from deploy.paper import claims
from deploy.paper.ablations import ALONE
from deploy.paper.claims import Found
from deploy.paper.results import NoSuchRun, Results, hand_places
from deploy.paper.statistics import Spread, spread
from deploy.planned_run import Run
from sim_server.verdict import Verdict

Array = NDArray[np.float64]

PERIOD_S = 4.0
"""Of the trajectory: 0.25 Hz."""
HOLDS_IN, FAILS_IN = 0.95, 0.5
"""A claim holds if it does in at least 95 % of the seeds, and does not if it does in no more than half."""

Check = Callable[[Results, str, int], Found]
"""``check(results, preset, seed)``."""


@dataclass(frozen=True, slots=True)
class Claim:
    """One claim of the paper."""

    name: str
    says: str
    """What the paper says, or what it comes to."""
    measures: str
    """What is measured for it."""
    needs: tuple[str, str]
    """The experiment and the condition whose seeds are gone through."""
    check: Check


@dataclass(frozen=True, slots=True)
class Judged:
    """A claim over all seeds of a preset."""

    claim: Claim
    preset: str
    found: tuple[Found, ...]
    seeds: tuple[int, ...]
    """Of each that was found."""
    verdict: Verdict

    @property
    def spread(self) -> Spread | None:
        """Of what was measured."""
        return spread(each.value for each in self.found)

    @property
    def holds_in(self) -> int:
        """Number of seeds in which it holds."""
        return sum(each.holds for each in self.found)


def judge(claim: Claim, results: Results, preset: str) -> Judged:
    """The verdict: ``unknown`` where there are no runs, or where some seeds say yes and some no. A seed without a run
    that the claim compares with says nothing."""
    found = {}
    for seed in results.seeds(*claim.needs, preset):
        with suppress(NoSuchRun):
            found[seed] = claim.check(results, preset, seed)
    verdict = verdict_of([each.holds for each in found.values()])
    return Judged(claim, preset, tuple(found.values()), tuple(found), verdict)


def verdict_of(holds: Sequence[bool]) -> Verdict:
    """Of one claim, from each seed's."""
    if not holds:
        return "unknown"
    part = sum(holds) / len(holds)
    if part >= HOLDS_IN:
        return "holds"
    return "violated" if part <= FAILS_IN else "unknown"


def _trace(results: Results, group: str, condition: str, preset: str, seed: int) -> claims.Trace:
    return results.trace(results.run(group, condition, preset, seed))


def _goal(results: Results, condition: str, preset: str, seed: int) -> tuple[float, float]:
    x, y = results.about(results.run("VI-C", condition, preset, seed))["facts"]["goal_m"]
    return float(x), float(y)


def disturbed_s(about: Any) -> tuple[float, float] | None:
    """When a run's scenario pushes, from its run.json."""
    for event in about["scenario"]["events"]:
        if event["kind"] in ("push", "fail_grasp"):
            return float(event["at_s"]), float(event["at_s"] + event["for_s"])
    return None


def wanted_height(about: Any, time_s: Array) -> Array:
    """The height that the follower of a trajectory is to hold, against its start, (rows,) m."""
    known = {name: value for name, value in about["scenario"]["team"]["gains"].items() if name.startswith("reference")}
    reference = ReferenceGains.model_validate(known)
    return np.array([reference.reference_at(float(t))[0][0] for t in time_s])


def _selective(condition: str) -> tuple[Claim, ...]:
    """VI-A: what moves and what does not."""

    def selectivity(results: Results, preset: str, seed: int) -> Found:
        return claims.selectivity(hand_places(_trace(results, "VI-A", condition, preset, seed)))

    def height(results: Results, preset: str, seed: int) -> Found:
        return claims.height_kept(hand_places(_trace(results, "VI-A", condition, preset, seed)))

    def level(results: Results, preset: str, seed: int) -> Found:
        return claims.level_kept(_trace(results, "VI-A", condition, preset, seed))

    moves = "the disturbance forces induce motion in the other (null-space) dimensions"
    keeps = "but the robot maintains task space accuracy"
    where = "VI-A", condition
    return (
        Claim(f"{condition}: the plane gives", moves, "planar over vertical displacement, rms", where, selectivity),
        Claim(f"{condition}: height holds", keeps, "change of height, rms", where, height),
        Claim(f"{condition}: roll and pitch hold", keeps, "tilt, rms", where, level),
    )


TRAJECTORY = "VI-B", "trajectory"
SETTLED_IN_S = 4.0
"""The first period, in which the trajectory comes to its full amplitude, is no part of the error."""


def height_error(results: Results, run: Run) -> Array:
    """Wanted less actual height of the hand on a trajectory, (rows,) m."""
    trace = results.trace(run)
    height = hand_places(trace)[:, 2]
    error: Array = wanted_height(results.about(run), trace["time_s"]) - (height - height[0])
    return error[trace["time_s"] >= SETTLED_IN_S]


def _smaller_error(results: Results, preset: str, seed: int) -> Found:
    fixed, dynamic = (height_error(results, results.run(*TRAJECTORY, law, seed)) for law in ("fixed", preset))
    return claims.smaller_error(fixed, dynamic)


def _smaller_torque(results: Results, preset: str, seed: int) -> Found:
    fixed, dynamic = (_trace(results, *TRAJECTORY, law, seed) for law in ("fixed", preset))
    return claims.smaller_torque(fixed, dynamic)


def _faster(results: Results, preset: str, seed: int) -> Found:
    fixed, dynamic = (_trace(results, *TRAJECTORY, law, seed) for law in ("fixed", preset))
    return claims.faster_convergence(fixed, dynamic, PERIOD_S)


def _carries(condition: str, words: str) -> tuple[Claim, ...]:
    """VI-C: every condition arrives and stays level."""

    def arrives(results: Results, preset: str, seed: int) -> Found:
        return claims.arrives(_trace(results, "VI-C", condition, preset, seed), _goal(results, condition, preset, seed))

    def level(results: Results, preset: str, seed: int) -> Found:
        return claims.stays_level(_trace(results, "VI-C", condition, preset, seed), condition)

    where = "VI-C", condition
    return (
        Claim(f"{condition}: arrives", words, "distance from the goal at the end", where, arrives),
        Claim(f"{condition}: stays level", words, "largest tilt", where, level),
    )


def _tilts_little(condition: str) -> Claim:
    def little(results: Results, preset: str, seed: int) -> Found:
        span = disturbed_s(results.about(results.run("VI-C", condition, preset, seed)))
        assert span is not None, condition
        return claims.tilts_little(_trace(results, "VI-C", condition, preset, seed), *span, condition)

    says = "some minor out-of-plane rotation is experienced"
    return Claim(f"{condition}: tilts little", says, "change of tilt by the push", ("VI-C", condition), little)


def _comes_back(condition: str) -> Claim:
    def back(results: Results, preset: str, seed: int) -> Found:
        span = disturbed_s(results.about(results.run("VI-C", condition, preset, seed)))
        assert span is not None, condition
        return claims.comes_back(_trace(results, "VI-C", condition, preset, seed), *span)

    says = "it quickly returns to the initial pose after the force is removed"
    return Claim(f"{condition}: comes back", says, "tilt a second later, over that before", ("VI-C", condition), back)


def _straight(results: Results, preset: str, seed: int) -> Found:
    trace = _trace(results, "VI-C", "undisturbed", preset, seed)
    return claims.goes_straight(trace, _goal(results, "undisturbed", preset, seed))


def _felt(results: Results, preset: str, seed: int) -> Found:
    lost, undisturbed = (
        _trace(results, "VI-C", condition, preset, seed) for condition in ("failed-grasp", "undisturbed")
    )
    return claims.is_felt(lost, undisturbed)


def _alone(results: Results, preset: str, seed: int) -> Found:
    length, width, _ = results.about(results.run(ALONE, "1", preset, seed))["scenario"]["load"]["size_m"]
    return claims.needs_a_team(_trace(results, ALONE, "1", preset, seed), (float(length), float(width)))


CLAIMS: tuple[Claim, ...] = (
    *_selective("smooth"),
    *_selective("abrupt"),
    Claim("dynamic stiffness: smaller error", "dynamic stiffness control allows for smaller position error",
          "rms height error", TRAJECTORY, _smaller_error),
    Claim("dynamic stiffness: smaller torque", "and smaller overall joint forces",
          "mean of the sum of the joints' torques' sizes", TRAJECTORY, _smaller_torque),
    Claim("dynamic stiffness: faster", "with faster convergence to steady-state torque application",
          "time until the torque has settled", TRAJECTORY, _faster),
    *_carries("undisturbed", "the payload moves smoothly to the goal location"),
    Claim("undisturbed: straight", "the payload moves smoothly to the goal location",
          "length of the way", ("VI-C", "undisturbed"), _straight),
    *_carries("pushed", "some minor out-of-plane rotation is experienced"),
    _tilts_little("pushed"),
    _comes_back("pushed"),
    *_carries("pushed-along", "transient planar perturbation of a single robot in parallel direction"),
    *_carries("twisted", "transient in-plane torque"),
    *_carries("failed-grasp", "the pose remains within controllable bounds and the task is still accomplished"),
    Claim("failed-grasp: is felt", "the loss of an agent has a noticeable effect on in-plane and out-of-plane rotation",
          "the smaller of the ratios of tilt and yaw", ("VI-C", "failed-grasp"), _felt),
    Claim("alone: fails", "an object too heavy or unwieldy for one to handle alone",
          "height of its lowest corner over the floor, least", (ALONE, "1"), _alone),
)  # fmt: skip
"""Every claim of section VI."""
