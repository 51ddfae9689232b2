"""One planner whose methods four threads call at random times, at the rate of a camera.

One thread passes frames, one plans and replans while the motion runs by the wall clock, one requests stops, and one
changes obstacles, goal, tracks and the motion of the base. The study counts foreign exceptions and contacts, and
measures frame times and memory. A sample of the motions is stored with the true points of the frame in its scene, and
judged at the end.
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
from studies.harness import Row, Study, StudyConfig
from studies.outside import obstacles_of
from studies.validation.judge import JudgedObstacle, PoseTrack, SampledMotion, contacts
from studies.validation.motions import COUNTED, Tally, windows
from studies.validation.random_arms import DrawnArm, named_arm
from studies.validation.random_worlds import (
    BALL_M,
    SEEN,
    Item,
    World,
    camera_pose,
    direction,
    draw_ends,
    draw_item,
    draw_track,
    free,
    middle_of,
    obstacle_of,
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

#: Points of a frame, number of clouds that frames choose from, and number of remembered frames.
POINTS, CLOUDS, REMEMBERED = 20_000, 12, 900

#: Time limit of a plan, and time until a splice takes over [s].
DEADLINE_S, AHEAD_S = 0.5, 0.6

#: Maximum numbers of known obstacles and of stored motions.
MOST_KNOWN, MOST_SAMPLES = 30, 1500

#: Share of obstacles with a track, and of changes at which the base starts or stops.
MOVING, DRIVING = 0.3, 0.03

#: Interval of memory measurements, and the time before the first [s].
MEMORY_EVERY_S, WARM_S = 10.0, 120.0


class _Soak:
    """The planner, and the data shared by its threads."""

    def __init__(self, drawn: DrawnArm, seed: int, seconds: float, folder: Path) -> None:
        self.drawn, self.seed, self.folder = drawn, seed, folder
        self.tally, self.lock = Tally(), threading.Lock()
        # The camera is on the base, which starts or stops between two frames.
        self.driving = threading.Lock()
        self.base: Item | None = None
        self.until = time.monotonic() + seconds
        rng = np.random.default_rng(seed)
        ends = draw_ends(drawn, rng, 0.01)
        if ends is None:
            raise ValueError("the arm has no free start")
        self.home = World(*ends)
        items = free(drawn, self.home, [self.item(rng, f"known {k}") for k in range(8)])
        fruits = tuple(
            {"name": f"fruit {k}", "kind": "sphere", "center": at.tolist(), "radius": 0.035}
            for k, at in enumerate(drawn.robot.tool_positions(q) for q in drawn.arm.drawn(rng, 4))
        )
        scene = World(*ends, items=tuple(items), fruits=fruits).scene()
        self.clouds = [self.cloud(rng) for _ in range(CLOUDS)]
        self.frames: OrderedDict[str, int] = OrderedDict()
        self.planner = Planner(drawn.robot, scene, PlanOptions(effort="quick", deadline_s=DEADLINE_S))
        self.frame_ms = array("f")  # wall time and CPU time of the thread, in turn
        self.stored = 0

    def cloud(self, rng: np.random.Generator) -> FloatArray:
        """Points on branches near the arm."""
        found: list[FloatArray] = []
        while sum(map(len, found)) < POINTS:
            at = self.drawn.robot.tool_positions(self.drawn.arm.drawn(rng, 1)[0]) + direction(rng) * rng.uniform(0, 0.4)
            half = direction(rng) * rng.uniform(0.1, 0.6)
            item = {"kind": "capsule", "from": at - half, "to": at + half, "radius": float(rng.uniform(0.005, 0.03))}
            points = surface(rng, item, 0.004)
            found.append(points[self.drawn.arm.box_distances(self.home.start, points) > 0.05])
        return np.concatenate(found)[:POINTS]

    def item(self, rng: np.random.Generator, name: str) -> Item:
        """An obstacle, static or with a track from now on."""
        item = draw_item(self.drawn, self.home, rng, name)
        return {**item, "track": self.track(rng, middle_of(item))} if rng.random() < MOVING else item

    def track(self, rng: np.random.Generator, about: list[float], turn_deg: float = 60.0) -> Item:
        return draw_track(rng, time.monotonic(), about, turn_deg)

    def repeat(self, rate_hz: float, call: Callable[[np.random.Generator], None], number: int) -> None:
        """Call a function at a rate until the time is up; any exception but hplan's is a fault."""
        rng = np.random.default_rng([self.seed, number])
        while (begin := time.monotonic()) < self.until:
            try:
                call(rng)
            except HplanError as error:
                self.count("refused", f"{call.__name__}: {error.kind}")
            except Exception as error:  # the study searches for these
                with self.lock:
                    self.tally.faults.append({"kind": "foreign exception", "call": call.__name__, "error": repr(error)})
            time.sleep(max(0.0, min(begin + 1.0 / rate_hz, self.until) - time.monotonic()))

    def count(self, name: str, key: str) -> None:
        with self.lock:
            getattr(self.tally, name)[key] += 1

    def store(
        self, kind: str, scene: Scene, motion: Trajectory, certificate: Certificate, start_time_s: float = 0.0,
        from_s: float = 0.0,
    ) -> None:  # fmt: skip
        """Store a verified motion for the judge; `start_time_s` is on the clock of the scene's tracks."""
        if not certificate.verified:
            self.count("unverified", kind)
            return
        seen = _cloud_digest(scene)
        self.count("checked", kind)
        with self.lock:
            cloud = -1 if seen is None else self.frames.get(seen)
            if cloud is None:
                return
            number, self.stored = self.stored, self.stored + 1
        if number >= MOST_SAMPLES:  # reservoir sampling
            number = int(np.random.default_rng().integers(number + 1))
        if number >= MOST_SAMPLES:
            return
        known = scene.with_values(obstacles=tuple(o for o in scene.obstacles if o.name != SEEN))
        allowed = windows(certificate, [fruit.model_dump() for fruit in scene.fruits])
        write_csv(motion, self.folder / f"{number}.csv", whole=True)
        sample = pickle.dumps((known, kind, cloud, allowed, start_time_s, from_s))
        (self.folder / f"{number}.pickle").write_bytes(sample)

    # The four threads

    def frame(self, rng: np.random.Generator) -> None:
        """Pass a frame."""
        number, pose = int(rng.integers(CLOUDS)), camera_pose(rng, 2.0)
        with self.driving:
            taken_s = time.monotonic()
            local = replace(self.home, base=self.base).from_base(self.clouds[number], taken_s)
            points = np.asarray((local - pose[:3, 3]) @ pose[:3, :3])
            begin, cpu = time.perf_counter(), time.thread_time()
            self.planner.set_cloud(SEEN, points, radius=BALL_M, pose=pose, time_s=taken_s)
        self.frame_ms.extend((1e3 * (time.perf_counter() - begin), 1e3 * (time.thread_time() - cpu)))
        # No other thread replaces this obstacle.
        digest = _cloud_digest(self.planner.scene)
        if digest is not None:
            with self.lock:
                self.frames[digest] = number
                while len(self.frames) > REMEMBERED:
                    self.frames.popitem(last=False)

    def plan(self, rng: np.random.Generator) -> None:
        """Plan a new motion, or replan the running one."""
        planner, last = self.planner, self.planner.last
        now = time.monotonic() if last is None else max(time.monotonic(), last.begins_s)
        if last is None or _end_s(last) < now + AHEAD_S or rng.random() < 0.05:
            end = self.home.start if last is None else last.trajectory.position[-1]
            with self.driving:
                planner.aim(start=Start(joints_rad=tuple(end.tolist())))
            call = planner.plan if rng.random() < 0.7 else planner.replan
            # Among moving obstacles a motion is planned for its start time.
            start_time_s = now + DEADLINE_S if planner.scene.moves else None
            found: PlanResult = call(begins_s=start_time_s)
            if start_time_s is None:
                planner.set_start_time(time.monotonic())
            self.store("plan", found.scene, found.trajectory, found.certificate)
            return
        measured = last.trajectory.positions(np.array([now - last.begins_s]))[0]
        spliced = planner.replan(at=now + AHEAD_S, now=now, measured=measured)
        self.store("kept" if spliced.is_kept else "splice", spliced.scene, spliced.trajectory, spliced.certificate)

    def stop(self, rng: np.random.Generator) -> None:
        """Request a stop, and sometimes a slower motion."""
        scene, last = self.planner.scene, self.planner.last
        if last is None or not (now := max(time.monotonic(), last.begins_s)) < _end_s(last):
            return
        stop = self.planner.stop_at(float(rng.uniform(now, _end_s(last))), now=now)
        if self.planner.scene is scene and self.planner.last is last:
            self.store("stop", scene, stop.trajectory, stop.certificate, last.begins_s, now - last.begins_s)
        if rng.random() < 0.2:
            slower = last.scale_speed(float(rng.uniform(0.3, 1.0)))
            self.store("scaled", last.scene, slower.trajectory, slower.certificate)

    def change(self, rng: np.random.Generator) -> None:
        """Add, move or remove an obstacle, or set another goal."""
        planner = self.planner
        known = [item for item in planner.scene.obstacles if item.name != SEEN]
        if rng.random() < DRIVING:
            self.drive(rng)
        change = rng.choice(["add", "move", "track", "remove", "aim"])
        if change == "add" and len(known) < MOST_KNOWN:
            for item in free(self.drawn, self.home, [self.item(rng, f"new {rng.integers(1 << 40)}")]):
                if item["kind"] not in ("mesh", "points"):
                    planner.add(obstacle_of(item))
        elif change == "aim":
            goals = [q for q in self.drawn.arm.drawn(rng, 10) if self.drawn.arm.is_clear_of_itself(q, 0.02)]
            fruit = str(rng.choice([fruit.name for fruit in planner.scene.fruits]))
            # A moving base picks no fruit.
            if self.base is None and (rng.random() < 0.5 or not goals):
                planner.aim(goal=Goal(fruit=fruit))
            elif goals:
                planner.aim(goal=Goal(joints_rad=tuple(goals[0].tolist())))
        elif change != "add" and known:
            chosen = known[int(rng.integers(len(known)))]
            if change == "remove":
                planner.remove(chosen.name)
            elif change == "track":
                planner.move(chosen.name, track=Track(**self.track(rng, [0.0, 0.0, 1.0])))
            else:
                at = tuple((self.drawn.robot.tool_positions(self.home.goal) + direction(rng) * 0.6).tolist())
                planner.move(chosen.name, **{"position" if chosen.kind in ("mesh", "points") else "center": at})

    def drive(self, rng: np.random.Generator) -> None:
        """Start or stop the base."""
        base = self.track(rng, [0.0, 0.0, 0.0], 20.0) if rng.random() < 0.5 else None
        with self.driving:
            self.base = base
            track = None if base is None else Track(**base)
            self.planner.scene = self.planner.scene.with_values(base_track=track)

    def judge(self) -> None:
        """Check the stored motions."""
        for number in range(min(self.stored, MOST_SAMPLES)):
            sample = pickle.loads((self.folder / f"{number}.pickle").read_bytes())
            known, kind, cloud, allowed, start_time_s, from_s = sample
            obstacles = obstacles_of(known)
            if cloud >= 0:
                points = {"name": SEEN, "kind": "points", "points": self.clouds[cloud], "radius": BALL_M}
                obstacles.append(JudgedObstacle(points))
            motion = SampledMotion.read(self.folder / f"{number}.csv", from_s)
            base = None if known.base_track is None else PoseTrack(known.base_track.model_dump())
            found = contacts(self.drawn.arm, motion, obstacles, base=base, start_time_s=start_time_s, windows=allowed)
            self.tally.checked_in["base drives" if base else "obstacles move" if known.moves else "still"] += 1
            self.tally.ticks += len(motion.times)
            self.tally.faults += [{"kind": kind, "sample": number, **vars(contact)} for contact in found]


