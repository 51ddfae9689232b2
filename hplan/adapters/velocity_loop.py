"""A loop of joint velocities, as pink and mink solve for them, that can stop without contact at any time.

Differential inverse kinematics gives a velocity for the next period only. A `VelocityLoop` approaches it as far as a
certificate permits: for each period it certifies the motion of that period and a stop after it. If that fails, the arm
follows the stop that was certified in the period before.

    loop = VelocityLoop(robot, scene, q, period_s=0.01)
    configuration = pink.Configuration(robot.model, robot.model.createData(), q)
    while running:
        velocity = pink.solve_ik(configuration, tasks, loop.period_s, solver="daqp")
        configuration.update(loop.step(velocity))
        send(configuration.q)

Arms need time to change their velocity: the gain of a task, divided by the period, should be below the ratio of
acceleration to velocity limits (a few per second), or the arm oscillates about the target.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray, numbers, readonly
from hplan.certificate.certificate import Certificate, rest_violations, with_violations
from hplan.errors import MovingObstacleError
from hplan.planning.motion import certificate_of
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.robot.model import Robot
from hplan.scene.model import Scene, Start
from hplan.trajectory.braking import braking
from hplan.trajectory.retime import rest_at
from hplan.trajectory.trajectory import Trajectory


class VelocityLoop:
    """Follows desired joint velocities within the limits, with a certified stop at hand.

    Positions, velocities and accelerations of its commands are continuous: they are on a cubic spline
    (`hplan.trajectory.braking`), which the controller should interpolate.

    Attributes:
        period_s: Time between commands [s].
        position: (dof,) the last command.
        velocity: (dof,) its velocity.
        acceleration: (dof,) its acceleration.
        certificate: Certificate of the last motion that was tried; its `violations` say why the arm stops.
        is_stopping: True while the arm follows a stop rather than the desired velocity.

    Examples:
        >>> from hplan import load_robot, load_scene
        >>> from hplan.adapters.velocity_loop import VelocityLoop
        >>> scene = load_scene()
        >>> loop = VelocityLoop(load_robot(), scene, scene.start.configuration, period_s=0.02)
        >>> for _ in range(20):
        ...     command = loop.step([0.3, 0.0, 0.0, 0.0])
        >>> round(float(loop.velocity[0]), 3), loop.is_stopping
        (0.3, False)
    """

    def __init__(
        self, robot: Robot, scene: Scene, q: ArrayLike, *, period_s: float, options: PlanOptions | None = None
    ) -> None:
        """Start at rest.

        Args:
            robot: The arm.
            scene: Obstacles, held objects and required clearance; its start and goal are ignored.
            q: (dof,) current configuration [rad; m for prismatic joints].
            period_s: Time between commands [s].
            options: Tracking errors and position uncertainties to cover; None for the defaults.

        Raises:
            MovingObstacleError: An obstacle of the scene moves.
            ConfigurationInCollisionError: The arm is in contact, or nearer to an obstacle than the clearance.
            JointLimitError: The configuration is outside the joint limits.
        """
        if scene.moves:
            raise MovingObstacleError(scene.first_moving, "a velocity loop takes scenes without moving obstacles")
        self.period_s = number("period_s", period_s, "a time in seconds in (0, 1]", lambda time: 0.0 < time <= 1.0)
        options = PlanOptions() if options is None else options
        start = Start(joints_rad=tuple(numbers("q", q, (robot.dof,)).tolist()))
        self._problem = Problem.from_scene(robot, scene.copy_unchecked({"start": start}), options)
        self._robot, self._limit = self._problem.robot, self._problem.robot.velocity_limit
        self._problem.world.check_base()
        self._problem.world.check_clear(self._problem.start, "start")
        self.position, self.velocity = self._problem.start, readonly(np.zeros(robot.dof))
        self.acceleration, self.is_stopping = self.velocity, False
        self._stop, self._row = rest_at(self._robot.model, self.position), 0
        self.certificate = self._certify(self._stop)

    def step(self, desired: ArrayLike) -> FloatArray:
        """Return the (dof,) command of the next period.

        Args:
            desired: (dof,) desired joint velocities [rad/s, m/s]; beyond the limits they are scaled down together.

        Raises:
            InputError: `desired` does not have one finite value for each joint.
        """
        velocity = numbers("desired", desired, (self._robot.dof,))
        velocity = velocity / max(1.0, float((np.abs(velocity) / self._limit).max()))
        # One period towards that velocity, and a stop.
        motion = braking(
            self._robot, self.position, self.velocity, self.acceleration, self.period_s,
            self._robot.acceleration_limit, desired=velocity,
        )  # fmt: skip
        if motion is not None:
            self.certificate = self._certify(motion)
        self.is_stopping = motion is None or not self.certificate.verified
        if motion is not None and not self.is_stopping:
            self._stop, self._row = motion, 0
        self._row = min(self._row + 1, self._stop.samples - 1)
        rows = self._stop.rows
        self.position, self.velocity, self.acceleration = (
            readonly(values[self._row]) for values in (rows.position, rows.velocity, rows.acceleration)
        )
        return self.position

    @property
    def stop(self) -> Trajectory:
        """The certified motion to rest that begins at the last command."""
        return self._stop.cut_before(self._row)

    def _certify(self, motion: Trajectory) -> Certificate:
        found = certificate_of(self._problem, motion, rest_to_rest=False)
        return with_violations(found, rest_violations(self._robot, motion, {"ends": -1}))
