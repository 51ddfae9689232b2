"""Configurations among obstacles: `hplan.check` against coal, pair by pair."""

from __future__ import annotations

import numpy as np
import pytest
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

import hplan
from hplan.collision.coal_scene import CoalScene, Contact, OwnContact
from hplan.errors import ConfigurationInCollisionError, MovingObstacleError
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Track


def scene_with(obstacles, dof, **more):
    return Scene(
        name="s", start=Start(joints_rad=[0.0] * dof), goal=Goal(joints_rad=[0.0] * dof), obstacles=obstacles, **more
    )


@pytest.fixture(scope="module")
def robot():
    return hplan.load_robot()


@pytest.fixture(scope="module")
def six_axes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    (folder / "six.urdf").write_text(six_axis_arm())
    (folder / "six.limits.yaml").write_text(SIX_AXIS_LIMITS)
    return folder / "six.urdf"


@pytest.mark.parametrize("clearance", [0.0, 0.03])
def test_single_and_batch_check_agree_with_coal(robot, six_axes, clearance):
    box = Box(name="box", center=[0.9, 0.2, 0.9], size=np.array([0.3, 0.2, 0.9]), rpy_deg=[10, 20, 30])
    ball = Sphere(name="ball", center=np.array([0.3, 0.5, 0.6]), radius=np.float64(0.2), sigma=0.01)
    fruit = Fruit(name="apple", center=[0.2, -0.6, 0.5], radius=0.1)
    for arm in (robot, hplan.load_robot(six_axes)):
        scene = scene_with([box, ball], arm.dof, fruits=[fruit], clearance=clearance)
        solids = scene.solids_with_goal
        growth = [3.0 * solid.sigma for solid in solids]
        plain = CoalScene(arm, solids, growth=growth, clearance=clearance)
        q = np.random.default_rng(1).uniform(arm.lower, arm.upper, (60, arm.dof))
        found = hplan.check(arm, scene, q)
        apart = np.array([plain.pair_distances(row) for row in q])
        kept, touched = (np.broadcast_to(plain.required_distance(keep), apart.shape) for keep in (clearance, 0.0))
        assert (found.valid == (apart > kept).all(axis=1)).all()
        assert (found.in_contact == (apart <= touched).any(axis=1)).all()
        least = np.argmin(apart - kept, axis=1)
        np.testing.assert_allclose(found.distance_m, apart[np.arange(60), least], atol=2e-6)
        assert 0 < found.in_contact.sum() < 60
        assert {type(contact) for contact in found.contacts} <= {Contact, OwnContact}
        assert found.nearest_contact.distance_m == found.distance_m.min()
        one = hplan.check(arm, scene, q[7].tolist())
        assert (one.valid.shape, bool(one.valid), one.nearest_contact.link) == (
            (),
            found.valid[7],
            found.contacts[7].link,
        )
        assert one.nearest_contact.distance_m == one.distance_m == pytest.approx(found.distance_m[7], abs=2e-6)


def test_nothing_to_meet(robot):
    found = hplan.check(robot, scene_with([], 4), np.zeros((0, 4)))
    assert (found.valid.shape, found.contacts, found.nearest_contact) == ((0,), (), None)


def test_check_among_moving_obstacles_requires_time(robot):
    track = Track(times_s=np.array([0.0, 1.0]), shifts_m=np.array([[0, 0, 0], [0, 0, 5.0]]))
    scene = scene_with([Sphere(name="ball", center=(2.0, 0.0, 0.6), radius=0.3, track=track)], 4)
    with pytest.raises(MovingObstacleError):
        hplan.check(robot, scene, [0, 0, 0, 0])
    assert [bool(hplan.check(robot, scene, [0, 0, 0, 0], time_s=t).in_contact) for t in (0.0, 1.0)] == [True, False]


def test_neighbours_that_touch_are_named_and_can_be_allowed(six_axes):
    """A wide forearm touches the upper arm if the elbow is bent.

    The error says how to allow it.
    """
    wide = six_axes.with_name("wide.urdf")
    wide.write_text(six_axis_arm().replace('size="0.07 0.07 0.38"', 'size="0.07 0.3 0.3"'))
    wide.with_name("wide.limits.yaml").write_text(SIX_AXIS_LIMITS)
    bent = hplan.load_robot(wide)
    scene = scene_with([], 6)
    q = np.random.default_rng(0).uniform(bent.lower, bent.upper, (300, 6))
    own = hplan.check(bent, scene, q)
    lenient = hplan.load_robot(wide, allow_neighbours=True)
    freed = ~own.valid & hplan.check(lenient, scene, q).valid
    assert freed.any()
    start = q[np.flatnonzero(freed)[0]]
    task = scene.model_copy(update={"start": Start(joints_rad=start), "goal": Goal(joints_rad=start + 0.01)})
    with pytest.raises(
        ConfigurationInCollisionError, match=r"Neighbours that touch here: .*--allow-neighbours"
    ) as caught:
        hplan.plan(bent, task)
    joints = [
        (bent.model.frames[bent.model.getFrameId(link)].parentJoint) for link in caught.value.data["neighbours"][0]
    ]
    assert abs(joints[0] - joints[1]) == 1
    assert hplan.plan(lenient, task).certificate.verified
