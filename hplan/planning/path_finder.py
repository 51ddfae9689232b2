"""Path finders: straight lines, pairs of trees, and additions by specialists.

A path finder yields groups of paths to one goal. The solver (`hplan.planning.solver`) makes the fastest certified
motion of each group, notes its duration in the finder, and requests the next group as long as that may be worthwhile.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, frozen
from hplan.errors import HplanError, NoPathError
from hplan.optimization.path_classes import PARTS, class_numbers
from hplan.optimization.shortcut import shorten
from hplan.optimization.smooth_path import START_SHORTCUTS
from hplan.planning.effort import FAR_FROM_BOUND
from hplan.planning.failures import FailuresError
from hplan.planning.growing_trees import Pairs
from hplan.planning.problem import Problem
from hplan.planning.recent_paths import recent_path
from hplan.planning.rrt_connect import tree_path
from hplan.planning.stages import stage
from hplan.robot.limits import clock_at_limits

#: The origin of a path: none (start and goal are the same), a straight line, trees, a grid search, an earlier motion
#: (repaired or unchanged), several earlier motions, or the caller.
Origin: TypeAlias = Literal["none", "direct", "trees", "search", "mended", "kept", "recent", "given"]

#: Maximum number of paths of one homotopy class; more than one, since smoothing may fail.
OF_A_CLASS = 3

#: A path is promising if the time along it, as a multiple of the time along an optimized path, is at most the square of
#: this fraction of the optimized motion's duration as a multiple of its lower bound. On 207 odd MotionBenchMaker
#: problems of Fetch, the motions last 0.6 % longer than with all second paths. Comparing the times alone, in homotopy
#: classes, costs 1.1 % at the same CPU time.
PROMISING = 0.68

#: A path takes a long way if the time along it after shortcuts is more than this multiple of the lower bound on a
#: motion's duration. Then a second pair of trees grows before a path is optimized: the faster path nearly always leads
#: to the faster motion, and the optimizer takes several times as long as trees. Shorter ways of Panda and UR5 mostly
#: lead to motions close to the bound. On 68 odd MotionBenchMaker problems of Fetch, this saves 16 % of the CPU time,
#: and the motions last as long; a third pair costs more than it saves.
LONG_WAY = 2.2

#: Minimum number of distance queries of a second pair of long trees.
_SHORT = 8_000

#: Fraction of their budget that all long trees use before any of them uses more.
_EARLY = 3

#: Number of joints beyond which each more multiplies the pairs of long trees by the factor.
_FEW_JOINTS, _PAIRS_PER_JOINT = 7, 4

#: Number of goals that trees search one by one before they search all goals together.
_ONE_BY_ONE = 2


class GridSearchRecord(Protocol):
    """Record of a search on a grid.

    Attributes:
        occupancy: The C-space that was searched.
        search: The result of the search.
    """

    @property
    def occupancy(self) -> Any: ...  # noqa: D102
    @property
    def search(self) -> Any: ...  # noqa: D102

    def report(self) -> dict[str, Any]:
        """Return the entries that replace defaults in the report's section `planner`."""


class Path(NamedTuple):
    """A path of straight motions in joint space.

    Attributes:
        waypoints: (m, dof) configurations from the start to a goal.
        origin: The finder or source of the path.
        goal: Number of the problem's goal that it leads to.
        search: The grid search that found it; None for none.
        margin: Clearance that the motion near it must have beyond the required one; None for the problem's [m].
        least_s: Approximate duration of a motion along it after shortcuts; None if not computed [s].
    """

    waypoints: FloatArray
    origin: Origin
    goal: int = 0
    search: GridSearchRecord | None = None
    margin: float | None = None
    least_s: float | None = None


