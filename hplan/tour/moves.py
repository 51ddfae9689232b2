"""Certified motions between stops, planned quickly at first, and joined where that is quicker than any one of them.

What a pair of trees finds between two stops is taken, however much longer it lasts than it has to; grids are searched
for those motions alone that a tour is to be made of. Motions that are there already are joined where no motion was
found, or where their sum is less: the arm then stops at stops that it does not pick from. A motion and its reverse take
the same time, so each is planned once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.planning.effort import CLOSE
from hplan.planning.failures import NO_MOTION, FailuresError
from hplan.planning.motion import Motion, last, seconds
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.planning.transits import straight_is_clear, transits
from hplan.robot.limits import Limits, rest_to_rest

#: A motion whose straight one is blocked is reckoned with so many times its least duration until trees look for it.
_BLOCKED: Final = 1.5

#: By less than this a joined motion is not quicker than another [s]; motions last whole periods.
_GAIN_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class Stop:
    """A configuration in which motions begin and end: at rest.

    Attributes:
        configuration: (dof,).
        fruit: The fruit that the last link is at; None elsewhere.
    """

    configuration: FloatArray
    fruit: str | None = None


#: Two stops, the lower number first, and whether the arm carries something between them.
_Key: TypeAlias = tuple[int, int, bool]


def _key(a: int, b: int, loaded: bool) -> _Key:
    return min(a, b), max(a, b), loaded


def _transit(task: PlanningTask, *, at_once: bool = False) -> Motion | None:
    """The motion that is found first, or the last and quickest one; None where there is none.

    Raises:
        HplanError: One of `NO_MOTION`.
    """
    with suppress(FailuresError):
        found = transits([task])
        return (next(found) if at_once else last(found))[1]
    return None


class _Joins(NamedTuple):
    """The quickest motions from stop to stop, over others where that is quicker.

    Attributes:
        stops: (n,) the stops that motions begin or end at.
        numbers: Which of them each stop is.
        seconds: (n, n) durations; infinite where there is no motion [s].
        before: (n, n) which of them comes last before the end.
    """

    stops: list[int]
    numbers: dict[int, int]
    seconds: FloatArray
    before: IntArray


class Moves:
    """Stops, and the motions between them.

    Attributes:
        stops: The stops, by their numbers.
        planned: How many motions between stops were planned, those among them that were not found.
    """

    def __init__(self, empty: PlanningContext, loaded: PlanningContext | None) -> None:
        """Begin without stops.

        Args:
            empty: The arm as it is, among its obstacles.
            loaded: The arm as it carries; None where nothing is carried.
        """
        self.stops: list[Stop] = []
        self.planned = 0
        self._contexts = (empty, empty if loaded is None else loaded)
        self._carries = loaded is not None
        self._hub = 0
        self._found: dict[_Key, Motion | None] = {}
        self._thorough: set[_Key] = set()
        self._blocked: set[_Key] = set()
        self._joined: dict[bool, _Joins] = {}
        self._last_least = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
        robot = empty.robot
        limits = Limits(robot.velocity_limit, robot.acceleration_limit, jerk=robot.jerk_limit)
        limits = limits.scaled(empty.options.speed)
        self.limits = limits.velocity, limits.acceleration, limits.jerk

    def stop(self, stop: Stop) -> int:
        """The number of a stop, a new one unless there is the same already."""
        for number, other in enumerate(self.stops):
            if other.fruit == stop.fruit and np.array_equal(other.configuration, stop.configuration):
                return number
        return self.add(stop)

    def add(self, stop: Stop) -> int:
        """The number of a new stop."""
        self.stops.append(stop)
        return len(self.stops) - 1

    def drop_at(self, hub: int) -> None:
        """Say at which stop what is carried is let go: there loaded motions end."""
        self._hub = hub

    def keep(self, a: int, b: int, loaded: bool, motion: Motion) -> None:
        """Keep a motion that is there."""
        self._found[_key(a, b, loaded)] = motion if a < b else motion.reversed
        self._joined.clear()

    def is_known(self, a: int, b: int, loaded: bool) -> bool:
        """True if the motion was planned."""
        return a == b or _key(a, b, loaded) in self._found

    def look(self, a: int, b: int, loaded: bool) -> None:
        """Look for a motion: the straight one first, another one where that is looked for again.

        A motion whose straight one is blocked is reckoned with a longer duration than its bound.
        """
        key = _key(a, b, loaded)
        if self.is_known(a, b, loaded):
            return
        try:
            task = self.task(*key)
            if not task.problem.turns or task.problem.is_empty:
                self._plan(key, _transit(task))
            elif key in self._blocked or straight_is_clear(task):
                effort = replace(task.effort, trees=replace(task.effort.trees, pairs=1), exhaustive=False, floods=False)
                self._plan(key, _transit(replace(task, effort=effort), at_once=True))
            else:
                self._blocked.add(key)
        except NO_MOTION:
            self._plan(key, None)

    def take(self, a: int, b: int, loaded: bool) -> list[tuple[tuple[int, int], Motion]] | None:
        """The quickest motions that are there, with the stops that they are between; looked for if need be.

        None where there are none.
        """
        while not self.is_known(a, b, loaded):
            self.look(a, b, loaded)
        if a == b:
            return []
        joins = self._joins(loaded)
        i, j = joins.numbers[a], joins.numbers[b]
        if not math.isfinite(joins.seconds[i, j]):
            return None
        path = [b]
        while i != j:
            j = int(joins.before[i, j])
            path.append(joins.stops[j])
        return [((one, other), self._one(one, other, loaded)) for one, other in pairwise(path[::-1])]

    def made_quicker(self, a: int, b: int, loaded: bool) -> bool:
        """True if a thorough search, done once where it may pay, gives quicker motions than there are."""
        key, taken = _key(a, b, loaded), self.take(a, b, loaded)
        duration_s = math.inf if taken is None else seconds([motion for _, motion in taken])
        if key in self._thorough or duration_s <= CLOSE * self._least([a, b])[0, 1]:
            return False
        self._thorough.add(key)
        before = self._found[key]
        with suppress(*NO_MOTION):
            self._plan(key, _transit(self.task(*key)))
        found = self._found[key]
        if found is not None and found.trajectory.duration < duration_s - _GAIN_S:
            return True
        self._found[key] = before
        return False

    def seconds(self, stops: IntArray, loaded: bool) -> FloatArray:
        """(k, k) durations between k stops: true ones where motions were planned, else what none can undercut [s]."""
        if not np.array_equal(self._last_least[0], stops):
            self._last_least = stops, self._least(stops)
        least, joins = self._last_least[1], self._joins(loaded)
        seconds = least.copy()
        places: dict[int, list[int]] = {}
        for place, stop in enumerate(stops.tolist()):
            places.setdefault(stop, []).append(place)
        for a, b, also in (*self._blocked, *self._found):
            if also != loaded:
                continue
            for i, j in itertools.product(places.get(a, ()), places.get(b, ())):
                if (a, b, also) in self._found:
                    seconds[i, j] = seconds[j, i] = joins.seconds[joins.numbers[a], joins.numbers[b]]
                else:
                    seconds[i, j] = seconds[j, i] = _BLOCKED * least[i, j]
        return seconds

    def _least(self, stops: IntArray | Sequence[int]) -> FloatArray:
        """(k, k) durations that no motion between k stops can undercut [s]."""
        there = np.array([self.stops[stop].configuration for stop in stops])
        least: FloatArray = rest_to_rest(np.abs(there[:, None] - there), *self.limits).max(axis=2)
        return least

    def task(self, a: int, b: int, loaded: bool) -> PlanningTask:
        """The motion to plan between two stops."""
        ends, context = (self.stops[a], self.stops[b]), self._contexts[loaded]
        for name in {end.fruit: None for end in ends if end.fruit is not None}:
            context = context.among(context.world.touching(name))  # at a fruit the last link may touch it
        return context.task(*(end.configuration for end in ends))

    def _plan(self, key: _Key, found: Motion | None) -> None:
        """Keep what was found of a motion."""
        self.planned += 1
        self._found[key] = found
        self._joined.clear()

    def _one(self, a: int, b: int, loaded: bool) -> Motion:
        """The quicker of the direct motions that are there: the empty arm may move as if it carried."""
        both = [self._found.get(_key(a, b, also)) for also in (loaded, loaded or self._carries)]
        there = min((one for one in both if one is not None), key=lambda one: one.trajectory.duration)
        return there if a < b else there.reversed

    def _joins(self, loaded: bool) -> _Joins:
        """The quickest motions over other stops, those of the empty arm or of the loaded one."""
        if loaded not in self._joined:
            self._joined[loaded] = self._all_joins(loaded)
        return self._joined[loaded]

    def _all_joins(self, loaded: bool) -> _Joins:
        stops = sorted({stop for a, b, _ in self._found for stop in (a, b)})
        numbers = {stop: number for number, stop in enumerate(stops)}
        seconds = np.full((len(stops), len(stops)), math.inf)
        np.fill_diagonal(seconds, 0.0)
        before = np.repeat(np.arange(len(stops))[:, None], len(stops), axis=1)
        for (a, b, also), motion in self._found.items():
            if motion is not None and (also or not loaded):
                i, j = numbers[a], numbers[b]
                seconds[i, j] = seconds[j, i] = min(seconds[i, j], motion.trajectory.duration)
        for number, stop in enumerate(stops):
            if self.stops[stop].fruit is not None or (loaded and stop == self._hub):
                continue  # the fruit would be touched, what is carried dropped
            over = seconds[:, number, None] + seconds[number]
            better = over < seconds - _GAIN_S
            seconds = np.where(better, over, seconds)
            before = np.where(better, before[number], before)
        return _Joins(stops, numbers, seconds, before)
