"""Kernels for clearances of moving bodies at a configuration and their gradients.

The moving bodies are the arm's bodies (`hplan.collision.compiled_bodies`) followed by its self-collision pairs; the
tilt of a tool that has to stay upright is one of these pairs. The
distance of a pair is expressed in the frame of one of its bodies, so a joint that carries both does not count as
motion. Bodies and obstacles are convex hulls of points grown by a radius; their distance is the distance of the hulls
(`hplan.geometry.convex_distance`) minus both radii. Checks run from cheap to exact: bounding balls first, then the
axis segments of the bodies, whose distance from points, segments and boxes has a closed form (exact for balls and
capsules, a lower bound for other shapes), then GJK until a direction separates the hulls by the required clearance.

**Clamping.** Distances are clamped to `enough`: a query stops once the clearance is known to be at least that.
(`hplan.collision.compiled_cover` finds the collision-free part of a motion with far less work.)

**Depth.** The penetration depth of two overlapping hulls is the minimum translation that separates them
(`hplan.geometry.penetration`), plus both radii.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, TableArray
from hplan.base.deadline import is_up
from hplan.base.kernels import any_int, inline, kernel
from hplan.collision import compiled_bodies as flat
from hplan.collision import compiled_obstacles as row
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.collision.compiled_placements import PLACED, place_bodies
from hplan.geometry.convex_distance import (
    NEAREST,
    NO_TABLE,
    ON_FIRST,
    WORK,
    Span,
    Wanted,
    core_distance,
    plane_of_separation,
)
from hplan.geometry.penetration import penetration
from hplan.geometry.planes import NO_PLANE, Plane, is_behind
from hplan.geometry.segment_distance import off_box, off_segment, point_segment
from hplan.geometry.sweep import STILL
from hplan.geometry.vectors import Pose, Vector, cross, dot, sub, turned_back, vector_of

_FIRST_ROW = any_int(0)

#: Relative tolerance: a clearance may be returned too small by this fraction of itself.
EXACT = 1e-10

#: Vector between nearest points (3), parameter of its end on the segment, and the separation along the vector [m]: a
#: lower bound of the distance, and up to rounding errors the largest of its kind.
Shown: TypeAlias = tuple[float, float, float, float, float]

#: The lower bound counts as the distance if its square is at least this multiple of the vector's squared length.
_SURELY = 1.0 - EXACT

#: Relative tolerance of distances from a leaf as a whole.
_ROUGH = 1e-2

#: Index of no row.
NO_ROW = any_int(-1)


class BodyArrays(NamedTuple):
    """An arm among obstacles, with the buffers of the kernels.

    Attributes:
        bodies: Moving bodies, as in `hplan.collision.compiled_bodies.FlatBodies`.
        pairs: Self-collision pairs, as in `hplan.collision.compiled_bodies.FlatBodies`.
        joints: Joints, as in `hplan.collision.compiled_bodies.FlatBodies`.
        points: Corners of the bodies, as in `hplan.collision.compiled_bodies.FlatBodies`.
        solids: Obstacle rows, as in `hplan.collision.compiled_field.ClearanceField`.
        data: Corners of hulls and points of clouds, as in `hplan.collision.compiled_field.ClearanceField`.
        placed: (bodies,) rows of `PLACED`, placements of the bodies.
        frames: (dof + 1, 12) frames of joints and base; (dof + 1, MOVING) with their twists for an arm in motion.
        work: (WORK + 6,) buffer. Its last six numbers are the direction from the nearest obstacle to the body, and the
            body's point nearest to that obstacle.
    """

    bodies: TableArray
    pairs: TableArray
    joints: TableArray
    points: FloatArray
    solids: TableArray
    data: FloatArray
    placed: TableArray
    frames: FloatArray
    work: FloatArray


@kernel
def _placed_arm(q: FloatArray, field: FieldArrays) -> BodyArrays:
    """Return the arrays of the arm placed at a configuration."""
    bodies, joints = field.bodies, field.joints
    placed, frames = np.empty(len(bodies), PLACED), np.empty((len(q) + 1, 12))
    place_bodies(q, bodies, joints, frames, placed)
    work = np.empty(WORK + 6)
    return BodyArrays(bodies, field.pairs, joints, field.points, field.solids, field.data, placed, frames, work)


@inline
def pose_of(frames: FloatArray, j: int) -> Pose:
    """Pose of joint j's frame."""
    return (
        frames[j, 0], frames[j, 1], frames[j, 2], frames[j, 3], frames[j, 4], frames[j, 5],
        frames[j, 6], frames[j, 7], frames[j, 8], frames[j, 9], frames[j, 10], frames[j, 11],
    )  # fmt: skip


