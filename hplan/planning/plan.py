"""The whole way, from a robot and a scene to a certified trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, Record
from hplan.base.polyline import path_length
from hplan.collision.coal_scene import CoalScene
from hplan.cspace.yaw_layers import LayerCache
from hplan.errors import CertificationError, HplanError, NoPathError, TimingError
from hplan.planning.find_motion import PlannedMotion, executable, find_motion, reuse_motion
from hplan.planning.grasp_motion import motion_to_grasp
from hplan.planning.grasps import Grasp, grasps, least_standoff, promising
from hplan.planning.grid_route import PlanningTask, Progress, no_progress
from hplan.planning.report import StageClock, certificate_report, versions
from hplan.problem.definition import Problem, check_problem
from hplan.problem.options import PlanOptions
from hplan.problem.world import World
from hplan.robot.model import Robot
from hplan.robot.tracking import largest_share, name_margin
from hplan.scene.model import Fruit, Scene
from hplan.scene.obstacles import Solid
from hplan.search import SearchResult
from hplan.search.grid import Occupancy
from hplan.smoothing.spline import SplinePath
from hplan.timing.trajectory import Trajectory, joined
from hplan.verification.certificate import Certificate, Stretch, all_of, certify, stretches
from hplan.verification.digests import Digests
from hplan.verification.goal_contact import contact_window
from hplan.verification.limit_use import cubic_pieces


@dataclass(frozen=True)
class Phase:
    """A part of a trajectory.

    Attributes:
        name: `transit`, `approach` or `retreat`.
        start_s: When it begins [s].
        end_s: When it ends [s].
    """

    name: str
    start_s: float
    end_s: float


@dataclass(frozen=True, eq=False)
class PlanResult(Record):
    """A plan.

    Attributes:
        problem: Start and goal of the transit, and the joints that may move.
        occupancy: The C-space that was searched; None where nothing was searched.
        search: The search; None where nothing was searched.
        grid_path: (m, dof) waypoints of the transit's grid path.
        path: The transit's smooth path; None for an empty motion.
        trajectory: The timed motion, all phases.
        certificate: What was shown of it.
        grasp: Where the tool takes the fruit, or reaches the point; None where the goal is given by joints.
        phases: The parts of the trajectory.
        motion: The transit, with all that it was made from.
        report: The numbers of `report.json`.
    """

    problem: Problem
    occupancy: Occupancy | None
    search: SearchResult | None
    grid_path: FloatArray
    path: SplinePath | None
    trajectory: Trajectory
    certificate: Certificate
    grasp: Grasp | None
    phases: tuple[Phase, ...]
    motion: PlannedMotion
    report: dict[str, Any]

    @property
    def picked(self) -> dict[str, float]:
        """The fruit that is picked, if any, and when the tool is at it [s]."""
        fruit = self.motion.task.scene.goal.fruit
        reached = [phase.end_s for phase in self.phases if phase.name != "retreat"]
        return {} if fruit is None else {fruit: reached[-1]}


def plan(
    robot: Robot, scene: Scene, options: PlanOptions | None = None, *, progress: Progress = no_progress
) -> PlanResult:
    """Plan a motion from the scene's start to its goal.

    To a fruit, or to a point, the way is a transit to a stand-off and a straight approach; from a fruit the arm then
    retreats to the stand-off.

    Args:
        robot: The arm.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.

    Raises:
        InputError: The scene does not fit the robot, or start or goal cannot be taken (see `check_problem`).
        UnreachableError: No configuration has the tool at the point.
        BlockedError: Obstacles are in the way of all that do; names them.
        NoPathError: No path exists on the grid; names what blocks it.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
    """
    check_task(robot, scene, options)
    return plan_with(PlanningCache(robot), scene, PlanOptions() if options is None else options, progress=progress)


def check_task(robot: Robot, scene: Scene, options: PlanOptions | None) -> None:
    """Refuse what is no robot, scene or options, such as the first two the wrong way round.

    Raises:
        OptionError: It is none.
    """
    instance("robot", robot, Robot, "load_robot")
    instance("scene", scene, Scene, "load_scene")
    if options is not None:
        instance("options", options, PlanOptions)


class PlanningCache:
    """What one plan leaves behind for the next: the robot's planar layers, and what it kept clear of."""

    def __init__(self, robot: Robot) -> None:
        """Begin with nothing."""
        self.robot = robot
        self.layers = LayerCache()
        self._last: tuple[tuple[tuple[Solid, ...], float, float, float], World] | None = None

    def world(self, scene: Scene, options: PlanOptions) -> World:
        """The robot among the scene's solids, all fruits among them; the same as before where these are the same."""
        # What need not be certified need not make room for the tracking error either; it is judged all the same.
        tracking_error = options.tracking.still_rad
        solids, clearance, sigmas = scene.solids_with_goal, scene.clearance, options.sigmas
        asked = solids, clearance, tracking_error, sigmas
        last = self._last
        if last is None or last[0] != asked:
            world = World.of(self.robot, solids, clearance=clearance, tracking_error=tracking_error, sigmas=sigmas)
            self._last = last = asked, world
        return last[1]

    def task(
        self, world: World, scene: Scene, options: PlanOptions, ends: tuple[ArrayLike, ArrayLike],
        clock: StageClock | None = None, progress: Progress = no_progress,
    ) -> PlanningTask:  # fmt: skip
        """A motion to plan.

        Args:
            world: What the arm must keep clear of on it.
            scene: Where that comes from.
            options: How to plan.
            ends: (dof,) start and goal configuration.
            clock: Where time is noted; a new one where this is None.
            progress: Called with the name of each stage as it begins.

        Raises:
            HplanError: As `check_problem`.
        """
        problem = check_problem(world, *ends, locked_joints=scene.locked_joints)
        return PlanningTask(world, scene, problem, options, clock or StageClock(), self.layers, progress)


