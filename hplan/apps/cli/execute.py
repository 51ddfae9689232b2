"""Run a trajectory in MuJoCo: a simulated arm among the scene's obstacles.

The arm is the robot's own URDF with torque motors; obstacles are solid bodies. A 1 kHz controller tracks the
trajectory (inverse-dynamics feedforward, PD feedback). Trajectories of any planner are accepted. The simulated masses
may differ from the controller's model, and its commands may be delayed. Given a tracking error, the command reports
whether the joints stayed within it. Fruit that a plan or tour picks may be touched from its approach on, and is then
taken off the tree.

With --bending, limbs of trees bend and fruit hangs on stalks. The command reports the force, stress and deflection of
each limb that is touched, limbs that break and fruit that is knocked off; for a plan's folder next to the bounds of its
certificate.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from hplan.apps.cli.options import add_shared, check_output_file, command_parser, robot_of, tracking_of
from hplan.apps.cli.terminal import FAILED, escape, facts_table, hand_out, number_table
from hplan.base.files import is_folder
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.apps.cli.finished_job import FinishedJob
    from hplan.apps.execution.bending_wood import BendingTrees
    from hplan.apps.execution.simulation import Execution, Pick, RecordedMotion
    from hplan.apps.execution.tree_response import TreeResponse
    from hplan.robot.model import Robot
    from hplan.scene.model import Scene
    from hplan.trajectory.trajectory import Trajectory

#: The certificate's bounds of a contact, by limb or fruit and link.
ContactBounds: TypeAlias = Mapping[tuple[str, str], Mapping[str, Any]]

#: Bounded quantities of a contact.
_BOUNDS = ("force_n", "stress_mpa")

#: Displacements of fruit above this are reported [m].
_VISIBLE_M = 1e-3

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
  5  a deeper contact, or the arm did not end at the goal; with --bending also
     a force or stress above the scene's limits, a broken limb, or fruit that
     was knocked off
"""

#: Options of `BendingTrees`, with their argument, help and metavar.
_TREE_OPTIONS = (
    ("youngs_modulus_gpa", "--youngs-modulus", "Young's modulus of the wood in GPa (default: the scene's largest, "
        "with which forces are largest)", "GPA"),
    ("damping_ratio", "--wood-damping", "damping ratio of limbs and hanging fruit (default: 0.07)", "RATIO"),
    ("wood_strength_mpa", "--wood-strength", "bending stress in MPa at which a limb breaks (default: 40)", "MPA"),
    ("stalk_strength_n", "--stalk-strength", "force in newtons at which fruit is knocked off (default: 20)", "N"),
    ("friction", "--friction", "coefficient of friction between the arm and limbs or fruit (default: 0)", "MU"),
    ("wind", "--wind", "mean speed of a gusty wind in m/s, and its heading in degrees from the x axis",
        ("SPEED", "DEG")),
)  # fmt: skip


class _Outcome(NamedTuple):
    """An execution with what its report compares it with.

    Attributes:
        scene: The scene.
        result: The execution.
        bounds: Bounds of the certificate for contacts with limbs and fruit.
        picked: Picking time of each fruit [s].
        grasp_s: Time when the goal fruit is grasped [s].
        goal_bound_m: Bound of the goal fruit's displacement at that time [m]; None without one.
    """

    scene: Scene
    result: Execution
    bounds: ContactBounds
    picked: Mapping[str, float]
    grasp_s: float
    goal_bound_m: float | None

    @property
    def goal_displacement_m(self) -> float | None:
        """Displacement of the goal fruit when it is grasped [m]; None without one that hangs."""
        trees, goal = self.result.trees, self.scene.goal.fruit
        return None if trees is None or goal is None else trees.displacement_at(goal, self.grasp_s)


