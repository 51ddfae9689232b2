"""Anytime planning among moving obstacles, certified in space and time.

Paths are planned without the moving obstacles (on a moving base: among all obstacles at their initial poses), and, if
that motion would collide, around the volume that they sweep meanwhile and around their poses at the collision, at the
start and at the end. A motion along each path runs unchanged if it is certified; otherwise it gets the earliest timing
through its cells of path and time (`hplan.planning.schedule`): it waits at a clear configuration, slows down, or
passes before the obstacle comes. If no motion from a start in motion is found, the arm is brought to rest first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate, certify
from hplan.certificate.start_state import start_state
from hplan.collision.coal_scene import OwnContact
from hplan.errors import HplanError, MovingObstacleError, ObstacleInTimeError, TimingError
from hplan.planning.motion import Plan, Solver, best_of
from hplan.planning.problem import Problem
from hplan.planning.schedule import STEP_S, MovingField, PathInTime, earliest_schedule, room_to_change
from hplan.planning.start_in_motion import StopMaker, after_stop, stops
from hplan.robot.upright import with_fixed_axis
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene, Start
from hplan.scene.obstacle_kind import transform_fields
from hplan.scene.obstacles import AnyObstacle, Sphere
from hplan.scene.tracks import Movement, Track
from hplan.trajectory.trajectory import Phase, Trajectory, join_trajectories, scale_motion


def past_moving_obstacles(solve: Solver, stop: StopMaker | None = None) -> Solver:
    """A solver that also solves problems with moving obstacles.

    Args:
        solve: Solver of problems among static obstacles.
        stop: Returns a motion to rest from a start in motion, tried before the default ones; None for none.
    """

    def solver(problem: Problem) -> Iterator[Plan]:
        return _plans_in_time(problem, solver, stop) if problem.scene.moves else solve(problem)

    return solver


def _plans_in_time(problem: Problem, solve: Solver, stop: StopMaker | None) -> Iterator[Plan]:
    """Certified plans among moving obstacles, each faster than the one before.

    Raises:
        MovingObstacleError: The options request a bound.
        ObstacleInTimeError: No motion was certified; names a blocking obstacle and the time.
        HplanError: As raised by `solve` for the scene without moving obstacles.
    """
    robot, scene, options = problem.robot, problem.scene, problem.options
    if options.bound:
        raise MovingObstacleError(scene.first_moving, "duration bounds take scenes without moving bodies")
    try:
        yield from _TimedSearch(problem, solve).plans()
    except ObstacleInTimeError:
        state = start_state(robot, scene)
        if state is None:
            raise
        yield after_stop(
            stops(robot, state, 1.0 / options.rate_hz, stop),
            lambda motion: certified_in_time(problem, motion, check_ends=False),
            lambda stopped, _: stopping_first(problem, solve, stopped),
        )


def stopping_first(problem: Problem, solve: Solver, stop: Trajectory) -> Plan | None:
    """A stop and a plan from its end; None if not certified.

    The plan starts with the moving obstacles as they are at the end of the stop.
    """
    stop_s = stop.duration
    rest = Start(joints_rad=tuple(stop.position[-1].tolist()))
    after = with_fixed_axis(problem.robot, problem.scene).starting_at(stop_s).copy_unchecked({"start": rest})
    plan = best_of(solve(Problem.from_scene(problem.robot, after, problem.options)))
    later, trajectory, _ = plan.join_phases
    first, *others = (phase.delay(stop_s) for phase in later)
    phases = (replace(first, start_s=0.0), *others)
    trajectory = join_trajectories([stop, trajectory])
    certificate = certified_in_time(problem, trajectory, direct=len(phases) == 1)
    if not certificate.verified:
        return None
    told = plan.told.get("in_time", {})
    return _run(plan, problem.scene, (phases, trajectory, certificate), {**told, "stops_until_s": stop_s})


def certified_in_time(
    problem: Problem, motion: Trajectory, *, direct: bool = False, check_ends: bool = True
) -> Certificate:
    """The certificate of a motion among moving obstacles.

    Args:
        problem: The problem with the scene; its clock is the motion's.
        direct: True if the fruit may be touched during the whole motion, which then has no approach.
        check_ends: True for a whole motion; False for a stop, which need not reach the goal.
    """
    options = problem.options
    return certify(
        problem.robot, problem.scene, motion,
        tracking_error=options.tracking_error, tracking_delay_s=options.tracking_delay_s, sigmas=options.sigmas,
        goal_contact="motion" if direct else "approach", check_ends=check_ends,
    )  # fmt: skip


class _TimedSearch:
    """A search for plans among moving obstacles, and its state.

    Attributes:
        best_s: Duration of the fastest certified plan; inf before the first [s].
        tried: Descriptions of the failed attempts, for the error.
        first: The first plan without moving obstacles, and its certificate among them.
    """

    def __init__(self, problem: Problem, solve: Solver) -> None:
        robot, scene, options = problem.robot, problem.scene, problem.options
        self._problem, self._robot, self._scene, self._options, self._solve = problem, robot, scene, options, solve
        self._field = MovingField(robot, scene, sigmas=options.sigmas, tracking_error=options.tracking.still_rad)
        self.best_s = math.inf
        self.tried: list[str] = []
        self.first: tuple[Plan, Certificate] | None = None

    def plans(self) -> Iterator[Plan]:
        """Certified plans, each faster than the one before.

        Raises:
            ObstacleInTimeError: No plan was certified.
        """
        for path, among in self._scenes():
            try:
                stills = self._solve(Problem.from_scene(self._robot, among, self._options))
                for still in stills if self._options.deadline_s is not None else [best_of(stills)]:
                    plan = self._plan_along(path, still)
                    if plan is not None and plan.duration < self.best_s - 1e-9:
                        self.best_s = plan.duration
                        yield plan
            except HplanError as error:
                if self.first is None:
                    raise
                self.tried.append(f"{path}: {error.message}")
        if math.isinf(self.best_s) and self.first is not None:
            near, at_s = self.first[1].nearest, self.first[1].nearest_s
            if near is None or isinstance(near, OwnContact):
                raise ObstacleInTimeError(None, None, list(dict.fromkeys(self.tried)))
            raise ObstacleInTimeError(near.obstacle, at_s, list(dict.fromkeys(self.tried)))

    def _scenes(self) -> Iterator[tuple[str, Scene]]:
        """Static scenes whose paths are tried, each with a description."""
        scene = self._scene
        yield "the path without moving obstacles", without_moving(scene)
        # If that motion is hardly slower than without moving obstacles, no alternative is needed.
        if self.first is None or self.best_s <= 1.02 * self.first[0].duration:
            return
        duration = self.first[0].duration
        when = min(self.first[1].nearest_s or 0.0, duration)
        # Maximum time span whose swept volume is avoided as a whole [s].
        end_s = min(duration + 0.5, 30.0)
        yield "a path around the space swept by the obstacle meanwhile", among_poses(scene, 0.0, end_s)
        # Half-width of the time window around the collision in which the obstacle's poses are avoided [s].
        meanwhile_s = 0.35
        yield (
            "a path around the obstacle at the time of the contact",
            among_poses(scene, max(0.0, when - meanwhile_s), when + meanwhile_s),
        )
        yield "a path around the initial position of the obstacle", among_poses(scene, 0.0, min(when, meanwhile_s))
        yield "a path around the final position of the obstacle", among_poses(scene, scene.at_rest_s, scene.at_rest_s)

    def _plan_along(self, path: str, still: Plan) -> Plan | None:
        """The fastest certified motion along a path, or None."""
        phases, motion, _ = still.join_phases
        certificate = self._certify(still, motion)
        if self.first is None:
            self.first = still, certificate
        report = {"path": path, "waits_s": 0.0, "slows_down": False, "at_full_speed_s": motion.duration}
        if certificate.verified:
            return _run(still, self._scene, (phases, motion, certificate), report)
        if motion.duration == 0.0:  # The goal is the start: there is nothing to time.
            self.tried.append(f"{path}: {certificate.violations[0]}")
            return None
        grasp_s = [phase.end_s for phase in phases if phase.name != "retreat"][-1]
        # Allowed deviation from the schedule, earlier or later, tried in turn [s].
        for spare_s in (0.02, 0.06, 0.15):
            cells = PathInTime(motion, self._field, step_s=STEP_S, spare_s=spare_s, grasp_s=grasp_s)
            schedule = earliest_schedule(
                cells,
                motion.duration,
                room_to_change(motion, self._robot, len(cells.configurations)),
                at_rest_s=self._field.at_rest_s,
                at_rest=not self._scene.start.is_moving,
                quicker_than_s=self.best_s,
            )
            try:
                retimed = None if schedule is None else scale_motion(motion, schedule.profile, self._robot)
            except TimingError:
                retimed = None
            if schedule is None or retimed is None:
                self.tried.append(f"{path}: no timing stays {1e3 * spare_s:g} ms away from the moving obstacles")
                return None
            certificate = self._certify(still, retimed.trajectory)
            if certificate.verified:
                report |= {"waits_s": schedule.waiting_s, "slows_down": schedule.slows_down}
                phases = tuple(phase.retime(retimed.clock, retimed.trajectory.time) for phase in phases)
                return _run(still, self._scene, (phases, retimed.trajectory, certificate), report)
            self.tried.append(f"{path}: {certificate.violations[0]}")
        return None

    def _certify(self, still: Plan, motion: Trajectory) -> Certificate:
        return certified_in_time(self._problem, motion, direct=not still.others)


def _run(
    plan: Plan, scene: Scene, run: tuple[tuple[Phase, ...], Trajectory, Certificate], told: Mapping[str, Any]
) -> Plan:
    """A plan with its motion and certificate among moving obstacles."""
    transit = replace(plan.transit, problem=replace(plan.transit.problem, scene=scene))
    return replace(plan, transit=transit, run=run, told={"in_time": {**told, "clear_until_s": run[2].clear_until_s}})


#: Maximum displacement between consecutive poses of one obstacle [m], and the maximum number of poses.
APART_M: Final = 0.03
_MOST_POSES: Final = 24


def without_moving(scene: Scene) -> Scene:
    """The scene without its moving obstacles.

    On a moving base: the other obstacles, at their initial poses, or with a goal fruit at their last ones. The goal
    fruit is where it comes to rest.
    """
    is_fruit = scene.goal.fruit is not None
    at_first = _with_resting_goal(scene.snapshot(scene.at_rest_s if is_fruit else 0.0), scene)
    kept = {item.name for item in (*scene.obstacles, *scene.fruits) if item.track is None} | {scene.goal.fruit}
    return at_first.copy_unchecked(
        {
            "obstacles": tuple(item for item in at_first.obstacles if item.name in kept),
            "fruits": tuple(item for item in at_first.fruits if item.name in kept),
        }
    )


def _with_resting_goal(scene: Scene, moving: Scene) -> Scene:
    """A scene with the goal fruit where it comes to rest in another one."""
    if moving.resting_goal_fruit is None:
        return scene
    goal, _ = moving.resting_goal_fruit
    return scene.copy_unchecked({"fruits": tuple(goal if f.name == goal.name else f for f in scene.fruits)})


def among_poses(scene: Scene, from_s: float, to_s: float) -> Scene:
    """The scene with moving obstacles at all their poses within an interval.

    Consecutive poses are close to each other (`APART_M`). The goal fruit is where it comes to rest.

    Args:
        from_s: Start of the interval [s].
        to_s: End of the interval [s].
    """
    scene = _with_resting_goal(scene, scene)
    moving = set(scene.poses_at([from_s])) - {scene.goal.fruit}
    still_fruits = tuple(fruit for fruit in scene.fruits if fruit.name not in moving)
    fruits = tuple(fruit for fruit in scene.fruits if fruit.name in moving)
    obstacles: list[AnyObstacle] = [item for item in scene.obstacles if item.name not in moving]
    items = [*(item for item in scene.obstacles if item.name in moving), *(_enclosing_ball(fruit) for fruit in fruits)]
    clock = np.linspace(from_s, to_s, _MOST_POSES)
    poses = scene.poses_at(clock)
    for item in items:
        rotations, shifts = poses[item.name]
        points = _core_points(item)
        places = points @ np.swapaxes(rotations, 1, 2) + shifts[:, None]
        steps = np.linalg.norm(np.diff(places, axis=0), axis=2).max(axis=1)
        for number in _choose_poses(steps):
            name = f"{item.name} at {clock[number]:.3f} s"
            update = transform_fields(item, rotations[number], shifts[number])
            pose = item.copy_unchecked(update | {"name": name})
            obstacles.append(_within_drift(pose, item.track, float(clock[number])))
    return scene.copy_unchecked({"obstacles": tuple(obstacles), "fruits": still_fruits, "base_track": None})


def _choose_poses(steps: FloatArray) -> Iterator[int]:
    """Choose poses: the first, the last, and few close ones between them."""
    gone = math.inf
    for number, step in enumerate([0.0, *steps.tolist()]):
        following = float(steps[number]) if number < len(steps) else math.inf
        gone += step
        if gone + following > APART_M and (gone > 0.0 or number == 0):
            gone = 0.0
            yield number


def _enclosing_ball(fruit: Fruit) -> Sphere:
    """A fruit as an obstacle."""
    keys = ("name", "center", "radius", "sigma", "track", "sway", "yields")
    return Sphere(**{key: getattr(fruit, key) for key in keys})


def _within_drift(pose: AnyObstacle, track: Track | None, time_s: float) -> AnyObstacle:
    """A ball that contains all places of a drifting obstacle at a time; the pose itself without a drift."""
    spread = float(Movement.relative_to(track, None).spread_at(np.array([time_s]))[0])
    if spread == 0.0:
        return pose
    points = _core_points(pose)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max()) + max(solid.rounding for solid in pose.solids)
    return Sphere(name=pose.name, center=tuple(centre.tolist()), radius=radius + spread, sigma=pose.sigma)


def _core_points(item: AnyObstacle) -> FloatArray:
    """(k, 3) core points of an obstacle, to measure its travel."""
    return np.concatenate([solid.core for solid in item.solids])
