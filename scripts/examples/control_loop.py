"""Pick fruit beside a controller at 100 Hz: cloud in, fruit chosen, motion spliced, stop on demand, in MuJoCo.

    python scripts/examples/control_loop.py [SECONDS]

What the planner knows of the trees is what four depth cameras see of the simulated ones, with noise: above and below,
on both sides of the arm. While the arm rests they look closely, at all their pixels for several frames; what they see
then is known, and remembered where fruit or arm hide it. While it moves they look coarsely, in turns, and what is not
known yet counts as well. The running motion goes on while it is certified among all of that; else a new one takes over
from where the arm will be. Time in the simulation stands still while hplan plans.

A certificate covers what was seen, each point with a ball about it, and no more. Not covered: what no camera sees,
being hidden, out of view or between pixels (unseen space counts as free); what comes to the arm faster than frames do;
wood within `CLOSE_NOISE_M` of a fruit, which cannot be told from it; a point measured farther off than the ball is
wide. What the arm touches is therefore counted by MuJoCo, among the true trees.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import numpy as np

import hplan
from hplan.apps.execution.plant import Plant
from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, SimulatedArm, Touch
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import ConfigurationInCollisionError, HplanError, NotInTimeError
from hplan.online.frame import CloudOptions
from hplan.scene import Goal, Scene, Start
from hplan.trajectory.trajectory import Trajectory

#: Period of the loop, of the camera, and how far ahead a new motion takes over [s].
TICK_S, FRAME_S, AHEAD_S = 0.01, 0.1, 0.2

#: When somebody steps in, and for how long [s].
STEPS_IN_S, STAYS_S = 4.0, 0.5

#: How long the cameras look closely, and at how many frames a second of which they take the mean [s, 1/s].
LOOK_S, CLOSE_RATE = 0.3, 30.0

#: Largest error of a point 2 m away: four standard deviations, of a single frame and of a close look [m].
NOISE_M, CLOSE_NOISE_M = 0.016, 0.005

#: Radius of the ball about each point: half the distance between points 2 m away, and half the largest error [m].
RADIUS_M, CLOSE_RADIUS_M = 0.016, 0.008

#: What is not known yet is planned past with so much to spare, lest noise bring the next frame too near [m].
SPARE_M = 0.005

#: What a controller may be off by [rad].
TRACKING_ERROR_RAD = 0.0002


class Camera:
    """A depth camera that does not move: rays through a pinhole, with noise.

    Attributes:
        pose: (4, 4) camera to `base_link`; z looks ahead, x to the right, y down.
    """

    def __init__(self, position: tuple[float, float, float], target: tuple[float, float, float]) -> None:
        """Look from a position at a target [m]."""
        ahead = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
        right = np.cross(ahead, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(ahead, (0.0, 0.0, 1.0)))
        self.pose = np.eye(4)
        self.pose[:3] = np.column_stack([right, np.cross(ahead, right), ahead, position])
        x, y = np.meshgrid(np.linspace(-1.1, 1.1, 480), np.linspace(-1.0, 0.8, 400))
        self._rays = np.stack([x, y, np.ones_like(x)], axis=2)
        self._rays /= np.linalg.norm(self._rays, axis=2)[:, :, None]
        self._random = np.random.default_rng(1)

    def frame(self, machine: SimulatedArm, *, closely: bool) -> np.ndarray:
        """(n, 3) points in the camera's frame, NaN where nothing is seen: the mean of several frames, or a few [m]."""
        rays = self._rays.reshape(-1, 3) if closely else self._rays[::3, ::3].reshape(-1, 3)
        distance, _ = machine.cast_rays(self.pose[:3, 3], rays @ self.pose[:3, :3].T)
        distance[~np.isfinite(distance)] = np.nan
        noise = 0.001 * np.nan_to_num(distance) ** 2
        distance += self._random.normal(0.0, noise / np.sqrt(LOOK_S * CLOSE_RATE) if closely else noise)
        points: np.ndarray = distance[:, None] * rays
        return points


