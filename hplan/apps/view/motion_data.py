"""A motion as the data of its page: charts as shares of limits, clearance over time, phases, and the certificate.

Charts hold no more points than a screen shows; of each short stretch of time two rows are kept, the first one and that
with the largest share, so no peak is lost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hplan.apps.view.playback import Playback
from hplan.apps.view.scene_stage import REST_S
from hplan.apps.view.three_js import Json
from hplan.base.arrays import FloatArray
from hplan.base.units import at_least_mm
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Phase, Trajectory

if TYPE_CHECKING:
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.clearance_curve import ClearanceCurve

#: Stretches of time of which a chart shows the largest shares.
STRETCHES = 600

#: Times that are nearer than this are one [s].
_SAME_S = 1e-6


def motion_data(robot: Robot, scene: Scene, playback: Playback) -> Json:
    """What the page's script shows of a motion, as JSON values.

    Args:
        scene: Its clearance is the one to keep.
    """
    trajectory = playback.trajectory
    arms = playback.arms or {"": playback.phases}
    rows: list[Json] = [{"name": name, "phases": _phases(phases, playback, name)} for name, phases in arms.items()]
    return {
        "duration": round(trajectory.duration, 6),
        "rest": REST_S,
        "joints": list(robot.joint_names),
        "arms": rows,
        "legs": _legs(rows[0]["phases"]) if len(rows) == 1 and len(playback.picked) > 1 else [],
        "charts": _charts(robot, trajectory),
        "clearance": None if playback.curve is None else _clearance(playback.curve, scene.clearance),
    }


def _phases(phases: Sequence[Phase], playback: Playback, arm: str) -> list[Json]:
    """Phases of one arm, and the fruit that each is about."""
    own = {fruit: time for fruit, time in playback.picked.items() if playback.pickers.get(fruit, "") == arm}
    return [
        {"name": phase.name, "start": round(phase.start_s, 6), "end": round(phase.end_s, 6), "fruit": fruit}
        for phase, fruit in zip(phases, _fruit_of_each(phases, own), strict=True)
    ]


def _fruit_of_each(phases: Sequence[Phase], picked: Mapping[str, float]) -> list[str | None]:
    """The fruit that is picked next in a phase or, in those that come after a pick, was picked last."""
    found: list[str | None] = []
    for phase in phases:
        if phase.name in ("retreat", "drop"):
            before = [fruit for fruit, time in picked.items() if time <= phase.start_s + _SAME_S]
            found.append(max(before, key=picked.__getitem__, default=None))
        else:
            after = [fruit for fruit, time in picked.items() if time >= phase.end_s - _SAME_S]
            found.append(min(after, key=picked.__getitem__, default=None))
    return found


def _legs(phases: Sequence[Json]) -> list[Json]:
    """From when to when a tour is about each of its fruits, in order; None for the leg back."""
    spans: list[Json] = []
    for phase in phases:
        name = phase["fruit"]
        if spans and spans[-1]["name"] == name:
            spans[-1]["end"] = phase["end"]
        else:
            spans.append({"name": name, "start": phase["start"], "end": phase["end"]})
    return spans


def _charts(robot: Robot, trajectory: Trajectory) -> list[Json]:
    """Position, velocity, acceleration and torque over time as shares of their limits, in thousandths."""
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    nothing = np.zeros(robot.dof)
    shown, efforts = [unit.shown for unit in robot.units], [unit.effort for unit in robot.units]
    factors, ones = np.array([unit.factor for unit in robot.units]), np.ones(robot.dof)
    rows = (
        ("Position", shown, factors, trajectory.position, middle, half),
        ("Velocity", [f"{unit}/s" for unit in shown], factors, trajectory.velocity, nothing, robot.velocity_limit),
        ("Acceleration", [f"{unit}/s²" for unit in shown], factors, trajectory.acceleration, nothing,
            robot.acceleration_limit),
        ("Force" if all(robot.slides) else "Torque", efforts, ones, trajectory.torque, nothing, robot.torque_limit),
    )  # fmt: skip
    charts: list[Json] = []
    for title, units, factor, values, zero, limit in rows:
        shares = _shares(values - zero, limit)
        kept = _rows_kept(shares)
        charts.append(
            {
                "title": title,
                "units": units,
                "zero": [round(float(value), 4) for value in factor * zero],
                "limit": [round(float(value), 4) if np.isfinite(value) else None for value in factor * limit],
                "time": np.round(trajectory.time[kept], 4).tolist(),
                "shares": np.round(1e3 * shares[kept]).astype(np.int64).T.tolist(),
            }
        )
    return charts


def _shares(values: FloatArray, limit: FloatArray) -> FloatArray:
    """(n, dof) values by their limits; what has no limit uses none of it, what may not move all and more."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        shares = values / limit
    shares = np.where(np.abs(values) <= 1e-9, 0.0, shares)
    # Shares that are larger, or of no limit at all, are drawn here.
    largest_share = 9.99
    kept: FloatArray = np.clip(np.nan_to_num(shares, nan=0.0), -largest_share, largest_share)
    return kept


