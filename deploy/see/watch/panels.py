"""The dashboard's panels but the top view: each a pure function from what is seen to lines of a given width."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import groupby

from rich.text import Text

from deploy.see.watch.canvas import Glyphs
from deploy.see.watch.rows import share_percent
from deploy.see.watch.seen import LEADER, Seen

STATE_STYLE = {
    "in": "green",
    "there": "green",
    "awaited": "yellow",
    "leaving": "cyan",
    "left": "dim",
    "lost": "bold red",
}
WELL = ("in", "there")
"""States with which nothing is the matter."""
PHASE_STYLE = {"unheard": "yellow", "waiting": "yellow", "running": "green", "ended": "bold"}
VERDICT_STYLE = {"holds": "bold green", "violated": "bold red", "unknown": "bold yellow"}
SCALES_DEG = (1, 2, 5, 10, 20, 45, 90, 180)
"""Full deflections of the tilt gauge: the smallest that holds all tilt so far."""
LONGEST_NAME = 8


def fitted(line: Text, width: int, glyphs: Glyphs) -> Text:
    """The line, cut where it is longer than ``width`` cells."""
    if line.cell_len <= width:
        return line
    line = line.copy()
    line.truncate(max(0, width - len(glyphs.more)))
    return line.append(glyphs.more) if width >= len(glyphs.more) else line


def printable(text: str) -> str:
    """Without what would move a terminal's cursor: an event may quote what a stranger sent."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def number(value: float, digits: int = 0, unit: str = "", *, signed: bool = False) -> str:
    """A number with its unit, or a dash for none."""
    if not math.isfinite(value):
        return f"- {unit}".strip()
    rounded = round(value, digits) + 0.0  # no minus zero
    return f"{rounded:{'+' if signed and rounded else ''}.{digits}f} {unit}".strip()


def bar(part: float, width: int, glyphs: Glyphs, style: str, mark: float = math.nan) -> Text:
    """A bar that is filled to ``part`` of 1, with a mark at another; empty for NaN."""
    fill = width * min(1.0, max(0.0, part)) if math.isfinite(part) else 0.0
    steps = len(glyphs.parts) + 1
    whole, rest = divmod(round(fill * steps), steps)
    filled = glyphs.full * whole + (glyphs.parts[rest - 1] if rest else "")
    line = Text(filled, style) + Text(glyphs.empty * (width - len(filled)), "dim")
    if math.isfinite(mark) and width:
        at = min(width - 1, max(0, math.floor(width * mark)))
        line = line[:at] + Text(glyphs.mark, "bold") + line[at + 1 :]
    return line


def titled(title: str, width: int, glyphs: Glyphs) -> Text:
    """A panel's title, with a rule to its end."""
    line = Text(f"{title} ", "bold")
    return fitted(line.append(glyphs.rule * max(0, width - line.cell_len), "dim"), width, glyphs)


def head(seen: Seen, width: int, glyphs: Glyphs, warning: str = "") -> list[Text]:
    """Which run, how far it is, and what is worth a warning."""
    parts = [Text(f"palanquin {printable(seen.run)}", "bold"), _phase(seen)]
    progress = seen.progress
    if progress is not None:
        total_s = progress.time_s * progress.ticks / progress.tick if progress.tick else math.nan
        of = f" of {number(total_s, 1)}" if math.isfinite(total_s) else ""
        parts += [Text(f"tick {seen.tick} of {progress.ticks}"), Text(f"{number(seen.time_s, 1)}{of} s")]
        if progress.real_time_factor > 0:
            parts.append(Text(f"x{number(progress.real_time_factor, 2)} real time"))
        if progress.goal_distance_m >= 0:
            parts.append(Text(f"{number(progress.goal_distance_m, 2)} m to the goal"))
        if progress.missed_ticks or progress.age_max_ticks:
            missed = f"{progress.missed_ticks} ticks missed, oldest command {progress.age_max_ticks}"
            parts.append(Text(missed, "yellow"))
    if state := seen.state_of(LEADER):
        pull = f", pulls {number(seen.load.pull_N, 0, 'N')}" if seen.load is not None and state == "in" else ""
        parts.append(Text.assemble("leader ", (state, STATE_STYLE.get(state, "")), pull))
    if warning:
        parts.append(Text(warning, "bold red"))
    if seen.refused:
        parts.append(Text(f"{seen.refused} messages did not fit", "red"))
    lines = flowing(parts, width, glyphs)
    if progress is not None:
        lines.append(bar(seen.tick / max(1, progress.ticks), width, glyphs, "blue"))
    return lines


def _phase(seen: Seen) -> Text:
    phase = seen.phase
    if phase == "waiting" and seen.progress is not None:
        return Text(f"waiting for {printable(seen.progress.waiting_for)}", PHASE_STYLE[phase])
    if phase == "ended":
        why = printable(seen.ended or "")
        verdict = printable(seen.verdict) or "ended"
        return Text.assemble((verdict, VERDICT_STYLE.get(verdict, "bold")), f": {why}")
    return Text("no word yet" if phase == "unheard" else phase, PHASE_STYLE[phase])


def flowing(parts: Iterable[Text], width: int, glyphs: Glyphs, gap: str = "   ") -> list[Text]:
    """The parts side by side, in as many lines as they need."""
    lines: list[Text] = []
    for part in parts:
        if lines and lines[-1].cell_len + len(gap) + part.cell_len <= width:
            lines[-1] = lines[-1] + Text(gap) + part
        else:
            lines.append(part)
    return [fitted(line, width, glyphs) for line in lines]


