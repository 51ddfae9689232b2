"""Certificates of stops and other timings: by the path's clearance, or shown anew."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fitted_arms import quintic, scene_of
from planned import assert_clear, between_rows, fruit, post, task

from hplan.certificate.certificate import certify
from hplan.certificate.digests import trajectory_digest
from hplan.certificate.retimed_certificate import certified_retiming
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.file import load_scene
from hplan.scene.model import Goal
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import scaled, stopped

STILL = TrackingModel(0.0, 0.0)


@cache
def picking() -> PlanResult:
    """A pick: transit, approach and retreat."""
    apple = fruit("apple", 20.0, 1.5, 1.4)
    scene = task((-20.0, 45.0, 45.0, 30.0), Goal(fruit="apple"), [post("post", 0.0, 1.2, 0.0, 0.9)], fruits=(apple,))
    return plan(load_robot(), scene)


@cache
def reference() -> PlanResult:
    return plan(load_robot(), load_scene())


@pytest.mark.parametrize("part", np.linspace(0.0, 1.0, 6))
def test_stops_are_certified_without_a_look_and_clear(robot, part):
    result = reference()
    scene = result.motion.task.scene
    found = result.stop_at(part * result.trajectory.duration)
    assert found.certificate.verified
    assert found.certificate.checks in (0, result.certificate.checks)
    assert found.certificate.digests.trajectory == trajectory_digest(found.trajectory)
    again = certify(robot, scene, found.trajectory, check_ends=False)
    assert again.verified
    looked_at = between_rows(found.trajectory, np.arange(found.trajectory.samples), 1)
    assert_clear(robot, scene, looked_at)


def test_the_clearance_is_less_by_what_the_arm_is_off_the_path():
    result = reference()
    found = result.stop_at(0.5)
    assert found.off_path_m > 0.0
    less = result.certificate.min_clearance_m - found.certificate.min_clearance_m
    assert 0.0 < less <= 2.0 * found.off_path_m


@pytest.mark.parametrize("part", np.linspace(0.0, 1.0, 6))
def test_stops_in_a_pick(part):
    """On the approach too, where the last link may touch the fruit."""
    result = picking()
    found = result.stop_at(part * result.trajectory.duration)
    assert found.certificate.verified, found.certificate.violations
    anew = certified_retiming(
        load_robot(), result.motion.task.scene, result.certificate,
        stopped(result.trajectory, part * result.trajectory.duration, load_robot()),
        tracking=STILL, sigmas=3.0, anew=True,
    )  # fmt: skip
    assert anew.certificate.verified, anew.certificate.violations


def test_where_the_clearance_does_not_suffice_it_is_shown_anew(robot):
    result = reference()
    scene = result.motion.task.scene
    tight = replace(result.certificate, min_clearance_m=1e-6)
    retimed = stopped(result.trajectory, 0.6, robot)
    found = certified_retiming(robot, scene, tight, retimed, tracking=STILL, sigmas=3.0)
    assert found.certificate.verified
    assert found.certificate.checks > tight.checks


def test_what_is_not_clear_is_not_certified(robot):
    """An obstacle on the path, and a certificate that does not hold."""
    result = reference()
    scene = result.motion.task.scene
    tool = robot.tool_positions(result.trajectory.position[[100]])[0]
    blocked = scene.with_obstacles([*scene.obstacles, Sphere(name="late", center=tuple(tool.tolist()), radius=0.05)])
    unknown = replace(result.certificate, verified=False)
    retimed = stopped(result.trajectory, result.trajectory.time[150], robot)
    found = certified_retiming(robot, blocked, unknown, retimed, tracking=STILL, sigmas=3.0)
    assert not found.certificate.verified
    assert any("late" in violation for violation in found.certificate.violations)


def test_other_speeds_are_certified(robot):
    result = picking()
    found = result.scaled([(0.0, 1.0), (0.4, 1.0), (0.4, 0.3)])
    assert found.certificate.verified
    assert found.parts_s == pytest.approx(0.396)
    scene = result.motion.task.scene
    assert certify(robot, scene, found.trajectory).verified


def test_faster_with_tracking_errors_that_grow_with_speed(robot):
    """At another speed the arm may be farther from the path than the path's certificate allows for."""
    scene, tracking = load_scene(), TrackingModel(1e-3, 0.02)
    options = PlanOptions(speed=0.5, tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s)
    result = plan(robot, scene, options)
    faster = scaled(result.trajectory, [(0.0, 1.0), (0.008, 1.0), (0.008, 1.5)], robot)
    found = certified_retiming(robot, scene, result.certificate, faster, tracking=tracking, sigmas=3.0)
    anew = certify(robot, scene, faster.trajectory, tracking_error=1e-3, tracking_delay_s=0.02)
    assert not anew.verified
    assert not found.certificate.verified
    assert found.certificate.min_clearance_m <= anew.min_clearance_m + 1e-4


def test_an_obstacle_that_comes_into_the_base_only_while_the_slower_motion_runs(robot):
    start, goal = (0.0, 45.0, 45.0, 45.0), (60.0, 30.0, 50.0, 40.0)
    comes = Track(times_s=(0.0, 8.0), shifts_m=((0.0, 0.0, 0.0), (3.0, 0.0, 0.0)))
    crate = Box(name="crate", center=(-3.0, 0.0, 0.1), size=(0.2, 0.2, 0.2), track=comes)
    scene, motion = scene_of(start, goal, [crate]), quintic(robot, start, goal, duration=3.0)
    running = certify(robot, scene, motion)
    assert running.verified
    found = certified_retiming(robot, scene, running, scaled(motion, 0.35, robot), tracking=STILL, sigmas=3.0)
    assert not found.certificate.verified
    assert found.certificate.clear_until_s is None
    assert any("'crate' comes into the robot's" in violation for violation in found.certificate.violations)
