"""What disturbs hands and load besides the leader's pull: pushes from outside, and grasps that fail.

All of it goes to MuJoCo's ``xfrc_applied``, step by step, and is kept for the trace. Where a push is and how it goes
follows from the scenario, the seed and the number of physics steps since it began, so it can be taken up anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim_server.bad_grasp import BadGrasp
from sim_server.faults.event import LoadPlace, Seen
from sim_server.faults.pushes import Push
from sim_server.layout import Array, cross
from sim_server.push_shapes import Wave, wave_of
from sim_server.snapshot import Snapshot
from sim_server.world import World


@dataclass(slots=True)
class _Pushing:
    """A push that goes on, from one physics step up to, and without, another."""

    event: Push
    number: int
    begin: int
    end: int
    wave: Wave
    told: bool = False
    """Whether it has been seen to act."""
    wrench: Array = field(default_factory=lambda: np.zeros(6))
    """In the step before."""


class Disturbances:
    """All disturbances of a world."""

    def __init__(self, world: World, dt_s: float) -> None:
        self._dt_s = dt_s
        self._bad: dict[str, BadGrasp] = {}
        self._pushes: list[_Pushing] = []
        self._begun = 0
        """How many pushes have begun so far."""
        self._wrote = False
        """Whether anything is left in MuJoCo's memory."""
        self.news: list[Seen] = []
        """Pushes that have acted, or have ended, with what was seen; whoever reports it takes them out."""
        self.on_load = np.zeros(6)
        """On the load in the step before, (6,) N and N m about its centre of mass, world axes."""
        self._bind(world)

    def _bind(self, world: World) -> None:
        self._world, arms = world, list(world.arms.values())
        self._row = {name: row for row, name in enumerate(world.arms)}
        self._hands = np.array([ids.hand_body for ids in arms], dtype=np.intp)
        self.on_hands = np.zeros((len(arms), 6))
        """On each hand in the step before, (N, 6) N and N m at the tool centre, world axes."""

    def move_to(self, world: World) -> None:
        """The world has other robots now; who was pushed is pushed on, unless the robot has been taken away."""
        self._bind(world)
        for bad in self._bad.values():
            bad.move_to(world)
        for each in list(self._pushes):
            if each.event.arm is not None and each.event.arm not in self._row:
                self._pushes.remove(each)
                self.news.append(Seen(each.event, "its robot has been taken away", proves=each.told))

    def loosen(self, arm: str, force_N: float) -> None:
        """From now on this hand holds badly: softly, with spurious forces of this size per axis."""
        self._bad[arm] = BadGrasp(self._world, arm, force_N)

    def hand_opened(self, arm: str) -> None:
        """A hand that holds nothing does not hold badly."""
        if bad := self._bad.pop(arm, None):
            bad.end()

    def begin(self, event: Push, step: int) -> None:
        """A push begins with this physics step (counted from the run's start)."""
        self._pushes.append(self._pushing(event, self._begun, step))
        self._begun += 1

    def _pushing(self, event: Push, number: int, begin: int) -> _Pushing:
        steps = max(1, round(event.for_s / self._dt_s))
        return _Pushing(event, number, begin, begin + steps, wave_of(event, self._world.scenario.seed, number))

    def apply(self, step: int) -> None:
        """Add this physics step's disturbances to MuJoCo's forces; call once the load's other forces are written."""
        if not (self._bad or self._pushes or self._wrote):
            return
        self._world.data.xfrc_applied[self._hands] = 0.0
        self.on_load[:], self.on_hands[:] = 0.0, 0.0
        for arm, bad in self._bad.items():
            self._keep_spurious(arm, bad.push(self._dt_s))
        for each in self._pushes:
            if step >= each.end:  # within the last tick
                continue
            each.wrench = each.wave((step - each.begin) * self._dt_s)
            if each.event.arm is None:
                self._push_load(each.event.point or "centre_of_mass", each.wrench)
            else:
                self._push_hand(each.event.arm, each.wrench)
        self._wrote = bool(self._bad or self._pushes)

    def settle(self, step: int) -> None:
        """After a tick, when ``step`` comes next: what has been seen of the pushes, and which are over."""
        for each in list(self._pushes):
            if not each.told and each.wrench.any():
                each.told = True
                force, torque = np.linalg.norm(each.wrench[:3]), np.linalg.norm(each.wrench[3:])
                self.news.append(Seen(each.event, f"{force:.3g} N and {torque:.3g} N m act"))
            if step >= each.end:
                self._pushes.remove(each)
                self.news.append(Seen(each.event, "it has ended", proves=each.told))

    def _push_hand(self, arm: str, wrench: Array) -> None:
        ids, data = self._world.arms[arm], self._world.data
        force, torque = wrench[:3], wrench[3:]
        applied = data.xfrc_applied[ids.hand_body]
        applied[:3] += force
        applied[3:] += torque + _moment(data.site_xpos[ids.tcp_site] - data.xipos[ids.hand_body], force)
        self.on_hands[self._row[arm]] += wrench

    def _push_load(self, point: LoadPlace, wrench: Array) -> None:
        world = self._world
        about_com = wrench.copy()
        if point != "centre_of_mass":
            R_WO = world.data.xmat[world.load_body].reshape(3, 3)
            about_com[3:] += _moment(
                R_WO @ (world.load_points[point] - world.model.body_ipos[world.load_body]), wrench[:3]
            )
        world.data.xfrc_applied[world.load_body] += about_com
        self.on_load += about_com

    def _keep_spurious(self, arm: str, force: Array) -> None:
        """A bad grasp pushes the load at the grasp, and the hand back."""
        ids, data = self._world.arms[arm], self._world.data
        point = data.site_xpos[ids.grasp_site]
        self.on_load[:3] += force
        self.on_load[3:] += _moment(point - data.xipos[self._world.load_body], force)
        self.on_hands[self._row[arm], :3] -= force
        self.on_hands[self._row[arm], 3:] -= _moment(point - data.site_xpos[ids.tcp_site], force)

    def state(self) -> Snapshot:
        """The bad grasps, the pushes that go on, how many have begun, and what nobody has reported yet."""
        return {
            "bad": {arm: bad.state() for arm, bad in self._bad.items()},
            "pushes": [
                [each.event.model_dump(mode="json"), each.number, each.begin, each.told] for each in self._pushes
            ],
            "begun": self._begun,
            "wrote": self._wrote,
            "news": [[each.event.model_dump(mode="json"), each.effect, each.proves] for each in self.news],
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there. MuJoCo's forces are the world's own state."""
        self._bad = {arm: BadGrasp(self._world, arm, float(bad["force_N"])) for arm, bad in saved["bad"].items()}
        for arm, bad in saved["bad"].items():
            self._bad[arm].restore(bad)
        self._pushes = []
        for event, number, begin, told in saved["pushes"]:
            push = Push.model_validate(event)
            each = self._pushing(push, int(number), int(begin))
            each.told = bool(told)
            self._pushes.append(each)
        self._begun, self._wrote = int(saved["begun"]), bool(saved["wrote"])
        self.news[:] = [
            Seen(Push.model_validate(event), str(effect), bool(proves)) for event, effect, proves in saved["news"]
        ]


def _moment(lever: Array, force: Array) -> tuple[float, float, float]:
    return cross(lever.tolist(), force.tolist())
