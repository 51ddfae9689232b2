"""Scenes whose lengths are probably in millimetres: a warning, and the names in the report."""

from __future__ import annotations

import contextlib
import json
import warnings
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from hplan import Planner, certify, plan
from hplan.apps.cli.main import main
from hplan.collision.far_obstacles import far_obstacles
from hplan.collision.motion_coefficients import workspace_ball
from hplan.errors import FarObstacleWarning, HplanError
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.scene.file import save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import AnyObstacle, Box, Capsule, Mesh, PointCloud, Sphere
from hplan.scene.tracks import Track

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def a_scene(*obstacles: AnyObstacle, fruits: tuple[Fruit, ...] = ()) -> Scene:
    start, goal = Start(joints_deg=(0, 90, 90, 90)), Goal(joints_deg=(20, 80, 80, 80))
    return Scene(name="s", start=start, goal=goal, obstacles=obstacles, fruits=fruits)


def in_millimetres() -> list[AnyObstacle]:
    points = np.random.default_rng(0).normal((900.0, 300.0, 1400.0), 50.0, (200, 3))
    return [
        Sphere(name="ball", center=(1000.0, 0.0, 1900.0), radius=150.0),
        # The ball about the wire holds the arm, the wire does not.
        Capsule(name="wire", start=(-500.0, -2000.0, 1500.0), end=(-500.0, 2000.0, 1500.0), radius=5.0),
        Box(name="box", center=(700.0, 500.0, 300.0), size=(200.0, 100.0, 50.0), rpy_deg=(0.0, 0.0, 30.0)),
        Mesh.from_arrays("crate", 300.0 * TETRAHEDRON, FACES, position=(600.0, 0.0, 400.0)),
        PointCloud.from_points("plant", points, radius=10.0),
    ]


@pytest.mark.parametrize("item", in_millimetres(), ids=lambda item: item.name)
def test_scene_in_millimetres_warns(robot: Robot, item: AnyObstacle) -> None:
    scene = a_scene(item)
    with pytest.warns(FarObstacleWarning, match=f"obstacle '{item.name}' .* in millimetres"):
        found = plan(robot, scene)
    assert found.report["far_obstacles"] == [item.name]
    with pytest.warns(FarObstacleWarning):
        certify(robot, scene, found.trajectory)
    planner = Planner(robot, a_scene())
    with pytest.warns(FarObstacleWarning):
        planner.add(item)
    # A mesh or a cloud by itself, among obstacles that are near.
    near = Sphere(name="near", center=(0.0, 1.9, 1.0), radius=0.1)
    expected = (item.name,) if isinstance(item, Mesh | PointCloud) else ()
    assert far_obstacles(robot, a_scene(near, item)) == expected


def test_held_object_in_millimetres_warns(robot: Robot) -> None:
    points = np.random.default_rng(0).normal((0.0, 0.0, 30.0), 20.0, (50, 3))
    for item in (
        Box(name="crate", center=(60.0, 0.0, 0.0), size=(30.0, 20.0, 10.0)),
        Sphere(name="ball", center=(0.0, 0.0, 0.0), radius=4.0),
        PointCloud.from_points("plant", points, radius=1.0),
    ):
        scene = a_scene().with_attached([Attached(object=item)])
        with pytest.warns(FarObstacleWarning, match=f"held object '{item.name}' .* m large; .* millimetres"):
            or_error(robot, scene)
    small = a_scene().with_attached([Attached(object=Box(name="crate", center=(0.1, 0.0, 0.0), size=(0.1, 0.1, 3.0)))])
    with warnings.catch_warnings():
        warnings.simplefilter("error", FarObstacleWarning)
        or_error(robot, small)


def or_error(robot: Robot, scene: Scene) -> None:
    with contextlib.suppress(HplanError):
        plan(robot, scene)


def test_scene_in_metres_does_not_warn(robot: Robot) -> None:
    far = Box(name="shed", center=(0.0, 150.0, 0.0), size=(4.0, 4.0, 4.0))
    near = Sphere(name="near", center=(0.0, 1.9, 1.0), radius=0.1)
    scenes = [
        a_scene(),
        a_scene(near),
        a_scene(near, far),
        a_scene(Sphere(name="at 9 m", center=(9, 0, 1), radius=0.1)),
    ]
    scenes.append(a_scene(far, fruits=(Fruit(name="apple", center=(1.0, 0.0, 1.5), radius=0.04),)))
    track = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    scenes.append(a_scene(Box(name="lorry", center=(0.0, 150.0, 0.0), size=(4.0, 4.0, 4.0), track=track)))
    with warnings.catch_warnings(action="error", category=FarObstacleWarning):
        for scene in scenes:
            assert far_obstacles(robot, scene) == ()
        assert "far_obstacles" not in plan(robot, scenes[1]).report


def test_distances_against_coal(robot: Robot) -> None:
    """Random boxes and capsules about ten reaches away, on both sides of the limit."""
    random, flagged = np.random.default_rng(3), []
    *centre, reach = workspace_ball(robot).tolist()
    for _ in range(200):
        at = random.normal(size=3)
        at *= reach * random.uniform(8.0, 14.0) / np.linalg.norm(at)
        size, angles = random.uniform(0.1, 20.0, 3), random.uniform(-180.0, 180.0, 3)
        item = Box(name="box", center=tuple(at), size=tuple(size), rpy_deg=tuple(angles))
        shape = coal.Box(*size)
        place = pin.SE3(pin.rpy.rpyToMatrix(*np.radians(angles)), at)
        bead, here = coal.Sphere(1e-6), pin.SE3(np.eye(3), np.array(centre))
        found = coal.DistanceResult()
        coal.distance(
            shape, coal.Transform3s(place.rotation, place.translation), bead,
            coal.Transform3s(here.rotation, here.translation), coal.DistanceRequest(), found,
        )  # fmt: skip
        is_far = far_obstacles(robot, a_scene(item)) == ("box",)
        if abs(found.min_distance - 10.0 * reach) > 1e-3:
            assert is_far == (found.min_distance > 10.0 * reach)
        flagged.append(is_far)
    assert 20 < sum(flagged) < 180


def test_commands_warn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, folder = str(save_scene(a_scene(*in_millimetres()), tmp_path / "scene.yaml")), str(tmp_path / "out")
    assert main(["plan", scene, "--out", folder]) == 0
    assert "warning: scene 's': obstacle 'ball' and 4 more" in capsys.readouterr().err
    names = ["ball", "wire", "box", "crate", "plant"]
    assert json.loads((tmp_path / "out" / "report.json").read_text())["far_obstacles"] == names
    assert main(["certify", folder, scene, "--json"]) == 0
    told = capsys.readouterr()
    assert "in millimetres" in told.err
    assert json.loads(told.out)["far_obstacles"] == names
