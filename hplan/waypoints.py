r"""Timing alone: any robot's URDF, waypoints, and the fastest motion through them with its corners rounded.

Nothing here knows the family of `hplan.robot`; the robot is whatever Pinocchio reads.

**Joints.** Revolute, prismatic and continuous joints can move. A continuous joint becomes a revolute one without ends:
its waypoints are angles that count on past a whole turn, and nothing is wrapped. Floating, planar and other joints of
several coordinates, and joints that mimic another or are mimicked, cannot move; they can be held. For a prismatic
joint read metres wherever radians are written, in column names too.

**Corners.** Let P be the polyline through the waypoints, s its length so far, and :math:`\Delta_k` the change of its
unit direction at corner k, at :math:`s_k`. The path is the cubic spline

.. math::
    V(s) = \sum_i N_i(s)\, P(\xi_i), \qquad \xi_i = \tfrac13 (t_{i+1} + t_{i+2} + t_{i+3}),

with simple knots :math:`s_k - h_k,\ s_k,\ s_k + h_k` at each corner (Schoenberg's operator; its control points are
points of the polyline). V reproduces straight lines, parameter and all, and P is a straight line plus the terms
:math:`\Delta_k (s - s_k)_+`. As :math:`s_k` is the middle of its knots, the first differences of such a term's
control values step from 0 to 1 there; hence its second derivative is the tent of area 1 over
:math:`[s_k - h_k, s_k + h_k]`, and it differs from the term itself by a function that is zero outside and reaches its
largest value, :math:`h_k / 6`, at the corner. The intervals are kept apart, so

.. math::
    |V(s) - P(s)| \le \tfrac16 h_k |\Delta_k| \quad \text{(Euclidean norm, at equal s)},

which the choice of :math:`h_k` makes no more than the deviation allowed. The path is thus near the polyline
everywhere, and passes near every waypoint in turn. Its second derivative is continuous, it runs at unit speed outside
the corners, and it lies in the hull of the waypoints: joint limits that they keep, it keeps.
"""

from __future__ import annotations

import csv
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan import timing
from hplan.arrays import FloatArray, readonly
from hplan.errors import InputError, JointLimitError, OptionError, RobotFileError, TimingError
from hplan.path import Limits
from hplan.postprocess.spline import SplinePath
from hplan.robot_files import check_links_and_joints, read_urdf_xml
from hplan.trajectory import QUANTITIES, Trajectory

#: Deviation from the polyline at its corners, where none is given [rad].
DEVIATION = math.radians(1.0)

#: Smallest deviation that can be asked for [rad]: sharper corners are too much for toppra's tolerances.
LEAST_DEVIATION = 1e-4

#: Distance up to which waypoints are the same [rad].
SAME = 1e-9

#: Share of the deviation that leaving out waypoints may take.
THINNING = 0.25

#: Largest share of a segment that the rounding of a corner at one of its ends takes.
SEGMENT_SHARE = 0.4

#: Grid points for half of a rounded corner: the fewest and the most; many corners have to share `MOST_POINTS`.
CORNER_POINTS, MOST_POINTS = (10, 100), 60_000

#: The same between two corners.
STRAIGHT_POINTS = (10, 60)

#: End of a continuous joint's range [rad].
ENDLESS = 1e9

#: Use of a limit from which on a joint counts as what holds the motion back.
AT_LIMIT = 0.99

_MOVABLE = ("revolute", "prismatic", "continuous")


@dataclass(frozen=True, eq=False)
class Machine:
    """A robot reduced to the joints that move.

    Attributes:
        model: Pinocchio's model of the moving joints; nq = nv. A limit that the URDF does not give is inf.
        held: Where the other joints stand, by name; joints of several coordinates stand at their neutral position
            and are None.
    """

    model: pin.Model
    held: Mapping[str, float | None]

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the model's order."""
        return tuple(self.model.names)[1:]


