"""Timed motion, sampled for a controller, and its CSV format."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import check_integer, instance, list_of, number, one_of, truth
from hplan.base.arrays import FloatArray, Record, frozen, numbers
from hplan.base.csv_file import CsvFile
from hplan.base.files import write_text
from hplan.base.lazy_import import VIEWERS
from hplan.base.units import SLIDING, TURNING, joint_unit
from hplan.errors import InputError, TimingError
from hplan.robot.model import Robot
from hplan.trajectory.cubics import (
    Interpolation,
    Rows,
    evaluate,
    joined_rows,
    segments_between,
)
from hplan.trajectory.time_scaling import Profile, check_factors, rescale, speed_factors
from hplan.trajectory.time_steps import Course

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: A sample within this time before an instant counts as being at it [s].
SAME_TIME = 1e-9

#: Rounding of time differences in a controller that counts seconds since 1970 [s].
_CLOCK_STEP = 1e-6


@dataclass(frozen=True)
class Phase:
    """Phase of a trajectory.

    Attributes:
        name: `transit`, `approach` or `retreat`; in tours also `drop` and `return`.
        start_s: Start time [s].
        end_s: End time [s].
    """

    name: str
    start_s: float
    end_s: float

    def delay(self, seconds: float) -> Phase:
        """The phase, delayed by a time [s].

        Examples:
            >>> Phase("transit", 0.0, 1.0).delay(2.0)
            Phase(name='transit', start_s=2.0, end_s=3.0)
        """
        return Phase(self.name, self.start_s + seconds, self.end_s + seconds)

    def retime(self, clock: FloatArray, time: FloatArray) -> Phase:
        """The phase on the clock of a retimed motion.

        It runs from the last sample at or before its start to the first sample at or after its end.

        Args:
            clock: (n,) time of each sample in this phase's motion [s].
            time: (n,) time of each sample in the retimed motion [s].
        """
        begin = max(0, int(np.searchsorted(clock, self.start_s + SAME_TIME, side="right")) - 1)
        end = int(np.searchsorted(clock, self.end_s - SAME_TIME)) if self.end_s < clock[-1] - SAME_TIME else -1
        return Phase(self.name, float(time[begin]) if self.start_s > 0.0 else 0.0, float(time[end]))


@dataclass(frozen=True, eq=False)
class Trajectory(Record):
    """Samples of a motion, normally at rest at both ends.

    Attributes:
        joint_names: Names of the `dof` joints.
        time: (n,) strictly increasing from 0 [s].
        position: (n, dof) [rad], in metres for prismatic joints.
        velocity: (n, dof) [rad/s].
        acceleration: (n, dof) [rad/s^2].
        torque: (n, dof) joint torques from inverse dynamics [N m]; forces for prismatic joints [N].
        slides: Whether each joint is prismatic, and is in metres; empty if unknown.
        interpolation: Curve that the controller follows between two samples: `cubic` matches their positions and
            velocities, as every motion of hplan does, `quintic` their accelerations too, `linear` their positions only.
        takes_over_s: For a motion that takes over from a running one, the time until it shares the running motion's
            samples, which may be past when it is sent [s]; 0 if it starts at the arm's present state. Such a motion's
            message needs a start time. None for a motion that starts on its own.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> motion
        <Trajectory: 2 s, 2 samples, joints q1>
        >>> motion.positions([1.0]).tolist()
        [[0.5]]
        >>> motion.reversal.position[0].tolist()
        [1.0]
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    slides: tuple[bool, ...] = ()
    interpolation: Interpolation = "cubic"
    takes_over_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", list_of("trajectory: joint_names", self.joint_names, str, "names"))
        if len(set(self.joint_names)) < len(self.joint_names):
            repeated = next(name for name in self.joint_names if self.joint_names.count(name) > 1)
            raise InputError(f"trajectory: joint_names has {repeated!r} twice, expected each joint once")
        time = numbers("trajectory: time", self.time, (None,))
        object.__setattr__(self, "time", time)
        if len(time) == 0 or time[0] != 0.0:
            raise InputError("trajectory: time must be a list of finite values that starts at 0")
        if not (np.diff(time) > 0.0).all():
            raise InputError(f"trajectory: time does not increase at sample {int(np.argmin(np.diff(time) > 0.0)) + 1}")
        shape = (len(time), len(self.joint_names))
        for name in ("position", "velocity", "acceleration", "torque"):
            object.__setattr__(self, name, numbers(f"trajectory: {name}", getattr(self, name), shape))
        slides = list_of("trajectory: slides", self.slides, bool, "Booleans")
        if len(slides) not in (0, shape[1]):
            raise InputError(f"trajectory: slides has {len(slides)} values, expected one for each of {shape[1]} joints")
        object.__setattr__(self, "slides", slides)
        one_of("interpolation", self.interpolation, get_args(Interpolation))
        if self.takes_over_s is not None:
            number(
                "takes_over_s", self.takes_over_s, "a time since the motion began, or None", lambda time: time >= 0.0
            )

    def copy_unchecked(self, rows: Rows, **changes: Any) -> Trajectory:
        """A motion of the same joints with samples that hplan itself has computed.

        Args:
            rows: The samples, in contiguous arrays, which become read-only.
            changes: Other fields.
        """
        found = object.__new__(Trajectory)
        vars(found).update({field.name: getattr(self, field.name) for field in fields(Trajectory)})
        vars(found).update(zip(Rows._fields, map(frozen, rows), strict=True), **changes)
        return found

    def __repr__(self) -> str:
        return f"<Trajectory: {self.duration:.6g} s, {self.samples} samples, joints {', '.join(self.joint_names)}>"

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def rows(self) -> Rows:
        """The samples without joint names and interpolation."""
        return Rows(self.time, self.position, self.velocity, self.acceleration, self.torque)

    @cached_property
    def course(self) -> Course:
        """The motion, prepared for stops and other speeds."""
        return Course.build(self.rows)

    @property
    def segments(self) -> tuple[FloatArray, FloatArray]:
        """Polynomials between the samples, as Bezier points and durations.

        Returns (segments, 4 or 6, dof) Bezier points and (segments,) durations [s]. Points are not finite if numbers
        overflow. A single sample is one constant segment of 1 s.
        """
        return segments_between(self.rows, self.interpolation)

    @property
    def end_velocities(self) -> FloatArray:
        """(2, dof) velocities of the curve at the first and last sample."""
        ends = (Rows(*(values[part] for values in self.rows)) for part in (slice(2), slice(-2, None)))
        (first, begin), (last, end) = (segments_between(rows, self.interpolation) for rows in ends)
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.stack([first[0, 1] - first[0, 0], last[-1, -1] - last[-1, -2]])
            velocities: FloatArray = (first.shape[1] - 1.0) * steps / np.array([begin, end])
        return velocities

    @property
    def reversal(self) -> Trajectory:
        """The motion backwards.

        Torques are unchanged: inverse dynamics depends on the square of velocity only.
        """
        time, position, acceleration = self.time[-1] - self.time[::-1], self.position[::-1], self.acceleration[::-1]
        rows = Rows(time, position, -self.velocity[::-1], acceleration, self.torque[::-1])
        return self.copy_unchecked(Rows(*map(np.ascontiguousarray, rows)), takes_over_s=None)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    def cut_before(self, row: int) -> Trajectory:
        """The motion from a sample on.

        If it is not at rest there, it takes over from the motion that runs until then (`takes_over_s`).

        Args:
            row: Index of the sample.

        Raises:
            OptionError: `row` is not the index of a sample.
        """
        row = check_integer("row", row, 0, self.samples - 1)
        if row == 0:
            return self
        begins_alone = self.takes_over_s is None and self.rows.is_at_rest(row)
        return self.copy_unchecked(self.rows.cut_before(row), takes_over_s=None if begins_alone else 0.0)

    def cut_after(self, row: int) -> Trajectory:
        """The motion up to a sample; it need not end at rest.

        Args:
            row: Index of the sample.

        Raises:
            OptionError: `row` is not the index of a sample.

        Examples:
            >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
            >>> motion.cut_after(0).duration
            0.0
        """
        return self.copy_unchecked(self.rows.cut_after(check_integer("row", row, 0, self.samples - 1)))

    def stop_at(self, t: float, robot: Robot) -> Trajectory:
        """The motion with the quickest stop on its path.

        The stop begins at the first sample at or after the time `t`. The arm stays on the path (to 0.1 mm), so a
        collision-free path remains collision-free. Details: function `stop_motion`.

        Args:
            t: The time, within the motion [s].
            robot: The arm, for its limits.

        Raises:
            OptionError: `t` is outside the motion, or `robot` is not a robot.
            TimingError: No stop was found, and the motion does not end at rest.
        """
        return stop_motion(self, t, robot).trajectory

    def scale_speed(self, profile: Profile, robot: Robot) -> Trajectory:
        """The motion at other speeds, on its path (to 0.1 mm).

        Args:
            profile: Fraction of the motion's own speed over time: a number, (n, 2) rows of time [s] and factor, or a
                function of the time (details: function `scale_motion`).
            robot: The arm, for its limits.

        Raises:
            OptionError: `profile` is invalid, a factor exceeds the limits, or the motion does not end with these
                factors.
            TimingError: No motion within the limits was found.
        """
        return scale_motion(self, profile, robot).trajectory

    def state_at(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Reference position, velocity and acceleration at a time, each (dof,).

        The state is on the curve of `interpolation`; before and after the motion, at rest at its first and its last
        position. A time that rounding has put less than `_CLOCK_STEP` before the motion counts as its start, which may
        be in motion.

        Args:
            t: The time [s].

        Raises:
            OptionError: `t` is not a finite number.

        Examples:
            >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
            >>> [values.tolist() for values in motion.state_at(1.0)]
            [[0.5], [0.75], [0.0]]
        """
        number("t", t, "a time in seconds")
        if -_CLOCK_STEP < t < 0.0:
            t = 0.0
        if not 0.0 <= t < self.duration:
            still = np.zeros(len(self.joint_names))
            return self.position[0 if t < 0.0 else -1], still, still
        row = min(int(np.searchsorted(self.time, t, side="right")), self.samples - 1)
        about = slice(row - 1, row + 1)
        rows = Rows(*(values[about] for values in self.rows))
        bezier, _ = segments_between(rows, self.interpolation)
        q, v, a = (evaluate(bezier, rows.time, np.array([t]), order) for order in range(3))
        return q[0], v[0], a[0]

    def plot(self, robot: Robot | None = None) -> Figure:
        """Plot positions, velocities, accelerations and torques over time.

        Requires the extra `figures`; returns a matplotlib figure.

        Args:
            robot: The arm, to draw its limits; None for no limits.

        Raises:
            InputError: Matplotlib is not installed, or the robot has other joints.
        """
        figure: Figure = VIEWERS["draw_trajectory"](self, robot)
        return figure

    def positions(self, clock: ArrayLike) -> FloatArray:
        """(k, dof) configurations at (k,) times, on the curve of `interpolation`.

        Raises:
            InputError: `clock` is not a list of finite times.
        """
        times = numbers("clock", clock, (None,))
        if self.samples == 1:
            return self.rows.positions(times)
        return evaluate(self.segments[0], self.time, times)


@dataclass(frozen=True, eq=False)
class Retimed(Record):
    """Retimed motion on the path of another one.

    Attributes:
        trajectory: The motion, on the clock of the original one up to the sample where they part.
        row: Index of that sample.
        clock: (samples,) each sample's time in the original motion [s].
        off_path: (dof,) upper bound on each joint's displacement off the path at any time [rad].
        off_path_m: Upper bound on the arm's displacement off the path [m].
    """

    trajectory: Trajectory
    row: int
    clock: FloatArray
    off_path: FloatArray
    off_path_m: float

    @classmethod
    def cut(cls, trajectory: Trajectory, row: int) -> Retimed:
        """The original motion, up to a sample."""
        kept = trajectory if row == trajectory.samples - 1 else trajectory.cut_after(row)
        return cls(kept, row, kept.time, np.zeros(len(trajectory.joint_names)), 0.0)


def stop_motion(trajectory: Trajectory, t: float, robot: Robot) -> Retimed:
    """The motion with the quickest stop on its path.

    The stop begins at the first sample at or after the time. If the motion itself comes to rest as early, it is the
    stop.

    Args:
        trajectory: The motion; its joints are the robot's.
        t: The time, within the motion [s].
        robot: The arm, for its limits.

    Raises:
        OptionError: `t` is outside the motion.
        InputError: The motion has other joints than the robot, or its segments are not cubics.
        TimingError: No stop was found, and the motion does not end at rest.
    """
    _check_kinds(trajectory, robot)
    number(
        "t", t, f"a time between 0 and the motion's end at {trajectory.duration:.6g} s",
        lambda value: 0.0 <= value <= trajectory.duration,
    )  # fmt: skip
    row, rows = int(np.searchsorted(trajectory.time, t - SAME_TIME)), trajectory.rows
    takes_over_s = trajectory.takes_over_s if row == 0 else float(trajectory.time[row])
    if rows.is_at_rest(row):
        return Retimed.cut(trajectory.copy_unchecked(rows, takes_over_s=takes_over_s), row)
    found = None
    if row < trajectory.samples - 1:
        found = rescale(rows, trajectory.course, robot, row, np.zeros_like, final_s=0.0)
    rests = rows.is_at_rest(-1)
    if found is not None and (not rests or found[0].duration < trajectory.duration):
        return Retimed(_on_path(trajectory, robot, found[0], takes_over_s), row, *found[1:])
    if rests:
        return Retimed.cut(trajectory.copy_unchecked(rows, takes_over_s=takes_over_s), trajectory.samples - 1)
    raise TimingError("no stop within the limits was found, and the motion does not end at rest", cause="no stop")


def scale_motion(trajectory: Trajectory, profile: Profile, robot: Robot) -> Retimed:
    """The motion at other speeds, on its path.

    Factors are followed as closely as the limits permit: a step of the factor becomes a ramp. A factor of 0 is a pause;
    if the last factor of an array is 0, the motion ends when it comes to rest.

    Args:
        trajectory: The motion; its joints are the robot's.
        profile: Fraction of the motion's own speed over the time of the new motion: a number, (n, 2) rows of time [s]
            and factor, linear in between and constant after the last one (a repeated time is a step), or a function of
            the time [s]. Factors above 1 are accepted if the limits permit them for the whole motion.
        robot: The arm, for its limits.

    Raises:
        OptionError: A factor is negative, not finite or beyond the limits, times decrease or are negative, or the
            motion does not end with these factors.
        InputError: The motion has other joints than the robot, or its segments are not cubics.
        TimingError: No motion within the limits was found.
    """
    _check_kinds(trajectory, robot)
    factors, last_s, last = speed_factors(profile)
    rows, own = trajectory.rows, factors(trajectory.time)
    differs = np.flatnonzero((own[:-1] != 1.0) | (own[1:] != 1.0))
    if len(differs) == 0:
        return Retimed.cut(trajectory, trajectory.samples - 1)
    row = int(differs[0])
    check_factors(rows, robot, float(own.max()))
    begin = float(trajectory.time[row])

    def read_profile(clock: FloatArray) -> FloatArray:
        values = factors(begin + clock)
        check_factors(rows, robot, float(values.max(initial=0.0)))
        return values

    final_s = last_s - begin if last == 0.0 else np.inf
    found = rescale(rows, trajectory.course, robot, row, read_profile, final_s=final_s)
    if found is not None:
        takes_over_s = begin if row > 0 else trajectory.takes_over_s
        return Retimed(_on_path(trajectory, robot, found[0], takes_over_s), row, *found[1:])
    if rows.is_at_rest(-1):
        raise TimingError("no motion at these speed factors keeps the limits", cause="speed factors")
    velocity, acceleration = trajectory.velocity[-1], trajectory.acceleration[-1]
    joint = int((np.abs(velocity) if velocity.any() else np.abs(acceleration)).argmax())
    unit = joint_unit(robot.slides[joint])
    raise TimingError(
        f"the motion ends with joint {robot.joint_names[joint]!r} at {abs(velocity[joint]):.3g} {unit.velocity} "
        f"with an acceleration of {abs(acceleration[joint]):.3g} {unit.acceleration}: at other speeds it would end "
        "differently; only a motion that ends at rest can be rescaled",
        joint=robot.joint_names[joint],
        cause="not at rest at the end",
    )


def _on_path(trajectory: Trajectory, robot: Robot, rows: Rows, takes_over_s: float | None) -> Trajectory:
    """The retimed motion of a robot."""
    return trajectory.copy_unchecked(rows, slides=robot.slides, takes_over_s=takes_over_s)


def _check_kinds(trajectory: Trajectory, robot: Robot) -> None:
    """Check that a trajectory consists of cubics and has a robot's joints."""
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    instance("robot", robot, Robot, "load_robot")
    check_trajectory_joints(trajectory, robot)
    if trajectory.interpolation != "cubic":
        raise InputError(
            f"stops and other speeds require cubic interpolation; this one is {trajectory.interpolation} between its "
            'samples. Follow its cubics instead, dataclasses.replace(trajectory, interpolation="cubic"), and certify '
            "them",
            interpolation=trajectory.interpolation,
        )


def check_trajectory_joints(trajectory: Trajectory, robot: Robot) -> None:
    """Check that a trajectory has a robot's joints and units.

    Raises:
        InputError: The joints or the units differ; names the joints of both, or the joint with the other unit.
    """
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; the robot has {', '.join(robot.joint_names)}"
        )
    check_units(dict(zip(trajectory.joint_names, trajectory.slides, strict=False)), robot)


