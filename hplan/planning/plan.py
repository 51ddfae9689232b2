"""The pipeline: from a robot and a scene to a certified trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.base.arguments import function, instance
from hplan.base.arrays import FloatArray, Record
from hplan.base.deadline import Cancel, TimeIsUpError, TimeLimit, check_deadline, time_limit
from hplan.certificate.certificate import REST, Certificate, GoalContact, all_of, certify, goal_contacts
from hplan.certificate.digests import Digests
from hplan.certificate.retimed_certificate import CertifiedMotion, certified_retiming
from hplan.certificate.start_state import start_state
from hplan.errors import CertificationError, HplanError, NoPathError, ObstacleInTimeError, OptionError, TimingError
from hplan.grid import SearchResult
from hplan.grid.grid import Occupancy
from hplan.planning.certified_motion import Part, PlannedMotion, motion_limits
from hplan.planning.definition import Problem
from hplan.planning.grasps import Grasp
from hplan.planning.moving.search import certified_in_time, quickest_in_time
from hplan.planning.options import PlanOptions
from hplan.planning.report import StageClock, bound_report, deadline_report, motion_report, plan_report
from hplan.planning.start_in_motion import Stop, after_stop, stops
from hplan.planning.task import LastWorld, PlanningCache, PlanningContext, Progress, no_progress
from hplan.planning.whole_motion import Beginning, all_parts, parts_in_time
from hplan.robot.model import Robot
from hplan.robot.tracking import largest_fraction, name_margin
from hplan.scene.model import Scene, Start
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.time_scaling import Profile
from hplan.trajectory.trajectory import Phase, Retimed, Trajectory, joined, scaled, stopped

if TYPE_CHECKING:
    from hplan.planning.lower_bound.duration_bound import DurationBound

#: With a deadline this part of the time that the world took to make is kept: freeing it afterwards takes time too.
FREED = 0.25


@dataclass(frozen=True, eq=False)
class PlanResult(Record):
    """A plan.

    Attributes:
        problem: Start and goal of the transit, and the joints that may move.
        occupancy: The C-space that was searched; None where nothing was searched.
        search: The search; None where nothing was searched.
        grid_path: (m, dof) waypoints of the transit's grid path.
        path: The transit's smooth path; None for an empty motion.
        trajectory: The timed motion, all phases.
        certificate: What was shown of it.
        grasp: Where the tool takes the fruit, or reaches the point; None where the goal is given by joints.
        phases: The parts of the trajectory.
        motion: The transit, with all that it was made from.
        report: The numbers of `report.json`.
        bound: A lower bound of the durations of all transits between the same configurations, or of all motions to the
            grasp where transit and approach are one; None where it was not asked for, or nothing was certified.
        begins_s: When the trajectory begins, on the controller's clock (`hplan.Planner`); NaN where that was not told
            [s]. All else counts from there: rows, phases, and the tracks of `scene`.
    """

    problem: Problem
    occupancy: Occupancy | None
    search: SearchResult | None
    grid_path: FloatArray
    path: SplinePath | None
    trajectory: Trajectory
    certificate: Certificate
    grasp: Grasp | None
    phases: tuple[Phase, ...]
    motion: PlannedMotion
    report: dict[str, Any]
    bound: DurationBound | None = None
    begins_s: float = 0.0

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.motion.task.robot

    @property
    def scene(self) -> Scene:
        """Obstacles and task, as they were given."""
        return self.motion.task.scene

    @property
    def picked(self) -> dict[str, float]:
        """The fruit that is picked, if any, and when the tool is at it [s]."""
        fruit = self.scene.goal.fruit
        reached = [phase.end_s for phase in self.phases if phase.name != "retreat"]
        return {} if fruit is None else {fruit: reached[-1]}

    def stop_at(self, t: float) -> CertifiedMotion:
        """The trajectory up to the first row at or after a time, and from there on the quickest stop on its path.

        Args:
            t: The time since the trajectory begins [s].

        Raises:
            OptionError: A time before the trajectory or after it.
        """
        return self._retimed(stopped(self.trajectory, t, self.robot))

    def scaled(self, profile: Profile) -> CertifiedMotion:
        """The trajectory at other speeds, on its path.

        Args:
            profile: Fraction of its own speed over time (`hplan.trajectory.trajectory.scaled`).

        Raises:
            OptionError: Factors that are none, beyond what limits allow, or with which the motion does not end.
            TimingError: No motion within the limits was found.
        """
        return self._retimed(scaled(self.trajectory, profile, self.robot))

    def _retimed(self, retimed: Retimed) -> CertifiedMotion:
        task = self.motion.task
        tracking, sigmas = task.options.certified_tracking, task.options.sigmas
        found = certified_retiming(task.robot, task.scene, self.certificate, retimed, tracking=tracking, sigmas=sigmas)
        return replace(found, begins_s=self.begins_s)


def plan(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> PlanResult:
    """Plan a motion from the scene's start to its goal.

    To a fruit, or to a point, the motion is a transit to a stand-off and a straight approach, without a stop between
    them where that is quicker; from a fruit the arm then retreats to the stand-off.

    The robot keeps the last obstacles made ready, some megabytes for hundreds of them: what is planned next among the
    same ones begins sooner.

    Args:
        robot: The arm.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.
        cancel: A function or an event that says whether nobody wants the plan any more; another thread asks it about
            every millisecond.

    Raises:
        InputError: The scene does not fit the robot, or start or goal cannot be taken (see `check_problem`).
        UnreachableError: No configuration has the tool at the point, or none at the pose was found.
        BlockedError: Obstacles are in the way of all that do; names them.
        NoPathError: No path exists on the grid; names what blocks it.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
        NotFoundError: None was found within memory and effort, and it was not shown that there is none.
        NotInTimeError: None was found before the deadline.
        PlanCancelledError: Nobody wants the plan any more.
        UnavoidableContactError: The start is in motion, and no motion onward or stop without contact was found.
        BoundError: The bound, where it is asked for, contradicts the motion.
    """
    check_task(robot, scene, options, progress)
    options = PlanOptions() if options is None else options
    with time_limit(options.deadline_s, cancel):
        return plan_with(PlanningCache(robot, LastWorld.of(robot)), scene, options, progress=progress)


def check_task(robot: Robot, scene: Scene, options: PlanOptions | None, progress: Progress = no_progress) -> None:
    """Refuse what is no robot, scene, options or function, such as the first two in the wrong order.

    Raises:
        OptionError: It is none, or an option that the robot has no use for.
    """
    instance("robot", robot, Robot, "load_robot")
    instance("scene", scene, Scene, "load_scene")
    function("progress", progress)
    if options is not None:
        instance("options", options, PlanOptions).check_for(robot)


def plan_with(
    cache: PlanningCache,
    scene: Scene,
    options: PlanOptions,
    *,
    progress: Progress = no_progress,
    before: PlannedMotion | None = None,
    stop: Trajectory | None = None,
) -> PlanResult:
    """As `plan`, with what earlier plans of the same robot have left.

    The deadline counts from the beginning of the limit of time that this is called in, or else from this call.

    Args:
        cache: What they have left.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.
        before: An earlier motion, to be kept or repaired where that can be (`hplan.planning.find_motion.reuse_motion`).
        stop: How a start in motion might be brought to rest, in addition to what is tried anyway.

    Raises:
        HplanError: As `plan`.
    """
    clock = StageClock()
    try:
        with time_limit(options.deadline_s) as limit:
            try:
                if scene.moves:
                    return _among_moving(cache, scene, options, progress, stop)
                return _planned(cache.context(scene, options, progress, clock), before, stop, limit)
            except TimeIsUpError:
                raise limit.error(["motions past what moves"] if scene.moves else clock.told()) from None
    except (NoPathError, TimingError, CertificationError) as error:
        if not options.tracking.is_exact and options.deadline_s is None:
            fraction = _fraction_with_room(cache, scene, options)
            name_margin(
                error, options.tracking, cache.robot.slides, fraction, "the motion found without one has room for"
            )
        raise


def _among_moving(
    cache: PlanningCache, scene: Scene, options: PlanOptions, progress: Progress, stop: Trajectory | None
) -> PlanResult:
    """The plan where obstacles move: one as if they did not, in a timing that keeps clear of them.

    A start in motion is brought to rest first where there is none.
    """
    robot = cache.robot
    try:
        found = quickest_in_time(
            robot, scene, options, lambda still: plan_with(cache, still, options, progress=progress, stop=stop)
        )
    except ObstacleInTimeError:
        state = start_state(robot, scene)
        if state is None:
            raise
        return after_stop(
            stops(robot, state, 1.0 / options.rate_hz, stop),
            lambda motion: certified_in_time(robot, scene, options, motion, check_ends=False),
            lambda stopped: _onward(cache, (scene, options), progress, stopped),
        )
    return _in_time(found.still, (scene, options), found.trajectory, found.certificate, found.phases, found.report)


def _onward(
    cache: PlanningCache, asked: tuple[Scene, PlanOptions], progress: Progress, stopped: Stop
) -> PlanResult | None:
    """The plan from the end of a stop among what moves, with the stop; None where it is not verified as a whole."""
    (scene, options), stop_s = asked, stopped.trajectory.duration
    rest = Start(joints_rad=tuple(stopped.trajectory.position[-1].tolist()))
    later = scene.since(stop_s).model_copy(update={"start": rest})
    found = plan_with(cache, later, options, progress=progress)
    first, *others = (phase.later(stop_s) for phase in found.phases)
    phases = (replace(first, start_s=0.0), *others)
    whole = joined([stopped.trajectory, found.trajectory])
    certificate = certified_in_time(cache.robot, scene, options, whole, direct=len(phases) == 1)
    if not certificate.verified:
        return None
    return _in_time(found, asked, whole, certificate, phases, {"stops_until_s": stop_s})


def _in_time(
    plan: PlanResult, asked: tuple[Scene, PlanOptions], trajectory: Trajectory, certificate: Certificate,
    phases: tuple[Phase, ...], report: dict[str, Any],
) -> PlanResult:  # fmt: skip
    """A plan whose motion is run, or begins, as one found among what moves; `report` is what is said of that."""
    scene, options = asked
    in_time = plan.report.get("in_time", {}) | report | {"clear_until_s": certificate.clear_until_s}
    return replace(
        plan,
        trajectory=trajectory,
        certificate=certificate,
        phases=phases,
        motion=replace(plan.motion, task=replace(plan.motion.task, scene=scene)),
        report=plan.report
        | {"scene": scene.name, "phases": [vars(phase) for phase in phases], "in_time": in_time}
        | motion_report(trajectory, certificate, options, scene),
    )


def _fraction_with_room(cache: PlanningCache, scene: Scene, options: PlanOptions) -> float:
    """Fraction of the tracking error for which a motion planned without one can be certified; 0 if there is none."""
    try:
        found = plan_with(cache, scene, replace(options, tracking_error=0.0, tracking_delay_s=0.0))
    except HplanError:
        return 0.0

    def is_certified(fraction: float) -> bool:
        tracking = options.tracking.scaled(fraction)
        return certify(
            cache.robot, scene, found.trajectory, sigmas=options.sigmas,
            tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s,
            goal_contact="approach" if len(found.phases) > 1 else "motion",
        ).verified  # fmt: skip

    return largest_fraction(is_certified)


def _planned(
    context: PlanningContext, before: PlannedMotion | None, stop: Trajectory | None, limit: TimeLimit
) -> PlanResult:
    """The plan that the options ask for; with a deadline the best of those found before it."""
    robot, scene = context.robot, context.scene
    start = robot.check_configuration(robot.joints_of(scene.start, "start"), "start")
    check_deadline()
    context.world.check_base(robot.yaw_of(start))
    check_deadline()
    begin = Beginning(start, start_state(robot, scene), before, stop)
    if begin.state is not None and context.options.bound:
        raise OptionError("bound", True, "False where the start is in motion")
    if context.options.deadline_s is None:
        return plan_result(context, *all_parts(context, begin))
    best: PlanResult | None = None
    count, first_s, cut_short = 0, 0.0, False
    freeing_s = FREED * limit.elapsed_s
    limit.keep(freeing_s)
    try:
        for parts in parts_in_time(context, begin):
            since_s = limit.elapsed_s
            best = plan_result(context, *parts)
            count, first_s = count + 1, first_s or limit.elapsed_s
            limit.keep(freeing_s + limit.elapsed_s - since_s)  # for the report of the next one
    except TimeIsUpError:
        limit.check_cancelled()
        cut_short = True
    if best is None:
        raise TimeIsUpError
    return replace(best, report=best.report | deadline_report(limit, count, first_s, cut_short=cut_short))


def in_sequence(parts: Sequence[Part], begin_s: float = 0.0) -> tuple[tuple[Phase, ...], Trajectory, Certificate]:
    """The phases, the trajectory and the certificate of motions one after the other, from a time on."""
    ends = np.cumsum([begin_s, *(part.trajectory.duration for part in parts)]).tolist()
    phases = tuple(Phase(part.name, *span) for part, span in zip(parts, pairwise(ends), strict=True))
    return phases, joined([part.trajectory for part in parts]), all_of([part.certificate for part in parts])


def plan_result(
    context: PlanningContext, grasp: Grasp | None, motion: PlannedMotion, parts: Sequence[Part]
) -> PlanResult:
    """The plan that consists of a motion and, after it, approach and retreat."""
    phases, trajectory, certificate = in_sequence(parts)
    scene, route = context.scene, motion.route
    fruit = scene.goal_fruit
    if fruit is not None:
        # Without an approach the last link may touch the fruit all the time.
        goal_contact: GoalContact = "motion" if len(phases) == 1 else "approach"
        contacts = goal_contacts(context.robot, trajectory, fruit, goal_contact)
        certificate = replace(certificate, goal_contact=goal_contact, contacts=contacts)
    certificate = replace(certificate, digests=Digests.of(context.robot, scene, trajectory))
    bounded = _bounded(parts)
    bound = _bound(context, grasp, motion, bounded) if context.options.bound else None
    return PlanResult(
        problem=motion.task.problem,
        occupancy=None if route is None else route.occupancy,
        search=None if route is None else route.search,
        grid_path=motion.waypoints,
        path=motion.path,
        trajectory=trajectory,
        certificate=certificate,
        grasp=grasp,
        phases=phases,
        motion=motion,
        report=plan_report(context, grasp, motion, phases)
        | (bound_report(bound, [part.name for part in bounded]) if context.options.bound else {})
        | motion_report(trajectory, certificate, context.options, context.scene),
        bound=bound,
    )


def _bounded(parts: Sequence[Part]) -> Sequence[Part]:
    """The first parts of a plan that end at rest: the transit, and the approach where one flows into the other."""
    at_rest = np.abs(parts[0].trajectory.velocity[-1]).max() <= REST
    return parts[: 1 if at_rest else 2]


def _bound(
    context: PlanningContext, grasp: Grasp | None, motion: PlannedMotion, parts: Sequence[Part]
) -> DurationBound | None:
    """The bound of the durations of some first parts of a plan; None where they are not certified.

    Raises:
        BoundError: It contradicts them.
    """
    from hplan.planning.lower_bound.duration_bound import (
        duration_bound,  # its kernels cost nothing where none is asked for
    )

    if not all(part.certificate.verified for part in parts):
        return None
    world, problem = motion.task.world, motion.task.problem
    if len(parts) > 1 and grasp is not None:
        # Any motion to the grasp, the last link free to touch the fruit all the time: more than there are.
        fruit = context.scene.goal.fruit
        world, problem = context.world, replace(problem, goal=grasp.goal)
        world = world if fruit is None else world.touching(fruit)
    with context.stage("bound"):
        return duration_bound(world, problem, motion_limits(context), sum(part.trajectory.duration for part in parts))


def with_export_time(result: PlanResult, seconds: float) -> PlanResult:
    """The result with the time of the export added to its report."""
    times = dict(result.report["time_ms"])
    times["export"] = round(1e3 * seconds, 4)
    times["total"] = round(times["total"] + times["export"], 4)
    return replace(result, report={**result.report, "time_ms": times})
