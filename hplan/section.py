r"""What of a 3-D obstacle an arm link can meet: one convex section of the arm plane.

A link's axis lies in the arm plane. A capsule link of half-width :math:`w` meets a convex obstacle :math:`O` exactly
when its axis meets :math:`S = (O \oplus B_w) \cap \text{plane}`. Here :math:`O` is the hull of a few core points grown
by a radius, and every :math:`S` is given as a *rounded polygon*: the hull of a few plane points grown by a radius.

- Core of one point (sphere) at distance :math:`s` from the plane: a disc of radius
  :math:`\sqrt{(r + w)^2 - s^2}`, exact.
- Any core that lies in the plane: the same core, exact.
- Any other core: a polygon around :math:`S`. The section's support in direction :math:`u` is that of its projection
  along the plane onto :math:`(u, n)`: where the hull of a few points in 2-D, grown by :math:`R`, crosses the axis, in
  closed form. `DIRECTIONS` tangents are drawn, and more between any two whose corner may stand outside :math:`S` by
  more than `SECTION_ERROR`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np

from hplan.arrays import FloatArray, IntArray, readonly
from hplan.errors import OptionError
from hplan.robot import Robot

#: How a link is modelled: the capsule, the paper's three cases to the letter, or the exact rectangle.
LinkModel: TypeAlias = Literal["capsule", "paper", "rectangle"]
LINK_MODELS: tuple[LinkModel, ...] = ("capsule", "paper", "rectangle")

#: Tangents drawn around a section that has no closed form, before corners are cut.
DIRECTIONS = 16

#: No point of such a polygon is farther than this outside the section [m].
SECTION_ERROR = 1e-3

#: Corners are cut this many times at most: enough for sections of 10 km.
_MAX_HALVINGS = 24

#: Outward shift of tangents, above all rounding errors, so that these err to the safe side [m].
_OUTWARD = 1e-12

#: Cores closer to the plane than this lie in it [m].
_IN_PLANE = 1e-12


class ConvexObstacle(Protocol):
    """What a section needs to know of an obstacle: the hull of `core` grown by `rounding`."""

    @property
    def name(self) -> str:
        """Name of the obstacle."""

    @property
    def core(self) -> FloatArray:
        """(k, 3) points [m]."""

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""


@dataclass(frozen=True, eq=False)
class RoundedPolygon:
    """The hull of `vertices` grown by `radius`: a planar convex set.

    Attributes:
        vertices: (k, 2) points [m], counter-clockwise where there are three or more.
        radius: Rounding [m].
    """

    vertices: FloatArray
    radius: float


@dataclass(frozen=True, eq=False)
class ArmSections:
    """The sections of all obstacles, link by link, as flat arrays for the kernels.

    Link `k` is concerned by sections `link_start[k]` to `link_start[k + 1]`; section `s` has the vertices
    `vertex_start[s]` to `vertex_start[s + 1]`.

    Attributes:
        link_model: The model the radii were made for (`rectangle`: obstacle alone; else grown by the link).
        link_start: (links + 1,) indices of sections.
        vertex_start: (sections + 1,) indices of vertices.
        vertices: (V, 2) points [m].
        radii: (sections,) rounding radii [m].
        bounds: (sections, 3) a disc around each section: centre and radius [m].
        obstacle_of: (sections,) index into `obstacle_names`.
        obstacle_names: Names of the obstacles.
    """

    link_model: LinkModel
    link_start: IntArray
    vertex_start: IntArray
    vertices: FloatArray
    radii: FloatArray
    bounds: FloatArray
    obstacle_of: IntArray
    obstacle_names: tuple[str, ...]


def arm_sections(
    robot: Robot,
    obstacles: Sequence[ConvexObstacle],
    *,
    yaw: float = 0.0,
    clearance: float = 0.0,
    link_model: LinkModel = "capsule",
) -> ArmSections:
    """Cut all obstacles by the arm plane, once for each link (their half-widths differ).

    Args:
        robot: The arm.
        obstacles: Convex obstacles.
        yaw: Yaw of the arm plane.
        clearance: Distance to keep from every obstacle [m].
        link_model: How links are modelled.

    Raises:
        OptionError: Unknown link model, a negative clearance, or `rectangle` with an obstacle that is no sphere.
    """
    _check_link_model(link_model)
    if not (np.isfinite(clearance) and clearance >= 0.0):
        raise OptionError("clearance", clearance, "a finite number of metres >= 0")
    origin, axes = robot.plane_at(yaw)
    cores = [(obstacle.core - origin) @ axes.T for obstacle in obstacles]
    per_link: list[list[tuple[int, RoundedPolygon]]] = []
    for half_width in robot.arm.half_widths:
        row = []
        for index, (obstacle, core) in enumerate(zip(obstacles, cores, strict=True)):
            rounding = obstacle.rounding + clearance
            if link_model == "rectangle":
                section = _beside_rectangle(core, rounding, float(half_width), obstacle.name)
            else:
                section = plane_section(core, rounding + float(half_width))
            if section is not None:
                row.append((index, section))
        per_link.append(row)
    return _flatten(per_link, tuple(obstacle.name for obstacle in obstacles), link_model)


def planar_sections(
    sections: Sequence[RoundedPolygon],
    half_widths: FloatArray,
    *,
    link_model: LinkModel = "capsule",
    names: Sequence[str] | None = None,
) -> ArmSections:
    """Sections of obstacles given in the arm plane itself, not yet grown by any link.

    Raises:
        OptionError: Unknown link model, or `rectangle` with a section that is no disc.
    """
    _check_link_model(link_model)
    hulls = [RoundedPolygon(_convex_hull(section.vertices), section.radius) for section in sections]
    default = tuple(f"section {index}" for index in range(len(sections)))
    names = default if names is None else tuple(names)
    if link_model == "rectangle":
        for name, hull in zip(names, hulls, strict=True):
            _require_disc(hull.vertices, name)
    growth = half_widths if link_model != "rectangle" else np.zeros_like(half_widths)
    per_link = [[(i, RoundedPolygon(h.vertices, h.radius + float(w))) for i, h in enumerate(hulls)] for w in growth]
    return _flatten(per_link, names, link_model)


def plane_section(core: FloatArray, radius: float) -> RoundedPolygon | None:
    """Section of the hull of `core` grown by `radius` with the plane where the third coordinate is 0.

    Args:
        core: (k, 3) points in plane coordinates [m].
        radius: Radius about the hull [m].

    Returns:
        The section, or None where the plane misses the body. See the module's text for what is exact.
    """
    heights = core[:, 2]
    if heights.min() > radius or heights.max() < -radius:
        return None
    if np.abs(heights).max() <= _IN_PLANE:
        return RoundedPolygon(readonly(_convex_hull(core[:, :2])), radius)
    if len(core) == 1:
        return RoundedPolygon(readonly(core[:, :2]), float(np.sqrt(radius**2 - heights[0] ** 2)))
    return RoundedPolygon(readonly(_convex_hull(_tangent_polygon(core, radius))), 0.0)


def _tangent_polygon(core: FloatArray, radius: float) -> FloatArray:
    """Corners of a polygon of tangents around the section, at most `SECTION_ERROR` outside it.

    A tangent halfway between two others that cuts their corner off at depth d shows that none of what the corner
    covers is farther than 2 d from the section: the section touches all three.
    """
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    supports = _supports(core, angles, radius)
    for _ in range(_MAX_HALVINGS):
        corners = _corners(angles, supports)
        between = angles + 0.5 * np.diff(angles, append=2.0 * np.pi)
        cut = _supports(core, between, radius)
        depth = np.sum(corners * _unit(between), axis=1) - cut
        coarse = 2.0 * depth > SECTION_ERROR
        if not coarse.any():
            break
        order = np.argsort(np.concatenate([angles, between[coarse]]))
        angles = np.concatenate([angles, between[coarse]])[order]
        supports = np.concatenate([supports, cut[coarse]])[order]
    return corners


def _unit(angles: FloatArray) -> FloatArray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _supports(core: FloatArray, angles: FloatArray, radius: float) -> FloatArray:
    """Support of the section in directions at the given angles.

    Seen along the plane the core's points stand at `reach` (along the direction) and `heights`; the section ends
    where the last of the arcs about them, or of the sides that join two arcs, crosses height 0.
    """
    heights = core[:, 2]
    reach = core[:, :2] @ _unit(angles).T
    near = np.abs(heights) <= radius
    arcs = reach[near] + np.sqrt(radius**2 - heights[near] ** 2)[:, None]
    first, second = np.triu_indices(len(core), k=1)
    rise = heights[second] - heights[first]
    slanted = np.abs(rise) > _IN_PLANE
    first, second, rise = first[slanted], second[slanted], rise[slanted, None]
    run = reach[second] - reach[first]
    outward = radius / np.hypot(rise, run)  # the side's normal points to larger reach
    place = -(heights[first, None] - np.copysign(outward, rise) * run) / rise
    sides = reach[first] + place * run + outward * np.abs(rise)
    sides[(place < 0.0) | (place > 1.0)] = -np.inf
    supports: FloatArray = np.max(np.concatenate([arcs, sides]), axis=0) + _OUTWARD
    return supports


def _corners(angles: FloatArray, supports: FloatArray) -> FloatArray:
    """Where each tangent meets the next one."""
    tangents = _unit(angles)
    following, next_supports = np.roll(tangents, -1, axis=0), np.roll(supports, -1)
    turn = tangents[:, 0] * following[:, 1] - tangents[:, 1] * following[:, 0]
    x = (supports * following[:, 1] - next_supports * tangents[:, 1]) / turn
    y = (next_supports * tangents[:, 0] - supports * following[:, 0]) / turn
    return np.stack([x, y], axis=1)


def _convex_hull(points: FloatArray) -> FloatArray:
    """Counter-clockwise convex hull (Andrew's monotone chain); 1 or 2 points where they are all in line."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    if len(ordered) <= 2:
        return np.array(ordered)

    def half(sequence: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for point in sequence:
            while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 0.0:
                chain.pop()
            chain.append(point)
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1]))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _beside_rectangle(core: FloatArray, radius: float, half_width: float, name: str) -> RoundedPolygon | None:
    """What a box link of the given half-width (both ways) meets of a ball: a disc, not grown by the link."""
    _require_disc(core, name)
    beyond = max(0.0, abs(float(core[0, 2])) - half_width)
    if beyond > radius:
        return None
    return RoundedPolygon(readonly(core[:, :2]), float(np.sqrt(radius**2 - beyond**2)))


