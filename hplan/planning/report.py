"""Reports of plans and tours: the contents of `report.json`.

They cover certificates, deadlines and failures.
"""

from __future__ import annotations

import functools
import json
import math
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.base.files import REPORT_FORMAT, write_text
from hplan.certificate.touch_risk import beyond_sigmas
from hplan.collision.far_obstacles import far_obstacles
from hplan.errors import HplanError

if TYPE_CHECKING:
    from hplan.base.deadline import TimeLimit
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.segment_contacts import Push
    from hplan.certificate.touch_risk import TouchRisk
    from hplan.planning.options import PlanOptions
    from hplan.robot.model import Robot
    from hplan.scene.model import Scene
    from hplan.scene.obstacle_kind import Sigmas
    from hplan.trajectory.trajectory import Trajectory


@functools.cache
def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed as a package"


def versions() -> dict[str, str]:
    """Versions of hplan and its main dependencies."""
    # The packages whose versions a report names.
    return {package: _version(package) for package in ("hplan", "pin", "coal", "toppra", "numba", "numpy")}


def uncertainty_report(scene: Scene, sigmas: Sigmas) -> dict[str, Any]:
    """Number of uncertain obstacles, and the probability that they exceed `sigmas`.

    The probability that any of them does is at most the sum of their probabilities, for any correlation.
    """
    items = [
        item.name for item in (*scene.obstacles, *scene.fruits) if item.sigma > 0.0 or scene.covariance is not None
    ]
    if not items:
        return {}
    named = sigmas if isinstance(sigmas, Mapping) else dict.fromkeys(items, sigmas)
    beyond = [float(beyond_sigmas(named.get(name, 0.0))) for name in items]
    told = {"obstacles": len(items), "one_beyond": max(beyond), "any_beyond_at_most": min(1.0, math.fsum(beyond))}
    return {"uncertain": told}


def risk_report(risk: TouchRisk) -> dict[str, Any]:
    """The contact probability: its bound, the largest shares, and an estimate."""
    estimate = risk.estimate
    return {
        "asked": risk.asked,
        "bound": risk.bound,
        "shared": risk.shared,
        # The report lists the ten obstacles with the largest shares.
        "shares": [vars(share) for share in risk.shares[:10]],
        "estimate": {"frequency": estimate.frequency, **vars(estimate)},
    }


def certificate_report(certificate: Certificate, options: PlanOptions, scene: Scene) -> dict[str, Any]:
    """A certificate and its subject, for `report.json`.

    Args:
        options: The options with the tracking error and the standard deviations that it covers.
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
        **(
            {"sigmas": options.sigmas, **uncertainty_report(scene, options.sigmas)}
            if certificate.risk is None
            else {"sigmas": 0.0, "risk": risk_report(certificate.risk)}
        ),
        "goal_contact": certificate.goal_contact,
        "contact_s": None if certificate.contact_s is None else list(certificate.contact_s),
        **({} if only_goal else {"contacts": told}),
        **pushes_report(certificate, scene),
        **({"pair_rules": [vars(rule) for rule in certificate.pair_rules]} if certificate.pair_rules else {}),
        "limit_use": vars(certificate.limit_use),
        "violations": list(certificate.violations),
        **tilt_report(certificate, scene),
        **({"uncovered_links": list(certificate.uncovered_links)} if certificate.uncovered_links else {}),
        **attached_report(scene),
        "digests": None if digests is None else digests.as_dict(),
        **({} if certificate.nearest_s is None else {"nearest_s": certificate.nearest_s}),
        **({} if until is None else {"clear_until_s": until if math.isfinite(until) else None}),
    }


def tilt_report(certificate: Certificate, scene: Scene) -> dict[str, Any]:
    """The bound of the tool's tilt, and what is allowed; empty if the tool may tilt."""
    if scene.upright is None:
        return {}
    tilt = certificate.max_tilt_rad
    bound = None if tilt is None else math.degrees(tilt)
    return {"upright": {**scene.upright.model_dump(mode="json"), "bound_deg": bound}}


def pushes_report(certificate: Certificate, scene: Scene) -> dict[str, Any]:
    """The deflections of compliant obstacles; null if they are unknown.

    Empty if no obstacle of the scene is compliant.
    """
    if not scene.gives_way:
        return {}
    found = certificate.pushes
    told: dict[str, Any] = {} if scene.yield_links is None else {"yield_links": list(scene.yield_links)}
    if scene.wood is not None:
        told |= {
            "wood": scene.wood.model_dump(mode="json"),
            "goal_displacement_m": certificate.goal_displacement_m,
        }
    return told | {"pushes": None if found is None else [push_report(push) for push in found]}


def push_report(push: Push) -> dict[str, Any]:
    """A contact as in the report; force and stress only for limbs and fruit on them."""
    return {key: value for key, value in vars(push).items() if value is not None}


def assumptions_report(robot: Robot) -> dict[str, list[str]]:
    """The limits that no file gives and that were assumed; empty if all are given."""
    return {"assumptions": list(robot.assumptions)} if robot.assumptions else {}


def far_report(robot: Robot, scene: Scene) -> dict[str, list[str]]:
    """The obstacles implausibly far from the arm; empty without any."""
    names = far_obstacles(robot, scene)
    return {"far_obstacles": list(names)} if names else {}


def attached_report(scene: Scene) -> dict[str, Any]:
    """The held objects and their total mass; empty without any. The frame of an object is null at the tool frame."""
    if not scene.attached:
        return {}
    held = [
        {"name": item.name, "kind": item.object.kind, "frame": item.frame, "mass_kg": item.mass}
        for item in scene.attached
    ]
    return {"attached": held, "payload_kg": math.fsum(item.mass for item in scene.attached)}


def curve_report(certificate: Certificate) -> dict[str, Any]:
    """The clearance over time, for pages; null if it is unknown."""
    curve = certificate.clearance_curve
    if curve is None:
        return {"clearance_curve": None}
    curve = curve.report_curve
    return {
        "clearance_curve": {
            "time_s": curve.time.tolist(),
            "clearance_m": curve.clearance_m.tolist(),
            "distance_m": curve.distance_m.tolist(),
            "nearest": curve.nearest.tolist(),
            "pairs": [list(pair) for pair in curve.pairs],
        }
    }


def deadline_report(limit: TimeLimit, count: int, first_s: float, *, cut_short: bool) -> dict[str, dict[str, Any]]:
    """The section of a plan's report about its deadline.

    Args:
        limit: The deadline and the elapsed time.
        count: Number of certified motions, each faster than the one before.
        first_s: Elapsed time at the first motion [s].
        cut_short: True if the deadline ended the search.
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
    """The last section of a report: trajectory, certificate, versions."""
    return {
        "trajectory": {"duration_s": trajectory.duration, "rate_hz": options.rate_hz, "samples": trajectory.samples},
        "certificate": certificate_report(certificate, options, scene),
        "versions": versions(),
    }


def failure_report(error: HplanError, *, scene: str | None, robot: str | None) -> dict[str, Any]:
    """The report of a plan that failed."""
    return {"status": "failed", "scene": scene, "robot": robot, "error": error.as_dict(), "versions": versions()}


def write_report(report: dict[str, Any], path: Path | str) -> Path:
    """Write a report as JSON (`report_text`), with the identifier of its format.

    Raises:
        OutputError: The file cannot be written.
    """
    return write_text(path, report_text({"format": REPORT_FORMAT, **report}))


def report_text(report: dict[str, Any]) -> str:
    """A report as JSON; numbers that are not finite become null."""
    return json.dumps(_to_plain(report), indent=2, allow_nan=False) + "\n"


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _to_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
