"""Certificates in space and time, against coal alone at closely spaced times."""

from __future__ import annotations

import gc
import itertools
import math
import weakref
from dataclasses import replace

import numpy as np
import pytest
from arm_variants import axis_points, coal_distances, least_by_coal
from fitted_arms import quintic, scene_of
from hypothesis import given, settings
from hypothesis import strategies as st
from studies.validation.random_worlds import direction

from hplan.certificate.certificate import certify
from hplan.certificate.configuration_check import check
from hplan.certificate.moving_obstacles import checker_in_time, moving_base_contacts
from hplan.collision.coal_arm import BASE_DEPTH, base_bodies
from hplan.collision.coal_moving_solids import MovingSolids, largest_interval_rates
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import solid_shape
from hplan.errors import MovingObstacleError, OptionError
from hplan.geometry.shape_outline import coal_distance
from hplan.planar.family_reader import family_of
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal
from hplan.scene.obstacles import Box, Capsule, Mesh, PointCloud, Sphere
from hplan.scene.tracks import Drift, Movement, Sway, Track

REST = (0.0, 45.0, 45.0, 45.0)
AWAY = (60.0, 30.0, 50.0, 40.0)
STILL = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


def track(*points: tuple[float, tuple[float, float, float]], **more) -> Track:
    return Track(times_s=tuple(t for t, _ in points), shifts_m=tuple(p for _, p in points), **more)


def shown(certificate) -> bool:
    """True if the clearance is certified, regardless of limits."""
    return not any("comes to" in violation or "comes into" in violation for violation in certificate.violations)


def tip(robot: Robot, q_deg) -> np.ndarray:
    return robot.tool_positions(np.radians(q_deg))


coordinates = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
turns = st.tuples(*(st.floats(-60.0, 60.0),) * 3)


@settings(max_examples=25)
@given(
    st.lists(st.tuples(coordinates, turns), min_size=2, max_size=4),
    st.floats(0.2, 0.9),
    st.sampled_from(["sphere", "capsule", "box"]),
    st.booleans(),
    st.integers(0, 3),
    st.floats(-0.5, 0.8),
)
def test_what_is_shown_is_clear_at_all_times(robot, poses, spacing, kind, creeps, row, begin):
    """An obstacle passes near the motion: nothing in contact is certified."""
    motion = quintic(robot, REST, AWAY, duration=1.5, count=76)
    middle = robot.tool_positions(motion.position[20 * row])
    path = Track(
        times_s=tuple(spacing * i for i in range(len(poses))),
        shifts_m=tuple(shift for shift, _ in poses),
        rpy_deg=tuple(turn for _, turn in poses),
        about=tuple(middle.tolist()),
    )
    place = tuple(middle.tolist())
    obstacle = {
        "sphere": lambda: Sphere(name="it", center=place, radius=0.1, track=path),
        "capsule": lambda: Capsule(name="it", start=place, end=(place[0], place[1], 0.9), radius=0.04, track=path),
        "box": lambda: Box(name="it", center=place, size=(0.05, 0.3, 0.2), track=path),
    }[kind]()
    base = track((0.0, (0.0, 0.0, 0.0)), (1.0, (0.1, 0.2, 0.0))) if creeps else None
    scene = scene_of(REST, AWAY, [obstacle], base_track=base)
    certificate = certify(robot, scene, motion, begin_s=begin)
    least = least_by_coal(robot, scene, motion, 0.01, begin)
    if shown(certificate):
        assert least >= certificate.min_clearance_m - 1e-6 > -1e-6
    else:
        # The refusal has a reason: the proof fails within micrometres of contact.
        assert certificate.min_clearance_m < 1e-4
        assert least < 0.03  # between times 10 ms apart an obstacle and a link may come that much nearer
    assert certificate.nearest.obstacle == "it" or certificate.nearest.distance_m > 0.0


