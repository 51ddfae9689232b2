"""Rotations by roll, pitch and yaw, and by quaternions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hplan.base.arrays import FloatArray


def rpy_rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation by roll, pitch and yaw about fixed axes, (3, 3) [rad]."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion_rotation(quaternion_xyzw: Sequence[float]) -> FloatArray:
    """Rotation of a quaternion (x, y, z, w) after normalization, (3, 3)."""
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    x, y, z, w = q / np.linalg.norm(q)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + 2.0 * w * across + 2.0 * across @ across
    return rotation


def rpy_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a (3, 3) rotation [deg].

    It inverts `rpy_rotation`, which takes radians.
    """
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) > 1e-9:
        roll, yaw = math.atan2(rotation[2, 1], rotation[2, 2]), math.atan2(rotation[1, 0], rotation[0, 0])
    else:  # gimbal lock: roll and yaw rotate about the same axis
        roll, yaw = 0.0, math.atan2(-rotation[0, 1], rotation[1, 1])
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
