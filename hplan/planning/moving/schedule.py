r"""The earliest time scaling of a motion through clear cells.

A cell is a station of the path at a time. A motion is run with its own clock :math:`\sigma(t)`. The speed :math:`r =
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
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Time between choices of the speed [s], the number of speeds above 0, and the maximum change of speed per step.
STEP_S: Final = 0.05
LEVELS: Final = 16
CHANGES: Final = 2

#: Fraction of acceleration and torque limits that a change of speed may use.
USED: Final = 0.98

#: Maximum duration of a schedule [s].
_LONGEST_S: Final = 120.0

_NONE: Final = 1 << 30


class Cells(Protocol):
    """Clear stations of a path, row by row of time."""

    configurations: FloatArray

    def clear(self, row: int) -> BoolArray:
        """(n,) mask of the stations that are clear in a row."""


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
        """(k, 2) rows of time and speed factor, as in `hplan.trajectory.trajectory.scaled`."""
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
    cells: Cells,
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
    rows = math.ceil(min(at_rest_s + 2.0 * duration_s + 2.0, quicker_than_s, _LONGEST_S) / STEP_S) + 1
    before = _blocked(cells.clear(0))
    for row in range(1, rows):
        check_deadline()
        after = _blocked(cells.clear(row))
        cost, back, end = _advance(cost, before, after, room, station_of)
        came.append(back.astype(np.int8))  # there may be hundreds
        if end[0] < _NONE:
            return _traced(came, end, places, unit, duration_s)
        if not (cost < _NONE).any():
            return None
        before = after
    return None


def _blocked(clear: BoolArray) -> IntArray:
    """(n + 1,) number of obstructed stations before each station."""
    return np.concatenate([[0], np.cumsum(~clear)])


@kernel
def _advance(
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


def _traced(came: list[NDArray[np.int8]], end: IntArray, places: int, unit: float, duration_s: float) -> Schedule:
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
