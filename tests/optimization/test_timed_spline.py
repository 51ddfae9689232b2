"""Splines over time, and the rows they give."""

from __future__ import annotations

import numpy as np
import pytest

from hplan.optimization.timed_spline import TimedSpline, breaks_at_rows, even_breaks
from hplan.robot.dynamics import InverseDynamics
from hplan.trajectory.trajectory import cubic_pieces


def swing(clock):
    """A motion from rest to rest over one second, with three derivatives zero at its ends."""
    t = np.clip(clock, 0.0, 1.0)
    return np.outer(t**4 * (35.0 - 84.0 * t + 70.0 * t**2 - 20.0 * t**3), [1.0, -0.5, 0.2, 0.7])


def test_breaks_are_at_rows_and_as_equal_as_they_can_be():
    breaks = breaks_at_rows(103, 10, 250.0)
    rows = np.diff(breaks) * 250.0
    np.testing.assert_allclose(rows, np.round(rows), atol=1e-9)
    assert set(np.round(rows)) == {10.0, 11.0}
    assert breaks[-1] == 103 / 250.0


@pytest.mark.parametrize("pieces", [20, 40])
def test_near_is_near(pieces):
    spline = TimedSpline.near(swing, even_breaks(1.0, pieces))
    clock = np.linspace(0.0, 1.0, 501)
    error = np.abs(spline.path.evaluate(clock) - swing(clock)).max()
    assert error < 12.0 / pieces**4 * 5.0
    assert (spline.control[:3] == 0.0).all()


def test_rows_are_the_motion(robot):
    dynamics = InverseDynamics.of(robot.model)
    spline = TimedSpline.near(swing, breaks_at_rows(250, 40, 250.0))
    rows = spline.trajectory(dynamics, 250.0)
    assert rows.samples == 251
    assert rows.duration == 1.0
    for end in (0, -1):
        assert not rows.velocity[end].any()
        assert not rows.acceleration[end].any()
    # The cubics between the rows, as the certificate reads them, are the spline.
    bezier, durations = cubic_pieces(rows)
    middle = (bezier * np.array([1.0, 3.0, 3.0, 1.0])[:, None] / 8.0).sum(axis=1)
    np.testing.assert_allclose(middle, spline.path.evaluate(rows.time[:-1] + 0.5 * durations), atol=1e-13)
