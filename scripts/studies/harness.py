"""One harness for all studies: a study is a set of problems and a row of numbers for each, and the rest is here.

`run` hands out rows as they are made, in this process or on any executor of `concurrent.futures`; `summary` tells what
they say, `compare` what has changed from one run to another, problem by problem. What a row says of one problem is
named by its keys:

- `name`: the problem, the same in every run;
- `fault`: true where hplan is at fault, as a certified motion in contact is;
- texts are counted, truths too, and of numbers the median, the 95th percentile and the largest are told.
"""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from hplan.errors import InputError, OptionError
from hplan.planning.options import EffortName
from hplan.robot.model import Robot, load_robot

#: What is told of one problem.
Row: TypeAlias = dict[str, Any]

#: Groups of a summary that has all rows.
ALL = "all"

#: Studies whose kernels this process has loaded.
_WARM: set[str] = set()


@dataclass(frozen=True)
class Asked:
    """What a run of a study asks for.

    Attributes:
        count: How many problems, or of each group; None for as many as there are.
        first: Number of the first problem.
        seed: Of the problems, and of planners that draw.
        effort: What hplan spends on a motion.
        peer: Who solves the problems too, one of OMPL's planners or roboplan; None for nobody.
        robot: The arm, where a study takes any; None for its own.
        trees: Folder of measured trees, a CSV of capsules each.
        files: Folder of problems in files.
        values: Further numbers that a study names, such as `deadlines`.
    """

    count: int | None = None
    first: int = 0
    seed: int = 0
    effort: EffortName = "default"
    peer: str | None = None
    robot: Robot | None = None
    trees: Path | None = None
    files: Path | None = None
    values: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def arm(self, name: str = "harvester") -> Robot:
        """The robot asked for, else the one of a name."""
        return load_robot(name) if self.robot is None else self.robot

    @property
    def numbers(self) -> range:
        """Numbers of the problems, for studies that draw each by its number."""
        return range(self.first, self.first + (self.count or 0))


def numbered(asked: Asked) -> Iterable[Any]:
    """Problems that are no more than their numbers."""
    return asked.numbers


@dataclass(frozen=True)
class Study:
    """A set of problems and what is measured of each.

    Attributes:
        name: Its name on the command line, and of its file.
        about: What it tells, in a line.
        row: From what is asked for and a problem to its row, or its rows, or None where it does not count.
        columns: Keys of the rows that the summary tells, in order.
        totals: Keys of numbers, and of counts by kind, that it adds up over all rows.
        problems: The problems, given what is asked for.
        by: Key of the rows that groups them; empty for no groups.
        count: Problems where no number is asked for, None for all; and in a quick run.
        needs: What has to be given: `trees`, `files`, `robot`.
        peers: Who can solve its problems too.
        warm: So many problems are solved in each process before any counts, so that kernels are loaded.
    """

    name: str
    about: str
    row: Callable[[Asked, Any], Row | list[Row] | None]
    columns: tuple[str, ...]
    problems: Callable[[Asked], Iterable[Any]] = numbered
    by: str = ""
    totals: tuple[str, ...] = ()
    count: tuple[int | None, int] = (None, 3)
    needs: tuple[str, ...] = ()
    peers: tuple[str, ...] = ("RRTConnect", "BITstar")
    warm: int = 1


def run(
    study: Study, asked: Asked, *, executor: Executor | None = None, told: Callable[[int, int], None] = lambda *_: None
) -> Iterator[Row]:
    """Rows of a study, in the order of its problems, each as soon as it and those before it are there.

    Args:
        asked: How much of it, with what.
        executor: Where rows are made; None for here.
        told: Called with how many problems are done, and of how many.
    """
    missing = [name for name in study.needs if getattr(asked, name) is None]
    if missing:
        raise InputError(f"{study.name}: needs --{' and --'.join(missing)}", study=study.name, missing=missing)
    if asked.peer not in (None, *study.peers):
        raise OptionError("--peer", asked.peer, f"one of {', '.join(study.peers)} for {study.name}")
    problems = list(study.problems(asked))
    warm = problems[:: max(1, math.ceil(len(problems) / max(1, study.warm)))] if study.warm else []
    made = partial(_rows, study, asked, warm)
    told(0, len(problems))
    found = map(made, problems) if executor is None else executor.map(made, problems)
    for done, rows in enumerate(found, 1):
        yield from rows
        told(done, len(problems))


def _rows(study: Study, asked: Asked, warm: Sequence[Any], problem: Any) -> list[Row]:
    """The rows of one problem; the first call in a process solves others before."""
    if study.name not in _WARM:
        _WARM.add(study.name)
        for one in warm:
            study.row(asked, one)
    found = study.row(asked, problem)
    return [] if found is None else found if isinstance(found, list) else [found]