def test_grazing_pass_is_decided_to_a_tenth_of_a_millimetre(robot):
    """A ball passes the arm at rest; the clearance it leaves is known in closed form."""
    motion = quintic(robot, REST, REST, duration=2.0, count=201)
    radius, links = 0.1, family_of(robot).arm.half_widths[-1]
    end = tip(robot, REST)
    for gap in (1e-3, 1e-4, -1e-4, -1e-3):
        # Beyond the tip, along the last link, so that the obstacle passes the tip's cap.
        ahead = end - tip_before(robot)
        place = end + (radius + links + gap) * ahead / np.linalg.norm(ahead)
        side = np.cross(ahead, [0.0, 0.0, 1.0])
        side *= 0.5 / np.linalg.norm(side)
        ball = Sphere(
            name="ball",
            center=tuple(place.tolist()),
            radius=radius,
            track=track((0.0, tuple((-side).tolist())), (2.0, tuple(side.tolist()))),
        )
        certificate = certify(robot, scene_of(REST, REST, [ball]), motion)
        assert shown(certificate) == (gap > 0.0)
        assert certificate.nearest_s == pytest.approx(1.0, abs=0.05)
        assert certificate.nearest.distance_m == pytest.approx(gap, abs=3e-4)


@settings(max_examples=15)
@given(coordinates, *(st.floats(0.0, 0.3),) * 2, st.floats(0.0, 2.0), st.floats(-0.2, 0.4), st.integers(0, 3))
def test_drift_is_kept_clear_of_at_all_times(robot, shift, radius, speed, acceleration, begin, row):
    """Certified distances hold for the obstacle anywhere within its drift, by coal and the formula."""
    motion = quintic(robot, REST, AWAY, duration=1.0, count=51)
    middle = robot.tool_positions(motion.position[16 * row])
    drift = Drift(radius_m=radius, speed_m_s=speed, acceleration_m_s2=acceleration)
    path = track((0.0, shift), (1.5, tuple(-x for x in shift)), drift=drift)
    ball = Sphere(name="ball", center=tuple(middle.tolist()), radius=0.05, track=path)
    scene = scene_of(REST, AWAY, [ball])
    certificate = certify(robot, scene, motion, begin_s=begin)
    least = math.inf
    for time in np.linspace(0.0, motion.duration, 101):
        at = begin + time
        near = coal_distances(robot, motion.positions(np.array([time]))[0], scene.snapshot(at).obstacles).min()
        least = min(least, near - drift.spread_after(max(0.0, at)))
    if shown(certificate):
        assert least >= certificate.min_clearance_m - 1e-6 > -1e-6
    else:
        assert least < 0.03  # between two times the obstacle and a link come that much nearer


def test_motion_is_not_certified_beyond_a_prediction(robot):
    motion = quintic(robot, REST, AWAY, duration=3.0)
    far = track((0.0, (0.0, 0.0, 0.0)), (5.0, (0.0, 0.0, 0.0)), drift=Drift(radius_m=0.01))
    scene = scene_of(REST, AWAY, [Sphere(name="ball", center=(0.0, 0.0, 9.0), radius=0.1, track=far)])
    assert certify(robot, scene, motion).clear_until_s == 5.0
    late = certify(robot, scene, motion, begin_s=2.5)
    assert late.violations == (
        "obstacle 'ball' is predicted until 5 s, the end of its track; the motion ends at 5.5 s",
    )
    assert late.clear_until_s is None
    q = np.radians(REST)
    assert check(robot, scene, q, time_s=5.0).valid
    with pytest.raises(OptionError, match=r"at most 5 s: 'ball' is predicted until then"):
        check(robot, scene, q, time_s=5.1)


def test_drift_may_not_lead_into_the_base(robot):
    motion = quintic(robot, REST, AWAY, duration=3.0)
    for acceleration in (0.0, 1.0):
        still = track((0.0, (0.0,) * 3), (4.0, (0.0,) * 3), drift=Drift(acceleration_m_s2=acceleration))
        crate = Box(name="crate", center=(-2.0, 0.0, 0.1), size=(0.2, 0.2, 0.2), track=still)
        certificate = certify(robot, scene_of(REST, AWAY, [crate]), motion)
        assert any("comes into the robot's" in each for each in certificate.violations) == (acceleration > 0.0)


