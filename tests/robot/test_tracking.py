"""The model of tracking errors: its values, and the proof under it against deviations drawn inside it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planned import between_twigs

from hplan.certificate.certificate import Certificate, certify
from hplan.collision.coal_scene import CoalScene
from hplan.errors import BlockedError, CertificationError, NoPathError
from hplan.planar.family_reader import family_of
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Solid, Sphere
from hplan.trajectory.trajectory import Trajectory

STILL, DELAY = 0.004, 0.02


def trajectory_of(robot: Robot, time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> Trajectory:
    zero = np.zeros_like(position)
    return Trajectory(robot.joint_names, time, position, velocity, zero, zero)


def swinging(robot: Robot, start: np.ndarray, end: np.ndarray, rng: np.random.Generator, rows: int = 15) -> Trajectory:
    """A motion between two configurations, with strongly varying velocities."""
    time = np.cumsum(np.append(0.0, rng.uniform(0.01, 0.1, rows - 1)))
    share = (time / time[-1])[:, None]
    position = start + (end - start) * share * share * (3.0 - 2.0 * share)
    return trajectory_of(robot, time, position, np.gradient(position, time, axis=0) * rng.uniform(0.2, 1.8, (rows, 1)))


def sampled(trajectory: Trajectory, per_piece: int) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of the cubics through the samples, densely."""
    h = np.diff(trajectory.time)[:, None, None]
    t = np.linspace(0.0, 1.0, per_piece)[:, None]
    q, v = trajectory.position[:, None], trajectory.velocity[:, None]
    a, b, m, n = q[:-1], q[1:], h * v[:-1], h * v[1:]
    position = a + t * m + t**2 * (3 * (b - a) - 2 * m - n) + t**3 * (2 * (a - b) + m + n)
    velocity = (m + 2 * t * (3 * (b - a) - 2 * m - n) + 3 * t**2 * (2 * (a - b) + m + n)) / h
    return position.reshape(-1, q.shape[-1]), velocity.reshape(-1, q.shape[-1])


def cluttered(rng: np.random.Generator) -> list[Solid]:
    """A few obstacles within reach."""
    solids: list[Solid] = []
    for number in range(4):
        x, y, z = rng.uniform([0.4, -0.8, 0.4], [2.0, 1.2, 2.2])
        if number % 3 == 0:
            solids.append(Sphere(name=f"o{number}", center=(x, y, z), radius=0.1))
        elif number % 3 == 1:
            solids.append(Capsule(name=f"o{number}", start=(x, y, z), end=(x + 0.3, y, z - 0.2), radius=0.05))
        else:
            solids.append(Box(name=f"o{number}", center=(x, y, z), size=(0.2, 0.1, 0.3), rpy_deg=(20, 40, 60)))
    return solids


def keeps_clear(certificate: Certificate) -> bool:
    """True if the clearance is certified, regardless of limits."""
    return not any(violation.startswith("link") for violation in certificate.violations)


def test_deviations_grow_with_speed() -> None:
    model = TrackingModel(0.01, 0.003)
    np.testing.assert_allclose(model.deviations([[0.0, -2.0], [1.0, 0.5]]), [[0.01, 0.016], [0.013, 0.0115]])
    assert TrackingModel().is_exact
    assert not TrackingModel(delay_s=1e-3).is_exact
    assert not TrackingModel(1e-3).is_exact
    assert model.scale(0.5) == TrackingModel(0.005, 0.0015)


@pytest.mark.parametrize("seed", range(3))
def test_no_deviation_inside_the_model_comes_nearer_than_certified(robot: Robot, scene: Scene, seed: int) -> None:
    """Every joint is off by at most the modelled error, at dense instants."""
    rng = np.random.default_rng(seed)
    shown = 0
    while shown < 4:
        world = scene.with_obstacles(cluttered(rng))
        checker = CoalScene(robot, world.solids)
        start, end = rng.uniform(robot.lower, robot.upper, (2, robot.dof))
        start[0], end[0] = rng.uniform(-0.5, 0.5, 2)
        trajectory = swinging(robot, start, end, rng)
        certificate = certify(robot, world, trajectory, tracking_error=STILL, tracking_delay_s=DELAY, checker=checker)
        if not keeps_clear(certificate) or certificate.min_clearance_m > 0.1:
            continue
        shown += 1
        position, velocity = sampled(trajectory, 12)
        off = TrackingModel(STILL, DELAY).deviations(velocity)
        nearest = math.inf
        for q, most in zip(position, off, strict=True):
            for sign in (*rng.choice([-1.0, 1.0], (6, robot.dof)), *rng.uniform(-1.0, 1.0, (2, robot.dof))):
                nearest = min(nearest, checker.distances(q + sign * most).min())
        assert nearest >= certificate.min_clearance_m


