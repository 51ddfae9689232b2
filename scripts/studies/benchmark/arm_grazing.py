"""Obstacles that certified motions of any arm graze by 0.1 to 5 mm, or pass with 0.3 mm to spare: are they verified?

A motion is planned between two random free configurations. A ball, a capsule and a box are put near a point of a moving
body at an instant of it; then the ball and the capsule are made as thick, and the box is moved to where, the least
distance over the whole motion, as coal measures it, is the one that was drawn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from studies.benchmark.arm_scenes import free_ends, reach_of, scene_between
from studies.benchmark.measure import times_until
from studies.benchmark.outside_check import EVERY_S, OutsideCheck, placed

from hplan.base.arrays import FloatArray
from hplan.bodies.collision_bodies import collision_bodies
from hplan.errors import HplanError
from hplan.planning.plan import plan
from hplan.problem.options import PlanOptions
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


@dataclass(frozen=True)
class Grazed:
    """One obstacle near one motion.

    Attributes:
        kind: Its kind.
        spare_m: Least distance of the arm from it over the motion, as coal measures it; negative is the depth [m].
        verified: Whether the motion is certified with it.
        named: Whether the certificate says where it comes too near to it.
    """

    kind: str
    spare_m: float
    verified: bool
    named: bool


def grazed(robot: Robot, count: int, seed: int) -> Iterator[Grazed]:
    """So many obstacles that are grazed, and as many that are passed.

    Args:
        robot: The arm.
        count: How many of each.
        seed: Of motions and obstacles.
    """
    rng = np.random.default_rng([seed, 10**6])
    extent, left = reach_of(robot, rng), [count, count]
    while max(left) > 0:
        ends = free_ends(robot, rng, (), extent)
        if ends is None:
            continue
        try:
            motion = plan(robot, scene_between("grazing", *ends, ()), PlanOptions()).trajectory
        except HplanError:
            continue
        for kind in ("sphere", "capsule", "box"):
            for passed in (0, 1):
                spare = GAP if passed else -rng.uniform(*DEPTHS)
                found = _placed_near(robot, rng, motion, kind, spare) if left[passed] > 0 else None
                if found is None:
                    continue
                left[passed] -= 1
                certificate = certify(robot, scene_between("grazing", *ends, (found[0],)), motion)
                named = any("'it'" in line for line in certificate.violations)
                yield Grazed(kind, found[1], certificate.verified, named)


def _placed_near(
    robot: Robot, rng: np.random.Generator, motion: Trajectory, kind: str, spare: float
) -> tuple[Sphere | Capsule | Box, float] | None:
    """An obstacle whose least distance from the arm is about that asked for, and that distance; None without one."""
    point, away = _near_the_arm(robot, rng, motion)
    if kind == "box":
        return _moved_box(robot, rng, motion, (point, away), spare)
    thin = _rounded(rng, kind, point + away * rng.uniform(0.05, 0.2), THINNEST, rng.normal(size=3))
    distance, _ = _least(robot, motion, thin)
    if distance - spare < 1e-4:
        return None
    thick = thin.model_copy(update={"radius": THINNEST + distance - spare})
    least, _ = _least(robot, motion, thick)
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
        least, _ = _least(robot, motion, box)
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
    return body_point(robot, q, body.joint, body.core.mean(axis=0)), away / np.linalg.norm(away)


def body_point(robot: Robot, q: FloatArray, joint: int, point: FloatArray) -> FloatArray:
    """(3,) a point of a joint's frame in `base_link` at a (dof,) configuration."""
    import pinocchio as pin

    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    found: FloatArray = data.oMi[joint + 1].act(point)
    return found


def _least(robot: Robot, motion: Trajectory, obstacle: Sphere | Capsule | Box) -> tuple[float, float]:
    """Least distance of the arm from an obstacle over a motion, and when it is [m, s]."""
    check = OutsideCheck(robot, [placed(obstacle)])
    clock = times_until(motion.duration, EVERY_S)
    distances = [check.distance(q) for q in motion.positions(clock)]
    at = float(clock[int(np.argmin(distances))])
    finer = np.clip(at + np.linspace(-EVERY_S, EVERY_S, 2 * FINER + 1), 0.0, motion.duration)
    closer = [check.distance(q) for q in motion.positions(finer)]
    return min(closer), float(finer[int(np.argmin(closer))])


def table(rows: Sequence[Grazed]) -> list[str]:
    """Lines: how many are verified."""
    lines = []
    for name, some in (
        ("grazed by 0.1 to 5 mm", [row for row in rows if row.spare_m < 0.0]),
        ("passed with 0.3 mm to spare", [row for row in rows if row.spare_m >= 0.0]),
    ):
        kinds = ", ".join(f"{sum(row.kind == kind for row in some)} {kind}" for kind in ("sphere", "capsule", "box"))
        verified, named = sum(row.verified for row in some), sum(row.named for row in some)
        lines.append(f"{name}: {len(some)} ({kinds}); verified: {verified}; refused with the obstacle's name: {named}")
    return lines
