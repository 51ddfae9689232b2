"""From a frame of a depth camera to a certified motion, among trees.

The shipped orchards, and measured trees where a folder of them is given, stand before a camera beside the arm
(`studies.benchmark.depth_camera`), on a floor, the arm in the picture. The planner knows the floor and where the arm
is; wood and fruit it knows from frames alone. To each of a few stand-offs of fruits that have `ROOM_M` it plans a
motion with the first frame, and again with every frame that comes: the same picture with other noise. The clock begins
with the array and ends with the certified motion, or with the answer that there is none within `DEADLINE_S`.

Balls are as large as the gaps between pixels, and outliers are looked for within three of these; but no smaller than
`RADIUS_M` and `NEAR_M`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from studies.benchmark.depth_camera import DepthCamera, camera_of, ground
from studies.benchmark.measure import Progress, median, or_error, spread, timed
from studies.benchmark.orchard_scenes import DISTANCES, Orchard, crop_of, measured_orchard, shipped_orchards

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.online.planner import Planner
from hplan.perception.arm_shape import arm_solids
from hplan.perception.frame import CloudOptions, FrameReport
from hplan.planning.plan import PlanResult
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Solid

#: Returns of a frame, about.
SIZES, QUICK_SIZES = (10_000, 100_000, 300_000, 1_000_000), (10_000,)

#: Frames of each motion, the first one among them; and motions in each orchard.
FRAMES, GOALS = 4, 4
QUICK_FRAMES, QUICK_GOALS = 2, 1

#: Least radius of the ball about each point, and least distance within which a point has others about it [m].
RADIUS_M, NEAR_M = 5e-3, 8e-3

#: A point with fewer about it, itself counted, is an outlier.
LEAST_POINTS = 3

#: Clearance of a goal from true wood and fruit [m]; balls and noise take up to half of it.
ROOM_M = 0.03

#: How long a plan may take [s].
DEADLINE_S = 1.0

#: What the trees' distance from the camera is taken to be [m].
_RANGE_M = 1.5

#: Random configurations at which distances are timed.
_LOOKS = 300


def measure(
    robot: Robot, *, trees: Path | None, most: int | None, seed: int, quick: bool, progress: Progress
) -> dict[str, Any]:
    """Measure the camera set.

    Args:
        robot: The arm.
        trees: Folder of measured trees; None for the shipped orchards alone.
        most: Orchards; None for all.
        seed: Seed of the noise.
        quick: Small frames alone.
        progress: Told how far it is.
    """
    orchards = shipped_orchards()
    if trees is not None:
        orchards += [measured_orchard(robot, file, DISTANCES[0]) for file in sorted(trees.glob("*.csv"))]
    orchards = orchards[:most]
    rows: list[dict[str, Any]] = []
    sizes, frames = (QUICK_SIZES, QUICK_FRAMES) if quick else (SIZES, FRAMES)
    for number, orchard in enumerate(orchards):
        goals = _goals(robot, orchard)[: QUICK_GOALS if quick else GOALS]
        for place, size in enumerate(sizes):
            progress("camera", number * len(sizes) + place, len(orchards) * len(sizes))
            if not rows:
                _walk(robot, orchard, goals[:1], size, seed, frames)  # what only this needs is loaded
            rows += _walk(robot, orchard, goals, size, seed, frames)
    progress("camera", len(orchards) * len(sizes), len(orchards) * len(sizes))
    return {
        "seed": seed,
        "orchards": len(orchards),
        "growth_m": CloudOptions().growth_m,
        "sizes": {str(size): numbers([row for row in rows if row["size"] == size]) for size in sizes},
        "rows": rows,
    }


def numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Medians of the frames of one size."""
    first, later = ([row for row in rows if (row["frame"] == 0) == begins] for begins in (True, False))
    moving = [row for row in later if row["certified"]]
    return {
        "frames": len(rows),
        "certified": sum(row["certified"] for row in rows),
        "contacts": sum(row["true_clearance_mm"] < 0.0 for row in rows if row["certified"]),
        **{
            key: median([row[key] for row in rows])
            for key in ("rows", "returns", "balls", "radius_mm", "growth_mm", "query_us")
        },
        **{key: median([row[key] for row in moving]) for key in ("filter_ms", "structure_ms", "plan_ms")},
        "total_ms": spread([row["total_ms"] for row in moving]),
        "first_ms": spread([row["total_ms"] for row in first if row["certified"]]),
        "refused_ms": spread([row["total_ms"] for row in rows if not row["certified"]]),
    }