def check_units(slides: Mapping[str, bool], robot: Robot) -> None:
    """Check that prismatic joints are in metres and revolute ones in radians.

    Args:
        slides: Whether each joint, by name, is in metres; joints with an unknown unit are left out.
        robot: The arm.

    Raises:
        InputError: A joint has the wrong unit; names it and its columns.
    """
    for joint, ours in zip(robot.joint_names, robot.slides, strict=True):
        if slides.get(joint, ours) != ours:
            kind, unit = ("slides", "radians") if ours else ("turns", "metres")
            columns = ", ".join(f"{joint}_{name}" for name in joint_unit(ours).columns)
            before = "; earlier versions of hplan used the names of radians for metres" if ours else ""
            raise InputError(
                f"joint {joint!r} {kind}, but the motion has it in {unit}; its columns are {columns}{before}",
                joint=joint,
            )


def join_trajectories(parts: Sequence[Trajectory]) -> Trajectory:
    """Concatenate motions; each must start where its predecessor ends.

    Position and velocity must match.

    Raises:
        InputError: `parts` is empty, or a motion has other joints or another interpolation, or starts at another
            position or velocity.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> join_trajectories([motion, motion.reversal]).duration
        4.0
    """
    parts = list_of("parts", parts, Trajectory, "trajectories")
    if not parts:
        raise InputError("joined: there is no motion to join")
    if len(parts) == 1:
        return parts[0]
    for place, (first, second) in enumerate(itertools.pairwise(parts)):
        if second.joint_names != first.joint_names:
            raise InputError(f"joined: motion {place + 1} moves other joints than the one before it")
        gap = max(
            float(np.abs(second.position[0] - first.position[-1]).max()),
            float(np.abs(second.velocity[0] - first.velocity[-1]).max()),
        )
        if gap > 1e-9:
            raise InputError(
                f"joined: motion {place + 1} does not begin where the one before it ends (off by {gap:.4g})",
                motion=place + 1,
            )
    slides = next((part.slides for part in parts if part.slides), ())
    curves = sorted({part.interpolation for part in parts if part.samples > 1}) or [parts[0].interpolation]
    if len(curves) > 1:
        raise InputError(f"joined: motions are {' and '.join(curves)} between their samples; they must be the same")
    rows = joined_rows([part.rows for part in parts])
    return Trajectory(parts[0].joint_names, *rows, slides, curves[0], parts[0].takes_over_s)


