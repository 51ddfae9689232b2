r"""Chance-constrained planning with iterative risk allocation (Ono and Williams 2008).

Each uncertain obstacle is grown by its own distance, a motion is planned, and an upper bound on the motion's contact
probability is computed (`hplan.certificate.touch_risk`). Distant obstacles contribute almost nothing to it, so the risk
is allocated to the nearby ones. An obstacle with contact probability :math:`p` is :math:`\Phi^{-1}(1 - p)` standard
deviations away if its surface is treated as a plane; its growth changes by the difference to the deviations that match
its share of the risk. Allocation and planning alternate, and the fastest motion within the risk is returned. The bound
is proved for the motion itself: the allocation only directs the search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import TypeAlias

from hplan.base.deadline import TimeIsUpError, time_limit
from hplan.certificate.certificate import GoalContact, certify
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.certificate.touch_risk import RiskShare, TouchRisk, touch_risk
from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    MovingObstacleError,
    NoPathError,
    NotFoundError,
    NotInTimeError,
    TimingError,
)
from hplan.planning.problem import MARGIN, Problem
from hplan.planning.result import PlanResult
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import largest_deviation

#: Fractions of the risk: for the first motion, for the later ones, and the minimum use by a motion that
#: ends the search.
_FIRST, _NEXT, _ENOUGH = 0.5, 0.75, 0.05

#: Maximum number of motions to plan.
_ROUNDS = 4

#: An obstacle is near if the motion comes within its growth plus this multiple of its standard deviation plus this
#: distance, one and a half times the margin of motions [m].
_NEAR, _NEAR_M = 0.25, 1.5 * MARGIN


@dataclass(frozen=True)
class _Allocation:
    """Growth of obstacles, in standard deviations of their relative position.

    Attributes:
        rest: Growth of all obstacles that are not in `near`.
        near: Growth of the others, by name.
    """

    rest: float
    near: Mapping[str, float]

    def growth_of(self, name: str) -> float:
        """Growth of one obstacle, in standard deviations."""
        return self.near.get(name, self.rest)


#: Solves a problem.
Solved: TypeAlias = Callable[[Problem], PlanResult]


def within_risk(solve: Solved) -> Solved:
    """A function that also solves problems whose options have a risk.

    Args:
        solve: Solves a problem without a risk.
    """

    def solve_allocated(problem: Problem) -> PlanResult:
        options, scene = problem.options, problem.scene
        if options.risk is None:
            return solve(problem)
        if scene.moves:
            raise MovingObstacleError(scene.first_moving, "a risk bound takes scenes without moving bodies")
        with time_limit(options.deadline_s) as limit:
            try:
                return _solved_at_risk(problem, options.risk, solve)
            except TimeIsUpError:
                raise limit.error(["the risk of motions"]) from None

    return solve_allocated


def _solved_at_risk(problem: Problem, risk: float, solve: Solved) -> PlanResult:
    """The fastest motion found with a contact probability of at most `risk`.

    Raises:
        HplanError: As in `hplan.planning.plan.plan`.
        CertificationError: Motions were found, but none has a probability bound within the risk.
    """
    scene, options = problem.scene, problem.options
    shared = scene.shared_error
    deviations = {name: largest_deviation(error + shared) for name, error in scene.errors.items()}
    best: tuple[PlanResult, TouchRisk] | None = None
    least = 1.0
    allocation = _Allocation(_normal_quantile(_FIRST * risk), {})
    room: dict[str, float] = {}
    # The rest of the time is for the bounds of the motions.
    deadline_s = None if options.deadline_s is None else 0.6 * options.deadline_s
    for _ in range(_ROUNDS):
        sigmas = _sigmas(allocation, deviations, scene.clearance, room)
        try:
            asked = replace(options, risk=None, sigmas=sigmas or 0.0, deadline_s=deadline_s)
            result = solve(Problem.from_scene(problem.robot, scene, asked))
            shown = _risk_of(result, scene, risk)
        except (NotInTimeError, TimeIsUpError):
            if best is None:
                raise
            break
        except ConfigurationInCollisionError:
            if best is not None:
                break
            if room:
                raise
            # Obstacles near start or goal cannot grow as much; the bound decides whether this suffices.
            room = _room_at_ends(problem)
            continue
        except (BlockedError, NoPathError, NotFoundError, CertificationError, TimingError):
            if best is not None:
                break
            if allocation.rest <= _normal_quantile(risk):
                raise
            # Smaller growths may admit a motion that is near to only one obstacle.
            allocation = _Allocation(_normal_quantile(risk), {})
            continue
        is_within = shown.bound <= risk
        least = min(least, shown.bound)
        if is_within and (best is None or result.trajectory.duration < best[0].trajectory.duration):
            best = result, shown
        near = _active_shares(shown, allocation, deviations, scene.clearance)
        if is_within and (shown.bound >= _ENOUGH * risk or not near):
            break
        allocation = _reallocate(allocation, shown, near, risk, deviations)
    if best is None:
        raise CertificationError(
            f"no motion was found whose contact probability is at most {risk:g}: the lowest bound that was "
            f"proved is {least:.3g}",
            risk=risk,
            bound=least,
        )
    return _among_what_was_seen(problem, *best)


def _risk_of(result: PlanResult, scene: Scene, risk: float) -> TouchRisk:
    """The contact probability of a motion certified among grown obstacles."""
    if result.certificate.subject is None:
        raise CertificationError("the motion's certificate has no digests")
    return touch_risk(result.certificate.subject, scene, risk)


def _normal_quantile(probability: float) -> float:
    """The standard normal quantile that is exceeded with a probability."""
    # Clamped to [1e-12, 0.45]: outside, the quantile is infinite, or not positive.
    return NormalDist().inv_cdf(1.0 - min(max(probability, 1e-12), 0.45))


def _room_at_ends(problem: Problem) -> dict[str, float]:
    """Maximum growth of each obstacle at start and goal, by name [m].

    The distance there less the required clearance and `_NEAR_M`, at least 0.
    """
    robot, scene = problem.robot, problem.scene
    checker = checker_in_time(robot, scene, 0.0)
    names = checker.obstacle_names[: checker.own_first]
    room: dict[str, float] = {}
    for end in (scene.start, scene.goal):
        joints = robot.joints_of(end, "start" if end is scene.start else "goal", scene.start)
        if joints is not None:
            distances = checker.distances(joints).min(axis=0).tolist()
            for name, distance in zip(names, distances, strict=False):
                left = distance - scene.clearance - _NEAR_M
                room[name] = max(0.0, min(room.get(name, left), left))
    return room


def _sigmas(
    allocation: _Allocation, deviations: Mapping[str, float], clearance: float, room: Mapping[str, float]
) -> dict[str, float]:
    """Growth of each obstacle as `PlanOptions.sigmas`, less the required clearance."""
    return {
        name: min(max(0.0, allocation.growth_of(name) - clearance / deviation), room.get(name, math.inf) / deviation)
        for name, deviation in deviations.items()
        if deviation > 0.0
    }


def _active_shares(
    shown: TouchRisk, allocation: _Allocation, deviations: Mapping[str, float], clearance: float
) -> tuple[RiskShare, ...]:
    """The obstacles that the motion approaches as closely as their growth allows."""
    return tuple(
        share
        for share in shown.shares
        if share.clearance_m
        <= max(clearance, allocation.growth_of(share.obstacle) * deviations[share.obstacle])
        + (_NEAR * deviations[share.obstacle] + _NEAR_M)
    )


def _reallocate(
    allocation: _Allocation,
    shown: TouchRisk,
    near: Sequence[RiskShare],
    risk: float,
    deviations: Mapping[str, float],
) -> _Allocation:
    """The next allocation, for a bound a little below the risk."""
    if shown.shared > 0.0 or not near:
        # With a shared error, scale all growths by the same factor.
        factor = _normal_quantile(_NEXT * risk) / _normal_quantile(shown.bound)
        return _Allocation(allocation.rest * factor, {name: z * factor for name, z in allocation.near.items()})
    others = shown.bound - sum(share.probability for share in near)
    each = max(_NEXT * risk - others, 0.1 * risk) / len(near)
    moved = {}
    for share in near:
        by = share.clearance_m * (_normal_quantile(each) / _normal_quantile(share.probability) - 1.0)
        moved[share.obstacle] = max(0.0, allocation.growth_of(share.obstacle) + by / deviations[share.obstacle])
    return _Allocation(_normal_quantile(each), {**allocation.near, **moved})


def _among_what_was_seen(problem: Problem, result: PlanResult, shown: TouchRisk) -> PlanResult:
    """The result with the certificate without growth, and the risk."""
    tracking = problem.options.certified_tracking
    contact: GoalContact = result.certificate.goal_contact or "approach"
    certificate = certify(
        problem.robot, problem.scene, result.trajectory,
        tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, sigmas=0.0, goal_contact=contact,
    )  # fmt: skip
    return replace(result, certificate=replace(certificate, risk=shown))