def camera_with(returns: int, truth: Sequence[Solid]) -> DepthCamera:
    """A camera of as many pixels as it takes to see about so many points."""
    seen = float(np.isfinite(camera_of(10_000).depths(truth)).mean())
    return camera_of(math.ceil(returns / seen))


def _goals(robot: Robot, orchard: Orchard) -> list[FloatArray]:
    """Stand-offs of fruits with room."""
    field = ClearanceField.of(robot, orchard.scene.solids_with_goal)
    return [goal for goal in crop_of(robot, orchard).goals.values() if field.clearance(goal) > ROOM_M]


def _walk(
    robot: Robot, orchard: Orchard, goals: Sequence[FloatArray], size: int, seed: int, frames: int
) -> list[dict[str, Any]]:
    """All frames of one orchard."""
    q = orchard.scene.start.configuration
    truth = orchard.scene.solids_with_goal
    in_view = [*truth, ground(), *arm_solids(robot, q)]
    camera, random, rows = camera_with(size, in_view), np.random.default_rng([seed, size]), []
    field = ClearanceField.of(robot, truth)
    for goal in goals:
        watch = _Watch(robot, orchard.scene.start, goal, camera)
        for number in range(frames):
            row = {"orchard": orchard.name, "size": size, "frame": number, **watch.take(camera.frame(in_view, random))}
            found = watch.planner.last if row["certified"] else None
            clearance = math.nan if found is None else float(field.along(found.trajectory.position).min())
            query_us = _query_us(robot, watch.planner.scene, random)
            rows.append({**row, "true_clearance_mm": 1e3 * clearance, "query_us": query_us})
    return rows


class _Watch:
    """A planner that goes to one goal and takes frames of one camera."""

    def __init__(self, robot: Robot, start: Start, goal: FloatArray, camera: DepthCamera) -> None:
        there = Goal(joints_rad=tuple(goal.tolist()))
        scene = Scene(name="camera", start=start, goal=there, obstacles=(ground(),))
        self.planner = Planner(robot, scene, PlanOptions(effort="quick", deadline_s=DEADLINE_S))
        self._camera, self._q = camera, start.configuration
        gap = 2.0 * _RANGE_M * math.tan(math.radians(0.5 * camera.view_deg)) / camera.width
        self._radius = max(RADIUS_M, gap / math.sqrt(2.0))
        self._options = CloudOptions(least_points=LEAST_POINTS, neighbour_m=max(NEAR_M, 3.0 * gap))

    def take(self, points: Any) -> dict[str, Any]:
        """Numbers of one frame."""
        report, filter_ms = timed(lambda: self._filter(points))
        _, structure_ms = timed(lambda: self.planner.scene.solids)
        found, plan_ms = timed(lambda: or_error(self.planner.replan))
        return {
            "rows": report.given,
            "returns": report.given - report.not_finite,
            "balls": report.kept,
            "radius_mm": 1e3 * report.radius_m,
            "growth_mm": 1e3 * report.growth_m,
            "filter_ms": filter_ms,
            "structure_ms": structure_ms,
            "plan_ms": plan_ms,
            "total_ms": filter_ms + structure_ms + plan_ms,
            "certified": isinstance(found, PlanResult),
            "outcome": found.motion.origin if isinstance(found, PlanResult) else found.kind,
        }

    def _filter(self, points: Any) -> FrameReport:
        return self.planner.set_cloud(
            "seen", points, radius=self._radius, pose=self._camera.pose, joints=self._q, ignore=("ground",),
            options=self._options,
        )  # fmt: skip


def _query_us(robot: Robot, scene: Scene, random: np.random.Generator) -> float:
    """Time of the distances of all links at one configuration, among the balls alone [us]."""
    field = ClearanceField.of(robot, [solid for solid in scene.solids if solid.name == "seen"])
    looks = random.uniform(robot.lower, robot.upper, (_LOOKS, robot.dof))
    field.along(looks[:10])
    return 1e3 * timed(lambda: field.along(looks))[1] / _LOOKS
