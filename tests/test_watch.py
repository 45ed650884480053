"""The dashboard without a terminal: what is seen of a run, and that every panel is true and fits."""

from __future__ import annotations

import io
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import QUIET, plant_of, scenario
from recorded import rows_of, trace_of
from rich.console import Console
from rich.text import Text
from watched import event, progress, row, tilted

from deploy.see.watch.arrangement import dashboard
from deploy.see.watch.canvas import ASCII, FANCY, Canvas, Glyphs
from deploy.see.watch.panels import arms_table, bar, event_list, head, number, steps, tilt_gauge
from deploy.see.watch.rows import UnreadableRow, joints_of, read_row, read_ways, share_percent
from deploy.see.watch.screens import glyphs_for
from deploy.see.watch.seen import MOST_PLACES, Seen, look
from deploy.see.watch.top_view import Told, Window, top_view, window_of
from deploy.see.watch.watching import exit_status, last_sentence
from sim_server.metrics import tilt_deg
from sim_server.tally import Tallies
from sim_server.truth import TruthFeed
from wire.codec import decode
from wire.keys import Keys
from wire.memory import Broker
from wire.messages import Row

NAN = math.nan
TOLD = Told((1.6, 0.9), (2.0, 0.0))


def plain(lines: list[Text]) -> list[str]:
    return [line.plain for line in lines]


def carried(arms: int = 4, looks: int = 3) -> Seen:
    """A run on its way: everybody in, the load a little further with every look."""
    joined = [event("joined", agent=f"a{k + 1}", lease=1) for k in range(arms)]
    seen = look(Seen("demo"), events=[*joined, event("joined", agent="leader", lease=1), event("started")])
    for k in range(looks):
        values = {"load.position": (0.1 * k, 0.0, 0.8), "load.quat_wxyz": tilted(0.2 * k)}
        seen = look(seen, [row(100 * k, arms, values=values)], [], [progress(100 * k)])
    return seen


# What a row says


def test_a_row_that_the_simulator_tells_is_read_as_its_trace_has_it() -> None:
    plant = plant_of(scenario(plant=QUIET))
    bus, heard = Broker(), list[Row]()
    bus.link().subscribe(Keys("seen").rows, lambda payload: heard.append(decode(payload, Row)))
    feed = TruthFeed(bus.link(), Keys("seen"), Tallies())
    rows = rows_of(plant, 100)
    for each in rows:
        feed.row(each, 900_000, plant.world.arms)
    feed.close()
    trace = trace_of(plant, rows)
    for k, told in enumerate(heard):
        load, arms = read_row(told)
        np.testing.assert_array_equal(load.p_WO, trace["load.position"][k])
        np.testing.assert_array_equal(load.tilt_deg, tilt_deg(trace["load.quat_wxyz"][k : k + 1])[0])
        assert list(arms) == list(plant.world.arms)
        for name, arm in arms.items():
            np.testing.assert_array_equal((arm.x_m, arm.y_m, arm.yaw_rad), trace[f"{name}.base"][k])
            assert arm.up_N == trace[f"{name}.grip"][k, 2]
            assert arm.age_ticks == trace[f"{name}.age_ticks"][k]
    assert len(heard) == len(rows) == 20
    p_WO, tilts_deg = read_ways(heard)
    np.testing.assert_array_equal(p_WO, trace["load.position"])
    np.testing.assert_array_equal(tilts_deg, tilt_deg(trace["load.quat_wxyz"]))


@given(arms=st.integers(1, 16), joints=st.integers(1, 16))
def test_how_many_joints_an_arm_has_follows_from_the_length_of_a_row(arms: int, joints: int) -> None:
    assert joints_of(row(arms=arms, joints=joints)) == joints


@pytest.mark.parametrize("missing", [8, 3, 8 * 41, 10_000])
def test_a_row_of_no_whole_number_of_joints_is_counted_and_changes_nothing(missing: int) -> None:
    good = row(arms=2, joints=7)
    short = Row(5, 1, good.arms, good.struts, good.values[:-missing] if missing < len(good.values) else b"")
    with pytest.raises(UnreadableRow, match=r"row of tick 5: got .* bytes of 2 arms, expected"):
        read_row(short)
    before = carried(2)
    assert look(before, [short]) == replace(before, refused=1)


