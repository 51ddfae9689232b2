"""Figures of the paper's workspace demonstration: the path past the sphere, and six of the layers.

Lengths are in the paper's unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from studies.paper.figures_joint_space import draw_line

from hplan.apps.view.cspace_surface import draw_cspace_obstacle, hidden, panes
from hplan.apps.view.figure_style import FAINT, GOAL, INK, OBSTACLE, OBSTACLE_TINT, PATH, START, new_figure, styled
from hplan.base.arrays import FloatArray, IntArray
from hplan.grid.grid import Grid, Occupancy

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def workspace_path(
    occupancy: Occupancy,
    centre: ArrayLike,
    radius: float,
    paths: Mapping[int, IntArray],
    path: IntArray,
    *,
    elevation: float = 24.0,
    azimuth: float = -62.0,
) -> Figure:
    """The path past the sphere, over the paths of the layers."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D

    grid = occupancy.grid
    middle = np.asarray(centre, dtype=np.float64)
    heights = grid.axis(2)
    norm, colors = Normalize(float(heights[0]), float(heights[-1])), colormaps["viridis"]
    points = grid.coordinates(path)
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    figure = new_figure(10.0, 5.8, f"Workspace path past the sphere: {length:.2f} units, {len(path)} points")
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=elevation, azim=azimuth)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    field = np.linalg.norm(mesh - middle, axis=-1) - radius
    towards = _draw_ball(axes, middle, radius)
    for number, layer in paths.items():
        behind = hidden(field, layer.astype(np.float64), towards, gap=1.0)
        draw_line(axes, grid.coordinates(layer), behind, colors(norm(heights[number])), 1.1, 4.0 + 0.01 * number)
    draw_line(axes, points, hidden(field, path.astype(np.float64), towards, gap=1.0), INK, 2.8, 7.0, halo=1.6)
    for end, color, marker in ((0, START, "o"), (-1, GOAL, "s")):
        axes.plot(*points[end][:, None], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
    _unit_box(axes, grid)
    bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, shrink=0.5, pad=0.07, aspect=18)
    bar.set_label("layer z [unit]")
    bar.set_ticks(np.linspace(heights[0], heights[-1], 5).tolist())
    bar.outline.set_visible(False)
    figure.legend(
        handles=[
            Line2D([], [], color=colors(0.5), lw=1.4, label=f"paths of the {len(paths)} layers (dotted: behind)"),
            Line2D([], [], color=INK, lw=2.6, label="path"),
            Line2D([], [], marker="o", color=OBSTACLE_TINT, ls="none", ms=10, label="sphere"),
            Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
        ],
        loc="outside lower center", ncols=5,
    )  # fmt: skip
    return figure


@styled
def workspace_layers(
    occupancy: Occupancy,
    centre: ArrayLike,
    radius: float,
    paths: Mapping[int, IntArray],
    path: IntArray,
    numbers: Sequence[int],
) -> Figure:
    """Six layers from above: the sphere's section, the path of the layer, and what the final path takes of it."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(10.4, 7.6, "Six layers of the workspace and their paths")
    panels = figure.subplots(2, 3)
    for place, (axes, number) in enumerate(zip(panels.flat, numbers, strict=False)):
        z = float(grid.axis(2)[number])
        _draw_section(axes, occupancy, number, (np.asarray(centre, dtype=np.float64), radius))
        layer = grid.coordinates(paths[number])
        axes.plot(layer[:, 0], layer[:, 1], color=PATH, lw=2.2, zorder=5)
        taken = grid.coordinates(path[path[:, 2] == number])
        axes.plot(taken[:, 0], taken[:, 1], "o", color=INK, ms=3.6, ls="none", zorder=9)
        for end, color, marker in ((0, START, "o"), (-1, GOAL, "s")):
            axes.plot(*layer[end, :2], marker, color=color, ms=8, mec="white", mew=1.1, zorder=8)
        length = float(np.linalg.norm(np.diff(layer, axis=0), axis=1).sum())
        axes.set_title(f"z = {z:g}:  {length:.2f} units, {len(layer)} points", fontweight="bold")
        axes.set_xlabel("x [unit]" if place >= 3 else "")
        axes.set_ylabel("y [unit]" if place % 3 == 0 else "")
        axes.tick_params(labelbottom=place >= 3, labelleft=place % 3 == 0)
    figure.legend(
        handles=[
            Patch(fc=OBSTACLE_TINT, ec=OBSTACLE, label="section of the sphere"),
            Line2D([], [], color=PATH, lw=2.2, label="path of the layer"),
            Line2D([], [], marker="o", color=INK, ls="none", ms=4, label="points of the path of Fig. 6"),
            Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
        ],
        loc="outside lower center", ncols=5, columnspacing=1.4,
    )  # fmt: skip
    return figure


def _draw_section(axes: Axes, occupancy: Occupancy, number: int, ball: tuple[FloatArray, float]) -> None:
    """Draw the occupied nodes of a layer and the circle in which it cuts the ball, given by centre and radius."""
    from matplotlib.colors import to_rgb
    from matplotlib.patches import Circle

    grid = occupancy.grid
    low, high = grid.lower, grid.coordinates(np.array(grid.shape) - 1)
    image = np.ones((*grid.shape[:2], 3))
    image[occupancy.occupied[:, :, number]] = to_rgb(OBSTACLE_TINT)
    half = 0.5 * grid.step
    axes.imshow(
        image.transpose(1, 0, 2), origin="lower", interpolation="nearest", zorder=1,
        extent=(low[0] - half[0], high[0] + half[0], low[1] - half[1], high[1] + half[1]),
    )  # fmt: skip
    centre, radius = ball
    square = radius**2 - (float(grid.axis(2)[number]) - centre[2]) ** 2
    if square > 0.0:
        axes.add_patch(Circle((centre[0], centre[1]), math.sqrt(square), fc="none", ec=OBSTACLE, lw=1.4, zorder=3))
    axes.grid(color=FAINT, lw=0.5, zorder=0)
    for spine in axes.spines.values():
        spine.set_visible(True)
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])


def _unit_box(axes: Any, grid: Grid) -> None:
    """Look of 3-D axes over the workspace, true to scale."""
    high = grid.coordinates(np.array(grid.shape) - 1)
    axes.set_xlim(grid.lower[0], high[0])
    axes.set_ylim(grid.lower[1], high[1])
    axes.set_zlim(grid.lower[2], high[2])
    axes.set_box_aspect(tuple(high - grid.lower), zoom=1.22)
    panes(axes)
    axes.set_xlabel("x [unit]", labelpad=4)
    axes.set_ylabel("y [unit]", labelpad=4)
    axes.set_zlabel("z [unit]", labelpad=-2)
    axes.set_zticks(np.linspace(grid.lower[2], high[2], 3)[1:])
    axes.set_yticks([tick for tick in axes.get_yticks() if grid.lower[1] <= tick < high[1]])


def _draw_ball(axes: Any, centre: FloatArray, radius: float) -> FloatArray:
    """Draw a shaded ball; returns the unit vector to the viewer."""
    grid = Grid.over(centre - radius - 1.0, centre + radius + 1.0, radius / 14.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    field = np.linalg.norm(mesh - centre, axis=-1) - radius
    # The obstacle is drawn in degrees of radians: hand it a grid whose "radians" give these units.
    scaled = Grid(np.radians(grid.lower), np.radians(grid.step), grid.shape)
    return draw_cspace_obstacle(axes, scaled, field)
