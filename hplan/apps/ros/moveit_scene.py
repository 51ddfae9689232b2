"""Reader of `.scene` files, written by MoveIt's `PlanningScene` and RViz's plugin.

The first line is the scene's name. An object begins with `* NAME`. Then follow its pose (since MoveIt of 2020), the
number of its shapes, for each shape its kind, sizes, pose in the object's frame and colour, and the subframes (since
MoveIt of 2020). A `.` ends the file. Words are separated by spaces or line breaks, as in MoveIt's parser.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
import pinocchio as pin

from hplan.base.arguments import decimal, file_path, list_between, one_of
from hplan.base.files import ByteBudget
from hplan.errors import OptionError, SceneError
from hplan.geometry.hull import hull_of
from hplan.geometry.prism import prism
from hplan.scene.limits import FARTHEST_M, MOST_SHAPE_BYTES, Vector
from hplan.scene.obstacles import Box, Cylinder, Mesh, Obstacle, Sphere

#: Treatment of a mesh that is not closed: refuse it, or replace it by its convex hull.
OpenMeshes: TypeAlias = Literal["refuse", "hull"]

#: Number of dimensions of each shape, in the order of MoveIt's scene files.
SIZES: Final = {"sphere": 1, "box": 3, "cylinder": 2, "cone": 2}

#: Reasons why planes and octomaps are refused.
NO_PLANE: Final = "a plane is infinite; replace it by a box"
NO_OCTOMAP: Final = "octomaps are not supported in this format; save the map as a `.bt` file for `read_octomap`"


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
        return Mesh.from_arrays(name, vertices, faces, **placement)
    except SceneError:
        if open_meshes == "refuse" or np.max(faces, initial=len(vertices) * (not faces)) >= len(vertices):
            raise
    points = np.asarray(vertices)[np.unique(faces)]
    try:
        hull = hull_of(points, most=len(points) + 14)
    except ValueError as error:
        raise SceneError("the mesh lies in one plane: it has no hull", where=name) from error
    return Mesh.from_arrays(name, hull.core, hull.faces, **placement)


def _rpy_deg(place: pin.SE3) -> tuple[float, float, float]:
    roll, pitch, yaw = np.degrees(pin.rpy.matrixToRpy(place.rotation)).tolist()
    return roll, pitch, yaw


#: MoveIt's kinds of shapes that hplan refuses, and the reasons.
_REFUSED: Final = {
    "plane": NO_PLANE,
    "octree": NO_OCTOMAP,
    "<octomap>": NO_OCTOMAP,
}


def read_moveit_scene(
    path: Path | str,
    *,
    position: Vector = (0.0, 0.0, 0.0),
    rpy_deg: Vector = (0.0, 0.0, 0.0),
    prefix: str = "",
    open_meshes: OpenMeshes = "refuse",
) -> tuple[Obstacle, ...]:
    """Read the obstacles of a MoveIt scene file, old or new format.

    Boxes, spheres and cylinders are kept as such. A cone becomes a circumscribed pyramid; a mesh is covered by convex
    pieces. Colours and subframes are ignored.

    Args:
        path: The file.
        position: Origin of MoveIt's planning frame in `base_link` [m].
        rpy_deg: Orientation of that frame: roll, pitch and yaw about fixed axes [deg].
        prefix: Prepended to every name.
        open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.

    Returns:
        The obstacles, named after the objects; an object with several shapes gives `NAME 1`, `NAME 2`, ... To write a
        scene file: `save_scene(scene.with_obstacles(obstacles), path)`.

    Raises:
        SceneError: The file is missing or malformed, or a shape cannot be an obstacle; names the line.
        OptionError: An option of the wrong type or range.
    """
    path = file_path("path", path)
    base = planning_frame(position, rpy_deg, prefix, open_meshes)
    text = ByteBudget(MOST_SHAPE_BYTES).text(path, lambda reason: SceneError(reason, path=path))
    return tuple(_SceneText(path, text, open_meshes).obstacles(base, prefix))


class _SceneText:
    """Parser of a scene file, word by word with line numbers."""

    def __init__(self, path: Path, text: str, open_meshes: OpenMeshes) -> None:
        self._path, self._open_meshes = path, open_meshes
        lines = text.splitlines()
        heads = [number for number, line in enumerate(lines) if number and line.startswith("*")]
        # The line after an object's name is a pose of several numbers, or in the old format the number of shapes.
        self._has_poses = bool(heads) and len("".join(lines[heads[0] + 1 : heads[0] + 2]).split()) > 1
        self._words = self._split(lines)
        self._last = len(lines)
        self._line = 1

    @staticmethod
    def _split(lines: list[str]) -> Iterator[tuple[int, str]]:
        """Split lines into words with line numbers.

        The first line of an object gives two words, its `*` and its name.
        """
        for number, line in enumerate(lines[1:], start=2):
            if line.startswith("*"):
                yield number, "*"
                yield number, line[1:].strip()
            else:
                yield from ((number, word) for word in line.split())

    def obstacles(self, base: pin.SE3, prefix: str) -> Iterator[Obstacle]:
        """Parse the obstacles of all objects.

        Args:
            base: Pose of the planning frame in `base_link`.
            prefix: Prepended to every name.

        Raises:
            SceneError: The file is malformed, or a shape cannot be an obstacle; names the line.
        """
        seen: dict[str, int] = {}
        while (marker := self._word("`*` and the name of an object, or `.` at the end")) != ".":
            if marker != "*":
                raise self._fault(f"expected `*` and the name of an object, or `.` at the end; got {marker!r}")
            name = self._word("a name")
            if not name or name in _REFUSED:
                raise self._fault(_REFUSED.get(name, "the object has no name"))
            if name in seen:
                raise self._fault(f"object {name!r} is already on line {seen[name]}")
            seen[name] = self._line
            place = base * self._pose() if self._has_poses else base
            count = self._count("the number of shapes")
            for number in range(1, count + 1):
                yield self._obstacle(prefix + (name if count == 1 else f"{name} {number}"), place)
            if self._has_poses:
                for _ in range(self._count("the number of subframes")):
                    self._word("the name of a subframe")
                    self._pose()
        for number, word in self._words:
            self._line = number
            raise self._fault(f"expected nothing after `.`, got {word!r}")

    def _obstacle(self, name: str, place: pin.SE3) -> Obstacle:
        kind, line = self._word("the kind of a shape"), self._line
        if kind in _REFUSED:
            raise self._fault(f"{name!r}: {_REFUSED[kind]}")
        if kind == "mesh":
            counts = self._count("the number of vertices"), self._count("the number of triangles")
            vertices = [self._numbers(3, "a vertex") for _ in range(counts[0])]
            faces = [[self._count("a vertex of a triangle") for _ in range(3)] for _ in range(counts[1])]
        elif kind in SIZES:
            sizes = self._numbers(SIZES[kind], f"the size of a {kind}")
        else:
            raise self._fault(f"expected one of {', '.join(SIZES)} or mesh, got {kind!r}")
        where = place * self._pose()
        self._numbers(4, "a colour")
        try:
            if kind == "mesh":
                return mesh(name, vertices, faces, where, self._open_meshes)
            return shape(name, kind, sizes, where)
        except SceneError as error:
            raise SceneError(f"{name!r}: {error.reason}", path=self._path, line=line, value=error.value) from error

    def _pose(self) -> pin.SE3:
        position, quaternion = self._numbers(3, "a position"), self._numbers(4, "a quaternion")
        try:
            return pose(position, quaternion)
        except ValueError as error:
            raise self._fault(str(error)) from error

    def _numbers(self, count: int, what: str) -> list[float]:
        """Read `count` finite numbers; the second argument names them in the error."""
        values = []
        for _ in range(count):
            word = self._word(what)
            value = decimal(word)
            if value is None:
                raise self._fault(f"expected {what}, {count} finite numbers; got {word!r}")
            values.append(value)
        return values

    def _count(self, what: str) -> int:
        word = self._word(what)
        if not (word.isascii() and word.isdigit()):
            raise self._fault(f"expected {what}, a whole number; got {word!r}")
        return int(word)

    def _word(self, expected: str) -> str:
        for number, word in self._words:
            self._line = number
            return word
        self._line = max(self._last, 1)
        raise self._fault(f"the file ends where {expected} is expected")

    def _fault(self, reason: str) -> SceneError:
        return SceneError(reason, path=self._path, line=self._line)
