"""Execution of a study on an executor; result rows and Pareto front."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hplan.base.arguments import file_path, instance
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.collision.motion_coefficients import workspace_ball
from hplan.errors import HplanError, TourError, WorkersLostError
from hplan.planning.failures import REASONS, Reason, obstacle_of, reason_of, tally_reasons
from hplan.planning.options import PlanOptions
from hplan.study.definition import Design, Study, load_study
from hplan.study.row_file import open_rows
from hplan.tour.row import RowOptions, plan_row, reach_in_turn, within_reach
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
        out_of_reach: Number of fruits that no configuration reaches, as `blocked`, `no_approach` and `no_motion` the
            number of fruits that are not picked for that reason (`FruitReach.reason`).
        obstacles: For the obstacles that prevent picking, the number of fruits.
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
    out_of_reach: int = 0
    blocked: int = 0
    no_approach: int = 0
    no_motion: int = 0
    obstacles: dict[str, int] = field(default_factory=dict)
    error: str = ""


@dataclass(frozen=True)
class Choice:
    """An arm at a base position, aggregated over all trees and rotations.

    Attributes:
        rows: Number of measured designs.
        share: Fraction of all fruit that is picked.
        seconds_per_fruit: Time of the tours per fruit, driving and detaching included if known [s]; None without tours.
        cpu_s: Mean processor time of a design [s].
        not_picked: Fractions of all fruit that are not picked, by reason (`FruitReach.reason`).
        obstacles: For the obstacles that prevent picking, the number of fruits, in descending order.
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
    not_picked: dict[str, float] = field(default_factory=dict)
    obstacles: dict[str, int] = field(default_factory=dict)
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
    def not_picked(self) -> dict[str, int]:
        """Number of fruits that are not picked, by reason, over all designs."""
        return {reason: sum(getattr(row, reason) for row in self.rows) for reason in REASONS}

    @property
    def obstacles(self) -> dict[str, int]:
        """For the obstacles that prevent picking, the number of fruits over all designs, in descending order."""
        return _sum_obstacles(self.rows)

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

    def row(
        picked: int,
        unpicked: Iterable[tuple[Reason | None, str | None]],
        *,
        stops: int = 1,
        motion_s: float | None = None,
        total_s: float | None = None,
        error: str = "",
    ) -> StudyRow:
        known = [(reason, obstacle) for reason, obstacle in unpicked if reason is not None]
        reasons, obstacles = tally_reasons(known)
        if not error:  # fruits outside the workspace are not even tried
            reasons["out_of_reach"] = len(scene.fruits) - picked - sum(map(reasons.__getitem__, REASONS[1:]))
        return StudyRow(
            design.digest, design.arm, design.tree, design.distance, design.height, design.turn_deg,
            design.yields.wood, design.yields.below, design.yields.fruit, design.measure,
            float(workspace_ball(robot)[3]), len(scene.fruits), picked, stops, motion_s, total_s,
            time.thread_time() - begin, **reasons, obstacles=obstacles, error=error,
        )  # fmt: skip

    try:
        if design.measure == "reach":
            found = reach_in_turn(robot, within_reach(robot, scene)).values()
            return row(sum(one.can_be_picked for one in found), ((one.reason, one.obstacle) for one in found))
        options = PlanOptions(effort=design.effort)
        if design.measure == "row":
            whole = plan_row(robot, scene, options, row=RowOptions(distance=design.distance))
            motion_s, total_s = (whole.report[key] for key in ("motion_s", "total_s"))
            left = ((one.reason, one.obstacle) for one in whole.unpicked.values())
            return row(len(whole.picked), left, stops=len(whole.stops), motion_s=motion_s, total_s=total_s)
        tour = plan_tour(robot, within_reach(robot, scene), options, tour=TourOptions(back=True))
    except TourError as none:
        return row(0, ((reason_of(error), obstacle_of(error)) for _, error in none.reasons), motion_s=0.0)
    except HplanError as error:
        return row(0, (), error=f"{error.kind}: {error.message}")
    return row(len(tour.order), ((one.reason, one.obstacle) for one in tour.unreached), motion_s=tour.duration)


def _summary(rows: Sequence[StudyRow]) -> tuple[Any, ...]:
    """Values of a choice: from the number of rows to the obstacles."""
    picked = sum(row.picked for row in rows)
    times = [row.motion_s if row.total_s is None else row.total_s for row in rows]
    known = [seconds for seconds in times if seconds is not None]
    seconds = sum(known) / picked if picked and known else None
    fruits = max(1, sum(row.fruits for row in rows))
    reasons = {reason: sum(getattr(row, reason) for row in rows) / fruits for reason in REASONS}
    return (
        len(rows),
        picked / fruits,
        seconds,
        sum(row.cpu_s for row in rows) / len(rows),
        reasons,
        _sum_obstacles(rows),
    )


def _sum_obstacles(rows: Sequence[StudyRow]) -> dict[str, int]:
    return dict(sum((Counter(row.obstacles) for row in rows), Counter[str]()).most_common())


def _is_best(one: Choice, others: Sequence[Choice]) -> bool:
    """True if no other choice dominates this one in share and cost."""
    return one.share > 0.0 and not any(
        (other.share, -other.cost) != (one.share, -one.cost) and other.share >= one.share and other.cost <= one.cost
        for other in others
        if other.share > 0.0
    )
