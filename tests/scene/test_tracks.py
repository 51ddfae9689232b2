"""Tracks and sways: scene file entries, poses over time, swept solids."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp
from shapes import crate, distances

from hplan.certificate.digests import scene_digest
from hplan.collision.coal_accuracy import ITERATION
from hplan.errors import InputError, MovingObstacleError, OptionError, SceneError
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import THIN
from hplan.geometry.rotation import rpy_of
from hplan.scene.file import dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import SWEPT_ERROR, transform_solid
from hplan.scene.obstacles import Box, Capsule, Mesh, PointCloud, Solid, Sphere
from hplan.scene.tracks import Drift, Sway, Track

TURNING = Track(
    times_s=(0.5, 1.0, 3.0),
    shifts_m=((0.0, 0.0, 0.0), (0.2, 0.0, 0.1), (0.2, -0.4, 0.0)),
    rpy_deg=((0.0, 0.0, 0.0), (10.0, 20.0, 90.0), (-30.0, 0.0, 0.0)),
    about=(1.0, 0.1, 0.9),
)
CREEP = Track(times_s=(0.0, 10.0), shifts_m=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
SWAY = Sway(direction=(0.0, 3.0, 0.0), amplitude_m=0.05)
HEAD = "format: hplan-scene/1\nname: t\nstart: {joints_deg: [0, 0, 0, 0]}\ngoal: {joints_deg: [0, 45, 60, 70]}\n"
BALL = HEAD + "obstacles:\n  - name: ball\n    kind: sphere\n    center: [1, 0, 1]\n    radius: 0.1\n"


def a_scene(*obstacles, **more) -> Scene:
    start, goal = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0, 45.0, 60.0, 70.0))
    return Scene(name="t", start=start, goal=goal, obstacles=obstacles, **more)


@cache  # a mesh is cut for a second
def all_kinds(track: Track | None = TURNING, sway: Sway | None = SWAY) -> Scene:
    how = {"track": track, "sway": sway}
    return a_scene(
        Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, **how),
        Capsule(name="rod", start=(1.0, 0.0, 1.0), end=(1.2, 0.1, 1.4), radius=0.1, **how),
        Box(name="box", center=(1.0, 0.0, 1.0), size=(0.1, 0.2, 0.3), rpy_deg=(10.0, 20.0, 30.0), **how),
        Mesh.from_arrays("crate", *crate(), position=(1.0, 0.0, 0.5), rpy_deg=(0.0, 30.0, 0.0), **how),
        PointCloud.from_points(
            "leaves", np.random.default_rng(1).uniform(-0.2, 0.2, (40, 3)), 0.02, position=(1, 0, 1), **how
        ),
        fruits=(Fruit(name="apple", center=(1.0, 0.3, 1.2), radius=0.04, **how),),
        base_track=None if track is None else CREEP,
    )


def apart(solid: Solid, points: np.ndarray) -> np.ndarray:
    """Distances of points from a solid."""
    if isinstance(solid, Cloud):
        return np.linalg.norm(points[:, None] - solid.core, axis=2).min(axis=1) - solid.rounding
    return distances(solid, points)


def test_scene_survives_writing_and_reading(tmp_path):
    scene = all_kinds()
    read = load_scene(save_scene(scene, tmp_path / "scene.yaml"))
    for before, after in zip(scene.obstacles, read.obstacles, strict=True):
        assert (before.name, before.track, before.sway) == (after.name, after.track, after.sway)
    assert (read.fruits, read.base_track) == (scene.fruits, scene.base_track)
    assert scene_digest(read) == scene_digest(scene)
    assert parse_scene(dump_scene(read), path=tmp_path / "scene.yaml") == read


def test_drift_survives_writing_and_reading(tmp_path):
    drifting = Track(times_s=(0.0, 1.0), shifts_m=((0.0,) * 3,) * 2, drift=Drift(acceleration_m_s2=2.0))
    scene = a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=drifting))
    read = load_scene(save_scene(scene, tmp_path / "scene.yaml"))
    assert read.obstacles[0].track == drifting
    exact = a_scene(scene.obstacles[0].model_copy(update={"track": drifting.model_copy(update={"drift": None})}))
    assert scene_digest(read) == scene_digest(scene) != scene_digest(exact)
    assert read.starting_at(0.5).obstacles[0].track.drift == drifting.drift


def test_goal_fruit_and_base_do_not_drift():
    drifting = Track(times_s=(0.0, 1.0), shifts_m=((0.0,) * 3,) * 2, drift=Drift(radius_m=0.1))
    with pytest.raises(InputError, match="base_track is exact"):
        a_scene(base_track=drifting)
    apple = Fruit(name="apple", center=(1.0, 0.0, 1.0), radius=0.04, track=drifting)
    assert a_scene(fruits=(apple,)).moves
    with pytest.raises(InputError, match="expected none for the goal fruit"):
        Scene(name="t", start=Start(joints_deg=(0.0,) * 4), goal=Goal(fruit="apple"), fruits=(apple,))


@given(*(st.floats(0.0, 3.0),) * 3, st.floats(0.1, 5.0))
def test_spread_is_never_smaller_than_its_formula(radius, speed, acceleration, span):
    """The linear interpolation lies above the parabola, by a millimetre at most where pieces suffice."""
    drift = Drift(radius_m=radius, speed_m_s=speed, acceleration_m_s2=acceleration)
    path = Track(times_s=(0.5, 0.5 + span), shifts_m=((0.0,) * 3, (1.0, 0.0, 0.0)), drift=drift)
    (movement,) = a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=path)).movements
    after = np.linspace(0.0, span, 301)
    exact = radius + speed * after + 0.5 * acceleration * after**2
    excess = movement.spread_at(0.5 + after) - exact
    assert excess.min() > -1e-12
    assert excess.max() < 1e-3 + 1e-9
    assert movement.known_until_s == 0.5 + span
    # The rates bound how fast the drift grows on top of the track's own speed.
    rates = movement.rates(np.zeros((1, 3)), 0.1)
    grown = np.diff(movement.spread_at(movement.breaks))
    moved = np.where(movement.breaks[:-1] >= 0.5, np.diff(movement.breaks) / span, 0.0)
    np.testing.assert_allclose(rates * np.diff(movement.breaks), moved + grown, atol=1e-9)


def test_digest_knows_how_things_move():
    moving = a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=CREEP))
    still = a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1))
    swaying = a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, sway=SWAY))
    creeping = still.model_copy(update={"base_track": CREEP})
    assert len({scene_digest(scene) for scene in (moving, still, swaying, creeping)}) == 4
    # The digest of a static scene has not changed with the introduction of tracks.
    assert scene_digest(still) == "sha256:58b921970ba4bd59e3437507ca88aeebb03deabae34644bb9acf11402c8ab91d"


def test_moving_scene_is_never_taken_for_a_still_one():
    for scene in (
        a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=CREEP)),
        a_scene(base_track=CREEP),
        a_scene(fruits=(Fruit(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=CREEP),)),
    ):
        assert scene.moves
        with pytest.raises(MovingObstacleError) as caught:
            _ = scene.solids
        assert caught.value.obstacle == (None if scene.base_track else "ball")
        assert not scene.snapshot(1.0).moves
        assert len(scene.snapshot(1.0).solids) == len(scene.listed_solids) == len(scene.movements)


@pytest.mark.parametrize(
    ("track", "where", "line", "words"),
    [
        ("{times_s: [0, 1, 1], shifts_m: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]}", "times_s[2]", 10, "times must increase"),
        ("{times_s: [0], shifts_m: [[0, 0, 0]]}", "times_s", 10, "at least 2"),
        ("{times_s: [0, .nan], shifts_m: [[0, 0, 0], [0, 0, 0]]}", "times_s[1]", 10, "finite"),
        ("{times_s: [0, 1], shifts_m: [[0, 0, 0]]}", "shifts_m", 10, "one for each of 2 times (got 1)"),
        ("{times_s: [0, 1], shifts_m: [[0, 0, 0], [0, 0, 0]], about: [0, 0, 0]}", "about", 10, "missing: rpy_deg"),
        (
            "{times_s: [0, 1], shifts_m: [[0, 0, 0], [0, 0, 0]], rpy_deg: [[0, 0, 0], [0, 0, 180]], about: [0, 0, 0]}",
            "rpy_deg[1]",
            10,
            "180 degrees",
        ),
        ("{times_s: [0, 1], shifts_m: [[0, 0, 0], [0, 0, 0]], drift: {speed_m_s: -1}}", "drift.speed_m_s", 10, "0"),
        ("{times_s: [0, 1], shifts_m: [[0, 0, 0], [0, 0, 0]], drift: {speed: 1}}", "drift.speed", 10, "speed_m_s"),
        ("fast", "", 10, "mapping"),
    ],
)
def test_wrong_track_is_named_with_its_line(track, where, line, words):
    with pytest.raises(SceneError) as caught:
        parse_scene(f"{BALL}    track: {track}\n")
    assert caught.value.where == "obstacles[0].track" + (f".{where}" if where else "")
    assert caught.value.line == line
    assert words in caught.value.reason


def test_poses_are_those_of_linear_shifts_and_slerp():
    item = all_kinds(sway=None).obstacles[2]
    scene = a_scene(item)
    times = np.linspace(-1.0, 4.0, 41)
    rotations, shifts = scene.poses_at(times)["box"]
    inside = np.clip(times, 0.5, 3.0)
    turns = Rotation.from_euler("xyz", TURNING.rpy_deg, degrees=True)
    wanted = Slerp(TURNING.times_s, turns)(inside).as_matrix()
    place = np.array([np.interp(inside, TURNING.times_s, np.array(TURNING.shifts_m)[:, i]) for i in range(3)]).T
    np.testing.assert_allclose(rotations, wanted, atol=1e-12)
    about = np.array(TURNING.about)
    np.testing.assert_allclose(shifts, about + place - wanted @ about, atol=1e-12)
    assert scene.poses_at([0.0]).keys() == {"box"}
    with pytest.raises(InputError, match="times_s"):
        scene.poses_at([math.nan])


def test_base_that_moves_is_a_scene_that_moves_the_other_way():
    """Poses as seen from the base, against the product of homogeneous matrices."""
    scene = all_kinds(sway=None).model_copy(update={"base_track": TURNING})
    about = np.array(TURNING.about)

    def pose(track: Track, time: float) -> np.ndarray:
        rotations, shifts = a_scene(Sphere(name="x", center=(0, 0, 0), radius=0.1, track=track)).poses_at([time])["x"]
        return np.block([[rotations[0], shifts[0][:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

    for time in (0.0, 0.7, 2.1, 9.0):
        whole = np.linalg.inv(pose(TURNING, time)) @ pose(TURNING, time)
        rotations, shifts = scene.poses_at([time])["rod"]
        np.testing.assert_allclose(np.block([rotations[0], shifts[0][:, None]]), whole[:3], atol=1e-12)
        creeping = all_kinds(sway=None)
        whole = np.linalg.inv(pose(CREEP, time)) @ pose(TURNING, time)
        rotations, shifts = creeping.poses_at([time])["rod"]
        np.testing.assert_allclose(np.block([rotations[0], shifts[0][:, None]]), whole[:3], atol=1e-12)
    assert about.shape == (3,)


def test_scene_at_a_time_has_its_solids_where_they_are_then():
    scene = all_kinds()
    rng = np.random.default_rng(3)
    points = rng.uniform([0.4, -0.8, 0.3], [1.6, 0.8, 1.8], (60, 3))
    for time in (0.0, 1.7, 5.0):
        poses = scene.poses_at([time])
        for listed, then in zip(scene.listed_solids, scene.snapshot(time).solids_with_goal, strict=True):
            rotation, shift = (part[0] for part in poses[listed.name])
            there = transform_solid(listed, rotation, shift)
            # A solid elsewhere seen from a point is the solid seen from that point taken back.
            back = (points - shift) @ rotation
            np.testing.assert_allclose(apart(there, points), apart(listed, back), atol=ITERATION)
            np.testing.assert_allclose(apart(then, points), apart(listed, back), atol=2.1 * SWEPT_ERROR)


@pytest.mark.parametrize("index", range(5))
def test_sway_sweeps_exactly_its_volume(index):
    scene, still = all_kinds(track=None), all_kinds(track=None, sway=None)
    rng = np.random.default_rng(index)
    swept, before = scene.obstacles[index].solids, still.obstacles[index].solids
    points = rng.uniform([0.4, -0.8, 0.3], [1.6, 0.8, 1.8], (40, 3))
    swings = [np.min([apart(s, points - a * SWAY.reach) for s in before], axis=0) for a in np.linspace(-1, 1, 101)]
    exact = np.min(swings, axis=0)
    found = np.min([apart(s, points) for s in swept], axis=0)
    outside = exact > 1e-3
    assert (found[outside] <= exact[outside] + 2.0 * ITERATION).all()  # all of it
    allowed = 2.1 * SWEPT_ERROR if isinstance(swept[0], Cloud) else 2.0 * THIN
    assert (found[outside] >= exact[outside] - allowed - 3e-4).all()  # 3e-4: swings are 1 mm apart


angles = st.floats(-180.0, 180.0)


@given(angles, st.floats(-90.0, 90.0), angles)
def test_roll_pitch_and_yaw_of_a_rotation(roll, pitch, yaw):
    rotation = Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix()
    again = Rotation.from_euler("xyz", rpy_of(rotation), degrees=True).as_matrix()
    np.testing.assert_allclose(again, rotation, atol=1e-9)


shifts = st.tuples(*(st.floats(-1.0, 1.0),) * 3)
turns = st.tuples(*(st.floats(-45.0, 45.0),) * 3)


@given(
    st.lists(st.tuples(shifts, turns), min_size=2, max_size=4),
    st.lists(st.tuples(shifts, turns), min_size=2, max_size=4),
)
def test_no_point_is_faster_than_the_bound(own, base):
    """Points of a box, their speed by differences, against the rates."""
    tracks = [
        Track(
            times_s=tuple(0.7 * i for i in range(len(poses))),
            shifts_m=tuple(shift for shift, _ in poses),
            rpy_deg=tuple(turn for _, turn in poses),
            about=(0.8, 0.0, 1.0),
        )
        for poses in (own, base)
    ]
    box = Box(name="b", center=(1.0, 0.2, 1.0), size=(0.1, 0.2, 0.3), track=tracks[0])
    scene = a_scene(box, base_track=tracks[1])
    (movement,) = scene.movements
    rates = movement.rates(box.core, box.rounding)
    clock = np.linspace(-0.1, movement.breaks[-1] + 0.1, 200)
    rotations, places = movement.displacement_at(clock)
    points = box.core @ np.swapaxes(rotations, 1, 2) + places[:, None]
    moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
    travel = np.interp(clock, movement.breaks, np.concatenate([[0.0], np.cumsum(rates * np.diff(movement.breaks))]))
    assert (moved <= np.diff(travel) + 1e-9).all()


@settings(max_examples=25)
@given(st.floats(-50.0, 50.0), st.lists(st.floats(-60.0, 60.0), min_size=1, max_size=4))
def test_a_scene_by_another_clock_is_where_it_was(zero, clock):
    """Before, within and after the tracks, of either sign."""
    scene = all_kinds()
    later = scene.starting_at(zero)
    before, after = scene.poses_at(np.array(clock)), later.poses_at(np.array(clock) - zero)
    assert before.keys() == after.keys()
    for name, poses in before.items():
        for one, other in zip(poses, after[name], strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
    assert later.at_rest_s == pytest.approx(scene.at_rest_s - zero, abs=1e-12)
    back = later.starting_at(-zero)
    for one, other in zip(back.obstacles, scene.obstacles, strict=True):
        np.testing.assert_allclose(one.track.times_s, other.track.times_s, rtol=0, atol=1e-12)
        assert one.track.shifts_m == other.track.shifts_m
    assert [solid.name for solid in later.listed_solids] == [solid.name for solid in scene.listed_solids]


def test_times_equal_after_rounding_are_refused():
    close = Track(times_s=(0.0, 1e-12), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert close.starting_at(1e-4).times_s[0] == -1e-4
    with pytest.raises(OptionError, match="distinct floating-point numbers"):
        a_scene(Sphere(name="ball", center=(1.0, 0.0, 1.0), radius=0.1, track=close)).starting_at(1e5)
