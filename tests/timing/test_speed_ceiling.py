"""Tight places run slowly, and only these; the proof then holds where tracking errors grow with speed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from planned import between_twigs

from hplan.collision.clearance_field import ClearanceField
from hplan.errors import CertificationError
from hplan.planning import certified_motion
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
from hplan.robot.limits import Limits
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.smoothing.spline import SplinePath
from hplan.timing.retime import time_path
from hplan.timing.speed_ceiling import LEAST, SpeedCeiling, averaging_s
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify

DELAY, WIDE = 3e-3, 1.5
REACHED = np.array([0.0, math.radians(20.0), math.radians(30.0), math.radians(20.0)])


def bead(robot: Robot, gap: float) -> Sphere:
    """A ball so far above the tip of the arm as it turns through yaw 0."""
    x, y, z = robot.tool_positions(REACHED)
    return Sphere(name="bead", center=(float(x), float(y), float(z) + float(robot.arm.half_widths[-1]) + 0.02 + gap),
        radius=0.02,
    )  # fmt: skip


def turning() -> SplinePath:
    """The base turns from one side to the other, the arm as it is."""
    ends = np.tile(REACHED, (2, 1))
    ends[:, 0] = -WIDE, WIDE
    return SplinePath.through(np.linspace(*ends, 6))


def timed(robot: Robot, path: SplinePath, ceiling: SpeedCeiling | None) -> Trajectory:
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit, ceiling)
    return time_path(path, robot.dynamics, limits)


def ceiling_of(robot: Robot, path: SplinePath, field: ClearanceField, fraction: float = 0.75) -> SpeedCeiling:
    averaged_s = averaging_s(Limits(robot.velocity_limit, robot.acceleration_limit, None, robot.jerk_limit), 250.0)
    return SpeedCeiling(robot, path, field, DELAY, fraction, averaged_s)


def scene_of(obstacles: list[Sphere]) -> Scene:
    still = Start(joints_deg=(0.0, 0.0, 0.0, 0.0))
    return Scene(name="turn", start=still, goal=Goal(joints_deg=(0.0,) * 4), obstacles=tuple(obstacles))


@pytest.mark.parametrize("gap", [0.001, 0.004])
def test_only_the_tight_place_is_run_slowly(robot: Robot, gap: float) -> None:
    path, scene = turning(), scene_of([bead(robot, gap)])
    field = ClearanceField.of(robot, scene.solids)
    fast, careful = timed(robot, path, None), timed(robot, path, ceiling_of(robot, path, field))
    assert not certify(robot, scene, fast, tracking_delay_s=DELAY, check_ends=False).verified
    assert certify(robot, scene, careful, tracking_delay_s=DELAY, check_ends=False).verified

    def speeds(motion: Trajectory, yaws: np.ndarray) -> np.ndarray:
        return np.interp(yaws, motion.position[:, 0], motion.velocity[:, 0])

    away = np.concatenate([np.linspace(-1.4, -0.6, 50), np.linspace(0.6, 1.4, 50)])
    np.testing.assert_allclose(speeds(careful, away), speeds(fast, away), atol=5e-3)
    lever = float(robot.yaw_radius[-1])
    slowest = float(speeds(careful, np.linspace(-0.05, 0.05, 50)).min())
    assert 0.7 * gap < slowest * DELAY * lever < 0.76 * gap
    assert fast.duration + 0.1 < careful.duration < fast.duration + 1.0


def test_ceiling_by_the_formula(robot: Robot) -> None:
    """At every grid point no more than its own clearance allows, and as much where its neighbours allow as much."""
    path = turning()
    field = ClearanceField.of(robot, [bead(robot, 0.003)])
    grid = np.linspace(0.0, path.end, 301)
    ceiling = ceiling_of(robot, path, field, 0.5)(grid)
    own = np.empty(len(grid))
    for number, s in enumerate(grid):
        clear = np.maximum(field.link_clearances(path.evaluate(s)), LEAST)
        own[number] = (0.5 * clear / robot.sway(DELAY * np.abs(path.evaluate(s, 1)))).min()
    tight = np.isfinite(ceiling)
    assert 5 < tight.sum() < 60
    assert (ceiling <= own * (1.0 + 1e-12))[tight].all()
    assert ceiling[tight].min() == pytest.approx(own.min(), rel=1e-3)
    rates = np.abs(path.evaluate(grid, 1))
    assert (own[~tight] >= (robot.velocity_limit / np.maximum(rates, 1e-300)).min(axis=1)[~tight]).all()


def test_the_tight_place_may_be_between_two_grid_points(robot: Robot) -> None:
    path = turning()
    field = ClearanceField.of(robot, [bead(robot, 0.002)])
    ceiling = ceiling_of(robot, path, field)
    between, on = np.linspace(0.0, path.end, 10), np.linspace(0.0, path.end, 11)  # yaw 0 is halfway
    assert ceiling(between).min() == pytest.approx(ceiling(on).min(), rel=1e-9)
    assert np.isfinite(ceiling(between)).sum() == 2


def test_nothing_near_is_no_ceiling(robot: Robot) -> None:
    path = turning()
    ceiling = ceiling_of(robot, path, ClearanceField.of(robot, [bead(robot, 0.5)]))
    assert np.isinf(ceiling(np.linspace(0.0, path.end, 100))).all()
    plain, same = timed(robot, path, None), timed(robot, path, ceiling)
    np.testing.assert_array_equal(plain.position, same.position)


def test_averages_reach_as_far_as_the_jerk_limit_takes(robot: Robot) -> None:
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, None, robot.jerk_limit)
    assert averaging_s(limits, 250.0) == pytest.approx(0.02 + 0.004)
    assert averaging_s(Limits(robot.velocity_limit, robot.acceleration_limit), 100.0) == pytest.approx(0.01)


@pytest.mark.parametrize("turn", [1.0, 0.005])
def test_path_speed_is_kept(robot: Robot, turn: float) -> None:
    """On a very short path too, which timing makes longer for itself."""
    path = SplinePath.through(REACHED + np.linspace(0.0, turn, 5)[:, None] * np.eye(4)[0])
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    half = 0.5 * float(time_path(path, robot.dynamics, limits).velocity[:, 0].max())
    kept = Limits(
        robot.velocity_limit, robot.acceleration_limit, None, robot.jerk_limit, lambda s: np.full(len(s), half)
    )
    assert kept.scaled(0.5).path_speed is kept.path_speed
    motion, fine = time_path(path, robot.dynamics, kept), np.linspace(0.0, path.end, 5000)
    at = np.interp(motion.position[:, 0], path.evaluate(fine)[:, 0], fine)
    assert (motion.velocity[:, 0] / path.evaluate(at, 1)[:, 0]).max() == pytest.approx(half, rel=0.03)


def test_approach_between_twigs(robot: Robot) -> None:
    """With a delay it takes a little longer, and then all of it is certified."""
    scene = between_twigs()
    plain, careful = (plan(robot, scene, PlanOptions(tracking_delay_s=delay)) for delay in (0.0, DELAY))
    assert careful.certificate.verified
    checker = plain.motion.task.world.touching("apple").checker
    assert not certify(
        robot, scene, plain.trajectory, tracking_delay_s=DELAY, checker=checker, check_ends=False
    ).verified
    assert plain.trajectory.duration < careful.trajectory.duration < 2.0 * plain.trajectory.duration


def test_without_delay_no_ceiling_is_looked_for(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("looked for")

    monkeypatch.setattr(certified_motion, "SpeedCeiling", never)
    assert plan(robot, between_twigs(), PlanOptions(tracking_error=1e-4)).certificate.verified
    assert plan(robot, between_twigs(), PlanOptions(tracking_delay_s=DELAY, certify=False)).trajectory.duration > 0.0
    with pytest.raises(AssertionError, match="looked for"):
        plan(robot, between_twigs(), PlanOptions(tracking_delay_s=DELAY))


def test_lower_ceilings_are_tried_in_turn(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a certificate is refused for the first ones; the last refusal is told."""
    tried: list[float] = []

    def note(robot: Robot, path: object, field: object, delay_s: float, fraction: float, averaged_s: float) -> object:
        tried.append(fraction)
        return lambda grid: np.full(len(grid), np.inf)  # no ceiling at all: nothing can be certified

    monkeypatch.setattr(certified_motion, "SpeedCeiling", note)
    found = plan(robot, between_twigs(), PlanOptions(effort="quick")).motion
    task = replace(found.task, options=PlanOptions(tracking_delay_s=0.1))
    with pytest.raises(CertificationError, match="100 ms"):
        certified_motion.certified_trajectory(task, found.path)
    assert tried == list(certified_motion.CEILINGS)
