"""Next-best view: the camera pose showing most unknown space along a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record
from hplan.collision.obstacle_rows import solid_rows
from hplan.online.arm_shape import arm_solids, reach_ball
from hplan.online.body_distances import distances_from_bodies
from hplan.online.hidden_points import CELLS
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid


@dataclass(frozen=True, eq=False)
class NextView(Record):
    """The next-best view (see `hplan.Planner.next_view`).

    Attributes:
        number: Index of the view among the candidates.
        pose: (4, 4) transform from the camera frame to `base_link`.
        shown: Expected fraction of the unknown voxels in `unseen` that the view shows.
        unseen: (k, 3) centres of the unknown voxels that the motion to the goal would sweep [m].
        motion: Certified motion to the view through known space if the arm carries the camera; None otherwise.
    """

    number: int
    pose: FloatArray
    shown: float
    unseen: FloatArray
    motion: PlanResult | None = None


def sweep(robot: Robot, path: FloatArray, step_m: float) -> list[Solid]:
    """The arm's bodies at selected samples of a path.

    Args:
        robot: The robot.
        path: (n, dof) samples.
        step_m: Approximate maximum displacement of any point between selected samples [m].
    """
    lever = max(1.0, 2.0 * float(reach_ball(robot)[3]))
    moved = lever * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).sum(axis=1))])
    rows = np.unique(np.searchsorted(moved, np.append(np.arange(0.0, moved[-1], step_m), moved[-1])))
    return [solid for q in path[rows] for solid in arm_solids(robot, q)]


def shows(
    unseen: FloatArray,
    radius: float,
    pose: FloatArray,
    solids: Sequence[Solid],
    field_of_view_deg: tuple[float, float],
    farthest_m: float,
) -> BoolArray:
    """(k,) mask of the voxels visible to a camera among known solids.

    The whole ball around a voxel must be in the field of view, with a margin of one direction cell
    (`hplan.online.hidden_points`), and no known solid may intersect the cone to it. Unknown space does not occlude,
    since only the view itself can show it.

    Args:
        unseen: (k, 3) centres of the voxels [m].
        radius: Radius of the balls around them [m].
        pose: (4, 4) transform from the camera frame to `base_link`; z points forward, x right, y down.
        solids: The known solids.
        field_of_view_deg: Width and height of the field of view [deg].
        farthest_m: Sensor range [m].
    """
    seen = (unseen - pose[:3, 3]) @ pose[:3, :3]
    away = np.linalg.norm(seen, axis=1)
    spare = np.arcsin(np.minimum(1.0, radius / np.maximum(away, 1e-9))) + 0.5 * math.pi / CELLS
    inside = (seen[:, 2] > 0.0) & (away + radius <= farthest_m)
    for axis, angle_deg in enumerate(field_of_view_deg):
        off = np.abs(np.arctan2(seen[:, axis], seen[:, 2]))
        inside &= off + spare <= math.radians(0.5 * angle_deg)
    rows, data = solid_rows(solids, 0.0)
    found = np.zeros(len(unseen), dtype=np.bool_)
    for number in np.flatnonzero(inside).tolist():
        # Balls that cover the cone, with centres no farther apart than a voxel's radius.
        shares = np.linspace(0.0, 1.0, 2 + math.ceil(away[number] / radius))[:, None]
        points = pose[:3, 3] + shares * (unseen[number] - pose[:3, 3])
        wide = shares[:, 0] * away[number] * np.sin(spare[number])
        found[number] = bool((distances_from_bodies(points, rows, data) > wide).all())
    return found
