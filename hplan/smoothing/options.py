"""Limits, aim and effort of post-processing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from hplan.base.arrays import FloatArray, IntArray

#: What a path is made for.
Objective = Literal["duration", "length"]
OBJECTIVES: tuple[Objective, ...] = ("duration", "length")


class JointArrays(NamedTuple):
    """What kernels read of `PostprocessOptions`: limits of all joints, and which of them may move."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray


@dataclass(frozen=True, eq=False)
class PostprocessOptions:
    """Limits, aim and effort of post-processing.

    Attributes:
        lower: (dof,) joint limits.
        upper: (dof,) joint limits.
        velocity: (dof,) velocity limits [rad/s].
        acceleration: (dof,) acceleration limits [rad/s^2].
        movable: Joints that may move.
        margin: Clearance asked for wherever a motion is evaluated [m].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        shortcuts: Shortcuts tried on the polyline.
        trials: Steps tried on the spline for a shorter duration.
        taut_rounds: Rounds of pulling taut for a shorter path.
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray
    margin: float
    objective: Objective = "duration"
    shortcuts: int = 200
    trials: int = 250
    taut_rounds: int = 45

    @cached_property
    def joints(self) -> JointArrays:
        """What kernels are given."""
        return JointArrays(self.lower, self.upper, self.velocity, self.acceleration, self.movable)
