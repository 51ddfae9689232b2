"""Checks that `certify` shares with `plan`: start, goal, locked joints, sigma, base."""

from __future__ import annotations

import numpy as np
import pytest

import hplan
from hplan.certificate.certificate import certify
from hplan.certificate.goal_contact import THERE
from hplan.certificate.task_check import TASK_TOLERANCE
from hplan.collision.coal_scene import CoalScene
from hplan.errors import InputError
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere

START, GOAL = (-0.4, 0.3, 0.4, 0.5), (0.5, 0.8, 0.2, 0.3)


@pytest.fixture(scope="module")
def free():
    return Scene(name="free", start=Start(joints_rad=START), goal=Goal(joints_rad=GOAL))


@pytest.fixture(scope="module")
def motion(robot, free):
    return hplan.plan(robot, free).trajectory


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("which", ["start", "goal"])
def test_begins_at_the_start_and_ends_at_the_goal(robot, free, motion, joint, which):
    for by, verified in ((0.9 * TASK_TOLERANCE, True), (-1.1 * TASK_TOLERANCE, False), (0.01, False)):
        values = list(START if which == "start" else GOAL)
        values[joint] += by
        kind = {"start": Start, "goal": Goal}[which]
        other = free.model_copy(update={which: kind(joints_rad=tuple(values))})
        certificate = certify(robot, other, motion)
        assert certificate.verified is verified
        assert certify(robot, other, motion, check_ends=False).verified
        if not verified:
            (violation,) = certificate.violations
            assert violation.split()[2] == {"start": "begins", "goal": "ends"}[which]
            assert repr(robot.joint_names[joint]) in violation
            assert f"{abs(by):.4g} rad" in violation


def test_ends_with_the_tool_at_the_position(robot, free, motion):
    tool = robot.tool_positions(motion.position[-1])
    for axis in range(3):
        for by, verified in ((0.9 * THERE, True), (1.1 * THERE, False)):
            goal = Goal(position=tuple((tool + by * np.eye(3)[axis]).tolist()))
            certificate = certify(robot, free.model_copy(update={"goal": goal}), motion)
            assert certificate.verified is verified
            assert len(certificate.violations) == (not verified)
    # Passing there is not enough.
    goal = Goal(position=tuple(robot.tool_positions(motion.position[len(motion.position) // 2]).tolist()))
    assert not certify(robot, free.model_copy(update={"goal": goal}), motion).verified


@pytest.mark.parametrize("asked", [90.0, (80.0, 100.0), (440.0, 460.0), (-280.0, -260.0), (-300.0, 95.0)])
def test_approach_angle(robot, free, motion, asked):
    """The last link is at sum(GOAL[1:]), about 74.5 deg, in the end; by 15.5 deg more it would be at 90 deg."""
    angle = np.degrees(sum(GOAL[1:]))
    tool = tuple(robot.tool_positions(motion.position[-1]).tolist())
    for shift in (0.0, 0.0005, -0.0005, 5.0, 17.0, -17.0):
        window = np.atleast_1d(asked) + shift - (90.0 - angle)
        goal = Goal(position=tool, approach_deg=float(window[0]) if len(window) == 1 else tuple(window.tolist()))
        low, high = window[0] % 360.0, window[0] % 360.0 + (window[-1] - window[0])
        inside = any(low - 0.00057 <= angle + turn <= high + 0.00057 for turn in (-360.0, 0.0, 360.0))
        certificate = certify(robot, free.model_copy(update={"goal": goal}), motion)
        assert certificate.verified is inside, (window, certificate.violations)


def test_locked_joints_stay_still(robot, free, motion):
    for joint in robot.joint_names:
        certificate = certify(robot, free.model_copy(update={"locked_joints": (joint,)}), motion)
        (violation,) = certificate.violations
        assert violation.startswith(f"joint {joint!r} is locked")
    still = free.model_copy(update={"goal": Goal(joints_rad=(START[0], *GOAL[1:])), "locked_joints": ("base_yaw",)})
    names = robot.joint_names
    still = still.model_copy(update={"locked_joints": names[:1]})
    assert certify(robot, still, hplan.plan(robot, still).trajectory).verified


def test_locked_joint_that_moves_between_rows_alone(robot, free):
    scene = free.model_copy(update={"goal": Goal(joints_rad=START), "locked_joints": robot.joint_names[3:]})
    velocity = np.zeros((3, 4))
    velocity[1, 3] = 0.1
    position, zero = np.tile(START, (3, 1)), np.zeros((3, 4))
    moving = hplan.Trajectory(robot.joint_names, np.array([0.0, 0.1, 0.2]), position, velocity, zero, zero)
    assert any("is locked" in violation for violation in certify(robot, scene, moving).violations)


def test_scene_of_another_robot_is_refused(robot, free, motion):
    with pytest.raises(InputError, match="start"):
        certify(robot, free.model_copy(update={"start": Start(joints_rad=(0.0,) * 3)}), motion)
    with pytest.raises(InputError, match="thumb"):
        certify(robot, free.model_copy(update={"locked_joints": ("thumb",)}), motion)


def test_uncertain_obstacles_are_grown(robot, free, motion):
    """By three standard deviations by default, as in `plan`; for obstacles and fruit."""
    tool = np.array([robot.tool_positions(q) for q in motion.position])
    center = tool[len(tool) // 2] + np.array([0.0, 0.0, 0.25])
    for kind in ("obstacle", "fruit"):

        def scene(sigma, kind=kind):
            values = {"name": "bead", "center": tuple(center.tolist()), "radius": 0.05, "sigma": sigma}
            key = {"obstacle": "obstacles", "fruit": "fruits"}[kind]
            return free.model_copy(update={key: ((Sphere if kind == "obstacle" else Fruit)(**values),)})

        gap = min(CoalScene(robot, scene(0.0).solids).distances(q).min() for q in motion.position)
        assert gap > 0.02
        for sigma, sigmas, verified in (
            (0.0, 3.0, True), (0.3 * gap, 3.0, True), (0.35 * gap, 3.0, False), (0.35 * gap, 2.0, True),
            (0.55 * gap, 2.0, False), (gap, 0.0, True),
        ):  # fmt: skip
            certificate = certify(robot, scene(sigma), motion, sigmas=sigmas)
            assert certificate.verified is verified
            assert certificate.min_clearance_m <= gap - sigmas * sigma + 1e-9
        assert not certify(robot, scene(0.35 * gap), motion).verified


def test_obstacle_in_the_base_is_refused(robot, free, motion):
    """As in `plan`; the ground may touch the pedestal."""
    for depth, verified in ((0.0, True), (0.05, False)):
        ground = Box(name="ground", center=(0.0, 0.0, depth - 0.5), size=(4.0, 4.0, 1.0))
        scene = free.model_copy(update={"obstacles": (ground,)})
        certificate = certify(robot, scene, motion)
        assert certificate.verified is verified
        if verified:
            assert hplan.plan(robot, scene).certificate.verified
        else:
            assert "'ground' is 50 mm deep" in certificate.violations[0]
            with pytest.raises(InputError, match="ground"):
                hplan.plan(robot, scene)
            # With the caller's own checker the base is not checked.
            assert certify(robot, scene, motion, checker=CoalScene(robot, scene.solids)).verified