def stretched(robot: Robot, shoulder: np.ndarray, speed: np.ndarray, step: float) -> Trajectory:
    """The stretched arm with the shoulder alone moving, in samples `step` apart [s]."""
    position, velocity = np.zeros((2, len(shoulder), robot.dof))
    position[:, 1], velocity[:, 1] = shoulder, speed
    return trajectory_of(robot, step * np.arange(len(shoulder)), position, velocity)


def beside_the_tip(robot: Robot, joint: int, gap: float) -> Sphere:
    """A ball `gap` from the tip of the level stretched arm, in a joint's turning direction."""
    tip = robot.tool_positions(np.zeros(4))
    turn = robot.tool_positions(1e-6 * np.eye(4)[joint]) - tip
    out = (family_of(robot).arm.half_widths[-1] + 0.02 + gap) * turn / np.linalg.norm(turn)
    return Sphere(name="bead", center=tuple((tip + out).tolist()), radius=0.02)


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("still", [0.0, 0.002])
def test_displacement_bound_is_tight(robot: Robot, scene: Scene, joint: int, still: float) -> None:
    """One joint leaves an obstacle at constant speed.

    Refused exactly where a tracking error would touch it.
    """
    levers = np.array([2.2, 2.2, 1.2, 0.4])  # of the tip about the joints
    speed, delay = 0.5, 0.01
    level, upright = still * levers[0], still * levers[1:].sum()
    reached = delay * speed * levers[joint] + (level if joint == 0 else upright)
    never_both = upright if joint == 0 else level
    velocity = np.tile(-speed * np.eye(4)[joint], (2, 1))
    trajectory = trajectory_of(robot, np.array([0.0, 0.004]), np.array([[0.0], [0.004]]) * velocity, velocity)
    for gap, shown in ((0.98 * reached, False), (1.02 * (reached + never_both), True)):
        world = scene.with_obstacles([beside_the_tip(robot, joint, gap)])
        certificate = certify(robot, world, trajectory, tracking_error=still, tracking_delay_s=delay)
        assert keeps_clear(certificate) == shown


def test_jerks_on_the_spot_count_by_their_speed(robot: Robot, scene: Scene) -> None:
    """Jerky motions with hardly any travel, and a ball slightly beyond the bound."""
    rng = np.random.default_rng(5)
    closest, refused, touching = math.inf, 0, 0
    for _ in range(150):
        still = rng.random(12) < 0.6
        speed = np.where(still, 0.0, rng.uniform(-0.4, 0.4, 12))
        place = np.cumsum(np.where(rng.random(12) < 0.7, 0.0, rng.uniform(-5e-4, 2e-4, 12)))
        step = rng.choice([2e-3, 0.02])
        gap, delay = rng.uniform(0.002, 0.05), 0.03
        trajectory = stretched(robot, place, speed, step)
        world = scene.with_obstacles([beside_the_tip(robot, 1, gap)])
        checker = CoalScene(robot, world.solids)
        certificate = certify(robot, world, trajectory, tracking_delay_s=delay, rest_to_rest=False, checker=checker)
        position, velocity = sampled(trajectory, 9)
        nearest = min(checker.distances(q).min() for q in position + delay * np.abs(velocity))
        touching += nearest <= 0.0
        if keeps_clear(certificate):
            assert nearest >= certificate.min_clearance_m
            closest = min(closest, nearest)
        else:
            refused += 1
    assert touching > 40
    assert refused < 115
    assert closest < 2e-3


