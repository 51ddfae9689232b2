r"""The order of a tour over fruits, each of which can be taken at several places, with a drop-off in between.

A *place* is one grasp of one fruit. A tour takes each fruit at one of its places. From one place it goes to the next
directly, or over the drop-off; directly at most as often as the arm can carry. For a given order of the fruits the
best places and drop-offs follow by dynamic programming over the order: with :math:`V_i(v, l)` the least cost of having
taken the first i fruits, the last of them at v and carrying l since the drop-off,

.. math::
    V_{i+1}(w, l + 1) &= \min_v V_i(v, l) + c(v, w), \\
    V_{i+1}(w, 1) &= \min_{v, l} (V_i(v, l) + d(v)) + a(w).

The order itself is exact for few fruits (the same over all subsets), else a local optimum: no reversal of a segment
and no move of up to three fruits, turned round or not, makes the tour shorter; kicks from a fixed seed look further.
Where no more than one fruit is carried, the least costs along all segments of the order are kept, from each place at
one end to each at the other, so that a change is judged by the few segments that it is made of; most changes by the
least cost of each segment and of the steps between them, whatever the places, which is no more than what they cost.
Costs may be infinite, and need not be symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen, readonly
from hplan.base.kernels import inlined, kernel

#: Up to so many fruits, and so many numbers in its table, the order is exact.
EXACT, _MOST_STATES = 11, 4_000_000

#: How many fruits are moved together at most.
SEGMENT = 3

#: Relative gain from which on a change counts.
_GAIN = 1e-12


class Costs(NamedTuple):
    """Costs from place to place, those of taking the fruit there included, as the kernels take them.

    Attributes:
        begin: (n + 1,) where the places of each of the n fruits begin, and the number of places m.
        first: (m,) from the start.
        onward: (m, m) from place to place directly.
        drop: (m,) from a place to the drop-off; infinite where there is none.
        away: (m,) from the drop-off to a place.
        last: (m,) from a place to the end of the tour.
        capacity: How many fruits are carried at most; 0 where they are not carried.
    """

    begin: IntArray
    first: FloatArray
    onward: FloatArray
    drop: FloatArray
    away: FloatArray
    last: FloatArray
    capacity: int

    @property
    def fruits(self) -> int:
        """Number of fruits."""
        return len(self.begin) - 1

    @property
    def fruit_of(self) -> IntArray:
        """(m,) the fruit of each place."""
        return np.repeat(np.arange(self.fruits), np.diff(self.begin))

    def over(self, fruits: Sequence[int]) -> Costs:
        """Those of some of the fruits, in that order."""
        begin, onward = self.begin, self.onward
        places = np.concatenate([np.arange(begin[fruit], begin[fruit + 1]) for fruit in fruits])
        return Costs(
            begin=readonly(np.cumsum([0, *(begin[fruit + 1] - begin[fruit] for fruit in fruits)]), np.int64),
            onward=readonly(onward[np.ix_(places, places)]),
            capacity=self.capacity,
            **{name: readonly(getattr(self, name)[places]) for name in ("first", "drop", "away", "last")},
        )


class Segments(NamedTuple):
    """What it costs to go along an order of N fruits, start and end, where no more than one fruit is carried.

    Attributes:
        costs: (2, N, N, places, places) from a place of the one at i to one of that at j >= i, and back.
        least: (2, N, N) the least of each, whatever the places.
    """

    costs: FloatArray
    least: FloatArray


@dataclass(frozen=True, eq=False)
class Visits:
    """A tour as an order of places, and the drop-offs in between.

    Attributes:
        cost: Its cost; infinite where there is no tour.
        places: (n,) the places in the order of the tour.
        dropped: (n,) True if the drop-off is visited between a place and the next one; the end is not included.
    """

    cost: float
    places: IntArray
    dropped: BoolArray


def along(costs: Costs, order: Sequence[int] | IntArray) -> Visits:
    """The best tour that takes fruits in a given order, all or some of them."""
    order = np.asarray(order, dtype=np.int64)
    if not len(order):
        return Visits(0.0, order, np.zeros(0, dtype=np.bool_))
    cost, places, dropped = _along(order, costs)
    return Visits(float(cost), frozen(places), frozen(dropped))


def nearest(costs: Costs) -> Visits:
    """Greedy tour: from each place to the fruit taken soonest from there; over the drop-off only where it must be."""
    fruit_of, left = costs.fruit_of, np.ones(len(costs.first), dtype=np.bool_)
    places: list[int] = []
    dropped: list[bool] = []
    load = 0
    for _ in range(costs.fruits):
        full = costs.capacity > 0 and load == costs.capacity
        legs = costs.first if not places else costs.away if full else costs.onward[places[-1]]
        if places and costs.capacity > 0 and not full and not np.isfinite(np.where(left, legs, np.inf)).any():
            full, legs = True, costs.away
        if places:
            dropped.append(full)
        place = int(np.argmin(np.where(left, legs, np.inf)))
        if not left[place]:  # no place left can be gone to
            place = int(np.argmax(left))
        load = 1 if full else load + 1
        places.append(place)
        left &= fruit_of != fruit_of[place]
    return Visits(_total(costs, places, dropped), np.array(places), np.array([*dropped, False]))


def best(costs: Costs, before: IntArray | None = None, kicked: bool = True) -> Visits:
    """The best tour: exact for few fruits, else a local optimum.

    Args:
        before: (n,) order of the fruits from which to go on.
        kicked: True if disturbed orders are tried, where the order is the one from before.
    """
    n, m = costs.fruits, len(costs.first)
    if n <= 2 or (n <= EXACT and (m * max(1, min(costs.capacity, n))) << n <= _MOST_STATES):
        return along(costs, _exact(costs))
    orders = [] if before is None else [np.asarray(before, dtype=np.int64)]
    if before is None or kicked:
        orders.append(costs.fruit_of[nearest(costs).places])
    found = [_improved(np.array(order), costs) for order in orders]
    cost, order = found[ties.argmin([cost for cost, _ in found])]
    if before is None or not kicked or not np.array_equal(order, orders[0]):
        return along(costs, order)  # there is time for kicks once nothing else moves
    random = np.random.default_rng(0)
    # How often the search is begun anew from a disturbed order, before it ends.
    for _ in range(30):
        cuts = np.sort(random.choice(np.arange(1, n), size=3, replace=False))
        a, b, c, d = np.split(order, cuts)
        other_cost, other = _improved(np.concatenate([a, c, b, d]), costs)
        if other_cost < cost * (1.0 - _GAIN):
            cost, order = other_cost, other
    return along(costs, order)


def _total(costs: Costs, places: Sequence[int], dropped: Sequence[bool]) -> float:
    """The cost of a tour."""
    total = costs.first[places[0]] + costs.last[places[-1]]
    for a, b, over in zip(places, places[1:], dropped, strict=False):
        total += costs.drop[a] + costs.away[b] if over else costs.onward[a, b]
    return float(total)


@kernel
def _cost(order: IntArray, costs: Costs, table: FloatArray) -> float:
    """The cost of the best tour in a given order; fills `table` (m, loads) with the least cost up to each place."""
    begin, first, onward, drop, away, last, capacity = costs
    loads = table.shape[1]
    for v in range(begin[order[0]], begin[order[0] + 1]):
        for load in range(loads):
            table[v, load] = math.inf
        table[v, 0] = first[v]
    for i in range(1, len(order)):
        f, g = order[i - 1], order[i]
        dropping = math.inf
        for v in range(begin[f], begin[f + 1]):
            for load in range(loads):
                dropping = min(dropping, table[v, load] + drop[v])
        for w in range(begin[g], begin[g + 1]):
            for load in range(loads):
                table[w, load] = math.inf
            table[w, 0] = dropping + away[w]
            for v in range(begin[f], begin[f + 1]):
                if capacity == 0:
                    table[w, 0] = min(table[w, 0], table[v, 0] + onward[v, w])
                else:
                    for load in range(loads - 1):
                        table[w, load + 1] = min(table[w, load + 1], table[v, load] + onward[v, w])
    least = math.inf
    for v in range(begin[order[-1]], begin[order[-1] + 1]):
        for load in range(loads):
            least = min(least, table[v, load] + last[v])
    return least


@kernel
def _along(order: IntArray, costs: Costs) -> tuple[float, IntArray, BoolArray]:
    """The best tour in a given order: cost, places, drop-offs; traced back through the values."""
    begin, _, onward, drop, away, last, capacity = costs
    n, loads = len(order), max(1, min(capacity, len(order)))
    table = np.empty((len(last), loads))
    cost = _cost(order, costs, table)
    places, dropped = np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    place, load, least = begin[order[-1]], 0, math.inf
    for v in range(begin[order[-1]], begin[order[-1] + 1]):
        for k in range(loads):
            if table[v, k] + last[v] < least:
                place, load, least = v, k, table[v, k] + last[v]
    places[n - 1] = place
    for i in range(n - 2, -1, -1):
        f, came, kept, over, least = order[i], begin[order[i]], 0, False, math.inf
        for v in range(begin[f], begin[f + 1]):
            for k in range(loads):
                if (capacity == 0 or k + 1 == load) and table[v, k] + onward[v, place] < least:
                    came, kept, over, least = v, k, False, table[v, k] + onward[v, place]
                if load == 0 and table[v, k] + drop[v] + away[place] < least:
                    came, kept, over, least = v, k, True, table[v, k] + drop[v] + away[place]
        place, load = came, kept
        places[i], dropped[i] = place, over
    return cost, places, dropped


@kernel
def _improved(order: IntArray, costs: Costs) -> tuple[float, IntArray]:
    """The order that no reversal of a segment and no move of a short one improves."""
    n = len(order)
    loads, most = max(1, min(costs.capacity, n)), 1
    for f in range(n):
        most = max(most, costs.begin[f + 1] - costs.begin[f])
    table = np.empty((len(costs.first), loads))
    cost, by_segments = _cost(order, costs, table), loads == 1
    # Start and end are fruits too, with a place each: n and n + 1.
    ends = _with_ends(costs)
    whole, other = np.empty(n + 2, dtype=np.int64), np.empty(n + 2, dtype=np.int64)
    whole[0] = other[0] = n
    whole[n + 1] = other[n + 1] = n + 1
    whole[1 : n + 1] = order
    steps, here = np.full((n + 2, n + 2), math.inf), np.empty((2, most))
    known = Segments(np.empty((2, n + 2, n + 2, most, most)), np.empty((2, n + 2, n + 2)))
    if by_segments:
        _fill_steps(ends, steps)
        _fill_segments(whole, ends, (0, n + 2), known)
    better = True
    while better:
        better = False
        # Kinds of change: a segment reversed (0); one of `kind` fruits moved (1 to SEGMENT), or moved and reversed.
        for kind in range(2 * SEGMENT + 1):
            size = (kind - 1) % SEGMENT + 1
            turned = kind > SEGMENT
            if turned and size == 1:
                continue
            for i in range(1, n + 1):
                for j in range(1, n + 1):
                    if (kind == 0 and j <= i) or (kind > 0 and (max(i, j) + size > n + 1 or i == j)):
                        continue
                    change = (kind, i, j)
                    if by_segments:
                        if not _bound(whole, change, steps, known) < cost * (1.0 - _GAIN):
                            continue
                        trial = _trial(whole, ends, change, known, here)
                        if not trial < cost * (1.0 - _GAIN):
                            continue
                    _change(whole, change, other)
                    if not by_segments:
                        trial = _cost(other[1 : n + 1], costs, table)
                        if not trial < cost * (1.0 - _GAIN):
                            continue
                    whole, other = other, whole
                    cost, better = trial, True
                    if by_segments:
                        _fill_segments(whole, ends, (min(i, j), _after(change)), known)
    return cost, whole[1 : n + 1].copy()


@kernel
def _change(order: IntArray, change: tuple[int, int, int], other: IntArray) -> None:
    """Write an order with the segment from i to j reversed, or some fruits from i on moved to stand from j on."""
    kind, i, j = change
    size, turned, source = (kind - 1) % SEGMENT + 1, kind > SEGMENT, 0
    for k in range(len(order)):
        if kind == 0:
            other[k] = order[i + j - k] if i <= k <= j else order[k]
        elif j <= k < j + size:
            other[k] = order[i + (j + size - 1 - k if turned else k - j)]
        else:
            if source == i:
                source += size
            other[k] = order[source]
            source += 1


class Ends(NamedTuple):
    """Costs with start and end as two more places, each a fruit of its own, as the kernels of segments take them.

    Attributes:
        begin: (N + 1,) where the places of each fruit begin.
        step: (m, m) from place to place where no more than one fruit is carried; infinite to the start, from the end.
    """

    begin: IntArray
    step: FloatArray


@kernel
def _with_ends(costs: Costs) -> Ends:
    """The costs with start and end."""
    m, n = len(costs.first), len(costs.begin) - 1
    begin, step = np.empty(n + 3, dtype=np.int64), np.full((m + 2, m + 2), math.inf)
    begin[: n + 1], begin[n + 1], begin[n + 2] = costs.begin, m + 1, m + 2
    for v in range(m):
        step[m, v], step[v, m + 1] = costs.first[v], costs.last[v]
        for w in range(m):
            step[v, w] = costs.onward[v, w] if costs.capacity == 0 else costs.drop[v] + costs.away[w]
    return Ends(begin, step)


@kernel
def _fill_segments(order: IntArray, ends: Ends, changed: tuple[int, int], known: Segments) -> None:
    """Write what it costs to go along each segment of an order.

    Args:
        order: The fruits, start and end.
        changed: From where to before where the order is another one than that of what is written already.
        known: What is written.
    """
    (low, end), begin = changed, ends.begin
    walk, least = known
    for i in range(end):
        places = begin[order[i] + 1] - begin[order[i]]
        least[0, i, i] = least[1, i, i] = 0.0
        for a in range(places):
            for b in range(places):
                walk[0, i, i, a, b] = walk[1, i, i, a, b] = 0.0 if a == b else math.inf
        for j in range(max(i + 1, low), len(order)):
            f, g = order[j], order[j - 1]
            least[0, i, j] = least[1, i, j] = math.inf
            for a in range(places):
                for w in range(begin[f], begin[f + 1]):
                    there, back = math.inf, math.inf
                    for v in range(begin[g], begin[g + 1]):
                        there = min(there, walk[0, i, j - 1, a, v - begin[g]] + ends.step[v, w])
                        back = min(back, ends.step[w, v] + walk[1, i, j - 1, v - begin[g], a])
                    walk[0, i, j, a, w - begin[f]] = there
                    walk[1, i, j, w - begin[f], a] = back
                    least[0, i, j], least[1, i, j] = min(least[0, i, j], there), min(least[1, i, j], back)


@kernel
def _fill_steps(ends: Ends, steps: FloatArray) -> None:
    """Write the least cost of a step from fruit to fruit, whatever the places: (N, N)."""
    begin = ends.begin
    for f in range(len(begin) - 1):
        for g in range(len(begin) - 1):
            for v in range(begin[f], begin[f + 1]):
                for w in range(begin[g], begin[g + 1]):
                    steps[f, g] = min(steps[f, g], ends.step[v, w])


_Part: TypeAlias = tuple[int, int, int]


@inlined
def _parts(change: tuple[int, int, int], count: int) -> tuple[_Part, _Part, _Part, _Part]:
    """The segments that a change puts one after the other: from low (-1 for none) to high, there (0) or back (1)."""
    kind, i, j = change
    size = (kind - 1) % SEGMENT + 1
    moved = (i, i + size - 1, 1 if kind > SEGMENT else 0)
    first, last = (0, min(i, j) - 1, 0), (_after(change), count - 1, 0)
    if kind == 0:
        return first, (i, j, 1), (-1, -1, 0), last
    if j < i:
        return first, moved, (j, i - 1, 0), last
    return first, (i + size, j + size - 1, 0), moved, last


@inlined
def _after(change: tuple[int, int, int]) -> int:
    """The place in the order behind what a change changes."""
    kind, i, j = change
    return (j if kind == 0 else max(i, j) + (kind - 1) % SEGMENT) + 1


@kernel
def _bound(order: IntArray, change: tuple[int, int, int], steps: FloatArray, known: Segments) -> float:
    """What the order that a change gives costs at least, by the least of each segment and of `_fill_steps`."""
    whole, at = 0.0, -1
    for low, high, back in _parts(change, len(order)):
        if low >= 0:
            enters, leaves = (high, low) if back == 1 else (low, high)
            whole += known.least[back, low, high] + (steps[at, order[enters]] if at >= 0 else 0.0)
            at = order[leaves]
    return whole


@kernel
def _trial(order: IntArray, ends: Ends, change: tuple[int, int, int], known: Segments, here: FloatArray) -> float:
    """The cost of the order that a change gives, by its segments; `here` (2, places) is written."""
    begin, at, now = ends.begin, -1, 0
    for low, high, back in _parts(change, len(order)):
        if low < 0:
            continue
        enters, leaves = (high, low) if back == 1 else (low, high)
        f, g = order[enters], order[leaves]
        for b in range(begin[g + 1] - begin[g]):
            here[1 - now, b] = math.inf
        for v in range(begin[f], begin[f + 1]):
            least = 0.0 if at < 0 else math.inf
            if at >= 0:
                for c in range(begin[order[at] + 1] - begin[order[at]]):
                    least = min(least, here[now, c] + ends.step[begin[order[at]] + c, v])
            for b in range(begin[g + 1] - begin[g]):
                here[1 - now, b] = min(here[1 - now, b], least + known.costs[back, low, high, v - begin[f], b])
        at, now = leaves, 1 - now
    cost: float = here[now, 0]
    return cost


@kernel
def _exact(costs: Costs) -> IntArray:
    """The best order, by the least cost of each set of fruits taken, place and load at its end."""
    begin, first, onward, drop, away, last, capacity = costs
    n, m = len(begin) - 1, len(first)
    loads = max(1, min(capacity, n))
    value = np.full((1 << n, m, loads), math.inf)
    # Where each state comes from: the place before, and its load.
    before = np.full((1 << n, m, loads, 2), -1, dtype=np.int32)
    for f in range(n):
        for v in range(begin[f], begin[f + 1]):
            value[1 << f, v, 0] = first[v]
    for taken in range(1, (1 << n) - 1):
        for f in range(n):
            if not (taken >> f) & 1:
                continue
            for v in range(begin[f], begin[f + 1]):
                for load in range(loads):
                    here = value[taken, v, load]
                    if here == math.inf:
                        continue
                    for g in range(n):
                        if (taken >> g) & 1:
                            continue
                        then = taken | (1 << g)
                        for w in range(begin[g], begin[g + 1]):
                            if here + drop[v] + away[w] < value[then, w, 0]:
                                value[then, w, 0] = here + drop[v] + away[w]
                                before[then, w, 0, 0], before[then, w, 0, 1] = v, load
                            carried = 0 if capacity == 0 else load + 1
                            if carried < loads and here + onward[v, w] < value[then, w, carried]:
                                value[then, w, carried] = here + onward[v, w]
                                before[then, w, carried, 0], before[then, w, carried, 1] = v, load
    fruit_of = np.empty(m, dtype=np.int64)
    for f in range(n):
        fruit_of[begin[f] : begin[f + 1]] = f
    taken, place, load, least = (1 << n) - 1, -1, 0, math.inf
    for v in range(m):
        for k in range(loads):
            if value[taken, v, k] + last[v] < least:
                place, load, least = v, k, value[taken, v, k] + last[v]
    order = np.arange(n)
    for i in range(n - 1, -1, -1):
        if place < 0:
            break  # there is no tour
        order[i] = fruit_of[place]
        came, kept = before[taken, place, load, 0], before[taken, place, load, 1]
        taken &= ~(1 << order[i])
        place, load = came, kept
    return order
