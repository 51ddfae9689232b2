"""`hplan ros judge` on the real middleware: messages of rclpy over Fast DDS."""

from __future__ import annotations

import json
import signal
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_client import Client, need_ros, node_process

import hplan
from hplan.apps.ros import SceneUpdates, to_joint_trajectory, to_message
from hplan.errors import SceneError
from hplan.scene.model import Scene

need_ros()

#: The ball of the scene `table-1`, which the reference motion goes around.
JUDGE = "/hplan_judge"


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    found = Client()
    yield found
    found.close()


@pytest.fixture(scope="module")
def motion() -> hplan.PlanResult:
    scene = hplan.load_scene("table-1")
    return hplan.plan(hplan.load_robot(scene.robot), scene, hplan.PlanOptions(effort="quick"))


def around(motion: hplan.PlanResult) -> dict[str, Any]:
    return to_joint_trajectory(motion.trajectory)


def through(motion: hplan.PlanResult, time_scale: int = 4) -> dict[str, Any]:
    """From start to goal straight through the ball, slowly."""
    points = [dict(around(motion)["points"][row]) for row in (0, -1)]
    points[1]["time_from_start"] = {"sec": time_scale, "nanosec": 0}
    return {**around(motion), "points": points}


def planning_scene(scene: Scene, *, is_diff: bool = False, operation: bytes = b"\0") -> Any:
    from moveit_msgs.msg import PlanningScene

    (ball,) = scene.obstacles
    item = {
        "header": {"frame_id": "world"},
        "id": "moveit ball",
        "pose": {"position": dict(zip("xyz", ball.center, strict=True))},  # type: ignore[union-attr]
        "primitives": [{"type": 2, "dimensions": [ball.radius]}],  # type: ignore[union-attr]
        "operation": operation,
    }
    links = [{"link_name": link, "padding": 0.0} for link in ("base", "hand")]
    content = {"is_diff": is_diff, "world": {"collision_objects": [item]}, "link_padding": links}
    return to_message(PlanningScene, content)


def test_motions_are_judged_and_verified_ones_passed_on(client: Client, motion: hplan.PlanResult) -> None:
    from moveit_msgs.msg import DisplayTrajectory, RobotTrajectory
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    with node_process("judge", "--ros-args", "-p", "scene:=table-1", "-p", "robot:=harvester"):
        verdicts = client.collect(String, f"{JUDGE}/verdict")
        relayed = client.collect(JointTrajectory, f"{JUDGE}/verified_trajectory")
        shown = client.collect(DisplayTrajectory, f"{JUDGE}/verified_display_trajectory")
        plain = client.connect(client.node.create_publisher(JointTrajectory, f"{JUDGE}/trajectory", 10))
        display = client.connect(client.node.create_publisher(DisplayTrajectory, f"{JUDGE}/display_trajectory", 10))
        good, bad = (to_message(JointTrajectory, each(motion)) for each in (around, through))
        plain.publish(good)
        client.wait(lambda: len(verdicts) == 1 and relayed)
        verdict = json.loads(verdicts[0].data)
        assert verdict["verified"]
        assert verdict["clearance_m"] == pytest.approx(motion.certificate.min_clearance_m, abs=1e-4)
        assert relayed[0] == good
        plain.publish(bad)
        client.wait(lambda: len(verdicts) == 2)
        verdict = json.loads(verdicts[1].data)
        assert not verdict["verified"]
        assert verdict["obstacle"] == "ball"
        assert verdict["depth_m"] > 0.0
        assert 0.0 < verdict["time_s"] < 4.0
        for message in (good, bad):
            display.publish(DisplayTrajectory(trajectory=[RobotTrajectory(joint_trajectory=message)]))
        client.wait(lambda: len(verdicts) == 4)
        client.spin(0.2)
        assert [json.loads(each.data)["verified"] for each in verdicts[2:]] == [True, False]
        assert len(relayed) == len(shown) == 1


