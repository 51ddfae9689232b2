"""Obstacles as rows of numbers for the clearance kernels.

The rows of a cloud are the nodes of its tree: if a node's bounding ball is farther than the nearest solid found before
it, all rows below it are skipped. Many obstacles with one row each are grouped by neighbourhood below nodes and skipped
in the same way. Obstacles that concern only some links are below a range of the joints that carry these links.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arrays import BoolArray, FloatArray, IntArray, TableArray
from hplan.base.deadline import check_deadline
from hplan.geometry.cloud import Cloud
from hplan.geometry.convex_distance import corner_table
from hplan.geometry.hull import whole_hull
from hplan.scene.obstacles import Box, Capsule, Solid, Sphere

#: Kinds of rows. Nodes and leaves belong to the tree of a cloud, and a leaf has points; rows below a joint range
#: concern only the bodies that these joints carry.
POINT, SEGMENT, BOX, HULL, NODE, LEAF, JOINT_RANGE = 0, 1, 2, 3, 4, 5, 6

#: Owner of joint-range rows.
RANGE = -2

#: Columns of a row: its kind; the row to continue with if its bounding ball is too far; that ball; the radius around
#: its core. A point has a start, a segment start and end, a box half sizes and, by rows, its axes. A leaf has points in
#: the data from `first` to `last`, a joint range has joints; a hull, in `solid_rows`, has facets up to `edges`, then
#: edges.
#:
#: In `rows_of`, every kind that is a single hull also has the index of its corners in the data. Two numbers precede the
#: corners: the index of their end, and the index of their table (`hplan.geometry.convex_distance`) after them, 0 for no
#: table.
OBSTACLE = np.dtype(
    [
        ("kind", np.int64),
        ("next", np.int64),
        ("centre", np.float64, 3),
        ("bound", np.float64),
        ("radius", np.float64),
        ("corners", np.int64),
        ("first", np.int64),
        ("edges", np.int64),
        ("last", np.int64),
        ("start", np.float64, 3),
        ("end", np.float64, 3),
        ("half", np.float64, 3),
        ("axes", np.float64, 9),
    ],
    align=True,
)

#: Balls and capsules. (Exact types are compared because for hundreds of obstacles `isinstance` of pydantic models takes
#: ten times as long, and longer for several types.)
_ROUND = (Sphere, Capsule)

#: From `_MANY` single-row obstacles on, they are put into groups of `_SIZE` neighbours, and these into larger groups of
#: `_SIZE`; obstacles with a ball larger than `_LARGE` times the median stay outside.
_MANY, _SIZE, _LARGE = 32, 8, 4.0

_Lengths = TypeVar("_Lengths", float, FloatArray)


class FieldArrays(NamedTuple):
    """The arrays of a `hplan.collision.compiled_field.ClearanceField` that kernels read.

    `until` is their deadline (`hplan.base.deadline`): results reached before it hold; after it nothing is verified.
    """

    bodies: TableArray
    pairs: TableArray
    joints: TableArray
    reaches: FloatArray
    points: FloatArray
    solids: TableArray
    data: FloatArray
    until: FloatArray


class _Stack:
    """Blocks of rows, one below the other, and their data.

    Attributes:
        numbers: Number of data values added.
    """

    def __init__(self) -> None:
        self._rows, self._data = [np.zeros(0, OBSTACLE)], [np.zeros(0)]
        self._owner = [np.zeros(0, dtype=np.int64)]
        self._count = self.numbers = 0

    def add(self, rows: TableArray, owner: int | IntArray, data: FloatArray | None = None) -> None:
        """Add rows with their owner and data.

        Args:
            rows: Rows with indices that start at 0.
            owner: Owner of all the rows, or of each.
            data: Data of the rows; None for no data.
        """
        rows["next"] += self._count
        self._rows.append(rows)
        self._owner.append(np.full(len(rows), owner, dtype=np.int64))
        self._count += len(rows)
        if data is not None:
            self._data.append(data)
            self.numbers += len(data)

    @property
    def arrays(self) -> tuple[TableArray, FloatArray, IntArray]:
        """All rows, their data, and the owner of each row."""
        return np.concatenate(self._rows), np.concatenate(self._data), np.concatenate(self._owner)


def solid_rows(obstacles: Sequence[Solid], clearance: float) -> tuple[TableArray, FloatArray]:
    """Rows of obstacles grown by a clearance [m], for distances of points.

    The data are the facets and edges of the hulls.
    """
    stack = _Stack()
    for index, obstacle in enumerate(obstacles):
        rows, more = _rows(obstacle, clearance, stack.numbers)
        stack.add(rows, index, more)
    return stack.arrays[:2]


def rows_of(
    obstacles: Sequence[Solid], clearance: ArrayLike, joints: BoolArray | None = None
) -> tuple[TableArray, FloatArray, IntArray]:
    """Rows of obstacles, with the corners of each.

    Args:
        clearance: Growth of the obstacles [m], one number or one for each.
        joints: (obstacles, dof) mask of the joints whose bodies keep clear of each obstacle; None for all joints and
            obstacles.

    Returns:
        `solids`, `data` and `owner` of `hplan.collision.compiled_field.ClearanceField`.
    """
    stack = _Stack()
    grown = np.broadcast_to(np.asarray(clearance, dtype=np.float64), (len(obstacles),)).tolist()
    kinds = zip(enumerate(obstacles), _joint_words(len(obstacles), joints), strict=True)
    for (is_cloud, _), run in groupby(kinds, lambda numbered: (numbered[0][1].is_point_set, numbered[1])):
        check_deadline()
        of_run = [numbered for numbered, _ in run]
        which = None if joints is None else joints[of_run[0][0]]
        if is_cloud:
            for index, solid in of_run:
                rows, data = _rows(solid, grown[index], stack.numbers)
                stack.add(*_for_joints(rows, np.full(len(rows), index), which), data)
            continue
        rows, data = _solid_rows([solid for _, solid in of_run], grown[of_run[0][0] :], stack.numbers)
        stack.add(*_for_joints(*group_rows(rows, np.array([index for index, _ in of_run])), which), data)
    return stack.arrays


def _solid_rows(obstacles: Sequence[Solid], clearances: Sequence[float], offset: int) -> tuple[TableArray, FloatArray]:
    """One row for each obstacle, with indices from 0, and their corners.

    The corners start at index `offset` of the data.
    """
    rows, data = np.zeros(len(obstacles), OBSTACLE), [np.zeros(0)]
    is_round = [type(solid) in _ROUND for solid in obstacles]
    if any(is_round):
        balls = [solid for solid in obstacles if type(solid) in _ROUND]
        radii = [clearance for clearance, chosen in zip(clearances, is_round, strict=False) if chosen]
        rows[is_round] = found = _round_rows(cast(Sequence[Sphere | Capsule], balls), radii)
        corners = offset + 2 + 8 * np.arange(len(found))
        rows["corners"][is_round] = corners
        end_of = corners + np.where(found["kind"] == POINT, 3, 6)
        data.append(np.column_stack([end_of, np.zeros(len(found)), found["start"], found["end"]]).ravel())
        offset += data[-1].size
    for number in np.flatnonzero(~np.array(is_round)).tolist():
        solid, first = obstacles[number], offset + 2
        end = first + solid.core.size
        table = corner_table(solid.core, first, end, None if isinstance(solid, Box | Cloud) else solid.hull.faces)
        rows[number], rows["corners"][number] = _rows(solid, clearances[number], offset)[0][0], first
        data.append(np.concatenate([[end, end if len(table) else 0], solid.core.ravel(), table]))
        offset += data[-1].size
    return rows, np.concatenate(data)


def _round_rows(obstacles: Sequence[Sphere | Capsule], clearances: Sequence[float]) -> TableArray:
    """Rows of balls and capsules grown by clearances [m], indices from 0."""
    rows = np.zeros(len(obstacles), OBSTACLE)
    radius = np.array([obstacle.radius for obstacle in obstacles]) + clearances
    # A ball is read as a segment of zero length; its row holds the first end only.
    is_ball = np.array([type(obstacle) is Sphere for obstacle in obstacles], dtype=np.bool_)
    ends = [(o.center, o.center) if isinstance(o, Sphere) else (o.start, o.end) for o in obstacles]
    start, end = np.array(ends).transpose(1, 0, 2)
    reach = 0.5 * np.array([math.dist(*both) for both in ends])
    rows["kind"] = np.where(is_ball, POINT, SEGMENT)
    rows["start"], rows["end"] = start, np.where(is_ball[:, None], 0.0, end)
    rows["centre"] = np.where(is_ball[:, None], start, 0.5 * (start + end))
    rows["radius"], rows["bound"] = radius, _bounding(reach, radius)
    rows["next"] = 1
    return rows


def group_rows(rows: TableArray, owner: IntArray) -> tuple[TableArray, IntArray]:
    """Arrange single rows of obstacles below nodes with bounding balls of neighbours.

    Args:
        rows: (n,) rows, each with indices from 0.
        owner: (n,) owners of the rows.

    Returns:
        The reordered rows, with the nodes among them, and their owners: -1 for a node.
    """
    if len(rows) < _MANY:
        rows["next"] += np.arange(len(rows))
        return rows, owner
    is_large = rows["bound"] > _LARGE * np.median(rows["bound"])
    alone, ordered = np.flatnonzero(is_large), _by_neighbourhood(rows["centre"], ~is_large)
    count = len(ordered)
    small = np.arange(0, count, _SIZE)
    large = small[::_SIZE]
    firsts = np.concatenate([large, small, np.arange(count)])
    ends = np.concatenate([*(np.append(starts[1:], count) for starts in (large, small)), np.arange(1, count + 1)])
    nodes = np.zeros(len(large) + len(small), OBSTACLE)
    nodes["kind"] = NODE
    around = [_bounding_balls(rows[ordered], firsts) for firsts in (large, small)]
    nodes["centre"], nodes["bound"] = (np.concatenate(parts) for parts in zip(*around, strict=True))
    # Sorted by the first obstacle of each: the larger group before the smaller one before the obstacle.
    order = np.argsort(firsts, kind="stable")
    found = np.concatenate([rows[alone], np.concatenate([nodes, rows[ordered]])[order]])
    found["next"][: len(alone)] = np.arange(1, len(alone) + 1)
    is_node = order < len(nodes)
    following = np.where(is_node, np.searchsorted(firsts[order], ends[order]), np.arange(1, len(order) + 1))
    found["next"][len(alone) :] = len(alone) + following
    owners = np.concatenate([np.full(len(nodes), -1), owner[ordered]])[order]
    return found, np.concatenate([owner[alone], owners])


def _by_neighbourhood(centres: FloatArray, chosen: BoolArray) -> IntArray:
    """Indices of the chosen (n, 3) points along a Morton curve."""
    numbers = np.flatnonzero(chosen)
    points = centres[numbers]
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    cells = ((points - low) * (1023.0 / max(size, 1e-9))).astype(np.int64)
    key = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return numbers[np.argsort(key, kind="stable")]


def _bounding_balls(rows: TableArray, firsts: IntArray) -> tuple[FloatArray, FloatArray]:
    """(k, 3) centres and (k,) radii of balls around groups of rows' balls.

    Never too small by rounding errors. A group extends from one of `firsts` to the next.
    """
    middles, radii = rows["centre"], rows["bound"]
    low = np.minimum.reduceat(middles - radii[:, None], firsts)
    high = np.maximum.reduceat(middles + radii[:, None], firsts)
    centres = 0.5 * (low + high)
    counts = np.diff(np.append(firsts, len(rows)))
    away = np.linalg.norm(middles - np.repeat(centres, counts, axis=0), axis=1) + radii
    return centres, np.maximum.reduceat(away, firsts) * (1.0 + 1e-12)


def _bounding(reach: _Lengths, radius: _Lengths) -> _Lengths:
    """Radius of a bounding ball, never too small by rounding errors [m]."""
    return (reach + radius) * (1.0 + 1e-12)


def _rows(obstacle: Solid, clearance: float, offset: int) -> tuple[TableArray, FloatArray]:
    """Rows of an obstacle with indices from 0, and their data.

    The rows refer to the data from index `offset` on.
    """
    if isinstance(obstacle, Cloud):
        return _cloud_rows(obstacle, clearance, offset), obstacle.core.ravel()
    if isinstance(obstacle, Sphere | Capsule):
        return _round_rows([obstacle], [clearance]), np.zeros(0)
    data = np.zeros(0)
    row = np.zeros(1, OBSTACLE)
    row["next"], row["radius"] = 1, obstacle.rounding + clearance
    if isinstance(obstacle, Box):
        row["kind"], row["half"] = BOX, 0.5 * np.array(obstacle.size)
        row["axes"] = obstacle.rotation.T.ravel()  # Rows: the box's axes in base_link.
        centre, reach = obstacle.center, 0.5 * math.hypot(*obstacle.size)
    else:
        flat = obstacle.hull
        data = np.concatenate([flat.planes.ravel(), flat.edges.ravel()])
        row["kind"], row["first"], row["edges"] = HULL, offset, offset + flat.planes.size
        row["last"] = offset + len(data)
        low, high = flat.core.min(axis=0), flat.core.max(axis=0)
        centre = tuple((0.5 * (low + high)).tolist())
        reach = float(np.linalg.norm(flat.core - centre, axis=1).max())
    row["centre"], row["bound"] = centre, _bounding(reach, obstacle.rounding + clearance)
    return row, data


def _joint_words(count: int, joints: BoolArray | None) -> list[bytes]:
    """For each obstacle, the joints that concern it, as a hashable word."""
    return [b""] * count if joints is None else [row.tobytes() for row in joints]


def _for_joints(rows: TableArray, owner: IntArray, joints: BoolArray | None) -> tuple[TableArray, IntArray]:
    """Rows and owners below each range of the joints they concern.

    The rows are repeated below each range of the (dof,) mask `joints`. Joint-range rows have the owner `RANGE`. With
    `joints` None they concern all joints.
    """
    if joints is None or joints.all():
        return rows, owner
    blocks, owners, count, chosen = [rows[:0]], [owner[:0]], 0, np.flatnonzero(joints)
    for run in np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1) if len(chosen) else []:
        head = np.zeros(1, OBSTACLE)
        head["kind"], head["first"], head["last"], head["next"] = JOINT_RANGE, run[0], run[-1], len(rows)
        head["centre"], head["bound"] = _bounding_balls(rows, np.zeros(1, dtype=np.int64))
        block = np.concatenate([head, rows])
        block["next"] += count + 1
        count += len(block)
        blocks.append(block)
        owners += [np.array([RANGE]), owner]
    return np.concatenate(blocks), np.concatenate(owners)


def convex_solid(name: str, core: FloatArray, rounding: float) -> Solid:
    """A rounded hull of (k, 3) points as the simplest exact solid.

    A flat hull is thickened.
    """
    _, spread, directions = np.linalg.svd(core - core.mean(axis=0), full_matrices=False)
    flat = np.count_nonzero(spread > 1e-9)
    if flat == 0:
        return Sphere(name=name, center=tuple(core[0].tolist()), radius=rounding)
    if flat == 1:
        a, b = core[np.argsort(core @ directions[0])][[0, -1]]
        return Capsule.model_validate(
            {"name": name, "from": tuple(a.tolist()), "to": tuple(b.tolist()), "radius": rounding}
        )
    return whole_hull(core, name, rounding)


def _cloud_rows(cloud: Cloud, clearance: float, offset: int) -> TableArray:
    """Rows of the nodes of a cloud's tree."""
    tree = cloud.tree
    rows = np.zeros(len(tree), OBSTACLE)
    rows["kind"] = np.where(tree[:, 2] == np.arange(len(tree)) + 1, LEAF, NODE)  # A leaf has no descendants.
    rows["radius"] = cloud.rounding + clearance
    rows["centre"] = tree[:, 3:6]
    rows["bound"] = tree[:, 6] * (1.0 + 1e-12) + rows["radius"]
    rows["first"], rows["last"] = (offset + 3 * tree[:, :2]).T
    rows["next"] = tree[:, 2]
    return rows
