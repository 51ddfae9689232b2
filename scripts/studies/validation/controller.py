"""Messages run by a model of ROS 2's `joint_trajectory_controller`: stops and splices, and motions of strangers.

`Controller` follows the documentation and the source of ros2_controllers (`trajectory.cpp`): a message replaces the one
before it; its points count from its stamp, or from its first sample if the stamp is 0; between the state at its first
sample and its first point, and between points, the curve is a quintic, a cubic or a straight line by the fields that
both points have. Nothing here uses hplan's curves.

- `handovers`: a motion is sent, and while it runs stops, other speeds and splices are. At the cycle in which a message
  arrives the commanded position must not jump, and the velocity by no more than a cycle at full acceleration allows.
- `strangers`: rows of all kinds, 2 to 500 Hz, and an obstacle that the controller's curve touches, or is clear of.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly
from studies.harness import Asked, Row, Study
from studies.validation.arms import DrawnArm, draw_arm
from studies.validation.episodes import COUNTED, JUMP, Tally, impatient, warm_up
from studies.validation.grazing import DEPTHS, GAPS, placed
from studies.validation.judge import Motion
from studies.validation.worlds import World, draw_ends, obstacle

from hplan.apps.ros import from_joint_trajectory, to_joint_trajectory
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import certify
from hplan.errors import HplanError, OptionError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.scene.model import Goal
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory

Message = Mapping[str, Any]

#: Period of the controller [ns].
CYCLE_NS = 2_000_000

#: Messages of a motion, and strangers' motions of an arm.
HANDOVERS, STRANGERS = 5, 4

#: Rows a second of strangers.
RATES_HZ = (2.0, 500.0)


def curve(times: FloatArray, points: list[FloatArray]) -> BPoly:
    """The polynomials that have, at each time, a value and as many derivatives as there are rows of a point."""
    return BPoly.from_derivatives(times, points)


def _ns(time: Mapping[str, int]) -> int:
    return int(time["sec"]) * 10**9 + int(time["nanosec"])


class Controller:
    """`joint_trajectory_controller` with a position interface, its state the last command."""

    def __init__(self, joint_names: tuple[str, ...], position: FloatArray) -> None:
        self.joint_names = list(joint_names)
        self.state = np.asarray(position, dtype=np.float64), np.zeros(len(joint_names))
        self._points: list[FloatArray] = []
        self._times: list[int] = []
        self._start_ns: int | None = None
        self._before: tuple[int, tuple[FloatArray, FloatArray]] | None = None

    def receive(self, message: Message, now_ns: int) -> None:
        """Take a message in place of the last one; a ValueError says why it is rejected."""
        points, stamp = message["points"], _ns(message["header"]["stamp"])
        times = [_ns(point["time_from_start"]) for point in points]
        if sorted(message["joint_names"]) != sorted(self.joint_names) or not points:
            raise ValueError("joint names, or no points")
        if any(point["effort"] for point in points):
            raise ValueError("efforts without an effort interface")
        if any(after <= before for before, after in pairwise(times)):
            raise ValueError("times do not increase")
        if stamp and stamp + times[-1] < now_ns:
            raise ValueError("the trajectory ends in the past")
        order = [message["joint_names"].index(name) for name in self.joint_names]
        fields = ("positions", "velocities", "accelerations")
        self._points = [
            np.array([point[f] for f in fields if point[f]], dtype=np.float64)[:, order] for point in points
        ]
        self._times, self._start_ns, self._before = times, stamp or None, None

    def update(self, now_ns: int) -> tuple[FloatArray, FloatArray]:
        """The commanded position and velocity of a cycle."""
        if not self._points:
            return self.state
        if self._start_ns is None:
            self._start_ns = now_ns
        if self._before is None:
            self._before = now_ns, self.state
        at = now_ns - self._start_ns
        if at < self._times[0]:
            self.state = _between(self._before[0], np.stack(self._before[1]), self._start_ns + self._times[0],
                self._points[0], now_ns)  # fmt: skip
        elif at >= self._times[-1]:
            last = self._points[-1]
            self.state = last[0], last[1] if len(last) > 1 else np.zeros_like(last[0])
        else:
            k = int(np.searchsorted(self._times, at, side="right")) - 1
            self.state = _between(self._times[k], self._points[k], self._times[k + 1], self._points[k + 1], at)
        return self.state


def _between(a_ns: int, first: FloatArray, b_ns: int, second: FloatArray, at_ns: int) -> tuple[FloatArray, FloatArray]:
    """Position and velocity between two points, by the fields that both have."""
    count, seconds = min(len(first), len(second)), 1e-9 * (b_ns - a_ns)
    found = curve(np.array([0.0, seconds]), [first[:count], second[:count]])
    at = 1e-9 * (at_ns - a_ns)
    return found(at), found(at, 1)


def handovers(seed: int, number: int) -> Tally:
    """A motion of a random arm, and messages that take over while it runs."""
    warm_up()
    rng, tally = np.random.default_rng([seed, number, 21]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn = draw_arm(Path(name), rng)
            ends = draw_ends(drawn, rng, 0.01)
            if ends is None:
                return tally
            tally.arms[drawn.kind] += 1
            planner = Planner(drawn.robot, World(*ends).scene(), PlanOptions(effort="quick"))
            begins_s = float(rng.choice([0.5, 100.0, 1.79e9])) + float(rng.random())
            running = planner.plan(begins_s=begins_s, cancel=impatient())
        except HplanError as error:
            tally.refused[error.kind] += 1
            return tally
        sent: tuple[Trajectory, float] = running.trajectory, begins_s
        for count in range(HANDOVERS):
            begin_s, duration = planner.last.begins_s, planner.last.trajectory.duration  # type: ignore[union-attr]
            now = begin_s + float(rng.uniform(0.0, 0.9)) * duration
            kind, arrives_s = str(rng.choice(["planner stop", "stop", "splice", "scaled"])), now + 0.02
            try:
                found = _taken_over(planner, kind, now, arrives_s + 0.03, rng)
            except HplanError as error:
                tally.refused[f"{kind}: {error.kind}"] += 1
                continue
            if not found[0].samples > 1 or arrives_s >= begin_s + duration:
                continue
            tally.looked[kind] += 1
            case = {"case": f"{number}.{count}", "kind": kind, "now_s": now - begin_s}
            tally.faults += [{**case, **fault} for fault in _jumps(drawn, sent, found, arrives_s)]
            if kind == "splice":
                sent = found
    return tally


def _taken_over(
    planner: Planner, kind: str, now: float, at: float, rng: np.random.Generator
) -> tuple[Trajectory, float]:
    """A motion that takes over from the running one, and when its first row is."""
    running = planner.last
    if running is None:
        raise OptionError("running", None, "a motion")
    at = min(at, running.begins_s + running.trajectory.duration)
    if kind == "planner stop":
        stop = planner.stop_at(at, now=now)
        return stop.trajectory, stop.begins_s
    if kind in ("stop", "scaled"):
        since = at - running.begins_s
        slow = running.stop_at(since) if kind == "stop" else running.scaled([(0, 1), (since, 1), (since + 0.1, 0.5)])
        return slow.trajectory, slow.begins_s
    robot = planner.robot
    step = rng.uniform(-0.3, 0.3, robot.dof)
    goal = np.clip(running.trajectory.position[-1] + step, robot.lower, robot.upper)
    planner.aim(goal=Goal(joints_rad=tuple(goal.tolist())))
    splice = planner.replan(at=at, now=now, cancel=impatient())
    return splice.trajectory, splice.begins_s


def _jumps(
    drawn: DrawnArm, sent: tuple[Trajectory, float], found: tuple[Trajectory, float], arrives_s: float
) -> Iterator[Row]:
    """How commands jump in the cycle in which a message arrives, and in any later one; none should."""
    robot = drawn.robot
    try:
        to_joint_trajectory(found[0])
        yield {"fault": "a message without a stamp"}
    except OptionError:
        pass
    controller = Controller(robot.joint_names, sent[0].position[0])
    arrives_ns = round(arrives_s * 1e9)
    before = arrives_ns - CYCLE_NS
    controller.receive(to_joint_trajectory(sent[0], stamp_s=sent[1]), before)
    controller.update(before)
    on_time = controller.update(arrives_ns)
    controller.receive(to_joint_trajectory(found[0], stamp_s=found[1]), arrives_ns)
    now = controller.update(arrives_ns)
    jump = float(np.abs(now[0] - on_time[0]).max())
    kick = float((np.abs(now[1] - on_time[1]) / (robot.acceleration_limit * 1e-9 * CYCLE_NS)).max())
    if jump > JUMP or kick > 1.0:
        yield {"fault": "arrival", "jump_rad": jump, "kick": kick}
    for at in range(arrives_ns + CYCLE_NS, round(1e9 * (found[1] + found[0].duration)), CYCLE_NS):
        last, now = now, controller.update(at)
        off = np.abs(now[0] - last[0] - 0.5e-9 * CYCLE_NS * (now[1] + last[1]))
        if (off > JUMP + 1e-18 * CYCLE_NS**2 * robot.acceleration_limit).any():
            yield {"fault": "later", "at_s": 1e-9 * (at - arrives_ns), "jump_rad": float(off.max())}
            return


def strangers(seed: int, number: int) -> Tally:
    """Strangers' motions of a random arm, and of each whether one that touches an obstacle is verified."""
    warm_up()
    rng, tally = np.random.default_rng([seed, number, 22]), Tally()
    with tempfile.TemporaryDirectory() as name:
        try:
            drawn = draw_arm(Path(name), rng)
        except HplanError as error:
            tally.refused[error.kind] += 1
            return tally
        tally.arms[drawn.kind] += 1
        for count in range(STRANGERS):
            ends = draw_ends(drawn, rng, 0.01)
            if ends is not None:
                _one_stranger(drawn, World(*ends), rng, tally, f"{number}.{count}")
    return tally


