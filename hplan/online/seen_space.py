"""Free space known from the camera and the arm.

Unknown space can be treated as an obstacle.

A grid of voxels around the arm's workspace records when each was last known to be free. A frame frees a voxel that lies
wholly in view: the directions around the camera are divided into cells (`hplan.online.hidden_points`), and in each cell
covered by the ball around the voxel all measurements exist and are farther away than the ball. A ray that ends in a
fruit whose points are ignored counts as measured at its exit from the fruit, because there is no wood in it. The arm
frees the space that it occupies, and everything within its padding, because nothing else can be seen there. Voxels that
contain such a fruit are free too, otherwise no gripper could reach it.

Unknown space is closed off by its voxels next to known space, each represented by a ball: from the known space around
the arm, no motion gets past them. They are an ordinary obstacle, so motions are planned and certified around them.

Not covered: objects thinner than the pixel spacing, because a cell with one return counts as seen through; a missing
return next to other returns in its cell; objects that enter space seen as free, for as long as that is remembered;
objects in a voxel shared with a fruit to be picked. A direction without any return frees nothing, and an outlier in
front hides everything behind it.

The next-best view is the camera pose that shows most unknown space along a motion (`next_view`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record
from hplan.base.kernels import inline, kernel
from hplan.collision.compiled_obstacles import solid_rows
from hplan.collision.motion_coefficients import tight_reach_ball
from hplan.errors import OptionError
from hplan.geometry.vectors import Vector
from hplan.online.arm_shape import arm_solids
from hplan.online.body_distances import distances_from_bodies
from hplan.online.hidden_points import CELLS, cells_about, shortest_ranges
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.obstacles import Solid

#: Name of the obstacle that closes off unknown space.
UNSEEN: Final = "unseen"

#: Maximum number of voxels of a grid; voxels along each side of a block that is checked as a whole first; the factor by
#: which the direction cells of that check are wider.
_MOST: Final = 20_000_000
_BLOCK: Final = 4
_VOXELS_TOGETHER: Final = 4


class SeenSpace:
    """Last time that each voxel was known to be free.

    The voxels cover the arm's workspace.

    Attributes:
        edge: Edge of a voxel [m].
        radius: Radius of the ball around a voxel [m].
        times: (n, n, n) last time that each voxel was known to be free; minus infinity for never [s].
    """

    def __init__(self, robot: Robot, edge: float) -> None:
        """Create a grid in which all space is unknown.

        Raises:
            OptionError: The voxels are too small for the arm's range.
        """
        self.edge, self.radius = edge, 0.5 * math.sqrt(3.0) * edge
        *centre, reach = tight_reach_ball(robot).tolist()
        # One voxel more on each side: the border of space within range is then in the grid.
        count = _BLOCK * math.ceil((2.0 * reach / edge + 4.0) / _BLOCK)
        if count**3 > _MOST:
            least = 2.0 * reach / (_MOST ** (1.0 / 3.0) - 8.0)
            raise OptionError("unseen_edge_m", edge, f"at least {least:.3g} m for a reach of {reach:.3g} m")
        self._corner = np.array(centre) - 0.5 * count * edge
        self.times: FloatArray = np.full((count, count, count), -math.inf)

    def see(
        self, points: FloatArray, pose: tuple[FloatArray, FloatArray], time_s: float, margin_m: float,
        through: FloatArray | None = None,
    ) -> None:  # fmt: skip
        """Free the voxels that a frame looks through.

        Args:
            points: (n, 3) in the camera's frame; points that are not finite are no measurements [m].
            pose: (3, 3) rotation and (3,) position of the camera in `base_link` [m].
            time_s: Time of the frame [s].
            margin_m: An object may be nearer than measured by this [m].
            through: (k, 4) centres and radii of balls in `base_link` that contain only ignored objects: a ray that ends
                in one continues to its other side [m].
        """
        rotation, position = pose
        if through is not None:
            through = np.column_stack([(through[:, :3] - position) @ rotation, through[:, 3]])
        ranges = shortest_ranges(points, through)
        ranges[ranges == math.inf] = 0.0
        together = ranges.reshape(
            6, CELLS // _VOXELS_TOGETHER, _VOXELS_TOGETHER, CELLS // _VOXELS_TOGETHER, _VOXELS_TOGETHER
        )
        coarse = np.stack([together.min(axis=4).min(axis=2).ravel(), together.max(axis=4).max(axis=2).ravel()])
        both = np.stack([ranges, ranges]), coarse
        _see(self.times, self._corner, self.edge, both, rotation, position, np.array([time_s, margin_m]))

    def free(self, solids: Iterable[Solid], time_s: float, within_m: float) -> None:
        """Mark the voxels in or near some solids as free.

        At `time_s` [s].

        A voxel is marked if its centre is within `within_m` of a solid [m].
        """
        for place, inside in self._iterate_near(solids, within_m):
            part = self.times[place]
            part[inside] = np.maximum(part[inside], time_s)

    def holds(self, solids: Iterable[Solid], since_s: float) -> bool:
        """True if all voxels touched by some solids were known free.

        At or after `since_s` [s].
        """
        return not len(self.unknown(solids, since_s))

    def unknown(self, solids: Iterable[Solid], since_s: float) -> FloatArray:
        """(k, 3) centres of the unknown voxels that some solids touch [m].

        A voxel is unknown if it was not known to be free at or after `since_s` [s].
        """
        found = np.zeros(self.times.shape, dtype=np.bool_)
        for place, inside in self._iterate_near(solids, self.radius):
            found[place] |= inside & ~(self.times[place] >= since_s)
        return self._middles(np.argwhere(found))

    def border(self, since_s: float) -> FloatArray:
        """(k, 3) centres of the unknown voxels next to known ones [m].

        A voxel is known if it was free at or after `since_s` [s].
        """
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

    def _iterate_near(self, solids: Iterable[Solid], within_m: float) -> Iterator[tuple[tuple[slice, ...], BoolArray]]:
        """Grid part and voxel mask for each solid.

        The mask selects voxels whose centres are within `within_m` of the solid [m].
        """
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
            distances = distances_from_bodies(self._middles(places).reshape(-1, 3), rows, data, within_m)
            yield place, (distances <= within_m).reshape(places.shape[:3])


@kernel
def _looks_through(
    x: float, y: float, z: float, radius: float, away: float, nearest: float, ranges: FloatArray
) -> tuple[bool, bool]:
    """Whether all measurements toward a ball are far, and whether any is.

    Args:
        x: Position of the ball in the camera's frame, with `y` and `z` [m].
        radius: Radius of the ball [m].
        away: Minimum range of all measurements for the first result [m].
        nearest: Minimum range of any measurement for the second result, which is True if not all of the directions are
            checked [m].
        ranges: (2, 6 n^2) minimum and maximum squared range of each direction cell, zero without measurements.
    """
    cells = int(math.sqrt(ranges.shape[1] / 6.0) + 0.5)
    begin, first, last, top, bottom = cells_about(x, y, z, radius, cells)
    free, any_free = last >= first, last < first or nearest <= 0.0
    least, most = away * away, nearest * nearest
    for column in range(first, last + 1):
        for cell in range(begin + column * cells + top, begin + column * cells + bottom + 1):
            free = free and ranges[0, cell] >= least
            any_free = any_free or ranges[1, cell] >= most
            if any_free and not free:
                return False, True
    return free, any_free


@kernel
def _see(
    times: FloatArray, corner: FloatArray, edge: float, ranges: tuple[FloatArray, FloatArray], rotation: FloatArray,
    position: FloatArray, frame: FloatArray,
) -> None:  # fmt: skip
    """Write the frame's time to the voxels that it looks through.

    Blocks are checked first; their voxels one by one only if the block is undecided.

    Args:
        ranges: Ranges of the direction cells, and of coarser cells, as in `_looks_through`.
        frame: (2,) time [s] and margin [m].
    """
    radius, time_s, margin = 0.5 * math.sqrt(3.0) * edge, frame[0], frame[1]
    all_of, fine, coarse = radius * _BLOCK, ranges[0], ranges[1]
    for block in np.ndindex(times.shape[0] // _BLOCK, times.shape[1] // _BLOCK, times.shape[2] // _BLOCK):
        i0, j0, k0 = block[0] * _BLOCK, block[1] * _BLOCK, block[2] * _BLOCK
        x, y, z = _seen_at(corner, edge, (i0 + 0.5 * _BLOCK, j0 + 0.5 * _BLOCK, k0 + 0.5 * _BLOCK), rotation, position)
        away = math.sqrt(x * x + y * y + z * z)
        # Voxel centres are nearer than the block's by at most the difference of the radii.
        free, any_free = _looks_through(
            x, y, z, all_of, away + all_of + margin, away - all_of + 2.0 * radius + margin, coarse
        )
        if not any_free:
            continue
        for i in range(i0, i0 + _BLOCK):
            for j in range(j0, j0 + _BLOCK):
                for k in range(k0, k0 + _BLOCK):
                    if times[i, j, k] >= time_s:
                        continue
                    if not free:
                        x, y, z = _seen_at(corner, edge, (i + 0.5, j + 0.5, k + 0.5), rotation, position)
                        away = math.sqrt(x * x + y * y + z * z) + radius + margin
                        if not _looks_through(x, y, z, radius, away, 0.0, fine)[0]:
                            continue
                    times[i, j, k] = time_s


@inline
def _seen_at(corner: FloatArray, edge: float, place: Vector, rotation: FloatArray, position: FloatArray) -> Vector:
    """Grid position, counted in voxels, in the camera's frame [m]."""
    dx, dy, dz = (
        corner[0] + place[0] * edge - position[0],
        corner[1] + place[1] * edge - position[1],
        corner[2] + place[2] * edge - position[2],
    )
    return (
        rotation[0, 0] * dx + rotation[1, 0] * dy + rotation[2, 0] * dz,
        rotation[0, 1] * dx + rotation[1, 1] * dy + rotation[2, 1] * dz,
        rotation[0, 2] * dx + rotation[1, 2] * dy + rotation[2, 2] * dz,
    )


