"""MCAP files, read back by another library than the one that writes them, and the option `--mcap`."""

from __future__ import annotations

import math
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from hplan.apps.cli.main import main
from hplan.apps.ros import scene_markers, write_mcap
from hplan.apps.ros.marked_motion import NearestPairs, fruit_events
from hplan.apps.ros.mcap_file import TOPICS
from hplan.apps.ros.transforms import LinkFrames
from hplan.apps.view.scenery import Pick
from hplan.certificate.certificate import certify
from hplan.collision.coal_scene import CoalScene
from hplan.errors import InputError, OptionError, OutputError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, PointCloud, Sphere
from hplan.scene.tracks import Track
from hplan.tour.tour import TourOptions, plan_tour

reader = pytest.importorskip("mcap.reader")
decoder = pytest.importorskip("mcap_ros2.decoder")
pytest.importorskip("rosbags")

CORNERS = np.array([(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.2)])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
OBSTACLES = (
    Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15),
    Capsule(name="branch", start=(1.5, -0.8, 1.0), end=(1.5, -0.6, 1.6), radius=0.03),
    Capsule(name="knob", start=(1.5, -0.8, 0.5), end=(1.5, -0.8, 0.5), radius=0.03),
    Cylinder(name="can", center=(0.4, 1.2, 0.8), length=0.14, radius=0.05, rpy_deg=(0.0, 90.0, 30.0)),
    Box(name="crate", center=(-0.9, 0.0, 0.2), size=(0.3, 0.4, 0.2), rpy_deg=(0.0, 0.0, 30.0)),
    Mesh.from_arrays("wedge", CORNERS, FACES, position=(-1.0, 1.0, 0.0)),
    PointCloud.from_points("leaves", CORNERS, 0.02, position=(1.0, 1.2, 1.6)),
)
FRUITS = (
    Fruit(name="ripe", center=(1.2, 0.5, 1.7), radius=0.04),
    Fruit(name="green", center=(1.3, 0.7, 1.5), radius=0.05),
)


def task(**goal: Any) -> Scene:
    start = Start(joints_deg=(0.0, 60.0, 30.0, 30.0))
    return Scene(name="everything", start=start, goal=Goal(**goal), obstacles=OBSTACLES, fruits=FRUITS)


@pytest.fixture(scope="module")
def picked(robot: Robot) -> PlanResult:
    return plan(robot, task(fruit="ripe"), PlanOptions(effort="quick"))


class Recorded:
    """The messages of a file by their topics, each with its time."""

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
        self.channels = {}
        with path.open("rb") as stream:
            file = reader.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
            assert file.get_header().profile == "ros2"
            for schema, channel, message, content in file.iter_decoded_messages():
                assert schema.name == TOPICS[channel.topic][0]
                self.messages[channel.topic].append((message.log_time, content))
                self.channels[channel.topic] = channel

    def only(self, topic: str) -> Any:
        ((_, content),) = self.messages[topic]
        return content


