r"""What of a 3-D obstacle an arm link can meet: one convex section of the arm plane.

A link's axis lies in the arm plane. A capsule link of half-width :math:`w` meets a convex obstacle :math:`O` exactly
when its axis meets :math:`S = (O \oplus B_w) \cap \text{plane}`. Here :math:`O` is the hull of a few core points grown
by a radius, and every :math:`S` is given as a *rounded polygon*: the hull of a few plane points grown by a radius.

- Core of one point (sphere) at distance :math:`s` from the plane: a disc of radius
  :math:`\sqrt{(r + w)^2 - s^2}`, exact.
- Core of two points equally far from the plane (capsule along it): a stadium, exact.
- Any other core: a rounded polygon around :math:`S` that stands out by `SECTION_ERROR` at most.

`hplan.cspace.hull_section` says how that is found. Over an interval of yaw the section is a bound on the union, as
`hplan.cspace.section_kernels` shows.

Where the arm can touch itself (`hplan.robot.self_contact`), what carries it is one more obstacle to the links that can
touch it. What turns with the arm plane, or is round about the yaw axis, is cut the same at every yaw. Links against
links are kept as pairs: where they lie depends on the joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import one_of
from hplan.base.arrays import FloatArray, IntArray, Record, frozen, readonly
from hplan.base.planar_geometry import convex_hull
from hplan.cspace.section_kernels import cut_balls, cut_hulls
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.robot.self_contact import BaseBody, SelfContact, pair_sway, self_contact

#: How a link is modelled: the capsule, the paper's three cases to the letter, or the exact rectangle.
LinkModel: TypeAlias = Literal["capsule", "paper", "rectangle"]
LINK_MODELS: tuple[LinkModel, ...] = ("capsule", "paper", "rectangle")

#: No point of a section without a closed form is farther than this outside the true one [m].
SECTION_ERROR = 1e-3

#: Half of a yaw interval is at most this: beyond, its ends would bound nothing of use.
MAX_HALF_ANGLE = 0.25 * math.pi


class ConvexObstacle(Protocol):
    """What a section needs to know of an obstacle: the hull of `core`, or each of its points, grown by `rounding`."""

    @property
    def name(self) -> str:
        """Name of the obstacle."""

    @property
    def core(self) -> FloatArray:
        """(k, 3) points [m]."""

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""

    @property
    def is_point_set(self) -> bool:
        """Whether every core point is a ball of its own (a point cloud) and not a corner of one hull."""


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
class ArmSections(Record):
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
        obstacle_names: Names of the obstacles, then those of what the arm can touch of itself.
        own_names: How many of the last names are the arm's own.
        own_pairs: (pairs, 3) pairs of links that can touch: the link, one before it, its index in `obstacle_names`.
        own_radii: (pairs,) distance of their axes from which on they are too near [m].
    """

    link_model: LinkModel
    link_start: IntArray
    vertex_start: IntArray
    vertices: FloatArray
    radii: FloatArray
    bounds: FloatArray
    obstacle_of: IntArray
    obstacle_names: tuple[str, ...]
    own_names: int = 0
    own_pairs: IntArray = field(default_factory=lambda: readonly(np.zeros((0, 3)), np.int64))
    own_radii: FloatArray = field(default_factory=lambda: readonly([]))


@dataclass(frozen=True, eq=False)
class PreparedObstacles(Record):
    """Obstacles made ready for cutting, once for all yaws: balls, each point of a cloud one, and hulls of points.

    Attributes:
        ball_centres: (balls, 3) centres, in `base_link` [m].
        ball_radii: (balls,) radii, clearance included [m].
        ball_owners: (balls,) index into `names`.
        hull_points: (P, 3) core points of all hulls, in `base_link` [m].
        hull_starts: (hulls + 1,) indices of their first points.
        hull_radii: (hulls,) radii about them, clearance included [m].
        hull_owners: (hulls,) index into `names`.
        around: (hulls, 4) a ball around each core: centre and radius [m].
        names: Names of the obstacles.
        own_clearance: Clearance that parts of the arm are to keep from one another [m].
        deviation: By how much every joint may be off [rad]; sections grow by what each link may then sway.
        touched: Index into `names` of the obstacle that the last link may touch; -1 where there is none.
    """

    ball_centres: FloatArray
    ball_radii: FloatArray
    ball_owners: IntArray
    hull_points: FloatArray
    hull_starts: IntArray
    hull_radii: FloatArray
    hull_owners: IntArray
    around: FloatArray
    names: tuple[str, ...]
    own_clearance: float
    deviation: float = 0.0
    touched: int = -1


