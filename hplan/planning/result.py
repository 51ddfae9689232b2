"""Results of plans: the motion, its certificate and its report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.base.arrays import FloatArray, Record
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate
from hplan.certificate.goal_contact import REST
from hplan.certificate.retimed_certificate import CertifiedMotion, certified_retiming
from hplan.geometry.polyline import path_length
from hplan.planning.grasps import Grasp
from hplan.planning.motion import Motion
from hplan.planning.problem import Problem
from hplan.planning.report import assumptions_report, far_report, motion_report
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.time_scaling import Profile
from hplan.trajectory.trajectory import Phase, Retimed, Trajectory, scale_motion, stop_motion

if TYPE_CHECKING:
    from hplan.planning.lower_bound.duration_bound import DurationBound


@dataclass(frozen=True, eq=False)
class PlanResult(Record, InNotebook):
    """Result of a plan.

    Attributes:
        motion: The transit, with the problem and the path that it was made from.
        trajectory: The timed motion, all phases.
        certificate: The certificate of the trajectory.
        phases: The phases of the trajectory.
        grasp: Configuration and approach at the fruit, point or pose; None for a goal given as joints.
        time_ms: Time of each stage and the total [ms].
        bound: Lower bound of the duration of all transits between the same configurations, or of all motions to the
            grasp if transit and approach are blended; None if not requested or not certified.
        begins_s: Start time of the trajectory on the controller's clock (`hplan.Planner`); NaN if unknown [s]. All
            other times count from there: samples, phases, and the tracks of `scene`.
        told: Additional report sections: deadline, moving obstacles, or a given path.

    Examples:
        >>> from hplan import PlanOptions, load_robot, load_scene, plan
        >>> result = plan(load_robot(), load_scene(), PlanOptions(effort="quick"))
        >>> [phase.name for phase in result.phases]
        ['transit']
        >>> result.stop_at(0.5).trajectory.duration < result.trajectory.duration
        True
    """

    motion: Motion
    trajectory: Trajectory
    certificate: Certificate
    phases: tuple[Phase, ...]
    grasp: Grasp | None
    time_ms: Mapping[str, float]
    bound: DurationBound | None = None
    begins_s: float = 0.0
    told: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @cached_property
    def report(self) -> dict[str, Any]:
        """The contents of `report.json`."""
        return plan_report(self)

    @property
    def problem(self) -> Problem:
        """Start, goal and movable joints of the transit."""
        return self.motion.problem

    @property
    def occupancy(self) -> Any:
        """The C-space of the grid search; None without a search."""
        return None if self.motion.search is None else self.motion.search.occupancy

    @property
    def search(self) -> Any:
        """The grid search; None without a search."""
        return None if self.motion.search is None else self.motion.search.search

    @property
    def grid_path(self) -> FloatArray:
        """(m, dof) waypoints of the transit's path before smoothing."""
        return self.motion.waypoints

    @property
    def path(self) -> SplinePath | None:
        """The transit's smooth path; None for an empty motion."""
        return self.motion.path

    @property
    def robot(self) -> Robot:
        """The arm."""
        return self.motion.problem.robot

    @property
    def scene(self) -> Scene:
        """Obstacles and task, as given."""
        return self.motion.problem.scene

    @property
    def picked_fruit(self) -> dict[str, float]:
        """The picked fruit, if any, and the time of the grasp [s]."""
        fruit = self.scene.goal.fruit
        reached = [phase.end_s for phase in self.phases if phase.name != "retreat"]
        return {} if fruit is None else {fruit: reached[-1]}

    def row(self) -> dict[str, Any]:
        """The main results, without nested values, for tables of many plans.

        Keys: robot, verified, duration_s, min_clearance_m, nearest_link, nearest_obstacle, nearest_distance_m (of the
        nearest pair; None without obstacles), fruit and planning_ms.
        """
        report = self.report
        nearest = report["certificate"]["nearest"] or {"link": "", "obstacle": "", "distance_m": None}
        return {
            "robot": self.robot.name,
            "verified": self.certificate.verified,
            "duration_s": self.trajectory.duration,
            "min_clearance_m": self.certificate.min_clearance_m,
            **{f"nearest_{key}": nearest[key] for key in ("link", "obstacle", "distance_m")},
            "fruit": self.scene.goal.fruit or "",
            "planning_ms": self.time_ms["total"],
        }

    def stop_at(self, t: float) -> CertifiedMotion:
        """The trajectory with a stop: the quickest one on its path.

        It is unchanged up to the first sample at or after `t`.

        Args:
            t: Time since the start of the trajectory [s].

        Raises:
            OptionError: `t` is before or after the trajectory.
        """
        return self._retime(stop_motion(self.trajectory, t, self.robot))

    def scale_speed(self, profile: Profile) -> CertifiedMotion:
        """The trajectory on the same path with another speed.

        Args:
            profile: Fraction of its own speed over time (`hplan.trajectory.trajectory.scale_motion`).

        Raises:
            OptionError: The factors are invalid, exceed the limits, or do not lead to the end of the motion.
            TimingError: No motion within the limits was found.
        """
        return self._retime(scale_motion(self.trajectory, profile, self.robot))

    def _retime(self, retimed: Retimed) -> CertifiedMotion:
        problem = self.motion.problem
        tracking, sigmas = problem.options.certified_tracking, problem.options.sigmas
        found = certified_retiming(
            problem.robot, problem.scene, self.certificate, retimed, tracking=tracking, sigmas=sigmas
        )
        return replace(found, begins_s=self.begins_s)


