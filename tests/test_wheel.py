"""The wheel has what an installed Palanquin needs and nothing else.

That it installs and runs is another matter: ``make wheel-check``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("wire", "agents", "sim_server", "deploy")
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built from a copy of what git would have: nothing that lies about in the checkout is in it, nor left there."""
    source, into = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in PACKAGES:
        shutil.copytree(REPOSITORY / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "NOTICE"):
        shutil.copy(REPOSITORY / name, source)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", into, source], check=True, capture_output=True, text=True)
    (file,) = into.glob("*.whl")
    return zipfile.ZipFile(file)


def test_all_of_the_packages_is_in_the_wheel_and_nothing_else(wheel: zipfile.ZipFile) -> None:
    inside = {name for name in wheel.namelist() if ".dist-info/" not in name}
    wanted = {".py", ".typed", ".xml", ".toml"}
    tree = {
        str(file.relative_to(REPOSITORY))
        for package in PACKAGES
        for file in (REPOSITORY / package).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert {name for name in tree if Path(name).suffix in wanted} <= inside
    assert inside <= tree
    assert {"wire/arms/panda.xml", "sim_server/scenarios/transport.toml", "deploy/entry.py"} <= inside


def test_the_wheel_says_what_it_is_and_what_it_needs(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    told = Parser().parsestr(wheel.read(name).decode())
    assert (told["Name"], told["Version"], told["Requires-Python"]) == ("palanquin", PROJECT["version"], ">=3.11")
    assert set(told.get_all("Provides-Extra") or []) == set(PROJECT["optional-dependencies"])
    needed = told.get_all("Requires-Dist") or []
    for extra, library in (("follower", "pin"), ("sim", "mujoco"), ("view", "matplotlib")):
        assert any(line.startswith(library) and f'extra == "{extra}"' in line for line in needed)
    assert not any(line.startswith("mujoco") and "extra" not in line for line in needed)
    entry = wheel.read(name.replace("METADATA", "entry_points.txt")).decode()
    assert "palanquin = deploy.entry:main" in entry
    licences = [each for each in wheel.namelist() if each.endswith(("/LICENSE", "/NOTICE"))]
    assert len(licences) == 2
