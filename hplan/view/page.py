"""The animated page: arm, scene and motion in one HTML file, or from a live server.

The file holds meshcat's viewer and the commands that fill it; it needs no network and no server. Making it starts no
process.
"""

from __future__ import annotations

import contextlib
import html
import importlib.util
import json
import subprocess
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from hplan.base.child_process import import_environment, python_module
from hplan.base.files import write_text
from hplan.errors import HplanError
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.view import scenery
from hplan.view.framing import ASPECT
from hplan.view.playback import Playback
from hplan.view.scene_stage import APPROACH_COLOR, GOAL_COLOR, START_COLOR, stage
from hplan.view.three_js import Json

#: Longest wait for the live server [s].
START_S = 60.0

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
body {{ margin: 0; overflow: hidden; background: #e8edf2; }}
#meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}
#legend {{
  position: absolute; left: 20px; top: 16px; pointer-events: none; color: #26303c;
  font: 14px/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif;
}}
#legend h1 {{ margin: 0 0 2px; font-size: 19px; font-weight: 600; }}
#legend p {{ margin: 0 0 8px; color: #5a6675; }}
#legend span {{ display: block; }}
#legend i {{
  display: inline-block; width: 11px; height: 11px; margin-right: 8px; border-radius: 50%; vertical-align: -1px;
}}
.dg.main .close-button, .dg.main .close-button:hover {{ background: #26303c; opacity: 0.55; }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="legend">
<h1>{title}</h1>
<p>{subtitle}</p>
{legend}
</div>
<script type="application/json" id="commands">{commands}</script>
<script>
{viewer}
</script>
<script>
try {{
  var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
  JSON.parse(document.getElementById("commands").textContent).forEach(command => viewer.handle_command(command));
  const fit = () => {{
    viewer.camera.zoom = Math.min(1, window.innerWidth / window.innerHeight / {aspect});
    viewer.set_dirty();
  }};
  window.addEventListener("resize", fit);
  fit();
}} catch (error) {{
  document.querySelector("#legend p").textContent = "This page needs WebGL: " + error.message;
}}
</script>
</body>
</html>
"""


def render_page(robot: Robot, scene: Scene, playback: Playback) -> str:
    """The page as HTML text: self-contained, playing by itself in real time, again and again.

    Args:
        robot: The arm.
        scene: Obstacles and fruits.
        playback: The motion.

    Raises:
        InputError: The trajectory is of other joints than the robot's; `picked` names a fruit that the scene does not
            have, or a time outside the motion.
        HplanError: meshcat, which brings the viewer, is not installed.
    """
    trajectory = playback.trajectory
    moves = trajectory.samples > 1
    entries = [("Start", START_COLOR), ("Goal", GOAL_COLOR)] if moves else []
    if moves and any(phase.name == "approach" for phase in playback.phases):
        entries.append(("Approach", APPROACH_COLOR))
    for look in scenery.looks(scene):
        one = look is scenery.OTHER and len(scene.obstacles) == 1
        entries.append(("Obstacle" if one else look.label, look.color))
    if scene.fruits:
        entries.append(("Fruit", scenery.FRUIT_COLOR))
    if scene.goal.fruit is not None and len(playback.picked) < 2:
        entries.append(("Fruit to pick", scenery.HALO_COLOR))
    if moves and playback.picked:
        entries.append(("Picked", scenery.PICKED_COLOR))
    subtitle = f"{robot.name}, {trajectory.duration:.2f} s" if moves else f"{robot.name}, at rest"
    return document(scene.name, subtitle, entries, stage(robot, scene, playback))


def document(title: str, subtitle: str, entries: Iterable[tuple[str, int]], commands: Sequence[Json]) -> str:
    """A page of meshcat's viewer as HTML text, self-contained.

    Args:
        title: Title.
        subtitle: A line below it.
        entries: Words and colours of the legend.
        commands: Commands to the viewer.

    Raises:
        HplanError: meshcat, which brings the viewer, is not installed.
    """
    legend = "\n".join(
        f'<span><i style="background: #{color:06x}"></i>{html.escape(text)}</span>' for text, color in entries
    )
    return _PAGE.format(
        title=html.escape(title),
        subtitle=html.escape(subtitle),
        legend=legend,
        # Inside a script element, "<" could end it.
        commands=json.dumps(commands, separators=(",", ":")).replace("<", "\\u003c"),
        viewer=_viewer_source(),
        aspect=ASPECT,
    )


def write_page(robot: Robot, scene: Scene, playback: Playback, path: Path | str) -> Path:
    """Write the page of `render_page` to a file.

    Raises:
        InputError: As `render_page`.
        OutputError: The file cannot be written.
        HplanError: meshcat, which brings the viewer, is not installed.
    """
    return write_text(path, render_page(robot, scene, playback))


class LiveView:
    """A running meshcat server that shows one motion; `close` ends it, as does leaving a `with` block."""

    def __init__(self, url: str, zmq_url: str, process: subprocess.Popen[str]) -> None:
        """Hold what `serve` has started."""
        self.url = url
        self.zmq_url = zmq_url
        self._process = process

    @property
    def running(self) -> bool:
        """True until the server has ended."""
        return self._process.poll() is None

    def wait(self, timeout_s: float | None = None) -> None:
        """Wait until the server ends (it does not by itself) or `timeout_s` seconds have passed."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def close(self) -> None:
        """End the server."""
        _end(self._process)

    def __enter__(self) -> LiveView:
        """Return the view itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End the server."""
        self.close()


def serve(robot: Robot, scene: Scene, playback: Playback) -> LiveView:
    """Start meshcat's live server with the same scene and motion; prints nothing and opens no browser.

    Args:
        robot: The arm.
        scene: Obstacles and fruits.
        playback: The motion.

    Returns:
        The running view; its `url` is for a browser on this machine, the only one that reaches it. The server ends
        with `close`, and with this process, however that ends.

    Raises:
        InputError: As `render_page`.
        HplanError: The server does not start.
    """
    commands = stage(robot, scene, playback)
    _viewer_source()  # says plainly that meshcat is missing
    process, zmq_url, url = _start_server()
    view = LiveView(url, zmq_url, process)
    try:
        _send(zmq_url, commands)
    except BaseException:
        view.close()
        raise
    return view


def _start_server() -> tuple[subprocess.Popen[str], str, str]:
    """The process of `hplan.view.server`, and its addresses for commands and for a browser.

    Raises:
        HplanError: It does not start.
    """
    try:
        process = subprocess.Popen(
            python_module("hplan.view.server"),
            stdin=subprocess.PIPE,  # never written to: the server ends with it
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=import_environment(),
            text=True,
        )
    except OSError as error:
        raise HplanError(f"the meshcat server does not start: {error}") from error
    too_late = threading.Timer(START_S, process.kill)
    too_late.start()
    try:
        said: list[str] = []
        for line in process.stdout or ():
            said.append(line)
            if line.startswith("web_url="):
                addresses = dict(each.rstrip("\n").split("=", 1) for each in said if "_url=" in each)
                return process, addresses["zmq_url"], addresses["web_url"]
    except BaseException:
        _end(process)
        raise
    finally:
        too_late.cancel()
    _end(process)
    raise HplanError(f"the meshcat server does not start: {''.join(said).strip() or 'it says nothing'}")


def _end(process: subprocess.Popen[str]) -> None:
    """End a process and close its pipes."""
    if process.poll() is None:
        process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()


def _send(zmq_url: str, commands: Sequence[Json]) -> None:
    """Hand commands to a meshcat server; each is answered before the next is sent.

    Raises:
        HplanError: No answer within 10 s.
    """
    import umsgpack  # type: ignore[import-untyped]
    import zmq

    with zmq.Context() as context, context.socket(zmq.REQ) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVTIMEO, 10_000)
        socket.connect(zmq_url)
        try:
            for command in commands:
                head = [command["type"].encode(), command["path"].encode()]
                socket.send_multipart([*head, umsgpack.packb(command)])
                socket.recv()
        except zmq.Again as error:
            raise HplanError("the meshcat server does not answer") from error


def _viewer_source() -> str:
    """Meshcat's viewer, one JavaScript file, found without importing meshcat (0.2 s).

    Raises:
        HplanError: meshcat is not installed.
    """
    found: Any = importlib.util.find_spec("meshcat")
    for folder in [] if found is None else found.submodule_search_locations:
        path = Path(folder) / "viewer" / "dist" / "main.min.js"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise HplanError("meshcat's viewer (meshcat/viewer/dist/main.min.js) is not installed")
