"""The simulated plant: MuJoCo steps, motor drivers before it, noisy sensors behind it.

Motor torques and base forces go into ``qfrc_applied``; the leader's pull into ``xfrc_applied`` of the load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, NoReturn

import mujoco
import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from sim_server.bases import Bases
from sim_server.disturbances import Disturbances
from sim_server.errors import PlantFailed
from sim_server.faults.damage import Damage
from sim_server.faults.pushes import Push
from sim_server.grasping import Grasping
from sim_server.grips import grip_wrenches
from sim_server.layout import STRUT_SIDE_M, cross
from sim_server.motor_drivers import MotorDrivers
from sim_server.new_world import carry_over, stand_outside
from sim_server.plant import LoadPose, Numbers, Reading
from sim_server.scenario import arm_number
from sim_server.sensor_noise import SensorNoise
from sim_server.snapshot import Snapshot, SnapshotError, fill
from sim_server.unled_arms import Behaviour, Brake, Felt, LetDown, Limp, Release
from sim_server.world import ArmIds, World, build_world
from wire.arms.limits import arm_limits
from wire.messages import Vector

Array = NDArray[np.float64]

NOWHERE: Vector = (0.0,) * 6

LOST_ARMS: Mapping[str, Callable[[], Behaviour]] = {"limp": Limp, "brake": Brake, "release": Release}
"""What a lost arm does, by the scenario's word for it."""

INTEGRATION = int(mujoco.mjtState.mjSTATE_INTEGRATION)
"""All that MuJoCo's next step depends on: positions, velocities, applied forces, which welds hold, the warm start."""
LEFT_BY_THE_STEP = ("sensordata", "qfrc_bias", "xmat", "xipos", "site_xpos")
"""What a step leaves behind and we read before the next: it belongs to the state that the step began with, so working
it out anew would give other numbers."""
GRASPS = ("eq_data", "eq_solref", "eq_solimp", "site_pos", "site_quat")
"""Numbers of the model that change during a run."""


