r"""The compiled part of `hplan.grid.sections`: all bodies cut by the arm plane at once, link by link.

At one yaw the section of a ball is a disc, and that of a hull is drawn by `hplan.grid.hull_section`.

**A yaw interval.** Let :math:`R_\delta` turn about the yaw axis. The arm plane at yaw :math:`\psi + \delta` has its
origin and axes turned by :math:`R_\delta`, so a point :math:`p` has there the plane coordinates that
:math:`R_{-\delta}\,p` has in the plane at :math:`\psi`, wherever the origin stands. The sections over the interval
are those of the plane at :math:`\psi` with the body turned by all :math:`|\delta| \le h`. A link off the plane
moves in a plane parallel to it; whichever it is, it may pass the axis at a distance.

- Hull of points: a point at distance :math:`\rho` from the axis moves on an arc that lies between the distances
  :math:`\rho \cos h` and :math:`\rho` along the middle direction. Its chord, stretched by
  :math:`(1 + \cos h) / (2 \cos h)` from the axis, stands halfway between and is wider than the arc, so the arc is
  nowhere farther from it than :math:`\rho (1 - \cos h) / 2`. A turned point of the hull is the same mean of turned
  core points: the swept body lies in the hull of two points for each core point, grown by that much more. Only what
  comes within the radius of the plane matters; of small cores the rest is cut away first, as the sweep of a far part
  would loosen the hull.
- Ball: where the plane holds the axis and the ball does not, a point of the plane is in the ball if the angle between
  the two is below a bound that does not depend on yaw. So the discs lie in each other, and the one at the nearest yaw
  is the union. Else a stadium over all centres, with the largest radius.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.base.kernels import inlined, kernel
from hplan.grid.cutting_arrays import ArmPlane, Balls, Cut, Hulls, LinkExtents
from hplan.grid.hull_section import MOST_TANGENTS, OUTWARD, cut_hull

#: A plane that passes the yaw axis by less holds it; bodies grow by the difference [m].
_THROUGH_AXIS = 1e-6

#: Cores of at most this many points (boxes) are cut to what comes near the plane before they are swept.
_CUT_POINTS = 8


@inlined
def _origin_from_axis(plane: ArmPlane) -> tuple[float, float]:
    """The plane's origin as seen from the yaw axis: along the plane, and beyond it."""
    axes = plane.axes
    x, y, z = plane.origin[0] - plane.yaw_axis[0], plane.origin[1] - plane.yaw_axis[1], plane.origin[2]
    return axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z, axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z


@kernel
def _sweep(
    points: FloatArray, plane: ArmPlane, lateral: float, radius: float, reach: float, turned: FloatArray
) -> tuple[int, float, float, float]:
    """Core points in the coordinates of a link's plane; over an interval of yaw the two for each of the module's text.

    Args:
        points: Core points of a hull [m].
        lateral: How far off it the link moves [m].
        radius: Radius about the hull, the link's growth included [m].
        reach: Largest reach of a link [m].
        turned: Takes the points, and needs room for the hull's own at its end.

    Returns:
        How many points were written, by how much the radius grows, and the direction from the first core point to the
        second, in the plane.
    """
    origin, axes, half_angle, _ = plane
    count = len(points)
    own = len(turned) - count  # the core's own points stand at the end until they are turned
    far = 0.0
    # Along, upward and sideways, of the axis where there is an interval and of the plane's origin where there is none.
    ox, on = _origin_from_axis(plane)
    swept = half_angle > 0.0
    for i in range(count):
        x, y, z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        for axis in range(3):
            turned[own + i, axis] = axes[axis, 0] * x + axes[axis, 1] * y + axes[axis, 2] * z
        if swept:
            turned[own + i, 0] += ox
            turned[own + i, 2] += on
            far = max(far, math.hypot(turned[own + i, 0], turned[own + i, 2]))
    ex, ey = turned[own + 1, 0] - turned[own, 0], turned[own + 1, 1] - turned[own, 1]
    length = math.hypot(ex, ey)
    ex, ey = (ex / length, ey / length) if length > 1e-9 else (1.0, 0.0)
    written = 0
    if not swept:
        for i in range(count):
            for axis in range(3):
                turned[i, axis] = turned[own + i, axis]
            turned[i, 2] -= lateral
        return count, 0.0, ex, ey
    on += lateral
    cos, sin = math.cos(half_angle), math.sin(half_angle)
    # What is farther sideways than this touches the plane at no yaw of the interval within the reach.
    wide = min(far, abs(ox) + reach + radius) * sin + OUTWARD * (1.0 + far)
    upper, under = on + radius, on - radius
    upper = (upper if upper > 0.0 else upper * cos) + wide
    under = (under if under < 0.0 else under * cos) - wide
    for i in range(count):
        height = turned[own + i, 2]
        if count > _CUT_POINTS or under <= height <= upper:
            for axis in range(3):
                turned[written, axis] = turned[own + i, axis]
            written += 1
        if count > _CUT_POINTS:
            continue
        for j in range(i):
            rise = turned[own + j, 2] - height
            for side in range(2):
                level = under if side == 0 else upper
                if (height - level) * (height + rise - level) < 0.0:
                    t = (level - height) / rise
                    for axis in range(3):
                        turned[written, axis] = turned[own + i, axis] + t * (
                            turned[own + j, axis] - turned[own + i, axis]
                        )
                    written += 1
    far = 0.0
    for i in range(written):
        far = max(far, math.hypot(turned[i, 0], turned[i, 2]))
    outward = 0.5 * (1.0 + cos) / cos
    for i in range(written - 1, -1, -1):
        x, y, n = turned[i, 0], turned[i, 1], turned[i, 2]
        for side in range(2):
            s = sin if side == 0 else -sin
            turned[2 * i + side, 0] = outward * (cos * x + s * n) - ox
            turned[2 * i + side, 1] = y
            turned[2 * i + side, 2] = outward * (cos * n - s * x) - on
    return 2 * written, 0.5 * far * (1.0 - cos), ex, ey


