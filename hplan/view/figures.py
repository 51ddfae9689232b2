"""Figures of the method in the plane: link and disc, arm, slices of the C-space, layer paths, restoration, motion.

Each public function takes data and returns a matplotlib `Figure`; `png_bytes` turns it into a PNG. Figures never
touch pyplot, so they neither need nor open a display. Matplotlib is an extra and is imported on first use; what is
drawn in three dimensions stands in `hplan.view.figures_3d`.

Angles come in radians, as everywhere in hplan, and are drawn in degrees.
"""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hplan import cspace
from hplan.arrays import BoolArray, FloatArray, IntArray
from hplan.errors import InputError
from hplan.grid import Grid, Occupancy
from hplan.robot import PlanarArm
from hplan.section import ArmSections

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_P = ParamSpec("_P")
_R = TypeVar("_R")

#: Resolution of the PNGs [dots per inch].
DPI = 160

# Okabe and Ito's colours, told apart by colour-blind eyes, and tints of them.
INK = "#22303C"
QUIET = "#7A8793"
FAINT = "#D9DFE4"
OBSTACLE = "#D55E00"
OBSTACLE_TINT = "#F0B183"
PATH = "#0072B2"
PATH_TINT = "#DCEBF5"
RESTORED = "#E69F00"
START = "#009E73"
GOAL = "#AA4488"
LINKS = ("#34495E", "#5D7F9E", "#9DBBD3")

#: One look for all figures.
STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "mathtext.fontset": "dejavusans",
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.0,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.titlesize": 9.5,
    "figure.facecolor": "white",
    "figure.titlesize": 12.5,
    "figure.titleweight": "bold",
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "savefig.facecolor": "white",
    "text.color": INK,
    "xtick.color": QUIET,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.color": QUIET,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8.5,
}


def require_matplotlib() -> None:
    """Make sure that matplotlib can be imported.

    Raises:
        InputError: It is not installed.
    """
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError("figures need the extra: pip install 'hplan[figures]'", extra="figures") from error


def styled(draw: Callable[_P, _R]) -> Callable[_P, _R]:
    """Run a function under hplan's style, or say that matplotlib is missing."""

    @functools.wraps(draw)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        require_matplotlib()
        from matplotlib import rc_context

        style: Any = STYLE
        with rc_context(style):
            return draw(*args, **kwargs)

    return wrapper


def new_figure(width: float, height: float, title: str, *, bottom: float = 0.0, placed: bool = False) -> Figure:
    """An empty figure with a title and a canvas of its own.

    Args:
        width: [inch].
        height: [inch].
        title: Title; may be empty.
        bottom: Share of the height kept free below.
        placed: The axes will be placed by hand; else they are laid out without overlaps.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(width, height))
    if not placed:
        figure.set_layout_engine(
            ConstrainedLayoutEngine(
                w_pad=0.09, h_pad=0.09, wspace=0.04, hspace=0.04, rect=(0.0, bottom, 1.0, 1.0 - bottom)
            )
        )
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.012, ha="left")
    return figure


@styled
def png_bytes(figure: Figure, dpi: int = DPI) -> bytes:
    """A figure as PNG; the same figure gives the same bytes."""
    from PIL import Image  # comes with matplotlib

    rendered, stream = io.BytesIO(), io.BytesIO()
    figure.savefig(rendered, format="png", dpi=dpi)
    with Image.open(rendered) as image:
        # 256 colours are enough for these drawings, and a third of the bytes.
        few = image.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
        few.save(stream, format="png", optimize=True, dpi=(dpi, dpi))
    return stream.getvalue()


# --------------------------------------------------------------------------------------------------------- pieces


def capsule_outline(start: ArrayLike, end: ArrayLike, radius: float) -> FloatArray:
    """Outline of a capsule in the plane, (m, 2) [m]."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    heading = math.atan2(b[1] - a[1], b[0] - a[0])
    angles = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 25)
    front = b + radius * np.stack([np.cos(heading + angles), np.sin(heading + angles)], axis=1)
    back = a - radius * np.stack([np.cos(heading + angles), np.sin(heading + angles)], axis=1)
    return np.concatenate([front, back])


def draw_arm(
    axes: Axes,
    arm: PlanarArm,
    q: ArrayLike,
    *,
    colors: Sequence[str] = LINKS,
    alpha: float = 1.0,
    zorder: float = 4.0,
    joints: bool = True,
) -> None:
    """Draw the arm's capsule links in its plane.

    Args:
        axes: Where to draw.
        arm: The planar chain.
        q: (n,) planar joint angles.
        colors: Colours of the links, repeated where there are more links.
        alpha: Opacity.
        zorder: Drawing order.
        joints: Mark the joints.
    """
    from matplotlib.patches import Circle, Polygon

    points = arm.joint_points(q)
    for k in range(arm.link_count):
        outline = capsule_outline(points[k], points[k + 1], float(arm.half_widths[k]))
        axes.add_patch(
            Polygon(outline, facecolor=colors[k % len(colors)], edgecolor="white", lw=0.6, alpha=alpha, zorder=zorder)
        )
    if joints:
        for k in range(arm.link_count):
            radius = 0.45 * float(arm.half_widths[k])
            axes.add_patch(
                Circle((float(points[k, 0]), float(points[k, 1])), radius, fc="white", lw=0, alpha=alpha, zorder=zorder)
            )


