"""Running motions to a fruit that is another one by now: contact is allowed with the very fruit alone."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from arm_variants import coal_distances
from planned import fruit, post, task

from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.plan import PlanResult, plan
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.model import Fruit, Goal
from hplan.scene.obstacles import Box, Sphere
from hplan.trajectory.trajectory import Trajectory

APPLE = fruit("apple", 20.0, 1.5, 1.4)
SCENE = task((-20.0, 45.0, 45.0, 30.0), Goal(fruit="apple"), [post("post", 0.0, 1.2, 0.0, 0.9)], fruits=(APPLE,))


@functools.cache
def picking(robot: Robot) -> PlanResult:
    return plan(robot, SCENE)


def a_planner(robot: Robot) -> Planner:
    """One whose motion to the apple runs."""
    planner = Planner(robot, SCENE)
    planner.last = picking(robot)
    return planner


def in_the_hand(robot: Robot, trajectory: Trajectory, time_s: float) -> tuple[float, float, float]:
    """The middle of the last link at a time."""
    q = trajectory.positions(np.array([time_s]))[0]
    points, (origin, axes) = robot.arm.joint_points(q[robot.arm_slice]), robot.plane_at(robot.yaw_of(q))
    x, y, z = (origin + 0.5 * (points[-1] + points[-2]) @ axes[:2]).tolist()
    return x, y, z


def without_apple(planner: Planner) -> None:
    running = planner.last.trajectory
    planner.aim(goal=Goal(joints_rad=tuple(running.position[-1].tolist())))
    planner.remove("apple")


def test_a_fruit_seen_elsewhere_is_an_obstacle(robot: Robot) -> None:
    planner = a_planner(robot)
    at_s = picking(robot).certificate.contact_s[0]
    moved = APPLE.model_copy(update={"center": in_the_hand(robot, picking(robot).trajectory, at_s + 0.05)})
    planner.scene = planner.scene.model_copy(update={"fruits": (moved,)})
    stop = planner.stop_at(at_s + 0.02, now=at_s)
    assert not stop.certificate.verified
    assert not certify(robot, planner.scene, stop.trajectory, check_ends=False).verified
    with pytest.raises(HplanError):
        planner.replan(at=at_s + 0.02, now=at_s)


def test_an_obstacle_of_the_fruits_name_is_an_obstacle(robot: Robot) -> None:
    planner = a_planner(robot)
    at_s = picking(robot).certificate.contact_s[0]
    without_apple(planner)
    planner.add(Sphere(name="apple", center=in_the_hand(robot, picking(robot).trajectory, at_s + 0.05), radius=0.1))
    assert not planner.stop_at(at_s + 0.02, now=at_s).certificate.verified


def test_what_stands_in_the_base_is_said_of_stops_too(robot: Robot) -> None:
    scene = load_scene("table-1")
    planner = Planner(robot, scene)
    planner.plan()
    planner.add(Box(name="inside", center=(0.0, 0.0, 0.3), size=(0.05, 0.05, 0.1)))
    stop = planner.stop_at(0.5, now=0.3)
    again = certify(robot, planner.scene, stop.trajectory, check_ends=False)
    assert not stop.certificate.verified
    assert stop.certificate.violations == again.violations
    assert "'inside'" in stop.certificate.violations[0]


@pytest.mark.parametrize("seed", range(40))
def test_random_stops_among_changed_fruit_are_clear(robot: Robot, seed: int) -> None:
    """What is certified touches no fruit but the one that the motion goes to, looked at by coal alone every 0.5 ms."""
    random = np.random.default_rng(seed)
    planner, running = a_planner(robot), picking(robot)
    motion, contact_s = running.trajectory, running.certificate.contact_s
    at_s = random.uniform(contact_s[0] - 0.1, motion.duration)
    kind = seed % 4
    ball: Fruit | Sphere = APPLE
    if kind == 1:  # a little beside where it was
        ball = APPLE.model_copy(update={"center": tuple(np.add(APPLE.center, random.normal(0.0, 0.03, 3)).tolist())})
    elif kind == 2:  # anywhere about the last link
        near = np.array(in_the_hand(robot, motion, random.uniform(at_s, motion.duration)))
        ball = APPLE.model_copy(update={"center": tuple((near + random.normal(0.0, 0.15, 3)).tolist())})
    elif kind == 3:
        without_apple(planner)
        ball = Sphere(name="apple", center=tuple((APPLE.center + random.normal(0.0, 0.1, 3)).tolist()), radius=0.05)
        planner.add(ball)
    if kind in (1, 2):
        planner.scene = planner.scene.model_copy(update={"fruits": (ball,)})
    stop = planner.stop_at(min(at_s + 0.02, motion.duration), now=at_s)
    if kind == 0:
        assert stop.certificate.verified, stop.certificate.violations
        return
    among = SCENE.with_obstacles([Sphere(name="ball", center=ball.center, radius=ball.radius)])
    row = int(np.searchsorted(stop.trajectory.time, at_s + 1e-9)) - 1
    left = stop.trajectory.since(row)
    # The tool stands out of the last link's capsule by nothing: links are all there is.
    clock = np.append(np.arange(0.0, left.duration, 5e-4), left.duration)
    least = min(float(coal_distances(robot, q, among.obstacles).min()) for q in left.positions(clock))
    assert stop.certificate.verified == (least > 0.0) or abs(least) < 1e-3


@pytest.mark.parametrize("name", ["orchard-row", "tour", "dense-canopy"])
def test_plan_and_certify_tell_one_window(robot: Robot, name: str) -> None:
    scene = load_scene(name)
    result = plan(robot, scene)
    found = certify(robot, scene, result.trajectory)
    assert found.contact_s == result.certificate.contact_s == tuple(result.report["certificate"]["contact_s"])
    assert found.contact_s[0] <= result.phases[-2].start_s


def test_a_splice_tells_the_window_of_its_new_motion(robot: Robot) -> None:
    planner = a_planner(robot)
    kept = planner.replan(at=0.3, now=0.2)
    assert kept.is_kept
    near = APPLE.model_copy(update={"center": fruit("apple", 20.0, 1.5, 1.42).center})
    planner.scene = planner.scene.model_copy(update={"fruits": (near,)})
    new = planner.replan(at=0.4, now=0.3)
    assert not new.is_kept
    for result in (kept, new):
        again = certify(robot, result.scene, result.trajectory)
        assert again.verified
        assert again.contact_s == pytest.approx(result.certificate.contact_s, abs=1e-9)
