"""New goals for arms in motion: a certified stop at once, a certified splice soon, among still and moving obstacles.

An arm follows motions in simulated time. At each tick it sees the obstacles with their predictions (`studies.crowds`)
and a goal. `Planner.aim` gives the running motion with a stop that begins at the next tick, certified for all places
that the obstacles may take. If it is not certified, the arm goes on with the last stop that is, so there is a certified
stop at every time. Motions to the goal are planned among the predicted places alone. They take over `World.ahead` ticks
after their computation began, and are dropped if it took more CPU time than that.

An outside judge checks the executed motion: contacts with the true obstacles, and limits by position differences.
Moving obstacles do not avoid the arm and may strike it while it rests: these contacts are counted separately.

Scenes: random ones (`studies.arms`) without and with a cloud of balls (`still`, `cloud`), where the first
motion found is followed at once and improved while it runs (`--values at_once=0`: improved first); balls that
accelerate at random (`drifting`); and the scenes of Covic and Lacevic (arXiv 2603.00759) in the folder `data/xarm6` of
their program RPMPLv2, --files: `boxes`, which their program `generate_random_scenarios` draws, and `pillars`.
"""

from __future__ import annotations

import functools
import itertools
import math
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from studies import crowds
from studies.arms import FARTHEST, NEAREST, free_ends, random_scene, reach_of, scene_between
from studies.harness import Row, Study, StudyConfig
from studies.measure import or_error, ratio, timed
from studies.outside import arm_of, obstacles_of
from studies.validation import judge
from studies.validation.judge import SampledMotion
from studies.validation.random_worlds import direction

from hplan.base.arrays import FloatArray
from hplan.certificate.configuration_check import check
from hplan.certificate.retimed_certificate import CertifiedMotion
from hplan.errors import HplanError, InputError, NotInTimeError
from hplan.online.planner import Planner
from hplan.online.warm_up import warm_up
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Obstacle, PointCloud
from hplan.trajectory.trajectory import SAME_TIME

#: Kinds of scenes without files and with them, and arms of the former.
OWN, PEERS = ("still", "cloud", "drifting"), ("boxes", "pillars")
ARMS = ("harvester", "ur5", "panda")

#: Time between two samples of the executed motion [s]; ticks are multiples of it.
SAMPLE_S = 1e-3

#: Still scenes: number of ticks and their length [s]; ticks between two goals; distance of a goal from an end of the
#: scene in each joint [rad, m].
STILL_TICKS, STILL_S, STILL_EVERY, ASIDE = 40, 0.06, 5, 0.4

#: Number of balls of a cloud, number in each shell, and their radius [m].
CLOUD, SHELL, CLOUD_RADIUS_M = 300_000, 15_000, 4e-3

#: Drifting balls: number of ticks and their length [s]; ticks for a splice; goals.
DRIFT_TICKS, DRIFT_AHEAD, GOALS = 200, 32, 12

#: Peers' scenes: numbers of boxes in turn; number of speeds of pillars, in turn; length of a tick and of a run [s];
#: ticks for a splice.
BOXES, SPEEDS, PEERS_S, PEERS_RUN_S, PEERS_AHEAD = (10, 30, 50), 10, 0.05, 10.0, 6

#: Length and radius of the capsule that their program takes for the gripper, from the flange on [m].
GRIPPER_M, GRIPPER_RADIUS_M = 0.119, 0.05

#: Allowed excess of limits by differences of rounded positions, as a fraction; speed below which a joint rests [rad/s,
#: m/s]; largest distance from a goal that is reached [rad, m].
ROUNDING, RESTING, REACHED = 1e-3, 1e-6, 1e-6


@dataclass(frozen=True, eq=False)
class World:
    """A problem.

    Attributes:
        kind: Its kind.
        robot: The arm.
        scene: Start, first goal, and the obstacles that do not move.
        goals: The goals; a random one of them every `every` ticks. With one, the run ends when it is reached.
        crowd: The moving obstacles; None for none.
        tick_s: Length of a tick [s].
        ticks: Their maximum number.
        ahead: Ticks from the start of the computation of a splice until it takes over.
        every: Ticks between two goals.
        lag: Ticks from the start of the computation of a stop until the arm relies on it; 0 for a stop that takes no
            time.
    """

    kind: str
    robot: Robot
    scene: Scene
    goals: Sequence[Goal]
    crowd: crowds.Crowd | None
    tick_s: float
    ticks: int
    ahead: int = 1
    every: int = 1
    lag: int = 0