def test_moving_solids_are_those_of_their_movements():
    """Drifts and speeds of many obstacles at once, against plain formulas; the predictions have different lengths."""
    rng = np.random.default_rng(3)
    balls = []
    for number, length in enumerate((0.3, 1.0, 4.0, 9.0)):
        drift = Drift(radius_m=0.01 * number, speed_m_s=rng.uniform(), acceleration_m_s2=3.0 * rng.uniform())
        path = track((0.1 * number, (0.0,) * 3), (0.1 * number + length, tuple(rng.normal(size=3))), drift=drift)
        balls.append(Sphere(name=f"ball {number}", center=(1.0, 0.0, 0.0), radius=0.1, track=path))
    solids = [solid for ball in balls for solid in ball.solids]
    moving = MovingSolids.combine(solids, [Movement.relative_to(ball.track, None) for ball in balls])
    for time in rng.uniform(-0.5, 11.0, 200):
        expected = [movement.spread_at(np.array([time]))[0] for movement in moving.movements]
        np.testing.assert_allclose(moving.spreads(time), expected, rtol=0.0, atol=1e-12)
    for _ in range(200):
        breaks = np.sort(rng.choice(20, int(rng.integers(2, 8)), replace=False)) / 4.0
        rates, clock = rng.uniform(size=len(breaks) - 1), np.sort(rng.integers(-4, 24, int(rng.integers(1, 7)))) / 4.0
        pieces = [
            (-math.inf, breaks[0], 0.0),
            *zip(breaks, breaks[1:], rates, strict=False),
            (breaks[-1], math.inf, 0.0),
        ]
        expected = [max(r for low, high, r in pieces if low <= b and high >= a) for a, b in itertools.pairwise(clock)]
        np.testing.assert_array_equal(largest_interval_rates(breaks, rates, clock), expected)


def test_obstacles_reach_the_base_as_coal_has_it(robot):
    """Random boxes pass the base: penetrations at fine times are found, and far boxes are not refused."""
    rng, motion = np.random.default_rng(5), quintic(robot, REST, AWAY, duration=1.0)
    found = []
    for _ in range(60):
        ends = [tuple((rng.uniform(0.1, 0.6) * unit).tolist()) for unit in (direction(rng), direction(rng))]
        crate = Box(
            name="crate", center=(0.0, 0.0, 0.3), size=(0.1, 0.1, 0.1), track=track((0.0, ends[0]), (2.0, ends[1]))
        )
        scene = scene_of(REST, AWAY, [crate])
        moving = checker_in_time(robot, scene, 0.0).moving
        messages = list(moving_base_contacts(robot, moving, 0.0, motion.duration))
        depths = [
            -min(
                coal_distance(base.shape.geometry, base.place, shape.geometry, shape.placement)
                for base in base_bodies(robot)
            )
            for time in np.linspace(0.0, motion.duration, 101)
            for shape in [solid_shape(scene.snapshot(time).obstacles[0].solids[0])]
        ]
        assert bool(messages) or max(depths) <= BASE_DEPTH + 1e-6
        assert not messages or max(depths) > BASE_DEPTH - 6e-3  # between two times the box comes that much nearer
        found.append(bool(messages))
    assert 5 < sum(found) < 55


def tip_before(robot: Robot) -> np.ndarray:
    """The joint before the tip, at rest."""
    return axis_points(robot, np.radians(REST))[-2]


def test_track_without_motion_changes_nothing(robot):
    motion = quintic(robot, REST, AWAY)
    near = tuple((tip(robot, AWAY) + np.array([0.0, 0.3, 0.0])).tolist())
    ball = Sphere(name="ball", center=near, radius=0.1)
    still = certify(robot, scene_of(REST, AWAY, [ball]), motion)
    tracked = certify(robot, scene_of(REST, AWAY, [ball.model_copy(update={"track": STILL})]), motion)
    assert still.verified
    assert (still.nearest_s, still.clear_until_s) == (None, None)
    assert tracked.clear_until_s == math.inf
    # No box bounds the distance of an obstacle with a track: coal needs more queries.
    same = {"nearest_s": None, "clear_until_s": None, "digests": None, "checks": 0}
    assert replace(tracked, **same) == replace(still, **same)


