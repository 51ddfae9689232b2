"""`hplan certify` and `hplan time --scene`: exit statuses, comparisons, messages, files."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from toy_urdf import SIX_AXIS_LIMITS, six_axis_picker

from hplan.apps.cli import main as cli
from hplan.apps.cli.main import main
from hplan.base.data_files import scenes_dir, urdf_dir
from hplan.robot.model import load_robot
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
    """Exit status and the printed JSON."""
    status = cli.main(["certify", *map(str, arguments), "--json"])
    return status, json.loads(capsys.readouterr().out)


def test_unchanged_folder_is_certified(done, capsys):
    status, report = said(capsys, done)
    told = json.loads((done / "report.json").read_text())["certificate"]
    assert status == 0
    assert report["status"] == "ok"
    assert report["differs"] == []
    assert report["certificate"] == told
    assert told["tracking_error_rad"] == pytest.approx(np.radians(0.005))


def test_scene_before_trajectory_is_told(done, tmp_path, capsys):
    scene = tmp_path / "scene.yaml"
    save_scene(load_scene("table-1"), scene)
    assert cli.main(["certify", str(scene), str(done / "trajectory.csv")]) == 2
    assert f"hplan certify {done / 'trajectory.csv'} {scene}" in " ".join(capsys.readouterr().err.split())


def test_folder_of_a_failed_job_tells_why_it_failed(tmp_path, capsys):
    out = tmp_path / "out"
    assert cli.main(["plan", "--robot", "panda", "--out", str(out), "--quiet"]) == 2
    assert cli.main(["certify", str(out)]) == 2
    assert "the job failed (InputError: start: expected 7 joint values" in " ".join(capsys.readouterr().err.split())


def test_trajectory_without_report(done, capsys):
    status, report = said(capsys, done / "trajectory.csv")
    assert status == 0
    assert report["certificate"]["tracking_error_rad"] == 0.0
    assert report["certificate"]["sigmas"] == 3.0
    status, report = said(capsys, done / "trajectory.csv", "--tracking-error", "5")
    assert status == 5
    assert report["status"] == "failed"
    assert "comes to" in report["certificate"]["violations"][0]


def test_risk(tmp_path, capsys):
    """A plan with a risk is certified again with it, but not with a smaller risk."""
    scene, folder = tmp_path / "vague.yaml", tmp_path / "out"
    sure = load_scene()
    ball = sure.obstacles[0].model_copy(update={"covariance": ((4e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-4))})
    shared = ((1e-5, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    save_scene(sure.with_obstacles([ball]).model_copy(update={"covariance": shared}), scene)
    assert cli.main(["plan", str(scene), "--out", str(folder), "--quiet", "--effort", "quick", "--risk", "0.02"]) == 0
    status, report = said(capsys, folder, scene)
    told = json.loads((folder / "report.json").read_text())["certificate"]
    assert (status, report["differs"]) == (0, [])
    assert 0.0 < told["risk"]["estimate"]["low"] <= told["risk"]["bound"] <= told["risk"]["asked"] == 0.02
    assert report["certificate"]["risk"]["bound"] == pytest.approx(told["risk"]["bound"])
    assert cli.main(["certify", str(folder / "trajectory.csv"), str(scene), "--risk", "0.001"]) == 5
    assert "risk" in capsys.readouterr().out


def test_trajectory_that_was_changed_a_little(job, capsys):
    """The motion is within limits and clear, but differs from the report's."""
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
    assert "trajectory is not that of report.json" in capsys.readouterr().out
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
def test_invalid_folders_are_refused(job, capsys, content):
    (job / "report.json").unlink() if content is None else (job / "report.json").write_text(content)
    assert cli.main(["certify", str(job)]) == 2
    assert "report.json" in capsys.readouterr().err


START = (0.0, 0.5, 0.4, 0.3)
FILES = {"report.json", "scene.html", "scene.yaml", "trajectory.csv"}


def waypoints(path: Path, rows: list[tuple[float, ...]]) -> Path:
    header = ",".join(load_robot().joint_names)
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n", encoding="utf-8")
    return path


def scene(path: Path, radius: float) -> Path:
    at = load_robot().tool_positions(np.array([[0.2, *START[1:]]]))[0].round(3).tolist()
    path.write_text(
        "format: hplan-scene/1\nname: ball\nstart: {joints_deg: [0, 0, 0, 0]}\ngoal: {joints_deg: [0, 9, 9, 9]}\n"
        f"obstacles:\n- {{kind: sphere, name: ball, center: [{at[0] * 1.3}, {at[1] * 1.3}, {at[2]}], "
        f"radius: {radius}}}\n",
        encoding="utf-8",
    )
    return path


