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
    check_link_model(link_model)
    if not (np.isfinite(clearance) and clearance >= 0.0):
        raise OptionError("clearance", clearance, "a finite number of metres >= 0")
    origin, axes = robot.plane_at(yaw)
    cores = [obstacle.core for obstacle in obstacles]
    roundings = np.array([obstacle.rounding + clearance for obstacle in obstacles])
    single = np.array([len(core) == 1 for core in cores], dtype=np.bool_)
    # Balls, of which there may be hundreds, all at once.
    balls = (np.concatenate([np.zeros((0, 3)), *(core for core in cores if len(core) == 1)]) - origin) @ axes.T
    if link_model == "rectangle" and not single.all():
        _require_disc(cores[int(single.argmin())], obstacles[int(single.argmin())].name)
    per_link = []
    for half_width in robot.arm.half_widths:
        if link_model == "rectangle":
            # What a box link of this half-width (both ways) meets of a ball: a disc, not grown by the link.
            reach, heights = roundings[single], np.maximum(0.0, np.abs(balls[:, 2]) - half_width)
        else:
            reach, heights = roundings[single] + half_width, balls[:, 2]
        square = reach**2 - heights**2
        met = square >= 0.0
        polygons = [
            (int(index), section)
            for index in np.flatnonzero(~single)
            for section in [plane_section((cores[index] - origin) @ axes.T, float(roundings[index] + half_width))]
            if section is not None
        ]
        discs = _Discs(np.flatnonzero(single)[met], balls[met, :2], np.sqrt(square[met]))
        per_link.append((discs, polygons))
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
    check_link_model(link_model)
    hulls = [RoundedPolygon(_convex_hull(section.vertices), section.radius) for section in sections]
    default = tuple(f"section {index}" for index in range(len(sections)))
    names = default if names is None else tuple(names)
    if link_model == "rectangle":
        for name, hull in zip(names, hulls, strict=True):
            _require_disc(hull.vertices, name)
    growth = half_widths if link_model != "rectangle" else np.zeros_like(half_widths)
    per_link = [
        (_NO_DISCS, [(i, RoundedPolygon(h.vertices, h.radius + float(w))) for i, h in enumerate(hulls)]) for w in growth
    ]
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


def check_link_model(link_model: str) -> None:
    """Refuse a link model that there is not.

    Raises:
        OptionError: It is none of `LINK_MODELS`.
    """
    if link_model not in LINK_MODELS:
        raise OptionError("link_model", link_model, f"one of {', '.join(LINK_MODELS)}")


def _require_disc(points: FloatArray, name: str) -> None:
    if len(points) != 1:
        raise OptionError(
            "link_model", "rectangle", f"another model, as this one takes only balls and {name!r} is none"
        )


@dataclass(frozen=True, eq=False)
class _Discs:
    """Sections that are discs: index of the obstacle, (k, 2) centres, (k,) radii."""

    obstacle_of: IntArray
    centres: FloatArray
    radii: FloatArray


_NO_DISCS = _Discs(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0))


def _flatten(
    per_link: Sequence[tuple[_Discs, Sequence[tuple[int, RoundedPolygon]]]],
    names: tuple[str, ...],
    link_model: LinkModel,
) -> ArmSections:
    """Flat arrays; of each link first the discs, then the other sections."""
    counts, sizes, vertices, radii, bounds, owners = [0], [0], [np.zeros((0, 2))], [], [np.zeros((0, 3))], []
    for discs, polygons in per_link:
        counts.append(len(discs.radii) + len(polygons))
        sizes.extend([1] * len(discs.radii) + [len(polygon.vertices) for _, polygon in polygons])
        vertices.extend([discs.centres, *(polygon.vertices for _, polygon in polygons)])
        radii.extend([*discs.radii, *(polygon.radius for _, polygon in polygons)])
        bounds.extend([np.column_stack([discs.centres, discs.radii]), *(_bound(polygon) for _, polygon in polygons)])
        owners.extend([*discs.obstacle_of, *(index for index, _ in polygons)])
    return ArmSections(
        link_model=link_model,
        link_start=readonly(np.cumsum(counts), np.int64),
        vertex_start=readonly(np.cumsum(sizes), np.int64),
        vertices=readonly(np.concatenate(vertices)),
        radii=readonly(radii),
        bounds=readonly(np.concatenate(bounds)),
        obstacle_of=readonly(owners, np.int64),
        obstacle_names=names,
    )


def _bound(polygon: RoundedPolygon) -> FloatArray:
    """(1, 3) centre and radius of a disc around a section."""
    centre = 0.5 * (polygon.vertices.min(axis=0) + polygon.vertices.max(axis=0))
    reach = float(np.linalg.norm(polygon.vertices - centre, axis=1).max()) + polygon.radius
    return np.array([[*centre, reach]])


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
    per_link = [(_NO_DISCS, polygons if k == link else []) for k in range(links)]
    return _flatten(per_link, sections.obstacle_names, sections.link_model)
