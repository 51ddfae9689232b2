"""Rows of a step's program against differences of the spline itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hplan.collision.clearance_field import ClearanceField
from hplan.optimization.first_order import (
    NEAR,
    PLACES,
    SCALE,
    MotionArrays,
    MotionLimits,
    basis,
    first_order,
    least_time_scale,
)
from hplan.scene.obstacles import Sphere

PIECES, MARGIN, TRUST = 12, 2e-3, 0.1


@pytest.fixture
def limits(robot):
    rates = np.stack([robot.velocity_limit, robot.acceleration_limit, robot.jerk_limit])
    return MotionLimits(np.array(robot.lower), np.array(robot.upper), rates, np.array([1, 3]), np.empty((0, 4)))


@pytest.fixture
def motion():
    rng = np.random.default_rng(3)
    breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.15, PIECES))])
    knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
    control = np.cumsum(rng.uniform(0.0, 0.05, (PIECES + 3, 4)), axis=0) + 0.3
    control[:3], control[-3:] = control[2], control[-3]
    control[:, [0, 2]] = control[0, [0, 2]]
    return control, knots


def at_rest(control, knots):
    return MotionArrays(control, knots, np.zeros_like(control))


def dense(rows, count):
    matrix = np.zeros((len(rows.upper), count + 1))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        np.add.at(matrix[row], rows.columns[start:end], rows.entries[start:end])
    matrix[:, -1] = rows.time_scale
    return matrix


def field_of(robot, radius=0.1):
    return ClearanceField.of(robot, [Sphere(name="ball", center=(1.0, 0.35, 1.35), radius=radius).solids[0]])


def moved(control, unknowns, movable):
    result = control.copy()
    result[3:-3, movable] += unknowns.reshape(-1, len(movable))
    return result


def test_basis_is_that_of_the_b_spline(motion):
    _, knots = motion
    weight = np.empty(4)
    for piece in range(PIECES):
        for t in (0.0, 0.3, 0.9):
            basis(knots, piece, t, weight)
            at = knots[piece + 3] + t * (knots[piece + 4] - knots[piece + 3])
            expected = BSpline(knots, np.eye(PIECES + 3), 3)(at)
            np.testing.assert_allclose(weight, expected[piece : piece + 4], atol=1e-13)


def test_least_time_scale_holds_for_every_time(motion, limits):
    control, knots = motion
    time_scale = least_time_scale(control, knots, limits)
    clock = np.linspace(0.0, knots[-1], 4001)[:-1]
    spline = BSpline(knots, control, 3)
    uses = [np.abs(spline(clock, nu=order) / time_scale**order)[:, limits.movable] for order in (1, 2, 3)]
    largest = [use.max(axis=0) / limits.rates[order][limits.movable] for order, use in enumerate(uses)]
    assert np.max(largest) <= 1.0 + 1e-9
    # Acceleration and jerk are exact; velocity is in the hull of its control points.
    assert np.max(largest) > 0.9


def test_a_motion_that_keeps_the_program_keeps_the_limits(motion, limits, robot):
    control, knots = motion
    rng = np.random.default_rng(4)
    count = (PIECES - 3) * 2
    rows = first_order(at_rest(control, knots), limits, field_of(robot).arrays, MARGIN, TRUST)
    matrix = dense(rows, count)
    both = len(rows.lower)
    for _ in range(200):
        unknowns = rng.uniform(-TRUST, TRUST, count)
        # The least time scale at which the program's limits are kept.
        value = matrix[:both, :-1] @ unknowns
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = np.maximum(value - rows.upper[:both], -value - rows.lower) / -rows.time_scale[:both]
        time_scale = needed[rows.time_scale[:both] < 0.0].max()
        if time_scale > 0.0:
            assert least_time_scale(moved(control, unknowns, limits.movable), knots, limits) <= time_scale * (
                1.0 + 1e-9
            )


def test_without_a_step_the_rows_are_the_limits_themselves(motion, limits, robot):
    control, knots = motion
    rows = first_order(at_rest(control, knots), limits, field_of(robot).arrays, MARGIN, TRUST)
    kinematic = np.count_nonzero(rows.time_scale)
    use = (np.abs(rows.lower - rows.upper[: len(rows.lower)]) / 2.0)[:kinematic]
    order = -rows.time_scale[:kinematic]
    assert max(use ** (1.0 / order)) == pytest.approx(least_time_scale(control, knots, limits))


def test_clearances_follow_the_field(motion, limits, robot):
    control, knots = motion
    field = field_of(robot)
    count = (PIECES - 3) * 2
    rows = first_order(at_rest(control, knots), limits, field.arrays, MARGIN, TRUST)
    matrix, both = dense(rows, count), len(rows.lower)
    gradients, bounds = matrix[both:, :-1], rows.upper[both:]

    def near(values):
        """Clearances in the order of the rows, those that were near to begin with."""
        spline = BSpline(knots, values, 3)
        breaks = knots[3:-3]
        clock = (breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(PLACES) / PLACES).ravel()
        return field.along(spline(clock)).ravel()

    here = near(control)
    touched = np.flatnonzero(here < NEAR)
    assert len(bounds) == len(touched) >= 5
    unknowns = np.random.default_rng(5).uniform(-1e-4, 1e-4, count)
    change = near(moved(control, unknowns, limits.movable)) - here
    expected = -gradients @ unknowns * SCALE
    np.testing.assert_allclose(change[touched], expected, atol=1e-7)
    # Where there is more than the margin, the margin is asked for.
    clearance = here[touched]
    np.testing.assert_allclose((clearance - bounds * SCALE)[clearance > 2.0 * MARGIN], MARGIN, atol=1e-12)


def test_clearances_less_what_tracking_errors_take_follow_step_and_time_scale(motion, limits, robot):
    """Errors that grow with speed bring links nearer; a slower motion leaves more room."""
    control, knots = motion
    field, count, by = field_of(robot), (PIECES - 3) * 2, 1e-4
    swaying = limits._replace(
        sway=np.array([[2e-3, 1e-3, 0.0, 0.0], [2e-3, 2e-3, 1e-3, 0.0], [3e-3, 2e-3, 2e-3, 1e-3]])
    )
    rows = first_order(at_rest(control, knots), swaying, field.arrays, MARGIN, TRUST)
    matrix, both = dense(rows, count), len(rows.lower)

    def left(values, time_scale):
        spline, breaks = BSpline(knots, values, 3), knots[3:-3]
        clock = (breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(PLACES) / PLACES).ravel()
        return (field.along(spline(clock)) - np.abs(spline(clock, 1)) @ swaying.sway.T / time_scale).ravel()

    here = left(control, 1.0)
    touched = np.flatnonzero(here < NEAR)
    assert len(rows.upper) - both == len(touched) >= 5
    unknowns = np.random.default_rng(5).uniform(-1e-5, 1e-5, count)
    change = left(moved(control, unknowns, limits.movable), 1.0 + by) - here
    expected = -(matrix[both:, :-1] @ unknowns + matrix[both:, -1] * by) * SCALE
    np.testing.assert_allclose(change[touched], expected, atol=2e-9 + 1e-3 * np.abs(expected).max())
    assert np.abs(matrix[both:, -1]).max() > 0.0


def test_control_points_outside_the_joint_limits_come_back(motion, limits, robot):
    control, knots = motion
    control[6, 1] = limits.upper[1] + 0.01
    rows = first_order(at_rest(control, knots), limits, field_of(robot).arrays, MARGIN, TRUST)
    kinematic = np.count_nonzero(rows.time_scale)
    bound = rows.upper[kinematic + (6 - 3) * 2]
    assert bound == pytest.approx(-0.01 / TRUST)
