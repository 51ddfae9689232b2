"""Certify a motion along a given path, or report its contacts.

python scripts/examples/finish_a_path.py [WAYPOINTS.csv]
"""

from __future__ import annotations

import sys

import numpy as np

import hplan
from hplan.errors import PathInContactError
from hplan.trajectory import read_waypoints

#: Around the ball of the reference scene, folded, and the same without the waypoint that leads around it [rad].
AROUND = np.radians([(0, 0, 0, 0), (0, 0, 90, 90), (0, 45, 60, 70)])
THROUGH = AROUND[[0, -1]]


def main(file: str | None = None) -> hplan.PlanResult:
    """Try the path that touches, then finish the other one."""
    robot, scene = hplan.load_robot(), hplan.load_scene()
    waypoints = AROUND if file is None else read_waypoints(file, robot.joint_names)
    try:
        hplan.finish(robot, scene, THROUGH)
    except PathInContactError as error:
        print(f"refused: {error}")
    result = hplan.finish(robot, scene, waypoints)
    clearance = 1e3 * result.certificate.min_clearance_m
    print(f"certified: {result.trajectory.duration:.3f} s, {clearance:.1f} mm or more at all times")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
