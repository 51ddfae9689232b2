"""Compiled distances of bodies, pairs and convex shapes, and their bounds, against coal."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import random_obstacles
from hypothesis import example, given, settings
from hypothesis import strategies as st
from segments import segment_to_box, vector

import hplan.collision.coal_pairs as module
from hplan.collision import coal_arm, coal_boxes
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import capsule_shapes, solid_shape
from hplan.collision.compiled_bodies import joint_table
from hplan.collision.compiled_clearance import is_box_beyond, off_body, off_row
from hplan.collision.compiled_obstacles import BOX, HULL, OBSTACLE
from hplan.collision.compiled_placements import PLACED, place_joints
from hplan.errors import RobotFileError
from hplan.geometry.cloud import Cloud
from hplan.geometry.convex_distance import WORK
from hplan.geometry.rotation import rpy_rotation
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import load_robot
from hplan.scene.obstacles import Capsule, Cylinder, Mesh, PointCloud


@settings(max_examples=300)
@given(vector, vector, vector, vector, st.sampled_from([1.0, 1e-3, 1e-6, 1e-7, 1e-9]))
@example((0, 0, 1.015625), (0, 0, 1.5), (0, 0, 0), (2, 0, 1.0096783638000488), 1.0)
def test_what_vectors_between_segments_show_is_no_more_than_their_distance(a, u, b, turn, angle):
    """For nearly parallel segments the vector may miss the nearest points."""
    a, u, b, v = (np.array(x, dtype=float) for x in (a, u, b, np.array(u) + angle * np.array(turn)))
    placed = np.zeros(2, PLACED)
    placed["start"], placed["along"] = [a, b], [u, v]
    *off, t, shown = off_body(placed, 0, 1)
    nearest = min(
        np.linalg.norm(a + s * u - b - r * v)
        for s, r in [(t, np.clip((a + t * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)), *settled(a, u, b, v)]
    )
    assert shown <= nearest + 1e-12
    assert np.linalg.norm(off) >= nearest - 1e-9
    if angle == 1.0 and nearest > 1e-6:
        assert shown == pytest.approx(nearest, abs=1e-7)


def settled(a, u, b, v):
    """Places on two segments, each nearest to the other's, from several on."""
    for s in (0.0, 0.5, 1.0):
        for _ in range(100):
            r = np.clip((a + s * u - b) @ v / max(v @ v, 1e-300), 0.0, 1.0)
            s = np.clip((b + r * v - a) @ u / max(u @ u, 1e-300), 0.0, 1.0)
        yield s, r


@settings(max_examples=300)
@given(vector, vector, st.tuples(*[st.floats(0.01, 2.0)] * 3), st.integers(0, 2**32 - 1))
def test_what_vectors_from_boxes_show_is_their_distance(a, u, half, seed):
    a, u, half = (np.array(x, dtype=float) for x in (a, u, half))
    rng = np.random.default_rng(seed)
    turn = rpy_rotation(*rng.uniform(-3.0, 3.0, 3))
    solid, placed = np.zeros(1, OBSTACLE), np.zeros(1, PLACED)
    solid["kind"], solid["half"], solid["axes"] = BOX, half, turn.ravel()
    solid["centre"] = centre = rng.uniform(-1.0, 1.0, 3)
    placed["start"], placed["along"] = centre + a @ turn, u @ turn  # rows of `turn`: axes of the box
    *off, _, shown = off_row(placed, 0, solid, 0)
    expected = segment_to_box(a, u, half)
    assert np.linalg.norm(off) == pytest.approx(expected, abs=1e-7)
    assert shown <= expected + 1e-12
    assert expected < 1e-6 or shown == pytest.approx(expected, abs=1e-7)


