"""Plan a certified motion of a Panda into a shelf.

pip install 'hplan[robots]'
python scripts/examples/panda_shelf.py
"""

from __future__ import annotations

import numpy as np

import hplan
from hplan.errors import PathInContactError
from hplan.scene import Box, Goal, Scene, Start

#: Before the upper board, and between the boards [rad].
START, GOAL = (0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.785), (0.5, 0.55, 0.0, -1.75, 0.0, 2.3, 0.785)


def shelf() -> Scene:
    """Boards and sides of a shelf before the arm."""
    sizes = {"lower board": (0.3, 1.2, 0.02), "upper board": (0.3, 1.2, 0.02), "left side": (0.3, 0.02, 0.8)}
    centers = {"lower board": (0.7, 0.0, 0.05), "upper board": (0.75, 0.0, 0.62), "left side": (0.7, 0.62, 0.35)}
    return Scene(
        name="shelf",
        start=Start(joints_rad=START),
        goal=Goal(joints_rad=GOAL),
        obstacles=tuple(Box(name=name, center=centers[name], size=size) for name, size in sizes.items()),
    )


def main() -> hplan.PlanResult:
    """Plan, and print the contact of a straight motion."""
    robot, scene = hplan.load_robot("panda", hold={"panda_finger_joint1": 0.04}), shelf()
    result = hplan.plan(robot, scene)
    nearest = result.certificate.nearest
    print(f"{result.trajectory.duration:.3f} s, certified; nearest: {nearest}")
    try:
        hplan.finish(robot, scene, np.array([START, GOAL]))
    except PathInContactError as error:
        print(f"the straight motion: {error}")
    return result


if __name__ == "__main__":
    main()
