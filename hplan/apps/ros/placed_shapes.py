"""Shapes of MoveIt in their places as obstacles of a scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
import pinocchio as pin

from hplan.base.arguments import list_between, one_of
from hplan.errors import OptionError, SceneError
from hplan.scene.limits import FARTHEST_M
from hplan.scene.obstacles import Box, Cylinder, Mesh, Obstacle, Sphere
from hplan.scene.prism import prism
from hplan.scene.solids import hull_of

#: What becomes of a mesh that is not closed: it is refused, or its convex hull is taken.
OpenMeshes: TypeAlias = Literal["refuse", "hull"]

#: How many numbers give the size of each shape, in the order of a scene file of MoveIt's.
SIZES: Final = {"sphere": 1, "box": 3, "cylinder": 2, "cone": 2}

#: Why some of MoveIt's objects are no obstacles.
NO_PLANE: Final = "a plane has no end; put a box in its place"
NO_OCTOMAP: Final = "an octomap cannot be read; give its points as a point cloud"


def planning_frame(position: Sequence[float], rpy_deg: Sequence[float], prefix: str, open_meshes: str) -> pin.SE3:
    """Check the options of readers; returns where the frame is.

    Args:
        position: Where the origin of the objects' frame is in `base_link` [m].
        rpy_deg: How that frame is turned: roll, pitch and yaw about fixed axes [deg].
        prefix: What is put before every name.
        open_meshes: What becomes of meshes that are not closed.

    Raises:
        OptionError: Not three numbers each, no text, or neither `refuse` nor `hull`.
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
    """A pose by a position [m] and a quaternion.

    Raises:
        ValueError: The quaternion is not of length 1.
    """
    length = math.hypot(*quaternion_xyzw)
    # Quaternions are written with six digits or so; those farther than this from length 1 are none.
    unit = 1e-3
    if abs(length - 1.0) > unit:
        raise ValueError(f"the quaternion {list(quaternion_xyzw)} has the length {length:.4g}, expected 1")
    turn = pin.Quaternion(np.array(quaternion_xyzw) / length)
    return pin.SE3(turn.toRotationMatrix(), np.array(position))


def shape(name: str, kind: str, sizes: Sequence[float], place: pin.SE3) -> Obstacle:
    """A sphere (radius), box (three edges), cylinder or cone (radius, length along z; its tip is above) as an obstacle.

    A cone becomes a pyramid about it, which stands out by as much as the prism about a cylinder of its radius.

    Raises:
        SceneError: A size that is not positive, or a place too far away.
    """
    center = tuple(place.translation.tolist())
    if kind == "sphere":
        return Sphere(name=name, center=center, radius=sizes[0])
    if kind == "box":
        return Box(name=name, center=center, size=tuple(sizes), rpy_deg=_rpy_deg(place))
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
    """A mesh in its place; of one that is not closed its convex hull, where that is wanted.

    Raises:
        SceneError: It is open, empty, flat or inside out.
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
