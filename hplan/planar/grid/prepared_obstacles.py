"""Obstacles prepared for sections by arm planes.

They are balls, and hulls of points grown by a radius.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen
from hplan.errors import InputError, OptionError
from hplan.planar.grid.cutting_arrays import Balls, Hulls


class ConvexObstacle(Protocol):
    """Obstacle interface for sections.

    The hull of `core`, or each of its points, grown by `rounding`.
    """

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
        """True if every core point is a separate ball.

        As in a point cloud; else the points are corners of one hull.
        """


@dataclass(frozen=True, eq=False)
class PreparedObstacles(Record):
    """Obstacles prepared for sections, once for all yaws.

    Attributes:
        balls: Balls; each point of a cloud is one ball.
        names: Names of the obstacles; balls and hulls refer to them by index.
        own_clearance: Required clearance between parts of the arm [m].
        deviation: Maximum error of every joint [rad]; sections grow by each link's tracking displacement bound.
        links: (obstacles, links) True if the link keeps clear of the obstacle; None if all links avoid all obstacles.
    """

    balls: Balls
    hulls: Hulls
    names: tuple[str, ...]
    own_clearance: float
    deviation: float = 0.0
    links: BoolArray | None = None


def prepare_obstacles(
    obstacles: Sequence[ConvexObstacle],
    *,
    clearance: ArrayLike = 0.0,
    own_clearance: float | None = None,
    deviation: float = 0.0,
    links: BoolArray | None = None,
) -> PreparedObstacles:
    """Prepare obstacles for sections.

    Args:
        clearance: Required distance from the obstacles [m], one number or one per obstacle; may be negative for a
            compliant obstacle if `links` is given.
        own_clearance: Required distance between parts of the arm [m]; None for the minimum of `clearance`.
        deviation: Maximum error of every joint [rad].
        links: (obstacles, links) True if the link keeps clear of the obstacle; None if all links avoid all obstacles.

    Raises:
        OptionError: A clearance is negative or not a number, or the number of clearances differs from the number of
            obstacles.
        InputError: An obstacle has no core points, or a point or radius that is not finite.
    """
    margins = np.asarray(clearance, dtype=np.float64)
    if not (np.isfinite(margins) & ((margins >= 0.0) | (links is not None))).all():
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
    hulls = _NO_HULLS
    if is_hull.any():
        of_hull = is_hull[owners]
        hulls = _hulls(points[of_hull], lengths[is_hull], radii[is_hull], np.flatnonzero(is_hull))
        points, owners = points[~of_hull], owners[~of_hull]
    least = float(margins.min()) if margins.size else 0.0
    return PreparedObstacles(
        balls=Balls(frozen(points), frozen(radii[owners]), frozen(owners)),
        hulls=hulls,
        names=tuple(obstacle.name for obstacle in obstacles),
        own_clearance=least if own_clearance is None else float(own_clearance),
        deviation=deviation,
        links=links,
    )


def _hulls(corners: FloatArray, lengths: IntArray, radii: FloatArray, owners: IntArray) -> Hulls:
    """Assemble hulls from concatenated corners and corner counts."""
    starts = np.concatenate([[0], np.cumsum(lengths)])
    low, high = np.minimum.reduceat(corners, starts[:-1]), np.maximum.reduceat(corners, starts[:-1])
    bounds = np.column_stack([0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)])
    return Hulls(*map(frozen, (corners, starts, radii, owners, bounds)))


_NO_HULLS = _hulls(*(np.zeros(shape, dtype) for shape, dtype in (((0, 3), float), (0, int), (0, float), (0, int))))
