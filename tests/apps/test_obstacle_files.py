"""Obstacles of other programs' files: octomaps, clouds of bags, MoveIt scenes named in a scene file."""

from __future__ import annotations

import base64
import itertools
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hplan
from hplan.apps.ros import cloud_points, read_bag_cloud, read_octomap, read_planning_scene
from hplan.apps.ros.mcap_file import Message, write_bag
from hplan.errors import OptionError, SceneError
from hplan.scene import Box

#: Files that the programs of OctoMap 1.10 wrote for six points (log2graph, graph2tree -res 0.1), compressed.
BT = base64.b64decode(
    "eNptTUtKA0EQfZNObxqhk4ULdxVmoxBiEnCtN3AW5gCdmRrTMB+Z7gh6Og/gYRo8gFaDy/Dq96pe8Up6ruPYuzfpLxMzHf3gpg9qfcempNuWua"
    "M2H+JIrmnonuqTG16Z6rHveYhhTcdzpI7du2hOLJ9TEO4HJhfIR/JhdWdK45t/CxP8J9PuYW8mDrTd7EzjojP43uISkJJkhUrqNfQ8feERT0I1"
    "rNTFFW6gLsAC1ubQ0DqLrS40DtWhUlb9zmQiyHqWsgAJy2yh8COOC2VR5C1UsfoD6yU+rw=="
)
OT = base64.b64decode(
    "eNpTVvBPLsnPTSwA0iFFqakKaZk5qVzKChppqak5CmkgkZJ8hcSUFAV9heSMxLz0VIXk/Nzc1LySYh2FpNIShZzUxDKgmgyQzqJiID8zL1UhsV"
    "ghs0Qhs1hRk0uZKzMFajZXcWZVqoKhqRFXUWqxgoGeIVdKYkkiV/OLCPsFIIKFPOKA/Mzz+3hABILFACfQuGAl7KhiYEIZTQxkcg+IVQAiGlAN"
    "QKgzwMJFU+IAN48JRLDDuQiLGEkmmEEE2DZmEGGMyy0ILjNeLtgAYSzhgqbuPBYlDCQpATncEER8hHuGWG0scMUGqBICcAkewl4FKzmKy6IDWE"
    "y+AOKyIOISRBiCCAEiQhduSiCqGAMAwN6HIA=="
)

#: Voxels that hold those points.
OCCUPIED = {(8, 0, 8), (10, 1, 10), (10, 2, 11), (15, -4, 12), (20, 5, 15)}


def voxels(boxes: Any, edge: float = 0.1) -> list[tuple[int, ...]]:
    """Voxels of axis-parallel boxes, those of overlapping boxes several times."""
    found: list[tuple[int, ...]] = []
    for box in boxes:
        ends = [np.round((np.array(box.center) + sign * np.array(box.size) / 2) / edge).astype(int) for sign in (-1, 1)]
        found += itertools.product(*(range(low, high) for low, high in zip(*ends, strict=True)))
    return found


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "tree.bt"
    path.write_bytes(zlib.decompress(BT))
    return path


def test_octomap_files_of_both_formats(map_file: Path) -> None:
    full = map_file.with_suffix(".ot")
    full.write_bytes(zlib.decompress(OT))
    for path in (map_file, full):
        assert set(voxels(read_octomap(path))) == OCCUPIED
    placed = read_octomap(map_file, name="map", position=(0.0, 0.0, 1.0))
    assert set(voxels(placed)) == {(x, y, z + 10) for x, y, z in OCCUPIED}
    assert placed[0].name == "map 1"
    coarse = read_octomap(map_file, depth=14)
    assert set(voxels(coarse, 0.4)) == {tuple(np.floor_divide(v, 4).tolist()) for v in OCCUPIED}


def encode(occupied: set[tuple[int, int, int]], low: tuple[int, int, int], edge: int) -> tuple[int, bytes]:
    """Kind of a node (0 unknown, 2 occupied, 3 inner) and its binary data."""
    inside = [v for v in occupied if all(b <= x < b + edge for x, b in zip(v, low, strict=True))]
    if len(inside) in (0, edge**3):
        return (2 if inside else 0), b""
    half, kinds, below = edge // 2, 0, b""
    for number in range(8):
        corner = tuple(b + half * (number >> axis & 1) for axis, b in enumerate(low))
        kind, data = encode(set(inside), corner, half)  # type: ignore[arg-type]
        kinds, below = kinds | kind << 2 * number, below + data
    return 3, struct.pack("<H", kinds) + below


