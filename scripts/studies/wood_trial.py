"""A field trial in simulation: an arm picks from trees that bend in the wind, with errors.

The planner sees each tree from a base that is off, and fruit with camera noise. It plans all motions before the first
one is executed on an arm whose masses differ from the model's (`hplan.apps.execution.field_errors`). Limbs bend and
sway in the wind, and fruit hang from stalks that break.

After the base has stopped, the camera takes `LOOKS` frames, and the tree is registered to their mean.

Each of three planners picks up to `FRUITS` of the fruit that it finds reachable. hplan's tours know how wood bends.
They are certified for three standard deviations of the perceived positions, which cover the errors of base and
camera, and for the tracking error. `--values sigmas=0 looks=0 tracking=0.0003` changes them.

The tracking error allowed for is 1 mrad: wrong masses cause up to 0.2 mrad, and each newton at the hand moves the wrist
by 0.08 mrad, so the permitted 10 N take 1 mrad. Only twice the bandwidth would push 10 N back to 0.3 mrad; the present
32 Hz are already as high as position loops of such arms get. At nine stops on wires 1 mrad leaves 82 of the 103 fruit
that 0.3 mrad allows, as many an hour.

The trees sway in the wind before the motion begins. Of the limbs only those move whose place at rest, displaced by a
gust of three standard deviations, comes within 50 mm of the arm, and only around that time unless they are soft. Fruit
hang likewise. Others are rigid and at rest, can be touched, and touches are counted (`held_contacts`). `--values
moves_all=1` lets the limbs move all the time.

With `--values sway=1` certificates also cover limbs and fruit that such a gust displaces by more than `LEAST_SWAY_M`:
the arm keeps clear of the volume that each sweeps along the displacement of its end that moves farther, and does not
push it. Limbs in resonance move farther.
With `--values minutes=10` the base stops at random places around trees of the same kind until the motions and grips of
a planner have taken that long; `--values stops=3` ends after the first three places, the same for all planners, and
`stops=200,300` tries the hundred from number 200 on.
The recipe of MoveIt is RRTConnect, simplified and timed by toppra, with a padding of `PADDING_M`: once with all wood
rigid, once without the wood that is thinner than the clamp radius. It picks the nearest fruit next and stops at
stand-offs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from studies.harness import Row, Study, StudyConfig, evenly_chosen
from studies.measure import timed
from studies.peers import ompl_path, seed_ompl, toppra_motion, world_of

from hplan.apps.execution.bending_wood import BendingTrees, WoodBodies
from hplan.apps.execution.field_errors import SIGMAS, FieldErrors
from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, Plant, SimulatedArm, import_mujoco
from hplan.apps.execution.simulation import find_near
from hplan.apps.execution.tree_response import TreeMonitor
from hplan.apps.execution.wind import Wind
from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import base_contacts
from hplan.errors import HplanError
from hplan.planning.grasps import Grasp
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import FruitReach, reachable
from hplan.robot.model import Robot
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.model import Goal, Scene, Start, with_limbs
from hplan.scene.obstacle_kind import Item, transform_fields
from hplan.scene.obstacles import Capsule
from hplan.scene.orchard import MeasuredOptions, measured_orchard
from hplan.scene.tracks import Sway
from hplan.scene.wood import Wood
from hplan.tour.tour import TourResult, plan_tour

#: Planners that are compared.
PLANNERS = ("hplan", "recipe, all rigid", "recipe, thin wood left out")

#: Distance of the trunk [m], maximum number of fruits to pick, and frames of the camera; --values distance, fruits and
#: looks override them.
DISTANCE_M, FRUITS, LOOKS = 1.2, 12, FieldErrors().looks

#: Distances of the trunk [m], and turns of the tree [deg], among which stops are drawn.
STOP_DISTANCES, STOP_TURNS = (1.0, 1.5), (0.0, 360.0)

#: Maximum number of stops.
MOST_STOPS = 200

#: Mean speed of the wind [m/s].
WIND_M_S = 3.0

#: Tracking error that motions allow for [rad], and the controller's bandwidth [rad/s].
TRACKING_RAD, BANDWIDTH = 0.001, 200.0

#: Maximum distance of a fruit from the tool at which the gripper takes it [m], and the time that it takes [s].
GRIPPER_M, GRIP_S = 0.03, 0.5

#: Simulation steps for each control period.
SUBSTEPS = 2

#: Limbs near the arm are searched once in this number of control periods.
_NEAR_ROWS = 20

#: Newton steps to the equilibrium of trees in wind.
SWAY_STEPS = 20

#: Limbs and fruit that a gust displaces by less may be pushed as in still air [m].
LEAST_SWAY_M = 0.005

#: Clearance of the recipe [m], and the CPU time to find each path [s].
PADDING_M, PATIENCE_S = 0.01, 3.0

_Item = TypeVar("_Item", bound=Item)


@dataclass(frozen=True)
class Trial:
    """A tree to pick from by a planner: the name, the tree's file, its number and the planner."""

    name: str
    tree: Path
    number: int
    planner: str