def plan_with(
    workspace: PlanningCache,
    scene: Scene,
    options: PlanOptions,
    *,
    progress: Progress = no_progress,
    before: PlannedMotion | None = None,
) -> PlanResult:
    """As `plan`, with what earlier plans of the same robot have left.

    Args:
        workspace: What they have left.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.
        before: An earlier motion, to be kept or mended where that can be (`hplan.planning.find_motion.reuse_motion`).

    Raises:
        HplanError: As `plan`.
    """
    try:
        return _planned(workspace, scene, options, progress, before)
    except (NoPathError, TimingError, CertificationError) as error:
        if not options.tracking.is_exact:
            share = _share_with_room(workspace, scene, options)
            name_margin(error, options.tracking, share, "the motion found without one has room for")
        raise


def _share_with_room(workspace: PlanningCache, scene: Scene, options: PlanOptions) -> float:
    """Share of the tracking error for which a motion planned without one can be certified; 0 where there is none."""
    try:
        found = plan_with(workspace, scene, replace(options, tracking_error=0.0, tracking_delay_s=0.0))
    except HplanError:
        return 0.0

    def is_certified(share: float) -> bool:
        tracking = options.tracking.scaled(share)
        return certify(
            workspace.robot,
            scene,
            found.trajectory,
            tracking_error=tracking.still_rad,
            tracking_delay_s=tracking.delay_s,
            sigmas=options.sigmas,
            goal_contact="approach" if len(found.phases) > 1 else "motion",
        ).verified

    return largest_share(is_certified)


def _planned(
    workspace: PlanningCache, scene: Scene, options: PlanOptions, progress: Progress, before: PlannedMotion | None
) -> PlanResult:
    """The plan."""
    clock, robot, goal = StageClock(), workspace.robot, scene.goal.joints()
    start = robot.check_configuration(scene.start.configuration, "start")
    world = workspace.world(scene, options)
    world.check_base(robot.yaw_of(start))
    if goal is not None:
        motion = _moved(workspace.task(world, scene, options, (start, goal), clock, progress), before)
        return _result(scene, clock, None, motion, [("transit", motion.trajectory, motion.certificate)])
    return _reach(workspace, world, start, scene, options, clock, progress)


def _moved(task: PlanningTask, before: PlannedMotion | None) -> PlannedMotion:
    """The motion of an earlier plan renewed, or another."""
    if before is not None:
        try:
            return reuse_motion(task, before)
        except (CertificationError, TimingError):
            pass  # what it was made for has changed too much
    return find_motion([task])[1]


def _reach(
    workspace: PlanningCache,
    world: World,
    start: FloatArray,
    scene: Scene,
    options: PlanOptions,
    clock: StageClock,
    progress: Progress,
) -> PlanResult:
    """Transit, approach and, from a fruit, retreat."""
    fruit = next((fruit for fruit in scene.fruits if fruit.name == scene.goal.fruit), None)
    near = world if fruit is None else world.touching(fruit.name)
    what = "the point" if fruit is None else f"fruit {fruit.name!r}"
    progress("grasps")
    with clock.stage("grasps"):
        ways = grasps(
            world,
            near,
            np.array(scene.goal.position if fruit is None else fruit.center),
            start,
            what=what,
            standoff=options.standoff,
            least_standoff=0.0 if fruit is None else least_standoff(world, fruit),
            approach_deg=scene.goal.approach_deg,
            locked=scene.locked_joints,
        )
        likely = promising(ways, world, near, start)

    def task_of(grasp: Grasp) -> PlanningTask:
        where = grasp.transit_among(world, near)
        return workspace.task(where, scene, options, (start, grasp.standoff), clock, progress)

    def last_of(grasp: Grasp, motion: PlannedMotion) -> list[tuple[str, Trajectory, Certificate]]:
        return last_stretch(replace(motion.task, world=near), grasp, fruit, world.checker)

    grasp, motion, last = motion_to_grasp(ways, likely, task_of, last_of, what)
    return _result(scene, clock, grasp, motion, [("transit", motion.trajectory, motion.certificate), *last])


