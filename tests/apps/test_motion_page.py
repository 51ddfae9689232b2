"""The panel of a motion's page: certificate, time line, charts, user actions."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from make_pictures import browse
from pages import needs_chromium

import hplan
from hplan.apps.view.page import MOST_VIOLATIONS, STRETCHES, motion_data, render_page
from hplan.apps.view.playback import Playback
from hplan.base.data_files import view_asset
from hplan.collision.coal_scene import Contact
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.file import load_scene
from hplan.trajectory.trajectory import Phase, Trajectory

QUANTITIES = ("position", "velocity", "acceleration", "torque")


@pytest.fixture(scope="module")
def result(robot: Robot) -> PlanResult:
    return hplan.plan(robot, load_scene("trellis"))


@pytest.fixture(scope="module")
def playback(result: PlanResult) -> Playback:
    return Playback(result.trajectory, result.picked_fruit, phases=result.phases, certificate=result.certificate)


@pytest.fixture(scope="module")
def page(robot: Robot, playback: Playback) -> str:
    return render_page(robot, load_scene("trellis"), playback)


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="motion">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found.group(1))
    return data


def limits(robot: Robot) -> dict[str, tuple[Any, Any]]:
    """Zero and limit of each quantity."""
    return {
        "position": (0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)),
        "velocity": (0.0, robot.velocity_limit),
        "acceleration": (0.0, robot.acceleration_limit),
        "torque": (0.0, robot.torque_limit),
    }


def waving(robot: Robot, samples: int) -> Trajectory:
    time = np.linspace(0.0, 60.0, samples)
    wave = np.sin(np.outer(time, np.arange(1, robot.dof + 1)))
    spike = np.zeros_like(wave)
    spike[samples // 3, 0] = -2.0 * robot.torque_limit[0]
    return Trajectory(robot.joint_names, time, 0.1 * wave, 0.1 * wave, 0.1 * wave, spike)


# The data.


def test_charts_are_the_trajectory_as_shares_of_the_limits(robot: Robot, playback: Playback) -> None:
    data = motion_data(robot, load_scene("trellis"), playback)
    trajectory = playback.trajectory
    assert [chart["title"].lower() for chart in data["charts"]] == list(QUANTITIES)
    assert data["joints"] == list(robot.joint_names)
    for chart, name in zip(data["charts"], QUANTITIES, strict=True):
        zero, limit = limits(robot)[name]
        np.testing.assert_allclose(chart["time"], trajectory.time, atol=1e-4)
        expected = (getattr(trajectory, name) - zero) / limit
        np.testing.assert_allclose(np.array(chart["shares"]).T / 1e3, expected, atol=6e-4)
        assert np.abs(chart["shares"]).max() <= 1001


def test_long_motion_keeps_its_peaks_in_few_points(robot: Robot) -> None:
    trajectory = waving(robot, 30_000)
    data = motion_data(robot, load_scene(), Playback(trajectory))
    for chart, name in zip(data["charts"], QUANTITIES, strict=True):
        zero, limit = limits(robot)[name]
        assert len(chart["time"]) <= 2 * STRETCHES + 2
        assert (np.diff(chart["time"]) > 0.0).all()
        peak = np.abs((getattr(trajectory, name) - zero) / limit).max()
        assert np.abs(chart["shares"]).max() / 1e3 == pytest.approx(peak, abs=6e-4)
    assert min(data["charts"][3]["shares"][0]) == -2000


def test_clearance_is_the_certificates(robot: Robot, playback: Playback, result: PlanResult) -> None:
    clearance = motion_data(robot, load_scene("trellis"), playback)["clearance"]
    curve = result.certificate.clearance_curve
    assert curve is not None
    low = np.interp(clearance["time"], curve.time, curve.clearance_m)
    assert (np.array(clearance["certain"]) <= 1e3 * low + 1e-3).all()
    assert min(clearance["certain"]) >= np.floor(1e5 * result.certificate.min_clearance_m) / 100.0
    assert clearance["keep"] == pytest.approx(1e3 * load_scene("trellis").clearance)
    names = {name for pair in clearance["pairs"] for name in pair}
    assert "forearm" in names
    assert max(clearance["nearest"]) < len(clearance["pairs"])


# The page.


def test_page_shows_certificate_clearance_and_nearest_pair(page: str, result: PlanResult) -> None:
    text = unescape(re.sub(r"<[^>]+>", " ", page[page.index('<section id="certificate"') :].split("</section>")[0]))
    certificate = result.certificate
    assert certificate.nearest is not None
    assert " certified " in text
    assert "not certified" not in text
    assert f"at least {np.floor(1e5 * certificate.min_clearance_m) / 100:.2f} mm at all times" in text
    assert certificate.nearest.link in text
    assert certificate.nearest.obstacle in text


def test_page_of_uncertified_motion_gives_reason(robot: Robot, result: PlanResult) -> None:
    violations = tuple(f"violation <{k}>" for k in range(MOST_VIOLATIONS + 3))
    certificate = replace(result.certificate, verified=False, violations=violations)
    page = render_page(robot, load_scene("trellis"), Playback(result.trajectory, certificate=certificate))
    section = page[page.index('<section id="certificate"') :].split("</section>")[0]
    assert 'class="bad"' in section
    assert "<b>not certified</b>" in section
    assert section.count("<li>") == MOST_VIOLATIONS + 1
    assert "violation &lt;0&gt;" in section
    assert "and 3 more" in section


def test_names_of_obstacles_and_fruits_cannot_break_the_panel(robot: Robot, result: PlanResult) -> None:
    names = ("</script><b>x", '"><img src=x onerror=alert(1)>', "${title}", "früh & spät")
    nearest = Contact(names[0] + names[2], names[1], 0.1)
    certificate = replace(result.certificate, verified=False, nearest=nearest, violations=names)
    assert result.certificate.clearance_curve is not None
    curve = result.certificate.clearance_curve
    pairs = [(names[k % 4], names[k % 3]) for k in range(max(4, len(curve.pairs)))]
    curve = replace(curve, pairs=tuple(pairs))
    phases = [Phase(name, 0.1 * k, 0.1 * k + 0.1) for k, name in enumerate(names)]
    shown = Playback(result.trajectory, {}, phases=phases, certificate=certificate, clearance_curve=curve)
    scene = load_scene("trellis")
    page = render_page(robot, scene, shown)
    assert page.count("</script>") == render_page(robot, scene, Playback(result.trajectory)).count("</script>")
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "<b>x" not in markup
    assert "<img" not in markup
    data = data_of(page)
    assert [phase["name"] for phase in data["arms"][0]["phases"]] == list(names)
    assert data["clearance"]["pairs"][:4] == [list(pair) for pair in pairs[:4]]


def test_panel_is_self_contained_and_small(robot: Robot, page: str, playback: Playback) -> None:
    assert not re.search(r"""(src|href)\s*=\s*["']?(https?:)?//""", page)
    for asset in ("page.html", "panel.html", "page.css", "player.js"):
        assert not re.search(r"https?://|@import|url\(|innerHTML|document\.write|\beval\b", view_asset(asset))
    assert len(json.dumps(data_of(page))) < 100_000
    assert render_page(robot, load_scene("trellis"), playback) == page


