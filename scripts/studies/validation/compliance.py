"""Motions among compliant trees, judged by coal: deflected obstacles, depths and links, and their reports."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.outside import obstacles_of
from studies.validation.judge import TICK_S, Arm, Body, Contact, SampledMotion, Window, contacts
from studies.validation.motions import COUNTED, Tally

from hplan.certificate.certificate import certify
from hplan.collision.compliant_solids import HANGING_M
from hplan.errors import BlockedError, HplanError
from hplan.planar.family_reader import family_of
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.world import without_inside
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene
from hplan.scene.orchard import MeasuredOptions, measured_orchard

#: Measured trees of the examples.
SHIPPED = Path(__file__).parents[2] / "examples" / "trees"

#: Fruits tried in each scene; excess of a deflection that is a fault [m].
FRUITS, EXCESS_M = 12, 1e-5

#: Motions with a larger deflection are certified again, with a compliance that is too small by this much [m].
PUSHED_M, SHORT_M = 1e-3, 1e-5


def check_deflections(seed: int, number: int, trees: Sequence[Path]) -> Tally:
    """Plan and check motions to some fruits of a compliant tree, one of the files."""
    rng, tally = np.random.default_rng([seed, number, 11]), Tally()
    robot = load_robot("orchard_harvester")
    scene, tree = _scene(robot, rng, trees)
    tally.arms[tree] += 1
    arm = _capsule_arm(robot)
    near = [fruit.name for fruit in scene.fruits if np.hypot(*fruit.center[:2]) < 2.0]
    for name in rng.permutation(near)[:FRUITS]:
        task = scene.with_values(goal=Goal(fruit=str(name)))
        options = PlanOptions(effort="quick", tracking_error=float(rng.choice([0.0, 1e-3])))
        try:
            result = plan(robot, task, options)
        except HplanError as error:
            tally.refused["blocked" if isinstance(error, BlockedError) else error.kind] += 1
            continue
        _check(robot, arm, task, result, tally, f"{tree}, case {number}, {name}")
    return tally


def _scene(robot: Robot, rng: np.random.Generator, trees: Sequence[Path]) -> tuple[Scene, str]:
    """A tree in front of the arm with random options, and its name."""
    file = trees[int(rng.integers(len(trees)))]
    wood, fruit = rng.choice([0.01, 0.02, 0.03], 2).tolist()
    options = MeasuredOptions(
        distance=rng.uniform(0.9, 1.6),
        height=rng.uniform(-0.6, 0.2),
        yaw_deg=rng.uniform(0.0, 360.0),
        wood_yields=wood,
        yields_below=rng.uniform(0.006, 0.012),
        fruit_yields=fruit if rng.random() < 0.8 else 0.0,
        clearance=float(rng.choice([0.0, 0.003])),
        hangs_within=0.01 if rng.random() < 0.5 else None,
    )
    scene, _ = without_inside(robot, measured_orchard([file], options, start_deg=(0.0, 90.0, 90.0, 90.0)))
    links = ("hand", "tool0") if rng.random() < 0.3 else None
    return scene.with_values(yield_links=links), file.stem


def _capsule_arm(robot: Robot) -> Arm:
    """The arm of the URDF with the capsules of its links, as hplan certifies them."""
    arm = Arm(robot.urdf_path, tool_frame=robot.tool_frame)
    arm.bodies = [body for body in arm.bodies if body.joint <= family_of(robot).arm_slice.start] + [
        _capsule(body)
        for body in arm.bodies
        if body.joint > family_of(robot).arm_slice.start and isinstance(body.shape, coal.Cylinder)
    ]
    return arm


def _capsule(body: Body) -> Body:
    width = body.shape.radius
    shape = coal.Capsule(width, 2.0 * body.shape.halfLength)
    half = np.array([width, width, body.shape.halfLength + width])
    return replace(body, name=body.link, shape=shape, hull=shape, middle=np.zeros(3), half=half)


def _check(robot: Robot, arm: Arm, scene: Scene, result: PlanResult, tally: Tally, case: str) -> None:
    """Check the deflections of a motion, and its certificate with a compliance that is too small."""
    certificate, motion = result.certificate, result.trajectory
    clock = np.append(np.arange(0.0, motion.duration, TICK_S), motion.duration)
    positions, obstacles = motion.positions(clock), obstacles_of(scene)
    windows = [Window(one.fruit.name, one.begin_s, one.end_s) for one in certificate.contacts]
    inside = np.zeros(len(clock), dtype=np.bool_)
    for window in windows:
        inside |= (clock >= window.from_s) & (clock <= window.to_s)
    tally.checked["motions"] += 1
    tally.ticks += len(clock)
    links = set(scene.yield_links or (*family_of(robot).arm.link_names[-2:], robot.tool_frame))
    reported: dict[tuple[str, str], float] = {}
    for push in certificate.pushes or ():
        reported[push.link, push.obstacle] = max(reported.get((push.link, push.obstacle), 0.0), push.depth_m)
    supports = {name for fruit in scene.fruits if fruit.name == scene.goal.fruit for name in fruit.hangs_from}
    pushed = list[Contact]()
    for mask, yields in ((~inside, _compliances(scene, set())), (inside, _compliances(scene, supports))):
        part = SampledMotion(robot.joint_names, clock[mask], positions[mask])
        for contact in contacts(arm, part, obstacles, windows=windows) if mask.any() else ():
            pair = contact.first, contact.second
            allowed = yields.get(contact.second, 0.0) if contact.first in links else 0.0
            if contact.depth_m > min(allowed, reported.get(pair, 0.0)) + EXCESS_M:
                tally.faults.append({"case": case, "pair": pair, "depth_m": contact.depth_m, "allowed_m": allowed})
            pushed += [contact] if allowed else []
    pairs = {(contact.first, contact.second) for contact in pushed}
    tally.checked_in["deflections"] += len(pairs)
    tally.checked_in["deflections of supports"] += sum(name not in _compliances(scene, set()) for _, name in pairs)
    deepest = max(pushed, key=lambda contact: contact.depth_m, default=None)
    if deepest is not None and deepest.depth_m > PUSHED_M:
        tally.checked_in["grazing"] += 1
        goal_contact = certificate.goal_contact if certificate.goal_contact == "motion" else "approach"
        if certify(robot, _less_compliant(scene, deepest), motion, goal_contact=goal_contact).verified:
            tally.faults.append({"case": case, "kind": "grazing", "depth_m": deepest.depth_m, "of": deepest.second})


def _compliances(scene: Scene, supports: AbstractSet[str]) -> dict[str, float]:
    """Allowed deflections of compliant obstacles, and of the supports of a fruit, by name [m]."""
    items = {item.name: item.yields for item in (*scene.obstacles, *scene.fruits) if item.yields}
    return dict.fromkeys(supports, HANGING_M) | items


def _less_compliant(scene: Scene, contact: Contact) -> Scene:
    """The scene with a compliance slightly smaller than the deflection in a contact."""
    items = {
        key: tuple(
            item.with_values(yields=contact.depth_m - SHORT_M) if item.name == contact.second else item
            for item in getattr(scene, key)
        )
        for key in ("obstacles", "fruits")
    }
    return scene.with_values(**items)


def _row(config: StudyConfig, number: int) -> Row:
    trees = sorted((config.trees or SHIPPED).glob("*.csv"))
    return check_deflections(config.seed, number, trees).row(number)


YIELDING = Study(
    "yielding",
    "motions to fruit of compliant trees (--trees): no deflection exceeds the compliance, and all are reported",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
