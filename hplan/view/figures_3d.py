"""Figures of the method in three dimensions: the C-space obstacle with the path, the workspace demonstration.

The obstacle's surface is made by surface nets: one vertex in each cell that the surface crosses, one quadrilateral
for each grid edge that it cuts. It is shaded here and seen in parallel projection, so that what a line passes behind
can be told exactly by following the line of sight through the field; hidden parts are drawn faint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import BoolArray, FloatArray, IntArray
from hplan.grid import Grid, Occupancy
from hplan.robot import PlanarArm
from hplan.view.figure_style import (
    FAINT,
    GOAL,
    INK,
    OBSTACLE,
    OBSTACLE_TINT,
    PATH,
    QUIET,
    RESTORED,
    START,
    new_figure,
    styled,
)
from hplan.view.figures_arm import draw_motion

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Value of the field beyond the grid: closes the surface on the grid's faces.
_OUTSIDE = 1e3


def surface_net(field: FloatArray) -> tuple[FloatArray, IntArray]:
    """Surface where a field on a 3-D grid is zero, closed on the faces of the grid.

    Args:
        field: (N1, N2, N3) values, negative inside.

    Returns:
        (V, 3) vertices in units of nodes and (F, 4) quadrilaterals, counter-clockwise seen from outside.
    """
    values = np.pad(field, 1, constant_values=_OUTSIDE)
    inside = values < 0.0
    cells = np.array(values.shape) - 1
    total = np.zeros((*cells, 3))
    crossings = np.zeros(tuple(cells), dtype=np.int64)
    base = np.moveaxis(np.indices(tuple(cells)), 0, -1).astype(np.float64)
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        for shift in ((0, 0), (0, 1), (1, 0), (1, 1)):
            low = [slice(None)] * 3
            low[axis] = slice(0, -1)
            for other, step in zip(others, shift, strict=True):
                low[other] = slice(step, step + int(cells[other]))
            high = list(low)
            high[axis] = slice(1, None)
            a, b = values[tuple(low)], values[tuple(high)]
            cut = inside[tuple(low)] != inside[tuple(high)]
            share = np.divide(a, a - b, out=np.zeros_like(a), where=cut)
            point = base.copy()
            point[..., axis] += share
            for other, step in zip(others, shift, strict=True):
                point[..., other] += step
            total += np.where(cut[..., None], point, 0.0)
            crossings += cut
    active = crossings > 0
    number = np.full(tuple(cells), -1, dtype=np.int64)
    number[active] = np.arange(int(active.sum()))
    vertices = total[active] / crossings[active][:, None] - 1.0  # the padding moved all by one
    faces = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(0, -1), slice(1, None)
        for rising in (True, False):
            cut = inside[tuple(low)] & ~inside[tuple(high)] if rising else ~inside[tuple(low)] & inside[tuple(high)]
            at = np.argwhere(cut)
            around = []
            for shift in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
                cell = at.copy()
                cell[:, first] += shift[0]
                cell[:, second] += shift[1]
                around.append(number[tuple(cell.T)])
            ring = np.stack(around, axis=1)
            faces.append(ring if rising else ring[:, ::-1])
    return vertices, np.concatenate(faces)


def hidden(field: FloatArray, points: FloatArray, towards: FloatArray, gap: float = 2.5) -> BoolArray:
    """Which points the surface hides.

    Args:
        field: (N1, N2, N3) values, negative inside.
        points: (m, 3) points in units of nodes.
        towards: (3,) unit vector to the viewer.
        gap: Distance from the point that cannot hide it, in nodes.
    """
    result = np.zeros(len(points), dtype=np.bool_)
    last = np.array(field.shape) - 1
    for distance in np.arange(gap, float(np.linalg.norm(last)), 0.7):
        at = np.rint(points + distance * towards).astype(np.int64)
        within = ((at >= 0) & (at <= last)).all(axis=1)
        place = np.clip(at, 0, last)
        result |= within & (field[tuple(place.T)] < 0.0)
    return result


def draw_cspace_obstacle(axes: Any, grid: Grid, field: FloatArray) -> FloatArray:
    """Draw the C-space obstacle as a shaded surface into 3-D axes, angles in degrees.

    Args:
        axes: Matplotlib's `Axes3D`, in parallel projection, with its view set.
        grid: Grid over three joints.
        field: (N1, N2, N3) values at its nodes, negative inside.

    Returns:
        (3,) unit vector to the viewer, in units of nodes.
    """
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    elevation, azimuth = math.radians(axes.elev), math.radians(axes.azim)
    towards = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    vertices, faces = surface_net(field)
    corners = vertices[faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    seen = normal @ towards > 0.0
    side = np.cross([0.0, 0.0, 1.0], towards)
    light = 0.45 * towards + np.array([0.0, 0.0, 0.8]) - 0.55 * side / np.linalg.norm(side)
    light /= np.linalg.norm(light)
    shade = 0.5 + 0.5 * np.clip(normal[seen] @ light, -1.0, 1.0)
    ramp = np.array([to_rgb(color) for color in ("#8A3A00", "#C45A08", "#EE9A57", "#FBD3AE")])
    colors = np.stack([np.interp(shade, (0.2, 0.5, 0.8, 1.0), ramp[:, channel]) for channel in range(3)], axis=1)
    axes.add_collection3d(
        Poly3DCollection(
            np.degrees(grid.lower + corners[seen] * grid.step),
            facecolors=colors, edgecolors=colors, linewidths=0.35, zorder=2,
        )
    )  # fmt: skip
    return towards


def joint_box(axes: Any, grid: Grid, zoom: float) -> None:
    """Look of 3-D axes over three joint angles."""
    high = np.degrees(grid.coordinates(np.array(grid.shape) - 1))
    low = np.degrees(grid.lower)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    _panes(axes)
    axes.set_xlabel(r"$\theta_1$ [deg]", labelpad=2)
    axes.set_ylabel(r"$\theta_2$ [deg]", labelpad=2)
    axes.set_zlabel(r"$\theta_3$ [deg]", labelpad=0)
    for axis, first, last in zip((axes.xaxis, axes.yaxis, axes.zaxis), low, high, strict=True):
        axis.set_ticks([tick for tick in np.arange(-360.0, 361.0, 30.0) if first <= tick <= last + 1e-9])
    axes.xaxis.set_ticks([tick for tick in axes.get_xticks() if tick > low[0] + 1e-9])  # it stands where theta2's ends


def _panes(axes: Any) -> None:
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))
        axis.line.set_color(QUIET)
        axis._axinfo["grid"].update(color=FAINT, linewidth=0.6)
        axis._axinfo["tick"].update(inward_factor=0.0, outward_factor=0.25)
    axes.tick_params(pad=0)


def _draw_line(
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


def _draw_path(axes: Any, grid: Grid, field: FloatArray, path: IntArray, towards: FloatArray) -> bool:
    """Draw the path with its ends; returns whether a part of it is hidden."""
    points = np.degrees(grid.coordinates(path))
    covered = hidden(field, path.astype(np.float64), towards)
    _draw_line(axes, points, covered, INK, 2.8, 7.0, halo=1.8)
    for point, color, marker in ((points[0], START, "o"), (points[-1], GOAL, "s")):
        axes.plot(*point[:, None], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
    return bool(covered.any())


@styled
def cspace_and_path(
    grid: Grid,
    field: FloatArray,
    paths: Mapping[int, IntArray],
    heads: Mapping[int, IntArray],
    path: IntArray,
    *,
    elevation: float = 27.0,
    azimuth: float = 128.0,
) -> Figure:
    """Figure 14: the C-space obstacle, the sparse graph and the path through it.

    Args:
        grid: Grid over three joints.
        field: (N1, N2, N3) values at its nodes, negative inside the obstacle.
        paths: Slice -> (m, 3) path of its own.
        heads: Slice -> (k, 3) restored part.
        path: (m, 3) path of the second level.
        elevation: Height of the viewer [deg].
        azimuth: Direction of the viewer [deg].
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = new_figure(8.2, 6.6, "The C-space obstacle, the sparse graph and the path")
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=elevation, azim=azimuth)
    towards = draw_cspace_obstacle(axes, grid, field)
    _draw_sparse_lines(axes, grid, field, heads, towards, RESTORED)
    _draw_sparse_lines(axes, grid, field, paths, towards, PATH)
    behind = _draw_path(axes, grid, field, path, towards)
    joint_box(axes, grid, 1.06)
    figure.legend(
        handles=[
            Patch(fc=OBSTACLE, label="forbidden"),
            Line2D([], [], color=PATH, lw=1.6, label="slice paths"),
            Line2D([], [], color=RESTORED, lw=1.6, label="restored parts"),
            Line2D([], [], color=INK, lw=2.8, label="path (dotted: behind)" if behind else "path"),
            Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
        ],
        loc="outside lower center", ncols=6, columnspacing=1.3, handlelength=1.6,
    )  # fmt: skip
    return figure


