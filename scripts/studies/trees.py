"""Motions among trees: home to fruit, fruit to fruit, picking tours, rows of stops.

Measured trees, one at a time, are in front of the base at several distances. Fruit hangs at the tips of their branches,
at the tips within the arm's reach first. The shipped orchards are included unchanged. A fruit is a goal if it has a
clear grasp with a straight approach of `STANDOFF`; the motion ends at the start of the approach, in the configuration
with the shortest expected motion from home. All fruits are obstacles.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from studies.harness import Row, Study, StudyConfig, evenly_chosen
from studies.measure import or_error, planned, timed
from studies.outside import contacts
from studies.peers import peer_row

from hplan.base.arrays import FloatArray
from hplan.base.data_files import scenes_dir
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import HplanError, InputError, OptionError, TourError, UnreachableError
from hplan.planar.inverse_kinematics import reach
from hplan.planning.failures import REASONS, reason_of, tally_reasons
from hplan.planning.grasps import straight_approaches
from hplan.planning.options import PlanOptions
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start, with_limbs
from hplan.scene.orchard import SHIPPED, TUCKED_DEG, MeasuredOptions, fruit_at_tips, import_capsules
from hplan.scene.orchard import measured_orchard as measured_orchard_scene
from hplan.scene.wood import Wood
from hplan.tour.row import RowOptions, plan_row
from hplan.tour.tour import TourOptions, plan_tour

#: Distances of a measured tree's trunk in front of the base [m].
DISTANCES = (1.4, 1.0, 1.8)

#: Fruits on each measured tree, their radius, and the length of the straight approach to one [m].
FRUITS, RADIUS, STANDOFF = 20, 0.04, 0.1

#: Approximate number of configurations per fruit; clearance of a grasp and of its stand-off, half of it along the
#: approach [m].
GRASPS, SPARE = 64, 1e-3


@dataclass(frozen=True)
class Orchard:
    """Trees with fruit.

    Attributes:
        name: Its name.
        group: Its group in the summary.
        scene: Trees, fruit, and the home pose as its start.
    """

    name: str
    group: str
    scene: Scene

    def between(self, name: str, start: FloatArray, goal: FloatArray) -> Scene:
        """The motion between two configurations among all of its trees and fruit."""
        ends = Start(joints_rad=tuple(start.tolist())), Goal(joints_rad=tuple(goal.tolist()))
        kept = {key: getattr(self.scene, key) for key in ("clearance", "obstacles", "fruits")}
        return Scene(name=name, start=ends[0], goal=ends[1], **kept)


@dataclass(frozen=True)
class TreeProblem:
    """A motion to plan, from configuration to configuration: its name, its orchard's group, its arm and scene."""

    name: str
    group: str
    robot: Robot
    scene: Scene


def shipped_orchards(robot: Robot) -> list[Orchard]:
    """The orchards that ship with hplan for a robot."""
    scenes = {name: load_scene(scenes_dir() / f"{name}.yaml") for name in SHIPPED}
    return [Orchard(name, name, scene) for name, scene in scenes.items() if (scene.robot or "harvester") == robot.name]


def measured_orchards(robot: Robot, folder: Path) -> list[Orchard]:
    """Measured trees, a CSV of capsules each, at each of the distances.

    Raises:
        InputError: A file is invalid, or a tree has too little room for its fruit.
    """
    return [measured_orchard(robot, file, distance) for distance in DISTANCES for file in sorted(folder.glob("*.csv"))]


def measured_orchard(robot: Robot, file: Path, distance: float) -> Orchard:
    """A measured tree with fruit, at a distance [m] in front of the base."""
    wood = import_capsules(file, position=(distance, 0.0, 0.0))
    branches = sum(piece.name.split()[0] != "trunk" for piece in wood)
    try:
        # One at each tip; additional ones, behind the tips, only if there are few tips.
        hung = fruit_at_tips(wood, max(FRUITS, branches), RADIUS)
    except OptionError as error:
        raise InputError(f"{file}: {error.message}", path=str(file)) from error
    chosen = sorted(hung, key=lambda fruit: not _is_within_reach(robot, fruit))[:FRUITS]
    name = f"{file.stem} at {distance:g} m"
    start, goal = Start(joints_deg=TUCKED_DEG), Goal(fruit=chosen[0].name)
    scene = Scene(name=name, start=start, goal=goal, obstacles=wood, fruits=tuple(chosen))
    return Orchard(name, f"measured at {distance:g} m", scene)


