r"""The earliest time scaling of a motion past moving obstacles.

It passes through clear cells of path and time.

A cell is the segment of the motion that takes `_STATION_S` at full speed, a station, during a time interval of one step
plus an allowance for timing errors on both sides. It is clear if the arm at its middle is farther from all moving
obstacles than arm and obstacles travel within the cell. Its interval is halved until that is decided or obstacles
travel less than `_RESOLUTION_M`; then its segment is checked in `_PARTS_OF_CELL` parts. Static obstacles are not
checked, and nothing here is a proof: the certificate is.

A motion is run with its own clock :math:`\sigma(t)`. The speed :math:`r =
\dot\sigma \in [0, 1]` of the clock is a multiple of :math:`1 / m` at times that are one step :math:`h` apart, and
linear between them. Places :math:`\sigma` are then multiples of :math:`h / 2m`, so that nothing is rounded. A change of
speed is allowed if acceleration and torque stay within limits: with :math:`q(\sigma)` the motion,

.. math:: \ddot q = q'' r^2 + q' \dot r, \qquad \tau = r^2 (\tau_1 - g) + g + \dot r M q',

where :math:`\tau_1` is the torque at full speed and :math:`g` the torque of gravity. A motion from rest may start at
any speed, since its velocity is zero there. The search expands all successors of all states reachable at a time; the
first time when they include the end is the earliest. Among the schedules to it one with the fewest changes of speed is
returned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
from hplan.collision.coal_moving_solids import largest_interval_rates
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compliant_solids import LinkedSolids
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas, growths, transform_solid
from hplan.scene.obstacles import Solid
from hplan.scene.tracks import Movement
from hplan.trajectory.trajectory import Trajectory

#: Time from station to station at full speed [s].
_STATION_S: Final = 0.00625

#: Intervals in which obstacles travel no farther than this to either side are not halved again [m].
_RESOLUTION_M: Final = 8e-3

#: Number of parts of a cell's segment in the final check.
_PARTS_OF_CELL: Final = 8


class MovingField:
    """Distances from the moving obstacles of a scene, by time.

    Attributes:
        at_rest_s: Time after which nothing moves [s].
        goal_rests_s: Time from which the goal fruit rests; -inf without one [s].
        known_until_s: Time until which all obstacles are predicted; inf if always [s].
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
        self._linked = LinkedSolids.build(robot, solids, scene.clearance + growth, scene.yield_links, growth)
        movements = {solid.name: how for solid, how in moving}
        self._moving: list[tuple[Solid, Movement]] = [(solid, movements[solid.name]) for solid in self._linked.solids]
        self._robot, self._deviation = robot, tracking_error
        self._rates = [(how.breaks, how.rates(solid.core, solid.rounding)) for solid, how in self._moving]
        self.at_rest_s = scene.at_rest_s
        self.known_until_s = min((how.known_until_s for _, how in moving), default=math.inf)
        self.goal_rests_s = (scene.resting_goal_fruit or (None, -math.inf))[1]
        # The goal fruit is an obstacle of the path once it rests.
        ends = (self.goal_rests_s if solid.name == scene.goal.fruit else math.inf for solid, _ in self._moving)
        self._until_s = np.array(list(ends))

    def field_at(self, time_s: float, from_s: float | None = None) -> ClearanceField:
        """The field at a time [s]; without the arm's own pairs.

        Args:
            from_s: Start of the interval that the field is for; None for `time_s` [s].
        """
        clock = np.array([time_s])
        poses = {id(how): tuple(part[0] for part in how.displacement_at(clock)) for _, how in self._moving}
        solids = tuple(transform_solid(solid, *poses[id(how)]) for solid, how in self._moving)
        growth = self._linked.growth + [how.spread_at(clock)[0] for _, how in self._moving]
        field = replace(self._linked, solids=solids, growth=growth).field(self._robot, deviation=self._deviation)
        return field.select((time_s if from_s is None else from_s) < self._until_s, arm=False)

    def travel(self, from_s: float, to_s: float) -> float:
        """Maximum travel of the moving obstacles within an interval [m]."""
        clock = np.array([from_s, to_s])
        return (to_s - from_s) * max(
            (float(largest_interval_rates(*rates, clock)[0]) for rates in self._rates), default=0.0
        )


