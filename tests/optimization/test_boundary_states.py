"""Motions with nonzero boundary velocities: control points, programs, optima.

They are compared with differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from hplan.certificate.limit_use import limit_use
from hplan.collision.compiled_field import ClearanceField
from hplan.optimization.constraint_rows import ALLOWED, TorqueUse, torque_rows
from hplan.optimization.first_order import NEAR, SCALE, MotionArrays, MotionLimits, first_order, sample_places
from hplan.optimization.minimize_time import Level, OptimizerEffort, minimize_time
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import BoundaryState, TimedSpline
from hplan.robot.limits import Limits
from hplan.scene.obstacles import Sphere

PIECES, STEP = 12, 1e-6

MOVABLE = np.array([1, 3])


def random_spline(seed, speed=1.0):
    """A spline over pieces of different durations, both ends in motion in two of the joints."""
    rng = np.random.default_rng(seed)
    breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.15, PIECES))])
    knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
    control = np.cumsum(rng.uniform(0.0, 0.05, (PIECES + 3, 4)), axis=0) + 0.3
    control[:, [0, 2]] = control[0, [0, 2]]
    some = speed * np.isin(np.arange(4), MOVABLE)
    ends = tuple(
        BoundaryState(control[end], some * rng.uniform(-1.0, 1.0, 4), some * rng.uniform(-3.0, 3.0, 4))
        for end in (0, -1)
    )
    return TimedSpline(control, knots).with_ends(ends)


def states_of(spline):
    """(2, 3, dof) position, velocity and acceleration at both ends, by scipy."""
    curve = BSpline(spline.knots, spline.control, 3)
    return np.array([[curve(at, nu=order) for order in range(3)] for at in spline.knots[[0, -1]]])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.2, 5.0))
def test_a_spline_has_the_states_of_its_ends_at_any_time_scale(seed, time_scale):
    spline = random_spline(seed)
    wanted = [[end.position, end.velocity, end.acceleration] for end in spline.ends]
    for motion in (spline, spline.at_time_scale(time_scale), spline.at_time_scale(time_scale).at_time_scale(0.7)):
        np.testing.assert_allclose(states_of(motion), wanted, rtol=0, atol=1e-9)


def moved(spline, unknowns, time_scale):
    control = np.array(spline.control)
    control[3:-3, MOVABLE] += unknowns.reshape(-1, len(MOVABLE))
    return TimedSpline(control, spline.knots, spline.ends).at_time_scale(time_scale)


def values_of(rows, unknowns, time_scale):
    """Ratio of left to right side of each constraint of a program."""
    value = np.zeros(len(rows.upper))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        value[row] = rows.entries[start:end] @ unknowns[rows.columns[start:end]]
    both = len(rows.lower)
    above = value + rows.time_scale * time_scale - rows.upper
    below = rows.time_scale[:both] * time_scale - value[:both] - rows.lower
    return above, below


def kinematic_sides(spline, limits, time_scale):
    """|V|, |A| and |J| of all control points that rest would not fix, over the limits' powers of the time scale."""
    sides = []
    for order in (1, 2, 3):
        curve, count = BSpline(spline.knots, spline.control, 3).derivative(order), len(spline.control) - order
        values = curve.c[:count] * time_scale**order / limits.rates[order - 1]
        values = values[max(0, 3 - order) : min(count, len(spline.control) - 3)][:, limits.movable]
        sides += [values - time_scale**order, -values - time_scale**order]
    return np.concatenate([side.ravel() for side in sides])


@pytest.fixture
def limits(robot):
    rates = np.stack([robot.velocity_limit, robot.acceleration_limit, robot.jerk_limit])
    return MotionLimits(np.array(robot.lower), np.array(robot.upper), rates, MOVABLE, np.empty((0, 4)))