def test_later_motion_meets_obstacles_at_that_time(robot):
    motion = quintic(robot, REST, AWAY, duration=3.0)
    through = tip(robot, REST)
    gone = track((0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, 0.0, 1.5)))
    ball = Sphere(name="ball", center=tuple(through.tolist()), radius=0.1, track=gone)
    scene = scene_of(REST, AWAY, [ball])
    assert not shown(certify(robot, scene, motion))
    assert shown(certify(robot, scene, motion, begin_s=1.0))


def test_how_long_the_arm_may_rest_where_it_ends(robot):
    motion = quintic(robot, REST, AWAY, duration=3.0)
    end = tip(robot, AWAY)
    reach = 0.1 + family_of(robot).arm.half_widths[-1]
    comes = track((0.0, (0.0, 0.0, 2.0)), (10.0, (0.0, 0.0, 0.0)))
    ball = Sphere(name="ball", center=tuple(end.tolist()), radius=0.1, track=comes)
    certificate = certify(robot, scene_of(REST, AWAY, [ball]), motion)
    assert shown(certificate)
    if certificate.verified:
        assert 5.0 < certificate.clear_until_s < 10.0 - reach / 0.2 + 1.0
        least = coal_distances(
            robot, np.radians(AWAY), scene_of(REST, AWAY, [ball]).snapshot(certificate.clear_until_s).obstacles
        ).min()
        assert 0.0 < least < 1e-4


def test_obstacle_may_not_come_into_the_base(robot):
    motion = quintic(robot, REST, AWAY, duration=3.0)
    comes = track((0.0, (0.0, 0.0, 0.0)), (2.0, (2.0, 0.0, 0.0)), (3.0, (2.0, 1.0, 0.0)))
    crate = Box(name="crate", center=(-2.0, 0.0, 0.1), size=(0.2, 0.2, 0.2), track=comes)
    certificate = certify(robot, scene_of(REST, AWAY, [crate]), motion)
    assert not certificate.verified
    assert "obstacle 'crate' comes into the robot's" in certificate.violations[0]
    # The ground that slides along under a creeping base may touch the pedestal.
    ground = Box(name="ground", center=(0.0, 0.0, -0.5), size=(20.0, 20.0, 1.0))
    creep = track((0.0, (0.0, 0.0, 0.0)), (3.0, (0.3, 0.0, 0.0)))
    assert shown(certify(robot, scene_of(REST, AWAY, [ground], base_track=creep), motion))


def test_every_kind_moves_and_sways(robot):
    """A cloud, a mesh and a swaying box hit the arm, another passes next to it."""
    motion = quintic(robot, REST, AWAY, duration=3.0)
    end = tip(robot, REST)
    away = track((0.0, (0.0, 0.0, 1.5)), (1.0, (0.0, 0.0, 0.0)), (2.0, (0.0, 0.0, 1.5)))
    rng = np.random.default_rng(0)
    corners = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    faces = [
        face if np.dot(np.cross(*(corners[face[1:]] - corners[face[0]])), equation[:3]) > 0 else face[::-1]
        for face, equation in zip(hull.simplices, hull.equations, strict=True)
    ]
    for at_arm in (True, False):
        place = tuple((end + (0.0 if at_arm else np.array([0.0, -0.6, 0.0]))).tolist())
        for obstacle in (
            PointCloud.from_points("it", rng.uniform(-0.1, 0.1, (30, 3)), 0.02, position=place, track=away),
            Mesh.from_arrays("it", corners, faces, position=place, track=away),
            Box(
                name="it",
                center=place,
                size=(0.1, 0.1, 0.1),
                track=away,
                sway=Sway(direction=(1.0, 1.0, 0.0), amplitude_m=0.05),
            ),
        ):
            certificate = certify(robot, scene_of(REST, AWAY, [obstacle]), motion)
            assert shown(certificate) == (not at_arm)


