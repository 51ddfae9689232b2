"""What every kind of obstacle is made of, and what it says of itself.

A new kind is a class on these bases in a file of its own, and its row in `hplan.scene.obstacles`. A convex one says
which points it is the hull of (`core`) and by how much they are grown (`rounding`); all else that kernels, certificate,
pages and messages ask (`hull`, `surface`, `excess`) follows, unless the kind knows better.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import Field, PrivateAttr

from hplan.base.arrays import FloatArray, IntArray
from hplan.scene.fault import StrictModel
from hplan.scene.limits import FARTHEST_M, Angles
from hplan.scene.solids import Hull, rpy_rotation, whole_hull
from hplan.scene.tracks import Sway, Track

if TYPE_CHECKING:
    from hplan.scene.obstacles import Solid

Name: TypeAlias = Annotated[str, Field(min_length=1)]
Sigma: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]

#: How an obstacle moves. In dumps these keys are added where there are any: a still scene has the digest it had.
TrackField: TypeAlias = Annotated[Track | None, Field(exclude=True)]
SwayField: TypeAlias = Annotated[Sway | None, Field(exclude=True)]


class Kind(StrictModel):
    """Base of all obstacles.

    Attributes of every kind:
        name: Name of the obstacle.
        sigma: Standard deviation of its position [m].
        track: How it moves; None for an obstacle that stands still.
        sway: How far it may swing out of its place; None for not at all.
    """

    if TYPE_CHECKING:  # fields of all kinds, where they stand in the order of the file's keys
        name: Name
        sigma: Sigma
        track: TrackField
        sway: SwayField


class Turned(Kind):
    """An obstacle that is turned by roll, pitch and yaw (fixed axes x, y, z)."""

    if TYPE_CHECKING:
        rpy_deg: Angles  # a field of all kinds below, where it stands in the order of the file's keys

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the obstacle's own frame to `base_link`."""
        return rpy_rotation(*map(math.radians, self.rpy_deg))


class Convex(Kind):
    """One convex solid: the hull of its core grown by its rounding."""

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
    def is_point_set(self) -> Literal[False]:
        """False: the solid is the hull of its core grown by its rounding."""
        return False

    @property
    def solids(self) -> tuple[Solid, ...]:
        """The obstacle itself, for it is convex, or what it sweeps as it sways."""
        if self.sway is None:
            return (self,)
        from hplan.scene.solids import swept_convex

        return (swept_convex(self),)


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

    def _swept(self, solids: tuple[Solid, ...]) -> tuple[Solid, ...]:
        """What its solids sweep as it sways."""
        if self.sway is None:
            return solids
        from hplan.scene.solids import swept

        return tuple(swept(solid, self.sway.reach) for solid in solids)

    def write(self, path: Path) -> Path:
        """Write its data as a PLY file, before scale, turn and shift.

        Raises:
            OutputError: The file cannot be written.
        """
        from hplan.scene.shape_data import write_shape

        return write_shape(self._data, path)
