"""hplan: motion planning for fruit-harvesting arms.

The names below load on first use, so that `import hplan` costs next to nothing. Each lives in the module that the
table names; whatever stands there can be imported from there as well.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hplan.certificate import Certificate, certify
    from hplan.errors import HplanError
    from hplan.options import PlanOptions
    from hplan.pipeline import PlanResult, plan
    from hplan.planner import Planner
    from hplan.robot import Robot, load_robot
    from hplan.scene import Scene
    from hplan.scene_file import load_scene, save_scene
    from hplan.tour import TourOptions, TourResult, plan_tour
    from hplan.trajectory import Trajectory, read_csv, write_csv

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
    "Certificate": "certificate",
    "HplanError": "errors",
    "PlanOptions": "options",
    "PlanResult": "pipeline",
    "Planner": "planner",
    "Robot": "robot",
    "Scene": "scene",
    "TourOptions": "tour",
    "TourResult": "tour",
    "Trajectory": "trajectory",
    "certify": "certificate",
    "load_robot": "robot",
    "load_scene": "scene_file",
    "plan": "pipeline",
    "plan_tour": "tour",
    "read_csv": "trajectory",
    "save_scene": "scene_file",
    "write_csv": "trajectory",
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
