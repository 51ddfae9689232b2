"""Commands that a signal ends at a random instant: the report must be there, and every file of others unchanged.

Each command runs in a folder of its own, every other time with an earlier job's files in it, and always with files
that hplan did not write. A fault is a crash, a traceback, a process that stays, a changed file of others, a part of a
file, or an interrupted job without its report.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from studies.harness import Asked, Row, Study

from hplan.apps.cli.own_files import is_own, recorded_digests
from hplan.base.child_process import import_environment, python_module

#: Each command, and the report that a job leaves in the folder `out`; without one the single file that it writes.
COMMANDS: dict[str, tuple[str, str]] = {
    "plan": ("plan --effort quick --out out", "report.json"),
    "plan, mcap and cspace": ("plan --effort quick --mcap --cspace --out out", "report.json"),
    "tour": ("tour --csv each --out out", "tour.json"),
    "row": ("row row.yaml --distance 1.2 --step 1.1 --one-side --effort quick --workers 2 --out out", "row.json"),
    "study": ("study study.yaml --workers 2 --out out", "study.json"),
    "cell": ("plan cell.yaml --effort quick --out out", "report.json"),
    "cell, tour": ("tour cell.yaml --mcap --out out", "tour.json"),
    "cell, certify": ("certify cell cell.yaml --report out/certificate.json", "certificate.json"),
    "time, scene": ("time harvester way.csv --scene table-1 --effort quick --out out", "report.json"),
    "time": ("time harvester way.csv --out out/timed.csv", "timed.csv"),
    "certify": ("certify job --report out/certificate.json", "certificate.json"),
    "execute": ("execute job/trajectory.csv", ""),
    "orchard": ("orchard --trees 2 --out out/orchard.yaml", "orchard.yaml"),
    "view": ("view job --no-serve --out out/page.html", "page.html"),
    "warmup": ("warmup", ""),
}

#: Commands that are not run to their end, and the time within which they are interrupted [s].
_LONG = {"warmup": 30.0}

#: Reports of jobs that write several files.
_REPORTS = ("report.json", "tour.json", "row.json", "study.json")

#: A process that has not ended this long after the signal stays [s].
_STAYS_S = 90.0

_CELL = """\
format: hplan-scene/1
name: two
robots:
- name: left
  start: {joints_deg: [-40, 60, 60, 60]}
  goal: {joints_deg: [40, 60, 60, 60]}
- name: right
  position: [3, 0, 0]
  rpy_deg: [0, 0, 180]
  start: {joints_deg: [0, 90, 90, 90]}
  goal: {joints_deg: [20, 80, 90, 90]}
