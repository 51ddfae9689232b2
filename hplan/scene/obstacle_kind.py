r"""Base classes of obstacles and their common fields.

A new kind is a class on these bases in a file of its own, and an entry in `hplan.scene.obstacles`. A convex kind
defines the points of its hull (`core`) and their radius (`rounding`); kernels, certificate, pages and messages derive
the rest (`hull`, `surface`, `excess`) from these, unless the kind overrides it.

**Swept solids.** Let a solid be the hull of a core :math:`C` grown by a rounding. Shifted by all of :math:`[-a, a]`, it
sweeps the hull of :math:`C - a` and :math:`C + a` grown by the same rounding: a ball becomes a capsule, any other solid
a hull. This is exact, except that a flat hull is thickened by `hplan.geometry.hull.THIN`, and a hull with many vertices
is simplified as for a mesh. A cloud becomes a cloud of copies along the segment, dense enough that balls with a radius
larger by `SWEPT_ERROR` cover the swept balls; if that needs too many points, fewer copies of larger balls.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from hplan.base.arrays import FloatArray, IntArray, frozen, readonly
from hplan.base.checked import StrictModel, fault
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import Hull, hull_of, thickening_shifts, whole_hull
from hplan.geometry.rotation import rpy_of, rpy_rotation
from hplan.scene.limits import FARTHEST_M, MOST_POINTS, Angles, Vector
from hplan.scene.tracks import Sway, Track

Name: TypeAlias = Annotated[str, Field(min_length=1)]
Sigma: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]


def to_tuple(names: Any) -> Any:
    """Convert a single name to a tuple."""
    return (names,) if isinstance(names, str) else names


#: Growth of obstacles in standard deviations: one number for all, or one by name (0 for unnamed ones).
Sigmas: TypeAlias = float | Mapping[str, float]


def _symmetric(rows: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    """Check the rows of a covariance matrix."""
    matrix = np.array(rows)
    size = float(np.abs(matrix).max())
    if not np.abs(matrix - matrix.T).max() <= 1e-9 * size or np.linalg.eigvalsh(matrix).min() < -1e-9 * size:
        raise ValueError("expected a covariance matrix: symmetric, without negative eigenvalues")
    return rows


#: Position covariance in `base_link` [m^2]; in dumps only if given.
CovarianceField: TypeAlias = Annotated[
    tuple[Vector, Vector, Vector] | None,
    AfterValidator(lambda rows: rows if rows is None else _symmetric(rows)),
    Field(exclude=True),
]


def largest_deviation(covariance: FloatArray) -> float:
    """Standard deviation along the principal axis of a (3, 3) covariance [m]."""
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance)[-1])))


#: Maximum growth of the balls of a swaying cloud, unless there are too many balls [m].
SWEPT_ERROR: Final = 1e-3

#: Cache size of swept solids.
_KEPT: Final = 4096

#: Motion of an obstacle. Dumps have these keys only if given, so static scenes keep the digest of earlier versions.
TrackField: TypeAlias = Annotated[Track | None, Field(exclude=True)]
SwayField: TypeAlias = Annotated[Sway | None, Field(exclude=True)]

#: Maximum deflection of an obstacle [m]; in dumps only if nonzero.
YieldsField: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M, exclude=True)]


class Item(StrictModel):
    """Base of obstacles and fruit: the fields besides the shape.

    Attributes:
        name: Name.
        sigma: Standard deviation of each coordinate of its position; with a covariance, along its principal axis [m].
        track: Motion; None for a static obstacle.
        sway: Oscillation; None for a fixed obstacle.
        yields: Maximum deflection (depth of penetration) by the links that may deflect it [m]; 0 for a rigid obstacle.
        covariance: Covariance of its position [m^2]; None for the isotropic `sigma`.
    """

    if TYPE_CHECKING:  # declared by each subclass: digests depend on the order of the keys
        name: Name
        sigma: Sigma
    track: TrackField = None
    sway: SwayField = None
    yields: YieldsField = 0.0
    covariance: CovarianceField = None

    @model_validator(mode="after")
    def _one_error(self) -> Self:
        """Set `sigma` to the largest deviation of a given covariance."""
        if self.covariance is not None:
            largest = largest_deviation(np.array(self.covariance))
            # A rotated covariance has the same deviation up to rounding.
            if self.sigma != 0.0 and not math.isclose(self.sigma, largest, rel_tol=1e-9):
                raise fault("sigma and covariance exclude each other", "covariance")
            vars(self)["sigma"] = largest
        return self

    @property
    def is_static(self) -> bool:
        """True if it neither moves nor sways."""
        return self.track is None and self.sway is None

    @property
    def place_covariance(self) -> FloatArray:
        """(3, 3) covariance of its position [m^2]."""
        return self.sigma**2 * np.eye(3) if self.covariance is None else np.array(self.covariance)


class Kind(Item):
    """Base of all obstacles."""


class Turned(Kind):
    """An obstacle rotated by roll, pitch, yaw (fixed axes x, y, z)."""

    if TYPE_CHECKING:
        rpy_deg: Angles  # declared by each subclass: digests depend on the order of the keys

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the obstacle's own frame to `base_link`."""
        return _rotation(self.rpy_deg)


