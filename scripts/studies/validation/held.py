"""Motions of random arms that hold random objects, checked by the judge.

A case is a random arm and a few worlds. In each the arm holds one to three objects of any kind in random frames, with
masses up to what it can hold at start and goal. A motion is planned; the judge looks for contacts of arm and objects,
and inverse dynamics of Pinocchio's model with the same masses gives the torques. Motions of the empty arm in the same
worlds show that the objects matter.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicHermiteSpline
from studies.harness import Row, Study, StudyConfig
from studies.validation.judge import SampledMotion, contacts
from studies.validation.motions import COUNTED, Tally, impatient, warm_up, windows
from studies.validation.random_arms import DrawnArm, draw_arm
from studies.validation.random_worlds import World, direction, draw_obstacle, draw_world, log_uniform, obstacle_of

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.attached import Attached
from hplan.trajectory.trajectory import Trajectory, write_csv

#: Worlds of a case, tries for each, and the share of them in which the empty arm is planned, too.
WORLDS, TRIES, EMPTY = 4, 4, 0.3

#: Kinds of held objects, their sizes [m], and shares of those at the tool, without mass, and with given inertia.
KINDS = ("sphere", "capsule", "cylinder", "box", "mesh", "points")
SIZES_M, AT_TOOL, WEIGHTLESS, GIVEN = (0.01, 0.12), 0.5, 0.1, 0.4

#: Most points of a held cloud; use of a torque limit that counts as kept; torque at rest that the load may use.
MOST_POINTS, KEPT, AT_REST = 60, 1.001, 0.8


class Held(NamedTuple):
    """A held object, as scenes list its shape, its frame, and its inertia there for a mass of 1 kg."""

    item: dict[str, Any]
    frame: str
    inertia: pin.Inertia
    is_given: bool


def hold(seed: int, number: int) -> Tally:
    """Plan motions of one arm with held objects, and check them."""
    warm_up()
    rng, tally = np.random.default_rng([seed, number, 17]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn = draw_arm(Path(name), rng)
        except HplanError as error:
            tally.refused[f"robot: {error.kind}"] += 1
            return tally
        tally.arms[drawn.kind] += 1
        for count in range(WORLDS):
            _hold_in_world(drawn, np.random.default_rng([seed, number, 17, count]), tally, Path(name), number)
    return tally


def _hold_in_world(drawn: DrawnArm, rng: np.random.Generator, tally: Tally, folder: Path, number: int) -> None:
    """Plan and check motions in one world."""
    for _ in range(TRIES):
        held = [draw_held(drawn.robot, rng, f"held {k}") for k in range(int(rng.integers(1, 4)))]
        arm = drawn.arm.holding([(each.item, each.frame) for each in held])
        world = draw_world(replace(drawn, arm=arm), rng, moving=False, camera=False)
        if world is not None:
            break
    else:
        tally.refused["no free ends"] += 1
        return
    masses = draw_masses(drawn.robot, held, world, rng)
    attached = [
        Attached(
            object=obstacle_of(each.item), frame=each.frame, mass=mass, may_touch=(),
            center_of_mass=tuple(each.inertia.lever.tolist()) if each.is_given and mass else None,
            inertia=_rows(mass * each.inertia.inertia) if each.is_given and mass else None,
        )
        for each, mass in zip(held, masses, strict=True)
    ]  # fmt: skip
    scene = world.scene()
    options = PlanOptions(effort="quick" if rng.random() < 0.5 else "default", step_deg=6.0)
    loaded = drawn.robot.model.copy()
    for each, mass in zip(held, masses, strict=True):
        frame = loaded.frames[loaded.getFrameId(each.frame)]
        body = pin.Inertia(mass, each.inertia.lever, mass * each.inertia.inertia)
        loaded.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    for is_held in (True, False) if rng.random() < EMPTY else (True,):
        try:
            task = scene.with_attached(attached if is_held else [])
            found = plan(drawn.robot, task, options, cancel=impatient())
        except HplanError as error:
            tally.refused[error.kind if is_held else f"empty: {error.kind}"] += 1
            continue
        seen = SampledMotion.read(write_csv(found.trajectory, folder / "motion.csv", whole=True))
        allowed = windows(found.certificate, world.fruits)
        touching = contacts(arm, seen, world.obstacles, windows=allowed)
        use = torque_use(drawn.robot, loaded, found.trajectory)
        if not is_held:
            tally.checked_in["empty"] += 1
            tally.checked_in["empty, in contact with the objects"] += bool(touching)
            tally.checked_in["empty, torque above limits with the objects"] += use > KEPT
            continue
        tally.checked["plan"] += 1
        tally.ticks += len(seen.times)
        for each in held:
            tally.checked_in[str(each.item["kind"])] += 1
        tally.checked_in[f"torque {10 * int(10.0 * min(use, 1.0))} %"] += 1
        fault = {"case": number, "arm": drawn.kind, "claimed_m": found.certificate.min_clearance_m}
        if touching:
            tally.faults.append({**fault, **vars(max(touching, key=lambda contact: contact.depth_m))})
        if use > KEPT:
            tally.faults.append({**fault, "torque": use, "claimed": found.certificate.limit_use.torque})


def _rows(matrix: FloatArray) -> Any:
    rows = 0.5 * (matrix + matrix.T)
    return tuple((x, y, z) for x, y, z in rows.tolist())


def draw_held(robot: Robot, rng: np.random.Generator, name: str) -> Held:
    """A random object in the tool frame or the frame of a moving link."""
    links = [f.name for f in robot.model.frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]
    frame = robot.tool_frame if rng.random() < AT_TOOL else str(rng.choice(links))

    def place(size: float) -> FloatArray:
        return np.asarray(direction(rng) * (size + float(rng.uniform(0.0, 0.1))))

    kind = str(rng.choice(KINDS))
    item = draw_obstacle(rng, name, kind, place, SIZES_M)
    item.pop("stock", None)
    if kind == "points":
        item["points"] = item["points"][:MOST_POINTS]
    own = _homogeneous(item)
    is_given = own is None or bool(rng.random() < GIVEN)
    if own is None or is_given:
        size = log_uniform(rng, *SIZES_M)
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        moments = rng.uniform(0.5, 1.0, 3) * size**2
        middle = np.array(item.get("center", item.get("position", item.get("from", (0.0, 0.0, 0.0)))))
        own = pin.Inertia(1.0, middle + size * direction(rng), axes @ np.diag(moments) @ axes.T)
    return Held(item, frame, own, is_given)


def _homogeneous(item: dict[str, Any]) -> pin.Inertia | None:
    """Inertia of a primitive of 1 kg; None for other kinds."""
    turn = pin.rpy.rpyToMatrix(*np.radians(item.get("rpy_deg", (0.0, 0.0, 0.0))))
    place = pin.SE3(turn, np.array(item.get("center", (0.0, 0.0, 0.0)), dtype=np.float64))
    if item["kind"] == "sphere":
        return pin.Inertia.FromSphere(1.0, item["radius"]).se3Action(place)
    if item["kind"] == "box":
        return pin.Inertia.FromBox(1.0, *item["size"]).se3Action(place)
    if item["kind"] == "cylinder":
        return pin.Inertia.FromCylinder(1.0, item["radius"], item["length"]).se3Action(place)
    if item["kind"] == "capsule":
        start, end = np.array(item["from"]), np.array(item["to"])
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).toRotationMatrix()
        place = pin.SE3(turn, 0.5 * (start + end))
        return pin.Inertia.FromCapsule(1.0, item["radius"], float(np.linalg.norm(end - start))).se3Action(place)
    return None


def draw_masses(robot: Robot, held: list[Held], world: World, rng: np.random.Generator) -> list[float]:
    """Masses of the objects that the arm can hold at start and goal [kg]."""
    shares = np.where(rng.random(len(held)) < WEIGHTLESS, 0.0, rng.random(len(held)))
    data, most = robot.model.createData(), 2e3
    loaded = robot.model.copy()
    for each, share in zip(held, shares.tolist(), strict=True):
        frame = loaded.frames[loaded.getFrameId(each.frame)]
        body = pin.Inertia(share, each.inertia.lever, share * each.inertia.inertia)
        loaded.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    for q in (world.start, world.goal):
        still = np.zeros(robot.dof)
        empty = np.array(pin.rnea(robot.model, data, q, still, still))
        added = np.array(pin.rnea(loaded, loaded.createData(), q, still, still)) - empty
        left = np.maximum(AT_REST * robot.torque_limit - np.abs(empty), 0.0)
        most = min(most, float((left / np.maximum(np.abs(added), 1e-9)).min()))
    return [float(mass) for mass in most * rng.random() * shares]


def torque_use(robot: Robot, loaded: pin.Model, motion: Trajectory) -> float:
    """Largest fraction of a torque limit between the samples of a motion, by inverse dynamics."""
    spline = CubicHermiteSpline(motion.time, motion.position, motion.velocity)
    clock = (motion.time[:-1, None] + np.diff(motion.time)[:, None] * np.array([1e-6, 0.5, 1.0 - 1e-6])).ravel()
    data, states = loaded.createData(), (spline(clock), spline(clock, 1), spline(clock, 2))
    torque = np.array([pin.rnea(loaded, data, *row) for row in zip(*states, strict=True)])
    return float((np.abs(torque) / robot.torque_limit).max(initial=0.0))


def _row(config: StudyConfig, number: int) -> Row:
    return hold(config.seed, number).row(number)


HELD = Study(
    "held",
    "motions of random arms that hold random objects: contacts by coal, torques by Pinocchio",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
