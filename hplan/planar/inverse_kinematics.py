r"""Inverse kinematics of planar arms: all configurations for a tool position.

If none exists, the error gives the reason. The yaw that brings a point into the arm plane is computed first. Let the
plane have the distance d from the yaw axis and the point the distance :math:`\rho`. Then the point lies
:math:`\pm\sqrt{\rho^2 - d^2}` from the axis along the plane: there are two yaws, one with the point ahead of the axis,
one with the point behind it. A point with :math:`\rho < d` is in the plane at no yaw; if the plane contains the axis, a
point on the axis is in the plane at every yaw.

The in-plane problem is solved by the chain of `hplan.planar.chain`. With three joints, its free parameter is
the *approach angle*: the absolute angle of the last link in the arm plane, 0 along the plane's horizontal axis,
90 degrees straight up. Joints beyond three take values from a grid, starting with those nearest to the base.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arrays import BoolArray, ComplexArray, FloatArray, IntArray, Record, frozen, numbers
from hplan.base.elementary import arctan2, modulus, product
from hplan.errors import OptionError, UnreachableError
from hplan.kinematics.approach_angles import Window
from hplan.planar.chain import ANGLE_TOLERANCE, MATCH_TOLERANCE, FreeChain, Reached
from hplan.planar.family_reader import family_of
from hplan.planar.planar_family import PlanarFamily
from hplan.robot.model import Robot

#: Default number of samples between the ends of continua.
_COUNT = 32

#: Number of yaws tried for a point on the yaw axis without a start configuration.
AXIS_YAWS = 5

#: Violations of a joint limit below this are not reported [rad].
ROUNDING = 1e-8

#: For a joint with a range of several turns, values farther than this from its start are omitted [rad].
_FARTHEST_FROM_START = 2.0 * math.tau


@dataclass(frozen=True, eq=False)
class Candidates(Record):
    """Configurations that put the tool at a point, or at one of several.

    Attributes:
        configurations: (k, dof), k >= 1, within the limits.
        approach: (k,) angle of the last link in the arm plane, in (-pi, pi].
    """

    configurations: FloatArray
    approach: FloatArray


def reach(
    robot: Robot,
    position: ArrayLike,
    *,
    approach_deg: float | tuple[float, float] | None = None,
    count: int = _COUNT,
    start: ArrayLike | None = None,
    locked: Sequence[str] = (),
) -> Candidates:
    """Return all configurations with the tool frame at a position, or at one of several.

    A continuum of configurations is represented by its exact ends and about `count` samples, spread evenly over the
    approach angles in between; every continuum is represented by at least its ends. For a joint with a range of a whole
    turn or more, all of its equivalent values within two turns of the start (by default, of the middle of its range)
    are returned. The tool is within 1e-9 m of the position, or within 1e-6 m if the locked joints leave no free joint
    or no free yaw.

    Args:
        position: (3,), or (p, 3) for several, in `base_link` [m].
        approach_deg: Approach angle, or an interval (low, high) [deg]; None for all.
        count: Total number of samples of the continua, for each position.
        start: (dof,) start configuration: gives the values of locked joints, and the yaw for a point on the yaw axis.
        locked: Names of joints that keep their start values.

    Raises:
        InputError: A position is not three finite numbers, a joint is unknown, or the start is no configuration.
        OptionError: The approach is no angle or interval, the count is below 1, or joints are locked without a start.
        UnreachableError: No configuration reaches a position; `reason` and `data` say why for the first one.
    """
    if count < 1:
        raise OptionError("count", count, "a number of configurations >= 1")
    task = _ReachTask.build(robot, position, Window.from_degrees(approach_deg), start, locked)
    configurations, direction = task.solve(count)
    if not len(configurations):
        raise _reason(replace(task, positions=task.positions[:1]))
    return Candidates(frozen(configurations), frozen(np.pi - (np.pi - direction) % math.tau))


@dataclass(frozen=True, eq=False)
class _Views:
    """The positions in the arm planes that contain them.

    Attributes:
        yaw: (v,) yaws; zeros for a robot without a yaw joint.
        point: (v,) a position in the plane, relative to the shoulder, as horizontal + i upward [m].
        distance: (v,) minimum distance of the position from the plane, over all yaws unless the yaw is locked [m].
    """

    yaw: FloatArray
    point: ComplexArray
    distance: FloatArray


@dataclass(frozen=True, eq=False)
class _ReachTask:
    """Positions to reach, with some joints locked.

    Attributes:
        positions: (p, 3) [m].
        window: Window of approach angles; None for all.
        start: (dof,) start configuration; None without one.
        held: (dof,) mask of the locked joints.
    """

    robot: Robot
    positions: FloatArray
    window: Window | None
    start: FloatArray | None
    held: BoolArray

    @classmethod
    def build(
        cls, robot: Robot, position: ArrayLike, window: Window | None, start: ArrayLike | None, locked: Sequence[str]
    ) -> _ReachTask:
        """Validate the arguments and return the task."""
        target = numbers("position", position, (3,) if np.ndim(position) < 2 else (..., 3)).reshape(-1, 3)
        held = robot.locked_mask(locked)
        if locked and start is None:
            raise OptionError("start", None, "the configuration whose values the locked joints keep")
        if start is None:
            return cls(robot, target, window, None, held)
        robot = robot.about(start)
        return cls(robot, target, window, robot.check_configuration(start, "start"), held)

    @cached_property
    def family(self) -> PlanarFamily:
        """The arm's planar chain."""
        return family_of(self.robot)

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Indices of the planar joints that are not locked."""
        return tuple(np.flatnonzero(~self.held[self.family.arm_slice]).tolist())

    @property
    def grid_joints(self) -> tuple[int, ...]:
        """Free joints beyond three, which take values from a grid."""
        return self.free[:-3]

    @property
    def rest(self) -> FloatArray:
        """(dof,) start configuration; the lower joint limits without one."""
        return self.robot.lower if self.start is None else self.start

    @cached_property
    def views(self) -> _Views:
        """Arm planes that contain the positions, at yaws beyond the limits too."""
        found = [self._views_of(position) for position in self.positions]
        yaw, point, distance = zip(*((one.yaw, one.point, one.distance) for one in found), strict=True)
        return _Views(np.concatenate(yaw), np.concatenate(point), np.concatenate(distance))

    def _views_of(self, position: FloatArray) -> _Views:
        """Arm planes that contain a (3,) position."""
        robot, family = self.robot, self.family
        if not family.has_yaw or self.held[0]:
            yaw = family.yaw_of(self.rest)
            origin, axes = family.plane_at(yaw)
            place = axes @ (position - origin)
            return _Views(np.array([yaw]), place[:1] + 1j * place[1:2], np.abs(place[2:]))
        (fx, fy), height = family.plane_axes[0, :2], position[2] - family.plane_origin[2]
        ahead, across = family.shoulder_from_axis
        x, y = position[:2] - family.yaw_axis
        distance = float(np.hypot(x, y))
        yaws: FloatArray
        # A point this close to the yaw axis counts as on the axis [m].
        on_axis = 1e-9
        if distance <= on_axis >= abs(across):
            yaws = np.linspace(robot.lower[0], robot.upper[0], AXIS_YAWS) if self.start is None else self.start[:1]
            out: FloatArray = np.zeros(len(yaws))
        else:
            out = np.sqrt(max(distance**2 - across**2, 0.0)) * np.array([1.0, -1.0])
            yaws = math.atan2(y, x) - math.atan2(fy, fx) - arctan2(0.0 - across, out)
        turns = np.floor((yaws - robot.lower[0] + ANGLE_TOLERANCE) / math.tau)
        beside = np.full(len(yaws), max(0.0, abs(across) - distance))
        return _Views(yaws - math.tau * turns, (out - ahead) + 1j * height, beside)

    @property
    def yaw_excess(self) -> FloatArray:
        """(v,) violation of the yaw range by each view [rad]."""
        if not self.family.has_yaw:
            return np.zeros(1)
        yaw, lower, upper = self.views.yaw, self.robot.lower[0], self.robot.upper[0]
        excess: FloatArray = np.maximum(np.minimum(yaw - upper, lower + math.tau - yaw), 0.0)
        return excess

    @cached_property
    def chain(self) -> FreeChain:
        """The chain from the first non-grid free joint on."""
        return FreeChain.build(self.family.arm, self.free[len(self.grid_joints) :], self.rest[self.family.arm_slice])

    def relative_position(self, base: FloatArray, views: IntArray) -> tuple[ComplexArray, FloatArray]:
        """Return the positions relative to the chain, for base joints and views.

        `base` has (b, n) values of the joints before the chain, `views` (v,) indices.

        Returns:
            (b * v,) points and (b * v,) turns for `FreeChain.reach`.
        """
        arm = self.family.arm
        first = self.chain.free[0] if self.chain.free else arm.link_count
        if first == 0:
            return self.views.point[views], np.zeros(len(views))
        angles = np.cumsum(arm.signs * base + arm.offsets, axis=1)[:, :first]
        root = (arm.lengths[:first] * np.exp(1j * angles)).sum(axis=1)
        turns = angles[:, -1]
        points = product(self.views.point[views] - root[:, None], np.exp(-1j * turns[:, None]))
        return points.ravel(), np.repeat(turns, len(views))

    def solve(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return (k, dof) configurations, and (k,) angles of the last link.

        Continua have about `count` samples between their ends, for each position.
        """
        views = np.flatnonzero((self.yaw_excess <= ANGLE_TOLERANCE) & (self.views.distance <= MATCH_TOLERANCE))
        if len(views):
            for base in self.grids():
                samples = count * len(self.positions)
                found = self.chain.reach(*self.relative_position(base, views), self.window, samples)
                if len(found.point):
                    return self._assemble(found, base, views)
        return np.empty((0, self.robot.dof)), np.empty(0)

    def grids(self) -> list[FloatArray]:
        """(b, n) joint values before the chain, on successively finer grids.

        Locked joints keep their values.
        """
        rest, gridded, arm = self.rest[self.family.arm_slice], list(self.grid_joints), self.family.arm
        if not gridded:
            return [rest[None]]
        grids: list[FloatArray] = []
        # Numbers of grid values per joint beyond three, tried in turn, and maximum number of combinations.
        grid_values, most_combinations = (5, 9, 17, 33), 1500
        for values in grid_values:
            if values ** len(gridded) <= most_combinations or not grids:
                axes = [np.linspace(arm.lower[j], arm.upper[j], values) for j in gridded]
                combinations = np.array(list(itertools.product(*axes)))
                base = np.tile(rest, (len(combinations), 1))
                base[:, gridded] = combinations
                grids.append(base)
        return grids

    def _assemble(self, found: Reached, base: FloatArray, views: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return sorted, distinct full configurations, and their angles of the last link."""
        robot, shift = self.robot, self.robot.dof - self.family.arm.link_count
        q = np.empty((len(found.point), robot.dof))
        q[:, shift:] = base[found.point // len(views)]
        q[:, [shift + joint for joint in self.chain.free]] = found.joints
        if self.family.has_yaw:
            yaw = np.minimum(self.views.yaw[views], robot.upper[0])
            q[:, 0] = np.maximum(yaw, robot.lower[0])[found.point % len(views)]
        direction = found.direction
        more = ~self.held & (q <= robot.upper - math.tau + ANGLE_TOLERANCE).any(axis=0)
        for joint in np.flatnonzero(more):
            q, direction = self._with_whole_turns(q, direction, int(joint))
        order = np.lexsort(np.round(q, 7).T[::-1])
        q, direction = q[order], direction[order]
        other = np.ones(len(q), dtype=bool)
        other[1:] = (np.abs(np.diff(q, axis=0)) > 1e-7).any(axis=1)
        return q[other], direction[other]

    def _with_whole_turns(self, q: FloatArray, direction: FloatArray, joint: int) -> tuple[FloatArray, FloatArray]:
        """Repeat solutions for every whole turn within `_FARTHEST_FROM_START` of the start."""
        lower, upper = self.robot.lower[joint], self.robot.upper[joint]
        near = 0.5 * (lower + upper) if self.start is None else self.start[joint]
        first = max(0, math.floor((near - _FARTHEST_FROM_START - lower) / math.tau))
        turns = np.arange(
            first, math.ceil((min(upper, near + _FARTHEST_FROM_START) - lower + ANGLE_TOLERANCE) / math.tau)
        )
        turned = np.repeat(q, len(turns), axis=0)
        turned[:, joint] += math.tau * np.tile(turns, len(q))
        kept = (turned[:, joint] <= upper + ANGLE_TOLERANCE) & (np.abs(turned[:, joint] - near) <= _FARTHEST_FROM_START)
        turned[:, joint] = np.minimum(turned[:, joint], upper)
        return turned[kept], np.repeat(direction, len(turns))[kept]

    def drop_constraints(self, *, window: bool = False, locks: bool = False) -> _ReachTask:
        """Return the task without its approach window, or without its locked joints."""
        held = np.zeros_like(self.held) if locks else self.held
        return replace(self, window=None if window else self.window, held=held)

    def is_possible(self) -> bool:
        """True if a configuration exists."""
        return bool(len(self.solve(1)[0]))


def _reason(task: _ReachTask) -> UnreachableError:
    """Return the unreachability error: options are blamed first, then the arm."""
    wider = task.drop_constraints(window=True)
    if task.window is not None and wider.is_possible():
        return _approach_reason(wider, task.window)
    if task.held.any():
        for freer in (task.drop_constraints(locks=True), task.drop_constraints(locks=True, window=True)):
            if freer.is_possible():
                return _locked_reason(task)
    return _arm_reason(task.drop_constraints(locks=True, window=True))


def _approach_reason(task: _ReachTask, window: Window) -> UnreachableError:
    """Return the error for a position reachable only with other approach angles."""
    views = np.flatnonzero(task.yaw_excess <= ANGLE_TOLERANCE)
    spans: list[tuple[float, float]] = []
    for base in task.grids():
        spans = task.chain.feasible_directions(*task.relative_position(base, views))
        if spans:
            break
    reachable = np.degrees(spans).tolist()
    asked = np.degrees([window.low, window.low + window.width]).tolist()
    text = ", ".join(f"{low:.4g} to {high:.4g}" if high > low else f"{low:.4g}" for low, high in reachable)
    return _unreachable(
        task,
        "approach",
        f"not with an approach angle of {window.describe()}, only of {text} deg",
        approach_deg=asked,
        reachable_deg=reachable,
    )


def _locked_reason(task: _ReachTask) -> UnreachableError:
    """Return the error for a position excluded by the locked joints."""
    names = [task.robot.joint_names[joint] for joint in np.flatnonzero(task.held)]
    distance = float(task.views.distance.min())
    detail = "" if distance <= MATCH_TOLERANCE else f": the arm plane passes it at {distance:.6g} m"
    return _unreachable(
        task, "locked", f"not with {', '.join(names)} locked{detail}", locked_joints=names, beside_m=distance
    )


def _arm_reason(task: _ReachTask) -> UnreachableError:
    """Return the error for a position that this arm cannot reach."""
    lengths, points = task.family.arm.lengths, task.views.point
    distance = float(task.views.distance.min())
    if distance > MATCH_TOLERANCE:
        across = f"{abs(task.family.shoulder_from_axis[1]):.6g} m"
        where = f"closer to the yaw axis than the arm plane, whose distance from the axis is {across}"
        detail = f"it is {distance:.6g} m {where if task.family.has_yaw else 'from the arm plane'}"
        return _unreachable(task, "off_plane", detail, beside_m=distance)
    farthest = float(lengths.sum())
    nearest = max(0.0, 2.0 * float(lengths.max()) - farthest)
    beyond = float(modulus(points).min()) - farthest
    short = nearest - float(modulus(points).max())
    if beyond > 0.0:
        return _unreachable(
            task, "too_far", f"it is {beyond:.6g} m beyond the maximum distance of {farthest:.6g} m", excess_m=beyond
        )
    if short > 0.0:
        return _unreachable(
            task,
            "too_near",
            f"it is {short:.6g} m closer than the minimum distance of the folded arm, {nearest:.6g} m",
            excess_m=short,
        )
    if task.grid_joints:  # the grid search is inconclusive
        names = [task.family.arm.joint_names[joint] for joint in task.grid_joints]
        detail = f"no configuration with {', '.join(names)} at grid values"
        return _unreachable(task, "not_found", detail, joints=names)
    return _limit_reason(task)


def _limit_reason(task: _ReachTask) -> UnreachableError:
    """Return the error that names the violated joint limits.

    The solution with the minimum total violation determines them.
    """
    robot, shift = task.robot, task.robot.dof - task.family.arm.link_count
    views = np.arange(len(task.views.yaw))
    points, _ = task.relative_position(task.grids()[0], views)
    index, q, excess = task.chain.violations(points)
    joints = [shift + joint for joint in task.chain.free]
    if task.family.has_yaw:
        yaw = task.views.yaw
        out = yaw - np.where(yaw - robot.upper[0] > robot.lower[0] + math.tau - yaw, math.tau, 0.0)
        view = index % len(views)
        joints, q = [0, *joints], np.column_stack([out[view], q])
        excess = np.column_stack([task.yaw_excess[view], excess])
    best = ties.argmin(excess.sum(axis=1))
    passed: list[dict[str, Any]] = []
    text: list[str] = []
    for which in ties.argsort(-excess[best]):
        joint, beyond = joints[which], float(np.degrees(excess[best, which]))
        if passed and excess[best, which] < ROUNDING:
            break
        name = robot.joint_names[joint]
        below = q[best, which] < robot.lower[joint]
        limit = float(np.degrees(robot.lower[joint] if below else robot.upper[joint]))
        passed.append({"joint": name, "limit_deg": limit, "excess_deg": beyond})
        text.append(f"joint {name!r} would have to exceed its limit of {limit:.6g} deg by {beyond:.4g} deg")
    return _unreachable(task, "joint_limit", " and ".join(text), **passed[0], passed=passed)


def _unreachable(task: _ReachTask, reason: str, detail: str, **data: Any) -> UnreachableError:
    return UnreachableError(task.positions[0].tolist(), reason, detail, **data)
