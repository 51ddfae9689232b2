"""`hplan view`: the page of a job, byte for byte; refusals; the served pages."""

from __future__ import annotations

import json
import os
import shutil
import urllib.request
from pathlib import Path
from typing import Any

import pytest

import hplan
from hplan.apps.cli.main import main
from hplan.base.data_files import shipped_scene


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a motion to a fruit."""
    folder = tmp_path_factory.mktemp("plan")
    assert main(["plan", "trellis", "--out", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def tours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a tour with a CSV for each leg."""
    folder = tmp_path_factory.mktemp("tour")
    fruits = ["--fruits", "fruit 01", "fruit 04", "fruit 09"]
    to_drop_off = ["--drop-off-joints", "90", "45", "45", "45", "--every", "2", "--back"]
    assert main(["tour", "--out", str(folder), *fruits, *to_drop_off, "--csv", "each", "--quiet"]) == 0
    return folder


@pytest.fixture
def job(plans: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(plans, tmp_path / "job"))


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the scenes that were served."""
    names: list[str] = []

    def serve(console: Any, robot: Any, scene: hplan.Scene, playback: Any) -> None:
        names.append(scene.name)

    monkeypatch.setattr("hplan.apps.cli.view.serve_page", serve)
    return names


@pytest.mark.parametrize("kind", ["plans", "tours"])
def test_page_of_a_job_is_the_one_that_it_had(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str], served: list[str]
) -> None:
    done: Path = request.getfixturevalue(kind)
    job = Path(shutil.copytree(done, tmp_path / "job"))
    (job / "scene.html").unlink()
    assert main(["view", str(job), "--no-serve"]) == 0
    assert (job / "scene.html").read_bytes() == (done / "scene.html").read_bytes()
    assert capsys.readouterr().out == f"written: {job / 'scene.html'}\n"
    assert served == []


def test_job_is_served_and_its_scene_is_found(job: Path, served: list[str]) -> None:
    assert main(["view", str(job), "--quiet"]) == 0
    assert served == ["trellis"]


def test_trajectory_without_report(job: Path, served: list[str]) -> None:
    """In a scene that it was not planned for: nothing is compared, and its page is no job's."""
    before = (job / "scene.html").read_bytes()
    assert main(["view", str(job / "trajectory.csv"), "tour", "--quiet"]) == 0
    assert served == ["tour"]
    assert "<h1>tour</h1>" in (job / "trajectory.html").read_text()
    assert (job / "scene.html").read_bytes() == before


def test_later_job_of_a_folder(job: Path, tours: Path, served: list[str]) -> None:
    for file in tours.iterdir():
        shutil.copy(file, job)
    for first, second, name in (("report", "tour", "tour"), ("tour", "report", "trellis")):
        os.utime(job / f"{first}.json", (1e9, 1e9))
        os.utime(job / f"{second}.json", (2e9, 2e9))
        assert main(["view", str(job), "--quiet"]) == 0
        assert served.pop() == name


def test_other_scene_robot_or_trajectory_is_refused(
    job: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], served: list[str]
) -> None:
    before = (job / "scene.html").read_bytes()
    assert main(["view", str(job), "tour"]) == 5
    assert capsys.readouterr().err == f"the scene is not that of {job / 'report.json'}\n"
    rows = (job / "trajectory.csv").read_text().splitlines(keepends=True)
    (job / "trajectory.csv").write_text("".join(rows[:-1]))
    assert main(["view", str(job)]) == 5
    assert "the trajectory is not" in capsys.readouterr().err
    assert (job / "scene.html").read_bytes() == before
    assert served == []


def test_scene_of_ones_own_is_given_again(
    tmp_path: Path, served: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(shipped_scene("table-1").read_text().replace("name: table-1", "name: own"))
    assert main(["plan", str(own), "--out", str(tmp_path), "--quiet"]) == 0
    capsys.readouterr()
    assert main(["view", str(tmp_path), "--quiet"]) == 2
    assert "its scene 'own' does not ship with hplan: give the scene file" in capsys.readouterr().err
    assert main(["view", str(tmp_path), str(own), "--quiet"]) == 0
    assert served == ["own"]


def test_robot_of_a_job_is_that_of_its_report(job: Path, served: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    report = json.loads((job / "report.json").read_text())
    (job / "report.json").write_text(json.dumps({**report, "robot": "orchard_harvester"}))
    assert main(["view", str(job), "--quiet"]) == 5  # the digest is another robot's
    (job / "report.json").write_text(json.dumps({**report, "robot": "my arm"}))
    assert main(["view", str(job), "--quiet"]) == 2
    says = "its robot 'my arm' does not ship with hplan: give the URDF with --robot"
    assert says in capsys.readouterr().err
    assert main(["view", str(job), "--robot", "harvester", "--quiet"]) == 0
    assert len(served) == 1


@pytest.mark.parametrize("name", ["trajectory.csv", "report.json"])
def test_input_file_is_not_replaced(job: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = (job / name).read_bytes()
    assert main(["view", str(job), "--out", str(job / name)]) == 2
    assert "a file other than the inputs" in capsys.readouterr().err
    assert (job / name).read_bytes() == before


def test_pages_of_row_are_served_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: dict[str, bytes] = {}

    def wait_for(_: Any, view: Any) -> None:
        with view, urllib.request.urlopen(view.url) as page, urllib.request.urlopen(f"{view.url}stop-01.html") as stop:
            shown.update(page=page.read(), stop=stop.read())

    monkeypatch.setattr("hplan.apps.cli.view.wait_for", wait_for)
    (tmp_path / "scene.html").write_text("the row")
    assert main(["view", str(tmp_path), "--quiet"]) == 2  # there is no report
    (tmp_path / "row.json").write_text("{}")
    (tmp_path / "stop-01.html").write_text("the stop")
    assert main(["view", str(tmp_path), "--quiet"]) == 0
    assert shown == {"page": b"the row", "stop": b"the stop"}
    assert main(["view", str(tmp_path), "--out", "page.html"]) == 2
    (tmp_path / "scene.html").unlink()
    assert main(["view", str(tmp_path), "--quiet"]) == 2