def test_planning_scene_gives_the_obstacles(client: Client, motion: hplan.PlanResult) -> None:
    from moveit_msgs.msg import PlanningScene
    from moveit_msgs.srv import GetPlanningScene
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    scene = hplan.load_scene("table-1")
    asked: list[Any] = []

    def answer(request: Any, response: Any) -> Any:
        asked.append(request.components.components)
        response.scene = planning_scene(scene)
        return response

    fetched = client.node.create_service(GetPlanningScene, "get_planning_scene", answer)
    with node_process("judge", "--ros-args", "-p", "robot:=harvester", end=signal.SIGTERM):
        verdicts = client.collect(String, f"{JUDGE}/verdict")
        plain = client.connect(client.node.create_publisher(JointTrajectory, f"{JUDGE}/trajectory", 10))
        updates = client.connect(client.node.create_publisher(PlanningScene, "planning_scene", 10))
        client.wait(lambda: asked)
        client.spin(0.2)
        bad = to_message(JointTrajectory, through(motion))
        plain.publish(bad)
        client.wait(lambda: len(verdicts) == 1)
        assert json.loads(verdicts[0].data)["obstacle"] == "moveit ball"
        updates.publish(planning_scene(scene, is_diff=True, operation=b"\1"))
        client.spin(0.3)
        plain.publish(bad)
        client.wait(lambda: len(verdicts) == 2)
        assert json.loads(verdicts[1].data)["verified"]
        updates.publish(planning_scene(scene, is_diff=True, operation=b"\3"))  # moves an object that is gone
        client.spin(0.3)
        plain.publish(bad)
        client.wait(lambda: len(verdicts) == 3)
        assert "expected a known object to move" in json.loads(verdicts[2].data)["violations"][0]
    client.node.destroy_service(fetched)


def test_controller_gets_verified_goals_only(client: Client, motion: hplan.PlanResult) -> None:
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient, ActionServer
    from sensor_msgs.msg import JointState

    received: list[Any] = []

    def run(goal: Any) -> Any:
        received.append(goal.request.trajectory)
        goal.succeed()
        return FollowJointTrajectory.Result(error_string="done")

    controller = ActionServer(client.node, FollowJointTrajectory, "/arm/follow_joint_trajectory", run)
    with node_process("judge", "--ros-args", "-p", "scene:=table-1", "-p", "robot:=harvester",
                      "-p", "controller:=/arm/follow_joint_trajectory"):  # fmt: skip
        guard = ActionClient(client.node, FollowJointTrajectory, f"{JUDGE}/follow_joint_trajectory")
        client.wait(guard.server_is_ready)
        states = client.connect(client.node.create_publisher(JointState, "joint_states", 10))
        names, start = list(motion.trajectory.joint_names), motion.trajectory.position[0]
        goals = ((start + 0.1, around, False), (start, through, False), (start, around, True))
        for here, make, accepted in goals:
            states.publish(JointState(name=names, position=here.tolist()))
            client.spin(0.5)
            content = make(motion)
            goal = to_message(FollowJointTrajectory.Goal, {"trajectory": content})
            answer = guard.send_goal_async(goal)
            client.wait(answer.done)
            assert answer.result().accepted is accepted
        result = answer.result().get_result_async()
        client.wait(result.done)
        assert result.result().result.error_string == "done"
        assert len(received) == 1
        np.testing.assert_array_equal(received[0].points[-1].positions, motion.trajectory.position[-1])
        guard.destroy()
    controller.destroy()


def test_undecided_motions_are_held_back(client: Client, motion: hplan.PlanResult) -> None:
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    late = ("-p", "deadline_s:=1e-6")
    with node_process("judge", "--ros-args", "-p", "scene:=table-1", "-p", "robot:=harvester", *late):
        verdicts = client.collect(String, f"{JUDGE}/verdict")
        relayed = client.collect(JointTrajectory, f"{JUDGE}/verified_trajectory")
        plain = client.connect(client.node.create_publisher(JointTrajectory, f"{JUDGE}/trajectory", 10))
        plain.publish(to_message(JointTrajectory, around(motion)))
        client.wait(lambda: verdicts)
        client.spin(0.2)
        assert json.loads(verdicts[0].data)["violations"] == ["not decided within 1e-06 s"]
        assert not relayed


