"""Why no motion leads to goals: regions of a grid that no path leaves and what bounds them, and one error for all.

Many goals are decided at once; why no motion leads to any of several is put into one error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hplan.base.arrays import IntArray, WordArray
from hplan.base.deadline import TimeIsUpError
from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    TimingError,
)
from hplan.grid.blockers import blockers
from hplan.grid.flood import bits_of, flood_from, has_bit, slice_sizes
from hplan.grid.grid import Grid
from hplan.grid.lattice import Lattice
from hplan.planning.definition import Problem
from hplan.planning.effort import GridAttempt
from hplan.planning.grid_entry import grid_entry
from hplan.planning.task import PlanningTask

#: What says that there is no motion, or none was found; anything else is a fault of what was asked.
NO_MOTION = (
    BlockedError,
    NoPathError,
    NotFoundError,
    CertificationError,
    TimingError,
    ConfigurationInCollisionError,
)

#: So far the base may turn beyond start and goal where many goals are decided at once, tried in turn [deg].
WIDTHS = (45.0, 360.0)

#: So many reasons stand in the sentence; `data` has all of them.
_TOLD = 3


class Region(NamedTuple):
    """A region of a grid.

    Attributes:
        what: Which end is enclosed, in words.
        grid: Planar joints, then yaw where the base may turn.
        reached: Nodes of the region: a mask of the grid's shape, or (rows, words) bits as in `Occupancy`; always bits
            if the base may turn.
    """

    what: str
    grid: Grid
    reached: NDArray[Any]


class EnclosedError(NoPathError):
    """One end is enclosed on a grid; `explained` finds out by what."""

    def __init__(
        self,
        task: PlanningTask,
        attempt: GridAttempt,
        reached_cells: int,
        region: Region | None = None,
        *,
        open_ended: bool = False,
    ) -> None:
        """Store what is known at once.

        Args:
            reached_cells: Number of the region's nodes; of several goals' regions that of all together.
            region: Where the end is enclosed; without it, it is not known what bounds it.
            open_ended: True if it ends at the edge of the yaws that were looked at, so that more might open it.
        """
        where = "" if region is None else f": {region.what}"
        super().__init__(f"no path exists on the grid{where}", reached_cells=reached_cells)
        self.open_ended = open_ended
        self._task, self._attempt, self._region = task, attempt, region

    @property
    def plain(self) -> NoPathError:
        """The failure without what bounds the region, and without the grid, which takes memory."""
        return NoPathError(self.message, reached_cells=self.reached_cells)

    def explained(self) -> NoPathError:
        """The failure with what bounds the region, which takes longer to find than whether another grid is open.

        If time is up first, the failure without its blockers: the proof stands, and is the error.
        """
        error = self.plain
        if self._region is not None:
            with suppress(TimeIsUpError):
                error = self._bounded(self._region)
        if self._attempt.step_factor > 1.0:
            step_deg = self._task.step_deg(self._attempt)
            remark = f"the grid's step is {step_deg:g} deg, as a finer one over all joint ranges is too large"
            error.add(remark, step_deg=step_deg)
        return error

    def _bounded(self, region: Region) -> NoPathError:
        """The error that says what bounds a region; over yaws, at the yaw at which it is largest."""
        task, grid, reached = self._task, region.grid, region.reached
        yaw = task.robot.yaw_of(task.problem.start)
        if task.problem.turns:
            layer = int(slice_sizes(reached).argmax())
            yaw = float(grid.lower[-1] + layer * grid.step[-1])
            grid = Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
            inside = (reached[:, layer >> 6] >> np.uint64(layer & 63)) & np.uint64(1) > 0
            reached = inside.reshape(grid.shape)
        elif reached.dtype != np.bool_:
            reached = bits_of(reached)[:, : grid.shape[-1]].reshape(grid.shape)
        arm = task.robot.arm
        walls = blockers(arm, task.sections(yaw, self._attempt.growth_m), grid, reached)
        message = self.message
        if walls:
            first = walls[0]
            low, high = first["slices_deg"]
            message += (
                f"; most of their border is held by obstacle {first['obstacle']!r} against link {first['link']!r}"
                f" ({arm.joint_names[-1]} from {low:g} to {high:g} deg)"
            )
        return NoPathError(message, reached_cells=int(reached.sum()), blockers=walls)


def open_ended(problem: Problem, grid: Grid, reached: WordArray) -> bool:
    """Return True if a region over yaws ends at the edge of the grid's yaws, and more yaws are within the limits.

    Args:
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
    grid, lattice = space.grid, Lattice.of(space.grid.shape, space.grid.step)
    goals: dict[int, IntArray] = {}
    with suppress(CertificationError):
        start = np.array(grid_entry(first, space, "start", min(margins)).nodes)
        for number, (task, margin) in enumerate(zip(tasks, margins, strict=True)):
            with suppress(CertificationError):
                goals[number] = np.array(grid_entry(task, space, "goal", margin).nodes)
    if not goals:
        return [None] * len(tasks)

    free = lattice.bordered(space.free_words)
    del space  # grids take tens of megabytes

    def holds(region: WordArray, nodes: IntArray) -> bool:
        return any(has_bit(region, lattice.row_of(node), int(node[-1])) for node in nodes)

    with first.stage("fallback"):
        region, cells = flood_from(lattice, free, np.concatenate(list(goals.values())))
        apart = set(goals)
        if holds(region, start):
            del region
            region, cells = flood_from(lattice, free, start)
            apart = {number for number, nodes in goals.items() if not holds(region, nodes)}
    more = first.problem.turns and open_ended(first.problem, grid, lattice.unbordered(region))
    shown = _smaller_region(grid, free, start, goals[0]) if explained and 0 in apart else None
    return [
        EnclosedError(task, attempt, cells, None if number else shown, open_ended=more) if number in apart else None
        for number, task in enumerate(tasks)
    ]


