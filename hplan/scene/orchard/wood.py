"""Growth of a tree from straight segments: tapering trunk, branches, shoots.

Two forms of modern apple trees. A spindle has one leader with branches all around it, each rotated by the golden angle
from the one below, long at the bottom and short at the top, so that all get light. A trellised tree has a pair of arms
along each wire, with branches on the arms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.scene.limits import Vector
from hplan.scene.obstacles import Capsule
from hplan.scene.orchard.options import OrchardOptions

#: Number of decimals of a length in metres.
DECIMALS = 4


def round_point(point: Iterable[float]) -> Vector:
    """Round a point to the 0.1 mm grid [m]."""
    # Adding 0.0 turns -0.0, which would appear in files, into 0.0.
    x, y, z = (round(float(value), DECIMALS) + 0.0 for value in point)
    return x, y, z


def capsule(name: str, start: Vector, end: Vector, radius: float) -> Capsule:
    """Return a capsule with the given ends [m]."""
    return Capsule.model_validate({"name": name, "from": start, "to": end, "radius": radius})


LimbKind: TypeAlias = Literal["trunk", "arm", "branch", "shoot"]


@dataclass(frozen=True, eq=False)
class Limb:
    """A straight segment of wood.

    Attributes:
        kind: Trunk, arm, branch or shoot.
        start: (3,) end nearer to the root [m].
        end: (3,) other end [m].
        radius: Radius [m].
    """

    kind: LimbKind
    start: FloatArray
    end: FloatArray
    radius: float


def grow_tree(options: OrchardOptions, root: FloatArray, random: np.random.Generator) -> list[Limb]:
    """Grow a tree: trunk, arms, branches and shoots, each upwards.

    Args:
        options: Options of the row.
        root: (3,) position of the trunk at the ground [m].
        random: Random number generator.
    """
    trunk = _trunk(options, root, random)
    if options.form == "spindle":
        arms: list[Limb] = []
        branches = _spindle_branches(options, trunk, random)
    else:
        arms = _trellis_arms(options, trunk, random)
        branches = _trellis_branches(options, arms, random)
    shoots = [shoot for branch in branches for shoot in _shoots(options, branch, random)]
    return [*trunk, *arms, *(piece for branch in branches for piece in branch), *shoots]


def _trunk(options: OrchardOptions, root: FloatArray, random: np.random.Generator) -> list[Limb]:
    """Grow nearly upright segments, thickest at the bottom."""
    # Approximate length of a trunk segment [m].
    trunk_piece = 0.45
    count = max(3, round(options.tree_height / trunk_piece))
    nodes = np.tile(root, (count + 1, 1))
    nodes[:, 2] += np.linspace(0.0, options.tree_height, count + 1)
    nodes[1:, :2] += np.cumsum(random.uniform(-0.015, 0.015, (count, 2)), axis=0)
    fraction = (np.arange(count) + 0.5) / count
    return _wood_pieces("trunk", nodes, options.trunk_radius * (1.0 - 0.75 * fraction))


def _spindle_branches(options: OrchardOptions, trunk: Sequence[Limb], random: np.random.Generator) -> list[list[Limb]]:
    """Grow a spindle's branches from bottom to top.

    They rise from the trunk and sink under their fruit.
    """
    branches = []
    azimuth = random.uniform(0.0, 2.0 * math.pi)
    for number in range(options.branches):
        fraction = (number + random.uniform(0.1, 0.9)) / options.branches
        height = options.first_branch + fraction * 0.96 * (options.tree_height - options.first_branch)
        # The golden angle: no branch is vertically above another.
        azimuth += math.pi * (3.0 - math.sqrt(5.0)) + random.uniform(-0.3, 0.3)
        length = options.branch_length * (1.0 - 0.65 * fraction) * random.uniform(0.75, 1.0)
        rise = math.radians(random.uniform(10.0, 35.0))
        start, thickness = _at_height(trunk, height)
        radius = min(0.6 * thickness, 0.004 + 0.013 * length)
        bends = rise - np.radians([0.0, 12.0, 30.0])
        turns = azimuth + np.cumsum(random.uniform(-0.15, 0.15, 3))
        branches.append(_grow_bent("branch", start, length, bends, turns, radius))
    return branches


def _trellis_arms(options: OrchardOptions, trunk: Sequence[Limb], random: np.random.Generator) -> list[Limb]:
    """Grow arms to both sides at each wire.

    They end before the arms of the next tree begin.
    """
    arms: list[Limb] = []
    for height in options.wire_heights:
        if height >= options.tree_height:
            break
        start, thickness = _at_height(trunk, height)
        for side in (-1.0, 1.0):
            length = 0.5 * options.spacing * random.uniform(0.85, 0.98)
            bends = np.radians(random.uniform(-4.0, 6.0, 3))
            turns = side * 0.5 * math.pi + random.uniform(-0.08, 0.08, 3)
            arms += _grow_bent("arm", start, length, bends, turns, 0.75 * thickness)
    return arms


def _trellis_branches(options: OrchardOptions, arms: Sequence[Limb], random: np.random.Generator) -> list[list[Limb]]:
    """Grow a trellised tree's branches, spread over the arms.

    They point upwards and to alternating sides of the row.
    """
    branches = []
    for number in range(options.branches):
        place = (number + random.uniform(0.1, 0.9)) / options.branches * len(arms)
        arm = arms[min(int(place), len(arms) - 1)]
        start = arm.start + (place - int(place)) * (arm.end - arm.start)
        azimuth = math.pi * (number % 2) + random.uniform(-0.7, 0.7)
        rise = math.radians(random.uniform(5.0, 55.0))
        length = options.branch_length * random.uniform(0.4, 1.0)
        bends = rise - np.radians([0.0, 10.0, 25.0])
        radius = min(0.6 * arm.radius, 0.003 + 0.01 * length)
        branches.append(_grow_bent("branch", start, length, bends, azimuth + np.zeros(3), radius))
    return branches


def _shoots(options: OrchardOptions, branch: Sequence[Limb], random: np.random.Generator) -> list[Limb]:
    """Grow side shoots of a branch, alternating left and right."""
    shoots = []
    length = sum(float(np.linalg.norm(piece.end - piece.start)) for piece in branch)
    for number in range(options.shoots):
        place = random.uniform(0.3, 0.95) * len(branch)
        piece = branch[int(place)]
        start = piece.start + (place - int(place)) * (piece.end - piece.start)
        along = piece.end - piece.start
        turn = (-1.0) ** number * math.radians(random.uniform(35.0, 75.0))
        azimuth = math.atan2(along[1], along[0]) + turn
        rise = math.radians(random.uniform(-15.0, 45.0))
        reach = length * random.uniform(0.2, 0.45)
        shoots += _wood_pieces(
            "shoot", np.stack([start, start + reach * _direction(azimuth, rise)]), [0.8 * piece.radius]
        )
    return shoots


def _grow_bent(
    kind: LimbKind, start: FloatArray, length: float, rises: FloatArray, azimuths: FloatArray, radius: float
) -> list[Limb]:
    """Return successive segments of equal length, each with its rise and azimuth.

    They taper to a third of the radius.
    """
    count = len(rises)
    steps = [_direction(azimuth, rise) for azimuth, rise in zip(azimuths, rises, strict=True)]
    nodes = start + length / count * np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    return _wood_pieces(kind, nodes, radius * np.linspace(1.0, 0.35, count))


def _wood_pieces(kind: LimbKind, nodes: FloatArray, radii: Sequence[float] | FloatArray) -> list[Limb]:
    # Minimum radius of wood [m].
    thinnest = 0.002
    return [
        Limb(kind, start, end, max(float(radius), thinnest))
        for start, end, radius in zip(nodes, nodes[1:], radii, strict=False)
    ]


def _direction(azimuth: float, rise: float) -> FloatArray:
    return np.array([math.cos(azimuth) * math.cos(rise), math.sin(azimuth) * math.cos(rise), math.sin(rise)])


def _at_height(trunk: Sequence[Limb], height: float) -> tuple[FloatArray, float]:
    """Point and radius of the trunk at a height [m]."""
    piece = next((piece for piece in trunk if piece.end[2] >= height), trunk[-1])
    fraction = (height - piece.start[2]) / (piece.end[2] - piece.start[2])
    return piece.start + fraction * (piece.end - piece.start), piece.radius
