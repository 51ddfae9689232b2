"""Hold the analytic C-space of a scene against coal on every node of the joint grid, and say where they differ."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.errors import OptionError, OutputError
from hplan.terminal import FAILED, add_robot, add_scene, command_parser, prepare_folder, run_command

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.validation import Comparison, Difference, Validation

RESULT = "validation.json"

_DESCRIPTION = """\
Ask coal at every node of the joint grid whether the arm touches an obstacle, with its links as capsules, as boxes
and as the URDF's own collision geometry, and compare the answers with the analytic C-space that the planner uses.
"""

_EPILOG = f"""\
coal only: free for us, a collision for coal. Against capsules and the URDF's
  geometry that is a fault. Against boxes it is not: the edges of a square beam
  stand out of the capsule, sideways of the arm plane.
ours only: forbidden for us, free for coal. It costs room, not safety.
contact: decided differently where the distance is zero up to rounding (1e-9 m),
  so that either answer is right; not among the others.

writes DIR/{RESULT} where --out names a folder.

exit status:
  0  no fault
  2  bad input
  5  a fault was found
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compare, write and show; returns the exit status."""
    if arguments.out is not None:
        _prepare(arguments.out)
    result = _validate(arguments, errors)
    if arguments.out is not None:
        from hplan.report import write_report

        write_report(result.as_dict(), arguments.out / RESULT)
    _show(console, result)
    if arguments.out is not None:
        console.print(f"written to {arguments.out / RESULT}\n", markup=False, soft_wrap=True)
    return 0 if result.ok else FAILED


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add_scene(parser)
    add_robot(parser)
    add = parser.add_argument
    add("--step", type=float, default=1.0, metavar="DEG", help="spacing of the joint grid (default: 1)")
    add("--yaw", type=float, metavar="DEG", help="yaw of the arm plane (default: that of the scene's start)")
    add("--out", type=Path, metavar="DIR", help=f"folder to write {RESULT} into (default: none)")
    return parser


def _prepare(folder: Path) -> None:
    """Make the folder and remove an earlier result from it, before any work.

    Raises:
        OutputError: The folder cannot be made or written, or the result not removed.
    """
    prepare_folder(folder)
    earlier = folder / RESULT
    try:
        earlier.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(earlier, error.strerror or str(error)) from error


def _validate(arguments: argparse.Namespace, errors: Console) -> Validation:
    import math

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bars:
        loading = bars.add_task("reading robot and scene", total=None)

        if not (math.isfinite(arguments.step) and arguments.step > 0.0):
            raise OptionError("--step", arguments.step, "a positive number of degrees")
        from hplan.robot import load_robot
        from hplan.scene_file import load_scene
        from hplan.validation import validate_cspace

        robot = load_robot(arguments.robot, limits=arguments.limits)
        scene = load_scene(arguments.scene)
        if arguments.yaw is not None and robot.has_yaw:
            low, high = math.degrees(robot.lower[0]), math.degrees(robot.upper[0])
            if not low - 1e-9 <= arguments.yaw <= high + 1e-9:
                raise OptionError("--yaw", arguments.yaw, f"a number of degrees between {low:g} and {high:g}")
        tasks = {"": loading}

        def progress(what: str, done: int, total: int) -> None:
            if what not in tasks:
                bars.remove_task(tasks.popitem()[1])
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        return validate_cspace(
            robot,
            scene,
            step=math.radians(arguments.step),
            yaw=None if arguments.yaw is None else math.radians(arguments.yaw),
            progress=progress,
        )


def _show(console: Console, result: Validation) -> None:
    """A table that fits 80 columns, then some of the nodes that differ, then the verdict."""
    import math

    from rich import box
    from rich.markup import escape
    from rich.table import Table

    shape = " x ".join(str(count) for count in result.shape)
    steps = sorted({f"{math.degrees(step):.4g}" for step in result.step_rad}, key=float)
    facts = Table.grid(padding=(0, 2, 0, 2))
    facts.add_column(style="dim", no_wrap=True)
    facts.add_column()
    facts.add_row("grid", f"{shape} = {result.nodes:,} nodes, step {', '.join(steps)} deg")
    facts.add_row("arm plane", f"yaw {math.degrees(result.yaw_rad):g} deg, clearance {1e3 * result.clearance_m:g} mm")
    first = result.comparisons[0]
    share = 100.0 * first.occupied / result.nodes
    ratio = f"coal with {first.judge} links takes {result.speed_ratio(first):,.0f} times as long"
    facts.add_row("forbidden", f"{first.occupied:,} nodes, {share:.3f} %")
    facts.add_row("analytic", f"{1e3 * result.analytic_s:.2f} ms; {ratio}")
    console.print(f"\n[bold]{escape(result.scene)}[/] with [bold]{escape(result.robot)}[/]\n")
    console.print(facts)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("ours", no_wrap=True)
    table.add_column("coal", no_wrap=True)
    for heading in ("forbidden", "coal only", "ours only", "differ", "contact", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    for c in result.comparisons:
        style = "bold red" if c.decisive else "yellow"
        table.add_row(
            c.link_model,
            c.judge,
            f"{c.judge_occupied:,}",
            f"[{style}]{c.faults:,}[/]" if c.faults else "0",
            f"{c.conservative:,}",
            f"{100 * (c.faults + c.conservative) / result.nodes:.3f} %",
            f"{c.in_contact:,}",
            f"{c.judge_s:.2f} s",
        )
    console.print(table)
    console.print()
    for c in result.comparisons:
        _show_differences(console, result, c)
    for contact in result.base_contacts:
        near, pair = contact.distance_m, f"{escape(contact.obstacle)} and {escape(contact.link)}"
        how = f"overlap by {_mm(-near)}" if near < 0.0 else f"are {_mm(near)} apart"
        console.print(
            f"[yellow]note[/]: {pair} {how}; the planar joints do not move {escape(contact.link)}, so the C-space "
            "does not show it\n",
            soft_wrap=True,
        )
    seconds = f"{result.total_s:.1f} s in all"
    if result.ok:
        console.print(f"[bold green]no fault[/] at {result.nodes:,} nodes, {seconds}\n")
    else:
        console.print(f"[bold red]{result.faults:,} FAULTS[/] at {result.nodes:,} nodes, {seconds}\n")


def _show_differences(console: Console, result: Validation, c: Comparison) -> None:
    """The worst of the nodes that differ, both ways."""
    from hplan.section import SECTION_ERROR

    pair = f"{c.link_model} and coal's {c.judge}"
    if c.faults:
        word = "[bold red]faults[/]" if c.decisive else "box only"
        console.print(f"{pair}: {word}, to a depth of {_mm(c.deepest_fault_m)}", soft_wrap=True)
        _show_examples(console, result, c.fault_examples)
    if c.conservative:
        text = f"{pair}: ours only, with up to {_mm(c.widest_gap_m)} to spare"
        if c.judge == "capsule":
            text += f"; {c.unexplained:,} beyond the bound on sections, {_mm(SECTION_ERROR)}"
        console.print(text, soft_wrap=True)
        _show_examples(console, result, c.conservative_examples[:3])


def _show_examples(console: Console, result: Validation, examples: Sequence[Difference]) -> None:
    import math

    from rich.markup import escape
    from rich.table import Table

    table = Table.grid(padding=(0, 2, 0, 2))
    table.add_row(*(f"[dim]{escape(name)}[/]" for name in result.joint_names), *("[dim]link[/]", "[dim]obstacle[/]"))
    for example in examples:
        cells: list[Any] = [f"{math.degrees(angle):.3f}" for angle in example.joints_rad]
        table.add_row(*cells, escape(example.link), escape(example.obstacle), _mm(example.distance_m))
    console.print(table)
    console.print()


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"


if __name__ == "__main__":
    sys.exit(main())
