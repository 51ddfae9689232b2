from __future__ import annotations

import math

import pytest

from hplan.errors import OptionError
from hplan.scene.orchard import FruitZone, OrchardOptions


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wire_heights": (2.0, 1.0)}, "heights that increase"),
        ({"first_branch": 2.7}, "first_branch = 2.7: expected less than the tree's height, 2.7 m"),
        ({"form": "trellis", "wire_heights": ()}, "a wire below the tree's height"),
        ({"picked": (0,)}, r"picked\[0\] = 0: expected a number between 1 and 24"),
        ({"picked": (3, 3)}, "numbers that differ"),
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
