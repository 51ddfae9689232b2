"""A job's files are written together or not at all, on any terminal."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import pytest
from small_tree import TREE

import hplan
from hplan.apps.cli.job_folder import JobFolder
from hplan.apps.cli.main import main
from hplan.errors import OutputError
from hplan.scene.obstacles import PointCloud

ROOT = Path(__file__).parents[2]
FILES = {"trajectory.csv", "report.json", "scene.html"}
SCRIPTS = {
    "hplan": [sys.executable, "-m", "hplan.apps.cli"],
    "plan_and_time": [sys.executable, str(ROOT / "scripts" / "plan_and_time.py")],
    "plan_tour": [sys.executable, str(ROOT / "scripts" / "plan_tour.py")],
    "time_waypoints": [sys.executable, str(ROOT / "scripts" / "time_waypoints.py")],
}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished plan's folder."""
    path = tmp_path_factory.mktemp("done") / "out"
    assert main(["--effort", "quick", "--quiet", "--out", str(path)]) == 0
    return path


@pytest.fixture
def folder(tmp_path: Path) -> JobFolder:
    return JobFolder(Namespace(out=tmp_path / "out", force=False), ("*.csv", "page.html"), "report.json")


def fill(staging: Path, *more: str) -> None:
    for name in ("a.csv", "page.html", "report.json", *more):
        (staging / name).write_text('{"status": "ok"}')


def test_files_are_moved_with_trajectory_last(folder: JobFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    replace = Path.replace

    def noted(self: Path, target: Path) -> Path:
        order.append(target.name)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", noted)
    with folder.job("scene", "robot"), folder.stage_files() as staging:
        fill(staging, "b.csv")
        assert not any(name.endswith(".csv") for name in names(folder.path))
    assert order == ["page.html", "report.json", "a.csv", "b.csv"]
    assert names(folder.path) == set(order)


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), ZeroDivisionError(), OSError(errno.ENOSPC, "full", "x/a.csv")])
@pytest.mark.parametrize("moved", [0, 1, 2])
def test_fault_at_any_move_leaves_no_trajectory(
    folder: JobFolder, monkeypatch: pytest.MonkeyPatch, fault: BaseException, moved: int
) -> None:
    replace, left = Path.replace, [moved]

    def failing(self: Path, target: Path) -> Path:
        if target.suffix in (".csv", ".html") or target.name == "report.json":
            left[0] -= 1
            if left[0] < 0 and self.parent != target.parent:
                raise fault
        return replace(self, target)

    def job() -> None:
        with folder.job("scene", "robot"), folder.stage_files() as staging:
            fill(staging)

    job()
    monkeypatch.setattr(Path, "replace", failing)
    expected = OutputError if isinstance(fault, OSError) else type(fault)
    with pytest.raises(expected) as caught:
        job()
    is_fault = isinstance(caught.value, ZeroDivisionError)  # of hplan's own
    assert names(folder.path) == (set() if is_fault else {"report.json"})
    if isinstance(caught.value, KeyboardInterrupt):
        assert json.loads((folder.path / "report.json").read_text())["status"] == "interrupted"
    if isinstance(caught.value, OutputError):
        assert caught.value.path == folder.path / "a.csv"
        assert caught.value.reason == "full"


AT_THE_REPORT = """
import os, signal, sys, time
import hplan.planning.report
signal.signal({number}, signal.SIG_DFL)  # which it is not where the tests run under nohup
def end(*_):
    os.kill(os.getpid(), {number})
    time.sleep(60)
hplan.planning.report.write_report = end
sys.argv = sys.argv[1:]
import runpy
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_signal_between_trajectory_and_report_leaves_the_report_alone(done: Path, tmp_path: Path) -> None:
    """A hangup acts like an interrupt; the exit status is the shell's."""
    out = shutil.copytree(done, tmp_path / "out")
    code = AT_THE_REPORT.format(number=int(signal.SIGHUP))
    command = [sys.executable, "-c", code, SCRIPTS["plan_and_time"][1], "--effort", "quick", "--out", out]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (128 + signal.SIGHUP, "ended by SIGHUP\n")
    assert names(out) == {"report.json"}
    report = json.loads((out / "report.json").read_text())
    assert (report["status"], report["signal"]) == ("interrupted", "SIGHUP")


