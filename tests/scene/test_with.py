"""Modified copies are validated in every way of copying; bypassed values are refused later."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest

import hplan
from hplan.errors import InputError, OptionError, SceneError
from hplan.scene.model import Goal, Scene, Start, checked_scene
from hplan.scene.obstacles import Capsule, Mesh, PointCloud, Sphere

BALL = Sphere(name="b", center=(1.0, 0.0, 1.9), radius=0.15)
WRONG = {
    "clearance": (-0.05, "5mm", None, math.nan),
    "obstacles": (
        BALL,
        (BALL, BALL.with_values(center=(2.0, 0.0, 1.0))),
        [{"kind": "sphere", "name": "b", "centre": 1}],
        None,
    ),
    "locked_joints": ("base_yaw",),
    "start": (None, {"joints_dgs": (0, 0, 0, 0)}),
    "goal": (None, Goal.model_validate({"fruit": "aple"}), {"fruit": "aple"}),
    "clearence": (0.01,),
    "yield_links": ("hand",),
}
CASES = [(key, value) for key, values in WRONG.items() for value in values]


@pytest.fixture(scope="module")
def scene():
    return hplan.load_scene()


@pytest.mark.parametrize(("key", "value"), CASES)
def test_wrong_values_are_refused_whoever_copies(scene, key, value):
    for make in (
        lambda: scene.with_values(**{key: value}),
        lambda: scene.model_copy(update={key: value}),
        lambda: scene.copy(update={key: value}),
        lambda: scene.__replace__(**{key: value}),
        lambda: Scene.model_construct(
            **{**{name: getattr(scene, name) for name in ("name", "start", "goal")}, key: value}
        ),
        lambda: setattr(scene, key, value),
    ):
        with pytest.raises(SceneError):
            make()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radius": -0.15}, "radius: input should be greater than 0"),
        ({"centre": (0, 0, 9)}, "a Sphere has no 'centre'; did you mean 'center'?"),
        ({"center": ("1", 0, 1)}, "center[0]"),
        ({"sigma": -1.0}, "sigma"),
    ],
)
def test_obstacles_are_checked_too(changes, words):
    for make in (lambda: BALL.with_values(**changes), lambda: BALL.model_copy(update=changes)):
        with pytest.raises(SceneError) as error:
            make()
        assert words in str(error.value)


def test_copies_have_the_values(scene):
    other = scene.with_values(
        clearance=np.float64(0.01), obstacles=[{"kind": "sphere", "name": "c", "center": [0, 1, 2], "radius": 1}]
    )
    assert (other.clearance, other.obstacles[0].radius, other.goal) == (0.01, 1.0, scene.goal)
    assert scene.clearance == 0.0
    assert scene.model_copy() == scene == copy.deepcopy(scene)
    assert Capsule(name="c", start=(0, 0, 0), end=(0, 0, 1), radius=0.1).with_values(**{"from": (0, 1, 0)}).start == (
        0,
        1,
        0,
    )
    goal = Goal(position=(1, 0, 1)).with_values(approach_deg=(0, 90))
    assert goal.approach_deg == (0, 90)
    error = ((1e-4, 0, 0), (0, 1e-6, 0), (0, 0, 1e-6))
    placed = BALL.with_values(covariance=error)
    assert placed.sigma == pytest.approx(1e-2)
    assert placed.with_values(covariance=((4e-4, 0, 0), (0, 1e-6, 0), (0, 0, 1e-6))).sigma == pytest.approx(2e-2)


def test_meshes_and_clouds_keep_their_data(tmp_path, monkeypatch):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    made = Mesh.from_arrays("m", corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    made.write(tmp_path / "m.ply")
    monkeypatch.chdir(tmp_path)
    read = Mesh(name="m", file="m.ply")
    monkeypatch.chdir("/")  # its file is no longer found by its name
    for mesh in (made, read):
        moved = mesh.with_values(position=(0, 0, 1), scale=2.0)
        assert (moved.data_digest, moved.path) == (mesh.data_digest, mesh.path)
        np.testing.assert_allclose(moved.surface[0], 2.0 * mesh.surface[0] + [0, 0, 1])
        with pytest.raises(SceneError):
            mesh.with_values(scale=1e9)
    with pytest.raises(SceneError, match=r"gone\.ply"):
        made.with_values(file="gone.ply")
    cloud = PointCloud.from_points("c", corners, 0.01).with_values(radius=0.02)
    assert len(cloud.points) == 4
    assert cloud.radius == 0.02


def test_options_are_checked():
    assert hplan.PlanOptions().with_values(speed=0.5).speed == 0.5
    for changes, words in (({"spede": 1.0}, "did you mean 'speed'"), ({"speed": 3.0}, "less than or equal to 1")):
        with pytest.raises(OptionError, match=words):
            hplan.PlanOptions().with_values(**changes)


def spoilt(scene):
    """Scenes whose values were changed past all checks."""
    bad = copy.deepcopy(scene.with_values(obstacles=(BALL,)))
    object.__setattr__(bad.obstacles[0], "radius", -0.15)
    yield bad, "obstacles[0].radius"
    yield scene.copy_unchecked({"clearence": 1.0}), "clearence"
    yield scene.copy_unchecked({"obstacles": [{"radius": 1}]}), "obstacles"
    yield scene.copy_unchecked({"goal": Goal(fruit="aple")}), "goal.fruit"
    track = scene.copy_unchecked({"start": Start(joints_rad=(0.0,) * 4).copy_unchecked({"joints_rad": "abcd"})})
    yield track, "start.joints_rad"


def test_public_functions_refuse_unvalidated_changes(scene):
    robot = hplan.load_robot()
    trajectory = hplan.plan(robot, scene).trajectory
    for bad, where in spoilt(scene):
        for call in (
            lambda bad=bad: hplan.plan(robot, bad),
            lambda bad=bad: hplan.certify(robot, bad, trajectory),
            lambda bad=bad: hplan.check(robot, bad, [0.0] * 4),
            lambda bad=bad: hplan.reachable(robot, bad),
            lambda bad=bad: hplan.Planner(robot, bad),
        ):
            with pytest.raises(SceneError) as error:
                call()
            assert error.value.where.startswith(where)
            assert "with_values(...) returns a checked copy" in str(error.value)


@pytest.mark.parametrize("name", ["table-1", "orchard-row", "dense-canopy", "trellis"])
def test_scenes_that_hplan_makes_pass(name):
    scene = hplan.load_scene(name)
    for other in (scene, scene.snapshot(0.0), scene.starting_at(1.0), scene.shift((0.1, 0, 0), 30.0), scene.crop(2.0)):
        assert checked_scene(other) is other


def test_misspelt_yield_link_is_refused_at_each_entrance():
    robot, scene = (
        hplan.load_robot("orchard_harvester"),
        hplan.load_scene("orchard-arm-row").with_values(yield_links=("hnad",)),
    )
    trajectory = hplan.plan(robot, scene.with_values(yield_links=None), hplan.PlanOptions(effort="quick")).trajectory
    for call in (
        lambda: hplan.plan(robot, scene),
        lambda: hplan.certify(robot, scene, trajectory),
        lambda: hplan.check(robot, scene, robot.lower),
        lambda: hplan.Planner(robot, scene),
    ):
        with pytest.raises(OptionError, match=r"moving links: .*hand.*; did you mean 'hand'"):
            call()


def test_check_covers_joint_limits(scene):
    robot = hplan.load_robot()
    degrees = np.array([0.0, 45.0, 60.0, 70.0])
    found = hplan.check(robot, scene.with_obstacles(()), degrees)
    assert not found.valid
    assert "joint 'shoulder' is at 45 rad, outside its limits" in found.limit_faults[0]
    assert "are these degrees?" in found.limit_faults[0]
    within = hplan.check(robot, scene.with_obstacles(()), np.radians(degrees))
    assert (bool(within.valid), within.limit_faults) == (True, (None,))
    q = np.array([robot.lower, robot.upper, robot.upper + np.array([0, 0, 1e-3, 0])])
    many = hplan.check(robot, scene.with_obstacles(()), q)
    assert many.limit_faults[:2] == (None, None)
    assert many.limit_faults[2].startswith("q[2]: joint 'elbow'")
    assert "degrees" not in many.limit_faults[2]
    with pytest.raises(InputError, match="are these degrees"):
        robot.check_configuration(degrees, "goal")
