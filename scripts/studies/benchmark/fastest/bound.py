"""Lower bounds of durations beside certified motions: none may be above one, and how near they are.

Planar problems of several kinds, in turn: discs about the arm with narrow joint ranges and about the one with wide
ranges, some with a clearance to keep, and corners between balls for both and for drawn members of the family. All are
planned by default; some again with the best effort, whose motions the same bound must not exceed either.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, peak_memory_mb, spread, timed
from studies.benchmark.narrow.scenes import ARMS, ROOMS, narrow_problem
from studies.benchmark.scenes import random_scene

from hplan.errors import BoundError, HplanError
from hplan.lower_bound.duration_bound import ENOUGH, DurationBound, duration_bound
from hplan.planning.certified_motion import motion_limits
from hplan.planning.plan import PlanResult, plan
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene

#: Kinds of problems in turn: discs about an arm, or pinches.
KINDS = ("harvester", "pinch", "harvester", "pinch", "harvester", "orchard_harvester", "harvester")

#: Clearances to keep of scenes of discs, in turn [m].
CLEARANCES = (0.0, 0.0, 0.02)

#: Each one of so many is planned with the best effort too, and bounded as well as can be.
BEST_EVERY = 5


def measure(robot: Robot, scene: Scene, *, seed: int, scenes: int, progress: Progress) -> dict[str, Any]:
    """Measure the bound set.

    Args:
        robot: The arm of the reference scene.
        scene: The reference scene.
        seed: Seed of the problems.
        scenes: Number of certified motions that are bounded; problems without one are passed over.
        progress: Told how far it is.
    """
    reference = _reference(robot, scene)
    rows: list[dict[str, Any]] = []
    number = refused = 0
    while len(rows) < scenes:
        progress("bound", len(rows), scenes)
        row = _row(seed, number)
        if row is None:
            refused += 1
        else:
            rows.append(row)
        number += 1
    progress("bound", scenes, scenes)
    return {
        "seed": seed,
        "scenes": scenes,
        "refused": refused,
        "violations": [row["number"] for row in rows if not row["holds"]],
        "best_checked": sum(row["best_s"] is not None for row in rows),
        "reference": reference,
        "groups": {
            name: _numbers([row for row in rows if name in ("all", row["kind"], row["method"])])
            for name in ("all", *dict.fromkeys(KINDS), "joints", "planar")
        },
        "rows": rows,
    }


def problem(seed: int, number: int) -> tuple[Robot, Scene, str]:
    """Arm, scene and kind of a problem, from the seed and its number alone."""
    kind = KINDS[number % len(KINDS)]
    if kind == "pinch":
        turn = number // len(KINDS)
        pinch = narrow_problem(seed, number, kind, ARMS[turn % len(ARMS)], ROOMS[turn // len(ARMS) % len(ROOMS)])
        return pinch.robot, pinch.scene, kind
    robot = load_robot(kind)
    clearance = CLEARANCES[number // len(KINDS) % len(CLEARANCES)]
    return robot, random_scene(robot, seed, number).scene.model_copy(update={"clearance": clearance}), kind


def _bound(result: PlanResult, enough: float = ENOUGH) -> DurationBound:
    task, duration_s = result.motion.task, result.motion.trajectory.duration
    return duration_bound(task.world, task.problem, motion_limits(task), duration_s, enough=enough)


def _reference(robot: Robot, scene: Scene) -> dict[str, Any]:
    """The bound of the reference scene, its time and its memory."""
    result = plan(robot, scene)
    _bound(result)
    bound, ms = timed(lambda: _bound(result))
    _, memory_mb = peak_memory_mb(lambda: _bound(result))
    return {**_facts(bound), "ms": ms, "memory_mb": memory_mb}


def _facts(bound: DurationBound) -> dict[str, Any]:
    return {**vars(bound), "gap": bound.gap}


def _row(seed: int, number: int) -> dict[str, Any] | None:
    """One problem; None where no motion is found and certified."""
    robot, scene, kind = problem(seed, number)
    try:
        result = plan(robot, scene)
    except HplanError:
        return None
    row: dict[str, Any] = {"number": number, "kind": kind, "best_s": None}
    again = number % BEST_EVERY == 0
    try:
        bound, ms = timed(lambda: _bound(result, 0.0 if again else ENOUGH))
    except BoundError:
        return {**row, "holds": False, "method": "planar", "gap": float("nan"), "ms": float("nan")}
    durations = [bound.duration_s]
    if again:
        row["best_s"] = plan(robot, scene, PlanOptions(effort="best")).trajectory.duration
        durations.append(row["best_s"])
    return {**row, **_facts(bound), "ms": ms, "holds": bound.seconds <= min(durations)}


def _numbers(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Gaps and times of some problems."""
    kept = [row for row in rows if np.isfinite(row["gap"])]
    return {
        "motions": len(rows),
        "gap": spread([row["gap"] for row in kept]),
        "joints_gap": spread([row["duration_s"] / row["joints_s"] - 1.0 for row in kept if row["joints_s"] > 0.0]),
        "ms": spread([row["ms"] for row in kept]),
    }
