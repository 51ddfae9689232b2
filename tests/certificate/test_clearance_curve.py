"""Values along the motion: the clearance curve against coal, use of position limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planned import on_cubics
from toy_urdf import urdf

from hplan.certificate.certificate import Certificate, all_of, certificate_of_part, certify
from hplan.certificate.clearance_curve import ClearanceCurve, ProvedMotion
from hplan.certificate.limit_use import limit_use
from hplan.collision.coal_scene import CoalScene
from hplan.errors import OptionError
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Obstacle, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory


def random_motion(robot: Robot, random: np.random.Generator, duration: float, count: int = 40) -> Trajectory:
    """Samples of a few sines, with cubics of their positions and velocities."""
    time = np.sort(np.append([0.0, duration], random.uniform(0.0, duration, count - 2)))
    frequency, phase = random.uniform(0.5, 4.0, (2, 3, robot.dof))
    size = random.uniform(0.0, 0.4, (3, robot.dof))
    angle = frequency * time[:, None, None] + phase
    position, velocity = (size * np.sin(angle)).sum(axis=1), (size * frequency * np.cos(angle)).sum(axis=1)
    nothing = np.zeros_like(position)
    middle = 0.5 * (robot.lower + robot.upper)
    return Trajectory(robot.joint_names, time, middle + position, velocity, nothing, nothing)


def random_scene(random: np.random.Generator) -> Scene:
    def place() -> Any:
        direction = random.normal(size=3)
        return tuple(random.uniform(0.7, 2.0) * direction / np.linalg.norm(direction) + (0.0, 0.0, 0.7))

    obstacles: list[Obstacle] = [Sphere(name=f"ball {k}", center=place(), radius=0.1) for k in range(8)]
    obstacles.append(Capsule(name="branch", start=place(), end=place(), radius=0.03))
    obstacles.append(Box(name="crate", center=place(), size=(0.3, 0.2, 0.1), rpy_deg=(10.0, 20.0, 30.0)))
    return Scene(
        name="random", start=Start(joints_deg=(0,) * 4), goal=Goal(joints_deg=(0,) * 4), obstacles=tuple(obstacles)
    )


def certified(robot: Robot, scene: Scene, motion: Trajectory, **options: Any) -> tuple[Certificate, ClearanceCurve]:
    certificate = certify(robot, scene, motion, check_ends=False, rest_to_rest=False, **options)
    curve = certificate.clearance_curve
    assert curve is not None
    return certificate, curve


def motions_of(certificate: Certificate) -> list[ProvedMotion]:
    assert certificate.subject is not None
    return [motion for motion, _ in certificate.subject.motions]


def check_against_coal(certificate: Certificate, step: float = 2e-3) -> int:
    """Coal at fine times of each motion; gives how often it was nearer than 10 cm."""
    near = 0
    for motion in motions_of(certificate):
        curve, rows = motion.curve, motion.trajectory.time
        for part, checker, deviations, *_ in motion.stretches:
            last = rows[min(part.stop, len(rows) - 1)]
            clock = np.unique([*np.arange(rows[part.start], last, step), *rows[part.start : part.stop], last])
            covering = checker.with_margins(float(deviations.max()), motion.clearance)
            sways = covering.pair_sways(deviations)
            found = np.array([covering.pair_distances(q) for q in on_cubics(motion.trajectory, clock)])
            piece = np.clip(np.searchsorted(rows, clock, side="right") - 1 - part.start, 0, sways.shape[1] - 1)
            bound = np.interp(clock, curve.time, curve.clearance_m)
            assert (bound <= (found - sways[:, piece].T).min(axis=1)).all()
            near += int((found.min(axis=1) < 0.1).sum())
    return near


@pytest.mark.parametrize("seed", range(6))
def test_curve_is_nowhere_above_the_true_clearance(robot: Robot, seed: int) -> None:
    random = np.random.default_rng(seed)
    motion = random_motion(robot, random, 2.0)
    scene = random_scene(random)
    beside = robot.tool_positions(motion.position[::9]) + random.uniform(-0.1, 0.1, 3)
    balls = [Sphere(name=f"beside {k}", center=tuple(center), radius=0.05) for k, center in enumerate(beside)]
    scene = scene.with_obstacles([*scene.obstacles, *balls])
    options: dict[str, Any] = [{}, {"tracking_error": 0.004}, {"tracking_delay_s": 0.01}][seed % 3]
    certificate, curve = certified(robot, scene, motion, **options)
    assert check_against_coal(certificate) > 0
    assert curve.time[0] == 0.0
    assert curve.time[-1] == pytest.approx(2.0)
    assert (np.diff(curve.time) > 0.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_distances_and_names_at_the_stations_are_coals(robot: Robot, seed: int) -> None:
    random = np.random.default_rng(100 + seed)
    certificate, curve = certified(robot, random_scene(random), random_motion(robot, random, 1.0))
    (motion,) = motions_of(certificate)
    ((_, checker, *_),) = motion.stretches
    for q, distance, nearest in zip(
        on_cubics(motion.trajectory, curve.time), curve.distance_m, curve.nearest, strict=True
    ):
        expected = checker.nearest_contact(q)
        assert expected is not None
        assert distance == pytest.approx(expected.distance_m, abs=1e-7)
        found = checker.distances(q)[
            checker.mover_names.index(curve.pairs[nearest][0]), checker.obstacle_names.index(curve.pairs[nearest][1])
        ]
        assert found == pytest.approx(expected.distance_m, abs=1e-7)
    # Tight: the bound is within the travel between two stations.
    gap = curve.distance_m - curve.clearance_m
    assert (gap < 1e-3 + 0.2 * np.abs(curve.distance_m)).mean() > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_thinned_it_is_nowhere_higher(robot: Robot, seed: int) -> None:
    random = np.random.default_rng(200 + seed)
    _, curve = certified(robot, random_scene(random), random_motion(robot, random, 1.5))
    thin = curve.thin(50)
    assert len(thin.time) == 50
    clock = np.union1d(np.linspace(0.0, 1.5, 4001), curve.time)
    high, low = (np.interp(clock, each.time, each.clearance_m) for each in (curve, thin))
    assert (low <= high + 1e-12).all()
    assert thin.clearance_m.min() == pytest.approx(curve.clearance_m.min())
    assert thin.distance_m.min() == curve.distance_m.min()
    assert curve.thin(len(curve.time)) is curve
    with pytest.raises(OptionError):
        curve.thin(1)


@pytest.fixture(scope="module")
def picked(robot: Robot) -> Any:
    return plan(robot, load_scene("trellis"))


def test_of_a_plan_it_covers_all_phases(picked: Any) -> None:
    certificate, curve = picked.certificate, picked.certificate.clearance_curve
    assert certificate.verified
    assert curve.time[-1] == pytest.approx(picked.trajectory.duration, abs=1e-9)
    assert curve.clearance_m.min() >= certificate.min_clearance_m
    check_against_coal(certificate, step=5e-3)
    # The last link may touch the fruit from the stand-off on.
    fruit = load_scene("trellis").goal.fruit
    approach = picked.phases[1]
    assert ("hand", fruit) not in {
        curve.pairs[n] for t, n in zip(curve.time, curve.nearest, strict=True) if t > approach.end_s - 1e-3
    }


def test_motion_backwards_has_the_curve_backwards(picked: Any) -> None:
    there, back = picked.certificate.clearance_curve, picked.certificate.reversal.clearance_curve
    clock = np.linspace(0.0, there.time[-1], 500)
    np.testing.assert_allclose(
        np.interp(there.time[-1] - clock, back.time, back.clearance_m),
        np.interp(clock, there.time, there.clearance_m),
        atol=1e-6,
    )
    # The retreat is the approach backwards, and the plan's certificate knows.
    both = all_of([picked.certificate, picked.certificate.reversal]).clearance_curve
    assert both.time[-1] == pytest.approx(2.0 * there.time[-1])
    np.testing.assert_allclose(
        np.interp(clock, both.time, both.distance_m), np.interp(clock, there.time, there.distance_m), atol=1e-6
    )


@pytest.mark.parametrize("seed", range(4))
def test_part_of_a_motion_has_its_part_of_the_curve(picked: Any, seed: int) -> None:
    whole, time = picked.certificate, picked.trajectory.time
    begin_s, end_s = np.sort(np.random.default_rng(400 + seed).choice(time, 2, replace=False)).tolist()
    for certificate in (whole, whole.reversal):
        part = certificate_of_part(certificate, begin_s, end_s)
        assert part is not None
        assert part.verified
        curve, of_whole = part.clearance_curve, certificate.clearance_curve
        assert curve is not None
        assert of_whole is not None
        assert curve.time[-1] == pytest.approx(end_s - begin_s, abs=1e-9)
        clock = np.linspace(0.0, end_s - begin_s, 300)
        seen, expected = (
            np.interp(clock + at, each.time, each.distance_m) for each, at in ((curve, 0.0), (of_whole, begin_s))
        )
        np.testing.assert_allclose(seen, expected, atol=1e-2)
        assert whole.min_clearance_m <= part.min_clearance_m <= curve.clearance_m.min()
        if certificate is whole:
            check_against_coal(part, step=5e-3)


def test_part_without_segments_and_of_what_is_not_verified_has_no_certificate(picked: Any) -> None:
    time = picked.trajectory.time
    assert certificate_of_part(picked.certificate, time[9], time[9]) is None
    for other in ({"verified": False}, {"subject": None}):
        assert certificate_of_part(replace(picked.certificate, **other), 0.0, time[-1]) is None


@pytest.mark.parametrize("seed", range(3))
def test_where_obstacles_move_it_is_nowhere_above_their_distances_at_that_time(robot: Robot, seed: int) -> None:
    random = np.random.default_rng(300 + seed)
    motion, scene = random_motion(robot, random, 1.5), random_scene(random)
    turns = {"rpy_deg": tuple(map(tuple, random.uniform(-80.0, 80.0, (3, 3)))), "about": (0.5, 0.0, 0.5)}
    track = Track(times_s=(0.2, 0.9, 1.8), shifts_m=tuple(map(tuple, random.uniform(-0.5, 0.5, (3, 3)))), **turns)
    items = [item.model_copy(update={"track": track}) if k % 2 else item for k, item in enumerate(scene.obstacles)]
    _, curve = certified(robot, scene.with_obstacles(items), motion, begin_s=0.1)
    clock = np.linspace(0.0, 1.5, 101)
    bound = np.interp(clock, curve.time, curve.clearance_m)
    moved = scene.with_obstacles(items)
    for at, q, certain in zip(clock, on_cubics(motion, clock), bound, strict=True):
        there = CoalScene(robot, moved.snapshot(0.1 + at).solids)
        assert certain <= there.distances(q)[:, : there.own_first].min()
    np.testing.assert_array_less(curve.clearance_m, curve.distance_m)


def test_of_a_motion_too_fast_to_be_bounded_nothing_is_certain(robot: Robot) -> None:
    motion = random_motion(robot, np.random.default_rng(3), 1.0)
    velocity = motion.velocity.copy()
    velocity[20] = 1e300
    fast = Trajectory(motion.joint_names, motion.time, motion.position, velocity, motion.acceleration, motion.torque)
    certificate, curve = certified(robot, random_scene(np.random.default_rng(3)), fast)
    assert not certificate.verified
    assert (curve.clearance_m[curve.time > motion.time[20]] == -np.inf).all()
    assert np.isfinite(curve.clearance_m[curve.time < motion.time[19]]).all()
    assert np.isfinite(curve.distance_m).all()


ROBOT = load_robot(
    urdf().replace('"l0"', '"base_link"').replace('"l2"', '"tool0"').replace("effort=", 'acceleration="9" effort=')
)

numbers = st.floats(-2.0, 2.0) | st.sampled_from([0.0, 1e-9, -1e-9, 1.0])
rows = st.lists(st.tuples(numbers, numbers, numbers, numbers, st.floats(0.01, 2.0)), min_size=2, max_size=4)


def trajectory(time, position, velocity) -> Trajectory:
    none = np.zeros_like(position)
    return Trajectory(ROBOT.joint_names, time, position, velocity, none, none)


def position_use(motion: Trajectory) -> float:
    return limit_use(ROBOT, motion, *motion.segments).position


@settings(max_examples=60)
@given(rows)
def test_it_is_what_is_seen_at_many_times(values):
    table = np.array(values)
    motion = trajectory(np.concatenate([[0.0], np.cumsum(table[1:, 4])]), table[:, :2], 3.0 * table[:, 2:4])
    clock = np.concatenate([np.linspace(*ends, 1001) for ends in pairwise(motion.time)])
    seen = motion.positions(clock)
    most = float((np.abs(seen - 0.5 * (ROBOT.lower + ROBOT.upper)) / (0.5 * (ROBOT.upper - ROBOT.lower))).max())
    assert most - 1e-12 <= position_use(motion) <= most + 1e-5


def test_swing_that_turns_before_the_limit_keeps_it():
    """Its Bezier points are beyond the limit of 3 rad, and it is not."""
    motion = trajectory(np.array([0.0, 1.0]), np.array([[2.9, 0.0], [2.9, 0.0]]), np.array([[0.39, 0.0], [-0.39, 0.0]]))
    assert np.abs(motion.segments[0]).max() > 3.0
    assert position_use(motion) == pytest.approx((2.9 + 0.39 / 4.0) / 3.0)


@pytest.mark.parametrize("fast", [1e10, 1e160, 1e300])
def test_numbers_that_are_huge_in_between_are_seen(fast):
    motion = trajectory(np.array([0.0, 1.0]), np.zeros((2, 2)), np.array([[fast, 0.0], [0.0, 0.0]]))
    assert position_use(motion) >= 0.01 * fast


def test_overflow_gives_no_bound():
    motion = trajectory(np.array([0.0, 1e200]), np.zeros((2, 2)), np.array([[1e200, 0.0], [0.0, 0.0]]))
    assert position_use(motion) == np.inf
