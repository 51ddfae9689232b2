"""One planner for an hour: four threads call its methods by chance, at the rate of a camera.

One thread hands in frames, one plans and replans while the motion runs by the clock on the wall, one asks for stops,
one changes obstacles and goal, gives obstacles tracks and has the base drive, or stand again. Counted are errors that
are not hplan's, how long frames take, how much memory is in use, and contacts: a sample of what was handed out is
written down, with the true points of the frame that its scene holds, and looked at by the judge when the hour is over.
"""

from __future__ import annotations

import math
import os
import pickle
import tempfile
import threading
import time
from array import array
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from studies.harness import Asked, Row, Study
from studies.outside import things_of
from studies.validation.arms import DrawnArm, named_arm
from studies.validation.episodes import COUNTED, Tally, windows
from studies.validation.judge import Motion, Moves, Thing, contacts
from studies.validation.random_scenes import direction
from studies.validation.worlds import (
    BALL_M,
    SEEN,
    Item,
    World,
    camera_pose,
    draw_ends,
    draw_item,
    draw_track,
    free,
    middle_of,
    obstacle,
    seen_from_base,
    surface,
)

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import PointCloud
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory, write_csv

#: Frames, replans, stops and changes per second.
CAMERA_HZ, REPLAN_HZ, STOP_HZ, CHANGE_HZ = 30.0, 4.0, 4.0, 4.0

#: Points of a frame; clouds of which each frame shows one; how many frames' points are remembered.
POINTS, CLOUDS, REMEMBERED = 20_000, 12, 900

#: How long a plan may take; how much later a splice takes over [s].
DEADLINE_S, AHEAD_S = 0.5, 0.6

#: Known obstacles at most, and samples of motions that are looked at, at most.
MOST_KNOWN, MOST_SAMPLES = 30, 1500

#: Share of obstacles that get a track, and of changes with which the base drives or stands.
MOVING, DRIVING = 0.3, 0.03

#: Memory is looked at so often, and counts from then on [s].
MEMORY_EVERY_S, WARM_S = 10.0, 120.0


