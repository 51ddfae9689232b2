"""Planning scenes of MoveIt as messages, with field names of ROS and of benchmarks."""

from __future__ import annotations

import json
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hplan.apps.ros import read_moveit_scene, read_planning_scene
from hplan.errors import OptionError, SceneError
from hplan.scene.obstacles import Box, Cylinder, Mesh

#: As robowflex writes a problem of MotionBenchMaker.
WORDS = """\
name: shelf
robot_model_name: panda
world:
  collision_objects:
    - id: Can1
      header: {frame_id: world}
      primitives: [{type: cylinder, dimensions: [0.14, 0.03]}]
      primitive_poses:
        - {position: [0.5, 0.25, 0.75], orientation: [0, 0, 0.6, 0.8]}
      operation: add
    - id: shelf
      header: {frame_id: world}
      primitives:
        - {type: box, dimensions: [0.7, 0.6, 0.04]}
        - {type: sphere, dimensions: [0.1]}
      primitive_poses:
        - {position: [1, 0, 0.5], orientation: [0, 0, 0, 1]}
        - {position: [1, 0, 1.5], orientation: [0, 0, 0, 1]}
"""

TEXT = """\
shelf
* Can1
0 0 0
0 0 0 1
1
cylinder
0.03 0.14
0.5 0.25 0.75
0 0 0.6 0.8
0 0 0 0
0
* shelf
0 0 0
0 0 0 1
2
box
0.7 0.6 0.04
1 0 0.5
0 0 0 1
0 0 0 0
sphere
0.1
1 0 1.5
0 0 0 1
0 0 0 0
0
.
"""


def message() -> dict[str, Any]:
    """The scene as ROS has it: numbers for kinds, poses by their parts, an object's own pose."""

    def pose(position: list[float], turn: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> dict[str, Any]:
        return {
            "position": dict(zip("xyz", position, strict=True)),
            "orientation": dict(zip("xyzw", turn, strict=True)),
        }

    def item(
        name: str, place: dict[str, Any], shapes: list[tuple[int, list[float]]], poses: list[Any]
    ) -> dict[str, Any]:
        return {
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "world"},
            "pose": place,
            "id": name,
            "type": {"key": "", "db": ""},
            "primitives": [{"type": kind, "dimensions": sizes, "polygon": {"points": []}} for kind, sizes in shapes],
            "primitive_poses": poses,
            "meshes": [],
            "mesh_poses": [],
            "planes": [],
            "plane_poses": [],
            "operation": 0,
        }

    return {
        "name": "shelf",
        "world": {
            "collision_objects": [
                item(
                    "Can1", pose([0.5, 0.25, 0.0], (0.0, 0.0, 0.6, 0.8)), [(3, [0.14, 0.03])], [pose([0.0, 0.0, 0.75])]
                ),
                item(
                    "shelf",
                    pose([1.0, 0.0, 0.0], (0.0, 0.0, 0.0, 0.0)),
                    [(1, [0.7, 0.6, 0.04]), (2, [0.1])],
                    [pose([0.0, 0.0, 0.5]), pose([0.0, 0.0, 1.5])],
                ),
            ],
            "octomap": {"header": {"frame_id": ""}, "octomap": {"data": [], "resolution": 0.0}},
        },
    }


def as_numbers(obstacles: Any) -> list[Any]:
    return [(item.name, item.kind, np.round(item.core, 9).tolist(), item.rounding) for item in obstacles]


