"""The paper's figures, drawn from the evidence."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hplan.reproduction.demonstration import DEMO_CENTRE, DEMO_DIAMETER
from hplan.reproduction.measure import Evidence
from hplan.view.figure_data import clearance_field
from hplan.view.figures_3d import cspace_and_path, overview, workspace
from hplan.view.figures_arm import arm_and_obstacle, link_cases, motions
from hplan.view.figures_cspace import layer_paths, restoration, slices, two_link_cspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figures(evidence: Evidence) -> dict[str, Callable[[], Figure]]:
    """File name -> how to draw it."""
    e = evidence
    arm, grid = e.robot.arm, e.occupancy.grid
    start_q, goal_q = grid.coordinates(e.start), grid.coordinates(e.goal)
    first = min(e.plain.paths)
    assert e.dense.path is not None
    assert e.plain.second.path is not None
    assert e.demo_result.path is not None
    dense_path, sparse_path, demo_path = e.dense.path, e.plain.second.path, e.demo_result.path
    field = clearance_field(arm, e.sections, grid)

    def at(*degrees: float) -> list[int]:
        return [int(np.argmin(np.abs(np.degrees(grid.axis(2)) - value))) for value in degrees]

    return {
        "figure_06_link_cases.png": link_cases,
        "figure_07_arm_and_obstacle.png": lambda: arm_and_obstacle(arm, e.centre, e.radius, start_q, goal_q),
        "figure_08_cspace_links_1_2.png": lambda: two_link_cspace(arm, e.sections, grid),
        "figure_09_slices.png": lambda: slices(
            arm, e.sections, e.occupancy, e.start, e.goal, at(0, 30, 44, 45, 70, 90)
        ),
        "figure_10_layer_paths.png": lambda: layer_paths(
            e.occupancy, e.start, e.goal, e.plain.paths, e.plain.expansions, [first - 1, first, *at(57, 70)]
        ),
        "figure_11_restoration.png": lambda: restoration(
            e.occupancy, e.start, e.goal, e.plain.paths[first], e.plain.heads, [first - 1, *at(30, 15, 0)]
        ),
        "figure_12_workspace.png": lambda: workspace(
            e.demo, DEMO_CENTRE, 0.5 * DEMO_DIAMETER, e.demo_result.slice_paths, demo_path
        ),
        "figure_14_cspace_and_path.png": lambda: cspace_and_path(
            grid, field, e.plain.paths, e.plain.heads, sparse_path
        ),
        "figure_15_motion.png": lambda: motions(
            arm,
            e.centre,
            e.radius,
            {"Dense A*": grid.coordinates(dense_path), "Two-level": grid.coordinates(sparse_path)},
        ),
        "overview.png": lambda: overview(arm, e.centre, e.radius, grid, field, sparse_path),
    }