class PathInTime:
    """Cells of a motion's path and of time.

    Attributes:
        configurations: (n, dof) configurations at the stations of the motion [rad].
        step_s: Time between rows of cells [s].
        at_rest_s: Time after which all rows are alike [s].
    """

    def __init__(
        self, motion: Trajectory, field: MovingField, *, step_s: float, spare_s: float, grasp_s: float = math.inf
    ) -> None:
        """Prepare the stations; cells are computed on demand.

        Args:
            motion: The motion at full speed.
            field: The moving obstacles.
            step_s: Time between rows of cells [s].
            spare_s: Allowed deviation from the schedule, earlier or later [s].
            grasp_s: Time of the grasp in the motion; later stations are not clear before the goal fruit rests [s].
        """
        count = max(1, math.ceil(motion.duration / _STATION_S))
        self.configurations = np.ascontiguousarray(motion.positions(np.linspace(0.0, motion.duration, count + 1)))
        self._motion, self._spacing_s = motion, motion.duration / count
        self.step_s, self.at_rest_s = step_s, field.at_rest_s
        self._field, self._half = field, 0.5 * step_s + spare_s
        self._is_before_grasp = np.arange(count + 1) < math.floor(min(grasp_s / self._spacing_s, count + 1.0))
        turns = np.diff(self.configurations, axis=0)
        bounds = np.abs(turns) @ field.field_at(0.0).reaches.T
        self._travel = 0.5 * np.maximum(np.vstack([bounds[:1], bounds]), np.vstack([bounds, bounds[-1:]]))
        self._last: tuple[int, BoolArray] | None = None

    def clear(self, row: int) -> BoolArray:
        """(n,) mask of the clear stations in a row of cells."""
        last_row = math.ceil((self.at_rest_s + self._half) / self.step_s) + 1
        row = min(row, last_row)
        if self._last is None or self._last[0] != row:
            time_s = row * self.step_s
            begin_s, end_s = max(0.0, time_s - self._half), time_s + self._half
            stations, is_known = np.arange(len(self.configurations)), end_s <= self._field.known_until_s
            clear = self._clear(stations, begin_s, end_s) if is_known else np.zeros(len(stations), dtype=np.bool_)
            self._last = row, clear if begin_s >= self._field.goal_rests_s else clear & self._is_before_grasp
        return self._last[1]

    def _clear(self, stations: IntArray, begin_s: float, end_s: float) -> BoolArray:
        """Mask of the given stations that are clear within a time interval."""
        travel = 0.5 * self._field.travel(begin_s, end_s)
        middle_s = 0.5 * (begin_s + end_s)
        field = self._field.field_at(middle_s, begin_s)
        # Clearance required beyond the scene's own [m]: less than the margin of planned paths.
        margin_m = 2e-4
        spare = field.clearance_along(self.configurations[stations]) - margin_m
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
        parts = (np.arange(_PARTS_OF_CELL) + 0.5) / _PARTS_OF_CELL - 0.5
        places = np.clip(rest[:, None] + parts, 0.0, len(self.configurations) - 1.0) * self._spacing_s
        spare = field.clearance_along(self._motion.positions(places.ravel())) - margin_m
        spare -= np.repeat(self._travel[rest], _PARTS_OF_CELL, axis=0) / _PARTS_OF_CELL
        clear[undecided] = np.all(spare.reshape(len(rest), -1) > travel, axis=1)
        return clear


#: Time between choices of the speed [s], the number of speeds above 0, and the maximum change of speed per step.
STEP_S: Final = 0.05
LEVELS: Final = 16
CHANGES: Final = 2

#: Fraction of acceleration and torque limits that a change of speed may use.
USED: Final = 0.98

#: Maximum duration of a schedule [s].
_LONGEST_SCHEDULE_S: Final = 120.0

_NONE: Final = 1 << 30


