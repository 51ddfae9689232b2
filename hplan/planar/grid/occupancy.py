r"""Analytic C-space: closed-form intervals of forbidden joint angles.

Link by link, by the paper's equations (1)-(3).

A link of length :math:`L` turns about its near joint. A disc of radius :math:`R` (obstacle grown by the link's
half-width) has its centre at distance :math:`\rho` from the joint, at bearing :math:`\varphi`. The link's axis meets
the disc for

.. math::
    |\theta - \varphi| \le \begin{cases}
        \arcsin(R / \rho)                                & \rho^2 \le L^2 + R^2 \quad (1) \\
        \arccos\frac{L^2 + \rho^2 - R^2}{2 L \rho}       & \rho \le L + R \quad (2) \\
        \text{never}                                     & \text{beyond} \quad (3)
    \end{cases}

(`_disc_half_angle`) and always if :math:`\rho \le R`. This is exact for a capsule link. The paper puts case 3 at
:math:`\rho > \sqrt{L^2 + w^2} + r`, the reach of a rectangle's corner (model `paper`); the model `rectangle` solves
the rectangle itself (`hplan.planar.grid.rectangle_link`). Angles run counter-clockwise from +x of the arm plane,
bearings by arctan2(y, x). The paper prints arctan(x / y), which gives its figures in no frame
(`scripts/reproduce_paper.py` tries both).

A rounded polygon also yields one interval: the hull of the intervals of its corner discs and of the directions to its
straight sides' intersections with the circle of the link's reach.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray, WordArray, frozen, readonly
from hplan.base.deadline import check_deadline, is_up, kernel_time_limit
from hplan.base.kernels import inline, kernel
from hplan.errors import InputError
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.planar.grid.rectangle_link import rectangle_half_angles
from hplan.planar.grid.sections import LINK_MODELS, ArmSections, SectionArrays
from hplan.planar.planar_family import PlanarArm
from hplan.planar.self_contact import part_of_arm

_CAPSULE, _PAPER, _RECTANGLE = range(len(LINK_MODELS))
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)

#: A joint closer than this to a rounded polygon counts as inside: bearings of such near points would be noise [m].
_TOUCHING = 1e-12

#: The deadline is checked at rows whose number has all of these bits clear.
_ROW_MASK = 63


class _Links(NamedTuple):
    """Links of an arm, their joints' grid axes, and the deadline.

    Links are as in `PlanarArm`, axes as in `Grid`.

    All arrays are (links,); for the deadline see `hplan.base.deadline`.
    """

    lengths: FloatArray
    half_widths: FloatArray
    signs: FloatArray
    offsets: FloatArray
    lower: FloatArray
    step: FloatArray
    counts: IntArray
    until: FloatArray


class _Axis(NamedTuple):
    """One axis of the grid.

    Node i is the relative link angle `sign * (lower + i * step) + offset`.
    """

    lower: float
    step: float
    size: int
    sign: float
    offset: float


class _Poses(NamedTuple):
    """(rows,) poses of a link's joint at the preceding joints' nodes.

    Each row of the grid has one pose.

    Attributes:
        alive: True if all preceding links are free.
        x: First coordinate of the joint [m].
        y: Second coordinate of the joint [m].
        cos: Direction of the preceding link, first component.
        sin: Direction of the preceding link, second component.
    """

    alive: BoolArray
    x: FloatArray
    y: FloatArray
    cos: FloatArray
    sin: FloatArray


def occupancy(arm: PlanarArm, sections: ArmSections, grid: Grid) -> Occupancy:
    """Occupancy of the joint grid.

    A node is occupied if a link meets a section.

    For `n` joints of `N` nodes each, a section needs one interval for the first link, `N` for the second and
    `N**(n - 1)` for the last, whose rows are filled by interval.

    Raises:
        InputError: The number of axes or sections does not match the arm's number of links.
    """
    links = arm.link_count
    if len(grid.shape) != links or len(sections.link_start) != links + 1:
        raise InputError(
            f"occupancy: the arm has {links} links, the grid has {len(grid.shape)} axes, and the sections are for "
            f"{len(sections.link_start) - 1} links",
        )
    shape = np.array(grid.shape)
    joints = _Links(
        arm.lengths, arm.half_widths, arm.signs, arm.offsets, grid.lower, grid.step, shape, kernel_time_limit()
    )
    words = _fill_rows(joints, LINK_MODELS.index(sections.link_model), sections.arrays)
    check_deadline()
    for (link, other, _), radius in zip(sections.own_pairs.tolist(), sections.own_radii.tolist(), strict=True):
        if link < links:
            _take_out_contact(words, arm, grid, link, other, radius)
    return Occupancy(grid, frozen(words))


def _take_out_contact(words: WordArray, arm: PlanarArm, grid: Grid, link: int, other: int, radius: float) -> None:
    """Clear the bits of nodes with two link axes too close.

    Closer than `radius` to the axis of an earlier link.

    This depends only on the joints between the two: the links after `other` form a separate arm, and `other` is an
    obstacle to the last of them.
    """
    between = slice(other + 1, link + 1)
    length = float(arm.lengths[other])
    before = ArmSections(
        link_model="capsule",
        link_start=readonly([*([0] * (link - other)), 1], np.int64),
        vertex_start=readonly([0, 2], np.int64),
        vertices=readonly([[-length, 0.0], [0.0, 0.0]]),
        radii=readonly([radius]),
        bounds=readonly([[-0.5 * length, 0.0, 0.5 * length + radius]]),
        obstacle_of=readonly([0], np.int64),
        obstacle_names=(arm.link_names[other],),
    )
    part = Grid(grid.lower[between], grid.step[between], grid.shape[between])
    apart = occupancy(part_of_arm(arm, other + 1, link), before, part)
    rows = words.reshape(math.prod(grid.shape[: other + 1]), -1, words.shape[1])
    if link == arm.link_count - 1:
        rows &= apart.free_words
    else:
        rows = words.reshape(len(rows), part.size, -1)
        rows[:, apart.occupied_mask.ravel()] = 0


@inline
def _disc_half_angle(rho: float, length: float, radius: float) -> float:
    """Half-angle of contact by equations (1) and (2), for rho > radius.

    It is -1, equation (3), if the disc is out of reach.
    """
    if rho > length + radius:
        return -1.0
    if rho * rho <= length * length + radius * radius:
        return math.asin(radius / rho)
    cosine = (length * length + rho * rho - radius * radius) / (2.0 * length * rho)
    return math.acos(min(1.0, cosine))


@inline
def _disc_tangent(square: float, length: float, radius: float) -> tuple[float, float]:
    """Direction of `_disc_half_angle` for a squared distance: scaled cosine and sine.

    Polygons need the direction for each corner, but the angle for only two corners. (For one disc the arc sine is
    faster.)
    """
    if square <= length * length + radius * radius:
        return math.sqrt(square - radius * radius), radius
    if square <= (length + radius) * (length + radius):
        along = 0.5 * (length * length + square - radius * radius)
        return along, math.sqrt(max(0.0, length * length * square - along * along))
    return 0.0, 0.0


@kernel
def _polygon_interval(
    vertices: FloatArray, first: int, last: int, radius: float, pose: tuple[float, float, float, float], length: float
) -> tuple[int, float, float]:
    """Interval of angles in which a link meets a rounded polygon.

    The link begins at (x, y).

    Angles are relative to the direction (cos, sin). The interval is narrower than pi, so the signs of cross products
    select its ends among the directions to points, and only these two directions are converted to angles.

    Args:
        vertices: Points of all sections.
        first: Index of the polygon's first vertex.
        last: Index after its last vertex.
        pose: x, y, cos, sin.

    Returns:
        0 (never), 1 (between the two angles, the second may pass pi) or 2 (always), and the angles.
    """
    px, py, cos, sin = pose
    inside = last - first >= 3
    square_length = length * length
    touching = (radius + _TOUCHING) * (radius + _TOUCHING)
    sure = max(0.0, length - radius)  # a corner nearer than this has its whole disc within reach
    cone = (0.0, 0.0, 0.0, 0.0)
    ax, ay = vertices[last - 1, 0] - px, vertices[last - 1, 1] - py
    before = ax * ax + ay * ay
    for i in range(first, last):
        # The corner, and the side from the previous corner to it.
        bx, by = vertices[i, 0] - px, vertices[i, 1] - py
        square = bx * bx + by * by
        if square <= touching:
            return 2, 0.0, 0.0
        along, across = _disc_tangent(square, length, radius)
        if along > 0.0 or across > 0.0:
            cone = _widen_cone(
                cone, bx * along + by * across, by * along - bx * across,
                bx * along - by * across, by * along + bx * across,
            )  # fmt: skip
        ex, ey = bx - ax, by - ay
        edge = ex * ex + ey * ey
        if edge > 0.0:
            outward = ex * ay - ey * ax  # distance of the joint to the right of the side, times the side's length
            along = -(ex * ax + ey * ay)
            if outward > 0.0:
                inside = False
            if 0.0 <= along <= edge and outward * outward <= touching * edge:
                return 2, 0.0, 0.0
            # Intersection of the straight side on the right with the reach. (Two vertices have two sides, there and
            # back, and therefore both sides of a stadium.)
            if before > sure * sure or square > sure * sure:
                size = math.sqrt(edge)
                distance = outward / size - radius
                if abs(distance) < length:
                    chord = math.sqrt(square_length - distance * distance)
                    ux, uy = ex / size, ey / size
                    for direction in (-1.0, 1.0):
                        t = along / size + direction * chord
                        if 0.0 <= t <= size:
                            x, y = ax + t * ux + radius * uy, ay + t * uy - radius * ux
                            cone = _widen_cone(cone, x, y, x, y)
        ax, ay, before = bx, by, square
    if inside:
        return 2, 0.0, 0.0
    lx, ly, hx, hy = cone
    if lx == 0.0 and ly == 0.0:
        return 0, 0.0, 0.0
    low = math.atan2(cos * ly - sin * lx, cos * lx + sin * ly)
    return 1, low, low + max(0.0, math.atan2(lx * hy - ly * hx, lx * hx + ly * hy))


@inline
def _widen_cone(
    cone: tuple[float, float, float, float], ax: float, ay: float, bx: float, by: float
) -> tuple[float, float, float, float]:
    """Widen a counter-clockwise cone of directions to include another.

    The other cone is from a to b.
    """
    lx, ly, hx, hy = cone
    if lx == 0.0 and ly == 0.0:
        return ax, ay, bx, by
    if lx * ay - ly * ax < 0.0:
        lx, ly = ax, ay
    if hx * by - hy * bx > 0.0:
        hx, hy = bx, by
    return lx, ly, hx, hy


@kernel
def _mark(rows: WordArray, r: int, low: float, high: float, axis: _Axis) -> None:
    """Clear the bits of row `r` in an interval of angles.

    The relative link angle is in [low, high] (mod 2 pi).
    """
    lower, step, count, sign, offset = axis
    if sign < 0.0:
        low, high = offset - high, offset - low
    else:
        low, high = low - offset, high - offset
    turn = 2.0 * math.pi
    if high < lower or high >= lower + turn:
        shift = turn * math.ceil((lower - high) / turn)
        low, high = low + shift, high + shift
    upper = lower + step * (count - 1)
    while low <= upper:
        first = max(0, math.ceil((low - lower) / step))
        last = min(count - 1, math.floor((high - lower) / step))
        if first <= last:
            for word in range(first >> 6, (last >> 6) + 1):
                mask = _ALL
                if word == first >> 6:
                    mask &= _ALL << np.uint64(first & 63)
                if word == last >> 6:
                    mask &= _ALL >> np.uint64(63 - (last & 63))
                rows[r, word] &= ~mask
        low, high = low + turn, high + turn


@inline
def _bounding_axis(links: _Links, k: int) -> _Axis:
    """Grid axis of joint k."""
    return _Axis(links.lower[k], links.step[k], links.counts[k], links.signs[k], links.offsets[k])


@kernel
def _fill_link(rows: WordArray, poses: _Poses, k: int, links: _Links, model: int, sections: SectionArrays) -> None:
    """Free bits of the rows of link k.

    A row with colliding earlier links is fully occupied.
    """
    alive, px, py, cos, sin = poses
    length, half_width, axis = links.lengths[k], links.half_widths[k], _bounding_axis(links, k)
    link_start, vertex_start, vertices, radii, bounds = sections
    words, first, last = rows.shape[1], link_start[k], link_start[k + 1]
    corner = math.hypot(length, half_width)
    reach = corner if model == _RECTANGLE else length
    tail = _ALL >> np.uint64((64 - axis.size) & 63)
    for r in range(rows.shape[0]):
        blocked = not alive[r]
        for w in range(words):
            rows[r, w] = np.uint64(0) if blocked else (tail if w == words - 1 else _ALL)
        if blocked:
            continue
        if r & _ROW_MASK == 0 and is_up(links.until):
            break
        for s in range(first, last):
            dx, dy = bounds[s, 0] - px[r], bounds[s, 1] - py[r]
            limit = reach + bounds[s, 2]
            square = dx * dx + dy * dy
            if square > limit * limit:
                continue
            radius = radii[s]
            # Forbidden angles by `state`: 0 empty, 1 [low, high], 2 all, 3 [low, high] and its mirror image.
            state, low, high, bearing = 0, 0.0, 0.0, 0.0
            if vertex_start[s + 1] - vertex_start[s] > 1:
                state, low, high = _polygon_interval(
                    vertices, vertex_start[s], vertex_start[s + 1], radius, (px[r], py[r], cos[r], sin[r]), length
                )
            else:
                rho = math.sqrt(square)
                bearing = math.atan2(cos[r] * dy - sin[r] * dx, cos[r] * dx + sin[r] * dy)
                if rho <= radius:
                    state = 2
                elif model == _RECTANGLE:
                    low, high = rectangle_half_angles(rho, length, half_width, radius)
                    if high >= 0.0:
                        state = 3 if low > 0.0 else 1
                        low = low if low > 0.0 else -high
                elif model == _CAPSULE or rho <= corner + radius - half_width:
                    high = _disc_half_angle(rho, length, radius)
                    low = -high
                    state = 1 if high >= 0.0 else 0
            if state == 2:
                for w in range(words):
                    rows[r, w] = np.uint64(0)
                break
            if state != 0:
                _mark(rows, r, bearing + low, bearing + high, axis)
            if state == 3:
                _mark(rows, r, bearing - high, bearing - low, axis)


@kernel
def _advance_cells(rows: WordArray, poses: _Poses, k: int, links: _Links) -> _Poses:
    """Poses of the next link's joint.

    From the rows of link k and the poses of its joint.
    """
    length, axis = links.lengths[k], _bounding_axis(links, k)
    count = axis.size
    size = rows.shape[0] * count
    alive = np.empty(size, dtype=np.bool_)
    next_x, next_y, next_cos, next_sin = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    _, x, y, cos, sin = poses
    turn_cos, turn_sin = np.empty(count), np.empty(count)
    for b in range(count):
        angle = axis.sign * (axis.lower + b * axis.step) + axis.offset
        turn_cos[b], turn_sin[b] = math.cos(angle), math.sin(angle)
    for r in range(rows.shape[0]):
        for b in range(count):
            i = r * count + b
            alive[i] = (rows[r, b >> 6] >> np.uint64(b & 63)) & np.uint64(1) != np.uint64(0)
            c = cos[r] * turn_cos[b] - sin[r] * turn_sin[b]
            s = sin[r] * turn_cos[b] + cos[r] * turn_sin[b]
            next_cos[i], next_sin[i] = c, s
            next_x[i], next_y[i] = x[r] + length * c, y[r] + length * s
    return _Poses(alive, next_x, next_y, next_cos, next_sin)


@kernel
def _fill_rows(links: _Links, model: int, sections: SectionArrays) -> WordArray:
    """Free bits of all rows, link by link."""
    poses = _Poses(np.ones(1, dtype=np.bool_), np.zeros(1), np.zeros(1), np.ones(1), np.zeros(1))
    rows = np.empty((1, (links.counts[0] + 63) >> 6), dtype=np.uint64)
    for k in range(len(links.counts)):
        if is_up(links.until):
            break
        if k > 0:
            poses = _advance_cells(rows, poses, k - 1, links)
            rows = np.empty((len(poses.alive), (links.counts[k] + 63) >> 6), dtype=np.uint64)
        _fill_link(rows, poses, k, links, model, sections)
    return rows
