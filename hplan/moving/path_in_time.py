"""When it is clear where on a motion's path: cells of path and time, by the compiled distances.

A cell is a part of the motion that takes `STATION_S` at full speed, at a time give or take half a step. It counts as
clear where the arm in its middle is farther from everything that moves than arm and obstacles travel within the cell,
and what is kept for a timing that is off. What stands still is not looked at.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import motion_bounds
from hplan.collision.moving_solids import largest_rates
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Solid
from hplan.scene.solids import posed
from hplan.scene.tracks import Movement
from hplan.timing.trajectory import Trajectory

#: Time that a motion takes from station to station at full speed [s].
STATION_S: Final = 0.00625

#: Clearance asked for beyond the one to keep [m].
MARGIN_M: Final = 1e-3


class MovingField:
    """Distances from what moves in a scene, by time.

    Attributes:
        at_rest_s: Time from which on nothing moves [s].
    """

    def __init__(self, robot: Robot, scene: Scene, *, sigmas: float, tracking_error: float) -> None:
        """Take what moves.

        Args:
            robot: The arm.
            scene: The scene.
            sigmas: How many standard deviations of its place an obstacle grows by.
            tracking_error: Deviation of any joint at rest that is to be allowed for [rad].
        """
        listed = zip(scene.listed_solids, scene.movements, strict=True)
        self._moving: list[tuple[Solid, Movement]] = [(solid, how) for solid, how in listed if how is not None]
        self._robot, self._deviation = robot, tracking_error
        self._growth = scene.clearance + np.array([sigmas * solid.sigma for solid, _ in self._moving])
        self._rates = [(how.breaks, how.rates(solid.core, solid.rounding)) for solid, how in self._moving]
        self.at_rest_s = scene.at_rest_s

    def at(self, time_s: float) -> ClearanceField:
        """The field as it is at a time [s]; the arm itself is not in it."""
        clock = np.array([time_s])
        poses = {id(how): tuple(part[0] for part in how.at(clock)) for _, how in self._moving}
        solids = [posed(solid, *poses[id(how)]) for solid, how in self._moving]
        field = ClearanceField.of(self._robot, solids, clearance=self._growth, deviation=self._deviation)
        return field.only(np.ones(len(solids), dtype=np.bool_), arm=False)

    def travel(self, from_s: float, to_s: float) -> float:
        """How far any point of what moves travels at most within an interval of time [m]."""
        clock = np.array([from_s, to_s])
        return (to_s - from_s) * max(float(largest_rates(*rates, clock)[0]) for rates in self._rates)


class PathInTime:
    """Cells of a motion's path and of time.

    Attributes:
        configurations: (n,) stations along the motion, (n, dof) [rad].
        step_s: Time between rows of cells [s].
        at_rest_s: Time from which on all rows are alike [s].
    """

    def __init__(self, motion: Trajectory, field: MovingField, robot: Robot, *, step_s: float, spare_s: float) -> None:
        """Look at nothing yet.

        Args:
            motion: The motion.
            field: What moves.
            robot: The arm.
            step_s: Time between rows of cells [s].
            spare_s: How much earlier or later than meant the arm may be anywhere [s].
        """
        count = max(1, math.ceil(motion.duration / STATION_S))
        self.configurations = np.ascontiguousarray(motion.positions(np.linspace(0.0, motion.duration, count + 1)))
        self.step_s, self.at_rest_s = step_s, field.at_rest_s
        self._field, self._half = field, 0.5 * step_s + spare_s
        turns = np.diff(self.configurations, axis=0)
        bounds = np.empty((count, robot.arm.link_count))
        empty = ClearanceField.of(robot, [])
        for turn, bound in zip(turns, bounds, strict=True):
            motion_bounds(turn, empty.chain, empty.base, bound)
        self._travel = 0.5 * np.maximum(np.vstack([bounds[:1], bounds]), np.vstack([bounds, bounds[-1:]]))
        self._last: tuple[int, BoolArray] | None = None

    def clear(self, row: int) -> BoolArray:
        """(n,) mask of the stations that are clear in a row of cells."""
        last_row = math.ceil((self.at_rest_s + self._half) / self.step_s) + 1
        row = min(row, last_row)
        if self._last is None or self._last[0] != row:
            time_s = row * self.step_s
            begin_s, end_s = max(0.0, time_s - self._half), time_s + self._half
            # Not before the begin: the first row is looked at where it begins.
            middle_s = 0.5 * (begin_s + end_s)
            needed = MARGIN_M + 0.5 * self._field.travel(begin_s, end_s)
            found = self._field.at(middle_s).along(self.configurations) - self._travel
            self._last = row, found.min(axis=1) > needed
        return self._last[1]