class MujocoPlant:
    """A scenario's world, driven tick by tick. Implements :class:`sim_server.plant.Plant`.

    The arms start at rest with the torque that carries them and their share of the load's weight, as if their brakes
    had just been opened.
    """

    def __init__(self, world: World) -> None:
        scenario = world.scenario
        self._substeps = scenario.clock.control_period_ms // scenario.plant.physics_step_ms
        self._dt_s = scenario.plant.physics_step_ms / 1000
        limits, base, arms = arm_limits(scenario.team.arm), scenario.base, list(world.arms.values())
        self.disturbances = Disturbances(world, self._dt_s)
        self.damage = Damage(world, self._substeps, self._dt_s)
        self.hands = Grasping(world)
        self.tick = 0
        self._is_prepared = False
        """Whether the first half of the coming physics step is done."""
        self.met: dict[str, ArmIds] = {}
        """All robots that are or were there; of those that have gone only the strut and the differences still mean
        anything."""
        self._bind(world)
        noise = scenario.plant.scaled
        sigma = np.repeat(
            [
                noise.position_noise_rad,
                noise.velocity_noise_rad_s,
                noise.torque_noise_Nm,
                noise.wrench_noise_N,
                noise.wrench_noise_Nm,
            ],
            [limits.joints] * 3 + [3, 3],
        )
        self._noise = SensorNoise(sigma, scenario.seed, len(arms))
        self._drivers = MotorDrivers(
            np.array([self._static_torque(ids, share) for ids, share in zip(arms, fair_shares(world), strict=True)]),
            np.array(limits.torque_Nm),
            limits.torque_rate_Nm_s,
            np.zeros(3) if base.fixed else np.array([base.force_max_N, base.force_max_N, base.torque_max_Nm]),
            noise.delay_ticks,
        )
        self._pull_point = world.load_com.copy()
        """The pulled point, (3,) m in O."""
        self._pull_force = np.zeros(3)
        self._see(self._data)
        self._told: list[Numbers] = [(0.0,) * (limits.joints + 1) for _ in arms]
        """What the agents report of themselves, (N, n + 1): stiffness, N m/rad, and passivity residual, W. Made an
        array only where a row of the trace wants one."""
        mujoco.set_mju_user_warning(_ignore)
        self._apply_efforts()
        mujoco.mj_forward(self._model, self._data)

    def _bind(self, world: World) -> None:
        """Know where everything of this world is."""
        self.world = world
        self._model, self._data = world.model, world.data
        arms = list(world.arms.values())
        self.met |= world.arms
        self._names = list(world.arms)
        self._row = {name: row for row, name in enumerate(self._names)}
        self._arm_dofs = _indices([ids.arm_dof for ids in arms])
        self._arm_qpos = _indices([ids.arm_qpos for ids in arms])
        self._bases = Bases(arms)
        self._sensors = np.hstack(
            [_indices([ids.force_sensor for ids in arms]), _indices([ids.torque_sensor for ids in arms])]
        )

    def move_to(self, world: World) -> None:
        """Go on in another world, between two ticks: robots that are in both go on as they were, new ones stand outside
        by their struts, braked, with empty hands."""
        carry_over(self.world, world)
        arrived = [name for name in world.arms if name not in self._row]
        for name in arrived:
            stand_outside(world, name)
        rows = [self._row.get(name) for name in world.arms]
        self._bind(world)
        self.damage.move_to(world, self.tick)
        mujoco.mj_forward(self._model, self._data)
        gravity = self._data.qfrc_bias[self._arm_dofs]
        self._drivers.exchange(rows, gravity)
        self._noise.exchange(rows, [arm_number(name) for name in self._names])
        self._told = [(0.0,) * (gravity.shape[1] + 1) if row is None else self._told[row] for row in rows]
        self._see(self._data)
        self.hands.move_to(world, arrived)
        self.disturbances.move_to(world)
        for name in arrived:
            self._drivers.leave_to(self._row[name], Brake())
        self._apply_efforts()
        mujoco.mj_forward(self._model, self._data)

    @property
    def names(self) -> list[str]:
        """Arms that are there."""
        return list(self._names)

    @property
    def carry_height_m(self) -> float:
        """How high above the arms' own base frames the hands carry: where they are at the start."""
        return float(self.world.X_AE.p[2])

    def reach(self, arm: str) -> Vector:
        """Where the strut of this arm is: see :meth:`Grasping.reach`.

        Asked at a greeting: an arm that is being let down stays as it is from then on, since whoever greets is told now
        whether it holds.
        """
        row = self._row[arm]
        if self.hands.holds(arm) and self._drivers.lets_down(row):
            self._drivers.leave_to(row, Brake())
        return self.hands.reach(arm)

    def _static_torque(self, ids: ArmIds, share: float) -> Array:
        """Torque that holds the arm and so much of the load's weight, N, at the start, (n,) N m."""
        J = np.zeros((3, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, J, None, ids.tcp_site)
        torque: Array = self._data.qfrc_bias[ids.arm_dof] + share * J[2, ids.arm_dof]
        return torque

    def _see(self, data: Any) -> None:
        """Keep views of MuJoCo's memory: asking for one costs more than what is done with it."""
        load, arms, joints = self.world.load_body, *self._arm_dofs.shape
        self._qpos, self._qvel, self._qfrc_bias = data.qpos, data.qvel, data.qfrc_bias
        self._sensordata, self._qfrc_applied = data.sensordata, data.qfrc_applied
        self._R_WO = data.xmat[load].reshape(3, 3)
        self._load_com = self._model.body_ipos[load]
        self._load_force, self._load_torque = data.xfrc_applied[load, :3], data.xfrc_applied[load, 3:]
        self._warnings = data.warning.number
        # Where each number of a reading stands in [qpos, qvel, driver torques, sensordata].
        qvel, torque = len(self._qpos), len(self._qpos) + len(self._qvel)
        sensors = torque + arms * joints
        self._read_at = np.hstack(
            [
                self._arm_qpos,
                qvel + self._arm_dofs,
                torque + np.arange(arms * joints).reshape(arms, joints),
                sensors + self._sensors,
            ]
        )

    @property
    def time_s(self) -> float:
        """Simulated time of this tick."""
        return self.tick * self._substeps * self._dt_s

    def read(self) -> Mapping[str, Reading]:
        """Sensor readings of this tick. Call once per tick: the noise goes on."""
        joints = self._arm_dofs.shape[1]
        everything = np.concatenate([self._qpos, self._qvel, self._torque.ravel(), self._sensordata])
        sensed = everything[self._read_at] + self._noise.draw()
        if self.damage.goes_on:
            self.damage.sense(sensed, self.tick)
        noisy = sensed.tolist()
        readings = {
            name: Reading(
                q=tuple(row[:joints]),
                qd=tuple(row[joints : 2 * joints]),
                tau=tuple(row[2 * joints : 3 * joints]),
                wrench=tuple(row[3 * joints :]),
                grip_m=STRUT_SIDE_M,
                odometry=NOWHERE,
            )
            for name, row in zip(self._row, noisy, strict=True)
        }
        for name in self.hands.empty:
            grip_m, odometry = self.hands.feel(name)
            readings[name] = structs.replace(readings[name], grip_m=grip_m, odometry=odometry)
        return readings

    def load_pose(self) -> LoadPose:
        """Where the load is, without noise: for the leader and the record."""
        data, world = self._data, self.world
        pose, twist = data.qpos[world.load_qpos], data.qvel[world.load_dof]
        R_WO = np.zeros(9)
        mujoco.mju_quat2Mat(R_WO, pose[3:])
        return LoadPose(pose[:3].copy(), pose[3:].copy(), twist[:3].copy(), R_WO.reshape(3, 3) @ twist[3:])

    @cached_property
    def points(self) -> dict[str, tuple[float, ...]]:
        """Named points of the load that can be pulled, (3,) m in O."""
        return {name: tuple(float(x) for x in point) for name, point in self.world.load_points.items()}

    def pull(self, point: str, force: Array) -> None:
        """The leader's force, (3,) N world, at a named point; held, and moving with the point, until the next one."""
        self._pull_point = np.array(self.points[point])
        self._pull_force = force

    def command(
        self,
        arm: str,
        torque: Numbers,
        base_force: Numbers,
        stiffness: Numbers,
        grip_m: float = 0.0,
        residual_W: float = 0.0,
    ) -> None:
        """This tick's command of one arm; ``stiffness`` and ``residual_W`` are recorded only."""
        row = self._row[arm]
        self._drivers.command(row, torque, base_force)
        self._told[row] = (*stiffness, residual_W)
        if self._drivers.is_led(row) and self.hands.want(arm, grip_m):
            self.open_hand(arm)

    def lose(self, arm: str) -> str:
        """Nobody drives this arm any more: it does what the scenario says of lost arms. Returns that word."""
        word = self.world.scenario.team.when_lost
        self._leave_to(arm, LOST_ARMS[word]())
        return word

    def let_down(self, arm: str, *, retreated: bool = False) -> None:
        """This arm's agent has said goodbye. If it has put its share down and driven clear itself, the robot stays
        where it stands; else its driver does all that: its share fades, the hand opens, arm and base drive clear."""
        stands_clear = retreated and not self.hands.holds(arm)
        self._leave_to(arm, Brake() if stands_clear else LetDown(self.world.scenario.team.leave_s))

    def _leave_to(self, arm: str, behaviour: Behaviour) -> None:
        self._drivers.leave_to(self._row[arm], behaviour)
        self._told[self._row[arm]] = (0.0,) * (self._arm_dofs.shape[1] + 1)

    def loosen(self, arm: str, force_N: float) -> None:
        """From now on this hand holds badly: softly, with spurious forces of this size per axis."""
        self.disturbances.loosen(arm, force_N)

    def push(self, event: Push) -> None:
        """A push on a hand or on the load begins with this tick."""
        self.disturbances.begin(event, self.tick * self._substeps)

    def slip(self, arm: str) -> None:
        """This hand has slipped off. A gripper feels that it is empty, and its driver draws it back, whatever its agent
        commands; until the agent is started anew."""
        self._leave_to(arm, Release())

    def open_hand(self, arm: str) -> None:
        """The hand lets go; nothing if it holds nothing."""
        if not self.hands.holds(arm):
            return
        self.disturbances.hand_opened(arm)
        self.hands.let_go(arm)

    def regain(self, arm: str) -> None:
        """Somebody drives this arm again."""
        self._drivers.regain(self._row[arm])

    def prepare(self) -> None:
        """The part of the next step that needs no command: where everything is, what touches, what bears what.

        The same bits as without, since nothing moves before :meth:`step`. Not where a hand is empty or an arm unled:
        there the step itself still decides what holds; nor with faults, which may change the model in every step.
        """
        if not self.hands.empty and not self._drivers.any_unled and not self.damage.goes_on:
            mujoco.mj_step1(self._model, self._data)
            self._is_prepared = True

    def step(self) -> None:
        """Advance to the next tick. A row of the trace takes :meth:`state_row` before and :meth:`force_row` after."""
        drivers = self._drivers
        drivers.tick()
        if self.hands.empty:
            self.hands.move(self.tick, self._dt_s * self._substeps)
        for substep in range(self._substeps):
            if drivers.any_unled:
                drivers.advance(self._dt_s, self._felt())
                for row in drivers.newly_open():
                    self.open_hand(self._names[row])
            else:
                drivers.advance(self._dt_s)
            self._apply_efforts(substep)
            if self._is_prepared:
                self._is_prepared = False
                mujoco.mj_step2(self._model, self._data)
            else:
                mujoco.mj_step(self._model, self._data)
        if np.count_nonzero(self._warnings):
            self._fail()
        if self.hands.closing:
            self.hands.watch(self.tick, self._dt_s * self._substeps)
        self.tick += 1
        self.disturbances.settle(self.tick * self._substeps)
        if self.damage.goes_on:
            self.damage.settle(self.tick)

    def _felt(self) -> Felt:
        """What the drivers themselves feel."""
        q, qd = self._qpos, self._qvel
        return Felt(
            self._qfrc_bias[self._arm_dofs],
            q[self._arm_qpos],
            qd[self._arm_dofs],
            self._bases.places(q),
            self._bases.rates(qd),
        )

    def _fail(self) -> NoReturn:
        """Say which of MuJoCo's warnings came up: each is a number that is not finite, not sane, or not room enough."""
        kinds = [mujoco.mjtWarning(k).name for k in np.flatnonzero(self._data.warning.number)]
        raise PlantFailed(
            f"the simulated physics failed at {self.time_s:g} s ({', '.join(kinds)}): the scenario's load, gains or "
            "delays drive it out of range"
        )

    def _apply_efforts(self, substep: int = 0) -> None:
        applied, step = self._qfrc_applied, self.tick * self._substeps + substep
        self._torque, self._base_force = self._drivers.torque, self._drivers.base_force
        if self.damage.goes_on:
            self.damage.advance(step)
            self._torque, self._base_force = self.damage.deliver(self._torque, self._base_force)
        applied[self._arm_dofs] = self._torque
        self._bases.drive(applied, self._qpos, self._base_force)
        self._load_force[:] = self._pull_force
        lever = self._R_WO @ (self._pull_point - self._load_com)
        self._load_torque[:] = cross(lever.tolist(), self._pull_force.tolist())
        self.disturbances.apply(step)

    def state(self) -> Snapshot:
        """Everything that the ticks after this one depend on, between two ticks."""
        model, data = self._model, self._data
        integration = np.zeros(mujoco.mj_stateSize(model, INTEGRATION))
        mujoco.mj_getState(model, data, integration, INTEGRATION)
        return {
            "tick": self.tick,
            "seats": [[name, ids.strut] for name, ids in self.world.arms.items()],
            "met": [[name, ids.strut] for name, ids in self.met.items()],
            "hands": self.hands.state(),
            "integration": integration,
            "left_by_the_step": {name: getattr(data, name) for name in LEFT_BY_THE_STEP},
            "grasps": {name: getattr(model, name) for name in GRASPS},
            "drivers": self._drivers.state(),
            "noise": self._noise.state(),
            "told": np.array(self._told),
            "pull_point": self._pull_point,
            "torque": self._torque,
            "pull_force": self._pull_force,
            "disturbances": self.disturbances.state(),
            "damage": self.damage.state(),
        }

    def restore(self, saved: Snapshot) -> None:
        """Go on from there, number for number. For a plant of the same scenario that has not been stepped yet."""
        seats = {str(name): int(strut) for name, strut in saved["seats"]}
        if not all(0 <= strut < len(self.world.struts) for strut in seats.values()):
            raise SnapshotError(f"robots: got {seats}, expected a strut of this load for each")
        met = {str(name): int(strut) for name, strut in saved["met"]}
        if met.keys() != self.met.keys():  # robots have come since the start, and some may have gone again
            everybody = build_world(self.world.scenario, met)
            self.met |= everybody.arms
        if seats != {name: ids.strut for name, ids in self.world.arms.items()}:
            self.move_to(build_world(self.world.scenario, seats))
        self.hands.restore(saved["hands"])
        model, data = self._model, self._data
        integration = np.zeros(mujoco.mj_stateSize(model, INTEGRATION))
        fill(integration, saved["integration"])
        self.disturbances.restore(saved["disturbances"])
        self.damage.restore(saved["damage"], int(saved["tick"]))
        for name in GRASPS:  # after the bad grasps, which set theirs
            fill(getattr(model, name), saved["grasps"][name])
        mujoco.mj_setState(model, data, integration, INTEGRATION)
        for name in LEFT_BY_THE_STEP:
            fill(getattr(data, name), saved["left_by_the_step"][name])
        self._drivers.restore(saved["drivers"])
        self._torque = self._drivers.torque.copy()
        fill(self._torque, saved["torque"])
        self._noise.restore(saved["noise"])
        told = np.array(self._told)
        fill(told, saved["told"])
        self._told = list(told)
        self._pull_point = np.zeros(3)
        fill(self._pull_point, saved["pull_point"])
        self._pull_force = np.zeros(3)
        fill(self._pull_force, saved["pull_force"])
        self.tick = int(saved["tick"])

    def state_row(self) -> tuple[list[Array], Array]:
        """Positions and velocities of this tick: the load's, and the arms' [q, qd, base, base velocity], (N, 2n + 6).
        Take it before :meth:`step`."""
        load, data = self.load_pose(), self._data
        arms = np.hstack(
            [
                data.qpos[self._arm_qpos],
                data.qvel[self._arm_dofs],
                self._bases.places(data.qpos),
                self._bases.rates(data.qvel),
            ]
        )
        return [load.position, load.quat_wxyz, load.linear_velocity, load.angular_velocity], arms

    def force_row(self, before: tuple[list[Array], Array]) -> list[Array]:
        """The trace's row of the tick that was just stepped: ``before`` from :meth:`state_row`, and its forces."""
        load, arms = before
        joints, drivers = self._arm_dofs.shape[1], self._drivers
        rows = np.hstack(
            [
                arms[:, : 2 * joints],
                self._torque,
                self._data.sensordata[self._sensors],
                np.array(self._told),
                arms[:, 2 * joints :],
                self._base_force,
                grip_wrenches(self.world),
                self.disturbances.on_hands,
                drivers.age_ticks[:, None],
            ]
        )
        tick = self.tick - 1
        time = np.array([tick, tick * self._substeps * self._dt_s])
        return [time, *load, self._pull_force, self.disturbances.on_load, rows.ravel()]


def fair_shares(world: World) -> Array:
    """What of the load's weight each arm carries, (N,) N: level and at rest, and as equal as the struts allow."""
    weight = world.load_mass * -world.model.opt.gravity[2]
    held = np.array([world.struts[ids.strut].p[:2] for ids in world.arms.values()]) - world.load_com[:2]
    balance = np.vstack([np.ones(len(held)), held.T])
    shares: Array = np.linalg.lstsq(balance, np.array([weight, 0.0, 0.0]), rcond=None)[0]
    return shares


def _ignore(message: str) -> None:
    """MuJoCo's warnings are counted in its data and looked at there; by itself it would also write a log file into
    whatever folder the user is in."""


def _indices(slices: list[slice]) -> NDArray[np.intp]:
    """Slices of equal length as rows of indices, (N, length)."""
    return np.array([range(each.start, each.stop) for each in slices], dtype=np.intp)
