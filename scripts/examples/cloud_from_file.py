"""Plan around a point cloud that a camera has left in a PLY or XYZ file.

    python scripts/examples/cloud_from_file.py [CLOUD.ply]

Without a file a small cloud is made up and written first: a canopy seen from the side.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

import hplan
from hplan.scene import Goal, PointCloud, Scene, Start

#: Half the distance between neighbouring points is covered by a ball about each [m].
RADIUS_M = 0.02


def canopy(path: Path) -> Path:
    """Write a cloud of 2,000 points: foliage in front of the arm."""
    points = np.random.default_rng(1).normal((1.1, 0.0, 1.9), (0.12, 0.25, 0.12), (2000, 3))
    return PointCloud.from_points("canopy", points, RADIUS_M).write(path)


def main(file: str | None = None) -> hplan.PlanResult:
    """Reach past the cloud."""
    with tempfile.TemporaryDirectory() as folder:
        cloud = PointCloud(name="canopy", file=file or str(canopy(Path(folder) / "canopy.ply")), radius=RADIUS_M)
        scene = Scene(
            name="cloud",
            start=Start(joints_deg=(0.0, 90.0, 90.0, 90.0)),
            goal=Goal(joints_deg=(60.0, 20.0, 30.0, 20.0)),
            obstacles=(cloud,),
        )
        result = hplan.plan(hplan.load_robot(), scene)
    print(f"{result.trajectory.duration:.3f} s past {len(cloud.points)} points")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
