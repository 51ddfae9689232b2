"""Contact with the goal's fruit: last link, straight approach, stops, retiming."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fitted_arms import quintic, scene_of
from planned import assert_clear, between_rows, fruit, post, task

import hplan
from hplan.base.data_files import scenes_dir
from hplan.certificate.certificate import certify, stretches
from hplan.certificate.digests import trajectory_digest
from hplan.certificate.goal_contact import OFFSET, THERE, TURN, FruitContact, contact_window
from hplan.certificate.retimed_certificate import certified_retiming
from hplan.planar.family_reader import family_of
from hplan.planar.inverse_kinematics import reach
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory, join_trajectories, read_csv, scale_motion, stop_motion, write_csv

GRASP = np.radians([0.0, 20.0, 20.0, 20.0])


@pytest.fixture(scope="module")
def apple(robot):
    """A fruit at the tool's position at `GRASP`."""
    return Fruit(name="apple", center=tuple(robot.tool_positions(GRASP).tolist()), radius=0.04)


@pytest.fixture(scope="module")
def picked(robot, apple):
    """A plan to the fruit and its scene."""
    scene = orchard(apple, np.radians([-40.0, 30.0, 40.0, 30.0]))
    return scene, hplan.plan(robot, scene)


def orchard(fruit, start, **changes):
    return Scene(
        name="one apple", start=Start(joints_rad=tuple(start)), goal=Goal(fruit="apple"), fruits=(fruit,), **changes
    )


def through(robot, *configurations, seconds=4.0, rate=250):
    """A rest-to-rest motion along straight joint motions, one after the other."""
    parts = []
    for start, end in itertools.pairwise(configurations):
        time = np.linspace(0.0, seconds, round(seconds * rate) + 1)
        s = time[:, None] / seconds
        turn = np.asarray(end) - start
        q = start + turn * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v = turn * (30 * s**2 - 60 * s**3 + 30 * s**4) / seconds
        a = turn * (60 * s - 180 * s**2 + 120 * s**3) / seconds**2
        parts.append(Trajectory(robot.joint_names, time, q, v, a, robot.dynamics.torques(q, v, a)))
    return join_trajectories(parts)


def test_certify_verifies_exported_plan(robot, picked, tmp_path):
    scene, result = picked
    assert result.grasp.distance > 0.0
    again = read_csv(write_csv(result.trajectory, tmp_path / "t.csv"))
    certificate = certify(robot, scene, again)
    assert certificate.verified, certificate.violations
    begin, end = certificate.contact_s
    # At least approach and retreat; the end of the transit is straight, too.
    assert (begin, end) == pytest.approx(result.certificate.contact_s, abs=1e-12)
    assert begin <= result.phases[1].start_s < end == result.trajectory.duration
    assert result.phases[1].start_s - begin < 0.1
    # There the last link may be at the fruit, but the plan keeps it away until the stand-off.
    assert certificate.min_clearance_m >= 0.8 * result.certificate.min_clearance_m
    assert certificate.goal_contact == result.certificate.goal_contact == "approach"
    assert certificate.digests == result.certificate.digests


def test_forearm_through_the_fruit_is_refused(robot):
    """The yaw sweeps the forearm through it; to the scene it is the goal all the same."""
    start, end = np.radians([-30.0, 20.0, 20.0, 20.0]), np.radians([30.0, 20.0, 20.0, 20.0])
    elbow, wrist = (
        family_of(robot).plane_origin + family_of(robot).arm.joint_points(GRASP[1:])[k] @ family_of(robot).plane_axes
        for k in (1, 2)
    )
    fruit = Fruit(name="apple", center=tuple((0.5 * (elbow + wrist)).tolist()), radius=0.06)
    for ends in (True, False):
        certificate = certify(robot, orchard(fruit, start), through(robot, start, end), check_ends=ends)
        assert not certificate.verified
        assert any("'forearm'" in violation and "apple" in violation for violation in certificate.violations)
        assert certificate.contact_s is None


