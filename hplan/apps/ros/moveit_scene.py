"""Reader of `.scene` files, written by MoveIt's `PlanningScene` and RViz's plugin.

The first line is the scene's name. An object begins with `* NAME`. Then follow its pose (since MoveIt of 2020), the
number of its shapes, for each shape its kind, sizes, pose in the object's frame and colour, and the subframes (since
MoveIt of 2020). A `.` ends the file. Words are separated by spaces or line breaks, as in MoveIt's parser.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pinocchio as pin

from hplan.apps.ros.placed_shapes import NO_OCTOMAP, NO_PLANE, SIZES, OpenMeshes, mesh, planning_frame, pose, shape
from hplan.base.arguments import decimal, file_path
from hplan.base.files import ByteBudget
from hplan.errors import SceneError
from hplan.scene.limits import MOST_SHAPE_BYTES, Vector
from hplan.scene.obstacles import Obstacle

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
