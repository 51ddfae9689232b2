"""Measure what deadlines leave: answers in time, when they come back, and how quick their motions are."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from studies.benchmark.study_command import add_rows, tell

from hplan.cli.options import command_parser
from hplan.cli.terminal import run_command

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.robot.model import Robot
    from hplan.scene.model import Scene

_DESCRIPTION = """\
Plan to all fruit of the shipped scenes, to the fruit on measured trees and between it, without a deadline and with
some, and compare.
"""

_EPILOG = """\
The clock is that of the wall, or the CPU time of the thread, on which deadlines are counted then, too: for a machine
that others use. Kernels are loaded before anything is measured.

exit status:
  0  done
  2  bad input
  5  a motion that was handed out is not certified
"""

#: Robots whose scenes there are.
ROBOTS = ("harvester", "orchard_harvester")

#: What is planned.
GROUPS = ("fruit", "tree-fruit", "tree-motions")

#: Problems of each group that are planned before the clock runs.
WARM = 8


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add = parser.add_argument
    add("--robot", choices=ROBOTS, default=ROBOTS[0], help="default: harvester")
    add("--group", choices=GROUPS, default=GROUPS[0], help="default: fruit")
    add("--trees", type=Path, metavar="DIR", help="folder of measured trees, a CSV of capsules each")
    add("--deadlines", type=float, nargs="+", default=[20.0, 50.0, 100.0], metavar="MS", help="default: 20 50 100")
    add("--part", type=int, nargs=2, default=(1, 1), metavar=("K", "N"), help="the K-th of N parts of the problems")
    add("--cpu", action="store_true", help="CPU time instead of the wall's")
    add_rows(parser)
    arguments = parser.parse_args(argv)

    def command(console: Console, _: Console) -> int:
        rows = measure(arguments)
        tell(console, summary(rows, arguments.deadlines), rows, arguments.out)
        return 5 if any(run["found"] and not run["certified"] for row in rows for run in row["runs"].values()) else 0

    return run_command(command)


def problems(robot: Robot, group: str, trees: Path | None) -> list[tuple[str, Scene]]:
    """What is planned: names and scenes.

    Raises:
        InputError: A file that is not in order, or no folder of trees where one is needed.
    """
    from studies.benchmark.orchard_scenes import crop_of, measured_orchards

    from hplan.base.data_files import scenes_dir
    from hplan.errors import InputError
    from hplan.scene.file import load_scene
    from hplan.scene.model import Goal

    def to_fruit(name: str, scene: Scene) -> list[tuple[str, Scene]]:
        goals = [(f"{name}: {fruit.name}", Goal(fruit=fruit.name)) for fruit in scene.fruits]
        return [(title, scene.model_copy(update={"goal": goal})) for title, goal in goals]

    if group == "fruit":
        scenes = [load_scene(path) for path in sorted(scenes_dir().glob("*.yaml"))]
        ours = [scene for scene in scenes if (scene.robot or ROBOTS[0]) == robot.name]
        return [problem for scene in ours for problem in to_fruit(scene.name, scene)]
    if trees is None:
        raise InputError("--trees: expected a folder of measured trees", trees=None)
    orchards = measured_orchards(robot, trees)
    if group == "tree-fruit":
        return [problem for orchard in orchards for problem in to_fruit(orchard.name, orchard.scene)]
    return [(problem.name, problem.scene) for orchard in orchards for problem in crop_of(robot, orchard).problems()]


def measure(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each problem: what comes of it without a deadline, and with each."""
    from hplan.robot.model import load_robot

    robot = load_robot(arguments.robot)
    part, parts = arguments.part
    chosen = problems(robot, arguments.group, arguments.trees)[part - 1 :: parts]
    with _clock(cpu=arguments.cpu) as clock:
        for _, scene in chosen[:: max(1, len(chosen) // WARM)]:
            for deadline_ms in (None, *arguments.deadlines):
                _run(robot, scene, deadline_ms, clock)
        rows = []
        for name, scene in chosen:
            runs = {"none": _run(robot, scene, None, clock)}
            runs |= {f"{ms:g}": _run(robot, scene, ms, clock) for ms in arguments.deadlines}
            rows.append({"name": name, "runs": runs})
    return rows


@contextmanager
def _clock(*, cpu: bool) -> Iterator[Callable[[], float]]:
    """The clock that is measured by, and that deadlines are counted on [s]."""
    from hplan.base import deadline

    before = deadline.CLOCK
    deadline.CLOCK = time.CLOCK_THREAD_CPUTIME_ID if cpu else time.CLOCK_MONOTONIC
    try:
        yield deadline.clock_s
    finally:
        deadline.CLOCK = before


def _run(robot: Robot, scene: Scene, deadline_ms: float | None, clock: Callable[[], float]) -> dict[str, Any]:
    """One plan as numbers."""
    from hplan.errors import HplanError
    from hplan.planning.plan import plan
    from hplan.problem.options import PlanOptions

    options = PlanOptions(deadline_s=None if deadline_ms is None else 1e-3 * deadline_ms)
    begin = clock()
    try:
        found = plan(robot, scene, options)
    except HplanError as error:
        return {"ms": 1e3 * (clock() - begin), "found": False, "error": error.kind}
    ms = 1e3 * (clock() - begin)
    return {
        "ms": ms,
        "found": True,
        "certified": found.certificate.verified,
        "duration_s": found.trajectory.duration,
        "origin": found.motion.origin,
        **({} if deadline_ms is None else {"first_ms": 1e3 * found.report["deadline"]["first_s"]}),
    }


def summary(rows: Sequence[dict[str, Any]], deadlines: Sequence[float]) -> Iterator[str]:
    """The rows in a few lines."""
    from studies.benchmark.measure import median, spread

    has = [row for row in rows if row["runs"]["none"]["found"]]
    refused = [row["runs"]["none"] for row in rows if not row["runs"]["none"]["found"]]
    times = _words(spread([row["runs"]["none"]["ms"] for row in has]))
    yield f"{len(rows)} problems; {len(has)} have a motion: {times}"
    kinds = dict(Counter(run["error"] for run in refused))
    yield f"{len(refused)} are refused {kinds}: {_words(spread([run['ms'] for run in refused]))}"
    for ms in deadlines:
        runs = [row["runs"][f"{ms:g}"] for row in rows]
        found = [row for row in has if row["runs"][f"{ms:g}"]["found"]]
        ratio = [row["runs"][f"{ms:g}"]["duration_s"] / row["runs"]["none"]["duration_s"] for row in found]
        first = [row["runs"][f"{ms:g}"]["first_ms"] for row in found]
        late = sum(run["ms"] > 1.1 * ms for run in runs)
        yield (
            f"{ms:g} ms: {len(found)} of {len(has)} ({len(found) / max(1, len(has)):.1%}) have a certified motion, the "
            f"first after {median(first):.1f} ms in the median; return {_words(spread([run['ms'] for run in runs]))}, "
            f"{late} of {len(runs)} later than {1.1 * ms:g} ms; duration to that without a deadline "
            f"{_words(spread(ratio), digits=3)}"
        )


def _words(numbers: dict[str, float], digits: int = 1) -> str:
    """Median, percentiles and maximum."""
    return " / ".join(f"{value:.{digits}f}" for value in numbers.values()) + " (median / 95 % / 99 % / max)"


if __name__ == "__main__":
    sys.exit(main())