class _Soak:
    """The planner, and what its threads share."""

    def __init__(self, drawn: DrawnArm, seed: int, seconds: float, folder: Path) -> None:
        self.drawn, self.seed, self.folder = drawn, seed, folder
        self.tally, self.lock = Tally(), threading.Lock()
        # The camera stands on the base, which begins to drive, or stands, between two frames.
        self.driving = threading.Lock()
        self.base: Item | None = None
        self.until = time.monotonic() + seconds
        rng = np.random.default_rng(seed)
        ends = draw_ends(drawn, rng, 0.01)
        if ends is None:
            raise ValueError("the arm has no place to begin")
        self.home = World(*ends)
        items = free(drawn, self.home, [self.item(rng, f"known {k}") for k in range(8)])
        fruits = tuple(
            {"name": f"fruit {k}", "kind": "sphere", "center": at.tolist(), "radius": 0.035}
            for k, at in enumerate(drawn.robot.tool_positions(q) for q in drawn.arm.drawn(rng, 4))
        )
        world = World(*ends, items=tuple(items), fruits=fruits)
        self.clouds = [self.cloud(rng) for _ in range(CLOUDS)]
        self.frames: OrderedDict[str, int] = OrderedDict()
        self.planner = Planner(drawn.robot, world.scene(), PlanOptions(effort="quick", deadline_s=DEADLINE_S))
        self.frame_ms = array("f")  # on the wall, and of its thread's CPU, in turn
        self.handed = 0

    def cloud(self, rng: np.random.Generator) -> FloatArray:
        """Branches about the arm, as points."""
        found: list[FloatArray] = []
        while sum(map(len, found)) < POINTS:
            at = self.drawn.robot.tool_positions(self.drawn.arm.drawn(rng, 1)[0]) + direction(rng) * rng.uniform(0, 0.4)
            half = direction(rng) * rng.uniform(0.1, 0.6)
            item = {"kind": "capsule", "from": at - half, "to": at + half, "radius": float(rng.uniform(0.005, 0.03))}
            points = surface(rng, item, 0.004)
            found.append(points[self.drawn.arm.beside(self.home.start, points) > 0.05])
        return np.concatenate(found)[:POINTS]

    def item(self, rng: np.random.Generator, name: str) -> Item:
        """An obstacle that stands, or has a track from about now on."""
        item = draw_item(self.drawn, self.home, rng, name)
        return {**item, **self.track(rng, middle_of(item))} if rng.random() < MOVING else item

    def track(self, rng: np.random.Generator, about: list[float], turn_deg: float = 60.0) -> Item:
        return {"track": draw_track(rng, time.monotonic(), about, turn_deg)}

    def every(self, rate_hz: float, call: Callable[[np.random.Generator], None], number: int) -> None:
        """Call again and again until time is up; what is not hplan's error is a fault."""
        rng = np.random.default_rng([self.seed, number])
        while (begin := time.monotonic()) < self.until:
            try:
                call(rng)
            except HplanError as error:
                self.count("refused", f"{call.__name__}: {error.kind}")
            except Exception as error:  # that none is raised is what is looked for
                with self.lock:
                    self.tally.faults.append({"kind": "foreign exception", "call": call.__name__, "error": repr(error)})
            time.sleep(max(0.0, min(begin + 1.0 / rate_hz, self.until) - time.monotonic()))

    def count(self, name: str, what: str) -> None:
        with self.lock:
            getattr(self.tally, name)[what] += 1

    def keep(
        self, kind: str, scene: Scene, trajectory: Trajectory, certificate: Certificate, *, begin_s: float = 0.0,
        from_s: float = 0.0,
    ) -> None:  # fmt: skip
        """Write a sample of what was handed out; `begin_s` is when it begins, on the clock of the scene's tracks."""
        if not certificate.verified:
            self.count("unverified", kind)
            return
        seen = _digest(scene)
        with self.lock:
            cloud = -1 if seen is None else self.frames.get(seen)
        self.count("looked", kind)
        if cloud is None:
            return
        with self.lock:
            number, self.handed = self.handed, self.handed + 1
        if number >= MOST_SAMPLES:  # each is as likely to be kept
            number = int(np.random.default_rng().integers(number + 1))
        if number >= MOST_SAMPLES:
            return
        known = scene.with_(obstacles=tuple(o for o in scene.obstacles if o.name != SEEN))
        allowed = windows(certificate, [fruit.model_dump() for fruit in scene.fruits])
        sample = pickle.dumps((known, kind, cloud, allowed, begin_s, from_s))
        write_csv(trajectory, self.folder / f"{number}.csv", whole=True)
        (self.folder / f"{number}.pickle").write_bytes(sample)

    # What the four threads do

    def frame(self, rng: np.random.Generator) -> None:
        """The camera looks."""
        number = int(rng.integers(CLOUDS))
        pose = camera_pose(rng, 2.0)
        with self.driving:
            taken_s = time.monotonic()
            there = seen_from_base(replace(self.home, base=self.base), self.clouds[number], taken_s)
            points = np.asarray((there - pose[:3, 3]) @ pose[:3, :3])
            begin, cpu = time.perf_counter(), time.thread_time()
            self.planner.set_cloud(SEEN, points, radius=BALL_M, pose=pose, time_s=taken_s)
        self.frame_ms.extend((1e3 * (time.perf_counter() - begin), 1e3 * (time.thread_time() - cpu)))
        # No other thread replaces this obstacle.
        digest = _digest(self.planner.scene)
        with self.lock:
            if digest is None:
                return
            self.frames[digest] = number
            while len(self.frames) > REMEMBERED:
                self.frames.popitem(last=False)

    def plan(self, rng: np.random.Generator) -> None:
        """A new motion, before the last one begins, while it runs, or from its end."""
        planner, last = self.planner, self.planner.last
        now = time.monotonic() if last is None else max(time.monotonic(), last.begins_s)
        if last is None or _end_s(last) < now + AHEAD_S or rng.random() < 0.05:
            end = self.home.start if last is None else last.trajectory.position[-1]
            with self.driving:
                planner.aim(start=Start(joints_rad=tuple(end.tolist())))
            ask = planner.plan if rng.random() < 0.7 else planner.replan
            # Among what moves a motion is planned for when it begins.
            begins_s = now + DEADLINE_S if planner.scene.moves else None
            found: PlanResult = ask(begins_s=begins_s)
            if begins_s is None:
                planner.began(time.monotonic())
            self.keep("plan", found.scene, found.trajectory, found.certificate)
            return
        measured = last.trajectory.positions(np.array([now - last.begins_s]))[0]
        spliced = planner.replan(at=now + AHEAD_S, now=now, measured=measured)
        kind = "kept" if spliced.is_kept else "splice"
        self.keep(kind, spliced.scene, spliced.trajectory, spliced.certificate)

    def stop(self, rng: np.random.Generator) -> None:
        """A stop, and a scaling, of what runs."""
        scene, last = self.planner.scene, self.planner.last
        if last is None or not (now := max(time.monotonic(), last.begins_s)) < _end_s(last):
            return
        stop = self.planner.stop_at(float(rng.uniform(now, _end_s(last))), now=now)
        if self.planner.scene is scene and self.planner.last is last:
            self.keep(
                "stop", scene, stop.trajectory, stop.certificate, begin_s=last.begins_s, from_s=now - last.begins_s
            )
        if rng.random() < 0.2:
            slower = last.scaled(float(rng.uniform(0.3, 1.0)))
            self.keep("scaled", last.scene, slower.trajectory, slower.certificate)

    def change(self, rng: np.random.Generator) -> None:
        """An obstacle comes, moves or goes; or another goal."""
        planner = self.planner
        names = [item.name for item in planner.scene.obstacles if item.name != SEEN]
        if rng.random() < DRIVING:
            self.drive(rng)
        what = rng.choice(["add", "move", "track", "remove", "aim"])
        if what == "add" and len(names) < MOST_KNOWN:
            for item in free(self.drawn, self.home, [self.item(rng, f"new {rng.integers(1 << 40)}")]):
                if item["kind"] not in ("mesh", "points"):
                    planner.add(obstacle(item))
        elif what == "remove" and names:
            planner.remove(names[int(rng.integers(len(names)))])
        elif what == "track" and names:
            planner.move(names[int(rng.integers(len(names)))], track=Track(**self.track(rng, [0.0, 0.0, 1.0])["track"]))
        elif what == "move" and names:
            name = names[int(rng.integers(len(names)))]
            kind = next((each.kind for each in planner.scene.obstacles if each.name == name), "sphere")
            at = tuple((self.drawn.robot.tool_positions(self.home.goal) + direction(rng) * 0.6).tolist())
            planner.move(name, **{"position" if kind in ("mesh", "points") else "center": at})
        elif what == "aim":
            goals = [q for q in self.drawn.arm.drawn(rng, 10) if self.drawn.arm.has_room(q, 0.02)]
            fruit = str(rng.choice([fruit.name for fruit in planner.scene.fruits]))
            # Where the base drives no fruit is picked.
            if self.base is None and (rng.random() < 0.5 or not goals):
                planner.aim(goal=Goal(fruit=fruit))
            elif goals:
                planner.aim(goal=Goal(joints_rad=tuple(goals[0].tolist())))

    def drive(self, rng: np.random.Generator) -> None:
        """The base drives from where it stood, or stands there."""
        base = self.track(rng, [0.0, 0.0, 0.0], 20.0)["track"] if rng.random() < 0.5 else None
        with self.driving:
            self.base = base
            track = None if base is None else Track(**base)
            self.planner.scene = self.planner.scene.with_(base_track=track)

    # Afterwards

    def judge(self) -> None:
        """Look at the samples."""
        for number in range(min(self.handed, MOST_SAMPLES)):
            sample = pickle.loads((self.folder / f"{number}.pickle").read_bytes())
            known, kind, cloud, allowed, begin_s, from_s = sample
            things = things_of(known)
            if cloud >= 0:
                things.append(Thing({"name": SEEN, "kind": "points", "points": self.clouds[cloud], "radius": BALL_M}))
            motion = Motion.read(self.folder / f"{number}.csv", from_s)
            base = None if known.base_track is None else Moves(known.base_track.model_dump())
            found = contacts(self.drawn.arm, motion, things, base=base, begin_s=begin_s, windows=allowed)
            self.tally.looked_in["base drives" if base else "obstacles move" if known.moves else "still"] += 1
            self.tally.ticks += len(motion.times)
            for contact in found:
                self.tally.faults.append({"kind": kind, "sample": number, **vars(contact)})


