"""Which pages the site has, in which order.

A page of ``docs/`` that stands nowhere here is an error, and so is an entry without a page.
"""

from __future__ import annotations

from collections.abc import Iterator

Entries = list[tuple[str, "str | Entries"]]
"""Titles, each with its page or with a section of further entries."""

GENERATED = {"cli.md"}
"""Pages that the build writes: see docsite/command_line.py."""
OUTSIDE = {"CHANGELOG.md": "changelog.md", "CONTRIBUTING.md": "contributing.md"}
"""Files of the top level that are pages of the site as well."""

NAVIGATION: Entries = [
    ("Palanquin", "index.md"),
    ("Quick start", "quick-start.md"),
    ("How it works", "how-it-works.md"),
    (
        "The law",
        [
            ("Equations and functions", "equations.md"),
            ("How the paper is read", "control-law.md"),
        ],
    ),
    (
        "Tutorials",
        [
            ("Your own controller", "own-controller.md"),
            ("Lead it yourself", "leading.md"),
            ("Your own load", "own-load.md"),
            ("Your own arm", "own-arm.md"),
            ("Several machines", "several-machines.md"),
            ("Containers", "containers.md"),
            ("Chaos", "chaos-bench.md"),
            ("See a run", "see.md"),
        ],
    ),
    (
        "Reference",
        [
            ("Command line", "cli.md"),
            ("Scenario files", "scenarios.md"),
            ("Faults", "chaos.md"),
            ("Metrics and verdict", "metrics.md"),
            ("The wire", "wire.md"),
            ("Credentials", "credentials.md"),
            ("Silence", "silence.md"),
            ("A killed simulator", "resuming.md"),
        ],
    ),
    (
        "Measured",
        [
            ("The paper's claims", "paper.md"),
            ("Results", "results.md"),
            ("What a loss costs", "losses.md"),
            ("Performance", "performance.md"),
            ("Scale", "scale.md"),
        ],
    ),
    ("When it fails", "failures.md"),
    ("Project", [("Changelog", "changelog.md"), ("Contributing", "contributing.md")]),
]

AWAITED: set[str] = set()
"""Pages that have a place and are still being written: their entries are left out as long as they are not there."""


def pages(entries: Entries = NAVIGATION) -> Iterator[str]:
    """Every page that stands in the navigation."""
    for _, target in entries:
        if isinstance(target, str):
            yield target
        else:
            yield from pages(target)


def present(entries: Entries, there: set[str]) -> Entries:
    """The navigation without entries of awaited pages that are not there, and without sections that this empties."""
    kept: Entries = []
    for title, target in entries:
        if not isinstance(target, str):
            if section := present(target, there):
                kept.append((title, section))
        elif target in there or target not in AWAITED:
            kept.append((title, target))
    return kept


def as_toml(entries: Entries) -> str:
    """The navigation as the value that the site's configuration takes."""
    items = []
    for title, target in entries:
        value = f'"{target}"' if isinstance(target, str) else as_toml(target)
        items.append(f'{{ "{title}" = {value} }}')
    return "[" + ", ".join(items) + "]"
