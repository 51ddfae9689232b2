from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.errors import OptionError
from hplan.scene.orchard import FruitZone, fruit_at_tips
from hplan.scene.orchard.fruits import Canopy
from hplan.scene.orchard.pieces import capsule

#: A trunk with four level branches, a rung of the ladder each.
TRUNK = capsule("trunk 1", (0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.03)
BRANCHES = [
    capsule(f"branch {i}", (0.0, 0.0, 0.4 * i), (0.5 * (-1) ** i, 0.1 * i, 0.4 * i), 0.006) for i in range(1, 5)
]
TREE = [TRUNK, *BRANCHES]

#: Gap between a fruit and wood that it touches: none, or what rounding to tenths of a millimetre leaves.
TOUCHING = (-1e-9, 2e-4)


def gap(fruit, wood) -> float:
    """Distance of a fruit's surface from a capsule's, by brute force along the axis and a refinement."""
    start, end = wood.core
    low, high = 0.0, 1.0
    for _ in range(60):  # the distance to a point of a segment is convex
        a, b = low + (high - low) / 3, high - (high - low) / 3
        if math.dist(fruit.center, start + a * (end - start)) < math.dist(fruit.center, start + b * (end - start)):
            high = b
        else:
            low = a
    return math.dist(fruit.center, start + low * (end - start)) - wood.radius - fruit.radius


def apart(fruits) -> bool:
    pairs = itertools.combinations(fruits, 2)
    return all(math.dist(a.center, b.center) >= a.radius + b.radius for a, b in pairs)


def test_one_at_each_tip():
    fruits = fruit_at_tips(TREE, 4)
    assert [fruit.name for fruit in fruits] == ["fruit 01", "fruit 02", "fruit 03", "fruit 04"]
    for branch in BRANCHES:
        (fruit,) = [f for f in fruits if math.dist(f.center, branch.end) < 0.05]
        assert TOUCHING[0] <= gap(fruit, branch) <= TOUCHING[1]
        # Straight ahead of the branch.
        along = np.subtract(branch.end, branch.start)
        assert np.dot(np.subtract(fruit.center, branch.end), along) == pytest.approx(
            0.0461 * np.linalg.norm(along), abs=1e-4
        )
    assert apart(fruits)
    assert [math.hypot(*f.center[:2]) for f in fruits] == sorted(math.hypot(*f.center[:2]) for f in fruits)


def test_other_wood_is_avoided_where_that_can_be():
    wall = capsule("trunk 2", (0.56, -1.0, 0.8), (0.56, 1.0, 0.8), 0.02)
    branch = capsule("branch 1", (0.0, 0.0, 0.8), (0.5, 0.0, 0.8), 0.006)
    (fruit,) = fruit_at_tips([branch, wall], 1)
    assert TOUCHING[0] <= gap(fruit, branch) <= TOUCHING[1]
    assert gap(fruit, wall) >= 0.0
    # In a narrow pipe of wood there is no clear place: then as little deep as can be, and never in another fruit.
    walls = [
        capsule(f"trunk {i}", (-1.0, y, z), (1.0, y, z), 0.01)
        for i, (y, z) in enumerate([(0.03, 0.8), (-0.03, 0.8), (0.0, 0.83), (0.0, 0.77)])
    ]
    pair = fruit_at_tips([branch, *walls], 2)
    assert apart(pair)
    assert max(min(gap(f, wall) for wall in walls) for f in pair) < -0.001


def test_only_free_ends_of_branches_are_tips():
    pieces = [capsule("branch 1", (0, 0, 0), (0.3, 0, 0), 0.01), capsule("branch 2", (0.3, 0, 0), (0.32, 0, 0), 0.01)]
    wood = [
        *pieces,
        TRUNK,
        capsule("post 1", (5, 0, 0), (5, 0, 2), 0.04),
        capsule("wire 1", (5, 0, 1), (7, 0, 1), 0.001),
    ]
    (fruit,) = fruit_at_tips(wood, 1)
    assert fruit.center == pytest.approx((0.32 + 0.0501, 0.0, 0.0), abs=1e-4)
    with pytest.raises(OptionError, match="count = 2: expected at most 1, which found room") as caught:
        fruit_at_tips(wood, 2)
    assert caught.value.option == "count"


def test_zone_is_kept():
    zone = FruitZone(0.7, 1.3)
    assert all(zone.holds(*fruit.center) for fruit in fruit_at_tips(TREE, 4, zone=zone))
    with pytest.raises(OptionError, match="at most 0"):
        fruit_at_tips(TREE, 1, zone=FruitZone(5.0, 6.0))


points = st.tuples(*[st.floats(-1, 1)] * 3)


@settings(max_examples=60)
@given(st.lists(st.tuples(points, points, st.floats(0.001, 0.05)), min_size=1, max_size=6), points)
def test_distances_from_wood(pieces, point):
    wood = [capsule(f"w {i}", *piece) for i, piece in enumerate(pieces)]

    class Ball:
        center, radius = point, 0.04

    expected = [gap(Ball, piece) + Ball.radius for piece in wood]
    np.testing.assert_allclose(Canopy(wood, 0.04, FruitZone()).wood_distances(np.array(point)), expected, atol=1e-6)


@settings(max_examples=40)
@given(
    st.lists(st.tuples(points, points, st.floats(0.002, 0.05)), min_size=1, max_size=8),
    st.integers(1, 12),
    st.integers(0, 5),
)
def test_random_wood(pieces, count, seed):
    wood = [capsule(f"branch {i}", *piece) for i, piece in enumerate(pieces)]
    try:
        fruits = fruit_at_tips(wood, count, seed=seed)
    except OptionError:
        return
    assert len(fruits) == count
    assert apart(fruits)
    assert all(min(gap(fruit, piece) for piece in wood) <= TOUCHING[1] for fruit in fruits)
