r"""Contact along a motion, found by Pinocchio and coal alone; of hplan's code nothing is used.

Bodies come from the URDF (meshes by their triangles), obstacles from the numbers of a scene, configurations from the
rows of a CSV. Obstacles and base are placed by their tracks, as the scene's documentation describes them. Clouds are
balls about the points handed in: all that were there, not what a filter has left of them.

A motion is looked at every `TICK_S`. Ticks at which two bodies cannot touch are skipped: where they are farther apart
at one tick than both can travel until another, they do not touch there. A body travels at most
:math:`\sum_j r_j |\Delta q_j|`, :math:`r_j` its largest distance from a joint, all links between stretched out.
"""

from __future__ import annotations

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
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import ConvexHull, cKDTree

from hplan.base.arrays import FloatArray

#: Time between two looks [s]; ticks of the pieces that are looked at first.
TICK_S, PIECE = 5e-4, 64

#: Deeper than this is contact; coal's own rounding is less [m].
CONTACT_M = 1e-6

#: What does not move may stand in the ground, or carry something, by this much [m].
STANDS_M = 1e-3

#: Of triangles that cut triangles coal does not know how deep: told is this [m].
CUT_M = 2e-3

#: Pairs that were seen this far apart are not asked further [m].
_FAR = 0.1

#: A mesh whose volume is that of its hull, up to this part, is taken for convex.
_CONVEX = 1e-4


@dataclass(frozen=True)
class Contact:
    """A pair that touches.

    Attributes:
        first: A body of the arm.
        second: Another, or an obstacle.
        time_s: The first tick at which they touch [s].
        depth_m: How deep they are at most, of all ticks [m].
    """

    first: str
    second: str
    time_s: float
    depth_m: float


@dataclass(frozen=True)
class Window:
    """When bodies may touch an obstacle: what the last joint carries, and the fruit to be picked.

    Attributes:
        name: The obstacle.
        from_s: From when [s].
        to_s: Until when [s].
    """

    name: str
    from_s: float
    to_s: float


class Moves:
    """A pose that changes with time: x is at about + shift + R (x - about)."""

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
        """(k,) how far a point has come by (k,) times at most, that is so far from the point of turning [m]."""
        steps = np.linalg.norm(np.diff(self.shifts, axis=0), axis=1) + radius * np.linalg.norm(self.between, axis=1)
        come: FloatArray = np.interp(clock, self.times, np.concatenate([[0.0], np.cumsum(steps)]))
        return come


class Thing:
    """An obstacle: a shape of coal, or the balls of a cloud, where the scene lists it; and how it moves from there."""

    def __init__(self, item: Mapping[str, Any], shift: FloatArray | None = None) -> None:
        """Read an obstacle as scenes list it; meshes have `vertices` and `faces`, clouds `points`.

        Args:
            shift: Where along its sway it is [m].
        """
        self.name: str = item["name"]
        self.moves = None if item.get("track") is None else Moves(item["track"])
        self.points = np.array(item["points"], dtype=np.float64) if item["kind"] == "points" else None
        self.ball = float(item["radius"]) if self.points is not None else 0.0
        self.place, self.shape = _placed_shape(item)
        if shift is not None:
            self.place = pin.SE3(self.place.rotation, self.place.translation + shift)
        if self.points is None:
            self.shape.computeLocalAABB()
            self.low, self.high = np.array(self.shape.aabb_local.min_), np.array(self.shape.aabb_local.max_)
        else:
            self.low, self.high = self.points.min(axis=0) - self.ball, self.points.max(axis=0) + self.ball
        self.middle, self.half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)

    @cached_property
    def tree(self) -> cKDTree:
        """The cloud's points."""
        return cKDTree(self.points)

    @cached_property
    def from_pivot(self) -> float:
        """Largest distance of its points from the point about which its track turns it [m]."""
        about = np.zeros(3) if self.moves is None else self.moves.about
        return float(np.linalg.norm(self.place.act(self.middle) - about) + np.linalg.norm(self.half))


