"""Design an arm: which link lengths reach a measured tree best? Write that arm as a URDF, and plan with it.

python scripts/examples/design_an_arm.py [ARM.urdf]
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import hplan
from hplan.robot.family import ORCHARD_HARVESTER, load_member, write_robot
from hplan.scene import Goal
from hplan.scene.orchard import MeasuredOptions, measured_orchard

TREE = Path(__file__).parent / "trees" / "apple_1_tallspindle.csv"

#: Lengths of upper arm, forearm and hand, in increasing order [m].
LENGTHS_M = ((0.7, 0.6, 0.3), (0.8, 0.7, 0.4), (0.9, 0.75, 0.4), (1.0, 0.8, 0.4), (1.1, 1.0, 0.4))


def main(urdf: str | None = None) -> hplan.PlanResult:
    """Choose the shortest arm that picks the most fruit, and plan with it.

    It is written to a file and loaded again.
    """
    trees = MeasuredOptions(distance=1.7, wood_yields=0.02, fruit_yields=0.02)
    scene, picked = measured_orchard([TREE], trees), {}
    for lengths in LENGTHS_M:
        spec = replace(ORCHARD_HARVESTER, name="my_arm", link_lengths=lengths)
        fruits = hplan.reachable(load_member(spec), scene)
        picked[spec] = [name for name, fruit in fruits.items() if fruit.can_be_picked]
        print(f"{sum(lengths):.2f} m long: {len(picked[spec])} of {len(fruits)} fruits")
    best = max(picked, key=lambda spec: len(picked[spec]))
    with tempfile.TemporaryDirectory() as folder:
        robot = hplan.load_robot(write_robot(best, urdf or Path(folder) / "my_arm.urdf")[0])
    result = hplan.plan(robot, scene.with_values(goal=Goal(fruit=picked[best][0])))
    duration = result.trajectory.duration
    print(f"{sum(best.link_lengths):.2f} m: {picked[best][0]} and back in {duration:.2f} s, certified")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