def test_without_any_arm_a_row_still_has_the_load() -> None:
    load, arms = read_row(row(arms=0))
    assert load.p_WO == (0.0, 0.0, 0.8)
    assert arms == {}


@given(st.lists(st.floats(0.1, 500), min_size=1, max_size=16))
def test_the_shares_of_all_hands_are_the_whole(up_N: list[float]) -> None:
    told = row(arms=len(up_N), values={f"a{k + 1}.grip": (0, 0, x, 0, 0, 0) for k, x in enumerate(up_N)})
    shares = share_percent(read_row(told)[1])
    assert sum(shares.values()) == pytest.approx(100)
    assert shares["a1"] == pytest.approx(100 * up_N[0] / sum(up_N))


def test_a_hand_that_is_not_there_has_no_share_and_takes_nothing_from_the_others() -> None:
    shares = share_percent(read_row(row(arms=3, values={"a2.grip": NAN}))[1])
    assert shares["a1"] == shares["a3"] == 50.0
    assert math.isnan(shares["a2"])
    assert all(
        math.isnan(x) for x in share_percent(read_row(row(arms=2, values={"a1.grip": 0, "a2.grip": 0}))[1]).values()
    )


# What is known after a look


def test_an_agents_state_follows_its_events() -> None:
    seen = look(Seen("demo"), progress=[progress(phase="waiting", waiting_for="a1, a2, leader")])
    assert {seen.state_of(name) for name in ("a1", "a2", "leader")} == {"awaited"}
    told = {
        "joined": "in",
        "leaving": "leaving",
        "left": "left",
        "lost": "lost",
    }
    for kind, state in told.items():
        seen = look(seen, events=[event(kind, agent="a2")])
        assert seen.state_of("a2") == state
    assert seen.arm_names == ["a1", "a2"]


def test_who_is_in_is_not_awaited_again_by_a_report_that_was_late() -> None:
    seen = look(Seen("demo"), events=[event("joined", agent="a1")])
    seen = look(seen, progress=[progress(phase="waiting", waiting_for="a1, a2")])
    assert (seen.state_of("a1"), seen.state_of("a2")) == ("in", "awaited")


def test_an_observer_that_comes_late_knows_who_is_there_and_claims_no_more() -> None:
    seen = look(Seen("demo"), [row(arms=2)])
    assert seen.state_of("a1") == "there"
    assert look(seen, events=[event("lost", agent="a1")]).state_of("a1") == "lost"
    assert seen.state_of("a7") == ""


def test_after_a_simulator_was_killed_and_went_on_those_who_were_in_are_awaited() -> None:
    seen = look(carried(3), events=[event("lost", 50, agent="a2"), event("resumed", 40, at="checkpoint")])
    assert [seen.state_of(name) for name in ("a1", "a2", "a3")] == ["awaited", "lost", "awaited"]
    assert seen.tick == 40
    assert look(seen, events=[event("joined", 40, agent="a1")]).state_of("a1") == "in"


def test_the_most_tilt_is_that_of_every_row_and_not_only_of_the_last_of_a_look() -> None:
    tilts = (0.5, 2.5, 1.0)
    rows = [row(k, values={"load.quat_wxyz": tilted(tilt)}) for k, tilt in enumerate(tilts)]
    seen = look(Seen("demo"), rows)
    assert seen.tilt_max_deg == pytest.approx(2.5)
    np.testing.assert_allclose(seen.tilts_deg, [2.5])
    assert seen.load is not None
    assert seen.load.tilt_deg == pytest.approx(1.0)