def _check_link_model(link_model: str) -> None:
    if link_model not in LINK_MODELS:
        raise OptionError("link_model", link_model, f"one of {', '.join(LINK_MODELS)}")


def _require_disc(points: FloatArray, name: str) -> None:
    if len(points) != 1:
        raise OptionError(
            "link_model", "rectangle", f"another model, as this one takes only balls and {name!r} is none"
        )


def _flatten(
    per_link: Sequence[Sequence[tuple[int, RoundedPolygon]]],
    names: tuple[str, ...],
    link_model: LinkModel,
) -> ArmSections:
    sections = [item for row in per_link for item in row]
    polygons = [polygon for _, polygon in sections]
    bounds = [
        (*centre, float(np.linalg.norm(p.vertices - centre, axis=1).max()) + p.radius)
        for p in polygons
        for centre in [0.5 * (p.vertices.min(axis=0) + p.vertices.max(axis=0))]
    ]
    return ArmSections(
        link_model=link_model,
        link_start=readonly(np.cumsum([0, *(len(row) for row in per_link)]), np.int64),
        vertex_start=readonly(np.cumsum([0, *(len(p.vertices) for p in polygons)]), np.int64),
        vertices=readonly(np.concatenate([np.zeros((0, 2)), *(p.vertices for p in polygons)])),
        radii=readonly([p.radius for p in polygons]),
        bounds=readonly(np.array(bounds).reshape(-1, 3)),
        obstacle_of=readonly([index for index, _ in sections], np.int64),
        obstacle_names=names,
    )


def only(sections: ArmSections, link: int, obstacle: int) -> ArmSections:
    """The same arm facing one obstacle with one link: for finding out which of them blocks."""
    first, last = int(sections.link_start[link]), int(sections.link_start[link + 1])
    kept = [s for s in range(first, last) if sections.obstacle_of[s] == obstacle]
    polygons = [
        (
            obstacle,
            RoundedPolygon(sections.vertices[slice(*sections.vertex_start[s : s + 2])], float(sections.radii[s])),
        )
        for s in kept
    ]
    links = len(sections.link_start) - 1
    per_link = [polygons if k == link else [] for k in range(links)]
    return _flatten(per_link, sections.obstacle_names, sections.link_model)
