"""Motions between which the arm picks objects up and puts them down, on one clock.

The arm rests at the end of each step; there an obstacle of the scene becomes a held object, or a held object becomes an
obstacle where it is. Each motion is planned and certified in the scene of its step (`Scene.pick_up`, `Scene.put_down`).

At a pick and at a put, hand and object, and the object and what it stands on, are nearer than the clearance, or in
contact. A motion away from such a place begins with contacts that it only leaves (`Start.contact_depth`). A motion to
such a place is one away from it in reverse: distances and torques are the same in both directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from hplan.base.arguments import instance, list_of
from hplan.base.arrays import FloatArray, Record, numbers
from hplan.base.deadline import Cancel, TimeIsUpError, time_limit
from hplan.certificate.certificate import Certificate, all_of, certify
from hplan.collision.held_objects import holding
from hplan.errors import (
    BlockedError,
    ConfigurationInCollisionError,
    HplanError,
    InputError,
    MovingObstacleError,
    NotFoundError,
)
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning.options import PlanOptions
from hplan.planning.plan import check_task, plan, plan_if_free
from hplan.planning.stages import Progress, no_progress
from hplan.robot.model import Robot
from hplan.robot.upright import with_fixed_axis
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.steps import Step
from hplan.trajectory.trajectory import Phase, Trajectory, join_trajectories

#: Maximum number of configurations at a pose that are tried for a motion into contact.
_MOST_ENDS = 8


@dataclass(frozen=True, eq=False)
class StepMotion(Record):
    """The motion of one step.

    Attributes:
        step: The step.
        scene: Obstacles and held objects during the motion; its start and goal are the ends of the certified motion.
        trajectory: The motion, from time 0.
        certificate: Its certificate.
        arrives: True if it ends in contact: its reverse is certified in `scene`.
    """

    step: Step
    scene: Scene
    trajectory: Trajectory
    certificate: Certificate
    arrives: bool


@dataclass(frozen=True, eq=False)
class StepsResult(Record):
    """Motions of all steps, on one clock.

    Attributes:
        robot: The arm, without what it picks up.
        motions: The motion of each step.
        trajectory: All of them, one after the other.
        certificate: The certificates of all of them.
        phases: Time of each step, with the names `step 1`, `step 2`, ...
        scene: The scene after the last step.
    """

    robot: Robot
    motions: tuple[StepMotion, ...]
    trajectory: Trajectory
    certificate: Certificate
    phases: tuple[Phase, ...]
    scene: Scene

    @property
    def picked(self) -> Mapping[str, float]:
        """Time of the last pick of each object, by name [s]."""
        return self._times("pick")

    @property
    def put(self) -> Mapping[str, float]:
        """Time of the last put of each object, by name [s]."""
        return self._times("put")

    def _times(self, key: str) -> Mapping[str, float]:
        steps = zip(self.motions, self.phases, strict=True)
        named = ((getattr(motion.step, key), phase.end_s) for motion, phase in steps)
        return MappingProxyType({name: end_s for name, end_s in named if name is not None})


def plan_steps(
    robot: Robot,
    scene: Scene,
    steps: Sequence[Step],
    options: PlanOptions | None = None,
    *,
    progress: Progress = no_progress,
    cancel: Cancel | None = None,
) -> StepsResult:
    """Plan motions between which objects are picked up and put down.

    Args:
        robot: The arm.
        scene: The scene before the first step; its goal is ignored.
        steps: The goals, and what the hand does there. A motion that begins and one that ends at a place of contact are
            two steps: lift an object before it is carried.
        options: How to plan each motion.
        progress: Called with the name of each stage as it begins.
        cancel: A function or an event that reports cancellation.

    Raises:
        InputError: There are no steps; a step picks what is not there or puts what is not held; a goal is invalid.
        MovingObstacleError: An obstacle of the scene moves.
        NotInTimeError: The deadline, which counts for all steps, passed.
        HplanError: An error of `plan`; its data has the number of the step (`step`).

    Examples:
        >>> from hplan import load_robot, load_scene
        >>> from hplan.planning.steps import plan_steps
        >>> from hplan.scene import Goal, Sphere, Step
        >>> robot, scene = load_robot(), load_scene()
        >>> there, back = (0.0, 45.0, 60.0, 70.0), (0.0, 60.0, 40.0, 40.0)
        >>> q = robot.joints_of(Goal(joints_deg=there), "goal")
        >>> x, y, z = robot.tool_positions(q).tolist()
        >>> pear = Sphere(name="pear", center=(x, y, z + 0.08), radius=0.04)
        >>> steps = [
        ...     Step(goal=Goal(joints_deg=there), pick="pear", mass=0.2),
        ...     Step(goal=Goal(joints_deg=back), put="pear"),
        ... ]
        >>> result = plan_steps(robot, scene.with_obstacles([*scene.obstacles, pear]), steps)
        >>> result.certificate.verified, list(result.picked), list(result.put)
        (True, ['pear'], ['pear'])
    """
    check_task(robot, scene, options, progress)
    steps = list_of("steps", steps, Step, "steps")
    if not steps:
        raise InputError("steps: there is no step")
    if scene.moves:
        raise MovingObstacleError(scene.first_moving)
    options = PlanOptions() if options is None else options
    whole = replace(options, deadline_s=None)
    with time_limit(options.deadline_s, cancel) as limit:
        try:
            found, now = list[StepMotion](), with_fixed_axis(robot, scene)
            for number, step in enumerate(steps):
                progress(f"step {number + 1} of {len(steps)}")
                before = steps[number - 1] if number else None
                try:
                    motion = _plan_step(robot, now, before, step, whole)
                    found.append(motion)
                    now = _after(robot, now, step, motion.trajectory.position[-1])
                except HplanError as error:
                    error.add(f"this is step {number + 1} of {len(steps)}", step=number)
                    raise
        except TimeIsUpError:
            raise limit.error([f"{len(found)} of {len(steps)} steps"]) from None
    return _join(robot, found, now)


def certify_steps(
    robot: Robot, scene: Scene, steps: Sequence[Step], trajectory: Trajectory, ends_s: Sequence[float], **options: Any
) -> Certificate:
    """Certify a motion of several steps, from any source.

    Args:
        robot: The arm.
        scene: The scene before the first step.
        steps: The steps.
        trajectory: The whole motion.
        ends_s: End of each step, as `[phase.end_s for phase in result.phases]`; the arm rests there [s].
        options: Tracking error and further options of `certify`.

    Raises:
        InputError: `ends_s` are not increasing times of samples, one for each step.
        HplanError: As `certify`.
    """
    steps = list_of("steps", steps, Step, "steps")
    ends = numbers("ends_s", ends_s, (len(steps),))
    rows = np.searchsorted(trajectory.time, ends - 1e-9)
    if rows[-1:] != trajectory.samples - 1 or (np.diff(rows, prepend=0) <= 0).any():
        raise InputError("ends_s: expected increasing times of samples, the last one at the end of the motion")
    parts, now, before = list[Certificate](), with_fixed_axis(robot, scene), None
    for step, (first, last) in zip(steps, pairwise([0, *rows.tolist()]), strict=True):
        part = trajectory.cut_after(last).cut_before(first)
        parts.append(_certify_step(robot, now, before, step, part, options))
        now, before = _after(robot, now, step, part.position[-1]), step
    return all_of(parts)


def _certify_step(
    robot: Robot, scene: Scene, before: Step | None, step: Step, part: Trajectory, options: Mapping[str, Any]
) -> Certificate:
    """Certify the motion of a step as one that leaves contacts, or in reverse."""
    q, end = part.position[0], part.position[-1]
    forward = _task(scene, q, _joints(end), None if before is None or before.change is None else before.contact_depth)
    found = certify(robot, forward, part, **options)
    if found.verified or step.change is None:
        return found
    back = _task(scene, end, _joints(q), step.contact_depth)
    return certify(robot, back, part.reversal, **options).reversal


def _plan_step(robot: Robot, scene: Scene, before: Step | None, step: Step, options: PlanOptions) -> StepMotion:
    """Plan the motion of a step from the scene's start."""
    leaves = scene.start.contact_depth if before is None or before.change is None else before.contact_depth
    forward = scene.copy_unchecked({"goal": step.goal, "start": _leaving(scene.start, leaves)})
    try:
        found = plan(robot, forward, options) if step.change is None else plan_if_free(robot, forward, options)
        return StepMotion(step, found.scene, found.trajectory, found.certificate, False)
    except (ConfigurationInCollisionError, BlockedError) as error:
        at_start = isinstance(error, ConfigurationInCollisionError) and error.which != "goal"
        if step.change is None or at_start:
            raise
        failure: HplanError = error
    start = holding(robot, scene.attached).joints_of(scene.start, "start")
    for end in _ends(robot, scene, step.goal, start):
        try:
            back = plan(robot, _task(scene, end, _joints(start), step.contact_depth), options)
        except (ConfigurationInCollisionError, BlockedError, NotFoundError) as error:
            if isinstance(error, ConfigurationInCollisionError) and error.which == "goal":
                error.add("a step that begins in contact cannot end in contact: lift the object in a step between")
            failure = error
            continue
        motion = back.motion.reversal
        return StepMotion(step, back.scene, motion.trajectory, motion.certificate, True)
    raise failure


