from __future__ import annotations

import math

import numpy as np
import pytest

from hplan.errors import OptionError
from hplan.scene.orchard import FruitZone, OrchardOptions


def test_numbers_of_any_kind_are_kept_as_plain_ones():
    options = OrchardOptions(trees=np.int64(2), spacing=1, stem=np.float32(0.5) / 4, wire_heights=[1, 2])
    assert (options.trees, options.spacing, options.stem, options.wire_heights) == (2, 1.0, 0.125, (1.0, 2.0))
    assert [type(value) for value in (options.trees, options.spacing, options.stem)] == [int, float, float]
    assert options == OrchardOptions(trees=2, spacing=1.0, stem=0.125, wire_heights=(1.0, 2.0))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0, 1e9, "1", None, True, [1.0]])
@pytest.mark.parametrize(
    "option",
    [
        "spacing",
        "distance",
        "tree_height",
        "trunk_radius",
        "branch_length",
        "first_branch",
        "wire_radius",
        "fruit_radius",
        "stem",
        "clearance",
    ],
)
def test_measures_out_of_range(option, value):
    with pytest.raises(OptionError, match=rf"^{option} = .*: expected a number between") as caught:
        OrchardOptions(**{option: value})
    assert caught.value.option == option


@pytest.mark.parametrize("value", [-1, 1.0, math.nan, "1", None, True])
@pytest.mark.parametrize("option", ["seed", "trees", "branches", "shoots", "fruits"])
def test_counts_out_of_range(option, value):
    with pytest.raises(OptionError, match=rf"^{option} = .*: expected a whole number >= [01]"):
        OrchardOptions(**{option: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"trees": 0}, "trees = 0: expected a whole number >= 1 and <= 100"),
        ({"trees": 10**400}, "<= 100"),
        ({"spacing": 10**400}, "expected a number between 0.2 and 10"),
        ({"fruits": 0}, "fruits = 0"),
        ({"name": ""}, "a text that is not empty"),
        ({"name": 3}, "a text that is not empty"),
        ({"form": "bush"}, "form = 'bush': expected one of spindle, trellis"),
        ({"posts": 1}, "posts = 1: expected True or False"),
        ({"vehicle": "no"}, "vehicle = 'no'"),
        ({"fruit_zone": (0, 1, 2)}, "a FruitZone"),
        ({"wire_heights": 1.0}, "wire_heights = 1.0: expected a list of numbers"),
        ({"wire_heights": "12"}, "wire_heights = '12': expected a list of numbers"),
        ({"wire_heights": (1.0, math.nan)}, r"wire_heights\[1\] = nan"),
        ({"wire_heights": (1.0, 1.0)}, "heights that increase"),
        ({"wire_heights": (2.0, 1.0)}, "heights that increase"),
        ({"first_branch": 2.7}, "first_branch = 2.7: expected less than the tree's height, 2.7 m"),
        ({"form": "trellis", "wire_heights": ()}, "a wire below the tree's height"),
        ({"form": "trellis", "wire_heights": (2.7,)}, "a wire below the tree's height"),
        ({"picked": (0,)}, r"picked\[0\] = 0: expected a number between 1 and 24"),
        ({"picked": (25,)}, r"picked\[0\] = 25"),
        ({"picked": (3, 3)}, "numbers that differ"),
        ({"picked": (1.5,)}, "whole number"),
        ({"fruits": 2, "picked": (1, 2)}, "fewer than 2"),
    ],
)
def test_options_that_make_no_orchard(changes, message):
    with pytest.raises(OptionError, match=message):
        OrchardOptions(**changes)


def test_zone():
    zone = FruitZone(1.0, 2.0, 1.5)
    assert zone.holds(0.9, -1.2, 1.0)
    assert zone.holds(0.0, 0.0, 2.0)
    assert not zone.holds(0.0, 0.0, 0.999)
    assert not zone.holds(0.0, 0.0, 2.001)
    assert not zone.holds(0.9, -1.21, 1.5)
    assert FruitZone().holds(-1000.0, 1000.0, -1000.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((2.0, 1.0), "high = 1.0: expected more than low, 2 m"),
        ((1.0, 1.0), "more than low"),
        ((math.nan, 1.0), "low = nan"),
        ((0.0, math.inf), "high = inf"),
        ((0.0, 1.0, 0.0), "reach = 0.0"),
        ((0.0, 1.0, -1.0), "reach = -1.0"),
    ],
)
def test_zones_that_hold_nothing(values, message):
    with pytest.raises(OptionError, match=message):
        FruitZone(*values)
