"""Figures of one link and a circle: the three cases of equations (1)-(3)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from studies.view.figure_data import half_angles
from studies.view.figures_arm import draw_disc, draw_link

from hplan.apps.view.figure_style import FAINT, INK, OBSTACLE_TINT, QUIET, new_figure, styled
from hplan.base.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LinkAndCircle:
    """One link and a circle: the lengths of equations (1)-(3).

    Attributes:
        length: Length of the link [m].
        half_width: Half-width of the link [m].
        radius: Radius of the circle [m].
        rho: Distance of the circle's centre from the link's joint [m].
        bearing: Bearing of the centre, counter-clockwise from +x [rad].
    """

    length: float
    half_width: float
    radius: float
    rho: float
    bearing: float

    @property
    def grown(self) -> float:
        """Radius of the circle grown by the link's half-width [m]."""
        return self.radius + self.half_width

    @property
    def centre(self) -> FloatArray:
        """(2,) centre of the circle, the joint at the origin [m]."""
        return self.rho * np.array([math.cos(self.bearing), math.sin(self.bearing)])

    @property
    def half_angle(self) -> float:
        """Half of the forbidden interval [rad], NaN where there is none."""
        return float(half_angles(self.rho, self.length, self.grown))

    @property
    def side_limit(self) -> float:
        """Distance up to which the side of the link touches first, then its tip [m]."""
        return math.hypot(self.length, self.grown)


#: Case -> what happens, its condition, its half-angle by equations (1)-(3), and the distance drawn [m].
_CASES = {
    1: (
        "the side of the link touches",
        r"$R < \rho \leq \sqrt{L^2 + R^2}$",
        r"$\delta = \arcsin\,\dfrac{R}{\rho}$",
        0.8,
    ),
    2: (
        "the tip of the link touches",
        r"$\sqrt{L^2 + R^2} < \rho \leq L + R$",
        r"$\delta = \arccos\,\dfrac{L^2 + \rho^2 - R^2}{2 L \rho}$",
        1.12,
    ),
    3: ("the circle is out of reach", r"$\rho > L + R$", "no angle is forbidden", 1.32),
}


@styled
def link_case(case: Literal[1, 2, 3]) -> Figure:
    """One link and a circle in one of the three cases of equations (1)-(3), with the numbers of what is drawn.

    Link and circle have the size of the example's first link and of its obstacle.
    """
    happens, condition, result, rho = _CASES[case]
    pair = LinkAndCircle(length=1.0, half_width=0.05, radius=0.15, rho=rho, bearing=math.radians(40.0))
    figure = new_figure(9.6, 5.4, f"One link and a circle, case {case}: {happens}")
    axes, text = figure.subplots(1, 2, width_ratios=(1.75, 1.0))
    draw_disc(axes, pair.centre, pair.radius, pair.grown)
    _draw_bearing(axes, pair)
    if case < 3:
        _draw_touching_links(axes, pair)
    else:
        draw_link(axes, (0.0, 0.0), math.radians(14.0), pair.length, pair.half_width)
        _draw_radius(axes, pair, pair.bearing + math.radians(70.0))
    axes.set_aspect("equal")
    axes.set_xlim(-0.13, 1.32)
    axes.set_ylim(-0.13, 1.13)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")

    text.axis("off")
    text.text(0.0, 0.97, condition, va="top", fontsize=12.5)
    text.text(0.0, 0.82, result, va="top", fontsize=12.5 if case == 3 else 14.0)
    text.text(0.0, 0.56, "\n".join(_numbers_of(pair)), va="top", linespacing=1.75)
    notes = ["Solid: obstacle. Dashed: grown by the half-width $w$.", r"Bearing $\varphi = \mathrm{arctan2}(y, x)$."]
    if case > 1:
        printed = math.hypot(pair.length, pair.half_width) + pair.radius
        notes += ["The paper sets case 3 beyond", f"$\\sqrt{{L^2 + w^2}} + r$ = {printed:.3f} m."]
    text.text(0.0, -0.02, "\n".join(notes), va="bottom", fontsize=8.0, color=QUIET, linespacing=1.5)
    return figure