@settings(max_examples=300)
@given(vector, st.tuples(*[st.floats(0.01, 2.0)] * 3), st.floats(0.0, 0.5), st.floats(-1.0, 3.0), st.integers(0, 9999))
def test_boxes_beyond_the_reach_of_a_point_are_told(point, half, radius, reach, seed):
    point, half = np.array(point, dtype=float), np.array(half)
    turn, solid = rpy_rotation(*np.random.default_rng(seed).uniform(-3.0, 3.0, 3)), np.zeros(1, OBSTACLE)
    solid["kind"], solid["half"], solid["axes"], solid["radius"] = BOX, half, turn.ravel(), radius
    apart = np.linalg.norm(np.maximum(np.abs(point) - half, 0.0))
    if abs(apart - reach - radius) > 1e-9:
        expected = apart > max(0.0, reach + radius)
        assert (
            is_box_beyond(solid, 0, tuple((point @ turn).tolist()), reach) == expected
        )  # rows of `turn`: axes of the box
    solid["kind"] = HULL
    assert not is_box_beyond(solid, 0, tuple((point @ turn).tolist()), reach)


def many(rng, copies=40):
    """Obstacles of most kinds, a cloud among them."""
    found = [o.model_copy(update={"name": f"{k}{o.name}"}) for k in range(copies) for o in random_obstacles(rng)]
    return [*found, PointCloud.from_points("leaves", rng.uniform(-2.0, 2.0, (50, 3)), 0.02).solids[0]]


def others(rng, copies=40):
    """Cylinders and a hull.

    The depth that coal finds in a cylinder depends on its previous queries.
    """
    found = []
    for number in range(copies):
        center, rpy = rng.uniform(-1.8, 1.8, 3), rng.uniform(-180.0, 180.0, 3)
        length, radius = rng.uniform(0.02, 0.6, 2)
        placed = {"name": f"can {number}", "center": tuple(center), "rpy_deg": tuple(rpy)}
        found.append(Cylinder(**placed, length=length, radius=radius))
    corners = [(0.5, 0.5, 0.5), (1.0, 0.5, 0.6), (0.6, 1.0, 0.5), (0.5, 0.6, 1.0)]
    return [*found, *Mesh.from_arrays("wedge", corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).solids]


@pytest.mark.parametrize("kind", ["capsules", "bodies"])
def test_no_bound_is_above_the_distance_and_most_are_near_it(robot, kind, tmp_path_factory):
    arm = loaded_arm("lift", tmp_path_factory) if kind == "bodies" else robot
    rng = np.random.default_rng(2)
    solids = [*many(rng), *others(rng)]
    checker = CoalScene(arm, solids, growth=0.01, clearance=0.02)
    pairs = np.arange(len(checker.pairs))
    errors, close = checker.distance_errors, 0
    for q in rng.uniform(arm.lower, arm.upper, (20, arm.dof)):
        distances = checker.pair_distances(q)
        bounds = checker.lower_bounds(q, pairs)
        assert (bounds <= distances + errors + 1e-6 * np.abs(distances)).all()
        close += int((bounds > 0.5 * distances).sum())
    assert close > 0.8 * 20 * len(pairs)


def test_bounds_of_clouds_are_those_of_their_points(robot):
    rng = np.random.default_rng(4)
    floor = rng.uniform((-3.0, -3.0, -1.6), (3.0, 3.0, -1.5), (4000, 3))
    overhead = rng.normal((0.5, 0.3, 3.2), 0.05, (300, 3))
    few = rng.uniform(1.0, 2.5, (5, 3))
    clouds = [Cloud.from_points("all", np.vstack([floor, overhead]), 0.02), Cloud.from_points("few", few, 0.1)]
    solids = [*others(rng), *clouds]
    checker = CoalScene(robot, solids, growth=0.01, clearance=0.02)
    pairs = np.arange(len(checker.pairs))
    of_clouds = np.array([len(solids) - 2 <= second < len(solids) for _, second in checker.pairs])
    errors, close = checker.distance_errors, 0
    for q in rng.uniform(robot.lower, robot.upper, (20, robot.dof)):
        distances = checker.pair_distances(q)
        bounds = checker.lower_bounds(q, pairs)
        assert (bounds <= distances + errors + 1e-6 * np.abs(distances)).all()
        close += int((bounds > 0.7 * distances)[of_clouds].sum())
    assert of_clouds.sum() >= 2
    assert close > 0.8 * 20 * of_clouds.sum()


