"""Repaired motions and escapes from tight places, judged by coal."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.optimization.repair import leave_contact, repair
from hplan.planar.family_reader import family_of
from hplan.robot.model import Robot, load_robot
from hplan.scene.obstacles import Box, Capsule, Sphere

MARGIN = 1e-4


def near_the_links(robot: Robot, q: np.ndarray, gap: float) -> list[Sphere | Capsule]:
    """A ball just below the second link and a bar just above the third."""
    points = family_of(robot).plane_origin + family_of(robot).arm.joint_points(q[1:]) @ family_of(robot).plane_axes
    second, third = np.diff(points, axis=0)[1:]
    up = [np.cross(np.cross(part, [0.0, 0.0, 1.0]), part) for part in (second, third)]
    up = [direction / np.linalg.norm(direction) for direction in up]
    widths = family_of(robot).arm.half_widths
    below = points[1] + 0.5 * second - (widths[1] + 0.05 + gap) * up[0]
    above = points[2] + 0.5 * third + (widths[2] + 0.02 + gap) * up[1]
    across = np.array([0.0, 0.3, 0.0])
    return [
        Sphere(name="below", center=tuple(below), radius=0.05),
        Capsule(name="above", start=tuple(above - across), end=tuple(above + across), radius=0.02),
    ]


def assert_clear(robot: Robot, obstacles: list[Sphere | Capsule], path: np.ndarray) -> None:
    checker = CoalScene(robot, obstacles)
    for first, last in itertools.pairwise(path):
        for t in np.linspace(0.0, 1.0, 40):
            assert checker.distances((1.0 - t) * first + t * last).min() > 0.0


@pytest.mark.parametrize("locked", [False, True])
def test_out_between_obstacles_that_hold_two_links_from_two_sides(robot, locked) -> None:
    q = np.array([0.0, 0.6, 0.5, 0.4])
    obstacles = near_the_links(robot, q, 1e-3)
    field = ClearanceField.build(robot, obstacles)
    assert (field.link_clearances(q) < 1.5e-3).sum() == 2
    lower, upper = robot.lower.copy(), robot.upper.copy()
    if locked:
        lower[0] = upper[0] = q[0]
    ways = list(leave_contact(q, field, lower, upper, MARGIN))
    assert ways
    for number, way in enumerate(ways):
        np.testing.assert_array_equal(way[0], q)
        assert len(way) == number + 2
        assert (way >= lower).all()
        assert (way <= upper).all()
        assert field.spare_clearance(way[-1]) > field.spare_clearance(way[-2])
        assert_clear(robot, obstacles, way)
    assert field.spare_clearance(ways[-1][-1]) >= 0.01


# Obstacles between the nodes

ROBOT = load_robot()
FAR = 1e-3


def mend(path: Any, solids: Any, robot: Robot = ROBOT, margin: float = FAR) -> tuple[np.ndarray, list[int]]:
    field = ClearanceField.build(robot, solids)
    return repair(np.asarray(path, dtype=float), field, robot.lower, robot.upper, margin)


def assert_repaired(robot: Robot, solids: Any, path: np.ndarray, found: np.ndarray, contacts: list[int]) -> None:
    """The given nodes in their order; all motions but those named clear; all within the limits."""
    rows = [0]
    for node in path[1:]:
        rows.append(rows[-1] + 1 + int((found[rows[-1] + 1 :] == node).all(axis=1).argmax()))
        assert (found[rows[-1]] == node).all()
    assert rows[-1] == len(found) - 1
    assert (found >= np.minimum(robot.lower, path.min(axis=0))).all()
    assert (found <= np.maximum(robot.upper, path.max(axis=0))).all()
    checker, field = CoalScene(robot, solids), ClearanceField.build(robot, solids)
    for number, (first, last) in enumerate(itertools.pairwise(rows)):
        stretch = found[first : last + 1]
        if number in contacts:
            assert len(stretch) == 2
            assert not field.is_clear(stretch, FAR)
            continue
        assert field.is_clear(stretch, FAR)
        for a, b in itertools.pairwise(stretch):
            count = 2 + int(np.abs(b - a).max() / 0.01)
            assert min(checker.distances(q).min() for q in np.linspace(a, b, count)) > 0.0


def test_joints_one_after_the_other() -> None:
    """Lifting first and turning then passes a low post that the straight motion would hit."""
    low = Capsule(name="low", start=(0.9, 0.25, 0.0), end=(0.9, 0.25, 0.9), radius=0.03)
    path = np.array([[0.0, 0.05, 0.0, 0.0], [0.45, 0.5, 0.0, 0.0]])
    assert not ClearanceField.build(ROBOT, [low]).is_clear(path, FAR)
    found, contacts = mend(path, [low])
    assert contacts == []
    np.testing.assert_array_equal(found, [path[0], [0.0, 0.5, 0.0, 0.0], path[1]])
    assert_repaired(ROBOT, [low], path, found, contacts)


def test_locked_joints_do_not_move() -> None:
    """Only movable joints are used; if none helps the motion is named."""
    ball = Sphere(name="ball", center=(1.7, 0.0, 0.54), radius=0.05)
    path = np.array([[-0.2, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0]])
    field = ClearanceField.build(ROBOT, [ball])
    lower, upper = ROBOT.lower.copy(), ROBOT.upper.copy()
    lower[2:] = upper[2:] = 0.0
    found, contacts = repair(path, field, lower, upper, FAR)
    assert contacts == []
    assert (found[:, 2:] == 0.0).all()
    assert (found[:, 1] > 0.0).any()
    lower[1:] = upper[1:] = 0.0
    found, contacts = repair(path, field, lower, upper, FAR)
    assert contacts == [0]
    np.testing.assert_array_equal(found, path)


@pytest.mark.parametrize("above", [0.05, 0.06, 0.08])
def test_limits_hold_where_the_push_leads_beyond(above: float) -> None:
    """The way out is downward, and the joints are at their lower limits."""
    ball = Sphere(name="ball", center=(1.7, 0.0, 0.6 + above), radius=0.05)
    path = np.array([[-0.2, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0]])
    found, contacts = mend(path, [ball])
    assert_repaired(ROBOT, [ball], path, found, contacts)


def test_motions_that_cannot_be_mended_are_named() -> None:
    """A wall between the first two nodes; the last motion is clear."""
    wall = Box(name="wall", center=(1.2, 0.0, 1.5), size=(1.8, 0.05, 3.0))
    path = np.array([[0.0, 0.3, 0.2, 0.2]] * 4)
    path[:, 0] = [0.5, 0.3, -0.3, -0.5]
    found, contacts = mend(path, [wall])
    assert contacts == [1]
    assert_repaired(ROBOT, [wall], path, found, contacts)


joints = st.tuples(st.floats(-1.0, 1.0), *[st.floats(0.0, 1.5)] * 3)
steps = st.lists(st.tuples(*[st.floats(-0.25, 0.25)] * 4), min_size=1, max_size=6)
balls = st.lists(
    st.tuples(st.floats(0.3, 1.9), st.floats(-1.0, 1.0), st.floats(0.4, 2.2), st.floats(0.02, 0.15)),
    min_size=1,
    max_size=5,
)


@settings(max_examples=150)
@given(joints, steps, balls)
def test_mended_among_random_balls(first: Any, moves: Any, places: Any) -> None:
    solids = [Sphere(name=f"b{i}", center=place[:3], radius=place[3]) for i, place in enumerate(places)]
    path = np.clip(np.cumsum([first, *moves], axis=0), ROBOT.lower, ROBOT.upper)
    path = path[np.concatenate([[True], (np.diff(path, axis=0) != 0.0).any(axis=1)])]
    if len(path) < 2:
        return
    found, contacts = mend(path, solids)
    assert_repaired(ROBOT, solids, path, found, contacts)


@pytest.mark.parametrize("seed", range(3))
def test_most_motions_that_graze_are_mended(seed: int) -> None:
    """Motions as between nodes of a grid, whose ends are clear and whose middles are not."""
    rng, seen, failed = np.random.default_rng(seed), 0, 0
    while seen < 25:
        first = rng.uniform([-1.0, 0.0, 0.0, 0.0], [1.0, 1.5, 1.5, 1.5])
        last = np.clip(first + rng.uniform(-0.06, 0.06, 4), ROBOT.lower, ROBOT.upper)
        tool = ROBOT.tool_positions(0.5 * (first + last)) + rng.normal(size=3) * 0.02
        ball = Sphere(name="ball", center=tuple(tool.tolist()), radius=float(rng.uniform(0.005, 0.02)))
        field = ClearanceField.build(ROBOT, [ball])
        path = np.stack([first, last])
        if field.spare_clearances(path).min() < 2.0 * FAR or field.is_clear(path, FAR):
            continue
        seen += 1
        found, contacts = mend(path, [ball])
        failed += len(contacts)
        assert_repaired(ROBOT, [ball], path, found, contacts)
    assert failed <= 6