def soak(seed: int, seconds: float) -> Row:
    """Run the threads for some time; the machine determines the motions, too."""
    with tempfile.TemporaryDirectory() as name:
        run = _Soak(named_arm("orchard_harvester"), seed, seconds, Path(name))
        calls = [(CAMERA_HZ, run.frame), (REPLAN_HZ, run.plan), (STOP_HZ, run.stop), (CHANGE_HZ, run.change)]
        threads = [
            threading.Thread(target=run.repeat, args=(rate, call, k), daemon=True)
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
        return run.tally.row(seed) | _measurements(run, memory) | {"judged": min(run.stored, MOST_SAMPLES)}


def _end_s(plan: PlanResult) -> float:
    """End of a motion on the wall clock [s]; NaN before its start."""
    return plan.begins_s + plan.trajectory.duration


def _cloud_digest(scene: Scene) -> str | None:
    """Digest of the camera's cloud in a scene."""
    found = (item.data_digest for item in scene.obstacles if item.name == SEEN and isinstance(item, PointCloud))
    return next(found, None)


def _measurements(run: _Soak, memory: list[tuple[float, float]]) -> Row:
    """Frame times and memory."""
    frames = np.reshape(run.frame_ms or (math.nan, math.nan), (-1, 2))
    row: Row = {"frames": len(frames), "within_60_ms": float((frames[:, 0] <= 60.0).mean())}
    for share in (50, 95, 99, 100):
        row[f"frame_{share}_ms"], row[f"frame_{share}_cpu_ms"] = np.percentile(frames, share, axis=0)
    times, held = np.array(memory).T if memory else (np.zeros(1), np.zeros(1))
    slope = float(np.polyfit(times, held, 1)[0]) * 3600.0 if len(times) > 2 else 0.0
    return row | {"first_mb": held[0], "last_mb": held[-1], "most_mb": held.max(), "mb_an_hour": slope}


def _resident_mb() -> float:
    """Resident memory of the process [MB]."""
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _row(config: StudyConfig, seed: int) -> Row:
    (minutes,) = config.values.get("minutes", (1.0,))
    return soak(seed, 60.0 * minutes)


def _seed(config: StudyConfig) -> list[int]:
    return [config.seed]


SOAK = Study(
    "soak",
    "one planner, and four threads that call its methods at a camera's rate (--values minutes=60)",
    _row,
    ("judged", "frames", "within_60_ms", "frame_95_ms", "frame_99_ms", "first_mb", "last_mb", "mb_an_hour"),
    problems=_seed,
    totals=COUNTED,
    warm=0,
)
