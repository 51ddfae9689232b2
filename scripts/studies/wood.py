"""Trees that bend in MuJoCo, against beam theory and against the bounds of contact.

`wood_static` pushes random points of random limbs with a force across the limb, in equilibrium. `wood_moving` moves a
ball or a capsule against a random limb, up to a permitted depth, with speeds as planned. `wood_picks` plans certified
picks and executes them.
"""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.measure import planned

from hplan.apps.execution.bending_wood import BendingTrees, WoodBodies, set_solver
from hplan.apps.execution.simulated_arm import Plant, import_mujoco
from hplan.apps.execution.simulation import Pick, execute, picks_in
from hplan.apps.execution.tree_response import TreeMonitor
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.certificate.certificate import Certificate
from hplan.certificate.goal_displacement import Grasp, displacement_at
from hplan.certificate.segment_contacts import CONTACT, SegmentContacts
from hplan.collision.coal_scene import base_contacts
from hplan.collision.compliant_solids import LIMB_SHARE
from hplan.errors import InputError
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import reachable
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.limbs import Limbs, find_parents
from hplan.scene.model import Goal, Scene, Start, with_limbs
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.orchard import MeasuredOptions, import_tree, measured_orchard
from hplan.scene.wood import Wood
from hplan.trajectory.trajectory import Trajectory

#: Minimum distance of a push from the start of its segment, in radii: nearer to it, limbs do not bend like beams.
NEAREST_RADII = 4.0

#: Maximum deflection, relative to the length of wood between the push and the clamp.
MOST_DEFLECTION = 0.1

#: Maximum error of the compliance.
TOLERANCE = 0.05


@dataclass(frozen=True)
class TreePush:
    """A push of a tree, or a pick from it: its name, its tree's file and its random seed."""

    name: str
    tree: Path
    seed: tuple[int, ...]

    @property
    def random(self) -> np.random.Generator:
        """Random number generator of the push."""
        return np.random.default_rng(self.seed)


def tree_pushes(config: StudyConfig) -> Iterable[TreePush]:
    """Pushes or picks of each tree; `count` is the number for each."""
    return [
        TreePush(f"{file.stem}: {number}", file, (config.seed, row, number))
        for row, file in enumerate(sorted((config.trees or Path()).glob("*.csv")))
        for number in config.numbers
    ]


@lru_cache(maxsize=32)
def _limbs(file: Path) -> tuple[Limbs, Wood]:
    """Limbs of a tree, and its wood.

    Wood is clamped from 8 mm of radius on; if that is almost all of the tree, from the radius that 60 % do not exceed.
    """
    capsules = import_tree(file)[0]
    radius = [piece.radius for piece in capsules]
    clamp = max(Wood().clamp_radius, float(np.quantile(radius, 0.6)) * (1.0 + 1e-9))
    parents = find_parents(capsules)
    grown = [piece.copy_unchecked({"parent": parents.get(piece.name)}) for piece in capsules]
    return Limbs.of(grown, clamp), Wood(clamp_radius=clamp)


class _Equilibrium:
    """A limb in MuJoCo that is pushed at a point, in equilibrium."""

    def __init__(self, limbs: Limbs, wood: Wood, trees: BendingTrees, number: int, along: float) -> None:
        mujoco = import_mujoco()
        spec = mujoco.MjSpec()
        # With implicit damping, steps of this length are Newton's steps to the equilibrium [s].
        spec.option.timestep = 1.0
        bodies = WoodBodies(mujoco, spec, limbs, wood, trees)
        bodies.add_limbs([limbs.names[number]])
        self._mujoco, self._model = mujoco, spec.compile()
        self._data = mujoco.MjData(self._model)
        bodies.finish(self._model, self._data)
        carrier = bodies.carrier(number, along)
        self._body = self._model.body(carrier.body.name).id
        self._local = limbs.start[number] + along * limbs.axis[number] - carrier.origin

    def displacement(self, force: FloatArray) -> FloatArray:
        """(3,) displacement of the point by a force [m]."""
        self._mujoco.mj_resetData(self._model, self._data)
        self._mujoco.mj_forward(self._model, self._data)
        start = before = self._point()
        for _ in range(100):
            lever = self._point() - self._data.xipos[self._body]
            self._data.xfrc_applied[self._body] = [*force, *np.cross(lever, force)]
            self._mujoco.mj_step(self._model, self._data)
            self._mujoco.mj_forward(self._model, self._data)
            if np.linalg.norm(self._point() - before) < 1e-12:
                break
            before = self._point()
        return self._point() - start

    def _point(self) -> FloatArray:
        found: FloatArray = self._data.xpos[self._body] + self._data.xmat[self._body].reshape(3, 3) @ self._local
        return found


