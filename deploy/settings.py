"""``--set KEY=VALUE`` options: dotted keys and TOML values, as nested tables, and values written as TOML."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import typer


def tables(settings: Sequence[str]) -> dict[str, Any]:
    """The settings as nested tables; a later one wins. Raises :class:`typer.BadParameter`."""
    merged: dict[str, Any] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise typer.BadParameter(f"--set {setting}: expected KEY=VALUE, such as load.mass_kg=30")
        try:
            parsed = tomllib.loads(f"{key} = {value}")
        except tomllib.TOMLDecodeError as error:
            raise typer.BadParameter(f"--set {setting}: the value is not TOML ({error}); text needs quotes") from None
        _merge(merged, parsed)
    return merged


def scenario_changes(seed: int | None, settings: Sequence[str] | None) -> dict[str, Any]:
    """What the command line lays over a scenario file."""
    return tables(settings or []) | ({"seed": seed} if seed is not None else {})


def _merge(below: dict[str, Any], above: dict[str, Any]) -> None:
    for key, value in above.items():
        if isinstance(value, dict) and isinstance(below.get(key), dict):
            _merge(below[key], value)
        else:
            below[key] = value


def toml_value(value: object) -> str:
    """A scenario's value as TOML text: true, 3.5, "text", [1, 2]."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(element) for element in value) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {toml_value(element)}" for key, element in value.items()) + "}"
    return repr(value)
