"""The scene: obstacles, fruit, start and goal.

Positions are in `base_link`, z up, in metres. A scene never changes; `with_obstacles` gives a new one. The classes
are the scene file's schema too (`hplan.scene.file`). What keeps the arm away are an obstacle's `solids`: itself, or
what a mesh or a point cloud becomes (`hplan.scene.solids`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from hplan.base.arrays import FloatArray, IntArray, readonly
from hplan.errors import SceneError
from hplan.scene.fault import scene_error
from hplan.scene.limits import FARTHEST_M, MOST_OBSTACLES, MOST_SHAPE_BYTES, ByteBudget
from hplan.scene.solids import Cloud, Hull

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass

    from hplan.scene.shape_data import PointSet, Surface

if not TYPE_CHECKING:
    ModelMetaclass = type(BaseModel)  # it has no public name

FORMAT: Final = "hplan-scene/1"

Angles: TypeAlias = tuple[float, float, float]
Coordinate: TypeAlias = Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]
Vector: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Size: TypeAlias = Annotated[float, Field(gt=0.0, le=FARTHEST_M)]
Name: TypeAlias = Annotated[str, Field(min_length=1)]
Sigma: TypeAlias = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]


_Part = TypeVar("_Part", bound=BaseModel)
_Data = TypeVar("_Data", "Mesh", "PointCloud")
_Shape = TypeVar("_Shape", "Surface", "PointSet")


class _SceneErrors(ModelMetaclass):
    """Classes whose constructor raises a `SceneError` for a wrong value."""

    if not TYPE_CHECKING:

        def __call__(self, *arguments, **values):
            """Make an object."""
            try:
                return super().__call__(*arguments, **values)
            except ValidationError as error:
                raise scene_error(error) from error


class _Strict(BaseModel, metaclass=_SceneErrors):
    """Immutable, no unknown keys, no NaN or infinity, no text where a number belongs.

    Raises:
        SceneError: A value of the wrong kind or range.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True)

    if not TYPE_CHECKING:

        @classmethod
        def model_validate(cls, *arguments, **options):
            """As pydantic's, but for the error."""
            try:
                return super().model_validate(*arguments, **options)
            except ValidationError as error:
                raise scene_error(error) from error


def validated(kind: type[_Part], content: Any, context: dict[str, Any]) -> _Part:
    """A part of a scene from its content, for callers who know more of where a fault is.

    Raises:
        ValidationError: A value of the wrong kind or range.
    """
    made: _Part = kind.__pydantic_validator__.validate_python(content, context=context)
    return made


class _Obstacle(_Strict):
    """What stands in the arm's way.

    Attributes of every kind:
        name: Name of the obstacle.
        sigma: Standard deviation of its position [m].
    """


class _Convex(_Obstacle):
    """One convex solid: the hull of its core grown by its rounding."""

    @property
    def is_point_set(self) -> Literal[False]:
        """Never: the solid is the hull of its core grown by its rounding."""
        return False

    @property
    def solids(self) -> tuple[Solid, ...]:
        """What the arm must keep clear of: the obstacle itself."""
        return (self,)  # type: ignore[return-value]  # one of the three below


class Sphere(_Convex):
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


class Capsule(_Convex):
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


class Box(_Convex):
    """A block of the given full edge lengths, turned by roll, pitch and yaw (fixed axes x, y, z)."""

    kind: Literal["box"] = "box"
    name: Name
    center: Vector
    size: tuple[Size, Size, Size]
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the box's frame to `base_link`."""
        return _rotation(self.rpy_deg)

    @property
    def core(self) -> FloatArray:
        """(8, 3) corners; the obstacle is their hull."""
        signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return readonly(np.array(self.center) + (0.5 * signs * np.array(self.size)) @ self.rotation.T)

    @property
    def rounding(self) -> float:
        """Radius about the core [m]."""
        return 0.0


def _rotation(rpy_deg: Angles) -> FloatArray:
    """(3, 3) rotation by roll, pitch and yaw about fixed axes x, y, z."""
    roll, pitch, yaw = (math.radians(angle) for angle in rpy_deg)
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


class _FromData(_Obstacle):
    """An obstacle whose shape is in a file or in arrays."""

    _data: Any = PrivateAttr(None)
    _path: Path | None = PrivateAttr(None)

    @property
    def path(self) -> Path | None:
        """Where its file was found, or None where it was made of arrays."""
        return self._path

    @property
    def data_digest(self) -> str:
        """SHA-256 of its data before scale, turn and shift, in hexadecimal digits; made once."""
        digest: str = self._data.once("digest", lambda: _sha256(self._data.arrays))
        return digest

    def write(self, path: Path) -> Path:
        """Write its data as a PLY file, before scale, turn and shift.

        Raises:
            OutputError: The file cannot be written.
        """
        from hplan.scene.shape_data import write_shape

        return write_shape(self._data, path)


