r"""How far a fruit is displaced when it is grasped, by the hand and by pushed limbs.

**Limbs.** Of the contacts with limbs that carry the fruit, or grow from its limb, the largest counts: they are on one
side, and each deflects what is beyond it. Those with other limbs of the same root, and with other fruit, add up.

**The hand.** The goal fruit of a scene is rigid, so nothing pushes it before the straight approach; fruit of a tour may
be pushed until then. A push that lasts until then counts as held until the grasp: the hand takes the fruit in where it
pushed it. On the approach the hand keeps within `hplan.certificate.goal_contact.OFFSET` of a line to the fruit's
centre, and takes it in without pushing it. Without an approach the last link may touch the fruit at all times, and only
other links count.

**Swing.** Let contacts displace the point that the fruit hangs from by u. A fruit that swings about it with the
frequency :math:`\omega` and the damping ratio :math:`\zeta` is off by at most

.. math:: \int_0^t |\dot u(s)| e^{-\zeta \omega (t - s)} ds,

which is bounded for contacts that deepen once: a limb swings as far beyond its deflection, and as far back. A link that
meets the fruit itself with the speed v throws it ahead with at most 2 v, and so by at most :math:`2 v / \omega`, since
energy is conserved. Limbs that are thrown ahead are not included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from hplan.base import ties
from hplan.certificate.clearance_curve import ProvedMotion, Subject
from hplan.certificate.goal_contact import REST
from hplan.certificate.segment_contacts import SegmentContacts
from hplan.scene.obstacle_kind import ContactLimit, Hanging
from hplan.scene.wood import DAMPING_RATIO


class GoalDisplacement(NamedTuple):
    """Upper bounds for a grasped fruit, or the largest of several ones.

    Attributes:
        held_m: Displacement by the contacts that last until the grasp [m].
        swing_m: Swing about that place after contacts with the fruit or its limb [m].
        beyond_m: Largest amount by which `held_m` exceeds the capture range [m]; negative if it does not.
    """

    held_m: float
    swing_m: float
    beyond_m: float


class Grasp(NamedTuple):
    """A grasp of a hanging fruit.

    Attributes:
        name: Name of the fruit.
        fruit: Its own contact limit.
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
    for grasp in _grasps(subject):
        held = displacement_at(contacts, grasp)
        found.append(GoalDisplacement(held, swing_at(contacts, grasp), held - grasp.fruit.capture_range))
    return GoalDisplacement(*map(max, zip(*found, strict=True))) if found else None


def capture_violations(moved: GoalDisplacement | None) -> list[str]:
    """Message about a fruit that is displaced beyond the capture range, if there is one."""
    if moved is None or moved.beyond_m <= 0.0:
        return []
    return [
        f"hand and pushed limbs displace the fruit by up to {1e3 * moved.held_m:.3g} mm at the grasp; allowed: "
        f"{1e3 * (moved.held_m - moved.beyond_m):g} mm"
    ]


def _grasps(subject: Subject) -> Iterator[Grasp]:
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
        rows = np.arange(part.start, min(part.stop + 1, trajectory.samples))
        speeds = np.abs(trajectory.velocity[rows]).max(axis=1)
        resting = rows[speeds <= max(REST, float(speeds.min()))]
        for name, center, limit in checker.fruit_limits:
            first_s = touched_s.setdefault(name, float(trajectory.time[part.start]))
            apart = np.linalg.norm(robot.tool_positions(trajectory.position[resting]) - center, axis=1)
            yield Grasp(name, limit, first_s, float(trajectory.time[resting[ties.argmin(apart)]]))


def displacement_at(contacts: SegmentContacts, grasp: Grasp) -> float:
    """Upper bound of the displacement by contacts that last until a grasp [m].

    Args:
        contacts: Contacts within single segments of a motion.
        grasp: The grasp.
    """
    return sum(contact.last for contact in _displacements(contacts, grasp) if contact.end_s >= grasp.time_s)


