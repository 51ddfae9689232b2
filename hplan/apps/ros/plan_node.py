"""A ROS node that plans: joint states, clouds and planning scenes in, certified motions out.

| topic or service | type | content |
|---|---|---|
| `joint_states` | `sensor_msgs/msg/JointState` | in: the arm's state |
| `points` | `sensor_msgs/msg/PointCloud2` | in: obstacles, in any frame that `/tf` connects with the base |
| `planning_scene` | `moveit_msgs/msg/PlanningScene` | in: obstacles, whole or differences |
| `~/goal` | `sensor_msgs/msg/JointState` | in: a goal by joint names; plans, or splices into the running motion |
| `~/goal_pose` | `geometry_msgs/msg/PoseStamped` | in: a goal for the tool frame, in the frame of the base |
| `~/plan`, `~/stop` | `std_srvs/srv/Trigger` | services: plan to the last goal; stop on the path |
| `joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | out: motions, with `output:=topic` |
| `~/status` | `std_msgs/msg/String` | out: each event as JSON |
| `~/markers` | `visualization_msgs/msg/MarkerArray` | out: arm, path, clearance, and what blocks |
| `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | out: the last event and the counts |

With `output:=action` (the default) motions are goals of `control_msgs/action/FollowJointTrajectory`. A frame of the
camera, or a planning scene, that invalidates the running motion leads to a splice, or else to a stop.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from hplan.apps.ros.bag_cloud import cloud_points
from hplan.apps.ros.controller import action_controller, topic_controller
from hplan.apps.ros.fields import to_message
from hplan.apps.ros.frame_tree import FrameTree, stamp_seconds
from hplan.apps.ros.marked_arm import arm_markers, motion_markers, problem_markers
from hplan.apps.ros.node import (
    DEPTH,
    ERROR,
    OK,
    WARN,
    Diagnostics,
    NodeOptions,
    RobotOptions,
    find_message,
    import_ros,
    latched,
    load_arm,
    read_parameters,
    run_node,
    watch_scene,
)
from hplan.apps.ros.session import Command, Session, SessionOptions
from hplan.apps.ros.transforms import SECOND_NS, LinkFrames
from hplan.base.checked import NotNegative, Options
from hplan.errors import HplanError, InputError
from hplan.online.warm_up import warm_up
from hplan.scene.model import Goal

#: How long the last message of a node may take to be sent [s].
_SENDING_S = 0.2


@dataclass(frozen=True)
class OutputOptions(Options):
    """Parameters of the node's connections.

    Attributes:
        output: `action` for goals of `FollowJointTrajectory`, `topic` for a `JointTrajectory` topic.
        controller: Name of the controller's action.
        joint_prefix: Prefix of the joints' names in messages.
        base_frame: Frame of the robot's base in `/tf`; empty for its root link.
        points_reliable: Whether clouds are requested without losses; no clouds then arrive from a camera that publishes
            with best effort.
        points_depth: Maximum number of clouds that wait while a motion is planned; with 1, the newest replaces others
            that wait. With more, none is skipped, and a reaction may be later.
        tf_tolerance_s: Maximum difference between the times of a cloud and of its transforms [s].
        replan: Whether clouds and planning scenes may change the running motion.
        fetch_scene: Whether the node asks `get_planning_scene` for the whole planning scene at the start.
        markers: Whether markers are published.
        warm_up: Whether all kernels are loaded before the node takes messages.
    """

    output: Literal["action", "topic"] = "action"
    controller: str = "joint_trajectory_controller/follow_joint_trajectory"
    joint_prefix: str = ""
    base_frame: str = ""
    points_reliable: bool = False
    points_depth: Annotated[int, Field(ge=1)] = 1
    tf_tolerance_s: NotNegative = 0.2
    replan: bool = True
    fetch_scene: bool = True
    markers: bool = True
    warm_up: bool = True


#: Dataclasses of the node's parameters.
PARAMETERS = (RobotOptions, SessionOptions, OutputOptions, NodeOptions)


def make_node() -> Any:
    """The node, in the process's default context; call after `rclpy.init`.

    Raises:
        HplanError: A parameter is invalid, the robot or the scene cannot be loaded, or a package is missing.
    """
    rclpy = import_ros()
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import JointState, PointCloud2
    from std_msgs.msg import String
    from std_srvs.srv import Trigger
    from visualization_msgs.msg import MarkerArray

    class PlanNode(rclpy.node.Node):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__("hplan_planner")
            self.of_robot, of_session, self.of_output, of_node = read_parameters(self, *PARAMETERS)
            self.robot, scene = load_arm(self, self.of_robot)
            if self.of_output.warm_up:
                warm_up(self.robot)
            self.base_frame = self.of_output.base_frame or LinkFrames(self.robot).root
            # The session counts from the node's start: stamps stay exact to the nanosecond.
            self.epoch_ns = self.get_clock().now().nanoseconds
            prefix = self.of_output.joint_prefix
            self.session = Session(self.robot, scene, of_session, self.now_s, prefix=prefix)
            self.frames = FrameTree(tolerance_s=self.of_output.tf_tolerance_s)
            self.counts: dict[str, int] = {}
            self.last_event: dict[str, Any] = {}
            self.status = self.create_publisher(String, "~/status", DEPTH)
            self.markers = self.create_publisher(MarkerArray, "~/markers", latched(rclpy, DEPTH))
            make = action_controller if self.of_output.output == "action" else topic_controller
            self.controller = make(self, self.of_output.controller, prefix)
            self.updates = watch_scene(self, self.of_robot, self.see_scene, fetch=self.of_output.fetch_scene)
            if self.updates is not None:
                self.take_obstacles()
            sensor = rclpy.qos.qos_profile_sensor_data
            self.create_subscription(JointState, "joint_states", self.see_joints, sensor)
            policy = rclpy.qos.ReliabilityPolicy
            reliability = policy.RELIABLE if self.of_output.points_reliable else policy.BEST_EFFORT
            waiting = rclpy.qos.QoSProfile(depth=self.of_output.points_depth, reliability=reliability)
            clouds = self.create_subscription(PointCloud2, "points", self.see_points, waiting)
            self._watch_frames(rclpy)
            goals = self.create_subscription(JointState, "~/goal", self.see_goal, DEPTH)
            self.create_subscription(PoseStamped, "~/goal_pose", self.see_goal_pose, DEPTH)
            self.create_service(Trigger, "~/plan", self.plan)
            self.create_service(Trigger, "~/stop", self.stop)
            self.diagnostics = Diagnostics(self, of_node, self.state)
            self.show(arm_markers(self.robot))
            self.get_logger().info(
                f"planning for {self.robot.name!r}, joints {', '.join(self.robot.joint_names)}; goals on "
                f"{goals.topic_name}, clouds on {clouds.topic_name}"
            )

        def now_s(self) -> float:
            """Time since the node's start [s]."""
            passed_ns: int = self.get_clock().now().nanoseconds - self.epoch_ns
            return passed_ns / SECOND_NS

        def session_s(self, stamp: Any) -> float:
            """A message's time since the node's start; the time now for a message without one [s]."""
            if not stamp.sec and not stamp.nanosec:
                return self.now_s()
            passed_ns: int = stamp.sec * SECOND_NS + stamp.nanosec - self.epoch_ns
            return min(passed_ns / SECOND_NS, self.now_s())

        def see_joints(self, state: Any) -> None:
            self.session.arm.see(state, self.session_s(state.header.stamp))

        def see_points(self, cloud: Any) -> None:
            """Take a cloud, and replan if it invalidates the running motion."""
            began = time.perf_counter()
            try:
                frame = cloud.header.frame_id.removeprefix("/")
                pose = None
                if frame and frame != self.base_frame:
                    pose = self.frames.pose(self.base_frame, frame, stamp_seconds(cloud.header.stamp)).homogeneous
                self.session.see_cloud(cloud_points(cloud), pose, self.session_s(cloud.header.stamp))
            except HplanError as error:
                self.note("cloud refused", error=error)
                return
            self.count("clouds")
            self.react(began)

        def see_scene(self, message: Any) -> None:
            """Take a planning scene, and replan if it invalidates the running motion."""
            began = time.perf_counter()
            assert self.updates is not None
            try:
                self.updates.apply(message)
            except HplanError as error:
                self.note("planning scene refused", error=error)
            self.take_obstacles()
            self.react(began)

        def take_obstacles(self) -> None:
            """Give the planner the obstacles of the planning scene."""
            assert self.updates is not None
            try:
                self.session.set_obstacles(self.updates.obstacles, self.updates.padding_m, self.updates.attached)
                self.session.fault = ""
            except HplanError as error:
                self.session.fault = error.message

        def see_goal(self, state: Any) -> None:
            """Plan to joint values."""
            prefix = self.of_output.joint_prefix
            given = {name.removeprefix(prefix): value for name, value in zip(state.name, state.position, strict=False)}
            if sorted(given) != sorted(self.robot.joint_names):
                names = ", ".join(self.robot.joint_names)
                self.note("goal refused", error=InputError(f"the goal has {', '.join(given)}; the joints are {names}"))
                return
            values = np.array([given[name] for name in self.robot.joint_names])
            if not np.isfinite(values).all():
                self.note("goal refused", error=InputError(f"the goal is not finite: {values.tolist()}"))
                return
            self.go(Goal(joints_rad=tuple(values.tolist())))

        def see_goal_pose(self, stamped: Any) -> None:
            """Plan to a pose of the tool frame."""
            at, turn = stamped.pose.position, stamped.pose.orientation
            try:
                frame = stamped.header.frame_id.removeprefix("/")
                if frame not in ("", self.base_frame):
                    raise InputError(f"the goal is in frame {frame!r}, expected {self.base_frame!r}")
                goal = Goal(position=(at.x, at.y, at.z), quaternion_xyzw=(turn.x, turn.y, turn.z, turn.w))
            except HplanError as error:
                self.note("goal refused", error=error)
                return
            self.go(goal)

        def go(self, goal: Goal | None = None) -> tuple[bool, str]:
            """Plan, or splice; returns success and a message."""
            try:
                self.controller.check()
                before = self.session.sent
                command = self.session.move(goal)
            except HplanError as error:
                self.note("not planned", error=error)
                return False, error.message
            if command is before:
                return True, "the running motion is kept"
            self.send(command)
            clearance = command.certificate.min_clearance_m
            words = "no obstacles" if math.isinf(clearance) else f"clearance {1e3 * clearance:.2f} mm or more"
            return True, f"{command.kind} of {command.trajectory.duration:.3f} s, {words} at all times"

        def plan(self, _: Any, answer: Any) -> Any:
            answer.success, answer.message = self.go()
            return answer

        def stop(self, _: Any, answer: Any) -> Any:
            command = self.session.stop()
            answer.success, answer.message = True, "nothing runs that is not stopping"
            if command is not None:
                self.send(command)
                answer.message = f"at rest in {command.ends_s - self.now_s():.3f} s"
            return answer

        def react(self, began: float) -> None:
            """Replace the running motion if it is no longer certified; the message arrived at `began` [s]."""
            if self.of_output.replan:
                command = self.session.react()
                if command is not None:
                    self.send(command, began)

        def send(self, command: Command, began: float | None = None) -> None:
            """Send a command, and show it."""
            self.controller.send(command, self.epoch_ns)
            reaction_ms = None if began is None else round(1e3 * (time.perf_counter() - began), 3)
            certificate = command.certificate
            self.note(
                "sent", kind=command.kind, number=command.number, duration_s=command.trajectory.duration,
                clearance_m=certificate.min_clearance_m, verified=certificate.verified, reason=command.reason,
                reaction_ms=reaction_ms,
            )  # fmt: skip
            self.show(motion_markers(self.robot, command.trajectory, certificate, self.base_frame))

        def rejected(self, number: int) -> None:
            """React to a command that the controller rejected."""
            was_stop = self.session.sent is not None and self.session.sent.kind == "stop"
            command = self.session.reject(number)
            self.note("rejected", number=number, level=ERROR)
            if command is not None:
                self.send(command)
            elif was_stop:
                self.controller.cancel()

        def accepted(self, number: int) -> None:
            self.session.accept(number)
            self.note("accepted", number=number)

        def ended(self, number: int, *, is_done: bool, words: str) -> None:
            """Note the result of a command; results of commands that were replaced say nothing."""
            if self.session.end(number):
                self.note("done" if is_done else "aborted", number=number, result=words,
                          level=OK if is_done else ERROR)  # fmt: skip

        def count(self, event: str) -> None:
            self.counts[event] = self.counts.get(event, 0) + 1

        def note(
            self, event: str, *, error: HplanError | None = None, level: bytes | None = None, **facts: Any
        ) -> None:
            """Publish an event on `~/status`, and errors in the log."""
            self.count(event)
            level = (OK if error is None else WARN) if level is None else level
            content = {"event": event, "time_s": round(self.now_s(), 6), **facts}
            if error is not None:
                content |= {"error": type(error).__name__, "message": error.message}
                named = {key: getattr(error, key, None) for key in ("link", "obstacle")}
                content |= {key: name for key, name in named.items() if isinstance(name, str)}
                self.get_logger().warning(f"{event}: {error}", throttle_duration_sec=1.0)
                self.show(problem_markers(self.robot, self.session.planner.scene, error, self.base_frame))
            self.last_event = {"level": level, **content}
            finite = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in content.items()}
            self.status.publish(String(data=json.dumps(finite, default=str)))

        def state(self) -> tuple[bytes, str, Mapping[str, Any]]:
            if self.session.fault:
                return ERROR, self.session.fault, self.counts
            if not self.last_event:
                return OK, "waiting", self.counts
            words = self.last_event.get("message") or self.last_event.get("result") or ""
            return self.last_event["level"], f"{self.last_event['event']} {words}".strip(), self.counts

        def show(self, markers: Sequence[Mapping[str, Any]]) -> None:
            """Publish markers."""
            if self.of_output.markers and markers:
                self.markers.publish(to_message(MarkerArray, {"markers": list(markers)}))

        def close(self) -> None:
            """Stop the arm."""
            command = self.session.stop("the node ends")
            if command is not None:
                self.send(command)
                time.sleep(_SENDING_S)
            self.controller.close()

        def _watch_frames(self, rclpy: Any) -> None:
            kind, depth = find_message("tf2_msgs/msg/TFMessage"), 100
            if kind is not None:
                see, static = self.frames.see, latched(rclpy, depth)
                self.create_subscription(kind, "/tf", lambda each: see(each.transforms, is_static=False), depth)
                self.create_subscription(kind, "/tf_static", lambda each: see(each.transforms, is_static=True), static)

    return PlanNode()


def main(ros_arguments: Sequence[str] = ()) -> int:
    """Run the node until it is interrupted; returns the exit status."""
    return run_node(make_node, ros_arguments)