@dataclass(eq=False)
class _Work:
    """Motion of an arm that picks fruit.

    Attributes:
        clock: Times of the reference [s].
        position: Its configurations, the start first.
        grasps: Fruits and the times when they are grasped [s].
        ms: CPU time of planning [ms].
        certified: True if the motion is certified.
    """

    clock: FloatArray
    position: FloatArray
    grasps: list[tuple[str, float]] = field(default_factory=list)
    ms: float = 0.0
    certified: bool = False

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return float(self.clock[-1])

    def append(self, position: FloatArray) -> None:
        """Append configurations at the controller's period, without the first one."""
        more = self.duration + CONTROL_PERIOD * np.arange(1, len(position))
        self.clock, self.position = np.append(self.clock, more), np.vstack([self.position, position[1:]])


def _problems(config: StudyConfig) -> Iterable[Trial]:
    planners = [PLANNERS[int(number)] for number in config.values.get("planners", range(len(PLANNERS)))]
    files = enumerate(config.tree_files)
    return [Trial(f"{file.stem}: {name}", file, row, name) for row, file in files for name in planners]


def true_scene(config: StudyConfig, file: Path, stop: np.random.Generator | None = None) -> Scene:
    """A measured tree before the arm, with its limbs.

    Args:
        stop: Draws the place of the base; None for one in front of the tree.
    """
    distance, turn = config.values.get("distance", (DISTANCE_M,))[0], 180.0
    if stop is not None:
        distance, turn = float(stop.uniform(*STOP_DISTANCES)), float(stop.uniform(*STOP_TURNS))
    scene = with_limbs(measured_orchard([file], MeasuredOptions(distance=distance, yaw_deg=turn)))
    joints = tuple(scene.start.configuration.tolist())
    return scene.with_values(goal=Goal(joints_rad=joints))


def _plan_tour(config: StudyConfig, robot: Robot, seen: Scene) -> _Work:
    """A certified tour."""
    sigmas = config.values.get("sigmas", (SIGMAS,))[0]
    options = PlanOptions(effort=config.effort, tracking_error=_tracking(config), sigmas=sigmas)

    def tour_or_none() -> TourResult | None:
        with suppress(HplanError):
            names = _chosen(config, reachable(robot, seen, options))
            return plan_tour(robot, seen, options, fruits=names) if names else None
        return None

    tour, ms = timed(tour_or_none)
    if tour is None:
        return _Work(np.zeros(1), seen.start.configuration[None], ms=ms)
    clock = np.arange(0.0, tour.duration + CONTROL_PERIOD, CONTROL_PERIOD)
    grasps = sorted(tour.picked.items(), key=lambda item: item[1])
    return _Work(clock, tour.trajectory.positions(np.minimum(clock, tour.duration)), grasps, ms,
                 tour.certificate.verified)  # fmt: skip


def _tracking(config: StudyConfig) -> float:
    """Tracking error that certificates allow for [rad]."""
    return config.values.get("tracking", (TRACKING_RAD,))[0]


def _chosen(config: StudyConfig, found: Mapping[str, FruitReach]) -> list[str]:
    """Names of fruit that can be picked, evenly chosen from all."""
    names = [name for name, fruit in found.items() if fruit.can_be_picked]
    return evenly_chosen(names, int(config.values.get("fruits", (FRUITS,))[0]), lambda _: "")


def _follow_recipe(config: StudyConfig, robot: Robot, seen: Scene, *, thin: bool) -> _Work:
    """Motions of the recipe; fruits without one are left."""
    clamp = (seen.wood or Wood()).clamp_radius
    kept = tuple(
        piece.copy_unchecked({"sigma": 0.0} | ({"parent": None} if isinstance(piece, Capsule) else {}))
        for piece in seen.obstacles
        if thin or not isinstance(piece, Capsule) or piece.radius >= clamp
    )
    fruits = tuple(fruit.copy_unchecked({"sigma": 0.0}) for fruit in seen.fruits)
    scene = seen.with_values(obstacles=kept, fruits=fruits, wood=None, clearance=PADDING_M)
    work = _Work(np.zeros(1), seen.start.configuration[None])
    _, work.ms = timed(lambda: _visit(config, robot, scene, work))
    return work


