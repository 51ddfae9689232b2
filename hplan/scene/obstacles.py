"""Obstacles of a scene: primitives, meshes, point clouds, and their convex solids.

Positions are in `base_link`, z up, in metres. The classes are also the schema of the scene file (`hplan.scene.file`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PositiveFloat, ValidationError, ValidationInfo, model_validator

from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.base.checked import fault, scene_error, validate_part
from hplan.base.files import ByteBudget
from hplan.errors import SceneError
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import CUBE_CORNERS, Hull
from hplan.geometry.prism import prism, prism_excess
from hplan.geometry.rotation import rpy_rotation
from hplan.scene.limits import FARTHEST_M, MOST_SHAPE_BYTES, Angles, Size, Vector
from hplan.scene.obstacle_kind import (
    Convex,
    FromData,
    Name,
    Sigma,
    Turned,
)
from hplan.scene.obstacle_kind import Solid as Solid  # a name of this module too

if TYPE_CHECKING:
    from hplan.scene.shape_data import PointSet, Surface

_Data = TypeVar("_Data", "Mesh", "PointCloud")
_Shape = TypeVar("_Shape", "Surface", "PointSet")


class Sphere(Convex):
    """A ball.

    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        center: Centre [m].
        radius: Radius [m].
        sigma: Standard deviation of each coordinate of its position [m].

    Examples:
        >>> from hplan.scene import Sphere
        >>> apple = Sphere(name="apple", center=(1.0, 0.0, 1.5), radius=0.04)
        >>> apple.core.tolist(), apple.rounding
        ([[1.0, 0.0, 1.5]], 0.04)
    """

    kind: Literal["sphere"] = "sphere"
    name: Name
    center: Vector
    radius: Size
    sigma: Sigma = 0.0

    @property
    def core(self) -> FloatArray:
        """(1, 3) points; the obstacle is their hull grown by `rounding`."""
        return readonly([self.center])

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return self.radius

    def swept(self, reach: FloatArray) -> Solid:
        """Capsule swept by shifts from -`reach` to `reach`, (3,) [m]."""
        start, end = (tuple((self.core[0] + shift).tolist()) for shift in (-reach, reach))
        return Capsule(name=self.name, start=start, end=end, radius=self.radius, sigma=self.sigma, yields=self.yields)


class Capsule(Convex):
    """A segment with a radius: branch, wire, trunk.

    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        start: First end of the axis; key `from` in files [m].
        end: Second end of the axis; key `to` in files [m].
        radius: Radius [m].
        sigma: Standard deviation of each coordinate of its position [m].
        parent: Name of the capsule that it grows from, for a limb of a tree (`hplan.scene.limbs`); None for a root, and
            for what is no limb.

    Examples:
        >>> from hplan.scene import Capsule
        >>> branch = Capsule(name="branch 1", start=(1.0, 0.0, 1.5), end=(1.3, 0.2, 1.6), radius=0.01)
        >>> branch.core.shape, branch.rounding
        ((2, 3), 0.01)
    """

    kind: Literal["capsule"] = "capsule"
    name: Name
    start: Vector = Field(validation_alias="from", serialization_alias="from")
    end: Vector = Field(validation_alias="to", serialization_alias="to")
    radius: Size
    sigma: Sigma = 0.0
    parent: Annotated[Name | None, Field(exclude=True)] = None

    @property
    def core(self) -> FloatArray:
        """(2, 3) points; the obstacle is their hull grown by `rounding`."""
        return readonly([self.start, self.end])

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return self.radius


class Cylinder(Turned, Convex):
    """A cylinder with flat ends, its axis along z before rotation.

    The certificate and MuJoCo use the exact cylinder, kernels and sections a circumscribed `hplan.geometry.prism`.
    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        center: Centre [m].
        length: Length along the axis [m].
        radius: Radius [m].
        rpy_deg: Rotation by roll, pitch and yaw about the fixed axes x, y, z [deg].
        sigma: Standard deviation of each coordinate of its position [m].

    Examples:
        >>> from hplan.scene import Cylinder
        >>> post = Cylinder(name="post", center=(1.0, 0.0, 1.0), length=2.0, radius=0.05)
        >>> 0.0 < post.excess < 0.001
        True
    """

    kind: Literal["cylinder"] = "cylinder"
    name: Name
    center: Vector
    length: Size
    radius: Size
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @property
    def hull(self) -> Hull:
        """The circumscribed prism."""
        return prism(self.center, self.rpy_deg, self.length, self.radius)

    @property
    def core(self) -> FloatArray:
        """(k, 3) corners of the circumscribed prism; their hull contains the obstacle."""
        return self.hull.core

    @property
    def excess(self) -> float:
        """Maximum distance of a point of the prism from the cylinder [m]."""
        return prism_excess(self.radius)


class Box(Turned, Convex):
    """A box with full edge lengths.

    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        center: Centre [m].
        size: Edge lengths along its own x, y, z axes [m].
        rpy_deg: Rotation by roll, pitch and yaw about the fixed axes x, y, z [deg].
        sigma: Standard deviation of each coordinate of its position [m].

    Examples:
        >>> from hplan.scene import Box
        >>> ground = Box(name="ground", center=(0.0, 0.0, -0.05), size=(6.0, 6.0, 0.1))
        >>> ground.core.max(axis=0).tolist()
        [3.0, 3.0, 0.0]
    """

    kind: Literal["box"] = "box"
    name: Name
    center: Vector
    size: tuple[Size, Size, Size]
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @property
    def core(self) -> FloatArray:
        """(8, 3) corners; the obstacle is their hull."""
        return _box_corners(self.center, self.size, self.rpy_deg)


@lru_cache(maxsize=4096)
def _box_corners(center: Vector, size: Vector, rpy_deg: Vector) -> FloatArray:
    rotation = rpy_rotation(*map(math.radians, rpy_deg))
    return readonly(np.array(center) + (0.5 * CUBE_CORNERS * np.array(size)) @ rotation.T)


class Mesh(FromData):
    """The solid inside a closed surface, from a file or arrays (`Mesh.from_arrays`).

    The surface is scaled, then rotated by roll, pitch and yaw about the fixed axes x, y, z, then shifted.
    `track`, `sway`, `yields` and `covariance` are described in `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        file: STL, PLY, OBJ or OFF file; a relative path is relative to the scene file's folder, without a scene file to
            the working directory. None for a mesh from arrays.
        position: Shift [m].
        rpy_deg: Rotation [deg].
        scale: Scale factor, for example 0.001 for a file in millimetres.
        sigma: Standard deviation of each coordinate of its position [m].

    Examples:
        >>> from hplan.scene import Mesh
        >>> corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
        >>> faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        >>> crate = Mesh.from_arrays("crate", corners, faces, position=(1.0, 0.0, 0.0), scale=0.5)
        >>> len(crate.solids), crate.excess
        (1, 0.0)
    """

    kind: Literal["mesh"] = "mesh"
    name: Name
    file: Name | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    scale: PositiveFloat = 1.0
    sigma: Sigma = 0.0

    @classmethod
    def from_arrays(cls, name: str, vertices: ArrayLike, faces: ArrayLike, **placement: Any) -> Mesh:
        """Return a mesh from arrays.

        Args:
            name: Name of the obstacle.
            vertices: (n, 3) vertices before `scale` [m].
            faces: (m, 3) vertex indices of the triangles, counter-clockwise as seen from outside.
            placement: `position`, `rpy_deg`, `scale`, `sigma`, `covariance`, `yields`.

        Raises:
            SceneError: The mesh is empty, not finite, open, flat or inside out.
        """
        from hplan.scene.shape_data import Surface

        return _made_of(cls, name, lambda: Surface.from_arrays(vertices, faces), placement)

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Mesh:
        from hplan.scene.shape_data import read_surface

        if self._data is not None:  # an existing obstacle is added to a scene
            return self
        self._data, self._path = _shape_data(self.file, read_surface, info)
        span = float(np.ptp(self._data.vertices, axis=0).max()) * self.scale
        farthest = float(np.abs(self._data.vertices).max()) * self.scale
        below = "file" if self.file else "name"
        if not 1e-4 <= span <= FARTHEST_M:
            raise fault(f"the mesh is {span:.3g} m across; expected 0.1 mm to 10 km: check its scale", below)
        if not farthest <= FARTHEST_M:
            raise fault(f"the mesh has coordinates of {farthest:.3g} m; expected at most 10 km: check its scale", below)
        return self

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """(n, 3) vertices in `base_link` [m] and (m, 3) triangles."""
        return self._data.vertices * self.scale @ self.rotation.T + np.array(self.position), self._data.faces

    @property
    def excess(self) -> float:
        """Maximum distance of a point of the solids from the mesh [m].

        The solids contain the mesh (`convex_decomposition`).
        """
        return float(self._data.pieces(self.scale).excess)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """Convex parts whose union contains the mesh."""
        key = (self.name, self.scale, self.position, self.rpy_deg, self.sigma, self.sway, self.yields)
        hulls: tuple[Solid, ...] = self._data.cache(key, self._hulls)
        return hulls

    def _hulls(self) -> tuple[Solid, ...]:
        place, own = (self.rotation, np.array(self.position)), {"name": self.name, "sigma": self.sigma}
        hulls = self._data.pieces(self.scale).hulls
        return self._swept(tuple(hull.transform(*place, yields=self.yields, **own) for hull in hulls))


class PointCloud(FromData):
    """Balls of one radius about points, from a file or an array.

    The points are placed as a `Mesh` is, without scale. `track`, `sway`, `yields` and `covariance` are described in
    `hplan.scene.obstacle_kind.Item`.

    Attributes:
        name: Name of the obstacle.
        file: PLY or XYZ file, its path as for a `Mesh`; None for a cloud from an array (`PointCloud.of`).
        radius: Radius of every ball [m].
        position: Shift [m].
        rpy_deg: Rotation [deg].
        sigma: Standard deviation of each coordinate of its position [m].

    Examples:
        >>> from hplan.scene import PointCloud
        >>> points = [(1.0, 0.0, 1.5), (1.0, 0.1, 1.5)]
        >>> cloud = PointCloud.from_points("canopy", points, radius=0.02, position=(0.0, 0.0, 0.5))
        >>> cloud.points.tolist()
        [[1.0, 0.0, 2.0], [1.0, 0.1, 2.0]]
    """

    kind: Literal["points"] = "points"
    name: Name
    file: Name | None = None
    radius: Size
    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @classmethod
    def from_points(cls, name: str, points: ArrayLike, radius: float, **placement: Any) -> PointCloud:
        """Return a cloud from an array.

        Args:
            name: Name of the obstacle.
            points: (n, 3) centres of the balls [m].
            radius: Radius of every ball [m].
            placement: `position`, `rpy_deg`, `sigma`, `covariance`, `yields`.

        Raises:
            SceneError: The cloud is empty, too large or not finite.
        """
        from hplan.scene.shape_data import PointSet

        return _made_of(cls, name, lambda: PointSet.from_points(points), {"radius": radius, **placement})

    @classmethod
    def from_thinned(cls, name: str, points: ArrayLike, radius: float, yields: float = 0.0) -> PointCloud:
        """Return a cloud of (n, 3) already thinned points, without merging (`hplan.online`).

        Raises:
            SceneError: The cloud is empty, too large or not finite.
        """
        from hplan.scene.shape_data import PointSet

        return _made_of(
            cls, name, lambda: PointSet.from_points(points, may_merge=False), {"radius": radius, "yields": yields}
        )

    @property
    def left_out(self) -> int:
        """Number of rows of the file with a non-finite value."""
        return int(self._data.left_out)

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> PointCloud:
        from hplan.scene.shape_data import read_points

        if self._data is not None:  # an existing obstacle is added to a scene
            return self
        self._data, self._path = _shape_data(self.file, read_points, info)
        return self

    @property
    def points(self) -> FloatArray:
        """(n, 3) centres of all balls in `base_link` before merging [m]."""
        points: FloatArray = self._data.points
        if any((*self.position, *self.rpy_deg)):  # the product takes as long as the tree
            points = points @ self.rotation.T + np.array(self.position)
        return points

    @property
    def solids(self) -> tuple[Solid, ...]:
        """One cloud of balls."""
        key = (self.name, self.radius, self.position, self.rpy_deg, self.sigma, self.sway, self.yields)
        cloud: Solid = self._data.cache(key, self._cloud)
        return (cloud,)

    def _cloud(self) -> Solid:
        make = Cloud.from_points if self._data.may_merge else Cloud.from_all_points
        cloud = make(self.name, self.points, self.radius, self.sigma)
        return self._swept((replace(cloud, yields=self.yields),))[0]


def _made_of(cls: type[_Data], name: str, make: Callable[[], Surface | PointSet], fields: dict[str, Any]) -> _Data:
    """Make an obstacle from data in memory."""
    try:
        data = make()
        return validate_part(cls, {"name": name, **fields}, {"data": data})
    except ValidationError as error:
        raise scene_error(error) from error
    except ValueError as error:
        raise SceneError(str(error), where=name) from error


def _shape_data(
    file: str | None, read: Callable[[Path, ByteBudget], _Shape], info: ValidationInfo
) -> tuple[_Shape, Path | None]:
    """Return the data of a mesh or cloud, and its file."""
    context = info.context or {}
    if "kept" in context:
        kept: tuple[_Shape, Path | None] = context["kept"]
        return kept
    if file is None:
        if context.get("data") is None:
            raise fault("this key is missing", "file")
        return context["data"], None
    path = Path(context.get("folder", "")) / file
    try:
        return read(path, context.get("budget") or ByteBudget(MOST_SHAPE_BYTES)), path.absolute()
    except ValueError as error:
        raise fault(str(error), "file") from error


#: The kinds of obstacles of a scene: a new kind is its class and its name here.
AnyObstacle: TypeAlias = Sphere | Capsule | Cylinder | Box | Mesh | PointCloud
Obstacle: TypeAlias = Annotated[AnyObstacle, Field(discriminator="kind")]
KINDS: tuple[type[AnyObstacle], ...] = get_args(AnyObstacle)
