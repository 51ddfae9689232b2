"""Reads a URDF: links, joints, inertia and collision geometry as numbers.

`urdfdom`, which Pinocchio uses, ignores much that it cannot read: it drops a mass whose origin has a decimal comma and
an element whose name is misspelled. Here each of these is a fault with its line and element, wherever a motion depends
on it; other faults are mended in the elements and reported. `hplan.robot.urdf_check` verifies that Pinocchio reads the
same.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np
import pinocchio as pin

from hplan.base.arguments import DECIMAL
from hplan.base.arrays import FloatArray, readonly
from hplan.errors import RobotFileError
from hplan.geometry.rotation import rpy_rotation
from hplan.robot.faults import Faults
from hplan.robot.urdf_xml import line_of
from hplan.scene.limits import FARTHEST_M

#: Permitted attributes and child elements of each element; a missing entry permits any. Other names are extensions,
#: unless they look like a misspelling; of the extensions only `_ACCELERATION` is read.
_ATTRIBUTES: Final[Mapping[str, frozenset[str]]] = {
    "origin": frozenset({"xyz", "rpy"}),
    "mass": frozenset({"value"}),
    "inertia": frozenset({"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}),
    "box": frozenset({"size"}),
    "sphere": frozenset({"radius"}),
    "cylinder": frozenset({"radius", "length"}),
    "mesh": frozenset({"filename", "scale"}),
    "parent": frozenset({"link"}),
    "child": frozenset({"link"}),
    "axis": frozenset({"xyz"}),
    "limit": frozenset({"lower", "upper", "velocity", "effort", "acceleration", "jerk"}),
    # The rotor inertia `armature` is written for MJCF, the last four are Franka's.
    "dynamics": frozenset({"damping", "friction", "armature", "D", "K", "mu_coulomb", "mu_viscous"}),
    "mimic": frozenset({"joint", "multiplier", "offset"}),
    "safety_controller": frozenset({"soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"}),
    "calibration": frozenset({"rising", "falling", "reference_position"}),
}
_CHILDREN: Final[Mapping[str, frozenset[str]]] = {
    "link": frozenset({"inertial", "visual", "collision"}),
    "inertial": frozenset({"origin", "mass", "inertia"}),
    "collision": frozenset({"origin", "geometry", "material"}),
    "visual": frozenset({"origin", "geometry", "material"}),
    "geometry": frozenset({"box", "sphere", "cylinder", "mesh"}),
    "joint": frozenset(
        {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"}
    ),
}
_ELEMENTS: Final = frozenset(_ATTRIBUTES).union(_CHILDREN, *_CHILDREN.values())

#: Elements that no motion depends on; a wrong one is removed.
_HARMLESS: Final = frozenset({"material", "visual", "dynamics", "safety_controller", "calibration"})

#: Minimum similarity for a misspelling (`difflib.SequenceMatcher.ratio`).
_SIMILARITY: Final = 0.8

#: Elements without known extensions, and attributes that they may have nevertheless.
_CLOSED: Final = frozenset({"origin", "mass", "inertia", "axis", "parent", "child"})
_LABELS: Final = frozenset({"name", "id", "comment", "description"})

#: Acceleration limit as Drake's files name it; URDF has its own since 1.2, which takes precedence.
_ACCELERATION: Final = "drake:acceleration"


@dataclass(frozen=True, eq=False)
class Inertial:
    """Mass and inertia of a link.

    Attributes:
        mass: Mass [kg].
        placement: Centre of mass and axes of the inertia, in the link's frame.
        inertia: (3, 3) inertia about the centre of mass [kg m^2].
    """

    mass: float
    placement: pin.SE3
    inertia: FloatArray


@dataclass(frozen=True, eq=False)
class CollisionShape:
    """Collision geometry of a link.

    Attributes:
        element: Its `<collision>` element.
        kind: `box`, `sphere`, `cylinder` or `mesh`.
        size: Edges of a box; radius of a sphere; radius and length of a cylinder; scale of a mesh [m].
        placement: Placement in the link's frame.
    """

    element: ET.Element
    kind: str
    size: tuple[float, ...]
    placement: pin.SE3


@dataclass(frozen=True, eq=False)
class Link:
    """Link of a robot.

    Attributes:
        element: Its `<link>` element.
        name: Its name.
        inertial: Mass and inertia; None if the file has no `<inertial>`.
        shapes: Its collision geometries.
    """

    element: ET.Element
    name: str
    inertial: Inertial | None
    shapes: tuple[CollisionShape, ...]


@dataclass(frozen=True, eq=False)
class Joint:
    """Joint of a robot.

    Attributes:
        element: Its `<joint>` element.
        name: Its name.
        kind: `revolute`, `continuous`, `prismatic`, `fixed`, `floating` or `planar`.
        parent: Name of the link that carries it.
        child: Name of the link that it moves.
        placement: Placement in the parent link's frame.
        axis: (3,) axis as in the file, not normalized.
        armature: Rotor inertia [kg m^2, kg].
        limits: `lower`, `upper`, `velocity`, `effort`, and from URDF 1.2 `acceleration` and `jerk`, as far as the file
            has them [rad, m, s, N, N m].
    """

    element: ET.Element
    name: str
    kind: str
    parent: str
    child: str
    placement: pin.SE3
    axis: FloatArray
    armature: float
    limits: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Urdf:
    """Robot as described by its URDF."""

    links: Mapping[str, Link]
    joints: Mapping[str, Joint]


def read_urdf(path: Path, root: ET.Element, *, any_robot: bool = False, faults: Faults | None = None) -> Urdf:
    """Read the content of a URDF.

    Harmless faults are mended in the elements: a second `<material>`, a misplaced element that no motion depends on, a
    malformed `<visual>`.

    Args:
        path: The file, for messages.
        root: Its root element; modified in place.
        any_robot: Whether only joints and inertias are needed: shapes are not read.
        faults: Collector of the faults; a value that cannot be read is replaced by its default, and a joint without
            both of its links is left out. None to raise them.

    Raises:
        RobotFileError: A name is missing, repeated or unprintable, a joint refers to a link that does not exist, an
            element or attribute is missing, unknown or duplicated, or a number is malformed or out of range; names line
            and element of all of these. Never with a collector.
    """
    collected = Faults(path) if faults is None else faults
    reader = _Reader(collected, any_robot)
    with collected.collect():
        reader.check_name(root, "the robot")
    named: dict[str, dict[str, ET.Element]] = {}
    for kind in ("link", "joint"):
        seen = named.setdefault(kind, {})
        for element in root.findall(kind):
            with collected.collect():
                reader.check_name(element, f"a <{kind}>")
                name = str(element.get("name"))
                if name in seen:
                    raise reader.fault(element, f"{kind} {name!r} is defined twice")
                seen[name] = element
    links = {name: reader.link(link) for name, link in named["link"].items()}
    joints = {name: reader.joint(joint, links) for name, joint in named["joint"].items()}
    if faults is None:
        collected.check()
    return Urdf(links, {name: joint for name, joint in joints.items() if joint is not None})


def check_inertias(faults: Faults, urdf: Urdf, *, repairs: bool = False) -> tuple[str, ...]:
    """Find inertias of moving links that no body has.

    One that is slightly off is a harmless fault: it counts as the file has it. Inertias of other links have no effect.

    Args:
        faults: Collector of the faults: a principal moment is negative, or larger than the sum of the others.
        urdf: The content of the file.
        repairs: Whether the elements of larger faults are mended: the smaller moments are raised, which never makes
            the load of a joint smaller.

    Returns:
        What was mended, one sentence for each link.
    """
    repaired: list[str] = []
    # Tolerances as a fraction of the maximum principal moment: CAD programs round, and vendors' files are off by 14 %.
    rounded, slight = 1e-3, 0.15
    # Moments below this need no torque worth counting: 0.1 mN m at 100 rad/s^2 [kg m^2].
    tiny = 1e-6
    carrying = {joint.child: joint for joint in urdf.joints.values()}
    for link in urdf.links.values():
        if link.inertial is None or not _is_moved(link.name, carrying):
            continue
        moments, axes = np.linalg.eigh(link.inertial.inertia)
        largest = float(np.abs(moments).max())
        excess = max(-float(moments[0]), float(moments[2] - moments[1] - moments[0]))
        if excess <= max(rounded * largest, 1e-12):
            continue
        element = next(link.element.iter("inertia"))
        reason = (
            f"{line_of(element)}link {link.name!r}: <inertia> has principal moments "
            f"{', '.join(f'{moment:.6g}' for moment in moments)} kg m^2; those of a body are not negative, and none is "
            "larger than the sum of the others"
        )
        if faults.repairs:
            _write_inertia(element, axes, moments)
            faults.mend(f"{reason}: the smaller moments were raised")
        elif excess <= max(slight * largest, tiny):
            faults.mend(f"{reason}; they count as they are")
        elif repairs:
            raised = _write_inertia(element, axes, moments)
            words = ", ".join(f"{moment:.6g}" for moment in raised)
            repaired.append(f"{reason}; the smaller ones were raised to {words} (repair_inertia)")
        else:
            faults.add(f"{reason}; repair_inertia=True (--repair-inertia) raises the smaller ones")
    return tuple(repaired)


def _write_inertia(element: ET.Element, axes: FloatArray, moments: FloatArray) -> list[float]:
    """Write and return the moments of a body near given ones.

    The given moments ascend.
    """
    raised = np.maximum(moments, 0.0)
    raised[:2] += 0.5 * max(0.0, raised[2] - raised[1] - raised[0])
    inertia = axes @ np.diag(raised) @ axes.T
    for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        element.set(key, repr(float(inertia["xyz".index(key[1]), "xyz".index(key[2])])))
    found: list[float] = raised.tolist()
    return found


def check_moving_joints(faults: Faults, urdf: Urdf) -> None:
    """Find moving joints that mimic another, or lack positive limits."""
    for joint in urdf.joints.values():
        where, kind = f"{line_of(joint.element)}joint {joint.name!r}", joint.element.get("type")
        is_known = any(fault.startswith(f"{where} mimics") for fault in faults.found)
        if kind != "fixed" and joint.element.find("mimic") is not None and not is_known:
            faults.add(f"{where} mimics another joint; every joint must move by itself")
        for key in ("velocity", "effort", "acceleration", "jerk") if kind in ("revolute", "prismatic") else ():
            if key in joint.limits and not joint.limits[key] > 0.0:
                value = f"{key} of <limit> is '{joint.limits[key]:g}', expected a positive finite number"
                faults.add(f"{where}: {value}{'' if key == 'jerk' else LIMIT_ADVICE}")


#: End of a message about a limit: where else it may be written.
LIMIT_ADVICE: Final = "; a limits file may give it (hplan inspect --write-limits writes one)"


def _is_moved(link: str, carrying: Mapping[str, Joint]) -> bool:
    """True if a joint moves a link, or joints form a cycle."""
    for _ in carrying:
        if link not in carrying:
            return False
        if carrying[link].element.get("type") != "fixed":
            return True
        link = carrying[link].parent
    return link in carrying


class _Reader:
    """Reads the elements of one file."""

    def __init__(self, faults: Faults, any_robot: bool) -> None:
        self._faults = faults
        self._any_robot = any_robot

    def fault(self, element: ET.Element, reason: str) -> RobotFileError:
        return RobotFileError(self._faults.path, line_of(element) + reason)

    def _mend(self, element: ET.Element, reason: str) -> None:
        self._faults.mend(line_of(element) + reason)

    def check_name(self, element: ET.Element, what: str) -> None:
        name = element.get("name")
        if not name or not name.strip():
            raise self.fault(element, f"{what} has no name")
        if not name.isprintable() or name != name.strip():
            reason = (
                f"{what} is called {name!r}; a name has no line break, no control character and no space at its ends"
            )
            raise self.fault(element, reason)

    def link(self, element: ET.Element) -> Link:
        where, collecting = f"link {element.get('name')!r}", self._faults.collect
        self._check_parts(element, where)
        found, inertial = element.find("inertial"), None
        if found is not None:
            with collecting():
                inertial = self._inertial(found, where)
        for visual in [] if self._any_robot else element.findall("visual"):
            drawn = _Reader(Faults(self._faults.path, repairs=self._faults.repairs), self._any_robot)
            with drawn._faults.collect():
                drawn._geometry_of(visual, where)
                drawn._origin_of(visual, where)
            if drawn._faults.found:
                element.remove(visual)
            left_out = [f"{fault}; the <visual> is left out" for fault in drawn._faults.found]
            for reason in (*drawn._faults.mended, *left_out):
                self._faults.mend(reason)
        shapes = []
        for shape in [] if self._any_robot else element.findall("collision"):
            with collecting():
                shapes.append(CollisionShape(shape, *self._geometry_of(shape, where), self._placement(shape, where)))
        return Link(element, str(element.get("name")), inertial, tuple(shapes))

    def joint(self, element: ET.Element, links: Mapping[str, Link]) -> Joint | None:
        name, kind = str(element.get("name")), str(element.get("type"))
        where, collecting = f"joint {name!r}", self._faults.collect
        self._check_parts(element, where)
        kinds = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
        parent, child, axis = None, None, readonly((1.0, 0.0, 0.0))
        placement, limits = pin.SE3.Identity(), dict[str, float]()
        with collecting():
            if kind not in kinds:
                given = element.get("type")
                raise self.fault(element, f"{where}: its type is {given!r}, expected one of {', '.join(kinds)}")
            limits = self._limits(element, where, kind)
        with collecting():
            parent = self._end(element, "parent", links, where)
        with collecting():
            child = self._end(element, "child", links, where)
        with collecting():
            placement = self._placement(element, where)
        with collecting():
            if (given_axis := element.find("axis")) is not None:
                axis = readonly(self._numbers(given_axis, "xyz", where, 3))
        if not self._has_readable_mimic(element, where) or kind not in kinds or parent is None or child is None:
            return None
        dynamics = element.find("dynamics")
        armature = 0.0 if dynamics is None else float(dynamics.get("armature", "0"))
        return Joint(element, name, kind, parent, child, placement, axis, armature, limits)

    def _end(self, joint: ET.Element, end: str, links: Mapping[str, Link], where: str) -> str:
        """Link at the `parent` or `child` end of a joint."""
        part = joint.find(end)
        link = None if part is None else part.get("link")
        if link is None or link not in links:
            raise self.fault(joint, f"{where}: its {end} link {link!r} does not exist")
        return link

    def _limits(self, joint: ET.Element, where: str, kind: str) -> dict[str, float]:
        for tag in ("dynamics", "safety_controller", "calibration"):
            for part in joint.findall(tag):
                try:
                    self._check_numbers(part, where)
                except RobotFileError as error:
                    joint.remove(part)
                    self._faults.mend(f"{error.reason}; the <{tag}> is left out")
        limit = joint.find("limit")
        bounded = kind in ("revolute", "prismatic")
        if limit is None:
            if bounded:
                raise self.fault(joint, f"{where}: it has no <limit>")
            return {}
        limits: dict[str, float] = {}
        for attribute in ("lower", "upper", "velocity", "effort", "acceleration", "jerk"):
            with self._faults.collect():
                if attribute in limit.attrib:
                    (limits[attribute],) = self._numbers(limit, attribute, where, 1)
                elif bounded and attribute in ("velocity", "effort"):
                    raise self.fault(limit, f"{where}: <limit> has no {attribute}{LIMIT_ADVICE}")
        if _ACCELERATION in limit.attrib:
            limits.setdefault("acceleration", *self._numbers(limit, _ACCELERATION, where, 1))
        return limits

    def _has_readable_mimic(self, joint: ET.Element, where: str) -> bool:
        known = len(self._faults.found)
        for mimic in joint.findall("mimic"):
            with self._faults.collect():
                self._check_numbers(mimic, where)
        return len(self._faults.found) == known

    def _check_numbers(self, part: ET.Element, where: str) -> None:
        """Check the numbers of a part with single-number attributes.

        Names of joints are not numbers.
        """
        for attribute in sorted(part.attrib.keys() & (_ATTRIBUTES[part.tag] - {"joint"})):
            self._numbers(part, attribute, where, 1)

    def _inertial(self, element: ET.Element, where: str) -> Inertial:
        self._check_parts(element, where)
        mass, inertia = element.find("mass"), element.find("inertia")
        if mass is None or inertia is None:
            missing = "mass" if mass is None else "inertia"
            raise self.fault(
                element, f"{where}: <inertial> has no <{missing}>; the inertia would be ignored without it"
            )
        (value,) = self._numbers(mass, "value", where, 1)
        if value < 0.0:
            raise self._bad_number(mass, "value", where, "a finite number >= 0")
        xx, xy, xz, yy, yz, zz = (
            self._numbers(inertia, key, where, 1)[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        )
        return Inertial(value, self._placement(element, where), readonly([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    def _geometry_of(self, element: ET.Element, where: str) -> tuple[str, tuple[float, ...]]:
        """Kind and size of the shape of a `<collision>` or `<visual>`."""
        self._check_parts(element, where)
        geometry = element.find("geometry")
        if geometry is None or len(geometry) == 0:
            raise self.fault(element, f"{where}: a <{element.tag}> has no geometry")
        self._check_parts(geometry, where)
        if len(geometry) > 1:
            raise self.fault(
                geometry, f"{where}: a <geometry> has {len(geometry)} shapes; all except the first would be ignored"
            )
        shape = geometry[0]
        if shape.tag not in _CHILDREN["geometry"]:
            raise self.fault(shape, self._unknown(shape, geometry, where))
        if shape.tag == "mesh":
            if not shape.get("filename"):
                raise self.fault(shape, f"{where}: <mesh> has no filename")
            scale = self._numbers(shape, "scale", where, 3) if "scale" in shape.attrib else (1.0, 1.0, 1.0)
            if 0.0 in scale:
                raise self._bad_number(shape, "scale", where, "3 finite nonzero numbers")
            return "mesh", scale
        size: list[float] = []
        # Attributes that specify the size of a shape.
        for attribute in {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "length")}[shape.tag]:
            numbers = self._numbers(shape, attribute, where, 3 if attribute == "size" else 1)
            if not all(0.0 < number <= FARTHEST_M for number in numbers):
                expected = f"a positive finite number, at most {FARTHEST_M:g} m"
                raise self._bad_number(shape, attribute, where, expected)
            size += numbers
        return shape.tag, tuple(size)

    def _placement(self, element: ET.Element, where: str) -> pin.SE3:
        """Placement given by the `<origin>` of an element."""
        xyz, rpy = self._origin_of(element, where)
        return pin.SE3(rpy_rotation(*rpy), np.array(xyz))

    def _origin_of(self, element: ET.Element, where: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numbers `xyz` and `rpy` of the `<origin>` of an element."""
        origin, none = element.find("origin"), (0.0, 0.0, 0.0)
        if origin is None:
            return none, none
        xyz = self._numbers(origin, "xyz", where, 3) if "xyz" in origin.attrib else none
        rpy = self._numbers(origin, "rpy", where, 3) if "rpy" in origin.attrib else none
        if max(map(abs, xyz)) > FARTHEST_M:
            raise self._bad_number(origin, "xyz", where, f"3 finite numbers of at most {FARTHEST_M:g} m")
        return xyz, rpy

    def _numbers(self, element: ET.Element, attribute: str, where: str, count: int) -> tuple[float, ...]:
        """Numbers of an attribute, separated by spaces."""
        text = element.get(attribute)
        if text is None:
            raise self.fault(element, f"{where}: <{element.tag}> has no {attribute}")
        for written in (text, *((text.replace(",", "."), text.replace(",", " ")) if self._faults.repairs else ())):
            words = [word for word in written.split(" ") if word]
            numbers = tuple(map(float, words)) if all(map(DECIMAL.fullmatch, words)) else ()
            if len(numbers) == count and all(map(math.isfinite, numbers)):
                break
        else:
            expected = "a finite number" if count == 1 else f"{count} finite numbers separated by spaces"
            raise self._bad_number(element, attribute, where, expected)
        if written != text:
            element.set(attribute, written)
            self._mend(element, f"{where}: {attribute} of <{element.tag}> was {text!r}, now {written!r}")
        return numbers

    def _bad_number(self, element: ET.Element, attribute: str, where: str, expected: str) -> RobotFileError:
        reason = f"{where}: {attribute} of <{element.tag}> is {element.get(attribute)!r}, expected {expected}"
        return self.fault(element, reason)

    def _check_parts(self, element: ET.Element, where: str) -> None:
        """Find unknown elements or attributes, and duplicates.

        URDF readers ignore these silently. Those that no motion depends on are removed.
        """
        known = _CHILDREN[element.tag]
        seen: set[str] = set()
        for part in list(element):
            with self._faults.collect():
                if self._is_kept(element, part, seen, where):
                    self._check_attributes(part, where)
            if part.tag in known:
                seen.add(part.tag)

    def _is_kept(self, element: ET.Element, part: ET.Element, seen: set[str], where: str) -> bool:
        """True for a known part of a URDF.

        False for an extension, and for a wrong part that was removed.

        Raises:
            RobotFileError: The part is unknown or duplicated.
        """
        known = _CHILDREN[element.tag]
        if part.tag not in known:
            # A link has no origin of its own; an identity origin has no effect and is accepted.
            is_frame = part.tag == "origin" and not any(map(any, self._origin_of(element, where)))
            if is_frame or self._is_extension(part.tag, known):
                return False
            reason = self._unknown(part, element, where)
            meant = get_close_matches(part.tag.lower(), known, 1, _SIMILARITY)
            if self._faults.repairs and meant:
                self._mend(part, f"{where}: <{part.tag}> in <{element.tag}> is called <{meant[0]}> now")
                part.tag = meant[0]
                return True
        elif part.tag in seen and part.tag not in ("visual", "collision"):
            reason = f"{where}: a second <{part.tag}> in <{element.tag}>; one of them would be ignored"
        else:
            return True
        if part.tag not in _HARMLESS:
            raise self.fault(part, reason)
        element.remove(part)
        self._mend(part, f"{reason}; it is left out")
        return False

    def _unknown(self, part: ET.Element, element: ET.Element, where: str) -> str:
        known = ", ".join(sorted(_CHILDREN[element.tag]))
        return f"{where}: <{part.tag}> in <{element.tag}> has no meaning, expected {known}"

    def _check_attributes(self, part: ET.Element, where: str) -> None:
        """Check for unknown attributes.

        Raises:
            RobotFileError: An attribute is unknown.
        """
        attributes = _ATTRIBUTES.get(part.tag, frozenset(part.attrib))
        for attribute in sorted(part.attrib.keys() - attributes):
            known = attribute in _LABELS if part.tag in _CLOSED else self._is_extension(attribute, attributes)
            alike = _SIMILARITY if part.tag not in _CLOSED else 0.6  # an extension is not likely there
            meant = get_close_matches(attribute.lower(), attributes, 1, alike)
            if known:
                continue
            if self._faults.repairs and meant and meant[0] not in part.attrib:
                part.set(meant[0], part.attrib.pop(attribute))
                self._mend(part, f"{where}: {attribute} of <{part.tag}> is called {meant[0]} now")
            elif part.tag in _HARMLESS:
                del part.attrib[attribute]
                self._mend(part, f"{where}: {attribute} of <{part.tag}> has no meaning; it is left out")
            else:
                raise self.fault(part, f"{where}: {attribute} of <{part.tag}> has no meaning")

    def _is_extension(self, name: str, known: frozenset[str]) -> bool:
        """True if an unknown name is a deliberate extension.

        It is not if it resembles a known name, is a known element at a wrong place, or is a shape.
        """
        shortened = any(word.startswith(name.lower()) for word in known)
        misspelt = shortened or get_close_matches(name.lower(), known, 1, _SIMILARITY)
        return ":" in name or not (name in _ELEMENTS or misspelt or known == _CHILDREN["geometry"])
