"""The whole way, from a robot and a scene to a certified trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from hplan.arrays import BoolArray, FloatArray, IntArray, frozen
from hplan.blockage import blockers
from hplan.certificate import Certificate, certify
from hplan.clearance import ClearanceField
from hplan.collision import CollisionScene
from hplan.connect import joined_nodes
from hplan.cspace import occupancy
from hplan.errors import CertificationError, NoPathError, OptionError
from hplan.grid import Grid, Occupancy
from hplan.path import Limits, check_rate, check_speed
from hplan.polyline import path_length
from hplan.postprocess import OBJECTIVES, Objective, PostprocessOptions, SplinePath, fast_path
from hplan.problem import Problem, pose_problem
from hplan.report import StageClock, versions
from hplan.robot import Robot
from hplan.scene import Scene
from hplan.search import SearchResult, dense_search, reachable, two_level_search
from hplan.section import ArmSections, LinkModel, arm_sections, check_link_model
from hplan.timing import resting, time_path
from hplan.trajectory import Trajectory

Method = Literal["two-level", "dense"]
METHODS: tuple[Method, ...] = ("two-level", "dense")

#: Clearance asked for wherever a motion is evaluated, beyond the scene's own [m]; less where start or goal have less.
MARGIN = 2e-3

#: Nodes are not motions: where the grid path's motions cannot be shown clear, the search is repeated with obstacles
#: grown by these [m].
GROWTH = (0.0, 2e-3, 5e-3, 0.01, 0.02, 0.04)

#: Where that does not help either, grids this many times as fine are tried.
FINER = (1.0, 2.0)

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
        check_link_model(self.link_model)
        if not (np.isfinite(self.step_deg) and self.step_deg > 0.0):
            raise OptionError("step_deg", self.step_deg, "a positive number of degrees")
        check_rate(self.rate_hz)
        check_speed(self.speed)
        if not (np.isfinite(self.tracking_error) and self.tracking_error >= 0.0):
            raise OptionError("tracking_error", self.tracking_error, "a finite number of radians >= 0")


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
    # What need not be certified need not make room for the tracking error either; it is judged all the same.
    problem = pose_problem(robot, scene, judge, tracking_error=options.tracking_error if options.certify else 0.0)
    field = ClearanceField.of(robot, scene.solids, clearance=problem.clearance)
    planner = _Planner(robot, scene, problem, options, judge, field, clock, progress)
    if problem.is_empty:
        return planner.empty()
    refused: CertificationError | None = None
    # Start and goal must stay free among the grown obstacles.
    growths = sorted({min(growth, 0.8 * problem.spare_clearance) for growth in GROWTH})
    for finer in FINER:
        for growth in growths:
            try:
                return planner.attempt(options.step_deg / finer, growth)
            except CertificationError as error:
                refused = refused or error
            except NoPathError:
                if refused is None:
                    raise
                break  # grown obstacles close the way; what was found without them could not be certified
    raise refused if refused is not None else CertificationError("no motion could be certified")


@dataclass(frozen=True, eq=False)
class _Planner:
    """What all attempts at one plan share."""

    robot: Robot
    scene: Scene
    problem: Problem
    options: PlanOptions
    judge: CollisionScene
    field: ClearanceField
    clock: StageClock
    progress: Progress

    def attempt(self, step_deg: float, growth: float) -> PlanResult:
        """One pass on a grid of `step_deg`, with obstacles grown by `growth` [m] in the C-space."""
        robot, problem, options = self.robot, self.problem, self.options
        margin = min(MARGIN + growth, 0.5 * problem.spare_clearance)
        self.progress("cspace")
        with self.clock.stage("cspace"):
            sections = arm_sections(
                robot,
                self.scene.solids,
                yaw=robot.yaw_of(problem.start),
                clearance=problem.clearance + growth,
                link_model=options.link_model,
            )
            space = occupancy(robot.arm, sections, self._grid(step_deg))
        self.progress("search")
        search = self._search(space, sections, 0.1 * margin)
        self.progress("postprocess")
        with self.clock.stage("postprocess"):
            grid_path = _waypoints(problem, space.grid, search, robot.arm_slice)
            path = fast_path(
                grid_path,
                self.field,
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
        self.progress("timing")
        with self.clock.stage("timing"):
            limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
            trajectory = time_path(path, robot.model, limits.scaled(options.speed), rate_hz=options.rate_hz)
        return self._certified(space, search, grid_path, path, trajectory, step_deg)

    def empty(self) -> PlanResult:
        """The plan from a configuration to itself."""
        start = self.problem.start
        rest = resting(self.robot.model, start)
        return self._certified(None, None, frozen(np.array(start[None])), None, rest, self.options.step_deg)

    def _grid(self, step_deg: float) -> Grid:
        planar = self.robot.arm_slice
        try:
            return Grid.over(self.problem.lower[planar], self.problem.upper[planar], np.radians(step_deg))
        except OptionError as error:
            raise OptionError("step_deg", self.options.step_deg, error.expected) from error

    def _search(self, space: Occupancy, sections: ArmSections, margin: float) -> SearchResult:
        """Search between the grid nodes that start and goal are joined to.

        Beside the grid there may be several, and the nearest may lie in a pocket: "no path" is said only when no pair
        of them is connected.
        """
        start, goal = (
            _Ends(joined_nodes(space, q[self.robot.arm_slice], q, self.robot.arm_slice, self.field, margin), which)
            for q, which in ((self.problem.start, "start"), (self.problem.goal, "goal"))
        )
        search = self._search_between(space, start.first, goal.first)
        if search.path is not None:
            return search
        most: tuple[int, BoolArray | None] = (0, None)
        for node in start.all():
            reached = reachable(space, node)
            for other in goal.all():
                if reached[tuple(other)]:
                    return self._search_between(space, node, other)
            if int(reached.sum()) > most[0]:
                most = (int(reached.sum()), reached)
        raise _no_path(self.robot, sections, space, most[1])

    def _search_between(self, space: Occupancy, start: IntArray, goal: IntArray) -> SearchResult:
        if self.options.method == "dense" or len(space.grid.shape) < 2:
            search = dense_search(space, start, goal)
        else:
            search = two_level_search(space, start, goal)
        for stage in ("layers", "sparse", "fallback"):
            self.clock.add(stage, getattr(search.times, stage))
        return search

    def _certified(
        self,
        space: Occupancy | None,
        search: SearchResult | None,
        grid_path: FloatArray,
        path: SplinePath | None,
        trajectory: Trajectory,
        step_deg: float,
    ) -> PlanResult:
        """The result, once its trajectory is certified."""
        self.progress("certificate")
        with self.clock.stage("certificate"):
            certificate = certify(
                self.robot, self.scene, trajectory, tracking_error=self.options.tracking_error, judge=self.judge
            )
        if self.options.certify and not certificate.verified:
            raise CertificationError(
                f"the motion is not certified: {'; '.join(certificate.violations)}",
                violations=list(certificate.violations),
            )
        report = _report(
            self.robot, self.scene, self.options, step_deg, search, grid_path, path, trajectory, certificate, self.clock
        )
        return PlanResult(self.problem, space, search, grid_path, path, trajectory, certificate, report)


class _Ends:
    """The nodes that one end is joined to; the first is found at once, the others when asked for."""

    def __init__(self, nodes: Iterator[IntArray], which: str) -> None:
        self._rest = nodes
        first = next(nodes, None)
        if first is None:
            raise CertificationError(
                f"no motion from the {which} to a free node of the grid can be shown clear; a smaller step may help",
                which=which,
            )
        self.first = first
        self._known = [first]

    def all(self) -> list[IntArray]:
        """All of them, the nearest first."""
        self._known.extend(self._rest)
        return self._known


def _no_path(robot: Robot, sections: ArmSections, space: Occupancy, reached: BoolArray | None) -> NoPathError:
    """The error that says what bounds everything the start reaches."""
    if reached is None:
        reached = np.zeros(space.grid.shape, dtype=np.bool_)
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


def _waypoints(problem: Problem, grid: Grid, search: SearchResult, planar: slice) -> FloatArray:
    """The grid path as configurations, with start and goal where they stand beside the grid."""
    nodes = np.empty((0, len(grid.shape))) if search.path is None else search.path
    path = np.repeat(problem.start[None], len(nodes), axis=0)
    path[:, planar] = grid.coordinates(nodes)
    for end, q in ((0, problem.start), (-1, problem.goal)):
        if np.abs(path[end] - q).max() < 1e-9:
            path[end] = q
        else:
            path = np.vstack([q, path]) if end == 0 else np.vstack([path, q])
    return frozen(path)


def _report(
    robot: Robot,
    scene: Scene,
    options: PlanOptions,
    step_deg: float,
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
    length_deg = float(np.degrees(path_length(grid_path)))
    nearest = certificate.nearest
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": robot.name,
        "planner": {
            "method": options.method,
            "link_model": options.link_model,
            "step_deg": step_deg,
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