#: What `_hulls` makes of none.
_NO_HULLS = readonly(np.zeros((0, 3))), readonly([0], np.int64), readonly(np.zeros((0, 4)))


def bodies_of(
    obstacles: Sequence[ConvexObstacle],
    *,
    clearance: ArrayLike = 0.0,
    own_clearance: float | None = None,
    deviation: float = 0.0,
    touched: int = -1,
) -> PreparedObstacles:
    """Make obstacles ready for cutting.

    Args:
        obstacles: The obstacles.
        clearance: Distance to keep from every obstacle [m], one number or one for each.
        own_clearance: Distance that parts of the arm are to keep from one another [m]; None for the smallest of the
            others.
        deviation: By how much every joint may be off [rad].
        touched: Number of the obstacle that the last link may touch; -1 where there is none.

    Raises:
        OptionError: A clearance that is negative or no number, or not one for each obstacle.
        InputError: An obstacle without core points, or with a point or radius that is not finite.
    """
    margins = np.asarray(clearance, dtype=np.float64)
    if not (np.isfinite(margins) & (margins >= 0.0)).all():
        raise OptionError("clearance", clearance, "a finite number of metres >= 0")
    if margins.shape not in ((), (len(obstacles),)):
        raise OptionError("clearance", clearance, f"one number, or one for each of {len(obstacles)} obstacles")
    cores = [obstacle.core for obstacle in obstacles]
    roundings = np.array([obstacle.rounding for obstacle in obstacles], dtype=np.float64)
    lengths = np.array([len(core) for core in cores], dtype=np.int64)
    is_point_set = np.array([obstacle.is_point_set for obstacle in obstacles], dtype=np.bool_)
    points = np.concatenate([np.zeros((0, 3)), *cores])
    owners = np.repeat(np.arange(len(cores)), lengths)
    bad = ~np.isfinite(roundings) | (lengths == 0)
    bad[owners[~np.isfinite(points).all(axis=1)]] = True
    if bad.any():
        name = obstacles[int(bad.argmax())].name
        raise InputError(
            f"obstacle {name!r}: expected finite core points, at least one, and a finite radius", name=name
        )
    radii = roundings + margins
    is_hull = ~(is_point_set | (lengths == 1))
    hull_owners = np.flatnonzero(is_hull)
    corners, starts, around = _NO_HULLS
    if len(hull_owners):
        of_hull = is_hull[owners]
        corners, starts, around = _hulls(points[of_hull], lengths[hull_owners])
        points, owners = points[~of_hull], owners[~of_hull]
    return PreparedObstacles(
        ball_centres=frozen(points),
        ball_radii=frozen(radii[owners]),
        ball_owners=frozen(owners),
        hull_points=corners,
        hull_starts=starts,
        hull_radii=frozen(radii[hull_owners]),
        hull_owners=frozen(hull_owners),
        around=around,
        names=tuple(obstacle.name for obstacle in obstacles),
        own_clearance=float(margins.min()) if own_clearance is None and margins.size else float(own_clearance or 0.0),
        deviation=deviation,
        touched=touched,
    )


def _hulls(corners: FloatArray, lengths: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """`hull_points`, `hull_starts` and `around` of `PreparedObstacles`: the ball is around each hull's bounding box."""
    starts = np.concatenate([[0], np.cumsum(lengths)])
    low, high = np.minimum.reduceat(corners, starts[:-1]), np.maximum.reduceat(corners, starts[:-1])
    around = np.column_stack([0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)])
    return frozen(corners), frozen(starts), frozen(around)


