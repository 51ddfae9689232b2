"""Certified trajectories looked at again, finely and by other means than those that certified them.

From the written CSV, read back with the csv module alone; cubic Hermite curves between its rows; positions every
0.1 ms, velocity and acceleration by their differences, torque by inverse dynamics, contact by coal at each instant.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from studies.benchmark.measure import Progress, spread, timed
from studies.benchmark.motions import row_cubics
from studies.benchmark.paths import PeerTask, without_jerk
from studies.benchmark.scenes import PlanarScene, random_scene

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.timing.trajectory import Trajectory, write_csv
from hplan.verification.certificate import LIMIT_TOLERANCE

#: Spacing of the samples [s].
INSTANT = 1e-4

#: Signed distances are computed at one in so many samples; contact is looked for at all of them.
_DISTANCE_EVERY = 50

#: What may be violated.
CHECKS = ("position", "velocity", "acceleration", "torque", "contact", "certified clearance", "ends")

#: Use of a limit from which on it counts as reached.
REACHED = 0.999


def measure(robot: Robot, scene: Scene, *, seed: int, scenes: int, progress: Progress) -> dict[str, Any]:
    """Measure the recheck set.

    Args:
        robot: The arm.
        scene: The reference scene.
        seed: Seed of the scenes.
        scenes: Number of scenes with a path.
        progress: Told how far it is.
    """
    failed: list[dict[str, Any]] = []
    violations: list[dict[str, Any]] = []
    worst: dict[str, tuple[float, int]] = {}
    times: list[float] = []
    motion_s, instants, certified, drawn, done, world = 0.0, 0, 0, 0, 0, 0
    least_clearance, slack = float("inf"), float("inf")
    with tempfile.TemporaryDirectory() as folder:
        while done < scenes:
            progress("recheck", done, scenes)
            candidate = random_scene(robot, seed, drawn)
            drawn += 1
            if not candidate.has_path:
                continue
            done += 1
            try:
                planned, ms = timed(lambda c=candidate: plan(robot, c.scene))  # type: ignore[misc]
            except HplanError as error:
                failed.append(
                    {
                        "number": candidate.number,
                        "kind": error.kind,
                        "message": error.message,
                        "spare_clearance_mm": 1e3 * candidate.spare_clearance_m,
                    }
                )
                continue
            times.append(ms)
            world += not _is_direct(robot, candidate)
            certified += planned.certificate.verified
            file = write_csv(planned.trajectory, Path(folder) / "trajectory.csv")
            seen = look_again(robot, candidate, file, planned.certificate.min_clearance_m)
            motion_s += planned.trajectory.duration
            instants += seen["instants"]
            least_clearance = min(least_clearance, seen["clearance_m"])
            slack = min(slack, seen["clearance_m"] - planned.certificate.min_clearance_m)
            for name, use in seen["use"].items():
                worst[name] = max(worst.get(name, (0.0, -1)), (use, candidate.number))
            violations += [{"number": candidate.number, **item} for item in seen["violations"]]
    progress("recheck", scenes, scenes)
    return {
        "seed": seed,
        "drawn": drawn,
        "with_path": scenes,
        "around": world,
        "planned": len(times),
        "certified": certified,
        "failed": failed,
        "plan_ms": spread(times),
        "motion_s": motion_s,
        "instants": instants,
        "violations": violations,
        "violation_counts": {name: sum(item["check"] == name for item in violations) for name in CHECKS},
        "worst_use": {name: {"use": use, "number": number} for name, (use, number) in worst.items()},
        "least_clearance_mm": 1e3 * least_clearance,
        "least_clearance_beyond_certificate_mm": 1e3 * slack,
        "reference": {
            "hplan": at_limits(robot, plan(robot, scene).trajectory),
            "hplan_no_jerk": at_limits(without_jerk(robot), plan(without_jerk(robot), scene).trajectory),
        },
    }


def _is_direct(robot: Robot, drawn: PlanarScene) -> bool:
    """True if the straight motion from start to goal is clear."""
    task = PeerTask.of(robot, drawn.scene)
    return task.field.is_clear(np.stack([task.problem.start, task.problem.goal]), task.smallest_margin)


def look_again(robot: Robot, drawn: PlanarScene, file: Path, certified_clearance: float) -> dict[str, Any]:
    """Look at a written trajectory."""
    time, position, velocity = read_rows(file)
    clock = np.append(np.arange(0.0, time[-1], INSTANT), time[-1])
    q = row_cubics(time, position, velocity, clock)
    v = np.diff(q[:-1], axis=0) / INSTANT
    use = {
        "position": float((np.abs(q - 0.5 * (robot.lower + robot.upper)) / (0.5 * (robot.upper - robot.lower))).max()),
        "velocity": float((np.abs(v) / robot.velocity_limit).max()),
        **_second_order(robot, q[:-1]),
    }
    checker = CoalScene(robot, drawn.scene.solids)
    claim = certified_clearance - 1e-9
    distances = [float(checker.distances(row).min()) for row in q[::_DISTANCE_EVERY]]
    found: list[dict[str, Any]] = []

    def note(check: str, value: float) -> None:
        found.append({"check": check, "value": value})

    outside = float(np.maximum(robot.lower - q, q - robot.upper).max())
    if outside > 1e-9:
        note("position", outside)
    for name in ("velocity", "acceleration", "torque"):
        if not use[name] <= LIMIT_TOLERANCE:
            note(name, use[name])
    touching = int(checker.in_collision(q).sum())
    if touching:
        note("contact", touching)
    closer = int(checker.in_collision(q, margin=claim).sum()) if claim != 0.0 else 0
    if closer or not certified_clearance > 0.0:
        note("certified clearance", closer)
    ends = [drawn.scene.start.joints(), drawn.scene.goal.joints()]
    apart = max(float(np.abs(row - end).max()) for row, end in zip(q[[0, -1]], ends, strict=True) if end is not None)
    moving = float(np.abs(velocity[[0, -1]]).max())
    if apart > 1e-9 or moving > 1e-9:
        note("ends", max(apart, moving))
    return {"instants": len(q), "use": use, "violations": found, "clearance_m": min(distances)}


def _second_order(robot: Robot, q: FloatArray) -> dict[str, float]:
    """Largest use of acceleration and torque, by differences of equally spaced positions."""
    v = (q[2:] - q[:-2]) / (2.0 * INSTANT)
    a = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / INSTANT**2
    return {
        "acceleration": float((np.abs(a) / robot.acceleration_limit).max()),
        "torque": float((np.abs(_torques(robot, q[1:-1], v, a)) / robot.torque_limit).max()),
    }


def _torques(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    model, data = robot.model, robot.model.createData()
    rnea = pin.rnea
    return np.array([rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def read_rows(file: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time, positions and velocities of a trajectory file, by the csv module alone."""
    with file.open(encoding="utf-8", newline="") as stream:
        header, *lines = list(csv.reader(stream))
    table = np.array(lines, dtype=np.float64)

    def columns(suffix: str) -> Sequence[int]:
        return [i for i, name in enumerate(header) if name.endswith(suffix)]

    return table[:, header.index("time_s")], table[:, columns("_pos_rad")], table[:, columns("_vel_rad_s")]


