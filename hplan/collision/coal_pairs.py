"""Shape pairs in Pinocchio, with linear time and memory in the obstacles.

`pinocchio.GeometryModel.addGeometryObject` copies a table of all pairs of its objects each time, so a model of n
objects costs n^3. Obstacles are therefore spread over several models, each with all moving shapes. The many
self-collision pairs of the arm have a model that all its scenes share, because creating their data takes 2.5 us per
pair.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.collision.coal_cloud import BareShape, PointBlocks
from hplan.collision.coal_meshes import ClosedMesh

#: The meshes of a pair's shapes; None for a shape without one.
MeshPair: TypeAlias = tuple[ClosedMesh | None, ClosedMesh | None]

#: Maximum number of obstacles in one geometry model.
_CHUNK: Final = 128

#: Index that represents the clouds among the model indices.
_CLOUDS: Final = -1


class _PartData:
    """Query data of one geometry model.

    Attributes:
        placed: Token `_QueryData.placed` of the last placement of its shapes; None before the first.
    """

    def __init__(self, geometry: pin.GeometryModel) -> None:
        self.geometry = geometry.createData()
        self.placed: object = None

    @cached_property
    def results(self) -> list[Any]:
        """Distance results of its pairs.

        Cached, because they keep their addresses and fetching one costs more than reading it.
        """
        return list(self.geometry.distanceResults)


class ArmPairs:
    """Self-collision pairs of an arm in their own geometry model.

    The model starts with the moving shapes.
    Safe for use from several threads.
    """

    def __init__(
        self, movers: Sequence[pin.GeometryObject], pairs: Sequence[tuple[pin.GeometryObject, pin.GeometryObject]]
    ) -> None:
        self.geometry = pin.GeometryModel()
        for shape in movers:
            self.geometry.addGeometryObject(shape)
        _add_pairs(self.geometry, movers, pairs)
        self._known = threading.local()

    @property
    def data(self) -> _PartData:
        """This thread's query data.

        Scenes share it, so whoever places an arm must check whether another scene has done so since.
        """
        known = vars(self._known)
        if "data" not in known:
            known["data"] = _PartData(self.geometry)
        found: _PartData = known["data"]
        return found


class _QueryData(threading.local):
    """Query data of the current thread, created on first use.

    Attributes:
        placed: Token of the arm's last placement.
        single: Arm data and model data if there is a single model that no other scene places, which saves the
            thread-local lookup; None otherwise.
        elsewhere: Obstacles that are not at their initial pose, by model: their index in it and their pose.
        clouds: For displaced clouds, by index, the pose of the base in the cloud's frame.
        nearer: (count,) distances by which pairs may be nearer than their poses say [m]; None for zero.
    """

    def __init__(
        self, model: pin.Model, geometries: Sequence[pin.GeometryModel], own: ArmPairs | None, has_clouds: bool
    ) -> None:
        self.arm, self.placed = model.createData(), object()
        self.parts: list[_PartData] = []
        for geometry in geometries:
            shared = own is not None and geometry is own.geometry
            self.parts.append(own.data if own is not None and shared else _PartData(geometry))
            check_deadline()
        alone = len(self.parts) == 1 and own is None and not has_clouds
        self.single = (self.arm, self.parts[0]) if alone else None
        self.elsewhere: dict[int, list[tuple[int, pin.SE3]]] = {}
        self.clouds: dict[int, pin.SE3] = {}
        self.nearer: FloatArray | None = None


class GeometryPairs:
    """Numbered shape pairs of an arm and obstacles, and their distances.

    The pairs are each moving shape with each obstacle, moving shape by moving shape, followed by the chosen pairs. All
    models are complete before their data is created, as Pinocchio requires. Safe for use from several threads.
    """

    def __init__(
        self,
        model: pin.Model,
        movers: Sequence[pin.GeometryObject],
        obstacles: Sequence[pin.GeometryObject | PointBlocks],
        chosen: Sequence[tuple[pin.GeometryObject, pin.GeometryObject]] | ArmPairs = (),
        bare: Sequence[BareShape] | None = None,
    ) -> None:
        """Build the geometry models.

        Args:
            model: Kinematic model of the arm.
            movers: The moving shapes.
            obstacles: Fixed shapes and clouds.
            chosen: Further pairs, of moving bodies or of shapes that are checked against no obstacle; `ArmPairs` must
                have been built with the same movers.
            bare: The moving shapes, possibly followed by others, without their swept radius; None to compute them.
        """
        self._model = model
        self._geometries: list[pin.GeometryModel] = []
        #: Pair indices of each model.
        self._numbers: list[IntArray] = []
        own = chosen if isinstance(chosen, ArmPairs) else None
        self._first_own = first_own = len(movers) * len(obstacles)
        self._clouds = [(column, shape) for column, shape in enumerate(obstacles) if isinstance(shape, PointBlocks)]
        fixed = [(column, shape) for column, shape in enumerate(obstacles) if not isinstance(shape, PointBlocks)]
        #: Model and index in it of each obstacle.
        self._where = {column: (_CLOUDS, cloud) for cloud, (column, _) in enumerate(self._clouds)}
        for number, (column, _) in enumerate(fixed):
            self._where[column] = number // _CHUNK, len(movers) + number % _CHUNK
        starts = range(0, len(fixed) if own is not None else max(len(fixed), 1), _CHUNK)
        for start in starts:
            check_deadline()
            geometry = pin.GeometryModel()
            for shape in movers:
                geometry.addGeometryObject(shape)
            chunk = fixed[start : start + _CHUNK]
            for _, shape in chunk:
                geometry.addGeometryObject(shape)
            wanted = np.zeros((geometry.ngeoms, geometry.ngeoms), dtype=np.bool_)
            wanted[: len(movers), len(movers) :] = True
            geometry.setCollisionPairs(wanted)
            rows = np.arange(len(movers))[:, None] * len(obstacles)
            numbers = (rows + np.array([column for column, _ in chunk], dtype=np.int64)).ravel()
            if start == starts[-1] and not isinstance(chosen, ArmPairs):
                _add_pairs(geometry, movers, chosen)
                numbers = np.append(numbers, first_own + np.arange(len(chosen)))
            self._geometries.append(geometry)
            self._numbers.append(numbers)
            check_deadline()
        if own is not None:
            self._geometries.append(own.geometry)
            self._numbers.append(first_own + np.arange(len(own.geometry.collisionPairs)))
        self.count = sum(map(len, self._numbers)) + len(movers) * len(self._clouds)
        self._movers = [BareShape.strip(shape.geometry) for shape in movers] if bare is None else bare
        self._query = _QueryData(model, self._geometries, own, bool(self._clouds))
        # Model of each pair and its index there; pairs with clouds have no model and are numbered body by body.
        self._part_of = np.full(self.count, -1, dtype=np.int64)
        self._local = np.zeros(self.count, dtype=np.int64)
        columns = np.array([column for column, _ in self._clouds], dtype=np.int64)
        self._of_clouds = (np.arange(len(movers))[:, None] * len(obstacles) + columns).ravel()
        self._local[self._of_clouds] = np.arange(len(self._of_clouds))
        for part, numbers in enumerate(self._numbers):
            self._part_of[numbers] = part
            self._local[numbers] = np.arange(len(numbers))

    def place(self, q: FloatArray) -> None:
        """Place the arm for `distances_of` in this thread, (dof,) joint angles."""
        query = self._query
        single = query.single
        if single is not None:  # One call instead of two.
            arm, part = single
            pin.updateGeometryPlacements(self._model, arm, self._geometries[0], part.geometry, q)
            part.placed = query.placed
            if query.elsewhere:
                _move_shapes(part, query.elsewhere[0])
            return
        pin.forwardKinematics(self._model, query.arm, q)
        query.placed = object()

    def move_obstacles(self, places: Iterable[tuple[int, pin.SE3]], spreads: FloatArray | None) -> None:
        """Move obstacles, by index, in this thread until the next call.

        The caller must place the arm next.

        Args:
            places: Indices and poses.
            spreads: (obstacles,) maximum distances of the obstacles from these poses, subtracted from the distances of
                their pairs [m]; None for zero.
        """
        elsewhere: dict[int, list[tuple[int, pin.SE3]]] = {}
        for obstacle, place in places:
            part, number = self._where[obstacle]
            elsewhere.setdefault(part, []).append((number, place if part != _CLOUDS else place.inverse()))
        self._query.elsewhere = elsewhere
        self._query.clouds = dict(elsewhere.get(_CLOUDS, ()))
        self._query.nearer = None
        if spreads is not None:
            self._query.nearer = np.zeros(self.count)
            self._query.nearer[: self._first_own] = np.tile(spreads, self._first_own // len(spreads))

    def distances(self, q: FloatArray) -> FloatArray:
        """Signed distances of all pairs at one configuration, (dof,) -> (count,) [m]."""
        self.place(q)
        query = self._query
        found = np.empty(self.count)
        for part, (geometry, numbers) in enumerate(zip(self._geometries, self._numbers, strict=True)):
            pin.computeDistances(geometry, self._placed_data(query, part))
            found[numbers] = [result.min_distance for result in query.parts[part].results]
        for local, number in enumerate(self._of_clouds.tolist()):
            found[number] = self._cloud_distance(query, local)
        return found if query.nearer is None else found - query.nearer

    def distances_of(self, pairs: IntArray) -> FloatArray:
        """Signed distances of (k,) pairs at the last placement, (k,) [m]."""
        query, geometries = self._query, self._geometries
        single = query.single
        if single is not None:  # The common case: no lookup of the pair's model.
            geometry, data = geometries[0], single[1].geometry
            near = np.array([pin.computeDistance(geometry, data, pair).min_distance for pair in pairs.tolist()])
            return near if query.nearer is None else near - query.nearer[pairs]
        found = []
        for part, local in zip(self._part_of[pairs].tolist(), self._local[pairs].tolist(), strict=True):
            if part < 0:
                found.append(self._cloud_distance(query, local))
                continue
            data = query.parts[part]
            placed = data.geometry if data.placed is query.placed else self._placed_data(query, part)
            found.append(pin.computeDistance(geometries[part], placed, local).min_distance)
        near = np.array(found, dtype=np.float64)
        return near if query.nearer is None else near - query.nearer[pairs]

    def mesh_distances(self, pairs: IntArray, meshes: Sequence[MeshPair]) -> FloatArray:
        """Distances of (k,) pairs at the last placement by meshes in place of shapes, (k,) [m].

        Args:
            pairs: Indices of pairs.
            meshes: The meshes of both shapes of each pair; None where its shape counts. A pair with a cloud needs one.

        Returns:
            Distances, or -inf for pairs in contact, whose depth is unknown.
        """
        query, found = self._query, []
        for (first, second), part, local in zip(
            meshes, self._part_of[pairs].tolist(), self._local[pairs].tolist(), strict=True
        ):
            if part < 0:
                found.append(-np.inf if first is None else first.cloud_distance(*self._placed_cloud(query, local)))
                continue
            geometry, placed = self._geometries[part], self._placed_data(query, part)
            pair = geometry.collisionPairs[local]
            places = [placed.oMg[number] for number in (pair.first, pair.second)]
            solids = [
                BareShape.strip(geometry.geometryObjects[number].geometry) if mesh is None else mesh
                for number, mesh in ((pair.first, first), (pair.second, second))
            ]
            if first is None:
                solids, places = solids[::-1], places[::-1]
            mesh = solids[0]
            found.append(mesh.distance(places[0], solids[1], places[1]) if isinstance(mesh, ClosedMesh) else -np.inf)
        near = np.array(found, dtype=np.float64)
        return near if query.nearer is None else near - query.nearer[pairs]

    def in_collision(self, configurations: FloatArray, margins: FloatArray) -> BoolArray:
        """(n,) mask of configurations that violate some pair's margin.

        `configurations` is (n, dof), `margins` (count,) [m].
        """
        q = np.asfortranarray(configurations.T)
        found = np.zeros(q.shape[1], dtype=np.bool_)
        for geometry, numbers in zip(self._geometries, self._numbers, strict=True):
            pool = pin.GeometryPool(self._model, geometry, 1)
            requests = pool.getGeometryDatas()[0].collisionRequests
            for request, margin in zip(requests, margins[numbers].tolist(), strict=True):
                request.security_margin = margin
                # In queries without contacts coal 3.0 misses deep collisions of boxes, cylinders and hulls if one shape
                # lies symmetrically inside the other or its core touches a face; with contacts it does not.
                request.enable_contact = True
            found |= np.asarray(pin.computeCollisionsInParallel(1, pool, q, True, False), dtype=np.bool_)
        if self._clouds:
            query, of_clouds = self._query, list(enumerate(margins[self._of_clouds].tolist()))
            for place in np.flatnonzero(~found).tolist():
                self.place(configurations[place])
                found[place] = any(self._cloud_distance(query, local) <= margin for local, margin in of_clouds)
        return found

    def _cloud_distance(self, query: _QueryData, local: int) -> float:
        """Signed distance of a cloud pair at the last placement [m]."""
        place, cloud = self._placed_cloud(query, local)
        return cloud.distance(self._movers[local // len(self._clouds)], place)

    def _placed_cloud(self, query: _QueryData, local: int) -> tuple[pin.SE3, PointBlocks]:
        """Pose of the shape of a cloud pair in the cloud's frame at the last placement, and the cloud."""
        mover, cloud = divmod(local, len(self._clouds))
        place = self._placed_data(query, 0).oMg[mover]
        if cloud in query.clouds:
            place = query.clouds[cloud] * place
        return place, self._clouds[cloud][1]

    def _placed_data(self, query: _QueryData, part: int) -> pin.GeometryData:
        """Return a model's data with its shapes at the last placement."""
        data = query.parts[part]
        if data.placed is not query.placed:
            pin.updateGeometryPlacements(self._model, query.arm, self._geometries[part], data.geometry)
            data.placed = query.placed
            if part in query.elsewhere:
                _move_shapes(data, query.elsewhere[part])
        return data.geometry


def _add_pairs(
    geometry: pin.GeometryModel,
    movers: Sequence[pin.GeometryObject],
    pairs: Sequence[tuple[pin.GeometryObject, pin.GeometryObject]],
) -> None:
    """Add pairs of shapes to a model that starts with the movers."""
    places = {id(shape): number for number, shape in enumerate(movers)}
    for shape in itertools.chain(*pairs):
        if id(shape) not in places:  # The same shape is added once.
            places[id(shape)] = geometry.addGeometryObject(shape)
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(places[id(first)], places[id(second)]))


def _move_shapes(part: _PartData, places: Sequence[tuple[int, pin.SE3]]) -> None:
    """Move shapes, by index, after Pinocchio has placed them by the model."""
    for number, place in places:
        part.geometry.oMg[number] = place