def last_stretch(
    task: PlanningTask, grasp: Grasp, fruit: Fruit | None, checker: CoalScene
) -> list[tuple[str, Trajectory, Certificate]]:
    """Approach and, from a fruit, retreat, timed and certified.

    Args:
        task: A motion among everything but the fruit.
        grasp: Where the tool goes.
        fruit: The fruit there, which the last link may touch (`hplan.verification.goal_contact`); None for none.
        checker: The arm among everything.
    """
    path = grasp.path(task.robot, task.scene.locked_joints)
    if path is None:
        return []

    def among(there: Trajectory) -> list[Stretch]:
        bezier, _ = cubic_pieces(there)
        contact = None if fruit is None else contact_window(task.robot, bezier, fruit.center)
        return stretches(checker, len(bezier), contact, None if fruit is None else fruit.name)

    there, shown = executable(task, path, among)
    if fruit is None:
        return [("approach", there, shown)]
    # The same motion backwards: accelerations and torques stay as they are, and so do all the distances.
    return [("approach", there, shown), ("retreat", there.reversed, shown)]


def _result(
    scene: Scene,
    clock: StageClock,
    grasp: Grasp | None,
    motion: PlannedMotion,
    parts: Sequence[tuple[str, Trajectory, Certificate]],
) -> PlanResult:
    """The plan that consists of a motion and, after it, approach and retreat: name, trajectory, certificate each."""
    ends = np.cumsum([part.duration for _, part, _ in parts]).tolist()
    phases = tuple(Phase(name, begin, end) for (name, _, _), begin, end in zip(parts, [0.0, *ends], ends, strict=False))
    trajectory = joined([part for _, part, _ in parts])
    certificate = replace(
        all_of([certificate for _, _, certificate in parts]),
        goal_contact=None if scene.goal.fruit is None else "approach" if len(phases) > 1 else "motion",
        contact_s=_contact_times(scene, phases),
        digests=Digests.of(motion.task.robot, scene, trajectory),
    )
    route = motion.route
    return PlanResult(
        problem=motion.task.problem,
        occupancy=None if route is None else route.occupancy,
        search=None if route is None else route.search,
        grid_path=motion.way,
        path=motion.path,
        trajectory=trajectory,
        certificate=certificate,
        grasp=grasp,
        phases=phases,
        motion=motion,
        report=_report(scene, clock, grasp, motion, phases, trajectory, certificate),
    )


def _contact_times(scene: Scene, phases: Sequence[Phase]) -> tuple[float, float] | None:
    """From when to when the last link may touch the fruit: from the stand-off on; without an approach, all the time."""
    if scene.goal.fruit is None:
        return None
    return phases[1 if len(phases) > 1 else 0].start_s, phases[-1].end_s


def _report(
    scene: Scene,
    clock: StageClock,
    grasp: Grasp | None,
    motion: PlannedMotion,
    phases: Sequence[Phase],
    trajectory: Trajectory,
    certificate: Certificate,
) -> dict[str, Any]:
    """The report of a plan, in the shape of `report.json`."""
    options, route, way, path = motion.task.options, motion.route, motion.way, motion.path
    search = None if route is None else route.search
    expansions = {"layers": 0, "sparse": 0, "fallback": 0, "total": 0, "flooded_cells": 0}
    if search is not None:
        spent = search.expansions
        expansions = {
            "layers": spent.layers,
            "sparse": spent.sparse,
            "fallback": spent.fallback,
            "total": spent.total,
            "flooded_cells": spent.flooded,
        }
    length_deg = float(np.degrees(path_length(way)))
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": motion.task.robot.name,
        "planner": {
            "method": options.method if motion.origin in ("none", "search") else motion.origin,
            "link_model": options.link_model,
            "step_deg": options.step_deg if route is None else route.step_deg,
            "cost_deg": 0.0 if search is None else float(np.degrees(search.cost)),
            "points": len(way) if search is None or search.path is None else len(search.path),
            "fallback": "none" if search is None else search.fallback,
            "expansions": expansions,
        },
        "time_ms": clock.as_ms(),
        "path": {
            "length_deg_grid": length_deg,
            "length_deg": 0.0 if path is None else float(np.degrees(path.length)),
        },
        "phases": [vars(phase) for phase in phases],
        "grasp": None
        if grasp is None
        else {
            "fruit": scene.goal.fruit,
            "approach_deg": float(np.degrees(grasp.approach)),
            "standoff_m": grasp.distance,
            "joints_rad": grasp.goal.tolist(),
        },
        "trajectory": {
            "duration_s": trajectory.duration,
            "rate_hz": options.rate_hz,
            "samples": trajectory.samples,
        },
        "certificate": certificate_report(certificate, options),
        "versions": versions(),
    }


def with_export_time(result: PlanResult, seconds: float) -> PlanResult:
    """The result with the time of the export added to its report."""
    times = dict(result.report["time_ms"])
    times["export"] = round(1e3 * seconds, 4)
    times["total"] = round(times["total"] + times["export"], 4)
    return replace(result, report={**result.report, "time_ms": times})
