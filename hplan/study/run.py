"""A study carried out: designs handed to an executor, rows kept in a file, and what they say of the arms."""

from __future__ import annotations

import csv
import fcntl
import io
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from hplan.base.arguments import file_path, instance
from hplan.base.csv_file import CsvFile
from hplan.base.interrupts import uninterrupted
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.collision.reach import reach_ball
from hplan.errors import HplanError, OutputError, TourError, WorkersLostError
from hplan.planning.options import PlanOptions
from hplan.study.definition import Design, Study, load_study
from hplan.tour.pickable import pickable, within_reach
from hplan.tour.row import RowOptions, plan_row
from hplan.tour.tour import TourOptions, plan_tour


@dataclass(frozen=True)
class StudyRow:
    """What was measured of one design; the columns of a study's CSV.

    Attributes:
        reach_m: Radius of the ball that holds the arm at all configurations.
        picked: Fruit that can be picked, or that tours pick.
        motion_s: Duration of the tours; None where there are none.
        total_s: The same with driving and detaching; None where there is none.
        error: Why nothing is picked; empty where something is.
    """

    digest: str
    arm: str
    tree: str
    distance_m: float
    height_m: float
    turn_deg: float
    wood_yields_m: float
    yields_below_m: float
    fruit_yields_m: float
    measure: str
    reach_m: float
    fruits: int
    picked: int
    stops: int
    motion_s: float | None
    total_s: float | None
    cpu_s: float
    error: str = ""


@dataclass(frozen=True)
class Choice:
    """An arm at a place, over all trees and turns: what a designer chooses among.

    Attributes:
        rows: How many designs were measured.
        share: Share of all fruit that is picked.
        seconds_per_fruit: Of tours, driving and detaching included where they are known; None without.
        cpu_s: Processor time of a design, on average.
        is_best: True if no other picks as much or more at as little cost or less: the Pareto front.
    """

    arm: str
    distance_m: float
    height_m: float
    wood_yields_m: float
    fruit_yields_m: float
    reach_m: float
    rows: int
    share: float
    seconds_per_fruit: float | None
    cpu_s: float
    is_best: bool = False

    @property
    def cost(self) -> float:
        """What is to be small: seconds for each fruit, or the reach [m]."""
        return self.reach_m if self.seconds_per_fruit is None else self.seconds_per_fruit


@dataclass(frozen=True)
class StudyResult:
    """A study's rows, in the order of its designs.

    Attributes:
        name: What the study is called.
        rows: A row for each design.
        measured: How many of them were measured now; the others had been before.
        seconds: How long that took [s].
    """

    name: str
    rows: tuple[StudyRow, ...]
    measured: int
    seconds: float

    @property
    def choices(self) -> tuple[Choice, ...]:
        """Arms at places, in the order of the rows, those marked that no other beats (the Pareto front)."""
        groups: dict[tuple[Any, ...], list[StudyRow]] = {}
        for row in self.rows:
            place = row.distance_m, row.height_m, row.wood_yields_m, row.fruit_yields_m
            groups.setdefault((row.arm, *place, row.reach_m), []).append(row)
        found = [Choice(*key, *_summary(rows)) for key, rows in groups.items()]
        return tuple(replace(one, is_best=_is_best(one, found)) for one in found)


