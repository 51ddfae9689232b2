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
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Final, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.planning.effort import CLOSE
from hplan.planning.failures import NO_MOTION, FailuresError
from hplan.planning.motion import Motion, best_of, seconds
from hplan.planning.path_finder import Path, is_straight_clear, path_time, shorten_path, tree_paths
from hplan.planning.problem import Problem
from hplan.planning.solver import motion_near, motions, searches_grid_first
from hplan.robot.limits import Limits, rest_to_rest
from hplan.scene.fruit import Fruit

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
_MoveKey: TypeAlias = tuple[int, int, bool]


def _key(a: int, b: int, loaded: bool) -> _MoveKey:
    return min(a, b), max(a, b), loaded


def _first_transit(problem: Problem, *, at_once: bool = False) -> Motion | None:
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
        self._found: dict[_MoveKey, Motion | None] = {}
        self._thorough: set[_MoveKey] = set()
        self._blocked: set[_MoveKey] = set()
        self._joins = {carries: Joins(partial(self._may_pass, carries)) for carries in (False, True)}
        self._routes: dict[_MoveKey, list[Path]] = {}
        # Flat lists of stop pairs: pairs with planned motions, and pairs with estimates only; the last estimate of
        # a pair is the best.
        self._looked = {carries: array("q") for carries in (False, True)}
        self._estimated = {carries: (array("q"), array("d")) for carries in (False, True)}
        self._last_least = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
        robot = empty.robot
        limits = Limits(robot.velocity_limit, robot.acceleration_limit, jerk=robot.jerk_limit)
        limits = limits.scale(empty.options.speed)
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
        self._take(_key(a, b, loaded), motion if a < b else motion.reversal)

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
            if problem.is_empty or searches_grid_first(problem):
                self._plan(key, _first_transit(problem))
            elif key in self._routes:
                self._plan(key, motion_near(problem, self._routes.pop(key)))
            elif key in self._blocked:
                routes = tree_paths(problem, 1)
                least_s = [path_time(shorten_path(problem, path), problem.robot.velocity_limit) for path in routes]
                if least_s and least_s[0] < self._joins[loaded].duration_between(a, b):
                    self._routes[key] = routes
                    # A motion near a tree path takes about this multiple of the path's duration at the velocity limits.
                    self._estimate(key, 1.2 * least_s[0])
                else:
                    self._plan(key, None)
            elif is_straight_clear(problem):
                effort = replace(problem.effort, pairs=1, long_pairs=0, proof_nodes=0.0)
                self._plan(key, _first_transit(replace(problem, effort=effort), at_once=True))
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
        return (
            None
            if way is None
            else [((one, other), self._quickest_motion(one, other, loaded)) for one, other in pairwise(way)]
        )

    def made_quicker(self, a: int, b: int, loaded: bool) -> bool:
        """Search thoroughly, once and if promising; True if that yields quicker motions."""
        key, taken = _key(a, b, loaded), self.take(a, b, loaded)
        duration_s = math.inf if taken is None else seconds([motion for _, motion in taken])
        if key in self._thorough or duration_s <= CLOSE * self.minimum_durations([a, b])[0, 1]:
            return False
        self._thorough.add(key)
        with suppress(*NO_MOTION):
            found = _first_transit(self.problem(*key))
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
            self._last_least = stops, self.minimum_durations(stops)
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

    def minimum_durations(self, stops: IntArray | Sequence[int]) -> FloatArray:
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
            problem = problem.in_world(problem.world.allow_touch(fruit.name, fruit.hangs_from))
        return problem.from_configurations(*(end.configuration for end in ends))

    def _plan(self, key: _MoveKey, found: Motion | None) -> None:
        """Count and store the result of planning a motion."""
        self.planned += 1
        self._take(key, found)

    def _take(self, key: _MoveKey, found: Motion | None) -> None:
        """Store a motion, or None, and update the concatenations."""
        self._found[key] = found
        a, b, loaded = key
        self._looked[loaded].extend((a, b))
        for carries in (False, True) if loaded else (False,):
            self._joins[carries].add(a, b, math.inf if found is None else found.trajectory.duration)

    def _block(self, key: _MoveKey) -> None:
        """Record that the straight motion is blocked."""
        self._blocked.add(key)
        # Provisional estimate until a tree search.
        self._estimate(key, 1.5 * self.minimum_durations(key[:2])[0, 1])

    def _estimate(self, key: _MoveKey, seconds: float) -> None:
        """Store a duration estimate for an unplanned motion [s]."""
        pairs, estimates = self._estimated[key[2]]
        pairs.extend(key[:2])
        estimates.append(seconds)

    def _may_pass(self, loaded: bool, stop: int) -> bool:
        """True if the arm may stop here in transit.

        It must neither touch a fruit nor release its load.
        """
        return self.stops[stop].fruit is None and not (loaded and stop == self._hub)

    def _quickest_motion(self, a: int, b: int, loaded: bool) -> Motion:
        """Return the quickest known direct motion.

        An unloaded arm may use a motion planned for the loaded arm.
        """
        both = [self._found.get(_key(a, b, also)) for also in (loaded, loaded or self._carries)]
        there = min((one for one in both if one is not None), key=lambda one: one.trajectory.duration)
        return there if a < b else there.reversal


