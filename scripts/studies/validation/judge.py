r"""Independent collision checks of motions by Pinocchio and coal, without any code of hplan.

Bodies are read from the URDF (meshes as triangles), obstacles from the numbers of a scene, and configurations from the
rows of a CSV. Obstacles and the base move along their tracks as the documentation of scenes describes. A cloud is a
set of balls around all of its points, also those that a filter removes.

A motion is checked every `TICK_S`. Ticks at which two bodies cannot touch are skipped: if they are farther apart at one
tick than both can travel until another, they do not touch there. A body travels at most
:math:`\sum_j r_j |\Delta q_j|`, with :math:`r_j` its maximum distance from joint j over all configurations.
"""

from __future__ import annotations

import copy
import csv
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import trimesh
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import cKDTree

from hplan.base.arrays import FloatArray

#: Time between two checks [s]; ticks of a segment.
TICK_S, SEGMENT = 5e-4, 64

#: A deeper penetration is a contact; coal's own error is smaller [m].
CONTACT_M = 1e-6

#: Static bodies may penetrate the ground, or an obstacle that they carry, up to this depth [m].
STATIC_CONTACT_M = 1e-3

#: Reported depth of intersecting triangle meshes, whose depth coal does not compute [m].
INTERSECTION_M = 2e-3

#: Maximum distance up to which pairs of bodies are compared at random configurations [m].
_FAR = 0.1

#: A mesh counts as convex if its volume equals that of its hull up to this fraction.
_CONVEX = 1e-4


@dataclass(frozen=True)
class Contact:
    """A pair in contact.

    Attributes:
        first: A body of the arm.
        second: Another body, or an obstacle.
        time_s: First tick in contact [s].
        depth_m: Maximum depth over all ticks [m].
    """

    first: str
    second: str
    time_s: float
    depth_m: float


@dataclass(frozen=True)
class Window:
    """Time interval in which bodies on the last joint may touch an obstacle, such as the fruit to pick.

    Attributes:
        name: The obstacle.
        from_s: Start [s].
        to_s: End [s].
    """

    name: str
    from_s: float
    to_s: float


class PoseTrack:
    """A time-dependent pose: x moves to about + shift + R (x - about)."""

    def __init__(self, track: Mapping[str, Any]) -> None:
        self.times = np.array(track["times_s"], dtype=np.float64)
        self.shifts = np.array(track["shifts_m"], dtype=np.float64)
        self.about = np.array(track.get("about") or (0.0, 0.0, 0.0), dtype=np.float64)
        angles = np.radians(track.get("rpy_deg") or np.zeros((len(self.times), 3)))
        self.turns = [pin.rpy.rpyToMatrix(*each) for each in angles]
        self.between = [pin.log3(a.T @ b) for a, b in itertools.pairwise(self.turns)]

    def at(self, clock: FloatArray) -> FloatArray:
        """(k, 4, 4) poses at (k,) times [s]."""
        poses = np.tile(np.eye(4), (len(clock), 1, 1))
        for number, time in enumerate(np.clip(clock, self.times[0], self.times[-1])):
            i = min(int(np.searchsorted(self.times, time, side="right")) - 1, len(self.times) - 2)
            part = (time - self.times[i]) / (self.times[i + 1] - self.times[i])
            turn = self.turns[i] @ pin.exp3(part * self.between[i])
            poses[number, :3, :3] = turn
            shift = (1.0 - part) * self.shifts[i] + part * self.shifts[i + 1]
            poses[number, :3, 3] = self.about + shift - turn @ self.about
        return poses

    def travel(self, clock: FloatArray, radius: float) -> FloatArray:
        """(k,) upper bounds of the way of a point within `radius` of the pivot up to (k,) times [m]."""
        steps = np.linalg.norm(np.diff(self.shifts, axis=0), axis=1) + radius * np.linalg.norm(self.between, axis=1)
        way: FloatArray = np.interp(clock, self.times, np.concatenate([[0.0], np.cumsum(steps)]))
        return way


