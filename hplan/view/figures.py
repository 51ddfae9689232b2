"""All figures, gathered, and the look they share; each is drawn in the module of its subject.

`figures_arm` draws the arm in its plane, `figures_cspace` the C-space and its slices, `figures_3d` what has three
dimensions; `figure_style` holds colours and saving, `figure_data` the arrays that are drawn.
"""

from __future__ import annotations

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
from hplan.view.figures_3d import cspace_and_path, overview, workspace
from hplan.view.figures_arm import arm_and_obstacle, link_cases, motions
from hplan.view.figures_cspace import layer_paths, restoration, slices, two_link_cspace

__all__ = [
    "GOAL",
    "INK",
    "OBSTACLE",
    "PATH",
    "QUIET",
    "RESTORED",
    "START",
    "arm_and_obstacle",
    "cspace_and_path",
    "layer_paths",
    "link_cases",
    "motions",
    "new_figure",
    "overview",
    "png_bytes",
    "require_matplotlib",
    "restoration",
    "slices",
    "styled",
    "two_link_cspace",
    "workspace",
]