def csv_header(joint_names: tuple[str, ...], slides: Sequence[bool] = ()) -> list[str]:
    """Column names: `time_s`, then four for each joint in its units.

    Units are radians for revolute and metres for prismatic joints.

    Examples:
        >>> csv_header(("q1",))
        ['time_s', 'q1_pos_rad', 'q1_vel_rad_s', 'q1_acc_rad_s2', 'q1_torque_nm']
    """
    kinds = zip(joint_names, slides or [False] * len(joint_names), strict=True)
    return ["time_s", *(f"{joint}_{name}" for joint, slides in kinds for name in joint_unit(slides).columns)]


def as_table(trajectory: Trajectory) -> FloatArray:
    """(n, 1 + 4 dof) table in the order of `csv_header`.

    Negative zeros become zeros.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> as_table(motion).tolist()
        [[0.0, 0.0, 0.0, 0.0, 0.0], [2.0, 1.0, 0.0, 0.0, 0.0]]
    """
    columns = np.stack(
        [trajectory.position, trajectory.velocity, trajectory.acceleration, trajectory.torque],
        axis=2,
    )
    table: FloatArray = np.column_stack([trajectory.time, columns.reshape(trajectory.samples, -1)]) + 0.0
    return table


def write_csv(trajectory: Trajectory, path: Path | str, robot: Robot | None = None, *, whole: bool = False) -> Path:
    """Write a trajectory as an RFC 4180 CSV file.

    Values read back exactly. The file has one header line and no comments. An existing file is replaced.

    Args:
        trajectory: The motion. If it does not define `slides`, all joints count as revolute.
        path: The file.
        robot: The motion's robot, which defines the prismatic joints; None to use the trajectory's `slides`.
        whole: Whether to write a stopped or retimed motion with the running motion's samples up to the stop, for an arm
            at rest at the first sample.

    Raises:
        InputError: The motion has another robot's joints, a joint has other units, or the motion contains samples of a
            running motion, which would send the arm back, and `whole` is false.
        OutputError: The file cannot be written.

    Examples:
        >>> import tempfile
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     read_csv(write_csv(motion, f"{folder}/motion.csv"))
        <Trajectory: 2 s, 2 samples, joints q1>
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    if not truth("whole", whole) and trajectory.takes_over_s:
        raise InputError(
            f"the motion takes over {trajectory.takes_over_s:.6g} s after its first sample, and a CSV has no start "
            "time: run from its first sample, it would send a moving arm back. Write trajectory.cut_before(row) for "
            "the sample where the arm is, or give whole=True if the arm is at rest at the first sample",
            takes_over_s=trajectory.takes_over_s,
        )
    if robot is not None:
        instance("robot", robot, Robot, "load_robot")
        check_trajectory_joints(trajectory, robot)
        trajectory = replace(trajectory, slides=robot.slides)
    return write_text(path, csv_text(trajectory))


def csv_text(trajectory: Trajectory) -> str:
    """Text of the CSV that `write_csv` writes.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> csv_text(motion).splitlines()[1]
        '0.0,0.0,0.0,0.0,0.0'
    """
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(csv_header(trajectory.joint_names, trajectory.slides))
    writer.writerows(as_table(trajectory).tolist())
    return text.getvalue()


def read_csv(path: Path | str, *, interpolation: Interpolation = "cubic") -> Trajectory:
    r"""Read a trajectory from a CSV file, written by hplan or not.

    Args:
        path: The file.
        interpolation: Curve that the controller follows between the samples; motions of hplan are cubics.

    Raises:
        InputError: The file is missing, its columns are not those of `csv_header`, a cell is not a finite number, or
            time does not increase strictly from 0; names the line.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "motion.csv"
        ...     _ = path.write_text("time_s,q1_pos_rad,q1_vel_rad_s,q1_acc_rad_s2,q1_torque_nm\n0,0,0,0,0\n2,1,0,0,0\n")
        ...     read_csv(path).duration
        2.0
    """
    file = CsvFile.read(path, "trajectory", "sample")
    joints, slides = joints_of_columns(file.header)
    if not joints or file.header != csv_header(joints, slides):
        turning, sliding = (", ".join("NAME_" + name for name in unit.columns) for unit in (TURNING, SLIDING))
        raise file.fault(
            1, f"expected the columns time_s and, for each joint, {turning}; for prismatic joints {sliding}"
        )
    rows: list[FloatArray] = []
    for line, texts, values in file.timed_rows(range(len(file.header))):
        if not rows and values[0] != 0.0:
            raise file.fault(line, f"time_s is {texts[0]}, expected 0 in the first sample")
        rows.append(np.array(values))
    table = np.stack(rows)
    columns = table[:, 1:].reshape(len(table), len(joints), len(TURNING.columns))
    position, velocity, acceleration, torque = np.moveaxis(columns, 2, 0)
    return Trajectory(joints, table[:, 0], position, velocity, acceleration, torque, slides, interpolation)


def joints_of_columns(header: Sequence[str]) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Joints with a position column, and whether each is in metres."""
    ends = f"_{TURNING.columns[0]}", f"_{SLIDING.columns[0]}"
    found = [(name[: -len(end)], end == ends[1]) for name in header for end in ends if name.endswith(end)]
    return tuple(name for name, _ in found), tuple(slides for _, slides in found)
