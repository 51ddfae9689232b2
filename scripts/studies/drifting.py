"""Random new goals at 200 Hz for an arm among balls of bounded acceleration, in simulated time.

Each tick of `TICK_S` the balls are seen with an error, and predicted at constant speed with a `Drift`; the goal changes
to a random one. Motions are planned to the predicted places (`PLANNED_EVERY` ticks; between them the arm keeps its
motion). They are followed only as long as a stop that begins one tick later is certified within the drift; otherwise
the arm runs the stop of the tick before, and starts again from rest. The balls accelerate at random within the bound.

What the arm did is judged from outside: contacts with the true balls at fine steps, and limits by differences of
positions. Balls do not avoid the arm, so they may strike it once it rests: such contacts are counted separately.
"""

from __future__ import annotations

import numpy as np
from studies.arms import free_ends, reach_of, scene_between
from studies.harness import Row, Study, StudyConfig
from studies.measure import or_error, timed
from studies.outside import arm_of, obstacles_of
from studies.validation import judge
from studies.validation.judge import SampledMotion
from studies.validation.random_worlds import direction

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere
from hplan.scene.tracks import Drift, Track
from hplan.trajectory.trajectory import Trajectory

#: The arms, the number of ticks in each problem, and of ticks between two plans.
ARMS, TICKS, PLANNED_EVERY = ("harvester", "panda", "ur5"), 200, 32

#: Time between two goals, and between two samples of what the arm did [s]; ticks are multiples of samples.
TICK_S, SAMPLE_S = 5e-3, 1e-3

#: Number of balls and of goals; radius [m], initial speed [m/s] and maximum acceleration [m/s^2] of the balls.
BALLS, GOALS, RADIUS_M, SPEED_M_S, MOST_M_S2 = 5, 12, 0.08, 0.4, 1.0

#: What the planner knows of a ball: maximum errors of position and velocity; how far ahead it is predicted [s].
DRIFT, AHEAD_S = Drift(radius_m=2e-3, speed_m_s=0.02, acceleration_m_s2=MOST_M_S2), 4.0

#: Allowed excess of limits by differences of rounded positions, as a fraction.
ROUNDING = 1e-3

#: Speed of a joint below which the arm counts as resting [rad/s, m/s].
RESTING = 1e-6


class Balls:
    """Balls that accelerate at random about the arm."""

    def __init__(self, rng: np.random.Generator, extent: float) -> None:
        self._rng, self._extent = rng, extent
        turns = rng.uniform(-np.pi, np.pi, BALLS)
        ring = np.column_stack([np.cos(turns), np.sin(turns), rng.uniform(0.2, 0.6, BALLS)])
        self.places = extent * ring * (0.65, 0.65, 1.0)
        self.speeds = np.array([SPEED_M_S * direction(rng) for _ in range(BALLS)])
        self.path = [self.places.copy()]

    def tick(self) -> None:
        """Move the balls on by a tick, at constant acceleration."""
        # Within a thick ring about the base, which they do not touch, and no faster than at first if possible.
        level = self.places * (1.0, 1.0, 0.0)
        back = 0.65 * self._extent * level / np.linalg.norm(level, axis=1, keepdims=True) - self.places
        back[:, 2] += 0.4 * self._extent
        is_fast = np.linalg.norm(self.speeds, axis=1, keepdims=True) > SPEED_M_S
        is_out = np.linalg.norm(back, axis=1, keepdims=True) > 0.25 * self._extent
        pull = np.where(is_fast, -self.speeds, [direction(self._rng) for _ in range(BALLS)])
        pull = np.where(is_out, back, pull)
        pull /= np.linalg.norm(pull, axis=1, keepdims=True)
        push = MOST_M_S2 * pull
        self.places = self.places + TICK_S * self.speeds + 0.5 * TICK_S**2 * push
        self.speeds = self.speeds + TICK_S * push
        self.path.append(self.places.copy())

    def seen(self, now: float) -> list[Sphere]:
        """The balls as a camera reports them, predicted from now on."""
        found = []
        for number, (place, speed) in enumerate(zip(self.places, self.speeds, strict=True)):
            center = place + DRIFT.radius_m * direction(self._rng)
            ahead = AHEAD_S * (speed + DRIFT.speed_m_s * direction(self._rng))
            track = Track(times_s=(now, now + AHEAD_S), shifts_m=((0.0, 0.0, 0.0), tuple(ahead.tolist())), drift=DRIFT)
            found.append(Sphere(name=f"ball {number}", center=tuple(center.tolist()), radius=RADIUS_M, track=track))
        return found


