"""What the kernels of `hplan.grid.section_kernels` take and give: bodies, the arm plane, links, and sections."""

from __future__ import annotations

from typing import NamedTuple

from hplan.base.arrays import FloatArray, IntArray


class Balls(NamedTuple):
    """Balls to be cut.

    Attributes:
        centres: (balls, 3) in `base_link` [m].
        radii: (balls,) clearance included [m].
        owners: (balls,) index of the obstacle that each belongs to.
    """

    centres: FloatArray
    radii: FloatArray
    owners: IntArray


class Hulls(NamedTuple):
    """Hulls of points, grown by a radius, to be cut.

    Attributes:
        points: (P, 3) core points of all hulls, two or more each, in `base_link` [m].
        starts: (hulls + 1,) indices of their first points.
        radii: (hulls,) radii about them, clearance included [m].
        owners: (hulls,) index of the obstacle that each belongs to.
        bounds: (hulls, 4) a ball that holds each core: centre and radius [m].
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
        axes: (3, 3) rows: its horizontal and upward axis and its normal.
    """

    origin: FloatArray
    axes: FloatArray


class LinkExtents(NamedTuple):
    """Widths, places and reaches of the links.

    Attributes:
        growth: (links,) what each link adds to the radii [m].
        depths: (links,) how far each link extends to both sides of the plane, flat; balls alone are cut so [m].
        reaches: (links,) distance from the origin beyond which sections are left out [m], inf for none.
        lateral: (links,) how far off the plane each link moves, along the normal [m]: in a plane parallel to it.
    """

    growth: FloatArray
    depths: FloatArray
    reaches: FloatArray
    lateral: FloatArray


class Cut(NamedTuple):
    """Sections, link by link, as in `hplan.grid.sections.ArmSections`; all but `link_start` have room at their end.

    Attributes:
        link_start: (links + 1,) indices of sections.
        vertex_start: Indices of vertices.
        vertices: Points [m].
        discs: Of each section a disc around it, and its rounding: centre, radius, rounding [m].
        owners: Index of the obstacle that each is cut from.
    """

    link_start: IntArray
    vertex_start: IntArray
    vertices: FloatArray
    discs: FloatArray
    owners: IntArray
