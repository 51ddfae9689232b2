"""Paths over the grid, planar and over yaw: ends, clearance, and errors without a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from planned import ABOVE, BAR, BELOW, posed, random_scene, task

import hplan.planar.no_path_proof
from hplan.errors import HplanError, OptionError
from hplan.planar.grid.grid import Occupancy
from hplan.planar.grid.yaw_layers import LayerCache, turning_occupancy, yaw_axis
from hplan.planar.grid_route import find_route
from hplan.planar.grids import GridAttempt, grid_axes, planar_grid, prepare_world
from hplan.planar.no_path_proof import EnclosedError, enclosed_goals, prove_infeasible
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.robot.model import Robot
from hplan.scene.model import Scene

MARGIN = 1e-4


def shown_enclosed(one: Problem, attempt: GridAttempt) -> EnclosedError | None:
    return enclosed_goals(one, attempt, [0], explained=True)[0]


def test_beyond_start_and_goal(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Closed in the plane and open next to it: the error says that more yaws might help, and they do."""
    one = posed(robot, task(BELOW, ABOVE, BAR), PlanOptions(step_deg=2.0))
    error = shown_enclosed(one, GridAttempt(1.0))
    assert error is not None
    assert error.open_ended
    assert error.reached_cells > 0
    assert shown_enclosed(one, GridAttempt(1.0, yaw_range_deg=20.0)) is None
    monkeypatch.setattr(hplan.planar.no_path_proof, "WIDTHS", (0.0, 20.0))
    assert prove_infeasible(one) == [None]


def test_step_that_gives_no_grid(robot: Robot, scene: Scene) -> None:
    with pytest.raises(OptionError) as caught:
        find_route(posed(robot, scene), GridAttempt(1e-6), MARGIN)
    assert caught.value.option == "step_deg"
    with pytest.raises(OptionError) as caught:
        shown_enclosed(posed(robot, task(BELOW, ABOVE, BAR)), GridAttempt(1e-6))
    assert caught.value.option == "step_deg"


def labels_of(space: Occupancy) -> Any:
    ndimage = pytest.importorskip("scipy.ndimage")
    return ndimage.label(~space.occupied_mask, structure=np.ones((3,) * len(space.grid.shape)))[0]


def on_nodes(values: Sequence[float], step: float) -> tuple[float, ...]:
    return tuple(float(step * round(value / step)) for value in values)


@pytest.mark.parametrize("seed", range(12))
def test_no_path_is_reported_if_none_exists(robot: Robot, seed: int) -> None:
    """Random scenes, start and goal on nodes of a coarse grid, whose parts are labelled without hplan."""
    step = 6.0
    drawn = random_scene(5000 + seed, robot)
    start = on_nodes(np.degrees(drawn.start.configuration).tolist(), step)
    rng = np.random.default_rng(seed)
    goal = (
        start[0] + step * int(rng.integers(1, 8)) * (-1 if start[0] > 0 else 1),
        *on_nodes(rng.uniform(6, 84, 3), step),
    )
    scene = task(start, goal, [*drawn.obstacles, *BAR])
    try:
        problem = posed(robot, scene)
    except HplanError:
        return
    bodies, planar = prepare_world(problem.world), planar_grid(problem, GridAttempt(step))
    ends = problem.start, problem.goal
    yaws = yaw_axis(ends[0][0], ends[1][0], math.radians(step), robot.lower[0], robot.upper[0], 0.0)
    space = turning_occupancy(robot, bodies, planar, yaws, layers=LayerCache())
    labels = labels_of(space)
    first, second = (labels[tuple(space.grid.nearest_node(q[grid_axes(problem)]))] for q in ends)
    assert first > 0
    assert second > 0
    error = shown_enclosed(problem, GridAttempt(step))
    assert (error is not None) == (first != second)
    if error is not None:
        assert error.reached_cells in {int((labels == part).sum()) for part in (first, second)}
