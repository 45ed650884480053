"""Physical faults: what they do by Newton's law, by MuJoCo's matrices or another plant; that they go on anywhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plants import NO_STIFFNESS, QUIET, plant_of, scenario
from test_happenings import Stage
from test_resume import drive

from sim_server.faults.added_mass import with_point_mass
from sim_server.faults.damage import SETTINGS, SHAPED
from sim_server.faults.grasps import GraspSlip
from sim_server.faults.physical import PhysicalEvent
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scene import set_constants
from sim_server.snapshot import pack, unpack
from sim_server.unled_arms import Brake
from sim_server.world import build_world

Array = NDArray[np.float64]

ARMS = ("a1", "a2", "a3", "a4")
WITHOUT_ARM = ("added_mass",)
KEYS: dict[str, dict[str, Any]] = {
    "joint_stuck": {"joint": 4},
    "torque_loss": {"joint": 2},
    "torque_saturation": {"joint": 2, "limit_Nm": 3.0},
    "sensor_bias": {"position_rad": 0.01, "wrench_N": 2.0},
    "sensor_noise": {"torque_Nm": 1.0},
    "sensor_dropout": {"channel": "q", "probability": 0.5},
    "sensor_frozen": {"channel": "qd"},
}


def fault(kind: str, **keys: Any) -> PhysicalEvent:
    whom = {} if kind in WITHOUT_ARM else {"arm": "a2"}
    event = SETTINGS[kind].model_validate({"kind": kind, "at_s": 0.0, **whom, **KEYS.get(kind, {}), **keys})
    assert isinstance(event, PhysicalEvent)
    return event


def quiet(count: int = 4, **plant: Any) -> MujocoPlant:
    """A plant whose sensors are exact, and whose joints have no dry friction of their own."""
    return plant_of(scenario(count, plant={**QUIET, "joint_friction_Nm": 0.0, **plant}))


def hold(plant: MujocoPlant, ticks: int, base: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
    """All arms go on with the torque that they had at the start; bases are pushed."""
    torques = {arm: np.array(reading.tau) for arm, reading in plant.read().items()}
    for _ in range(ticks):
        for arm, torque in torques.items():
            plant.command(arm, torque, base, NO_STIFFNESS)
        plant.step()


def words(plant: MujocoPlant) -> list[str]:
    return [seen.effect for seen in plant.damage.news]


# Mass on the load


def inertia(plant: MujocoPlant) -> tuple[Array, Array]:
    """Mass matrix and bias forces at rest, of everything, by MuJoCo."""
    model, data = plant.world.model, plant.world.data
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    for column, unit in zip(M, np.eye(model.nv), strict=True):
        mujoco.mj_mulM(model, data, column, unit)
    return M, data.qfrc_bias.copy()


@pytest.mark.parametrize("point", ["centre", "front", "left", "centre_of_mass"])
def test_mass_on_the_load_is_that_mass_at_that_point_in_the_equations_of_motion(point: str) -> None:
    """M + m J^T J and its weight m J^T g, with the Jacobian J of the point."""
    plant = quiet(2)
    world = plant.world
    M, bias = inertia(plant)
    place = world.load_com if point == "centre_of_mass" else world.load_points[point]  # type: ignore[index]
    J, data = np.zeros((3, world.model.nv)), world.data
    R_WO = data.xmat[world.load_body].reshape(3, 3)
    mujoco.mj_jac(world.model, data, J, None, data.xpos[world.load_body] + R_WO @ place, world.load_body)
    plant.damage.begin(fault("added_mass", mass_kg=7.0, point=point), 0, None)
    heavier, pulled = inertia(plant)
    np.testing.assert_allclose(heavier, M + 7.0 * J.T @ J, rtol=0, atol=1e-10)
    np.testing.assert_allclose(pulled, bias - 7.0 * J.T @ world.model.opt.gravity, rtol=0, atol=1e-10)


def test_two_masses_add_up_and_nothing_is_left_of_them_at_their_end() -> None:
    plant = quiet(2)
    before = {name: getattr(plant.world.model, name).copy() for name in (*SHAPED, "body_invweight0", "dof_M0")}
    plant.damage.begin(fault("added_mass", mass_kg=2.0, point="front"), 0, 5)
    plant.damage.begin(fault("added_mass", mass_kg=3.0, point="back"), 0, 8)
    hold(plant, 3)
    assert plant.world.model.body_mass[plant.world.load_body] == pytest.approx(25.0)
    hold(plant, 6)
    for name, numbers in before.items():
        np.testing.assert_array_equal(getattr(plant.world.model, name), numbers)
    front, back = (plant.world.load_points[name] - plant.world.load_com for name in ("front", "back"))
    off_mm = 1e3 * np.linalg.norm((2.0 * front + 3.0 * back) / 25.0)
    assert words(plant)[0] == f"the load weighs 25 kg, its centre of mass {off_mm:.3g} mm off"
    assert [text.partition(":")[0] for text in words(plant)[2:]] == ["it has ended", "it has ended"]


def test_what_follows_from_masses_is_the_same_bits_when_it_is_worked_out_anew() -> None:
    model = quiet(2).world.model
    names = [name for name in dir(model) if isinstance(getattr(model, name, None), np.ndarray)]
    before = {name: getattr(model, name).copy() for name in names}
    set_constants(model)
    assert len(names) > 200
    for name in names:
        np.testing.assert_array_equal(getattr(model, name), before[name], err_msg=name)


three = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).map(np.array)


@settings(deadline=None)
@given(st.floats(0.1, 50.0), three, st.floats(0.1, 50.0), three)
def test_two_point_masses_turn_about_their_common_middle(m: float, p: Array, added: float, at: Array) -> None:
    mass, com, I = with_point_mass(m, p, np.zeros((3, 3)), added, at)
    reduced, apart = m * added / (m + added), p - at
    np.testing.assert_allclose(mass * com, m * p + added * at, rtol=0, atol=1e-9)
    expected = reduced * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    np.testing.assert_allclose(I, expected, rtol=0, atol=1e-9)


# Joints and motors


def test_a_stuck_joint_stays_under_a_torque_that_swings_it_otherwise() -> None:
    moved = {}
    for stuck in (False, True):
        plant = quiet()
        plant.open_hand("a2")
        if stuck:
            plant.damage.begin(fault("joint_stuck", joint=4), 0, None)
        start = np.array(plant.read()["a2"].q)
        torque = np.array(plant.read()["a2"].tau)
        torque[3] += 30.0
        for _ in range(200):
            plant.command("a2", torque, (0.0,) * 3, NO_STIFFNESS)
            plant.step()
        moved[stuck] = np.abs(np.array(plant.read()["a2"].q) - start)
    assert moved[False][3] > 0.3
    assert moved[True][3] < 1e-5  # MuJoCo's dry friction creeps by some microradians per second
    assert moved[True][1] > 1e-3, "the others are free"
    assert "joint 4 stands at -2.1" in words(plant)[0]


def test_a_joint_that_moves_when_it_sticks_stops_within_milliseconds_and_is_free_again_at_the_end() -> None:
    plant = quiet()
    plant.open_hand("a2")
    hold(plant, 100)  # it has dropped its share of the load: the arm flies up
    assert abs(plant.read()["a2"].qd[3]) > 0.1
    plant.damage.begin(fault("joint_stuck", joint=4), plant.tick, plant.tick + 50)
    hold(plant, 5)
    assert abs(plant.read()["a2"].qd[3]) < 1e-3
    hold(plant, 100)
    assert abs(plant.read()["a2"].qd[3]) > 1e-2
    assert words(plant)[-1].startswith("it has ended: joint 4 stands at ")


@pytest.mark.parametrize(
    ("kind", "keys", "given_"),
    [
        ("torque_loss", {"factor": 0.25}, lambda tau: 0.25 * tau),
        ("torque_saturation", {"limit_Nm": 3.0}, lambda tau: np.clip(tau, -3.0, 3.0)),
    ],
)
def test_a_motor_gives_less_and_the_reading_says_what_it_gives(
    kind: str, keys: dict[str, float], given_: Callable[[Any], Any]
) -> None:
    plant, other = quiet(), quiet()
    plant.damage.begin(fault(kind, joint=2, **keys), 0, 40)
    for each in (plant, other):
        each.command("a2", np.full(7, 20.0), (0.0,) * 3, NO_STIFFNESS)
        before = each.state_row()
        each.step()
    ids = plant.world.arms["a2"]
    here, there = (each.world.data.qfrc_applied[ids.arm_dof] for each in (plant, other))
    expected = there.copy()
    expected[1] = given_(there[1])
    assert abs(expected[1] - there[1]) > 1.0
    np.testing.assert_array_equal(here, expected)
    np.testing.assert_array_equal(plant.read()["a2"].tau, expected)
    assert any(expected[1] in row for row in plant.force_row(before)), "and the trace"
    hold(plant, 60)
    assert words(plant)[1].startswith("it has ended: joint 2 lacked ")
    assert words(plant)[1].endswith("in 40 ticks")


# Bases


def test_slipping_wheels_give_the_base_a_part_of_the_drive() -> None:
    plant, other = quiet(), quiet()
    plant.damage.begin(fault("wheel_slip", factor=0.25), 0, None)
    hold(plant, 20, (80.0, -40.0, 4.0))
    hold(other, 20, (80.0, -40.0, 4.0))
    dof = plant.world.arms["a2"].base_dof
    here, there = (each.world.data.qfrc_applied[dof] for each in (plant, other))
    np.testing.assert_allclose(np.hypot(*here[:2]), 0.25 * np.hypot(80.0, 40.0), rtol=1e-12)
    np.testing.assert_allclose(here[2], 1.0)
    assert np.hypot(*there[:2]) == pytest.approx(np.hypot(80.0, 40.0))
    plant.damage.finish()
    assert words(plant)[-1] == "until the run's end: 67.1 N at most were lost, in 20 ticks"  # 0.75 of 89.4 N


@pytest.mark.parametrize(("force", "moves"), [(90.0, False), (400.0, True)])
def test_a_dragging_wheel_holds_the_base_up_to_its_friction(force: float, moves: bool) -> None:
    plant = quiet()
    plant.open_hand("a2")
    plant.damage.begin(fault("wheel_stuck", friction_N=250.0), 0, None)
    place = plant.world.arms["a2"].base_qpos
    start = plant.world.data.qpos[place].copy()
    hold(plant, 300, (force, 0.0, 0.0))
    way = float(np.hypot(*(plant.world.data.qpos[place] - start)[:2]))
    if moves:
        # 150 N are left, against 600 N s/m of rolling resistance: 0.25 m/s, which 100 kg reach within 0.17 s.
        assert way == pytest.approx(0.25 * (0.3 - 0.17), rel=0.5)
    else:
        assert way < 2e-3
    plant.damage.finish()
    held = float(words(plant)[-1].split(" with ")[1].split()[0])
    # Each axis has that friction, so the two together have up to 1.42 times as much; the arm, rid of its load, pushes.
    assert 250.0 <= held < 355.0 if moves else 85.0 < held < 250.0


def test_a_step_lifts_the_arms_foot_and_its_hand_by_its_height_and_lets_both_down_again() -> None:
    stepped, level = quiet(), quiet()
    stepped.damage.begin(fault("floor_step", height_mm=8.0, rise_s=0.1, for_s=0.4), 0, 400)
    ids = level.world.arms["a2"]
    rises = []
    for each in (stepped, level):
        each.open_hand("a2")
        each._drivers.leave_to(1, Brake())
    for ticks in (390, 120):
        foot, hand = [], []
        for each in (stepped, level):
            step(each, ticks)
            foot.append(each.world.data.xpos[ids.link0_body][2])
            hand.append(each.world.data.site_xpos[ids.tcp_site][2])
        rises.append((foot[0] - foot[1], hand[0] - hand[1]))
    assert rises[0][0] == pytest.approx(8e-3, abs=1e-9)
    assert rises[0][1] == pytest.approx(8e-3, abs=1e-5)  # the base's brakes give by micrometres, the joints' by nothing
    assert rises[1] == pytest.approx((0.0, 0.0), abs=1e-5)
    first, last = words(stepped)
    assert first.startswith("the arm's foot stood 7.9"), "it is told as soon as it is there but for one per cent"
    assert last == "it has ended: the arm's foot stood 8 mm higher"


def test_the_corner_of_a_carried_load_feels_a_step() -> None:
    plant, level = quiet(), quiet()
    plant.damage.begin(fault("floor_step", height_mm=10.0), 0, None)
    for each in (plant, level):
        for row in range(4):
            each._drivers.leave_to(row, Brake())
        step(each, 400)
    site = plant.world.arms["a2"].grasp_site
    rise = plant.world.data.site_xpos[site][2] - level.world.data.site_xpos[site][2]
    assert 2e-3 < rise < 10e-3


def step(plant: MujocoPlant, ticks: int) -> None:
    for _ in range(ticks):
        plant.step()


# Sensors


def readings(event: PhysicalEvent, ticks: int, **plant: Any) -> tuple[Array, Array, list[str]]:
    """What the sensors of a2 say with the fault and without it, (ticks, 27), and what has been seen."""
    here, there = quiet(**plant), quiet(**plant)
    here.damage.begin(event, 0, None)
    rows: list[list[Any]] = [[], []]
    for _ in range(ticks):
        for each, book in ((here, rows[0]), (there, rows[1])):
            all_ = each.read()
            one = all_["a2"]
            book.append([*one.q, *one.qd, *one.tau, *one.wrench])
            each.step()
            if each is here:
                others = [all_[arm] for arm in ARMS if arm != "a2"]
            else:
                assert others == [all_[arm] for arm in ARMS if arm != "a2"], "nobody else feels it"
    here.damage.finish()
    return np.array(rows[0]), np.array(rows[1]), words(here)


def test_a_bias_is_that_much_on_one_joint_or_on_all() -> None:
    sizes = {"position_rad": 0.01, "velocity_rad_s": 0.2, "torque_Nm": -3.0, "wrench_N": 4.0, "wrench_Nm": 0.5}
    with_, without, told = readings(fault("sensor_bias", **sizes), 5)
    expected = np.repeat([0.01, 0.2, -3.0, 4.0, 0.5], [7, 7, 7, 3, 3])
    np.testing.assert_allclose(with_ - without, np.tile(expected, (5, 1)), rtol=0, atol=1e-12)
    assert told[-1] == (
        "until the run's end: readings of 5 ticks were off, by 0.01 rad, 0.2 rad/s, 3 N m, 4 N, 0.5 N m at the wrist "
        "at most"
    )
    with_, without, _ = readings(fault("sensor_bias", joint=3, wrench_N=0.0), 2)
    np.testing.assert_allclose((with_ - without)[0], np.eye(27)[2] * 0.01, rtol=0, atol=1e-12)


def test_noise_has_its_deviation_and_is_drawn_anew_in_every_tick() -> None:
    with_, without, _ = readings(fault("sensor_noise", torque_Nm=2.0), 300)
    noise = with_ - without
    np.testing.assert_array_equal(np.delete(noise, np.s_[14:21], axis=1), np.zeros((300, 20)))
    assert noise[:, 14:21].std() == pytest.approx(2.0, rel=0.06)  # 2100 draws: 1.5 per cent, one deviation
    assert np.unique(noise[:, 14:21]).size == 2100


def test_a_dropout_reads_zero_as_often_as_told_and_a_frozen_sensor_what_it_read() -> None:
    with_, without, told = readings(fault("sensor_dropout", channel="q", joint=2, probability=0.3), 300)
    gone = with_[:, 1] == 0.0
    assert 60 < gone.sum() < 120  # 90 with a deviation of 8
    assert f"readings of {gone.sum()} ticks" in told[-1]
    np.testing.assert_array_equal(with_[~gone], without[~gone])
    with_, without, _ = readings(fault("sensor_frozen", channel="tau"), 50, torque_noise_Nm=0.05)
    assert (with_[:, 14:21] == with_[0, 14:21]).all()
    assert (without[1:, 14:21] != without[0, 14:21]).all()
    np.testing.assert_array_equal(np.delete(with_, np.s_[14:21], axis=1), np.delete(without, np.s_[14:21], axis=1))


def test_a_dead_wrist_feels_nothing() -> None:
    with_, without, told = readings(fault("wrist_dead"), 5)
    assert not with_[:, 21:].any()
    np.testing.assert_array_equal(with_[:, :21], without[:, :21])
    most = np.abs(without[:, 21:24]).max()
    assert f"by {most:.3g} N" in told[-1]


# Wherever a run goes on


def test_two_plants_of_one_state_go_on_equally_with_every_fault_in_flight() -> None:
    given_ = scenario(4, plant={"delay_ticks": 2})
    plant, other = plant_of(given_), plant_of(given_)
    drive(plant, 20, ARMS)
    for number, kind in enumerate(SETTINGS):
        keys = {} if kind in WITHOUT_ARM else {"arm": ARMS[number % 4]}
        plant.damage.begin(fault(kind, **keys), plant.tick, plant.tick + 60 + number)
    drive(plant, 30, ARMS)
    saved = pack(plant.state())
    other.restore(unpack(saved))
    assert pack(other.state()) == saved
    np.testing.assert_array_equal(drive(plant, 200, ARMS), drive(other, 200, ARMS))
    assert pack(plant.state()) == pack(other.state())
    assert plant.damage.news == other.damage.news
    ended = [seen for seen in plant.damage.news if seen.effect.startswith("it has ended")]
    assert {seen.event.kind for seen in ended} == SETTINGS.keys() - {"floor_step"}, "that one has no time of its own"
    assert all(seen.proves for seen in ended)


def test_faults_go_on_in_a_world_with_another_robot_and_end_with_their_own() -> None:
    plant = plant_of(scenario(2, load={"struts": 4}, team={"count": 2}))
    plant.damage.begin(fault("added_mass", mass_kg=4.0), 0, None)
    plant.damage.begin(fault("torque_loss", joint=2), 0, None)
    plant.damage.begin(fault("joint_stuck", joint=4), 0, None)
    step(plant, 5)
    plant.move_to(build_world(plant.world.scenario, {"a1": 0, "a2": 1, "a3": 2}))
    model, ids = plant.world.model, plant.world.arms["a2"]
    assert model.body_mass[plant.world.load_body] == pytest.approx(24.0)
    assert model.dof_frictionloss[ids.arm_dof.start + 3] == 1000.0
    plant.step()
    np.testing.assert_allclose(plant._torque[1, 1], 0.5 * plant._drivers.torque[1, 1])
    plant.damage.news.clear()
    plant.move_to(build_world(plant.world.scenario, {"a1": 0, "a3": 2}))
    assert [(seen.event.kind, seen.effect.partition(":")[0]) for seen in plant.damage.news] == [
        ("torque_loss", "its robot has been taken away"),
        ("joint_stuck", "its robot has been taken away"),
    ]
    assert plant.world.model.dof_frictionloss.max() < 1.0
    step(plant, 2)
    assert plant.world.model.body_mass[plant.world.load_body] == pytest.approx(24.0)


# Events


def test_a_physical_fault_is_ordered_at_its_tick_and_only_what_proves_it_counts() -> None:
    one, two = fault("wrist_dead", arm="a1", at_s=0.002, for_s=0.003), fault("wrist_dead", at_s=0.003)
    stage = Stage(one, two)
    stage.run(5)
    assert stage.reported("ordered") == [("wrist_dead", "a1"), ("wrist_dead", "a2")]
    assert [each["effect"] for each in stage.bench.reported("seen")] == ["from 2 to 5", "from 3 to None"]
    assert stage.happenings.proofs.missing() == ["event 'wrist_dead' of a1 at 0.002 s was not seen to take effect"]


def test_a_grasp_that_slips_is_seen_when_the_hand_holds_nothing() -> None:
    stage = Stage(GraspSlip(kind="grasp_slip", at_s=0.002, arm="a1"))
    stage.run(4)
    assert stage.hands.book == [("open", "a1")]
    assert stage.reported("seen") == [], "the hand still holds"
    assert stage.happenings.proofs.missing() == ["event 'grasp_slip' of a1 at 0.002 s was not seen to take effect"]
    stage.hands.hands.empty.add("a1")
    stage.run(1)
    assert stage.reported("seen") == [("grasp_slip", "a1")]
    assert stage.happenings.proofs.missing() == []