def _one_stranger(drawn: DrawnArm, world: World, rng: np.random.Generator, tally: Tally, case: str) -> None:
    """One motion without an obstacle, and with one, which touches it three times out of four."""
    robot = drawn.robot
    fields = int(rng.integers(1, 4))
    told: Interpolation | None = "cubic" if fields == 3 and rng.random() < 0.2 else None
    message, true = _message(drawn, world, rng, fields, told)
    motion = from_joint_trajectory(message, robot=robot, interpolation=told)
    jumps = motion.interpolation == "linear"
    kind, scene = f"{motion.interpolation}, {fields} fields", world.scene()
    if not certify(robot, scene, motion, velocity_jumps=jumps, check_ends=False).verified:
        tally.unverified[kind] += 1
        return
    clock = np.unique(np.concatenate([motion.time, np.linspace(0.0, motion.duration, 400)]))
    touches = bool(rng.random() < 0.75)
    gap = -math.exp(rng.uniform(*np.log(DEPTHS))) if touches else math.exp(rng.uniform(*np.log(GAPS)))
    made = placed(drawn, Motion(robot.joint_names, clock, true(clock)), rng, gap)
    if made is None:
        return
    item, body = made
    scene = scene.model_copy(update={"obstacles": (obstacle(item),)})
    verified = certify(robot, scene, motion, velocity_jumps=jumps, check_ends=False).verified
    tally.looked[f"{kind}: {'touching' if touches else 'clear, verified' if verified else 'clear, refused'}"] += 1
    if verified and touches:
        tally.faults.append({"case": case, "kind": kind, "gap_m": gap, "body": body, "item": item})