@dataclass(frozen=True, eq=False)
class Schedule(Record):
    """A schedule: places along a path over time.

    Attributes:
        time: (n,) times [s].
        place: (n,) time of the original motion at them [s].
        speed: (n,) speed as a fraction of the original one.
    """

    time: FloatArray
    place: FloatArray
    speed: FloatArray

    @property
    def waiting_s(self) -> float:
        """Total waiting time [s]."""
        return float(np.diff(self.time)[np.diff(self.place) == 0.0].sum())

    @property
    def slows_down(self) -> bool:
        """True if it runs slowly, but does not wait, at some time."""
        between = (self.place[:-1] > 0.0) & (np.diff(self.place) > 0.0)
        return bool((between & (self.speed[:-1] < 1.0)).any())

    @property
    def profile(self) -> FloatArray:
        """(k, 2) rows of time and speed factor, as in `hplan.trajectory.trajectory.scale_motion`."""
        rows: list[tuple[float, float]] = []
        for i, (time, speed) in enumerate(zip(self.time.tolist(), self.speed.tolist(), strict=True)):
            begins = i + 1 < len(self.time) and self.place[i] == 0.0 and speed == 0.0 and self.speed[i + 1] > 0.0
            rows.append((time, speed))
            if begins:  # from rest the speed may jump, at half of the step
                middle = 0.5 * (time + float(self.time[i + 1]))
                rows += [(middle, 0.0), (middle, float(self.speed[i + 1]))]
        time, speed = rows[-1]
        rows[-1] = time, max(speed, 1.0 / LEVELS)  # the final speed is positive, so that the motion ends
        return np.array(rows)


def room_to_change(motion: Trajectory, robot: Robot, stations: int) -> BoolArray:
    """Allowed changes of speed, (stations, levels + 1, 2 changes + 1).

    Entry [i, j, k] is True if the speed may change by k - changes levels from level j at station i within a step.

    Args:
        motion: The motion at full speed.
        robot: The arm, for its limits.
        stations: Number of stations, evenly spaced in the motion's own time.
    """
    clock = np.linspace(0.0, motion.duration, stations)
    row = np.clip(np.searchsorted(motion.time, clock), 0, motion.samples - 1)
    q, v, a = motion.position[row], motion.velocity[row], motion.acceleration[row]
    dynamics, still = robot.dynamics, np.zeros_like(q)
    gravity = dynamics.gravity(q)
    moved, inertial = motion.torque[row] - gravity, dynamics.torques(q, still, v) - gravity
    squares = (np.arange(LEVELS + 1) / LEVELS)[None, :, None, None] ** 2
    rates = (np.arange(-CHANGES, CHANGES + 1) / (LEVELS * STEP_S))[None, None, :, None]
    accelerations = a[:, None, None] * squares + v[:, None, None] * rates
    torques = moved[:, None, None] * squares + gravity[:, None, None] + inertial[:, None, None] * rates
    torque_limit = np.maximum(USED * robot.torque_limit, np.abs(gravity[:, None, None]))
    kept: BoolArray = np.all(np.abs(accelerations) <= USED * robot.acceleration_limit, axis=3)
    kept &= np.all(np.abs(torques) <= torque_limit, axis=3)
    kept[:, :, CHANGES] = True  # without a change the motion is just slower
    return kept