@inlined
def _ball(x: float, n: float, ox: float, on: float, cos: float, sin: float, nested: bool) -> tuple[float, float, float]:
    """Range of a ball's centre along the plane, and its least height, while it turns about the axis.

    It stands at (x, n) from the axis, in the middle of the interval, and the plane's origin at (ox, on). Where the
    discs lie in each other, only the largest counts.
    """
    ax, an = cos * x + sin * n, cos * n - sin * x
    bx, bn = cos * x - sin * n, cos * n + sin * x
    distance = math.sqrt(x * x + n * n)
    if nested:
        if an * bn <= 0.0:
            place = math.copysign(distance, x)
            return place - ox, place - ox, 0.0
        place, height = (ax, an) if abs(an) < abs(bn) else (bx, bn)
        return place - ox, place - ox, abs(height)
    low, high = min(ax, bx), max(ax, bx)
    if an * bn <= 0.0:
        low, high = (min(low, -distance), high) if x < 0.0 else (low, max(high, distance))
    under, upper = min(an, bn) - on, max(an, bn) - on
    if ax * bx <= 0.0:
        under, upper = (min(under, -distance - on), upper) if n < 0.0 else (under, max(upper, distance - on))
    return low - ox, high - ox, max(0.0, under, -upper)


@inlined
def _largest(links: LinkExtents) -> tuple[float, float, float]:
    """The links' largest width, reach, and distance from the plane."""
    widest, farthest, aside = 0.0, 0.0, 0.0
    for k in range(len(links.growth)):
        widest, farthest = max(widest, links.growth[k] + links.depths[k]), max(farthest, links.reaches[k])
        aside = max(aside, abs(links.lateral[k]))
    return widest, farthest, aside


@inlined
def _near_balls(balls: Balls, plane: ArmPlane, links: LinkExtents) -> tuple[int, IntArray, FloatArray]:
    """Number of balls near enough for any link, which they are, and their centres in plane coordinates."""
    (centres, radii, _), (origin, axes, half_angle, _) = balls, plane
    moved = 2.0 * math.sin(0.5 * half_angle)
    ox, on = _origin_from_axis(plane)
    widest, farthest, aside = _largest(links)
    near, places = np.empty(len(radii), dtype=np.int64), np.empty((len(radii), 3))
    found = 0
    for b in range(len(radii)):
        dx, dy, dz = centres[b, 0] - origin[0], centres[b, 1] - origin[1], centres[b, 2] - origin[2]
        x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
        y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        size = (radii[b] + widest + moved * math.sqrt((x + ox) ** 2 + (n + on) ** 2)) * (1.0 + 1e-9)
        if abs(n) <= size + aside and x * x + y * y <= (farthest + size) ** 2:
            near[found], places[found, 0], places[found, 1], places[found, 2] = b, x, y, n
            found += 1
    return found, near, places


