"""Obstacles out of a `moveit_msgs/msg/PlanningScene`: a dict of it, or YAML or JSON, as benchmarks keep their scenes.

Words and lists may stand where the message has numbers and named parts, as robowflex writes them: `type: box`,
`position: [x, y, z]`, `orientation: [x, y, z, w]`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pinocchio as pin
import yaml

from hplan.apps.ros.placed_shapes import NO_OCTOMAP, NO_PLANE, SIZES, OpenMeshes, mesh, planning_frame, pose, shape
from hplan.base.arguments import file_path, is_number
from hplan.base.files import ByteBudget
from hplan.base.yaml_text import read_yaml
from hplan.errors import SceneError
from hplan.scene.limits import MOST_SCENE_BYTES, Vector
from hplan.scene.obstacles import Obstacle


def read_planning_scene(
    source: Path | str | Mapping[str, Any],
    *,
    position: Vector = (0.0, 0.0, 0.0),
    rpy_deg: Vector = (0.0, 0.0, 0.0),
    prefix: str = "",
    open_meshes: OpenMeshes = "refuse",
) -> tuple[Obstacle, ...]:
    """Read the obstacles of a planning scene.

    Only its world is read; all objects are to be in one frame. What has no pose stands at the origin of what it
    belongs to, and a quaternion of zeros turns nothing, as in MoveIt.

    Args:
        source: The message as a dict, or the YAML or JSON file that holds it, or its `world` alone.
        position: Where the origin of the objects' frame is in `base_link` [m].
        rpy_deg: How that frame is turned: roll, pitch and yaw about fixed axes [deg].
        prefix: Put before every name.
        open_meshes: `refuse` meshes that are open or inside out, or take their convex `hull`.

    Returns:
        The obstacles, called as the objects are; where one has several shapes, `NAME 1`, `NAME 2`, ...

    Raises:
        SceneError: Missing or malformed file, something that cannot be an obstacle; names the key.
        OptionError: An option of the wrong kind.
    """
    base = planning_frame(position, rpy_deg, prefix, open_meshes)
    path = None
    if isinstance(source, Mapping):
        message = source
    else:
        path = file_path("source", source)
        message = _read(path)
    try:
        return tuple(_obstacles(_World(message), base, prefix, open_meshes))
    except SceneError as error:
        raise SceneError(error.reason, path=path, where=error.where, value=error.value) from error


def _read(path: Path) -> Mapping[str, Any]:
    text = ByteBudget(MOST_SCENE_BYTES).text(path, lambda reason: SceneError(reason, path=path))
    try:
        content, _ = read_yaml(text)
    except yaml.MarkedYAMLError as error:
        line = None if error.problem_mark is None else error.problem_mark.line + 1
        raise SceneError(f"malformed YAML: {error.problem}", path=path, line=line) from error
    if not isinstance(content, Mapping):
        raise SceneError("expected a planning scene: a mapping with world", path=path)
    return content


class _World:
    """The world of a planning scene, and where in the message it is."""

    def __init__(self, message: Mapping[str, Any]) -> None:
        self.where = "world" if "world" in message else ""
        world = _mapping(message.get("world", message), self.where)
        if "collision_objects" not in world:
            raise SceneError("this key is missing", where=_below(self.where, "collision_objects"))
        octomap = _mapping(_or(world.get("octomap"), {}), _below(self.where, "octomap"))
        inner = _mapping(_or(octomap.get("octomap"), {}), _below(self.where, "octomap.octomap"))
        if inner.get("data"):
            raise SceneError(NO_OCTOMAP, where=_below(self.where, "octomap"))
        self.objects = _list(world["collision_objects"], _below(self.where, "collision_objects"))


def _obstacles(world: _World, base: pin.SE3, prefix: str, open_meshes: OpenMeshes) -> Iterator[Obstacle]:
    frames: dict[str, str] = {}
    names: set[str] = set()
    for index, item in enumerate(world.objects):
        where = f"{_below(world.where, 'collision_objects')}[{index}]"
        item = _mapping(item, where)
        name = item.get("id")
        if not isinstance(name, str) or not name or name in names:
            reason = f"there are two objects {name!r}" if name in names else f"expected a name, got {name!r}"
            raise SceneError(reason, where=f"{where}.id", value=name)
        names.add(name)
        # What `operation` of an object may be: it is added.
        if item.get("operation", 0) not in (0, "add", "ADD"):
            raise SceneError("only objects that are added are read", where=f"{where}.operation")
        if item.get("planes"):
            raise SceneError(NO_PLANE, where=f"{where}.planes")
        frames.setdefault(str(_mapping(_or(item.get("header"), {}), f"{where}.header").get("frame_id", "")), name)
        if len(frames) > 1:
            (first, one), (second, other) = frames.items()
            reason = f"{one!r} is in frame {first!r}, {other!r} in {second!r}; expected one frame"
            raise SceneError(reason, where=f"{where}.header.frame_id")
        place = base * _pose(item.get("pose"), f"{where}.pose")
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
    """Shapes of one kind, their poses in the object's frame, and where they stand."""
    shapes = _list(_or(item.get(key), ()), f"{where}.{key}")
    places = _list(_or(item.get(poses), ()), f"{where}.{poses}")
    if places and len(places) != len(shapes):
        raise SceneError(f"expected one for each of {len(shapes)} {key}, got {len(places)}", where=f"{where}.{poses}")
    for index, content in enumerate(shapes):
        at = f"{where}.{key}[{index}]"
        yield _mapping(content, at), _pose(places[index] if places else None, f"{where}.{poses}[{index}]"), at


