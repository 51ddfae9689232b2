"""Time a path of any robot that Pinocchio reads: a UR5's waypoints, corners rounded, at the joints' limits.

pip install 'hplan[robots]'
python scripts/examples/time_ur5_path.py
"""

from __future__ import annotations

import numpy as np

import hplan
from hplan.trajectory import limits_of, read_kinematics, time_waypoints

WAYPOINTS_DEG = ((0, -90, 0, 0, 0, 0), (45, -60, 60, -90, 0, 0), (90, -90, 90, -90, -90, 0), (90, -120, 60, 0, -90, 90))


def main() -> hplan.Trajectory:
    """Time the path and print its duration."""
    ur5, _ = read_kinematics("ur5")
    trajectory = time_waypoints(ur5, np.radians(WAYPOINTS_DEG), limits_of(ur5, acceleration=8.0))
    print(f"{trajectory.duration:.3f} s, {trajectory.samples} rows at 250 Hz")
    return trajectory


if __name__ == "__main__":
    main()
