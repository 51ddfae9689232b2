r"""Clearance of the arm in 3-D, and motions shown clear over continuous time.

Clearance at a configuration is only a sample. It becomes a proof with a bound on motion: while a joint-space segment
is traversed, no axis point of link :math:`k` moves farther than

.. math:: |\Delta q_0| \, \varrho_k + \sum_{i \le k} L_i \, |\Delta \varphi_i|,

with :math:`\varphi_i` the absolute angle of link :math:`i` in the plane and :math:`\varrho_k` its largest distance
from the yaw axis. So a link with clearance :math:`d` stays clear for the part of the motion whose bound is below
:math:`d` (conservative advancement). Distances are exact for capsule links against balls, capsules, boxes, hulls and
clouds of balls. The rows of a cloud are the nodes of its tree: where a node's bounding ball is farther than the nearest
solid so far, all rows below it are skipped.

Where the arm can touch itself (`hplan.self_contact`), two links count half of their distance, for the outer one:
neither moves farther than the bound of the outer one, so together they use up no more than twice that. What carries the
arm stands below a gate that only the links pass that can touch it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np
from numpy.typing import ArrayLike

from hplan.arrays import BoolArray, FloatArray, IntArray, frozen, readonly
from hplan.errors import OptionError
from hplan.kernels import inlined, kernel
from hplan.robot import Robot
from hplan.scene import Box, Capsule, Solid, Sphere
from hplan.self_contact import BaseBody, self_contact
from hplan.solids import Cloud, Hull, hull_of

#: Columns of a row: kind, radius, bounding centre (3) and radius, 14 numbers of its kind, the row to go on with where
#: the bounding ball is too far. A node is an inner one of a cloud's tree, its leaves are lots of points. The row below
#: a gate is for the links from one to another; a pair is one link of the arm to one after it.
_POINT, _SEGMENT, _BOX, _HULL, _NODE, _LOT, _GATE, _PAIR = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0
_COLUMNS = 21

#: A hull whose points lie in one plane is made so thick [m].
_THICKNESS = 1e-5

#: Largest turn of a joint between two looks at what is near a motion.
_NEAR_STEP = 0.05


@dataclass(frozen=True, eq=False)
class ClearanceField:
    """Arm and obstacles as flat arrays, ready for the kernels.

    Attributes:
        chain: (links, 4) rows: length, half-width [m], sign, zero offset.
        base: (10,) shoulder position, the plane's horizontal and upward axes, all at yaw 0; 1 where joint 0 is a yaw.
        solids: (rows, 21) balls, capsules, boxes, hulls and nodes of clouds, grown by the clearance to keep.
        data: Facets and edges of hulls, and points of clouds, one after the other; rows say where.
        owner: (rows,) index of the solid behind each row, -1 for parts of the arm.
    """

    chain: FloatArray
    base: FloatArray
    solids: FloatArray
    data: FloatArray
    owner: IntArray

    @classmethod
    def of(
        cls,
        robot: Robot,
        obstacles: Sequence[Solid],
        *,
        clearance: ArrayLike = 0.0,
        own_clearance: float | None = None,
    ) -> ClearanceField:
        """The field of a robot among obstacles.

        Args:
            robot: The arm.
            obstacles: What it keeps clear of.
            clearance: By how much each of them is grown [m], one number or one for each.
            own_clearance: Clearance that parts of the arm are to keep from one another [m]; None for the smallest of
                the others.
        """
        arm = robot.arm
        base = [*robot.plane_origin, *robot.plane_axes[0], *robot.plane_axes[1], float(robot.has_yaw)]
        blocks, data, owner = [np.zeros((0, _COLUMNS))], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        row_count = data_count = 0
        growth = np.asarray(clearance, dtype=np.float64)
        grown = np.broadcast_to(growth, (len(obstacles),)).tolist()
        own = float(growth.min()) if own_clearance is None and growth.size else own_clearance or 0.0
        contact = self_contact(robot)
        for index, part in [*enumerate(obstacles), *((-1, body) for body in contact.bodies)]:
            if isinstance(part, BaseBody):
                rows, more = _base_rows(part, own, data_count)
            else:
                rows, more = _rows(part, grown[index], data_count)
            rows[:, 20] += row_count
            blocks.append(rows)
            data.append(more)
            owner.append(np.full(len(rows), index))
            row_count += len(rows)
            data_count += len(more)
        if contact.links:
            blocks.append(_pair_rows(robot, contact.links, own, row_count))
            owner.append(np.full(len(contact.links), -1))
        return cls(
            chain=readonly(np.column_stack([arm.lengths, arm.half_widths, arm.signs, arm.offsets])),
            base=readonly(base),
            solids=readonly(np.concatenate(blocks)),
            data=readonly(np.concatenate(data)),
            owner=readonly(np.concatenate(owner), np.int64),
        )

    def only(self, kept: BoolArray) -> ClearanceField:
        """The field of some of the solids, and of the arm itself.

        Args:
            kept: (solids,) which of them.
        """
        return self._of_rows(np.append(kept, True)[self.owner])

    def sparing(self, touched: BoolArray) -> ClearanceField:
        """The field where the last link may touch some of the solids.

        Args:
            touched: (solids,) which of them.
        """
        if len(self.chain) < 2:
            return self.only(~touched)
        rows = np.append(touched, False)[self.owner]
        first = rows & (np.concatenate([[-2], self.owner[:-1]]) != self.owner)  # where a gate comes before the row
        before = np.concatenate([[0], np.cumsum(first)])
        solids = np.insert(self.solids, np.flatnonzero(first), 0.0, axis=0)
        moved = np.arange(len(rows)) + before[1:]
        solids[moved, 20] = self.solids[:, 20] + before[self.solids[:, 20].astype(np.int64)]
        ends = np.append(np.flatnonzero(first), len(rows))[1:]
        for start, end in zip(np.flatnonzero(first).tolist(), ends.tolist(), strict=True):
            last = start + int(np.count_nonzero(self.owner[start:end] == self.owner[start]))
            gate = solids[start + before[start]]
            gate[:] = self.solids[start]
            gate[0], gate[6], gate[7] = _GATE, 0, len(self.chain) - 2
            gate[20] = last + before[last]
        owner = np.insert(self.owner, np.flatnonzero(first), self.owner[first])
        return replace(self, solids=frozen(solids), owner=frozen(owner))

    def near(self, path: ArrayLike, distance: float) -> ClearanceField:
        """The field of what is near a motion: for optimisers, who prove in the end with the whole one.

        Args:
            path: (m, dof) waypoints; between them the motion is looked at every `_NEAR_STEP`.
            distance: Distance from the links up to which solids, by their bounding balls, are kept [m].
        """
        points = np.asarray(path, dtype=np.float64)
        parts = [points[:1]]
        for first, last in itertools.pairwise(points):
            count = max(1, math.ceil(float(np.abs(last - first).max()) / _NEAR_STEP))
            parts.append(first + np.linspace(0.0, 1.0, count + 1)[1:, None] * (last - first))
        kept = np.zeros(len(self.solids), dtype=np.bool_)
        _mark_near(np.concatenate(parts), self.chain, self.base, self.solids, distance, kept)
        return self._of_rows(kept)

    def _of_rows(self, kept: BoolArray) -> ClearanceField:
        """The field of some rows; where a node is left out, so is all below it."""
        rows = np.flatnonzero(kept)
        place = np.searchsorted(rows, np.arange(len(self.solids) + 1))  # where the rows kept come to stand
        solids = self.solids[rows]
        solids[:, 20] = place[solids[:, 20].astype(np.int64)]
        return replace(self, solids=frozen(solids), owner=frozen(self.owner[rows]))

    def link_clearances(self, q: ArrayLike) -> FloatArray:
        """Clearance of each link at one configuration.

        Args:
            q: (dof,) configuration.

        Returns:
            (links,) distances to the nearest obstacle [m], inf without obstacles. Negative in contact; the depth is
            exact for balls and for capsules whose axis is not crossed, a lower bound of the depth otherwise.
        """
        result = np.empty(len(self.chain))
        _link_clearances(np.asarray(q, dtype=np.float64), self.chain, self.base, self.solids, self.data, result)
        return result

    def clearance(self, q: ArrayLike) -> float:
        """Least clearance of any link at one configuration [m]."""
        return float(self.link_clearances(q).min())

    def is_clear(self, path: ArrayLike, margin: float) -> bool:
        """Whether the straight joint-space motions between waypoints are shown clear.

        Args:
            path: (m, dof) waypoints.
            margin: Clearance asked for wherever it is evaluated [m], positive. A step from clearance `d` may use up
                `d` before the next look finds at least `margin`, so half of it is shown to be kept everywhere.
        """
        if not margin > 0.0:
            raise OptionError("margin", margin, "a positive number of metres")
        points = np.array(path, dtype=np.float64, order="C")
        return bool(
            np.isfinite(points).all() and _path_is_clear(points, self.chain, self.base, self.solids, self.data, margin)
        )


def _rows(obstacle: Solid, clearance: float, offset: int) -> tuple[FloatArray, FloatArray]:
    """Rows of an obstacle, its first one number 0, and the data that they point to from `offset` on."""
    if isinstance(obstacle, Cloud):
        return _cloud_rows(obstacle, clearance, offset), obstacle.core.ravel()
    data = np.zeros(0)
    row = np.zeros(_COLUMNS)
    core = obstacle.core
    centre = 0.5 * (core.min(axis=0) + core.max(axis=0))
    row[1] = obstacle.rounding + clearance
    row[2:5] = centre
    row[5] = np.linalg.norm(core - centre, axis=1).max() + row[1]
    row[20] = 1
    if isinstance(obstacle, Sphere):
        row[0], row[6:9] = _POINT, obstacle.center
    elif isinstance(obstacle, Capsule):
        row[0], row[6:9], row[9:12] = _SEGMENT, obstacle.start, obstacle.end
    elif isinstance(obstacle, Box):
        row[0], row[6:9] = _BOX, 0.5 * np.array(obstacle.size)
        row[9:18] = obstacle.rotation.T.ravel()  # rows: the box's axes in base_link
    elif isinstance(obstacle, Hull):
        edges = np.column_stack([obstacle.edges, 0.5 * np.linalg.norm(obstacle.edges[:, 3:], axis=1)])
        data = np.concatenate([obstacle.planes.ravel(), edges.ravel()])
        row[0], row[6], row[7], row[8] = _HULL, offset, offset + obstacle.planes.size, offset + len(data)
    else:
        assert_never(obstacle)
    return row[None], data


def _base_rows(body: BaseBody, clearance: float, offset: int) -> tuple[FloatArray, FloatArray]:
    """As `_rows`, below the gate that lets the links pass that can touch the body."""
    rows, data = _rows(_base_solid(body), clearance, offset)
    gate = rows[:1].copy()
    gate[0, 0], gate[0, 6], gate[0, 7], gate[0, 20] = _GATE, body.links[0], body.links[-1], 2
    rows[:, 20] += 1
    return np.concatenate([gate, rows]), data


def _base_solid(body: BaseBody) -> Solid:
    """A shape of turret or pedestal as a solid."""
    core = body.core
    _, spread, directions = np.linalg.svd(core - core.mean(axis=0), full_matrices=False)
    flat = np.count_nonzero(spread > 1e-9)
    if flat == 0:
        return Sphere(name=body.name, center=tuple(core[0]), radius=body.rounding)
    if flat == 1:
        a, b = core[np.argsort(core @ directions[0])][[0, -1]]
        return Capsule.model_validate(
            {"name": body.name, "from": a.tolist(), "to": b.tolist(), "radius": body.rounding}
        )
    if flat == 2:
        core = np.vstack([core - _THICKNESS * directions[2], core + _THICKNESS * directions[2]])
    return replace(hull_of(core, body.name, most=len(core) + 14), rounding=body.rounding)


def _pair_rows(robot: Robot, pairs: Sequence[tuple[int, int]], clearance: float, first: int) -> FloatArray:
    """The rows of pairs of links, from number `first` on; they have no place, and are near to everything."""
    rows, widths = np.zeros((len(pairs), _COLUMNS)), robot.arm.half_widths
    inner, outer = np.array(pairs).T
    rows[:, 0], rows[:, 5] = _PAIR, np.inf
    rows[:, 6], rows[:, 7], rows[:, 8] = inner, outer, widths[inner] + widths[outer] + clearance
    rows[:, 20] = first + 1 + np.arange(len(pairs))
    return rows


def _cloud_rows(cloud: Cloud, clearance: float, offset: int) -> FloatArray:
    """The nodes of a cloud's tree."""
    tree = cloud.tree
    rows = np.zeros((len(tree), _COLUMNS))
    rows[:, 0] = np.where(tree[:, 2] == np.arange(len(tree)) + 1, _LOT, _NODE)  # what has nothing below it is a leaf
    rows[:, 1] = cloud.rounding + clearance
    rows[:, 2:5] = tree[:, 3:6]
    rows[:, 5] = tree[:, 6] * (1.0 + 1e-12) + rows[:, 1]
    rows[:, 6:8] = offset + 3 * tree[:, :2]
    rows[:, 20] = tree[:, 2]
    return rows


