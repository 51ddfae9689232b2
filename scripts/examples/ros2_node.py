#!/usr/bin/env python3
"""A ROS 2 node from depth clouds to certified `FollowJointTrajectory` goals.

    python scripts/examples/ros2_node.py --ros-args -r points:=/camera/depth/points -r joint_states:=/joint_states \
        -p scene:=cell.yaml -p controller:=/joint_trajectory_controller/follow_joint_trajectory

It needs a workspace with rclpy, control_msgs, sensor_msgs and std_srvs. The cloud must be in `base_link` (transform it
with tf2). `ros2 service call /plan std_srvs/srv/Trigger` plans from the arm's current state to the scene's goal, among
the points that the camera has seen, and sends the motion. The arm's state is the last position of each joint, from any
message; if one is missing or old, nothing is planned. The log has the controller's answer and the result. All message
handling is in `points_of`, `ArmState`, `goal_of` and `outcome_of`, which need no ROS.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np

import hplan
from hplan.apps.ros import cloud_points, to_joint_trajectory
from hplan.scene import Start

#: Radius of the ball about each point of the cloud [m].
RADIUS_M = 0.01

#: Maximum age of a joint's last position [s].
MAX_AGE_S = 0.5

#: The error codes of `control_msgs/action/FollowJointTrajectory`.
ERROR_CODES = {
    0: "successful",
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "old header timestamp",
    -4: "path tolerance violated",
    -5: "goal tolerance violated",
}


class ArmState:
    """The last position of each joint, from all messages, with its age."""

    def __init__(self, robot: hplan.Robot) -> None:
        self._robot = robot
        self._seen: dict[str, tuple[float, float]] = {}

    def see(self, state: Any, now_s: float) -> None:
        """Take the joints of the arm out of a `sensor_msgs/msg/JointState`; other joints, as a gripper's, stay out."""
        for name, position in zip(state.name, state.position, strict=False):
            if name in self._robot.joint_names and math.isfinite(position):
                self._seen[name] = float(position), now_s

    def configuration(self, now_s: float) -> np.ndarray:
        """The (dof,) configuration; an `InputError` names a joint that was never seen, or not lately."""
        for name in self._robot.joint_names:
            if name not in self._seen:
                raise hplan.errors.InputError(f"no joint state has had joint {name!r} yet")
            age_s = now_s - self._seen[name][1]
            if age_s > MAX_AGE_S:
                raise hplan.errors.InputError(f"the last state of joint {name!r} is {age_s:.2f} s old")
        return np.array([self._seen[name][0] for name in self._robot.joint_names])


def goal_of(motion: hplan.PlanResult) -> dict[str, Any]:
    """A `FollowJointTrajectory` goal as a dict, with immediate start.

    The type is `control_msgs/action/FollowJointTrajectory`.
    """
    return {"trajectory": to_joint_trajectory(motion.trajectory)}


def outcome_of(result: Any) -> tuple[bool, str]:
    """Success of a `FollowJointTrajectory` result, and its message."""
    meaning = ERROR_CODES.get(result.error_code, f"error code {result.error_code}")
    return result.error_code == 0, ": ".join(text for text in (meaning, result.error_string) if text)


def main() -> None:
    """Spin the node until it is interrupted."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from rosidl_runtime_py import set_message_fields
    from sensor_msgs.msg import JointState, PointCloud2
    from std_srvs.srv import Trigger

    class PlanningNode(Node):
        def __init__(self) -> None:
            super().__init__("hplan")
            scene = hplan.load_scene(self.declare_parameter("scene", "orchard-row").value)
            self.robot = hplan.load_robot(scene.robot)
            self.arm, self.goal = ArmState(self.robot), None
            self.planner = hplan.Planner(self.robot, scene)
            hplan.warm_up(self.robot)
            controller = self.declare_parameter("controller", "/follow_joint_trajectory").value
            self.client = ActionClient(self, FollowJointTrajectory, controller)
            self.create_subscription(JointState, "joint_states", self.at, qos_profile_sensor_data)
            self.create_subscription(PointCloud2, "points", self.seen, qos_profile_sensor_data)
            self.create_service(Trigger, "plan", self.plan)

        def at(self, state: Any) -> None:
            self.arm.see(state, time.monotonic())

        def seen(self, cloud: Any) -> None:
            try:
                joints = self.arm.configuration(time.monotonic())
                report = self.planner.set_cloud("camera", cloud_points(cloud), radius=RADIUS_M, joints=joints)
            except hplan.HplanError as error:
                self.get_logger().warning(f"cloud not taken: {error}")
                return
            self.get_logger().debug(str(report))

        def plan(self, _: Any, answer: Any) -> Any:
            if self.goal is not None:  # the arm is in motion, and a motion from rest would jump
                answer.success, answer.message = (
                    False,
                    "the controller has not finished the last goal, or not answered it",
                )
                return answer
            try:
                self.planner.aim(start=Start(joints_rad=self.arm.configuration(time.monotonic())))
                motion = self.planner.plan()
            except hplan.HplanError as error:
                answer.success, answer.message = False, str(error)
                return answer
            goal = FollowJointTrajectory.Goal()
            set_message_fields(goal, goal_of(motion))
            self.goal = self.client.send_goal_async(goal)
            if self.goal is not None:
                self.goal.add_done_callback(self.answered)
            clearance = 1e3 * motion.certificate.min_clearance_m
            answer.success = True
            answer.message = f"{motion.trajectory.duration:.3f} s, clearance {clearance:.2f} mm or more at all times"
            return answer

        def answered(self, answer: Any) -> None:
            handle = answer.result()
            if handle.accepted:
                handle.get_result_async().add_done_callback(self.ended)
                return
            self.goal = None
            self.get_logger().error("the controller rejected the goal; its log says why")

        def ended(self, answer: Any) -> None:
            self.goal = None
            is_done, words = outcome_of(answer.result().result)
            log = self.get_logger()
            (log.info if is_done else log.error)(f"the controller's result: {words}")

    rclpy.init(args=sys.argv)
    try:
        rclpy.spin(PlanningNode())
    except KeyboardInterrupt:
        pass
    except Exception as error:
        from rclpy.executors import ExternalShutdownException

        if not isinstance(error, ExternalShutdownException):  # Ctrl-C where rclpy takes the signal itself
            raise
    finally:
        # Releases before Humble have no `try_shutdown`.
        getattr(rclpy, "try_shutdown", lambda: None)()


if __name__ == "__main__":
    main()
