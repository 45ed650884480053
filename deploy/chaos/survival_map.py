"""The survival map: in every cell a bar of its runs by their outcomes. Needs the extra ``view``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # before pyplot: no display needed

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle

from deploy.chaos.matrix import Judged
from deploy.chaos.outcome import Outcome

PAINT: Mapping[Outcome, tuple[str, str]] = {
    "carries": ("#009E73", ""),
    "stops": ("#56B4E9", ""),
    "moves": ("#E69F00", "//"),
    "drops": ("#D55E00", "xx"),
    "unknown": ("#CCCCCC", ".."),
}
"""Colour (Okabe and Ito's) and hatching: told apart without colours, too."""
MARGIN = 0.06


def draw_map(cells: Sequence[Judged], file: Path) -> None:
    """Rows are faults, columns teams."""
    faults = list(dict.fromkeys(each.cell.fault for each in cells))
    teams = list(dict.fromkeys((each.cell.arms, each.cell.preset) for each in cells))
    size = (3.2 + 1.7 * len(teams), 1.6 + 0.36 * len(faults))
    figure, axes = plt.subplots(figsize=size, layout="constrained")
    for each in cells:
        _bar(axes, each, teams.index((each.cell.arms, each.cell.preset)), faults.index(each.cell.fault))
    axes.set_xlim(0, len(teams))
    axes.set_ylim(len(faults), 0)
    axes.set_xticks([k + 0.5 for k in range(len(teams))], [f"{arms} arms\n{preset}" for arms, preset in teams])
    axes.set_yticks([k + 0.5 for k in range(len(faults))], faults)
    axes.tick_params(length=0, labelsize=8)
    axes.xaxis.tick_top()
    for spine in axes.spines.values():
        spine.set_visible(False)
    legend = [
        Patch(facecolor=colour, hatch=hatch, edgecolor="white", label=name) for name, (colour, hatch) in PAINT.items()
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=len(legend), fontsize=8, frameon=False)
    figure.savefig(file, dpi=130, metadata={"Software": None})
    plt.close(figure)


def _bar(axes: Axes, each: Judged, column: int, row: int) -> None:
    total, begin = sum(each.outcomes.values()), 0.0
    for outcome, (colour, hatch) in PAINT.items():
        count = each.outcomes[outcome]
        if not count:
            continue
        width = (1 - 2 * MARGIN) * count / total
        place = (column + MARGIN + begin, row + MARGIN)
        axes.add_patch(
            Rectangle(place, width, 1 - 2 * MARGIN, facecolor=colour, hatch=hatch, edgecolor="white", linewidth=0.5)
        )
        axes.text(
            place[0] + width / 2, row + 0.5, str(count), ha="center", va="center", fontsize=7,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8, "alpha": 0.8},
        )  # fmt: skip
        begin += width