def _visit(config: StudyConfig, robot: Robot, scene: Scene, work: _Work) -> None:
    """Append the motions to fruit that can be reached, the nearest in the joints' time next."""
    try:
        found = reachable(robot, scene, PlanOptions(sigmas=0.0))
    except HplanError:
        return
    grasps = {name: grasp for name in _chosen(config, found) if (grasp := found[name].grasp) is not None}
    while grasps:
        here = work.position[-1]
        away = {name: float((np.abs(g.standoff - here) / robot.velocity_limit).max()) for name, g in grasps.items()}
        name = min(away, key=lambda one: away[one])
        grasp = grasps.pop(name)
        motions = _recipe_motions(robot, scene, here, grasp)
        if motions is None:
            continue
        for position in motions[:2]:
            work.append(position)
        work.grasps.append((name, work.duration))
        work.append(motions[2])
        scene = scene.with_values(fruits=tuple(fruit for fruit in scene.fruits if fruit.name != name))


def _recipe_motions(robot: Robot, scene: Scene, here: FloatArray, grasp: Grasp) -> list[FloatArray] | None:
    """Configurations of the transit, the straight approach and the way back, at the controller's period."""
    scene = scene.with_values(start=Start(joints_rad=tuple(here.tolist())))
    path = ompl_path(world_of(robot, scene), scene, grasp.standoff, seconds=PATIENCE_S)
    if path is None:
        return None
    found = list[FloatArray]()
    line = grasp.path(robot)
    ways = [path] if line is None else [path, np.array(line.evaluate(np.linspace(0.0, line.end, 9)))]
    for way in ways:
        motion = toppra_motion(robot, way)
        if motion is None:
            return None
        clock = np.arange(0.0, motion.duration + CONTROL_PERIOD, CONTROL_PERIOD)
        found.append(motion.positions(clock))
    found += [found[-1][-1:]] * (2 - len(found))
    return [*found, found[1][::-1]]


def _try(config: StudyConfig, trial: Trial) -> Row:
    """Plan and execute; forces and damage beside the fruit picked."""
    if not config.values.keys() & {"minutes", "stops"}:
        return _at_stop(config, trial, None)
    allowed_s, stops = 60.0 * config.values.get("minutes", (math.inf,))[0], config.values.get("stops", (MOST_STOPS,))
    rows, spent_s = list[Row](), 0.0
    for stop in range(*map(int, stops)):
        rows.append(_at_stop(config, trial, stop))
        spent_s += rows[-1].get("worked_s", 0.0)
        if spent_s >= allowed_s:
            break
    return _sum_up(rows, spent_s)


#: Columns that are added up over stops.
_SUMS = ("ms", "planned", "picked", "duration_s", "executed_s", "over_limits", "broken", "knocked_off",
         "knocked_off_untouched", "rigid_contacts", "held_contacts", "diverged")  # fmt: skip

#: Columns of which the largest counts.
_LARGEST = ("most_miss_mm", "limb_force_n", "fruit_force_n", "stress_mpa", "tracking_mrad", "fault")


def _sum_up(rows: list[Row], spent_s: float) -> Row:
    """One row about several stops."""
    found = rows[0] | {key: sum(row.get(key, 0) for row in rows) for key in _SUMS}
    found |= {key: max(row.get(key, 0.0) for row in rows) for key in _LARGEST}
    misses = [row["miss_mm"] for row in rows if row.get("miss_mm") is not None]
    found |= {"miss_mm": float(np.median(misses)) if misses else None, "stops": len(rows), "worked_s": spent_s}
    return found | {"fruit_per_hour": 3600.0 * found["picked"] / spent_s if spent_s > 0.0 else 0.0}


