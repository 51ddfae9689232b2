"""Measure hplan and other planners: all studies in one command, with comparisons.

Rows of numbers are written as they are computed, then tables. Peers, with --peer: OMPL's planners, toppra on their
paths, roboplan (extra bench), vamp-planner (from source code). Times are CPU times of a thread; compare ratios within
one run only. Without names all studies run that need no further input.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.options import add_shared, command_parser, robot_of
from hplan.apps.cli.terminal import FAILED, run_command
from hplan.base.files import prepare_folder
from hplan.errors import InputError, OptionError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.harness import Study, StudyConfig

#: Module of each study.
STUDIES = {
    "reference": "reference:REFERENCE",
    "cspace": "validation.cspace:CSPACE",
    "motions": "validation.motions:MOTIONS",
    "grazing": "validation.grazing:GRAZING",
    "held": "validation.held:HELD",
    "yielding": "validation.compliance:YIELDING",
    "soak": "validation.soak:SOAK",
    "trees": "trees:TREES",
    "tours": "trees:TOURS",
    "rows": "trees:ROWS",
    "fastest": "fastest:FASTEST",
    "deadlines": "fruit:DEADLINES",
    "camera": "camera:CAMERA",
    "motionbenchmaker": "motionbenchmaker:MOTIONBENCHMAKER",
    "random": "arms:RANDOM",
    "others": "others:OTHERS",
    "upright": "upright:STUDY",
    "franka": "franka:FRANKA",
    "retargets": "retargets:RETARGETS",
    "cells": "cells:CELLS",
    "cell_trees": "cell_trees:CELL_TREES",
    "wood_static": "wood:WOOD_STATIC",
    "wood_moving": "wood:WOOD_MOVING",
    "wood_picks": "wood:WOOD_PICKS",
    "wood_grasps": "wood_grasps:WOOD_GRASPS",
    "wood_trial": "wood_trial:WOOD_TRIAL",
}

#: Other planners that can solve the problems of a study.
PEERS = ("RRTConnect", "BITstar", "roboplan", "vamp")

_EPILOG = """\
writes into DIR: STUDY.jsonl, with options and environment in its first line and then one row per line; and
benchmark.md

