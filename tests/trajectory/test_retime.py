"""Timed motions against their limits, at rows and between them, and against motions timed by hand."""

from __future__ import annotations

import time
import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planned import on_cubics

from hplan.errors import OptionError, TimingError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.trajectory import rounded_path
from hplan.trajectory.retime import GRID_POINTS, time_path
from hplan.trajectory.speed_profile import parameter_grid
from hplan.trajectory.spline import SplinePath

RATE = 250.0
FINE = 1e-4

START, GOAL = np.array([0.1, 0.2, 0.3, 0.2]), np.array([0.4, 1.2, 0.8, 1.0])


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)


@pytest.fixture(scope="module")
def smooth_limits(limits):
    """Without limits on jerk."""
    return replace(limits, jerk=None)


@pytest.fixture(scope="module")
def reference_path(robot, scene):
    return SplinePath.through(plan(robot, scene, PlanOptions(effort="quick")).trajectory.position[::40])


def straight(start, end, count=5):
    return SplinePath.through(np.linspace(start, end, count))


def curve(seed, robot, count=7, share=0.8):
    """A random spline within the joint limits."""
    rng = np.random.default_rng(seed)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * share * (robot.upper - robot.lower)
    half[0] = min(half[0], 1.0)
    return SplinePath.through(middle + rng.uniform(-half, half, (count, robot.dof)))


def joint_turn(robot, joint, angle, start=0.1):
    q = np.full(robot.dof, start)
    end = q.copy()
    end[joint] += angle
    return straight(q, end)


def hermite(trajectory, step=FINE):
    """Time and position of the cubic Hermite curve through the rows, every `step` seconds."""
    time = np.arange(0.0, trajectory.duration + 0.5 * step, step)
    return on_cubics(trajectory, time)


def inverse_dynamics(model, q, v, a):
    data = model.createData()
    return np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def row_uses(trajectory, limits):
    """(rows,) largest share of any limit, jerk between rows included where it is limited."""
    shares = [np.abs(trajectory.velocity) / limits.velocity, np.abs(trajectory.acceleration) / limits.acceleration]
    if limits.torque is not None:
        shares.append(np.abs(trajectory.torque) / limits.torque)
    use = np.max(shares, axis=(0, 2))
    if limits.jerk is not None:
        jerk = jerk_uses(trajectory, limits)
        use = np.maximum(use, np.maximum(np.append(jerk, 0.0), np.append(0.0, jerk)))
    return use


def jerk_uses(trajectory, limits):
    """(rows - 1,) share of the jerk limit; between rows acceleration is linear."""
    step = np.diff(trajectory.time)[:, None]
    return (np.abs(np.diff(trajectory.acceleration, axis=0)) / step / limits.jerk).max(axis=1)