def test_upper_arm_keeps_its_own_displacement(robot: Robot) -> None:
    """A ball 60 mm from the upper arm, far from the tool.

    The upper arm is displaced by at most 35 mm with 1 deg per joint, the tool by 105 mm.
    """
    along = math.radians(57.0)
    center = 0.5 * math.cos(along), 0.16, 0.6 + 0.5 * math.sin(along)
    scene = Scene(
        name="ball beside the upper arm",
        start=Start(joints_deg=(0.0, 30.0, 90.0, 0.0)),
        goal=Goal(joints_deg=(0.0, 85.0, 90.0, 0.0)),
        locked_joints=("base_yaw",),
        obstacles=(Sphere(name="ball", center=center, radius=0.03),),
    )
    result = plan(robot, scene, PlanOptions(tracking_error=math.radians(1.0)))
    assert result.certificate.verified
    assert result.certificate.min_clearance_m > 0.02


def test_refusal_of_all_grasps_names_the_largest_error(robot: Robot) -> None:
    """True: with 99 % of it the fruit is not blocked, and is picked; with 101 % it is blocked."""
    scene = between_twigs(0.09)
    with pytest.raises(BlockedError) as refused:
        plan(robot, scene, PlanOptions(tracking_error=math.radians(1.0)))
    facts = refused.value.data
    assert facts["tracking_error_deg"] == pytest.approx(1.0)
    largest = math.radians(facts["largest_tracking_error_deg"])
    assert f"would succeed with up to {facts['largest_tracking_error_deg']:.4g} deg" in refused.value.message
    assert plan(robot, scene, PlanOptions(tracking_error=0.99 * largest)).certificate.verified
    with pytest.raises(BlockedError):
        plan(robot, scene, PlanOptions(tracking_error=1.01 * largest))
    wall = Box(name="wall", center=(1.6, 0.0, 1.43), size=(1.0, 1.0, 0.05))
    with pytest.raises(BlockedError) as closed:
        plan(robot, scene.with_obstacles([wall]), PlanOptions(tracking_error=math.radians(1.0)))
    assert "tracking_error_deg" not in closed.value.data


def turning_above_a_bead(gap: float) -> Scene:
    """Only the base turns, the tip of the arm a little above a ball half way."""
    tip = (2.2 * math.cos(math.radians(30.0)), 2.2 * math.sin(math.radians(30.0)), 0.6)
    center = (tip[0], tip[1], tip[2] - 0.03 - 0.02 - gap)
    return Scene(
        name="above a bead",
        start=Start(joints_deg=(0.0, 0.0, 0.0, 0.0)),
        goal=Goal(joints_deg=(60.0, 0.0, 0.0, 0.0)),
        locked_joints=("shoulder", "elbow", "wrist"),
        obstacles=(Sphere(name="bead", center=center, radius=0.02),),
    )


@pytest.mark.parametrize("delay_s", [0.0, 0.01])
def test_refusal_names_largest_possible_tracking_error(robot: Robot, delay_s: float) -> None:
    """True: the motion found without an error is certified with that much, and not with a little more."""
    gap = 0.02
    scene, error = turning_above_a_bead(gap), math.radians(1.0)
    with pytest.raises((NoPathError, CertificationError)) as refused:
        plan(robot, scene, PlanOptions(tracking_error=error, tracking_delay_s=delay_s))
    facts, motion = refused.value.data, plan(robot, scene).trajectory
    assert (facts["tracking_error_deg"], facts["tracking_delay_ms"]) == (pytest.approx(1.0), 1e3 * delay_s)
    assert "allows up to" in refused.value.message
    share = facts["largest_tracking_error_deg"]
    assert facts["largest_tracking_delay_ms"] == pytest.approx(share * 1e3 * delay_s)
    for factor, shown in ((0.999, True), (1.01, False)):
        asked = {"tracking_error": factor * share * error, "tracking_delay_s": factor * share * delay_s}
        assert certify(robot, scene, motion, **asked).verified == shown
    if delay_s == 0.0:
        assert family_of(robot).sway(share * error)[-1] == pytest.approx(gap, rel=0.01)
