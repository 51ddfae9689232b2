"""How the problems of the set were chosen; run once, as their best known durations hold for them alone.

python -m studies.benchmark.fastest.draw TREES FILE

In each the straight motion is in contact, and hplan finds a certified one: discs in the plane of the default arm
(joints 0 to 90 degrees) and of the orchard arm (wide ranges), pinches for both and for arms drawn at random, all with
the base locked; and measured trees, one at a time, with all joints, mostly for the orchard arm.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import numpy as np
from studies.benchmark.fastest.problems import digest_of, made_from
from studies.benchmark.fastest.records import DiscSource, PinchSource, Record, Source, TreeSource, write_records
from studies.benchmark.narrow.scenes import ARMS, ROOMS
from studies.benchmark.orchard_scenes import crop_of, measured_orchards

from hplan.collision.clearance_field import ClearanceField
from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene

#: How many problems of each kind.
DISCS = {"harvester": 40, "orchard_harvester": 40}
PINCHES = 20
TREES = {"orchard_harvester": 80, "harvester": 20}

#: Clearance at start and goal [m], and places of the straight motion that are looked at.
SPARE, PLACES = 1e-3, 400


def draw(trees: Path) -> Iterator[Record]:
    """All problems, with the durations of hplan's motions by default.

    Args:
        trees: Folder of measured trees.
    """
    for arm, most in DISCS.items():
        yield from _first(_planar([DiscSource(arm, number) for number in range(20 * most)], "discs"), most)
    pinches = (PinchSource(ARMS[n % 3], n, ROOMS[n // 3 % len(ROOMS)]) for n in count())
    yield from _first(_planar(pinches, "pinch"), PINCHES)
    for arm, most in TREES.items():
        yield from _among_trees(arm, trees, most)


def _planar(sources: object, kind: str) -> Iterator[Record]:
    for source in sources:  # type: ignore[attr-defined]
        record = _record(f"{kind} {source.number}, {source.arm}", source, None)
        if record is not None:
            yield record


def _first(records: Iterator[Record], most: int) -> Iterator[Record]:
    for _, record in zip(range(most), records, strict=False):
        yield record


def _among_trees(arm: str, trees: Path, most: int) -> Iterator[Record]:
    """So many problems, evenly spread over those whose straight motion is in contact."""
    robot = load_robot(arm)
    blocked = []
    for orchard in measured_orchards(robot, trees):
        tree, distance = orchard.name.removesuffix(" m").split(" at ")
        for problem in crop_of(robot, orchard).problems():
            if is_blocked(robot, problem.scene):
                ends = problem.scene.start.configuration, problem.scene.goal.configuration
                start, goal = (tuple(q.tolist()) for q in ends)
                blocked.append((f"{problem.name}, {arm}", TreeSource(arm, tree, float(distance), start, goal)))
    taken: set[int] = set()
    for place in range(most):
        wanted = (2 * place + 1) * len(blocked) // (2 * most)
        for number in sorted(set(range(len(blocked))) - taken, key=lambda n: (abs(n - wanted), n)):
            taken.add(number)
            record = _record(*blocked[number], trees)
            if record is not None:
                yield record
                break


def _record(name: str, source: Source, trees: Path | None) -> Record | None:
    """The problem, if it is blocked and hplan solves it."""
    robot, scene = made_from(source, name, trees)
    if not is_blocked(robot, scene):
        return None
    try:
        found = plan(robot, scene)
    except HplanError:
        return None
    if not found.certificate.verified:
        return None
    return Record(name, source, digest_of(robot, scene), found.trajectory.duration, "default")


def is_blocked(robot: Robot, scene: Scene) -> bool:
    """True if the straight motion is in contact, and its ends have clearance to spare."""
    field = ClearanceField.of(robot, scene.solids_with_goal, clearance=scene.clearance)
    ends = scene.start.configuration, scene.goal.configuration
    if min(field.clearance(q) for q in ends) < SPARE:
        return False
    straight = ends[0] + np.linspace(0.0, 1.0, PLACES)[:, None] * (ends[1] - ends[0])
    return any(field.clearance(q) < 0.0 for q in straight)


if __name__ == "__main__":
    write_records(draw(Path(sys.argv[1])), Path(sys.argv[2]))
