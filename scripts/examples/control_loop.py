"""Pick fruit with a 100 Hz controller: clouds, splices, stops, in MuJoCo.

    python scripts/examples/control_loop.py [SECONDS] [--unknown solid] [--bending] [--tree FILE --distance M]

The planner knows the trees only from four depth cameras in the simulation, with noise: above and below, on both sides
of the arm. While the arm rests they look closely, with all pixels for several frames; the observed points are then
known, and remembered while fruit or arm hide them. While it moves they look coarsely, in turns, and points that are not
known yet count as well. The running motion continues while it is certified among all of these points; otherwise a new
one takes over from the arm's state at the handover. Simulated time stops while hplan plans.

A certificate covers the observed points only, each with a ball around it. Not covered: objects that no camera sees,
because they are hidden, out of view or between pixels (unseen space counts as free); objects that approach the arm
faster than frames arrive; wood within `CLOSE_NOISE_M` of a fruit, which is indistinguishable from the fruit; a point
with a measurement error larger than the ball. MuJoCo therefore counts the contacts of the arm with the true trees.

With `--unknown solid` the arm stays in space that a close look has seen through, and in the lane that the machine has
driven in. If it cannot reach a fruit that way, a fifth camera on a mast looks from the view that `Planner.next_view`
proposes. A ray without a return counts as free up to the camera's range: true here, to be verified for a real camera.
Not covered then: wood thinner than the pixel spacing of a close look, 9 mm at 2 m, and wood in the same voxel of
`VOXEL_M` as a fruit to be picked.

With `--bending` limbs bend and sway in the wind, fruit hang from stalks, and the gripper must reach them. The planner
does not know the errors of base, camera and masses (`hplan.apps.execution.field_errors`). MuJoCo measures the forces.
Not covered then: wood within `SWAY_M` more of a fruit, and wood that sways out of the balls between two frames.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np

import hplan
from hplan.apps.execution.bending_wood import BendingTrees
from hplan.apps.execution.field_errors import FieldErrors
from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, Plant, SimulatedArm, Touch
from hplan.apps.execution.simulation import find_near
from hplan.apps.execution.tree_response import TreeResponse
from hplan.apps.execution.wind import Wind
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.collision.compiled_obstacles import solid_rows
from hplan.errors import ConfigurationInCollisionError, HplanError, NotInTimeError
from hplan.online.body_distances import distances_from_bodies
from hplan.online.frame import CloudOptions
from hplan.online.planner import Unknown
from hplan.scene import Box, Goal, Scene, Start, with_limbs
from hplan.scene.orchard import MeasuredOptions, measured_orchard
from hplan.trajectory.trajectory import Trajectory

#: Period of the loop, of the camera, and how far ahead a new motion takes over; start and duration of a disturbance,
#: when a person steps in [s].
TICK_S, FRAME_S, AHEAD_S, STEPS_IN_S, STAYS_S = 0.01, 0.1, 0.2, 4.0, 0.5

#: Duration and frame rate of a close look, whose frames are averaged [s, 1/s].
LOOK_S, CLOSE_RATE = 0.3, 30.0

#: Of a single frame and of a close look: maximum error of a point at 2 m, four standard deviations, and radius of the
#: ball around each point, half the distance between points at 2 m and half the maximum error [m].
NOISE_M, CLOSE_NOISE_M, RADIUS_M, CLOSE_RADIUS_M = 0.016, 0.005, 0.016, 0.008

#: Extra clearance from points that are not known yet, so that noise in the next frame does not violate the margin [m].
SPARE_M = 0.005

#: Maximum tracking error of the controller, and if the masses are wrong [rad].
TRACKING_ERROR_RAD, WRONG_MASSES_RAD = 0.0002, 0.0003

#: How far fruit sway in the wind, and maximum distance from the tool at which the gripper takes them [m].
SWAY_M, GRIPPER_M = 0.01, 0.03

#: Range of a camera, and edge length of the voxels of seen space [m].
RANGE_M, VOXEL_M = 6.0, 0.03

#: The lane that the machine has driven through: free, even if unknown space is solid.
LANE = Box(name="lane", center=(-1.0, 0.0, 1.25), size=(2.5, 6.0, 2.5))

#: Minimum radius of a fruit [m].
LEAST_FRUIT_M = 0.015

#: How long the mast takes to bring its camera elsewhere [s], and from how many places it may look at one fruit's way.
MAST_S, MOST_VIEWS = 1.0, 2


class Camera:
    """A depth camera that does not move: rays through a pinhole, with noise.

    Attributes:
        pose: (4, 4) camera to `base_link`; z looks ahead, x to the right, y down.
        view_deg: Width and height of a field of view that it has all of [deg].
    """

    view_deg = 2.0 * np.degrees(np.arctan((1.1, 0.8)))

    def __init__(self, position: tuple[float, float, float], target: tuple[float, float, float]) -> None:
        ahead = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
        right = np.cross(ahead, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(ahead, (0.0, 0.0, 1.0)))
        self.pose = np.eye(4)
        self.pose[:3] = np.column_stack([right, np.cross(ahead, right), ahead, position])
        x, y = np.meshgrid(np.linspace(-1.1, 1.1, 480), np.linspace(-1.0, 0.8, 400))
        self._rays = np.stack([x, y, np.ones_like(x)], axis=2)
        self._rays /= np.linalg.norm(self._rays, axis=2)[:, :, None]
        self._random = np.random.default_rng(1)

    def frame(self, machine: SimulatedArm, *, closely: bool, beyond: float = np.nan) -> np.ndarray:
        """(n, 3) points in the camera's frame, possibly averaged.

        A close look averages several frames. `beyond` is the depth of pixels without a return [m].
        """
        rays = self._rays.reshape(-1, 3) if closely else self._rays[::3, ::3].reshape(-1, 3)
        distance, _ = machine.cast_rays(self.pose[:3, 3], rays @ self.pose[:3, :3].T)
        distance[~(distance < RANGE_M)] = beyond
        noise = 0.001 * np.nan_to_num(distance) ** 2
        distance += self._random.normal(0.0, noise / np.sqrt(LOOK_S * CLOSE_RATE) if closely else noise)
        points: np.ndarray = distance[:, None] * rays
        return points


@dataclass
class Log:
    """Events: fruits reached and left, motions, frames, splices, stops, times, contacts."""

    picked: list[str] = field(default_factory=list)
    views: int = 0
    left: list[str] = field(default_factory=list)
    motions: list[hplan.PlanResult] = field(default_factory=list)
    frames: int = 0
    spliced: int = 0
    stops: int = 0
    seen_ms: list[float] = field(default_factory=list)
    planned_ms: list[float] = field(default_factory=list)
    contacts: tuple[Touch, ...] = ()
    farthest_off_rad: float = 0.0
    trees: TreeResponse | None = None


class ControlLoop:
    """A planner, a controller and a simulated arm."""

    def __init__(
        self, scene: Scene, options: hplan.PlanOptions, unknown: Unknown = "free", *, bending: bool = False
    ) -> None:
        """Start at a scene's start: the planner gets its fruits, not its obstacles."""
        robot = hplan.load_robot(scene.robot)
        home = np.array(scene.start.configuration)
        there = scene.with_values(goal=Goal(joints_rad=tuple(home.tolist())))
        plant, seen, trees, near, self.sway_m = Plant(bandwidth=200.0), there, None, None, 0.0
        if bending:
            errors, random = FieldErrors(), np.random.default_rng(1)
            there, trees, self.sway_m = with_limbs(there), BendingTrees(wind=Wind()), SWAY_M
            seen = errors.seen_scene(there, random).with_values(wood=None)
            plant = plant.with_values(mass_factor=errors.mass_factor(random))
            grasps = [fruit.grasp for fruit in hplan.reachable(robot, there).values()]
            ways = [np.linspace(home, grasp.goal, 15) for grasp in grasps if grasp is not None]
            near = find_near(robot, there, np.vstack([home, *ways]))  # other limbs are rigid, which saves time
        self.machine = SimulatedArm(robot, there, plant, trees=trees, bending=near)
        self.machine.settle(home)
        self.cameras = {
            f"{name} {across}": Camera((-0.4, side, up), (1.3, 0.0, at))
            for name, up, at in (("above", 2.4, 1.0), ("below", 0.5, 1.5))
            for across, side in (("right", -1.4), ("left", 1.4))
        }
        self.unknown = unknown
        spots = product((1.5, 2.0, 2.5, 1.0, 0.5), (-1.0, -0.5, 0.0, 0.5, 1.0, -1.5, 1.5))
        self.mast = {f"mast {n}": Camera((-0.4, side, up), (1.3, 0.0, 1.4)) for n, (up, side) in enumerate(spots)}
        self.planner = hplan.Planner(robot, seen.with_obstacles(()), options)
        self.log, self.todo = Log(), [fruit.name for fruit in scene.fruits]
        self.running: hplan.PlanResult | CertifiedMotion | None = None
        self.resting, self.waits_until_s, self.fruit, self.has_looked = home, LOOK_S, "", False
        self.looked_from: list[str] = []
        self.later: set[str] = set()
        self.held: set[str] = set()

    @property
    def ends_s(self) -> float:
        """When the running motion comes to its end [s]."""
        return 0.0 if self.running is None else self.running.begins_s + self.running.trajectory.duration

    @property
    def grasps_s(self) -> float:
        """When the running motion grasps its fruit [s]."""
        motion = self.running
        return motion.begins_s + motion.picked_fruit[self.fruit] if isinstance(motion, hplan.PlanResult) else np.inf

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
        if self.fruit and self.machine.time_s >= self.grasps_s:
            self.grip(self.fruit)
        for _step in range(round(TICK_S / CONTROL_PERIOD)):
            still = np.zeros_like(self.resting)
            state = self.resting, still, still
            if self.running is not None:
                # Rounding may put the clock slightly before the motion's start, when it is at rest.
                state = self.running.trajectory.state_at(max(self.machine.time_s - self.running.begins_s, 0.0))
            self.log.farthest_off_rad = max(self.log.farthest_off_rad, np.abs(self.machine.position - state[0]).max())
            self.machine.follow(*state)

    def look(self, cameras: dict[str, Camera]) -> None:
        """Look closely with the arm at rest; the points are known afterwards."""
        solid = self.unknown == "solid"
        for name, camera in cameras.items():
            self.planner.set_cloud(
                name, camera.frame(self.machine, closely=True, beyond=RANGE_M if solid else np.nan),
                radius=CLOSE_RADIUS_M, pose=camera.pose, joints=self.machine.position, ignore=self.todo, keep_s=3600.0,
                time_s=self.machine.time_s, unknown=self.unknown,
                options=CloudOptions(
                    ignore_padding_m=CLOSE_NOISE_M + self.sway_m, growth_m=0.003,
                    unseen_edge_m=VOXEL_M, known_free=(LANE,),
                ),
            )  # fmt: skip
        self.has_looked = True

    def look_again(self) -> bool:
        """View unknown space on the way to a fruit; False if useless."""
        left = [name for name in self.mast if name not in self.looked_from]
        if self.unknown == "free" or len(self.looked_from) == MOST_VIEWS:
            return False
        try:
            view = self.planner.next_view(
                [self.mast[name].pose for name in left], field_of_view_deg=tuple(Camera.view_deg), farthest_m=RANGE_M
            )
        except HplanError:
            return False  # known points block it
        if view is None:
            return False
        name = left[view.number]
        self.looked_from.append(name)
        self.look({name: self.mast[name]})
        self.log.views += 1
        self.waits_until_s = self.machine.time_s + MAST_S + LOOK_S
        return True

    def glance(self) -> None:
        """A coarse frame of two cameras; the running motion goes on, or another takes over."""
        names = list(self.cameras)[self.log.frames % 2 :: 2]
        frames = [self.cameras[name].frame(self.machine, closely=False) for name in names]
        known = [item.name for item in self.planner.scene.obstacles if item.name in {**self.cameras, **self.mast}]
        radius = RADIUS_M if self.running is not None else RADIUS_M + SPARE_M
        began = time.perf_counter()
        for name, points in zip(names, frames, strict=True):
            self.planner.set_cloud(
                f"news {name}", points, radius=radius, pose=self.cameras[name].pose, joints=self.machine.position,
                ignore=[*self.todo, *known], keep_s=60.0, time_s=self.machine.time_s,
                options=CloudOptions(ignore_padding_m=NOISE_M + self.sway_m),
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
            self.look(self.cameras)
        here = Start(joints_rad=tuple(self.resting.tolist()))
        while self.running is None and self.todo:
            self.fruit = self.todo[0]
            self.planner.aim(start=here, goal=Goal(fruit=self.fruit))
            try:
                self.running = self.planner.plan(begins_s=self.machine.time_s)
                self.log.motions.append(self.running)
                self.machine.ignore_contacts([self.fruit])
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
                if self.unknown == "solid" and self.fruit not in self.later:
                    self.later.add(self.fruit)  # first the fruits that need no further view
                    self.todo.append(self.todo.pop(0))
                    continue
                if self.look_again():
                    return
                self.log.left.append(self.todo.pop(0))
            self.looked_from = []

    def stop(self) -> None:
        """Stop on the path, and wait; an arm that is already stopping continues."""
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
        """A fruit is in the hand, or the gripper missed it; a fruit to pick no more."""
        self.planner.aim(goal=Goal(joints_rad=tuple(self.resting.tolist())))
        self.planner.remove(fruit)
        self.todo.remove(fruit)
        self.grip(fruit)
        (self.log.picked if fruit in self.held else self.log.left).append(fruit)
        self.fruit = ""

    def grip(self, fruit: str) -> None:
        """Take a fruit off the tree; it must be in the reach of the gripper if it hangs."""
        if self.machine.trees is None or self.machine.distance_to_fruit(fruit) <= GRIPPER_M:
            self.machine.take_away([fruit])
            self.held.add(fruit)


def tree_in_front(file: Path, distance_m: float, arm: str) -> Scene:
    """A measured tree in front of the arm.

    Its fruits are balls around the measured ones, some with wood inside, which ends at the ball.
    """
    scene = measured_orchard([file], MeasuredOptions(distance=distance_m))
    wood = solid_rows([solid for item in scene.obstacles for solid in item.solids], 0.0)
    room = distances_from_bodies(np.array([fruit.center for fruit in scene.fruits]), *wood) - 2.0 * CLOSE_NOISE_M
    fruits = tuple(
        fruit.with_values(radius=min(fruit.radius, float(most)))
        for fruit, most in zip(scene.fruits, room, strict=True)
        if most > LEAST_FRUIT_M
    )
    return scene.with_values(robot=arm, fruits=fruits, goal=Goal(fruit=fruits[0].name))


def main(
    seconds: float = 8.0,
    *,
    scene: Scene | str = "tour",
    deadline_s: float | None = AHEAD_S,
    unknown: Unknown = "free",
    bending: bool = False,
) -> Log:
    """Pick for a while, and print the result."""
    tracking = WRONG_MASSES_RAD if bending else TRACKING_ERROR_RAD
    options = hplan.PlanOptions(deadline_s=deadline_s, tracking_error=tracking)
    scene = hplan.load_scene(scene) if isinstance(scene, str) else scene
    loop = ControlLoop(scene, options, unknown, bending=bending)
    for number in range(round(seconds / TICK_S)):
        loop.tick(number)
    log = loop.log
    log.contacts = loop.machine.contacts
    print(f"{len(log.picked)} fruits picked, {len(log.left)} left, in {seconds:g} s: {', '.join(log.picked)}")
    print(f"{log.frames} frames, {log.views} views from the mast, {log.spliced} motions spliced, {log.stops} stops")
    print(f"frames taken up in {np.median(log.seen_ms):.0f} ms, planned anew in {np.median(log.planned_ms):.0f} ms")
    print(f"joints at most {1e3 * log.farthest_off_rad:.2f} mrad off; contacts: {log.contacts or 'none'}")
    if loop.machine.trees is not None:
        log.trees = trees = loop.machine.trees.response({})
        print(f"largest forces: {trees.limb_force_n:.1f} N on limbs, {trees.fruit_force_n:.1f} N on fruit")
        for words, damage in (("broken", trees.broken), ("knocked off", trees.knocked_off)):
            print(f"{words}: {', '.join(one.name for one in damage) or 'nothing'}")
    return log


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Pick fruit with a controller, in MuJoCo.")
    parser.add_argument("seconds", type=float, nargs="?", default=8.0, help="of simulation")
    parser.add_argument("--unknown", choices=("free", "solid"), default="free", help="treatment of unseen space")
    parser.add_argument("--bending", action="store_true", help="limbs that bend in the wind, and errors in the field")
    parser.add_argument("--tree", type=Path, help="a measured tree instead of the tour that ships with hplan")
    parser.add_argument("--distance", type=float, default=1.4, help="of the tree [m]")
    parser.add_argument("--arm", default="orchard_harvester", help="arm that picks from the tree")
    parser.add_argument("--deadline", type=float, default=AHEAD_S, help="of each plan [s]; 0 for none")
    given = parser.parse_args()
    orchard = "tour" if given.tree is None else tree_in_front(given.tree, given.distance, given.arm)
    main(given.seconds, scene=orchard, deadline_s=given.deadline or None, unknown=given.unknown, bending=given.bending)
