"""Starts that are nearer to obstacles than the clearance, or touch them a little, are left."""

from __future__ import annotations

import numpy as np
import pytest

from hplan import certify, load_robot, plan
from hplan.collision.coal_scene import LEAVE_TOLERANCE, CoalScene
from hplan.errors import ConfigurationInCollisionError, MovingObstacleError
from hplan.scene import Goal, Scene, Sphere, Start

CLEARANCE = 0.01


def next_to_the_hand(gap: float, **start: object) -> Scene:
    """A ball above the last link at the start, at a distance from it."""
    robot = load_robot()
    q = np.radians([0.0, 60.0, 10.0, 10.0])
    tool, wrist = robot.tool_positions(q), robot.forward_kinematics(q, "hand")[:3, 3]
    along = (tool - wrist) / np.linalg.norm(tool - wrist)
    up = np.cross(np.cross(along, [0.0, 0.0, 1.0]), along)
    thick = 0.03
    center = 0.5 * (tool + wrist) + (thick + 0.05 + gap) * up / np.linalg.norm(up)
    ball = Sphere(name="ball", center=tuple(center), radius=0.05)
    distance = CoalScene(robot, [ball]).nearest_contact(q).distance_m
    ball = ball.with_values(center=tuple(center + (gap - distance) * up / np.linalg.norm(up)))
    goal = Goal(joints_deg=(-60.0, 40.0, 30.0, 10.0))
    begin = Start(joints_rad=tuple(q.tolist()), **start)
    return Scene(name="near", start=begin, goal=goal, obstacles=(ball,), clearance=CLEARANCE)


@pytest.mark.parametrize("gap", [0.006, 0.0005, -0.002])
@pytest.mark.parametrize("locked", [(), ("base_yaw",)])
def test_near_start_is_left_and_no_nearer_is_come(gap: float, locked: tuple[str, ...]) -> None:
    robot, scene = load_robot(), next_to_the_hand(gap, contact_depth=0.005)
    if locked:
        scene = scene.with_values(locked_joints=locked, goal=Goal(joints_deg=(0.0, 30.0, 10.0, 10.0)))
    result = plan(robot, scene)
    assert result.certificate.verified
    assert certify(robot, scene, result.trajectory).verified
    checker = CoalScene(robot, scene.solids)
    fine = np.linspace(0.0, result.trajectory.duration, 4000)
    distances = np.array([checker.distances(q).min() for q in result.trajectory.positions(fine)])
    assert distances.min() >= gap - LEAVE_TOLERANCE - 1e-6
    assert distances[-1] >= CLEARANCE
    if gap >= 0.0:
        rules = [rule for rule in result.certificate.pair_rules if rule.other == "ball"]
        assert rules
        assert all(rule.required_m == pytest.approx(gap - LEAVE_TOLERANCE, abs=1e-5) for rule in rules)
    else:
        assert result.certificate.pushes[0].depth_m <= -gap + LEAVE_TOLERANCE + 1e-6


def test_without_the_option_or_too_deep_the_start_is_refused() -> None:
    robot = load_robot()
    with pytest.raises(ConfigurationInCollisionError):
        plan(robot, next_to_the_hand(0.006))
    with pytest.raises(ConfigurationInCollisionError):
        plan(robot, next_to_the_hand(-0.008, contact_depth=0.005))


def test_motion_that_comes_nearer_or_stays_near_is_not_certified() -> None:
    robot, scene = load_robot(), next_to_the_hand(0.006, contact_depth=0.0)
    nudged = np.array(scene.start.configuration)
    nudged[1] += 0.002
    other = scene.with_values(goal=Goal(joints_rad=tuple(nudged.tolist())))
    with pytest.raises(ConfigurationInCollisionError):
        plan(robot, other)  # its goal is nearer than the clearance
    motion = plan(robot, next_to_the_hand(0.006, contact_depth=0.0)).trajectory.reversal
    back = scene.with_values(
        start=Start(joints_rad=tuple(motion.position[0].tolist()), contact_depth=0.0),
        goal=Goal(joints_rad=tuple(motion.position[-1].tolist())),
    )
    assert not certify(robot, back, motion).verified


def test_moving_obstacles_are_refused() -> None:
    scene = next_to_the_hand(0.006, contact_depth=0.0)
    track = {"times_s": [0.0, 1.0], "shifts_m": [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]}
    moving = scene.obstacles[0].with_values(track=track)
    with pytest.raises(MovingObstacleError, match="contact_depth"):
        plan(load_robot(), scene.with_values(obstacles=(moving,)))
