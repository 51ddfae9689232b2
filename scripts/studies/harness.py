"""The harness of all studies: problems, rows of numbers, summaries.

`run` yields rows as they are computed, in this process or on any executor of `concurrent.futures`; `summary` tabulates
them, `compare` lists changes between two runs, problem by problem. The keys of a row name its results for one problem:

- `name`: the problem, the same in every run;
- `fault`: True if hplan is at fault, for example with a certified motion in contact;
- texts and booleans are counted; for numbers the median, the 95th percentile and the maximum are reported. A list of
  numbers counts with each of them; two runs are compared by its median.
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

#: Results for one problem.
Row: TypeAlias = dict[str, Any]

#: Studies whose kernels this process has loaded.
_WARM: set[str] = set()


@dataclass(frozen=True)
class StudyConfig:
    """Settings of a study's run.

    Attributes:
        count: Number of problems, or of problems in each group; None for all.
        first: Number of the first problem.
        step: Distance of the numbers of the problems.
        seed: Random seed of the problems, and of sampling-based planners.
        effort: hplan's effort preset.
        peer: Another planner for the same problems: one of OMPL's planners, roboplan or vamp-planner; None for none.
        robot: The arm, if a study takes any; None for its own.
        trees: Folder of measured trees, a CSV of capsules each.
        files: Folder of problems in files.
        only: The chosen robots, sets or kinds of problems of a study; empty for all.
        values: Further numbers that a study names, such as `deadlines`.
    """

    count: int | None = None
    first: int = 0
    step: int = 1
    seed: int = 0
    effort: EffortName = "default"
    peer: str | None = None
    robot: Robot | None = None
    trees: Path | None = None
    files: Path | None = None
    only: frozenset[str] = frozenset()
    values: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def arm(self, name: str = "harvester") -> Robot:
        """The robot of the settings, otherwise the named one."""
        return load_robot(name) if self.robot is None else self.robot

    @property
    def numbers(self) -> range:
        """Numbers of the problems, for studies that draw each by its number."""
        return range(self.first, self.first + self.step * (self.count or 0), self.step)

    @property
    def tree_files(self) -> list[Path]:
        """Files of the chosen trees, by name; none without a folder."""
        files = sorted(self.trees.glob("*.csv") if self.trees is not None else ())
        return files[self.first :: self.step][: self.count]

    def chosen(self, names: Iterable[str]) -> tuple[str, ...]:
        """The chosen ones of some alternative names; all of them if none is chosen."""
        every = tuple(names)
        return tuple(name for name in every if name in self.only) or every


def numbered(config: StudyConfig) -> Iterable[Any]:
    """Problems given by their numbers alone."""
    return config.numbers


@dataclass(frozen=True)
class Study:
    """A set of problems and the measurements of each.

    Attributes:
        name: Its name on the command line, and of its file.
        about: Its subject, in a line.
        row: Maps the settings and a problem to its row, its rows, or None if it does not count.
        columns: Keys of the rows in the summary, in order.
        totals: Keys of numbers, and of counts by kind, that the summary adds up over all rows.
        problems: Maps the settings to the problems.
        by: Key of the rows that groups them, a name or several names of groups; empty for no groups.
        count: Default number of problems, None for all; and the number in a quick run.
        needs: Required settings: `trees`, `files`, `robot`.
        peers: Other planners that can solve its problems.
        warm: Number of problems that each process solves first without counting them, to load kernels.
        choices: Alternative names that can be chosen, for each property of a problem.
        percentiles: Percentiles of numbers in the summary.
    """

    name: str
    about: str
    row: Callable[[StudyConfig, Any], Row | list[Row] | None]
    columns: tuple[str, ...]
    problems: Callable[[StudyConfig], Iterable[Any]] = numbered
    by: str = ""
    totals: tuple[str, ...] = ()
    count: tuple[int | None, int] = (None, 3)
    needs: tuple[str, ...] = ()
    peers: tuple[str, ...] = ("RRTConnect", "BITstar")
    warm: int = 1
    choices: tuple[tuple[str, ...], ...] = ()
    percentiles: tuple[int, int, int] = (50, 95, 100)


def run(
    study: Study,
    config: StudyConfig,
    *,
    executor: Executor | None = None,
    report: Callable[[int, int], None] = lambda *_: None,
) -> Iterator[Row]:
    """Yield the rows of a study, in the order of its problems.

    Args:
        study: The study.
        config: Its settings.
        executor: Executor that computes the rows; None for this process.
        report: Called with the number of finished problems, and their total.
    """
    missing = [name for name in study.needs if getattr(config, name) is None]
    if missing:
        raise InputError(f"{study.name}: needs --{' and --'.join(missing)}", study=study.name, missing=missing)
    if config.peer not in (None, *study.peers):
        raise OptionError("--peer", config.peer, f"one of {', '.join(study.peers)} for {study.name}")
    names = list(itertools.chain.from_iterable(study.choices))
    if unknown := sorted(config.only.difference(names)):
        raise OptionError("--only", unknown[0], f"one of {', '.join(names) or 'none'} for {study.name}")
    problems = list(study.problems(config))
    warm = problems[:: max(1, math.ceil(len(problems) / max(1, study.warm)))] if study.warm else []
    report(0, len(problems))
    solve = partial(_rows, study, config, warm)
    for done, rows in enumerate(map(solve, problems) if executor is None else executor.map(solve, problems), 1):
        yield from rows
        report(done, len(problems))


def _rows(study: Study, config: StudyConfig, warm: Sequence[Any], problem: Any) -> list[Row]:
    """The rows of one problem; the first call in a process warms up."""
    if study.name not in _WARM:
        _WARM.add(study.name)
        for one in warm:
            study.row(config, one)
    found = study.row(config, problem)
    return [] if found is None else found if isinstance(found, list) else [found]


def evenly_chosen(problems: Sequence[Any], most: int | None, group: Callable[[Any], str]) -> list[Any]:
    """At most `most` problems of each group, evenly spread over it."""
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


def summarize(values: Sequence[Any], percentiles: Sequence[int] = (50, 95, 100)) -> str:
    """The summary of one column's values, without missing ones."""
    listed = itertools.chain.from_iterable(value if isinstance(value, list) else [value] for value in values)
    kept = [value for value in listed if value is not None]
    if not kept:
        return "-"
    if all(isinstance(value, bool) for value in kept):
        return f"{sum(kept)} of {len(kept)}"
    if any(isinstance(value, str) for value in kept):
        return ", ".join(f"{count} {value}" for value, count in Counter(map(str, kept)).most_common())
    if len(kept) == 1:
        return number(float(kept[0]), 4)
    return " / ".join(number(float(value), 4) for value in np.nanpercentile(kept, percentiles))


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    lines = [f"| {' | '.join(heads)} |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


def summary(study: Study, rows: Sequence[Row]) -> list[str]:
    """Markdown lines: a table with a row per group, and the faults."""
    chosen: dict[str, list[Row]] = {}
    for row in rows if study.by else ():
        group = row.get(study.by)
        for name in group if isinstance(group, list) else [group]:
            chosen.setdefault(str(name), []).append(row)
    chosen["all"] = list(rows)
    kept = [key for key in study.columns if any(row.get(key) is not None for row in rows)]
    cells = [
        (name, str(len(some)), *(summarize([row.get(key) for row in some], study.percentiles) for key in kept))
        for name, some in chosen.items()
    ]
    faults = [str(row.get("name")) for row in rows if row.get("fault")]
    totals = [f"{key.replace('_', ' ')}: {_total([row[key] for row in rows])}." for key in study.totals if rows]
    return [
        f"### {study.name}: {study.about}",
        "",
        *table((study.by, "rows", *(key.replace("_", " ") for key in kept)), cells),
        "",
        " ".join([f"Numbers: {_in_words(study.percentiles)}.", *totals, f"At fault: {', '.join(faults) or 'none'}."]),
        "",
    ]


def _in_words(percentiles: Sequence[int]) -> str:
    return " / ".join({50: "median", 100: "largest"}.get(each, f"{each} %") for each in percentiles)


def _total(values: Sequence[Any]) -> str:
    """A sum of numbers, or of counts by kind."""
    if not isinstance(values[0], Mapping):
        return f"{sum(values):,}"
    counts = sum(map(Counter, values), Counter[str]())
    return ", ".join(f"{count:,} {kind}" for kind, count in counts.most_common()) or "none"


def compare(before: Sequence[Row], after: Sequence[Row], columns: Sequence[str]) -> list[str]:
    """Markdown lines: changes in each column between two runs.

    Only problems of both runs count. For numbers the ratios after : before are reported (of their sums, then median, 95
    % and maximum over problems), for booleans and texts the number of each change.
    """
    old = {row["name"]: row for row in before}
    pairs = [(old[row["name"]], row) for row in after if row["name"] in old]
    lines = []
    for key in columns:
        both = [
            (_one(a[key]), _one(b[key]))
            for a, b in pairs
            if a.get(key) not in (None, []) and b.get(key) not in (None, [])
        ]
        if not both:
            continue
        if any(isinstance(value, bool | str) for value in itertools.chain.from_iterable(both)):
            changed = Counter(f"{a} -> {b}" for a, b in both if a != b)
            changes = ", ".join(f"{count}: {change}" for change, count in changed.most_common()) or "no change"
            lines.append((key, str(len(both)), changes, "", ""))
            continue
        a, b = np.array(both, dtype=np.float64).T
        good = np.isfinite(a) & np.isfinite(b) & (a > 0.0)
        ratio = (b[good] / a[good]).tolist()
        total = number(b[good].sum() / a[good].sum(), 4) if ratio else "-"
        more = f"{sum(one > 1.0 + 1e-9 for one in ratio)} more, {sum(one < 1.0 - 1e-9 for one in ratio)} less"
        lines.append((key, str(len(ratio)), total, summarize(ratio), more))
    first = f"{len(before)} rows before, {len(after)} after, {len(pairs)} of the same problems"
    return [first, "", *table(("after : before", "pairs", "of sums", "median / 95 % / largest", ""), lines)]


def _one(value: Any) -> Any:
    """A value of a row, or the median of a list; None for none."""
    return (float(np.median(value)) if value else None) if isinstance(value, list) else value


def read_rows(file: Path) -> list[Row]:
    """Read the rows of an earlier run."""
    try:
        lines = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: no rows of a study: {error}", path=str(file)) from error
    return [line for line in lines if "name" in line]


def plain(value: Any) -> Any:
    """A value for JSON: NumPy's numbers as Python's, null if not finite."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
