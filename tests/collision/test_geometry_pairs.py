"""Pairs of shapes over several geometry models are the same pairs as in one."""

from __future__ import annotations

import numpy as np
import pytest
from arm_variants import random_obstacles

import hplan.collision.geometry_pairs as module
from hplan.collision.coal_scene import CoalScene
from hplan.robot.family.members import write_robot
from hplan.robot.family.spec import ArmSpec
from hplan.robot.model import load_robot
from hplan.scene.solids import Cloud


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """An arm that can touch itself and what carries it."""
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


@pytest.mark.parametrize("links", ["capsule", "urdf"])
@pytest.mark.parametrize("count", [0, 7, 13])
def test_models_of_few_obstacles_answer_as_one_of_all(wide, links, count, monkeypatch):
    rng = np.random.default_rng(count)
    obstacles = random_obstacles(rng, count)
    if count > 6:
        obstacles[4] = Cloud.of("cloud", rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (30, 3)), 0.02)
    growth = rng.uniform(0.0, 0.05, count)
    whole = CoalScene(wide, obstacles, links=links, growth=growth)
    monkeypatch.setattr(module, "_CHUNK", 3)
    parts = CoalScene(wide, obstacles, links=links, growth=growth)
    assert parts.pairs == whole.pairs
    assert len(parts.parts.own) > 0
    configurations = rng.uniform(wide.lower, wide.upper, (80, wide.dof))
    if count:
        name = obstacles[-1].name
        whole, parts = whole.touching(name), parts.touching(name)
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
