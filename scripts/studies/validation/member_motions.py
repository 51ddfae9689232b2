"""Motions of one member of the family: certified, past grazing obstacles and past clear ones, and their counts."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from studies.validation.checker import ALWAYS, STANDS_M, PlacedBodies, between_rows, capsule, read_rows
from studies.validation.members import write_stl
from studies.validation.random_scenes import direction

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.planning.plan import PlanResult, plan
from hplan.problem.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.timing.trajectory import Trajectory, write_csv
from hplan.verification.certificate import certify

#: Depth of grazing and gap of clear obstacles [m].
DEPTHS, GAPS = (1e-4, 5e-3), (1e-3, 5e-3)

#: Steps of the grid by the number of links [deg].
STEPS = {1: 3.0, 2: 3.0, 3: 6.0, 4: 12.0, 5: 20.0}

#: Radius that obstacles begin with [m].
THIN = 1e-3

#: Motions are asked for until so many times as many as wanted were.
PATIENCE = 8


@dataclass
class MotionCounts:
    """What was counted of one member, or of all.

    Attributes:
        asked: Motions that were asked for.
        refused: Those that were refused, by the error.
        certified: Those that were certified and looked at.
        looks: Configurations that were looked at.
        contacts: Contacts in certified motions.
        grazing: Motions past a grazing obstacle.
        verified: Those of them that `certify` verified, wrongly.
        clear: Motions past a clear obstacle.
        unverified: Those of them that `certify` did not verify, wrongly.
        grazed: Which bodies grazed.
        members: Members of the family; those that could not be loaded by the error.
    """

    asked: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    certified: int = 0
    looks: int = 0
    contacts: list[dict[str, Any]] = field(default_factory=list)
    grazing: int = 0
    verified: list[dict[str, Any]] = field(default_factory=list)
    clear: int = 0
    unverified: list[dict[str, Any]] = field(default_factory=list)
    grazed: Counter[str] = field(default_factory=Counter)
    members: Counter[str] = field(default_factory=Counter)

    @property
    def ok(self) -> bool:
        """True if nothing was wrong."""
        return not (self.contacts or self.verified or self.unverified)

    def add(self, other: MotionCounts) -> None:
        """Count another one too."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    def as_dict(self) -> dict[str, Any]:
        """The numbers, ready for JSON."""
        numbers = {name: dict(value) if isinstance(value, Counter) else value for name, value in vars(self).items()}
        return {"ok": self.ok, **numbers}