def arm_sections(
    robot: Robot,
    obstacles: Sequence[ConvexObstacle],
    *,
    yaw: float = 0.0,
    clearance: ArrayLike = 0.0,
    link_model: LinkModel = "capsule",
) -> ArmSections:
    """Cut all obstacles by the arm plane at one yaw, once for each link (their half-widths differ).

    Args:
        robot: The arm.
        obstacles: The obstacles.
        yaw: Yaw of the arm plane.
        clearance: Distance to keep from every obstacle [m], one number or one for each.
        link_model: How links are modelled.

    Raises:
        OptionError: Unknown link model, a negative clearance, or `rectangle` with an obstacle that is no sphere.
        InputError: An obstacle without core points, or with a point or radius that is not finite.
    """
    check_link_model(link_model)
    bodies = bodies_of(obstacles, clearance=clearance)
    return sections_at(robot, bodies, yaw, link_model=link_model, within_reach=False)


def sections_at(
    robot: Robot,
    bodies: PreparedObstacles,
    yaw: float = 0.0,
    *,
    half_angle: float = 0.0,
    link_model: LinkModel = "capsule",
    within_reach: bool = True,
) -> ArmSections:
    """What each link can meet of each body at any yaw from `yaw - half_angle` to `yaw + half_angle`.

    With an interval a section holds the union of the sections at all its yaws, in the plane coordinates of each. A
    configuration in which a link meets a body, capsules as links, is therefore occupied at every yaw of the interval.

    Args:
        robot: The arm.
        bodies: The obstacles, made ready.
        yaw: Yaw of the arm plane, the middle of the interval.
        half_angle: Half of the interval's width.
        link_model: How links are modelled.
        within_reach: Leave out sections that the link cannot reach, whatever the joint angles.

    Raises:
        OptionError: Unknown link model, `rectangle` with a body that is no ball, a yaw that is not finite, or a half
            angle that is negative, too large, or above 0 for an arm without yaw.
    """
    check_link_model(link_model)
    if not math.isfinite(yaw):
        raise OptionError("yaw", yaw, "a finite angle")
    largest = MAX_HALF_ANGLE if robot.has_yaw else 0.0
    if not 0.0 <= half_angle <= largest:
        reason = "" if robot.has_yaw else ", as this arm has no yaw"
        raise OptionError("half_angle", half_angle, f"an angle from 0 to {largest:.6g} rad{reason}")
    if link_model == "rectangle" and len(bodies.hull_owners):
        _require_disc(len(bodies.hull_points), bodies.names[int(bodies.hull_owners[0])])
    sections = _cut(robot, bodies, yaw, float(half_angle), link_model, within_reach=within_reach)
    if bodies.touched >= 0:
        links = _links_of(sections)
        spared = (sections.obstacle_of == bodies.touched) & (links == robot.arm.link_count - 1)
        sections = _picked(sections, np.flatnonzero(~spared), links)
    contact = self_contact(robot, deviation=bodies.deviation, clearance=bodies.own_clearance)
    if not (contact.links or contact.bodies):
        return sections
    return _with_itself(sections, robot, contact, bodies, yaw, float(half_angle))


def _cut(
    robot: Robot, bodies: PreparedObstacles, yaw: float, half_angle: float, link_model: LinkModel, *, within_reach: bool
) -> ArmSections:
    """The sections of the bodies alone."""
    rectangle = link_model == "rectangle"
    widths, none = robot.arm.half_widths, np.zeros(robot.arm.link_count)
    growth = (none if rectangle else widths) + robot.sway(bodies.deviation)
    # A box link's corner is farther out than its axis; capsules have their width in the section.
    reaches = np.cumsum(robot.arm.lengths) + (widths if rectangle else none)
    if not within_reach:
        reaches = np.full(len(reaches), np.inf)
    origin, axes = (np.ascontiguousarray(array) for array in robot.plane_at(yaw))
    cut = cut_balls(
        bodies.ball_centres, bodies.ball_radii, bodies.ball_owners, origin, axes, half_angle, growth,
        widths if rectangle else none, reaches, rectangle, SECTION_ERROR,
    )  # fmt: skip
    if len(bodies.hull_owners):
        # Left out where there is none: this kernel takes longest to compile.
        cut = cut_hulls(
            bodies.hull_points, bodies.hull_starts, bodies.hull_radii, bodies.hull_owners, bodies.around, origin, axes,
            half_angle, growth, reaches, SECTION_ERROR, *cut,
        )  # fmt: skip
    link_start, vertex_start, vertices, discs, owner = cut
    made = int(link_start[-1])
    return ArmSections(
        link_model=link_model,
        link_start=frozen(link_start),
        vertex_start=readonly(vertex_start[: made + 1], np.int64),
        vertices=readonly(vertices[: vertex_start[made]]),
        radii=readonly(discs[:made, 3]),
        bounds=readonly(discs[:made, :3]),
        obstacle_of=readonly(owner[:made], np.int64),
        obstacle_names=bodies.names,
    )


