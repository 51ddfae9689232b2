"""Motions, splices and stops for a controller, and verdicts, without ROS."""

from __future__ import annotations

import importlib.util
import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hplan
from hplan.apps.cli.main import main
from hplan.apps.ros import to_joint_trajectory
from hplan.apps.ros.arm_state import ArmState
from hplan.apps.ros.controller import command_message, outcome_of
from hplan.apps.ros.judge import Judge, JudgeOptions
from hplan.apps.ros.scene_updates import SceneUpdates
from hplan.apps.ros.session import Session, SessionOptions
from hplan.errors import HplanError, InputError, OptionError
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

A, B = (0.0, 0.9, 0.6, 0.3), (1.2, 0.9, 0.6, 0.3)


def test_last_position_of_each_joint_counts(robot: Robot) -> None:
    arm = ArmState(robot.joint_names)
    with pytest.raises(InputError, match="'base_yaw'"):
        arm.configuration(0.0)
    arm.see({"name": ["gripper", *reversed(robot.joint_names)], "position": [9.0, 4.0, 3.0, 2.0, 1.0]}, 0.0)
    arm.see(SimpleNamespace(name=["finger"], position=[0.01]), 0.1)
    arm.see({"name": ["wrist", "shoulder"], "position": [5.0, math.nan]}, 0.3)
    assert arm.configuration(0.4).tolist() == [1.0, 2.0, 3.0, 5.0]
    with pytest.raises(InputError, match=r"'base_yaw' is 0.60 s old"):
        arm.configuration(0.6)
    assert arm.positions["gripper"] == 9.0


class World:
    """A session with a clock that the test sets, and an arm that follows what is sent."""

    def __init__(self, robot: Robot, **options: Any) -> None:
        scene = Scene(name="x", start=Start(joints_rad=A), goal=Goal(joints_rad=B))
        self.now, self.robot = 10.0, robot
        self.session = Session(robot, scene, SessionOptions(deadline_s=60.0, ahead_s=2.0, **options), lambda: self.now)
        self.at(A)

    def at(self, q: Any) -> None:
        state = {"name": list(self.robot.joint_names), "position": list(map(float, q))}
        self.session.arm.see(state, self.now)

    def go_on(self, command: Any, after_s: float) -> None:
        self.now = command.begins_s + after_s
        self.at(command.trajectory.state_at(after_s)[0])

    def block(self, command: Any, at_s: float) -> None:
        """Put a ball at the tool's place at a time of a motion."""
        tool = self.robot.tool_positions(command.trajectory.state_at(at_s)[0][None])[0]
        self.session.set_obstacles((Sphere(name="ball", center=tuple(tool.tolist()), radius=0.05),))


@pytest.fixture
def world(robot: Robot) -> World:
    return World(robot, speed=0.1)


def test_scene_of_another_robot_is_refused_at_the_start(robot: Robot) -> None:
    scene = Scene(name="x", start=Start(joints_rad=A), goal=Goal(joints_rad=B), locked_joints=("elbow 7",))
    with pytest.raises(InputError, match="locked_joints names 'elbow 7'"):
        Session(robot, scene, SessionOptions(), lambda: 0.0)


def test_motion_is_kept_until_something_blocks_it(world: World) -> None:
    session = world.session
    first = session.move()
    assert (first.kind, first.number, session.is_moving) == ("motion", 1, True)
    with pytest.raises(InputError, match="has not answered"):
        session.move()
    assert first.begins_s == pytest.approx(10.05)
    message = command_message(first, 10**18)
    assert message["header"]["stamp"]["sec"] == 10**9 + 10
    session.accept(1)
    world.go_on(first, 0.2)
    assert session.react() is None
    world.block(first, first.trajectory.duration)  # the goal itself
    stop = session.react()
    assert stop is not None
    assert (stop.kind, stop.certificate.verified) == ("stop", True)
    assert stop.reason
    assert session.react() is None
    session.accept(2)
    with pytest.raises(InputError, match="is stopping"):
        session.move()
    assert not session.end(1)
    assert session.end(2)
    assert not session.is_moving


def test_rejected_splice_leaves_the_motion_before_it(world: World) -> None:
    session = world.session
    first = session.move()
    session.accept(first.number)
    world.go_on(first, 0.2)
    second = session.move(Goal(joints_rad=(0.8, 0.9, 0.6, 0.3)))
    assert second.kind == "splice"
    stop = session.reject(second.number)
    assert stop is not None
    assert stop.kind == "stop"
    # The stop is on the path of the first motion.
    rows = np.array([first.trajectory.state_at(at)[0] for at in np.linspace(0.0, 0.5, 4)])
    found = np.array([stop.trajectory.state_at(at + first.begins_s - stop.begins_s)[0] for at in (0.0, 0.1, 0.2)])
    assert np.abs(found[0] - rows[0]).max() < 1e-9
    assert session.reject(stop.number) is None
    assert session.sent == first


def test_goal_that_cannot_be_reached_leaves_the_running_motion(world: World) -> None:
    session = world.session
    first = session.move()
    session.accept(1)
    world.go_on(first, 0.2)
    with pytest.raises(HplanError):
        session.move(Goal(joints_rad=(9.0, 0.9, 0.6, 0.3)))
    assert session.planner.scene.goal == Goal(joints_rad=B)
    assert session.react() is None
    session.fault = "the planning scene is unknown"
    stop = session.react()
    assert stop is not None
    assert stop.reason == session.fault
    session.end(stop.number)
    with pytest.raises(InputError, match="is unknown"):
        session.move()


