"""Motions among trees that give way, judged by coal alone: what is pushed, how deep, by which link, and is it told."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path

import coal
import numpy as np
from studies.harness import Asked, Row, Study
from studies.outside import things_of
from studies.validation.episodes import COUNTED, Tally
from studies.validation.judge import TICK_S, Arm, Body, Contact, Motion, Window, contacts

from hplan.certificate.certificate import certify
from hplan.collision.giving_way import HANGING_M
from hplan.errors import BlockedError, HplanError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.world import without_inside
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene
from hplan.scene.orchard import MeasuredOptions, measured_orchard

#: Measured trees that come with the examples.
SHIPPED = Path(__file__).parents[2] / "examples" / "trees"

#: Fruits that are tried in a scene; deeper than allowed by more than this is a fault [m].
FRUITS, BEYOND_M = 12, 1e-5

#: A motion that pushes something deeper than this grazes, with a bound so far above its depth [m].
PUSHED_M, SHORT_M = 1e-3, 1e-5


def among_yielding(seed: int, number: int, trees: Sequence[Path]) -> Tally:
    """Motions to some fruits of a tree that gives way, each looked at, and again with a bound that it does not keep.

    Args:
        trees: Files of measured trees, of which one is drawn.
    """
    rng, tally = np.random.default_rng([seed, number, 11]), Tally()
    robot = load_robot("orchard_harvester")
    scene, tree = _scene(robot, rng, trees)
    tally.arms[tree] += 1
    arm = _thick(robot)
    near = [fruit.name for fruit in scene.fruits if np.hypot(*fruit.center[:2]) < 2.0]
    for name in rng.permutation(near)[:FRUITS]:
        task = scene.with_(goal=Goal(fruit=str(name)))
        options = PlanOptions(effort="quick", tracking_error=float(rng.choice([0.0, 1e-3])))
        try:
            result = plan(robot, task, options)
        except HplanError as error:
            tally.refused["blocked" if isinstance(error, BlockedError) else error.kind] += 1
            continue
        _look(robot, arm, task, result, tally, f"{tree}, case {number}, {name}")
    return tally


def _scene(robot: Robot, rng: np.random.Generator, trees: Sequence[Path]) -> tuple[Scene, str]:
    """A tree before the arm, with what is left to chance, and its name."""
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
    links = ("hand",) if rng.random() < 0.3 else None
    return scene.with_(yield_links=links), file.stem


def _thick(robot: Robot) -> Arm:
    """The arm as coal has it from the URDF, each of its links as the capsule that it is taken for."""
    arm = Arm(robot.urdf_path, tool_frame=robot.tool_frame)
    widths = dict(zip(robot.arm.link_names, robot.arm.half_widths.tolist(), strict=True))
    still = [body for body in arm.bodies if body.joint <= robot.arm_slice.start]
    arm.bodies = still + [
        _capsule(body, widths[body.link])
        for body in arm.bodies
        if body.link in widths and isinstance(body.shape, coal.Cylinder)
    ]
    return arm


def _capsule(body: Body, width: float) -> Body:
    shape = coal.Capsule(width, 2.0 * body.shape.halfLength)
    half = np.array([width, width, body.shape.halfLength + width])
    return Body(body.link, body.link, body.joint, shape, shape, body.place, np.zeros(3), half)


def _look(robot: Robot, arm: Arm, scene: Scene, result: PlanResult, tally: Tally, case: str) -> None:
    """Hold a motion against what gives way, and its certificate against a bound that is too small."""
    certificate, motion = result.certificate, result.trajectory
    clock = np.append(np.arange(0.0, motion.duration, TICK_S), motion.duration)
    positions, things = motion.positions(clock), things_of(scene)
    windows = [Window(one.fruit.name, one.begin_s, one.end_s) for one in certificate.contacts]
    inside = np.zeros(len(clock), dtype=np.bool_)
    for window in windows:
        inside |= (clock >= window.from_s) & (clock <= window.to_s)
    tally.looked["motions"] += 1
    tally.ticks += len(clock)
    links = set(scene.yield_links or robot.arm.link_names[-2:])
    told: dict[tuple[str, str], float] = {}
    for push in certificate.pushes or ():
        told[push.link, push.obstacle] = max(told.get((push.link, push.obstacle), 0.0), push.depth_m)
    pushed = list[Contact]()
    for mask, hanging in ((~inside, ()), (inside, scene.fruits)):
        yields = _yields(
            scene, {name for fruit in hanging if fruit.name == scene.goal.fruit for name in fruit.hangs_from}
        )
        part = Motion(robot.joint_names, clock[mask], positions[mask])
        for contact in contacts(arm, part, things, windows=windows) if mask.any() else ():
            pair = contact.first, contact.second
            allowed = yields.get(contact.second, 0.0) if contact.first in links else 0.0
            if contact.depth_m > min(allowed, told.get(pair, 0.0)) + BEYOND_M:
                tally.faults.append({"case": case, "pair": pair, "depth_m": contact.depth_m, "allowed_m": allowed})
            pushed += [contact] if allowed else []
    tally.looked_in["pushes"] += len({(contact.first, contact.second) for contact in pushed})
    tally.looked_in["pushes of what the fruit hangs from"] += len(
        {(one.first, one.second) for one in pushed if one.second not in _yields(scene, set())}
    )
    deepest = max(pushed, key=lambda contact: contact.depth_m, default=None)
    if deepest is not None and deepest.depth_m > PUSHED_M:
        less = _yielding_less(scene, deepest)
        touches: bool = result.certificate.goal_contact == "motion"
        tally.looked_in["grazing"] += 1
        if certify(robot, less, motion, goal_contact="motion" if touches else "approach").verified:
            tally.faults.append({"case": case, "kind": "grazing", "depth_m": deepest.depth_m, "of": deepest.second})


def _yields(scene: Scene, hanging: AbstractSet[str]) -> dict[str, float]:
    """How deep what may be pushed may be, by name [m]."""
    items = {item.name: item.yields for item in (*scene.obstacles, *scene.fruits) if item.yields}
    return dict.fromkeys(hanging, HANGING_M) | items


def _yielding_less(scene: Scene, contact: Contact) -> Scene:
    """The scene where what is pushed gives way by a little less than it is pushed."""
    items = {
        key: tuple(
            item.with_(yields=contact.depth_m - SHORT_M) if item.name == contact.second else item
            for item in getattr(scene, key)
        )
        for key in ("obstacles", "fruits")
    }
    return scene.with_(**items)


def _row(asked: Asked, number: int) -> Row:
    trees = sorted((asked.trees or SHIPPED).glob("*.csv"))
    return among_yielding(asked.seed, number, trees).row(number)


YIELDING = Study(
    "yielding",
    "motions to fruit of trees that give way (--trees): nothing is pushed deeper than it yields, or untold",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
