"""Turret shapes of planar arms: which turn with the yaw, their extents and their poses."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hplan.planar.base_shapes import TURRET, BaseShape, base_shapes
from hplan.planar.family_reader import is_planar
from hplan.robot.model import Robot


def turning_shapes(robot: Robot) -> tuple[BaseShape, ...]:
    """Turret shapes that are not round about the yaw axis."""
    shapes = base_shapes(robot) if is_planar(robot) else ()
    return tuple(shape for shape in shapes if shape.carrier == TURRET and not shape.is_round)


def radius(shape: BaseShape) -> float:
    """Maximum distance of its points from the yaw axis [m]."""
    x, y, _ = (shape.core - shape.axis).T
    return float(np.hypot(x, y).max()) + shape.rounding


def bottom(shape: BaseShape) -> float:
    """Height of its lowest point [m]."""
    return float(shape.core[:, 2].min()) - shape.rounding


def placed_at(shape: BaseShape, yaw: float) -> pin.SE3:
    """Pose in `base_link` with the turret at a yaw."""
    turn = pin.utils.rotate("z", yaw)
    return pin.SE3(turn, shape.axis - turn @ shape.axis) * shape.placement
