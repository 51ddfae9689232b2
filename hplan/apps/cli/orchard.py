"""Write a scene with a tree row in front of the arm.

The same options give the same file, byte for byte. Fruits are numbered by distance from the base; the nearest is the
goal by default.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hplan.apps.cli.options import (
    add_shared,
    check_output_file,
    command_parser,
    refuse,
    robot_of,
    scene_with_wood,
    source_of,
)
from hplan.apps.cli.terminal import escape, facts_table, progress_line
from hplan.errors import OptionError

if TYPE_CHECKING:
    from rich.console import Console

    from hplan.robot.model import Robot
    from hplan.scene.model import Scene
    from hplan.scene.orchard import FruitZone

_EPILOG = """\
TREE.csv: a header, then one line for each straight segment of wood, in metres,
z up, with the trunk's base at the origin: kind,x1,y1,z1,x2,y2,z2,radius.
Segments are named by their kind (trunk, branch) and number. Lines of the kind
fruit, with the centre given twice, are fruits; trees without any get fruits at
their branch tips.

exit status:
  0  done
  2  bad input
"""

#: Destinations of the options of both kinds of tree rows, of generated rows only, and of measured rows only.
_COMMON = (
    *("seed", "distance", "spacing", "height", "clearance", "fruits", "fruit_radius", "goal"),
    *("wood_yields", "yields_below", "fruit_yields", "grasp_offset", "hangs_within"),
)
_GROWN = ("form", "trees", "branches", "shoots", "tree_height", "branch_length", "vehicle", "ground")
_MEASURED = ("turn",)

#: Destinations of the options of the robot.
_ROBOT = (
    *("robot", "limits", "hold", "tool_frame", "tool_tube_m", "srdf", "allow_neighbours", "package_dir", "xacro"),
    *("acceleration_scale", "collision_from_visual", "group", "group_state", "repair_inertia"),
)


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--import", nargs="+", type=Path, metavar="TREE.csv", dest="files", help="CSV files of measured trees"
    )
    source.add_argument(
        "--shipped",
        metavar="NAME",
        help="scene that ships with hplan, to generate again; only --start, --out, --force and --quiet apply",
    )
    add = parser.add_argument
    add(
        "--out",
        type=Path,
        default=Path("orchard.yaml"),
        metavar="FILE",
        help="scene file to write (default: orchard.yaml)",
    )
    add_shared(parser, "force")
    add("--name", help="name of the scene (default: the file's)")
    add_shared(parser, "robot", "parts")
    add("--seed", type=int, metavar="N", help="random seed (default: 0)")
    add(
        "--distance",
        type=float,
        metavar="M",
        help="distance from the base's axis to the row in metres (default: 1.4, or as fits an arm of your own)",
    )
    add("--spacing", type=float, metavar="M", help="distance between trees in metres (default: 1.1)")
    add(
        "--height",
        type=float,
        metavar="M",
        help="height of the trees' feet above the robot's base in metres (default: 0)",
    )
    add("--clearance", type=float, metavar="M", help="minimum clearance of motions in metres (default: 0)")
    add(
        "--fruits",
        type=int,
        metavar="N",
        help="number of fruits (default: 24; for measured trees those of the files, or 20)",
    )
    add("--fruit-radius", type=float, metavar="M", help="radius of the fruits in metres (default: 0.04)")
    add(
        "--fruit-heights",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="minimum and maximum height of the fruits in metres (default: the robot's range)",
    )
    add(
        "--fruit-reach",
        type=float,
        metavar="M",
        help="maximum distance of a fruit from the base's axis in metres (default: the robot's range)",
    )
    yields = "maximum depth to which the arm's last links may push"
    add("--yield", dest="wood_yields", type=float, metavar="M", help=f"{yields} thin wood, in metres (default: 0)")
    add(
        "--yield-below",
        dest="yields_below",
        type=float,
        metavar="M",
        help="radius below which wood is thin, in metres (default: 0.008)",
    )
    add("--yield-fruit", dest="fruit_yields", type=float, metavar="M", help=f"{yields} a fruit, in metres (default: 0)")
    offset = "maximum distance of the tool from a fruit's centre where wood blocks the centre, in metres (default: 0)"
    add("--grasp-offset", type=float, metavar="M", help=offset)
    hangs = "distance within which a fruit hangs from the wood, which may deflect during the picking (default: unknown)"
    add("--hangs-within", type=float, metavar="M", help=hangs)
    add_shared(parser, "wood")
    add("--goal", metavar="NAME", help="fruit that is the goal (default: the first)")
    add(
        "--start",
        type=float,
        nargs="+",
        metavar="DEG",
        help="joint positions at the start in degrees (default: the tucked harvester; for an arm of your own, one "
        "found beside the trees)",
    )
    add("--quiet", action="store_true", help="print no summary")
    grown = parser.add_argument_group("grown trees").add_argument
    grown("--form", choices=("spindle", "trellis"), help="training form of the trees (default: spindle)")
    grown("--trees", type=int, metavar="N", help="number of trees (default: 3)")
    grown("--tree-height", type=float, metavar="M", help="height of the trees in metres (default: 2.7)")
    grown("--branches", type=int, metavar="N", help="number of branches of each tree (default: 18)")
    grown("--branch-length", type=float, metavar="M", help="maximum length of a branch in metres (default: 0.6)")
    grown("--shoots", type=int, metavar="N", help="number of side shoots of each branch (default: 2)")
    grown("--vehicle", action="store_true", default=None, help="add the body of a vehicle behind the arm")
    grown("--ground", action="store_true", default=None, help="add the ground")
    measured = parser.add_argument_group("measured trees").add_argument
    measured("--turn", type=float, metavar="DEG", help="rotation of every tree about its trunk in degrees (default: 0)")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Generate and write the scene, print a summary; return the exit status."""
    from hplan.scene.file import save_scene

    out: Path = arguments.out
    with progress_line(errors, quiet=arguments.quiet) as progress:
        scene, pickable = make_scene(arguments, console, progress)
        scene = scene_with_wood(arguments, scene)
    check_output_file(out, force=arguments.force)
    save_scene(scene, out)
    if not arguments.quiet:
        show_orchard(console, scene, out, pickable)
    return 0


