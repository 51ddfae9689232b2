"""A planner that receives frames of a depth camera."""

from __future__ import annotations

import gc
from collections import Counter

import numpy as np
import pytest

from hplan import Planner, PlanOptions
from hplan.collision.coal_cloud import PointBlocks
from hplan.collision.motion_coefficients import tight_reach_ball
from hplan.errors import InputError, NoPathError
from hplan.geometry.cloud import Cloud
from hplan.online.frame import CloudOptions
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import PointCloud, Sphere

#: Options that accept frames without any return.
MAY_BE_EMPTY = CloudOptions(allow_empty=True, max_lost=1.0)

START, GOAL = (-40.0, 60.0, 60.0, 60.0), (40.0, 60.0, 60.0, 60.0)


def a_scene(**values) -> Scene:
    fields = {"goal": Goal(joints_deg=GOAL), "obstacles": (Sphere(name="post", center=(0.0, 1.9, 1.0), radius=0.1),)}
    return Scene(name="s", start=Start(joints_deg=START), **{**fields, **values})


def canopy(seed: int, count: int = 3000) -> np.ndarray:
    return np.random.default_rng(seed).uniform([1.0, -0.4, 0.7], [1.3, 0.4, 1.5], (count, 3)).astype(np.float32)


def clouds(planner: Planner) -> list[str]:
    return [obstacle.name for obstacle in planner.scene.obstacles if isinstance(obstacle, PointCloud)]


def test_frame_replaces_the_last_one_of_its_name(robot):
    planner = Planner(robot, a_scene())
    report = planner.set_cloud("canopy", canopy(0), radius=0.005)
    assert report.given == 3000
    assert report.out_of_reach == report.not_finite == report.of_arm == 0
    (cloud,) = planner.scene.obstacles[1].solids
    assert len(cloud.core) == report.kept
    assert cloud.rounding == report.radius_m
    planner.set_cloud("other", canopy(1), radius=0.005)
    again = planner.set_cloud("canopy", canopy(2, 50), radius=0.004)
    assert [obstacle.name for obstacle in planner.scene.obstacles] == ["post", "canopy", "other"]
    assert planner.scene.obstacles[1].radius == again.radius_m
    planner.set_cloud("canopy", canopy(0), radius=0.005, yields=0.003)
    assert [solid.yields for obstacle in planner.scene.obstacles for solid in obstacle.solids] == [0.0, 0.003, 0.0]
    assert planner.set_cloud("canopy", [], radius=0.005, options=MAY_BE_EMPTY).kept == 0
    assert clouds(planner) == ["other"]
    planner.remove("canopy")  # there is no obstacle of the name, and its frames are forgotten
    planner.remove("other")
    assert clouds(planner) == []