def earliest_schedule(
    cells: PathInTime,
    duration_s: float,
    room: BoolArray,
    *,
    at_rest_s: float,
    at_rest: bool = True,
    quicker_than_s: float = math.inf,
) -> Schedule | None:
    """The earliest schedule of a whole path; None if infeasible.

    Args:
        cells: Clear stations, in rows `STEP_S` apart; the stations are evenly spaced in the motion's own time.
        duration_s: Duration of the motion at full speed [s].
        room: Allowed changes of speed (`room_to_change`), at the same stations.
        at_rest_s: Time after which all rows are alike [s].
        at_rest: True if the motion begins at rest.
        quicker_than_s: Maximum useful duration [s].
    """
    unit = STEP_S / (2.0 * LEVELS)
    places = max(1, math.ceil(duration_s / unit - 1e-9))
    stations = len(cells.configurations)
    along = np.minimum(np.arange(places + 1) * unit, duration_s) / max(duration_s, unit * 1e-9)  # 0 if empty
    station_of = np.rint(along * (stations - 1)).astype(np.int64)
    cost = np.full((places + 1, LEVELS + 1), _NONE, dtype=np.int64)
    if not cells.clear(0)[0]:
        return None
    # From rest the motion may wait; a start in motion continues at full speed.
    cost[0, 0 if at_rest else LEVELS] = 0
    came: list[NDArray[np.int8]] = []
    rows = math.ceil(min(at_rest_s + 2.0 * duration_s + 2.0, quicker_than_s, _LONGEST_SCHEDULE_S) / STEP_S) + 1
    before = _count_blocked(cells.clear(0))
    for row in range(1, rows):
        check_deadline()
        after = _count_blocked(cells.clear(row))
        cost, back, end = _advance_clock(cost, before, after, room, station_of)
        came.append(back.astype(np.int8))  # there may be hundreds
        if end[0] < _NONE:
            return _trace_back(came, end, places, unit, duration_s)
        if not (cost < _NONE).any():
            return None
        before = after
    return None


def _count_blocked(clear: BoolArray) -> IntArray:
    """(n + 1,) number of obstructed stations before each station."""
    return np.concatenate([[0], np.cumsum(~clear)])


@kernel
def _advance_clock(
    cost: IntArray, before: IntArray, after: IntArray, room: BoolArray, station_of: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Advance all states by one step of time.

    Args:
        cost: (places + 1, levels + 1) minimum number of speed changes to each state.
        before: (stations + 1,) number of obstructed stations before each station in this row.
        after: (stations + 1,) the same number in the next row.
        room: Allowed changes of speed, as returned by `room_to_change`.
        station_of: (places + 1,) station of each place.

    Returns:
        The costs at the next row; for each state there the previous speed, -1 for none; and for the best path to the
        end its cost, previous place, previous speed, and speed.
    """
    places, levels = cost.shape[0] - 1, cost.shape[1] - 1
    changes = room.shape[2] // 2
    found, back = np.full(cost.shape, _NONE), np.full(cost.shape, -1)
    end = np.array([_NONE, 0, 0, 0])
    for place in range(places):
        for speed in range(levels + 1):
            now = cost[place, speed]
            if now >= _NONE:
                continue
            first, last = max(0, speed - changes), min(levels, speed + changes)
            begins = place == 0 and speed == 0
            if begins:
                last = levels
            for new in range(first, last + 1):
                if not begins and not room[station_of[place], speed, new - speed + changes]:
                    continue
                to = min(place + speed + new, places)
                if not begins and to < places and not room[station_of[to], new, new - speed + changes]:
                    continue
                middle = min(place + (3 * speed + new) // 4, places)
                a, b, c = station_of[place], station_of[middle], station_of[to]
                if before[b + 1] > before[a] or after[c + 1] > after[b]:
                    continue
                then = now + (1 if new != speed else 0)
                if to == places:
                    if then < end[0]:
                        end[0], end[1], end[2], end[3] = then, place, speed, new
                elif then < found[to, new]:
                    found[to, new], back[to, new] = then, speed
    return found, back, end


def _trace_back(came: list[NDArray[np.int8]], end: IntArray, places: int, unit: float, duration_s: float) -> Schedule:
    """The schedule, traced back from its end."""
    place, speed = int(end[1]), int(end[2])
    states = [(places, int(end[3])), (place, speed)]
    for back in reversed(came[:-1]):
        earlier = int(back[place, speed])
        place, speed = place - earlier - speed, earlier
        states.append((place, speed))
    states.reverse()
    found = np.array(states, dtype=np.float64)
    return Schedule(
        frozen(STEP_S * np.arange(len(states), dtype=np.float64)),
        frozen(np.minimum(unit * found[:, 0], duration_s)),
        frozen(found[:, 1] / LEVELS),
    )