@inline
def span_of(bodies: TableArray, b: int) -> Span:
    """Index range and corner table of a body's points."""
    body = bodies[b]
    return body.first, body.last, body.table


@inline
def difference(frames: FloatArray, j: int, i: int) -> Pose:
    """Pose of joint j's frame in joint i's frame."""
    a, b = frames[i], frames[j]
    x, y, z = b[9] - a[9], b[10] - a[10], b[11] - a[11]
    return (
        a[0] * b[0] + a[3] * b[3] + a[6] * b[6],
        a[0] * b[1] + a[3] * b[4] + a[6] * b[7],
        a[0] * b[2] + a[3] * b[5] + a[6] * b[8],
        a[1] * b[0] + a[4] * b[3] + a[7] * b[6],
        a[1] * b[1] + a[4] * b[4] + a[7] * b[7],
        a[1] * b[2] + a[4] * b[5] + a[7] * b[8],
        a[2] * b[0] + a[5] * b[3] + a[8] * b[6],
        a[2] * b[1] + a[5] * b[4] + a[8] * b[7],
        a[2] * b[2] + a[5] * b[5] + a[8] * b[8],
        a[0] * x + a[3] * y + a[6] * z,
        a[1] * x + a[4] * y + a[7] * z,
        a[2] * x + a[5] * y + a[8] * z,
    )


@inline
def segment_of(placed: TableArray, b: int) -> tuple[Vector, Vector]:
    """Start and vector of a body's axis segment."""
    start, along = placed[b].start, placed[b].along
    return (start[0], start[1], start[2]), (along[0], along[1], along[2])


@kernel
def is_box_beyond(solids: TableArray, s: int, off: Vector, reach: float) -> bool:
    """True if a box is farther from a point than `reach` [m]; False for other primitives.

    Long and flat boxes fill little of their bounding balls.

    Args:
        off: The point relative to the box's centre.
    """
    solid = solids[s]
    if solid.kind != row.BOX:
        return False
    axes, half = solid.axes, solid.half
    x = max(0.0, abs(axes[0] * off[0] + axes[1] * off[1] + axes[2] * off[2]) - half[0])
    y = max(0.0, abs(axes[3] * off[0] + axes[4] * off[1] + axes[5] * off[2]) - half[1])
    z = max(0.0, abs(axes[6] * off[0] + axes[7] * off[1] + axes[8] * off[2]) - half[2])
    square, reach = x * x + y * y + z * z, reach + solid.radius
    beyond: bool = square > max(0.0, reach) * reach
    return beyond


@kernel
def off_row(placed: TableArray, b: int, solids: TableArray, s: int) -> Shown:
    """Vector from a primitive (point, segment, box) to a body's axis segment.

    The last value is the separation of the two along that vector. It is a lower bound of the distance even if rounding
    errors move the end of the vector off the nearest point.
    """
    start, along = segment_of(placed, b)
    solid = solids[s]
    if solid.kind != row.BOX:
        first = vector_of(solid.start)
        second = first
        if solid.kind == row.SEGMENT:
            second = vector_of(solid.end)
        x, y, z, t = off_segment(start, along, first, sub(second, first))
        length = math.sqrt(x * x + y * y + z * z)
        if not length > 0.0:
            return 0.0, 0.0, 0.0, t, 0.0
        low, slope = x * start[0] + y * start[1] + z * start[2], x * along[0] + y * along[1] + z * along[2]
        high = max(x * first[0] + y * first[1] + z * first[2], x * second[0] + y * second[1] + z * second[2])
        return x, y, z, t, (low + min(0.0, slope) - high) / length
    half, axes = vector_of(solid.half), solid.axes
    off = sub(start, vector_of(solid.centre))
    right, ahead, up = (axes[0], axes[1], axes[2]), (axes[3], axes[4], axes[5]), (axes[6], axes[7], axes[8])
    seen, way = (dot(off, right), dot(off, ahead), dot(off, up)), (dot(along, right), dot(along, ahead), dot(along, up))
    x, y, z, t = off_box(seen, way, half)
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0, t, 0.0
    low, slope = x * seen[0] + y * seen[1] + z * seen[2], x * way[0] + y * way[1] + z * way[2]
    high = abs(x) * half[0] + abs(y) * half[1] + abs(z) * half[2]
    return (
        x * right[0] + y * ahead[0] + z * up[0],
        x * right[1] + y * ahead[1] + z * up[1],
        x * right[2] + y * ahead[2] + z * up[2],
        t,
        (low + min(0.0, slope) - high) / length,
    )


