r"""The compiled part of `hplan.section`: all bodies cut by the arm plane at once, link by link.

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

**A section of a hull.** With core points :math:`p_i` at heights :math:`n_i`, the section's support along a unit
vector :math:`u` of the plane is

.. math:: \min_t \; \max_i \, (u \cdot p_i + t\,n_i) + r \sqrt{1 + t^2},

any tilt :math:`t` gives a bound, and the best is found between the two points that bind. It touches the ball about a
core point at some height :math:`n`, whose disc of radius :math:`\sqrt{r^2 - n^2}` lies in the section. With
:math:`q` the least such radius the section is therefore a convex set grown by :math:`q`; tangents are drawn around
that set, each new one along the chord of the two points where its neighbours touch, until no corner stands
farther than the allowed error from such a chord. Straight sides are found exactly so, and a branch in the plane, beside
it or across it needs no tangents but four.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.arrays import FloatArray, IntArray
from hplan.kernels import inlined, kernel

#: Bodies grow by this, relative to their size above 1 m, so that rounding errors fall on the safe side [m].
_OUTWARD = 1e-12

#: Heights that differ by less are the same [m].
_IN_PLANE = 1e-12

#: A plane that passes the yaw axis by less holds it; bodies grow by the difference [m].
_THROUGH_AXIS = 1e-6

#: Tangents about one section at most; where they do not do, the section may stand out farther than asked for.
_MOST_TANGENTS = 256

#: Cores of at most this many points (boxes) are cut to what comes near the plane before they are swept.
_CUT_POINTS = 8

#: Cores of more points than this are not searched for a rounding that their section keeps.
_ROUNDED_POINTS = 128

#: Largest number of steps to the binding points; the support is a bound after any.
_STEPS = 64


@inlined
def _support(
    points: FloatArray, count: int, radius: float, ux: float, uy: float, lowest: int, highest: int
) -> tuple[float, float, int, int, float]:
    """Support of the section along (ux, uy), and where it touches.

    Returns:
        The support, the radius of the disc that touches, and its centre: two core points and the share of the second.
    """
    low, high, share, across, excess = lowest, highest, 0.0, 0.0, 0.0
    support = 0.0
    for _ in range(_STEPS):
        low_reach = ux * points[low, 0] + uy * points[low, 1]
        high_reach = ux * points[high, 0] + uy * points[high, 1]
        rise = points[high, 2] - points[low, 2]
        # The tilt at which both bind, unless one of them binds alone at a better one.
        tilt, root, alone = 0.0, 1.0, 0 if low_reach >= high_reach else 1
        if rise > _IN_PLANE:
            tilt = (low_reach - high_reach) / rise
            root = math.sqrt(1.0 + tilt * tilt)
            height = -radius * tilt / root
            share = (height - points[low, 2]) / rise
            alone = 0 if share < 0.0 else (1 if share > 1.0 else -1)
        if alone >= 0:
            share = float(alone)
            height = points[high, 2] if alone == 1 else points[low, 2]
            flat = max(math.sqrt(max(0.0, radius * radius - height * height)), 1e-9 * radius)
            tilt = -height / flat
            root = math.sqrt(1.0 + tilt * tilt)
        across = radius / root
        reach = low_reach + share * (high_reach - low_reach)
        model = reach + tilt * height
        best, found = model, -1
        for i in range(count):
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
    return support, across, low, high, share


@kernel
def _corner(tangents: FloatArray, i: int, j: int) -> tuple[float, float]:
    """Where two tangents meet."""
    turn = tangents[i, 0] * tangents[j, 1] - tangents[i, 1] * tangents[j, 0]
    x = (tangents[i, 2] * tangents[j, 1] - tangents[j, 2] * tangents[i, 1]) / turn
    y = (tangents[j, 2] * tangents[i, 0] - tangents[i, 2] * tangents[j, 0]) / turn
    return x, y


@kernel
def _gap(x: float, y: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Distance of a point from a segment."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    t = 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / square))
    return math.sqrt((x - ax - t * dx) ** 2 + (y - ay - t * dy) ** 2)


@kernel
def _kept_rounding(points: FloatArray, count: int, radius: float) -> float:
    """A radius by which some convex set must be grown to give the section: that of no disc which touches is smaller.

    A tangent that touches the face (or edge, or vertex) of the core at height n > 0 has the tilt
    n / sqrt(r^2 - n^2), which may not exceed run over rise to any point below a vertex of that face; one such vertex
    stands at n or higher. Below the plane likewise.
    """
    if count > _ROUNDED_POINTS:
        return 0.0
    worst = 0.0
    for i in range(count):
        height = points[i, 2]
        share = min(1.0, (height / radius) ** 2)
        for j in range(count):
            rise = points[j, 2] - height
            if rise * height < 0.0 and share > worst:
                square = (points[j, 0] - points[i, 0]) ** 2 + (points[j, 1] - points[i, 1]) ** 2
                share = min(share, square / (square + rise * rise))
        worst = max(worst, share)
    return radius * math.sqrt(1.0 - worst)


@kernel
def cut_hull(
    points: FloatArray,
    count: int,
    radius: float,
    ex: float,
    ey: float,
    error: float,
    tangents: FloatArray,
    after: IntArray,
    corners: FloatArray,
) -> tuple[int, float]:
    """Rounded polygon around the section of a hull of points, grown by `radius`, with the plane at height 0.

    Args:
        points: (at least `count`, 3) core points in plane coordinates [m].
        count: How many of them there are.
        radius: Radius about the hull [m].
        ex: Unit vector of the first tangent (along the core's length).
        ey: The same, second coordinate.
        error: How far the polygon may stand outside [m].
        tangents: (256, 5) for its own use: direction, support, where it touches.
        after: (256,) for its own use: the next tangent.
        corners: (256, 2) takes the vertices [m].

    Returns:
        Number of vertices, 0 where the plane misses the body, and the radius about them.
    """
    lowest, highest, size = 0, 0, 1.0
    for i in range(count):
        if points[i, 2] < points[lowest, 2]:
            lowest = i
        if points[i, 2] > points[highest, 2]:
            highest = i
        size = max(size, abs(points[i, 0]), abs(points[i, 1]), abs(points[i, 2]))
    if points[lowest, 2] > radius or points[highest, 2] < -radius:
        return 0, 0.0
    if count == 2 and points[highest, 2] - points[lowest, 2] <= _IN_PLANE:
        # Nothing to bound: all discs along the segment are the same.
        nearest = min(abs(points[lowest, 2]), abs(points[highest, 2]))
        for i in range(2):
            corners[i, 0], corners[i, 1] = points[i, 0], points[i, 1]
        same = points[0, 0] == points[1, 0] and points[0, 1] == points[1, 1]
        return 1 if same else 2, math.sqrt(radius * radius - nearest * nearest)
    radius += _OUTWARD * size
    kept = _kept_rounding(points, count, radius)
    ux, uy, made, at = ex, ey, 0, 0
    while True:
        if made >= 4:
            following = after[at]
            cx, cy = _corner(tangents, at, following)
            dx = tangents[following, 3] - tangents[at, 3]
            dy = tangents[following, 4] - tangents[at, 4]
            gap = _gap(cx, cy, tangents[at, 3], tangents[at, 4], tangents[following, 3], tangents[following, 4])
            if gap <= error:
                at = following
                if at == 0:
                    break
                continue
            if made == _MOST_TANGENTS:
                # A section of many metres: from the first four again, with less to ask for.
                error, made, at = 4.0 * error, 4, 0
                for i in range(4):
                    after[i] = (i + 1) & 3
                continue
            chord = math.hypot(dx, dy)
            if chord > 0.0:
                ux, uy = dy / chord, -dx / chord
            before = tangents[at, 0] * uy - tangents[at, 1] * ux
            behind = ux * tangents[following, 1] - uy * tangents[following, 0]
            if chord == 0.0 or before < 1e-6 or behind < 1e-6:
                ux, uy = tangents[at, 0] + tangents[following, 0], tangents[at, 1] + tangents[following, 1]
                chord = math.hypot(ux, uy)
                ux, uy = ux / chord, uy / chord
        support, across, low, high, share = _support(points, count, radius, ux, uy, lowest, highest)
        touch_x = points[low, 0] + share * (points[high, 0] - points[low, 0]) + (across - kept) * ux
        touch_y = points[low, 1] + share * (points[high, 1] - points[low, 1]) + (across - kept) * uy
        tangents[made, 0], tangents[made, 1], tangents[made, 2] = ux, uy, support - kept
        tangents[made, 3], tangents[made, 4] = touch_x, touch_y
        if made >= 4:
            after[made] = after[at]
            after[at] = made
        else:
            after[made] = (made + 1) & 3
            ux, uy = -uy, ux
        made += 1
        if made == 4:
            length, width = tangents[0, 2] + tangents[2, 2], tangents[1, 2] + tangents[3, 2]
            if width <= error:
                count, kept = _thin(tangents, length, width, kept, error, corners)
                return count, kept
    # Drop each tangent that the corner of its neighbours does without.
    start, sides = 0, made
    for _ in range(made):
        middle = after[start]
        end = after[middle]
        if sides > 3 and tangents[start, 0] * tangents[end, 1] - tangents[start, 1] * tangents[end, 0] > 0.1:
            cx, cy = _corner(tangents, start, end)
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
    for i in range(sides):
        corners[i, 0], corners[i, 1] = _corner(tangents, start, after[start])
        start = after[start]
    return sides, kept


@kernel
def _thin(
    tangents: FloatArray, length: float, width: float, kept: float, error: float, corners: FloatArray
) -> tuple[int, float]:
    """The stadium, or the disc, around a rectangle that is no wider than the error."""
    ux, uy = tangents[0, 0], tangents[0, 1]
    aside = 0.5 * (tangents[1, 2] - tangents[3, 2])
    if math.hypot(length, width) <= error:
        middle = 0.5 * (tangents[0, 2] - tangents[2, 2])
        corners[0, 0], corners[0, 1] = middle * ux - aside * uy, middle * uy + aside * ux
        return 1, kept + 0.5 * math.hypot(length, width)
    for i in range(2):
        along = tangents[0, 2] if i == 0 else -tangents[2, 2]
        corners[i, 0], corners[i, 1] = along * ux - aside * uy, along * uy + aside * ux
    return 2, kept + 0.5 * width


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
    wide = min(far, abs(ox) + reach + radius) * sin + _OUTWARD * (1.0 + far)
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
        Sections as in `hplan.section.ArmSections`: link starts, vertex starts, vertices; of each section its bound and
        its radius in one row, and its owner. All but the first have room left behind the last section.
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
                radius += _OUTWARD + aside
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
    tangents, after = np.empty((_MOST_TANGENTS, 5)), np.empty(_MOST_TANGENTS, dtype=np.int64)
    corners = np.empty((_MOST_TANGENTS, 2))
    room = links * found + ball_start[links]
    link_start, vertex_start = np.empty(links + 1, dtype=np.int64), np.empty(room + 1, dtype=np.int64)
    discs, owner = np.empty((room, 4)), np.empty(room, dtype=np.int64)
    vertices = np.empty((_MOST_TANGENTS * links * found + ball_vertex_start[ball_start[links]], 2))
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
