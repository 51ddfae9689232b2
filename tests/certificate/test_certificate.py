"""The certificate against coal at 0.1 ms, and against slightly wrong motions."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from planned import on_cubics, straight

from hplan.certificate import certificate as certificates
from hplan.certificate.clearance_proof import point_at, prove_clearance
from hplan.certificate.motion_bound import motion_of_movers
from hplan.certificate.turning_in_place import clearance_in_place
from hplan.collision.coal_scene import CoalScene
from hplan.geometry.shape_outline import outline
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.trajectory.trajectory import Trajectory

FINE = 1e-4


def certify(*arguments, rest_to_rest=False, check_ends=False, **options):
    """Certify motions that need not begin and end at rest, or at start and goal."""
    return certificates.certify(*arguments, rest_to_rest=rest_to_rest, check_ends=check_ends, **options)


def rows(robot, time, position, velocity, acceleration=None):
    """A trajectory from its samples."""
    position, velocity = np.asarray(position, dtype=float), np.asarray(velocity, dtype=float)
    acceleration = np.zeros_like(position) if acceleration is None else acceleration
    return Trajectory(robot.joint_names, np.asarray(time, dtype=float), position, velocity, acceleration, 0 * position)


def interpolated(trajectory, step=FINE):
    """The cubic Hermite curve through the samples, evaluated every `step` seconds."""
    time = np.union1d(np.arange(0.0, trajectory.duration, step), trajectory.time)
    return on_cubics(trajectory, time)


def sampled_clearance(checker, trajectory, step=FINE):
    return min(checker.distances(q).min() for q in interpolated(trajectory, step))


def swing(robot, start, end, duration, count):
    """The shoulder at constant speed, the arm stretched out."""
    time = np.linspace(0.0, duration, count)
    position = np.zeros((count, 4))
    position[:, 1] = np.linspace(start, end, count)
    velocity = np.zeros((count, 4))
    velocity[:, 1] = (end - start) / duration
    return rows(robot, time, position, velocity)


def grazed_ball(depth, angle):
    """A ball just beyond the tip of the stretched arm, entered by `depth` as the shoulder passes `angle`."""
    distance = 2.2 + 0.03 + 0.02 - depth
    center = (distance * np.cos(angle), 0.0, 0.6 + distance * np.sin(angle))
    return Sphere(name="bead", center=center, radius=0.02)


# Clearance


def test_graze_between_rows_is_refused(robot, scene):
    trajectory = swing(robot, 0.301, 0.901, 0.6, 101)
    scene = scene.with_obstacles([grazed_ball(1e-4, 0.604)])
    checker = CoalScene(robot, scene.solids)
    at_rows = min(checker.distances(q).min() for q in trajectory.position)
    assert at_rows > 1e-4
    assert sampled_clearance(checker, trajectory) == pytest.approx(-1e-4, abs=1e-6)
    certificate = certify(robot, scene, trajectory)
    assert not certificate.verified
    assert certificate.nearest.obstacle == "bead"
    assert certificate.nearest.link == "hand"


def test_near_miss_is_verified_and_its_clearance_close(robot, scene):
    trajectory = swing(robot, 0.301, 0.901, 0.6, 101)
    for gap in (1e-4, 1e-2):
        certificate = certify(robot, scene.with_obstacles([grazed_ball(-gap, 0.604)]), trajectory)
        assert certificate.verified, certificate.violations
        assert 0.3 * gap < certificate.min_clearance_m <= gap + 1e-9
    # The scene's clearance is required.
    scene = scene.with_obstacles([grazed_ball(-0.01, 0.604)])
    assert certify(robot, scene.model_copy(update={"clearance": 0.0099}), trajectory).verified
    refused = certify(robot, scene.model_copy(update={"clearance": 0.0101}), trajectory)
    assert not refused.verified
    assert refused.min_clearance_m == pytest.approx(0.0101, abs=2e-5)  # the distance where the proof failed


def test_contact_after_a_long_graze_is_found_early(robot, scene):
    count = 201
    yaw, drop = np.linspace(0.0, 1.5, count), np.clip(np.linspace(-9.0, 1.0, count), 0.0, None)
    position = np.column_stack([yaw, np.zeros(count), np.zeros(count), -0.3 * drop])
    velocity = np.zeros((count, 4))
    trajectory = rows(robot, np.linspace(0.0, 3.0, count), position, velocity)
    table = Box(name="table", center=(1.4, 0.0, 0.6 - 0.05 - 2e-5 - 0.1), size=(2.6, 5.0, 0.2))
    certificate = certify(robot, scene.with_obstacles([table]), trajectory)
    assert not certificate.verified
    assert certificate.nearest_s is None
    assert certificate.min_clearance_m < -0.05
    assert certificate.checks < 3_000


@pytest.mark.parametrize("depth", [-0.01, 0.02])
def test_verdict_alone_is_that_of_the_measured_proof(robot, scene, depth):
    bezier = swing(robot, 0.301, 0.901, 0.6, 101).segments[0]
    checker = CoalScene(robot, scene.with_obstacles([grazed_ball(depth, 0.604)]).solids)
    whole, verdict = (prove_clearance(bezier, checker, np.zeros((1, 4)), 0.0, measured=each) for each in (True, False))
    assert (verdict.outcome, verdict.end) == (whole.outcome, whole.end)
    assert verdict.is_certified == (depth < 0.0)
    assert verdict.checks == whole.checks if depth < 0.0 else verdict.checks < whole.checks


def test_contact_at_an_end_is_refused(robot, scene):
    inside = np.radians([0, 52, 0, 0])
    checker = CoalScene(robot, scene.solids)
    depth = checker.distances(inside).min()
    assert depth < -1e-3
    resting = rows(robot, [0.0], [inside], np.zeros((1, 4)))
    certificate = certify(robot, scene, resting)
    assert not certificate.verified
    assert certificate.min_clearance_m == pytest.approx(depth)
    outside = np.zeros(4)
    for start, end in ((inside, outside), (outside, inside)):
        assert not certify(robot, scene, straight(robot, start, end, 6.0)).verified


def random_obstacles(rng):
    obstacles = []
    for index in range(6):
        center = rng.uniform([-0.6, -0.6, 0.2], [2.2, 1.5, 2.6])
        size = rng.uniform(0.02, 0.15)
        if index % 3 == 0:
            obstacles.append(Sphere(name=f"o{index}", center=tuple(center), radius=size))
        elif index % 3 == 1:
            end = center + rng.uniform(-0.5, 0.5, 3)
            obstacles.append(Capsule(name=f"o{index}", start=tuple(center), end=tuple(end), radius=size))
        else:
            edges = tuple(rng.uniform(0.05, 0.4, 3))
            rpy = tuple(rng.uniform(-180, 180, 3))
            obstacles.append(Box(name=f"o{index}", center=tuple(center), size=edges, rpy_deg=rpy))
    return obstacles


def test_random_motions_are_judged_as_dense_sampling_judges_them(robot, scene):
    rng = np.random.default_rng(3)
    shown = refused = 0
    while shown + refused < 60:
        world = scene.with_obstacles(random_obstacles(rng))
        checker = CoalScene(robot, world.solids)
        start, end = rng.uniform(robot.lower, robot.upper, (2, 4))
        start[0], end[0] = rng.uniform(-0.5, 1.0, 2)
        if checker.distances(start).min() <= 1e-3:
            continue
        trajectory = straight(robot, start, end, 0.4)  # so fast that limits are broken; only clearance is judged here
        certificate = certify(robot, world, trajectory, checker=checker)
        sampled = sampled_clearance(checker, trajectory)
        if any(violation.startswith("link") for violation in certificate.violations):
            refused += 1
            assert sampled < 1e-4
            assert certificate.min_clearance_m <= 0.0
        else:
            shown += 1
            assert sampled > 0.0
            least = min(sampled, clearance_in_place(checker, (0.0, 1.0), 0.0, np.inf).distance_m)
            assert 0.4 * least - 1e-6 < certificate.min_clearance_m <= least + 1e-9
    assert min(shown, refused) >= 10


def test_certified_clearance_is_bounded_when_motion_ends_before_next_query(robot, scene):
    """The stretched arm turns toward a ball at maximum speed, and stops before it."""
    ball = Sphere(name="far", center=(0.0, 2.0, 0.6), radius=0.05)
    world = scene.with_obstacles([ball])
    checker = CoalScene(robot, world.solids)
    for end in np.arange(0.1, 1.35, 0.05).tolist():
        trajectory = straight(robot, np.zeros(4), np.array([end, 0.0, 0.0, 0.0]), 4.0)
        certificate = certify(robot, world, trajectory)
        assert certificate.verified
        true = checker.distances(trajectory.position[-1]).min()
        assert 0.25 * true < certificate.min_clearance_m <= true


def test_no_point_of_a_link_travels_farther_than_its_bound(robot, scene):
    """Points of the shapes along random lines; for capsules the ends of their axes.

    A capsule is two balls around them, and their hull.
    """
    checker, rng = CoalScene(robot, scene.solids), np.random.default_rng(3)
    lines = np.linspace(0.0, 1.0, 4)[:, None] * 0.3 * rng.normal(size=(30, 1, 4))
    bezier = rng.uniform(robot.lower, robot.upper, (30, 1, 4)) + lines
    deviations = np.full((1, 4), 1e-3)
    mover_of, moved, sways = motion_of_movers(checker, bezier, deviations)
    data, used = robot.model.createData(), 0.0

    def placed(q, shape):
        pin.forwardKinematics(robot.model, data, q)
        local, _ = outline(shape, rim_from_outside=False)
        return np.array([(data.oMi[shape.parentJoint] * shape.placement).act(point) for point in local])

    for piece, off in itertools.product(range(30), rng.uniform(-1e-3, 1e-3, (2, 4))):
        start, end = (point_at(bezier[piece : piece + 1], at) for at in (0.0, 1.0))
        for number, shape in enumerate(checker.link_shapes):
            mover, here = mover_of[number * len(scene.solids)], placed(start, shape)
            went = np.linalg.norm(placed(end, shape) - here, axis=1).max()
            assert went <= moved[mover, piece] + 1e-9
            assert np.linalg.norm(placed(start + off, shape) - here, axis=1).max() <= sways[mover, 0] + 1e-9
            used = max(used, went / max(moved[mover, piece], 1e-12))
    assert used > 0.4


# Limits


@pytest.mark.parametrize(("share", "verified"), [(1.0, True), (1.0009, True), (1.0011, False), (1.005, False)])
def test_velocity(robot, scene, share, verified):
    speed = share * robot.velocity_limit[1]
    certificate = certify(robot, scene.with_obstacles([]), swing(robot, 0.2, 0.2 + 0.5 * speed, 0.5, 101))
    assert certificate.limit_use.velocity == pytest.approx(share, abs=1e-9)
    assert certificate.verified is verified
    assert [v.split()[0] for v in certificate.violations] == ([] if verified else ["velocity"])


@pytest.mark.parametrize(("share", "verified"), [(1.0, True), (1.005, False)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_acceleration(robot, scene, share, verified, sign):
    acceleration = sign * share * robot.acceleration_limit
    time = np.linspace(0.0, 0.2, 51)[:, None]
    start = 0.5 * (robot.lower + robot.upper)
    trajectory = rows(robot, time[:, 0], start + 0.5 * acceleration * time**2, acceleration * time)
    certificate = certify(robot, scene.with_obstacles([]), trajectory)
    assert certificate.limit_use.acceleration == pytest.approx(share, rel=1e-9)
    assert certificate.verified is verified
    assert [v.split()[0] for v in certificate.violations] == ([] if verified else ["acceleration"])


@pytest.mark.parametrize(("share", "verified"), [(1.0, True), (1.005, False)])
def test_torque(robot, scene, share, verified):
    trajectory = straight(robot, np.radians([0, 10, 20, 30]), np.radians([20, 40, 40, 10]), 3.0)
    data = robot.model.createData()
    torque = np.array(
        [
            pin.rnea(robot.model, data, *row)
            for row in zip(trajectory.position, trajectory.velocity, trajectory.acceleration, strict=True)
        ]
    )
    limit = np.array(robot.torque_limit)
    limit[2] = np.abs(torque[:, 2]).max() / share
    certificate = certify(replace(robot, torque_limit=limit), scene.with_obstacles([]), trajectory)
    assert certificate.limit_use.torque == pytest.approx(share, rel=1e-4)
    assert certificate.verified is verified
    assert [v.split()[0] for v in certificate.violations] == ([] if verified else ["torque"])


@pytest.mark.parametrize("beyond", [0.0, 0.005])
@pytest.mark.parametrize("joint", [0, 1, 3])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_position(robot, scene, beyond, joint, side):
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    end = middle.copy()
    end[joint] += side * (1.0 + beyond) * half[joint]
    certificate = certify(robot, scene.with_obstacles([]), straight(robot, middle, end, 6.0))
    assert certificate.limit_use.position == pytest.approx(1.0 + beyond, abs=1e-9)
    assert [v.split()[0] for v in certificate.violations] == (["position"] if beyond else [])


def test_limits_are_exact_for_random_rows(robot, scene):
    rng = np.random.default_rng(5)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.3, 12))])
    trajectory = rows(robot, time, rng.uniform(0.2, 1.2, (13, 4)), rng.uniform(-1, 1, (13, 4)))
    use = certify(robot, scene.with_obstacles([]), trajectory).limit_use
    curve = interpolated(trajectory)
    grid = np.union1d(np.arange(0.0, trajectory.duration, FINE), trajectory.time)
    velocity = np.diff(curve, axis=0) / np.diff(grid)[:, None]
    assert use.velocity == pytest.approx((np.abs(velocity) / robot.velocity_limit).max(), rel=1e-3)
    even = interpolated(trajectory)[np.isin(grid, np.arange(0.0, trajectory.duration, FINE))]
    acceleration = np.diff(even, 2, axis=0) / FINE**2
    assert use.acceleration == pytest.approx((np.abs(acceleration) / robot.acceleration_limit).max(), rel=0.02)
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    assert use.position >= (np.abs(curve - middle) / half).max() - 1e-12


# Trajectories from elsewhere


def test_velocity_column_that_leads_into_the_obstacle(robot, scene):
    """Two equal samples far from the obstacle; their velocities bend the curve into it."""
    position = np.tile([0.0, 0.5, 0.05, 0.05], (2, 1))
    velocity = np.array([[0, 1.0, 0, 0], [0, -1.0, 0, 0]])
    trajectory = rows(robot, [0.0, 1.0], position, velocity)  # rises by 0.25 rad half-way
    tip = np.array([2.19 * np.cos(0.75), 0.0, 0.6 + 2.19 * np.sin(0.75)])
    world = scene.with_obstacles([Sphere(name="above", center=tuple(tip), radius=0.05)])
    assert CoalScene(robot, world.solids).distances(position[0])[:, 0].min() > 0.3
    certificate = certify(robot, world, trajectory)
    assert not certificate.verified
    assert any("above" in violation for violation in certificate.violations)


# Rest and the columns that a controller may feed forward


@pytest.mark.parametrize("end", ["begins", "ends", "both"])
def test_motion_that_is_not_at_rest_at_its_ends_is_refused(robot, scene, end):
    moving = swing(robot, 0.3, 0.4, 0.2, 51)
    velocity = np.array(moving.velocity)
    if end != "both":
        velocity[-1 if end == "begins" else 0] = 0.0
    certificate = certify(robot, scene.with_obstacles([]), replace(moving, velocity=velocity), rest_to_rest=True)
    told = [violation.split()[2] for violation in certificate.violations if violation.startswith("the motion")]
    assert told == (["begins", "ends"] if end == "both" else [end])


def test_motions_one_after_the_other(robot, scene):
    """The worst of all parts."""
    there = straight(robot, np.zeros(4), np.array([0.2, 0.0, 0.0, 0.0]))
    back = there.reversal
    moving = replace(back, velocity=np.where(np.arange(back.samples)[:, None] == back.samples - 1, 0.1, back.velocity))
    near = scene.with_obstacles([Sphere(name="near", center=(1.0, -0.3, 0.6), radius=0.1)])
    far = scene.with_obstacles([Sphere(name="far", center=(1.0, -0.8, 0.6), radius=0.1)])
    parts = [certify(robot, far, there), certify(robot, near, moving, rest_to_rest=True)]
    for some in (parts, parts[::-1]):
        whole = certificates.all_of(some)
        assert not whole.verified
        assert whole.min_clearance_m == parts[1].min_clearance_m < parts[0].min_clearance_m
        assert whole.nearest.obstacle == "near"
        assert whole.checks == parts[0].checks + parts[1].checks
        assert whole.violations == parts[1].violations
        for name, value in vars(whole.limit_use).items():
            assert value == max(getattr(part.limit_use, name) for part in parts)
    assert certificates.all_of(parts[:1]) is parts[0]
    assert certificates.all_of([parts[0], parts[0]]).verified


@pytest.mark.parametrize("column", ["acceleration", "torque"])
def test_column_beyond_the_limit_is_refused(robot, scene, column):
    motion = straight(robot, np.zeros(4), np.array([0.0, 0.2, 0.1, 0.1]))
    values = np.array(getattr(motion, column))
    values[7, 2] = 1e4
    certificate = certify(robot, scene, replace(motion, **{column: values}))
    assert [violation.split()[0] for violation in certificate.violations] == [column]
