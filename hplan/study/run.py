"""Execution of a study on an executor; result rows and Pareto front."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from hplan.base.arguments import file_path, instance
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.collision.reach import workspace_ball
from hplan.errors import HplanError, TourError, WorkersLostError
from hplan.planning.options import PlanOptions
from hplan.study.definition import Design, Study, load_study
from hplan.study.row_file import open_rows
from hplan.tour.row import RowOptions, pickable, plan_row, within_reach
from hplan.tour.tour import TourOptions, plan_tour


@dataclass(frozen=True)
class StudyRow:
    """Measurements of one design; the columns of a study's CSV.

    Attributes:
        reach_m: Radius of a ball that contains the arm in all configurations [m].
        fruits: Number of fruits.
        picked: Number of pickable fruits, or of fruits picked on tours.
        stops: Number of stops of the base.
        motion_s: Duration of the tours [s]; None without tours.
        total_s: Duration including driving and detaching [s]; None without tours along the row.
        cpu_s: Processor time of the measurement [s].
        error: Reason if the measurement failed; else empty.
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
    """An arm at a base position, aggregated over all trees and rotations.

    Attributes:
        rows: Number of measured designs.
        share: Fraction of all fruit that is picked.
        seconds_per_fruit: Time of the tours per fruit, driving and detaching included if known [s]; None without tours.
        cpu_s: Mean processor time of a design [s].
        is_best: True if no other choice picks at least the same share at no more cost (Pareto front).
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
        """Cost to minimize: seconds per fruit [s], or the reach [m]."""
        return self.reach_m if self.seconds_per_fruit is None else self.seconds_per_fruit


@dataclass(frozen=True)
class StudyResult:
    """Result rows of a study, in the order of its designs.

    Attributes:
        name: Name of the study.
        rows: One row for each design.
        measured: Number of designs measured in this run; the other rows existed before.
        seconds: Duration of this run [s].

    Examples:
        >>> from hplan import StudyResult
        >>> StudyResult(name="reach", rows=(), measured=0, seconds=0.0).choices
        ()
    """

    name: str
    rows: tuple[StudyRow, ...]
    measured: int
    seconds: float

    @property
    def choices(self) -> tuple[Choice, ...]:
        """Arms at base positions, in row order, with the Pareto front marked."""
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
    r"""Measure the designs of a study that its CSV file lacks.

    Each row is written immediately, so an interrupted study resumes from its file. Designs of a lost worker are
    measured by another one.

    Args:
        study: The study, or its file.
        rows: CSV file of the rows, extended if it exists; None for no file.
        executor: Any executor of `concurrent.futures`, for example from `dask.distributed.Client.get_executor()`, or a
            function that makes one; the function is called again if a lost worker breaks the executor. None for
            processes of this machine.
        workers: Maximum number of concurrent measurements; None for one per processor, or for the number of the
            executor. With 1 and no executor the measurements run in this process. Other processes import the caller's
            main module: guard it with `if __name__ == "__main__"`.
        progress: Called with the number of finished rows and the number of designs.

    Returns:
        Rows of all designs, from the file and measured now.

    Raises:
        StudyError: The study is invalid.
        InputError: A tree or robot cannot be read, the trees have no room for their fruits, or the CSV file has other
            content.
        OutputError: A row cannot be written, or another study is writing to the file.
        WorkersLostError: Some designs repeatedly lost their workers; all others have their rows.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hplan import Study, run_study
        >>> lines = "kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,2,0.03", "fruit,0,0.1,1.6,0,0.1,1.6,0.04"
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tree = Path(folder, "apple.csv")
        ...     n = tree.write_text("\n".join(lines))
        ...     result = run_study(Study(name="reach", arms=["harvester"], trees=[tree]), workers=1)
        >>> row = result.rows[0]
        >>> row.tree, row.fruits, row.picked
        ('apple', 1, 1)
    """
    study = load_study(study) if isinstance(study, Path | str) else instance("study", study, Study)
    kept_in = None if rows is None else file_path("rows", rows)
    pool, at_once = pool_of(executor, workers)
    begin = time.perf_counter()
    designs = {design.digest: design for design in study.designs()}
    with open_rows(kept_in, StudyRow, "study") as (found, keep):
        kept = {row.digest: row for row in found if row.digest in designs}
        left = [design for digest, design in designs.items() if digest not in kept]
        progress(len(kept), len(designs))
        try:
            for _, row in outcomes(measure, left, pool, at_once):
                keep(row)
                kept[row.digest] = row
                progress(len(kept), len(designs))
        except WorkersLostError as error:
            error.add("run the study again with these rows to resume it")
            raise
    return StudyResult(study.name, tuple(map(kept.__getitem__, designs)), len(left), time.perf_counter() - begin)


def measure(design: Design) -> StudyRow:
    """Measure one design.

    Raises:
        InputError: A tree file cannot be read.
    """
    begin = time.thread_time()
    robot, scene = design.robot, design.scene
    row = partial(
        StudyRow, design.digest, design.arm, design.tree, design.distance, design.height, design.turn_deg,
        design.yields.wood, design.yields.below, design.yields.fruit, design.measure, float(workspace_ball(robot)[3]),
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
    """Number of rows, share picked, seconds per fruit, and mean processor time."""
    picked = sum(row.picked for row in rows)
    times = [row.motion_s if row.total_s is None else row.total_s for row in rows]
    known = [seconds for seconds in times if seconds is not None]
    seconds = sum(known) / picked if picked and known else None
    share = picked / max(1, sum(row.fruits for row in rows))
    return len(rows), share, seconds, sum(row.cpu_s for row in rows) / len(rows)


def _is_best(one: Choice, others: Sequence[Choice]) -> bool:
    """True if no other choice dominates this one in share and cost."""
    return one.share > 0.0 and not any(
        (other.share, -other.cost) != (one.share, -one.cost) and other.share >= one.share and other.cost <= one.cost
        for other in others
        if other.share > 0.0
    )
