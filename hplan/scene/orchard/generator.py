"""Orchard scenes: a tree row before the arm, grown or measured."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hplan.base.arguments import instance, list_between, list_of
from hplan.errors import OptionError
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule
from hplan.scene.orchard.capsule_file import import_tree
from hplan.scene.orchard.fruits import attach_fruits, fruit_at_tips, hang_fruits
from hplan.scene.orchard.options import TUCKED_DEG, FruitZone, MeasuredOptions, OrchardOptions
from hplan.scene.orchard.wood import DECIMALS, Limb, capsule, grow_tree, round_point

#: The ground, 1 mm below the pedestal to avoid contact; and a vehicle body behind the pedestal, below the tucked arm.
_GROUND = Box(name="ground", center=(0.0, 0.0, -0.051), size=(6.0, 6.0, 0.1))
_VEHICLE = Box(name="vehicle", center=(-1.1, 0.0, 0.3), size=(1.6, 1.2, 0.4))


def generate(options: OrchardOptions | None = None, *, start_deg: Sequence[float] = TUCKED_DEG) -> Scene:
    """Generate a tree row with fruit; equal options give bit-identical scenes.

    Trees are grown one by one: a longer row has the same trees, shifted along the row, and more. Obstacles are named
    `tree 1 trunk 2`, `tree 1 arm 1`, `tree 1 branch 3`, `tree 1 shoot 4`, `wire 2`, `post 1`, `ground`, `vehicle`;
    fruits `fruit 01`, `fruit 02`, ..., numbered from the base's axis outwards.

    Args:
        options: Options of the row; None for the defaults.
        start_deg: Start configuration [deg]; the default is the tucked harvester.

    Raises:
        OptionError: There is no room for this number of fruits, the goal is not one of them, or the start is not a list
            of numbers.
    """
    options = OrchardOptions() if options is None else instance("options", options, OrchardOptions)
    wood: list[Capsule] = []
    for number, y in enumerate(_places_in_row(options.trees, options.spacing), start=1):
        limbs = grow_tree(options, np.array([options.distance, y, 0.0]), np.random.default_rng([options.seed, number]))
        wood += _limbs_to_obstacles(limbs, f"tree {number} ")
    wood += _trellis(options)
    zone = options.fruit_zone.lift(-options.height)
    fruits = hang_fruits(wood, replace(options, fruit_zone=zone), np.random.default_rng([options.seed, 0]))
    x, y, z = _GROUND.center
    ground = _GROUND.copy_unchecked({"center": (x, y, z + options.height)})
    boxes = [box for box, wanted in ((ground, options.ground), (_VEHICLE, options.vehicle)) if wanted]
    if options.height:
        lift = np.array([0.0, 0.0, options.height])
        wood = [capsule(w.name, round_point(w.core[0] + lift), round_point(w.core[1] + lift), w.radius) for w in wood]
        fruits = tuple(fruit.copy_unchecked({"center": round_point(fruit.center + lift)}) for fruit in fruits)
    return _assemble_scene(options, (*wood, *boxes), fruits, start_deg)


def measured_orchard(
    paths: Sequence[Path | str],
    options: MeasuredOptions | None = None,
    *,
    start_deg: Sequence[float] = TUCKED_DEG,
) -> Scene:
    """Return a row of measured trees with their fruit.

    Each tree is a file (`import_tree`). If no file has fruit, it is placed at branch tips. Wood and fruit keep their
    names for any position of the row.

    Args:
        paths: The files; several trees are named `tree 1 ...`, `tree 2 ...`.
        options: Options of the row; None for the defaults.
        start_deg: Start configuration [deg].

    Raises:
        InputError: A file is invalid.
        OptionError: There are no files, there is no fruit or no room for this number of fruits, the goal is not one of
            them, or the start is not a list of numbers.
    """
    paths = list_of("paths", paths, str | Path, "files")
    if not paths:
        raise OptionError("paths", [], "at least one file")
    options = MeasuredOptions() if options is None else instance("options", options, MeasuredOptions)
    wood, hung = list[Capsule](), list[Fruit]()
    for number, (path, y) in enumerate(zip(paths, _places_in_row(len(paths), options.spacing), strict=True), start=1):
        prefix = f"tree {number} " if len(paths) > 1 else ""
        position = options.distance, y, options.height
        tree, own = import_tree(path, position=position, yaw_deg=options.yaw_deg, prefix=prefix)
        wood += [capsule(piece.name, round_point(piece.start), round_point(piece.end), piece.radius) for piece in tree]
        hung += [fruit.copy_unchecked({"center": round_point(fruit.center)}) for fruit in own]
    # Number of fruits placed on measured trees without fruit, and their radius [m].
    put, put_radius = 20, 0.04
    if hung:
        fruits = _select_nearest(hung, options)
    else:
        count = put if options.fruits is None else options.fruits
        radius = put_radius if options.fruit_radius is None else options.fruit_radius
        fruits = fruit_at_tips(wood, count, radius, options.seed, zone=options.fruit_zone or FruitZone())
    return _assemble_scene(options, wood, fruits, start_deg)


def _select_nearest(fruits: Sequence[Fruit], options: MeasuredOptions) -> tuple[Fruit, ...]:
    """Select fruits of measured trees, nearest to the base's axis first."""
    if options.fruit_radius is not None:
        raise OptionError("fruit_radius", options.fruit_radius, "no value: the measured trees have their own fruits")
    zone = options.fruit_zone
    found = [fruit for fruit in fruits if zone is None or zone.holds(*fruit.center)]
    found.sort(key=lambda fruit: (math.hypot(*fruit.center[:2]), fruit.center[2]))
    return tuple(found[: options.fruits])


