"""Certified motions between stops, planned lazily, and concatenated if that is quicker.

If the straight motion is blocked, the tour first uses an estimate of its duration, then the duration of the path found
by a pair of trees. The motion near that path is planned only if a candidate tour uses it, and is accepted even if it is
much longer than its lower bound. Grids are searched only for the motions of a candidate tour. Existing motions are
concatenated if no direct motion was found, or if their sum is shorter: the arm then stops at intermediate stops without
picking. A motion and its reverse take the same time, so each is planned once.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.planning.effort import CLOSE, NO_TREES
from hplan.planning.failures import NO_MOTION, FailuresError
from hplan.planning.motion import Motion, best_of, seconds
from hplan.planning.path_finder import Path, is_straight_clear, path_time, shortened, tree_paths
from hplan.planning.problem import Problem
from hplan.planning.solver import motion_near, motions, searches_first
from hplan.robot.limits import Limits, rest_to_rest
from hplan.scene.model import Fruit
from hplan.tour.joins import GAIN_S, Joins

#: Number of rows of the bounds matrix computed at a time.
_ROWS: Final = 64


@dataclass(frozen=True, eq=False)
class Stop:
    """A configuration at rest, at the start or end of a motion.

    Attributes:
        configuration: (dof,).
        fruit: The fruit at the last link; None without a fruit.
    """

    configuration: FloatArray
    fruit: Fruit | None = None


#: Two stops, the lower number first, and whether the arm is loaded between them.
_Key: TypeAlias = tuple[int, int, bool]


def _key(a: int, b: int, loaded: bool) -> _Key:
    return min(a, b), max(a, b), loaded


def _transit(problem: Problem, *, at_once: bool = False) -> Motion | None:
    """Return the first motion found, or the quickest; None without one.

    Raises:
        HplanError: One of `NO_MOTION`.
    """
    with suppress(FailuresError):
        found = motions(problem)
        return (next(found) if at_once else best_of(found))[1]
    return None


class Moves:
    """Stops, and the motions between them.

    Attributes:
        stops: The stops, by their numbers.
        planned: Number of motions planned between stops, failed attempts included.
    """

    def __init__(self, empty: Problem, loaded: Problem | None) -> None:
        """Start without stops.

        Args:
            empty: The unloaded arm among its obstacles.
            loaded: The loaded arm; None if it never carries anything.
        """
        self.stops: list[Stop] = []
        self.planned = 0
        self._contexts = (empty, empty if loaded is None else loaded)
        self._carries = loaded is not None
        self._hub = 0
        self._found: dict[_Key, Motion | None] = {}
        self._thorough: set[_Key] = set()
        self._blocked: set[_Key] = set()
        self._joins = {carries: Joins(partial(self._may_pass, carries)) for carries in (False, True)}
        self._routes: dict[_Key, list[Path]] = {}
        # Flat lists of stop pairs: pairs with planned motions, and pairs with estimates only; the last estimate of
        # a pair is the best.
        self._looked = {carries: array("q") for carries in (False, True)}
        self._estimated = {carries: (array("q"), array("d")) for carries in (False, True)}
        self._last_least = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
        robot = empty.robot
        limits = Limits(robot.velocity_limit, robot.acceleration_limit, jerk=robot.jerk_limit)
        limits = limits.scaled(empty.options.speed)
        self.limits = limits.velocity, limits.acceleration, limits.jerk

    def stop(self, stop: Stop) -> int:
        """Return the number of a stop; an equal stop keeps its number."""
        for number, other in enumerate(self.stops):
            if other.fruit == stop.fruit and np.array_equal(other.configuration, stop.configuration):
                return number
        return self.add(stop)

    def add(self, stop: Stop) -> int:
        """Add a stop and return its number."""
        self.stops.append(stop)
        return len(self.stops) - 1

    def drop_at(self, hub: int) -> None:
        """Set the drop-off stop, the end of loaded motions."""
        self._hub = hub

    def keep(self, a: int, b: int, loaded: bool, motion: Motion) -> None:
        """Store an existing motion."""
        self._take(_key(a, b, loaded), motion if a < b else motion.reversed)

    def is_known(self, a: int, b: int, loaded: bool) -> bool:
        """True if the motion was planned."""
        return a == b or _key(a, b, loaded) in self._found

    def look(self, a: int, b: int, loaded: bool) -> None:
        """Refine the known duration of a motion by one step.

        If the straight motion is blocked, the first call stores an estimate, the second one the duration of a tree
        path, and the third one plans the motion near that path.
        """
        key = _key(a, b, loaded)
        if self.is_known(a, b, loaded):
            return
        try:
            problem = self.problem(*key)
            if problem.is_empty or searches_first(problem):
                self._plan(key, _transit(problem))
            elif key in self._routes:
                self._plan(key, motion_near(problem, self._routes.pop(key)))
            elif key in self._blocked:
                routes = tree_paths(problem, replace(problem.effort.trees, pairs=1))
                least_s = [path_time(shortened(problem, path), problem.robot.velocity_limit) for path in routes]
                if least_s and least_s[0] < self._joins[loaded].between(a, b):
                    self._routes[key] = routes
                    # A motion near a tree path takes about this multiple of the path's duration at the velocity limits.
                    self._estimate(key, 1.2 * least_s[0])
                else:
                    self._plan(key, None)
            elif is_straight_clear(problem):
                trees = replace(problem.effort.trees, pairs=1)
                effort = replace(problem.effort, trees=trees, long=NO_TREES, proof_nodes=0.0)
                self._plan(key, _transit(replace(problem, effort=effort), at_once=True))
            else:
                self._block(key)
        except NO_MOTION:
            self._plan(key, None)

    def take(self, a: int, b: int, loaded: bool) -> list[tuple[tuple[int, int], Motion]] | None:
        """Return the quickest known motions between two stops, planned if necessary.

        Each motion comes with its pair of stops. The result is None if no motions connect the stops.
        """
        while not self.is_known(a, b, loaded):
            self.look(a, b, loaded)
        if a == b:
            return []
        way = self._joins[loaded].way(a, b)
        return None if way is None else [((one, other), self._one(one, other, loaded)) for one, other in pairwise(way)]

    def made_quicker(self, a: int, b: int, loaded: bool) -> bool:
        """Search thoroughly, once and if promising; True if that yields quicker motions."""
        key, taken = _key(a, b, loaded), self.take(a, b, loaded)
        duration_s = math.inf if taken is None else seconds([motion for _, motion in taken])
        if key in self._thorough or duration_s <= CLOSE * self.least([a, b])[0, 1]:
            return False
        self._thorough.add(key)
        with suppress(*NO_MOTION):
            found = _transit(self.problem(*key))
            if found is not None and found.trajectory.duration < duration_s - GAIN_S:
                self._plan(key, found)
                return True
        self.planned += 1
        return False

    def seconds(self, stops: IntArray, loaded: bool) -> FloatArray:
        """Return (k, k) durations of motions between k stops [s].

        They are exact for planned motions, otherwise estimates or lower bounds.
        """
        if not np.array_equal(self._last_least[0], stops):
            self._last_least = stops, self.least(stops)
        least = self._last_least[1]
        seconds = least.copy()
        places: dict[int, list[int]] = {}
        for place, stop in enumerate(stops.tolist()):
            places.setdefault(stop, []).append(place)
        first = np.full(len(self.stops), -1)
        first[list(places)] = [same[0] for same in places.values()]
        pairs, estimates = self._estimated[loaded]
        for ends, known in ((pairs, np.array(estimates)), (self._looked[loaded], None)):
            stops_of = np.array(ends, dtype=np.int64).reshape(-1, 2)
            i, j = first[stops_of].T
            here = (i >= 0) & (j >= 0)
            joined = self._joins[loaded].seconds(*stops_of[here].T)
            times = joined if known is None else np.minimum(joined, np.maximum(known[here], least[i[here], j[here]]))
            seconds[i[here], j[here]] = seconds[j[here], i[here]] = times
        for same in places.values():
            for other in same[1:]:
                seconds[other], seconds[:, other] = seconds[same[0]], seconds[:, same[0]]
        return seconds

    def least(self, stops: IntArray | Sequence[int]) -> FloatArray:
        """(k, k) lower bounds on durations between k stops [s]."""
        there = np.array([self.stops[stop].configuration for stop in stops])
        least = np.empty((len(there), len(there)))
        for begin in range(0, len(there), _ROWS):
            rows = slice(begin, begin + _ROWS)
            least[rows] = rest_to_rest(np.abs(there[rows, None] - there), *self.limits).max(axis=2)
        return least

    def problem(self, a: int, b: int, loaded: bool) -> Problem:
        """Return the planning problem of the motion between two stops."""
        ends, problem = (self.stops[a], self.stops[b]), self._contexts[loaded]
        for fruit in {end.fruit.name: end.fruit for end in ends if end.fruit is not None}.values():
            # The last link may touch the fruit at its stop.
            problem = problem.among(problem.world.touching(fruit.name, fruit.hangs_from))
        return problem.between(*(end.configuration for end in ends))

    def _plan(self, key: _Key, found: Motion | None) -> None:
        """Count and store the result of planning a motion."""
        self.planned += 1
        self._take(key, found)

    def _take(self, key: _Key, found: Motion | None) -> None:
        """Store a motion, or None, and update the concatenations."""
        self._found[key] = found
        a, b, loaded = key
        self._looked[loaded].extend((a, b))
        for carries in (False, True) if loaded else (False,):
            self._joins[carries].add(a, b, math.inf if found is None else found.trajectory.duration)

    def _block(self, key: _Key) -> None:
        """Record that the straight motion is blocked."""
        self._blocked.add(key)
        # Provisional estimate until a tree search.
        self._estimate(key, 1.5 * self.least(key[:2])[0, 1])

    def _estimate(self, key: _Key, seconds: float) -> None:
        """Store a duration estimate for an unplanned motion [s]."""
        pairs, estimates = self._estimated[key[2]]
        pairs.extend(key[:2])
        estimates.append(seconds)

    def _may_pass(self, loaded: bool, stop: int) -> bool:
        """True if the arm may stop here in transit.

        It must neither touch a fruit nor release its load.
        """
        return self.stops[stop].fruit is None and not (loaded and stop == self._hub)

    def _one(self, a: int, b: int, loaded: bool) -> Motion:
        """Return the quickest known direct motion.

        An unloaded arm may use a motion planned for the loaded arm.
        """
        both = [self._found.get(_key(a, b, also)) for also in (loaded, loaded or self._carries)]
        there = min((one for one in both if one is not None), key=lambda one: one.trajectory.duration)
        return there if a < b else there.reversed