def assert_sound(trajectory, model, limits, *, rate=RATE, path=None, jerk=True):
    """Uniform time, rest, exact ends, columns that belong together, limits at rows and between."""
    steps = np.diff(trajectory.time)
    assert trajectory.time[0] == 0.0
    assert (steps > 0.0).all()
    np.testing.assert_allclose(trajectory.time, np.arange(trajectory.samples) / rate, rtol=1e-12)
    for row, s in ((0, 0.0), (-1, None)):
        assert not trajectory.velocity[row].any()
        assert not trajectory.acceleration[row].any()
        if path is not None:
            np.testing.assert_array_equal(trajectory.position[row], path.evaluate(path.breaks[-1] if s is None else s))
    torque = inverse_dynamics(model, trajectory.position, trajectory.velocity, trajectory.acceleration)
    np.testing.assert_allclose(trajectory.torque, torque, atol=1e-9)
    assert (np.abs(trajectory.velocity) <= 1.001 * limits.velocity + 1e-12).all()
    assert (np.abs(trajectory.acceleration) <= 1.001 * limits.acceleration + 1e-12).all()
    if limits.torque is not None:
        assert (np.abs(torque) <= 1.001 * limits.torque + 1e-12).all()
    if jerk and limits.jerk is not None:
        assert jerk_uses(trajectory, limits).max(initial=0.0) <= 1.001
    if trajectory.samples < 3:
        return
    # The rows are one cubic spline: acceleration by position and velocity of two rows is that of the column.
    h, q, w = 1.0 / rate, np.diff(trajectory.position, axis=0), trajectory.velocity
    noise = 5e-12 / h**2 * (1.0 + np.abs(trajectory.position).max()) + 1e-7
    np.testing.assert_allclose(6 * q / h**2 - (4 * w[:-1] + 2 * w[1:]) / h, trajectory.acceleration[:-1], atol=noise)
    np.testing.assert_allclose((2 * w[:-1] + 4 * w[1:]) / h - 6 * q / h**2, trajectory.acceleration[1:], atol=noise)
    # As a controller will interpolate it.
    step = min(FINE, 0.1 / rate)
    q = hermite(trajectory, step)[:200_000]
    v, a = np.diff(q, axis=0) / step, np.diff(q, 2, axis=0) / step**2
    noise = 8 * np.finfo(float).eps * np.abs(q).max()
    assert (np.abs(v) <= 1.001 * limits.velocity + noise / step).all()
    assert (np.abs(a) <= 1.001 * limits.acceleration + noise / step**2).all()
    if limits.torque is not None:
        keep = slice(None, None, max(1, len(a) // 2000))
        torque = inverse_dynamics(model, q[1:-1][keep], 0.5 * (v[1:] + v[:-1])[keep], a[keep])
        assert (np.abs(torque) <= 1.001 * limits.torque + 1e-6).all()


# Limits


@pytest.mark.parametrize("jerk", [False, True])
def test_reference_motion(robot, limits, smooth_limits, reference_path, jerk):
    kept = limits if jerk else smooth_limits
    trajectory = time_path(reference_path, robot.model, kept)
    assert_sound(trajectory, robot.model, kept, path=reference_path)
    assert (trajectory.position >= robot.lower - 1e-12).all()
    assert (trajectory.position <= robot.upper + 1e-12).all()
    assert (trajectory.position[:, 0] == trajectory.position[0, 0]).all()


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10**6), st.integers(4, 12), st.sampled_from([60.0, 250.0, 1000.0]), st.booleans())
def test_random_motions_keep_their_limits(robot, limits, smooth_limits, seed, count, rate, with_jerk):
    path = curve(seed, robot, count)
    kept = limits if with_jerk else smooth_limits
    trajectory = time_path(path, robot.model, kept, rate_hz=rate)
    assert_sound(trajectory, robot.model, kept, rate=rate, path=path, jerk=False)


@pytest.mark.parametrize("rate", [60.0, 250.0, 1000.0])
def test_jerk_of_random_motions(robot, limits, rate):
    uses = [
        jerk_uses(time_path(curve(s, robot, 8), robot.model, limits, rate_hz=rate), limits).max() for s in range(12)
    ]
    assert max(uses) <= 1.001


def test_tight_torque_slows_the_motion_and_is_kept(robot, smooth_limits):
    path = straight(START, GOAL)
    data = robot.model.createData()
    static = np.abs(
        [pin.computeGeneralizedGravity(robot.model, data, q) for q in path.evaluate(np.linspace(0, path.end, 400))]
    ).max(axis=0)
    durations = []
    for share in (1.003, 1.03, 1.3, 3.0):
        kept = replace(smooth_limits, torque=np.maximum(share * static, 5.0))
        trajectory = time_path(path, robot.model, kept)
        assert_sound(trajectory, robot.model, kept, path=path)
        durations.append(trajectory.duration)
    assert durations == sorted(durations, reverse=True)
    assert durations[0] > 1.5 * durations[-1]
    without = time_path(path, robot.model, replace(smooth_limits, torque=None))
    assert without.duration <= durations[-1] + 1e-9


def torque_bound(robot, smooth_limits, path, share):
    """Limits where torque, a share beyond what gravity takes, is what binds."""
    data = robot.model.createData()
    static = [
        np.abs(pin.computeGeneralizedGravity(robot.model, data, q))
        for q in path.evaluate(np.linspace(0, path.end, 400))
    ]
    return Limits(
        2.0 * smooth_limits.velocity, 10.0 * smooth_limits.acceleration, np.maximum(share * np.max(static, axis=0), 3.0)
    )