def test_motion_that_ends_before_the_fruit_rests_does_not_pick_it(robot):
    moved = Fruit(name="apple", center=(1.2, 0.2, 1.2), radius=0.04, track=track((0, (0, 0, 0)), (90, (0, 0, 0.1))))
    motion = quintic(robot, REST, AWAY)
    found = certify(robot, scene_of(REST, goal=Goal(fruit="apple"), fruits=(moved,)), motion)
    assert any("comes to rest at 90 s" in violation for violation in found.violations)


def test_checker_of_moving_obstacles_wants_a_time(robot):
    ball = Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.1, track=track((0, (0, 0, 0)), (1, (0, 0, 0.5))))
    scene = scene_of(REST, AWAY, [ball, Sphere(name="other", center=(1.0, 1.0, 1.9), radius=0.1)])
    checker = CoalScene(robot, scene.listed_solids, movements=scene.movements)
    q = np.radians(REST)
    for time in (0.0, 0.3, 5.0):
        still = CoalScene(robot, scene.snapshot(time).solids)
        np.testing.assert_allclose(checker.pair_distances(q, time), still.pair_distances(q), atol=1e-12)
        assert checker.nearest_contact(q, time).obstacle == still.nearest_contact(q).obstacle
        again = checker.allow_touch("ball").with_margins(0.1, 0.01)
        assert np.isinf(again.distances(q, time)[len(checker.link_names) - 1, 0])
    for ask in (lambda: checker.distances(q), lambda: checker.place(q), lambda: checker.in_collision(q[None])):
        with pytest.raises(MovingObstacleError):
            ask()


def test_motions_of_one_scene_share_a_checker(robot):
    """The same scene and uncertainties give the same checker and certificate, others do not, and none is kept alive."""
    ball = Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.1, sigma=0.01)
    scene, motion = scene_of(REST, AWAY, [ball]), quintic(robot, REST, AWAY)
    sigmas = {"ball": 3.0}
    first, checker = certify(robot, scene, motion, sigmas=sigmas), checker_in_time(robot, scene, sigmas)
    assert checker_in_time(robot, scene, {"ball": 3.0}) is checker
    assert certify(robot, scene, motion, sigmas=sigmas) == first
    sigmas["ball"] = 9.0
    grown = checker_in_time(robot, scene, sigmas)
    assert grown is not checker
    assert grown.distances(np.radians(REST))[0, 0] == pytest.approx(checker.distances(np.radians(REST))[0, 0] - 0.06)
    away = scene.with_obstacles(())
    assert "ball" not in checker_in_time(robot, away, sigmas).obstacle_names
    kept, last = checker_in_time(robot, scene, 0.0), weakref.ref(checker_in_time(robot, scene, 0.0))
    del scene, kept, first, away
    gc.collect()
    assert last() is None


def test_many_obstacles_are_in_several_models(robot):
    """Obstacles beyond the first model are moved, too, and keep their poses between queries."""
    rng = np.random.default_rng(1)
    places = rng.uniform([-2, -2, 0], [2, 2, 2], (300, 3))
    balls = [
        Sphere(name=f"b{i}", center=tuple(p), radius=0.02, track=track((0, (0, 0, 0)), (1, (0, 0.1 * (i % 3), 0.3))))
        for i, p in enumerate(places.tolist())
    ]
    scene = scene_of(REST, AWAY, balls)
    checker = CoalScene(robot, scene.listed_solids, movements=scene.movements)
    pairs = np.array([5, 140, 299, 700])
    for time in (0.0, 0.5, 0.5, 1.0):
        still = CoalScene(robot, scene.snapshot(time).solids)
        np.testing.assert_allclose(
            checker.pair_distances(np.radians(AWAY), time), still.pair_distances(np.radians(AWAY)), atol=1e-12
        )
        checker.place(np.radians(REST), time)
        still.place(np.radians(REST))
        np.testing.assert_allclose(checker.distances_of(pairs), still.distances_of(pairs), atol=1e-12)