def run(arguments: argparse.Namespace, console: Console, _: Console) -> int:
    """Execute the motion and print the result; return the exit status."""
    from hplan.apps.cli.finished_job import FinishedJob
    from hplan.apps.execution.simulated_arm import Plant
    from hplan.apps.execution.simulation import execute, picks_in, read_motion
    from hplan.scene.file import load_scene

    path: Path = arguments.trajectory
    job = FinishedJob(path, tours=True) if is_folder(path) else None
    motion: Trajectory | RecordedMotion
    picked: Mapping[str, float] = {}
    picks: Sequence[Pick] = ()
    if job is None:
        motion = read_motion(path)
    else:
        motion = job.trajectory()
        shown = job.playback(motion)
        picked, picks = shown.picked, picks_in(shown.picked, shown.phases)
    scene = load_scene(job.scene if arguments.scene is None and job is not None else arguments.scene)
    robot = robot_of(arguments, scene, job)
    plant = Plant(arguments.mass_factor, 1e-3 * arguments.command_delay, arguments.bandwidth)
    trees = _bending_trees(arguments)
    for file, option in ((arguments.report, "--report"), (arguments.page, "--page")):
        if file is not None:
            check_output_file(file, option, force=arguments.force)
    result = execute(robot, scene, motion, plant, trees, picks=picks)
    outcome = _Outcome(
        scene, result, _certified_bounds(job, robot, result.trees), picked,
        picked.get(scene.goal.fruit or "", float(motion.time[-1] - motion.time[0])),
        None if job is None else job.report["certificate"].get("goal_displacement_m"),
    )  # fmt: skip
    if arguments.page is not None:
        _write_page(robot, outcome, arguments.page)
    report = {"status": "ok" if result.ok else "failed", "scene": scene.name, "robot": robot.name}
    report |= _execution_report(outcome)
    hand_out(arguments, console, report, lambda: _show(console, arguments, outcome))
    return 0 if result.ok else FAILED


def _show(console: Console, arguments: argparse.Namespace, outcome: _Outcome) -> None:
    """Print the result, and whether it is within the tracking error."""
    _show_execution(console, arguments.trajectory, outcome)
    tracking, result = tracking_of(arguments), outcome.result
    if not tracking.is_exact:
        kept = "no joint was" if result.is_within(tracking) else "[bold red]some joint was[/]"
        units = tracking.summary(result.slides)
        console.print(f"{kept} farther from its reference than a tracking error of {units}\n")


def _bending_trees(arguments: argparse.Namespace) -> BendingTrees | None:
    """Properties of the trees; None without `--bending`.

    Raises:
        OptionError: A property is given without `--bending`, or is out of its range.
    """
    from hplan.apps.execution.bending_wood import BendingTrees
    from hplan.apps.execution.wind import Wind

    given = {name: getattr(arguments, name) for name, *_ in _TREE_OPTIONS if getattr(arguments, name) is not None}
    if not arguments.bending:
        for name, option, *_ in _TREE_OPTIONS:
            if name in given:
                raise OptionError(option, given[name], "no value without --bending")
        return None
    if "wind" in given:
        speed, heading = given["wind"]
        given["wind"] = Wind(speed_m_s=speed, heading_deg=heading)
    return BendingTrees(**given)


def _certified_bounds(job: FinishedJob | None, robot: Robot, trees: TreeResponse | None) -> ContactBounds:
    """Bounds of the certificate for the measured contacts, by limb or fruit and link.

    MuJoCo joins links that no joint moves relative to each other, so the joint identifies the link.
    """
    pushes = () if job is None else job.report["certificate"].get("pushes") or ()
    by_joint: dict[tuple[str, int], dict[str, float]] = {}
    for push in pushes:
        if push.get("force_n") is not None:
            known = by_joint.setdefault((push["obstacle"], _joint_of(robot, push["link"])), {})
            for name in _BOUNDS:
                known[name] = max(known.get(name, 0.0), push.get(name) or 0.0)
    found = {}
    for one in () if trees is None else trees.contacts:
        bound = by_joint.get((one.limb, _joint_of(robot, one.link)))
        if bound is not None:
            found[one.limb, one.link] = bound
    return found


