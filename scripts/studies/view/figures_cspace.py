"""Figures of slices of the C-space: what is forbidden, and their paths after connectivity restoration.

Each figure is a function that takes data and returns a matplotlib `Figure`. Angles come in radians, as everywhere in
hplan, and are drawn in degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from studies.view.figure_data import earlier_links, reached_mask

from hplan.apps.view.figure_style import (
    FAINT,
    GOAL,
    INK,
    OBSTACLE,
    OBSTACLE_TINT,
    PATH,
    PATH_TINT,
    QUIET,
    RESTORED,
    START,
    new_figure,
    styled,
)
from hplan.base.arrays import BoolArray, IntArray
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.sections import ArmSections
from hplan.robot.planar_family import PlanarArm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def slices(
    arm: PlanarArm,
    sections: ArmSections,
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    numbers: Sequence[int],
) -> Figure:
    """Occupancy of theta3 slices, and what the start reaches in each."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    earlier = earlier_links(arm, sections, grid)
    figure = new_figure(9.6, 6.9, r"Slices of the C-space at constant $\theta_3$")
    panels = figure.subplots(2, 3)
    start, goal = np.asarray(start), np.asarray(goal)
    for place, (axes, number) in enumerate(zip(panels.flat, numbers, strict=False)):
        occupied = occupancy.occupied[:, :, number]
        reached = reached_mask(~occupied, (int(start[0]), int(start[1])))
        feasible = bool(reached[goal[0], goal[1]])
        paint(axes, grid, [(reached, PATH_TINT), (occupied, OBSTACLE_TINT), (occupied & earlier, OBSTACLE)])
        _ends(axes, grid, start, goal)
        degree_axes(axes, grid, x_label=place >= 3, y_label=place % 3 == 0)
        value = np.degrees(grid.axis(2)[number])
        axes.set_title(f"$\\theta_3$ = {value:g}°:  " + ("goal is reached" if feasible else "no path"),
                       color=PATH if feasible else OBSTACLE, fontweight="bold")  # fmt: skip
    figure.legend(
        handles=[
            Patch(fc=OBSTACLE, label="links 1, 2 collide"),
            Patch(fc=OBSTACLE_TINT, label="link 3 collides"),
            Patch(fc=PATH_TINT, label="free, reached from the start"),
            Patch(fc="white", ec=QUIET, lw=0.6, label="free, not reached"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="outside lower center", ncols=6, columnspacing=1.4, handlelength=1.4,
    )  # fmt: skip
    return figure


@styled
def slice_paths(
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    paths: Mapping[int, IntArray],
    heads: Mapping[int, IntArray],
    numbers: Sequence[int],
) -> Figure:
    """Paths of slices after connectivity restoration: their own, or the part kept of the first slice path."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(9.6, 9.2, r"Slice paths after connectivity restoration")
    panels = figure.add_gridspec(3, 3, height_ratios=(1.0, 1.0, 0.72))
    first = paths[min(paths)]
    for place, number in enumerate(numbers[:6]):
        axes = figure.add_subplot(panels[place // 3, place % 3])
        paint(axes, grid, [(occupancy.occupied[:, :, number], OBSTACLE_TINT)])
        if number in paths:
            _line(axes, grid, paths[number], color=PATH, lw=2.4, zorder=5)
            length = np.degrees(np.linalg.norm(np.diff(grid.coordinates(paths[number]), axis=0), axis=1).sum())
            says = f"{length:.1f}°, {len(paths[number])} points"
        else:
            _line(axes, grid, first, color=QUIET, lw=1.1, ls=(0, (2, 1.5)), zorder=4)
            _line(axes, grid, heads[number], color=RESTORED, lw=3.0, zorder=5)
            says = f"{len(heads[number])} of {len(first)} points kept"
            if len(heads[number]) < len(first):
                cut = np.degrees(grid.coordinates(first[len(heads[number])]))
                axes.plot(cut[0], cut[1], "x", color=INK, ms=7.5, mew=2.0, zorder=7)
        _ends(axes, grid, start, goal)
        degree_axes(axes, grid, x_label=place >= 3, y_label=place % 3 == 0)
        axes.set_title(f"$\\theta_3$ = {np.degrees(grid.axis(2)[number]):g}°:  {says}", fontweight="bold",
                       color=PATH if number in paths else INK)  # fmt: skip
    _draw_kept(figure.add_subplot(panels[2, :]), occupancy, first, heads)
    figure.legend(
        handles=[
            Line2D([], [], color=PATH, lw=2.4, label="path of the slice"),
            Line2D([], [], color=RESTORED, lw=3.0, label="kept"),
            Line2D([], [], color=QUIET, lw=1.1, ls=(0, (2, 1.5)), label="cut off"),
            Patch(fc=OBSTACLE_TINT, label="forbidden"),
            Line2D([], [], marker="x", color=INK, ls="none", ms=7, mew=2, label="cut here"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="outside lower center", ncols=7, columnspacing=1.4,
    )  # fmt: skip
    return figure


def _draw_kept(axes: Axes, occupancy: Occupancy, first: IntArray, heads: Mapping[int, IntArray]) -> None:
    """Draw for each slice how much of the first slice path is kept, and where it is forbidden."""
    from matplotlib.colors import to_rgb

    grid, source, whole = occupancy.grid, int(first[0, 2]), len(first)
    order = [*sorted(heads), source]
    image = np.empty((whole, len(order), 3))
    for column, number in enumerate(order):
        image[:, column] = to_rgb(FAINT)
        image[: whole if number == source else len(heads[number]), column] = to_rgb(
            PATH if number == source else RESTORED
        )
        image[occupancy.occupied[first[:, 0], first[:, 1], number], column] = to_rgb(OBSTACLE_TINT)
    degrees = np.degrees(grid.axis(2)[order])
    half = 0.5 * float(np.degrees(grid.step[2]))
    axes.imshow(
        image, origin="lower", aspect="auto", interpolation="nearest",
        extent=(float(degrees[0]) - half, float(degrees[-1]) + half, 0.5, whole + 0.5),
    )  # fmt: skip
    axes.annotate(
        "restored in this direction", xy=(degrees[0] + 0.30 * (degrees[-1] - degrees[0]), 0.3 * whole),
        xytext=(degrees[-1] - 6.0 * half, 0.3 * whole), va="center", ha="right", color=INK,
        arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.2},
    )  # fmt: skip
    axes.set_title(f"The path at $\\theta_3$ = {degrees[-1]:g}°, carried back slice by slice")
    axes.set_xlabel(r"slice $\theta_3$ [deg]")
    axes.set_ylabel("waypoint [number]")


def degree_axes(axes: Axes, grid: Grid, *, x_label: bool = True, y_label: bool = True) -> None:
    """Give axes the range and look of (theta1, theta2) in degrees."""
    from matplotlib.ticker import MultipleLocator

    low, high = np.degrees(grid.lower), np.degrees(grid.coordinates(np.array(grid.shape) - 1))
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
    half = 0.5 * np.degrees(grid.step)
    axes.set_xlim(low[0] - half[0], high[0] + half[0])
    axes.set_ylim(low[1] - half[1], high[1] + half[1])
    axes.xaxis.set_major_locator(MultipleLocator(30.0))
    axes.yaxis.set_major_locator(MultipleLocator(30.0))
    axes.set_xlabel(r"$\theta_1$ [deg]" if x_label else "")
    axes.set_ylabel(r"$\theta_2$ [deg]" if y_label else "")
    axes.tick_params(labelbottom=x_label, labelleft=y_label)


def paint(axes: Axes, grid: Grid, layers: Sequence[tuple[BoolArray, str]], background: str = "white") -> None:
    """Paint masks of a (theta1, theta2) slice, later ones over earlier ones."""
    from matplotlib.colors import to_rgb

    image = np.empty((*grid.shape[:2], 3))
    image[:] = to_rgb(background)
    for mask, color in layers:
        image[mask] = to_rgb(color)
    low = np.degrees(grid.lower - 0.5 * grid.step)
    high = np.degrees(grid.coordinates(np.array(grid.shape) - 1) + 0.5 * grid.step)
    axes.imshow(
        image.transpose(1, 0, 2),
        origin="lower",
        extent=(float(low[0]), float(high[0]), float(low[1]), float(high[1])),
        interpolation="nearest",
        zorder=1,
    )


def _ends(axes: Axes, grid: Grid, start: ArrayLike, goal: ArrayLike) -> None:
    """Mark the start's and the goal's place in a slice."""
    for node, color, marker in ((start, START, "o"), (goal, GOAL, "s")):
        place = np.degrees(grid.coordinates(node))
        axes.plot(
            place[0], place[1], marker, color=color, ms=7, mec="white", mew=1.0, zorder=8, clip_on=False, ls="none"
        )


def _line(axes: Axes, grid: Grid, path: IntArray, **look: Any) -> None:
    """Draw a path's (theta1, theta2) over a slice."""
    place = np.degrees(grid.coordinates(path))
    axes.plot(place[:, 0], place[:, 1], **look)
