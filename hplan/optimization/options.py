"""Joint limits and clearance margin of post-processing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from hplan.base.arrays import FloatArray, IntArray


class JointArrays(NamedTuple):
    """Arrays of `PostprocessOptions` that kernels read."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray


@dataclass(frozen=True, eq=False)
class PostprocessOptions:
    """Joint limits and clearance margin of post-processing.

    Attributes:
        lower: (dof,) lower joint limits.
        upper: (dof,) upper joint limits.
        velocity: (dof,) velocity limits [rad/s].
        acceleration: (dof,) acceleration limits [rad/s^2].
        movable: (k,) indices of the joints that may move.
        margin: Required clearance at each evaluated configuration [m].
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray
    margin: float

    @cached_property
    def joints(self) -> JointArrays:
        """The arrays for kernels."""
        return JointArrays(self.lower, self.upper, self.velocity, self.acceleration, self.movable)
