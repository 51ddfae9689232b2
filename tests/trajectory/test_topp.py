"""Both passes compiled against toppra's own, stage by stage in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import toppra
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from toppra import algorithm, constraint

from hplan.errors import TimingError
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import Limits
from hplan.trajectory import topp
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.topp import Passes, fastest_speed


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit)


@pytest.fixture(scope="module")
def dynamics(robot):
    return InverseDynamics.of(robot.model)


class Compared:
    """In place of `Passes`: runs toppra's own as well, and compares."""

    def __init__(self, constraints, path, gridpoints):
        self.compiled = Passes(constraints, path, gridpoints=gridpoints)
        self.reference = algorithm.TOPPRA(constraints, path, gridpoints=gridpoints, solver_wrapper="seidel")
        self.problem_data = self.compiled.problem_data

    def compute_parameterization(self, start, end):
        found = self.compiled.compute_parameterization(start, end, return_data=True)
        expected = self.reference.compute_parameterization(start, end, return_data=True)
        outcomes.append((self.compiled.problem_data.return_code.name, self.reference.problem_data.return_code.name))
        if expected[1] is None:
            assert_kept(self.compiled, found)
        else:
            assert_same(found, expected)
            data, like = self.compiled.problem_data, self.reference.problem_data
            np.testing.assert_array_equal(data.sd_vec, found[1])
            np.testing.assert_array_equal(data.K, found[3])
            np.testing.assert_array_equal(data.gridpoints, like.gridpoints)
        return found[:3]


outcomes: list[tuple[str, str]] = []


def assert_same(found, expected):
    """The sets to rounding; speeds to toppra's tolerance of half-planes (1e-10), which it may use up or not."""
    for got, like in zip(found, expected, strict=True):
        assert got.shape == like.shape
    peak = expected[1].max()
    np.testing.assert_allclose(found[3], expected[3], rtol=1e-9, atol=1e-12 * peak**2)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-9, atol=1e-9 * peak)


def assert_kept(instance, found):
    """Where toppra gives up for rounding there may be a motion; it is one if every half-plane is kept."""
    u, speed = found[:2]
    if speed is None:
        return
    x = speed**2
    for given_ in instance.constraints:
        a, b, c, faces, offsets, _, bound = given_.compute_constraint_params(instance.path, instance.gridpoints)
        if a is not None:
            use = (a[:-1] * u[:, None] + b[:-1] * x[:-1, None] + c[:-1]) @ faces.T - offsets
            assert (use <= 1e-6 * np.abs(offsets) + 1e-9).all()
        else:
            assert (x <= bound[:, 1] * (1 + 1e-9)).all()
    assert np.abs(np.diff(x) - 2.0 * np.diff(instance.gridpoints) * u).max() <= 1e-3 * x.max()


@pytest.fixture
def compared(monkeypatch):
    monkeypatch.setattr(topp, "Passes", Compared)
    outcomes.clear()


def timed(*arguments):
    """The speed and "Ok", or None and the cause."""
    try:
        return fastest_speed(*arguments), "Ok"
    except TimingError as error:
        return None, error.cause


def spline(rng, span, locked):
    control = 0.8 + rng.uniform(-0.7, 0.7, 4) + span * rng.uniform(-0.7, 0.7, (int(rng.integers(4, 12)), 4))
    if locked is not None:
        control[:, locked] = 0.3
    return SplinePath.through(control)


def cosine(end, points):
    grid = 0.5 * end * (1.0 - np.cos(np.linspace(0.0, np.pi, points)))
    grid[-1] = end
    return grid


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    span=st.sampled_from([1.0, 1.0, 0.3, 1e-2, 1e-4, 1e-6]),
    locked=st.sampled_from([None, None, 0, 2]),
    torque=st.sampled_from([None, 0.97, 1.01, 1.3, 10.0]),
    faster=st.sampled_from([0.1, 1.0, 10.0]),
    rates=st.sampled_from([(0.0, 0.0), (0.0, 0.0), (0.1, 0.3), (1.0, 0.0), (0.0, 2.0), (30.0, 0.0)]),
    points=st.integers(10, 400),
)
def test_random_paths(compared, dynamics, limits, seed, span, locked, torque, faster, rates, points):
    rng = np.random.default_rng(seed)
    path = spline(rng, span, locked)
    static = np.abs(dynamics.gravity(path.evaluate(np.linspace(0.0, path.end, 200)))).max(axis=0)
    kept = Limits(
        limits.velocity, faster * limits.acceleration, None if torque is None else np.maximum(torque * static, 3.0)
    )
    speed, cause = timed(path, dynamics, kept, cosine(path.end, points), np.array(rates))
    assert cause == outcomes[-1][0]
    if speed is None:
        assert outcomes[-1][1] != "Ok"
    else:
        assert speed.shape == (points,)
        np.testing.assert_allclose(speed[[0, -1]], rates, atol=1e-6)


