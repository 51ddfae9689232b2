"""Shortest connections between stops, updated incrementally as motions are found.

A connection may pass other stops if that is faster. A new motion shortens some connections and lengthens none: each
connection is compared with the one through the new motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hplan.base.arrays import FloatArray, IntArray

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

    def between(self, a: int, b: int) -> float:
        """Duration between two stops [s]; infinite without a connection."""
        return float(self.seconds(np.array([a]), np.array([b]))[0])

    def way(self, a: int, b: int) -> list[int] | None:
        """Stops of the fastest connection between two stops; None without a connection.

        Examples:
            >>> joins = Joins(lambda stop: True)
            >>> joins.add(0, 1, 1.0)
            >>> joins.add(1, 2, 1.0)
            >>> joins.way(0, 2), joins.between(0, 2)
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
