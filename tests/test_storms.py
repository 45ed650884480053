"""Storms, matrix and losses: everything that is drawn is a scenario, and says the same again from its seed."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.chaos.catalogue import NOT_DRAWN, Fault, Span, faults, named
from deploy.chaos.lost import LOSSES, draw_losses, rows_of, run_of
from deploy.chaos.matrix import CONTROL, Judged, judged, plan_matrix, report, table
from deploy.chaos.outcome import OUTCOMES, Judgement, Outcome
from deploy.chaos.storm import StormError, carry_in, carry_of, draw_storm, scenario_text, short_carry
from deploy.settings import scenario_changes, toml_value
from sim_server.scenario_events import EVENT_KINDS
from sim_server.scenario_files import load_scenario

seeds = st.integers(0, 2**32)


@settings(max_examples=60)
@given(seeds, st.integers(0, 6), st.sampled_from([4, 6]), st.sampled_from(["paper", "palanquin"]))
def test_every_storm_is_a_scenario_whose_file_says_what_was_drawn(seed: int, count: int, arms: int, law: str) -> None:
    carry = short_carry(arms, law)
    events = draw_storm(carry, seed, count)
    assert events == draw_storm(carry, seed, count), "the same seed, the same storm"
    assert len(events) >= count
    times = [event["at_s"] for event in events]
    assert times == sorted(times)
    written = tomllib.loads(scenario_text(carry, events, seed, "drawn"))
    extends = load_scenario(written.pop("extends"), written).scenario
    planned = carry.run("storm", "drawn", law, events, seed)
    assert extends.model_dump(mode="json") == planned.resolved() | {"description": "drawn"}
    assert len(extends.events) == len(events)


@settings(max_examples=30)
@given(seeds)
def test_what_ends_an_agents_part_strikes_it_alone_but_for_pushes(seed: int) -> None:
    ending = {row.kind for row in faults() if row.ends}
    by_target: dict[str, list[str]] = {}
    for event in draw_storm(short_carry(4, "paper"), seed, 6):
        by_target.setdefault(str(event.get("agent") or event.get("arm")), []).append(event["kind"])
    for target, kinds in by_target.items():
        left = [kind for kind in kinds if kind not in ("push", "start", "continue")]
        # A stop that is continued does not end a part, and is a stop nevertheless.
        assert target == "None" or len(left) <= 1 or not ending & set(left) - {"stop"}, (target, kinds)


def test_two_seeds_draw_two_storms() -> None:
    carry = short_carry(4, "paper")
    assert draw_storm(carry, 1, 5) != draw_storm(carry, 2, 5)


def test_a_storm_on_a_scenario_of_the_users_keeps_its_events_and_names_its_file(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text('extends = "dropout"\ndescription = "mine"\nduration_s = 20.0\n')
    carry = carry_of(str(own), 5, "palanquin")
    events = draw_storm(carry, 3, 2)
    assert {"at_s": 5.0, "kind": "kill", "agent": "a2"} in events
    drawn = [event["at_s"] for event in events if event["at_s"] != 5.0 and event["kind"] not in ("start", "continue")]
    assert all(2.0 <= at_s <= 8.0 for at_s in drawn), "between a tenth and four tenths of the run"
    file = tmp_path / "elsewhere" / "storm.toml"
    file.parent.mkdir()
    file.write_text(scenario_text(carry, events, 3, "drawn"))
    team = load_scenario(str(file)).scenario.team
    assert (team.count, team.controller) == (5, "palanquin")


def test_what_is_cut_out_of_a_storms_file_stands_without_it(tmp_path: Path) -> None:
    (tmp_path / "heavy.toml").write_text('extends = "transport"\ndescription = "mine"\n[load]\nmass_kg = 30.0\n')
    storm, cut = tmp_path / "storm.toml", tmp_path / "there" / "cut.toml"
    storm.write_text(
        'extends = "heavy"\ndescription = "storm"\nduration_s = 9.0\n[expect]\ntilt_max_deg = { max = 3.0 }\n'
        '[[events]]\nat_s = 1.0\nkind = "kill"\nagent = "a1"\n[[events]]\nat_s = 2.0\nkind = "kill"\nagent = "a2"\n'
    )
    whole = load_scenario(str(storm)).scenario
    cut.parent.mkdir()
    cut.write_text(scenario_text(carry_in(str(storm)), [{"at_s": 2.0, "kind": "kill", "agent": "a2"}], 1, "storm"))
    storm.unlink()
    assert load_scenario(str(cut)).scenario == whole.model_copy(update={"events": whole.events[1:]})
    assert carry_in("transport").scenario == "transport"


def test_a_storm_without_room_is_refused_with_how_many_there_is_room_for() -> None:
    with pytest.raises(StormError, match=r"--faults 9: there is room for 4 "):
        draw_storm(short_carry(4, "paper"), 1, 9, named(["kill"]))


def test_a_leaderless_scenario_gets_no_fault_of_the_leader() -> None:
    carry = carry_of("hold", None, None)
    with pytest.raises(StormError, match="room for 0"):
        draw_storm(carry, 1, 1, named(["leader-kill"]))


def test_what_goes_with_nothing_else_is_in_no_storm_unless_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, carry = replace(named(["push-load"])[0], alone=True), short_carry(4, "paper")
    assert draw_storm(carry, 1, 1, [alone])[0]["kind"] == "push"
    monkeypatch.setattr("deploy.chaos.storm.faults", lambda: (alone,))
    with pytest.raises(StormError, match="room for 0"):
        draw_storm(carry, 1, 1)


def test_every_kind_of_event_is_drawn_or_undoes_one() -> None:
    assert {row.kind for row in faults()} == set(EVENT_KINDS) - set(NOT_DRAWN)
    assert len({row.name for row in faults()}) == len(faults())


def test_an_unknown_fault_is_refused_with_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"got 'kil', expected one of kill, "):
        named(["kil"])


@given(st.floats(-100, 100), st.floats(0, 50), seeds)
def test_a_span_draws_within_itself(low: float, length: float, seed: int) -> None:
    import numpy as np

    drawn = Span(low, low + length).draw(np.random.default_rng(seed))
    assert low - 5e-4 <= drawn <= low + length + 5e-4  # rounded to three digits


MATRIX = plan_matrix(faults(), [4, 6], ["paper", "palanquin"], range(1, 4))


def test_the_matrix_has_every_fault_by_every_team_and_one_run_per_seed() -> None:
    assert len(MATRIX) == (1 + len(faults())) * 2 * 2
    assert {(cell.fault, cell.arms, cell.preset) for cell in MATRIX} == {
        (name, arms, preset)
        for name in (CONTROL, *(row.name for row in faults()))
        for arms in (4, 6)
        for preset in ("paper", "palanquin")
    }
    places = [run.place for cell in MATRIX for run in cell.runs]
    assert len(set(places)) == len(places) == 3 * len(MATRIX)


def test_every_run_of_the_matrix_is_a_scenario_and_its_settings_say_the_same() -> None:
    for cell in MATRIX:
        run = cell.runs[0]
        resolved = run.resolved()
        assert resolved["team"]["count"] == cell.arms
        assert bool(resolved["events"]) == (cell.fault != CONTROL)
        again = load_scenario(run.scenario, scenario_changes(run.seed, run.settings())).scenario
        assert again.model_dump(mode="json") == resolved


def test_a_seed_strikes_both_laws_alike_and_another_seed_otherwise() -> None:
    cells = {(cell.fault, cell.arms, cell.preset): cell for cell in MATRIX}
    for row in faults():
        one, other = (cells[row.name, 4, preset].runs for preset in ("paper", "palanquin"))
        assert [run.changes["events"] for run in one] == [run.changes["events"] for run in other]
        assert one[0].changes["events"] != one[1].changes["events"]


def judgement(outcome: Outcome) -> Judgement:
    verdict = {"carries": "holds", "drops": "violated", "unknown": "unknown"}[outcome]
    return Judgement(outcome, verdict, (), 1.0 + len(outcome), 0.1, 0.05)  # type: ignore[arg-type]


def small_map() -> list[Judged]:
    cells = plan_matrix(named(["kill"]), [4], ["paper", "palanquin"], range(1, 4))
    by_place = {run.place: judgement("carries") for cell in cells for run in cell.runs}
    killed = next(cell for cell in cells if (cell.fault, cell.preset) == ("kill", "paper"))
    by_place |= {killed.runs[0].place: judgement("drops"), killed.runs[1].place: judgement("unknown")}
    return judged(cells, by_place)


def test_the_survival_table_counts_outcomes_and_verdicts_of_each_cell() -> None:
    lines = table(small_map()).splitlines()
    assert lines[0] == "| fault | 4 arms, `paper` | 4 arms, `palanquin` |"
    assert lines[2] == "| no fault | 3 carries (3 / 0 / 0) | 3 carries (3 / 0 / 0) |"
    assert lines[3] == "| kill | 1 carries, 1 drops, 1 unknown (1 / 1 / 1) | 3 carries (3 / 0 / 0) |"
    assert set(OUTCOMES) <= set(report(small_map(), "command", "", "map.png").replace("*", " ").split())


def test_the_survival_map_paints_each_part_as_long_as_its_share(tmp_path: Path) -> None:
    """Read back from the picture. Of four cells' worth of colour, 3 1/3 are `carries` and 1/3 is `drops`: ten times as
    much, and more where hatching and figures cover some of either. What did not occur is not painted."""
    from matplotlib.colors import to_rgb
    from matplotlib.pyplot import imread

    from deploy.chaos.survival_map import PAINT, draw_map

    file = tmp_path / "map.png"
    draw_map(small_map(), file)
    pixels = imread(file)[:, :, :3]
    height = pixels.shape[0]

    def painted(outcome: Outcome) -> int:
        near = abs(pixels - to_rgb(PAINT[outcome][0])).max(axis=2) < 0.01
        return int(near[: int(0.8 * height)].sum())  # above the legend

    assert painted("drops") > 100
    assert painted("stops") == painted("moves") == 0
    assert 8 < painted("carries") / painted("drops") < 20


def test_losses_are_drawn_in_every_way_as_often_and_at_ticks_of_the_way() -> None:
    arms = load_scenario("transport").scenario.arms
    losses = draw_losses(arms, 200, 1)
    assert losses == draw_losses(arms, 200, 1)
    assert losses != draw_losses(arms, 200, 2)
    names = [loss.name for loss in losses]
    each = [names.count(name) for name in set(names)]
    assert len(each) == 3 * len(LOSSES)
    assert max(each) - min(each) <= 1
    assert {loss.arm for loss in losses} == set(arms)
    assert len({loss.tick for loss in losses}) > 190
    for loss in losses[:12]:
        resolved = run_of(loss, "palanquin", 1).resolved()
        assert resolved["team"]["when_lost"] == loss.when_lost
        assert resolved["events"][0]["kind"] == loss.way
        assert round(1000 * resolved["events"][0]["at_s"]) == loss.tick


def test_the_worst_of_the_losses_is_told_by_kind_and_in_all() -> None:
    losses = draw_losses(("a1",), 6, 1)
    *rows, everything = rows_of(losses, [judgement("carries")] * 5 + [judgement("drops")])
    assert sum(row.outcomes["carries"] for row in rows) == everything.outcomes["carries"] == 5
    assert everything.tilt_max_deg == 8.0
    assert [row.name for row in rows if row.outcomes["drops"]] == [losses[5].name]


def test_a_table_of_an_event_is_written_as_toml_reads_it() -> None:
    event = {"at_s": 1.5, "kind": "push", "force_N": [0.0, -1e-05, 3.0], "on": True, "text": 'a "b"\n\\'}
    assert tomllib.loads(f"events = {toml_value([event])}")["events"] == [event]


def test_a_row_with_a_second_event_strikes_the_same_agent_later() -> None:
    import numpy as np

    (row,) = named(["kill-start"])
    first, second = row.draw(np.random.default_rng(1), ("a1", "a2"), Span(1.0, 2.0))
    assert (first["kind"], second["kind"], first["agent"]) == ("kill", "start", second["agent"])
    assert 0.3 <= round(second["at_s"] - first["at_s"], 3) <= 2.0
    assert isinstance(row, Fault)
