"""Plan a certified motion of a harvesting arm for the controller.

Writes trajectory.csv, report.json and an animated scene.html.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.job_folder import (
    CSPACE_FIGURE,
    CSPACE_PAGE,
    PLAN_FILES,
    REPORT,
    TRAJECTORY,
    JobFolder,
    needs_rosbags,
    write_figure,
    write_result,
)
from hplan.apps.cli.options import (
    OF_PLANS,
    add_shared,
    command_parser,
    names_robots,
    plan_options,
    robot_of,
    scene_among,
)
from hplan.apps.cli.terminal import (
    describe_certificate,
    escape,
    facts_table,
    held_rows,
    pause_garbage_collection,
    percent,
    progress_line,
    risk_words,
    show,
    tilt_words,
    uncovered_rows,
)
from hplan.base.units import at_least_mm

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.planning.options import PlanOptions
    from hplan.planning.result import PlanResult
    from hplan.robot.model import Robot
    from hplan.scene.model import Scene

_EXIT_STATUS = """\
exit status:
  0  done
  2  bad input
  3  no path exists (proved), or the goal is unreachable
  4  the motion cannot be timed
  5  the motion is not certified
  6  no motion found (search inconclusive or timed out)

hplan --help lists the other commands.
"""

#: Approximate number of kernels called for the reference scene; most other scenes call fewer.
KERNELS = 144

STAGE_WORDS = {
    "grasps": "finding grasps",
    "trees": "growing trees for a first path",
    "cspace": "computing the C-space",
    "search": "searching slices and sparse graph",
    "postprocess": "smoothing the path",
    "timing": "timing the motion",
    "certificate": "certifying clearance and limits",
    "bound": "computing a lower bound of the duration",
    "export": "writing files",
}


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Plan, write the files and show a summary; return the exit status."""
    if arguments.scene is not None and names_robots(arguments.scene):
        from hplan.apps.cli.cell import run as run_cell

        return run_cell(arguments, console, errors)
    folder = JobFolder(arguments, PLAN_FILES, REPORT)
    result, files = _plan_and_write(arguments, folder, errors)
    if not arguments.quiet:
        show_summary(console, result, folder.path, files)
    if arguments.view:
        from hplan.apps.cli.view import serve_page
        from hplan.apps.view.playback import playable

        serve_page(console, *playable(result))
    return 0


def parser(prog: str) -> argparse.ArgumentParser:
    """Parser of the command's arguments."""
    parser = command_parser(__doc__, _EXIT_STATUS, prog=prog)
    add = parser.add_argument
    add_shared(parser, "scene", "out", "force", "robot", "parts", "contacts", "wood", "upright", "gentle")
    add_shared(parser, "search", "effort", "seed", "grid", "pace", "tracking", "sigmas", "risk", "capture", "standoff")
    add("--uncertified", dest="certify", action="store_false", help="write the motion even if it is not certified; "
        "the report says whether it is")  # fmt: skip
    add("--bound", action="store_true", help="also report by how much any motion could be faster at most")
    add_shared(parser, "deadline")
    add("--view", action="store_true", help="serve the animated scene until interrupted")
    add("--cspace", action="store_true", help="write cspace.html with the forbidden joint angles and the "
        "motion, and cspace.png if matplotlib is installed")  # fmt: skip
    add(
        "--cspace-yaw", type=float, metavar="DEG", help="write them for this yaw angle in degrees (default: the goal's)"
    )
    add_shared(parser, "mcap", "quiet")
    return parser


