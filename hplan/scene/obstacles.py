"""Obstacles of a scene: spheres, capsules, cylinders, boxes, meshes, point clouds, and the convex solids they become.

Positions are in `base_link`, z up, in metres. The classes are the scene file's schema too (`hplan.scene.file`).
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
from hplan.base.files import ByteBudget
from hplan.errors import SceneError
from hplan.scene.fault import fault, scene_error, validated
from hplan.scene.limits import FARTHEST_M, MOST_SHAPE_BYTES, Angles, Size, Vector
from hplan.scene.obstacle_kind import (
    Convex,
    FromData,
    Name,
    Sigma,
    Turned,
)
from hplan.scene.obstacle_kind import Solid as Solid  # a name of this module too
from hplan.scene.prism import prism, prism_excess
from hplan.scene.solids import CUBE_CORNERS, Cloud, Hull, rpy_rotation

if TYPE_CHECKING:
    from hplan.scene.shape_data import PointSet, Surface

_Data = TypeVar("_Data", "Mesh", "PointCloud")
_Shape = TypeVar("_Shape", "Surface", "PointSet")


class Sphere(Convex):
    """A ball."""

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
        """The capsule that it sweeps when it is shifted by up to (3,) `reach` [m] to either side."""
        start, end = (self.core[0] - reach).tolist(), (self.core[0] + reach).tolist()
        kept = {"radius": self.radius, "sigma": self.sigma, "yields": self.yields}
        return Capsule(name=self.name, start=tuple(start), end=tuple(end), **kept)


class Capsule(Convex):
    """A segment with a radius: branch, wire, trunk."""

    kind: Literal["capsule"] = "capsule"
    name: Name
    start: Vector = Field(alias="from")
    end: Vector = Field(alias="to")
    radius: Size
    sigma: Sigma = 0.0

    @property
    def core(self) -> FloatArray:
        """(2, 3) points; the obstacle is their hull grown by `rounding`."""
        return readonly([self.start, self.end])

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return self.radius


class Cylinder(Turned, Convex):
    """A cylinder, flat at both ends, turned by roll, pitch and yaw (fixed axes x, y, z); unturned it stands on z.

    The certificate and MuJoCo take it as it is, kernels and sections the prism about it (`hplan.scene.prism`).
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
        """The prism about it."""
        return prism(self.center, self.rpy_deg, self.length, self.radius)

    @property
    def core(self) -> FloatArray:
        """(k, 3) corners of the prism about it; the obstacle lies in their hull."""
        return self.hull.core

    @property
    def excess(self) -> float:
        """How far the prism stands out of it [m]."""
        return prism_excess(self.radius)


class Box(Turned, Convex):
    """A block of the given full edge lengths, turned by roll, pitch and yaw (fixed axes x, y, z)."""

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
    """The solid inside a closed surface, from a file or from arrays (`Mesh.of`).

    The surface is scaled, then turned by roll, pitch and yaw (fixed axes x, y, z), then shifted. A relative `file` is
    looked for in the scene file's folder, without one in the working directory.
    """

    kind: Literal["mesh"] = "mesh"
    name: Name
    file: Name | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    scale: PositiveFloat = 1.0
    sigma: Sigma = 0.0

    @classmethod
    def of(cls, name: str, vertices: ArrayLike, faces: ArrayLike, **placement: Any) -> Mesh:
        """A mesh from (n, 3) vertices and (m, 3) triangles, counter-clockwise as seen from outside.

        Args:
            vertices: Vertices [m] (before `scale`).
            faces: Rows of the triangles' vertices.
            placement: `position`, `rpy_deg`, `scale`, `sigma`, `covariance`, `yields`.

        Raises:
            SceneError: The mesh is empty, not finite, open, flat or inside out.
        """
        from hplan.scene.shape_data import Surface

        return _made_of(cls, name, lambda: Surface.of(vertices, faces), placement)

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Mesh:
        from hplan.scene.shape_data import read_surface

        if self._data is not None:  # an obstacle that exists already is put into a scene
            return self
        self._data, self._path = _shape_data(self.file, read_surface, info)
        span = float(np.ptp(self._data.vertices, axis=0).max()) * self.scale
        farthest = float(np.abs(self._data.vertices).max()) * self.scale
        below = "file" if self.file else "name"
        if not 1e-4 <= span <= FARTHEST_M:
            raise fault(f"the mesh is {span:.3g} m across; expected 0.1 mm to 10 km: look at its scale", below)
        if not farthest <= FARTHEST_M:
            raise fault(f"the mesh reaches {farthest:.3g} m; expected at most 10 km: look at its scale", below)
        return self

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """(n, 3) vertices in `base_link` [m] and (m, 3) triangles."""
        return self._data.vertices * self.scale @ self.rotation.T + np.array(self.position), self._data.faces

    @property
    def excess(self) -> float:
        """The solids hold the mesh, and stand out of it by no more than this [m] (`convex_decomposition`)."""
        return float(self._data.pieces(self.scale).excess)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """Convex pieces whose union holds the mesh."""
        key = (self.name, self.scale, self.position, self.rpy_deg, self.sigma, self.sway, self.yields)
        hulls: tuple[Solid, ...] = self._data.cached(key, self._hulls)
        return hulls

    def _hulls(self) -> tuple[Solid, ...]:
        place, own = (self.rotation, np.array(self.position)), {"name": self.name, "sigma": self.sigma}
        hulls = self._data.pieces(self.scale).hulls
        return self._swept(tuple(hull.placed(*place, yields=self.yields, **own) for hull in hulls))


