r"""Planar sections of 3-D obstacles.

A section is the convex region of the arm plane in which a link meets an obstacle.

A link's axis lies in the arm plane or in a plane parallel to it. A capsule link of half-width :math:`w` meets a convex
obstacle :math:`O` exactly when its axis meets :math:`S = (O \oplus B_w) \cap \text{plane}`. Here :math:`O` is the hull
of a few core points grown by a radius, and every :math:`S` is given as a *rounded polygon*: the hull of a few plane
points grown by a radius.

- Core of one point (sphere) at distance :math:`s` from the plane: a disc of radius
  :math:`\sqrt{(r + w)^2 - s^2}`, exact.
- Core of two points equally far from the plane (capsule along it): a stadium, exact.
- Any other core: a rounded polygon around :math:`S` that exceeds it by at most `SECTION_ERROR`.

`hplan.planar.grid.hull_section` describes the computation of the polygon.

If the arm can touch itself (`hplan.planar.self_contact`), turret and pedestal are additional obstacles to the links
that can touch them. Shapes that turn with the arm plane or are round about the yaw axis have the same section at every
yaw. Contact between links is stored as pairs, because the links' relative pose depends on the joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, get_args
from weakref import WeakKeyDictionary

import numpy as np

from hplan.base.arguments import one_of
from hplan.base.arrays import FloatArray, IntArray, Record, frozen, readonly
from hplan.errors import OptionError
from hplan.planar.base_shapes import BaseShape
from hplan.planar.family_reader import family_of
from hplan.planar.grid.cutting_arrays import ArmPlane, LinkExtents
from hplan.planar.grid.prepared_obstacles import PreparedObstacles, prepare_obstacles
from hplan.planar.grid.section_kernels import cut_balls, cut_hulls
from hplan.planar.own_contact import checked_contact
from hplan.planar.self_contact import SelfContact, radius_in_plane
from hplan.planning.options import LinkModel
from hplan.robot.model import Robot

#: The capsule, the paper's three cases verbatim, or the exact rectangle.
LINK_MODELS: tuple[LinkModel, ...] = get_args(LinkModel)

#: Maximum distance of a section without closed form outside the true section [m].
SECTION_ERROR = 1e-3


class SectionArrays(NamedTuple):
    """Arrays of `ArmSections` for the kernels."""

    link_start: IntArray
    vertex_start: IntArray
    vertices: FloatArray
    radii: FloatArray
    bounds: FloatArray


@dataclass(frozen=True, eq=False)
class ArmSections(Record):
    """Sections of all obstacles as flat arrays for the kernels.

    Link by link.

    Link `k` has the sections `link_start[k]` to `link_start[k + 1]`; section `s` has the vertices `vertex_start[s]` to
    `vertex_start[s + 1]`.

    Attributes:
        link_model: Link model of the radii (`rectangle`: obstacle alone; else grown by the link).
        link_start: (links + 1,) indices of sections.
        vertex_start: (sections + 1,) indices of vertices.
        vertices: (V, 2) points [m].
        radii: (sections,) rounding radii [m].
        bounds: (sections, 3) bounding disc of each section: centre and radius [m].
        obstacle_of: (sections,) index into `obstacle_names`.
        obstacle_names: Names of the obstacles, then names of the arm's own parts that it can touch.
        own_names: Number of the arm's own names, at the end of `obstacle_names`.
        own_pairs: (pairs, 3) pairs of links that can touch: the link, an earlier link, its index in `obstacle_names`.
        own_radii: (pairs,) distance of their axes, projected along the plane's normal, below which they are too near
            [m].
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

    @property
    def arrays(self) -> SectionArrays:
        """Arrays for the kernels."""
        return SectionArrays(self.link_start, self.vertex_start, self.vertices, self.radii, self.bounds)

    @property
    def links(self) -> IntArray:
        """(sections,) link of each section."""
        return np.repeat(np.arange(len(self.link_start) - 1), np.diff(self.link_start))


