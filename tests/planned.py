"""Plans for the tests, and checks of every plan without the planner's formulas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.collision.coal_scene import CoalScene
from hplan.planar.family_reader import family_of
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.planning.result import PlanResult
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.trajectory.trajectory import Trajectory

Obstacles = Sequence[Any]

#: Maximum deviation of the tool from its line on the approach: samples are averages over the time of the jerk limit
#: [m].
STRAIGHT = 1e-4


def task(start: Sequence[float], goal: Sequence[float] | Goal, obstacles: Obstacles = (), **more: Any) -> Scene:
    """From joints [deg] to joints [deg] or to another goal."""
    end = goal if isinstance(goal, Goal) else Goal(joints_deg=tuple(goal))
    return Scene(name="test", start=Start(joints_deg=tuple(start)), goal=end, obstacles=tuple(obstacles), **more)


def at(bearing_deg: float, distance: float, z: float) -> tuple[float, float, float]:
    """A point by its bearing and its distance from the yaw axis."""
    bearing = math.radians(bearing_deg)
    return (distance * math.cos(bearing), distance * math.sin(bearing), z)


def post(
    name: str, bearing_deg: float, distance: float, low: float, high: float, radius: float = 0.03, **more: Any
) -> Capsule:
    """An upright capsule."""
    ends = {"start": at(bearing_deg, distance, low), "end": at(bearing_deg, distance, high)}
    return Capsule(name=name, **ends, radius=radius, **more)


def fruit(name: str, bearing_deg: float, distance: float, z: float, radius: float = 0.04, **more: Any) -> Fruit:
    """A fruit by its bearing."""
    return Fruit(name=name, center=at(bearing_deg, distance, z), radius=radius, **more)


def frame_about_upper_arm(yaw_deg: float, lift_deg: float, half: float = 0.13) -> list[Capsule]:
    """Four bars in a square about the middle of the upper arm, which cannot get out of it."""
    yaw, lift = math.radians(yaw_deg), math.radians(lift_deg)
    out, side = np.array([math.cos(yaw), math.sin(yaw), 0.0]), np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    along = math.cos(lift) * out + math.sin(lift) * np.array([0.0, 0.0, 1.0])
    above = np.cross(along, side)
    middle = np.array([0.0, 0.0, 0.6]) + 0.7 * along
    corners = [
        tuple((middle + half * (x * side + y * above)).tolist()) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return [Capsule(name=f"bar {i}", start=corners[i], end=corners[(i + 1) % 4], radius=0.02) for i in range(4)]


def part(trajectory: Trajectory, begin: float, end: float) -> np.ndarray:
    """Numbers of the samples within a time interval."""
    return np.flatnonzero((trajectory.time >= begin - 1e-9) & (trajectory.time <= end + 1e-9))


def between_rows(trajectory: Trajectory, rows: np.ndarray, looks: int = 3) -> np.ndarray:
    """Configurations at samples, and at `looks` places on the cubic between each two."""
    time = trajectory.time[rows]
    if len(time) == 1:
        return trajectory.position[rows]
    clock = [time, *(time[:-1] + t * np.diff(time) for t in np.arange(1, looks + 1) / (looks + 1))]
    return on_cubics(trajectory, np.concatenate(clock))


def assert_clear(
    robot: Robot, scene: Scene, configurations: np.ndarray, *, sigmas: float = 3.0, touched: str | None = None
) -> None:
    """Check the clearance of every link, except those on the last joint from the touched fruit."""
    solids = scene.solids_with_goal
    if not solids:
        return
    checker = CoalScene(robot, solids)
    own = [scene.clearance] * (len(checker.obstacle_names) - len(solids))  # from parts of the arm itself
    keep = np.array([*(scene.clearance + sigmas * solid.sigma for solid in solids), *own])
    spare = np.min([checker.distances(q) for q in configurations], axis=0) - keep
    if touched is not None:
        last = [name for name, shapes in checker.parts.links.items() if shapes[0].parentJoint == robot.tool_joint]
        named = [name == touched for name in checker.obstacle_names]
        spare[np.ix_([name in last for name in checker.mover_names], named)] = np.inf
    mover, other = np.unravel_index(int(spare.argmin()), spare.shape)
    assert spare.min() > 0.0, f"{checker.mover_names[mover]} and {checker.obstacle_names[other]}: {spare.min()}"


def assert_within_limits(robot: Robot, trajectory: Trajectory) -> None:
    """Check velocities, accelerations and torques."""
    for values, limit in (
        (trajectory.velocity, robot.velocity_limit),
        (trajectory.acceleration, robot.acceleration_limit),
        (trajectory.torque, robot.torque_limit),
    ):
        assert (np.abs(values) <= LIMIT_TOLERANCE * limit).all()


def assert_sound(robot: Robot, scene: Scene, result: PlanResult, *, sigmas: float = 3.0) -> None:
    """Check certificate, limits, clearance, rest at the ends and grasp, and continuity."""
    trajectory, report = result.trajectory, result.report
    assert result.certificate.verified
    assert report["certificate"]["verified"]
    assert report["status"] == "ok"
    everything = between_rows(trajectory, np.arange(trajectory.samples))
    assert (everything >= robot.lower - 1e-9).all()
    assert (everything <= robot.upper + 1e-9).all()
    assert_within_limits(robot, trajectory)
    np.testing.assert_allclose(trajectory.position[0], scene.start.configuration, rtol=0, atol=1e-12)
    locked = [robot.joint_names.index(name) for name in scene.locked_joints]
    np.testing.assert_allclose(trajectory.position[:, locked] - trajectory.position[0, locked], 0.0, atol=1e-9)
    phases = result.phases
    assert [phases[0].start_s, phases[-1].end_s] == [0.0, trajectory.duration]
    for number, phase in enumerate(phases):
        if number:
            assert phase.start_s == phases[number - 1].end_s
        rows = part(trajectory, phase.start_s, phase.end_s)
        still = {"transit": [0], "approach": [-1], "retreat": [0, -1]}[phase.name] if len(phases) > 1 else [0, -1]
        np.testing.assert_allclose(trajectory.velocity[rows[still]], 0.0, rtol=0, atol=1e-6)
        direct = result.grasp is not None and result.grasp.distance == 0.0
        touched = scene.goal.fruit if direct or phase.name != "transit" else None
        assert_clear(robot, scene, between_rows(trajectory, rows), sigmas=sigmas, touched=touched)
    if scene.goal.listed_joints() is not None:
        np.testing.assert_allclose(trajectory.position[-1], scene.goal.configuration, rtol=0, atol=1e-12)
        assert [phase.name for phase in phases] == ["transit"]
    else:
        assert_grasps(robot, scene, result)


def assert_grasps(robot: Robot, scene: Scene, result: PlanResult) -> None:
    """Check that the tool reaches the point along the last link, and retreats."""
    grasp, trajectory, name = result.grasp, result.trajectory, scene.goal.fruit
    assert grasp is not None
    heading = last_link(robot, grasp.goal)
    told = math.radians(result.report["grasp"]["approach_deg"])
    target = scene.goal.position if name is None else next(f.center for f in scene.fruits if f.name == name)
    ahead, up, _ = family_of(robot).plane_at(family_of(robot).yaw_of(grasp.goal))[1]
    away = np.array(target) - robot.model.jointPlacements[1].translation
    if away @ ahead < 0.0:  # behind the base: outward is the other way
        ahead = -ahead
    assert math.cos(told - math.atan2(up @ heading, ahead @ heading)) > 1.0 - 1e-9
    np.testing.assert_allclose(robot.tool_positions(grasp.goal), target, rtol=0, atol=1e-6)
    bounds = scene.goal.approach_deg
    if bounds is not None:
        low, high = bounds if isinstance(bounds, tuple) else (bounds, bounds)
        turned = (math.degrees(grasp.approach) - low + 1e-6) % 360.0
        assert turned <= high - low + 2e-6
    if grasp.distance == 0.0:
        assert [phase.name for phase in result.phases] == ["transit"]
        np.testing.assert_allclose(trajectory.position[-1], grasp.goal, rtol=0, atol=1e-9)
        return
    names = ["transit", "approach", "retreat"] if name is not None else ["transit", "approach"]
    assert [phase.name for phase in result.phases] == names
    approach = result.phases[1]
    rows = part(trajectory, approach.start_s, approach.end_s)
    q = between_rows(trajectory, rows)
    if not trajectory.velocity[rows[0]].any():
        np.testing.assert_allclose(trajectory.position[rows[0]], grasp.standoff, rtol=0, atol=1e-9)
    np.testing.assert_allclose(trajectory.position[rows[-1]], grasp.goal, rtol=0, atol=1e-9)
    heading = last_link(robot, grasp.goal)
    tools = robot.tool_positions(trajectory.position[rows])
    beside = (tools - target) - np.outer((tools - target) @ heading, heading)
    assert np.linalg.norm(beside, axis=1).max() <= STRAIGHT
    assert (np.diff(tools @ heading) > -1e-9).all()
    # A blended approach begins at the last sample before the stand-off.
    away = np.linalg.norm(tools[:2] - target, axis=1)
    assert away[0] >= grasp.distance - 1e-6
    assert min(away[0] - 1e-6, away[1]) <= grasp.distance
    assert np.linalg.norm([last_link(robot, each) - heading for each in q], axis=1).max() < 1e-3
    if name is not None:
        np.testing.assert_allclose(trajectory.position[-1], grasp.standoff, rtol=0, atol=1e-9)


def last_link(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Direction of the last link in `base_link`."""
    points = family_of(robot).arm.joint_points(np.asarray(q)[family_of(robot).arm_slice])[-2:]
    _, axes = family_of(robot).plane_at(family_of(robot).yaw_of(q))
    along = (points[1] - points[0]) @ axes[:2]
    return np.asarray(along / np.linalg.norm(along))


