"""The paper's figures under its own numbers, drawn from the evidence; the layout is our own.

`field` is the clearance at the nodes of the joint grid, negative inside the obstacle [m]; `path` (m, 3) node indices;
`paths` and `heads` the path of each slice and the part of the first one that restoration keeps there.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from studies.paper.measure import DEMO_CENTRE, DEMO_DIAMETER, PAPER_DENSE, PAPER_TWO_LEVEL, Evidence, Reproduction
from studies.paper.plain import path_found

from hplan.apps.view import figures as look
from hplan.apps.view.figures import apply_style, new_figure
from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.pages.cspace_surface import draw_cspace_obstacle, hidden_by_surface, joint_box, panes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: theta3 of the slices in Figures 10 and 11 [deg]; layers in Figure 7, in the paper's unit.
SLICES_DEG, LAYERS = (0.0, 22.0, 44.0, 45.0, 66.0, 70.0), (5.0, 6.0, 12.0, 18.0, 24.0, 25.0)

#: Elevation and azimuth of the viewer [deg]: the gap between obstacle and limits in front; the goal's side.
VIEW, OTHER_VIEW = (27.0, 128.0), (27.0, -38.0)

#: Length of the example's first link, half its width and its obstacle's radius [m], for Figures 2 to 4; for each of the
#: three cases its description, condition, half-angle, and the drawn distance [m].
LINK, BEARING = (1.0, 0.05, 0.15), math.radians(40.0)
CASES = {
    1: ("the side of the link touches", r"$R < \rho \leq \sqrt{L^2 + R^2}$", r"$\delta = \arcsin(R / \rho)$", 0.8),
    2: ("the tip of the link touches", r"$\sqrt{L^2 + R^2} < \rho \leq L + R$",
        r"$\delta = \arccos\,\frac{L^2 + \rho^2 - R^2}{2 L \rho}$", 1.12),
    3: ("the circle is out of reach", r"$\rho > L + R$", "no angle is forbidden", 1.32),
}  # fmt: skip

#: Names of the first two joint axes, and degrees of a radian.
_THETA, _DEG = (r"$\theta_1$ [deg]", r"$\theta_2$ [deg]"), 180.0 / math.pi


def figures(numbers: Reproduction, evidence: Evidence) -> dict[str, Callable[[], Figure]]:
    """File name -> drawing function, in the paper's order; the overview, which the paper does not have, comes last."""
    drawings: dict[str, Callable[[], Figure]] = {
        f"link-and-circle-case-{n}": functools.partial(link_case, n) for n in CASES
    }
    of_evidence: dict[str, Callable[[Evidence], Figure]] = {
        "two-links": two_links, "workspace-path": workspace_path, "workspace-layers": workspace_layers,
        "arm-and-obstacle": arm_and_obstacle, "cspace": cspace_obstacle, "slices": slices, "slice-paths": slice_paths,
        "sparse-path": sparse_path, "execution": snapshots, "paths-in-cspace": paths_in_cspace,
        "paths-in-workspace": paths_in_workspace, "comparison": functools.partial(comparison, numbers),
    }  # fmt: skip
    drawings |= {name: functools.partial(draw, evidence) for name, draw in of_evidence.items()}
    named = {
        f"figure-{number:02d}-{name}.png": functools.partial(_numbered, number, draw)
        for number, (name, draw) in enumerate(drawings.items(), start=2)
    }
    return {**named, "overview.png": lambda: overview(evidence)}


@apply_style
def _numbered(number: int, draw: Callable[[], Figure]) -> Figure:
    """Draw a figure and set the paper's number before its title."""
    figure = draw()
    figure.suptitle(f"Fig. {number}.  {figure.get_suptitle()}", x=0.012, ha="left")
    return figure


# Numbers that are drawn


def half_angles(rho: ArrayLike, length: float, radius: float) -> FloatArray:
    """Half of the forbidden interval by equations (1)-(3); NaN if no angle is forbidden, pi if all are."""
    distance = np.asarray(rho, dtype=np.float64)
    safe = np.maximum(distance, radius)
    side = np.arcsin(np.clip(radius / safe, -1.0, 1.0))
    tip = np.arccos(np.clip((length**2 + safe**2 - radius**2) / (2.0 * length * safe), -1.0, 1.0))
    result = np.where(safe**2 <= length**2 + radius**2, side, tip)
    return np.where(distance <= radius, math.pi, np.where(distance > length + radius, np.nan, result))


