"""The MuJoCo plant against laws of mechanics: energy, momentum, Newton and Euler."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from plants import NO_STIFFNESS, QUIET, plant_of, scenario

from sim_server.errors import PlantFailed
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario_files import load_scenario, shipped_names
from sim_server.unled_arms import Release
from sim_server.world import build_world
from wire.arms.limits import arm_limits

Array = NDArray[np.float64]


def rotation(quat_wxyz: Array) -> Array:
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat_wxyz)
    return R.reshape(3, 3)


def turn(yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def let_go(plant: MujocoPlant) -> None:
    plant.world.data.eq_active[:] = 0


# Energy


@cache
def energy_residual(step_ms: int) -> tuple[float, float]:
    """What is left over of the energy balance after 0.4 s of wild motion, and the work that was done in all, J.

    Every arm's motors and base swing at their own phase while the leader pulls at the table's front; torques change
    more slowly than the rate limit, so that what is commanded is what acts. Forces are those that this test commanded,
    damping constants those of the scenario; only positions, velocities and MuJoCo's own energy are read back.
    """
    given = scenario(
        step_ms=step_ms,
        load={"mass_kg": 20.0, "centre_of_mass_offset_m": (0.1, -0.05, 0.02)},
        plant={"joint_friction_Nm": 0.0, "joint_damping_Nms_rad": 0.5},
    )
    world = build_world(given)
    model, data = world.model, world.data
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    plant = MujocoPlant(world)
    mujoco.mj_forward(model, data)
    before = float(data.energy.sum())
    start = plant.read()
    held = {name: data.qfrc_applied[ids.arm_dof].copy() for name, ids in world.arms.items()}
    assert start.keys() == held.keys()

    h, pull = step_ms / 1000, np.array([30.0, 10.0, 0.0])
    resistance = np.array([given.base.rolling_resistance_Ns_m] * 2 + [given.base.yaw_resistance_Nms_rad])
    front = world.load_points["front"]
    balance = work = 0.0
    for k in range(round(0.4 / h)):
        t = k * h
        v_before, pose_before = data.qvel.copy(), data.qpos[world.load_qpos].copy()
        plant.pull("front", pull)
        forces = []
        for j, (name, ids) in enumerate(world.arms.items()):
            swing = np.sin(12.6 * t + np.arange(7) + j) * np.sin(7.9 * t) * [4, 4, 4, 4, 1, 1, 1]
            base = np.array([120 * np.sin(9 * t + j), 80 * np.cos(7 * t), 20 * np.sin(5 * t)])
            plant.command(name, held[name] + swing, base, NO_STIFFNESS)
            forces.append((ids, held[name] + swing, turn(data.qpos[ids.base_qpos][2]) @ base))
        plant.step()
        v = (v_before + data.qvel) / 2
        pose = data.qpos[world.load_qpos]
        parts = [pull @ (pose[:3] + rotation(pose[3:]) @ front - pose_before[:3] - rotation(pose_before[3:]) @ front)]
        for ids, motors, base_W in forces:
            q_dot, base_velocity = v[ids.arm_dof], v[ids.base_dof]
            parts += [
                h * motors @ q_dot,
                h * base_W @ base_velocity,
                -h * float(resistance @ base_velocity**2),
                -h * float(ids.differences.joint_damping @ q_dot**2),
            ]
        balance += sum(parts)
        work += float(np.abs(parts).sum())
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    return float(data.energy.sum()) - before - balance, work


def test_mechanical_energy_changes_by_the_work_of_motors_bases_and_leader_less_friction() -> None:
    """The integrator is of first order: positions move with the velocity at a step's end, work counts the one in its
    middle. So the balance is off by something proportional to the step, and extrapolated to step 0 it must close."""
    (coarse, _), (middle, _), (fine, work) = (energy_residual(step_ms) for step_ms in (4, 2, 1))
    assert work > 50.0
    assert abs(fine) < 1e-3 * work  # proportional to the step: here 0.04 %
    # First order: halving the step halves the error; what is left after extrapolating is second order, so smaller by
    # another factor of the step over the motion's own time (1 ms over some 30 ms).
    assert middle / fine == pytest.approx(2.0, abs=0.2)
    assert coarse / middle == pytest.approx(2.0, abs=0.4)
    assert abs(2 * fine - middle) < 1e-4 * work


# Bases


@pytest.mark.parametrize("quarter_turns", [0, 1, 2, 3])
def test_a_base_pushes_along_its_own_axes_whatever_its_heading(quarter_turns: int) -> None:
    """Nothing but the base's drive acts on a whole robot in the plane that lets go and rolls without resistance."""
    plant = plant_of(scenario(base={"rolling_resistance_Ns_m": 0.0, "yaw_resistance_Nms_rad": 0.0}))
    world, ids = plant.world, plant.world.arms["a1"]
    model, data = world.model, world.data
    let_go(plant)
    yaw = 0.3 + quarter_turns * np.pi / 2
    data.qpos[ids.base_qpos] = 5.0, 5.0, yaw
    mujoco.mj_forward(model, data)
    force = np.array([60.0, -25.0, 0.0])
    steps = 5
    for _ in range(steps):
        plant.command("a1", plant.read()["a1"].tau, force, NO_STIFFNESS)
        plant.step()
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    momentum = model.body_subtreemass[ids.base_body] * data.subtree_linvel[ids.base_body]
    # Exact where a step starts; positions then go on with the new velocities (first order), and the arms swing by some
    # 1e-4 rad in 5 ms. A wrong axis would be off by all of it.
    np.testing.assert_allclose(momentum[:2], 0.005 * (turn(yaw) @ force)[:2], rtol=0, atol=3e-4)