@dataclass(frozen=True, eq=False)
class NextView(Record):
    """The next-best view (see `hplan.Planner.next_view`).

    Attributes:
        number: Index of the view among the candidates.
        pose: (4, 4) transform from the camera frame to `base_link`.
        shown: Expected fraction of the unknown voxels in `unseen` that the view shows.
        unseen: (k, 3) centres of the unknown voxels that the motion to the goal would sweep [m].
        motion: Certified motion to the view through known space if the arm carries the camera; None otherwise.
    """

    number: int
    pose: FloatArray
    shown: float
    unseen: FloatArray
    motion: PlanResult | None = None


def sweep(robot: Robot, path: FloatArray, step_m: float) -> list[Solid]:
    """The arm's bodies at selected samples of a path.

    Args:
        robot: The robot.
        path: (n, dof) samples.
        step_m: Approximate maximum displacement of any point between selected samples [m].
    """
    lever = max(1.0, 2.0 * float(tight_reach_ball(robot)[3]))
    moved = lever * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).sum(axis=1))])
    rows = np.unique(np.searchsorted(moved, np.append(np.arange(0.0, moved[-1], step_m), moved[-1])))
    return [solid for q in path[rows] for solid in arm_solids(robot, q)]


def shows(
    unseen: FloatArray,
    radius: float,
    pose: FloatArray,
    solids: Sequence[Solid],
    field_of_view_deg: tuple[float, float],
    farthest_m: float,
) -> BoolArray:
    """(k,) mask of the voxels visible to a camera among known solids.

    The whole ball around a voxel must be in the field of view, with a margin of one direction cell
    (`hplan.online.hidden_points`), and no known solid may intersect the cone to it. Unknown space does not occlude,
    since only the view itself can show it.

    Args:
        unseen: (k, 3) centres of the voxels [m].
        radius: Radius of the balls around them [m].
        pose: (4, 4) transform from the camera frame to `base_link`; z points forward, x right, y down.
        solids: The known solids.
        field_of_view_deg: Width and height of the field of view [deg].
        farthest_m: Sensor range [m].
    """
    seen = (unseen - pose[:3, 3]) @ pose[:3, :3]
    away = np.linalg.norm(seen, axis=1)
    spare = np.arcsin(np.minimum(1.0, radius / np.maximum(away, 1e-9))) + 0.5 * math.pi / CELLS
    inside = (seen[:, 2] > 0.0) & (away + radius <= farthest_m)
    for axis, angle_deg in enumerate(field_of_view_deg):
        off = np.abs(np.arctan2(seen[:, axis], seen[:, 2]))
        inside &= off + spare <= math.radians(0.5 * angle_deg)
    rows, data = solid_rows(solids, 0.0)
    found = np.zeros(len(unseen), dtype=np.bool_)
    for number in np.flatnonzero(inside).tolist():
        # Balls that cover the cone, with centres no farther apart than a voxel's radius.
        shares = np.linspace(0.0, 1.0, 2 + math.ceil(away[number] / radius))[:, None]
        points = pose[:3, 3] + shares * (unseen[number] - pose[:3, 3])
        wide = shares[:, 0] * away[number] * np.sin(spare[number])
        found[number] = bool((distances_from_bodies(points, rows, data) > wide).all())
    return found
