"""Reported clearances count the round shapes of a turret, judged by Pinocchio and coal."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import AnyObstacle, Box, PointCloud, Sphere
from hplan.scene.tracks import Track

START, GOAL = Start(joints_deg=(0.0, 60.0, 20.0, 20.0)), Goal(joints_deg=(20.0, 60.0, 20.0, 20.0))


def a_scene(*obstacles: AnyObstacle, clearance: float = 0.0) -> Scene:
    return Scene(name="x", start=START, goal=GOAL, obstacles=obstacles, clearance=clearance)


def from_turret(robot: Robot, center: np.ndarray, radius: float) -> float:
    """Distance of a ball from the URDF's shapes of the turret [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.zeros(robot.dof))
    found = []
    for shape in robot.collision_model.geometryObjects:
        if shape.parentJoint == 1:
            place = data.oMi[1] * shape.placement
            there = coal.Transform3s(place.rotation, place.translation), coal.Transform3s(np.eye(3), center)
            ask = coal.DistanceRequest(), coal.DistanceResult()
            found.append(coal.distance(shape.geometry, there[0], coal.Sphere(radius), there[1], *ask))
    return min(found)


@pytest.mark.parametrize("sigma", [0.0, 0.004])
@pytest.mark.parametrize("center", [(-0.2, 0.0, 0.5), (-0.13, -0.13, 0.55), (-0.17, 0.02, 0.45)])
def test_round_turret_counts(robot: Robot, center: tuple[float, ...], sigma: float) -> None:
    ball = Sphere(name="ball", center=center, radius=0.04, sigma=sigma)
    true = from_turret(robot, np.array(center), 0.04) - 3.0 * sigma
    for obstacle in (ball, PointCloud.from_points("ball", np.array([center]), radius=0.04, sigma=sigma)):
        result = hplan.plan(robot, a_scene(obstacle), hplan.PlanOptions(effort="quick"))
        assert result.certificate.verified
        assert true - 1e-4 < result.certificate.min_clearance_m <= true + 1e-9
        assert result.stop_at(0.3).certificate.min_clearance_m <= true + 1e-9


def test_turret_nearer_than_the_clearance_is_listed(robot: Robot) -> None:
    center = (-0.2, 0.0, 0.5)
    true = from_turret(robot, np.array(center), 0.05)
    found = hplan.plan(robot, a_scene(Sphere(name="ball", center=center, radius=0.05), clearance=0.05)).certificate
    (rule,) = [rule for rule in found.pair_rules if rule.other == "ball"]
    assert (rule.link, rule.required_m) == ("turret", 0.0)
    assert rule.clearance_m == pytest.approx(true, abs=1e-4)
    assert found.min_clearance_m == rule.clearance_m <= true < 0.05


def test_body_under_turret_is_listed_but_not_counted(robot: Robot) -> None:
    """A collar about the turret that touches it, as the ground may touch a pedestal."""
    touching = Box(name="collar", center=(-0.2115, 0.0, 0.5), size=(0.2, 0.1, 0.1))
    found = hplan.plan(robot, a_scene(touching)).certificate
    (rule,) = [rule for rule in found.pair_rules if rule.other == "collar"]
    assert (rule.link, rule.required_m, rule.clearance_m) == ("turret", None, None)
    assert found.verified
    assert found.min_clearance_m > 0.01


def test_obstacle_that_passes_the_turret_counts(robot: Robot) -> None:
    """A ball that comes near the turret between two times of the motion's own samples."""
    still = hplan.plan(robot, a_scene(), hplan.PlanOptions(effort="quick")).trajectory
    end = still.duration
    times = np.array([0.0, 0.373 * end, end])
    shifts = np.array([[-0.6, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.6, 0.0, 0.0]])
    center = np.array([-0.2, 0.0, 0.5])
    track = Track(times_s=tuple(times.tolist()), shifts_m=tuple(map(tuple, shifts.tolist())))
    ball = Sphere(name="ball", center=tuple(center.tolist()), radius=0.05, track=track)
    found = hplan.certify(robot, a_scene(ball), still)
    true = from_turret(robot, center, 0.05)
    assert found.min_clearance_m <= true + 1e-9
    assert found.min_clearance_m > true - 0.02
