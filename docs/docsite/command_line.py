"""The reference of the command line, written by Typer from the command itself, so that it cannot be out of date."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

HEADING = re.compile(r"^#+ `palanquin (?P<verb>[\w -]+)`\n\n(?P<help>[^\n]*)$", re.MULTILINE)
COMMAND = re.compile(r"^\* `(?P<name>\w[\w-]*)`: .*$", re.MULTILINE)
SECTION = re.compile(r"(?=^#+ `palanquin)", re.MULTILINE)


def command_line_page(repository: Path) -> str:
    """The page, of the package in ``repository``."""
    done = subprocess.run(
        [sys.executable, "-m", "typer", "deploy.cli", "utils", "docs", "--name", "palanquin"],
        cwd=repository,
        capture_output=True,
        text=True,
        check=True,
    )
    return "# Command line\n\n" + _whole_sentences(done.stdout.partition("\n")[2])


def _whole_sentences(text: str) -> str:
    """Lists of commands with the first line of each one's help, which Typer cuts at 45 characters, and links to it."""
    helps = {found["verb"]: found["help"] for found in HEADING.finditer(text)}
    sections = []
    for section in SECTION.split(text):
        heading = HEADING.match(section)
        group = heading["verb"] + " " if heading else ""

        def whole(line: re.Match[str], group: str = group) -> str:
            verb = group + line["name"]
            return f"* [`{line['name']}`](#palanquin-{verb.replace(' ', '-')}): {helps[verb]}"

        sections.append(COMMAND.sub(whole, section))
    return "".join(sections)
