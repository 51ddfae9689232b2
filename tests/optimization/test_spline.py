"""Splines: of paths, and of timed motions."""

from __future__ import annotations

import numpy as np
import pytest
from arm_variants import random_obstacles
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.compiled_motions import piece_is_clear
from hplan.optimization.timed_spline import TimedSpline, breaks_at_rows, even_breaks
from hplan.robot.dynamics import InverseDynamics
from hplan.scene.obstacles import Sphere
from hplan.trajectory.spline import STRIDE, MovableSpline, SplinePath, blocked_pieces, pieces_are_clear


@st.composite
def control_points(draw):
    seed, count, dof = draw(st.integers(0, 2**32 - 1)), draw(st.integers(4, 14)), draw(st.integers(1, 5))
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.5, 1.5, (count, dof))
    if draw(st.booleans()):  # very different spacings
        points = np.cumsum(points * rng.choice([1e-3, 1.0], (count, 1)), axis=0)
    return points


everywhere = settings(max_examples=60)


@everywhere
@given(control_points())
def test_values_and_derivatives_are_those_of_scipy(control):
    interpolate = pytest.importorskip("scipy.interpolate")
    path = SplinePath.from_control_points(control)
    reference = interpolate.BSpline(path.knots, path.control, 3)
    s = np.linspace(0.0, path.end, 137)
    for derivative in (0, 1, 2):
        expected = reference.derivative(derivative)(s) if derivative else reference(s)
        np.testing.assert_allclose(
            path.evaluate(s, derivative), expected, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(expected).max())
        )


@everywhere
@given(control_points())
def test_ends_are_exact_and_nothing_jumps_at_breaks(control):
    path = SplinePath.from_control_points(control)
    np.testing.assert_array_equal(path.evaluate(0.0), control[0])
    np.testing.assert_allclose(path.evaluate(path.end), control[-1], rtol=0, atol=1e-15 * np.abs(control).max())
    b = path.pieces
    width = np.diff(path.breaks)[:, None]
    for derivative, (before, after) in enumerate(
        [
            (b[:-1, 3], b[1:, 0]),
            ((b[:, 3] - b[:, 2])[:-1] / width[:-1], (b[:, 1] - b[:, 0])[1:] / width[1:]),
            (
                (b[:, 3] - 2 * b[:, 2] + b[:, 1])[:-1] / width[:-1] ** 2,
                (b[:, 2] - 2 * b[:, 1] + b[:, 0])[1:] / width[1:] ** 2,
            ),
        ]
    ):
        scale = max(1.0, np.abs(before).max(initial=0.0))
        np.testing.assert_allclose(before, after, atol=1e-8 * scale, err_msg=f"derivative {derivative}")


@everywhere
@given(control_points())
def test_path_is_in_the_hull_of_its_control_points(control):
    path = SplinePath.from_control_points(control)
    points = path.evaluate(np.linspace(0.0, path.end, 301))
    assert (points >= control.min(axis=0) - 1e-12).all()
    assert (points <= control.max(axis=0) + 1e-12).all()
    # Span by span: along any direction, within its four control points.
    rng = np.random.default_rng(0)
    for i, (low, high) in enumerate(zip(path.breaks[:-1], path.breaks[1:], strict=True)):
        span = path.evaluate(np.linspace(low, high, 9)[:-1])
        for direction in rng.normal(size=(5, control.shape[1])):
            reach = control[i : i + 4] @ direction
            assert (span @ direction >= reach.min() - 1e-10).all()
            assert (span @ direction <= reach.max() + 1e-10).all()


@everywhere
@given(control_points())
def test_length(control):
    path = SplinePath.from_control_points(control)
    points = path.evaluate(np.linspace(0.0, path.end, 20001))
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    polygon = np.linalg.norm(np.diff(control, axis=0), axis=1).sum()
    assert path.length == pytest.approx(chords, rel=2e-2)  # near a cusp quadrature is not exact
    assert path.length <= polygon * (1 + 2e-2)


def test_evaluate_clips_and_keeps_shapes():
    path = SplinePath.from_control_points(np.random.default_rng(1).uniform(size=(6, 3)))
    np.testing.assert_array_equal(path.evaluate([-1.0, 99.0]), path.control[[0, -1]])
    assert path.evaluate(0.3).shape == (3,)
    assert path.evaluate(np.zeros((2, 5)), 2).shape == (2, 5, 3)
    for array in (path.control, path.knots, path.breaks, path.pieces):
        assert not array.flags.writeable


# Pieces in the world


def bezier(piece, t):
    t = np.asarray(t)[:, None]
    u = 1 - t
    return u**3 * piece[0] + 3 * u**2 * t * piece[1] + 3 * u * t**2 * piece[2] + t**3 * piece[3]