def soak(seed: int, seconds: float) -> Row:
    """Run it; which motions come of a seed, the machine decides."""
    with tempfile.TemporaryDirectory() as name:
        run = _Soak(named_arm("orchard_harvester"), seed, seconds, Path(name))
        calls = [(CAMERA_HZ, run.frame), (REPLAN_HZ, run.plan), (STOP_HZ, run.stop), (CHANGE_HZ, run.change)]
        threads = [
            threading.Thread(target=run.every, args=(rate, call, k), daemon=True)
            for k, (rate, call) in enumerate(calls)
        ]
        for thread in threads:
            thread.start()
        begin, memory = time.monotonic(), []
        while any(thread.is_alive() for thread in threads):
            time.sleep(min(MEMORY_EVERY_S, max(0.1, run.until - time.monotonic())))
            if (now := time.monotonic() - begin) >= min(WARM_S, 0.3 * seconds):
                memory.append((now, _resident_mb()))
        run.judge()
        return run.tally.row(seed) | _measured(run, memory) | {"judged": min(run.handed, MOST_SAMPLES)}


def _end_s(plan: PlanResult) -> float:
    """When a motion ends, on the clock on the wall [s]; NaN where it has not begun."""
    return plan.begins_s + plan.trajectory.duration


def _digest(scene: Scene) -> str | None:
    """Of the cloud that a scene holds."""
    found = (item.data_digest for item in scene.obstacles if item.name == SEEN and isinstance(item, PointCloud))
    return next(found, None)


