r"""Solids elsewhere: turned and shifted, and what they sweep as they sway along a segment.

**Swept solids.** A solid that is the hull of a core grown by a rounding sweeps, as it is shifted by all of
:math:`[-a, a]`, the hull of :math:`C - a` and :math:`C + a` grown by the same rounding: a ball a capsule, everything
else a hull. This is exact, but that a flat hull is made `hplan.scene.solids.THIN` thicker, and one of many vertices
simplified as a mesh is. A cloud becomes one of copies along the segment, so close that balls of a radius larger by
`SWEPT_ERROR` cover what theirs sweep; where that would be too many points, fewer copies of larger balls.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, Final

import numpy as np

from hplan.base.arrays import FloatArray, frozen, readonly
from hplan.scene.limits import MOST_POINTS
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere
from hplan.scene.solids import Cloud, Hull, hull_of, thickening
from hplan.scene.tracks import rpy_of

#: Balls of a cloud that sways grow by no more than this, unless there are too many [m].
SWEPT_ERROR: Final = 1e-3

#: Solids that sway are made once, as long as no more than so many are in use.
_KEPT: Final = 4096


@lru_cache(maxsize=_KEPT)
def swept_convex(obstacle: Sphere | Capsule | Cylinder | Box) -> Solid:
    """What a convex obstacle that sways sweeps; a cylinder as the prism about it."""
    return obstacle if obstacle.sway is None else swept(obstacle, obstacle.sway.reach)


def swept(solid: Solid, reach: FloatArray) -> Solid:
    """A solid that holds all that another sweeps when it is shifted by up to (3,) `reach` [m] to either side."""
    if isinstance(solid, Cloud):
        return _swept_cloud(solid, reach)
    core = np.concatenate([solid.core - reach, solid.core + reach])
    if len(solid.core) == 1:
        start, end = core.tolist()
        return Capsule(name=solid.name, start=tuple(start), end=tuple(end), radius=solid.rounding, sigma=solid.sigma)
    points = (core + thickening(core)[:, None]).reshape(-1, 3)
    hull = hull_of(points, solid.name)
    return replace(hull, rounding=hull.rounding + solid.rounding, sigma=solid.sigma)


def _swept_cloud(cloud: Cloud, reach: FloatArray) -> Cloud:
    radius, length = cloud.rounding, 2.0 * float(np.linalg.norm(reach))
    # Balls at a distance of this along the segment, grown, cover the capsule between them.
    spacing = 2.0 * math.sqrt((radius + SWEPT_ERROR) ** 2 - radius**2)
    copies = min(max(2, math.ceil(length / spacing) + 1), max(2, MOST_POINTS // len(cloud.core)))
    shifts = np.linspace(-1.0, 1.0, copies)[:, None] * reach
    grown = math.hypot(radius, 0.5 * length / (copies - 1))
    points = (cloud.core + shifts[:, None]).reshape(-1, 3)
    return Cloud.of(cloud.name, points, grown, cloud.sigma)


def posed(solid: Solid, rotation: FloatArray, shift: FloatArray) -> Solid:
    """The solid with each of its points x at `rotation @ x + shift`.

    Args:
        solid: The solid.
        rotation: (3, 3) rotation.
        shift: (3,) shift [m].
    """
    if isinstance(solid, Sphere | Capsule | Cylinder | Box):
        return solid.model_copy(update=moved(solid, rotation, shift))
    core = frozen(np.ascontiguousarray(solid.core @ rotation.T + shift))
    if isinstance(solid, Cloud):
        tree = solid.tree.copy()
        tree[:, 3:6] = tree[:, 3:6] @ rotation.T + shift
        return replace(solid, core=core, tree=frozen(tree))
    return _posed_hull(solid, core, rotation, shift)


def moved(item: Any, rotation: FloatArray, shift: FloatArray) -> dict[str, Any]:
    """The keys of an obstacle, or a fruit, that are others where each of its points x is at `rotation @ x + shift`.

    It stands still there.
    """
    found: dict[str, Any] = {"track": None}
    for key in ("center", "start", "end", "position"):
        if hasattr(item, key):
            found[key] = tuple((rotation @ np.array(getattr(item, key)) + shift).tolist())
    if hasattr(item, "rpy_deg"):
        found["rpy_deg"] = rpy_of(rotation @ item.rotation)
    if item.sway is not None:
        turned = tuple((rotation @ item.sway.reach).tolist())
        found["sway"] = item.sway.model_copy(update={"direction": turned})
    return found


def _posed_hull(hull: Hull, core: FloatArray, rotation: FloatArray, shift: FloatArray) -> Hull:
    """The hull elsewhere, with its facets and edges, which take long to find."""
    moved = replace(hull, core=core)
    normals = hull.planes[:, :3] @ rotation.T
    planes = np.column_stack([normals, (normals @ core.T).max(axis=1)])
    ends = hull.edges[:, :3] @ rotation.T + shift
    edges = readonly(np.column_stack([ends, hull.edges[:, 3:] @ rotation.T]))
    vars(moved)["_facets"] = frozen(planes), edges
    return moved
