"""Blocks of a cloud in coal against its points one by one."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.collision.coal_cloud import BareShape, PointBlocks, _lower_bounds, distance_from, local_box
from hplan.robot.base_shapes import coal_distance
from hplan.scene.convex_shape import convex_hull_shape
from hplan.scene.solids import CUBE_CORNERS, Cloud


def swept_block() -> coal.Convex:
    """A block with a radius about it, as bodies of meshes have."""
    points = CUBE_CORNERS * np.array([0.15, 0.05, 0.25])
    shape = convex_hull_shape(points)
    shape.setSweptSphereRadius(0.03)
    return shape


SHAPES = {
    "capsule": coal.Capsule(0.04, 0.7),
    "box": coal.Box(0.3, 0.1, 0.5),
    "cylinder": coal.Cylinder(0.1, 0.4),
    "sphere": coal.Sphere(0.2),
    "swept": swept_block(),
}


def placed(rng: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(*(lambda q: q / np.linalg.norm(q))(rng.normal(size=4)))
    return pin.SE3(turn.toRotationMatrix(), rng.uniform(-1.0, 1.0, 3))


def brute_force(points: np.ndarray, shape: coal.CollisionGeometry, place: pin.SE3) -> float:
    bead = coal.Sphere(1e-3)
    return min(coal_distance(bead, pin.SE3(np.eye(3), point), shape, place) + 1e-3 for point in points)


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.sampled_from(sorted(SHAPES)), st.sampled_from([1, 40, 700]))
def test_blocks_are_their_points(seed, kind, count):
    rng = np.random.default_rng(seed)
    cloud = Cloud.of("cloud", rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, rng.choice([0.0, 1.0])], 0.02)
    shape, place = SHAPES[kind], placed(rng)
    found, expected = PointBlocks.of(cloud).distance(BareShape.of(shape), place), brute_force(cloud.core, shape, place)
    if expected > 1e-5:
        assert found == pytest.approx(expected, abs=3e-6)
        assert distance_from(cloud)(shape, place) == pytest.approx(expected - 0.02, abs=3e-6)
    else:
        assert found <= 2e-5


def test_balls_hold_their_points_and_bound_distances_from_below():
    rng = np.random.default_rng(3)
    cloud = Cloud.of("cloud", rng.uniform(-1.0, 1.0, (1000, 3)), 0.02)
    blocks = PointBlocks.of(cloud)
    apart = np.linalg.norm(cloud.core[:, None] - blocks.balls[None, :, :3], axis=2) - blocks.balls[:, 3]
    assert (apart.min(axis=1) < 0.0).all()
    assert len(blocks.balls) == 16
    for kind, half in (("capsule", (0.04, 0.04, 0.39)), ("box", (0.15, 0.05, 0.25)), ("sphere", (0.2, 0.2, 0.2))):
        np.testing.assert_allclose(local_box(SHAPES[kind]), [(0.0, 0.0, 0.0), half], atol=1e-12)
    for seed in range(20):
        place, shape = placed(np.random.default_rng(seed)), SHAPES["capsule"]
        bounds = _lower_bounds(place.rotation, place.translation, local_box(shape), blocks.balls)
        for (*centre, radius), bound in zip(blocks.balls.tolist(), bounds.tolist(), strict=True):
            at = pin.SE3(np.eye(3), np.array(centre))
            assert bound <= coal_distance(coal.Sphere(radius), at, shape, place) + 1e-6 or bound < 0.0
