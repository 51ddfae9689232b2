"""Robots of scenes: files with options, and the tool tube."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_urdf import six_axis_arm

import hplan
from hplan.errors import InputError, RobotFileError, SceneError
from hplan.scene import Goal, Scene, Start, dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.robot_source import RobotSource

TASK = {"name": "own", "start": Start(joints_deg=(0.0,) * 6), "goal": Goal(joints_deg=(0.0,) * 6)}


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    path = tmp_path / "arms" / "own.urdf"
    path.parent.mkdir()
    path.write_text(six_axis_arm(), encoding="utf-8")
    return path


def test_scene_finds_its_robot_from_its_own_folder(arm: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = RobotSource(urdf=str(arm), tool_tube_m=0.2, hold={"wrist_3": 0.5})
    (tmp_path / "scenes").mkdir()
    path = save_scene(Scene(robot=source, **TASK), tmp_path / "scenes" / "own.yaml")
    assert "  urdf: ../arms/own.urdf\n" in path.read_text()
    monkeypatch.chdir(tmp_path / "scenes")
    found = load_scene("own.yaml").robot
    assert isinstance(found, RobotSource)
    assert Path(found.urdf).samefile(arm)
    assert (found.tool_tube_m, found.hold) == (0.2, {"wrist_3": 0.5})
    robot, shorter = hplan.load_robot(found), hplan.load_robot(found, tool_tube_m=0.1, package_dirs=[])
    assert robot.dof == shorter.dof == 5
    assert np.linalg.norm(robot.tool_positions(np.zeros(5)) - shorter.tool_positions(np.zeros(5))) == pytest.approx(0.1)


@pytest.mark.parametrize("robot", ["own.urdf", {"urdf": "own.xacro", "xacro_args": {"hand": False, "size": 2}}])
def test_text_of_a_scene_keeps_its_robot(robot: object) -> None:
    scene = Scene(robot=robot, **TASK)
    assert parse_scene(dump_scene(scene)) == scene
    assert isinstance(scene.robot, RobotSource)
    assert dict(scene.robot.xacro_args) in ({}, {"hand": "false", "size": "2"})


@pytest.mark.parametrize("robot", ["harvestor", {"urdf": "own.urdf", "tool_tube_m": 180.0}, {"tool_tube_m": 0.1}])
def test_wrong_robots_are_refused(robot: object) -> None:
    with pytest.raises(SceneError, match="robot"):
        Scene(robot=robot, **TASK)


def test_tube_is_along_the_tool_axis(arm: Path) -> None:
    """A flange with y outwards: the tube projects along y, and its mouth is the tool frame, with z along it."""
    bare, tubed = hplan.load_robot(arm), hplan.load_robot(arm, tool_tube_m=0.18)
    q = np.array([0.3, -0.5, 0.8, 0.1, -0.4, 0.2])
    pose, mouth = bare.forward_kinematics(q), tubed.forward_kinematics(q)
    np.testing.assert_allclose(mouth[:3, 3] - pose[:3, 3], 0.18 * pose[:3, :3] @ bare.tool_axis, atol=1e-12)
    np.testing.assert_allclose(mouth[:3, :3] @ tubed.tool_axis, pose[:3, :3] @ bare.tool_axis, atol=1e-12)
    assert sum(i.mass for i in tubed.model.inertias) == pytest.approx(sum(i.mass for i in bare.model.inertias) + 0.18)
    with pytest.raises(InputError, match=r"tool_tube_m = 180"):
        hplan.load_robot(arm, tool_tube_m=180)
    text = arm.read_text().replace('"tool0"', '"tool_tube"')
    with pytest.raises(RobotFileError, match="'tool_tube' already"):
        hplan.load_robot(text, tool_frame="tool_tube", tool_tube_m=0.1)
