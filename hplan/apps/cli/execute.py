"""Run a trajectory in MuJoCo: a simulated arm among the scene's obstacles.

The arm is the robot's own URDF with torque motors; obstacles are solid bodies. A 1 kHz controller tracks the
trajectory (inverse-dynamics feedforward, PD feedback). Trajectories of any planner are accepted. The simulated masses
may differ from the controller's model, and its commands may be delayed. Given a tracking error, the command reports
whether the joints stayed within it.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hplan.apps.cli.options import add_shared, command_parser, robot_of, tracking_of
from hplan.apps.cli.terminal import FAILED, escape, facts_table, number_table

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.apps.execution.simulation import Execution
    from hplan.scene.model import Scene

_EPILOG = """\
the CSV: one header line with time_s and NAME_pos_rad for each joint of the
  robot (NAME_pos_m for a prismatic joint), in any order. NAME_vel_rad_s
  (NAME_vel_m_s) is used if all joints have it. Otherwise velocities come from
  parabolas through three samples, and are zero at both ends. Between samples
  the motion is a cubic. Other columns are ignored.

needs the extra `execution`: pip install 'hplan[execution]'

exit status:
  0  no contact, or none deeper than the obstacle's compliance; the arm ended
     at the goal (0.5 deg, 5 mm) and stayed there
  2  bad input
  5  a deeper contact, or the arm did not end at the goal
"""


def run(arguments: argparse.Namespace, console: Console, _: Console) -> int:
    """Execute the motion and print the result; return the exit status."""
    from hplan.apps.execution.simulated_arm import Plant
    from hplan.apps.execution.simulation import execute, read_motion
    from hplan.scene.file import load_scene

    motion = read_motion(arguments.trajectory)
    scene = load_scene(arguments.scene)
    robot = robot_of(arguments, scene)
    plant = Plant(arguments.mass_factor, 1e-3 * arguments.command_delay, arguments.bandwidth)
    result = execute(robot, scene, motion, plant)
    _show_execution(console, arguments.trajectory, scene, result)
    tracking = tracking_of(arguments)
    if not tracking.is_exact:
        kept = "no joint was" if result.is_within(tracking) else "[bold red]some joint was[/]"
        console.print(f"{kept} farther from its reference than a tracking error of {tracking.summary(robot.slides)}\n")
    return 0 if result.ok else FAILED


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument("trajectory", type=Path, metavar="TRAJECTORY.csv", help="CSV of the motion")
    add_shared(parser, "scene", "robot", "parts")
    add = parser.add_argument
    add(
        "--mass-factor",
        type=float,
        default=1.0,
        metavar="F",
        help="simulated masses as multiples of those in the controller's model (default: 1)",
    )
    add(
        "--command-delay",
        type=float,
        default=0.0,
        metavar="MS",
        help="delay of the controller's commands in milliseconds (default: 0)",
    )
    add(
        "--bandwidth",
        type=float,
        default=40.0,
        metavar="RAD/S",
        help="bandwidth of the position loop in rad/s (default: 40)",
    )
    add_shared(parser, "tracking")
    return parser


def _show_execution(console: Console, path: Path, scene: Scene, result: Execution) -> None:
    """Print errors and torques of each joint, contacts and the verdict."""
    from hplan.base.units import joint_unit

    units = [joint_unit(slides) for slides in result.slides]
    console.print(f"\n[bold]{escape(path)}[/] in [bold]{escape(scene.name)}[/]\n", soft_wrap=True)
    headings = "joint", "path error", "goal error", "required torque", "commanded", "limit"
    table = number_table(headings, (), texts=("joint",))
    for joint, (name, unit) in enumerate(zip(result.joint_names, units, strict=True)):
        peak, limit = result.peak_torque_nm[joint], result.torque_limit_nm[joint]
        table.add_row(
            escape(name),
            unit.error(result.max_tracking_error_rad[joint], ".4f"),
            unit.error(result.final_error_rad[joint], ".4f"),
            f"{result.needed_torque_nm[joint]:.1f} {unit.effort}",
            f"[bold red]{peak:.1f}[/]" if peak > limit else f"{peak:.1f}",
            f"{limit:.1f}",
        )
    console.print(table)
    console.print()
    facts = facts_table(indent=0)
    held = result.time[-1] - result.duration_s
    facts.add_row("motion", f"{result.duration_s:.3f} s, then held for {held:.2f} s")
    if result.nearest is not None:
        nearest = result.nearest
        gap = f"{1e3 * nearest.distance_m:.2f} mm between {escape(nearest.link)} and {escape(nearest.obstacle)}"
        facts.add_row("nearest", gap)
    if result.saturated_s > 0.0:
        joints = ", ".join(escape(name) for name in result.torque_exceeded)
        facts.add_row(
            "torque", f"commands [bold red]above the motors' limits[/] for {result.saturated_s:.3f} s: {joints}"
        )
    off = [unit.error(error) for unit, error in zip(units, result.start_error_rad, strict=True) if error > 1e-6]
    if off:
        facts.add_row(
            "start", f"[yellow]the joints of the first sample differ from the scene's start by {', '.join(off)}[/]"
        )
    for push in result.pushes:
        pair = f"{escape(push.link)} pushed {escape(push.obstacle)}"
        facts.add_row("push", f"{pair} up to {1e3 * push.depth_m:.2f} of {1e3 * push.yields_m:.2f} mm deep")
    for touch in result.contacts:
        pair = f"{escape(touch.link)} touched {escape(touch.obstacle)}"
        depth = f"up to {1e3 * touch.depth_m:.2f} mm deep"
        facts.add_row("contact", f"[bold red]{pair}[/] at {touch.time_s:.3f} s, {depth}")
    console.print(facts)
    console.print()
    obstacles = list(dict.fromkeys(touch.obstacle for touch in result.contacts))
    more = f" and {len(obstacles) - 3} more" if len(obstacles) > 3 else ""
    touched = f"touched {escape(', '.join(obstacles[:3]))}{more}" if obstacles else "touched nothing"
    ended = "ended at the goal" if result.ended_at_goal else "did not end at the goal"
    console.print(f"[bold {'green' if result.ok else 'red'}]{touched}, {ended}[/]\n")