def _rows_kept(shares: FloatArray) -> list[int]:
    """Rows of a chart: all of a few, else of each stretch the first and that with the largest share, and the last."""
    samples = len(shares)
    if samples <= 2 * STRETCHES:
        return list(range(samples))
    largest = np.abs(shares).max(axis=1)
    first = np.linspace(0, samples, STRETCHES + 1).astype(int)
    rows = {0, samples - 1}
    for a, b in zip(first[:-1].tolist(), first[1:].tolist(), strict=True):
        rows |= {a, a + int(largest[a:b].argmax())}
    return sorted(rows)


def _clearance(curve: ClearanceCurve, keep: float) -> Json:
    """Clearance over time in millimetres; null where it is not finite."""
    return {
        "keep": round(1e3 * keep, 4),
        "time": np.round(curve.time, 4).tolist(),
        "certain": _millimetres(curve.clearance_m, down=True),
        "distance": _millimetres(curve.distance_m),
        "nearest": curve.nearest.tolist(),
        "pairs": [list(pair) for pair in curve.pairs],
    }


def _millimetres(values: FloatArray, *, down: bool = False) -> list[float | None]:
    """Lengths in millimetres to a hundredth, rounded, or rounded down; None where one is not finite."""
    hundredths = np.floor(1e5 * values) if down else np.round(1e5 * values)
    return [value / 100.0 if math.isfinite(value) else None for value in hundredths.tolist()]


def certificate_words(certificate: Certificate | None) -> tuple[str, str, list[str]]:
    """The certificate as a kind (`ok`, `bad`, `none`), a sentence, and what was not shown."""
    if certificate is None:
        return "none", "It does not come with this motion.", []
    nearest, clearance = certificate.nearest, 1e3 * certificate.min_clearance_m
    pair = "" if nearest is None else f"{nearest.link} – {nearest.obstacle}, {1e3 * nearest.distance_m:.2f} mm"  # noqa: RUF001
    if certificate.nearest_s is not None:
        pair += f" at {certificate.nearest_s:.2f} s"
    if not np.isfinite(clearance):
        words = "nothing to meet"
    elif certificate.verified:
        words = f"clearance {at_least_mm(certificate.min_clearance_m)} mm or more at all times"
    else:
        errors = nearest is not None and clearance < 1e3 * nearest.distance_m - 0.01
        words = f"smallest clearance found {clearance:.2f} mm{', tracking errors taken off' if errors else ''}"
    if certificate.pushes:
        deepest = max(certificate.pushes, key=lambda push: push.depth_m)
        names = len({push.obstacle for push in certificate.pushes})
        words += (
            f"; {names} pushed, {deepest.obstacle} by {deepest.link} deepest: {1e3 * deepest.depth_m:.2f} mm at most"
        )
    if certificate.uncovered_links:
        words += f"; not covered, as drawn without a fitting collision shape: {', '.join(certificate.uncovered_links)}"
    return (
        "ok" if certificate.verified else "bad",
        f"{words}; nearest: {pair}" if pair else words,
        list(dict.fromkeys(certificate.violations)),
    )
