from __future__ import annotations

import pytest

from hplan.errors import OptionError
from hplan.scene.orchard import FruitZone, OrchardOptions


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
