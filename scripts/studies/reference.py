"""The reference scene: stages, searches, C-space and motions, compared with peers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from studies.harness import Asked, Row, Study
from studies.measure import median_ms, outcome, timed
from studies.outside import Motion, findings
from studies.peers import (
    finished_s,
    ompl_path,
    quickest_polyline,
    seed_ompl,
    stopping_duration,
    toppra_motion,
    world_of,
)
from studies.planar import without_jerk
from studies.planar_cspace import arm_sections, joint_grid, sampled_occupancy

from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.coal_scene import CoalScene
from hplan.geometry.polyline import path_length
from hplan.planar.grid import dense_search, two_level_search
from hplan.planar.grid.grid import Occupancy
from hplan.planar.grid.occupancy import occupancy
from hplan.planning.options import EFFORT_NAMES, PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene

#: Runs of each measurement, and of each planner of OMPL's with the time that it has [s].
REPETITIONS, RUNS = 15, (("RRTConnect", 1.0, 10), ("BITstar", 0.2, 3), ("BITstar", 1.0, 3))


def _parts(_: Asked) -> Iterable[str]:
    return "searches", "C-space", "stages", "motions", "planners"


def _part(asked: Asked, part: str) -> list[Row]:
    robot, scene = load_robot(), load_scene()
    makes: dict[str, Callable[[Robot, Scene], list[Row]]] = {
        "searches": _searches,
        "C-space": _cspace,
        "stages": _stages,
        "motions": _motions,
        "planners": lambda robot, scene: _planners(asked, robot, scene),
    }
    return [{"what": row["name"], **row} for row in makes[part](robot, scene)]


def space_of(robot: Robot, scene: Scene) -> Occupancy:
    """The C-space of the arm plane at yaw 0."""
    return occupancy(robot.arm, arm_sections(robot, scene.solids), joint_grid(robot.arm, np.radians(1.0)))


def node_of(space: Occupancy, robot: Robot, q: FloatArray) -> IntArray:
    """The free node nearest to a configuration."""
    position = space.grid.position(q[robot.arm_slice])
    near = np.stack(np.meshgrid(*[[-1, 0, 1]] * len(position), indexing="ij"), axis=-1).reshape(-1, len(position))
    nodes = np.clip(np.rint(position).astype(np.int64) + near, 0, np.array(space.grid.shape) - 1)
    free = [node for node in nodes if space.is_free(node)]
    nearest: IntArray = min(free, key=lambda node: float(np.linalg.norm(node - position)))
    return nearest


def _searches(robot: Robot, scene: Scene) -> list[Row]:
    """The two-level search and the dense one on the same C-space."""
    space = space_of(robot, scene)
    ends = [node_of(space, robot, end.configuration) for end in (scene.start, scene.goal)]
    runs: dict[str, Callable[[], Any]] = {
        "two-level": lambda: two_level_search(space, *ends),
        "the paper's two-level method": lambda: two_level_search(space, *ends, octile=False),
        "dense A*": lambda: dense_search(space, *ends),
        "dense A*, octile bound": lambda: dense_search(space, *ends, octile=True),
    }
    rows: list[Row] = []
    for name, search in runs.items():
        found, ms = search(), median_ms(search, REPETITIONS)
        expansions = {"cost_deg": float(np.degrees(found.cost)), "expansions": found.expansions.total}
        rows.append({"name": name, "ms": ms, "ratio": ms / rows[0]["ms"] if rows else 1.0, **expansions})
    return rows


def _cspace(robot: Robot, scene: Scene) -> list[Row]:
    """The analytic C-space compared with coal's sampling of the same grid."""
    ours, ms = space_of(robot, scene), median_ms(lambda: space_of(robot, scene), 3 * REPETITIONS)
    checker = CoalScene(robot, scene.solids)
    theirs, coal_ms = timed(lambda: sampled_occupancy(checker, ours.grid))
    differ = int((theirs != ours.occupied).sum())
    coal = {"name": "coal at each node", "ms": coal_ms, "ratio": coal_ms / ms, "differ": differ, "fault": differ > 0}
    return [{"name": "C-space", "ms": ms, "ratio": 1.0, "occupied": ours.occupied_count}, coal]


@contextmanager
def _stages_in_cpu_time() -> Iterator[None]:
    """Let `time.perf_counter`, which hplan's stages are timed by, tell CPU time of the thread."""
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
    for effort in EFFORT_NAMES:
        options = PlanOptions(effort=effort)
        ms = median_ms(lambda options=options: plan(robot, scene, options), REPETITIONS)  # type: ignore[misc]
        rows.append({"name": f"effort {effort}", **outcome(plan(robot, scene, options), ms)})
        rows[-1]["ratio"] = ms / next(row["ms"] for row in rows if row["name"] == "effort quick")
    return rows


def _motions(robot: Robot, scene: Scene) -> list[Row]:
    """Motions by hplan and other post-processing, checked every millisecond."""
    result, field = plan(robot, scene), world_of(robot, scene).field
    grid = result.grid_path
    taut = quickest_polyline(robot, grid, field)
    motions: dict[str, Motion | None] = {
        "hplan": result.trajectory,
        "hplan, objective length": plan(robot, scene, PlanOptions(objective="length")).trajectory,
        "hplan, jerk not limited": plan(without_jerk(robot), scene).trajectory,
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
    rows.append(
        {"name": "shortened, stops at corners", "duration_s": stops, "ratio": stops / ours, "length_deg": length}
    )
    return [{**row, "fault": row["name"].startswith("hplan") and row.get("contacts", 0) > 0} for row in rows]


def _planners(asked: Asked, robot: Robot, scene: Scene) -> list[Row]:
    """OMPL's planners, each several times: their paths through toppra and through hplan.

    Only if a peer is selected.
    """
    if asked.peer is None:
        return []
    seed_ompl(asked.seed + 1)
    world, goal = world_of(robot, scene), scene.goal.configuration
    ours, ms = plan(robot, scene).trajectory.duration, median_ms(lambda: plan(robot, scene), REPETITIONS)
    rows: list[Row] = [{"name": "hplan", "ms": ms, "ratio": 1.0}]
    for planner, seconds, count in RUNS:
        for number in range(count):
            path, ms = timed(lambda p=planner, s=seconds: ompl_path(world, scene, goal, planner=p, seconds=s))  # type: ignore[misc]
            if path is None:
                continue
            spline, finished = toppra_motion(robot, path), finished_s(robot, scene, path)
            for what, lasts in (("toppra", spline and spline.duration), ("finished", finished)):
                name = f"{planner} {seconds:g} s, {what}"
                rows.append({"what": name, "name": f"{name} {number}", "ms": ms, "ratio": lasts and lasts / ours})
            if spline is not None:
                rows[-2] |= findings(robot, scene, spline)
    return rows


REFERENCE = Study(
    "reference",
    "the reference scene: ratios to hplan's of times (searches, C-space) and durations (motions, planners)",
    _part,
    ("ms", "ratio", "duration_s", "expansions", "contacts", "velocity", "acceleration", "outside_deg"),
    problems=_parts,
    by="what",
    warm=0,
)
