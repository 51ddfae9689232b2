"""Properties of every subcommand of `hplan`: help, version, terminals, signals, shipped scenes."""

from __future__ import annotations

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_tree import TREE
from toy_urdf import urdf

import hplan
from hplan.apps.cli.main import COMMANDS, main
from hplan.base.data_files import shipped_robots, shipped_scene, shipped_scenes
from hplan.errors import SceneError

ROOT = Path(__file__).parents[2]
SCRIPTS = {
    "plan": "plan_and_time.py",
    "tour": "plan_tour.py",
    "time": "time_waypoints.py",
    "certify": "certify.py",
    "execute": "execute.py",
    "orchard": "make_orchard.py",
}
HEAVY = ("numpy", "matplotlib", "meshcat", "numba", "pinocchio", "coal", "pydantic", "rich", "scipy", "toppra",
    "trimesh", "yaml", "yourdfpy")  # fmt: skip

#: Valid arguments of each command, in a folder with a job in `job`, and arguments that name a missing file.
GOOD = {
    "plan": ["plan", "--out", "new"],
    "tour": ["tour", "--out", "new", "--fruits", "fruit 01"],
    "row": ["row", "row.yaml", "--distance", "1.2", "--step", "1.1", "--one-side", "--effort", "quick", "--out", "new"],
    "batch": ["batch", "trellis", "--effort", "quick", "--out", "new.csv", "--jobs", "1"],
    "study": ["study", "study.yaml", "--out", "new", "--workers", "1"],
    "time": ["time", "toy.urdf", "way.csv", "--acceleration", "3"],
    "certify": ["certify", "job"],
    "execute": ["execute", "job/trajectory.csv"],
    "orchard": ["orchard", "--trees", "1", "--fruits", "3"],
    "view": ["view", "job", "--no-serve"],
    "completion": ["completion", "bash"],
}
MISSING = {
    "plan": ["plan", "missing.yaml"],
    "tour": ["tour", "missing.yaml"],
    "row": ["row", "missing.yaml"],
    "batch": ["batch", "missing.yaml"],
    "study": ["study", "missing.yaml"],
    "time": ["time", "missing.urdf", "missing.csv"],
    "certify": ["certify", "missing.csv"],
    "execute": ["execute", "missing.csv"],
    "orchard": ["orchard", "--import", "missing.csv"],
    "view": ["view", "missing.csv"],
}
#: The report of each command that leaves one after a signal.
REPORTS = {"plan": "report.json", "tour": "tour.json", "row": "row.json", "study": "study.json"}
#: Functions that do the work of each command.
INSIDE = {
    "plan": ("hplan.planning.plan", "plan"),
    "tour": ("hplan.tour.tour", "plan_tour"),
    "row": ("hplan.tour.row", "plan_row"),
    "study": ("hplan.study.run", "run_study"),
    "time": ("hplan.trajectory", "time_waypoints"),
    "certify": ("hplan.certificate.certificate", "certify"),
    "execute": ("hplan.apps.execution.simulation", "execute"),
    "orchard": ("hplan.scene.orchard", "generate"),
    "view": ("hplan.apps.view.page", "write_page"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that the commands of `GOOD` read."""
    path = tmp_path_factory.mktemp("commands")
    assert main(["plan", "--out", str(path / "job"), "--quiet"]) == 0
    (path / "toy.urdf").write_text(urdf())
    (path / "way.csv").write_text("a,b\n0,0\n0.5,0.4\n")
    (path / "tree.csv").write_text(TREE)
    orchard = ["orchard", "--import", str(path / "tree.csv"), "--distance", "1.2", "--robot", "orchard_harvester"]
    assert main([*orchard, "--yield", "0.02", "--out", str(path / "row.yaml"), "--quiet"]) == 0
    (path / "study.yaml").write_text("name: one\narms: [orchard_harvester]\ntrees: [tree.csv]\n")
    return path


# Help and version


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert not ended.value.code
    shown = capsys.readouterr().out
    assert [name for name in COMMANDS if not re.search(rf"^  {name} +\w", shown, re.MULTILINE)] == []
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert not ended.value.code
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: hplan {command} ")
    assert "exit status:" in shown or command == "completion"
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize("arguments", [["--version"], ["plan", "--version"]], ids=" ".join)
def test_version(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert not ended.value.code
    assert capsys.readouterr().out == f"hplan {hplan.__version__}\n"


@pytest.mark.parametrize("command", ["plan", "time"])
def test_scripts_go_by_their_own_names(command: str) -> None:
    program = [sys.executable, ROOT / "scripts" / SCRIPTS[command]]
    shown = subprocess.run([*program, "--help"], capture_output=True, text=True, check=True).stdout
    assert shown.startswith(f"usage: {SCRIPTS[command]} [-h] ")
    assert "--version" not in shown
    wrong = subprocess.run([*program, "--nothing"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert f"\n{SCRIPTS[command]}: error: " in wrong.stderr


@pytest.mark.parametrize("arguments", [[], *([command] for command in COMMANDS)], ids=lambda words: " ".join(words))
def test_help_loads_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys\nfrom hplan.apps.cli.main import COMMANDS, main\n"
        f"try: main([*{arguments}, '--help'])\n"
        f"except SystemExit: print([name for name in {HEAVY} if name in sys.modules])\n"
        f"print([name for name in COMMANDS if f'hplan.apps.cli.{{name}}' in sys.modules and [name] != {arguments}])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.splitlines()[-2:] == ["[]", "[]"]


# Terminals and signals


@pytest.mark.parametrize("command", [name for name in GOOD if name not in ("completion", "execute", "certify")])
def test_quiet(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(folder)
    assert main([*GOOD[command], "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("command", MISSING)
def test_something_missing_is_one_line(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(MISSING[command]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"error \(\w+\): .*missing.*\n", err.replace("\n", " ").rstrip() + "\n")


@pytest.mark.parametrize(
    ("command", "number"), [("plan", signal.SIGINT), *((command, signal.SIGTERM) for command in INSIDE)]
)
def test_signal_ends_a_command_and_leaves_its_report_alone(
    command: str,
    number: signal.Signals,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In this process; in one of its own in `test_job_folder`."""
    work = shutil.copytree(
        folder, tmp_path / "work", ignore=shutil.ignore_patterns("new", "timed.csv", "out", "orchard.yaml")
    )
    before = {path: path.read_bytes() for path in work.rglob("*") if path.is_file()}
    monkeypatch.chdir(work)
    monkeypatch.setattr(".".join(INSIDE[command]), lambda *_, **__: (signal.raise_signal(number), time.sleep(60)))
    # In the background, or under nohup, a process ignores them.
    kept = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        assert main(GOOD[command]) == 128 + number
    finally:
        for each, handler in kept.items():
            signal.signal(each, handler)
    assert capsys.readouterr() == ("", "interrupted\n" if number == signal.SIGINT else "ended by SIGTERM\n")
    after = {path: path.read_bytes() for path in work.rglob("*") if path.is_file()}
    report = work / "new" / REPORTS.get(command, "")
    if command in REPORTS:
        assert json.loads(after.pop(report))["status"] == "interrupted"
    assert after == before


# Scenes by name

#: Where each command that takes a scene has it.
WITH_SCENE = {
    "plan": ["plan"],
    "hplan": [],
    "tour": ["tour"],
    "certify": ["certify", "job/trajectory.csv"],
    "execute": ["execute", "job/trajectory.csv"],
    "view": ["view", "job/trajectory.csv"],
}


@pytest.mark.parametrize("command", WITH_SCENE)
def test_name_that_no_scene_has(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    assert main([*WITH_SCENE[command], "trelis"]) == 2
    shown = capsys.readouterr().err
    assert "scene file trelis: No such file or directory; scenes that ship with hplan: dense-canopy, " in shown
    assert [name for name in shipped_scenes() if name not in shown] == []


def test_name_that_no_robot_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "trellis", "--robot", "nosuch", "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    assert "robot file nosuch: No such file or directory; robots that ship with hplan: harvester, " in shown
    assert [name for name in shipped_robots() if name not in shown] == []
    assert main(["plan", "trellis", "--robot", "./no.urdf", "--out", str(tmp_path / "out")]) == 2
    assert "robots that ship" not in capsys.readouterr().err


def test_file_goes_before_a_shipped_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert hplan.load_scene("trellis").name == "trellis"
    Path("trellis").mkdir()
    assert hplan.load_scene("trellis").name == "trellis"
    Path("trellis").rmdir()
    Path("trellis").write_text(shipped_scene("tour").read_text())
    assert hplan.load_scene("trellis").name == "tour"


@pytest.mark.parametrize("name", ["./trellis", "trellis.yaml", Path("trellis"), Path("missing"), "no/trellis"])
def test_unknown_name_is_a_file(name: str | Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError, match=r"No such file or directory$"):
        hplan.load_scene(name)


# The shell completes


def completed(folder: Path, *words: str) -> list[str]:
    script = main_output("completion", "bash")
    line = f'COMP_WORDS=({" ".join(map(repr, words))}); COMP_CWORD={len(words) - 1}; _hplan; echo "${{COMPREPLY[@]}}"'
    done = subprocess.run(["bash", "-c", script + line], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


def main_output(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "hplan.apps.cli", *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["t"], ["table-1", "tour", "trellis", "tour", "time"]),
        (["--me"], ["--method"]),
        (["plan", "--method", ""], ["two-level", "dense"]),
        (["completion", ""], ["bash"]),
        (["view", "job/"], []),
    ],
)
def test_bash_completes(words: list[str], found: list[str], tmp_path: Path) -> None:
    assert sorted(completed(tmp_path, "hplan", *words)) == sorted(found)


def test_unknown_option_names_the_most_similar_one(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["plan", "--standof", "0.1", "--efort=quick", "--zzz"])
    assert caught.value.code == 2
    printed = capsys.readouterr().err
    assert "did you mean --effort for --efort?" in printed
    assert "for --zzz" not in printed


def test_place_of_a_positional_argument_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["plan", "--scene", "orchard-row"])
    assert caught.value.code == 2
    assert "scene is given without --scene" in capsys.readouterr().err
