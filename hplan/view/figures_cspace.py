"""Figures of the C-space in the plane: link by link, its slices, their paths, and connectivity restoration.

Each figure is a function that takes data and returns a matplotlib `Figure`. Angles come in radians, as everywhere in
hplan, and are drawn in degrees.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import BoolArray, IntArray
from hplan.grid import Grid, Occupancy
from hplan.robot import PlanarArm
from hplan.section import ArmSections
from hplan.view.figure_data import disc_of, earlier_links, half_angles, pair_mask, reached_mask
from hplan.view.figure_style import (
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def two_link_cspace(arm: PlanarArm, sections: ArmSections, grid: Grid) -> Figure:
    """Figure 8: the case that applies to each link over theta1, and the C-space of (theta1, theta2).

    Args:
        arm: The planar chain, at least two links.
        sections: One disc for each link (capsule model).
        grid: Grid over the planar joints.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = new_figure(10.6, 4.9, "C-space, link by link")
    left, right = figure.subplots(1, 2, width_ratios=(1.12, 1.0))
    theta = np.linspace(float(grid.lower[0]), float(grid.coordinates(np.array(grid.shape) - 1)[0]), 7201)
    heading = arm.signs[0] * theta + arm.offsets[0]
    elbow = arm.lengths[0] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    first, first_radius = disc_of(sections, 0)
    second, radius = disc_of(sections, 1)
    length = float(arm.lengths[1])
    offset = second - elbow
    rho = np.hypot(offset[:, 0], offset[:, 1])
    bearing = (np.arctan2(offset[:, 1], offset[:, 0]) - heading + math.pi) % (2 * math.pi) - math.pi
    bearing = arm.signs[1] * (bearing - arm.offsets[1])
    half = half_angles(rho, length, radius)
    degrees = np.degrees(theta)
    bounds = (radius, math.hypot(length, radius), length + radius)
    top = 1.22 * max(float(np.hypot(*first)), float(rho.max()))
    left.axhspan(bounds[0], bounds[1], color=OBSTACLE_TINT, alpha=0.55, lw=0)
    left.axhspan(bounds[1], bounds[2], color=RESTORED, alpha=0.35, lw=0)
    left.axhspan(0.0, bounds[0], color=OBSTACLE, alpha=0.75, lw=0)
    left.plot(degrees, rho, color=PATH, lw=2.2)
    left.axhline(float(np.hypot(*first)), color=INK, lw=1.6)
    left.axhline(float(arm.lengths[0]) + first_radius, color=INK, lw=1.0, ls=(0, (3, 2)))
    middle = 0.5 * float(degrees[0] + degrees[-1])
    for height, text, color, va in (
        (float(np.hypot(*first)) + 0.02, r"link 1: $\rho$ from the shoulder, constant", INK, "bottom"),
        (float(arm.lengths[0]) + first_radius + 0.02, "reach $L_1 + R_1$ of link 1: no forbidden angle", INK, "bottom"),
        (bounds[2] + 0.025, "case 3: out of link 2's reach", QUIET, "bottom"),
        (0.5 * (bounds[1] + bounds[2]), "case 2: the tip of link 2 touches", INK, "center"),
        (0.5 * (bounds[0] + bounds[1]) - 0.12, "case 1: the side of link 2 touches", INK, "center"),
        (0.5 * bounds[0], r"$\rho \leq R_2$: every $\theta_2$ is forbidden", INK, "center"),
    ):
        left.text(middle + 6.0, height, text, color=color, va=va, ha="center", fontsize=8)
    lowest = int(np.argmin(rho))
    left.text(float(degrees[lowest]), float(rho[lowest]) - 0.02, r"link 2: $\rho$ from the elbow", color=PATH, va="top",
              ha="center", fontsize=8)  # fmt: skip
    left.set_xlim(degrees[0], degrees[-1])
    left.set_ylim(0.0, top)
    left.set_xticks(np.arange(degrees[0], degrees[-1] + 1e-6, 15.0))
    left.set_xlabel(r"$\theta_1$ [deg]")
    left.set_ylabel(r"distance $\rho$ from joint to disc [m]")
    left.set_title("Which case applies")

    _paint(right, grid, [(pair_mask(arm, sections, grid), OBSTACLE_TINT)])
    case_two = rho > bounds[1]
    for mask, color in ((~case_two, OBSTACLE), (case_two, RESTORED)):
        for side in (-1.0, 1.0):
            edge = np.where(mask, np.degrees(bearing + side * half), np.nan)
            right.plot(degrees, edge, color=color, lw=2.0, zorder=4)
    right.plot(degrees, np.where(np.isfinite(half), np.degrees(bearing), np.nan), color=INK, lw=0.9,
               ls=(0, (5, 2, 1, 2)), zorder=4)  # fmt: skip
    _degree_axes(right, grid)
    right.set_title("Forbidden intervals of link 2 and the nodes inside")
    right.legend(
        handles=[
            Patch(fc=OBSTACLE_TINT, label="occupied nodes"),
            Line2D([], [], color=OBSTACLE, lw=2, label="equation (1)"),
            Line2D([], [], color=RESTORED, lw=2, label="equation (2)"),
            Line2D([], [], color=INK, lw=0.9, ls=(0, (5, 2, 1, 2)), label=r"bearing $\varphi$"),
        ],
        loc="upper right", frameon=True, framealpha=0.92, edgecolor="none",
    )  # fmt: skip
    return figure


