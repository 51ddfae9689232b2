"""Hulls as coal convex shapes, made from their own vertices and triangles.

coal's own hull computation (`BVHModelBase.buildConvexHull`) aborts the process for flat or nearly flat points.
"""

from __future__ import annotations

import coal

from hplan.base.arrays import FloatArray
from hplan.geometry.hull import Hull, whole_hull


def convex_shape(hull: Hull) -> coal.Convex:
    """Convert a hull to a coal shape.

    The rounding becomes its swept-sphere radius.
    """
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in hull.core:
        points.append(point)
    for face in hull.faces.tolist():
        triangles.append(coal.Triangle(*face))
    shape = coal.Convex(points, triangles)
    shape.setSweptSphereRadius(float(hull.rounding))
    return shape


def convex_hull_shape(points: FloatArray) -> coal.Convex:
    """Convex hull of (n, 3) points as a coal shape (`whole_hull`)."""
    return convex_shape(whole_hull(points))
