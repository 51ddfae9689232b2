"""The paper's figures by its own numbers, drawn from the evidence.

What they are given has the same names everywhere: `grid` over the planar joints, `field` the clearance at its nodes,
negative inside the obstacle [m], `path` (m, n) node indices, `paths` and `heads` the (m, 3) path of each slice and the
part that restoration keeps there, `centre` (2,) and `radius` of the disc in the arm plane [m]; angles in radians.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from studies.paper.figure_comparison import comparison
from studies.paper.figure_execution import snapshots
from studies.paper.figure_link_cases import link_case
from studies.paper.figure_two_links import two_links
from studies.paper.figures_joint_space import cspace_obstacle, overview, paths_in_cspace, sparse_path
from studies.paper.figures_workspace import workspace_layers, workspace_path
from studies.paper.measure import DEMO_CENTRE, DEMO_DIAMETER, Evidence, Reproduction
from studies.paper.plain import path_found
from studies.view.figure_data import clearance_field
from studies.view.figures_arm import arm_and_obstacle, motions
from studies.view.figures_cspace import slice_paths, slices

from hplan.apps.view.figure_style import styled
from hplan.base.arrays import FloatArray
from hplan.grid.grid import Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: theta3 of the slices in Figures 10 and 11 [deg].
SLICES_DEG = (0.0, 22.0, 44.0, 45.0, 66.0, 70.0)
#: Layers in Figure 7, in the paper's unit.
LAYERS = (5.0, 6.0, 12.0, 18.0, 24.0, 25.0)


def figures(numbers: Reproduction, evidence: Evidence) -> dict[str, Callable[[], Figure]]:
    """File name -> how to draw it, in the paper's order; the overview, which the paper does not have, comes last."""
    e = evidence
    arm, grid, disc = e.robot.arm, e.occupancy.grid, (e.centre, e.radius)
    ends = grid.coordinates(e.start), grid.coordinates(e.goal)
    dense, two_level = path_found(e.dense), path_found(e.plain.second)
    joint_paths = {"Dense A*": grid.coordinates(dense), "Two-level": grid.coordinates(two_level)}
    field = clearance_field(arm, e.sections, grid)
    ball = (DEMO_CENTRE, 0.5 * DEMO_DIAMETER)
    layers = e.demo_result.slice_paths, path_found(e.demo_result)
    shown = _nearest(grid, np.radians(SLICES_DEG))
    shown_layers = _nearest(e.demo.grid, np.array(LAYERS))
    degrees = [round(math.degrees(value)) for value in grid.axis(2)]
    expansions = {degrees[number]: count for number, count in e.plain.expansions.items()}
    found = {degrees[number] for number in e.plain.paths}

    drawings: dict[tuple[int, str], Callable[[], Figure]] = {
        (2, "link-and-circle-case-1"): lambda: link_case(1),
        (3, "link-and-circle-case-2"): lambda: link_case(2),
        (4, "link-and-circle-case-3"): lambda: link_case(3),
        (5, "two-links"): lambda: two_links(arm, e.sections, grid),
        (6, "workspace-path"): lambda: workspace_path(e.demo, *ball, *layers),
        (7, "workspace-layers"): lambda: workspace_layers(e.demo, *ball, *layers, shown_layers),
        (8, "arm-and-obstacle"): lambda: arm_and_obstacle(arm, *disc, *ends),
        (9, "cspace"): lambda: cspace_obstacle(grid, field, e.start, e.goal, e.occupancy.occupied_count),
        (10, "slices"): lambda: slices(arm, e.sections, e.occupancy, e.start, e.goal, shown),
        (11, "slice-paths"): lambda: slice_paths(e.occupancy, e.start, e.goal, e.plain.paths, e.plain.heads, shown),
        (12, "sparse-path"): lambda: sparse_path(grid, field, e.plain.paths, e.plain.heads, two_level),
        (13, "execution"): lambda: snapshots(arm, *disc, grid, field, two_level),
        (14, "paths-in-cspace"): lambda: paths_in_cspace(grid, field, dense, two_level),
        (15, "paths-in-workspace"): lambda: motions(arm, *disc, joint_paths),
        (16, "comparison"): lambda: comparison(numbers, expansions, found),
    }
    named = {
        f"figure-{number:02d}-{subject}.png": functools.partial(_numbered, number, draw)
        for (number, subject), draw in drawings.items()
    }
    return {**named, "overview.png": lambda: overview(arm, *disc, grid, field, two_level)}


def _nearest(grid: Grid, values: FloatArray) -> list[int]:
    """Slices nearest to values along the grid's last axis."""
    return [int(number) for number in np.rint((values - grid.lower[-1]) / grid.step[-1])]


@styled
def _numbered(number: int, draw: Callable[[], Figure]) -> Figure:
    """Draw a figure and set the paper's number before its title."""
    figure = draw()
    figure.suptitle(f"Fig. {number}.  {figure.get_suptitle()}", x=0.012, ha="left")
    return figure
