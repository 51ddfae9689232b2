"""Planar family: an optional yaw, then parallel revolute joints in one plane.

Arms of the family have a closed-form C-space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, Record


@dataclass(frozen=True, eq=False)
class PlanarArm(Record):
    """Planar chain of a robot in the coordinates of its own plane.

    The plane's origin is the first planar joint (the shoulder); its first axis is horizontal, its second points
    up. Link `k` is the segment from its joint to the next joint (the last link ends at the tool frame). Relative link
    angles, counter-clockwise from the first axis, are `signs * q + offsets`. The tool moves in the plane; the body of
    a link may lie off it, in a plane of its own.

    Attributes:
        joint_names: Names of the `n` planar joints.
        link_names: Names of the `n` links they move.
        lengths: (n,) link lengths [m].
        half_widths: (n,) radii of the capsules that enclose the links [m].
        lateral: (n,) distances of these capsules' axes from the plane, along its normal [m].
        signs: (n,) +1 or -1, sense of each joint.
        offsets: (n,) relative link angles at q = 0.
        lower: (n,) lower joint limits.
        upper: (n,) upper joint limits.
    """

    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    lengths: FloatArray
    half_widths: FloatArray
    lateral: FloatArray
    signs: FloatArray
    offsets: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def link_count(self) -> int:
        """Number of planar links."""
        return len(self.link_names)

    def joint_points(self, q: ArrayLike) -> FloatArray:
        """Joint and tool positions in the plane.

        Args:
            q: (..., n) planar joint angles.

        Returns:
            (..., n + 1, 2) positions [m]: the joints from the shoulder on, the tool frame last.
        """
        angles = np.cumsum(self.signs * np.asarray(q, dtype=np.float64) + self.offsets, axis=-1)
        steps = self.lengths[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        origin = np.zeros_like(steps[..., :1, :])
        return np.concatenate([origin, np.cumsum(steps, axis=-2)], axis=-2)


@dataclass(frozen=True, eq=False)
class PlanarFamily(Record):
    """Planar chain of an arm, and its placement in `base_link`.

    Attributes:
        has_yaw: True if joint 0 turns the arm plane about the vertical.
        yaw_axis: (2,) horizontal position of the yaw axis in `base_link` [m]; zeros without a yaw.
        plane_origin: (3,) shoulder position at yaw 0, in `base_link` [m].
        plane_axes: (2, 3) the plane's horizontal and upward unit vectors at yaw 0.
    """

    has_yaw: bool
    yaw_axis: FloatArray
    arm: PlanarArm
    plane_origin: FloatArray
    plane_axes: FloatArray

    @property
    def yaw_joints(self) -> int:
        """Number of joints before the planar ones.

        1 with a yaw, else 0.
        """
        return int(self.has_yaw)

    @property
    def arm_slice(self) -> slice:
        """Slice of the planar joints in a configuration."""
        return slice(self.yaw_joints, None)

    def yaw_of(self, q: ArrayLike) -> float:
        """Yaw of a configuration (0 for a robot without one)."""
        return float(np.asarray(q)[0]) if self.has_yaw else 0.0

    def plane_at(self, yaw: float) -> tuple[FloatArray, FloatArray]:
        """The arm plane turned by `yaw`.

        Returns:
            The (3,) origin in `base_link` [m] and the (3, 3) rows: horizontal axis, upward axis, unit normal.
        """
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        (ax, ay, az), (bx, by, bz) = self.plane_axes.tolist()
        axes = np.array([[ax, ay, az], [bx, by, bz], [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]])
        axis = np.append(self.yaw_axis, 0.0)
        return axis + turn @ (self.plane_origin - axis), axes @ turn.T

    def tool_positions(self, q: ArrayLike) -> FloatArray:
        """Tool positions of configurations, (..., dof) -> (..., 3), in `base_link` [m]."""
        q = np.asarray(q, dtype=np.float64)
        tip = self.arm.joint_points(q[..., self.arm_slice])[..., -1, :]
        at_zero = self.plane_origin + tip @ self.plane_axes
        if not self.has_yaw:
            return at_zero
        cos, sin, (ax, ay) = np.cos(q[..., 0]), np.sin(q[..., 0]), self.yaw_axis.tolist()
        x, y, z = np.moveaxis(at_zero, -1, 0)
        x, y = x - ax, y - ay
        return np.stack([ax + (cos * x - sin * y), ay + (sin * x + cos * y), z], axis=-1)

    def sway(self, deviation: ArrayLike) -> FloatArray:
        """Tracking displacement bound of each link's axis points for joint errors [m].

        The error of a link's absolute angle is at most the sum of the errors of the joints up to it; each link adds its
        length times that error. The yaw adds its own error times the maximum distance from the yaw axis.

        Args:
            deviation: Maximum joint error: one number for all joints, or (..., dof) [rad].

        Returns:
            (..., links) distances [m].
        """
        off = np.asarray(deviation, dtype=np.float64)
        off = off if off.ndim else np.full(self.arm.link_count + self.yaw_joints, off)
        sway: FloatArray = np.cumsum(self.arm.lengths * np.cumsum(off[..., self.arm_slice], axis=-1), axis=-1)
        return sway + off[..., :1] * self.yaw_radius if self.has_yaw else sway

    @cached_property
    def shoulder_from_axis(self) -> tuple[float, float]:
        """Shoulder position relative to the yaw axis [m].

        The components are along the plane's horizontal axis and along its normal.
        """
        (fx, fy), (x, y) = self.plane_axes[0, :2].tolist(), (self.plane_origin[:2] - self.yaw_axis).tolist()
        return fx * x + fy * y, fy * x - fx * y

    @property
    def yaw_radius(self) -> FloatArray:
        """(links,) maximum distance of link axes from the yaw axis [m]."""
        ahead, across = self.shoulder_from_axis
        radius: FloatArray = np.hypot(abs(ahead) + np.cumsum(self.arm.lengths), across + self.arm.lateral)
        return radius