def test_a_bases_yaw_torque_turns_it_to_the_left() -> None:
    plant = plant_of(scenario(base={"rolling_resistance_Ns_m": 0.0, "yaw_resistance_Nms_rad": 0.0}))
    world, ids = plant.world, plant.world.arms["a1"]
    model, data = world.model, world.data
    let_go(plant)
    mujoco.mj_forward(model, data)
    for _ in range(5):
        plant.command("a1", plant.read()["a1"].tau, np.array([0.0, 0.0, 30.0]), NO_STIFFNESS)
        plant.step()
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    # About the robot's own centre of mass, on which nothing else acts. Tolerance: the integrator's, 5 ms old.
    assert data.subtree_angmom[ids.base_body][2] == pytest.approx(0.005 * 30.0, rel=1e-3)


def test_the_load_pushes_the_bases() -> None:
    """Nobody drives; the arms only hold their posture. The leader's pull reaches the bases through load and arms, and
    in the end all roll at the one speed at which their resistance takes up the pull."""
    given = scenario(plant={**QUIET, "joint_friction_Nm": 0.0})
    plant = plant_of(given)
    first = plant.read()
    plant.pull("centre", np.array([40.0, 0.0, 0.0]))
    for _ in range(1500):
        for name, sensed in plant.read().items():
            hold = 600.0 * np.subtract(first[name].q, sensed.q) - 40.0 * np.array(sensed.qd)
            plant.command(name, np.array(first[name].tau) + hold, np.zeros(3), NO_STIFFNESS)
        plant.step()
    data, world = plant.world.data, plant.world
    speed = 40.0 / (4 * given.base.rolling_resistance_Ns_m)
    for ids in world.arms.values():
        # 412 kg against 2400 N s/m: a time constant of 0.17 s, so 1e-4 of the start is left, and the arms still sway.
        assert data.qvel[ids.base_dof][0] == pytest.approx(speed, rel=0.02)
        assert abs(data.qvel[ids.base_dof][1]) < 0.02 * speed
    assert plant.load_pose().linear_velocity[0] == pytest.approx(speed, rel=0.02)


