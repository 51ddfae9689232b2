"""Exact contact angles of a rectangular link and a disc.

They serve for comparison with the capsule link and the paper's equations.
"""

from __future__ import annotations

import math

from hplan.base.kernels import inline, kernel


@kernel
def rectangle_half_angles(rho: float, length: float, half_width: float, radius: float) -> tuple[float, float]:
    """Minimum and maximum |bearing| of contact of disc and rectangle.

    -1 without contact.

    The rectangle is [0, length] x [-w, w]. Grown by the disc's radius, it extends to `extent(a)` in direction `a`;
    `extent` increases from `a = 0` to the corner and decreases from there to `a = pi`. Each branch below inverts one
    piece of it.
    """
    corner = math.hypot(length, half_width)
    if rho > corner + radius:
        return -1.0, -1.0
    if rho <= radius:
        return 0.0, math.pi
    to_corner = math.atan2(half_width, length)
    lowest = 0.0
    if rho > length + radius:
        if rho <= math.hypot(length + radius, half_width):
            lowest = math.acos((length + radius) / rho)
        else:
            lowest = to_corner - _arc(rho, corner, radius)
    if rho <= math.hypot(radius, half_width):
        highest = math.pi - math.acos(radius / rho)
    elif rho <= half_width + radius:
        sine = (rho * rho + half_width * half_width - radius * radius) / (2.0 * rho * half_width)
        highest = math.pi - math.asin(min(1.0, sine))
    elif rho <= math.hypot(length, half_width + radius):
        highest = math.asin((half_width + radius) / rho)
    else:
        highest = to_corner + _arc(rho, corner, radius)
    return lowest, highest


@inline
def _arc(rho: float, centre: float, radius: float) -> float:
    """Angle between directions to a circle's centre and a point.

    The point of the circle is at distance rho.
    """
    cosine = (rho * rho + centre * centre - radius * radius) / (2.0 * rho * centre)
    return math.acos(max(-1.0, min(1.0, cosine)))
