"""Splices and stops of a running motion while something crosses its way: judged by coal in time, and by differences.

The arm goes to and fro in the scenes of `studies.benchmark.moving.scenes`. Every so often what moves there is replaced
by another track, which passes close to a link at a moment at which the running motion may be there, or the goal is the
other one; the planner is asked for what comes next from a time shortly ahead on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from studies.benchmark.in_motion import AHEAD_S, PAUSE_S, replanned, seam_row, splice_jumps, splice_outcome
from studies.benchmark.measure import Progress, or_error, spread, timed
from studies.benchmark.moving.judge import least_distance
from studies.benchmark.moving.scenes import MOMENT, ROOM, kind_of, moving_scene, passing_near

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.collision.moving_solids import MovingSolids
from hplan.errors import HplanError, ObstacleInTimeError, RunningMotionBlockedError
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.planning.plan import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import REST, certify
from hplan.verification.moving_obstacles import moving_base_contacts

#: Steps of each scene, and the share of them with a new goal.
STEPS, TURNING = 12, 0.5


def measure(robot: Robot, *, seed: int, scenes: int, progress: Progress, first: int = 0) -> dict[str, Any]:
    """Measure splices and stops among tracks.

    Args:
        robot: The arm.
        seed: Seed of the scenes and of what crosses.
        scenes: Number of scenes.
        progress: Told how far it is.
        first: Number of the first scene.
    """
    rows: list[dict[str, Any]] = []
    for number in range(first, first + scenes):
        progress("splices among tracks", number - first, scenes)
        rows += walk(robot, seed, number)
    progress("splices among tracks", scenes, scenes)
    return {"seed": seed, "first": first, "scenes": scenes, **numbers(rows), "rows": rows}


def walk(robot: Robot, seed: int, number: int, steps: int = STEPS) -> list[dict[str, Any]]:
    """The steps of a scene; none where there is no motion to begin with."""
    planner = Planner(robot, moving_scene(robot, seed, number))
    scene, random = planner.scene, np.random.default_rng([seed, number, 3])
    ends = tuple(tuple(end.configuration.tolist()) for end in (scene.start, scene.goal))
    rows: list[dict[str, Any]] = []
    try:
        running: PlanResult | None = planner.plan()
        now = 0.0
        while running is not None and len(rows) < steps:
            rows.append({"scene": number, "kind": kind_of(number), "step": len(rows)})
            rows[-1] |= _step(robot, planner, running, (now, ends, number), random)
            now, running = rows[-1].pop("now"), planner.last
            if running is not None and now > running.trajectory.duration - PAUSE_S[0]:
                now, running = 0.0, _begun(planner, running, ends)
    except HplanError:
        return rows  # no motion to go on with
    return rows


def _begun(planner: Planner, ended: PlanResult, ends: Sequence[tuple[float, ...]]) -> PlanResult:
    """A new motion from where one has ended, to the farther end."""
    q = ended.trajectory.position[-1]
    goal = Goal(joints_rad=_farther(ends, q))
    planner.aim(start=Start(joints_rad=tuple(q.tolist())), goal=goal)
    return planner.plan(begins_s=ended.begins_s + ended.trajectory.duration)


def _farther(ends: Sequence[tuple[float, ...]], q: FloatArray) -> tuple[float, ...]:
    """The end that is farther from a configuration."""
    return max(ends, key=lambda end: float(np.abs(np.array(end) - q).max()))


def _step(
    robot: Robot,
    planner: Planner,
    running: PlanResult,
    state: tuple[float, Sequence[tuple[float, ...]], int],
    random: np.random.Generator,
) -> dict[str, Any]:
    """Something crosses, and a motion goes on; `now` of the row is the time then."""
    (now, ends, number), motion, before = state, running.trajectory, planner.scene
    now = min(now + float(random.uniform(*PAUSE_S)), motion.duration)
    at = min(now + AHEAD_S, motion.duration)
    # Drawn by times since the motion began.
    planner.scene = _crossed(robot, before.since(running.begins_s), motion, (now, at, number), random).since(
        -running.begins_s
    )
    turns = bool(random.random() < TURNING)
    if turns:
        planner.aim(goal=Goal(joints_rad=_farther(ends, before.goal.configuration)))
    asked = planner.scene
    row: dict[str, Any] = {"turns": turns}
    found, ms = timed(lambda: or_error(lambda: replanned(planner, running.begins_s + at, running.begins_s + now)))
    row["ms"] = ms
    if isinstance(found, HplanError):
        planner.scene = before
        return {**row, "outcome": _name(found), "message": found.message, "now": now} | _told_stop(robot, asked, found)
    row |= _judged(robot, asked, running, found)
    row["stop"] = _stop(robot, planner, found.begins_s + float(random.uniform(0.0, found.trajectory.duration)))
    return {**row, "now": now - (found.begins_s - running.begins_s)}


def _crossed(
    robot: Robot, scene: Scene, motion: Trajectory, state: tuple[float, float, int], random: np.random.Generator
) -> Scene:
    """The scene with another track, drawn until it is clear of the base, and of the arm now; as it was where none is.

    Args:
        robot: The arm.
        scene: The scene.
        motion: What runs.
        state: The time, when a new motion may take over, and the number of the scene.
        random: The generator.
    """
    now, at, number = state
    for _ in range(20):
        moment_s = at + float(random.uniform(*MOMENT)) * (motion.duration - at)
        q = motion.positions(np.array([moment_s]))[0]
        piece = passing_near(robot, kind_of(number), q, moment_s, random)
        other = scene.with_obstacles([*(item for item in scene.obstacles if item.track is None), piece])
        moving = MovingSolids.of(other.listed_solids, other.movements)
        if moving is None or next(moving_base_contacts(robot, moving, 0.0, now, now + 30.0), None) is not None:
            continue
        # Nothing comes from nowhere: it is clear of the arm as it is now.
        checker = CoalScene(robot, other.listed_solids, movements=other.movements)
        if checker.distances(motion.positions(np.array([now]))[0], now).min() > ROOM:
            return other
    return scene


def _name(error: HplanError) -> str:
    if isinstance(error, RunningMotionBlockedError):
        return "blocked" if error.stop is None else "blocked, with a stop"
    return "in the way in time" if isinstance(error, ObstacleInTimeError) else error.kind


def _told_stop(robot: Robot, scene: Scene, error: HplanError) -> dict[str, Any]:
    """What coal says of the stop that an error carries."""
    if not isinstance(error, RunningMotionBlockedError) or error.stop is None:
        return {}
    least = least_distance(robot, scene.since(error.begins_s), error.stop.positions, error.stop.duration)
    return {"told_stop_mm": 1e3 * least}


def _judged(robot: Robot, scene: Scene, before: PlanResult, found: SplicedResult) -> dict[str, Any]:
    """What is found of a splice without the planner's own word for it."""
    motion = found.trajectory
    by_old_clock = scene.model_copy(update={"start": found.scene.start})
    return {
        "outcome": splice_outcome(found),
        "certified": found.certificate.verified
        and certify(robot, found.scene, motion).verified
        and certify(robot, by_old_clock, motion, begin_s=found.begins_s).verified,
        "clearance_mm": 1e3 * least_distance(robot, found.scene, motion.positions, motion.duration),
        "seam_rad_s": float(np.abs(motion.velocity[seam_row(found)]).max()),
        "jumps": splice_jumps(before, found),
    }


