"""The animated page: arm, scene and motion in HTML, written or served.

The HTML holds meshcat's viewer and its commands, so the file needs neither network nor server. Rendering it starts no
process.
"""

from __future__ import annotations

import html
import importlib.util
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from hplan.apps.view import scenery
from hplan.apps.view.framing import ASPECT
from hplan.apps.view.playback import Playback, playable
from hplan.apps.view.scene_stage import APPROACH_COLOR, GOAL_COLOR, REST_S, START_COLOR, build_stage
from hplan.apps.view.server import LiveView
from hplan.apps.view.three_js import Json
from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray
from hplan.base.data_files import view_asset
from hplan.base.files import HTML_COMMENT, write_marked
from hplan.base.units import at_least_mm, at_most_deg
from hplan.collision.held_objects import HELD_COLOR
from hplan.errors import HplanError
from hplan.planning.failures import REASON_WORDS
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Phase, Trajectory, check_trajectory_joints

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.clearance_curve import ClearanceCurve

#: Number of time intervals of a chart.
STRETCHES = 600

#: Times closer than this are considered equal [s].
_EQUAL_TIMES_S = 1e-6


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
            before = [fruit for fruit, time in picked.items() if time <= phase.start_s + _EQUAL_TIMES_S]
            found.append(max(before, key=picked.__getitem__, default=None))
        else:
            after = [fruit for fruit, time in picked.items() if time >= phase.end_s - _EQUAL_TIMES_S]
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
    nearest, clearance, pushes = certificate.nearest, 1e3 * certificate.min_clearance_m, certificate.pushes or ()
    pushed = {push.obstacle for push in pushes}
    if not np.isfinite(clearance):
        words = "There is nothing to meet"
    elif certificate.verified:
        others = " from all that is not pushed" if pushed else ""
        words = f"The arm keeps at least {at_least_mm(certificate.min_clearance_m)} mm{others} at all times"
    else:
        errors = nearest is not None and clearance < 1e3 * nearest.distance_m - 0.01
        words = f"The clearance found is {clearance:.2f} mm{' after subtraction of tracking errors' if errors else ''}"
    if nearest is not None and nearest.obstacle not in pushed:
        when = "" if certificate.nearest_s is None else f" at {certificate.nearest_s:.2f} s"
        gap = "apart" if nearest.distance_m >= 0.0 else "deep"
        words += f"; nearest{when}: {nearest.link} and {nearest.obstacle}, {1e3 * abs(nearest.distance_m):.2f} mm {gap}"
    sentences = [words]
    if pushes:
        deepest = max(pushes, key=lambda push: push.depth_m)
        count = "1 obstacle" if len(pushed) == 1 else f"{len(pushed)} obstacles"
        depth = f"{1e3 * deepest.depth_m:.2f} mm"
        sentences.append(f"It pushes {count}, at most {depth} deep ({deepest.obstacle} by {deepest.link})")
        loads = [push for push in pushes if push.force_n is not None and push.stress_mpa is not None]
        if loads:
            force, stress = (max(getattr(push, key) for push in loads) for key in ("force_n", "stress_mpa"))
            sentences.append(f"Limbs and fruit are pushed with at most {force:.1f} N and bent by {stress:.1f} MPa")
    if certificate.max_tilt_rad is not None:
        sentences.append(f"The tool tilts by at most {at_most_deg(certificate.max_tilt_rad)} deg at any time")
    if certificate.uncovered_links:
        names = ", ".join(certificate.uncovered_links)
        sentences.append(f"Not covered, because drawn without a matching collision shape: {names}")
    return (
        "ok" if certificate.verified else "bad",
        "".join(f"{sentence}. " for sentence in sentences).rstrip(),
        list(dict.fromkeys(certificate.violations)),
    )


#: Maximum number of certificate violations listed on a page.
MOST_VIOLATIONS = 6


