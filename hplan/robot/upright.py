"""The tool axis that stays upright, and its tilt."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.errors import TiltedError
from hplan.robot.model import Robot
from hplan.scene.model import Scene


class UprightTool(NamedTuple):
    """A tool axis with a maximum tilt.

    Attributes:
        axis: (3,) unit vector in the tool frame.
        up: (3,) unit vector in `base_link`; the tilt is measured from it.
        max_tilt_rad: Maximum angle between the two [rad].
    """

    axis: tuple[float, ...]
    up: tuple[float, ...]
    max_tilt_rad: float

    @classmethod
    def vertical_at(cls, robot: Robot, q: FloatArray, max_tilt_rad: float) -> UprightTool:
        """Return the axis that is vertical at a (dof,) configuration.

        The vertical is against gravity, and z without gravity.
        """
        gravity = np.array(robot.model.gravity.linear)
        up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
        axis = robot.forward_kinematics(q)[:3, :3].T @ up
        return cls(tuple(axis.tolist()), tuple(up.tolist()), max_tilt_rad)

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene) -> UprightTool | None:
        """Return the axis and the maximum tilt of a scene; None if the tool may tilt.

        Raises:
            InputError: The scene's start is not a configuration of the robot.
        """
        upright = scene.upright
        if upright is None:
            return None
        start = robot.check_configuration(robot.joints_of(scene.start, "start"), "start")
        found = cls.vertical_at(robot, start, math.radians(upright.max_tilt_deg))
        if upright.axis is None:
            return found
        length = math.hypot(*upright.axis)
        return found._replace(axis=tuple(value / length for value in upright.axis))

    def tilt_of(self, pose: FloatArray) -> float:
        """Return the tilt at a (4, 4) pose of the tool frame [rad]."""
        axis, up = pose[:3, :3] @ np.array(self.axis), np.array(self.up)
        return math.atan2(float(np.linalg.norm(np.cross(axis, up))), float(axis @ up))

    def check(self, robot: Robot, q: FloatArray, which: str, deviation: float = 0.0) -> None:
        """Refuse a configuration with too large a tilt.

        Args:
            robot: The arm.
            q: (dof,) configuration.
            which: Name of the configuration, for the error.
            deviation: Tracking error of each joint, which adds to the tilt [rad].

        Raises:
            TiltedError: The tilt is not below the maximum.
        """
        tilt = self.tilt_of(robot.forward_kinematics(q)) + deviation * robot.slides.count(False)
        if not tilt < self.max_tilt_rad:
            raise TiltedError(which, tilt, self.max_tilt_rad)


def with_fixed_axis(robot: Robot, scene: Scene) -> Scene:
    """Return the scene with its upright axis written out, so that another start does not change it.

    The same scene if it has one, or no `upright`.
    """
    tool = UprightTool.of_scene(robot, scene)
    if tool is None or scene.upright is None or scene.upright.axis is not None:
        return scene
    return scene.copy_unchecked({"upright": scene.upright.copy_unchecked({"axis": tool.axis})})
