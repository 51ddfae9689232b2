"""Reader of `moveit_msgs/msg/PlanningScene` messages: a dict, YAML or JSON.

The message may be a dictionary of `rosidl_runtime_py.message_to_ordereddict` or the output of `ros2 topic echo`. As in
the benchmark files of robowflex, words and lists may replace numbers and named fields: `type: box`,
`position: [x, y, z]`, `orientation: [x, y, z, w]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin
import yaml

from hplan.apps.ros.placed_shapes import NO_PLANE, SIZES, OpenMeshes, mesh, planning_frame, shape
from hplan.apps.ros.scene_parts import (
    MESSAGE,
    OBJECT,
    WORLD,
    FixedFrames,
    below,
    check_keys,
    check_left_out,
    check_parts,
    frame_of,
    mapping,
    numbers_of,
    or_else,
    pose_of,
    sequence,
)
from hplan.base.arguments import file_path, is_number
from hplan.base.files import ByteBudget
from hplan.base.yaml_text import read_yaml
from hplan.errors import SceneError
from hplan.scene.limits import MOST_SCENE_BYTES, Vector
from hplan.scene.obstacles import Obstacle

#: Values of `operation` that add an object: the byte of a message in its forms, and the words of files.
_ADDS: Final = (0, "\0", "add", "ADD")


def read_planning_scene(
    source: Path | str | Mapping[str, Any],
    *,
    position: Vector = (0.0, 0.0, 0.0),
    rpy_deg: Vector = (0.0, 0.0, 0.0),
    prefix: str = "",
    open_meshes: OpenMeshes = "refuse",
    leave_out: Sequence[str] = (),
) -> tuple[Obstacle, ...]:
    """Read the obstacles of a planning scene.

    The objects of its world are read, in the planning frame or in a frame of `fixed_frame_transforms`. As in MoveIt, a
    missing pose is the identity, and a quaternion of zeros is no rotation. Attached objects, paddings and scales of
    links, allowed collisions of objects, octomaps, planes and differences (`is_diff`) are refused. Allowed collisions
    between links are ignored, because `load_robot` takes them from the SRDF; colours, subframes and joint states are
    ignored too.

    Args:
        source: The message or its `world` alone, as a dict or as the path of a YAML or JSON file.
        position: Origin of the objects' frame in `base_link` [m].
        rpy_deg: Orientation of that frame: roll, pitch and yaw about fixed axes [deg].
        prefix: Prepended to every name.
        open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.
        leave_out: Names of parts to ignore that would otherwise be refused: `attached_collision_objects`,
            `link_padding`, `link_scale`, `allowed_collision_matrix`, `octomap`, `is_diff`.

    Returns:
        The obstacles, named after the objects; an object with several shapes gives `NAME 1`, `NAME 2`, ...

    Raises:
        SceneError: The file is missing or malformed, an object cannot be an obstacle, a part is refused, or a frame or
            key is unknown; names the key.
        OptionError: An option of the wrong type or range.

    Examples:
        >>> ball = {"primitives": [{"type": "sphere", "dimensions": [0.1]}], "pose": {"position": [1.0, 0.0, 0.5]}}
        >>> (obstacle,) = read_planning_scene({"world": {"collision_objects": [{"id": "ball", **ball}]}})
        >>> obstacle.name, obstacle.center, obstacle.radius
        ('ball', (1.0, 0.0, 0.5), 0.1)
    """
    base = planning_frame(position, rpy_deg, prefix, open_meshes)
    left_out = check_left_out(leave_out)
    path = None
    if isinstance(source, Mapping):
        message = source
    else:
        path = file_path("source", source)
        message = _read(path)
    try:
        return tuple(_obstacles(_World(message, left_out), base, prefix, open_meshes))
    except SceneError as error:
        raise SceneError(error.reason, path=path, where=error.where, value=error.value) from error


def _read(path: Path) -> Mapping[str, Any]:
    text = ByteBudget(MOST_SCENE_BYTES).text(path, lambda reason: SceneError(reason, path=path))
    # `ros2 topic echo` ends each message with a line of three hyphens.
    text = re.sub(r"(\n---[ \t\r]*)+\s*\Z", "\n", text)
    try:
        content, _ = read_yaml(text)
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        reason = f"malformed YAML: {error.problem}"
        if "another document" in str(error.problem):
            reason = "there are several messages; expected one, as `ros2 topic echo --once --full-length` prints it"
        raise SceneError(reason, path=path, line=line) from error
    if not isinstance(content, Mapping):
        raise SceneError("expected a planning scene: a mapping with world", path=path)
    return content


class _World:
    """The world of a planning scene, its key and its frames."""

    def __init__(self, message: Mapping[str, Any], leave_out: tuple[str, ...]) -> None:
        self.where = "world" if "world" in message else ""
        world = mapping(message.get("world", message), self.where)
        if "collision_objects" not in world:
            raise SceneError("this key is missing", where=below(self.where, "collision_objects"))
        check_keys(message, MESSAGE if self.where else WORLD, "")
        check_keys(world, WORLD, self.where)
        self.objects = sequence(world["collision_objects"], below(self.where, "collision_objects"))
        check_parts(message if self.where else {}, world, self.where, leave_out)
        self.frames = FixedFrames(message if self.where else {})


def _obstacles(world: _World, base: pin.SE3, prefix: str, open_meshes: OpenMeshes) -> Iterator[Obstacle]:
    names: set[str] = set()
    for index, item in enumerate(world.objects):
        where = f"{below(world.where, 'collision_objects')}[{index}]"
        item = mapping(item, where)
        check_keys(item, OBJECT, where)
        name = item.get("id")
        if not isinstance(name, str) or not name or name in names:
            reason = f"there are two objects {name!r}" if name in names else f"expected a name, got {name!r}"
            raise SceneError(reason, where=f"{where}.id", value=name)
        names.add(name)
        operation = item.get("operation", 0)
        if (operation.decode("latin-1") if isinstance(operation, bytes | bytearray) else operation) not in _ADDS:
            reason = f"expected an object that is added (ADD, 0); got operation {operation!r}"
            raise SceneError(reason, where=f"{where}.operation", value=operation)
        if len(sequence(or_else(item.get("planes"), ()), f"{where}.planes")):
            raise SceneError(NO_PLANE, where=f"{where}.planes")
        place = (
            base * world.frames.place(frame_of(item, where), name, where) * pose_of(item.get("pose"), f"{where}.pose")
        )
        shapes = [*_placed(item, "primitives", "primitive_poses", where), *_placed(item, "meshes", "mesh_poses", where)]
        if not shapes:
            raise SceneError("the object has no shape", where=where)
        for number, (content, inner, at) in enumerate(shapes, start=1):
            called = prefix + (name if len(shapes) == 1 else f"{name} {number}")
            try:
                yield _shape(called, content, place * inner, at, open_meshes)
            except SceneError as error:
                inside = (error.where or "").startswith(at)
                raise SceneError(error.reason, where=error.where if inside else at, value=error.value) from error


def _placed(
    item: Mapping[str, Any], key: str, poses: str, where: str
) -> Iterator[tuple[Mapping[str, Any], pin.SE3, str]]:
    """Shapes of one kind, their poses in the object's frame, their keys.

    Raises:
        SceneError: The numbers of shapes and poses differ, or a pose is malformed.
    """
    shapes = sequence(or_else(item.get(key), ()), f"{where}.{key}")
    places = sequence(or_else(item.get(poses), ()), f"{where}.{poses}")
    if places and len(places) != len(shapes):
        raise SceneError(f"expected one for each of {len(shapes)} {key}, got {len(places)}", where=f"{where}.{poses}")
    for index, content in enumerate(shapes):
        at = f"{where}.{key}[{index}]"
        yield mapping(content, at), pose_of(places[index] if places else None, f"{where}.{poses}[{index}]"), at


def _shape(name: str, content: Mapping[str, Any], place: pin.SE3, where: str, open_meshes: OpenMeshes) -> Obstacle:
    if "vertices" in content:
        corners = f"{where}.triangles"
        rows, triangles = (
            sequence(content["vertices"], f"{where}.vertices"),
            sequence(content.get("triangles"), corners),
        )
        vertices = [numbers_of(row, "xyz", f"{where}.vertices") for row in rows]
        faces = [row.get("vertex_indices") if isinstance(row, Mapping) else row for row in triangles]
        return mesh(name, vertices, [list(sequence(face, corners)) for face in faces], place, open_meshes)
    kind = content.get("type")
    # Constants of `shape_msgs/msg/SolidPrimitive`.
    types = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
    kind = types.get(int(kind), kind) if isinstance(kind, int | np.integer) and not isinstance(kind, bool) else kind
    if not isinstance(kind, str) or kind not in SIZES:
        expected = ", ".join(f"{number} ({word})" for number, word in types.items())
        raise SceneError(f"expected one of {expected}; got {kind!r}", where=f"{where}.type", value=kind)
    sizes = sequence(content.get("dimensions"), f"{where}.dimensions")
    if len(sizes) != SIZES[kind] or not all(map(is_number, sizes)):
        reason = f"expected {SIZES[kind]} numbers for a {kind}, got {list(sizes)!r}"
        raise SceneError(reason, where=f"{where}.dimensions")
    # A message has the height before the radius.
    ordered = [float(size) for size in (sizes if kind in ("box", "sphere") else reversed(sizes))]
    return shape(name, kind, ordered, place)
