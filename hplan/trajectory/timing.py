"""Timing alone: any robot's URDF, waypoints, and the fastest motion through them with its corners rounded.

The robot is one of `hplan.trajectory.machine`, the path one of `hplan.trajectory.corner_rounding`. For a prismatic
joint read metres wherever radians are written; its columns say so.
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

#: Deviation from the polyline at its corners, where none is given [rad].
DEVIATION = math.radians(1.0)

#: Grid points for half of a rounded corner: the fewest and the most; many corners have to share `_MOST_POINTS`.
_CORNER_POINTS, _MOST_POINTS = (10, 100), 60_000

#: Use of a limit from which on a joint counts as the one that holds the motion back.
AT_LIMIT = 0.99


def read_waypoints(path: Path | str, joint_names: Sequence[str], slides: Sequence[bool] = ()) -> FloatArray:
    """Read waypoints from a CSV: a header, then one line for each; returns (n, dof) waypoints, n >= 1.

    A joint's column is `NAME` or `NAME_pos_rad`, in radians, or where it slides `NAME_pos_m`, in metres; columns stand
    in any order, others are ignored, and so are empty lines. A trajectory that hplan wrote can be read as well.

    Args:
        joint_names: The `dof` joints, in the order wanted.
        slides: Of each of them whether it slides; empty where none does.

    Raises:
        InputError: Missing or unreadable file, a joint without a column or with two, a line of another length, a value
            that is no finite number, no waypoint at all; names the line.
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
    """The fastest motion through waypoints, from rest to rest, with corners rounded by `rounded_path`.

    The rows are averages of the motion along the path over a period h (`hplan.trajectory.retime`), which takes them off
    it by less than a h^2 / 6 a joint (a: acceleration; 3e-6 rad for 1 rad/s^2 at 250 Hz), more where jerk is limited.
    They stay in the hull of the waypoints.

    Args:
        model: Pinocchio's model; all its joints have one coordinate (`read_machine` sees to that).
        waypoints: (n, dof) configurations within the joint limits; equal ones are an empty motion.
        limits: Limits of the motion, as from `limits_of`.
        deviation_rad: Largest distance of path and polyline, Euclidean norm; at least 1e-4.
        speed: Fraction of full speed, in (0, 1].

    Raises:
        InputError: A joint of several coordinates; waypoints that are no (n, dof) array of finite numbers.
        JointLimitError: A waypoint outside the joint limits (by more than 1e-9 rad); counted from 1.
        OptionError: A deviation, rate or speed out of range.
        TimingError: No motion within the limits exists; names the joint and the cause.
    """
    instance("model", model, pin.Model, "read_machine")
    instance("limits", limits, Limits, "limits_of")
    names = tuple(model.names)[1:]
    for name, joint in zip(names, tuple(model.joints)[1:], strict=True):
        if (joint.nq, joint.nv) != (1, 1):
            raise InputError(
                f"joint {name!r} ({joint.shortname()}) has {joint.nq} coordinates and {joint.nv} velocities; only "
                "joints with one of each can be timed. hplan.trajectory.read_machine turns continuous joints into such",
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
    """Path parameters that suit the corners of a `rounded_path`: many in each, however short it is, few in between.

    In a corner the joints that turn back pass a point at which the path acceleration does not move them; on a coarse
    grid toppra lets it jump up and down there, and timing slows the whole motion to take that back.
    """
    breaks = instance("path", path, SplinePath, "rounded_path").breaks
    corners = (len(breaks) - 2) // 3
    each = _MOST_POINTS // (3 * max(corners, 1))
    even = np.linspace(0.0, 1.0, int(np.clip(each, *_CORNER_POINTS)) + 1)
    # Between corners, and from and to rest, dense at the ends; with no corner as many as for any path.
    # Grid points between two corners.
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
    """Fractions of its limits that each joint uses.

    Attributes:
        velocity: (dof,) largest |velocity| / limit.
        acceleration: (dof,) largest |acceleration| / limit.
        torque: (dof,) largest |torque| / limit; None where torque is not limited.
        jerk: (dof,) largest change of acceleration from row to row / limit; None where jerk is not limited.
        binding: (dof,) fraction of the rows in which the joint uses `AT_LIMIT` or more of some limit other than jerk.
        bound: Fraction of the rows in which any joint does.
    """

    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray | None
    jerk: FloatArray | None
    binding: FloatArray
    bound: float


def limit_shares(trajectory: Trajectory, limits: Limits) -> LimitShares:
    """Measure a trajectory's rows against limits; a joint at rest may have limits of zero.

    Args:
        limits: (dof,) limits; for `binding` to say what holds a slowed motion back, scaled like it.
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