class Follower:
    """An arm that follows planned motions as long as it has a certified stop, and that stop otherwise.

    Attributes:
        counts: Number of ticks with a retarget of the moving arm, of refused stops, and of ticks at rest.
        splices: Number of plans by outcome; `improved` are faster motions to the same goal.
        stop_ms: CPU time of each `Planner.aim` of the moving arm [ms].
        splice_ms: CPU time of each motion of the moving arm to a new goal [ms].
        improve_ms: CPU time of each search for a faster motion to the same goal [ms].
        refusal_ms: CPU time until no such motion was found [ms].
        first_to_better: Durations of these motions, from the seam on, relative to another planner's.
        to_better: The same once they are improved.
    """

    def __init__(self, world: World, better: PlanOptions | None, *, at_once: bool) -> None:
        # Moving obstacles end a search that would be late; a loaded machine's clock runs faster than CPU time.
        deadline_s = None if world.crowd is None else max(1.0, 5.0 * world.ahead * world.tick_s)
        options = PlanOptions(effort="quick", at_once=at_once, deadline_s=deadline_s)
        self._world, self._planner = world, Planner(world.robot, world.scene, options)
        self._better = None if better is None else Planner(world.robot, world.scene, better)
        self._rest = world.scene.start.configuration
        # True if the next motion is planned among the predicted ways of the obstacles.
        self._in_time = True
        # The motion with a certified stop that the arm follows, and the plan that it is from.
        self._held: CertifiedMotion | None = None
        self._followed: PlanResult | None = None
        # The previous tick's stop with its plan and CPU time [ms]; a new motion, and the tick when it is known.
        self._asked: tuple[CertifiedMotion, PlanResult, float] | None = None
        self._coming: tuple[PlanResult, int] | None = None
        self.counts = dict.fromkeys(("retargets", "refused", "resting"), 0)
        self.splices = Counter[str]()
        self.stop_ms, self.splice_ms, self.improve_ms, self.refusal_ms = (list[float]() for _ in range(4))
        self.first_to_better, self.to_better = list[float](), list[float]()
        # Seam of the last splice to a new goal, and the ends of its motion and of the other planner's [s].
        self._compared: tuple[float, float, float] | None = None

    def positions(self, clock: FloatArray) -> FloatArray:
        """(n, dof) positions at (n,) times [s], as long as nothing else is decided."""
        if self._held is None:
            return np.tile(self._rest, (len(clock), 1))
        trajectory = self._held.trajectory
        return trajectory.positions(np.clip(clock - self._held.begins_s, 0.0, trajectory.duration))

    def rests_at(self, goal: Goal, now: float) -> bool:
        """True if the arm rests at a goal."""
        ends = 0.0 if self._held is None else self._held.begins_s + self._held.trajectory.duration
        return now >= ends and bool(np.abs(self._at(now) - goal.configuration).max() <= REACHED)

    def _at(self, now: float) -> FloatArray:
        found: FloatArray = self.positions(np.array([now]))[0]
        return found

    def tick(self, number: int, seen: Sequence[Obstacle], goal: Goal) -> None:
        """Choose the motion from a tick on, among the obstacles as seen and predicted now."""
        world, planner, now = self._world, self._planner, number * self._world.tick_s
        if self._coming is not None and number >= self._coming[1]:
            planner.last, self._coming = self._coming[0], None
        self._decide(now)
        last = planner.last
        # A stop that takes a tick to compute is requested one tick before the motion begins.
        if last is not None and last.begins_s <= now + world.lag * world.tick_s + SAME_TIME and now < _end_s(last):
            self._show(seen)
            begin = max(now, last.begins_s)
            at = min(now + (1 + world.lag) * world.tick_s, _end_s(last))
            stop, took_ms = timed(lambda: planner.aim(goal=goal, now=begin, at=at, measured=self._at(begin)))
            self.stop_ms.append(took_ms)
            self.counts["retargets"] += 1
            self._asked = stop, last, took_ms
            if world.lag == 0:
                self._decide(now)
        else:
            self.counts["resting"] += 1
        if number % world.ahead == 0 and self._coming is None and not self.rests_at(goal, now):
            self._show([crowds.planned_around(item) for item in seen])
            self._plan(number, goal)

    def _show(self, seen: Sequence[Obstacle]) -> None:
        """Give moving obstacles to the planner."""
        scene, changes = self._world.scene, {"goal": self._planner.scene.goal}
        self._planner.scene = scene.copy_unchecked(changes | {"obstacles": (*scene.obstacles, *seen)})

    def _decide(self, now: float) -> None:
        """Follow the motion with the requested stop if the stop is certified and known in time."""
        if self._asked is None:
            return
        (stop, last, took_ms), self._asked, world = self._asked, None, self._world
        if stop.certificate.verified and (world.lag == 0 or took_ms <= 1e3 * world.lag * world.tick_s):
            self._held, self._followed = stop, last
            return
        self.counts["refused"] += 1
        held, planner, self._coming = self._held, self._planner, None
        if held is None or now >= held.begins_s + held.trajectory.duration:
            planner.last = None  # a motion that has not begun
            return
        planner.last = self._followed
        if self._followed is not None and self._followed.trajectory is not held.trajectory:
            self._followed = planner.use(held)

    def _plan(self, number: int, goal: Goal) -> None:
        """Plan a motion to the goal that takes over, or begins, a few ticks later."""
        world, planner, before = self._world, self._planner, self._planner.last
        now, at = number * world.tick_s, (number + world.ahead) * world.tick_s
        is_moving = before is not None and now < _end_s(before)
        if before is not None and is_moving and not before.begins_s - SAME_TIME <= now < at <= _end_s(before):
            return  # it has not begun, or ends before
        if not self._in_time:
            planner.scene = planner.scene.snapshot(at)
        found: PlanResult | HplanError
        if is_moving:
            found, took_ms = timed(lambda: or_error(lambda: planner.replan(at=at, now=now, measured=self._at(now))))
        else:
            # An obstacle may have come nearer than it is for plans.
            near = None if self._in_time else crowds.WIDER_M
            planner.aim(start=Start(joints_rad=tuple(self._at(now).tolist()), contact_depth=near), goal=goal)
            found, took_ms = timed(lambda: or_error(lambda: planner.plan(begins_s=at)))
        planner.last = before
        is_kept = getattr(found, "is_kept", False)
        is_new = before is not None and is_moving and before.scene.goal != planner.scene.goal
        if is_new:
            (self.refusal_ms if isinstance(found, HplanError) else self.splice_ms).append(took_ms)
            self.compare(found, before, at, now)
        elif is_moving and getattr(found, "is_improved", False) and not getattr(before, "is_improved", False):
            self.improve_ms.append(took_ms)
        known = number + math.ceil(1e-3 * took_ms / world.tick_s)
        is_late = known + world.lag > number + world.ahead or isinstance(found, NotInTimeError)
        is_error = isinstance(found, HplanError)
        if not (is_late or isinstance(found, HplanError)):
            self._coming = found, known
        # After a failure, the next plan takes the obstacles as fixed at their predicted places.
        self._in_time = not (self._in_time and (is_late or is_error))
        if is_late and is_new:
            self._compared = None  # it is not followed
        is_improved = is_moving and not is_new and not is_kept and getattr(found, "is_improved", False)
        if self._compared is not None and self._coming is not None and is_improved:
            self._compared = *self._compared[:2], _end_s(self._coming[0])
        is_found = "kept" if is_kept else "improved" if is_improved else "certified"
        self.splices["late" if is_late else type(found).__name__ if is_error else is_found] += 1

    def compare(
        self, found: PlanResult | HplanError | None, before: PlanResult | None = None, at: float = 0.0, now: float = 0.0
    ) -> None:
        """Note the last splice as it was improved, and plan the same one as a found one with another effort."""
        if self._compared is not None:
            at_s, better_s, end_s = self._compared
            self.to_better.append(ratio(end_s - at_s, better_s - at_s) or math.inf)
            self._compared = None
        other = self._better
        if other is None or found is None or isinstance(found, HplanError):
            return
        other.scene, other.last = self._planner.scene, before
        better = or_error(lambda: other.replan(at=at, now=now))
        if not isinstance(better, HplanError):
            self._compared = at, _end_s(better), _end_s(found)
            self.first_to_better.append(ratio(_end_s(found) - at, _end_s(better) - at) or math.inf)


