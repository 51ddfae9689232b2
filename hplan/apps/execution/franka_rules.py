"""Rules of libfranka for joint motions: limits of the 1 kHz stream of commands, and its start and end.

The robot stops with an error if a command violates one of the necessary conditions: the joint limits of position,
velocity, acceleration and jerk, of the stream's differences over 1 ms. A motion must begin and end at rest, without
acceleration; before its first and after its last command the differences are zero. A jump of velocity is an excessive
acceleration of one command (`joint_motion_generator_velocity_discontinuity`), a jump of acceleration an excessive jerk
(`joint_motion_generator_acceleration_discontinuity`).

Source: https://frankaemika.github.io/docs/control_parameters.html, joint trajectory requirements and limits for Panda.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, Record, numbers, readonly

#: Time between two commands [s].
PERIOD_S: Final = 1e-3


@dataclass(frozen=True, eq=False)
class StreamLimits(Record):
    """Necessary limits of each joint.

    Attributes:
        lower: (dof,) lower position limits [rad].
        upper: (dof,) upper position limits [rad].
        velocity: (dof,) [rad/s].
        acceleration: (dof,) [rad/s^2].
        jerk: (dof,) [rad/s^3].
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray


#: Limits of the Panda (Franka Emika Robot).
PANDA: Final = StreamLimits(
    lower=readonly([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]),
    upper=readonly([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]),
    velocity=readonly([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61]),
    acceleration=readonly([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0]),
    jerk=readonly([7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0]),
)


@dataclass(frozen=True, eq=False)
class StreamCheck(Record):
    """Result of the rules on a stream of commands.

    Attributes:
        violations: One message for each violated rule, of the command that violates it most.
        position: Maximum distance from the middle of the joint range, as a fraction of half the range.
        velocity: Maximum use of the velocity limit, as a fraction.
        acceleration: Maximum use of the acceleration limit.
        jerk: Maximum use of the jerk limit.
    """

    violations: tuple[str, ...]
    position: float
    velocity: float
    acceleration: float
    jerk: float

    @property
    def is_accepted(self) -> bool:
        """True if no rule is violated."""
        return not self.violations


def check_stream(q: ArrayLike, limits: StreamLimits = PANDA) -> StreamCheck:
    """Check a stream of joint positions, one command each millisecond.

    Args:
        q: (n, dof) commands; the arm rests at the first one before the stream, and at the last one after it [rad].
        limits: Limits of the robot.

    Raises:
        InputError: `q` is not an (n, dof) array of finite numbers.

    Examples:
        >>> rest = np.tile([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0], (5, 1))
        >>> check_stream(rest).is_accepted
        True
        >>> jump = rest + np.outer(np.arange(5) > 2, [1e-3, 0, 0, 0, 0, 0, 0])
        >>> check_stream(jump).violations[0]
        'acceleration of joint 1 reaches 66.67 of its limit at command 3'
    """
    rows = numbers("q", q, (None, len(limits.velocity)))
    rest = np.repeat(rows[[0, -1]], 3, axis=0)
    held = np.vstack([rest[:3], rows, rest[3:]])
    velocity = np.diff(held, axis=0) / PERIOD_S
    acceleration = np.diff(velocity, axis=0) / PERIOD_S
    jerk = np.diff(acceleration, axis=0) / PERIOD_S
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    # Of each quantity: use of the limits, and the number of the command in the first row.
    found = {
        "position": (np.abs(rows - middle) / half, 0),
        "velocity": (np.abs(velocity) / limits.velocity, -2),
        "acceleration": (np.abs(acceleration) / limits.acceleration, -1),
        "jerk": (np.abs(jerk) / limits.jerk, 0),
    }
    violations, uses = list[str](), dict[str, float]()
    for name, (use, first) in found.items():
        row, joint = np.unravel_index(int(use.argmax()), use.shape)
        uses[name] = float(use[row, joint])
        if not uses[name] <= 1.0:
            at = f"joint {int(joint) + 1} reaches {uses[name]:.4g} of its limit at command {int(row) + first}"
            violations.append(f"{name} of {at}")
    violations.sort(key=lambda words: words.startswith("jerk"))
    return StreamCheck(tuple(violations), **uses)
