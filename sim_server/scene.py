"""The world's bodies, written as a MuJoCo specification: floor, light, load, robots, grasps, sensors.

The one place where a model is specified; ``world.py`` says where everything stands and what its addresses are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sim_server.differences import JOINTS, ArmDifferences
from sim_server.layout import Array, Pose
from sim_server.loads import LoadBody
from sim_server.parts import MEETS, Colour, Part, Touch
from sim_server.robots import ACCENTS, R_SE, base_parts
from sim_server.scenario import Base, Scenario, arm_number
from wire.arms import arm_path

FINGERS = ("left_finger", "right_finger")
WELD_SOLREF = (0.004, 1.0)
WELD_SOLIMP = (0.98, 0.999, 0.001, 0.5, 2.0)
"""A stiff grasp: the weld gives by micrometres under a load's weight."""


def compile_scene(
    scenario: Scenario,
    load: LoadBody,
    X_WO: Pose,
    pedestal_m: float,
    differences: Mapping[str, ArmDifferences],
    seats: Mapping[str, int],
    fixed: Mapping[str, Pose],
    *,
    to_look_at: bool = False,
) -> Any:
    """Compiled model. The load stands at ``X_WO``; each arm of ``differences`` is welded to its strut (from 0).

    Robots whose bases are fixed stand there, at ``X_WB``; the others are still at the origin: write their joints into
    the data's ``qpos``, then :func:`refresh`.

    Args:
        to_look_at: with the shapes that are only seen.
    """
    spec = _scene(scenario)
    _add_load(spec, load, X_WO)
    for name, different in differences.items():
        accent = ACCENTS[arm_number(name) % len(ACCENTS)]
        _add_robot(spec, name, scenario.team.arm, scenario.base, pedestal_m, accent, different, fixed.get(name))
        _add_weld(spec, name, f"grasp{seats[name] + 1}")
    # Nine of ten geoms are for the eye only; the physics is the same to the bit.
    spec.compiler.discardvisual = not to_look_at
    return spec.compile()


def new_data(model: Any) -> Any:
    """Data for a model, all at its zero."""
    return mujoco.MjData(model)


def write_model(model: Any, path: Path) -> None:
    """A compiled model to a file, for another process of the same release."""
    mujoco.mj_saveModel(model, str(path), None)


def read_model(path: Path) -> Any:
    """A model that :func:`write_model` wrote."""
    return mujoco.MjModel.from_binary_path(str(path))


def refresh(model: Any, data: Any) -> None:
    """Everything that follows from positions, velocities and forces: nothing moves, nothing is integrated."""
    mujoco.mj_forward(model, data)


class BareStep:
    """MuJoCo's step alone, on a copy of a world's state: what a plant's step is measured against."""

    def __init__(self, model: Any) -> None:
        self._model, self._data = model, mujoco.MjData(model)

    def take(self, data: Any) -> None:
        """Begin from this state."""
        mujoco.mj_copyData(self._data, self._model, data)

    def step(self) -> None:
        """One physics step."""
        mujoco.mj_step(self._model, self._data)


def tool_pose(arm: str, q: Array) -> Pose:
    """Pose of the tool centre in the arm's own base frame, by the description."""
    return _tool_pose(arm, tuple(q.tolist()))


@cache
def _tool_pose(arm: str, q: tuple[float, ...]) -> Pose:
    model = mujoco.MjModel.from_xml_path(str(arm_path(arm)))
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    tcp = data.site("tcp")
    return Pose(tcp.xpos.copy(), tcp.xmat.reshape(3, 3).copy())


def _scene(scenario: Scenario) -> Any:
    spec = mujoco.MjSpec()
    spec.modelname = "palanquin"
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # never back to the start behind our back
    spec.option.timestep = scenario.plant.physics_step_ms / 1000
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_AUTO
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.35] * 3
    spec.visual.quality.shadowsize = 8192
    spec.visual.map.shadowclip, spec.visual.map.zfar = 6, 12  # smaller, larger: false shadows speckle the floor
    span = max(scenario.load.size_m)
    spec.stat.center, spec.stat.extent = [0, 0, 0.5], 1.5 + span
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.72, 0.78, 0.84],
        width=256,
        height=256,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.80, 0.81, 0.82],
        rgb2=[0.75, 0.76, 0.77],
        width=256,
        height=256,
    )
    textures = [""] * mujoco.mjtTextureRole.mjNTEXROLE
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    # Two squares to a repeat: squares of 1 m.
    spec.add_material(name="floor", textures=textures, texrepeat=[0.5, 0.5], texuniform=True, specular=0)
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[-1.4, -1, 4], dir=[0.35, 0.25, -1], diffuse=[0.5] * 3
    )
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="floor",
        contype=Touch.FLOOR,
        conaffinity=MEETS[Touch.FLOOR],
    )
    return spec


def _add_parts(body: Any, parts: list[Part]) -> None:
    """Shapes of a body: to be looked at and to be touched, without mass."""
    for part in parts:
        x, y, z = part.size
        box = part.shape == "box"
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX if box else mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[x / 2, y / 2, z / 2] if box else [x / 2, z / 2, 0],
            pos=part.X.p,
            quat=quat_wxyz(part.X.R),
            rgba=[*part.colour, 1],
            contype=part.touch,
            conaffinity=MEETS[part.touch],
            mass=0,
        )