def make_scene(
    arguments: argparse.Namespace, console: Console, progress: Callable[[str], None]
) -> tuple[Scene, int | None]:
    """Generate the scene of the arguments; with the number of fruits that can be picked, for an arm of one's own."""
    from hplan.base.data_files import shipped_robots
    from hplan.scene.orchard import SHIPPED, FruitZone, MeasuredOptions, OrchardOptions, generate, measured_orchard
    from hplan.scene.orchard.options import REACHED

    start = {} if arguments.start is None else {"start_deg": arguments.start}
    if arguments.shipped is not None:
        if arguments.shipped not in SHIPPED:
            raise OptionError("--shipped", arguments.shipped, f"one of {', '.join(SHIPPED)}")
        others = ("name", *_ROBOT, *_COMMON, "fruit_heights", "fruit_reach", *_GROWN, *_MEASURED)
        refuse(arguments, others, "no value together with --shipped")
        return generate(SHIPPED[arguments.shipped], **start), None
    wanted = {option: getattr(arguments, option) for option in _COMMON}
    wanted["name"] = arguments.out.stem if arguments.name is None else arguments.name
    if arguments.files:
        refuse(arguments, _GROWN, "no value together with --import")
        wanted |= {"yaw_deg": arguments.turn}
    else:
        refuse(arguments, _MEASURED, "no value without --import, as it is for measured trees")
        wanted |= {option: getattr(arguments, option) for option in _GROWN}
    wanted["robot"] = source_of(arguments)
    wanted = _drop_unset(wanted)
    if wanted.get("robot", "harvester") not in shipped_robots():
        return _fit_scene(arguments, wanted, console, progress)
    if arguments.files:
        if arguments.fruit_heights is not None or arguments.fruit_reach is not None:
            wanted["fruit_zone"] = _zone(arguments, FruitZone())
        scene = measured_orchard(arguments.files, MeasuredOptions(**wanted), **start)
        return _beside_base(scene, robot_of(arguments), console), None
    wanted["fruit_zone"] = _zone(arguments, REACHED.get(str(arguments.robot), OrchardOptions.fruit_zone))
    return generate(OrchardOptions(**wanted), **start), None


