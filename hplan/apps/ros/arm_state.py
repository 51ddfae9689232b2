"""State of an arm from `sensor_msgs/msg/JointState` messages, which may each have only some of its joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hplan.apps.ros.fields import fields_of
from hplan.base.arrays import FloatArray
from hplan.errors import InputError


class ArmState:
    """The last position of each joint, from all messages, with its age.

    Examples:
        >>> arm = ArmState(("shoulder", "elbow"))
        >>> arm.see({"name": ["finger", "elbow"], "position": [0.02, 1.5]}, 10.0)
        >>> arm.see({"name": ["shoulder"], "position": [0.5]}, 10.1)
        >>> arm.configuration(10.2).tolist()
        [0.5, 1.5]
    """

    def __init__(self, joint_names: Sequence[str], *, prefix: str = "", max_age_s: float = 0.5) -> None:
        """Start without any position.

        Args:
            joint_names: The arm's joints.
            prefix: Prefix of the joints' names in messages.
            max_age_s: Maximum age of a joint's position [s].
        """
        self._names = tuple(joint_names)
        self._prefix, self._max_age_s = prefix, max_age_s
        self._seen: dict[str, tuple[float, float]] = {}

    def see(self, state: Any, now_s: float) -> None:
        """Take all finite positions of a `JointState`, also those of joints that are not the arm's.

        Args:
            state: An object of rclpy or rosbags, or a dict.
            now_s: Time of the state [s].
        """
        fields = fields_of(state)
        for name, position in zip(fields["name"], fields["position"], strict=False):
            if math.isfinite(position):
                self._seen[name.removeprefix(self._prefix)] = float(position), now_s

    @property
    def positions(self) -> Mapping[str, float]:
        """Last position of each joint that was seen [rad, m if prismatic]."""
        return {name: position for name, (position, _) in self._seen.items()}

    def configuration(self, now_s: float) -> FloatArray:
        """The (dof,) configuration of the arm.

        Args:
            now_s: The time now [s].

        Raises:
            InputError: A joint was never seen, or not within the maximum age; names it.
        """
        for name in self._names:
            if name not in self._seen:
                raise InputError(f"no joint state has had joint {name!r} yet", joint=name)
            age_s = now_s - self._seen[name][1]
            if age_s > self._max_age_s:
                raise InputError(f"the last state of joint {name!r} is {age_s:.2f} s old", joint=name)
        return np.array([self._seen[name][0] for name in self._names])

    def seen_s(self) -> float:
        """Time of the oldest of the last positions of the arm's joints [s]; minus infinity if one was never seen."""
        return min((self._seen.get(name, (0.0, -math.inf))[1] for name in self._names), default=-math.inf)