def test_motions_keep_clear_of_every_point(robot):
    planner = Planner(robot, a_scene())
    straight = planner.plan()
    points = robot.tool_positions(straight.trajectory.position[len(straight.trajectory.position) // 2])
    frame = points + np.random.default_rng(0).normal(size=(400, 3)) * 0.03
    planner.set_cloud("leaf", frame, radius=0.005)
    around = planner.replan()
    assert around.certificate.verified
    assert around.motion.origin != "kept"
    balls = Scene(
        name="balls", start=a_scene().start, goal=a_scene().goal,
        obstacles=tuple(Sphere(name=f"b{i}", center=tuple(p), radius=0.005) for i, p in enumerate(frame.tolist())),
    )  # fmt: skip
    from hplan import certify

    assert certify(robot, balls, around.trajectory).verified


def test_arm_and_the_fruit_to_pick_are_left_out(robot):
    reached = tuple(robot.tool_positions(np.radians([5.0, 30.0, 50.0, 20.0])).tolist())
    fruit = Fruit(name="apple", center=reached, radius=0.04)
    planner = Planner(robot, a_scene(fruits=(fruit,), goal=Goal(fruit="apple")))
    rng = np.random.default_rng(0)
    on_fruit = np.array(fruit.center) + 0.04 * (v := rng.normal(size=(200, 3))) / np.linalg.norm(v, axis=1)[:, None]
    q = np.radians(START)
    on_arm = robot.tool_positions(q) + rng.normal(size=(100, 3)) * 2e-3
    report = planner.set_cloud("seen", np.concatenate([on_fruit, on_arm]), radius=0.01, joints=q, ignore=["apple"])
    assert (report.ignored, report.of_arm, report.kept) == (200, 100, 0)
    assert planner.plan().certificate.verified


def test_names(robot):
    planner = Planner(robot, a_scene(fruits=(Fruit(name="apple", center=(1.3, 0.0, 1.2), radius=0.04),)))
    for name, words in (("post", "sphere"), ("apple", "fruit")):
        with pytest.raises(InputError, match=words):
            planner.set_cloud(name, canopy(0), radius=0.005)
    with pytest.raises(InputError, match="no fruit or obstacle 'pear'"):
        planner.set_cloud("c", canopy(0), radius=0.005, ignore=["apple", "pear"])
    with pytest.raises(InputError, match="the cloud itself"):
        planner.set_cloud("c", canopy(0), radius=0.005, ignore=["c"])
    assert clouds(planner) == []


def test_hidden_points_are_kept_between_frames(robot):
    planner = Planner(robot, a_scene())
    near, far = (
        np.stack(np.broadcast_arrays(x, *np.meshgrid(*2 * [np.linspace(-0.2, 0.2, 80)])), axis=-1) for x in (0.8, 1.4)
    )
    pose = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    planner.set_cloud("seen", 0.5 * far, radius=0.01, pose=pose, keep_s=1.0, time_s=0.0)
    first = planner.set_cloud("seen", far * [1.0, 0.5, 0.5], radius=0.01, pose=pose, keep_s=1.0, time_s=0.0)
    second = planner.set_cloud("seen", near, radius=0.01, pose=pose, keep_s=1.0, time_s=0.5)
    assert second.remembered == first.kept
    assert planner.set_cloud("seen", near, radius=0.01, pose=pose, time_s=0.6).remembered == 0  # not requested


def test_obstacles_within_tracking_displacement_are_kept(robot):
    x, y, z, reach_m = tight_reach_ball(robot)
    beyond = [[x + reach_m + 0.005 + CloudOptions().growth_m + CloudOptions().reach_margin_m + 0.02, y, z]]
    for error_rad, kept in ((0.0, 0), (0.05, 1)):
        planner = Planner(robot, a_scene(), PlanOptions(tracking_error=error_rad))
        assert planner.set_cloud("far", beyond, radius=0.005, options=MAY_BE_EMPTY).kept == kept


def test_cloud_that_is_removed_has_seen_nothing(robot):
    planner = Planner(robot, a_scene())
    planner.set_cloud("seen", canopy(0), radius=0.005, keep_s=9.0, time_s=0.0)
    planner.remove("seen")
    report = planner.set_cloud("seen", [], radius=0.005, keep_s=9.0, time_s=0.1, options=MAY_BE_EMPTY)
    assert report.remembered == 0


@pytest.fixture
def new_clouds():
    """Counts live clouds and their blocks, except clouds of earlier tests."""
    gc.collect()
    gc.freeze()
    yield lambda: Counter(type(o) for o in gc.get_objects() if isinstance(o, (PointCloud, Cloud, PointBlocks)))
    gc.unfreeze()


def test_frames_leave_nothing_behind(robot, new_clouds):
    planner = Planner(robot, a_scene())
    held = []
    for seed in range(12):
        planner.set_cloud("canopy", canopy(seed), radius=0.005, keep_s=0.5, time_s=0.1 * seed)
        try:
            planner.replan()
        except NoPathError:  # some canopies close every path
            planner.last = None
        if seed >= 6:
            gc.collect()
            held.append(new_clouds())
    assert all(now == held[0] for now in held)
    assert 1 <= held[0][Cloud] <= 3
    assert held[0][PointBlocks] <= 3
