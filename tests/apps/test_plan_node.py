"""`hplan ros plan` on the real middleware, with a controller of the test."""

from __future__ import annotations

import json
import time
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from ros_client import Client, need_ros, node_process

import hplan
from hplan.apps.ros import to_message

need_ros()

NODE, ACTION = "/hplan_planner", "/arm/follow_joint_trajectory"
#: A slow motion, and times that hold on a busy machine.
SLOW = ("-p", "scene:=table-1", "-p", "robot:=harvester", "-p", "warm_up:=false", "-p", "speed:=0.2")
FAR = (*SLOW, "-p", "ahead_s:=0.8", "-p", "max_state_age_s:=60.0")


class ControllerNode:
    """A joint_trajectory_controller: a new goal takes over; joint states at 200 Hz.

    Attributes:
        goals: Trajectories of accepted goals.
        answers: Whether each following goal is accepted; True once it is used up.
        results: Error code of goals that reach their end.
    """

    def __init__(self, client: Client, q: np.ndarray) -> None:
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionServer, CancelResponse, GoalResponse
        from rclpy.task import Future
        from sensor_msgs.msg import JointState

        self.client, self.q, self.names = client, q, hplan.load_robot().joint_names
        self.goals: list[Any] = []
        self.answers: list[bool] = []
        self.error_code = 0
        self._handle: Any = None
        self._outcome: Any = None
        self._future = Future
        self._kind, self._state = FollowJointTrajectory, JointState
        self.server = ActionServer(
            client.node, FollowJointTrajectory, ACTION, self._run,
            goal_callback=lambda _: GoalResponse.ACCEPT if self._next_answer() else GoalResponse.REJECT,
            handle_accepted_callback=self._accepted, cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.states = client.node.create_publisher(JointState, "joint_states", 10)
        self.timer = client.node.create_timer(0.005, self._update)

    def _next_answer(self) -> bool:
        return self.answers.pop(0) if self.answers else True

    def _accepted(self, handle: Any) -> None:
        self._end("abort")
        self.goals.append(handle.request.trajectory)
        self._handle, self._outcome = handle, self._future()
        handle.execute()

    def _end(self, outcome: str) -> None:
        if self._handle is not None:
            self._handle = None
            self._outcome.set_result(outcome)

    def _now(self) -> float:
        return self.client.node.get_clock().now().nanoseconds * 1e-9

    def _update(self) -> None:
        if self._handle is not None:
            motion = self._handle.request.trajectory
            stamp = motion.header.stamp
            clock = self._now() - stamp.sec - 1e-9 * stamp.nanosec
            times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in motion.points]
            rows = np.array([p.positions for p in motion.points])
            self.q = np.array([np.interp(clock, times, column) for column in rows.T])
            if self._handle.is_cancel_requested:
                self._end("canceled")
            elif clock > times[-1]:
                self._end("abort" if self.error_code else "succeed")
        state = self._state(name=list(self.names), position=self.q.tolist())
        state.header.stamp = self.client.node.get_clock().now().to_msg()
        self.states.publish(state)

    async def _run(self, handle: Any) -> Any:
        outcome = await self._outcome
        getattr(handle, outcome)()
        return self._kind.Result(error_code=self.error_code)

    def close(self) -> None:
        self.client.node.destroy_timer(self.timer)
        self.client.node.destroy_publisher(self.states)
        self.server.destroy()


@pytest.fixture(scope="module")
def client() -> Iterator[Client]:
    found = Client()
    yield found
    found.close()


@pytest.fixture
def controller(client: Client) -> Iterator[ControllerNode]:
    scene = hplan.load_scene("table-1")
    found = ControllerNode(client, np.array(scene.start.configuration))
    yield found
    found.close()


