"""What kernels and all else are made of: kernels, units, ties, short texts of objects, names that have moved."""

from __future__ import annotations

import importlib
import itertools
import math
import re
import subprocess
import sys
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest

import hplan
from hplan.base import elementary, ties
from hplan.base.arrays import FloatArray, Record, readonly
from hplan.base.kernels import any_int, inlined, kernel
from hplan.base.moved import MOVED, present_name
from hplan.base.units import at_least_mm

_THREE = any_int(3)


@inlined
def _twice(x: float) -> float:
    return 2.0 * x


@kernel
def _power(x: float, times: int) -> float:
    result = 1.0
    for _ in range(times):
        result *= x
    return result


@kernel
def _all_of_them(x: float, times: int) -> float:
    return _power(x, times) + _power(x, _THREE) + _twice(x)


def test_a_constant_is_no_kind_of_its_own() -> None:
    assert _all_of_them(2.0, 5) == 32.0 + 8.0 + 4.0
    assert isinstance(_THREE, np.int64)
    assert len(_power.overloads) <= 1  # 0 where the kernel that calls it comes from disk


@pytest.mark.parametrize(
    ("distance_m", "digits", "shown"),
    [(0.000988, 2, "0.98"), (0.002, 2, "2.00"), (0.0029999, 1, "2.9"), (-0.0011, 0, "-2"), (math.inf, 2, "inf")],
)
def test_distances_are_rounded_down(distance_m: float, digits: int, shown: str) -> None:
    assert at_least_mm(distance_m, digits) == shown


#: The same distance by two sums.
NEAR, NEARER = 0.20660599951286857, math.nextafter(0.20660599951286857, 0.0)


def test_the_first_of_those_that_tie() -> None:
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
    assert np.isnan(elementary.arccos(np.array([1.5]))).all()


@dataclass(frozen=True)
class Pair(Record):
    few: FloatArray
    many: FloatArray
    names: tuple[str, ...]
    nested: object


def test_a_record_shows_small_values_and_sizes_of_large_ones() -> None:
    inner = Pair(readonly([1.0]), readonly([2.0]), (), None)
    pair = Pair(readonly([0.5, np.pi]), readonly(np.zeros((40, 3))), ("x", "y"), inner)
    shown = "Pair(few=[0.5     , 3.141593], many=<float64 (40, 3)>, names=('x', 'y'), nested=Pair(...))"
    assert repr(pair) == shown
    assert repr(Pair(pair.few, pair.many, tuple("abcdefghij"), "x" * 300)).endswith("xx...)")
    assert "names=<10 items>" in repr(Pair(pair.few, pair.many, tuple("abcdefghij"), None))


def test_a_robot_is_its_name_and_joints(robot: hplan.Robot) -> None:
    assert repr(robot) == "<Robot 'harvester': 4 joints (base_yaw, shoulder, elbow, wrist), tool frame 'tool0'>"


def test_results_are_a_line(robot: hplan.Robot, scene: hplan.Scene) -> None:
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))
    assert re.fullmatch(r"<Trajectory: \S+ s, \d+ rows, joints base_yaw, .*>", repr(result.trajectory))
    assert len(repr(result)) < 1500
    assert len(repr(result.motion)) < 1500


@pytest.mark.parametrize("name", sorted(MOVED))
def test_an_earlier_name_is_the_same_module(name: str) -> None:
    assert importlib.import_module(f"hplan.{name}") is importlib.import_module(f"hplan.{MOVED[name]}")


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ("hplan.view.page", "hplan.apps.view.page"),
        ("hplan.timing.trajectory", "hplan.trajectory.trajectory"),
        ("hplan.smoothing.spline", "hplan.trajectory.spline"),
        ("hplan.smoothing.repair", "hplan.optimization.repair"),
    ],
)
def test_a_module_of_an_earlier_package_is_no_copy(before: str, now: str) -> None:
    assert present_name(before) == now
    assert importlib.import_module(before) is importlib.import_module(now)


def test_public_names_of_earlier_packages() -> None:
    names = {"orchard": "generate", "robot_family": "ArmSpec", "search": "dense_search", "waypoints": "time_waypoints"}
    assert all(callable(getattr(importlib.import_module(f"hplan.{room}"), name)) for room, name in names.items())


@pytest.mark.parametrize("name", ["hplan.timing.nothing", "hplan.nothing"])
def test_other_names_are_not_found(name: str) -> None:
    assert present_name("hplan.scene.model") is None
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module(name)


def test_a_module_that_was_moved_is_run_by_its_earlier_name() -> None:
    called = subprocess.run(
        [sys.executable, "-m", "hplan.cli", "--version"], capture_output=True, text=True, check=True
    )
    assert called.stdout.startswith("hplan ")
