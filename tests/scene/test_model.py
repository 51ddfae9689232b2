from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from hplan.errors import SceneError
from hplan.scene.model import Fruit, Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere


def a_scene(**changes) -> Scene:
    content = {"name": "a", "start": Start(joints_deg=(0.0,)), "goal": Goal(joints_deg=(1.0,))}
    return Scene(**{**content, **changes})


BALL = Sphere(name="ball", center=(1.0, 2.0, 3.0), radius=0.5)
APPLE = Fruit(name="apple", center=(1.0, 0.0, 1.0), radius=0.04)
PEAR = Fruit(name="pear", center=(1.2, 0.0, 1.0), radius=0.05)


def test_reference_scene(scene):
    assert scene.name == "table-1"
    assert scene.start.joints().tolist() == [0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(np.degrees(scene.goal.joints()), [0.0, 45.0, 60.0, 70.0])
    assert scene.locked_joints == ("base_yaw",)
    assert scene.clearance == 0.0
    assert scene.solids == (Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15),)


def test_cores():
    assert BALL.core.tolist() == [[1.0, 2.0, 3.0]]
    assert BALL.rounding == 0.5
    branch = Capsule(name="branch", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=0.02)
    assert branch.core.tolist() == [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert branch.rounding == 0.02
    post = Box(name="post", center=(1.0, 2.0, 3.0), size=(2.0, 4.0, 6.0))
    assert sorted(map(tuple, post.core.tolist())) == [(x, y, z) for x in (0, 2) for y in (0, 4) for z in (0, 6)]
    assert post.rounding == 0.0


def test_box_turns_as_urdf_does():
    rng = np.random.default_rng(0)
    for rpy in np.vstack([np.eye(3) * 90.0, rng.uniform(-180, 180, (20, 3))]):
        box = Box(name="box", center=(0.1, 0.2, 0.3), size=(1.0, 2.0, 3.0), rpy_deg=tuple(rpy))
        rotation = pin.rpy.rpyToMatrix(*np.radians(rpy))
        np.testing.assert_allclose(box.rotation, rotation, atol=1e-14)
        corners = (box.core - box.center) @ rotation
        np.testing.assert_allclose(np.abs(corners), np.tile([0.5, 1.0, 1.5], (8, 1)), atol=1e-14)


def test_solids_with_and_without_the_goal():
    """The fruit that is the goal is no obstacle, the others are; sigma goes with them."""
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
    with pytest.raises(SceneError, match="exactly one of joints_deg, joints_rad"):
        Start(**given)
    with pytest.raises(SceneError, match="exactly one of joints_deg, joints_rad, position, fruit"):
        Goal(**given)