def _sha256(arrays: Sequence[FloatArray | IntArray]) -> str:
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.dtype.kind}{array.shape}".encode())
        found.update(np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).tobytes())
    return found.hexdigest()


class Mesh(_FromData):
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
            name: Name of the obstacle.
            vertices: Vertices [m] (before `scale`).
            faces: Rows of the triangles' vertices.
            placement: `position`, `rpy_deg`, `scale`, `sigma`.

        Raises:
            SceneError: The mesh is empty, not finite, open, flat or inside out.
        """
        from hplan.scene.shape_data import Surface

        return _made_of(cls, name, lambda: Surface.of(vertices, faces), placement)

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Mesh:
        from hplan.scene.shape_data import read_surface

        if self._data is not None:  # an obstacle that is there already, on its way into a scene
            return self
        self._data, self._path = _shape_data(self.file, read_surface, info)
        span = float(np.ptp(self._data.vertices, axis=0).max()) * self.scale
        farthest = float(np.abs(self._data.vertices).max()) * self.scale
        below = "file" if self.file else "name"
        if not 1e-4 <= span <= FARTHEST_M:
            raise _fault(f"the mesh is {span:.3g} m across; expected 0.1 mm to 10 km: look at its scale", below)
        if not farthest <= FARTHEST_M:
            raise _fault(f"the mesh reaches {farthest:.3g} m; expected at most 10 km: look at its scale", below)
        return self

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the mesh's frame to `base_link`."""
        return _rotation(self.rpy_deg)

    @property
    def surface(self) -> tuple[FloatArray, IntArray]:
        """(n, 3) vertices in `base_link` [m] and (m, 3) triangles."""
        return self._data.vertices * self.scale @ self.rotation.T + np.array(self.position), self._data.faces

    @property
    def excess(self) -> float:
        """The solids hold the mesh, and stand out of it by no more than this [m] (`convex_decomposition`)."""
        excess: float = self._data.pieces(self.scale).excess
        return excess

    @property
    def solids(self) -> tuple[Solid, ...]:
        """What the arm must keep clear of: convex pieces whose union holds the mesh."""
        from hplan.scene.shape_data import placed_pieces

        key = (self.name, self.scale, self.position, self.rpy_deg, self.sigma)
        place = (self.rotation, np.array(self.position))
        found: tuple[Hull, ...] = self._data.once(
            key, lambda: placed_pieces(self._data, self.scale, self.name, *place, self.sigma)
        )
        return found


class PointCloud(_FromData):
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
            name: Name of the obstacle.
            points: Centres of the balls [m].
            radius: Radius of every ball [m].
            placement: `position`, `rpy_deg`, `sigma`.

        Raises:
            SceneError: The cloud is empty, too large or not finite.
        """
        from hplan.scene.shape_data import PointSet

        return _made_of(cls, name, lambda: PointSet.of(points), {"radius": radius, **placement})

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> PointCloud:
        from hplan.scene.shape_data import read_points

        if self._data is not None:  # an obstacle that is there already, on its way into a scene
            return self
        self._data, self._path = _shape_data(self.file, read_points, info)
        return self

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation from the cloud's frame to `base_link`."""
        return _rotation(self.rpy_deg)

    @property
    def points(self) -> FloatArray:
        """(n, 3) centres of all balls in `base_link` [m], before near ones are merged."""
        points: FloatArray = self._data.points @ self.rotation.T + np.array(self.position)
        return points

    @property
    def solids(self) -> tuple[Solid, ...]:
        """What the arm must keep clear of: one cloud."""
        key = (self.name, self.radius, self.position, self.rpy_deg, self.sigma)
        place = (self.rotation, np.array(self.position))
        cloud: Cloud = self._data.once(key, lambda: self._data.cloud(self.name, self.radius, *place, self.sigma))
        return (cloud,)


def _made_of(cls: type[_Data], name: str, make: Callable[[], Surface | PointSet], fields: dict[str, Any]) -> _Data:
    """An obstacle whose data is at hand."""
    try:
        data = make()
        return validated(cls, {"name": name, **fields}, {"data": data})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"]) or name
        raise SceneError(first["msg"], where=where, value=first["input"]) from error
    except ValueError as error:
        raise SceneError(str(error), where=name) from error


def _shape_data(
    file: str | None, read: Callable[[Path, ByteBudget], _Shape], info: ValidationInfo
) -> tuple[_Shape, Path | None]:
    """The data of a mesh or cloud, and the file it is from."""
    context = info.context or {}
    if file is None:
        if context.get("data") is None:
            raise _fault("this key is missing", "file")
        return context["data"], None
    path = Path(context.get("folder", "")) / file
    try:
        return read(path, context.get("budget") or ByteBudget(MOST_SHAPE_BYTES)), path.absolute()
    except ValueError as error:
        raise _fault(str(error), "file") from error