@styled
def overview(
    arm: PlanarArm,
    centre: ArrayLike,
    radius: float,
    grid: Grid,
    field: FloatArray,
    path: IntArray,
    *,
    elevation: float = 27.0,
    azimuth: float = 128.0,
) -> Figure:
    """The method in one picture: the path in the C-space, and the motion that it is.

    Args:
        arm: The planar chain, three links.
        centre: (2,) centre of the disc obstacle [m].
        radius: Its radius [m].
        grid: Grid over the three joints.
        field: (N1, N2, N3) values at its nodes, negative inside the obstacle.
        path: (m, 3) node indices.
        elevation: Height of the viewer [deg].
        azimuth: Direction of the viewer [deg].
    """
    figure = new_figure(11.0, 4.6, "", placed=True)
    axes: Any = figure.add_axes((0.0, 0.0, 0.43, 0.93), projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=elevation, azim=azimuth)
    towards = draw_cspace_obstacle(axes, grid, field)
    _draw_path(axes, grid, field, path, towards)
    joint_box(axes, grid, 0.98)
    right = figure.add_axes((0.5, 0.11, 0.49, 0.79))
    draw_motion(right, arm, centre, radius, grid.coordinates(path), color=INK)
    for x, text in ((0.02, "A path through joint space"), (0.5, "The same path as a motion of the arm")):
        figure.text(x, 0.945, text, fontweight="bold", fontsize=11.5)
    return figure


