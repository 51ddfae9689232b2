"""Clouds of balls: merging of near points, and the tree of bounding balls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.geometry.cloud import LEAF, merge_points
from hplan.geometry.cloud_tree import tree_of


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 300), st.sampled_from([0.02, 0.2, 0.5]))
def test_points_of_one_voxel_become_the_middle_of_their_box(seed, count, edge):
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 3))
    middles, farthest = merge_points(points, edge)
    voxels = np.floor(points / edge)
    own = [points[(voxels == voxel).all(axis=1)] for voxel in np.unique(voxels, axis=0)]
    if len(own) > 0.7 * count:
        np.testing.assert_array_equal(middles, points)
        assert farthest == 0.0
        return
    boxes = [(inside.min(axis=0), inside.max(axis=0)) for inside in own]
    np.testing.assert_array_equal(sorted(map(tuple, middles)), sorted(tuple(0.5 * (low + high)) for low, high in boxes))
    away = np.linalg.norm(points[:, None] - middles, axis=2).min(axis=1).max()
    assert away <= farthest + 1e-12
    needed = [np.linalg.norm(i - 0.5 * (low + high), axis=1).max() for i, (low, high) in zip(own, boxes, strict=True)]
    assert farthest == pytest.approx(max(needed), rel=1e-12)


def test_points_too_far_apart_for_numbers_of_their_voxels_stay():
    points = np.random.default_rng(0).choice([-9e3, 9e3], (40, 3))
    middles, farthest = merge_points(points, 1e-3)
    np.testing.assert_array_equal(middles, points)
    assert farthest == 0.0


@pytest.mark.parametrize("kind", ["random", "one place", "steps", "line", "sorted", "strays"])
@pytest.mark.parametrize("count", [1, LEAF + 1, 1000])
def test_tree_parts_its_points_and_its_balls_hold_them(kind, count):
    rng = np.random.default_rng(count)
    points = {
        "random": rng.uniform(0, 1, (count, 3)),
        "one place": np.ones((count, 3)),
        "steps": rng.integers(0, 3, (count, 3)).astype(float),
        "line": rng.uniform(0, 1, (count, 1)) * [1.0, 0.0, 0.0],
        "sorted": np.sort(rng.uniform(0, 1, (count, 3)), axis=0),
        "strays": rng.choice([0.0, 1e-3, 1.0], (count, 3)) ** rng.integers(1, 5, (count, 1)),
    }[kind]
    core, nodes = tree_of(points, LEAF)
    assert sorted(map(tuple, core)) == sorted(map(tuple, points))
    assert nodes[0, :3].tolist() == [0, count, len(nodes)]
    for number, (first, last, after, *ball) in enumerate(nodes.tolist()):
        inside = core[int(first) : int(last)]
        low, high = inside.min(axis=0), inside.max(axis=0)
        away = np.linalg.norm(inside - ball[:3], axis=1).max()
        np.testing.assert_array_equal(ball[:3], 0.5 * (low + high))
        assert away <= ball[3] * (1.0 + 1e-12)
        assert ball[3] <= 0.5 * np.linalg.norm(high - low) * (1.0 + 1e-12)
        if after > number + 1:
            other = int(nodes[number + 1, 2])
            assert nodes[number + 1, :2].tolist() == [first, nodes[other, 0]]
            assert nodes[other, 1:3].tolist() == [last, after]
        else:
            assert ball[3] == pytest.approx(away, rel=1e-12)
            assert last - first <= LEAF
