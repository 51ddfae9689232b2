"""Conversion of MoveIt's shapes with poses to obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
import pinocchio as pin

from hplan.base.arguments import list_between, one_of
from hplan.errors import OptionError, SceneError
from hplan.geometry.hull import hull_of
from hplan.geometry.prism import prism
from hplan.scene.limits import FARTHEST_M
from hplan.scene.obstacles import Box, Cylinder, Mesh, Obstacle, Sphere

#: Treatment of a mesh that is not closed: refuse it, or replace it by its convex hull.
OpenMeshes: TypeAlias = Literal["refuse", "hull"]

#: Number of dimensions of each shape, in the order of MoveIt's scene files.
SIZES: Final = {"sphere": 1, "box": 3, "cylinder": 2, "cone": 2}

#: Reasons why planes and octomaps are refused.
NO_PLANE: Final = "a plane is infinite; replace it by a box"
NO_OCTOMAP: Final = "octomaps are not supported; give the points as a point cloud"


def planning_frame(position: Sequence[float], rpy_deg: Sequence[float], prefix: str, open_meshes: str) -> pin.SE3:
    """Check the options of readers; return the pose of the planning frame.

    Args:
        position: Origin of the objects' frame in `base_link` [m].
        rpy_deg: Orientation of that frame: roll, pitch and yaw about fixed axes [deg].
        prefix: Prefix of every name.
        open_meshes: Treatment of meshes that are not closed.

    Raises:
        OptionError: `position` or `rpy_deg` is not three numbers within their limits, `prefix` is not text, or
            `open_meshes` is neither `refuse` nor `hull`.
    """
    if not isinstance(prefix, str):
        raise OptionError("prefix", prefix, "text")
    one_of("open_meshes", open_meshes, get_args(OpenMeshes))
    places = []
    for option, values, most in (("position", position, FARTHEST_M), ("rpy_deg", rpy_deg, 360.0)):
        places.append(list_between(option, values, -most, most))
        if len(places[-1]) != 3:
            raise OptionError(option, values, "three numbers")
    return pin.SE3(pin.rpy.rpyToMatrix(*np.radians(places[1])), np.array(places[0]))


def pose(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> pin.SE3:
    """Build a pose from position [m] and quaternion (x, y, z, w).

    Raises:
        ValueError: The quaternion's length differs from 1 by more than 1e-3.
    """
    length = math.hypot(*quaternion_xyzw)
    # Files have quaternions with about six digits, so a larger deviation from length 1 is a fault.
    unit = 1e-3
    if abs(length - 1.0) > unit:
        raise ValueError(f"the quaternion {list(quaternion_xyzw)} has the length {length:.4g}, expected 1")
    turn = pin.Quaternion(np.array(quaternion_xyzw) / length)
    return pin.SE3(turn.toRotationMatrix(), np.array(position))


def shape(name: str, kind: str, sizes: Sequence[float], place: pin.SE3) -> Obstacle:
    """Create an obstacle from a primitive shape.

    A cone becomes a circumscribed pyramid, which exceeds the cone by no more than `prism` exceeds a cylinder of the
    same radius.

    Args:
        name: Name of the obstacle.
        kind: `sphere`, `box`, `cylinder` or `cone`.
        sizes: Radius of a sphere; three edge lengths of a box; radius and length along z of a cylinder or of a cone,
            whose tip is at the upper end [m].
        place: Pose of the shape's centre.

    Raises:
        SceneError: A size is not positive, or the place is too far away.
    """
    center = tuple(place.translation.tolist())
    if kind == "sphere":
        return Sphere(name=name, center=center, radius=sizes[0])
    if kind == "box":
        return Box(name=name, center=center, size=(sizes[0], sizes[1], sizes[2]), rpy_deg=_rpy_deg(place))
    can = Cylinder(name=name, center=center, radius=sizes[0], length=sizes[1], rpy_deg=_rpy_deg(place))
    if kind == "cylinder":
        return can
    ring = prism((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), can.length, can.radius).core
    count = len(ring) // 2
    tip = np.array([[0.0, 0.0, 0.5 * can.length]])
    around = [(k, (k + 1) % count) for k in range(count)]
    below = [(0, b, a) for a, b in around[1:-1]]
    return mesh(name, np.vstack([ring[:count], tip]), [*((a, b, count) for a, b in around), *below], place)


def mesh(name: str, vertices: Any, faces: Any, place: pin.SE3, open_meshes: OpenMeshes = "refuse") -> Mesh:
    """Create a mesh obstacle, or the convex hull of an open mesh.

    Args:
        name: Name of the obstacle.
        vertices: (n, 3) vertices [m].
        faces: (m, 3) vertex indices of the triangles.
        place: Pose of the mesh.
        open_meshes: `hull` replaces a mesh that is open or inside out by its convex hull.

    Raises:
        SceneError: The mesh is empty or flat, a face has an unknown vertex, or the mesh is open or inside out and
            `open_meshes` is `refuse`.
    """
    placement = {"position": tuple(place.translation.tolist()), "rpy_deg": _rpy_deg(place)}
    try:
        return Mesh.of(name, vertices, faces, **placement)
    except SceneError:
        if open_meshes == "refuse" or np.max(faces, initial=len(vertices) * (not faces)) >= len(vertices):
            raise
    points = np.asarray(vertices)[np.unique(faces)]
    try:
        hull = hull_of(points, most=len(points) + 14)
    except ValueError as error:
        raise SceneError("the mesh lies in one plane: it has no hull", where=name) from error
    return Mesh.of(name, hull.core, hull.faces, **placement)


def _rpy_deg(place: pin.SE3) -> tuple[float, float, float]:
    roll, pitch, yaw = np.degrees(pin.rpy.matrixToRpy(place.rotation)).tolist()
    return roll, pitch, yaw