def _plan_and_write(arguments: argparse.Namespace, folder: JobFolder, errors: Console) -> tuple[PlanResult, list[str]]:
    """Load, plan and write; return the plan and its file names."""
    with progress_line(errors, quiet=arguments.quiet, kernels=KERNELS) as status:
        status("reading robot and scene")
        with pause_garbage_collection():
            from hplan.errors import OptionError
            from hplan.planning.plan import with_export_time
            from hplan.planning.report import curve_report, write_report
            from hplan.planning.specialist import specialist_of
            from hplan.scene.file import load_scene

        options = plan_options(arguments, *OF_PLANS, "risk", "certify", "bound", "gentle")
        needs_rosbags(arguments)
        given = load_scene(arguments.scene)
        robot = robot_of(arguments, given)
        yaw = None if arguments.cspace_yaw is None else math.radians(arguments.cspace_yaw)
        wants_cspace = arguments.cspace or yaw is not None
        specialist = specialist_of(robot) if wants_cspace else None
        if specialist is not None:
            specialist.check_cspace(robot, yaw)
        elif wants_cspace:
            raise OptionError("cspace", True, f"False for {robot.name!r}, which has no C-space that can be drawn")
        scene, left_out = scene_among(arguments, robot, given, errors)

        def progress(stage: str) -> None:
            status(STAGE_WORDS.get(stage, stage))

        with folder.job(scene.name, robot.name):
            result = _plan_and_compile(robot, scene, options, progress)
            progress("export")
            begin = time.perf_counter()
            with folder.stage_files() as staging:
                files = write_result(result, {TRAJECTORY: result.trajectory}, staging, mcap=arguments.mcap)
                if specialist is not None:
                    files += _write_cspace(*specialist.draw_cspace(result, options, yaw), staging, errors)
                result = with_export_time(result, time.perf_counter() - begin)
                write_report(result.report | curve_report(result.certificate) | left_out, staging / REPORT)
    return result, [TRAJECTORY, REPORT, *files]


def _plan_and_compile(robot: Robot, scene: Scene, options: PlanOptions, progress: Callable[[str], None]) -> PlanResult:
    """Plan; on a first run another process compiles the last kernels meanwhile."""
    from hplan.apps.cli.compile_ahead import compiling_ahead, is_first_run
    from hplan.online.warm_up import warm_up
    from hplan.planning.plan import plan

    with compiling_ahead(is_first_run()) as compile_last:

        def stage(name: str) -> None:
            progress(name)
            if name == "postprocess":
                compile_last()

        if options.deadline_s is not None:
            warm_up(robot)
        return plan(robot, scene, options, progress=stage)


def _write_cspace(page: str, draw: Callable[[], Any], folder: Path, errors: Console) -> list[str]:
    """Write page and figure of the C-space; return the file names."""
    from hplan.base.files import HTML_COMMENT, write_marked

    write_marked(folder / CSPACE_PAGE, page, HTML_COMMENT)
    return [CSPACE_PAGE, *write_figure(draw, folder / CSPACE_FIGURE, errors)]


