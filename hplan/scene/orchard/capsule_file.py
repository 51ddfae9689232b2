"""Measured trees: a CSV of capsules and balls, rotated and shifted.

A point p moves to R p + t, with R a rotation about the vertical. A capsule keeps its radius.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

from hplan.base.arguments import check_between, file_path, list_between
from hplan.base.csv_file import CsvFile
from hplan.errors import OptionError, SceneError
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.limits import Vector
from hplan.scene.obstacles import Capsule
from hplan.scene.orchard.options import FARTHEST
from hplan.scene.orchard.wood import capsule

_CAPSULE_NUMBERS = ("x1", "y1", "z1", "x2", "y2", "z2", "radius")
_CSV_COLUMNS = ("kind", *_CAPSULE_NUMBERS)

#: Kind of fruit rows.
FRUIT = "fruit"


def import_capsules(
    path: Path | str,
    *,
    position: Vector = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    prefix: str = "",
) -> tuple[Capsule, ...]:
    """Return the wood of a tree as capsules (`import_tree`)."""
    return import_tree(path, position=position, yaw_deg=yaw_deg, prefix=prefix)[0]


def import_tree(
    path: Path | str,
    *,
    position: Vector = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    prefix: str = "",
) -> tuple[tuple[Capsule, ...], tuple[Fruit, ...]]:
    """Read a tree: wood as capsules, fruit as balls.

    The file has one header line with the columns `kind,x1,y1,z1,x2,y2,z2,radius` in any order; other columns are
    ignored. Lengths are in metres, z is up. Capsules may touch and overlap. A row of the kind `fruit` repeats its
    centre.

    A scene file (`.yaml`) is read as well: its capsules and fruits are one tree, with the mean of the trunks' feet as
    the origin.

    Args:
        path: The file.
        position: Position of the file's origin [m].
        yaw_deg: Rotation about the vertical through the file's origin, applied first [deg].
        prefix: Prefix of every name, for example "tree 1 ".

    Returns:
        A capsule for each wood row, named by its kind and a counter, `trunk 1`, `branch 7`; and the fruits, `fruit 1`,
        `fruit 2`, ... in file order.

    Raises:
        InputError: The file is missing or malformed, a column is missing or repeated, there are no rows, a kind is
            empty, a number is not finite or beyond a kilometre, a radius is not positive, a capsule's ends coincide, or
            a fruit's ends differ. The error names the line.
        OptionError: The position or the rotation is not finite.
    """
    place = list_between("position", position, -FARTHEST, FARTHEST)
    if len(place) != 3:
        raise OptionError("position", position, "three numbers x, y, z [m]")
    turn = math.radians(check_between("yaw_deg", yaw_deg, -FARTHEST, FARTHEST))
    if not isinstance(prefix, str):
        raise OptionError("prefix", prefix, "text")
    source = file_path("path", path)
    if source.suffix in (".yaml", ".yml"):
        return _tree_of_scene(source, place, math.degrees(turn), prefix)
    file = CsvFile.read(path, "capsule", "capsule")
    header = [name.strip() for name in file.header]
    for name in _CSV_COLUMNS:
        if header.count(name) != 1:
            state = "missing" if name not in header else "there twice"
            raise file.fault(1, f"column {name!r} is {state}; expected {','.join(_CSV_COLUMNS)}")
    kind_column = header.index("kind")
    counts: Counter[str] = Counter()
    capsules, fruits = list[Capsule](), list[Fruit]()
    for line, row, numbers in file.number_rows([header.index(name) for name in _CAPSULE_NUMBERS]):
        kind = " ".join(row[kind_column].split())
        _check_row(file, line, kind, numbers)
        counts[kind] += 1
        name = f"{prefix}{kind} {counts[kind]}"
        start, end = (_place_point(numbers[first : first + 3], turn, place) for first in (0, 3))
        if kind == FRUIT:
            fruits.append(Fruit(name=name, center=start, radius=numbers[6]))
        else:
            capsules.append(capsule(name, start, end, numbers[6]))
    return tuple(capsules), tuple(fruits)


def _tree_of_scene(
    path: Path, place: tuple[float, ...], yaw_deg: float, prefix: str
) -> tuple[tuple[Capsule, ...], tuple[Fruit, ...]]:
    """Capsules and fruits of a scene, as those of a tree."""
    scene = load_scene(path)
    wood = [one for one in scene.obstacles if isinstance(one, Capsule)]
    feet = [one.start for one in wood if one.name.endswith("trunk 1")]
    if not feet:
        raise SceneError("it has no tree: no obstacle is called 'trunk 1' or 'tree 1 trunk 1'", path=path)
    x, y, z = (sum(axis) / len(feet) for axis in zip(*feet, strict=True))
    trees = scene.copy_unchecked({"obstacles": tuple(wood)}).shift((-x, -y, -z)).shift(place, yaw_deg)
    named = [one.copy_unchecked({"name": prefix + one.name}) for one in (*trees.obstacles, *trees.fruits)]
    return tuple(one for one in named if isinstance(one, Capsule)), tuple(
        one for one in named if isinstance(one, Fruit)
    )


def _check_row(file: CsvFile, line: int, kind: str, numbers: list[float]) -> None:
    """Refuse an invalid row."""
    if not kind:
        raise file.fault(line, "kind is empty, expected a word such as trunk or branch")
    for name, value in zip(_CAPSULE_NUMBERS, numbers, strict=True):
        if abs(value) > FARTHEST:
            raise file.fault(line, f"{name} is {value:g}, expected metres, at most {FARTHEST:g}")
    if not numbers[6] > 0.0:
        raise file.fault(line, f"radius is {numbers[6]:g}, expected a positive number")
    if (numbers[:3] == numbers[3:6]) != (kind == FRUIT):
        raise file.fault(line, f"both ends are {'not ' if kind == FRUIT else ''}in the same place")


def _place_point(point: list[float], turn: float, place: tuple[float, ...]) -> Vector:
    cos, sin = math.cos(turn), math.sin(turn)
    x, y, z = point
    return cos * x - sin * y + place[0], sin * x + cos * y + place[1], z + place[2]