def _ends(robot: Robot, scene: Scene, goal: Goal, start: FloatArray) -> Iterator[FloatArray]:
    """Configurations at a goal, obstacles ignored."""
    joints = robot.joints_of(goal, "goal", scene.start)
    if joints is not None:
        yield np.asarray(robot.about(start).turned_near(joints, start))
    elif goal.pose is not None:
        found = inverse_kinematics(robot, goal.pose, start=start, frame=goal.frame, locked=scene.locked_joints)
        yield from found[:_MOST_ENDS]


def _task(scene: Scene, start: FloatArray, goal: Goal, contact_depth: float | None) -> Scene:
    """The scene with other ends."""
    begin = Start(joints_rad=tuple(start.tolist()), contact_depth=contact_depth)
    return scene.copy_unchecked({"start": begin, "goal": goal})


def _leaving(start: Start, contact_depth: float | None) -> Start:
    return start if start.contact_depth == contact_depth else start.with_values(contact_depth=contact_depth)


def _joints(q: FloatArray) -> Goal:
    return Goal(joints_rad=tuple(q.tolist()))


def _after(robot: Robot, scene: Scene, step: Step, q: FloatArray) -> Scene:
    """The scene after a step, starting where it ended.

    Raises:
        InputError: The step picks what is not there, or puts what is not held.
        SceneError: The object cannot be held.
    """
    now = scene.copy_unchecked({"start": Start(joints_rad=tuple(q.tolist())), "goal": _joints(q)})
    if step.pick is not None:
        return now.pick_up(step.pick, robot.forward_kinematics(q, step.frame), **step.held)
    if step.put is not None:
        frames = {item.name: item.frame for item in scene.attached}
        return now.put_down(step.put, robot.forward_kinematics(q, frames.get(step.put)))
    return now


def _join(robot: Robot, motions: Sequence[StepMotion], scene: Scene) -> StepsResult:
    ends = [0.0, *accumulate(motion.trajectory.duration for motion in motions)]
    phases = (Phase(f"step {number + 1}", *span) for number, span in enumerate(pairwise(ends)))
    return StepsResult(
        robot=instance("robot", robot, Robot),
        motions=tuple(motions),
        trajectory=join_trajectories([motion.trajectory for motion in motions]),
        certificate=all_of([motion.certificate for motion in motions]),
        phases=tuple(phases),
        scene=scene,
    )
