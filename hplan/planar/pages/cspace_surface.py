"""Surface of the C-space obstacle, and the points that it hides.

Surface nets generate the obstacle's surface: one vertex in each cell that the surface crosses, one quadrilateral for
each grid edge that it cuts. The surface is shaded and drawn in parallel projection, so that tracing the line of sight
through the field finds the hidden segments of a line exactly; these are drawn faint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hplan.apps.view.figures import FAINT, QUIET
from hplan.apps.view.framing import view_axes
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.planar.grid.grid import Grid


def surface_net(field: FloatArray) -> tuple[FloatArray, IntArray]:
    """Zero-level surface of a field on a 3-D grid.

    It is closed on the grid's faces.

    Args:
        field: (N1, N2, N3) values, negative inside.

    Returns:
        (V, 3) vertices in units of nodes, and (F, 4) quadrilaterals, counter-clockwise from outside.
    """
    # Value of the field beyond the grid: closes the surface on the grid's faces.
    values = np.pad(field, 1, constant_values=1e3)
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
            fraction = np.divide(a, a - b, out=np.zeros_like(a), where=cut)
            point = base.copy()
            point[..., axis] += fraction
            for other, step in zip(others, shift, strict=True):
                point[..., other] += step
            total += np.where(cut[..., None], point, 0.0)
            crossings += cut
    active = crossings > 0
    number = np.full(tuple(cells), -1, dtype=np.int64)
    number[active] = np.arange(int(active.sum()))
    vertices = total[active] / crossings[active][:, None] - 1.0  # undoes the offset of the padding
    faces = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(0, -1), slice(1, None)
        for rising in (True, False):
            cut = inside[tuple(low)] & ~inside[tuple(high)] if rising else ~inside[tuple(low)] & inside[tuple(high)]
            at = np.argwhere(cut)
            cells_about = []
            for shift in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
                cell = at.copy()
                cell[:, first] += shift[0]
                cell[:, second] += shift[1]
                cells_about.append(number[tuple(cell.T)])
            ring = np.stack(cells_about, axis=1)
            faces.append(ring if rising else ring[:, ::-1])
    return vertices, np.concatenate(faces)


def hidden_by_surface(field: FloatArray, points: FloatArray, towards: FloatArray, gap: float = 2.5) -> BoolArray:
    """Mask of the points that the surface hides.

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
    """Draw the C-space obstacle as a shaded surface.

    Into 3-D axes with angles in degrees.

    Args:
        axes: Matplotlib's `Axes3D`, in parallel projection, with its view set.
        field: (N1, N2, N3) values at its nodes, negative inside.

    Returns:
        (3,) unit vector to the viewer, in units of nodes.
    """
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    towards = view_axes(math.radians(axes.azim), math.radians(axes.elev))[2]
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


def joint_box(
    axes: Any, grid: Grid, zoom: float, names: Sequence[str] = (r"$\theta_1$", r"$\theta_2$", r"$\theta_3$")
) -> None:
    """Style 3-D axes over three joint angles; without names, use the paper's."""
    high = np.degrees(grid.coordinates(np.array(grid.shape) - 1))
    low = np.degrees(grid.lower)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=zoom)
    panes(axes)
    axes.set_xlabel(f"{names[0]} [deg]", labelpad=2)
    axes.set_ylabel(f"{names[1]} [deg]", labelpad=2)
    axes.set_zlabel(f"{names[2]} [deg]", labelpad=0)
    for axis, first, last in zip((axes.xaxis, axes.yaxis, axes.zaxis), low, high, strict=True):
        axis.set_ticks([tick for tick in np.arange(-360.0, 361.0, 30.0) if first <= tick <= last + 1e-9])
    axes.xaxis.set_ticks([tick for tick in axes.get_xticks() if tick > low[0] + 1e-9])  # else it overlaps theta2's end


def panes(axes: Any) -> None:
    """Style the walls, grid lines and ticks of 3-D axes."""
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((0.975, 0.98, 0.985, 1.0))
        axis.line.set_color(QUIET)
        axis._axinfo["grid"].update(color=FAINT, linewidth=0.6)
        axis._axinfo["tick"].update(inward_factor=0.0, outward_factor=0.25)
    axes.tick_params(pad=0)
