"""Groups paths into approximate homotopy classes.

If the straight motions between corresponding points of two paths are collision-free, each path can be deformed into the
other without contact (the visibility deformation of Jaillet and Simeon 2008, "Path deformation roadmaps"). Only a few
points are checked: paths of one class lead to about the same time-optimal motion, so one of them suffices. The result
is a heuristic and certifies nothing.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import any_int, kernel
from hplan.collision.compiled_clearance import least_body_clearance
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_obstacles import FieldArrays

#: Points of comparison, as fractions of the paths' durations.
PARTS = frozen(np.linspace(0.0, 1.0, 14)[1:-1])

#: Number of points checked between corresponding points of two paths.
BETWEEN = any_int(3)


def class_numbers(paths: FloatArray, field: ClearanceField) -> IntArray:
    """(n,) class numbers: index of the first path each one deforms into.

    Args:
        paths: (n, k, dof) corresponding points of the paths, which share their start and goal.
    """
    number = _class_numbers(np.array(paths), field.arrays)
    check_deadline()
    return frozen(number)


@kernel
def _class_numbers(paths: FloatArray, field: FieldArrays) -> IntArray:
    """Compare each path with the first member of every class, in order."""
    count = paths.shape[0]
    number, q = np.arange(count), np.empty(paths.shape[2])
    for path in range(count):
        if is_up(field.until):
            break
        for first in range(path):
            if number[first] == first and _may_be_moved(paths[path], paths[first], field, q):
                number[path] = first
                break
    return number


@kernel
def _may_be_moved(path: FloatArray, other: FloatArray, field: FieldArrays, q: FloatArray) -> bool:
    """True if no contact is detected between corresponding points."""
    points, dof = path.shape
    for k in range(1, BETWEEN + 1):
        part = k / (BETWEEN + 1)
        for point in range(points):
            for j in range(dof):
                q[j] = path[point, j] + part * (other[point, j] - path[point, j])
            if least_body_clearance(q, field, 0.0) < 0.0:
                return False
    return True