def _with_itself(
    sections: ArmSections, robot: Robot, contact: SelfContact, bodies: PreparedObstacles, yaw: float, half_angle: float
) -> ArmSections:
    """The same sections, and what the arm can touch of itself; whatever the model, by its capsules."""
    arm, count = robot.arm, len(sections.obstacle_names)
    touched = sorted({i for i, _ in contact.links})
    if contact.bodies:
        same = tuple(body for body in contact.bodies if body.follows_arm_plane)
        others = tuple(body for body in contact.bodies if not body.follows_arm_plane)
        sections = _joined(sections, _constant_sections(robot, same, bodies))
        if others:
            sections = _joined(sections, _base_sections(robot, others, bodies, yaw, half_angle))
    first = len(sections.obstacle_names)
    return replace(
        sections,
        obstacle_names=(*sections.obstacle_names, *(arm.link_names[i] for i in touched)),
        own_names=first + len(touched) - count,
        own_pairs=readonly(
            np.array([(j, i, first + touched.index(i)) for i, j in contact.links]).reshape(-1, 3), np.int64
        ),
        own_radii=readonly(
            [
                arm.half_widths[i]
                + arm.half_widths[j]
                + bodies.own_clearance
                + pair_sway(robot, j, i, bodies.deviation)
                for i, j in contact.links
            ]
        ),
    )


#: Sections of turret and pedestal that are the same at every yaw and were made before, by the clearance to keep from
#: them and the joints' deviation.
_BASE: WeakKeyDictionary[Robot, dict[tuple[float, float], ArmSections]] = WeakKeyDictionary()


def _constant_sections(robot: Robot, parts: Sequence[BaseBody], bodies: PreparedObstacles) -> ArmSections:
    """Sections of what of turret and pedestal is cut the same at every yaw, made once."""
    known, kept = _BASE.get(robot, {}), (bodies.own_clearance, bodies.deviation)
    if kept not in known:
        # A table of one, replaced and never changed: another thread may hold the one before.
        known = _BASE[robot] = {kept: _base_sections(robot, parts, bodies, 0.0, 0.0)}
    return known[kept]


def _base_sections(
    robot: Robot, parts: Sequence[BaseBody], bodies: PreparedObstacles, yaw: float, half_angle: float
) -> ArmSections:
    """Sections of parts of turret and pedestal, to each link that can touch them."""
    grown = bodies_of(parts, clearance=bodies.own_clearance, deviation=bodies.deviation)
    cut = _cut(robot, grown, yaw, half_angle, "capsule", within_reach=True)
    links = _links_of(cut)
    wanted = [link in parts[body].links for link, body in zip(links, cut.obstacle_of, strict=True)]
    return _picked(cut, np.flatnonzero(wanted), links)


def _links_of(sections: ArmSections) -> IntArray:
    """(sections,) the link that each concerns."""
    return np.repeat(np.arange(len(sections.link_start) - 1), np.diff(sections.link_start))


def _picked(sections: ArmSections, kept: IntArray, links: IntArray) -> ArmSections:
    """Some of the sections, in the order of the links that they concern.

    Args:
        sections: All sections.
        kept: Which of them.
        links: (sections,) the link that each concerns.
    """
    kept = kept[np.argsort(links[kept], kind="stable")]
    sizes = np.diff(sections.vertex_start)[kept]
    starts = np.cumsum([0, *sizes])
    rows = np.repeat(sections.vertex_start[kept] - starts[:-1], sizes) + np.arange(starts[-1])
    return replace(
        sections,
        link_start=readonly(np.searchsorted(links[kept], np.arange(len(sections.link_start))), np.int64),
        vertex_start=readonly(starts, np.int64),
        vertices=frozen(sections.vertices[rows]),
        radii=frozen(sections.radii[kept]),
        bounds=frozen(sections.bounds[kept]),
        obstacle_of=frozen(sections.obstacle_of[kept]),
    )