def test_last_link_sideways_through_the_fruit_is_refused(robot, apple):
    """By the yaw: past the fruit, and up to its centre."""
    for last in (20.0, 0.0):
        for wrist in (20.0, 5.0):
            q = np.radians([0.0, 20.0, 20.0, wrist])
            fruit = apple.model_copy(update={"center": tuple(robot.tool_positions(q).tolist())})
            start, end = q + np.radians([-20.0, 0, 0, 0]), q + np.radians([last, 0, 0, 0])
            certificate = certify(robot, orchard(fruit, start), through(robot, start, end))
            assert not certificate.verified
            assert "'hand'" in certificate.violations[-1]
            assert "apple" in certificate.violations[-1]
            assert certify(
                robot, orchard(fruit, start), through(robot, start, end), goal_contact="motion", check_ends=False
            ).verified


def test_deeper_than_to_the_centre_is_refused(robot, picked):
    """The approach goes on beyond the fruit's centre, and comes back to it."""
    scene, result = picked
    fruit = scene.fruits[0]
    direction = np.array(fruit.center) - robot.tool_positions(result.grasp.standoff)
    direction /= np.linalg.norm(direction)
    for deeper, verified in ((0.0, True), (0.8 * OFFSET, True), (1.2 * OFFSET, False), (0.03, False)):
        # Smaller, so that only the approach comes near it.
        center = tuple((np.array(fruit.center) - deeper * direction).tolist())
        moved = fruit.model_copy(update={"center": center, "radius": 0.02})
        world = scene.model_copy(update={"fruits": (moved,)})
        certificate = certify(robot, world, result.trajectory)
        assert certificate.verified is verified, (deeper, certificate.violations)


def test_second_visit_is_refused(robot, picked):
    """Straight to the fruit and back twice: a picked fruit is gone."""
    scene, _ = picked
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))  # with a stop at the stand-off
    approach = result.phases[1]
    rows = (result.trajectory.time >= approach.start_s - 1e-9) & (result.trajectory.time <= result.phases[-1].end_s)
    first = int(np.flatnonzero(rows)[0])
    there = Trajectory(
        robot.joint_names,
        result.trajectory.time[rows] - result.trajectory.time[first],
        *(getattr(result.trajectory, name)[rows] for name in ("position", "velocity", "acceleration", "torque")),
    )
    again = join_trajectories([result.trajectory, there])
    # All of it is one straight segment: motion back and forth on the line is no other kind of contact.
    assert certify(robot, scene, again).verified
    aside = there.position[0] + np.radians([8.0, 0.0, 0.0, 0.0])
    away = join_trajectories([result.trajectory, through(robot, there.position[0], aside, there.position[0]), there])
    certificate = certify(robot, scene, away)
    assert not certificate.verified
    assert "apple" in certificate.violations[0]


def test_curves_between_rows_far_apart_are_not_taken_for_straight(robot, apple):
    """The samples are on the line, the cubic between them is not."""
    scene = orchard(apple, np.radians([0.0, 30.0, 20.0, 10.0]))
    result = hplan.plan(robot, scene)
    bezier, _ = result.trajectory.segments
    window = contact_window(robot, bezier, apple.center)
    inside = (window.start + window.stop) // 2
    bent = np.array(bezier)
    for joint, shift in ((0, 0.02), (1, 0.02)):
        bent = np.array(bezier)
        bent[inside - 20, 1:3, joint] += shift
        other = contact_window(robot, bent, apple.center)
        assert window.start <= inside - 20 < other.start


def test_tool_that_is_not_there(robot, picked):
    scene, result = picked
    for gap, there in ((0.9 * THERE, True), (1.1 * THERE, False)):
        center = (*scene.fruits[0].center[:2], scene.fruits[0].center[2] + gap)
        moved = scene.model_copy(update={"fruits": (scene.fruits[0].model_copy(update={"center": center}),)})
        certificate = certify(robot, moved, result.trajectory)
        assert certificate.verified is there
        assert (certificate.contact_s is not None) is there
        if not there:
            assert "no closer than 1.1 mm" in certificate.violations[0]
            assert "'hand'" in certificate.violations[1]