def _end_s(plan: PlanResult) -> float:
    """End of a motion on the controller's clock [s]."""
    return plan.begins_s + plan.trajectory.duration


def _row(config: StudyConfig, problem: tuple[str, int]) -> Row:
    kind, number = problem
    rng = np.random.default_rng([config.seed, number])
    world = _WORLDS[kind](config, number, rng)
    ticks = int(config.values.get("ticks", [world.ticks])[0])
    better = PlanOptions(effort=config.effort) if world.crowd is None else None
    at_once = world.crowd is None and bool(config.values.get("at_once", [1])[0])
    arm = Follower(world, better, at_once=at_once)
    samples, done, goal = round(world.tick_s / SAMPLE_S), list[FloatArray](), world.goals[0]
    target_s = None
    for tick in range(ticks):
        now = tick * world.tick_s
        if len(world.goals) > 1 and tick % world.every == 0:
            goal = world.goals[int(rng.integers(len(world.goals)))]
        if world.crowd is not None:
            world.crowd.advance(now)
        if len(world.goals) == 1 and arm.rests_at(goal, now):
            target_s = now
            break
        arm.tick(tick, [] if world.crowd is None else world.crowd.seen(now), goal)
        clock: FloatArray = SAMPLE_S * np.arange(tick * samples, (tick + 1) * samples, dtype=np.float64)
        done.append(arm.positions(clock))
    arm.compare(None)
    if world.crowd is not None:
        world.crowd.advance(ticks * world.tick_s)
    row: Row = {"name": world.scene.name, "arm": world.robot.name, "kind": [kind, f"{kind}, {world.robot.name}"]}
    row |= arm.counts | _judged(world, np.concatenate(done))
    for key in ("splices", "stop_ms", "splice_ms", "improve_ms", "refusal_ms", "first_to_better", "to_better"):
        row[key] = getattr(arm, key)
    if len(world.goals) == 1:
        row |= {"success": target_s is not None and row["contacts"] + row["struck_at_rest"] == 0, "target_s": target_s}
    row["fault"] = row["contacts"] > 0 or max(row["velocity"], row["acceleration"]) > 1.0 + ROUNDING
    return row


