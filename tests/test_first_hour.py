"""The five commands of `docs/first_hour.md`, for an arm that hplan has never seen."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest
from toy_urdf import six_axis_arm

import hplan
from hplan.apps.cli.main import main

PAGE = Path(__file__).parents[1] / "docs" / "first_hour.md"


def vendor_file() -> str:
    """A xacro file with an argument and typical defects.

    No accelerations, a velocity of 0, no tool0, a second material, a missing visual mesh, an inertia slightly off.
    """
    text = six_axis_arm().replace("tool0", "ee_link").replace('velocity="3"', 'velocity="0"', 1)
    visual = '<visual><geometry><mesh filename="package://vendor/arm.dae"/></geometry>{0}{0}</visual>'
    text = text.replace(
        '<link name="elbow_link">', '<link name="elbow_link">' + visual.format('<material name="grey"/>')
    )
    text = text.replace('iyy="0.02" izz="0.01"', 'iyy="0.02" izz="0.0401"', 1)
    head = '<robot name="vendor" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="mount" default=""/>'
    text = text.replace('<robot name="six_axes">', head)
    return text.replace('length="0.12"', 'length="$(arg mount)"', 1)


def test_own_arm_picks_in_five_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xacrodoc", reason="the extra `xacro` is not installed")
    monkeypatch.chdir(tmp_path)
    Path("vendor.urdf.xacro").write_text(vendor_file(), encoding="utf-8")
    block = re.search(r"^```sh\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert block
    lines = block[1].splitlines()
    assert len(lines) == 5
    begin = time.perf_counter()
    for line in lines:
        words = line.replace("my_arm.urdf", "vendor.urdf.xacro --xacro mount:=0.12").split()
        # The velocity of 0 is the only fault that prevents loading; `init` writes a guess for it.
        assert main(words[1:]) == (2 if "inspect" in words else 0), line
    assert time.perf_counter() - begin < 300.0
    folder = Path("picking")
    scene = hplan.load_scene(folder / "scene.yaml")
    motion, robot = hplan.read_csv(folder / "first" / "trajectory.csv"), hplan.load_robot(scene.robot)
    picked = robot.tool_positions(motion.position)
    fruit = next(fruit for fruit in scene.fruits if fruit.name == scene.goal.fruit)
    assert min(((place - fruit.center) ** 2).sum() ** 0.5 for place in picked) < 1e-3
    assert '"verified": true' in (folder / "tour" / "tour.json").read_text()