def _smaller_region(grid: Grid, free: WordArray, start: IntArray, goal: IntArray) -> Region:
    """The region of the start or of the goal, whichever is the smaller."""
    lattice = Lattice.of(grid.shape, grid.step)
    floods = [(*flood_from(lattice, free, nodes), which) for nodes, which in ((start, "start"), (goal, "goal"))]
    (region, count, which), (_, _, other) = sorted(floods, key=lambda flood: flood[1])
    what = f"the {which} is connected to {count} of {grid.size} nodes, and the {other} is not among them"
    return Region(what, grid, lattice.unbordered(region))


def without_path(tasks: Sequence[PlanningTask]) -> list[NoPathError | None]:
    """Goals to which no path exists on the finest grid, decided for all at once.

    Args:
        tasks: One for each goal, from the same start among the same obstacles.

    Returns:
        For each goal the error that says so; None where a path exists, or where that is left open.
    """
    errors: list[NoPathError | None] = [None] * len(tasks)
    todo = list(range(len(tasks)))
    while todo:
        yaw = tasks[todo[0]].problem.goal[0]
        left = [number for number in todo if abs(tasks[number].problem.goal[0] - yaw) < 1e-9]  # on the same grid
        todo = [number for number in todo if number not in left]
        for yaw_range_deg in WIDTHS:
            attempt = tasks[0].to_flood(yaw_range_deg)
            if attempt is None or not left:
                break
            some = [tasks[number] for number in left]
            found = enclosed_goals(some, attempt, [0.1 * task.margin() for task in some], explained=left[0] == 0)
            shown = {number: error for number, error in zip(left, found, strict=True) if error is not None}
            left = [number for number, error in shown.items() if error.open_ended]
            for number in shown.keys() - left:
                errors[number] = shown[number]
    return errors


class FailuresError(Exception):
    """No motion was found to any of several goals. It does not leave planning: `as_one` does.

    Attributes:
        errors: One for each goal, in the goals' order; at least one.
    """

    def __init__(self, errors: tuple[HplanError, ...]) -> None:
        super().__init__(errors)
        self.errors = errors

    def as_one(self, goals: str = "goals") -> HplanError:
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
        text = "; ".join(f"{number} x {reason}" for reason, number in tally[:_TOLD])
        message = f"no certified motion to any of {count} {goals}: {text}{'; ...' if len(tally) > _TOLD else ''}"
        failed = next(error for error in self.errors if not isinstance(error, NoPathError))
        if isinstance(failed, TimingError) and not any(isinstance(error, CertificationError) for error in self.errors):
            return TimingError(message, joint=failed.joint, cause=failed.cause)
        return CertificationError(message, goals=count, reasons=reasons)


def _reason(error: HplanError) -> str:
    return "no path exists on the grid" if isinstance(error, NoPathError) else error.message
