"""Why no motion leads to goals: regions of a grid that no path leaves and what bounds them, and one error for all.

Many goals are decided at once; why no motion leads to any of several is put into one error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import IntArray, Record, WordArray
from hplan.errors import CertificationError, HplanError, NoPathError, NotFoundError, TimingError
from hplan.grid.blockers import blockers
from hplan.grid.flood import flood_from, has_bit, slice_sizes
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.lattice import Lattice
from hplan.planning.definition import Problem
from hplan.planning.grid_entry import grid_entry
from hplan.planning.task import GridAttempt, PlanningTask

#: So many reasons stand in the sentence; `data` has all of them.
TOLD = 3


@dataclass(frozen=True, eq=False)
class Region(Record):
    """A region of a grid.

    Attributes:
        what: Which end is enclosed, in words.
        task: The motion that was to be planned.
        growth_m: By how much obstacles were grown [m].
        grid: Planar joints, then yaw where the base may turn.
        reached: Nodes of the region: a mask of the grid's shape or, where the base may turn, (rows, words) bits as in
            `Occupancy`.
    """

    what: str
    task: PlanningTask
    growth_m: float
    grid: Grid
    reached: NDArray[Any]

    def explained(self) -> NoPathError:
        """The error that says what bounds the region; over yaws, at the yaw at which it is largest."""
        grid, reached, arm = self.grid, self.reached, self.task.robot.arm
        yaw = self.task.robot.yaw_of(self.task.problem.start)
        if self.task.problem.turns:
            layer = int(slice_sizes(reached).argmax())
            yaw = float(grid.lower[-1] + layer * grid.step[-1])
            grid = Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
            inside = (reached[:, layer >> 6] >> np.uint64(layer & 63)) & np.uint64(1) > 0
            reached = inside.reshape(grid.shape)
        walls = blockers(arm, self.task.sections(yaw, self.growth_m), grid, reached)
        message = f"no path exists on the grid: {self.what}"
        if walls:
            first = walls[0]
            low, high = first["slices_deg"]
            message += (
                f"; most of their border is held by obstacle {first['obstacle']!r} against link {first['link']!r}"
                f" ({arm.joint_names[-1]} from {low:g} to {high:g} deg)"
            )
        return NoPathError(message, reached_cells=int(reached.sum()), blockers=walls)


class EnclosedError(NoPathError):
    """One end is enclosed on a grid; `explained` finds out by what."""

    def __init__(self, region: Region | None, reached_cells: int, *, open_ended: bool) -> None:
        """Store what is known at once; without the region it is not known what bounds it.

        Args:
            region: Where the end is enclosed.
            reached_cells: Number of its nodes; of several goals' regions that of all together.
            open_ended: True if it ends at the edge of the yaws that were looked at, so that more might open it.
        """
        where = "" if region is None else f": {region.what}"
        super().__init__(f"no path exists on the grid{where}", reached_cells=reached_cells)
        self.open_ended = open_ended
        self.coarse_step_deg: float | None = None  # of the grid, where a finer one did not fit
        self._region = region

    def forget_region(self) -> None:
        """Forget the region, which keeps the grid in memory."""
        self._region = None

    def explained(self) -> NoPathError:
        """The same with what bounds the region, which takes longer to find than whether another grid is open."""
        known = NoPathError(self.message, reached_cells=self.reached_cells)
        error = known if self._region is None else self._region.explained()
        if self.coarse_step_deg is not None:
            remark = (
                f"the grid's step is {self.coarse_step_deg:g} deg, as a finer one over all joint ranges is too large"
            )
            error.add(remark, step_deg=self.coarse_step_deg)
        return error


def open_ended(problem: Problem, grid: Grid, reached: WordArray) -> bool:
    """Return True if a region over yaws ends at the edge of the grid's yaws, and more yaws are within the limits.

    Args:
        problem: The limits.
        grid: Planar joints and yaw.
        reached: (rows, words) the region, without border.
    """
    ever = np.bitwise_or.reduce(reached)
    last = grid.shape[-1] - 1
    below, above = int(ever[0]) & 1, int(ever[last >> 6]) >> (last & 63) & 1
    first, step = grid.lower[-1], grid.step[-1]
    return bool(
        (below and first - step >= problem.lower[0] - 1e-9)
        or (above and first + (last + 1) * step <= problem.upper[0] + 1e-9)
    )


def enclosed_goals(
    tasks: Sequence[PlanningTask], attempt: GridAttempt, margins: Sequence[float], *, explained: bool = False
) -> list[EnclosedError | None]:
    """Goals that the start is not connected to on one grid, that of the first, shown by flooding it.

    The goals' regions are flooded first: most often they are small pockets, and the start is in none of them.

    Args:
        tasks: One for each goal, from the same start among the same obstacles.
        attempt: The grid.
        margins: For each goal the clearance asked of the motions that join it to the grid [m].
        explained: Whether the error of the first goal holds the region that shows it.

    Returns:
        For each goal the error that says that no path leads to it; None where one does, or an end cannot be joined to
        the grid.

    Raises:
        OptionError: A step that gives no grid.
    """
    if not tasks:
        return []
    first = tasks[0]
    space = first.occupancy(attempt)
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    free = lattice.bordered(space.free_words)
    goals: dict[int, IntArray] = {}
    with suppress(CertificationError):
        start = np.array(grid_entry(first, space, "start", min(margins)).all())
        for number, (task, margin) in enumerate(zip(tasks, margins, strict=True)):
            with suppress(CertificationError):
                goals[number] = np.array(grid_entry(task, space, "goal", margin).all())
    if not goals:
        return [None] * len(tasks)

    def holds(region: WordArray, nodes: IntArray) -> bool:
        return any(has_bit(region, lattice.row_of(node), int(node[-1])) for node in nodes)

    with first.stage("fallback"):
        region, cells = flood_from(lattice, free, np.concatenate(list(goals.values())))
        apart = set(goals)
        if holds(region, start):
            region, cells = flood_from(lattice, free, start)
            apart = {number for number, nodes in goals.items() if not holds(region, nodes)}
    more = first.problem.turns and open_ended(first.problem, space.grid, lattice.unbordered(region))
    shown = _smaller_region(first, attempt, space, free, (start, goals[0])) if explained and 0 in apart else None
    return [
        EnclosedError(shown if number == 0 else None, cells, open_ended=more) if number in apart else None
        for number in range(len(tasks))
    ]


def _smaller_region(
    task: PlanningTask, attempt: GridAttempt, space: Occupancy, free: WordArray, ends: tuple[IntArray, IntArray]
) -> Region:
    """The region of the start or of the goal, whichever is the smaller."""
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    (from_start, of_start), (from_goal, of_goal) = (flood_from(lattice, free, nodes) for nodes in ends)
    is_start = of_start <= of_goal
    which, other, count = ("start", "goal", of_start) if is_start else ("goal", "start", of_goal)
    what = f"the {which} is connected to {count} of {space.grid.size} nodes, and the {other} is not among them"
    reached = lattice.unbordered(from_start if is_start else from_goal)
    return Region(what, task, attempt.growth_m, space.grid, reached)


@dataclass(frozen=True, eq=False)
class Refusals:
    """Errors of several goals.

    Attributes:
        errors: One for each goal, in the goals' order; at least one.
    """

    errors: tuple[HplanError, ...]

    def error(self, goals: str = "goals") -> HplanError:
        """The one error to raise.

        `NoPathError` only where no path was shown for every goal; `NotFoundError` where it was shown for some and no
        motion was found to the others.

        Args:
            goals: What the goals are, in the plural.
        """
        first, count = self.errors[0], len(self.errors)
        if isinstance(first, NoPathError) and all(isinstance(error, NoPathError) for error in self.errors):
            told = first.explained() if isinstance(first, EnclosedError) else first
            detail = told.message.removeprefix("no path exists on the grid: ")
            message = f"no path exists on the grid to any of {count} {goals}; to the first of them: {detail}"
            return (
                told
                if count == 1
                else NoPathError(message, reached_cells=told.reached_cells, blockers=told.blockers, goals=count)
            )
        if count == 1:
            return first
        tally = Counter(_reason(error) for error in self.errors).most_common()  # in order of appearance where equal
        reasons = [{"reason": reason, "goals": number} for reason, number in tally]
        if all(isinstance(error, NoPathError | NotFoundError) for error in self.errors):
            missed = next(error for error in self.errors if isinstance(error, NotFoundError))
            return NotFoundError(missed.tried, goals=count, reasons=reasons)
        text = "; ".join(f"{number} x {reason}" for reason, number in tally[:TOLD])
        message = f"no certified motion to any of {count} {goals}: {text}{'; ...' if len(tally) > TOLD else ''}"
        failed = next(error for error in self.errors if not isinstance(error, NoPathError))
        if isinstance(failed, TimingError) and not any(isinstance(error, CertificationError) for error in self.errors):
            return TimingError(message, joint=failed.joint, cause=failed.cause)
        return CertificationError(message, goals=count, reasons=reasons)


def _reason(error: HplanError) -> str:
    return "no path exists on the grid" if isinstance(error, NoPathError) else error.message
