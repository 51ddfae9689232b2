"""Splices and stops of a running motion while obstacles move, each judged by coal alone and by differences.

The arm goes to and fro. Every so often one of many obstacles has moved, now and then the goal is another one, and the
planner is asked for what comes next from a time shortly ahead on. Of what then runs, a stop at a random instant is
asked for. After a step without a motion the obstacle and the goal are again what they were.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from studies.benchmark.measure import Progress, or_error, spread, timed
from studies.benchmark.moving_scenes import moving_scene, next_move

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError, NoPathError, RunningMotionBlockedError
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.planning.plan import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.timing.trajectory import Trajectory, cubic_pieces
from hplan.verification.certificate import REST, certify

#: Steps of each scene.
STEPS, QUICK_STEPS = 40, 6

#: How long until something moves, and how much later the new motion may take over [s]; share of steps with a new goal.
PAUSE_S, AHEAD_S, TURNING = (0.05, 0.4), 0.1, 0.5

#: Motions are looked at so often [s].
EVERY_S = 5e-4

#: Where the arm goes to and fro.
Ends: TypeAlias = tuple[Goal, ...]

#: What becomes of a step.
OUTCOMES = ("kept", "led over", "by a stop", "blocked, with a stop", "blocked", "no path", "failed")


def measure(robot: Robot, *, seed: int, scenes: int, quick: bool, progress: Progress) -> dict[str, Any]:
    """Measure splices and stops.

    Args:
        robot: The arm.
        seed: Seed of the scenes and of what moves.
        scenes: Number of scenes that have a motion before anything moves.
        quick: Few steps.
        progress: Told how far it is.
    """
    rows: list[dict[str, Any]] = []
    drawn = done = 0
    while done < scenes:
        progress("in motion", done, scenes)
        walked = _walk(robot, seed, drawn, QUICK_STEPS if quick else STEPS)
        rows += walked
        done += bool(walked)
        drawn += 1
    progress("in motion", scenes, scenes)
    return {"seed": seed, "scenes": scenes, "drawn": drawn, "every_s": EVERY_S, **numbers(rows), "rows": rows}


def _walk(robot: Robot, seed: int, number: int, steps: int) -> list[dict[str, Any]]:
    """The steps of a scene; none where there is no motion to begin with."""
    scene = moving_scene(robot, seed, number)
    planner = Planner(robot, scene)
    ends = tuple(Goal(joints_rad=tuple(end.configuration.tolist())) for end in (scene.start, scene.goal))
    random = np.random.default_rng([seed, number, 2])
    rows: list[dict[str, Any]] = []
    now = _begun(planner, ends)
    while now is not None and len(rows) < steps:
        rows.append({"scene": number, "step": len(rows), **_step(robot, planner, now, ends, random)})
        begun = rows[-1].pop("now")
        now = _begun(planner, ends) if begun is None else begun
    return rows


def _other(ends: Ends, q: FloatArray) -> Goal:
    """The end that is farther from a configuration."""
    return max(ends, key=lambda end: float(np.abs(end.configuration - q).max()))


def _begun(planner: Planner, ends: Ends) -> float | None:
    """The time at which a new motion begins, from where the last one ended; None where there is none."""
    if planner.last is not None:
        end = planner.last.trajectory.position[-1]
        start = Start(joints_rad=tuple(end.tolist()))
        planner.scene = planner.scene.model_copy(update={"start": start, "goal": _other(ends, end)})
    try:
        planner.plan()
    except HplanError:
        return None
    return 0.0


def _step(robot: Robot, planner: Planner, now: float, ends: Ends, random: np.random.Generator) -> dict[str, Any]:
    """Something has moved, and a motion goes on; `now` of the row is the time then, None where it is at its end."""
    running, before = planner.last, planner.scene
    if running is None:
        raise ValueError("nothing runs")
    motion = running.trajectory
    now = min(now + float(random.uniform(*PAUSE_S)), motion.duration)  # since it began
    at = min(now + AHEAD_S, motion.duration)
    free = before.model_copy(update={"start": Start(joints_rad=ends[0].joints_rad), "goal": ends[1]})
    move = next_move(robot, free, motion.position[motion.time >= now], random)
    turns = bool(random.random() < TURNING)
    planner.move(move.piece.name, **move.changes)
    if turns:
        planner.aim(goal=_other(ends, before.goal.configuration))
    found, ms = timed(lambda: or_error(lambda: replanned(planner, running.begins_s + at, running.begins_s + now)))
    row: dict[str, Any] = {"close": move.close, "turns": turns, "ms": ms, "at_rest": at == motion.duration}
    if isinstance(found, HplanError):
        planner.scene = before
        later = now if now < motion.duration - PAUSE_S[0] else None
        return {**row, "outcome": _name(found), "error": found.kind, "message": found.message, "now": later}
    row |= _judged(robot, planner.scene, running, found) | {"stop": _stop(robot, found, random)}
    later = now - (found.begins_s - running.begins_s)
    return {**row, "now": later if later < found.trajectory.duration - PAUSE_S[0] else None}


def replanned(planner: Planner, at: float, now: float) -> SplicedResult:
    """What comes next from the time `at` on, asked for at the time `now`, both on the controller's clock."""
    found = planner.replan(at=at, now=now)
    if not isinstance(found, SplicedResult):
        raise TypeError("a splice was asked for")
    return found