def evenly_chosen(problems: Sequence[Any], most: int | None, group: Callable[[Any], str]) -> list[Any]:
    """So many problems of each group at most, evenly spread over it."""
    kept: list[Any] = []
    for name in dict.fromkeys(map(group, problems)):
        ours = [problem for problem in problems if group(problem) == name]
        count = len(ours) if most is None else min(most, len(ours))
        kept += [ours[(2 * i + 1) * len(ours) // (2 * count)] for i in range(count)]
    return kept


def number(value: float, digits: int = 3) -> str:
    """A number as tables show it."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 10.0**digits else f"{value:.{digits}g}"


def told_of(values: Sequence[Any]) -> str:
    """What a cell says of values of one column, those that are not there left out."""
    kept = [value for value in values if value is not None]
    if not kept:
        return "-"
    if all(isinstance(value, bool) for value in kept):
        return f"{sum(kept)} of {len(kept)}"
    if any(isinstance(value, str) for value in kept):
        return ", ".join(f"{count} {value}" for value, count in Counter(map(str, kept)).most_common())
    if len(kept) == 1:
        return number(float(kept[0]), 4)
    return " / ".join(number(float(value), 4) for value in np.nanpercentile(kept, (50, 95, 100)))


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    lines = [f"| {' | '.join(heads)} |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


def summary(study: Study, rows: Sequence[Row]) -> list[str]:
    """Lines in Markdown: a table with a row for each group, and what is at fault by name."""
    groups = list(dict.fromkeys(str(row.get(study.by)) for row in rows)) if study.by else []
    chosen = {name: [row for row in rows if str(row.get(study.by)) == name] for name in groups} | {ALL: rows}
    kept = [key for key in study.columns if any(row.get(key) is not None for row in rows)]
    cells = [
        (name, str(len(some)), *(told_of([row.get(key) for row in some]) for key in kept))
        for name, some in chosen.items()
    ]
    faults = [str(row.get("name")) for row in rows if row.get("fault")]
    totals = [f"{key.replace('_', ' ')}: {_total([row[key] for row in rows])}." for key in study.totals if rows]
    return [
        f"### {study.name}: {study.about}",
        "",
        *table((study.by, "rows", *(key.replace("_", " ") for key in kept)), cells),
        "",
        " ".join(["Numbers: median / 95 % / largest.", *totals, f"At fault: {', '.join(faults) or 'none'}."]),
        "",
    ]


def _total(values: Sequence[Any]) -> str:
    """A sum of numbers, or of counts by kind."""
    if not isinstance(values[0], Mapping):
        return f"{sum(values):,}"
    counts = sum(map(Counter, values), Counter[str]())
    return ", ".join(f"{count:,} {kind}" for kind, count in counts.most_common()) or "none"


def compare(before: Sequence[Row], after: Sequence[Row], columns: Sequence[str]) -> list[str]:
    """Lines in Markdown: of the problems that both runs have, what has changed in each column.

    Of numbers the ratios after : before are told (of their sums, then median, 95 % and largest over problems), of
    truths and texts how many have become what.
    """
    old = {row["name"]: row for row in before}
    pairs = [(old[row["name"]], row) for row in after if row["name"] in old]
    lines = []
    for key in columns:
        both = [(a[key], b[key]) for a, b in pairs if a.get(key) is not None and b.get(key) is not None]
        if not both:
            continue
        if any(isinstance(value, bool | str) for value in itertools.chain.from_iterable(both)):
            changed = Counter(f"{a} -> {b}" for a, b in both if a != b)
            told = ", ".join(f"{count}: {change}" for change, count in changed.most_common()) or "no change"
            lines.append((key, str(len(both)), told, "", ""))
            continue
        a, b = np.array(both, dtype=np.float64).T
        good = np.isfinite(a) & np.isfinite(b) & (a > 0.0)
        ratio = (b[good] / a[good]).tolist()
        total = number(b[good].sum() / a[good].sum(), 4) if ratio else "-"
        more = f"{sum(one > 1.0 + 1e-9 for one in ratio)} more, {sum(one < 1.0 - 1e-9 for one in ratio)} less"
        lines.append((key, str(len(ratio)), total, told_of(ratio), more))
    heads = ("after : before", "pairs", "of sums", "median / 95 % / largest", "")
    return [
        f"{len(before)} rows before, {len(after)} after, {len(pairs)} of the same problems",
        "",
        *table(heads, lines),
    ]


def read_rows(file: Path) -> list[Row]:
    """Rows of a file that a run has written."""
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: no rows of a study: {error}", path=str(file)) from error
    return [line for line in lines if "name" in line]


def plain(value: Any) -> Any:
    """A value as JSON has it: numbers of NumPy as Python's, what is not finite as null."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
