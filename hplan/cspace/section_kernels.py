r"""The compiled part of `hplan.cspace.sections`: all bodies cut by the arm plane at once, link by link.

At one yaw the section of a ball is a disc, and that of a hull is drawn by `hplan.cspace.hull_section`.

**A yaw interval.** Let :math:`R_\delta` turn about the yaw axis. The arm plane at yaw :math:`\psi + \delta` has its
origin and axes turned by :math:`R_\delta`, so a point :math:`p` has there the plane coordinates that
:math:`R_{-\delta}\,p` has in the plane at :math:`\psi`, wherever the origin stands. The sections over the interval
are those of the plane at :math:`\psi` with the body turned by all :math:`|\delta| \le h`.

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
from hplan.cspace.hull_section import MOST_TANGENTS, OUTWARD, cut_hull

#: A plane that passes the yaw axis by less holds it; bodies grow by the difference [m].
_THROUGH_AXIS = 1e-6

#: Cores of at most this many points (boxes) are cut to what comes near the plane before they are swept.
_CUT_POINTS = 8


@kernel
def _sweep(
    points: FloatArray,
    first: int,
    last: int,
    origin: FloatArray,
    axes: FloatArray,
    half_angle: float,
    radius: float,
    reach: float,
    turned: FloatArray,
) -> tuple[int, float, float, float]:
    """Core points in plane coordinates; over an interval of yaw the two for each that the module's text speaks of.

    Returns:
        How many points were written, by how much the radius grows, and the direction from the first core point to the
        second, in the plane.
    """
    count = last - first
    spare = len(turned) - count  # the core's own points stand at the end until they are turned
    far = 0.0
    # Along, upward and aside, of the axis where there is an interval and of the plane's origin where there is none.
    ox = axes[0, 0] * origin[0] + axes[0, 1] * origin[1] + axes[0, 2] * origin[2]
    on = axes[2, 0] * origin[0] + axes[2, 1] * origin[1] + axes[2, 2] * origin[2]
    swept = half_angle > 0.0
    for i in range(count):
        x, y, z = points[first + i, 0] - origin[0], points[first + i, 1] - origin[1], points[first + i, 2] - origin[2]
        for axis in range(3):
            turned[spare + i, axis] = axes[axis, 0] * x + axes[axis, 1] * y + axes[axis, 2] * z
        if swept:
            turned[spare + i, 0] += ox
            turned[spare + i, 2] += on
            far = max(far, math.hypot(turned[spare + i, 0], turned[spare + i, 2]))
    ex, ey = turned[spare + 1, 0] - turned[spare, 0], turned[spare + 1, 1] - turned[spare, 1]
    length = math.hypot(ex, ey)
    ex, ey = (ex / length, ey / length) if length > 1e-9 else (1.0, 0.0)
    written = 0
    if not swept:
        for i in range(count):
            for axis in range(3):
                turned[i, axis] = turned[spare + i, axis]
        return count, 0.0, ex, ey
    cos, sin = math.cos(half_angle), math.sin(half_angle)
    # What is farther aside than this touches the plane at no yaw of the interval within the reach.
    wide = min(far, abs(ox) + reach + radius) * sin + OUTWARD * (1.0 + far)
    upper, under = on + radius, on - radius
    upper = (upper if upper > 0.0 else upper * cos) + wide
    under = (under if under < 0.0 else under * cos) - wide
    for i in range(count):
        height = turned[spare + i, 2]
        if count > _CUT_POINTS or under <= height <= upper:
            for axis in range(3):
                turned[written, axis] = turned[spare + i, axis]
            written += 1
        if count > _CUT_POINTS:
            continue
        for j in range(i):
            rise = turned[spare + j, 2] - height
            for side in range(2):
                level = under if side == 0 else upper
                if (height - level) * (height + rise - level) < 0.0:
                    share = (level - height) / rise
                    for axis in range(3):
                        turned[written, axis] = turned[spare + i, axis] + share * (
                            turned[spare + j, axis] - turned[spare + i, axis]
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
    """Range of the centre's place along the plane, and its least height, while it turns about the axis.

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


