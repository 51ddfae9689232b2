"""A UR5 with a picking tube picks a measured tree's apples.

It is on a platform, and drops each apple into a bin next to it; measured fruit goes through the tube.

pip install 'hplan[robots]'
python scripts/examples/ur5_picking.py [TREE.csv] [FOLDER]

The tree is a list of capsules and fruit (kind,x1,y1,z1,x2,y2,z2,radius: `hplan.scene.orchard.import_tree`); without a
file one is generated, and fruit hangs at the branch tips of a file without fruit.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import hplan
from hplan.apps.view.page import write_page
from hplan.apps.view.playback import Playback
from hplan.planning.report import write_report
from hplan.scene import Box, Capsule, Goal, Scene
from hplan.scene.orchard import FruitZone, MeasuredOptions, OrchardOptions, generate, import_tree, measured_orchard

#: Folded, its back to the tree; the bin is at the platform's side and filled from above.
START_DEG = (180.0, -110.0, 140.0, -120.0, -90.0, 0.0)
BIN = Goal(position=(-0.1, 0.55, 0.1), approach_deg=-90.0)


def ur5() -> hplan.Robot:
    """The UR5 of example-robot-data with a tube of 18 cm at its flange; its mouth is the grasp point."""
    return hplan.load_robot("ur5", tool_tube_m=0.18)


def orchard(robot: hplan.Robot, tree: str | None) -> Scene:
    """The tree in front of the arm, and its apples within reach.

    The arm is on a platform 70 cm above the ground, as near to the tree as its folded start allows.
    """
    zone = FruitZone(low=-0.25, high=0.75, reach=0.95)
    platform = Box(name="platform", center=(-0.2, 0.0, -0.36), size=(0.9, 0.7, 0.7))
    bin_wall = Box(name="bin", center=(-0.1, 0.55, -0.25), size=(0.35, 0.35, 0.4))
    if tree is None:
        grown = OrchardOptions(
            name="grown tree", trees=1, distance=0.95, tree_height=1.8, first_branch=0.1, branches=16,
            branch_length=0.45, wire_heights=(), posts=False, fruits=12, fruit_radius=0.035, fruit_zone=zone,
        )  # fmt: skip
        stem = Capsule(name="stem", start=(0.95, 0.0, -0.7), end=(0.95, 0.0, 0.0), radius=0.03)  # down to the ground
        scene = generate(grown, start_deg=START_DEG)
        return scene.with_obstacles([*scene.obstacles, stem, platform, bin_wall])
    for distance in (0.95, 1.05, 1.15, 1.25, 1.35, 1.45, 1.55, 1.7, 1.85, 2.0, 2.2):
        measured = MeasuredOptions(
            name=Path(tree).stem, distance=distance, height=-0.7, fruits=12, fruit_zone=zone, wood_yields=0.02,
            fruit_yields=0.02, hangs_within=0.02, fruit_radius=None if bears_fruit(tree) else 0.035,
        )  # fmt: skip
        scene = measured_orchard([tree], measured, start_deg=START_DEG)
        scene = scene.with_obstacles([*scene.obstacles, platform, bin_wall])
        if hplan.check(robot, scene, scene.start.configuration).valid:
            break
    return scene


def bears_fruit(tree: str | None) -> bool:
    """True if the file of a tree has fruit."""
    return tree is not None and bool(import_tree(tree)[1])


def main(tree: str | None = None, folder: str | None = None, most: int | None = None) -> hplan.TourResult:
    """Plan a certified tour over the apples; write all files.

    Args:
        tree: File of the tree; None to generate one.
        folder: Output folder of CSV, report and page.
        most: Maximum number of apples; None for all.
    """
    robot, out = ur5(), Path(tempfile.mkdtemp(prefix="hplan-") if folder is None else folder)
    scene = orchard(robot, tree)
    names = [fruit.name for fruit in scene.fruits[:most]]
    # Balls about measured fruit overlap their wood, and cannot be carried clear of it: the tube takes them.
    drop_off = None if bears_fruit(tree) else BIN
    result = hplan.plan_tour(robot, scene, fruits=names, tour=hplan.TourOptions(drop_off=drop_off, back=True))
    out.mkdir(parents=True, exist_ok=True)
    hplan.write_csv(result.trajectory, out / "tour.csv")
    write_report(result.report, out / "tour.json")
    write_page(robot, scene, Playback.from_result(result), out / "scene.html")
    print(f"written: {out}")
    print(f"{len(result.order)} of {len(names)} apples in {result.trajectory.duration:.1f} s, certified")
    for item in result.unreached:
        print(f"left: {item.error}")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:3])