def _fit_scene(
    arguments: argparse.Namespace, wanted: dict[str, Any], console: Console, progress: Callable[[str], None]
) -> tuple[Scene, int]:
    """Generate trees that fit the workspace of any arm."""
    progress("reading robot")
    from hplan.planning.fitted_orchard import (
        find_start,
        grow_fitted,
        measure_workspace,
        measured_defaults,
        with_pickable_goal,
        zone_of,
    )
    from hplan.scene.orchard import MeasuredOptions, measured_orchard

    robot = robot_of(arguments)
    progress("sampling the workspace")
    space = measure_workspace(robot)
    if arguments.fruit_heights is not None or arguments.fruit_reach is not None:
        wanted["fruit_zone"] = _zone(arguments, zone_of(space))
    start = [0.0] * robot.dof if arguments.start is None else arguments.start
    if arguments.files:
        options = MeasuredOptions(**measured_defaults(space) | wanted)
        scene = _beside_base(measured_orchard(arguments.files, options, start_deg=start), robot, console)
    else:
        scene = grow_fitted(space, wanted, start)
    if arguments.start is None:
        progress("looking for a start")
        scene = scene.with_values(start=find_start(robot, scene, space.far))
    aimed, found = with_pickable_goal(robot, scene, progress)
    return scene if arguments.goal else aimed, sum(reach.can_be_picked for reach in found.values())


def _beside_base(scene: Scene, robot: Robot, console: Console) -> Scene:
    """Remove, and print, fruits that hang inside the robot's pedestal or turret."""
    from hplan.planning.world import without_inside

    fruit_alone, names = without_inside(robot, scene.copy_unchecked({"obstacles": ()}))
    if not names:
        return scene
    console.print(f"removed, inside the pedestal or turret: {', '.join(names)}", markup=False, soft_wrap=True)
    return scene.copy_unchecked({"fruits": fruit_alone.fruits, "goal": fruit_alone.goal})


def _drop_unset(options: dict[str, Any]) -> dict[str, Any]:
    """Options whose value is not None."""
    return {option: value for option, value in options.items() if value is not None}


def _zone(arguments: argparse.Namespace, usual: FruitZone) -> FruitZone:
    """Fruit zone of the arguments; omitted values come from `usual`."""
    from hplan.scene.orchard import FruitZone

    low, high = arguments.fruit_heights or (usual.low, usual.high)
    return FruitZone(low, high, usual.reach if arguments.fruit_reach is None else arguments.fruit_reach)


def show_orchard(console: Console, scene: Scene, out: Path, pickable: int | None) -> None:
    """Print a summary in at most 80 columns, unless names are long."""
    heights = [fruit.center[2] for fruit in scene.fruits]
    can = "" if pickable is None else f"; {pickable:,} can be picked from the start"
    facts = (
        ("obstacles", f"{len(scene.obstacles):,}"),
        ("fruits", f"{len(scene.fruits):,}, {min(heights):.2f} to {max(heights):.2f} m high{can}"),
        ("goal", escape(scene.goal.fruit)),
        ("file", escape(out)),
    )
    console.print(f"\n[bold]{escape(scene.name)}[/]\n")
    console.print(facts_table(facts))
    console.print()