def show_summary(console: Console, result: PlanResult, folder: Path, files: Sequence[str]) -> None:
    """Print a plan's summary and file names.

    Lines fit 80 columns unless names are long.
    """
    from hplan.base.units import joint_length

    report = result.report
    planner, expansions, path = report["planner"], report["planner"]["expansions"], report["path"]
    motion, proof = report["trajectory"], report["certificate"]
    length, grid = (
        joint_length(math.radians(path[key]), result.robot.slides) for key in ("length_deg", "length_deg_grid")
    )
    table = facts_table()
    add: Callable[[str, str], Any] = table.add_row
    if result.grasp is not None:
        grasp = report["grasp"]
        point = "the point" if result.scene.goal.pose is None else "the pose"
        what = point if grasp["fruit"] is None else escape(grasp["fruit"])
        angle = round(grasp["approach_deg"], 1) + 0.0  # no -0.0
        caught = f", caught with {percent(grasp['caught'])} %" if "caught" in grasp else ""
        add("grasp", f"{what}, tool at {angle:.1f} deg, {_approach_words(grasp['standoff_m'])}{caught}")
    if result.path is None:
        add("search", "none: start and goal are the same")
    elif planner["method"] == "direct":
        add("search", "none: the straight motion is collision-free")
    elif planner["method"] == "given":
        given = report["given"]
        moved = len(given["moved_segments"])
        words = f"; {moved} motion{'s' * (moved != 1)} moved to keep clear" if moved else ""
        add("search", f"none: {given['waypoints']:,} waypoints were given{words}")
        add("path", f"{length}, from {grid}")
    elif result.search is None:
        add("search", f"{planner['method']}: {len(result.grid_path) - 2} configurations between start and goal")
        add("path", length)
    else:
        points = f"{planner['points']} points, cost {planner['cost_deg']:.6f} deg"
        fallback = "" if planner["fallback"] == "none" else f", with the {planner['fallback']} search after it"
        add("search", f"{planner['method']}{fallback}: {points}")
        stages = ", ".join(f"{stage} {expansions[stage]:,}" for stage in ("layers", "sparse", "fallback"))
        add("expanded", f"{expansions['total']:,} nodes: {stages}")
        add("flooded", f"{expansions['flooded_cells']:,} nodes")
        add("path", f"{length}, from {grid} on the grid")
    rows = "1 sample" if motion["samples"] == 1 else f"{motion['samples']:,} samples at {motion['rate_hz']:g} Hz"
    add("motion", f"[bold]{motion['duration_s']:.3f} s[/], {rows}")
    if len(result.phases) > 1:
        add("", ", ".join(f"{phase.name} {phase.end_s - phase.start_s:.3f} s" for phase in result.phases))
    if "bound" in report:
        add("bound", _bound_words(report["bound"], len(result.phases)))
    add("limits used", ", ".join(f"{name} {percent(used)}" for name, used in proof["limit_use"].items()) + " %")
    add("clearance", _clearance_words(proof))
    if "upright" in proof:
        add("tilt", tilt_words(proof["upright"]))
    if "in_time" in report:
        timing = report["in_time"]
        slows = ", slows down" if timing["slows_down"] else ""
        until_s = proof.get("clear_until_s")
        until = "" if until_s is None else f", clear until {until_s:.4g} s"
        add("obstacles move", f"{timing['path']}, waits {timing['waits_s']:.2f} s{slows}{until}")
    if proof["nearest"] is not None:
        nearest = proof["nearest"]
        pair = f"{escape(nearest['link'])} to {escape(nearest['obstacle'])}"
        add("nearest", f"{pair}, {1e3 * nearest['distance_m']:.2f} mm")
    if "risk" in proof:
        add("risk", risk_words(proof["risk"]))
    add("certificate", describe_certificate(proof["verified"]))
    for violation in proof["violations"]:
        add("", escape(violation))
    for row in [*uncovered_rows(proof.get("uncovered_links", ())), *held_rows(proof)]:
        add(*row)
    for assumption in report.get("assumptions", ()):
        add("assumed", f"[yellow]{escape(assumption.partition(':')[0])}[/]")
    add("time", _time_words(report["time_ms"]))
    add("files", f"{escape(folder)}: {', '.join(files)}")
    show(console, report["scene"], report["robot"], table)


def _bound_words(bound: dict[str, Any] | None, phases: int) -> str:
    """Phrase for the optimality gap of the motion or its phases.

    The gap is relative to the fastest motion that the lower bound does not exclude.
    """
    if bound is None:
        return "none, because the motion is not certified"
    gap = math.ceil(1e3 * bound["gap"] - 1e-6) / 10.0
    what = "" if len(bound["phases"]) == phases else f"{' and '.join(bound['phases'])}: "
    words = f"at most {gap:.1f} % from the fastest possible"
    return f"{words}\n{what}no motion is shorter than {bound['bound_s']:.3f} s"


def _approach_words(standoff_m: float) -> str:
    return (
        f"straight approach of {100 * standoff_m:.1f} cm"
        if standoff_m > 0.0
        else "no straight approach is collision-free"
    )


def _clearance_words(proof: dict[str, Any]) -> str:
    if proof["nearest"] is None:
        return "no obstacles"
    if not proof["verified"]:
        return f"{1e3 * proof['min_clearance_m']:.2f} mm, where the proof stopped"
    return f"{at_least_mm(proof['min_clearance_m'])} mm or more, proved for all times"


def _time_words(times: dict[str, float]) -> str:
    """Total time, then the times of the executed stages.

    The stages up to the path take one line, the stages of the motion another.
    """
    stages = {name: f"{name} {ms:.1f}" for name, ms in times.items() if name != "total" and ms > 0.0}
    motion = [
        stages.pop(name) for name in ("postprocess", "timing", "certificate", "bound", "export") if name in stages
    ]
    lines = [", ".join(part) for part in (stages.values(), motion) if part]
    return "\n".join([f"[bold]{times['total']:,.0f} ms[/], including the loading of compiled code", *lines])
