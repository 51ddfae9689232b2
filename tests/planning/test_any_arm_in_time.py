"""Plans of arms that are no planar ones among obstacles that move; judged by coal at times close together."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track

START, GOAL = (-1.3, -0.6, 1.0, 0.2, 0.3, 0.0), (1.3, -0.6, 1.0, 0.2, 0.3, 0.0)


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Robot:
    return loaded_arm("toy", tmp_path_factory)


def least_distance(robot: Robot, ball: Sphere, result: PlanResult) -> float:
    """Of anything that moves from the ball, put where its track has it."""
    model, data = robot.collision_model, robot.model.createData()
    placed, least = model.createData(), math.inf
    times, shifts = np.array(ball.track.times_s), np.array(ball.track.shifts_m)
    for clock in np.arange(0.0, result.trajectory.duration, 5e-3):
        pin.updateGeometryPlacements(
            robot.model, data, model, placed, result.trajectory.positions(np.array([clock]))[0]
        )
        shift = np.array([np.interp(clock, times, shifts[:, axis]) for axis in range(3)])
        at = coal.Transform3s(np.eye(3), np.array(ball.center) + shift)
        for shape, place in zip(model.geometryObjects, placed.oMg.tolist(), strict=True):
            if shape.parentJoint > 0:
                where = coal.Transform3s(place.rotation, place.translation)
                other = coal.Sphere(ball.radius), at
                found = coal.distance(shape.geometry, where, *other, coal.DistanceRequest(), coal.DistanceResult())
                least = min(least, found)
    return least


@pytest.mark.parametrize("leaves_s", [0.6, 2.0])
def test_it_waits_for_a_ball_that_leaves_its_path(robot, leaves_s):
    middle = robot.tool_positions(0.5 * (np.array(START) + np.array(GOAL)))
    away = Track(times_s=(0.0, leaves_s), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.8)))
    ball = Sphere(name="ball", center=tuple(middle.tolist()), radius=0.06, track=away)
    scene = Scene(
        name="s", start=Start(joints_rad=START), goal=Goal(joints_rad=GOAL), obstacles=(ball,), clearance=0.005
    )
    result = plan(robot, scene, PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert least_distance(robot, ball, result) >= result.certificate.min_clearance_m - 1e-6 > 0.005 - 1e-6
