"""Orders of visits against brute force over all orders, places and drop-offs."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hplan.tour import ordering
from hplan.tour.ordering import SEGMENT, Costs, Visits, along, best, nearest


def random_costs(
    seed: int, n: int, *, capacity: int, absent: float = 0.0, round_numbers: bool = False, most: int = 3
) -> Costs:
    """Costs that know no symmetry and no triangle inequality; some of them infinite."""
    random = np.random.default_rng(seed)
    begin = np.concatenate([[0], np.cumsum(random.integers(1, most + 1, n))])
    m = int(begin[-1])

    def entries(*shape: int) -> np.ndarray:
        values = random.integers(1, 4, shape).astype(float) if round_numbers else random.uniform(0.1, 3.0, shape)
        values[random.uniform(size=shape) < absent] = np.inf
        return values

    drop = entries(m) if capacity else np.full(m, np.inf)
    return Costs(begin, entries(m), entries(m, m), drop, entries(m), entries(m), capacity)


def cost_of(costs: Costs, visits: Visits) -> float:
    """What a tour costs, counted leg by leg; infinite if it carries too much."""
    total, load = costs.first[visits.places[0]], 1
    for a, b, over in zip(visits.places, visits.places[1:], visits.dropped, strict=False):
        total += costs.drop[a] + costs.away[b] if over else costs.onward[a, b]
        load = 1 if over else load + 1
        if costs.capacity and load > costs.capacity:
            return math.inf
    return float(total + costs.last[visits.places[-1]])


def brute_force(costs: Costs, orders: list[tuple[int, ...]]) -> float:
    """The least cost over some orders, all places and all drop-offs."""
    n, least = costs.fruits, math.inf
    for order in orders:
        choices = [range(costs.begin[f], costs.begin[f + 1]) for f in order]
        for places in itertools.product(*choices):
            for over in itertools.product((False, True) if costs.capacity else (False,), repeat=n - 1):
                least = min(least, cost_of(costs, Visits(0.0, np.array(places), np.array([*over, False]))))
    return least


CASES = [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.2), (0, 0.3), (2, 0.4)]


@pytest.mark.parametrize(("capacity", "absent"), CASES)
@pytest.mark.parametrize("seed", range(5))
def test_few_fruits_are_exact(seed: int, capacity: int, absent: float) -> None:
    costs = random_costs(seed, 4, capacity=capacity, absent=absent)
    found = best(costs)
    wanted = brute_force(costs, list(itertools.permutations(range(4))))
    assert found.cost == pytest.approx(wanted, rel=1e-12) or found.cost == wanted == math.inf
    if math.isfinite(wanted):
        assert cost_of(costs, found) == pytest.approx(found.cost, rel=1e-12)
        assert sorted(costs.fruit_of[found.places]) == [0, 1, 2, 3]


@pytest.mark.parametrize(("capacity", "absent"), CASES)
@pytest.mark.parametrize("seed", range(5))
def test_places_and_drop_offs_along_an_order_are_exact(seed: int, capacity: int, absent: float) -> None:
    costs = random_costs(seed, 5, capacity=capacity, absent=absent, round_numbers=seed % 2 == 1)
    order = tuple(np.random.default_rng(seed).permutation(5).tolist())
    found = along(costs, order)
    wanted = brute_force(costs, [order])
    assert found.cost == pytest.approx(wanted, rel=1e-12) or found.cost == wanted == math.inf
    if math.isfinite(wanted):
        assert tuple(costs.fruit_of[found.places]) == order
        assert cost_of(costs, found) == pytest.approx(found.cost, rel=1e-12)


@pytest.mark.parametrize("capacity", [0, 1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_local_search_comes_near_the_optimum(monkeypatch: pytest.MonkeyPatch, seed: int, capacity: int) -> None:
    costs = random_costs(seed, 8, capacity=capacity, absent=0.1)
    exact = best(costs)
    monkeypatch.setattr(ordering, "EXACT", 0)
    first = best(costs)
    again = best(costs, costs.fruit_of[first.places])
    assert cost_of(costs, again) == pytest.approx(again.cost, rel=1e-12)
    assert exact.cost <= again.cost * (1 + 1e-12)
    assert again.cost <= first.cost <= along(costs, costs.fruit_of[nearest(costs).places]).cost
    assert again.cost <= 1.1 * exact.cost


@pytest.mark.parametrize("capacity", [0, 1])
def test_every_change_costs_what_the_changed_order_does(capacity: int) -> None:
    for seed, n, most in itertools.product(range(3), (3, 4, 7), (1, 3)):
        costs = random_costs(seed, n, capacity=capacity, absent=0.2, most=most)
        order, places = (
            np.array([n, *np.random.default_rng(seed).permutation(n), n + 1]),
            int(np.diff(costs.begin).max()),
        )
        ends, shapes = ordering._with_ends(costs), ((2, n + 2, n + 2, places, places), (2, n + 2, n + 2))
        known, steps = ordering.Segments(*map(np.empty, shapes)), np.full((n + 2, n + 2), np.inf)
        ordering._fill_steps(ends, steps)
        ordering._fill_segments(order, ends, (0, n + 2), known)
        single = (np.diff(costs.begin) == 1).all()
        table, here, other = np.empty((len(costs.first), 1)), np.empty((2, places)), order.copy()
        for kind, i, j in itertools.product(range(2 * SEGMENT + 1), range(1, n + 1), range(1, n + 1)):
            size = (kind - 1) % SEGMENT + 1
            if (j <= i) if kind == 0 else (i == j or max(i, j) + size > n + 1):
                continue
            ordering._change(order, (kind, i, j), other)
            assert (other[0], sorted(other[1:-1]), other[-1]) == (n, list(range(n)), n + 1)
            trial = ordering._trial(order, ends, (kind, i, j), known, here)
            assert trial == pytest.approx(ordering._cost(other[1:-1], costs, table), rel=1e-12)
            # What is written anew where the order has changed is what is written of all of it.
            anew = ordering.Segments(*(array.copy() for array in known))
            whole = ordering.Segments(*(np.full(shape, np.nan) for shape in shapes))
            ordering._fill_segments(other, ends, (min(i, j), ordering._after((kind, i, j))), anew)
            ordering._fill_segments(other, ends, (0, n + 2), whole)
            assert all((a[~np.isnan(b)] == b[~np.isnan(b)]).all() for a, b in zip(anew, whole, strict=True))
            bound = ordering._bound(order, (kind, i, j), steps, known)
            assert bound == pytest.approx(trial, rel=1e-12) if single else bound <= trial * (1.0 + 1e-12)


@pytest.mark.parametrize("n", [12, 25])
def test_many_fruits_on_a_circle(n: int) -> None:
    """The best open tour over points on a circle follows it."""
    angles = 2.0 * np.pi * np.random.default_rng(0).permutation(n) / n
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    onward = np.linalg.norm(points[:, None] - points, axis=2)
    none = np.full(n, np.inf)
    costs = Costs(np.arange(n + 1), np.zeros(n), onward, none, none, np.zeros(n), 0)
    found = best(costs)
    assert found.cost == pytest.approx(2.0 * math.sin(math.pi / n) * (n - 1), rel=1e-12)


def test_nearest_goes_on_to_the_nearest() -> None:
    x = np.array([1.0, -1.1, 2.2, -4.0])
    onward, none = np.abs(x[:, None] - x), np.full(4, np.inf)
    costs = Costs(np.arange(5), np.abs(x), onward, none, none, np.zeros(4), 0)
    found = nearest(costs)
    assert found.places.tolist() == [0, 2, 1, 3]
    assert found.cost == pytest.approx(1.0 + 1.2 + 3.3 + 2.9)
    carried = Costs(np.arange(5), np.abs(x), onward, np.abs(x), np.abs(x), np.abs(x), 2)
    found = nearest(carried)
    assert found.places.tolist() == [0, 2, 1, 3]
    assert found.dropped.tolist() == [False, True, False, False]
    assert found.cost == pytest.approx(cost_of(carried, found))


@pytest.mark.parametrize("capacity", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", range(3))
def test_nearest_never_carries_more_than_it_can(seed: int, capacity: int) -> None:
    found = nearest(random_costs(seed, 13, capacity=capacity))
    ends = [*np.flatnonzero(found.dropped).tolist(), 12]
    loads = np.diff([-1, *ends]).tolist()
    assert loads == [capacity] * (13 // capacity) + [13 % capacity] * (13 % capacity > 0)


@pytest.mark.parametrize("find", [best, nearest, lambda costs: along(costs, [1, 0, 2])])
def test_no_tour_costs_infinity(find: object) -> None:
    none = np.full(3, np.inf)
    costs = Costs(np.arange(4), np.ones(3), np.full((3, 3), np.inf), none, none, np.zeros(3), 0)
    found = find(costs)  # type: ignore[operator]
    assert found.cost == math.inf
    assert sorted(found.places) == [0, 1, 2]