def _is_within_reach(robot: Robot, fruit: Fruit) -> bool:
    try:
        reach(robot, fruit.center, count=1)
    except UnreachableError:
        return False
    return True


def crop_of(robot: Robot, orchard: Orchard) -> tuple[dict[str, FloatArray], Counter[str]]:
    """Start of the approach to each reachable fruit, and counts of failures by reason."""
    scene, home = orchard.scene, orchard.scene.start.configuration
    found = {fruit.name: _standoff(robot, scene, fruit, home) for fruit in scene.fruits}
    goals = {name: goal for name, goal in found.items() if not isinstance(goal, str)}
    return goals, Counter(reason for reason in found.values() if isinstance(reason, str))


def motions_in(robot: Robot, orchard: Orchard) -> list[TreeProblem]:
    """From home to each fruit, then from each fruit to the next, in the order of their distance from the base."""
    scene, home = orchard.scene, orchard.scene.start.configuration
    goals, _ = crop_of(robot, orchard)
    clear = ClearanceField.build(robot, scene.solids_with_goal, clearance=scene.clearance).spare_clearance(home) > 0.0
    ways = [("home", home, name, goal) for name, goal in goals.items()] if clear else []
    ways += [(*one, *other) for one, other in pairwise(goals.items())]
    named = [(f"{orchard.name}: {before} to {after}", start, goal) for before, start, after, goal in ways]
    return [TreeProblem(way[0], orchard.group, robot, orchard.between(*way)) for way in named]


def _standoff(robot: Robot, scene: Scene, fruit: Fruit, home: FloatArray) -> FloatArray | str:
    """Start of the approach to a fruit, or the reason without one.

    The last link alone may touch the fruit.
    """
    world = ClearanceField.build(robot, scene.solids_with_goal, clearance=scene.clearance)
    touching = world.ignoring_last_link(np.array([solid.name == fruit.name for solid in scene.solids_with_goal]))
    try:
        goals = reach(robot, fruit.center, count=GRASPS, start=home).configurations
    except UnreachableError as error:
        return error.reason
    goals = goals[touching.spare_clearances(goals) > SPARE]
    if not len(goals):
        return "blocked"
    feasible, polylines = straight_approaches(robot, goals, STANDOFF)
    ways = polylines[feasible]
    if not len(ways):
        return "no_approach"
    clear = [way[-1] for way in ways if world.spare_clearance(way[-1]) > SPARE and touching.is_clear(way, 0.5 * SPARE)]
    limits = robot.velocity_limit, robot.acceleration_limit
    return min(clear, key=lambda q: least_duration(home, q, *limits), default="blocked")


def orchards_of(config: StudyConfig) -> list[Orchard]:
    """Measured trees, if their folder is given, and the shipped orchards for the arm."""
    robot = config.arm()
    return [*(() if config.trees is None else measured_orchards(robot, config.trees)), *shipped_orchards(robot)]


def _problems(config: StudyConfig) -> Iterable[TreeProblem]:
    robot = config.arm()
    found = [problem for orchard in orchards_of(config) for problem in motions_in(robot, orchard)]
    return evenly_chosen(found, config.count, lambda problem: problem.group)


def _row(config: StudyConfig, problem: TreeProblem) -> Row:
    robot, scene = problem.robot, problem.scene
    found, row = planned(robot, scene, PlanOptions(effort=config.effort))
    row |= {"name": problem.name, "group": problem.group}
    if found is not None:
        row["contacts"] = sum(contacts(robot, scene, found.trajectory))
        row["fault"] |= row["contacts"] > 0
    row |= peer_row(config, robot, scene, row.get("duration_s"))
    return row | {"missed": not row["solved"] and row.get("peer_solved", False)}


TREES = Study(
    "trees",
    "motions among trees, all joints free: measured ones (--trees) and those that ship",
    _row,
    (
        *("certified", "missed", "ms", "duration_s", "origin", "contacts"),
        *("peer_solved", "peer_ms", "to_peer", "to_spline", "spline_touches"),
    ),
    problems=_problems,
    by="group",
    warm=6,
)


def _tours(config: StudyConfig) -> Sequence[Orchard]:
    robot = config.arm()
    if config.trees is None:
        return shipped_orchards(robot)[: config.count]
    return [measured_orchard(robot, file, DISTANCES[0]) for file in config.tree_files]


