"""Reports of plans and tours: stage times, certificates, failures, as the numbers of `report.json`."""

from __future__ import annotations

import functools
import json
import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.base.files import write_text
from hplan.base.polyline import path_length
from hplan.certificate.certificate import REST
from hplan.errors import HplanError
from hplan.grid.result import Expansions

if TYPE_CHECKING:
    from hplan.base.deadline import TimeLimit
    from hplan.certificate.certificate import Certificate
    from hplan.planning.lower_bound.duration_bound import DurationBound
    from hplan.planning.motion import Transit
    from hplan.planning.options import PlanOptions
    from hplan.planning.plan import PlanResult
    from hplan.scene.model import Scene
    from hplan.trajectory.trajectory import Trajectory

#: Stages of a plan, in order.
STAGES = (
    "grasps", "trees", "cspace", "layers", "sparse", "fallback", "postprocess", "timing", "certificate", "bound",
    "export",
)  # fmt: skip

#: Packages whose versions a report names.
_PACKAGES = ("hplan", "pin", "coal", "toppra", "numba", "numpy")


class StageClock:
    """Wall-clock time of each stage [s]; a stage entered again adds up."""

    def __init__(self) -> None:
        """Start the clock of the whole."""
        self._begin = time.perf_counter()
        self.seconds = dict.fromkeys(STAGES, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside as part of a stage."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - begin)

    def add(self, name: str, seconds: float) -> None:
        """Add time that was measured elsewhere."""
        self.seconds[name] += seconds

    def told(self) -> list[str]:
        """The stages that there were and how long each took, in words."""
        return [f"{name} for {1e3 * seconds:.3g} ms" for name, seconds in self.seconds.items() if seconds > 0.0]

    def as_ms(self) -> dict[str, float]:
        """Times by stage and in all [ms]."""
        table = {name: round(1e3 * seconds, 4) for name, seconds in self.seconds.items()}
        return {**table, "total": round(1e3 * (time.perf_counter() - self._begin), 4)}


@functools.cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed as a package"


def versions() -> dict[str, str]:
    """Versions of hplan and of what it stands on."""
    return {package: _version(package) for package in _PACKAGES}


def beyond_sigmas(sigmas: float) -> float:
    """Probability that a place is off by more than so many sigmas, sigma being that of each coordinate in space.

    The distance has the chi distribution of three degrees of freedom: beyond three sigmas are 2.9 %, not the 0.3 % of a
    single coordinate.
    """
    return math.erfc(sigmas / math.sqrt(2.0)) + math.sqrt(2.0 / math.pi) * sigmas * math.exp(-0.5 * sigmas * sigmas)


def uncertainty_report(scene: Scene, sigmas: float) -> dict[str, Any]:
    """What a number of sigmas leaves: how many obstacles are uncertain, and how likely they are farther off.

    That any of them is has at most the sum of their probabilities, whatever they have to do with one another.
    """
    count = sum(item.sigma > 0.0 for item in (*scene.obstacles, *scene.fruits))
    if not count:
        return {}
    beyond = beyond_sigmas(sigmas)
    return {"uncertain": {"obstacles": count, "one_beyond": beyond, "any_beyond_at_most": min(1.0, count * beyond)}}


def certificate_report(certificate: Certificate, options: PlanOptions, scene: Scene) -> dict[str, Any]:
    """A certificate, and what it is about, as `report.json` has it.

    Args:
        certificate: The certificate.
        options: How it was asked for: tracking error and standard deviations.
        scene: What it was asked for.
    """
    nearest, digests, until = certificate.nearest, certificate.digests, certificate.clear_until_s
    told = [{"fruit": at.fruit.name, "begin_s": at.begin_s, "end_s": at.end_s} for at in certificate.contacts]
    only_goal = [at["fruit"] for at in told] in ([], [scene.goal.fruit])
    return {
        "verified": certificate.verified,
        "min_clearance_m": certificate.min_clearance_m,
        "nearest": None if nearest is None else vars(nearest),
        "tracking_error_rad": options.tracking_error,
        "tracking_delay_s": options.tracking_delay_s,
        "sigmas": options.sigmas,
        **uncertainty_report(scene, options.sigmas),
        "goal_contact": certificate.goal_contact,
        "contact_s": None if certificate.contact_s is None else list(certificate.contact_s),
        **({} if only_goal else {"contacts": told}),
        "limit_use": vars(certificate.limit_use),
        "violations": list(certificate.violations),
        "digests": None if digests is None else vars(digests),
        **({} if certificate.nearest_s is None else {"nearest_s": certificate.nearest_s}),
        **({} if until is None else {"clear_until_s": until if math.isfinite(until) else None}),
    }


def curve_report(certificate: Certificate) -> dict[str, Any]:
    """The part of a report that has the clearance over time, as pages show it; null where it is not known."""
    curve = certificate.clearance_curve
    if curve is None:
        return {"clearance_curve": None}
    curve = curve.shown
    return {
        "clearance_curve": {
            "time_s": curve.time.tolist(),
            "clearance_m": curve.clearance_m.tolist(),
            "distance_m": curve.distance_m.tolist(),
            "nearest": curve.nearest.tolist(),
            "pairs": [list(pair) for pair in curve.pairs],
        }
    }


def bounded_phases(transit: Transit) -> int:
    """How many phases of a plan a bound is of: up to rest, the transit, or approach too where that does not stop."""
    return 1 if np.abs(transit.trajectory.velocity[-1]).max() <= REST else 2


def plan_report(plan: PlanResult) -> dict[str, Any]:
    """The report of a plan, in the shape of `report.json`."""
    motion, grasp = plan.motion, plan.grasp
    scene, options, route, path = motion.task.scene, motion.task.options, motion.route, motion.path
    search = None if route is None else route.search
    spent = Expansions() if search is None else search.expansions
    phases = [vars(phase) for phase in plan.phases]
    bounded = [phase.name for phase in plan.phases[: bounded_phases(motion)]]
    return {
        "status": "ok",
        "scene": scene.name,
        "robot": motion.task.robot.name,
        "planner": {
            "method": options.method if motion.origin in ("none", "search") else motion.origin,
            "link_model": options.link_model,
            "step_deg": options.step_deg if route is None else route.step_deg,
            "cost_deg": 0.0 if search is None else math.degrees(search.cost),
            "points": len(motion.waypoints) if search is None or search.path is None else len(search.path),
            "fallback": "none" if search is None else search.fallback,
            "expansions": {
                "layers": spent.layers,
                "sparse": spent.sparse,
                "fallback": spent.fallback,
                "total": spent.total,
                "flooded_cells": spent.flooded,
            },
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
        },
        **({"bound": _bound_report(plan.bound, bounded)} if options.bound else {}),
        **plan.told,
        **motion_report(plan.trajectory, plan.certificate, options, scene),
    }


def _bound_report(bound: DurationBound | None, phases: Sequence[str]) -> dict[str, Any] | None:
    """What compares the durations of some phases with the bound of all; None where there is none."""
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


def deadline_report(limit: TimeLimit, count: int, first_s: float, *, cut_short: bool) -> dict[str, dict[str, Any]]:
    """The part of a plan's report that says what there was time for.

    Args:
        limit: The deadline.
        count: How many motions were certified, each quicker than the one before.
        first_s: When there was the first one [s].
        cut_short: Whether the deadline came before all that the options ask for was done.
    """
    return {
        "deadline": {
            "deadline_s": limit.deadline_s,
            "elapsed_s": limit.elapsed_s,
            "cut_short": cut_short,
            "motions": count,
            "first_s": first_s,
        }
    }


def motion_report(
    trajectory: Trajectory, certificate: Certificate, options: PlanOptions, scene: Scene
) -> dict[str, Any]:
    """The last part of the report of a plan or a tour: trajectory, certificate, versions."""
    return {
        "trajectory": {"duration_s": trajectory.duration, "rate_hz": options.rate_hz, "samples": trajectory.samples},
        "certificate": certificate_report(certificate, options, scene),
        "versions": versions(),
    }


def failure_report(error: HplanError, *, scene: str | None, robot: str | None) -> dict[str, Any]:
    """The report of a plan that failed."""
    return {"status": "failed", "scene": scene, "robot": robot, "error": error.as_dict(), "versions": versions()}


def write_report(report: dict[str, Any], path: Path | str) -> Path:
    """Write a report as JSON (`report_text`).

    Raises:
        OutputError: The file cannot be written.
    """
    return write_text(path, report_text(report))


def report_text(report: dict[str, Any]) -> str:
    """A report as JSON; what is not finite becomes null, as JSON knows no infinity."""
    return json.dumps(_plain(report), indent=2, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
