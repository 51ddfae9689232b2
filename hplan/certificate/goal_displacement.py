r"""How far a fruit is displaced when it is grasped, by everything that was pushed before.

A contact of the depth d with a limb exerts at most the static force f of that depth and the force I of an impact.
Becoming deeper by :math:`\delta` in all, it does the work :math:`W \le \int f(d)\, dd + I \delta`. One with a fruit of
the mass m throws it ahead as well, with at most twice the speed v of the link: it adds at most :math:`2 m v^2`. All
contacts with limbs and fruit that share the first bending segment from the clamp add up, since these are coupled. So do
contacts with other limbs and fruit that may be pressed against them (`hplan.scene.neighbours`).

With the largest eigenvalue :math:`\lambda` of the compliance of limb and pendulum at the fruit, a displacement x of the
fruit takes at least the energy :math:`|x|^2 / 2 \lambda`. Contacts that last until the grasp, swinging fruit and limbs
that were released have no more than all work together, so

.. math:: |x| \le \sqrt{2 \lambda \sum_i W_i e^{-2 \zeta \omega t_i}},

where the energy of a contact that ended :math:`t_i` before the grasp has decayed with the lowest frequency
:math:`\omega` and damping ratio :math:`\zeta`.

The goal fruit of a scene is rigid, so nothing pushes it before the straight approach; fruit of a tour may be pushed
until then. A push that lasts until then counts as held until the grasp: the hand takes the fruit in where it pushed it.
On the approach the hand keeps within `hplan.certificate.goal_contact.OFFSET` of a line to where it grasps the fruit,
and takes it in without pushing it. Without an approach the last link may touch the fruit at all times: only other links
count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.certificate.clearance_curve import ProvedMotion, Subject
from hplan.certificate.goal_contact import REST, THERE
from hplan.certificate.segment_contacts import SegmentContacts
from hplan.scene.obstacle_kind import ContactLimit
from hplan.scene.wood import DAMPING_RATIO


class GoalDisplacement(NamedTuple):
    """Upper bounds for a grasped fruit, or the largest of several ones.

    Attributes:
        moved_m: Displacement at the grasp [m].
        beyond_m: Largest amount by which it exceeds the capture range [m]; negative if it does not.
    """

    moved_m: float
    beyond_m: float


class Grasp(NamedTuple):
    """A grasp of a hanging fruit.

    Attributes:
        name: Name of the fruit.
        fruit: Its own contact limit; a grasp off its centre takes its distance from the capture range.
        touched_s: Time from which the hand may touch it [s].
        time_s: Time of the grasp [s].
    """

    name: str
    fruit: ContactLimit
    touched_s: float
    time_s: float


def goal_displacement(subject: Subject) -> GoalDisplacement | None:
    """Upper bounds over the grasps of a sequence of motions; None without a grasp of a hanging fruit."""
    found, contacts = list[GoalDisplacement](), subject.pushes_by_segment
    for grasp in grasps_in(subject):
        moved = displacement_at(contacts, grasp)
        found.append(GoalDisplacement(moved, moved - grasp.fruit.capture_range))
    return GoalDisplacement(*map(max, zip(*found, strict=True))) if found else None


def capture_violations(moved: GoalDisplacement | None) -> list[str]:
    """Message about a fruit that is displaced beyond the capture range, if there is one."""
    if moved is None or moved.beyond_m <= 0.0:
        return []
    return [
        f"hand and pushed limbs displace the fruit by up to {1e3 * moved.moved_m:.3g} mm at the grasp; allowed: "
        f"{1e3 * (moved.moved_m - moved.beyond_m):g} mm"
    ]


def grasps_in(subject: Subject) -> Iterator[Grasp]:
    """Grasps of a sequence of motions.

    A fruit is grasped where the tool rests nearest to it while it may be touched.
    """
    begin_s = 0.0
    for motion, backwards in subject.motions:
        duration_s = motion.trajectory.duration
        for grasp in _grasps_of(motion):
            if not backwards:
                yield Grasp(grasp.name, grasp.fruit, begin_s + grasp.touched_s, begin_s + grasp.time_s)
        begin_s += duration_s


def _grasps_of(motion: ProvedMotion) -> Iterator[Grasp]:
    trajectory, robot = motion.trajectory, motion.robot
    touched_s = dict[str, float]()
    for part, checker, *_ in motion.stretches:
        fruits = checker.fruit_limits
        if not fruits:
            continue
        rows = np.arange(part.start, min(part.stop + 1, trajectory.samples))
        speeds = np.abs(trajectory.velocity[rows]).max(axis=1)
        resting = rows[speeds <= max(REST, float(speeds.min()))]
        for name, center, limit in fruits:
            first_s = touched_s.setdefault(name, float(trajectory.time[part.start]))
            apart = np.linalg.norm(robot.tool_positions(trajectory.position[resting]) - center, axis=1)
            nearest = int(ties.argmin(apart))
            left_m = max(0.0, limit.capture_range - max(0.0, float(apart[nearest]) - THERE))
            yield Grasp(name, limit._replace(capture_range=left_m), first_s, float(trajectory.time[resting[nearest]]))


def displacement_at(contacts: SegmentContacts, grasp: Grasp) -> float:
    """Upper bound of the displacement of a fruit at its grasp by all contacts before [m].

    Args:
        contacts: Contacts within single segments of a motion.
        grasp: The grasp.
    """
    found = _squares_at(contacts, grasp)
    return math.sqrt(found.still + found.moving)


def contacts_to_slow(subject: Subject) -> tuple[IntArray, FloatArray] | None:
    """Contacts whose speed displaces a grasped fruit beyond the capture range.

    Returns:
        (k,) their numbers in `subject.pushes_by_segment`, and (k,) fractions of their speeds that keep the fruit within
        the range; None if no speed does.
    """
    rows, fractions = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for grasp in grasps_in(subject):
        found, allowed = _squares_at(subject.pushes_by_segment, grasp), grasp.fruit.capture_range**2
        if found.still >= allowed:
            return None
        if found.still + found.moving > allowed:
            # Impacts do work in proportion to the speed, fruit that are thrown have energy in proportion to its square.
            rows.append(found.rows)
            fractions.append(np.full(len(found.rows), (allowed - found.still) / found.moving))
    return np.concatenate(rows), np.concatenate(fractions)


class _Squares(NamedTuple):
    """Parts of the squared displacement of a fruit at its grasp.

    Attributes:
        still: The part of static forces [m^2].
        moving: The part of the speed of contacts [m^2].
        rows: (k,) numbers of the contacts that displace it.
    """

    still: float = 0.0
    moving: float = 0.0
    rows: IntArray = frozen(np.zeros(0, dtype=np.int64))


def _squares_at(contacts: SegmentContacts, grasp: Grasp) -> _Squares:
    point, loads = grasp.fruit.displacement, contacts.loads
    if point is None or not len(loads.row):
        return _Squares()
    is_own, is_on, is_beside = contacts.displacing(grasp.fruit.root, grasp.name)
    kept = np.flatnonzero((is_on | is_beside) & (contacts.rows["begin_s"][loads.row] <= grasp.time_s))
    if not len(kept):
        return _Squares()
    rows, is_own, is_fruit = contacts.rows[loads.row[kept]], is_own[kept], loads.is_fruit[kept]
    bodies = np.stack([rows["link"], loads.segment[kept], np.where(is_fruit, rows["obstacle"], -1)])
    order = np.lexsort((rows["begin_s"], *bodies))
    rows, is_own, is_fruit = rows[order], is_own[order], is_fruit[order]
    is_other = np.append(True, (np.diff(bodies[:, order], axis=1) != 0).any(axis=0))
    # Of several parts of a limb within one segment of the motion the largest counts.
    span = np.flatnonzero(is_other | np.append(True, np.diff(rows["begin_s"]) != 0.0))
    depth = np.maximum.reduceat(np.where(is_fruit, rows["whole_depth"], rows["depth"]), span)
    begin_s, end_s = rows["begin_s"][span], np.maximum.reduceat(rows["end_s"], span)
    starts = is_other[span] | np.append(True, begin_s[1:] > end_s[:-1] + _TOUCHING_S)
    first = np.flatnonzero(starts)
    deeper = np.maximum(depth - np.where(starts, 0.0, np.append(0.0, depth[:-1])), 0.0)
    thrown = 2.0 * loads.mass[kept][order] * np.where(rows["whole_depth"] > 0.0, rows["speed"], 0.0) ** 2
    # The rest is work on the wood that the fruit hangs from.
    pressed = np.where(is_fruit | is_beside[kept][order], loads.static[kept][order], loads.pressed[kept][order])
    elastic, pressed, impact, thrown = (
        np.maximum.reduceat(values, span)
        for values in (loads.static[kept][order] - pressed, pressed, loads.impact[kept][order], thrown)
    )
    of_wood = np.add.reduceat(elastic * deeper, first)
    others = np.add.reduceat(pressed * deeper, first)
    moving = np.maximum.reduceat(impact, first) * np.add.reduceat(deeper, first) + np.maximum.reduceat(thrown, first)
    until_s = np.maximum.reduceat(end_s, first)
    lasts = is_own[span][first] & (until_s >= grasp.touched_s - _TOUCHING_S)
    ago_s = np.where(lasts, 0.0, np.maximum(0.0, grasp.time_s - until_s))
    rate = np.minimum(grasp.fruit.decay_rate, loads.decay_rate[kept][order][span][first])
    left = np.minimum(1.0, _SLOWEST_DECAY * np.exp(-2.0 * rate * ago_s))
    # The squared displacement is linear in the work.
    still = point.displacement_by_work(float((of_wood * left).sum()), float((others * left).sum()))
    return _Squares(still**2, point.displacement_by_work(0.0, float((moving * left).sum())) ** 2, loads.row[kept])


#: Contacts with one limb that are less than this apart are one [s].
_TOUCHING_S: Final = 1e-6

#: The energy of an oscillator with this damping exceeds its mean decay by at most this factor.
_SLOWEST_DECAY: Final = (1.0 + DAMPING_RATIO) / (1.0 - DAMPING_RATIO)
