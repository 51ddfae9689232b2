"""Certified motions of the set's problems by other means than `hplan.plan`.

- `rrtconnect`: paths of OMPL's RRTConnect, each made the fastest motion near it by hplan with its best effort;
- `detours`: the same by way of random configurations, for paths on other sides of what is in the way;
- `ipopt`: nonlinear programs (`studies.benchmark.fastest.offline`) from hplan's own motion and from those paths.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from studies.benchmark.fastest.offline import optimized
from studies.benchmark.fastest.problems import FastestProblem
from studies.benchmark.fastest.symbolic import load_casadi
from studies.benchmark.paths import PeerTask, processed_motion
from studies.benchmark.planners import Ompl

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError, InputError
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions

#: Paths of RRTConnect on each problem, and detours.
PATHS, DETOURS = 3, 6

#: CPU time that a path may take, and each half of a detour, whose middle may be out of reach [s].
PATIENCE, HALF_PATIENCE = 10.0, 1.0

#: Paths and detours that IPOPT begins with, beside hplan's motion.
STARTS = 2

#: Draws of a configuration for a detour that is clear.
_DRAWS = 200


class Found(NamedTuple):
    """A certified motion.

    Attributes:
        duration_s: How long it takes [s].
        by: Who found it.
    """

    duration_s: float
    by: str


def rrtconnect(problem: FastestProblem) -> list[Found]:
    """Motions near paths of RRTConnect.

    Raises:
        InputError: OMPL is not installed.
    """
    task = PeerTask.of(problem.robot, problem.scene)
    return _processed(task, [_path(task) for _ in range(PATHS)], "rrtconnect")


def detours(problem: FastestProblem) -> list[Found]:
    """Motions near paths of RRTConnect by way of random configurations.

    Raises:
        InputError: OMPL is not installed.
    """
    task = PeerTask.of(problem.robot, problem.scene)
    return _processed(task, [_path(task, via) for via in _places(problem, task, DETOURS)], "detours")


def ipopt(problem: FastestProblem) -> list[Found]:
    """The fastest motion of IPOPT from hplan's motion, and from those near a few paths.

    Raises:
        InputError: CasADi or OMPL is not installed.
    """
    load_casadi()
    task, starts = PeerTask.of(problem.robot, problem.scene), []
    with suppress(HplanError):
        starts.append(plan(problem.robot, problem.scene, PlanOptions(effort="best")).trajectory)
    places = [None] * STARTS + list(_places(problem, task, STARTS))
    for path in (_path(task, via) for via in places):
        motion = None if path is None else processed_motion(task, path)
        starts += [] if motion is None else [motion]
    best = optimized(problem.robot, problem.scene, starts)
    return [] if best is None else [Found(best.duration, "ipopt")]


def _processed(task: PeerTask, paths: list[FloatArray | None], by: str) -> list[Found]:
    motions = [processed_motion(task, path, "best") for path in paths if path is not None]
    return [Found(motion.duration, by) for motion in motions if motion is not None]


def _path(task: PeerTask, via: FloatArray | None = None) -> FloatArray | None:
    """A path of RRTConnect, simplified, by way of a configuration if there is one; None where none is found."""
    stops = [task.problem.start, *([] if via is None else [via]), task.problem.goal]
    parts: list[FloatArray] = []
    seconds = PATIENCE if via is None else HALF_PATIENCE
    for ends in pairwise(stops):
        part = _ompl().plan(task, *ends, seconds=seconds, turns=task.problem.turns).path
        if part is None:
            return None
        parts.append(part[bool(parts) :])
    return np.concatenate(parts)


def _places(problem: FastestProblem, task: PeerTask, most: int) -> list[FloatArray]:
    """Random clear configurations with the locked joints where they are; the same for the same problem."""
    random = np.random.default_rng(int(problem.record.digest, 16))
    asked, found = task.problem, list[FloatArray]()
    for _ in range(_DRAWS):
        drawn = np.array(asked.start)
        drawn[asked.movable] = random.uniform(asked.lower, asked.upper)[asked.movable]
        if task.field.clearance(drawn) > task.margin:
            found.append(drawn)
        if len(found) == most:
            break
    return found


@cache
def _ompl() -> Ompl:
    found = Ompl.if_installed(1)
    if found is None:
        raise InputError("OMPL is not installed (pip install 'hplan[bench]')")
    return found


#: The peers by name.
PEERS: dict[str, Callable[[FastestProblem], list[Found]]] = {
    "rrtconnect": rrtconnect,
    "detours": detours,
    "ipopt": ipopt,
}