class PointCloud(FromData):
    """Balls of one radius about points, from a file or from an array (`PointCloud.of`); placed as a `Mesh` is."""

    kind: Literal["points"] = "points"
    name: Name
    file: Name | None = None
    radius: Size
    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @classmethod
    def of(cls, name: str, points: ArrayLike, radius: float, **placement: Any) -> PointCloud:
        """A cloud from (n, 3) points.

        Args:
            points: Centres of the balls [m].
            radius: Radius of every ball [m].
            placement: `position`, `rpy_deg`, `sigma`, `covariance`, `yields`.

        Raises:
            SceneError: The cloud is empty, too large or not finite.
        """
        from hplan.scene.shape_data import PointSet

        return _made_of(cls, name, lambda: PointSet.of(points), {"radius": radius, **placement})

    @classmethod
    def thinned(cls, name: str, points: ArrayLike, radius: float, yields: float = 0.0) -> PointCloud:
        """A cloud of (n, 3) points of which none are merged, so that its balls are those given (`hplan.online`).

        Raises:
            SceneError: The cloud is empty, too large or not finite.
        """
        from hplan.scene.shape_data import PointSet

        return _made_of(cls, name, lambda: PointSet.of(points, may_merge=False), {"radius": radius, "yields": yields})

    @property
    def left_out(self) -> int:
        """How many rows of its file held a value that is not finite."""
        return int(self._data.left_out)

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> PointCloud:
        from hplan.scene.shape_data import read_points

        if self._data is not None:  # an obstacle that exists already is put into a scene
            return self
        self._data, self._path = _shape_data(self.file, read_points, info)
        return self

    @property
    def points(self) -> FloatArray:
        """(n, 3) centres of all balls in `base_link` [m], before near ones are merged."""
        points: FloatArray = self._data.points
        if any((*self.position, *self.rpy_deg)):  # a product takes as long as a tree, and a camera's cloud needs none
            points = points @ self.rotation.T + np.array(self.position)
        return points

    @property
    def solids(self) -> tuple[Solid, ...]:
        """One cloud of balls."""
        key = (self.name, self.radius, self.position, self.rpy_deg, self.sigma, self.sway, self.yields)
        cloud: Solid = self._data.cached(key, self._cloud)
        return (cloud,)

    def _cloud(self) -> Solid:
        make = Cloud.of if self._data.may_merge else Cloud.unmerged
        cloud = make(self.name, self.points, self.radius, self.sigma)
        return self._swept((replace(cloud, yields=self.yields),))[0]


def _made_of(cls: type[_Data], name: str, make: Callable[[], Surface | PointSet], fields: dict[str, Any]) -> _Data:
    """An obstacle whose data is at hand."""
    try:
        data = make()
        return validated(cls, {"name": name, **fields}, {"data": data})
    except ValidationError as error:
        raise scene_error(error) from error
    except ValueError as error:
        raise SceneError(str(error), where=name) from error


def _shape_data(
    file: str | None, read: Callable[[Path, ByteBudget], _Shape], info: ValidationInfo
) -> tuple[_Shape, Path | None]:
    """The data of a mesh or cloud, and the file it is from."""
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


#: The kinds of obstacles, as a scene lists them: a new one is its class and its name here.
AnyObstacle: TypeAlias = Sphere | Capsule | Cylinder | Box | Mesh | PointCloud
Obstacle: TypeAlias = Annotated[AnyObstacle, Field(discriminator="kind")]
KINDS: tuple[type[AnyObstacle], ...] = get_args(AnyObstacle)