@pytest.mark.parametrize("seed", range(6))
def test_boxes_of_an_octomap_are_its_voxels(seed: int) -> None:
    """Every voxel is in exactly one box, however large its leaf is."""
    random = np.random.default_rng(seed)
    occupied: set[tuple[int, int, int]] = set()
    for _ in range(5):
        low, size = random.integers(-6, 6, 3), random.integers(1, 6, 3)
        occupied |= set(itertools.product(*(range(a, a + n) for a, n in zip(low.tolist(), size.tolist(), strict=True))))
    _, data = encode(occupied, (-32768,) * 3, 65536)
    message = {"binary": True, "id": "OcTree", "resolution": 0.05, "data": np.frombuffer(data, np.int8).tolist()}
    boxes = read_octomap(message)
    assert sorted(voxels(boxes, 0.05)) == sorted(occupied)
    assert len(boxes) < len(occupied)
    scene = {"world": {"collision_objects": [], "octomap": {"origin": {"position": [1, 0, 0]}, "octomap": message}}}
    moved = read_planning_scene(scene)
    assert [box.name for box in moved] == [box.name for box in boxes]
    shifts = np.array([box.center for box in moved]) - np.array([box.center for box in boxes])
    np.testing.assert_allclose(shifts, [(1.0, 0.0, 0.0)] * len(boxes), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: b"", "not an octomap file"),
        (lambda data: data[:-1], "end too early"),
        (lambda data: data.replace(b"id OcTree", b"id Countless"), "type OcTree or ColorOcTree, got 'Countless'"),
        (lambda data: data.replace(b"res 0.1", b"res much"), "res METRES"),
        (lambda data: data.replace(b"res 0.1", b"res 0.0"), "resolution in metres, got 0.0"),
        (lambda data: data.partition(b"data\n")[0] + b"data\n\0\0", "nothing is occupied"),
        (lambda data: data.replace(b"res 0.1", b"res 1e9"), "10000"),
    ],
)
def test_malformed_octomaps(map_file: Path, change: Any, said: str) -> None:
    map_file.write_bytes(change(map_file.read_bytes()))
    with pytest.raises(SceneError, match=said):
        read_octomap(map_file)


def test_octomap_options(map_file: Path) -> None:
    with pytest.raises(OptionError, match="depth"):
        read_octomap(map_file, depth=17)
    with pytest.raises(SceneError, match="No such file"):
        read_octomap(map_file.with_name("none.bt"))
    with pytest.raises(SceneError, match="key is missing"):
        read_octomap({"id": "OcTree"})


# Bags

POINTS = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0], [0.0, 0.2, 1.5]])


def cloud_message(stamp: int, frame: str, points: Any) -> dict[str, Any]:
    rows = np.vstack([points, np.full((1, 3), np.nan)]).astype("<f4")
    fields = [{"name": axis, "offset": 4 * k, "datatype": 7, "count": 1} for k, axis in enumerate("xyz")]
    return {
        "header": {"stamp": {"sec": stamp, "nanosec": 0}, "frame_id": frame}, "height": 1, "width": len(rows),
        "fields": fields, "is_bigendian": False, "point_step": 12, "row_step": 12 * len(rows),
        "data": np.frombuffer(rows.tobytes(), np.uint8), "is_dense": False,
    }  # fmt: skip


