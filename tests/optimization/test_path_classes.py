"""Classes of paths: on different sides of an obstacle, or not."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.collision.compiled_field import ClearanceField
from hplan.optimization.path_classes import BETWEEN, class_numbers
from hplan.scene.obstacles import Sphere

START, GOAL = np.array([0.0, 1.2, 0.3, 0.3]), np.array([0.0, 0.1, 0.3, 0.3])


@pytest.fixture(scope="module")
def field(robot):
    return ClearanceField.build(robot, [Sphere(name="ball", center=(1.6, 0.0, 1.6), radius=0.25).solids[0]])


def bent(sideways):
    """(12, 4) points of a path, with the base turned midway."""
    parts = np.linspace(0.0, 1.0, 14)[1:-1, None]
    return START + parts * (GOAL - START) + np.sin(np.pi * parts) * np.array([sideways, 0.0, 0.0, 0.0])


def test_against_plain_numpy(field):
    rng = np.random.default_rng(3)
    shapes = np.sin(np.pi * np.linspace(0.0, 1.0, 14)[1:-1])[:, None]
    paths = np.stack([bent(0.0) + shapes * rng.uniform(-0.8, 0.8, 4) for _ in range(12)])
    expected: list[int] = []
    for number, path in enumerate(paths):
        firsts = [first for first in sorted(set(expected)) if clear_between(field, path, paths[first])]
        expected.append(firsts[0] if firsts else number)
    assert 2 < len(set(expected)) < 12
    np.testing.assert_array_equal(class_numbers(paths, field), expected)


def clear_between(field, path, other):
    parts = np.arange(1, BETWEEN + 1)[:, None, None] / (BETWEEN + 1)
    return (field.clearance_along((path + parts * (other - path)).reshape(-1, path.shape[1])) >= 0.0).all()