def read_machine(
    path: Path | str, joints: Sequence[str] | None = None, *, hold: Mapping[str, float] | None = None
) -> Machine:
    """Read the kinematics and inertia of any robot from its URDF; geometry and meshes are not looked at.

    Args:
        path: URDF file.
        joints: Names of the joints that move; None for all but those that mimic another or are mimicked.
        hold: Positions of joints that do not move [rad]. Without one a joint stands at 0, or at the limit nearest to
            it.

    Raises:
        RobotFileError: Missing file, malformed XML, or refused by Pinocchio.
        InputError: A joint that does not exist, or that cannot move; no joint at all.
        JointLimitError: A joint held outside its limits.
    """
    path = Path(path)
    root = read_urdf_xml(path)
    elements = {str(joint.get("name")): joint for joint in root.findall("joint") if joint.get("type") != "fixed"}
    tied = _cut_mimics(root)
    check_links_and_joints(path, root)
    moving = [name for name in elements if name not in tied] if joints is None else list(joints)
    hold = {} if hold is None else hold
    for name in [*moving, *hold]:
        if name not in elements:
            raise InputError(f"robot file {path}: there is no joint {name!r} that moves", path=str(path), joint=name)
        if name in tied and name in moving:
            raise _immovable(path, name, "moved", f"it and {tied[name]!r} move as one (mimic)")
        kind = elements[name].get("type")
        if kind not in _MOVABLE:
            raise _immovable(
                path, name, "moved or held", f"it is {kind}; revolute, prismatic and continuous joints can"
            )
        if name in moving and name in hold:
            raise InputError(f"joint {name!r} cannot both move and be held", joint=name)
    if not moving:
        raise InputError(f"robot file {path}: no joint is to move", path=str(path))
    missing = {name: _make_revolute(joint) for name, joint in elements.items() if joint.get("type") == "continuous"}
    _rename_links(root)
    try:
        model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses it: {error} (its reader's own words, if any, are on the terminal)"
        raise RobotFileError(path, reason) from error
    for name, attributes in missing.items():
        for attribute in attributes:
            limit = model.velocityLimit if attribute == "velocity" else model.effortLimit
            limit[model.joints[model.getJointId(name)].idx_v] = np.inf
    return _reduced(model, moving, hold)


def _cut_mimics(root: ET.Element) -> dict[str, str]:
    """Make mimicking joints independent; returns each joint that mimics or is mimicked, with the other one."""
    tied: dict[str, str] = {}
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
            follower, leader = str(joint.get("name")), str(mimic.get("joint"))
            tied[follower] = leader
            tied.setdefault(leader, follower)
    return tied


def _rename_links(root: ET.Element) -> None:
    """Keep names of links apart from those of joints: Pinocchio does not reduce a model that has one of both."""
    for link in root.findall("link"):
        link.set("name", f"link {link.get('name')}")
    for joint in root.findall("joint"):
        for end in (*joint.findall("parent"), *joint.findall("child")):
            end.set("link", f"link {end.get('link')}")


def _immovable(path: Path, joint: str, what: str, reason: str) -> InputError:
    return InputError(
        f"robot file {path}: joint {joint!r} cannot be {what}: {reason}. Name the joints to move; "
        "the others stay where they are",
        path=str(path),
        joint=joint,
        reason=reason,
    )  # fmt: skip


def _make_revolute(joint: ET.Element) -> list[str]:
    """Turn a continuous joint into a revolute one without ends; returns which limits it does not give."""
    joint.set("type", "revolute")
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    missing = [attribute for attribute in ("velocity", "effort") if attribute not in limit.attrib]
    for attribute in missing:
        limit.set(attribute, "0")
    limit.set("lower", str(-ENDLESS))
    limit.set("upper", str(ENDLESS))
    return missing


def _reduced(model: pin.Model, moving: Sequence[str], hold: Mapping[str, float]) -> Machine:
    """The model with all joints but the moving ones fixed."""
    reference = pin.neutral(model)
    held: dict[str, float | None] = {}
    for name in tuple(model.names)[1:]:
        if name in moving:
            continue
        joint = model.joints[model.getJointId(name)]
        if (joint.nq, joint.nv) != (1, 1):
            held[name] = None
            continue
        low, high = float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])
        value = float(hold.get(name, min(max(0.0, low), high)))
        if not low - 1e-9 <= value <= high + 1e-9:
            raise JointLimitError("hold", name, value, low, high)
        reference[joint.idx_q] = held[name] = value
    return Machine(pin.buildReducedModel(model, [model.getJointId(name) for name in held], reference), held)


