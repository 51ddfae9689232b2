"""Motions of a random arm in a random world, one after the other, each looked at by the judge.

A case is an arm and a few worlds. In each a motion is planned; it is stopped at random instants, scaled, and while it
runs the world changes and a new motion is spliced in. Whatever is handed out as verified is looked at by
`studies.validation.judge` in the world as it is. A case follows from the seed and its number alone.
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
from studies.harness import Asked, Row, Study
from studies.validation.arms import DrawnArm, draw_arm
from studies.validation.judge import Motion, Window, contacts
from studies.validation.random_scenes import direction
from studies.validation.worlds import (
    BALL_M,
    SEEN,
    World,
    bad_frame,
    camera_pose,
    draw_item,
    draw_seen,
    draw_world,
    free,
    obstacle,
    seen_from_base,
    surface,
)

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import HplanError, NotOnMotionError, RunningMotionBlockedError
from hplan.online.frame import CloudOptions
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.scene.model import Goal
from hplan.trajectory.trajectory import Trajectory, write_csv

#: Worlds of a case, changes while a motion runs, and stops between them.
WORLDS, CHANGES, STOPS = 4, 4, 3

#: Frames of a failing camera after each good one.
BAD_FRAMES = 3

#: How long until something changes, and how much later a new motion may take over [s].
PAUSE_S, AHEAD_S = (0.02, 0.6), 0.1

#: CPU time for which a motion is looked for [s]; a case in which much is called once.
patience_s, _WARM = 0.8, 8

#: Share of changes at which the arm is said to be elsewhere.
ELSEWHERE = 0.2

#: How far a splice may be from where the motion before it is [rad, m].
JUMP = 1e-6


@dataclass
class Tally:
    """What was counted in a case.

    Attributes:
        arms: Arms by kind.
        refused: Calls without a motion, by the error.
        looked: Motions that were looked at, by kind.
        looked_in: These motions, by what the world was.
        unverified: Stops, scalings and splices that were not verified, by kind.
        ticks: Configurations that were looked at.
        faults: Contacts and jumps, each with what it needs to be found again.
    """

    arms: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    looked: Counter[str] = field(default_factory=Counter)
    looked_in: Counter[str] = field(default_factory=Counter)
    unverified: Counter[str] = field(default_factory=Counter)
    ticks: int = 0
    faults: list[Row] = field(default_factory=list)

    def row(self, name: object) -> Row:
        """The row of a case."""
        motions = sum(self.looked.values())
        return {"name": str(name), "motions": motions, **vars(self), "fault": bool(self.faults)}


#: What a summary adds up of the rows of tallies.
COUNTED = ("motions", "ticks", "arms", "looked", "looked_in", "unverified", "refused")


def run_case(seed: int, number: int) -> Tally:
    """One arm, and its worlds."""
    warm_up()
    return _run_case(seed, number)


@functools.cache
def warm_up() -> None:
    """Load kernels, which would count as time in which a motion is looked for."""
    global patience_s
    kept, patience_s = patience_s, 60.0
    _run_case(0, _WARM)
    patience_s = kept


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
        world: What is there now; tracks on their own clock.
        rng: Where numbers come from.
        tally: Where it is counted.
        folder: Where files may be written.
        name: Of the case and its world.
    """

    drawn: DrawnArm
    world: World
    rng: np.random.Generator
    tally: Tally
    folder: Path
    name: str

    def run(self) -> None:
        """Plan, stop, scale; change the world and go on."""
        rng = self.rng
        options = PlanOptions(
            effort="quick" if rng.random() < 0.6 else "default", step_deg=6.0, rate_hz=float(rng.choice([100.0, 250.0]))
        )  # fmt: skip
        self.planner = Planner(self.drawn.robot, self.world.scene(), options)
        self.frame(self.world.start, self.world.begin_s)
        try:
            found = self.planner.plan(begins_s=self.world.begin_s, cancel=impatient())
        except HplanError as error:
            self.tally.refused[error.kind] += 1
            return
        self.look("plan", found.begins_s, found.trajectory, found.certificate)
        self.retimed(found, found.begins_s)
        for _ in range(CHANGES):
            later = self.changed(found)
            if later is None:
                return
            found = later

    def retimed(self, running: PlanResult, now: float, *, changed: bool = False) -> None:
        """Stops, and the whole motion slower: that in the world that it was planned in alone."""
        begins_s, duration = running.begins_s, running.trajectory.duration
        for _ in range(STOPS):
            t = float(self.rng.uniform(now, begins_s + duration))
            self.certified("stop", begins_s, now, functools.partial(self.planner.stop_at, t, now=now))
        if not changed:
            factor = float(self.rng.uniform(0.3, 1.0))
            self.certified("scaled", begins_s, now, lambda: running.scaled(factor))

    def certified(self, kind: str, begins_s: float, now: float, ask: Callable[[], CertifiedMotion]) -> None:
        """Look at a motion along the running one's path."""
        try:
            found = ask()
        except HplanError as error:
            self.tally.refused[f"{kind}: {error.kind}"] += 1
            return
        self.look(kind, begins_s, found.trajectory, found.certificate, from_s=now - begins_s)

    def changed(self, running: PlanResult) -> PlanResult | None:
        """The world changes, and a motion goes on; None where none does."""
        end = running.begins_s + running.trajectory.duration
        now = float(min(running.begins_s + self.rng.uniform(*PAUSE_S), end))
        q = running.trajectory.positions(np.array([now - running.begins_s]))[0]
        self.change(q, now)
        self.retimed(running, now, changed=True)
        self.elsewhere(q, now)
        try:
            found = self.planner.replan(at=min(now + AHEAD_S, end), now=now, measured=q, cancel=impatient())
        except RunningMotionBlockedError as error:
            self.tally.refused["splice: blocked"] += 1
            if error.stop is not None:
                self.look("blocked stop", error.begins_s, error.stop, error.certificate)
            return None
        except HplanError as error:
            self.tally.refused[f"splice: {error.kind}"] += 1
            return None
        before = running.trajectory.positions(np.array([found.begins_s - running.begins_s]))[0]
        jump = float(np.abs(found.trajectory.position[0] - before).max())
        if jump > JUMP:
            self.tally.faults.append({"case": self.name, "kind": "splice", "jump": jump})
        self.look("kept" if found.is_kept else "splice", found.begins_s, found.trajectory, found.certificate)
        self.retimed(found, found.begins_s)
        return found

    def elsewhere(self, q: FloatArray, now: float) -> None:
        """An arm that is not on the motion is not taken over, nor stopped."""
        if self.rng.random() < ELSEWHERE:
            try:
                self.planner.stop_at(now, now=now, measured=q + self.rng.choice([-0.01, 0.01], len(q)))
            except NotOnMotionError:
                return
            self.tally.faults.append({"case": self.name, "kind": "an arm elsewhere was taken for on the motion"})

    def look(
        self, kind: str, begin_s: float, trajectory: Trajectory, certificate: Certificate, *, from_s: float = 0.0
    ) -> None:
        """Judge a motion, if it is verified."""
        if not certificate.verified:
            self.tally.unverified[kind] += 1
            return
        path = write_csv(trajectory, self.folder / "motion.csv", whole=True)
        motion = Motion.read(path, from_s)
        world = self.world
        allowed = windows(certificate, world.fruits)
        found = contacts(self.drawn.arm, motion, world.things, base=world.moves, begin_s=begin_s, windows=allowed)
        self.tally.looked[kind] += 1
        self.tally.looked_in[f"{'moving' if self.moves else 'still'}{', cloud' if world.seen is not None else ''}"] += 1
        self.tally.ticks += len(motion.times)
        if found:
            deepest = vars(max(found, key=lambda contact: contact.depth_m))
            told = {"claimed_m": certificate.min_clearance_m, "begin_s": begin_s, "base": world.base is not None}
            self.tally.faults.append({"case": self.name, "arm": self.drawn.kind, "kind": kind, **deepest, **told})

    @property
    def moves(self) -> bool:
        """Whether anything but the arm moves."""
        return self.world.base is not None or any("track" in item for item in self.world.items)

    # What changes

    def frame(self, q: FloatArray, time_s: float) -> None:
        """The camera looks: what is seen is told to the planner, points of the arm and of fruit with it."""
        world, rng, arm = self.world, self.rng, self.drawn.arm
        if world.seen is None:
            return
        own = [  # the arm's own
            place.act(body.middle)[None] for body, place in
            zip(arm.bodies, arm.places(arm.configurations(arm.joints, q[None])[0]), strict=True)
        ]  # fmt: skip
        balls = [each for each in world.balls_at(time_s) if each["name"] == world.target or rng.random() < 0.5]
        there = np.concatenate([world.seen, *(surface(rng, each, 0.01) for each in balls)])
        points = np.concatenate([seen_from_base(world, there, time_s), *own])
        pose = camera_pose(rng, 1.0)
        options = CloudOptions(growth_m=float(rng.choice([0.002, 0.005, 0.02])), allow_empty=not len(there))
        local = (rng.permutation(points) - pose[:3, 3]) @ pose[:3, :3]
        frame: dict[str, Any] = {
            "points": local,
            "pose": pose,
            "joints": q,
            "time_s": time_s,
            "radius": BALL_M,
            "options": options,
        }
        frame["ignore"] = [each["name"] for each in balls]
        self.planner.set_cloud(SEEN, **frame)
        own_local = (np.concatenate(own) - pose[:3, 3]) @ pose[:3, :3]
        for _ in range(BAD_FRAMES * bool(len(there))):
            bad = bad_frame(rng, local, own_local, pose, time_s)
            try:
                self.planner.set_cloud(SEEN, **{**frame, **bad})
            except HplanError as error:
                self.tally.refused[f"bad frame: {error.kind}"] += 1
            else:
                self.tally.faults.append({"case": self.name, "kind": "a bad frame was taken", "frame": str(bad)})

    def change(self, q: FloatArray, time_s: float) -> None:
        """Something comes, goes, moves or is seen anew; or the arm is to go elsewhere; or nothing changes."""
        world, rng, planner = self.world, self.rng, self.planner
        changes = (
            ["add", "aim", "aim", "aim", "nothing"]
            + ["move", "remove"] * bool(world.items)
            + ["see"] * (2 * (world.seen is not None))
        )
        changes += ["fruit"] * (world.target is not None)
        what = changes[int(rng.integers(len(changes)))]
        if what == "add":
            for item in free(
                self.drawn, world, [draw_item(self.drawn, world, rng, f"new {rng.integers(1 << 40)}")], q, time_s
            ):
                planner.add(obstacle(item))
                self.world = replace(world, items=(*world.items, item))
        elif what == "remove":
            gone = world.items[int(rng.integers(len(world.items)))]
            planner.remove(gone["name"])
            self.world = replace(world, items=tuple(item for item in world.items if item is not gone))
        elif what == "move":
            k = int(rng.integers(len(world.items)))
            moved = shifted(world.items[k], direction(rng) * rng.uniform(0.01, 0.2))
            for item in free(self.drawn, world, [moved], q, time_s):
                keys = (("center", "center"), ("position", "position"), ("from", "start"), ("to", "end"))
                planner.move(item["name"], **{key: tuple(item[ours]) for ours, key in keys if ours in item})
                self.world = replace(world, items=(*world.items[:k], item, *world.items[k + 1 :]))
        elif what == "see":
            self.world = replace(world, seen=draw_seen(self.drawn, world, rng, q, time_s))
            self.frame(q, time_s)
        elif what == "aim":
            goals = [q for q in self.drawn.arm.drawn(rng, 20) if self.drawn.arm.has_room(q, 0.02)]
            if goals:
                goal = q + (goals[0] - q) * rng.uniform(0.1, 0.6)
                planner.aim(goal=Goal(joints_rad=tuple(goal.tolist())))
                self.world = replace(world, goal=goal, target=None)
        elif what == "fruit":
            fruits = tuple(shifted(fruit, direction(rng) * rng.uniform(0.0, 0.1)) for fruit in world.fruits)
            self.world = replace(world, fruits=fruits)
            planner.scene = planner.scene.with_(fruits=self.world.scene().fruits)


