"""Planning scenes that change, as objects and as dicts."""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hplan.apps.ros import (
    SceneUpdates,
    cloud_points,
    from_joint_trajectory,
    joint_trajectories,
    read_attached,
    read_planning_scene,
    to_joint_trajectory,
)
from hplan.apps.ros.mcap_file import _Encoder
from hplan.errors import InputError, OptionError, SceneError
from hplan.robot.model import Robot


def as_object(content: Any) -> Any:
    """A message of dicts as one of objects, with arrays of numbers."""
    if isinstance(content, dict):
        return SimpleNamespace(**{key: as_object(value) for key, value in content.items()})
    if isinstance(content, list) and content and all(isinstance(item, float) for item in content):
        return array("d", content)
    return [as_object(item) for item in content] if isinstance(content, list) else content


def ball(name: str, x: float, operation: int | bytes | str = 0, frame: str = "world") -> dict[str, Any]:
    pose = {"position": {"x": x, "y": 0.0, "z": 0.5}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    shape = {"type": 2, "dimensions": [0.1]}
    return {"id": name, "header": {"frame_id": frame}, "pose": pose, "primitives": [shape], "operation": operation}


def scene(*objects: dict[str, Any], is_diff: bool = False, **parts: Any) -> dict[str, Any]:
    return {"is_diff": is_diff, "world": {"collision_objects": list(objects)}, **parts}


def attached(name: str, operation: int = 0) -> dict[str, Any]:
    item = {"link_name": "hand", "object": {**ball(name, 0.0), "operation": operation}}
    return {"attached_collision_objects": [item]}


def places(updates: SceneUpdates) -> dict[str, float]:
    return {item.name: float(item.core[0, 0]) for item in updates.obstacles}


@pytest.mark.parametrize("form", [dict, as_object])
def test_differences_are_applied(form: Any) -> None:
    updates = SceneUpdates()
    with pytest.raises(SceneError, match="no whole planning scene"):
        _ = updates.obstacles
    with pytest.raises(SceneError, match="no whole planning scene"):
        updates.apply(form(scene(ball("a", 1.0), is_diff=True)))
    updates.apply(form(scene(ball("a", 1.0), ball("b", 2.0, b"\0"))))
    assert places(updates) == {"a": 1.0, "b": 2.0}
    more = {**ball("b", 9.0, b"\2"), "primitives": [{"type": 2, "dimensions": [0.2]}]}
    updates.apply(form(scene(ball("a", 1.5, "move"), more, ball("c", 3.0), is_diff=True)))
    assert places(updates) == {"a": 1.5, "b 1": 2.0, "b 2": 2.0, "c": 3.0}
    updates.apply(form(scene({"id": "b", "operation": b"\1"}, ball("c", 4.0, 0), is_diff=True)))
    assert places(updates) == {"a": 1.5, "c": 4.0}
    updates.apply(form(scene({"id": "", "operation": 1}, is_diff=True)))
    assert places(updates) == {}
    updates.apply(form(scene(ball("d", 1.0))))
    assert places(updates) == {"d": 1.0}


def test_world_that_starts_empty_takes_differences() -> None:
    updates = SceneUpdates(starts_empty=True, position=(0.0, 0.0, 1.0))
    assert updates.obstacles == ()
    updates.apply(scene(ball("a", 1.0), is_diff=True))
    assert updates.obstacles[0].core[0].tolist() == [1.0, 0.0, 1.5]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (scene(ball("x", 1.0, 3), is_diff=True), "expected a known object to move"),
        (scene(ball("a", 1.0, 7), is_diff=True), "unknown operation 7"),
        (scene(ball("a", 1.0, frame="camera"), is_diff=True), "in 'camera'"),
        (scene(is_diff=True, robot_state=attached("a")), "'a' is attached to link 'hand'"),
        (scene(is_diff=True, link_scale=[{"link_name": "hand", "scale": 1.2}]), "scale"),
        ({"is_diff": True, "wrld": {"collision_objects": [1]}}, "unknown key"),
    ],
)
def test_nothing_is_known_after_a_message_that_is_refused(change: dict[str, Any], reason: str) -> None:
    updates = SceneUpdates()
    updates.apply(scene(ball("z", 0.0), ball("a", 1.0)))
    with pytest.raises(SceneError, match=reason):
        updates.apply(change)
    with pytest.raises(SceneError, match=reason):
        _ = updates.obstacles
    with pytest.raises(SceneError, match=reason):  # a difference to an unknown world
        updates.apply(scene(is_diff=True))
    updates.apply(scene(ball("a", 1.0)))
    assert places(updates) == {"a": 1.0}