#: What the planner keeps clear of: the hull of `core` grown by `rounding`; of a point set a ball about each core point.
Solid: TypeAlias = Sphere | Capsule | Box | Hull | Cloud

#: What a scene lists.
Obstacle: TypeAlias = Annotated[Sphere | Capsule | Box | Mesh | PointCloud, Field(discriminator="kind")]


class Fruit(_Strict):
    """A fruit: a ball, an obstacle unless it is the one being reached for."""

    name: Name
    center: Vector
    radius: Size
    sigma: Sigma = 0.0


class Start(_Strict):
    """Where the motion begins: one of `joints_deg`, `joints_rad`."""

    joints_deg: tuple[float, ...] | None = None
    joints_rad: tuple[float, ...] | None = None

    #: The keys of which one is to be given.
    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad")

    @model_validator(mode="after")
    def _one_of(self) -> Start:
        given = [key for key in self._choices if getattr(self, key) is not None]
        if len(given) != 1:
            keys = ", ".join(self._choices)
            raise ValueError(f"give exactly one of {keys}; got {', '.join(given) or 'none'}")
        return self

    def joints(self) -> FloatArray | None:
        """The configuration [rad], or None where the goal is given in another way."""
        if self.joints_deg is not None:
            return np.radians(self.joints_deg)
        return None if self.joints_rad is None else np.array(self.joints_rad, dtype=np.float64)

    @property
    def configuration(self) -> FloatArray:
        """The configuration [rad].

        Raises:
            SceneError: It is a goal that is given in another way.
        """
        joints = self.joints()
        if joints is None:
            raise SceneError("expected a goal given by joints", where="goal")
        return joints


class Goal(Start):
    """Where the motion ends: joints, a `tool0` position, or the name of a fruit.

    To a position or a fruit, `approach_deg` fixes or bounds the angle of the last link in the arm plane (0: outward,
    90: up).
    """

    position: Vector | None = None
    fruit: str | None = None
    approach_deg: float | tuple[float, float] | None = None

    _choices: ClassVar[tuple[str, ...]] = ("joints_deg", "joints_rad", "position", "fruit")

    @model_validator(mode="after")
    def _approach_is_free(self) -> Goal:
        if self.approach_deg is not None and self.joints() is not None:
            raise ValueError("approach_deg belongs to a position or a fruit; joints leave nothing to choose")
        return self


def _fault(message: str, *below: int | str) -> PydanticCustomError:
    """A fault of the scene as a whole that shows at one place; `scene_file` finds its line by `below`."""
    return PydanticCustomError("scene", "{message}", {"message": message, "below": below})


class Scene(_Strict):
    """Everything around the arm, and what it is asked to do.

    Attributes:
        name: Name of the scene.
        start: Configuration at which the motion begins.
        goal: Configuration, tool position or fruit to reach.
        locked_joints: Joints that keep their start value.
        clearance: Distance kept from every obstacle [m].
        obstacles: What must not be touched.
        fruits: Fruit; obstacles too, except the one reached for.
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    start: Start
    goal: Goal
    locked_joints: tuple[str, ...] = ()
    clearance: Annotated[float, Field(ge=0.0, le=FARTHEST_M)] = 0.0
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_OBSTACLES)] = ()
    fruits: Annotated[tuple[Fruit, ...], Field(max_length=MOST_OBSTACLES)] = ()

    @model_validator(mode="after")
    def _names_are_unique(self) -> Scene:
        seen: set[str] = set()
        for key, items in (("obstacles", self.obstacles), ("fruits", self.fruits)):
            for index, item in enumerate(items):
                if item.name in seen:
                    raise _fault(f"two obstacles are called {item.name!r}; names must differ", key, index, "name")
                seen.add(item.name)
        if self.goal.fruit is not None and self.goal.fruit not in {fruit.name for fruit in self.fruits}:
            raise _fault(f"{self.goal.fruit!r} is not among the fruits", "goal", "fruit")
        return self

    @property
    def solids(self) -> tuple[Solid, ...]:
        """All that the arm must keep clear of: the obstacles' solids, and each fruit that is not the goal as a ball.

        Those of one obstacle have its name and stand together.
        """
        return tuple(solid for solid in self.solids_with_goal if solid.name != self.goal.fruit)

    @property
    def solids_with_goal(self) -> tuple[Solid, ...]:
        """As `solids`, the fruit that is the goal among them."""
        balls = (Sphere(name=f.name, center=f.center, radius=f.radius, sigma=f.sigma) for f in self.fruits)
        return (*(solid for obstacle in self.obstacles for solid in obstacle.solids), *balls)

    def with_obstacles(self, obstacles: Sequence[Sphere | Capsule | Box | Mesh | PointCloud]) -> Scene:
        """The same task among other obstacles."""
        return Scene.model_validate(
            {
                **{key: getattr(self, key) for key in type(self).model_fields},
                "obstacles": tuple(obstacles),
            }
        )
