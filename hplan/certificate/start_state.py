"""State of motion at the start of a scene's motion.

The state is checked against the robot, and a motion against the state.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hplan.base.arrays import frozen
from hplan.errors import InputError, StartStateError
from hplan.optimization.timed_spline import BoundaryState
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory

#: A state may exceed a limit by this factor, as a motion may.
_LIMIT_FACTOR = 1.001


def start_state(robot: Robot, scene: Scene) -> BoundaryState | None:
    """The state in which the scene's motion starts; None for rest.

    Raises:
        InputError: The number of velocities or accelerations is not the number of joints.
        StartStateError: A value exceeds its joint's limit, or a locked joint moves.
        JointLimitError: The start configuration is outside the limits.
    """
    start = scene.start
    if not start.is_moving:
        return None
    position = robot.check_configuration(robot.joints_of(start, "start"), "start")
    locked = robot.locked_mask(scene.locked_joints)
    rates = []
    for quantity, key, limit in (
        ("velocity", "velocity_rad_s", robot.velocity_limit),
        ("acceleration", "acceleration_rad_s2", robot.acceleration_limit),
    ):
        values = np.array(start.rates.get(key, (0.0,) * robot.dof))
        if len(values) != robot.dof:
            raise InputError(f"start: expected {robot.dof} values of {key}, got {len(values)}", expected=robot.dof)
        beyond = np.flatnonzero((np.abs(values) > _LIMIT_FACTOR * limit) | (locked & (values != 0.0)))
        if len(beyond):
            joint = int(beyond[0])
            raise StartStateError(
                robot.joint_names[joint],
                quantity,
                float(values[joint]),
                float(limit[joint]),
                getattr(robot.units[joint], quantity),
                locked=bool(locked[joint]),
            )
        rates.append(frozen(values))
    return BoundaryState(position, *rates)


def start_violations(robot: Robot, scene: Scene, trajectory: Trajectory) -> Iterator[str]:
    """Messages on differences between the motion's first state and the scene's start.

    The motion's first sample and first segment are checked. There are no messages if the scene starts at rest.

    Raises:
        InputError: The number of velocities or accelerations is not the number of joints.
        StartStateError: A value exceeds its joint's limit, or a locked joint moves.
        JointLimitError: The start configuration is outside the limits.
    """
    state = start_state(robot, scene)
    if state is None:
        return
    speeds, pushes = [trajectory.velocity[0], trajectory.end_velocities[0]], [trajectory.acceleration[0]]
    if trajectory.samples > 1:
        bezier, duration = trajectory.segments
        degree = bezier.shape[1] - 1.0
        pushes.append(degree * (degree - 1.0) * (bezier[0, 2] - 2.0 * bezier[0, 1] + bezier[0, 0]) / duration[0] ** 2)
    # Tolerances of velocities [rad/s] and accelerations [rad/s^2].
    same_velocity, same_acceleration = 1e-6, 1e-3
    for what, found, asked, same in (
        ("velocity", speeds, state.velocity, same_velocity),
        ("acceleration", pushes, state.acceleration, same_acceleration),
    ):
        off = np.abs(np.array(found) - asked).max(axis=0)
        joint = int(np.where(np.isnan(off), np.inf, off).argmax())
        if not off[joint] <= same:
            unit = getattr(robot.units[joint], what)
            yield (
                f"the motion begins with the {what} of joint {robot.joint_names[joint]!r} {off[joint]:.4g} {unit} off "
                "that of the scene's start"
            )