def draw_disc(axes: Axes, centre: ArrayLike, radius: float, grown: float | None = None) -> None:
    """Draw a disc obstacle and, dashed, the disc grown by a link's half-width [m]."""
    from matplotlib.patches import Circle

    x, y = (float(value) for value in np.asarray(centre))
    axes.add_patch(Circle((x, y), radius, facecolor=OBSTACLE, edgecolor="none", zorder=3))
    if grown is not None:
        axes.add_patch(Circle((x, y), grown, facecolor="none", edgecolor=OBSTACLE, lw=1.0, ls=(0, (3, 2)), zorder=3))


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
    """Half of the forbidden interval by equations (1)-(3): NaN where there is none, pi where all is forbidden.

    Args:
        rho: (...) distances of the disc's centre from the joint [m].
        length: Length of the link [m].
        radius: Radius of the grown disc [m].
    """
    distance = np.asarray(rho, dtype=np.float64)
    safe = np.maximum(distance, radius)
    tangent = np.arcsin(np.clip(radius / safe, -1.0, 1.0))
    tip = np.arccos(np.clip((length**2 + safe**2 - radius**2) / (2.0 * length * safe), -1.0, 1.0))
    result = np.where(safe**2 <= length**2 + radius**2, tangent, tip)
    result = np.where(distance > length + radius, np.nan, result)
    return np.where(distance <= radius, math.pi, result)


def clearance_field(arm: PlanarArm, sections: ArmSections, grid: Grid) -> FloatArray:
    """Distance from the arm's nearest link axis to its grown disc at every grid node, negative inside [m].

    Args:
        arm: The planar chain.
        sections: One disc for each link.
        grid: Grid over the planar joints, shape (N1, ..., Nn).

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


def _degree_axes(axes: Axes, grid: Grid, *, x_label: bool = True, y_label: bool = True) -> None:
    from matplotlib.ticker import MultipleLocator

    low, high = np.degrees(grid.lower), np.degrees(grid.coordinates(np.array(grid.shape) - 1))
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_visible(True)
    half = 0.5 * np.degrees(grid.step)
    axes.set_xlim(low[0] - half[0], high[0] + half[0])
    axes.set_ylim(low[1] - half[1], high[1] + half[1])
    axes.xaxis.set_major_locator(MultipleLocator(30.0))
    axes.yaxis.set_major_locator(MultipleLocator(30.0))
    axes.set_xlabel(r"$\theta_1$ [deg]" if x_label else "")
    axes.set_ylabel(r"$\theta_2$ [deg]" if y_label else "")
    axes.tick_params(labelbottom=x_label, labelleft=y_label)


def _paint(axes: Axes, grid: Grid, layers: Sequence[tuple[BoolArray, str]], background: str = "white") -> None:
    """Paint masks of a (theta1, theta2) slice, later ones over earlier ones."""
    from matplotlib.colors import to_rgb

    image = np.empty((*grid.shape[:2], 3))
    image[:] = to_rgb(background)
    for mask, color in layers:
        image[mask] = to_rgb(color)
    low = np.degrees(grid.lower - 0.5 * grid.step)
    high = np.degrees(grid.coordinates(np.array(grid.shape) - 1) + 0.5 * grid.step)
    axes.imshow(
        image.transpose(1, 0, 2),
        origin="lower",
        extent=(float(low[0]), float(high[0]), float(low[1]), float(high[1])),
        interpolation="nearest",
        zorder=1,
    )


def _ends(axes: Axes, grid: Grid, start: ArrayLike, goal: ArrayLike) -> None:
    """Mark the start's and the goal's place in a slice."""
    for node, color, marker in ((start, START, "o"), (goal, GOAL, "s")):
        place = np.degrees(grid.coordinates(node))
        axes.plot(
            place[0], place[1], marker, color=color, ms=7, mec="white", mew=1.0, zorder=8, clip_on=False, ls="none"
        )


def _line(axes: Axes, grid: Grid, path: IntArray, **look: Any) -> None:
    """Draw a path's (theta1, theta2) over a slice."""
    place = np.degrees(grid.coordinates(path))
    axes.plot(place[:, 0], place[:, 1], **look)


