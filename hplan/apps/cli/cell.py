"""What `hplan plan` does with a scene of several robots: a motion of all of them, a CSV for each."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.job_folder import PAGE, REPORT, TRAJECTORY, JobFolder
from hplan.apps.cli.options import plan_options
from hplan.apps.cli.terminal import certificate_words, facts_table, loading, progress_line, show_title
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.planning.cell import CellResult

#: Files of a cell's motion: of all joints, then those of each arm.
FILES = (TRAJECTORY, "trajectory-*.csv", PAGE)

#: Options of `hplan plan` that are of one robot, as the parser names them, and their defaults.
_OF_ONE_ROBOT: dict[str, Any] = {
    "robot": None, "limits": None, "hold": [], "tool_frame": None, "srdf": None, "package_dir": [],
    "drop_inside": False, "yield_links": None, "bound": False, "view": False, "cspace": False, "cspace_yaw": None,
    "mcap": False, "certify": True,
}  # fmt: skip


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Plan, write, show what came of it; returns the exit status.

    Raises:
        OptionError: An option that is of one robot.
    """
    for name, default in _OF_ONE_ROBOT.items():
        if getattr(arguments, name) != default:
            option = "--uncertified" if name == "certify" else f"--{name.replace('_', '-')}"
            raise OptionError(option, getattr(arguments, name), "none: the scene has several robots, with their own")
    folder = JobFolder(arguments.out, FILES, REPORT)
    with progress_line(errors, quiet=arguments.quiet, kernels=1) as show:
        show("reading robots and scene")
        with loading():
            from hplan.apps.view.page import write_page
            from hplan.apps.view.playback import Playback
            from hplan.planning.cell import load_cell, plan_cell
            from hplan.planning.report import write_report
            from hplan.trajectory.trajectory import write_csv
        options = plan_options(
            arguments, "method", "step_deg", "objective", "effort", "link_model", "sigmas", "standoff"
        )
        cell = load_cell(arguments.scene)
        with folder.job(cell.scene.name, cell.robot.name):
            begin = time.perf_counter()
            result = plan_cell(cell, options, progress=show)
            seconds = time.perf_counter() - begin
            with folder.filling() as staging:
                write_csv(result.trajectory, staging / TRAJECTORY)
                for name, own in result.trajectories.items():
                    write_csv(own, staging / f"trajectory-{name}.csv")
                shown = cell.task(result.trajectory.position[-1])
                playback = Playback(result.trajectory, certificate=result.certificate.between)
                write_page(cell.robot, shown, playback, staging / PAGE)
                report = {"status": "ok", "scene": cell.scene.name, "robots": {a.name: a.robot.name for a in cell.arms}}
                write_report(report | result.report | {"time_ms": 1e3 * seconds}, staging / REPORT)
    if not arguments.quiet:
        _show(console, result, 1e3 * seconds, str(folder.path))
    return 0


def _show(console: Console, result: CellResult, milliseconds: float, folder: str) -> None:
    from rich.markup import escape

    report = result.report
    table = facts_table()
    add: Callable[[str, str], Any] = table.add_row
    arms = [arm.name for arm in result.cell.arms]
    add("motion", f"[bold]{report['makespan_s']:.3f} s[/], {result.how}")
    alone = ", ".join(f"{escape(name)} {seconds:.3f} s" for name, seconds in report["alone_s"].items())
    add("alone", f"{alone}; one after the other {report['one_after_the_other_s']:.3f} s")
    if any(result.later_s.values()):
        add("later", ", ".join(f"{escape(name)} by {later:.2f} s" for name, later in result.later_s.items() if later))
    distances = {"between arms": report["between_arms_mm"], **report["arms_mm"]}
    shown = (f"{escape(name)} {'no obstacles' if d is None else f'{d:.2f} mm'}" for name, d in distances.items())
    add("clearance", ", ".join(shown) + "; or more, shown for all times")
    add("certificate", certificate_words(report["verified"]))
    add("time", f"[bold]{milliseconds:,.0f} ms[/], loading of compiled code included")
    files = ", ".join([TRAJECTORY, *(f"trajectory-{escape(name)}.csv" for name in arms), REPORT, PAGE])
    add("files", f"{escape(folder)}: {files}")
    show_title(console, result.cell.scene.name, ", ".join(arms))
    console.print(table)
    console.print()
