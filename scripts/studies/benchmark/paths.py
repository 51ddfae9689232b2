"""Three motions along one path: by the common recipe, by hplan's timing alone, by hplan's post-processing too.

- `spline`: a cubic spline through the waypoints, timed by toppra as its users are advised; not limited in jerk;
- `rounded`: corners rounded within the clearance (`hplan.smoothing.round_corners`), timed and certified by hplan;
- `processed`: hplan's whole post-processing (`hplan.planning.certified_motion.smooth_and_certify`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from studies.benchmark.measure import median, timed
from studies.benchmark.motions import Findings, look_at, toppra_motion

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.planning.certified_motion import smooth_and_certify
from hplan.planning.task import MARGIN, PlanningCache
from hplan.problem.definition import Problem, check_problem
from hplan.problem.options import EffortName, PlanOptions
from hplan.problem.world import World
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.smoothing.round_corners import smooth
from hplan.smoothing.smooth_path import SMALLEST_FRACTION
from hplan.smoothing.spline import SplinePath
from hplan.timing.retime import time_path
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify


@dataclass(frozen=True, eq=False)
class PeerTask:
    """A scene, ready for the peers' planners, and for certifying their paths."""

    robot: Robot
    scene: Scene
    problem: Problem
    field: ClearanceField
    checker: CoalScene
    margin: float

    @classmethod
    def of(cls, robot: Robot, scene: Scene) -> PeerTask:
        """Get a scene ready, with the margin that hplan asks for in it."""
        world = World.of(robot, scene.solids, clearance=scene.clearance)
        problem = check_problem(
            world, scene.start.configuration, scene.goal.configuration, locked_joints=scene.locked_joints
        )
        return cls(robot, scene, problem, world.field, world.checker, min(MARGIN, 0.5 * problem.spare_clearance))

    @property
    def smallest_margin(self) -> float:
        """The margin that hplan accepts at worst, which is what planners are asked to keep [m]."""
        return SMALLEST_FRACTION * self.margin


@dataclass(frozen=True)
class PathMotions:
    """The motions made of a path.

    Attributes:
        length_deg: Length of the path as given.
        spline: Findings about the motion of the common recipe, or None where toppra finds none.
        rounded_s: Duration of the certified motion with rounded corners, or None where there is none.
        processed_s: Duration of the certified motion after hplan's post-processing, or None where there is none.
        spline_ms: Time of the common recipe.
        rounded_ms: Time from the path to the certified motion.
        processed_ms: The same.
    """

    length_deg: float
    spline: Findings | None
    rounded_s: float | None
    processed_s: float | None
    spline_ms: float
    rounded_ms: float
    processed_ms: float


def motions_of(task: PeerTask, path: FloatArray) -> PathMotions:
    """Make motions of a path that is clear at the smallest margin."""
    robot = task.robot
    motion, spline_ms = timed(lambda: toppra_motion(robot, path))
    rounded, rounded_ms = timed(lambda: _certified(task, lambda: smooth(path, task.field, margin=task.smallest_margin)))
    processed, processed_ms = timed(lambda: _duration(processed_motion(task, path)))
    return PathMotions(
        length_deg=float(np.degrees(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())),
        spline=None if motion is None else look_at(robot, task.checker, motion),
        rounded_s=rounded,
        processed_s=processed,
        spline_ms=spline_ms,
        rounded_ms=rounded_ms,
        processed_ms=processed_ms,
    )


def _certified(task: PeerTask, make: Any) -> float | None:
    """Duration of the certified motion along a path, or None where there is none."""
    robot = task.robot
    try:
        path: SplinePath = make()
        trajectory = time_path(path, robot.dynamics, limits_of(robot))
    except HplanError:
        return None
    certificate = certify(robot, task.scene, trajectory, checker=task.checker)
    return trajectory.duration if certificate.verified else None


def processed_motion(task: PeerTask, path: FloatArray, effort: EffortName = "default") -> Trajectory | None:
    """The certified motion that hplan makes of a path, or None where there is none.

    Args:
        task: Arm and scene.
        path: (m, dof) waypoints, clear at the smallest margin.
        effort: What to spend on it.
    """
    context = PlanningCache(task.robot).context(task.scene, PlanOptions(effort=effort))
    asked = replace(context.task(path[0], path[-1]), problem=task.problem)
    try:
        return smooth_and_certify(asked, path, task.margin, "search").trajectory
    except HplanError:
        return None


def _duration(motion: Trajectory | None) -> float | None:
    return None if motion is None else motion.duration


def limits_of(robot: Robot) -> Limits:
    """All limits of a robot."""
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)


def without_jerk(robot: Robot) -> Robot:
    """The robot with no limit on jerk, as the common recipes see it."""
    return replace(robot, jerk_limit=None)


def summary(
    motions: Sequence[PathMotions], path_ms: Sequence[float], hplan_s: Sequence[float], *, asked: int | None = None
) -> dict[str, Any]:
    """Numbers of several paths, one for each problem.

    Args:
        motions: One for each path found.
        path_ms: Time to each path.
        hplan_s: Duration of hplan's motion on the same problem, for the ratios.
        asked: Number of problems, where not all were solved.
    """
    found = [(motion.spline, ours) for motion, ours in zip(motions, hplan_s, strict=True)]
    splines = [(spline, ours) for spline, ours in found if spline is not None]
    result: dict[str, Any] = {
        "problems": len(motions) if asked is None else asked,
        "solved": len(motions),
        "length_deg": median([motion.length_deg for motion in motions]),
        "path_ms": median(path_ms),
        "spline": {
            "duration_s": median([spline.duration_s for spline, _ in splines]),
            "ratio": median([spline.duration_s / ours for spline, ours in splines]),
            "total_ms": median([ms + motion.spline_ms for ms, motion in zip(path_ms, motions, strict=True)]),
            "timed": len(splines),
            "colliding": sum(spline.collides for spline, _ in splines),
            "worst_depth_mm": max((spline.depth_mm for spline, _ in splines), default=0.0),
            "outside_range": sum(spline.leaves_range for spline, _ in splines),
            "worst_outside_deg": max((spline.outside_deg for spline, _ in splines), default=0.0),
            "over_limits": sum(spline.breaks_limits for spline, _ in splines),
            "usable": sum(not (s.collides or s.leaves_range or s.breaks_limits) for s, _ in splines),
        },
    }
    for name in ("rounded", "processed"):
        certified = [(getattr(motion, f"{name}_s"), ours) for motion, ours in zip(motions, hplan_s, strict=True)]
        kept = [(duration, ours) for duration, ours in certified if duration is not None]
        times = [ms + getattr(motion, f"{name}_ms") for ms, motion in zip(path_ms, motions, strict=True)]
        result[name] = {
            "certified": len(kept),
            "duration_s": median([duration for duration, _ in kept]),
            "ratio": median([duration / ours for duration, ours in kept]),
            "best_ratio": min((duration / ours for duration, ours in kept), default=float("nan")),
            "faster_than_hplan": sum(duration < 0.999 * ours for duration, ours in kept),
            "total_ms": median(times),
        }
    return result