@kernel
def cut_balls(
    centres: FloatArray,
    radii: FloatArray,
    owners: IntArray,
    origin: FloatArray,
    axes: FloatArray,
    half_angle: float,
    growth: FloatArray,
    depths: FloatArray,
    reaches: FloatArray,
    discs_only: bool,
    error: float,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, IntArray]:
    """Sections of balls, link by link.

    Args:
        centres: (balls, 3) centres [m].
        radii: (balls,) radii [m].
        owners: (balls,) whose they are.
        origin: (3,) the plane's origin [m].
        axes: (3, 3) rows: the plane's horizontal and upward axis, its normal.
        half_angle: Half of the yaw interval, less than a right angle; above 0 the plane must be vertical.
        growth: (links,) what each link adds to the radii [m].
        depths: (links,) how far each link extends to both sides of the plane, flat [m].
        reaches: (links,) distance from the origin beyond which sections are left out [m], inf for none.
        discs_only: Whether a disc must hold what is a stadium.
        error: How far a section may stand outside [m].

    Returns:
        Sections as in `hplan.cspace.sections.ArmSections`: link starts, vertex starts, vertices; of each section its
        bound and its radius in one row, and its owner. All but the first have room left behind the last section.
    """
    links = len(growth)
    cos, sin, moved = math.cos(half_angle), math.sin(half_angle), 2.0 * math.sin(0.5 * half_angle)
    ox = axes[0, 0] * origin[0] + axes[0, 1] * origin[1] + axes[0, 2] * origin[2]
    on = axes[2, 0] * origin[0] + axes[2, 1] * origin[1] + axes[2, 2] * origin[2]
    aside = abs(on) if abs(on) <= _THROUGH_AXIS else 0.0
    widest, farthest = 0.0, 0.0
    for k in range(links):
        widest, farthest = max(widest, growth[k] + depths[k]), max(farthest, reaches[k])
    # Balls near enough for any link, with their centres in plane coordinates.
    near, places = np.empty(len(radii), dtype=np.int64), np.empty((len(radii), 3))
    found = 0
    for b in range(len(radii)):
        dx, dy, dz = centres[b, 0] - origin[0], centres[b, 1] - origin[1], centres[b, 2] - origin[2]
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        x = axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz
        y = axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz
        size = (radii[b] + widest + moved * math.sqrt((x + ox) ** 2 + (n + on) ** 2)) * (1.0 + 1e-9)
        if abs(n) <= size and x * x + y * y <= (farthest + size) ** 2:
            near[found], places[found, 0], places[found, 1], places[found, 2] = b, x, y, n
            found += 1
    link_start, vertex_start = np.empty(links + 1, dtype=np.int64), np.empty(links * found + 1, dtype=np.int64)
    discs, owner = np.empty((links * found, 4)), np.empty(links * found, dtype=np.int64)
    vertices = np.empty((2 * links * found, 2))
    link_start[0], vertex_start[0] = 0, 0
    made, used = 0, 0
    for k in range(links):
        for c in range(found):
            x, y, n = places[c, 0], places[c, 1], places[c, 2]
            radius = radii[near[c]] + growth[k]
            low, high, height = x, x, abs(n)
            if half_angle > 0.0:
                x, n = x + ox, n + on
                radius += OUTWARD + aside
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
            discs[made, 3], owner[made] = rounding, owners[near[c]]
            made += 1
            vertex_start[made] = used
        link_start[k + 1] = made
    return link_start, vertex_start, vertices, discs, owner


