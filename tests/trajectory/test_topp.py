"""Both passes compiled against toppra's own, stage by stage in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toppra
from hypothesis import given, settings
from hypothesis import strategies as st
from toppra import algorithm, constraint

from hplan.errors import TimingError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import Limits
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.topp import PathView, fastest_speed, half_planes, passes


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit)


@pytest.fixture(scope="module")
def dynamics(robot):
    return InverseDynamics.of(robot.model)


class HalfPlanes(constraint.LinearConstraint):
    """Half-planes as one of toppra's own constraints: the bounds of x, and all others."""

    def __init__(self, rows):
        super().__init__()
        self.rows = rows

    def compute_constraint_params(self, path, gridpoints):
        bounds = self.rows[:, 2:4, 2] * (1.0, -1.0)
        a, b, c = np.moveaxis(self.rows[:, 6:], 2, 0)
        faces = np.tile(np.eye(a.shape[1]), (len(a), 1, 1))
        return a, b, c, faces, np.zeros(a.shape), None, bounds


def toppras(rows, grid, rates):
    """Speeds, accelerations and sets by toppra's own algorithm, None where it finds none; its return code."""
    line = toppra.SplineInterpolator(grid[[0, -1]], np.array([[0.0], [1.0]]))
    own = algorithm.TOPPRA([HalfPlanes(rows)], line, gridpoints=grid, solver_wrapper="seidel")
    u, speed, _, sets = own.compute_parameterization(*rates, return_data=True)
    return None if speed is None else (speed, u, sets), own.problem_data.return_code.name


def compared(rows, grid, rates):
    """The code of both, which agree: the sets to rounding, speeds to toppra's tolerance of half-planes (1e-10)."""
    expected, code = toppras(rows.copy(), grid, rates)
    try:
        found = passes(rows, np.diff(grid), rates)
    except TimingError as error:
        assert expected is None
        return error.cause, code
    if expected is None:
        # Where toppra gives up for rounding there may be a motion; it is one if every half-plane is kept.
        speed, u, _ = found
        a, b, c = np.moveaxis(rows[:-1, 6:], 2, 0)
        use = a * u[:, None] + b * speed[:-1, None] ** 2 + c
        assert (use <= 1e-6 * np.abs(c) + 1e-9).all()
        return "Ok", code
    peak = expected[0].max()
    np.testing.assert_allclose(found[2], expected[2], rtol=1e-9, atol=1e-12 * peak**2)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-9, atol=1e-9 * peak)
    return "Ok", code


def spline(rng, span, locked):
    control = 0.8 + rng.uniform(-0.7, 0.7, 4) + span * rng.uniform(-0.7, 0.7, (int(rng.integers(4, 12)), 4))
    if locked is not None:
        control[:, locked] = 0.3
    return SplinePath.through(control)


def cosine(end, points):
    grid = 0.5 * end * (1.0 - np.cos(np.linspace(0.0, np.pi, points)))
    grid[-1] = end
    return grid


@settings(max_examples=80)
@given(
    seed=st.integers(0, 10**6),
    span=st.sampled_from([1.0, 1.0, 0.3, 1e-2]),
    locked=st.sampled_from([None, None, 0, 2]),
    torque=st.sampled_from([None, 0.97, 1.01, 1.3, 10.0]),
    faster=st.sampled_from([0.1, 1.0, 10.0]),
    rates=st.sampled_from([(0.0, 0.0), (0.0, 0.0), (0.1, 0.3), (1.0, 0.0), (0.0, 2.0), (30.0, 0.0)]),
    points=st.integers(10, 400),
)
def test_passes_are_toppras(dynamics, limits, seed, span, locked, torque, faster, rates, points):
    path = spline(np.random.default_rng(seed), span, locked)
    static = np.abs(dynamics.gravity(path.evaluate(np.linspace(0.0, path.end, 200)))).max(axis=0)
    most = None if torque is None else np.maximum(torque * static, 3.0)
    kept, grid = Limits(limits.velocity, faster * limits.acceleration, most), cosine(path.end, points)
    rows = half_planes(PathView(path, 4, 1.0), dynamics, kept, grid)
    ours, own = compared(rows, grid, np.array(rates))
    assert ours == own or own != "Ok"


def test_outcomes_of_many_paths(dynamics, limits):
    """What toppra times is timed, what it cannot time for its limits neither."""
    rng, outcomes = np.random.default_rng(4), set()
    for _ in range(60):
        path, rates = spline(rng, 1.0, None), rng.choice([0.0, 0.0, 0.5, 50.0], 2)
        kept, grid = replace(limits, torque=rng.uniform(0.2, 1.0) * limits.torque), cosine(path.end, 60)
        outcomes.add(compared(half_planes(PathView(path, 4, 1.0), dynamics, kept, grid), grid, rates))
    assert outcomes >= {("Ok", "Ok"), ("FailUncontrollable", "FailUncontrollable")}


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), span=st.sampled_from([1.0, 1e-2, 1e-4, 1e-6]))
def test_speeds_use_a_limit_and_pass_none(dynamics, limits, seed, span):
    """At the middles of the grid's intervals, whatever the length of the path."""
    path = spline(np.random.default_rng(seed), span, None)
    grid = cosine(path.end, 300)
    speed = fastest_speed(path, dynamics, limits, grid)
    push = 0.5 * np.diff(speed**2) / np.diff(grid)
    square, middle = 0.5 * (speed[1:] ** 2 + speed[:-1] ** 2), 0.5 * (grid[1:] + grid[:-1])
    first, second = path.evaluate(middle, 1), path.evaluate(middle, 2)
    acceleration = first * push[:, None] + second * square[:, None]
    torque = dynamics.torques(path.evaluate(middle), first * np.sqrt(square)[:, None], acceleration)
    velocity = path.evaluate(grid, 1) * speed[:, None]
    use = [(np.abs(velocity) / limits.velocity)[:-1], np.abs(acceleration) / limits.acceleration]
    use.append(np.abs(torque) / limits.torque)
    largest = np.max(use, axis=(0, 2))
    assert largest.max() < 1.01
    assert np.median(largest) > 0.95


@pytest.mark.parametrize(
    ("a", "c"), [(0.0, (1.0, 0.0)), (1.0, (1.0, 1.0)), (1.0, (2.0, -1.0)), (1.0, (0.0, np.nan)), (np.nan, (0.0, 0.0))]
)
@pytest.mark.parametrize("at", [slice(None), slice(5, 6)])
def test_half_planes_without_a_point(dynamics, limits, a, c, at):
    """a u + c <= 0 and -a u + c <= 0, everywhere or at one point."""
    path = SplinePath.through(np.linspace(np.zeros(4), np.full(4, 0.5), 5))
    grid = cosine(path.end, 20)
    rows = half_planes(PathView(path, 4, 1.0), dynamics, limits, grid)
    rows[at, 6:8, 0], rows[at, 6:8, 1], rows[at, 6:8, 2] = (a, -a), 0.0, c
    with pytest.raises(TimingError) as caught:
        passes(rows, np.diff(grid), np.zeros(2))
    assert caught.value.cause == "FailUncontrollable"
