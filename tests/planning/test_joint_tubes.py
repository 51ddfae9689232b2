"""Where a joint can be when: against motions that are sampled, and against optima by linear programming."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from hplan.base.arrays import FloatArray
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.robot.limits import rest_to_rest


def joint(goal: float, velocity: float, acceleration: float, jerk: float = np.inf, *, wide: float = 100.0):
    """One joint that moves from 0."""
    values = {"start": 0.0, "goal": goal, "lower": -wide, "upper": wide}
    limits = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    return JointMotions(**{name: np.array([value]) for name, value in (values | limits).items()})


def largest_place(motion: JointMotions, total: float, when: int, pieces: int = 60) -> float:
    """The largest position at a sample by linear programming, the jerk constant in each of many pieces.

    Fewer motions than there are, so that it is a lower bound of the largest one.
    """
    h = total / pieces
    state, rows = np.zeros((3, pieces)), [np.zeros((3, pieces))]  # position, velocity, acceleration over the jerks
    for k in range(pieces):
        q, v, a = state
        jerk = np.eye(pieces)[k]
        state = np.array([q + h * v + h * h / 2 * a + h**3 / 6 * jerk, v + h * a + h * h / 2 * jerk, a + h * jerk])
        rows.append(state)
    table = np.array(rows)
    limits = np.array([motion.velocity[0], motion.acceleration[0]])
    most = np.concatenate([table[:, 1], -table[:, 1], table[:, 2], -table[:, 2]])
    bounds = np.repeat(limits, 2 * (pieces + 1))
    jerk = motion.jerk[0] if np.isfinite(motion.jerk[0]) else None
    found = linprog(
        -table[when, 0],
        A_ub=most,
        b_ub=bounds,
        A_eq=table[-1],
        b_eq=[motion.goal[0], 0.0, 0.0],
        bounds=(None if jerk is None else -jerk, jerk),
    )
    return float(-found.fun) if found.success else -np.inf


@pytest.mark.parametrize("jerk", [np.inf, 40.0, 8.0])
@pytest.mark.parametrize("goal", [0.8, 0.2, 0.0])
def test_places_hold_the_optima_and_are_near_them(goal: float, jerk: float) -> None:
    motion = joint(goal, 1.2, 3.0, jerk)
    total = 1.15 * max(float(motion.least_durations[0]), 0.9)
    for when in (3, 10, 25, 40, 55):
        lower, upper = (end.item() for end in motion.places(np.array([[when / 60.0 * total]]), total))
        top = largest_place(motion, total, when)
        bottom = goal - largest_place(motion, total, 60 - when)  # the motion turned about its middle
        assert lower <= bottom + 1e-6
        assert top - 1e-6 <= upper
        assert upper - top < (0.02 if jerk > 30.0 else 0.12)


def profile(draws: FloatArray, velocity: float, acceleration: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, positions and velocities of a motion from rest to rest that is made of drawn accelerations."""
    h = 0.02
    speeds = [0.0]
    for push in draws:
        speeds.append(float(np.clip(speeds[-1] + h * push * acceleration, -velocity, velocity)))
    while abs(speeds[-1]) > 0.0:
        speeds.append(float(np.sign(speeds[-1]) * max(0.0, abs(speeds[-1]) - h * acceleration)))
    v = np.array(speeds)
    q = np.concatenate([[0.0], np.cumsum(0.5 * h * (v[1:] + v[:-1]))])
    return h * np.arange(len(v)), q, v


@given(st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=80), st.floats(0.2, 3.0), st.floats(0.5, 10.0))
def test_any_motion_is_within_its_bounds(draws: list[float], velocity: float, acceleration: float) -> None:
    time, q, v = profile(np.sign(draws) * np.sqrt(np.abs(draws)), velocity, acceleration)
    motion, total = joint(float(q[-1]), velocity, acceleration), float(time[-1])
    assert motion.least_durations[0] <= total + 1e-9
    for known in (None, (v[:, None], v[:, None]), (v[:, None] - 0.1, v[:, None] + 0.3)):
        lower, upper = motion.places(time[:, None], total, known)
        assert (lower[:, 0] <= q + 1e-12).all()
        assert (q <= upper[:, 0] + 1e-12).all()


def test_a_motion_that_is_just_too_short_is_excluded_by_its_own_bounds() -> None:
    motion = joint(1.0, 1.2, 3.0)
    least = float(rest_to_rest(np.ones(1), 1.2, 3.0)[0])
    time = np.linspace(0.0, 1.0, 21)[:, None]
    lower, upper = motion.places(least * time, least)
    assert (lower <= upper).all()
    lower, upper = motion.places(0.999 * least * time, 0.999 * least)
    assert (lower > upper).any()
