"""docs/failures.md: every sentence on the page is one that the code, or the Makefile, says."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PAGE = (REPOSITORY / "docs" / "failures.md").read_text(encoding="utf-8")
SENTENCES = re.findall(r"^\| `([^`]+)` \|", PAGE, re.MULTILINE)
LEAST = 6
"""Letters of a piece of a sentence that is looked up; shorter ones (``; ``) prove nothing."""


def spoken() -> str:
    """All text in the code of the packages: parts of f-strings on their own, strings that follow each other joined."""
    found = []
    for package in ("wire", "agents", "sim_server", "deploy"):
        for file in (REPOSITORY / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.append(node.value)
    makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8").replace("$(PYTHON)", "\n")
    return "\n".join([*found, makefile]).replace("`", "'")


SPOKEN = spoken()


def pieces(sentence: str) -> list[str]:
    """What stands between placeholders, and around what a ScenarioError puts between its parts."""
    return [piece for piece in re.split(r"<[^>]*>|; expected ", sentence) if len(piece.strip()) >= LEAST]


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_of_the_page_is_said_by_the_code(sentence: str) -> None:
    assert pieces(sentence)
    for piece in pieces(sentence):
        # An f-string's {field} may hold a fixed word (--open's meaning); what is between two fields is never cut.
        assert re.sub(r"^[\s;:,)]+|[\s;:,(]+$", "", piece) in SPOKEN, piece


def test_the_page_has_the_sentences_and_a_made_up_one_would_be_found_out() -> None:
    assert len(SENTENCES) > 25
    assert "cannot listen at" not in SPOKEN
    assert pieces("<a>: the disk <b>; it is full") == [": the disk ", "; it is full"]
