"""Tests run in several processes at once (``pytest -n``): the slow ones first, and some with the machine to themselves.

A file's tests stay in one process, since they share what they started.
"""

from __future__ import annotations

import fcntl
import tempfile
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# How long an example takes says how busy the machine is, and nothing of the code.
settings.register_profile("palanquin", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("palanquin")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that start real processes come first: a long file that begins last is waited for by everybody."""
    slow = {item.path for item in items if item.get_closest_marker("system")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """A test marked ``alone`` begins when no other process has one under way, and they wait for its end."""
    cache = getattr(item.config, "cache", None)  # pytest can be run without
    folder = cache.mkdir("alone") if cache else Path(tempfile.gettempdir())
    kind = fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH
    with (folder / "turnstile").open("w") as turnstile, (folder / "machine").open("w") as machine:
        fcntl.flock(turnstile, fcntl.LOCK_EX)  # else those who share the machine would never let one alone in
        fcntl.flock(machine, kind)
        fcntl.flock(turnstile, fcntl.LOCK_UN)
        return (yield)