def _shape(name: str, content: Mapping[str, Any], place: pin.SE3, where: str, open_meshes: OpenMeshes) -> Obstacle:
    if "vertices" in content:
        corners = f"{where}.triangles"
        rows, triangles = _list(content["vertices"], f"{where}.vertices"), _list(content.get("triangles"), corners)
        vertices = [_numbers(row, "xyz", f"{where}.vertices") for row in rows]
        faces = [row.get("vertex_indices") if isinstance(row, Mapping) else row for row in triangles]
        return mesh(name, vertices, [list(_list(face, corners)) for face in faces], place, open_meshes)
    kind = content.get("type")
    # Types of `shape_msgs/msg/SolidPrimitive`.
    types = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
    kind = types.get(kind, kind) if type(kind) is int else kind
    if not isinstance(kind, str) or kind not in SIZES:
        expected = ", ".join(f"{number} ({word})" for number, word in types.items())
        raise SceneError(f"expected one of {expected}; got {kind!r}", where=f"{where}.type", value=kind)
    sizes = _list(content.get("dimensions"), f"{where}.dimensions")
    if len(sizes) != SIZES[kind] or not all(map(is_number, sizes)):
        reason = f"expected {SIZES[kind]} numbers for a {kind}, got {list(sizes)!r}"
        raise SceneError(reason, where=f"{where}.dimensions")
    # A message has the height before the radius.
    ordered = [float(size) for size in (sizes if kind in ("box", "sphere") else reversed(sizes))]
    return shape(name, kind, ordered, place)


def _pose(content: Any, where: str) -> pin.SE3:
    content = _mapping(_or(content, {}), where)
    position = _numbers(_or(content.get("position"), (0.0, 0.0, 0.0)), "xyz", f"{where}.position")
    quaternion = _numbers(_or(content.get("orientation"), (0.0, 0.0, 0.0, 0.0)), "xyzw", f"{where}.orientation")
    try:
        return pose(position, quaternion if any(quaternion) else (0.0, 0.0, 0.0, 1.0))
    except ValueError as error:
        raise SceneError(str(error), where=f"{where}.orientation") from error


def _numbers(content: Any, keys: str, where: str) -> list[float]:
    """Numbers by their keys, or as a list."""
    values = [content.get(key, 0.0) for key in keys] if isinstance(content, Mapping) else list(_list(content, where))
    if len(values) != len(keys) or not all(map(is_number, values)):
        raise SceneError(f"expected {', '.join(keys)}, got {content!r}", where=where)
    return [float(value) for value in values]


def _mapping(content: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise SceneError(f"expected a mapping of keys, got {content!r}", where=where or None)
    return content


def _list(content: Any, where: str) -> list[Any] | tuple[Any, ...]:
    if not isinstance(content, (list, tuple)):
        raise SceneError(f"expected a list, got {content!r}", where=where)
    return content


def _below(where: str, key: str) -> str:
    return f"{where}.{key}" if where else key


def _or(content: Any, otherwise: Any) -> Any:
    """What is given, else something."""
    return otherwise if content is None else content
