"""Paths of OMPL's RRTConnect: what `hplan.finish` makes of them, beside a spline through them timed by toppra.

OMPL checks configurations along each motion, so many fractions of the space's extent apart (a hundredth unless it is
told otherwise), with hplan's compiled distances, and simplifies what it finds. A path may so touch something between
two configurations that were checked; `finish` then says where.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from studies.benchmark.measure import median, times_until
from studies.benchmark.motions import toppra_motion
from studies.benchmark.ompl_paths import ompl_path

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.finishing.finish import finish
from hplan.problem.options import PlanOptions
from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Where the shape of a path is kept, so near to it [rad].
WITHIN_RAD = 0.02

#: Motions are looked at from outside so often [s].
EVERY_S = 1e-3


@dataclass(frozen=True)
class Finished:
    """One path.

    Attributes:
        group: What it is counted with.
        waypoints: How many it has; 0 where OMPL found none.
        spline_s: Duration of the spline through it, timed by toppra; None where there is none [s].
        spline_touches: Whether that touches something.
        outcome: `certified`, or the kind of error.
        moved: How many of its motions were moved away from what they came too close to.
        finished_s: Duration of the certified motion; None without one [s].
        finished_touches: Whether that touches something, by coal.
        kept_s: Duration with the path's shape kept; None without one [s].
        finish_ms: Time of `finish` (CPU).
    """

    group: str
    waypoints: int
    spline_s: float | None = None
    spline_touches: bool = False
    outcome: str = "no path"
    moved: int = 0
    finished_s: float | None = None
    finished_touches: bool = False
    kept_s: float | None = None
    finish_ms: float = 0.0


def finished(
    robot: Robot, scenes: Sequence[tuple[str, Scene]], options: PlanOptions, resolution: float = 0.01
) -> Iterator[Finished]:
    """What becomes of OMPL's paths.

    Args:
        robot: The arm.
        scenes: Problems from joints to joints, and the group of each.
        options: How to finish.
        resolution: As `ompl_path` takes it.
    """
    for group, scene in scenes:
        goal = scene.goal.joints()
        if goal is None:
            continue
        world = World.of(robot, scene.solids_with_goal, clearance=scene.clearance)
        path = ompl_path(world, scene, goal, resolution)
        yield Finished(group, 0) if path is None else _finished(robot, scene, group, path, options, world.checker)


def _finished(
    robot: Robot, scene: Scene, group: str, path: FloatArray, options: PlanOptions, checker: CoalScene
) -> Finished:
    spline = toppra_motion(robot, path)
    touches = spline is not None and _touches(checker, spline.positions(times_until(spline.duration, EVERY_S)))
    found: dict[str, Any] = {"spline_s": None if spline is None else spline.duration, "spline_touches": touches}
    began = time.process_time()
    try:
        result = finish(robot, scene, path, options)
        motion = result.trajectory
        found |= {
            "outcome": "certified",
            "moved": len(result.report["given"]["moved_segments"]),
            "finished_s": motion.duration,
            "finish_ms": 1e3 * (time.process_time() - began),
            "finished_touches": _touches(checker, motion.positions(times_until(motion.duration, EVERY_S))),
        }
        found["kept_s"] = finish(robot, scene, path, options, keep_within_rad=WITHIN_RAD).trajectory.duration
    except HplanError as error:
        found = {"outcome": type(error).__name__, "finish_ms": 1e3 * (time.process_time() - began)} | found
    return Finished(group, len(path), **found)


def _touches(checker: CoalScene, positions: FloatArray) -> bool:
    return bool(checker.in_collision(positions).any())


def table(rows: Sequence[Finished]) -> list[str]:
    """Lines: for each group, and for all, what became of the paths."""
    heads = (
        *("problems", "paths", "splines in contact", "refused: path in contact", "other refusals", "certified"),
        *("moved", "certified in contact", "spline s", "finished s", "ratio", "kept / spline", "median ms"),
    )
    lines = [f"| set | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
    for name in (*dict.fromkeys(row.group for row in rows), "all"):
        some = [row for row in rows if name in (row.group, "all")]
        paths = [row for row in some if row.waypoints]
        good = [row for row in paths if row.finished_s is not None and row.spline_s is not None]
        refused = sum(row.outcome == "PathInContactError" for row in paths)
        certified = sum(row.outcome == "certified" for row in paths)
        cells = (
            *(len(some), len(paths), sum(row.spline_touches for row in paths), refused),
            *(len(paths) - refused - certified, certified, sum(row.moved > 0 for row in paths)),
            sum(row.finished_touches for row in paths),
            f"{_median([row.spline_s for row in good]):.2f}",
            f"{_median([row.finished_s for row in good]):.2f}",
            f"{_median([_ratio(row.finished_s, row.spline_s) for row in good]):.2f}",
            f"{_median([_ratio(row.kept_s, row.spline_s) for row in good]):.2f}",
            f"{_median([row.finish_ms for row in paths]):.0f}",
        )
        lines.append(f"| {name} | {' | '.join(map(str, cells))} |")
    return lines


def _ratio(value: float | None, other: float | None) -> float | None:
    return None if value is None or other is None else value / other


def _median(values: Sequence[float | None]) -> float:
    """The median of what there is."""
    return median([value for value in values if value is not None])