def test_certificate_reports_missing_straight_approach(robot):
    """A fruit behind which a wall leaves no room for an approach along the last link."""
    scene = load_scene(scenes_dir() / "orchard-row.yaml")
    scene = scene.model_copy(update={"goal": Goal(fruit="fruit 02")})
    result = hplan.plan(robot, scene)
    assert result.grasp.distance == 0.0
    assert result.certificate.verified
    assert result.certificate.goal_contact == "motion"
    assert result.certificate.contact_s == (0.0, result.trajectory.duration)
    assert result.report["certificate"]["goal_contact"] == "motion"
    refused = certify(robot, scene, result.trajectory)
    assert not refused.verified
    assert "'hand'" in refused.violations[0]
    shown = certify(robot, scene, result.trajectory, goal_contact="motion")
    assert shown.verified
    assert shown.contact_s == result.certificate.contact_s
    assert shown.min_clearance_m == pytest.approx(result.certificate.min_clearance_m)


def test_last_link_that_pivots_about_the_fruit_leaves_its_direction(robot, apple):
    """The hand turns about the fruit's centre by 10 deg.

    At most `TURN` to both sides is one approach.
    """
    q, rows = GRASP, []
    for angle in np.arange(52.0, 62.01, 0.1):
        found = reach(robot, apple.center, approach_deg=angle).configurations
        q = found[np.abs(found - q).max(axis=1).argmin()]
        rows.append(q)
    position = np.array(rows)
    time = 0.02 * np.arange(len(position))
    velocity = np.gradient(position, time, axis=0)
    zero = 0.0 * position
    bezier, _ = Trajectory(robot.joint_names, time, position, velocity, zero, zero).segments
    assert np.linalg.norm(robot.tool_positions(position) - apple.center, axis=1).max() < THERE
    window = contact_window(robot, bezier, apple.center)
    angles = position[window.start : window.stop + 1, 1:].sum(axis=1)
    assert TURN - np.radians(0.11) <= np.ptp(angles) <= 2.0 * TURN + 1e-9
    assert np.ptp(position[:, 1:].sum(axis=1)) > 4.0 * TURN


class Touching(frozenset):
    """Names of touchable bodies, in place of a collision checker."""

    def allow_touch(self, name, hangs_from):
        return Touching(self | {name})

    def rests_from(self, name):
        return -np.inf


@pytest.mark.parametrize("seed", range(20))
def test_windows_of_several_fruits(seed):
    """Each segment may touch the fruits whose windows cover all of it."""
    random = np.random.default_rng(seed)
    clock = np.cumsum(random.uniform(0.001, 0.1, random.integers(1, 12)))
    ends = [np.sort(random.choice([*clock, *random.uniform(0.0, clock[-1], 4)], 2)) for _ in range(random.integers(4))]
    contacts = [
        FruitContact(Fruit(name=f"{k % 2}", center=(1.0, 0.0, 1.0), radius=0.04), *span.tolist())
        for k, span in enumerate(ends)
    ]
    found = stretches(Touching(), clock, contacts)
    assert [part.start for part, _ in found] == [0, *(part.stop for part, _ in found[:-1])]
    pieces = list(itertools.pairwise(clock)) if len(clock) > 1 else [(clock[0], clock[0])]
    assert found[-1][0].stop == len(pieces)
    for part, among in found:
        for begin, end in pieces[part]:
            assert among == {each.fruit.name for each in contacts if each.begin_s <= begin and end <= each.end_s}


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
def test_stops_are_certified_without_distance_query_and_clear(robot, part):
    result = reference()
    scene = result.motion.problem.scene
    found = result.stop_at(part * result.trajectory.duration)
    assert found.certificate.verified
    assert found.certificate.checks in (0, result.certificate.checks)
    assert found.certificate.digests.trajectory == trajectory_digest(found.trajectory)
    again = certify(robot, scene, found.trajectory, check_ends=False)
    assert again.verified
    looked_at = between_rows(found.trajectory, np.arange(found.trajectory.samples), 1)
    assert_clear(robot, scene, looked_at)