def test_no_piece_in_contact_is_accepted_and_few_others_refused(robot):
    rng = np.random.default_rng(4)
    margin = 2e-3
    accepted = refused = 0
    while accepted + refused < 250:
        obstacles = random_obstacles(rng, 3)
        checker, field = CoalScene(robot, obstacles), ClearanceField.build(robot, obstacles)
        for _ in range(20):
            piece = rng.uniform(robot.lower, robot.upper) + np.cumsum(rng.uniform(-0.2, 0.2, (4, 4)), axis=0)
            if (
                field.spare_clearance(piece[0]) <= 0.0
                or not -0.05 < field.spare_clearance(bezier(piece, [0.5])[0]) < 0.2
            ):
                continue
            arrays = field.arrays
            least = min(checker.distances(q).min() for q in bezier(piece, np.linspace(0.0, 1.0, 200)))
            bounds = field.reaches @ (3.0 * np.abs(np.diff(piece, axis=0)).max(axis=0))
            if piece_is_clear(piece, arrays, margin, 0.0):
                accepted += 1
                assert least >= 0.5 * margin
                assert piece_is_clear(piece, arrays, margin, STRIDE)  # fewer looks find no more
            else:
                refused += 1
                assert least < margin + bounds.max() / 398
    assert min(accepted, refused) > 25


def test_contact_of_a_piece_for_a_moment_is_refused(robot):
    """A bead grazed by the tip between free configurations, and one just missed."""
    shoulder = np.linspace(0.3, 0.9, 4)
    piece = np.column_stack([0 * shoulder, shoulder, 0 * shoulder, 0 * shoulder])
    for depth in (1e-4, 1e-2):
        for at in (0.31, 0.455, 0.52, 0.6037, 0.7, 0.88):
            for gap, clear in ((-depth, False), (depth, True)):
                reach = 2.2 + 0.03 + 0.001 + gap
                bead = Sphere(name="bead", center=(reach * np.cos(at), 0, 0.6 + reach * np.sin(at)), radius=0.001)
                field = ClearanceField.build(robot, [bead])
                arrays = field.arrays
                assert piece_is_clear(piece, arrays, 0.5e-4, 0.0) is clear
                assert piece_is_clear(np.ascontiguousarray(piece[::-1]), arrays, 0.5e-4, 0.0) is clear


def test_piece_in_contact_is_named(robot, scene):
    field = ClearanceField.build(robot, scene.solids)
    control = np.radians(np.column_stack([np.zeros(12), np.linspace(0, 88, 12), np.zeros(12), np.zeros(12)]))
    path = SplinePath.from_control_points(control)
    checker = CoalScene(robot, scene.solids)
    expected = []
    for low, high in zip(path.breaks[:-1], path.breaks[1:], strict=True):
        expected.append(min(checker.distances(q).min() for q in path.evaluate(np.linspace(low, high - 1e-12, 300))) < 0)
    found = blocked_pieces(path.pieces, field, 1e-6)
    assert found.tolist() == expected
    assert 0 < sum(expected) < len(expected)
    assert not path.is_clear(field, 1e-6)
    assert not pieces_are_clear(MovableSpline(path.control, path.knots), field.arrays, 1e-6)
    nothing = ClearanceField.build(robot, [])
    assert pieces_are_clear(MovableSpline(path.control, path.knots), nothing.arrays, 1e-6)


def test_spline_that_is_not_a_number_is_not_clear(robot, scene):
    control = np.zeros((5, 4))
    control[:, 1] = [0.0, 0.1, np.nan, 0.3, 0.4]
    knots = SplinePath.from_control_points(np.linspace(0.0, 1.0, 5)[:, None]).knots
    assert not SplinePath(control, knots).is_clear(ClearanceField.build(robot, scene.solids), 1e-3)


def swing(clock):
    """A motion from rest to rest over one second, with three derivatives zero at its ends."""
    t = np.clip(clock, 0.0, 1.0)
    return np.outer(t**4 * (35.0 - 84.0 * t + 70.0 * t**2 - 20.0 * t**3), [1.0, -0.5, 0.2, 0.7])


def test_breaks_are_at_samples_and_equally_spaced():
    breaks = breaks_at_rows(103, 10, 250.0)
    rows = np.diff(breaks) * 250.0
    np.testing.assert_allclose(rows, np.round(rows), atol=1e-9)
    assert set(np.round(rows)) == {10.0, 11.0}
    assert breaks[-1] == 103 / 250.0


@pytest.mark.parametrize("pieces", [20, 40])
def test_near_is_near(pieces):
    spline = TimedSpline.approximate(swing, even_breaks(1.0, pieces))
    clock = np.linspace(0.0, 1.0, 501)
    error = np.abs(spline.path.evaluate(clock) - swing(clock)).max()
    assert error < 12.0 / pieces**4 * 5.0
    assert (spline.control[:3] == 0.0).all()


def test_rows_are_the_motion(robot):
    dynamics = InverseDynamics.build(robot.model)
    spline = TimedSpline.approximate(swing, breaks_at_rows(250, 40, 250.0))
    rows = spline.trajectory(dynamics, 250.0)
    assert rows.samples == 251
    assert rows.duration == 1.0
    for end in (0, -1):
        assert not rows.velocity[end].any()
        assert not rows.acceleration[end].any()
    # The cubics between the samples, as read by the certificate, equal the spline.
    bezier, durations = rows.segments
    middle = (bezier * np.array([1.0, 3.0, 3.0, 1.0])[:, None] / 8.0).sum(axis=1)
    np.testing.assert_allclose(middle, spline.path.evaluate(rows.time[:-1] + 0.5 * durations), atol=1e-13)
