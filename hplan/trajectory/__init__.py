"""Time-optimal path timing: limits, toppra's passes, jerk, trajectories and their CSV.

The names exported here time waypoints of any robot that Pinocchio reads, without a scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hplan.base.lazy_import import lazy_names

if TYPE_CHECKING:
    from hplan.trajectory.corner_rounding import largest_path_deviation, rounded_path
    from hplan.trajectory.timing import (
        AT_LIMIT,
        DEVIATION,
        LimitShares,
        corner_grid,
        limit_shares,
        limits_of,
        read_kinematics,
        read_waypoints,
        time_waypoints,
    )

__all__ = [
    "AT_LIMIT",
    "DEVIATION",
    "LimitShares",
    "corner_grid",
    "largest_path_deviation",
    "limit_shares",
    "limits_of",
    "read_kinematics",
    "read_waypoints",
    "rounded_path",
    "time_waypoints",
]

__getattr__ = lazy_names(
    __name__,
    {
        "hplan.trajectory.corner_rounding": "largest_path_deviation rounded_path",
        "hplan.trajectory.timing": "AT_LIMIT DEVIATION LimitShares corner_grid limit_shares limits_of "
        "read_kinematics read_waypoints time_waypoints",
    },
)
