from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from hplan.certificate.digests import scene_digest
from hplan.errors import InputError, MovingObstacleError, OptionError, SceneError
from hplan.geometry.rotation import rpy_rotation
from hplan.scene.file import dump_scene, parse_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.scene.tracks import Track


def a_scene(**changes) -> Scene:
    content = {"name": "a", "start": Start(joints_deg=(0.0,)), "goal": Goal(joints_deg=(1.0,))}
    return Scene(**{**content, **changes})


BALL = Sphere(name="ball", center=(1.0, 2.0, 3.0), radius=0.5)
APPLE = Fruit(name="apple", center=(1.0, 0.0, 1.0), radius=0.04)
PEAR = Fruit(name="pear", center=(1.2, 0.0, 1.0), radius=0.05)


def test_box_turns_as_urdf_does():
    rng = np.random.default_rng(0)
    for rpy in np.vstack([np.eye(3) * 90.0, rng.uniform(-180, 180, (20, 3))]):
        box = Box(name="box", center=(0.1, 0.2, 0.3), size=(1.0, 2.0, 3.0), rpy_deg=tuple(rpy))
        rotation = pin.rpy.rpyToMatrix(*np.radians(rpy))
        np.testing.assert_allclose(box.rotation, rotation, atol=1e-14)
        corners = (box.core - box.center) @ rotation
        np.testing.assert_allclose(np.abs(corners), np.tile([0.5, 1.0, 1.5], (8, 1)), atol=1e-14)


def test_solids_with_and_without_the_goal():
    """The goal's fruit is not an obstacle, the others are; sigma is kept."""
    blurred = PEAR.model_copy(update={"sigma": 0.01})
    scene = a_scene(goal=Goal(fruit="apple"), fruits=(APPLE, blurred), obstacles=(BALL,))
    assert [solid.name for solid in scene.solids] == ["ball", "pear"]
    assert [solid.name for solid in scene.solids_with_goal] == ["ball", "apple", "pear"]
    assert scene.solids_with_goal[2] == Sphere(name="pear", center=(1.2, 0.0, 1.0), radius=0.05, sigma=0.01)
    for goal in (Goal(joints_deg=(1.0,)), Goal(position=(1.0, 0.0, 1.0))):
        other = a_scene(goal=goal, fruits=(APPLE, PEAR), obstacles=(BALL,))
        assert other.solids == other.solids_with_goal
        assert len(other.solids) == 3


@pytest.mark.parametrize("joints", [{"joints_deg": (1.0,)}, {"joints_rad": (1.0,)}])
def test_joints_leave_no_approach(joints):
    with pytest.raises(SceneError, match="approach_deg belongs to a position or a fruit"):
        Goal(**joints, approach_deg=90.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"obstacles": (BALL, BALL)}, "two obstacles are called 'ball'"),
        ({"fruits": (APPLE, APPLE)}, "two obstacles are called 'apple'"),
        ({"obstacles": (BALL,), "fruits": (Fruit(name="ball", center=(0, 0, 0), radius=1.0),)}, "called 'ball'"),
        ({"goal": Goal(fruit="plum"), "fruits": (APPLE,)}, "'plum' is not among the fruits"),
    ],
)
def test_scenes_that_contradict_themselves(changes, message):
    with pytest.raises(SceneError, match=message):
        a_scene(**changes)


@pytest.mark.parametrize("given", [{}, {"joints_deg": (0.0,), "joints_rad": (0.0,)}])
def test_one_way_to_give_a_configuration(given):
    with pytest.raises(SceneError, match="exactly one of joints_deg, joints_rad, joints;"):
        Start(**given)
    with pytest.raises(SceneError, match="exactly one of joints_deg, joints_rad, joints, position, fruit"):
        Goal(**given)


