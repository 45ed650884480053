"""The simulated plant: MuJoCo steps, motor drivers before it, noisy sensors behind it.

Motor torques and base forces go into ``qfrc_applied``; the leader's pull into ``xfrc_applied`` of the load.
"""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim_server.grips import grip_wrenches
from sim_server.motor_driver import MotorDriver
from sim_server.plant import LoadPose, Reading
from sim_server.world import ArmIds, World
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]


class MujocoPlant:
    """A scenario's world, driven tick by tick. Implements :class:`sim_server.plant.Plant`.

    The arms start at rest with the torque that carries them and an equal share of the load's weight, as if their
    brakes had just been opened.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._model, self._data = world.model, world.data
        scenario = world.scenario
        self._substeps = scenario.clock.control_period_ms // scenario.plant.physics_step_ms
        self._dt_s = scenario.plant.physics_step_ms / 1000
        self._noise = scenario.plant
        self._rng = np.random.default_rng([scenario.seed, 1])
        limits = arm_limits(scenario.team.arm)
        base = scenario.base
        self._drivers = {
            name: MotorDriver(
                np.array(limits.torque_Nm),
                limits.torque_rate_Nm_s,
                np.array([base.force_max_N, base.force_max_N, base.torque_max_Nm]),
                self._static_torque(ids),
                scenario.plant.delay_ticks,
            )
            for name, ids in world.arms.items()
        }
        self._commands: dict[str, tuple[Array, Array]] = {}
        self._stiffness = {name: np.zeros(limits.joints) for name in world.arms}
        self._age = dict.fromkeys(world.arms, 0)
        self._pull_point = np.zeros(3)
        self._pull_force = np.zeros(3)
        self.tick = 0
        self._apply_efforts()
        mujoco.mj_forward(self._model, self._data)

    def _static_torque(self, ids: ArmIds) -> Array:
        """Torque that holds the arm and an equal share of the load's weight at the start, (n,) N m."""
        J = np.zeros((3, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, J, None, ids.tcp_site)
        share = self.world.load_mass * -self._model.opt.gravity[2] / len(self.world.arms)
        torque: Array = self._data.qfrc_bias[ids.arm_dof] + share * J[2, ids.arm_dof]
        return torque

    @property
    def time_s(self) -> float:
        """Simulated time of this tick."""
        return self.tick * self._substeps * self._dt_s

    def read(self) -> Mapping[str, Reading]:
        """Sensor readings of this tick. Call once per tick: the noise goes on."""
        data, noise, rng = self._data, self._noise, self._rng
        readings = {}
        for name, ids in self.world.arms.items():
            joints = self._drivers[name].torque.size
            drawn = rng.standard_normal(3 * joints + 6)
            wrench = np.concatenate([data.sensordata[ids.force_sensor], data.sensordata[ids.torque_sensor]])
            wrench[:3] += noise.wrench_noise_N * drawn[-6:-3]
            wrench[3:] += noise.wrench_noise_Nm * drawn[-3:]
            readings[name] = Reading(
                q=data.qpos[ids.arm_qpos] + noise.position_noise_rad * drawn[:joints],
                qd=data.qvel[ids.arm_dof] + noise.velocity_noise_rad_s * drawn[joints : 2 * joints],
                tau=self._drivers[name].torque + noise.torque_noise_Nm * drawn[2 * joints : 3 * joints],
                wrench=wrench,
            )
        return readings

    def load_pose(self) -> LoadPose:
        """Where the load is, without noise: for the leader and the record."""
        data, world = self._data, self.world
        pose, twist = data.qpos[world.load_qpos], data.qvel[world.load_dof]
        R_WO = np.zeros(9)
        mujoco.mju_quat2Mat(R_WO, pose[3:])
        return LoadPose(pose[:3].copy(), pose[3:].copy(), twist[:3].copy(), R_WO.reshape(3, 3) @ twist[3:])

    @property
    def points(self) -> dict[str, tuple[float, ...]]:
        """Named points of the load that can be pulled, (3,) m in O."""
        return {name: tuple(float(x) for x in point) for name, point in self.world.load_points.items()}

    def pull(self, point: str, force: Array) -> None:
        """The leader's force, (3,) N world, at a named point; held, and moving with the point, until the next one."""
        self._pull_point = np.array(self.points[point])
        self._pull_force = force

    def command(self, arm: str, torque: Array, base_force: Array, stiffness: Array) -> None:
        """This tick's command of one arm; ``stiffness`` is recorded only."""
        self._commands[arm] = torque, base_force
        self._stiffness[arm] = stiffness

    def lose(self, arm: str) -> None:
        """Nobody drives this arm any more: it goes limp."""
        self._drivers[arm].lose()
        self._stiffness[arm] = np.zeros_like(self._stiffness[arm])

    def regain(self, arm: str) -> None:
        """Somebody drives this arm again."""
        self._drivers[arm].regain()

    def step(self) -> None:
        """Advance to the next tick; a row of this tick can be taken before (:meth:`state_row`) and after
        (:meth:`force_row`)."""
        for name, driver in self._drivers.items():
            command = self._commands.get(name)
            driver.tick(command)
            self._age[name] = 0 if command is not None else self._age[name] + 1
        self._commands = {}
        for _ in range(self._substeps):
            for name, ids in self.world.arms.items():
                self._drivers[name].advance(self._dt_s, self._data.qfrc_bias[ids.arm_dof], self._data.qvel[ids.arm_dof])
            self._apply_efforts()
            mujoco.mj_step(self._model, self._data)
        self.tick += 1

    def _apply_efforts(self) -> None:
        data, world = self._data, self.world
        for name, ids in world.arms.items():
            driver = self._drivers[name]
            data.qfrc_applied[ids.arm_dof] = driver.torque
            x, y, turn = driver.base_force
            yaw = data.qpos[ids.base_qpos][2]
            c, s = np.cos(yaw), np.sin(yaw)
            data.qfrc_applied[ids.base_dof] = c * x - s * y, s * x + c * y, turn
        lever = data.xmat[world.load_body].reshape(3, 3) @ (self._pull_point - world.load_com)
        data.xfrc_applied[world.load_body, :3] = self._pull_force
        data.xfrc_applied[world.load_body, 3:] = np.cross(lever, self._pull_force)

    def state_row(self) -> dict[str, list[Array]]:
        """Positions and velocities of this tick, by owner: ``load`` and the arms. Take it before :meth:`step`."""
        load, data = self.load_pose(), self._data
        row = {"load": [load.position, load.quat_wxyz, load.linear_velocity, load.angular_velocity]}
        for name, ids in self.world.arms.items():
            row[name] = [
                data.qpos[ids.arm_qpos].copy(),
                data.qvel[ids.arm_dof].copy(),
                data.qpos[ids.base_qpos].copy(),
                data.qvel[ids.base_dof].copy(),
            ]
        return row

    def force_row(self, before: dict[str, list[Array]]) -> list[Array]:
        """The trace's row of the tick that was just stepped: ``before`` from :meth:`state_row`, and its forces."""
        row = [np.array([self.tick - 1.0]), np.array([(self.tick - 1) * self._substeps * self._dt_s])]
        row += [*before["load"], self._pull_force]
        for grip, (name, ids) in zip(grip_wrenches(self.world), self.world.arms.items(), strict=True):
            q, qd, base, base_velocity = before[name]
            driver = self._drivers[name]
            wrench = [self._data.sensordata[ids.force_sensor], self._data.sensordata[ids.torque_sensor]]
            row += [q, qd, driver.torque, *wrench, self._stiffness[name], base, base_velocity, driver.base_force, grip]
            row.append(np.array([float(self._age[name])]))
        return row