def test_clearance_is_reduced_by_deviation_from_path():
    result = reference()
    found = result.stop_at(0.5)
    assert found.off_path_m > 0.0
    less = result.certificate.min_clearance_m - found.certificate.min_clearance_m
    assert 0.0 < less <= 2.0 * found.off_path_m


@pytest.mark.parametrize("part", np.linspace(0.0, 1.0, 6))
def test_stops_in_a_pick(part):
    """Also during the approach, when the last link may touch the fruit."""
    result = picking()
    found = result.stop_at(part * result.trajectory.duration)
    assert found.certificate.verified, found.certificate.violations
    anew = certified_retiming(
        load_robot(), result.motion.problem.scene, result.certificate,
        stop_motion(result.trajectory, part * result.trajectory.duration, load_robot()),
        tracking=STILL, sigmas=3.0, anew=True,
    )  # fmt: skip
    assert anew.certificate.verified, anew.certificate.violations


def test_insufficient_clearance_is_proved_again(robot):
    result = reference()
    scene = result.motion.problem.scene
    tight = replace(result.certificate, min_clearance_m=1e-6)
    retimed = stop_motion(result.trajectory, 0.6, robot)
    found = certified_retiming(robot, scene, tight, retimed, tracking=STILL, sigmas=3.0)
    assert found.certificate.verified
    assert found.certificate.checks > tight.checks


def test_stop_in_contact_is_not_certified(robot):
    """An obstacle on the path, and an invalid certificate."""
    result = reference()
    scene = result.motion.problem.scene
    tool = robot.tool_positions(result.trajectory.position[[100]])[0]
    blocked = scene.with_obstacles([*scene.obstacles, Sphere(name="late", center=tuple(tool.tolist()), radius=0.05)])
    unknown = replace(result.certificate, verified=False)
    retimed = stop_motion(result.trajectory, result.trajectory.time[150], robot)
    found = certified_retiming(robot, blocked, unknown, retimed, tracking=STILL, sigmas=3.0)
    assert not found.certificate.verified
    assert any("late" in violation for violation in found.certificate.violations)


def test_other_speeds_are_certified(robot):
    result = picking()
    found = result.scale_speed([(0.0, 1.0), (0.4, 1.0), (0.4, 0.3)])
    assert found.certificate.verified
    assert found.parts_s == pytest.approx(0.396)
    scene = result.motion.problem.scene
    assert certify(robot, scene, found.trajectory).verified


def test_faster_with_tracking_errors_that_grow_with_speed(robot):
    """At another speed the arm may be farther from the path than the path's certificate allows for."""
    scene, tracking = load_scene(), TrackingModel(1e-3, 0.02)
    options = PlanOptions(speed=0.5, tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s)
    result = plan(robot, scene, options)
    faster = scale_motion(result.trajectory, [(0.0, 1.0), (0.008, 1.0), (0.008, 1.5)], robot)
    found = certified_retiming(robot, scene, result.certificate, faster, tracking=tracking, sigmas=3.0)
    anew = certify(robot, scene, faster.trajectory, tracking_error=1e-3, tracking_delay_s=0.02)
    assert not anew.verified
    assert not found.certificate.verified
    assert found.certificate.min_clearance_m <= anew.min_clearance_m + 1e-4


def test_obstacle_that_comes_into_the_base_only_while_the_slower_motion_runs(robot):
    start, goal = (0.0, 45.0, 45.0, 45.0), (60.0, 30.0, 50.0, 40.0)
    comes = Track(times_s=(0.0, 8.0), shifts_m=((0.0, 0.0, 0.0), (3.0, 0.0, 0.0)))
    crate = Box(name="crate", center=(-3.0, 0.0, 0.1), size=(0.2, 0.2, 0.2), track=comes)
    scene, motion = scene_of(start, goal, [crate]), quintic(robot, start, goal, duration=3.0)
    running = certify(robot, scene, motion)
    assert running.verified
    found = certified_retiming(robot, scene, running, scale_motion(motion, 0.35, robot), tracking=STILL, sigmas=3.0)
    assert not found.certificate.verified
    assert found.certificate.clear_until_s is None
    assert any("'crate' comes into the robot's" in violation for violation in found.certificate.violations)