@lru_cache(maxsize=4096)
def _rotation(rpy_deg: tuple[float, float, float]) -> FloatArray:
    return readonly(rpy_rotation(*map(math.radians, rpy_deg)))


class Hanging(Protocol):
    """Point that a fruit hangs from (`hplan.scene.hanging_point`)."""

    def displacement_by_work(self, of_wood: float, others: float) -> float:
        """Upper bound of the displacement of the fruit itself by some work [m]."""


class ContactLimit(NamedTuple):
    """What the deepest permitted contact does to a limb or a fruit, and what is allowed (`hplan.scene.limb_contacts`).

    Static force and stress of a smaller depth are at most in proportion.

    Attributes:
        depth: Permitted depth [m].
        force: Static force at this depth [N].
        stress: Largest static bending stress of the limb at this depth [Pa].
        segment: Number of the limb segment, or of the one that a fruit hangs from.
        root: Number of the first bending segment on its path from the clamp; -1 for a fruit on wood that does not bend.
        along: First and last point of the part on the segment's axis, from its start [m].
        impact: Force of an impact per speed of the link [N s/m].
        impact_stress: Bending stress of an impact per speed of the link [Pa s/m].
        swing: Force on a stalk per squared speed of the link [N s^2/m^2].
        rate: Angular frequency of limb or fruit on the spring of the contact [rad/s]: a contact of the depth d does not
            accelerate it beyond the speed rate d.
        most_force: Allowed force [N].
        most_stress: Allowed bending stress [Pa].
        displacement: For a fruit the point that it hangs from, which is displaced by other contacts; None for limbs.
        decay_rate: Minimum rate at which a fruit comes to rest after its limb was displaced, or for a part of a limb
            all fruit on limbs with its root [1/s]; infinite without fruit.
        capture_range: Allowed displacement of a fruit that is grasped [m].
        pressed: The part of `force` by neighbours that limb or fruit is pressed against [N].
        mass: Mass of a fruit [kg]; 0 for limbs.
        roots: Roots, as `root`, of other limbs that limb or fruit is pressed against.
        fruits: Names of fruit that limb or fruit is pressed against.
    """

    depth: float
    force: float
    stress: float
    segment: int
    root: int
    along: tuple[float, float]
    impact: float
    impact_stress: float
    swing: float
    rate: float
    most_force: float
    most_stress: float
    displacement: Hanging | None
    decay_rate: float
    capture_range: float
    pressed: float
    mass: float
    roots: frozenset[int] = frozenset()
    fruits: frozenset[str] = frozenset()


#: Links that a solid counts for: all, those that may push compliant obstacles, or the others.
Meets: TypeAlias = Literal["all", "pushing", "others"]


class Convex(Kind):
    """One convex solid: the hull of its core grown by its rounding."""

    is_point_set: ClassVar[Literal[False]] = False
    _meets: Meets = PrivateAttr("all")
    _contact_limit: ContactLimit | None = PrivateAttr(None)

    @property
    def meets(self) -> Meets:
        """Links that the solid counts for."""
        return self._meets

    @property
    def contact_limit(self) -> ContactLimit | None:
        """What the deepest permitted contact does; None for a solid that is no part of a limb or hanging fruit."""
        return self._contact_limit

    @property
    def is_limb(self) -> bool:
        """True for solids of limbs and hanging fruit, whose depths follow from forces."""
        return self._meets != "all" or self._contact_limit is not None

    def met_by(self, meets: Meets, limit: ContactLimit | None = None) -> Self:
        """Copy of the solid that counts for some links only."""
        found = self.copy_unchecked({})
        found._meets, found._contact_limit = meets, limit
        return found

    @property
    def core(self) -> FloatArray:
        """(k, 3) core points [m].

        The obstacle is their hull grown by `rounding`, or lies in it.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define its hull points")

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return 0.0

    @property
    def excess(self) -> float:
        """Maximum distance of the grown hull's points from the obstacle [m]."""
        return 0.0

    @property
    def hull(self) -> Hull:
        """Hull of its core, with facets.

        It represents the obstacle in kernels, coal and MuJoCo if they have no primitive of its kind.
        """
        return _hull_of(self)

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """Surface to draw: (n, 3) vertices [m] and (m, 3) triangles."""
        return self.hull.surface

    @property
    def solids(self) -> tuple[Solid, ...]:
        """The obstacle itself, or its swept volume if it sways."""
        return (self,) if self.sway is None else (_swept_convex(self),)

    def swept(self, reach: FloatArray) -> Solid:
        """Return a solid that contains the volume swept by shifts.

        Args:
            reach: (3,) maximum shift to either side [m].
        """
        return _swept_core(self, reach)


@lru_cache(maxsize=4096)
def _hull_of(obstacle: Convex) -> Hull:
    return whole_hull(obstacle.core, obstacle.name, obstacle.rounding, obstacle.sigma)


