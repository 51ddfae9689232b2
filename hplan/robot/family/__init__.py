"""Generates URDFs and limits files of planar arms from specifications."""

from hplan.robot.family.members import CrossCheck, cross_check, load_member, write_robot
from hplan.robot.family.spec import HARVESTER, ORCHARD_HARVESTER, ArmSpec, Gripper

__all__ = [
    "HARVESTER",
    "ORCHARD_HARVESTER",
    "ArmSpec",
    "CrossCheck",
    "Gripper",
    "cross_check",
    "load_member",
    "write_robot",
]
