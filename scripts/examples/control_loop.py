"""Pick fruit beside a controller at 100 Hz: cloud in, fruit chosen, motion spliced, stop on demand, in MuJoCo.

    python scripts/examples/control_loop.py [SECONDS]

What the planner knows of the trees is what two depth cameras see of the simulated ones, with noise; what is within 2 cm
of a fruit to pick counts as fruit. The running motion goes on while it is certified among what is seen now; else a new
one takes over from where the arm will be. Time in the simulation stands still while hplan plans.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import numpy as np

import hplan
from hplan.errors import ConfigurationInCollisionError, HplanError, NotInTimeError
from hplan.execution.plant import Plant
from hplan.execution.simulated_arm import CONTROL_PERIOD, SimulatedArm, Touch
from hplan.scene import Goal, Scene, Start
from hplan.timing.trajectory import Trajectory
from hplan.verification.retimed_certificate import CertifiedMotion

#: Period of the loop, of the camera, and how far ahead a new motion takes over [s].
TICK_S, FRAME_S, AHEAD_S = 0.01, 0.1, 0.2

#: When somebody steps in, and for how long [s].
STEPS_IN_S, STAYS_S = 4.0, 0.5

#: Radius of the ball about each point: half the distance between points on a tree 2 m away, and the noise [m].
RADIUS_M = 0.012

#: Motions are planned with so much to spare, lest noise bring the next frame too near [m].
SPARE_M = 0.005


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
        x, y = np.meshgrid(np.linspace(-1.1, 1.1, 240), np.linspace(-1.0, 0.8, 200))
        self._rays = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
        self._rays /= np.linalg.norm(self._rays, axis=1)[:, None]
        self._random = np.random.default_rng(1)

    def frame(self, machine: SimulatedArm) -> np.ndarray:
        """(n, 3) points in the camera's frame; NaN where nothing is seen [m]."""
        distance, _ = machine.cast_rays(self.pose[:3, 3], self._rays @ self.pose[:3, :3].T)
        distance[~np.isfinite(distance)] = np.nan
        distance += self._random.normal(0.0, 0.001 * np.nan_to_num(distance) ** 2)
        points: np.ndarray = distance[:, None] * self._rays
        return points


@dataclass
class Log:
    """What happened: fruits reached and left, frames, splices, stops, times, contacts."""

    picked: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
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
        self.cameras = [Camera((0.2, side, 2.2), (1.3, 0.3 * side, 1.4)) for side in (-0.7, 0.7)]
        self.planner = hplan.Planner(robot, there.with_obstacles(()), options)
        self.log, self.todo = Log(), [fruit.name for fruit in scene.fruits]
        self.running: hplan.PlanResult | CertifiedMotion | None = None
        self.resting, self.waits_until_s, self.fruit = home, 0.0, ""

    @property
    def ends_s(self) -> float:
        """When the running motion comes to its end [s]."""
        return 0.0 if self.running is None else self.running.begins_s + self.running.trajectory.duration

    def tick(self, number: int) -> None:
        """One period of the loop."""
        if self.running is not None and self.machine.time_s >= self.ends_s:
            self.end(self.running.trajectory)
        if number % round(FRAME_S / TICK_S) == 0:
            self.look()
        if number == round(STEPS_IN_S / TICK_S):
            self.stop()
        if self.running is None and self.machine.time_s >= self.waits_until_s:
            self.choose()
        for _step in range(round(TICK_S / CONTROL_PERIOD)):
            still = np.zeros_like(self.resting)
            state = self.resting, still, still
            if self.running is not None:
                state = self.running.trajectory.state_at(self.machine.time_s - self.running.begins_s)
            self.machine.follow(*state)
            self.log.farthest_off_rad = max(self.log.farthest_off_rad, np.abs(self.machine.position - state[0]).max())

    def look(self) -> None:
        """A frame of each camera; the running motion goes on, or another takes over."""
        frames = [camera.frame(self.machine) for camera in self.cameras]
        radius = RADIUS_M if self.running is not None else RADIUS_M + SPARE_M
        began = time.perf_counter()
        for number, (camera, points) in enumerate(zip(self.cameras, frames, strict=True)):
            self.planner.set_cloud(
                f"camera {number}", points, radius=radius, pose=camera.pose, joints=self.machine.position,
                ignore=self.todo, keep_s=60.0, time_s=self.machine.time_s,
            )  # fmt: skip
        self.log.frames += 1
        self.log.seen_ms.append(1e3 * (time.perf_counter() - began))
        if self.running is None or not self.fruit:
            return
        now = min(self.machine.time_s, self.ends_s)
        try:
            result = self.planner.replan(at=min(now + AHEAD_S, self.ends_s), now=now)
        except HplanError:
            self.stop()
        else:
            self.log.spliced += not result.is_kept
            self.running = result
        self.log.planned_ms.append(1e3 * (time.perf_counter() - began))

    def choose(self) -> None:
        """Plan to the first fruit that there is a motion to."""
        here = Start(joints_rad=tuple(self.resting.tolist()))
        while self.running is None and self.todo:
            self.fruit = self.todo[0]
            self.planner.aim(start=here, goal=Goal(fruit=self.fruit))
            try:
                self.running = self.planner.plan(begins_s=self.machine.time_s)
                self.machine.pass_through([self.fruit])
            except ConfigurationInCollisionError as error:
                if error.obstacle not in self.todo:
                    self.waits_until_s = self.machine.time_s + STAYS_S  # perhaps the next frames see it elsewhere
                    return
                self.take(error.obstacle)  # the arm was stopped with the fruit in its hand
            except NotInTimeError:
                self.todo.append(self.todo.pop(0))  # later, from elsewhere
                return
            except HplanError:
                self.log.left.append(self.todo.pop(0))

    def stop(self) -> None:
        """Stop on the path, and wait."""
        if self.running is not None:
            now = min(self.machine.time_s, self.ends_s)
            self.running, self.log.stops = self.planner.stop_at(now, now=now), self.log.stops + 1
        self.fruit, self.waits_until_s = "", self.machine.time_s + STAYS_S

    def end(self, trajectory: Trajectory) -> None:
        """A motion has come to its end."""
        self.resting, self.running = trajectory.position[-1], None
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


def main(seconds: float = 20.0, *, scene: str = "tour", deadline_s: float | None = AHEAD_S) -> Log:
    """Pick for a while, and tell how it went."""
    loop = ControlLoop(hplan.load_scene(scene), hplan.PlanOptions(deadline_s=deadline_s))
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
