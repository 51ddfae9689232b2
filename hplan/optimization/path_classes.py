"""Classes of paths: which of several paths between the same ends can be moved into each other.

Where the straight motions between corresponding points of two paths are clear, each can be moved into the other without
contact (the visibility deformation of Jaillet and Simeon 2008, "Path deformation roadmaps"). Here few points are looked
at: paths of one class lead to about the same fastest motion, and one of them will do. Nothing is shown by it.
"""

from __future__ import annotations

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import any_int, kernel
from hplan.collision.body_kernels import least_body_clearance
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.obstacle_rows import FieldArrays

#: Where paths are compared, as fractions of their times.
PARTS = frozen(np.linspace(0.0, 1.0, 14)[1:-1])

#: Points looked at between corresponding points of two paths.
BETWEEN = any_int(3)


def class_numbers(paths: FloatArray, field: ClearanceField) -> IntArray:
    """(n,) the class of each path: the number of the first path that it can be moved into.

    Args:
        paths: (n, k, dof) corresponding points of the paths, between the same ends.
    """
    number = _class_numbers(np.array(paths), field.arrays)
    check_deadline()
    return frozen(number)


@kernel
def _class_numbers(paths: FloatArray, field: FieldArrays) -> IntArray:
    """Each path is compared with the first of every class, in their order."""
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
    """True if no contact is seen between corresponding points."""
    points, dof = path.shape
    for k in range(1, BETWEEN + 1):
        part = k / (BETWEEN + 1)
        for point in range(points):
            for j in range(dof):
                q[j] = path[point, j] + part * (other[point, j] - path[point, j])
            if least_body_clearance(q, field, 0.0) < 0.0:
                return False
    return True
