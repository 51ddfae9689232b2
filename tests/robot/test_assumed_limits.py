"""Acceleration limits that nothing gives are assumed, and reports say so."""

from __future__ import annotations

import numpy as np
import pytest
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan import PlanOptions, load_robot, plan
from hplan.errors import OptionError, RobotFileWarning
from hplan.scene import Goal, Scene, Start


@pytest.mark.parametrize(("scale", "factor"), [(None, 2.0), (0.5, 0.5)])
def test_accelerations_are_a_multiple_of_the_velocity_limits(scale, factor):
    with pytest.warns(RobotFileWarning, match=f"no acceleration limits; {factor:g} /s times the velocity limits"):
        robot = load_robot(six_axis_arm(), acceleration_scale=scale)
    np.testing.assert_allclose(robot.acceleration_limit, factor * robot.velocity_limit)
    q = 0.5 * (robot.lower + robot.upper)
    scene = Scene(name="free", start=Start(joints_rad=q), goal=Goal(joints_rad=q + 0.2))
    result = plan(robot, scene, PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert (np.abs(result.trajectory.acceleration) <= 1.001 * robot.acceleration_limit).all()
    assert "no acceleration limits" in result.report["assumptions"][0]


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("nan"), "2"])
def test_scale_is_positive(wrong):
    with pytest.raises(OptionError, match="acceleration_scale"):
        load_robot(six_axis_arm(), acceleration_scale=wrong)


def test_given_limits_are_not_scaled(tmp_path):
    limits = tmp_path / "arm.limits.yaml"
    limits.write_text(SIX_AXIS_LIMITS)
    assert not load_robot(six_axis_arm(), limits=limits).assumptions
    with pytest.raises(OptionError, match="gives the acceleration limits"):
        load_robot(six_axis_arm(), limits=limits, acceleration_scale=1.0)