def _message(
    drawn: DrawnArm, world: World, rng: np.random.Generator, fields: int, told: str | None
) -> tuple[dict[str, Any], Callable[[FloatArray], FloatArray]]:
    """Rows between two configurations with what a stranger's planner makes of them, and the controller's curve."""
    robot, (start, goal) = drawn.robot, (world.start, world.goal)
    rate = math.exp(rng.uniform(*np.log(RATES_HZ)))
    reach = np.abs(goal - start)
    seconds = float(max(3.0 * (reach / robot.velocity_limit).max(),
        3.5 * np.sqrt(reach / robot.acceleration_limit).max(), 2.0 / rate, 0.3))  # fmt: skip
    times = np.linspace(0.0, seconds, max(round(rate * seconds), 2) + 1)
    s = times / seconds
    shape = (
        s**3 * (10 - 15 * s + 6 * s * s),
        30 * s**2 * (1 - s) ** 2 / seconds,
        60 * s * (1 - s) * (1 - 2 * s) / seconds**2,
    )
    rows = np.stack([values[:, None] * (goal - start) for values in shape], axis=1)
    rows[:, 0] += start
    # A stranger's derivatives need not be those of his positions.
    h = seconds / (len(times) - 1)
    loose = np.minimum(0.3 * robot.acceleration_limit, 0.1 * robot.velocity_limit / h)
    rows[1:-1, 1] += 0.1 * h * loose * rng.uniform(-1.0, 1.0, rows[1:-1, 1].shape)
    rows[:, 2] += loose * rng.uniform(-1.0, 1.0, rows[:, 2].shape)
    stamps = [divmod(round(1e9 * time), 10**9) for time in times.tolist()]
    points = [
        {
            **{
                key: row[k].tolist() if k < fields else []
                for k, key in enumerate(("positions", "velocities", "accelerations"))
            },
            "effort": [],
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
        for row, (sec, nanosec) in zip(rows, stamps, strict=True)
    ]
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    used = 2 if told == "cubic" else fields
    exact = np.array([sec + 1e-9 * nanosec for sec, nanosec in stamps])
    true = curve(exact, list(rows[:, :used]))
    return {"header": header, "joint_names": list(robot.joint_names), "points": points}, true


def _handovers_row(asked: Asked, number: int) -> Row:
    return handovers(asked.seed, number).row(number)


def _strangers_row(asked: Asked, number: int) -> Row:
    return strangers(asked.seed, number).row(number)


MESSAGES = Study(
    "messages",
    "stops, other speeds and splices sent to a model of joint_trajectory_controller, whose commands must not jump",
    _handovers_row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)

STRANGERS_STUDY = Study(
    "strangers",
    "motions of strangers, which must not be verified if the curve that a controller runs touches an obstacle",
    _strangers_row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
