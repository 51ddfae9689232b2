"""All parts of a plan: a motion to joints, or transit and approach to a fruit or a point and, from a fruit, a retreat.

Without a deadline they are what the options ask for. With one the first certified motion comes as soon as can be, by
what finds most motions in a few milliseconds, without regard to how quick it is; then come quicker ones near it, each
certified, as often as there is time; and last what the options ask for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import FloatArray, Record, frozen
from hplan.errors import (
    BlockedError,
    CertificationError,
    HplanError,
    InputError,
    NotFoundError,
    TimingError,
    UnreachableError,
)
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning.certified_motion import (
    Origin,
    PlannedMotion,
    Polyline,
    along,
    ever_quicker,
)
from hplan.planning.effort import effort_of
from hplan.planning.find_motion import find_motion, first_found, first_motion, reuse_motion
from hplan.planning.grasp_motion import (
    FindMotion,
    Pick,
    approach_and_retreat,
    flowing,
    motion_to_grasp,
)
from hplan.planning.grasps import COUNT, Target, grasps, promising
from hplan.planning.pose_goal import configurations_at, pose_of
from hplan.planning.refusals import Refusals
from hplan.planning.sampled_motion import tree_path_to_any
from hplan.planning.sampling.rrt_connect import TreeEffort
from hplan.planning.start_in_motion import Parts, leaving
from hplan.planning.task import PlanningContext, PlanningTask
from hplan.trajectory.trajectory import Trajectory

#: Pairs of trees that look for the first motion, the evaluations of each.
FIRST_TREES = (3_000, 3_000, 3_000, 3_000, 12_000, 12_000, 12_000, 12_000)

#: Pairs of trees where the base is locked: grids find narrow passages there.
PLANAR_TREES = 2

#: Configurations at a fruit among which grasps are chosen for the first motion, and how many of them.
FEW_GRASPS, FIRST_GRASPS = 24, 3


@dataclass(frozen=True, eq=False)
class Beginning(Record):
    """What a plan begins with.

    Attributes:
        start: (dof,) configuration.
        state: The state of motion there; None at rest.
        before: An earlier motion, to be kept or repaired where that can be; None for none.
        stop: How a start in motion might be brought to rest, in addition to what is tried anyway; None for none.
    """

    start: FloatArray
    state: BoundaryState | None
    before: PlannedMotion | None = None
    stop: Trajectory | None = None


def all_parts(context: PlanningContext, begin: Beginning) -> Parts:
    """What the options ask for.

    Args:
        context: Arm, scene and options.
        begin: What the plan begins with.

    Raises:
        HplanError: As `hplan.planning.plan.plan`.
    """
    if begin.state is None:
        return _asked_for(context, begin.start, begin.before)
    return leaving(context, begin.state, lambda start: _asked_for(context, start, None), begin.stop)


def parts_in_time(context: PlanningContext, begin: Beginning) -> Iterator[Parts]:
    """One plan after the other, each quicker than the one before, the last one what the options ask for.

    Args:
        context: Arm, scene and options.
        begin: What the plan begins with.

    Raises:
        TimeIsUpError: The deadline came before the last one.
        HplanError: As `hplan.planning.plan.plan`, before the first one.
    """
    kept = None if begin.before is None or begin.state is not None else _kept(context, begin)
    if kept is not None:
        yield kept
        return
    quick = replace(context, options=replace(context.options, effort="quick"))
    if begin.state is None:
        first = _first(context, begin.start)
    else:
        first = leaving(quick, begin.state, lambda start: _first(context, start), begin.stop)
    yield first
    best, by_duration = first, context.options.objective == "duration"
    for better in _better(context, begin, first) if by_duration else ():
        if better.duration < best.duration:
            best = better
            yield best
    with suppress(HplanError):  # what finds most motions at once may find one where more effort finds none
        asked = all_parts(context, replace(begin, before=None))
        if not by_duration or asked.duration < best.duration:
            yield asked


def _better(context: PlanningContext, begin: Beginning, first: Parts) -> Iterator[Parts]:
    """Plans that may be quicker than the first one, which they begin with."""
    if begin.state is not None:
        with suppress(HplanError):
            yield leaving(context, begin.state, lambda start: _first(context, start), begin.stop)
        return
    best = first
    for motion in ever_quicker(first.motion):
        best = Parts(best.grasp, motion, [motion.transit, *best.parts[1:]])
        yield best
    yield _flowing(context, best)


def _asked_for(context: PlanningContext, start: FloatArray, before: PlannedMotion | None) -> Parts:
    """What the options ask for, from rest."""
    goal = _goal(context, start)
    if isinstance(goal, list):
        motion = None if before is None else _reused(goal, before)
        return _alone(find_motion(goal)[1] if motion is None else motion)
    return _flowing(context, _to_grasp(context, goal, start))


def _first(context: PlanningContext, start: FloatArray) -> Parts:
    """The first parts that are found, from rest."""
    goal = _goal(context, start)
    if isinstance(goal, list):
        found = first_in_time(goal)
        if isinstance(found, Refusals):
            raise found.error()
        return _alone(found[1])
    try:  # some grasps, the promising ones of them, and nothing that takes long
        return _to_grasp(context, goal, start, _at_once, FEW_GRASPS)
    except (BlockedError, UnreachableError, InputError):  # more grasps were looked at already
        raise
    except HplanError:
        return _to_grasp(context, goal, start, first_in_time)


def _kept(context: PlanningContext, begin: Beginning) -> Parts | None:
    """The earlier motion, kept or repaired; None where it cannot be."""
    goal = _goal(context, begin.start)
    if begin.before is None or not isinstance(goal, list):
        return None
    motion = _reused(goal, begin.before)
    return None if motion is None else _alone(motion)


def _reused(tasks: Sequence[PlanningTask], before: PlannedMotion) -> PlannedMotion | None:
    """An earlier motion, kept or repaired for that of some tasks that has its goal; None where it cannot be."""
    motions = (reuse_motion(task, before) for task in tasks)
    return next((motion for motion in motions if motion is not None), None)


def first_in_time(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """A certified motion to one of several goals as soon as can be; where there is none, why not to each of them."""
    if any(task.problem.is_empty for task in tasks):
        return first_motion(tasks)
    found = _at_once(tasks)
    if not isinstance(found, Refusals):
        return found
    return first_motion([replace(task, options=replace(task.options, effort="quick")) for task in tasks])


def _at_once(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | Refusals:
    """The same without what takes long and would show that there is none."""
    found = first_found(tasks, _straight) or _by_trees(tasks)
    return found or Refusals(tuple(NotFoundError(["straight motion", "trees"]) for _ in tasks))


def _straight(task: PlanningTask) -> PlannedMotion | None:
    """The straight motion; None where it is not clear."""
    return _along(task, frozen(np.stack([task.problem.start, task.problem.goal])), "direct")


def _by_trees(tasks: Sequence[PlanningTask]) -> tuple[int, PlannedMotion] | None:
    """The motion along the first path of trees to whichever goal; None where none is found."""
    for seed, evaluations in enumerate(FIRST_TREES if tasks[0].problem.turns else FIRST_TREES[:PLANAR_TREES]):
        reached = tree_path_to_any(tasks, TreeEffort(evaluations, seed))
        if reached is None:
            continue
        number, path = reached
        motion = _along(tasks[number], path, "trees")
        if motion is not None:
            return number, motion
    return None


def _along(task: PlanningTask, waypoints: FloatArray, origin: Origin) -> PlannedMotion | None:
    """The motion along the first smooth path near a polyline; None where none is verified collision-free."""
    with suppress(CertificationError, TimingError):
        return along(task, Polyline(waypoints, origin), task.margin())
    return None


def _goal(context: PlanningContext, start: FloatArray) -> list[PlanningTask] | Target:
    """What is asked: a motion to joints, or to some of those with a frame at a pose; or a point to reach."""
    scene = context.scene
    goal = context.robot.joints_of(scene.goal, "goal")
    if goal is not None:
        return [context.task(start, context.robot.turned_near(goal, start))]
    if scene.goal.pose is not None and not context.options.standoff:
        with context.stage("grasps"):
            ends = configurations_at(context.world, scene.goal, start, scene.locked_joints)
            return [context.task(start, end) for end in ends[: effort_of(context).pose_goals]]
    return _target(context)


def _target(context: PlanningContext) -> Target:
    """The fruit, the place or the pose of the scene's goal."""
    goal, world = context.scene.goal, context.world
    if goal.pose is not None:
        pose = pose_of(world.robot, goal)
        return Target("the pose", pose[:3, 3], world, world, pose=pose, frame=goal.frame)
    for fruit in context.scene.fruits:
        if fruit.name == goal.fruit:
            return Target.of_fruit(world, fruit, goal.approach_deg)
    return Target("the point", np.array(goal.position), world, world, goal.approach_deg)


