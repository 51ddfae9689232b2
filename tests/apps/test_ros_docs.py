"""The commands of the page on ROS 2, run as nodes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from ros_client import Client, need_ros, node_process

need_ros()

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = re.findall(r"^hplan (ros .*)$", (ROOT / "docs" / "ros2.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("line", COMMANDS)
def test_command_of_the_page_runs(line: str) -> None:
    """Each command starts a node that offers what the page says; it ends with status 0."""
    import rclpy
    from std_msgs.msg import String

    import hplan
    from hplan.apps.ros import robot_description
    from hplan.apps.ros.node import latched

    client = Client()
    try:
        description = client.node.create_publisher(String, "robot_description", latched(rclpy))
        description.publish(String(data=robot_description(hplan.load_robot())))
        _, *words = shlex.split(line)
        with node_process(*words):
            topics = {"judge": "/display_planned_path", "plan": "/camera/depth/points"}
            client.wait(lambda: client.node.count_subscribers(topics[words[0]]))
    finally:
        client.close()


def test_page_has_commands_of_both_nodes() -> None:
    assert {line.split()[1] for line in COMMANDS} == {"judge", "plan"}


def test_launch_file_starts_the_nodes_with_arguments_that_they_take() -> None:
    """`launch` has no wheel: the topics of its file are names that the nodes know."""
    text = (ROOT / "scripts" / "ros" / "hplan.launch.py").read_text(encoding="utf-8")
    for topic in ("planning_scene", "~/display_trajectory", "points"):
        assert f'"{topic}"' in text
