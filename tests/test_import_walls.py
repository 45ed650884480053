"""Who may import whom: read from the source of every file, so that a lazy import in a function counts too."""

import ast
from collections.abc import Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("wire", "agents", "sim_server", "deploy")  # tests and benchmarks may import anything

# Nothing in the folder on the left imports the packages on the right.
FORBIDDEN = {
    "agents": ("sim_server", "mujoco"),
    "sim_server": ("agents",),
    "wire": ("agents", "sim_server", "deploy"),
}
# The one file that imports the library.
ONLY_DOOR = {
    "zenoh": "wire/zenoh_link.py",
    "pinocchio": "agents/arm_model.py",
    "llvmlite": "agents/machine_code.py",
    "pygame": "deploy/person/gamepad.py",
}
# Who may go past the door, and why: an intruder is a hostile process, which would not use ours.
PAST_THE_DOOR = {"zenoh": "deploy/chaos/"}
# No more files than this import the library.
MOST_DOORS = {"rerun": 1, "mujoco": 3}
MUJOCO_FOLDER = "sim_server/"

EQUATIONS_FOLDER = "agents/equations/"
EQUATIONS_IMPORT = ("__future__", "collections.abc", "dataclasses", "numpy", "typing", "agents.equations")

DYNAMIC_IMPORTS = ("__import__", "import_module")


def imported_names(path: str, source: str) -> set[str]:
    """Absolute dotted names of all that a file imports: `from a import b` is `a.b`, whether b is a module or not."""
    package = path.split("/")[:-1]
    names: set[str] = set()
    for node in ast.walk(ast.parse(source, filename=path)):
        match node:
            case ast.Import():
                names.update(alias.name for alias in node.names)
            case ast.ImportFrom():
                parts = package[: len(package) - node.level + 1] if node.level else []
                base = ".".join([*parts, *filter(None, [node.module])])
                names.update(f"{base}.{alias.name}" for alias in node.names)
            case ast.Call(
                func=ast.Name(id=function) | ast.Attribute(attr=function),
                args=[ast.Constant(value=str(name)), *_],
            ) if function in DYNAMIC_IMPORTS:
                names.add(name)
    return names


def lies_in(name: str, package: str) -> bool:
    return name == package or name.startswith(package + ".")


def broken_walls(sources: Mapping[str, str]) -> list[str]:
    """One sentence per broken rule in files given as {path relative to the root: source text}."""
    imports = {path: sorted(imported_names(path, source)) for path, source in sorted(sources.items())}

    def importers(package: str) -> list[str]:
        return [path for path, names in imports.items() if any(lies_in(name, package) for name in names)]

    broken: list[str] = []
    for folder, packages in FORBIDDEN.items():
        for package in packages:
            broken += [f"{path} imports {package}" for path in importers(package) if path.startswith(folder + "/")]
    for library, door in ONLY_DOOR.items():
        past = (door, PAST_THE_DOOR.get(library, door))
        broken += [
            f"{path} imports {library}; only {door} may" for path in importers(library) if not path.startswith(past)
        ]
    for library, most in MOST_DOORS.items():
        if len(doors := importers(library)) > most:
            broken.append(f"{library} is imported in {len(doors)} files, at most {most} may: {', '.join(doors)}")
    broken += [
        f"{path} imports mujoco; only {MUJOCO_FOLDER} may"
        for path in importers("mujoco")
        if not path.startswith((MUJOCO_FOLDER, "agents/"))  # agents has its own sentence above
    ]
    for path, names in imports.items():
        if path.startswith(EQUATIONS_FOLDER):
            outside = [name for name in names if not any(lies_in(name, allowed) for allowed in EQUATIONS_IMPORT)]
            broken += [f"{path} imports {name}; an equation needs numpy only" for name in outside]
    return broken


def project_sources() -> dict[str, str]:
    files = (file for folder in FOLDERS for file in (ROOT / folder).rglob("*.py"))
    return {file.relative_to(ROOT).as_posix(): file.read_text(encoding="utf-8") for file in files}


