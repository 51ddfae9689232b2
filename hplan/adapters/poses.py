"""Poses as other programs write them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, numbers
from hplan.errors import InputError
from hplan.geometry.rotation import quaternion_rotation


def pose_of_row(row: ArrayLike) -> FloatArray:
    """(4, 4) matrix of a pose given as (7,) x, y, z [m], qw, qx, qy, qz.

    Raises:
        InputError: It is not such a row.

    Examples:
        >>> pose_of_row([1.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0])[:3, 3].tolist()
        [1.0, 0.0, 0.5]
    """
    values = numbers("pose", row, (7,))
    if not np.linalg.norm(values[3:]) > 0.5:
        raise InputError(f"pose: expected a quaternion of length 1 after the position, got {values[3:].tolist()}")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = quaternion_rotation(np.roll(values[3:], -1).tolist()), values[:3]
    return pose