def _joint_of(robot: Robot, link: str) -> int:
    """Number of the joint that moves a link."""
    return int(robot.model.frames[robot.frame_number(link)].parentJoint)


def _write_page(robot: Robot, outcome: _Outcome, path: Path) -> None:
    """Write the animated page of the simulated motion."""
    from hplan.apps.view.page import write_page
    from hplan.apps.view.playback import Playback

    result, words = outcome.result, _describe(outcome)
    bodies = None if result.trees is None else result.trees.motions
    verdict = result.ok, f"{words[0].upper()}{words[1:]}."
    shown = Playback(result.trajectory, outcome.picked, bodies=bodies, outcome=verdict)
    write_page(robot, outcome.scene, shown, path)


def _execution_report(outcome: _Outcome) -> dict[str, Any]:
    """Report of an execution, as JSON values."""
    from dataclasses import asdict

    result, bounds = outcome.result, outcome.bounds

    names = (
        "duration_s", "ended_at_goal", "saturated_s", "joint_names", "start_error_rad", "max_tracking_error_rad",
        "final_error_rad", "needed_torque_nm", "peak_torque_nm", "torque_limit_nm",
    )  # fmt: skip
    report: dict[str, Any] = {name: getattr(result, name) for name in names}
    report |= {name: [asdict(one) for one in getattr(result, name)] for name in ("contacts", "pushes")}
    report["nearest"] = None if result.nearest is None else asdict(result.nearest)
    trees = result.trees
    if trees is not None:
        contacts = [
            asdict(one) | {"bound": bounds.get((one.limb, one.link)), "within_limits": one.is_within(trees.wood)}
            for one in trees.contacts
        ]
        moved = {name: value for name, value in trees.fruit_displacement_m.items() if value > _VISIBLE_M}
        report["trees"] = {
            "contacts": contacts,
            "broken": [asdict(one) for one in trees.broken],
            "knocked_off": [asdict(one) for one in trees.knocked_off],
            "fruit_displacement_m": moved,
            "goal": {
                "grasp_s": outcome.grasp_s,
                "displacement_m": outcome.goal_displacement_m,
                "bound_m": outcome.goal_bound_m,
            },
            "limits": {key: getattr(trees.wood, key) for key in ("contact_force", "wood_stress_mpa", "fruit_force")},
        }
    return report


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    add = parser.add_argument
    add("trajectory", type=Path, metavar="FOLDER_OR_CSV", help="CSV of the motion, or output folder of a plan or tour")
    add_shared(parser, "scene", "robot", "parts", scene="the job's, or the paper's reference scene")
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
    add("--bending", action="store_true", help="simulate limbs that bend and fruit that hangs; in a scene without "
        "limbs they are found by proximity")  # fmt: skip
    for name, option, about, metavar in _TREE_OPTIONS:
        count = 2 if isinstance(metavar, tuple) else None
        add(option, dest=name, type=float, nargs=count, metavar=metavar, help=f"with --bending: {about}")
    add("--page", type=Path, metavar="FILE", help="write an animated page of the simulated motion to this file")
    add("--report", type=Path, metavar="FILE", help="write the result as JSON to this file")
    add_shared(parser, "force")
    add("--json", action="store_true", help="print the result as JSON instead of a summary")
    add("--quiet", action="store_true", help="print no summary")
    return parser


def _show_execution(console: Console, path: Path, outcome: _Outcome) -> None:
    """Print errors and torques of each joint, contacts, the response of the trees and the verdict."""
    from hplan.base.units import joint_unit

    scene, result = outcome.scene, outcome.result
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
    if result.trees is not None:
        _show_trees(console, result.trees, outcome)
    console.print(f"[bold {'green' if result.ok else 'red'}]{escape(_describe(outcome))}[/]\n")


