"""Operations on three coordinates and poses as tuples, which stay in registers."""

from __future__ import annotations

from typing import TypeAlias

from hplan.base.arrays import FloatArray
from hplan.base.kernels import inline, kernel

#: Three coordinates. A tuple stays in registers; an array would be allocated and reference-counted in each call.
Vector: TypeAlias = tuple[float, float, float]

#: A rotation, three rows of three numbers, and a translation [m].
Pose: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float, float, float]


@inline
def vector_of(numbers: FloatArray) -> Vector:
    """The first three numbers, as a tuple."""
    return numbers[0], numbers[1], numbers[2]


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def sub(a: Vector, b: Vector) -> Vector:
    """The difference a - b, the vector from b to a."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def moved_on(a: Vector, b: Vector, factor: float) -> Vector:
    """The sum a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@kernel
def rotate(pose: Pose, d: Vector) -> Vector:
    """Rotate a direction by the pose."""
    return (
        pose[0] * d[0] + pose[1] * d[1] + pose[2] * d[2],
        pose[3] * d[0] + pose[4] * d[1] + pose[5] * d[2],
        pose[6] * d[0] + pose[7] * d[1] + pose[8] * d[2],
    )


@kernel
def turned_back(pose: Pose, d: Vector) -> Vector:
    """Rotate a direction by the inverse of the pose."""
    return (
        pose[0] * d[0] + pose[3] * d[1] + pose[6] * d[2],
        pose[1] * d[0] + pose[4] * d[1] + pose[7] * d[2],
        pose[2] * d[0] + pose[5] * d[1] + pose[8] * d[2],
    )


@kernel
def placed_point(pose: Pose, points: FloatArray, p: int) -> Vector:
    """Transform a point by the pose."""
    x, y, z = points[p], points[p + 1], points[p + 2]
    return (
        pose[0] * x + pose[1] * y + pose[2] * z + pose[9],
        pose[3] * x + pose[4] * y + pose[5] * z + pose[10],
        pose[6] * x + pose[7] * y + pose[8] * z + pose[11],
    )
