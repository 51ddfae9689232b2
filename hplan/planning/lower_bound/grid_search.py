"""Infeasible durations by reachability on a grid of up to three joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, Record, WordArray, frozen
from hplan.collision.compiled_field import ClearanceField
from hplan.planning.lower_bound.cells import AXES, ClearCells, Samples, is_reachable, take_occupied
from hplan.planning.lower_bound.joint_tubes import JointMotions

#: Number of parts of a cell, and the bits of 64 free cells.
_PARTS, _ALL = 16, np.uint64(2**64 - 1)

#: Approximate maximum number of configurations to query per group of bodies that the same joints move; fewer with
#: hulls.
_CHECKED_FRACTIONS = 4e6


@dataclass(frozen=True, eq=False)
class TimedGrid(Record):
    """A grid over joints and time, for motions up to a duration.

    Attributes:
        motions: The joints, in the order of the axes; a missing axis has a joint at rest.
        longest: Maximum duration of the motions [s].
        period: Time between samples [s].
        lower: (AXES,) lower edges of the first cells [rad, m].
        sizes: (AXES,) sizes of the cells: the maximum travel of the joints between samples [rad, m].
        counts: (AXES,) numbers of cells.
    """

    motions: JointMotions
    longest: float
    period: float
    lower: FloatArray
    sizes: FloatArray
    counts: IntArray

    @classmethod
    def build(cls, motions: JointMotions, longest: float, samples: int) -> TimedGrid:
        """The grid for motions up to a duration.

        Args:
            motions: Motions of at most `AXES` joints, in the order of the axes.
            longest: Maximum duration of the motions [s].
            samples: Number of samples of the longest motion.
        """
        motions = motions.with_still_ones(AXES)
        period = longest / samples
        # Rounding must never make a cell so small that one step crosses more than its neighbour.
        travel = motions.velocity * period * (1.0 + 1e-9)
        # Size of the cells of a joint at rest [rad].
        sizes = np.where(travel > 0.0, travel, 1e-3)
        lower, upper = motions.ranges(longest, samples)
        counts = np.floor((upper - lower) / sizes).astype(np.int64) + 1
        return cls(motions, longest, period, lower, sizes, counts)

    @property
    def words(self) -> int:
        """Memory of the cells, in words of 8 bytes."""
        return int(self.counts[1:].prod() * ((self.counts[0] + 63) // 64))

    def samples(self, total: float) -> Samples | None:
        """Bounds of motions of a duration at their samples; None if contradictory.

        Args:
            total: Duration, two samples or more [s].
        """
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
    """The search for the longest infeasible duration.

    Attributes:
        grid: The grid.
        free: Bits of the cells that are not entirely in contact.
    """

    grid: TimedGrid
    free: WordArray

    def is_possible(self, total: float) -> bool:
        """False if it is proved that no motion of a duration exists."""
        if total < 2.0 * self.grid.period:
            return True
        samples = self.grid.samples(total)
        return samples is not None and is_reachable(self.free, samples)

    @classmethod
    def build(
        cls, obstacles: ClearanceField, excess: FloatArray, motions: JointMotions, joints: IntArray, grid: TimedGrid
    ) -> GridSearch:
        """The search over a grid.

        Bodies that the same joints move are checked together, in order of increasing number of joints: cells in contact
        then are in contact for all values of the other joints.

        Args:
            obstacles: Bodies and obstacles, without pairs of bodies.
            excess: (bodies,) maximum excess of bodies over the shapes that they represent [m].
            motions: Motions of all joints.
            joints: Numbers of the joints of the grid's axes.
            grid: The grid.
        """
        free = np.full((*grid.counts[1:], (grid.counts[0] + 63) // 64), _ALL)
        samples = grid.samples(grid.longest)
        if samples is None:  # no motion has this duration, and no cell matters
            return cls(grid, free)
        lower, upper = motions.ranges(grid.longest, len(samples.first) - 1)
        sizes = upper - lower
        lower[joints], sizes[joints] = grid.lower[: len(joints)], grid.sizes[: len(joints)]
        bodies = obstacles.arm.bodies
        moved = (obstacles.reaches > 0.0) & (motions.velocity > 0.0)
        is_checked = bodies["is_checked"]
        for group in sorted({tuple(row) for row in moved[is_checked].tolist()}, key=lambda row: (sum(row), row)):
            chosen = is_checked & (moved == np.array(group)).all(axis=1)
            parts = _cell_divisions(obstacles.reaches[chosen].max(axis=0) * sizes, int(joints[0]))
            # Skip bodies that a part may move by more than their own radius: they are hardly ever in contact so deeply.
            chosen &= 0.5 * obstacles.reaches @ (sizes / parts) < bodies["ball_radius"]
            if not chosen.any():
                continue
            axes = np.full(AXES, -1, dtype=np.int64)
            axes[: len(joints)] = np.where(np.array(group)[joints], joints, -1)
            axes[0] = joints[0]  # bodies that it does not move are in contact along all of it
            reaches = frozen(obstacles.reaches[chosen])
            field = obstacles.arrays._replace(bodies=frozen(bodies[chosen]), reaches=reaches)
            points = (bodies["last"] - bodies["first"])[chosen].max() / 3.0
            of_bodies = reaches, excess[chosen], int(_CHECKED_FRACTIONS / (1.0 + points / 8.0))
            known = free[_first_cells(axes)]
            if known.shape != free.shape:
                known = np.full_like(known, _ALL)
            take_occupied(known, field, ClearCells(axes, lower, sizes, parts, samples.first, samples.last, *of_bodies))
            free &= known
        return cls(grid, free)


def _first_cells(axes: IntArray) -> tuple[slice, ...]:
    """Index of the first cells along axes without a joint."""
    return tuple(slice(None) if joint >= 0 else slice(0, 1) for joint in axes[1:])


def _cell_divisions(moved: FloatArray, first: int) -> IntArray:
    """(dof,) numbers of parts into which cells are divided.

    Parts are halved along the joint that moves bodies farthest within a part.

    Args:
        moved: (dof,) maximum travel of bodies by each joint within a cell, or within its whole range [m].
        first: The joint of the first axis, along which clearances are extrapolated.
    """
    parts = np.ones(len(moved), dtype=np.int64)
    moved[first] = 0.0
    while moved.any() and parts.prod() < _PARTS:
        parts[ties.argmax(moved / parts)] *= 2
    return parts
