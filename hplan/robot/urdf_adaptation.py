"""Adapts third-party URDFs to the requirements of Pinocchio and hplan.

A real robot's URDF has more joints than the arm: fingers, mimic joints, a lift, a camera pan. Each of these becomes a
fixed joint at its held value, so that the mass and the shapes of its links keep their place. An upright `base_link`
becomes the root, continuous joints get limits of one turn to either side, and mesh files are located.

The pass modifies the XML elements in place after a strict read; the result is read strictly again.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arguments import nearest_name
from hplan.base.arrays import Record
from hplan.base.units import joint_unit
from hplan.errors import InputError, JointLimitError, RobotFileError
from hplan.robot.drawn_links import shape_links_from_visuals
from hplan.robot.faults import Faults
from hplan.robot.files import RobotGroup
from hplan.robot.limits_file import limits_in_place
from hplan.robot.mesh_files import MeshFinder
from hplan.robot.urdf_check import hold_advice
from hplan.robot.urdf_file import LIMIT_ADVICE, Joint, Urdf, check_inertias, check_moving_joints, read_urdf
from hplan.robot.urdf_xml import line_of
from hplan.robot.xml_element import Element
from hplan.scene.limits import FARTHEST_M

#: Reference frame of scenes.
_BASE_LINK: Final = "base_link"

#: Range of a continuous joint to either side: a whole turn [rad].
CONTINUOUS_RANGE: Final = 2.0 * math.pi

#: A revolute limit beyond this counts as no limit: exporters write 1e16 for continuous joints [rad].
_ENDLESS: Final = 1e3


@dataclass(frozen=True, eq=False)
class RobotChoice(Record):
    """Caller's arguments that accompany a robot file.

    Attributes:
        tool_frame: Frame at the end of the arm.
        joints: Names of the moving joints, from the base on; None for all joints up to the tool frame that are not
            held.
        hold: Values of held joints by name [rad, m].
        package_dirs: Folders searched first for `package://` meshes.
        from_visual: Names of links whose collision shapes are built from their visuals.
        tries_visuals: Whether visual meshes are read, and dropped if they cannot be.
        limits: Limits file whose velocities and efforts take the place of the URDF's; None for none.
        xacro_args: Values of the arguments of a xacro file, by name.
        repairs: Whether faults that have an obvious remedy are mended.
        guesses_tool: Whether another frame is taken if `tool_frame` is missing and there is one candidate.
        tool_tube_m: Length of a picking tube at the tool frame [m]; None for none.
        group: Group of an SRDF with the moving joints; None for none.
        state: Values of joints that do not move, by name, unless `hold` has others; unlike there, joints that move
            or do not exist have no effect [rad, m].
        repairs_inertia: Whether inertias that no body has are mended.
    """

    tool_frame: str = "tool0"
    joints: tuple[str, ...] | None = None
    hold: Mapping[str, float] | None = None
    package_dirs: tuple[Path, ...] = ()
    from_visual: tuple[str, ...] = ()
    tries_visuals: bool = False
    limits: Path | None = None
    xacro_args: Mapping[str, str] | None = None
    repairs: bool = False
    guesses_tool: bool = False
    tool_tube_m: float | None = None
    group: RobotGroup | None = None
    state: Mapping[str, float] | None = None
    repairs_inertia: bool = False


@dataclass(frozen=True, eq=False)
class AdaptedUrdf(Record):
    """A URDF after the pass.

    Attributes:
        text: Its XML; None if it equals the file's content.
        continuous: Names of the moving continuous joints.
        held: Values of the joints that were made fixed, by name [rad, m]; None for joints of several coordinates.
        missing_visuals: Name of the link and of the mesh file for each visual that was dropped, as its file is missing
            or unreadable.
        mended: Faults of the file that no motion depends on, and what was done about each.
        tool_frame: The tool frame that was taken.
        assumptions: Limits that nothing gives, and what is assumed.
    """

    urdf: Urdf
    text: str | None
    continuous: frozenset[str]
    held: Mapping[str, float | None]
    missing_visuals: tuple[tuple[str, str], ...] = ()
    mended: tuple[str, ...] = ()
    tool_frame: str = "tool0"
    assumptions: tuple[str, ...] = ()


def adapt_urdf(path: Path, root: Element, choice: RobotChoice, faults: Faults | None = None) -> AdaptedUrdf:
    """Adapt a URDF: fix the joints that do not move.

    Args:
        path: The file, for messages and for finding files relative to it.
        root: Its root element; modified in place.
        faults: Collector of the faults; None for one of its own. They are raised either way.

    Raises:
        RobotFileError: `read_urdf` or `check_inertias` finds faults in the URDF; a collision mesh is not found; a joint
            mimics a joint that does not exist, or itself; a moving joint mimics or is mimicked, has a limit that is not
            positive, or is continuous without velocity or effort limit; the base is not fixed relative to its parent;
            a link whose shape is built from its visual has no visual. Names all faults that were found.
        InputError: A joint to move or to hold does not exist or cannot be moved or held.
        JointLimitError: A joint is held outside its limits.
    """
    collected = Faults(path, repairs=choice.repairs) if faults is None else faults
    meshes = MeshFinder(path, choice.package_dirs)
    given = _write_limits(root, choice.limits)
    changed = bool(given)
    urdf = read_urdf(path, root, faults=collected)
    missing = meshes.drop_missing_visuals(root, tries=choice.tries_visuals)
    if choice.from_visual:
        with collected.collect():
            shape_links_from_visuals(path, root, choice.from_visual)
        changed = True
    changed |= meshes.locate(root, collected) or bool(missing)
    chain = _Adaptation(collected, str(root.get("name")), urdf, choice)
    if len(urdf.joints) == len(root.findall("joint")):
        with collected.collect():
            changed |= chain.apply()
    is_utf8 = getattr(root, "encoding", "utf-8") in ("utf-8", "ascii", "us-ascii")
    collected.add(*chain.missing_efforts(root.assumed, given))
    as_is = not changed and not collected.mended and is_utf8 and not root.is_made
    adapted = urdf if as_is or collected.found else read_urdf(path, root, faults=collected)
    repaired = check_inertias(collected, adapted, repairs=choice.repairs_inertia)
    check_moving_joints(collected, adapted)
    collected.check()
    if as_is and not repaired:
        return AdaptedUrdf(urdf, None, frozenset(), {}, tool_frame=choice.tool_frame)
    text = ET.tostring(root, encoding="unicode")
    mended = tuple(collected.mended)
    adapted = read_urdf(path, root) if repaired else adapted
    assumed = (*chain.assumed_velocities(root.assumed, given), *repaired, *root.ignored)
    return AdaptedUrdf(
        adapted, text, frozenset(chain.continuous), chain.held, missing, mended, chain.tool_frame, assumed
    )


def _write_limits(root: ET.Element, file: Path | None) -> dict[str, dict[str, float]]:
    """Write a limits file's limits into the joints, and return them by joint.

    Velocities, efforts and positions.

    Raises:
        RobotFileError: The limits file is missing or malformed, or names a joint that the URDF lacks.
    """
    if file is None:
        return {}
    joints = {str(joint.get("name")): joint for joint in root.findall("joint") if joint.get("type") != "fixed"}
    found = limits_in_place(file, joints)
    for name, limits in found.items():
        element = joints[name].find("limit")
        if element is None:
            element = ET.SubElement(joints[name], "limit")
        for quantity, value in limits.items():
            element.set(quantity, repr(value))
    return found


class _Adaptation:
    """The pass over one robot's joints."""

    def __init__(self, faults: Faults, robot: str, urdf: Urdf, choice: RobotChoice) -> None:
        self._faults = faults
        self._path = faults.path
        self._robot = robot
        self._urdf = urdf
        self._hold = dict(choice.hold or {})
        self._choice = choice if choice.group is None else self._of_group(choice, choice.group)
        self._carrying = {joint.child: joint for joint in urdf.joints.values()}
        self.tool_frame = self._choice.tool_frame
        self.continuous: list[str] = []
        self.held: dict[str, float | None] = {}
        self.moving: set[str] = set()

    def _of_group(self, choice: RobotChoice, group: RobotGroup) -> RobotChoice:
        """Return the choice with the joints and the tip of a group; a named tool frame has priority.

        Raises:
            RobotFileError: The group names a link or joint that the URDF lacks.
        """
        joints, links = self._urdf.joints, self._urdf.links
        for name in filter(None, (group.base, group.tip)):
            if name not in links:
                raise RobotFileError(self._path, f"the SRDF's group names link {name!r}: {nearest_name(name, links)}")
        for name in group.joints:
            if name not in joints:
                raise RobotFileError(self._path, f"the SRDF's group names joint {name!r}: {nearest_name(name, joints)}")
        carrying = {joint.child: joint for joint in joints.values()}
        tip = group.tip or (joints[group.joints[-1]].child if group.joints else None)
        frame = tip if tip is not None and choice.guesses_tool else choice.tool_frame
        names, link = list(group.joints), tip
        while not group.joints and link is not None and link in carrying and link != group.base:
            names.insert(0, carrying[link].name)
            link = carrying[link].parent
        moving = tuple(
            name
            for name in names
            if joints[name].kind != "fixed" and joints[name].element.find("mimic") is None and name not in self._hold
        )
        return replace(choice, joints=moving, tool_frame=frame)

    def missing_efforts(
        self, assumed: Mapping[str, Collection[str]], given: Mapping[str, Collection[str]]
    ) -> list[str]:
        """Faults of moving joints whose effort nothing gives."""
        missing = self._left("effort", assumed, given)
        return [f"joint {name!r}: no actuator gives its effort{LIMIT_ADVICE}" for name in missing]

    def assumed_velocities(
        self, assumed: Mapping[str, Collection[str]], given: Mapping[str, Collection[str]]
    ) -> tuple[str, ...]:
        """The velocity limits of moving joints that nothing gives, in words."""
        speeds: dict[float, list[str]] = {}
        for name in self._left("velocity", assumed, given):
            speeds.setdefault(self._urdf.joints[name].limits["velocity"], []).append(name)
        return tuple(
            f"velocity limits assumed: {speed:g} per second for {', '.join(names)}; nothing gives them{LIMIT_ADVICE}"
            for speed, names in speeds.items()
        )

    def _left(
        self, quantity: str, assumed: Mapping[str, Collection[str]], given: Mapping[str, Collection[str]]
    ) -> list[str]:
        """Moving joints with an assumed quantity, in the file's order."""
        return [
            name
            for name, quantities in assumed.items()
            if name in self.moving and quantity in quantities and quantity not in given.get(name, ())
        ]

    def apply(self) -> bool:
        """Change the elements; returns True if there was anything to change."""
        self._check_names()
        if not self._is_tree() or all(joint.kind == "fixed" for joint in self._urdf.joints.values()):
            return False  # Pinocchio and the readers of its model report the fault
        tip = self._tip()
        mount = self._mount()
        changed = self._make_root(mount)
        above = {joint.name for joint in mount}
        chain = [joint for joint in self._up_from(tip)[::-1] if joint.name not in above]
        values = self._values()
        moving = self.moving = self._moving_joints(chain)
        self._hold |= {
            name: value
            for name, value in (self._choice.state or {}).items()
            if name not in moving and name not in self._hold and self._leader(name) == name
        }
        values = self._values() if self._choice.state else values
        for joint in self._urdf.joints.values():
            if joint.kind == "fixed" or joint.name in above:
                continue
            if joint.name not in moving:
                self._fix(joint, values[joint.name])
                changed = True
            else:
                changed |= self._bound(joint)
        return changed

    def _fault(self, joint: Joint, reason: str) -> RobotFileError:
        return RobotFileError(self._path, f"{line_of(joint.element)}joint {joint.name!r}{reason}")

    def _check_names(self) -> None:
        joints = self._choice.joints or ()
        for name in (*joints, *self._hold):
            joint = self._urdf.joints.get(name)
            if joint is None or joint.kind == "fixed":
                known = ", ".join(j.name for j in self._urdf.joints.values() if j.kind != "fixed")
                raise InputError(f"robot {self._robot!r} has no moving joint {name!r}; it has {known}", joint=name)
            if name in joints and name in self._hold:
                raise InputError(f"joint {name!r} cannot both move and be held", joint=name)

    def _tip(self) -> str:
        """Link that is the tool frame or carries it.

        A guess if the frame is missing, which is a fault.
        """
        frame = self._choice.tool_frame
        if frame in self._urdf.links:
            return frame
        if frame in self._urdf.joints:
            return self._urdf.joints[frame].child
        candidates, is_only = tool_frames(self._urdf)
        if self._choice.guesses_tool and is_only:
            self.tool_frame = candidates[0]
            taken = f"{candidates[0]!r} is taken, the only one; tool_frame=NAME (--tool-frame NAME) selects another"
            self._faults.mend(f"there is no frame {frame!r} at the end of the arm; {taken}")
            return candidates[0]
        reason = f"it marks the end of the arm and is missing; the links are {', '.join(self._urdf.links)}; "
        advice = f"tool_frame=NAME (--tool-frame NAME) selects another frame, for example {candidates[0]!r}"
        self._faults.add(f"frame {frame!r}: {reason}{advice}")
        return candidates[0]

    def _is_tree(self) -> bool:
        """True if the links form a tree.

        A tree has one root and one parent joint for every other link.
        """
        children = [joint.child for joint in self._urdf.joints.values()]
        if len(set(children)) != len(children) or len(children) != len(self._urdf.links) - 1:
            return False
        return all(len(self._up_from(link)) <= len(children) for link in self._urdf.links)

    def _up_from(self, link: str) -> list[Joint]:
        """Joints from a link up to the root.

        For a loop, the list has one joint more than the URDF.
        """
        found: list[Joint] = []
        while link in self._carrying and len(found) <= len(self._carrying):
            found.append(self._carrying[link])
            link = found[-1].parent
        return found

    def _mount(self) -> list[Joint]:
        """Fixed joints above `base_link`, from it up.

        None if they tilt it: then scenes are in the root link's frame.
        """
        mount = self._up_from(_BASE_LINK) if _BASE_LINK in self._urdf.links else []
        for joint in mount:
            if joint.kind != "fixed" and joint.name not in self._hold:
                reason = (
                    f"it is {joint.kind} and carries {_BASE_LINK!r}, the frame of scenes; only fixed joints may do so; "
                    f"{hold_advice(joint.name)}"
                )
                raise self._fault(joint, ": " + reason)
        tilt = np.eye(3)
        values = self._values() if mount else {}
        for joint in mount:
            tilt = _child_placement(joint, values.get(joint.name)).rotation @ tilt
        # Tolerance between the verticals of `base_link` and of the links above it [rad].
        if math.hypot(tilt[0, 2], tilt[1, 2]) > 1e-9 or tilt[2, 2] < 0.0:
            angle = math.degrees(math.atan2(math.hypot(tilt[0, 2], tilt[1, 2]), tilt[2, 2]))
            reason = (
                f"joint {mount[0].name!r} tilts {_BASE_LINK!r} by {angle:.4g} deg; gravity pulls along -z of "
                f"{mount[-1].parent!r}, and scenes are in that frame"
            )
            self._faults.mend(line_of(mount[0].element) + reason)
            return []
        return mount

    def _make_root(self, mount: list[Joint]) -> bool:
        """Invert the fixed joints above `base_link`, so that it becomes the root.

        The links above become its descendants; no link with shapes is lost, and gravity and the vertical are unchanged.
        """
        values = self._values() if mount else {}
        for joint in mount:
            if joint.kind != "fixed":
                self._fix(joint, values[joint.name])
            place = _child_placement(joint, values.get(joint.name)).inverse()
            set_origin(joint.element, place)
            for end, link in (("parent", joint.child), ("child", joint.parent)):
                joint.element.find(end).set("link", link)  # type: ignore[union-attr]
        return bool(mount)

    def _values(self) -> dict[str, float | None]:
        return standing_values(self._path, self._urdf.joints, self._hold)

    def _moving_joints(self, chain: list[Joint]) -> set[str]:
        """Names of the moving joints."""
        joints = self._choice.joints
        on_chain = [joint.name for joint in chain if joint.kind != "fixed"]
        moving = {
            name
            for name in (on_chain if joints is None else joints)
            if name not in self._hold and (joints is not None or self._leader(name) not in self._hold)
        }
        for joint in self._urdf.joints.values():
            if joint.name in moving:
                with self._faults.collect():
                    self._check_moving(joint)
        for follower in self._urdf.joints.values():
            leader = self._leader(follower.name)
            if leader in moving and leader != follower.name:
                reason = f"joint {follower.name!r} mimics it and would have to move with it; {hold_advice(leader)}"
                self._faults.add(*self._fault(self._urdf.joints[leader], ": " + reason).faults)
        return moving

    def _leader(self, name: str) -> str:
        """Joint at the end of a mimic chain.

        The joint itself if it mimics none.
        """
        mimic = self._urdf.joints[name].element.find("mimic")
        return name if mimic is None else self._leader(str(mimic.get("joint")))

    def _check_moving(self, joint: Joint) -> None:
        if joint.element.find("mimic") is not None:
            leader = self._leader(joint.name)
            reason = f"mimics another joint; every joint must move by itself, but {hold_advice(leader)} and this joint"
            raise self._fault(joint, " " + reason)
        missing = [key for key in ("velocity", "effort") if key not in joint.limits]
        if joint.kind == "continuous" and missing:
            reason = f"it is continuous, and its <limit> has no {' and no '.join(missing)}; a motion requires both: "
            advice = f"{reason}write them there, or {hold_advice(joint.name)}{LIMIT_ADVICE}"
            raise self._fault(joint, ": " + advice)

    def _fix(self, joint: Joint, value: float | None) -> None:
        """Fix a joint at a value."""
        fix_joint(self._path, joint, value)
        self.held[joint.name] = value

    def _bound(self, joint: Joint) -> bool:
        """Add limits to a continuous or one-sided joint.

        Returns True if it is one.
        """
        limit = joint.element.find("limit")
        if limit is None:
            return False  # Pinocchio reports it
        ends = {key: joint.limits.get(key, 0.0) for key in ("lower", "upper")}
        range_ = f"its range is {ends['lower']:.6g} to {ends['upper']:.6g}"
        if joint.kind == "prismatic":
            if max(map(abs, ends.values())) > FARTHEST_M:
                raise self._fault(
                    joint, f": {range_} m, expected at most {FARTHEST_M:g} m to either side: give the ends of the rail"
                )
            return False
        endless = {
            "lower": joint.kind == "continuous" or ends["lower"] < -_ENDLESS,
            "upper": joint.kind == "continuous" or ends["upper"] > _ENDLESS,
        }
        for key, side in (("lower", -1.0), ("upper", 1.0)):
            if endless[key]:
                ends[key] = side * CONTINUOUS_RANGE
                limit.set(key, repr(ends[key]))
        if any(endless.values()) and not -_ENDLESS <= ends["lower"] < ends["upper"] <= _ENDLESS:
            advice = f"a limit beyond {_ENDLESS:g} rad counts as none, and the joint turns by at most 2 pi to that side"
            raise self._fault(joint, f": {range_} rad; {advice}: write both limits within a few turns of 0")
        if all(endless.values()):
            joint.element.set("type", "revolute")
            self.continuous.append(joint.name)
        return any(endless.values())