def _to_grasp(
    context: PlanningContext, target: Target, start: FloatArray, find: FindMotion | None = None, count: int = COUNT
) -> Parts:
    """The motion to a grasp of a target, its approach from rest and the retreat."""
    standoff, locked = context.options.standoff_m, context.scene.locked_joints
    with context.stage("grasps"):
        found = grasps(target, start, standoff=standoff, locked=locked, count=count)
        if count < COUNT:
            likely = promising(found, target, start)
            found = (*likely[:FIRST_GRASPS], *likely[FIRST_GRASPS:][-1:])  # the last may be straight ahead
    grasp, motion, last = motion_to_grasp(
        target,
        found,
        start,
        lambda grasp: context.among(target.transit_world(grasp)).task(start, grasp.standoff),
        lambda grasp: approach_and_retreat(context, target, grasp),
        find,
    )
    return Parts(grasp, motion, [motion.transit, *last])


def _flowing(context: PlanningContext, stopping: Parts) -> Parts:
    """The same without a stop before the approach, where that is quicker."""
    grasp, motion, parts = stopping
    if grasp is None or len(parts) == 1:
        return stopping
    flow = flowing(motion.task, motion.transit, None, Pick(context, _target(context), grasp, parts[1]))
    if flow is None or flow.approach is None:
        return stopping
    _, trajectory, certificate = flow.transit
    motion = replace(motion, path=flow.path, trajectory=trajectory, certificate=certificate)
    return Parts(grasp, motion, [motion.transit, flow.approach, *parts[2:]])


def _alone(motion: PlannedMotion) -> Parts:
    return Parts(None, motion, [motion.transit])
