"""Splices and stops among moving obstacles: certified in time, clear by coal, clocks."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planned import assert_clear, between_rows, task
from spliced import FIELDS, assert_goes_on
from studies.outside import contacts

from hplan.certificate.certificate import certify
from hplan.errors import ObstacleInTimeError, RunningMotionBlockedError
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.planar.family_reader import family_of
from hplan.planning.in_time import stopping_first
from hplan.planning.motion import Plan
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan, solver
from hplan.planning.problem import Problem
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory

START, GOAL, BACK = (0.0, 0.0, 0.0, 0.0), (0.0, 45.0, 60.0, 70.0), (0.0, 20.0, 0.0, 10.0)
PLANAR = {"locked_joints": ("base_yaw",)}


def tool_at(robot: Robot, trajectory: Trajectory, part: float) -> np.ndarray:
    """Position of the tool at a fraction of a motion."""
    return robot.tool_positions(trajectory.positions(np.array([part * trajectory.duration])))[0]


def crossing(center: np.ndarray, at_s: float, *, speed: float = 1.0, far: float = 1.5, radius: float = 0.1) -> Sphere:
    """A ball that crosses the arm's plane at a time."""
    away = far / speed
    track = Track(times_s=(at_s - away, at_s + away), shifts_m=((0.0, -far, 0.0), (0.0, far, 0.0)))
    return Sphere(name="ball", center=tuple(center.tolist()), radius=radius, track=track)


def coming(center: np.ndarray, at_s: float, *, speed: float = 1.0, radius: float = 0.1) -> Sphere:
    """A ball that comes into the arm's plane and stays."""
    track = Track(times_s=(at_s - 1.5 / speed, at_s), shifts_m=((0.0, -1.5, 0.0), (0.0, 0.0, 0.0)))
    return Sphere(name="ball", center=tuple(center.tolist()), radius=radius, track=track)


def a_planner(robot: Robot, *obstacles: Sphere, **options: object) -> Planner:
    """A planner whose motion is clear at first."""
    planner = Planner(robot, task(START, GOAL, obstacles, **PLANAR), PlanOptions(**options))
    assert planner.plan().certificate.verified
    return planner


def assert_spliced(robot: Robot, before: PlanResult, scene: Scene, planner: Planner, result: SplicedResult) -> None:
    """Check a splice: unchanged up to the seam, continuous, certified, clear by coal.

    The scene is unchanged.

    Args:
        robot: The arm.
        before: The running motion.
        scene: The planner's scene at that time.
        planner: The planner.
        result: The spliced motion.
    """
    motion = result.trajectory
    assert_goes_on(before, result)
    assert result.certificate.verified
    assert certify(robot, result.scene, motion).verified
    # By the controller's clock it is the same.
    started = scene.model_copy(update={"start": result.scene.start})
    assert certify(robot, started, motion, begin_s=result.begins_s).verified
    assert not any(contacts(robot, result.scene, motion))
    assert not motion.velocity[-1].any()
    assert planner.last is result
    assert planner.scene.start == scene.start
    assert planner.scene is scene
    clock = np.linspace(-1.0, 3.0, 9)
    seen = result.scene.poses_at(clock)
    for name, poses in scene.poses_at(clock + result.begins_s).items():
        for one, other in zip(poses, seen[name], strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)


@functools.cache
def among_a_ball(robot: Robot) -> tuple[Scene, Trajectory]:
    """A motion past a ball that crosses."""
    running = a_planner(robot).last.trajectory
    scene = task(START, GOAL, [crossing(tool_at(robot, running, 0.6), 0.4 * running.duration)], **PLANAR)
    return scene, plan(robot, scene).trajectory


@given(st.floats(0.0, 1.0))
def test_what_is_left_of_a_motion_has_one_certificate_by_either_clock(robot, part):
    scene, motion = among_a_ball(robot)
    row = round(part * (motion.samples - 1))
    begin_s, left = float(motion.time[row]), motion.cut_before(row)
    how = {"check_ends": False, "rest_to_rest": False}
    by_old = certify(robot, scene, left, begin_s=begin_s, **how)
    by_new = certify(robot, scene.starting_at(begin_s), left, **how)
    assert by_old.verified
    assert by_new.verified
    assert by_new.min_clearance_m == pytest.approx(by_old.min_clearance_m, abs=1e-9)
    assert by_new.clear_until_s == by_old.clear_until_s == math.inf
    if by_old.nearest_s is not None:
        assert by_new.nearest_s == pytest.approx(by_old.nearest_s - begin_s, abs=1e-9)