class JudgedObstacle:
    """An obstacle, as a shape of coal or the balls of a cloud, at its listed pose, and its track."""

    def __init__(self, item: Mapping[str, Any], shift: FloatArray | None = None) -> None:
        """Read an obstacle as scenes list it; meshes have `vertices` and `faces`, clouds `points`.

        Args:
            shift: Displacement of a swaying obstacle [m].
        """
        self.name: str = item["name"]
        self.track = None if item.get("track") is None else PoseTrack(item["track"])
        self.points = np.array(item["points"], dtype=np.float64) if item["kind"] == "points" else None
        self.ball = float(item["radius"]) if self.points is not None else 0.0
        self.place, self.shape = _placed_shape(item)
        if shift is not None:
            self.place = pin.SE3(self.place.rotation, self.place.translation + shift)
        if self.points is None:
            self.middle, self.half = _box_of(self.shape)
        else:
            low, high = self.points.min(axis=0) - self.ball, self.points.max(axis=0) + self.ball
            self.middle, self.half = 0.5 * (low + high), 0.5 * (high - low)

    @cached_property
    def tree(self) -> cKDTree:
        """The points of the cloud."""
        return cKDTree(self.points)

    def poses(self, base: PoseTrack | None, clock: FloatArray) -> FloatArray:
        """(k, 4, 4) poses in the frame of the base at (k,) times."""
        place = self.place.homogeneous
        poses = np.tile(place, (len(clock), 1, 1)) if self.track is None else self.track.at(clock) @ place
        return poses if base is None else np.linalg.inv(base.at(clock)) @ poses

    def travel(self, clock: FloatArray) -> FloatArray | float:
        """(k,) upper bounds of the way of its points up to (k,) times [m]."""
        if self.track is None:
            return 0.0
        from_pivot = np.linalg.norm(self.place.act(self.middle) - self.track.about) + np.linalg.norm(self.half)
        return self.track.travel(clock, float(from_pivot))


def _placed_shape(item: Mapping[str, Any]) -> tuple[pin.SE3, Any]:
    """Pose and shape of an obstacle; for a cloud the shape of one ball."""
    kind = item["kind"]
    turn = pin.rpy.rpyToMatrix(*np.radians(item.get("rpy_deg", (0.0, 0.0, 0.0))))
    place = pin.SE3(turn, np.array(item.get("center", item.get("position", (0.0, 0.0, 0.0))), dtype=np.float64))
    if kind in ("sphere", "points"):
        return place, coal.Sphere(item["radius"])
    if kind == "box":
        return place, coal.Box(*item["size"])
    if kind == "cylinder":
        return place, coal.Cylinder(item["radius"], item["length"])
    if kind == "capsule":
        start, end = np.array(item["from"]), np.array(item["to"])
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
        return pin.SE3(turn, 0.5 * (start + end)), coal.Capsule(item["radius"], float(np.linalg.norm(end - start)))
    return place, _mesh_shape(np.array(item["vertices"]) * item.get("scale", 1.0), np.array(item["faces"]))