def _add_load(spec: Any, load: LoadBody, X_WO: Pose) -> None:
    body = spec.worldbody.add_body(name="load", pos=X_WO.p, quat=quat_wxyz(X_WO.R))
    body.add_freejoint(name="load")
    I = load.inertia.I
    body.explicitinertial = True
    body.mass, body.ipos = load.inertia.mass, load.inertia.com
    body.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]
    _add_parts(body, load.parts)
    for k, X_OS in enumerate(load.struts, start=1):
        X_OE = X_OS.compose(Pose(np.zeros(3), R_SE))
        body.add_site(name=f"grasp{k}", pos=X_OE.p, quat=quat_wxyz(X_OE.R), group=4)


def _add_robot(
    spec: Any,
    name: str,
    arm: str,
    base: Base,
    pedestal: float,
    accent: Colour,
    differences: ArmDifferences,
    fixed_at: Pose | None,
) -> None:
    if fixed_at is not None:
        body = spec.worldbody.add_body(name=f"{name}/base", pos=fixed_at.p, quat=quat_wxyz(fixed_at.R))
    else:
        body = _add_rolling_base(spec, name, base)
    body.explicitinertial = True
    body.mass, body.ipos = base.mass_kg, [0, 0, 0.15]
    izz = base.yaw_inertia_kg_m2
    body.inertia = [0.6 * izz, 0.6 * izz, izz]  # roll and pitch do not move: any numbers that a body can have
    _add_parts(body, base_parts(pedestal, accent))

    child = mujoco.MjSpec.from_file(str(arm_path(arm)))
    _apply(child, differences)
    for finger in ("hand", *FINGERS):
        for geom in child.body(finger).geoms:
            if geom.group == 3:  # the description's collision boxes
                geom.contype, geom.conaffinity = Touch.HAND, MEETS[Touch.HAND]
    site = mujoco.mjtObj.mjOBJ_SITE
    child.add_sensor(name="wrist_force", type=mujoco.mjtSensor.mjSENS_FORCE, objtype=site, objname="wrist")
    child.add_sensor(name="wrist_torque", type=mujoco.mjtSensor.mjSENS_TORQUE, objtype=site, objname="wrist")
    spec.attach(child, prefix=f"{name}/", frame=body.add_frame(pos=[0, 0, pedestal]))


def _add_rolling_base(spec: Any, name: str, base: Base) -> Any:
    # The body stays at the world's origin, so that the slide axes are the world's and qpos is the base's pose.
    body = spec.worldbody.add_body(name=f"{name}/base")
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    rolling, turning = [base.rolling_resistance_Ns_m, 0, 0], [base.yaw_resistance_Nms_rad, 0, 0]
    body.add_joint(name=f"{name}/base_x", type=slide, axis=[1, 0, 0], damping=rolling)
    body.add_joint(name=f"{name}/base_y", type=slide, axis=[0, 1, 0], damping=rolling)
    body.add_joint(name=f"{name}/base_yaw", type=hinge, axis=[0, 0, 1], damping=turning)
    return body


def _apply(arm: Any, differences: ArmDifferences) -> None:
    """Make one arm's specification differ from its description."""
    groups = [(f"link{k}",) for k in range(1, JOINTS + 1)] + [("hand", *FINGERS)]
    for names, scale in zip(groups, differences.link_scale, strict=True):
        for name in names:
            body = arm.body(name)
            body.mass *= scale
            body.fullinertia *= scale
    for k in range(JOINTS):
        joint = arm.joint(f"joint{k + 1}")
        joint.damping = [differences.joint_damping[k], 0, 0]
        joint.frictionloss = differences.joint_friction[k]


def _add_weld(spec: Any, name: str, grasp: str) -> None:
    spec.add_equality(
        name=f"{name}/grasp",
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=f"{name}/tcp",
        name2=grasp,
        solref=WELD_SOLREF,
        solimp=WELD_SOLIMP,
    )


def locate(model: Any, data: Any) -> None:
    """Where all bodies and sites are at the present positions; forces and velocities are left as they were."""
    mujoco.mj_kinematics(model, data)


def site_jacobian(model: Any, data: Any, site: int) -> Array:
    """Jacobian of a site where :func:`locate` has put it, rows [v; w] in the world's axes, (6, nv)."""
    mujoco.mj_comPos(model, data)
    J = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], site)
    return J


def constraint_columns(model: Any, data: Any, dofs: slice) -> Array:
    """Columns of the constraint Jacobian at some degrees of freedom, (nefc, n).

    A product with a unit vector each: right for dense and sparse Jacobians, and as cheap for 16 arms as for one.
    """
    columns = np.zeros((dofs.stop - dofs.start, data.nefc))
    unit = np.zeros(model.nv)
    for k, dof in enumerate(range(dofs.start, dofs.stop)):
        unit[dof] = 1.0
        mujoco.mj_mulJacVec(model, data, columns[k], unit)
        unit[dof] = 0.0
    return columns.T


def dry_friction(data: Any, dofs: Sequence[int]) -> Array:
    """Forces of dry friction at these degrees of freedom in the last step, N or N m each; zeros where there is none."""
    is_friction = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
    return np.array([float(data.efc_force[is_friction & (data.efc_id == dof)].sum()) for dof in dofs])


def rotation(data: Any, site: int) -> Array:
    """The axes of a site in the world, (3, 3)."""
    R: Array = data.site_xmat[site].reshape(3, 3)
    return R


def quat_wxyz(R: Array) -> Array:
    """A rotation as a unit quaternion, w first, (4,)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(R).ravel())
    return quat


def rotation_of(quat_wxyz: Array) -> Array:
    """A unit quaternion, w first, as a rotation, (3, 3)."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, quat_wxyz)
    return R.reshape(3, 3)


def set_constants(model: Any) -> None:
    """Work out anew what follows from the model's masses and stays the same at all positions."""
    mujoco.mj_setConst(model, mujoco.MjData(model))
