"""Limits of post-processing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from hplan.base.arrays import FloatArray, IntArray


class JointArrays(NamedTuple):
    """The arrays of `PostprocessOptions` that kernels read: limits of all joints, and the joints that may move."""

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    movable: IntArray


@dataclass(frozen=True, eq=False)
class PostprocessOptions:
    """Limits of post-processing.

    Attributes:
        lower: (dof,) joint limits.
        upper: (dof,) joint limits.
        velocity: (dof,) velocity limits [rad/s].
        acceleration: (dof,) acceleration limits [rad/s^2].
        margin: Clearance asked for wherever a motion is evaluated [m].
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
