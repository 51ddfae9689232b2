"""Clearance of the arm, and motions verified collision-free over continuous time.

The moving bodies are the arm's bodies, followed by its self-collision pairs and, if the tool has to stay upright, its
tilt, which counts as the distance of a pair (`hplan.collision.compiled_bodies`). A
motion is verified collision-free by bounds on the motion of the bodies (`hplan.collision.compiled_motions`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, TableArray, frozen
from hplan.base.deadline import check_deadline, kernel_time_limit
from hplan.collision.compiled_bodies import FlatBodies
from hplan.collision.compiled_clearance import body_slopes, clearances_along
from hplan.collision.compiled_motions import path_is_clear
from hplan.collision.compiled_obstacles import JOINT_RANGE, OBSTACLE, FieldArrays, rows_of
from hplan.collision.distance_checker import FAR
from hplan.errors import OptionError
from hplan.robot.model import Robot
from hplan.robot.upright import UprightTool
from hplan.scene.obstacles import Solid


@dataclass(frozen=True, eq=False)
class ClearanceField(Record):
    """Arm and obstacles as flat arrays for the kernels.

    Attributes:
        arm: Moving bodies and self-collision pairs.
        solids: (rows,) balls, capsules, boxes, hulls and nodes of clouds, grown by the required clearance; columns are
            those of `hplan.collision.compiled_obstacles.OBSTACLE`.
        data: Corners of hulls and points of clouds, one after the other; the rows hold the indices.
        owner: (rows,) index of the obstacle of each row; -1 for a node over several obstacles, `RANGE` for a joint
            range (`hplan.collision.compiled_obstacles`).
    """

    arm: FlatBodies
    solids: TableArray
    data: FloatArray
    owner: IntArray

    @property
    def arrays(self) -> FieldArrays:
        """The arrays and the deadline for the kernels."""
        arm = self.arm
        return FieldArrays(
            arm.bodies, arm.pairs, arm.joints, arm.reaches, arm.points, self.solids, self.data, kernel_time_limit()
        )

    @property
    def reaches(self) -> FloatArray:
        """(moving bodies, dof) motion-bound coefficients (`hplan.collision.motion_coefficients`)."""
        return self.arm.reaches

    @property
    def count(self) -> int:
        """Number of moving bodies, self-collision pairs included."""
        return len(self.arm.reaches)

    @classmethod
    def build(
        cls,
        robot: Robot,
        obstacles: Sequence[Solid],
        *,
        clearance: ArrayLike = 0.0,
        own_clearance: float | None = None,
        deviation: float = 0.0,
        joints: BoolArray | None = None,
        upright: UprightTool | None = None,
    ) -> ClearanceField:
        """Build the field of a robot among obstacles.

        Args:
            clearance: Growth of the obstacles [m], one number or one for each.
            own_clearance: Clearance required between the arm's own bodies [m]; None for the minimum of `clearance`.
            deviation: Joint error bound [rad]; each body is thickened by the displacement that this error can cause.
            joints: (obstacles, dof) mask of the joints whose bodies keep clear of each obstacle; None for all joints
                and obstacles.
            upright: The tool axis that stays upright; None if the tool may tilt.
        """
        growth = np.asarray(clearance, dtype=np.float64)
        own = float(growth.min()) if own_clearance is None and growth.size else own_clearance or 0.0
        solids, data, owner = rows_of(obstacles, growth, joints)
        return cls(FlatBodies.build(robot, own, deviation, upright), frozen(solids), frozen(data), frozen(owner))

    def select(self, kept: BoolArray, *, arm: bool = True) -> ClearanceField:
        """Return the field of a subset of the obstacles.

        Args:
            kept: (solids,) mask of the obstacles to keep.
            arm: False drops the arm's self-collision pairs.
        """
        remains = np.append(kept, [True, True])[self.owner]
        solids, place = self.solids[remains], np.concatenate([[0], np.cumsum(remains)])  # their new indices
        solids["next"] = place[solids["next"]]
        own = self.arm if arm else self.arm.with_pairs(np.zeros(len(self.arm.pairs), dtype=np.bool_))
        return replace(self, arm=own, solids=frozen(solids), owner=frozen(self.owner[remains]))

    def ignoring_last_link(self, touched: BoolArray) -> ClearanceField:
        """Return the field whose last joint's bodies may touch some obstacles.

        Args:
            touched: (solids,) mask of these obstacles.
        """
        before_last = len(self.arm.joints) - 2
        if before_last < 0:
            return self.select(~touched)
        rows = np.append(touched, [False, False])[self.owner]
        first = rows & (np.concatenate([[-2], self.owner[:-1]]) != self.owner)  # A joint range comes before it.
        before = np.concatenate([[0], np.cumsum(first)])
        moved = np.arange(len(rows)) + before[1:]
        solids = np.zeros(len(rows) + before[-1], OBSTACLE)
        solids[moved] = self.solids
        solids["next"][moved] = self.solids["next"] + before[self.solids["next"]]
        ends = np.append(np.flatnonzero(first), len(rows))[1:]
        for start, end in zip(np.flatnonzero(first).tolist(), ends.tolist(), strict=True):
            last = start + int(np.count_nonzero(self.owner[start:end] == self.owner[start]))
            joints = solids[start + before[start]]
            joints["centre"], joints["bound"] = self.solids[start]["centre"], self.solids[start]["bound"]
            joints["kind"], joints["first"], joints["last"] = JOINT_RANGE, 0, before_last
            joints["next"] = last + before[last]
        owner = np.insert(self.owner, np.flatnonzero(first), self.owner[first])
        return replace(self, solids=frozen(solids), owner=frozen(owner))

    def without_idle_pairs(self, path: FloatArray, movable: IntArray, distance: float, turn: float) -> ClearanceField:
        """Return the field without self-collision pairs that are irrelevant near a motion.

        Args:
            path: (m, dof) configurations.
            movable: (k,) joints that may move.
            distance: Pairs farther apart than this are irrelevant [m].
            turn: So are pairs that, by their gradients, do not touch while every joint moves by this [rad].
        """
        first, alone = len(self.arm.bodies), replace(self, solids=self.solids[:0], owner=self.owner[:0])
        idle = np.arange(self.count) >= first
        if not idle.any():
            return self
        clear, gradient, arrays = np.empty(len(idle)), np.empty((len(idle), len(movable))), alone.arrays
        for configuration in path:
            body_slopes(configuration, arrays, movable, distance, clear, gradient)
            idle &= (clear >= distance) | (clear > turn * np.abs(gradient).sum(axis=1))
        pairs = self.arm.pairs.copy()
        pairs["ball_distance"][idle[first:]] = -np.inf
        return replace(self, arm=replace(self.arm, pairs=frozen(pairs)))

    def link_clearances(self, q: ArrayLike, enough: float = FAR) -> FloatArray:
        """Clearance of each moving body at one configuration [m].

        Clamped and signed as by `clearance_along`.
        """
        found: FloatArray = self.clearance_along(np.asarray(q)[None], enough)[0]
        return found

    def clearance_along(self, configurations: ArrayLike, enough: float = FAR) -> FloatArray:
        """Clearance of each moving body at many configurations [m].

        Args:
            configurations: (n, dof).
            enough: Clearances are clamped to this value [m].

        Returns:
            (n, moving bodies) distances to the nearest obstacle [m]. Negative in contact: minus the minimum translation
            that separates a body from an obstacle.
        """
        points = np.array(configurations, dtype=np.float64, order="C")
        result = np.empty((len(points), self.count))
        clearances_along(points, self.arrays, enough, result)
        check_deadline()
        return result

    def spare_clearance(self, q: ArrayLike, enough: float = FAR) -> float:
        """Minimum clearance of all moving bodies at one configuration, clamped to `enough` [m]."""
        return float(self.spare_clearances(np.asarray(q)[None], enough)[0])

    def spare_clearances(self, configurations: ArrayLike, enough: float = FAR) -> FloatArray:
        """Minimum clearance of all moving bodies at each configuration, clamped to `enough`, (n,) [m].

        The obstacles and the arm's own bodies are grown by what is required, so all of it is spare.
        """
        found: FloatArray = self.clearance_along(configurations, enough).min(axis=1, initial=enough)
        return found

    def in_collision(self, configurations: ArrayLike, *, margin: float = 0.0) -> BoolArray:
        """(n,) mask of the configurations whose spare clearance is at most a margin [m]; (n, dof) configurations."""
        return self.spare_clearances(configurations, max(FAR, 2.0 * margin)) <= margin

    def is_clear(self, path: ArrayLike, margin: float) -> bool:
        """True if the straight motions between waypoints are verified collision-free.

        The motions are straight in joint space.

        Args:
            path: (m, dof) waypoints.
            margin: Clearance required at every query [m], positive. A step from clearance `d` may use up `d` before the
                next one finds at least `margin`, so half of it is certified everywhere.

        Raises:
            OptionError: `margin` is not positive.
        """
        if not margin > 0.0:
            raise OptionError("margin", margin, "a positive number of metres")
        points = np.array(path, dtype=np.float64, order="C")
        clear = bool(np.isfinite(points).all() and path_is_clear(points, self.arrays, margin))
        check_deadline()
        return clear
