"""Every shell block of README and of the tutorials runs, as a reader would copy it.

What makes that affordable: ``palanquin`` is a script here that hands everything on, and cuts runs short
(``SHORT``). A bound that such a run does not hold is no failure of the page, so status 1 of ``run`` counts as 0, and
so does an audit that cannot tell. Ports are free ones.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from processes import PALANQUIN, free_port
from shell_blocks import BadMark, Block, blocks, files

REPOSITORY = Path(__file__).resolve().parent.parent
PAGES = [
    "README.md",
    *(f"docs/{name}.md" for name in ("quick-start", "own-controller", "own-load", "own-arm", "several-machines")),
]
SHORT = "--set duration_s=0.1 --set team.count=1"
"""Before the reader's own options, so that those win."""
PATIENCE_S = 250.0
"""Of one block; a dozen seconds where nothing else runs."""
MY_SCENARIO = 'extends = "transport"\ndescription = "Mine."\n'
"""What README calls a scenario of your own."""

WRAPPER = """#!/bin/bash
verb=$1; shift
case $verb in
  run) "{real}" run --no-picture {short} "$@"; status=$?; [ $status = 1 ] && status=0; exit $status ;;
  sim) [[ $* == *--listen* ]] || set -- "$@" --listen tcp/127.0.0.1:{port}
       "{real}" sim --set duration_s=0.1 "$@"; status=$?; [ $status = 1 ] && status=0; exit $status ;;
  follower | leader) [[ $* == *--connect* ]] || set -- "$@" --connect tcp/127.0.0.1:{port}
       for try in $(seq 100); do "{real}" $verb "$@" 2>said.$$ && exit 0
         grep -q "nobody answers" said.$$ || break; sleep 0.1; done; cat said.$$ >&2; exit 3 ;;
  render) "{real}" render "$@" 2>said.$$; status=$?; cat said.$$ >&2
       grep -q libegl1 said.$$ && exit 0; exit $status ;;
  audit) "{real}" audit "$@"; status=$?; [ $status = 3 ] && status=0; exit $status ;;
  *) exec "{real}" "$verb" "$@" ;;
esac
"""


@pytest.fixture
def page(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[list[Block], Path, dict[str, str]]:
    """A page's blocks, the folder in which they run, and the environment."""
    text = (REPOSITORY / str(request.param)).read_text(encoding="utf-8")
    folder, port = tmp_path / "here", free_port()
    folder.mkdir()
    for name, content in {"my-scenario.toml": MY_SCENARIO, **files(text)}.items():
        (folder / name).write_text(content, encoding="utf-8")
    wrapper = tmp_path / "bin" / "palanquin"
    wrapper.parent.mkdir()
    wrapper.write_text(WRAPPER.format(real=PALANQUIN, short=SHORT, port=port))
    wrapper.chmod(0o755)
    environment = {**os.environ, "PATH": f"{wrapper.parent}:{os.environ['PATH']}"}
    if "At the top of a checkout" in text:  # one of its own, which is what a page that changes code is about
        for package in ("wire", "agents", "sim_server", "deploy"):
            shutil.copytree(REPOSITORY / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
        environment["PYTHONPATH"] = str(folder)
    mine = [Block(each.line, each.text.replace("7447", str(port)), each.how, each.reason) for each in blocks(text)]
    return mine, folder, environment


@pytest.mark.system
@pytest.mark.timeout(600)  # several blocks, each with patience for a busy machine
@pytest.mark.parametrize("page", PAGES, indirect=True)
def test_the_shell_blocks_of_the_page_run(page: tuple[list[Block], Path, dict[str, str]]) -> None:
    mine, folder, environment = page
    run = 0
    for block in mine:
        if block.how == "not run":
            continue
        commands = block.commands() if block.how == "terminals" else [f"set -e\n{block.text}"]
        terminals = [_terminal(command, folder, environment) for command in commands]
        try:
            _all_end_well(terminals, block)
        finally:
            for terminal in terminals:
                with suppress(ProcessLookupError):
                    os.killpg(terminal.pid, signal.SIGKILL)
                terminal.wait(10)
        run += 1
    assert run


def _terminal(command: str, folder: Path, environment: dict[str, str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def _all_end_well(terminals: list[subprocess.Popen[str]], block: Block) -> None:
    deadline = time.monotonic() + PATIENCE_S
    said = [terminal.communicate(timeout=deadline - time.monotonic())[0] for terminal in terminals]
    failed = [text for terminal, text in zip(terminals, said, strict=True) if terminal.returncode]
    assert not failed, f"line {block.line}:\n{block.text}\n" + "\n".join(text[-1500:] for text in failed)


def test_what_is_not_run_says_what_holds_it_true_instead() -> None:
    for name in PAGES:
        for block in blocks((REPOSITORY / name).read_text(encoding="utf-8")):
            if block.how == "not run":
                for word in block.reason.split():
                    if word.startswith("tests/"):
                        assert (REPOSITORY / word).is_file(), f"{name}, line {block.line}: {word}"


def test_make_has_what_the_pages_ask_of_it() -> None:
    asked = {
        command.split()[1]
        for name in PAGES
        for block in blocks((REPOSITORY / name).read_text(encoding="utf-8"))
        for command in block.commands()
        if command.startswith("make ")
    }
    assert {"demo", "test"} <= asked
    dry = ["make", "--dry-run", "--no-print-directory", f"PYTHON={sys.executable}", *sorted(asked)]
    done = subprocess.run(dry, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


# The reading of pages.


def test_blocks_are_found_with_their_marks_and_lines() -> None:
    text = "a\n\n```sh\nx  # why\n\ny\n```\n\n<!-- shell: terminals -->\n```sh\np\nq\n```\n\n```toml\nk = 1\n```\n"
    one, two = blocks(text)
    assert (one.line, one.how, one.commands()) == (3, "script", ["x", "y"])
    assert (two.line, two.how, two.commands()) == (10, "terminals", ["p", "q"])
    (three,) = blocks("<!-- shell: not run, because -->\n```sh\nz\n```\n")
    assert (three.how, three.reason) == ("not run", "because")


@pytest.mark.parametrize("how", ["not run", "not run,", "terminal", "notrun, because"])
def test_a_mark_that_means_nothing_is_refused(how: str) -> None:
    with pytest.raises(BadMark):
        blocks(f"<!-- shell: {how} -->\n```sh\nz\n```\n")


def test_files_are_found_by_the_line_before_them() -> None:
    assert files("`a.toml`:\n\n```toml\nk = 1\n```\n\n`b.py`, beside it. The\nkeys:\n\n```python\nx\n```\n") == {
        "a.toml": "k = 1\n",
        "b.py": "x\n",
    }