class PathFinder(ABC):
    """Finds paths from the start of a problem to its goals.

    A finder serves one search. The solver notes what came of the paths, and the finder reads that to decide whether to
    go on.

    Attributes:
        durations: (n,) duration of the fastest certified motion to each goal; inf without one [s].
        error: Why the last group led to no certified motion; None if it led to one.
        pairs: Trees that have not met yet and can grow on.
    """

    def __init__(self) -> None:
        """Start without results; the solver sets durations and pairs."""
        self.durations = np.zeros(0)
        self.error: HplanError | None = None
        self.pairs: Pairs = {}

    @property
    def best_s(self) -> float:
        """Duration of the fastest certified motion; inf without one [s]."""
        return float(self.durations.min())

    @abstractmethod
    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield groups of alternative paths to one goal each.

        Raises:
            FailuresError: None leads to a motion; holds the reason for each goal.
        """


def straight_path(problem: Problem, goal: int = 0) -> Path:
    """The straight line from the start to a goal."""
    return Path(frozen(np.stack([problem.start, problem.goals[goal]])), "direct", goal)


def is_straight_clear(problem: Problem) -> bool:
    """True if the straight motion to the first goal is verified collision-free."""
    return problem.field.is_clear(straight_path(problem).waypoints, problem.margin)


class StraightLine(PathFinder):
    """The straight line to the first goal with a free one."""

    #: A goal is searched with trees if its lower bound is below this fraction of the straight motion's duration.
    _WORTHWHILE = 0.7

    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield the line, then paths to goals that may be much faster.

        The latter have an obstructed line.
        """
        for number in range(len(problem.goals)):
            if not is_straight_clear(problem.with_goals(number)):
                continue
            yield (straight_path(problem, number),)
            if math.isinf(self.durations[number]):
                continue  # another path may lead to a motion that can be certified
            enough = self._WORTHWHILE * self.durations[number]
            better = (other for other in range(number) if problem.with_goals(other).least_duration < enough)
            if (sooner := next(better, None)) is not None:
                trees = Trees()
                trees.durations = self.durations
                yield from trees.paths_to(problem, sooner)
            return


class Trees(PathFinder):
    """Paths of pairs of trees (RRT-Connect), later of several homotopy classes."""

    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield paths to the first reachable goal, or to several faster ones."""
        compared = problem.effort.compared
        for number in range(min(len(problem.goals), max(_ONE_BY_ONE, compared))):
            is_found = math.isfinite(self.best_s)
            if is_found and (compared == 1 or problem.with_goals(number).least_duration >= self.best_s):
                continue
            yield from self.paths_to(problem, number)

    def paths_to(self, problem: Problem, number: int) -> Iterator[tuple[Path, ...]]:
        """Yield one pair's path to a goal, or the faster one of two, then several pairs'.

        The others are skipped if the motion is close to the fastest.
        """
        one, grown = problem.with_goals(number), 1
        first = [with_time_if_long(one, path) for path in tree_paths(one, grown, pairs=self.pairs)]
        if first and problem.effort.pairs > grown and is_long_way(one, first[0]):
            grown = 2
            first = tree_paths(one, grown, known=first, grown=1, pairs=self.pairs)
        if first:
            yield (first[0]._replace(goal=number),)
        if self.durations[number] <= problem.effort.close * one.least_duration:
            return
        known_s = float(self.durations[number])  # the motion near the first
        found = tree_paths(one, problem.effort.pairs, known=first, grown=grown, pairs=self.pairs, known_s=known_s)
        group = (*self.other_paths(one, number), *(path._replace(goal=number) for path in found))
        if group:
            yield group

    def other_paths(self, problem: Problem, number: int) -> Sequence[Path]:
        """Paths from other sources, to compare with the trees' paths."""
        del problem, number
        return ()