def test_outcomes_of_many_paths(compared, dynamics, limits):
    """What toppra times is timed, what it cannot time for its limits neither; rounding aside."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        path = spline(rng, rng.choice([1.0, 1e-5]), None)
        kept = replace(limits, torque=rng.uniform(0.2, 1.0) * limits.torque)
        rates = rng.choice([0.0, 0.0, 0.5, 50.0], 2)
        _, cause = timed(path, dynamics, kept, cosine(path.end, 60), rates)
        assert cause == outcomes[-1][0]
    assert ("Ok", "Ok") in outcomes
    assert ("FailUncontrollable", "FailUncontrollable") in outcomes
    assert not [pair for pair in outcomes if pair[1] == "Ok" != pair[0]]


def test_constraints_of_toppra_itself():
    """Interpolated ones, whose faces differ from point to point, and bounds of u."""

    class Push(constraint.LinearConstraint):
        def compute_constraint_params(self, path, gridpoints):
            bound = np.tile([-0.9, 0.7], (len(gridpoints), 1))
            return None, None, None, None, None, bound, None

    rng = np.random.default_rng(6)
    path = toppra.SplineInterpolator(np.linspace(0.0, 1.0, 6), rng.normal(size=(6, 3)))
    both = constraint.DiscretizationType.Interpolation

    def varying(s):
        return np.array([[-1.0 - s, 2.0], [-2.0, 1.0 + s], [-3.0, 3.0]])

    constraints = [
        constraint.JointVelocityConstraintVarying(varying),
        constraint.JointAccelerationConstraint([5.0, 6.0, 7.0], discretization_scheme=both),
        constraint.SecondOrderConstraint(
            lambda q, v, a: a + 0.1 * v**2, lambda q: np.eye(3), lambda q: np.full(3, 9.0 + 0.1 * q[0]), dof=3
        ),
    ]
    for given_ in (constraints, [*constraints, Push()]):
        instance = Compared(given_, path, np.linspace(0.0, 1.0, 90))
        assert instance.compute_parameterization(0.0, 0.0)[1].max() > 0.05
        assert outcomes[-1] == ("Ok", "Ok")


@pytest.mark.parametrize(
    ("a", "c"), [(0.0, (1.0, 0.0)), (1.0, (1.0, 1.0)), (1.0, (2.0, -1.0)), (1.0, (0.0, np.nan)), (np.nan, (0.0, 0.0))]
)
@pytest.mark.parametrize("rows", [slice(None), slice(5, 6)])
def test_half_planes_without_a_point(a, c, rows):
    """a u + c <= 0 and -a u + c <= 0, everywhere or at one point."""

    class Impossible(constraint.LinearConstraint):
        def compute_constraint_params(self, path, gridpoints):
            count = len(gridpoints)
            turns, rest = np.zeros((count, 2)), np.full((count, 2), -1.0)
            turns[rows], rest[rows] = (a, -a), c
            return turns, 0.0 * rest, rest, np.tile(np.eye(2), (count, 1, 1)), np.zeros((count, 2)), None, None

    path = toppra.SplineInterpolator([0.0, 1.0], np.array([[0.0], [1.0]]))
    bounds = constraint.JointVelocityConstraint([1.0]), constraint.JointAccelerationConstraint([1.0])
    instance = Passes([*bounds, Impossible()], path, gridpoints=np.linspace(0.0, 1.0, 20))
    u, speed, rest, sets = instance.compute_parameterization(0.0, 0.0, return_data=True)
    assert (u, speed, rest) == (None, None, None)
    assert np.isnan(sets[0]).any()
    assert instance.problem_data.return_code.name == "FailUncontrollable"


def test_start_beyond_its_set(dynamics, limits):
    path = SplinePath.through(np.linspace(np.zeros(4), np.full(4, 0.5), 5))
    grid = cosine(path.end, 50)
    with pytest.raises(TimingError) as caught:
        fastest_speed(path, dynamics, limits, grid, np.array([100.0, 0.0]))
    assert caught.value.cause == "FailUncontrollable"
    assert "toppra" in caught.value.message
