from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pages import animation_of, commands_of, objects, orchard, steady_motion
from scipy.spatial.transform import Rotation

from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.apps.view.scene_stage import REST_S, build_stage, keyframe_times
from hplan.apps.view.scenery import METAL, UNPICKED_COLORS, WOOD, moving_nodes, obstacles, picks
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal
from hplan.scene.obstacles import Box, Capsule, Cylinder
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Phase, Trajectory

CAPSULES = (
    Capsule(name="tree 1 branch 1", start=(1.6, 0.5, 0.0), end=(1.2, 0.1, 1.4), radius=0.03),
    Capsule(name="tree 1 shoot 2", start=(0.4, 0.8, 1.0), end=(0.4, 0.8, 1.0), radius=0.05),
    Capsule(name="wire 1", start=(1.4, -2.0, 1.0), end=(1.4, 2.0, 1.0), radius=0.002),
    Capsule(name="trunk", start=(1.4, 0.0, 0.0), end=(1.4, 0.0, 1.0), radius=0.04),
)


def motion(robot: Robot, duration: float = 2.0) -> Trajectory:
    return steady_motion(robot, (0.3, 0.8, 0.9, 0.4), duration)


def tracks(commands: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Path -> property -> track."""
    return {
        item["path"]: {track["name"]: track for track in item["clip"]["tracks"]}
        for item in animation_of(commands)["animations"]
    }


def seen_at(track: dict[str, Any], time: float) -> bool:
    return bool(track["values"][int(np.searchsorted(track["times"], time, side="right")) - 1])


def test_capsules_of_equal_appearance_share_one_shape(robot: Robot) -> None:
    found = objects(build_stage(robot, orchard(obstacles=CAPSULES), Playback(motion(robot))))
    body = found["/hplan/obstacles/Wood"]
    walls, ends = body["object"]["children"]
    assert {walls["type"], ends["type"]} == {"InstancedMesh"}
    assert (walls["count"], ends["count"]) == (2, 6)  # no wall without length
    assert not walls["frustumCulled"]
    assert not ends["frustumCulled"]
    assert [surface["color"] for surface in body["materials"]] == [WOOD.color]
    poses = np.reshape(walls["instanceMatrix"]["array"], (-1, 4, 4)).swapaxes(1, 2)
    for pose, item in zip(poses, (CAPSULES[0], CAPSULES[3]), strict=True):
        start, end = np.array(item.start), np.array(item.end)
        # The shape is a cylinder of length 1 and radius 1 about y.
        np.testing.assert_allclose(pose @ [0, 0.5, 0, 1], [*end, 1], atol=2e-6)
        np.testing.assert_allclose(pose @ [0, -0.5, 0, 1], [*start, 1], atol=2e-6)
        for across in ([1, 0, 0, 0], [0, 0, 1, 0]):
            side = (pose @ across)[:3]
            assert np.linalg.norm(side) == pytest.approx(item.radius, abs=2e-6)
            assert side @ (end - start) == pytest.approx(0.0, abs=1e-5)
        assert np.linalg.det(pose[:3, :3]) > 0.0  # a mirrored shape would be seen from inside
    # The shape of the ends is the upper half of a ball: it must look away from the capsule.
    caps = np.reshape(ends["instanceMatrix"]["array"], (-1, 4, 4)).swapaxes(1, 2)
    assert (np.linalg.det(caps[:, :3, :3]) > 0.0).all()
    for number, item in enumerate((CAPSULES[0], CAPSULES[1], CAPSULES[3])):
        axis = np.array(item.end) - np.array(item.start)
        for cap, center, sign in ((caps[2 * number], item.end, 1), (caps[2 * number + 1], item.start, -1)):
            np.testing.assert_allclose(cap[:3, 3], center, atol=1e-6)
            if axis.any():
                top = sign * item.radius * axis / np.linalg.norm(axis)
                np.testing.assert_allclose(cap[:3, 1], top, atol=2e-6)
    wires = found["/hplan/obstacles/Posts and wires"]
    assert [surface["color"] for surface in wires["materials"]] == [METAL.color]


def test_picked_fruit_changes_its_colour_and_goes_with_the_tool(robot: Robot) -> None:
    trajectory = motion(robot)
    phases = (Phase("transit", 0.0, 0.6), Phase("approach", 0.6, 1.0), Phase("retreat", 1.0, 2.0))
    commands = build_stage(
        robot, orchard(obstacles=CAPSULES), Playback(trajectory, picked={"ripe": 1.0}, phases=phases)
    )
    found = tracks(commands)
    hanging = found["/hplan/fruits/fruit ripe"][".visible"]
    held = found["/hplan/picked/fruit ripe"]
    place = found["/hplan/places/fruit ripe"][".visible"]
    for time, taken in ((0.0, False), (0.99, False), (1.01, True), (2.0, True), (2.0 + REST_S, True)):
        assert seen_at(hanging, time) is not taken
        assert seen_at(held[".visible"], time) is taken
        assert seen_at(place, time) is taken
    assert "/hplan/fruits/fruit green" not in found
    # All clips end together: else the parts of the page would drift apart from round to round.
    ends = {track["times"][-1] for item in found.values() for track in item.values()}
    assert ends == {2.0 + REST_S}
    way = held[".position"]
    places = np.reshape(way["values"], (-1, 3))
    tool = robot.tool_positions(trajectory.position)
    for time in (0.0, 1.0, 1.5, 2.0, 2.0 + REST_S):
        got = [np.interp(time, way["times"], axis) for axis in places.T]
        at, taken = tool[min(round(250 * time), 500)], tool[250]
        expected = np.array((1.2, 0.3, 1.4)) + (at - taken if time > 1.0 else 0.0)
        np.testing.assert_allclose(got, expected, atol=1e-4)
    green = objects(commands)["/hplan/picked/fruit ripe"]["materials"][0]["color"]
    assert green != objects(commands)["/hplan/fruits/fruit ripe"]["materials"][0]["color"]


def test_of_a_tour_the_tool_holds_one_fruit_until_it_lets_it_go(robot: Robot) -> None:
    scene, trajectory = orchard(obstacles=CAPSULES), motion(robot, 4.0)
    retreats = (Phase("retreat", 1.0, 1.4), Phase("retreat", 3.0, 3.4))
    times = {"green": 3.0, "ripe": 1.0}
    assert [(p.fruit.name, p.since, p.until) for p in picks(scene, Playback(trajectory, times, phases=retreats))] == [
        ("ripe", 1.0, 1.4),
        ("green", 3.0, 3.4),
    ]
    late = {"ripe": 3.5, "green": 4.0}
    assert [p.until for p in picks(scene, Playback(trajectory, times, late, retreats))] == [3.0, math.inf]
    assert picks(scene, Playback(trajectory, phases=retreats)) == []
    commands = build_stage(robot, scene, Playback(trajectory, picked=times, dropped={"ripe": 2.0, "green": 3.8}))
    held = tracks(commands)["/hplan/picked/fruit ripe"][".visible"]
    assert [seen_at(held, time) for time in (0.5, 1.5, 2.5)] == [False, True, False]
    # With several fruits none is the one to pick, and the goal has no single pose.
    assert len(objects(commands)["/hplan/fruits/fruit ripe"]["object"]["children"]) == 1
    assert not any("pose" in path for path in objects(commands))


def test_cylinder_lies_where_it_is() -> None:
    """three.js has it along y: the matrix takes y to the cylinder's axis."""
    can = Cylinder(name="can", center=(1.2, 0.1, 0.9), length=0.3, radius=0.05, rpy_deg=(0.0, 90.0, 30.0))
    (command,) = obstacles(orchard(obstacles=(can,), goal=Goal(joints_deg=(0.0,) * 4)))
    (geometry,) = command["object"]["geometries"]
    assert (geometry["type"], geometry["height"], geometry["radiusTop"]) == ("CylinderGeometry", 0.3, 0.05)
    (mesh,) = command["object"]["object"]["children"]
    matrix = np.reshape(mesh["matrix"], (4, 4)).T
    np.testing.assert_allclose(matrix[:3, 1], [math.cos(math.radians(30)), 0.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 3], can.center, atol=1e-6)


# Moving obstacles

TURNING = Track(
    times_s=(0.0, 1.0, 3.0),
    shifts_m=((0.0, 0.0, 0.0), (0.5, 0.0, 0.2), (0.0, 0.5, 0.0)),
    rpy_deg=((0.0, 0.0, 0.0), (30.0, 20.0, 10.0), (0.0, 0.0, 90.0)),
    about=(1.4, 0.0, 0.5),
)


@pytest.mark.parametrize("creeping", [False, True])
def test_tracked_obstacles_are_where_the_scene_puts_them(robot: Robot, creeping: bool) -> None:
    box = Box(name="cart", center=(1.6, 0.2, 0.4), size=(0.2, 0.3, 0.4), track=TURNING)
    branch = CAPSULES[0].model_copy(update={"track": TURNING})
    base = Track(times_s=(0.0, 2.0), shifts_m=((0.0, 0.0, 0.0), (0.4, 0.0, 0.0))) if creeping else None
    scene = orchard(goal=Goal(joints_deg=(0, 9, 9, 9)), obstacles=(*CAPSULES[1:], branch, box), base_track=base)
    playback = Playback(motion(robot), begin_s=0.25)
    commands = build_stage(robot, scene, playback)
    nodes = moving_nodes(scene)
    assert nodes["cart"] == nodes[branch.name]
    assert ("ripe" in nodes) == creeping
    paths = objects(commands)
    assert f"{nodes['cart']}/box cart" in paths
    assert f"{nodes['cart']}/Wood" in paths
    # The others are static, or move with the base alone.
    rest = nodes[CAPSULES[1].name] if creeping else "/hplan/obstacles"
    assert f"{rest}/Wood" in paths
    clips = {
        path: {name: np.reshape(track["values"], (len(track["times"]), -1)) for name, track in each.items()}
        for path, each in tracks(commands).items()
    }
    assert {path for path in clips if "moving" in path} == set(nodes.values())
    times = keyframe_times(playback.trajectory)
    for name in ("cart", *(["ripe"] if creeping else [])):
        turns, shifts = scene.poses_at(0.25 + times)[name]
        found = clips[nodes[name]]
        np.testing.assert_allclose(found[".position"][:-1], shifts, atol=1e-5)
        quaternions = Rotation.from_quat(found[".quaternion"][:-1])
        np.testing.assert_allclose(quaternions.as_matrix(), turns, atol=1e-5)
        np.testing.assert_array_equal(found[".position"][-1], found[".position"][-2])
        (at_first,) = [c["matrix"] for c in commands if c["type"] == "set_transform" and c["path"] == nodes[name]]
        np.testing.assert_allclose(np.reshape(at_first, (4, 4)).T[:3, 3], shifts[0], atol=1e-5)


def test_fruit_that_is_not_picked_has_the_colour_of_its_reason(robot: Robot) -> None:
    names = ("far", "behind", "narrow", "lost", "ripe")
    fruits = tuple(Fruit(name=name, center=(1.0, 0.1 * k, 1.0), radius=0.03) for k, name in enumerate(names))
    scene = orchard(fruits=fruits)
    unpicked = dict(zip(names, UNPICKED_COLORS, strict=False))
    page = render_page(robot, scene, Playback(steady_motion(robot, (0.1, 0.2, 0.2, 0.2)), unpicked=unpicked))
    drawn = {path.rpartition("/")[2]: body for path, body in objects(commands_of(page)).items() if "/fruits/" in path}
    colors = {name: next(iter(drawn[f"fruit {name}"]["materials"]))["color"] for name in names}
    assert [colors[name] for name in names[:4]] == list(UNPICKED_COLORS.values())
    assert colors["ripe"] not in UNPICKED_COLORS.values()
    for words in ("Out of reach", "Blocked", "No approach", "No motion found"):
        assert words in page
