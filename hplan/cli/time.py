"""The command `hplan time`: time a motion through waypoints for any robot that Pinocchio reads."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.cli.options import (
    CommandParser,
    add_hold,
    add_pace,
    check_output_file,
    command_parser,
    held_joints,
    named_output,
)
from hplan.cli.terminal import facts_table, number_table, show_title
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.base.arrays import FloatArray
    from hplan.robot.limits import Limits
    from hplan.timing.trajectory import Trajectory
    from hplan.waypoints import Machine

#: Where the motion goes unless something else is said.
OUT = Path("timed.csv")

_DESCRIPTION = """\
Time the fastest motion through waypoints, from rest to rest, under the URDF's velocity and torque limits and given
acceleration limits. Corners are rounded within a guaranteed deviation. Obstacles are not looked at.
"""

_EPILOG = """\
WAYPOINTS.csv: a header, then a line for each waypoint. Columns NAME_pos_rad or
NAME, in any order, in radians (metres for prismatic joints; continuous joints
count on past a whole turn); other columns are ignored.

joints: revolute, prismatic and continuous ones move; by default all but those
that mimic another or are mimicked. The others are held: at 0, at the limit
nearest to it, or where --hold says.

exit status:
  0  done
  2  bad input
  4  the motion cannot be timed
"""


def parser(prog: str) -> CommandParser:
    """The parser of the command's arguments."""
    parser = command_parser(_DESCRIPTION, _EPILOG, prog=prog)
    add = parser.add_argument
    add("urdf", type=Path, metavar="URDF", help="the robot; its meshes are not needed")
    add("waypoints", type=Path, metavar="WAYPOINTS.csv", help="the waypoints")
    limits = parser.add_mutually_exclusive_group()
    limits.add_argument(
        "--limits", type=Path, metavar="YAML", help="acceleration limits (default: NAME.limits.yaml beside the URDF)"
    )
    limits.add_argument("--acceleration", type=float, metavar="RAD_S2", help="one acceleration limit for all joints")
    add("--no-torque", action="store_true", help="do not limit the torque")
    add("--joints", nargs="+", metavar="NAME", help="the joints that move")
    add_hold(parser)
    add("--deviation", type=float, default=1.0, metavar="DEG", help="largest distance from the polyline (default: 1)")
    add_pace(parser)
    add("--out", type=Path, default=OUT, metavar="FILE.csv", help="file to write (default: timed.csv)")
    add("--quiet", action="store_true", help="no summary")
    parser.on_usage_error = lambda _, words: _remove_earlier(words)
    return parser


def _remove_earlier(words: Sequence[str]) -> None:
    """Remove an earlier result where arguments cannot be understood, unless they name it as something to read too."""
    out = named_output(words, OUT)
    if out is None or out.suffix != ".csv" or not out.is_file():
        return
    named = [Path(text) for text in words if Path(text).exists() and Path(text).samefile(out)]
    given = sum(text == "--out" for text in words)
    if len(named) <= given:
        with contextlib.suppress(OSError):
            out.unlink()


def _prepare(arguments: argparse.Namespace) -> None:
    """Remove an earlier result, which must not be taken for this one's, before any work.

    Raises:
        OptionError: The result would replace something that is read.
        OutputError: There is no such folder.
    """
    check_output_file(arguments.out, (arguments.urdf, arguments.waypoints, arguments.limits))
    out = arguments.out.resolve()
    if out.is_file() and out.suffix == ".csv":
        with contextlib.suppress(OSError):  # what cannot be removed cannot be replaced either, and is reported then
            out.unlink()