@pytest.mark.parametrize("effort", ["quick", "default"])
def test_around_or_behind_a_ball_that_crosses(robot, effort):
    planner = a_planner(robot, effort=effort)
    before, running = planner.last, planner.last.trajectory
    planner.add(crossing(tool_at(robot, running, 0.6), 0.6 * running.duration))
    scene = planner.scene
    assert not certify(robot, scene, running).verified
    result = planner.replan(at=0.15, now=0.1)
    assert not result.is_kept
    assert_spliced(robot, before, scene, planner, result)
    # And on, by the same clock.
    planner.aim(goal=Goal(joints_deg=BACK))
    again_in = planner.scene
    again = planner.replan(at=0.3, now=0.2)
    assert_spliced(robot, result, again_in, planner, again)
    assert again.certificate.nearest_s is None or -1e-9 <= again.certificate.nearest_s <= again.trajectory.duration


def test_motion_certified_in_time_is_kept(robot):
    """The ball crosses the path, and not when the arm is there."""
    planner = a_planner(robot)
    before, running = planner.last, planner.last.trajectory
    planner.add(crossing(tool_at(robot, running, 0.8), -0.3, speed=1.0))
    scene = planner.scene
    result = planner.replan(at=0.3, now=0.2)
    assert result.is_kept
    assert_spliced(robot, before, scene, planner, result)
    whole = certify(robot, scene, running)
    assert result.certificate.clear_until_s == whole.clear_until_s == math.inf


def test_rest_time_is_on_clock_of_running_motion(robot):
    planner = a_planner(robot)
    running = planner.last.trajectory
    planner.add(coming(tool_at(robot, running, 1.0), running.duration + 1.0))
    until = certify(robot, planner.scene, running).clear_until_s
    assert running.duration < until < running.duration + 1.0
    kept = planner.replan(at=0.3, now=0.2)
    assert kept.is_kept
    assert kept.certificate.clear_until_s == pytest.approx(until - kept.begins_s, abs=1e-9)
    stop = planner.stop_at(kept.begins_s + kept.trajectory.duration)
    assert stop.begins_s == kept.begins_s
    assert stop.certificate.clear_until_s == pytest.approx(until - kept.begins_s, abs=1e-9)


def test_stops_of_the_running_motion_are_certified_in_time(robot):
    planner = a_planner(robot)
    running = planner.last.trajectory
    at_s, middle = 0.5 * running.duration, tool_at(robot, running, 0.5)
    planner.add(crossing(middle, at_s))
    found = planner.stop_at(0.05)
    assert found.certificate.verified
    assert found.certificate.nearest_s is not None
    assert not any(contacts(robot, planner.scene, found.trajectory))
    # Too late it is hit, though from then on the place itself is clear.
    late = planner.stop_at(at_s)
    assert not late.certificate.verified
    assert late.certificate.clear_until_s is None
    # After the ball has passed the arm may stop.
    planner.move("ball", track=crossing(middle, -0.5).track)
    assert planner.stop_at(at_s).certificate.verified


def test_stop_reports_time_of_later_contact(robot):
    planner = a_planner(robot)
    running = planner.last.trajectory
    stop = planner.stop_at(0.1)
    comes_s = stop.trajectory.duration + 1.5
    planner.add(coming(tool_at(robot, stop.trajectory, 1.0), comes_s))
    found = planner.stop_at(0.1)
    assert found.certificate.verified
    assert running.duration < comes_s
    assert found.trajectory.duration < found.certificate.clear_until_s < comes_s


def test_obstacle_before_seam_gives_stop(robot):
    planner = a_planner(robot)
    running = planner.last.trajectory
    hit_s = 0.5 * running.duration
    planner.add(crossing(tool_at(robot, running, 0.5), hit_s, speed=2.0))
    last, scene = planner.last, planner.scene
    with pytest.raises(RunningMotionBlockedError, match=r"ball.*the arm can stop on its path") as caught:
        planner.replan(at=hit_s + 0.1, now=0.05)
    stop, begins_s = caught.value.stop, caught.value.begins_s
    assert begins_s == pytest.approx(0.048)
    assert caught.value.certificate.verified
    np.testing.assert_array_equal(stop.position[0], running.position[12])
    assert not any(contacts(robot, scene.starting_at(begins_s), stop))
    assert planner.last is last
    assert planner.scene is scene
    with pytest.raises(RunningMotionBlockedError, match="no stop on its path") as caught:
        planner.replan(at=hit_s, now=hit_s - 0.03)
    assert caught.value.stop is None


