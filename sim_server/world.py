"""The world of a scenario: who stands where at the start, and the addresses of everything in the MuJoCo model.

Every name of arm ``a1`` begins with ``a1/``: body ``a1/base``, joints ``a1/base_x``, ``a1/base_y``, ``a1/base_yaw``,
``a1/joint1`` to ``a1/joint7``, sites ``a1/tcp`` and ``a1/wrist``, sensors ``a1/wrist_force`` and ``a1/wrist_torque``,
weld ``a1/grasp``. The load is body ``load`` with joint ``load`` and, at strut k - 1, site ``grasp<k>`` (k from 1),
oriented as the tool that grasps there.

There are no actuators: motor torques and base forces go to ``data.qfrc_applied`` at the addresses given here, and the
motor driver before it keeps the limits.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim_server.differences import JOINTS, ArmDifferences, draw_differences
from sim_server.layout import Array, Pose, base_poses, strut_level_m
from sim_server.loads import load_body
from sim_server.robots import R_SE, home, pedestal_height_m
from sim_server.scenario import LoadPoint, Scenario, arm_number
from sim_server.scene import compile_scene, new_data, refresh, tool_pose
from sim_server.start import displaced_base, displaced_load, reach_struts


@dataclass(frozen=True, eq=False)
class ArmIds:
    """Addresses of one robot in the model. The slices give views, for reading and for writing.

    Attributes:
        name: ``a1`` ...
        strut: number of the strut it holds, or is to take, from 0; its site is ``grasp_site``.
        base_qpos, base_dof: x, y [m], yaw [rad] of the base in the world: ``data.qpos[base_qpos]`` is the base's pose.
            Nothing for a base that is fixed: ask :mod:`sim_server.bases`.
        fixed_at: x, y, yaw of a base that is fixed, (3,); None for one that rolls.
        arm_qpos, arm_dof: the 7 joints of the arm. Motor torque: ``data.qfrc_applied[arm_dof]``.
        force_sensor, torque_sensor: 3 numbers each in ``data.sensordata``: what the arm's flange exerts on the hand
            (and so on all that the hand holds), at the wrist, in the wrist's axes [N], [N m].
        wrist_site, tcp_site, grasp_site: site numbers; the last is on the load.
        weld: number of the equality constraint: ``data.eq_active[weld]``.
        base_body, link0_body, hand_body: body numbers; ``link0_body``'s frame is the arm's own base frame.
        torque_limit: (7,) [N m]; velocity_limit: (7,) [rad/s]; position_limit: (7, 2) [rad].
        differences: what was changed against the arm's description.
    """

    name: str
    strut: int
    base_qpos: slice
    base_dof: slice
    fixed_at: Array | None
    arm_qpos: slice
    arm_dof: slice
    force_sensor: slice
    torque_sensor: slice
    wrist_site: int
    tcp_site: int
    grasp_site: int
    weld: int
    base_body: int
    link0_body: int
    hand_body: int
    torque_limit: Array
    velocity_limit: Array
    position_limit: Array
    differences: ArmDifferences


@dataclass(frozen=True, eq=False)
class World:
    """A scenario's world at tick 0.

    Attributes:
        scenario: what it was built from.
        model, data: MuJoCo's; ``data`` is at the start, forward kinematics and dynamics done, all velocities zero.
        arms: by name, in the order of ``scenario.arms``.
        load_body: body number of the load.
        load_qpos: 7 numbers in ``data.qpos``: position of O in the world [m] and ``quat_wxyz``.
        load_dof: 6 numbers in ``data.qvel``: velocity of O in the world's axes [m/s], angular velocity in O's
            axes [rad/s].
        load_points: named points (3,) [m] in O, on the rim at the struts' level; ``centre`` above O.
        X_WO_start: pose of the load at the start.
        load_com: centre of mass (3,) [m] in O; load_mass [kg].
        struts: poses ``X_OS`` of all struts, held or free.
        q_home: joint positions (7,) [rad] at the start.
        X_AE: pose of the tool centre in the arm's own base frame then; the hand points straight down.
        X_BS: pose of the strut in the base of the robot that holds it then.
        pedestal_m: height of the arms' foot above the floor.
    """

    scenario: Scenario
    model: Any
    data: Any
    arms: dict[str, ArmIds]
    load_body: int
    load_qpos: slice
    load_dof: slice
    load_points: dict[LoadPoint, Array]
    load_mass: float
    load_com: Array
    X_WO_start: Pose
    struts: list[Pose]
    q_home: Array
    X_AE: Pose
    X_BS: Pose
    pedestal_m: float


def build_world(scenario: Scenario, seats: Mapping[str, int] | None = None, *, to_look_at: bool = False) -> World:
    """The scenario's world, every robot in its starting posture with its hand closed on its strut.

    Args:
        scenario: what it is built from.
        seats: the arms that are in it, each with its strut (from 0); by default the scenario's team.
        to_look_at: with the shapes that are only seen.

    Raises ``LayoutError`` when load and robots do not fit, ``NoHome`` or ``wire.arms.UnknownArm`` for an arm that is
    not known. The same scenario gives the same world, number for number.
    """
    if seats is None:
        seats = {name: strut for strut, name in enumerate(scenario.arms)}
    arm = scenario.team.arm
    q_home = home(arm)
    load = load_body(scenario.load)
    X_AE = tool_pose(arm, q_home)
    level = strut_level_m(scenario.load)
    pedestal = pedestal_height_m(level, float(X_AE.p[2]))
    X_BS = Pose.planar(0, 0, pedestal).compose(X_AE).compose(Pose(np.zeros(3), R_SE.T))
    X_WO = displaced_load(scenario, Pose.planar(0, 0, float(X_BS.p[2]) - level))
    X_OB = base_poses(scenario.load, X_BS)
    bases = {name: displaced_base(scenario, name, X_WO.compose(X_OB[strut])) for name, strut in seats.items()}

    differences = {name: draw_differences(scenario.plant, scenario.seed, arm_number(name)) for name in seats}
    fixed = bases if scenario.base.fixed else {}
    model = compile_scene(scenario, load, X_WO, pedestal, differences, seats, fixed, to_look_at=to_look_at)
    data = new_data(model)
    arms = {name: _arm_ids(model, name, strut, differences[name], fixed.get(name)) for name, strut in seats.items()}
    for ids in arms.values():
        if ids.fixed_at is None:
            data.qpos[ids.base_qpos] = planar(bases[ids.name])
        data.qpos[ids.arm_qpos] = q_home
    if scenario.plant.start_offset_m or scenario.plant.start_yaw_rad:
        reach_struts(model, data, ((ids.tcp_site, ids.grasp_site, ids.arm_qpos, ids.arm_dof) for ids in arms.values()))
    refresh(model, data)
    joint = model.joint("load")
    return World(
        scenario=scenario,
        model=model,
        data=data,
        arms=arms,
        load_body=model.body("load").id,
        load_qpos=_run(joint.qposadr[0], 7),
        load_dof=_run(joint.dofadr[0], 6),
        load_points=load.points,
        load_mass=load.inertia.mass,
        load_com=load.inertia.com,
        X_WO_start=X_WO,
        struts=load.struts,
        q_home=q_home,
        X_AE=X_AE,
        X_BS=X_BS,
        pedestal_m=pedestal,
    )


def with_robots(world: World, seats: Mapping[str, int], model: Any) -> Generator[None, None, World]:
    """The same load among other robots, in small steps between which time may pass: the world is this generator's
    return value. Its ``data`` is at the load's start, and all robots at the origin.

    Args:
        world: what there is; stays as it is.
        seats: the arms of the new world, each with its strut (from 0).
        model: the compiled model of just these.
    """
    data = new_data(model)
    yield
    arms = {}
    for name, strut in seats.items():
        arms[name] = _arm_ids(
            model, name, strut, draw_differences(world.scenario.plant, world.scenario.seed, arm_number(name))
        )
        yield
    joint = model.joint("load")
    return replace(
        world,
        model=model,
        data=data,
        arms=arms,
        load_body=model.body("load").id,
        load_qpos=_run(joint.qposadr[0], 7),
        load_dof=_run(joint.dofadr[0], 6),
    )


def planar(X_WB: Pose) -> Array:
    """x, y, yaw of a base, (3,)."""
    return np.array([X_WB.p[0], X_WB.p[1], X_WB.yaw])


def _arm_ids(model: Any, name: str, strut: int, differences: ArmDifferences, fixed_at: Pose | None = None) -> ArmIds:
    first = model.joint(f"{name}/joint1")
    base = None if fixed_at else model.joint(f"{name}/base_x")
    joints = [model.joint(f"{name}/joint{k}").id for k in range(1, JOINTS + 1)]
    force, torque = model.sensor(f"{name}/wrist_force"), model.sensor(f"{name}/wrist_torque")
    return ArmIds(
        name=name,
        strut=strut,
        base_qpos=slice(0, 0) if base is None else _run(base.qposadr[0], 3),
        base_dof=slice(0, 0) if base is None else _run(base.dofadr[0], 3),
        fixed_at=None if fixed_at is None else planar(fixed_at),
        arm_qpos=_run(first.qposadr[0], JOINTS),
        arm_dof=_run(first.dofadr[0], JOINTS),
        force_sensor=_run(force.adr[0], 3),
        torque_sensor=_run(torque.adr[0], 3),
        wrist_site=model.site(f"{name}/wrist").id,
        tcp_site=model.site(f"{name}/tcp").id,
        grasp_site=model.site(f"grasp{strut + 1}").id,
        weld=model.equality(f"{name}/grasp").id,
        base_body=model.body(f"{name}/base").id,
        link0_body=model.body(f"{name}/link0").id,
        hand_body=model.body(f"{name}/hand").id,
        torque_limit=model.jnt_actfrcrange[joints, 1].copy(),
        velocity_limit=model.numeric(f"{name}/velocity_limit").data.copy(),
        position_limit=model.jnt_range[joints].copy(),
        differences=differences,
    )


def _run(start: int, count: int) -> slice:
    return slice(int(start), int(start) + count)
