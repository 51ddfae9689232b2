"""Clouds seen from a moving base: placement, memory, and motions past them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from hplan.collision.motion_coefficients import tight_reach_ball
from hplan.errors import HplanError, InputError, OptionError
from hplan.online.arm_shape import SweptReach
from hplan.online.frame import CloudOptions
from hplan.online.planner import Planner
from hplan.planar.family_reader import family_of
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory

START, GOAL = (-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0)
QUICK = PlanOptions(effort="quick")
CREEP = Track(times_s=(0.0, 20.0), shifts_m=((0.0, 0.0, 0.0), (2.0, 0.0, 0.0)))


def a_scene(track: Track | None = CREEP, **more: object) -> Scene:
    fields = {"goal": Goal(joints_deg=GOAL), "clearance": 0.005, "base_track": track, **more}
    return Scene(name="creep", start=Start(joints_deg=START), **fields)


def base_poses(track: Track, clock: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, 3, 3) rotations and (k, 3) positions of the base, by SciPy alone.

    A point that the base sees at y is at R y + s.
    """
    inside = np.clip(clock, track.times_s[0], track.times_s[-1])
    shifts = np.array([np.interp(inside, track.times_s, column) for column in np.array(track.shifts_m).T]).T
    if track.rpy_deg is None:
        return np.tile(np.eye(3), (len(clock), 1, 1)), shifts
    turns = Slerp(track.times_s, Rotation.from_euler("xyz", track.rpy_deg, degrees=True))(inside).as_matrix()
    return turns, np.array(track.about) + shifts - turns @ np.array(track.about)


def seen_at(track: Track, points: np.ndarray, time_s: float) -> np.ndarray:
    """Listed points as the base sees them."""
    (turn,), (shift,) = base_poses(track, np.array([time_s]))
    return (points - shift) @ turn


def least_distance(robot: Robot, track: Track, motion: Trajectory, begins_s: float, points: np.ndarray) -> float:
    """Of listed points from the capsules of the links, every 0.5 ms, in plain NumPy [m]."""
    clock, least = np.append(np.arange(0.0, motion.duration, 5e-4), motion.duration), np.inf
    turns, shifts = base_poses(track, begins_s + clock)
    q = motion.positions(clock)
    origins, axes = map(
        np.array, zip(*(family_of(robot).plane_at(family_of(robot).yaw_of(each)) for each in q), strict=True)
    )
    joints = origins[:, None] + family_of(robot).arm.joint_points(q[:, family_of(robot).arm_slice]) @ axes[:, :2]
    seen = (points - shifts[:, None]) @ turns
    for link, half in enumerate(family_of(robot).arm.half_widths):
        beside = family_of(robot).arm.lateral[link] * axes[:, 2]
        start, way = (joints[:, link] + beside)[:, None], (joints[:, link + 1] - joints[:, link])[:, None]
        along = np.clip(((seen - start) * way).sum(axis=2) / (way**2).sum(axis=2), 0.0, 1.0)[..., None]
        least = min(least, float(np.linalg.norm(seen - start - along * way, axis=2).min()) - half)
    return least


def random_track(random: np.random.Generator) -> Track:
    """A base that creeps and, half of the time, turns."""
    times = np.cumsum([0.0, *random.uniform(1.0, 4.0, 3)])
    shifts = np.cumsum([np.zeros(3), *(random.uniform(-0.4, 0.4, (3, 3)) * [1.0, 1.0, 0.05])], axis=0)
    turning = {}
    if random.random() < 0.5:
        turns = [(0.0, 0.0, float(yaw)) for yaw in np.cumsum([0.0, *random.uniform(-20.0, 20.0, 3)])]
        turning = {"rpy_deg": tuple(turns), "about": (0.3, -0.2, 0.0)}
    return Track(times_s=tuple(times.tolist()), shifts_m=tuple(map(tuple, shifts.tolist())), **turning)