def test_state_without_escape_is_reported(robot):
    """It is clear up to the seam, and then collides with every motion."""
    planner = a_planner(robot)
    running = planner.last.trajectory
    q = running.positions(np.array([0.5 * running.duration]))[0]
    elbow = (
        family_of(robot).arm.joint_points(q[family_of(robot).arm_slice])[1] @ family_of(robot).plane_at(0.0)[1][:2]
        + family_of(robot).plane_at(0.0)[0]
    )
    planner.add(crossing(elbow, 0.5 * running.duration, speed=20.0, radius=0.5))
    seam_s = 0.5 * running.duration - 0.06
    with pytest.raises(RunningMotionBlockedError) as caught:
        planner.replan(at=seam_s, now=seam_s - 0.004)
    assert not caught.value.certificate.verified


def test_moving_obstacles_are_at_their_place_after_stop(robot, monkeypatch):
    planner = a_planner(robot)
    running = planner.last.trajectory
    row = running.samples // 5
    stop = planner.stop_at(float(running.time[row])).trajectory.cut_before(row)
    state = {"velocity_rad_s": tuple(running.velocity[row]), "acceleration_rad_s2": tuple(running.acceleration[row])}
    start = Start(joints_rad=tuple(running.position[row]), **state)
    ball = crossing(tool_at(robot, running, 0.6), 8.0, speed=0.15)
    scene, seen = task(START, GOAL, [ball], **PLANAR).model_copy(update={"start": start}), list[Scene]()

    options = PlanOptions(effort="quick")

    def solve(problem: Problem) -> Iterator[Plan]:
        seen.append(problem.scene)
        return solver()(problem)

    problem = Problem.from_scene(robot, scene, options)
    found = stopping_first(problem, solve, stop)
    assert found is not None
    assert found.run is not None
    assert found.run[2].verified
    assert found.told["in_time"]["stops_until_s"] == stop.duration > 0.1
    for one, other in zip(seen[0].poses_at([0.5])["ball"], scene.poses_at([stop.duration + 0.5])["ball"], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_arm_stops_and_waits_for_blocking_obstacle(robot):
    """A start in motion before a gap that opens later: no motion goes on, a stop does, and then the way."""
    start = a_planner(robot).last.trajectory
    row = start.samples // 5
    state = Start(
        joints_rad=tuple(start.position[row].tolist()),
        velocity_rad_s=tuple(start.velocity[row].tolist()),
        acceleration_rad_s2=tuple(start.acceleration[row].tolist()),
    )
    q = np.radians(GOAL)
    balls = [
        Sphere(
            name=f"ball {i}",
            center=tuple(robot.tool_positions(part * q).tolist()),
            radius=0.25,
            track=Track(times_s=(2.0, 2.5), shifts_m=((0.0, 0.0, 0.0), (0.0, 4.0, 0.0))),
        )
        for i, part in enumerate((0.65, 0.8, 0.95))
    ]
    scene = task(START, GOAL, balls, **PLANAR).model_copy(update={"start": state})
    result = plan(robot, scene)
    assert result.certificate.verified
    assert certify(robot, scene, result.trajectory).verified
    assert not any(contacts(robot, scene, result.trajectory))
    np.testing.assert_array_equal(result.trajectory.velocity[0], start.velocity[row])
    assert result.trajectory.duration > 2.0
    assert result.phases[0].start_s == 0.0
    assert result.phases[-1].end_s == pytest.approx(result.trajectory.duration)
    assert result.report["in_time"]["clear_until_s"] == result.certificate.clear_until_s


def test_permanent_obstacle_is_named(robot):
    planner = a_planner(robot)
    running = planner.last.trajectory
    planner.add(coming(tool_at(robot, running, 1.0), 0.5 * running.duration, speed=4.0, radius=0.3))
    with pytest.raises(ObstacleInTimeError) as caught:
        planner.replan(at=0.1, now=0.05)
    assert caught.value.obstacle == "ball"
    assert planner.stop_at(0.1, now=0.05).certificate.verified


def test_base_creeps_on_while_a_new_goal_comes(robot):
    creep = Track(times_s=(0.0, 10.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)))
    away = Sphere(name="away", center=(1.2, 1.2, 1.5), radius=0.2)
    planner = Planner(robot, task(START, GOAL, [away], base_track=creep, **PLANAR))
    running = planner.plan().trajectory
    planner.aim(goal=Goal(joints_deg=BACK))
    scene = planner.scene
    result = planner.replan(at=0.3, now=0.2)
    assert result.scene.base_track.times_s[0] == pytest.approx(-result.begins_s)
    assert certify(
        robot, scene.model_copy(update={"start": result.scene.start}), result.trajectory, begin_s=0.2
    ).verified
    assert result.certificate.verified
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(result.trajectory, field)[:25], getattr(running, field)[50:75])
    still = result.scene.snapshot(result.trajectory.duration)
    assert_clear(robot, still, between_rows(result.trajectory, np.array([result.trajectory.samples - 1]), 0))