def _at_stop(config: StudyConfig, trial: Trial, stop: int | None) -> Row:
    """A trial from one place of the base, the stop of a number or the one in front of the tree."""
    seeds = (config.seed, trial.number) if stop is None else (config.seed, trial.number, stop)
    robot, random = config.arm("orchard_harvester"), np.random.default_rng(seeds)
    row: Row = {"name": trial.name, "planner": trial.planner, "tree": trial.tree.stem, "planned": 0, "picked": 0}
    row |= {"ms": 0.0, "fruit_per_hour": 0.0}
    scene = true_scene(config, trial.tree, None if stop is None else random)
    if base_contacts(robot, scene.solids):  # the tree stands in the arm
        return row
    errors = FieldErrors(looks=int(config.values.get("looks", (LOOKS,))[0]))
    seen = errors.seen_scene(scene, random)
    wind_seed = config.seed + trial.number + 1000 * (stop or 0)
    wind = Wind(speed_m_s=config.values.get("wind", (WIND_M_S,))[0], seed=wind_seed)
    sway = cache(lambda: _sway(scene, wind))
    if config.values.get("sway", (0.0,))[0]:
        seen = _swaying(robot, seen, sway())
    if trial.planner == PLANNERS[0]:
        work = _plan_tour(config, robot, seen)
    else:
        seed_ompl(config.seed + 1)
        work = _follow_recipe(config, robot, seen, thin=trial.planner == PLANNERS[1])
    row |= {"ms": work.ms, "planned": len(work.grasps), "duration_s": work.duration}
    if not work.grasps:
        return row
    plant = Plant(mass_factor=errors.mass_factor(random), bandwidth=BANDWIDTH, decoupled=True)
    moves_all = bool(config.values.get("moves_all", (0.0,))[0])
    moved = {name: float(np.linalg.norm(by)) for name, by in sway().items()}
    done, executed_ms = timed(lambda: _execute(robot, scene, work, plant, wind, moved, moves_all=moves_all))
    row |= done | {"executed_s": 1e-3 * executed_ms}
    is_harmful = row["broken"] or row["knocked_off"] or row["rigid_contacts"]
    is_far_off = row["tracking_mrad"] > 1e3 * _tracking(config)
    return row | {"fault": work.certified and bool(is_harmful or is_far_off)}


def _swaying(robot: Robot, seen: Scene, sway: Mapping[str, FloatArray]) -> Scene:
    """The seen scene, with limbs and fruit that sway between their places and displaced ones.

    Those that swing against the robot's base stay where they are.

    Args:
        robot: The robot.
        seen: The scene.
        sway: (3,) displacements by name [m].
    """

    def swept(item: _Item) -> _Item:
        moved = 0.5 * sway.get(item.name, np.zeros(3))
        amplitude = float(np.linalg.norm(moved))
        if 2.0 * amplitude < LEAST_SWAY_M:
            return item
        fields = transform_fields(item, np.eye(3), moved)
        return item.copy_unchecked(fields | {"sway": Sway(direction=tuple(moved.tolist()), amplitude_m=amplitude)})

    whole = seen.with_values(obstacles=tuple(map(swept, seen.obstacles)), fruits=tuple(map(swept, seen.fruits)))
    inside = sway.keys() & {contact.obstacle for contact in base_contacts(robot, whole.solids)}
    return _swaying(robot, seen, {name: sway[name] for name in sway.keys() - inside}) if inside else whole


def _sway(scene: Scene, wind: Wind) -> dict[str, FloatArray]:
    """(3,) displacement of each limb and fruit in equilibrium with a gust of `SIGMAS` standard deviations [m].

    Of a limb it is that of the end which moves farther.
    """
    wind = replace(wind, speed_m_s=wind.speed_m_s * (1.0 + SIGMAS * wind.intensity), intensity=0.0)
    mujoco, wood = import_mujoco(), scene.wood or Wood()
    limbs, spec = limbs_of(scene.obstacles, wood), mujoco.MjSpec()
    # With implicit damping, steps of this length are Newton's steps to the equilibrium [s].
    spec.option.timestep = 1.0
    bodies = WoodBodies(mujoco, spec, limbs, wood, BendingTrees(wind=wind))
    bodies.add_limbs(limbs.names)
    bodies.add_fruits(scene.fruits, [fruit.name for fruit in scene.fruits])
    model = spec.compile()
    data = mujoco.MjData(model)
    monitor = TreeMonitor(mujoco, model, data, bodies)
    geoms = [model.geom(name).id for name in bodies.obstacle_of]
    half = np.where(model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CAPSULE, model.geom_size[geoms, 1], 0.0)

    def ends() -> FloatArray:
        along = half[:, None] * data.geom_xmat[geoms].reshape(-1, 3, 3)[:, :, 2]
        return np.stack([data.geom_xpos[geoms] - along, data.geom_xpos[geoms] + along])

    rest = ends()
    for _ in range(SWAY_STEPS):
        monitor.blow()
        mujoco.mj_step(model, data)
    moved, found = ends() - rest, dict[str, FloatArray]()
    for name, both in zip(bodies.obstacle_of.values(), moved.swapaxes(0, 1), strict=True):
        found[name] = max(*both, found.get(name, np.zeros(3)), key=np.linalg.norm)
    return found


