"""Certificate of a retimed motion: clearance from its path, limits proved anew.

A retimed motion (`hplan.trajectory.time_scaling`) deviates from the certified path by a bounded fraction of a
millimetre, which is subtracted from the certified clearance. If the rest does not suffice, the clearance is proved
anew. It is also proved anew if it depends on the timing: if obstacles move, or if tracking errors grow with velocity.
Velocity, acceleration and torque are always checked anew.
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
from hplan.certificate.limit_use import LimitUse, limit_use
from hplan.certificate.motion_bound import largest_pair_sway
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.certificate.tool_bounds import tilt_violations, tool_bounds
from hplan.collision.coal_scene import CoalScene
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.robot.upright import UprightTool
from hplan.scene.model import Scene
from hplan.scene.obstacle_kind import Sigmas
from hplan.trajectory.trajectory import SAME_TIME, Retimed, Trajectory


@dataclass(frozen=True, eq=False)
class CertifiedMotion(Record, InNotebook):
    """A retimed motion along the path of another motion, with its certificate.

    Attributes:
        trajectory: The retimed motion; up to `parts_s` both motions have the same clock.
        certificate: Its certificate.
        parts_s: Time until which both motions have the same timing [s].
        off_path_m: Upper bound of the arm's distance from the other motion's path [m].
        robot: The arm.
        scene: The scene in which it is certified.
        clock: (samples,) time of each sample in the other motion, from its start [s].
        begins_s: Start time of both motions on the controller's clock [s].
    """

    trajectory: Trajectory
    certificate: Certificate
    parts_s: float
    off_path_m: float
    robot: Robot
    scene: Scene
    clock: FloatArray
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
    """Certify a retimed motion.

    Args:
        scene: The scene in which the other motion is certified.
        tracking: Model of the covered joint deviations.
        sigmas: Growth of an obstacle in standard deviations of its position.
        anew: Whether to prove the clearance anew, even if the clearance of the path suffices.
    """
    whole, row = retimed.trajectory, retimed.row
    nearer = _clearance_loss(robot, retimed.off_path)
    left = running.min_clearance_m - nearer
    # If obstacles move, the proof depends on the timing.
    known = running.verified and not scene.moves
    if known and left > scene.clearance and tracking.delay_s == 0.0 and not anew:
        certificate = _by_path(robot, running, retimed, left, (UprightTool.of_scene(robot, scene), tracking))
    else:
        first = row if known else 0
        checker = checker_in_time(robot, scene, sigmas)
        part = certified_from(robot, (scene, checker), running.contacts, retimed, first, tracking=tracking)
        certificate = replace(all_of([running, part]), subject=None) if known else part
    certificate = replace(
        with_violations(certificate, rest_violations(robot, whole, {"ends": -1})),
        goal_contact=running.goal_contact,
        contacts=map_to_retimed(retimed, running.contacts),
        digests=Digests(robot, scene, whole),
    )
    return CertifiedMotion(whole, certificate, float(whole.time[row]), retimed.off_path_m, robot, scene, retimed.clock)


def certified_from(
    robot: Robot,
    among: tuple[Scene, CoalScene],
    contacts: Sequence[FruitContact],
    retimed: Retimed,
    row: int,
    *,
    tracking: TrackingModel,
    measured: bool = True,
) -> Certificate:
    """Certify a retimed motion from a sample on, as `certify` does.

    Rest at its ends is not required.

    Args:
        among: The scene, with obstacles and required clearance, and its collision checker.
        contacts: Time windows in which the last link may touch fruits, on the clock of the other motion; the same
            parts of the path are allowed here.
        tracking: Model of the covered joint deviations.
        measured: Whether the minimum distance is searched if the clearance is not proved, as for `certify_among`.
    """
    scene, checker = among
    motion, begin_s = retimed.trajectory.cut_before(row), float(retimed.trajectory.time[row])
    found = certify_among(
        robot,
        motion,
        stretches(checker, retimed.clock[row:], contacts, retimed.trajectory.time[row:]),
        clearance=scene.clearance,
        tracking=tracking,
        rest_to_rest=False,
        begin_s=begin_s,
        measured=measured,
    )
    found = with_violations(found, base_violations(robot, checker, motion, begin_s))
    return on_track(found, robot, scene, begin_s, motion.duration)


def _by_path(
    robot: Robot,
    running: Certificate,
    retimed: Retimed,
    left: float,
    tool: tuple[UprightTool | None, TrackingModel],
) -> Certificate:
    """Certificate of a motion with the clearance `left` from its path [m].

    Before the sample where the motions part, the use of the limits is that of the path's motion. `tool` has the axis
    that stays upright, or None, and the tracking errors.
    """
    motion, use, (upright, tracking), tilt = retimed.trajectory, running.limit_use, tool, None
    if retimed.row < motion.samples - 1:
        part = motion.cut_before(retimed.row)
        use = LimitUse.largest([use, limit_use(robot, part, *part.segments)])
    violations = tuple(limit_violations(use))
    if upright is not None:
        tilt = tool_bounds(robot, motion, upright, tracking).tilt_rad
        violations += tuple(tilt_violations(upright, tilt))
    nearer = running.min_clearance_m - left
    rules = tuple(rule.lower_by(nearer) for rule in running.pair_rules)
    return Certificate(
        not violations, left, running.nearest, use, 0, violations,
        pair_rules=rules, uncovered_links=robot.uncovered_links, max_tilt_rad=tilt,
    )  # fmt: skip


def _clearance_loss(robot: Robot, off_path: FloatArray) -> float:
    """Upper bound on the clearance lost by joint errors (dof,) [m]."""
    if not off_path.any():
        return 0.0
    return largest_pair_sway(robot, off_path)


def map_to_retimed(retimed: Retimed, contacts: Sequence[FruitContact]) -> tuple[FruitContact, ...]:
    """Contact windows of the other motion, mapped to the retimed motion's clock.

    Windows that the retimed motion does not reach are dropped.
    """
    found, time = [], retimed.trajectory.time
    for contact in contacts:
        inside = retimed.clock >= contact.begin_s - SAME_TIME
        rows = np.flatnonzero(inside & (retimed.clock <= contact.end_s + SAME_TIME))
        if len(rows):
            found.append(FruitContact(contact.fruit, float(time[rows[0]]), float(time[rows[-1]])))
    return tuple(found)