def run(arguments: argparse.Namespace, console: Console, _: Console) -> int:
    """Read, time, write, and say how it went; returns the exit status."""
    from hplan.timing.trajectory import write_csv
    from hplan.waypoints import read_machine, read_waypoints, time_waypoints

    _prepare(arguments)
    machine = read_machine(arguments.urdf, arguments.joints, hold=held_joints(arguments))
    waypoints = read_waypoints(arguments.waypoints, machine.joint_names)
    limits = _limits(arguments, machine)
    trajectory = time_waypoints(
        machine.model,
        waypoints,
        limits,
        deviation_rad=math.radians(arguments.deviation),
        rate_hz=arguments.rate_hz,
        speed=arguments.speed,
    )
    write_csv(trajectory, arguments.out)
    if not arguments.quiet:
        _show(console, arguments, machine, waypoints, limits, trajectory)
    return 0


def _limits(arguments: argparse.Namespace, machine: Machine) -> Limits:
    """The URDF's limits, with acceleration (and jerk) from the YAML or the number given."""
    from hplan.robot.files import read_limits
    from hplan.waypoints import limits_of

    torque = not arguments.no_torque
    if arguments.acceleration is not None:
        if not (math.isfinite(arguments.acceleration) and arguments.acceleration >= 0.0):
            raise OptionError("--acceleration", arguments.acceleration, "a finite number >= 0")
        return limits_of(machine.model, arguments.acceleration, torque=torque)
    path = arguments.urdf.with_suffix(".limits.yaml") if arguments.limits is None else arguments.limits
    if arguments.limits is None and not path.exists():
        raise OptionError(
            "--acceleration",
            None,
            f"acceleration limits, which a URDF cannot hold: a number here, or a file by --limits ({path} is missing)",
        )
    acceleration, jerk = read_limits(path, machine.joint_names, machine.held)
    return limits_of(machine.model, acceleration, jerk, torque=torque)


def _show(
    console: Console,
    arguments: argparse.Namespace,
    machine: Machine,
    waypoints: FloatArray,
    limits: Limits,
    trajectory: Trajectory,
) -> None:
    """Facts, then a row for each joint; fits 80 columns, unless names are long."""
    import numpy as np
    from rich.markup import escape

    from hplan.waypoints import AT_LIMIT, largest_deviation, limit_shares

    full, paced = limit_shares(trajectory, limits), limit_shares(trajectory, limits.scaled(arguments.speed))
    facts = facts_table()
    length = float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())
    facts.add_row("waypoints", f"{len(waypoints):,}, {math.degrees(length):.2f} deg along the lines between them")
    rows = "1 row: nothing to move" if trajectory.samples == 1 else f"{trajectory.samples:,} rows"
    facts.add_row("motion", f"[bold]{trajectory.duration:.3f} s[/], {rows} at {arguments.rate_hz:g} Hz")
    deviation = math.degrees(largest_deviation(trajectory.position, waypoints))
    facts.add_row("deviation", f"{deviation:.4f} deg from the lines at most, {arguments.deviation:g} deg allowed")
    facts.add_row("at a limit", f"{100.0 * paced.bound:.1f} % of the time")
    for name, value in machine.held.items():
        facts.add_row("held", f"{escape(name)} at {'its neutral position' if value is None else f'{value:g} rad'}")
    facts.add_row("file", escape(str(arguments.out)))
    table = number_table()
    table.add_column("use of limits, %", no_wrap=True)
    columns = {"velocity": full.velocity, "acceleration": full.acceleration, "torque": full.torque, "jerk": full.jerk}
    shown = {name: values for name, values in columns.items() if values is not None}
    for heading in (*shown, "holds the motion back"):
        table.add_column(heading, justify="right", no_wrap=True)
    for joint, name in enumerate(machine.joint_names):
        shares = (f"{100.0 * values[joint]:.1f}" for values in shown.values())
        table.add_row(escape(name), *shares, f"{100.0 * paced.binding[joint]:.1f} % of the time")
    show_title(console, arguments.waypoints.name, machine.model.name)
    console.print(facts)
    console.print()
    console.print(table)
    torque = "" if full.torque is not None else "; torque is not limited"
    console.print(f"\nholds the motion back: uses {100.0 * AT_LIMIT:g} % or more of a limit{torque}\n", style="dim")