def _grouped(count: int) -> str:
    """A number with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")


def _earlier_links(arm: PlanarArm, sections: ArmSections, grid: Grid) -> BoolArray:
    """Mask over all axes but the last: where the links before the last one collide."""
    n = arm.link_count - 1
    shorter = replace(
        arm,
        joint_names=arm.joint_names[:n],
        link_names=arm.link_names[:n],
        **{key: getattr(arm, key)[:n] for key in ("lengths", "half_widths", "signs", "offsets", "lower", "upper")},
    )
    fewer = replace(sections, link_start=sections.link_start[: n + 1])
    return cspace.occupancy(shorter, fewer, Grid(grid.lower[:n], grid.step[:n], grid.shape[:n])).occupied


# -------------------------------------------------------------------------------------------------------- figures


@styled
def link_cases(length: float = 1.0, half_width: float = 0.06, radius: float = 0.2) -> Figure:
    """Figure 6: a link and a disc, the three cases of equations (1)-(3).

    Args:
        length: Length of the link [m].
        half_width: Half-width of the link [m].
        radius: Radius of the obstacle [m].
    """
    from matplotlib.patches import Arc, Polygon, Wedge

    grown = radius + half_width
    limit = math.hypot(length, grown)
    bearing = math.radians(38.0)
    cases = (
        (0.78 * limit, "Case 1: the side touches", r"$\rho^2 \leq L^2 + R^2$",
         r"$\delta = \arcsin\,\dfrac{R}{\rho}$"),
        (limit + 0.55 * (length + grown - limit), "Case 2: the tip touches", r"$\sqrt{L^2 + R^2} < \rho \leq L + R$",
         r"$\delta = \arccos\,\dfrac{L^2 + \rho^2 - R^2}{2 L \rho}$"),
        (1.1 * (length + grown), "Case 3: out of reach", r"$\rho > L + R$", "no angle is forbidden"),
    )  # fmt: skip
    figure = new_figure(11.0, 5.0, "A link and a disc: which joint angles are forbidden", bottom=0.09)
    for place, (rho, title, condition, result) in enumerate(cases):
        axes = figure.add_subplot(1, 3, place + 1)
        direction = np.array([math.cos(bearing), math.sin(bearing)])
        centre = rho * direction
        half = float(half_angles(rho, length, grown))
        axes.set_title(title, fontweight="bold")
        axes.plot([0.0, 1.32], [0.0, 0.0], color=FAINT, lw=1.0, zorder=0)
        axes.plot([0.0, centre[0]], [0.0, centre[1]], color=INK, lw=1.0, ls=(0, (5, 2, 1, 2)), zorder=6)
        axes.plot(*centre, "+", color="white", ms=8, mew=1.4, zorder=7)
        draw_disc(axes, centre, radius, grown)
        reach = np.linspace(math.radians(-4.0), math.radians(88.0), 60)
        axes.plot(length * np.cos(reach), length * np.sin(reach), color=QUIET, lw=0.8, ls=":", zorder=1)
        axes.text(length * math.cos(reach[0]) + 0.02, length * math.sin(reach[0]) - 0.01, "reach $L$", fontsize=8,
                  color=QUIET, ha="left", va="top")  # fmt: skip
        if math.isfinite(half):
            low, high = bearing - half, bearing + half
            axes.add_patch(
                Wedge((0, 0), length, math.degrees(low), math.degrees(high), fc=OBSTACLE_TINT, alpha=0.35, lw=0)
            )
            for angle, opacity in ((low, 1.0), (high, 0.55)):
                tip = length * np.array([math.cos(angle), math.sin(angle)])
                axes.add_patch(
                    Polygon(capsule_outline((0, 0), tip, half_width), fc=LINKS[1], ec="white", alpha=opacity, zorder=4)
                )
                axes.plot([0, tip[0]], [0, tip[1]], color="white", lw=0.8, zorder=5)
                touch = tip if place == 1 else math.sqrt(rho**2 - grown**2) * tip / length
                axes.plot([centre[0], touch[0]], [centre[1], touch[1]], color=INK, lw=1.1, zorder=6)
                axes.plot(*touch, "o", color=INK, ms=3.5, zorder=7)
            middle = 0.5 * (centre + touch)
            normal = np.array([-(touch - centre)[1], (touch - centre)[0]]) / grown
            x, y = middle - 0.055 * normal
            axes.text(x, y, "$R$", ha="center", va="center", fontsize=10, zorder=8)
            size = 0.98
            axes.add_patch(Arc((0, 0), size, size, theta1=math.degrees(bearing), theta2=math.degrees(high), color=INK))
            axes.add_patch(Arc((0, 0), size, size, theta1=math.degrees(low), theta2=math.degrees(bearing), color=INK))
            angle = 0.5 * (bearing + high)
            axes.text(0.41 * math.cos(angle), 0.41 * math.sin(angle), r"$\delta$", fontsize=10.5, ha="center",
                      va="center", zorder=8)  # fmt: skip
        else:
            angle = math.radians(14.0)
            tip = length * np.array([math.cos(angle), math.sin(angle)])
            axes.add_patch(Polygon(capsule_outline((0, 0), tip, half_width), fc=LINKS[1], ec="white", zorder=4))
            axes.plot([0, tip[0]], [0, tip[1]], color="white", lw=0.8, zorder=5)
            foot = centre + grown * np.array([math.cos(1.9), math.sin(1.9)])
            axes.plot([centre[0], foot[0]], [centre[1], foot[1]], color=INK, lw=1.1, zorder=6)
            axes.text(centre[0] - 0.11, centre[1] + 0.11, "$R$", ha="center", va="center", fontsize=10, zorder=8)
        along = (0.58, 0.68, 0.62)[place]
        x, y = along * direction + 0.05 * np.array([-direction[1], direction[0]])
        axes.text(x, y, r"$\rho$", fontsize=11, ha="center", va="center", zorder=8)
        axes.add_patch(Arc((0, 0), 0.42, 0.42, theta1=0, theta2=math.degrees(bearing), color=INK, lw=1.0, zorder=8))
        axes.text(0.24, -0.055, r"$\varphi$", fontsize=10, ha="center", va="center", zorder=8)
        axes.plot(0, 0, "o", color=INK, ms=6, mec="white", zorder=9)
        axes.set_aspect("equal")
        axes.set_xlim(-0.12, 1.4)
        axes.set_ylim(-0.13, 1.17)
        axes.axis("off")
        axes.text(0.5, -0.05, condition, transform=axes.transAxes, ha="center", va="top", fontsize=10.5)
        axes.text(0.5, -0.16, result, transform=axes.transAxes, ha="center", va="top", fontsize=11.5)
    figure.text(
        0.5, 0.012,
        r"Forbidden: $|\theta - \varphi| \leq \delta$, every angle where $\rho \leq R$.   $R = r + w$: obstacle "
        r"(solid) grown by the link's half-width (dashed).   Bearing $\varphi = \mathrm{arctan2}(y, x)$.",
        ha="center", va="bottom", fontsize=8.5, color=QUIET,
    )  # fmt: skip
    return figure


@styled
def arm_and_obstacle(arm: PlanarArm, centre: ArrayLike, radius: float, start: ArrayLike, goal: ArrayLike) -> Figure:
    """Figure 7: the arm in its plane at start and goal, and the obstacle.

    Args:
        arm: The planar chain.
        centre: (2,) centre of the disc [m].
        radius: Its radius [m].
        start: (n,) planar joint angles.
        goal: (n,) planar joint angles.
    """
    from matplotlib.patches import Arc

    figure = new_figure(7.2, 5.2, "The arm in its plane: start, goal and obstacle")
    axes = figure.add_subplot()
    x, y = (float(value) for value in np.asarray(centre))
    draw_disc(axes, (x, y), radius)
    axes.plot(x, y, "+", color="white", ms=8, mew=1.3, zorder=5)
    axes.annotate(
        f"obstacle ({x:g}, {y:g}) m\nradius {radius:g} m", (x + radius * 0.8, y + radius * 0.6),
        (x + 0.35, y + 0.12), va="center", arrowprops={"arrowstyle": "-", "color": QUIET, "lw": 0.8},
    )  # fmt: skip
    for q, color, name in ((start, START, "start"), (goal, GOAL, "goal")):
        points = arm.joint_points(q)
        draw_arm(axes, arm, q)
        axes.plot(points[-1, 0], points[-1, 1], "o", color=color, ms=9, mec="white", mew=1.2, zorder=9)
        degrees = ", ".join(f"{value:g}" for value in np.degrees(np.asarray(q)))
        up = name == "start"
        axes.text(points[-1, 0], points[-1, 1] + (0.09 if up else -0.09), f"{name}\n$\\theta$ = ({degrees})°",
                  color=color, ha="center", va="bottom" if up else "top", fontweight="bold", zorder=9)  # fmt: skip
    points = arm.joint_points(start)
    for k in range(arm.link_count):
        middle = 0.5 * (points[k] + points[k + 1])
        axes.text(middle[0], middle[1] - float(arm.half_widths[k]) - 0.04,
                  f"$L_{k + 1}$ = {arm.lengths[k]:g} m\n$w_{k + 1}$ = {100 * arm.half_widths[k]:g} cm",
                  ha="center", va="top", fontsize=8, color=QUIET, linespacing=1.35)  # fmt: skip
    points = arm.joint_points(goal)
    heading = 0.0
    for k in range(arm.link_count):
        turn = float(arm.signs[k] * np.asarray(goal)[k] + arm.offsets[k])
        size = (0.72, 0.56, 0.42)[min(k, 2)]
        px, py = points[k]
        reach = 0.62 * size
        axes.plot([px, px + reach * math.cos(heading)], [py, py + reach * math.sin(heading)], color=QUIET, lw=0.8,
                  ls=(0, (3, 2)), zorder=6)  # fmt: skip
        axes.add_patch(
            Arc((px, py), size, size, theta1=math.degrees(heading), theta2=math.degrees(heading + turn), color=INK,
                lw=1.1, zorder=7)
        )  # fmt: skip
        at = heading + 0.5 * turn
        away = 0.5 * size + 0.09
        axes.text(px + away * math.cos(at), py + away * math.sin(at), f"$\\theta_{k + 1}$", ha="center", va="center",
                  fontsize=10, zorder=8)  # fmt: skip
        heading += turn
    axes.set_aspect("equal")
    total = float(arm.lengths.sum())
    axes.set_xlim(-0.3, total + 0.3)
    axes.set_ylim(-0.32, y + radius + 0.4)
    axes.set_xlabel("arm plane, horizontal [m]")
    axes.set_ylabel("arm plane, up from the shoulder [m]")
    return figure


@styled
def two_link_cspace(arm: PlanarArm, sections: ArmSections, grid: Grid) -> Figure:
    """Figure 8: the case that applies to each link over theta1, and the C-space of (theta1, theta2).

    Args:
        arm: The planar chain, at least two links.
        sections: One disc for each link (capsule model).
        grid: Grid over the planar joints.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    figure = new_figure(10.6, 4.9, "C-space, link by link")
    left, right = figure.subplots(1, 2, width_ratios=(1.12, 1.0))
    theta = np.linspace(float(grid.lower[0]), float(grid.coordinates(np.array(grid.shape) - 1)[0]), 7201)
    heading = arm.signs[0] * theta + arm.offsets[0]
    elbow = arm.lengths[0] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    first, first_radius = disc_of(sections, 0)
    second, radius = disc_of(sections, 1)
    length = float(arm.lengths[1])
    offset = second - elbow
    rho = np.hypot(offset[:, 0], offset[:, 1])
    bearing = (np.arctan2(offset[:, 1], offset[:, 0]) - heading + math.pi) % (2 * math.pi) - math.pi
    bearing = arm.signs[1] * (bearing - arm.offsets[1])
    half = half_angles(rho, length, radius)
    degrees = np.degrees(theta)
    bounds = (radius, math.hypot(length, radius), length + radius)
    top = 1.22 * max(float(np.hypot(*first)), float(rho.max()))
    left.axhspan(bounds[0], bounds[1], color=OBSTACLE_TINT, alpha=0.55, lw=0)
    left.axhspan(bounds[1], bounds[2], color=RESTORED, alpha=0.35, lw=0)
    left.axhspan(0.0, bounds[0], color=OBSTACLE, alpha=0.75, lw=0)
    left.plot(degrees, rho, color=PATH, lw=2.2)
    left.axhline(float(np.hypot(*first)), color=INK, lw=1.6)
    left.axhline(float(arm.lengths[0]) + first_radius, color=INK, lw=1.0, ls=(0, (3, 2)))
    middle = 0.5 * float(degrees[0] + degrees[-1])
    for height, text, color, va in (
        (float(np.hypot(*first)) + 0.02, r"link 1: $\rho$ from the shoulder, constant", INK, "bottom"),
        (float(arm.lengths[0]) + first_radius + 0.02, "reach $L_1 + R_1$ of link 1: no forbidden angle", INK, "bottom"),
        (bounds[2] + 0.025, "case 3: out of link 2's reach", QUIET, "bottom"),
        (0.5 * (bounds[1] + bounds[2]), "case 2: the tip of link 2 touches", INK, "center"),
        (0.5 * (bounds[0] + bounds[1]) - 0.12, "case 1: the side of link 2 touches", INK, "center"),
        (0.5 * bounds[0], r"$\rho \leq R_2$: every $\theta_2$ is forbidden", INK, "center"),
    ):
        left.text(middle + 6.0, height, text, color=color, va=va, ha="center", fontsize=8)
    lowest = int(np.argmin(rho))
    left.text(float(degrees[lowest]), float(rho[lowest]) - 0.02, r"link 2: $\rho$ from the elbow", color=PATH, va="top",
              ha="center", fontsize=8)  # fmt: skip
    left.set_xlim(degrees[0], degrees[-1])
    left.set_ylim(0.0, top)
    left.set_xticks(np.arange(degrees[0], degrees[-1] + 1e-6, 15.0))
    left.set_xlabel(r"$\theta_1$ [deg]")
    left.set_ylabel(r"distance $\rho$ from joint to disc [m]")
    left.set_title("Which case applies")

    _paint(right, grid, [(_pair_mask(arm, sections, grid), OBSTACLE_TINT)])
    case_two = rho > bounds[1]
    for mask, color in ((~case_two, OBSTACLE), (case_two, RESTORED)):
        for side in (-1.0, 1.0):
            edge = np.where(mask, np.degrees(bearing + side * half), np.nan)
            right.plot(degrees, edge, color=color, lw=2.0, zorder=4)
    right.plot(degrees, np.where(np.isfinite(half), np.degrees(bearing), np.nan), color=INK, lw=0.9,
               ls=(0, (5, 2, 1, 2)), zorder=4)  # fmt: skip
    _degree_axes(right, grid)
    right.set_title("Forbidden intervals of link 2 and the nodes inside")
    right.legend(
        handles=[
            Patch(fc=OBSTACLE_TINT, label="occupied nodes"),
            Line2D([], [], color=OBSTACLE, lw=2, label="equation (1)"),
            Line2D([], [], color=RESTORED, lw=2, label="equation (2)"),
            Line2D([], [], color=INK, lw=0.9, ls=(0, (5, 2, 1, 2)), label=r"bearing $\varphi$"),
        ],
        loc="upper right", frameon=True, framealpha=0.92, edgecolor="none",
    )  # fmt: skip
    return figure


