"""The C-space over yaws: its axis, its layers one by one, what thick layers hold, and what is remembered."""

from __future__ import annotations

import numpy as np
import pytest
from arm_variants import load_variant, random_obstacles
from hypothesis import given, settings
from hypothesis import strategies as st
from studies.planar_cspace import joint_grid

from hplan.base.arrays import BoolArray
from hplan.grid.grid import Occupancy
from hplan.grid.occupancy import occupancy
from hplan.grid.prepared_obstacles import prepare_obstacles
from hplan.grid.sections import sections_at
from hplan.grid.yaw_layers import LayerCache, YawAxis, turning_occupancy, yaw_axis

LOWER, UPPER = -3.0, 3.0


def free_nodes(space: Occupancy) -> BoolArray:
    """One truth value for each node."""
    bits = np.unpackbits(space.free_words.view(np.uint8), axis=1, bitorder="little")
    return bits[:, : space.grid.shape[-1]].reshape(space.grid.shape).astype(bool)


@settings(max_examples=200)
@given(
    start=st.floats(LOWER, UPPER), goal=st.floats(LOWER, UPPER), step=st.floats(0.01, 1.0), beyond=st.floats(0.0, 7.0)
)
def test_the_axis_holds_start_and_goal_within_the_limits(start: float, goal: float, step: float, beyond: float) -> None:
    first, spacing, count = yaw_axis(start, goal, step, LOWER, UPPER, beyond)
    yaws = first + spacing * np.arange(count)
    assert spacing <= step * (1.0 + 1e-12)
    assert yaws[0] >= LOWER - 1e-6
    assert yaws[-1] <= UPPER + 1e-6
    assert np.abs(yaws - start).min() < 1e-6
    assert np.abs(yaws - goal).min() < 1e-6 or abs(start - goal) < 0.5 * step
    for end, towards in ((min(start, goal), -1.0), (max(start, goal), 1.0)):
        wanted = min(beyond, (UPPER - end) if towards > 0.0 else (end - LOWER))
        reached = towards * ((yaws[-1] if towards > 0.0 else yaws[0]) - end)
        assert wanted - step - 1e-6 < reached < wanted + 0.5 * step + 1e-6


@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 130])
@pytest.mark.parametrize("step", [1.0, 0.08])
def test_each_layer_is_the_planar_problem_at_its_yaw(tmp_path, count, step) -> None:
    """Grids of less than a word, and of one and more, in either direction."""
    robot = load_variant("one link on a yaw" if step < 0.1 else "upright on a yaw", tmp_path)
    bodies = prepare_obstacles(random_obstacles(np.random.default_rng(count), 9))
    planar = joint_grid(robot.arm, step)
    first, turn = -0.7, 0.03
    space = turning_occupancy(robot, bodies, planar, YawAxis(first, turn, count), layers=LayerCache())
    assert space.grid.shape == (*planar.shape, count)
    np.testing.assert_allclose(
        space.grid.coordinates(np.array([0] * len(planar.shape) + [count - 1]))[-1], first + turn * (count - 1)
    )
    free = free_nodes(space)
    assert free.any()
    for layer in range(count):
        sections = sections_at(robot, bodies, first + turn * layer)
        np.testing.assert_array_equal(free[..., layer], free_nodes(occupancy(robot.arm, sections, planar)))
    spare = np.unpackbits(space.free_words.view(np.uint8), axis=1, bitorder="little")[:, count:]
    assert not spare.any()


def test_layers_are_remembered_until_there_are_too_many(tmp_path) -> None:
    robot = load_variant("upright on a yaw", tmp_path)
    planar, finer = joint_grid(robot.arm, 1.0), joint_grid(robot.arm, 0.8)
    bodies = prepare_obstacles(random_obstacles(np.random.default_rng(1), 9))
    sections = [sections_at(robot, bodies, 0.1 * k) for k in range(4)]
    layers = LayerCache()
    first = layers.free_words(robot, sections[0], planar)
    assert layers.free_words(robot, sections_at(robot, bodies, 0.0), planar) is first
    assert layers.free_words(robot, sections[1], planar) is not first
    assert layers.free_words(robot, sections[0], finer).shape != first.shape
    assert layers.free_words(robot, sections[0], planar) is first
    grown = sections_at(robot, prepare_obstacles(random_obstacles(np.random.default_rng(1), 9), clearance=0.01), 0.0)
    assert layers.free_words(robot, grown, planar) is not first

    few = LayerCache(most_bytes=1)
    first = few.free_words(robot, sections[0], planar)
    assert few.free_words(robot, sections[0], planar) is first
    few.free_words(robot, sections[1], planar)
    again = few.free_words(robot, sections[0], planar)
    assert again is not first
    np.testing.assert_array_equal(again, first)
