"""By how much a body that moves for a while can come nearer to another, along one direction."""

from __future__ import annotations

import math
from typing import NamedTuple

from hplan.base.kernels import kernel
from hplan.collision.vectors import Vector, cross, dot


class Sweep(NamedTuple):
    """How the first of two bodies moves as seen from the other, for some time before and after now.

    It lies in a ball, whose centre has a velocity, and which turns with a spin; what its points' velocities change by
    is bounded.

    Attributes:
        velocity: Of the ball's centre.
        spin: Angular velocity.
        radius: Of the ball [m].
        back: How long before now, >= 0.
        forward: How long after now, >= 0.
        bend_back: By how much more than by its velocity now a point may move in that time [m].
        bend_forward: The same of the time after.
        speed: How fast its points ever move at most.
        least: Distance that is asked for now; half of it is for all of the time [m].
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


#: Nothing is asked of directions.
STILL = Sweep((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0)


@kernel
def used_up(sweep: Sweep, direction: Vector, length: float) -> float:
    """By how much a sweep brings the first body nearer to the other along a direction, the other's to it [m].

    With `n` the direction's unit vector, a point at `x` from the ball's centre moves by `n . (v + w x x)` along it, and
    `n . (w x x) = x . (n x w)` is `|n x w|` times the radius at most.
    """
    if sweep.speed == math.inf:
        return math.inf
    along = dot(direction, sweep.velocity) / length
    across = cross(direction, sweep.spin)
    turning = sweep.radius * math.sqrt(dot(across, across)) / length
    after = min(sweep.forward * sweep.speed, sweep.forward * (turning - along) + sweep.bend_forward)
    before = min(sweep.back * sweep.speed, sweep.back * (turning + along) + sweep.bend_back)
    return max(sweep.least, 0.5 * sweep.least + max(after, before))
