r"""Bounds of the tool's distance from a line and its tilt.

Both hold at all times of a motion. Between two samples of the motion :math:`h` apart the tool's point leaves their
chord by at most :math:`h^2 / 8 \max |\ddot p|`, and so does a direction fixed in the tool
(`hplan.certificate.goal_contact` has both bounds). The points within a distance of a line segment are a convex set; the
component of a direction along another one is linear. So the maximum of both over the samples, plus the bound between
samples, holds at all times.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.certificate.goal_contact import largest_rates, tool_bends
from hplan.certificate.motion_bound import fastest, largest_deviations
from hplan.collision.motion_coefficients import carriers, joint_axis, points_reach
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.robot.upright import UprightTool
from hplan.trajectory.trajectory import Trajectory

#: Number of samples in each cubic of a motion.
_SAMPLES_PER_CUBIC = 4


class ToolBounds(NamedTuple):
    """Upper bounds at all times, tracking errors included.

    Attributes:
        deviation_m: Distance of the tool from the straight line between its positions at both ends [m].
        tilt_rad: Angle between a direction fixed in the tool and one fixed in `base_link` [rad].
    """

    deviation_m: float
    tilt_rad: float


def tool_bounds(robot: Robot, trajectory: Trajectory, upright: UprightTool, tracking: TrackingModel) -> ToolBounds:
    """Bound the tool's distance from its line and its tilt.

    Args:
        upright: The axis whose tilt is bounded.
        tracking: Tracking errors of the joints.
    """
    pieces, duration = trajectory.segments
    rates, pushes = largest_rates(pieces)
    bent, turned = (bends / (8.0 * _SAMPLES_PER_CUBIC**2) for bends in tool_bends(robot, rates, pushes))
    looks = np.arange(_SAMPLES_PER_CUBIC * len(pieces) + 1) / _SAMPLES_PER_CUBIC
    clock = trajectory.time if trajectory.samples > 1 else np.zeros(2)
    poses = robot.forward_kinematics(trajectory.positions(np.interp(looks, np.arange(len(pieces) + 1), clock)))
    off, along = _off_segment(poses[:, :3, 3]), poses[:, :3, :3] @ np.array(upright.axis) @ np.array(upright.up)
    deviations = largest_deviations(robot, tracking, fastest(pieces, duration))
    turns = [joint for joint in carriers(robot, robot.tool_joint - 1) if not joint_axis(robot, joint)[1]]
    place = robot.model.frames[robot.frame_number(robot.tool_frame)].placement.translation[None]
    away = _largest_per_cubic(off) + bent + deviations @ points_reach(robot, place, robot.tool_joint - 1)
    lean = np.arccos(np.clip(-_largest_per_cubic(-along) - turned, -1.0, 1.0)) + deviations[:, turns].sum(axis=1)
    return ToolBounds(float(away.max()), float(lean.max()))


def tilt_violations(upright: UprightTool, tilt_rad: float) -> Iterator[str]:
    """Message about a tilt beyond its maximum [rad]."""
    if not tilt_rad <= upright.max_tilt_rad:
        allowed = math.degrees(upright.max_tilt_rad)
        yield f"the tool tilts by up to {math.degrees(tilt_rad):.4g} deg from upright; allowed: {allowed:.4g} deg"


def _largest_per_cubic(values: FloatArray) -> FloatArray:
    """(pieces,) maximum over the samples of each cubic, both ends included."""
    inner: FloatArray = np.maximum(values[:-1], values[1:]).reshape(-1, _SAMPLES_PER_CUBIC).max(axis=1)
    return inner


def _off_segment(places: FloatArray) -> FloatArray:
    """(n,) distances of (n, 3) positions from the end-to-end segment [m]."""
    away, line = places - places[0], places[-1] - places[0]
    along = np.clip(away @ line / max(float(line @ line), 1e-300), 0.0, 1.0)
    off: FloatArray = np.linalg.norm(away - along[:, None] * line, axis=1)
    return off