def test_numbers_that_are_none_harm_nothing() -> None:
    empty = {"load.position": NAN, "load.quat_wxyz": NAN, "a1.base": NAN, "a1.grip": NAN, "a1.age_ticks": NAN}
    seen = look(carried(2), [row(arms=2, values={**empty, "a1.stiffness": NAN, "leader.force": NAN})])
    assert math.isfinite(seen.tilt_max_deg)
    assert seen.path_m == carried(2).path_m
    said = "\n".join(plain(dashboard(seen, 80, 24, FANCY, TOLD)))
    assert "nan" not in said.lower()
    assert "a1  in          -      -      -     -" in said


def test_a_long_way_is_kept_whole_from_its_first_place_to_its_last() -> None:
    rows = [row(k, arms=1, values={"load.position": (0.05 * k, 0.0, 0.8)}) for k in range(3 * MOST_PLACES)]
    path = look(Seen("demo"), rows).path_m
    assert len(path) <= MOST_PLACES
    assert path[0] == (0.0, 0.0)
    assert path[-1][0] == pytest.approx(0.05 * (3 * MOST_PLACES - 1))


@pytest.mark.parametrize("details", ["{", "[]", "3", '{"tick": 1}'])
def test_an_event_that_says_nothing_usable_does_no_harm(details: str) -> None:
    told = event("lost")
    seen = look(carried(), events=[type(told)(told.tick, told.time_s, told.kind, details)])
    assert seen.states == carried().states


def test_how_it_ended_is_said_in_a_sentence_and_by_the_exit_status() -> None:
    over = look(carried(), events=[event("ended", 300, why="reached its duration")])
    assert (last_sentence(over, stopped=False), exit_status(over, stopped=False)) == (
        "ended, and no verdict was told: reached its duration",
        3,
    )
    for verdict, status in (("holds", 0), ("violated", 1), ("unknown", 3)):
        judged = look(over, events=[event("judged", 300, verdict=verdict, why="reached its duration")])
        assert last_sentence(judged, stopped=True) == f"{verdict}: reached its duration"
        assert exit_status(judged, stopped=True) == status
        assert plain(head(judged, 80, ASCII))[0].startswith(f"palanquin demo   {verdict}: reached its duration")
    assert exit_status(carried(), stopped=True) == 0
    assert last_sentence(Seen("demo"), stopped=True) == "stopped before anything was heard of the run"
    assert last_sentence(carried(), stopped=True) == "stopped watching at 0.20 s; the run goes on"


