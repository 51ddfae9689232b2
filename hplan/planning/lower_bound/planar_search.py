"""Which lengths of motion reachability on a grid of three joints excludes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, Record, WordArray
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.flat_bodies import BODIES
from hplan.planning.lower_bound.joint_tubes import SLACK, JointMotions
from hplan.planning.lower_bound.occupied_cells import Cells, free_cells
from hplan.planning.lower_bound.reachability import Samples, is_reachable
from hplan.robot.model import Robot


@dataclass(frozen=True)
class Resolution:
    """How finely motions are resolved.

    Attributes:
        samples: Samples of a motion of the largest length.
        move_cells: Cells of the first axis by which acceleration changes the move from one sample to the next.
        speed_cells: Cells of the other axes by which their joints move between samples at most.
    """

    samples: int
    move_cells: int = 1
    speed_cells: int = 2


@dataclass(frozen=True, eq=False)
class TimedGrid(Record):
    """A grid over three joints with the time between samples, for motions of up to some length.

    Attributes:
        motions: The three joints, in the order of the axes.
        period: Time between samples [s].
        lower: (3,) where the first cells begin [rad].
        sizes: (3,) sizes of cells [rad].
        counts: (3,) numbers of cells.
        steps: (3,) as in `Samples`.
        most_move: Largest move of the first axis [cells].
    """

    motions: JointMotions
    period: float
    lower: FloatArray
    sizes: FloatArray
    counts: IntArray
    steps: IntArray
    most_move: int

    @classmethod
    def of(cls, motions: JointMotions, longest: float, resolution: Resolution) -> TimedGrid:
        """The grid for motions no longer than some length."""
        period = longest / resolution.samples
        # Rounding never makes a cell too small for the steps below.
        change = motions.acceleration[0] * period**2 * (1.0 + 1e-9)
        travel = motions.velocity * period * (1.0 + 1e-9)
        # Size of the cells of a joint that stands still [rad].
        sizes = np.where(travel > 0.0, travel / resolution.speed_cells, 1e-3)
        sizes[0] = min(change / resolution.move_cells, sizes[0])
        places = motions.places(np.linspace(0.0, longest, resolution.samples + 1)[:, None], longest)
        # Between samples a joint is no farther than half of its travel from where it is at one of them.
        lower = np.maximum(motions.lower - SLACK, places[0].min(axis=0) - 0.5 * travel)
        upper = np.minimum(motions.upper + SLACK, places[1].max(axis=0) + 0.5 * travel)
        counts = np.floor((upper - lower) / sizes).astype(np.int64) + 1
        # The largest whole numbers below change / size + 2, and below travel / size + 1.
        largest = np.ceil(travel / sizes).astype(np.int64)
        steps = np.array([math.ceil(change / sizes[0]) + 1, largest[1], largest[2]], dtype=np.int64)
        return cls(motions, period, lower, sizes, counts, steps, int(largest[0]))

    @property
    def words(self) -> int:
        """Words of memory that the states take."""
        return int((2 * self.most_move + 1) * self.counts[1] * self.counts[2] * ((self.counts[0] + 63) // 64))

    def samples(self, total: float) -> Samples | None:
        """Bounds of motions of some length, of two samples or more; None where they leave nothing."""
        count = int(total / self.period + 1e-9)
        time = np.maximum(total - self.period * np.arange(count, -1, -1.0), 0.0)[:, None]
        lower, upper = self.motions.places(time, total)
        if (lower > upper).any():
            return None
        first, last = self._cells(lower, upper, slice(None))
        moves = np.arange(-self.most_move, self.most_move + 1)
        joint = self.motions.only([0])
        # The mean velocity until the next sample differs by a/2 times the period at most from that at this one.
        mean, off = moves * self.sizes[0] / self.period, self.sizes[0] / self.period
        off += 0.5 * joint.acceleration[0] * self.period
        lower, upper = joint.places(time, total, (mean - off, mean + off))
        first_of, last_of = self._cells(lower, upper, 0)
        first_of[:-1] = np.maximum(first_of[:-1], first[1:, :1] - moves)
        last_of[:-1] = np.minimum(last_of[:-1], last[1:, :1] - moves)
        return Samples(first, last, np.maximum(first_of, first[:, :1]), np.minimum(last_of, last[:, :1]), self.steps)

    def _cells(self, lower: FloatArray, upper: FloatArray, axes: slice | int) -> tuple[IntArray, IntArray]:
        """First and last cells of ranges along some axes; where a range is empty the last is before the first."""
        ends = [(np.where(lower > upper, np.nan, end) - self.lower[axes]) / self.sizes[axes] for end in (lower, upper)]
        first = np.nan_to_num(np.floor(ends[0] - 1e-9), nan=1.0).astype(np.int64)
        last = np.nan_to_num(np.floor(ends[1] + 1e-9), nan=0.0).astype(np.int64)
        return np.maximum(first, 0), np.minimum(last, self.counts[axes] - 1)


@dataclass(frozen=True, eq=False)
class PlanarSearch(Record):
    """The search for the largest length at which no motion of three joints exists.

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
        cls, robot: Robot, obstacles: ClearanceField, q: FloatArray, joints: IntArray, grid: TimedGrid
    ) -> PlanarSearch:
        """The search over a grid.

        Args:
            q: (dof,) the start.
            joints: (3,) numbers of the joints of the grid's axes in a configuration.
        """
        planar = joints - robot.yaw_joints
        # Parts of a cell along each axis but the first that are examined one by one.
        parts = np.array([1, *np.where(grid.counts[1:] > 1, 2, 1)])
        half = np.zeros(3)
        half[planar] = 0.5 * grid.sizes / parts
        lengths = robot.arm.lengths[:3]
        moved = np.where(np.arange(3) >= planar[0], lengths, 0.0)
        cells = Cells(
            joints, grid.lower, grid.sizes, grid.counts, parts, np.cumsum(lengths * np.cumsum(half)), np.cumsum(moved)
        )
        field, numbers = obstacles.arrays, obstacles.numbers.copy()
        numbers[BODIES] = 3  # the links alone
        return cls(grid, free_cells(q.copy(), field._replace(movers=field.movers[:3], numbers=numbers), cells))