def test_path_becomes_a_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [START, (0.1, 0.55, 0.4, 0.3), (0.3, 0.45, 0.4, 0.3), (0.4, *START[1:])]
    way, given = waypoints(tmp_path / "way.csv", rows), scene(tmp_path / "ball.yaml", 0.05)
    out = tmp_path / "job"
    words = ["time", "harvester", str(way), "--scene", str(given), "--out", str(out), "--effort", "quick"]
    assert main(words) == 0
    out_words = capsys.readouterr().out
    assert "4 waypoints were given" in out_words
    assert "scene.yaml" in out_words
    assert {path.name for path in out.iterdir()} == FILES
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["certificate"]["verified"]
    assert report["given"]["waypoints"] == 4
    assert read_csv(out / "trajectory.csv").position[[0, -1]] == pytest.approx(np.array(rows)[[0, -1]], abs=1e-7)
    assert load_scene(out / "scene.yaml").goal.listed_joints() == pytest.approx(rows[-1])
    # The written files are certified again unchanged.
    assert main(["certify", str(out), str(out / "scene.yaml")]) == 0
    assert main(["certify", str(out), "--quiet"]) == 0  # its report names the robot, and the scene is in the folder
    assert main(["view", str(out), "--no-serve", "--quiet"]) == 0
    kept_s = report["trajectory"]["duration_s"]
    assert main([*words, "--keep-path", "--quiet"]) == 0
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["trajectory"]["duration_s"] > kept_s


def test_poses_become_a_job(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf, given, way = tmp_path / "six.urdf", tmp_path / "scene.yaml", tmp_path / "poses.csv"
    urdf.write_text(six_axis_picker(), encoding="utf-8")
    urdf.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS, encoding="utf-8")
    start = "{joints_rad: [0, 0.3, 1.2, 0.1, -1.5, 0]}"
    given.write_text(f"format: hplan-scene/1\nname: poses\nstart: {start}\ngoal: {start}\n", encoding="utf-8")
    pose = load_robot(urdf).forward_kinematics(np.array([0.0, 0.3, 1.2, 0.1, -1.5, 0.0]))
    pose[2, 3] -= 0.1
    numbers = [*pose[:3, 3], *pin.Quaternion(pose[:3, :3]).coeffs()]
    way.write_text("x,y,z,qx,qy,qz,qw\n" + ",".join(map(str, numbers)) + "\n", encoding="utf-8")
    words = ["time", str(urdf), str(way), "--scene", str(given), "--out", str(tmp_path / "job"), "--poses"]
    assert main([*words, "--tilt", "5"]) == 0
    report = json.loads((tmp_path / "job" / "report.json").read_text(encoding="utf-8"))
    (phase,) = report["poses"]["phases"]
    assert phase["deviation_m"] < 1e-3
    assert phase["tilt_deg"] < 5.0
    assert main([*words, "--keep-path"]) == 2
    assert "--poses" in capsys.readouterr().err


def test_path_in_contact_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    way = waypoints(tmp_path / "way.csv", [START, (0.4, *START[1:])])
    given = scene(tmp_path / "ball.yaml", 0.44)
    out = tmp_path / "job"
    out.mkdir()
    (out / "trajectory.csv").write_text("of an earlier job", encoding="utf-8")
    assert main(["time", "harvester", str(way), "--scene", str(given), "--out", str(out), "--force"]) == 5
    assert "ball" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["report.json"]
    error = json.loads((out / "report.json").read_text(encoding="utf-8"))["error"]
    assert error["kind"] == "PathInContactError"
    assert error["obstacle"] == "ball"


@pytest.mark.parametrize(
    "words",
    [
        ["--scene", "table-1", "--acceleration", "3"],
        ["--scene", "table-1", "--joints", "yaw"],
        ["--keep-path"],
        ["--poses"],
        ["--deadline", "5"],
    ],
)
def test_options_out_of_place(tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    way = waypoints(tmp_path / "way.csv", [START, (0.4, *START[1:])])
    assert main(["time", "harvester", str(way), "--out", str(tmp_path / "out"), *words]) == 2
    assert "--scene" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["scene.yaml", "trajectory.csv"])
def test_files_that_are_read_are_not_removed(tmp_path: Path, name: str) -> None:
    out = tmp_path / "job"
    out.mkdir()
    way, given = waypoints(out / "trajectory.csv", [START, (0.4, *START[1:])]), scene(out / "scene.yaml", 0.05)
    elsewhere = waypoints(tmp_path / "way.csv", [START, (0.4, *START[1:])])
    before = {file: file.read_bytes() for file in (way, given)}
    read = {"trajectory.csv": [str(way), "--scene", "table-1"], "scene.yaml": [str(elsewhere), f"--scene={given}"]}[
        name
    ]
    words = ["time", "harvester", *read, "--out", str(out), "--quiet"]
    assert main(words) == 2
    assert {file: file.read_bytes() for file in out.iterdir()} == before
