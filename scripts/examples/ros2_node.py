#!/usr/bin/env python3
"""A ROS 2 node: a depth camera's cloud comes in, a certified motion goes out as the action `FollowJointTrajectory`.

    python scripts/examples/ros2_node.py --ros-args -r points:=/camera/depth/points -r joint_states:=/joint_states \
        -p scene:=cell.yaml -p controller:=/joint_trajectory_controller/follow_joint_trajectory

It needs a workspace with rclpy, control_msgs, sensor_msgs and std_srvs. The cloud is to be in `base_link` (let tf2 turn
it). `ros2 service call /plan std_srvs/srv/Trigger` plans from where the arm is to the scene's goal, among what the
camera has seen, and sends the motion. `points_of` and `goal_of` are all that knows of messages, and need no ROS.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

import hplan
from hplan.apps.ros import to_joint_trajectory
from hplan.scene import Start

#: Radius of the ball about each point of the cloud [m].
RADIUS_M = 0.01


def points_of(cloud: Any) -> np.ndarray:
    """The (n, 3) points of a `sensor_msgs/msg/PointCloud2`, with NaN where there is none [m]."""
    order = ">" if cloud.is_bigendian else "<"
    fields = {field.name: (field.offset, f"{order}f{4 if field.datatype == 7 else 8}") for field in cloud.fields}
    offsets, formats = zip(*(fields[axis] for axis in "xyz"), strict=True)
    kind = np.dtype({"names": list("xyz"), "formats": formats, "offsets": offsets, "itemsize": cloud.point_step})
    rows = np.frombuffer(bytes(cloud.data), np.uint8).reshape(cloud.height, cloud.row_step)
    points = np.ascontiguousarray(rows[:, : cloud.width * cloud.point_step]).reshape(-1).view(kind)
    return np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)


def configuration_of(robot: hplan.Robot, state: Any) -> np.ndarray | None:
    """The (dof,) configuration in a `sensor_msgs/msg/JointState`; None where a joint is missing."""
    at = dict(zip(state.name, state.position, strict=False))
    return np.array([at[name] for name in robot.joint_names]) if set(robot.joint_names) <= set(at) else None


def goal_of(motion: hplan.PlanResult) -> dict[str, Any]:
    """A `control_msgs/action/FollowJointTrajectory` goal as a dict: begun as soon as it is received."""
    return {"trajectory": to_joint_trajectory(motion.trajectory, effort=False)}


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
            self.robot, self.joints = hplan.load_robot(scene.robot), None
            self.planner = hplan.Planner(self.robot, scene)
            hplan.warm_up(self.robot)
            controller = self.declare_parameter("controller", "/follow_joint_trajectory").value
            self.client = ActionClient(self, FollowJointTrajectory, controller)
            self.create_subscription(JointState, "joint_states", self.at, qos_profile_sensor_data)
            self.create_subscription(PointCloud2, "points", self.seen, qos_profile_sensor_data)
            self.create_service(Trigger, "plan", self.plan)

        def at(self, state: Any) -> None:
            self.joints = configuration_of(self.robot, state)

        def seen(self, cloud: Any) -> None:
            report = self.planner.set_cloud("camera", points_of(cloud), radius=RADIUS_M, joints=self.joints)
            self.get_logger().debug(str(report))

        def plan(self, _: Any, answer: Any) -> Any:
            try:
                if self.joints is not None:
                    self.planner.aim(start=Start(joints_rad=self.joints))
                motion = self.planner.plan()
            except hplan.HplanError as error:
                answer.success, answer.message = False, str(error)
                return answer
            goal = FollowJointTrajectory.Goal()
            set_message_fields(goal, goal_of(motion))
            self.client.send_goal_async(goal)
            clearance = 1e3 * motion.certificate.min_clearance_m
            answer.success = True
            answer.message = f"{motion.trajectory.duration:.3f} s, clearance {clearance:.2f} mm or more at all times"
            return answer

    rclpy.init(args=sys.argv)
    rclpy.spin(PlanningNode())


if __name__ == "__main__":
    main()
