"""Reader of `moveit_msgs/msg/PlanningScene` messages: an object, a dict, YAML or JSON.

The message may be an object of rclpy or rosbags, a dictionary, or the output of `ros2 topic echo`. As in the benchmark
files of robowflex, words and lists may replace numbers and named fields: `type: box`,
`position: [x, y, z]`, `orientation: [x, y, z, w]`.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.apps.ros.fields import are_messages, column, fields_of, is_message, read_message
from hplan.apps.ros.moveit_scene import NO_PLANE, SIZES, OpenMeshes, mesh, planning_frame, pose, shape
from hplan.apps.ros.octomap import read_octomap
from hplan.base.arguments import is_number, list_of
from hplan.collision.held_objects import solid_volume
from hplan.errors import OptionError, SceneError
from hplan.scene.attached import Attached
from hplan.scene.limits import Vector
from hplan.scene.obstacles import Obstacle

#: Parts that can be left out by name; all but the octomap are otherwise refused if they hold anything.
PARTS: Final = (
    "attached_collision_objects",
    "link_padding",
    "link_scale",
    "allowed_collision_matrix",
    "octomap",
    "is_diff",
)

#: Fields of the messages `PlanningScene`, `PlanningSceneWorld` and `CollisionObject`.
MESSAGE: Final = (
    *("name", "robot_state", "robot_model_name", "fixed_frame_transforms", "allowed_collision_matrix", "link_padding"),
    *("link_scale", "object_colors", "world", "is_diff"),
)
WORLD: Final = ("collision_objects", "octomap")
#: Key of the attached objects, and fields of the message `AttachedCollisionObject`.
ATTACHED: Final = "robot_state.attached_collision_objects"
_HELD: Final = ("link_name", "object", "touch_links", "detach_posture", "weight")
OBJECT: Final = (
    *("header", "pose", "id", "type", "primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses"),
    *("subframe_names", "subframe_poses", "operation"),
)


def check_left_out(leave_out: Any) -> tuple[str, ...]:
    """Check the names of the parts to leave out.

    Raises:
        OptionError: A name that is not in `PARTS`.
    """
    names = tuple(list_of("leave_out", leave_out, str, "names of parts of a planning scene"))
    for name in names:
        if name not in PARTS:
            raise OptionError("leave_out", name, f"one of {', '.join(PARTS)}")
    return names


def check_parts(message: Mapping[str, Any], world: Mapping[str, Any], where: str, leave_out: Collection[str]) -> None:
    """Refuse parts that change which motions are allowed.

    Args:
        message: The planning scene; empty if only its world is given.
        world: Its world.
        where: Key of the world in the message.
        leave_out: Names of the parts to ignore.

    Raises:
        SceneError: A part that is not empty and not left out; names the key.
    """
    objects = sequence(or_else(world.get("collision_objects"), ()), where)
    names = {fields_of(item).get("id") for item in objects if is_message(item)}
    for part, fault, key in (
        ("attached_collision_objects", _attached_fault(message), "robot_state.attached_collision_objects"),
        ("link_padding", _link_fault(message, "link_padding", "padding", 0.0), "link_padding"),
        ("link_scale", _link_fault(message, "link_scale", "scale", 1.0), "link_scale"),
        ("allowed_collision_matrix", _allowed_fault(message, names), "allowed_collision_matrix"),
        ("is_diff", _diff_fault(message), "is_diff"),
    ):
        if fault and part not in leave_out:
            raise SceneError(f"{fault}; leave_out=({part!r},) reads the scene without this part", where=key)


def _attached_fault(message: Mapping[str, Any]) -> str:
    for index, held in enumerate(attached_items(message)):
        name = check_mapping(or_else(held.get("object"), {}), f"{ATTACHED}[{index}].object").get("id")
        return (
            f"{name!r} is attached to link {held.get('link_name')!r}, and an attached object is not an obstacle; "
            "read_attached reads it"
        )
    return ""


def _link_fault(message: Mapping[str, Any], key: str, field: str, neutral: float) -> str:
    """Fault of a link padding or scale; empty if all are neutral."""
    values = {}
    for index, item in enumerate(sequence(or_else(message.get(key), ()), key)):
        entry = check_mapping(item, f"{key}[{index}]")
        value = entry.get(field, neutral)
        if not is_number(value):
            raise SceneError(f"expected a number, got {value!r}", where=f"{key}[{index}].{field}", value=value)
        if float(value) != neutral:
            values[str(entry.get("link_name"))] = float(value)
    if not values:
        return ""
    link, value = max(values.items(), key=lambda each: each[1])
    instead = f"set `clearance` of the scene to {value:g} m or more" if field == "padding" else "scale the URDF's shape"
    return f"link {link!r} has the {field} {value:g}, which hplan does not apply: {instead}"


def _allowed_fault(message: Mapping[str, Any], names: Collection[Any]) -> str:
    """Fault of an allowed collision between a world object and a link.

    Empty if no such collision is allowed.
    """
    key = "allowed_collision_matrix"
    matrix = check_mapping(or_else(message.get(key), {}), key)
    entries = sequence(or_else(matrix.get("entry_names"), ()), f"{key}.entry_names")
    rows = sequence(or_else(matrix.get("entry_values"), ()), f"{key}.entry_values")
    if rows and len(rows) != len(entries):
        raise SceneError(
            f"expected a row for each of {len(entries)} names, got {len(rows)}", where=f"{key}.entry_values"
        )
    allowed = []
    for name, row in zip(entries, rows, strict=False):
        enabled = fields_of(row).get("enabled") if is_message(row) else row
        flags = sequence(or_else(enabled, ()), f"{key}.entry_values")
        allowed += [(name, other) for other, flag in zip(entries, flags, strict=False) if flag]
    defaults = zip(
        sequence(or_else(matrix.get("default_entry_names"), ()), f"{key}.default_entry_names"),
        sequence(or_else(matrix.get("default_entry_values"), ()), f"{key}.default_entry_values"),
        strict=False,
    )
    allowed += [(name, "every link") for name, flag in defaults if flag]
    for one, other in allowed:
        if (one in names) != (other in names) and not (other == "every link" and one not in names):
            thing, link = (one, other) if one in names else (other, one)
            return f"{thing!r} may touch {link!r}, but hplan keeps all links clear of all obstacles"
    return ""


def _diff_fault(message: Mapping[str, Any]) -> str:
    return "the message is a difference and lacks the objects that did not change" if message.get("is_diff") else ""


class FixedFrames:
    """Frames of a planning scene, from its fixed transforms.

    Without transforms the first frame named by an object is the planning frame, and all other frames are refused.
    """

    def __init__(self, message: Mapping[str, Any]) -> None:
        """Read the transforms of a message.

        Raises:
            SceneError: The transforms are malformed, have no common root or a cycle, or two are of one frame.
        """
        key = "fixed_frame_transforms"
        self._parents: dict[str, tuple[str, pin.SE3]] = {}
        frames = []
        for index, item in enumerate(sequence(or_else(message.get(key), ()), key)):
            where = f"{key}[{index}]"
            item = check_mapping(item, where)
            parent, child = frame_of(item, where), _plain(item.get("child_frame_id", ""))
            place = check_mapping(or_else(item.get("transform"), {}), f"{where}.transform")
            placed = pose_of(place, f"{where}.transform", ("translation", "rotation"))
            frames.append(parent)
            if child in self._parents:
                raise SceneError(f"expected one transform of frame {child!r}, got two", where=where, value=child)
            if child != parent:
                self._parents[child] = parent, placed
        roots = {self._root(frame) for frame in frames}
        if len(roots) > 1:
            raise SceneError(f"expected one root of all frames, got {', '.join(map(repr, sorted(roots)))}", where=key)
        self._planning = next(iter(roots), "")
        self._first = ""

    def _root(self, frame: str) -> str:
        for _ in range(len(self._parents) + 1):
            if frame not in self._parents:
                return frame
            frame = self._parents[frame][0]
        raise SceneError(f"frame {frame!r} is its own parent", where="fixed_frame_transforms")

    def place(self, frame: str, name: str, where: str) -> pin.SE3:
        """Pose of an object's frame in the planning frame.

        Args:
            frame: Name of the frame; empty for the planning frame.
            name: Name of the object.
            where: Key of the object in the message.

        Raises:
            SceneError: The frame is unknown.
        """
        if not self._planning:
            self._planning, self._first = frame, name
        found = pin.SE3.Identity()
        known = [self._planning, *self._parents]
        if frame and frame not in known:
            reason = f"{name!r} is in frame {frame!r}, the known frames are {', '.join(map(repr, known))}"
            if self._first:
                reason = (
                    f"{self._first!r} is in frame {self._planning!r}, {name!r} in {frame!r}; expected one frame, or "
                    "fixed_frame_transforms of the others"
                )
            raise SceneError(reason, where=f"{where}.header.frame_id", value=frame)
        while frame in self._parents:
            frame, placed = self._parents[frame]
            found = placed * found
        return found


def frame_of(item: Mapping[str, Any], where: str) -> str:
    """Frame name in the header of an item."""
    return _plain(check_mapping(or_else(item.get("header"), {}), f"{where}.header").get("frame_id", ""))


def _plain(frame: Any) -> str:
    """Frame name without the leading slash of ROS 1."""
    return str(or_else(frame, "")).removeprefix("/")


def pose_of(content: Any, where: str, keys: tuple[str, str] = ("position", "orientation")) -> pin.SE3:
    """Convert a pose; missing numbers are zero.

    A quaternion of zeros is the identity rotation.

    Args:
        content: The pose message; None for the identity.
        where: Its key, for the error.
        keys: Names of the fields of position [m] and orientation.

    Raises:
        SceneError: A value is not a number, a key is unknown, or the quaternion's length is not 1.
    """
    content = check_mapping(or_else(content, {}), where)
    check_keys(content, keys, where)
    position = numbers_of(or_else(content.get(keys[0]), (0.0, 0.0, 0.0)), "xyz", f"{where}.{keys[0]}")
    quaternion = numbers_of(or_else(content.get(keys[1]), (0.0, 0.0, 0.0, 0.0)), "xyzw", f"{where}.{keys[1]}")
    try:
        return pose(position, quaternion if any(quaternion) else (0.0, 0.0, 0.0, 1.0))
    except ValueError as error:
        raise SceneError(str(error), where=f"{where}.{keys[1]}") from error


def numbers_of(content: Any, keys: str, where: str) -> list[float]:
    """Convert numbers given as a list or by keys.

    Missing keys are 0.

    Raises:
        SceneError: Another number of values, a value that is not a number, or an unknown key.
    """
    if is_message(content):
        content = fields_of(content)
        values = [content.get(key, 0.0) for key in keys]
        check_keys(content, keys, where)
    else:
        values = list(sequence(content, where))
    if len(values) != len(keys) or not all(map(is_number, values)):
        raise SceneError(f"expected {', '.join(keys)}, got {content!r}", where=where)
    return [float(value) for value in values]


def check_keys(content: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Refuse keys that the message type lacks, unless they are empty.

    Raises:
        SceneError: A key is unknown, for example misspelt.
    """
    known = tuple(known)
    for key, value in content.items():
        if key not in known and not (value is None or value is False or (hasattr(value, "__len__") and not len(value))):
            raise SceneError(f"unknown key; expected one of {', '.join(known)}", where=key_path(where, str(key)))


