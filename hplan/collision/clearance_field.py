"""Clearance of the arm in space, and motions verified collision-free over continuous time.

Distances are exact for capsule links against balls, capsules, boxes, hulls and clouds of balls. A motion is verified
collision-free by a bound on how far each link moves (`hplan.collision.clearance_kernels`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen, readonly
from hplan.base.deadline import check_deadline, until
from hplan.collision.clearance_kernels import (
    LINK,
    FieldArrays,
    clearances_along,
    link_clearances,
    mark_near,
    path_is_clear,
)
from hplan.collision.flat_bodies import BODIES, DOF, FlatBodies
from hplan.collision.obstacle_rows import (
    FIRST_LINK,
    KIND,
    LAST_LINK,
    LINK_RANGE,
    NEXT,
    RANGE,
    TURNS,
    BodyFieldArrays,
    core_rows,
    own_clearance_of,
    rows_of,
)
from hplan.errors import OptionError
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid

#: Largest turn of a joint between two samples of a motion, for what is near it.
_NEAR_STEP = 0.05


def _of_owners(solids: BoolArray, owner: IntArray, *, arm: bool) -> BoolArray:
    """(rows,) what is so of each row's owner: of solids, of the arm; of what is everybody's always."""
    rows: BoolArray = np.concatenate([solids, [True, arm]])[owner]
    return rows


@dataclass(frozen=True, eq=False)
class ClearanceField(Record):
    """Arm and obstacles as flat arrays, ready for the kernels.

    Attributes:
        chain: (links, 6) rows: length, half-width with the link's sway [m], sign, zero offset, distance from the arm
            plane and largest distance from the yaw axis [m]; of an arm that is not of the planar family the `movers` of
            `hplan.collision.flat_bodies`, and in `base` its `numbers`.
        base: (12,) shoulder position, from the foot of the yaw axis, the plane's horizontal and upward axes, all at
            yaw 0; 1 where joint 0 is a yaw; where its axis stands.
        solids: (rows, 21) balls, capsules, boxes, hulls and nodes of clouds, grown by the clearance to keep; columns as
            in `hplan.collision.obstacle_rows`.
        data: Facets and edges of hulls, and points of clouds, one after the other; rows say where.
        owner: (rows,) index of the solid behind each row; `ARM` or `RANGE` (`hplan.collision.obstacle_rows`).
    """

    chain: FloatArray
    base: FloatArray
    solids: FloatArray
    data: FloatArray
    owner: IntArray

    @property
    def arrays(self) -> FieldArrays:
        """The arrays for kernels, and how long these may take."""
        planar = FieldArrays(self.chain, self.base, self.solids, self.data, until())
        if self.chain.shape[1] == LINK:
            return planar
        return cast(FieldArrays, BodyFieldArrays(*planar, int(self.base[BODIES])))

    @classmethod
    def of(
        cls,
        robot: Robot,
        obstacles: Sequence[Solid],
        *,
        clearance: ArrayLike = 0.0,
        own_clearance: float | None = None,
        deviation: float = 0.0,
        links: BoolArray | None = None,
    ) -> ClearanceField:
        """The field of a robot among obstacles.

        Args:
            clearance: By how much each of them is grown [m], one number or one for each.
            own_clearance: Clearance that parts of the arm are to keep from one another [m]; None for the smallest of
                the others.
            deviation: By how much every joint may be off [rad]; each link is as much thicker as it may then sway.
            links: (obstacles, links) which links keep clear of each; of a robot that is no planar arm (obstacles, dof),
                what which joints carry. None for all of all.
        """
        if robot.planar is None:
            flat = FlatBodies.of(robot, own_clearance_of(clearance, own_clearance), deviation)
            solids, data, owner = core_rows(obstacles, clearance, links)
            return cls(flat.movers, flat.numbers, readonly(solids), readonly(data), readonly(owner, np.int64))
        arm = robot.arm
        widths = arm.half_widths + robot.sway(deviation)
        shoulder = robot.plane_origin - np.append(robot.yaw_axis, 0.0)
        base = [*shoulder, *robot.plane_axes[0], *robot.plane_axes[1], float(robot.has_yaw), *robot.yaw_axis]
        chain = [arm.lengths, widths, arm.signs, arm.offsets, arm.lateral, robot.yaw_radius]
        solids, data, owner = rows_of(robot, obstacles, clearance, own_clearance, deviation, links)
        return cls(
            chain=readonly(np.column_stack(chain)),
            base=readonly(base),
            solids=readonly(solids),
            data=readonly(data),
            owner=readonly(owner, np.int64),
        )

    def only(self, kept: BoolArray, *, arm: bool = True) -> ClearanceField:
        """The field of some of the solids, and of the arm itself.

        Args:
            kept: (solids,) which of them.
            arm: False leaves the arm itself out.
        """
        found = self._of_rows(_of_owners(kept, self.owner, arm=arm))
        if arm or self.chain.shape[1] == LINK:
            return found
        # Of general (non-planar) arms their own pairs count as moving bodies, after the bodies.
        return replace(found, chain=readonly(self.chain[: int(self.base[BODIES])]))

    def sparing(self, touched: BoolArray) -> ClearanceField:
        """The field where the last link may touch some of the solids.

        Args:
            touched: (solids,) which of them.
        """
        # The link, or of other arms than planar ones the joint, before the last.
        last_link = (len(self.chain) if self.chain.shape[1] == LINK else int(self.base[DOF])) - 2
        if last_link < 0:
            return self.only(~touched)
        rows = _of_owners(touched, self.owner, arm=False) & (self.owner != RANGE)
        first = rows & (np.concatenate([[-2], self.owner[:-1]]) != self.owner)  # a link range comes before it
        before = np.concatenate([[0], np.cumsum(first)])
        solids = np.insert(self.solids, np.flatnonzero(first), 0.0, axis=0)
        moved = np.arange(len(rows)) + before[1:]
        solids[moved, NEXT] = self.solids[:, NEXT] + before[self.solids[:, NEXT].astype(np.int64)]
        ends = np.append(np.flatnonzero(first), len(rows))[1:]
        for start, end in zip(np.flatnonzero(first).tolist(), ends.tolist(), strict=True):
            last = start + int(np.count_nonzero(self.owner[start:end] == self.owner[start]))
            links = solids[start + before[start]]
            links[:] = self.solids[start]
            links[KIND], links[FIRST_LINK], links[LAST_LINK], links[TURNS] = LINK_RANGE, 0, last_link, 0.0
            links[NEXT] = last + before[last]
        owner = np.insert(self.owner, np.flatnonzero(first), self.owner[first])
        return replace(self, solids=frozen(solids), owner=frozen(owner))

    def near(self, path: ArrayLike, distance: float) -> ClearanceField:
        """The field of what is near a motion: for optimisers, whose result is proved with the whole field.

        Args:
            path: (m, dof) waypoints; between them the motion is sampled every `_NEAR_STEP`.
            distance: Distance from the links up to which solids, by their bounding balls, are kept [m].
        """
        points = np.asarray(path, dtype=np.float64)
        parts = [points[:1]]
        for first, last in itertools.pairwise(points):
            count = max(1, math.ceil(float(np.abs(last - first).max()) / _NEAR_STEP))
            parts.append(first + np.linspace(0.0, 1.0, count + 1)[1:, None] * (last - first))
        kept = np.zeros(len(self.solids), dtype=np.bool_)
        mark_near(np.concatenate(parts), self.arrays, distance, kept)
        check_deadline()
        return self._of_rows(kept)

    def _of_rows(self, kept: BoolArray) -> ClearanceField:
        """The field of some rows; where a node is left out, so is all below it."""
        rows = np.flatnonzero(kept)
        place = np.searchsorted(rows, np.arange(len(self.solids) + 1))  # new numbers of the rows kept
        solids = self.solids[rows]
        solids[:, NEXT] = place[solids[:, NEXT].astype(np.int64)]
        return replace(self, solids=frozen(solids), owner=frozen(self.owner[rows]))

    def link_clearances(self, q: ArrayLike) -> FloatArray:
        """Clearance of each link at one configuration.

        Args:
            q: (dof,) configuration.

        Returns:
            (links,) distances to the nearest obstacle [m], inf without obstacles. Negative in contact; the depth is
            exact for balls and for capsules whose axis is not crossed, a lower bound of the depth otherwise.
        """
        check_deadline()
        result = np.empty(len(self.chain))
        link_clearances(np.array(q, dtype=np.float64), self.arrays, result)
        return result

    def along(self, configurations: ArrayLike) -> FloatArray:
        """Clearances of the links at many configurations, (n, dof) -> (n, links) [m]; as `link_clearances`."""
        points = np.array(configurations, dtype=np.float64, order="C")
        result = np.empty((len(points), len(self.chain)))
        clearances_along(points, self.arrays, result)
        check_deadline()
        return result

    def of_last_end(self, place: ArrayLike, axes: FloatArray) -> float:
        """Clearance that a planar arm's last link cannot exceed wherever its end is at a place [m].

        It is that of the end alone, as if all links had no length.

        Args:
            place: (3,) in `base_link` [m].
            axes: (3, 3) the arm plane's horizontal and upward axis and its normal there.
        """
        links = self.chain.copy()
        links[:, 0] = 0.0
        base = np.concatenate([np.asarray(place, dtype=np.float64), axes[0], axes[1], np.zeros(3)])
        solids = self.only(np.ones(int(self.owner.max(initial=-1)) + 1, dtype=np.bool_), arm=False)
        end = replace(solids, chain=frozen(links), base=frozen(base))
        return float(end.link_clearances(np.zeros(len(links)))[-1])

    def clearance(self, q: ArrayLike) -> float:
        """Least clearance of any link at one configuration [m]."""
        return float(self.link_clearances(q).min())

    def is_clear(self, path: ArrayLike, margin: float) -> bool:
        """True if the straight joint-space motions between waypoints are verified collision-free.

        Args:
            path: (m, dof) waypoints.
            margin: Clearance asked for wherever it is evaluated [m], positive. A step from clearance `d` may use up
                `d` before the next one finds at least `margin`, so half of it is shown to be kept everywhere.

        Raises:
            OptionError: A margin that is not positive.
        """
        if not margin > 0.0:
            raise OptionError("margin", margin, "a positive number of metres")
        points = np.array(path, dtype=np.float64, order="C")
        clear = bool(np.isfinite(points).all() and path_is_clear(points, self.arrays, margin))
        check_deadline()
        return clear