def test_bounds_of_hulls_among_clouds_are_close_to_the_distances():
    arm, rng, close = load_robot("panda"), np.random.default_rng(5), 0
    sheet = rng.uniform((0.3, -0.6, 0.2), (0.35, 0.6, 0.9), (3000, 3))
    clouds = [Cloud.from_points("sheet", sheet, 0.004), Cloud.from_points("few", rng.uniform(-0.6, 0.6, (7, 3)), 0.05)]
    checker = CoalScene(arm, [*clouds, *others(rng)])
    boxes, joints = checker.boxes, coal_boxes.joints_as_pinocchio(arm)
    names = np.array([checker.contact(*pair, 0.0).obstacle for pair in checker.pairs])
    # Others have boxes that say as much.
    is_hull = np.diff(boxes.spans[boxes.sides[:, 0], :2], axis=1)[:, 0] > 0
    asked, work = is_hull & np.isin(names, ["sheet", "few"]), np.empty((2, WORK))
    frames = np.empty((arm.dof + 1, 12))
    for q in rng.uniform(arm.lower, arm.upper, (20, arm.dof)):
        distances = checker.pair_distances(q) + checker.taken_off
        place_joints(q, joints, frames)
        for enough in (0.05, 3.0):
            bounds = np.array([coal_boxes.hull_separation(frames, boxes, k, enough, work) for k in range(len(names))])
            assert (bounds <= np.minimum(distances, enough) + checker.distance_errors + 1e-6 * np.abs(distances)).all()
            assert (bounds[~asked] < 0.0).all()
            apart = asked & (distances > 1e-3)
            assert (bounds[apart] > 0.98 * np.minimum(distances, enough)[apart]).all()
            close += int((distances[apart] < enough).sum())
    assert close > 100


@pytest.mark.parametrize("name", ["toy", "lift"])
def test_robot_with_displaced_joints_gets_no_bounds(name, tmp_path_factory, monkeypatch):
    arm = loaded_arm(name, tmp_path_factory)
    assert (coal_boxes.joints_as_pinocchio(arm) == joint_table(arm)).all()
    for column, at in (("cosine", 1), ("position", 0)):
        wrong = joint_table(arm).copy()
        wrong[column][0, at] += 1e-6
        monkeypatch.setattr(coal_boxes, "joint_table", lambda _, wrong=wrong: wrong)
        with pytest.raises(RobotFileError, match=arm.joint_names[0]):
            coal_boxes.joints_as_pinocchio.__wrapped__(arm)


def test_nearest_pair_is_that_of_all_distances(robot):
    rng = np.random.default_rng(3)
    checker = CoalScene(robot, many(rng))
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.dof)):
        kept = rng.uniform(0.0, 0.05, len(checker.pairs))
        pair, distance = checker.nearest_pair(q, kept)
        beyond = checker.pair_distances(q) - kept
        assert distance - kept[pair] == pytest.approx(beyond.min(), abs=1e-9)
        assert beyond[pair] == pytest.approx(beyond.min(), abs=1e-9)


def test_nearest_pair_among_clouds_is_that_of_all_distances(robot):
    """Coal measures to tiny triangles in place of points, which are nearer than these."""
    rng = np.random.default_rng(8)
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.dof)):
        places = rng.normal(0.0, 0.3, (40, 30, 3)) + rng.uniform(-2.0, 2.0, (40, 1, 3))
        solids = [Cloud.from_points(f"cloud {k}", points, 0.01) for k, points in enumerate(places)]
        checker = CoalScene(robot, solids)
        pair, distance = checker.nearest_pair(q, np.zeros(len(checker.pairs)))
        every = checker.pair_distances(q)
        assert distance == pytest.approx(every.min(), abs=1e-6)
        assert every[pair] == pytest.approx(distance, abs=1e-9)


