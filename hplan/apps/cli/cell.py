"""What `hplan plan`, `tour` and `certify` do with a scene of several robots: one motion of all, and a CSV for each."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.job_folder import MCAP, PAGE, REPORT, TOUR, TOUR_REPORT, TRAJECTORY, JobFolder, needs_rosbags
from hplan.apps.cli.options import check_output_file, plan_options, tracking_of
from hplan.apps.cli.terminal import FAILED, certificate_words, facts_table, hand_out, loading, progress_line, show_title
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.planning.cell import CellCertificate, CellResult
    from hplan.tour.cell_tour import CellTour

#: Options that are of one robot, as the parsers name them, and their defaults.
_OF_ONE_ROBOT: dict[str, Any] = {
    "robot": None, "limits": None, "hold": [], "tool_frame": None, "srdf": None, "package_dir": [],
    "allow_neighbours": False, "drop_inside": False, "yield_links": None, "bound": False, "view": False,
    "cspace": False, "cspace_yaw": None, "certify": True, "fruits": None,
    "drop_off": None, "drop_off_pose": None, "drop_off_joints": None, "begin": 0.0, "moving_ends": False,
    "every": None, "back": False, "order": "best", "compare": False, "grasps": 4, "csv": "one",
}  # fmt: skip

#: Those of `PlanOptions` that the parsers have.
_OF_PLANS = ("method", "step_deg", "objective", "effort", "link_model", "sigmas", "standoff")


def run(arguments: argparse.Namespace, console: Console, errors: Console, *, tour: bool = False) -> int:
    """Plan motions to goals, or tours; write, show what came of it; returns the exit status.

    Raises:
        OptionError: An option that is of one robot.
    """
    _check_options(arguments)
    csv, name = (TOUR, TOUR_REPORT) if tour else (TRAJECTORY, REPORT)
    of_arm = csv.replace(".csv", "-{}.csv")
    folder = JobFolder(arguments.out, (csv, of_arm.format("*"), PAGE, MCAP), name)
    needs_rosbags(arguments)
    with progress_line(errors, quiet=arguments.quiet) as show:
        show("reading robots and scene")
        with loading():
            from hplan.apps.view.page import write_page
            from hplan.apps.view.playback import playable
            from hplan.planning.cell import load_cell
            from hplan.planning.cell_planner import plan_cell
            from hplan.planning.report import write_report
            from hplan.tour.cell_tour import plan_cell_tour
            from hplan.trajectory.trajectory import write_csv
        options = plan_options(arguments, *(option for option in _OF_PLANS if hasattr(arguments, option)))
        cell = load_cell(arguments.scene)
        with folder.job(cell.scene.name, cell.robot.name):
            begin = time.perf_counter()
            result = plan_cell_tour(cell, options, progress=show) if tour else plan_cell(cell, options, progress=show)
            milliseconds = 1e3 * (time.perf_counter() - begin)
            with folder.filling() as staging:
                write_csv(result.trajectory, staging / csv)
                for arm, own in result.trajectories.items():
                    write_csv(own, staging / of_arm.format(arm))
                write_page(*playable(result), staging / PAGE)
                if arguments.mcap:
                    from hplan.apps.ros.mcap_file import write_mcap

                    write_mcap(result, staging / MCAP)
                report = {"status": "ok", "scene": cell.scene.name, "robots": {a.name: a.robot.name for a in cell.arms}}
                write_report(report | result.report | {"time_ms": milliseconds}, staging / name)
    if not arguments.quiet:
        files = [csv, *(of_arm.format(arm.name) for arm in cell.arms), name, PAGE, *([MCAP] if arguments.mcap else [])]
        _show(console, result, milliseconds, f"{folder.path}: {', '.join(files)}")
    return 0


def certify(arguments: argparse.Namespace, console: Console) -> int:
    """Certify a motion of all joints, or a folder with a `trajectory-NAME.csv` of each arm; returns the exit status.

    Raises:
        OptionError: An option that is of one robot.
    """
    _check_options(arguments)
    with loading():
        from hplan.planning.cell import certify_cell, load_cell
        from hplan.planning.options import PlanOptions
        from hplan.planning.report import certificate_report, versions
        from hplan.trajectory.trajectory import read_csv

    cell, path, tracking = load_cell(arguments.scene), arguments.trajectory, tracking_of(arguments)
    options = PlanOptions(tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, sigmas=arguments.sigmas)
    names = [arm.name for arm in cell.arms]
    motion = {name: read_csv(path / f"trajectory-{name}.csv") for name in names} if path.is_dir() else read_csv(path)
    if arguments.report is not None:
        check_output_file(arguments.report, "--report")
    contact = dict.fromkeys(names, arguments.goal_contact)
    found = certify_cell(cell, motion, options, goal_contact=contact, check_ends=not arguments.any_ends)
    tasks = {arm.name: arm.scene for arm in cell.arms}
    report = {
        "status": "ok" if found.verified else "failed",
        "scene": cell.scene.name,
        "between": certificate_report(found.between, options, cell.task(cell.configuration({}), obstacles=False)),
        "arms": {name: certificate_report(own, options, tasks[name]) for name, own in found.arms.items()},
        "violations": list(found.violations),
        "versions": versions(),
    }
    hand_out(arguments, console, report, lambda: _show_certificate(console, cell.scene.name, found))
    return 0 if found.verified else FAILED


def _show_certificate(console: Console, scene: str, found: CellCertificate) -> None:
    table = facts_table()
    table.add_row("certificate", certificate_words(found.verified))
    for violation in found.violations:
        table.add_row("", violation)
    distances = {"between arms": found.between, **found.arms}
    table.add_row("clearance", ", ".join(f"{n} {1e3 * own.min_clearance_m:.2f} mm" for n, own in distances.items()))
    show_title(console, scene, ", ".join(found.arms))
    console.print(table)
    console.print()


def _check_options(arguments: argparse.Namespace) -> None:
    for name, default in _OF_ONE_ROBOT.items():
        if getattr(arguments, name, default) != default:
            option = "--uncertified" if name == "certify" else f"--{name.replace('_', '-')}"
            raise OptionError(option, getattr(arguments, name), "none: the scene has several robots, with their own")


def _show(console: Console, result: CellResult | CellTour, milliseconds: float, files: str) -> None:
    from rich.markup import escape

    from hplan.planning.cell import CellResult

    report = result.report
    table = facts_table()
    add: Callable[[str, str], Any] = table.add_row
    if isinstance(result, CellResult):
        add("motion", f"[bold]{report['makespan_s']:.3f} s[/], {result.how}")
        alone = ", ".join(f"{escape(name)} {seconds:.3f} s" for name, seconds in report["alone_s"].items())
        add("alone", f"{alone}; one after the other {report['one_after_the_other_s']:.3f} s")
        if any(result.later_s.values()):
            add(
                "later",
                ", ".join(f"{escape(name)} by {later:.2f} s" for name, later in result.later_s.items() if later),
            )
    else:
        faster = report["speed_up_over_one_arm"]
        picked = f"[bold]{report['picked']}[/] in [bold]{report['makespan_s']:.2f} s[/]"
        add("picked", f"{picked}, {report['s_per_fruit']:.2f} s each, {faster:.2f} times as fast as one arm")
        add("idle", ", ".join(f"{escape(name)} {seconds:.2f} s" for name, seconds in report["idle_s"].items()))
        for fruit, reason in result.unreached.items():
            add("not picked", escape(f"{fruit}: {reason}"))
    distances = {"between arms": report["between_arms_mm"], **report.get("arms_mm", {})}
    shown = (f"{escape(name)} {'nothing near' if d is None else f'{d:.2f} mm'}" for name, d in distances.items())
    add("clearance", ", ".join(shown) + "; or more, shown for all times")
    add("certificate", certificate_words(report["verified"]))
    add("time", f"[bold]{milliseconds:,.0f} ms[/], loading of compiled code included")
    add("files", escape(files))
    show_title(console, result.cell.scene.name, ", ".join(arm.name for arm in result.cell.arms))
    console.print(table)
    console.print()