def test_words_numbers_and_text_agree(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(WORDS)
    (tmp_path / "scene.json").write_text(json.dumps(message()["world"]))
    (tmp_path / "moveit.scene").write_text(TEXT)
    found = read_planning_scene(tmp_path / "scene.yaml")
    assert [item.name for item in found] == ["Can1", "shelf 1", "shelf 2"]
    can, box, _ = found
    assert isinstance(can, Cylinder)
    assert (can.length, can.radius, can.center) == (0.14, 0.03, (0.5, 0.25, 0.75))
    assert isinstance(box, Box)
    assert as_numbers(found) == as_numbers(read_planning_scene(message()))
    assert as_numbers(found) == as_numbers(read_planning_scene(str(tmp_path / "scene.json")))
    assert as_numbers(found) == as_numbers(read_moveit_scene(tmp_path / "moveit.scene"))
    moved = read_planning_scene(message(), position=(0.0, 0.0, 1.0), prefix="a ")
    assert [(item.name, item.core[0, 2] - other.core[0, 2]) for item, other in zip(moved, found, strict=True)] == [
        (f"a {item.name}", pytest.approx(1.0)) for item in found
    ]


def test_meshes_and_cones() -> None:
    scene = message()
    vertices = [
        {"x": x, "y": y, "z": z} for x, y, z in [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    ]
    faces = [{"vertex_indices": row} for row in ([0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3])]
    first, second = scene["world"]["collision_objects"]
    first |= {"primitives": [], "primitive_poses": [], "meshes": [{"vertices": vertices, "triangles": faces}]}
    first |= {"mesh_poses": [{"position": {"x": 0.0, "y": 0.0, "z": 1.0}}], "pose": {}}
    second["primitives"][1] = {"type": 4, "dimensions": [0.8, 0.3]}
    wedge, _, cone = read_planning_scene(scene)
    assert isinstance(wedge, Mesh)
    assert wedge.surface[0].min(axis=0).tolist() == [0.0, 0.0, 1.0]
    assert isinstance(cone, Mesh)
    heights = cone.surface[0][:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((1.1, 1.9))
    first["meshes"][0]["triangles"].pop()
    with pytest.raises(SceneError, match=r"world.collision_objects\[0\].meshes\[0\]"):
        read_planning_scene(scene)
    assert read_planning_scene(scene, open_meshes="hull")[0].kind == "mesh"


WRONG: dict[str, tuple[list[Any], Any, str, str]] = {
    "no number": (
        ["primitives", 0, "dimensions"],
        [0.14, "x"],
        ".primitives[0].dimensions",
        "2 numbers for a cylinder",
    ),
    "negative": (["primitives", 0, "dimensions"], [0.14, -1.0], ".primitives[0]", "greater than 0"),
    "kind": (["primitives", 0, "type"], 9, ".primitives[0].type", "expected one of 1 (box), 2 (sphere)"),
    "quaternion": (["pose", "orientation"], [1.0, 1.0, 0.0, 0.0], ".pose.orientation", "has the length 1.414"),
    "pose": (["pose"], "here", ".pose", "a mapping of keys"),
    "twice": (["id"], "shelf", "", "two objects 'shelf'"),
    "frame": (["header", "frame_id"], "elsewhere", "", "expected one frame"),
    "removed": (["operation"], 1, ".operation", "expected an object that is added"),
    "plane": (["planes"], [{"coef": [0, 0, 1, 0]}], ".planes", "a plane is infinite"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors_name_fault_and_place(case: str) -> None:
    steps, value, where, reason = WRONG[case]
    scene = message()
    item = scene["world"]["collision_objects"][0]
    for step in steps[:-1]:
        item = item[step]
    item[steps[-1]] = value
    with pytest.raises(SceneError) as error:
        read_planning_scene(scene)
    assert reason in error.value.reason
    assert (error.value.where or "").startswith("world.collision_objects[")
    assert where in (error.value.where or "")


def echoed(operation: Any = "\0", frame: str = "base_link", **parts: Any) -> dict[str, Any]:
    """A planning scene as `rosidl_runtime_py.message_to_ordereddict` writes it."""
    scene = message()
    for item in scene["world"]["collision_objects"]:
        item |= {"operation": operation, "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}}
        item |= {"subframe_names": [], "subframe_poses": []}
    state = {"joint_state": {"name": ["elbow"], "position": [0.1]}, "attached_collision_objects": [], "is_diff": False}
    scene |= {"robot_state": state, "robot_model_name": "ur5", "fixed_frame_transforms": [], "link_padding": []}
    scene |= {"allowed_collision_matrix": {"entry_names": [], "entry_values": []}, "link_scale": [], "is_diff": False}
    return scene | {"object_colors": []} | parts


@pytest.mark.parametrize("operation", [0, "\0", b"\0", bytearray(b"\0"), np.uint8(0), "add"])
def test_scenes_as_ros_writes_them(tmp_path: Path, operation: Any) -> None:
    expected = as_numbers(read_planning_scene(message()))
    scene = echoed(operation)
    assert as_numbers(read_planning_scene(scene)) == expected
    # Messages hold arrays.
    can, shelf = scene["world"]["collision_objects"]
    can["primitives"][0]["dimensions"] = array("d", can["primitives"][0]["dimensions"])
    shelf["primitives"][0] |= {"dimensions": np.array(shelf["primitives"][0]["dimensions"]), "type": np.uint8(1)}
    assert as_numbers(read_planning_scene(scene)) == expected
    if isinstance(operation, int | str):
        text = yaml.safe_dump(echoed(operation), width=10**6)
        for number, (before, after) in enumerate([("", ""), ("", "---\n"), ("---\n", "---\n---\n\n"), ("", "---")]):
            path = tmp_path / f"{number}.yaml"
            path.write_text(before + text + after)
            assert as_numbers(read_planning_scene(path)) == expected
        path.write_text(f"{text}---\n{text}---\n")
        with pytest.raises(SceneError, match="several messages; expected one"):
            read_planning_scene(path)


def held(name: str) -> dict[str, Any]:
    """A state in which an object is attached to the tool."""
    item = {**echoed()["world"]["collision_objects"][0], "id": name}
    return {"attached_collision_objects": [{"link_name": "tool0", "object": item, "touch_links": []}]}


def allowed(one: str, other: str) -> dict[str, Any]:
    """A matrix in which two bodies may touch."""
    names = ["wrist", one, other]
    rows = [[{a, b} == {one, other} for b in names] for a in names]
    return {"entry_names": names, "entry_values": [{"enabled": row} for row in rows]}


#: Parts that would change which motions are allowed: the part, its container, the key, and the message.
PARTS: list[tuple[str, dict[str, Any], str, str]] = [
    ("attached_collision_objects", {"robot_state": held("pole")}, "robot_state.", "'pole' is attached to link 'tool0'"),
    ("link_padding", {"link_padding": [{"link_name": "wrist", "padding": 0.05}]}, "link_padding", "0.05 m or more"),
    ("link_scale", {"link_scale": [{"link_name": "wrist", "scale": 1.1}]}, "link_scale", "has the scale 1.1"),
    ("allowed_collision_matrix", {"allowed_collision_matrix": allowed("Can1", "hand")}, "allowed", "'Can1' may touch"),
    (
        "allowed_collision_matrix",
        {"allowed_collision_matrix": {"default_entry_names": ["Can1"], "default_entry_values": [True]}},
        "allowed",
        "'Can1' may touch 'every link'",
    ),
    ("is_diff", {"is_diff": True}, "is_diff", "lacks the objects that did not change"),
]


@pytest.mark.parametrize(("part", "content", "where", "reason"), PARTS)
def test_parts_that_change_motions_are_refused(part: str, content: dict[str, Any], where: str, reason: str) -> None:
    scene = echoed(**content)
    with pytest.raises(SceneError) as error:
        read_planning_scene(scene)
    assert reason in error.value.reason
    assert f"leave_out=({part!r},)" in error.value.reason
    assert (error.value.where or "").startswith(where)
    assert as_numbers(read_planning_scene(scene, leave_out=[part])) == as_numbers(read_planning_scene(message()))
    with pytest.raises(SceneError):
        read_planning_scene(scene, leave_out=["octomap"])


def test_parts_that_change_nothing_are_read() -> None:
    expected = as_numbers(read_planning_scene(message()))
    scene = echoed(
        link_padding=[{"link_name": "wrist", "padding": 0.0}],
        link_scale=[{"link_name": "wrist", "scale": 1.0}],
        allowed_collision_matrix={
            **allowed("hand", "finger"), "default_entry_names": ["finger"], "default_entry_values": [True]
        },
    )  # fmt: skip
    assert as_numbers(read_planning_scene(scene)) == expected
    assert as_numbers(read_planning_scene(echoed(allowed_collision_matrix=allowed("Can1", "shelf")))) == expected
    with pytest.raises(OptionError, match="leave_out = 'colours': expected one of attached_collision_objects"):
        read_planning_scene(scene, leave_out=["colours"])


@pytest.mark.parametrize("data", [[1, 2], array("b", [1]), np.array([0], np.int8), "<sequence type: int8, length: 0>"])
def test_incomplete_octomaps_are_refused(data: Any) -> None:
    scene = echoed()
    scene["world"]["octomap"]["octomap"]["data"] = data
    with pytest.raises(SceneError, match=r"world\.octomap\.octomap\.(id|data)"):
        read_planning_scene(scene)
    assert len(read_planning_scene(scene, leave_out=["octomap"])) == 3


def fixed(parent: str, child: str, shift: list[float]) -> dict[str, Any]:
    """A transform of a frame."""
    translation = dict(zip("xyz", shift, strict=True))
    turn = {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}
    return {
        "header": {"frame_id": parent}, "child_frame_id": child,
        "transform": {"translation": translation, "rotation": turn if shift[0] else {"x": 0, "y": 0, "z": 0, "w": 1}},
    }  # fmt: skip


def test_objects_are_in_fixed_frames() -> None:
    transforms = [fixed("table", "tray", [0.0, 0.2, 0.3]), fixed("world", "table", [1.0, 0.0, 0.0])]
    scene = echoed(frame="/tray", fixed_frame_transforms=[*transforms, fixed("world", "world", [0.0, 0.0, 0.0])])
    scene["world"]["collision_objects"][0]["header"]["frame_id"] = "world"
    can, box, _ = read_planning_scene(scene)
    other_can, other_box, _ = read_planning_scene(message())
    np.testing.assert_allclose(can.core, other_can.core, atol=1e-12)
    cos, sin = 0.8**2 - 0.6**2, 2.0 * 0.6 * 0.8
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        box.core, (other_box.core + np.array([0.0, 0.2, 0.3])) @ turn.T + [1.0, 0.0, 0.0], atol=1e-12
    )
    scene["world"]["collision_objects"][0]["header"]["frame_id"] = "camera"
    with pytest.raises(SceneError, match="'Can1' is in frame 'camera', the known frames are 'world', 'tray', 'table'"):
        read_planning_scene(scene)
    for wrong, reason in (
        (fixed("tray", "table", [0.0, 0.0, 0.0]), "is its own parent"),
        (fixed("map", "wall", [0.0, 0.0, 0.0]), "expected one root of all frames, got 'map', 'table'"),
        (fixed("table", "tray", [1.0, 0.2, 0.3]), r"\[1\]: expected one transform of frame 'tray', got two"),
    ):
        with pytest.raises(SceneError, match=reason):
            read_planning_scene(echoed(fixed_frame_transforms=[transforms[0], wrong]))


@pytest.mark.parametrize(
    ("steps", "key"),
    [([], "link_paddings"), (["world"], "octomaps"), (["world", "collision_objects", 0], "mesh"),
     (["world", "collision_objects", 0, "pose"], "postion")],
)  # fmt: skip
def test_unknown_keys_are_refused(steps: list[Any], key: str) -> None:
    scene = part = echoed()
    for step in steps:
        part = part[step]
    part[key] = []
    assert len(read_planning_scene(scene)) == 3  # it holds nothing
    part[key] = [1.0, 0.0, 0.0]
    with pytest.raises(SceneError, match=rf"{key}: unknown key; expected one of"):
        read_planning_scene(scene)
