"""Limits, aim and effort of post-processing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from hplan.base.arrays import FloatArray, IntArray

#: Aims of post-processing.
Objective = Literal["duration", "length"]
OBJECTIVES: tuple[Objective, ...] = ("duration", "length")


class JointArrays(NamedTuple):
    """The arrays of `PostprocessOptions` that kernels read: limits of all joints, and the joints that may move."""

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
        starts: How many numbers of control points are carried through for the fastest motion: the search is local, so
            each finds another path.
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
    starts: int = 2

    @cached_property
    def joints(self) -> JointArrays:
        """The arrays for kernels."""
        return JointArrays(self.lower, self.upper, self.velocity, self.acceleration, self.movable)