def test_attached_object_leaves_the_world() -> None:
    updates = SceneUpdates(leave_out=("attached_collision_objects",))
    updates.apply(scene(ball("a", 1.0), ball("b", 2.0)))
    updates.apply(scene(is_diff=True, robot_state=attached("a")))
    assert places(updates) == {"b": 2.0}
    updates.apply(scene(ball("a", 1.2), is_diff=True, robot_state=attached("a", 1)))
    assert places(updates) == {"a": 1.2, "b": 2.0}


def test_attached_object_is_held_until_it_is_put_back() -> None:
    """Its shape is in the frame of its link; its names of links are those that it may touch."""
    box = {"type": 1, "dimensions": [0.1, 0.2, 0.3]}
    held = {**ball("a", 0.0, frame="hand"), "primitives": [box, {"type": 2, "dimensions": [0.05]}]}
    item = {"link_name": "hand", "object": held, "touch_links": ["finger"], "weight": 2.0}
    updates = SceneUpdates()
    updates.apply(as_object(scene(ball("a", 1.0), ball("b", 2.0))))
    updates.apply(as_object(scene(is_diff=True, robot_state={"attached_collision_objects": [item]})))
    assert places(updates) == {"b": 2.0}
    assert [(each.name, each.frame, each.may_touch) for each in updates.attached] == [
        ("a 1", "hand", ("finger",)),
        ("a 2", "hand", ("finger",)),
    ]
    assert sum(each.mass for each in updates.attached) == pytest.approx(2.0)
    assert updates.attached[0].mass / updates.attached[1].mass == pytest.approx(0.006 / (4.0 / 3.0 * np.pi * 0.05**3))
    np.testing.assert_allclose(updates.attached[1].object.core, [[0.0, 0.0, 0.5]])
    updates.apply(scene(ball("a", 1.2), is_diff=True, robot_state=attached("a", 1)))
    assert updates.attached == ()
    assert places(updates) == {"b": 2.0, "a": 1.2}
    with pytest.raises(SceneError, match="but it is in frame 'world'"):
        read_attached({"robot_state": attached("a")})


def test_padding_of_links_is_a_clearance() -> None:
    updates = SceneUpdates(leave_out=("link_padding",))
    padding = [{"link_name": "hand", "padding": 0.01}, {"link_name": "arm", "padding": 0.0}]
    updates.apply(as_object(scene(ball("a", 1.0), link_padding=padding)))
    assert updates.padding_m == 0.01
    updates.apply(scene(is_diff=True))
    assert updates.padding_m == 0.01
    updates.apply(scene())
    assert updates.padding_m == 0.0


def test_map_is_replaced_and_removed() -> None:
    tree = {"binary": True, "id": "OcTree", "resolution": 0.1, "data": array("b", [3, 0] * 15 + [2, 0])}
    with_map = scene(is_diff=True)
    with_map["world"]["octomap"] = {"header": {"frame_id": "world"}, "octomap": tree}
    updates = SceneUpdates(starts_empty=True)
    updates.apply(as_object(with_map))
    assert [item.name for item in updates.obstacles] == ["octomap 1"]
    updates.apply(scene(ball("a", 1.0), is_diff=True))
    assert len(updates.obstacles) == 2
    updates.apply(scene({"id": "<octomap>", "operation": "remove"}, is_diff=True))
    assert places(updates) == {"a": 1.0}


def test_objects_and_dicts_give_the_same_obstacles() -> None:
    corners = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    faces = ([0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3])
    mesh = {
        "vertices": [dict(zip("xyz", corner, strict=True)) for corner in corners],
        "triangles": [{"vertex_indices": row} for row in faces],
    }
    content = scene({**ball("a", 1.0), "primitives": [], "meshes": [mesh]}, ball("b", 2.0))
    found, expected = read_planning_scene(as_object(content)), read_planning_scene(content)
    assert [item.model_dump() for item in found] == [item.model_dump() for item in expected]


