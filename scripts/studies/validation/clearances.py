"""Reported clearances of random arms, judged by Pinocchio and coal alone.

Each motion joins two random configurations of a random chain or named robot, next to a random ball, with a clearance
drawn from `CLEARANCES`. The judge looks every `TICK_S` at all pairs that the certificate claims: every body with the
ball, and all pairs of bodies that move relative to each other, except pairs that the certificate lists as not checked.
A reported clearance above the minimum distance is a fault; so is a bound in `pair_rules`.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

import numpy as np
from studies.harness import Asked, Row, Study
from studies.outside import things_of
from studies.validation.arms import draw_arm
from studies.validation.judge import TICK_S, Motion

from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.trajectory.trajectory import Trajectory

#: Clearances to keep [m].
CLEARANCES = (0.0, 0.005, 0.01, 0.02, 0.03, 0.06)

#: Duration of a motion [s]; how far the judge's distances may be off [m].
DURATION_S, ROUNDING_M = 0.5, 1e-6


def reported_clearance(seed: int, number: int) -> Row:
    """Judge the certificate of one motion."""
    rng = np.random.default_rng([seed, number])
    with tempfile.TemporaryDirectory() as folder:
        while True:
            try:
                drawn = draw_arm(Path(folder), rng)
            except HplanError:
                continue
            if drawn.robot.planar is None:
                break
    robot, arm = drawn.robot, drawn.arm
    ends = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (2, robot.dof))
    part = np.linspace(0.0, 1.0, 11)[:, None]
    q = ends[0] + (3.0 * part**2 - 2.0 * part**3) * 0.4 * (ends[1] - ends[0])
    v = 6.0 * part * (1.0 - part) * 0.4 * (ends[1] - ends[0]) / DURATION_S
    none = np.zeros_like(q)
    motion = Trajectory(robot.joint_names, DURATION_S * part[:, 0], q, v, none, none, robot.slides)
    tip = robot.tool_positions(q[5])
    ball = Sphere(name="ball", center=tip + rng.normal(size=3) * 0.4, radius=rng.uniform(0.02, 0.1))
    clearance = float(rng.choice(CLEARANCES))
    start, goal = Start(joints_rad=q[0]), Goal(joints_rad=q[-1])
    scene = Scene(name="any", start=start, goal=goal, obstacles=(ball,), clearance=clearance)
    found = certify(robot, scene, motion, check_ends=False)
    is_proved = not any("comes to" in line or "clearance" in line for line in found.violations)
    if not is_proved:
        return {"kind": drawn.kind, "proved": False, "fault": False}
    exempt = {frozenset((rule.link, rule.other)) for rule in found.pair_rules if rule.required_m is None}
    bounds = {frozenset((r.link, r.other)): r.clearance_m for r in found.pair_rules if r.clearance_m is not None}
    pairs = [
        (a, b) for a, b in itertools.combinations(range(len(arm.bodies)), 2)
        if arm.between(a, b) and frozenset((arm.bodies[a].link, arm.bodies[b].link)) not in exempt
    ]  # fmt: skip
    (thing,) = things_of(scene)
    clock = np.append(np.arange(0.0, DURATION_S, TICK_S), DURATION_S)
    values = Motion(robot.joint_names, clock, motion.positions(clock)).values
    moving = [number for number, fixed in enumerate(arm.standing) if not fixed]
    least, over = np.inf, 0
    for each in arm.configurations(robot.joint_names, values):
        places = arm.places(each)
        least = min(least, *(arm.apart(k, places[k], thing, thing.place, least) for k in moving))
        for a, b in pairs:
            bound = bounds.get(frozenset((arm.bodies[a].link, arm.bodies[b].link)), clearance)
            distance = arm.own((a, b), places, max(least, bound))
            least, over = min(least, distance), over + (distance < bound - ROUNDING_M)
    too_large = found.min_clearance_m > least + ROUNDING_M
    return {
        "kind": drawn.kind,
        "proved": True,
        "pairs": len(pairs),
        "reported_mm": 1e3 * found.min_clearance_m,
        "true_mm": 1e3 * least,
        "fault": bool(too_large or over),
    }


def _row(asked: Asked, number: int) -> Row:
    return {"name": str(number), **reported_clearance(asked.seed, number)}


CLEARANCES_STUDY = Study(
    "clearances",
    "certificates of random arms: no reported clearance above the minimum distance of all claimed pairs",
    _row,
    ("certificates",),
    totals=("proved", "fault"),
    count=(20, 1),
    warm=0,
)
