"""Warm-up: load the compiled kernels before the first deadline.

They are the kernels of planning, clouds, replanning and stops.
"""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track

#: Number of sampled pairs of configurations, and maximum number of pairs tried until a motion is found.
_DRAWN, _PAIRS = 200, 16

#: Maximum displacement of each joint [rad, m].
_LARGEST_STEP: Final = 0.6

#: Maximum radius of the fruit and of the dummy obstacles; smaller if the motion is short [m].
_RADIUS: Final = 0.03

#: Number, relative distance from the base (of the tool's) and spread [m] of the dummy obstacles off the path.
_MANY, _FAR, _SPREAD = 60, 1.5, 0.1


class NotReadyWarning(UserWarning):
    """Kernels could not be preloaded; the first plan loads them."""


def warm_up(robot: Robot) -> None:
    """Load a robot's kernels so that the first plan meets its deadline.

    A small scene is derived from the robot. In it, motions are planned past static and moving balls to joint values, a
    fruit and a pose; a camera cloud is set; a running motion is replanned and stopped. Kernels that are not in the disk
    cache are compiled, which takes a minute (`hplan warmup` does this in advance); otherwise the call takes one to
    three seconds.

    All objects that exist at the end of the call, including the program's own, are excluded from later garbage
    collections (`gc.freeze`). A collection then takes a millisecond instead of a tenth of a second. Therefore call it
    early, after the imports.

    Args:
        robot: The robot to plan for; data that are computed once for each robot are cached with this object.

    Warns:
        NotReadyWarning: No motion was found between sampled neighbouring configurations.

    Raises:
        OptionError: `robot` is not a `Robot`.
    """
    instance("robot", robot, Robot, "load_robot")
    if not any(_is_done(robot, *pair, blocked) for blocked in (True, False) for pair in _pairs(robot)):
        warnings.warn(f"the warm-up found no motion of {robot.name!r}", NotReadyWarning, stacklevel=2)
    gc.collect()
    gc.freeze()


def _pairs(robot: Robot) -> list[tuple[FloatArray, FloatArray]]:
    """Sampled pairs of neighbouring configurations without self-collision, with a fixed seed."""
    low, high = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    begins = low + np.random.default_rng(0).uniform(0.05, 0.95, (_DRAWN, robot.dof)) * (high - low)
    begins[0] = 0.5 * (low + high)
    goals = begins + np.clip(np.roll(begins, -1, axis=0) - begins, -_LARGEST_STEP, _LARGEST_STEP)
    field = ClearanceField.build(robot, ())
    clear = np.minimum(field.spare_clearances(begins), field.spare_clearances(goals)) > 0.0
    return list(zip(begins[clear], goals[clear], strict=True))[:_PAIRS]


def _is_done(robot: Robot, start: FloatArray, goal: FloatArray, blocked: bool) -> bool:
    """Plan, replan and stop a motion; False if none is found.

    Args:
        robot: The robot.
        start: (dof,) start configuration.
        goal: (dof,) goal configuration.
        blocked: Whether a ball blocks the straight motion.
    """
    rng = np.random.default_rng(0)
    begin, middle, end = robot.tool_positions([start, 0.5 * (start + goal), goal])
    radius = min(_RADIUS, 0.3 * float(min(np.linalg.norm(middle - begin), np.linalg.norm(middle - end))))
    if radius <= 0.0:
        return False
    scene = Scene(
        name="warm-up",
        start=Start(joints_rad=tuple(start.tolist())),
        goal=Goal(joints_rad=tuple(goal.tolist())),
        obstacles=tuple(
            Sphere(name=f"ball {number}", center=tuple(center.tolist()), radius=radius)
            for number, center in enumerate([middle, *(_FAR * middle + rng.normal(0.0, _SPREAD, (_MANY, 3)))])
        ),
    )
    among = scene if blocked else scene.with_obstacles(())
    planner = Planner(robot, among)
    try:
        trajectory = planner.plan(begins_s=0.0).trajectory
    except HplanError:
        return False
    for changes, options in _other_tasks(robot, scene, Fruit(name="fruit", center=tuple(end.tolist()), radius=radius)):
        with suppress(HplanError):  # kernels called before the error are loaded
            Planner(robot, scene.copy_unchecked(changes), options).plan()
    seconds = trajectory.duration
    points = rng.normal(robot.tool_positions(trajectory.state_at(0.7 * seconds)[0]), radius, (2000, 3))
    with suppress(HplanError):
        for time_s in (0.0, 0.1 * seconds):
            joints = trajectory.state_at(time_s)[0]
            planner.set_cloud("seen", points, radius=0.3 * radius, joints=joints, keep_s=seconds, time_s=time_s)
        planner.replan(at=0.3 * seconds, now=0.1 * seconds)
    with suppress(HplanError):
        planner.stop_at(0.4 * seconds, now=0.2 * seconds)
    with suppress(HplanError):  # back along the motion
        planner = Planner(robot, among, PlanOptions(effort="quick", at_once=True))
        seconds = planner.plan(begins_s=0.0).trajectory.duration
        planner.aim(goal=Goal(joints_rad=scene.start.joints_rad))
        planner.replan(at=seconds)
    return True


def _other_tasks(robot: Robot, scene: Scene, fruit: Fruit) -> Iterator[tuple[dict[str, Any], PlanOptions]]:
    """Other kinds of tasks: changes of the scene, and options."""
    # A plan with a deadline calls additional kernels; this deadline leaves time to compile all of them [s].
    usual = PlanOptions(deadline_s=600.0)
    ball, *others = scene.obstacles
    track = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, fruit.radius), (0.0, 0.0, 0.0)))
    yield {"obstacles": ()}, usual
    yield {"obstacles": (ball.copy_unchecked({"track": track}), *others)}, usual
    yield {"fruits": (fruit,), "goal": Goal(fruit=fruit.name)}, usual
    yield {}, PlanOptions(tracking_error=1e-4, tracking_delay_s=1e-4, effort="best")
    pose = pin.SE3ToXYZQUAT(pin.SE3(robot.forward_kinematics(scene.goal.configuration))).tolist()
    yield {"goal": Goal(position=tuple(pose[:3]), quaternion_xyzw=tuple(pose[3:]))}, usual
    goal = (scene.start.configuration[0], *scene.goal.configuration[1:])
    yield {"goal": Goal(joints_rad=goal), "locked_joints": robot.joint_names[:1]}, usual