@dataclass
class Log:
    """What happened: fruits reached and left, motions to them, frames, splices, stops, times, contacts."""

    picked: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    motions: list[hplan.PlanResult] = field(default_factory=list)
    frames: int = 0
    spliced: int = 0
    stops: int = 0
    seen_ms: list[float] = field(default_factory=list)
    planned_ms: list[float] = field(default_factory=list)
    contacts: tuple[Touch, ...] = ()
    farthest_off_rad: float = 0.0


class ControlLoop:
    """A planner, a controller and a simulated arm."""

    def __init__(self, scene: Scene, options: hplan.PlanOptions) -> None:
        """Begin at the start of a scene; its obstacles are the simulation's alone, its fruits have been detected."""
        robot = hplan.load_robot(scene.robot)
        home = np.array(scene.start.configuration)
        there = scene.model_copy(update={"goal": Goal(joints_rad=tuple(home.tolist()))})
        self.machine = SimulatedArm(robot, there, Plant(bandwidth=200.0))
        self.machine.place(home)
        self.cameras = {
            f"{name} {across}": Camera((0.2, side, up), (1.3, 0.3 * side, at))
            for name, up, at in (("above", 2.2, 1.4), ("below", 1.0, 1.7))
            for across, side in (("right", -0.7), ("left", 0.7))
        }
        self.planner = hplan.Planner(robot, there.with_obstacles(()), options)
        self.log, self.todo = Log(), [fruit.name for fruit in scene.fruits]
        self.running: hplan.PlanResult | CertifiedMotion | None = None
        self.resting, self.waits_until_s, self.fruit, self.has_looked = home, LOOK_S, "", False

    @property
    def ends_s(self) -> float:
        """When the running motion comes to its end [s]."""
        return 0.0 if self.running is None else self.running.begins_s + self.running.trajectory.duration

    def tick(self, number: int) -> None:
        """One period of the loop."""
        if self.running is not None and self.machine.time_s >= self.ends_s:
            self.end(self.running.trajectory)
        if number % round(FRAME_S / TICK_S) == 0:
            self.glance()
        if number == round(STEPS_IN_S / TICK_S):
            self.stop()
        if self.running is None and self.machine.time_s >= self.waits_until_s:
            self.choose()
        for _step in range(round(TICK_S / CONTROL_PERIOD)):
            still = np.zeros_like(self.resting)
            state = self.resting, still, still
            if self.running is not None:
                # A hair before it begins, sums of small steps being what they are, a motion that runs stands still.
                state = self.running.trajectory.state_at(max(self.machine.time_s - self.running.begins_s, 0.0))
            self.log.farthest_off_rad = max(self.log.farthest_off_rad, np.abs(self.machine.position - state[0]).max())
            self.machine.follow(*state)

    def look(self) -> None:
        """Look closely, the arm at rest: what is seen is known from then on."""
        for name, camera in self.cameras.items():
            self.planner.set_cloud(
                name, camera.frame(self.machine, closely=True), radius=CLOSE_RADIUS_M, pose=camera.pose,
                joints=self.machine.position, ignore=self.todo, keep_s=3600.0, time_s=self.machine.time_s,
                options=CloudOptions(ignore_padding_m=CLOSE_NOISE_M, growth_m=0.003),
            )  # fmt: skip
        self.has_looked = True

    def glance(self) -> None:
        """A coarse frame of two cameras; the running motion goes on, or another takes over."""
        names = list(self.cameras)[self.log.frames % 2 :: 2]
        frames = [self.cameras[name].frame(self.machine, closely=False) for name in names]
        known = [item.name for item in self.planner.scene.obstacles if item.name in self.cameras]
        radius = RADIUS_M if self.running is not None else RADIUS_M + SPARE_M
        began = time.perf_counter()
        for name, points in zip(names, frames, strict=True):
            self.planner.set_cloud(
                f"news {name}", points, radius=radius, pose=self.cameras[name].pose, joints=self.machine.position,
                ignore=[*self.todo, *known], keep_s=60.0, time_s=self.machine.time_s,
                options=CloudOptions(ignore_padding_m=NOISE_M),
            )  # fmt: skip
        self.log.frames += 1
        self.log.seen_ms.append(1e3 * (time.perf_counter() - began))
        if self.running is None or not self.fruit:
            return
        now = min(self.machine.time_s, self.ends_s)
        try:
            result = self.planner.replan(at=min(now + AHEAD_S, self.ends_s), now=now, measured=self.machine.position)
        except HplanError:
            self.stop()
        else:
            self.log.spliced += not result.is_kept
            self.running = result
        self.log.planned_ms.append(1e3 * (time.perf_counter() - began))

    def choose(self) -> None:
        """Plan to the first fruit that there is a motion to."""
        if not self.has_looked:
            self.look()
        here = Start(joints_rad=tuple(self.resting.tolist()))
        while self.running is None and self.todo:
            self.fruit = self.todo[0]
            self.planner.aim(start=here, goal=Goal(fruit=self.fruit))
            try:
                self.running = self.planner.plan(begins_s=self.machine.time_s)
                self.log.motions.append(self.running)
                self.machine.pass_through([self.fruit])
            except ConfigurationInCollisionError as error:
                if error.obstacle not in self.todo:
                    self.waits_until_s = self.machine.time_s + STAYS_S  # perhaps the next frames see it elsewhere
                    self.has_looked = False
                    return
                self.take(error.obstacle)  # the arm was stopped with the fruit in its hand
            except NotInTimeError:
                self.todo.append(self.todo.pop(0))  # later, from elsewhere
                return
            except HplanError:
                self.log.left.append(self.todo.pop(0))

    def stop(self) -> None:
        """Stop on the path, and wait; what is coming to rest already goes on to do so."""
        if isinstance(self.running, hplan.PlanResult):
            now = min(self.machine.time_s, self.ends_s)
            self.running = self.planner.stop_at(now, now=now, measured=self.machine.position)
            self.log.stops += 1
        self.fruit, self.waits_until_s, self.has_looked = "", self.machine.time_s + STAYS_S, False

    def end(self, trajectory: Trajectory) -> None:
        """A motion has come to its end."""
        self.resting, self.running, self.has_looked = trajectory.position[-1], None, False
        self.waits_until_s = max(self.waits_until_s, self.machine.time_s + LOOK_S)
        if self.fruit:
            self.take(self.fruit)

    def take(self, fruit: str) -> None:
        """A fruit is in the hand, and no obstacle any more."""
        self.planner.aim(goal=Goal(joints_rad=tuple(self.resting.tolist())))
        self.planner.remove(fruit)
        self.machine.take_away([fruit])
        self.todo.remove(fruit)
        self.log.picked.append(fruit)
        self.fruit = ""


def main(seconds: float = 8.0, *, scene: str = "tour", deadline_s: float | None = AHEAD_S) -> Log:
    """Pick for a while, and tell how it went."""
    options = hplan.PlanOptions(deadline_s=deadline_s, tracking_error=TRACKING_ERROR_RAD)
    loop = ControlLoop(hplan.load_scene(scene), options)
    for number in range(round(seconds / TICK_S)):
        loop.tick(number)
    log = loop.log
    log.contacts = loop.machine.contacts
    print(f"{len(log.picked)} fruits picked, {len(log.left)} left, in {seconds:g} s: {', '.join(log.picked)}")
    print(f"{log.frames} frames, {log.spliced} motions spliced, {log.stops} stops")
    print(f"frames taken up in {np.median(log.seen_ms):.0f} ms, planned anew in {np.median(log.planned_ms):.0f} ms")
    print(f"joints at most {1e3 * log.farthest_off_rad:.2f} mrad off; contacts: {log.contacts or 'none'}")
    return log


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))
