"""From where a camera sees most of what a motion would sweep and nobody has seen."""

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
    """A view that is worth taking (`hplan.Planner.next_view`).

    Attributes:
        number: Which of the views it is.
        pose: (4, 4) camera to `base_link` there.
        shown: Share of the voxels not known that it is expected to show.
        unseen: (k, 3) middles of the voxels not known that the motion to the goal would sweep [m].
        motion: Certified motion there through known space, where the arm carries the camera; else None.
    """

    number: int
    pose: FloatArray
    shown: float
    unseen: FloatArray
    motion: PlanResult | None = None


def sweep(robot: Robot, path: FloatArray, step_m: float) -> list[Solid]:
    """The arm's bodies along a (n, dof) path, at those of its rows between which no point moves farther than a step."""
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
    """(k,) mask of the voxels that a camera would look through, past what is known to be there.

    All of a voxel's ball has to be in the field of view, with a cell of directions (`hplan.online.hidden_points`) to
    spare, and nothing known in the cone to it. What is not known hides nothing: that is found out by looking.

    Args:
        unseen: (k, 3) middles of the voxels [m].
        radius: Of the balls about them [m].
        pose: (4, 4) camera to `base_link`; z looks ahead, x to the right, y down.
        solids: What is known to be there.
        field_of_view_deg: Its width and height [deg].
        farthest_m: How far it measures [m].
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
        # Balls that hold the cone, their middles no farther apart than a voxel's radius.
        shares = np.linspace(0.0, 1.0, 2 + math.ceil(away[number] / radius))[:, None]
        points = pose[:3, 3] + shares * (unseen[number] - pose[:3, 3])
        wide = shares[:, 0] * away[number] * np.sin(spare[number])
        found[number] = bool((distances_from_bodies(points, rows, data) > wide).all())
    return found