def impatient() -> Callable[[], bool]:
    """Whether a call has taken too long, by CPU time: so results do not depend on what else runs."""
    until = time.process_time() + patience_s
    return lambda: time.process_time() > until


def windows(certificate: Certificate, fruits: Sequence[dict[str, Any]]) -> list[Window]:
    """When fruits may be touched that are where they were when that was allowed."""
    where = {fruit["name"]: tuple(fruit["center"]) for fruit in fruits}
    return [
        Window(contact.fruit.name, *contact.span_s)
        for contact in certificate.contacts
        if where.get(contact.fruit.name) == contact.fruit.center
    ]


def shifted(item: dict[str, Any], shift: FloatArray) -> dict[str, Any]:
    """An obstacle elsewhere."""
    keys = ("from", "to") if item["kind"] == "capsule" else ("center",) if "center" in item else ("position",)
    return {**item, **{key: (np.array(item[key]) + shift).tolist() for key in keys}}


def _row(asked: Asked, number: int) -> Row:
    return run_case(asked.seed, number).row(number)


MOTIONS = Study(
    "motions",
    "plans, stops, scalings and splices of random arms, each looked at by Pinocchio and coal every half millisecond",
    _row,
    ("motions",),
    totals=COUNTED,
    count=(20, 1),
    warm=0,
)
