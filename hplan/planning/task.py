"""A motion to plan: the arm among obstacles, start and goal, options; and the grids over its C-space."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import IntArray, Record
from hplan.base.deadline import check_deadline
from hplan.collision.clearance_field import ClearanceField
from hplan.errors import OptionError
from hplan.grid.grid import Grid, Occupancy
from hplan.grid.occupancy import occupancy
from hplan.grid.sections import ArmSections, sections_at
from hplan.grid.yaw_layers import LayerCache, turning_occupancy, yaw_axis
from hplan.optimization.several_starts import StartsEffort
from hplan.planning.definition import Problem, check_problem
from hplan.planning.effort import Effort, GridAttempt, efforts_of
from hplan.planning.options import PlanOptions
from hplan.planning.stages import StageClock
from hplan.planning.world import World
from hplan.robot.limits import least_duration
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas, Solid

#: Clearance asked for wherever a motion is evaluated, beyond the scene's own [m]; less where start or goal have less.
MARGIN = 2e-3

#: Multiples of the step that are tried where a grid has too many nodes, as long as the step is no larger than the
#: coarsest [deg]; the one that is asked for may be.
_STEP_FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
COARSEST_DEG = 8.0

#: Most nodes of a grid.
MOST_CELLS = 1e8

#: Called with the name of each stage as it begins.
Progress = Callable[[str], None]


def no_progress(_: str) -> None:
    """Ignore the stages."""


@dataclass(frozen=True, eq=False)
class PlanningContext(Record):
    """World, scene and options, common to all motions planned among the same obstacles.

    Attributes:
        world: The arm and what it must keep clear of.
        effort: What may be spent on a motion.
        layers: Planar layers that are already there.
        progress: Called with the name of each stage as it begins.
    """

    world: World
    scene: Scene
    options: PlanOptions
    effort: Effort
    layers: LayerCache
    clock: StageClock
    progress: Progress

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.world.robot

    @property
    def field(self) -> ClearanceField:
        """Distances between the arm and what it must keep clear of."""
        return self.world.field

    @property
    def optimization(self) -> StartsEffort | None:
        """What may be spent on optimisation; None where a short path is asked for, not a fast motion."""
        return self.effort.starts if self.options.objective == "duration" else None

    def __getstate__(self) -> dict[str, tuple[Any, bool]]:
        """The fields; who listens to the progress of a plan does not travel with it."""
        return {**super().__getstate__(), "progress": (no_progress, False)}

    def among(self, world: World) -> PlanningContext:
        """The task among other obstacles."""
        return replace(self, world=world)

    def task(self, start: ArrayLike, goal: ArrayLike) -> PlanningTask:
        """The task of moving between two (dof,) configurations.

        Raises:
            HplanError: As `check_problem`.
        """
        problem = check_problem(self.world, start, goal, locked_joints=self.scene.locked_joints)
        common = {field.name: getattr(self, field.name) for field in fields(PlanningContext)}
        return PlanningTask(**common, problem=problem)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Announce a stage, and note the time of what runs inside."""
        check_deadline()
        self.progress(name)
        with self.clock.stage(name):
            yield


