"""Figure of a trajectory: position, velocity, acceleration and torque of all joints."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from hplan.apps.view.figure_style import FAINT, GOAL, INK, OBSTACLE, PATH, QUIET, RESTORED, START, new_figure, styled
from hplan.base.arrays import FloatArray
from hplan.base.units import joint_unit
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory, check_joints

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLORS = (PATH, OBSTACLE, START, GOAL, INK, RESTORED, QUIET)


@styled
def draw_trajectory(trajectory: Trajectory, robot: Robot | None = None) -> Figure:
    """Draw a trajectory over time.

    Args:
        trajectory: The trajectory.
        robot: Robot whose limits are drawn as dotted lines; None for no limits.

    Raises:
        InputError: Matplotlib is not installed, or the joints of the trajectory are not the robot's.
    """
    if robot is not None:
        check_joints(trajectory, robot)
    slides = trajectory.slides or (False,) * len(trajectory.joint_names)
    units = [joint_unit(slide) for slide in slides]
    factors = np.array([unit.factor for unit in units])
    shown = ", ".join(dict.fromkeys(unit.shown for unit in units))
    efforts = ", ".join(dict.fromkeys(unit.effort for unit in units))
    ends: list[tuple[FloatArray, ...]] = [(), (), (), ()]
    if robot is not None:
        largest = robot.velocity_limit, robot.acceleration_limit, robot.torque_limit
        ends = [(robot.lower, robot.upper), *((-limit, limit) for limit in largest)]
    rows = (
        (f"position [{shown}]", factors, trajectory.position),
        (f"velocity [{shown}/s]", factors, trajectory.velocity),
        (f"acceleration [{shown}/s²]", factors, trajectory.acceleration),
        (f"effort [{efforts}]", np.ones(len(units)), trajectory.torque),
    )
    figure = new_figure(7.2, 8.0, f"{trajectory.duration:.3f} s")
    axes = figure.subplots(4, sharex=True)
    for axis, (label, factor, values), limits in zip(axes, rows, ends, strict=True):
        axis.grid(color=FAINT, lw=0.6)
        axis.set_ylabel(label)
        for joint, name in enumerate(trajectory.joint_names):
            style, color = "-" if joint < len(_COLORS) else "--", _COLORS[joint % len(_COLORS)]
            axis.plot(trajectory.time, factor[joint] * values[:, joint], style, lw=1.3, color=color, label=name)
        low, high = axis.get_ylim()
        for joint, limit in itertools.product(range(len(units)), limits):
            axis.axhline(factor[joint] * limit[joint], ls=":", lw=0.8, color=_COLORS[joint % len(_COLORS)])
        axis.set_ylim(low, high)  # limits far outside the trajectory do not rescale the axis
    axes[-1].set_xlabel("time [s]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower left", ncols=4)
    return figure
