"""A start in motion among what moves, brought to rest first: the motion goes on from there, later or another way.

Where no motion on from a state of motion is certified in time, a stop may be; once the arm rests it can wait.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from hplan.base.arrays import Record
from hplan.errors import HplanError, NotInTimeError, PlanCancelledError, UnavoidableContactError
from hplan.moving.search import StillPlan, Stretch
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Scene, Start
from hplan.timing.trajectory import Trajectory, joined
from hplan.verification.certificate import Certificate, certify

_Plan = TypeVar("_Plan", bound=StillPlan)


@dataclass(frozen=True, eq=False)
class StoppedFirst(Record, Generic[_Plan]):
    """A certified motion that comes to rest, and goes on from there.

    Attributes:
        plan: The plan from where the arm rests, by a clock that begins there.
        trajectory: Stop and plan as one.
        certificate: What is shown of it.
        stop_s: When the arm rests [s].
    """

    plan: _Plan
    trajectory: Trajectory
    certificate: Certificate
    stop_s: float

    @property
    def phases(self) -> tuple[Stretch, ...]:
        """Its parts; the stop belongs to the first."""
        spans = [(phase.name, phase.start_s + self.stop_s, phase.end_s + self.stop_s) for phase in self.plan.phases]
        return tuple(Stretch(name, 0.0 if i == 0 else start, end) for i, (name, start, end) in enumerate(spans))


def stopped_first(
    robot: Robot,
    scene: Scene,
    options: PlanOptions,
    stops: Iterable[Trajectory],
    plan_at_rest: Callable[[Scene], _Plan],
) -> StoppedFirst[_Plan]:
    """The first stop that is certified in time and from whose end a plan goes on.

    Args:
        robot: The arm.
        scene: The scene; its start is in motion.
        options: How to plan.
        stops: Motions from the start to rest, in the order in which they are tried.
        plan_at_rest: Plans a scene whose start is at rest, and whose tracks count from then.

    Raises:
        UnavoidableContactError: No stop is certified; holds the one with the most clearance.
        HplanError: As `plan_at_rest` from the end of the first stop that is.
    """
    refused: HplanError | None = None
    tried: list[tuple[Trajectory, Certificate]] = []
    for stop in stops:
        certificate = _certified(robot, scene, options, stop, is_whole=False)
        tried.append((stop, certificate))
        if not certificate.verified:
            continue
        rest = Start(joints_rad=tuple(stop.position[-1].tolist()))
        try:
            plan = plan_at_rest(scene.since(stop.duration).model_copy(update={"start": rest}))
        except (NotInTimeError, PlanCancelledError):
            raise
        except HplanError as error:
            refused = refused or error.with_traceback(None)
            continue
        whole = joined([stop, plan.trajectory])
        certificate = _certified(robot, scene, options, whole, direct=len(plan.phases) == 1)
        if certificate.verified:
            return StoppedFirst(plan, whole, certificate, stop.duration)
    if refused is not None:
        raise refused
    raise unavoidable_contact(tried)


def unavoidable_contact(tried: Sequence[tuple[Trajectory, Certificate]]) -> UnavoidableContactError:
    """The error that names the best of some stops of which none is certified: the one with the most clearance."""
    stop, certificate = max(tried, key=lambda each: each[1].min_clearance_m)
    clearance = certificate.min_clearance_m
    return UnavoidableContactError(
        certificate.violations, len(tried), clearance if np.isfinite(clearance) else None, stop
    )


def _certified(
    robot: Robot, scene: Scene, options: PlanOptions, motion: Trajectory, *, is_whole: bool = True, direct: bool = False
) -> Certificate:
    """What is shown of a motion from the start of the scene, or of a stop, which need not get to the goal."""
    return certify(
        robot,
        scene,
        motion,
        tracking_error=options.tracking_error,
        tracking_delay_s=options.tracking_delay_s,
        sigmas=options.sigmas,
        goal_contact="motion" if is_whole and direct else "approach",
        check_ends=is_whole,
    )