@dataclass(frozen=True, eq=False)
class PlanningTask(PlanningContext):
    """A motion to plan.

    Attributes:
        problem: Start, goal, joints that may move.
    """

    problem: Problem

    @property
    def least_duration(self) -> float:
        """Duration that no motion between start and goal can undercut [s]."""
        problem, robot = self.problem, self.robot
        return least_duration(problem.start, problem.goal, robot.velocity_limit, robot.acceleration_limit)

    @property
    def axes(self) -> IntArray:
        """The joint behind each axis of the grid: the planar joints, then the yaw where it may turn."""
        planar = np.arange(self.robot.dof)[self.robot.arm_slice]
        return np.append(planar, 0) if self.problem.turns else planar

    def margin(self, growth_m: float = 0.0) -> float:
        """Clearance asked for beyond the one to keep [m]: less where start or goal have less."""
        return min(MARGIN + growth_m, 0.5 * self.problem.spare_clearance)

    def grown(self, growth_m: float) -> float:
        """Growth of obstacles at which start and goal stay free, at most the given one [m]."""
        return min(growth_m, 0.8 * self.problem.spare_clearance)

    def step_deg(self, attempt: GridAttempt) -> float:
        """Largest spacing of the grid of an attempt [deg]."""
        return attempt.step_factor * self.options.step_deg

    def cells(self, attempt: GridAttempt) -> float:
        """About how many nodes the grid of an attempt has, by the memory it takes; it need not fit any."""
        problem, step = self.problem, math.radians(self.step_deg(attempt))
        planar = self.robot.arm_slice
        count = math.prod((1.0 + (problem.upper[planar] - problem.lower[planar]) / step).tolist())
        if problem.turns:
            beyond = math.radians(attempt.yaw_range_deg)
            low = max(problem.lower[0], min(problem.start[0], problem.goal[0]) - beyond)
            high = min(problem.upper[0], max(problem.start[0], problem.goal[0]) + beyond)
            # A row of yaws takes as much memory as one of so many nodes, however few there are.
            count *= max(1.0 + (high - low) / step, 32)
        return float(count)

    def to_flood(self, yaw_range_deg: float) -> GridAttempt | None:
        """The finest grid that may be flooded, the base turning so far beyond start and goal; None without any."""
        return self.fitting(GridAttempt(yaw_range_deg=yaw_range_deg), min(MOST_CELLS, self.effort.floods))

    def fitting(self, attempt: GridAttempt, most_cells: float | None = None) -> GridAttempt | None:
        """The attempt with a step as much larger as keeps the grid within a number of nodes; None without any."""
        most_cells = MOST_CELLS if most_cells is None else most_cells
        coarsest = max(attempt.step_factor, COARSEST_DEG / self.options.step_deg)
        factors = (factor for factor in _STEP_FACTORS if attempt.step_factor <= factor <= coarsest)
        larger = (replace(attempt, step_factor=factor) for factor in factors)
        return next((coarser for coarser in larger if self.cells(coarser) <= most_cells), None)

    def planar_grid(self, attempt: GridAttempt) -> Grid:
        """The grid over the planar joints.

        Raises:
            OptionError: A step that gives none.
        """
        planar = self.robot.arm_slice
        try:
            return Grid.over(self.problem.lower[planar], self.problem.upper[planar], np.radians(self.step_deg(attempt)))
        except OptionError as error:
            raise OptionError("step_deg", self.options.step_deg, error.expected) from error

    def sections(self, yaw: float, growth_m: float) -> ArmSections:
        """Obstacles, grown, cut by the arm plane at a yaw."""
        model = "capsule" if self.problem.turns else self.options.link_model
        return sections_at(self.robot, self.world.bodies(growth_m), yaw, link_model=model, within_reach=False)

    def occupancy(self, attempt: GridAttempt) -> Occupancy:
        """The C-space on the grid of an attempt: over the planar joints and, where the base may turn, the yaw.

        Raises:
            OptionError: A step that gives no grid.
        """
        problem, robot = self.problem, self.robot
        with self.stage("cspace"):
            if not problem.turns:
                sections = self.sections(robot.yaw_of(problem.start), attempt.growth_m)
                return occupancy(robot.arm, sections, self.planar_grid(attempt))
            planar = self.planar_grid(attempt)
            yaws = yaw_axis(
                problem.start[0], problem.goal[0], math.radians(self.step_deg(attempt)), problem.lower[0],
                problem.upper[0], math.radians(attempt.yaw_range_deg),
            )  # fmt: skip
            bodies = self.world.bodies(attempt.growth_m)
            return turning_occupancy(robot, bodies, planar, yaws, layers=self.layers)


class LastWorld:
    """The last world that was made, and what of: another one takes its place."""

    def __init__(self) -> None:
        self._kept: tuple[tuple[tuple[Solid, ...], float, float, Sigmas, tuple[str, ...] | None], World] | None = None

    @classmethod
    def of(cls, robot: Robot) -> LastWorld:
        """The one that a robot keeps, from one plan to the next."""
        return robot.cached("last world", cls)

    def world(self, robot: Robot, scene: Scene, options: PlanOptions) -> World:
        """The robot among the scene's solids, all fruits among them; the same as before where these are the same."""
        # What need not be certified need not make room for the tracking error either; it is certified all the same.
        tracking_error = options.tracking.still_rad
        solids, clearance, sigmas = scene.solids_with_goal, scene.clearance, options.sigmas
        check_deadline()
        asked = solids, clearance, tracking_error, sigmas, scene.yield_links
        kept = self._kept
        if kept is None or kept[0] != asked:
            world = World.of(
                robot, solids, clearance=clearance, tracking_error=tracking_error, sigmas=sigmas,
                yield_links=scene.yield_links,
            )  # fmt: skip
            self._kept = kept = asked, world
        return kept[1]


class PlanningCache:
    """Results that one plan leaves for the next: the robot's planar layers, and the last world."""

    def __init__(self, robot: Robot, last: LastWorld | None = None) -> None:
        self.robot = robot
        self.layers = LayerCache()
        self._last = LastWorld() if last is None else last

    def world(self, scene: Scene, options: PlanOptions) -> World:
        """The robot among the scene's solids (`LastWorld.world`)."""
        return self._last.world(self.robot, scene, options)

    def context(
        self, scene: Scene, options: PlanOptions, progress: Progress = no_progress, clock: StageClock | None = None
    ) -> PlanningContext:
        """A context with a clock, its own where none is given, to plan motions among the scene's solids."""
        clock = StageClock() if clock is None else clock
        effort = efforts_of(self.robot, options)[-1]
        return PlanningContext(self.world(scene, options), scene, options, effort, self.layers, clock, progress)
