"""Times waypoints of any robot's URDF: the fastest motion with rounded corners.

The robot is read by `hplan.trajectory.machine`, the path made by `hplan.trajectory.corner_rounding`. For prismatic
joints, radians mean metres; the columns of their files are named accordingly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base.arguments import instance, list_of
from hplan.base.arrays import FloatArray, Record, readonly
from hplan.base.csv_file import CsvFile
from hplan.base.units import joint_unit
from hplan.errors import InputError, JointLimitError, TimingError
from hplan.robot.dynamics import joints_that_slide
from hplan.robot.limits import Limits
from hplan.trajectory import retime as timing
from hplan.trajectory.corner_rounding import as_waypoints, rounded_path
from hplan.trajectory.speed_profile import NO_MOTION
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

#: Default deviation from the polyline at its corners [rad].
DEVIATION = math.radians(1.0)

#: Minimum and maximum number of grid points for half of a rounded corner; many corners share `_MOST_POINTS`.
_CORNER_POINTS, _MOST_POINTS = (10, 100), 60_000

#: A joint that uses at least this fraction of a limit counts as limiting the motion.
AT_LIMIT = 0.99


def read_waypoints(path: Path | str, joint_names: Sequence[str], slides: Sequence[bool] = ()) -> FloatArray:
    """Read (n, dof) waypoints from a CSV file, n >= 1.

    The file has a header and one line per waypoint. A joint's column is `NAME` or `NAME_pos_rad`, in radians, or
    `NAME_pos_m`, in metres, if the joint is prismatic; columns may be in any order. Other columns and empty lines are
    ignored. A trajectory written by hplan can be read as well.

    Args:
        path: The file.
        joint_names: Names of the `dof` joints, in the order of the result.
        slides: Whether each joint is prismatic; empty if none is.

    Raises:
        InputError: The file is missing or unreadable, a joint has no column or two, a line has another length, a value
            is not a finite number, or there is no waypoint; names the line.
    """
    joint_names = list_of("joint_names", joint_names, str, "names")

    file = CsvFile.read(path, "waypoint", "waypoint", blank=True)
    header = [name.strip() for name in file.header]
    if not header:
        raise file.fault(1, "expected a header with the names of the joints")
    columns = []
    for joint, slide in zip(joint_names, slides or [False] * len(joint_names), strict=True):
        own = f"{joint}_{joint_unit(slide).columns[0]}"
        found = [index for index, name in enumerate(header) if name in (joint, own)]
        if len(found) != 1:
            how = "two columns" if found else f"no column; expected {own} or {joint}"
            raise file.fault(file.first, f"joint {joint!r} has {how} (the columns are {', '.join(header)})")
        columns.append(found[0])
    return readonly([values for _, _, values in file.number_rows(columns)])


def time_waypoints(
    model: pin.Model,
    waypoints: ArrayLike,
    limits: Limits,
    *,
    deviation_rad: float = DEVIATION,
    rate_hz: float = 250.0,
    speed: float = 1.0,
) -> Trajectory:
    """Fastest rest-to-rest motion through waypoints, with corners rounded by `rounded_path`.

    The samples are averages of the motion along the path over a period h (`hplan.trajectory.retime`). They are off the
    path by less than a h^2 / 6 for each joint (a: acceleration; 3e-6 rad for 1 rad/s^2 at 250 Hz), and by more with
    jerk limits. They stay in the convex hull of the waypoints.

    Args:
        model: Pinocchio's model; all its joints have one coordinate (as from `read_machine`).
        waypoints: (n, dof) configurations within the joint limits; equal ones are an empty motion.
        limits: Limits of the motion, as from `limits_of`.
        deviation_rad: Maximum distance between path and polyline, Euclidean norm; at least 1e-4.
        rate_hz: Samples per second.
        speed: Fraction of full speed, in (0, 1].

    Raises:
        InputError: A joint has several coordinates, or `waypoints` is not an (n, dof) array of finite numbers.
        JointLimitError: A waypoint is outside the joint limits (by more than 1e-9 rad); waypoints are counted from 1.
        OptionError: The deviation, rate or speed is out of range.
        TimingError: No motion within the limits exists; names the joint and the cause.
    """
    instance("model", model, pin.Model, "read_machine")
    instance("limits", limits, Limits, "limits_of")
    names = tuple(model.names)[1:]
    for name, joint in zip(names, tuple(model.joints)[1:], strict=True):
        if (joint.nq, joint.nv) != (1, 1):
            raise InputError(
                f"joint {name!r} ({joint.shortname()}) has {joint.nq} coordinates and {joint.nv} velocities; only "
                "joints with one of each can be timed. hplan.trajectory.read_machine converts continuous joints",
                joint=name,
            )
    points = as_waypoints(waypoints)
    if points.shape[1] != len(names):
        raise InputError(f"waypoints: {points.shape[1]} values each, expected {len(names)} ({', '.join(names)})")
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    outside = (points < lower - 1e-9) | (points > upper + 1e-9)
    for number, joint in np.argwhere(outside)[:1]:
        value = float(points[number, joint])
        slides, ends = joints_that_slide(model)[joint], (float(lower[joint]), float(upper[joint]))
        raise JointLimitError(f"waypoint {number + 1}", names[joint], value, *ends, joint_unit(slides).position)
    points = np.clip(points, lower, upper)
    if limits.torque is not None:
        for joint in np.flatnonzero((np.ptp(points, axis=0) >= NO_MOTION) & ~(limits.torque > 0.0)):
            raise TimingError(
                f"joint {names[joint]!r} must move, but its torque limit is {limits.torque[joint]:g}",
                joint=names[joint],
                cause="torque limit of zero",
            )
    path = rounded_path(points, deviation_rad)
    return timing.time_path(path, model, limits.scaled(speed), rate_hz=rate_hz, grid=corner_grid(path))


def corner_grid(path: SplinePath) -> FloatArray:
    """Path parameters for a `rounded_path`: many in each corner, few in between.

    The number per corner does not depend on its length. In a corner the joints that reverse pass a point where path
    acceleration does not move them; on a coarse grid toppra lets it jump up and down there, and timing would slow the
    whole motion down to remove that.
    """
    breaks = instance("path", path, SplinePath, "rounded_path").breaks
    corners = (len(breaks) - 2) // 3
    each = _MOST_POINTS // (3 * max(corners, 1))
    even = np.linspace(0.0, 1.0, int(np.clip(each, *_CORNER_POINTS)) + 1)
    # Between corners, and from and to rest, the grid is dense at the ends; without corners it has as many points as for
    # any path.
    straight_points = (10, 60)
    count = int(np.clip(each, *straight_points)) if corners else timing.GRID_POINTS
    eased = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))
    # Pieces come in threes: straight, into the corner, out of it.
    parts = [
        low + (high - low) * (eased if piece % 3 == 0 else even)[:-1]
        for piece, (low, high) in enumerate(pairwise(breaks))
    ]
    return np.concatenate([*parts, breaks[-1:]])


@dataclass(frozen=True, eq=False)
class LimitShares(Record):
    """Use of each joint's limits, as fractions.

    Attributes:
        velocity: (dof,) maximum |velocity| / limit.
        acceleration: (dof,) maximum |acceleration| / limit.
        torque: (dof,) maximum |torque| / limit; None if torque is not limited.
        jerk: (dof,) maximum change of acceleration from sample to sample / limit; None if jerk is not limited.
        binding: (dof,) fraction of the samples in which the joint uses `AT_LIMIT` or more of some limit other than
            jerk.
        bound: Fraction of the samples in which any joint does.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None
    jerk: FloatArray | None
    binding: FloatArray
    bound: float