def test_points_stay_where_they_were_seen(robot: Robot) -> None:
    """Seen at 10 s, when the base is 1 m farther: then it blocks the motion."""
    planner = Planner(robot, a_scene(), QUICK)
    free = planner.plan(begins_s=10.0)
    tip = robot.tool_positions(free.trajectory.position[[int(0.6 * free.trajectory.samples)]])
    points = tip + np.random.default_rng(0).normal(0.0, 0.03, (300, 3))
    with pytest.raises(OptionError, match="time_s = None: expected the time of the frame"):
        planner.set_cloud("canopy", points, radius=0.01)
    planner.set_cloud("canopy", points, radius=0.01, time_s=10.0)
    result = planner.plan(begins_s=10.0)
    assert result.certificate.verified
    assert result.certificate.nearest.obstacle == "canopy"
    assert least_distance(robot, CREEP, result.trajectory, 10.0, points + np.array([1.0, 0.0, 0.0])) > 0.01 + 0.005


def test_random_motions_past_clouds_on_a_base_that_moves(robot: Robot) -> None:
    """Certified motions keep clear of every observed point, by NumPy alone.

    Times and cameras are random.
    """
    free = plan(robot, a_scene(None), QUICK).trajectory
    near = [past_a_cloud(robot, free, seed) for seed in range(12)]
    assert sum(distance < 0.2 for distance in near) >= 5, near


def past_a_cloud(robot: Robot, free: Trajectory, seed: int) -> float:
    """Minimum distance of a certified motion from a random cloud next to a free motion.

    Infinite without a certified motion.
    """
    random = np.random.default_rng(seed)
    track, (taken_s, begins_s) = random_track(random), random.uniform(0.0, 8.0, 2)
    planner = Planner(robot, a_scene(track), QUICK)
    at_s = random.uniform(0.3, 0.7) * free.duration
    (turn,), (shift,) = base_poses(track, np.array([begins_s + at_s]))
    tip = turn @ robot.tool_positions(free.positions(np.array([at_s])))[0] + shift
    listed = tip + random.normal(0.0, 0.1, 3) + random.normal(0.0, 0.04, (60, 3))
    camera, position = Rotation.random(random_state=seed).as_matrix(), random.uniform(-1.0, 1.0, 3)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera, position
    given = (seen_at(track, listed, taken_s) - position) @ camera
    options = CloudOptions(reach_margin_m=float(random.choice([0.0, 0.1])))
    report = planner.set_cloud("seen", given, radius=0.01, pose=pose, time_s=taken_s, options=options)
    assert (report.given, report.not_finite, report.of_arm, report.ignored) == (60, 0, 0, 0)
    try:
        result = planner.plan(begins_s=begins_s)
    except HplanError:
        return np.inf  # it is in the base, or blocks every motion
    assert result.certificate.verified
    least = least_distance(robot, track, result.trajectory, begins_s, listed)
    assert least > 0.01 + 0.005 - 1e-6
    stop = planner.stop_at(begins_s + 0.5 * result.trajectory.duration, now=begins_s)
    if stop.certificate.verified:
        assert least_distance(robot, track, stop.trajectory, begins_s, listed) > 0.01 + 0.005 - 1e-6
    return least


@pytest.mark.parametrize("seed", range(4))
def test_omitted_points_never_come_within_reach(robot: Robot, seed: int) -> None:
    """Against the distance from the ball of reach at places less than 2 mm apart on the track."""
    random = np.random.default_rng(seed)
    track, margin = random_track(random), 0.07
    swept = SweptReach.sweep(tight_reach_ball(robot), track)
    points = random.uniform(-5.0, 5.0, (800, 3))
    turns, shifts = base_poses(track, np.arange(track.times_s[0], track.times_s[-1], 2e-3))
    x, y, z, radius = tight_reach_ball(robot)
    centres = turns @ np.array([x, y, z]) + shifts
    away = np.array([np.linalg.norm(centres - point, axis=1).min() for point in points]) - radius
    near = swept.comes_near(points, margin)
    assert near[away <= margin].all()
    assert not near[away > margin + 0.06].any()
    ball = swept.ball_seen_from(*track.pose_at(1.3))
    seen = seen_at(track, points[away <= 0.0], 1.3)
    assert (np.linalg.norm(seen - ball[:3], axis=1) <= ball[3]).all()


