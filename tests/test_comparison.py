"""``palanquin chaos intruder`` as real processes, protected side; what an open system gives is in test_intruder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from processes import UNKNOWN_CONNECTION, free_port, not_violated, processes_that_name, read_json, run_to_end
from rich.console import Console

from deploy.chaos import target
from deploy.chaos.attempt import Got
from deploy.chaos.comparison import Comparison
from deploy.chaos.comparison_report import is_closed, print_and_write, status
from deploy.chaos.intruder import ATTEMPTS, ON_THE_WIRE, Row, try_all
from deploy.chaos.target import Target
from deploy.landlock import abi


@pytest.mark.system
@pytest.mark.timeout(180)
@pytest.mark.skipif(abi() < 6, reason="this kernel's Landlock lacks a wall")
@pytest.mark.parametrize(("option", "protection"), [((), "passwords"), (("--tls",), "certificates (mTLS)")])
def test_all_that_an_intruder_tries_is_closed(option: tuple[str, ...], protection: str, tmp_path: Path) -> None:
    folder = tmp_path / "attacked"
    ended = run_to_end(
        "chaos", "intruder", "--only-protected", "--out", folder, *option, cwd=tmp_path, patience_s=160.0
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    report = read_json(folder / "report.json")
    assert report["closed"]
    assert report["protection"] == protection
    assert [row["name"] for row in report["here"]] == [attempt.name for attempt in ATTEMPTS]
    assert [row["name"] for row in report["here"] if row["got"]["is_open"] is not False] == []
    assert report["expect"].count("holds") == 3, report["expect"]  # tilt, sag, the leader's force
    assert f"{len(ATTEMPTS)} of {len(ATTEMPTS)} attempts closed here" in ended.stdout
    # A session in mode peer, with a1's credential, now and then gets some of a1's own states while it opens.
    not_violated(read_json(folder / "here" / "audit.json"), UNKNOWN_CONNECTION)
    assert processes_that_name(str(folder)) == []


HERE = (Row("hear", "hear", Got(False, "nothing")), Row("say | shout", "speak", Got(False, "none arrived")))
COMPARISON = Comparison("passwords", 2, HERE, (Row("hear", "hear", Got(True, "heard 7")),), True, 1000, "holds")


def test_one_open_attempt_or_another_trace_is_enough_to_fail() -> None:
    assert is_closed(COMPARISON)
    assert is_closed(replace(COMPARISON, same_trace=None))
    assert not is_closed(replace(COMPARISON, same_trace=False))
    assert status(replace(COMPARISON, expect="tilt_max_deg 3 (<= 0.5) violated")) == 1
    assert not is_closed(replace(COMPARISON, here=(*HERE, Row("x", "hear", Got(True, "heard 1")))))
    assert not is_closed(replace(COMPARISON, here=(*HERE, Row("x", "hear", Got(None, "nobody looked")))))


def test_the_report_sets_what_an_open_system_gave_beside_what_was_got_here(tmp_path: Path) -> None:
    console = Console(width=200, record=True)
    print_and_write(console, COMPARISON, tmp_path)
    table = (tmp_path / "report.md").read_text()
    assert "| hear | OPEN: heard 7 | closed: nothing |" in table
    assert "| say \\| shout | not run | closed: none arrived |" in table
    assert "- 1 of 1 were open on an open system: 1 gave the intruder something, 0 were only heard" in table
    assert "byte for byte" in console.export_text()
    assert read_json(tmp_path / "report.json")["same_trace"] is True


@pytest.mark.system
def test_an_intruder_that_cannot_log_in_has_tested_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target, "OPEN_TIMEOUT_MS", 100)  # a dozen logins wait for it, and nobody is there
    nobody = Target(f"tcp/127.0.0.1:{free_port()}", "carry", "a1", ("a2",))
    needs_no_session = {"call for others on the network"}
    attempts = [each for each in ON_THE_WIRE if each.name not in needs_no_session]
    some = [attempts[0], *(each for each in attempts if each.way in ("connect", "speak"))]
    rows = tuple(try_all(nobody, some))
    assert [row.name for row in rows if row.got.tested or row.got.is_open is not None] == []
    comparison = replace(COMPARISON, here=(*HERE, *rows))
    assert status(comparison) == 3
    console = Console(width=200, record=True)
    print_and_write(console, comparison, tmp_path)
    assert "not tested, the intruder's own session did not work: hear everything, " in console.export_text()
    opened = Row("x", "hear", Got(True, "heard 1"))
    assert status(replace(comparison, here=(*comparison.here, opened))) == 1
    assert status(COMPARISON) == 0


def test_what_was_only_heard_is_told_apart_from_what_had_an_effect(tmp_path: Path) -> None:
    heard = Row("say | shout", "speak", Got(True, "answer: taken", only_heard=True))
    console = Console(width=200, record=True)
    print_and_write(console, replace(COMPARISON, open=(*COMPARISON.open, heard)), tmp_path)
    table = (tmp_path / "report.md").read_text()
    assert "| say \\| shout | OPEN (heard, no effect): answer: taken | closed: none arrived |" in table
    assert "2 of 2 were open on an open system: 1 gave the intruder something, 1 were only heard" in table
