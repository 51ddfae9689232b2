"""Motions made by others: positions and velocities over time, and their CSV."""

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
    """Positions and velocities over time, from wherever they come.

    Attributes:
        time: (n,) strictly increasing [s].
        position: (n, joints).
        velocity: (n, joints) [rad/s].
        slides: Of each joint whether it is in metres; empty where that is not known.
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    slides: tuple[bool, ...] = ()

    @classmethod
    def from_positions(cls, joint_names: Sequence[str], time: FloatArray, position: FloatArray) -> RecordedMotion:
        """The motion through positions, from rest to rest.

        A row's velocity is that of the parabola through it and its neighbours; the first and last rows are at rest.

        Args:
            time: (n,) strictly increasing [s].
            position: (n, joints).

        Raises:
            InputError: One of them is no such list of finite numbers, or time does not increase.
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
    """Read a CSV of a motion, whoever wrote it.

    One header line; needed are `time_s` and a column `NAME_pos_rad` (`NAME_pos_m` where it slides) for each joint, in
    any order. Velocities are taken from columns `NAME_vel_rad_s` (`NAME_vel_m_s`) where every joint has one, else the
    motion is that through the positions from rest to rest
    (see `RecordedMotion.from_positions`). Other columns are ignored, so hplan's own files can be read.

    Raises:
        InputError: Missing file, missing or repeated columns, a cell that is no finite number, time that does not
            increase strictly; names the line.
    """
    file = CsvFile.read(path, "motion", "row")
    header = [name.strip() for name in file.header]
    joints, slides = joints_of_columns(header)
    if "time_s" not in header or not joints:
        names = f"NAME_{TURNING.columns[0]}, where it slides NAME_{SLIDING.columns[0]}"
        raise file.fault(1, f"expected a header with the columns time_s and, for each joint, {names}")
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise file.fault(1, f"column {twice[0]!r} is there twice")
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
