"""docs/own-controller.md: the very text of the page, run in a loop of its own and through the real processes."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import run_to_end

from agents.arm_model import ArmModel, ArmSnapshot
from agents.controllers import make_controller
from agents.controllers.interface import Effort, Sensed
from agents.safety import SafeController
from sim_server.metrics import tilt_deg
from sim_server.mujoco_plant import MujocoPlant
from sim_server.scenario_files import load_scenario
from sim_server.world import build_world

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "own-controller.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The only block of that language on the page."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    return str(found)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder that the page describes."""
    (tmp_path / "spring_hand.py").write_text(block("python"), encoding="utf-8")
    (tmp_path / "carry.toml").write_text(block("toml"), encoding="utf-8")
    return tmp_path


def test_the_controller_of_the_page_holds_a_crate(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two seconds with nobody pulling, handover included. What is left is the load's weight over the spring, by hand:
    2.5 kg 9.81 m/s^2 / 8000 N/m = 3.07 mm (3.02 measured). The crate hangs straight below the hand: no tilt."""
    monkeypatch.syspath_prepend(folder)
    scenario = load_scenario(str(folder / "carry.toml")).scenario
    plant = MujocoPlant(build_world(scenario))
    arm = ArmModel(scenario.team.arm)
    law = make_controller(scenario.team.controller, arm, scenario.team.gains)
    safe = SafeController(scenario.team.controller, law, arm, scenario.team.handover_s)
    start = plant.load_pose()
    for _ in range(2000):
        reading = plant.read()["a1"]
        effort = safe.step(Sensed(*map(np.array, (reading.q, reading.qd, reading.tau, reading.wrench))), 1e-3)
        plant.command("a1", effort.torque, effort.base_force, effort.stiffness)
        plant.step()
    end = plant.load_pose()
    # Links that weigh up to 3 % more or less than the model says (about 2 N at the hand) and dry friction (0.5 N).
    assert start.position[2] - end.position[2] == pytest.approx(0.00307, abs=0.0004)
    assert tilt_deg(end.quat_wxyz[None])[0] < 0.05
    assert np.linalg.norm(end.linear_velocity) < 0.005


@pytest.mark.system
def test_the_commands_of_the_page_run_it_in_the_real_processes(folder: Path) -> None:
    assert "\npalanquin run carry.toml\n" in PAGE
    done = run_to_end("run", "carry.toml", "--out", "mine", "--set", "duration_s=1.0", cwd=folder)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    run = json.loads((folder / "mine" / "run.json").read_text(encoding="utf-8"))
    assert run["scenario"]["team"]["controller"] == "spring_hand:SpringHand"
    assert run["scenario"]["team"]["gains"] == {"lift_N_m": 8000.0}
    assert run["ended"] == {"completed": True, "why": "reached its duration", "ticks": 1000}
    assert run["agents"]["a1"]["missed_ticks"] == 0
    metrics = json.loads((folder / "mine" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["verdict"] == ("holds", "violated")[done.returncode]  # a second may be too short for the goal
    assert all(math.isfinite(value) for value in metrics.values() if isinstance(value, float))
    assert 1.0 < metrics["sag_max_mm"] < 5.0  # 3 mm at rest, see above, and a little more in motion
    assert metrics["leader_impulse_Ns"] > 0


@pytest.mark.system
def test_a_gain_that_the_constructor_does_not_take_ends_the_run_before_it_begins(folder: Path) -> None:
    done = run_to_end("run", "carry.toml", "--out", "mine", "--set", "team.gains.lift_kN_m=8", cwd=folder)
    assert done.returncode == 2
    assert "lift_kN_m" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (folder / "mine").exists()


@pytest.mark.parametrize(
    ("heading", "cls"), [("What it gets", ArmSnapshot), ("What it gets", Sensed), ("return", Effort)]
)
def test_the_page_names_every_field(heading: str, cls: Any) -> None:
    (section,) = (part for part in PAGE.split("\n## ") if part.splitlines()[0].endswith(heading))
    told = set(re.findall(r"`(\w+)`", "\n".join(line for line in section.splitlines() if line.startswith("| `"))))
    assert set(cls.__annotations__) <= told
