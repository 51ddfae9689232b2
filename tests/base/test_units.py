"""What is shown of a bound is a bound."""

from __future__ import annotations

import math

import pytest

from hplan.base.units import at_least_mm


@pytest.mark.parametrize(
    ("distance_m", "digits", "shown"),
    [(0.000988, 2, "0.98"), (0.002, 2, "2.00"), (0.0029999, 1, "2.9"), (-0.0011, 0, "-2"), (math.inf, 2, "inf")],
)
def test_distances_are_rounded_down(distance_m: float, digits: int, shown: str) -> None:
    assert at_least_mm(distance_m, digits) == shown