class LongTrees(PathFinder):
    """Paths of trees with a larger budget, to whichever goal they reach."""

    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield a group for each pair that meets; of the first two pairs the faster path first.

        If the trees grow for one goal after the other, yield a group for each goal after all pairs have grown.
        """
        effort, waiting, tried = problem.effort, list[Path](), dict[int, Path]()
        seeds, queries = long_trees(problem)
        met, most = set[int](), queries
        for seed, before, after in _turns(seeds, effort.long_pairs, queries):
            if seed in met:
                continue
            is_second = bool(waiting) or math.isfinite(self.best_s)
            path, evaluations = tree_to_any(problem, min(after, before + most), seed, self.pairs)
            if path is not None:
                met.add(seed)
                waiting.append(path._replace(least_s=time_along_path(problem.with_goals(path.goal), path)))
            if not effort.long_stops_early or not (waiting or is_second):
                continue
            if not is_second:
                # A second pair that takes about as long as this one did.
                most = max(_SHORT, 3 * evaluations // 2)
                if is_long_way(problem.with_goals(waiting[0].goal), waiting[0]):
                    continue
            yield from self._fastest_first(problem, waiting, tried)
            waiting.clear()
            if math.isinf(self.best_s):
                most = queries
                continue
            bound = problem.with_goals(int(self.durations.argmin())).least_duration
            if is_second or self.best_s <= FAR_FROM_BOUND * bound:
                return
        for goal in dict.fromkeys(path.goal for path in waiting):
            if math.isfinite(self.best_s):
                return
            yield tuple(path for path in waiting if path.goal == goal)

    def _fastest_first(
        self, problem: Problem, paths: Sequence[Path], tried: dict[int, Path]
    ) -> Iterator[tuple[Path, ...]]:
        """Yield paths, the fastest first, without those that are not promising.

        Args:
            problem: The problem with all goals.
            paths: Paths of trees.
            tried: By goal the path near which the fastest motion is known; extended.
        """
        times = [time_along_path(problem.with_goals(path.goal), path) for path in paths]
        for number in ties.argsort(times).tolist():
            path = paths[number]
            one, known_s = problem.with_goals(path.goal), float(self.durations[path.goal])
            if path.goal in tried and not promising_paths(one, [path], tried[path.goal], known_s):
                continue
            yield (path,)
            if self.durations[path.goal] < known_s:
                tried[path.goal] = path


class FirstPaths(PathFinder):
    """The first promising paths: straight lines, one along recent motions, then trees."""

    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield single paths until one leads to a certified motion.

        Raises:
            FailuresError: No path leads to any goal, with a proof for each.
        """
        for path in self._candidates(problem):
            yield (path,)
            if math.isfinite(self.best_s):
                return

    def _candidates(self, problem: Problem) -> Iterator[Path]:
        yield from (straight_path(problem, number) for number in range(len(problem.goals)))
        proofs = self.prove_excluded(problem)
        if all(proofs):
            raise FailuresError(tuple(error for error in proofs if error is not None))
        left = [number for number, error in enumerate(proofs) if error is None]
        pairs, queries = self.tree_budget(problem)
        remaining = problem.with_goals(*left)
        known = path_along_recent(remaining)
        if known is not None:
            yield known._replace(goal=left[known.goal])
        for seed in range(problem.effort.seed, problem.effort.seed + pairs):
            path, _ = tree_to_any(remaining, queries, seed, self.pairs)
            if path is not None:
                yield path._replace(goal=left[path.goal])

    def tree_budget(self, problem: Problem) -> tuple[int, int]:
        """Number of pairs of trees, and maximum number of distance queries of each."""
        return problem.effort.pairs, problem.effort.queries

    def prove_excluded(self, problem: Problem) -> Sequence[NoPathError | None]:
        """For each goal the proof that no path leads there, or None."""
        return [None] * len(problem.goals)


def tree_paths(
    problem: Problem,
    count: int,
    *,
    queries: int | None = None,
    known: Sequence[Path] = (),
    grown: int = 0,
    pairs: Pairs | None = None,
    known_s: float = math.inf,
) -> list[Path]:
    """Paths of pairs of trees to the problem's first goal.

    The fastest path of every homotopy class.

    They are compared by their durations after shortcuts, but not shortened: shortened paths touch the margin and leave
    no room for smoothing.

    Args:
        problem: The problem with one goal.
        count: Number of pairs.
        queries: Maximum number of distance queries of each pair; None for the problem's.
        known: Paths that are known already.
        grown: Number of pairs that have grown already and found the known paths.
        pairs: Trees that can grow on, as in `tree_path`.
        known_s: Duration of the motion near the first known path; if there is one, only the others are returned, and
            only promising ones (`promising_paths`) [s].

    Returns:
        The paths, known ones included, fastest first; at most `OF_A_CLASS` of each homotopy class
        (`hplan.optimization.path_classes`).
    """
    found, each, first = list(known), problem.effort.queries if queries is None else queries, problem.effort.seed
    with stage("trees"):
        for seed in range(first + grown, first + count):
            waypoints, _ = tree_path(problem, 0.1 * problem.margin, each, seed, pairs=pairs)
            if waypoints is not None:
                found.append(Path(waypoints, "trees"))
        if len(found) > 1:
            found = [path._replace(least_s=time_along_path(problem, path)) for path in found]
        if known and math.isfinite(known_s):
            found = promising_paths(problem, found[1:], found[0], known_s)
        if len(found) < 2:
            return found
        order = ties.argsort([time_along_path(problem, path) for path in found]).tolist()
        if len(found) > OF_A_CLASS:
            velocity = problem.robot.velocity_limit
            points = np.stack([_sample_evenly(shorten_path(problem, found[number]), velocity) for number in order])
            classes = class_numbers(points, problem.field)
            order = [k for n, k in enumerate(order) if np.count_nonzero(classes[:n] == classes[n]) < OF_A_CLASS]
        return [found[number] for number in order]


def promising_paths(problem: Problem, paths: Sequence[Path], optimized: Path, optimized_s: float) -> list[Path]:
    """The paths near which a motion may be faster than that near an optimized one.

    They are compared by the times along them after shortcuts (`PROMISING`). All of them are promising if the optimizer
    takes several paths of a homotopy class.

    Args:
        problem: The problem with one goal.
        optimized: The path near which a motion is known.
        optimized_s: Duration of that motion [s].
    """
    if problem.effort.starts.others or not paths:
        return list(paths)
    known, *times = (time_along_path(problem, path) for path in (optimized, *paths))
    longest = known * (PROMISING * optimized_s / problem.least_duration) ** 2
    return [path for path, time in zip(paths, times, strict=True) if time <= longest]