class FromData(Turned):
    """An obstacle with a shape from a file or arrays.

    It is placed by a rotation and a shift.
    """

    _data: Any = PrivateAttr(None)
    _path: Path | None = PrivateAttr(None)

    @property
    def path(self) -> Path | None:
        """Absolute path of its file; None if made of arrays."""
        return self._path

    @property
    def data_digest(self) -> str:
        """SHA-256 of its data before placement, as hexadecimal digits; cached."""
        return str(self._data.digest)

    def _context(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Reuse the data in a copy from the same file."""
        kept = values.get("file") == vars(self).get("file")
        return {"kept": (self._data, self._path)} if kept else {}

    def _swept(self, solids: tuple[Solid, ...]) -> tuple[Solid, ...]:
        """Swept volumes of its solids if it sways."""
        if self.sway is None:
            return solids
        return tuple(swept(solid, self.sway.reach) for solid in solids)

    def write(self, path: Path) -> Path:
        """Write its data as a PLY file, before placement.

        Raises:
            OutputError: The file cannot be written.
        """
        from hplan.scene.shape_data import write_shape

        return write_shape(self._data, path)


#: A solid that the planner avoids: the hull of `core` grown by `rounding`; if `is_point_set`, a ball about each core
#: point; for a cylinder the hull contains it.
Solid: TypeAlias = Convex | Hull | Cloud


@lru_cache(maxsize=_KEPT)
def _swept_convex(obstacle: Convex) -> Solid:
    """Swept volume of a swaying convex obstacle.

    A cylinder counts as its circumscribed prism.
    """
    return obstacle if obstacle.sway is None else obstacle.swept(obstacle.sway.reach)


def swept(solid: Solid, reach: FloatArray) -> Solid:
    """Return a solid that contains the volume swept by shifts.

    Args:
        solid: The solid.
        reach: (3,) maximum shift to either side [m].
    """
    if isinstance(solid, Cloud):
        return _swept_cloud(solid, reach)
    return solid.swept(reach) if isinstance(solid, Convex) else _swept_core(solid, reach)


def _swept_core(solid: Convex | Hull, reach: FloatArray) -> Hull:
    """Hull of the swept core, with the rounding of the core."""
    core = np.concatenate([solid.core - reach, solid.core + reach])
    points = (core + thickening_shifts(core)[:, None]).reshape(-1, 3)
    hull = hull_of(points, solid.name)
    return replace(hull, rounding=hull.rounding + solid.rounding, sigma=solid.sigma, yields=solid.yields)


def _swept_cloud(cloud: Cloud, reach: FloatArray) -> Cloud:
    radius, length = cloud.rounding, 2.0 * float(np.linalg.norm(reach))
    # Grown balls with this spacing along the segment cover the capsule between them.
    spacing = 2.0 * math.sqrt((radius + SWEPT_ERROR) ** 2 - radius**2)
    copies = min(max(2, math.ceil(length / spacing) + 1), max(2, MOST_POINTS // len(cloud.core)))
    shifts = np.linspace(-1.0, 1.0, copies)[:, None] * reach
    grown = math.hypot(radius, 0.5 * length / (copies - 1))
    points = (cloud.core + shifts[:, None]).reshape(-1, 3)
    return replace(Cloud.from_points(cloud.name, points, grown, cloud.sigma), yields=cloud.yields)


def growths(solids: Sequence[Solid], sigmas: Sigmas) -> FloatArray:
    """(solids,) growth of each solid for its position uncertainty [m]."""
    if isinstance(sigmas, Mapping):
        return np.array([sigmas.get(solid.name, 0.0) * solid.sigma for solid in solids], dtype=np.float64)
    return np.array([sigmas * solid.sigma for solid in solids], dtype=np.float64)


def transform_solid(solid: Solid, rotation: FloatArray, shift: FloatArray) -> Solid:
    """Transform a solid.

    Each point x moves to `rotation @ x + shift`.

    Args:
        solid: The solid.
        rotation: (3, 3) rotation.
        shift: (3,) shift [m].
    """
    if not isinstance(solid, Hull | Cloud):
        return solid.copy_unchecked(transform_fields(solid, rotation, shift))
    if isinstance(solid, Hull):
        return solid.transform(rotation, shift)
    tree = solid.tree.copy()
    tree[:, 3:6] = tree[:, 3:6] @ rotation.T + shift
    core = np.ascontiguousarray(solid.core @ rotation.T + shift)
    return replace(solid, core=frozen(core), tree=frozen(tree))


def transform_fields(item: Any, rotation: FloatArray, shift: FloatArray) -> dict[str, Any]:
    """Return the changed fields of a transformed obstacle or fruit.

    Each point x moves to `rotation @ x + shift`. The result has no track.
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
    """Rows of a covariance rotated by a (3, 3) matrix."""
    rows = rotation @ np.array(covariance) @ rotation.T
    return tuple((x, y, z) for x, y, z in (0.5 * (rows + rows.T)).tolist())