def _pair_mask(arm: PlanarArm, sections: ArmSections, grid: Grid) -> BoolArray:
    """(N1, N2) mask of the nodes at which link 1 or 2 collides."""
    if arm.link_count == 2:
        return cspace.occupancy(arm, sections, grid).occupied
    if arm.link_count == 3:
        return _earlier_links(arm, sections, grid)
    raise InputError("this figure wants a planar arm of two or three links", links=arm.link_count)


@styled
def slices(
    arm: PlanarArm,
    sections: ArmSections,
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    numbers: Sequence[int],
) -> Figure:
    """Figure 9: occupancy of theta3 slices, and what the start reaches in each.

    Args:
        arm: The planar chain, three links.
        sections: The obstacles' sections.
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        numbers: Slices to show, at most six.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    earlier = _earlier_links(arm, sections, grid)
    figure = new_figure(9.6, 6.9, r"Slices of the C-space at constant $\theta_3$")
    panels = figure.subplots(2, 3)
    start, goal = np.asarray(start), np.asarray(goal)
    for place, (axes, number) in enumerate(zip(panels.flat, numbers, strict=False)):
        occupied = occupancy.occupied[:, :, number]
        reached = reached_mask(~occupied, (int(start[0]), int(start[1])))
        feasible = bool(reached[goal[0], goal[1]])
        _paint(
            axes,
            grid,
            [(reached, PATH_TINT), (occupied, OBSTACLE_TINT), (occupied & earlier, OBSTACLE)],
        )
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, x_label=place >= 3, y_label=place % 3 == 0)
        value = np.degrees(grid.axis(2)[number])
        axes.set_title(f"$\\theta_3$ = {value:g}°:  " + ("goal is reached" if feasible else "no path"),
                       color=PATH if feasible else OBSTACLE, fontweight="bold")  # fmt: skip
    figure.legend(
        handles=[
            Patch(fc=OBSTACLE, label="links 1, 2 collide"),
            Patch(fc=OBSTACLE_TINT, label="link 3 collides"),
            Patch(fc=PATH_TINT, label="free, reached from the start"),
            Patch(fc="white", ec=QUIET, lw=0.6, label="free, not reached"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="outside lower center", ncols=6, columnspacing=1.4, handlelength=1.4,
    )  # fmt: skip
    return figure


@styled
def layer_paths(
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    paths: Mapping[int, IntArray],
    expansions: Mapping[int, int],
    numbers: Sequence[int],
) -> Figure:
    """Figure 10: the search of each slice on its own, and what it costs.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        paths: Slice -> (m, 3) path, for the slices that have one.
        expansions: Slice -> nodes expanded by a plain A* there, for every slice searched.
        numbers: Slices to show, at most four.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(10.4, 6.2, "First level: a 2-D A* in every slice")
    panels = figure.add_gridspec(2, 4, height_ratios=(1.25, 1.0))
    start, goal = np.asarray(start), np.asarray(goal)
    for place, number in enumerate(numbers[:4]):
        axes = figure.add_subplot(panels[0, place])
        _paint(axes, grid, [(occupancy.occupied[:, :, number], OBSTACLE_TINT)])
        value = np.degrees(grid.axis(2)[number])
        if number in paths:
            _line(axes, grid, paths[number], color=PATH, lw=2.2, zorder=5)
            length = np.degrees(np.linalg.norm(np.diff(grid.coordinates(paths[number]), axis=0), axis=1).sum())
            verdict = f"{length:.1f}° long"
        else:
            verdict = "no path"
        axes.set_title(f"$\\theta_3$ = {value:g}°:  {verdict}", color=PATH if number in paths else OBSTACLE,
                       fontweight="bold")  # fmt: skip
        axes.text(0.97, 0.97, f"{_grouped(expansions[number])} expansions", transform=axes.transAxes, ha="right",
                  va="top", fontsize=8, zorder=7)  # fmt: skip
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, y_label=place == 0)
    bars = figure.add_subplot(panels[1, :])
    order = np.array(sorted(expansions))
    values = np.array([expansions[int(k)] for k in order])
    found = np.array([int(k) in paths for k in order])
    degrees = np.degrees(grid.axis(2)[order])
    width = float(np.degrees(grid.step[2]))
    bars.bar(degrees[~found], values[~found], width * 0.82, color=OBSTACLE)
    bars.bar(degrees[found], values[found], width * 0.82, color=PATH)
    bars.set_xlim(degrees[0] - width, degrees[-1] + width)
    bars.set_xlabel(r"slice $\theta_3$ [deg]")
    bars.set_ylabel("nodes expanded")
    bars.yaxis.set_major_formatter(lambda value, _: _grouped(int(value)))
    bars.set_ylim(0.0, 1.3 * values.max())
    bars.legend(
        handles=[
            Patch(fc=OBSTACLE, label=f"{int((~found).sum())} slices without a path: "
                  f"{_grouped(int(values[~found].sum()))} expansions"),
            Patch(fc=PATH, label=f"{int(found.sum())} slices with a path: "
                  f"{_grouped(int(values[found].sum()))} expansions"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="upper center", ncols=4, columnspacing=1.6,
    )  # fmt: skip
    return figure


@styled
def restoration(
    occupancy: Occupancy,
    start: ArrayLike,
    goal: ArrayLike,
    first_path: IntArray,
    heads: Mapping[int, IntArray],
    numbers: Sequence[int],
) -> Figure:
    """Figure 11: the first slice path carried back towards the start, cut before each contact.

    Args:
        occupancy: The (N1, N2, N3) C-space.
        start: (3,) node index.
        goal: (3,) node index.
        first_path: (m, 3) path of the first slice that has one.
        heads: Slice -> (k, 3) part of that path kept there.
        numbers: Slices to show, at most four, out of `heads`.
    """
    from matplotlib.colors import to_rgb
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid = occupancy.grid
    figure = new_figure(10.4, 6.2, "Connectivity restoration: carry the first path back, cut it before contact")
    panels = figure.add_gridspec(2, 4, height_ratios=(1.25, 1.0))
    whole = len(first_path)
    for place, number in enumerate(numbers[:4]):
        axes = figure.add_subplot(panels[0, place])
        head = heads[number]
        _paint(axes, grid, [(occupancy.occupied[:, :, number], OBSTACLE_TINT)])
        _line(axes, grid, first_path, color=QUIET, lw=1.1, ls=(0, (2, 1.5)), zorder=4)
        _line(axes, grid, head, color=RESTORED, lw=3.0, zorder=5)
        if len(head) < whole:
            cut = np.degrees(grid.coordinates(first_path[len(head)]))
            axes.plot(cut[0], cut[1], "x", color=INK, ms=7.5, mew=2.0, zorder=7)
        _ends(axes, grid, start, goal)
        _degree_axes(axes, grid, y_label=place == 0)
        value = np.degrees(grid.axis(2)[number])
        axes.set_title(f"$\\theta_3$ = {value:g}°:  {len(head)} of {whole} points", fontweight="bold")
    unrolled = figure.add_subplot(panels[1, :])
    source = int(first_path[0, 2])
    order = [*sorted(heads), source]
    image = np.empty((whole, len(order), 3))
    for column, number in enumerate(order):
        blocked = occupancy.occupied[first_path[:, 0], first_path[:, 1], number]
        kept = whole if number == source else len(heads[number])
        image[:, column] = to_rgb(FAINT)
        image[:kept, column] = to_rgb(PATH if number == source else RESTORED)
        image[blocked, column] = to_rgb(OBSTACLE_TINT)
    degrees = np.degrees(grid.axis(2)[order])
    width = float(np.degrees(grid.step[2]))
    unrolled.imshow(
        image, origin="lower", aspect="auto", interpolation="nearest",
        extent=(float(degrees[0]) - 0.5 * width, float(degrees[-1]) + 0.5 * width, -0.5, whole - 0.5),
    )  # fmt: skip
    unrolled.annotate(
        "restored in this direction", xy=(degrees[0] + 0.30 * (degrees[-1] - degrees[0]), 0.3 * whole),
        xytext=(degrees[-1] - 3.0 * width, 0.3 * whole), va="center", ha="right", color=INK,
        arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.2},
    )  # fmt: skip
    unrolled.set_xlabel(r"slice $\theta_3$ [deg]")
    unrolled.set_ylabel("point along the path")
    figure.legend(
        handles=[
            Patch(fc=PATH, label=f"path at $\\theta_3$ = {np.degrees(grid.axis(2)[source]):g}°"),
            Patch(fc=RESTORED, label="kept"),
            Patch(fc=FAINT, label="cut off"),
            Patch(fc=OBSTACLE_TINT, label="forbidden"),
            Line2D([], [], marker="x", color=INK, ls="none", ms=7, mew=2, label="first contact"),
            Line2D([], [], marker="o", color=START, ls="none", ms=7, label="start"),
            Line2D([], [], marker="s", color=GOAL, ls="none", ms=7, label="goal"),
        ],
        loc="outside lower center", ncols=7, columnspacing=1.4,
    )  # fmt: skip
    return figure


def draw_motion(
    axes: Axes,
    arm: PlanarArm,
    centre: ArrayLike,
    radius: float,
    path: FloatArray,
    *,
    poses: int = 9,
    color: str = PATH,
) -> None:
    """Draw a motion stroboscopically: poses from light to dark, the tool's way, start and goal.

    Args:
        axes: Where to draw.
        arm: The planar chain.
        centre: (2,) centre of the disc obstacle [m].
        radius: Its radius [m].
        path: (m, n) joint angles.
        poses: Poses to show, start and goal among them.
        color: Colour of the tool's way.
    """
    from matplotlib.colors import to_hex, to_rgb

    shown = np.unique(np.rint(np.linspace(0, len(path) - 1, poses)).astype(int))
    for place, index in enumerate(shown):
        share = place / max(1, len(shown) - 1)
        ends = place in (0, len(shown) - 1)
        tint = 1.0 if ends else 0.30 + 0.32 * share
        pale = [[1.0 - tint * (1.0 - channel) for channel in to_rgb(link)] for link in LINKS]
        colors = [to_hex((red, green, blue)) for red, green, blue in pale]
        draw_arm(axes, arm, path[index], colors=colors, zorder=2.0 + share, joints=ends)
    draw_arm(axes, arm, path[0], zorder=3.2)
    tool = arm.joint_points(path)[:, -1]
    axes.plot(tool[:, 0], tool[:, 1], color="white", lw=4.0, zorder=5)
    axes.plot(tool[:, 0], tool[:, 1], color=color, lw=2.2, zorder=6)
    draw_disc(axes, centre, radius)
    for point, end, name in ((tool[0], START, "start"), (tool[-1], GOAL, "goal")):
        axes.plot(*point, "o" if name == "start" else "s", color=end, ms=8, mec="white", mew=1.1, zorder=9)
    axes.set_aspect("equal")
    low = np.minimum(arm.joint_points(path).reshape(-1, 2).min(axis=0), np.asarray(centre) - radius)
    high = np.maximum(arm.joint_points(path).reshape(-1, 2).max(axis=0), np.asarray(centre) + radius)
    axes.set_xlim(low[0] - 0.12, high[0] + 0.12)
    axes.set_ylim(low[1] - 0.12, high[1] + 0.12)
    axes.set_xlabel("arm plane, horizontal [m]")
    axes.set_ylabel("arm plane, up from the shoulder [m]")


@styled
def motions(
    arm: PlanarArm,
    centre: ArrayLike,
    radius: float,
    paths: Mapping[str, FloatArray],
) -> Figure:
    """Figure 15: the arm's motion, one column for each method, and the joint angles along the path.

    Args:
        arm: The planar chain.
        centre: (2,) centre of the disc obstacle [m].
        radius: Its radius [m].
        paths: Name -> (m, n) joint angles; one or two methods.
    """
    figure = new_figure(10.4, 6.7, "The motion in the workspace")
    panels = figure.subplots(2, len(paths), height_ratios=(2.35, 1.0), squeeze=False)
    longest = max(float(_travelled(path)[-1]) for path in paths.values())
    for column, (name, path) in enumerate(paths.items()):
        axes = panels[0, column]
        draw_motion(axes, arm, centre, radius, path)
        along = np.degrees(_travelled(path))
        axes.set_title(f"{name}: {along[-1]:.2f}°, {len(path)} points", fontweight="bold")
        below = panels[1, column]
        for k in range(arm.link_count):
            below.plot(along, np.degrees(path[:, k]), color=(INK, PATH, OBSTACLE)[k % 3], lw=1.8,
                       ls=("-", (0, (5, 1.5)), (0, (1.5, 1)))[k % 3], label=f"$\\theta_{k + 1}$")  # fmt: skip
        below.set_xlim(0.0, math.degrees(longest))
        below.set_ylim(-3.0, 93.0)
        below.set_yticks([0, 30, 60, 90])
        below.set_xlabel("length along the path [deg]")
        below.set_ylabel("joint angle [deg]")
        below.legend(loc="upper left", ncols=3)
        if column > 0:
            axes.set_ylabel("")
            below.set_ylabel("")
    return figure


def _travelled(path: FloatArray) -> FloatArray:
    """(m,) length along a joint path [rad]."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])