def test_signal_that_is_ignored_stays_so(tmp_path: Path) -> None:
    """As under nohup."""
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from hplan.apps.cli.terminal import run_command\n"
        "sys.exit(run_command(lambda *_: os.kill(os.getpid(), signal.SIGHUP) or 7))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 7


@pytest.mark.parametrize(
    "arguments",
    [
        ["--rate", "fast"],
        ["certfy"],
        ["missing.yaml"],
        ["broken.yaml"],
        ["--limits", "broken.yaml"],
        ["--step", "1e-308"],
        ["tour", "--every", "x"],
        ["tour", "--fruits", "no such"],
        ["time", "harvester", "missing.csv", "--scene", "table-1"],
        ["certify", "out", "--report", "out/report.json"],
        ["certify", "out", "--report", "out/trajectory.csv"],
        ["view", "out", "--no-serve", "--out", "out/trajectory.csv"],
        ["orchard", "--import", "broken.yaml"],
        ["view", "out/trajectory.csv", "--robot", "ur5", "--no-serve"],
        ["plan", "--out", ""],
        ["plan", "--robot", "harvester", "--package-dir", "missing"],
        ["tour", "--fruits", "no such", "--out", "new"],
        ["row", "tour", "--carried", "no such", "--out", "new"],
        ["study", "study.yaml", "--workers", "0", "--out", "new"],
        ["study", "study.yaml", "--workers", "1", "--out", "new"],
        ["batch", "missing.yaml", "--out", "new.csv"],
        ["batch", "table-1", "--jobs", "0", "--out", "new.csv"],
    ],
    ids=lambda words: " ".join(words)[:60],
)
def test_invalid_or_unreadable_input_changes_no_file(
    arguments: list[str], done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(done, "out")
    for name in ("out/tour.csv", "out/tour-01-apple.csv", "out/tour.json", "broken.yaml", "timed.csv", "orchard.yaml"):
        Path(name).write_text("{an earlier job's")
    far = "name: far\narms: [orchard_harvester]\ntrees: [tree.csv]\ndistances: [1200]\n"
    Path("study.yaml").write_text(far)
    Path("tree.csv").write_text(TREE)
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    try:
        status = main(arguments)
    except SystemExit as ended:
        status = ended.code
    assert status == 2
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize("later", ["report.json", "tour.json"])
def test_failed_job_takes_its_own_files_alone(later: str, done: Path, tmp_path: Path) -> None:
    """It removes an earlier plan's files, but keeps a tour's and the user's."""
    (tmp_path / "scene.yaml").write_text(SCENE.replace("1.0, 0.0, 1.9", "1.0, 0.0, 0.6"), encoding="utf-8")
    out = shutil.copytree(done, tmp_path / "out")
    for name in ("motion.mcap", "tour.csv", "tour-1-mine.csv", "scene.yaml", "a.csv"):
        (out / name).write_text("mine")
    (out / "tour.json").write_text('{"status": "ok"}')
    for name in ("report.json", "tour.json"):
        os.utime(out / name, (1e9 + (name == later), 1e9 + (name == later)))
    kept = names(out) - {"trajectory.csv", "report.json"}
    kept -= {"scene.html"} if later == "report.json" else set()
    for _ in range(2):
        assert main([str(tmp_path / "scene.yaml"), "--out", str(out)]) == 2
        assert names(out) == kept | {"report.json"}
        assert '"ConfigurationInCollisionError"' in (out / "report.json").read_text()


def test_cloud_that_the_scene_names_stays(tmp_path: Path) -> None:
    """It is in the job's folder, under a name that hplan itself writes."""
    scene = hplan.load_scene()
    cloud = PointCloud.from_points("cloud", [[0.9, 0.0, 2.5]], 0.01)
    hplan.save_scene(scene.model_copy(update={"obstacles": (cloud,)}), tmp_path / "scene.yaml")
    (ply,) = tmp_path.glob("*.ply")
    before = ply.read_bytes()
    (tmp_path / "scene.yaml").rename(tmp_path / "mine.yaml")
    names_q = ("base_yaw", "shoulder", "elbow", "wrist")
    (tmp_path / "way.csv").write_text(f"{','.join(names_q)}\n0,0.3,0.3,0.3\n0,0.4,0.3,0.3\n")
    words = ["time", "harvester", str(tmp_path / "way.csv"), "--out", str(tmp_path), "--effort", "quick", "--quiet"]
    assert main([*words, "--scene", str(tmp_path / "mine.yaml")]) == 0
    assert ply.read_bytes() == before
    assert hplan.load_scene(tmp_path / "scene.yaml").obstacles[0].kind == "points"


def test_files_follow_the_umask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hplan.planar.pages.yaw_section._STEP_DEG", 10.0)
    before = os.umask(0o027)
    try:
        words = ["--quiet", "--effort", "quick", "--mcap", "--cspace", "--out", str(tmp_path / "out")]
        assert main(words) == 0
        assert main(["certify", str(tmp_path / "out"), "--quiet", "--report", str(tmp_path / "r.json")]) == 0
    finally:
        os.umask(before)
    made = [*(tmp_path / "out").iterdir(), tmp_path / "r.json"]
    assert {path.stat().st_mode & 0o777 for path in made} == {0o640}
    assert {"motion.mcap", "cspace.html"} < {path.name for path in made}


# Terminals that cannot take it

SCENE = """
format: hplan-scene/1
name: "Äpfel \\u2603"
start: {joints_deg: [0, 0, 0, 0]}
goal: {joints_deg: [0, 45, 60, 70]}
obstacles:
  - {name: "Bäume \\u2603", kind: sphere, center: [1.0, 0.0, 1.9], radius: 0.15}
"""


def shell(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command line with `hplan` standing for the command, in a folder."""
    program = f"{sys.executable} -c 'from hplan.apps.cli.main import main; raise SystemExit(main())'"
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", f'hplan() {{ {program} "$@"; }}\n{command}'],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("hplan --effort quick > /dev/full", "cannot write to standard output: No space left on device\n"),
        ("hplan --effort quick | head -c 0", ""),
        ("hplan --effort quick <&- >&- 2>&-", ""),
    ],
)
def test_unencodable_output_changes_nothing(command: str, said: str, tmp_path: Path) -> None:
    done = shell(command, tmp_path)
    assert (done.returncode, done.stderr) == (0, said)
    assert names(tmp_path / "out") == FILES


@pytest.mark.parametrize("command", ["hplan --step x >&-", "hplan missing.yaml > /dev/full 2> /dev/full"])
def test_fault_is_reported_on_any_terminal(command: str, tmp_path: Path) -> None:
    assert shell(command, tmp_path).returncode == 2
    assert names(tmp_path) == set()


def test_name_that_the_terminal_cannot_show(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE, encoding="utf-8")
    done = shell("hplan --effort quick scene.yaml", tmp_path, LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert (done.returncode, done.stderr) == (0, "")
    assert names(tmp_path / "out") == FILES
    assert "u2603" in done.stdout
    inside = SCENE.replace("1.0, 0.0, 1.9", "1.0, 0.0, 0.6")
    (tmp_path / "scene.yaml").write_text(inside, encoding="utf-8")
    done = shell("hplan scene.yaml", tmp_path, PYTHONIOENCODING="ascii")
    assert done.returncode == 2
    assert "u2603" in done.stderr
    assert names(tmp_path / "out") == {"report.json"}


def test_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """The first files fit, the page does not."""
    assert main(["--out", str(tmp_path), "--quiet"]) == 0
    make: Callable[..., int] = os.open
    made: list[object] = []

    def full(path: object, flags: int, *mode: int, **options: object) -> int:
        if flags & os.O_EXCL:
            made.append(path)
            if len(made) == 2:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return make(path, flags, *mode, **options)

    monkeypatch.setattr(os, "open", full)
    assert main(["--out", str(tmp_path), "--quiet"]) == 2
    assert "scene.html: No space left on device" in capsys.readouterr().err.replace("\n", " ")
    assert names(tmp_path) == {"report.json"}


@pytest.mark.parametrize("name", ["hplan", "time_waypoints"])
def test_commands_run_nothing_of_the_working_directory(name: str, tmp_path: Path) -> None:
    """Except `python -m`, which searches there by default."""
    for module in ("yaml", "rich", "numpy"):
        (tmp_path / f"{module}.py").write_text("raise SystemExit('a module of the working directory was run')")
    command = [part if part != "-m" else "-Pm" for part in SCRIPTS[name]]
    done = subprocess.run([*command, "nothing.yaml", *(["w.csv"] if name == "time_waypoints" else [])],
        cwd=tmp_path, capture_output=True, text=True, check=False)  # fmt: skip
    assert "working directory was run" not in done.stderr
