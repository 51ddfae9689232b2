r"""Limbs: the wood of a tree as a graph of segments, and their compliance from beam theory.

A limb segment is a capsule that grows from another one, its `parent`. Segments thinner than the clamp radius bend;
thicker ones do not, and a limb is clamped where its path towards the root meets the first of these, or at its own
start if there is none.

**Compliance.** A force :math:`f` at a point :math:`x` bends each element :math:`ds` at :math:`p` on the path from the
clamp to :math:`x` by the moment :math:`(x - p) \times f`. A bending stiffness of :math:`EI = E \pi r^4 / 4` gives the
displacement :math:`C f` at :math:`x` with

.. math:: C(x) = \int \frac{|d|^2 \mathbf{1} - d d^\top}{E I} ds, \qquad d = x - p

(unit-load method; Timoshenko and Gere, Mechanics of Materials). It is that of sections as stiff in torsion as in
bending. Wood is softer in torsion: with a torsional stiffness of :math:`\tau E I`, each segment with the axis
:math:`a` that starts at :math:`s` adds :math:`(1 / \tau - 1) L / (E I) w w^\top` with :math:`w = a \times (x - s)`.
Extension and shear are neglected, so forces are not underestimated. Along a segment, :math:`C` is a convex function of
:math:`x` in the sense of matrices, and its tangent a lower bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from hplan.base import ties
from hplan.base.arrays import BoolArray, FloatArray, IntArray, Record, frozen
from hplan.errors import SceneError
from hplan.scene.obstacles import Capsule

#: Radius from which wood does not bend [m].
CLAMP_RADIUS_M: Final = 0.008

#: Assumed ratio of torsional to bending stiffness, GJ / EI: 0.77 for isotropic round sections, about 0.14 for trunks
#: (Vogel 2007, "To twist or bend when stressed").
TWIST_RATIO: Final = 0.25

#: Maximum gap between the end of a limb and the surface of its parent [m].
JOINT_GAP_M: Final = 0.003


@dataclass(frozen=True, eq=False)
class Limbs(Record):
    """The limb segments of a scene, each with its parent.

    Attributes:
        names: Names of the capsules.
        start: (n, 3) end of the axis nearer to the root [m].
        end: (n, 3) other end [m].
        radius: (n,) radius [m].
        parent: (n,) number of the parent; -1 for a root.
        joint: (n, 3) point of the parent's axis that the segment grows from; its own start for a root [m].
        clamped: (n,) True for segments that do not bend.
        order: (n,) numbers of the segments, parents before children.

    Examples:
        >>> from hplan.scene import Capsule
        >>> from hplan.scene.limbs import Limbs
        >>> trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
        >>> twig = Capsule(name="twig", start=(0.0, 0.0, 1.0), end=(0.4, 0.0, 1.0), radius=0.004, parent="trunk")
        >>> limbs = Limbs.of([trunk, twig])
        >>> limbs.parent.tolist(), limbs.clamped.tolist()
        ([-1, 0], [True, False])
        >>> round(float(1.0 / limbs.compliance(1, 1.0, 5e9)[2, 2]), 1)  # newton per metre at the tip
        47.1
    """

    names: tuple[str, ...]
    start: FloatArray
    end: FloatArray
    radius: FloatArray
    parent: IntArray
    joint: FloatArray
    clamped: BoolArray
    order: IntArray

    @classmethod
    def of(cls, capsules: Sequence[Capsule], clamp_radius: float = CLAMP_RADIUS_M) -> Limbs:
        """Return the limbs among some capsules: those with a parent, and the parents.

        Args:
            capsules: Capsules of a scene; parents that are not among them count as none.
            clamp_radius: Radius from which wood does not bend [m].

        Raises:
            SceneError: A capsule is among its own ancestors.
        """
        known = {piece.name for piece in capsules}
        parents = {piece.name: piece.parent for piece in capsules if piece.parent in known}
        bearing = {*parents, *parents.values()}
        pieces = [piece for piece in capsules if piece.name in bearing]
        number = {piece.name: row for row, piece in enumerate(pieces)}
        names = tuple(number)
        parent = np.array([number.get(parents.get(name) or "", -1) for name in names], dtype=np.int64)
        order = _parents_first(parent, names)
        start = np.array([piece.start for piece in pieces], dtype=np.float64).reshape(-1, 3)
        end = np.array([piece.end for piece in pieces], dtype=np.float64).reshape(-1, 3)
        radius = np.array([piece.radius for piece in pieces], dtype=np.float64)
        joint = start.copy()
        for row in order.tolist():
            on = int(parent[row])
            if on >= 0:
                ends = np.stack([start[row], end[row]])
                nearest = _nearest_on_axis(ends, start[on], end[on])
                if np.linalg.norm(ends[1] - nearest[1]) < np.linalg.norm(ends[0] - nearest[0]):
                    start[row], end[row], nearest = end[row].copy(), start[row].copy(), nearest[::-1]
                joint[row] = nearest[0]
        return cls(
            names, frozen(start), frozen(end), frozen(radius), frozen(parent), frozen(joint),
            frozen(radius >= clamp_radius), frozen(order),
        )  # fmt: skip

    @cached_property
    def length(self) -> FloatArray:
        """(n,) length of each axis [m]."""
        found: FloatArray = np.linalg.norm(self.end - self.start, axis=1)
        return found

    @cached_property
    def axis(self) -> FloatArray:
        """(n, 3) direction of each axis away from the root."""
        found: FloatArray = (self.end - self.start) / self.length[:, None]
        return found

    def path(self, number: int) -> tuple[int, ...]:
        """Bending segments from a segment down to its clamp, itself first."""
        found: list[int] = []
        while number >= 0 and not self.clamped[number]:
            found.append(number)
            number = int(self.parent[number])
        return tuple(found)

    def roots(self) -> IntArray:
        """(n,) the bending segment next to the clamp on each segment's path; -1 for segments that do not bend."""
        found = np.full(len(self.names), -1, dtype=np.int64)
        for row in self.order.tolist():
            if not self.clamped[row]:
                on = int(self.parent[row])
                found[row] = row if on < 0 or self.clamped[on] else found[on]
        return found

    def compliance(self, number: int, fraction: float, youngs_modulus: float) -> FloatArray:
        """Compliance at a point of an axis: (6, 6), force and moment to displacement and rotation.

        Args:
            number: Number of a segment.
            fraction: Position on its axis, 0 at its start, 1 at its end.
            youngs_modulus: Young's modulus [Pa].

        Returns:
            The matrix, in [m/N], [1/N] and [rad/(N m)]; zeros for a segment that does not bend.
        """
        at = np.array([number]), np.array([fraction * self.length[number]])
        moments = self.moments_at(*at)
        m0, m1 = moments[0][0], moments[1][0]
        point = self.start[number] + at[1][0] * self.axis[number]
        found = np.zeros((6, 6))
        found[:3, :3] = self.compliance_along(*at)[0][0]
        found[3:, 3:] = m0 * np.eye(3)
        lever = skew(m0 * point - m1)  # the sum of d ds
        found[:3, 3:], found[3:, :3] = -lever, lever
        for axis, arm, weight in self._twists(number, point):
            found[3:, 3:] += weight * np.outer(axis, axis)
            found[:3, 3:] += weight * np.outer(arm, axis)
            found[3:, :3] += weight * np.outer(axis, arm)
        return found / youngs_modulus

    def _twists(self, number: int, point: FloatArray) -> Iterator[tuple[FloatArray, FloatArray, float]]:
        """Axis, arm to a point, and additional twist per moment, of each segment on a path, for 1 Pa."""
        tip = point
        for row in self.path(number):
            axis = self.axis[row]
            length = max(0.0, float((tip - self.start[row]) @ axis))
            weight = (1.0 / TWIST_RATIO - 1.0) * length / (0.25 * math.pi * float(self.radius[row]) ** 4)
            yield axis, np.cross(axis, point - self.start[row]), weight
            tip = self.joint[row]

    def compliance_along(self, numbers: IntArray, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compliance at points of the axes for a Young's modulus of 1 Pa.

        Args:
            numbers: (k,) segments.
            along: (k,) distances of the points from the segments' starts [m].

        Returns:
            (k, 3, 3) compliance [m/N], (k, 3, 3) its derivative along the axis, and (k,) rotation per moment.
        """
        moments, axis = self.moments_at(numbers, along), self.axis[numbers]
        points = self.start[numbers] + along[:, None] * axis
        lever = moments[0][:, None] * points - moments[1]  # the sum of d ds
        slope = 2.0 * np.einsum("kj,kj->k", lever, axis)[:, None, None] * np.eye(3)
        slope = slope - axis[:, :, None] * lever[:, None] - lever[:, :, None] * axis[:, None]
        compliance, at, tip = _displacement(moments, points), numbers.copy(), points.copy()
        while True:
            rows = np.flatnonzero((at >= 0) & ~self.clamped[at])
            if not len(rows):
                return compliance, slope, moments[0]
            on = at[rows]
            turned = self.axis[on]
            length = np.einsum("kj,kj->k", tip[rows] - self.start[on], turned)
            weight = (1.0 / TWIST_RATIO - 1.0) * np.clip(length, 0.0, None) / (0.25 * math.pi * self.radius[on] ** 4)
            arm, grows = np.cross(turned, points[rows] - self.start[on]), np.cross(turned, axis[rows])
            compliance[rows] += weight[:, None, None] * arm[:, :, None] * arm[:, None]
            slope[rows] += weight[:, None, None] * (grows[:, :, None] * arm[:, None] + arm[:, :, None] * grows[:, None])
            tip[rows], at[rows] = self.joint[on], self.parent[on]

    def stress_per_force(self, numbers: IntArray, points: FloatArray) -> FloatArray:
        """(k,) maximum bending stress on the paths to the clamps by forces at (k, 3) points of the axes [Pa/N]."""
        found, at = np.zeros(len(numbers)), numbers.copy()
        tip = points
        while True:
            rows = np.flatnonzero((at >= 0) & ~self.clamped[at])
            if not len(rows):
                return found
            on = at[rows]
            for end in (self.start[on], tip[rows]):  # the lever is a convex function on a segment
                lever = np.linalg.norm(points[rows] - end, axis=1)
                found[rows] = np.maximum(found[rows], 4.0 * lever / (math.pi * self.radius[on] ** 3))
            tip = tip.copy()
            tip[rows] = self.joint[on]
            at[rows] = self.parent[on]

    def related(self) -> BoolArray:
        """(n, n) True for segments of which one is on the other's path to its clamp, the clamp included."""
        found = np.eye(len(self.names), dtype=np.bool_)
        for row in self.order.tolist():
            on = int(self.parent[row])
            if on >= 0 and not self.clamped[row]:
                found[row] |= found[on] if not self.clamped[on] else np.arange(len(self.names)) == on
        return found | found.T

    def nearest(self, point: FloatArray, names: Sequence[str] = ()) -> tuple[int, float, float] | None:
        """Segment with the nearest surface, the nearest point's distance from its start, and from its axis [m].

        Args:
            point: (3,) a point [m].
            names: Names of the segments to choose from; empty for all.
        """
        kept = [row for row, name in enumerate(self.names) if not names or name in names]
        if not kept:
            return None
        nearest = _nearest_on_axes(point[None], self.start[kept], self.end[kept])[0]
        distance = np.linalg.norm(nearest - point, axis=1)
        best = ties.argmin(distance - self.radius[kept])
        return kept[best], float(np.linalg.norm(nearest[best] - self.start[kept[best]])), float(distance[best])

    def flexural_rigidity(self, youngs_modulus: float | FloatArray) -> FloatArray:
        """(n,) bending stiffness EI of each segment [N m^2], for one modulus or (n,) of them [Pa]."""
        found: FloatArray = youngs_modulus * 0.25 * math.pi * self.radius**4
        return found

    def moments_at(self, numbers: IntArray, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Integrals of 1, p and p p^T over ds / I between the clamp and points of the axes.

        Args:
            numbers: (k,) segments.
            along: (k,) distance of the points from the segments' starts [m].

        Returns:
            (k,), (k, 3), (k, 3, 3); for a Young's modulus of 1 Pa.
        """
        m0, m1, m2 = self._moments
        own = _element(self, numbers, along)
        return m0[numbers] + own[0], m1[numbers] + own[1], m2[numbers] + own[2]

    @cached_property
    def _moments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The integrals of `moments_at` at the start of each segment."""
        found = np.zeros(len(self.names)), np.zeros((len(self.names), 3)), np.zeros((len(self.names), 3, 3))
        for row in self.order.tolist():
            on = int(self.parent[row])
            if on >= 0 and not self.clamped[on] and not self.clamped[row]:
                at = np.array([np.clip(np.dot(self.joint[row] - self.start[on], self.axis[on]), 0.0, None)])
                for whole, part in zip(found, _element(self, np.array([on]), at), strict=True):
                    whole[row] = whole[on] + part[0]
        return found


def find_parents(capsules: Sequence[Capsule]) -> dict[str, str]:
    """Find the parent of each limb segment by proximity and thickness.

    A segment grows from another one if one of its ends is within both radii and `JOINT_GAP_M` of the other's axis, and
    that one was reached before. Segments are reached from the thickest on, nearest ends first; two segments that only
    share their roots' starts are not parent and child.

    Args:
        capsules: The capsules of trees; wires and posts among them get a parent if they touch one: leave them out.

    Returns:
        Name of the parent by the name of the segment; roots are not listed.

    Examples:
        >>> from hplan.scene import Capsule
        >>> from hplan.scene.limbs import find_parents
        >>> trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 2.0), radius=0.03)
        >>> twig = Capsule(name="twig", start=(0.02, 0.0, 1.0), end=(0.4, 0.0, 1.2), radius=0.004)
        >>> find_parents([twig, trunk])
        {'twig': 'trunk'}
    """
    count = len(capsules)
    if not count:
        return {}
    start = np.array([piece.start for piece in capsules], dtype=np.float64)
    end = np.array([piece.end for piece in capsules], dtype=np.float64)
    radius = np.array([piece.radius for piece in capsules], dtype=np.float64)
    gaps = np.full((count, count), np.inf)  # of the nearer end of a row's segment from a column's surface
    for row in range(count):
        ends = np.stack([start[row], end[row]])
        nearest = _nearest_on_axes(ends, start, end)
        apart = np.linalg.norm(nearest - ends[:, None], axis=2)
        # An end that meets the other's start leaves no length to grow from, unless the other one has its root there.
        at_start = np.linalg.norm(nearest - start, axis=2) < 1e-9
        apart[0, at_start[0]] = np.inf
        gaps[row] = apart.min(axis=0) - radius[row] - radius
        gaps[row, row] = np.inf
    left, found = np.ones(count, dtype=np.bool_), dict[str, str]()
    best, from_which = np.full(count, np.inf), np.full(count, -1, dtype=np.int64)
    while left.any():
        near = np.where(left & (best <= JOINT_GAP_M), radius, -1.0)
        row = int(np.argmax(near)) if near.max() > 0.0 else int(np.argmax(np.where(left, radius, -1.0)))
        if near.max() > 0.0:
            found[capsules[row].name] = capsules[int(from_which[row])].name
        left[row] = False
        nearer = left & (gaps[:, row] < best)
        best[nearer], from_which[nearer] = gaps[nearer, row], row
    return found


def skew(vector: FloatArray) -> FloatArray:
    """(3, 3) matrix of the cross product with a vector."""
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _displacement(moments: tuple[FloatArray, FloatArray, FloatArray], points: FloatArray) -> FloatArray:
    """(k, 3, 3) displacement by a unit force at (k, 3) points, for a Young's modulus of 1 Pa."""
    m0, m1, m2 = moments
    squares = (
        m0[:, None, None] * points[:, :, None] * points[:, None]
        - points[:, :, None] * m1[:, None]
        - m1[:, :, None] * points[:, None]
        + m2
    )
    found: FloatArray = np.trace(squares, axis1=1, axis2=2)[:, None, None] * np.eye(3) - squares
    return found


def _element(limbs: Limbs, numbers: IntArray, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Integrals of 1, p and p p^T over ds / I from the starts of segments to points on their axes."""
    inertia = 0.25 * math.pi * limbs.radius[numbers] ** 4
    weight = np.where(limbs.clamped[numbers], 0.0, along / inertia)
    axis = limbs.axis[numbers]
    middle = limbs.start[numbers] + 0.5 * along[:, None] * axis
    second = middle[:, :, None] * middle[:, None] + (along**2 / 12.0)[:, None, None] * axis[:, :, None] * axis[:, None]
    return weight, weight[:, None] * middle, weight[:, None, None] * second


def _nearest_on_axis(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """(k, 3) points of one axis nearest to (k, 3) points."""
    found: FloatArray = _nearest_on_axes(points, start[None], end[None])[:, 0]
    return found


def _nearest_on_axes(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """(k, n, 3) points of n axes nearest to (k, 3) points."""
    along = end - start
    square = np.maximum(np.einsum("nj,nj->n", along, along), 1e-18)
    fraction = np.clip(np.einsum("knj,nj->kn", points[:, None] - start, along) / square, 0.0, 1.0)
    found: FloatArray = start + fraction[:, :, None] * along
    return found


def _parents_first(parent: IntArray, names: Sequence[str]) -> IntArray:
    """Order in which parents come before their children.

    Raises:
        SceneError: A segment is among its own ancestors.
    """
    depth = np.full(len(parent), -1, dtype=np.int64)
    for row in range(len(parent)):
        path = list[int]()
        at = row
        while at >= 0 and depth[at] < 0:
            if at in path:
                reason = f"{names[at]!r} is among its own ancestors: a limb grows from another one, up to a root"
                raise SceneError(reason, where="parent", value=names[int(parent[at])])
            path.append(at)
            at = int(parent[at])
        base = -1 if at < 0 else int(depth[at])
        for rank, each in enumerate(reversed(path), start=1):
            depth[each] = base + rank
    return frozen(np.argsort(depth, kind="stable"))