@pytest.mark.parametrize("rate", [10.0, 25.0, 50.0])
def test_torque_of_motions_bound_by_it(robot, smooth_limits, rate):
    for seed in range(4):
        path = curve(seed, robot)
        kept = torque_bound(robot, smooth_limits, path, 1.3)
        assert_sound(time_path(path, robot.model, kept, rate_hz=rate), robot.model, kept, rate=rate, path=path)


def test_rows_are_near_the_path(robot, limits):
    path = curve(3, robot)
    fine = path.evaluate(np.linspace(0.0, path.end, 20001))
    trajectory = time_path(path, robot.model, limits)
    off = max(np.abs(fine - q).max(axis=1).min() for q in trajectory.position)
    window = 2.0 * (limits.acceleration / limits.jerk).max() + 2.0 / RATE
    assert off <= limits.acceleration.max() * window**2 / 24.0


@pytest.mark.parametrize("seed", [2, 7])
def test_little_is_lost_with_few_points(robot, smooth_limits, seed):
    """What passes a limit between two of few points is remedied there: it does not slow the whole motion."""
    path = curve(seed, robot)
    few, many = (
        time_path(path, robot.model, smooth_limits, grid=parameter_grid(path, points)) for points in (GRID_POINTS, 3200)
    )
    assert few.duration <= 1.015 * many.duration
    assert np.median(row_uses(few, smooth_limits)) >= 0.9


# Durations by hand


@pytest.mark.parametrize("with_jerk", [False, True])
@pytest.mark.parametrize("angle", [-1.2, 0.01, 0.1, 0.47, 1.3])
@pytest.mark.parametrize("joint", [0, 1, 3])
def test_duration_of_a_single_joint(robot, limits, smooth_limits, joint, angle, with_jerk):
    kept = replace(limits if with_jerk else smooth_limits, torque=None)
    v, a = kept.velocity[joint], kept.acceleration[joint]
    turn = abs(angle)
    fastest = 2.0 * np.sqrt(turn / a) if turn <= v * v / a else turn / v + v / a
    allowed = 4.0 / RATE + (2.0 * a / kept.jerk[joint] if with_jerk else 0.0)
    path = joint_turn(robot, joint, angle, start=1.3 if angle < 0 else 0.1)
    duration = time_path(path, robot.model, kept).duration
    assert fastest * (1 - 1e-3) <= duration <= fastest * (1 + 1e-3) + allowed


def test_share_of_the_speed(robot, limits, smooth_limits):
    path = curve(5, robot)
    free = replace(smooth_limits, torque=None)
    full = time_path(path, robot.model, free).duration
    for share in (0.5, 0.1):
        slow = free.scaled(share)
        trajectory = time_path(path, robot.model, slow)
        assert_sound(trajectory, robot.model, slow, path=path)
        assert trajectory.duration == pytest.approx(full / share, rel=0.02)
    half = limits.scaled(0.5)
    np.testing.assert_array_equal(half.velocity, 0.5 * limits.velocity)
    np.testing.assert_array_equal(half.acceleration, 0.25 * limits.acceleration)
    np.testing.assert_array_equal(half.jerk, 0.125 * limits.jerk)
    np.testing.assert_array_equal(half.torque, limits.torque)
    assert smooth_limits.scaled(1.0).jerk is None
    assert free.scaled(0.3).torque is None


@pytest.mark.parametrize(("where", "share"), [("begin", (0.0, 0.0, 0.0, 1.0)), ("end", (0.0, 3.0, -3.0, 1.0))])
def test_a_path_whose_parameter_stands_still_is_refused(robot, limits, where, share):
    """As that of an optimised motion, which begins and ends at rest."""

    class Path:
        breaks = np.array([0.0, 1.0])

        def evaluate(self, s, derivative=0):
            part = np.polynomial.Polynomial(share).deriv(derivative)(np.asarray(s))
            return START * (derivative == 0) + np.multiply.outer(part, GOAL - START)

    with pytest.raises(TimingError, match=f"stands still at its {where}"):
        time_path(Path(), robot.model, limits)


# Small, closed and awkward motions


