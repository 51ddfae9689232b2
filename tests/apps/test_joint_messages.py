"""Messages of joints against the definitions of ROS 2, as rosbags has them."""

from __future__ import annotations

import json
from array import array
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.apps.ros import from_joint_trajectory, to_joint_state, to_joint_trajectory, write_joint_trajectory
from hplan.apps.ros.transforms import message_time, seconds_of, time_ns, times_ns
from hplan.certificate.digests import trajectory_digest
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

typesys = pytest.importorskip("rosbags.typesys")


@pytest.fixture(scope="module")
def definitions() -> Any:
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY).fielddefs


@pytest.fixture
def swing(robot: Robot) -> Trajectory:
    """A motion of three samples with distinct numbers."""
    numbers = iter(range(100))
    rows = [[[next(numbers) / 7.0 for _ in range(4)] for _ in range(3)] for _ in range(4)]
    rows[1][0] = [0.0] * 4  # it begins at rest, like a message without a stamp
    return Trajectory(robot.joint_names, [0.0, 0.999999999, 2.0], *rows, interpolation="quintic")


def assert_conforms(content: Any, kind: str, definitions: Any) -> None:
    """A dict has just the fields of a message, each of its kind, all the way down."""
    assert isinstance(content, dict)
    fields = dict(definitions[kind][1])
    assert list(content) == list(fields)
    for name, (node, what) in fields.items():
        items = [content[name]]
        if node.name == "SEQUENCE":
            (node, what), _ = what
            assert isinstance(content[name], list)
            items = content[name]
        for item in items:
            if node.name == "NAME":
                assert_conforms(item, what, definitions)
            else:
                expected = {"s": str, "f": float, "i": int, "u": int, "b": bool}[what[0][0]]
                assert type(item) is expected, (kind, name, item)


@pytest.mark.parametrize("effort", [True, False])
def test_fields_are_those_of_the_definition(swing: Trajectory, definitions: Any, effort: bool) -> None:
    message = to_joint_trajectory(swing, prefix="left_", frame_id="base_link", stamp_s=12.5, effort=effort)
    assert_conforms(message, "trajectory_msgs/msg/JointTrajectory", definitions)
    assert json.loads(json.dumps(message)) == message
    assert message["header"] == {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "base_link"}
    assert message["joint_names"] == ["left_base_yaw", "left_shoulder", "left_elbow", "left_wrist"]
    for row, point in enumerate(message["points"]):
        assert point["positions"] == swing.position[row].tolist()
        assert point["velocities"] == swing.velocity[row].tolist()
        assert point["accelerations"] == swing.acceleration[row].tolist()
        assert point["effort"] == (swing.torque[row].tolist() if effort else [])
    times = [point["time_from_start"] for point in message["points"]]
    assert times == [{"sec": 0, "nanosec": 0}, {"sec": 0, "nanosec": 999_999_999}, {"sec": 2, "nanosec": 0}]


def test_joint_states(swing: Trajectory, definitions: Any) -> None:
    message = to_joint_state(swing, 1, prefix="r/", stamp_s=0.5)
    assert_conforms(message, "sensor_msgs/msg/JointState", definitions)
    assert message["header"]["stamp"] == {"sec": 1, "nanosec": 499_999_999}
    assert message["name"][0] == "r/base_yaw"
    expected = [swing.position[1], swing.velocity[1], swing.torque[1]]
    assert [message[key] for key in ("position", "velocity", "effort")] == [row.tolist() for row in expected]


@settings(max_examples=200)
@given(st.floats(0.0, 2.0**31 - 1.0))
def test_times_are_the_nearest_nanoseconds(seconds: float) -> None:
    found = message_time(time_ns("t", seconds))
    assert 0 <= found["nanosec"] < 1_000_000_000
    exact = Decimal(seconds)
    assert abs(Decimal(found["sec"]) + Decimal(found["nanosec"]) / 10**9 - exact) <= Decimal("5e-10")
    assert seconds_of("t", found) == pytest.approx(seconds, abs=1e-9, rel=1e-15)


def test_many_times_are_those_of_one() -> None:
    """Halves of a nanosecond, and what is next to them, are rounded as one time alone."""
    rng = np.random.default_rng(0)
    halves = (rng.integers(0, 10**9, 5000) + 0.5) / 1e9
    near = [halves, np.nextafter(halves, 0.0), np.nextafter(halves, 1.0), rng.integers(0, 2**20, 5000) + halves]
    exact, others = 0.5**10 * np.arange(2000), rng.uniform(0.0, 2.0**31 - 1, 2000)
    times = np.sort(np.concatenate([*near, exact, others]))
    assert times_ns("time", times) == [time_ns("time", each) for each in times.tolist()]
    with pytest.raises(OptionError, match="time"):
        times_ns("time", np.array([0.0, 2.0**31]))