def _placed_shape(item: Mapping[str, Any]) -> tuple[pin.SE3, Any]:
    """Where an obstacle is, and its shape; of a cloud one of its balls."""
    kind = item["kind"]
    turn = pin.rpy.rpyToMatrix(*np.radians(item.get("rpy_deg", (0.0, 0.0, 0.0))))
    place = pin.SE3(turn, np.array(item.get("center", item.get("position", (0.0, 0.0, 0.0))), dtype=np.float64))
    if kind == "sphere":
        return place, coal.Sphere(item["radius"])
    if kind == "box":
        return place, coal.Box(*item["size"])
    if kind == "cylinder":
        return place, coal.Cylinder(item["radius"], item["length"])
    if kind == "capsule":
        start, end = np.array(item["from"]), np.array(item["to"])
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
        return pin.SE3(turn, 0.5 * (start + end)), coal.Capsule(item["radius"], float(np.linalg.norm(end - start)))
    if kind == "points":
        return place, coal.Sphere(item["radius"])
    return place, _solid(np.array(item["vertices"]) * item.get("scale", 1.0), np.array(item["faces"]))


def things_of(items: Sequence[Mapping[str, Any]]) -> list[Thing]:
    """All obstacles; what sways stands in the middle and at quarters of its swing."""
    found = []
    for item in items:
        sway = item.get("sway")
        if sway is None:
            found.append(Thing(item))
            continue
        along = np.array(sway["direction"], dtype=np.float64)
        along *= sway["amplitude_m"] / np.linalg.norm(along)
        found += [Thing(item, part * along) for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    return found


@dataclass(frozen=True, eq=False)
class Body:
    """A body of the arm: shape and its hull, the joint that carries it, its link, the box about it in its frame."""

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
        """About its middle [m]."""
        return float(np.linalg.norm(self.half))


class Arm:
    """All that a URDF describes."""

    def __init__(
        self,
        urdf: Path,
        *,
        held: Mapping[str, float | None] | None = None,
        package_dirs: Sequence[Path] = (),
        may_touch: Sequence[tuple[str, str]] = (),
        tool_frame: str = "tool0",
    ) -> None:
        """Read it.

        Args:
            held: Where joints stand that do not move [rad, m].
            may_touch: Pairs of links that its SRDF lets touch.
            tool_frame: Frame at the end of the arm.
        """
        self.model = pin.buildModelFromUrdf(str(urdf))
        folders = [str(each) for each in package_dirs]
        geometry = pin.buildGeomFromUrdf(self.model, str(urdf), pin.GeometryType.COLLISION, package_dirs=folders)
        self._stand_on_base(geometry)
        self.data = self.model.createData()
        held = {} if held is None else held
        self.joints = [name for name in list(self.model.names)[1:] if name not in held]
        self.still = pin.neutral(self.model)
        for name, value in held.items():
            if value is not None:
                self._put(self.still[None], name, np.array([value]))
        self.bodies = [self._body(shape) for shape in geometry.geometryObjects]
        moving = [joint for joint in ElementTree.parse(urdf).iter("joint") if joint.get("type") != "fixed"]
        self._joined = [{end.get("link") for end in joint if end.tag in ("parent", "child")} for joint in moving]
        self._joined += [set(pair) for pair in may_touch]
        self._numbers = [int(self.model.getJointId(name)) for name in self.joints]
        tool = [frame for frame in self.model.frames if frame.name == tool_frame]
        self.last_joint = self.carrier(max(frame.parentJoint for frame in tool))

    def _stand_on_base(self, geometry: pin.GeometryModel) -> None:
        """Places are those in `base_link`, where there is one: it may stand on something else."""
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
            corners = (shape.tri_indices(number) for number in range(shape.num_tris))
            vertices = np.array(shape.vertices())
            faces = np.array([[three[k] for k in range(3)] for three in corners])
            hull, shape = _hull(vertices), _solid(vertices, faces)
            hull = shape if isinstance(shape, coal.ConvexBase) else hull
        shape.computeLocalAABB()
        low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        link = self.model.frames[geometry.parentFrame].name
        place = pin.SE3(geometry.placement)
        return Body(
            geometry.name, link, geometry.parentJoint, shape, hull, place, 0.5 * (low + high), 0.5 * (high - low)
        )

    def _put(self, q: FloatArray, name: str, values: FloatArray) -> None:
        joint = self.model.joints[self.model.getJointId(name)]
        if joint.nq == 1:
            q[:, joint.idx_q] = values
        else:  # turns without end: cosine and sine
            q[:, joint.idx_q], q[:, joint.idx_q + 1] = np.cos(values), np.sin(values)

    def configurations(self, names: Sequence[str], values: FloatArray) -> FloatArray:
        """(m, nq) of Pinocchio from (m, joints) values of joints by name."""
        q = np.tile(self.still, (len(values), 1))
        for column, name in enumerate(names):
            self._put(q, name, values[:, column])
        return q

    def drawn(self, rng: np.random.Generator, count: int) -> FloatArray:
        """(count, joints) values within the limits; joints without any turn once."""
        low, high = [], []
        for number in self._numbers:
            joint = self.model.joints[number]
            limits = self.model.lowerPositionLimit, self.model.upperPositionLimit
            low.append(limits[0][joint.idx_q] if joint.nq == 1 else -math.pi)
            high.append(limits[1][joint.idx_q] if joint.nq == 1 else math.pi)
        return rng.uniform(low, high, (count, len(low)))

    def places(self, q: FloatArray) -> list[pin.SE3]:
        """Where all bodies are at a (nq,) configuration, seen from the base."""
        pin.forwardKinematics(self.model, self.data, q)
        return [self.data.oMi[body.joint] * body.place for body in self.bodies]

    def carrier(self, number: int) -> int:
        """The last joint that moves of those that carry what a joint does; 0 for none."""
        return max(({0} | set(self._numbers)) & set(self.model.supports[number]))

    def slides(self, number: int) -> bool:
        """Whether a joint slides, by its number in the model."""
        return str(self.model.joints[number].shortname()).startswith("JointModelP")

    def levers(self, farthest: FloatArray) -> tuple[FloatArray, float]:
        """(bodies, joints) how far a body comes at most where a joint moves by one, and how far from the base any is.

        Args:
            farthest: (joints,) how far joints are from 0 at most; of joints that slide it counts [rad, m].
        """
        out = dict(zip(self._numbers, farthest.tolist(), strict=True))
        found, reach = np.zeros((len(self.bodies), len(self._numbers))), 0.0
        for row, body in enumerate(self.bodies):
            beyond = float(np.linalg.norm(body.place.act(body.middle))) + body.radius
            for number in reversed(list(self.model.supports[body.joint])[1:]):
                if number in out:
                    found[row, self._numbers.index(number)] = 1.0 if self.slides(number) else beyond
                beyond += float(np.linalg.norm(self.model.jointPlacements[number].translation))
                beyond += out.get(number, 0.0) if self.slides(number) else 0.0
            reach = max(reach, beyond)
        return found, reach

    @cached_property
    def standing(self) -> list[bool]:
        """(bodies,) whose place is the same at all configurations: still, or round about an upright first axis."""
        return [self._stands(body) for body in self.bodies]

    def _stands(self, body: Body) -> bool:
        if body.joint == 0:
            return True
        upright = self.model.joints[1].shortname() in ("JointModelRZ", "JointModelRUBZ")
        upright &= bool(abs(self.model.jointPlacements[1].rotation[2, 2]) > 1.0 - 1e-12)
        centred = np.hypot(*body.place.translation[:2]) < 1e-9 and abs(body.place.rotation[2, 2]) > 1.0 - 1e-12
        return bool(body.joint == 1 and upright and centred and isinstance(body.shape, coal.Cylinder))

    @cached_property
    def farthest_apart(self) -> dict[tuple[int, int], float]:
        """How far apart pairs of bodies that move to each other are seen at random configurations [m]."""
        found = {(a, b): -math.inf for a, b in itertools.combinations(range(len(self.bodies)), 2) if self.between(a, b)}
        # Random configurations at all of which a pair of bodies touches that is left out.
        always = 300
        for q in self.configurations(self.joints, self.drawn(np.random.default_rng(0), always)):
            places = self.places(q)
            for pair, most in found.items():
                if most <= _FAR:
                    found[pair] = max(most, self.own(pair, places, _FAR))
        return found

    def own(self, pair: tuple[int, int], places: Sequence[pin.SE3], within: float) -> float:
        """Distance of two bodies, or of their hulls where these are farther apart than what need be known."""
        (a, b), bodies = pair, self.bodies
        apart = distance(bodies[a].hull, places[a], bodies[b].hull, places[b])
        if apart > within or (bodies[a].hull is bodies[a].shape and bodies[b].hull is bodies[b].shape):
            return apart
        return distance(bodies[a].shape, places[a], bodies[b].shape, places[b])

    @cached_property
    def own_pairs(self) -> list[tuple[int, int]]:
        """Pairs of bodies that move to each other, but those of a joint's two links, and those that touch always."""
        apart = [pair for pair, most in self.farthest_apart.items() if most > 0.0]
        return [pair for pair in apart if {self.bodies[k].link for k in pair} not in self._joined]

    def between(self, a: int, b: int) -> list[int]:
        """Places in `joints` of those of which the places of two bodies to each other depend."""
        one, other = (set(self.model.supports[self.bodies[k].joint]) for k in (a, b))
        return [place for place, number in enumerate(self._numbers) if (number in one) != (number in other)]

    def has_room(self, values: FloatArray, room_m: float) -> bool:
        """Whether bodies keep so far from each other at a (joints,) configuration, or a third of what they can."""
        places = self.places(self.configurations(self.joints, values[None])[0])
        pairs = [(pair, most) for pair, most in self.farthest_apart.items() if most > 0.0]
        return all(self.own(pair, places, room_m) > min(room_m, most / 3.0) for pair, most in pairs)

    def clearances(self, values: FloatArray, things: Sequence[Thing], base: Moves | None, time_s: float) -> list[float]:
        """(things,) least distance from each obstacle of any body [m].

        Args:
            values: (joints,) configuration.
        """
        places = self.places(self.configurations(self.joints, values[None])[0])
        clock, found = np.array([time_s]), []
        for thing in things:
            at = _seen(thing, base, clock)[0]
            found.append(min((self.apart(k, place, thing, at) for k, place in enumerate(places)), default=math.inf))
        return found

    def beside(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """(n,) least distances of (n, 3) points, seen from the base, from the boxes about all bodies [m]."""
        places = self.places(self.configurations(self.joints, values[None])[0])
        least = np.full(len(points), math.inf)
        for body, place in zip(self.bodies, places, strict=True):
            local = (points - place.translation) @ place.rotation
            beside = np.linalg.norm(np.maximum(np.abs(local - body.middle) - body.half, 0.0), axis=1)
            least = np.minimum(least, beside)
        return least

    def apart(self, number: int, place: pin.SE3, thing: Thing, at: FloatArray, within: float = math.inf) -> float:
        """Distance of a body from an obstacle, or something above `within` where it is more [m].

        Args:
            within: What is farther apart need not be known.
        """
        body = self.bodies[number]
        if thing.points is None:
            apart = distance(body.hull, place, thing.shape, pin.SE3(at))
            if apart > within or body.hull is body.shape:
                return apart
            return distance(body.shape, place, thing.shape, pin.SE3(at))
        seen = pin.SE3(at).actInv(place)  # the body in the cloud's frame
        if within < math.inf:
            chosen = thing.tree.query_ball_point(seen.act(body.middle), body.radius + thing.ball + within)
            points = thing.points[chosen]
        else:
            points = thing.points
        if not len(points):
            return math.inf
        local = (points - seen.translation) @ seen.rotation
        beside = np.maximum(np.abs(local - body.middle) - body.half, 0.0)
        least = np.linalg.norm(beside, axis=1) - thing.ball
        nearest = math.inf
        for k in np.argsort(least):
            if least[k] > min(within, nearest):
                break
            nearest = min(nearest, distance(body.shape, pin.SE3.Identity(), thing.shape, pin.SE3(np.eye(3), local[k])))
        return nearest if nearest < math.inf else float(least.min())


@dataclass(frozen=True, eq=False)
class Motion:
    """What is looked at.

    Attributes:
        names: The joints.
        times: (m,) [s].
        values: (m, joints) [rad, m].
    """

    names: Sequence[str]
    times: FloatArray
    values: FloatArray

    @classmethod
    def read(cls, path: Path, from_s: float = 0.0) -> Motion:
        """Read a CSV, and fill in the cubics that have its positions and velocities, from a time on."""
        names, rows, cubics = read_cubics(path)
        times = np.union1d(np.arange(0.0, rows[-1], TICK_S), rows)
        times = times[times >= from_s - 1e-9]
        return cls(names, times, cubics(times))


def read_cubics(path: Path) -> tuple[list[str], FloatArray, Callable[[FloatArray], FloatArray]]:
    """Joints of a CSV, the times of its rows [s], and the cubics that have its positions and velocities."""
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    table, names, columns = np.array(rows, dtype=np.float64), [], []
    for number, name in enumerate(header):
        for unit, rate in (("_pos_rad", "_vel_rad_s"), ("_pos_m", "_vel_m_s")):
            if name.endswith(unit):
                names.append(name.removesuffix(unit))
                columns.append((number, header.index(names[-1] + rate)))
    time = table[:, header.index("time_s")]
    place, speed = (table[:, [pair[k] for pair in columns]] for k in (0, 1))
    if len(time) == 1:
        return names, time, lambda clock: np.repeat(place, len(clock), axis=0)
    return names, time, CubicHermiteSpline(time, place, speed)


def contacts(
    arm: Arm,
    motion: Motion,
    things: Sequence[Thing],
    *,
    base: Moves | None = None,
    begin_s: float = 0.0,
    windows: Sequence[Window] = (),
) -> list[Contact]:
    """All pairs that touch along a motion.

    Args:
        begin_s: When the motion's time 0 is on the clock of the tracks [s].
        windows: When what the last joint carries may touch an obstacle.
    """
    look = _Look(arm, motion, things, base, begin_s)
    found = [look.pair(a, b) for a, b in arm.own_pairs]
    for number, thing in enumerate(things):
        near = look.near(thing)
        for k, body in enumerate(arm.bodies):
            allowed = [
                each for each in windows if each.name == thing.name and arm.carrier(body.joint) == arm.last_joint
            ]
            found.append(look.obstacle(k, number, near[:, k], allowed))
    return [contact for contact in found if contact is not None]


def least_between(
    arms: Sequence[tuple[Arm, Motion, pin.SE3]], within: float, skip: Callable[[int, str, int, str], bool]
) -> tuple[float, str, str]:
    """The minimum distance of bodies of different arms over motions with the same ticks, and the two bodies.

    Ticks are skipped as in `contacts`; a distance above `within` is not searched for [m].

    Args:
        arms: Each arm, its motion, and the pose of its base.
        skip: True for two links, each with the number of its arm, that may touch.
    """
    looks = [_Look(arm, motion, (), None, 0.0) for arm, motion, _ in arms]
    centres = [
        look.centres @ base.rotation.T + base.translation for look, (_, _, base) in zip(looks, arms, strict=True)
    ]
    best, names = within, ("", "")
    for first, second in itertools.combinations(range(len(arms)), 2):
        one, other, to_other = looks[first], looks[second], arms[first][2].actInv(arms[second][2])
        apart = np.linalg.norm(centres[first][:, :, None] - centres[second][:, None], axis=3)
        apart -= one.radii[:, None] + other.radii + one._come(one.gone)[:, :, None] + other._come(other.gone)[:, None]
        for a, b in itertools.product(range(len(one.radii)), range(len(other.radii))):
            if skip(first, one.arm.bodies[a].link, second, other.arm.bodies[b].link):
                continue
            bodies = one.arm.bodies[a], other.arm.bodies[b]

            def distance_at(
                tick: int, within: float, a: int = a, b: int = b, bodies: tuple[Body, Body] = bodies,
                one: _Look = one, other: _Look = other, to_other: pin.SE3 = to_other,
            ) -> float:  # fmt: skip
                places = one.places(tick)[a], to_other * other.places(tick)[b]
                found = distance(bodies[0].hull, places[0], bodies[1].hull, places[1])
                return found if found > within else distance(bodies[0].shape, places[0], bodies[1].shape, places[1])

            found = one.minimum(distance_at, one.gone[:, a] + other.gone[:, b], apart[:, a, b], best)
            if found < best:
                best, names = found, (f"{first} {bodies[0].name}", f"{second} {bodies[1].name}")
    return best, *names


def least_own(arm: Arm, motion: Motion, within: float) -> dict[tuple[int, int], float]:
    """The minimum distance over a motion of each pair of bodies that move to each other; at most `within` [m]."""
    look = _Look(arm, motion, (), None, 0.0)
    return {pair: look.least_of_pair(*pair, within) for pair in arm.farthest_apart}


def least_beside(arm: Arm, motion: Motion, things: Sequence[Thing], within: float) -> float:
    """The minimum distance over a motion of all bodies that move from obstacles; at most `within` [m]."""
    look, best = _Look(arm, motion, things, None, 0.0), within
    for number in range(len(things)):
        for k in (k for k, stands in enumerate(arm.standing) if not stands):
            best = look.least_of_obstacle(k, number, best)
    return best


class _Look:
    """One motion among obstacles."""

    def __init__(self, arm: Arm, motion: Motion, things: Sequence[Thing], base: Moves | None, begin_s: float) -> None:
        self.arm, self.motion, self.things, self.base = arm, motion, things, base
        self.clock = motion.times + begin_s
        self.q = arm.configurations(motion.names, motion.values)
        order = [list(motion.names).index(name) for name in arm.joints]
        values = motion.values[:, order]
        self.turned = np.vstack([np.zeros(len(order)), np.cumsum(np.abs(np.diff(values, axis=0)), axis=0)])
        self.levers, reach = arm.levers(np.abs(values).max(axis=0))
        self.gone = self.turned @ self.levers.T  # (ticks, bodies) how far each body has come at most
        self.carried = np.zeros(len(self.clock))
        if base is not None:
            self.carried = base.travel(self.clock, reach + float(np.linalg.norm(base.about)))
        self.known: dict[int, list[pin.SE3]] = {}
        self.seen: dict[tuple[int, int], FloatArray] = {}
        last = len(self.clock) - 1
        self.edges = [(a, min(a + PIECE - 1, last)) for a in range(0, last + 1, PIECE)]
        self.middles = [(a + c) // 2 for a, c in self.edges]
        places = [self.places(tick) for tick in self.middles]
        self.centres = np.array(
            [[place.act(body.middle) for place, body in zip(row, arm.bodies, strict=True)] for row in places]
        ).reshape(len(places), len(arm.bodies), 3)
        self.radii = np.array([body.radius for body in arm.bodies])

    def places(self, tick: int) -> list[pin.SE3]:
        if tick not in self.known:
            self.known[tick] = self.arm.places(self.q[tick])
        return self.known[tick]

    def where(self, number: int, tick: int) -> FloatArray:
        """(4, 4) where an obstacle is, seen from the base."""
        thing = self.things[number]
        key = (number, tick if thing.moves is not None or self.base is not None else -1)
        if key not in self.seen:
            self.seen[key] = _seen(thing, self.base, self.clock[[tick]])[0]
        return self.seen[key]

    def near(self, thing: Thing) -> Any:
        """(pieces, bodies) whether the box about an obstacle is near enough to look closer."""
        poses = _seen(thing, self.base, self.clock[self.middles])
        local = np.einsum("kji,kbj->kbi", poses[:, :3, :3], self.centres - poses[:, None, :3, 3])
        beside = np.linalg.norm(np.maximum(np.abs(local - thing.middle) - thing.half, 0.0), axis=2) - self.radii
        come = self._come(self.gone + self._travel(thing)[:, None])
        return beside <= come

    def _travel(self, thing: Thing) -> FloatArray:
        return self.carried + (0.0 if thing.moves is None else thing.moves.travel(self.clock, thing.from_pivot))

    def _come(self, gone: FloatArray) -> FloatArray:
        """How far it comes at most from the middle of each piece to its ends."""
        first, middle, last = gone[[a for a, _ in self.edges]], gone[self.middles], gone[[c for _, c in self.edges]]
        return np.maximum(middle - first, last - middle)

    def obstacle(self, k: int, number: int, near: Any, allowed: Sequence[Window]) -> Contact | None:
        """A body against an obstacle."""
        arm, thing = self.arm, self.things[number]
        moves = self.base is not None or thing.moves is not None
        pieces = [edge for edge, each in zip(self.edges, near.tolist(), strict=True) if each]
        if arm.standing[k] and not moves:
            pieces = [(0, 0)]
        for window in allowed:
            pieces = list(self._without(pieces, window))
        if not pieces:
            return None
        least = STANDS_M if arm.standing[k] else CONTACT_M

        def apart(tick: int, within: float) -> float:
            return arm.apart(k, self.places(tick)[k], thing, self.where(number, tick), within)

        gone = self.gone[:, k] + self._travel(thing)
        return self._search(apart, gone, pieces, least, (arm.bodies[k].name, thing.name))

    def _without(self, pieces: Sequence[tuple[int, int]], window: Window) -> Iterator[tuple[int, int]]:
        """Pieces without the ticks of a window."""
        inside = (self.motion.times >= window.from_s - 1e-9) & (self.motion.times <= window.to_s + 1e-9)
        for a, c in pieces:
            ticks = np.flatnonzero(~inside[a : c + 1]) + a
            if len(ticks):
                breaks = np.flatnonzero(np.diff(ticks) > 1)
                yield from zip(ticks[np.r_[0, breaks + 1]].tolist(), ticks[np.r_[breaks, -1]].tolist(), strict=True)

    def pair(self, a: int, b: int) -> Contact | None:
        """Two bodies of the arm."""
        joints = self.arm.between(a, b)
        gone = self.turned[:, joints] @ (self.levers[a] + self.levers[b])[joints]
        apart = np.linalg.norm(self.centres[:, a] - self.centres[:, b], axis=1) - self.radii[a] - self.radii[b]
        near = apart <= self._come(gone)
        pieces = [edge for edge, each in zip(self.edges, near.tolist(), strict=True) if each]

        def distance_at(tick: int, within: float) -> float:
            return self.arm.own((a, b), self.places(tick), within)

        names = self.arm.bodies[a].name, self.arm.bodies[b].name
        return self._search(distance_at, gone, pieces, CONTACT_M, names)

    def least_of_pair(self, a: int, b: int, best: float) -> float:
        """The minimum distance of two bodies of the arm; at most `best` [m]."""
        joints = self.arm.between(a, b)
        gone = self.turned[:, joints] @ (self.levers[a] + self.levers[b])[joints]
        apart = np.linalg.norm(self.centres[:, a] - self.centres[:, b], axis=1) - self.radii[a] - self.radii[b]

        def distance_at(tick: int, within: float) -> float:
            return self.arm.own((a, b), self.places(tick), within)

        return self.minimum(distance_at, gone, apart - self._come(gone), best)

    def least_of_obstacle(self, k: int, number: int, best: float) -> float:
        """The minimum distance of a body from an obstacle; at most `best` [m]."""
        thing = self.things[number]
        poses = _seen(thing, self.base, self.clock[self.middles])
        local = np.einsum("kji,kj->ki", poses[:, :3, :3], self.centres[:, k] - poses[:, :3, 3])
        apart = np.linalg.norm(np.maximum(np.abs(local - thing.middle) - thing.half, 0.0), axis=1) - self.radii[k]
        gone = self.gone[:, k] + self._travel(thing)

        def distance_at(tick: int, within: float) -> float:
            return self.arm.apart(k, self.places(tick)[k], thing, self.where(number, tick), within)

        return self.minimum(distance_at, gone, apart - self._come(gone), best)

    def minimum(self, apart: Callable[[int, float], float], gone: FloatArray, least: FloatArray, best: float) -> float:
        """The minimum of a distance over all ticks; at most `best` [m].

        Args:
            apart: The distance at a tick, or something above `within` if it is more [m].
            gone: (ticks,) how far the two have come at most [m].
            least: (pieces,) lower bounds of the distance [m].
            best: Distances above need not be known [m].
        """
        stack = [self.edges[k] for k in np.argsort(-least) if least[k] < best]
        while stack:
            low, high = stack.pop()
            middle = (low + high) // 2
            come = max(gone[middle] - gone[low], gone[high] - gone[middle])
            found = apart(middle, best + come)
            best = min(best, found)
            if found - come < best:
                stack += [piece for piece in ((low, middle - 1), (middle + 1, high)) if piece[0] <= piece[1]]
        return best

    def _search(
        self, apart: Any, gone: FloatArray, pieces: Sequence[tuple[int, int]], least: float, names: tuple[str, str]
    ) -> Contact | None:
        """The contact of a pair in pieces of the motion, each halved where it is not free as a whole."""
        stack, touching = list(pieces), False
        while stack and not touching:
            a, c = stack.pop()
            m = (a + c) // 2
            come = max(gone[m] - gone[a], gone[c] - gone[m])
            found = apart(m, come)
            touching = found < -least
            if found <= come:
                stack += [piece for piece in ((a, m - 1), (m + 1, c)) if piece[0] <= piece[1]]
        if not touching:
            return None
        ticks = [tick for a, c in pieces for tick in range(a, c + 1)]
        depths = np.array([-apart(tick, 0.0) for tick in ticks])
        first = ticks[int(np.argmax(depths > least))]
        return Contact(*names, float(self.motion.times[first]), float(depths.max()))


def _seen(thing: Thing, base: Moves | None, clock: FloatArray) -> FloatArray:
    """(k, 4, 4) where an obstacle is at (k,) times, seen from the base."""
    place = thing.place.homogeneous
    poses = np.tile(place, (len(clock), 1, 1)) if thing.moves is None else thing.moves.at(clock) @ place
    return poses if base is None else np.linalg.inv(base.at(clock)) @ poses


def _placed(place: pin.SE3) -> coal.Transform3s:
    return coal.Transform3s(place.rotation, place.translation)


_REQUEST, _RESULT = coal.DistanceRequest(), coal.DistanceResult()


def distance(first: Any, at: pin.SE3, second: Any, where: pin.SE3) -> float:
    """Signed distance of two shapes [m]; triangles that cut triangles are told as `CUT_M` deep."""
    _RESULT.clear()
    apart = float(coal.distance(first, _placed(at), second, _placed(where), _REQUEST, _RESULT))
    hollow = isinstance(first, coal.BVHModelBase) and isinstance(second, coal.BVHModelBase)
    return -CUT_M if hollow and apart <= 0.0 else apart


def _hull(vertices: FloatArray) -> Any:
    points = coal.StdVec_Vec3s()
    for point in vertices:
        points.append(point)
    return coal.Convex.convexHull(points, True, "Qt")


def _solid(vertices: FloatArray, faces: Any) -> Any:
    """A mesh as it was given: its triangles, or its hull where it is convex."""
    corners = vertices[faces]
    volume = float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0)
    if abs(volume - ConvexHull(vertices).volume) <= _CONVEX * abs(volume):
        return _hull(vertices)
    tree = coal.BVHModelOBBRSS()
    tree.beginModel(len(faces), len(vertices))
    tree.addVertices(vertices)
    tree.addTriangles(faces.astype(np.int32))
    tree.endModel()
    return tree
