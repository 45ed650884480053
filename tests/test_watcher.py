"""The observer behind the dashboard, over a link in memory: when it ends, and what it says then."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from refused import refused
from rich.console import Console
from watched import event, progress, row

from deploy.see.heard import NotSeen
from deploy.see.watch.canvas import ASCII
from deploy.see.watch.screens import Lines, Picture, why_plain
from deploy.see.watch.seen import Seen
from deploy.see.watch.top_view import Told
from deploy.see.watch.watcher import Watcher
from wire.codec import encode
from wire.keys import Keys
from wire.link import Link
from wire.memory import Broker
from wire.messages import Event, Progress, Row

KEYS = Keys("demo")


class Simulator:
    """As much of one as an observer hears."""

    def __init__(self, broker: Broker) -> None:
        self.link: Link = broker.link()
        self.link.declare_alive(KEYS.sim_alive)

    def tell(self, *messages: Row | Event | Progress) -> None:
        of_type = {Row: KEYS.rows, Event: KEYS.events, Progress: KEYS.progress}
        for message in messages:
            self.link.publisher(of_type[type(message)]).put(encode(message))


class Playing:
    """A screen on which every look has something happen; keeps what was shown."""

    def __init__(self, *scenes: Callable[[], object]) -> None:
        self._scenes = list(scenes)
        self.shown: list[tuple[Seen, str]] = []

    def show(self, seen: Seen, warning: str) -> None:
        self.shown.append((seen, warning))
        if self._scenes:
            self._scenes.pop(0)()


def test_a_run_is_shown_until_its_simulator_has_ended_it_and_gone() -> None:
    broker = Broker()
    sim = Simulator(broker)
    watcher = Watcher(broker.link(), "demo")
    screen = Playing(
        lambda: sim.tell(event("joined", agent="a1"), progress(5)),
        lambda: sim.tell(row(10, arms=1), progress(10)),
        lambda: sim.tell(event("ended", 20, why="reached its duration"), event("judged", 20, verdict="holds")),
        sim.link.close,
    )
    watcher.wait_for_simulator(0)
    last = watcher.run_to_end(screen, reconnect_s=60)
    assert [seen.tick for seen, _ in screen.shown] == [0, 5, 10, 20, 20]
    assert (last.state_of("a1"), last.ended, last.verdict) == ("in", "reached its duration", "holds")


def test_a_simulator_that_goes_without_an_end_is_said_to_be_gone() -> None:
    broker = Broker()
    sim = Simulator(broker)
    watcher = Watcher(broker.link(), "demo")
    screen = Playing(lambda: sim.tell(progress(1234)), sim.link.close)
    with pytest.raises(NotSeen, match=r"the simulator of run demo is gone.* tick 1234 \(1\.23 s\)"):
        watcher.run_to_end(screen, reconnect_s=0)
    assert screen.shown[-1][1] == "the simulator is gone, waiting 0 s for it"


def test_a_simulator_that_comes_back_in_time_goes_on_being_shown() -> None:
    broker = Broker()
    sim = Simulator(broker)
    watcher = Watcher(broker.link(), "demo")
    again: list[Simulator] = []
    screen = Playing(
        sim.link.close,
        lambda: again.append(Simulator(broker)),
        lambda: again[0].tell(event("resumed", 5), progress(6)),
        watcher.stop,
    )
    last = watcher.run_to_end(screen, reconnect_s=600)
    assert last.tick == 5  # of what comes together, events count last
    assert [warning.partition(",")[0] for _, warning in screen.shown] == ["", "the simulator is gone", "", "", ""]
    assert watcher.was_stopped


def test_who_is_told_to_stop_stops_at_once_even_while_it_waits() -> None:
    broker = Broker()
    watcher = Watcher(broker.link(), "demo")
    watcher.stop()
    watcher.wait_for_simulator(600)
    assert watcher.run_to_end(Playing(), reconnect_s=600).tick == 0


def test_without_a_simulator_it_is_said_what_to_do() -> None:
    with pytest.raises(NotSeen, match=r"no simulator of run demo .* within 0 s: start it with `palanquin sim`"):
        Watcher(Broker().link(), "demo").wait_for_simulator(0)


def test_what_does_not_fit_is_counted_and_changes_nothing() -> None:
    broker = Broker()
    sim = Simulator(broker)
    watcher = Watcher(broker.link(), "demo")
    for key in (KEYS.rows, KEYS.events, KEYS.progress):
        sim.link.publisher(key).put(b"nothing")
    watcher.stop()
    assert watcher.run_to_end(Playing(), 0) == Seen("demo", refused=3)


def lines_of(looks: Sequence[tuple[Seen, str]]) -> list[str]:
    console = Console(file=io.StringIO(), width=40)
    lines = Lines(console)
    for seen, warning in looks:
        lines.show(seen, warning)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def test_without_a_terminal_every_event_is_a_line_and_every_simulated_second() -> None:
    broker = Broker()
    sim = Simulator(broker)
    watcher = Watcher(broker.link(), "demo")
    screen = Playing(
        lambda: sim.tell(progress(phase="waiting", waiting_for="a1")),
        lambda: sim.tell(progress(phase="waiting", waiting_for="a1")),
        lambda: sim.tell(event("joined", agent="a1", lease=1), progress(10)),
        lambda: sim.tell(progress(900)),
        lambda: sim.tell(progress(1300), event("lost", 1200, agent="a1", why="its sign of life is gone")),
        sim.link.close,
    )
    with pytest.raises(NotSeen):
        watcher.run_to_end(screen, reconnect_s=0)
    assert lines_of(screen.shown) == [
        "waiting for a1",
        "0.00 s: joined a1: lease 1",
        "0.01 s: tick 10 of 10000, tilt 0.25 deg, 1.50 m to the goal",
        "1.20 s: lost a1: its sign of life is gone",
        "1.30 s: tick 1300 of 10000, tilt 0.25 deg, 1.50 m to the goal, a1 lost",
        "the simulator is gone",
    ]


def terminal(**more: str) -> Console:
    return Console(
        file=io.StringIO(), force_terminal=True, width=80, height=24, _environ={"TERM": "xterm-256color", **more}
    )


def drawn(console: Console) -> str:
    screen = Playing()
    broker = Broker()
    sim, watcher = Simulator(broker), Watcher(broker.link(), "demo")
    sim.tell(row(arms=2), progress(10), event("lost", agent="a1"))
    watcher.stop()
    watcher.run_to_end(screen, 0)
    with Picture(console, ASCII, Told()) as picture:
        picture.show(*screen.shown[-1])
        picture.show(*screen.shown[-1])
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_a_picture_is_drawn_on_the_second_screen_and_only_when_it_has_changed() -> None:
    said = drawn(terminal())
    assert said.index("\x1b[?1049h") < said.index("palanquin demo") < said.index("\x1b[?1049l")
    assert said.count("palanquin demo") == 1
    assert "\x1b[1;31mlost" in said


def test_no_color_is_obeyed() -> None:
    said = drawn(terminal(NO_COLOR="1"))
    assert "lost" in said
    assert "\x1b[1;31m" not in said
    assert "\x1b[3" not in said


def test_where_no_picture_is_possible_it_is_said_why(monkeypatch: pytest.MonkeyPatch) -> None:
    assert why_plain(terminal()) == ""
    assert why_plain(Console(file=io.StringIO())) == "standard output is no terminal"
    monkeypatch.setenv("TERM", "dumb")
    assert why_plain(terminal(TERM="dumb")) == "TERM=dumb has no cursor to move"


REFUSED = {
    "run": (["watch", "--run", "no/pe"], 2, "run: got 'no/pe', expected 1 to 40 of a-z"),
    "scenario": (["watch", "holdd", "--run", "x"], 2, "holdd"),
    "credential": (["watch", "--run", "x", "--credential", "nowhere"], 2, "nowhere: no credential"),
    "address": (["watch", "--run", "x", "--connect", "here"], 2, "here"),
    "nobody": (["watch", "--run", "x", "--connect", "tcp/127.0.0.1:1", "--wait-s", "0"], 3, "tcp/127.0.0.1:1"),
    "no_terminal": (["run", "hold", "--watch"], 2, "--watch: standard output is no terminal, expected a terminal"),
}


@pytest.mark.parametrize(("arguments", "status", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_watched_is_refused_in_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], status: int, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    got, sentence = refused(arguments)
    assert (got, len(sentence.splitlines())) == (status, 1), sentence
    assert said in sentence
    assert not any(tmp_path.iterdir())