# In a browser.

ACTS = """<script>
const seen = {};
const pose = () => viewer.animator.actions.map(action => action.time);
seen.playing = element("play").getAttribute("aria-label");
element("play").click();
seen.paused = element("play").getAttribute("aria-label");
element("time").value = 0.5;
element("time").dispatchEvent(new Event("input"));
seen.scrubbed = [player.time(), ...pose()];
document.body.focus();
const fire = key => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
fire("ArrowRight");
seen.stepped = player.time();
fire("End");
seen.end = player.time();
seen.phase = document.querySelector("#clock span").textContent;
fire(" ");
seen.again = [element("play").getAttribute("aria-label"), player.time()];
fire(" ");
const plot = document.querySelector(".plot"), box = plot.getBoundingClientRect();
plot.setPointerCapture = () => {};
plot.dispatchEvent(new PointerEvent("pointerdown", { clientX: box.right - 10, buttons: 1 }));
seen.dragged = player.time();
seen.charts = document.querySelectorAll("#charts figure").length;
seen.wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
const there = words => [...document.querySelectorAll(words)].filter(item => !item.hidden);
seen.sizes = there("main button, main select, #time").map(item => item.offsetHeight);
element("least").click();
seen.nearest = [element("least").textContent, player.time()];
seen.grey = [...document.querySelectorAll(".dg")].filter(item => item.offsetHeight > 0).length;
seen.inked = [...document.querySelectorAll(".plot canvas")].map(canvas => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((count, value, k) => count + (k % 4 === 3 && value > 0), 0) / (data.length / 4);
});
document.title = JSON.stringify(seen);
</script>"""


def tried(page: str, acts: str, folder: Path) -> dict[str, Any]:
    """State of a page after some actions, in a window of minimum width (500 px)."""
    run = browse(page.replace("</body>", f"{acts}</body>"), folder, "--dump-dom", (500, 844))
    found = re.search(r"<title>(\{.*?\})</title>", run.stdout)
    assert found is not None, run.stderr[-2000:]
    seen: dict[str, Any] = json.loads(unescape(found.group(1)))
    return seen


@needs_chromium
@pytest.mark.browser
def test_play_pause_scrub_and_keys_in_a_browser(page: str, result: PlanResult, tmp_path: Path) -> None:
    seen = tried(page, ACTS, tmp_path)
    duration = result.trajectory.duration
    assert (seen["playing"], seen["paused"]) == ("Pause", "Play")
    assert seen["scrubbed"] == [0.5] * len(seen["scrubbed"])
    assert len(seen["scrubbed"]) > 4
    assert seen["stepped"] == pytest.approx(0.5 + duration / 100)
    assert seen["end"] == pytest.approx(duration)
    assert seen["phase"].startswith("retreat from fruit")
    assert seen["again"] == ["Pause", 0]
    assert seen["dragged"] == pytest.approx(duration, rel=0.01)
    assert (seen["charts"], seen["wide"]) == (5, 0)
    assert min(seen["sizes"]) >= 44
    assert min(seen["inked"]) > 0.3
    assert result.certificate.clearance_curve is not None
    curve = result.certificate.clearance_curve.report_curve  # as the page draws it
    words, at = seen["nearest"]
    assert words == f"look: {at:.2f} s"
    assert np.interp(at, curve.time, curve.clearance_m) == pytest.approx(np.min(curve.clearance_m), abs=1e-4)
    assert seen["grey"] == 0