def read_obstacles(items: Sequence[Mapping[str, Any]]) -> list[JudgedObstacle]:
    """The obstacles of a scene; a swaying one at the middle, the quarters and the ends of its sway."""
    found = []
    for item in items:
        sway = item.get("sway")
        if sway is None:
            found.append(JudgedObstacle(item))
            continue
        along = np.array(sway["direction"], dtype=np.float64)
        along *= sway["amplitude_m"] / np.linalg.norm(along)
        found += [JudgedObstacle(item, part * along) for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    return found


@dataclass(frozen=True, eq=False)
class Body:
    """A body of the arm: shape, convex hull, link, joint that carries it, and its bounding box in its own frame."""

    name: str
    link: str
    joint: int
    shape: Any
    hull: Any
    place: pin.SE3
    middle: FloatArray
    half: FloatArray

    @property
    def radius(self) -> float:
        """Radius of the ball around the bounding box [m]."""
        return float(np.linalg.norm(self.half))


class Arm:
    """The bodies and joints of a URDF."""

    def __init__(
        self,
        urdf: Path,
        *,
        held: Mapping[str, float | None] | None = None,
        package_dirs: Sequence[Path] = (),
        may_touch: Sequence[tuple[str, str]] = (),
        tool_frame: str = "tool0",
    ) -> None:
        """Read a URDF.

        Args:
            held: Positions of joints that do not move [rad, m].
            may_touch: Pairs of links that the SRDF allows to touch.
            tool_frame: Frame at the end of the arm.
        """
        self.model = pin.buildModelFromUrdf(str(urdf))
        folders = [str(each) for each in package_dirs]
        geometry = pin.buildGeomFromUrdf(self.model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
        self._use_base_frame(geometry)
        self.data = self.model.createData()
        held = {} if held is None else held
        self.joints = [name for name in list(self.model.names)[1:] if name not in held]
        self.still = pin.neutral(self.model)
        for name, value in held.items():
            if value is not None:
                self._set(self.still[None], name, np.array([value]))
        self.bodies = [self._body(shape) for shape in geometry.geometryObjects]
        moving = [joint for joint in ElementTree.parse(urdf).iter("joint") if joint.get("type") != "fixed"]
        self._joined = [{end.get("link") for end in joint if end.tag in ("parent", "child")} for joint in moving]
        self._joined += [set(pair) for pair in may_touch]
        self._numbers = [int(self.model.getJointId(name)) for name in self.joints]
        self.last_joint = self.carrier(max(f.parentJoint for f in self.model.frames if f.name == tool_frame))

    def holding(self, items: Sequence[tuple[Mapping[str, Any], str]]) -> Arm:
        """The arm with obstacles fixed to frames: each as scenes list it, and the name of its frame."""
        found = copy.copy(self)
        for name in ("static", "farthest_apart", "own_pairs"):
            vars(found).pop(name, None)
        found.bodies = list(self.bodies)
        for item, frame_name in items:
            held, frame = JudgedObstacle(item), self.model.frames[self.model.getFrameId(frame_name)]
            spheres = [held.place] if held.points is None else [held.place * pin.SE3(np.eye(3), p) for p in held.points]
            for place in spheres:
                at = frame.placement * place
                box = _box_of(held.shape)
                body = Body(held.name, held.name, frame.parentJoint, held.shape, held.shape, at, *box)
                found.bodies.append(body)
        return found

    def _use_base_frame(self, geometry: pin.GeometryModel) -> None:
        """Express all poses in `base_link` if the URDF has it; its root may be another link."""
        found = [frame for frame in self.model.frames if frame.name == "base_link" and frame.parentJoint == 0]
        if found:
            to_base = found[0].placement.inverse()
            for number in range(1, self.model.njoints):
                if self.model.parents[number] == 0:
                    self.model.jointPlacements[number] = to_base * self.model.jointPlacements[number]
            for shape in geometry.geometryObjects:
                if shape.parentJoint == 0:
                    shape.placement = to_base * shape.placement

    def _body(self, geometry: pin.GeometryObject) -> Body:
        hull = shape = geometry.geometry
        if isinstance(shape, coal.BVHModelBase):
            vertices = np.array(shape.vertices())
            triangles = (shape.tri_indices(number) for number in range(shape.num_tris))
            shape = _mesh_shape(vertices, np.array([[triangle[k] for k in range(3)] for triangle in triangles]))
            hull = shape if isinstance(shape, coal.ConvexBase) else _hull(vertices)
        link, place = self.model.frames[geometry.parentFrame].name, pin.SE3(geometry.placement)
        return Body(geometry.name, link, geometry.parentJoint, shape, hull, place, *_box_of(shape))

    def _set(self, q: FloatArray, name: str, values: FloatArray) -> None:
        joint = self.model.joints[self.model.getJointId(name)]
        if joint.nq == 1:
            q[:, joint.idx_q] = values
        else:  # a continuous joint: cosine and sine
            q[:, joint.idx_q], q[:, joint.idx_q + 1] = np.cos(values), np.sin(values)

    def configurations(self, names: Sequence[str], values: FloatArray) -> FloatArray:
        """(m, nq) of Pinocchio from (m, joints) values of joints by name."""
        q = np.tile(self.still, (len(values), 1))
        for column, name in enumerate(names):
            self._set(q, name, values[:, column])
        return q

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(count, joints) random values within the limits; one turn for continuous joints."""
        joints = [self.model.joints[number] for number in self._numbers]
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        low = [lower[joint.idx_q] if joint.nq == 1 else -math.pi for joint in joints]
        high = [upper[joint.idx_q] if joint.nq == 1 else math.pi for joint in joints]
        return rng.uniform(low, high, (count, len(low)))

    def places(self, q: FloatArray) -> list[pin.SE3]:
        """Poses of all bodies at a (nq,) configuration, in the frame of the base."""
        pin.forwardKinematics(self.model, self.data, q)
        return [self.data.oMi[body.joint] * body.place for body in self.bodies]

    def carrier(self, number: int) -> int:
        """The last moving joint on the chain of a joint; 0 for none."""
        return max(({0} | set(self._numbers)) & set(self.model.supports[number]))

    def is_prismatic(self, number: int) -> bool:
        """True if the joint with this number in the model is prismatic."""
        return str(self.model.joints[number].shortname()).startswith("JointModelP")

    def levers(self, farthest: FloatArray) -> tuple[FloatArray, float]:
        """(bodies, joints) maximum way of a body per unit of a joint, and the maximum distance of bodies from the base.

        Args:
            farthest: (joints,) maximum distances of the joints from 0; only those of prismatic joints count [rad, m].
        """
        out = dict(zip(self._numbers, farthest.tolist(), strict=True))
        found, extent = np.zeros((len(self.bodies), len(self._numbers))), 0.0
        for row, body in enumerate(self.bodies):
            beyond = float(np.linalg.norm(body.place.act(body.middle))) + body.radius
            for number in reversed(list(self.model.supports[body.joint])[1:]):
                if number in out:
                    found[row, self._numbers.index(number)] = 1.0 if self.is_prismatic(number) else beyond
                beyond += float(np.linalg.norm(self.model.jointPlacements[number].translation))
                beyond += out.get(number, 0.0) if self.is_prismatic(number) else 0.0
            extent = max(extent, beyond)
        return found, extent

    @cached_property
    def static(self) -> list[bool]:
        """(bodies,) True if the pose is the same at all configurations, up to a turn of a cylinder about its axis."""
        return [self._is_static(body) for body in self.bodies]

    def _is_static(self, body: Body) -> bool:
        if body.joint == 0:
            return True
        upright = self.model.joints[1].shortname() in ("JointModelRZ", "JointModelRUBZ")
        upright &= bool(abs(self.model.jointPlacements[1].rotation[2, 2]) > 1.0 - 1e-12)
        centred = np.hypot(*body.place.translation[:2]) < 1e-9 and abs(body.place.rotation[2, 2]) > 1.0 - 1e-12
        return bool(body.joint == 1 and upright and centred and isinstance(body.shape, coal.Cylinder))

    @cached_property
    def farthest_apart(self) -> dict[tuple[int, int], float]:
        """Maximum distance of each pair of bodies with relative motion, over random configurations [m]."""
        found = {(a, b): -math.inf for a, b in itertools.combinations(range(len(self.bodies)), 2) if self.between(a, b)}
        for q in self.configurations(self.joints, self.drawn(np.random.default_rng(0), 300)):
            places = self.places(q)
            for pair, most in found.items():
                if most <= _FAR:
                    found[pair] = max(most, self.own_distance(pair, places, _FAR))
        return found

    def own_distance(self, pair: tuple[int, int], places: Sequence[pin.SE3], within: float) -> float:
        """Distance of two bodies, or a lower bound of it above `within` [m]."""
        (a, b), bodies = pair, self.bodies
        found = distance(bodies[a].hull, places[a], bodies[b].hull, places[b])
        if found > within or (bodies[a].hull is bodies[a].shape and bodies[b].hull is bodies[b].shape):
            return found
        return distance(bodies[a].shape, places[a], bodies[b].shape, places[b])

    @cached_property
    def own_pairs(self) -> list[tuple[int, int]]:
        """Pairs of bodies with relative motion, except the two links of a joint and pairs always in contact."""
        apart = [pair for pair, most in self.farthest_apart.items() if most > 0.0]
        return [pair for pair in apart if {self.bodies[k].link for k in pair} not in self._joined]

    def between(self, a: int, b: int) -> list[int]:
        """Indices in `joints` of the joints that move two bodies relative to each other."""
        one, other = (set(self.model.supports[self.bodies[k].joint]) for k in (a, b))
        return [place for place, number in enumerate(self._numbers) if (number in one) != (number in other)]

    def is_clear_of_itself(self, values: FloatArray, clearance_m: float) -> bool:
        """True if all pairs of bodies keep the clearance, or a third of their maximum distance if that is less."""
        places = self.places(self.configurations(self.joints, values[None])[0])
        pairs = [(pair, most) for pair, most in self.farthest_apart.items() if most > 0.0]
        return all(self.own_distance(pair, places, clearance_m) > min(clearance_m, most / 3.0) for pair, most in pairs)

    def clearances(
        self, values: FloatArray, obstacles: Sequence[JudgedObstacle], base: PoseTrack | None, time_s: float
    ) -> list[float]:
        """(obstacles,) minimum distance of the bodies from each obstacle at a (joints,) configuration [m]."""
        places = self.places(self.configurations(self.joints, values[None])[0])
        clock, found = np.array([time_s]), []
        for obstacle in obstacles:
            at = obstacle.poses(base, clock)[0]
            distances = (self.obstacle_distance(k, place, obstacle, at) for k, place in enumerate(places))
            found.append(min(distances, default=math.inf))
        return found

    def box_distances(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """(n,) distances of (n, 3) points from the nearest bounding box of a body [m]."""
        places = self.places(self.configurations(self.joints, values[None])[0])
        least = np.full(len(points), math.inf)
        for body, place in zip(self.bodies, places, strict=True):
            local = (points - place.translation) @ place.rotation
            least = np.minimum(least, _box_distances(local, body))
        return least

    def obstacle_distance(
        self, number: int, place: pin.SE3, obstacle: JudgedObstacle, at: FloatArray, within: float = math.inf
    ) -> float:
        """Distance of a body from an obstacle, or a lower bound of it above `within` [m]."""
        body = self.bodies[number]
        if obstacle.points is None:
            found = distance(body.hull, place, obstacle.shape, pin.SE3(at))
            if found > within or body.hull is body.shape:
                return found
            return distance(body.shape, place, obstacle.shape, pin.SE3(at))
        seen, points = pin.SE3(at).actInv(place), obstacle.points  # the body in the frame of the cloud
        if within < math.inf:
            near = obstacle.tree.query_ball_point(seen.act(body.middle), body.radius + obstacle.ball + within)
            points = points[near]
        if not len(points):
            return math.inf
        local = (points - seen.translation) @ seen.rotation
        least, nearest = _box_distances(local, body) - obstacle.ball, math.inf
        for k in np.argsort(least):
            if least[k] > min(within, nearest):
                break
            ball = pin.SE3(np.eye(3), local[k])
            nearest = min(nearest, distance(body.shape, pin.SE3.Identity(), obstacle.shape, ball))
        return nearest if nearest < math.inf else float(least.min())


@dataclass(frozen=True, eq=False)
class SampledMotion:
    """Configurations at the ticks of a motion.

    Attributes:
        names: The joints.
        times: (m,) [s].
        values: (m, joints) [rad, m].
    """

    names: Sequence[str]
    times: FloatArray
    values: FloatArray

    @classmethod
    def read(cls, path: Path, from_s: float = 0.0) -> SampledMotion:
        """Read a CSV from a time on, with the cubics through its positions and velocities."""
        with path.open(newline="", encoding="utf-8") as file:
            header, *rows = list(csv.reader(file))
        table, names, columns = np.array(rows, dtype=np.float64), list[str](), []
        for number, name in enumerate(header):
            for unit, rate in (("_pos_rad", "_vel_rad_s"), ("_pos_m", "_vel_m_s")):
                if name.endswith(unit):
                    names.append(name.removesuffix(unit))
                    columns.append((number, header.index(names[-1] + rate)))
        time = table[:, header.index("time_s")]
        position, velocity = (table[:, [pair[k] for pair in columns]] for k in (0, 1))
        if len(time) == 1:
            return cls(names, time, position)
        times = np.union1d(np.arange(0.0, time[-1], TICK_S), time)
        times = times[times >= from_s - 1e-9]
        return cls(names, times, CubicHermiteSpline(time, position, velocity)(times))


def contacts(
    arm: Arm,
    motion: SampledMotion,
    obstacles: Sequence[JudgedObstacle],
    *,
    base: PoseTrack | None = None,
    start_time_s: float = 0.0,
    windows: Sequence[Window] = (),
) -> list[Contact]:
    """All pairs in contact along a motion.

    Args:
        start_time_s: Start of the motion on the clock of the tracks [s].
        windows: Intervals in which bodies on the last joint may touch an obstacle.
    """
    check = _Check(arm, motion, base, start_time_s)
    found = [check.own_contact(a, b) for a, b in arm.own_pairs]
    for obstacle in obstacles:
        near = check.near(obstacle)
        for k, body in enumerate(arm.bodies):
            on_last = arm.carrier(body.joint) == arm.last_joint
            allowed = [window for window in windows if window.name == obstacle.name and on_last]
            found.append(check.obstacle_contact(k, obstacle, near[:, k], allowed))
    return [contact for contact in found if contact is not None]


class _Check:
    """The check of one motion."""

    def __init__(self, arm: Arm, motion: SampledMotion, base: PoseTrack | None, start_time_s: float) -> None:
        self.arm, self.motion, self.base, self.clock = arm, motion, base, motion.times + start_time_s
        self.q = arm.configurations(motion.names, motion.values)
        order = [list(motion.names).index(name) for name in arm.joints]
        values = motion.values[:, order]
        self.turned = np.vstack([np.zeros(len(order)), np.cumsum(np.abs(np.diff(values, axis=0)), axis=0)])
        self.levers, extent = arm.levers(np.abs(values).max(axis=0))
        self.travel = self.turned @ self.levers.T  # (ticks, bodies) maximum way of each body
        if base is not None:
            self.travel += base.travel(self.clock, extent + float(np.linalg.norm(base.about)))[:, None]
        self.known: dict[int, list[pin.SE3]] = {}
        last = len(self.clock) - 1
        self.segments = [(a, min(a + SEGMENT - 1, last)) for a in range(0, last + 1, SEGMENT)]
        self.middles = [(a + c) // 2 for a, c in self.segments]
        centers = [
            [place.act(body.middle) for place, body in zip(self.places(tick), arm.bodies, strict=True)]
            for tick in self.middles
        ]
        self.centers = np.array(centers).reshape(len(centers), len(arm.bodies), 3)
        self.radii = np.array([body.radius for body in arm.bodies])

    def places(self, tick: int) -> list[pin.SE3]:
        if tick not in self.known:
            self.known[tick] = self.arm.places(self.q[tick])
        return self.known[tick]

    def near(self, obstacle: JudgedObstacle) -> Any:
        """(segments, bodies) True unless bounding box and travel prove a body clear of an obstacle."""
        poses = obstacle.poses(self.base, self.clock[self.middles])
        local = np.einsum("kji,kbj->kbi", poses[:, :3, :3], self.centers - poses[:, None, :3, 3])
        apart = np.linalg.norm(np.maximum(np.abs(local - obstacle.middle) - obstacle.half, 0.0), axis=2) - self.radii
        return apart <= self._travel_of_segments(self.travel + np.reshape(obstacle.travel(self.clock), (-1, 1)))

    def _travel_of_segments(self, travel: FloatArray) -> FloatArray:
        """Maximum way from the middle of each segment to its ends."""
        first, middle, last = (travel[ticks] for ticks in ([a for a, _ in self.segments], self.middles,
            [c for _, c in self.segments]))  # fmt: skip
        return np.maximum(middle - first, last - middle)

    def obstacle_contact(
        self, k: int, obstacle: JudgedObstacle, near: Any, allowed: Sequence[Window]
    ) -> Contact | None:
        """Contact of a body and an obstacle."""
        arm, is_moving = self.arm, self.base is not None or obstacle.track is not None
        segments = list(itertools.compress(self.segments, near.tolist()))
        if arm.static[k] and not is_moving:
            segments = [(0, 0)]
        for window in allowed:
            segments = list(self._without(segments, window))
        if not segments:
            return None
        fixed = None if is_moving else obstacle.poses(None, self.clock[:1])[0]

        def distance_at(tick: int, within: float) -> float:
            at = obstacle.poses(self.base, self.clock[[tick]])[0] if fixed is None else fixed
            return arm.obstacle_distance(k, self.places(tick)[k], obstacle, at, within)

        travel = self.travel[:, k] + obstacle.travel(self.clock)
        least = STATIC_CONTACT_M if arm.static[k] else CONTACT_M
        return self._search(distance_at, travel, segments, least, (arm.bodies[k].name, obstacle.name))

    def _without(self, segments: Sequence[tuple[int, int]], window: Window) -> Iterator[tuple[int, int]]:
        """Segments without the ticks of a window."""
        inside = (self.motion.times >= window.from_s - 1e-9) & (self.motion.times <= window.to_s + 1e-9)
        for a, c in segments:
            ticks = np.flatnonzero(~inside[a : c + 1]) + a
            if len(ticks):
                breaks = np.flatnonzero(np.diff(ticks) > 1)
                yield from zip(ticks[np.r_[0, breaks + 1]].tolist(), ticks[np.r_[breaks, -1]].tolist(), strict=True)

    def own_contact(self, a: int, b: int) -> Contact | None:
        """Contact of two bodies of the arm."""
        joints = self.arm.between(a, b)
        travel = self.turned[:, joints] @ (self.levers[a] + self.levers[b])[joints]
        apart = np.linalg.norm(self.centers[:, a] - self.centers[:, b], axis=1) - self.radii[a] - self.radii[b]
        segments = list(itertools.compress(self.segments, apart <= self._travel_of_segments(travel)))

        def distance_at(tick: int, within: float) -> float:
            return self.arm.own_distance((a, b), self.places(tick), within)

        return self._search(
            distance_at, travel, segments, CONTACT_M, (self.arm.bodies[a].name, self.arm.bodies[b].name)
        )

    def _search(
        self, distance_at: Callable[[int, float], float], travel: FloatArray, segments: Sequence[tuple[int, int]],
        least: float, names: tuple[str, str],
    ) -> Contact | None:  # fmt: skip
        """The contact of a pair, by bisection of segments that are not clear as a whole."""
        stack, touching = list(segments), False
        while stack and not touching:
            a, c = stack.pop()
            m = (a + c) // 2
            way = max(travel[m] - travel[a], travel[c] - travel[m])
            found = distance_at(m, way)
            touching = found < -least
            if found <= way:
                stack += [segment for segment in ((a, m - 1), (m + 1, c)) if segment[0] <= segment[1]]
        if not touching:
            return None
        ticks = [tick for a, c in segments for tick in range(a, c + 1)]
        depths = np.array([-distance_at(tick, 0.0) for tick in ticks])
        first = ticks[int(np.argmax(depths > least))]
        return Contact(*names, float(self.motion.times[first]), float(depths.max()))


_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()


def distance(first: Any, at: pin.SE3, second: Any, where: pin.SE3) -> float:
    """Signed distance of two shapes; `-INTERSECTION_M` if two triangle meshes intersect [m]."""
    _RESULT.clear()
    poses = (coal.Transform3s(place.rotation, place.translation) for place in (at, where))
    found = float(coal.distance(first, next(poses), second, next(poses), _REQUEST, _RESULT))
    are_meshes = isinstance(first, coal.BVHModelBase) and isinstance(second, coal.BVHModelBase)
    return -INTERSECTION_M if are_meshes and found <= 0.0 else found


def _box_distances(local: FloatArray, body: Body) -> FloatArray:
    """(n,) distances of (n, 3) points in the frame of a body from its bounding box [m]."""
    return np.asarray(np.linalg.norm(np.maximum(np.abs(local - body.middle) - body.half, 0.0), axis=1))


def _box_of(shape: Any) -> tuple[FloatArray, FloatArray]:
    """Middle and half sizes of the bounding box of a shape [m]."""
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    return 0.5 * (low + high), 0.5 * (high - low)


def _hull(vertices: FloatArray) -> Any:
    points = coal.StdVec_Vec3s()
    for point in vertices:
        points.append(point)
    return coal.Convex.convexHull(points, True, "Qt")


def _mesh_shape(vertices: FloatArray, faces: Any) -> Any:
    """The triangles of a mesh, or its hull if it is convex."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if abs(mesh.volume - mesh.convex_hull.volume) <= _CONVEX * abs(mesh.volume):
        return _hull(vertices)
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(vertices)
    tree.addTriangles(faces.astype(np.int32))
    tree.endModel()
    return tree
