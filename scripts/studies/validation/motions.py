"""Motions of random arms in random worlds, checked by the judge.

A case is an arm and a few worlds. In each world a motion is planned, stopped at random times and scaled; while it runs,
the world changes and a new motion is spliced in. Every verified motion is checked by `studies.validation.judge` in the
actual world. A case depends only on the seed and its number.
"""

from __future__ import annotations

import functools
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from studies.harness import Row, Study, StudyConfig
from studies.validation.judge import SampledMotion, Window, contacts
from studies.validation.random_arms import DrawnArm, draw_arm
from studies.validation.random_worlds import (
    BALL_M,
    SEEN,
    World,
    camera_pose,
    direction,
    draw_item,
    draw_seen,
    draw_world,
    free,
    obstacle_of,
    shifted,
    surface,
)

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import HplanError, NotOnMotionError, RunningMotionBlockedError
from hplan.online.frame import CloudOptions
from hplan.online.planner import Planner
from hplan.planning.options import EffortName, PlanOptions
from hplan.planning.result import PlanResult
from hplan.scene.model import Goal
from hplan.trajectory.trajectory import Trajectory, write_csv

#: Worlds of a case, changes while a motion runs, stops between them, and bad frames after each good one.
WORLDS, CHANGES, STOPS, BAD_FRAMES = 4, 4, 3, 3

#: Time until something changes, and from then until a new motion may take over [s].
PAUSE_S, AHEAD_S = (0.02, 0.6), 0.1

#: CPU time limit of a plan [s]; a case that calls most functions once.
time_limit_s, _WARM = 0.8, 8

#: Share of changes at which a deviating arm is reported; maximum jump at a splice [rad, m].
OFF_MOTION, JUMP = 0.2, 1e-6


@dataclass
class Tally:
    """Counts of a case.

    Attributes:
        arms: Arms by kind.
        refused: Calls without a motion, by error.
        checked: Checked motions, by kind.
        checked_in: Checked motions, by the state of the world.
        unverified: Stops, scalings and splices that were not verified, by kind.
        ticks: Checked configurations.
        faults: Contacts and jumps, with all that is required to reproduce them.
    """

    arms: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    checked: Counter[str] = field(default_factory=Counter)
    checked_in: Counter[str] = field(default_factory=Counter)
    unverified: Counter[str] = field(default_factory=Counter)
    ticks: int = 0
    faults: list[Row] = field(default_factory=list)

    def row(self, name: object) -> Row:
        """The row of a case."""
        motions = sum(self.checked.values())
        return {"name": str(name), "motions": motions, **vars(self), "fault": bool(self.faults)}


#: Counts that a summary adds up.
COUNTED = ("motions", "ticks", "arms", "checked", "checked_in", "unverified", "refused")


def run_case(seed: int, number: int) -> Tally:
    """Plan and check motions of one arm in a few worlds."""
    warm_up()
    return _run_case(seed, number)


@functools.cache
def warm_up() -> None:
    """Load kernels, whose compilation would count towards the time limit."""
    global time_limit_s
    kept, time_limit_s = time_limit_s, 60.0
    _run_case(0, _WARM)
    time_limit_s = kept


def _run_case(seed: int, number: int) -> Tally:
    rng, tally = np.random.default_rng([seed, number]), Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            drawn = draw_arm(folder, rng)
        except HplanError as error:
            tally.refused[f"robot: {error.kind}"] += 1
            return tally
        tally.arms[drawn.kind] += 1
        for count in range(WORLDS):
            own = np.random.default_rng([seed, number, count])
            moving, camera = bool(own.random() < 0.5), bool(own.random() < 0.5)
            world = draw_world(drawn, own, moving=moving, camera=camera)
            if world is not None:
                Episode(drawn, world, own, tally, folder, f"{number}.{count}").run()
    return tally