def test_there_and_back(swing: Trajectory) -> None:
    message = json.loads(json.dumps(to_joint_trajectory(swing, prefix="left_", effort=True)))
    assert trajectory_digest(from_joint_trajectory(message, prefix="left_")) == trajectory_digest(swing)


def test_files_hold_the_message(swing: Trajectory, tmp_path: Path) -> None:
    for name, read in (("motion.yaml", yaml.safe_load), ("motion.json", json.loads)):
        content = write_joint_trajectory(swing, tmp_path / name, prefix="left_").read_text(encoding="utf-8")
        assert read(content) == to_joint_trajectory(swing, prefix="left_")


def test_message_with_other_joint_order_and_without_effort(robot: Robot, swing: Trajectory) -> None:
    message = to_joint_trajectory(swing, effort=False)
    order = [2, 0, 3, 1]
    message["joint_names"] = [message["joint_names"][index] for index in order]
    for point in message["points"]:
        for key in ("positions", "velocities", "accelerations"):
            point[key] = [point[key][index] for index in order]
    found = from_joint_trajectory(message, robot=robot)
    assert found.joint_names == robot.joint_names
    np.testing.assert_array_equal(found.acceleration, swing.acceleration)
    expected = robot.dynamics.torques(swing.position, swing.velocity, swing.acceleration)
    np.testing.assert_allclose(found.torque, expected)
    with pytest.raises(InputError, match=r"points\[0\].effort has 0 numbers"):
        from_joint_trajectory(message)


def test_numbers_in_arrays_as_real_messages_have_them(swing: Trajectory) -> None:
    message = to_joint_trajectory(swing, effort=True)
    fields = ("positions", "velocities", "accelerations", "effort")
    points = [point | {key: array("d", point[key]) for key in fields} for point in message["points"]]
    found = from_joint_trajectory({**message, "points": points})
    np.testing.assert_array_equal(found.position, swing.position)
    assert found.interpolation == swing.interpolation


def broken(message: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {**message, "points": [message["points"][0], {**message["points"][1], **changes}]}


def test_wrong_messages(robot: Robot, swing: Trajectory) -> None:
    good = to_joint_trajectory(swing, effort=True)
    wrong: list[tuple[Any, str]] = [
        ({key: value for key, value in good.items() if key != "points"}, "has no points"),
        ({**good, "points": []}, "points of the message is empty"),
        ({**good, "joint_names": []}, "joint_names of the message is empty"),
        (broken(good, velocities=[]), r"points\[1\].velocities has 0 numbers, expected one for each of 4"),
        (broken(good, positions=[0.0] * 5), r"points\[1\].positions has 5 numbers"),
        (broken(good, positions=[0.0, 1.0, float("nan"), 0.0]), "not finite"),
        (broken(good, time_from_start={"sec": 0, "nanosec": 0}), "does not increase at sample 1"),
        (broken(good, time_from_start={"sec": 0, "nanosec": 10**9}), "nanosec below 1e9"),
        (broken(good, time_from_start=None), r"points\[1\].time_from_start"),
        (broken(good, time_from_start={"sec": 1.5, "nanosec": 0}), "whole numbers"),
        ({**good, "points": good["points"][1:]}, "starts at 0"),
    ]
    for message, reason in wrong:
        with pytest.raises(InputError, match=reason):
            from_joint_trajectory(message)
    with pytest.raises(InputError, match="the joints of 'harvester' are base_yaw"):
        from_joint_trajectory(to_joint_trajectory(swing, prefix="left_"), robot=robot)


def test_anything_in_place_of_a_value_is_an_error_of_our_own(swing: Trajectory) -> None:
    good = to_joint_trajectory(swing, effort=True)
    junk = (None, "text", 1.0, True, [None], [[1.0] * 4], {"sec": 1}, float("nan"), [1j] * 4, object())
    for value in junk:
        for key in ("joint_names", "points"):
            with pytest.raises(InputError):
                from_joint_trajectory({**good, key: value})
        for key in good["points"][0]:
            with pytest.raises(InputError):
                from_joint_trajectory(broken(good, **{key: value}))
        if not isinstance(value, dict):
            # A text is the name of a file.
            with pytest.raises(InputError if isinstance(value, str) else OptionError):
                from_joint_trajectory(value)
