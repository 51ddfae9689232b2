"""The world of MoveIt's planning scene, kept up to date by whole messages and differences.

A difference (`is_diff`) adds, removes, extends or moves objects, and replaces what else it has. The rules are those of
`planning_scene::PlanningScene::setPlanningSceneDiffMsg`: an object that is attached leaves the world, and the octomap
counts as an object of that name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hplan.apps.ros.fields import fields_of, read_message
from hplan.apps.ros.moveit_scene import OpenMeshes, planning_frame
from hplan.apps.ros.planning_scene import (
    ATTACHED,
    MESSAGE,
    WORLD,
    FixedFrames,
    attached_items,
    check_keys,
    check_left_out,
    check_mapping,
    check_parts,
    object_name,
    operation_of,
    or_else,
    read_held,
    read_map,
    read_object,
    sequence,
)
from hplan.base.arguments import is_number
from hplan.errors import SceneError
from hplan.scene.attached import Attached
from hplan.scene.limits import Vector
from hplan.scene.obstacles import Obstacle

#: Fields that a later message replaces if it has any.
_REPLACED = ("fixed_frame_transforms", "allowed_collision_matrix", "link_padding", "link_scale")

_OBJECTS = "world.collision_objects"


class SceneUpdates:
    """Obstacles and held objects of a planning scene that changes.

    Nothing is known before the first whole message, unless the world starts empty; and after a message that cannot be
    read, until the next whole one: obstacles that are out of date are never returned.

    Examples:
        >>> ball = {"primitives": [{"type": "sphere", "dimensions": [0.1]}], "pose": {"position": [1.0, 0.0, 0.5]}}
        >>> updates = SceneUpdates()
        >>> updates.apply({"world": {"collision_objects": [{"id": "ball", **ball}]}})
        >>> moved = {"id": "ball", "operation": "move", "pose": {"position": [1.0, 0.0, 0.7]}}
        >>> updates.apply({"is_diff": True, "world": {"collision_objects": [moved]}})
        >>> [(item.name, item.center) for item in updates.obstacles]
        [('ball', (1.0, 0.0, 0.7))]
    """

    def __init__(
        self,
        *,
        position: Vector = (0.0, 0.0, 0.0),
        rpy_deg: Vector = (0.0, 0.0, 0.0),
        open_meshes: OpenMeshes = "refuse",
        leave_out: Sequence[str] = (),
        starts_empty: bool = False,
    ) -> None:
        """Start without obstacles.

        Args:
            position: Origin of the planning frame in `base_link` [m].
            rpy_deg: Orientation of that frame: roll, pitch and yaw about fixed axes [deg].
            open_meshes: `refuse` meshes that are open or inside out, or replace them by their convex `hull`.
            leave_out: Names of parts to ignore (`read_planning_scene`).
            starts_empty: Whether the world is empty until the first message, and not unknown.

        Raises:
            OptionError: An option of the wrong type or range.
        """
        self._base = planning_frame(position, rpy_deg, "", open_meshes)
        self._open_meshes, self._leave_out = open_meshes, check_left_out(leave_out)
        self._fault: SceneError | None = None
        if not starts_empty:
            self._fault = SceneError("no whole planning scene has arrived yet, only differences or nothing")
        self._clear()

    def _clear(self) -> None:
        self._parts: dict[str, Any] = {}
        self._objects: dict[str, Mapping[str, Any]] = {}
        self._attached: dict[str, tuple[Attached, ...]] = {}
        self._octomap: Mapping[str, Any] = {}
        self._read: dict[str, tuple[Obstacle, ...]] = {}
        self._frames: FixedFrames | None = None
        self._obstacles: tuple[Obstacle, ...] = ()

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """The obstacles after the last message.

        Raises:
            SceneError: No whole message has arrived, or one since then could not be read.
        """
        if self._fault is not None:
            raise self._fault
        return self._obstacles

    @property
    def attached(self) -> tuple[Attached, ...]:
        """The objects that the arm holds after the last message (`read_attached`).

        Raises:
            SceneError: No whole message has arrived, or one since then could not be read.
        """
        if self._fault is not None:
            raise self._fault
        return tuple(part for parts in self._attached.values() for part in parts)

    @property
    def padding_m(self) -> float:
        """Maximum padding of any link [m]; with `link_padding` left out, a clearance that covers it."""
        paddings = (fields_of(item) for item in self._parts.get("link_padding", ()))
        values = [item.get("padding", 0.0) for item in paddings]
        return max([0.0, *map(float, values)])

    def apply(self, message: Any) -> None:
        """Take a `moveit_msgs/msg/PlanningScene`, whole or a difference.

        Args:
            message: An object of rclpy or rosbags, a dict, or a YAML or JSON file.

        Raises:
            SceneError: The message cannot be read, changes an object that does not exist, or holds a part that is
                refused (`read_planning_scene`).
        """
        content, path = read_message(message, SceneError)
        whole = not content.get("is_diff", False)
        if self._fault is not None and not whole:
            raise self._fault
        if whole:
            self._clear()
        try:
            self._update(content)
            self._fault = None
        except SceneError as error:
            self._fault = SceneError(error.reason, path=path, where=error.where, value=error.value)
            raise self._fault from error

    def _update(self, content: Mapping[str, Any]) -> None:
        check_keys(content, MESSAGE, "")
        world = check_mapping(or_else(content.get("world"), {}), "world")
        check_keys(world, WORLD, "world")
        for key in _REPLACED:
            given = content.get(key)
            is_empty = given is None or (
                hasattr(given, "__len__") and not isinstance(given, Mapping) and not len(given)
            )
            if key == "allowed_collision_matrix" and not is_empty:
                is_empty = not len(or_else(check_mapping(given, key).get("entry_names"), ()))
            if not is_empty or key not in self._parts:
                self._parts[key] = or_else(given, {} if key == "allowed_collision_matrix" else ())
                self._read.clear()
                self._frames = None
        # Without transforms, the first frame that an object names is the planning frame from then on.
        frames = self._frames = self._frames or FixedFrames(self._parts)
        for index, item in enumerate(attached_items(content)):
            self._attach(item, f"{ATTACHED}[{index}]")
        for index, item in enumerate(sequence(or_else(world.get("collision_objects"), ()), _OBJECTS)):
            self._change(check_mapping(item, f"{_OBJECTS}[{index}]"), f"{_OBJECTS}[{index}]")
        octomap = check_mapping(or_else(world.get("octomap"), {}), "world.octomap")
        tree = check_mapping(or_else(octomap.get("octomap"), {}), "world.octomap.octomap")
        if tree.get("id") or _has_values(tree.get("data")):
            self._octomap = octomap
            self._read.pop("", None)
        check_parts(self._parts, {"collision_objects": list(self._objects.values())}, _OBJECTS, self._leave_out)
        if "link_padding" in self._leave_out and any(
            not is_number(fields_of(item).get("padding", 0.0)) for item in self._parts["link_padding"]
        ):
            raise SceneError("expected numbers", where="link_padding")
        for name, item in self._objects.items():
            if name not in self._read:
                found = read_object(item, f"{_OBJECTS}[{name!r}]", frames, self._base, open_meshes=self._open_meshes)
                self._read[name] = tuple(found)
        if "" not in self._read:
            octomap = {} if "octomap" in self._leave_out else self._octomap
            self._read[""] = read_map(octomap, "world.octomap", frames, self._base, "octomap")
        self._obstacles = tuple(item for name in (*self._objects, "") for item in self._read[name])

    def _attach(self, item: Mapping[str, Any], where: str) -> None:
        held = check_mapping(or_else(item.get("object"), {}), f"{where}.object")
        if operation_of(held) == "remove":
            # Without a name, all objects of the link.
            link = item.get("link_name")
            on_link = [name for name, parts in self._attached.items() if not link or parts[0].frame == link]
            for name in [str(held["id"])] if held.get("id") else on_link:
                self._attached.pop(name, None)
            return
        name = object_name(held, f"{where}.object")
        self._objects.pop(name, None)
        if "attached_collision_objects" not in self._leave_out:
            self._attached[name] = read_held(item, where, open_meshes=self._open_meshes)

    def _change(self, item: Mapping[str, Any], where: str) -> None:
        operation = operation_of(item)
        if operation == "remove" and not item.get("id"):
            self._objects.clear()
            self._octomap = {}
            self._read.clear()
            return
        name = object_name(item, where)
        if operation == "append" and name not in self._objects:
            operation = "add"
        if operation == "move" and name not in self._objects:
            reason = f"expected a known object to move ({', '.join(self._objects) or 'none'}), got {name!r}"
            raise SceneError(reason, where=f"{where}.id", value=name)
        self._read.pop(name, None)
        if operation == "remove":
            self._objects.pop(name, None)
            if name == "<octomap>":
                self._octomap = {}
                self._read.pop("", None)
        elif operation == "add":
            self._objects[name] = item
        elif operation == "append":
            self._objects[name] = _extended(self._objects[name], item, where)
        elif operation == "move":
            self._objects[name] = _moved(self._objects[name], item)
        else:
            got = item.get("operation")
            raise SceneError(f"unknown operation {got!r}", where=f"{where}.operation", value=got)


_SHAPES = {"primitives": "primitive_poses", "meshes": "mesh_poses"}


def _has_values(content: Any) -> bool:
    return content is not None and hasattr(content, "__len__") and len(content) > 0


def _extended(known: Mapping[str, Any], more: Mapping[str, Any], where: str) -> Mapping[str, Any]:
    """An object with the shapes of another message appended, whose pose must be the same."""
    if _has_values(more.get("planes")):
        raise SceneError("a plane is infinite; replace it by a box", where=f"{where}.planes")
    found = dict(known)
    for key, poses in _SHAPES.items():
        for field in (key, poses):
            found[field] = [*or_else(known.get(field), ()), *or_else(more.get(field), ())]
        if found[poses] and len(found[poses]) != len(found[key]):
            reason = f"expected a pose for each of {len(found[key])} {key}, got {len(found[poses])}"
            raise SceneError(reason, where=f"{where}.{poses}")
    return found


def _moved(known: Mapping[str, Any], item: Mapping[str, Any]) -> Mapping[str, Any]:
    """An object at the pose of another message, in that message's frame; with its shapes' poses if it has any."""
    found = {**known, "pose": item.get("pose")}
    if item.get("header") is not None and fields_of(item["header"]).get("frame_id"):
        found["header"] = item["header"]
    return found | {poses: item[poses] for poses in _SHAPES.values() if _has_values(item.get(poses))}