def _clearance(evidence: Evidence, nodes: FloatArray, links: int) -> FloatArray:
    """(n,) distance of the first capsule links from the disc at (n, 3) configurations, negative inside [m]."""
    arm = family_of(evidence.robot).arm
    points, clearance = arm.joint_points(nodes), np.full(len(nodes), np.inf)
    for k in range(links):
        begin, along = points[:, k], points[:, k + 1] - points[:, k]
        part = np.clip(((evidence.centre - begin) * along).sum(axis=1) / arm.lengths[k] ** 2, 0.0, 1.0)
        distance = np.linalg.norm(evidence.centre - begin - part[:, None] * along, axis=1)
        clearance = np.minimum(clearance, distance - arm.half_widths[k] - evidence.radius)
    return clearance


@functools.cache
def _field(evidence: Evidence) -> FloatArray:
    """(N1, N2, N3) distance of the links from the disc at the nodes of the joint grid, negative inside [m]."""
    grid = evidence.occupancy.grid
    return _clearance(evidence, _mesh(grid).reshape(-1, 3), family_of(evidence.robot).arm.link_count).reshape(
        grid.shape
    )


def _mesh(grid: Grid) -> FloatArray:
    """(N1, N2, N3, 3) coordinates of all nodes."""
    return np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)


def _link_occupied(evidence: Evidence, links: int) -> BoolArray:
    """(N1, N2) mask of nodes with the first links in collision."""
    grid = evidence.occupancy.grid
    mesh = np.stack(np.meshgrid(grid.axis(0), grid.axis(1), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    occupied: BoolArray = _clearance(evidence, mesh, links) <= 0.0
    return occupied.reshape(grid.shape[:2])


def _degrees(evidence: Evidence, path: IntArray) -> FloatArray:
    """(m, 3) joint angles of a path [deg]."""
    return np.degrees(evidence.occupancy.grid.coordinates(path))


def _terminals(evidence: Evidence) -> IntArray:
    """(2, 3) nodes of start and goal."""
    return np.stack([evidence.start, evidence.goal])


def _length(grid: Grid, path: IntArray) -> str:
    """Length and number of points of a path over joint angles."""
    turned = np.linalg.norm(np.diff(grid.coordinates(path), axis=0), axis=1).sum()
    return f"{math.degrees(turned):.2f}°, {len(path)} points"


def _nearest(grid: Grid, values: Sequence[float]) -> list[int]:
    """Slices nearest to values along the grid's last axis."""
    return [int(number) for number in np.rint((np.array(values) - grid.lower[-1]) / grid.step[-1])]


# Parts of several figures


def _line(label: str, color: str, width: float = 2.4, **more: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, lw=width, label=label, **more)


def _patch(label: str, color: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(fc=color, ec=look.QUIET, lw=0.4, label=label)


def _legend(figure: Figure, *handles: Any) -> None:
    """Legend below the panels: the given handles, then start and goal."""
    ends = [_line("start", look.START, 0.0, marker="o", ms=7), _line("goal", look.GOAL, 0.0, marker="s", ms=7)]
    figure.legend(handles=[*handles, *ends], loc="outside lower center", ncols=6, columnspacing=1.3, handlelength=1.5)


def _ends(axes: Any, points: FloatArray) -> None:
    """Mark the first and the last of (m, 2) or (m, 3) points."""
    for point, color, marker in ((points[0], look.START, "o"), (points[-1], look.GOAL, "s")):
        axes.plot(*point[:, None], marker, color=color, ms=8, mec="white", mew=1.1, zorder=9, clip_on=False)


def _disc(axes: Any, centre: ArrayLike, radius: float, grown: float | None = None) -> None:
    """A disc and, dashed, the disc grown by a link's half-width [m]."""
    from matplotlib.patches import Circle

    x, y = (float(value) for value in np.asarray(centre))
    axes.add_patch(Circle((x, y), radius, fc=look.OBSTACLE, zorder=3))
    if grown is not None:
        axes.add_patch(Circle((x, y), grown, fc="none", ec=look.OBSTACLE, lw=1.0, ls=(0, (3, 2)), zorder=3))


def _links(axes: Any, points: FloatArray, widths: Sequence[float], colors: Sequence[str], alpha: float = 1.0) -> None:
    """Capsules between successive (m, 2) points, with half-widths [m]."""
    from matplotlib.patches import Polygon

    for a, b, width, color in zip(points[:-1], points[1:], widths, colors, strict=False):
        angle = math.atan2(*(b - a)[::-1]) + np.linspace(-0.5 * math.pi, 0.5 * math.pi, 25)
        cap = width * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        axes.add_patch(Polygon(np.concatenate([b + cap, a - cap]), fc=color, ec="white", lw=0.6, alpha=alpha, zorder=4))


def _arm(axes: Any, evidence: Evidence, q: FloatArray, alpha: float = 1.0) -> FloatArray:
    """The arm in its plane; returns the position of the tool."""
    arm = family_of(evidence.robot).arm
    points = arm.joint_points(q)
    _links(axes, points, arm.half_widths.tolist(), look.LINKS, alpha)
    tool: FloatArray = points[-1]
    return tool


def _plane(axes: Any, points: FloatArray, margin: float = 0.12) -> None:
    """Limits and labels of the arm plane around (..., 2) points [m]."""
    low, high = points.reshape(-1, 2).min(axis=0) - margin, points.reshape(-1, 2).max(axis=0) + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1] + margin), aspect="equal")
    axes.set(xlabel="arm plane, horizontal [m]", ylabel="arm plane, up [m]")


