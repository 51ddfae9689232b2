"""Motions past an obstacle that moves: how many are certified, and how long they take beside waiting and a baseline.

Waiting: the arm stands still until the motion that is planned without what moves is clear of it for good, and then runs
it. The baseline is `studies.benchmark.moving.safe_intervals`, where the base is locked.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from studies.benchmark.measure import Progress, or_error, spread, timed
from studies.benchmark.moving.judge import least_distance
from studies.benchmark.moving.safe_intervals import STEP_DEG, GridMotion, safe_interval_motion
from studies.benchmark.moving.scenes import KINDS, kind_of, moving_scene

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import HplanError
from hplan.moving.obstacles_at import without_moving
from hplan.moving.path_in_time import MovingField, PathInTime
from hplan.moving.schedule import STEP_S
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify


def measure(robot: Robot, *, seed: int, scenes: int, progress: Progress, first: int = 0) -> dict[str, Any]:
    """Measure the set.

    Args:
        robot: The arm.
        seed: Seed of the scenes.
        scenes: Number of scenes that have a motion without what moves.
        progress: Told how far it is.
        first: Number of the first scene.
    """
    rows: list[dict[str, Any]] = []
    for number in itertools.count(first):
        if len(rows) == scenes:
            break
        progress("moving", len(rows), scenes)
        row = _row(robot, moving_scene(robot, seed, number), number)
        if row is not None:
            rows.append(row)
    progress("moving", scenes, scenes)
    return {"seed": seed, "first": first, "step_deg": STEP_DEG, **numbers(rows), "rows": rows}


def numbers(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the rows say in all."""
    found = [row for row in rows if row["outcome"] == "certified"]
    groups = {kind: _group([row for row in rows if row["kind"] == kind]) for kind in KINDS}
    return {
        "scenes": len(rows),
        "groups": {"all": _group(rows), **groups},
        "at_fault": [row["scene"] for row in found if row["clearance_mm"] <= 0.0],
        "refused": [row for row in rows if row["outcome"] != "certified"],
    }


def _group(rows: list[dict[str, Any]]) -> dict[str, Any]:
    found = [row for row in rows if row["outcome"] == "certified"]
    met = [row for row in found if row["in_the_way"]]
    waited = [row for row in met if math.isfinite(row["waiting_s"])]
    grid = [row for row in found if row["grid_s"] is not None]
    met_grid = [row for row in grid if row["in_the_way"]]
    return {
        "scenes": len(rows),
        "certified": len(found),
        "contacts": sum(row["clearance_mm"] <= 0.0 for row in found),
        "in_the_way": sum(row["in_the_way"] for row in rows),
        "could_wait": sum(math.isfinite(row["waiting_s"]) for row in met),
        "how": {key: sum(row["how"] == key for row in met) for key in ("waits", "slows down", "around", "at once")},
        "ms": spread([row["ms"] for row in rows]),
        "duration_s": spread([row["duration_s"] for row in met]),
        "to_waiting": spread([row["duration_s"] / row["waiting_s"] for row in waited]),
        "to_unhindered": spread([row["duration_s"] / row["alone_s"] for row in met]),
        "planar": sum(row["planar"] for row in rows),
        "grid": sum(row["grid_s"] is not None for row in rows if row["planar"]),
        "grid_contacts": sum(row["grid_clearance_mm"] <= 0.0 for row in rows if row["grid_s"] is not None),
        "to_grid": spread([row["duration_s"] / row["grid_s"] for row in met_grid]),
    }


def _row(robot: Robot, scene: Scene, number: int) -> dict[str, Any] | None:
    """One scene; None where there is no motion even without what moves."""
    still = without_moving(scene)
    try:
        alone = plan(robot, still)
    except HplanError:
        return None
    found, ms = timed(lambda: or_error(lambda: plan(robot, scene)))
    planar = bool(scene.locked_joints)
    grid = safe_interval_motion(robot, scene, ClearanceField.of(robot, still.solids)) if planar else None
    row: dict[str, Any] = {
        "scene": scene.name,
        "kind": kind_of(number),
        "planar": planar,
        "alone_s": alone.trajectory.duration,
        "in_the_way": not certify(robot, scene, alone.trajectory).verified,
        "waiting_s": _waiting_s(robot, scene, alone.trajectory),
        "grid_s": None if grid is None else grid.duration,
        "grid_clearance_mm": None
        if grid is None
        else 1e3 * least_distance(robot, scene, _positions(grid), grid.duration, 2e-3),
        "ms": ms,
    }
    if isinstance(found, HplanError):
        return {**row, "outcome": found.kind, "message": found.message}
    motion, told = found.trajectory, found.report["in_time"]
    least = least_distance(robot, scene, motion.positions, motion.duration)
    how = "around" if "around" in told["path"] else "at once"
    how = "waits" if told["waits_s"] > 0.0 else "slows down" if told["slows_down"] else how
    return {
        **row,
        "outcome": "certified" if found.certificate.verified else "not certified",
        "how": how,
        "path": told["path"],
        "duration_s": motion.duration,
        "certified_mm": 1e3 * found.certificate.min_clearance_m,
        "clearance_mm": 1e3 * least,
    }


def _waiting_s(robot: Robot, scene: Scene, motion: Trajectory) -> float:
    """Duration of standing still until a motion is clear for good, and of the motion [s]; infinite for never."""
    field = MovingField(robot, scene, sigmas=3.0, tracking_error=0.0)
    cells = PathInTime(motion, field, robot, step_s=STEP_S, spare_s=0.0)
    last = math.ceil(max(0.0, field.at_rest_s) / STEP_S) + 1
    clear = [cells.clear(row) for row in range(last + 1)]
    if not clear[-1].all():
        return math.inf
    blocked = [row for row in range(last + 1) if not clear[row].all()]
    goes = blocked[-1] + 1 if blocked else 0
    if not all(clear[row][0] for row in range(goes)):
        return math.inf
    return goes * STEP_S + motion.duration


def _positions(grid: GridMotion) -> Callable[[FloatArray], FloatArray]:
    """Configurations of a motion from node to node, over time."""
    return lambda clock: np.array([np.interp(clock, grid.time, column) for column in grid.position.T]).T
