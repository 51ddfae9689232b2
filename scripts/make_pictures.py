"""Make all pictures of README and documentation; needs Chromium and extra `figures`.

    python scripts/make_pictures.py [--check]
    python scripts/make_pictures.py --gallery FOLDER [EXAMPLE ...]

Each picture of `docs/pictures` states the duration of its motion. `--check` plans the same motions again and lists the
pictures that differ from today's code. `--gallery` runs programs of `scripts/examples`: for each it writes a picture,
the printed output and, if there is a motion in a scene, its page; the site is built with them.
"""

from __future__ import annotations

import base64
import contextlib
import io
import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, PngImagePlugin

import hplan
from hplan.apps.view.figures import draw_row, draw_study, png_bytes
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback, playable
from hplan.base.files import write_bytes
from hplan.planar.pages.cspace_figure import cspace_at_yaw
from hplan.planar.pages.yaw_section import yaw_section
from hplan.scene.orchard import MeasuredOptions, measured_orchard

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
EXAMPLES = ROOT / "scripts" / "examples"
TREE = EXAMPLES / "trees" / "apple_1_tallspindle.csv"

#: Under which a picture says how long the motion is that it shows [s], and by how much of it today's may differ.
DURATION_KEY, SAME = "hplan duration", 0.01

#: Frames of the moving picture a second, its size, how many colours it has.
RATE_HZ, SIZE, COLORS = 12.5, (640, 480), 240

#: Options for pages besides their size: 3-D rendering by the processor, no network.
CHROMIUM = (
    "--headless=new", "--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run", "--hide-scrollbars", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--virtual-time-budget=200", "--enable-logging=stderr",
)  # fmt: skip

#: Draws the picture of a page alone, without its text, and stores it as the page's text.
_FRAMES = """
player.pause();
const drawn = [%s].map(time => {
  player.seek(time);
  viewer.renderer.render(viewer.scene, viewer.camera);
  return viewer.renderer.domElement.toDataURL("image/png");
});
document.body.textContent = "frames:" + drawn.join(" ");
"""
#: Pauses in the middle of the motion.
_MIDDLE = "player.pause(); player.seek(0.5 * motion.duration);"


def _alone(page: str, size: tuple[int, int], script: str) -> str:
    """A page whose picture has a size, and that runs a script in the end."""
    style = "<style>body.motion #picture {{ width: {}px; height: {}px; }}</style>".format(*size)
    return page.replace("</head>", f"{style}</head>").replace("</body>", f"<script>{script}</script></body>")


def still(page: str, script: str = "") -> bytes:
    """A PNG of a page's picture without the panel below it, after a script."""
    html = _alone(page, (800, 560), script)
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "picture.png"
        browse(html, Path(folder), f"--screenshot={picture}", (800, 560))
        return _png(*few_colors([Image.open(picture).convert("RGB")]))


