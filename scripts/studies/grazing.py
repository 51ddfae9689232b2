"""Obstacles that certified motions of any arm graze by 0.1 to 5 mm, or pass with 0.3 mm to spare: are they verified?

A motion is planned between two random free configurations. A ball, a capsule and a box are put near a point of a moving
body at an instant of it; then the ball and the capsule are made as thick, and the box is moved to where, the least
distance over the whole motion, as coal measures it, is the one that was drawn.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from studies.arms import free_ends, reach_of, scene_between
from studies.harness import Asked, Row, Study
from studies.measure import or_error
from studies.outside import EVERY_S, OutsideCheck, times_until

from hplan.base.arrays import FloatArray
from hplan.bodies.collision_bodies import collision_bodies
from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.timing.trajectory import Trajectory
from hplan.verification.certificate import certify

#: Depths of grazing, and the gap of obstacles that are passed [m].
DEPTHS, GAP = (1e-4, 5e-3), 3e-4

#: How near to the depth or gap that was drawn a box has to come, as a part of it.
NEAR = 0.2

#: Thinnest ball or capsule [m].
THINNEST = 5e-3

#: About the least distance of all milliseconds the motion is looked at so many times within one.
FINER = 40


class _Case(NamedTuple):
    """What is put near a motion, and which of its draws this is."""

    kind: str
    passed: bool
    number: int


def _cases(asked: Asked) -> Iterable[_Case]:
    kinds = ("sphere", "capsule", "box")
    return [_Case(kinds[number % 3], passed, number) for number in asked.numbers for passed in (False, True)]


def _grazed(asked: Asked, case: _Case) -> Row:
    """An obstacle that a certified motion grazes, or passes: whether the motion is certified with it."""
    robot = asked.arm()
    rng = np.random.default_rng([asked.seed, case.number, case.passed, 10**6])
    extent = reach_of(robot, rng)
    while True:
        ends = free_ends(robot, rng, (), extent)
        if ends is None:
            continue
        empty = scene_between("grazing", *ends, ())
        result = or_error(lambda empty=empty: plan(robot, empty))  # type: ignore[misc]
        if isinstance(result, HplanError):
            continue
        motion, spare = result.trajectory, GAP if case.passed else -rng.uniform(*DEPTHS)
        found = _placed_near(robot, rng, motion, case.kind, spare)
        if found is None:
            continue
        certificate = certify(robot, scene_between("grazing", *ends, (found[0],)), motion)
        return {
            "name": f"{case.kind} {case.number}",
            "how": "passed with 0.3 mm to spare" if case.passed else "grazed by 0.1 to 5 mm",
            "spare_mm": 1e3 * found[1],
            "verified": certificate.verified,
            "named": any("'it'" in line for line in certificate.violations),
            "fault": certificate.verified and not case.passed,
        }


def _placed_near(
    robot: Robot, rng: np.random.Generator, motion: Trajectory, kind: str, spare: float
) -> tuple[Sphere | Capsule | Box, float] | None:
    """An obstacle whose least distance from the arm is about that asked for, and that distance; None without one."""
    point, away = _near_the_arm(robot, rng, motion)
    if kind == "box":
        return _moved_box(robot, rng, motion, (point, away), spare)
    thin = _rounded(rng, kind, point + away * rng.uniform(0.05, 0.2), THINNEST, rng.normal(size=3))
    distance = _least(robot, motion, thin)
    if distance - spare < 1e-4:
        return None
    thick = thin.model_copy(update={"radius": THINNEST + distance - spare})
    least = _least(robot, motion, thick)
    return (thick, least) if abs(least - spare) < NEAR * abs(spare) else None


def _rounded(
    rng: np.random.Generator, kind: str, center: FloatArray, radius: float, along: FloatArray
) -> Sphere | Capsule:
    """A ball, or a capsule along a direction."""
    if kind == "sphere":
        return Sphere(name="it", center=tuple(center.tolist()), radius=radius)
    half = along / np.linalg.norm(along) * rng.uniform(0.05, 0.3)
    ends = {"from": tuple((center - half).tolist()), "to": tuple((center + half).tolist())}
    return Capsule.model_validate({"name": "it", "radius": radius, **ends})


def _moved_box(
    robot: Robot, rng: np.random.Generator, motion: Trajectory, near: tuple[FloatArray, FloatArray], spare: float
) -> tuple[Box, float] | None:
    """A box pushed towards a point of the arm, or away from it, until the distance is right."""
    point, away = near
    size, turned = tuple(rng.uniform(0.03, 0.2, 3).tolist()), tuple(rng.uniform(-90.0, 90.0, 3).tolist())
    back, low, high = 0.3, 0.0, 1.0
    for _ in range(30):
        box = Box(name="it", center=tuple((point + back * away).tolist()), size=size, rpy_deg=turned)
        least = _least(robot, motion, box)
        if abs(least - spare) < NEAR * abs(spare):
            return box, least
        low, high = (back, high) if least < spare else (low, back)
        # Nothing comes nearer to the arm by more than it is moved.
        back = (
            max(low, back - (least - spare)) if least > spare else min(0.5 * (low + high), back + 2.0 * (spare - least))
        )
        if high - low < 1e-6:
            return None
    return None


def _near_the_arm(robot: Robot, rng: np.random.Generator, motion: Trajectory) -> tuple[FloatArray, FloatArray]:
    """(3,) a point of a moving body at an instant of a motion, and (3,) a direction."""
    bodies = [body for body in collision_bodies(robot) if body.joint >= 0]
    body, away = bodies[rng.integers(len(bodies))], rng.normal(size=3)
    q = motion.positions(np.array([rng.uniform(0.0, motion.duration)]))[0]
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return data.oMi[body.joint + 1].act(body.core.mean(axis=0)), away / np.linalg.norm(away)


def _least(robot: Robot, motion: Trajectory, obstacle: Sphere | Capsule | Box) -> float:
    """Least distance of the arm from an obstacle over a motion [m]."""
    check = OutsideCheck(robot, [obstacle])
    clock = times_until(motion.duration, EVERY_S)
    at = float(clock[int(np.argmin([check.distance(q) for q in motion.positions(clock)]))])
    finer = np.clip(at + np.linspace(-EVERY_S, EVERY_S, 2 * FINER + 1), 0.0, motion.duration)
    return min(check.distance(q) for q in motion.positions(finer))


GRAZING = Study(
    "grazing",
    "obstacles that certified motions of any arm (--robot) graze, of which none may be verified, or pass",
    _grazed,
    ("verified", "named", "spare_mm"),
    problems=_cases,
    by="how",
    count=(300, 3),
    needs=("robot",),
)
