"""The certificate of a motion that runs along another one's path: the clearance is the path's, the limits are its own.

What is certified clear stays so on its path. A new timing (`hplan.trajectory.time_scaling`) leaves the path by a
bounded part of a millimetre; by as much the clearance is less, and where it does not suffice, it is shown anew. It is
shown anew as well where another timing changes what it depends on: where obstacles move, and where tracking errors grow
with velocity. Velocity, acceleration and torque are always checked anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import (
    Certificate,
    all_of,
    base_violations,
    certify_among,
    limit_violations,
    on_track,
    rest_violations,
    stretches,
    with_violations,
)
from hplan.certificate.digests import Digests
from hplan.certificate.goal_contact import FruitContact
from hplan.certificate.limit_use import limit_use
from hplan.certificate.motion_bound import largest_pair_sway
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas
from hplan.trajectory.trajectory import SAME_TIME, Retimed, Trajectory


@dataclass(frozen=True, eq=False)
class CertifiedMotion(Record, InNotebook):
    """A motion along the path of another one, and what was shown of it.

    Attributes:
        trajectory: The motion, on the same clock as the other one up to where they part.
        certificate: What was shown of it.
        parts_s: When the two part [s].
        off_path_m: Bound of how far the arm is off the other one's path [m].
        robot: The arm.
        scene: What it is certified among.
        begins_s: When the trajectory begins, on the controller's clock: as that of the other one [s].
    """

    trajectory: Trajectory
    certificate: Certificate
    parts_s: float
    off_path_m: float
    robot: Robot
    scene: Scene
    begins_s: float = 0.0


def certified_retiming(
    robot: Robot,
    scene: Scene,
    running: Certificate,
    retimed: Retimed,
    *,
    tracking: TrackingModel,
    sigmas: Sigmas,
    anew: bool = False,
) -> CertifiedMotion:
    """A motion along another one's path with its certificate.

    Args:
        scene: What the other motion is certified among.
        tracking: Deviation of the joints that is covered.
        sigmas: How many standard deviations of its place an obstacle is grown by.
        anew: Whether to show the clearance anew, even where that of the path suffices.
    """
    whole, row = retimed.trajectory, retimed.row
    nearer = _nearer(robot, retimed.off_path)
    left = running.min_clearance_m - nearer
    # Where obstacles move another timing meets others.
    known = running.verified and not scene.moves
    if known and left > scene.clearance and tracking.delay_s == 0.0 and not anew:
        certificate = _by_path(robot, running, whole, left)
    else:
        first = row if known else 0
        checker = checker_in_time(robot, scene, sigmas)
        part = certified_from(robot, (scene, checker), running.contacts, retimed, first, tracking=tracking)
        certificate = replace(all_of([running, part]), subject=None) if known else part
    certificate = replace(
        with_violations(certificate, rest_violations(robot, whole, {"ends": -1})),
        goal_contact=running.goal_contact,
        contacts=later(retimed, running.contacts),
        digests=Digests.of(robot, scene, whole),
    )
    return CertifiedMotion(whole, certificate, float(whole.time[row]), retimed.off_path_m, robot, scene)


def certified_from(
    robot: Robot,
    among: tuple[Scene, CoalScene],
    contacts: Sequence[FruitContact],
    retimed: Retimed,
    row: int,
    *,
    tracking: TrackingModel,
) -> Certificate:
    """What is shown of a motion along another one's path from a row on, by `certify`'s rule, at rest at its end or not.

    Args:
        among: Obstacles and the clearance to keep, and the arm among them.
        contacts: When the last link may touch fruits in the other motion; where it is there, it may here.
        tracking: Deviation of the joints that is covered.
    """
    scene, checker = among
    motion, begin_s = retimed.trajectory.since(row), float(retimed.trajectory.time[row])
    found = certify_among(
        robot,
        motion,
        stretches(checker, retimed.clock[row:], contacts),
        clearance=scene.clearance,
        tracking=tracking,
        rest_to_rest=False,
        begin_s=begin_s,
    )
    found = with_violations(found, base_violations(robot, scene, checker, motion, begin_s))
    return on_track(found, robot, scene, begin_s, motion.duration)


def _by_path(robot: Robot, running: Certificate, motion: Trajectory, left: float) -> Certificate:
    """The certificate of a motion where the clearance of its path suffices."""
    use = limit_use(robot, motion, *motion.segments)
    violations = tuple(limit_violations(use))
    nearer = running.min_clearance_m - left
    rules = tuple(rule.nearer(nearer) for rule in running.pair_rules)
    return Certificate(
        not violations, left, running.nearest, use, 0, violations,
        pair_rules=rules, uncovered_links=robot.uncovered_links,
    )  # fmt: skip


def _nearer(robot: Robot, off_path: FloatArray) -> float:
    """By how much any part of the arm may come nearer to anything with joints off by (dof,) [m]."""
    if not off_path.any():
        return 0.0
    return largest_pair_sway(robot, off_path)


def later(retimed: Retimed, contacts: Sequence[FruitContact]) -> tuple[FruitContact, ...]:
    """When the motion is where the other one may touch fruits; none of those to which it does not come."""
    found, time = [], retimed.trajectory.time
    for contact in contacts:
        inside = retimed.clock >= contact.begin_s - SAME_TIME
        rows = np.flatnonzero(inside & (retimed.clock <= contact.end_s + SAME_TIME))
        if len(rows):
            found.append(FruitContact(contact.fruit, float(time[rows[0]]), float(time[rows[-1]])))
    return tuple(found)
