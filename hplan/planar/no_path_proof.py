"""Proves that no path to a goal exists.

A proof names closed regions of a grid, and their obstacles.

Many goals are decided together.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import IntArray, WordArray
from hplan.base.deadline import TimeIsUpError
from hplan.errors import CertificationError, NoPathError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.blockers import blockers
from hplan.planar.grid.flood import bits_of, flood_from, has_bit, slice_sizes
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.lattice import Lattice
from hplan.planar.grid_entry import grid_entry
from hplan.planar.grids import (
    GridAttempt,
    base_turns,
    flood_attempt,
    grid_occupancy,
    obstacle_sections,
    step_deg,
)
from hplan.planar.own_contact import within_bodies
from hplan.planning.failures import UnexplainedNoPathError
from hplan.planning.problem import Problem
from hplan.planning.stages import stage

#: Yaw ranges beyond start and goal in a proof for many goals, tried in this order [deg].
WIDTHS = (45.0, 360.0)


class Region(NamedTuple):
    """A region of a grid.

    Attributes:
        description: Phrase that names the enclosed end.
        grid: Planar joints, then yaw if the base may turn.
        reached: Nodes of the region: a mask of the grid's shape, or (rows, words) bits as in `Occupancy`; always bits
            if the base may turn.
    """

    description: str
    grid: Grid
    reached: NDArray[Any]


class EnclosedError(UnexplainedNoPathError):
    """One end is enclosed on a grid.

    `explained` finds the obstacles around it.
    """

    def __init__(
        self,
        problem: Problem,
        attempt: GridAttempt,
        reached_cells: int,
        region: Region | None = None,
        *,
        open_ended: bool = False,
    ) -> None:
        """Store the facts known without further search.

        Args:
            reached_cells: Number of the region's nodes; for several goals, of all their regions together.
            region: The region of the enclosed end; None if the obstacles around it are unknown.
            open_ended: True if the region ends at the edge of the searched yaws, so that a larger yaw range might open
                it.
        """
        where = "" if region is None else f": {region.description}"
        super().__init__(f"no path exists on the grid{where}", reached_cells=reached_cells)
        self.open_ended = open_ended
        self._problem, self._attempt, self._region = problem, attempt, region

    @property
    def plain(self) -> NoPathError:
        """Return the error without the region and its grid, to free memory."""
        return NoPathError(self.message, reached_cells=self.reached_cells)

    def explain(self) -> NoPathError:
        """Return the error with the obstacles that bound the region.

        Finding them takes longer than the proof itself. If time runs out, the error has no obstacles; the proof holds.
        """
        error = self.plain
        if self._region is not None:
            with suppress(TimeIsUpError):
                error = self._explain_region(self._region)
        if self._attempt.step_factor > 1.0:
            step = step_deg(self._problem, self._attempt)
            remark = f"the grid's step is {step:g} deg because a finer grid over all joint ranges is too large"
            error.add(remark, step_deg=step)
        return error

    def _explain_region(self, region: Region) -> NoPathError:
        """Return the error with the obstacles around a region.

        For a region over yaws, the obstacles are those at the yaw with the largest slice.
        """
        problem, grid, reached = self._problem, region.grid, region.reached
        yaw = family_of(problem.robot).yaw_of(problem.start)
        if base_turns(problem):
            layer = int(slice_sizes(reached).argmax())
            yaw = float(grid.lower[-1] + layer * grid.step[-1])
            grid = Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
            inside = (reached[:, layer >> 6] >> np.uint64(layer & 63)) & np.uint64(1) > 0
            reached = inside.reshape(grid.shape)
        elif reached.dtype != np.bool_:
            reached = bits_of(reached)[:, : grid.shape[-1]].reshape(grid.shape)
        arm = family_of(problem.robot).arm
        walls = blockers(arm, obstacle_sections(problem, yaw, self._attempt.growth_m), grid, reached)
        message = self.message
        if walls:
            first = walls[0]
            low, high = first["slices_deg"]
            message += (
                f"; most of their border is blocked by obstacle {first['obstacle']!r} against link {first['link']!r}"
                f" ({arm.joint_names[-1]} from {low:g} to {high:g} deg)"
            )
        return NoPathError(message, reached_cells=int(reached.sum()), blockers=walls)


def is_open_ended(problem: Problem, grid: Grid, reached: WordArray) -> bool:
    """True if a larger yaw range might open a region.

    Within the limits.

    The region then ends at the edge of the grid's yaws, and the joint limits allow more yaws.

    Args:
        reached: (rows, words) bits of the region, without border.
    """
    ever = np.bitwise_or.reduce(reached)
    last = grid.shape[-1] - 1
    below, above = int(ever[0]) & 1, int(ever[last >> 6]) >> (last & 63) & 1
    first, step = grid.lower[-1], grid.step[-1]
    return bool(
        (below and first - step >= problem.lower[0][0] - 1e-9)
        or (above and first + (last + 1) * step <= problem.upper[0][0] + 1e-9)
    )


def enclosed_goals(
    problem: Problem, attempt: GridAttempt, numbers: Sequence[int], *, explained: bool = False
) -> list[EnclosedError | None]:
    """Prove by a flood which goals the start cannot reach.

    The flood is that of one grid.

    It is the grid of the first goal. The goals' regions are flooded first, because they are usually small pockets that
    do not contain the start.

    Args:
        numbers: Indices of the goals.
        explained: True if the error of the first goal keeps the enclosed region.

    Returns:
        For each goal the error that proves that no path exists; None if a path exists, if start or goal cannot be
        connected to the grid, or if the links have no capsules (`within_bodies`).

    Raises:
        OptionError: The step gives no valid grid.
    """
    robot = within_bodies(problem.robot)
    if not numbers or robot is None:
        return [None] * len(numbers)
    if robot is not problem.robot:
        problem = replace(problem, robot=robot, other_world=replace(problem.world, robot=robot))
    problems = [problem.with_goals(number) for number in numbers]
    margins = [0.1 * one.margin for one in problems]
    first = problems[0]
    space = grid_occupancy(first, attempt)
    grid, lattice = space.grid, Lattice.build(space.grid.shape, space.grid.step)
    goals: dict[int, IntArray] = {}
    with suppress(CertificationError):
        start = np.array(grid_entry(first, space, "start", min(margins)).nodes)
        for number, (one, margin) in enumerate(zip(problems, margins, strict=True)):
            with suppress(CertificationError):
                goals[number] = np.array(grid_entry(one, space, "goal", margin).nodes)
    if not goals:
        return [None] * len(problems)

    free = lattice.add_border(space.free_words)
    del space  # grids take tens of megabytes

    def holds(region: WordArray, nodes: IntArray) -> bool:
        return any(has_bit(region, lattice.row_of(node), int(node[-1])) for node in nodes)

    with stage("fallback"):
        region, cells = flood_from(lattice, free, np.concatenate(list(goals.values())))
        separate = set(goals)
        if holds(region, start):
            del region
            region, cells = flood_from(lattice, free, start)
            separate = {number for number, nodes in goals.items() if not holds(region, nodes)}
    more = base_turns(first) and is_open_ended(first, grid, lattice.remove_border(region))
    kept = _smaller_region(grid, free, start, goals[0]) if explained and 0 in separate else None
    return [
        EnclosedError(one, attempt, cells, None if number else kept, open_ended=more) if number in separate else None
        for number, one in enumerate(problems)
    ]


def _smaller_region(grid: Grid, free: WordArray, start: IntArray, goal: IntArray) -> Region:
    """Region of the start or of the goal, whichever is smaller."""
    lattice = Lattice.build(grid.shape, grid.step)
    floods = [(*flood_from(lattice, free, nodes), which) for nodes, which in ((start, "start"), (goal, "goal"))]
    (region, count, which), (_, _, other) = sorted(floods, key=lambda flood: flood[1])
    description = f"the {which} is connected to {count} of {grid.size} nodes, and the {other} is not among them"
    return Region(description, grid, lattice.remove_border(region))


def prove_infeasible(problem: Problem, numbers: Sequence[int] | None = None) -> list[NoPathError | None]:
    """Prove for several goals that no path exists.

    On the finest grid.

    Args:
        numbers: Indices of the goals; None for all goals.

    Returns:
        For each goal the error that proves it; None if a path exists or the question is undecided.
    """
    numbers = range(len(problem.goals)) if numbers is None else numbers
    if problem.is_leaving:
        return [None] * len(numbers)
    errors: dict[int, NoPathError | None] = dict.fromkeys(numbers)
    first, remaining = next(iter(numbers), None), list(numbers)
    while remaining:
        yaw = problem.goals[remaining[0]][0]
        left = [number for number in remaining if abs(problem.goals[number][0] - yaw) < 1e-9]  # on the same grid
        remaining = [number for number in remaining if number not in left]
        for yaw_range_deg in WIDTHS:
            attempt = flood_attempt(problem.with_goals(numbers[0]), yaw_range_deg)
            if attempt is None or not left:
                break
            found = enclosed_goals(problem, attempt, left, explained=left[0] == first)
            proved = {number: error for number, error in zip(left, found, strict=True) if error is not None}
            left = [number for number, error in proved.items() if error.open_ended]
            for number in proved.keys() - left:
                errors[number] = proved[number]
    return list(errors.values())


def describe_proof(problem: Problem) -> str:
    """Phrase for errors that names the grids of an attempted proof."""
    widest = flood_attempt(problem.with_goals(0), WIDTHS[-1])
    if widest is None:
        return "no grid over all yaws fits"
    return f"grids down to {step_deg(problem, widest):g} deg"
