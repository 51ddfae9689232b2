"""Ever quicker certified plans: a motion to joints, or a transit, an approach and, from a fruit, a retreat.

There is one way to them, `plans`. Without a deadline its last one is taken; with one the first comes as soon as can be,
and the last before the deadline is taken (`hplan.planning.plan`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    TimingError,
)
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning.approach import Approach, blended
from hplan.planning.effort import Effort, efforts_of
from hplan.planning.failures import FailuresError, without_path
from hplan.planning.grasps import COUNT, SPARE, Grasp, Target, grasps, promising
from hplan.planning.motion import Plan, Transit
from hplan.planning.pose_goal import configurations_at, pose_of
from hplan.planning.start_in_motion import plans_in_motion
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.planning.transits import reused, transits
from hplan.trajectory.trajectory import Trajectory


def plans(
    context: PlanningContext,
    start: FloatArray,
    state: BoundaryState | None = None,
    *,
    before: Transit | None = None,
    stop: Trajectory | None = None,
) -> Iterator[Plan]:
    """Certified plans, each quicker than the one before; the last one is what the options ask for, or as quick.

    Args:
        start: (dof,) configuration.
        state: The state of motion there; None at rest.
        before: An earlier motion, to be kept or repaired where that can be; None for none.
        stop: How a start in motion might be brought to rest, in addition to what is tried anyway; None for none.

    Raises:
        TimeIsUpError: The deadline came before the last one.
        HplanError: There is none; as `hplan.planning.plan.plan`.
    """
    kept = None if before is None or state is not None else _kept(context, start, before)
    if kept is not None:
        yield Plan(kept)
        return
    best_s, is_found = math.inf, False
    efforts = efforts_of(context.robot, context.options)
    for effort in efforts:
        if context.options.objective == "length":
            best_s = math.inf  # what more is spent on is shorter, not quicker
        try:
            for plan in _with_effort(replace(context, effort=effort), start, state, stop):
                if plan.duration < best_s:
                    best_s, is_found = plan.duration, True
                    yield plan
        except HplanError as error:
            if not is_found and (effort is efforts[-1] or not _may_be_found(context, effort, error)):
                raise


def _may_be_found(context: PlanningContext, effort: Effort, error: HplanError) -> bool:
    """True if a larger effort may find a motion after a smaller one has failed by an error."""
    if not isinstance(error, NoPathError):
        return isinstance(error, NotFoundError | CertificationError | TimingError)
    # The proof is about the goals that were tried, which are all only if the goal is given as joints.
    goal = context.scene.goal
    tries_all = not effort.at_once and goal.pose is None
    return not tries_all and context.robot.joints_of(goal, "goal") is None


def _with_effort(
    context: PlanningContext, start: FloatArray, state: BoundaryState | None, stop: Trajectory | None
) -> Iterator[Plan]:
    if state is None:
        return _from_rest(context, start)
    return plans_in_motion(context, state, lambda q: _from_rest(context, q), stop)


def _kept(context: PlanningContext, start: FloatArray, before: Transit) -> Transit | None:
    """The earlier motion, kept or repaired; None where it cannot be."""
    goal = _goal(context, start)
    return None if isinstance(goal, Target) else reused(goal, before)


def _from_rest(context: PlanningContext, start: FloatArray) -> Iterator[Plan]:
    """Ever quicker plans with one effort."""
    goal = _goal(context, start)
    if isinstance(goal, Target):
        yield from _to_target(context, goal, start)
        return
    try:
        yield from (Plan(motion) for _, motion in transits(goal))
    except FailuresError as failures:
        raise failures.as_one() from None


def _goal(context: PlanningContext, start: FloatArray) -> list[PlanningTask] | Target:
    """What is asked: a motion to joints, or to some of those with a frame at a pose; or a target to reach."""
    scene, world = context.scene, context.world
    goal = scene.goal
    joints = context.robot.joints_of(goal, "goal")
    if joints is not None:
        return [context.task(start, context.robot.turned_near(joints, start))]
    if goal.pose is not None and not context.options.standoff:
        with context.stage("grasps"):
            ends = configurations_at(world, goal, start, scene.locked_joints)
            return [context.task(start, end) for end in ends[: context.effort.pose_goals]]
    if goal.pose is not None:
        pose = pose_of(world.robot, goal)
        return Target("the pose", pose[:3, 3], world, world, pose=pose, frame=goal.frame)
    for fruit in scene.fruits:
        if fruit.name == goal.fruit:
            return Target.of_fruit(world, fruit, scene, context.options)
    return Target("the point", np.array(goal.position), world, world, goal.approach_deg)


def _to_target(context: PlanningContext, target: Target, start: FloatArray) -> Iterator[Plan]:
    """Ever quicker plans to a target; the last one goes without a stop before the approach where that is quicker."""
    at_once, locked = context.effort.at_once, context.scene.locked_joints
    # So many grasps are tried where a motion is wanted at once.
    first_grasps = 3
    with context.stage("grasps"):
        # Where a motion is wanted at once, grasps are chosen among few configurations.
        count = 24 if at_once else COUNT
        found = grasps(target, start, standoff=context.options.standoff_m, locked=locked, count=count)
        if at_once:
            likely = promising(found, target, start)
            found = (*likely[:first_grasps], *likely[first_grasps:][-1:])  # the last may be straight ahead
    for approach, plan in plans_to_grasps(context, target, found, start):
        quickest = approach, plan
        yield plan
    approach, plan = quickest
    non_stop = blended(plan.transit.task, plan.transit, None, approach) if plan.others else None
    if non_stop is not None and non_stop[2] is not None:
        yield replace(plan, transit=non_stop[1], others=(non_stop[2], *plan.others[1:]))


def plans_to_grasps(
    context: PlanningContext,
    target: Target,
    found: Sequence[Grasp],
    start: FloatArray,
    task_to: Callable[[Grasp], PlanningTask] | None = None,
) -> Iterator[tuple[Approach, Plan]]:
    """Ever quicker plans to one of several grasps, with a stop before the approach; and how it is approached.

    The promising grasps are tried as if there were no others. Where none of them can be reached, one flood shows to
    which of the others no path exists, and those that are left are tried in their order. Grasps without an approach
    come after all those with one.

    Args:
        found: Its grasps, those that promise the shortest motions first.
        start: (dof,) configuration from which the arm comes.
        task_to: The motion to plan to a grasp, where it is not that to its stand-off among what the target has there;
            raises `ConfigurationInCollisionError` where it cannot be taken.

    Raises:
        NoPathError: No path to any of the grasps exists on the grid.
        TimingError: No path can be timed.
        CertificationError: Not all grasps were shown to have no path, and no motion could be certified.
        ConfigurationInCollisionError: The start is in collision.
    """

    def to_standoff(grasp: Grasp) -> PlanningTask:
        return context.among(target.transit_world(grasp)).task(start, grasp.standoff)

    ordered: list[Grasp] = []
    failures: dict[int, HplanError] = {}
    for is_likely, batch in _batches(target, found, start):
        tasks: dict[int, PlanningTask] = {}
        for number, grasp in enumerate(batch, len(ordered)):
            try:
                tasks[number] = (task_to or to_standoff)(grasp)
            except ConfigurationInCollisionError as error:
                if error.which == "start":
                    raise
                failures[number] = error.with_traceback(None)
        ordered += batch
        if not is_likely and context.effort.floods:
            shown = zip(list(tasks), without_path(list(tasks.values())), strict=True)
            failures |= {number: error for number, error in shown if error is not None}
        while left := [number for number in tasks if number not in failures]:
            is_found = False
            try:
                for place, transit in transits([tasks[number] for number in left]):
                    approach = Approach(context, target, ordered[left[place]])
                    try:
                        plan = Plan(transit, approach.motions, approach.grasp)
                    except (CertificationError, TimingError) as error:
                        failures[left[place]] = error.with_traceback(None)
                        if not is_found:
                            break
                    else:
                        is_found = True
                        yield approach, plan
            except FailuresError as none:
                failures |= zip(left, none.errors, strict=True)
            if is_found:
                return
    raise _failure(target, ordered, [failures[number] for number in range(len(ordered))])


def _batches(target: Target, found: Sequence[Grasp], start: FloatArray) -> Iterator[tuple[bool, list[Grasp]]]:
    """Grasps to try together, those with an approach before those without; and whether they are the promising ones."""
    for batch in ([grasp for grasp in found if grasp.distance > 0.0], [grasp for grasp in found if not grasp.distance]):
        likely = promising(batch, target, start)
        first = {id(grasp) for grasp in likely}
        yield True, likely
        yield False, [grasp for grasp in batch if id(grasp) not in first]


def _failure(target: Target, ordered: Sequence[Grasp], errors: Sequence[HplanError]) -> HplanError:
    """The one error for all grasps; where they have little room it says how little."""
    failure = FailuresError(tuple(errors)).as_one(f"grasps of {target.what}")
    room = max(grasp.room for grasp in ordered)
    if room < SPARE:
        remark = (
            f"spare clearance {1e3 * room:.2g} mm at the grasp; with {1e3 * SPARE:g} mm there would be room to move"
        )
        failure.add(remark, spare_clearance_m=room, needed_clearance_m=SPARE)
    return failure