@dataclass(eq=False)
class Episode:
    """A world, and the planner in it.

    Attributes:
        drawn: The arm.
        world: The current world; tracks are on their own clock.
        rng: Random generator.
        tally: Counts.
        folder: Folder for files.
        name: Name of the case and its world.
    """

    drawn: DrawnArm
    world: World
    rng: np.random.Generator
    tally: Tally
    folder: Path
    name: str

    def run(self) -> None:
        """Plan, stop and scale; then change the world and continue."""
        rng, start_time_s = self.rng, self.world.start_time_s
        effort: EffortName = "quick" if rng.random() < 0.6 else "default"
        options = PlanOptions(effort=effort, step_deg=6.0, rate_hz=float(rng.choice([100.0, 250.0])))
        self.planner = Planner(self.drawn.robot, self.world.scene(), options)
        self.take_frame(self.world.start, start_time_s)
        try:
            found = self.planner.plan(begins_s=start_time_s, cancel=impatient())
        except HplanError as error:
            self.tally.refused[error.kind] += 1
            return
        self.check("plan", found.begins_s, found.trajectory, found.certificate)
        self.retime(found, found.begins_s)
        for _ in range(CHANGES):
            later = self.replan(found)
            if later is None:
                return
            found = later

    def retime(self, running: PlanResult, now: float, *, changed: bool = False) -> None:
        """Check stops, and the whole motion slowed down in the world in which it was planned."""
        begins_s, duration = running.begins_s, running.trajectory.duration
        for _ in range(STOPS):
            t = float(self.rng.uniform(now, begins_s + duration))
            self.check_retimed("stop", begins_s, now, functools.partial(self.planner.stop_at, t, now=now))
        if not changed:
            factor = float(self.rng.uniform(0.3, 1.0))
            self.check_retimed("scaled", begins_s, now, lambda: running.scale_speed(factor))

    def check_retimed(self, kind: str, begins_s: float, now: float, retime: Callable[[], CertifiedMotion]) -> None:
        """Check a motion along the path of the running one."""
        try:
            found = retime()
        except HplanError as error:
            self.tally.refused[f"{kind}: {error.kind}"] += 1
            return
        self.check(kind, begins_s, found.trajectory, found.certificate, from_s=now - begins_s)

    def replan(self, running: PlanResult) -> PlanResult | None:
        """Change the world and replan; None without a motion."""
        end = running.begins_s + running.trajectory.duration
        now = float(min(running.begins_s + self.rng.uniform(*PAUSE_S), end))
        q = running.trajectory.positions(np.array([now - running.begins_s]))[0]
        self.change(q, now)
        self.retime(running, now, changed=True)
        self.report_deviation(q, now)
        try:
            found = self.planner.replan(at=min(now + AHEAD_S, end), now=now, measured=q, cancel=impatient())
        except RunningMotionBlockedError as error:
            self.tally.refused["splice: blocked"] += 1
            if error.stop is not None:
                self.check("blocked stop", error.begins_s, error.stop, error.certificate)
            return None
        except HplanError as error:
            self.tally.refused[f"splice: {error.kind}"] += 1
            return None
        before = running.trajectory.positions(np.array([found.begins_s - running.begins_s]))[0]
        jump = float(np.abs(found.trajectory.position[0] - before).max())
        if jump > JUMP:
            self.tally.faults.append({"case": self.name, "kind": "splice", "jump": jump})
        self.check("kept" if found.is_kept else "splice", found.begins_s, found.trajectory, found.certificate)
        self.retime(found, found.begins_s)
        return found

    def report_deviation(self, q: FloatArray, now: float) -> None:
        """Require that a stop is refused if the measured arm is not on the motion."""
        if self.rng.random() < OFF_MOTION:
            try:
                self.planner.stop_at(now, now=now, measured=q + self.rng.choice([-0.01, 0.01], len(q)))
            except NotOnMotionError:
                return
            self.tally.faults.append({"case": self.name, "kind": "a deviating arm counted as on the motion"})

    def check(
        self, kind: str, start_time_s: float, motion: Trajectory, certificate: Certificate, *, from_s: float = 0.0
    ) -> None:
        """Let the judge check a motion, if it is verified."""
        if not certificate.verified:
            self.tally.unverified[kind] += 1
            return
        seen = SampledMotion.read(write_csv(motion, self.folder / "motion.csv", whole=True), from_s)
        world, base = self.world, self.world.base_track
        allowed = windows(certificate, world.fruits)
        found = contacts(self.drawn.arm, seen, world.obstacles, base=base, start_time_s=start_time_s, windows=allowed)
        is_moving = base is not None or any("track" in item for item in world.items)
        self.tally.checked[kind] += 1
        self.tally.checked_in[f"{'moving' if is_moving else 'still'}{', cloud' if world.seen is not None else ''}"] += 1
        self.tally.ticks += len(seen.times)
        if found:
            deepest = vars(max(found, key=lambda contact: contact.depth_m))
            claim = {"claimed_m": certificate.min_clearance_m, "start_time_s": start_time_s, "base": base is not None}
            self.tally.faults.append({"case": self.name, "arm": self.drawn.kind, "kind": kind, **deepest, **claim})

    # Changes of the world

    def take_frame(self, q: FloatArray, time_s: float) -> None:
        """Pass a camera frame to the planner, with points of the arm and of fruit, and then some bad frames."""
        world, rng, arm = self.world, self.rng, self.drawn.arm
        if world.seen is None:
            return
        places = arm.places(arm.configurations(arm.joints, q[None])[0])
        own = np.array([place.act(body.middle) for body, place in zip(arm.bodies, places, strict=True)])
        balls = [each for each in world.balls_at(time_s) if each["name"] == world.target or rng.random() < 0.5]
        true = np.concatenate([world.seen, *(surface(rng, each, 0.01) for each in balls)])
        pose = camera_pose(rng, 1.0)
        points = np.concatenate([world.from_base(true, time_s), own])
        local, own_local = ((each - pose[:3, 3]) @ pose[:3, :3] for each in (rng.permutation(points), own))
        frame: dict[str, Any] = {
            "points": local, "pose": pose, "joints": q, "time_s": time_s, "radius": BALL_M,
            "options": CloudOptions(growth_m=float(rng.choice([0.002, 0.005, 0.02])), allow_empty=not len(true)),
            "ignore": [each["name"] for each in balls],
        }  # fmt: skip
        self.planner.set_cloud(SEEN, **frame)
        for _ in range(BAD_FRAMES * bool(len(true))):
            bad = bad_frame(rng, local, own_local, pose, time_s)
            try:
                self.planner.set_cloud(SEEN, **{**frame, **bad})
            except HplanError as error:
                self.tally.refused[f"bad frame: {error.kind}"] += 1
            else:
                self.tally.faults.append({"case": self.name, "kind": "a bad frame was accepted", "frame": str(bad)})

    def change(self, q: FloatArray, time_s: float) -> None:
        """Change obstacles, camera points, fruit or the goal, or nothing."""
        world, rng, planner = self.world, self.rng, self.planner
        changes = ["add", "aim", "aim", "aim", "nothing", *["move", "remove"] * bool(world.items)]
        changes += ["see"] * (2 * (world.seen is not None)) + ["fruit"] * (world.target is not None)
        match str(rng.choice(changes)):
            case "add":
                drawn = draw_item(self.drawn, world, rng, f"new {rng.integers(1 << 40)}")
                for item in free(self.drawn, world, [drawn], q, time_s):
                    planner.add(obstacle_of(item))
                    self.world = replace(world, items=(*world.items, item))
            case "remove":
                gone = world.items[int(rng.integers(len(world.items)))]
                planner.remove(gone["name"])
                self.world = replace(world, items=tuple(item for item in world.items if item is not gone))
            case "move":
                k = int(rng.integers(len(world.items)))
                moved = shifted(world.items[k], direction(rng) * rng.uniform(0.01, 0.2))
                for item in free(self.drawn, world, [moved], q, time_s):
                    keys = (("center", "center"), ("position", "position"), ("from", "start"), ("to", "end"))
                    planner.move(item["name"], **{key: tuple(item[ours]) for ours, key in keys if ours in item})
                    self.world = replace(world, items=(*world.items[:k], item, *world.items[k + 1 :]))
            case "see":
                self.world = replace(world, seen=draw_seen(self.drawn, world, rng, q, time_s))
                self.take_frame(q, time_s)
            case "aim":
                goals = [q for q in self.drawn.arm.drawn(rng, 20) if self.drawn.arm.is_clear_of_itself(q, 0.02)]
                if goals:
                    goal = q + (goals[0] - q) * rng.uniform(0.1, 0.6)
                    planner.aim(goal=Goal(joints_rad=tuple(goal.tolist())))
                    self.world = replace(world, goal=goal, target=None)
            case "fruit":
                fruits = tuple(shifted(fruit, direction(rng) * rng.uniform(0.0, 0.1)) for fruit in world.fruits)
                self.world = replace(world, fruits=fruits)
                planner.scene = planner.scene.with_values(fruits=self.world.scene().fruits)


