"""Pick several fruits in the fastest order, with a drop-off after every second one.

python scripts/examples/picking_tour.py
"""

from __future__ import annotations

import hplan
from hplan.scene import Goal

FRUITS = ("fruit 01", "fruit 04", "fruit 09")


def main() -> hplan.TourResult:
    """Plan the tour and print its legs."""
    scene = hplan.load_scene("tour")
    scene = scene.with_values(fruits=tuple(fruit for fruit in scene.fruits if fruit.name in FRUITS))
    options = hplan.TourOptions(drop_off=Goal(joints_deg=(0.0, 90.0, 90.0, 0.0)), every=2)
    result = hplan.plan_tour(hplan.load_robot(), scene, tour=options)
    for leg in result.legs:
        print(f"{leg.begin_s:6.2f} s  {leg.fruit or 'back'}: {', '.join(phase.name for phase in leg.phases)}")
    print(f"{result.trajectory.duration:.2f} s in all")
    return result


if __name__ == "__main__":
    main()