class Arm:
    """An arm that follows planned motions as long as it has a certified stop.

    Attributes:
        stop: The motion with the certified stop that the arm would run now, and its start time [s]; None at first.
        stop_ms: CPU time of each certified stop [ms].
        counts: Number of ticks by what the arm does, and of plans by their outcome.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        options = PlanOptions(effort="quick")
        # One planner plans to the predicted places; the other certifies stops within the drift.
        self._robot, self._planner, self._guard = robot, Planner(robot, scene, options), Planner(robot, scene, options)
        self._rest = scene.start.configuration
        self._is_stopping = True
        self.stop: tuple[Trajectory, float] | None = None
        self.stop_ms = list[float]()
        self.counts = dict.fromkeys(("moving", "stopping", "resting", "planned", "not found", "not guarded"), 0)

    def tick(self, number: int, balls: list[Sphere], goal: Goal) -> None:
        """Take the balls as seen at a tick and a new goal; decide what to follow up to the next one."""
        now, planner, guard = number * TICK_S, self._planner, self._guard
        still = tuple(item for item in planner.scene.obstacles if item.track is None)
        exact = [ball.with_values(track=ball.track.copy_unchecked({"drift": None})) for ball in balls if ball.track]
        planner.scene = planner.scene.copy_unchecked({"obstacles": (*still, *exact), "goal": goal})
        guard.scene = guard.scene.copy_unchecked({"obstacles": (*still, *balls), "goal": goal})
        at_rest = self.stop is None or now >= self.stop[1] + self.stop[0].duration
        plans = number % PLANNED_EVERY == 0
        if self._is_stopping and not (at_rest and plans):
            self.counts["resting" if at_rest else "stopping"] += 1
            return
        if self._is_stopping:
            self._start(now)
        else:
            self._go_on(now, plans)
        self.counts["resting" if at_rest and self._is_stopping else "stopping" if self._is_stopping else "moving"] += 1

    def _start(self, now: float) -> None:
        """Plan from rest, and start if a stop is certified."""
        rest = Start(joints_rad=tuple(self._at(now).tolist()))
        for planner in (self._planner, self._guard):
            planner.aim(start=rest)
        found = or_error(lambda: self._planner.plan(begins_s=now))
        self.counts["not found" if isinstance(found, HplanError) else "planned"] += 1
        if not isinstance(found, HplanError) and found.trajectory.duration > TICK_S:
            self._guard.last = found
            self._is_stopping = not self._guarded(now)

    def _go_on(self, now: float, plans: bool) -> None:
        """Follow a new motion or the running one if a stop from it is certified, and otherwise the last stop."""
        guard, running = self._guard, self._guard.last
        if running is None or now + TICK_S >= running.begins_s + running.trajectory.duration:
            self._is_stopping = True  # its end is the stop
            return
        if plans:
            self._planner.last = running
            found = or_error(lambda: self._planner.replan(at=now + TICK_S, now=now))
            self.counts["not found" if isinstance(found, HplanError) else "planned"] += 1
            if not isinstance(found, HplanError):
                guard.last = found
                if self._guarded(now):
                    return
                guard.last = running
        self._is_stopping = not self._guarded(now)

    def _guarded(self, now: float) -> bool:
        """Take the stop that begins at the next tick on the guard's motion, if it is certified."""
        end_s = self._guard.last.begins_s + self._guard.last.trajectory.duration if self._guard.last else now
        found, took_ms = timed(lambda: or_error(lambda: self._guard.stop_at(min(now + TICK_S, end_s), now=now)))
        self.stop_ms.append(took_ms)
        if isinstance(found, HplanError) or not found.certificate.verified:
            self.counts["not guarded"] += 1
            return False
        self.stop = found.trajectory, found.begins_s
        return True

    def _at(self, time_s: float) -> FloatArray:
        found: FloatArray = self.positions(np.array([time_s]))[0]
        return found

    def positions(self, clock: FloatArray) -> FloatArray:
        """(n, dof) positions of the motion with its stop at (n,) times [s]."""
        if self.stop is None:
            return np.tile(self._rest, (len(clock), 1))
        trajectory, begins_s = self.stop
        return trajectory.positions(np.clip(clock - begins_s, 0.0, trajectory.duration))


