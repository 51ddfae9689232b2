"""Motions mended: what comes back is clear as coal judges many samples, within the limits, and begins and ends alike."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.clearance import ClearanceField
from hplan.collision import CollisionScene
from hplan.mend import mended
from hplan.robot import Robot, load_robot
from hplan.scene import Box, Capsule, Sphere

ROBOT = load_robot()
MARGIN = 1e-3


def mend(path: Any, solids: Any, robot: Robot = ROBOT, margin: float = MARGIN) -> tuple[np.ndarray, list[int]]:
    field = ClearanceField.of(robot, solids)
    return mended(np.asarray(path, dtype=float), field, robot.lower, robot.upper, margin)


def assert_mended(robot: Robot, solids: Any, path: np.ndarray, found: np.ndarray, contacts: list[int]) -> None:
    """The given nodes in their order; all motions but those named clear; all within the limits."""
    rows = [0]
    for node in path[1:]:
        rows.append(rows[-1] + 1 + int((found[rows[-1] + 1 :] == node).all(axis=1).argmax()))
        assert (found[rows[-1]] == node).all()
    assert rows[-1] == len(found) - 1
    assert (found >= np.minimum(robot.lower, path.min(axis=0))).all()
    assert (found <= np.maximum(robot.upper, path.max(axis=0))).all()
    judge, field = CollisionScene(robot, solids), ClearanceField.of(robot, solids)
    for number, (first, last) in enumerate(itertools.pairwise(rows)):
        stretch = found[first : last + 1]
        if number in contacts:
            assert len(stretch) == 2
            assert not field.is_clear(stretch, MARGIN)
            continue
        assert field.is_clear(stretch, MARGIN)
        for a, b in itertools.pairwise(stretch):
            count = 2 + int(np.abs(b - a).max() / 0.01)
            assert min(judge.distances(q).min() for q in np.linspace(a, b, count)) > 0.0


def test_what_is_clear_stays(robot: Robot) -> None:
    path = np.array([[0, 0.1, 0.1, 0.1], [0.5, 0.4, 0.2, 0.3], [0.6, 0.8, 0.2, 0.9]])
    for solids in ([], [Sphere(name="far", center=(0.0, -2.0, 2.0), radius=0.1)]):
        found, contacts = mend(path, solids)
        np.testing.assert_array_equal(found, path)
        assert contacts == []
        assert not found.flags.writeable


def test_a_single_point_stays(robot: Robot) -> None:
    found, contacts = mend(np.zeros((1, 4)), [])
    assert found.shape == (1, 4)
    assert contacts == []


def test_joints_one_after_the_other() -> None:
    """Lifting first and turning then passes a low post that the straight motion would hit."""
    low = Capsule(name="low", start=(0.9, 0.25, 0.0), end=(0.9, 0.25, 0.9), radius=0.03)
    path = np.array([[0.0, 0.05, 0.0, 0.0], [0.45, 0.5, 0.0, 0.0]])
    assert not ClearanceField.of(ROBOT, [low]).is_clear(path, MARGIN)
    found, contacts = mend(path, [low])
    assert contacts == []
    np.testing.assert_array_equal(found, [path[0], [0.0, 0.5, 0.0, 0.0], path[1]])
    assert_mended(ROBOT, [low], path, found, contacts)


def test_pushed_over_an_obstacle() -> None:
    """No order of the joints helps where one joint alone has to move: the middle is pushed out."""
    for side in (0.0, 0.35):
        solids = [Sphere(name="ball", center=(1.7 * np.cos(side), 1.7 * np.sin(side), 0.54), radius=0.05)]
        path = np.array([[side - 0.2, 0.0, 0.0, 0.0], [side + 0.2, 0.0, 0.0, 0.0]])
        assert not ClearanceField.of(ROBOT, solids).is_clear(path, MARGIN)
        found, contacts = mend(path, solids)
        assert contacts == []
        assert len(found) > 2
        assert_mended(ROBOT, solids, path, found, contacts)


def test_locked_joints_do_not_move() -> None:
    """The push uses the joints that may move only; where none of these helps the motion is named."""
    ball = Sphere(name="ball", center=(1.7, 0.0, 0.54), radius=0.05)
    path = np.array([[-0.2, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0]])
    field = ClearanceField.of(ROBOT, [ball])
    lower, upper = ROBOT.lower.copy(), ROBOT.upper.copy()
    lower[2:] = upper[2:] = 0.0
    found, contacts = mended(path, field, lower, upper, MARGIN)
    assert contacts == []
    assert (found[:, 2:] == 0.0).all()
    assert (found[:, 1] > 0.0).any()
    lower[1:] = upper[1:] = 0.0
    found, contacts = mended(path, field, lower, upper, MARGIN)
    assert contacts == [0]
    np.testing.assert_array_equal(found, path)


def test_motions_that_cannot_be_mended_are_named() -> None:
    """A wall between the first two nodes; the last motion is clear."""
    wall = Box(name="wall", center=(1.2, 0.0, 1.5), size=(1.8, 0.05, 3.0))
    path = np.array([[0.0, 0.3, 0.2, 0.2]] * 4)
    path[:, 0] = [0.5, 0.3, -0.3, -0.5]
    found, contacts = mend(path, [wall])
    assert contacts == [1]
    assert_mended(ROBOT, [wall], path, found, contacts)


def test_same_answer_whatever_is_known() -> None:
    """What earlier calls found out changes nothing."""
    solids = [Sphere(name="ball", center=(1.7, 0.0, 0.54), radius=0.05)]
    path = np.array([[-0.2, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0], [0.3, 0.2, 0.0, 0.0]])
    field = ClearanceField.of(ROBOT, solids)
    known: dict[bytes, Any] = {}
    results = [
        mended(path, field, ROBOT.lower, ROBOT.upper, MARGIN),
        mended(path, field, ROBOT.lower, ROBOT.upper, MARGIN, known),
        mended(path, field, ROBOT.lower, ROBOT.upper, MARGIN, known),
    ]
    for found, contacts in results:
        assert found.tobytes() == results[0][0].tobytes()
        assert contacts == results[0][1]


joints = st.tuples(st.floats(-1.0, 1.0), *[st.floats(0.0, 1.5)] * 3)
steps = st.lists(st.tuples(*[st.floats(-0.25, 0.25)] * 4), min_size=1, max_size=6)
balls = st.lists(
    st.tuples(st.floats(0.3, 1.9), st.floats(-1.0, 1.0), st.floats(0.4, 2.2), st.floats(0.02, 0.15)),
    min_size=1,
    max_size=5,
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(joints, steps, balls)
def test_mended_among_random_balls(first: Any, moves: Any, places: Any) -> None:
    solids = [Sphere(name=f"b{i}", center=place[:3], radius=place[3]) for i, place in enumerate(places)]
    path = np.clip(np.cumsum([first, *moves], axis=0), ROBOT.lower, ROBOT.upper)
    path = path[np.concatenate([[True], (np.diff(path, axis=0) != 0.0).any(axis=1)])]
    if len(path) < 2:
        return
    found, contacts = mend(path, solids)
    assert_mended(ROBOT, solids, path, found, contacts)


@pytest.mark.parametrize("seed", range(3))
def test_most_motions_that_graze_are_mended(seed: int) -> None:
    """Motions as between nodes of a grid, whose ends are clear and whose middles are not."""
    rng, seen, failed = np.random.default_rng(seed), 0, 0
    while seen < 25:
        first = rng.uniform([-1.0, 0.0, 0.0, 0.0], [1.0, 1.5, 1.5, 1.5])
        last = np.clip(first + rng.uniform(-0.06, 0.06, 4), ROBOT.lower, ROBOT.upper)
        tool = ROBOT.tool_positions(0.5 * (first + last)) + rng.normal(size=3) * 0.02
        ball = Sphere(name="ball", center=tuple(tool.tolist()), radius=float(rng.uniform(0.005, 0.02)))
        field = ClearanceField.of(ROBOT, [ball])
        path = np.stack([first, last])
        if min(map(field.clearance, path)) < 2.0 * MARGIN or field.is_clear(path, MARGIN):
            continue
        seen += 1
        found, contacts = mend(path, [ball])
        failed += len(contacts)
        assert_mended(ROBOT, [ball], path, found, contacts)
    assert failed <= 6
