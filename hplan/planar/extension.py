"""Registers the planar family with planning.

`hplan` declares this module as an extension, and `hplan.base.lazy_import` imports it when a plan first asks for one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from hplan.planar.effort import EFFORTS
from hplan.planar.family_reader import is_planar
from hplan.planar.goal_sampler import configurations_at_point
from hplan.planar.joint_ranges import joint_ranges
from hplan.planar.no_path_proof import describe_proof, prove_infeasible
from hplan.planar.path_finders import path_finders, searches_first
from hplan.planning.options import PlanOptions
from hplan.planning.path_finder import PathFinder
from hplan.planning.problem import Problem
from hplan.planning.result import PlanResult
from hplan.planning.specialist import GoalSampler, Specialist, register_specialist
from hplan.robot.model import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def check_cspace(robot: Robot, yaw: float | None) -> None:
    """Check that an arm's C-space can be drawn at a yaw.

    None for the goal's yaw.

    Raises:
        InputError: The arm does not have three planar joints.
        OptionError: The yaw is not finite, is beyond the limits, or is nonzero for an arm without yaw.
    """
    from hplan.planar.pages.yaw_section import check_yaw

    check_yaw(robot, yaw)


def draw_cspace(result: PlanResult, options: PlanOptions, yaw: float | None) -> tuple[str, Callable[[], Figure]]:
    """Return the page of a result's C-space at a yaw.

    Also returns a function that draws its figure.

    Raises:
        InputError: The arm does not have three planar joints.
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    from hplan.apps.view.playback import Playback
    from hplan.planar.pages.cspace_figure import cspace_at_yaw
    from hplan.planar.pages.cspace_page import render_cspace_page
    from hplan.planar.pages.yaw_section import yaw_section

    title = result.scene.name
    section = yaw_section(result.robot, result.scene, Playback.from_result(result), options, yaw=yaw)
    return render_cspace_page(section, title), lambda: cspace_at_yaw(section, title)


register_specialist(
    Specialist[Problem, PathFinder](
        recognizes=is_planar,
        presets=EFFORTS,
        # The closed form returns all configurations, and all of their approaches are tried.
        goal_sampler=GoalSampler(configurations_at_point, more=512, enough=None, is_sorted=False),
        joint_ranges=joint_ranges,
        path_finders=path_finders,
        prove_infeasible=prove_infeasible,
        describe_proof=describe_proof,
        searches_first=searches_first,
        check_cspace=check_cspace,
        draw_cspace=draw_cspace,
    )
)