def _row(config: StudyConfig, number: int) -> list[Row]:
    robot = load_robot(ARMS[number % len(ARMS)])
    rng = np.random.default_rng([config.seed, number])
    extent = reach_of(robot, rng)
    floor = Box(name="floor", center=(0.0, 0.0, -0.08), size=(4.0, 4.0, 0.1))
    ends = [ends for _ in range(GOALS) if (ends := free_ends(robot, rng, [floor], extent)) is not None]
    goals = [Goal(joints_rad=tuple(q.tolist())) for pair in ends for q in pair]
    scene = scene_between(f"drifting {config.seed}-{number}", *ends[0], [floor])
    balls, arm = Balls(rng, extent), Arm(robot, scene)
    ticks = int(config.values.get("ticks", [TICKS])[0])
    steps, done = round(TICK_S / SAMPLE_S), list[FloatArray]()
    for tick in range(ticks):
        arm.tick(tick, balls.seen(tick * TICK_S), goals[int(rng.integers(len(goals)))])
        clock: FloatArray = SAMPLE_S * np.arange(tick * steps, (tick + 1) * steps, dtype=np.float64)
        done.append(arm.positions(clock))
        balls.tick()
    q = np.concatenate(done)
    row: Row = {"name": scene.name, "arm": robot.name, "retargets": ticks, "stop_ms": np.median(arm.stop_ms or [0.0])}
    row |= arm.counts | _judged(robot, scene, q, balls)
    row["fault"] = row["contacts"] > 0 or max(row["velocity"], row["acceleration"]) > 1.0 + ROUNDING
    return [row]


def _judged(robot: Robot, scene: Scene, q: FloatArray, balls: Balls) -> Row:
    """Contacts of the moving and of the resting arm with the true balls, and use of limits by differences."""
    v, a = np.diff(q, axis=0) / SAMPLE_S, np.diff(q, 2, axis=0) / SAMPLE_S**2
    clock = np.arange(len(q)) * SAMPLE_S
    times = TICK_S * np.arange(len(balls.path))
    items = []
    for number in range(BALLS):
        path = np.array([places[number] for places in balls.path])
        track = {"times_s": times, "shifts_m": path, "rpy_deg": None, "about": None}
        items.append(
            {"name": f"ball {number}", "kind": "sphere", "center": (0, 0, 0), "radius": RADIUS_M, "track": track}
        )
    moves = np.append(np.abs(v).max(axis=1) > RESTING, False)
    struck = {True: 0, False: 0}
    # The motion in pieces that move or rest.
    edges = np.flatnonzero(np.diff(moves)) + 1
    for piece in np.split(np.arange(len(q)), edges):
        rows = np.append(piece, min(piece[-1] + 1, len(q) - 1)) if len(piece) == 1 else piece
        motion = SampledMotion(robot.joint_names, clock[rows] - clock[rows[0]], q[rows])
        listed = [*obstacles_of(scene), *judge.read_obstacles(items)]
        struck[bool(moves[piece[0]])] += len(
            judge.contacts(arm_of(robot), motion, listed, start_time_s=float(clock[rows[0]]))
        )
    return {
        "contacts": struck[True],
        "struck_at_rest": struck[False],
        "velocity": float((np.abs(v) / robot.velocity_limit).max()),
        "acceleration": float((np.abs(a) / robot.acceleration_limit).max()),
        "outside": float(np.maximum(robot.lower - q, q - robot.upper).max().clip(0.0)),
    }


DRIFTING = Study(
    "drifting",
    "random goals at 200 Hz among balls of bounded acceleration, with a certified stop at every tick",
    _row,
    (
        "retargets",
        "contacts",
        "velocity",
        "acceleration",
        "outside",
        "struck_at_rest",
        "moving",
        "stopping",
        "resting",
        "planned",
        "not found",
        "not guarded",
        "stop_ms",
    ),
    by="arm",
    count=(30, 3),
    peers=(),
    warm=3,
)