@kernel
def cut_hulls(
    points: FloatArray,
    starts: IntArray,
    radii: FloatArray,
    owners: IntArray,
    around: FloatArray,
    origin: FloatArray,
    axes: FloatArray,
    half_angle: float,
    growth: FloatArray,
    reaches: FloatArray,
    error: float,
    ball_start: IntArray,
    ball_vertex_start: IntArray,
    ball_vertices: FloatArray,
    ball_discs: FloatArray,
    ball_owner: IntArray,
) -> tuple[IntArray, IntArray, FloatArray, FloatArray, IntArray]:
    """Sections of grown hulls, link by link, behind those of the balls of each link.

    Args:
        points: (P, 3) core points of all hulls, two or more each [m].
        starts: (hulls + 1,) indices of their first points.
        radii: (hulls,) radii about them [m].
        owners: (hulls,) whose they are.
        around: (hulls, 4) a ball around each core: centre and radius [m].
        origin: As for `cut_balls`, and so on.
        axes: The same.
        half_angle: The same.
        growth: The same.
        reaches: The same.
        error: The same.
        ball_start: What `cut_balls` returned, and so on.
        ball_vertex_start: The same.
        ball_vertices: The same.
        ball_discs: The same.
        ball_owner: The same.

    Returns:
        As `cut_balls`.
    """
    links = len(growth)
    moved, widest, farthest = 2.0 * math.sin(0.5 * half_angle), 0.0, 0.0
    for k in range(links):
        widest, farthest = max(widest, growth[k]), max(farthest, reaches[k])
    near = np.empty(len(radii), dtype=np.int64)
    found, most = 0, 0
    for b in range(len(radii)):
        dx, dy, dz = around[b, 0] - origin[0], around[b, 1] - origin[1], around[b, 2] - origin[2]
        n = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
        away = moved * math.sqrt(around[b, 0] ** 2 + around[b, 1] ** 2)
        size = (radii[b] + widest + around[b, 3] + away) * (1.0 + 1e-9)
        if abs(n) <= size and dx * dx + dy * dy + dz * dz - n * n <= (farthest + size) ** 2:
            near[found] = b
            found += 1
            most = max(most, starts[b + 1] - starts[b])
    # Two for each point, of small cores also where each pair crosses the two borders; and the points themselves.
    turned = np.empty((3 * most + 2 * _CUT_POINTS * _CUT_POINTS, 3))
    tangents, after = np.empty((MOST_TANGENTS, 5)), np.empty(MOST_TANGENTS, dtype=np.int64)
    corners = np.empty((MOST_TANGENTS, 2))
    room = links * found + ball_start[links]
    link_start, vertex_start = np.empty(links + 1, dtype=np.int64), np.empty(room + 1, dtype=np.int64)
    discs, owner = np.empty((room, 4)), np.empty(room, dtype=np.int64)
    vertices = np.empty((MOST_TANGENTS * links * found + ball_vertex_start[ball_start[links]], 2))
    link_start[0], vertex_start[0] = 0, 0
    made, used = 0, 0
    for k in range(links):
        for s in range(ball_start[k], ball_start[k + 1]):
            for i in range(ball_vertex_start[s], ball_vertex_start[s + 1]):
                vertices[used, 0], vertices[used, 1] = ball_vertices[i, 0], ball_vertices[i, 1]
                used += 1
            for i in range(4):
                discs[made, i] = ball_discs[s, i]
            owner[made] = ball_owner[s]
            made += 1
            vertex_start[made] = used
        for c in range(found):
            b = near[c]
            radius = radii[b] + growth[k]
            count, more, ex, ey = _sweep(
                points, starts[b], starts[b + 1], origin, axes, half_angle, radius, farthest, turned
            )  # fmt: skip
            if count == 0:
                continue
            count, rounding = cut_hull(turned, count, radius + more, ex, ey, error, tangents, after, corners)
            if count == 0:
                continue
            low_x, low_y, high_x, high_y = corners[0, 0], corners[0, 1], corners[0, 0], corners[0, 1]
            for i in range(count):
                x, y = corners[i, 0], corners[i, 1]
                vertices[used + i, 0], vertices[used + i, 1] = x, y
                low_x, high_x = min(low_x, x), max(high_x, x)
                low_y, high_y = min(low_y, y), max(high_y, y)
            x, y, extent = 0.5 * (low_x + high_x), 0.5 * (low_y + high_y), 0.0
            for i in range(count):
                extent = max(extent, (corners[i, 0] - x) ** 2 + (corners[i, 1] - y) ** 2)
            extent = math.sqrt(extent) + rounding
            if math.sqrt(x * x + y * y) > (reaches[k] + extent) * (1.0 + 1e-9):
                continue
            discs[made, 0], discs[made, 1], discs[made, 2], discs[made, 3] = x, y, extent, rounding
            owner[made] = owners[b]
            used += count
            made += 1
            vertex_start[made] = used
        link_start[k + 1] = made
    return link_start, vertex_start, vertices, discs, owner
