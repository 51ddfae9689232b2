"""Anytime search for certified motions to any of several goals.

The path finders of a problem are tried in turn. Near the paths that they yield the solver optimizes, times and
certifies a motion, and yields each one that is faster than those before. Callers take the first motion, the last,
or the last one before a deadline.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from hplan.base.arrays import frozen
from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.optimization.repair import repair
from hplan.planning.failures import FailuresError
from hplan.planning.growing_trees import Pairs
from hplan.planning.motion import Motion, best_of, certificate_of, improve, motion_along, quickest, require_certificate
from hplan.planning.path_finder import (
    FirstPaths,
    LongTrees,
    Path,
    PathFinder,
    StraightLine,
    Trees,
    describe_trees,
    is_straight_clear,
)
from hplan.planning.problem import Problem
from hplan.planning.specialist import specialist_of
from hplan.trajectory.retime import rest_at

#: The number of a goal, and a motion there.
Found: TypeAlias = tuple[int, Motion]


def motions(problem: Problem) -> Iterator[Found]:
    """Certified motions to any of a problem's goals, each faster than before.

    The search ends when the effort is spent.

    Args:
        problem: The problem; goals that promise the fastest motions come first.

    Yields:
        The number of the goal, and the motion.

    Raises:
        FailuresError: No motion was found; holds the reason for each goal.
        TimingError: A straight motion cannot be timed.
    """
    at_goal = next((number for number in range(len(problem.goals)) if problem.with_goals(number).is_empty), None)
    if at_goal is not None:
        yield at_goal, _rest(problem.with_goals(at_goal))
        return
    failures: dict[int, HplanError] = {}
    left, pairs = list(range(len(problem.goals))), Pairs() if problem.memory.pairs is None else problem.memory.pairs
    for finder in finders_of(problem):
        remaining = problem.with_goals(*left)
        finder.durations, finder.pairs = np.full(len(left), math.inf), pairs
        try:
            for group in finder.paths(remaining):
                for place, motion in _motions_near(remaining, group, finder):
                    yield left[place], motion
        except FailuresError as error:
            failures |= zip(left, error.errors, strict=True)
            left = [number for number in left if not isinstance(failures[number], NoPathError)]
        if math.isfinite(finder.best_s):
            return
        if not left:
            break  # no path leads to any goal: further search is futile
    raise FailuresError(tuple(failures[number] for number in sorted(failures)) or tuple(_reasons(problem)))


def best_motion(problem: Problem) -> Found:
    """The last of `motions`.

    Raises:
        NoPathError: No path to any goal exists on the grid.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
        NotFoundError: No motion was found within memory and effort; this does not prove that none exists.
    """
    try:
        return best_of(motions(problem))
    except FailuresError as failures:
        raise failures.as_one() from None


def finders_of(problem: Problem) -> Sequence[PathFinder]:
    """The path finders of a problem, in order of preference."""
    specialist = specialist_of(problem.robot)
    found = None if specialist is None else specialist.path_finders(problem)
    if found is None:
        found = (FirstPaths(),) if problem.effort.at_once else (StraightLine(), Trees(), LongTrees())
    return found if problem.effort.long_pairs else [finder for finder in found if not isinstance(finder, LongTrees)]


def reuse_motion(problem: Problem, previous: Motion) -> Motion | None:
    """Keep or repair an earlier motion among changed obstacles.

    Returns:
        The earlier motion itself if it can still be certified, and is straight or still has an obstacle to avoid;
        otherwise a motion along its waypoints, repaired. None if both fail, or start, goal or joint limits have
        changed.
    """
    old = previous.problem
    for number in range(len(problem.goals)):
        new = problem.with_goals(number)
        pairs = ((old.start, new.start), (old.goal, new.goal), (old.lower, new.lower), (old.upper, new.upper))
        if any(before.shape != now.shape or (before != now).any() for before, now in pairs):
            continue
        if previous.path is None or (is_straight_clear(new) and len(previous.waypoints) > 2):
            continue  # it would be a detour
        certificate = certificate_of(new, previous.trajectory)
        if certificate.verified:
            return replace(previous, problem=new, search=None, certificate=certificate, origin="kept")
        margin = new.margin
        clear, contacts = repair(previous.waypoints, new.field, new.lower[0], new.upper[0], 0.1 * margin)
        with suppress(CertificationError, TimingError):
            if not contacts:
                return quickest(new, [Path(clear, "mended")], margin)
    return None


def motion_near(problem: Problem, paths: Sequence[Path]) -> Motion | None:
    """The fastest certified motion near some paths of trees, or None."""
    with suppress(CertificationError, TimingError):
        return quickest(problem, paths, problem.margin) if paths else None
    return None


def searches_grid_first(problem: Problem) -> bool:
    """True if the robot's specialist searches a grid before a straight motion."""
    specialist = specialist_of(problem.robot)
    return specialist is not None and specialist.searches_first(problem)


def prove_each_goal(problem: Problem) -> list[NoPathError | None]:
    """For each goal the error that proves it unreachable; None if open."""
    specialist = specialist_of(problem.robot)
    if specialist is None or not problem.effort.proof_nodes:
        return [None] * len(problem.goals)
    return specialist.prove_infeasible(problem)


def _motions_near(problem: Problem, group: Sequence[Path], finder: PathFinder) -> Iterator[Found]:
    """Motions near a group of paths that are faster than all before.

    The finder learns their durations.
    """
    number = group[0].goal
    one = problem.with_goals(number)
    margin = one.margin if group[0].margin is None else group[0].margin
    finder.error = None
    try:
        if problem.effort.at_once and not problem.is_draft:
            found = improve(motion_along(one, group[0], margin))
        else:
            found = iter((quickest(one, group, margin, quicker_than_s=finder.best_s),))
        for motion in found:
            is_faster = motion.trajectory.duration < finder.best_s
            finder.durations[number] = min(float(finder.durations[number]), motion.trajectory.duration)
            if is_faster:
                yield number, motion
    except (CertificationError, TimingError) as error:
        if isinstance(error, TimingError) and group[0].origin == "direct" and not problem.effort.at_once:
            raise
        finder.error = error.with_traceback(None)


def _rest(problem: Problem) -> Motion:
    """The motion from a configuration to itself."""
    rest = rest_at(problem.robot.model, problem.start)
    certificate = require_certificate(problem, certificate_of(problem, rest))
    return Motion("transit", rest, certificate, problem, frozen(np.array(problem.start[None])), None, "none")


def _reasons(problem: Problem) -> Iterator[NoPathError | NotFoundError]:
    """For each goal an infeasibility proof, or the attempts of the search."""
    specialist = specialist_of(problem.robot)
    tried = ["straight motion", describe_trees(problem)]
    if specialist is not None and problem.effort.proof_nodes:
        tried.append(specialist.describe_proof(problem))
    for error in prove_each_goal(problem):
        yield error or NotFoundError(tried)