def bounded_phases(transit: Motion) -> int:
    """Number of phases that a bound covers.

    It covers the phases up to the first rest: the transit, or transit and approach if they are blended.
    """
    return 1 if np.abs(transit.trajectory.velocity[-1]).max() <= REST else 2


def plan_report(plan: PlanResult) -> dict[str, Any]:
    """The report of a plan, as in `report.json`."""
    motion, grasp = plan.motion, plan.grasp
    scene, options, path = motion.problem.scene, motion.problem.options, motion.path
    expansions = dict.fromkeys(("layers", "sparse", "fallback", "total", "flooded_cells"), 0)
    phases = [vars(phase) for phase in plan.phases]
    bounded = [phase.name for phase in plan.phases[: bounded_phases(motion)]]
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": motion.problem.robot.name,
        "planner": {
            "method": options.method if motion.origin in ("none", "search") else motion.origin,
            "link_model": options.link_model,
            "step_deg": options.step_deg,
            "cost_deg": 0.0,
            "points": len(motion.waypoints),
            "fallback": "none",
            "expansions": expansions,
            **({} if motion.search is None else motion.search.report()),
        },
        "time_ms": dict(plan.time_ms),
        "path": {
            "length_deg_grid": math.degrees(path_length(motion.waypoints)),
            "length_deg": 0.0 if path is None else math.degrees(path.length),
        },
        "phases": phases,
        "grasp": None
        if grasp is None
        else {
            "fruit": scene.goal.fruit,
            "approach_deg": math.degrees(grasp.approach),
            "standoff_m": grasp.distance,
            "joints_rad": grasp.goal.tolist(),
            **({} if grasp.caught is None else {"caught": grasp.caught}),
        },
        **({"bound": _bound_report(plan.bound, bounded)} if options.bound else {}),
        **plan.told,
        **assumptions_report(motion.problem.robot),
        **far_report(motion.problem.robot, scene),
        **motion_report(plan.trajectory, plan.certificate, options, scene),
    }


def _bound_report(bound: DurationBound | None, phases: Sequence[str]) -> dict[str, Any] | None:
    """The bound and the duration that it covers, or None."""
    if bound is None:
        return None
    return {
        "phases": list(phases),
        "bound_s": bound.seconds,
        "duration_s": bound.duration_s,
        "gap": bound.gap,
        "method": bound.method,
        "joint": bound.joint,
        "joints_s": bound.joints_s,
    }