def swing_at(contacts: SegmentContacts, grasp: Grasp) -> float:
    """Upper bound of the swing about the place where contacts hold a fruit [m].

    Args:
        contacts: Contacts within single segments of a motion.
        grasp: The grasp.
    """
    swing, decay = 0.0, grasp.fruit.decay_rate
    for contact in _displacements(contacts, grasp):
        left = contact.last if contact.end_s >= grasp.time_s else 0.0
        thrown = 2.0 * contact.speed * DAMPING_RATIO / decay if contact.speed > 0.0 else 0.0
        swing += (2.0 * contact.most - left + thrown) * math.exp(-decay * max(0.0, grasp.time_s - contact.end_s))
    return swing


class _Displacement(NamedTuple):
    """Displacement of a fruit by one contact.

    Attributes:
        end_s: End of the contact [s].
        most: Largest displacement until the grasp [m].
        last: The last displacement before it [m].
        speed: Largest speed of a link that pushes the fruit itself [m/s]; 0 for others.
    """

    end_s: float
    most: float
    last: float
    speed: float


def _displacements(contacts: SegmentContacts, grasp: Grasp) -> list[_Displacement]:
    """Displacements of a fruit by the contacts that begin before its grasp."""
    point, loads = grasp.fruit.displacement, contacts.loads
    if point is None:
        return []
    own = np.array([name == grasp.name for name in contacts.obstacles], dtype=np.bool_)
    is_own = own[contacts.rows["obstacle"][loads.row]]
    related = is_own | ((loads.root == grasp.fruit.root) & (grasp.fruit.root >= 0))
    kept = np.flatnonzero(related & (contacts.rows["begin_s"][loads.row] <= grasp.time_s))
    if not len(kept):
        return []
    rows, is_own = contacts.rows[loads.row[kept]], is_own[kept]
    used, of_each = np.unique(rows["limit"], return_inverse=True)
    mine = set(rows["limit"][is_own].tolist())
    ratios = [(0.0, False) if number in mine else _ratio_of(point, contacts.limits[number]) for number in used.tolist()]
    ratio, carries = (np.array(column)[of_each] for column in zip(*ratios, strict=True))
    size, speed = rows["depth"] * ratio, np.where(is_own, rows["speed"], 0.0)
    size[is_own] = [
        point.displacement_by_push(*each)
        for each in zip(loads.static[kept][is_own].tolist(), rows["whole_depth"][is_own].tolist(), strict=True)
    ]
    lasts = is_own & (rows["end_s"] >= grasp.touched_s - _TOUCHING_S)
    end_s = np.where(lasts, grasp.time_s, rows["end_s"])
    body = np.where(carries, -1, loads.segment[kept]), np.where(loads.is_fruit[kept], rows["obstacle"], -1)
    order = np.lexsort((end_s, rows["begin_s"], *body))
    columns = (np.stack(body, axis=1), np.stack([rows["begin_s"], end_s], axis=1), size, speed)
    found, last = list[_Displacement](), ([-2, -2], [0.0, 0.0])
    for key, span, most, fast in zip(*(column[order].tolist() for column in columns), strict=True):
        if key != last[0] or span[0] > found[-1].end_s + _TOUCHING_S:
            found.append(_Displacement(span[1], most, most, fast))
        else:
            known = found[-1]
            # Of several parts within one segment the largest counts.
            now = max(most, known.last) if span == last[1] else most
            found[-1] = _Displacement(max(known.end_s, span[1]), max(known.most, most), now, max(known.speed, fast))
        last = key, span
    return found


def _ratio_of(point: Hanging, limit: ContactLimit | None) -> tuple[float, bool]:
    """Displacement of a fruit per depth of a contact, and whether limbs of both carry each other."""
    return (0.0, False) if limit is None else point(limit)


#: Contacts with one limb that are less than this apart are one [s].
_TOUCHING_S: Final = 1e-6
