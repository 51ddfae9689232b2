"""What every kind of obstacle is made of, and what it says of itself.

A new kind is a class on these bases in a file of its own, and its row in `hplan.scene.obstacles`. A convex one says
which points it is the hull of (`core`) and by how much they are grown (`rounding`); all else that kernels, certificate,
pages and messages ask (`hull`, `surface`, `excess`) follows, unless the kind knows better.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self, TypeAlias

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from hplan.base.arrays import FloatArray, IntArray, frozen, readonly
from hplan.scene.fault import StrictModel, fault
from hplan.scene.limits import FARTHEST_M, MOST_POINTS, Angles, Vector
from hplan.scene.solids import Cloud, Hull, hull_of, rpy_of, rpy_rotation, thickening, whole_hull
from hplan.scene.tracks import Sway, Track

Name: TypeAlias = Annotated[str, Field(min_length=1)]
Sigma: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]

#: How many standard deviations each obstacle grows by: the same of all, or of each by name (none of those not named).
Sigmas: TypeAlias = float | Mapping[str, float]


def _symmetric(rows: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    """Rows of a covariance, checked."""
    matrix = np.array(rows)
    size = float(np.abs(matrix).max())
    if not np.abs(matrix - matrix.T).max() <= 1e-9 * size or np.linalg.eigvalsh(matrix).min() < -1e-9 * size:
        raise ValueError("expected a covariance: symmetric, without negative eigenvalues")
    return rows


#: Covariance of a place, in `base_link` [m^2]; in dumps where there is one.
CovarianceField: TypeAlias = Annotated[
    tuple[Vector, Vector, Vector] | None,
    AfterValidator(lambda rows: rows if rows is None else _symmetric(rows)),
    Field(exclude=True),
]


def largest_deviation(covariance: FloatArray) -> float:
    """Standard deviation in the direction in which a (3, 3) covariance has the largest [m]."""
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance)[-1])))


#: Balls of a cloud that sways grow by no more than this, unless there are too many [m].
SWEPT_ERROR: Final = 1e-3

#: Solids that sway are made once, as long as no more than so many are in use.
_KEPT: Final = 4096

#: How an obstacle moves. In dumps these keys are added where there are any: a still scene has the digest it had.
TrackField: TypeAlias = Annotated[Track | None, Field(exclude=True)]
SwayField: TypeAlias = Annotated[Sway | None, Field(exclude=True)]

#: How deep an obstacle may be pushed [m]; in dumps where it may.
YieldsField: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M, exclude=True)]


class Item(StrictModel):
    """Base of obstacles and fruit: what the fields are that any of them may have besides its shape.

    Attributes:
        name: Its name.
        sigma: Standard deviation of each coordinate of its position; with a covariance that in the worst direction [m].
        track: How it moves; None for one that stands still.
        sway: How far it may swing out of its place; None for not at all.
        yields: How deep the links that may push may be in it [m]; 0 for what must not be touched.
        covariance: Covariance of its position [m^2]; None where `sigma` says it all.
    """

    if TYPE_CHECKING:  # fields of all, where they stand in the order of the file's keys, which digests have
        name: Name
        sigma: Sigma
    track: TrackField = None
    sway: SwayField = None
    yields: YieldsField = 0.0
    covariance: CovarianceField = None

    @model_validator(mode="after")
    def _one_error(self) -> Self:
        """Where a covariance is given, `sigma` is what it has in its worst direction."""
        if self.covariance is not None:
            largest = largest_deviation(np.array(self.covariance))
            # Turned rows have the same deviation but for rounding.
            if self.sigma != 0.0 and not math.isclose(self.sigma, largest, rel_tol=1e-9):
                raise fault("sigma and covariance exclude one another", "covariance")
            vars(self)["sigma"] = largest
        return self

    @property
    def place_covariance(self) -> FloatArray:
        """(3, 3) covariance of its place [m^2]."""
        return self.sigma**2 * np.eye(3) if self.covariance is None else np.array(self.covariance)


class Kind(Item):
    """Base of all obstacles."""


class Turned(Kind):
    """An obstacle that is turned by roll, pitch and yaw (fixed axes x, y, z)."""

    if TYPE_CHECKING:
        rpy_deg: Angles  # a field of all kinds below, where it stands in the order of the file's keys

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the obstacle's own frame to `base_link`."""
        return _rotation(self.rpy_deg)


@lru_cache(maxsize=4096)
def _rotation(rpy_deg: tuple[float, float, float]) -> FloatArray:
    return readonly(rpy_rotation(*map(math.radians, rpy_deg)))


class Convex(Kind):
    """One convex solid: the hull of its core grown by its rounding."""

    is_point_set: ClassVar[Literal[False]] = False

    @property
    def core(self) -> FloatArray:
        """(k, 3) points; the obstacle is, or lies in, their hull grown by `rounding`."""
        raise NotImplementedError(f"{type(self).__name__} does not say of which points it is the hull")

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return 0.0

    @property
    def excess(self) -> float:
        """How far the grown hull of its core stands out of it [m]."""
        return 0.0

    @property
    def hull(self) -> Hull:
        """The hull of its core, with its facets: what kernels, coal and MuJoCo take that have no shape of its kind."""
        return _hull_of(self)

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """(n, 3) vertices [m] and (m, 3) triangles of a surface about it, to be drawn."""
        return self.hull.surface

    @property
    def solids(self) -> tuple[Solid, ...]:
        """The obstacle itself, for it is convex, or what it sweeps as it sways."""
        return (self,) if self.sway is None else (_swept_convex(self),)

    def swept(self, reach: FloatArray) -> Solid:
        """A solid that holds all that it sweeps when it is shifted by up to (3,) `reach` [m] to either side."""
        return _swept_core(self, reach)


