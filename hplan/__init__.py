"""hplan: motion planning for fruit-harvesting arms.

The names below load on first use, so that `import hplan` costs next to nothing. Each lives in the module that it is
imported from here; whatever stands there can be imported from there as well.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hplan.base.lazy_import import VIEWERS, declare_extension, lazy_names

if TYPE_CHECKING:
    from hplan.certificate.certificate import Certificate, certify
    from hplan.certificate.configuration_check import ConfigurationCheck, check
    from hplan.errors import HplanError
    from hplan.online.planner import Planner
    from hplan.online.warm_up import warm_up
    from hplan.planning.finish import finish
    from hplan.planning.options import PlanOptions
    from hplan.planning.plan import plan
    from hplan.planning.pose_sequence import plan_poses
    from hplan.planning.reachable import FruitReach, reachable
    from hplan.planning.result import PlanResult
    from hplan.robot.model import Robot, load_robot
    from hplan.scene.file import load_scene, save_scene
    from hplan.scene.model import Scene
    from hplan.study.batch import BatchRow, run_batch
    from hplan.study.definition import Study
    from hplan.study.run import StudyResult, run_study
    from hplan.tour.cell_tour import CellTour, plan_cell_tour
    from hplan.tour.row import RowOptions, RowResult, plan_row
    from hplan.tour.tour import TourOptions, TourResult, plan_tour
    from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv
    from hplan.workcell.cell import Cell, CellResult, certify_cell, load_cell
    from hplan.workcell.planner import plan_cell, replan_cell

__version__ = "0.2.0"

__all__ = [
    "BatchRow",
    "Cell",
    "CellResult",
    "CellTour",
    "Certificate",
    "ConfigurationCheck",
    "FruitReach",
    "HplanError",
    "PlanOptions",
    "PlanResult",
    "Planner",
    "Robot",
    "RowOptions",
    "RowResult",
    "Scene",
    "Study",
    "StudyResult",
    "TourOptions",
    "TourResult",
    "Trajectory",
    "certify",
    "certify_cell",
    "check",
    "finish",
    "load_cell",
    "load_robot",
    "load_scene",
    "plan",
    "plan_cell",
    "plan_cell_tour",
    "plan_poses",
    "plan_row",
    "plan_tour",
    "reachable",
    "read_csv",
    "replan_cell",
    "run_batch",
    "run_study",
    "save_scene",
    "warm_up",
    "write_csv",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.certificate.certificate": "Certificate certify",
        "hplan.errors": "HplanError",
        "hplan.online.planner": "Planner",
        "hplan.online.warm_up": "warm_up",
        "hplan.workcell.cell": "Cell CellResult certify_cell load_cell",
        "hplan.workcell.planner": "plan_cell replan_cell",
        "hplan.certificate.configuration_check": "ConfigurationCheck check",
        "hplan.planning.finish": "finish",
        "hplan.planning.options": "PlanOptions",
        "hplan.planning.plan": "plan",
        "hplan.planning.pose_sequence": "plan_poses",
        "hplan.planning.reachable": "FruitReach reachable",
        "hplan.planning.result": "PlanResult",
        "hplan.robot.model": "Robot load_robot",
        "hplan.scene.file": "load_scene save_scene",
        "hplan.scene.model": "Scene",
        "hplan.study.batch": "BatchRow run_batch",
        "hplan.study.definition": "Study",
        "hplan.study.run": "StudyResult run_study",
        "hplan.tour.cell_tour": "CellTour plan_cell_tour",
        "hplan.tour.row": "RowOptions RowResult plan_row",
        "hplan.tour.tour": "TourOptions TourResult plan_tour",
        "hplan.trajectory.trajectory": "Trajectory read_csv write_csv",
    },
)

#: Modules at the edge that add path finders, inverse kinematics, proofs and pages for robots that they recognize.
declare_extension("hplan.planar.extension")

#: Readers of other programs' files for the obstacles of a scene.
declare_extension("hplan.apps.ros.scene_files", "obstacles")


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted(__all__)


def _notebook_html(result: Any) -> str:
    """Make the page of a result for a notebook."""
    from hplan.apps.view.page import notebook_html

    return notebook_html(result)


def _draw_trajectory(trajectory: Trajectory, robot: Robot | None) -> Any:
    """Draw joint values over time."""
    from hplan.apps.view.figures import draw_trajectory

    return draw_trajectory(trajectory, robot)


VIEWERS.update(notebook_html=_notebook_html, draw_trajectory=_draw_trajectory)
