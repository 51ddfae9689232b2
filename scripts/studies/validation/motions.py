"""Certified motions of random arms compared with Pinocchio and coal on everything that the URDF describes.

Three questions, each with motions drawn at random:

- *certified*: random members of the family among obstacles of all kinds; of no motion that `plan` certifies does any
  body touch an obstacle or another body, looked at every millisecond of the exported rows;
- *grazing*: an obstacle is put where some moving body penetrates it by 0.1 to 5 mm at some instant of a certified
  motion; `certify` must not verify it. What carries the turret is none: an obstacle in which a body of the turret
  stands at every yaw, by 1 mm at most;
- *clear*: an obstacle is put where everything keeps 1 to 5 mm from it; `certify` must verify it. Everything is: links
  as capsules along their axes as wide as `PlanarArm.half_widths` says, which hold what is fixed to them, all other
  bodies by their own shapes. The least distance over the motion, looked at every millisecond, is the gap.

Where an obstacle's place is found by distances, it is a ball or a capsule that is at first thin and near the body that
it is to graze; it is then made as thick as makes the least distance that asked for, whichever body and instant that is
at. Boxes are moved along the direction of the least distance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from studies.validation.member_motions import MemberMotions, MotionCounts
from studies.validation.members import write_member

from hplan.errors import HplanError
from hplan.robot.model import Robot, load_robot

#: Members of the family; certified motions, grazing and clear obstacles of all of them together, in full.
MEMBERS, MOTIONS, GRAZING = 20, 1000, 300

#: Where a member gives too few, as it touches itself nearly everywhere, another is drawn, up to so many in all.
REDRAWN = 4


def validate_motions(
    *,
    members: int = MEMBERS,
    motions: int = MOTIONS,
    grazing: int = GRAZING,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[int, MotionCounts], None] = lambda *_: None,
) -> MotionCounts:
    """Draw members and motions, and count.

    Args:
        members: Members of the family.
        motions: Certified motions to look at, of all members together.
        grazing: Grazing obstacles, and as many clear ones.
        seed: Seed of all random numbers; the same whatever the number of jobs.
        jobs: Processes.
        progress: Told how many members are done, and the count so far.
    """
    parts = [(seed, k, _part(motions, members, k), _part(grazing, members, k)) for k in range(members)]
    total = MotionCounts()
    for done, tally in enumerate(_each(parts, jobs)):
        total.add(tally)
        progress(done + 1, total)
    return total


def _part(total: int, parts: int, part: int) -> int:
    return (part + 1) * total // parts - part * total // parts


def _each(parts: Sequence[tuple[int, int, int, int]], jobs: int) -> Iterator[MotionCounts]:
    if jobs == 1:
        yield from map(_of_member, parts)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_of_member, parts)


def _of_member(part: tuple[int, int, int, int]) -> MotionCounts:
    """One member of the family; every other one has offsets."""
    seed, number, motions, grazing = part
    rng, tally = np.random.default_rng([seed, number]), MotionCounts()
    with TemporaryDirectory() as name:
        folder = Path(name)
        for _ in range(REDRAWN):
            robot = _loaded(folder, rng, tally, offsets=number % 2 == 1)
            member = MemberMotions(robot, folder, rng, tally, f"{seed}/{number}")
            member.certified_motions(motions - tally.certified)
            member.grazing_motions(grazing - tally.grazing, grazing - tally.clear)
            if (tally.certified, tally.grazing, tally.clear) == (motions, grazing, grazing):
                break
    return tally


def _loaded(folder: Path, rng: np.random.Generator, tally: MotionCounts, *, offsets: bool) -> Robot:
    """A member that can be loaded."""
    while True:
        path = write_member(folder, rng, offsets=offsets)
        try:
            robot = load_robot(path)
        except HplanError as error:
            tally.members[error.kind] += 1
            continue
        kind = f"{robot.arm.link_count} links{', yaw' if robot.has_yaw else ''}{', offsets' if offsets else ''}"
        tally.members[kind] += 1
        return robot