def frames(page: str, times_s: Sequence[float]) -> list[Image.Image]:
    """Pictures of a page's motion at some times [s]."""
    html = _alone(page, SIZE, _FRAMES % ",".join(f"{time:.3f}" for time in times_s))
    with tempfile.TemporaryDirectory() as folder:
        text = browse(html, Path(folder), "--dump-dom", SIZE).stdout
    found = re.findall(r"data:image/png;base64,([\w+/=]+)", text.rpartition("frames:")[2])
    if len(found) != len(times_s):
        raise RuntimeError(f"Chromium drew {len(found)} of {len(times_s)} frames")
    return [Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB") for data in found]


def browse(html: str, folder: Path, action: str, size: tuple[int, int]) -> subprocess.CompletedProcess[str]:
    """Open a page, written into a folder, in Chromium."""
    chromium = shutil.which("chromium")
    if chromium is None:
        raise SystemExit("pictures are drawn by chromium, which is not installed")
    page, window = folder / "page.html", "--window-size={},{}".format(*size)
    page.write_text(html, encoding="utf-8")
    # On a busy machine Chromium may hang as it starts: it is started again, with a profile of its own.
    tries, patience_s = 4, 75.0
    for number in range(tries):
        profile = f"--user-data-dir={folder / f'profile {number}'}"
        command = [chromium, *CHROMIUM, window, profile, action, page.as_uri()]
        with contextlib.suppress(subprocess.TimeoutExpired):
            return subprocess.run(command, capture_output=True, text=True, timeout=patience_s, check=True)
    raise RuntimeError(f"Chromium was started {tries} times and drew nothing within {patience_s:g} s")


def few_colors(drawn: list[Image.Image]) -> list[Image.Image]:
    """Quantize pictures with one palette, to compress static areas.

    It has `COLORS` colors: half by area, for the sky, and half for all colors equally, since fruit is small.
    """
    some = np.vstack([np.asarray(frame).reshape(-1, 3) for frame in drawn[:: max(1, len(drawn) // 6)]])
    alike = np.unique(some & 0xF8, axis=0)
    by_area = np.random.default_rng(1).choice(some, len(alike))
    palette = Image.fromarray(np.vstack([alike, by_area])[None]).quantize(COLORS)
    return [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in drawn]


def _png(picture: Image.Image, duration_s: float | None = None) -> bytes:
    """A picture as PNG, with the duration of its motion."""
    stream, facts = io.BytesIO(), PngImagePlugin.PngInfo()
    if duration_s is not None:
        facts.add_text(DURATION_KEY, f"{duration_s:.3f}")
    picture.save(stream, format="PNG", optimize=True, pnginfo=facts)
    return stream.getvalue()


def _picking() -> hplan.TourResult:
    """An arm picks fruit from the shipped measured tree, 20 mm compliant."""
    trees = MeasuredOptions(distance=1.2, yaw_deg=180.0, wood_yields=0.02, fruit_yields=0.02)
    scene, robot = measured_orchard([TREE], trees), hplan.load_robot("orchard_harvester")
    names = [name for name, fruit in hplan.reachable(robot, scene).items() if fruit.can_be_picked]
    return hplan.plan_tour(robot, scene, fruits=names[:6], tour=hplan.TourOptions(back=True))


def _plan(scene: str) -> Callable[[], hplan.PlanResult]:
    """Plans a scene that ships."""
    return lambda: hplan.plan(hplan.load_robot(), hplan.load_scene(scene))


def _moving(result: Any) -> bytes:
    """A GIF of a motion, in real time."""
    duration = result.trajectory.duration
    page = render_page(*playable(result))
    drawn = frames(page, np.arange(0.0, duration, 1.0 / RATE_HZ).tolist())
    few = few_colors(drawn)
    stream, pause_ms = io.BytesIO(), round(1e3 / RATE_HZ)
    few[0].save(
        stream, format="GIF", save_all=True, append_images=few[1:], loop=0, optimize=True,
        duration=[pause_ms] * (len(few) - 1) + [1000], comment=f"{DURATION_KEY}: {duration:.3f}".encode(),
    )  # fmt: skip
    return stream.getvalue()


def _standing(result: Any) -> bytes:
    """A PNG of a motion at half of its duration."""
    page = render_page(*playable(result))
    return _png(Image.open(io.BytesIO(still(page, _MIDDLE))), result.trajectory.duration)


def _cspace(result: hplan.PlanResult) -> bytes:
    """A PNG of the joint space at the goal's yaw, with the motion in it."""
    section = yaw_section(result.robot, result.scene, Playback.from_result(result))
    figure = png_bytes(cspace_at_yaw(section, result.scene.name), dpi=110)
    return _png(Image.open(io.BytesIO(figure)), result.trajectory.duration)


@dataclass(frozen=True)
class Picture:
    """A picture of the documentation: the motion that it shows, and how it is drawn."""

    plan: Callable[[], Any]
    draw: Callable[[Any], bytes]


DOCS = {
    "picking.gif": Picture(_picking, _moving),
    "reference.png": Picture(_plan("table-1"), _standing),
    "cspace.png": Picture(_plan("table-1"), _cspace),
    "cspace-yaw.png": Picture(_plan("dense-canopy"), _cspace),
}


def shown_s(path: Path) -> float:
    """How long the motion of a picture was when it was drawn [s]."""
    info = Image.open(path).info
    text = info["comment"].decode().rpartition(" ")[2] if "comment" in info else info[DURATION_KEY]
    return float(text)


def stale() -> list[str]:
    """Names of the pictures that show something else than today's motions."""
    found = []
    for name, picture in DOCS.items():
        duration, shown = picture.plan().trajectory.duration, shown_s(PICTURES / name)
        if abs(duration - shown) > SAME * shown:
            found.append(f"{name}: {shown:.3f} s, today {duration:.3f} s")
    return found


# The gallery: examples, their output and results.


def _gallery(folder: Path, names: Sequence[str]) -> None:
    """Run examples, each in a process of its own, one for each core at a time."""
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(lambda name: _example_process(folder, name), names):
            pass


def _example_process(folder: Path, name: str) -> None:
    """Run one example as its user would, and store its output."""
    run = subprocess.run(
        [sys.executable, __file__, "--example", str(folder), name], capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise SystemExit(f"scripts/examples/{name}.py failed:\n{run.stderr[-4000:]}")
    said = "".join(line for line in run.stdout.splitlines(keepends=True) if not line.startswith("written: "))
    (folder / f"{name}.txt").write_text(said, encoding="utf-8")


def _example(folder: Path, name: str) -> None:
    """Run an example's `main`, and write picture and page of its result."""
    result = runpy.run_path(str(EXAMPLES / f"{name}.py"))["main"]()
    page, figure = _shown(result)
    if page is not None:
        (folder / f"{name}.html").write_text(page, encoding="utf-8")
    if figure is None and shutil.which("chromium") is None:
        return  # the page says it all, and more
    (folder / f"{name}.png").write_bytes(still(page or "", _MIDDLE) if figure is None else png_bytes(figure, dpi=110))


def _shown(result: Any) -> tuple[str | None, Any]:
    """The page of a result, and a figure if it is better than the page's picture."""
    if motions := result if isinstance(result, list) else getattr(result, "motions", []):
        return _shown(motions[-1])
    if isinstance(result, hplan.StudyResult):
        return None, draw_study(result)
    if isinstance(result, hplan.RowResult):
        tour = max((stop.tour for stop in result.stops), key=lambda tour: len(tour.order))
        return render_page(*playable(tour)), draw_row(result)
    if isinstance(result, hplan.Trajectory):
        return None, result.plot()
    return render_page(*playable(result)), None


def main() -> int:
    """Draw all pictures, or check them, or draw the pictures of examples."""
    match sys.argv[1:]:
        case ["--gallery", folder, *names]:
            _gallery(Path(folder), names or sorted(path.stem for path in EXAMPLES.glob("*.py")))
            return 0
        case ["--example", folder, name]:
            _example(Path(folder), name)
            return 0
    if "--check" in sys.argv[1:]:
        old = stale()
        print("\n".join(old) or "all pictures are of today's motions")
        return 5 if old else 0
    PICTURES.mkdir(exist_ok=True)
    for name, picture in DOCS.items():
        path = write_bytes(PICTURES / name, picture.draw(picture.plan()))
        print(f"{path.relative_to(ROOT)}: {path.stat().st_size // 1024} KB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
