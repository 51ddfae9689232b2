"""Hold the analytic C-space against coal, and say where they differ.

On every node of a scene's joint grid, or on random scenes of every kind of obstacle.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.cli.job_folder import prepare_folder
from hplan.cli.options import add_robot, add_scene, command_parser, robot_of
from hplan.cli.terminal import FAILED, run_command
from hplan.errors import OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.validation.cspace_results import Comparison, Difference, Validation
    from studies.validation.kinds import KindsValidation

RESULT, KINDS_RESULT = "validation.json", "validation-kinds.json"

_DESCRIPTION = """\
Ask coal at every node of the joint grid whether the arm touches an obstacle, with its links as capsules, as boxes
and as the URDF's own collision geometry, and compare the answers with the analytic C-space that the planner uses.
With --kinds do so for random scenes of obstacles of each kind, at random yaws and over intervals of yaw, links as
capsules.
"""

_EPILOG = f"""\
coal only: free for us, a collision for coal. Against capsules and the URDF's
  geometry that is a fault. Against boxes it is not: the edges of a square beam
  stand out of the capsule, sideways of the arm plane.
ours only: forbidden for us, free for coal. It costs room, not safety.
contact: decided differently where the distance is zero up to rounding (1e-9 m),
  so that either answer is right; not among the others.

--kinds: sphere, capsule, box, mesh, points, fruits; all where none is named.
missed: a collision for coal, free for us. It must be 0.
differ: the signs of our exact distances against coal's answers.
free, lost: free by more than 2 mm for coal, and what of this is forbidden for
  us; at one yaw 1 % at most. Over an interval of yaw a node counts where it is
  free at all yaws looked at.
widest: most to spare for coal where we forbid.

writes DIR/{RESULT} or, with --kinds, DIR/{KINDS_RESULT}
  where --out names a folder.

exit status:
  0  no fault; with --kinds nothing missed and no more lost than may be
  2  bad input
  5  a fault was found
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    arguments = _parser().parse_args(argv)
    return run_command(lambda console, errors: _run(arguments, console, errors))