@kernel
def off_body(placed: TableArray, j: int, i: int) -> Shown:
    """Vector from body i's axis segment to body j's.

    Values and guarantee as for `off_row`.
    """
    start, along = segment_of(placed, j)
    other, beside = segment_of(placed, i)
    x, y, z, t = off_segment(start, along, other, beside)
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0, t, 0.0
    r = sub(start, other)
    low = x * r[0] + y * r[1] + z * r[2]
    slope, rise = x * along[0] + y * along[1] + z * along[2], x * beside[0] + y * beside[1] + z * beside[2]
    return x, y, z, t, (low + min(0.0, slope) - max(0.0, rise)) / length


@inline
def is_thin(bodies: TableArray, b: int) -> bool:
    """True if a body is its axis segment grown by a radius."""
    thin: bool = bodies[b].last - bodies[b].first <= flat.CAPSULE_COORDINATES
    return thin


@kernel
def _body_clearance(arm: BodyArrays, b: int, enough: float) -> float:
    """Clearance of a body from the obstacles, clamped to `enough` [m]."""
    bodies, solids, placed, work = arm.bodies, arm.solids, arm.placed, arm.work
    body = bodies[b]
    centre, ball, thickness, joint, least = placed[b].centre, body.ball_radius, body.axis_radius, body.joint, enough
    x, y, z = centre[0], centre[1], centre[2]
    thin = is_thin(bodies, b)
    following, within_tree, visited, plane = _FIRST_ROW, _FIRST_ROW, NO_ROW, NO_PLANE
    while following < len(solids):
        s = following
        solid = solids[s]
        dx, dy, dz = solid.centre[0] - x, solid.centre[1] - y, solid.centre[2] - z
        within = least + ball + solid.bound
        kind = solid.kind
        if not within > 0.0 or dx * dx + dy * dy + dz * dz > within * within:
            following = solid.next if kind >= row.NODE else s + 1
            continue
        following = s + 1
        if is_box_beyond(solids, s, (-dx, -dy, -dz), least + ball):
            continue
        if kind == row.JOINT_RANGE:
            if not solid.first <= joint <= solid.last:
                following = solid.next
        elif kind == row.NODE or kind == row.LEAF:
            start, along = segment_of(placed, b)
            middle = vector_of(solid.centre)
            if (
                is_behind(plane, middle, least + solid.bound)
                or point_segment(middle, start, along) > least + thickness + solid.bound
            ):
                following = solid.next
                continue
            if (kind == row.NODE and s < within_tree) or s == visited:
                continue
            leaf = s
            if kind == row.NODE:
                # The nearest leaf first: most of the tree is farther.
                within_tree, visited = solid.next, nearest_leaf(placed, b, solids, s)
                leaf = visited
            if leaf != NO_ROW:
                least = _leaf_clearance(arm, b, leaf, least)
                if not thin:
                    plane = plane_behind(arm, b)
        else:
            away = (-dx, -dy, -dz)
            if kind != row.HULL:
                # Vector from the solid's core to the body's axis segment.
                ox, oy, oz, t, shown = off_row(placed, b, solids, s)
                if shown > 0.0:
                    clear = shown - solid.radius - thickness
                    if clear >= least:
                        continue
                    if thin and shown * shown >= _SURELY * (ox * ox + oy * oy + oz * oz):
                        least = clear
                        work[WORK], work[WORK + 1], work[WORK + 2] = ox, oy, oz
                        for c in range(3):
                            work[WORK + 3 + c] = placed[b].start[c] + t * placed[b].along[c]
                        continue
                    away = (ox, oy, oz)
            least = _row_clearance(arm, (b, s), away, least)
    return least


