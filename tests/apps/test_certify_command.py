"""`hplan certify`: exit statuses, what is compared, and what is said."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from hplan.apps.cli import main as cli
from hplan.base.data_files import scenes_dir, urdf_dir
from hplan.scene.file import load_scene, save_scene
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """The folder of a job: the reference scene, with a tracking error."""
    folder = tmp_path_factory.mktemp("job") / "out"
    assert cli.main(["plan", "--out", str(folder), "--quiet", "--tracking-error", "0.005", "--sigmas", "2"]) == 0
    return folder


@pytest.fixture
def job(done, tmp_path) -> Path:
    """A copy of it to tamper with."""
    return Path(shutil.copytree(done, tmp_path / "out"))


def said(capsys, *arguments):
    """Exit status and what is printed as JSON."""
    status = cli.main(["certify", *map(str, arguments), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_a_folder_as_it_was_left(done, capsys):
    status, report = said(capsys, done)
    told = json.loads((done / "report.json").read_text())["certificate"]
    assert status == 0
    assert report["status"] == "ok"
    assert report["differs"] == []
    assert report["certificate"] == told
    assert told["tracking_error_rad"] == pytest.approx(np.radians(0.005))


def test_a_trajectory_by_itself(done, capsys):
    status, report = said(capsys, done / "trajectory.csv")
    assert status == 0
    assert report["certificate"]["tracking_error_rad"] == 0.0
    assert report["certificate"]["sigmas"] == 3.0
    status, report = said(capsys, done / "trajectory.csv", "--tracking-error", "5")
    assert status == 5
    assert report["status"] == "failed"
    assert "comes to" in report["certificate"]["violations"][0]


def test_a_risk(tmp_path, capsys):
    """A plan at risk is certified again as its folder says it was, by a stricter risk it is not."""
    scene, folder = tmp_path / "vague.yaml", tmp_path / "out"
    sure = load_scene()
    ball = sure.obstacles[0].model_copy(update={"covariance": ((4e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))})
    shared = ((1e-5, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    save_scene(sure.with_obstacles([ball]).model_copy(update={"covariance": shared}), scene)
    assert cli.main(["plan", str(scene), "--out", str(folder), "--quiet", "--risk", "0.02"]) == 0
    status, report = said(capsys, folder, scene)
    told = json.loads((folder / "report.json").read_text())["certificate"]
    assert (status, report["differs"]) == (0, [])
    assert 0.0 < told["risk"]["estimate"]["low"] <= told["risk"]["bound"] <= told["risk"]["asked"] == 0.02
    assert report["certificate"]["risk"]["bound"] == pytest.approx(told["risk"]["bound"])
    assert cli.main(["certify", str(folder / "trajectory.csv"), str(scene), "--risk", "0.001"]) == 5
    assert "risk" in capsys.readouterr().out


def test_a_trajectory_that_was_changed_a_little(job, capsys):
    """Still within limits and clear: but not what the report is about."""
    motion = read_csv(job / "trajectory.csv")
    torque = np.array(motion.torque)
    torque[5, 1] += 1e-9
    columns = motion.time, motion.position, motion.velocity, motion.acceleration, torque
    write_csv(Trajectory(motion.joint_names, *columns), job / "trajectory.csv")
    status, report = said(capsys, job)
    assert status == 5
    assert report["differs"] == ["trajectory"]
    assert report["certificate"]["verified"]
    assert cli.main(["certify", str(job)]) == 5
    assert "trajectory is not the one of report.json" in capsys.readouterr().out
    assert said(capsys, job / "trajectory.csv")[0] == 0


def test_another_scene_and_another_robot(job, capsys, tmp_path):
    text = (scenes_dir() / "table-1.yaml").read_text()
    (tmp_path / "other.yaml").write_text(text.replace("radius: 0.15", "radius: 0.1499"))
    status, report = said(capsys, job, tmp_path / "other.yaml")
    assert (status, report["differs"], report["certificate"]["verified"]) == (5, ["scene"], True)
    for name in ("harvester.urdf", "harvester.limits.yaml"):
        shutil.copy(urdf_dir() / name, tmp_path / name)
    urdf = tmp_path / "harvester.urdf"
    urdf.write_text(urdf.read_text().replace('effort="', 'effort="1'))
    status, report = said(capsys, job, "--robot", urdf)
    assert (status, report["differs"], report["certificate"]["verified"]) == (5, ["robot"], True)


def test_ends(done, capsys, tmp_path):
    text = (scenes_dir() / "table-1.yaml").read_text()
    (tmp_path / "other.yaml").write_text(text.replace("start: {joints_deg: [0, ", "start: {joints_deg: [1, "))
    other = tmp_path / "other.yaml"
    assert other.read_text() != text
    status, report = said(capsys, done / "trajectory.csv", other)
    assert status == 5
    assert "begins" in report["certificate"]["violations"][0]
    assert said(capsys, done / "trajectory.csv", other, "--any-ends")[0] == 0


@pytest.mark.parametrize("content", [None, "{", "[]", "{}", '{"certificate": {"digests": null}}'])
def test_folders_that_are_none(job, capsys, content):
    (job / "report.json").unlink() if content is None else (job / "report.json").write_text(content)
    assert cli.main(["certify", str(job)]) == 2
    assert "report.json" in capsys.readouterr().err