@styled
def workspace(
    occupancy: Occupancy,
    centre: ArrayLike,
    radius: float,
    paths: Mapping[int, IntArray],
    path: IntArray,
    *,
    elevation: float = 22.0,
    azimuth: float = -62.0,
) -> Figure:
    """Figure 12: the workspace demonstration, layer by layer and in space.

    Args:
        occupancy: The (N1, N2, N3) workspace grid.
        centre: (3,) centre of the sphere, in the grid's unit.
        radius: Its radius.
        paths: Layer -> (m, 3) path of its own.
        path: (m, 3) path of the second level.
        elevation: Height of the viewer [deg].
        azimuth: Direction of the viewer [deg].
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle

    grid = occupancy.grid
    middle = np.asarray(centre, dtype=np.float64)
    heights = grid.axis(2)
    norm = Normalize(float(heights[0]), float(heights[-1]))
    colors = colormaps["viridis"]
    points = grid.coordinates(path)
    figure = new_figure(11.0, 5.5, "The same search in the workspace: a sphere, layer by layer")
    panels = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.12))

    flat = figure.add_subplot(panels[0, 0])
    for number, layer in paths.items():
        place = grid.coordinates(layer)
        flat.plot(place[:, 0], place[:, 1], color=colors(norm(heights[number])), lw=1.2, zorder=3)
    for number in np.linspace(0, len(heights) - 1, len(heights)).astype(int):
        square = radius**2 - (heights[number] - middle[2]) ** 2
        if square > 0.0:
            flat.add_patch(
                Circle((middle[0], middle[1]), math.sqrt(square), fc=OBSTACLE_TINT, ec=OBSTACLE, lw=0.5, alpha=0.22)
            )
    flat.plot(points[:, 0], points[:, 1], color="white", lw=4.2, zorder=4)
    flat.plot(points[:, 0], points[:, 1], color=INK, lw=2.4, zorder=5)
    flat.set_title(f"The {len(paths)} layer paths seen from above", fontweight="bold")
    flat.set_aspect("equal")
    high = grid.coordinates(np.array(grid.shape) - 1)
    flat.set_xlim(grid.lower[0], high[0])
    flat.set_ylim(grid.lower[1], high[1])
    flat.set_xlabel("x [unit]")
    flat.set_ylabel("y [unit]")

    axes: Any = figure.add_subplot(panels[0, 1], projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=elevation, azim=azimuth)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    field = np.linalg.norm(mesh - middle, axis=-1) - radius
    towards = _draw_ball(axes, middle, radius)
    for number, layer in paths.items():
        behind = hidden(field, layer.astype(np.float64), towards, gap=1.0)
        color = colors(norm(heights[number]))
        _draw_line(axes, grid.coordinates(layer), behind, color, 1.1, 4.0 + 0.01 * number)
    behind = hidden(field, path.astype(np.float64), towards, gap=1.0)
    _draw_line(axes, points, behind, INK, 2.6, 7.0, halo=1.6)
    for end, color, marker in ((0, START, "o"), (-1, GOAL, "s")):
        axes.plot(*points[end][:, None], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
        flat.plot(*points[end][:2], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
    axes.set_xlim(grid.lower[0], high[0])
    axes.set_ylim(grid.lower[1], high[1])
    axes.set_zlim(grid.lower[2], high[2])
    axes.set_box_aspect(tuple(high - grid.lower), zoom=1.25)
    _panes(axes)
    axes.set_title("The path over their union", fontweight="bold", y=0.985)
    axes.set_xlabel("x [unit]", labelpad=2)
    axes.set_ylabel("y [unit]", labelpad=2)
    axes.set_zlabel("z [unit]", labelpad=-2)
    axes.set_zticks(np.linspace(heights[0], heights[-1], 3)[1:])
    axes.set_yticks([tick for tick in axes.get_yticks() if grid.lower[1] <= tick < high[1]])
    bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, shrink=0.55, pad=0.08, aspect=18)
    bar.set_label("layer z [unit]")
    bar.set_ticks(np.linspace(heights[0], heights[-1], 5).tolist())
    bar.outline.set_visible(False)
    figure.legend(
        handles=[
            Line2D([], [], color=colors(0.5), lw=1.4, label="layer paths (dotted: behind)"),
            Line2D([], [], color=INK, lw=2.6, label="path"),
            Line2D([], [], marker="o", color=OBSTACLE_TINT, ls="none", ms=10, label="sphere"),
            Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
        ],
        loc="outside lower center", ncols=5,
    )  # fmt: skip
    return figure


def _draw_ball(axes: Any, centre: FloatArray, radius: float) -> FloatArray:
    """Draw a shaded ball; returns the unit vector to the viewer."""
    grid = Grid.over(centre - radius - 1.0, centre + radius + 1.0, radius / 14.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    field = np.linalg.norm(mesh - centre, axis=-1) - radius
    # The obstacle is drawn in degrees of radians: hand it a grid whose "radians" give these units.
    scaled = Grid(np.radians(grid.lower), np.radians(grid.step), grid.shape)
    return draw_cspace_obstacle(axes, scaled, field)
