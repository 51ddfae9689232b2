"""C-space of one arm plane: its grid, and sections of obstacles in space."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.prepared_obstacles import ConvexObstacle, prepare_obstacles
from hplan.planar.grid.sections import ArmSections, sections_at
from hplan.planar.planar_family import PlanarArm
from hplan.planning.options import LinkModel
from hplan.robot.model import Robot


def joint_grid(arm: PlanarArm, step: float | FloatArray) -> Grid:
    """Grid over the ranges of the planar joints, with a maximum spacing [rad], one number or one for each joint."""
    return Grid.from_limits(arm.lower, arm.upper, step)


def arm_sections(
    robot: Robot,
    obstacles: Sequence[ConvexObstacle],
    *,
    clearance: ArrayLike = 0.0,
    link_model: LinkModel = "capsule",
) -> ArmSections:
    """Cut all obstacles by the arm plane at yaw 0, once for each link (their half-widths differ).

    Args:
        clearance: Distance to keep from every obstacle [m], one number or one for each.

    Raises:
        OptionError: Unknown link model, a negative clearance, or `rectangle` with an obstacle that is no sphere.
        InputError: An obstacle without core points, or with a point or radius that is not finite.
    """
    prepared = prepare_obstacles(obstacles, clearance=clearance)
    return sections_at(robot, prepared, 0.0, link_model=link_model, within_reach=False)