def limits_of(
    model: pin.Model, acceleration: ArrayLike, jerk: ArrayLike | None = None, *, torque: bool = True
) -> Limits:
    """The model's velocity and torque limits, with those that URDF cannot give.

    Args:
        model: Pinocchio's model; its limits are the URDF's, of which 0 is taken at its word.
        acceleration: (dof,) or one for all [rad/s^2].
        jerk: (dof,) or one for all [rad/s^3]; None leaves it unlimited.
        torque: Whether torque is limited.

    Raises:
        InputError: A limit that is not finite or negative, as where the URDF gives none; names the joint.
    """
    names = tuple(model.names)[1:]

    def checked(what: str, values: ArrayLike) -> FloatArray:
        array = readonly(np.broadcast_to(np.asarray(values, dtype=np.float64), (model.nv,)))
        for name, value in zip(names, array, strict=False):
            if value == np.inf:
                raise InputError(f"joint {name!r} has no {what} limit; the motion needs one", joint=name)
            if not (np.isfinite(value) and value >= 0.0):
                raise InputError(f"joint {name!r}: its {what} limit is {value:g}, expected a number >= 0", joint=name)
        return array

    return Limits(
        velocity=checked("velocity", model.velocityLimit),
        acceleration=checked("acceleration", acceleration),
        torque=checked("torque", model.effortLimit) if torque else None,
        jerk=None if jerk is None else checked("jerk", jerk),
    )


def read_waypoints(path: Path | str, joint_names: Sequence[str]) -> FloatArray:
    """Read waypoints from a CSV: a header, then one line for each.

    A joint's column is `NAME_pos_rad` or `NAME`, in radians; columns stand in any order, others are ignored, and so
    are empty lines. A trajectory that hplan wrote can be read as well.

    Args:
        path: CSV file.
        joint_names: The `dof` joints, in the order wanted.

    Returns:
        (n, dof) waypoints, n >= 1.

    Raises:
        InputError: Missing or unreadable file, a joint without a column or with two, a line of another length, a value
            that is no finite number, no waypoint at all; names the line.
    """
    path = Path(path)

    def fault(line: int, reason: str) -> InputError:
        return InputError(f"waypoint file {path}, line {line}: {reason}", path=str(path), line=line, reason=reason)

    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except OSError as error:
        raise InputError(f"waypoint file {path}: {error.strerror}", path=str(path)) from error
    except UnicodeDecodeError as error:
        raise InputError(f"waypoint file {path}: it is not UTF-8 text", path=str(path)) from error
    except csv.Error as error:
        raise fault(reader.line_num, str(error)) from error
    if not rows:
        raise fault(1, "expected a header with the names of the joints")
    first, header = rows[0]
    columns = []
    for joint in joint_names:
        found = [index for index, name in enumerate(header) if name in (joint, f"{joint}_{QUANTITIES[0]}")]
        if len(found) != 1:
            how = "two columns" if found else f"no column; expected {joint}_{QUANTITIES[0]} or {joint}"
            raise fault(first, f"joint {joint!r} has {how} (the columns are {', '.join(header)})")
        columns.append(found[0])
    if len(rows) == 1:
        raise fault(first, "no waypoints follow the header")
    waypoints = np.empty((len(rows) - 1, len(columns)))
    for number, (line, row) in enumerate(rows[1:]):
        if len(row) != len(header):
            raise fault(line, f"{len(row)} values, expected {len(header)}")
        waypoints[number] = [_number(row[column]) for column in columns]
        for value, column in zip(waypoints[number], columns, strict=True):
            if not math.isfinite(value):
                raise fault(line, f"{header[column]} is {row[column]!r}, expected a finite number")
    return readonly(waypoints)


def _number(text: str) -> float:
    """The number that a cell holds, or nan."""
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def rounded_path(waypoints: ArrayLike, deviation_rad: float) -> SplinePath:
    r"""The polyline through waypoints with its corners rounded (see the module's text).

    Both run along each other, so that at no point they are further apart than `deviation_rad` in the Euclidean norm of
    joint space: the path keeps to the polyline, and passes every waypoint in turn within the deviation. It begins and
    ends at the first and the last of them (up to the rounding of the last digit), and stays in the hull of all.

    A quarter of the deviation goes into leaving out waypoints (equal ones, those in line, noise): a chord stands for
    those between its ends if points of it, in the same order, are within that distance of them, and then by convexity
    the segments between are too. The corners of the chords are rounded by what remains.

    Args:
        waypoints: (n, dof), n >= 1.
        deviation_rad: Largest distance from the polyline; at least 1e-4.

    Returns:
        The path; constant where all waypoints are the same.

    Raises:
        InputError: No waypoint, no list of equally many numbers each, or a value that is not finite.
        OptionError: The deviation is too small or not finite.
    """
    points = _as_waypoints(waypoints)
    if not (math.isfinite(deviation_rad) and deviation_rad >= LEAST_DEVIATION):
        raise OptionError("deviation_rad", deviation_rad, f"a finite number of radians >= {LEAST_DEVIATION:g}")
    points = _thinned(points, THINNING * deviation_rad - SAME)
    if len(points) < 2:
        return SplinePath(readonly(np.repeat(points, 4, axis=0)), readonly([0.0] * 4 + [1.0] * 4))
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    station = np.concatenate([[0.0], np.cumsum(length)])
    bend = np.linalg.norm(np.diff(np.diff(points, axis=0) / length[:, None], axis=0), axis=1)
    half = np.minimum(
        SEGMENT_SHARE * np.minimum(length[:-1], length[1:]),
        6.0 * (1.0 - THINNING) * deviation_rad / np.maximum(bend, 1e-12),
    )
    inner = (station[1:-1, None] + half[:, None] * np.array([-1.0, 0.0, 1.0])).ravel()
    knots = np.concatenate([[0.0] * 4, inner, [station[-1]] * 4])
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    control = np.stack([np.interp(greville, station, joint) for joint in points.T], axis=1)
    control[[0, -1]] = points[[0, -1]]
    # Rounding must not take a control point out of the joint limits that the waypoints keep.
    control = np.clip(control, points.min(axis=0), points.max(axis=0))
    return SplinePath(readonly(control), readonly(knots))