def _numbers_of(pair: LinkAndCircle) -> list[str]:
    """The lengths and angles of the picture, a line each."""
    lines = [
        f"$L$ = {pair.length:g} m,  $w$ = {100 * pair.half_width:g} cm,  $r$ = {100 * pair.radius:g} cm",
        f"$R = r + w$ = {100 * pair.grown:g} cm",
        f"$\\rho$ = {pair.rho:g} m,  $\\varphi$ = {math.degrees(pair.bearing):g}°",
        f"$\\sqrt{{L^2 + R^2}}$ = {pair.side_limit:.3f} m",
        f"$L + R$ = {pair.length + pair.grown:.3f} m",
    ]
    half = pair.half_angle
    if math.isfinite(half):
        low, high = math.degrees(pair.bearing - half), math.degrees(pair.bearing + half)
        lines += [f"$\\delta$ = {math.degrees(half):.1f}°", f"forbidden: {low:.1f}° $\\leq \\theta \\leq$ {high:.1f}°"]
    return lines


def _draw_bearing(axes: Axes, pair: LinkAndCircle) -> None:
    """Draw the line from joint to circle, its angle, and the reach of the link."""
    from matplotlib.patches import Arc

    x, y = pair.centre
    axes.plot([0.0, 1.25], [0.0, 0.0], color=FAINT, lw=1.0, zorder=0)
    axes.plot([0.0, x], [0.0, y], color=INK, lw=1.0, ls=(0, (5, 2, 1, 2)), zorder=6)
    axes.plot(x, y, "+", color="white", ms=8, mew=1.4, zorder=7)
    reach = np.linspace(math.radians(-4.0), math.radians(88.0), 60)
    axes.plot(pair.length * np.cos(reach), pair.length * np.sin(reach), color=QUIET, lw=0.8, ls=":", zorder=1)
    axes.text(pair.length + 0.02, -0.06, "reach $L$", fontsize=8.5, color=QUIET, ha="left", va="top")
    along = (0.66 if pair.rho < pair.length else 0.5) * pair.centre
    aside = 0.035 / pair.rho * np.array([-y, x])
    x, y = along + aside
    axes.text(x, y, r"$\rho$", fontsize=11.5, ha="center", va="center", zorder=8)
    axes.add_patch(Arc((0, 0), 0.42, 0.42, theta1=0, theta2=math.degrees(pair.bearing), color=INK, zorder=8))
    axes.text(0.235, -0.045, r"$\varphi$", fontsize=11, ha="center", va="center", zorder=8)
    axes.plot(0, 0, "o", color=INK, ms=6, mec="white", zorder=9)


def _draw_radius(axes: Axes, pair: LinkAndCircle, direction: float) -> None:
    """Draw a radius of the grown circle, with its letter."""
    centre = pair.centre
    foot = centre + pair.grown * np.array([math.cos(direction), math.sin(direction)])
    axes.plot([centre[0], foot[0]], [centre[1], foot[1]], color=INK, lw=1.1, zorder=6)
    x, y = 0.5 * (centre + foot) + 0.04 * np.array([-math.sin(direction), math.cos(direction)])
    axes.text(x, y, "$R$", ha="center", va="center", fontsize=11, zorder=8)


def _draw_touching_links(axes: Axes, pair: LinkAndCircle) -> None:
    """Draw the link where it begins and where it ends to touch, and the angles between, which are forbidden."""
    from matplotlib.patches import Arc, Wedge

    bearing, low, high = pair.bearing, pair.bearing - pair.half_angle, pair.bearing + pair.half_angle
    by_side = pair.rho <= pair.side_limit
    axes.add_patch(
        Wedge((0, 0), pair.length, math.degrees(low), math.degrees(high), fc=OBSTACLE_TINT, alpha=0.35, lw=0)
    )
    for angle, opacity in ((low, 1.0), (high, 0.55)):
        tip = draw_link(axes, (0.0, 0.0), angle, pair.length, pair.half_width, alpha=opacity)
        touch = math.sqrt(pair.rho**2 - pair.grown**2) * tip / pair.length if by_side else tip
        across = touch - pair.centre
        _draw_radius(axes, pair, math.atan2(across[1], across[0]))
        axes.plot(*touch, "o", color=INK, ms=3.5, zorder=7)
    arc, letter = (0.45, 0.39) if by_side else (0.74, 0.79)
    for first, last in ((low, bearing), (bearing, high)):
        axes.add_patch(
            Arc((0, 0), 2 * arc, 2 * arc, theta1=math.degrees(first), theta2=math.degrees(last), color=INK, zorder=8)
        )
        x, y = letter * math.cos(0.5 * (first + last)), letter * math.sin(0.5 * (first + last))
        axes.text(x, y, r"$\delta$", fontsize=11, ha="center", va="center", zorder=8)
