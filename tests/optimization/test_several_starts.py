"""Several starts: the faster side of an obstacle is found, and little is spent on the others."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hplan.collision.clearance_field import ClearanceField
from hplan.optimization.minimize_time import Effort, Level
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.several_starts import StartsEffort, fastest_motions, optimization_starts
from hplan.optimization.time_problem import TimeProblem
from hplan.robot.limits import Limits
from hplan.scene.obstacles import Sphere

START, GOAL = np.array([0.15, 1.2, 0.3, 0.3]), np.array([0.15, 0.1, 0.3, 0.3])
LEVELS = (Level(0.1, (15, 30), 10, 1e-2, 0.2), Level(0.05, (20, 40), 3, 1e-2, 0.05))
EFFORT = StartsEffort(Effort(LEVELS), rough=4, others=1, finished=1)


@pytest.fixture(scope="module")
def problem(robot):
    field = ClearanceField.of(robot, [Sphere(name="ball", center=(1.6, 0.0, 1.6), radius=0.25).solids[0]])
    options = PostprocessOptions(
        lower=robot.lower, upper=robot.upper, velocity=robot.velocity_limit, acceleration=robot.acceleration_limit,
        movable=np.arange(4), margin=2e-3,
    )  # fmt: skip
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return TimeProblem(field, field, options, limits, robot.dynamics, 250.0)


def paths():
    """On the farther side of the ball, and twice on the nearer one."""
    return [np.stack([START, np.array([yaw, 0.65, 0.3, 0.3]), GOAL]) for yaw in (-0.7, 0.9, 0.8)]


def test_the_faster_class_wins_whatever_comes_first(problem):
    starts = optimization_starts(paths(), problem)
    assert len(starts) == 3
    times = [start.profile.duration for start in starts]
    assert times == sorted(times)  # none is within the preference for the first
    alone = [fastest_motions([start], EFFORT)[0][1].duration for start in starts]
    assert max(alone) > 1.01 * min(alone)
    for order in (starts, starts[::-1]):
        assert fastest_motions(order, EFFORT)[0][1].duration == pytest.approx(min(alone), rel=0.005)


def test_paths_in_contact_give_no_start(problem):
    straight = np.stack([START, GOAL])
    assert not problem.field.is_clear(straight, 1e-4)
    starts = optimization_starts([straight, *paths()], problem)
    assert sorted(start.number for start in starts) == [1, 2, 3]
    assert all(math.isfinite(start.profile.duration) for start in starts)