def _judged(world: World, q: FloatArray) -> Row:
    """Contacts of the moving and of the resting arm, and use of limits by differences of (n, dof) positions."""
    robot = world.robot
    v, a = np.diff(q, axis=0) / SAMPLE_S, np.diff(q, 2, axis=0) / SAMPLE_S**2
    clock = np.arange(len(q)) * SAMPLE_S
    items = [*obstacles_of(world.scene), *([] if world.crowd is None else world.crowd.judged())]
    moves = np.append(np.abs(v).max(axis=1) > RESTING, False)
    struck = {True: 0, False: 0}
    # The motion in pieces that move or rest.
    for piece in np.split(np.arange(len(q)), np.flatnonzero(np.diff(moves)) + 1):
        rows = np.append(piece, min(piece[-1] + 1, len(q) - 1)) if len(piece) == 1 else piece
        motion = SampledMotion(robot.joint_names, clock[rows] - clock[rows[0]], q[rows])
        found = judge.contacts(arm_of(robot), motion, items, start_time_s=float(clock[rows[0]]))
        struck[bool(moves[piece[0]])] += len(found)
    return {
        "contacts": struck[True],
        "struck_at_rest": struck[False],
        "velocity": float((np.abs(v) / robot.velocity_limit).max()),
        "acceleration": float((np.abs(a) / robot.acceleration_limit).max()),
        "outside": float(np.maximum(robot.lower - q, q - robot.upper).max().clip(0.0)),
    }


@functools.cache
def _ready_arm(name: str) -> Robot:
    """An arm after the warm-up that programs of controllers begin with."""
    robot = load_robot(name)
    warm_up(robot)
    return robot


def _still(config: StudyConfig, number: int, rng: np.random.Generator) -> World:
    robot = _ready_arm(ARMS[number % len(ARMS)])
    scene = random_scene(robot, config.seed, number)
    return _with_goals("still", robot, scene, rng)


def _cloud(config: StudyConfig, number: int, rng: np.random.Generator) -> World:
    """A still scene with more obstacles: shells of balls, clear of its start and goal."""
    robot = _ready_arm(ARMS[number % len(ARMS)])
    scene = random_scene(robot, config.seed, number)
    reach_m, shells = reach_of(robot, rng), list[PointCloud]()
    while len(shells) < CLOUD // SHELL:
        rays = rng.normal(size=(SHELL, 3))
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        points = direction(rng) * reach_m * rng.uniform(NEAREST, FARTHEST) + rays * rng.uniform(0.05, 0.25, 3)
        shell = PointCloud.from_thinned(f"shell {len(shells)}", points, CLOUD_RADIUS_M)
        alone = scene.with_values(obstacles=(shell,))
        if all(check(robot, alone, end.configuration).valid for end in (scene.start, scene.goal)):
            shells.append(shell)
    name, obstacles = scene.name.replace("random", "cloud"), (*scene.obstacles, *shells)
    return _with_goals("cloud", robot, scene.with_values(name=name, obstacles=obstacles), rng)


