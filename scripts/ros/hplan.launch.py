"""Launch file for a node of hplan.

    ros2 launch scripts/ros/hplan.launch.py node:=judge parameters:=judge.yaml

The file of parameters has the usual form, `/**: {ros__parameters: {robot: panda}}`.
"""

from __future__ import annotations

from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration


def generate_launch_description() -> Any:
    """The node as a process: `hplan` is a command, not a ROS package."""
    names = {
        "node": ("judge", "judge or plan"),
        "parameters": ("/dev/null", "YAML file of parameters"),
        "planning_scene": ("/monitored_planning_scene", "topic of MoveIt's planning scene"),
        "motions": ("/display_planned_path", "topic of motions to judge (DisplayTrajectory)"),
        "points": ("/camera/depth/points", "topic of clouds to plan with"),
    }
    declared = [
        DeclareLaunchArgument(key, default_value=value, description=text) for key, (value, text) in names.items()
    ]
    command: list[Any] = ["hplan", "ros", LaunchConfiguration("node"), "--ros-args"]
    command += ["--params-file", LaunchConfiguration("parameters")]
    topics = {"planning_scene": "planning_scene", "~/display_trajectory": "motions", "points": "points"}
    for topic, name in topics.items():
        command += ["-r", [f"{topic}:=", LaunchConfiguration(name)]]
    node = ExecuteProcess(cmd=command, output="screen", sigterm_timeout="10")
    return LaunchDescription([*declared, node])
