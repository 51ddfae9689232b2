r"""Plans of which it is shown how probable it is at most that they touch anything: risk allocated where it is of use.

A motion is planned among obstacles that have each grown by its own distance, and then it is bounded how probable it is
that it touches anything (`hplan.certificate.touch_risk`). What is far has hardly any part of that; so the risk is for
those that are near, and their growths are found from what they have of it: an obstacle that would be touched with
probability :math:`p` is :math:`\Phi^{-1}(1 - p)` standard deviations away, as by a plane, and grows by as many more or
fewer as make :math:`p` its part of the risk. Allocation and motion follow one another, as in iterative risk allocation
(Ono and Williams 2008); the quickest motion that keeps within the risk is taken. What is shown is shown of the motion:
the allocation only says where to look for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

from hplan.base.deadline import TimeIsUpError
from hplan.certificate.certificate import GoalContact, certify
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.certificate.touch_risk import Share, TouchRisk, touch_risk
from hplan.errors import (
    BlockedError,
    CertificationError,
    ConfigurationInCollisionError,
    NoPathError,
    NotFoundError,
    NotInTimeError,
    TimingError,
)
from hplan.planning.options import PlanOptions
from hplan.planning.problem import MARGIN
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import largest_deviation

#: Part of the risk that the first motion is to take, and those after it; one that takes as much as the third is kept.
_FIRST, _NEXT, _ENOUGH = 0.5, 0.75, 0.05

#: Motions that are planned at most.
_ROUNDS = 4

#: An obstacle is near where the motion comes within its growth, so many of its standard deviations and the margin that
#: motions keep, half as much again [m].
_NEAR, _NEAR_M = 0.25, 1.5 * MARGIN


@dataclass(frozen=True)
class _Allocation:
    """By how much obstacles grow, in standard deviations from where they were seen to the arm.

    Attributes:
        rest: Of those that are not named.
        near: Of the others, by name.
    """

    rest: float
    near: Mapping[str, float]

    def of(self, name: str) -> float:
        """That of an obstacle."""
        return self.near.get(name, self.rest)


def plan_at_risk(
    robot: Robot, scene: Scene, options: PlanOptions, risk: float, plan: Callable[[PlanOptions], PlanResult]
) -> PlanResult:
    """The quickest motion found that touches anything with a probability of at most `risk`.

    Args:
        plan: Plans the scene, given the growths as `PlanOptions.sigmas`.

    Raises:
        HplanError: As `hplan.planning.plan.plan`.
        CertificationError: Motions were found, and none that is shown to keep within the risk.
    """
    shared = scene.shared_error
    deviations = {name: largest_deviation(error + shared) for name, error in scene.errors.items()}
    best: tuple[PlanResult, TouchRisk] | None = None
    least = 1.0
    allocation = _Allocation(_away(_FIRST * risk), {})
    room: dict[str, float] = {}
    # What is shown of motions takes its part of the time.
    deadline_s = None if options.deadline_s is None else 0.6 * options.deadline_s
    for _ in range(_ROUNDS):
        sigmas = _sigmas(allocation, deviations, scene.clearance, room)
        try:
            result = plan(replace(options, risk=None, sigmas=sigmas or 0.0, deadline_s=deadline_s))
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
            # What start or goal is near to cannot grow as far; the bound tells whether that is near enough.
            room = _room_at_ends(robot, scene)
            continue
        except (BlockedError, NoPathError, NotFoundError, CertificationError, TimingError):
            if best is not None:
                break
            if allocation.rest <= _away(risk):
                raise
            # There may be a motion past those that have grown less, where only one of them is near.
            allocation = _Allocation(_away(risk), {})
            continue
        is_within = shown.bound <= risk
        least = min(least, shown.bound)
        if is_within and (best is None or result.trajectory.duration < best[0].trajectory.duration):
            best = result, shown
        near = _near(shown, allocation, deviations, scene.clearance)
        if is_within and (shown.bound >= _ENOUGH * risk or not near):
            break
        allocation = _reallocated(allocation, shown, near, risk, deviations)
    if best is None:
        raise CertificationError(
            f"no motion was found that touches something with a probability of at most {risk:g}: the least that was "
            f"shown is {least:.3g}",
            risk=risk,
            bound=least,
        )
    return _among_what_was_seen(robot, scene, options, *best)


def _risk_of(result: PlanResult, scene: Scene, risk: float) -> TouchRisk:
    """What is shown of a motion that is certified among obstacles that have grown."""
    if result.certificate.subject is None:
        raise CertificationError("the motion's certificate does not say what it is about")
    return touch_risk(result.certificate.subject, scene, risk)


def _away(probability: float) -> float:
    """How many standard deviations away a plane is beyond which a place is with a probability."""
    # Probabilities as numbers of standard deviations.
    return NormalDist().inv_cdf(1.0 - min(max(probability, 1e-12), 0.45))


def _room_at_ends(robot: Robot, scene: Scene) -> dict[str, float]:
    """By how much obstacles may grow where start, or goal, is near to them, less the margin of motions [m]."""
    checker = checker_in_time(robot, scene, 0.0)
    names = checker.obstacle_names[: checker.own_first]
    room: dict[str, float] = {}
    for end in (scene.start, scene.goal):
        joints = robot.joints_of(end, "start" if end is scene.start else "goal")
        if joints is not None:
            distances = checker.distances(joints).min(axis=0).tolist()
            for name, distance in zip(names, distances, strict=False):
                left = distance - scene.clearance - _NEAR_M
                room[name] = max(0.0, min(room.get(name, left), left))
    return room


def _sigmas(
    allocation: _Allocation, deviations: Mapping[str, float], clearance: float, room: Mapping[str, float]
) -> dict[str, float]:
    """How many standard deviations each is to grow by; what the clearance keeps anyway comes off."""
    return {
        name: min(max(0.0, allocation.of(name) - clearance / deviation), room.get(name, math.inf) / deviation)
        for name, deviation in deviations.items()
        if deviation > 0.0
    }


def _near(
    shown: TouchRisk, allocation: _Allocation, deviations: Mapping[str, float], clearance: float
) -> tuple[Share, ...]:
    """Those to which the motion comes as near as it may."""
    return tuple(
        share
        for share in shown.shares
        if share.clearance_m
        <= max(clearance, allocation.of(share.obstacle) * deviations[share.obstacle])
        + (_NEAR * deviations[share.obstacle] + _NEAR_M)
    )


def _reallocated(
    allocation: _Allocation,
    shown: TouchRisk,
    near: Sequence[Share],
    risk: float,
    deviations: Mapping[str, float],
) -> _Allocation:
    """An allocation with which the bound should be a little less than the risk."""
    if shown.shared > 0.0 or not near:
        # All together, by as much as the bound is off.
        factor = _away(_NEXT * risk) / _away(shown.bound)
        return _Allocation(allocation.rest * factor, {name: z * factor for name, z in allocation.near.items()})
    others = shown.bound - sum(share.probability for share in near)
    each = max(_NEXT * risk - others, 0.1 * risk) / len(near)
    moved = {}
    for share in near:
        by = share.clearance_m * (_away(each) / _away(share.probability) - 1.0)
        moved[share.obstacle] = max(0.0, allocation.of(share.obstacle) + by / deviations[share.obstacle])
    return _Allocation(_away(each), {**allocation.near, **moved})


def _among_what_was_seen(
    robot: Robot, scene: Scene, options: PlanOptions, result: PlanResult, shown: TouchRisk
) -> PlanResult:
    """The result with the certificate that its motion has among obstacles that have not grown, and its risk."""
    tracking = options.certified_tracking
    contact: GoalContact = result.certificate.goal_contact or "approach"
    certificate = certify(
        robot, scene, result.trajectory, tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s,
        sigmas=0.0, goal_contact=contact,
    )  # fmt: skip
    return replace(result, certificate=replace(certificate, risk=shown))
