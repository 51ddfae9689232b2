"""Array types of `hplan.planar.grid.section_kernels`: bodies, arm plane, links and sections."""

from __future__ import annotations

from typing import NamedTuple

from hplan.base.arrays import FloatArray, IntArray


class Balls(NamedTuple):
    """Balls to be cut.

    Attributes:
        centres: (balls, 3) in `base_link` [m].
        radii: (balls,) clearance included [m].
        owners: (balls,) obstacle index of each ball.
    """

    centres: FloatArray
    radii: FloatArray
    owners: IntArray


class Hulls(NamedTuple):
    """Hulls of points, grown by a radius, to be cut.

    Attributes:
        points: (P, 3) core points of all hulls, at least two each, in `base_link` [m].
        starts: (hulls + 1,) indices of their first points.
        radii: (hulls,) radii about them, clearance included [m].
        owners: (hulls,) obstacle index of each hull.
        bounds: (hulls, 4) bounding ball of each core: centre and radius [m].
    """

    points: FloatArray
    starts: IntArray
    radii: FloatArray
    owners: IntArray
    bounds: FloatArray


class ArmPlane(NamedTuple):
    """The arm plane.

    Attributes:
        origin: (3,) a point of the plane [m].
        axes: (3, 3) rows: horizontal axis, upward axis and normal.
    """

    origin: FloatArray
    axes: FloatArray


class LinkExtents(NamedTuple):
    """Widths, lateral offsets and reaches of the links.

    Attributes:
        growth: (links,) growth of the radii by each link [m].
        depths: (links,) half-thickness of each link, a flat slab about its plane [m]; used for balls only.
        reaches: (links,) distance from the origin [m]; sections beyond it are omitted; inf for no limit.
        lateral: (links,) offset of each link's plane of motion from the arm plane, along the normal [m].
    """

    growth: FloatArray
    depths: FloatArray
    reaches: FloatArray
    lateral: FloatArray


class Cut(NamedTuple):
    """Sections, link by link, as in `hplan.planar.grid.sections.ArmSections`.

    All arrays but `link_start` have spare capacity at their end.

    Attributes:
        link_start: (links + 1,) indices of sections.
        vertex_start: Indices of vertices.
        vertices: Points [m].
        discs: Bounding disc and rounding of each section: centre, radius, rounding [m].
        owners: Obstacle index of each section.
    """

    link_start: IntArray
    vertex_start: IntArray
    vertices: FloatArray
    discs: FloatArray
    owners: IntArray