@kernel
def _hull_clearance(arm: BodyArrays, k: int, other: tuple[FloatArray, Span, float], least: float) -> float:
    """Clearance of a body from a rounded hull, clamped to `least` [m]."""
    corners, other_span, radius = other
    bodies, points, work = arm.bodies, arm.points, arm.work
    radii = radius + bodies[k].rounding
    span, pose = span_of(bodies, k), pose_of(arm.frames, bodies[k].joint)
    wanted = Wanted(least + radii, -math.inf, EXACT, radii, STILL)
    distance = core_distance(points, span, pose, corners, other_span, wanted, work)
    sign = 1.0
    if distance == 0.0 and least + radii > 0.0:
        distance, sign = -penetration((points, span, pose, corners, other_span), work), -1.0
    if least <= distance - radii:
        return least
    beyond: float = distance - radii
    for c in range(3):
        work[WORK + c], work[WORK + 3 + c] = sign * work[NEAREST + c], work[ON_FIRST + c]
    return beyond


@kernel
def _row_clearance(arm: BodyArrays, place: tuple[int, int], away: Vector, least: float) -> float:
    """Clearance of a body from a primitive, clamped to `least` [m].

    Args:
        place: Indices of the body and of the primitive.
        away: A direction from the primitive to the body.
        least: The result is clamped to this clearance [m].
    """
    (k, s), solids, data, work = place, arm.solids, arm.data, arm.work
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = away
    first = solids[s].corners
    span = first, int(data[first - 2]), int(data[first - 1])
    return _hull_clearance(arm, k, (data, span, solids[s].radius), least)


@kernel
def plane_behind(arm: BodyArrays, b: int) -> Plane:
    """Plane that touches a body from behind; its normal is the last query's direction of the largest separation."""
    pose = pose_of(arm.frames, arm.bodies[b].joint)
    normal, height = plane_of_separation(arm.points, span_of(arm.bodies, b), pose, arm.work)
    return normal, height - arm.bodies[b].rounding


@kernel
def nearest_leaf(placed: TableArray, b: int, solids: TableArray, node: int) -> int:
    """Leaf of a cloud's tree that is about the nearest to a body's axis.

    `NO_ROW` for a group of other obstacles, and below a node whose rows have been left out.
    """
    first, last = node, solids[node].next
    while first < last and solids[first].kind == row.NODE:
        first += 1
    if first == last or solids[first].kind != row.LEAF:
        return NO_ROW
    found, (start, along) = node, segment_of(placed, b)
    while solids[found].kind == row.NODE:
        child, end, nearest, least = found + 1, solids[found].next, NO_ROW, math.inf
        while child < end:
            solid = solids[child]
            apart = point_segment(vector_of(solid.centre), start, along) - solid.bound
            if apart < least:
                least, nearest = apart, child
            child = solid.next
        if nearest == NO_ROW:
            return NO_ROW
        found = nearest
    return found


@kernel
def _leaf_clearance(arm: BodyArrays, k: int, s: int, least: float) -> float:
    """Clearance of a body from a leaf's balls, clamped to `least` [m]."""
    solid, data, placed, work = arm.solids[s], arm.data, arm.placed, arm.work
    radius, thickness, plane = solid.radius, arm.bodies[k].axis_radius, NO_PLANE
    start, along = segment_of(placed, k)
    if not is_thin(arm.bodies, k):
        radii, pose = radius + arm.bodies[k].rounding, pose_of(arm.frames, arm.bodies[k].joint)
        wanted = Wanted(least + radii, least + radii, _ROUGH, radii, STILL)
        for c in range(3):
            work[NEAREST + c] = placed[k].centre[c] - solid.centre[c]
        lot = solid.first, solid.last, NO_TABLE
        if core_distance(arm.points, span_of(arm.bodies, k), pose, data, lot, wanted, work) - radii >= least:
            return least
        plane = plane_behind(arm, k)
    for p in range(solid.first, solid.last, 3):
        point = data[p], data[p + 1], data[p + 2]
        if is_behind(plane, point, least + radius):
            continue
        if point_segment(point, start, along) < least + thickness + radius:
            for c in range(3):
                work[NEAREST + c] = placed[k].centre[c] - data[p + c]
            least = _hull_clearance(arm, k, (data, (p, p + 3, NO_TABLE), radius), least)
    return least