@kernel
def cut_balls(balls: Balls, plane: ArmPlane, links: LinkExtents, discs_only: bool, error: float) -> Cut:
    """Sections of balls, link by link.

    Args:
        discs_only: Whether a disc must hold what is a stadium.
        error: How far a section may stand outside [m].
    """
    (_, radii, obstacles), half_angle, (growth, depths, reaches, lateral) = balls, plane.half_angle, links
    count, cos, sin = len(growth), math.cos(half_angle), math.sin(half_angle)
    ox, plane_on = _origin_from_axis(plane)
    found, near, places = _near_balls(balls, plane, links)
    link_start, vertex_start = np.empty(count + 1, dtype=np.int64), np.empty(count * found + 1, dtype=np.int64)
    discs, owners = np.empty((count * found, 4)), np.empty(count * found, dtype=np.int64)
    vertices = np.empty((2 * count * found, 2))
    link_start[0], vertex_start[0] = 0, 0
    made, used = 0, 0
    for k in range(count):
        on = plane_on + lateral[k]
        off_axis = abs(on) if abs(on) <= _THROUGH_AXIS else 0.0
        for c in range(found):
            x, y, n = places[c, 0], places[c, 1], places[c, 2]
            radius = radii[near[c]] + growth[k]
            low, high, height = x, x, abs(n - lateral[k])
            if half_angle > 0.0:
                x, n = x + ox, n + plane_on
                radius += OUTWARD + off_axis
                nested = abs(on) <= _THROUGH_AXIS and depths[k] == 0.0 and x * x + n * n > radius * radius
                low, high, height = _ball(x, n, ox, on, cos, sin, nested)
            height = max(0.0, height - depths[k])
            square = radius * radius - height * height
            if square < 0.0:
                continue
            rounding, half, middle = math.sqrt(square), 0.5 * (high - low), 0.5 * (low + high)
            if math.sqrt(middle * middle + y * y) > (reaches[k] + half + rounding) * (1.0 + 1e-9):
                continue
            discs[made, 0], discs[made, 1], discs[made, 2] = middle, y, half + rounding
            if discs_only or half <= 0.125 * error:
                rounding += half
                low, half = middle, 0.0
            vertices[used, 0], vertices[used, 1] = low, y
            used += 1
            if half > 0.0:
                vertices[used, 0], vertices[used, 1] = high, y
                used += 1
            discs[made, 3], owners[made] = rounding, obstacles[near[c]]
            made += 1
            vertex_start[made] = used
        link_start[k + 1] = made
    return Cut(link_start, vertex_start, vertices, discs, owners)


@inlined
def _near_hulls(hulls: Hulls, plane: ArmPlane, links: LinkExtents) -> tuple[int, IntArray, int, float]:
    """Number of hulls near enough for any link, which they are, most points of one, and the links' largest reach."""
    (_, starts, radii, _, bounds), (origin, axes, half_angle, yaw_axis) = hulls, plane
    moved, (widest, farthest, aside) = 2.0 * math.sin(0.5 * half_angle), _largest(links)
    near = np.empty(len(bounds), dtype=np.int64)
    found, most = 0, 0
    for b in range(len(bounds)):
        dx, dy, dz = bounds[b, 0] - origin[0], bounds[b, 1] - origin[1], bounds[b, 2] - origin[2]
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        away = moved * math.sqrt((bounds[b, 0] - yaw_axis[0]) ** 2 + (bounds[b, 1] - yaw_axis[1]) ** 2)
        size = (radii[b] + widest + bounds[b, 3] + away) * (1.0 + 1e-9)
        if abs(n) <= size + aside and dx * dx + dy * dy + dz * dz - n * n <= (farthest + size) ** 2:
            near[found] = b
            found += 1
            most = max(most, starts[b + 1] - starts[b])
    return found, near, most, farthest


@inlined
def _disc_around(corners: FloatArray, count: int, rounding: float) -> tuple[float, float, float]:
    """Centre and radius of a disc around a rounded polygon: about the middle of its corners' bounding box."""
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
    """Sections of grown hulls, link by link, behind those of the balls of each link.

    Args:
        error: How far a section may stand outside [m].
        balls: What `cut_balls` has made.
    """
    (points, starts, radii, obstacles, _), (growth, _, reaches, lateral) = hulls, links
    ball_start, ball_vertex_start, ball_vertices, ball_discs, ball_owners = balls
    count = len(growth)
    found, near, most, farthest = _near_hulls(hulls, plane, links)
    # Two for each point, of small cores also where each pair crosses the two borders; and the points themselves.
    turned = np.empty((3 * most + 2 * _CUT_POINTS * _CUT_POINTS, 3))
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
            radius = radii[b] + growth[k]
            swept, more, ex, ey = _sweep(points[starts[b] : starts[b + 1]], plane, lateral[k], radius, farthest, turned)
            if swept == 0:
                continue
            sides, rounding = cut_hull(turned[:swept], radius + more, (ex, ey), error, tangents, after, corners)
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