def test_robot_from_its_topics_and_joints_at_rest(client: Client, motion: hplan.PlanResult) -> None:
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
    from trajectory_msgs.msg import JointTrajectory

    from hplan.apps.ros import robot_description
    from hplan.apps.ros.node import latched

    robot = hplan.load_robot()
    publisher = client.node.create_publisher(String, "robot_description", latched(rclpy))
    publisher.publish(String(data=robot_description(robot)))
    with node_process("judge", "--ros-args", "-p", "scene:=table-1"):
        verdicts = client.collect(String, f"{JUDGE}/verdict")
        plain = client.connect(client.node.create_publisher(JointTrajectory, f"{JUDGE}/trajectory", 10))
        states = client.connect(client.node.create_publisher(JointState, "joint_states", 10))
        part = through(motion)
        part["joint_names"] = part["joint_names"][:1]
        for point in part["points"]:
            point["positions"], point["velocities"] = point["positions"][:1], [0.0]
        plain.publish(to_message(JointTrajectory, part))
        client.wait(lambda: len(verdicts) == 1)
        assert "the message moves" in json.loads(verdicts[0].data)["violations"][0]
        start = motion.trajectory.position[0].tolist()
        states.publish(JointState(name=list(robot.joint_names), position=start))
        client.spin(0.3)
        plain.publish(to_message(JointTrajectory, part))
        client.wait(lambda: len(verdicts) == 2)
        assert "the message moves" not in " ".join(json.loads(verdicts[1].data)["violations"])
    client.node.destroy_publisher(publisher)


def test_planning_scenes_from_the_wire() -> None:
    """Octomap, matrix, padding, bytes and attached objects, serialized and read again by rclpy."""
    from moveit_msgs.msg import PlanningScene
    from rclpy.serialization import deserialize_message, serialize_message

    message = planning_scene(hplan.load_scene("table-1"))
    tree = {"binary": True, "id": "OcTree", "resolution": 0.1, "data": array("b", [3, 0] * 15 + [2, 0])}
    matrix = {"entry_names": ["a", "b"], "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}]}
    world = {"octomap": {"header": {"frame_id": "world"}, "octomap": tree}}
    more = {"is_diff": True, "world": world, "allowed_collision_matrix": matrix}
    more["link_padding"] = [{"link_name": "a", "padding": 0.01}]
    updates = SceneUpdates(leave_out=("link_padding",))
    for each in (message, to_message(PlanningScene, more)):
        updates.apply(deserialize_message(serialize_message(each), PlanningScene))
    assert [item.name for item in updates.obstacles] == ["moveit ball", "octomap 1"]
    assert updates.padding_m == 0.01
    held = {"link_name": "hand", "object": {"id": "moveit ball", "operation": b"\0"}}
    attached = {"is_diff": True, "robot_state": {"attached_collision_objects": [held]}}
    with pytest.raises(SceneError, match="'moveit ball' is attached to link 'hand'"):
        updates.apply(deserialize_message(serialize_message(to_message(PlanningScene, attached)), PlanningScene))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "robt:=panda"], "robt = 'panda': expected a parameter of this node; did you mean 'robot'"),
        (["-p", "clearance_m:=near"], "clearance_m"),
        (["-p", "robot:=harvester", "-p", "clearance_m:=-1.0"], "clearance_m"),
        (["-p", "robot:=nothing.urdf"], "nothing.urdf"),
    ],
)
def test_wrong_parameters(arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]) -> None:
    import subprocess
    import sys

    command = [sys.executable, "-m", "hplan.apps.cli", "ros", "judge", "--ros-args", *arguments]
    found = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False)
    assert found.returncode == 2
    assert words in found.stderr