def bad_frame(
    rng: np.random.Generator, points: FloatArray, own: FloatArray, pose: FloatArray, time_s: float
) -> dict[str, Any]:
    """A fault of a frame, as arguments of `set_cloud`: a failing camera, a wrong unit or pose, an old stamp.

    Args:
        rng: Random generator.
        points: (n, 3) points of a good frame, in the camera's frame [m].
        own: (k, 3) points of the arm, in the camera's frame [m].
        pose: (4, 4) camera to `base_link`.
        time_s: Time stamp of the good frame [s].
    """
    nothing = float(rng.choice([0.0, np.nan, np.inf, -np.inf]))
    lost = np.where(rng.random((len(points), 1)) < rng.uniform(0.6, 1.0), nothing, points)
    skewed, far, turned = pose.copy(), pose.copy(), pose.copy()
    skewed[:3, :3] *= rng.uniform(1.01, 2.0)
    far[:3, 3] = 1e3 * pose[:3, 3] + 1e3
    turned[:3, 3] += 30.0 * direction(rng)
    rays = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    clouds: tuple[Any, ...] = (
        np.full_like(points, nothing), lost, points[:0], 1e3 * points, np.rint(1e3 * points).astype(np.int32),
        rng.choice([20.0, 65.535, 1e30]) * rays, own, points[:, :2], points.astype(str),
    )  # fmt: skip
    faults: list[dict[str, Any]] = [{"points": cloud} for cloud in clouds]
    faults += [{"pose": wrong} for wrong in (skewed, far, turned)]
    old = time_s - rng.uniform(1e-3, 10.0)
    faults += [{"time_s": old}, {"points": points[:0], "time_s": old}, {"time_s": None}]
    return faults[int(rng.integers(len(faults)))]


def impatient() -> Callable[[], bool]:
    """A cancel function that returns True after `time_limit_s` of CPU time, independent of the machine's load."""
    until = time.process_time() + time_limit_s
    return lambda: time.process_time() > until


def windows(certificate: Certificate, fruits: Sequence[dict[str, Any]]) -> list[Window]:
    """Intervals in which fruit may be touched that is still where the certificate allowed it."""
    where = {fruit["name"]: tuple(fruit["center"]) for fruit in fruits}
    return [
        Window(contact.fruit.name, *contact.span_s)
        for contact in certificate.contacts
        if where.get(contact.fruit.name) == contact.fruit.center
    ]


def _row(config: StudyConfig, number: int) -> Row:
    return run_case(config.seed, number).row(number)


MOTIONS = Study(
    "motions",
    "plans, stops, scalings and splices of random arms, each checked by Pinocchio and coal every half millisecond",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
