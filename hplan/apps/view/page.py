"""The animated page: arm, scene and motion in HTML, written or served.

The HTML holds meshcat's viewer and its commands, so the file needs neither network nor server. Rendering it starts no
process.
"""

from __future__ import annotations

import html
import importlib.util
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from hplan.apps.view import scenery
from hplan.apps.view.framing import ASPECT
from hplan.apps.view.motion_data import certificate_words, motion_data
from hplan.apps.view.playback import Playback, playable
from hplan.apps.view.scene_stage import APPROACH_COLOR, GOAL_COLOR, START_COLOR, stage
from hplan.apps.view.server import LiveView
from hplan.apps.view.three_js import Json
from hplan.base.arguments import instance
from hplan.base.data_files import view_asset
from hplan.base.files import HTML_COMMENT, write_marked
from hplan.errors import HplanError
from hplan.robot.model import Robot
from hplan.scene.model import Scene

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown

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
    trajectory = instance("playback", playback, Playback, "Playback.of").trajectory
    moves = trajectory.samples > 1
    entries: list[tuple[str, Sequence[int]]] = [("Start", [START_COLOR]), ("Goal", [GOAL_COLOR])] if moves else []
    if moves and any(phase.name == "approach" for phase in playback.every_phase):
        entries.append(("Approach", [APPROACH_COLOR]))
    colors = [look.color for look in scenery.looks(scene)]
    if colors:
        entries.append(("Obstacle" if len(scene.obstacles) == 1 else "Obstacles", colors))
    if scene.fruits:
        entries.append(("Fruit", [scenery.FRUIT_COLOR]))
    if scene.goal.fruit is not None and len(playback.picked) < 2:
        entries.append(("Fruit to pick", [scenery.HALO_COLOR]))
    if moves and playback.picked:
        entries.append(("Picked", [scenery.PICKED_COLOR]))
    subtitle = f"{robot.name}, {trajectory.duration:.2f} s" if moves else f"{robot.name}, at rest"
    panel = _panel(robot, scene, playback) if moves else ""
    return document(scene.name, subtitle, entries, stage(robot, scene, playback), panel)


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

    Raises:
        HplanError: meshcat is not installed.
    """
    found: Any = importlib.util.find_spec("meshcat")
    for folder in [] if found is None else found.submodule_search_locations:
        path = Path(folder) / "viewer" / "dist" / "main.min.js"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise HplanError("meshcat's viewer (meshcat/viewer/dist/main.min.js) is not installed")
