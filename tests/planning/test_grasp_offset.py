"""Grasps off the centre of a fruit, where obstacles block those at the centre."""

from __future__ import annotations

import numpy as np
import pytest
from planned import assert_clear, fruit, post, task

import hplan
from hplan.certificate.certificate import certify
from hplan.certificate.goal_contact import THERE
from hplan.certificate.goal_displacement import grasps_in
from hplan.errors import BlockedError, SceneError
from hplan.planning.grasps import capture_probabilities
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Capsule
from hplan.scene.wood import Wood

HOME = (0.0, 90.0, 90.0, 90.0)


@pytest.fixture(scope="module")
def orchard_arm() -> Robot:
    return hplan.load_robot("orchard_harvester")


def behind(gap: float, offset: float, **more: float) -> Scene:
    """An apple whose centre is at a distance from a post that reaches around it, nearer than the hand is thick."""
    apple = fruit("apple", 10.0, 1.2, 1.3, grasp_offset=offset, **more)
    return task(HOME, Goal(fruit="apple"), [post("post", 10.0, 1.2 + 0.03 + gap, 0.3, 2.2)], fruits=(apple,))


def away(robot: Robot, result: hplan.PlanResult) -> float:
    assert result.grasp is not None
    tool = robot.tool_positions(result.grasp.goal)
    return float(np.linalg.norm(tool - np.array(result.scene.fruits[0].center)))


@pytest.mark.parametrize(("gap", "offset", "expected"), [(0.04, 0.02, 0.0), (0.03, 0.02, 0.01), (0.02, 0.02, 0.02)])
def test_offset_is_as_small_as_possible(orchard_arm: Robot, gap: float, offset: float, expected: float) -> None:
    scene = behind(gap, offset)
    result = hplan.plan(orchard_arm, scene, hplan.PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert away(orchard_arm, result) == pytest.approx(expected, abs=1e-6)
    assert_clear(orchard_arm, scene, result.trajectory.position, touched="apple")
    # Without the permission the same motion does not reach the fruit.
    exact = scene.copy_unchecked({"fruits": (scene.fruits[0].copy_unchecked({"grasp_offset": 0.0}),)})
    found = certify(orchard_arm, exact, result.trajectory)
    assert found.verified is (expected <= THERE)
    if expected > THERE:
        assert "the tool no closer than" in found.violations[0]
        with pytest.raises(BlockedError):
            hplan.plan(orchard_arm, exact, hplan.PlanOptions(effort="quick"))


def test_hand_is_never_deeper_than_the_centre(orchard_arm: Robot) -> None:
    result = hplan.plan(orchard_arm, behind(0.02, 0.02), hplan.PlanOptions(effort="quick"))
    assert result.grasp is not None
    pose = orchard_arm.forward_kinematics(result.grasp.goal)
    beyond = (pose[:3, 3] - np.array(result.scene.fruits[0].center)) @ (pose[:3, :3] @ orchard_arm.tool_axis)
    assert beyond <= 1e-6


def test_offsets_too_small_do_not_help(orchard_arm: Robot) -> None:
    with pytest.raises(BlockedError):
        hplan.plan(orchard_arm, behind(0.01, 0.02), hplan.PlanOptions(effort="quick"))


def test_tours_and_reachability_use_them(orchard_arm: Robot) -> None:
    scene = behind(0.02, 0.02)
    found = hplan.reachable(orchard_arm, scene)["apple"]
    assert found.can_be_picked
    assert hplan.plan_tour(orchard_arm, scene, hplan.PlanOptions(effort="quick")).certificate.verified


def test_offset_takes_from_the_range_for_displacements(orchard_arm: Robot) -> None:
    scene = behind(0.02, 0.02)
    apple = scene.fruits[0]
    x, y, z = apple.center
    trunk = Capsule(name="trunk", start=(x, y - 0.5, z + 0.3), end=(x, y + 0.5, z + 0.3), radius=0.02)
    twig = Capsule(name="twig", start=(x, y, z + 0.3), end=(x, y, z + 0.055), radius=0.004, parent="trunk")
    scene = scene.copy_unchecked({"obstacles": (*scene.obstacles, trunk, twig), "wood": Wood(capture_range=0.03)})
    result = hplan.plan(orchard_arm, scene, hplan.PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert result.certificate.subject is not None
    (grasp,) = grasps_in(result.certificate.subject)
    assert grasp.fruit.capture_range == pytest.approx(0.03 - (away(orchard_arm, result) - THERE), abs=1e-9)
    assert away(orchard_arm, result) > 0.009


def test_any_arm_uses_them() -> None:
    robot = hplan.load_robot("ur5")
    apple = Fruit(name="apple", center=(0.55, 0.1, 0.5), radius=0.04, grasp_offset=0.03)
    wall = hplan.scene.Box(name="wall", center=(0.83, 0.1, 0.5), size=(0.5, 1.2, 1.2))
    start = (120.0, -90.0, 60.0, -60.0, -90.0, 0.0)
    scene = task(start, Goal(fruit="apple"), [wall], fruits=(apple,))
    exact = scene.copy_unchecked({"fruits": (apple.copy_unchecked({"grasp_offset": 0.0}),)})
    with pytest.raises(BlockedError):
        hplan.plan(robot, exact, hplan.PlanOptions(effort="quick"))
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert 0.01 < away(robot, result) <= 0.03 + 1e-6


def test_offset_is_at_most_the_radius_and_in_files_and_digests(orchard_arm: Robot) -> None:
    with pytest.raises(SceneError, match="at most the radius"):
        fruit("apple", 10.0, 1.2, 1.3, grasp_offset=0.05)
    scene = behind(0.02, 0.02)
    assert hplan.scene.parse_scene(hplan.scene.dump_scene(scene)) == scene
    digests = [
        certify(orchard_arm, each, hplan.plan(orchard_arm, scene, hplan.PlanOptions(effort="quick")).trajectory).digests
        for each in (scene, scene.copy_unchecked({"fruits": (fruit("apple", 10.0, 1.2, 1.3, grasp_offset=0.021),)}))
    ]
    assert digests[0] != digests[1]


def test_probability_counts_the_offset() -> None:
    sigma, capture, off = 0.01, (0.02, 0.02), np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    ahead = np.tile([1.0, 0.0, 0.0], (3, 1))
    found = capture_probabilities(ahead, sigma**2 * np.eye(3), capture, off)
    errors = np.random.default_rng(1).normal(scale=sigma, size=(200_000, 3))
    for share, offset in zip(found, off, strict=True):
        relative = errors - offset
        caught = (np.abs(relative[:, 0]) <= capture[1]) & (np.hypot(relative[:, 1], relative[:, 2]) <= capture[0])
        assert share == pytest.approx(float(caught.mean()), abs=0.005)
