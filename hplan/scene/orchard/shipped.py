"""Generator options of the shipped orchard scenes."""

from __future__ import annotations

from typing import Final

from hplan.scene.orchard.options import REACHED, FruitZone, OrchardOptions

_ORCHARDS = (
    OrchardOptions(name="orchard-row", seed=1),
    OrchardOptions(
        name="trellis",
        seed=2,
        form="trellis",
        tree_height=2.4,
        branches=28,
        branch_length=0.3,
        shoots=1,
        wire_heights=(0.6, 1.05, 1.5, 1.95),
    ),
    OrchardOptions(
        name="dense-canopy",
        seed=3,
        spacing=1.0,
        branches=30,
        branch_length=0.7,
        shoots=3,
        fruits=45,
        posts=False,
        goal="fruit 18",
    ),
    OrchardOptions(
        name="tour",
        seed=4,
        form="trellis",
        tree_height=2.2,
        branches=28,
        branch_length=0.3,
        shoots=0,
        wire_heights=(0.6, 1.05, 1.5, 1.95),
        fruits=46,
        fruit_zone=FruitZone(1.4, 2.05, 1.7),
        # The remaining fruits are reachable: each has a collision-free motion with the base turned towards it first.
        picked=(4, 5, 7, 9, 11, 14, 15, 16, 17, 18, 20, 21, 22, 24, 25, 26, 27, 30, 33, 34, 36, 37, 39, 40, 42, 46),
        vehicle=True,
    ),
    # For the arm that bends both ways: fruit from knee height to above the trees' middle, with the ground.
    OrchardOptions(
        name="orchard-arm-row",
        robot="orchard_harvester",
        seed=5,
        distance=1.35,
        first_branch=0.45,
        branches=16,
        branch_length=0.5,
        shoots=1,
        fruits=26,
        fruit_zone=REACHED["orchard_harvester"],
        ground=True,
        goal="fruit 20",
    ),
    OrchardOptions(
        name="orchard-arm-tour",
        robot="orchard_harvester",
        seed=8,
        form="trellis",
        distance=1.35,
        tree_height=2.3,
        branches=24,
        branch_length=0.3,
        shoots=0,
        wire_heights=(0.5, 0.95, 1.4, 1.85),
        fruits=22,
        fruit_zone=REACHED["orchard_harvester"],
        ground=True,
        vehicle=True,
    ),
)

#: Options of each shipped orchard, by the name of its scene; `generate` gives the scene.
SHIPPED: Final[dict[str, OrchardOptions]] = {options.name: options for options in _ORCHARDS}