def _static(_: StudyConfig, push: TreePush) -> Row:
    """Displacement by a force across a limb, relative to beam theory."""
    random, (limbs, wood) = push.random, _limbs(push.tree)
    long_enough = ~limbs.clamped & (limbs.length > NEAREST_RADII * limbs.radius)
    number = int(random.choice(np.flatnonzero(long_enough)))
    length = float(limbs.length[number])
    along = float(random.uniform(NEAREST_RADII * limbs.radius[number], length))
    modulus_gpa = float(random.uniform(*wood.youngs_modulus_gpa))
    direction = np.cross(random.normal(size=3), limbs.axis[number])
    direction /= np.linalg.norm(direction)
    compliance = limbs.compliance(number, along / length, 1e9 * modulus_gpa)[:, :3] @ direction
    unit, turn = compliance[:3], float(np.linalg.norm(compliance[3:]))
    share = float(random.uniform(0.0, MOST_DEFLECTION))
    force = share * _arc(limbs, number, along) / np.linalg.norm(unit)
    limb = _Equilibrium(limbs, wood, BendingTrees(youngs_modulus_gpa=modulus_gpa), number, along)
    # A thousandth of the force shows the compliance at rest.
    small, whole = (limb.displacement(part * force * direction) / (part * force) for part in (1e-3, 1.0))
    expected = float(unit @ direction)
    at_rest, error = (abs(float(found @ direction) / expected - 1.0) for found in (small, whole))
    return {
        "name": push.name, "tree": push.tree.stem, "at_rest_error": at_rest, "error": error, "deflection": share,
        "rotation_rad": turn * force,
        "within": error <= TOLERANCE, "fault": not at_rest <= TOLERANCE,
    }  # fmt: skip


def _arc(limbs: Limbs, number: int, along: float) -> float:
    """Length of wood between a point and its clamp [m]."""
    path = limbs.path(number)
    below = [float((limbs.joint[child] - limbs.start[on]) @ limbs.axis[on]) for child, on in itertools.pairwise(path)]
    return along + sum(below)


WOOD_STATIC = Study(
    "wood_static",
    "compliance of limbs in MuJoCo against beam theory, on measured trees (--trees); count for each tree",
    _static,
    ("at_rest_error", "error", "within", "deflection", "rotation_rad"),
    problems=tree_pushes,
    by="tree",
    count=(60, 2),
    needs=("trees",),
    peers=(),
    warm=0,
)


# Pushes in motion.

#: Deceleration of a body that stops in a limb [m/s^2], and time that it stays there [s].
DECELERATION, STAY_S = 10.0, 0.08

#: Range of the body's speed [m/s].
SPEEDS = (0.15, 1.2)

#: Step of the simulation, and of the motions that are checked for their depths [s].
STEP_S, CHECK_S = 2.5e-4, 2e-3

#: Steps of the simulation between measurements of the fruit.
FRUIT_STEPS = 8

#: Distance from which on a motion is simulated [m].
BEFORE_M = 2e-3

#: Limbs that share a root bend together up to this number; of more, those on the way from the contact to the clamp.
MOST_BENDING = 12

#: Attempts to find a motion within the permitted depths.
ATTEMPTS = 200


@dataclass(frozen=True, eq=False)
class _Scene:
    """A tree with the solids that a pushing body meets.

    Attributes:
        limbs: Its limbs.
        scene: The scene.
        limits: Limits of the solids that may be pushed, by number.
        is_limb: (k,) True for parts of limbs.
        segments: (k,) limb segment of each part; -1 for others.
        targets: Numbers of the parts of each limb.
        start: (k, 3) first ends of the solids' axes [m].
        end: (k, 3) last ends [m].
        radius: (k,) radii [m].
        depth: (k,) permitted depths [m].
        spans: (k,) half lengths of the axes [m].
        hanging: Limits of the hanging fruit, by name.
    """

    limbs: Limbs
    scene: Scene
    limits: Mapping[int, ContactLimit]
    is_limb: BoolArray
    segments: IntArray
    targets: tuple[IntArray, ...]
    start: FloatArray
    end: FloatArray
    radius: FloatArray
    depth: FloatArray
    spans: FloatArray
    hanging: Mapping[str, ContactLimit]


