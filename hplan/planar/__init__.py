"""Arms of the planar family: an optional yaw joint, then parallel revolute joints.

The package adds the published method to planning: the analytic C-space, two-level A* on its grid, and proofs that no
path exists. `hplan` declares it as an extension; no lower layer imports it.
"""

from __future__ import annotations

from hplan.planar.effort import EFFORTS
from hplan.planar.no_path_proof import describe_proof, prove_infeasible
from hplan.planar.path_finders import path_finders, searches_first
from hplan.planning.effort import register_presets
from hplan.planning.specialist import Specialist, register_specialist
from hplan.robot.model import Robot


def is_planar(robot: Robot) -> bool:
    """True if a robot belongs to the planar family."""
    return robot.planar is not None


register_presets(is_planar, EFFORTS)
register_specialist(
    Specialist(
        recognizes=is_planar,
        path_finders=path_finders,
        prove_infeasible=prove_infeasible,
        describe_proof=describe_proof,
        searches_first=searches_first,
    )
)
