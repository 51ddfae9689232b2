"""The look that all figures share, and the figures of an arm in its plane and of slices of its C-space.

`figures_arm` draws the arm in its plane, `figures_cspace` slices of the C-space; `figures_3d` has what figures in three
dimensions need; `figure_style` holds colours and saving, `figure_data` the arrays that are drawn.
"""

from __future__ import annotations

from studies.view.figures_arm import arm_and_obstacle, motions
from studies.view.figures_cspace import slice_paths, slices

from hplan.view.figure_style import (
    GOAL,
    INK,
    OBSTACLE,
    PATH,
    QUIET,
    RESTORED,
    START,
    new_figure,
    png_bytes,
    require_matplotlib,
    styled,
)

__all__ = [
    "GOAL",
    "INK",
    "OBSTACLE",
    "PATH",
    "QUIET",
    "RESTORED",
    "START",
    "arm_and_obstacle",
    "motions",
    "new_figure",
    "png_bytes",
    "require_matplotlib",
    "slice_paths",
    "slices",
    "styled",
]