def random_scene(seed: int, robot: Robot) -> Scene:
    """Obstacles of all kinds and fruits about the arm, start and goal at different yaws with a little room."""
    random = np.random.default_rng(seed)
    ends = random.uniform([-180.0, 5.0, 5.0, 5.0], [180.0, 85.0, 85.0, 85.0], (2, 4))
    ends[1, 0] = np.clip(ends[0, 0] + random.choice([-1.0, 1.0]) * random.uniform(10.0, 90.0), -179.0, 179.0)
    obstacles: list[Any] = []
    fruits: list[Fruit] = []
    wanted = int(random.integers(8, 31))
    middle = float(ends[:, 0].mean())
    while len(obstacles) + len(fruits) < wanted:
        name = f"o{len(obstacles) + len(fruits)}"
        kind, size = int(random.integers(4)), float(random.uniform(0.02, 0.1))
        low, high = ([0.35, 0.3], [1.9, 2.2]) if kind < 3 else ([0.8, 1.2], [1.5, 2.0])
        place = at(float(middle + random.uniform(-60, 60)), *random.uniform(low, high).tolist())
        candidate: Any
        if kind == 0:
            candidate = Sphere(name=name, center=place, radius=size, sigma=float(random.choice([0.0, 0.003])))
        elif kind == 1:
            other = tuple((np.array(place) + random.uniform(-0.6, 0.6, 3)).tolist())
            candidate = Capsule(name=name, start=place, end=other, radius=0.3 * size)
        elif kind == 2:
            rpy = tuple(random.uniform(-180, 180, 3).tolist())
            candidate = Box(name=name, center=place, size=(2 * size, size, 3 * size), rpy_deg=rpy)
        else:
            candidate = Fruit(name=name, center=place, radius=0.04)
        ball = candidate if kind < 3 else Sphere(name=name, center=place, radius=0.04)
        checker = CoalScene(robot, [ball])
        away = min(checker.distances(np.radians(q)).min() for q in ends) > 0.02 + 3.0 * candidate.sigma
        if away and min(np.hypot(*point[:2]) for point in ball.core) > 0.3:
            (fruits if kind == 3 else obstacles).append(candidate)
    to_fruit = bool(fruits) and seed % 3 == 0
    goal = Goal(fruit=fruits[0].name) if to_fruit else Goal(joints_deg=tuple(ends[1].tolist()))
    return task(tuple(ends[0].tolist()), goal, obstacles, fruits=tuple(fruits))


