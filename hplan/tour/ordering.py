r"""Optimizes the order of fruits with alternative grasps and a drop-off.

A *place* is one grasp of one fruit. A tour visits each fruit at one of its places. It goes from place to place directly
or through the drop-off; the number of direct moves in a row is limited by the load capacity. For a given order of the
fruits the optimal places and drop-offs follow by dynamic programming over the order: with :math:`V_i(v, l)` the minimum
cost of having taken the first i fruits, the last of them at v and carrying l since the drop-off,

.. math::
    V_{i+1}(w, l + 1) &= \min_v V_i(v, l) + c(v, w), \\
    V_{i+1}(w, 1) &= \min_{v, l} (V_i(v, l) + d(v)) + a(w).

The order itself is exact for few fruits (dynamic programming over all subsets), otherwise a local optimum: no reversal
of a segment and no move of up to three fruits, reversed or not, makes the tour shorter; kicks from a fixed seed widen
the search. If at most one fruit is carried, the minimum costs along all segments of the order are stored, from each
place at one end to each at the other, so that a change is evaluated from the few segments that compose it. Most changes
are rejected by a lower bound: the sum of the minimum costs of its segments and of the steps between them, over all
places. Costs may be infinite, and need not be symmetric.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray, frozen, readonly
from hplan.base.kernels import inline, kernel

#: Maximum number of fruits, and of entries of the table, for the exact order.
EXACT, _MOST_STATES = 11, 4_000_000

#: Maximum number of fruits that are moved together.
SEGMENT = 3

#: Minimum relative gain of a change.
_GAIN = 1e-12


class Costs(NamedTuple):
    """Costs between places, picking at the destination included, for kernels.

    Attributes:
        begin: (n + 1,) index of the first place of each of the n fruits, and the number of places m.
        first: (m,) from the start to a place.
        onward: (m, m) from place to place directly.
        drop: (m,) from a place to the drop-off; infinite without a drop-off.
        away: (m,) from the drop-off to a place.
        last: (m,) from a place to the end of the tour.
        capacity: Maximum number of fruits carried; 0 if fruits are not carried.
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
        """(m,) index of the fruit of each place."""
        return np.repeat(np.arange(self.fruits), np.diff(self.begin))

    def select(self, fruits: Sequence[int]) -> Costs:
        """Costs of a subset of the fruits, in the given order."""
        begin, onward = self.begin, self.onward
        places = np.concatenate([np.arange(begin[fruit], begin[fruit + 1]) for fruit in fruits])
        return Costs(
            begin=readonly(np.cumsum([0, *(begin[fruit + 1] - begin[fruit] for fruit in fruits)]), np.int64),
            onward=readonly(onward[np.ix_(places, places)]),
            capacity=self.capacity,
            **{name: readonly(getattr(self, name)[places]) for name in ("first", "drop", "away", "last")},
        )


class Segments(NamedTuple):
    """Costs along all segments of an order, for loads of one.

    At most one fruit is carried. The N fruits include the start and the end.

    Attributes:
        costs: (2, N, N, places, places) from a place of the fruit at i to one of that at j >= i, and backwards.
        least: (2, N, N) minimum of each over all places.
    """

    costs: FloatArray
    least: FloatArray


@dataclass(frozen=True, eq=False)
class Visits:
    """Tour as an order of places, with the drop-offs between them.

    Attributes:
        cost: Total cost; infinite if there is no feasible tour.
        places: (n,) places in the order of the tour.
        dropped: (n,) True if the drop-off is visited between a place and the next one; the end is not included.
    """

    cost: float
    places: IntArray
    dropped: BoolArray


def order_grasps(costs: Costs, order: Sequence[int] | IntArray) -> Visits:
    """Optimal tour in a given order of all or some fruits."""
    order = np.asarray(order, dtype=np.int64)
    if not len(order):
        return Visits(0.0, order, np.zeros(0, dtype=np.bool_))
    cost, places, dropped = _cost_of_order(order, costs)
    return Visits(float(cost), frozen(places), frozen(dropped))


def nearest_tour(costs: Costs) -> Visits:
    """Greedy tour: always to the cheapest next fruit; drop-offs only if necessary."""
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
        if not left[place]:  # no place left is reachable
            place = int(np.argmax(left))
        load = 1 if full else load + 1
        places.append(place)
        left &= fruit_of != fruit_of[place]
    return Visits(_total(costs, places, dropped), np.array(places), np.array([*dropped, False]))


def best(costs: Costs, before: IntArray | None = None, kicked: bool = True) -> Visits:
    """Optimal tour for few fruits, otherwise a local optimum.

    Args:
        costs: Costs between places.
        before: (n,) initial order of the fruits; None for the greedy order.
        kicked: True to try perturbed orders if the local search leaves the initial order unchanged.
    """
    n, m = costs.fruits, len(costs.first)
    if n <= 2 or (n <= EXACT and (m * max(1, min(costs.capacity, n))) << n <= _MOST_STATES):
        return order_grasps(costs, _exact(costs))
    orders = [] if before is None else [np.asarray(before, dtype=np.int64)]
    if before is None or kicked:
        orders.append(costs.fruit_of[nearest_tour(costs).places])
    found = [_improve_order(np.array(order), costs) for order in orders]
    cost, order = found[ties.argmin([cost for cost, _ in found])]
    if before is None or not kicked or not np.array_equal(order, orders[0]):
        return order_grasps(costs, order)  # kicks follow once the order no longer changes
    random = np.random.default_rng(0)
    # Number of restarts from a perturbed order.
    for _ in range(30):
        cuts = np.sort(random.choice(np.arange(1, n), size=3, replace=False))
        a, b, c, d = np.split(order, cuts)
        other_cost, other = _improve_order(np.concatenate([a, c, b, d]), costs)
        if other_cost < cost * (1.0 - _GAIN):
            cost, order = other_cost, other
    return order_grasps(costs, order)


