"""A planar arm is a robot like any other: SRDF, links without a joint of their own, and nothing below that asks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hplan import PlanOptions, certify, load_robot, load_scene, plan
from hplan.collision.coal_scene import CoalScene
from hplan.planar.family_reader import is_planar
from hplan.robot.model import Robot
from hplan.scene import Sphere

PACKAGE = Path(__file__).resolve().parents[2] / "hplan"


def harvester_with_camera(link: str, along: float, height: float, **options) -> Robot:
    """The harvester with a camera bolted to a link."""
    text = load_robot("harvester").urdf_path.read_text(encoding="utf-8")
    camera = (
        '<link name="camera"><collision><geometry><box size="0.1 0.08 0.06"/></geometry></collision></link>'
        f'<joint name="mount" type="fixed"><parent link="{link}"/><child link="camera"/>'
        f'<origin xyz="{along} 0 {height}"/></joint></robot>'
    )
    return load_robot(text.replace("</robot>", camera), limits="harvester", **options)


def test_rooms_below_do_not_ask_for_planar_arms() -> None:
    asks = re.compile(r"\.planar\b(?!\.)|is_planar|has_yaw|family_of|yaw_joints|RobotFamilyError\(")
    files = [path for path in PACKAGE.rglob("*.py") if not {"planar", "family", "errors"} & {*path.parts}]
    assert len(files) > 200
    assert [
        str(path) for path in files if asks.search(path.read_text(encoding="utf-8").replace("hplan.planar", ""))
    ] == []


@pytest.mark.parametrize("link", ["turret", "upper_arm", "forearm"])
def test_camera_on_any_link_is_planned_with_and_certified(link: str) -> None:
    robot, scene = harvester_with_camera(link, 0.3, 0.12), load_scene()
    assert is_planar(robot)
    result = plan(robot, scene, PlanOptions(effort="quick"))
    assert certify(robot, scene, result.trajectory).verified
    goal = result.trajectory.position[-1]
    camera = robot.forward_kinematics(goal, "camera")[:3, 3]
    ball = CoalScene(robot, [Sphere(name="ball", center=tuple(camera), radius=0.005)])
    assert ball.nearest_contact(goal).link == "camera"


def test_srdf_of_a_planar_arm_is_obeyed(tmp_path: Path) -> None:
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="harvester"><disable_collisions link1="camera" link2="hand" reason="User"/></robot>')
    strict, lenient = (harvester_with_camera("forearm", 0.76, 0.15, **given) for given in ({}, {"srdf": srdf}))
    q = np.radians([0.0, 0.0, 0.0, 90.0])
    contact = CoalScene(strict, []).nearest_contact(q)
    assert {contact.link, contact.obstacle} == {"camera", "hand"}
    assert CoalScene(strict, []).in_collision(q[None]).all()
    assert not CoalScene(lenient, []).in_collision(q[None]).any()