def render_page(robot: Robot, scene: Scene, playback: Playback) -> str:
    """Render a motion as a self-contained HTML page.

    The page plays the motion in real time, repeatedly.

    Raises:
        InputError: The joints of the trajectory are not the robot's; `picked` names a fruit that is not in the scene,
            or a time outside the motion.
        OptionError: An argument of another type.
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    instance("robot", robot, Robot, "load_robot")
    instance("scene", scene, Scene, "load_scene")
    trajectory = instance("playback", playback, Playback, "Playback.from_result").trajectory
    check_trajectory_joints(trajectory, robot)
    moves = trajectory.samples > 1
    entries: list[tuple[str, Sequence[int]]] = [("Start", [START_COLOR]), ("Goal", [GOAL_COLOR])] if moves else []
    if moves and any(phase.name == "approach" for phase in playback.every_phase):
        entries.append(("Approach", [APPROACH_COLOR]))
    colors = [look.color for look in scenery.looks(scene)]
    if colors:
        entries.append(("Obstacle" if len(scene.obstacles) == 1 else "Obstacles", colors))
    if scene.attached:
        entries.append(("Held", [HELD_COLOR]))
    if scene.fruits:
        entries.append(("Fruit", [scenery.FRUIT_COLOR]))
    if scene.goal.fruit is not None and len(playback.picked) < 2:
        entries.append(("Fruit to pick", [scenery.HALO_COLOR]))
    if moves and playback.picked:
        entries.append(("Picked", [scenery.PICKED_COLOR]))
    for reason, color in scenery.UNPICKED_COLORS.items():
        if reason in playback.unpicked.values():
            entries.append((REASON_WORDS[reason].capitalize(), [color]))
    subtitle = f"{robot.name}, {trajectory.duration:.2f} s" if moves else f"{robot.name}, at rest"
    panel = _panel(robot, scene, playback) if moves else ""
    return document(scene.name, subtitle, entries, build_stage(robot, scene, playback), panel)


def document(
    title: str, subtitle: str, entries: Iterable[tuple[str, Sequence[int]]], commands: Sequence[Json], panel: str = ""
) -> str:
    """Render a self-contained HTML page of meshcat's viewer.

    Args:
        title: Title of the page.
        subtitle: Line below the title.
        entries: Legend: label and colours of each entry.
        commands: Commands that build the scene in the viewer.
        panel: HTML below the picture; empty for a picture that fills the window.

    Raises:
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    dots = '<i style="background: #{:06x}"></i>'.format
    named = ((html.escape(text), "".join(map(dots, colors))) for text, colors in entries)
    legend = "\n".join(f"<span>{colored}{text}</span>" for text, colored in named)
    return Template(view_asset("page.html")).substitute(
        title=html.escape(title),
        subtitle=html.escape(subtitle),
        style=view_asset("page.css"),
        kind="motion" if panel else "picture",
        legend=legend,
        commands=_json_text(commands),
        viewer=_viewer_source(),
        aspect=ASPECT,
        panel=panel,
    )


def _panel(robot: Robot, scene: Scene, playback: Playback) -> str:
    """HTML of a motion's certificate, controls, time line and charts."""
    kind, words, violations = certificate_words(playback.certificate)
    title = {"ok": "certified", "bad": "not certified", "none": "no certificate"}[kind]
    if playback.outcome is not None:
        went_well, words = playback.outcome
        kind, title = "ok" if went_well else "bad", "simulated"
    listed = "".join(f"<li>{html.escape(violation)}</li>" for violation in violations[:MOST_VIOLATIONS])
    if len(violations) > MOST_VIOLATIONS:
        listed += f"<li>and {len(violations) - MOST_VIOLATIONS} more</li>"
    return Template(view_asset("panel.html")).substitute(
        kind=kind,
        title=title,
        words=html.escape(words),
        violations=f"<ul>{listed}</ul>" if listed else "",
        data=_json_text(motion_data(robot, scene, playback)),
        script=view_asset("player.js"),
    )


def _json_text(value: Any) -> str:
    """JSON for a script element, with "<" escaped, which could end it."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def notebook_html(result: Shown) -> str:
    """Render the page of a result as a frame for notebooks.

    Raises:
        OptionError: `result` has no motion.
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    page = html.escape(render_page(*playable(result)))
    return f'<iframe srcdoc="{page}" width="100%" height="640" style="border: 0" allowfullscreen></iframe>'


def write_page(robot: Robot, scene: Scene, playback: Playback, path: Path | str) -> Path:
    """Write the page of `render_page` to a file.

    Returns:
        The path of the file.

    Raises:
        InputError: The motion does not fit robot or scene (`render_page`).
        OutputError: The file cannot be written.
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    return write_marked(path, render_page(robot, scene, playback), HTML_COMMENT)


def serve(robot: Robot, scene: Scene, playback: Playback) -> LiveView:
    """Serve the page of `render_page` on this machine.

    It prints nothing and opens no browser.

    Returns:
        The running view. Its `url` is accessible from this machine only. The server ends with `close` or with this
        process.

    Raises:
        InputError: The motion does not fit robot or scene (`render_page`).
        HplanError: The server cannot start, or meshcat, which provides the viewer, is not installed.
    """
    return LiveView(render_page(robot, scene, playback).encode())


def _viewer_source() -> str:
    """Read meshcat's viewer, a JavaScript file.

    Meshcat itself is not imported, which would take 0.2 s.
    """
    found: Any = importlib.util.find_spec("meshcat")
    for folder in [] if found is None else found.submodule_search_locations:
        path = Path(folder) / "viewer" / "dist" / "main.min.js"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise HplanError("meshcat's viewer (meshcat/viewer/dist/main.min.js) is not installed")
