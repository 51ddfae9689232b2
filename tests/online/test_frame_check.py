"""Frames of failing cameras, in wrong units, at wrong poses and with old stamps: the last good frame stays."""

from __future__ import annotations

import pickle
import time
from typing import Any

import numpy as np
import pytest

from hplan import Planner, PlanResult, check
from hplan.base.arrays import FloatArray
from hplan.errors import FrameError, HplanError, InputError
from hplan.online.frame import CloudOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import PointCloud

NAN, INF = float("nan"), float("inf")
START, GOAL = np.radians([-40.0, 60.0, 60.0, 60.0]), np.radians([40.0, 60.0, 60.0, 60.0])
SCENE = Scene(name="loop", start=Start(joints_rad=START), goal=Goal(joints_rad=GOAL), clearance=0.005)

#: The camera is 1 m to the side, and looks along y of `base_link`.
POSE = np.array([[1.0, 0.0, 0.0, 0.9], [0.0, 0.0, 1.0, -1.5], [0.0, -1.0, 0.0, 1.2], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def plant(robot: Robot) -> FloatArray:
    """(2000, 3) points about the middle of the free motion, in the camera's frame."""
    middle = robot.tool_positions(0.5 * (START + GOAL))
    points = middle + np.random.default_rng(0).normal(0.0, 0.04, (2000, 3))
    return np.asarray((points - POSE[:3, 3]) @ POSE[:3, :3])


def see(planner: Planner, points: Any, **changes: Any) -> Any:
    """Hand in a frame of the camera."""
    values = {"radius": 0.01, "pose": POSE, "joints": START, "time_s": 1.0}
    return planner.set_cloud("plant", points, **{**values, **changes})


def scaled_rotation(factor: float) -> FloatArray:
    pose = POSE.copy()
    pose[:3, :3] *= factor
    return pose


def rows_of(points: FloatArray) -> FloatArray:
    return np.arange(len(points))[:, None]


#: Faults of a frame of points, as arguments of `see`.
BAD: dict[str, Any] = {
    "all NaN": lambda points: {"points": np.full_like(points, NAN)},
    "all infinite": lambda points: {"points": np.full_like(points, -INF)},
    "no return": lambda points: {"points": np.zeros_like(points)},
    "no points": lambda points: {"points": points[:0]},
    "millimetres": lambda points: {"points": 1e3 * points},
    "millimetres as whole numbers": lambda points: {"points": np.rint(1e3 * points).astype(np.int16)},
    "millimetres among NaN": lambda points: {"points": np.where(rows_of(points) % 2, NAN, 1e3 * points)},
    "centimetres": lambda points: {"points": 1e2 * points},
    "maximum range": lambda points: {"points": 65.535 * points / np.linalg.norm(points, axis=1, keepdims=True)},
    "huge": lambda points: {"points": 1e200 * points},
    "most lost": lambda points: {"points": np.where(rows_of(points) % 10, NAN, points)},
    "most at (0, 0, 0)": lambda points: {"points": np.where(rows_of(points) % 10, 0.0, points)},
    "looks away": lambda points: {"pose": [0.0, 0.0, 30.0, 0.0, 0.0, 0.0]},
    "pose in millimetres": lambda points: {"pose": [900.0, -1500.0, 1200.0, 0.0, 0.0, 0.0]},
    "pose that scales": lambda points: {"pose": scaled_rotation(1.001)},
    "pose that mirrors": lambda points: {"pose": POSE @ np.diag([1.0, 1.0, -1.0, 1.0])},
    "pose that is not finite": lambda points: {"pose": np.where(POSE == 1.2, NAN, POSE)},
    "outliers alone": lambda points: {"options": CloudOptions(least_points=10_000)},
    "the arm alone": lambda points: {"options": CloudOptions(arm_padding_m=9.0)},
    "older": lambda points: {"time_s": 0.999},
    "older and empty": lambda points: {"points": points[:0], "time_s": 0.5},
    "no stamp": lambda points: {"time_s": None},
    "stamp that is not finite": lambda points: {"time_s": NAN},
    "two columns": lambda points: {"points": points[:, :2]},
    "texts": lambda points: {"points": points.astype(str)},
    "objects": lambda points: {"points": points.astype(object)},
}


@pytest.mark.parametrize("keep_s", [0.0, 60.0])
@pytest.mark.parametrize("kind", BAD)
def test_bad_frame_leaves_the_plant(robot: Robot, plant: FloatArray, kind: str, keep_s: float) -> None:
    planner = Planner(robot, SCENE)
    assert see(planner, plant, keep_s=keep_s).kept > 100
    before = planner.scene
    for _ in range(2):
        with pytest.raises(InputError):
            see(planner, **{"points": plant, "time_s": 1.1, "keep_s": keep_s} | BAD[kind](plant))
        assert planner.scene is before
    report = see(planner, plant, keep_s=keep_s, time_s=1.2)
    assert report.kept > 100
    assert planner.scene is not before


def test_no_motion_is_certified_through_the_plant_after_a_bad_frame(robot: Robot, plant: FloatArray) -> None:
    """Judged by the balls of the plant itself."""
    planner = Planner(robot, SCENE)
    planner.plan(begins_s=0.0)
    world = PointCloud.from_points("plant", plant @ POSE[:3, :3].T + POSE[:3, 3], radius=0.01)
    for number, kind in enumerate(BAD):
        see(planner, plant, time_s=1.0 + number)
        with pytest.raises(InputError):
            see(planner, **{"points": plant, "time_s": 1.5 + number} | BAD[kind](plant))
        try:
            found = planner.plan(begins_s=0.0) if number % 2 else planner.replan(at=0.3, now=0.1)
        except HplanError:
            continue
        assert found.certificate.verified
        assert not check(robot, SCENE.with_obstacles((world,)), found.trajectory.position).in_contact.any()


def test_pixels_without_return_are_not_obstacles(robot: Robot, plant: FloatArray) -> None:
    """A camera on the arm: balls at the camera would leave a trail in the memory."""
    planner = Planner(robot, SCENE)
    frame = np.concatenate([plant, np.zeros((500, 3))]).reshape(50, 50, 3)
    for number in range(5):
        pose = POSE.copy()
        pose[:3, 3] += [0.0, 0.1 * number, 0.0]
        report = see(planner, frame, pose=pose, keep_s=60.0, time_s=1.0 + number)
        assert (report.given, report.no_return, report.not_finite) == (2500, 500, 0)
        (cloud,) = planner.scene.obstacles
        assert np.linalg.norm(cloud.points - pose[:3, 3], axis=1).min() > 0.2
    with pytest.raises(FrameError, match="in earlier frames 80 %"):
        see(planner, np.zeros((50, 50, 3), np.float32), keep_s=60.0, time_s=9.0)


def test_camera_that_fades_is_noticed(robot: Robot, plant: FloatArray) -> None:
    """Each frame alone loses less than the acceptable share."""
    planner, found = Planner(robot, SCENE), None
    for number in range(20):
        try:
            see(planner, np.where(rows_of(plant) < 0.7**number * len(plant), plant, NAN), time_s=1.0 + number)
        except FrameError as error:
            found = error
            break
    assert found is not None
    assert "the camera may be failing" in found.reason
    assert found.data["given"] == len(plant)
    assert 0.5 * len(plant) <= found.data["not_finite"] < 0.7 * len(plant)
    # A frame with fewer points, all of them returns, is no loss: drivers omit pixels without a return.
    see(planner, plant[:100], time_s=99.0)


def test_empty_frames_must_be_allowed(robot: Robot, plant: FloatArray) -> None:
    background = np.array([[0.0, 0.0, 9.0]]) + plant
    planner = Planner(robot, SCENE)
    with pytest.raises(FrameError, match=r"it leaves no obstacle \(2000 given, .* 2000 out of reach"):
        see(planner, background)
    see(planner, plant)
    for options in (CloudOptions(), CloudOptions(max_lost=1.0)):
        with pytest.raises(FrameError, match="it leaves no obstacle"):
            see(planner, background, options=options)
    for frame in (np.full_like(plant, NAN), plant[:0]):
        with pytest.raises(FrameError, match="0 % of"):
            see(planner, frame, options=CloudOptions(allow_empty=True))
    assert see(planner, background, options=CloudOptions(allow_empty=True)).kept == 0
    assert planner.scene.obstacles == ()
    see(planner, plant, time_s=2.0)
    with pytest.raises(FrameError, match="millimetres"):
        see(planner, 1e3 * plant, time_s=2.0, options=CloudOptions(allow_empty=True, max_lost=1.0))
    sky = np.full_like(plant, NAN)
    assert see(planner, sky, time_s=2.0, options=CloudOptions(allow_empty=True, max_lost=1.0)).kept == 0
    assert planner.scene.obstacles == ()


def test_order_of_stamps(robot: Robot, plant: FloatArray) -> None:
    planner = Planner(robot, SCENE)
    see(planner, plant, time_s=5.0)
    see(planner, plant[:50], time_s=5.0)  # the same stamp is no older frame
    again = pickle.loads(pickle.dumps(planner))
    for each in (planner, again):
        with pytest.raises(FrameError, match="its stamp 4 s is before the stamp of the last frame, 5 s"):
            see(each, plant, time_s=4.0)
        with pytest.raises(FrameError, match="no time stamp and the frame before has one"):
            see(each, plant, time_s=None)
        each.set_cloud("another camera", plant, radius=0.01, pose=POSE, time_s=4.0)
        each.remove("plant")
        see(each, plant, time_s=4.0)
    empty = Planner(robot, SCENE)
    see(empty, plant[:0], options=CloudOptions(allow_empty=True))
    empty.remove("plant")
    with pytest.raises(InputError, match="no obstacle 'plant'"):
        empty.remove("plant")
    see(empty, plant, time_s=None)
    see(empty, plant, time_s=None)
    with pytest.raises(FrameError, match="a time stamp and the frame before has none"):
        see(empty, plant, time_s=9.0)


def test_plans_rely_on_frames_of_a_stated_age(robot: Robot, plant: FloatArray) -> None:
    """With one of two cameras dead, a stop is certified with its last frame, and reports it."""
    planner = Planner(robot, SCENE)
    planner.plan(begins_s=0.0)
    aside, options = plant + np.array([0.0, 0.0, 1.0]), CloudOptions(max_age_s=0.2)
    see(planner, aside, time_s=0.0, options=options)
    planner.set_cloud("other", aside, radius=0.01, pose=POSE, time_s=0.0, options=options)
    found = planner.replan(at=0.3, now=0.1)
    ages = {"plant": {"age_s": 0.1}, "other": {"age_s": 0.1}}
    assert found.report["frames"] == ages
    assert pickle.loads(pickle.dumps(found)).report["frames"] == ages
    see(planner, aside, time_s=0.25, options=options)
    with pytest.raises(FrameError, match=r"frame of 'other': it is 0.3 s old; the maximum age is 0.2 s") as error:
        planner.replan(at=0.5, now=0.3)
    assert (error.value.name, error.value.age_s, error.value.max_age_s) == ("other", 0.3, 0.2)
    stop = planner.stop_at(0.3, now=0.3)
    assert not stop.certificate.verified
    assert any("0.3 s old" in violation for violation in stop.certificate.violations)
    for call in (lambda: planner.plan(begins_s=0.3), lambda: planner.replan(begins_s=0.3)):
        with pytest.raises(FrameError, match="'other'"):
            call()
    see(planner, aside, time_s=1e9, options=options)
    with pytest.raises(FrameError, match="in the future; expected the controller's clock"):
        planner.replan(at=0.5, now=0.3)
    planner.remove("other")
    planner.remove("plant")
    assert isinstance(planner.replan(at=0.5, now=0.3), PlanResult)


def test_age_without_stamps_counts_from_the_call(
    robot: Robot, plant: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    planner, began = Planner(robot, SCENE), time.monotonic()
    see(planner, plant[:0], time_s=None, options=CloudOptions(allow_empty=True, max_age_s=1e3))
    planner.plan()
    monkeypatch.setattr("hplan.online.frame_check.time.monotonic", lambda: began + 2e3)
    with pytest.raises(FrameError, match="the maximum age is 1000 s"):
        planner.plan()


def test_refused_frame_frees_no_unknown_space(robot: Robot, plant: FloatArray) -> None:
    planner = Planner(robot, SCENE)
    see(planner, plant, unknown="solid", keep_s=9.0)
    assert planner._space is not None
    times, since_s = planner._space.times.copy(), planner._known_since_s
    for kind in ("millimetres", "maximum range", "all NaN", "older"):
        with pytest.raises(InputError):
            see(planner, **{"points": plant, "time_s": 2.0, "unknown": "solid"} | BAD[kind](plant))
    assert (planner._space.times == times).all()
    assert planner._known_since_s == since_s
