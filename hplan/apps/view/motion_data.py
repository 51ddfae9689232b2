"""Data of a motion for its page: charts, clearance, phases, certificate.

Charts show values as fractions of their limits, with no more points than a screen can show. Two samples of each short
time interval are kept, the first one and the one with the largest fraction, so no peak is lost.
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

#: Number of time intervals of a chart.
STRETCHES = 600

#: Times closer than this are considered equal [s].
_SAME_S = 1e-6


def motion_data(robot: Robot, scene: Scene, playback: Playback) -> Json:
    """Data of a motion for the page's script, as JSON values.

    Args:
        robot: The arm, with the limits of the charts.
        scene: The scene, with the required clearance.
        playback: The motion.
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
    """Phases of one arm, each with its fruit."""
    own = {fruit: time for fruit, time in playback.picked.items() if playback.pickers.get(fruit, "") == arm}
    return [
        {"name": phase.name, "start": round(phase.start_s, 6), "end": round(phase.end_s, 6), "fruit": fruit}
        for phase, fruit in zip(phases, _fruit_of_each(phases, own), strict=True)
    ]


def _fruit_of_each(phases: Sequence[Phase], picked: Mapping[str, float]) -> list[str | None]:
    """Fruit of each phase, or None.

    It is the fruit picked last in phases after a pick (retreat, drop), else the fruit picked next.
    """
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
    """Legs of a tour in order, with their fruits and times [s].

    The return to the start has None for its fruit.
    """
    spans: list[Json] = []
    for phase in phases:
        name = phase["fruit"]
        if spans and spans[-1]["name"] == name:
            spans[-1]["end"] = phase["end"]
        else:
            spans.append({"name": name, "start": phase["start"], "end": phase["end"]})
    return spans


def _charts(robot: Robot, trajectory: Trajectory) -> list[Json]:
    """Charts of position, velocity, acceleration and torque.

    Values are in thousandths of their limits; positions are relative to the middle of their range.
    """
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
    """(n, dof) values divided by their limits, clipped to +-9.99.

    Values without a limit give 0, as do values below 1e-9; other values with a limit of 0 give the maximum.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        shares = values / limit
    shares = np.where(np.abs(values) <= 1e-9, 0.0, shares)
    # Larger fractions, and fractions of a limit of 0, are drawn at this value.
    largest_share = 9.99
    kept: FloatArray = np.clip(np.nan_to_num(shares, nan=0.0), -largest_share, largest_share)
    return kept


def _rows_kept(shares: FloatArray) -> list[int]:
    """Indices of the samples that a chart shows.

    All samples if they are few, else the first and the largest of each interval, and the last sample.
    """
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
    """Clearance over time [mm]; null if not finite."""
    return {
        "keep": round(1e3 * keep, 4),
        "time": np.round(curve.time, 4).tolist(),
        "certain": _millimetres(curve.clearance_m, down=True),
        "distance": _millimetres(curve.distance_m),
        "nearest": curve.nearest.tolist(),
        "pairs": [list(pair) for pair in curve.pairs],
    }


def _millimetres(values: FloatArray, *, down: bool = False) -> list[float | None]:
    """Convert metres to millimetres with two decimals; None if not finite.

    Values are rounded to nearest, or down for lower bounds (`down`).
    """
    hundredths = np.floor(1e5 * values) if down else np.round(1e5 * values)
    return [value / 100.0 if math.isfinite(value) else None for value in hundredths.tolist()]


def certificate_words(certificate: Certificate | None) -> tuple[str, str, list[str]]:
    """Kind of the certificate (`ok`, `bad`, `none`), a sentence, and its violations."""
    if certificate is None:
        return "none", "This motion has no certificate.", []
    nearest, clearance = certificate.nearest, 1e3 * certificate.min_clearance_m
    pair = "" if nearest is None else f"{nearest.link} – {nearest.obstacle}, {1e3 * nearest.distance_m:.2f} mm"  # noqa: RUF001
    if certificate.nearest_s is not None:
        pair += f" at {certificate.nearest_s:.2f} s"
    if not np.isfinite(clearance):
        words = "no obstacles"
    elif certificate.verified:
        words = f"clearance {at_least_mm(certificate.min_clearance_m)} mm or more at all times"
    else:
        errors = nearest is not None and clearance < 1e3 * nearest.distance_m - 0.01
        words = f"minimum clearance found {clearance:.2f} mm{' after subtraction of tracking errors' if errors else ''}"
    if certificate.pushes:
        deepest = max(certificate.pushes, key=lambda push: push.depth_m)
        names = len({push.obstacle for push in certificate.pushes})
        words += (
            f"; {names} pushed, {deepest.obstacle} by {deepest.link} deepest: {1e3 * deepest.depth_m:.2f} mm at most"
        )
    if certificate.uncovered_links:
        words += (
            f"; not covered, because drawn without a matching collision shape: {', '.join(certificate.uncovered_links)}"
        )
    return (
        "ok" if certificate.verified else "bad",
        f"{words}; nearest: {pair}" if pair else words,
        list(dict.fromkeys(certificate.violations)),
    )