def _places_in_row(count: int, spacing: float) -> list[float]:
    """Positions of the trees along y, centred at 0 [m]."""
    return [(number - 0.5 * (count - 1)) * spacing for number in range(count)]


def _limbs_to_obstacles(limbs: Sequence[Limb], prefix: str) -> list[Capsule]:
    """Convert limbs to obstacles, numbered by kind."""
    counts: Counter[str] = Counter()
    capsules = []
    for limb in limbs:
        counts[limb.kind] += 1
        name, radius = f"{prefix}{limb.kind} {counts[limb.kind]}", round(limb.radius, DECIMALS)
        capsules.append(capsule(name, round_point(limb.start), round_point(limb.end), radius))
    return capsules


def _trellis(options: OrchardOptions) -> list[Capsule]:
    """Return wires along the row, and posts at its ends."""
    x, y = options.distance, 0.5 * options.trees * options.spacing
    wires = [
        capsule(f"wire {number}", round_point((x, -y, height)), round_point((x, y, height)), options.wire_radius)
        for number, height in enumerate(options.wire_heights, start=1)
    ]
    if not options.posts:
        return wires
    # Radius of a post; its excess height over 0.8 of the tree height and the topmost wire [m].
    post_radius, post_excess = 0.04, 0.1
    top = max(0.8 * options.tree_height, *options.wire_heights, 0.0) + post_excess
    feet = [(x, side * y, post_radius) for side in (-1.0, 1.0)]
    posts = [
        capsule(f"post {number}", round_point(foot), round_point((*foot[:2], top - post_radius)), post_radius)
        for number, foot in enumerate(feet, start=1)
    ]
    return [*wires, *posts]


def _assemble_scene(
    options: OrchardOptions | MeasuredOptions,
    obstacles: Sequence[Capsule | Box],
    fruits: tuple[Fruit, ...],
    start_deg: Sequence[float],
) -> Scene:
    """Assemble the scene with a valid goal."""
    start = list_between("start_deg", start_deg, -36000.0, 36000.0)
    obstacles = [
        piece.copy_unchecked({"yields": options.wood_yields})
        if options.wood_yields and isinstance(piece, Capsule) and piece.radius < options.yields_below
        else piece
        for piece in obstacles
    ]
    fruits = tuple(
        fruit.copy_unchecked({"yields": options.fruit_yields, "grasp_offset": min(options.grasp_offset, fruit.radius)})
        for fruit in fruits
    )
    if options.hangs_within is not None:
        fruits = attach_fruits(fruits, obstacles, options.hangs_within)
    names = [fruit.name for fruit in fruits]
    if not names:
        raise OptionError("fruits", 0, "at least one fruit, as the goal")
    if options.goal is not None and options.goal not in names:
        raise OptionError("goal", options.goal, f"one of the fruits, {names[0]} to {names[-1]}")
    return Scene(
        name=options.name,
        robot=options.robot,
        start=Start(joints_deg=start),
        goal=Goal(fruit=options.goal or names[0]),
        clearance=options.clearance,
        obstacles=tuple(obstacles),
        fruits=fruits,
    )