@lru_cache(maxsize=4)
def _tree_scene(file: Path) -> _Scene:
    """A tree with its fruit."""
    limbs, wood = _limbs(file)
    capsules, fruits = import_tree(file)
    rest = Start(joints_deg=(0.0,)), Goal(joints_deg=(0.0,))
    scene = with_limbs(Scene(name=file.stem, start=rest[0], goal=rest[1], obstacles=capsules, fruits=fruits), wood)
    solids = tuple(solid for solid in scene.solids if solid.meets != "others")
    limits = {row: solid.contact_limit for row, solid in enumerate(solids) if solid.contact_limit is not None}
    is_limb = np.zeros(len(solids), dtype=np.bool_)
    is_limb[[row for row, limit in limits.items() if limit.depth > 0.0 and limit.swing == 0.0]] = True
    segments = np.array([limits[row].segment if row in limits else -1 for row in range(len(solids))], dtype=np.int64)
    targets = tuple(np.flatnonzero(is_limb & (segments == row)) for row in np.unique(segments[is_limb]))
    start, end = (np.array([solid.core[at] for solid in solids]) for at in (0, -1))
    return _Scene(
        limbs, scene, limits, is_limb, segments, targets, start, end, np.array([solid.rounding for solid in solids]),
        np.array([solid.yields for solid in solids]), 0.5 * np.linalg.norm(end - start, axis=1),
        {solids[row].name: limit for row, limit in limits.items() if limit.mass > 0.0},
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Body:
    """A ball or capsule that moves without rotation.

    Attributes:
        half: (3,) half of its axis [m]; zero for a ball.
        radius: Radius [m].
        time: (k,) times [s].
        position: (k, 3) positions of its middle [m].
        speed: (k,) speeds [m/s].
    """

    half: FloatArray
    radius: float
    time: FloatArray
    position: FloatArray
    speed: FloatArray

    def at(self, kept: slice) -> _Body:
        """The body at some of its times."""
        return replace(self, time=self.time[kept], position=self.position[kept], speed=self.speed[kept])

    def depths(self, tree: _Scene, rows: IntArray) -> FloatArray:
        """(k, rows) depths in some undeformed solids over time; negative for distances [m]."""
        # Distances from points of the body's axis 4 mm apart exceed those from the axis by at most 0.1 mm.
        count = 1 + 2 * math.ceil(float(np.linalg.norm(self.half)) / 4e-3)
        start, along, radius = tree.start[rows], tree.end[rows] - tree.start[rows], tree.radius[rows]
        square = np.maximum(np.einsum("nj,nj->n", along, along), 1e-18)
        found = np.full((len(self.time), len(rows)), -np.inf)
        for share in np.linspace(-1.0, 1.0, count) if count > 1 else (0.0,):
            offset = (self.position + share * self.half)[:, None] - start
            at = np.clip(np.einsum("knj,nj->kn", offset, along) / square, 0.0, 1.0)
            distance = np.linalg.norm(offset - at[:, :, None] * along, axis=2)
            np.maximum(found, self.radius + radius - distance, out=found)
        return found


def _moving(config: StudyConfig, push: TreePush) -> Row | None:
    """Largest force and stress of a push in motion, relative to their bounds; None without room for a motion."""
    random, tree = push.random, _tree_scene(push.tree)
    if not tree.targets:
        return None
    found = next((drawn for _ in range(ATTEMPTS) if (drawn := _draw(random, tree)) is not None), None)
    if found is None:
        return None
    body, pushed = found
    wood, loads, bent = tree.scene.wood or Wood(), pushed.loads, pushed.stresses
    modulus_gpa = float(random.uniform(*wood.youngs_modulus_gpa))
    fruits = tree.scene.fruits if config.values.get("fruit", (1,))[0] else ()
    monitor, moved = _simulate(tree, body, set(loads.segment.tolist()), modulus_gpa, fruits)
    forces: dict[str, float] = defaultdict(float)
    for segment, force in zip(loads.segment.tolist(), loads.force.tolist(), strict=True):
        name = tree.limbs.names[segment]
        forces[name] = max(forces[name], force)
    contacts = monitor.response({}).contacts
    force_ratio = max((one.force_n / forces[one.limb] for one in contacts if one.limb in forces), default=0.0)
    roots = tree.limbs.roots()
    stresses = np.array([
        monitor.max_stress_pa[roots == root].max() for root in loads.root[bent.order[bent.first]].tolist()
    ])  # fmt: skip
    stress_ratio = float((stresses / bent.stress).max())
    depths = dict[str, float]()
    for number, depth in zip(pushed.rows["limit"].tolist(), pushed.rows["depth"].tolist(), strict=True):
        limit = pushed.limits[number]
        if limit is not None:
            name = tree.limbs.names[limit.segment]
            depths[name] = max(depths.get(name, 0.0), depth)
    deflections = [one.deflection_m / depths[one.limb] for one in contacts if one.limb in depths]
    fruit_ratio, fruit_m, fruit_bound_m = 0.0, 0.0, 0.0
    for name, distance in moved.items():
        bound = displacement_at(pushed, Grasp(name, tree.hanging[name], 1.0, 1.0)) if name in tree.hanging else 0.0
        if bound > 0.0 and distance / bound > fruit_ratio:
            fruit_ratio, fruit_m, fruit_bound_m = distance / bound, distance, bound
    return {
        "name": push.name, "tree": push.tree.stem, "touched": any(one.limb in forces for one in contacts),
        "force_ratio": force_ratio, "stress_ratio": stress_ratio, "fruit_ratio": fruit_ratio,
        "deflection_ratio": max(deflections, default=0.0), "fruit_mm": 1e3 * fruit_m,
        "fruit_bound_mm": 1e3 * fruit_bound_m,
        "force_n": max((one.force_n for one in contacts if one.limb in forces), default=0.0),
        "force_bound_n": max(forces.values()), "static_n": float(loads.static.max()),
        "stress_mpa": 1e-6 * float(stresses.max()), "stress_bound_mpa": 1e-6 * float(bent.stress.max()),
        # Limbs that moved into the body although it did not enter their place at rest.
        "other_force_n": max((one.force_n for one in contacts if one.limb not in forces), default=0.0),
        "speed_m_s": float(pushed.rows["speed"].max()), "modulus_gpa": modulus_gpa, "limbs": len(forces),
        "fault": force_ratio > 1.0 or stress_ratio > 1.0 or fruit_ratio > 1.0,
    }  # fmt: skip


def _draw(random: np.random.Generator, tree: _Scene) -> tuple[_Body, SegmentContacts] | None:
    """A motion of a body against a random limb, and its contacts; None if it is deeper than permitted anywhere."""
    limbs, target = tree.limbs, int(random.choice(tree.targets[int(random.integers(len(tree.targets)))]))
    limit = tree.limits[target]
    axis = limbs.axis[limit.segment]
    point = limbs.start[limit.segment] + float(random.uniform(*limit.along)) * axis
    across, tilt = _across(random, axis), float(random.uniform(-0.6, 0.6))
    normal = math.cos(tilt) * across + math.sin(tilt) * axis
    radius, length = float(random.uniform(0.02, 0.05)), float(random.uniform(0.03, 0.12))
    half = length * _across(random, normal) if random.random() < 0.5 else np.zeros(3)
    depth, speed = float(random.uniform(0.3, 1.0)) * limit.depth, float(random.uniform(*SPEEDS))
    deepest = point - normal * (radius + float(tree.radius[target]) - depth)
    if random.random() < 0.5:
        body = _stopping(half, radius, deepest, normal, speed, before=depth + 0.03)
    else:
        body = _passing(half, radius, deepest, _across(random, normal), speed)
    near = np.linalg.norm(0.5 * (tree.start + tree.end) - deepest, axis=1) < tree.spans + length + radius + 0.15
    rows = np.flatnonzero(near)
    most = np.minimum(tree.depth[near], LIMB_SHARE * (radius + tree.radius[near]))
    permitted = np.where(tree.is_limb[near], most, 0.0)
    if (body.at(slice(None, None, 8)).depths(tree, rows) > permitted).any():
        return None
    depths = body.depths(tree, rows)
    most = depths.max(axis=0)
    if (most > permitted).any() or depths[0].max() > -BEFORE_M:
        return None
    touched = np.flatnonzero(most > 0.0)
    if not len(touched):
        return None
    limits, contacts = [tree.limits[number] for number in rows[touched].tolist()], np.zeros(len(touched), CONTACT)
    contacts["limit"], contacts["share"] = np.arange(len(touched)), most[touched] / tree.depth[rows[touched]]
    contacts["depth"], contacts["end_s"] = most[touched], 1.0
    contacts["speed"] = [float(body.speed[depths[:, row] > -BEFORE_M].max()) for row in touched.tolist()]
    return body, SegmentContacts(contacts, ("body",), ("limb",), limits)


def _across(random: np.random.Generator, axis: FloatArray) -> FloatArray:
    """(3,) random direction across an axis."""
    found = np.cross(random.normal(size=3), axis)
    return found / np.linalg.norm(found)


def _stopping(
    half: FloatArray, radius: float, end: FloatArray, direction: FloatArray, speed: float, before: float
) -> _Body:
    """Body that comes from a distance [m], stops at a point and stays there."""
    braking = speed**2 / (2.0 * DECELERATION)
    start_speed = min(speed, math.sqrt(2.0 * DECELERATION * before))
    cruise = max(0.0, before - braking) / speed
    time = np.arange(0.0, cruise + start_speed / DECELERATION + STAY_S, CHECK_S)
    slow = np.clip(time - cruise, 0.0, start_speed / DECELERATION)
    along = np.minimum(time, cruise) * speed + start_speed * slow - 0.5 * DECELERATION * slow**2
    at = end + (along - before)[:, None] * direction
    return _Body(half, radius, time, at, np.where(time < cruise, speed, start_speed - DECELERATION * slow))


def _passing(half: FloatArray, radius: float, middle: FloatArray, direction: FloatArray, speed: float) -> _Body:
    """Body that passes a point at a constant speed."""
    before = 0.1
    time = np.arange(0.0, 2.0 * before / speed, CHECK_S)
    return _Body(half, radius, time, middle + (speed * time - before)[:, None] * direction, np.full(len(time), speed))


def _simulate(
    tree: _Scene, body: _Body, segments: set[int], modulus_gpa: float, fruits: Sequence[Fruit]
) -> tuple[TreeMonitor, dict[str, float]]:
    """Move the body through the limbs in MuJoCo; also returns the largest displacement of each fruit [m]."""
    limbs, mujoco = tree.limbs, import_mujoco()
    roots = limbs.roots()
    family = np.isin(roots, roots[list(segments)])
    if family.sum() > MOST_BENDING:
        family[:] = False
        family[list(segments)] = True
    names = {limbs.names[row] for row in np.flatnonzero(family).tolist()}
    spec = mujoco.MjSpec()
    spec.option.timestep = STEP_S
    set_solver(mujoco, spec, sleeps=False)
    bodies = WoodBodies(mujoco, spec, limbs, tree.scene.wood or Wood(), BendingTrees(youngs_modulus_gpa=modulus_gpa))
    bodies.add_limbs(names)
    bodies.add_fruits(fruits, (), without_contact=[fruit.name for fruit in fruits])
    pusher = spec.worldbody.add_body(name="pusher", gravcomp=1.0)
    for axis in np.eye(3):
        pusher.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    kinds, size = mujoco.mjtGeom, [body.radius, 0.0, 0.0]
    shape: dict[str, Any] = {"type": kinds.mjGEOM_SPHERE, "size": size}
    if body.half.any():
        shape = {"type": kinds.mjGEOM_CAPSULE, "size": size, "fromto": [*-body.half, *body.half]}
    pusher.add_geom(name="pusher", mass=1e3, contype=1, conaffinity=0, **shape)
    model = spec.compile()
    data = mujoco.MjData(model)
    monitor = TreeMonitor(mujoco, model, data, bodies)
    row = int(model.body("pusher").dofadr[0]) + np.arange(3)
    at = int(model.jnt_qposadr[model.body("pusher").jntadr[0]]) + np.arange(3)
    obstacle_of = {int(model.geom(name).id): obstacle for name, obstacle in bodies.obstacle_of.items()}
    depths = body.depths(tree, np.flatnonzero(np.isin(tree.segments, list(segments))))
    first = max(0, int(np.argmax(depths.max(axis=1) > -BEFORE_M)) - 1)
    times = np.arange(body.time[first], body.time[-1], STEP_S)
    places = np.column_stack([np.interp(times, body.time, column) for column in body.position.T])
    farthest: dict[str, float] = defaultdict(float)
    for step, (place, following) in enumerate(itertools.pairwise(places)):
        data.qpos[at], data.qvel[row] = place, (following - place) / STEP_S
        mujoco.mj_step(model, data)
        contacts: dict[tuple[str, str], list[int]] = defaultdict(list)
        for number in range(data.ncon):
            obstacle = next(obstacle_of[geom] for geom in data.contact[number].geom.tolist() if geom in obstacle_of)
            contacts["pusher", obstacle].append(number)
        monitor.note(contacts)
        if step % FRUIT_STEPS == 0:
            for name, distance in monitor.fruit_displacement_m().items():
                farthest[name] = max(farthest[name], distance)
    return monitor, farthest


WOOD_MOVING = Study(
    "wood_moving",
    "pushes in motion in MuJoCo against the bounds of force and stress, on trees (--trees); count for each tree",
    _moving,
    (
        *(
            "touched",
            "force_ratio",
            "stress_ratio",
            "fruit_ratio",
            "fruit_mm",
            "deflection_ratio",
            "force_n",
            "force_bound_n",
            "static_n",
            "stress_mpa",
        ),
        *("stress_bound_mpa", "other_force_n", "speed_m_s", "limbs"),
    ),
    problems=tree_pushes,
    by="tree",
    count=(527, 1),
    needs=("trees",),
    peers=(),
    warm=0,
)


# Picks.

#: Ranges of the trees' distances from the arm, of their sideways distances [m], and of their turns [deg].
PICK_DISTANCES, PICK_SIDES, PICK_TURNS = (1.1, 1.6), (-0.6, 0.6), (0.0, 360.0)

#: One of this many fruit nearest to the arm is picked.
PICK_AMONG = 24

#: Picks are simulated from this time before the first contact [s].
PICK_BEFORE_S = 0.1

#: Displacements of less are rounding errors of the simulation [m].
ROUNDING_M = 1e-9

#: Tracking error that picks allow for [rad], and the simulated controller.
PICK_TRACKING_RAD, PICK_PLANT = 2e-5, Plant(bandwidth=200.0, decoupled=True)


def drawn_scene(config: StudyConfig, robot: Robot, problem: TreePush, random: np.random.Generator) -> Scene | None:
    """The tree at a random place; None if it stands in the arm.

    `--values clearance=0.02` sets the clearance from rigid obstacles [m]: a larger one leads to more pushes.
    """
    options = MeasuredOptions(
        distance=float(random.uniform(*PICK_DISTANCES)), yaw_deg=float(random.uniform(*PICK_TURNS))
    )
    tree = measured_orchard([problem.tree], options).shift((0.0, float(random.uniform(*PICK_SIDES)), 0.0))
    if base_contacts(robot, tree.solids):
        return None
    return with_limbs(tree).with_values(clearance=config.values.get("clearance", (tree.clearance,))[0])


def _drawn_pick(config: StudyConfig, robot: Robot, problem: TreePush) -> Scene | None:
    """A tree at a random place, with a random fruit that can be picked as the goal; None without any."""
    random = problem.random
    scene = drawn_scene(config, robot, problem, random)
    if scene is None:
        return None
    near = sorted(scene.fruits, key=lambda fruit: float(np.linalg.norm(fruit.center[:2])))[:PICK_AMONG]
    some = random.permutation([fruit.name for fruit in near]).tolist()
    with suppress(InputError):  # the arm has no room
        found = reachable(robot, scene, fruits=some) if some else {}
        name = next((name for name in some if found[name].can_be_picked), None)
        return None if name is None else scene.with_values(goal=Goal(fruit=name))
    return None


def _pick(config: StudyConfig, problem: TreePush) -> Row | None:
    """A certified pick, executed among trees that bend; forces relative to the certificate's bounds."""
    robot = config.arm("orchard_harvester")
    scene = _drawn_pick(config, robot, problem)
    if scene is None:
        return None
    options = PlanOptions(effort=config.effort, tracking_error=PICK_TRACKING_RAD)
    result, row = planned(robot, scene, options)
    row |= {"name": problem.name, "tree": problem.tree.stem}
    if result is None or not result.certificate.verified:
        return row
    (pick,) = picks_in(result.picked_fruit, result.phases)
    return row | run_pick(robot, scene, result.trajectory, result.certificate, pick, BendingTrees())


def run_pick(
    robot: Robot, scene: Scene, motion: Trajectory, certificate: Certificate, pick: Pick, trees: BendingTrees
) -> Row:
    """Execute a certified pick; forces, stresses and the fruit's displacement, and the certificate's bounds."""
    pushes, frames = certificate.pushes or (), robot.model.frames
    # Nothing moves before the first contact.
    touched_s = min([pick.touched_s, *(push.begin_s for push in pushes)]) - PICK_BEFORE_S
    duration_s = motion.duration
    motion = motion.cut_before(max(0, int(np.searchsorted(motion.time, touched_s)) - 1))
    begin_s = duration_s - motion.duration
    pick = pick._replace(touched_s=max(0.0, pick.touched_s - begin_s), picked_s=pick.picked_s - begin_s)
    bending = _moved_by(scene, [pick.fruit, *(push.obstacle for push in pushes)])
    executed = execute(robot, scene, motion, PICK_PLANT, trees=trees, picks=[pick], bending=bending)
    response = executed.trees
    assert response is not None
    forces, stresses = defaultdict[tuple[str, int], float](float), defaultdict[tuple[str, int], float](float)
    for push in pushes:
        key = push.obstacle, int(frames[robot.frame_number(push.link)].parentJoint)
        forces[key] = max(forces[key], push.force_n or 0.0)
        stresses[key] = max(stresses[key], push.stress_mpa or 0.0)
    force_ratio = stress_ratio = other_n = 0.0
    for one in response.contacts:
        key = one.limb, int(frames[robot.frame_number(one.link)].parentJoint)
        if key in forces:
            force_ratio = max(force_ratio, one.force_n / forces[key])
            stress_ratio = max(stress_ratio, one.stress_mpa / stresses[key] if stresses[key] else 0.0)
        else:  # it swung into the arm
            other_n = max(other_n, one.force_n)
    moved, bound = response.displacement_at(pick.fruit, pick.picked_s), certificate.goal_displacement_m
    return {
        "pushes": len(pushes), "contacts": len(response.contacts), "rigid_contacts": len(executed.contacts),
        "tracking_mrad": 1e3 * max(executed.max_tracking_error_rad),
        "force_n": max((one.force_n for one in response.contacts), default=0.0),
        "stress_mpa": max((one.stress_mpa for one in response.contacts), default=0.0),
        "force_ratio": force_ratio if response.contacts else None,
        "stress_ratio": stress_ratio if response.contacts else None,
        "goal_mm": None if moved is None else 1e3 * moved, "goal_bound_mm": None if bound is None else 1e3 * bound,
        "goal_ratio": moved / bound if moved is not None and bound else None,
        "broken": len(response.broken), "knocked_off": len(response.knocked_off),
        "within_limits": response.ok and not executed.contacts, "other_force_n": other_n,
        "fault": bool(
            not response.ok or force_ratio > 1.0 or stress_ratio > 1.0 or executed.contacts
            or (moved is not None and bound is not None and moved > bound + ROUNDING_M)
        ),
    }  # fmt: skip


def _moved_by(scene: Scene, touched: Sequence[str]) -> set[str]:
    """Names of some limbs and fruit, and of all limbs that share a root with them."""
    limbs, names = limbs_of(scene.obstacles, scene.wood or Wood()), set(touched)
    holds = [limbs.nearest(np.array(fruit.center), fruit.hangs_from) for fruit in scene.fruits if fruit.name in names]
    rows = [row for row, name in enumerate(limbs.names) if name in names] + [hold[0] for hold in holds if hold]
    roots = limbs.roots()
    return names | {limbs.names[row] for row in np.flatnonzero((roots >= 0) & np.isin(roots, roots[rows])).tolist()}


WOOD_PICKS = Study(
    "wood_picks",
    "certified picks executed among trees that bend (--trees); count for each tree",
    _pick,
    (
        *("certified", "ms", "duration_s", "pushes", "contacts", "rigid_contacts", "within_limits", "force_n"),
        *(
            "force_ratio",
            "stress_mpa",
            "stress_ratio",
            "goal_mm",
            "goal_bound_mm",
            "broken",
            "knocked_off",
        ),
    ),
    problems=tree_pushes,
    by="tree",
    count=(30, 1),
    needs=("trees",),
    peers=(),
    warm=0,
)
