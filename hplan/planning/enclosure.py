"""Regions of a grid that one end of a motion is enclosed in, and the errors that say what bounds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hplan.base.arrays import BoolArray, Record, WordArray
from hplan.cspace.blockers import blockers
from hplan.cspace.sections import ArmSections, sections_at
from hplan.errors import NoPathError
from hplan.problem.definition import Problem
from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.search.flood import slice_sizes
from hplan.search.grid import Grid


class Region(Protocol):
    """A region that knows its border."""

    @property
    def what(self) -> str:
        """Which end is enclosed, in words."""

    def explained(self) -> NoPathError:
        """The error that says what bounds the region."""


@dataclass(frozen=True, eq=False)
class PlanarRegion(Record):
    """A region of the planar grid.

    Attributes:
        what: Which end is enclosed, in words.
        grid: The grid.
        robot: The arm.
        sections: Obstacles cut by the arm plane.
        reached: Mask of the grid's shape.
    """

    what: str
    grid: Grid
    robot: Robot
    sections: ArmSections
    reached: BoolArray

    def explained(self) -> NoPathError:
        """The error that says what bounds the region."""
        walls = blockers(self.robot.arm, self.sections, self.grid, self.reached)
        message = f"no path exists on the grid: {self.what}"
        if walls:
            first = walls[0]
            low, high = first["slices_deg"]
            message += (
                f"; most of their border is held by obstacle {first['obstacle']!r} against link {first['link']!r}"
                f" ({self.robot.arm.joint_names[-1]} from {low:g} to {high:g} deg)"
            )
        return NoPathError(message, reached_cells=int(self.reached.sum()), blockers=walls)


@dataclass(frozen=True, eq=False)
class TurningRegion(Record):
    """A region of a grid over yaws.

    Attributes:
        what: Which end is enclosed, in words.
        grid: The grid: planar joints, then yaw.
        world: The arm and what it must keep clear of.
        growth: By how much obstacles were grown [m].
        reached: (rows, words) nodes of the region, as in `Occupancy`.
    """

    what: str
    grid: Grid
    world: World
    growth: float
    reached: WordArray

    def explained(self) -> NoPathError:
        """The error that says what bounds the region, at the yaw at which it is largest."""
        grid, robot = self.grid, self.world.robot
        layer = int(slice_sizes(self.reached).argmax())
        planar = Grid(grid.lower[:-1], grid.step[:-1], grid.shape[:-1])
        at = float(grid.lower[-1] + layer * grid.step[-1])
        sections = sections_at(robot, self.world.bodies(self.growth), at, within_reach=False)
        inside = (self.reached[:, layer >> 6] >> np.uint64(layer & 63)) & np.uint64(1) > 0
        return PlanarRegion(self.what, planar, robot, sections, inside.reshape(planar.shape)).explained()


class EnclosedError(NoPathError):
    """One end is enclosed on a grid; `explained` finds out by what."""

    def __init__(self, region: Region, reached_cells: int, *, open_ended: bool) -> None:
        """Store what is known at once."""
        super().__init__(f"no path exists on the grid: {region.what}", reached_cells=reached_cells)
        self.open_ended = open_ended
        self._region = region

    @property
    def bare(self) -> NoPathError:
        """The same without the region, which keeps the grid in memory."""
        return NoPathError(self.message, reached_cells=self.reached_cells)

    def explained(self) -> NoPathError:
        """The same with what bounds the region, which takes longer to find than whether another grid is open."""
        return self._region.explained()


def open_ended(problem: Problem, grid: Grid, reached: WordArray) -> bool:
    """Whether a region of a grid over yaws ends at the edge of them, and more yaws are within the limits.

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
