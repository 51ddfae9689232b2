"""Strictly reads a URDF: links, joints, inertia and collision geometry as numbers.

`urdfdom`, which Pinocchio uses, ignores much that it cannot read: it drops a mass whose origin has a decimal comma and
an element whose name is misspelled. Here each of these is an error with its line and element. `hplan.robot.urdf_check`
verifies that Pinocchio reads the same.
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
    # The last four are Franka's.
    "dynamics": frozenset({"damping", "friction", "D", "K", "mu_coulomb", "mu_viscous"}),
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
    limits: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Urdf:
    """Robot as described by its URDF."""

    links: Mapping[str, Link]
    joints: Mapping[str, Joint]


def read_urdf(path: Path, root: ET.Element, *, any_robot: bool = False) -> Urdf:
    """Read the content of a URDF.

    Args:
        path: The file, for messages.
        root: Its root element.
        any_robot: Whether only joints and inertias are needed: shapes are not read.

    Raises:
        RobotFileError: A name is missing, repeated or unprintable, a joint refers to a link that does not exist, an
            element or attribute is missing, unknown or duplicated, or a number is malformed or out of range; names line
            and element.
    """
    reader = _Reader(path, any_robot)
    reader.check_name(root, "the robot")
    links, joints = root.findall("link"), root.findall("joint")
    for kind, elements in (("link", links), ("joint", joints)):
        seen: set[str] = set()
        for element in elements:
            reader.check_name(element, f"a <{kind}>")
            name = str(element.get("name"))
            if name in seen:
                raise reader.fault(element, f"{kind} {name!r} is defined twice")
            seen.add(name)
    found = {str(link.get("name")): reader.link(link) for link in links}
    return Urdf(found, {str(joint.get("name")): reader.joint(joint, found) for joint in joints})


def check_inertias(path: Path, urdf: Urdf) -> None:
    """Check that inertias of moving links are physically possible.

    Inertias of other links have no effect.

    Raises:
        RobotFileError: A principal moment is negative, or larger than the sum of the others; names line and link.
    """
    # Tolerance as a fraction of the maximum principal moment: CAD programs round.
    inertia_tolerance = 1e-3
    carrying = {joint.child: joint for joint in urdf.joints.values()}
    for link in urdf.links.values():
        if link.inertial is None or not _is_moved(link.name, carrying):
            continue
        moments = np.linalg.eigvalsh(link.inertial.inertia)
        tolerance = max(inertia_tolerance * float(np.abs(moments).max()), 1e-12)
        if moments[0] < -tolerance or moments[2] > moments[0] + moments[1] + tolerance:
            reason = (
                f"{line_of(next(link.element.iter('inertia')))}link {link.name!r}: <inertia> has principal moments "
                f"{', '.join(f'{moment:.6g}' for moment in moments)} kg m^2; those of a body are not negative, and "
                "none is larger than the sum of the others"
            )
            raise RobotFileError(path, reason)


def _is_moved(link: str, carrying: Mapping[str, Joint]) -> bool:
    """True if a joint moves a link, or joints form a cycle."""
    for _ in carrying:
        if link not in carrying:
            return False
        if carrying[link].kind != "fixed":
            return True
        link = carrying[link].parent
    return link in carrying


class _Reader:
    """Reads the elements of one file."""

    def __init__(self, path: Path, any_robot: bool) -> None:
        self._path = path
        self._any_robot = any_robot

    def fault(self, element: ET.Element, reason: str) -> RobotFileError:
        return RobotFileError(self._path, line_of(element) + reason)

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
        where = f"link {element.get('name')!r}"
        self._check_parts(element, where)
        inertial = element.find("inertial")
        for visual in [] if self._any_robot else element.findall("visual"):
            self._geometry_of(visual, where)
            self._origin_of(visual, where)
        return Link(
            element,
            str(element.get("name")),
            None if inertial is None else self._inertial(inertial, where),
            tuple(
                CollisionShape(shape, *self._geometry_of(shape, where), self._placement(shape, where))
                for shape in ([] if self._any_robot else element.findall("collision"))
            ),
        )

    def joint(self, element: ET.Element, links: Mapping[str, Link]) -> Joint:
        name, kind = str(element.get("name")), element.get("type")
        where = f"joint {name!r}"
        self._check_parts(element, where)
        kinds = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
        if kind not in kinds:
            raise self.fault(element, f"{where}: its type is {kind!r}, expected one of {', '.join(kinds)}")
        axis = element.find("axis")
        return Joint(
            element,
            name,
            kind,
            self._end(element, "parent", links, where),
            self._end(element, "child", links, where),
            self._placement(element, where),
            readonly((1.0, 0.0, 0.0) if axis is None else self._numbers(axis, "xyz", where, 3)),
            self._limits(element, where, kind),
        )

    def _end(self, joint: ET.Element, end: str, links: Mapping[str, Link], where: str) -> str:
        """Link at the `parent` or `child` end of a joint."""
        part = joint.find(end)
        link = None if part is None else part.get("link")
        if link is None or link not in links:
            raise self.fault(joint, f"{where}: its {end} link {link!r} does not exist")
        return link

    def _limits(self, joint: ET.Element, where: str, kind: str) -> dict[str, float]:
        for tag in ("dynamics", "safety_controller", "mimic", "calibration"):
            for part in joint.findall(tag):
                for attribute in sorted(part.attrib.keys() & (_ATTRIBUTES[tag] - {"joint"})):
                    self._numbers(part, attribute, where, 1)
        limit = joint.find("limit")
        bounded = kind in ("revolute", "prismatic")
        if limit is None:
            if bounded:
                raise self.fault(joint, f"{where}: it has no <limit>")
            return {}
        limits: dict[str, float] = {}
        for attribute in ("lower", "upper", "velocity", "effort", "acceleration", "jerk"):
            if attribute in limit.attrib or (bounded and attribute in ("velocity", "effort")):
                (limits[attribute],) = self._numbers(limit, attribute, where, 1)
        if _ACCELERATION in limit.attrib:
            limits.setdefault("acceleration", *self._numbers(limit, _ACCELERATION, where, 1))
        return limits

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
        words = [word for word in text.split(" ") if word]
        numbers = tuple(map(float, words)) if all(map(DECIMAL.fullmatch, words)) else ()
        if len(numbers) != count or not all(map(math.isfinite, numbers)):
            expected = "a finite number" if count == 1 else f"{count} finite numbers separated by spaces"
            raise self._bad_number(element, attribute, where, expected)
        return numbers

    def _bad_number(self, element: ET.Element, attribute: str, where: str, expected: str) -> RobotFileError:
        reason = f"{where}: {attribute} of <{element.tag}> is {element.get(attribute)!r}, expected {expected}"
        return self.fault(element, reason)

    def _check_parts(self, element: ET.Element, where: str) -> None:
        """Check for unknown elements or attributes and for duplicates.

        URDF readers ignore these silently.

        Raises:
            RobotFileError: An element or attribute is unknown or duplicated.
        """
        known = _CHILDREN[element.tag]
        seen: set[str] = set()
        for part in element:
            if part.tag not in known:
                # A link has no origin of its own; an identity origin has no effect and is accepted.
                is_frame = part.tag == "origin" and not any(map(any, self._origin_of(element, where)))
                if is_frame or self._is_extension(part.tag, known):
                    continue
                reason = f"{where}: <{part.tag}> in <{element.tag}> has no meaning, expected {', '.join(sorted(known))}"
                raise self.fault(part, reason)
            if part.tag in seen and part.tag not in ("visual", "collision"):
                raise self.fault(
                    part, f"{where}: a second <{part.tag}> in <{element.tag}>; one of them would be ignored"
                )
            seen.add(part.tag)
            attributes = _ATTRIBUTES.get(part.tag, frozenset(part.attrib))
            for attribute in sorted(part.attrib.keys() - attributes):
                # Elements without known extensions.
                closed = part.tag in ("origin", "mass", "inertia", "axis", "parent", "child")
                if closed or not self._is_extension(attribute, attributes):
                    raise self.fault(part, f"{where}: {attribute} of <{part.tag}> has no meaning")

    def _is_extension(self, name: str, known: frozenset[str]) -> bool:
        """True if an unknown name is a deliberate extension.

        It is not if it resembles a known name, is a known element at a wrong place, or is a shape.
        """
        # Minimum similarity for a misspelling (`difflib.SequenceMatcher.ratio`).
        alike = 0.8
        shortened = any(word.startswith(name.lower()) for word in known)
        misspelt = shortened or get_close_matches(name.lower(), known, 1, alike)
        return ":" in name or not (name in _ELEMENTS or misspelt or known == _CHILDREN["geometry"])
