"""One step of a law, warm: as it ships (traced, machine code), as plain numpy, and beside Pinocchio's own share."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.arm_model import ArmModel
from agents.controllers import make_controller
from agents.controllers.interface import Sensed
from agents.controllers.palanquin import PalanquinController, least_stiffness, palanquin_law
from agents.controllers.palanquin_gains import PalanquinGains
from agents.controllers.paper import PaperController, PaperGains, law_of_the_arm, paper_law
from deploy.bench.figures import Part, Samples
from deploy.bench.plan import Plan, team_of
from deploy.bench.timing import Action, spread_us, times_us
from sim_server.world import build_world
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]
DT_S = 1e-3
SLOW_PART = 4
"""Plain numpy is so slow that a fraction of the calls has to do."""

STEP, TERMS = "step as shipped", "Pinocchio's terms"
WITH_PINOCCHIO, PLAIN = "numpy and Pinocchio", "numpy alone"


def at_work() -> Sensed:
    """An arm in the pose of a carry, moving a little, with its share of a load: q, qd, tau (7,), wrench (6,)."""
    world = build_world(team_of(4).load().scenario)
    q, n = world.q_home.copy(), len(world.q_home)
    return Sensed(q, 0.02 * np.sin(np.arange(n)), np.linspace(-20.0, 40.0, n), np.array([1.0, -2.0, 50.0, 0.1, 0.2, 0]))


def paper_actions(arm: ArmModel, sensed: Sensed) -> dict[str, Action]:
    """The preset ``paper`` in every form."""
    controller, gains = PaperController(arm), PaperGains()
    q, qd = sensed.q, sensed.qd
    controller.step(sensed, DT_S)
    at_start = arm.snapshot(q, qd)
    p_held, up_E, ahead_held = at_start.p_BE, at_start.R_BE[2], at_start.R_BE[:, 0]

    def with_pinocchio() -> Any:
        now = arm.snapshot(q, qd)
        return paper_law(
            gains, qd=qd, M_inv=now.M_inv, C=now.C, g=now.g, J=now.J, Jdot=now.Jdot, p_BE=now.p_BE, R_BE=now.R_BE,
            p_held=p_held, up_E=up_E, ahead_held=ahead_held,
        )  # fmt: skip

    return {
        STEP: lambda: controller.step(sensed, DT_S),
        WITH_PINOCCHIO: with_pinocchio,
        PLAIN: lambda: law_of_the_arm(arm.chain, gains, q, qd, p_held, up_E, ahead_held),
        TERMS: lambda: arm.snapshot(q, qd),
    }


def palanquin_actions(arm: ArmModel, sensed: Sensed) -> dict[str, Action]:
    """The preset ``palanquin``; its law works the arm's terms out itself, so there is no form with Pinocchio's."""
    controller, gains = PalanquinController(arm), PalanquinGains()
    controller.step(sensed, DT_S)
    at_start, tau_max = arm.snapshot(sensed.q, sensed.qd), np.array(arm_limits(arm.name).torque_Nm)
    n, one = arm.joints, np.ones(1)
    inputs: dict[str, Array] = {
        "q": sensed.q, "qd": sensed.qd, "tau": sensed.tau, "wrench": sensed.wrench,
        "p_held": at_start.p_BE, "up_E": at_start.R_BE[2], "ahead_held": at_start.R_BE[:, 0], "q_held": sensed.q,
        "p": np.zeros(n), "r": np.zeros(n), "f": np.zeros(2), "K": np.array(least_stiffness(gains)),
        "dt_s": DT_S * one, "keep_r": 0.99 * one, "keep_f": 0.99 * one, "rise": one,
    }  # fmt: skip
    return {
        STEP: lambda: controller.step(sensed, DT_S),
        PLAIN: lambda: palanquin_law(gains, arm.chain, tau_max, **inputs),
        TERMS: lambda: arm.snapshot(sensed.q, sensed.qd),
    }


def measure_controller(plan: Plan, tell: Callable[[str], None]) -> Part:
    """Both presets, in turns."""
    samples, arm, sensed = Samples(), ArmModel("panda"), at_work()
    laws = {"paper": paper_actions(arm, sensed), "palanquin": palanquin_actions(arm, sensed)}
    for k in range(plan.turns):
        for law, actions in laws.items():
            tell(f"turn {k + 1} of {plan.turns}, {law}")
            _add(samples, law, times_of(actions, plan.calls))
    said = (
        "Numpy: the same equations (the functions that are traced), called on arrays; the arm's terms by Pinocchio, or "
        "in numpy as well. The preset palanquin works them out itself.",
        f"Making a controller, traced and compiled, takes {1e3 * _making_s(arm):.0f} ms.",
    )
    return Part("controller", "One step of a law, warm", samples.figures(), said)


def times_of(actions: Mapping[str, Action], calls: int) -> dict[str, list[float]]:
    """Wall time of every call, us; of what is plain numpy fewer."""
    quick = {name: action for name, action in actions.items() if name in (STEP, TERMS)}
    slow = {name: action for name, action in actions.items() if name not in quick}
    return times_us(quick, calls) | times_us(slow, max(1, calls // SLOW_PART))


def _add(samples: Samples, law: str, times: Mapping[str, list[float]]) -> None:
    median: dict[str, float] = {}
    for name, each in times.items():
        p50, p99 = spread_us(each)
        median[name] = p50
        samples.add(f"{name}, p50", law, "us", p50, "less")
        samples.add(f"{name}, p99", law, "us", p99, "less")
    for name in (WITH_PINOCCHIO, PLAIN):
        if name in median:
            samples.ratio(f"{name} / {STEP}", law, median[name], median[STEP], "more")
    samples.ratio(f"{STEP} / {TERMS}", law, median[STEP], median[TERMS], "less")


def _making_s(arm: ArmModel) -> float:
    """Wall time of making the preset ``paper``, median of three."""
    times = times_us({"make": lambda: make_controller("paper", arm, {})}, 3)["make"]
    return statistics.median(times) / 1e6
