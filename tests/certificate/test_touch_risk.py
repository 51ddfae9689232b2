"""Bounds of contact probabilities: half-spaces against coal, draws, motions at risk."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from scipy.stats import chi

import hplan
from hplan.base.arrays import FloatArray
from hplan.certificate import touch_risk as subject
from hplan.certificate.touch_risk import TouchRisk
from hplan.collision.coal_scene import CoalScene
from hplan.errors import CertificationError, MovingObstacleError, NotInTimeError, OptionError
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import AnyObstacle, Box, Capsule, PointCloud, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory

LONG = ((4e-4, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 1e-4))
ROUND = ((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))


def things(shift: FloatArray | None = None) -> tuple[AnyObstacle, ...]:
    """Obstacles around the path of `motion`, all of them shifted."""
    by = np.zeros(3) if shift is None else shift
    ends, box = np.array([[0.65, 0.95, 1.0], [1.45, 0.95, 1.2]]), np.array([1.36, 0.4, 1.75])
    points = np.random.default_rng(5).normal(size=(40, 3)) * 0.05 + [1.1, -0.55, 1.42]
    return (
        Sphere(name="ball", center=np.array([1.1, 0.29, 1.75]) + by, radius=0.06, sigma=0.012),
        Capsule(name="twig", start=ends[0] + by, end=ends[1] + by, radius=0.01, sigma=0.015),
        Box(name="box", center=box + by, size=(0.2, 0.1, 0.2), rpy_deg=(10.0, 20.0, 30.0), covariance=LONG),
        PointCloud.from_points("leaves", points + by, 0.01, sigma=0.01),
    )


def task(obstacles: tuple[AnyObstacle, ...], **more: object) -> Scene:
    start, goal = Start(joints_deg=(-60.0, 30.0, 40.0, 0.0)), Goal(joints_deg=(60.0, 10.0, 60.0, 20.0))
    return Scene(name="vague", start=start, goal=goal, obstacles=obstacles, **more)


@pytest.fixture(scope="module")
def motion(robot: Robot) -> Trajectory:
    return hplan.plan(robot, task(()), hplan.PlanOptions()).trajectory


def risk_of(robot: Robot, scene: Scene, motion: Trajectory, asked: float = 0.5) -> TouchRisk:
    found = hplan.certify(robot, scene, motion, risk=asked, check_ends=False).risk
    assert found is not None
    return found


def test_errors_within_the_half_spaces_touch_nothing(robot: Robot, motion: Trajectory) -> None:
    scene, random = task(things()), np.random.default_rng(2)
    errors = scene.errors
    far = {name: 7.0 * float(np.sqrt(np.linalg.eigvalsh(error)[-1])) for name, error in errors.items()}
    found = np.concatenate(
        [
            rows
            for proved, _ in risk_of(robot, scene, motion).subject.motions
            for rows in subject._iterate_half_spaces(proved, far)
        ]
    )
    rows = {name: found[found[:, 0] == place] for place, name in enumerate(errors)}
    assert all(len(part) for part in rows.values())
    dense, nearest = motion.position[:: max(1, motion.samples // 400)], []
    for name, part in rows.items():
        for _ in range(25):
            along = random.normal(size=3)
            # Up to the nearest half-space in a direction, or to the maximum distance.
            reach = part[:, 4] / np.maximum(part[:, 1:4] @ along, 1e-12)
            shift = along * min(0.999 * reach.min(), far[name] / float(np.linalg.norm(along)))
            thing = next(thing for thing in things(shift) if thing.name == name)
            checker = CoalScene(robot, thing.solids)
            nearest.append(min(float(checker.distances(q).min()) for q in dense))
    assert min(nearest) > 0.0
    # They are not much smaller than they have to be either.
    assert np.quantile(nearest, 0.1) < 0.005


@pytest.mark.parametrize("gap", [0.5, 2.0, 4.0])
def test_one_plane_planes_all_round_and_those_between(gap: float) -> None:
    one = subject._exit_probability(np.array([[0.0, 0.6, 0.8]]), np.array([gap]), np.eye(3))
    assert NormalDist().cdf(-gap) <= one <= 1.3 * NormalDist().cdf(-gap)
    random = np.random.default_rng(0)
    round_about = random.normal(size=(4000, 3))
    round_about /= np.linalg.norm(round_about, axis=1, keepdims=True)
    ball = subject._exit_probability(round_about, np.full(4000, gap), np.eye(3))
    assert ball == pytest.approx(chi(3).sf(gap), rel=0.03)
    normals, gaps = round_about[:6], gap * random.uniform(0.8, 1.5, 6)
    root = random.normal(size=(3, 3))
    draws = random.normal(size=(400_000, 3)) @ root.T
    deviations = np.linalg.norm(normals @ root, axis=1)
    truth = float((draws @ normals.T >= gaps * deviations).any(axis=1).mean())
    bound = subject._exit_probability(normals, gaps * deviations, root @ root.T)
    assert truth - 4.0 * math.sqrt(truth / 400_000) <= bound <= 1.25 * truth + 1e-4


def test_draws_touch_no_more_often_than_the_bound(robot: Robot, motion: Trajectory) -> None:
    for scene in (task(things()), task(things(), covariance=ROUND)):
        found = risk_of(robot, scene, motion)
        assert 1e-3 < found.estimate.low <= found.bound <= 2.0 * found.estimate.high
        assert sum(share.probability for share in found.shares) + found.shared == pytest.approx(found.bound, rel=1e-3)


def test_joint_motion_counts_once(robot: Robot, motion: Trajectory) -> None:
    certain = [thing.model_copy(update={"sigma": 0.0, "covariance": None}) for thing in things()]
    twins = [thing.model_copy(update={"name": f"{thing.name} {n}"}) for thing in certain for n in range(5)]
    together = risk_of(robot, task(tuple(twins), covariance=ROUND), motion)
    alone = risk_of(robot, task(tuple(certain), covariance=ROUND), motion)
    assert together.bound == pytest.approx(alone.bound, rel=1e-9)
    assert together.estimate.low <= together.bound <= 1.6 * together.estimate.high
    # Errors of each by itself do add up.
    own = [thing.model_copy(update={"sigma": 0.01}) for thing in twins]
    assert risk_of(robot, task(tuple(own)), motion).bound > 2.0 * together.bound


def test_obstacle_without_error_has_no_risk(robot: Robot, motion: Trajectory) -> None:
    certain = tuple(thing.model_copy(update={"sigma": 0.0, "covariance": None}) for thing in things())
    for scene in (task(()), task((), covariance=ROUND), task(certain)):
        found = risk_of(robot, scene, motion)
        assert (found.bound, found.shares, found.estimate.touching) == (0.0, (), 0)


def test_certify_judges_by_the_bound(robot: Robot, motion: Trajectory) -> None:
    scene = task(things())
    bound = risk_of(robot, scene, motion).bound
    assert hplan.certify(robot, scene, motion, risk=min(1.0, 1.001 * bound)).verified
    refused = hplan.certify(robot, scene, motion, risk=0.999 * bound)
    assert not refused.verified
    assert "the probability of a contact is bounded by" in refused.violations[0]
    moving = replace_first(scene, Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))))
    with pytest.raises(MovingObstacleError):
        hplan.certify(robot, moving, motion, risk=0.1)
    with pytest.raises(MovingObstacleError):
        hplan.plan(robot, moving, hplan.PlanOptions(risk=0.1))
    for wrong in (0.0, 1.5, "much", math.nan):
        with pytest.raises(OptionError):
            hplan.certify(robot, scene, motion, risk=wrong)  # type: ignore[arg-type]
        with pytest.raises(OptionError):
            hplan.PlanOptions(risk=wrong)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="single plan"):
        hplan.plan_tour(robot, replace_goal(scene), hplan.PlanOptions(risk=0.1))


def replace_first(scene: Scene, track: Track) -> Scene:
    first, *others = scene.obstacles
    return scene.with_obstacles([first.model_copy(update={"track": track}), *others])


def replace_goal(scene: Scene) -> Scene:
    fruit = Fruit(name="apple", center=(1.0, 0.0, 1.4), radius=0.04)
    return scene.model_copy(update={"fruits": (fruit,), "goal": Goal(fruit="apple")})


def test_plans_keep_within_the_risk_and_lose_less_time_than_equal_shares(robot: Robot) -> None:
    scene = task(things())
    for risk in (0.1, 0.001):
        found = hplan.plan(robot, scene, hplan.PlanOptions(risk=risk))
        shown = found.certificate.risk
        assert found.certificate.verified
        assert shown is not None
        assert shown.bound <= risk
        assert shown.estimate.low <= shown.bound
        equal = hplan.plan(robot, scene, hplan.PlanOptions(sigmas=float(chi(3).isf(risk / len(scene.obstacles)))))
        assert found.trajectory.duration <= equal.trajectory.duration
        again = hplan.certify(robot, scene, found.trajectory, risk=risk)
        assert again.verified
        assert again.risk is not None
        assert again.risk.bound == pytest.approx(shown.bound, rel=0.2)
        assert found.report["certificate"]["risk"]["asked"] == risk


def test_no_motion_is_given_whose_goal_alone_is_riskier(robot: Robot, motion: Trajectory) -> None:
    hand = robot.forward_kinematics(motion.position[-1])[:3, 3]
    beside = Sphere(name="beside", center=hand + np.array([0.0, 0.0, 0.16]), radius=0.05, sigma=0.1)
    with pytest.raises(CertificationError, match=r"at most 0\.01: the lowest bound that was proved is 0\."):
        hplan.plan(robot, task((beside,)), hplan.PlanOptions(risk=0.01))


def test_deadline_leaves_time_for_the_bound(robot: Robot) -> None:
    found = hplan.plan(robot, task(things()), hplan.PlanOptions(risk=0.01, deadline_s=60.0)).certificate
    assert found.verified
    assert found.risk is not None
    assert found.risk.bound <= 0.01
    for too_short in (1e-4, 0.01, 0.03):
        with contextlib.suppress(NotInTimeError):
            hplan.plan(robot, task(things()), hplan.PlanOptions(risk=0.01, deadline_s=too_short))


def test_sigmas_by_name(robot: Robot) -> None:
    scene = task(things())
    named = hplan.PlanOptions(sigmas={thing.name: 2.0 for thing in scene.obstacles})
    same, found = hplan.plan(robot, scene, hplan.PlanOptions(sigmas=2.0)), hplan.plan(robot, scene, named)
    np.testing.assert_array_equal(found.trajectory.position, same.trajectory.position)
    assert found.report["certificate"]["uncertain"] == pytest.approx(same.report["certificate"]["uncertain"])
    with pytest.raises(OptionError, match="ball"):
        replace(named, sigmas={"ball": -1.0})
