"""Timing alone: waypoints of any robot that Pinocchio reads, without a scene.

May use the rooms up to `verification`.
"""

from hplan.waypoints.corner_rounding import largest_deviation, rounded_path
from hplan.waypoints.machine import Machine, limits_of, read_machine
from hplan.waypoints.timing import (
    AT_LIMIT,
    DEVIATION,
    LimitShares,
    corner_grid,
    limit_shares,
    read_waypoints,
    time_waypoints,
)

__all__ = [
    "AT_LIMIT",
    "DEVIATION",
    "LimitShares",
    "Machine",
    "corner_grid",
    "largest_deviation",
    "limit_shares",
    "limits_of",
    "read_machine",
    "read_waypoints",
    "rounded_path",
    "time_waypoints",
]
