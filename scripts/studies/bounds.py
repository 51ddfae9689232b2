"""Lower bounds of durations beside certified motions: in random planar scenes, among trees, of the Panda."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from studies.arms import panda_scenes
from studies.harness import Asked, Row, Study, evenly_chosen
from studies.measure import planned, timed
from studies.peers import MARGIN_M, world_of
from studies.pinches import ARMS, ROOMS, pinch
from studies.planar import random_scene
from studies.trees import TreeProblem, motions_in, orchards_of

from hplan.errors import BoundError
from hplan.planning.lower_bound.duration_bound import DurationBound, duration_bound
from hplan.planning.motion import motion_limits
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene

#: Kinds of problems of bounds in turn (discs about an arm, or pinches), clearances to keep of the discs in turn [m],
#: and of how many problems one is planned with the best effort too, whose motion the same bound must not exceed.
BOUND_KINDS = ("harvester", "pinch", "harvester", "pinch", "harvester", "orchard_harvester", "harvester")
CLEARANCES, BEST_EVERY = (0.0, 0.0, 0.02), 5


def bound_problem(seed: int, number: int) -> tuple[Robot, Scene, str]:
    """Arm, scene and kind of a problem of bounds, from the seed and its number alone."""
    kind, turn = BOUND_KINDS[number % len(BOUND_KINDS)], number // len(BOUND_KINDS)
    if kind == "pinch":
        return *pinch(seed, number, ARMS[turn % len(ARMS)], ROOMS[turn // len(ARMS) % len(ROOMS)]), kind
    robot, clearance = load_robot(kind), CLEARANCES[turn % len(CLEARANCES)]
    return robot, random_scene(robot, seed, number).scene.with_(clearance=clearance), kind


def _problems(asked: Asked) -> Iterable[tuple[int, TreeProblem | None]]:
    """The problems with their numbers: in files, and among trees, where folders are given, else drawn ones.

    Of motions among trees those count whose straight line in joint space is blocked.
    """
    if asked.files is None and asked.trees is None:
        return [(number, None) for number in asked.numbers]
    arms = [TreeProblem(scene.name, f"panda {kind}", robot, scene) for kind, robot, scene in panda_scenes(asked)]
    blocked: list[TreeProblem] = []
    if asked.trees is not None:
        robot = asked.arm()
        among = [one for orchard in orchards_of(asked) for one in motions_in(robot, orchard)]
        blocked = evenly_chosen([one for one in among if _is_blocked(one)], asked.count, lambda one: one.group)
    return list(enumerate([*arms, *blocked]))


def _is_blocked(problem: TreeProblem) -> bool:
    ends = np.stack([problem.scene.start.configuration, problem.scene.goal.configuration])
    return not world_of(problem.robot, problem.scene).field.is_clear(ends, MARGIN_M)


def _bound(asked: Asked, numbered: tuple[int, TreeProblem | None]) -> Row | None:
    """The lower bound of a certified motion; no motion is faster, not even that of the best effort."""
    number, problem = numbered
    if problem is None:
        robot, scene, kind = bound_problem(asked.seed, number)
        name = f"{kind} {number}"
    else:
        robot, scene, kind, name = problem.robot, problem.scene, problem.group, problem.name
    found, row = planned(robot, scene)
    if found is None:
        return None
    row |= {"name": name, "kind": kind}
    again = number % BEST_EVERY == 0
    try:
        bound, ms = timed(lambda: _bound_of(found, thorough=again))
    except BoundError:
        return row | {"fault": True}
    durations = [row["duration_s"]]
    if again:
        best, _ = planned(robot, scene, PlanOptions(effort="best"))
        durations += [] if best is None else [best.trajectory.duration]
    return row | {
        "bound_ms": ms,
        "method": bound.method,
        "gap": bound.gap,
        "joints_gap": bound.duration_s / bound.joints_s - 1.0 if bound.joints_s > 0.0 else None,
        "fault": row["fault"] or bound.seconds > min(durations),
    }


def _bound_of(result: PlanResult, *, thorough: bool) -> DurationBound:
    problem, duration_s = result.motion.problem, result.motion.trajectory.duration
    return duration_bound(problem.world, problem, motion_limits(problem), duration_s, thorough=thorough)


BOUND = Study(
    "bound",
    "lower bounds of durations beside certified motions, blocked ones among trees (--trees), the Panda's (--files)",
    _bound,
    ("certified", "gap", "joints_gap", "bound_ms", "method"),
    problems=_problems,
    by="kind",
    count=(500, 7),
)