def _slice(
    axes: Any, grid: Grid, masks: Sequence[tuple[BoolArray, str]], unit: float = _DEG, names: Any = _THETA
) -> None:
    """Masks over the first two axes of a grid, later ones over earlier ones, in a unit."""
    from matplotlib.colors import to_rgb

    image = np.ones((*grid.shape[:2], 3))
    for mask, color in masks:
        image[mask] = to_rgb(color)
    low = unit * (grid.lower - 0.5 * grid.step)
    high = unit * (grid.coordinates(np.array(grid.shape) - 1) + 0.5 * grid.step)
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    axes.imshow(image.transpose(1, 0, 2), origin="lower", extent=extent, interpolation="nearest", zorder=1)
    axes.set(xlabel=names[0], ylabel=names[1])
    axes.label_outer()


def _axes_3d(figure: Figure, view: tuple[float, float], place: Any = 111) -> Any:
    axes: Any = figure.add_subplot(place, projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(elev=view[0], azim=view[1])
    return axes


def _joint_space(figure: Figure, evidence: Evidence, view: Any = VIEW, place: Any = 111) -> tuple[Any, Any]:
    """3-D axes with the C-space obstacle; returns them and the unit vector to the viewer, in units of nodes."""
    axes = _axes_3d(figure, view, place)
    towards = draw_cspace_obstacle(axes, evidence.occupancy.grid, _field(evidence))
    joint_box(axes, evidence.occupancy.grid, 1.0)
    return axes, towards


def _line_3d(axes: Any, points: FloatArray, covered: BoolArray, color: Any, width: float, zorder: float) -> None:
    """A 3-D line, dotted and faint where covered."""
    changes = np.flatnonzero(covered[1:] != covered[:-1]) + 1
    for first, last in zip([0, *changes], [*changes, len(points) - 1], strict=True):
        style: Any = {"lw": width}
        if covered[first]:
            style = {"lw": 0.6 * width, "alpha": 0.55, "ls": (0, (1, 1.4))}
        axes.plot(*points[first : last + 1].T, color=color, zorder=zorder, **style)


def _joint_path(axes: Any, evidence: Evidence, path: IntArray, towards: Any, color: str, width: float,
                zorder: float = 5.0) -> None:  # fmt: skip
    """A path past the C-space obstacle."""
    covered = hidden_by_surface(_field(evidence), path.astype(np.float64), towards)
    _line_3d(axes, _degrees(evidence, path), covered, color, width, zorder + width)


# The figures


def link_case(case: int) -> Figure:
    """Figures 2 to 4: one link and a circle in one of the three cases of equations (1)-(3)."""
    from matplotlib.patches import Wedge

    title, condition, result, rho = CASES[case]
    length, half_width, radius = LINK
    grown, centre = radius + half_width, rho * np.array([math.cos(BEARING), math.sin(BEARING)])
    half = float(half_angles(rho, length, grown))
    figure = new_figure(9.6, 5.0, f"One link and a circle, case {case}: {title}")
    axes, text = figure.subplots(1, 2, width_ratios=(1.75, 1.0))
    _disc(axes, centre, radius, grown)
    axes.plot(*np.stack([np.zeros(2), centre], axis=1), color=look.INK, lw=1.0, ls=(0, (5, 2, 1, 2)), zorder=6)
    sizes = f"$L$ = {length:g} m,  $w$ = {half_width:g} m,  $r$ = {radius:g} m"
    circle = f"$R = r + w$ = {grown:g} m,  $\\rho$ = {rho:g} m", f"$\\varphi$ = {math.degrees(BEARING):g}°"
    lines, angles = [condition, result, "", sizes, *circle], [math.radians(14.0)]
    if math.isfinite(half):
        angles = [BEARING - half, BEARING + half]
        low, high = np.degrees(angles)
        axes.add_patch(Wedge((0.0, 0.0), length, low, high, fc=look.OBSTACLE_TINT, alpha=0.35, lw=0))
        lines += [f"$\\delta$ = {math.degrees(half):.1f}°", f"forbidden: {low:.1f}° $\\leq \\theta \\leq$ {high:.1f}°"]
    for angle in angles:
        link = length * np.array([[0.0, 0.0], [math.cos(angle), math.sin(angle)]])
        _links(axes, link, [half_width], look.LINKS[1:], 0.8)
        axes.plot(*link.T, color="white", lw=0.8, zorder=5)
    _plane(axes, np.array([[0.0, 0.0], [1.2, 1.0]]))
    text.axis("off")
    text.text(0.0, 0.95, "\n".join(lines), va="top", fontsize=11, linespacing=1.8)
    text.text(0.0, 0.0, "Solid: obstacle. Dashed: grown by the half-width $w$.", fontsize=8.0, color=look.QUIET)
    return figure


def two_links(evidence: Evidence) -> Figure:
    """Figure 5: forbidden angles of the second link over theta1, by equations (1)-(3) and on the grid."""
    arm, grid, radius = (
        family_of(evidence.robot).arm,
        evidence.occupancy.grid,
        evidence.radius + float(family_of(evidence.robot).arm.half_widths[1]),
    )
    figure = new_figure(11.0, 5.2, "Two links and a circle: which angles of link 2 are forbidden")
    left, right = figure.subplots(1, 2)
    theta = np.linspace(grid.lower[0], grid.axis(0)[-1], 2001)
    heading = arm.signs[0] * theta + arm.offsets[0]
    offset = evidence.centre - arm.lengths[0] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    turn = (np.arctan2(offset[:, 1], offset[:, 0]) - heading + math.pi) % (2.0 * math.pi) - math.pi
    bearing = arm.signs[1] * (turn - arm.offsets[1])
    half = half_angles(np.hypot(*offset.T), float(arm.lengths[1]), radius)
    drawn = int(np.argmin(np.abs(theta - math.radians(40.0))))
    for angle, alpha in ((bearing[drawn] - half[drawn], 1.0), (bearing[drawn] + half[drawn], 0.55)):
        points = arm.joint_points(np.array([theta[drawn], angle, 0.0]))
        _links(left, points[:3], arm.half_widths.tolist(), look.LINKS, alpha)
    _disc(left, evidence.centre, evidence.radius, radius)
    _plane(left, np.array([[0.0, 0.0], [1.3, 1.4]]))
    left.set_title(f"Link 2 begins and ends to touch at $\\theta_1$ = {math.degrees(theta[drawn]):.0f}°")
    masks = [(_link_occupied(evidence, 2), look.OBSTACLE_TINT), (_link_occupied(evidence, 1), look.OBSTACLE)]
    _slice(right, grid, masks)
    for edge in (bearing - half, bearing + half):
        right.plot(np.degrees(theta), np.degrees(edge), color=look.PATH, lw=1.6, zorder=5)
    right.set_ylim(*np.degrees([grid.lower[1], grid.axis(1)[-1]]))
    handles = [_patch("link 1 collides", look.OBSTACLE), _patch("link 2 collides", look.OBSTACLE_TINT),
               _line("bounds by the equations", look.PATH, 1.6)]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def workspace_path(evidence: Evidence) -> Figure:
    """Figure 6: the path past the sphere, over the paths of the layers."""
    from matplotlib import colormaps

    grid, path, layers = evidence.demo.grid, path_found(evidence.demo_result), evidence.demo_result.slice_paths
    points = grid.coordinates(path)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    figure = new_figure(9.4, 5.8, f"Workspace path past the sphere: {length:.2f} units, {len(path)} points")
    axes = _axes_3d(figure, (24.0, -62.0))
    field = np.linalg.norm(_mesh(grid) - np.array(DEMO_CENTRE), axis=-1) - 0.5 * DEMO_DIAMETER
    # Surfaces are drawn in degrees of radians: a grid whose "radians" give these units.
    towards = draw_cspace_obstacle(axes, Grid(np.radians(grid.lower), np.radians(grid.step), grid.shape), field)
    for number, layer in layers.items():
        covered = hidden_by_surface(field, layer.astype(np.float64), towards, gap=1.0)
        color = colormaps["viridis"](number / max(layers))
        _line_3d(axes, grid.coordinates(layer), covered, color, 1.1, 4.0 + 0.01 * number)
    _line_3d(axes, points, hidden_by_surface(field, path.astype(np.float64), towards, gap=1.0), look.INK, 2.8, 7.0)
    _ends(axes, points)
    high = grid.coordinates(np.array(grid.shape) - 1)
    axes.set(xlim=(grid.lower[0], high[0]), ylim=(grid.lower[1], high[1]), zlim=(grid.lower[2], high[2]))
    axes.set(xlabel="x [unit]", ylabel="y [unit]", zlabel="z [unit]")
    axes.set_box_aspect(tuple(high - grid.lower), zoom=1.15)
    panes(axes)
    _legend(figure, _line(f"paths of the {len(layers)} layers", look.RESTORED, 1.4), _line("path", look.INK))
    return figure


def workspace_layers(evidence: Evidence) -> Figure:
    """Figure 7: six layers from above, with their paths."""
    grid, path, layers = evidence.demo.grid, path_found(evidence.demo_result), evidence.demo_result.slice_paths
    figure = new_figure(10.4, 7.6, "Six layers of the workspace and their paths")
    for axes, number in zip(figure.subplots(2, 3).flat, _nearest(grid, LAYERS), strict=True):
        _slice(
            axes, grid, [(evidence.demo.occupied_mask[:, :, number], look.OBSTACLE_TINT)], 1.0, ("x [unit]", "y [unit]")
        )
        layer, taken = grid.coordinates(layers[number]), grid.coordinates(path[path[:, 2] == number])
        axes.plot(layer[:, 0], layer[:, 1], color=look.PATH, lw=2.2, zorder=5)
        axes.plot(taken[:, 0], taken[:, 1], "o", color=look.INK, ms=3.6, zorder=8)
        _ends(axes, layer[:, :2])
        length = np.linalg.norm(np.diff(layer, axis=0), axis=1).sum()
        axes.set_title(f"z = {grid.axis(2)[number]:g}:  {length:.2f} units, {len(layer)} points")
    _legend(figure, _patch("sphere", look.OBSTACLE_TINT), _line("path of the layer", look.PATH),
            _line("points of the path of Fig. 6", look.INK, 0.0, marker="o", ms=4))  # fmt: skip
    return figure


def arm_and_obstacle(evidence: Evidence) -> Figure:
    """Figure 8: the arm in its plane at start and goal, and the obstacle."""
    figure = new_figure(7.2, 5.2, "Arm and obstacle: start and goal in the arm plane")
    axes = figure.add_subplot()
    _disc(axes, evidence.centre, evidence.radius)
    q = evidence.occupancy.grid.coordinates(_terminals(evidence))
    tools = np.stack([_arm(axes, evidence, each) for each in q])
    _ends(axes, tools)
    for tool, name, color, each in zip(tools, ("start", "goal"), (look.START, look.GOAL), np.degrees(q), strict=True):
        text = f"{name}\n$\\theta$ = ({', '.join(f'{value:g}' for value in each)})°"
        axes.text(tool[0], tool[1] + 0.08, text, color=color, ha="center", fontweight="bold", zorder=9)
    (x, y), radius = evidence.centre, evidence.radius
    axes.text(x + 1.2 * radius, y + radius, f"obstacle ({x:g}, {y:g}) m, radius {radius:g} m")
    _plane(axes, family_of(evidence.robot).arm.joint_points(q), 0.25)
    return figure


def cspace_obstacle(evidence: Evidence) -> Figure:
    """Figure 9: the C-space obstacle from two sides."""
    size, count = evidence.occupancy.grid.size, evidence.occupancy.occupied_count
    title = f"C-space of the three links: {count:,} of {size:,} nodes forbidden ({100.0 * count / size:.1f} %)"
    figure = new_figure(11.4, 6.0, title)
    for place, view in ((121, VIEW), (122, OTHER_VIEW)):
        axes, _ = _joint_space(figure, evidence, view, place)
        _ends(axes, _degrees(evidence, _terminals(evidence)))
    _legend(figure, _patch("forbidden", look.OBSTACLE))
    return figure


def _six(figure: Figure, evidence: Evidence) -> list[tuple[Any, int, float]]:
    """Panels of six slices: axes, number and theta3 [deg]."""
    grid = evidence.occupancy.grid
    numbers = _nearest(grid, np.radians(SLICES_DEG).tolist())
    degrees = np.degrees(grid.axis(2)[numbers]).tolist()
    return list(zip(figure.subplots(2, 3).flat, numbers, degrees, strict=True))


def slices(evidence: Evidence) -> Figure:
    """Figure 10: occupancy of six theta3 slices, and the existence of a path in each."""
    inner, ends = _link_occupied(evidence, 2), _degrees(evidence, _terminals(evidence))
    figure = new_figure(9.6, 6.9, r"Slices of the C-space at constant $\theta_3$")
    for axes, number, degrees in _six(figure, evidence):
        occupied, has_path = evidence.occupancy.occupied_mask[:, :, number], number in evidence.plain.paths
        masks = [(occupied, look.OBSTACLE_TINT), (occupied & inner, look.OBSTACLE)]
        _slice(axes, evidence.occupancy.grid, masks)
        _ends(axes, ends[:, :2])
        axes.set_title(f"$\\theta_3$ = {degrees:g}°:  {'goal is reached' if has_path else 'no path'}",
                       color=look.PATH if has_path else look.OBSTACLE)  # fmt: skip
    _legend(figure, _patch("links 1, 2 collide", look.OBSTACLE), _patch("link 3 collides", look.OBSTACLE_TINT))
    return figure


def slice_paths(evidence: Evidence) -> Figure:
    """Figure 11: paths of slices after connectivity restoration, their own or the part kept of the first one."""
    grid, paths, heads = evidence.occupancy.grid, evidence.plain.paths, evidence.plain.heads
    figure = new_figure(9.6, 6.9, "Slice paths after connectivity restoration")
    for axes, number, degrees in _six(figure, evidence):
        _slice(axes, grid, [(evidence.occupancy.occupied_mask[:, :, number], look.OBSTACLE_TINT)])
        whole = _degrees(evidence, paths.get(number, paths[min(paths)]))
        if number in paths:
            axes.plot(whole[:, 0], whole[:, 1], color=look.PATH, lw=2.4, zorder=5)
            label = _length(grid, paths[number])
        else:
            kept = _degrees(evidence, heads[number])
            axes.plot(whole[:, 0], whole[:, 1], color=look.QUIET, lw=1.1, ls=(0, (2, 1.5)), zorder=4)
            axes.plot(kept[:, 0], kept[:, 1], color=look.RESTORED, lw=3.0, zorder=5)
            label = f"{len(kept)} of {len(whole)} points kept"
        _ends(axes, whole[:, :2])
        axes.set_title(f"$\\theta_3$ = {degrees:g}°:  {label}")
    _legend(figure, _line("path of the slice", look.PATH), _line("kept", look.RESTORED, 3.0),
            _line("cut off", look.QUIET, 1.1, ls=(0, (2, 1.5))), _patch("forbidden", look.OBSTACLE_TINT))  # fmt: skip
    return figure


def sparse_path(evidence: Evidence) -> Figure:
    """Figure 12: the sparse graph of slice paths and restored parts, and the path found in it."""
    path = path_found(evidence.plain.second)
    figure = new_figure(8.4, 6.8, f"Path in the sparse graph: {_length(evidence.occupancy.grid, path)}")
    axes, towards = _joint_space(figure, evidence)
    for lines, color in ((evidence.plain.heads, look.RESTORED), (evidence.plain.paths, look.PATH)):
        for line in list(lines.values())[::3]:
            _joint_path(axes, evidence, line, towards, color, 0.9)
    _joint_path(axes, evidence, path, towards, look.INK, 2.8)
    _ends(axes, _degrees(evidence, path))
    _legend(figure, _patch("forbidden", look.OBSTACLE), _line("slice paths (every third)", look.PATH, 1.4),
            _line("restored parts", look.RESTORED, 1.4), _line("path (dotted: behind)", look.INK))  # fmt: skip
    return figure


def snapshots(evidence: Evidence) -> Figure:
    """Figure 13: eight points of the path, start and goal among them, each with its joint angles and clearance."""
    path = path_found(evidence.plain.second)
    q, clearance = evidence.occupancy.grid.coordinates(path), _field(evidence)[tuple(path.T)]
    points = family_of(evidence.robot).arm.joint_points(q)
    title = f"Execution of the path of {len(path)} points: smallest clearance at a point {1e3 * clearance.min():.1f} mm"
    figure = new_figure(12.0, 5.9, title)
    drawn = np.rint(np.linspace(0, len(path) - 1, 8)).astype(int).tolist()
    for axes, index in zip(figure.subplots(2, 4).flat, drawn, strict=True):
        _arm(axes, evidence, q[index])
        _disc(axes, evidence.centre, evidence.radius)
        axes.plot(*points[:, -1].T, color=look.FAINT, lw=1.6, zorder=1)
        axes.plot(*points[: index + 1, -1].T, color=look.PATH, lw=2.0, zorder=6)
        _ends(axes, points[:, -1])
        _plane(axes, points)
        axes.label_outer()
        degrees = ", ".join(f"{value:.0f}" for value in np.degrees(q[index]))
        axes.set_title(f"Point {index + 1}: ({degrees})°, {clearance[index]:.3f} m clear")
    return figure


def paths_in_cspace(evidence: Evidence) -> Figure:
    """Figure 14: the paths of both methods past the C-space obstacle."""
    grid, dense, two_level = evidence.occupancy.grid, path_found(evidence.dense), path_found(evidence.plain.second)
    figure = new_figure(8.4, 6.8, "Both paths in the C-space")
    axes, towards = _joint_space(figure, evidence)
    # The wider line is visible on both sides where the paths coincide.
    _joint_path(axes, evidence, dense, towards, look.PATH, 5.0)
    _joint_path(axes, evidence, two_level, towards, look.INK, 1.8, 9.2)
    _ends(axes, _degrees(evidence, dense))
    _legend(figure, _line(f"dense A*: {_length(grid, dense)}", look.PATH, 5.0),
            _line(f"two-level: {_length(grid, two_level)}", look.INK, 1.8))  # fmt: skip
    return figure


def _draw_motion(axes: Any, evidence: Evidence, path: IntArray, color: str) -> None:
    """The arm along a path: some configurations, the tool's path, the obstacle."""
    q = evidence.occupancy.grid.coordinates(path)
    for index in np.rint(np.linspace(0, len(q) - 1, 9)).astype(int).tolist():
        _arm(axes, evidence, q[index], 1.0 if index in (0, len(q) - 1) else 0.25)
    _disc(axes, evidence.centre, evidence.radius)
    points = family_of(evidence.robot).arm.joint_points(q)
    axes.plot(*points[:, -1].T, color=color, lw=2.2, zorder=6)
    _ends(axes, points[:, -1])
    _plane(axes, points)


def paths_in_workspace(evidence: Evidence) -> Figure:
    """Figure 15: the motions of the arm along the paths of both methods."""
    figure = new_figure(12.0, 5.6, "Both paths as motions of the arm")
    found = {"Dense A*": evidence.dense, "Two-level": evidence.plain.second}
    for axes, (name, search) in zip(figure.subplots(1, 2), found.items(), strict=True):
        path = path_found(search)
        _draw_motion(axes, evidence, path, look.PATH)
        axes.set_title(f"{name}: {_length(evidence.occupancy.grid, path)}")
    return figure


def comparison(numbers: Reproduction, evidence: Evidence) -> Figure:
    """Figure 16: nodes, time and cost, of the paper and measured, and the nodes' distribution."""
    runs = {
        "paper: dense A*": PAPER_DENSE, "paper: two-level": PAPER_TWO_LEVEL, "here: dense A*": numbers.runs["dense"],
        "here: two-level, plain": numbers.runs["plain"], "here: two-level, hplan": numbers.runs["hplan"],
    }  # fmt: skip
    figure = new_figure(12.4, 7.4, "Comparison of dense A* and the two-level method")
    panels, colors = figure.add_gridspec(2, 3), [look.INK, look.PATH, look.INK, look.PATH, look.PATH]
    columns: dict[str, tuple[list[float], list[str]]] = {
        "nodes expanded": ([r.layers + r.second for r in runs.values()],
                           [f"{r.layers:,} + {r.second:,}" if r.layers else f"{r.second:,}" for r in runs.values()]),
        "time [ms], logarithmic": ([r.ms for r in runs.values()], [f"{r.ms:,.3g} ms" for r in runs.values()]),
        "cost [deg]": ([r.cost for r in runs.values()], [f"{r.cost:.6f}°, {r.points} points" for r in runs.values()]),
    }  # fmt: skip
    for column, (label, (values, texts)) in enumerate(columns.items()):
        axes = figure.add_subplot(panels[0, column])
        axes.barh(range(5), values, color=colors, height=0.6)
        axes.set_yticks(range(5), list(runs) if column == 0 else [""] * 5)
        axes.invert_yaxis()
        axes.set_xlabel(label)
        if column == 1:
            axes.set_xscale("log")
        else:
            axes.locator_params(axis="x", nbins=4)
        if column == 2:
            axes.set_xlim(min(values) - 1.0, max(values) + 0.2)
        for row, text in enumerate(texts):
            axes.text(0.02, row - 0.37, text, fontsize=8, va="bottom", transform=axes.get_yaxis_transform())
    axes, plain = figure.add_subplot(panels[1, :]), evidence.plain
    degrees = np.rint(np.degrees(evidence.occupancy.grid.axis(2))).astype(int)
    for has_path, color in ((False, look.OBSTACLE), (True, look.PATH)):
        counted = {n: count for n, count in plain.expansions.items() if (n in plain.paths) == has_path}
        text = f"{len(counted)} slices with{'' if has_path else 'out'} a path: {sum(counted.values()):,} nodes"
        axes.bar(degrees[list(counted)], list(counted.values()), 0.82, color=color, label=text)
    axes.set(xlabel=r"slice $\theta_3$ [deg]", ylabel="nodes expanded")
    axes.set_title("First level, to the letter: the nodes of every slice search, which the paper does not count")
    axes.legend(loc="upper center", ncols=2)
    return figure


@apply_style
def overview(evidence: Evidence) -> Figure:
    """The method in one picture: the path in the C-space, and the corresponding motion."""
    figure, path = new_figure(11.0, 4.8, ""), path_found(evidence.plain.second)
    axes, towards = _joint_space(figure, evidence, VIEW, 121)
    _joint_path(axes, evidence, path, towards, look.INK, 2.8)
    _ends(axes, _degrees(evidence, path))
    axes.set_title("A path through joint space")
    right = figure.add_subplot(122)
    _draw_motion(right, evidence, path, look.INK)
    right.set_title("The same path as a motion of the arm")
    return figure