def test_program_is_the_limits_to_first_order_in_step_and_time_scale(robot, limits):
    spline, trust = random_spline(3), 1e9
    far = ClearanceField.build(robot, [Sphere(name="far", center=(9.0, 9.0, 9.0), radius=0.1).solids[0]])
    motion = MotionArrays(np.array(spline.control), spline.knots, spline.drift)
    rows = first_order(motion, limits, far.arrays, 2e-3, trust)
    kinematic = np.concatenate(
        [rows.time_scale[: len(rows.lower)] != 0.0, np.ones(len(rows.time_scale) - len(rows.lower), dtype=bool)]
    )
    count = (PIECES - 3) * 2
    unknowns, time_scale = np.random.default_rng(4).uniform(-STEP, STEP, count), 1.0 + STEP

    def sides(of, at):
        above, below = values_of(rows, of, at)
        return np.concatenate([above[kinematic], below[kinematic[: len(below)]]])

    here, there = (
        kinematic_sides(spline, limits, 1.0),
        kinematic_sides(moved(spline, unknowns, time_scale), limits, time_scale),
    )
    assert len(sides(np.zeros(count), 1.0)) == len(here) == 2 * (3 * (PIECES + 3) - 12) * 2
    # In any order: each value, and its derivative.
    order, other = np.argsort(here), np.argsort(sides(np.zeros(count), 1.0))
    np.testing.assert_allclose(sides(np.zeros(count), 1.0)[other], here[order], atol=1e-9)
    change = (sides(unknowns, time_scale) - sides(np.zeros(count), 1.0))[other]
    np.testing.assert_allclose(change, (there - here)[order], rtol=0, atol=1e-8)


def test_clearances_follow_the_time_scale_where_an_end_is_in_motion(robot, limits):
    spline = random_spline(3)
    at = robot.tool_positions(np.array(spline.control[:1]))[0]
    field = ClearanceField.build(robot, [Sphere(name="ball", center=tuple(at + 0.1), radius=0.1).solids[0]])
    rows = first_order(
        MotionArrays(np.array(spline.control), spline.knots, spline.drift), limits, field.arrays, 2e-3, 0.1
    )
    count = (PIECES - 3) * 2
    unknowns, time_scale = np.random.default_rng(5).uniform(-1e-5, 1e-5, count), 1.0 + 1e-4
    # A step does not change the start.
    here = clearances(spline, field)
    near = (here < NEAR) & (np.arange(len(here)) >= field.count)
    change = (clearances(moved(spline, unknowns, time_scale), field) - here)[near]
    assert near[: 4 * field.count].any()  # in the first pieces
    program = values_of(rows, unknowns, time_scale)[0] - values_of(rows, 0.0 * unknowns, 1.0)[0]
    expected = -program[-np.count_nonzero(near) :] * SCALE
    np.testing.assert_allclose(change, expected, rtol=0, atol=1e-7)


def clearances(spline, field):
    piece, part = sample_places(np.array(spline.control), spline.knots, field.arrays).T
    clock = np.interp(piece + part, np.arange(PIECES + 1), spline.knots[3:-3])
    return field.clearance_along(BSpline(spline.knots, spline.control, 3)(clock)).ravel()


def test_torque_rows_follow_the_time_scale_where_an_end_is_in_motion(robot, limits):
    spline = random_spline(1, speed=0.5)
    limit = np.abs(TorqueUse.sample(spline, robot.dynamics, np.ones(4)).use).max(axis=0) + 1e-6
    use = TorqueUse.sample(spline, robot.dynamics, limit)
    rows = torque_rows(use, spline, robot.dynamics, limits)
    count = (PIECES - 3) * 2
    unknowns, time_scale = np.random.default_rng(1).uniform(-1e-5, 1e-5, count), 1.0 + 1e-5
    after = TorqueUse.sample(moved(spline, unknowns, time_scale), robot.dynamics, limit)
    times, joints = np.nonzero(np.abs(use.use) > 0.75)
    sign = np.sign(use.use[times, joints])
    gravity = sign * (robot.dynamics.gravity(use.states[0]) / limit)[times, joints]
    before, later = (sign * found.use[times, joints] - np.maximum(ALLOWED, gravity + 0.05) for found in (use, after))
    actual = time_scale**2 * later - before
    program = values_of(rows, unknowns, time_scale)[0] - values_of(rows, 0.0 * unknowns, 1.0)[0]
    np.testing.assert_allclose(program, actual, rtol=0, atol=5e-7)
    assert (times < 4).any() or (times > 2 * PIECES - 4).any()


def swing(duration):
    """From rest to rest."""

    class Swing:
        def positions(self, clock):
            t = np.clip(np.asarray(clock) / duration, 0.0, 1.0)
            return START + np.outer(t**3 * (10.0 - 15.0 * t + 6.0 * t**2), TURN)

    found = Swing()
    found.duration = duration
    return found


