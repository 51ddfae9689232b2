"""The direction in which tools point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from any_arms import ARMS, loaded_arm
from arm_variants import VARIANTS, load_variant

from hplan.base.arrays import FloatArray
from hplan.robot.model import load_robot
from hplan.robot.tool_axis import find_tool_axis

UP = np.array([0.0, 0.0, 1.0])


def arm_of(axes: list[FloatArray], tool: pin.SE3) -> tuple[pin.Model, int]:
    """Joints half a metre apart along x that turn about given axes, and the frame of a tool after the last one."""
    model, joint = pin.Model(), 0
    for number, axis in enumerate(axes):
        place = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRevoluteUnaligned(axis), place, f"joint {number}")
    return model, model.addFrame(pin.Frame("tool", joint, 0, tool, pin.FrameType.OP_FRAME))


@pytest.mark.parametrize("name", ARMS)
def test_tools_of_common_arms_point_along_z(name: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    np.testing.assert_array_equal(loaded_arm(name, tmp_path_factory).tool_axis, UP)


@pytest.mark.parametrize("name", VARIANTS)
def test_tools_of_arms_whose_frames_have_x_forward_point_along_the_last_link(name: str, tmp_path: Path) -> None:
    np.testing.assert_allclose(load_variant(name, tmp_path).tool_axis, [1.0, 0.0, 0.0], atol=1e-12)


def test_held_wrists_change_nothing() -> None:
    pytest.importorskip("example_robot_data")
    np.testing.assert_array_equal(load_robot("ur5", hold={"wrist_3_joint": 0.0}).tool_axis, UP)


@pytest.mark.parametrize(
    ("tool", "expected"),
    [
        (pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.2])), UP),  # offset from the last axis, parallel to it
        (pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.8, 0.0), np.array([0.1, 0.0, 0.2])), UP),  # oblique
        (pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), np.array([0.1, 0.0, 0.0])), UP),  # along the last link
        (pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0), np.array([0.3, 0.0, 0.2])), np.array([1.0, 0.0, 0.0])),
        (pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0), np.array([0.0, 0.0, 0.2])), UP),  # on the last axis
    ],
)
def test_z_unless_it_is_across_both_the_last_axis_and_the_last_link(tool: pin.SE3, expected: FloatArray) -> None:
    axes = [UP, np.array([0.0, 1.0, 0.0]), UP]
    np.testing.assert_allclose(find_tool_axis(*arm_of(axes, tool)), expected, atol=1e-12)


def test_not_along_z_if_no_joint_moves_the_tool_there() -> None:
    tool = pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.2]))
    np.testing.assert_allclose(find_tool_axis(*arm_of([UP, UP, UP], tool)), [0.0, 1.0, 0.0], atol=1e-12)
