"""OMPL's paths with hplan's validity checkers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from planned import post, task

from hplan.adapters.ompl import Validity
from hplan.certificate.configuration_check import check
from hplan.errors import InputError
from hplan.planning.finish import finish
from hplan.robot.model import Robot
from hplan.scene.model import Scene

START, GOAL = (-40.0, 10.0, 60.0, 30.0), (40.0, 10.0, 60.0, 30.0)


@pytest.fixture
def around() -> Scene:
    """A motion around a post."""
    return task(START, GOAL, [post("post", 0.0, 1.1, 0.0, 2.5)])


def test_states_are_judged_as_by_coal(robot: Robot, around: Scene) -> None:
    ring = [post(f"post {bearing}", bearing, 0.9, 0.0, 2.5) for bearing in range(-170, 170, 25)]
    around = around.with_values(obstacles=(*ring, *around.obstacles[1:]), start=around.start)
    validity, random = Validity.of_scene(robot, around), np.random.default_rng(3)
    states = random.uniform(robot.lower, robot.upper, (200, 4))
    ours = [validity.is_valid(state) for state in states]
    theirs = check(robot, around, states)
    assert 20 < sum(ours) < 180
    is_clear_cut = np.abs(theirs.distance_m) > 1e-4
    np.testing.assert_array_equal(np.array(ours)[is_clear_cut], theirs.valid[is_clear_cut])


def test_motion_between_valid_states_is_refused_in_contact(robot: Robot, around: Scene) -> None:
    validity = Validity.of_scene(robot, around)
    first, last = np.radians(START), np.radians(GOAL)
    assert validity.is_valid(first)
    assert validity.is_valid(last)
    assert not validity.is_valid_motion(first, last)
    assert validity.is_valid_motion(first, first + np.eye(4)[0] * 0.1)


def test_locked_joints_are_no_axes(robot: Robot, around: Scene) -> None:
    validity = Validity.of_scene(robot, around.with_values(locked_joints=("base_yaw",)))
    np.testing.assert_allclose(validity.configuration([0.1, 0.2, 0.3]), [np.radians(-40.0), 0.1, 0.2, 0.3])


def test_states_must_be_finite_and_of_the_free_joints(robot: Robot, around: Scene) -> None:
    validity = Validity.of_scene(robot, around)
    for state in ([np.nan, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3], [0.1, 0.2, 0.3, 0.4, 0.5]):
        with pytest.raises(InputError, match="state"):
            validity.is_valid(state)
        with pytest.raises(InputError, match="state"):
            validity.is_valid_motion(np.radians(START), state)


def test_path_of_ompl_is_free_of_contact(robot: Robot, around: Scene) -> None:
    base: Any = pytest.importorskip("ompl.base", reason="OMPL is not installed (extra `bench`)")
    geometric: Any = pytest.importorskip("ompl.geometric")
    validity = Validity.of_scene(robot, around)
    space, bounds = base.RealVectorStateSpace(4), base.RealVectorBounds(4)
    for axis, (low, high) in enumerate(zip(robot.lower, robot.upper, strict=True)):
        bounds.setLow(axis, float(low))
        bounds.setHigh(axis, float(high))
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    validator = validity.motion_validator(information)
    setup.setStateValidityChecker(validity.is_valid)
    information.setMotionValidator(validator)
    ends = [space.allocState(), space.allocState()]
    for state, end in zip(ends, np.radians([START, GOAL]), strict=True):
        for axis in range(4):
            state[axis] = float(end[axis])
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(information))
    assert setup.solve(20.0)
    path = [validity.configuration(state) for state in setup.getSolutionPath().getStates()]
    assert validity.world.field.is_clear(path, 1e-6)
    assert finish(robot, around, path).certificate.verified
