"""Random scenes of any arm: what a straight motion, OMPL's RRTConnect and hplan make of them, and contacts by coal.

RRTConnect has 5 s of CPU time, asks hplan's compiled distances at a fine resolution, and at a finer one where coal
finds its path in contact, which is looked at every `EVERY_RAD`; a scene is solved where coal finds none. Motions of
hplan are looked at every millisecond.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from studies.benchmark.arm_scenes import random_scene
from studies.benchmark.measure import spread
from studies.benchmark.motions import TimedMotion
from studies.benchmark.ompl_paths import ompl_path
from studies.benchmark.outside_check import OutsideCheck, of_scene

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
from hplan.problem.world import World
from hplan.robot.model import Robot

#: Distances between configurations that OMPL checks, one after the other, as fractions of the space's extent.
FINE = (0.002, 0.0005)

#: Paths are looked at from outside so often, by the joint that turns farthest [rad].
EVERY_RAD = 5e-3


@dataclass(frozen=True)
class Attempt:
    """One scene.

    Attributes:
        number: Its number.
        straight: Whether the straight motion touches nothing.
        waypoints: How many RRTConnect's path has; 0 where it found none.
        path_clear: Whether that touches nothing.
        path_s: CPU time to the path, simplified, or until time was up [s].
        origin: Where the path of hplan's motion comes from, or the kind of refusal.
        seconds: CPU time from the scene to the certified motion, or to the refusal [s].
        duration_s: Duration of the motion; None without one [s].
        verified: Whether the motion is certified.
        contacts: Configurations at which the motion touches an obstacle, and the robot itself.
    """

    number: int
    straight: bool
    waypoints: int
    path_clear: bool
    path_s: float
    origin: str
    seconds: float
    duration_s: float | None = None
    verified: bool = False
    contacts: tuple[int, int] = (0, 0)

    @property
    def peer_solved(self) -> bool:
        """True if RRTConnect has a path that touches nothing."""
        return self.waypoints > 0 and self.path_clear


def attempts(robot: Robot, numbers: Sequence[int], options: PlanOptions, seed: int) -> Iterator[Attempt]:
    """Each scene solved by both; kernels are loaded before, and OMPL is seeded.

    Args:
        robot: The arm.
        numbers: Of the scenes (`random_scene`).
        options: How to plan.
        seed: Of the scenes.
    """
    with suppress(HplanError):
        plan(robot, random_scene(robot, seed, 1), options)
    for number in numbers:
        yield _attempt(robot, number, options, seed)


def _attempt(robot: Robot, number: int, options: PlanOptions, seed: int) -> Attempt:
    scene = random_scene(robot, seed, number)
    check, goal = OutsideCheck(robot, *of_scene(scene.obstacles)), scene.goal.configuration
    straight = _is_clear(check, np.array([scene.start.configuration, goal]))
    peer, path_s = (0, False), 0.0
    for resolution in FINE:
        began = time.process_time()
        path = ompl_path(World.of(robot, scene.solids_with_goal), scene, goal, resolution)
        path_s += time.process_time() - began
        peer = (0, False) if path is None else (len(path), _is_clear(check, path))
        if path is None or peer[1]:
            break
    began = time.process_time()
    try:
        found = plan(robot, scene, options)
    except HplanError as error:
        return Attempt(number, straight, *peer, path_s, type(error).__name__, time.process_time() - began)
    seconds, motion = time.process_time() - began, TimedMotion(found.trajectory.duration, found.trajectory.positions)
    touched, verified = check.contacts(motion), found.certificate.verified
    return Attempt(number, straight, *peer, path_s, found.motion.origin, seconds, motion.duration, verified, touched)


def _is_clear(check: OutsideCheck, path: FloatArray) -> bool:
    """Whether straight motions between the waypoints of a path touch nothing."""
    for first, last in itertools.pairwise(path):
        steps = max(2, int(np.ceil(np.abs(last - first).max() / EVERY_RAD)) + 1)
        if any(touched.any() for touched in check.touched(np.linspace(first, last, steps))):
            return False
    return True


def table(rows: Sequence[Attempt]) -> list[str]:
    """Lines: how many are solved by whom, missed, certified, in contact; times."""
    solved = [row for row in rows if row.duration_s is not None]
    peers = [row for row in rows if row.peer_solved]
    missed = [row.number for row in peers if not row.verified]
    times, theirs = (spread([1e3 * value for value in values]) for values in (
        [row.seconds for row in rows], [row.path_s for row in peers]))  # fmt: skip
    return [
        f"scenes: {len(rows)}; the straight motion is clear in {sum(row.straight for row in rows)}",
        f"RRTConnect, 5 s: {sum(row.waypoints > 0 for row in rows)} paths, {len(peers)} of them touch nothing; "
        f"median {theirs['median']:.0f} ms, 95 % {theirs['p95']:.0f} ms",
        f"hplan: {len(solved)} motions, {sum(row.verified for row in rows)} certified; without one of those that "
        f"RRTConnect solves: {len(missed)} {missed or ''}",
        f"hplan: median {times['median']:.0f} ms, 95 % {times['p95']:.0f} ms, max {times['max']:.0f} ms",
        f"motions in contact: {sum(row.contacts[0] > 0 for row in solved)} with an obstacle, "
        f"{sum(row.contacts[1] > 0 for row in solved)} with the robot itself",
        "by hplan alone: " + str([row.number for row in rows if row.verified and not row.peer_solved] or "none"),
        "by nobody: " + str([row.number for row in rows if not row.verified and not row.peer_solved] or "none"),
        "refusals: " + (", ".join(sorted({row.origin for row in rows if row.duration_s is None})) or "none"),
    ]