def check_mapping(content: Any, where: str) -> Mapping[str, Any]:
    """Check that a value is a mapping or a message object; return its fields.

    Raises:
        SceneError: The value is neither.
    """
    if not is_message(content):
        raise SceneError(f"expected a mapping of keys, got {content!r}", where=where or None)
    return fields_of(content)


def sequence(content: Any, where: str) -> list[Any] | tuple[Any, ...]:
    """Return a value if it is a list, tuple or array.

    Arrays are converted to lists.

    Raises:
        SceneError: The value is anything else.
    """
    if isinstance(content, array | np.ndarray):
        return list(content.tolist())
    if not isinstance(content, (list, tuple)):
        raise SceneError(f"expected a list, got {content!r}", where=where)
    return content


def key_path(where: str, key: str) -> str:
    """Dotted path of a key under another one."""
    return f"{where}.{key}" if where else key


def or_else(content: Any, otherwise: Any) -> Any:
    """Return the content, with None replaced by the default."""
    return otherwise if content is None else content


#: Operations of a collision object, by the byte of a message, and as words of files.
_OPERATIONS: Final = ("add", "remove", "append", "move")


def read_planning_scene(
    source: Any,
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
    links, allowed collisions of objects, planes and differences (`is_diff`) are refused. The occupied space of an
    octomap is read as boxes (`read_octomap`). Allowed collisions between links are ignored, because `load_robot` takes
    them from the SRDF; colours, subframes and joint states are ignored too.

    Args:
        source: The message or its `world` alone: an object of rclpy or rosbags, a dict, or the path of a YAML or JSON
            file.
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
    message, path = read_message(source, SceneError)
    try:
        return tuple(_read_obstacles(_World(message, left_out), base, prefix, open_meshes))
    except SceneError as error:
        raise SceneError(error.reason, path=path, where=error.where, value=error.value) from error


def read_attached(source: Any, *, prefix: str = "", open_meshes: OpenMeshes = "refuse") -> tuple[Attached, ...]:
    """Read the attached objects of a planning scene.

    `touch_links` are the links that they may touch besides those that move with them, `weight` is a mass [kg]; an
    object of several shapes gives one for each, with a share of the mass by volume.

    Args:
        source: The message, as for `read_planning_scene`; its objects are in the frames of their links.
        prefix: Prepended to every name.
        open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.

    Raises:
        SceneError: The file is missing or malformed, or an object is in another frame than its link or has no shape;
            names the key.
        OptionError: An option of the wrong type or range.

    Examples:
        >>> from hplan.apps.ros import read_attached
        >>> ball = {"id": "pear", "primitives": [{"type": "sphere", "dimensions": [0.04]}]}
        >>> held = {"link_name": "tool0", "object": ball, "touch_links": ["finger"], "weight": 0.2}
        >>> (item,) = read_attached({"robot_state": {"attached_collision_objects": [held]}})
        >>> item.name, item.frame, item.may_touch, item.mass
        ('pear', 'tool0', ('finger',), 0.2)
    """
    planning_frame((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), prefix, open_meshes)
    message, path = read_message(source, SceneError)
    try:
        check_keys(message, MESSAGE, "")
        return tuple(
            held
            for index, item in enumerate(attached_items(message))
            for held in read_held(item, f"{ATTACHED}[{index}]", prefix=prefix, open_meshes=open_meshes)
        )
    except SceneError as error:
        raise SceneError(error.reason, path=path, where=error.where, value=error.value) from error


def attached_items(message: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Fields of the attached objects of a planning scene.

    Raises:
        SceneError: The message is malformed.
    """
    state = check_mapping(or_else(message.get("robot_state"), {}), "robot_state")
    items = sequence(or_else(state.get("attached_collision_objects"), ()), ATTACHED)
    return [check_mapping(item, f"{ATTACHED}[{index}]") for index, item in enumerate(items)]


def read_held(
    item: Mapping[str, Any], where: str, *, prefix: str = "", open_meshes: OpenMeshes = "refuse"
) -> tuple[Attached, ...]:
    """Held objects of one `moveit_msgs/msg/AttachedCollisionObject`.

    Args:
        item: Its fields.
        where: Its key in the message, for errors.
        prefix: Prepended to every name.
        open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.

    Raises:
        SceneError: It has no link or shape, or is in another frame than its link.
    """
    check_keys(item, _HELD, where)
    link, content = item.get("link_name"), check_mapping(or_else(item.get("object"), {}), f"{where}.object")
    if not isinstance(link, str) or not link:
        raise SceneError(f"expected the name of a link, got {link!r}", where=f"{where}.link_name", value=link)
    name, frame = object_name(content, f"{where}.object"), frame_of(content, f"{where}.object")
    attached = f"{name!r} is attached to link {link!r}"
    if not any(len(or_else(content.get(key), ())) for key in ("primitives", "meshes", "planes")):
        raise SceneError(f"{attached}, but the message does not have its shape", where=f"{where}.object")
    if frame not in ("", link):
        reason = f"{attached}, but it is in frame {frame!r}; expected the frame of the link"
        raise SceneError(reason, where=f"{where}.object.header.frame_id", value=frame)
    mass, touched = item.get("weight", 0.0), sequence(or_else(item.get("touch_links"), ()), f"{where}.touch_links")
    if not is_number(mass) or not all(isinstance(each, str) for each in touched):
        raise SceneError("expected a number for weight, and names for touch_links", where=where)
    still, frames = pin.SE3.Identity(), FixedFrames({})
    local = {**content, "header": {}}
    shapes = read_object(local, f"{where}.object", frames, still, prefix=prefix, open_meshes=open_meshes)
    whole = [Attached(object=each, frame=link, may_touch=tuple(touched)) for each in shapes]
    volumes = [solid_volume(each) for each in whole]
    shares = [float(mass) * volume / math.fsum(volumes) for volume in volumes]
    return tuple(each.with_values(mass=share) for each, share in zip(whole, shares, strict=True))


class _World:
    """The world of a planning scene, its key and its frames."""

    def __init__(self, message: Mapping[str, Any], leave_out: tuple[str, ...]) -> None:
        self.where = "world" if "world" in message else ""
        world = check_mapping(message.get("world", message), self.where)
        if "collision_objects" not in world:
            raise SceneError("this key is missing", where=key_path(self.where, "collision_objects"))
        check_keys(message, MESSAGE if self.where else WORLD, "")
        check_keys(world, WORLD, self.where)
        self.objects = sequence(world["collision_objects"], key_path(self.where, "collision_objects"))
        check_parts(message if self.where else {}, world, self.where, leave_out)
        octomap = {} if "octomap" in leave_out else or_else(world.get("octomap"), {})
        self.octomap = check_mapping(octomap, key_path(self.where, "octomap"))
        self.frames = FixedFrames(message if self.where else {})


def _read_obstacles(world: _World, base: pin.SE3, prefix: str, open_meshes: OpenMeshes) -> Iterator[Obstacle]:
    names: set[str] = set()
    for index, item in enumerate(world.objects):
        where = f"{key_path(world.where, 'collision_objects')}[{index}]"
        item = check_mapping(item, where)
        name = object_name(item, where)
        if name in names:
            raise SceneError(f"there are two objects {name!r}", where=f"{where}.id", value=name)
        names.add(name)
        operation = operation_of(item)
        if operation != "add":
            reason = f"expected an object that is added (ADD, 0); got operation {item.get('operation')!r}"
            raise SceneError(reason, where=f"{where}.operation", value=operation)
        yield from read_object(item, where, world.frames, base, prefix=prefix, open_meshes=open_meshes)
    yield from read_map(world.octomap, key_path(world.where, "octomap"), world.frames, base, f"{prefix}octomap")


def object_name(item: Mapping[str, Any], where: str) -> str:
    """Name of a collision object.

    Raises:
        SceneError: A key is unknown, or the object has no name.
    """
    check_keys(item, OBJECT, where)
    name = item.get("id")
    if not isinstance(name, str) or not name:
        raise SceneError(f"expected a name, got {name!r}", where=f"{where}.id", value=name)
    return name


def operation_of(item: Mapping[str, Any]) -> str:
    """Operation of a collision object: `add`, `remove`, `append` or `move`; empty if unknown."""
    operation = item.get("operation", 0)
    if isinstance(operation, bytes | bytearray):
        operation = operation.decode("latin-1")
    if isinstance(operation, str) and len(operation) == 1:
        operation = ord(operation)
    if is_number(operation):
        return dict(enumerate(_OPERATIONS)).get(int(operation), "")
    return operation.lower() if isinstance(operation, str) and operation.lower() in _OPERATIONS else ""


def read_object(
    item: Mapping[str, Any],
    where: str,
    frames: FixedFrames,
    base: pin.SE3,
    *,
    prefix: str = "",
    open_meshes: OpenMeshes = "refuse",
) -> Iterator[Obstacle]:
    """Obstacles of one collision object.

    Args:
        item: The object's fields.
        where: Its key in the message, for errors.
        frames: Frames of the scene.
        base: Pose of the planning frame in `base_link`.
        prefix: Prepended to every name.
        open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.

    Raises:
        SceneError: The object cannot be an obstacle, or its frame is unknown.
    """
    name = object_name(item, where)
    if len(sequence(or_else(item.get("planes"), ()), f"{where}.planes")):
        raise SceneError(NO_PLANE, where=f"{where}.planes")
    place = base * frames.place(frame_of(item, where), name, where) * pose_of(item.get("pose"), f"{where}.pose")
    shapes = [
        *_iterate_placed_shapes(item, "primitives", "primitive_poses", where),
        *_iterate_placed_shapes(item, "meshes", "mesh_poses", where),
    ]
    if not shapes:
        raise SceneError("the object has no shape", where=where)
    for number, (content, inner, at) in enumerate(shapes, start=1):
        called = prefix + (name if len(shapes) == 1 else f"{name} {number}")
        try:
            yield _read_shape(called, content, place * inner, at, open_meshes)
        except SceneError as error:
            inside = (error.where or "").startswith(at)
            raise SceneError(error.reason, where=error.where if inside else at, value=error.value) from error


def read_map(
    octomap: Mapping[str, Any], where: str, frames: FixedFrames, base: pin.SE3, name: str
) -> tuple[Obstacle, ...]:
    """Boxes of an `octomap_msgs/msg/OctomapWithPose`; none of an empty one.

    Args:
        octomap: Its fields.
        where: Its key in the message, for errors.
        frames: Frames of the scene.
        base: Pose of the planning frame in `base_link`.
        name: Prefix of the names.

    Raises:
        SceneError: The map is malformed, or its frame is unknown.
    """
    content = check_mapping(or_else(octomap.get("octomap"), {}), f"{where}.octomap")
    data = or_else(content.get("data"), ())
    if not is_number(data) and len(data) == 0:
        return ()
    place = (
        base * frames.place(frame_of(octomap, where), name, where) * pose_of(octomap.get("origin"), f"{where}.origin")
    )
    rpy_deg = tuple(np.degrees(pin.rpy.matrixToRpy(place.rotation)).tolist())
    try:
        return read_octomap(content, name=name, position=tuple(place.translation.tolist()), rpy_deg=rpy_deg)
    except SceneError as error:
        raise SceneError(error.reason, where=key_path(f"{where}.octomap", error.where or "")) from error


def _iterate_placed_shapes(
    item: Mapping[str, Any], key: str, poses: str, where: str
) -> Iterator[tuple[Mapping[str, Any], pin.SE3, str]]:
    """Shapes of one kind, their poses in the object's frame, their keys."""
    shapes = sequence(or_else(item.get(key), ()), f"{where}.{key}")
    places = sequence(or_else(item.get(poses), ()), f"{where}.{poses}")
    if places and len(places) != len(shapes):
        raise SceneError(f"expected one for each of {len(shapes)} {key}, got {len(places)}", where=f"{where}.{poses}")
    for index, content in enumerate(shapes):
        at = f"{where}.{key}[{index}]"
        yield check_mapping(content, at), pose_of(places[index] if places else None, f"{where}.{poses}[{index}]"), at


def _read_shape(name: str, content: Mapping[str, Any], place: pin.SE3, where: str, open_meshes: OpenMeshes) -> Obstacle:
    if "vertices" in content:
        corners = f"{where}.triangles"
        rows, triangles = (
            sequence(content["vertices"], f"{where}.vertices"),
            sequence(content.get("triangles"), corners),
        )
        vertices = [numbers_of(row, "xyz", f"{where}.vertices") for row in rows]
        faces = column(triangles, "vertex_indices") if are_messages(triangles) else triangles
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
