"""The fastest motion in free space: states, limits, and linear programs that have no solution with one piece less."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from hplan.optimization.arrival import fastest_arrival
from hplan.optimization.timed_spline import BoundaryState
from hplan.robot.limits import Limits, least_duration_between

RATE_HZ = 250.0


def random_task(seed, jerk):
    """A state within its limits, a goal, and the limits; the velocity stays within them at all accelerations."""
    rng = np.random.default_rng(seed)
    dof = int(rng.integers(1, 8))
    velocity, acceleration = rng.uniform(1.0, 3.0, dof), rng.uniform(1.0, 10.0, dof)
    limits = Limits(velocity, acceleration, jerk=50.0 * acceleration if jerk else None)
    position = rng.normal(size=dof)
    speed, push = rng.uniform(-0.6, 0.6, dof) * velocity, rng.uniform(-0.9, 0.9, dof) * acceleration
    goal = position + rng.normal(size=dof) * rng.choice([0.0, 0.1, 1.0], dof)
    return BoundaryState(position, speed, push), goal, limits


def is_possible(state, goal, limits, piece_s, pieces):
    """True if a linear program of steps has a solution for every joint."""
    free = pieces - 2  # the last two steps are 0
    if free < 1:
        return False
    for values in zip(
        state.position, state.velocity, state.acceleration, goal, limits.velocity, limits.acceleration, strict=True
    ):
        q, v, a, end, most_v, most_a = values
        first, third = piece_s * v + 0.5 * piece_s**2 * a, q + piece_s * v + piece_s**2 * a / 3.0
        change = np.diff(np.eye(free + 2), axis=0)[:, 1:-1]  # from one step to the next; the outer ones are known
        known = np.zeros(free + 1)
        known[0] = -first
        upper = piece_s**2 * most_a
        found = linprog(
            np.zeros(free), np.vstack([change, -change]), np.concatenate([upper - known, upper + known]),
            np.ones((1, free)), [end - third], bounds=[(-piece_s * most_v, piece_s * most_v)] * free,
        )  # fmt: skip
        if found.status != 0:
            return False
    return True


@pytest.mark.parametrize("jerk", [False, True])
@pytest.mark.parametrize("seed", range(30))
def test_motion_is_within_limits_and_the_fastest(seed, jerk):
    state, goal, limits = random_task(seed, jerk)
    spline = fastest_arrival(state, goal, limits, RATE_HZ)
    path, clock = spline.path, np.linspace(0.0, spline.duration, 3001)
    position, velocity, acceleration = (path.evaluate(clock, order) for order in range(3))
    start = np.stack([position[0], velocity[0], acceleration[0]])
    np.testing.assert_allclose(start, [state.position, state.velocity, state.acceleration], rtol=0, atol=1e-9)
    np.testing.assert_allclose(position[-1], goal, rtol=0, atol=1e-12)
    np.testing.assert_allclose([velocity[-1], acceleration[-1]], 0.0, rtol=0, atol=1e-9)
    assert (np.abs(velocity) <= limits.velocity * (1.0 + 1e-9)).all()
    assert (np.abs(acceleration) <= limits.acceleration * (1.0 + 1e-9)).all()
    breaks, at_breaks = path.breaks, path.evaluate(path.breaks, 2)
    if jerk:
        jerks = np.abs(np.diff(at_breaks, axis=0)) / np.diff(breaks)[:, None]
        assert (jerks <= limits.jerk * (1.0 + 1e-9)).all()
    # Its pieces meet at samples.
    np.testing.assert_allclose(breaks * RATE_HZ, np.round(breaks * RATE_HZ), rtol=0, atol=1e-9)
    # No motion with one piece less, and none that is much faster.
    pieces = len(breaks) - 1
    assert is_possible(state, goal, limits, breaks[1], pieces)
    assert not is_possible(state, goal, limits, breaks[1], pieces - 1)
    speeds = state.velocity, np.zeros(len(goal))
    least_s = least_duration_between(goal - state.position, speeds, limits.velocity, limits.acceleration).max()
    assert least_s <= spline.duration <= least_s + 0.2


def test_joints_at_their_goal_stay_there():
    state, goal, limits = random_task(3, jerk=True)
    still = BoundaryState(state.position, 0.0 * state.velocity, 0.0 * state.velocity)
    goal = state.position.copy()
    goal[0] += 1.0
    spline = fastest_arrival(still, goal, limits, RATE_HZ)
    assert (spline.control[:, 1:] == goal[1:]).all()


def test_motion_that_takes_too_long():
    still, one = BoundaryState.at_rest(np.zeros(1)), np.ones(1)
    assert fastest_arrival(still, 1e4 * one, Limits(one, one), RATE_HZ) is None


@pytest.mark.parametrize(("jerk", "is_found"), [(20.0, True), (2.0, False)])
def test_low_jerk_limits_need_enough_pieces(jerk, is_found):
    still, one = BoundaryState.at_rest(np.zeros(1)), np.ones(1)
    spline = fastest_arrival(still, one, Limits(one, one, jerk=jerk * one), RATE_HZ)
    assert (spline is not None) == is_found
    slow = fastest_arrival(still, 100.0 * one, Limits(one, one, jerk=jerk * one), RATE_HZ)
    assert slow.duration <= 1.1 * (100.0 + 1.0 + 1.0 / jerk)


def test_joint_that_accelerates_near_its_velocity_limit():
    one = np.ones(1)
    for jerk in (None, 500.0 * one):
        limits = Limits(one, 5.0 * one, jerk=jerk)
        # The largest steps would reach 1.015 of the limit.
        state = BoundaryState(np.zeros(1), 0.98 * one, 3.5 * one)
        spline = fastest_arrival(state, 3.0 * one, limits, RATE_HZ)
        clock = np.linspace(0.0, spline.duration, 30_001)
        velocity, acceleration = (spline.path.evaluate(clock, order) for order in (1, 2))
        assert 0.999 < np.abs(velocity).max() <= 1.0 + 5e-4 + 1e-9
        assert np.abs(acceleration).max() <= 5.0 + 1e-9
        least_s = least_duration_between(3.0 * one, (state.velocity, 0.0 * one), one, 5.0 * one).max()
        assert spline.duration <= least_s + 0.1
        mirrored = BoundaryState(np.zeros(1), -0.98 * one, -3.5 * one)
        backward = fastest_arrival(mirrored, -3.0 * one, limits, RATE_HZ)
        np.testing.assert_allclose(backward.control, -spline.control, rtol=0, atol=1e-12)
        # The way back does not exceed the limit any more.
        turned = fastest_arrival(state, -one, limits, RATE_HZ)
        assert turned.path.evaluate(np.linspace(0.0, 0.1, 3001), 1).max() <= 1.0 + 5e-4 + 1e-9
        # From the limit itself no motion keeps it, however it brakes; rounding is no obstacle.
        assert fastest_arrival(BoundaryState(np.zeros(1), one, 3.5 * one), 3.0 * one, limits, RATE_HZ) is None
        rounded = BoundaryState(np.zeros(1), one * (1.0 + 1e-9), 1e-3 * one)
        assert fastest_arrival(rounded, 3.0 * one, limits, RATE_HZ) is not None