#: Minimum gain for a joined motion to replace another one [s]; durations are whole numbers of periods.
GAIN_S = 1e-6


class Joins:
    """Symmetric shortest connections from stop to stop."""

    def __init__(self, may_pass: Callable[[int], bool]) -> None:
        """Start without motions.

        Args:
            may_pass: Whether the arm may pause at a stop on its way to another.
        """
        self._may_pass = may_pass
        self._stops: list[int] = []
        self._place = np.full(0, -1)  # index of each stop in `_stops`
        self._passes = np.zeros(0, dtype=np.bool_)
        # Durations from stop to stop and the last stop but one, with spare capacity.
        self._seconds, self._before = np.zeros((0, 0)), np.zeros((0, 0), dtype=np.int32)

    def add(self, a: int, b: int, seconds: float) -> None:
        """Add a motion between two stops.

        Args:
            a: First stop.
            b: Second stop.
            seconds: Duration of the motion; infinite if there is no motion [s].
        """
        i, j = self._place_of(a), self._place_of(b)
        if math.isinf(seconds):
            return
        for start, end in ((i, j), (j, i)):
            count = len(self._stops)
            ways, before = self._seconds[:count, :count], self._before[:count, :count]
            there = np.where(self._passes[start] | (np.arange(count) == start), ways[:, start], math.inf)
            onward = np.where(self._passes[end] | (np.arange(count) == end), ways[end], math.inf)
            over = there[:, None] + (seconds + onward)
            last = np.where(np.arange(count) == end, start, before[end])
            better = over < ways - GAIN_S
            np.copyto(ways, over, where=better)
            np.copyto(before, np.broadcast_to(last, before.shape), where=better)

    def seconds(self, a: IntArray, b: IntArray) -> FloatArray:
        """(k,) durations between stops [s]; infinite without a connection."""
        longest = int(max(a.max(initial=-1), b.max(initial=-1)))
        place = np.append(self._place, np.full(max(0, longest + 1 - len(self._place)), -1))
        i, j = place[a], place[b]
        found = np.full(len(a), math.inf)
        here = (i >= 0) & (j >= 0)
        found[here] = self._seconds[i[here], j[here]]
        return found

    def duration_between(self, a: int, b: int) -> float:
        """Duration between two stops [s]; infinite without a connection."""
        return float(self.seconds(np.array([a]), np.array([b]))[0])

    def way(self, a: int, b: int) -> list[int] | None:
        """Stops of the fastest connection between two stops; None without a connection.

        Examples:
            >>> joins = Joins(lambda stop: True)
            >>> joins.add(0, 1, 1.0)
            >>> joins.add(1, 2, 1.0)
            >>> joins.way(0, 2), joins.duration_between(0, 2)
            ([0, 1, 2], 2.0)
        """
        i, j = self._place_of(a), self._place_of(b)
        if not math.isfinite(self._seconds[i, j]):
            return None
        way = [b]
        while i != j:
            j = int(self._before[i, j])
            way.append(self._stops[j])
        return way[::-1]

    def _place_of(self, stop: int) -> int:
        """Index of a stop in `_stops`; a new stop is added."""
        if stop >= len(self._place):
            self._place = np.append(self._place, np.full(stop + 1, -1))
        if self._place[stop] < 0:
            place = len(self._stops)
            self._place[stop] = place
            self._stops.append(stop)
            if place == len(self._passes):
                more = (0, place + 16)
                self._passes = np.pad(self._passes, more)
                self._seconds = np.pad(self._seconds, (more, more), constant_values=math.inf)
                self._before = np.pad(self._before, (more, more))
            self._passes[place] = self._may_pass(stop)
            self._seconds[place, place], self._before[place, place] = 0.0, place
        return int(self._place[stop])
