"""The main job as its user runs it: files, their contracts, exit statuses, messages."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.apps.cli import terminal
from hplan.apps.cli.main import main
from hplan.planning.report import report_text
from hplan.robot.family.members import HARVESTER, write_robot
from hplan.robot.model import Robot

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "plan_and_time.py"
FILES = {"trajectory.csv", "report.json", "scene.html"}

TABLE_1: dict[str, Any] = {
    "format": "hplan-scene/1",
    "name": "table-1",
    "start": {"joints_deg": [0, 0, 0, 0]},
    "goal": {"joints_deg": [0, 45, 60, 70]},
    "locked_joints": ["base_yaw"],
    "obstacles": [{"name": "ball", "kind": "sphere", "center": [1.0, 0.0, 1.9], "radius": 0.15}],
}
#: Balls along a ray from the shoulder: the upper arm passes neither between them nor around them.
WALL = [
    {"name": f"ball {i}", "kind": "sphere", "center": [0.92 * r, 0.0, 0.6 + 0.38 * r], "radius": 0.08}
    for i, r in enumerate([0.45, 0.65, 0.85, 1.05])
]

Run = Callable[..., tuple[int, Path]]


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Write the reference scene with some keys changed; None removes a key."""

    def write(**changes: Any) -> Path:
        path = tmp_path / "scene.yaml"
        content = {key: value for key, value in {**TABLE_1, **changes}.items() if value is not None}
        path.write_text(json.dumps(content))
        return path

    return write


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Run the command in this process; returns the exit status and the output folder."""
    folder = tmp_path / "out"

    def job(*arguments: object) -> tuple[int, Path]:
        return main([*map(str, arguments), "--out", str(folder)]), folder

    return job


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of the reference job, run as the README says."""
    folder = tmp_path_factory.mktemp("reference") / "new" / "folder"
    process = subprocess.run([sys.executable, SCRIPT, "--out", folder], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    return folder


def report_of(folder: Path) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((folder / "report.json").read_text(), parse_constant=refuse)


def table_of(folder: Path) -> tuple[list[str], np.ndarray]:
    with (folder / "trajectory.csv").open(newline="") as stream:
        header, *rows = csv.reader(stream, strict=True)
    return header, np.array(rows, dtype=float)


def words(text: str) -> str:
    """Text with its line breaks taken out."""
    return " ".join(text.split())


# The finished job


def test_csv_rows(done: Path, robot: Robot) -> None:
    _, table = table_of(done)
    clock, rows = table[:, 0], table[:, 1:].reshape(len(table), 4, 4)
    position, velocity, acceleration, torque = np.moveaxis(rows, 2, 0)
    assert np.isfinite(table).all()
    assert clock[0] == 0.0
    assert (np.diff(clock) > 0.0).all()
    assert (position[0] == 0.0).all()
    np.testing.assert_allclose(position[-1], np.radians([0, 45, 60, 70]), rtol=0, atol=1e-12)
    np.testing.assert_allclose(velocity[[0, -1]], 0.0, rtol=0, atol=1e-9)
    assert (np.abs(velocity) <= robot.velocity_limit * 1.001).all()
    assert (np.abs(acceleration) <= robot.acceleration_limit * 1.001).all()
    data = robot.model.createData()
    for q, v, a, tau in zip(position[::20], velocity[::20], acceleration[::20], torque[::20], strict=True):
        np.testing.assert_allclose(pin.rnea(robot.model, data, q, v, a), tau, rtol=0, atol=1e-9)


def test_report_has_every_key_of_the_contract(done: Path) -> None:
    report = report_of(done)
    contract: dict[str, set[str]] = {
        "planner": {"method", "cost_deg", "points", "expansions"},
        "time_ms": {
            *("cspace", "layers", "sparse", "fallback", "postprocess", "timing", "certificate", "export", "total")
        },
        "path": {"length_deg_grid", "length_deg"},
        "trajectory": {"duration_s", "rate_hz", "samples"},
        "certificate": {"verified", "min_clearance_m", "limit_use"},
        "versions": {"hplan", "pin", "coal", "toppra", "numba", "numpy"},
    }
    assert {"status", "scene", "robot", *contract} <= set(report)
    for key, names in contract.items():
        assert names <= set(report[key]), key
    assert {"layers", "sparse", "fallback", "total"} <= set(report["planner"]["expansions"])
    assert set(report["certificate"]["limit_use"]) == {"position", "velocity", "acceleration", "torque"}


def test_report_of_the_reference_scene(done: Path) -> None:
    report = report_of(done)
    planner, path, times = report["planner"], report["path"], report["time_ms"]
    _, table = table_of(done)
    assert (report["status"], report["scene"], report["robot"]) == ("ok", "table-1", "harvester")
    assert planner["method"] == "two-level"
    assert planner["cost_deg"] == pytest.approx(145.214952, abs=1e-6)
    assert planner["points"] == 107
    expansions = planner["expansions"]
    assert expansions["total"] == expansions["layers"] + expansions["sparse"] + expansions["fallback"]
    assert expansions["layers"] > 0
    assert path["length_deg"] <= path["length_deg_grid"]
    assert report["trajectory"] == {"duration_s": table[-1, 0], "rate_hz": 250.0, "samples": len(table)}
    assert report["certificate"]["verified"] is True
    assert report["certificate"]["min_clearance_m"] > 0.0
    assert all(0.0 <= share <= 1.001 for share in report["certificate"]["limit_use"].values())
    assert sum(times.values()) - times["total"] <= times["total"] + 0.01


def test_two_runs_give_the_same_bytes(done: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    subprocess.run([sys.executable, SCRIPT, "--out", tmp_path, "--quiet"], env=environment, check=True)
    assert (tmp_path / "trajectory.csv").read_bytes() == (done / "trajectory.csv").read_bytes()


# The terminal


def test_summary_fits_80_columns(run: Run, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(Path(run()[1]).parent)
    capsys.readouterr()
    assert main(["--out", "out"]) == 0
    out, err = capsys.readouterr()
    lines = out.rstrip("\n").split("\n")
    assert max(map(len, lines)) <= 80
    labels = [line.split()[0] for line in lines if re.match(r"\S", line)]
    assert labels == [
        *("table-1", "search", "expanded", "flooded", "path", "motion", "limits", "clearance", "nearest"),
        *("certificate", "time", "files"),
    ]
    # Nothing was wrapped: only the stage times go on in a second and third line.
    assert [line.split()[0] for line in lines if line.startswith(" ") and line.strip()] == ["trees", "postprocess"]
    assert err == ""


# Options


@pytest.mark.parametrize(
    ("option", "value"), [*(("--step", "0"), ("--rate", "1e9"), ("--speed", "1.01"), ("--tracking-error", "nan"))]
)
def test_options_out_of_range(run: Run, option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, folder = run(f"{option}={value}")
    name = option.removeprefix("--").replace("-", "[-_]")
    assert status == 2
    assert re.search(rf"error \(OptionError\): (--)?{name}\w* = .*: expected ", capsys.readouterr().err)
    assert not folder.exists()


# Failures: one message, one status, one report and no trajectory


@pytest.fixture
def fails(
    run: Run, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[dict[str, Any], str]]:
    """Run a job that must fail; returns the error's facts and message.

    The folder has an earlier job's files. Unreadable input changes no file; a plan that fails leaves its report alone.
    """
    shown: list[hplan.HplanError] = []
    show = terminal.show_error
    monkeypatch.setattr(terminal, "show_error", lambda console, error: (shown.append(error), show(console, error)))

    # Errors of the input, before a job begins.
    of_reading = {"InputError", "OptionError", "RobotFamilyError", "RobotFileError", "SceneError"}

    def job(status: int, *arguments: object, of_plan: bool = False) -> tuple[dict[str, Any], str]:
        folder = Path(shutil.copytree(done, tmp_path / "out"))
        before = {path.name: path.read_bytes() for path in folder.iterdir()}
        assert set(before) == FILES
        capsys.readouterr()
        assert run(*arguments)[0] == status
        out, err = capsys.readouterr()
        assert out == ""
        error = json.loads(report_text(shown[-1].as_dict()))
        assert f"error ({error['kind']}): {error['message']}" in words(err)
        if error["kind"] in of_reading and not of_plan:
            assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
        else:
            assert {path.name for path in folder.iterdir()} == {"report.json"}
            report = report_of(folder)
            assert (report["status"], report["error"]) == ("failed", error)
            assert {"scene", "robot", "versions"} <= set(report)
        return error, words(err)

    return job


Fails = Callable[..., tuple[dict[str, Any], str]]
SceneFile = Callable[..., Path]


def test_no_path(fails: Fails, scene_file: SceneFile) -> None:
    error, message = fails(3, scene_file(obstacles=WALL))
    assert error["kind"] == "NoPathError"
    assert error["reached_cells"] > 0
    assert "no path exists on the grid" in message
    first = error["blockers"][0]
    assert first["obstacle"] in message
    assert first["link"] == "upper_arm"
    assert first["slices_deg"] == [0.0, 90.0]


def test_arm_too_weak_to_hold_itself(fails: Fails, tmp_path: Path) -> None:
    urdf, _ = write_robot(replace(HARVESTER, effort=(150.0, 20.0, 120.0, 30.0)), tmp_path / "weak.urdf")
    error, message = fails(4, "--robot", urdf)
    assert (error["kind"], error["joint"]) == ("TimingError", "shoulder")
    assert "'shoulder' needs 101" in message
    assert "limit is 20 N m" in message


def test_motion_that_cannot_be_certified(fails: Fails, scene_file: SceneFile) -> None:
    """A thin plate between the nodes of a coarse grid, which the motion hits."""
    out = math.radians(30)
    plate = {
        "name": "plate",
        "kind": "box",
        "center": [1.6 * math.cos(out), 0, 0.6 + 1.6 * math.sin(out)],
        "size": [1.4, 0.4, 0.002],
        "rpy_deg": [0, -30, 0],
    }
    path = scene_file(start={"joints_deg": [0, 0, 0, 0]}, goal={"joints_deg": [0, 72, 0, 0]}, obstacles=[plate])
    error, message = fails(5, path, "--step", 18)
    assert error["kind"] == "CertificationError"
    assert "cannot be verified collision-free" in message


def test_uncertified_plan_is_written_and_reported(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    status, folder = run("--tracking-error", 20, "--uncertified")
    report = report_of(folder)
    assert status == 0
    assert {path.name for path in folder.iterdir()} == FILES
    assert report["status"] == "ok"
    assert report["certificate"]["verified"] is False
    assert report["certificate"]["violations"]
    assert report["certificate"]["tracking_error_rad"] == pytest.approx(math.radians(20))
    assert "NOT VERIFIED" in capsys.readouterr().out


def ball(**changes: Any) -> list[dict[str, Any]]:
    return [{**TABLE_1["obstacles"][0], **changes}]


def fruit(*center: float) -> dict[str, Any]:
    return {"goal": {"fruit": "f"}, "fruits": [{"name": "f", "center": list(center), "radius": 0.04}]}


TRUNK = {"name": "trunk", "kind": "capsule", "from": [1.2, 0, 0], "to": [1.2, 0, 2.5], "radius": 0.06}


@pytest.mark.parametrize(
    ("status", "changes", "kind", "says"),
    [
        (2, {"obstacles": ball(colour="red")}, "SceneError", ["obstacles[0].colour", "unknown key"]),
        (2, {"start": {"joints_deg": [0, -1, 0, 0]}}, "JointLimitError", ["start", "'shoulder'", "[0, 1.5708]"]),
        (2, {"goal": {"joints_deg": [0, 45, 91, 70]}}, "JointLimitError", ["goal", "'elbow'"]),
        (2, {"goal": {"joints_deg": [0, 45, 60]}}, "InputError", ["goal", "expected 4 joint values", "got 3"]),
        (2, {"goal": {"joints_deg": [20, 45, 60, 70]}}, "InputError", ["'base_yaw' is locked"]),
        (2, {"locked_joints": ["knee"]}, "InputError", ["'knee'", "base_yaw, shoulder, elbow, wrist"]),
        (3, fruit(1.0, 0.0, 0.7), "UnreachableError", ["limit"]),
        (3, fruit(1.2, 0.0, 1.6) | {"obstacles": [TRUNK]}, "BlockedError", ["fruit 'f'", "'trunk'", "66 config"]),
    ],
)
def test_scenes_that_are_refused(
    fails: Fails, scene_file: SceneFile, status: int, changes: dict[str, Any], kind: str, says: list[str]
) -> None:
    # A task that does not fit the robot is seen by the plan.
    error, message = fails(status, scene_file(**changes), of_plan=kind == "InputError")
    assert error["kind"] == kind
    assert [word for word in says if word not in message] == []


@pytest.mark.parametrize("inside", ["", "below"])
def test_output_folder_that_is_a_file_is_refused(
    tmp_path: Path, inside: str, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert main(["--out", str(taken / inside)]) == 2
    assert "OutputError" in capsys.readouterr().err
    assert taken.read_text() == "mine"


@pytest.mark.parametrize("name", ["trajectory.csv", "scene.html", "report.json"])
def test_output_where_a_folder_has_a_files_name(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).mkdir()
    assert main(["--out", str(tmp_path)]) == 2
    assert f"{name}: it is a folder" in words(capsys.readouterr().err)
    assert {path.name for path in tmp_path.iterdir()} == {name, "report.json"}


# Other scenes and robots


def member(folder: Path, links: int, has_yaw: bool) -> Path:
    """Another arm of the family, 2 m long."""
    joints = links + has_yaw
    spec = replace(
        HARVESTER,
        name=f"arm_{links}_{has_yaw}",
        link_lengths=(2.0 / links,) * links,
        link_half_widths=(0.03,) * links,
        link_masses=(8.0 / links,) * links,
        lower=(-1.0,) * joints,
        upper=(1.0,) * joints,
        velocity=(1.0,) * joints,
        effort=(300.0,) * joints,
        acceleration=(3.0,) * joints,
        jerk=None,
        has_yaw=has_yaw,
    )
    return write_robot(spec, folder / f"{spec.name}.urdf")[0]


def test_grid_too_large_for_memory_is_reported(
    scene_file: SceneFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With nine links trees find a path, and a required grid is refused as too large."""
    scene = scene_file(
        start={"joints_rad": [0.1] * 9}, goal={"joints_rad": [0.2] * 9}, obstacles=None, locked_joints=None
    )
    arguments = [str(scene), "--robot", str(member(tmp_path, 9, False)), "--out", str(tmp_path / "out"), "--quiet"]
    assert main(arguments) == 0
    assert json.loads((tmp_path / "out" / "report.json").read_text())["certificate"]["verified"]
    assert main([*arguments, "--method", "dense"]) == 6
    assert "no grid of 8 deg or less has fewer than" in capsys.readouterr().err