def limit_shares(trajectory: Trajectory, limits: Limits) -> LimitShares:
    """Compute the use of limits in a trajectory's samples.

    A joint at rest may have limits of zero.

    Args:
        trajectory: The motion.
        limits: (dof,) limits; scale them like the motion, so that `binding` refers to its reduced limits.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> limit_shares(motion, Limits(np.ones(1), np.ones(1))).bound
        0.0
    """
    instance("trajectory", trajectory, Trajectory, "time_waypoints")
    instance("limits", limits, Limits, "limits_of")

    def fractions(values: FloatArray, limit: FloatArray) -> FloatArray:
        size = np.abs(values)
        return np.where(size <= 1e-9, 0.0, size / np.maximum(limit, 1e-12))

    rows = [fractions(trajectory.velocity, limits.velocity), fractions(trajectory.acceleration, limits.acceleration)]
    if limits.torque is not None:
        rows.append(fractions(trajectory.torque, limits.torque))
    largest = [readonly(row.max(axis=0)) for row in rows]
    at_limit = np.max(rows, axis=0) >= AT_LIMIT
    jerk = None
    if limits.jerk is not None:
        change = np.diff(trajectory.acceleration, axis=0) / np.diff(trajectory.time)[:, None]
        jerk = readonly(fractions(change, limits.jerk).max(axis=0, initial=0.0))
    return LimitShares(
        velocity=largest[0],
        acceleration=largest[1],
        torque=largest[2] if len(largest) > 2 else None,
        jerk=jerk,
        binding=readonly(at_limit.mean(axis=0)),
        bound=float(at_limit.any(axis=1).mean()),
    )
