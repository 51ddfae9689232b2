"""A ROS node that judges the motions of any planner, and passes on only those that are verified.

| topic | type | content |
|---|---|---|
| `~/trajectory` | `trajectory_msgs/msg/JointTrajectory` | in: motions |
| `~/robot_trajectory`, `~/display_trajectory` | `moveit_msgs/msg/RobotTrajectory`, `DisplayTrajectory` | in: motions |
| `~/verified_trajectory`, ... | the same types | out: motions that are verified, unchanged |
| `~/verdict` | `std_msgs/msg/String` | out: a `Verdict` as JSON for each motion, in order |
| `planning_scene` | `moveit_msgs/msg/PlanningScene` | in: obstacles, whole or differences |
| `joint_states` | `sensor_msgs/msg/JointState` | in: positions of joints that a motion does not move |
| `/diagnostics` | `diagnostic_msgs/msg/DiagnosticArray` | out: the last verdict and the counts |

With `controller`, the node also serves `~/follow_joint_trajectory`: goals that are not verified, or do not begin where
the arm is, are rejected; others are handed on to the controller's action, with feedback, cancellation and result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hplan.apps.ros.judge import Judge, JudgeOptions, Verdict
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
    load_arm,
    need_message,
    read_parameters,
    run_node,
    watch_scene,
)
from hplan.base.checked import Options
from hplan.errors import HplanError

#: Types of motions, by the name of their topic.
MOTIONS = {
    "trajectory": "trajectory_msgs/msg/JointTrajectory",
    "robot_trajectory": "moveit_msgs/msg/RobotTrajectory",
    "display_trajectory": "moveit_msgs/msg/DisplayTrajectory",
}

#: Default distance of the arm from the start of a motion that a controller runs [rad, m], as in MoveIt.
START_TOLERANCE = 0.01

_ACTION = "control_msgs/action/FollowJointTrajectory"


@dataclass(frozen=True)
class RelayOptions(Options):
    """Parameters of the judge's connections.

    Attributes:
        controller: Action of the controller that verified goals are handed on to; empty for none. The arm must then be
            at the start of a motion, within `start_tolerance` or, if that is 0, 0.01 rad.
        fetch_scene: Whether the node asks `get_planning_scene` for the whole planning scene at the start.
    """

    controller: str = ""
    fetch_scene: bool = True


#: Dataclasses of the node's parameters.
PARAMETERS = (RobotOptions, JudgeOptions, RelayOptions, NodeOptions)


def make_node() -> Any:
    """The node, in the process's default context; call after `rclpy.init`.

    Raises:
        HplanError: A parameter is invalid, or the robot or the scene cannot be loaded.
    """
    rclpy = import_ros()
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    class JudgeNode(rclpy.node.Node):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__("hplan_judge")
            self.of_robot, self.of_judge, self.of_relay, of_node = read_parameters(self, *PARAMETERS)
            if self.of_relay.controller and self.of_judge.start_tolerance == 0.0:
                self.of_judge = self.of_judge.with_values(start_tolerance=START_TOLERANCE)
            robot, scene = load_arm(self, self.of_robot)
            self.updates = watch_scene(self, self.of_robot, self.see_scene, fetch=self.of_relay.fetch_scene)
            self.judge = Judge(robot, scene, self.of_judge, updates=self.updates)
            self.counts = {"verified": 0, "refused": 0}
            self.last: Verdict | None = None
            self.warm_up(robot)
            self.verdicts = self.create_publisher(String, "~/verdict", DEPTH)
            sensor = rclpy.qos.qos_profile_sensor_data
            self.create_subscription(JointState, "joint_states", self.see_joints, sensor)
            topics = []
            for topic, name in MOTIONS.items():
                kind = find_message(name)
                if kind is not None:
                    relay = self.create_publisher(kind, f"~/verified_{topic}", DEPTH)
                    topics.append(self.create_subscription(kind, f"~/{topic}", self._receiver(relay), DEPTH).topic_name)
            self.guard = None
            if self.of_relay.controller:
                self.guard = _Guard(self, self.of_relay.controller)
            self.diagnostics = Diagnostics(self, of_node, self.state)
            names = ", ".join(robot.joint_names)
            self.get_logger().info(f"judging motions of {robot.name!r}, joints {names}, on {', '.join(topics)}")

        def warm_up(self, robot: Any) -> None:
            """Judge a motion once, so that the first verdict is as fast as the others."""
            rest = {name: 0.5 * (a + b) for name, a, b in zip(robot.joint_names, robot.lower, robot.upper, strict=True)}
            point = {"positions": list(rest.values()), "velocities": [0.0] * robot.dof}
            points = [{**point, "time_from_start": {"sec": second, "nanosec": 0}} for second in (0, 1)]
            prefix = self.of_judge.joint_prefix
            Judge(robot, self.judge.scene, self.of_judge).judge(
                {"joint_names": [prefix + name for name in rest], "points": points}
            )

        def see_joints(self, state: Any) -> None:
            self.judge.arm.see(state, 0.0)

        def see_scene(self, message: Any) -> None:
            assert self.updates is not None
            try:
                self.updates.apply(message)
            except HplanError as error:
                self.get_logger().warning(f"planning scene not taken: {error}", throttle_duration_sec=5.0)

        def give_verdict(self, message: Any) -> bool:
            """Judge a message and publish the verdict; True if it is verified."""
            verdict = self.last = self.judge.judge(message)
            self.counts["verified" if verdict.verified else "refused"] += 1
            self.verdicts.publish(String(data=verdict.to_json()))
            if not verdict.verified:
                self.get_logger().warning(f"not verified: {'; '.join(verdict.violations)}")
            return verdict.verified

        def state(self) -> tuple[bytes, str, dict[str, Any]]:
            values: dict[str, Any] = dict(self.counts)
            if self.last is None:
                return WARN, "no motion has arrived", values
            values |= {name: getattr(self.last, name) for name in ("link", "obstacle", "distance_m", "time_s", "limit")}
            if self.last.verified:
                return OK, "the last motion is verified", values
            return ERROR, f"not verified: {self.last.violations[0]}", values

        def close(self) -> None:
            """End what `destroy_node` does not."""
            if self.guard is not None:
                self.guard.close()

        def _receiver(self, relay: Any) -> Any:
            def receive(message: Any) -> None:
                if self.give_verdict(message):
                    relay.publish(message)

            return receive

    return JudgeNode()


class _Guard:
    """An action server in front of a controller's, which rejects goals that are not verified."""

    def __init__(self, node: Any, controller: str) -> None:
        from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse

        self._node, self._kind = node, need_message(_ACTION, "the parameter controller")
        self._client = ActionClient(node, self._kind, controller)
        self._handles: dict[bytes, Any] = {}

        def judge(goal: Any) -> Any:
            if not self._client.server_is_ready():
                node.get_logger().error(f"the controller's action {controller} is not there")
                return GoalResponse.REJECT
            return GoalResponse.ACCEPT if node.give_verdict(goal) else GoalResponse.REJECT

        def cancel(goal: Any) -> Any:
            handle = self._handles.get(bytes(goal.goal_id.uuid))
            if handle is not None:
                handle.cancel_goal_async()
            return CancelResponse.ACCEPT

        self._server = ActionServer(
            node, self._kind, "~/follow_joint_trajectory", self._run, goal_callback=judge, cancel_callback=cancel
        )

    async def _run(self, goal: Any) -> Any:
        """Hand a verified goal on, and its result back."""
        from action_msgs.msg import GoalStatus

        def forward(message: Any) -> None:
            if goal.is_active:
                goal.publish_feedback(message.feedback)

        handle = await self._client.send_goal_async(goal.request, feedback_callback=forward)
        if not handle.accepted:
            goal.abort()
            return self._kind.Result(error_code=-1, error_string="the controller rejected the goal; its log says why")
        key = bytes(goal.goal_id.uuid)
        self._handles[key] = handle
        answer = await handle.get_result_async()
        del self._handles[key]
        if answer.status == GoalStatus.STATUS_SUCCEEDED:
            goal.succeed()
        elif answer.status == GoalStatus.STATUS_CANCELED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return answer.result

    def close(self) -> None:
        self._server.destroy()
        self._client.destroy()


def main(ros_arguments: Sequence[str] = ()) -> int:
    """Run the node until it is interrupted; returns the exit status."""
    return run_node(make_node, ros_arguments)
