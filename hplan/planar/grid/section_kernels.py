"""Compiled kernels that cut all bodies by the arm plane.

Link by link, for `hplan.planar.grid.sections`.

The section of a ball is a disc; `hplan.planar.grid.hull_section` computes the section of a hull.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import inline, kernel
from hplan.planar.grid.cutting_arrays import ArmPlane, Balls, Cut, Hulls, LinkExtents
from hplan.planar.grid.hull_section import MOST_TANGENTS, cut_hull


@kernel
def _to_plane(points: FloatArray, plane: ArmPlane, lateral: float, turned: FloatArray) -> tuple[float, float]:
    """Write a hull's core points in coordinates of a plane [m].

    The plane of a link.

    The link's plane is offset from the arm plane by `lateral`.

    Returns:
        The direction from the first core point to the second, in the plane.
    """
    origin, axes = plane
    for i in range(len(points)):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        for axis in range(3):
            turned[i, axis] = axes[axis, 0] * x + axes[axis, 1] * y + axes[axis, 2] * z
        turned[i, 2] -= lateral
    ex, ey = turned[1, 0] - turned[0, 0], turned[1, 1] - turned[0, 1]
    length = math.hypot(ex, ey)
    return (ex / length, ey / length) if length > 1e-9 else (1.0, 0.0)


@inline
def _largest_sizes(links: LinkExtents) -> tuple[float, float, float]:
    """Maximum width, reach and distance from the plane over all links."""
    widest, farthest, aside = 0.0, 0.0, 0.0
    for k in range(len(links.growth)):
        widest, farthest = max(widest, links.growth[k] + links.depths[k]), max(farthest, links.reaches[k])
        aside = max(aside, abs(links.lateral[k]))
    return widest, farthest, aside


@inline
def _near_balls(balls: Balls, plane: ArmPlane, links: LinkExtents) -> tuple[int, IntArray, FloatArray]:
    """Number, indices and plane coordinates of balls that links reach."""
    (centres, radii, _), (origin, axes) = balls, plane
    widest, farthest, aside = _largest_sizes(links)
    near, places = np.empty(len(radii), dtype=np.int64), np.empty((len(radii), 3))
    found = 0
    for b in range(len(radii)):
        dx, dy, dz = centres[b, 0] - origin[0], centres[b, 1] - origin[1], centres[b, 2] - origin[2]
        x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
        y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        size = (radii[b] + widest) * (1.0 + 1e-9)
        if abs(n) <= size + aside and x * x + y * y <= (farthest + size) ** 2:
            near[found], places[found, 0], places[found, 1], places[found, 2] = b, x, y, n
            found += 1
    return found, near, places


@kernel
def cut_balls(balls: Balls, plane: ArmPlane, links: LinkExtents) -> Cut:
    """Sections of balls, link by link."""
    (_, radii, obstacles), (growth, depths, reaches, lateral) = balls, links
    count = len(growth)
    found, near, places = _near_balls(balls, plane, links)
    link_start, vertex_start = np.empty(count + 1, dtype=np.int64), np.empty(count * found + 1, dtype=np.int64)
    discs, owners = np.empty((count * found, 4)), np.empty(count * found, dtype=np.int64)
    vertices = np.empty((count * found, 2))
    link_start[0], vertex_start[0] = 0, 0
    made = 0
    for k in range(count):
        for c in range(found):
            x, y, n = places[c, 0], places[c, 1], places[c, 2]
            radius = radii[near[c]] + growth[k]
            height = max(0.0, abs(n - lateral[k]) - depths[k])
            square = radius * radius - height * height
            if square < 0.0:
                continue
            rounding = math.sqrt(square)
            if math.sqrt(x * x + y * y) > (reaches[k] + rounding) * (1.0 + 1e-9):
                continue
            discs[made, 0], discs[made, 1], discs[made, 2], discs[made, 3] = x, y, rounding, rounding
            vertices[made, 0], vertices[made, 1] = x, y
            owners[made] = obstacles[near[c]]
            made += 1
            vertex_start[made] = made
        link_start[k + 1] = made
    return Cut(link_start, vertex_start, vertices, discs, owners)


@inline
def _near_hulls(hulls: Hulls, plane: ArmPlane, links: LinkExtents) -> tuple[int, IntArray, int]:
    """Number and indices of the hulls within reach of any link.

    The third value is the maximum number of points of these hulls.
    """
    (_, starts, radii, _, bounds), (origin, axes) = hulls, plane
    widest, farthest, aside = _largest_sizes(links)
    near = np.empty(len(bounds), dtype=np.int64)
    found, most = 0, 0
    for b in range(len(bounds)):
        dx, dy, dz = bounds[b, 0] - origin[0], bounds[b, 1] - origin[1], bounds[b, 2] - origin[2]
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        size = (radii[b] + widest + bounds[b, 3]) * (1.0 + 1e-9)
        if abs(n) <= size + aside and dx * dx + dy * dy + dz * dz - n * n <= (farthest + size) ** 2:
            near[found] = b
            found += 1
            most = max(most, starts[b + 1] - starts[b])
    return found, near, most


@inline
def _disc_around(corners: FloatArray, count: int, rounding: float) -> tuple[float, float, float]:
    """Centre and radius of a disc around a rounded polygon.

    The centre is the middle of the corners' bounding box.
    """
    low_x, low_y, high_x, high_y = corners[0, 0], corners[0, 1], corners[0, 0], corners[0, 1]
    for i in range(1, count):
        low_x, high_x = min(low_x, corners[i, 0]), max(high_x, corners[i, 0])
        low_y, high_y = min(low_y, corners[i, 1]), max(high_y, corners[i, 1])
    x, y, square = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y), 0.0
    for i in range(count):
        square = max(square, (corners[i, 0] - x) ** 2 + (corners[i, 1] - y) ** 2)
    return x, y, math.sqrt(square) + rounding


@kernel
def cut_hulls(hulls: Hulls, plane: ArmPlane, links: LinkExtents, error: float, balls: Cut) -> Cut:
    """Sections of grown hulls, appended to each link's ball sections.

    Args:
        error: Maximum distance of a section's outline outside the true section [m].
        balls: Result of `cut_balls`.
    """
    (points, starts, radii, obstacles, _), (growth, _, reaches, lateral) = hulls, links
    ball_start, ball_vertex_start, ball_vertices, ball_discs, ball_owners = balls
    count = len(growth)
    found, near, most = _near_hulls(hulls, plane, links)
    turned = np.empty((most, 3))
    tangents, after = np.empty((MOST_TANGENTS, 5)), np.empty(MOST_TANGENTS, dtype=np.int64)
    corners = np.empty((MOST_TANGENTS, 2))
    room = count * found + ball_start[count]
    link_start, vertex_start = np.empty(count + 1, dtype=np.int64), np.empty(room + 1, dtype=np.int64)
    discs, owners = np.empty((room, 4)), np.empty(room, dtype=np.int64)
    vertices = np.empty((MOST_TANGENTS * count * found + ball_vertex_start[ball_start[count]], 2))
    link_start[0], vertex_start[0] = 0, 0
    made, used = 0, 0
    for k in range(count):
        for s in range(ball_start[k], ball_start[k + 1]):
            for i in range(ball_vertex_start[s], ball_vertex_start[s + 1]):
                vertices[used, 0], vertices[used, 1] = ball_vertices[i, 0], ball_vertices[i, 1]
                used += 1
            for i in range(4):
                discs[made, i] = ball_discs[s, i]
            owners[made] = ball_owners[s]
            made += 1
            vertex_start[made] = used
        for c in range(found):
            b = near[c]
            size = starts[b + 1] - starts[b]
            along = _to_plane(points[starts[b] : starts[b + 1]], plane, lateral[k], turned)
            sides, rounding = cut_hull(turned[:size], radii[b] + growth[k], along, error, tangents, after, corners)
            if sides == 0:
                continue
            x, y, extent = _disc_around(corners, sides, rounding)
            if math.sqrt(x * x + y * y) > (reaches[k] + extent) * (1.0 + 1e-9):
                continue
            for i in range(sides):
                vertices[used + i, 0], vertices[used + i, 1] = corners[i, 0], corners[i, 1]
            discs[made, 0], discs[made, 1], discs[made, 2], discs[made, 3] = x, y, extent, rounding
            owners[made] = obstacles[b]
            used += sides
            made += 1
            vertex_start[made] = used
        link_start[k + 1] = made
    return Cut(link_start, vertex_start, vertices, discs, owners)