def sections_at(
    robot: Robot,
    obstacles: PreparedObstacles,
    yaw: float = 0.0,
    *,
    link_model: LinkModel = "capsule",
    within_reach: bool = True,
) -> ArmSections:
    """Cut obstacles and arm parts by the arm plane.

    Parts are those that a link can touch; the plane is at a given yaw.

    Args:
        yaw: Yaw of the arm plane.
        within_reach: True to omit sections that the link cannot reach at any joint angles.

    Raises:
        OptionError: The link model is unknown, an obstacle is not a ball although the model is `rectangle`, or the yaw
            is not finite.
    """
    one_of("link_model", link_model, LINK_MODELS)
    if not math.isfinite(yaw):
        raise OptionError("yaw", yaw, "a finite angle")
    hulls = obstacles.hulls.owners
    if link_model == "rectangle" and len(hulls):
        raise balls_only(obstacles.names[int(hulls[0])])
    sections = _cut_sections(robot, obstacles, yaw, link_model, within_reach=within_reach)
    if obstacles.links is not None:
        links = sections.links
        sections = _pick_sections(sections, np.flatnonzero(obstacles.links[sections.obstacle_of, links]), links)
    contact = checked_contact(robot, deviation=obstacles.deviation, clearance=obstacles.own_clearance)
    if contact.bodies:
        same = tuple(body for body in contact.bodies if body.follows_arm_plane)
        others = tuple(body for body in contact.bodies if not body.follows_arm_plane)
        sections = _join_sections(sections, _constant_sections(robot, same, obstacles))
        if others:
            sections = _join_sections(sections, _base_sections(robot, others, obstacles, yaw))
    if contact.bodies or contact.links:
        sections = _with_own_pairs(sections, robot, contact, obstacles)
    return sections


def balls_only(name: str) -> OptionError:
    """Error that names an obstacle unsupported by the link model `rectangle`."""
    return OptionError(
        "link_model", "rectangle", f"another model, because this one takes only spheres, and {name!r} is not a sphere"
    )


def _cut_sections(
    robot: Robot,
    obstacles: PreparedObstacles,
    yaw: float,
    link_model: LinkModel,
    *,
    within_reach: bool,
) -> ArmSections:
    """Sections of the obstacles, without the arm's own parts."""
    family = family_of(robot)
    rectangle = link_model == "rectangle"
    widths, none = family.arm.half_widths, np.zeros(family.arm.link_count)
    # A box link's corner is farther out than its axis; capsules have their width in the section.
    reaches = np.cumsum(family.arm.lengths) + (widths if rectangle else none)
    links = LinkExtents(
        growth=(none if rectangle else widths) + family.sway(obstacles.deviation),
        depths=np.array(widths) if rectangle else none,
        reaches=reaches if within_reach else np.full(len(reaches), np.inf),
        lateral=np.array(family.arm.lateral),
    )
    origin, axes = (np.ascontiguousarray(array) for array in family.plane_at(yaw))
    plane = ArmPlane(origin, axes)
    cut = cut_balls(obstacles.balls, plane, links)
    if len(obstacles.hulls.owners):
        # Skipped without hulls: this kernel takes longest to compile.
        cut = cut_hulls(obstacles.hulls, plane, links, SECTION_ERROR, cut)
    made = int(cut.link_start[-1])
    return ArmSections(
        link_model=link_model,
        link_start=frozen(cut.link_start),
        vertex_start=readonly(cut.vertex_start[: made + 1], np.int64),
        vertices=readonly(cut.vertices[: cut.vertex_start[made]]),
        radii=readonly(cut.discs[:made, 3]),
        bounds=readonly(cut.discs[:made, :3]),
        obstacle_of=readonly(cut.owners[:made], np.int64),
        obstacle_names=obstacles.names,
    )


