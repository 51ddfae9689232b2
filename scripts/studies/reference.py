"""The reference scene: CPU times of the stages and of each effort, and durations compared with common recipes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.measure import median_ms, outcome
from studies.outside import Motion, findings
from studies.peers import quickest_polyline, stopping_duration, toppra_motion, world_of

from hplan.geometry.polyline import path_length
from hplan.planning.options import EFFORT_NAMES, PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene

#: Runs of each measurement.
REPETITIONS = 15


def _parts(_: StudyConfig) -> Iterable[str]:
    return "stages", "motions"


def _part(_: StudyConfig, part: str) -> list[Row]:
    parts: dict[str, Callable[[Robot, Scene], list[Row]]] = {"stages": _stages, "motions": _motions}
    return [{"what": row["name"], **row} for row in parts[part](load_robot(), load_scene())]


@contextmanager
def _stages_in_cpu_time() -> Iterator[None]:
    """Let `time.perf_counter`, the clock of hplan's stages, return CPU time of the thread."""
    original = time.perf_counter
    time.perf_counter = time.thread_time
    try:
        yield
    finally:
        time.perf_counter = original


def _stages(robot: Robot, scene: Scene) -> list[Row]:
    """Median CPU time of each stage of a plan, and of a plan with each effort."""
    plan(robot, scene)
    with _stages_in_cpu_time():
        reports = [plan(robot, scene).report["time_ms"] for _ in range(REPETITIONS)]
    rows: list[Row] = [
        {"name": f"stage {name}", "ms": float(np.median([report[name] for report in reports]))} for name in reports[0]
    ]
    first_ms = None
    for effort in EFFORT_NAMES:
        options = PlanOptions(effort=effort)
        ms = median_ms(lambda options=options: plan(robot, scene, options), REPETITIONS)  # type: ignore[misc]
        first_ms = first_ms or ms
        rows.append({"name": f"effort {effort}", **outcome(plan(robot, scene, options), ms), "ratio": ms / first_ms})
    return rows


def _motions(robot: Robot, scene: Scene) -> list[Row]:
    """Motions by hplan and other post-processing, checked every millisecond; `ratio` is to hplan's duration."""
    result = plan(robot, scene)
    grid = result.grid_path
    taut = quickest_polyline(robot, grid, world_of(robot, scene).field)
    motions: dict[str, Motion | None] = {
        "hplan": result.trajectory,
        "hplan, objective length": plan(robot, scene, PlanOptions(objective="length")).trajectory,
        "hplan, jerk not limited": plan(replace(robot, jerk_limit=None), scene).trajectory,
        "grid path, toppra": toppra_motion(robot, grid),
        "grid path, toppra's defaults": toppra_motion(robot, grid, defaults=True),
        "shortened, toppra": toppra_motion(robot, taut),
        "shortened, toppra's defaults": toppra_motion(robot, taut, defaults=True),
    }
    ours, stops = result.trajectory.duration, stopping_duration(robot, taut)
    rows: list[Row] = [
        {"name": name, "duration_s": motion.duration, "ratio": motion.duration / ours, **findings(robot, scene, motion)}
        for name, motion in motions.items()
        if motion is not None
    ]
    length = float(np.degrees(path_length(taut)))
    rows += [{"name": "shortened, stops at corners", "duration_s": stops, "ratio": stops / ours, "length_deg": length}]
    return [{**row, "fault": row["name"].startswith("hplan") and row.get("contacts", 0) > 0} for row in rows]


REFERENCE = Study(
    "reference",
    "the reference scene: CPU times of stages and efforts; ratios of durations to hplan's",
    _part,
    ("ms", "ratio", "duration_s", "contacts", "velocity", "acceleration", "outside_deg"),
    problems=_parts,
    by="what",
    warm=0,
)