def between_twigs(side: float = 0.085) -> Scene:
    """A fruit between two twigs."""
    twigs = [Sphere(name=f"twig {i}", center=(1.6, y, 1.43), radius=0.05) for i, y in enumerate((-side, side))]
    return Scene(
        name="between twigs",
        start=Start(joints_deg=(60.0, 30.0, 20.0, 20.0)),
        goal=Goal(fruit="apple"),
        obstacles=tuple(twigs),
        fruits=(Fruit(name="apple", center=(1.6, 0.0, 1.5), radius=0.03),),
    )


def straight(robot: Robot, start: Any, end: Any, duration: float = 2.0, rate_hz: float = 250.0) -> Trajectory:
    """From rest to rest, straight in joint space, by a polynomial of degree 5; `start` and `end` in radians."""
    t = np.linspace(0.0, 1.0, round(duration * rate_hz) + 1)[:, None]
    s, ds, dds = 10 * t**3 - 15 * t**4 + 6 * t**5, 30 * t**2 * (1 - t) ** 2, 60 * t * (1 - t) * (1 - 2 * t)
    turn = np.asarray(end, dtype=np.float64) - start
    q, v, a = start + s * turn, ds / duration * turn, dds / duration**2 * turn
    return Trajectory(robot.joint_names, duration * t[:, 0], q, v, a, robot.dynamics.torques(q, v, a), robot.slides)


