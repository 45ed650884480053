"""A law is chosen and its gains are set by name; what is wrong is refused, with what is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from one_arm import HOME, arm, sensed

from agents.controllers import CONTROLLERS, find_controller, make_controller
from agents.controllers.paper import PaperController, PaperGains
from agents.errors import ControllerError

# Refusals.


@pytest.mark.parametrize(
    ("gains", "named"),
    [
        ({"task_stifness_1_s2": 80.0}, "task_stifness_1_s2"),
        ({"task_stiffness_1_s2": -1.0}, "task_stiffness_1_s2"),
        ({"null_damping_Nms_rad": float("nan")}, "null_damping_Nms_rad"),
        ({"beta": float("inf")}, "beta"),
        ({"alpha": "0.02"}, "alpha"),
        ({"alpha": True}, "alpha"),
        ({"adaptive": "perhaps"}, "adaptive"),
        ({"null_stiffness_Nm_rad": [859.0, -286.0, 286.0, 286.0, 286.0, 286.0, 286.0]}, "null_stiffness_Nm_rad"),
    ],
)
def test_a_wrong_gain_is_refused_by_its_name_with_the_known_ones(gains: dict[str, object], named: str) -> None:
    with pytest.raises(ControllerError) as caught:
        make_controller("paper", arm(), gains)
    message = str(caught.value)
    (value,) = gains.values()
    given = value if not isinstance(value, list) else min(value)
    assert f"controller paper: gain {named}" in message
    assert repr(given) in message
    for known in PaperGains.model_fields:
        assert known in message


@pytest.mark.parametrize("count", [0, 6, 8])
def test_a_stiffness_for_another_number_of_joints_is_refused(count: int) -> None:
    with pytest.raises(ControllerError, match=f"null_stiffness_Nm_rad: got {count} numbers, expected 7, .* panda"):
        make_controller("paper", arm(), {"null_stiffness_Nm_rad": [286.0] * count})


def test_gains_of_a_scenario_reach_the_law() -> None:
    law = make_controller("paper", arm(), {"adaptive": False, "null_stiffness_Nm_rad": [100] * 7})
    assert isinstance(law, PaperController)
    assert law.gains == PaperGains(adaptive=False, null_stiffness_Nm_rad=(100.0,) * 7)
    np.testing.assert_array_equal(law.step(sensed(HOME), 1e-3).stiffness, np.full(7, 100.0))


@pytest.mark.parametrize("name", ["papr", "", "my_law", ":Law", ".relative:Law", "my law:Law", "/tmp/law.py:Law"])
def test_an_unknown_law_is_refused_with_the_known_ones_and_the_way_to_ones_own(name: str) -> None:
    with pytest.raises(ControllerError) as caught:
        find_controller(name)
    assert repr(name) in str(caught.value)
    for known in [*CONTROLLERS, "module:Class"]:
        assert known in str(caught.value)


OWN = """
import numpy as np
from agents.controllers.interface import Effort

class Zero:
    def __init__(self, arm, scale=1.0):
        self.arm, self.scale = arm, scale

    def step(self, sensed, dt_s):
        return Effort(self.scale * np.ones(self.arm.joints), np.zeros(3), np.zeros(self.arm.joints))

class NoGains:
    def __init__(self, arm):
        pass

number = 3
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Writes a module of the user's own on the path; its name is used in no other test."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(text: str) -> str:
        name = f"own_law_{tmp_path.name}"
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        return name

    return write


def test_ones_own_law_is_found_by_module_and_class_and_gets_its_gains(own: Callable[[str], str]) -> None:
    law = make_controller(f"{own(OWN)}:Zero", arm(), {"scale": 2.5})
    np.testing.assert_array_equal(law.step(sensed(HOME), 1e-3).torque, np.full(7, 2.5))


def test_a_module_that_is_not_there_is_named() -> None:
    with pytest.raises(ControllerError, match="module 'no_such_module' cannot be imported"):
        find_controller("no_such_module:Law")


def test_a_module_whose_own_imports_fail_says_which(own: Callable[[str], str]) -> None:
    with pytest.raises(ControllerError, match=r"cannot be imported .*no_such_library"):
        find_controller(f"{own('import no_such_library')}:Law")


@pytest.mark.parametrize("name", ["Missing", "number", ""])
def test_a_class_that_is_not_there_is_named(name: str, own: Callable[[str], str]) -> None:
    with pytest.raises(ControllerError, match=f"has no class '{name}'"):
        find_controller(f"{own(OWN)}:{name}")


def test_a_constructor_that_takes_no_such_gain_is_named(own: Callable[[str], str]) -> None:
    module = own(OWN)
    for cls, gains in (("NoGains", {"scale": 1.0}), ("Zero", {"scales": 1.0})):
        with pytest.raises(ControllerError, match=f"controller {module}:{cls}: .*'scales?'.*got gains .*1.0"):
            make_controller(f"{module}:{cls}", arm(), gains)