@lru_cache(maxsize=4096)
def _hull_of(obstacle: Convex) -> Hull:
    return whole_hull(obstacle.core, obstacle.name, obstacle.rounding, obstacle.sigma)


class FromData(Turned):
    """An obstacle whose shape is in a file or in arrays, placed by a rotation and a shift."""

    _data: Any = PrivateAttr(None)
    _path: Path | None = PrivateAttr(None)

    @property
    def path(self) -> Path | None:
        """Absolute path of its file, or None if it was made of arrays."""
        return self._path

    @property
    def data_digest(self) -> str:
        """SHA-256 of its data before scale, turn and shift, in hexadecimal digits; made once."""
        return str(self._data.digest)

    def _context(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """A copy from the same file has the same data."""
        kept = values.get("file") == vars(self).get("file")
        return {"kept": (self._data, self._path)} if kept else {}

    def _swept(self, solids: tuple[Solid, ...]) -> tuple[Solid, ...]:
        """What its solids sweep as it sways."""
        if self.sway is None:
            return solids
        return tuple(swept(solid, self.sway.reach) for solid in solids)

    def write(self, path: Path) -> Path:
        """Write its data as a PLY file, before scale, turn and shift.

        Raises:
            OutputError: The file cannot be written.
        """
        from hplan.scene.shape_data import write_shape

        return write_shape(self._data, path)


#: A body that the planner keeps clear of: the hull of `core` grown by `rounding`; of a point set a ball about each
#: core point; of a cylinder the hull holds it.
Solid: TypeAlias = Convex | Hull | Cloud


@lru_cache(maxsize=_KEPT)
def _swept_convex(obstacle: Convex) -> Solid:
    """What a convex obstacle that sways sweeps; a cylinder as the prism about it."""
    return obstacle if obstacle.sway is None else obstacle.swept(obstacle.sway.reach)


def swept(solid: Solid, reach: FloatArray) -> Solid:
    """A solid that holds all that another sweeps when it is shifted by up to (3,) `reach` [m] to either side."""
    if isinstance(solid, Cloud):
        return _swept_cloud(solid, reach)
    return solid.swept(reach) if isinstance(solid, Convex) else _swept_core(solid, reach)


def _swept_core(solid: Convex | Hull, reach: FloatArray) -> Hull:
    """The hull of what the core sweeps, grown as the core is."""
    core = np.concatenate([solid.core - reach, solid.core + reach])
    points = (core + thickening(core)[:, None]).reshape(-1, 3)
    hull = hull_of(points, solid.name)
    return replace(hull, rounding=hull.rounding + solid.rounding, sigma=solid.sigma, yields=solid.yields)


def _swept_cloud(cloud: Cloud, reach: FloatArray) -> Cloud:
    radius, length = cloud.rounding, 2.0 * float(np.linalg.norm(reach))
    # Balls at a distance of this along the segment, grown, cover the capsule between them.
    spacing = 2.0 * math.sqrt((radius + SWEPT_ERROR) ** 2 - radius**2)
    copies = min(max(2, math.ceil(length / spacing) + 1), max(2, MOST_POINTS // len(cloud.core)))
    shifts = np.linspace(-1.0, 1.0, copies)[:, None] * reach
    grown = math.hypot(radius, 0.5 * length / (copies - 1))
    points = (cloud.core + shifts[:, None]).reshape(-1, 3)
    return replace(Cloud.of(cloud.name, points, grown, cloud.sigma), yields=cloud.yields)


def growths(solids: Sequence[Solid], sigmas: Sigmas) -> FloatArray:
    """(solids,) by how much each grows for its uncertainty [m]."""
    if isinstance(sigmas, Mapping):
        return np.array([sigmas.get(solid.name, 0.0) * solid.sigma for solid in solids], dtype=np.float64)
    return np.array([sigmas * solid.sigma for solid in solids], dtype=np.float64)


def posed(solid: Solid, rotation: FloatArray, shift: FloatArray) -> Solid:
    """The solid with each of its points x at `rotation @ x + shift`.

    Args:
        rotation: (3, 3) rotation.
        shift: (3,) shift [m].
    """
    if not isinstance(solid, Hull | Cloud):
        return solid.copy_unchecked(moved(solid, rotation, shift))
    if isinstance(solid, Hull):
        return solid.placed(rotation, shift)
    tree = solid.tree.copy()
    tree[:, 3:6] = tree[:, 3:6] @ rotation.T + shift
    core = np.ascontiguousarray(solid.core @ rotation.T + shift)
    return replace(solid, core=frozen(core), tree=frozen(tree))


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
    if item.covariance is not None:
        found["covariance"] = turned_covariance(item.covariance, rotation)
    if item.sway is not None:
        turned = tuple((rotation @ item.sway.reach).tolist())
        found["sway"] = item.sway.copy_unchecked({"direction": turned})
    return found


def turned_covariance(
    covariance: tuple[Vector, Vector, Vector], rotation: FloatArray
) -> tuple[tuple[float, float, float], ...]:
    """Rows of a covariance in axes that a (3, 3) rotation has turned."""
    rows = rotation @ np.array(covariance) @ rotation.T
    return tuple((x, y, z) for x, y, z in (0.5 * (rows + rows.T)).tolist())
