"""Scenes and files that are too large are refused before they cost time; large ones are planned among."""

from __future__ import annotations

import numpy as np
import pytest

from hplan import plan
from hplan.base import yaml_text
from hplan.errors import SceneError
from hplan.scene import file as scene_file
from hplan.scene.file import load_scene, parse_scene, save_scene
from hplan.scene.limits import FARTHEST_M, MOST_OBSTACLES
from hplan.scene.model import Fruit, Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Mesh, PointCloud, Sphere

HEAD = """format: hplan-scene/1
name: a scene
start: {joints_deg: [0, 0, 0, 0]}
goal: {joints_deg: [0, 45, 60, 70]}
"""


def ball(index: int) -> Sphere:
    return Sphere(name=f"b{index}", center=(2.0, 0.0, 1.0), radius=0.01)


def test_a_scene_has_a_largest_number_of_obstacles():
    balls = tuple(ball(i) for i in range(MOST_OBSTACLES + 1))
    start, goal = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0,) * 4)
    Scene(name="a", start=start, goal=goal, obstacles=balls[1:])
    with pytest.raises(ValueError, match="at most 20000 items"):
        Scene(name="a", start=start, goal=goal, obstacles=balls)
    fruits = tuple(Fruit(name=f"f{i}", center=(0.0, 0.0, 9.0), radius=0.1) for i in range(MOST_OBSTACLES + 1))
    with pytest.raises(ValueError, match="at most 20000 items"):
        Scene(name="a", start=start, goal=goal, fruits=fruits)


def test_a_yaml_file_has_a_largest_number_of_values(monkeypatch):
    monkeypatch.setattr(yaml_text, "MOST_VALUES", 21)
    assert parse_scene(HEAD).name == "a scene"
    with pytest.raises(SceneError, match="line 5: malformed YAML: more than 21 values"):
        parse_scene(f"{HEAD}obstacles: [1, 2, 3]\n")


def cube() -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return vertices, np.array(faces)


def test_files_of_a_scene_have_a_largest_size_together(tmp_path, monkeypatch):
    start, goal = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0,) * 4)
    meshes = tuple(Mesh.of(f"m{i}", *cube(), position=(2.0 * i, 5.0, 0.0)) for i in range(2))
    cloud = PointCloud.of("cloud", [[9.0, 9.0, 9.0]], 0.1)
    path = save_scene(Scene(name="a", start=start, goal=goal, obstacles=(*meshes, cloud)), tmp_path / "scene.yaml")
    sizes = [file.stat().st_size for file in sorted(tmp_path.glob("*.ply"))]
    monkeypatch.setattr(scene_file, "MOST_SHAPE_BYTES", sum(sizes))
    assert len(load_scene(path).obstacles) == 3
    monkeypatch.setattr(scene_file, "MOST_SHAPE_BYTES", sum(sizes) - 1)
    with pytest.raises(SceneError, match=r"obstacles\[2\]\.file: .*and the files before it") as caught:
        load_scene(path)
    assert caught.value.line is not None


@pytest.mark.filterwarnings("error")
def test_shapes_do_not_reach_farther_than_a_scene():
    vertices, faces = cube()
    millimetres = Mesh.of("m", 1e6 * vertices, faces, scale=1e-3)
    assert millimetres.surface[0].max() == pytest.approx(1e3)
    for shift, scale in ((2e7, 1e-3), (1e306, 1e-303), (1.0, 1e308)):
        with pytest.raises(SceneError, match=r"reach|across"):
            Mesh.of("m", vertices + shift, faces, scale=scale)
    with pytest.raises(SceneError, match=r"points reach 1.1e\+04; expected metres, at most 10000"):
        PointCloud.of("c", [[0.0, 0.0, 1.1e4]], 0.1)
    with pytest.raises(SceneError, match="less than or equal to 10000"):
        PointCloud.of("c", [[0.0, 0.0, 0.0]], 1e308)
    with pytest.raises(SceneError, match="less than or equal to 10000"):
        Mesh.of("m", vertices, faces, position=(0.0, 1e200, 0.0))


@pytest.mark.filterwarnings("error")
def test_obstacles_at_the_limit_are_planned_among(robot):
    far = Sphere(name="far", center=(FARTHEST_M, -FARTHEST_M, FARTHEST_M), radius=1.0)
    long = Capsule(name="long", start=(-FARTHEST_M, 5.0, 0.0), end=(FARTHEST_M, 5.0, 0.0), radius=1.0)
    scene = parse_scene(HEAD).with_obstacles([far, long])
    assert plan(robot, scene).certificate.verified


def test_ten_thousand_obstacles_are_planned_among(robot):
    """Before several geometry models, 4,000 did not finish in a minute."""
    rng = np.random.default_rng(0)
    places = rng.uniform([-2.5, -2.5, 0.3], [2.5, -0.25, 3.0], (10_000, 3)).tolist()
    balls = [Sphere(name=f"b{i}", center=tuple(place), radius=0.01) for i, place in enumerate(places)]
    scene = parse_scene(HEAD.replace("[0, 0, 0, 0]", "[60, 10, 20, 20]").replace("[0, 45", "[20, 45"))
    scene = scene.with_obstacles(balls)
    result = plan(robot, scene)
    assert result.certificate.verified
