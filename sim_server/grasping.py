"""The hands of a world: which hold, which are empty, what those feel, and how a strut is taken and let go.

A hand takes hold where it is: the grasp on the load moves to the closed fingers, so that nothing snaps together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_server.bases import base_place, base_rate
from sim_server.grips import grip_wrenches
from sim_server.hands import OPEN_M, Hand, would_hold
from sim_server.layout import STRUT_SIDE_M, Array, Pose
from sim_server.robots import R_SE
from sim_server.scene import locate, quat_wxyz, rotation
from sim_server.snapshot import Snapshot
from sim_server.world import World
from wire.messages import Vector

WATCHED_S = 0.5
"""How long after a hand has closed its force counts as that of grasping."""


@dataclass(slots=True)
class Closing:
    """A hand that has closed on its strut."""

    arm: str
    tick: int
    force_max_N: float = 0.0
    """The greatest force between hand and load since then."""


class Grasping:
    """All hands of a world."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.empty: dict[str, Hand] = {}
        self.closing: dict[str, Closing] = {}
        self.opened: list[str] = []
        """Arms whose hands have opened; whoever reports it takes them out."""
        self.force_max_N = 0.0
        """The greatest force of any hand that has taken hold, while it did."""
        self.grasped: list[Closing] = []
        """Hands that have closed on their struts, and a while has passed: likewise."""

    def move_to(self, world: World, arrived: list[str]) -> None:
        """The world has other robots now; those that have arrived have empty hands."""
        self._world = world
        for gone in self.empty.keys() - world.arms.keys():
            del self.empty[gone]
        for name in arrived:
            self.empty[name] = Hand(self._base(name))

    def feel(self, arm: str) -> tuple[float, Vector]:
        """Opening m and odometry (6,) of an empty hand's robot."""
        hand, ids = self.empty[arm], self._world.arms[arm]
        return hand.opening_m, hand.odometry(self._base(arm), base_rate(ids, self._world.data))

    def want(self, arm: str, grip_m: float) -> bool:
        """The agent wants its fingers so far open; whether that means that a hand that holds lets go."""
        if arm in self.empty:
            self.empty[arm].wanted_m = min(max(grip_m, 0.0), OPEN_M)
            return False
        return grip_m > STRUT_SIDE_M

    def let_go(self, arm: str) -> None:
        """Open a hand that holds."""
        self._world.data.eq_active[self._world.arms[arm].weld] = 0
        self.closing.pop(arm, None)
        self.empty[arm] = Hand(self._base(arm), STRUT_SIDE_M)
        self.opened.append(arm)

    def reach(self, arm: str) -> Vector:
        """Where the strut of this arm is, in the arm's own base frame: position m and ``quat_wxyz`` of the hand that
        grasps it, (7,); zeros for a hand that holds. Its odometer begins now."""
        if arm not in self.empty:
            return (0.0,) * 7
        hand = self.empty[arm]
        hand.origin = self._base(arm)
        x, y, yaw = hand.origin
        X_AE = Pose.planar(x, y, self._world.pedestal_m, yaw).inverse().compose(self._holding_pose(arm))
        return (*X_AE.p.tolist(), *quat_wxyz(X_AE.R).tolist())

    def move(self, tick: int, dt_s: float) -> None:
        """Fingers of empty hands move for a tick; those that close around their struts hold them from now on."""
        for name, hand in list(self.empty.items()):
            if not hand.move(dt_s):
                continue
            world, ids = self._world, self._world.arms[name]
            locate(world.model, world.data)
            X_WE = Pose(
                *(each.copy() for each in (world.data.site_xpos[ids.tcp_site], rotation(world.data, ids.tcp_site)))
            )
            if would_hold(self._holding_pose(name).inverse().compose(X_WE)) and not self.is_held(ids.strut):
                X_OE = load_pose(world).inverse().compose(X_WE)
                world.model.site_pos[ids.grasp_site] = X_OE.p
                world.model.site_quat[ids.grasp_site] = quat_wxyz(X_OE.R)
                world.data.eq_active[ids.weld] = 1
                del self.empty[name]
                self.closing[name] = Closing(name, tick)

    def watch(self, tick: int, dt_s: float) -> None:
        """How hard the hands pull that have just closed."""
        grips = dict(zip(self._world.arms, grip_wrenches(self._world), strict=True))
        for name, closing in list(self.closing.items()):
            closing.force_max_N = max(closing.force_max_N, float(np.linalg.norm(grips[name][:3])))
            self.force_max_N = max(self.force_max_N, closing.force_max_N)
            if (tick - closing.tick) * dt_s >= WATCHED_S:
                self.grasped.append(self.closing.pop(name))

    def holds(self, arm: str) -> bool:
        """Whether this robot is there and its hand holds."""
        return arm in self._world.arms and arm not in self.empty

    def is_held(self, strut: int) -> bool:
        """Whether some hand holds this strut (from 0)."""
        return self.holder(strut) is not None

    def holder(self, strut: int) -> str | None:
        """Whose hand holds this strut (from 0)."""
        return next((name for name, ids in self._world.arms.items() if ids.strut == strut and self.holds(name)), None)

    def state(self) -> Snapshot:
        """Empty hands, those that have just closed, and what nobody has reported yet."""
        return {
            "empty": {name: [hand.origin, hand.opening_m, hand.wanted_m] for name, hand in self.empty.items()},
            "closing": [[each.arm, each.tick, each.force_max_N] for each in self.closing.values()],
            "opened": list(self.opened),
            "grasped": [[each.arm, each.tick, each.force_max_N] for each in self.grasped],
            "force_max_N": self.force_max_N,
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there. Whether a hand holds is the world's own state."""
        self.empty = {
            str(name): Hand(np.array(origin), float(opening), float(wanted))
            for name, (origin, opening, wanted) in saved["empty"].items()
        }
        self.closing = {str(arm): Closing(str(arm), int(tick), float(most)) for arm, tick, most in saved["closing"]}
        self.grasped = [Closing(str(arm), int(tick), float(most)) for arm, tick, most in saved["grasped"]]
        self.opened[:] = map(str, saved["opened"])
        self.force_max_N = float(saved["force_max_N"])

    def _base(self, arm: str) -> Array:
        return base_place(self._world.arms[arm], self._world.data)

    def _holding_pose(self, arm: str) -> Pose:
        """Pose in the world of a hand that holds this arm's strut squarely."""
        X_WS = load_pose(self._world).compose(self._world.struts[self._world.arms[arm].strut])
        return X_WS.compose(Pose(np.zeros(3), R_SE))


def load_pose(world: World) -> Pose:
    """Pose of the load's frame O in the world, now."""
    pose = world.data.qpos[world.load_qpos]
    w, x, y, z = pose[3:]
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return Pose(pose[:3].copy(), R)


def base_at_strut(world: World, strut: int) -> Pose:
    """Where a base stands, on the floor, whose hand is at this strut (from 0) in the starting posture."""
    X_WO, X_OB = load_pose(world), world.struts[strut].compose(world.X_BS.inverse())
    yaw = math.atan2(X_WO.R[1, 0], X_WO.R[0, 0])
    X_WB = Pose.planar(X_WO.p[0], X_WO.p[1], 0.0, yaw).compose(Pose.planar(X_OB.p[0], X_OB.p[1], 0.0, X_OB.yaw))
    return X_WB
