"""Plans for many scene files, one row of results each."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache, partial
from pathlib import Path

from hplan.base.arguments import file_path, instance
from hplan.base.data_files import shipped_scenes
from hplan.base.files import prepare_folder
from hplan.base.tasks import Pool, outcomes, pool_of
from hplan.certificate.digests import robot_digest, scene_digest
from hplan.errors import HplanError, OptionError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.study.row_file import open_rows
from hplan.trajectory.trajectory import write_csv


@dataclass(frozen=True)
class BatchRow:
    """Result for one scene file; the columns of a batch's CSV.

    Attributes:
        digest: 16 hexadecimal digits that identify scene file, robot and options.
        scene: The scene file, as given.
        robot: Name of the robot.
        status: "ok", or the kind of the error.
        exit_status: Exit status of `hplan plan` for the scene.
        verified: True if the motion is certified.
        duration_s: Duration of the motion [s]; None without a motion, as are the values below.
        min_clearance_m: Lower bound on the clearance of the whole motion [m].
        nearest_link: Link of the nearest pair.
        nearest_obstacle: Obstacle of the nearest pair.
        nearest_distance_m: Distance of the nearest pair [m].
        fruit: The picked fruit; empty for other goals.
        planning_ms: Planning time [ms].
        cpu_s: Processor time, loading included [s].
        trajectory: File name of the trajectory; empty if not written.
        error: Message of the error; empty without one.
    """

    digest: str
    scene: str
    robot: str
    status: str
    exit_status: int
    verified: bool
    duration_s: float | None
    min_clearance_m: float | None
    nearest_link: str
    nearest_obstacle: str
    nearest_distance_m: float | None
    fruit: str
    planning_ms: float | None
    cpu_s: float
    trajectory: str
    error: str = ""


@dataclass(frozen=True)
class _Job:
    """A scene file, and the digests of its rows that are kept."""

    scene: Path | str
    known: frozenset[str]


@dataclass(frozen=True)
class _Task:
    """Settings of all plans: robot, options, and folder of the trajectories."""

    robot: Robot | None
    options: PlanOptions
    folder: Path | None


def run_batch(
    scenes: Sequence[Path | str],
    options: PlanOptions | None = None,
    *,
    robot: Robot | None = None,
    rows: Path | str | None = None,
    trajectories: Path | str | None = None,
    executor: Pool | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> tuple[BatchRow, ...]:
    """Plan a motion for each scene file.

    A scene without a certified motion, or an invalid one, gives a row with its error; the others are not affected.

    Args:
        scenes: Scene files, or names of shipped scenes.
        options: Options of all plans; None for the defaults.
        robot: Robot of all plans; None for the robot of each scene.
        rows: CSV file of the rows, extended if it exists: rows of the same scene, robot and options are kept. None for
            no file.
        trajectories: Folder for the trajectories as CSV; None to write none.
        executor: As for `hplan.run_study`.
        workers: Maximum number of concurrent plans; None for one per processor.
        progress: Called with the number of finished rows and the number of scenes.

    Returns:
        The rows, in the order of the scenes.

    Raises:
        OptionError: `scenes` is empty or has a scene twice, or another argument is invalid.
        SceneError: A scene file does not exist.
        OutputError: A file cannot be written.
        WorkersLostError: Scenes whose worker processes were lost again and again; the others are done.

    Examples:
        >>> from hplan import PlanOptions, run_batch
        >>> rows = run_batch(["table-1", "trellis"], PlanOptions(effort="quick"), workers=1)
        >>> [(row.scene, row.status, row.verified) for row in rows]
        [('table-1', 'ok', True), ('trellis', 'ok', True)]
    """
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    if not isinstance(scenes, Sequence) or isinstance(scenes, str) or not scenes:
        raise OptionError("scenes", scenes, "a list with at least one scene file")
    for scene in scenes:
        file_path("scenes", scene)
    repeated = next((scene for scene, count in Counter(map(str, scenes)).items() if count > 1), None)
    if repeated is not None:
        raise OptionError("scenes", repeated, "scene files, each once")
    folder = None if trajectories is None else file_path("trajectories", trajectories)
    kept_in = None if rows is None else file_path("rows", rows)
    if robot is not None:
        instance("robot", robot, Robot)
    for scene in scenes:
        if not Path(scene).exists() and scene not in shipped_scenes():
            load_scene(scene)  # raises: probably a slip in the call, where all other errors are rows
    if folder is not None:
        prepare_folder(folder)
    task = _Task(robot, options, folder)
    pool, at_once = pool_of(executor, workers)
    with open_rows(kept_in, BatchRow, "batch") as (found, keep):
        known: dict[str, dict[str, BatchRow]] = {str(scene): {} for scene in scenes}
        for row in found:
            is_whole = folder is None or row.status != "ok" or (row.trajectory and (folder / row.trajectory).is_file())
            if row.scene in known and is_whole:
                known[row.scene][row.digest] = row
        jobs = [_Job(scene, frozenset(known[str(scene)])) for scene in scenes]
        done: dict[int, BatchRow] = {}
        progress(0, len(jobs))
        for number, found_row in outcomes(partial(_plan_row, task), jobs, pool, at_once):
            if isinstance(found_row, str):
                done[number] = known[str(scenes[number])][found_row]
            else:
                keep(found_row)
                done[number] = found_row
            progress(len(done), len(jobs))
    return tuple(done[number] for number in range(len(jobs)))


def _plan_row(task: _Task, job: _Job) -> BatchRow | str:
    """Plan for one scene file; return its row, or the digest of its known row.

    The row has the error if there is no motion. A scene is identified by its content, meshes and clouds included, by
    the robot and the options.
    """
    begin, robot = time.process_time(), task.robot
    loaded: tuple[Robot, Scene] | HplanError
    try:
        scene = load_scene(job.scene)
        robot = _scene_robot(scene.robot) if robot is None else robot
        loaded, content = (robot, scene), scene_digest(scene) + robot_digest(robot)
    except HplanError as error:
        loaded, content = error, error.message
    digest = hashlib.sha256(f"{job.scene}\n{task.options!r}\n{content}".encode()).hexdigest()[:16]
    if digest in job.known:
        return digest
    trajectory = "" if task.folder is None else f"{Path(job.scene).stem}-{digest[:8]}.csv"
    try:
        if isinstance(loaded, HplanError):
            raise loaded
        result = plan(*loaded, task.options)
        if task.folder is not None:
            write_csv(result.trajectory, task.folder / trajectory)
    except HplanError as error:
        missing = {field.name: None if "None" in str(field.type) else "" for field in fields(BatchRow)}
        failed = {
            "status": error.kind,
            "exit_status": error.exit_status,
            "verified": False,
            "error": error.message,
            "cpu_s": time.process_time() - begin,
        }
        name = "" if robot is None else robot.name
        return BatchRow(**(missing | {"digest": digest, "scene": str(job.scene), "robot": name} | failed))  # type: ignore[arg-type]
    found = {"status": "ok", "exit_status": 0, "cpu_s": time.process_time() - begin, "trajectory": trajectory}
    return BatchRow(digest, str(job.scene), **(result.row() | found))


@lru_cache(maxsize=16)
def _scene_robot(name: str | None) -> Robot:
    return load_robot(name)
