"""Uncertain fruit positions: the capture probability, and the best approach."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hplan
from hplan.errors import OptionError
from hplan.planning.grasps import SAME, capture_probabilities
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start

CAPTURE = (0.008, 0.02)

#: Depth, along x, is the least certain direction.
COVARIANCE = np.diag([0.015, 0.003, 0.003]) ** 2

SCENE = Scene(
    name="uncertain",
    start=Start(joints_deg=(0.0, 90.0, 90.0, 90.0)),
    goal=Goal(fruit="far"),
    fruits=(
        Fruit(name="far", center=(1.0, 0.3, 2.0), radius=0.04, covariance=COVARIANCE.tolist()),
        Fruit(name="sure", center=(1.2, -0.6, 1.5), radius=0.04),
    ),
)


def test_shares_are_those_of_the_normal_distribution() -> None:
    random = np.random.default_rng(0)
    for sigma in (0.003, 0.01, 0.03):
        ahead = random.normal(size=(5, 3))
        exact = math.erf(CAPTURE[1] / (math.sqrt(2.0) * sigma)) * -math.expm1(-(CAPTURE[0] ** 2) / (2.0 * sigma**2))
        np.testing.assert_allclose(capture_probabilities(ahead, sigma**2 * np.eye(3), CAPTURE), exact, atol=0.004)
    deep = np.diag([0.015**2, 0.0, 0.0])
    along, across = (math.erf(most / (math.sqrt(2.0) * 0.015)) for most in CAPTURE[::-1])
    np.testing.assert_allclose(capture_probabilities(np.eye(3), deep, CAPTURE), [along, across, across], atol=0.004)


def test_approach_is_best_against_the_error(robot: Robot) -> None:
    # With a growth of three sigmas, stand-offs of 10 cm would not be clear.
    plain, found = (
        hplan.plan(robot, SCENE, hplan.PlanOptions(standoff=0.2, capture_m=most)) for most in (None, CAPTURE)
    )
    assert found.certificate.verified
    assert plain.grasp is not None
    assert found.grasp is not None
    assert (plain.grasp.caught, "caught" in plain.report["grasp"]) == (None, False)
    shares = []
    for result in (plain, found):
        way = (
            np.array([robot.forward_kinematics(q)[:3, 3] for q in result.trajectory.position]) - SCENE.fruits[0].center
        )
        away = np.linalg.norm(way, axis=1)
        begin = np.flatnonzero(away > 0.05)[-1]
        ahead = -way[begin] / away[begin]
        errors = np.random.default_rng(1).multivariate_normal(np.zeros(3), COVARIANCE, 40_000)
        along = errors @ ahead
        across = np.linalg.norm(errors - along[:, None] * ahead, axis=1)
        shares.append(float(((np.abs(along) <= CAPTURE[1]) & (across <= CAPTURE[0])).mean()))
    assert found.report["grasp"]["caught"] == found.grasp.caught == pytest.approx(shares[1], abs=0.01)
    assert shares[1] > shares[0] + 2.0 * SAME
    with pytest.raises(OptionError, match="capture_m"):
        hplan.PlanOptions(capture_m=(0.02,))  # type: ignore[arg-type]


def test_tour_reports_expected_fruit(robot: Robot) -> None:
    tour = hplan.plan_tour(robot, SCENE, hplan.PlanOptions(capture_m=CAPTURE))
    each = {leg.fruit: leg.grasp.caught for leg in tour.legs if leg.grasp is not None}
    assert each["sure"] == 1.0
    assert each["far"] < 0.95
    assert tour.report["expected_fruit"] == pytest.approx(sum(each.values()))
