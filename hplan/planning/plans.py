"""Anytime certified plans from rest to any goal.

A plan is a motion to joints, or a transit, an approach and, from a fruit, a retreat. Without a deadline the last plan
is taken. With a deadline the first plan comes as soon as possible, and the last one before the deadline is taken
(`hplan.planning.plan`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.deadline import check_deadline
from hplan.errors import (
    CertificationError,
    ConfigurationInCollisionError,
    HplanError,
    NoPathError,
    NotFoundError,
    TimingError,
)
from hplan.planning.approach import Approach, blend
from hplan.planning.effort import FAR_FROM_BOUND, Effort, efforts_of
from hplan.planning.failures import FailuresError, mark_approach
from hplan.planning.grasps import COUNT, SPARE, Grasp, Target, grasps, select_promising
from hplan.planning.motion import Motion, Plan, Solver, require_whole
from hplan.planning.pose_goal import configurations_at, goal_pose
from hplan.planning.problem import Problem, merge_problems
from hplan.planning.solver import motions, prove_each_goal, reuse_motion
from hplan.planning.specialist import presets_of
from hplan.planning.stages import stage


def with_all_efforts(solve: Solver) -> Solver:
    """A solver that tries the budgets of the options in turn.

    Each plan is faster than the one before.

    The last plan results from the requested effort, or is as fast; with a deadline, `quick` ends with the first search
    that finds one if the arm is moving or the plan is close to its lower bound. The world is prepared before the solver
    returns.
    """

    def plans(problem: Problem) -> Iterator[Plan]:
        best_s: float = math.inf
        best: Plan | None = None
        efforts = efforts_of(presets_of(problem.robot), problem.options)
        for effort in efforts:
            if (
                best is not None
                and problem.options.effort == "quick"
                and (problem.scene.start.is_moving or _is_close(best.transit))
            ):
                return
            if problem.options.objective == "length":
                best_s = math.inf  # a larger effort yields shorter paths, not faster motions
            try:
                for plan in solve(replace(problem, effort=effort)):
                    if plan.duration < best_s:
                        best_s, best = plan.duration, plan
                        yield plan
            except HplanError as error:
                if best is None and (effort is efforts[-1] or not _may_be_found(problem, effort, error)):
                    raise

    def solver(problem: Problem) -> Iterator[Plan]:
        problem.world.check_base()
        if problem.world.upright is not None:
            problem.world.upright.check(problem.robot, problem.start, "start", problem.world.deviation)
        check_deadline()
        return plans(problem.in_world(problem.world))

    return solver


def _is_close(transit: Motion) -> bool:
    """True if a transit takes little longer than its lower bound (`FAR_FROM_BOUND`)."""
    return transit.trajectory.duration <= FAR_FROM_BOUND * transit.problem.least_duration


def with_reuse(before: Motion | None, solve: Solver) -> Solver:
    """A solver that keeps or repairs an earlier motion if possible.

    Args:
        before: The earlier motion, from rest among static obstacles; None for none.
        solve: Solves the problem if that is impossible.
    """

    def plans(problem: Problem, found: Iterator[Plan]) -> Iterator[Plan]:
        goal = None if before is None or problem.scene.moves or problem.scene.start.is_moving else goal_of(problem)
        kept = reuse_motion(goal, before) if isinstance(goal, Problem) and before is not None else None
        yield from found if kept is None else (Plan(kept),)

    return lambda problem: plans(problem, solve(problem))


def _may_be_found(problem: Problem, effort: Effort, error: HplanError) -> bool:
    """True if a larger effort may succeed after an error."""
    if not isinstance(error, NoPathError):
        return isinstance(error, NotFoundError | CertificationError | TimingError)
    # The proof covers the goals that were tried: all of them only if the goal is given as joints.
    goal = problem.scene.goal
    tries_all = not effort.at_once and goal.pose is None
    return not tries_all and not goal.has_joints


def plans_from_rest(problem: Problem) -> Iterator[Plan]:
    """Plans with the effort of a problem, each faster than before.

    Raises:
        TimeIsUpError: The deadline has passed.
        HplanError: No plan was found; as in `hplan.planning.plan.plan`.
    """
    goal = goal_of(problem)
    if isinstance(goal, Target):
        yield from _to_target(problem, goal)
        return
    try:
        yield from (Plan(motion) for _, motion in motions(goal))
    except FailuresError as failures:
        raise failures.as_one() from None


def goal_of(problem: Problem) -> Problem | Target:
    """The problem with its goal configurations; or the target to approach."""
    scene, world, start = problem.scene, problem.world, problem.start
    goal = scene.goal
    joints = problem.robot.joints_of(goal, "goal", scene.start)
    if joints is not None:
        return problem.from_configurations(start, problem.robot.turned_near(joints, start))
    if goal.pose is not None and not problem.options.standoff:
        with stage("grasps"):
            ends = configurations_at(world, goal, start, scene.locked_joints, problem.pose_starts)
            return merge_problems(
                [problem.from_configurations(start, end) for end in ends[: problem.effort.pose_goals]]
            )
    if goal.pose is not None:
        pose = goal_pose(goal)
        return Target(
            "the pose",
            pose[:3, 3],
            world,
            world,
            pose=pose,
            frame=goal.frame,
            rotation_tolerance=goal.rotation_tolerance,
        )
    for fruit in scene.fruits:
        if fruit.name == goal.fruit:
            return Target.of_fruit(world, fruit, scene, problem.options)
    return Target("the point", np.array(goal.position), world, world, goal.approach_deg)


def _to_target(problem: Problem, target: Target) -> Iterator[Plan]:
    """Plans to a target, each faster than the one before.

    The last one has no stop before the approach if that is faster.
    """
    at_once, locked, start = problem.effort.at_once, problem.scene.locked_joints, problem.start
    # Number of grasps for a first motion.
    first_grasps = 3
    with stage("grasps"):
        # For a first motion grasps are chosen from fewer configurations.
        count = 24 if at_once else COUNT
        found = grasps(target, start, standoff=problem.options.standoff_m, locked=locked, count=count)
        if at_once:
            likely = select_promising(found, target, start)
            found = (*likely[:first_grasps], *likely[first_grasps:][-1:])  # the last may be straight ahead
    for approach, plan in plans_to_grasps(problem, target, found):
        quickest = approach, plan
        yield plan
    approach, plan = quickest
    non_stop = blend(plan.transit.problem, plan.transit, None, approach) if plan.others else None
    if non_stop is not None and non_stop[2] is not None:
        quicker = replace(plan, transit=non_stop[1], others=(non_stop[2], *plan.others[1:]))
        try:
            require_whole(problem, quicker)
        except CertificationError:
            return  # the plan with stops is certified
        yield quicker


def plans_to_grasps(
    problem: Problem,
    target: Target,
    found: Sequence[Grasp],
    problem_to: Callable[[Grasp], Problem] | None = None,
) -> Iterator[tuple[Approach, Plan]]:
    """Anytime plans to one of several grasps, with the approach to it.

    The plans stop before the approach. The promising grasps are tried as if there were no others. If all of them fail,
    infeasibility proofs exclude some of the others, and the rest are tried in order. Grasps without an
    approach come after all grasps with one.

    Args:
        found: The grasps of the target, shortest expected motion first.
        problem_to: Returns the problem of a motion to a grasp; raises `ConfigurationInCollisionError` if the goal is in
            collision. None for motions to the stand-off in the target's world.

    Raises:
        NoPathError: No path to any of the grasps exists on the grid.
        TimingError: No path can be timed.
        CertificationError: Not all grasps were proved unreachable, and no motion could be certified.
        ConfigurationInCollisionError: The start is in collision.
    """
    start = problem.start

    def to_standoff(grasp: Grasp) -> Problem:
        return problem.in_world(target.transit_world(grasp)).from_configurations(start, grasp.standoff)

    ordered: list[Grasp] = []
    failures: dict[int, HplanError] = {}
    for is_likely, batch in _batches(target, found, start):
        problems: dict[int, Problem] = {}
        for number, grasp in enumerate(batch, len(ordered)):
            try:
                problems[number] = (problem_to or to_standoff)(grasp)
            except ConfigurationInCollisionError as error:
                if error.which == "start":
                    raise
                failures[number] = mark_approach(error.with_traceback(None))
        ordered += batch
        approaches = {number: Approach(problem, target, ordered[number]) for number in problems}
        if not is_likely and problems:
            proofs = prove_each_goal(merge_problems(list(problems.values())))
            failures |= {number: error for number, error in zip(problems, proofs, strict=True) if error is not None}
        while left := [number for number in problems if number not in failures]:
            is_found = False
            try:
                for place, transit in motions(merge_problems([problems[number] for number in left])):
                    approach = approaches[left[place]]
                    try:
                        plan = require_whole(problem, Plan(transit, approach.motions, approach.grasp))
                    except (CertificationError, TimingError) as error:
                        failures[left[place]] = mark_approach(error.with_traceback(None))
                        if not is_found:
                            # Approaches to a fruit often fail for the same reason: no transits to others that do.
                            others = [number for number in left if number not in failures][: len(failures)]
                            failures |= _approach_failures({number: approaches[number] for number in others})
                            break
                    else:
                        is_found = True
                        yield approach, plan
            except FailuresError as none:
                failures |= zip(left, none.errors, strict=True)
            if is_found:
                return
    raise _failure(target, ordered, [failures[number] for number in range(len(ordered))])


def _approach_failures(approaches: Mapping[int, Approach]) -> dict[int, HplanError]:
    """Errors of the approaches that cannot be timed or certified, by number."""
    failures = dict[int, HplanError]()
    for number, approach in approaches.items():
        try:
            approach.from_rest  # noqa: B018 (it is computed once and kept)
        except (CertificationError, TimingError) as error:
            failures[number] = mark_approach(error.with_traceback(None))
    return failures


def _batches(target: Target, found: Sequence[Grasp], start: FloatArray) -> Iterator[tuple[bool, list[Grasp]]]:
    """Batches of grasps to try together, and True for the promising ones.

    Grasps with an approach come before those without.
    """
    for batch in ([grasp for grasp in found if grasp.distance > 0.0], [grasp for grasp in found if not grasp.distance]):
        likely = select_promising(batch, target, start)
        first = {id(grasp) for grasp in likely}
        yield True, likely
        yield False, [grasp for grasp in batch if id(grasp) not in first]


def _failure(target: Target, ordered: Sequence[Grasp], errors: Sequence[HplanError]) -> HplanError:
    """One error for all grasps, with the spare clearance if too small."""
    failure = FailuresError(tuple(errors)).as_one(f"grasps of {target.what}")
    room = max(grasp.room for grasp in ordered)
    if room < SPARE:
        remark = (
            f"spare clearance {1e3 * room:.2g} mm at the grasp; with {1e3 * SPARE:g} mm the arm would have room to move"
        )
        failure.add(remark, spare_clearance_m=room, needed_clearance_m=SPARE)
    return failure
