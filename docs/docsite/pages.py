"""A page of the repository as a page of the site: its links, its equations and the code that it names.

In the repository a page links to files beside it and to code (``../wire/access.py``); on the site each file of code
that a page links to is a page too, so the site is whole without a network. Equations stand in blocks ```` ```math ````,
which become MathML: no script draws them. A line that is nothing but a link to a function, with the function's name as
its text, is followed by that function's source.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path, PurePosixPath

from latex2mathml.converter import convert

from docsite.navigation import OUTSIDE

LINK = re.compile(r"(?<!\!)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s#]+)(?P<anchor>#[^)\s]*)?\)")
MATH = re.compile(r"^```math\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FUNCTION = re.compile(r"^\[`(\w+)`\]\(\.\./([\w/]+\.py)\)$", re.MULTILINE)
FENCE = re.compile(r"^(```+)[^\n]*\n.*?^\1$", re.MULTILINE | re.DOTALL)
LANGUAGES = {".py": "python", ".toml": "toml", ".xml": "xml", ".md": "markdown"}


class PageError(Exception):
    """A page names something that is not there; the message says which page, what, and what to do."""


def site_page(text: str, place: str, repository: Path) -> tuple[str, set[PurePosixPath]]:
    """The page as the site has it, and the files of code that it links to.

    Args:
        text: the page as it stands in the repository.
        place: where it stands, from the repository's top: ``docs/wire.md``.
        repository: the repository's top.
    """
    code: set[PurePosixPath] = set()

    def relink(link: re.Match[str]) -> str:
        target = link["target"]
        if ":" in target:
            return link[0]
        path = _resolve(PurePosixPath(place).parent, target)
        if not (repository / path).exists():
            raise PageError(f"{place}: a link to {target}, and there is no such file: correct the link")
        anchor = link["anchor"] or ""
        if str(path) == "README.md":
            return f"[{link['text']}](index.md{anchor})"
        if str(path) in OUTSIDE:
            return f"[{link['text']}]({OUTSIDE[str(path)]}{anchor})"
        if path.parts[0] == "docs":
            return f"[{link['text']}]({path.relative_to('docs')}{anchor})"
        if not (repository / path).is_file():
            raise PageError(f"{place}: a link to the folder {target}: link to a file in it")
        code.add(path)
        return f"[{link['text']}]({source_page_name(path)}{anchor})"

    text = FUNCTION.sub(lambda line: line[0] + "\n\n" + _source_of(repository, line[2], line[1], place), text)
    text = MATH.sub(lambda block: _mathml(block[1], place), text)
    return _outside_fences(text, lambda prose: LINK.sub(relink, prose)), code


def source_page_name(path: PurePosixPath) -> str:
    """Where the page of a file of code is on the site."""
    return f"source/{path}.md"


def source_page(path: PurePosixPath, repository: Path) -> str:
    """A file of code as a page."""
    text = (repository / path).read_text(encoding="utf-8")
    return f"# {path}\n\n{_fenced(text, LANGUAGES.get(path.suffix, 'text'), numbered=True)}"


def _resolve(folder: PurePosixPath, target: str) -> PurePosixPath:
    """The target of a link as a path from the repository's top."""
    parts: list[str] = []
    for part in (folder / target).parts:
        if part == "..":
            parts.pop()
        else:
            parts.append(part)
    return PurePosixPath(*parts)


def _source_of(repository: Path, file: str, name: str, place: str) -> str:
    """The source of one function, as a block."""
    text = (repository / file).read_text(encoding="utf-8")
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return _fenced(ast.get_source_segment(text, node) or "", "python")
    raise PageError(f"{place}: {file} has no function {name}: correct the page")


def _mathml(latex: str, place: str) -> str:
    """A displayed equation. One that cannot be read stops the build."""
    try:
        drawn = convert(" ".join(latex.split()), display="block")
    except Exception as error:  # of several kinds, none of them named by the library
        raise PageError(f"{place}: the equation {latex.strip()!r} cannot be read: {error!r}") from error
    return f'<div class="equation">{drawn}</div>'


def _fenced(text: str, language: str, *, numbered: bool = False) -> str:
    longest = max((len(run) for run in re.findall(r"`{3,}", text)), default=2)
    fence = "`" * (longest + 1)
    return f"{fence} {{ .{language}{' linenums=1' if numbered else ''} }}\n{text.rstrip()}\n{fence}\n"


def _outside_fences(text: str, change: object) -> str:
    """Change the prose; blocks of code stay as they are."""
    assert callable(change)
    done, last = [], 0
    for fence in FENCE.finditer(text):
        done += [change(text[last : fence.start()]), fence[0]]
        last = fence.end()
    return "".join([*done, change(text[last:])])