def _with_own_pairs(
    sections: ArmSections, robot: Robot, contact: SelfContact, obstacles: PreparedObstacles
) -> ArmSections:
    """Add the pairs of links that can touch, as capsules.

    For every link model.
    """
    arm, count = family_of(robot).arm, len(sections.obstacle_names)
    touched = sorted({i for i, _ in contact.links})
    # A link relative to an earlier link: each link between turns it, and all later links with it.
    sways = [obstacles.deviation * float(arm.lengths[i + 1 : j + 1] @ range(1, j - i + 1)) for i, j in contact.links]
    return replace(
        sections,
        obstacle_names=(*sections.obstacle_names, *(arm.link_names[i] for i in touched)),
        own_names=count + len(touched) - len(obstacles.names),
        own_pairs=readonly(
            np.array([(j, i, count + touched.index(i)) for i, j in contact.links]).reshape(-1, 3), np.int64
        ),
        own_radii=readonly(
            [
                radius_in_plane(
                    float(arm.half_widths[i] + arm.half_widths[j] + obstacles.own_clearance + sway),
                    float(arm.lateral[j] - arm.lateral[i]),
                )
                for (i, j), sway in zip(contact.links, sways, strict=True)
            ]
        ),
    )


#: Cache of the sections of turret and pedestal that are the same at every yaw, by required clearance and joint
#: deviation.
_BASE: WeakKeyDictionary[Robot, dict[tuple[float, float], ArmSections]] = WeakKeyDictionary()


def _constant_sections(robot: Robot, parts: Sequence[BaseShape], obstacles: PreparedObstacles) -> ArmSections:
    """Cached sections of base parts that do not depend on yaw.

    Parts of turret and pedestal.
    """
    known, kept = _BASE.get(robot, {}), (obstacles.own_clearance, obstacles.deviation)
    if kept not in known:
        # A table with one entry, replaced and never modified: another thread may hold the previous table.
        known = _BASE[robot] = {kept: _base_sections(robot, parts, obstacles, 0.0)}
    return known[kept]


def _base_sections(robot: Robot, parts: Sequence[BaseShape], obstacles: PreparedObstacles, yaw: float) -> ArmSections:
    """Sections of base parts for each link that can touch them.

    Parts of turret and pedestal.
    """
    grown = prepare_obstacles(parts, clearance=obstacles.own_clearance, deviation=obstacles.deviation)
    cut = _cut_sections(robot, grown, yaw, "capsule", within_reach=True)
    links = cut.links
    wanted = [link in parts[body].links for link, body in zip(links, cut.obstacle_of, strict=True)]
    return _pick_sections(cut, np.flatnonzero(wanted), links)


def _pick_sections(sections: ArmSections, kept: IntArray, links: IntArray) -> ArmSections:
    """Select the sections `kept` by index, ordered by link.

    Args:
        links: Link of each of all sections.
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


def _join_sections(first: ArmSections, second: ArmSections) -> ArmSections:
    """Concatenate the sections of both, the first before the second."""
    both = replace(
        first,
        vertex_start=np.concatenate([first.vertex_start, len(first.vertices) + second.vertex_start[1:]]),
        vertices=np.concatenate([first.vertices, second.vertices]),
        radii=np.concatenate([first.radii, second.radii]),
        bounds=np.concatenate([first.bounds, second.bounds]),
        obstacle_of=np.concatenate([first.obstacle_of, len(first.obstacle_names) + second.obstacle_of]),
        obstacle_names=(*first.obstacle_names, *second.obstacle_names),
    )
    return _pick_sections(both, np.arange(len(both.radii)), np.concatenate([first.links, second.links]))


def select_sections(sections: ArmSections, link: int, obstacle: int) -> ArmSections:
    """Sections of one obstacle for one link; used to identify blocking pairs."""
    links = sections.links
    made = _pick_sections(sections, np.flatnonzero((links == link) & (sections.obstacle_of == obstacle)), links)
    own = (sections.own_pairs[:, 0] == link) & (sections.own_pairs[:, 2] == obstacle)
    return replace(made, own_pairs=frozen(sections.own_pairs[own]), own_radii=frozen(sections.own_radii[own]))


def meeting_pairs(sections: ArmSections) -> list[tuple[int, int]]:
    """Pairs of link and obstacle with a section, in order.

    The plane misses most obstacles.
    """
    pairs = set(zip(sections.links.tolist(), sections.obstacle_of.tolist(), strict=True))
    return sorted(pairs | {(link, obstacle) for link, _, obstacle in sections.own_pairs.tolist()})