def on_cubics(trajectory: Trajectory, time: FloatArray) -> FloatArray:
    """(n, dof) positions at (n,) times on the cubic Hermite curves of the samples."""
    row = np.clip(np.searchsorted(trajectory.time, time, side="right") - 1, 0, trajectory.samples - 2)
    h = (trajectory.time[row + 1] - trajectory.time[row])[:, None]
    t = (time - trajectory.time[row])[:, None] / h
    q, v = trajectory.position, trajectory.velocity
    return (
        (2 * t**3 - 3 * t**2 + 1) * q[row]
        + (t**3 - 2 * t**2 + t) * h * v[row]
        + (3 * t**2 - 2 * t**3) * q[row + 1]
        + (t**3 - t**2) * h * v[row + 1]
    )


def problem_between(world: World, start: ArrayLike, goal: ArrayLike, locked_joints: Sequence[str] = ()) -> Problem:
    """The problem of a motion between two configurations in a world."""
    first = Start(joints_rad=tuple(np.asarray(start, dtype=np.float64).tolist()))
    stay = Goal(joints_rad=first.joints_rad)
    scene = Scene(name="between", start=first, goal=stay, locked_joints=tuple(locked_joints))
    return Problem.from_scene(world.robot, scene, PlanOptions()).in_world(world).from_configurations(start, goal)


def posed(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> Problem:
    """The problem of a scene whose goal is given as joints."""
    problem = Problem.from_scene(robot, scene, PlanOptions() if options is None else options)
    return problem.from_configurations(scene.start.configuration, scene.goal.configuration)


#: A ball in the plane of a locked base, and configurations below and above it.
BAR = [Sphere(name="ball", center=(1.3, 0.0, 1.6), radius=0.15)]
BELOW, ABOVE = (0.0, 10.0, 10.0, 10.0), (0.0, 70.0, 10.0, 10.0)
