"""Speed factors of another timing (see `time_scaling`): as they are given, and the most a motion allows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from hplan.base.arguments import is_number, number
from hplan.base.arrays import FloatArray, numbers
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Speed factors over time: a number, (n, 2) rows of time and factor, or a function of the time.
Profile: TypeAlias = "float | Sequence[tuple[float, float]] | FloatArray | Callable[[float], float]"


def speed_factors(profile: Profile) -> tuple[Callable[[FloatArray], FloatArray], float, float]:
    """A profile as a function of (n,) times, and the time and the factor of its last row, infinite and NaN if none.

    Raises:
        OptionError: It is none.
    """
    expected = "a factor >= 0, (n, 2) rows of time and factor >= 0, or a function of the time that gives one"
    if is_number(profile):
        factor = number("profile", profile, "a factor > 0", lambda value: value > 0.0)
        return lambda clock: np.full(len(clock), factor), math.inf, math.nan
    if callable(profile):
        given = profile

        def called(clock: FloatArray) -> FloatArray:
            values = [given(time) for time in clock.tolist()]
            for time, value in zip(clock.tolist(), values, strict=True):
                if not (is_number(value) and value >= 0.0):
                    raise OptionError(f"profile({time:g})", value, "a finite factor >= 0")
            return np.array(values, dtype=np.float64)

        return called, math.inf, math.nan
    try:
        rows = numbers("profile", profile, (None, 2))
    except InputError as error:
        raise OptionError("profile", profile, expected) from error
    if len(rows) == 0 or not (np.diff(rows[:, 0]) >= 0.0).all() or (rows < 0.0).any():
        raise OptionError("profile", profile, f"{expected}; times must not decrease")
    return lambda clock: _between_rows(rows, clock), float(rows[-1, 0]), float(rows[-1, 1])


def _between_rows(rows: FloatArray, clock: FloatArray) -> FloatArray:
    """Factors at times, linear between rows; at a time given twice the later row counts."""
    at = np.searchsorted(rows[:, 0], clock, side="right")
    before, after = rows[np.maximum(at - 1, 0)], rows[np.minimum(at, len(rows) - 1)]
    width = after[:, 0] - before[:, 0]
    part = np.where(width > 0.0, (clock - before[:, 0]) / np.where(width > 0.0, width, 1.0), 0.0)
    values: FloatArray = before[:, 1] + np.clip(part, 0.0, 1.0) * (after[:, 1] - before[:, 1])
    return values


def check_factors(trajectory: Trajectory, robot: Robot, factor: float) -> None:
    """Refuse a factor above 1 that the motion as a whole has no room for.

    Raises:
        OptionError: It has none; names the joint and its limit.
    """
    if factor <= 1.0:
        return
    gravity = robot.dynamics.gravity(trajectory.position)
    moved = trajectory.torque - gravity
    with np.errstate(divide="ignore", invalid="ignore"):
        most = {
            "velocity": robot.velocity_limit / np.abs(trajectory.velocity).max(axis=0),
            "acceleration": np.sqrt(robot.acceleration_limit / np.abs(trajectory.acceleration).max(axis=0)),
            "torque": np.sqrt(
                np.where(moved != 0.0, (robot.torque_limit - np.sign(moved) * gravity) / np.abs(moved), np.inf)
                .clip(min=0.0)
                .min(axis=0)
            ),
        }
    if robot.jerk_limit is not None:
        jerk = np.abs(np.diff(trajectory.acceleration, axis=0) / np.diff(trajectory.time)[:, None]).max(axis=0)
        with np.errstate(divide="ignore"):
            most["jerk"] = np.cbrt(robot.jerk_limit / jerk)
    what = min(most, key=lambda name: float(most[name].min()))
    joint = int(most[what].argmin())
    allowed = max(1.0, float(most[what][joint]))
    if factor > allowed * (1.0 + 1e-9):
        raise OptionError(
            "profile", factor,
            f"factors up to {allowed:.4g}: joint {robot.joint_names[joint]!r} is at its {what} limit then",
        )  # fmt: skip