def points_of(robot: Robot) -> dict[str, Any]:
    points: list[dict[str, Any]] = [
        {"positions": [0.1 * k, 0.9, 0.6, 0.3], "velocities": [0.0] * 4, "time_from_start": {"sec": k, "nanosec": 5}}
        for k in range(3)
    ]
    points[0]["time_from_start"] = {"sec": 0, "nanosec": 0}
    return {"joint_names": list(robot.joint_names), "points": points}


@pytest.mark.parametrize("form", [dict, as_object])
def test_motions_within_other_messages(robot: Robot, form: Any) -> None:
    part = points_of(robot)
    expected = from_joint_trajectory(part, robot=robot)
    assert expected.time.tolist() == [0.0, 1.000000005, 2.000000005]
    moved = {"joint_trajectory": part, "multi_dof_joint_trajectory": {"points": []}}
    for whole in (part, {"trajectory": part}, moved, {"trajectory": [moved]}):
        found = from_joint_trajectory(form(whole), robot=robot)
        np.testing.assert_array_equal(found.position, expected.position)
        np.testing.assert_array_equal(found.torque, expected.torque)
    assert len(joint_trajectories(form({"trajectory": [moved, moved]}))) == 2
    with pytest.raises(InputError, match="has 2 motions, expected one"):
        from_joint_trajectory(form({"trajectory": [moved, moved]}))
    with pytest.raises(InputError, match=r"multi-DOF joints \(base\)"):
        from_joint_trajectory(form(moved | {"multi_dof_joint_trajectory": {"joint_names": ["base"], "points": [{}]}}))
    with pytest.raises(OptionError, match="a JointTrajectory"):
        joint_trajectories(3)


def test_joints_at_rest_are_filled_in(robot: Robot) -> None:
    part = points_of(robot)
    part["joint_names"] = part["joint_names"][:3]
    for point in part["points"]:
        point["positions"], point["velocities"] = point["positions"][:3], [0.0] * 3
    with pytest.raises(InputError, match="the joints of 'harvester' are"):
        from_joint_trajectory(part, robot=robot)
    found = from_joint_trajectory(part, robot=robot, rest={"wrist": 0.25, "finger": 1.0})
    assert found.position[:, 3].tolist() == [0.25] * 3
    assert found.interpolation == "cubic"


def test_cloud_as_object_and_dict() -> None:
    points = np.arange(6.0, dtype=np.float32).reshape(2, 3)
    fields = [{"name": axis, "offset": 4 * k, "datatype": 7} for k, axis in enumerate("xyz")]
    content = {"height": 1, "width": 2, "point_step": 12, "row_step": 24, "is_bigendian": False, "fields": fields}
    for data in (points.tobytes(), list(points.tobytes()), array("B", points.tobytes())):
        for form in (dict, as_object):
            np.testing.assert_array_equal(cloud_points(form({**content, "data": data})), points)


def test_objects_of_rosbags(robot: Robot) -> None:
    """Decoded messages have arrays of NumPy, also a cloud with bytes between its points and its rows."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    expected = from_joint_trajectory(points_of(robot), robot=robot)
    message = to_joint_trajectory(expected)
    kind = "trajectory_msgs/msg/JointTrajectory"
    decoded = store.deserialize_cdr(store.serialize_cdr(_Encoder(store).message(kind, message), kind), kind)
    found = from_joint_trajectory(decoded, robot=robot)
    np.testing.assert_array_equal(found.position, expected.position)
    assert found.interpolation == "cubic"
    points = np.random.default_rng(0).normal(size=(2, 3, 3)).astype(np.float32)
    data = np.zeros((2, 3 * 20 + 4), dtype=np.uint8)  # 20 bytes for each point, x at 4; 4 bytes after each row
    for row, column in np.ndindex(2, 3):
        data[row, 20 * column + 4 : 20 * column + 16] = points[row, column].view(np.uint8)
    field, cloud, header, time = (
        store.types[name]
        for name in ("sensor_msgs/msg/PointField", "sensor_msgs/msg/PointCloud2", "std_msgs/msg/Header",
                     "builtin_interfaces/msg/Time")
    )  # fmt: skip
    fields = [field(name=name, offset=offset, datatype=7, count=1) for name, offset in (("z", 12), ("x", 4), ("y", 8))]
    message = cloud(header(time(0, 0), "base_link"), 2, 3, fields, False, 20, 64, data.ravel(), False)
    np.testing.assert_array_equal(cloud_points(message), points.reshape(-1, 3))
