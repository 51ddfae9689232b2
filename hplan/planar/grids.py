"""Grids over the C-space of a planar arm.

Their spacing, size and occupancy for a planning problem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import IntArray
from hplan.errors import OptionError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import PreparedObstacles, prepare_obstacles
from hplan.planar.grid.sections import ArmSections, sections_at
from hplan.planar.grid.yaw_layers import LayerCache, turning_occupancy, yaw_axis
from hplan.planning.problem import MARGIN, Problem
from hplan.planning.stages import stage
from hplan.planning.world import World

#: Multiples of the step tried if a grid has too many nodes, and the coarsest resulting step [deg]; the requested step
#: may be coarser.
_GRID_STEP_FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0)
COARSEST_DEG = 8.0

#: Maximum number of nodes of a grid.
MOST_CELLS = 1e8


@dataclass(frozen=True)
class GridAttempt:
    """Spacing and width of a grid, and growth of its obstacles.

    Attributes:
        step_factor: Maximum spacing of the grid as a multiple of the option `step_deg`.
        yaw_range_deg: Range of the yaw beyond start and goal, if the base may turn [deg].
        growth_m: Growth of obstacles in the C-space [m].
    """

    step_factor: float = 1.0
    yaw_range_deg: float = 0.0
    growth_m: float = 0.0


def base_turns(problem: Problem) -> bool:
    """True if the base has a yaw joint that may move."""
    return family_of(problem.robot).has_yaw and 0 in problem.movable


def grid_axes(problem: Problem) -> IntArray:
    """Joint of each grid axis.

    The planar joints, then the yaw if it may turn.
    """
    planar = np.arange(problem.robot.dof)[family_of(problem.robot).arm_slice]
    return np.append(planar, 0) if base_turns(problem) else planar


def grown_margin(problem: Problem, growth_m: float) -> float:
    """Additional clearance required with grown obstacles [m].

    Less if start or goal have less.
    """
    return min(MARGIN + growth_m, 0.5 * float(problem.spare_clearances[0]))


def possible_growth(problem: Problem, growth_m: float) -> float:
    """Maximum obstacle growth that keeps start and goal free [m].

    At most the given one.
    """
    return min(growth_m, 0.8 * float(problem.spare_clearances[0]))


def step_deg(problem: Problem, attempt: GridAttempt) -> float:
    """Maximum spacing of the grid of an attempt [deg]."""
    return attempt.step_factor * problem.options.step_deg


def count_nodes(problem: Problem, attempt: GridAttempt) -> float:
    """Approximate memory of an attempt's grid, as a number of nodes.

    The number may exceed every limit.
    """
    step = math.radians(step_deg(problem, attempt))
    planar = family_of(problem.robot).arm_slice
    lower, upper = problem.lower[0], problem.upper[0]
    count = math.prod((1.0 + (upper[planar] - lower[planar]) / step).tolist())
    if base_turns(problem):
        beyond = math.radians(attempt.yaw_range_deg)
        low = max(lower[0], min(problem.start[0], problem.goal[0]) - beyond)
        high = min(upper[0], max(problem.start[0], problem.goal[0]) + beyond)
        # A row of yaws takes at least the memory of 32 nodes.
        count *= max(1.0 + (high - low) / step, 32)
    return float(count)


def fitting_attempt(problem: Problem, attempt: GridAttempt, most_cells: float | None = None) -> GridAttempt | None:
    """Attempt with the smallest step factor that fits; None without.

    A grid fits if it has at most `most_cells` nodes.
    """
    most_cells = MOST_CELLS if most_cells is None else most_cells
    coarsest = max(attempt.step_factor, COARSEST_DEG / problem.options.step_deg)
    factors = (factor for factor in _GRID_STEP_FACTORS if attempt.step_factor <= factor <= coarsest)
    larger = (replace(attempt, step_factor=factor) for factor in factors)
    return next((coarser for coarser in larger if count_nodes(problem, coarser) <= most_cells), None)


def flood_attempt(problem: Problem, yaw_range_deg: float) -> GridAttempt | None:
    """Attempt with the finest grid that can be flooded, or None.

    Its yaws extend beyond start and goal by `yaw_range_deg`.
    """
    most = min(MOST_CELLS, problem.effort.proof_nodes)
    return fitting_attempt(problem, GridAttempt(yaw_range_deg=yaw_range_deg), most)


def planar_grid(problem: Problem, attempt: GridAttempt) -> Grid:
    """Grid over the planar joints.

    Raises:
        OptionError: The step gives no valid grid.
    """
    planar = family_of(problem.robot).arm_slice
    try:
        return Grid.from_limits(
            problem.lower[0][planar], problem.upper[0][planar], np.radians(step_deg(problem, attempt))
        )
    except OptionError as error:
        raise OptionError("step_deg", problem.options.step_deg, error.expected) from error


def prepare_world(world: World, more: float = 0.0) -> PreparedObstacles:
    """Obstacles of a world, grown and prepared for sections.

    They are grown by their clearance plus `more` [m].
    """
    linked, arm = world.linked, family_of(world.robot).arm_slice
    links = None if linked.joints is None else linked.joints[:, arm]
    if world.touched:
        touched = linked.name_mask(world.touched)
        everything = np.ones((len(touched), family_of(world.robot).arm.link_count), dtype=np.bool_)
        links = everything if links is None else links.copy()
        links[touched, -1] = False
    return prepare_obstacles(
        linked.solids,
        clearance=linked.growth + more,
        own_clearance=world.clearance + more,
        deviation=world.deviation,
        links=links,
    )


def obstacle_sections(problem: Problem, yaw: float, growth_m: float) -> ArmSections:
    """Sections of the grown obstacles with the arm plane at a yaw."""
    model = "capsule" if base_turns(problem) else problem.options.link_model
    return sections_at(problem.robot, prepare_world(problem.world, growth_m), yaw, link_model=model, within_reach=False)


def grid_occupancy(problem: Problem, attempt: GridAttempt) -> Occupancy:
    """C-space occupancy on an attempt's grid.

    The axes are the planar joints and, if the base may turn, the yaw.

    Raises:
        OptionError: The step gives no valid grid.
    """
    robot = problem.robot
    with stage("cspace"):
        planar = planar_grid(problem, attempt)
        if not base_turns(problem):
            sections = obstacle_sections(problem, family_of(robot).yaw_of(problem.start), attempt.growth_m)
            return occupancy(family_of(robot).arm, sections, planar)
        yaws = yaw_axis(
            problem.start[0], problem.goal[0], math.radians(step_deg(problem, attempt)), problem.lower[0][0],
            problem.upper[0][0], math.radians(attempt.yaw_range_deg),
        )  # fmt: skip
        layers = robot.cache("planar layers", LayerCache)
        return turning_occupancy(robot, prepare_world(problem.world, attempt.growth_m), planar, yaws, layers=layers)
