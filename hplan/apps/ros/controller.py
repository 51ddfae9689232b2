"""Commands to a controller: as goals of `FollowJointTrajectory`, or as messages on a topic.

Goals, answers and results of `control_msgs/action/FollowJointTrajectory` as dicts and words need no ROS.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from hplan.apps.ros.fields import fields_of, to_message
from hplan.apps.ros.joint_messages import to_joint_trajectory
from hplan.apps.ros.transforms import SECOND_NS, message_time, time_ns
from hplan.errors import InputError

if TYPE_CHECKING:
    from hplan.apps.ros.session import Command

#: Error codes of `control_msgs/action/FollowJointTrajectory`.
ERROR_CODES: Final = {
    0: "successful",
    -1: "invalid goal",
    -2: "invalid joints",
    -3: "old header timestamp",
    -4: "path tolerance violated",
    -5: "goal tolerance violated",
}


def outcome_of(result: Any) -> tuple[bool, str]:
    """Success of a `FollowJointTrajectory` result, and its message.

    Examples:
        >>> outcome_of({"error_code": -5, "error_string": "elbow is 0.1 off"})
        (False, 'goal tolerance violated: elbow is 0.1 off')
    """
    fields = fields_of(result)
    meaning = ERROR_CODES.get(fields["error_code"], f"error code {fields['error_code']}")
    words = ": ".join(text for text in (meaning, fields["error_string"]) if text)
    return fields["error_code"] == 0, words


def command_message(command: Command, epoch_ns: int = 0, prefix: str = "") -> dict[str, Any]:
    """A command as a `trajectory_msgs/msg/JointTrajectory`.

    Args:
        command: The command.
        epoch_ns: Zero of the command's clock on the controller's [ns].
        prefix: Prepended to every joint name.
    """
    stamp_ns = epoch_ns + time_ns("begins_s", command.begins_s)
    message = to_joint_trajectory(command.trajectory, prefix=prefix, stamp_s=stamp_ns / SECOND_NS)
    message["header"]["stamp"] = message_time(stamp_ns)
    return message


class _Topic:
    """Publishes motions on `joint_trajectory`; each counts as accepted, and as done when its time is over."""

    def __init__(self, node: Any, prefix: str) -> None:
        from trajectory_msgs.msg import JointTrajectory

        self._node, self._kind, self._prefix = node, JointTrajectory, prefix
        self._timer: Any = None
        self._publisher = node.create_publisher(JointTrajectory, "joint_trajectory", 10)

    def check(self) -> None:
        """Raise an `InputError` if nobody listens."""
        if not self._publisher.get_subscription_count():
            raise InputError(f"no controller listens on {self._publisher.topic_name}")

    def send(self, command: Command, epoch_ns: int) -> None:
        """Send a command."""
        self._publisher.publish(to_message(self._kind, command_message(command, epoch_ns, self._prefix)))
        self._node.accepted(command.number)
        if self._timer is not None:
            self._node.destroy_timer(self._timer)

        def end() -> None:
            self._node.destroy_timer(timer)
            self._node.ended(command.number, is_done=True, words="its time is over")

        timer = self._timer = self._node.create_timer(max(command.ends_s - self._node.now_s(), 1e-3), end)

    def cancel(self) -> None:
        """A topic has nothing to cancel."""

    def close(self) -> None:
        """A topic has nothing to end."""


class _Action:
    """Sends motions as goals; answers and results come back to the node."""

    def __init__(self, node: Any, name: str, prefix: str) -> None:
        from rclpy.action import ActionClient

        from hplan.apps.ros.node import need_message

        kind = need_message("control_msgs/action/FollowJointTrajectory", "output:=action (output:=topic does not)")
        self._node, self._kind, self._prefix, self._name = node, kind, prefix, name
        self._client = ActionClient(node, kind, name)
        self._running: Any = None

    def check(self) -> None:
        """Raise an `InputError` if there is no action server."""
        if not self._client.server_is_ready():
            raise InputError(f"the controller's action {self._name} is not there")

    def send(self, command: Command, epoch_ns: int) -> None:
        """Send a command."""
        goal = to_message(self._kind.Goal, {"trajectory": command_message(command, epoch_ns, self._prefix)})
        answer = self._client.send_goal_async(goal)
        answer.add_done_callback(lambda done: self._answered(command.number, done.result()))

    def _answered(self, number: int, handle: Any) -> None:
        if not handle.accepted:
            self._node.rejected(number)
            return
        self._running = handle
        self._node.accepted(number)
        handle.get_result_async().add_done_callback(lambda done: self._ended(number, done.result()))

    def _ended(self, number: int, answer: Any) -> None:
        from action_msgs.msg import GoalStatus

        is_done, words = outcome_of(answer.result)
        if answer.status != GoalStatus.STATUS_SUCCEEDED:
            names = {GoalStatus.STATUS_CANCELED: "canceled", GoalStatus.STATUS_ABORTED: "aborted"}
            is_done, words = False, f"{names.get(answer.status, answer.status)}: {words}"
        self._node.ended(number, is_done=is_done, words=words)

    def cancel(self) -> None:
        """Ask the controller to end the last accepted goal in its own way."""
        if self._running is not None:
            self._running.cancel_goal_async()

    def close(self) -> None:
        """Destroy the client."""
        self._client.destroy()


def topic_controller(node: Any, name: str, prefix: str) -> _Topic:
    """A controller that reads a topic; the name of its action does not matter."""
    del name
    return _Topic(node, prefix)


def action_controller(node: Any, name: str, prefix: str) -> _Action:
    """A controller that serves an action.

    Raises:
        InputError: control_msgs is not installed.
    """
    return _Action(node, name, prefix)
