"""Figures of the arm in its plane: at start and goal, and its motion.

Each figure is a function that takes data and returns a matplotlib `Figure`. Angles come in radians, as everywhere in
hplan, and are drawn in degrees.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hplan.apps.view.figure_style import GOAL, INK, LINKS, OBSTACLE, PATH, QUIET, START, new_figure, styled
from hplan.base.arrays import FloatArray
from hplan.robot.planar_family import PlanarArm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    """Draw the arm's capsule links in its plane."""
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


def draw_link(
    axes: Axes, joint: ArrayLike, heading: float, length: float, half_width: float, *, alpha: float = 1.0
) -> FloatArray:
    """Draw one capsule link with its axis; returns its (2,) tip [m]."""
    from matplotlib.patches import Polygon

    near = np.asarray(joint, dtype=np.float64)
    tip: FloatArray = near + length * np.array([math.cos(heading), math.sin(heading)])
    axes.add_patch(
        Polygon(capsule_outline(near, tip, half_width), fc=LINKS[1], ec="white", lw=0.8, alpha=alpha, zorder=4)
    )
    axes.plot([near[0], tip[0]], [near[1], tip[1]], color="white", lw=0.8, zorder=5)
    return tip


@styled
def arm_and_obstacle(arm: PlanarArm, centre: ArrayLike, radius: float, start: ArrayLike, goal: ArrayLike) -> Figure:
    """The arm in its plane at start and goal, and the obstacle."""
    from matplotlib.patches import Arc

    figure = new_figure(7.2, 5.2, "Arm and obstacle: start and goal in the arm plane")
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
        marker = "o" if name == "start" else "s"
        axes.plot(points[-1, 0], points[-1, 1], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
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


def draw_motion(
    axes: Axes, arm: PlanarArm, centre: ArrayLike, radius: float, path: FloatArray, *, poses: int = 9, color: str = PATH
) -> None:
    """Draw a motion stroboscopically: poses from light to dark, the tool's path, start and goal."""
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
def motions(arm: PlanarArm, centre: ArrayLike, radius: float, paths: Mapping[str, FloatArray]) -> Figure:
    """The arm's motion, one column for each method, and the joint angles along the path."""
    figure = new_figure(10.4, 6.7, "Both paths in the workspace")
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