def _name(error: HplanError) -> str:
    if isinstance(error, RunningMotionBlockedError):
        return "blocked" if error.stop is None else "blocked, with a stop"
    return "no path" if isinstance(error, NoPathError) else "failed"


def _judged(robot: Robot, scene: Scene, before: PlanResult, found: SplicedResult) -> dict[str, Any]:
    """What is found of a splice without the planner's own word for it."""
    motion = found.trajectory
    # What is kept was looked at when it was made; it is certified again.
    clock = np.arange(0.0, motion.duration + EVERY_S, EVERY_S if not found.is_kept else motion.duration + EVERY_S)
    return {
        "outcome": splice_outcome(found),
        "certified": found.certificate.verified and certify(robot, found.scene, motion).verified,
        "clearance_mm": 1e3 * least_distance(CoalScene(robot, scene.solids), motion.positions(clock)),
        "jumps": splice_jumps(before, found),
        "duration_s": motion.duration,
        "left_s": before.begins_s + before.trajectory.duration - found.begins_s,
    }


def seam_row(found: SplicedResult) -> int:
    """The row of a splice at which the new motion takes over."""
    return int(np.searchsorted(found.trajectory.time, found.seam_s - 1e-9))


def splice_outcome(found: SplicedResult) -> str:
    """What has become of the running motion."""
    after = found.trajectory.velocity[seam_row(found) + 1 : -1]
    paused = bool((np.abs(after).max(axis=1, initial=0.0) <= REST).any())
    return "kept" if found.is_kept else "by a stop" if paused else "led over"


def splice_jumps(before: PlanResult, found: SplicedResult) -> list[float]:
    """Largest differences of position, velocity and acceleration at the seam, and from what ran until then."""
    motion, seam = found.trajectory, seam_row(found)
    first = int(np.searchsorted(before.trajectory.time, found.begins_s - before.begins_s - 1e-9))
    ran = [
        float(
            np.abs(getattr(motion, name)[: seam + 1] - getattr(before.trajectory, name)[first : first + seam + 1]).max()
        )
        for name in ("position", "velocity", "acceleration")
    ]
    return [max(each) for each in zip(motion_jumps(motion, seam), ran, strict=True)]


def motion_jumps(motion: Trajectory, row: int) -> list[float]:
    """Jumps of position, velocity and acceleration from the cubic before a row to the one after it."""
    if not 0 < row < motion.samples - 1:
        return [0.0, 0.0, 0.0]
    bezier, duration = cubic_pieces(motion)
    h = duration[:, None, None]
    values = (bezier, 3.0 * np.diff(bezier, axis=1) / h, 6.0 * np.diff(bezier, n=2, axis=1) / h**2)
    return [float(np.abs(value[row, 0] - value[row - 1, -1]).max()) for value in values]


def least_distance(checker: CoalScene, configurations: FloatArray) -> float:
    """The smallest distance of any pair, by coal alone [m]."""
    return min(float(checker.distances(q).min()) for q in configurations)


