"""Certified motions of the set's problems by other means than `hplan.plan`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

from studies.benchmark.fastest.problems import FastestProblem
from studies.benchmark.paths import PeerTask, processed_duration
from studies.benchmark.planners import Ompl

from hplan.errors import InputError

#: Paths of RRTConnect on each problem, and the CPU time that each may take [s].
PATHS, PATIENCE = 3, 10.0


class Found(NamedTuple):
    """A certified motion.

    Attributes:
        duration_s: How long it takes [s].
        by: Who found it.
    """

    duration_s: float
    by: str


def rrtconnect(problem: FastestProblem) -> list[Found]:
    """Motions along OMPL's RRTConnect's paths, each made the fastest near it by hplan with its best effort.

    Raises:
        InputError: OMPL is not installed.
    """
    ompl, task = _ompl(), PeerTask.of(problem.robot, problem.scene)
    found = []
    for _ in range(PATHS):
        ends = task.problem.start, task.problem.goal
        path = ompl.plan(task, *ends, seconds=PATIENCE, turns=task.problem.turns).path
        duration = None if path is None else processed_duration(task, path, "best")
        if duration is not None:
            found.append(Found(duration, "rrtconnect"))
    return found


@cache
def _ompl() -> Ompl:
    found = Ompl.if_installed(1)
    if found is None:
        raise InputError("rrtconnect: OMPL is not installed (pip install 'hplan[bench]')")
    return found


#: The peers by name.
PEERS: dict[str, Callable[[FastestProblem], list[Found]]] = {"rrtconnect": rrtconnect}