def _measured(run: _Soak, memory: list[tuple[float, float]]) -> Row:
    """Frames and memory in numbers."""
    frames = np.reshape(run.frame_ms or (math.nan, math.nan), (-1, 2))
    row: Row = {"frames": len(frames), "within_60_ms": float((frames[:, 0] <= 60.0).mean())}
    for share in (50, 95, 99, 100):
        row[f"frame_{share}_ms"], row[f"frame_{share}_cpu_ms"] = np.percentile(frames, share, axis=0)
    times, held = np.array(memory).T if memory else (np.zeros(1), np.zeros(1))
    slope = float(np.polyfit(times, held, 1)[0]) * 3600.0 if len(times) > 2 else 0.0
    return row | {"first_mb": held[0], "last_mb": held[-1], "most_mb": held.max(), "mb_an_hour": slope}


def _resident_mb() -> float:
    """Memory in use [MB]."""
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _row(asked: Asked, seed: int) -> Row:
    (minutes,) = asked.values.get("minutes", (1.0,))
    return soak(seed, 60.0 * minutes)


def _seed(asked: Asked) -> list[int]:
    return [asked.seed]


SOAK = Study(
    "soak",
    "one planner, and four threads that call its methods at a camera's rate (--values minutes=60)",
    _row,
    ("judged", "frames", "within_60_ms", "frame_95_ms", "frame_99_ms", "first_mb", "last_mb", "mb_an_hour"),
    problems=_seed,
    totals=COUNTED,
    warm=0,
)
