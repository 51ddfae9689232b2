"""Points, solids and distances of the collision shapes of a URDF."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.geometry.coal_hull import convex_hull_shape
from hplan.geometry.hull import CUBE_CORNERS


def outline(shape: pin.GeometryObject, *, rim_from_outside: bool) -> tuple[FloatArray, float]:
    """Points and a rounding radius whose hull contains a shape.

    The hull is exact except at the rim of a cylinder, which becomes a 64-gon: inscribed if the cylinder lies about the
    link's axis (every rim point is then equally far from it), else circumscribed (0.12 % larger).

    Raises:
        TypeError: The shape is neither a URDF shape nor a convex shape of coal.
    """
    geometry = shape.geometry
    kind = type(geometry).__name__
    if isinstance(geometry, coal.BVHModelBase):
        return np.asarray(geometry.vertices(), dtype=np.float64), 0.0
    if not isinstance(geometry, coal.ShapeBase):
        raise TypeError(f"shape {kind} is not supported")
    rounding = float(geometry.getSweptSphereRadius())
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points(), dtype=np.float64).reshape(-1, 3), rounding
    if kind == "Sphere":
        return np.zeros((1, 3)), rounding + float(geometry.radius)
    if kind == "Capsule":
        return np.array([[0, 0, -1.0], [0, 0, 1.0]]) * geometry.halfLength, rounding + float(geometry.radius)
    if kind == "Cylinder":
        angles = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        radius = geometry.radius / np.cos(np.pi / 64) if rim_from_outside else geometry.radius
        rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = [np.c_[rim, np.full(64, h)] for h in (-geometry.halfLength, geometry.halfLength)]
        return np.vstack(ends), rounding
    if kind == "Box":
        return CUBE_CORNERS * np.asarray(geometry.halfSide), rounding
    raise TypeError(f"shape {kind} is not supported")


def solid_geometry(shape: pin.GeometryObject) -> coal.CollisionGeometry:
    """Geometry of a shape; the convex hull for a mesh."""
    geometry = shape.geometry
    if isinstance(geometry, coal.BVHModelBase):
        return convex_hull_shape(np.asarray(geometry.vertices(), dtype=np.float64))
    return geometry


def coal_distance(a: coal.CollisionGeometry, at: pin.SE3, b: coal.CollisionGeometry, other: pin.SE3) -> float:
    """Signed distance between two placed shapes [m]."""
    return float(
        coal.distance(
            a,
            coal.Transform3s(at.rotation, at.translation),
            b,
            coal.Transform3s(other.rotation, other.translation),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )
