"""Figure of the C-space at one yaw.

It shows the forbidden region and the motion.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.apps.view.figures import FAINT, GOAL, INK, OBSTACLE, START, apply_style, new_figure
from hplan.planar.pages.cspace_surface import draw_cspace_obstacle, hidden_by_surface, joint_box
from hplan.planar.pages.yaw_section import YawSection

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Colours of the motion: at the yaw, and farthest from it.
_NEAR, _FAR = INK, "#A9BBCB"


@apply_style
def cspace_at_yaw(section: YawSection, title: str = "") -> Figure:
    """Draw the forbidden region at one yaw and the projected motion.

    Hidden segments of the motion are dotted. The line becomes thinner and paler with the distance of the motion's yaw
    from the region's, because the region at that yaw is a different one.

    Args:
        title: Title; may be empty.
    """
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    grid, azimuth_elevation = section.grid, section.view
    figure = new_figure(7.6, 6.6, title)
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    axes.set_proj_type("ortho")
    axes.view_init(azim=azimuth_elevation[0], elev=azimuth_elevation[1])
    towards = draw_cspace_obstacle(axes, grid, section.field)
    most = float(section.yaw_distance.max())
    colors = LinearSegmentedColormap.from_list("yaw distance", [_NEAR, _FAR])
    norm = Normalize(0.0, max(math.degrees(most), 1e-9))
    behind = _draw_motion(axes, section, towards, lambda distance: colors(norm(math.degrees(distance))))
    joint_box(axes, grid, 1.04, section.joint_names)
    turns = most > math.radians(0.5)
    words = "motion, projected" if turns else "motion"
    if behind:
        words += " (dotted: behind)"
    handles: list[Any] = [
        Patch(fc=OBSTACLE, label=f"forbidden at yaw {math.degrees(section.yaw):.1f}°"),
        Line2D([], [], color=INK, lw=2.8, label=words),
        Line2D([], [], marker="o", color=START, ls="none", ms=8, label="start"),
        Line2D([], [], marker="s", color=GOAL, ls="none", ms=8, label="goal"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, columnspacing=1.4, handlelength=1.6)
    if turns:
        from matplotlib.cm import ScalarMappable

        bar = figure.colorbar(ScalarMappable(norm, colors), ax=axes, shrink=0.42, aspect=18, pad=0.09)
        bar.set_label("yaw difference from the region [deg]")
        bar.outline.set_edgecolor(FAINT)
    return figure


def _draw_motion(axes: Any, section: YawSection, towards: Any, color_of: Any) -> bool:
    """Draw the motion; return True if any segment is hidden.

    The farthest segments are drawn first, then the ends.
    """
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    points = np.degrees(section.path)
    covered = hidden_by_surface(section.field, section.grid.position(section.path), towards)
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    dark = covered[:-1] | covered[1:]
    fraction = section.yaw_distance[:-1] / max(float(section.yaw_distance.max()), 1e-9)
    widths = 3.2 - 2.0 * fraction
    colors = np.array([color_of(distance) for distance in section.yaw_distance[:-1]])
    # Every second pair of hidden segments is omitted, which gives dots.
    dots = dark & (np.arange(len(dark)) % 4 < 2)
    for shown, thick, alpha, zorder in ((dots, 0.6, 0.8, 6.0), (~dark, 1.0, 1.0, 7.0)):
        if shown.any():
            if thick == 1.0:
                axes.add_collection3d(
                    Line3DCollection(
                        pieces[shown], colors="white", linewidths=widths[shown] + 1.6, zorder=zorder - 0.5,
                        capstyle="round",
                    )
                )  # fmt: skip
            axes.add_collection3d(
                Line3DCollection(
                    pieces[shown], colors=colors[shown], linewidths=thick * widths[shown], alpha=alpha, zorder=zorder,
                    capstyle="round",
                )
            )  # fmt: skip
    for point, color, marker in ((points[0], START, "o"), (points[-1], GOAL, "s")):
        axes.plot(*point[:, None], marker, color=color, ms=9, mec="white", mew=1.2, zorder=9)
    return bool(dark.any())
