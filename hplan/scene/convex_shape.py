"""Hulls as convex shapes of coal, made of their own vertices and triangles.

coal can find the hull of a mesh itself (`BVHModelBase.buildConvexHull`), but ends the process where the points are
flat, or nearly so.
"""

from __future__ import annotations

import coal

from hplan.base.arrays import FloatArray
from hplan.scene.solids import Hull, whole_hull


def convex_shape(hull: Hull) -> coal.Convex:
    """A hull in coal, its rounding as the radius that is swept about it."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in hull.core:
        points.append(point)
    for face in hull.faces.tolist():
        triangles.append(coal.Triangle(*face))
    shape = coal.Convex(points, triangles)
    shape.setSweptSphereRadius(float(hull.rounding))
    return shape


def convex_hull_shape(points: FloatArray) -> coal.Convex:
    """The convex hull in coal of (n, 3) points (`whole_hull`)."""
    return convex_shape(whole_hull(points))
