"""Reported clearances of random arms, judged by Pinocchio and coal alone.

A case is a random arm and some motions between random configurations, each certified among several random sets of
obstacles, with clearances about the distances that are kept. The judge looks every `TICK_S` at all pairs that the
certificate claims: every moving body with every obstacle, and all pairs of bodies that move relative to each other,
except pairs that the certificate lists as not checked. A reported clearance above the minimum distance is a fault; so
is a bound in `pair_rules`.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from studies.harness import Asked, Row, Study
from studies.validation.arms import DrawnArm, draw_arm
from studies.validation.episodes import COUNTED, Tally
from studies.validation.judge import TICK_S, Motion, Thing, least_beside, least_own
from studies.validation.worlds import World, draw_item, obstacle

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.trajectory.trajectory import Trajectory

#: Motions of an arm, and sets of obstacles of a motion.
MOTIONS, SETS = 4, 12

#: Clearances to keep [m].
CLEARANCES = (0.0, 0.005, 0.01, 0.02, 0.03, 0.06)

#: Duration of a motion [s]; rounding of coal, and distances that need not be known [m].
DURATION_S, ROUNDING_M, WITHIN_M = 0.5, 1e-6, 0.5


def reported_clearances(seed: int, number: int) -> Tally:
    """Judge the certificates of the motions of one arm."""
    rng, tally = np.random.default_rng([seed, number]), Tally()
    with tempfile.TemporaryDirectory() as folder:
        try:
            drawn = draw_arm(Path(folder), rng)
        except HplanError as error:
            tally.refused[f"robot: {error.kind}"] += 1
            return tally
        tally.arms[drawn.kind] += 1
        for _ in range(MOTIONS):
            _among_sets(drawn, rng, tally, str(number))
    return tally


def _among_sets(drawn: DrawnArm, rng: np.random.Generator, tally: Tally, case: str) -> None:
    """One motion, free of contact with itself if one is found soon, among some sets of obstacles."""
    robot, arm = drawn.robot, drawn.arm
    for _ in range(5):
        motion = _motion(drawn, rng)
        world = World(motion.position[0], motion.position[-1])
        if _is_proved(certify(robot, world.scene(), motion, check_ends=False).violations):
            break
    clock = np.append(np.arange(0.0, DURATION_S, TICK_S), DURATION_S)
    seen = Motion(robot.joint_names, clock, motion.positions(clock))
    # Neighbours in the planar family may overlap near their joint.
    own = {
        (arm.bodies[a].link, arm.bodies[b].link, a, b): least
        for (a, b), least in least_own(arm, seen, WITHIN_M).items()
        if robot.planar is None or len(arm.between(a, b)) > 1
    }
    for count in range(SETS):
        items = [draw_item(drawn, world, rng, f"o{k}") for k in range(int(rng.integers(4)))]
        scene = world.scene().with_(obstacles=tuple(map(obstacle, items)))
        beside, clearance = math.inf, float(rng.choice(CLEARANCES))
        for _ in range(2):
            found = certify(robot, scene.with_(clearance=clearance), motion, check_ends=False)
            if not _is_proved(found.violations):
                tally.unverified["refused"] += 1
                break
            exempt = {frozenset((rule.link, rule.other)) for rule in found.pair_rules if rule.required_m is None}
            bounds = {
                frozenset((r.link, r.other)): r.clearance_m for r in found.pair_rules if r.clearance_m is not None
            }
            claimed = {key: least for key, least in own.items() if frozenset(key[:2]) not in exempt}
            reported, least = found.min_clearance_m, min((WITHIN_M, *claimed.values()))
            if beside == math.inf:
                within = max(least, min(reported, WITHIN_M), clearance)
                beside = least_beside(arm, seen, [Thing(item) for item in items], within)
            is_own, least = least <= beside, min(least, beside)
            over = [
                f"{key[0]}, {key[1]}: {distance:.6f}"
                for key, distance in claimed.items()
                if distance < min(bounds.get(frozenset(key[:2]), clearance), WITHIN_M) - ROUNDING_M
            ]
            tally.looked["own pair nearest" if is_own else "obstacle nearest"] += 1
            tally.looked_in["within 20 mm" if least < 0.02 else "within 100 mm" if least < 0.1 else "far"] += 1
            tally.ticks += len(clock)
            if over or min(reported, WITHIN_M) > least + ROUNDING_M or beside < clearance - ROUNDING_M:
                told = {"reported_m": reported, "true_m": least, "clearance_m": clearance, "beside_m": beside}
                tally.faults.append({"case": f"{case}.{count}", "kind": drawn.kind, "over": over} | told)
            clearance = float(rng.uniform(0.7, 1.02)) * min(reported, 0.1)  # about the distance that is kept


def _motion(drawn: DrawnArm, rng: np.random.Generator) -> Trajectory:
    """A part of the way between two random configurations, at rest at both ends."""
    robot = drawn.robot
    ends = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (2, robot.dof))
    part, way = np.linspace(0.0, 1.0, 11)[:, None], rng.uniform(0.05, 0.4) * (ends[1] - ends[0])
    q: FloatArray = ends[0] + (3.0 * part**2 - 2.0 * part**3) * way
    none = np.zeros_like(q)
    times = DURATION_S * part[:, 0]
    return Trajectory(
        robot.joint_names, times, q, 6.0 * part * (1.0 - part) * way / DURATION_S, none, none, robot.slides
    )


def _is_proved(violations: tuple[str, ...]) -> bool:
    """Whether the clearance is proved; limits are not looked at."""
    return not any("comes to" in line or "clearance" in line for line in violations)


def _row(asked: Asked, number: int) -> Row:
    return reported_clearances(asked.seed, number).row(number)


CLEARANCES_STUDY = Study(
    "clearances",
    "certificates of random arms: no reported clearance above the minimum distance of all claimed pairs",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
