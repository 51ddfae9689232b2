"""Several arms: the Pandas of xECBS (ICAPS 2024), planned on one clock and checked by Pinocchio and coal alone.

The problems come from a copy of the repository `yoraish/xecbs_icaps24_experiments` (`--files DIR`): Pandas in a circle,
at bins and at shelves; bases from its xacro, tasks and boxes from its YAML. Hands, closed fingers and meshes are as in
the repository; the table is 2 mm lower, so that the bases do not touch it.
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
from studies.harness import Row, Study, StudyConfig
from studies.measure import timed
from studies.outside import between_arms

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError, InputError
from hplan.planning.options import PlanOptions
from hplan.robot.files import named_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.limits import Vector
from hplan.scene.model import Goal, Start
from hplan.scene.obstacles import Box
from hplan.workcell.cell import Cell
from hplan.workcell.planner import plan_cell

#: Folders of the problems.
SETS = ("scalability-2", "scalability-4", "4-binpick", "8-shelves", "scalability-6", "scalability-8")

_FINGER = "package://example-robot-data/robots/panda_description/meshes/collision/finger.stl"

#: Time limit of one problem, and time between the checked configurations [s].
LIMIT_S, EVERY_S = 300.0, 2e-3


def problems(config: StudyConfig) -> list[tuple[str, str, dict[str, Any]]]:
    """Set, name and content of each problem."""
    found = []
    for group in SETS:
        (file,) = sorted((config.files or Path()).glob(f"{group}/*test_config.yaml"))
        tests = yaml.load(file.read_text(), Loader=yaml.CSafeLoader)
        found += [(group, name, test) for name, test in tests.items()][: config.count]
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
        raise InputError("the URDF of the Panda has no origin of panda_hand_joint")
    mount.set("rpy", "0 0 0")
    for name, turn in (("panda_leftfinger", "0 0 0"), ("panda_rightfinger", "0 0 3.141592653589793")):
        finger = next(link for link in root.iter("link") if link.get("name") == name)
        for boxes in finger.findall("collision"):
            finger.remove(boxes)
        collision = ET.SubElement(finger, "collision")
        ET.SubElement(collision, "origin", rpy=turn, xyz="0 0 0")
        ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=_FINGER)
    text, hold = ET.tostring(root, encoding="unicode"), {"panda_finger_joint1": 0.0}
    return load_robot(text, limits="panda", tool_frame=files.tool_frame, srdf=files.srdf,
                      package_dirs=files.package_dirs, hold=hold)  # fmt: skip


def cell_of(config: StudyConfig, group: str, test: dict[str, Any]) -> Cell:
    """The workcell of a problem."""
    poses = bases((config.files or Path()) / group)
    arms = tuple(
        CellRobot(
            name=name, position=poses[name][0], rpy_deg=poses[name][1],
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
    return Cell.from_robots(scene, {arm.name: _panda() for arm in arms})


def _row(config: StudyConfig, problem: tuple[str, str, dict[str, Any]]) -> Row:
    group, name, test = problem
    row: Row = {"name": f"{group} {name}", "group": group, "solved": False}
    cell = cell_of(config, group, test)
    try:
        result, ms = timed(lambda: plan_cell(cell, PlanOptions(effort=config.effort, deadline_s=LIMIT_S)))
    except HplanError as error:
        return row | {"how": type(error).__name__}
    motion, verified = result.trajectory, result.certificate.verified
    return row | {
        "solved": verified, "how": result.how, "s": 1e-3 * ms, "makespan_s": motion.duration,
        "to_the_longest_alone": motion.duration / max(result.report["alone_s"].values()),
        "fault": verified and _arms_touch(cell, motion.positions(np.arange(0.0, motion.duration, EVERY_S))),
    }  # fmt: skip


def _arms_touch(cell: Cell, q: FloatArray) -> bool:
    """True if bodies of different arms are in contact by coal, with original meshes."""
    model, geometry = cell.robot.model, between_arms(cell)
    data, found = model.createData(), geometry.createData()
    return any(pin.computeCollisions(model, data, geometry, found, each, True) for each in q)


CELLS = Study(
    "cells",
    "several Pandas on one clock (xECBS, ICAPS 2024; --files)",
    _row,
    ("solved", "how", "s", "makespan_s", "to_the_longest_alone"),
    problems,
    by="group",
    needs=("files",),
)
