"""A ROS client for tests of hplan's nodes, which run as processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import ros_interfaces


def need_ros() -> None:
    """Skip a test file without rclpy; build the packages that have no wheels, and put them on the path."""
    pytest.importorskip("rclpy", reason="ROS is not installed: pip install 'hplan[ros2]'")
    missing = ros_interfaces.missing_tool()
    if missing:
        pytest.skip(missing, allow_module_level=True)
    sys.path.insert(0, str(ros_interfaces.build(ros_interfaces.default_folder())))
    # Only on this machine, and apart from other test processes.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(10 + os.getpid() % 90)


@contextmanager
def node_process(*arguments: str, end: int = signal.SIGINT) -> Iterator[subprocess.Popen[str]]:
    """A node of `hplan ros`, ended by a signal; its exit status must be 0."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", "hplan.apps.cli", "ros", *arguments]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        # A killed node would stay in the discovery of the next test.
        process.send_signal(end)
        try:
            errors = process.communicate(timeout=30)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            errors = process.communicate()[1]
    assert process.returncode == 0, errors


class Client:
    """A node of the test's own process that waits for messages.

    Attributes:
        node: The node.
    """

    def __init__(self, name: str = "test_client") -> None:
        import rclpy

        rclpy.init()
        self._rclpy = rclpy
        self.node = rclpy.create_node(name)
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def collect(self, kind: Any, topic: str, quality: Any = 10) -> list[Any]:
        """A list that receives the messages of a topic."""
        found: list[Any] = []
        self.node.create_subscription(kind, topic, found.append, quality)
        return found

    def wait(self, done: Callable[[], Any], most_s: float = 60.0) -> Any:
        """Spin until a function returns something true; return that."""
        end = time.monotonic() + most_s
        while time.monotonic() < end:
            found = done()
            if found:
                return found
            self._executor.spin_once(timeout_sec=0.05)
        raise AssertionError("nothing arrived in time")

    def spin(self, duration_s: float) -> None:
        """Spin for a while."""
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=max(0.0, end - time.monotonic()))

    def connect(self, publisher: Any, subscribers: int = 1) -> Any:
        """Wait until a publisher has subscribers; return it."""
        self.wait(lambda: publisher.get_subscription_count() >= subscribers)
        return publisher

    def call(self, kind: Any, name: str, request: Any = None) -> Any:
        """Answer of a service."""
        client = self.node.create_client(kind, name)
        self.wait(client.service_is_ready)
        answer = client.call_async(kind.Request() if request is None else request)
        self.wait(answer.done)
        return answer.result()

    def close(self) -> None:
        """Destroy the node, and end ROS in this process."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()
