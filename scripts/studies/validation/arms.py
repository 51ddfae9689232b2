"""Arms of any kind by chance: members of the family, chains, the harvester and robots by name."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from studies.outside import arm_of
from studies.validation.judge import Arm
from studies.validation.members import CHAINS, write_chain, write_member

from hplan.robot.model import Robot, load_robot

#: Robots of example-robot-data, and the one that ships.
NAMED = ("panda", "ur3", "ur5", "ur10", "orchard_harvester")

#: Shares of members and of chains; the others are robots by name.
_MEMBERS, _CHAINS = 0.4, 0.45


@dataclass(frozen=True, eq=False)
class DrawnArm:
    """An arm as hplan has it, and as the judge has.

    Attributes:
        kind: What was drawn.
        robot: As hplan reads it.
        arm: As Pinocchio reads it.
    """

    kind: str
    robot: Robot
    arm: Arm


def draw_arm(folder: Path, rng: np.random.Generator) -> DrawnArm:
    """An arm by chance.

    Args:
        folder: Where its files may be written.

    Raises:
        HplanError: hplan does not take it.
    """
    share = rng.random()
    if share < _MEMBERS:
        offsets = bool(rng.random() < 0.5)
        robot = load_robot(write_member(folder, rng, offsets=offsets))
        kind = f"{robot.arm.link_count} links{', yaw' if robot.has_yaw else ''}{', offsets' if offsets else ''}"
        return DrawnArm(kind, robot, Arm(robot.urdf_path))
    if share < _MEMBERS + _CHAINS:
        kind = list(CHAINS)[int(rng.integers(len(CHAINS)))]
        robot = load_robot(write_chain(folder, rng, kind))
        return DrawnArm(kind, robot, Arm(robot.urdf_path))
    return named_arm(NAMED[int(rng.integers(len(NAMED)))])


@cache
def named_arm(name: str) -> DrawnArm:
    """A robot by name."""
    return given_arm(load_robot(name))


def given_arm(robot: Robot) -> DrawnArm:
    """A robot that hplan has read, read by the judge too."""
    return DrawnArm(robot.name, robot, arm_of(robot))
