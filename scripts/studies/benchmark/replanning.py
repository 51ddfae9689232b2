"""Replanning while one of many obstacles moves at a time, beside planning the same scene from nothing.

The clock of a replan covers telling the planner what has moved, and ends with the certified motion. Planning from
nothing is `hplan.plan` on the scene as it then is. Steps without a motion are kept apart: they have times of their own.
After one the obstacle goes back to where it was; else most of the steps that follow would ask the same again.

Every scene is planned once before the clock runs: some kernels are needed so seldom that no other first call loads
them, and whatever plans first gets from the system the memory that the next one finds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
from studies.benchmark.measure import Progress, or_error, spread, timed
from studies.benchmark.motions import look_at, of_rows
from studies.benchmark.moving_scenes import CLOSE_SHARE, OBSTACLES, ROOM, SHIFT, ObstacleMove, moving_scene, next_move

from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError, NoPathError
from hplan.online.planner import Planner
from hplan.planning.certified_motion import Origin
from hplan.planning.plan import PlanResult, plan
from hplan.robot.model import Robot

#: Steps of each scene.
STEPS, QUICK_STEPS = 50, 5

#: What becomes of a motion is told by its origin; these are steps without one.
NO_PATH, FAILED = "no_path", "failed"
OUTCOMES: tuple[str, ...] = (*get_args(Origin), NO_PATH, FAILED)

#: A motion is counted as longer from this many times the other's duration on.
LONGER = 1.02


def measure(robot: Robot, *, seed: int, scenes: int, quick: bool, progress: Progress) -> dict[str, Any]:
    """Measure the replanning set.

    Args:
        robot: The arm.
        seed: Seed of the scenes and of what moves.
        scenes: Number of scenes that have a motion before anything moves.
        quick: Few steps.
        progress: Told how far it is.
    """
    steps = QUICK_STEPS if quick else STEPS
    rows: list[dict[str, Any]] = []
    drawn = done = 0
    while done < scenes:
        progress("replanning", done, scenes)
        walked = _walk(robot, seed, drawn, steps)
        if walked is not None:
            # The first time loads what only replanning needs.
            rows += walked if done else _walk(robot, seed, drawn, steps) or []
            done += 1
        drawn += 1
    progress("replanning", scenes, scenes)
    return {
        "seed": seed,
        "scenes": scenes,
        "drawn": drawn,
        "obstacles": OBSTACLES,
        "steps_each": steps,
        "close_share": CLOSE_SHARE,
        "shift_m": SHIFT,
        "room_m": ROOM,
        **numbers(rows),
        "rows": rows,
    }


def _walk(robot: Robot, seed: int, number: int, steps: int) -> list[dict[str, Any]] | None:
    """The steps of a scene; None where there is no motion to begin with."""
    planner = Planner(robot, moving_scene(robot, seed, number))
    try:
        last = planner.plan()
    except HplanError:
        return None
    random = np.random.default_rng([seed, number, 1])
    rows = []
    for step in range(steps):
        before, last = planner.scene, planner.last or last
        move = next_move(robot, before, last.trajectory.position, random)
        rows.append({"scene": number, "step": step, **_step(robot, planner, move)})
        if rows[-1]["outcome"] in (NO_PATH, FAILED):
            planner.scene = before
    return rows


def _step(robot: Robot, planner: Planner, move: ObstacleMove) -> dict[str, Any]:
    """One obstacle moves, and both ways of planning answer."""

    def from_nothing() -> PlanResult | HplanError:
        return or_error(lambda: plan(robot, planner.scene))

    _, moving_ms = timed(lambda: planner.move(move.piece.name, **move.changes))
    from_nothing()
    again, again_ms = timed(lambda: or_error(planner.replan))
    anew, anew_ms = timed(from_nothing)
    ms = moving_ms + again_ms
    row: dict[str, Any] = {
        "close": move.close,
        "outcome": _name(again),
        "ms": ms,
        "from_nothing": _name(anew),
        "from_nothing_ms": anew_ms,
        "ratio": anew_ms / ms,
        "to_from_nothing": float("nan"),
    }
    if isinstance(again, HplanError):
        return {**row, "error": again.kind, "message": again.message}
    seen = look_at(robot, CoalScene(robot, planner.scene.solids), of_rows(again.trajectory))
    row |= {
        "certified": again.certificate.verified,
        "collides": seen.collides,
        "clearance_mm": 1e3 * again.certificate.min_clearance_m,
        "duration_s": again.trajectory.duration,
    }
    if not isinstance(anew, HplanError):
        row["to_from_nothing"] = again.trajectory.duration / anew.trajectory.duration
    return row


def _name(found: PlanResult | HplanError) -> str:
    if isinstance(found, HplanError):
        return NO_PATH if isinstance(found, NoPathError) else FAILED
    return found.motion.origin


def numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of all steps, by what became of the motion, and by how the obstacle moved."""
    moved = [row for row in rows if "certified" in row]
    by_outcome = {name: [row for row in rows if row["outcome"] == name] for name in OUTCOMES}
    everything = _group(moved)
    return {
        "steps": len(rows),
        "replanned": len(moved),
        "certified": sum(row["certified"] for row in moved),
        "colliding": sum(row["collides"] for row in moved),
        "at_fault": [_where(row) for row in moved if row["collides"] or not row["certified"]],
        "per_second": 1e3 / everything["ms"]["median"],
        "outcomes": dict(Counter(row["outcome"] for row in rows)),
        "in_all_s": 1e-3 * sum(row["ms"] for row in rows),
        "in_all_from_nothing_s": 1e-3 * sum(row["from_nothing_ms"] for row in rows),
        "all": everything,
        "by_outcome": {name: _group(chosen) for name, chosen in by_outcome.items() if chosen},
        "by_move": {
            name: _group([row for row in moved if row["close"] == close])
            for name, close in (("shifted", False), ("close", True))
        },
        "only_replanned": [_where(row) for row in moved if row["from_nothing"] in (NO_PATH, FAILED)],
        "only_from_nothing": [
            _where(row)
            for row in rows
            if row["outcome"] in (NO_PATH, FAILED) and row["from_nothing"] not in (NO_PATH, FAILED)
        ],
        "failed": [{"number": _where(row), "kind": row["error"], **row} for row in by_outcome[FAILED]],
    }


def _where(row: dict[str, Any]) -> str:
    return f"{row['scene']}.{row['step']}"


def _group(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    durations = [row["to_from_nothing"] for row in rows if np.isfinite(row["to_from_nothing"])]
    return {
        "steps": len(rows),
        "ratio": spread([row["ratio"] for row in rows]),
        "ms": spread([row["ms"] for row in rows]),
        "from_nothing_ms": spread([row["from_nothing_ms"] for row in rows]),
        "to_from_nothing": {
            **spread(durations),
            "count": len(durations),
            "longer": sum(ratio > LONGER for ratio in durations),
            "shorter": sum(ratio * LONGER < 1.0 for ratio in durations),
        },
    }