def test_scene_from_another_stop_has_everything_where_it_is_seen_from_there():
    box = Box(name="box", center=(1.0, 0.2, 0.5), size=(0.1, 0.2, 0.3), rpy_deg=(10.0, 20.0, 30.0))
    rod = Capsule.model_validate({"name": "rod", "from": (1, 0, 0), "to": (1, 0, 2), "radius": 0.01, "yields": 0.02})
    fruit = Fruit(name="fruit", center=(0.9, 0.1, 1.4), radius=0.04)
    goal = Goal(position=(1.1, 0.0, 1.0), quaternion_xyzw=(0.0, 0.6, 0.0, 0.8))
    scene = Scene(name="s", start=Start(joints_rad=(0.0,)), goal=goal, obstacles=(box, rod), fruits=(fruit,))
    turn, by = rpy_rotation(0.0, 0.0, np.radians(70.0)), np.array([0.3, -0.5, 0.1])
    seen = scene.shift(by, 70.0)
    for item, other in zip(scene.obstacles, seen.obstacles, strict=True):
        np.testing.assert_allclose(other.core, item.core @ turn.T + by, atol=1e-12)
        assert (other.name, other.yields) == (item.name, item.yields)
    np.testing.assert_allclose(seen.fruits[0].center, turn @ fruit.center + by, atol=1e-12)
    np.testing.assert_allclose(seen.goal.pose[:3, :3], turn @ goal.pose[:3, :3], atol=1e-12)
    np.testing.assert_allclose(seen.goal.position, turn @ goal.position + by, atol=1e-12)
    moving = scene.model_copy(update={"base_track": Track(times_s=(0.0, 1.0), shifts_m=((0, 0, 0), (1, 0, 0)))})
    with pytest.raises(MovingObstacleError):
        moving.shift(by)
    for wrong in ((1.0, 2.0), "123", None, (1.0, 2.0, np.nan)):
        with pytest.raises(InputError):
            scene.shift(wrong)


def test_unreachable_obstacles_are_left_out_except_goal_and_moving_ones():
    rods = [
        Capsule.model_validate({"name": f"rod {n}", "from": (n, 0, 0), "to": (n, 0, 1), "radius": 0.01}) for n in (1, 4)
    ]
    fruits = [Fruit(name=f"fruit {n}", center=(n, 0.0, 1.0), radius=0.04) for n in (1.0, 5.0, 6.0)]
    scene = Scene(
        name="s",
        start=Start(joints_rad=(0.0,)),
        goal=Goal(fruit="fruit 6.0"),
        obstacles=tuple(rods),
        fruits=tuple(fruits),
    )
    near = scene.crop(2.0)
    assert [item.name for item in (*near.obstacles, *near.fruits)] == ["rod 1", "fruit 1.0", "fruit 6.0"]
    assert [item.name for item in scene.crop(0.6, (4.5, 0.0, 0.5)).obstacles] == ["rod 4"]
    assert scene.crop(10.0) == scene
    with pytest.raises(OptionError):
        scene.crop(-1.0)


def test_covariances() -> None:
    """Read, written, digested, rotated with the scene; `sigma` is the maximum over directions."""
    rows = ((4e-4, 1e-4, 0.0), (1e-4, 1e-4, 0.0), (0.0, 0.0, 9e-4))
    ball = Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, covariance=rows)
    fruit = Fruit(name="apple", center=(0.0, 1.0, 1.0), radius=0.04, covariance=rows)
    scene = a_scene(obstacles=(ball,), fruits=(fruit,), covariance=rows)
    assert parse_scene(dump_scene(scene)) == scene
    assert ball.sigma == fruit.sigma == pytest.approx(0.03)
    assert [solid.sigma for solid in scene.solids] == pytest.approx([math.sqrt(18e-4)] * 2)
    plain = [
        scene.model_copy(update={"covariance": None}),
        scene.with_obstacles([ball.model_copy(update={"covariance": None})]),
        scene.model_copy(update={"fruits": (fruit.model_copy(update={"covariance": None}),)}),
    ]
    assert len({scene_digest(each) for each in (scene, *plain)}) == 4
    turned = scene.shift((0.0, 0.0, 0.0), yaw_deg=90.0)
    for covariance in (turned.errors["ball"], turned.errors["apple"], turned.shared_error):
        np.testing.assert_allclose(covariance, [[1e-4, -1e-4, 0.0], [-1e-4, 4e-4, 0.0], [0.0, 0.0, 9e-4]], atol=1e-12)
    for wrong in (np.array(rows) + np.eye(3, k=1), -np.array(rows), np.eye(2)):
        with pytest.raises(SceneError, match="covariance"):
            Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, covariance=wrong)
    with pytest.raises(SceneError, match="exclude each other"):
        Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, covariance=rows, sigma=0.01)
