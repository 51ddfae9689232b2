"""The whole way, from a robot and a scene to a certified trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hplan.arrays import FloatArray, frozen
from hplan.blockage import blockers
from hplan.certificate import Certificate, certify
from hplan.clearance import ClearanceField
from hplan.collision import CollisionScene
from hplan.connect import nearest_node
from hplan.cspace import occupancy
from hplan.errors import CertificationError, NoPathError, OptionError
from hplan.grid import Grid, Occupancy
from hplan.postprocess import OBJECTIVES, Objective, PostprocessOptions, SplinePath, fast_path
from hplan.problem import Problem, pose_problem
from hplan.report import StageClock, versions
from hplan.robot import Robot
from hplan.scene import Scene
from hplan.search import SearchResult, dense_search, reachable, two_level_search
from hplan.section import ArmSections, LinkModel, arm_sections
from hplan.timing import Limits, resting, time_path
from hplan.trajectory import Trajectory

Method = Literal["two-level", "dense"]
METHODS: tuple[Method, ...] = ("two-level", "dense")

#: Clearance asked for wherever a motion is evaluated, beyond the scene's own [m]; less where start or goal have less.
MARGIN = 2e-3

#: Nodes are not motions: where the grid path's motions cannot be shown clear, the search is repeated with obstacles
#: grown by these [m].
GROWTH = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)

#: Called with the name of each stage as it begins.
Progress = Callable[[str], None]


@dataclass(frozen=True)
class PlanOptions:
    """How to plan.

    Attributes:
        method: `two-level`, or `dense` for the baseline.
        step_deg: Largest spacing of the joint grid [deg].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        link_model: Link model of the C-space; motions are always certified for capsules.
        rate_hz: Rows of the trajectory per second.
        speed: Share of the velocity limits to use, in (0, 1].
        tracking_error: Deviation from the trajectory to be covered by the certificate, each joint [rad].
        certify: False exports what was not certified, and says so.
    """

    method: Method = "two-level"
    step_deg: float = 1.0
    objective: Objective = "duration"
    link_model: LinkModel = "capsule"
    rate_hz: float = 250.0
    speed: float = 1.0
    tracking_error: float = 0.0
    certify: bool = True

    def __post_init__(self) -> None:
        """Check the values."""
        if self.method not in METHODS:
            raise OptionError("method", self.method, f"one of {', '.join(METHODS)}")
        if self.objective not in OBJECTIVES:
            raise OptionError("objective", self.objective, f"one of {', '.join(OBJECTIVES)}")
        if not (np.isfinite(self.step_deg) and self.step_deg > 0.0):
            raise OptionError("step_deg", self.step_deg, "a positive number of degrees")


@dataclass(frozen=True, eq=False)
class PlanResult:
    """A plan.

    Attributes:
        problem: Start, goal and the joints that may move.
        occupancy: The C-space that was searched; None for an empty motion.
        search: The search; None for an empty motion.
        grid_path: (m, dof) waypoints of the grid path.
        path: The smooth path; None for an empty motion.
        trajectory: The timed motion.
        certificate: What was shown of it.
        report: The numbers of `report.json`.
    """

    problem: Problem
    occupancy: Occupancy | None
    search: SearchResult | None
    grid_path: FloatArray
    path: SplinePath | None
    trajectory: Trajectory
    certificate: Certificate
    report: dict[str, Any]


def plan(
    robot: Robot, scene: Scene, options: PlanOptions | None = None, *, progress: Progress = lambda _: None
) -> PlanResult:
    """Plan a motion from the scene's start to its goal.

    Args:
        robot: The arm.
        scene: Obstacles and task.
        options: How to plan.
        progress: Called with the name of each stage as it begins.

    Raises:
        InputError: The scene does not fit the robot, or start or goal cannot be taken (see `pose_problem`).
        NoPathError: No path exists on the grid; names what blocks it.
        TimingError: The path cannot be timed.
        CertificationError: No motion could be certified.
    """
    options = PlanOptions() if options is None else options
    clock = StageClock()
    judge = CollisionScene(robot, scene.solids)
    problem = pose_problem(robot, scene, judge)
    if problem.is_empty:
        return _empty(robot, scene, problem, options, judge, clock)
    margin = min(MARGIN, 0.5 * problem.spare_clearance)
    field = ClearanceField.of(robot, scene.solids, clearance=scene.clearance)
    refused: CertificationError | None = None
    for growth in GROWTH:
        try:
            return _attempt(robot, scene, problem, options, judge, field, margin, growth, clock, progress)
        except CertificationError as error:
            refused = refused or error
        except NoPathError:
            if refused is None:
                raise
            break  # grown obstacles close the way; what was found without them could not be certified
    raise refused if refused is not None else CertificationError("no motion could be certified")


def _attempt(
    robot: Robot,
    scene: Scene,
    problem: Problem,
    options: PlanOptions,
    judge: CollisionScene,
    field: ClearanceField,
    margin: float,
    growth: float,
    clock: StageClock,
    progress: Progress,
) -> PlanResult:
    """One pass with obstacles grown by `growth` in the C-space."""
    progress("cspace")
    with clock.stage("cspace"):
        planar = robot.arm_slice
        sections = arm_sections(
            robot,
            scene.solids,
            yaw=robot.yaw_of(problem.start),
            clearance=scene.clearance + growth,
            link_model=options.link_model,
        )
        grid = Grid.over(problem.lower[planar], problem.upper[planar], np.radians(options.step_deg))
        space = occupancy(robot.arm, sections, grid)
        ends = [nearest_node(space, q[planar], q, planar, field, 0.1 * margin) for q in (problem.start, problem.goal)]
    for which, node in zip(("start", "goal"), ends, strict=True):
        if node is None:
            raise CertificationError(
                f"no motion from the {which} to a free node of the grid can be shown clear; a smaller step may help",
                which=which,
            )
    progress("search")
    search = _search(space, ends[0], ends[1], options.method)
    for stage in ("layers", "sparse", "fallback"):
        clock.add(stage, getattr(search.times, stage))
    if search.path is None:
        raise _no_path(robot, sections, space, ends[0])
    progress("postprocess")
    with clock.stage("postprocess"):
        grid_path = _waypoints(problem, grid, search.path, planar)
        path = fast_path(
            grid_path,
            field,
            PostprocessOptions(
                lower=problem.lower,
                upper=problem.upper,
                velocity=robot.velocity_limit,
                acceleration=robot.acceleration_limit,
                movable=problem.movable,
                margin=margin,
                objective=options.objective,
            ),
        )
    progress("timing")
    with clock.stage("timing"):
        trajectory = time_path(path, robot.model, _limits(robot, options), rate_hz=options.rate_hz)
    progress("certificate")
    with clock.stage("certificate"):
        certificate = certify(robot, scene, trajectory, tracking_error=options.tracking_error, judge=judge)
    if options.certify and not certificate.verified:
        raise CertificationError(
            f"the motion is not certified: {'; '.join(certificate.violations)}",
            violations=list(certificate.violations),
        )
    report = _report(robot, scene, options, search, grid_path, path, trajectory, certificate, clock)
    return PlanResult(problem, space, search, grid_path, path, trajectory, certificate, report)


def _search(space: Occupancy, start: Any, goal: Any, method: Method) -> SearchResult:
    if method == "dense" or len(space.grid.shape) < 2:
        return dense_search(space, start, goal)
    return two_level_search(space, start, goal)


def _no_path(robot: Robot, sections: ArmSections, space: Occupancy, start: Any) -> NoPathError:
    """The error that says what bounds everything the start reaches."""
    reached = reachable(space, start)
    walls = blockers(robot.arm, sections, space.grid, reached)
    count = int(reached.sum())
    message = f"no path exists on the grid: the start reaches {count} of {space.grid.size} nodes, not the goal"
    if walls:
        first = walls[0]
        low, high = first["slices_deg"]
        message += (
            f"; most of their border is held by obstacle {first['obstacle']!r} against link {first['link']!r}"
            f" ({robot.arm.joint_names[-1]} from {low:g} to {high:g} deg)"
        )
    return NoPathError(message, reached_cells=count, blockers=walls)


def _waypoints(problem: Problem, grid: Grid, nodes: Any, planar: slice) -> FloatArray:
    """The grid path as configurations, with start and goal where they stand beside the grid."""
    path = np.repeat(problem.start[None], len(nodes), axis=0)
    path[:, planar] = grid.coordinates(nodes)
    for end, q in ((0, problem.start), (-1, problem.goal)):
        if np.abs(path[end] - q).max() < 1e-9:
            path[end] = q
        else:
            path = np.vstack([q, path]) if end == 0 else np.vstack([path, q])
    return frozen(path)


def _limits(robot: Robot, options: PlanOptions) -> Limits:
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return limits.scaled(options.speed)


def _empty(
    robot: Robot, scene: Scene, problem: Problem, options: PlanOptions, judge: CollisionScene, clock: StageClock
) -> PlanResult:
    """The plan from a configuration to itself."""
    trajectory = resting(robot.model, problem.start)
    with clock.stage("certificate"):
        certificate = certify(robot, scene, trajectory, tracking_error=options.tracking_error, judge=judge)
    if options.certify and not certificate.verified:
        raise CertificationError("; ".join(certificate.violations), violations=list(certificate.violations))
    grid_path = frozen(np.array(problem.start[None]))
    report = _report(robot, scene, options, None, grid_path, None, trajectory, certificate, clock)
    return PlanResult(problem, None, None, grid_path, None, trajectory, certificate, report)


def _report(
    robot: Robot,
    scene: Scene,
    options: PlanOptions,
    search: SearchResult | None,
    grid_path: FloatArray,
    path: SplinePath | None,
    trajectory: Trajectory,
    certificate: Certificate,
    clock: StageClock,
) -> dict[str, Any]:
    """The report of a plan, in the shape of `report.json`."""
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
    length_deg = float(np.degrees(np.linalg.norm(np.diff(grid_path, axis=0), axis=1).sum()))
    nearest = certificate.nearest
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": robot.name,
        "planner": {
            "method": options.method,
            "link_model": options.link_model,
            "step_deg": options.step_deg,
            "cost_deg": 0.0 if search is None else float(np.degrees(search.cost)),
            "points": len(grid_path) if search is None or search.path is None else len(search.path),
            "fallback": "none" if search is None else search.fallback,
            "expansions": expansions,
        },
        "time_ms": clock.as_ms(),
        "path": {
            "length_deg_grid": length_deg,
            "length_deg": 0.0 if path is None else float(np.degrees(path.length)),
        },
        "trajectory": {
            "duration_s": trajectory.duration,
            "rate_hz": options.rate_hz,
            "samples": trajectory.samples,
        },
        "certificate": {
            "verified": certificate.verified,
            "min_clearance_m": certificate.min_clearance_m,
            "nearest": None if nearest is None else vars(nearest),
            "tracking_error_rad": options.tracking_error,
            "limit_use": vars(certificate.limit_use),
            "violations": list(certificate.violations),
        },
        "versions": versions(),
    }


def with_export_time(result: PlanResult, seconds: float) -> PlanResult:
    """The result with the time of the export added to its report."""
    times = dict(result.report["time_ms"])
    times["export"] = round(1e3 * seconds, 4)
    times["total"] = round(times["total"] + times["export"], 4)
    return replace(result, report={**result.report, "time_ms": times})
