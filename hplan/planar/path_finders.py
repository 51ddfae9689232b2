"""Path finders for planar arms with a locked base.

Two-level grid search and trees.

If the base may turn or the tool has to stay upright, planar arms use the general path finders.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final

from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.planar.effort import PlanarEffort
from hplan.planar.grid_route import find_route
from hplan.planar.grids import (
    COARSEST_DEG,
    MOST_CELLS,
    GridAttempt,
    base_turns,
    count_nodes,
    fitting_attempt,
    grown_margin,
    possible_growth,
)
from hplan.planar.no_path_proof import EnclosedError, enclosed_goals, prove_infeasible
from hplan.planning.failures import FailuresError
from hplan.planning.path_finder import (
    FirstPaths,
    LongTrees,
    Path,
    PathFinder,
    Trees,
    describe_trees,
    is_straight_clear,
    tree_paths,
)
from hplan.planning.problem import Problem

#: Free nodes do not imply free segments: if the segments of a grid path cannot be verified, the search is repeated with
#: obstacles grown by these lengths [m] and, if that fails too, on grids with these multiples of the step.
_GROWTH: Final = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)
_STEP_FACTORS: Final = (1.0, 0.5)

#: A planar grid with more nodes than the first is searched only after trees; a coarse grid above the second is skipped.
_LARGE: Final = 2e6
_MOST_COARSE: Final = 5e6

#: Pairs of trees for the first solution, and distance queries of each; narrow passages are left to the grids.
_AT_ONCE: Final = 2, 1_500


def searches_first(problem: Problem) -> bool:
    """True if the base is locked and the tool may tilt.

    A grid is then searched even if the straight motion is free.
    """
    return _suits_grid(problem)


def _suits_grid(problem: Problem) -> bool:
    """True if a grid over the planar joints has the motions of a problem, and only those.

    Grids do not know how far the tool may tilt, nor obstacles that the arm leaves.
    """
    return not (base_turns(problem) or problem.is_leaving or problem.world.upright is not None)


def path_finders(problem: Problem) -> Sequence[PathFinder] | None:
    """Path finders of a problem; None for the general finders."""
    if not _suits_grid(problem):
        return None
    if problem.effort.at_once:
        return (FirstGridPaths(),)
    if problem.options.method == "dense":
        return (TwoLevelGrid(),)
    if count_nodes(problem, GridAttempt()) > _LARGE:
        # Trees take a fraction of the time, and their paths are shorter than those from a flood of the grid.
        return (TreesAndGrids(), LongTrees(), TwoLevelGrid())
    return (TwoLevelGrid(), LongTrees())


class TwoLevelGrid(PathFinder):
    """Two-level A* on the grid over the planar joints.

    Finer grids and grown obstacles are fallbacks.
    """

    def paths(self, problem: Problem) -> Iterator[tuple[Path, ...]]:
        """Yield the grid path with its alternatives.

        Ends when one leads to a certified motion.

        Raises:
            FailuresError: No path leads to a certified motion; includes the proof for each goal without a path.
        """
        failures: dict[int, HplanError] = {}
        for number in range(len(problem.goals)):
            if number in failures:
                continue
            try:
                yield from self._paths_to(problem.with_goals(number), number)
            except NoPathError as error:
                failures[number] = error.plain if isinstance(error, EnclosedError) and number else error
                error.with_traceback(None)  # it would keep grids in memory
                others = [other for other in range(number + 1, len(problem.goals)) if other not in failures]
                proofs = prove_infeasible(problem, others)
                failures |= {other: proof for other, proof in zip(others, proofs, strict=True) if proof is not None}
            except (CertificationError, NotFoundError, TimingError) as error:
                failures[number] = error.with_traceback(None)
            else:
                return
        raise FailuresError(tuple(failures[number] for number in range(len(problem.goals))))

    def _paths_to(self, problem: Problem, number: int) -> Iterator[tuple[Path, ...]]:
        """Yield paths to one goal until one leads to a certified motion.

        Raises if all fail.
        """
        fitting = [fitting_attempt(problem, GridAttempt(factor)) for factor in _STEP_FACTORS]
        failure: CertificationError | None = None
        for step_factor in dict.fromkeys(attempt.step_factor for attempt in fitting if attempt is not None):
            for growth_m in sorted({possible_growth(problem, growth_m) for growth_m in _GROWTH}):
                attempt = GridAttempt(step_factor, growth_m=growth_m)
                margin = grown_margin(problem, growth_m)
                try:
                    route = find_route(problem, attempt, 0.1 * margin)
                except CertificationError as error:
                    failure = failure or error.with_traceback(None)
                    continue
                except NoPathError:
                    if failure is None:
                        raise
                    break  # grown obstacles close the passage, and the motion without growth could not be certified
                found = Path(route.path, "search", number, route, margin)
                yield (found, *(path._replace(goal=number, margin=margin) for path in self._alternatives(problem)))
                if self.error is None:
                    return
                if isinstance(self.error, TimingError):
                    raise self.error
                if isinstance(self.error, CertificationError):
                    failure = failure or self.error
        coarsest = max(problem.options.step_deg, COARSEST_DEG)
        tried = [] if any(fitting) else [f"no grid of {coarsest:g} deg or less has fewer than {MOST_CELLS:.3g} nodes"]
        raise failure or NotFoundError(
            [*tried, describe_trees(problem)] if problem.options.method == "two-level" else tried
        )

    def _alternatives(self, problem: Problem) -> list[Path]:
        """Tree paths in other homotopy classes than the grid path."""
        effort = problem.effort
        if problem.options.method == "dense" or not isinstance(effort, PlanarEffort) or not effort.after_grid_pairs:
            return []
        if is_straight_clear(problem):
            return []
        return tree_paths(problem, effort.after_grid_pairs, queries=effort.after_grid_queries)


class FirstGridPaths(FirstPaths):
    """Straight lines, then trees to the remaining goals.

    Goals are excluded by a flood of the grid.
    """

    def tree_budget(self, problem: Problem) -> tuple[int, int]:
        """Number of pairs of trees, and maximum number of distance queries of each."""
        del problem
        return _AT_ONCE

    def prove_excluded(self, problem: Problem) -> Sequence[NoPathError | None]:
        """Infeasibility proof of each goal on the planar grid; None without one."""
        attempt, numbers = GridAttempt(), range(len(problem.goals))
        if count_nodes(problem, attempt) > _LARGE:
            return [None] * len(numbers)
        return enclosed_goals(problem, attempt, numbers, explained=True)


class TreesAndGrids(Trees):
    """Paths of pairs of trees and of several coarse grids."""

    def other_paths(self, problem: Problem, number: int) -> Sequence[Path]:
        """Paths on coarse grids, compared with paths of trees."""
        found: list[Path] = []
        effort = problem.effort
        for attempt in effort.coarse_grids if isinstance(effort, PlanarEffort) else ():
            if count_nodes(problem, attempt) <= _MOST_COARSE:
                with suppress(NoPathError):
                    grown = replace(attempt, growth_m=possible_growth(problem, attempt.growth_m))
                    found.append(Path(find_route(problem, grown, 0.1 * problem.margin).path, "search", number))
        return found