def arms_table(seen: Seen, width: int, glyphs: Glyphs, most_lines: int | None = None) -> list[Text]:
    """A line for each arm: state, age of its command in ticks, stiffness, and what it bears. A full bar is twice an
    equal share, which has a mark.

    Args:
        most_lines: where there are more arms, those who are in are left out first, and the last line counts the others.
    """
    names, shares = seen.arm_names, share_percent(dict(seen.arms))
    broad = min(LONGEST_NAME, max(3, max(map(len, names), default=0)))
    head_line = f"{'arm':<{broad}} {'state':<7} {'age':>5} {'Nm/rad':>6} {'up N':>6} {'share':>5}"
    lines = [fitted(Text(head_line, "bold"), width, glyphs)]
    room = max(0, len(names) if most_lines is None else most_lines - 1)
    shown = names if len(names) <= room else _first(names, max(0, room - 1), seen)
    for name in shown:
        state, arm = seen.state_of(name), seen.arms.get(name)
        style = STATE_STYLE.get(state, "")
        line = Text.assemble((f"{name[:broad]:<{broad}}", "bold"), " ", (f"{state:<7}", style))
        if arm is not None:
            share = shares[name]
            stiff, up = number(arm.stiffness_Nm_rad), number(arm.up_N, 1)
            percent = f"{number(share)}%" if math.isfinite(share) else "-"
            line.append(f" {number(arm.age_ticks):>5} {stiff:>6} {up:>6} {percent:>5} ")
            equal = 100 / max(1, len(seen.arms))
            line += bar(share / (2 * equal), max(0, width - line.cell_len), glyphs, style, 0.5)
        lines.append(fitted(line, width, glyphs))
    if (others := [name for name in names if name not in shown]) and room:
        counted = groupby(sorted(seen.state_of(name) for name in others))
        text = ", ".join(f"{len(list(group))} {state or 'unknown'}" for state, group in counted)
        lines.append(fitted(Text(f"{len(others)} more: {text}", "dim"), width, glyphs))
    return lines


def _first(names: Sequence[str], room: int, seen: Seen) -> list[str]:
    """So many of the names, in their order: first of those with whom something is the matter."""
    kept = sorted(names, key=lambda name: seen.state_of(name) in WELL)[:room]
    return [name for name in names if name in kept]


def tilt_gauge(seen: Seen, width: int, glyphs: Glyphs) -> list[Text]:
    """How the load stands: tilt now as a bar, the most so far as a mark, the last minute as steps, and the rest as
    numbers."""
    load, start = seen.load, seen.start
    if load is None or start is None:
        return [fitted(Text("tilt: nothing seen yet", "dim"), width, glyphs)]
    known = [tilt for tilt in (load.tilt_deg, seen.tilt_max_deg) if math.isfinite(tilt)]
    scale = next((scale for scale in SCALES_DEG if scale >= max(known, default=0.0)), SCALES_DEG[-1])
    now, most = number(load.tilt_deg, 2, "deg"), number(seen.tilt_max_deg, 2, "deg")
    end = f" {scale} deg"
    gauge = bar(load.tilt_deg / scale, max(0, width - len(end)), glyphs, "magenta", seen.tilt_max_deg / scale)
    turn = (load.yaw_deg - start.yaw_deg + 180.0) % 360.0 - 180.0
    height = 1e3 * (load.p_WO[2] - start.p_WO[2])
    rest = [
        Text(f"roll {number(load.roll_deg, 2, signed=True)}"),
        Text(f"pitch {number(load.pitch_deg, 2, signed=True)}"),
        Text(f"turn {number(turn, 1, 'deg', signed=True)}"),
        Text(f"height {number(height, 0, 'mm', signed=True)}"),
    ]
    return [
        *flowing([Text(f"tilt {now}", "bold"), Text(f"most so far {most}")], width, glyphs),
        gauge + Text(end, "dim"),
        _lately(seen.tilts_deg, scale, width, glyphs),
        *flowing(rest, width, glyphs, gap="  "),
    ]


def _lately(tilts_deg: Sequence[float], scale: float, width: int, glyphs: Glyphs) -> Text:
    """The largest tilt of each of the last looks, the newest at the right."""
    end = " lately"
    room = max(1, width - len(end))
    return Text(f"{steps(tilts_deg[-room:], scale, glyphs):>{room}}", "magenta") + Text(end, "dim")


def steps(values: Sequence[float], full: float, glyphs: Glyphs) -> str:
    """A letter for each value, higher for larger ones; blank for NaN."""
    highest = len(glyphs.levels) - 1
    return "".join(
        glyphs.levels[min(highest, max(0, int(value / full * len(glyphs.levels))))] if math.isfinite(value) else " "
        for value in values
    )


def event_list(seen: Seen, width: int, height: int, glyphs: Glyphs) -> list[Text]:
    """The last events as sentences, the newest at the end."""
    lines = []
    for each in seen.happenings[-height:] if height > 0 else ():
        style = "yellow" if each.is_trouble else ""
        line = Text.assemble((f"{each.time_s:8.2f} s ", "dim"), (printable(each.text), style))
        lines.append(fitted(line, width, glyphs))
    return lines