def _stop(robot: Robot, planner: Planner, t: float) -> dict[str, Any]:
    """A stop at an instant of what runs: clear by coal wherever it is certified."""
    found = planner.stop_at(t)
    motion = found.trajectory
    certified = found.certificate.verified
    scene = planner.scene.since(found.begins_s)
    least = least_distance(robot, scene, motion.positions, motion.duration) if certified else float("nan")
    return {"certified": certified, "clearance_mm": 1e3 * least, "bound_mm": 1e3 * found.off_path_m}


def numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of all steps."""
    found = [row for row in rows if "certified" in row]
    spliced = [row for row in found if row["outcome"] != "kept"]
    stops = [row["stop"] for row in found]
    told = [row["told_stop_mm"] for row in rows if "told_stop_mm" in row]
    return {
        "steps": len(rows),
        "outcomes": dict(Counter(row["outcome"] for row in rows)),
        "splices": len(spliced),
        "splices_in_motion": sum(row["seam_rad_s"] > REST for row in spliced),
        "certified": sum(row["certified"] for row in found),
        "contacts": sum(row["clearance_mm"] <= 0.0 for row in found),
        "least_clearance_mm": min((row["clearance_mm"] for row in found), default=float("nan")),
        "largest_jumps": [max((row["jumps"][i] for row in spliced), default=0.0) for i in range(3)],
        "splice_ms": spread([row["ms"] for row in spliced]),
        "stops": len(stops),
        "stops_certified": sum(stop["certified"] for stop in stops),
        "stops_contacts": sum(stop["certified"] and stop["clearance_mm"] <= 0.0 for stop in stops),
        "stops_largest_bound_mm": max((stop["bound_mm"] for stop in stops), default=0.0),
        "told_stops": len(told),
        "told_stops_contacts": sum(least <= 0.0 for least in told),
    }
