"""hplan: motion planning for fruit-harvesting arms.

The names below load on first use, so that `import hplan` costs next to nothing. Each lives in the module that the
table names; whatever stands there can be imported from there as well.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hplan.errors import HplanError
    from hplan.planning.plan import PlanResult, plan
    from hplan.planning.planner import Planner
    from hplan.problem.options import PlanOptions
    from hplan.robot.model import Robot, load_robot
    from hplan.scene.file import load_scene, save_scene
    from hplan.scene.model import Scene
    from hplan.timing.trajectory import Trajectory, read_csv, write_csv
    from hplan.tour.tour import TourOptions, TourResult, plan_tour
    from hplan.verification.certificate import Certificate, certify

__version__ = "0.1.0"

__all__ = [
    "Certificate",
    "HplanError",
    "PlanOptions",
    "PlanResult",
    "Planner",
    "Robot",
    "Scene",
    "TourOptions",
    "TourResult",
    "Trajectory",
    "certify",
    "load_robot",
    "load_scene",
    "plan",
    "plan_tour",
    "read_csv",
    "save_scene",
    "write_csv",
]

_HOME = {
    "Certificate": "verification.certificate",
    "HplanError": "errors",
    "PlanOptions": "problem.options",
    "PlanResult": "planning.plan",
    "Planner": "planning.planner",
    "Robot": "robot.model",
    "Scene": "scene.model",
    "TourOptions": "tour.tour",
    "TourResult": "tour.tour",
    "Trajectory": "timing.trajectory",
    "certify": "verification.certificate",
    "load_robot": "robot.model",
    "load_scene": "scene.file",
    "plan": "planning.plan",
    "plan_tour": "tour.tour",
    "read_csv": "timing.trajectory",
    "save_scene": "scene.file",
    "write_csv": "timing.trajectory",
}


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'hplan' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"hplan.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted(__all__)
