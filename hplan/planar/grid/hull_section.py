r"""Plane section of a grown hull, as a rounded polygon.

With core points :math:`p_i` at heights :math:`n_i`, the section's support along a unit vector :math:`u` of the plane is

.. math:: \min_t \; \max_i \, (u \cdot p_i + t\,n_i) + r \sqrt{1 + t^2},

Any tilt :math:`t` gives a bound, and the best tilt lies between the two binding points. The tangent touches the ball
about a core point at some height :math:`n`, and this ball's disc of radius :math:`\sqrt{r^2 - n^2}` lies in the
section. With :math:`q` the minimum such radius, the section is therefore a convex set grown by :math:`q`. Tangents are
drawn around that set, each new tangent along the chord of its neighbours' contact points, until every corner is within
the allowed error of such a chord. This finds straight sides exactly; a branch in the plane, parallel to it or across it
needs only four tangents.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import inline, kernel

#: Growth of bodies, relative to their size above 1 m, that keeps rounding errors on the safe side [m].
OUTWARD = 1e-12

#: Heights that differ by less are treated as equal [m].
_EQUAL_HEIGHT = 1e-12

#: Maximum number of tangents per section; if they do not suffice, the section may exceed the requested error.
MOST_TANGENTS = 256

#: Maximum number of steps to the binding points; the support is a valid bound after any number of steps.
_MOST_STEPS = 64


class _Hull(NamedTuple):
    """Parameters of the hull to be cut, without its points."""

    radius: float
    kept: float  # rounding that the section keeps
    lowest: int
    highest: int


@kernel
def _draw_tangent(points: FloatArray, hull: _Hull, ux: float, uy: float, tangents: FloatArray, row: int) -> None:
    """Write the tangent with normal (ux, uy).

    From the support and its contact disc.

    The disc's centre lies between the two binding core points, the lower and the higher one.
    """
    radius, kept, low, high = hull
    weight, across = 0.0, 0.0
    support = 0.0
    for _ in range(_MOST_STEPS):
        low_reach = ux * points[low, 0] + uy * points[low, 1]
        high_reach = ux * points[high, 0] + uy * points[high, 1]
        rise = points[high, 2] - points[low, 2]
        # Tilt with both points binding, unless one of them alone binds at a better tilt.
        tilt, root, alone = 0.0, 1.0, 0 if low_reach >= high_reach else 1
        if rise > _EQUAL_HEIGHT:
            tilt = (low_reach - high_reach) / rise
            root = math.sqrt(1.0 + tilt * tilt)
            height = -radius * tilt / root
            weight = (height - points[low, 2]) / rise
            alone = 0 if weight < 0.0 else (1 if weight > 1.0 else -1)
        if alone >= 0:
            weight = float(alone)
            height = points[high, 2] if alone == 1 else points[low, 2]
            flat = max(math.sqrt(max(0.0, radius * radius - height * height)), 1e-9 * radius)
            tilt = -height / flat
            root = math.sqrt(1.0 + tilt * tilt)
        across = radius / root
        reach = low_reach + weight * (high_reach - low_reach)
        model = reach + tilt * height
        best, found = model, -1
        for i in range(len(points)):
            value = ux * points[i, 0] + uy * points[i, 1] + tilt * points[i, 2]
            if value > best:
                best, found = value, i
        excess = best - model
        support = reach + across + excess
        if excess <= 1e-14 * (1.0 + abs(tilt)) * (1.0 + abs(best)) or found in (low, high):
            break
        if points[found, 2] < height:
            low = found
        else:
            high = found
    tangents[row, 0], tangents[row, 1], tangents[row, 2] = ux, uy, support - kept
    tangents[row, 3] = points[low, 0] + weight * (points[high, 0] - points[low, 0]) + (across - kept) * ux
    tangents[row, 4] = points[low, 1] + weight * (points[high, 1] - points[low, 1]) + (across - kept) * uy


@kernel
def _section_corner(tangents: FloatArray, i: int, j: int) -> tuple[float, float]:
    """Intersection of two tangents."""
    turn = tangents[i, 0] * tangents[j, 1] - tangents[i, 1] * tangents[j, 0]
    x = (tangents[i, 2] * tangents[j, 1] - tangents[j, 2] * tangents[i, 1]) / turn
    y = (tangents[j, 2] * tangents[i, 0] - tangents[i, 2] * tangents[j, 0]) / turn
    return x, y


@kernel
def _gap(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance from a point to a segment."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    t = 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / square))
    return math.sqrt((x - ax - t * dx) ** 2 + (y - ay - t * dy) ** 2)


@kernel
def _kept_rounding(points: FloatArray, radius: float) -> float:
    """Rounding radius of the section.

    A lower bound on the radii of its contact discs.

    The section is therefore a convex set grown by this radius. A tangent that touches the face (or edge, or vertex) of
    the core at height n > 0 has the tilt n / sqrt(r^2 - n^2), which cannot exceed run over rise to any point below a
    vertex of that face; one such vertex has a height of at least n. The same holds below the plane.
    """
    count = len(points)
    # Cores with more points than this are not searched for a rounding.
    if count > 128:
        return 0.0
    worst = 0.0
    for i in range(count):
        height = points[i, 2]
        most = min(1.0, (height / radius) ** 2)
        for j in range(count):
            rise = points[j, 2] - height
            if rise * height < 0.0 and most > worst:
                square = (points[j, 0] - points[i, 0]) ** 2 + (points[j, 1] - points[i, 1]) ** 2
                most = min(most, square / (square + rise * rise))
        worst = max(worst, most)
    return radius * math.sqrt(1.0 - worst)


@inline
def _next_normal(tangents: FloatArray, at: int, following: int) -> tuple[float, float]:
    """Normal of the next tangent between two others.

    It is perpendicular to the chord of their contact points.
    """
    dx, dy = tangents[following, 3] - tangents[at, 3], tangents[following, 4] - tangents[at, 4]
    chord = math.hypot(dx, dy)
    ux, uy = 0.0, 0.0
    if chord > 0.0:
        ux, uy = dy / chord, -dx / chord
    before = tangents[at, 0] * uy - tangents[at, 1] * ux
    behind = ux * tangents[following, 1] - uy * tangents[following, 0]
    if chord == 0.0 or before < 1e-6 or behind < 1e-6:
        # Without a chord, or with hardly a turn from one of them: halfway between the two.
        ux, uy = tangents[at, 0] + tangents[following, 0], tangents[at, 1] + tangents[following, 1]
        length = math.hypot(ux, uy)
        ux, uy = ux / length, uy / length
    return ux, uy


@inline
def _draw_between(
    points: FloatArray, hull: _Hull, error: float, tangents: FloatArray, after: IntArray
) -> tuple[int, float]:
    """Draw tangents until all corners are within the error.

    They lie between the first four.

    Returns:
        Number of tangents, and the error, which is larger than allowed if more than `MOST_TANGENTS` were required.
    """
    made, at = 4, 0
    while True:
        following = after[at]
        cx, cy = _section_corner(tangents, at, following)
        gap = _gap(cx, cy, tangents[at, 3], tangents[at, 4], tangents[following, 3], tangents[following, 4])
        if gap <= error:
            at = following
            if at == 0:
                break
            continue
        if made == MOST_TANGENTS:
            # A section of many metres: start again from the first four tangents with a larger error.
            error, made, at = 4.0 * error, 4, 0
            for i in range(4):
                after[i] = (i + 1) & 3
            continue
        ux, uy = _next_normal(tangents, at, following)
        _draw_tangent(points, hull, ux, uy, tangents, made)
        after[made] = after[at]
        after[at] = made
        made += 1
    return made, error


@inline
def _drop_needless(made: int, error: float, tangents: FloatArray, after: IntArray) -> tuple[int, int]:
    """Drop tangents within the error; return the number left.

    Also returns one of the remaining tangents.
    """
    start, sides = 0, made
    for _ in range(made):
        middle = after[start]
        end = after[middle]
        if sides > 3 and tangents[start, 0] * tangents[end, 1] - tangents[start, 1] * tangents[end, 0] > 0.1:
            cx, cy = _section_corner(tangents, start, end)
            mx, my = tangents[middle, 3], tangents[middle, 4]
            gap = min(
                _gap(cx, cy, tangents[start, 3], tangents[start, 4], mx, my),
                _gap(cx, cy, mx, my, tangents[end, 3], tangents[end, 4]),
            )
            if gap <= error:
                after[start] = end
                sides -= 1
                continue
        start = middle
    return sides, start


@kernel
def cut_hull(
    points: FloatArray,
    radius: float,
    along: tuple[float, float],
    error: float,
    tangents: FloatArray,
    after: IntArray,
    corners: FloatArray,
) -> tuple[int, float]:
    """Rounded polygon around a grown hull's section at height 0.

    The hull of points is grown by `radius`.

    Args:
        points: (k, 3) core points in plane coordinates [m].
        radius: Radius about the hull [m].
        along: Unit normal of the first tangent (along the core's length).
        error: Maximum distance of the polygon outside the section [m].
        tangents: (`MOST_TANGENTS`, 5) work array: normal (2), support, contact point without the rounding (2).
        after: (`MOST_TANGENTS`,) work array: the next tangent.
        corners: (`MOST_TANGENTS`, 2) output array of the vertices [m].

    Returns:
        Number of vertices (0 if the plane misses the body), and the radius about them.
    """
    count, lowest, highest, size = len(points), 0, 0, 1.0
    for i in range(count):
        if points[i, 2] < points[lowest, 2]:
            lowest = i
        if points[i, 2] > points[highest, 2]:
            highest = i
        size = max(size, abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2]))
    if points[lowest, 2] > radius or points[highest, 2] < -radius:
        return 0, 0.0
    if count == 2 and points[highest, 2] - points[lowest, 2] <= _EQUAL_HEIGHT:
        # No bound is required: all discs along the segment are equal.
        nearest = min(abs(points[lowest, 2]), abs(points[highest, 2]))
        for i in range(2):
            corners[i, 0], corners[i, 1] = points[i, 0], points[i, 1]
        same = points[0, 0] == points[1, 0] and points[0, 1] == points[1, 1]
        return 1 if same else 2, math.sqrt(radius * radius - nearest * nearest)
    radius += OUTWARD * size
    hull = _Hull(radius, _kept_rounding(points, radius), lowest, highest)
    ux, uy = along
    for side in range(4):
        _draw_tangent(points, hull, ux, uy, tangents, side)
        after[side] = (side + 1) & 3
        ux, uy = -uy, ux
    length, width = tangents[0, 2] + tangents[2, 2], tangents[1, 2] + tangents[3, 2]
    if width <= error:
        return _thin(tangents, length, width, hull.kept, error, corners)
    made, error = _draw_between(points, hull, error, tangents, after)
    sides, start = _drop_needless(made, error, tangents, after)
    for i in range(sides):
        corners[i, 0], corners[i, 1] = _section_corner(tangents, start, after[start])
        start = after[start]
    return sides, hull.kept


@inline
def _thin(
    tangents: FloatArray, length: float, width: float, kept: float, error: float, corners: FloatArray
) -> tuple[int, float]:
    """Stadium or disc around a rectangle no wider than the error.

    Returns as `cut_hull` does.
    """
    ux, uy = tangents[0, 0], tangents[0, 1]
    offset = 0.5 * (tangents[1, 2] - tangents[3, 2])
    if math.hypot(length, width) <= error:
        middle = 0.5 * (tangents[0, 2] - tangents[2, 2])
        corners[0, 0], corners[0, 1] = middle * ux - offset * uy, middle * uy + offset * ux
        return 1, kept + 0.5 * math.hypot(length, width)
    for i in range(2):
        along = tangents[0, 2] if i == 0 else -tangents[2, 2]
        corners[i, 0], corners[i, 1] = along * ux - offset * uy, along * uy + offset * ux
    return 2, kept + 0.5 * width