START, TURN = np.array([0.1, 0.6, 0.7, 0.5]), np.array([0.0, 0.5, 0.4, -0.2])

EFFORT = OptimizerEffort((Level(piece_s=0.03, pieces=(30, 60), steps=12, gain=1e-3, trust=0.2),))


def fastest(robot, ends, limits=None, effort=None):
    far = ClearanceField.build(robot, [Sphere(name="far", center=(9.0, 9.0, 9.0), radius=0.1).solids[0]])
    limits = limits or Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    options = PostprocessOptions(
        lower=robot.lower, upper=robot.upper, velocity=robot.velocity_limit, acceleration=robot.acceleration_limit,
        movable=np.arange(1, 4), margin=2e-3,
    )  # fmt: skip
    problem = TimeProblem(far, far, options, limits, robot.dynamics, 250.0, ends)
    return minimize_time(swing(1.5), problem, effort or EFFORT)


def assert_kept(robot, motion, ends):
    """Check samples between the states, segments at samples, and limits at all times."""
    rows = motion.trajectory(robot.dynamics, 250.0)
    for row, state in ((0, ends[0]), (-1, ends[1])):
        for name in ("position", "velocity", "acceleration"):
            np.testing.assert_allclose(getattr(rows, name)[row], getattr(state, name), rtol=0, atol=1e-12)
    breaks = motion.knots[3:-3] * 250.0
    np.testing.assert_allclose(breaks, np.round(breaks), atol=1e-9)
    use = limit_use(robot, rows, *rows.segments)
    assert max(use.velocity, use.acceleration, use.torque) <= 1.0 + 1e-5
    assert (np.abs(np.diff(rows.acceleration, axis=0)) * 250.0 <= robot.jerk_limit * (1.0 + 1e-5)).all()
    return rows


def test_fastest_motion_between_states(robot):
    rest = BoundaryState.at_rest(START), BoundaryState.at_rest(START + TURN)
    fast = tuple(BoundaryState(end.position, 0.8 * TURN, a * TURN) for end, a in zip(rest, (2.0, -2.0), strict=True))
    back = tuple(BoundaryState(end.position, -0.8 * TURN, 0.0 * TURN) for end in rest)
    durations = [assert_kept(robot, fastest(robot, ends), ends).duration for ends in (rest, fast, back)]
    assert durations[1] < durations[0] - 0.2
    assert durations[2] > durations[0]
    # The motion backwards takes as long.
    there = tuple(BoundaryState(end.position, end.velocity, end.acceleration) for end in (fast[0], rest[1]))
    mirrored = tuple(
        BoundaryState(START + TURN - (end.position - START), end.velocity, -end.acceleration) for end in there[::-1]
    )
    one, other = (assert_kept(robot, fastest(robot, ends), ends).duration for ends in (there, mirrored))
    assert one == pytest.approx(other, abs=0.009)
    # States at rest give the motion from rest to rest.
    known = fastest(robot, None)
    assert abs(known.duration - durations[0]) <= 0.004 + 1e-9
    # Without ends the outer control points are equal to the last bit.
    assert (known.control[:3] == known.control[0]).all()


def test_state_beyond_the_limits_has_no_motion(robot):
    rest = BoundaryState.at_rest(START)
    fast = BoundaryState(START + TURN, 4.0 * TURN, 0.0 * TURN)
    assert fastest(robot, (rest, fast)) is None


def test_brief_level_solves_few_programs_and_keeps_the_limits(robot, monkeypatch):
    rest = BoundaryState.at_rest(START), BoundaryState.at_rest(START + TURN)
    fast = BoundaryState(START, 0.8 * TURN, 2.0 * TURN)
    counts, durations = [], []
    solve = TimeProblem.solve
    monkeypatch.setattr(TimeProblem, "solve", lambda *given, **more: counts.append(1) or solve(*given, **more))
    for is_brief in (False, True):
        counts.clear()
        effort = OptimizerEffort((replace(EFFORT.levels[-1], gain=0.06, is_brief=is_brief),))
        rows = assert_kept(robot, fastest(robot, (fast, rest[1]), effort=effort), (fast, rest[1]))
        durations.append((rows.duration, len(counts)))
    (whole_s, programs), (brief_s, fewer) = durations
    assert fewer < programs
    assert brief_s <= 1.02 * whole_s