def _execute(
    robot: Robot, scene: Scene, work: _Work, plant: Plant, wind: Wind, sway: Mapping[str, float], *, moves_all: bool
) -> Row:
    """Execute a motion among trees that bend in the wind, and take the fruit that the gripper reaches.

    Args:
        robot: The robot.
        scene: The true scene.
        work: The motion.
        plant: The arm's dynamics.
        wind: The wind.
        sway: Displacement of each limb and fruit in a strong gust [m].
        moves_all: True to let limbs and fruit that the arm comes near to move all the time, not only while it is near.
    """
    near = find_near(robot, scene, work.position[::_NEAR_ROWS], sway)
    arm = SimulatedArm(robot, scene, plant, trees=BendingTrees(wind=wind), bending=near, substeps=SUBSTEPS)
    monitor = arm.trees
    assert monitor is not None
    if not moves_all:
        period = _NEAR_ROWS * CONTROL_PERIOD
        monitor.move_only({
            name: [(period * first, period * last) for first, last in rows] for name, rows in near.items()
        })  # fmt: skip
    velocity = np.gradient(work.position, CONTROL_PERIOD, axis=0)
    acceleration = np.gradient(velocity, CONTROL_PERIOD, axis=0)
    rows = {round(at / CONTROL_PERIOD): name for name, at in work.grasps}
    misses, picked, target, off = list[float](), list[str](), iter(work.grasps), 0.0
    arm.ignore_contacts([next(target)[0]])
    arm.settle(work.position[0])
    arm.place(work.position[0], velocity[0])
    for row, state in enumerate(zip(work.position, velocity, acceleration, strict=True)):
        if not arm.is_finite:
            break
        off = max(off, float(np.abs(arm.position - state[0]).max()))
        if row in rows:
            name = rows[row]
            miss = arm.distance_to_fruit(name)
            misses += [miss] if math.isfinite(miss) else []
            if miss <= GRIPPER_M:
                picked.append(name)
                arm.take_away([name])
            following = next(target, None)
            if following is not None:
                arm.ignore_contacts([following[0]])
        arm.follow(*state)
    response, limits = monitor.response({}), scene.wood or Wood()
    touched, worked_s = {one.limb for one in response.contacts}, work.duration + GRIP_S * len(work.grasps)
    limbs = monitor.bodies.limbs
    bend = {name for name, is_clamped in zip(limbs.names, limbs.clamped.tolist(), strict=True) if not is_clamped}
    bend |= {fruit.name for fruit in scene.fruits}
    held = monitor.touched_still | (bend & {touch.obstacle for touch in arm.contacts})
    return {
        "picked": len(picked), "worked_s": worked_s, "fruit_per_hour": 3600.0 * len(picked) / worked_s,
        "miss_mm": 1e3 * float(np.median(misses)) if misses else None, "most_miss_mm": 1e3 * max(misses, default=0.0),
        "limb_force_n": response.limb_force_n, "fruit_force_n": response.fruit_force_n,
        "stress_mpa": 1e-6 * float(monitor.max_stress_pa.max(initial=0.0)),
        "over_limits": sum(not one.is_within(limits) for one in response.contacts),
        "broken": len(response.broken), "knocked_off": len(response.knocked_off),
        "knocked_off_untouched": sum(one.name not in touched for one in response.knocked_off),
        "rigid_contacts": len(arm.contacts), "held_contacts": len(held), "tracking_mrad": 1e3 * off,
        "diverged": not arm.is_finite,
    }  # fmt: skip


WOOD_TRIAL = Study(
    "wood_trial",
    "field trial: picking from trees that bend in the wind, with errors (--trees); count of trees",
    _try,
    (
        *("planned", "picked", "duration_s", "fruit_per_hour", "miss_mm", "most_miss_mm", "limb_force_n"),
        *("fruit_force_n", "stress_mpa", "over_limits", "broken", "knocked_off", "rigid_contacts", "held_contacts"),
        *("tracking_mrad", "ms", "executed_s"),
    ),
    _problems,
    by="planner",
    count=(None, 1),
    needs=("trees",),
    peers=(),
    warm=0,
)
