"""OMPL's validity checkers, with hplan's distances behind them.

OMPL checks motions at single states, so its paths may touch obstacles between them. With `Validity` it verifies each
straight motion as a whole:

    validity = Validity.of_scene(robot, scene)
    information = setup.getSpaceInformation()
    setup.setStateValidityChecker(validity.is_valid)
    information.setMotionValidator(validity.motion_validator(information))

Source: https://ompl.kavrakilab.org/stateValidation.html
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, numbers
from hplan.base.lazy_import import extra
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Clearance beyond the required one that a valid motion keeps at every distance query [m].
MARGIN_M = 1e-5


@dataclass(frozen=True, eq=False)
class Validity(Record):
    """Validity of states and motions of an arm among obstacles.

    A state has one value for each joint that is not locked, in the arm's order: a `RealVectorStateSpace`, or a compound
    space whose states are read with `[axis]`.

    Attributes:
        world: The arm among the obstacles.
        start: (dof,) configuration with the values of locked joints.
        locked: (dof,) True for joints that keep their values.

    Examples:
        >>> from hplan import load_robot, load_scene
        >>> from hplan.adapters.ompl import Validity
        >>> validity = Validity.of_scene(load_robot(), load_scene())
        >>> validity.is_valid([0.0, 0.6, 0.7])  # the scene locks the base's yaw
        True
        >>> validity.is_valid_motion([0.0, 0.6, 0.7], [0.1, 0.6, 0.7])
        True
    """

    world: World
    start: FloatArray
    locked: BoolArray

    @classmethod
    def of_scene(cls, robot: Robot, scene: Scene, options: PlanOptions | None = None) -> Validity:
        """Return the validity among the obstacles of a scene; its goal is ignored.

        Args:
            robot: The arm.
            scene: Obstacles, held objects, required clearance, locked joints.
            options: Position uncertainties and tracking errors to cover; None for the defaults.

        Raises:
            InputError: The scene's start is not a configuration of the robot.
            JointLimitError: The start violates the joint limits.
        """
        problem = Problem.from_scene(robot, scene, PlanOptions() if options is None else options)
        return cls(problem.world, problem.start, problem.robot.locked_mask(scene.locked_joints))

    def configuration(self, state: Any) -> FloatArray:
        """(dof,) configuration of a state.

        Raises:
            InputError: A value is not finite, or a list or array has another number of values.
        """
        q, count = np.array(self.start), len(self._axes)
        # OMPL's states have no length. Planners ask for tens of thousands of them: the full check takes longer than the
        # distances.
        values = state if hasattr(state, "__len__") else [state[axis] for axis in range(count)]
        if values is state or not all(map(math.isfinite, values)):
            values = numbers("state", values, (count,))
        q[self._axes] = values
        return q

    def is_valid(self, state: Any) -> bool:
        """True if a state keeps the required clearance."""
        return self.world.field.spare_clearance(self.configuration(state), MARGIN_M) > 0.0

    def is_valid_motion(self, first: Any, last: Any) -> bool:
        """True if the straight motion between two states is verified to keep the required clearance throughout."""
        return self.world.field.is_clear([self.configuration(first), self.configuration(last)], MARGIN_M)

    def motion_validator(self, information: Any) -> Any:
        """Return an OMPL motion validator that verifies motions as a whole.

        Keep a reference to it for as long as OMPL uses it.

        Args:
            information: The space information of the OMPL problem.

        Raises:
            InputError: OMPL is not installed (extra `bench`).
        """
        with extra("bench", "hplan.adapters.ompl needs OMPL"):
            base = importlib.import_module("ompl.base")
        validity = self

        class Verified(base.MotionValidator):  # type: ignore[misc, name-defined]
            def checkMotion(self, first: Any, second: Any, lastValid: Any = None) -> bool:  # noqa: N802, N803 - OMPL's
                del lastValid
                return validity.is_valid_motion(first, second)

        return Verified(information)

    @cached_property
    def _axes(self) -> IntArray:
        return np.flatnonzero(~self.locked)
