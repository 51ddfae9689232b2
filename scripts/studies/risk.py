"""Motions among obstacles of uncertain places: the risk that is shown beside draws, other allocations beside it."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from scipy.stats import chi
from studies.harness import Asked, Row, Study
from studies.measure import planned, ratio

from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import AnyObstacle, Box, Capsule, Sphere

#: Obstacles of a scene, and their standard deviations [m].
OBSTACLES, SIGMAS = (25, 60), (0.003, 0.02)

#: Every so many scenes have an error that is common to all, of that standard deviation [m].
_SHARED_EVERY, _SHARED = 4, 0.005


def uncertain_scene(robot: Robot, seed: int, number: int) -> Scene:
    """Balls, capsules and boxes within reach, and a task for which the straight motion is not free where they are."""
    random = np.random.default_rng([seed, number])
    reach = float(robot.arm.lengths.sum())
    while True:
        things = [_thing(random, reach, f"thing {n}") for n in range(int(random.integers(*OBSTACLES)))]
        shared = None if number % _SHARED_EVERY else (_SHARED**2 * np.eye(3)).tolist()
        for _ in range(20):
            start, goal = random.uniform(np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (2, robot.dof))
            scene = Scene(
                name=f"uncertain-{number}", start=Start(joints_rad=start), goal=Goal(joints_rad=goal),
                obstacles=tuple(things), covariance=shared,
            )  # fmt: skip
            found, _ = planned(robot, scene, PlanOptions(sigmas=0.0, effort="quick"))
            if found is not None and found.motion.origin != "direct":
                return scene


def _thing(random: np.random.Generator, reach: float, name: str) -> AnyObstacle:
    away, yaw, up = random.uniform(0.3, 1.05) * reach, random.uniform(-np.pi, np.pi), random.uniform(0.1, 0.9 * reach)
    center, sigma = np.array([away * np.cos(yaw), away * np.sin(yaw), up]), float(random.uniform(*SIGMAS))
    kind = int(random.integers(3))
    if kind == 0:
        return Sphere(name=name, center=center, radius=float(random.uniform(0.02, 0.1)), sigma=sigma)
    if kind == 1:
        along = random.normal(size=3)
        along *= 0.5 * random.uniform(0.2, 0.8) / np.linalg.norm(along)
        radius = float(random.uniform(0.005, 0.03))
        return Capsule(name=name, start=center - along, end=center + along, radius=radius, sigma=sigma)
    root = sigma * random.normal(size=(3, 3))
    size, rpy = random.uniform(0.03, 0.2, 3), random.uniform(-180.0, 180.0, 3)
    return Box(name=name, center=center, size=size, rpy_deg=rpy, covariance=root @ root.T / 3.0)


def _row(asked: Asked, number: int) -> list[Row]:
    robot = asked.arm()
    scene = uncertain_scene(robot, asked.seed, number)
    count = len(scene.obstacles)
    _, plain = planned(robot, scene, PlanOptions(effort=asked.effort))
    rows = []
    for risk in (0.1, 0.01, 0.001):
        _, equal = planned(robot, scene, _growing(asked, NormalDist().inv_cdf(1.0 - risk / count)))
        _, sigmas = planned(robot, scene, _growing(asked, float(chi(3).isf(risk / count))))
        found, row = planned(robot, scene, PlanOptions(effort=asked.effort, risk=risk))
        duration, both = row.get("duration_s"), plain["solved"] and row["solved"]
        row |= {
            "name": f"{scene.name}-{risk:g}", "risk": f"{risk:g}", "obstacles": count, "fault": False,
            "times_plain": ratio(row["ms"], plain["ms"]) if both else None, "equal_solved": equal["solved"],
            "sigmas_solved": sigmas["solved"], "equal_to_ours": ratio(equal.get("duration_s"), duration),
            "sigmas_to_ours": ratio(sigmas.get("duration_s"), duration),
        }  # fmt: skip
        if found is not None and found.certificate.risk is not None:
            shown, estimate = found.certificate.risk, found.certificate.risk.estimate
            row |= {
                "bound": shown.bound, "frequency": estimate.frequency, "low": estimate.low, "high": estimate.high,
                "bound_to_truth": shown.bound / estimate.frequency if estimate.touching >= _ENOUGH else None,
                "fault": estimate.low > shown.bound or shown.bound > risk,
            }  # fmt: skip
        rows.append(row)
    return rows


#: So many draws have to touch something before a ratio to their number says much.
_ENOUGH = 20


def _growing(asked: Asked, sigmas: float) -> PlanOptions:
    return PlanOptions(effort=asked.effort, sigmas=sigmas)


RISK = Study(
    "risk", "what is shown of contact beside draws", _row, by="risk", count=(200, 2),
    columns=(
        "solved", "equal_solved", "sigmas_solved", "bound", "frequency", "bound_to_truth", "equal_to_ours",
        "sigmas_to_ours", "ms", "times_plain",
    ),
)  # fmt: skip
