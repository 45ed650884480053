"""Scenario files: where they are found, how ``extends`` is resolved, and how a bad one is reported."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from sim_server.errors import ScenarioError
from sim_server.metrics import METRICS
from sim_server.scenario import Scenario
from sim_server.scenario_events import EVENT_KINDS

SHIPPED = Path(__file__).parent / "scenarios"


@dataclass(frozen=True, slots=True)
class NamedScenario:
    """A checked scenario and where it came from."""

    name: str
    source: str
    scenario: Scenario


def shipped_names() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml")))


def load_scenario(name_or_path: str, changes: Mapping[str, Any] | None = None) -> NamedScenario:
    """Read and check a scenario.

    Args:
        name_or_path: the name of a shipped scenario, or a path to a TOML file.
        changes: tables that are laid over the file, as from the command line (``{"seed": 3}``).

    Raises:
        ScenarioError: no such scenario, not TOML, an unknown key, or a value that cannot be; with file and key.
    """
    path = _find(name_or_path)
    tables = _read(path, ())
    merged = _overlay(tables, changes or {})
    try:
        scenario = Scenario.model_validate(merged)
    except ValidationError as error:
        raise _explain(path, error.errors()) from None
    for metric in scenario.expect:
        if metric not in METRICS:
            near = get_close_matches(metric, METRICS, n=1)
            raise ScenarioError(
                path.name,
                f"expect.{metric}",
                "unknown metric",
                expected="one of " + ", ".join(METRICS),
                fix=f"Did you mean {near[0]}?" if near else "",
            )
    return NamedScenario(path.stem, str(path) if path.parent != SHIPPED else path.name, scenario)


def _find(name_or_path: str) -> Path:
    shipped = SHIPPED / f"{name_or_path}.toml"
    if "/" not in name_or_path and shipped.is_file():
        return shipped
    path = Path(name_or_path)
    if path.is_file():
        return path
    near = get_close_matches(name_or_path, shipped_names(), n=1)
    raise ScenarioError(
        name_or_path,
        "",
        "no scenario of this name and no such file",
        expected=f"one of {', '.join(shipped_names())}, or a path to a TOML file",
        fix=f"Did you mean {near[0]}?" if near else "",
    )


def _read(path: Path, seen: tuple[Path, ...]) -> dict[str, Any]:
    """The file's tables, laid over those of the scenario that it extends."""
    here = path.resolve()  # else a circle through `../` never meets the same path again
    if here in seen:
        raise ScenarioError(path.name, "extends", "the scenarios extend each other in a circle")
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ScenarioError(path.name, "", f"cannot be read as TOML: {error}") from None
    parent = tables.pop("extends", None)
    if parent is None:
        return tables
    if not isinstance(parent, str):
        raise ScenarioError(path.name, "extends", f"got {parent!r}", expected="the name of a scenario")
    return _overlay(_read(_find_parent(path, parent), (*seen, here)), tables)


def _find_parent(path: Path, parent: str) -> Path:
    beside = path.parent / f"{parent}.toml"
    if beside.is_file():
        return beside
    try:
        return _find(parent)
    except ScenarioError as error:
        raise ScenarioError(
            path.name, "extends", f"{parent!r}: {error.problem}", expected=error.expected, fix=error.fix
        ) from None


def _overlay(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Tables merged key by key; anything else of ``above`` replaces what is below. A metric's bound is one value."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        if isinstance(old, dict) and isinstance(value, Mapping) and not _is_bound(value):
            merged[key] = _overlay(old, value)
        else:
            merged[key] = value
    return merged


def _is_bound(table: Mapping[str, Any]) -> bool:
    return bool(table) and not table.keys() - {"min", "max"}


def _explain(path: Path, errors: list[ErrorDetails]) -> ScenarioError:
    """The first thing that is wrong, in our words."""
    first = errors[0]
    key = ".".join(str(part) for part in _written(first["loc"]))
    message = first["msg"].removeprefix("Value error, ")
    more = f" ({len(errors) - 1} more)" if len(errors) > 1 else ""
    if first["type"] == "extra_forbidden":
        return ScenarioError(path.name, key, f"unknown key{more}", expected=_known_keys(first["loc"]))
    if first["type"] == "missing" and isinstance(first["loc"][-1], int):
        listed = ".".join(str(part) for part in _written(first["loc"])[:-1])
        few = f"too few numbers{more}; got {first['input']!r}"
        return ScenarioError(path.name, listed, few, expected=f"at least {first['loc'][-1] + 1}")
    if first["type"] == "missing":
        return ScenarioError(path.name, key, f"missing{more}", expected="this key")
    if first["type"].startswith("union_tag"):
        known = ", ".join(str(kind) for kind in EVENT_KINDS)
        return ScenarioError(path.name, f"{key}.kind", f"no such kind of event{more}", expected=f"one of {known}")
    if not key and ": " in message:
        key, message = message.split(": ", 1)
        return ScenarioError(path.name, key, message + more)
    return ScenarioError(path.name, key, f"{message}{more}; got {first['input']!r}")


def _written(place: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """The place as the file has it: an event's kind is no part of it."""
    return place[:2] + place[3:] if place[:1] == ("events",) else place


def _known_keys(place: tuple[int | str, ...]) -> str:
    """The keys that are known where the unknown one stands."""
    model: Any = Scenario
    if place[0] == "events":
        model, place = EVENT_KINDS[str(place[2])], place[-1:]
    for part in place[:-1]:
        if part not in model.model_fields:
            continue  # the name of a metric, the number of an event
        annotation = model.model_fields[part].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next((option for option in options if hasattr(option, "model_fields")), None)
        if model is None:
            return "no such key here"
    return "one of " + ", ".join(model.model_fields)
