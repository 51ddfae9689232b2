"""Obstacles put where a motion grazes them, which must not be verified, or is clear of them, which must be."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from studies.harness import Asked, Row, Study
from studies.validation.arms import NAMED, DrawnArm, draw_arm, given_arm
from studies.validation.episodes import COUNTED, Tally, impatient, warm_up
from studies.validation.judge import STANDS_M, Motion, Thing, distance
from studies.validation.random_scenes import direction
from studies.validation.worlds import World, draw_ends, obstacle

from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import write_csv

#: Depth of grazing and gap of clear obstacles [m]; radius that they begin with.
DEPTHS, GAPS, THIN = (1e-4, 5e-3), (1e-3, 5e-3), 1e-3


def graze(seed: int, number: int, robot: Robot | None = None) -> Tally:
    """One motion of a random arm, or of one robot, among nothing, and obstacles put beside it."""
    warm_up()
    rng, tally = np.random.default_rng([seed, number, 9]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn = draw_arm(Path(name), rng) if robot is None else given_arm(robot)
            ends = draw_ends(drawn, rng, 0.01)
            if ends is None:
                return tally
            tally.arms[drawn.kind] += 1
            world = World(*ends)
            found = Planner(drawn.robot, world.scene(), PlanOptions(effort="quick")).plan(cancel=impatient())
        except HplanError as error:
            tally.refused[error.kind] += 1
            return tally
        motion = Motion.read(write_csv(found.trajectory, Path(name) / "motion.csv"))
        for count in range(4):
            # Links of the planar family stand for capsules, and meshes for convex pieces, which are wider.
            grazes = count % 2 == 0 or drawn.robot.planar is not None or robot is not None or drawn.kind in NAMED
            gap = -math.exp(rng.uniform(*np.log(DEPTHS))) if grazes else math.exp(rng.uniform(*np.log(GAPS)))
            made = placed(drawn, motion, rng, gap)
            if made is None:
                continue
            item, body = made
            scene = world.scene().with_(obstacles=(obstacle(item),))
            verified = certify(drawn.robot, scene, found.trajectory).verified
            tally.looked["grazing" if grazes else "clear"] += 1
            if verified == grazes:
                tally.faults.append({"case": str(number), "kind": "grazing", "gap_m": gap, "body": body, "item": item})
    return tally


def placed(drawn: DrawnArm, motion: Motion, rng: np.random.Generator, gap: float) -> tuple[dict[str, Any], str] | None:
    """An obstacle whose least distance from the arm over a motion is the one asked for, and the nearest body."""
    arm = drawn.arm
    q = arm.configurations(motion.names, motion.values)
    places = [arm.places(each) for each in q[::2]]
    k = int(rng.choice([k for k, fixed in enumerate(arm.standing) if not fixed]))
    at = places[int(rng.integers(len(places)))][k].act(arm.bodies[k].middle)
    centre = at + direction(rng) * (arm.bodies[k].radius * rng.uniform(0.2, 1.0) + 0.05)
    end = centre + direction(rng) * rng.uniform(0.05, 0.4) * float(rng.integers(2))
    item: dict[str, Any] = {"name": "drawn", "kind": "sphere", "center": centre.tolist(), "radius": THIN}
    if (end != centre).any():
        item = {"name": "drawn", "kind": "capsule", "from": centre.tolist(), "to": end.tolist(), "radius": THIN}
    thing = Thing(item)
    least, nearest = min(_least(body.shape, [row[j] for row in places], thing, j) for j, body in enumerate(arm.bodies))
    item["radius"] = THIN + least - gap
    of_turret = arm.bodies[nearest].joint <= 1 and -gap <= STANDS_M  # it may stand in something so deep
    if least < 0.005 or not 0.008 < item["radius"] < 0.4 or arm.standing[nearest] or of_turret:
        return None
    return item, arm.bodies[nearest].name


def _least(shape: Any, places: list[pin.SE3], thing: Thing, number: int) -> tuple[float, int]:
    return min(distance(shape, place, thing.shape, thing.place) for place in places), number


def _row(asked: Asked, number: int) -> Row:
    return graze(asked.seed, number, asked.robot).row(number)


GRAZING = Study(
    "grazing",
    "obstacles put 0.1 to 5 mm into a motion's way, which must not be verified, or 1 to 5 mm beside it, which must be",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
