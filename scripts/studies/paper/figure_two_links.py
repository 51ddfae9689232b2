"""Figure of two links and a circle: the forbidden angles of the second link, for one theta1 and for all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from studies.view.figure_data import disc_of, half_angles, pair_mask
from studies.view.figures_arm import capsule_outline, draw_disc, draw_link
from studies.view.figures_cspace import degree_axes, paint

from hplan.apps.view.figure_style import (
    FAINT,
    INK,
    LINKS,
    OBSTACLE,
    OBSTACLE_TINT,
    PATH,
    QUIET,
    RESTORED,
    new_figure,
    styled,
)
from hplan.base.arrays import FloatArray
from hplan.grid.grid import Grid
from hplan.grid.sections import ArmSections
from hplan.robot.planar_family import PlanarArm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class SecondLink:
    """Where the circle lies for the second link, over theta1.

    Attributes:
        theta: (m,) angles of the first joint.
        elbow: (m, 2) places of the second joint [m].
        rho: (m,) distances of the circle's centre from it [m].
        bearing: (m,) theta2 at which the second link points at the centre.
        half: (m,) half of the forbidden interval: NaN where there is none, pi where all is forbidden.
    """

    theta: FloatArray
    elbow: FloatArray
    rho: FloatArray
    bearing: FloatArray
    half: FloatArray

    @classmethod
    def over(cls, arm: PlanarArm, sections: ArmSections, theta: FloatArray) -> SecondLink:
        """The second link of an arm among one disc, for (m,) angles of the first joint."""
        heading = arm.signs[0] * theta + arm.offsets[0]
        elbow = arm.lengths[0] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        centre, radius = disc_of(sections, 1)
        offset = centre - elbow
        rho = np.hypot(offset[:, 0], offset[:, 1])
        turn = (np.arctan2(offset[:, 1], offset[:, 0]) - heading + math.pi) % (2.0 * math.pi) - math.pi
        bearing = arm.signs[1] * (turn - arm.offsets[1])
        return cls(theta, elbow, rho, bearing, half_angles(rho, float(arm.lengths[1]), radius))


@styled
def two_links(arm: PlanarArm, sections: ArmSections, grid: Grid, theta1: float = math.radians(40.0)) -> Figure:
    """Two links and a circle: the second link for one theta1, the case that applies over theta1, and the C-space."""
    figure = new_figure(11.4, 7.6, "Two links and a circle: which angles of link 2 are forbidden")
    panels = figure.add_gridspec(2, 2, width_ratios=(1.0, 1.08), height_ratios=(1.55, 1.0))
    high = float(grid.coordinates(np.array(grid.shape) - 1)[0])
    second = SecondLink.over(arm, sections, np.linspace(float(grid.lower[0]), high, 7201))
    _draw_links(figure.add_subplot(panels[0, 0]), arm, sections, theta1)
    _draw_cases(figure.add_subplot(panels[1, 0]), arm, sections, second)
    _draw_cspace(figure.add_subplot(panels[:, 1]), arm, sections, grid, second)
    axes = figure.axes[2]
    axes.axvline(math.degrees(theta1), color=QUIET, lw=1.0, ls=(0, (3, 2)), zorder=3)
    axes.text(math.degrees(theta1) + 1.0, 88.5, f"$\\theta_1$ = {math.degrees(theta1):g}°, as drawn", color=QUIET,
              fontsize=8, va="top")  # fmt: skip
    return figure


def _draw_links(axes: Axes, arm: PlanarArm, sections: ArmSections, theta1: float) -> None:
    """Draw the first link at one angle, and the second where it begins and where it ends to touch the circle."""
    from matplotlib.patches import Arc, Polygon, Wedge

    second = SecondLink.over(arm, sections, np.array([theta1]))
    elbow, rho = second.elbow[0], float(second.rho[0])
    bearing, half = float(second.bearing[0]), float(second.half[0])
    centre, grown = disc_of(sections, 1)
    width, length = float(arm.half_widths[1]), float(arm.lengths[1])
    heading = float(arm.signs[0] * theta1 + arm.offsets[0])
    upper = capsule_outline((0, 0), elbow, float(arm.half_widths[0]))
    axes.add_patch(Polygon(upper, fc=LINKS[0], ec="white", zorder=4))
    draw_disc(axes, centre, grown - width, grown)
    low, high = heading + bearing - half, heading + bearing + half
    axes.add_patch(Wedge(elbow, length, math.degrees(low), math.degrees(high), fc=OBSTACLE_TINT, alpha=0.35, lw=0))
    for angle, opacity in ((low, 1.0), (high, 0.55)):
        draw_link(axes, elbow, angle, length, width, alpha=opacity)
    ahead = elbow + 0.34 * np.array([math.cos(heading), math.sin(heading)])
    axes.plot([elbow[0], ahead[0]], [elbow[1], ahead[1]], color=QUIET, lw=0.9, ls=(0, (3, 2)), zorder=6)
    axes.plot([elbow[0], centre[0]], [elbow[1], centre[1]], color=INK, lw=1.0, ls=(0, (5, 2, 1, 2)), zorder=6)
    axes.plot([0.0, 0.42], [0.0, 0.0], color=FAINT, lw=1.0, zorder=0)
    for place, size, first, last in (
        ((0.0, 0.0), 0.5, 0.0, heading),
        (elbow, 0.4, heading, heading + bearing),
        (elbow, 0.8, heading + bearing, high),
    ):
        axes.add_patch(
            Arc(place, size, size, theta1=math.degrees(first), theta2=math.degrees(last), color=INK, zorder=8)
        )
    for place, distance, angle, text in (
        (np.zeros(2), 0.31, 0.5 * heading, r"$\theta_1$"),
        (elbow, 0.27, heading - 0.13, r"$\varphi$"),
        (elbow, 0.35, 0.5 * (heading + bearing + high), r"$\delta$"),
        (elbow, 0.43, heading + bearing - 0.09, r"$\rho$"),
    ):
        x, y = place + distance * np.array([math.cos(angle), math.sin(angle)])
        axes.text(x, y, text, fontsize=10.5, ha="center", va="center", zorder=9)
    for x, y in ((0.0, 0.0), elbow):
        axes.plot(x, y, "o", color="white", ms=5, mec=INK, zorder=9)
    axes.set_aspect("equal")
    axes.set_xlim(-0.12, 1.4)
    axes.set_ylim(-0.1, 1.52)
    axes.set_xlabel("arm plane, horizontal [m]")
    axes.set_ylabel("arm plane, up [m]")
    begin, end = math.degrees(bearing - half), math.degrees(bearing + half)
    axes.set_title(f"At $\\theta_1$ = {math.degrees(theta1):g}°:  $\\rho$ = {rho:.3f} m,  forbidden "
                   f"{begin:.1f}° $\\leq \\theta_2 \\leq$ {end:.1f}°")  # fmt: skip


def _draw_cases(axes: Axes, arm: PlanarArm, sections: ArmSections, second: SecondLink) -> None:
    """Draw the distances that decide the case, over theta1."""
    shoulder, first_grown = disc_of(sections, 0)
    grown = disc_of(sections, 1)[1]
    length, rho = float(arm.lengths[1]), second.rho
    degrees = np.degrees(second.theta)
    limits = (grown, math.hypot(length, grown), length + grown)
    constant = float(np.hypot(*shoulder))
    axes.axhspan(0.0, limits[0], color=OBSTACLE, alpha=0.75, lw=0)
    axes.axhspan(limits[0], limits[1], color=OBSTACLE_TINT, alpha=0.55, lw=0)
    axes.axhspan(limits[1], limits[2], color=RESTORED, alpha=0.35, lw=0)
    axes.plot(degrees, rho, color=PATH, lw=2.2)
    axes.axhline(constant, color=INK, lw=1.6)
    middle = 0.5 * float(degrees[0] + degrees[-1])
    reach = float(arm.lengths[0]) + first_grown
    lowest = int(np.argmin(rho))
    for x, height, text, color, va in (
        (middle, constant + 0.03, f"link 1: $\\rho$ = {constant:.2f} m, beyond its reach {reach:.2f} m", INK, "bottom"),
        (middle, limits[2] + 0.03, "case 3: out of link 2's reach", QUIET, "bottom"),
        (middle, 0.5 * (limits[1] + limits[2]), "case 2: the tip of link 2 touches", INK, "center"),
        (middle, 0.5 * (limits[0] + limits[1]) - 0.16, "case 1: the side of link 2 touches", INK, "center"),
        (middle, 0.5 * limits[0], r"$\rho \leq R_2$: every $\theta_2$ is forbidden", INK, "center"),
        (float(degrees[lowest]), float(rho[lowest]) - 0.02, r"link 2: $\rho$ from the elbow", PATH, "top"),
    ):
        axes.text(x, height, text, color=color, va=va, ha="center", fontsize=8)
    axes.set_xlim(degrees[0], degrees[-1])
    axes.set_ylim(0.0, 1.2 * max(constant, float(rho.max())))
    axes.set_xticks(np.arange(degrees[0], degrees[-1] + 1e-6, 30.0))
    axes.set_xlabel(r"$\theta_1$ [deg]")
    axes.set_ylabel(r"joint to circle, $\rho$ [m]")
    axes.set_title("Which case applies")


def _draw_cspace(axes: Axes, arm: PlanarArm, sections: ArmSections, grid: Grid, second: SecondLink) -> None:
    """Draw the forbidden intervals of the second link over theta1, and the nodes inside."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    degrees = np.degrees(second.theta)
    occupied = pair_mask(arm, sections, grid)
    paint(axes, grid, [(occupied, OBSTACLE_TINT)])
    by_tip = second.rho > math.hypot(float(arm.lengths[1]), disc_of(sections, 1)[1])
    for mask, color in ((~by_tip, OBSTACLE), (by_tip, RESTORED)):
        for side in (-1.0, 1.0):
            edge = np.where(mask, np.degrees(second.bearing + side * second.half), np.nan)
            axes.plot(degrees, edge, color=color, lw=2.0, zorder=4)
    line = np.where(np.isfinite(second.half), np.degrees(second.bearing), np.nan)
    axes.plot(degrees, line, color=INK, lw=0.9, ls=(0, (5, 2, 1, 2)), zorder=4)
    degree_axes(axes, grid)
    axes.set_title(f"C-space of both links: {int(occupied.sum())} of {occupied.size:,} nodes occupied")
    axes.legend(
        handles=[
            Patch(fc=OBSTACLE_TINT, label="occupied nodes"),
            Line2D([], [], color=OBSTACLE, lw=2, label="case 1, equation (1)"),
            Line2D([], [], color=RESTORED, lw=2, label="case 2, equation (2)"),
            Line2D([], [], color=INK, lw=0.9, ls=(0, (5, 2, 1, 2)), label=r"bearing $\varphi$"),
        ],
        loc="center right", frameon=True, framealpha=0.92, edgecolor="none",
    )  # fmt: skip