def _tour(config: StudyConfig, orchard: Orchard) -> Row:
    robot, scene = config.arm(), orchard.scene
    found, ms = timed(lambda: or_error(lambda: plan_tour(robot, scene, PlanOptions(effort=config.effort))))
    solved = not isinstance(found, HplanError)
    row: Row = {"name": orchard.name, "ms": ms, "fruits": len(scene.fruits), "solved": solved}
    if isinstance(found, HplanError):
        return row | {"picked": 0, "message": found.message}
    picked, duration = len(found.order), found.trajectory.duration
    return row | {"picked": picked, "duration_s": duration, "a_fruit_s": duration / max(1, picked)}


TOURS = Study(
    "tours",
    "picking tours over a measured tree each (--trees), or over the orchards that ship",
    _tour,
    ("solved", "fruits", "picked", "duration_s", "a_fruit_s", "ms"),
    problems=_tours,
)


#: Distance of the rows' trees from the vehicle, and spacing of its possible stops [m].
ROW_DISTANCE, ROW_STEP = 1.2, 0.4

#: Depth to which thin wood and fruit may be pushed in rows without forces, and radius below which wood is thin [m].
ROW_DEPTH, THIN = 0.02, 0.008

#: Wood of the rows: bounded by depth, by force and stress, and thin wood left out, which no real arm can do.
WOODS = ("depths", "forces", "no thin wood")

#: Grasps of the rows, each with the maximum distance of the tool from a fruit's centre [m], at most its radius. It is
#: the gripper's capture range too, if that is more than by default: the last one is the gripper of `wood_trial`.
OFFSETS = {"at centres": 0.0, "20 mm off": 0.02, "30 mm off": 0.03}


@dataclass(frozen=True)
class TreeRow:
    """A measured tree that a vehicle passes: the tree's name, the kinds of its wood and grasps, and the scene."""

    name: str
    kind: str
    scene: Scene


def _tree_rows(config: StudyConfig) -> Iterable[TreeRow]:
    kinds = config.chosen(WOODS), config.chosen(OFFSETS)
    return [_tree_row(file, wood, grasps) for file, wood, grasps in itertools.product(config.tree_files, *kinds)]


def _tree_row(file: Path, wood: str, grasps: str) -> TreeRow:
    depth = 0.0 if wood == "forces" else ROW_DEPTH
    given = MeasuredOptions(
        distance=ROW_DISTANCE, wood_yields=depth, yields_below=THIN, fruit_yields=depth, grasp_offset=OFFSETS[grasps]
    )
    scene = measured_orchard_scene([file], given)
    if wood == "forces":
        scene = with_limbs(scene, Wood(capture_range=max(Wood().capture_range, OFFSETS[grasps])))
    elif wood == "no thin wood":
        scene = scene.copy_unchecked({"obstacles": tuple(one for one in scene.obstacles if not one.yields)})
    return TreeRow(file.stem, f"{wood}, {grasps}", scene)


def _plan_row(config: StudyConfig, problem: TreeRow) -> Row:
    robot, scene, begin = config.arm("orchard_harvester"), problem.scene, time.process_time()
    given = RowOptions(distance=ROW_DISTANCE, step=ROW_STEP)
    tour = TourOptions(max_detour_s=next(iter(config.values.get("detour", ())), None))
    found = or_error(lambda: plan_row(robot, scene, PlanOptions(effort=config.effort), row=given, tour=tour))
    row: Row = {"name": f"{problem.name}, {problem.kind}", "kind": problem.kind, "fruits": len(scene.fruits)}
    row |= {"cpu_s": time.process_time() - begin}
    if isinstance(found, TourError):
        reasons, _ = tally_reasons((reason_of(error), None) for _, error in found.reasons)
        return row | {"picked": 0, **reasons}
    if isinstance(found, HplanError):
        return row | {"picked": 0, "message": found.message}
    numbers = {key: found.report.get(key) for key in ("motion_s", "motion_s_per_fruit", "max_force_n")}
    reasons = {key: count for key, count in found.report["not_picked"].items() if key in REASONS}
    return row | {"picked": len(found.picked), "stops": len(found.stops), **reasons, **numbers}


ROWS = Study(
    "rows",
    "fruit picked from stops along a measured tree each (--trees), by how wood is bounded and fruit grasped",
    _plan_row,
    ("fruits", "picked", *REASONS, "motion_s_per_fruit", "cpu_s"),
    problems=_tree_rows,
    by="kind",
    totals=("fruits", "picked", *REASONS, "motion_s", "cpu_s"),
    count=(None, 1),
    needs=("trees",),
    peers=(),
    warm=0,
    choices=(WOODS, tuple(OFFSETS)),
)
