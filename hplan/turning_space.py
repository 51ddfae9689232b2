"""C-space of an arm whose base turns: one layer of the planar C-space for each yaw, stacked along the last axis.

The grid's axes are the planar joints and then the yaw, so that a slice of the last axis is the paper's problem at that
yaw, and one word of a row holds 64 yaws.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from hplan.arrays import WordArray, frozen
from hplan.cspace import occupancy
from hplan.grid import Grid, Occupancy, words_for
from hplan.robot import Robot
from hplan.section import ArmSections, Bodies, sections_at


def yaw_axis(
    start: float, goal: float, step: float, lower: float, upper: float, beyond: float
) -> tuple[float, float, int]:
    """Equally spaced yaws that hold start and goal and go beyond them where the limits allow.

    Args:
        start: Yaw of the start.
        goal: Yaw of the goal.
        step: Largest spacing.
        lower: Lower limit of the yaw.
        upper: Upper limit of the yaw.
        beyond: How far to go beyond start and goal.

    Returns:
        The first yaw, the spacing and the number of yaws. Where start and goal are nearer to each other than half a
        step, only the start's yaw is met exactly.
    """
    low, high = min(start, goal), max(start, goal)
    if high - low >= 0.5 * step:
        step = (high - low) / math.ceil((high - low) / step - 1e-9)
    else:
        low = high = start
    below = math.floor(min(beyond, low - lower) / step + 1e-9)
    above = math.floor(min(beyond, upper - high) / step + 1e-9)
    return low - below * step, step, round((high - low) / step) + below + above + 1


class Layers:
    """Planar layers that were computed before, found again by what they are made from: grid and sections.

    A layer whose sections have not changed need not be computed again, whatever else has changed in the scene. Once
    more than `most_bytes` are held, the oldest go.
    """

    def __init__(self, most_bytes: int = 64_000_000) -> None:
        """Hold nothing yet."""
        self._most_bytes = most_bytes
        self._bytes = 0
        self._held: dict[bytes, WordArray] = {}

    def free_words(self, robot: Robot, sections: ArmSections, planar: Grid) -> WordArray:
        """Free bits of a layer, as in `Occupancy`."""
        parts = (planar.lower, planar.step, np.array(planar.shape), sections.link_start, sections.vertex_start)
        key = b"".join(part.tobytes() for part in (*parts, sections.vertices, sections.radii))
        found = self._held.get(key)
        if found is None:
            found = occupancy(robot.arm, sections, planar).free_words
            self._held[key] = found
            self._bytes += len(key) + found.nbytes
            while self._bytes > self._most_bytes and len(self._held) > 1:
                oldest = next(iter(self._held))
                self._bytes -= len(oldest) + self._held.pop(oldest).nbytes
        return found


def turning_occupancy(
    robot: Robot,
    bodies: Bodies,
    planar: Grid,
    first_yaw: float,
    yaw_step: float,
    count: int,
    *,
    thick: bool,
    layers: Layers,
) -> Occupancy:
    """Which nodes of planar grid times yaws are free.

    Args:
        robot: The arm, with a yaw.
        bodies: The obstacles.
        planar: Grid over the planar joints.
        first_yaw: Yaw of the first layer.
        yaw_step: Spacing of the layers.
        count: Number of layers.
        thick: Whether a layer holds the obstacles at all yaws nearer to it than to others, not at its own yaw alone.
        layers: Layers that are already there; of this robot only.
    """
    grid = Grid(np.append(planar.lower, first_yaw), np.append(planar.step, yaw_step), (*planar.shape, count))
    words = np.zeros((planar.size, words_for(count)), dtype=np.uint64)
    for layer in range(count):
        sections = sections_at(robot, bodies, first_yaw + layer * yaw_step, half_angle=0.5 * yaw_step if thick else 0.0)
        _stack(layers.free_words(robot, sections, planar), planar.shape[-1], layer, words)
    return Occupancy(grid, frozen(words))


@nb.njit(cache=True)
def _stack(free: WordArray, count: int, layer: int, words: WordArray) -> None:
    """Set bit `layer` in the row of every free node of a planar occupancy."""
    one = np.uint64(1)
    bit, place = one << np.uint64(layer & 63), layer >> 6
    for row in range(free.shape[0]):
        for b in range(count):
            if (free[row, b >> 6] >> np.uint64(b & 63)) & one:
                words[row * count + b, place] |= bit
