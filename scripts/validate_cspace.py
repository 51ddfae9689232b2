"""Hold the analytic C-space against coal, and say where they differ.

On every node of a scene's joint grid, or on random scenes of every kind of obstacle.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.job_folder import prepare_folder
from hplan.apps.cli.options import add_shared, command_parser, robot_of
from hplan.apps.cli.terminal import FAILED, run_command
from hplan.errors import OptionError, OutputError

if TYPE_CHECKING:
    from rich.console import Console
    from studies.validation.cspace import Validation
    from studies.validation.kinds import KindsValidation

RESULT, KINDS_RESULT = "validation.json", "validation-kinds.json"

_DESCRIPTION = """\
Ask coal at every node of the joint grid whether the arm touches an obstacle, with its links as capsules, as boxes
and as the URDF's own collision geometry, and compare the answers with the analytic C-space that the planner uses.
With --kinds do so for random scenes of obstacles of each kind, at random yaws, links as capsules.
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
  us; 1 % at most.
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
        comparison = _validate(arguments)
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
    add_shared(parser, "scene")
    add_shared(parser, "robot", "parts")
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


def _validate(arguments: argparse.Namespace) -> Validation:
    import math

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
    yaw = None if arguments.yaw is None else math.radians(arguments.yaw)
    return validate_cspace(robot, scene, step=math.radians(step), yaw=yaw)


def _validate_kinds(arguments: argparse.Namespace, errors: Console) -> KindsValidation:
    from studies.validation.kinds import CONFIGURATIONS, SCENES, validate_kinds
    from studies.validation.scenes import KINDS

    return validate_kinds(
        robot_of(arguments),
        arguments.kinds or KINDS,
        scenes=SCENES if arguments.scenes is None else arguments.scenes,
        configurations=CONFIGURATIONS if arguments.configurations is None else arguments.configurations,
        seed=arguments.seed or 0,
        told=lambda row: errors.print(f"{row.kind}: {row.seconds:.0f} s", markup=False),
    )


def _show_kinds(console: Console, result: KindsValidation) -> None:
    """A table, some of what was missed, and the verdict."""
    each = f"{result.configurations:,} configurations each"
    _print(console, f"\n{result.scenes:,} random scenes of each kind with {result.robot}, {each}")
    _table(
        console,
        ("kind", "looked at", "colliding", "missed", "differ", "free", "lost", "widest"),
        [
            (
                row.kind, f"{row.configurations:,}", f"{row.colliding:,}", f"{row.missed:,}",
                f"{row.differing:,}", f"{row.spare:,}", f"{100.0 * row.lost_share:.3f} %",
                _mm(row.widest_gap_m),
            )
            for row in result.results
        ],
    )  # fmt: skip
    for row in result.results:
        for example in row.examples:
            joints = ", ".join(f"{joint:.9g}" for joint in example.joints_rad)
            where = f"{row.kind} {example.scene}: {example.side}"
            _print(console, f"{where}, coal {_mm(example.distance_m)}, joints_rad [{joints}]")
    _print(
        console,
        f"{'nothing missed' if result.ok else 'FAULTS'}, {result.total_s:.0f} s in all",
    )


def _show(console: Console, result: Validation) -> None:
    """A table, then some of the nodes that differ, then the verdict."""
    _print(
        console, f"\n{result.scene} with {result.robot}: {' x '.join(map(str, result.shape))} = {result.nodes:,} nodes"
    )
    first = result.comparisons[0]
    ratio = f"coal with {first.links} links takes {first.coal_s / result.analytic_s:,.0f} times as long"
    _print(console, f"forbidden {first.occupied:,} nodes; analytic {1e3 * result.analytic_s:.2f} ms; {ratio}")
    _table(
        console,
        ("ours", "coal", "forbidden", "coal only", "ours only", "beyond sections", "contact", "time"),
        [
            (
                c.link_model, c.links, f"{c.coal_occupied:,}", f"{c.faults:,}{'' if c.decisive else ' (no fault)'}",
                f"{c.conservative:,}", f"{c.unexplained:,}", f"{c.in_contact:,}", f"{c.coal_s:.2f} s",
            )
            for c in result.comparisons
        ],
    )  # fmt: skip
    for c in result.comparisons:
        for word, examples in (("coal only", c.fault_examples), ("ours only", c.conservative_examples[:3])):
            for example in examples:
                joints = zip(result.joint_names, example.joints_rad, strict=True)
                at = ", ".join(f"{name} {angle:.6g}" for name, angle in joints)
                pair = f"{example.link} and {example.obstacle} {_mm(example.distance_m)}"
                _print(console, f"{c.link_model} and coal's {c.links}: {word}: {pair} apart at {at} rad")
    for contact in result.base_contacts:
        how = "overlap" if contact.distance_m < 0.0 else "are near"
        _print(console, f"note: {contact.obstacle} and {contact.link} {how}, which no planar joint moves")
    verdict = "no fault" if result.ok else f"{result.faults:,} FAULTS"
    _print(console, f"{verdict} at {result.nodes:,} nodes, {result.total_s:.1f} s in all")


def _print(console: Console, line: str) -> None:
    console.print(line, markup=False, soft_wrap=True)


def _table(console: Console, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Columns as wide as what stands in them."""
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for row in (headings, *rows):
        _print(console, "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3g} mm"


if __name__ == "__main__":
    sys.exit(main())
