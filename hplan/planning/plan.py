"""The pipeline: from a robot and a scene to a certified trajectory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

from hplan.base.arguments import function, instance
from hplan.base.deadline import Cancel, TimeIsUpError, TimeLimit, time_limit
from hplan.base.log import LOG
from hplan.certificate.certificate import GoalContact, certify, goal_contacts
from hplan.certificate.digests import Digests
from hplan.collision.compliant_solids import check_yield_links
from hplan.collision.far_obstacles import warn_of_far_obstacles
from hplan.collision.held_objects import holding
from hplan.errors import CertificationError, HplanError, NoPathError, TimingError
from hplan.planning.at_risk import within_risk
from hplan.planning.in_time import past_moving_obstacles
from hplan.planning.less_force import with_less_force
from hplan.planning.motion import Motion, Plan, Solver, best_of, motion_limits, require_certificate, seconds
from hplan.planning.options import PlanOptions
from hplan.planning.plans import plans_from_rest, with_reuse
from hplan.planning.pose_goal import FEW_STARTS, STARTS
from hplan.planning.problem import Problem
from hplan.planning.report import deadline_report
from hplan.planning.result import PlanResult, bounded_phases
from hplan.planning.specialist import check_method
from hplan.planning.stages import Progress, current_clock, no_progress, stage, stage_clock
from hplan.planning.start_in_motion import StopMaker, from_motion
from hplan.robot.model import Robot
from hplan.robot.tracking import largest_fraction, name_margin
from hplan.scene.model import Scene, checked_scene

if TYPE_CHECKING:
    from hplan.planning.lower_bound.duration_bound import DurationBound


def plan(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> PlanResult:
    """Plan a motion from the scene's start to its goal.

    To a fruit or a point the motion is a transit to a stand-off and a straight approach, blended if that is faster;
    from a fruit the arm then retreats to the stand-off.

    The robot caches the last prepared obstacles, some megabytes for hundreds of them, so that the next plan among the
    same obstacles starts sooner.

    Args:
        robot: The arm.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.
        cancel: A function or an event that reports cancellation; another thread queries it about every millisecond.

    Raises:
        InputError: The scene does not fit the robot, or start or goal is invalid (see `hplan.check`).
        UnreachableError: No configuration reaches the point, or none at the pose was found.
        BlockedError: Obstacles block all configurations that reach the goal; names them.
        NoPathError: No path exists on the grid; names the blocking obstacles.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
        NotFoundError: No motion was found within memory and effort; this does not prove that none exists.
        NotInTimeError: No motion was found before the deadline.
        PlanCancelledError: Planning was cancelled.
        UnavoidableContactError: The start is in motion, and neither a motion onward nor a stop without contact was
            found.
        BoundError: The requested bound contradicts the motion.
        MovingObstacleError: The options have a risk, and the scene has moving obstacles.

    Examples:
        >>> from hplan import PlanOptions, load_robot, load_scene, plan
        >>> result = plan(load_robot(), load_scene(), PlanOptions(effort="quick"))
        >>> result.certificate.verified
        True
    """
    return _plan(robot, scene, options, STARTS, progress, cancel)


def plan_if_free(robot: Robot, scene: Scene, options: PlanOptions) -> PlanResult:
    """Plan as `plan`, but refuse a pose early if it is blocked: the caller has other means.

    A longer search may find a configuration that is free, but is reached by no motion.
    """
    return _plan(robot, scene, options, FEW_STARTS)


def _plan(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None,
    pose_starts: tuple[int, ...],
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> PlanResult:
    """Validate and solve a scene."""
    check_task(robot, scene, options, progress, takes_risk=True)
    options = PlanOptions() if options is None else options
    with time_limit(options.deadline_s, cancel):
        problem = replace(Problem.from_scene(robot, scene, options), pose_starts=pose_starts)
        return within_risk(partial(solve_scene, progress=progress))(problem)


def check_task(
    robot: Robot,
    scene: Scene,
    options: PlanOptions | None,
    progress: Progress = no_progress,
    *,
    takes_risk: bool = False,
) -> None:
    """Validate argument types; catches a swapped robot and scene.

    Raises:
        OptionError: An argument has the wrong type, the robot cannot use an option, or `yield_links` names an unknown
            link.
        SceneError: A value of the scene was changed without validation.
    """
    instance("robot", robot, Robot, "load_robot")
    robot = holding(robot, checked_scene(scene).attached)
    check_yield_links(robot, scene.yield_links)
    function("progress", progress)
    if options is not None:
        check_method(robot, instance("options", options, PlanOptions))
        if not takes_risk:
            options.refuse_risk()
    warn_of_far_obstacles(robot, scene)


def solve_scene(
    problem: Problem,
    *,
    progress: Progress = no_progress,
    before: Motion | None = None,
    stop: StopMaker | None = None,
    at_once: bool | None = None,
) -> PlanResult:
    """Solve the problem of a scene.

    With an earlier motion to reuse and a stop to try.

    The deadline counts from the start of the enclosing time limit or, without one, from this call.

    Args:
        progress: Called with the name of each stage as it begins.
        before: An earlier motion, kept or repaired if possible (`hplan.planning.solver.reuse_motion`).
        stop: Returns a motion to rest from a start in motion, tried before the default ones.
        at_once: True for the first motion found; None for the option of this name.

    Raises:
        HplanError: As in `plan`.
    """
    options = problem.options
    try:
        with stage_clock(progress) as clock, time_limit(options.deadline_s) as limit:
            try:
                found = solver(before, stop)(problem)
                if options.at_once if at_once is None else at_once:
                    found = islice(found, 1)
                result = plan_result(best_of(found)) if options.deadline_s is None else _last_in_time(found, limit)
            except TimeIsUpError:
                raise limit.error(clock.describe()) from None
            require_certificate(problem, result.certificate)
            LOG.info(
                "plan for scene %r: %.3f s, clearance %.2f mm, %s, planned in %.0f ms",
                problem.scene.name, result.trajectory.duration, 1e3 * result.certificate.min_clearance_m,
                "verified" if result.certificate.verified else "not verified", result.time_ms["total"],
            )  # fmt: skip
            return result
    except (NoPathError, TimingError, CertificationError) as error:
        if not options.tracking.is_exact and options.deadline_s is None:
            fraction = _fraction_with_room(problem)
            name_margin(error, options.tracking, problem.robot.slides, fraction, "the motion found without one allows")
        raise


def solver(before: Motion | None = None, stop: StopMaker | None = None) -> Solver:
    """The solver of any problem.

    That of problems from rest among static obstacles, and its wrappers.

    Args:
        before: An earlier motion, kept or repaired if possible.
        stop: Returns a motion to rest from a start in motion, tried before the default ones.
    """
    solve = with_less_force(from_motion(plans_from_rest, stop))
    return with_reuse(before, past_moving_obstacles(solve, stop))


def _last_in_time(found: Iterator[Plan], limit: TimeLimit) -> PlanResult:
    """The last plan of an anytime search before the deadline.

    Raises:
        TimeIsUpError: There was no plan before the deadline.
    """
    best: PlanResult | None = None
    count, first_s, cut_short = 0, 0.0, False
    # Keep this fraction of the time that the world took to prepare: releasing it afterwards takes time, too.
    freeing_s = 0.25 * limit.elapsed_s
    limit.keep(freeing_s)
    try:
        for plan in found:
            since_s = limit.elapsed_s
            best = plan_result(plan)
            count, first_s = count + 1, first_s or limit.elapsed_s
            limit.keep(freeing_s + limit.elapsed_s - since_s)  # for the next result
    except TimeIsUpError:
        limit.check_cancelled()
        cut_short = True
    if best is None:
        raise TimeIsUpError
    return replace(best, told={**best.told, **deadline_report(limit, count, first_s, cut_short=cut_short)})


def _fraction_with_room(problem: Problem) -> float:
    """Fraction of the tracking error that an exact plan allows.

    0 if planning fails even without a tracking error.
    """
    robot, scene, options = problem.robot, problem.scene, problem.options
    try:
        found = solve_scene(
            Problem.from_scene(robot, scene, replace(options, tracking_error=0.0, tracking_delay_s=0.0))
        )
    except HplanError:
        return 0.0

    def is_certified(fraction: float) -> bool:
        tracking = options.tracking.scale(fraction)
        return certify(
            robot, scene, found.trajectory, sigmas=options.sigmas,
            tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s,
            goal_contact="approach" if len(found.phases) > 1 else "motion",
        ).verified  # fmt: skip

    return largest_fraction(is_certified)


def plan_result(plan: Plan) -> PlanResult:
    """The result of a plan, with contact times and the requested bound."""
    phases, trajectory, certificate = plan.join_phases
    problem = plan.transit.problem
    fruit = problem.scene.goal_fruit
    if certificate.digests is None:  # those of the parts say nothing of the whole
        if fruit is not None:
            # Without an approach the last link may touch the fruit during the whole motion.
            goal_contact: GoalContact = "approach" if plan.others else "motion"
            contacts = goal_contacts(problem.robot, trajectory, fruit, goal_contact)
            certificate = replace(certificate, goal_contact=goal_contact, contacts=contacts)
        certificate = replace(certificate, digests=Digests(problem.robot, problem.scene, trajectory))
    return PlanResult(
        motion=plan.transit,
        trajectory=trajectory,
        certificate=certificate,
        phases=phases,
        grasp=plan.grasp,
        bound=_bound(plan) if problem.options.bound else None,
        time_ms=current_clock().as_ms(),
        told=plan.told,
    )


def _bound(plan: Plan) -> DurationBound | None:
    """Lower bound of the duration of a plan's first motions, or None.

    Raises:
        BoundError: The bound contradicts their duration.
    """
    from hplan.planning.lower_bound.duration_bound import (
        duration_bound,  # loads its kernels only if a bound is requested
    )

    motions = plan.motions[: bounded_phases(plan.transit)]
    if not all(motion.certificate.verified for motion in motions):
        return None
    problem, world = plan.transit.problem, plan.transit.problem.world
    if len(motions) > 1 and plan.grasp is not None:
        # Bound all motions to the grasp with free contact of the last link and the fruit: a superset of the real
        # motions.
        fruit = problem.scene.goal_fruit
        problem = replace(problem, goals=plan.grasp.goal[None])
        world = world if fruit is None else world.allow_touch(fruit.name, fruit.hangs_from)
    with stage("bound"):
        return duration_bound(world, problem, motion_limits(problem), seconds(motions))


def with_export_time(result: PlanResult, export_s: float) -> PlanResult:
    """The result with the time of the export in its report."""
    took = round(1e3 * export_s, 4)
    return replace(
        result, time_ms={**result.time_ms, "export": took, "total": round(result.time_ms["total"] + took, 4)}
    )
