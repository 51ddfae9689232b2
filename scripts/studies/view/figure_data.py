"""What the figures show, as arrays: forbidden angles, clearance over the C-space, masks of its slices."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray
from hplan.errors import InputError
from hplan.grid import occupancy as cspace
from hplan.grid.grid import Grid
from hplan.grid.sections import ArmSections
from hplan.robot.planar_family import PlanarArm


def disc_of(sections: ArmSections, link: int) -> tuple[FloatArray, float]:
    """The one disc that a link must avoid: its (2,) centre and its grown radius [m].

    Raises:
        InputError: The link has no section, several, or one that is no disc.
    """
    first, last = int(sections.link_start[link]), int(sections.link_start[link + 1])
    if last - first != 1 or sections.vertex_start[last] - sections.vertex_start[first] != 1:
        raise InputError(f"link {link}: this figure wants exactly one disc as obstacle", link=link)
    return sections.vertices[sections.vertex_start[first]], float(sections.radii[first])


def half_angles(rho: ArrayLike, length: float, radius: float) -> FloatArray:
    """Half of the forbidden interval by equations (1)-(3): NaN where there is none, pi where all is forbidden."""
    distance = np.asarray(rho, dtype=np.float64)
    safe = np.maximum(distance, radius)
    tangent = np.arcsin(np.clip(radius / safe, -1.0, 1.0))
    tip = np.arccos(np.clip((length**2 + safe**2 - radius**2) / (2.0 * length * safe), -1.0, 1.0))
    result = np.where(safe**2 <= length**2 + radius**2, tangent, tip)
    result = np.where(distance > length + radius, np.nan, result)
    return np.where(distance <= radius, math.pi, result)


def clearance_field(arm: PlanarArm, sections: ArmSections, grid: Grid) -> FloatArray:
    """Distance from the arm's nearest link axis to its grown disc at every grid node, negative inside [m].

    Returns:
        (N1, ..., Nn) clearance of capsule links.
    """
    mesh = np.meshgrid(*(grid.axis(k) for k in range(len(grid.shape))), indexing="ij")
    angle = np.zeros(grid.shape)
    x, y = np.zeros(grid.shape), np.zeros(grid.shape)
    field = np.full(grid.shape, np.inf)
    for k, q in enumerate(mesh):
        angle = angle + arm.signs[k] * q + arm.offsets[k]
        cos, sin = np.cos(angle), np.sin(angle)
        centre, radius = disc_of(sections, k)
        dx, dy = centre[0] - x, centre[1] - y
        along = np.clip(dx * cos + dy * sin, 0.0, arm.lengths[k])
        field = np.minimum(field, np.hypot(dx - along * cos, dy - along * sin) - radius)
        x, y = x + arm.lengths[k] * cos, y + arm.lengths[k] * sin
    return field


def reached_mask(free: BoolArray, seed: tuple[int, int]) -> BoolArray:
    """Nodes of a slice connected to `seed` over its eight neighbours, (N1, N2)."""
    reached = np.zeros_like(free)
    reached[seed] = free[seed]
    while True:
        grown = np.pad(reached, 1)
        grown = grown[:-2] | grown[1:-1] | grown[2:]
        grown = (grown[:, :-2] | grown[:, 1:-1] | grown[:, 2:]) & free
        if bool((grown == reached).all()):
            return reached
        reached = grown


def earlier_links(arm: PlanarArm, sections: ArmSections, grid: Grid) -> BoolArray:
    """Mask over all axes but the last: where the links before the last one collide."""
    n = arm.link_count - 1
    shorter = replace(
        arm,
        joint_names=arm.joint_names[:n],
        link_names=arm.link_names[:n],
        **{
            key: getattr(arm, key)[:n]
            for key in ("lengths", "half_widths", "lateral", "signs", "offsets", "lower", "upper")
        },
    )
    fewer = replace(sections, link_start=sections.link_start[: n + 1])
    return cspace.occupancy(shorter, fewer, Grid(grid.lower[:n], grid.step[:n], grid.shape[:n])).occupied


def pair_mask(arm: PlanarArm, sections: ArmSections, grid: Grid) -> BoolArray:
    """(N1, N2) mask of the nodes at which link 1 or 2 collides."""
    if arm.link_count == 2:
        return cspace.occupancy(arm, sections, grid).occupied
    if arm.link_count == 3:
        return earlier_links(arm, sections, grid)
    raise InputError("this figure wants a planar arm of two or three links", links=arm.link_count)