def transform(stamp: int, parent: str, child: str, shift: Any, turn: Any = (0.0, 0.0, 0.0, 1.0)) -> dict[str, Any]:
    translation, rotation = dict(zip("xyz", shift, strict=True)), dict(zip("xyzw", turn, strict=True))
    header = {"stamp": {"sec": stamp, "nanosec": 0}, "frame_id": parent}
    return {"header": header, "child_frame_id": child, "transform": {"translation": translation, "rotation": rotation}}


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Clouds at 10 s and 12 s of a camera on a mast that is moved meanwhile, beside the base."""
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    half = np.sqrt(0.5).item()
    static = [transform(0, "/world", "base_link", (0.0, 0.0, 0.5)), transform(0, "mast", "camera", (0.0, 0.0, 0.2))]
    moved = [transform(t, "world", "mast", (x, 0.0, 1.0), (0.0, 0.0, half, half)) for t, x in ((10, 1.0), (12, 2.0))]
    second = int(1e9)
    messages = [
        Message("/tf_static", 9 * second, {"transforms": static}),
        Message("/tf", 10 * second, {"transforms": [moved[0]]}),
        Message("/points", 10 * second, cloud_message(10, "camera", POINTS)),
        Message("/tf", 12 * second, {"transforms": [moved[1]]}),
        Message("/points", 12 * second, cloud_message(12, "camera", POINTS)),
        Message("/base", 12 * second, cloud_message(12, "base_link", POINTS)),
    ]
    cloud, transforms = ("sensor_msgs/msg/PointCloud2", 0), ("tf2_msgs/msg/TFMessage", 0)
    topics = {"/points": cloud, "/base": cloud, "/tf": transforms, "/tf_static": transforms}
    return write_bag(tmp_path / "run.mcap", topics, messages)


@pytest.mark.parametrize(("time_s", "x"), [(0.0, 1.0), (1.0, 1.0), (1.5, 2.0), (3.0, 2.0)])
def test_cloud_of_a_bag_is_where_the_transforms_put_it(bag: Path, time_s: float, x: float) -> None:
    cloud = read_bag_cloud(bag, radius=0.01, topic="/points", time_s=time_s)
    turned = np.stack([-POINTS[:, 1], POINTS[:, 0], POINTS[:, 2]], axis=1)
    np.testing.assert_allclose(cloud.points - turned, [(x, 0.0, 1.0 + 0.2 - 0.5)] * 3, atol=1e-6)
    assert cloud.radius == 0.01


def test_cloud_in_the_frame_of_the_base_or_with_a_given_pose(bag: Path) -> None:
    own = read_bag_cloud(bag, radius=0.01, topic="/base")
    np.testing.assert_allclose(own.points, POINTS, atol=1e-6)
    given = read_bag_cloud(bag, radius=0.01, topic="/points", position=(0.0, 0.0, 2.0))
    np.testing.assert_allclose(given.points - POINTS, [(0.0, 0.0, 2.0)] * 3, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "expected a topic, one of /base, /points"),
        ({"topic": "/tf"}, "PointCloud2 .*/points.*got '/tf'"),
        ({"topic": "/points", "time_s": 4.0}, "no cloud of /points at or after 4 s; the bag is 3 s long"),
        ({"topic": "/points", "frame": "base"}, "no transforms lead from 'camera' to 'base' .*mast"),
    ],
)
def test_wrong_clouds_of_a_bag(bag: Path, options: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        read_bag_cloud(bag, radius=0.01, **options)


def test_files_that_are_no_bags(tmp_path: Path, bag: Path) -> None:
    (tmp_path / "text.mcap").write_text("no bag")
    (tmp_path / "cut.mcap").write_bytes(bag.read_bytes()[:300])
    for name in ("text.mcap", "cut.mcap", "none.mcap", "none.bag", "."):
        with pytest.raises(SceneError, match=str(tmp_path)):
            read_bag_cloud(tmp_path / name, radius=0.01)


def test_cloud_message_without_coordinates() -> None:
    steps = {"is_bigendian": False, "width": 1, "height": 1, "point_step": 1, "row_step": 1, "data": b"0"}
    with pytest.raises(SceneError, match="fields x, y and z"):
        cloud_points({**steps, "fields": [{"name": "x", "offset": 0, "datatype": 2}]})


# Scene files

SCENE = """
format: hplan-scene/1
name: imported
start: {joints_deg: [0, 90, 90, 90]}
goal: {joints_deg: [60, 20, 30, 20]}
obstacles:
  - {kind: sphere, name: ball, center: [-1, 0, 1], radius: 0.1}
  - {kind: import, file: tree.bt, name: tree, position: [0, 3, 0]}
  - {kind: import, file: shelf.scene}
  - {kind: import, file: run.mcap, name: canopy, topic: /base, radius: 0.01, position: [5, 0, 0]}
  - {kind: box, name: crate, center: [-1, 1, 0.2], size: [0.2, 0.2, 0.2]}
"""
SHELF = "shelf\n* board\n0 -2 1\n0 0 0 1\n1\nbox\n1 0.4 0.02\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n"


@pytest.fixture
def scene_file(map_file: Path, bag: Path) -> Path:
    (bag.parent / "shelf.scene").write_text(SHELF)
    path = bag.parent / "scene.yaml"
    path.write_text(SCENE)
    return path


def test_scene_file_names_files_of_other_programs(scene_file: Path) -> None:
    scene = hplan.load_scene(scene_file)
    names = [obstacle.name for obstacle in scene.obstacles]
    assert names == ["ball", *(f"tree {k}" for k in range(1, 6)), "board", "canopy", "crate"]
    assert all(isinstance(obstacle, Box) for obstacle in scene.obstacles[1:7])
    np.testing.assert_allclose(scene.obstacles[7].points - POINTS, [(5.0, 0.0, 0.0)] * 3, atol=1e-6)
    robot = hplan.load_robot()
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))
    saved = hplan.load_scene(hplan.save_scene(scene, scene_file.with_name("saved.yaml")))
    assert hplan.certify(robot, saved, result.trajectory).verified
    assert [obstacle.name for obstacle in saved.obstacles] == names


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("tree.bt", "bush.bt", 8, "no such file"),
        ("tree.bt", "tree.txt", 8, "suffixes .*bt"),
        ("topic: /base, radius: 0.01", "topic: /base", 10, "radius"),
        ("shelf.scene", "shelf.scene, depth: 3", 9, "no effect"),
        ("topic: /base", "topic: /tf", 10, "got '/tf'"),
        ("size: [0.2, 0.2, 0.2]", "size: [0.2, 0.2]", 11, "crate|size|too few"),
        ("name: ball", "name: board", 9, "two obstacles are called 'board'"),
    ],
)
def test_faults_of_imports_name_their_line(scene_file: Path, old: str, new: str, line: int, said: str) -> None:
    scene_file.write_text(SCENE.replace(old, new))
    with pytest.raises(SceneError, match=said) as caught:
        hplan.load_scene(scene_file)
    if "two obstacles" not in said:
        assert caught.value.line == line


def test_file_of_obstacles_in_place_of_a_scene_file_is_explained(scene_file: Path) -> None:
    for name in ("shelf.scene", "tree.bt", "run.mcap"):
        with pytest.raises(SceneError, match=rf"no start and goal.*kind: import, file: {name}"):
            hplan.load_scene(scene_file.with_name(name))