@pytest.mark.parametrize("angle", [2e-7, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("joint", [1, 3])
def test_tiny_motion(robot, limits, joint, angle):
    path = joint_turn(robot, joint, angle)
    trajectory = time_path(path, robot.model, limits)
    assert_sound(trajectory, robot.model, limits, path=path)
    assert 0.0 < trajectory.duration < 0.05


def there_and_back():
    out = np.linspace(START, GOAL, 7)
    return np.vstack([out, out[-2::-1]])


def with_twins(count, spread=0.0):
    rng = np.random.default_rng(1)
    middle = 0.5 * (START + GOAL) + np.array([0.0, 0.2, 0.0, 0.0])
    twins = middle + spread * rng.normal(size=(count, 4))
    return np.vstack([START, twins, GOAL - [0.0, 0.3, 0.0, 0.1], GOAL])


AWKWARD = {
    "twin control points": partial(with_twins, 2),
    "three equal control points": partial(with_twins, 3),
    "nearly equal control points": partial(with_twins, 2, 1e-6),
    "there and back": there_and_back,
    "many control points": lambda: np.linspace(START, GOAL, 90) + 1e-3 * np.random.default_rng(2).normal(size=(90, 4)),
    "a crooked step at the end": lambda: np.vstack([np.linspace(START, GOAL, 8), GOAL + np.array([1e-3, 0, -1e-3, 0])]),
    "steps of very different size": lambda: (
        START + np.cumsum(0.3 * np.logspace(-4, 0, 8)[:, None] * np.random.default_rng(3).normal(size=(8, 4)), axis=0)
    ),
}


@pytest.mark.parametrize("case", AWKWARD)
def test_awkward_paths(robot, smooth_limits, case):
    path = SplinePath.through(AWKWARD[case]())
    trajectory = time_path(path, robot.model, smooth_limits)
    assert_sound(trajectory, robot.model, smooth_limits, path=path)
    assert trajectory.duration < 12.0


# Rates and robots


@pytest.mark.parametrize("rate", [1.0, 20.0, 5000.0])
@pytest.mark.parametrize("with_jerk", [False, True])
def test_rates(robot, limits, smooth_limits, rate, with_jerk):
    kept = limits if with_jerk else smooth_limits
    path = straight(START, GOAL)
    trajectory = time_path(path, robot.model, kept, rate_hz=rate)
    assert_sound(trajectory, robot.model, kept, rate=rate, path=path, jerk=rate < 1000.0)
    fastest = time_path(path, robot.model, smooth_limits, rate_hz=2000.0).duration
    window = 2.0 * (limits.acceleration / limits.jerk).max() if with_jerk else 0.0
    assert fastest * (1 - 5e-3) <= trajectory.duration <= fastest * (1 + 5e-3) + 4.0 / rate + window


def test_motions_of_too_many_rows_are_refused_before_they_are_made(robot, scene):
    """A thousandth of full speed: half an hour, 450,000 rows."""
    begin = time.process_time()
    tracemalloc.start()
    with pytest.raises(OptionError, match=r"lasts 1\d\d\d s and would have 4\d\d,\d\d\d") as error:
        plan(robot, scene, PlanOptions(speed=1e-3))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert error.value.data["option"] == "rate_hz"
    assert peak < 2e8
    assert time.process_time() - begin < 100.0  # seconds, kernels compiled in it
    with pytest.raises(OptionError, match="rows"):
        plan(robot, scene, PlanOptions(speed=1e-9))


def test_a_sharp_bend_does_not_slow_the_whole_motion(robot: Robot) -> None:
    """A corner rounded within 1e-4 rad: what grid points about it miss must not cost the rest of the motion."""
    corner = np.array([[0.0, 0.2, 0.2, 0.2], [0.0, 0.9, 0.2, 0.9], [0.0, 0.9, 0.9, 0.9]])
    path = rounded_path(corner, 1e-4)
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    trajectory = time_path(path, robot.dynamics, limits)
    parts = [rounded_path(corner[:2], 1e-4), rounded_path(corner[1:], 1e-4)]
    apart = sum(time_path(part, robot.dynamics, limits).duration for part in parts)
    assert trajectory.duration <= 1.02 * apart
    assert (np.abs(trajectory.velocity) <= robot.velocity_limit * (1.0 + 1e-3)).all()
    assert (np.abs(trajectory.acceleration) <= robot.acceleration_limit * (1.0 + 1e-3)).all()