obstacles:
- {name: post, kind: sphere, center: [0.0, -1.5, 1.2], radius: 0.1}
fruits:
- {name: apple, center: [1.2, 1.45, 1.2], radius: 0.035}
- {name: pear, center: [1.8, -1.45, 1.2], radius: 0.035}
"""

_TREE = """\
kind,x1,y1,z1,x2,y2,z2,radius
trunk,0,0,0,0,0,1.9,0.03
branch,0,0,0.8,-0.1,0.5,1.1,0.012
branch,0,0,1.2,0.1,-0.5,1.5,0.010
shoot,-0.1,0.5,1.1,-0.3,0.6,1.2,0.004
fruit,-0.12,0.5,1.0,-0.12,0.5,1.0,0.035
fruit,-0.31,0.62,1.14,-0.31,0.62,1.14,0.035
fruit,0.1,-0.5,1.4,0.1,-0.5,1.4,0.035
"""


@dataclass(frozen=True)
class _Prepared:
    """A folder with the files that commands read, folders that each has filled, and the time that each takes [s]."""

    inputs: Path
    done: dict[str, Path]
    seconds: dict[str, float]


def _hplan(words: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*python_module("hplan.apps.cli"), *words.split()],
        cwd=folder, env=import_environment(), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


@cache
def _prepared() -> _Prepared:
    """Run every command once, all but the long ones to their ends."""
    root = Path(tempfile.mkdtemp(prefix="hplan-interrupts-"))
    inputs = root / "inputs"
    inputs.mkdir()
    (inputs / "way.csv").write_text("base_yaw,shoulder,elbow,wrist\n0,0.3,0.3,0.3\n0,0.4,0.3,0.5\n", "utf-8")
    (inputs / "cell.yaml").write_text(_CELL, "utf-8")
    (inputs / "tree.csv").write_text(_TREE, "utf-8")
    (inputs / "study.yaml").write_text(
        "name: one\narms: [orchard_harvester, harvester]\ntrees: [tree.csv]\ndistances: [1.2, 1.4]\n", "utf-8"
    )
    orchard = "orchard --import tree.csv --distance 1.2 --robot orchard_harvester --yield 0.02 --out row.yaml --quiet"
    jobs = [
        f"plan {scene} --effort quick --out {folder} --quiet" for scene, folder in (("", "job"), ("cell.yaml", "cell"))
    ]
    for words in (*jobs, orchard):
        _wait(_hplan(words, inputs), words)
    done, seconds = dict[str, Path](), dict[str, float]()
    for number, (command, (words, _)) in enumerate(COMMANDS.items()):
        done[command] = shutil.copytree(inputs, root / str(number))
        (done[command] / "out").mkdir()
        begin = time.perf_counter()
        if command not in _LONG:
            _wait(_hplan(words, done[command]), words)
        seconds[command] = _LONG.get(command, time.perf_counter() - begin)
    return _Prepared(inputs, done, seconds)


def _wait(process: subprocess.Popen[str], words: str) -> None:
    _, said = process.communicate()
    if process.returncode not in (0, 5):
        raise RuntimeError(f"hplan {words}: exit status {process.returncode}: {said}")


def _contents(folder: Path) -> dict[str, str]:
    """The SHA-256 of every file in a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def interrupt(command: str, seed: int) -> Row:
    """Run a command, end it by a signal at a random instant, and compare its folder with the one before."""
    prepared, rng = _prepared(), random.Random(seed)
    words, result = COMMANDS[command]
    number = rng.choice((signal.SIGINT, signal.SIGINT, signal.SIGTERM))
    delay_s, is_repeated = rng.uniform(0.02, 1.1 * prepared.seconds[command]), rng.random() < 0.5
    with tempfile.TemporaryDirectory(prefix="hplan-interrupt-") as name:
        folder = Path(name, "work")
        shutil.copytree(prepared.done[command] if is_repeated else prepared.inputs, folder)
        out = folder / "out"
        out.mkdir(exist_ok=True)
        theirs = ["notes.txt", "tour-99-mine.csv", "stop-99.csv", "trajectory-mine.csv"]
        theirs += [] if "--mcap" in words else ["motion.mcap"]
        for other in theirs:
            (out / other).write_text("written by hand\n", "utf-8")
        before = _contents(folder)
        theirs = [name for name in before if not name.startswith("out/") or name.removeprefix("out/") in theirs]
        process = _hplan(words, folder)
        time.sleep(delay_s)
        sent = time.perf_counter()
        # Ctrl-C reaches every process of the terminal, `kill` one.
        (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        try:
            _, said = process.communicate(timeout=_STAYS_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            _, said = process.communicate()
            said += "STAYS"
        ended_s, status = time.perf_counter() - sent, process.returncode
        faults = _faults(folder, before, theirs, result, status, number, said)
        ended = "done" if status in (0, 5) else "before hplan" if status == -number else "interrupted"
        if ended == "interrupted" and _contents(folder) == before:
            ended = "before the job"  # the command did not know its folder yet
        report = _read(out / result)
        state = str(report.get("status", "none" if result in _REPORTS else "-"))
        return {
            "name": f"{command} {seed}", "command": command, "signal": number.name, "at_s": delay_s,
            "ended": ended, "report": state, "ends_s": ended_s, "fault": bool(faults), "why": "; ".join(faults),
            "status": status, "said": said[-2000:] if faults else "",
        }  # fmt: skip


def _read(path: Path) -> dict[str, object]:
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _faults(
    folder: Path, before: dict[str, str], theirs: list[str], result: str, status: int, number: signal.Signals, said: str
) -> list[str]:
    """Faults of the folder's contents and of the process's exit."""
    out, after = folder / "out", _contents(folder)
    faults = []
    early = status == -number  # Python itself was not ready
    if status not in (0, 5, 128 + number, -number):
        faults.append(f"exit status {status}")
    if "STAYS" in said:
        faults.append("the process stays")
    if not early and ("Traceback" in said or "Exception ignored" in said):
        faults.append("a traceback")
    faults += [f"changed or lost: {name}" for name in theirs if after.get(name) != before[name]]
    faults += [f"left behind: {name}" for name in after if "/.hplan-" in name]
    faults += [f"left behind: {path.name}" for path in out.glob(".hplan-*")]
    report = _read(out / result)
    if result in _REPORTS:
        if status == 128 + number and before != after and report.get("status") not in ("interrupted", "ok"):
            faults.append("files changed, and no report")
        if report.get("status") == "ok":
            broken = [name for name, digest in recorded_digests(out).items() if after.get(f"out/{name}") != digest]
            faults += [f"not what the report says: {name}" for name in broken]
        if report.get("status") == "interrupted" and (out / "trajectory.csv").exists():
            faults.append("a trajectory beside the report of an interrupted job")
    elif result and (out / result).exists() and not is_own(out / result):
        faults.append(f"part of a file: {result}")

    return faults


def _row(asked: Asked, number: int) -> Row:
    commands = list(COMMANDS)
    return interrupt(commands[number % len(commands)], 1000 * asked.seed + number)


INTERRUPTS = Study(
    "interrupts",
    "commands that Ctrl-C or a termination signal ends at a random instant",
    _row,
    ("ended", "report", "signal", "ends_s", "why"),
    by="command",
    count=(200, 12),
    warm=0,
)
