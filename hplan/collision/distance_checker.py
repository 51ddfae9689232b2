"""Questions that both distance back ends answer, in the same units and with the same meaning."""

from __future__ import annotations

from typing import Final, Protocol

from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray

#: Clearances are clamped to this value unless a caller chooses another [m].
FAR: Final = 0.2


class DistanceChecker(Protocol):
    """Distances of an arm among static obstacles, by one back end.

    Two classes share no distance formula: `hplan.collision.compiled_field.ClearanceField` for the planner, and
    `hplan.collision.coal_scene.CoalScene` for the certificate. Either is built for a required clearance, the growth of
    each obstacle and a tracking error. The *spare clearance* of a configuration is the minimum, over all checked pairs
    of bodies, of the distance beyond the required clearance and the tracking displacement bound [m].

    **Conservatism.** A positive spare clearance by the compiled back end exceeds coal's by at most coal's tolerance
    (1e-6 m). It is smaller by at most the excess of the prisms that replace cylinders
    (`hplan.scene.obstacles.Cylinder.excess`) plus twice the growth of the arm's bodies (`CollisionBody.growth`). The
    displacement bounds of both differ by less than 1 %. In contact both are negative, but the depths may differ.

    Examples:
        >>> import numpy as np
        >>> from hplan import load_robot
        >>> from hplan.collision.coal_scene import CoalScene
        >>> from hplan.collision.compiled_field import ClearanceField
        >>> from hplan.scene import Sphere
        >>> robot, ball = load_robot("orchard_harvester"), Sphere(name="ball", center=(0.9, 0.6, 0.6), radius=0.1)
        >>> checkers: tuple[DistanceChecker, ...] = (
        ...     ClearanceField.build(robot, [ball], clearance=0.01),
        ...     CoalScene(robot, [ball], clearance=0.01),
        ... )
        >>> [checker.in_collision(np.zeros((1, robot.dof))).tolist() for checker in checkers]
        [[False], [False]]
        >>> [round(checker.spare_clearance(np.zeros(robot.dof)), 3) for checker in checkers]
        [0.168, 0.168]
    """

    def spare_clearance(self, q: ArrayLike, enough: float = FAR) -> float:
        """Spare clearance of one configuration, (dof,) [m].

        Args:
            q: (dof,) joint values [rad, m].
            enough: The clearance is clamped to this value [m].

        Raises:
            MovingObstacleError: An obstacle moves.
        """

    def spare_clearances(self, configurations: ArrayLike, enough: float = FAR) -> FloatArray:
        """Spare clearance of each configuration, (n,) [m].

        Args:
            configurations: (n, dof) joint values [rad, m].
            enough: Clearances are clamped to this value [m].

        Raises:
            MovingObstacleError: An obstacle moves.
        """

    def in_collision(self, configurations: ArrayLike, *, margin: float = 0.0) -> BoolArray:
        """(n,) mask of the configurations whose spare clearance is at most a margin.

        Args:
            configurations: (n, dof) joint values [rad, m].
            margin: Maximum spare clearance that counts as collision [m].

        Raises:
            MovingObstacleError: An obstacle moves.
        """
