"""The example with the bearing read as the paper prints it, arctan(x / y)."""

from __future__ import annotations

import math

import numpy as np
from studies.paper.results import Slip

from hplan.base.arrays import IntArray
from hplan.cspace.sections import ArmSections
from hplan.robot.model import Robot
from hplan.search import dense_search, slices_with_path
from hplan.search.grid import Grid, Occupancy


def slip_of(occupancy: Occupancy, start: IntArray, goal: IntArray) -> Slip:
    """What is left of the example in such a C-space."""
    if not occupancy.is_free(goal):
        return Slip(occupancy.occupied_count, goal_is_free=False, feasible_slices=0, cost_deg=None)
    feasible = slices_with_path(occupancy, start, goal)
    dense = dense_search(occupancy, start, goal)
    cost = None if dense.path is None else math.degrees(dense.cost)
    return Slip(occupancy.occupied_count, goal_is_free=True, feasible_slices=int(feasible.sum()), cost_deg=cost)


def printed_arctan(robot: Robot, grid: Grid, sections: ArmSections, *, in_link_frame: bool) -> Occupancy:
    """C-space with the bearing read as the paper prints it, arctan(x / y).

    Args:
        robot: The arm.
        grid: The joint grid.
        sections: One disc for each link.
        in_link_frame: Take x and y along and across the link before; else in the arm plane.
    """
    arm = robot.arm
    mesh = np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij", sparse=True)
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    x, y, heading = np.zeros((1, 1, 1)), np.zeros((1, 1, 1)), np.zeros((1, 1, 1))
    for k in range(3):
        cx, cy = sections.vertices[sections.vertex_start[sections.link_start[k]]]
        radius, length = sections.radii[sections.link_start[k]], arm.lengths[k]
        frame = heading if in_link_frame else np.zeros_like(heading)
        dx = np.cos(frame) * (cx - x) + np.sin(frame) * (cy - y)
        dy = np.cos(frame) * (cy - y) - np.sin(frame) * (cx - x)
        rho = np.hypot(dx, dy)
        with np.errstate(divide="ignore", invalid="ignore"):
            bearing = frame + np.arctan(dx / dy)
            tip = np.arccos(np.clip((length**2 + rho**2 - radius**2) / (2.0 * length * rho), -1.0, 1.0))
            half = np.where(rho**2 <= length**2 + radius**2, np.arcsin(np.clip(radius / rho, -1.0, 1.0)), tip)
        half = np.where(rho > length + radius, -1.0, np.where(rho <= radius, math.pi, half))
        heading = heading + arm.signs[k] * mesh[k] + arm.offsets[k]
        apart = np.abs((heading - bearing + math.pi) % (2.0 * math.pi) - math.pi)
        occupied |= apart <= half
        x, y = x + length * np.cos(heading), y + length * np.sin(heading)
    return Occupancy.from_mask(grid, occupied)