def _describe(outcome: _Outcome) -> str:
    """The verdict in a few words: contacts, damage and the end of the motion."""
    result = outcome.result
    obstacles = list(dict.fromkeys(touch.obstacle for touch in result.contacts))
    more = f" and {len(obstacles) - 3} more" if len(obstacles) > 3 else ""
    words = [f"touched {', '.join(obstacles[:3])}{more}"] if obstacles else []
    words += [] if result.trees is None else _describe_trees(result.trees, outcome)
    ended = "ended at the goal" if result.ended_at_goal else "did not end at the goal"
    return ", ".join([*(words or ["touched nothing"]), ended])


def _show_trees(console: Console, trees: TreeResponse, outcome: _Outcome) -> None:
    """Print contacts with limbs and fruit, with the certificate's bounds, and the damage."""
    headings = "limb or fruit", "link", "force", "stress", "deflection", "from", "to"
    table = number_table(headings, (), texts=("limb or fruit", "link"))
    for one in sorted(trees.contacts, key=lambda one: (-one.force_n, one.limb, one.link)):
        bound = outcome.bounds.get((one.limb, one.link), {})
        force = f"{one.force_n:.1f}{_bound_words(bound, 'force_n')} N"
        stress = "" if one.is_fruit else f"{one.stress_mpa:.1f}{_bound_words(bound, 'stress_mpa')} MPa"
        deflection = f"{1e3 * one.deflection_m:.1f} mm"
        force = force if one.is_within(trees.wood) else f"[bold red]{force}[/]"
        times = f"{one.begin_s:.2f} s", f"{one.end_s:.2f} s"
        table.add_row(escape(one.limb), escape(one.link), force, stress, deflection, *times)
    if trees.contacts:
        console.print(table)
        console.print()
    facts = facts_table(indent=0)
    for limb in trees.broken:
        facts.add_row("broken", f"[bold red]{escape(limb.name)}[/] at {limb.time_s:.3f} s, {limb.load:.0f} MPa")
    for fruit in trees.knocked_off:
        facts.add_row("knocked off", f"[bold red]{escape(fruit.name)}[/] at {fruit.time_s:.3f} s, {fruit.load:.1f} N")
    moved = [value for value in trees.fruit_displacement_m.values() if value > _VISIBLE_M]
    if moved:
        facts.add_row("displaced", f"{len(moved)} fruit at the end, up to {1e3 * max(moved):.1f} mm")
    goal, goal_bound = outcome.goal_displacement_m, outcome.goal_bound_m
    if goal is not None:
        bound_words = "" if goal_bound is None else f" of {1e3 * goal_bound:.1f}"
        facts.add_row("goal fruit", f"displaced by {1e3 * goal:.1f}{bound_words} mm at {outcome.grasp_s:.2f} s")
    if facts.row_count:
        console.print(facts)
        console.print()


def _bound_words(bound: Mapping[str, Any], key: str) -> str:
    """The certificate's bound of a value; empty without one."""
    value = bound.get(key)
    return "" if value is None else f" of {value:.1f}"


def _describe_trees(trees: TreeResponse, outcome: _Outcome) -> list[str]:
    """Contacts with limbs and fruit, and damage, in a few words."""
    limbs = {one.limb for one in trees.contacts if not one.is_fruit}
    fruit = {one.limb for one in trees.contacts if one.is_fruit}
    beyond = sum(not one.is_within(trees.wood) for one in trees.contacts)
    words = ["touched no limb"]
    if trees.contacts:
        most = max(trees.contacts, key=lambda one: one.force_n)
        bound = _bound_words(outcome.bounds.get((most.limb, most.link), {}), "force_n")
        touched = [_count(len(limbs), "limb")] * bool(limbs) + [f"{len(fruit)} fruit"] * bool(fruit)
        words = [f"touched {' and '.join(touched)} with at most {most.force_n:.1f}{bound} N"]
    words += [f"{_count(beyond, 'contact')} beyond the limits"] if beyond else []
    words += [f"broke {_count(len(trees.broken), 'limb')}"] if trees.broken else []
    words += [f"knocked off {len(trees.knocked_off)} fruit"] if trees.knocked_off else []
    return words


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
