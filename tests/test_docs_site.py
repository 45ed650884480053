"""The documentation site: it builds with every link, stands on its own, and what it generates is what the code says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import pytest
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from deploy.cli import app
from docsite import __main__ as docsite
from docsite.command_line import command_line_page
from docsite.navigation import AWAITED, GENERATED, NAVIGATION, OUTSIDE, as_toml, pages, present
from docsite.pages import PageError, site_page

REPOSITORY = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site: that this succeeds says that no link and no anchor is broken."""
    into = tmp_path_factory.mktemp("site")
    docsite.build(into)
    return into / "site"


def html(site: Path) -> Iterator[tuple[str, str]]:
    for file in sorted(site.rglob("*.html")):
        yield str(file.relative_to(site)), file.read_text(encoding="utf-8")


def test_every_page_of_the_navigation_is_built(site: Path) -> None:
    there = {file.name.removesuffix(".html") + ".md" for file in site.glob("*.html")}
    assert {page for page in pages() if page not in AWAITED} <= there
    assert "Equations and functions" in (site / "index.html").read_text(encoding="utf-8")


def test_the_site_needs_no_other_host(site: Path) -> None:
    """No script, style, font or picture from elsewhere; links that a reader may follow are another matter."""
    fetched = re.compile(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"?(https?:)?//|<link[^>]*rel=\"?stylesheet[^>]*//")
    assert [name for name, text in html(site) if fetched.search(text)] == []
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", style.read_text(encoding="utf-8")), style


def test_each_equation_of_the_page_is_drawn_and_its_function_shown(site: Path) -> None:
    source = (REPOSITORY / "docs" / "equations.md").read_text(encoding="utf-8")
    built = (site / "equations.html").read_text(encoding="utf-8")
    assert built.count("<math ") == source.count("```math") > 10
    plain = re.sub(r"<[^>]+>", "", built)
    functions = re.findall(r"^\[`(\w+)`\]\(\.\./agents/equations", source, re.MULTILINE)
    assert len(functions) > 10
    for name in functions:
        assert f"def {name}(" in plain


def test_every_numbered_equation_of_the_law_is_on_the_page() -> None:
    text = (REPOSITORY / "docs" / "equations.md").read_text(encoding="utf-8")
    assert {int(number) for number in re.findall(r"[Ee]quation (\d+)", text)} == set(range(5, 17))


def test_the_reference_names_every_verb_and_every_option() -> None:
    page = command_line_page(REPOSITORY)
    assert "..." not in [line[-3:] for line in page.splitlines() if line.startswith("* [")]

    def check(command: object, name: str) -> None:
        heading = "# Command line\n" if name == "palanquin" else f"# `{name}`\n"
        assert page.count(heading) == 1, name
        section = re.split(r"^#+ `", page.partition(heading)[2], maxsplit=1, flags=re.MULTILINE)[0]
        if isinstance(command, TyperGroup):
            for verb, below in command.commands.items():
                assert f"[`{verb}`](#{f'{name}-{verb}'.replace(' ', '-')})" in section
                check(below, f"{name} {verb}")
        elif isinstance(command, TyperCommand):
            for parameter in command.params:
                if not getattr(parameter, "hidden", False) and parameter.param_type_name == "option":
                    assert parameter.opts[0] in section, f"{name} {parameter.opts[0]}"

    check(get_command(app), "palanquin")


# What is wrong with a page stops the build.


def small(tmp_path: Path, text: str) -> tuple[str, set[PurePosixPath]]:
    (tmp_path / "docs").mkdir()
    (tmp_path / "wire").mkdir()
    (tmp_path / "wire" / "keys.py").write_text("def arm(name):\n    return name\n")
    (tmp_path / "docs" / "other.md").write_text("# Other\n")
    return site_page(text, "docs/page.md", tmp_path)


def test_links_to_code_become_pages_and_blocks_of_code_stay(tmp_path: Path) -> None:
    page, code = small(tmp_path, "[keys](../wire/keys.py), [o](other.md#other)\n\n```sh\necho [a](../b)\n```\n")
    assert page == "[keys](source/wire/keys.py.md), [o](other.md#other)\n\n```sh\necho [a](../b)\n```\n"
    assert code == {PurePosixPath("wire/keys.py")}


def test_a_function_s_line_is_followed_by_its_source(tmp_path: Path) -> None:
    page, _ = small(tmp_path, "[`arm`](../wire/keys.py)\n")
    assert "def arm(name):\n    return name" in page


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[x](../wire/kyes.py)", "a link to ../wire/kyes.py, and there is no such file"),
        ("[x](../wire)", "a link to the folder ../wire"),
        ("[`arms`](../wire/keys.py)", "wire/keys.py has no function arms"),
        ("```math\n\\left( a\n```", "cannot be read"),
    ],
)
def test_what_is_not_there_is_refused_with_its_page(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(PageError, match=re.escape(said)) as error:
        small(tmp_path, text + "\n")
    assert "docs/page.md" in str(error.value)


def test_a_broken_anchor_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(into: Path) -> None:
        (into / "pages").mkdir(parents=True)
        (into / "pages" / "index.md").write_text("# Here\n\n[there](#there)\n")
        (into / "zensical.toml").write_text((docsite.HERE / docsite.CONFIGURATION).read_text())
        (into / "pages" / "site.css").touch()

    monkeypatch.setattr(docsite, "write_pages", broken)
    with pytest.raises(PageError, match="anchor does not exist"):
        docsite.build(tmp_path / "site")


def test_a_page_without_a_place_and_a_place_without_a_page_are_errors() -> None:
    there = set(pages())
    docsite._check_navigation(there)
    docsite._check_navigation(there - AWAITED)
    with pytest.raises(PageError, match=r"docs/new\.md has no place"):
        docsite._check_navigation(there | {"new.md"})
    with pytest.raises(PageError, match=r"names wire\.md, and there is no such page"):
        docsite._check_navigation(there - {"wire.md"})


def test_awaited_pages_are_left_out_and_nothing_else() -> None:
    there = set(pages()) - AWAITED
    assert set(pages(present(NAVIGATION, there))) == there
    assert as_toml([("A", "a.md"), ("S", [("B", "b.md")])]) == '[{ "A" = "a.md" }, { "S" = [{ "B" = "b.md" }] }]'
    assert {"cli.md"} == GENERATED


def test_links_of_pages_outside_of_the_site_lead_somewhere() -> None:
    for name in ["README.md", *OUTSIDE]:
        for target in LINK.findall((REPOSITORY / name).read_text(encoding="utf-8")):
            assert ":" in target or (REPOSITORY / target).exists(), f"{name}: {target}"