def standing_values(path: Path, joints: Mapping[str, Joint], hold: Mapping[str, float]) -> dict[str, float | None]:
    """Fixed value of each joint that does not move.

    The value is the held one, the mimicked one, 0, or the limit nearest to 0.

    Args:
        hold: Values of held joints [rad, m].

    Returns:
        Values by name for all joints that are not fixed [rad, m]; None for joints of several coordinates.

    Raises:
        RobotFileError: A joint mimics itself, or a joint that cannot move.
        InputError: A held joint mimics another, or has several coordinates.
        JointLimitError: A joint is held outside its limits.
    """
    return {name: _mimic_value(path, joints, hold, (name,)) for name, joint in joints.items() if joint.kind != "fixed"}


def _mimic_value(
    path: Path, joints: Mapping[str, Joint], hold: Mapping[str, float], followers: tuple[str, ...]
) -> float | None:
    """Value of the last joint of a mimic chain.

    Each joint of `followers` mimics the next.
    """
    joint = joints[followers[-1]]
    where = f"{line_of(joint.element)}joint {joint.name!r}"
    if joint.name in followers[:-1]:
        raise RobotFileError(path, f"{where} mimics itself through {' and '.join(followers[:-1])}")
    mimic = joint.element.find("mimic")
    if mimic is not None:
        leader = joints.get(str(mimic.get("joint")))
        if leader is None or leader.kind == "fixed":
            raise RobotFileError(path, f"{where} mimics {mimic.get('joint')!r}, which is not a moving joint")
        if joint.name in hold:
            reason = f"joint {joint.name!r} cannot be held by itself because it mimics {leader.name!r}; hold that joint"
            raise InputError(reason, joint=joint.name)
        value = _mimic_value(path, joints, hold, (*followers, leader.name))
        if value is None:
            raise RobotFileError(path, f"{where} mimics {leader.name!r}, which is {leader.kind}")
        return float(mimic.get("multiplier", "1")) * value + float(mimic.get("offset", "0"))
    if joint.kind in ("floating", "planar"):
        if joint.name in hold:
            reason = f"joint {joint.name!r} cannot be held at a value because it is {joint.kind}; make it fixed"
            raise InputError(reason, joint=joint.name)
        return None
    low, high = -math.inf, math.inf
    if joint.kind != "continuous":
        low, high = joint.limits.get("lower", 0.0), joint.limits.get("upper", 0.0)
    value = hold.get(joint.name, min(max(0.0, low), high))
    if joint.name in hold and not low - 1e-9 <= value <= high + 1e-9:
        raise JointLimitError("hold", joint.name, value, low, high, joint_unit(joint.kind == "prismatic").position)
    return value


