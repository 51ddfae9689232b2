"""Joins several robots into one tree of joints, one arm per branch.

Planning and certification for joint trees therefore cover multi-arm robots: the bodies of different arms form
self-collision pairs of the joined robot, checked in continuous time with both arms in motion.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import readonly
from hplan.errors import InputError
from hplan.robot.model import Robot, read_robot
from hplan.robot.urdf_adaptation import set_origin
from hplan.robot.urdf_xml import read_urdf_xml
from hplan.scene.cell import ArmLink

#: Root link, the common frame of all bases.
_ROOT: Final = "base_link"


def joined_robots(
    arms: Mapping[str, tuple[Robot, pin.SE3]],
    name: str = "cell",
    *,
    may_touch: Iterable[tuple[ArmLink, ArmLink, str]] = (),
) -> Robot:
    """Join several robots; prefix joints, links and frames with robot names.

    The prefix is the robot's name and `_`. The tool frame belongs to the first arm; the joints of each arm are
    contiguous, in their own order. `Robot.owner_of` gives the arm of each link.

    Args:
        arms: Robots by name, with the poses of their bases.
        name: Name of the joined robot.
        may_touch: Pairs of links of different arms that may touch, each with the reason. All other pairs of bodies of
            different arms require the full clearance.

    Raises:
        InputError: `arms` is empty, or `may_touch` names an unknown arm or link, or two links of one arm.
        RobotFileError: A robot's URDF can no longer be read, or two prefixed names of joints or links coincide.
    """
    if not arms:
        raise InputError("joined_robots: there is no robot to join")
    jerk = any(robot.jerk_limit is not None for robot, _ in arms.values())
    root = ET.Element("robot", name=name)
    ET.SubElement(root, "link", name=_ROOT)
    for each, (robot, placement) in arms.items():
        links = _rename_robot(each, robot, root, jerk=jerk)
        mount = ET.SubElement(root, "joint", name=f"{each}_mount", type="fixed")
        ET.SubElement(mount, "parent", link=_ROOT)
        ET.SubElement(mount, "child", link=links)
        set_origin(mount, placement)
    ordered = sorted(arms, key=lambda each: f"{each}_mount")  # as URDF readers sort the branches of a link
    joints = [f"{each}_{joint}" for each in ordered for joint in arms[each][0].joint_names]
    first, (robot, _) = next(iter(arms.items()))
    found = read_robot(ET.tostring(root, encoding="unicode"), joints=joints, tool_frame=f"{first}_{robot.tool_frame}")
    allowed = [(f"{n}_{a}", f"{n}_{b}", why) for n in ordered for a, b, why in arms[n][0].may_touch]
    allowed += _iterate_declared(arms, may_touch)
    owners = {f"{each}_{link}": each for each, (robot, _) in arms.items() for link in _link_names(robot)}
    turning = np.concatenate([arms[each][0].continuous for each in ordered])
    faults = tuple(replace(fault, link=f"{each}_{fault.link}") for each in arms for fault in arms[each][0].shape_faults)
    return replace(
        found,
        continuous=readonly(turning, np.bool_),
        may_touch=tuple(allowed),
        owners=owners,
        shape_faults=faults,
    )


def _iterate_declared(
    arms: Mapping[str, tuple[Robot, pin.SE3]], pairs: Iterable[tuple[ArmLink, ArmLink, str]]
) -> Iterator[tuple[str, str, str]]:
    """Validate pairs of links of different arms; yield their joined names.

    Raises:
        InputError: An arm or link is unknown, or both links belong to one arm.
    """
    for first, second, reason in pairs:
        for arm, link in (first, second):
            if arm not in arms:
                raise InputError(f"may_touch: the workcell has no arm {arm!r}; it has {', '.join(arms)}", robot=arm)
            links = _link_names(arms[arm][0])
            if link not in links:
                known = f"{link!r} is not a link of arm {arm!r}; its links are {', '.join(links)}"
                raise InputError(f"may_touch: {known}", robot=arm, link=link)
        if first[0] == second[0]:
            declared = f"links {first[1]!r} and {second[1]!r} both belong to arm {first[0]!r}"
            raise InputError(f"may_touch: {declared}; the pairs of one arm are in its SRDF", robot=first[0])
        yield "_".join(first), "_".join(second), reason


def _link_names(robot: Robot) -> tuple[str, ...]:
    """Names of the links of a robot."""
    return tuple(str(frame.name) for frame in robot.model.frames if frame.type == pin.FrameType.BODY)


def _rename_robot(name: str, robot: Robot, into: ET.Element, *, jerk: bool) -> str:
    """Copy a robot into a URDF with prefixed names; return its root.

    Links, joints and materials are prefixed.
    """
    own, children = read_urdf_xml(robot.urdf_path, robot.urdf_text), set[str]()
    rows = {joint: row for row, joint in enumerate(robot.joint_names)}
    for element in own:
        row = rows.get(element.get("name", "")) if element.tag == "joint" else None
        for each in element.iter():
            if each.tag == "mesh":  # relative mesh paths refer to the URDF's folder
                each.set("filename", str(robot.urdf_path.parent.resolve() / each.get("filename", "")))
            elif each.tag == "limit" and row is not None:
                each.set("acceleration", repr(float(robot.acceleration_limit[row])))
                if jerk:
                    # For joints without a jerk limit, this one reaches the full acceleration in far less than a sample.
                    each.set("jerk", repr(1e6 if robot.jerk_limit is None else float(robot.jerk_limit[row])))
            for key, tags in (("name", ("link", "joint", "material")), ("link", ("parent", "child"))):
                if each.tag in tags and each.get(key):
                    each.set(key, f"{name}_{each.get(key)}")
            if each.tag == "child":
                children.add(each.get("link", ""))
        if element.tag in ("link", "joint", "material"):
            into.append(element)
    return next(link.get("name", "") for link in own.findall("link") if link.get("name") not in children)