class MemberMotions:
    """Motions of one member of the family: its bodies, and the counts."""

    def __init__(self, robot: Robot, folder: Path, rng: np.random.Generator, tally: MotionCounts, name: str) -> None:
        """Read the bodies of a member; counts go to `tally`, `name` is told in its examples."""
        self.robot, self.folder, self.rng, self.tally, self.name = robot, folder, rng, tally, name
        self.bodies = PlacedBodies(robot.urdf_path)
        self.pairs = self.bodies.own_pairs(rng)
        self.moving = [k for k in range(self.bodies.count) if not self.bodies.stands(k)]
        self.last = [
            k for k in range(self.bodies.count)
            if self.bodies.geometry.geometryObjects[k].parentJoint == self.bodies.model.njoints - 1
        ]  # fmt: skip

    def configuration(self) -> FloatArray:
        """At random within the limits, where no own pair touches."""
        while True:
            q: FloatArray = self.rng.uniform(self.robot.lower, self.robot.upper)
            if not self.pairs or self.bodies.distances(q[None], self.pairs).min() > 0.02:
                return q

    # Certified motions

    def certified_motions(self, wanted: int) -> None:
        """Ask for motions among obstacles until so many were certified, and look at each."""
        most = self.tally.asked + PATIENCE * wanted
        while wanted > 0 and self.tally.asked < most:
            self.tally.asked += 1
            start, goal = self.configuration(), self.configuration()
            path = self.scene(start, goal)
            options = PlanOptions(step_deg=STEPS[self.robot.arm.link_count])
            try:
                result = plan(self.robot, load_scene(path), options)
            except HplanError as error:
                self.tally.refused[error.kind] += 1
                continue
            self.tally.certified += 1
            wanted -= 1
            self.look_at(result, path)

    def scene(self, start: FloatArray, goal: FloatArray) -> Path:
        """Obstacles of all kinds that are clear of the arm at start and goal."""
        numbers: dict[str, Any] = {"format": "hplan-scene/1", "name": "drawn"}
        numbers["start"] = {"joints_rad": start.tolist()}
        numbers["goal"] = {"joints_rad": goal.tolist()}
        numbers["obstacles"] = [self.obstacle(k) for k in range(int(self.rng.integers(3, 16)))]
        if self.rng.random() < 0.25:
            center = self.robot.tool_positions(goal).tolist()
            numbers["fruits"] = [{"name": "fruit", "center": center, "radius": 0.04}]
            numbers["goal"] = {"fruit": "fruit"}
        if self.robot.has_yaw and "fruit" not in numbers["goal"] and self.rng.random() < 0.1:
            goal = goal.copy()
            goal[0] = start[0]
            numbers["goal"], numbers["locked_joints"] = {"joints_rad": goal.tolist()}, [self.robot.joint_names[0]]
        path = self.folder / "scene.json"
        path.write_text(json.dumps(numbers), "utf-8")
        bodies = PlacedBodies(self.robot.urdf_path, path, fruits=False)
        others = range(bodies.count, bodies.count + len(bodies.obstacles))
        pairs = [(k, other) for k in range(bodies.count) for other in others]
        near = bodies.distances(np.stack([start, goal]), pairs).min(axis=0) < 0.01
        bad = {
            bodies.obstacles[pair[1] - bodies.count] for pair, each in zip(pairs, near.tolist(), strict=True) if each
        }
        numbers["obstacles"] = [item for item in numbers["obstacles"] if item["name"] not in bad]
        path.write_text(json.dumps(numbers), "utf-8")
        return path

    def obstacle(self, number: int) -> dict[str, Any]:
        """One of any kind, about where the arm reaches."""
        rng, reach = self.rng, float(self.robot.arm.lengths.sum())
        center = self.robot.plane_origin + direction(rng) * rng.uniform(0.2, 0.9) * reach
        item: dict[str, Any] = {"name": f"o{number}"}
        kind = ("sphere", "capsule", "box", "mesh", "points")[int(rng.integers(5))]
        turn, size = rng.uniform(-180.0, 180.0, 3).tolist(), float(rng.uniform(0.02, 0.12)) * min(1.0, reach)
        if kind == "sphere":
            return {**item, "kind": kind, "center": center.tolist(), "radius": size}
        if kind == "capsule":
            end = center + direction(rng) * rng.uniform(0.2, 1.0)
            return {**item, "kind": kind, "from": center.tolist(), "to": end.tolist(), "radius": 0.4 * size}
        if kind == "box":
            sizes = (rng.uniform(0.5, 3.0, 3) * size).tolist()
            return {**item, "kind": kind, "center": center.tolist(), "size": sizes, "rpy_deg": turn}
        points = rng.uniform(-1.0, 1.0, (16, 3)) * rng.uniform(0.7, 2.0, 3) * size
        name = f"{kind}-{number}.{'stl' if kind == 'mesh' else 'xyz'}"
        placed = {**item, "kind": kind, "file": name, "position": center.tolist(), "rpy_deg": turn}
        if kind == "mesh":
            write_stl(self.folder / name, points)
            return placed
        np.savetxt(self.folder / name, points, fmt="%.9f")
        return {**placed, "radius": 0.25 * size}

    def look_at(self, result: PlanResult, scene: Path) -> None:
        """Look at every millisecond of an exported motion."""
        times, q = self.exported(result.trajectory)
        self.tally.looks += len(q)
        bodies = PlacedBodies(self.robot.urdf_path, scene)
        others = {name: bodies.count + k for k, name in enumerate(bodies.obstacles)}
        fruit = result.motion.task.scene.goal.fruit
        rigid = [k for k in range(bodies.count) if not bodies.stands(k)]
        standing = [k for k in range(bodies.count) if bodies.stands(k)]
        numbers = list(range(bodies.count, bodies.count + len(bodies.obstacles)))
        target = None if fruit is None else others[fruit]
        apart = [(k, other) for k in rigid for other in numbers if not (other == target and k in self.last)]
        checks = [
            (times, q, self.pairs, 0.0),
            (times, q, apart, 0.0),
            (times[:1], q[:1], [(k, other) for k in standing for other in numbers if other != target], -STANDS_M),
        ]
        if target is not None:
            phases = {phase.name: phase.end_s for phase in result.phases}
            until = phases["transit"] if "approach" in phases else 0.0
            before = times <= until + 1e-9
            checks.append((times[before], q[before], [(k, target) for k in self.last], 0.0))
        for instants, configurations, pairs, margin in checks:
            touch = bodies.first_touch(instants, configurations, pairs, margin) if len(instants) else None
            if touch is not None:
                self.tally.contacts.append(
                    {"member": self.name, "asked": self.tally.asked, **vars(touch), "scene": scene.read_text("utf-8")}
                )

    def exported(self, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
        """Times and configurations, in Pinocchio's order, of what is written as CSV."""
        path = self.folder / "trajectory.csv"
        write_csv(trajectory, path)
        names, time, position, velocity = read_rows(path)
        times, q = between_rows(time, position, velocity)
        ordered = np.empty_like(q)
        ordered[:, self.bodies.joint_order(names)] = q
        return times, ordered

    # Grazing and clear obstacles

    def grazing_motions(self, grazing: int, clear: int) -> None:
        """Put so many grazing and clear obstacles next to motions, each motion a few times."""
        tries = PATIENCE * max(grazing, clear)
        while (grazing > 0 or clear > 0) and tries > 0:
            tries -= 1
            scene = self.free(self.configuration(), self.configuration())
            try:
                motion = plan(self.robot, scene, PlanOptions(step_deg=STEPS[self.robot.arm.link_count]))
            except HplanError:
                continue
            times, q = self.exported(motion.trajectory)
            if len(q) < 2:
                continue
            for _ in range(3):
                if grazing > 0:
                    grazing -= self.graze(scene, motion.trajectory, times, q)
                if clear > 0:
                    clear -= self.pass_by(scene, motion.trajectory, q)

    def free(self, start: FloatArray, goal: FloatArray) -> Scene:
        """A task without obstacles."""
        numbers = {"start": {"joints_rad": start.tolist()}, "goal": {"joints_rad": goal.tolist()}, "name": "drawn"}
        path = self.folder / "free.json"
        path.write_text(json.dumps({"format": "hplan-scene/1", **numbers}), "utf-8")
        return load_scene(path)

    def graze(self, scene: Scene, trajectory: Trajectory, times: FloatArray, q: FloatArray) -> bool:
        """One grazing obstacle; whether it could be placed."""
        depth = float(np.exp(self.rng.uniform(*np.log(DEPTHS))))
        target = self.moving[int(self.rng.integers(len(self.moving)))]
        found = self.placed(self.bodies.geometry, target, q, -depth)
        if found is None:
            return False
        item, body, row = found
        if body not in self.moving or self.stands_on(item, body, depth):
            return False
        self.tally.grazing += 1
        self.tally.grazed[_kind(self.bodies.names[body])] += 1
        if certify(self.robot, self.with_obstacle(scene, item), trajectory).verified:
            case = {"member": self.name, "depth_m": depth, "body": self.bodies.names[body], "time_s": float(times[row])}
            self.tally.verified.append({**case, "obstacle": item})
        return True

    def stands_on(self, item: dict[str, Any], body: int, depth: float) -> bool:
        """True if a body of the turret is in an obstacle at every yaw, no deeper than it may stand in one."""
        if not self.robot.has_yaw or self.bodies.geometry.geometryObjects[body].parentJoint != 1 or depth > STANDS_M:
            return False
        path = self.folder / "stands.json"
        path.write_text(json.dumps({"obstacles": [item]}), "utf-8")
        q = np.tile(self.bodies.model.lowerPositionLimit, (ALWAYS, 1))
        q[:, 0] = np.linspace(self.robot.lower[0], self.robot.upper[0], ALWAYS)
        among = PlacedBodies(self.robot.urdf_path, path)
        return bool((among.distances(q, [(body, among.count)]) < 0.0).all())

    def pass_by(self, scene: Scene, trajectory: Trajectory, q: FloatArray) -> bool:
        """One clear obstacle; whether it could be placed."""
        gap = float(np.exp(self.rng.uniform(*np.log(GAPS))))
        shapes = self.modelled()
        target = int(self.rng.integers(len(shapes.geometryObjects)))
        found = self.placed(shapes, target, q, gap)
        if found is None:
            return False
        item, body, _ = found
        self.tally.clear += 1
        certificate = certify(self.robot, self.with_obstacle(scene, item), trajectory)
        if not certificate.verified:
            case = {"member": self.name, "gap_m": gap, "body": shapes.geometryObjects[body].name}
            self.tally.unverified.append({**case, "obstacle": item, "violations": list(certificate.violations)})
        return True

    def modelled(self) -> pin.GeometryModel:
        """The bodies that do not move with a link, and capsules for those that do."""
        model, arm, geometry = self.bodies.model, self.robot.arm, pin.GeometryModel()
        first = model.njoints - arm.link_count
        for shape in self.bodies.geometry.geometryObjects:
            if shape.parentJoint < first:
                geometry.addGeometryObject(shape)
        tool = model.frames[model.getFrameId(self.robot.tool_frame)].placement.translation
        ends = [model.jointPlacements[joint].translation for joint in range(first + 1, model.njoints)]
        normal = np.cross(*self.robot.plane_axes)
        for k, end in enumerate([*ends, tool]):
            # Joints turn about y: what is at the tool's y, or beside it, is so in every joint's frame at all angles.
            aside = sum(float(each[1]) for each in [*ends, tool][k:]) + float(arm.lateral[k] * normal[1])
            start, stop = np.array([0.0, aside, 0.0]), np.array([end[0], aside, end[2]])
            body, place = capsule(start, stop, float(arm.half_widths[k]))
            geometry.addGeometryObject(pin.GeometryObject(f"capsule_{k}", first + k, place, body))
        return geometry

    def placed(
        self, shapes: pin.GeometryModel, target: int, q: FloatArray, distance: float
    ) -> tuple[dict[str, Any], int, int] | None:
        """An obstacle whose least distance from shapes over a motion is the one asked for.

        Args:
            shapes: The shapes.
            target: The one near which it is placed at first.
            q: (m, nq) configurations of the motion.
            distance: Distance asked for, negative for depth [m].

        Returns:
            The obstacle as in a scene, the shape that is nearest and at which configuration; None where what was drawn
            cannot be placed so.
        """
        rng, data = self.rng, self.bodies.model.createData()
        results = shapes.createData()
        row = int(rng.integers(len(q)))
        pin.updateGeometryPlacements(self.bodies.model, data, shapes, results, q[row])
        shape = shapes.geometryObjects[target]
        shape.geometry.computeLocalAABB()
        middle = results.oMg[target].act(np.array(shape.geometry.aabb_center))
        center = middle + direction(rng) * (float(shape.geometry.aabb_radius) * rng.uniform(0.2, 1.0) + 0.05)
        kind = ("sphere", "capsule", "box")[int(rng.integers(3))]
        turn = rng.uniform(-180.0, 180.0, 3)
        if kind == "box":
            size = rng.uniform(0.02, 0.15, 3)
            return self._box(shapes, q, distance, center, size, turn)
        end = center + direction(rng) * rng.uniform(0.05, 0.4) if kind == "capsule" else center
        body, place = (
            capsule(center, end, THIN) if kind == "capsule" else (coal.Sphere(THIN), pin.SE3(np.eye(3), center))
        )
        nearest, body_number, at_row, _ = self._least(shapes, q, body, place)
        radius = THIN + nearest - distance
        if nearest < 0.005 or not 0.008 < radius < 0.4:
            return None  # it is inside, or would be no obstacle of any size
        item: dict[str, Any] = {"name": "drawn", "kind": kind, "radius": radius}
        if kind == "sphere":
            return {**item, "center": center.tolist()}, body_number, at_row
        return {**item, "from": center.tolist(), "to": end.tolist()}, body_number, at_row

    def _box(
        self, shapes: pin.GeometryModel, q: FloatArray, distance: float, center: FloatArray, size: FloatArray,
        turn: FloatArray,
    ) -> tuple[dict[str, Any], int, int] | None:  # fmt: skip
        """A box moved until its least distance is the one asked for, to a twentieth of it."""
        body, rotation = coal.Box(*size.tolist()), pin.rpy.rpyToMatrix(*np.radians(turn))
        for _ in range(12):
            nearest, number, row, away = self._least(shapes, q, body, pin.SE3(rotation, center))
            if abs(nearest - distance) <= 0.05 * abs(distance):
                item = {"name": "drawn", "kind": "box", "center": center.tolist(), "size": size.tolist()}
                return {**item, "rpy_deg": turn.tolist()}, number, row
            center = center + away * (distance - nearest)
        return None

    def _least(
        self, shapes: pin.GeometryModel, q: FloatArray, body: Any, place: pin.SE3
    ) -> tuple[float, int, int, FloatArray]:
        """Least distance of an obstacle, from which shape, at which configuration, and the direction away from it."""
        geometry = shapes.copy()
        geometry.removeAllCollisionPairs()
        other = geometry.addGeometryObject(pin.GeometryObject("drawn", 0, place, body))
        for number in range(other):
            geometry.addCollisionPair(pin.CollisionPair(number, other))
        model = self.bodies.model
        data, results = model.createData(), geometry.createData()
        best, shape, row, away = math.inf, -1, -1, np.zeros(3)
        for k, each in enumerate(q):
            pin.updateGeometryPlacements(model, data, geometry, results, each)
            which = pin.computeDistances(geometry, results)
            found = results.distanceResults[which]
            if found.min_distance < best:
                best, shape, row = found.min_distance, which, k
                away = np.array(found.normal)
        return best, shape, row, away

    def with_obstacle(self, scene: Scene, item: dict[str, Any]) -> Scene:
        """The scene with one obstacle."""
        numbers = {"format": "hplan-scene/1", "name": "drawn", "obstacles": [item]}
        ends = {name: {"joints_rad": getattr(scene, name).configuration.tolist()} for name in ("start", "goal")}
        path = self.folder / "one.json"
        path.write_text(json.dumps({**numbers, **ends}), "utf-8")
        return load_scene(path)


def _kind(name: str) -> str:
    """Kind of a body: its name without its number."""
    return name.rstrip("0123456789").rstrip("_").removesuffix("_0")
