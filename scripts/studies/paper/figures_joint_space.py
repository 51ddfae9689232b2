"""Figures of the C-space in three dimensions: the obstacle, the sparse graph, and paths past it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from studies.view.figures_arm import draw_motion

from hplan.apps.view.cspace_surface import draw_cspace_obstacle, hidden, joint_box
from hplan.apps.view.figure_style import GOAL, INK, OBSTACLE, PATH, RESTORED, START, new_figure, styled
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.grid.grid import Grid
from hplan.robot.planar_family import PlanarArm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Height and direction of the viewer [deg]: the gap between obstacle and limits in front.
VIEW = (27.0, 128.0)
#: The same, from the goal's side.
OTHER_VIEW = (27.0, -38.0)


@styled
def cspace_obstacle(grid: Grid, field: FloatArray, start: ArrayLike, goal: ArrayLike, occupied: int) -> Figure:
    """The C-space obstacle from two sides."""
    share = 100.0 * occupied / grid.size
    figure = new_figure(
        11.4, 6.0, f"C-space of the three links: {occupied:,} of {grid.size:,} nodes forbidden ({share:.1f} %)"
    )
    for place, view, side in ((0, VIEW, "start"), (1, OTHER_VIEW, "goal")):
        axes: Any = figure.add_subplot(1, 2, place + 1, projection="3d", computed_zorder=False)
        towards = _draw_obstacle(axes, grid, field, view)
        for node, color, marker in ((start, START, "o"), (goal, GOAL, "s")):
            at = np.asarray(node, dtype=np.float64)
            covered = bool(hidden(field, at[None], towards)[0])
            axes.plot(*np.degrees(grid.coordinates(node))[:, None], marker, color=color, ms=9, mec="white", mew=1.2,
                      alpha=0.35 if covered else 1.0, zorder=9)  # fmt: skip
        joint_box(axes, grid, 0.96)
        figure.text(0.03 + 0.5 * place, 0.87, f"seen from the {side}'s side", fontweight="bold")
    figure.legend(handles=_handles(), loc="outside lower center", ncols=3)
    return figure


@styled
def sparse_path(
    grid: Grid,
    field: FloatArray,
    paths: Mapping[int, IntArray],
    heads: Mapping[int, IntArray],
    path: IntArray,
    *,
    view: tuple[float, float] = VIEW,
) -> Figure:
    """The sparse graph of slice paths and restored parts, and the path found in it."""
    from matplotlib.lines import Line2D

    figure = new_figure(8.4, 6.8, f"Path in the sparse graph: {_length(grid, path)}")
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    towards = _draw_obstacle(axes, grid, field, view)
    _draw_sparse_lines(axes, grid, field, heads, towards, RESTORED)
    _draw_sparse_lines(axes, grid, field, paths, towards, PATH)
    behind = _draw_path(axes, grid, field, path, towards)
    joint_box(axes, grid, 1.06)
    figure.legend(
        handles=[
            *_handles(),
            Line2D([], [], color=PATH, lw=1.6, label="slice paths"),
            Line2D([], [], color=RESTORED, lw=1.6, label="restored parts"),
            Line2D([], [], color=INK, lw=2.8, label="path (dotted: behind)" if behind else "path"),
        ],
        loc="outside lower center", ncols=6, columnspacing=1.3, handlelength=1.6,
    )  # fmt: skip
    return figure


@styled
def paths_in_cspace(
    grid: Grid, field: FloatArray, dense: IntArray, two_level: IntArray, *, view: tuple[float, float] = VIEW
) -> Figure:
    """The paths of both methods past the C-space obstacle."""
    from matplotlib.lines import Line2D

    figure = new_figure(8.4, 6.8, "Both paths in the C-space")
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    towards = _draw_obstacle(axes, grid, field, view)
    # The wider line below shows on both sides where the two coincide.
    behind = _draw_path(axes, grid, field, dense, towards, (PATH, 5.0, 1.8))
    behind |= _draw_path(axes, grid, field, two_level, towards, (INK, 1.8, 0.0))
    joint_box(axes, grid, 1.06)
    figure.legend(
        handles=[
            Line2D([], [], color=PATH, lw=5.0, label=f"dense A*: {_length(grid, dense)}"),
            Line2D([], [], color=INK, lw=1.8, label=f"two-level: {_length(grid, two_level)}"
                   + (" (dotted: behind)" if behind else "")),
            *_handles(),
        ],
        loc="outside lower center", ncols=5, columnspacing=1.3, handlelength=1.6,
    )  # fmt: skip
    return figure


@styled
def overview(arm: PlanarArm, centre: ArrayLike, radius: float, grid: Grid, field: FloatArray, path: IntArray) -> Figure:
    """The method in one picture: the path in the C-space, and the motion that it is."""
    figure = new_figure(11.0, 4.6, "", placed=True)
    axes: Any = figure.add_axes((0.0, 0.0, 0.43, 0.93), projection="3d", computed_zorder=False)
    towards = _draw_obstacle(axes, grid, field, VIEW)
    _draw_path(axes, grid, field, path, towards)
    joint_box(axes, grid, 0.98)
    right = figure.add_axes((0.5, 0.11, 0.49, 0.79))
    draw_motion(right, arm, centre, radius, grid.coordinates(path), color=INK)
    for x, text in ((0.02, "A path through joint space"), (0.5, "The same path as a motion of the arm")):
        figure.text(x, 0.945, text, fontweight="bold", fontsize=11.5)
    return figure


def _draw_obstacle(axes: Any, grid: Grid, field: FloatArray, view: tuple[float, float]) -> FloatArray:
    """Draw the C-space obstacle as `view` sees it; returns the unit vector to the viewer, in units of nodes."""
    axes.set_proj_type("ortho")
    axes.view_init(elev=view[0], azim=view[1])
    return draw_cspace_obstacle(axes, grid, field)


def _draw_sparse_lines(
    axes: Any, grid: Grid, field: FloatArray, pieces: Mapping[int, IntArray], towards: FloatArray, color: str
) -> None:
    """Draw the slice paths that the viewer sees."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    seen, covered = [], []
    for path in pieces.values():
        if len(path) < 2:
            continue
        behind = hidden(field, path.astype(np.float64), towards)
        points = np.degrees(grid.coordinates(path))
        segments = np.stack([points[:-1], points[1:]], axis=1)
        dark = behind[:-1] | behind[1:]
        seen.append(segments[~dark])
        covered.append(segments[dark])
    for parts, width, alpha, zorder in ((seen, 0.9, 0.75, 4.0), (covered, 0.5, 0.16, 3.0)):
        if sum(len(part) for part in parts) > 0:
            lines = np.concatenate(parts)
            axes.add_collection3d(Line3DCollection(lines, colors=color, linewidths=width, alpha=alpha, zorder=zorder))