def test_arm_off_its_motion_is_stopped(world: World) -> None:
    first = world.session.move()
    world.session.accept(1)
    world.go_on(first, 0.2)
    world.at(first.trajectory.state_at(0.2)[0] + 0.1)
    stop = world.session.react()
    assert stop is not None
    assert "from the running motion" in stop.reason


def test_node_without_ros_names_the_extra(capsys: pytest.CaptureFixture[str]) -> None:
    if importlib.util.find_spec("rclpy") is not None:
        pytest.skip("ROS is installed")
    for node in ("judge", "plan"):
        assert main(["ros", node, "--ros-args", "-p", "robot:=panda"]) == 2
        assert "needs rclpy, which is not installed: pip install 'hplan[ros2]'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["ros", "judge", "robot:=panda"])
    assert "expected --ros-args, got 'robot:=panda'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("node", "words"), [("judge", "a verdict [s]"), ("plan", "Maximum time for a plan from rest [s].")]
)
def test_help_lists_the_parameters_of_a_node(node: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ros", node, "--help"]) == 0
    found = " ".join(capsys.readouterr().out.split())
    assert words in found.partition("deadline_s")[2]
    assert "(default: 5.0)" in found


def test_outcomes() -> None:
    assert outcome_of({"error_code": 0, "error_string": ""}) == (True, "successful")
    assert outcome_of(SimpleNamespace(error_code=-9, error_string="x")) == (False, "error code -9: x")


# Verdicts


@pytest.fixture(scope="module")
def around() -> tuple[Robot, Scene, dict[str, Any]]:
    scene = hplan.load_scene("table-1")
    robot = hplan.load_robot(scene.robot)
    motion = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick")).trajectory
    return robot, scene, to_joint_trajectory(motion)


def test_verdict_names_time_pair_depth_and_limit(around: tuple[Robot, Scene, dict[str, Any]]) -> None:
    robot, scene, message = around
    good = Judge(robot, scene).judge(message)
    assert good.verified
    assert good.limit == ""
    straight = {**message, "points": [dict(message["points"][0]), dict(message["points"][-1])]}
    straight["points"][1]["time_from_start"] = {"sec": 0, "nanosec": 500_000_000}
    bad = Judge(robot, scene).judge(straight)
    assert not bad.verified
    assert (bad.obstacle, bad.limit) == ("ball", max(bad.limits, key=lambda name: bad.limits[name]))
    assert 0.0 < (bad.time_s or 0.0) <= (bad.deepest_s or 0.0) < 0.5
    assert bad.depth_m == pytest.approx(0.19, abs=0.01)
    only_clearance = Judge(robot, scene, JudgeOptions(limits=())).judge(straight)
    assert len(only_clearance.violations) == 1
    assert json.loads(good.to_json())["depth_m"] == 0.0


def test_verdict_on_several_motions_and_faults(around: tuple[Robot, Scene, dict[str, Any]]) -> None:
    robot, scene, message = around
    judge = Judge(robot, scene)
    twice = judge.judge({"trajectory": [{"joint_trajectory": message}] * 2})
    assert "motion 2 begins" in twice.violations[0]
    assert judge.judge({"trajectory": []}).violations == ("the message has no motion",)
    assert "joint_names" in judge.judge({}).violations[0]
    assert "the joints of" in judge.judge({**message, "joint_names": list("abcd")}).violations[0]
    begins = Judge(robot, scene, JudgeOptions(start_tolerance=0.01))
    begins.arm.see({"name": message["joint_names"], "position": [0.5, *message["points"][0]["positions"][1:]]}, 0.0)
    assert "the arm is at 0.5" in begins.judge(message).violations[0]


def test_verdict_in_time_or_not_verified(around: tuple[Robot, Scene, dict[str, Any]]) -> None:
    robot, scene, message = around
    late = Judge(robot, scene, JudgeOptions(deadline_s=1e-6)).judge(message)
    assert (late.verified, late.violations) == (False, ("not decided within 1e-06 s",))
    assert Judge(robot, scene, JudgeOptions(deadline_s=60.0)).judge(message).verified
    with pytest.raises(OptionError, match="deadline_s"):
        JudgeOptions(deadline_s=0.0)


def test_verdict_waits_for_the_planning_scene(around: tuple[Robot, Scene, dict[str, Any]]) -> None:
    robot, scene, message = around
    updates = SceneUpdates(leave_out=("link_padding",))
    judge = Judge(robot, scene.with_obstacles(()), updates=updates)
    assert "no whole planning scene" in judge.judge(message).violations[0]
    updates.apply({"world": {"collision_objects": []}})
    assert judge.judge(message).clearance_m == math.inf or judge.judge(message).verified
    padding = [{"link_name": "hand", "padding": 5.0}]
    updates.apply({"is_diff": True, "world": {"collision_objects": [BALL]}, "link_padding": padding})
    assert "required: more than 5e+03 mm" in judge.judge(message).violations[0]


BALL = {
    "id": "ball",
    "pose": {"position": {"x": 3.0, "y": 0.0, "z": 0.0}},
    "primitives": [{"type": 2, "dimensions": [0.1]}],
}
