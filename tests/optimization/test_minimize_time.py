"""Motions optimised together with their timing, on the reference scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hplan
from hplan.certificate.limit_use import limit_use
from hplan.optimization.torque_rows import TorqueUse
from hplan.planning.options import EFFORT_NAMES, PlanOptions
from hplan.trajectory.trajectory import cubic_pieces


@pytest.fixture(scope="module")
def plans(robot, scene):
    return {effort: hplan.plan(robot, scene, PlanOptions(effort=effort)) for effort in EFFORT_NAMES}


def test_more_effort_is_quicker(plans):
    durations = {effort: plan.trajectory.duration for effort, plan in plans.items()}
    # An offline optimum of the motion is at about 1.75 s.
    assert durations["default"] <= 1.77
    assert durations["best"] <= 1.755
    assert durations["best"] <= durations["default"] <= durations["quick"]
    assert all(plan.certificate.verified for plan in plans.values())


def test_limits_are_kept_from_row_to_row_and_between(plans, robot):
    for effort in ("default", "best"):
        trajectory = plans[effort].trajectory
        jerk = np.diff(trajectory.acceleration, axis=0) * 250.0
        assert (np.abs(jerk) <= robot.jerk_limit * (1.0 + 1e-5)).all()
        use = limit_use(robot, trajectory, *cubic_pieces(trajectory))
        assert max(use.velocity, use.acceleration, use.torque) <= 1.0 + 1e-5
        assert use.position <= 1.0 + 1e-6


def test_torque_limits_are_kept(robot, scene):
    weak = np.array(robot.torque_limit)
    largest = np.abs(hplan.plan(robot, scene).trajectory.torque).max(axis=0)
    weak[1] = 0.97 * largest[1]
    arm = replace(robot, torque_limit=weak)
    plan = hplan.plan(arm, scene)
    assert plan.certificate.verified
    assert np.abs(plan.trajectory.torque[:, 1]).max() <= weak[1] * 1.001


def test_torque_rows_follow_the_torques(robot):
    from hplan.optimization.first_order import MotionLimits
    from hplan.optimization.timed_spline import TimedSpline, even_breaks
    from hplan.optimization.torque_rows import torque_rows

    def motion(clock):
        t = np.clip(clock / 0.8, 0.0, 1.0)
        return 0.3 + np.outer(t**3 * (10.0 - 15.0 * t + 6.0 * t**2), [0.0, 0.6, 0.4, -0.2])

    spline = TimedSpline.near(motion, even_breaks(0.8, 14))
    limit = np.abs(TorqueUse.of(spline, robot.dynamics, np.ones(4)).use).max(axis=0) + 1e-6
    use = TorqueUse.of(spline, robot.dynamics, limit)
    movable = np.array([1, 2, 3])
    limits = MotionLimits(np.array(robot.lower), np.array(robot.upper), np.ones((3, 4)), movable, np.empty((0, 4)))
    rows = torque_rows(use, spline, robot.dynamics, limits)
    rng = np.random.default_rng(1)
    change, time_scale = rng.uniform(-1e-5, 1e-5, (len(spline.control) - 6, 3)), 1.0 + 1e-5
    control = np.array(spline.control)
    control[3:-3, movable] += change
    after = TorqueUse.of(TimedSpline(control, spline.knots).at_time_scale(time_scale), robot.dynamics, limit)
    times, joints = np.nonzero(np.abs(use.use) > 0.75)
    sign = np.sign(use.use[times, joints])
    actual = sign * (after.use - use.use)[times, joints]
    matrix = np.zeros((len(rows.upper), change.size))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        matrix[row, rows.columns[start:end]] = rows.entries[start:end]
    np.testing.assert_allclose(matrix @ change.ravel() + rows.time_scale * (time_scale - 1.0), actual, atol=2e-7)
    assert len(rows.upper) > 5
