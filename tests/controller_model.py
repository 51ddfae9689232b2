"""A model of ROS 2's `joint_trajectory_controller`, after its documentation and source (`trajectory.cpp`).

A message replaces the one before it; its points count from its stamp, or from its first sample if the stamp is 0;
between the state at its first sample and its first point, and between points, the curve is a quintic, a cubic or a
straight line by the fields that both points have. No code of hplan is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

from hplan.base.arrays import FloatArray


def _ns(time: Mapping[str, int]) -> int:
    return int(time["sec"]) * 10**9 + int(time["nanosec"])


class Controller:
    """The controller with a position interface; its state is the last command."""

    def __init__(self, joint_names: tuple[str, ...], position: FloatArray) -> None:
        self.joint_names = list(joint_names)
        self.state = np.asarray(position, dtype=np.float64), np.zeros(len(joint_names))
        self._points: list[FloatArray] = []
        self._times: list[int] = []
        self._start_ns: int | None = None
        self._before: tuple[int, FloatArray] | None = None

    def receive(self, message: Mapping[str, Any], now_ns: int) -> None:
        """Accept a message; a ValueError gives the reason of a rejection."""
        points, stamp = message["points"], _ns(message["header"]["stamp"])
        times = [_ns(point["time_from_start"]) for point in points]
        if sorted(message["joint_names"]) != sorted(self.joint_names) or not points:
            raise ValueError("joint names, or no points")
        if any(point["effort"] for point in points):
            raise ValueError("efforts without an effort interface")
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError("times do not increase")
        if stamp and stamp + times[-1] < now_ns:
            raise ValueError("the trajectory ends in the past")
        order = [message["joint_names"].index(name) for name in self.joint_names]
        fields = ("positions", "velocities", "accelerations")
        self._points = [np.array([point[f] for f in fields if point[f]])[:, order] for point in points]
        self._times, self._start_ns, self._before = times, stamp or None, None

    def update(self, now_ns: int) -> tuple[FloatArray, FloatArray]:
        """Commanded position and velocity of a cycle."""
        if not self._points:
            return self.state
        if self._start_ns is None:
            self._start_ns = now_ns
        if self._before is None:
            self._before = now_ns, np.stack(self.state)
        at = now_ns - self._start_ns
        if at < self._times[0]:
            first = self._start_ns + self._times[0]
            self.state = _between(*self._before, first, self._points[0], now_ns)
        elif at >= self._times[-1]:
            last = self._points[-1]
            self.state = last[0], last[1] if len(last) > 1 else np.zeros_like(last[0])
        else:
            k = int(np.searchsorted(self._times, at, side="right")) - 1
            self.state = _between(self._times[k], self._points[k], self._times[k + 1], self._points[k + 1], at)
        return self.state


def _between(a_ns: int, first: FloatArray, b_ns: int, second: FloatArray, at_ns: int) -> tuple[FloatArray, FloatArray]:
    """Position and velocity between two points, by the fields that both have."""
    count, seconds = min(len(first), len(second)), 1e-9 * (b_ns - a_ns)
    curve = BPoly.from_derivatives([0.0, seconds], [first[:count], second[:count]])
    at = 1e-9 * (at_ns - a_ns)
    return curve(at), curve(at, 1)
