"""Blocks of shell commands in README and in the tutorials, so that a test can run what a reader would copy.

A block of language ``sh`` runs in bash, line by line, in a folder that all blocks of its page share. An invisible
comment before it may say otherwise:

    <!-- shell: terminals -->          each line is a terminal of its own; all are started, and all have to end
    <!-- shell: not run, REASON -->    it is not run, and the reason says what holds it true instead

A block of another language under a paragraph that begins with a file's name (```cabinet.toml`:``) is that file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

BLOCK = re.compile(
    r"(?:^<!-- shell: (?P<how>[^\n]*) -->\n)?^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
NAMED = re.compile(
    r"^`(?P<name>[\w.-]+\.(?:toml|py))`[:,][^\n]*\n(?:[^\n]+\n)*\n```\w+\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """Commands that belong together.

    Attributes:
        line: where it begins on its page, from 1.
        how: as the comment before it says.
        reason: why it is not run; empty if it is.
    """

    line: int
    text: str
    how: Literal["script", "terminals", "not run"] = "script"
    reason: str = ""

    def commands(self) -> list[str]:
        """Its lines that are commands."""
        lines = [line.partition(" #")[0].strip() for line in self.text.replace("\\\n", " ").splitlines()]
        return [line for line in lines if line and not line.startswith("#")]


class BadMark(ValueError):
    """A comment before a block that means nothing."""


def blocks(page: str) -> list[Block]:
    """All shell blocks of a page, in order. Raises :class:`BadMark`."""
    found = []
    for match in BLOCK.finditer(page):
        if match["language"] in ("sh", "bash", "console", "shell"):
            line = page.count("\n", 0, match.start("text"))
            found.append(_block(line, match["text"], match["how"] or "script"))
    return found


def _block(line: int, text: str, how: str) -> Block:
    word, _, reason = (part.strip() for part in how.partition(","))
    if how == "script":
        return Block(line, text)
    if how == "terminals":
        return Block(line, text, "terminals")
    if word != "not run" or not reason:
        raise BadMark(f"line {line}: shell: {how}: expected `terminals` or `not run, REASON`")
    return Block(line, text, "not run", reason)


def files(page: str) -> dict[str, str]:
    """Files that the page shows, by name."""
    return {match["name"]: match["text"] for match in NAMED.finditer(page)}