@inlined
def _point_segment(
    cx: float, cy: float, cz: float, ax: float, ay: float, az: float, ux: float, uy: float, uz: float
) -> float:
    """Distance of a point from the segment a, a + u."""
    dx, dy, dz = cx - ax, cy - ay, cz - az
    square = ux * ux + uy * uy + uz * uz
    t = 0.0
    if square > 0.0:
        t = min(1.0, max(0.0, (dx * ux + dy * uy + dz * uz) / square))
    dx, dy, dz = dx - t * ux, dy - t * uy, dz - t * uz
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def _segment_segment(
    ax: float, ay: float, az: float, ux: float, uy: float, uz: float,
    bx: float, by: float, bz: float, vx: float, vy: float, vz: float,
) -> float:  # fmt: skip
    """Distance between the segments a, a + u and b, b + v.

    Closest points by clamping (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    rx, ry, rz = ax - bx, ay - by, az - bz
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    vr = vx * rx + vy * ry + vz * rz
    if uu <= 1e-18 and vv <= 1e-18:
        return math.sqrt(rx * rx + ry * ry + rz * rz)
    s, t = 0.0, 0.0
    if uu <= 1e-18:
        t = min(1.0, max(0.0, vr / vv))
    else:
        ur = ux * rx + uy * ry + uz * rz
        if vv <= 1e-18:
            s = min(1.0, max(0.0, -ur / uu))
        else:
            uv = ux * vx + uy * vy + uz * vz
            determinant = uu * vv - uv * uv
            if determinant > 1e-12 * uu * vv:
                s = min(1.0, max(0.0, (uv * vr - ur * vv) / determinant))
            t = (uv * s + vr) / vv
            if t < 0.0:
                t = 0.0
                s = min(1.0, max(0.0, -ur / uu))
            elif t > 1.0:
                t = 1.0
                s = min(1.0, max(0.0, (uv - ur) / uu))
    dx, dy, dz = rx + s * ux - t * vx, ry + s * uy - t * vy, rz + s * uz - t * vz
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def _beyond(x: float, half: float) -> float:
    """How far, with sign, a coordinate is outside [-half, half]."""
    return x - half if x > half else (x + half if x < -half else 0.0)


@kernel
def _segment_box(
    ax: float, ay: float, az: float, ux: float, uy: float, uz: float, hx: float, hy: float, hz: float
) -> float:  # fmt: skip
    """Distance of the segment a, a + u from the box of half sizes h, in the box's frame.

    The squared distance is convex and piecewise quadratic along the segment; its derivative is piecewise linear and
    changes sign between two of the at most eight breakpoints (faces crossed, ends).
    """
    low, high = 0.0, 1.0
    slope_low = 2.0 * (_beyond(ax, hx) * ux + _beyond(ay, hy) * uy + _beyond(az, hz) * uz)
    slope_high = 2.0 * (_beyond(ax + ux, hx) * ux + _beyond(ay + uy, hy) * uy + _beyond(az + uz, hz) * uz)
    t = 0.0
    if slope_low >= 0.0:
        t = 0.0
    elif slope_high <= 0.0:
        t = 1.0
    else:
        for axis in range(3):
            a = ax if axis == 0 else (ay if axis == 1 else az)
            u = ux if axis == 0 else (uy if axis == 1 else uz)
            h = hx if axis == 0 else (hy if axis == 1 else hz)
            if u == 0.0:
                continue
            for side in (-1.0, 1.0):
                x = (side * h - a) / u
                if low < x < high:
                    px, py, pz = ax + x * ux, ay + x * uy, az + x * uz
                    slope = 2.0 * (_beyond(px, hx) * ux + _beyond(py, hy) * uy + _beyond(pz, hz) * uz)
                    if slope >= 0.0:
                        high, slope_high = x, slope
                    else:
                        low, slope_low = x, slope
        t = low - slope_low * (high - low) / (slope_high - slope_low)
    dx, dy, dz = _beyond(ax + t * ux, hx), _beyond(ay + t * uy, hy), _beyond(az + t * uz, hz)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def _segment_hull(
    ax: float, ay: float, az: float, ux: float, uy: float, uz: float,
    data: FloatArray, first: int, middle: int, last: int, enough: float,
) -> float:  # fmt: skip
    """Distance of the segment a, a + u from a hull, or some number from `enough` up where it is no less than that.

    Facets stand in data[first:middle], edges in data[middle:last]. The nearest point of the hull lies on an edge, or on
    the facet above which an end of the segment stands highest.
    """
    bx, by, bz = ax + ux, ay + uy, az + uz
    enter, leave = 0.0, 1.0
    apart, top_a, top_b, at_a, at_b = -math.inf, -math.inf, -math.inf, first, first
    for f in range(first, middle, 4):
        a = data[f] * ax + data[f + 1] * ay + data[f + 2] * az - data[f + 3]
        b = data[f] * bx + data[f + 1] * by + data[f + 2] * bz - data[f + 3]
        if a > top_a:
            top_a, at_a = a, f
        if b > top_b:
            top_b, at_b = b, f
        apart = max(apart, min(a, b))
        if a > 0.0 and b > 0.0:
            leave = -1.0
        elif a > 0.0:
            enter = max(enter, a / (a - b))
        elif b > 0.0:
            leave = min(leave, a / (a - b))
    if enter <= leave:
        return 0.0  # part of the segment is below every facet
    if apart >= enough:
        return apart
    least = enough
    for end in range(2):
        height, at = (top_a, at_a) if end == 0 else (top_b, at_b)
        if height > 0.0:
            px = (ax if end == 0 else bx) - height * data[at]
            py = (ay if end == 0 else by) - height * data[at + 1]
            pz = (az if end == 0 else bz) - height * data[at + 2]
            inside = True
            for f in range(first, middle, 4):
                if data[f] * px + data[f + 1] * py + data[f + 2] * pz - data[f + 3] > 1e-9:
                    inside = False
                    break
            if inside:
                least = min(least, height)
    for e in range(middle, last, 7):
        # No edge that is farther than the nearest so far, by its middle and half its length.
        mx, my, mz = data[e] + 0.5 * data[e + 3], data[e + 1] + 0.5 * data[e + 4], data[e + 2] + 0.5 * data[e + 5]
        if _point_segment(mx, my, mz, ax, ay, az, ux, uy, uz) - data[e + 6] < least:
            distance = _segment_segment(
                ax, ay, az, ux, uy, uz,
                data[e], data[e + 1], data[e + 2], data[e + 3], data[e + 4], data[e + 5],
            )  # fmt: skip
            least = min(least, distance)
    return least


@kernel
def _links_apart(q: FloatArray, first: int, chain: FloatArray, inner: int, outer: int) -> float:
    """Distance between the axes of two links, in the plane; the end of the inner one is the origin, its direction x."""
    x, y, angle = 0.0, 0.0, 0.0
    along, up = 0.0, 0.0
    for k in range(inner + 1, outer + 1):
        x, y = x + along, y + up
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
    length = chain[inner, 0]
    distance: float = _segment_segment(x, y, 0.0, along, up, 0.0, -length, 0.0, 0.0, length, 0.0, 0.0)
    return distance


@kernel
def _link_clearances(
    q: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, data: FloatArray, result: FloatArray
) -> None:
    """Clearance of each link at one configuration."""
    first = 1 if base[9] > 0.0 else 0
    yaw_cos, yaw_sin = 1.0, 0.0
    if first:
        yaw_cos, yaw_sin = math.cos(q[0]), math.sin(q[0])
    fx, fy = yaw_cos * base[3] - yaw_sin * base[4], yaw_sin * base[3] + yaw_cos * base[4]
    gx, gy = yaw_cos * base[6] - yaw_sin * base[7], yaw_sin * base[6] + yaw_cos * base[7]
    x, y, z = yaw_cos * base[0] - yaw_sin * base[1], yaw_sin * base[0] + yaw_cos * base[1], base[2]
    angle = 0.0
    for k in range(chain.shape[0]):
        angle += chain[k, 2] * q[first + k] + chain[k, 3]
        along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
        ux, uy, uz = along * fx + up * gx, along * fy + up * gy, along * base[5] + up * base[8]
        mx, my, mz = x + 0.5 * ux, y + 0.5 * uy, z + 0.5 * uz
        half_length = 0.5 * chain[k, 0]
        least = math.inf
        following = 0
        while following < solids.shape[0]:
            s = following
            dx, dy, dz = solids[s, 2] - mx, solids[s, 3] - my, solids[s, 4] - mz
            within = least + half_length + solids[s, 5]
            if dx * dx + dy * dy + dz * dz > within * within:
                # Its bounding ball is farther than the nearest so far.
                following = int(solids[s, 20]) if solids[s, 0] >= _NODE else s + 1
                continue
            following = s + 1
            kind = solids[s, 0]
            distance = math.inf
            if kind == _POINT:
                distance = _point_segment(solids[s, 6], solids[s, 7], solids[s, 8], x, y, z, ux, uy, uz)
            elif kind == _SEGMENT:
                distance = _segment_segment(
                    x, y, z, ux, uy, uz, solids[s, 6], solids[s, 7], solids[s, 8],
                    solids[s, 9] - solids[s, 6], solids[s, 10] - solids[s, 7], solids[s, 11] - solids[s, 8],
                )  # fmt: skip
            elif kind == _BOX:
                ox, oy, oz = x - solids[s, 2], y - solids[s, 3], z - solids[s, 4]
                distance = _segment_box(
                    ox * solids[s, 9] + oy * solids[s, 10] + oz * solids[s, 11],
                    ox * solids[s, 12] + oy * solids[s, 13] + oz * solids[s, 14],
                    ox * solids[s, 15] + oy * solids[s, 16] + oz * solids[s, 17],
                    ux * solids[s, 9] + uy * solids[s, 10] + uz * solids[s, 11],
                    ux * solids[s, 12] + uy * solids[s, 13] + uz * solids[s, 14],
                    ux * solids[s, 15] + uy * solids[s, 16] + uz * solids[s, 17],
                    solids[s, 6],
                    solids[s, 7],
                    solids[s, 8],
                )
            elif kind == _HULL:
                distance = _segment_hull(
                    x, y, z, ux, uy, uz, data, int(solids[s, 6]), int(solids[s, 7]), int(solids[s, 8]),
                    least + solids[s, 1],
                )  # fmt: skip
            elif kind == _GATE:
                if not solids[s, 6] <= k <= solids[s, 7]:
                    following = int(solids[s, 20])
            elif kind == _PAIR:
                if k == solids[s, 7]:
                    apart = _links_apart(q, first, chain, int(solids[s, 6]), k) - solids[s, 8]
                    distance = 0.5 * apart + chain[k, 1]  # less the half-width, below
            elif _point_segment(solids[s, 2], solids[s, 3], solids[s, 4], x, y, z, ux, uy, uz) > least + solids[s, 5]:
                following = int(solids[s, 20])
            elif kind == _LOT:
                for p in range(int(solids[s, 6]), int(solids[s, 7]), 3):
                    distance = min(distance, _point_segment(data[p], data[p + 1], data[p + 2], x, y, z, ux, uy, uz))
            least = min(least, distance - solids[s, 1])
        result[k] = least - chain[k, 1]
        x, y, z = x + ux, y + uy, z + uz


@kernel
def _mark_near(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, distance: float, near: BoolArray
) -> None:
    """Mark the rows whose bounding ball comes within a distance of a link at some configuration."""
    first = 1 if base[9] > 0.0 else 0
    for i in range(path.shape[0]):
        yaw_cos, yaw_sin = 1.0, 0.0
        if first:
            yaw_cos, yaw_sin = math.cos(path[i, 0]), math.sin(path[i, 0])
        fx, fy = yaw_cos * base[3] - yaw_sin * base[4], yaw_sin * base[3] + yaw_cos * base[4]
        gx, gy = yaw_cos * base[6] - yaw_sin * base[7], yaw_sin * base[6] + yaw_cos * base[7]
        x, y, z = yaw_cos * base[0] - yaw_sin * base[1], yaw_sin * base[0] + yaw_cos * base[1], base[2]
        angle = 0.0
        for k in range(chain.shape[0]):
            angle += chain[k, 2] * path[i, first + k] + chain[k, 3]
            along, up = chain[k, 0] * math.cos(angle), chain[k, 0] * math.sin(angle)
            ux, uy, uz = along * fx + up * gx, along * fy + up * gy, along * base[5] + up * base[8]
            for s in range(solids.shape[0]):
                if not near[s]:
                    reach = _point_segment(solids[s, 2], solids[s, 3], solids[s, 4], x, y, z, ux, uy, uz)
                    near[s] = reach <= distance + solids[s, 5] + chain[k, 1]
            x, y, z = x + ux, y + uy, z + uz


@kernel
def smallest(values: FloatArray) -> float:
    """Smallest of a few values."""
    least = math.inf
    for value in values:
        least = min(least, value)
    return least


@inlined
def proven_advance(clear: FloatArray, bounds: FloatArray, margin: float) -> float:
    """The share of a motion, at most 1, that cannot use up any link's clearance; -1 where the margin is not kept."""
    advance = 1.0
    for k in range(len(clear)):
        if not clear[k] >= margin:  # so that nothing that is no number passes
            advance = -1.0
            break
        if bounds[k] * advance > clear[k]:
            advance = clear[k] / bounds[k]
    return advance