exit status:
  0  done, and hplan was not found at fault
  2  bad input
  5  hplan was found at fault, for example with a certified motion in contact
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    words = list(sys.argv[1:] if argv is None else argv)
    lines = [f"  {name:16} {study_of(name).about}" for name in STUDIES] if {"-h", "--help"} & set(words) else []
    arguments = _parser("\n".join(["studies:", *lines, "", _EPILOG])).parse_args(words)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _parser(epilog: str) -> argparse.ArgumentParser:
    parser = command_parser(__doc__, epilog)
    add = parser.add_argument
    add("studies", nargs="*", metavar="STUDY", help="studies to run (default: all without required input)")
    add("--out", type=Path, metavar="DIR", help="folder to write into (default: a temporary one, named in the end)")
    add("--count", type=int, metavar="N", help="problems of each study, or of each of its groups")
    add("--quick", action="store_true", help="few problems, as a check")
    add("--first", type=int, default=0, metavar="N", help="number of the first problem drawn (default: 0)")
    add("--step", type=int, default=1, metavar="N", help="distance of the problems' numbers (default: 1)")
    add("--only", nargs="+", default=[], metavar="NAME", help="chosen robots, sets and kinds of problems of a study")
    add("--seed", type=int, default=0, metavar="N", help="seed of problems and planners (default: 0)")
    add("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    add("--effort", choices=("quick", "default", "best"), default="default", help="of hplan (default: default)")
    add(
        "--peer",
        nargs="?",
        const=PEERS[0],
        choices=PEERS,
        help=f"another planner for the problems (default: {PEERS[0]})",
    )
    add("--trees", type=Path, metavar="DIR", help="folder of measured trees, a CSV of capsules each")
    add("--files", type=Path, metavar="DIR", help="folder of a study's problems, such as VAMP's `resources`")
    add("--values", nargs="+", default=[], metavar="NAME=X,Y", help="numbers of a study, as deadlines=20,50 [ms]")
    add("--improve", action="store_true", help="fastest: store faster motions in the project's file")
    add("--compare", nargs=2, type=Path, metavar=("OLD", "NEW"), help="compare the rows of two folders, problem by "
        "problem, instead of measuring")  # fmt: skip
    add_shared(parser, "robot", "parts")
    return parser


def study_of(name: str) -> Study:
    """The study of a name."""
    if name not in STUDIES:
        raise OptionError("STUDY", name, f"one of {', '.join(STUDIES)}")
    module, attribute = STUDIES[name].split(":")
    study: Study = getattr(import_module(f"studies.{module}"), attribute)
    return study


def _value(text: str) -> tuple[str, tuple[float, ...]]:
    """A name and its numbers."""
    name, _, numbers = text.partition("=")
    try:
        return name, tuple(map(float, numbers.split(",")))
    except ValueError:
        raise OptionError("--values", text, "NAME=X,Y, a name and numbers") from None


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    for name, least in (("count", 1), ("first", 0), ("step", 1), ("seed", 0), ("jobs", 1)):
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise OptionError(f"--{name}", value, f"a whole number >= {least}")
    studies = [study_of(name) for name in arguments.studies or STUDIES]
    if arguments.compare:
        return _compare(arguments.compare, studies, console)
    from studies.harness import StudyConfig

    config = StudyConfig(
        first=arguments.first,
        step=arguments.step,
        seed=arguments.seed,
        effort=arguments.effort,
        peer=arguments.peer,
        robot=None if arguments.robot is None else robot_of(arguments),
        trees=arguments.trees,
        files=arguments.files,
        only=frozenset(arguments.only),
        values=dict(map(_value, arguments.values)),
    )
    if not arguments.studies:
        studies = [study for study in studies if not study.needs]
    arguments.out = arguments.out or Path(tempfile.mkdtemp(prefix="hplan-"))
    prepare_folder(arguments.out)
    if config.trees is not None and not any(config.trees.glob("*.csv")):
        raise InputError(f"--trees {config.trees}: the folder has no CSV", path=str(config.trees))
    faults, lines = 0, list[str]()
    for study in studies:
        count = arguments.count or study.count[arguments.quick]
        report, wrong = _measured(study, config, count, arguments, errors)
        lines, faults = lines + report, faults + wrong
        console.print("\n".join(report), markup=False, soft_wrap=True)
    (arguments.out / "benchmark.md").write_text("\n".join(lines), encoding="utf-8")
    console.print(f"written to {arguments.out}", markup=False, soft_wrap=True)
    return FAILED if faults else 0


def _measured(
    study: Study, config: StudyConfig, count: int | None, arguments: argparse.Namespace, errors: Console
) -> tuple[list[str], int]:
    """Run a study and write its rows; its report and fault count."""
    from dataclasses import replace

    from rich.progress import Progress
    from studies.fastest import improve
    from studies.harness import Row, plain, run, summary
    from studies.measure import environment

    config, rows = replace(config, count=count), list[Row]()
    options = {name: str(value) for name, value in vars(arguments).items() if value not in (None, [], False)}
    with (
        Progress(console=errors, transient=True, disable=not errors.is_terminal) as bars,
        _executor(arguments.jobs) as executor,
        (arguments.out / f"{study.name}.jsonl").open("w", encoding="utf-8") as file,
    ):
        bar = bars.add_task(study.name, total=None)
        head = {"study": study.name, "count": count, "options": options, "environment": environment()}
        file.write(json.dumps(plain(head)) + "\n")
        for row in run(
            study, config, executor=executor, report=lambda done, total: bars.update(bar, completed=done, total=total)
        ):
            rows.append(row)
            file.write(json.dumps(plain(row)) + "\n")
            file.flush()
    if study.name == "fastest" and arguments.improve:
        improve(rows)
    return summary(study, rows), sum(bool(row.get("fault")) for row in rows)


@contextlib.contextmanager
def _executor(jobs: int) -> Iterator[Executor | None]:
    """A pool of processes; None for a single one."""
    if jobs == 1:
        yield None
        return
    from multiprocessing import get_context

    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield pool


def _compare(folders: Sequence[Path], studies: Sequence[Study], console: Console) -> int:
    """Print the changes between two folders in each study that both have."""
    from studies.harness import compare, read_rows

    found = 0
    for study in studies:
        files = [folder / f"{study.name}.jsonl" for folder in folders]
        if not all(file.is_file() for file in files):
            continue
        found += 1
        lines = compare(*map(read_rows, files), study.columns)
        console.print("\n".join([f"### {study.name}", "", *lines, ""]), markup=False, soft_wrap=True)
    if not found:
        raise InputError(f"--compare: no study is in both {folders[0]} and {folders[1]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
