"""Trees from measurements: a CSV of capsules and balls, placed and turned.

Turning by yaw and moving is `p -> R p + t` with R about the vertical; a capsule stays a capsule of the same radius.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

from hplan.base.arguments import between, list_between
from hplan.base.csv_file import CsvFile
from hplan.errors import OptionError
from hplan.scene.limits import Vector
from hplan.scene.model import Fruit
from hplan.scene.obstacles import Capsule
from hplan.scene.orchard.options import FARTHEST
from hplan.scene.orchard.pieces import capsule

_NUMBERS = ("x1", "y1", "z1", "x2", "y2", "z2", "radius")
_COLUMNS = ("kind", *_NUMBERS)

#: Kind of the rows that are fruit.
FRUIT = "fruit"


def import_capsules(
    path: Path | str,
    *,
    position: Vector = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    prefix: str = "",
) -> tuple[Capsule, ...]:
    """The wood of a tree as capsules (`import_tree`)."""
    return import_tree(path, position=position, yaw_deg=yaw_deg, prefix=prefix)[0]


def import_tree(
    path: Path | str,
    *,
    position: Vector = (0.0, 0.0, 0.0),
    yaw_deg: float = 0.0,
    prefix: str = "",
) -> tuple[tuple[Capsule, ...], tuple[Fruit, ...]]:
    """Read a tree as capsules, and the fruit that hung on it as balls.

    The file has one header line with the columns `kind,x1,y1,z1,x2,y2,z2,radius` in any order; others are ignored.
    Lengths are metres, z is up. Capsules may touch and overlap. A row of the kind `fruit` has its centre twice.

    Args:
        position: Where the file's origin comes to stand [m].
        yaw_deg: Turn about the vertical through the file's origin, before that [deg].
        prefix: Put before every name, such as "tree 1 ".

    Returns:
        A capsule for each other row, called by its kind and counted, `trunk 1`, `branch 7`; and the fruits, `fruit 1`,
        `fruit 2`, ... in the order of their rows.

    Raises:
        InputError: Missing or malformed file, a missing or repeated column, no rows, a kind that is empty, a number
            that is not finite or beyond a kilometre, a radius that is not positive, two ends in the same place, those
            of a fruit in two; names the line.
        OptionError: The position or the turn is no finite number.
    """
    place = list_between("position", position, -FARTHEST, FARTHEST)
    if len(place) != 3:
        raise OptionError("position", position, "three numbers x, y, z [m]")
    turn = math.radians(between("yaw_deg", yaw_deg, -FARTHEST, FARTHEST))
    if not isinstance(prefix, str):
        raise OptionError("prefix", prefix, "text")
    file = CsvFile.read(path, "capsule", "capsule")
    header = [name.strip() for name in file.header]
    for name in _COLUMNS:
        if header.count(name) != 1:
            state = "missing" if name not in header else "there twice"
            raise file.fault(1, f"column {name!r} is {state}; expected {','.join(_COLUMNS)}")
    kind_column = header.index("kind")
    counts: Counter[str] = Counter()
    capsules, fruits = list[Capsule](), list[Fruit]()
    for line, row, numbers in file.number_rows([header.index(name) for name in _NUMBERS]):
        kind = " ".join(row[kind_column].split())
        _check(file, line, kind, numbers)
        counts[kind] += 1
        name = f"{prefix}{kind} {counts[kind]}"
        start, end = (_placed(numbers[first : first + 3], turn, place) for first in (0, 3))
        if kind == FRUIT:
            fruits.append(Fruit(name=name, center=start, radius=numbers[6]))
        else:
            capsules.append(capsule(name, start, end, numbers[6]))
    return tuple(capsules), tuple(fruits)


def _check(file: CsvFile, line: int, kind: str, numbers: list[float]) -> None:
    """Refuse what is no piece of a tree."""
    if not kind:
        raise file.fault(line, "kind is empty, expected a word such as trunk or branch")
    for name, value in zip(_NUMBERS, numbers, strict=True):
        if abs(value) > FARTHEST:
            raise file.fault(line, f"{name} is {value:g}, expected metres, {FARTHEST:g} at most")
    if not numbers[6] > 0.0:
        raise file.fault(line, f"radius is {numbers[6]:g}, expected a positive number")
    if (numbers[:3] == numbers[3:6]) != (kind == FRUIT):
        raise file.fault(line, f"both ends are {'not ' if kind == FRUIT else ''}in the same place")


def _placed(point: list[float], turn: float, place: tuple[float, ...]) -> Vector:
    cos, sin = math.cos(turn), math.sin(turn)
    x, y, z = point
    return cos * x - sin * y + place[0], sin * x + cos * y + place[1], z + place[2]