def _run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Compare, write and show; returns the exit status."""
    path = None if arguments.out is None else arguments.out / (RESULT if arguments.kinds is None else KINDS_RESULT)
    if path is not None:
        _prepare(path)
    _check_options(arguments)
    if arguments.kinds is None:
        comparison = _validate(arguments, errors)
        _show(console, comparison)
        ok, report = comparison.ok, comparison.as_dict()
    else:
        kinds = _validate_kinds(arguments, errors)
        _show_kinds(console, kinds)
        ok, report = kinds.ok, kinds.as_dict()
    if path is not None:
        from hplan.planning.report import write_report

        write_report(report, path)
        console.print(f"written to {path}\n", markup=False, soft_wrap=True)
    return 0 if ok else FAILED


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(_DESCRIPTION, _EPILOG)
    add_scene(parser)
    add_robot(parser)
    add = parser.add_argument
    add("--step", type=float, metavar="DEG", help="spacing of the joint grid (default: 1)")
    add("--yaw", type=float, metavar="DEG", help="yaw of the arm plane (default: that of the scene's start)")
    add("--kinds", nargs="*", metavar="KIND", help="random scenes of these kinds of obstacles instead of one scene")
    add("--scenes", type=int, metavar="N", help="random scenes of each kind (default: 200)")
    add("--configurations", type=int, metavar="M", help="configurations of each random scene (default: 20000)")
    add("--seed", type=int, metavar="N", help="seed of the random scenes (default: 0)")
    add("--out", type=Path, metavar="DIR", help="folder to write the numbers into (default: none)")
    return parser


def _check_options(arguments: argparse.Namespace) -> None:
    """Refuse what has no meaning beside `--kinds`, or without it.

    Raises:
        OptionError: An option of the one way is given in the other.
    """
    random = {"--scenes": arguments.scenes, "--configurations": arguments.configurations, "--seed": arguments.seed}
    single = {"SCENE": arguments.scene, "--step": arguments.step, "--yaw": arguments.yaw}
    for name, value in (random if arguments.kinds is None else single).items():
        if value is not None:
            raise OptionError(name, value, "--kinds beside it" if arguments.kinds is None else "nothing beside --kinds")


def _prepare(path: Path) -> None:
    """Make the folder of a result and remove an earlier one from it, before any work.

    Raises:
        OutputError: The folder cannot be made or written, or the result not removed.
    """
    prepare_folder(path.parent)
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def _validate(arguments: argparse.Namespace, errors: Console) -> Validation:
    import math

    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bars:
        loading = bars.add_task("reading robot and scene", total=None)

        step = 1.0 if arguments.step is None else arguments.step
        if not (math.isfinite(step) and step > 0.0):
            raise OptionError("--step", step, "a positive number of degrees")
        from studies.validation.cspace import validate_cspace

        from hplan.scene.file import load_scene

        scene = load_scene(arguments.scene)
        robot = robot_of(arguments, scene)
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
            step=math.radians(step),
            yaw=None if arguments.yaw is None else math.radians(arguments.yaw),
            progress=progress,
        )


def _validate_kinds(arguments: argparse.Namespace, errors: Console) -> KindsValidation:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description:28}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bars:
        task = bars.add_task("loading", total=None)

        from studies.validation.kinds import CONFIGURATIONS, SCENES, validate_kinds
        from studies.validation.scenes import KINDS

        return validate_kinds(
            robot_of(arguments),
            arguments.kinds or KINDS,
            scenes=SCENES if arguments.scenes is None else arguments.scenes,
            configurations=CONFIGURATIONS if arguments.configurations is None else arguments.configurations,
            seed=arguments.seed or 0,
            progress=lambda what, done, total: bars.update(task, description=what, completed=done, total=total),
        )


def _show_kinds(console: Console, result: KindsValidation) -> None:
    """A table that fits 80 columns, some of what was missed, and the verdict."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    console.print(
        f"\n[bold]{result.scenes:,}[/] random scenes of each kind with [bold]{escape(result.robot)}[/], "
        f"{result.configurations:,} configurations each\n",
        soft_wrap=True,
    )
    table = Table(box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    table.add_column("kind", no_wrap=True)
    for heading in ("looked at", "colliding", "missed", "differ", "free", "lost", "widest", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    before = False
    for row in result.results:
        if row.layers and not before:
            table.add_section()
        before = row.layers
        table.add_row(
            f"{row.kind} ~" if row.layers else row.kind,
            f"{row.configurations:,}",
            f"{row.colliding:,}",
            f"[bold red]{row.missed:,}[/]" if row.missed else "0",
            "-" if row.layers else f"[bold red]{row.differing:,}[/]" if row.differing else "0",
            f"{row.spare:,}",
            f"{100.0 * row.lost_share:.3f} %",
            _mm(row.widest_gap_m),
            f"{row.seconds:.0f} s",
        )
    console.print(table)
    if before:
        console.print("~ over intervals of yaw; free and lost are nodes of the planar grids", style="dim")
    console.print()
    for row in result.results:
        for example in row.examples:
            joints = ", ".join(f"{joint:.9g}" for joint in example.joints_rad)
            console.print(
                f"{row.kind} {example.scene}: {example.side}, coal {_mm(example.distance_m)}, joints_rad [{joints}]",
                markup=False,
                soft_wrap=True,
            )
    verdict = "[bold green]nothing missed[/]" if result.ok else "[bold red]FAULTS[/]"
    console.print(f"{verdict}, {result.total_s:.0f} s in all\n")


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
    ratio = f"coal with {first.links} links takes {result.speed_ratio(first):,.0f} times as long"
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
            c.links,
            f"{c.coal_occupied:,}",
            f"[{style}]{c.faults:,}[/]" if c.faults else "0",
            f"{c.conservative:,}",
            f"{100 * (c.faults + c.conservative) / result.nodes:.3f} %",
            f"{c.in_contact:,}",
            f"{c.coal_s:.2f} s",
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
    from hplan.cspace.sections import SECTION_ERROR

    pair = f"{c.link_model} and coal's {c.links}"
    if c.faults:
        word = "[bold red]faults[/]" if c.decisive else "box only"
        console.print(f"{pair}: {word}, to a depth of {_mm(c.deepest_fault_m)}", soft_wrap=True)
        _show_examples(console, result, c.fault_examples)
    if c.conservative:
        text = f"{pair}: ours only, with up to {_mm(c.widest_gap_m)} to spare"
        if c.links == "capsule":
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
