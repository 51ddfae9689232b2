"""Fruit shared out among arms, by costs that are given."""

from __future__ import annotations

import itertools

import numpy as np

from hplan.base.arrays import readonly
from hplan.tour.cell_tour import Share, exchange_fruits
from hplan.tour.ordering import Costs

FRUITS = ("a", "b", "c", "d", "e", "f")


def share(home: float, order: tuple[str, ...]) -> Share:
    """An arm on a line that waits at a place, with fruit at 0, 1, ... 5: a second for each unit."""
    at = np.arange(6.0)
    there = np.abs(at - home)
    never = readonly(np.full(6, np.inf))
    costs = Costs(
        readonly(np.arange(7), np.int64), readonly(there), readonly(np.abs(at[:, None] - at)), never, never,
        readonly(there), 0,
    )  # fmt: skip
    return Share({fruit: np.zeros((1, 1)) for fruit in FRUITS}, costs, order)


def nearness(weight: float) -> dict[tuple[str, str, str, str], float]:
    pairs = itertools.product(FRUITS, FRUITS)
    return {("l", f, "r", g): weight if abs(FRUITS.index(f) - FRUITS.index(g)) == 1 else 0.0 for f, g in pairs}


def test_fruit_goes_to_who_is_done_sooner_with_it():
    shares = {"l": share(-1.0, ("a",)), "r": share(6.0, ("f", "e", "d", "c", "b"))}
    found = exchange_fruits(shares, nearness(0.0), 1.0)
    assert {name: set(each.order) for name, each in found.items()} == {"l": {"a", "b", "c"}, "r": {"d", "e", "f"}}
    assert [each.seconds for each in found.values()] == [6.0, 6.0]


def test_fruit_is_exchanged_where_arms_would_be_near_each_other():
    shares = {"l": share(-1.0, ("a", "b", "d")), "r": share(6.0, ("c", "e", "f"))}
    found = exchange_fruits(shares, nearness(1.0), 1.0)
    assert {name: set(each.order) for name, each in found.items()} == {"l": {"a", "b", "c"}, "r": {"d", "e", "f"}}


def test_unreachable_fruit_stays_with_other_arm():
    right = share(6.0, FRUITS)
    left = Share({fruit: right.grasps[fruit] for fruit in ("a",)}, share(-1.0, ()).costs.select([0]))
    found = exchange_fruits({"l": left, "r": right}, nearness(0.0), 1.0)
    assert found["l"].order == ("a",)
    assert set(found["r"].order) == set(FRUITS[1:])


def test_measured_tour_durations_correct_the_costs():
    shares = {"l": share(-1.0, ("a", "b", "c")), "r": share(6.0, ("f", "e", "d"))}
    late = Share(shares["l"].grasps, shares["l"].costs, shares["l"].order, more_s=10.0)
    found = exchange_fruits(shares | {"l": late}, nearness(0.0), 1.0)
    assert set(found["r"].order) > {"d", "e", "f"}
