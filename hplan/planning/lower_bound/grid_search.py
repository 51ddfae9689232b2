"""Which lengths of motion reachability on a grid of up to three joints excludes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, Record, WordArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.flat_bodies import BALL_RADIUS, BODIES, FIRST, LAST, MEETS
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.lower_bound.occupied_cells import AXES, Cells, take_occupied
from hplan.planning.lower_bound.reachability import Samples, is_reachable

#: Into how many parts a cell is cut; the bits of 64 cells.
_PARTS, _ALL = 16, np.uint64(2**64 - 1)

#: How many configurations of bodies that the same joints move are looked at in a grid, about, and of hulls fewer.
_LOOKS = 4e6


@dataclass(frozen=True, eq=False)
class TimedGrid(Record):
    """A grid over some joints with the time between samples, for motions of up to some length.

    Attributes:
        motions: The joints, in the order of the axes; for an axis that is missing one that stands still.
        longest: Length of the longest motions [s].
        period: Time between samples [s].
        lower: (AXES,) where the first cells begin [rad, m].
        sizes: (AXES,) sizes of cells: how far joints move from sample to sample at most [rad, m].
        counts: (AXES,) numbers of cells.
    """

    motions: JointMotions
    longest: float
    period: float
    lower: FloatArray
    sizes: FloatArray
    counts: IntArray

    @classmethod
    def of(cls, motions: JointMotions, longest: float, samples: int) -> TimedGrid:
        """The grid for motions no longer than some length.

        Args:
            motions: Of `AXES` joints at most, in the order of the axes.
            longest: Length of the longest motion [s].
            samples: Samples of it.
        """
        motions = motions.with_still_ones(AXES)
        period = longest / samples
        # Rounding never makes a cell too small to be left by one step alone.
        travel = motions.velocity * period * (1.0 + 1e-9)
        # Size of the cells of a joint that stands still [rad].
        sizes = np.where(travel > 0.0, travel, 1e-3)
        lower, upper = motions.ranges(longest, samples)
        counts = np.floor((upper - lower) / sizes).astype(np.int64) + 1
        return cls(motions, longest, period, lower, sizes, counts)

    @property
    def words(self) -> int:
        """Words of memory that the cells take."""
        return int(self.counts[1:].prod() * ((self.counts[0] + 63) // 64))

    def samples(self, total: float) -> Samples | None:
        """Bounds of motions of some length, of two samples or more; None where they leave nothing."""
        count = int(total / self.period + 1e-9)
        time = np.maximum(total - self.period * np.arange(count, -1, -1.0), 0.0)[:, None]
        lower, upper = self.motions.places(time, total)
        if (lower > upper).any():
            return None
        ends = [(end - self.lower) / self.sizes for end in (lower, upper)]
        first, last = np.floor(ends[0] - 1e-9).astype(np.int64), np.floor(ends[1] + 1e-9).astype(np.int64)
        return Samples(np.maximum(first, 0), np.minimum(last, self.counts - 1))


@dataclass(frozen=True, eq=False)
class GridSearch(Record):
    """The search for the largest length at which no motion of some joints exists.

    Attributes:
        free: Its cells that are not in contact whole.
    """

    grid: TimedGrid
    free: WordArray

    def is_possible(self, total: float) -> bool:
        """False if it is shown that no motion of a length exists."""
        if total < 2.0 * self.grid.period:
            return True
        samples = self.grid.samples(total)
        return samples is not None and is_reachable(self.free, samples)

    @classmethod
    def of(
        cls, obstacles: ClearanceField, excess: FloatArray, motions: JointMotions, joints: IntArray, grid: TimedGrid
    ) -> GridSearch:
        """The search over a grid.

        Bodies that the same joints move are looked at together, those of the fewest joints first: what is in contact
        then is so whatever the others do.

        Args:
            obstacles: Bodies and obstacles, without pairs of bodies.
            excess: (bodies,) by how much bodies are larger than what they stand for at most [m].
            motions: Those of all joints.
            joints: Numbers of the joints of the grid's axes.
        """
        free = np.full((*grid.counts[1:], (grid.counts[0] + 63) // 64), _ALL)
        samples = grid.samples(grid.longest)
        if samples is None:  # no motion is so long, and no cell matters
            return cls(grid, free)
        lower, upper = motions.ranges(grid.longest, len(samples.first) - 1)
        sizes = upper - lower
        lower[joints], sizes[joints] = grid.lower[: len(joints)], grid.sizes[: len(joints)]
        meets = obstacles.movers[:, MEETS] > 0.0
        moved = (obstacles.reaches > 0.0) & (motions.velocity > 0.0)
        for group in sorted({tuple(row) for row in moved[meets].tolist()}, key=lambda row: (sum(row), row)):
            chosen = meets & (moved == np.array(group)).all(axis=1)
            parts = _parts(obstacles.reaches[chosen].max(axis=0) * sizes, int(joints[0]))
            # Bodies that a part may move by more than their own radius are not looked at: they are hardly ever so deep.
            chosen &= 0.5 * obstacles.reaches @ (sizes / parts) < obstacles.movers[:, BALL_RADIUS]
            if not chosen.any():
                continue
            axes = np.full(AXES, -1, dtype=np.int64)
            axes[: len(joints)] = np.where(np.array(group)[joints], joints, -1)
            axes[0] = joints[0]  # those that it does not move are in contact along all of it
            numbers = obstacles.numbers.copy()
            numbers[BODIES] = chosen.sum()
            field = obstacles.arrays._replace(movers=obstacles.movers[chosen], numbers=numbers)
            points = (obstacles.movers[chosen][:, LAST] - obstacles.movers[chosen][:, FIRST]).max() / 3.0
            of_bodies = obstacles.reaches[chosen], excess[chosen], int(_LOOKS / (1.0 + points / 8.0))
            known = free[_along(axes)]
            if known.shape != free.shape:
                known = np.full_like(known, _ALL)
            take_occupied(known, field, Cells(axes, lower, sizes, parts, samples.first, samples.last, *of_bodies))
            free &= known
        return cls(grid, free)


def _along(axes: IntArray) -> tuple[slice, ...]:
    """Of an array of cells the first ones along axes without a joint."""
    return tuple(slice(None) if joint >= 0 else slice(0, 1) for joint in axes[1:])


def _parts(moved: FloatArray, first: int) -> IntArray:
    """(dof,) into how many parts cells are cut: in halves by the joint that moves bodies farthest within a part.

    Args:
        moved: (dof,) how far joints move bodies within a cell, or all of their range, at most [m].
        first: The joint of the first axis, along which clearances are followed.
    """
    parts = np.ones(len(moved), dtype=np.int64)
    moved[first] = 0.0
    while moved.any() and parts.prod() < _PARTS:
        parts[ties.argmax(moved / parts)] *= 2
    return parts
