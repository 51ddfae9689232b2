"""Closed-form distances of points and segments.

Segments from points, segments and boxes; points from hulls.

A distance is 0 if the two meet.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from hplan.base.arrays import FloatArray
from hplan.base.kernels import inline, kernel
from hplan.geometry.vectors import Vector

#: Vector from a body's point nearest to a segment to the segment's nearest point, and the latter's parameter on it.
Off: TypeAlias = tuple[float, float, float, float]


@inline
def point_segment(c: Vector, a: Vector, u: Vector) -> float:
    """Distance of a point c from the segment a, a + u."""
    (cx, cy, cz), (ax, ay, az), (ux, uy, uz) = c, a, u
    dx, dy, dz = cx - ax, cy - ay, cz - az
    square = ux * ux + uy * uy + uz * uz
    t = 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, (dx * ux + dy * uy + dz * uz) / square))
    dx, dy, dz = dx - t * ux, dy - t * uy, dz - t * uz
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def off_segment(a: Vector, u: Vector, b: Vector, v: Vector) -> Off:
    """Vector from one segment to another.

    From segment b, b + v to segment a, a + u. Closest points by clamping (Ericson, Real-Time Collision Detection,
    5.1.9).
    """
    (ux, uy, uz), (vx, vy, vz) = u, v
    rx, ry, rz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    vr = vx * rx + vy * ry + vz * rz
    if uu <= 1e-18 and vv <= 1e-18:
        return rx, ry, rz, 0.0
    s, t = 0.0, 0.0
    if uu <= 1e-18:
        t = min(1.0, max(0.0, vr / vv))
    else:
        ur = ux * rx + uy * ry + uz * rz
        if vv <= 1e-18:
            s = min(1.0, max(0.0, -ur / uu))
        else:
            uv = ux * vx + uy * vy + uz * vz
            determinant = uu * vv - uv * uv
            if determinant > 1e-12 * uu * vv:
                s = min(1.0, max(0.0, (uv * vr - ur * vv) / determinant))
            t = (uv * s + vr) / vv
            if t < 0.0:
                t = 0.0
                s = min(1.0, max(0.0, -ur / uu))
            elif t > 1.0:
                t = 1.0
                s = min(1.0, max(0.0, (uv - ur) / uu))
    return rx + s * ux - t * vx, ry + s * uy - t * vy, rz + s * uz - t * vz, s


@inline
def signed_excess(x: float, half: float) -> float:
    """Signed distance of a coordinate from [-half, half]."""
    return x - half if x > half else (x + half if x < -half else 0.0)


@kernel
def off_box(a: Vector, u: Vector, half: Vector) -> Off:
    """Vector from a box to the segment a, a + u.

    Everything is in the box's frame; the box has half sizes `half`. The squared distance is convex and piecewise
    quadratic along the segment; its derivative is piecewise linear and changes sign between two of the at most eight
    breakpoints (face crossings and ends).
    """
    (ax, ay, az), (ux, uy, uz), (hx, hy, hz) = a, u, half
    low, high = 0.0, 1.0
    slope_low = 2.0 * (signed_excess(ax, hx) * ux + signed_excess(ay, hy) * uy + signed_excess(az, hz) * uz)
    slope_high = 2.0 * (
        signed_excess(ax + ux, hx) * ux + signed_excess(ay + uy, hy) * uy + signed_excess(az + uz, hz) * uz
    )
    t = 0.0
    if slope_low >= 0.0:
        t = 0.0
    elif slope_high <= 0.0:
        t = 1.0
    else:
        for axis in range(3):
            if u[axis] == 0.0:
                continue
            for side in (-1.0, 1.0):
                x = (side * half[axis] - a[axis]) / u[axis]
                if low < x < high:
                    px, py, pz = ax + x * ux, ay + x * uy, az + x * uz
                    slope = 2.0 * (signed_excess(px, hx) * ux + signed_excess(py, hy) * uy + signed_excess(pz, hz) * uz)
                    if slope >= 0.0:
                        high, slope_high = x, slope
                    else:
                        low, slope_low = x, slope
        t = low - slope_low * (high - low) / (slope_high - slope_low)
    return signed_excess(ax + t * ux, hx), signed_excess(ay + t * uy, hy), signed_excess(az + t * uz, hz), t


@kernel
def point_hull(point: Vector, data: FloatArray, first: int, middle: int, last: int, enough: float) -> float:
    """Distance of a point from a hull, or a number >= `enough`.

    The result is at least `enough` if the distance is, and the distance otherwise. Facets are data[first:middle], edges
    are data[middle:last]. The hull's nearest point lies on the facet with the largest signed distance of the point, or
    on an edge.
    """
    x, y, z = point
    top, at = -math.inf, first
    for f in range(first, middle, 4):
        above = data[f] * x + data[f + 1] * y + data[f + 2] * z - data[f + 3]
        if above > top:
            top, at = above, f
    if top <= 0.0:
        return 0.0
    if top >= enough:
        return top
    foot, inside = (x - top * data[at], y - top * data[at + 1], z - top * data[at + 2]), True
    for f in range(first, middle, 4):
        if data[f] * foot[0] + data[f + 1] * foot[1] + data[f + 2] * foot[2] - data[f + 3] > 1e-9:
            inside = False
            break
    if inside:
        return top
    least = enough
    for e in range(middle, last, 6):
        along = (data[e + 3], data[e + 4], data[e + 5])
        least = min(least, point_segment(point, (data[e], data[e + 1], data[e + 2]), along))
    return least