def test_a_machine_without_the_simulator_can_watch() -> None:
    """What `pip install palanquin` brings is enough: no MuJoCo, no Parquet, no viewer."""
    extras = ("mujoco", "pyarrow", "rerun", "pinocchio", "llvmlite", "matplotlib", "cryptography", "PIL", "av")
    script = (
        f"import sys; sys.modules.update(dict.fromkeys({extras!r})); from deploy.cli import app; "
        "app(['watch', 'hold', '--run', 'demo', '--connect', 'tcp/127.0.0.1:1', '--wait-s', '0'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=100, check=False)
    assert "wire.errors.LinkError" in done.stderr


# What is drawn


def test_at_80_columns_everything_is_there() -> None:
    seen = look(carried(), events=[event("lost", 200, agent="a3", why="its sign of life is gone")])
    lines = plain(dashboard(seen, 80, 24, FANCY, TOLD))
    said = "\n".join(lines)
    assert lines[0].startswith("palanquin demo   running   tick 200 of 10000   0.2 of 10.0 s   x0.95 real time")
    assert "1.50 m to the goal   leader in, pulls 0 N" in said
    assert "a1  in          0    400   50.0   25% ████┃" in said
    assert "a3  lost        0    400   50.0   25% ████┃" in said
    assert "tilt 0.40 deg   most so far 0.40 deg" in said
    assert "from above, " in said
    assert "X: goal" in said
    assert lines[-1] == "    0.20 s lost a3: its sign of life is gone"


SIZES = [(80, 24), (40, 24), (40, 12), (132, 50), (72, 10), (20, 5), (3, 2), (1, 1)]


@pytest.mark.parametrize("glyphs", [FANCY, ASCII], ids=["fancy", "ascii"])
@pytest.mark.parametrize("arms", [1, 2, 4, 7, 16])
@pytest.mark.parametrize(
    ("width", "height"), [(80, 24), (40, 24), (40, 12), (132, 50), (72, 10), (20, 5), (3, 2), (1, 1)]
)
def test_the_picture_fits_whatever_the_terminal_and_the_team(
    arms: int, width: int, height: int, glyphs: Glyphs
) -> None:
    seen = look(carried(arms), events=[event("refused", agent="a1", text="x" * 300)])
    waiting = look(Seen("demo"), progress=[progress(phase="waiting", waiting_for="a1, a2")])
    for told in (TOLD, Told()):
        for each in (seen, Seen("demo"), waiting):
            lines = dashboard(each, width, height, glyphs, told, "no word for 3 s")
            assert len(lines) <= height
            assert max(line.cell_len for line in lines) <= width
            assert glyphs is FANCY or all(line.plain.isascii() for line in lines)


@pytest.mark.parametrize(("width", "arms"), [(80, 8), (40, 8), (120, 16)])
def test_every_arm_has_its_line_where_there_is_room(width: int, arms: int) -> None:
    lines = plain(dashboard(carried(arms), width, 60, FANCY, TOLD))
    for k in range(arms):
        assert sum(line.startswith(f"a{k + 1} ") for line in lines) == 1


def test_where_there_is_no_room_for_all_arms_those_in_trouble_are_shown_and_the_others_counted() -> None:
    seen = look(carried(16), events=[event("lost", agent="a14"), event("leaving", agent="a15")])
    lines = plain(arms_table(seen, 46, FANCY, 6))
    assert [line.split()[:2] for line in lines[1:-1]] == [
        ["a1", "in"],
        ["a2", "in"],
        ["a14", "lost"],
        ["a15", "leaving"],
    ]
    assert lines[-1] == "12 more: 12 in"


def test_who_bears_an_equal_share_has_half_a_bar() -> None:
    heavy = look(carried(2), [row(arms=2, values={"a1.grip": (0, 0, 150, 0, 0, 0), "a2.grip": (0, 0, 50, 0, 0, 0)})])
    first, second = plain(arms_table(heavy, 52, ASCII))[1:]
    room = len(first) - first.index("#")
    assert first.count("#") + first.count("|") == round(0.75 * room)
    assert second.count("#") == round(0.25 * room)


@given(part=st.floats(0, 1), width=st.integers(0, 60))
def test_a_bar_is_filled_to_its_part(part: float, width: int) -> None:
    for glyphs in (FANCY, ASCII):
        line = bar(part, width, glyphs, "").plain
        assert len(line) == width
        eighths = sum(8 if letter == glyphs.full else (glyphs.parts.find(letter) + 1) for letter in line)
        assert abs(eighths / 8 - part * width) <= (1 / 16 if glyphs.parts else 0.5) + 1e-9


def test_the_gauge_holds_the_most_tilt_so_far_and_marks_it() -> None:
    rows = [row(k, values={"load.quat_wxyz": tilted(tilt)}) for k, tilt in enumerate((8.0, 2.0))]
    lines = plain(tilt_gauge(look(Seen("demo"), rows), 47, ASCII))
    assert lines[0] == "tilt 2.00 deg   most so far 8.00 deg"
    assert lines[1] == "########" + "." * 24 + "|" + "." * 7 + " 10 deg"  # 40 letters for 10 deg
    assert "roll +2.00" in lines[3]


def test_letters_rise_with_the_tilt_and_are_blank_for_none() -> None:
    assert steps([0.0, 0.13, 0.5, 0.99, 1.0, 7.0, NAN], 1.0, FANCY) == "▁▂▅███ "


@pytest.mark.parametrize(("value", "said"), [(NAN, "- N"), (math.inf, "- N"), (-0.04, "0.0 N"), (1.25, "+1.2 N")])
def test_a_number_is_never_a_nan_or_a_minus_zero(value: float, said: str) -> None:
    assert number(value, 1, "N", signed=True) == said


def test_what_a_stranger_sent_does_not_move_the_cursor() -> None:
    hostile = look(carried(), events=[event("refused", agent="a1", text="\x1b[2J\x07gone\r\nx")])
    (line,) = plain(event_list(hostile, 80, 1, FANCY))
    assert line.isprintable()
    assert "?[2J?gone" in line


def test_what_is_wrong_with_the_connection_is_said_in_the_head() -> None:
    assert "no word for 4 s" in "\n".join(plain(head(carried(), 80, FANCY, "no word for 4 s")))
    assert "2 messages did not fit" in "\n".join(plain(head(look(carried(), refused=2), 80, FANCY)))


# From above


def test_a_metre_is_as_long_to_the_right_as_upwards_and_everything_is_inside() -> None:
    points = [(-1.0, -2.0), (3.0, 0.5), (0.0, 0.0)]
    window = window_of(points, 30, 12)
    for point in points:
        x, y = window.at(point)
        assert 0 <= x < 2 * 30
        assert 0 <= y < 4 * 12
    (x0, y0), (x1, y1) = window.at((0.0, 0.0)), window.at((1.0, 1.0))
    assert x1 - x0 == pytest.approx(y0 - y1)


def where(lines: list[str], word: str) -> tuple[int, int]:
    """Column and line of a word."""
    ((k, line),) = [(k, line) for k, line in enumerate(lines) if word in line]
    return line.index(word), k


def test_from_above_x_is_to_the_right_and_y_is_up() -> None:
    values = {
        "a1.base": (2.0, 0.0, 0.0),
        "a2.base": (0.0, 2.0, 0.0),
        "a3.base": (-2.0, 0.0, 0.0),
        "a4.base": (0.0, -2.0, 0.0),
    }
    lines = plain(top_view(look(Seen("demo"), [row(values=values)]), 40, 21, FANCY, Told((1.0, 1.0), (1.0, 1.0))))
    assert len(lines) == 21
    at = {name: where(lines[1:], name) for name in ("a1", "a2", "a3", "a4", "X")}
    assert at["a3"][0] < at["a2"][0] < at["a1"][0]
    assert at["a2"][1] < at["a1"][1] < at["a4"][1]
    assert at["a2"][0] < at["X"][0] < at["a1"][0]
    assert at["a2"][1] < at["X"][1] < at["a1"][1]


def test_the_load_is_drawn_in_its_size_where_it_is_and_as_it_is_turned() -> None:
    """A bar of 2 m by 0.2 m: across when it looks along x, down when it looks along y."""
    quarter = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
    for quat, across in (((1.0, 0.0, 0.0, 0.0), True), (quarter, False)):
        seen = look(Seen("demo"), [row(arms=0, values={"load.quat_wxyz": quat, "load.position": (5.0, 5.0, 0.8)})])
        drawn = [line for line in plain(top_view(seen, 40, 21, FANCY, Told((2.0, 0.2))))[1:] if line.strip()]
        columns = {k for line in drawn for k, letter in enumerate(line) if letter != " "}
        assert (2 * len(columns) > 4 * len(drawn)) == across


def test_dots_outside_of_the_canvas_are_nowhere_and_words_at_its_edge_are_whole() -> None:
    canvas = Canvas(10, 3)
    canvas.line((-50, 5), (90, 5))
    canvas.dot(math.nextafter(0, -1), 0)
    canvas.word(19, 0, "a12")
    canvas.word(5, 400, "no")
    lines = plain(canvas.draw(FANCY))
    assert lines[0] == " " * 7 + "a12"
    assert lines[1] == "⠒" * 10
    assert lines[2] == " " * 10


def test_a_window_of_nothing_is_a_window() -> None:
    assert isinstance(window_of([], 10, 4), Window)
    assert isinstance(window_of([(NAN, NAN)], 10, 4), Window)


@pytest.mark.parametrize(
    ("encoding", "asked", "glyphs"), [("utf-8", False, FANCY), ("utf-8", True, ASCII), ("ascii", False, ASCII)]
)
def test_a_terminal_that_has_no_braille_gets_none(encoding: str, asked: bool, glyphs: Glyphs) -> None:
    console = Console(file=io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    assert glyphs_for(console, ascii_only=asked) is glyphs
