"""Figure of the comparison: nodes, time and cost, the paper's and the measured ones, and where the nodes go."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from studies.paper.measure import PAPER_DENSE, PAPER_TWO_LEVEL, Reproduction, Run

from hplan.apps.view.figure_style import FAINT, INK, OBSTACLE, PATH, RESTORED, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ROWS = ("paper: dense A*", "paper: two-level", "here: dense A*", "here: two-level, plain", "here: two-level, hplan")


@styled
def comparison(numbers: Reproduction, expansions: Mapping[int, int], found: Collection[int]) -> Figure:
    """Dense A* and the two-level method: nodes expanded, time and cost, and the nodes of every slice search."""
    figure = new_figure(12.4, 7.4, "Comparison of dense A* and the two-level method")
    panels = figure.add_gridspec(2, 3, width_ratios=(1.35, 1.2, 1.0), height_ratios=(1.0, 0.9))
    nodes, times, costs = (figure.add_subplot(panels[0, column]) for column in range(3))
    _draw_nodes(nodes, numbers)
    _draw_times(times, numbers)
    _draw_costs(costs, numbers)
    for axes in (nodes, times, costs):
        axes.set_yticks(range(len(_ROWS)), _ROWS if axes is nodes else [""] * len(_ROWS))
        axes.set_ylim(len(_ROWS) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.axhline(1.5, color=FAINT, lw=1.0, zorder=0)
    _draw_slices(figure.add_subplot(panels[1, :]), expansions, found)
    return figure


def _runs(r: Reproduction) -> list[Run]:
    """The searches in the order of the rows."""
    return [PAPER_DENSE, PAPER_TWO_LEVEL, *(r.runs[name] for name in ("dense", "plain", "hplan"))]


def _draw_nodes(axes: Axes, r: Reproduction) -> None:
    """Draw the nodes that each method expands."""
    from matplotlib.patches import Patch

    (layers, second), dense = r.runs["plain"][2:4], r.runs["dense"].second
    theirs, own = (PAPER_DENSE.second, PAPER_TWO_LEVEL.second), r.runs["hplan"]
    axes.barh([0, 2], [theirs[0], dense], color=INK, height=0.6)
    axes.barh([3], [layers], color=RESTORED, height=0.6)
    axes.barh([1, 3], [theirs[1], second], left=[0, layers], color=PATH, height=0.6)
    for row, x, text in (
        (0, theirs[0], f"{theirs[0]:,}"),
        (1, theirs[1], f"{theirs[1]:,}; layers not given"),
        (2, dense, f"{dense:,}"),
        (3, layers + second, f"{layers:,} + {second:,}"),
        (4, 0, f"{own.layers:,} jump points,\n{own.second:,} rows and nodes: other units of work"),
    ):
        axes.text(x + 3000, row, text, va="center", fontsize=8)
    axes.set_xlim(0.0, 1.5 * theirs[0])
    axes.set_xticks([0, 50_000, 100_000, 150_000], ["0", "50k", "100k", "150k"])
    axes.set_xlabel("nodes expanded")
    axes.set_title("Nodes", fontweight="bold")
    axes.legend(
        handles=[Patch(fc=RESTORED, label="layers"), Patch(fc=PATH, label="second level")], loc="upper center",
        bbox_to_anchor=(0.64, 0.83), ncols=2, columnspacing=1.2, handlelength=1.2,
    )  # fmt: skip


def _draw_times(axes: Axes, r: Reproduction) -> None:
    """Draw the times on a logarithmic axis, and the ratios to the dense search of the same machine."""
    times_ms = [run.ms for run in _runs(r)]
    ratios = [times_ms[0 if row < 2 else 2] / time_ms for row, time_ms in enumerate(times_ms)]
    axes.barh(range(5), times_ms, color=[INK, PATH, INK, PATH, PATH], height=0.6, left=0.05)
    axes.set_xscale("log")
    for row, (time_ms, ratio) in enumerate(zip(times_ms, ratios, strict=True)):
        text = f"{time_ms / 1e3:g} s" if row < 2 else f"{time_ms:.3g} ms"
        faster = "" if row in (0, 2) else f",  {ratio:.1f} x faster" if ratio < 10.0 else f",  {ratio:.0f} x faster"
        axes.text(1.25 * time_ms, row, text + faster, va="center", fontsize=8)
    axes.set_xlim(0.05, 3e6)
    axes.set_xticks([0.1, 1.0, 10.0, 100.0, 1e3, 1e4], ["0.1 ms", "1 ms", "10 ms", "0.1 s", "1 s", "10 s"])
    axes.minorticks_off()
    axes.set_xlabel("time, logarithmic")
    axes.set_title("Time", fontweight="bold")


def _draw_costs(axes: Axes, r: Reproduction) -> None:
    """Draw the costs."""
    for row, (cost, count, *_) in enumerate(_runs(r)):
        axes.plot(cost, row, "o", color=INK if row in (0, 2) else PATH, ms=7, zorder=4)
        axes.text(cost, row - 0.3, f"  {cost:.6f}°, {count} points", va="center", fontsize=8)
    axes.set_xlim(145.0, 146.6)
    axes.set_xticks([145.0, 145.5, 146.0, 146.5])
    axes.set_xlabel("cost [deg]")
    axes.set_title("Cost", fontweight="bold")


def _draw_slices(axes: Axes, expansions: Mapping[int, int], found: Collection[int]) -> None:
    """Draw the nodes expanded in every slice, by whether it has a path."""
    from matplotlib.patches import Patch

    order = np.array(sorted(expansions))
    values = np.array([expansions[int(number)] for number in order])
    has_path = np.array([int(number) in found for number in order])
    for mask, color in ((~has_path, OBSTACLE), (has_path, PATH)):
        axes.bar(order[mask], values[mask], 0.82, color=color)
    axes.set_xlim(order[0] - 1.0, order[-1] + 1.0)
    axes.set_ylim(0.0, 1.3 * values.max())
    axes.set_xlabel(r"slice $\theta_3$ [deg]")
    axes.set_ylabel("nodes expanded")
    axes.yaxis.set_major_formatter(lambda value, _: f"{int(value):,}")
    axes.set_title("First level, to the letter: the nodes of every slice search, which the paper does not count",
                   fontweight="bold")  # fmt: skip
    axes.legend(
        handles=[
            Patch(fc=color, label=f"{int(mask.sum())} slices {name} a path: {int(values[mask].sum()):,} nodes")
            for mask, color, name in ((~has_path, OBSTACLE, "without"), (has_path, PATH, "with"))
        ],
        loc="upper center", ncols=2, columnspacing=1.6,
    )  # fmt: skip
