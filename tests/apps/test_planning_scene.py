"""Planning scenes of MoveIt as messages, in the words of ROS and in those of benchmarks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hplan.apps.ros import read_moveit_scene, read_planning_scene
from hplan.errors import SceneError
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


def test_words_numbers_and_text_say_the_same(tmp_path: Path) -> None:
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
    "removed": (["operation"], 1, ".operation", "only objects that are added"),
    "plane": (["planes"], [{"coef": [0, 0, 1, 0]}], ".planes", "a plane has no end"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_and_where(case: str) -> None:
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
