"""Write a folder to start from: a scene with trees that fit the arm, and a script that plans in it.

For an arm whose file lacks limits, a limits file with a guess for each is written too. Files that are in the folder
already are not replaced.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hplan.apps.cli.options import add_shared, command_parser, robot_of, robot_options, source_of
from hplan.apps.cli.own_files import check_own
from hplan.apps.cli.terminal import progress_line
from hplan.errors import HplanError

if TYPE_CHECKING:
    from rich.console import Console

_EPILOG = """\
examples:
  hplan init picking
  hplan init picking --robot my_arm.urdf --tool-tube 0.18

exit status:
  0  done
  2  bad input, or files in the folder that hplan did not write
"""

#: Files of the folder.
SCENE, LIMITS, README, SCRIPT = "scene.yaml", "limits.yaml", "README.md", "pick.py"

_README_TEXT: Final = """\
# {name}

In this folder:

    hplan plan scene.yaml --out first      # a certified motion to one fruit: CSV, report, page
    hplan view first scene.yaml            # the page in a browser
    hplan tour scene.yaml --out tour       # all fruits from here
    hplan row scene.yaml --out row         # stops along the row
    python pick.py                         # the first motion in Python

`scene.yaml` names the arm and its options. `hplan orchard` writes other trees, `hplan inspect` lists what a robot file
lacks.
{limits}"""

_LIMITS_TEXT: Final = "`limits.yaml` has guesses for limits that the robot file lacks: use the data sheet's.\n"

_SCRIPT_TEXT: Final = '''\
"""Plans to the goal fruit of scene.yaml and writes the motion for the controller."""

from pathlib import Path

import hplan

folder = Path(__file__).parent
scene = hplan.load_scene(folder / "scene.yaml")
robot = hplan.load_robot(scene.robot)
result = hplan.plan(robot, scene)
assert result.certificate.verified
hplan.write_csv(result.trajectory, folder / "motion.csv")
print(f"{scene.goal.fruit}: {result.trajectory.duration:.2f} s, nearest: {result.certificate.nearest}")
'''


def parser(prog: str) -> argparse.ArgumentParser:
    """Return the argument parser of the subcommand."""
    parser = command_parser(__doc__, _EPILOG, prog=prog)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder to write to; it is created")
    add_shared(parser, "robot", "parts")
    parser.add_argument("--seed", type=int, metavar="N", help="random seed of the trees (default: 0)")
    add_shared(parser, "force", "quiet")
    return parser


def run(arguments: argparse.Namespace, console: Console, errors: Console) -> int:
    """Write the files; return the exit status."""
    from hplan.apps.cli import orchard
    from hplan.base.files import HTML_COMMENT, YAML_COMMENT, prepare_folder, write_marked
    from hplan.scene.file import save_scene

    folder: Path = arguments.folder
    for name in (SCENE, LIMITS, README, SCRIPT):
        check_own(folder / name, force=arguments.force)
    prepare_folder(folder)
    with progress_line(errors, quiet=arguments.quiet) as progress:
        progress("reading robot")
        limits = _missing_limits(arguments)
        if limits is not None:
            arguments.limits = write_marked(folder / LIMITS, limits, YAML_COMMENT)
        own = {"out": folder / SCENE, "name": folder.resolve().name}
        row = vars(orchard.parser("hplan orchard").parse_args([])) | vars(arguments) | own
        try:
            scene, pickable = orchard.make_scene(argparse.Namespace(**row), console, progress)
        except HplanError:
            if limits is not None:
                (folder / LIMITS).unlink()
            raise
        save_scene(scene, folder / SCENE)
    text = _README_TEXT.format(name=scene.name, limits="" if limits is None else _LIMITS_TEXT)
    write_marked(folder / README, text, HTML_COMMENT)
    write_marked(folder / SCRIPT, _SCRIPT_TEXT, YAML_COMMENT)
    if not arguments.quiet:
        orchard.show_orchard(console, scene, folder / SCENE, pickable)
        names = [SCENE, *([LIMITS] if limits is not None else []), SCRIPT, README]
        console.print(f"written: {folder}: {', '.join(names)}", markup=False, soft_wrap=True)
        console.print(f"next: cd {folder}; hplan plan {SCENE} --out first", markup=False, soft_wrap=True)
    return 0


def _missing_limits(arguments: argparse.Namespace) -> str | None:
    """Text of a limits file with guesses for the limits that an arm lacks; None if it lacks none.

    Raises:
        RobotFileError: The arm has faults beside its limits.
    """
    source = source_of(arguments)
    if not hasattr(source, "urdf") or arguments.limits is not None or arguments.acceleration_scale is not None:
        return None
    from hplan.robot.inspection import inspect_robot, limits_template

    found = inspect_robot(arguments.robot, **robot_options(arguments))
    if found.robot is None:
        robot_of(arguments)  # raises the faults
        return None
    if not found.faults and not found.robot.assumptions:
        return None
    return limits_template(found.name, found.urdf, found.joints)
