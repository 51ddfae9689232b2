"""C-space of an arm with a turning base, layer by layer.

Each yaw has one layer, a planar C-space.

Layers are stacked along the last axis. The grid's axes are the planar joints and then the yaw, so that a slice of the
last axis is the paper's problem at that yaw, and one word of a row contains 64 yaws.
"""

from __future__ import annotations

import math
from threading import Lock
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, WordArray, frozen
from hplan.base.deadline import check_deadline, is_up, kernel_time_limit
from hplan.base.forking import renewed_in_children
from hplan.base.kernels import kernel
from hplan.errors import OptionError
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid, Occupancy, words_for
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import PreparedObstacles
from hplan.planar.grid.sections import ArmSections, sections_at
from hplan.robot.model import Robot

#: Maximum size of a C-space with a turning base [bytes], one bit per node; a search needs five times this memory.
_MOST_CSPACE_BYTES = 150_000_000

#: The deadline is checked at rows whose number has all of these bits clear.
_LAYER_MASK = 63


class YawAxis(NamedTuple):
    """Equally spaced yaws, one for each layer."""

    first: float
    step: float
    size: int


def yaw_axis(start: float, goal: float, step: float, lower: float, upper: float, beyond: float) -> YawAxis:
    """Equally spaced yaws that include start and goal.

    They extend beyond them, within the limits.

    Args:
        step: Maximum spacing.
        lower: Lower limit of the yaw.
        upper: Upper limit of the yaw.
        beyond: Extent beyond start and goal.

    Returns:
        The yaws. If start and goal are nearer to each other than half a step, only the start's yaw is met exactly.
    """
    low, high = min(start, goal), max(start, goal)
    if high - low >= 0.5 * step:
        step = (high - low) / math.ceil((high - low) / step - 1e-9)
    else:
        low = high = start
    below = math.floor(min(beyond, low - lower) / step + 1e-9)
    above = math.floor(min(beyond, upper - high) / step + 1e-9)
    return YawAxis(low - below * step, step, round((high - low) / step) + below + above + 1)


class LayerCache:
    """Cache of planar layers by grid and sections.

    Layers unaffected by a change of the scene are not recomputed. Above `most_bytes` the oldest layers are evicted.
    """

    def __init__(self, most_bytes: int = 64_000_000) -> None:
        self._most_bytes = most_bytes
        self._bytes = 0
        self._held: dict[bytes, WordArray] = {}
        self._lock = renewed_in_children(Lock())

    def __getstate__(self) -> int:
        """Return the capacity in bytes.

        A pickled plan has no layers.
        """
        return self._most_bytes

    def __setstate__(self, most_bytes: int) -> None:
        self.__init__(most_bytes)  # type: ignore[misc]

    def free_words(self, robot: Robot, sections: ArmSections, planar: Grid) -> WordArray:
        """Free bits of a layer, as in `Occupancy`."""
        parts = (planar.lower, planar.step, np.array(planar.shape), sections.link_start, sections.vertex_start)
        key = b"".join(part.tobytes() for part in (*parts, sections.vertices, sections.radii, sections.own_radii))
        found = self._held.get(key)
        if found is None:
            found = occupancy(family_of(robot).arm, sections, planar).free_words
            self._keep(key, found)
        return found

    def _keep(self, key: bytes, words: WordArray) -> None:
        """Store a layer and evict the oldest.

        A layer that another thread has stored meanwhile is kept.
        """
        with self._lock:
            if key in self._held:
                return
            self._held[key] = words
            self._bytes += len(key) + words.nbytes
            while self._bytes > self._most_bytes and len(self._held) > 1:
                oldest = next(iter(self._held))
                self._bytes -= len(oldest) + self._held.pop(oldest).nbytes


def turning_occupancy(
    robot: Robot, obstacles: PreparedObstacles, planar: Grid, yaws: YawAxis, *, layers: LayerCache
) -> Occupancy:
    """Occupancy of the planar grid times yaws.

    Args:
        robot: The arm, with a yaw.
        layers: Cached layers, of this robot only.

    Raises:
        OptionError: The grid takes more than 150 MB.
    """
    first, step, count = yaws
    size = 8 * planar.size * words_for(count)
    if size > _MOST_CSPACE_BYTES:
        raise OptionError(
            "step_deg",
            round(math.degrees(step), 6),
            f"a larger step: with the base turning, one bit for each of {planar.size} nodes and {count} yaws takes "
            f"{size / 1e6:.0f} MB, more than {_MOST_CSPACE_BYTES / 1e6:.0f} MB, and a search takes five times as much",
        )
    grid = Grid(np.append(planar.lower, first), np.append(planar.step, step), (*planar.shape, count))
    words = np.empty((planar.size, words_for(count)), dtype=np.uint64)
    for place in range(words_for(count)):
        some = first + step * np.arange(64 * place, min(count, 64 * place + 64))
        sections = (sections_at(robot, obstacles, yaw) for yaw in some.tolist())
        free = np.stack([layers.free_words(robot, each, planar) for each in sections])
        _stack(free, planar.shape[-1], place, words, kernel_time_limit())
        check_deadline()
    return Occupancy(grid, frozen(words))


@kernel
def _stack(free: WordArray, count: int, place: int, words: WordArray, until: FloatArray) -> None:
    """Assemble a word of every row from 64 planar occupancies.

    Word `place`; each occupancy gives one bit.

    The occupancies are (layers, rows, words). 64 words of 64 bits are transposed: blocks of 32 bits are swapped across
    the diagonal, then blocks of 16 within each of these, and so on.
    """
    layers, rows, planar_words = free.shape
    block = np.empty(64, dtype=np.uint64)
    for row in range(rows):
        if row & _LAYER_MASK == 0 and is_up(until):
            break
        for word in range(planar_words):
            for k in range(64):
                block[k] = free[k, row, word] if k < layers else np.uint64(0)
            size, mask = 32, np.uint64(0xFFFFFFFF)
            while size > 0:
                shift = np.uint64(size)
                for base in range(0, 64, 2 * size):
                    for k in range(base, base + size):
                        change = ((block[k] >> shift) ^ block[k + size]) & mask
                        block[k] ^= change << shift
                        block[k + size] ^= change
                size >>= 1
                mask ^= mask << np.uint64(size)
            first = row * count + 64 * word
            for k in range(min(64, count - 64 * word)):
                words[first + k, place] = block[k]
