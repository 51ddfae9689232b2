"""Random arms, drawn as URDFs: members of the family with bodies of all kinds, and chains of any joints.

Nothing of hplan writes them. Of members, links are boxes or cylinders; pedestal and turret carry cabinets,
counterweights and masts on fixed links; the last link carries boxes, and grippers. Bodies of what is carried, and of
chains, are meshes as well, written as STL, some of them no convex ones.
Where they have offsets, the yaw axis stands off the origin, the arm plane passes it at a distance, and joints, links
and tool lie beside each other.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from hplan.base.arrays import FloatArray

#: Largest effort of a joint [N m]: torque is not what is looked at.
EFFORT = 5000.0


def write_member(folder: Path, rng: np.random.Generator, *, offsets: bool = False) -> Path:
    """Draw a member and write it; returns the URDF."""
    count, has_yaw = int(rng.integers(2, 6)), bool(rng.random() < 0.8)
    lengths = np.sort(rng.uniform(0.3, 1.0, count))[::-1]
    widths = np.sort(rng.uniform(0.02, 0.05, count))[::-1]
    column = float(rng.uniform(0.3, 0.6))
    foot: list[float] = rng.uniform(-0.6, 0.6, 2).tolist() if offsets else [0.0, 0.0]
    # From the joint before it: the shoulder, the other joints, the tool; and from its joint, each link's body.
    aside = rng.uniform(-0.15, 0.15, count + 1) if offsets else np.zeros(count + 1)
    body = rng.uniform(-0.1, 0.1, count) * (rng.random(count) < 0.6) if offsets else np.zeros(count)
    parts = ['<?xml version="1.0"?>', '<robot name="drawn">', _link("base_link", _pedestal(rng, column, foot))]
    limits: list[str] = []
    if rng.random() < 0.6:
        place = _beside(rng, 0.3, 0.6, 0.0)
        size = rng.uniform(0.1, 0.35, 3)
        size[2] = rng.uniform(0.2, column + 0.5)
        at = [foot[0] + place[0], foot[1] + place[1], 0.5 * size[2]]
        parts += _hung("cabinet", "base_link", at, _load(rng, folder / "cabinet.stl", size), rng)
    parent, place = "base_link", [*foot, column]
    if has_yaw:
        parts.append(_link("turret", _turret(rng)))
        reach = math.radians(float(rng.uniform(90.0, 180.0)))
        parts.append(_joint("yaw", parent, "turret", place, "0 0 1", (-reach, reach)))
        limits.append(f"yaw: {rng.uniform(1.5, 4.0):.3f}")
        parts += _turret_load(rng, folder)
        parent, ahead = "turret", float(rng.choice([0.0, rng.uniform(-0.1, 0.2)]))
        place = [ahead, float(aside[0]), float(rng.uniform(0.15, 0.3))]
    for k in range(count):
        length, width = float(lengths[k]), float(widths[k])
        parts.append(_link(f"link_{k}", _beam(rng, length, width, float(body[k]))))
        low, high = _range(rng, k)
        parts.append(_joint(f"joint_{k}", parent, f"link_{k}", place, rng.choice(["0 -1 0", "0 1 0"]), (low, high)))
        limits.append(f"joint_{k}: {rng.uniform(2.0, 6.0):.3f}")
        parent, place = f"link_{k}", [length, float(aside[k + 1]), 0.0]
    parts += _tool(rng, folder, parent, place)
    path = folder / "member.urdf"
    path.write_text("\n".join([*parts, "</robot>"]) + "\n", encoding="utf-8")
    table = "{" + ", ".join(limits) + "}"
    path.with_suffix(".limits.yaml").write_text(f"format: hplan-limits/1\nacceleration_rad_s2: {table}\n", "utf-8")
    return path


#: Chains by name: of each joint its axis, x, y or z, a capital where it slides, `?` for any axis and kind.
CHAINS = {
    "six axes": "zyyzyz", "seven axes": "zyzyzyz", "rail and six": "Yzyyzyz", "lift": "ZzXy", "scara": "zzzZ",
    "gantry": "XYZzy", "any four": "????", "any six": "??????",
}  # fmt: skip

#: Share of turning joints without limits.
_ENDLESS = 0.15


def write_chain(folder: Path, rng: np.random.Generator, kind: str) -> Path:
    """Draw a chain that is no member, and write it; returns the URDF."""
    height = float(rng.uniform(0.1, 0.5))
    foot = _collision(_box([*rng.uniform(0.1, 0.25, 2), 0.8 * height]), [0.0, 0.0, 0.4 * height])
    parts = ['<?xml version="1.0"?>', '<robot name="chain">', _link("base_link", [foot])]
    parent, place = "base_link", [0.0, 0.0, height]
    count = len(CHAINS[kind])
    for k, sign in enumerate(CHAINS[kind]):
        axis = np.eye(3)["xyz".index(sign.lower())] if sign != "?" else rng.normal(size=3)
        slides = sign.isupper() or (sign == "?" and bool(rng.random() < 0.2))
        if rng.random() < 0.3:
            axis = axis + rng.normal(scale=0.1, size=3)
        # Wrists are shorter; each link leads up, or, of a slide, along it.
        along = rng.normal(scale=0.25, size=3) + np.array([0.0, 0.0, 1.0])
        along *= float(rng.uniform(0.25, 0.5) if k < count - 3 else rng.uniform(0.12, 0.25)) / np.linalg.norm(along)
        parts.append(_link(f"link_{k}", [_bone(rng, folder / f"link_{k}.stl", along)]))
        half = float(rng.uniform(0.2, 0.8) if slides else np.radians(rng.uniform(60.0, 170.0)))
        limits: tuple[float, float] | None = (0.0, half) if slides else (-half, half)
        what = "prismatic" if slides else "revolute"
        if not slides and rng.random() < _ENDLESS:
            what, limits = "continuous", None
        push = f'acceleration="{rng.uniform(3.0, 8.0):.3f}"'
        parts.append(_joint(f"joint_{k}", parent, f"link_{k}", place, _text(axis), limits, what, push))
        parent, place = f"link_{k}", along.tolist()
    length = float(rng.uniform(0.08, 0.2))
    tube = _collision(cylinder(0.015, length - 0.01), [0.0, 0.0, 0.5 * length + 0.01])
    parts += [_link("tube", [tube]), _joint("flange", parent, "tube", place)]
    parts += [_link("tool0", []), _joint("tip", "tube", "tool0", [0.0, 0.0, length])]
    if rng.random() < 0.3:
        write_stl(folder / "gripper.stl", rng.uniform(-1.0, 1.0, (14, 3)) * rng.uniform(0.02, 0.05, 3))
        body = f'<mesh filename="{folder / "gripper.stl"}"/>'
        parts += _hung("gripper", "tube", [0.0, 0.0, 0.6 * length], body, rng)
    path = folder / "chain.urdf"
    path.write_text("\n".join([*parts, "</robot>"]) + "\n", encoding="utf-8")
    return path


def _bone(rng: np.random.Generator, mesh: Path, along: FloatArray) -> str:
    """A body along a link, that begins after its joint and ends before the next one."""
    length = float(np.linalg.norm(along))
    turn = [0.0, math.acos(along[2] / length), math.atan2(along[1], along[0])]
    width, middle = float(rng.uniform(0.08, 0.16)) * length, (0.52 * along).tolist()
    if rng.random() < 0.2:
        return _collision(f'<sphere radius="{0.25 * length:.6f}"/>', middle)
    size = np.array([1.8 * width, 1.4 * width, 0.6 * length])
    body = cylinder(width, 0.6 * length) if rng.random() < 0.5 else _load(rng, mesh, size)
    return _collision(body, middle, turn)


def _load(rng: np.random.Generator, mesh: Path, size: FloatArray) -> str:
    """Geometry of about a size: a box, a ball, or a mesh, convex or of two blocks at an angle."""
    share = rng.random()
    if share < 0.5:
        return _box(size)
    if share < 0.6:
        return f'<sphere radius="{0.5 * size.min():.6f}"/>'
    if share < 0.8:
        write_stl(mesh, rng.uniform(-0.5, 0.5, (14, 3)) * size)
    else:
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        foot, wall = corners * (1.0, 1.0, 0.3) - (0.0, 0.0, 0.35), corners * (0.3, 1.0, 0.7) - (0.35, 0.0, -0.15)
        write_stl(mesh, foot * size, wall * size)
    return f'<mesh filename="{mesh}"/>'


def write_stl(path: Path, *blocks: FloatArray) -> None:
    """Write the convex hulls of points, block by block, as binary STL.

    Args:
        *blocks: (k, 3) points of each [m].
    """
    rows = []
    for points in blocks:
        hull = ConvexHull(points)
        middle = points[hull.vertices].mean(axis=0)
        for simplex in hull.simplices:
            a, b, c = points[simplex]
            if np.cross(b - a, c - a) @ (a - middle) < 0.0:
                b, c = c, b
            rows.append(struct.pack("<12fH", 0.0, 0.0, 0.0, *a, *b, *c, 0))
    path.write_bytes(b"".join([b"\0" * 80, struct.pack("<I", len(rows)), *rows]))


def cylinder(radius: float, length: float) -> str:
    """Geometry of a cylinder."""
    return f'<cylinder radius="{radius:.6f}" length="{length:.6f}"/>'


def _range(rng: np.random.Generator, joint: int) -> tuple[float, float]:
    """Wide limits, about where the arm stands up or is stretched."""
    middle = float(rng.uniform(-0.3, 0.3)) + (0.5 * math.pi * rng.choice([-1.0, 1.0]) if joint == 0 else 0.0)
    half = math.radians(float(rng.uniform(70.0, 165.0)))
    return middle - half, middle + half


def _pedestal(rng: np.random.Generator, column: float, foot: Sequence[float]) -> list[str]:
    """What stands still below the yaw."""
    if rng.random() < 0.5:
        body = cylinder(float(rng.uniform(0.06, 0.15)), column - 0.02)
    else:
        body = _box([*rng.uniform(0.1, 0.3, 2), column - 0.02])
    return [_collision(body, [*foot, 0.5 * (column - 0.02)])]


def _turret(rng: np.random.Generator) -> list[str]:
    """What turns with the yaw, below the shoulder: boxes, or something round."""
    if rng.random() < 0.3:
        return [_collision(cylinder(float(rng.uniform(0.06, 0.12)), 0.1), [0.0, 0.0, 0.06])]
    return [_collision(_box([*rng.uniform(0.1, 0.3, 2), 0.1]), [*rng.uniform(-0.03, 0.03, 2), 0.06])]


def _turret_load(rng: np.random.Generator, folder: Path) -> list[str]:
    """A counterweight behind, a mast beside."""
    parts: list[str] = []
    if rng.random() < 0.7:
        size = rng.uniform(0.1, 0.3, 3)
        place = [-float(rng.uniform(0.25, 0.55)), float(rng.uniform(-0.1, 0.1)), float(rng.uniform(0.05, 0.3))]
        parts += _hung("counterweight", "turret", place, _load(rng, folder / "counterweight.stl", size), rng)
    if rng.random() < 0.7:
        height, side = float(rng.uniform(0.3, 1.2)), float(rng.choice([-1.0, 1.0]))
        place = [float(rng.uniform(-0.25, 0.15)), side * float(rng.uniform(0.15, 0.35)), 0.5 * height]
        body = cylinder(0.02, height) if rng.random() < 0.5 else _box([0.04, 0.03, height])
        parts += _hung("mast", "turret", place, body, rng, turned=False)
    return parts


def _beam(rng: np.random.Generator, length: float, width: float, aside: float) -> list[str]:
    """A link: a box or a cylinder along it, now and then a motor at its side."""
    if rng.random() < 0.5:
        beam = _collision(_box([length, 2.0 * width, 1.4 * width]), [0.5 * length, aside, 0.0])
    else:
        beam = _collision(cylinder(width, length), [0.5 * length, aside, 0.0], [0.0, 0.5 * math.pi, 0.0])
    if rng.random() < 0.3:
        place = [float(rng.uniform(0.3, 0.7)) * length, aside, 1.2 * width]
        return [beam, _collision(_box([1.5 * width, 1.5 * width, 1.5 * width]), place)]
    return [beam]


def _tool(rng: np.random.Generator, folder: Path, parent: str, end: Sequence[float]) -> list[str]:
    """The tool frame; a box on it, a gripper mesh on a fixed link behind it, or on the last link before it."""
    size = rng.uniform(0.02, 0.08, 3)
    on_tool = [_collision(_box(size), [-0.5 * size[0], 0.0, 0.0])] if rng.random() < 0.5 else []
    parts = [_link("tool0", on_tool), _joint("tool", parent, "tool0", end)]
    if rng.random() < 0.6:
        points = rng.uniform(-1.0, 1.0, (14, 3)) * rng.uniform(0.02, 0.07, 3)
        write_stl(folder / "gripper.stl", points)
        body = f'<mesh filename="{folder / "gripper.stl"}"/>'
        hangs_on, place = ("tool0", [-0.05, 0.0, 0.0]) if rng.random() < 0.5 else (parent, [0.8 * end[0], end[1], 0.03])
        parts += _hung("gripper", hangs_on, place, body, rng)
    return parts


def _beside(rng: np.random.Generator, near: float, far: float, z: float) -> list[float]:
    bearing, distance = float(rng.uniform(-math.pi, math.pi)), float(rng.uniform(near, far))
    return [distance * math.cos(bearing), distance * math.sin(bearing), z]


def _hung(
    name: str, parent: str, place: Sequence[float], body: str, rng: np.random.Generator, *, turned: bool = True
) -> list[str]:
    """A fixed link with one body, turned about the vertical."""
    turn = [0.0, 0.0, float(rng.uniform(-0.5, 0.5)) if turned else 0.0]
    return [_link(name, [_collision(body, [0.0] * 3, turn)]), _joint(f"{name}_mount", parent, name, place)]


def _link(name: str, collisions: Sequence[str]) -> str:
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return f'<link name="{name}">{inertial}{"".join(collisions)}</link>'


def _joint(
    name: str, parent: str, child: str, place: Sequence[float], axis: str = "",
    limits: tuple[float, float] | None = None, kind: str = "revolute", more: str = "",
) -> str:  # fmt: skip
    """A joint that moves, or a fixed one where it has no axis."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{_text(place)}"/>'
    if not axis:
        return f'<joint name="{name}" type="fixed">{ends}</joint>'
    between = "" if limits is None else f'lower="{limits[0]:.6f}" upper="{limits[1]:.6f}" '
    limit = f'<limit {between}velocity="3" effort="{EFFORT:g}" {more}/>'
    return f'<joint name="{name}" type="{kind}">{ends}<axis xyz="{axis}"/>{limit}</joint>'


def _box(size: Sequence[float] | FloatArray) -> str:
    return f'<box size="{_text(size)}"/>'


def _collision(body: str, place: Sequence[float], turn: Sequence[float] = (0.0, 0.0, 0.0)) -> str:
    origin = f'<origin xyz="{_text(place)}" rpy="{_text(turn)}"/>'
    return f"<collision>{origin}<geometry>{body}</geometry></collision>"


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{float(value):.6f}" for value in values)