def test_a_bases_drive_is_bounded() -> None:
    pushed = []
    for force in (300.0, 1e6):
        plant = plant_of(scenario(base={"force_max_N": 300.0}))
        plant.command("a1", np.zeros(7), np.array([force, 0.0, 0.0]), NO_STIFFNESS)
        plant.step()
        pushed.append(plant.world.data.qvel.copy())
    np.testing.assert_array_equal(pushed[0], pushed[1])


# The leader's pull


def test_the_leaders_pull_moves_a_free_load_as_newton_and_euler_say() -> None:
    """A load that floats, turned, with its weight off the middle, pulled at its front from rest."""
    plant = plant_of(scenario(load={"mass_kg": 20.0, "centre_of_mass_offset_m": (0.15, -0.1, 0.05)}))
    world = plant.world
    model, data = world.model, world.data
    let_go(plant)
    model.opt.gravity[:] = 0
    quat = np.array([0.8, 0.1, -0.3, 0.5])
    quat /= np.linalg.norm(quat)
    data.qpos[world.load_qpos] = 7.0, -6.0, 3.0, *quat
    mujoco.mj_forward(model, data)
    R = rotation(quat)
    F = np.array([12.0, -30.0, 5.0])
    plant.pull("front", F)
    plant.step()
    h = 0.001
    # Named points and inertia as the table's geometry gives them: the rim at the struts' level, 45 mm under the top.
    lever = R @ (np.array([0.8, 0.0, 0.705]) - world.load_com)
    I_O = rotation(model.body_iquat[world.load_body])
    I = R @ I_O @ np.diag(model.body_inertia[world.load_body]) @ I_O.T @ R.T
    omega = h * np.linalg.solve(I, np.cross(lever, F))
    v_com = h * F / 20.0
    pose = plant.load_pose()
    # From rest one step is exact but for rounding (and the frame has turned by 1e-5 rad in it).
    np.testing.assert_allclose(pose.angular_velocity, omega, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(pose.linear_velocity, v_com - np.cross(omega, R @ world.load_com), rtol=1e-4, atol=1e-9)


def test_the_pull_stays_at_its_point_while_the_load_turns() -> None:
    """Angular momentum about the centre of mass grows by the moment of the point as it is now, not as it was."""
    plant = plant_of(scenario())
    world = plant.world
    let_go(plant)
    world.model.opt.gravity[:] = 0
    world.data.qpos[world.load_qpos] = 7.0, -6.0, 3.0, 1.0, 0.0, 0.0, 0.0
    world.data.qvel[world.load_dof] = 0, 0, 0, 0, 0, 3.0
    mujoco.mj_forward(world.model, world.data)
    F = np.array([40.0, 0.0, 0.0])
    plant.pull("front", F)

    def angular_momentum() -> Array:
        mujoco.mj_forward(world.model, world.data)
        mujoco.mj_subtreeVel(world.model, world.data)
        momentum: Array = world.data.subtree_angmom[world.load_body].copy()
        return momentum

    before, impulse = angular_momentum(), np.zeros(3)
    for _ in range(1000):
        lever = rotation(plant.load_pose().quat_wxyz) @ (np.array([0.8, 0.0, 0.705]) - world.load_com)
        impulse += 0.001 * np.cross(lever, F)
        plant.step()
    # A pull along the first lever, as it was at the start, has no moment about z.
    assert abs(impulse[2]) > 20.0
    # The integrator is of first order: 1 ms of a motion at 3 rad/s and more, 0.3 % of 25 N m s.
    np.testing.assert_allclose(angular_momentum() - before, impulse, rtol=0, atol=0.1)


# The start


@pytest.mark.parametrize("name", shipped_names())
def test_with_the_start_torques_held_a_shipped_scenarios_load_stays_where_it_is(name: str) -> None:
    plant = plant_of(load_scenario(name).scenario)
    limits = np.array(arm_limits("panda").torque_Nm)
    before = plant.load_pose()
    for _ in range(20):
        plant.step()
    after = plant.load_pose()
    # The grasps are stiff springs that give by micrometres under the weight; a fall of 20 ms would be 2 mm.
    np.testing.assert_allclose(after.position, before.position, rtol=0, atol=6e-6)
    np.testing.assert_allclose(after.quat_wxyz, before.quat_wxyz, rtol=0, atol=1e-6)
    assert (np.abs([each.tau for each in plant.read().values()]) < limits).all()


# The record


def test_positions_and_forces_of_a_row_belong_to_the_same_instant() -> None:
    """Newton's second law inside one row: weight, grips and pull make the acceleration to the next row's velocity."""
    plant = plant_of(scenario(plant={"joint_friction_Nm": 0.0}, load={"mass_kg": 20.0}))
    world = plant.world
    rng = np.random.default_rng(3)
    start = plant.read()
    momentum: list[Array] = []
    force: list[Array] = []
    pull = np.array([20.0, -15.0, 0.0])
    plant.pull("front", pull)
    for _ in range(40):
        for name in world.arms:
            plant.command(name, np.array(start[name].tau) + rng.normal(size=7), rng.normal(size=3) * 50, NO_STIFFNESS)
        before = plant.state_row()
        pose = plant.load_pose()
        r = rotation(pose.quat_wxyz) @ world.load_com
        momentum.append(20.0 * (pose.linear_velocity + np.cross(pose.angular_velocity, r)))
        plant.step()
        row = np.concatenate(plant.force_row(before))
        assert row[0] == plant.tick - 1
        np.testing.assert_array_equal(row[2:5], pose.position)
        arms = row[2 + 13 + 3 + 6 :].reshape(4, -1)
        force.append(arms[:, -13:-10].sum(axis=0) + pull + 20.0 * world.model.opt.gravity)
    change = np.diff(momentum, axis=0) / 0.001
    assert np.abs(change).max() > 10.0
    # Grips are forces at a step's start and the step is explicit in them; what differs is the centre of mass swinging
    # round O within one step, of order omega^2 r m = 1e-2 N, and the integrator's implicit damping (none on the load).
    np.testing.assert_allclose(np.array(force)[:-1], change, rtol=0, atol=0.05)


# Physics that blows up


def step_often(plant: MujocoPlant, ticks: int) -> None:
    for _ in range(ticks):
        plant.step()


def test_physics_out_of_range_says_so_and_does_not_go_back_to_the_start() -> None:
    plant = plant_of(scenario())
    plant.pull("front", np.array([1e14, 0.0, 0.0]))
    with pytest.raises(PlantFailed, match=r"the simulated physics failed at .* s \(mjWARN_"):
        step_often(plant, 100)
    position = plant.load_pose().position
    assert not np.allclose(position[:2], 0.0, atol=1e-6), "MuJoCo's own reset would have put it back to where it began"


def test_a_step_that_was_prepared_while_the_commands_were_on_their_way_is_the_same_step() -> None:
    """To the last bit. (Nobody pulls: the leader's lever is of the present attitude then, not of the one before.)"""
    plants = [plant_of(scenario(plant=QUIET)) for _ in range(2)]
    rng = np.random.default_rng(3)
    for _ in range(50):
        torque = plants[0]._drivers.torque + rng.normal(size=(4, 7))
        for prepared, plant in enumerate(plants):
            if prepared:
                plant.prepare()
            for row, name in enumerate(plant.names):
                plant.command(name, torque[row], np.array([30.0, -20.0, 1.0]), NO_STIFFNESS)
            plant.step()
    for name in ("qpos", "qvel", "sensordata", "efc_force"):
        np.testing.assert_array_equal(getattr(plants[0].world.data, name), getattr(plants[1].world.data, name), name)


def test_a_step_is_not_prepared_where_it_decides_itself_what_holds() -> None:
    """A hand that opens in the step itself holds no more in that very step."""
    plants = [plant_of(scenario(plant=QUIET)) for _ in range(2)]
    for prepared, plant in enumerate(plants):
        plant._leave_to("a1", Release())
        for _ in range(5):
            if prepared:
                plant.prepare()
            plant.step()
    np.testing.assert_array_equal(plants[0].world.data.qpos, plants[1].world.data.qpos)
