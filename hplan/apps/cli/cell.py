"""Subcommands `plan`, `tour` and `certify_cell_motion` for workcells, scenes with several robots.

A plan or tour is one motion of all arms, written as one CSV of all joints and one CSV for each arm.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import (
    MCAP,
    PAGE,
    REPORT,
    TOUR,
    TOUR_REPORT,
    TRAJECTORY,
    JobFolder,
    needs_rosbags,
    write_result,
)
from hplan.apps.cli.options import OF_PLANS, check_output_file, check_tracking, plan_options, refuse, tracking_of
from hplan.apps.cli.terminal import (
    FAILED,
    describe_certificate,
    escape,
    facts_table,
    hand_out,
    pause_garbage_collection,
    progress_line,
    show,
    uncovered_rows,
    unpicked_table,
)
from hplan.base.units import at_least_mm

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.scene.cell import ArmLink
    from hplan.tour.cell_tour import CellTour
    from hplan.workcell.cell import CellCertificate, CellResult

#: Options that apply to a single robot only, and the error text if one of them is given.
_OF_ONE_ROBOT = (
    *(
        "robot",
        "limits",
        "hold",
        "tool_frame",
        "srdf",
        "package_dir",
        "xacro",
        "acceleration_scale",
        "group",
        "group_state",
        "repair_inertia",
        "tool_tube_m",
        "allow_neighbours",
        "drop_inside",
        "yield_links",
        "upright",
        "upright_axis",
    ),
    "collision_from_visual",
    *("bound", "view", "cspace", "cspace_yaw", "certify", "fruits", "drop_off", "drop_off_pose", "drop_off_joints"),
    *(
        "risk",
        "begin",
        "interpolation",
        "velocity_jumps",
        "moving_ends",
        "every",
        "back",
        "order",
        "compare",
        "grasps",
        "max_detour_s",
        "csv",
    ),
)
_NO_SINGLE_ROBOT = "no value: the scene has several robots, each with its own"


def run(arguments: argparse.Namespace, console: Console, errors: Console, *, tour: bool = False) -> int:
    """Plan a workcell's motions to goals or its tours.

    Writes the files and prints a summary.

    Args:
        tour: Plan picking tours instead of motions to the goals.

    Returns:
        The exit status.
    """
    refuse(arguments, _OF_ONE_ROBOT, _NO_SINGLE_ROBOT)
    csv, name = (TOUR, TOUR_REPORT) if tour else (TRAJECTORY, REPORT)
    of_arm = csv.replace(".csv", "-{}.csv")
    folder = JobFolder(arguments, (csv, of_arm.format("*"), PAGE, MCAP), name)
    needs_rosbags(arguments)
    with progress_line(errors, quiet=arguments.quiet) as progress:
        progress("reading robots and scene")
        with pause_garbage_collection():
            from hplan.planning.report import write_report
            from hplan.tour.cell_tour import CellTour, plan_cell_tour
            from hplan.workcell.cell import load_cell
            from hplan.workcell.planner import plan_cell
        options = plan_options(arguments, *(option for option in OF_PLANS if hasattr(arguments, option)))
        cell = load_cell(arguments.scene)
        check_tracking(arguments, cell.robot)
        with folder.job(cell.scene.name, cell.robot.name):
            begin = time.perf_counter()
            plan = plan_cell_tour if tour else plan_cell
            result = plan(cell, options, progress=progress)
            milliseconds = 1e3 * (time.perf_counter() - begin)
            motions = {csv: result.trajectory}
            motions |= {of_arm.format(arm): own for arm, own in result.trajectories.items()}
            with folder.stage_files() as staging:
                files = [*motions, name, *write_result(result, motions, staging, mcap=arguments.mcap)]
                report = {"status": "ok", "scene": cell.scene.name, "robots": {a.name: a.robot.name for a in cell.arms}}
                write_report(report | result.report | {"time_ms": milliseconds}, staging / name)
    if not arguments.quiet:
        facts = facts_table(_cell_facts(result, milliseconds, f"{folder.path}: {', '.join(files)}"))
        unpicked = unpicked_table(result.unreached) if isinstance(result, CellTour) else []
        show(console, cell.scene.name, ", ".join(arm.name for arm in cell.arms), *unpicked, facts)
    return 0


def certify_cell_motion(arguments: argparse.Namespace, console: Console) -> int:
    """Certify a motion of a workcell; return the exit status.

    The motion is one CSV of all joints, or a folder with a `trajectory-NAME.csv` for each arm.
    """
    refuse(arguments, _OF_ONE_ROBOT, _NO_SINGLE_ROBOT)
    with pause_garbage_collection():
        from hplan.planning.options import PlanOptions
        from hplan.planning.report import certificate_report, versions
        from hplan.trajectory.trajectory import read_csv
        from hplan.workcell.cell import certify_cell, load_cell, may_touch_report

    cell, path, tracking = load_cell(arguments.scene), arguments.trajectory, tracking_of(arguments)
    check_tracking(arguments, cell.robot)
    options = PlanOptions(tracking_error=tracking.still_rad, tracking_delay_s=tracking.delay_s, sigmas=arguments.sigmas)
    names = [arm.name for arm in cell.arms]
    motion = {name: read_csv(path / f"trajectory-{name}.csv") for name in names} if path.is_dir() else read_csv(path)
    if arguments.report is not None:
        check_output_file(arguments.report, "--report", force=arguments.force)
    contact = dict.fromkeys(names, arguments.goal_contact)
    found = certify_cell(cell, motion, options, goal_contact=contact, check_ends=not arguments.any_ends)
    tasks = {arm.name: arm.scene for arm in cell.arms}
    report = {
        "status": "ok" if found.verified else "failed",
        "scene": cell.scene.name,
        "between": certificate_report(found.between, options, cell.task(cell.configuration({}), obstacles=False)),
        "arms": {name: certificate_report(own, options, tasks[name]) for name, own in found.arms.items()},
        "violations": list(found.violations),
        **may_touch_report(found.may_touch),
        "versions": versions(),
    }
    hand_out(arguments, console, report, lambda: _show_cell_certificate(console, cell.scene.name, found))
    return 0 if found.verified else FAILED


def _show_cell_certificate(console: Console, scene: str, found: CellCertificate) -> None:
    distances = {"between arms": found.between, **found.arms}
    facts = [
        ("certificate", describe_certificate(found.verified)),
        *(("", violation) for violation in found.violations),
        *uncovered_rows(found.between.uncovered_links),
        ("clearance", ", ".join(f"{name} {at_least_mm(own.min_clearance_m)} mm" for name, own in distances.items())),
    ]
    facts += _may_touch(found.may_touch)
    show(console, scene, ", ".join(found.arms), facts_table(facts))


def _may_touch(pairs: Sequence[tuple[ArmLink, ArmLink]]) -> Iterator[tuple[str, str]]:
    """Summary row of the link pairs that the scene exempts from checking."""
    if pairs:
        named = (" and ".join(f"{arm} {link!r}" for arm, link in pair) for pair in pairs)
        yield "may touch", escape("; ".join(named)) + ": not checked, as declared in the scene"


def _cell_facts(result: CellResult | CellTour, milliseconds: float, files: str) -> Iterator[tuple[str, str]]:
    from hplan.workcell.cell import CellResult

    report = result.report
    if isinstance(result, CellResult):
        yield "motion", f"[bold]{report['makespan_s']:.3f} s[/], {result.how}"
        alone = ", ".join(f"{escape(name)} {seconds:.3f} s" for name, seconds in report["alone_s"].items())
        yield "alone", f"{alone}; in sequence {report['one_after_the_other_s']:.3f} s"
        if any(result.later_s.values()):
            later = (f"{escape(name)} by {later:.2f} s" for name, later in result.later_s.items() if later)
            yield "later", ", ".join(later)
    else:
        faster = report["speed_up_over_one_arm"]
        picked = f"[bold]{report['picked']}[/] in [bold]{report['makespan_s']:.2f} s[/]"
        yield "picked", f"{picked}, {report['s_per_fruit']:.2f} s each, {faster:.2f} times as fast as one arm"
        yield "idle", ", ".join(f"{escape(name)} {seconds:.2f} s" for name, seconds in report["idle_s"].items())
    distances = {"between arms": report["between_arms_mm"], **report.get("arms_mm", {})}
    shown = (
        f"{escape(name)} {'no obstacles near' if d is None else f'{at_least_mm(1e-3 * d)} mm'}"
        for name, d in distances.items()
    )
    yield "clearance", ", ".join(shown) + " or more, proved for all times"
    yield "certificate", describe_certificate(report["verified"])
    between = result.certificate.between if isinstance(result, CellResult) else result.between
    yield from uncovered_rows(between.uncovered_links)
    yield from _may_touch(result.cell.scene.may_touch)
    yield "time", f"[bold]{milliseconds:,.0f} ms[/], including the loading of compiled code"
    yield "files", escape(files)
