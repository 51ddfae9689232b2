"""Two arms reach into one row of trees, certified against trees and each other.

python scripts/examples/two_arms.py
"""

from __future__ import annotations

import hplan
from hplan.scene import Goal, Start
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.orchard import TUCKED_DEG
from hplan.workcell.cell import Cell

#: The goal of each arm, and its offset from the middle of the row [m].
FRUITS, ASIDE_M = {"left": "fruit 20", "right": "fruit 19"}, {"left": 0.4, "right": -0.4}


def main() -> hplan.CellResult:
    """Plan both motions on one clock and print how near the arms come to each other."""
    row, robot = hplan.load_scene("orchard-arm-row"), hplan.load_robot("orchard_harvester")
    robots = tuple(
        CellRobot(
            name=name,
            robot=robot.name,
            position=(0.0, ASIDE_M[name], 0.0),
            start=Start(joints_deg=TUCKED_DEG),
            goal=Goal(fruit=fruit),
        )
        for name, fruit in FRUITS.items()
    )
    scene = CellScene(name="two arms", robots=robots, obstacles=row.obstacles, fruits=row.fruits)
    result = hplan.plan_cell(Cell.from_robots(scene, dict.fromkeys(FRUITS, robot)))
    reached = " and ".join(f"{fruit} by the {name} arm" for name, fruit in FRUITS.items())
    print(f"{reached} in {result.trajectory.duration:.2f} s")
    between = result.certificate.between.min_clearance_m
    print(f"certified, moving {result.how}; {1e3 * between:.0f} mm or more between the arms")
    return result


if __name__ == "__main__":
    main()
