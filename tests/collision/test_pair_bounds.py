"""Lower bounds of coal's distances, by a box about each part of the arm and a ball about each obstacle."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm
from arm_variants import random_obstacles

from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import capsule_shapes, solid_shape
from hplan.scene.obstacles import Capsule, PointCloud


def many(rng, copies=40):
    """Obstacles of all kinds, a cloud among them."""
    found = [o.model_copy(update={"name": f"{k}{o.name}"}) for k in range(copies) for o in random_obstacles(rng)]
    return [*found, PointCloud.of("leaves", rng.uniform(-2.0, 2.0, (50, 3)), 0.02).solids[0]]


@pytest.mark.parametrize("kind", ["capsule", "urdf", "bodies"])
def test_no_bound_is_above_the_distance_and_most_are_near_it(robot, kind, tmp_path_factory):
    arm = loaded_arm("lift", tmp_path_factory) if kind == "bodies" else robot
    rng = np.random.default_rng(2)
    checker = CoalScene(arm, many(rng), links="urdf" if kind == "urdf" else "capsule", growth=0.01, clearance=0.02)
    pairs = np.arange(len(checker.pairs))
    errors, close = checker.distance_errors, 0
    for q in rng.uniform(arm.lower, arm.upper, (20, arm.dof)):
        distances = checker.pair_distances(q)
        bounds = checker.lower_bounds(pairs)
        assert (bounds <= distances + errors + 1e-6 * np.abs(distances)).all()
        close += int((bounds > 0.5 * distances).sum())
    assert close > 0.5 * 20 * len(pairs)


def test_the_nearest_pair_is_that_of_all_distances(robot):
    rng = np.random.default_rng(3)
    checker = CoalScene(robot, many(rng))
    for q in rng.uniform(robot.lower, robot.upper, (40, robot.dof)):
        kept = rng.uniform(0.0, 0.05, len(checker.pairs))
        pair, distance = checker.nearest_pair(q, kept)
        beyond = checker.pair_distances(q) - kept
        assert distance - kept[pair] == pytest.approx(beyond.min(), abs=1e-9)
        assert beyond[pair] == pytest.approx(beyond.min(), abs=1e-9)


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
