"""Figure of the execution: snapshots of the arm on its way along the path."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from studies.view.figures_arm import draw_arm, draw_disc

from hplan.apps.view.figure_style import FAINT, GOAL, PATH, START, new_figure, styled
from hplan.base.arrays import FloatArray, IntArray
from hplan.grid.grid import Grid
from hplan.robot.planar_family import PlanarArm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMNS = 4


@styled
def snapshots(
    arm: PlanarArm, centre: ArrayLike, radius: float, grid: Grid, field: FloatArray, path: IntArray
) -> Figure:
    """Eight points of a path, start and goal among them, each with its joint angles and clearance."""
    clearance = field[tuple(path.T)]
    nearest = int(np.argmin(np.round(clearance, 9)))
    figure = new_figure(
        12.0, 5.7, f"Execution of the path of {len(path)} points: smallest clearance at a point "
        f"{1e3 * clearance[nearest]:.1f} mm (point {nearest + 1})",
    )  # fmt: skip
    shown = np.unique(np.rint(np.linspace(0, len(path) - 1, 2 * _COLUMNS)).astype(int))
    panels = figure.subplots(2, _COLUMNS, squeeze=False)
    q = grid.coordinates(path)
    for place, (axes, index) in enumerate(zip(panels.flat, shown, strict=False)):
        _draw_snapshot(axes, arm, q, int(index))
        draw_disc(axes, centre, radius)
        degrees = ", ".join(f"{round(value)}" for value in np.degrees(q[index]))
        axes.set_title(f"Point {index + 1}:  $\\theta$ = ({degrees})°", fontweight="bold")
        axes.text(0.97, 0.96, f"clearance {clearance[index]:.3f} m", transform=axes.transAxes, ha="right", va="top",
                  fontsize=8)  # fmt: skip
        axes.set_xlabel("arm plane, horizontal [m]" if place >= _COLUMNS else "")
        axes.set_ylabel("arm plane, up [m]" if place % _COLUMNS == 0 else "")
        axes.tick_params(labelbottom=place >= _COLUMNS, labelleft=place % _COLUMNS == 0)
    return figure


def _draw_snapshot(axes: Axes, arm: PlanarArm, q: FloatArray, index: int) -> None:
    """Draw the arm at one point of a path of joint angles, and the tool's path up to there."""
    points = arm.joint_points(q)
    tool = points[:, -1]
    axes.plot(tool[:, 0], tool[:, 1], color=FAINT, lw=1.6, zorder=1)
    draw_arm(axes, arm, q[index])
    axes.plot(tool[: index + 1, 0], tool[: index + 1, 1], color="white", lw=3.6, zorder=5)
    axes.plot(tool[: index + 1, 0], tool[: index + 1, 1], color=PATH, lw=2.0, zorder=6)
    for point, color, marker in ((tool[0], START, "o"), (tool[-1], GOAL, "s")):
        axes.plot(*point, marker, color=color, ms=7, mec="white", mew=1.0, zorder=9)
    low, high = points.reshape(-1, 2).min(axis=0), points.reshape(-1, 2).max(axis=0)
    axes.set_aspect("equal")
    axes.set_xlim(low[0] - 0.12, high[0] + 0.12)
    axes.set_ylim(low[1] - 0.12, high[1] + 0.24)
