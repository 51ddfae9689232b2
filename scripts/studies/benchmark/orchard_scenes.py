"""Problems in orchards, all joints free: from the tucked home pose to each fruit, and from each fruit to the next.

Measured trees, one at a time, stand in front of the base at several distances. Fruit hangs at the tips of their
branches, at those within the arm's reach first. The orchards that ship with hplan are there as they are. A fruit is a
goal where some grasp of it is clear and has a straight approach of `STANDOFF`; the motion ends where the approach
begins, in the configuration that promises the shortest motion from home. All fruits are obstacles.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.data_files import scenes_dir
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import InputError, OptionError, UnreachableError
from hplan.orchard import SHIPPED, TUCKED_DEG, fruit_at_tips, import_capsules
from hplan.planar.inverse_kinematics import reach
from hplan.planar.straight_approach import standoffs
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.scene.model import Fruit, Goal, Scene, Start

#: Where the trunk of a measured tree stands in front of the base [m].
DISTANCES = (1.4, 1.0, 1.8)

#: Fruits on each measured tree, and their radius [m].
FRUITS, RADIUS = 20, 0.04

#: Length of the straight approach to a fruit [m].
STANDOFF = 0.1

#: Configurations at a fruit that are looked at, about.
GRASPS = 64

#: Clearance of a grasp and of its stand-off, and half of it all along the approach [m].
SPARE = 1e-3

#: Where an approach is looked at, as shares of its length.
_LOOKS = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Orchard:
    """Trees with fruit.

    Attributes:
        name: Which it is.
        group: What it is counted with.
        scene: Trees, fruit, and the home pose as its start.
    """

    name: str
    group: str
    scene: Scene

    def problem(self, name: str, start: FloatArray, goal: FloatArray) -> OrchardProblem:
        """The motion between two configurations among all of its trees and fruit."""
        posed = Scene(
            name=name,
            start=Start(joints_rad=tuple(start.tolist())),
            goal=Goal(joints_rad=tuple(goal.tolist())),
            clearance=self.scene.clearance,
            obstacles=self.scene.obstacles,
            fruits=self.scene.fruits,
        )
        return OrchardProblem(name, self.group, posed)


@dataclass(frozen=True)
class OrchardProblem:
    """A motion to plan, from configuration to configuration.

    Attributes:
        name: Orchard, and from where to where.
        group: What it is counted with.
        scene: Obstacles, start and goal.
    """

    name: str
    group: str
    scene: Scene


@dataclass(frozen=True, eq=False)
class CropProblems:
    """What the arm can do in an orchard.

    Attributes:
        orchard: The orchard.
        goals: By the names of the fruits that can be taken, the configurations to plan to.
        without: How many fruits cannot be taken, by the reason: `blocked`, `no_approach`, or why they are out of
            reach (see `UnreachableError`).
        home_is_clear: Whether the arm touches nothing at home.
    """

    orchard: Orchard
    goals: dict[str, FloatArray]
    without: Counter[str]
    home_is_clear: bool

    def problems(self) -> list[OrchardProblem]:
        """From home to each fruit, then from each fruit to the next, in the order of their distance from the base."""
        home = self.orchard.scene.start.configuration
        ways = [("home", home, name, goal) for name, goal in self.goals.items()] if self.home_is_clear else []
        ways += [(*one, *other) for one, other in pairwise(self.goals.items())]
        return [self._problem(*way) for way in ways]

    def _problem(self, before: str, start: FloatArray, after: str, goal: FloatArray) -> OrchardProblem:
        return self.orchard.problem(f"{self.orchard.name}: {before} to {after}", start, goal)


def shipped_orchards() -> list[Orchard]:
    """The orchards that ship with hplan for the default robot."""
    scenes = {name: load_scene(scenes_dir() / f"{name}.yaml") for name in SHIPPED}
    return [Orchard(name, name, scene) for name, scene in scenes.items() if scene.robot is None]


def measured_orchards(robot: Robot, folder: Path) -> list[Orchard]:
    """Measured trees, one at a time, at each of the distances.

    Args:
        robot: The arm.
        folder: Where the trees are, a CSV of capsules each.

    Raises:
        InputError: A file that is not in order, or a tree with too little room for its fruit.
    """
    return [measured_orchard(robot, file, distance) for distance in DISTANCES for file in sorted(folder.glob("*.csv"))]


def measured_orchard(robot: Robot, file: Path, distance: float) -> Orchard:
    """A measured tree with fruit, at a distance [m] in front of the base.

    Raises:
        InputError: A file that is not in order, or a tree with too little room for its fruit.
    """
    wood = import_capsules(file, position=(distance, 0.0, 0.0))
    branches = sum(piece.name.split()[0] != "trunk" for piece in wood)
    try:
        # One at each tip; more, behind the tips, only where there are few.
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


def crop_of(robot: Robot, orchard: Orchard) -> CropProblems:
    """Find out which fruits can be taken, and how."""
    scene, home = orchard.scene, orchard.scene.start.configuration
    goals: dict[str, FloatArray] = {}
    without: Counter[str] = Counter()
    for fruit in scene.fruits:
        found = _standoff(robot, scene, fruit, home)
        if isinstance(found, str):
            without[found] += 1
        else:
            goals[fruit.name] = found
    clear = ClearanceField.of(robot, scene.solids_with_goal, clearance=scene.clearance).clearance(home) > 0.0
    return CropProblems(orchard, goals, without, clear)


def _standoff(robot: Robot, scene: Scene, fruit: Fruit, home: FloatArray) -> FloatArray | str:
    """Where the approach to a fruit begins, or why there is none; the last link alone may touch the fruit."""
    world, rest, itself = (
        ClearanceField.of(robot, solids, clearance=scene.clearance)
        for solids in (
            scene.solids_with_goal,
            [solid for solid in scene.solids_with_goal if solid.name != fruit.name],
            [solid for solid in scene.solids_with_goal if solid.name == fruit.name],
        )
    )
    try:
        goals = reach(robot, fruit.center, count=GRASPS, start=home).configurations
    except UnreachableError as error:
        return error.reason
    goals = goals[[rest.clearance(q) > SPARE and itself.link_clearances(q)[:-1].min() > SPARE for q in goals]]
    if not len(goals):
        return "blocked"
    stages = [standoffs(robot, goals, share * STANDOFF) for share in _LOOKS]
    ways = np.stack([goals, *(stage.configurations for stage in stages)], axis=1)[stages[-1].feasible]
    if not len(ways):
        return "no_approach"
    clear = [way[-1] for way in ways if world.clearance(way[-1]) > SPARE and rest.is_clear(way, 0.5 * SPARE)]
    limits = robot.velocity_limit, robot.acceleration_limit
    return min(clear, key=lambda q: least_duration(home, q, *limits), default="blocked")
