"""Continuous joints are planned about where they are, whatever number of turns they have made."""

from __future__ import annotations

import numpy as np
import pytest
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan import Planner, PlanOptions, certify, check, finish, load_robot, plan
from hplan.certificate.digests import robot_digest, scene_digest
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.held_objects import holding
from hplan.errors import JointLimitError
from hplan.robot.model import Robot
from hplan.scene import Goal, Scene, Sphere, Start
from hplan.tour.motions import carried_fruit

TURN = 2.0 * np.pi


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A six-axis arm whose first and last joints have no limits."""
    path = tmp_path_factory.mktemp("arm") / "six.urdf"
    text = six_axis_arm()
    for name in ("shoulder_pan", "wrist_3"):
        text = text.replace(f'name="{name}" type="revolute"', f'name="{name}" type="continuous"')
    path.write_text(text)
    path.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS)
    return load_robot(path)


def task(robot: Robot, turns: float, *obstacles: Sphere) -> Scene:
    start, goal = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.lower + robot.upper)
    goal[0], goal[-1], start[-1] = 0.4, 0.4, TURN * turns
    return Scene(name="turned", start=Start(joints_rad=start), goal=Goal(joints_rad=goal), obstacles=obstacles)


@pytest.mark.parametrize("turns", [0.0, 1.0, 1.1, -3.02])
def test_motion_is_short_and_certified_after_any_turns(arm: Robot, turns: float) -> None:
    scene = task(arm, turns)
    result = plan(arm, scene)
    assert result.certificate.verified
    assert certify(arm, scene, result.trajectory).verified
    assert result.trajectory.position[0, -1] == pytest.approx(TURN * turns)
    assert abs(result.trajectory.position[-1, -1] - TURN * turns) <= np.pi
    assert robot_digest(result.robot) == robot_digest(arm)
    assert check(arm, scene, result.trajectory.position[-1]).valid.all()


def test_other_joints_keep_their_limits(arm: Robot) -> None:
    beyond = arm.upper[1] + 0.1
    with pytest.raises(JointLimitError):
        plan(arm, task(arm, 2.0).with_values(goal=Goal(joints_rad=[0.0, beyond, 0.0, 0.0, 0.0, 0.0])))
    assert not certify(arm, task(arm, 0.0), plan(arm, task(arm, 1.0)).trajectory).verified  # starts a turn away


def test_path_across_half_a_turn_is_not_the_long_way(arm: Robot) -> None:
    scene = task(arm, 3.0 / TURN).with_values(goal=Goal(joints_rad=[0.4, *task(arm, 0.0).goal.joints_rad[1:-1], -3.0]))
    first, last = np.array(scene.start.joints_rad), np.array(scene.goal.joints_rad)
    middle = 0.5 * (first + last)
    middle[-1] = -np.pi + 0.01
    turned = finish(arm, scene, [first, middle, last]).trajectory.position[:, -1]
    assert np.abs(np.diff(turned)).sum() < 0.5


def test_planner_replans_in_motion_after_turns(arm: Robot) -> None:
    planner = Planner(arm, task(arm, 1.2), PlanOptions(effort="quick"))
    running = planner.plan(begins_s=0.0)
    start, goal = running.trajectory.position[[0, -1]]
    assert abs(start[-1] - 1.2 * TURN) < 1e-9
    assert abs(goal[-1] - start[-1]) <= np.pi
    other = Goal(joints_rad=[-0.4, *goal[1:-1], goal[-1] - TURN + 0.3])
    planner.aim(goal=other)
    spliced = planner.replan(at=0.15, now=0.05, measured=running.trajectory.state_at(0.05)[0])
    assert spliced.certificate.verified
    assert spliced.trajectory.position[-1, -1] == pytest.approx(goal[-1] + 0.3)


def test_what_a_turned_arm_carries_counts(arm: Robot) -> None:
    """Bodies are those of the arm with its load, not of the arm that was loaded from the file."""
    turned = arm.about(task(arm, 2.0).start.configuration)
    assert turned.loaded is arm
    assert turned.loaded.about(task(arm, 0.0).start.configuration) is arm
    carrying, other = (holding(robot, [carried_fruit(0.04)]) for robot in (turned, arm))
    assert len(collision_bodies(carrying)) == len(collision_bodies(other)) == len(collision_bodies(arm)) + 1
    assert robot_digest(carrying) == robot_digest(other) == robot_digest(arm)
    scene = task(arm, 0.0)
    assert scene_digest(scene.with_attached(carrying.attached)) != scene_digest(scene)
    np.testing.assert_allclose(carrying.lower, turned.lower)
    np.testing.assert_allclose(carrying.loaded.lower, arm.lower)
