"""Inspect a robot file: list all faults with line and remedy.

Shown are also its joints with their limits, candidates for the tool frame, links without collision shapes, and links
that touch at the zero or the middle configuration.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.options import (
    add_shared,
    check_output_file,
    command_parser,
    robot_options,
    xacro_arguments,
)
from hplan.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console
    from rich.table import Table

    from hplan.robot.inspection import Inspection
    from hplan.robot.model import Robot

_EPILOG = """\
--write-limits writes every acceleration limit that the URDF has, a guess for
each one that it lacks, and for each velocity and effort that is 0. Beside the
URDF and called NAME.limits.yaml, the file is found by all commands.

--repair mends decimal commas, misspelled names, second materials, stray
elements, missing visuals, and inertias that no body has. Comments are lost.

exit status:
  0  the robot can be loaded
  2  it has faults, or bad input
"""


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("robot", metavar="URDF", help="URDF or xacro file, or name of a robot")
    add("--limits", type=Path, metavar="YAML", help="limits file, MoveIt's joint_limits.yaml, or name of a robot")
    add_shared(parser, "parts")
    add("--write-limits", type=Path, metavar="FILE", help="write a limits file to complete")
    add("--repair", type=Path, metavar="FILE", help="write a mended copy of the URDF")
    add("--picture", type=Path, metavar="FILE.png", help="draw the arm (needs the extra figures)")
    add_shared(parser, "force", "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Inspect the file, write what was requested; return the exit status."""
    from hplan.base.files import YAML_COMMENT, write_marked
    from hplan.robot.inspection import inspect_robot, limits_template, repair_urdf

    for option in ("write_limits", "repair", "picture"):
        if getattr(arguments, option) is not None:
            check_output_file(getattr(arguments, option), f"--{option.replace('_', '-')}", force=arguments.force)
    found = inspect_robot(arguments.robot, **robot_options(arguments))
    if not arguments.quiet:
        _show_findings(console, found)
    written = list[Path]()
    if arguments.write_limits is not None:
        text = limits_template(found.name, found.urdf, found.joints)
        written.append(write_marked(arguments.write_limits, text, YAML_COMMENT))
    if arguments.repair is not None:
        options = {"package_dirs": arguments.package_dir, "xacro_args": xacro_arguments(arguments)}
        written.append(_repair(arguments, console, *repair_urdf(found.path, arguments.repair, **options)))
    if arguments.picture is not None:
        if found.robot is None:
            raise InputError(f"{arguments.picture}: an arm that cannot be loaded cannot be drawn")
        from hplan.apps.view.figures import write_png

        write_png(draw_arm(found.robot), arguments.picture)
        written.append(arguments.picture)
    for file in written:
        if not arguments.quiet:
            console.print(f"written: {file}", markup=False, soft_wrap=True)
    if found.faults:
        for fault in found.faults if arguments.quiet else ():
            errors.print(fault, markup=False, soft_wrap=True)
        return InputError.exit_status
    return 0


def _repair(
    arguments: argparse.Namespace, console: Console, text: str, mended: tuple[str, ...], faults: tuple[str, ...]
) -> Path:
    from hplan.base.files import HTML_COMMENT, write_marked

    for words, items in (("mended", mended), ("not mended", faults)):
        for item in () if arguments.quiet else items:
            console.print(f"{words}: {item}", markup=False, soft_wrap=True)
    return write_marked(arguments.repair, text, HTML_COMMENT)


def _show_findings(console: Console, found: Inspection) -> None:
    """Print the inspection."""
    from hplan.apps.cli.terminal import escape, facts_table, show

    state = (
        f"loads in {found.load_s:.2f} s"
        if not found.faults
        else f"{len(found.faults)} fault{'s' * (len(found.faults) != 1)}"
    )
    show(console, str(found.path), found.name, facts_table(_robot_facts(found, state)))
    for heading, lines in (("fault", found.faults), ("warning", found.warnings)):
        if lines:
            console.print(_lines_table(heading, lines))
            console.print()
    console.print(_joints_table(found))
    if found.touching:
        console.print()
        console.print("links that touch; if they may, give an SRDF, or --allow-neighbours for neighbours")
        for pair in found.touching:
            kind = "Adjacent" if pair.are_neighbours else "Default"
            line = f'<disable_collisions link1="{pair.first}" link2="{pair.second}" reason="{kind}"/>'
            console.print(f"  {escape(line)}  [dim]at {pair.at}[/]", soft_wrap=True)
    console.print()