def test_ignored_obstacles_are_at_their_current_place(robot: Robot) -> None:
    drift = Track(times_s=(0.0, 20.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 2.0, 0.0)))
    apple, bird = (
        Fruit(name="apple", center=(1.9, 0.1, 1.2), radius=0.04),
        Sphere(name="bird", center=(2.0, -0.6, 1.3), radius=0.05, track=drift),
    )
    planner = Planner(robot, a_scene(fruits=(apple,), obstacles=(bird,)))
    random = np.random.default_rng(1)
    way = random.normal(size=(200, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    listed = np.concatenate([apple.center + 0.04 * way, np.add(bird.center, (0.0, 1.0, 0.0)) + 0.05 * way])
    points = seen_at(CREEP, listed, 10.0)
    report = planner.set_cloud("seen", points, radius=0.01, time_s=10.0, ignore=["apple", "bird"])
    assert (report.ignored, report.kept) == (400, 0)
    assert planner.set_cloud("seen", points, radius=0.01, time_s=15.0, ignore=["apple", "bird"]).ignored < 100
    # The base may be at rest: moving obstacles are evaluated at the frame's time all the same.
    planner = Planner(robot, a_scene(None, obstacles=(bird,)))
    with pytest.raises(OptionError, match="a body to ignore moves"):
        planner.set_cloud("seen", listed, radius=0.01, ignore=["bird"])
    assert planner.set_cloud("seen", listed[200:], radius=0.01, time_s=10.0, ignore=["bird"]).kept == 0


def test_remembered_points_stay_where_they_were_seen(robot: Robot) -> None:
    planner = Planner(robot, a_scene())
    listed = np.array([1.4, 0.2, 1.2]) + np.random.default_rng(0).normal(0.0, 0.02, (50, 3))
    first = planner.set_cloud("seen", seen_at(CREEP, listed, 2.0), radius=0.01, time_s=2.0, keep_s=30.0)
    before = planner.scene.obstacles[0].points
    second = planner.set_cloud("seen", [(-1.0, 0.0, 1.0)], radius=0.01, time_s=8.0, keep_s=30.0)
    assert second.remembered == first.kept
    np.testing.assert_allclose(planner.scene.obstacles[0].points[1:], before, atol=1e-12)


def test_cloud_that_was_cropped_for_less_is_refused(robot: Robot) -> None:
    """Clearance, tracking errors, the base's track and the cloud's place may not change behind the crop."""
    planner = Planner(robot, a_scene(None), QUICK)
    x, y, z, radius = tight_reach_ball(robot)
    points = [(1.4, 0.2, 1.2), (x, y - radius - 0.13, z)]
    options = CloudOptions(growth_m=1e-3)
    report = planner.set_cloud("seen", points, radius=0.01, options=options)
    assert (report.kept, report.out_of_reach) == (1, 1)
    planner.plan(begins_s=0.0)
    scene = planner.scene
    planner.scene = scene.model_copy(update={"clearance": 0.1})
    planner.plan(begins_s=0.0)  # all points were kept
    changes = [
        {"scene": scene.model_copy(update={"clearance": 0.2})},
        {"options": PlanOptions(effort="quick", tracking_error=0.05)},
        {"scene": scene.model_copy(update={"base_track": CREEP})},
    ]
    for change in changes:
        planner.scene, planner.options = scene, QUICK
        vars(planner).update(change)
        for ask in (lambda: planner.plan(begins_s=0.0), lambda: planner.replan(at=0.3, now=0.1)):
            with pytest.raises(InputError, match="cloud 'seen' was cropped to the reach for"):
                ask()
        stop = planner.stop_at(0.2)
        assert not stop.certificate.verified
        assert "cropped to the reach" in stop.certificate.violations[-1]
    planner.scene, planner.options = changes[0]["scene"], QUICK
    assert planner.set_cloud("seen", points, radius=0.01, options=options).kept == 2
    planner.replan(begins_s=0.0)
    with pytest.raises(InputError, match="cropped to the reach of the arm where it was seen"):
        planner.move("seen", position=(0.0, 0.3, 0.0))


def test_memory_is_cropped_for_the_least_of_its_frames(robot: Robot) -> None:
    planner = Planner(robot, a_scene(None), QUICK)
    points = [(1.4, 0.2, 1.2)]
    planner.set_cloud("seen", points, radius=0.01, keep_s=60.0, time_s=0.0)
    planner.scene = planner.scene.model_copy(update={"clearance": 0.2})
    planner.set_cloud("seen", points, radius=0.01, keep_s=60.0, time_s=1.0)
    with pytest.raises(InputError, match="remove it first"):
        planner.plan()
    planner.remove("seen")
    planner.set_cloud("seen", points, radius=0.01, keep_s=60.0, time_s=2.0)
    planner.plan()