@kernel
def _near_below(
    bodies: TableArray, pairs: TableArray, placed: TableArray, solids: TableArray, k: int, enough: float
) -> int:
    """Next lower moving body that fails the bounding-ball check; else -1.

    Pairs come first, then bodies from the tip to the base. (The check is inlined here because a call with all arrays
    costs more than the work that most bodies need.)
    """
    while k > 0:
        k -= 1
        if k >= len(bodies):
            pair = pairs[k - len(bodies)]
            one, other = placed[pair.outer].centre, placed[pair.inner].centre
            dx, dy, dz = one[0] - other[0], one[1] - other[1], one[2] - other[2]
            within = enough + pair.ball_distance
            if within > 0.0 and dx * dx + dy * dy + dz * dz < within * within:
                return k
        elif bodies[k].is_checked:
            centre, around = placed[k].centre, enough + bodies[k].ball_radius
            x, y, z = centre[0], centre[1], centre[2]
            s = _FIRST_ROW
            while s < len(solids):
                solid = solids[s]
                dx, dy, dz = solid.centre[0] - x, solid.centre[1] - y, solid.centre[2] - z
                within = around + solid.bound
                if within > 0.0 and dx * dx + dy * dy + dz * dz <= within * within:
                    return k
                s = solid.next if solid.kind >= row.NODE else s + 1
    return -1


@inline
def tilting_axis(arm: BodyArrays, k: int) -> Vector:
    """Direction of the tool axis of a tilt, in `base_link`."""
    pair, frames = arm.pairs[k - len(arm.bodies)], arm.frames
    axis, j = vector_of(pair.axis), pair.carrier
    return (
        frames[j, 0] * axis[0] + frames[j, 1] * axis[1] + frames[j, 2] * axis[2],
        frames[j, 3] * axis[0] + frames[j, 4] * axis[1] + frames[j, 5] * axis[2],
        frames[j, 6] * axis[0] + frames[j, 7] * axis[1] + frames[j, 8] * axis[2],
    )


@kernel
def tilt_clearance(arm: BodyArrays, k: int) -> float:
    """Angle left to the maximum tilt, as a distance [m].

    The axis of the rotation that brings the tool upright is written to the buffer, from `WORK` on.
    """
    pair, work = arm.pairs[k - len(arm.bodies)], arm.work
    axis, up = tilting_axis(arm, k), vector_of(pair.up)
    n = cross(axis, up)
    work[WORK], work[WORK + 1], work[WORK + 2] = n
    tilt = math.atan2(math.sqrt(dot(n, n)), dot(axis, up))
    left: float = pair.tilt_m * (pair.most_tilt - tilt) - pair.hull_distance
    return left


@kernel
def _pair_clearance(arm: BodyArrays, k: int, enough: float) -> float:
    """Clearance of a self-collision pair, clamped to `enough` [m]."""
    bodies, points, placed, work = arm.bodies, arm.points, arm.placed, arm.work
    pair = arm.pairs[k - len(bodies)]
    if pair.tilt_m > 0.0:
        return min(enough, tilt_clearance(arm, k))
    j, i, touching = pair.outer, pair.inner, pair.hull_distance
    dx, dy, dz, t, shown = off_body(placed, j, i)
    if shown > 0.0:
        if shown - pair.axis_distance >= enough:
            return enough
        if is_thin(bodies, i) and is_thin(bodies, j) and shown * shown >= _SURELY * (dx * dx + dy * dy + dz * dz):
            work[WORK], work[WORK + 1], work[WORK + 2] = dx, dy, dz
            for c in range(3):
                work[WORK + 3 + c] = placed[j].start[c] + t * placed[j].along[c]
            left: float = shown - touching
            return left
    else:
        dx, dy, dz = sub(vector_of(placed[j].centre), vector_of(placed[i].centre))
    frames, inner = arm.frames, bodies[i].joint
    work[NEAREST], work[NEAREST + 1], work[NEAREST + 2] = turned_back(pose_of(frames, inner), (dx, dy, dz))
    pose = difference(frames, bodies[j].joint, inner)
    span, other = span_of(bodies, j), span_of(bodies, i)
    wanted = Wanted(enough + touching, -math.inf, EXACT, touching, STILL)
    distance = core_distance(points, span, pose, points, other, wanted, work)
    sign = 1.0
    if distance == 0.0:
        distance, sign = -penetration((points, span, pose, points, other), work), -1.0
    if enough <= distance - touching:
        return enough
    # Expressed in the world frame.
    for c in range(3):
        work[WORK + c], work[WORK + 3 + c] = 0.0, frames[inner, 9 + c]
        for d in range(3):
            work[WORK + c] += sign * frames[inner, 3 * c + d] * work[NEAREST + d]
            work[WORK + 3 + c] += frames[inner, 3 * c + d] * work[ON_FIRST + d]
    beyond: float = distance - touching
    return beyond