def at_limits(robot: Robot, trajectory: Trajectory) -> dict[str, float]:
    """Share of the time at which some limit is reached, and which one.

    Jerk is the slope of the acceleration between rows.
    """
    rows = trajectory
    clock = np.arange(0.5 * INSTANT, rows.duration, INSTANT)
    i = np.clip(np.searchsorted(rows.time, clock, side="right") - 1, 0, rows.samples - 2)
    share = ((clock - rows.time[i]) / (rows.time[i + 1] - rows.time[i]))[:, None]
    h = 0.5 * INSTANT
    before, here, after = (row_cubics(rows.time, rows.position, rows.velocity, clock + d) for d in (-h, 0.0, h))
    velocity = (after - before) / INSTANT
    acceleration = rows.acceleration[i] + share * (rows.acceleration[i + 1] - rows.acceleration[i])
    torque = _torques(robot, here, velocity, acceleration)
    uses = {
        "velocity": (np.abs(velocity) / robot.velocity_limit).max(axis=1),
        "acceleration": (np.abs(acceleration) / robot.acceleration_limit).max(axis=1),
        "torque": (np.abs(torque) / robot.torque_limit).max(axis=1),
    }
    dynamic = np.max(list(uses.values()), axis=0)
    if robot.jerk_limit is not None:
        step = np.diff(rows.acceleration, axis=0) / np.diff(rows.time)[:, None]
        uses["jerk"] = (np.abs(step) / robot.jerk_limit).max(axis=1)[i]
    whole = np.max(list(uses.values()), axis=0)
    return {
        "duration_s": rows.duration,
        **{name: float((use >= REACHED).mean()) for name, use in uses.items()},
        "any_but_jerk": float((dynamic >= REACHED).mean()),
        "any": float((whole >= REACHED).mean()),
        "any_at_95_percent": float((whole >= 0.95).mean()),
    }
