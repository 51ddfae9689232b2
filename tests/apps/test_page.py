"""Pages of motions: positions of arm, obstacles and fruit, names, kinds of robots."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm
from pages import animation_of, commands_of, objects, orchard
from planned import straight
from shapes import crate

from hplan.apps.view import scene_stage
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.apps.view.scene_stage import build_stage, keyframe_times
from hplan.apps.view.scenery import OTHER
from hplan.apps.view.three_js import simplify_mesh
from hplan.collision.held_objects import HELD_COLOR
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Mesh, PointCloud, Sphere
from hplan.trajectory.retime import time_path
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.trajectory import Trajectory

GOAL = (0.0, math.pi / 4, math.pi / 3, math.radians(70.0))


def motion(robot: Robot, goal: Any = GOAL) -> Trajectory:
    return straight(robot, np.zeros(robot.dof), goal)


OBSTACLES = (
    Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15),
    Capsule(name="branch", start=(1.6, 0.5, 0.0), end=(1.2, 0.1, 1.4), radius=0.03),
    Capsule(name="stub", start=(0.4, 0.8, 1.0), end=(0.4, 0.8, 1.0), radius=0.05),
    Box(name="post", center=(1.7, -0.6, 0.9), size=(0.1, 0.2, 1.8), rpy_deg=(0.0, 0.0, 20.0)),
)


def matrix_of(mesh: dict[str, Any]) -> np.ndarray:
    return np.reshape(mesh["matrix"], (4, 4)).T if "matrix" in mesh else np.eye(4)


def replayed(commands: list[dict[str, Any]], key: int) -> dict[str, np.ndarray]:
    """World pose of every mesh of the arm at a keyframe, composed as the viewer composes its tree."""
    local = {c["path"]: np.reshape(c["matrix"], (4, 4)).T for c in commands if c["type"] == "set_transform"}
    for item in animation_of(commands)["animations"]:
        (track,) = item["clip"]["tracks"]
        assert track["name"] == ".quaternion"
        x, y, z, w = track["values"][4 * key : 4 * key + 4]
        local[item["path"]][:3, :3] = pin.Quaternion(w, x, y, z).normalized().matrix()
    poses: dict[str, np.ndarray] = {}
    for path, item in objects(commands).items():
        if not path.startswith("/hplan/arm"):
            continue
        parts = path.split("/")
        pose = np.eye(4)
        for end in range(3, len(parts) + 1):
            pose = pose @ local.get("/".join(parts[:end]), np.eye(4))
        for mesh in item["object"]["children"]:
            poses[mesh["name"]] = pose @ matrix_of(mesh)
    return poses


@pytest.mark.parametrize("row", [0, 250, 500])
def test_animation_puts_every_visual_geometry_where_pinocchio_puts_it(robot: Robot, row: int) -> None:
    q = (0.7, *GOAL[1:])
    trajectory = motion(robot, q)
    commands = build_stage(robot, load_scene(), Playback(trajectory))
    key = int(np.argmin(np.abs(keyframe_times(trajectory) - trajectory.time[row])))
    poses = replayed(commands, key)
    data, visual_data = robot.model.createData(), robot.visual_model.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.visual_model, visual_data, np.array(trajectory.position[row]))
    assert set(poses) == {item.name for item in robot.visual_model.geometryObjects}
    for item, placement in zip(robot.visual_model.geometryObjects, visual_data.oMg, strict=True):
        np.testing.assert_allclose(poses[item.name][:3, 3], placement.translation, atol=1e-5, err_msg=item.name)


def test_obstacles_and_fruits_are_where_the_scene_has_them(robot: Robot) -> None:
    scene = orchard(obstacles=OBSTACLES)
    drawn = objects(build_stage(robot, scene, Playback(motion(robot))))

    def meshes(path: str) -> list[dict[str, Any]]:
        children: list[dict[str, Any]] = drawn[f"/hplan/{path}"]["object"]["children"]
        return children

    (ball,) = meshes("obstacles/sphere ball")
    np.testing.assert_allclose(matrix_of(ball)[:3, 3], (1.0, 0.0, 1.9))
    (post,) = meshes("obstacles/box post")
    np.testing.assert_allclose(matrix_of(post)[:3, :3], scene.obstacles[3].rotation, atol=1e-6)  # type: ignore[union-attr]
    assert len(meshes("fruits/fruit green")) == 1
    assert len(meshes("fruits/fruit ripe")) == 2  # the goal has a halo
    (surface,) = drawn["/hplan/obstacles/sphere ball"]["materials"]
    assert surface["color"] == OTHER.color
    assert 0.5 < surface["opacity"] < 1.0


@pytest.mark.parametrize("name", ["</script><b>", "a/b", "constructor", "__proto__", "früh & spät"])
def test_names_cannot_break_the_page(robot: Robot, name: str) -> None:
    scene = orchard(name=name, obstacles=(Sphere(name=name, center=(1.0, 0.0, 1.9), radius=0.15),))
    page = render_page(robot, scene, Playback(motion(robot)))
    assert page.count("</script>") == 5
    (path,) = [path for path in objects(commands_of(page)) if path.startswith("/hplan/obstacles/")]
    assert path.count("/") == 3
    assert "<b>" not in page.split('<script type="application/json"')[0]


def test_meshes_and_clouds_are_drawn(robot: Robot) -> None:
    points = np.random.default_rng(0).uniform(0.5, 1.5, (50_001, 3))
    crate_ = Mesh.from_arrays("crate", *crate(), position=(1.0, 0.5, 0.2), rpy_deg=(0, 0, 30))
    cloud = PointCloud.from_points("canopy", points, 0.01)
    drawn = objects(build_stage(robot, orchard(obstacles=(crate_, cloud)), Playback(motion(robot))))
    surface = drawn["/hplan/obstacles/mesh crate"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    vertices, faces = crate_.surface
    np.testing.assert_allclose(np.reshape(surface, (-1, 3, 3)), vertices[faces], atol=1e-6)
    dots = drawn["/hplan/obstacles/points canopy"]
    (mesh,) = dots["object"]["children"]
    assert mesh["type"] == "Points"
    assert dots["materials"][0]["size"] == pytest.approx(0.02 / math.tan(math.radians(16.0)), abs=1e-6)
    places = np.reshape(dots["geometries"][0]["data"]["attributes"]["position"]["array"], (-1, 3))
    assert 15_000 < len(places) <= 20_000
    np.testing.assert_allclose(places.mean(axis=0), [1, 1, 1], atol=0.01)
    assert len(dots["geometries"][0]["data"]["index"]["array"]) == len(places)


def moved(name: str, folders: pytest.TempPathFactory) -> tuple[Any, Scene, Playback]:
    """A robot that moves all its joints a little."""
    robot = loaded_arm(name, folders)
    middle = np.clip(np.zeros(robot.dof), robot.lower, robot.upper)
    start, goal = np.clip([middle - 0.1, middle + 0.1], robot.lower, robot.upper)
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, None, None)
    trajectory = time_path(
        SplinePath.from_control_points(np.linspace(start, goal, 5)), robot.dynamics, limits, rate_hz=100.0
    )
    wall = Box(name="wall", center=(1.0, 0.0, 0.5), size=(0.1, 1.0, 1.0))
    ends = Start(joints_rad=tuple(start.tolist())), Goal(joints_rad=tuple(goal.tolist()))
    return robot, Scene(name="any arm", start=ends[0], goal=ends[1], obstacles=(wall,)), Playback(trajectory)


@pytest.mark.parametrize("name", ["toy", "lift", "seven", "panda"])
def test_every_joint_moves_in_the_picture(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    robot, scene, playback = moved(name, tmp_path_factory)
    commands = scene_stage.build_stage(robot, scene, playback)
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    tracks = [clip["clip"]["tracks"][0]["name"] for clip in animation["animations"]]
    sliding = [joint.shortname().startswith("JointModelP") for joint in robot.model.joints.tolist()[1:]]
    assert tracks == [".position" if slides else ".quaternion" for slides in sliding]


def test_fine_meshes_do_not_make_the_page_large(tmp_path_factory: pytest.TempPathFactory) -> None:
    assert len(render_page(*moved("panda", tmp_path_factory))) < 5e6


def test_simplified_meshes_keep_their_extent_and_no_more_triangles_than_asked() -> None:
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=5, radius=0.2)
    vertices, faces = simplify_mesh(np.asarray(ball.vertices), np.asarray(ball.faces), 0.02)
    assert 0.5 * 0.02 * len(ball.faces) < len(faces) <= 0.02 * len(ball.faces)
    used = np.linalg.norm(vertices[np.unique(faces)], axis=1)
    assert 0.17 < used.min() <= used.max() <= 0.2 + 1e-12
    same = simplify_mesh(np.asarray(ball.vertices), np.asarray(ball.faces), 1.0)
    assert len(same[1]) == len(ball.faces)


def test_legend_names_held_objects(robot: Robot) -> None:
    box = Attached(object=Box(name="crate", center=(0.1, 0.0, 0.0), size=(0.1, 0.1, 0.1)))
    playback, scene = Playback(motion(robot)), load_scene()
    entry = f'<i style="background: #{HELD_COLOR:06x}"></i>Held</span>'
    assert entry not in render_page(robot, scene, playback)
    assert entry in render_page(robot, scene.with_attached([box]), playback)
