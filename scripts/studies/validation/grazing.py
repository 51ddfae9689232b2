"""Certificates of motions that graze an obstacle, or pass it closely.

A case is a random arm (or `--robot`) with a motion planned by hplan and messages of another program, whose samples at 2
to 500 Hz have one to three fields. A ROS 2 controller interpolates these by straight lines, cubics or quintics. An
obstacle is placed at a known minimum distance from the arm. A motion in contact must not be verified, a planned motion
that is clear must be, and no certificate may report more than that distance.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly
from studies.harness import Row, Study, StudyConfig
from studies.validation.judge import STATIC_CONTACT_M, Arm, JudgedObstacle, SampledMotion, distance
from studies.validation.motions import COUNTED, Tally, impatient, warm_up
from studies.validation.random_arms import NAMED, DrawnArm, draw_arm, given_arm
from studies.validation.random_worlds import World, direction, draw_ends, log_uniform, obstacle_of

from hplan.apps.ros import from_joint_trajectory
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planar.family_reader import is_planar
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory, write_csv

#: Penetration depths and gaps of obstacles, radius that they start with, and accuracy of distances [m].
DEPTHS, GAPS, THIN, ACCURACY = (1e-4, 5e-3), (1e-3, 5e-3), 1e-3, 1e-6

#: Obstacles of a planned motion; messages of another program; rates of their samples [1/s].
OBSTACLES, MESSAGES, RATES_HZ = 4, 4, (2.0, 500.0)


def graze(seed: int, number: int, robot: Robot | None = None) -> Tally:
    """Check the certificates of motions of a random arm, or of a given robot."""
    warm_up()
    rng, tally = np.random.default_rng([seed, number, 9]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn = draw_arm(Path(name), rng) if robot is None else given_arm(robot)
        except HplanError as error:
            tally.refused[error.kind] += 1
            return tally
        tally.arms[drawn.kind] += 1
        # Links of planar arms are certified as capsules, and meshes as convex pieces, which are larger.
        is_exact = not is_planar(drawn.robot) and robot is None and drawn.kind not in NAMED
        ends = draw_ends(drawn, rng, 0.01)
        if ends is not None:
            world = World(*ends)
            try:
                planner = Planner(drawn.robot, world.scene(), PlanOptions(effort="quick"))
                found = planner.plan(cancel=impatient()).trajectory
                seen = SampledMotion.read(write_csv(found, Path(name) / "motion.csv"))
                for count in range(OBSTACLES):
                    contact = count % 2 == 0 or not is_exact
                    _certify_near(drawn, world, found, seen, rng, tally, contact=contact, must_verify=True)
            except HplanError as error:
                tally.refused[error.kind] += 1
        for _ in range(MESSAGES):
            ends = draw_ends(drawn, rng, 0.01)
            if ends is not None:
                _certify_message(drawn, World(*ends), rng, tally)
    return tally


def _certify_message(drawn: DrawnArm, world: World, rng: np.random.Generator, tally: Tally) -> None:
    """Certify a message of another program, without an obstacle and with one."""
    fields = int(rng.integers(1, 4))
    given: Interpolation | None = "cubic" if fields == 3 and rng.random() < 0.2 else None
    message, curve = draw_message(drawn.robot, world, rng, fields, 2 if given else fields)
    motion = from_joint_trajectory(message, robot=drawn.robot, interpolation=given)
    if not _certify(drawn.robot, world, motion).verified:
        tally.unverified[f"{motion.interpolation}, {fields} fields"] += 1
        return
    clock = np.unique(np.concatenate([motion.time, np.linspace(0.0, motion.duration, 400)]))
    seen = SampledMotion(drawn.robot.joint_names, clock, curve(clock))
    _certify_near(drawn, world, motion, seen, rng, tally, contact=bool(rng.random() < 0.75), must_verify=False)


def _certify(robot: Robot, world: World, motion: Trajectory, *items: dict[str, Any]) -> Any:
    scene = world.scene().with_values(obstacles=tuple(map(obstacle_of, items)))
    return certify(robot, scene, motion, velocity_jumps=motion.interpolation == "linear", check_ends=False)


def _certify_near(
    drawn: DrawnArm, world: World, motion: Trajectory, seen: SampledMotion, rng: np.random.Generator, tally: Tally,
    *, contact: bool, must_verify: bool,
) -> None:  # fmt: skip
    """Place an obstacle in contact with a motion, or clear of it, and check the certificate."""
    gap = -log_uniform(rng, *DEPTHS) if contact else log_uniform(rng, *GAPS)
    placed = place_obstacle(drawn.arm, seen, rng, gap)
    if placed is None:
        return
    item, body = placed
    found = _certify(drawn.robot, world, motion, item)
    tally.checked["grazing" if contact else "clear" if must_verify else "clear, of messages"] += 1
    tally.checked_in[motion.interpolation] += 1
    if found.verified and (contact or found.min_clearance_m > gap + ACCURACY):
        fault = "verified in contact" if contact else "clearance too large"
    elif not found.verified and not contact and must_verify:
        fault = "refused although clear"
    else:
        return
    tally.faults.append({"kind": fault, "gap_m": gap, "body": body, "item": item, "curve": motion.interpolation})


def place_obstacle(
    arm: Arm, motion: SampledMotion, rng: np.random.Generator, gap: float
) -> tuple[dict[str, Any], str] | None:
    """A sphere or capsule at a minimum distance from the arm over a motion, and the nearest body."""
    q = arm.configurations(motion.names, motion.values)
    places = [arm.places(each) for each in q[::2]]
    k = int(rng.choice([k for k, is_static in enumerate(arm.static) if not is_static]))
    at = places[int(rng.integers(len(places)))][k].act(arm.bodies[k].middle)
    center = at + direction(rng) * (arm.bodies[k].radius * rng.uniform(0.2, 1.0) + 0.05)
    end = center + direction(rng) * rng.uniform(0.05, 0.4) * float(rng.integers(2))
    item: dict[str, Any] = {"name": "drawn", "kind": "sphere", "center": center.tolist(), "radius": THIN}
    if (end != center).any():
        item = {"name": "drawn", "kind": "capsule", "from": center.tolist(), "to": end.tolist(), "radius": THIN}
    obstacle = JudgedObstacle(item)
    least, nearest = min(
        (min(distance(body.shape, row[j], obstacle.shape, obstacle.place) for row in places), j)
        for j, body in enumerate(arm.bodies)
    )
    item["radius"] = THIN + least - gap
    # Turrets may overlap obstacles a little, as static bodies may.
    of_turret = arm.bodies[nearest].joint <= 1 and -gap <= STATIC_CONTACT_M
    if least < 0.005 or not 0.008 < item["radius"] < 0.4 or arm.static[nearest] or of_turret:
        return None
    return item, arm.bodies[nearest].name


def draw_message(
    robot: Robot, world: World, rng: np.random.Generator, fields: int, used: int
) -> tuple[dict[str, Any], Callable[[FloatArray], FloatArray]]:
    """A message from start to goal, and the curve that a controller makes of its first `used` fields."""
    way, rate = world.goal - world.start, log_uniform(rng, *RATES_HZ)
    seconds = float(max(3.0 * (np.abs(way) / robot.velocity_limit).max(),
        3.5 * np.sqrt(np.abs(way) / robot.acceleration_limit).max(), 2.0 / rate, 0.3))  # fmt: skip
    times = np.linspace(0.0, seconds, max(round(rate * seconds), 2) + 1)
    quintic = BPoly.from_derivatives([0.0, seconds], [[world.start, 0.0 * way, 0.0 * way], [world.goal, 0.0 * way,
        0.0 * way]])  # fmt: skip
    rows = np.stack([quintic(times), quintic(times, 1), quintic(times, 2)], axis=1)
    # Derivatives from another program need not be those of its positions.
    h = seconds / (len(times) - 1)
    loose = np.minimum(0.3 * robot.acceleration_limit, 0.1 * robot.velocity_limit / h)
    rows[1:-1, 1] += 0.1 * h * loose * rng.uniform(-1.0, 1.0, rows[1:-1, 1].shape)
    rows[:, 2] += loose * rng.uniform(-1.0, 1.0, rows[:, 2].shape)
    stamps = [divmod(round(1e9 * time), 10**9) for time in times.tolist()]
    keys = ("positions", "velocities", "accelerations")
    points = [
        {key: row[k].tolist() if k < fields else [] for k, key in enumerate(keys)}
        | {"effort": [], "time_from_start": {"sec": sec, "nanosec": nanosec}}
        for row, (sec, nanosec) in zip(rows, stamps, strict=True)
    ]
    exact = np.array([sec + 1e-9 * nanosec for sec, nanosec in stamps])
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    message = {"header": header, "joint_names": list(robot.joint_names), "points": points}
    return message, BPoly.from_derivatives(exact, list(rows[:, :used]))


def _row(config: StudyConfig, number: int) -> Row:
    return graze(config.seed, number, config.robot).row(number)


GRAZING = Study(
    "grazing",
    "obstacles 0.1 to 5 mm deep in a motion, which must not be verified, or 1 to 5 mm clear of it",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
