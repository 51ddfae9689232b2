"""Upper bound of a moving body's approach to another along one direction."""

from __future__ import annotations

import math
from typing import NamedTuple

from hplan.base.kernels import kernel
from hplan.geometry.vectors import Vector, cross, dot


class Sweep(NamedTuple):
    """Motion of a body relative to another one, around now.

    The body lies in a ball whose centre has a velocity and which rotates with a spin; the change of its points'
    velocities is bounded.

    Attributes:
        velocity: Velocity of the ball's centre.
        spin: Angular velocity.
        radius: Radius of the ball [m].
        back: Duration before now, >= 0.
        forward: Duration after now, >= 0.
        bend_back: Upper bound of a point's displacement beyond constant velocity during `back` [m].
        bend_forward: The same bound during `forward` [m].
        speed: Upper bound of its points' speed at all times.
        least: Distance required now; half of it is required over the whole time [m].
    """

    velocity: Vector
    spin: Vector
    radius: float
    back: float
    forward: float
    bend_back: float
    bend_forward: float
    speed: float
    least: float


#: A sweep that no direction satisfies: it disables the early exit of distance queries.
STILL = Sweep((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0)


@kernel
def used_up(sweep: Sweep, direction: Vector, length: float) -> float:
    """Upper bound of the clearance used up along a direction [m].

    `direction` points from the other body to the first. With `n` its unit vector, a point at `x` from the ball's centre
    moves by `n . (v + w x x)` along it, and `n . (w x x) = x . (n x w)` is at most `|n x w|` times the radius.
    """
    if sweep.speed == math.inf:
        return math.inf
    along = dot(direction, sweep.velocity) / length
    across = cross(direction, sweep.spin)
    turning = sweep.radius * math.sqrt(dot(across, across)) / length
    after = min(sweep.forward * sweep.speed, sweep.forward * (turning - along) + sweep.bend_forward)
    before = min(sweep.back * sweep.speed, sweep.back * (turning + along) + sweep.bend_back)
    return max(sweep.least, 0.5 * sweep.least + max(after, before))