@pytest.fixture(scope="module")
def recorded(picked: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    path = tmp_path_factory.mktemp("mcap") / "motion.mcap"
    assert write_mcap(picked, path, rate_hz=50.0, stamp_s=5.25) == path
    assert [file.name for file in path.parent.iterdir()] == ["motion.mcap"]
    return Recorded(path)


def stamp_of(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def xyz(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def pose_of(pose: Any) -> pin.SE3:
    turn = pin.Quaternion(pose.orientation.w, *xyz(pose.orientation))
    return pin.SE3(turn.toRotationMatrix(), np.array(xyz(pose.position)))


def transform_of(transform: Any) -> pin.SE3:
    turn = pin.Quaternion(transform.rotation.w, *xyz(transform.rotation))
    return pin.SE3(turn.toRotationMatrix(), np.array(xyz(transform.translation)))


def test_all_topics_exist_and_static_ones_are_latched(recorded: Recorded) -> None:
    assert set(recorded.messages) == set(TOPICS)
    for topic, channel in recorded.channels.items():
        kept = "transient_local" in channel.metadata["offered_qos_profiles"]
        assert kept == (topic in ("/robot_description", "/tf_static", "/scene", "/certificate"))
        times = [time for time, _ in recorded.messages[topic]]
        assert times == sorted(times)
        assert times[0] == 5_250_000_000 or topic == "/clearance"


def test_states_and_transforms_go_together(recorded: Recorded, picked: PlanResult, robot: Robot) -> None:
    """The transforms of each state, by another library's forward kinematics."""
    states, transforms = recorded.messages["/joint_states"], recorded.messages["/tf"]
    trajectory = picked.trajectory
    assert len(states) == len(transforms) == pytest.approx(50.0 * trajectory.duration, abs=3)
    assert states[-1][0] == 5_250_000_000 + round(trajectory.duration * 1e9)
    urdf = yourdfpy.URDF.load(str(robot.urdf_path))
    fixed = {item.child_frame_id: item for item in recorded.only("/tf_static").transforms}
    assert set(fixed) == {"tool0"}
    for (time, state), (other, message) in zip(states, transforms, strict=True):
        assert time == other == stamp_of(state.header)
        clock = 1e-9 * (time - 5_250_000_000)
        row = int(np.abs(trajectory.time - clock).argmin())
        assert trajectory.time[row] == pytest.approx(clock, abs=1e-9)
        assert list(state.name) == list(robot.joint_names)
        assert list(state.position) == trajectory.position[row].tolist()
        assert list(state.velocity) == trajectory.velocity[row].tolist()
        assert list(state.effort) == trajectory.torque[row].tolist()
        urdf.update_cfg(dict(zip(state.name, state.position, strict=True)))
        links = {item.child_frame_id: item for item in message.transforms} | fixed
        assert set(links) == set(urdf.link_map) - {"base_link"}
        for link, item in links.items():
            assert stamp_of(item.header) == time or link in fixed
            expected = urdf.get_transform(link, item.header.frame_id)
            np.testing.assert_allclose(transform_of(item.transform).homogeneous, expected, atol=1e-12)


def test_markers_fill_the_obstacles(recorded: Recorded, robot: Robot) -> None:
    """A ball of coal's that touches an obstacle touches its markers, and no other does."""
    scene, (time, message) = task(fruit="ripe"), recorded.messages["/scene"][0]
    assert time == 5_250_000_000
    markers = [marker for marker in message.markers if marker.ns == "obstacles"]
    assert [marker.id for marker in markers] == list(range(len(markers)))
    assert {(m.header.frame_id, stamp_of(m.header), m.action) for m in message.markers} == {("base_link", time, 0)}
    kinds = [marker.type for marker in markers]
    assert kinds == [2, 3, 2, 2, 2, 3, 1, 11, 7]
    ball, wall, top, bottom, knob, can, crate, wedge, leaves = markers
    assert (xyz(ball.pose.position), xyz(ball.scale)) == ([1.0, 0.0, 1.9], [0.3] * 3)
    length = math.hypot(0.2, 0.6)
    np.testing.assert_allclose(xyz(wall.scale), [0.06, 0.06, length], atol=1e-12)
    along = pose_of(wall.pose).rotation[:, 2]
    np.testing.assert_allclose(along, np.array([0.0, 0.2, 0.6]) / length, atol=1e-12)
    np.testing.assert_allclose(xyz(wall.pose.position), [1.5, -0.7, 1.3], atol=1e-12)
    assert [xyz(end.pose.position) for end in (top, bottom)] == [[1.5, -0.8, 1.0], [1.5, -0.6, 1.6]]
    assert xyz(knob.scale) == [0.06] * 3
    np.testing.assert_allclose(pose_of(can.pose).rotation, OBSTACLES[3].rotation, atol=1e-12)
    assert xyz(can.scale) == [0.1, 0.1, 0.14]
    np.testing.assert_allclose(pose_of(crate.pose).rotation, OBSTACLES[4].rotation, atol=1e-12)
    assert xyz(crate.scale) == [0.3, 0.4, 0.2]
    corners = (CORNERS + np.array([-1.0, 1.0, 0.0]))[np.ravel(FACES)]
    np.testing.assert_allclose([xyz(point) for point in wedge.points], corners)
    np.testing.assert_allclose(
        sorted(xyz(point) for point in leaves.points), sorted((CORNERS + np.array([1.0, 1.2, 1.6])).tolist())
    )
    assert xyz(leaves.scale) == [0.04] * 3
    fruits = [marker for marker in message.markers if marker.ns == "fruits"]
    assert [(m.id, xyz(m.pose.position), m.scale.x) for m in fruits] == [
        (0, list(FRUITS[0].center), 0.08),
        (1, list(FRUITS[1].center), 0.1),
    ]
    assert fruits[0].color.g != fruits[1].color.g
    assert len(scene_markers(scene)) == len(message.markers)


def test_fruit_keeps_its_place_in_the_tool(picked: PlanResult) -> None:
    pick, robot, trajectory = Pick(FRUITS[1], since=0.3, until=0.5), picked.robot, picked.trajectory
    (since, held), (until, gone) = fruit_events(robot, picked.scene, trajectory, [pick])
    assert (since, until, gone["action"], gone["id"]) == (0.3, 0.5, 2, 1)
    frames = LinkFrames(robot)
    frames.place(trajectory.positions(np.array([0.3]))[0])
    place = frames.pose("tool0").act(np.array(list(held["pose"]["position"].values())))
    np.testing.assert_allclose(place, FRUITS[1].center, atol=1e-12)


def test_nearest_pairs_agree_with_coal(recorded: Recorded, picked: PlanResult) -> None:
    curve, seen = picked.certificate.clearance_curve, set()
    checker, trajectory = CoalScene(picked.robot, picked.scene.solids_with_goal), picked.trajectory
    assert curve is not None
    for time, message in recorded.messages["/nearest"]:
        (marker,) = message.markers
        clock = 1e-9 * (time - 5_250_000_000)
        link, obstacle = curve.pairs[int(curve.nearest[np.abs(curve.time - clock).argmin()])]
        seen.add(obstacle)
        if marker.action == 2:
            assert obstacle not in checker.obstacle_names
            continue
        table = checker.distances(trajectory.position[np.abs(trajectory.time - clock).argmin()])
        expected = table[checker.link_names.index(link), checker.obstacle_names.index(obstacle)]
        ends = np.array([xyz(point) for point in marker.points])
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(abs(expected), abs=1e-5)
    assert {"ripe", "ball"} <= seen
    for time, message in recorded.messages["/clearance"]:
        bound = float(np.interp(1e-9 * (time - 5_250_000_000), curve.time, curve.clearance_m))
        assert message.data == pytest.approx(bound, abs=1e-9)


def test_nearest_points_of_a_cloud(picked: PlanResult) -> None:
    scene = picked.scene.model_copy(
        update={"obstacles": OBSTACLES[-1:], "fruits": (), "goal": Goal(joints_deg=(0.0,) * 4)}
    )
    robot, trajectory = picked.robot, picked.trajectory
    proof = certify(robot, scene, trajectory, check_ends=False)
    pairs, checker = NearestPairs(robot, scene, proof, "base_link"), CoalScene(robot, scene.solids)
    lines = 0
    for row in range(0, trajectory.samples, 20):
        q = trajectory.position[row]
        marker = pairs.marker(float(trajectory.time[row]), q, {})
        if "points" not in marker:  # two parts of the arm are nearer to each other
            continue
        lines += 1
        ends = np.array([list(point.values()) for point in marker["points"]])
        assert np.abs(checker.distances(q) - np.linalg.norm(ends[1] - ends[0])).min() < 1e-5
        leaves = CORNERS + np.array([1.0, 1.2, 1.6])
        assert np.linalg.norm(leaves - ends[1], axis=1).min() == pytest.approx(0.02, abs=1e-9)
    assert lines > 5


def test_obstacles_that_move(picked: PlanResult, tmp_path: Path) -> None:
    """Moving obstacles have frames of their own, with nearest points at each time."""
    times, up = (0.0, 0.5, 1.5), (0.0, 0.0, 0.6)
    turns = ((0.0, 0.0, 0.0), (0.0, 0.0, 40.0), (0.0, 30.0, 40.0))
    gate = {"rpy_deg": turns, "about": (1.0, -1.0, 1.0), "shifts_m": ((0.0, 0.0, 0.0), up, (0.1, 0.0, 0.6))}
    box = Box(name="gate", center=(1.2, -1.0, 1.2), size=(0.1, 0.5, 0.1), track=Track(times_s=times, **gate))
    creep = Track(times_s=(0.0, 4.0), shifts_m=((0.0, 0.0, 0.0), (-0.2, 0.0, 0.0)))
    changes = {"obstacles": (box,), "fruits": (), "goal": Goal(joints_deg=(0.0,) * 4), "base_track": creep}
    scene = picked.scene.model_copy(update=changes)
    proof = certify(picked.robot, scene, picked.trajectory, check_ends=False)
    assert proof.nearest is not None
    problem = replace(picked.motion.problem, scene=scene)
    moving = replace(picked, motion=replace(picked.motion, problem=problem), certificate=proof, phases=())
    found = Recorded(write_mcap(moving, tmp_path / "moving.mcap", rate_hz=20.0))
    (_, markers), *_ = found.messages["/scene"]
    (marker,) = markers.markers
    assert (marker.header.frame_id, xyz(marker.pose.position)) == ("obstacle/gate", list(box.center))
    lines = dict(found.messages["/nearest"])
    for time, message in found.messages["/tf"]:
        (place,) = [item for item in message.transforms if item.child_frame_id == "obstacle/gate"]
        assert place.header.frame_id == "base_link"
        standing = scene.snapshot(1e-9 * time - 1.0)
        (expected,) = standing.obstacles
        assert isinstance(expected, Box)
        frame = transform_of(place.transform)
        np.testing.assert_allclose(frame.act(np.array(box.center)), expected.center, atol=1e-9)
        np.testing.assert_allclose(frame.rotation @ box.rotation, expected.rotation, atol=1e-9)
        (line,) = lines[time].markers
        if line.action == 0:
            ends = np.array([xyz(point) for point in line.points])
            row = np.abs(picked.trajectory.time - (1e-9 * time - 1.0)).argmin()
            table = CoalScene(picked.robot, standing.solids).distances(picked.trajectory.position[row])
            assert np.abs(table - np.linalg.norm(ends[1] - ends[0])).min() < 1e-5


def test_tour(robot: Robot, tmp_path: Path) -> None:
    drop = Goal(joints_deg=(-30.0, 60.0, 30.0, 30.0))
    options = PlanOptions(effort="quick")
    result = plan_tour(
        robot, task(fruit="ripe"), options, fruits=["green"], tour=TourOptions(drop_off=drop, grasps=1, back=True)
    )
    path = write_mcap(result, tmp_path / "tour.mcap", rate_hz=10.0)
    found = Recorded(path)
    assert len(found.only("/joint_trajectory").points) == result.trajectory.samples
    _, (taken, held), (let_go, gone) = found.messages["/scene"]
    assert taken == 10**9 + round(1e9 * result.picked["green"])
    assert let_go == 10**9 + round(1e9 * result.dropped["green"])
    assert [(m.ns, m.id, m.action) for m in (*held.markers, *gone.markers)] == [("fruits", 1, 0), ("fruits", 1, 2)]


def test_recording_of_motion_stop_and_next_motion(picked: PlanResult, tmp_path: Path) -> None:
    """Each is recorded up to the start of the next on its clock."""
    stop = picked.stop_at(0.2)
    later = replace(picked, begins_s=1.5)
    found = Recorded(write_mcap([picked, stop, later], tmp_path / "run.mcap", rate_hz=1e4, stamp_s=1.0))
    times = [time for time, _ in found.messages["/joint_states"]]
    assert times == sorted(set(times))
    at = {time: np.array(state.position) for time, state in found.messages["/joint_states"]}
    assert stop.trajectory.duration < 1.5
    for row in (5, stop.trajectory.samples - 1):
        now = 10**9 + round(1e9 * stop.trajectory.time[row])
        np.testing.assert_array_equal(at[now], stop.trajectory.position[row])
    last = 10**9 + round(1.5e9) + round(1e9 * picked.trajectory.time[-1])
    np.testing.assert_array_equal(at[last], picked.trajectory.position[-1])
    assert [time for time, _ in found.messages["/joint_trajectory"]] == [
        10**9 + round(1e9 * begin) for begin in (0.0, stop.parts_s, 1.5)
    ]
    assert len(found.messages["/robot_description"]) == 1
    shown = [markers for _, markers in found.messages["/scene"] if len(markers.markers) > 1]
    assert [[m.action for m in markers.markers].count(3) for markers in shown] == [0, 1, 1]
    with pytest.raises(InputError, match="the same robot"):
        write_mcap([], tmp_path / "run.mcap")


def test_files_that_cannot_be_written(picked: PlanResult, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file"):
        write_mcap(picked, tmp_path / "nowhere" / "motion.mcap")
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(OutputError, match="it is a folder"):
        write_mcap(picked, tmp_path / "folder.mcap")
    assert [file.name for file in tmp_path.iterdir()] == ["folder.mcap"]
    for wrong in ({"rate_hz": 0.0}, {"rate_hz": math.nan}, {"stamp_s": -1.0}, {"file": ""}, {"result": None}):
        with pytest.raises(OptionError):
            write_mcap(**{"result": picked, "file": tmp_path / "m.mcap", **wrong})  # type: ignore[arg-type]


mcap_reader = pytest.importorskip("mcap.reader")
pytest.importorskip("rosbags")


def topics(path: Path) -> set[str]:
    with path.open("rb") as stream:
        summary = mcap_reader.make_reader(stream).get_summary()
    return {channel.topic for channel in summary.channels.values()}


def test_of_plans_and_of_tours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, files = str(tmp_path), ("trajectory.csv", "report.json", "scene.html")
    assert main(["plan", "--effort", "quick", "--mcap", "--out", folder]) == 0
    assert "motion.mcap" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {*files, "motion.mcap"}
    assert "/joint_trajectory" in topics(tmp_path / "motion.mcap")
    # An earlier job's file must not remain with this one's report.
    assert main(["plan", "--effort", "quick", "--quiet", "--out", folder]) == 0
    assert {file.name for file in tmp_path.iterdir()} == set(files)
    assert main(["tour", "--fruits", "fruit 01", "--grasps", "1", "--mcap", "--quiet", "--out", folder]) == 0
    assert "/clearance" in topics(tmp_path / "motion.mcap")


@pytest.mark.parametrize("command", ["plan", "tour"])
def test_without_rosbags(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    assert main([command, "--mcap", "--quiet", "--out", str(tmp_path)]) == 2
    assert list(tmp_path.iterdir()) == []
    assert "pip install 'hplan[ros]'" in capsys.readouterr().err