@kernel
def _mover_clearance(arm: BodyArrays, k: int, enough: float) -> float:
    """Clearance of a moving body, clamped to `enough` [m]."""
    if k >= len(arm.bodies):
        return _pair_clearance(arm, k, enough)
    return _body_clearance(arm, k, enough)


@kernel
def body_clearances(q: FloatArray, field: FieldArrays, enough: float, result: FloatArray) -> None:
    """Write the clearance of each moving body, clamped to `enough` [m].

    Bodies that no obstacle concerns get `enough`.
    """
    arm = _placed_arm(q, field)
    bodies, pairs, placed, solids = arm.bodies, arm.pairs, arm.placed, arm.solids
    for k in range(len(result)):
        result[k] = enough
    k = _near_below(bodies, pairs, placed, solids, len(result), enough)
    while k >= 0:
        result[k] = _mover_clearance(arm, k, enough)
        k = _near_below(bodies, pairs, placed, solids, k, enough)


@kernel
def clearances_along(points: FloatArray, field: FieldArrays, enough: float, result: FloatArray) -> None:
    """Write the clearances at (n, dof) configurations into an (n, bodies) array.

    Each is clamped to `enough` [m], as by `body_clearances`. Rows after the deadline are not written.
    """
    for i in range(points.shape[0]):
        if is_up(field.until):
            break
        body_clearances(points[i], field, enough, result[i])


@kernel
def body_slopes(
    q: FloatArray, field: FieldArrays, joints: IntArray, enough: float, clear: FloatArray, gradient: FloatArray
) -> None:
    """Write the (bodies,) clearances and their (bodies, k) gradients by k joints.

    Clearances are clamped to `enough` [m]. A gradient is the velocity of the nearest points along the line between
    them; zeros if the clearance is clamped.
    """
    guessed_slopes(q, field, joints, enough, np.full(len(clear), enough), clear, gradient)


@kernel
def guessed_slopes(
    q: FloatArray,
    field: FieldArrays,
    joints: IntArray,
    enough: float,
    guesses: FloatArray,
    clear: FloatArray,
    gradient: FloatArray,
) -> None:
    """Write what `body_slopes` writes, in less time if the clearances are guessed well.

    A search visits the obstacles that may be nearer than the nearest found so far, at first than the guess.

    Args:
        guesses: (bodies,) clearances, preferably slightly too large ones [m].
    """
    arm = _placed_arm(q, field)
    bodies, pairs, placed, solids, work = arm.bodies, arm.pairs, arm.placed, arm.solids, arm.work
    rates = np.empty(len(q))
    for k in range(len(clear)):
        clear[k] = enough
        for m in range(len(joints)):
            gradient[k, m] = 0.0
    k = len(clear)
    while True:
        k = _near_below(bodies, pairs, placed, solids, k, enough)
        if k < 0:
            break
        guess = min(guesses[k], enough)
        clear[k] = _mover_clearance(arm, k, guess)
        if not clear[k] < guess and guess < enough:
            clear[k] = _mover_clearance(arm, k, enough)
        if not clear[k] < enough:
            continue
        outer, inner = k, -1
        if k >= len(bodies):
            outer, inner = pairs[k - len(bodies)].outer, pairs[k - len(bodies)].inner
        n = (work[WORK], work[WORK + 1], work[WORK + 2])
        length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if not length > 0.0:
            continue
        n = (n[0] / length, n[1] / length, n[2] / length)
        at = (work[WORK + 3], work[WORK + 4], work[WORK + 5])
        if inner >= 0 and pairs[k - len(bodies)].tilt_m > 0.0:
            for m in range(len(joints)):
                gradient[k, m] = _righting_rate(arm, k, joints[m], n)
            continue
        _write_rates(arm, (outer, inner), n, at, rates)
        for m in range(len(joints)):
            gradient[k, m] = rates[joints[m]]


