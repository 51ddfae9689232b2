"""Space that a camera has seen through, or where the arm has been: all other counts as solid where that is asked for.

A grid of voxels about all that the arm can reach notes when each was last known to be free. A frame frees a voxel that
lies wholly in view: the directions about the camera are cut into cells (`hplan.online.hidden_points`), and in each one
that the ball about the voxel covers something was measured, all of it farther off than the ball. The arm frees where it
stands, and what is as near to it as its padding: nothing else can be seen there. So do fruits whose points are to be
ignored, with what is as near to them: else no hand came to them.

What is not known is closed off by the voxels that border on what is, a ball about each: from where the arm is known to
be it cannot get past them. They are an obstacle as any other, so motions are planned and certified past them.

Not covered: what is thinner than the pixels are apart, for a cell with one return counts as looked through; a return
that is missing beside others in its cell; what comes into space that was seen free, for as long as that is kept. A
direction without any return frees nothing, and an outlier in front hides what is behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.kernels import kernel
from hplan.collision.obstacle_rows import solid_rows
from hplan.errors import OptionError
from hplan.online.arm_shape import reach_ball
from hplan.online.body_distances import distances_from_bodies
from hplan.online.hidden_points import CELLS, shortest_ranges, side_of_cube
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid

#: Name of the obstacle that closes off what is not known.
UNSEEN: Final = "unseen"

#: Most voxels of a grid.
_MOST: Final = 20_000_000


class SeenSpace:
    """When each voxel within the arm's reach was last known to be free.

    Attributes:
        edge: Edge of a voxel [m].
        radius: Radius of the ball about a voxel [m].
        times: (n, n, n) when each was last known to be free; minus infinity for never [s].
    """

    def __init__(self, robot: Robot, edge: float) -> None:
        """Know nothing.

        Raises:
            OptionError: Voxels that are too small for the arm's reach.
        """
        self.edge, self.radius = edge, 0.5 * math.sqrt(3.0) * edge
        *centre, reach = reach_ball(robot).tolist()
        # A voxel more on each side: what borders on space within reach is in the grid.
        count = 2 * math.ceil(reach / edge) + 4
        if count**3 > _MOST:
            least = 2.0 * reach / (_MOST ** (1.0 / 3.0) - 6.0)
            raise OptionError("unseen_edge_m", edge, f"at least {least:.3g} m for a reach of {reach:.3g} m")
        self._corner = np.array(centre) - 0.5 * count * edge
        self.times: FloatArray = np.full((count, count, count), -math.inf)

    def see(self, points: FloatArray, pose: tuple[FloatArray, FloatArray], time_s: float, margin_m: float) -> None:
        """Take a frame: free what it has looked through.

        Args:
            points: (n, 3) in the camera's frame; not finite ones are no measurements [m].
            pose: (3, 3) rotation and (3,) position of the camera in `base_link` [m].
            time_s: When it was taken [s].
            margin_m: So much nearer than measured something may be [m].
        """
        rotation, position = pose
        ranges = shortest_ranges(points)
        _see(self.times, self._corner, self.edge, ranges, rotation, position, np.array([time_s, margin_m]))

    def free(self, solids: Iterable[Solid], time_s: float, padding_m: float) -> None:
        """Take as free, at a time [s], where some solids are and what is as near to them as a padding [m]."""
        for place, inside in self._about(solids, padding_m + self.radius):
            part = self.times[place]
            part[inside] = np.maximum(part[inside], time_s)

    def holds(self, solids: Iterable[Solid], since_s: float) -> bool:
        """True if all that some solids touch was known to be free since a time [s]."""
        return all((self.times[place][inside] >= since_s).all() for place, inside in self._about(solids, self.radius))

    def border(self, since_s: float) -> FloatArray:
        """(k, 3) middles of the voxels not known to be free since a time that border on such as are [m]."""
        known = self.times >= since_s
        beside = np.zeros_like(known)
        for axis in range(3):
            a, b = np.moveaxis(beside, axis, 0), np.moveaxis(known, axis, 0)
            a[1:] |= b[:-1]
            a[:-1] |= b[1:]
        beside &= ~known
        return self._middles(np.argwhere(beside))

    def _middles(self, places: IntArray) -> FloatArray:
        middles: FloatArray = self._corner + (places + 0.5) * self.edge
        return middles

    def _about(self, solids: Iterable[Solid], within_m: float) -> Iterator[tuple[tuple[slice, ...], BoolArray]]:
        """For each solid a part of the grid, and the voxels in it whose middles are so near to it."""
        for solid in solids:
            away = solid.rounding + within_m
            low = np.floor((solid.core.min(axis=0) - away - self._corner) / self.edge).astype(np.int64)
            high = np.ceil((solid.core.max(axis=0) + away - self._corner) / self.edge).astype(np.int64)
            low, high = np.clip(low, 0, len(self.times)), np.clip(high, 0, len(self.times))
            place = tuple(slice(a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True))
            places = np.stack(
                np.meshgrid(*(np.arange(each.start, each.stop) for each in place), indexing="ij"), axis=-1
            )
            rows, data = solid_rows([solid], 0.0)
            distances = distances_from_bodies(self._middles(places).reshape(-1, 3), rows, data)
            yield place, (distances <= within_m).reshape(places.shape[:3])


@kernel
def _see(
    times: FloatArray, corner: FloatArray, edge: float, ranges: FloatArray, rotation: FloatArray, position: FloatArray,
    frame: FloatArray,
) -> None:  # fmt: skip
    """Write the frame's time to the voxels that it looks through.

    Args:
        ranges: Least squared range of each cell of directions; infinite for none.
        frame: (2,) time [s] and margin [m].
    """
    radius, half = 0.5 * math.sqrt(3.0) * edge, 0.5 * CELLS
    time_s, margin = frame[0], frame[1]
    x0, y0 = corner[0] + 0.5 * edge - position[0], corner[1] + 0.5 * edge - position[1]
    z0 = corner[2] + 0.5 * edge - position[2]
    for i in range(times.shape[0]):
        for j in range(times.shape[1]):
            for k in range(times.shape[2]):
                if times[i, j, k] >= time_s:
                    continue
                dx, dy, dz = x0 + i * edge, y0 + j * edge, z0 + k * edge
                x = rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz
                y = rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz
                z = rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz
                side, longest, u, v = side_of_cube(x, y, z)
                near = longest - radius
                if near <= 0.0:
                    continue
                # Slopes of all directions to the ball; those of more than one side of the cube are left.
                far = longest + radius
                left, right = u - radius, u + radius
                low, high = v - radius, v + radius
                left, right = left / (near if left < 0.0 else far), right / (near if right > 0.0 else far)
                low, high = low / (near if low < 0.0 else far), high / (near if high > 0.0 else far)
                if left < -1.0 or right > 1.0 or low < -1.0 or high > 1.0:
                    continue
                away = math.sqrt(x * x + y * y + z * z) + radius + margin
                least = away * away
                first, last = int(left * half + half), min(int(right * half + half), CELLS - 1)
                top, bottom = int(low * half + half), min(int(high * half + half), CELLS - 1)
                free = True
                for column in range(first, last + 1):
                    begin = (side * CELLS + column) * CELLS
                    for line in range(begin + top, begin + bottom + 1):
                        if not least <= ranges[line] < math.inf:
                            free = False
                            break
                    if not free:
                        break
                if free:
                    times[i, j, k] = time_s
