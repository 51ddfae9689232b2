"""Configurations of all active joints of a robot; those outside the arm are held."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import numbers
from hplan.errors import HplanWarning, InputError
from hplan.robot.model import Robot

#: Held joints are at multiples of this value [rad, m], because each value takes a robot of its own.
_STEP: Final = 1e-3

#: Excess of a joint limit that counts as the simulator's [rad, m].
_EXCESS: Final = 0.01

#: Number of these robots that are kept.
_KEPT: Final = 8


class FullConfigurations:
    """Splits configurations of all active joints into those of the arm and values of held joints.

    Attributes:
        names: Names of all active joints, in the order of a configuration.
        robot: The arm, with the held joints of the last configuration.
    """

    def __init__(self, load: Callable[[Mapping[str, float]], Robot], names: Sequence[str]) -> None:
        """Load the arm.

        Args:
            load: Loads the robot with held joints at the given values.
            names: Names of all active joints that hplan can hold or move.

        Raises:
            InputError: A joint of the arm is not among them.
        """

        @lru_cache(maxsize=_KEPT)
        def load_once(held: tuple[tuple[str, float], ...]) -> Robot:
            with warnings.catch_warnings():
                if held:  # The robot without held joints has told its warnings.
                    warnings.simplefilter("ignore", HplanWarning)
                return load(dict(held))

        self._load, self.names, self.robot = load_once, tuple(names), load_once(())
        if missing := [name for name in self.robot.joint_names if name not in self.names]:
            raise InputError(f"names of the active joints: expected {', '.join(missing)} too, got {list(self.names)}")

    def arm_at(self, values: ArrayLike) -> tuple[float, ...]:
        """Return the arm's part of a configuration, and hold the other joints at theirs.

        Values are clipped to the limits, which simulated joints exceed a little; those farther beyond stay, for the
        planner to judge.

        Args:
            values: One value for each of `names`, or for each joint of the arm; held joints then stay as they are.

        Raises:
            InputError: It has another number of values, or one is not finite.
            JointLimitError: A joint is held outside its limits.
        """
        found, robot = numbers("configuration", values, (None,)), self.robot
        if len(found) == len(self.names):
            full = dict(zip(self.names, found.tolist(), strict=True))
            found = np.array([full.pop(name) for name in robot.joint_names])
            self.robot = self._load(tuple((name, _STEP * round(value / _STEP)) for name, value in full.items()))
        elif len(found) != robot.dof:
            expected = f"{len(self.names)} values, or {robot.dof} of the arm alone"
            raise InputError(f"configuration: expected {expected}, got {len(found)}")
        within = np.clip(found, robot.lower, robot.upper)
        return tuple(np.where(np.abs(within - found) <= _EXCESS, within, found).tolist())


def with_limits(robot: Robot, *, velocity_limit: ArrayLike | None, acceleration_limit: ArrayLike | None) -> Robot:
    """Return a robot with other limits of velocity [rad/s] and acceleration [rad/s^2], (dof,) each; None keeps them.

    Raises:
        InputError: The limits do not fit the robot.
    """
    fastest = robot.velocity_limit if velocity_limit is None else velocity_limit
    most = robot.acceleration_limit if acceleration_limit is None else acceleration_limit
    return replace(
        robot,
        velocity_limit=numbers("velocity_limit", fastest, (robot.dof,)),
        acceleration_limit=numbers("acceleration_limit", most, (robot.dof,)),
    )
