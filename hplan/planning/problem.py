"""Planning problems: an arm in its world, start, alternative goals, budget."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray, IntArray, Record, frozen, readonly
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.held_objects import holding
from hplan.errors import InputError
from hplan.optimization.minimize_time import OptimizerEffort
from hplan.planning.effort import Effort, efforts_of
from hplan.planning.growing_trees import Pairs
from hplan.planning.options import PlanOptions
from hplan.planning.pose_goal import STARTS
from hplan.planning.specialist import narrow_ranges, presets_of
from hplan.planning.world import World
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Clearance required beyond the scene's own during motions [m]; less if start or goal have less.
MARGIN = 2e-3


class SearchMemory(NamedTuple):
    """What earlier searches of a planner found.

    Attributes:
        motions: (n, dof) configurations along each of some recent motions (`hplan.planning.recent_paths`).
        pairs: Trees that grow on, among obstacles that have not changed; None for new ones.
    """

    motions: tuple[FloatArray, ...] = ()
    pairs: Pairs | None = None


#: Nothing is known from earlier searches.
NO_MEMORY = SearchMemory()


@dataclass(frozen=True, eq=False)
class Problem(Record):
    """An arm and a scene, with budget, start and goals.

    A problem made from a scene has no goal configurations yet: `scene.goal` says which are acceptable. `between`
    returns the problem of a motion to one of them, and `merged` the problem of a motion to any of several.

    Attributes:
        robot: The arm, with the objects that it holds in the scene.
        scene: Obstacles and task, as given.
        options: The options of the plan.
        effort: Search and optimization budget.
        start: (dof,) start configuration.
        goals: (n, dof) alternative goal configurations; n = 0 before they are chosen.
        lower: (n, dof) lower joint limits of the motion to each goal; a locked joint has its start value.
        upper: (n, dof) upper joint limits of the motion to each goal; a locked joint has its start value.
        spare_clearances: (n,) minimum clearance of start and goal beyond the required one [m]; inf without obstacles.
        movable: (k,) numbers of the joints that may move.
        other_world: The arm among other obstacles than the scene's; None for the scene's.
        is_draft: True if motions are not certified: each only starts the optimizer of another one.
        pose_starts: Numbers of starts of the inverse kinematics at a goal pose, tried in order until a configuration is
            collision-free.
        memory: What earlier searches found.
    """

    robot: Robot
    scene: Scene
    options: PlanOptions
    effort: Effort
    start: FloatArray
    goals: FloatArray
    lower: FloatArray
    upper: FloatArray
    spare_clearances: FloatArray
    movable: IntArray
    other_world: World | None = None
    is_draft: bool = False
    pose_starts: tuple[int, ...] = STARTS
    memory: SearchMemory = NO_MEMORY

    @classmethod
    def from_scene(cls, robot: Robot, scene: Scene, options: PlanOptions) -> Problem:
        """The problem that a scene states for a robot.

        Raises:
            InputError: The scene's start is not a configuration of the robot.
            JointLimitError: The start violates the joint limits.
        """
        robot, start = holding(robot, scene.attached).about_start(scene.start)
        movable = np.flatnonzero(~robot.locked_mask(scene.locked_joints))
        rows, nothing = frozen(np.zeros((0, robot.dof))), frozen(np.zeros(0))
        effort = efforts_of(presets_of(robot), options)[-1]
        return cls(robot, scene, options, effort, start, rows, rows, rows, nothing, readonly(movable, np.int64))

    @cached_property
    def world(self) -> World:
        """The arm among the obstacles, prepared at the first use.

        Raises:
            OptionError: `scene.yield_links` names an unknown link.
        """
        return self.other_world or World.of_scene(self.robot, self.scene, self.options)

    @property
    def field(self) -> ClearanceField:
        """Distances between the arm and the obstacles."""
        return self.world.field

    @property
    def optimization(self) -> OptimizerEffort | None:
        """Budget of the optimizer; None if the objective is a short path."""
        return self.effort.starts if self.options.objective == "duration" else None

    @property
    def goal(self) -> FloatArray:
        """(dof,) the goal; the first of several."""
        first: FloatArray = self.goals[0]
        return first

    @property
    def is_leaving(self) -> bool:
        """True if the start is nearer to obstacles than the clearance (`Start.contact_depth`).

        C-spaces of the scene then exclude it, and prove nothing.
        """
        return len(self.world.checker.near_pairs) > 0

    @property
    def is_empty(self) -> bool:
        """True if start and goal are the same configuration."""
        return bool(np.abs(self.goal - self.start).max() < 1e-9)

    @property
    def least_duration(self) -> float:
        """Lower bound of the duration from start to goal [s]."""
        robot = self.robot
        return least_duration(self.start, self.goal, robot.velocity_limit, robot.acceleration_limit)

    @property
    def margin(self) -> float:
        """Clearance required beyond the scene's own [m].

        At most `MARGIN`; less if start or goal have less.
        """
        return min(MARGIN, 0.5 * float(self.spare_clearances[0]))

    def in_world(self, world: World) -> Problem:
        """The problem in another world."""
        return replace(self, other_world=world)

    def with_goals(self, *numbers: int) -> Problem:
        """The problem with some of its goals alone, by their numbers."""
        chosen = list(numbers)
        return replace(
            self, goals=frozen(self.goals[chosen]), lower=frozen(self.lower[chosen]), upper=frozen(self.upper[chosen]),
            spare_clearances=frozen(self.spare_clearances[chosen]),
        )  # fmt: skip

    def from_configurations(self, start: ArrayLike, goal: ArrayLike) -> Problem:
        """The problem of moving between two configurations, validated.

        Args:
            start: (dof,) configuration.
            goal: (dof,) configuration.

        Raises:
            InputError: A value is not a configuration; a locked joint has different values in start and goal.
            JointLimitError: Start or goal violates the joint limits.
            ConfigurationInCollisionError: Start or goal is in collision, or closer to an obstacle than the required
                clearance; names link, obstacle and depth.
            NoPathError: A joint is blocked between start and goal for all values of the other joints.
        """
        world, robot = self.world, self.robot
        first = robot.check_configuration(start, "start")
        last = robot.check_configuration(goal, "goal")
        locked = robot.locked_mask(self.scene.locked_joints)
        for joint in np.flatnonzero(locked & (np.abs(last - first) > 1e-9)):
            name = robot.joint_names[joint]
            raise InputError(
                f"joint {name!r} is locked at {first[joint]:.6g} rad, but the goal has it at {last[joint]:.6g} rad",
                joint=name,
            )
        clearance = min(world.check_clear(first, "start"), world.check_clear(last, "goal"))
        last = readonly(np.where(locked, first, last))
        ranges = narrow_ranges(world.checker, first, last, clearance)
        return replace(
            self,
            start=first,
            goals=frozen(np.array(last[None])),
            lower=frozen(np.where(locked, first, ranges.lower)[None]),
            upper=frozen(np.where(locked, first, ranges.upper)[None]),
            other_world=world,
            spare_clearances=frozen(np.array([clearance])),
        )


def merge_problems(problems: Sequence[Problem]) -> Problem:
    """Merge problems with the same start: their goals become alternatives, in order."""
    first, *others = problems
    if not others:
        return first
    return replace(
        first,
        goals=frozen(np.concatenate([problem.goals for problem in problems])),
        lower=frozen(np.concatenate([problem.lower for problem in problems])),
        upper=frozen(np.concatenate([problem.upper for problem in problems])),
        spare_clearances=frozen(np.concatenate([problem.spare_clearances for problem in problems])),
    )
