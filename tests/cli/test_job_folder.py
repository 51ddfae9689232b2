"""A job's files stand together or not at all, and what the terminal cannot take changes nothing of that."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from hplan.cli.job_folder import JobFolder
from hplan.cli.main import main
from hplan.cli.terminal import run_command
from hplan.errors import HplanError, OutputError

ROOT = Path(__file__).parents[2]
FILES = {"trajectory.csv", "report.json", "scene.html"}
SCRIPTS = {
    "hplan": [sys.executable, "-m", "hplan.cli"],
    "plan_and_time": [sys.executable, str(ROOT / "scripts" / "plan_and_time.py")],
    "plan_tour": [sys.executable, str(ROOT / "scripts" / "plan_tour.py")],
    "time_waypoints": [sys.executable, str(ROOT / "scripts" / "time_waypoints.py")],
}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def folder(tmp_path: Path) -> JobFolder:
    return JobFolder(tmp_path / "out", ("*.csv", "page.html"), "report.json")


def fill(staging: Path, *more: str) -> None:
    for name in ("a.csv", "page.html", "report.json", *more):
        (staging / name).write_text(name)


def test_all_files_come_to_stand_the_trajectory_last(folder: JobFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    replace = Path.replace

    def noted(self: Path, target: Path) -> Path:
        order.append(target.name)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", noted)
    with folder.job(), folder.filling() as staging:
        fill(staging, "b.csv")
        assert not any(name.endswith(".csv") for name in names(folder.path))
    assert order == ["page.html", "report.json", "a.csv", "b.csv"]
    assert names(folder.path) == set(order)


@pytest.mark.parametrize("fault", [KeyboardInterrupt(), ZeroDivisionError(), OSError(errno.ENOSPC, "full", "x/a.csv")])
@pytest.mark.parametrize("moved", [0, 1, 2])
def test_a_fault_at_any_move_leaves_no_trajectory(
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
        with folder.job(), folder.filling() as staging:
            fill(staging)

    job()
    monkeypatch.setattr(Path, "replace", failing)
    expected = OutputError if isinstance(fault, OSError) else type(fault)
    with pytest.raises(expected) as caught:
        job()
    assert names(folder.path) == ({"report.json"} if isinstance(caught.value, HplanError) else set())
    if isinstance(caught.value, OutputError):
        assert caught.value.path == folder.path / "a.csv"
        assert caught.value.reason == "full"


def test_a_fault_of_writing_names_the_files_place(folder: JobFolder) -> None:
    def job() -> None:
        with folder.job(), folder.filling() as staging:
            raise OutputError(staging / "a.csv", "No space left on device")

    with pytest.raises(OutputError, match=r"out/a\.csv: No space left") as caught:
        job()
    assert caught.value.path == folder.path / "a.csv"


def test_what_a_killed_job_has_left_goes_with_the_next(folder: JobFolder) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    for number in (ended.pid, os.getppid()):
        (folder.path / f".hplan-job-{number}").mkdir(parents=True)
        (folder.path / f".hplan-job-{number}" / "a.csv").touch()
    with folder.job():
        assert names(folder.path) == {f".hplan-job-{os.getppid()}"}  # that one is still at work


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


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_a_signal_between_trajectory_and_report_leaves_nothing(number: signal.Signals, tmp_path: Path) -> None:
    """Both handled as an interrupt is; the exit status is what shells give."""
    assert main(["--out", str(tmp_path), "--quiet"]) == 0
    code = AT_THE_REPORT.format(number=int(number))
    script = SCRIPTS["plan_and_time"][1]
    done = subprocess.run(
        [sys.executable, "-c", code, script, "--out", tmp_path], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (128 + number, f"ended by {number.name}\n")
    assert names(tmp_path) == set()


def test_a_signal_that_is_ignored_stays_so(tmp_path: Path) -> None:
    """As under nohup."""
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from hplan.cli.terminal import run_command\n"
        "sys.exit(run_command(lambda *_: os.kill(os.getpid(), signal.SIGHUP) or 7))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 7


def test_signals_are_as_before_when_a_command_has_ended() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)]
    assert run_command(lambda *_: 3) == 3
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)] == before


@pytest.mark.parametrize(
    "arguments",
    [["--rate", "fast"], ["--method", "fastest"], ["--nothing"], ["a", "b"], ["--speed"]],
    ids=" ".join,
)
@pytest.mark.parametrize("how", [["--out", "{}"], ["--out={}"], ["--ou", "{}"]], ids=["--out x", "--out=x", "--ou x"])
def test_arguments_that_cannot_be_understood_leave_no_trajectory(
    arguments: list[str], how: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in FILES:
        (tmp_path / name).write_text("an earlier job's")
    with pytest.raises(SystemExit) as ended:
        main([*(part.format(tmp_path) for part in how), *arguments])
    assert ended.value.code == 2
    assert "usage:" in capsys.readouterr().err
    assert names(tmp_path) == {"report.json"}
    assert '"status": "failed"' in (tmp_path / "report.json").read_text()


def test_such_arguments_make_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (["--nothing"], ["--out", "new", "--nothing"], ["--o", "new", "--nothing"], ["--out"]):
        with pytest.raises(SystemExit):
            main(arguments)
    assert names(tmp_path) == set()


def test_help_leaves_an_earlier_job_alone(tmp_path: Path) -> None:
    (tmp_path / "trajectory.csv").write_text("an earlier job's")
    with pytest.raises(SystemExit) as ended:
        main(["--out", str(tmp_path), "--help"])
    assert not ended.value.code
    assert names(tmp_path) == {"trajectory.csv"}


def test_the_other_commands_leave_no_trajectory_either(tmp_path: Path) -> None:
    for name in ("tour.csv", "tour-01-apple.csv", "tour.json", "mine.csv", "timed.csv"):
        (tmp_path / name).write_text("an earlier job's")
    run = {"check": False, "stderr": subprocess.DEVNULL}
    assert subprocess.run([*SCRIPTS["plan_tour"], "--out", tmp_path, "--every", "x"], **run).returncode == 2
    assert names(tmp_path) == {"tour.json", "mine.csv", "timed.csv"}
    # A file that is read is not removed.
    for arguments in (["robot.urdf", "timed.csv", "--out", "timed.csv", "--rate", "x"], ["--out", "robot.urdf"]):
        assert subprocess.run([*SCRIPTS["time_waypoints"], *arguments], cwd=tmp_path, **run).returncode == 2
        assert names(tmp_path) == {"tour.json", "mine.csv", "timed.csv"}
    assert (
        subprocess.run([*SCRIPTS["time_waypoints"], "--out=timed.csv", "--rate=x"], cwd=tmp_path, **run).returncode == 2
    )
    assert names(tmp_path) == {"tour.json", "mine.csv"}


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
    program = f"{sys.executable} -c 'from hplan.cli.main import main; raise SystemExit(main())'"
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
        ("hplan", ""),
        ("hplan > /dev/full", "cannot write to standard output: No space left on device\n"),
        ("hplan | head -c 0", ""),
        ("hplan >&-", ""),
        ("hplan <&- >&- 2>&-", ""),
        ("hplan > /dev/full 2> /dev/full", ""),
        ("PYTHONUNBUFFERED=1 hplan > /dev/full", "cannot write to standard output: No space left on device\n"),
    ],
)
def test_what_the_terminal_cannot_take_changes_nothing(command: str, said: str, tmp_path: Path) -> None:
    done = shell(command, tmp_path)
    assert (done.returncode, done.stderr) == (0, said)
    assert names(tmp_path / "out") == FILES


@pytest.mark.parametrize("command", ["hplan --step x >&-", "hplan missing.yaml > /dev/full", "hplan missing.yaml 2>&-"])
def test_a_fault_is_one_whatever_the_terminal(command: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert shell(command, tmp_path).returncode == 2
    assert names(tmp_path / "out") == {"report.json"}


@pytest.mark.parametrize(
    "environment",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"PYTHONIOENCODING": "latin-1"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["ascii", "latin-1", "the C locale"],
)
def test_a_name_that_the_terminal_cannot_show(environment: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text(SCENE, encoding="utf-8")
    done = shell("hplan scene.yaml", tmp_path, **environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert names(tmp_path / "out") == FILES
    assert "u2603" in done.stdout
    inside = SCENE.replace("1.0, 0.0, 1.9", "1.0, 0.0, 0.6")
    (tmp_path / "scene.yaml").write_text(inside, encoding="utf-8")
    done = shell("hplan scene.yaml", tmp_path, **environment)
    assert done.returncode == 2
    assert "u2603" in done.stderr
    assert names(tmp_path / "out") == {"report.json"}


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """What is written at first fits, the page does not."""
    assert main(["--out", str(tmp_path), "--quiet"]) == 0
    fdopen: Callable[..., object] = os.fdopen
    opened: list[int] = []

    def full(handle: int, *more: object, **options: object) -> object:
        opened.append(handle)
        if len(opened) == 2:
            os.close(handle)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return fdopen(handle, *more, **options)

    monkeypatch.setattr(os, "fdopen", full)
    assert main(["--out", str(tmp_path), "--quiet"]) == 2
    assert "scene.html: No space left on device" in capsys.readouterr().err.replace("\n", " ")
    assert names(tmp_path) == {"report.json"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a small disk")
def test_a_disk_that_is_really_full(tmp_path: Path) -> None:
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", tmp_path], check=False).returncode != 0:
        pytest.skip("a small disk cannot be mounted here")
    try:
        done = shell("hplan --quiet --out .", tmp_path)
        assert done.returncode == 2
        assert "No space left on device" in done.stderr
        assert names(tmp_path) <= {"report.json"}
    finally:
        subprocess.run(["umount", tmp_path], check=True)


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_commands_run_nothing_of_the_working_directory(name: str, tmp_path: Path) -> None:
    """But for `python -m`, which looks there by itself unless told not to."""
    for module in ("yaml", "rich", "numpy"):
        (tmp_path / f"{module}.py").write_text("raise SystemExit('a module of the working directory was run')")
    command = [part if part != "-m" else "-Pm" for part in SCRIPTS[name]]
    done = subprocess.run([*command, "nothing.yaml", *(["w.csv"] if name == "time_waypoints" else [])],
        cwd=tmp_path, capture_output=True, text=True, check=False)  # fmt: skip
    assert "working directory was run" not in done.stderr