def _total(costs: Costs, places: Sequence[int], dropped: Sequence[bool]) -> float:
    """Cost of a tour."""
    total = costs.first[places[0]] + costs.last[places[-1]]
    for a, b, over in zip(places, places[1:], dropped, strict=False):
        total += costs.drop[a] + costs.away[b] if over else costs.onward[a, b]
    return float(total)


@kernel
def _cost(order: IntArray, costs: Costs, table: FloatArray) -> float:
    """Minimum cost of a tour in a given order.

    Fills `table` (m, loads) with the minimum cost up to each place.
    """
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
def _cost_of_order(order: IntArray, costs: Costs) -> tuple[float, IntArray, BoolArray]:
    """Cost, places and drop-offs of the optimal tour in a given order.

    They are traced back through the table of minimum costs.
    """
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
def _improve_order(order: IntArray, costs: Costs) -> tuple[float, IntArray]:
    """Improve an order by reversals of segments and moves of short segments."""
    n = len(order)
    loads, most = max(1, min(costs.capacity, n)), 1
    for f in range(n):
        most = max(most, costs.begin[f + 1] - costs.begin[f])
    table = np.empty((len(costs.first), loads))
    cost, by_segments = _cost(order, costs, table), loads == 1
    # Start and end count as fruits with one place each: n and n + 1.
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
        # Kinds of change: a segment reversed (0); `kind` fruits moved (1 to SEGMENT), or moved and reversed.
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
                        if not _bound_tour(whole, change, steps, known) < cost * (1.0 - _GAIN):
                            continue
                        trial = _trial(whole, ends, change, known, here)
                        if not trial < cost * (1.0 - _GAIN):
                            continue
                    _change_of_order(whole, change, other)
                    if not by_segments:
                        trial = _cost(other[1 : n + 1], costs, table)
                        if not trial < cost * (1.0 - _GAIN):
                            continue
                    whole, other = other, whole
                    cost, better = trial, True
                    if by_segments:
                        _fill_segments(whole, ends, (min(i, j), _end_of_change(change)), known)
    return cost, whole[1 : n + 1].copy()


@kernel
def _change_of_order(order: IntArray, change: tuple[int, int, int], other: IntArray) -> None:
    """Write an order with one segment reversed or moved.

    The segment from i to j is reversed, or fruits from i on are moved to position j.
    """
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
    """Costs with start and end as additional fruits, for segment kernels.

    Attributes:
        begin: (N + 1,) index of the first place of each fruit.
        step: (m, m) from place to place, if at most one fruit is carried; infinite to the start and from the end.
    """

    begin: IntArray
    step: FloatArray


@kernel
def _with_ends(costs: Costs) -> Ends:
    """Costs with start and end as additional fruits."""
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
    """Write the costs along each segment of an order.

    Args:
        order: The fruits, start and end included.
        ends: Costs with start and end.
        changed: First changed index, and the index after the last one, relative to the order of `known`.
        known: The costs of the previous order; updated.
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
    """Write (N, N) minimum costs from fruit to fruit over all places."""
    begin = ends.begin
    for f in range(len(begin) - 1):
        for g in range(len(begin) - 1):
            for v in range(begin[f], begin[f + 1]):
                for w in range(begin[g], begin[g + 1]):
                    steps[f, g] = min(steps[f, g], ends.step[v, w])


_Segment: TypeAlias = tuple[int, int, int]


@inline
def _segments_after(change: tuple[int, int, int], count: int) -> tuple[_Segment, _Segment, _Segment, _Segment]:
    """Segments of the order after a change.

    Each has the first index (-1 for no segment), the last index, and 1 if it is reversed.
    """
    kind, i, j = change
    size = (kind - 1) % SEGMENT + 1
    moved = (i, i + size - 1, 1 if kind > SEGMENT else 0)
    first, last = (0, min(i, j) - 1, 0), (_end_of_change(change), count - 1, 0)
    if kind == 0:
        return first, (i, j, 1), (-1, -1, 0), last
    if j < i:
        return first, moved, (j, i - 1, 0), last
    return first, (i + size, j + size - 1, 0), moved, last


@inline
def _end_of_change(change: tuple[int, int, int]) -> int:
    """Index after the last position that a change affects."""
    kind, i, j = change
    return (j if kind == 0 else max(i, j) + (kind - 1) % SEGMENT) + 1


@kernel
def _bound_tour(order: IntArray, change: tuple[int, int, int], steps: FloatArray, known: Segments) -> float:
    """Lower bound on the cost of an order after a change.

    It adds the minimum costs of the segments and of the steps between them.
    """
    whole, at = 0.0, -1
    for low, high, back in _segments_after(change, len(order)):
        if low >= 0:
            enters, leaves = (high, low) if back == 1 else (low, high)
            whole += known.least[back, low, high] + (steps[at, order[enters]] if at >= 0 else 0.0)
            at = order[leaves]
    return whole


@kernel
def _trial(order: IntArray, ends: Ends, change: tuple[int, int, int], known: Segments, here: FloatArray) -> float:
    """Cost of the order after a change, from its segments.

    `here` (2, places) is workspace.
    """
    begin, at, now = ends.begin, -1, 0
    for low, high, back in _segments_after(change, len(order)):
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
    """Optimal order, by dynamic programming over subsets, last place and load."""
    begin, first, onward, drop, away, last, capacity = costs
    n, m = len(begin) - 1, len(first)
    loads = max(1, min(capacity, n))
    value = np.full((1 << n, m, loads), math.inf)
    # Predecessor of each state: the previous place, and its load.
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