def shorten_path(problem: Problem, path: Path) -> FloatArray:
    """(k, dof) waypoints of a path of trees after shortcuts."""
    return shorten(path.waypoints, problem.field, margin=0.1 * problem.margin, rounds=START_SHORTCUTS)


def time_along_path(problem: Problem, path: Path) -> float:
    """Approximate duration of a motion along a path of trees after shortcuts [s]."""
    if path.least_s is not None:
        return path.least_s
    return path_time(shorten_path(problem, path), problem.robot.velocity_limit)


def with_time_if_long(problem: Problem, path: Path) -> Path:
    """A path of trees with its duration after shortcuts, so that it is computed once, if it is long before them."""
    is_long = path_time(path.waypoints, problem.robot.velocity_limit) > LONG_WAY * problem.least_duration
    return path._replace(least_s=time_along_path(problem, path)) if is_long else path


def is_long_way(problem: Problem, path: Path) -> bool:
    """True if a motion along a path of trees takes much longer than the lower bound (`LONG_WAY`)."""
    longest = LONG_WAY * problem.least_duration
    return path_time(path.waypoints, problem.robot.velocity_limit) > longest < time_along_path(problem, path)


def path_time(path: FloatArray, velocity: FloatArray) -> float:
    """Approximate duration of a motion along waypoints [s].

    Time at the velocity limits, plus 0.02 s for each corner.
    """
    return float((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1).sum() + 0.02 * (len(path) - 2))


def _sample_evenly(path: FloatArray, velocity: FloatArray) -> FloatArray:
    """(k, dof) points of a path, at `PARTS` of its duration."""
    clock = clock_at_limits(path, velocity)
    return np.stack([np.interp(PARTS * clock[-1], clock, joint) for joint in path.T], axis=1)


def path_along_recent(problem: Problem) -> Path | None:
    """A path along recent motions to any goal, or None."""
    with stage("trees"):
        waypoints = recent_path(problem, _tree_margin(problem))
    return None if waypoints is None else Path(waypoints, "recent", _goal_at(problem, waypoints[-1]))


def _tree_margin(problem: Problem) -> float:
    """Clearance beyond the required one that paths to any of a problem's goals keep [m]."""
    return 0.1 * min(problem.with_goals(number).margin for number in range(len(problem.goals)))


def _goal_at(problem: Problem, end: FloatArray) -> int:
    """Number of the goal where a path ends."""
    return int((problem.goals == end).all(axis=1).argmax())


def tree_to_any(problem: Problem, evaluations: int, seed: int, pairs: Pairs | None = None) -> tuple[Path | None, int]:
    """A path of one pair of trees to any goal, or None.

    The second value is the number of distance queries spent.
    """
    with stage("trees"):
        path, used = tree_path(problem, _tree_margin(problem), evaluations, seed, goals=problem.goals, pairs=pairs)
    return None if path is None else Path(path, "trees", _goal_at(problem, path[-1])), used


def long_trees(problem: Problem) -> tuple[range, int]:
    """Seeds of the trees before a goal is refused, and distance queries of each.

    More pairs for arms of many joints. Half of the queries among point clouds, where one costs up to four times as
    much.
    """
    effort = problem.effort
    pairs = effort.long_pairs * _PAIRS_PER_JOINT ** max(0, len(problem.movable) - _FEW_JOINTS)
    is_cloudy = any(solid.is_point_set for solid in problem.world.solids)
    first = effort.seed + effort.long_seed
    return range(first, first + pairs), effort.long_queries // 2 if is_cloudy else effort.long_queries


def _turns(seeds: Sequence[int], together: int, queries: int) -> Iterator[tuple[int, int, int]]:
    """The turns of pairs of long trees: seed, and distance queries before and after each turn.

    Most pairs meet soon or take long: `together` pairs grow to a part of the budget before any of them uses all of it,
    and all of it before the next ones begin.
    """
    for first in range(0, len(seeds), together):
        for before, after in ((0, queries // _EARLY), (queries // _EARLY, queries)):
            yield from ((seed, before, after) for seed in seeds[first : first + together])


def describe_trees(problem: Problem) -> str:
    """Return a phrase with the budget of all trees, for errors."""
    effort = problem.effort
    each = dict.fromkeys(range(effort.seed, effort.seed + effort.pairs), effort.queries)
    each |= dict.fromkeys(*long_trees(problem))  # by seed: some of the long ones have grown before
    return f"trees with {sum(each.values())} distance queries"
