"""``python -m docsite --into FOLDER``: the site, in FOLDER/site. A broken link, or a page without a place in the
navigation, is an error with status 2."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from docsite.command_line import command_line_page
from docsite.navigation import AWAITED, GENERATED, NAVIGATION, OUTSIDE, as_toml, pages, present
from docsite.pages import PageError, site_page, source_page, source_page_name

REPOSITORY = Path(__file__).resolve().parent.parent.parent
CONFIGURATION = "zensical.toml"
HERE = Path(__file__).resolve().parent


def write_pages(into: Path, repository: Path = REPOSITORY) -> None:
    """Write the site's pages, and its configuration, into a new folder.

    Raises:
        PageError: a page without a place in the navigation, an entry without a page, a link to what is not there.
    """
    docs = repository / "docs"
    sources = {f"docs/{page.name}": page.name for page in sorted(docs.glob("*.md"))} | OUTSIDE
    there = set(sources.values()) | GENERATED
    _check_navigation(there)
    made = into / "pages"
    made.mkdir(parents=True)
    code = set()
    for place, name in sources.items():
        text, linked = site_page((repository / place).read_text(encoding="utf-8"), place, repository)
        (made / name).write_text(text, encoding="utf-8")
        code |= linked
    for path in sorted(code):
        page = made / source_page_name(path)
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(source_page(path, repository), encoding="utf-8")
    (made / "cli.md").write_text(command_line_page(repository), encoding="utf-8")
    for beside in sorted(docs.iterdir()):  # pictures, and what a page offers to be taken along
        if beside.is_dir() and beside != HERE:
            shutil.copytree(beside, made / beside.name)
        elif beside.is_file() and beside.suffix != ".md":
            shutil.copy(beside, made)
    shutil.copy(HERE / "site.css", made)
    configuration = (HERE / CONFIGURATION).read_text(encoding="utf-8")
    navigation = as_toml(present(NAVIGATION, there))
    (into / CONFIGURATION).write_text(configuration.replace("nav = []", f"nav = {navigation}"), encoding="utf-8")


def build(into: Path) -> int:
    """Make the pages and build the site from them; the exit status: 2 if a page or a link is wrong."""
    shutil.rmtree(into, ignore_errors=True)
    write_pages(into)
    environment = {**os.environ, "NO_COLOR": "1"}
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "--config-file", CONFIGURATION]
    done = subprocess.run(command, cwd=into, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        said = done.stderr.partition("Traceback")[0].strip() or done.stderr
        raise PageError(f"the site has broken links:\n{said}")
    return 0


def _check_navigation(there: set[str]) -> None:
    placed = set(pages())
    if homeless := sorted(there - placed):
        raise PageError(f"docs/{homeless[0]} has no place on the site: put it into docs/docsite/navigation.py")
    if missing := sorted(placed - there - AWAITED):
        raise PageError(f"docs/docsite/navigation.py names {missing[0]}, and there is no such page in docs/")


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="docsite", description=__doc__)
    parser.add_argument("--into", type=Path, required=True, help="a folder of its own: what is in it is replaced")
    into = parser.parse_args().into.absolute()
    try:
        build(into)
    except PageError as error:
        print(f"docs: {error}", file=sys.stderr)
        return 2
    print(f"the site: {into / 'site' / 'index.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