class Planning:
    """The interfaces of a planning node."""

    def __init__(self, client: Client) -> None:
        from sensor_msgs.msg import JointState
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        self.client, self._trigger, self._goal = client, Trigger, JointState
        self.events_of = client.collect(String, f"{NODE}/status")
        self.goals = client.node.create_publisher(JointState, f"{NODE}/goal", 10)
        client.connect(self.goals)
        client.spin(0.5)

    @property
    def events(self) -> list[dict[str, Any]]:
        return [json.loads(each.data) for each in self.events_of]

    def names(self) -> list[str]:
        return [each["event"] for each in self.events]

    def wait(self, event: str, count: int = 1) -> dict[str, Any]:
        self.client.wait(lambda: self.names().count(event) >= count)
        return [each for each in self.events if each["event"] == event][-1]

    def go_to(self, q: Any) -> None:
        self.goals.publish(self._goal(name=list(hplan.load_robot().joint_names), position=list(map(float, q))))

    def call(self, name: str) -> Any:
        return self.client.call(self._trigger, f"{NODE}/{name}")


def cloud(points: np.ndarray, frame: str, stamp: Any) -> Any:
    from sensor_msgs.msg import PointCloud2

    fields = [{"name": axis, "offset": 4 * k, "datatype": 7, "count": 1} for k, axis in enumerate("xyz")]
    data = points.astype(np.float32)
    message = to_message(
        PointCloud2, {"header": {"frame_id": frame}, "height": 1, "width": len(data), "fields": fields,
                      "point_step": 12, "row_step": 12 * len(data), "is_dense": True},
    )  # fmt: skip
    message.header.stamp = stamp
    message.data = array("B", data.tobytes())
    return message


def test_motion_is_accepted_and_reaches_its_goal(client: Client, controller: ControllerNode) -> None:
    import rclpy
    from visualization_msgs.msg import MarkerArray

    from hplan.apps.ros.node import latched

    scene = hplan.load_scene("table-1")
    with node_process("plan", "--ros-args", *FAR, "-p", f"controller:={ACTION}"):
        planning = Planning(client)
        markers = client.collect(MarkerArray, f"{NODE}/markers", latched(rclpy, 10))
        answer = planning.call("plan")
        assert answer.success, answer.message
        assert "clearance" in answer.message
        planning.wait("done")
        assert planning.names() == ["sent", "accepted", "done"]
        goal = hplan.load_robot().joints_of(scene.goal, "goal", scene.start)
        np.testing.assert_allclose(controller.q, goal, atol=1e-3)
        spaces = {marker.ns for message in markers for marker in message.markers}
        assert spaces >= {"arm", "certificate"}
        planning.go_to([9.0, 0.0, 0.0, 0.0])
        assert planning.wait("not planned")["message"]
        assert len(controller.goals) == 1


def test_rejected_and_aborted_goals_are_noted(client: Client, controller: ControllerNode) -> None:
    with node_process("plan", "--ros-args", *FAR, "-p", f"controller:={ACTION}"):
        planning = Planning(client)
        controller.answers = [False]
        assert planning.call("plan").success
        planning.wait("rejected")
        controller.error_code = -4
        assert planning.call("plan").success
        assert "path tolerance violated" in planning.wait("aborted")["result"]


def test_new_goal_is_a_splice_and_a_stop_comes_to_rest(client: Client, controller: ControllerNode) -> None:
    scene = hplan.load_scene("table-1")
    start = np.array(scene.start.configuration)
    with node_process("plan", "--ros-args", *FAR, "-p", f"controller:={ACTION}"):
        planning = Planning(client)
        planning.call("plan")
        planning.wait("accepted")
        client.spin(0.4)
        planning.go_to(start + np.array([0.0, 0.1, 0.1, 0.1]))
        client.wait(lambda: len(controller.goals) == 2 or "not planned" in planning.names())
        assert "not planned" not in planning.names(), planning.events
        assert planning.wait("sent", 2)["kind"] == "splice"
        client.spin(0.3)
        assert planning.call("stop").success
        assert planning.wait("sent", 3)["kind"] == "stop"
        planning.wait("done")
        # A splice that the controller rejects leaves the motion before it, which is then stopped.
        assert planning.call("plan").success
        planning.wait("accepted", 4)
        client.spin(0.2)
        controller.answers = [False]
        planning.go_to(start)
        planning.wait("rejected")
        assert planning.wait("sent", 6)["kind"] == "stop"
        assert "rejected" in planning.events[-1].get("reason", "") or planning.names()[-1] in ("accepted", "done")
        planning.wait("done", 2)


