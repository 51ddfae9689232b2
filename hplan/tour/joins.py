"""The quickest ways between stops, over other stops where that is quicker, as motions are found one after the other.

A motion that is found makes some ways quicker and none slower: each way is compared with the one over it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hplan.base.arrays import FloatArray, IntArray

#: By less than this a joined motion is not quicker than another [s]; motions last whole periods.
GAIN_S = 1e-6


class Joins:
    """Ways from stop to stop, there and back alike."""

    def __init__(self, may_pass: Callable[[int], bool]) -> None:
        """Begin without motions.

        Args:
            may_pass: Whether the arm may stop at a stop on its way to another.
        """
        self._may_pass = may_pass
        self._stops: list[int] = []
        self._place = np.full(0, -1)  # of each stop among these
        self._passes = np.zeros(0, dtype=np.bool_)
        # From place to place, with room for more: duration, and the place before the end.
        self._seconds, self._before = np.zeros((0, 0)), np.zeros((0, 0), dtype=np.int32)

    def add(self, a: int, b: int, seconds: float) -> None:
        """Take in a motion between two stops, by its duration; infinite where there is none [s]."""
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
        """(k,) durations between stops; infinite where there is no way [s]."""
        longest = int(max(a.max(initial=-1), b.max(initial=-1)))
        place = np.append(self._place, np.full(max(0, longest + 1 - len(self._place)), -1))
        i, j = place[a], place[b]
        found = np.full(len(a), math.inf)
        here = (i >= 0) & (j >= 0)
        found[here] = self._seconds[i[here], j[here]]
        return found

    def between(self, a: int, b: int) -> float:
        """The duration between two stops; infinite where there is no way [s]."""
        return float(self.seconds(np.array([a]), np.array([b]))[0])

    def way(self, a: int, b: int) -> list[int] | None:
        """The stops of the quickest way between two; None where there is none."""
        i, j = self._place_of(a), self._place_of(b)
        if not math.isfinite(self._seconds[i, j]):
            return None
        way = [b]
        while i != j:
            j = int(self._before[i, j])
            way.append(self._stops[j])
        return way[::-1]

    def _place_of(self, stop: int) -> int:
        """The place of a stop, a new one unless it has one."""
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
