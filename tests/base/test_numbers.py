"""Numbers: units, ties, elementary functions, and arrays as short texts."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

from hplan.base import elementary, ties
from hplan.base.arrays import FloatArray, Record, readonly
from hplan.base.units import at_least_mm


@pytest.mark.parametrize(
    ("distance_m", "digits", "shown"),
    [(0.000988, 2, "0.98"), (0.002, 2, "2.00"), (0.0029999, 1, "2.9"), (-0.0011, 0, "-2"), (math.inf, 2, "inf")],
)
def test_distances_are_rounded_down(distance_m: float, digits: int, shown: str) -> None:
    assert at_least_mm(distance_m, digits) == shown


#: The same distance by two sums.
NEAR, NEARER = 0.20660599951286857, math.nextafter(0.20660599951286857, 0.0)


def test_first_of_those_that_tie() -> None:
    assert NEARER < NEAR
    values = [1.0, NEAR, math.inf, NEARER, -1.0, NEAR]
    assert ties.argsort(values).tolist() == [4, 1, 3, 5, 0, 2]
    assert ties.argmin(values[:4]) == 1
    assert ties.argmax([NEARER, NEAR, 0.0]) == 0
    assert ties.argmax([NEARER, 0.3]) == 1


def test_sums_on_the_raster_are_exact_in_any_order() -> None:
    values = ties.on_raster(np.random.default_rng(0).uniform(0.0, 30.0, 6)).tolist()
    sums = {sum(order) for order in itertools.permutations(values)}
    assert len(sums) == 1
    assert Fraction(sums.pop()) == sum(map(Fraction, values))


@pytest.mark.parametrize("shape", [(500,), (20, 25)])
def test_elementary_functions_are_those_of_the_c_library(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    x, y, c, d = rng.uniform(-3.0, 3.0, (4, *shape))
    points, others = x + 1j * y, c + 1j * d
    expected = np.array([math.atan2(b, a) for a, b in zip(x.flat, y.flat, strict=True)]).reshape(shape)
    np.testing.assert_array_equal(elementary.arctan2(y, x), expected)
    np.testing.assert_array_equal(elementary.argument(points), expected)
    np.testing.assert_array_equal(
        elementary.arccos(x / 3.0), np.array([math.acos(a / 3.0) for a in x.flat]).reshape(shape)
    )
    np.testing.assert_array_equal(elementary.modulus(points), np.sqrt(x * x + y * y))
    product = elementary.product(points, others)
    np.testing.assert_array_equal(product.real, x * c - y * d)
    np.testing.assert_array_equal(product.imag, x * d + y * c)
    assert elementary.arccos(np.array([1.5, -1.5])).tolist() == [0.0, math.pi]


@dataclass(frozen=True)
class Pair(Record):
    few: FloatArray
    many: FloatArray
    names: tuple[str, ...]
    nested: object


def test_record_shows_small_values_and_sizes_of_large_ones() -> None:
    inner = Pair(readonly([1.0]), readonly([2.0]), (), None)
    pair = Pair(readonly([0.5, np.pi]), readonly(np.zeros((40, 3))), ("x", "y"), inner)
    shown = "Pair(few=[0.5     , 3.141593], many=<float64 (40, 3)>, names=('x', 'y'), nested=Pair(...))"
    assert repr(pair) == shown
    assert repr(Pair(pair.few, pair.many, tuple("abcdefghij"), "x" * 300)).endswith("xx...)")
    assert "names=<10 items>" in repr(Pair(pair.few, pair.many, tuple("abcdefghij"), None))