def _as_waypoints(waypoints: ArrayLike) -> FloatArray:
    try:
        points = np.array(waypoints, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("waypoints: expected a list of configurations, all of the same number of joints") from error
    if points.ndim != 2 or 0 in points.shape:
        raise InputError(f"waypoints: expected an array (waypoints, joints), got shape {points.shape}")
    if not np.isfinite(points).all():
        number = int(np.argmin(np.isfinite(points).all(axis=1))) + 1
        raise InputError(f"waypoint {number} holds a value that is not finite", waypoint=number)
    return points


def _thinned(points: FloatArray, radius: float) -> FloatArray:
    """Some of the points, the ends among them, each as far on as the chord from the one before may reach."""
    taken, low = [points[0]], 0
    while low < len(points) - 1:
        high = low + 1
        while high < len(points) - 1 and _stands_for(points[low : high + 2], radius):
            high += 1
        if np.linalg.norm(points[high] - taken[-1]) > SAME:
            taken.append(points[high])
        low = high
    if len(taken) > 1:
        taken[-1] = points[-1]
    return np.array(taken)


def _stands_for(points: FloatArray, radius: float) -> bool:
    """Whether the chord from first to last point has points in order within the radius of each in between."""
    start, step = points[0], points[-1] - points[0]
    away = points[1:-1] - start
    squared = float(step @ step)
    if squared <= SAME**2:
        return bool((np.linalg.norm(away, axis=1) <= radius).all())
    middle = away @ step / squared
    offset = np.linalg.norm(away - middle[:, None] * step, axis=1)
    if (offset > radius).any():
        return False
    # The part of the chord within the radius of each; going through them in order, each as early as it may be.
    reach = np.sqrt((radius**2 - offset**2) / squared)
    earliest = np.maximum.accumulate(np.maximum(middle - reach, 0.0))
    return bool((earliest <= np.minimum(middle + reach, 1.0)).all())


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

    The rows are averages of the motion along the path over a period h (`hplan.timing`), which takes them off it by
    less than a h^2 / 6 a joint (a: acceleration; 3e-6 rad for 1 rad/s^2 at 250 Hz), more where jerk is limited. They
    stay in the hull of the waypoints.

    Args:
        model: Pinocchio's model; all its joints have one coordinate (`read_machine` sees to that).
        waypoints: (n, dof) configurations within the joint limits; equal ones are an empty motion.
        limits: Limits of the motion, as from `limits_of`.
        deviation_rad: Largest distance of path and polyline, Euclidean norm; at least 1e-4.
        rate_hz: Rows per second.
        speed: Share of full speed, in (0, 1].

    Raises:
        InputError: A joint of several coordinates; waypoints that are no (n, dof) array of finite numbers.
        JointLimitError: A waypoint outside the joint limits (by more than 1e-9 rad); counted from 1.
        OptionError: A deviation, rate or speed out of range.
        TimingError: No motion within the limits exists; names the joint and the cause.
    """
    names = tuple(model.names)[1:]
    for name, joint in zip(names, tuple(model.joints)[1:], strict=True):
        if (joint.nq, joint.nv) != (1, 1):
            raise InputError(
                f"joint {name!r} ({joint.shortname()}) has {joint.nq} coordinates and {joint.nv} velocities; only "
                "joints with one of each can be timed. hplan.waypoints.read_machine turns continuous joints into such",
                joint=name,
            )
    points = _as_waypoints(waypoints)
    if points.shape[1] != len(names):
        raise InputError(f"waypoints: {points.shape[1]} values each, expected {len(names)} ({', '.join(names)})")
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    outside = (points < lower - 1e-9) | (points > upper + 1e-9)
    for number, joint in np.argwhere(outside)[:1]:
        value = float(points[number, joint])
        raise JointLimitError(f"waypoint {number + 1}", names[joint], value, float(lower[joint]), float(upper[joint]))
    points = np.clip(points, lower, upper)
    if limits.torque is not None:
        for joint in np.flatnonzero((np.ptp(points, axis=0) >= timing.NO_MOTION) & ~(limits.torque > 0.0)):
            raise TimingError(
                f"joint {names[joint]!r} must move, but its torque limit is {limits.torque[joint]:g}",
                joint=names[joint],
                cause="torque limit of zero",
            )
    path = rounded_path(points, deviation_rad)
    return timing.time_path(path, model, limits.scaled(speed), rate_hz=rate_hz, grid=_grid(path))


def _grid(path: SplinePath) -> FloatArray:
    """Path parameters that suit the corners: many in each, however short it is, and fewer in between.

    In a corner the joints that turn back pass a point at which the path acceleration does not move them; on a coarse
    grid toppra lets it jump up and down there, and timing slows the whole motion to take that back.
    """
    breaks = path.breaks
    corners = (len(breaks) - 2) // 3
    each = MOST_POINTS // (3 * max(corners, 1))
    even = np.linspace(0.0, 1.0, int(np.clip(each, *CORNER_POINTS)) + 1)
    # Between corners, and from and to rest, dense at the ends; with no corner as many as for any path.
    count = int(np.clip(each, *STRAIGHT_POINTS)) if corners else timing.GRID_POINTS
    eased = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))
    # Pieces come in threes: straight, into the corner, out of it.
    parts = [
        low + (high - low) * (eased if piece % 3 == 0 else even)[:-1]
        for piece, (low, high) in enumerate(pairwise(breaks))
    ]
    return np.concatenate([*parts, breaks[-1:]])


@dataclass(frozen=True, eq=False)
class LimitShares:
    """How much of its limits each joint uses.

    Attributes:
        velocity: (dof,) largest |velocity| / limit.
        acceleration: (dof,) largest |acceleration| / limit.
        torque: (dof,) largest |torque| / limit; None where torque is not limited.
        jerk: (dof,) largest change of acceleration from row to row / limit; None where jerk is not limited.
        binding: (dof,) share of the rows in which the joint uses `AT_LIMIT` or more of some limit other than jerk.
        bound: Share of the rows in which any joint does.
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
        trajectory: The motion.
        limits: (dof,) limits; for `binding` to say what holds a slowed motion back, scaled like it.
    """

    def shares(values: FloatArray, limit: FloatArray) -> FloatArray:
        size = np.abs(values)
        return np.where(size <= 1e-9, 0.0, size / np.maximum(limit, 1e-12))

    rows = [shares(trajectory.velocity, limits.velocity), shares(trajectory.acceleration, limits.acceleration)]
    if limits.torque is not None:
        rows.append(shares(trajectory.torque, limits.torque))
    largest = [readonly(row.max(axis=0)) for row in rows]
    at_limit = np.max(rows, axis=0) >= AT_LIMIT
    jerk = None
    if limits.jerk is not None:
        change = np.diff(trajectory.acceleration, axis=0) / np.diff(trajectory.time)[:, None]
        jerk = readonly(shares(change, limits.jerk).max(axis=0, initial=0.0))
    return LimitShares(
        velocity=largest[0],
        acceleration=largest[1],
        torque=largest[2] if len(largest) > 2 else None,
        jerk=jerk,
        binding=readonly(at_limit.mean(axis=0)),
        bound=float(at_limit.any(axis=1).mean()),
    )


def largest_deviation(positions: ArrayLike, waypoints: ArrayLike) -> float:
    """Largest distance of configurations from the polyline through waypoints, Euclidean norm [rad].

    Args:
        positions: (k, dof) configurations.
        waypoints: (n, dof).
    """
    q, points = np.asarray(positions, dtype=np.float64), _as_waypoints(waypoints)
    nearest = np.linalg.norm(q - points[0], axis=1)
    for start, step in zip(points[:-1], np.diff(points, axis=0), strict=True):
        squared = float(step @ step)
        along = np.clip((q - start) @ step / squared, 0.0, 1.0) if squared > 0.0 else np.zeros(len(q))
        nearest = np.minimum(nearest, np.linalg.norm(q - start - along[:, None] * step, axis=1))
    return float(nearest.max())
