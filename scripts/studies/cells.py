"""Several arms: the Pandas of xECBS (ICAPS 2024).

They are planned on one clock, and judged by Pinocchio and coal alone. The problems come from the repository
`yoraish/xecbs_icaps24_experiments`, read from a copy (`--files DIR`): Pandas in a circle, at bins and at shelves; bases
from its xacro, tasks and boxes from its YAML. Hands, closed fingers and meshes are as in the repository; the table is 2
mm lower, so that the bases do not touch it.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from studies.harness import Asked, Row, Study
from studies.measure import timed
from studies.outside import between_arms

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError, InputError
from hplan.planning.cell import Cell
from hplan.planning.cell_planner import plan_cell
from hplan.planning.options import PlanOptions
from hplan.robot.files import named_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.limits import Vector
from hplan.scene.model import Goal, Start
from hplan.scene.obstacles import Box

#: Folders of the problems.
SETS = ("scalability-2", "scalability-4", "4-binpick", "8-shelves", "scalability-6", "scalability-8")

_FINGER = "package://example-robot-data/robots/panda_description/meshes/collision/finger.stl"

#: How long one problem may take [s].
LIMIT_S = 300.0

#: Time between the checked configurations [s].
LOOK_S = 2e-3


def problems(asked: Asked) -> list[tuple[str, str, dict[str, Any]]]:
    """Set, name and content of each problem."""
    found = []
    for group in SETS:
        (file,) = sorted((asked.files or Path()).glob(f"{group}/*test_config.yaml"))
        tests = yaml.load(file.read_text(), Loader=yaml.CSafeLoader)
        found += [(group, name, test) for name, test in tests.items()][: asked.count]
    return found


@cache
def bases(folder: Path) -> dict[str, tuple[Vector, Vector]]:
    """Position [m] and orientation [deg] of each arm's base."""
    (file,) = (path for path in sorted(folder.glob("*/urdf/*.xacro")) if not path.name.endswith("_.urdf.xacro"))
    text = re.sub(r"<!--.*?-->", "", file.read_text(), flags=re.DOTALL)
    names = dict(re.findall(r'<xacro:arg name="(\w+)" default="(\w+)"', text))
    arm = re.compile(r'<xacro:panda_arm arm_id="\$\(arg (\w+)\)" connected_to="base"\s+xyz="([^"]*)" rpy="([^"]*)"')
    return {
        names[match[1]]: (_numbers(match[2].split()), _numbers(map(math.degrees, _numbers(match[3].split()))))
        for match in arm.finditer(text)
    }


def _numbers(values: Iterable[str | float]) -> Vector:
    x, y, z = map(float, values)
    return x, y, z


@cache
def _panda() -> Robot:
    """The Panda of these problems: its hand is mounted without the usual eighth of a turn, fingers are their mesh."""
    files = named_robot("panda")
    root = ET.fromstring(files.urdf.read_text())
    mount = root.find("joint[@name='panda_hand_joint']/origin")
    if mount is None:
        raise InputError("the URDF of the Panda has no panda_hand_joint that is placed")
    mount.set("rpy", "0 0 0")
    for name, turn in (("panda_leftfinger", "0 0 0"), ("panda_rightfinger", "0 0 3.141592653589793")):
        finger = next(link for link in root.iter("link") if link.get("name") == name)
        for boxes in finger.findall("collision"):
            finger.remove(boxes)
        collision = ET.SubElement(finger, "collision")
        ET.SubElement(collision, "origin", rpy=turn, xyz="0 0 0")
        ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=_FINGER)
    return load_robot(
        ET.tostring(root, encoding="unicode"),
        limits="panda",
        tool_frame=files.tool_frame,
        srdf=files.srdf,
        package_dirs=files.package_dirs,
        hold={"panda_finger_joint1": 0.0},
    )


def cell_of(asked: Asked, group: str, test: dict[str, Any]) -> Cell:
    """The cell of a problem."""
    stands = bases((asked.files or Path()) / group)
    arms = tuple(
        CellRobot(
            name=name, position=stands[name][0], rpy_deg=stands[name][1],
            start=Start(joints_deg=tuple(map(float, start))),
            goal=Goal(joints_deg=tuple(map(float, test["goals"][name]))),
        )
        for name, start in sorted(test["starts"].items())
    )  # fmt: skip
    boxes = [
        Box(name=name, center=_numbers(box["origin"]), size=_numbers(box["size"]))
        for name, box in (test.get("world_objects") or {}).items()
    ]
    table = Box(name="table", center=(0.0, 0.0, 0.048), size=(2.0, 2.0, 0.1))
    scene = CellScene(name=group, robots=arms, obstacles=(table, *boxes))
    return Cell.of(scene, {arm.name: _panda() for arm in arms})


def _row(asked: Asked, problem: tuple[str, str, dict[str, Any]]) -> Row:
    group, name, test = problem
    row: Row = {"name": f"{group} {name}", "group": group, "solved": False}
    cell = cell_of(asked, group, test)
    options = PlanOptions(effort=asked.effort, deadline_s=LIMIT_S)
    try:
        result, milliseconds = timed(lambda: plan_cell(cell, options))
    except HplanError as error:
        return row | {"how": type(error).__name__}
    depth = _deepest(cell, result.trajectory.positions(np.arange(0.0, result.trajectory.duration, LOOK_S)))
    least = max(result.report["alone_s"].values())
    return row | {
        "solved": result.certificate.verified, "how": result.how, "s": 1e-3 * milliseconds,
        "makespan_s": result.trajectory.duration, "to_the_longest_alone": result.trajectory.duration / least,
        "fault": result.certificate.verified and depth < -1e-6,
    }  # fmt: skip


def _deepest(cell: Cell, q: FloatArray) -> float:
    """Minimum distance of two bodies of different arms, by coal with original meshes [m]."""
    model, geometry = cell.robot.model, between_arms(cell)
    data, seen = model.createData(), geometry.createData()
    for each in q:
        if pin.computeCollisions(model, data, geometry, seen, each, True):
            return -1.0
    return 0.0


CELLS = Study(
    "cells",
    "several Pandas on one clock (xECBS, ICAPS 2024; --files)",
    _row,
    ("solved", "how", "s", "makespan_s", "to_the_longest_alone"),
    problems,
    by="group",
    needs=("files",),
)
