"""The three main pages in a browser, on desktop and phone, against stored pictures.

If a page was changed on purpose, its new picture is in the folder that the failure names: look at it, and copy it to
`screenshots`.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from make_pictures import browse
from pages import needs_chromium
from PIL import Image

import hplan
from hplan.apps.view.page import render_page
from hplan.apps.view.playback import Playback
from hplan.planar.pages.cspace_page import render_cspace_page
from hplan.planar.pages.yaw_section import yaw_section

KEPT = Path(__file__).with_name("screenshots")
DESK, PHONE = (1280, 860), (390, 844)

#: The font of all texts, so that lines break as they did whatever fonts are installed; it comes with matplotlib.
FONT = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")

#: Pixels that are compared as one: edges of another renderer are less than that.
BLOCK = 20

#: Maximum difference of a block, of 255, and the maximum fraction of blocks that differ by more.
DIFFERENT, SHARE = 24.0, 0.005

STILL = "<script>player.pause(); player.seek(0.5 * motion.duration);</script>"


def motion_page() -> str:
    robot, scene = hplan.load_robot(), hplan.load_scene()
    return render_page(robot, scene, Playback.from_result(hplan.plan(robot, scene))).replace(
        "</body>", f"{STILL}</body>"
    )


def tour_page() -> str:
    robot, scene = hplan.load_robot(), hplan.load_scene("tour")
    tour = hplan.plan_tour(robot, scene, hplan.PlanOptions(effort="quick"))
    return render_page(robot, scene, Playback.from_result(tour)).replace("</body>", f"{STILL}</body>")


def cspace_page() -> str:
    robot, scene = hplan.load_robot(), hplan.load_scene()
    result = hplan.plan(robot, scene)
    page = render_cspace_page(yaw_section(robot, scene, Playback.from_result(result), hplan.PlanOptions()), scene.name)
    halfway = f"<script>viewer.animator.pause(); viewer.animator.seek({0.5 * result.trajectory.duration});</script>"
    return page.replace("</body>", f"{halfway}</body>")


def taken(page: str, size: tuple[int, int], folder: Path, name: str) -> Image.Image:
    """A page as drawn by Chromium; narrow windows are frames in a wider one."""
    font = base64.b64encode(FONT.read_bytes()).decode()
    face = f"@font-face {{ font-family: own; src: url(data:font/ttf;base64,{font}); }}"
    own = page.replace("</head>", f"<style>{face} * {{ font-family: own !important; }}</style></head>", 1)
    (folder / "inner.html").write_text(own, encoding="utf-8")
    html = f'<body style="margin:0"><iframe src="inner.html" style="border:0;width:{size[0]}px;height:{size[1]}px">'
    picture = folder / f"{name}.png"
    done = browse(f"<!doctype html>{html}</iframe></body>", folder, f"--screenshot={picture}", size)
    assert not re.search(r"CONSOLE.*(Uncaught|[Ee]rror)", done.stderr), done.stderr[-2000:]
    image = Image.open(picture).convert("RGB").crop((0, 0, *size))
    image.save(picture.with_suffix(".jpg"), quality=60)
    return image


def blocks(image: Image.Image) -> np.ndarray:
    size = (image.width // BLOCK, image.height // BLOCK)
    return np.asarray(image.convert("RGB").resize(size, Image.Resampling.BOX), dtype=float)


@needs_chromium
@pytest.mark.browser
@pytest.mark.parametrize(
    ("name", "page", "size"),
    [
        ("motion", motion_page, DESK),
        ("motion_phone", motion_page, PHONE),
        ("tour", tour_page, DESK),
        ("cspace", cspace_page, DESK),
    ],
)
def test_page_looks_like_its_picture(name: str, page: Callable[[], str], size: tuple[int, int], tmp_path: Path) -> None:
    seen, kept = (blocks(image) for image in (taken(page(), size, tmp_path, name), Image.open(KEPT / f"{name}.jpg")))
    assert seen.shape == kept.shape
    differ = np.abs(seen - kept).max(axis=-1) > DIFFERENT
    assert differ.mean() <= SHARE, f"{differ.mean():.1%} of the picture is another: see {tmp_path / f'{name}.jpg'}"