def run_study(
    study: Study | Path | str,
    rows: Path | str | None = None,
    *,
    executor: Pool | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> StudyResult:
    """Measure all designs of a study that its file of rows does not have yet.

    Each row is written when it comes, so that a study that is cut off goes on where it was. The designs of a worker
    that is lost are measured by another one.

    Args:
        study: The study, or its file.
        rows: CSV to keep the rows in, and to go on with; None to keep none.
        executor: What measures designs: any executor of `concurrent.futures`, as `dask.distributed.Client` gives one by
            `get_executor()`, or a function that makes one, which is called again when a worker's loss has broken it.
            None for processes of this machine.
        workers: How many designs are measured at once; None for one on each processor, or as many as the executor has.
            With 1 and no executor they are measured in this process. Others import the caller's main module: keep it
            behind `if __name__ == "__main__"`.
        progress: Called with how many rows are there, and of how many.

    Raises:
        StudyError: The study is not in order.
        InputError: A tree or robot cannot be read, or the file of rows holds something else.
        OutputError: A row cannot be written, or another study is writing them.
        WorkersLostError: Designs whose workers were lost again and again; all others have their rows.
    """
    study = load_study(study) if isinstance(study, Path | str) else instance("study", study, Study)
    kept_in = None if rows is None else file_path("rows", rows)
    pool, at_once = pool_of(executor, workers)
    begin = time.perf_counter()
    designs = {design.digest: design for design in study.designs()}
    with _row_file(kept_in) as (found, keep):
        kept = {row.digest: row for row in found if row.digest in designs}
        left = [design for digest, design in designs.items() if digest not in kept]
        progress(len(kept), len(designs))
        try:
            for _, row in outcomes(measure, left, pool, at_once):
                keep(row)
                kept[row.digest] = row
                progress(len(kept), len(designs))
        except WorkersLostError as error:
            error.add("the study goes on where it is called again with these rows")
            raise
    return StudyResult(study.name, tuple(map(kept.__getitem__, designs)), len(left), time.perf_counter() - begin)


def measure(design: Design) -> StudyRow:
    """The row of one design.

    Raises:
        InputError: A tree that cannot be read.
    """
    begin = time.thread_time()
    robot, scene = design.robot, design.scene
    row = partial(
        StudyRow, design.digest, design.arm, design.tree, design.distance, design.height, design.turn_deg,
        design.yields.wood, design.yields.below, design.yields.fruit, design.measure, float(reach_ball(robot)[3]),
        len(scene.fruits),
    )  # fmt: skip
    try:
        if design.measure == "reach":
            return row(len(pickable(robot, within_reach(robot, scene))), 1, None, None, time.thread_time() - begin)
        options = PlanOptions(effort=design.effort)
        if design.measure == "row":
            whole = plan_row(robot, scene, options, row=RowOptions(distance=design.distance))
            motion_s, total_s = (whole.report[key] for key in ("motion_s", "total_s"))
            return row(len(whole.picked), len(whole.stops), motion_s, total_s, time.thread_time() - begin)
        near = within_reach(robot, scene)
        tour = plan_tour(robot, near, options, tour=TourOptions(back=True))
    except TourError:
        return row(0, 1, 0.0, None, time.thread_time() - begin)
    except HplanError as error:
        return row(0, 1, None, None, time.thread_time() - begin, f"{error.kind}: {error.message}")
    return row(len(tour.order), 1, tour.duration, None, time.thread_time() - begin)


def _summary(rows: Sequence[StudyRow]) -> tuple[Any, ...]:
    """Number, share picked, seconds for each fruit, and processor time of rows."""
    picked = sum(row.picked for row in rows)
    times = [row.motion_s if row.total_s is None else row.total_s for row in rows]
    known = [seconds for seconds in times if seconds is not None]
    seconds = sum(known) / picked if picked and known else None
    share = picked / max(1, sum(row.fruits for row in rows))
    return len(rows), share, seconds, sum(row.cpu_s for row in rows) / len(rows)


def _is_best(one: Choice, others: Sequence[Choice]) -> bool:
    """Whether none of the others is better in share or cost and no worse in the other."""
    return one.share > 0.0 and not any(
        (other.share, -other.cost) != (one.share, -one.cost) and other.share >= one.share and other.cost <= one.cost
        for other in others
        if other.share > 0.0
    )


_COLUMNS = tuple(field.name for field in fields(StudyRow))


@contextmanager
def _row_file(path: Path | None) -> Iterator[tuple[list[StudyRow], Callable[[StudyRow], None]]]:
    """The rows that a file has, and what adds one to it, for good; nobody else adds any meanwhile."""
    if path is None:
        yield [], lambda _: None
        return
    with ExitStack() as stack:
        try:
            file = stack.enter_context(path.open("ab+"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _check_header(path, file)
            _cut_half_a_row(file)
            if not file.tell():
                _add(file, _COLUMNS)
        except BlockingIOError as error:
            raise OutputError(path, "another study is writing rows to it") from error
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from error

        def keep(row: StudyRow) -> None:
            try:
                _add(file, [_text(getattr(row, name)) for name in _COLUMNS])
            except OSError as error:
                raise OutputError(path, error.strerror or str(error)) from error

        yield _read(path), keep


def _check_header(path: Path, file: BinaryIO) -> None:
    """Leave a file of others as it is: only a file of rows, or the start of its header, is written to.

    Raises:
        InputError: Its first line is another one.
    """
    file.seek(0)
    header, line = f"{','.join(_COLUMNS)}\n".encode(), file.readline()
    if not header.startswith(line):
        raise CsvFile.read(path, "row", "row").fault(1, f"it has no rows of a study; expected {','.join(_COLUMNS)}")


def _cut_half_a_row(file: BinaryIO) -> None:
    """Leave out what follows the last end of a line: a row that was being written when the machine stopped."""
    file.seek(0)
    whole = file.read().rfind(b"\n") + 1
    file.truncate(whole)
    file.seek(whole)


def _add(file: BinaryIO, cells: Sequence[str]) -> None:
    """Add a row in one write, and see it on the disk."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    with uninterrupted():
        file.write(line.getvalue().encode())
        file.flush()
        os.fsync(file.fileno())


def _text(value: Any) -> str:
    return "" if value is None else " ".join(value.split()) if isinstance(value, str) else repr(value)


def _read(path: Path) -> list[StudyRow]:
    """The rows of a file."""
    file = CsvFile.read(path, "row", "row")
    if tuple(file.header) != _COLUMNS:
        raise file.fault(1, f"it has no rows of a study; expected {','.join(_COLUMNS)}")
    return [_row(file, line, cells) for line, cells in file.rows]


def _row(file: CsvFile, line: int, cells: Sequence[str]) -> StudyRow:
    kinds: dict[str, Callable[[str], Any]] = {"float": float, "int": int, "str": str}
    kinds["float | None"] = lambda text: float(text) if text else None
    try:
        values = [kinds[str(field.type)](cell) for field, cell in zip(fields(StudyRow), cells, strict=True)]
    except ValueError as error:
        raise file.fault(line, f"it is no row of a study: {error}") from error
    return StudyRow(*values)