def test_no_wall_is_broken() -> None:
    assert broken_walls(project_sources()) == []


@pytest.mark.parametrize(("library", "door"), ONLY_DOOR.items(), ids=ONLY_DOOR)
def test_each_door_leads_to_its_library(library: str, door: str) -> None:
    """Else a renamed door would leave the rule about it empty."""
    names = imported_names(door, (ROOT / door).read_text(encoding="utf-8"))
    assert any(lies_in(name, library) for name in names)


OFFENDERS = {
    "agent_sees_physics": ("agents/follower.py", "import sim_server.plant", "imports sim_server"),
    "agent_uses_simulator": ("agents/follower.py", "from mujoco import MjModel", "imports mujoco"),
    "physics_sees_agent": ("sim_server/plant.py", "from agents.equations import inertia", "imports agents"),
    "wire_sees_agent": ("wire/codec.py", "from agents import arm_model", "imports agents"),
    "wire_sees_physics": ("wire/codec.py", "import sim_server as s", "imports sim_server"),
    "wire_sees_launcher": ("wire/codec.py", "from deploy.cli import main", "imports deploy"),
    "lazy_import": ("agents/leader.py", "def f():\n    import mujoco", "imports mujoco"),
    "import_for_types_only": ("agents/leader.py", "if TYPE_CHECKING:\n    import mujoco", "imports mujoco"),
    "import_by_name": ("agents/leader.py", "m = importlib.import_module('sim_server.plant')", "imports sim_server"),
    "second_zenoh_door": ("sim_server/router.py", "import zenoh", "imports zenoh; only wire/zenoh_link.py may"),
    "launcher_past_the_door": ("deploy/launcher.py", "import zenoh", "imports zenoh; only wire/zenoh_link.py may"),
    "second_pinocchio_door": ("agents/follower.py", "import pinocchio as pin", "only agents/arm_model.py may"),
    "mujoco_in_deploy": ("deploy/view.py", "import mujoco.viewer", "only sim_server/ may"),
    "equation_uses_model": ("agents/equations/impedance.py", "from ..arm_model import ArmModel", "needs numpy only"),
    "equation_uses_wire": ("agents/equations/impedance.py", "import wire", "needs numpy only"),
    "equation_uses_clock": ("agents/equations/impedance.py", "from time import monotonic", "needs numpy only"),
}


@pytest.mark.parametrize(("path", "source", "sentence"), OFFENDERS.values(), ids=OFFENDERS)
def test_an_offending_import_is_named(path: str, source: str, sentence: str) -> None:
    (said,) = broken_walls({path: source})
    assert said.startswith(path)
    assert sentence in said


@pytest.mark.parametrize(("library", "most"), MOST_DOORS.items(), ids=MOST_DOORS)
def test_one_door_too_many_is_named(library: str, most: int) -> None:
    sources = {f"sim_server/file_{i}.py": f"import {library}" for i in range(most + 1)}
    assert broken_walls(dict(list(sources.items())[:most])) == []
    (said,) = broken_walls(sources)
    assert f"{library} is imported in {most + 1} files" in said


def test_allowed_imports_break_no_wall() -> None:
    assert (
        broken_walls(
            {
                "wire/zenoh_link.py": "import zenoh",
                "deploy/chaos/attempts.py": "import zenoh",
                "agents/arm_model.py": "import pinocchio as pin\nfrom wire.keys import state_key",
                "agents/equations/impedance.py": (
                    "from __future__ import annotations\n"
                    "from collections.abc import Sequence\n"
                    "from dataclasses import dataclass\n"
                    "from typing import Final\n"
                    "import numpy as np\n"
                    "from numpy.typing import NDArray\n"
                    "from . import frames\n"
                    "from .frames import rotation\n"
                    "from agents.equations.inertia import task_inertia\n"
                ),
                "sim_server/plant.py": "import mujoco\nimport wire.codec",
                "deploy/cli.py": "import agents_of_change, mujoco_menagerie\nfrom sim_server.server import serve",
            }
        )
        == []
    )