def fix_joint(path: Path, joint: Joint, value: float | None) -> None:
    """Turn a joint's element into a fixed joint at a value.

    Raises:
        RobotFileError: The joint's axis is zero.
    """
    if value:
        if not np.linalg.norm(joint.axis) > 0.0:
            raise RobotFileError(path, f"{line_of(joint.element)}joint {joint.name!r}: its axis has no direction")
        set_origin(joint.element, _child_placement(joint, value))
    joint.element.set("type", "fixed")
    # Elements that are meaningless for a fixed joint.
    of_moving = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")
    for part in [part for part in joint.element if part.tag in of_moving]:
        joint.element.remove(part)


def _child_placement(joint: Joint, value: float | None) -> pin.SE3:
    """Placement of a joint's child at a value; None for 0.

    In the frame of its parent.
    """
    if not value:
        return joint.placement
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.kind == "prismatic":
        return joint.placement * pin.SE3(np.eye(3), value * axis)
    return joint.placement * pin.SE3(pin.AngleAxis(value, axis).toRotationMatrix(), np.zeros(3))


def set_origin(element: ET.Element, placement: pin.SE3) -> None:
    """Set the `origin` of an element to a placement in its parent."""
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    for key, numbers in (("xyz", placement.translation), ("rpy", pin.rpy.matrixToRpy(placement.rotation))):
        origin.set(key, " ".join(repr(number) for number in numbers.tolist()))


