"""Certified motions by IPOPT: nonlinear programs in turn, each from the last one's motion, until no row is saved.

What it finds is taken to rows, slowed down to a whole number of them, and counts only if hplan's certificate verifies
these rows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from studies.benchmark.fastest.transcription import OfflineProblem, fastest
from studies.benchmark.motions import of_rows
from studies.benchmark.paths import PeerTask, limits_of

from hplan.base.arrays import FloatArray
from hplan.optimization.timed_spline import RESTING, TimedSpline, breaks_at_rows
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify

#: Rows per second of its motions, and rows of a piece; pieces are longer where there would be more than so many.
RATE_HZ, ROWS_EACH, MOST_PIECES = 250.0, 3, 200

#: Rows of the shortest motions that are looked at.
FEWEST = 30

#: Clearance asked for at the places looked at, tried in turn until the rows are certified [m].
MARGINS = (1e-4, 3e-4, 1e-3)

#: Programs in turn, at most; no more are solved where one is faster than the last by less than this part and saves no
#: row.
PROGRAMS, GAIN = 5, 5e-4

#: Starts at most, and how much slower than the fastest of them a start may be.
STARTS, SLOWER = 2, 1.15

#: Starts whose durations differ by less than this part are taken for the same motion.
SAME = 5e-3


def optimized(robot: Robot, scene: Scene, starts: Sequence[Trajectory]) -> Trajectory | None:
    """The fastest certified motion that IPOPT finds near some; None where it finds none.

    Args:
        robot: The arm.
        scene: Balls and capsules, start and goal.
        starts: Motions to begin with.

    Raises:
        InputError: CasADi is not installed.
    """
    task = PeerTask.of(robot, scene)
    found = [motion for start in distinct(starts) if (motion := _near(task, start)) is not None]
    return min(found, key=lambda motion: motion.duration, default=None)


def distinct(starts: Sequence[Trajectory]) -> list[Trajectory]:
    """The fastest few of some motions, those of about the same duration once."""
    kept: list[Trajectory] = []
    for start in sorted(starts, key=lambda motion: motion.duration):
        if not kept or kept[-1].duration * (1.0 + SAME) < start.duration < SLOWER * kept[0].duration:
            kept.append(start)
    return kept[:STARTS]


def _near(task: PeerTask, start: Trajectory) -> Trajectory | None:
    """The fastest certified motion near one; None where none is found."""
    rows = max(FEWEST, round(start.duration * RATE_HZ))
    spline = TimedSpline.near(of_rows(start).positions, _breaks(rows))
    best: Trajectory | None = None
    for margin in MARGINS:
        verified = False
        for found, meets_rows in _programs(_problem(task, margin), spline, rows):
            motion = found.trajectory(task.robot.dynamics, RATE_HZ)
            if best is not None and best.duration <= motion.duration:
                continue
            is_verified = certify(task.robot, task.scene, motion, checker=task.checker).verified
            best = motion if is_verified else best
            verified = is_verified if meets_rows else verified
        if verified:
            break
    return best


def _programs(problem: OfflineProblem, start: TimedSpline, rows: int) -> Iterator[tuple[TimedSpline, bool]]:
    """Motions of programs, each from the last, of whole numbers of rows; and whether their pieces meet at rows.

    They do where that is the number of rows that the program was made for; else the rows are only near the motion.
    """
    before, spline = math.inf, start
    for _ in range(PROGRAMS):
        found = fastest(problem, spline)
        if found is None:
            return
        needed = max(FEWEST, math.ceil(found.duration * RATE_HZ - 1e-6))
        slower = found.at_pace(needed / RATE_HZ / found.duration)
        if needed <= rows:
            yield found.at_pace(rows / RATE_HZ / found.duration), True
        if needed != rows:
            yield slower, False
        if needed >= rows and found.duration > (1.0 - GAIN) * before:
            return
        before, rows = found.duration, needed
        spline = TimedSpline.near(slower.path.evaluate, _breaks(rows))


def _breaks(rows: int) -> FloatArray:
    """Times at which pieces of a motion of so many rows meet [s]."""
    return breaks_at_rows(rows, min(max(rows // ROWS_EACH, 2 * RESTING), MOST_PIECES), RATE_HZ)


def _problem(task: PeerTask, margin: float) -> OfflineProblem:
    asked = task.problem
    limits = limits_of(task.robot)
    return OfflineProblem(task.robot, task.field, limits, asked.movable, asked.lower, asked.upper, margin)
