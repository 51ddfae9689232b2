"""Motions at the time steps of simulators."""

from __future__ import annotations

import numpy as np

from hplan.base.arguments import number
from hplan.base.arrays import FloatArray
from hplan.trajectory.trajectory import Trajectory


def states_every(motion: Trajectory, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return times (n,) [s], positions, velocities and accelerations (n, dof) of a motion at time steps.

    The last one is the end of the motion, at most a step after the one before it.

    Raises:
        OptionError: The time step is not a positive number.

    Examples:
        >>> motion = Trajectory(("q1",), [0.0, 2.0], [[0.0], [1.0]], [[0.0], [0.0]], [[0.0], [0.0]], [[0.0], [0.0]])
        >>> states_every(motion, 0.8)[0].tolist()
        [0.0, 0.8, 1.6, 2.0]
    """
    number("time_step", step_s, "a positive time in seconds", lambda step: step > 0.0)
    clock = np.append(np.arange(0.0, motion.duration - 1e-9, step_s), motion.duration)
    position, velocity, acceleration = zip(*map(motion.state_at, clock.tolist()), strict=True)
    return clock, np.array(position), np.array(velocity), np.array(acceleration)
