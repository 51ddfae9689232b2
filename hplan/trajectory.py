"""A timed motion, sampled as the controller will run it, and its CSV."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hplan.arrays import FloatArray, readonly
from hplan.errors import InputError
from hplan.files import write_text

#: Columns of the CSV for each joint, after `time_s`.
QUANTITIES = ("pos_rad", "vel_rad_s", "acc_rad_s2", "torque_nm")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a motion, at rest at both ends unless asked for otherwise.

    Attributes:
        joint_names: Names of the `dof` joints.
        time: (n,) strictly increasing from 0 [s].
        position: (n, dof).
        velocity: (n, dof) [rad/s].
        acceleration: (n, dof) [rad/s^2].
        torque: (n, dof) joint torques by inverse dynamics [N m].
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray

    def __post_init__(self) -> None:
        """Check shapes, values and time, and make the arrays read-only."""
        time = readonly(self.time)
        object.__setattr__(self, "time", time)
        shape = (len(time), len(self.joint_names))
        if len(time) == 0 or time[0] != 0.0 or not (np.diff(time) > 0.0).all():
            raise InputError("trajectory: time must start at 0 and increase strictly")
        for name in ("position", "velocity", "acceleration", "torque"):
            values = readonly(getattr(self, name))
            if values.shape != shape:
                raise InputError(f"trajectory: {name} has shape {values.shape}, expected {shape}")
            if not np.isfinite(values).all():
                raise InputError(f"trajectory: {name} holds a value that is not finite")
            object.__setattr__(self, name, values)

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.time)


def csv_header(joint_names: tuple[str, ...]) -> list[str]:
    """Column names: `time_s`, then four for each joint."""
    return ["time_s", *(f"{joint}_{quantity}" for joint in joint_names for quantity in QUANTITIES)]


def write_csv(trajectory: Trajectory, path: Path | str) -> Path:
    """Write the trajectory as RFC 4180 CSV: one header line, no comments, values that read back exactly.

    Raises:
        OutputError: The file cannot be written.
    """
    columns = np.stack(
        [trajectory.position, trajectory.velocity, trajectory.acceleration, trajectory.torque],
        axis=2,
    )
    table = np.column_stack([trajectory.time, columns.reshape(trajectory.samples, -1)]) + 0.0
    lines = [",".join(csv_header(trajectory.joint_names))]
    lines.extend(",".join(map(repr, row)) for row in table.tolist())
    return write_text(path, "\r\n".join(lines) + "\r\n")


def read_csv(path: Path | str) -> Trajectory:
    """Read a trajectory CSV, whoever wrote it.

    Raises:
        InputError: Missing file, other columns than `csv_header` gives, a cell that is no finite number, time that
            does not increase strictly from 0; names the line.
    """
    path = Path(path)
    try:
        rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"))))
    except OSError as error:
        raise InputError(f"trajectory file {path}: {error.strerror}", path=str(path)) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"trajectory file {path}: {error}", path=str(path)) from error
    header = rows[0] if rows else []
    suffix = f"_{QUANTITIES[0]}"
    joints = tuple(name.removesuffix(suffix) for name in header if name.endswith(suffix))
    if not joints or header != csv_header(joints):
        raise InputError(
            f"trajectory file {path}, line 1: expected time_s and, for each joint, "
            f"{', '.join('NAME_' + quantity for quantity in QUANTITIES)}",
            path=str(path),
            line=1,
        )
    table = np.empty((len(rows) - 1, len(header)))
    for number, row in enumerate(rows[1:]):
        try:
            table[number] = [float(cell) for cell in row]
        except ValueError as error:
            raise InputError(
                f"trajectory file {path}, line {number + 2}: {error}",
                path=str(path),
                line=number + 2,
            ) from error
        if not all(map(math.isfinite, table[number])):
            raise InputError(
                f"trajectory file {path}, line {number + 2}: a value is not finite",
                path=str(path),
                line=number + 2,
            )
    columns = table[:, 1:].reshape(len(table), len(joints), len(QUANTITIES))
    return Trajectory(joints, table[:, 0], *(columns[:, :, i] for i in range(len(QUANTITIES))))
