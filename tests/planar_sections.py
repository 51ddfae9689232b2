"""Sections of obstacles given in the arm plane itself, and the C-space by sampling with coal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, readonly
from hplan.collision.coal_scene import CoalScene
from hplan.geometry.polygon import convex_hull
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.sections import ArmSections, balls_only
from hplan.planning.options import LinkModel


def sampled_occupancy(checker: CoalScene, grid: Grid) -> BoolArray:
    """Mask of a grid over the planar joints, at yaw 0: True where coal finds some link in contact with an obstacle."""
    nodes = grid.coordinates(np.stack(np.unravel_index(np.arange(grid.size), grid.shape), axis=-1))
    q = np.column_stack([np.zeros(len(nodes)), nodes]) if family_of(checker.robot).has_yaw else nodes
    return checker.in_collision(q).reshape(grid.shape)


@dataclass(frozen=True, eq=False)
class RoundedPolygon:
    """The hull of `vertices` grown by `radius`: a planar convex set.

    Attributes:
        vertices: (k, 2) points [m], counter-clockwise for three or more.
        radius: Rounding [m].
    """

    vertices: FloatArray
    radius: float


def planar_sections(
    sections: Sequence[RoundedPolygon],
    half_widths: FloatArray,
    *,
    link_model: LinkModel = "capsule",
) -> ArmSections:
    """Sections of obstacles given in the arm plane itself, not yet grown by any link."""
    hulls = [RoundedPolygon(convex_hull(section.vertices), section.radius) for section in sections]
    names = tuple(f"section {index}" for index in range(len(sections)))
    if link_model == "rectangle":
        for name, hull in zip(names, hulls, strict=True):
            if len(hull.vertices) != 1:
                raise balls_only(name)
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


def _bound(polygon: RoundedPolygon) -> FloatArray:
    """(1, 3) centre and radius of a disc around a section."""
    centre = 0.5 * (polygon.vertices.min(axis=0) + polygon.vertices.max(axis=0))
    reach = float(np.linalg.norm(polygon.vertices - centre, axis=1).max()) + polygon.radius
    return np.array([[*centre, reach]])