def _joined(first: ArmSections, second: ArmSections) -> ArmSections:
    """The sections of both, of either kind of names the first one's first."""
    both = replace(
        first,
        vertex_start=np.concatenate([first.vertex_start, len(first.vertices) + second.vertex_start[1:]]),
        vertices=np.concatenate([first.vertices, second.vertices]),
        radii=np.concatenate([first.radii, second.radii]),
        bounds=np.concatenate([first.bounds, second.bounds]),
        obstacle_of=np.concatenate([first.obstacle_of, len(first.obstacle_names) + second.obstacle_of]),
        obstacle_names=(*first.obstacle_names, *second.obstacle_names),
    )
    return _picked(both, np.arange(len(both.radii)), np.concatenate([_links_of(first), _links_of(second)]))


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
    hulls = [RoundedPolygon(convex_hull(section.vertices), section.radius) for section in sections]
    default = tuple(f"section {index}" for index in range(len(sections)))
    names = default if names is None else tuple(names)
    if link_model == "rectangle":
        for name, hull in zip(names, hulls, strict=True):
            _require_disc(len(hull.vertices), name)
    growth = half_widths if link_model != "rectangle" else np.zeros_like(half_widths)
    polygons = [RoundedPolygon(hull.vertices, hull.radius + float(width)) for width in growth for hull in hulls]
    return ArmSections(
        link_model=link_model,
        link_start=readonly(len(hulls) * np.arange(len(growth) + 1), np.int64),
        vertex_start=readonly(np.cumsum([0, *(len(polygon.vertices) for polygon in polygons)]), np.int64),
        vertices=readonly(np.concatenate([np.zeros((0, 2)), *(polygon.vertices for polygon in polygons)])),
        radii=readonly([polygon.radius for polygon in polygons]),
        bounds=readonly(np.concatenate([np.zeros((0, 3)), *(_bound(polygon) for polygon in polygons)])),
        obstacle_of=readonly(np.tile(np.arange(len(hulls)), len(growth)), np.int64),
        obstacle_names=names,
    )


def check_link_model(link_model: str) -> None:
    """Refuse a link model that there is not.

    Raises:
        OptionError: It is none of `LINK_MODELS`.
    """
    one_of("link_model", link_model, LINK_MODELS)


def _require_disc(points: int, name: str) -> None:
    if points != 1:
        raise OptionError(
            "link_model", "rectangle", f"another model, as this one takes only balls and {name!r} is none"
        )


def _bound(polygon: RoundedPolygon) -> FloatArray:
    """(1, 3) centre and radius of a disc around a section."""
    centre = 0.5 * (polygon.vertices.min(axis=0) + polygon.vertices.max(axis=0))
    reach = float(np.linalg.norm(polygon.vertices - centre, axis=1).max()) + polygon.radius
    return np.array([[*centre, reach]])


def only(sections: ArmSections, link: int, obstacle: int) -> ArmSections:
    """The same arm facing one obstacle with one link: for finding out which of them blocks."""
    links = _links_of(sections)
    made = _picked(sections, np.flatnonzero((links == link) & (sections.obstacle_of == obstacle)), links)
    own = (sections.own_pairs[:, 0] == link) & (sections.own_pairs[:, 2] == obstacle)
    return replace(made, own_pairs=frozen(sections.own_pairs[own]), own_radii=frozen(sections.own_radii[own]))


def meeting_pairs(sections: ArmSections) -> list[tuple[int, int]]:
    """The pairs of link and obstacle that can meet at all, in order: most obstacles are not cut by the plane."""
    pairs = set(zip(_links_of(sections).tolist(), sections.obstacle_of.tolist(), strict=True))
    return sorted(pairs | {(link, obstacle) for link, _, obstacle in sections.own_pairs.tolist()})