def test_cloud_in_the_way_makes_the_arm_give_way(client: Client, controller: ControllerNode) -> None:
    from sensor_msgs.msg import PointCloud2
    from tf2_msgs.msg import TFMessage

    from hplan.apps.ros.transforms import transform_message

    robot = hplan.load_robot()
    with node_process("plan", "--ros-args", *FAR, "-p", f"controller:={ACTION}"):
        planning = Planning(client)
        clouds = client.connect(client.node.create_publisher(PointCloud2, "points", 1))
        transforms = client.connect(client.node.create_publisher(TFMessage, "/tf", 10))
        assert planning.call("plan").success
        planning.wait("accepted")
        (motion,) = controller.goals
        # A wall that a camera 1 m to the side sees, across the tool's last position.
        at = robot.tool_positions(np.array([motion.points[-1].positions]))[0]
        wall = at + np.random.default_rng(0).uniform(-0.03, 0.03, (500, 3))
        stamp = client.node.get_clock().now()
        message = transform_message("base_link", "camera", np.eye(3), (0.0, 1.0, 0.0), stamp.nanoseconds)
        transforms.publish(to_message(TFMessage, {"transforms": [message]}))
        client.spin(0.1)
        clouds.publish(cloud(wall - [0.0, 1.0, 0.0], "camera", stamp.to_msg()))
        assert planning.wait("sent", 2)["kind"] == "stop"  # the goal itself is blocked
        planning.wait("done")
        assert np.linalg.norm(robot.tool_positions(controller.q[None])[0] - at) > 0.05
        planning.call("plan")
        assert planning.wait("not planned")["message"]


def test_no_cloud_is_skipped_if_they_may_wait(client: Client) -> None:
    from sensor_msgs.msg import PointCloud2

    words = (*SLOW, "-p", "output:=topic", "-p", "points_reliable:=true", "-p", "points_depth:=10")
    with node_process("plan", "--ros-args", *words):
        planning = Planning(client)
        clouds = client.connect(client.node.create_publisher(PointCloud2, "points", 10))
        for _ in range(8):  # in a frame that nobody knows: each is an event
            clouds.publish(cloud(np.ones((20_000, 3)), "nowhere", client.node.get_clock().now().to_msg()))
        planning.wait("cloud refused", 8)
        client.node.destroy_publisher(clouds)


def test_topic_output_and_stop_at_the_end(client: Client) -> None:
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory

    scene = hplan.load_scene("table-1")
    states = client.node.create_publisher(JointState, "joint_states", 10)
    found = client.collect(JointTrajectory, "joint_trajectory")
    names = [f"left_{name}" for name in hplan.load_robot().joint_names]
    with node_process("plan", "--ros-args", *FAR, "-p", "output:=topic", "-p", "joint_prefix:=left_"):
        planning = Planning(client)
        assert "no joint state" in planning.call("plan").message
        for _ in range(3):
            states.publish(JointState(name=names, position=list(map(float, scene.start.configuration))))
            client.spin(0.05)
        assert planning.call("plan").success
        client.wait(lambda: found)
        assert list(found[0].joint_names) == names
        client.spin(0.3)
    client.wait(lambda: len(found) == 2)  # the node stopped the arm as it ended
    assert not np.any(found[1].points[-1].velocities)
    late = time.time() - found[1].header.stamp.sec
    assert 0.0 < late < 30.0
