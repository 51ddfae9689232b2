"""ROS 2 messages, bags, octomaps and MoveIt scenes, without a ROS installation; nodes, with one.

Readers take message objects of rclpy and rosbags, dicts and files; written messages are plain dicts, and `to_message`
makes objects of them where ROS is installed. MCAP files are for Foxglove and RViz; obstacles are read from MoveIt
scenes, octomaps and clouds in bags. MCAP files and bags need `rosbags` (the extra `ros`), imported when one is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hplan.base.lazy_import import lazy_names

if TYPE_CHECKING:
    from hplan.apps.ros.bag_cloud import cloud_points, read_bag_cloud
    from hplan.apps.ros.fields import to_message
    from hplan.apps.ros.joint_messages import (
        from_joint_trajectory,
        joint_trajectories,
        to_joint_state,
        to_joint_trajectory,
        write_joint_trajectory,
    )
    from hplan.apps.ros.marked_scene import scene_markers
    from hplan.apps.ros.mcap_file import write_mcap
    from hplan.apps.ros.moveit_scene import read_moveit_scene
    from hplan.apps.ros.octomap import read_octomap
    from hplan.apps.ros.planning_scene import read_attached, read_planning_scene
    from hplan.apps.ros.scene_updates import SceneUpdates
    from hplan.apps.ros.transforms import robot_description

__all__ = [
    "SceneUpdates",
    "cloud_points",
    "from_joint_trajectory",
    "joint_trajectories",
    "read_attached",
    "read_bag_cloud",
    "read_moveit_scene",
    "read_octomap",
    "read_planning_scene",
    "robot_description",
    "scene_markers",
    "to_joint_state",
    "to_joint_trajectory",
    "to_message",
    "write_joint_trajectory",
    "write_mcap",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.apps.ros.bag_cloud": "cloud_points read_bag_cloud",
        "hplan.apps.ros.fields": "to_message",
        "hplan.apps.ros.joint_messages": "from_joint_trajectory joint_trajectories to_joint_state to_joint_trajectory "
        "write_joint_trajectory",
        "hplan.apps.ros.marked_scene": "scene_markers",
        "hplan.apps.ros.mcap_file": "write_mcap",
        "hplan.apps.ros.moveit_scene": "read_moveit_scene",
        "hplan.apps.ros.octomap": "read_octomap",
        "hplan.apps.ros.planning_scene": "read_attached read_planning_scene",
        "hplan.apps.ros.scene_updates": "SceneUpdates",
        "hplan.apps.ros.transforms": "robot_description",
    },
)