def _robot_facts(found: Inspection, state: str) -> Iterator[tuple[str, str]]:
    from hplan.apps.cli.terminal import escape

    yield "state", state
    yield "tool frame", escape(found.tool_frame)
    others = [name for name in found.tool_frames if name != found.tool_frame]
    if others:
        yield "others at ends", escape(", ".join(others[:8]))
    if found.without_shape:
        yield "no collision", escape(", ".join(found.without_shape))


def _lines_table(heading: str, faults: tuple[str, ...]) -> Table:
    from hplan.apps.cli.terminal import escape, number_table
    from hplan.robot.faults import split_line

    rows = ((str(line or ""), escape(text)) for line, text in map(split_line, faults))
    return number_table(("line", heading), rows, texts=(heading,))


def _joints_table(found: Inspection) -> Table:
    """Table of the joints and their limits; accelerations from the limits file, if the robot can be loaded."""
    from hplan.apps.cli.terminal import escape, number_table

    accelerations = [joint.limits.get("acceleration") for joint in found.joints]
    velocities = [joint.limits.get("velocity") for joint in found.joints]
    efforts = [joint.limits.get("effort") for joint in found.joints]
    if found.robot is not None and not found.faults:
        accelerations, velocities, efforts = (
            values.tolist()
            for values in (
                found.robot.acceleration_limit, found.robot.velocity_limit, found.robot.torque_limit
            )
        )  # fmt: skip
    rows = []
    for joint, *limits in zip(found.joints, velocities, accelerations, efforts, strict=True):
        ends = [joint.limits.get(key) for key in ("lower", "upper")]
        unit = "m" if joint.kind == "prismatic" else "rad"
        rows.append((escape(joint.name), joint.kind, unit, *map(_format_cell, (*ends, *limits))))
    headings = ("joint", "kind", "unit", "lower", "upper", "velocity", "acceleration", "effort")
    return number_table(headings, rows, texts=("joint", "kind", "unit"))


def _format_cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def draw_arm(robot: Robot) -> Figure:
    """Draw a robot's links at the middle of its joint ranges, a colour for each.

    Raises:
        InputError: Matplotlib is not installed.
    """
    import numpy as np

    from hplan.apps.view.figures import LINKS, apply_style, new_figure
    from hplan.robot.inspection import shape_triangles

    @apply_style
    def draw() -> Figure:
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        parts = shape_triangles(robot, np.clip(np.zeros(robot.dof) + 0.3, robot.lower, robot.upper))
        figure = new_figure(6.0, 6.0, robot.name)
        axes: Any = figure.add_subplot(projection="3d")
        # Meshes with more triangles are drawn in part; they look alike [triangles].
        most = 6000
        for number, triangles in enumerate(parts.values()):
            shown = triangles[:: max(1, len(triangles) // most)]
            color = LINKS[number % len(LINKS)]
            axes.add_collection3d(Poly3DCollection(shown, facecolors=color, shade=True))
        points = np.concatenate([part.reshape(-1, 3) for part in parts.values()] or [np.zeros((1, 3))])
        middle, half = 0.5 * (points.max(0) + points.min(0)), max(0.05, 0.5 * float(np.ptp(points, axis=0).max()))
        for name, center in zip("xyz", middle.tolist(), strict=True):
            getattr(axes, f"set_{name}lim")(center - half, center + half)
            getattr(axes, f"set_{name}label")(f"{name} [m]")
        axes.set_box_aspect((1, 1, 1))
        return figure

    return draw()