@styled
def slices(
    arm: PlanarArm,
    sections: ArmSections,
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    numbers: Sequence[int],
) -> Figure:
    """Figure 9: occupancy of theta3 slices, and what the start reaches in each.

    Args:
        arm: The planar chain, three links.
        sections: The obstacles' sections.
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        numbers: Slices to show, at most six.
    """
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
        _paint(
            axes,
            grid,
            [(reached, PATH_TINT), (occupied, OBSTACLE_TINT), (occupied & earlier, OBSTACLE)],
        )
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, x_label=place >= 3, y_label=place % 3 == 0)
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
def layer_paths(
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    paths: Mapping[int, IntArray],
    expansions: Mapping[int, int],
    numbers: Sequence[int],
) -> Figure:
    """Figure 10: the search of each slice on its own, and what it costs.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        paths: Slice -> (m, 3) path, for the slices that have one.
        expansions: Slice -> nodes expanded by a plain A* there, for every slice searched.
        numbers: Slices to show, at most four.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(10.4, 6.2, "First level: a 2-D A* in every slice")
    panels = figure.add_gridspec(2, 4, height_ratios=(1.25, 1.0))
    start, goal = np.asarray(start), np.asarray(goal)
    for place, number in enumerate(numbers[:4]):
        axes = figure.add_subplot(panels[0, place])
        _paint(axes, grid, [(occupancy.occupied[:, :, number], OBSTACLE_TINT)])
        value = np.degrees(grid.axis(2)[number])
        if number in paths:
            _line(axes, grid, paths[number], color=PATH, lw=2.2, zorder=5)
            length = np.degrees(np.linalg.norm(np.diff(grid.coordinates(paths[number]), axis=0), axis=1).sum())
            verdict = f"{length:.1f}° long"
        else:
            verdict = "no path"
        axes.set_title(f"$\\theta_3$ = {value:g}°:  {verdict}", color=PATH if number in paths else OBSTACLE,
                       fontweight="bold")  # fmt: skip
        axes.text(0.97, 0.97, f"{_grouped(expansions[number])} expansions", transform=axes.transAxes, ha="right",
                  va="top", fontsize=8, zorder=7)  # fmt: skip
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, y_label=place == 0)
    bars = figure.add_subplot(panels[1, :])
    order = np.array(sorted(expansions))
    values = np.array([expansions[int(k)] for k in order])
    found = np.array([int(k) in paths for k in order])
    degrees = np.degrees(grid.axis(2)[order])
    width = float(np.degrees(grid.step[2]))
    bars.bar(degrees[~found], values[~found], width * 0.82, color=OBSTACLE)
    bars.bar(degrees[found], values[found], width * 0.82, color=PATH)
    bars.set_xlim(degrees[0] - width, degrees[-1] + width)
    bars.set_xlabel(r"slice $\theta_3$ [deg]")
    bars.set_ylabel("nodes expanded")
    bars.yaxis.set_major_formatter(lambda value, _: _grouped(int(value)))
    bars.set_ylim(0.0, 1.3 * values.max())
    bars.legend(
        handles=[
            Patch(fc=OBSTACLE, label=f"{int((~found).sum())} slices without a path: "
                  f"{_grouped(int(values[~found].sum()))} expansions"),
            Patch(fc=PATH, label=f"{int(found.sum())} slices with a path: "
                  f"{_grouped(int(values[found].sum()))} expansions"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="upper center", ncols=4, columnspacing=1.6,
    )  # fmt: skip
    return figure


@styled
def restoration(
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    first_path: IntArray,
    heads: Mapping[int, IntArray],
    numbers: Sequence[int],
) -> Figure:
    """Figure 11: the first slice path carried back towards the start, cut before each contact.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        first_path: (m, 3) path of the first slice that has one.
        heads: Slice -> (k, 3) part of that path kept there.
        numbers: Slices to show, at most four, out of `heads`.
    """
    from matplotlib.colors import to_rgb
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(10.4, 6.2, "Connectivity restoration: carry the first path back, cut it before contact")
    panels = figure.add_gridspec(2, 4, height_ratios=(1.25, 1.0))
    whole = len(first_path)
    for place, number in enumerate(numbers[:4]):
        axes = figure.add_subplot(panels[0, place])
        head = heads[number]
        _paint(axes, grid, [(occupancy.occupied[:, :, number], OBSTACLE_TINT)])
        _line(axes, grid, first_path, color=QUIET, lw=1.1, ls=(0, (2, 1.5)), zorder=4)
        _line(axes, grid, head, color=RESTORED, lw=3.0, zorder=5)
        if len(head) < whole:
            cut = np.degrees(grid.coordinates(first_path[len(head)]))
            axes.plot(cut[0], cut[1], "x", color=INK, ms=7.5, mew=2.0, zorder=7)
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, y_label=place == 0)
        value = np.degrees(grid.axis(2)[number])
        axes.set_title(f"$\\theta_3$ = {value:g}°:  {len(head)} of {whole} points", fontweight="bold")
    unrolled = figure.add_subplot(panels[1, :])
    source = int(first_path[0, 2])
    order = [*sorted(heads), source]
    image = np.empty((whole, len(order), 3))
    for column, number in enumerate(order):
        blocked = occupancy.occupied[first_path[:, 0], first_path[:, 1], number]
        kept = whole if number == source else len(heads[number])
        image[:, column] = to_rgb(FAINT)
        image[:kept, column] = to_rgb(PATH if number == source else RESTORED)
        image[blocked, column] = to_rgb(OBSTACLE_TINT)
    degrees = np.degrees(grid.axis(2)[order])
    width = float(np.degrees(grid.step[2]))
    unrolled.imshow(
        image, origin="lower", aspect="auto", interpolation="nearest",
        extent=(float(degrees[0]) - 0.5 * width, float(degrees[-1]) + 0.5 * width, -0.5, whole - 0.5),
    )  # fmt: skip
    unrolled.annotate(
        "restored in this direction", xy=(degrees[0] + 0.30 * (degrees[-1] - degrees[0]), 0.3 * whole),
        xytext=(degrees[-1] - 3.0 * width, 0.3 * whole), va="center", ha="right", color=INK,
        arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.2},
    )  # fmt: skip
    unrolled.set_xlabel(r"slice $\theta_3$ [deg]")
    unrolled.set_ylabel("point along the path")
    figure.legend(
        handles=[
            Patch(fc=PATH, label=f"path at $\\theta_3$ = {np.degrees(grid.axis(2)[source]):g}°"),
            Patch(fc=RESTORED, label="kept"),
            Patch(fc=FAINT, label="cut off"),
            Patch(fc=OBSTACLE_TINT, label="forbidden"),
            Line2D([], [], marker="x", color=INK, ls="none", ms=7, mew=2, label="first contact"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="outside lower center", ncols=7, columnspacing=1.4,
    )  # fmt: skip
    return figure


def _degree_axes(axes: Axes, grid: Grid, *, x_label: bool = True, y_label: bool = True) -> None:
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


def _paint(axes: Axes, grid: Grid, layers: Sequence[tuple[BoolArray, str]], background: str = "white") -> None:
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


def _grouped(count: int) -> str:
    """A number with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")