@kernel
def _righting_rate(arm: BodyArrays, k: int, joint: int, n: Vector) -> float:
    """Derivative of a tilt's distance by a joint, n the unit axis of the rotation upright [m/rad]."""
    pair, own, frames = arm.pairs[k - len(arm.bodies)], arm.joints[joint], arm.frames
    if own.slides or not _is_beyond(arm, pair.carrier, joint):
        return 0.0
    tx, ty, tz = vector_of(own.axis)
    x = frames[joint, 0] * tx + frames[joint, 1] * ty + frames[joint, 2] * tz
    y = frames[joint, 3] * tx + frames[joint, 4] * ty + frames[joint, 5] * tz
    z = frames[joint, 6] * tx + frames[joint, 7] * ty + frames[joint, 8] * tz
    rate: float = pair.tilt_m * (n[0] * x + n[1] * y + n[2] * z)
    return rate


@kernel
def _is_beyond(arm: BodyArrays, j: int, joint: int) -> bool:
    """True if a joint is j, or carries it."""
    joints = arm.joints
    while j < len(joints) and j != joint:
        j = joints[j].parent
    carries: bool = j == joint and j < len(joints)
    return carries


@kernel
def _write_rates(arm: BodyArrays, pair: tuple[int, int], n: Vector, at: Vector, rates: FloatArray) -> None:
    """Write for each joint the velocity of a point along n at unit rate [m/rad, m/m].

    Joints that carry both bodies do not count, wherever the inner body's nearest point lies along the line.

    Args:
        pair: Indices of the body with the point, and of the one relative to which it moves; -1 for an obstacle.
    """
    bodies, joints, (outer, inner) = arm.bodies, arm.joints, pair
    base = len(joints)
    rates[:] = 0.0
    i, j = bodies[outer].joint, base
    if inner >= 0:
        j = bodies[inner].joint
    # Parents have lower numbers than the joints that they carry, so both chains meet at the last joint of both.
    while i != j:
        if j == base or (i != base and i > j):
            rates[i] = _rate(arm, i, n, at)
            i = joints[i].parent
        else:
            rates[j] = -_rate(arm, j, n, at)
            j = joints[j].parent


@kernel
def _rate(arm: BodyArrays, joint: int, n: Vector, at: Vector) -> float:
    """Velocity along n of a point that a joint moves at unit rate [m/rad, m/m]."""
    own, frames = arm.joints[joint], arm.frames
    if own.slides:
        below, shift, rate = own.parent, own.shift, 0.0
        for r in range(3):
            for c in range(3):
                rate += n[r] * frames[below, 3 * r + c] * shift[c]
        return rate
    tx, ty, tz = vector_of(own.axis)
    x = frames[joint, 0] * tx + frames[joint, 1] * ty + frames[joint, 2] * tz
    y = frames[joint, 3] * tx + frames[joint, 4] * ty + frames[joint, 5] * tz
    z = frames[joint, 6] * tx + frames[joint, 7] * ty + frames[joint, 8] * tz
    dx, dy, dz = at[0] - frames[joint, 9], at[1] - frames[joint, 10], at[2] - frames[joint, 11]
    moved: float = n[0] * (y * dz - z * dy) + n[1] * (z * dx - x * dz) + n[2] * (x * dy - y * dx)
    return moved


@kernel
def least_body_clearance(q: FloatArray, field: FieldArrays, enough: float) -> float:
    """Minimum clearance of all moving bodies, clamped to `enough` [m]."""
    arm = _placed_arm(q, field)
    bodies, pairs, placed, solids, least = arm.bodies, arm.pairs, arm.placed, arm.solids, enough
    k = _near_below(bodies, pairs, placed, solids, len(bodies) + len(pairs), least)
    while k >= 0:
        least = _mover_clearance(arm, k, least)
        k = _near_below(bodies, pairs, placed, solids, k, least)
    return least