def _draw_path(
    axes: Any,
    grid: Grid,
    field: FloatArray,
    path: IntArray,
    towards: FloatArray,
    look: tuple[str, float, float] = (INK, 2.8, 1.8),
) -> bool:
    """Draw a path with its ends, in a colour, a width and a white margin; returns whether a part of it is hidden."""
    points = np.degrees(grid.coordinates(path))
    covered = hidden(field, path.astype(np.float64), towards)
    color, width, halo = look
    draw_line(axes, points, covered, color, width, 7.0, halo=halo)
    for point, end, marker in ((points[0], START, "o"), (points[-1], GOAL, "s")):
        axes.plot(*point[:, None], marker, color=end, ms=9, mec="white", mew=1.2, zorder=9)
    return bool(covered.any())


def _length(grid: Grid, path: IntArray) -> str:
    """Length and number of points of a path, in words."""
    length = np.linalg.norm(np.diff(grid.coordinates(path), axis=0), axis=1).sum()
    return f"{math.degrees(length):.2f}°, {len(path)} points"


def _handles() -> list[Any]:
    """Handles for the legend: obstacle, start and goal."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Patch(fc=OBSTACLE, label="forbidden"),
        Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
        Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
    ]


def draw_line(
    axes: Any, points: FloatArray, covered: BoolArray, color: str, width: float, zorder: float, halo: float = 0.0
) -> None:
    """Draw a 3-D line, what is covered dotted and faint."""
    for index, last in _runs(covered):
        piece = points[index : last + 1]
        if covered[index]:
            axes.plot(*piece.T, color=color, lw=0.6 * width, alpha=0.55, ls=(0, (1, 1.4)), zorder=zorder)
        else:
            if halo > 0.0:
                axes.plot(*piece.T, color="white", lw=width + halo, zorder=zorder - 0.1)
            axes.plot(*piece.T, color=color, lw=width, zorder=zorder)


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """First and last index of each run of equal flags, each run reaching to the next one's first."""
    changes = np.flatnonzero(flags[1:] != flags[:-1]) + 1
    firsts = [0, *(int(change) for change in changes)]
    lasts = [*firsts[1:], len(flags) - 1]
    return list(zip(firsts, lasts, strict=True))
