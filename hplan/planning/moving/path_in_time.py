"""Clear cells of a motion's path and time, by compiled distances.

A cell is the segment of the motion that takes `_STATION_S` at full speed, during a time interval of one step plus an
allowance for timing errors on both sides. It is clear if the arm at its middle is farther from all moving obstacles
than arm and obstacles travel within the cell. Its interval is halved until that is decided or obstacles travel less
than `_RESOLUTION_M`; then its segment is checked in `_PARTS` parts. Static obstacles are not checked.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, IntArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.giving_way import LinkedSolids
from hplan.collision.moving_solids import largest_rates
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas, growths, posed
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement
from hplan.trajectory.trajectory import Trajectory

#: Time from station to station at full speed [s].
_STATION_S: Final = 0.00625

#: Intervals in which obstacles travel no farther than this to either side are not halved again [m].
_RESOLUTION_M: Final = 8e-3

#: Number of parts of a cell's segment in the final check.
_PARTS: Final = 8


class MovingField:
    """Distances from the moving obstacles of a scene, by time.

    Attributes:
        at_rest_s: Time after which nothing moves [s].
    """

    def __init__(self, robot: Robot, scene: Scene, *, sigmas: Sigmas, tracking_error: float) -> None:
        """Collect the moving obstacles of a scene.

        Args:
            robot: The arm.
            scene: Obstacles and their tracks.
            sigmas: Growth of an uncertain obstacle, in standard deviations of its position.
            tracking_error: Tracking error of each joint at rest [rad].
        """
        listed = zip(scene.listed_solids, scene.movements, strict=True)
        moving = [(solid, how) for solid, how in listed if how is not None]
        growth = growths([solid for solid, _ in moving], sigmas)
        solids = [solid for solid, _ in moving]
        self._linked = LinkedSolids.of(robot, solids, scene.clearance + growth, scene.yield_links, growth)
        movements = {solid.name: how for solid, how in moving}
        self._moving: list[tuple[Solid, Movement]] = [(solid, movements[solid.name]) for solid in self._linked.solids]
        self._robot, self._deviation = robot, tracking_error
        self._rates = [(how.breaks, how.rates(solid.core, solid.rounding)) for solid, how in self._moving]
        self.at_rest_s = scene.at_rest_s

    def at(self, time_s: float) -> ClearanceField:
        """The field at a time [s]; without the arm's own pairs."""
        clock = np.array([time_s])
        poses = {id(how): tuple(part[0] for part in how.at(clock)) for _, how in self._moving}
        solids = tuple(posed(solid, *poses[id(how)]) for solid, how in self._moving)
        field = replace(self._linked, solids=solids).field(self._robot, deviation=self._deviation)
        return field.only(np.ones(len(solids), dtype=np.bool_), arm=False)

    def travel(self, from_s: float, to_s: float) -> float:
        """Maximum travel of the moving obstacles within an interval [m]."""
        clock = np.array([from_s, to_s])
        return (to_s - from_s) * max(float(largest_rates(*rates, clock)[0]) for rates in self._rates)


class PathInTime:
    """Cells of a motion's path and of time.

    Attributes:
        configurations: (n, dof) configurations at the stations of the motion [rad].
        step_s: Time between rows of cells [s].
        at_rest_s: Time after which all rows are alike [s].
    """

    def __init__(self, motion: Trajectory, field: MovingField, *, step_s: float, spare_s: float) -> None:
        """Prepare the stations; cells are computed on demand.

        Args:
            motion: The motion at full speed.
            field: The moving obstacles.
            step_s: Time between rows of cells [s].
            spare_s: Allowed deviation from the schedule, earlier or later [s].
        """
        count = max(1, math.ceil(motion.duration / _STATION_S))
        self.configurations = np.ascontiguousarray(motion.positions(np.linspace(0.0, motion.duration, count + 1)))
        self._motion, self._spacing_s = motion, motion.duration / count
        self.step_s, self.at_rest_s = step_s, field.at_rest_s
        self._field, self._half = field, 0.5 * step_s + spare_s
        turns = np.diff(self.configurations, axis=0)
        bounds = np.abs(turns) @ field.at(0.0).reaches.T
        self._travel = 0.5 * np.maximum(np.vstack([bounds[:1], bounds]), np.vstack([bounds, bounds[-1:]]))
        self._last: tuple[int, BoolArray] | None = None

    def clear(self, row: int) -> BoolArray:
        """(n,) mask of the clear stations in a row of cells."""
        last_row = math.ceil((self.at_rest_s + self._half) / self.step_s) + 1
        row = min(row, last_row)
        if self._last is None or self._last[0] != row:
            time_s = row * self.step_s
            begin_s, end_s = max(0.0, time_s - self._half), time_s + self._half
            self._last = row, self._clear(np.arange(len(self.configurations)), begin_s, end_s)
        return self._last[1]

    def _clear(self, stations: IntArray, begin_s: float, end_s: float) -> BoolArray:
        """Mask of the given stations that are clear within a time interval."""
        travel = 0.5 * self._field.travel(begin_s, end_s)
        middle_s = 0.5 * (begin_s + end_s)
        field = self._field.at(middle_s)
        # Clearance required beyond the scene's own [m]: less than the margin of planned paths.
        margin_m = 2e-4
        spare = field.along(self.configurations[stations]) - margin_m
        clear: BoolArray = np.all(spare - self._travel[stations] > travel, axis=1)
        undecided = np.flatnonzero(~clear & np.all(spare > 0.0, axis=1))
        if len(undecided) == 0:
            return clear
        rest = stations[undecided]
        if travel > _RESOLUTION_M:
            first = self._clear(rest, begin_s, middle_s)
            first[first] = self._clear(rest[first], middle_s, end_s)
            clear[undecided] = first
            return clear
        parts = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        places = np.clip(rest[:, None] + parts, 0.0, len(self.configurations) - 1.0) * self._spacing_s
        spare = field.along(self._motion.positions(places.ravel())) - margin_m
        spare -= np.repeat(self._travel[rest], _PARTS, axis=0) / _PARTS
        clear[undecided] = np.all(spare.reshape(len(rest), -1) > travel, axis=1)
        return clear