@kernel
def motion_bounds(turns: FloatArray, chain: FloatArray, base: FloatArray, result: FloatArray) -> None:
    """Largest displacement of any axis point of each link while all joints turn in proportion, by `turns` in all.

    Args:
        turns: (dof,) joint displacements.
        chain: As in `ClearanceField`.
        base: As in `ClearanceField`.
        result: (links,) bounds, written [m].
    """
    first = 1 if base[9] > 0.0 else 0
    swing = abs(turns[0]) if first else 0.0
    radius = math.hypot(base[0], base[1])
    absolute, bound = 0.0, 0.0
    for k in range(chain.shape[0]):
        absolute += chain[k, 2] * turns[first + k]
        bound += chain[k, 0] * abs(absolute)
        radius += chain[k, 0]
        result[k] = bound + swing * radius


@kernel
def _path_is_clear(
    path: FloatArray, chain: FloatArray, base: FloatArray, solids: FloatArray, data: FloatArray, margin: float
) -> bool:
    """Conservative advancement along every segment of a polyline."""
    for i in range(path.shape[0] - 1):
        if not segment_is_clear(path[i], path[i + 1], chain, base, solids, data, margin):
            return False
    return True


@kernel
def segment_is_clear(
    start: FloatArray,
    end: FloatArray,
    chain: FloatArray,
    base: FloatArray,
    solids: FloatArray,
    data: FloatArray,
    margin: float,
) -> bool:
    """Whether the straight joint-space motion is shown clear; `margin` is asked for wherever it is evaluated."""
    links, dof = chain.shape[0], start.shape[0]
    bounds, clear, q, turns = np.empty(links), np.empty(links), np.empty(dof), np.empty(dof)
    for i in range(dof):
        turns[i] = end[i] - start[i]
    motion_bounds(turns, chain, base, bounds)
    # The middle first: where a motion fails it often fails there.
    t, at_middle = 0.5, True
    while True:
        for i in range(dof):
            q[i] = start[i] + t * turns[i]
        _link_clearances(q, chain, base, solids, data, clear)
        advance = proven_advance(clear, bounds, margin)
        if advance < 0.0:
            return False
        if t >= 1.0:
            return True
        t = 0.0 if at_middle else min(1.0, t + advance)
        at_middle = False
