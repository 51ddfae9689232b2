"""A timed motion, sampled as the controller will run it, and its CSV."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import instance, list_of, number, whole
from hplan.base.arrays import FloatArray, Record, numbers
from hplan.base.csv_file import CsvFile
from hplan.base.files import write_text
from hplan.base.units import SLIDING, TURNING, joint_unit
from hplan.errors import InputError

if TYPE_CHECKING:
    from hplan.robot.model import Robot
    from hplan.trajectory.speed_factors import Profile

#: Ends of motions nearer to each other than this are one [rad, rad/s].
JOINED = 1e-9

#: Differences of a controller's times are no finer than this where it counts seconds since 1970 [s].
CLOCK_STEP = 1e-6


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
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    slides: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes, values and time, and make the arrays read-only."""
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

    def __repr__(self) -> str:
        """Duration, number of rows and joints."""
        return f"<Trajectory: {self.duration:.6g} s, {self.samples} rows, joints {', '.join(self.joint_names)}>"

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def reversed(self) -> Trajectory:
        """The motion backwards. Torques stay as they are: inverse dynamics knows velocity only by its square."""
        return Trajectory(
            self.joint_names,
            self.time[-1] - self.time[::-1],
            self.position[::-1],
            -self.velocity[::-1],
            self.acceleration[::-1],
            self.torque[::-1],
            self.slides,
        )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)

    def since(self, row: int) -> Trajectory:
        """The motion from a row on; it begins in motion if it is in motion there.

        Raises:
            OptionError: It has no such row.
        """
        row = whole("row", row, 0, self.samples - 1)
        return Trajectory(
            self.joint_names,
            self.time[row:] - self.time[row],
            self.position[row:],
            self.velocity[row:],
            self.acceleration[row:],
            self.torque[row:],
            self.slides,
        )

    def until(self, row: int) -> Trajectory:
        """The motion up to a row; it ends in motion if it is in motion there.

        Raises:
            OptionError: It has no such row.
        """
        row = whole("row", row, 0, self.samples - 1)
        return Trajectory(
            self.joint_names,
            self.time[: row + 1],
            self.position[: row + 1],
            self.velocity[: row + 1],
            self.acceleration[: row + 1],
            self.torque[: row + 1],
            self.slides,
        )

    def stop_at(self, t: float, robot: Robot) -> Trajectory:
        """The motion up to the first row at or after a time, and from there on the quickest stop on its path.

        The path stays (to 0.1 mm): what was clear of obstacles on it is. `hplan.trajectory.time_scaling.stopped` says
        more.

        Args:
            t: The time, within the motion [s].
            robot: The arm, for its limits.

        Raises:
            OptionError: A time before the motion or after it, or no robot.
            TimingError: The motion neither ends at rest, nor was a stop found.
        """
        from hplan.trajectory.time_scaling import stopped

        return stopped(self, t, robot).trajectory

    def scaled(self, profile: Profile, robot: Robot) -> Trajectory:
        """The motion at other speeds, on its path (to 0.1 mm).

        Args:
            profile: Fraction of the motion's own speed over time: a number, (n, 2) rows of time [s] and factor, or a
                function of the time (`hplan.trajectory.time_scaling.scaled`).
            robot: The arm, for its limits.

        Raises:
            OptionError: Factors that are none, beyond what limits allow, or with which the motion does not end.
            TimingError: No motion within the limits was found.
        """
        from hplan.trajectory.time_scaling import scaled

        return scaled(self, profile, robot).trajectory

    def state_at(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration that a controller is to follow at a time, each (dof,).

        On the cubics of `cubic_pieces`; before the motion and after it, at rest where it begins and where it ends. A
        time that rounding has put less than `CLOCK_STEP` before the motion is its begin, which may be in motion.

        Args:
            t: The time [s].

        Raises:
            OptionError: No finite number.
        """
        number("t", t, "a time in seconds")
        if -CLOCK_STEP < t < 0.0:
            t = 0.0
        if not 0.0 <= t < self.duration:
            still = np.zeros(len(self.joint_names))
            return self.position[0 if t < 0.0 else -1], still, still
        q, v, a = cubic_states(self.time, self.position, self.velocity, np.array([t]))
        return q[0], v[0], a[0]

    def positions(self, clock: ArrayLike) -> FloatArray:
        """(k, dof) configurations at (k,) times, on the cubics of `cubic_pieces`.

        Raises:
            InputError: No list of finite times.
        """
        clock = np.clip(numbers("clock", clock, (None,)), 0.0, self.duration)
        bezier, duration = cubic_pieces(self)
        piece = np.clip(np.searchsorted(self.time, clock, side="right") - 1, 0, len(bezier) - 1)
        t = np.clip((clock - self.time[piece]) / duration[piece], 0.0, 1.0)[:, None]
        a, b, c, d = np.moveaxis(bezier[piece], 1, 0)
        u = 1.0 - t
        q: FloatArray = u * u * (u * a + 3.0 * t * b) + t * t * (3.0 * u * c + t * d)
        return q


def cubic_pieces(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """The cubics between the rows of a trajectory, with the rows' positions and velocities.

    Returns:
        (pieces, 4, dof) Bezier points [rad] and (pieces,) durations [s]; of a single row one constant piece of 1 s.
        Points are not finite where numbers overflow.
    """
    q, v = trajectory.position, trajectory.velocity
    if len(q) == 1:
        return np.repeat(q[:, None, :], 4, axis=1), np.ones(1)
    duration = np.diff(trajectory.time)
    third = duration[:, None] / 3.0
    with np.errstate(over="ignore", invalid="ignore"):
        return np.stack([q[:-1], q[:-1] + third * v[:-1], q[1:] - third * v[1:], q[1:]], axis=1), duration


def cubic_states(
    time: FloatArray, position: FloatArray, velocity: FloatArray, clock: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration on the cubics between rows, those of `cubic_pieces`; after the end, there.

    Args:
        time: (n,) times of the rows, n > 1 [s].
        position: (n, dof).
        velocity: (n, dof) [rad/s].
        clock: (k,) times, none before the first row [s].

    Returns:
        Three of (k, dof).
    """
    piece = np.clip(np.searchsorted(time, clock, side="right") - 1, 0, len(time) - 2)
    h = (time[piece + 1] - time[piece])[:, None]
    t = np.minimum((clock - time[piece])[:, None] / h, 1.0)
    p0, p1 = position[piece], position[piece + 1]
    m0, m1 = h * velocity[piece], h * velocity[piece + 1]
    c2, c3 = 3.0 * (p1 - p0) - 2.0 * m0 - m1, 2.0 * (p0 - p1) + m0 + m1
    return p0 + t * (m0 + t * (c2 + t * c3)), (m0 + t * (2.0 * c2 + 3.0 * t * c3)) / h, (2.0 * c2 + 6.0 * t * c3) / h**2


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
        robot: The robot.

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
        if gap > JOINED:
            raise InputError(
                f"joined: motion {place + 1} does not go on where the one before it ends (off by {gap:.4g})",
                motion=place + 1,
            )
    begins = np.concatenate([[0.0], np.cumsum([part.duration for part in parts])])
    times = [part.time[1:] + begin for part, begin in zip(parts, begins, strict=False)]
    rows = {
        name: np.concatenate([getattr(parts[0], name)[:1], *(getattr(part, name)[1:] for part in parts)])
        for name in ("position", "velocity", "acceleration", "torque")
    }
    slides = next((part.slides for part in parts if part.slides), ())
    return Trajectory(parts[0].joint_names, np.concatenate([[0.0], *times]), slides=slides, **rows)


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


def write_csv(trajectory: Trajectory, path: Path | str, robot: Robot | None = None) -> Path:
    """Write the trajectory as RFC 4180 CSV: one header line, no comments, values that read back exactly.

    Args:
        trajectory: The motion. Where it does not say which joints slide, as those of hplan do, all count as turning.
        path: The file.
        robot: The robot that it is of, and that says which slide.

    Raises:
        InputError: It is of another robot, or has a joint in other units.
        OutputError: The file cannot be written.
    """
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    if robot is not None:
        from hplan.robot.model import Robot

        instance("robot", robot, Robot, "load_robot")
        check_joints(trajectory, robot)
        trajectory = replace(trajectory, slides=robot.slides)
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(csv_header(trajectory.joint_names, trajectory.slides))
    writer.writerows(as_table(trajectory).tolist())
    return write_text(path, text.getvalue())


def read_csv(path: Path | str) -> Trajectory:
    """Read a trajectory CSV, whoever wrote it.

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
    return Trajectory(joints, table[:, 0], position, velocity, acceleration, torque, slides)


def joints_of_columns(header: Sequence[str]) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """The joints that have a column of positions, in their order, and of each whether it is in metres."""
    ends = f"_{TURNING.columns[0]}", f"_{SLIDING.columns[0]}"
    found = [(name[: -len(end)], end == ends[1]) for name in header for end in ends if name.endswith(end)]
    return tuple(name for name, _ in found), tuple(slides for _, slides in found)
