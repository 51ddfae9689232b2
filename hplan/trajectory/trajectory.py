"""A timed motion, sampled as the controller will run it, and its CSV."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import instance, list_of, number, one_of, truth, whole
from hplan.base.arrays import FloatArray, Record, numbers
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
from hplan.trajectory.time_scaling import Profile, check_factors, rescaled, speed_factors

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: A row so little before a time is at it [s].
SAME_TIME = 1e-9

#: Differences of a controller's times are no finer than this where it counts seconds since 1970 [s].
_CLOCK_STEP = 1e-6


@dataclass(frozen=True)
class Phase:
    """A part of a trajectory.

    Attributes:
        name: `transit`, `approach` or `retreat`; of tours also `drop` and `return`.
        start_s: When it begins [s].
        end_s: When it ends [s].
    """

    name: str
    start_s: float
    end_s: float

    def later(self, seconds: float) -> Phase:
        """The part of a motion that begins as much later [s]."""
        return Phase(self.name, self.start_s + seconds, self.end_s + seconds)


@dataclass(frozen=True, eq=False)
class Trajectory(Record):
    """Samples of a motion, at rest at both ends unless asked for otherwise.

    Attributes:
        joint_names: Names of the `dof` joints.
        time: (n,) strictly increasing from 0 [s].
        position: (n, dof).
        velocity: (n, dof) [rad/s].
        acceleration: (n, dof) [rad/s^2].
        torque: (n, dof) joint torques by inverse dynamics [N m], of joints that slide forces [N].
        slides: Of each joint whether it slides, and is in metres; empty where that is not known.
        interpolation: The curve that the controller follows between two rows: `cubic` has their positions and
            velocities, as every motion of hplan, `quintic` their accelerations too, `linear` their positions alone.
        takes_over_s: Of a motion that takes over from a running one, the time up to which its rows are those of the
            running one and may be past when it is sent [s]; 0 if it begins where the arm is. A message of it needs a
            start time. None for a motion that begins on its own.
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
        time = numbers("trajectory: time", self.time, (None,))
        object.__setattr__(self, "time", time)
        if len(time) == 0 or time[0] != 0.0:
            raise InputError("trajectory: time must be a list of finite values that starts at 0")
        if not (np.diff(time) > 0.0).all():
            raise InputError(f"trajectory: time does not increase at sample {int(np.argmin(np.diff(time) > 0.0)) + 1}")
        shape = (len(time), len(self.joint_names))
        for name in ("position", "velocity", "acceleration", "torque"):
            object.__setattr__(self, name, numbers(f"trajectory: {name}", getattr(self, name), shape))
        slides = list_of("trajectory: slides", self.slides, bool, "truth values")
        if len(slides) not in (0, shape[1]):
            raise InputError(f"trajectory: slides has {len(slides)} values, expected one for each of {shape[1]} joints")
        object.__setattr__(self, "slides", slides)
        one_of("interpolation", self.interpolation, get_args(Interpolation))
        if self.takes_over_s is not None:
            number(
                "takes_over_s", self.takes_over_s, "a time since the motion began, or None", lambda time: time >= 0.0
            )

    def __repr__(self) -> str:
        return f"<Trajectory: {self.duration:.6g} s, {self.samples} rows, joints {', '.join(self.joint_names)}>"

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def rows(self) -> Rows:
        """Its samples alone."""
        return Rows(self.time, self.position, self.velocity, self.acceleration, self.torque)

    @property
    def segments(self) -> tuple[FloatArray, FloatArray]:
        """The polynomials between its rows: (segments, 4 or 6, dof) Bezier points and (segments,) durations.

        Points are not finite if numbers overflow. A single row is one constant segment of 1 s.
        """
        return segments_between(self.rows, self.interpolation)

    @property
    def end_velocities(self) -> FloatArray:
        """(2, dof) velocities with which the curve leaves the first row and reaches the last one."""
        bezier, duration = self.segments
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.stack([bezier[0, 1] - bezier[0, 0], bezier[-1, -1] - bezier[-1, -2]])
            velocities: FloatArray = (bezier.shape[1] - 1.0) * steps / duration[[0, -1], None]
        return velocities

    def _with(self, rows: Rows, takes_over_s: float | None = None) -> Trajectory:
        return Trajectory(self.joint_names, *rows, self.slides, self.interpolation, takes_over_s)

    @property
    def reversed(self) -> Trajectory:
        """The motion backwards. Torques stay as they are: inverse dynamics knows velocity only by its square."""
        time, position, acceleration = self.time[-1] - self.time[::-1], self.position[::-1], self.acceleration[::-1]
        return self._with(Rows(time, position, -self.velocity[::-1], acceleration, self.torque[::-1]))

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    def since(self, row: int) -> Trajectory:
        """The motion from a row on; it begins in motion if it is in motion there.

        If it is in motion there, it takes over from the motion that runs until then (`takes_over_s`).

        Raises:
            OptionError: There is no such row.
        """
        row = whole("row", row, 0, self.samples - 1)
        if row == 0:
            return self
        begins_alone = self.takes_over_s is None and self.rows.is_at_rest(row)
        return self._with(self.rows.since(row), None if begins_alone else 0.0)

    def until(self, row: int) -> Trajectory:
        """The motion up to a row; it ends in motion if it is in motion there.

        Raises:
            OptionError: It has no such row.
        """
        return self._with(self.rows.until(whole("row", row, 0, self.samples - 1)), self.takes_over_s)

    def stop_at(self, t: float, robot: Robot) -> Trajectory:
        """The motion up to the first row at or after a time, and from there on the quickest stop on its path.

        The path stays (to 0.1 mm): what was clear of obstacles on it is. `stopped` says more.

        Args:
            t: The time, within the motion [s].
            robot: The arm, for its limits.

        Raises:
            OptionError: A time before the motion or after it, or no robot.
            TimingError: The motion neither ends at rest, nor was a stop found.
        """
        return stopped(self, t, robot).trajectory

    def scaled(self, profile: Profile, robot: Robot) -> Trajectory:
        """The motion at other speeds, on its path (to 0.1 mm).

        Args:
            profile: Fraction of the motion's own speed over time: a number, (n, 2) rows of time [s] and factor, or a
                function of the time (the function `scaled` says more).
            robot: The arm, for its limits.

        Raises:
            OptionError: Factors that are none, beyond what limits allow, or with which the motion does not end.
            TimingError: No motion within the limits was found.
        """
        return scaled(self, profile, robot).trajectory

    def state_at(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration that a controller is to follow at a time, each (dof,).

        On the curve of `interpolation`; before the motion and after it, at rest where it begins and where it ends. A
        time that rounding has put less than `_CLOCK_STEP` before the motion is its begin, which may be in motion.

        Args:
            t: The time [s].

        Raises:
            OptionError: No finite number.
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
        """Positions, velocities, accelerations and torques over time as matplotlib's figure (extra `figures`).

        Args:
            robot: The arm, to draw its limits.

        Raises:
            InputError: Matplotlib is not installed; a robot of other joints.
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
    """A motion on the path of another one.

    Attributes:
        trajectory: The motion, on the same clock as the other one up to where they part.
        row: The row at which they part.
        clock: (samples,) for each row the time at which the other motion is there [s].
        off_path: (dof,) bound of how far each joint is off the path at any time [rad].
        off_path_m: Bound of how far the arm is off it [m].
    """

    trajectory: Trajectory
    row: int
    clock: FloatArray
    off_path: FloatArray
    off_path_m: float

    @classmethod
    def cut(cls, trajectory: Trajectory, row: int) -> Retimed:
        """The motion itself, up to a row."""
        kept = trajectory if row == trajectory.samples - 1 else trajectory.until(row)
        return cls(kept, row, kept.time, np.zeros(len(trajectory.joint_names)), 0.0)


def stopped(trajectory: Trajectory, t: float, robot: Robot) -> Retimed:
    """The motion with the quickest stop on its path from the first row at or after a time on.

    Where the motion itself comes to rest as early, that is the stop.

    Args:
        trajectory: The motion; its joints are the robot's.
        t: The time, within the motion [s].
        robot: The arm, for its limits.

    Raises:
        OptionError: A time before the motion or after it.
        InputError: A motion of other joints.
        TimingError: The motion neither ends at rest, nor was a stop found.
    """
    _check_kinds(trajectory, robot)
    number(
        "t", t, f"a time between 0 and the motion's end at {trajectory.duration:.6g} s",
        lambda value: 0.0 <= value <= trajectory.duration,
    )  # fmt: skip
    row, rows = int(np.searchsorted(trajectory.time, t - SAME_TIME)), trajectory.rows
    takes_over_s = trajectory.takes_over_s if row == 0 else float(trajectory.time[row])
    trajectory = replace(trajectory, takes_over_s=takes_over_s)
    if rows.is_at_rest(row):
        return Retimed.cut(trajectory, row)
    found = None
    if row < trajectory.samples - 1:
        found = rescaled(rows, robot, row, np.zeros_like, final_s=0.0)
    rests = rows.is_at_rest(-1)
    if found is not None and (not rests or found[0].duration < trajectory.duration):
        return _parted(robot, found, row, takes_over_s)
    if rests:
        return Retimed.cut(trajectory, trajectory.samples - 1)
    raise TimingError("no stop within the limits was found, and the motion does not end at rest", cause="no stop")


def scaled(trajectory: Trajectory, profile: Profile, robot: Robot) -> Retimed:
    """The motion at other speeds, on its path.

    Factors are followed as closely as limits allow: what they ask for at once is reached over a ramp. A pause is a
    factor of 0; where the last factor of rows is 0, the motion ends at rest when it gets there.

    Args:
        trajectory: The motion; its joints are the robot's.
        profile: Fraction of the motion's own speed over the time of the new motion: a number, (n, 2) rows of time [s]
            and factor, linear in between and constant after the last one (at a time given twice it steps), or a
            function of the time [s]. More than 1 is taken where the whole motion has room for it.
        robot: The arm, for its limits.

    Raises:
        OptionError: A factor that is negative, not finite or beyond what limits allow; times that decrease or are
            negative; factors with which the motion does not end.
        InputError: A motion of other joints.
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

    def wanted(clock: FloatArray) -> FloatArray:
        values = factors(begin + clock)
        check_factors(rows, robot, float(values.max(initial=0.0)))
        return values

    found = rescaled(rows, robot, row, wanted, final_s=last_s - begin if last == 0.0 else np.inf)
    if found is not None:
        return _parted(robot, found, row, begin if row > 0 else trajectory.takes_over_s)
    if rows.is_at_rest(-1):
        raise TimingError("no motion at these speed factors keeps the limits", cause="speed factors")
    velocity, acceleration = trajectory.velocity[-1], trajectory.acceleration[-1]
    joint = int((np.abs(velocity) if velocity.any() else np.abs(acceleration)).argmax())
    unit = joint_unit(robot.slides[joint])
    raise TimingError(
        f"the motion ends with joint {robot.joint_names[joint]!r} at {abs(velocity[joint]):.3g} {unit.velocity} "
        f"with an acceleration of {abs(acceleration[joint]):.3g} {unit.acceleration}: at other speeds it would end "
        "otherwise; only one that ends without either can be run so",
        joint=robot.joint_names[joint],
        cause="not at rest at the end",
    )


def _parted(
    robot: Robot, found: tuple[Rows, FloatArray, FloatArray, float], row: int, takes_over_s: float | None
) -> Retimed:
    """A motion that leaves the timing of another one at a row."""
    return Retimed(Trajectory(robot.joint_names, *found[0], robot.slides, takes_over_s=takes_over_s), row, *found[1:])


def _check_kinds(trajectory: Trajectory, robot: Robot) -> None:
    """Check that a trajectory is one of cubics, of a robot.

    Raises:
        InputError: Its joints are not the robot's, or it is not made of cubics.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    instance("robot", robot, Robot, "load_robot")
    check_joints(trajectory, robot)
    if trajectory.interpolation != "cubic":
        raise InputError(
            f"stops and other speeds are made of cubic motions; this one is {trajectory.interpolation} between its "
            'rows. Let the controller run its cubics, dataclasses.replace(trajectory, interpolation="cubic"), and '
            "certify those",
            interpolation=trajectory.interpolation,
        )


def check_joints(trajectory: Trajectory, robot: Robot) -> None:
    """Refuse a trajectory of other joints than a robot's, or in other units.

    Raises:
        InputError: It is one; names the joints of both, or the joint that slides in one of them alone.
    """
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; the robot has {', '.join(robot.joint_names)}"
        )
    check_units(dict(zip(trajectory.joint_names, trajectory.slides, strict=False)), robot)


def check_units(slides: Mapping[str, bool], robot: Robot) -> None:
    """Refuse a motion with a joint in metres that turns, or one in radians that slides.

    Args:
        slides: Of each joint, by name, whether it is in metres; those of which that is not known are left out.

    Raises:
        InputError: There is one; names it and its columns.
    """
    for joint, ours in zip(robot.joint_names, robot.slides, strict=True):
        if slides.get(joint, ours) != ours:
            kind, unit = ("slides", "radians") if ours else ("turns", "metres")
            columns = ", ".join(f"{joint}_{name}" for name in joint_unit(ours).columns)
            before = "; hplan gave metres the names of radians before" if ours else ""
            raise InputError(
                f"joint {joint!r} {kind}, but the motion has it in {unit}; its columns are {columns}{before}",
                joint=joint,
            )


def joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Motions one after the other; each begins where the one before it ends, and at its speed.

    Raises:
        InputError: No motion, motions of other joints, or one that begins elsewhere or at another velocity.
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
                f"joined: motion {place + 1} does not go on where the one before it ends (off by {gap:.4g})",
                motion=place + 1,
            )
    slides = next((part.slides for part in parts if part.slides), ())
    curves = sorted({part.interpolation for part in parts if part.samples > 1}) or [parts[0].interpolation]
    if len(curves) > 1:
        raise InputError(f"joined: motions are {' and '.join(curves)} between their rows; they must be the same")
    rows = joined_rows([part.rows for part in parts])
    return Trajectory(parts[0].joint_names, *rows, slides, curves[0], parts[0].takes_over_s)


def csv_header(joint_names: tuple[str, ...], slides: Sequence[bool] = ()) -> list[str]:
    """Column names: `time_s`, then four for each joint, in the units of one that turns or, where it slides, of that."""
    kinds = zip(joint_names, slides or [False] * len(joint_names), strict=True)
    return ["time_s", *(f"{joint}_{name}" for joint, slides in kinds for name in joint_unit(slides).columns)]


def as_table(trajectory: Trajectory) -> FloatArray:
    """(n, 1 + 4 dof) the rows of the trajectory's CSV, in the order of `csv_header`; no zero has a sign."""
    columns = np.stack(
        [trajectory.position, trajectory.velocity, trajectory.acceleration, trajectory.torque],
        axis=2,
    )
    table: FloatArray = np.column_stack([trajectory.time, columns.reshape(trajectory.samples, -1)]) + 0.0
    return table


def write_csv(trajectory: Trajectory, path: Path | str, robot: Robot | None = None, *, whole: bool = False) -> Path:
    """Write the trajectory as RFC 4180 CSV: one header line, no comments, values that read back exactly.

    A file of that name is replaced, as by all functions that write a file.

    Args:
        trajectory: The motion. Where it does not say which joints slide, as those of hplan do, all count as turning.
        path: The file.
        robot: The robot that it is of, and that says which slide.
        whole: Whether to write a stop, or other speeds, with the rows that the running motion has up to there, for an
            arm that is at the first row and at rest.

    Raises:
        InputError: It is of another robot, or has a joint in other units; or it has rows of a running motion, which
            would send the arm back, and `whole` is false.
        OutputError: The file cannot be written.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    if not truth("whole", whole) and trajectory.takes_over_s:
        raise InputError(
            f"the motion takes over {trajectory.takes_over_s:.6g} s after its first row, and a CSV has no start time: "
            "run from its first row it would send a moving arm back. Write trajectory.since(row) from the row where "
            "the arm is, or give whole=True if the arm is at rest at the first row",
            takes_over_s=trajectory.takes_over_s,
        )
    if robot is not None:
        instance("robot", robot, Robot, "load_robot")
        check_joints(trajectory, robot)
        trajectory = replace(trajectory, slides=robot.slides)
    return write_text(path, csv_text(trajectory))


def csv_text(trajectory: Trajectory) -> str:
    """The text of the CSV that `write_csv` writes."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(csv_header(trajectory.joint_names, trajectory.slides))
    writer.writerows(as_table(trajectory).tolist())
    return text.getvalue()


def read_csv(path: Path | str, *, interpolation: Interpolation = "cubic") -> Trajectory:
    """Read a trajectory CSV, whoever wrote it.

    Args:
        path: The file.
        interpolation: The curve that the controller runs between the rows; those that hplan wrote are cubics.

    Raises:
        InputError: Missing file, other columns than `csv_header` gives, a cell that is no finite number, time that
            does not increase strictly from 0; names the line.
    """
    file = CsvFile.read(path, "trajectory", "sample")
    joints, slides = joints_of_columns(file.header)
    if not joints or file.header != csv_header(joints, slides):
        turning, sliding = (", ".join("NAME_" + name for name in unit.columns) for unit in (TURNING, SLIDING))
        raise file.fault(1, f"expected the columns time_s and, for each joint, {turning}; where it slides, {sliding}")
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
    """The joints that have a column of positions, in their order, and of each whether it is in metres."""
    ends = f"_{TURNING.columns[0]}", f"_{SLIDING.columns[0]}"
    found = [(name[: -len(end)], end == ends[1]) for name in header for end in ends if name.endswith(end)]
    return tuple(name for name, _ in found), tuple(slides for _, slides in found)
