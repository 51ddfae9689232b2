"""Motions from other planners: positions and velocities over time, and their CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from hplan.base.arguments import list_of
from hplan.base.arrays import FloatArray, Record, numbers, readonly
from hplan.base.csv_file import CsvFile
from hplan.base.units import SLIDING, TURNING, joint_unit
from hplan.errors import InputError
from hplan.trajectory.trajectory import Trajectory, joints_of_columns


@dataclass(frozen=True, eq=False)
class RecordedMotion(Record):
    """Positions and velocities over time, of any origin.

    Attributes:
        joint_names: Names of the `joints` joints.
        time: (n,) strictly increasing [s].
        position: (n, joints) [rad, or m if prismatic].
        velocity: (n, joints) [rad/s, or m/s if prismatic].
        slides: For each joint whether it is prismatic; empty if unknown.
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    slides: tuple[bool, ...] = ()

    @classmethod
    def from_positions(cls, joint_names: Sequence[str], time: FloatArray, position: FloatArray) -> RecordedMotion:
        """Estimate velocities of a rest-to-rest motion through positions.

        The velocity at a sample is the derivative of the parabola through it and its two neighbours. It is zero at the
        first and last sample.

        Args:
            joint_names: Names of the `joints` joints.
            time: (n,) strictly increasing [s], n >= 1.
            position: (n, joints) [rad, or m if prismatic].

        Raises:
            InputError: `time` or `position` has another shape or a value that is not finite, or `time` is empty or
                does not increase.
        """
        joint_names = list_of("joint_names", joint_names, str, "names")
        time = numbers("time", time, (None,))
        if not len(time) or not (np.diff(time) > 0.0).all():
            raise InputError("time: expected at least one value, each later than the one before")
        position = numbers("position", position, (len(time), len(joint_names)))
        velocity = np.zeros_like(position)
        if len(time) > 2:
            before, after = np.diff(time)[:-1, None], np.diff(time)[1:, None]
            slopes = np.diff(position, axis=0) / np.diff(time)[:, None]
            velocity[1:-1] = (after * slopes[:-1] + before * slopes[1:]) / (before + after)
        return cls(tuple(joint_names), readonly(time), readonly(position), readonly(velocity))


#: A motion that can be executed.
Movement: TypeAlias = Trajectory | RecordedMotion


def read_motion(path: Path | str) -> RecordedMotion:
    """Read the CSV of a motion, written by any program.

    The file has one header line. Required columns, in any order: `time_s`, and for each joint `NAME_pos_rad`
    (`NAME_pos_m` if prismatic). Velocities come from the columns `NAME_vel_rad_s` (`NAME_vel_m_s`) if every joint has
    one, and are otherwise estimated by `RecordedMotion.from_positions`. Other columns are ignored, so hplan's own
    files can be read.

    Raises:
        InputError: The file or a required column is missing, a column is repeated, a cell is not a finite number, or
            time does not increase strictly; names the line.
    """
    file = CsvFile.read(path, "motion", "row")
    header = [name.strip() for name in file.header]
    joints, slides = joints_of_columns(header)
    if "time_s" not in header or not joints:
        names = f"NAME_{TURNING.columns[0]} or, if prismatic, NAME_{SLIDING.columns[0]}"
        raise file.fault(1, f"expected a header with the columns time_s and, for each joint, {names}")
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise file.fault(1, f"column {twice[0]!r} occurs twice")
    kinds = [(joint, joint_unit(slide).columns) for joint, slide in zip(joints, slides, strict=True)]
    wanted = ["time_s", *(f"{joint}_{names[0]}" for joint, names in kinds)]
    velocities = [f"{joint}_{names[1]}" for joint, names in kinds]
    if set(velocities) <= set(header):
        wanted += velocities
    table = np.array([row for _, _, row in file.timed_rows([header.index(name) for name in wanted])])
    time, position = table[:, 0], table[:, 1 : len(joints) + 1]
    if len(wanted) == len(joints) + 1:
        return replace(RecordedMotion.from_positions(joints, time, position), slides=slides)
    return RecordedMotion(joints, readonly(time), readonly(position), readonly(table[:, len(joints) + 1 :]), slides)