def test_capsules_placed_together_are_those_placed_alone():
    rng = np.random.default_rng(5)
    ends = rng.normal(size=(60, 2, 3))
    ends[:6, 1] = ends[:6, 0] + [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 0, 0), (1e-9, 0, -1), (0, -1e-200, 0)]
    capsules = [
        Capsule(name=f"c{k}", start=tuple(a), end=tuple(b), radius=0.1 + 0.01 * k)
        for k, (a, b) in enumerate(ends.tolist())
    ]
    for found, capsule in zip(capsule_shapes(capsules), capsules, strict=True):
        alone = solid_shape(capsule)
        assert found.name == alone.name
        assert found.placement.isApprox(alone.placement, 1e-12)
        assert found.geometry.radius == alone.geometry.radius
        assert found.geometry.halfLength == pytest.approx(alone.geometry.halfLength, rel=1e-15, abs=0.0)
    assert capsule_shapes([]) == []


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """An arm that can touch itself and its base."""
    spec = ArmSpec(
        name="wide",
        has_yaw=True,
        link_lengths=(1.0, 0.8, 0.4),
        link_half_widths=(0.05, 0.04, 0.03),
        link_masses=(4.0, 3.0, 1.0),
        lower=(-3.0, -2.6, -2.6, -2.6),
        upper=(3.0, 2.6, 2.6, 2.6),
        velocity=(1.5,) * 4,
        effort=(300.0,) * 4,
        acceleration=(3.0,) * 4,
        jerk=(150.0,) * 4,
        shoulder_height=0.6,
    )
    return load_robot(write_robot(spec, tmp_path_factory.mktemp("arm") / "wide.urdf")[0])


@pytest.mark.parametrize("count", [0, 7, 13])
def test_models_of_few_obstacles_answer_as_one_of_all(wide, count, monkeypatch):
    rng = np.random.default_rng(count)
    obstacles = random_obstacles(rng, count)
    if count > 6:
        obstacles[4] = Cloud.from_points("cloud", rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (30, 3)), 0.02)
    growth = rng.uniform(0.0, 0.05, count)
    whole = CoalScene(wide, obstacles, growth=growth)
    monkeypatch.setattr(module, "_CHUNK", 3)
    parts = CoalScene(wide, obstacles, growth=growth)
    assert parts.pairs == whole.pairs
    assert len(parts.parts.own) > 0
    configurations = rng.uniform(wide.lower, wide.upper, (80, wide.dof))
    if count:
        name = obstacles[-1].name
        whole, parts = whole.allow_touch(name), parts.allow_touch(name)
    for q in configurations[:20]:
        np.testing.assert_array_equal(parts.pair_distances(q), whole.pair_distances(q))
        asked = rng.permutation(len(whole.pairs))[:11]
        for checker in (whole, parts):
            checker.place(q[::-1].clip(wide.lower, wide.upper))
        np.testing.assert_array_equal(parts.distances_of(asked), whole.distances_of(asked))
        np.testing.assert_array_equal(parts.distances(q), whole.distances(q))
    for margin in (-0.01, 0.0, 0.1):
        np.testing.assert_array_equal(
            parts.in_collision(configurations, margin=margin), whole.in_collision(configurations, margin=margin)
        )


def test_scenes_that_share_a_model_of_the_arms_own_pairs_answer_each_for_itself(wide, monkeypatch):
    rng = np.random.default_rng(9)
    obstacles = random_obstacles(rng, 4)
    alone = CoalScene(wide, obstacles)
    monkeypatch.setattr(coal_arm, "_MANY", 1)
    monkeypatch.delitem(vars(alone.parts), "shape_pairs")
    first, second = CoalScene(wide, obstacles), CoalScene(wide, [])
    assert isinstance(first.parts.shape_pairs, module.ArmPairs)
    monkeypatch.delitem(vars(alone.parts), "shape_pairs")
    pairs = np.arange(len(alone.pairs))
    of_arm = pairs[-len(alone.parts.own) :]
    for q, other in rng.uniform(wide.lower, wide.upper, (20, 2, wide.dof)):
        for checker, at in ((alone, q), (first, q), (second, other)):
            checker.place(at)
        distances = alone.distances_of(pairs)
        np.testing.assert_allclose(first.distances_of(pairs), distances, rtol=1e-12, atol=1e-12)
        bounds = first.lower_bounds(q, pairs)
        assert (bounds <= distances + alone.distance_errors).all()
        np.testing.assert_array_equal(alone.lower_bounds(q, pairs), bounds)
        elsewhere = alone.pair_distances(other)[of_arm]
        np.testing.assert_allclose(second.distances_of(of_arm - of_arm[0]), elsewhere, rtol=1e-12, atol=1e-12)
    assert (bounds[of_arm] > 0.0).any()
