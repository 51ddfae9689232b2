"""Many goals decided at once: which of them the start cannot reach on one grid, shown by flooding it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import IntArray, WordArray
from hplan.errors import CertificationError
from hplan.planning.enclosure import open_ended
from hplan.planning.grid_route import GridAttempt, PlanningTask, planar_space, turning_space
from hplan.search.flood import flood_from, has_bit
from hplan.search.lattice import Lattice


@dataclass(frozen=True)
class Component:
    """A part of a grid, connected to nothing else, that holds a goal and not the start, or the start and not a goal.

    Attributes:
        cells: Number of its nodes; of several goals' regions that of all together.
        open_ended: Whether it ends at the edge of the yaws that were looked at, so that more of them might open it.
    """

    cells: int
    open_ended: bool


def enclosed_goals(
    tasks: Sequence[PlanningTask], grid_attempt: GridAttempt, margins: Sequence[float]
) -> list[Component | None]:
    """Which of several goals the start is not connected to on one grid: that of the first.

    The goals' regions are flooded first: most often they are small pockets, and the start is in none of them.

    Args:
        tasks: One for each goal, from the same start among the same obstacles.
        grid_attempt: The grid.
        margins: For each goal the clearance asked of the motions that join it to the grid [m].

    Returns:
        For each goal what shows that no path leads to it; None where one does, or an end cannot be joined to the grid.

    Raises:
        OptionError: A step that gives no grid.
    """
    first = tasks[0]
    space = turning_space(first, grid_attempt) if first.problem.turns else planar_space(first, grid_attempt)[0]
    lattice = Lattice.of(space.grid.shape, space.grid.step)
    free = lattice.bordered(space.free_words)
    goals: dict[int, IntArray] = {}
    with suppress(CertificationError):
        start = np.array(first.end(space, "start", min(margins)).all())
        for number, (task, margin) in enumerate(zip(tasks, margins, strict=True)):
            with suppress(CertificationError):
                goals[number] = np.array(task.end(space, "goal", margin).all())
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
    return [Component(cells, more) if number in apart else None for number in range(len(tasks))]
