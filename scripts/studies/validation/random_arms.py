"""Random arms as URDFs: planar arms with attached bodies, serial chains of any joints, and named robots.

hplan does not write these files. Links of planar arms are boxes or cylinders; cabinets, counterweights, masts and
grippers are attached by fixed joints. Attached bodies and links of chains are also meshes, some of them not convex.
With offsets, the yaw axis is away from the origin, the arm plane is away from the yaw axis, and joints, links and tool
are displaced sideways.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
from studies.outside import arm_of
from studies.validation.judge import Arm

from hplan.base.arrays import FloatArray
from hplan.planar.family_reader import family_of
from hplan.robot.model import Robot, load_robot

#: Robots of example-robot-data, and the shipped orchard arm.
NAMED = ("panda", "ur3", "ur5", "ur10", "orchard_harvester")

#: Shares of planar arms and of chains; the others are named robots. Share of revolute joints of chains without limits.
_PLANAR, _CHAINS, _ENDLESS = 0.4, 0.45, 0.15

#: Chains by name: the axis of each joint, x, y or z, a capital for a prismatic joint, `?` for any axis and type.
CHAINS = {
    "six axes": "zyyzyz", "seven axes": "zyzyzyz", "rail and six": "Yzyyzyz", "lift": "ZzXy", "scara": "zzzZ",
    "gantry": "XYZzy", "any four": "????", "any six": "??????",
}  # fmt: skip

_INERTIA = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """An arm as hplan and as the judge read it.

    Attributes:
        kind: Kind of arm.
        robot: hplan's robot.
        arm: The judge's arm.
    """

    kind: str
    robot: Robot
    arm: Arm


def draw_arm(folder: Path, rng: np.random.Generator) -> DrawnArm:
    """Draw an arm and write its files into a folder.

    Raises:
        HplanError: hplan refuses the arm.
    """
    share = rng.random()
    if share >= _PLANAR + _CHAINS:
        return named_arm(str(rng.choice(NAMED)))
    if share < _PLANAR:
        offsets = bool(rng.random() < 0.5)
        robot = load_robot(write_planar_arm(folder, rng, offsets=offsets))
        family = family_of(robot)
        kind = f"{family.arm.link_count} links{', yaw' if family.has_yaw else ''}{', offsets' if offsets else ''}"
    else:
        kind = str(rng.choice(list(CHAINS)))
        robot = load_robot(write_chain(folder, rng, kind))
    return DrawnArm(kind, robot, Arm(robot.urdf_path))


@cache
def named_arm(name: str) -> DrawnArm:
    """A robot by name."""
    return given_arm(load_robot(name))


def given_arm(robot: Robot) -> DrawnArm:
    """A robot that hplan has read, read by the judge too."""
    return DrawnArm(robot.name, robot, arm_of(robot))


class _Urdf:
    """Links and joints of a URDF, in the order in which they are added."""

    def __init__(self, folder: Path, rng: np.random.Generator) -> None:
        self.folder, self.rng, self.parts = folder, rng, list[str]()

    def link(self, name: str, *collisions: str) -> None:
        self.parts.append(f'<link name="{name}">{_INERTIA}{"".join(collisions)}</link>')

    def joint(
        self, name: str, parent: str, child: str, at: Sequence[float], kind: str = "fixed", axis: str = "",
        limits: str = "",
    ) -> None:  # fmt: skip
        moving = f'<axis xyz="{axis}"/><limit velocity="3" effort="5000" {limits}/>' if axis else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{_text(at)}"/>'
        self.parts.append(f'<joint name="{name}" type="{kind}">{ends}{moving}</joint>')

    def attach(self, name: str, parent: str, at: Sequence[float], geometry: str, turn_rad: float = 0.5) -> None:
        """Add a link with one body on a fixed joint, turned about the vertical by up to an angle."""
        turn = float(self.rng.uniform(-turn_rad, turn_rad))
        self.link(name, _collision(geometry, [0.0] * 3, [0.0, 0.0, turn]))
        self.joint(f"{name}_mount", parent, name, at)

    def body(self, name: str, size: FloatArray) -> str:
        """Random geometry of a size: a box, a sphere, or a mesh, convex or of two blocks at an angle."""
        share = self.rng.random()
        if share < 0.5:
            return _box(size)
        if share < 0.6:
            return f'<sphere radius="{0.5 * size.min():.6f}"/>'
        if share < 0.8:
            return self.mesh(name, self.rng.uniform(-0.5, 0.5, (14, 3)) * size)
        corners = np.array(trimesh.creation.box((1.0, 1.0, 1.0)).vertices)
        foot, wall = corners * (1.0, 1.0, 0.3) - (0.0, 0.0, 0.35), corners * (0.3, 1.0, 0.7) - (0.35, 0.0, -0.15)
        return self.mesh(name, foot * size, wall * size)

    def mesh(self, name: str, *blocks: FloatArray) -> str:
        """Write the convex hulls of blocks of (k, 3) points as one STL."""
        file = self.folder / f"{name}.stl"
        trimesh.util.concatenate([trimesh.convex.convex_hull(points) for points in blocks]).export(file)
        return f'<mesh filename="{file}"/>'

    def write(self, name: str) -> Path:
        file = self.folder / f"{name}.urdf"
        text = "\n".join(['<?xml version="1.0"?>', f'<robot name="{name}">', *self.parts, "</robot>"])
        file.write_text(text, encoding="utf-8")
        return file


def write_planar_arm(folder: Path, rng: np.random.Generator, *, offsets: bool = False) -> Path:
    """Draw a planar arm and write it; returns the URDF."""
    urdf, limits = _Urdf(folder, rng), dict[str, float]()
    count, has_yaw, column = int(rng.integers(2, 6)), bool(rng.random() < 0.8), float(rng.uniform(0.3, 0.6))
    lengths, widths = (np.sort(rng.uniform(*span, count))[::-1] for span in ((0.3, 1.0), (0.02, 0.05)))
    foot: list[float] = rng.uniform(-0.6, 0.6, 2).tolist() if offsets else [0.0, 0.0]
    # Sideways displacements of the shoulder, the other joints and the tool, and of each link's body.
    aside = rng.uniform(-0.15, 0.15, count + 1) * offsets
    body_aside = rng.uniform(-0.1, 0.1, count) * (rng.random(count) < 0.6) * offsets
    _pedestal(urdf, column, foot)
    parent, at = "base_link", [*foot, column]
    if has_yaw:
        _turret(urdf, at)
        limits["yaw"] = float(rng.uniform(1.5, 4.0))
        parent, at = "turret", [float(rng.uniform(-0.1, 0.2)), float(aside[0]), float(rng.uniform(0.15, 0.3))]
    for k in range(count):
        name, length, width, y = f"joint_{k}", float(lengths[k]), float(widths[k]), float(body_aside[k])
        half_turn = [0.0, 0.5 * math.pi, 0.0]
        beams = [(_box([length, 2.0 * width, 1.4 * width]), [0.0] * 3), (_cylinder(width, length), half_turn)]
        beam, turn = beams[int(rng.integers(2))]
        motor = [float(rng.uniform(0.3, 0.7)) * length, y, 1.2 * width]
        parts = [_collision(beam, [0.5 * length, y, 0.0], turn), _collision(_box([1.5 * width] * 3), motor)]
        urdf.link(f"link_{k}", *parts[: 2 if rng.random() < 0.3 else 1])
        middle = float(rng.uniform(-0.3, 0.3)) + (0.5 * math.pi * rng.choice([-1.0, 1.0]) if k == 0 else 0.0)
        half = math.radians(float(rng.uniform(70.0, 165.0)))
        axis = str(rng.choice(["0 -1 0", "0 1 0"]))
        urdf.joint(name, parent, f"link_{k}", at, "revolute", axis, _range(middle - half, middle + half))
        limits[name] = float(rng.uniform(2.0, 6.0))
        parent, at = f"link_{k}", [length, float(aside[k + 1]), 0.0]
    size = rng.uniform(0.02, 0.08, 3)
    urdf.link("tool0", *[_collision(_box(size), [-0.5 * size[0], 0.0, 0.0])][: int(rng.integers(2))])
    urdf.joint("tool", parent, "tool0", at)
    if rng.random() < 0.6:
        gripper = urdf.mesh("gripper", rng.uniform(-1.0, 1.0, (14, 3)) * rng.uniform(0.02, 0.07, 3))
        places = [("tool0", [-0.05, 0.0, 0.0]), (parent, [0.8 * at[0], at[1], 0.03])]
        urdf.attach("gripper", *places[int(rng.integers(2))], gripper)
    path = urdf.write("planar_arm")
    table = "{" + ", ".join(f"{joint}: {limit:.3f}" for joint, limit in limits.items()) + "}"
    path.with_suffix(".limits.yaml").write_text(f"format: hplan-limits/1\nacceleration_rad_s2: {table}\n", "utf-8")
    return path


def _pedestal(urdf: _Urdf, column: float, foot: list[float]) -> None:
    """Add the static base, possibly with a cabinet next to it."""
    rng, height = urdf.rng, column - 0.02
    bodies = _cylinder(float(rng.uniform(0.06, 0.15)), height), _box([*rng.uniform(0.1, 0.3, 2), height])
    urdf.link("base_link", _collision(bodies[int(rng.integers(2))], [*foot, 0.5 * height]))
    if rng.random() < 0.6:
        bearing, distance = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(0.3, 0.6))
        size = np.array([*rng.uniform(0.1, 0.35, 2), rng.uniform(0.2, column + 0.5)])
        at = [foot[0] + distance * math.cos(bearing), foot[1] + distance * math.sin(bearing), 0.5 * size[2]]
        urdf.attach("cabinet", "base_link", at, urdf.body("cabinet", size))


def _turret(urdf: _Urdf, at: Sequence[float]) -> None:
    """Add the turret on a yaw joint, possibly with a counterweight behind it and a mast at its side."""
    rng, half = urdf.rng, math.radians(float(urdf.rng.uniform(90.0, 180.0)))
    box = _collision(_box([*rng.uniform(0.1, 0.3, 2), 0.1]), [*rng.uniform(-0.03, 0.03, 2), 0.06])
    round_one = _collision(_cylinder(float(rng.uniform(0.06, 0.12)), 0.1), [0.0, 0.0, 0.06])
    urdf.link("turret", round_one if rng.random() < 0.3 else box)
    urdf.joint("yaw", "base_link", "turret", at, "revolute", "0 0 1", _range(-half, half))
    if rng.random() < 0.7:
        place = [-float(rng.uniform(0.25, 0.55)), float(rng.uniform(-0.1, 0.1)), float(rng.uniform(0.05, 0.3))]
        urdf.attach("counterweight", "turret", place, urdf.body("counterweight", rng.uniform(0.1, 0.3, 3)))
    if rng.random() < 0.7:
        height, side = float(rng.uniform(0.3, 1.2)), float(rng.choice([-1.0, 1.0]))
        place = [float(rng.uniform(-0.25, 0.15)), side * float(rng.uniform(0.15, 0.35)), 0.5 * height]
        masts = _cylinder(0.02, height), _box([0.04, 0.03, height])
        urdf.attach("mast", "turret", place, masts[int(rng.integers(2))], 0.0)


def write_chain(folder: Path, rng: np.random.Generator, kind: str) -> Path:
    """Draw a chain that is not a planar arm, and write it; returns the URDF."""
    urdf, height = _Urdf(folder, rng), float(rng.uniform(0.1, 0.5))
    urdf.link("base_link", _collision(_box([*rng.uniform(0.1, 0.25, 2), 0.8 * height]), [0.0, 0.0, 0.4 * height]))
    parent, at = "base_link", [0.0, 0.0, height]
    for k, sign in enumerate(CHAINS[kind]):
        axis = rng.normal(size=3) if sign == "?" else np.eye(3)["xyz".index(sign.lower())]
        slides = sign.isupper() or (sign == "?" and bool(rng.random() < 0.2))
        if rng.random() < 0.3:
            axis = axis + rng.normal(scale=0.1, size=3)
        # Each link leads upwards; wrists are shorter.
        along = rng.normal(scale=0.25, size=3) + np.array([0.0, 0.0, 1.0])
        along *= float(rng.uniform(*(0.25, 0.5) if k < len(CHAINS[kind]) - 3 else (0.12, 0.25))) / np.linalg.norm(along)
        urdf.link(f"link_{k}", _chain_link(urdf, f"link_{k}", along))
        half = float(rng.uniform(0.2, 0.8) if slides else np.radians(rng.uniform(60.0, 170.0)))
        endless = not slides and rng.random() < _ENDLESS
        limits = "" if endless else _range(0.0 if slides else -half, half)
        joint_type = "prismatic" if slides else "continuous" if endless else "revolute"
        limits += f' acceleration="{rng.uniform(3.0, 8.0):.3f}"'
        urdf.joint(f"joint_{k}", parent, f"link_{k}", at, joint_type, _text(axis), limits)
        parent, at = f"link_{k}", along.tolist()
    length = float(rng.uniform(0.08, 0.2))
    urdf.link("tube", _collision(_cylinder(0.015, length - 0.01), [0.0, 0.0, 0.5 * length + 0.01]))
    urdf.joint("flange", parent, "tube", at)
    urdf.link("tool0")
    urdf.joint("tip", "tube", "tool0", [0.0, 0.0, length])
    if rng.random() < 0.3:
        gripper = urdf.mesh("gripper", rng.uniform(-1.0, 1.0, (14, 3)) * rng.uniform(0.02, 0.05, 3))
        urdf.attach("gripper", "tube", [0.0, 0.0, 0.6 * length], gripper)
    return urdf.write("chain")


def _chain_link(urdf: _Urdf, name: str, along: FloatArray) -> str:
    """A body along a link, from after its joint to before the next one."""
    rng, length = urdf.rng, float(np.linalg.norm(along))
    middle, width = (0.52 * along).tolist(), float(rng.uniform(0.08, 0.16)) * length
    if rng.random() < 0.2:
        return _collision(f'<sphere radius="{0.25 * length:.6f}"/>', middle)
    size = np.array([1.8 * width, 1.4 * width, 0.6 * length])
    body = _cylinder(width, 0.6 * length) if rng.random() < 0.5 else urdf.body(name, size)
    return _collision(body, middle, [0.0, math.acos(along[2] / length), math.atan2(along[1], along[0])])


def _box(size: Sequence[float] | FloatArray) -> str:
    return f'<box size="{_text(size)}"/>'


def _cylinder(radius: float, length: float) -> str:
    return f'<cylinder radius="{radius:.6f}" length="{length:.6f}"/>'


def _collision(geometry: str, at: Sequence[float], turn: Sequence[float] = (0.0, 0.0, 0.0)) -> str:
    origin = f'<origin xyz="{_text(at)}" rpy="{_text(turn)}"/>'
    return f"<collision>{origin}<geometry>{geometry}</geometry></collision>"


def _range(low: float, high: float) -> str:
    return f'lower="{low:.6f}" upper="{high:.6f}"'


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{float(value):.6f}" for value in values)