def tool_frames(urdf: Urdf) -> tuple[tuple[str, ...], bool]:
    """Links that may be the tool frame, the likeliest first, and whether the first is the only one.

    A link without children that has no body, as `tool0`, comes before a body, and one beyond more joints before others.
    """
    carrying, parents = {joint.child: joint for joint in urdf.joints.values()}, {j.parent for j in urdf.joints.values()}

    def rank(link: str) -> tuple[bool, int]:
        body = bool(urdf.links[link].shapes) or urdf.links[link].element.find("visual") is not None
        is_moved = link in carrying and carrying[link].kind != "fixed"
        return body or is_moved, -len(joints_up_to(urdf, link))

    ends = sorted((name for name in urdf.links if name not in parents), key=rank) or list(urdf.links)
    is_frame = not rank(ends[0])[0]
    if len(ends) > 1 and not is_frame and ends[0] in carrying:
        palm = carrying[ends[0]].parent  # of a gripper whose fingers have no frame between them
        return (palm, *ends), False
    return tuple(ends), len(ends) == 1 or (is_frame and rank(ends[0]) != rank(ends[1]))


def joints_up_to(urdf: Urdf, link: str) -> list[Joint]:
    """Joints that move a link, from the base on, without those that mimic others."""
    carrying, found = {joint.child: joint for joint in urdf.joints.values()}, list[Joint]()
    for _ in urdf.joints:
        if link not in carrying:
            break
        found.append(carrying[link])
        link = found[-1].parent
    return [joint for joint in found[::-1] if joint.kind != "fixed" and joint.element.find("mimic") is None]