def _with_goals(kind: str, robot: Robot, scene: Scene, rng: np.random.Generator) -> World:
    """A still scene with goals near its ends, clear of everything."""
    goals = [scene.goal]
    for change in range(STILL_TICKS // STILL_EVERY):
        near = (scene.start, scene.goal)[change % 2].configuration
        low, high = np.maximum(robot.lower, near - ASIDE), np.minimum(robot.upper, near + ASIDE)
        drawn = (rng.uniform(low, high) for _ in itertools.count())
        goals.append(Goal(joints_rad=tuple(next(q for q in drawn if check(robot, scene, q).valid).tolist())))
    return World(kind, robot, scene, goals, None, STILL_S, STILL_TICKS, every=STILL_EVERY)


def _drifting(config: StudyConfig, number: int, rng: np.random.Generator) -> World:
    robot = _ready_arm(ARMS[number % len(ARMS)])
    extent = reach_of(robot, rng)
    floor = Box(name="floor", center=(0.0, 0.0, -0.08), size=(4.0, 4.0, 0.1))
    ends = [ends for _ in range(GOALS) if (ends := free_ends(robot, rng, [floor], extent)) is not None]
    goals = [Goal(joints_rad=tuple(q.tolist())) for pair in ends for q in pair]
    scene = scene_between(f"drifting {config.seed}-{number}", *ends[0], [floor])
    return World(
        "drifting", robot, scene, goals, crowds.DriftingBalls(rng, extent), crowds.STEP_S, DRIFT_TICKS, DRIFT_AHEAD
    )


@functools.cache
def _peers_files(folder: Path, name: str) -> tuple[Robot, dict[str, Any]]:
    """The peers' arm with its gripper, and one of their files."""
    scenario = _read(folder / f"{name}/{name}.yaml")
    # The limits of the scenario are the robot's; the gripper counts to the last link.
    tree, place = ElementTree.parse(folder / "xarm6.urdf"), Path(tempfile.mkdtemp())
    (place / "collision").symlink_to((folder / "collision").absolute())
    link = next(link for link in tree.iter("link") if link.get("name") == "link6")
    radius, ends = f'radius="{GRIPPER_RADIUS_M}"', (0.0, 0.5 * GRIPPER_M, GRIPPER_M)
    shapes = (f"<sphere {radius}/>", f'<cylinder {radius} length="{GRIPPER_M}"/>', f"<sphere {radius}/>")
    for shape, z in zip(shapes, ends, strict=True):
        text = f'<collision><origin xyz="0 0 {z}"/><geometry>{shape}</geometry></collision>'
        link.append(ElementTree.fromstring(text))
    tree.write(place / "xarm6.urdf")
    names = [joint.get("name") for joint in tree.iter("joint") if joint.get("type") == "revolute"]
    limits: dict[str, Any] = {"format": "hplan-limits/1"}
    for theirs, ours in (("vel", "velocity_rad_s"), ("acc", "acceleration_rad_s2"), ("jerk", "jerk_rad_s3")):
        limits[ours] = dict(zip(names, map(float, scenario["robot"][f"max_{theirs}"]), strict=True))
    (place / "xarm6.limits.yaml").write_text(yaml.safe_dump(limits), encoding="utf-8")
    return load_robot(place / "xarm6.urdf", tool_frame="link_eef", allow_neighbours=True), scenario


def _peers(config: StudyConfig, name: str) -> tuple[Robot, dict[str, Any], Path]:
    """The peers' arm, a scenario, and its folder."""
    if config.files is None:
        raise InputError("the scenes boxes and pillars need --files, RPMPLv2's folder data/xarm6", missing=["files"])
    return *_peers_files(config.files, name), config.files / name


def _fixed(scenario: dict[str, Any]) -> list[Box]:
    """The boxes of a scenario; the ground is a millimetre lower, to clear the base."""
    items = [item["box"] for item in scenario["environment"]]
    lower = [1e-3 if item.get("label") == "ground" else 0.0 for item in items]
    return [
        Box(name=f"box {k}", center=(*item["pos"][:2], item["pos"][2] - low), size=tuple(item["dim"]))
        for k, (item, low) in enumerate(zip(items, lower, strict=True))
    ]


@functools.cache
def _read(file: Path) -> dict[str, Any]:
    """A YAML file of the peers."""
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: no file of RPMPLv2's folder data/xarm6: {error.strerror}", path=str(file)) from error
    # YAML has no tabs; their reader allows them.
    found: dict[str, Any] = yaml.load(text.replace("\t", " "), Loader=yaml.CSafeLoader)
    return found


def _boxes(config: StudyConfig, number: int, _: np.random.Generator) -> World:
    """Small boxes that fly straight and are reflected by the border of the workspace and around the base."""
    robot, scenario, folder = _peers(config, "scenario_random_obstacles")
    count, run = BOXES[number % len(BOXES)], number // len(BOXES)
    listed = _read(folder / "random_scenarios.yaml")[f"scenario_{count}"][f"run_{run}"]
    each = [listed[key] for key in listed if key.startswith("object")]
    places, velocities = (np.array([item[key] for item in each], dtype=np.float64) for key in ("pos", "vel"))
    size = tuple(scenario["random_obstacles"]["dim"])
    shapes = [Box(name=f"flying {k}", center=(0.0, 0.0, 0.0), size=size) for k in range(len(each))]
    scene = scene_between(f"boxes {count}-{run}", np.array(listed["start"]), np.array(listed["goal"]), _fixed(scenario))
    # Their program moves them in steps of at most 1 cm, in single precision.
    step_s = PEERS_S / math.ceil(
        np.float32(scenario["random_obstacles"]["max_vel"]) * np.float32(PEERS_S) / np.float32(0.01)
    )
    base = max(scenario["robot"]["capsules_radius"][:2]) + float(np.linalg.norm(size))
    law = functools.partial(crowds.reflected, step_s=step_s, robot=scenario["robot"], base=base)
    return _peers_world("boxes", robot, scene, crowds.LawfulObjects(shapes, places, velocities, step_s, law))


def _pillars(config: StudyConfig, number: int, _: np.random.Generator) -> World:
    """Four pillars that go round the arm."""
    robot, scenario, _folder = _peers(config, "scenario1")
    ground, *pillars = _fixed(scenario)
    places = np.array([pillar.center for pillar in pillars])
    start, goal = (np.clip(scenario["robot"][key], robot.lower, robot.upper) for key in ("q_start", "q_goal"))
    scene = scene_between(f"pillars {config.seed}-{number}", start, goal, [ground])
    speed = scenario["testing"]["max_vel_obs"] * (number % SPEEDS + 0.5) / SPEEDS
    law = functools.partial(crowds.circled, step_s=0.5 * PEERS_S, speed=speed)
    return _peers_world(
        "pillars", robot, scene, crowds.LawfulObjects(pillars, places, 0.0 * places, 0.5 * PEERS_S, law)
    )


def _peers_world(kind: str, robot: Robot, scene: Scene, crowd: crowds.Crowd) -> World:
    ticks = round(PEERS_RUN_S / PEERS_S)
    return World(kind, robot, scene, [scene.goal], crowd, PEERS_S, ticks, PEERS_AHEAD, lag=1)


_WORLDS = {"still": _still, "cloud": _cloud, "drifting": _drifting, "boxes": _boxes, "pillars": _pillars}


def _problems(config: StudyConfig) -> Iterator[tuple[str, int]]:
    kinds = config.chosen(_WORLDS) if config.only else OWN
    return ((kind, number) for kind in kinds for number in config.numbers)


RETARGETS = Study(
    "retargets",
    "new goals for arms in motion, among still and moving obstacles, with a certified stop at every time",
    _row,
    (
        "retargets",
        "refused",
        "resting",
        "stop_ms",
        "splice_ms",
        "improve_ms",
        "refusal_ms",
        "first_to_better",
        "to_better",
        "contacts",
        "struck_at_rest",
        "velocity",
        "acceleration",
        "outside",
        "success",
        "target_s",
    ),
    problems=_problems,
    by="kind",
    totals=("retargets", "refused", "resting", "contacts", "struck_at_rest", "splices"),
    count=(30, 3),
    peers=(),
    warm=1,
    choices=((*OWN, *PEERS),),
    percentiles=(50, 95, 99),
)