def _stop(robot: Robot, running: PlanResult, random: np.random.Generator) -> dict[str, Any]:
    """A stop at a random instant of what runs."""
    motion, t = running.trajectory, float(random.uniform(0.0, running.trajectory.duration))
    found, ms = timed(lambda: running.stop_at(t))
    anew = certify(robot, running.scene, found.trajectory, check_ends=False)
    row = int(np.searchsorted(motion.time, t - 1e-9))
    return {
        "ms": ms,
        "certified": found.certificate.verified,
        "proved_anew": anew.verified,
        "bound_mm": 1e3 * found.off_path_m,
        "off_path_mm": 1e3 * _off_path(robot, motion, found.trajectory, row),
        "seconds": found.trajectory.duration - float(motion.time[row]),
        "left_s": motion.duration - float(motion.time[row]),
        "least_s": float((np.abs(motion.velocity[row]) / robot.acceleration_limit).max()),
        "at_rest": bool(np.abs(found.trajectory.velocity[-1]).max() <= REST),
    }


def _off_path(robot: Robot, motion: Trajectory, stop: Trajectory, row: int) -> float:
    """How far the tool is from its path at most from a row on; looked at between rows too [m]."""
    clock = np.linspace(stop.time[min(row, stop.samples - 1)], stop.duration, 101)
    path = robot.tool_positions(motion.positions(np.linspace(motion.time[row], motion.duration, 4_001)))
    tool = robot.tool_positions(stop.positions(clock))
    return max(_to_polyline(path, place) for place in tool)


def _to_polyline(path: FloatArray, place: FloatArray) -> float:
    """Distance of a place from the polyline through points, near the nearest of them."""
    nearest = int(np.linalg.norm(path - place, axis=1).argmin())
    pieces = path[max(0, nearest - 1) : nearest + 2]
    if len(pieces) < 2:
        return float(np.linalg.norm(pieces[0] - place))
    begin, along = pieces[:-1], np.diff(pieces, axis=0)
    square = np.maximum((along**2).sum(axis=1), 1e-300)
    part = np.clip(((place - begin) * along).sum(axis=1) / square, 0.0, 1.0)
    return float(np.linalg.norm(begin + part[:, None] * along - place, axis=1).min())


def numbers(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What is told of all steps."""
    found = [row for row in rows if "certified" in row]
    spliced = [row for row in found if row["outcome"] != "kept"]
    stops = [row["stop"] for row in found]
    return {
        "steps": len(rows),
        "outcomes": {name: count for name in OUTCOMES if (count := Counter(row["outcome"] for row in rows)[name])},
        "splices": len(spliced),
        "certified": sum(row["certified"] for row in spliced),
        "colliding": sum(row["clearance_mm"] <= 0.0 for row in found),
        "least_clearance_mm": min((row["clearance_mm"] for row in found), default=float("nan")),
        "largest_jumps": [max((row["jumps"][i] for row in spliced), default=0.0) for i in range(3)],
        "ms": {name: spread([row["ms"] for row in rows if row["outcome"] == name]) for name in _seen(rows)},
        "splice_ms": spread([row["ms"] for row in spliced]),
        "stops": {
            "count": len(stops),
            "certified": sum(stop["certified"] and stop["proved_anew"] and stop["at_rest"] for stop in stops),
            "ms": spread([stop["ms"] for stop in stops]),
            "largest_bound_mm": max((stop["bound_mm"] for stop in stops), default=0.0),
            "largest_off_path_mm": max((stop["off_path_mm"] for stop in stops), default=0.0),
            "later_s": spread([stop["seconds"] - min(stop["least_s"], stop["left_s"]) for stop in stops]),
        },
        "at_fault": [
            f"{row['scene']}.{row['step']}"
            for row in found
            if not (row["certified"] and row["clearance_mm"] > 0.0 and row["stop"]["certified"])
        ],
        "failed": [row for row in rows if row["outcome"] == "failed"],
    }


def _seen(rows: Sequence[dict[str, Any]]) -> list[str]:
    seen = {row["outcome"] for row in rows}
    return [name for name in OUTCOMES if name in seen]
