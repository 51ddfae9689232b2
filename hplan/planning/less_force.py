"""Plans among limbs that bend: motions that touch nothing first, then motions that push.

Most motions that push limbs are slowed down for impacts, so that they are hardly faster than those around the limbs,
and their certificates take longer. So limbs count as rigid first. Motions that push follow if that fails, or if the
motion takes a detour.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from hplan.errors import BlockedError, HplanError, UnreachableError
from hplan.planning.effort import FAR_FROM_BOUND
from hplan.planning.motion import Plan, Solver, best_of
from hplan.planning.plans import with_all_efforts
from hplan.planning.problem import Problem
from hplan.planning.world import World

#: Maximum duration of a gentle motion, as a multiple of the quickest one.
LONGER = 1.05

#: Fractions of the limits that are tried with the option `gentle`.
_SHARES = (0.1, 0.2, 0.35, 0.5, 0.7)


def with_less_force(solve: Solver) -> Solver:
    """A solver with all efforts that pushes limbs only if that pays.

    A motion that touches no limb is the last plan if it is close to the lower bound of its duration, if the first one
    that pushes takes as long as the first one that does not, or if no motion that pushes is faster. With the option
    `gentle` the last plan is the motion within the smallest fraction of the limits that takes at most `LONGER` times as
    long as the fastest one.

    Args:
        solve: A solver with the effort of the problem; its last plan is the fastest.
    """
    whole, brief = with_all_efforts(solve), with_all_efforts(_without_long_search(solve))

    def plans(problem: Problem, around: Iterator[Plan]) -> Iterator[Plan]:
        free: Plan | None = None
        first_s = math.inf
        failure: HplanError | None = None
        try:
            for free in around:
                first_s = free.duration if math.isinf(first_s) else first_s
                yield free
        except HplanError as error:
            failure = error.with_traceback(None)
        gentle = problem.options.gentle
        if free is not None and not gentle and free.duration <= FAR_FROM_BOUND * _least_duration(free):
            return
        best: Plan | None = None
        try:
            for found in (whole if free is None else brief)(problem):
                if best is None and found.duration >= first_s and not gentle:
                    return
                if free is None or (LONGER if gentle else 1.0) * found.duration < free.duration:
                    best = found
                    yield best
        except HplanError:
            if free is not None:
                return
            if isinstance(failure, BlockedError | UnreachableError):
                raise
            less = _best_within(problem, 0.0, whole)
            if less is None:
                raise
            yield less
            return
        if best is None:
            return
        if free is None and best.duration > FAR_FROM_BOUND * _least_duration(best):
            less = _best_within(problem, 0.0, whole)
            if less is not None and less.duration < best.duration:
                yield less
                return
        for share in _SHARES if gentle else ():
            less = _best_within(problem, share, whole)
            if less is not None and less.duration < LONGER * best.duration:
                yield less
                return

    def solver(problem: Problem) -> Iterator[Plan]:
        if problem.scene.wood is None or problem.scene.moves:
            return whole(problem)
        return plans(problem, brief(_within(problem, 0.0)))

    return solver


def _without_long_search(solve: Solver) -> Solver:
    """A solver without long trees and proofs, which follow among limbs that bend."""
    return lambda problem: solve(replace(problem, effort=replace(problem.effort, long_pairs=0, proof_nodes=0.0)))


def _least_duration(plan: Plan) -> float:
    """Lower bound of the duration of plans to the grasp or goal of a plan [s]."""
    return plan.transit.problem.least_duration if plan.grasp is None else plan.grasp.least_duration


def _within(problem: Problem, share: float) -> Problem:
    """The problem within a fraction of the limits of force and stress; limbs are rigid if it is 0."""
    wood = problem.scene.wood
    if wood is None:
        return problem
    scene = problem.scene.with_values(wood=wood.scale(share) if share > 0.0 else wood.as_rigid)
    return problem.in_world(World.of_scene(problem.robot, scene, problem.options))


def _best_within(problem: Problem, share: float, solve: Solver) -> Plan | None:
    """The fastest plan within a fraction of the limits of force and stress, or None."""
    with suppress(HplanError):
        return best_of(solve(_within(problem, share)))
    return None
