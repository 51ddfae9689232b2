"""Loads on limbs and fruit: whether the contacts of a motion keep the limits of force and stress.

Each contact alone keeps them by its depth (`hplan.scene.limb_contacts`) and speed. Several contacts at a time add up:

- Contacts of one link, or of links that share a joint, are on one side of a limb. A displacement by one of them never
  increases the force that another one needs for its own, so each force is at most its depth over its compliance.
- Their stresses add up, on all limbs that share the first bending segment from the clamp. On one segment, the largest
  counts: of contacts on one side, the bending moment lies between those that each would cause alone.
- Other links might squeeze a limb from two sides, which no depth bounds. Such contacts are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import combinations
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.certificate.segment_contacts import SegmentContacts
from hplan.robot.model import Robot


def load_violations(robot: Robot, contacts: SegmentContacts) -> Iterator[str]:
    """Messages about limits of force and stress that contacts do not keep.

    Args:
        robot: The arm.
        contacts: Contacts within single segments of a motion, as from `hplan.certificate.pushes.pushes_along`.
    """
    loads, stresses = contacts.loads, contacts.stresses

    def force_in_words(row: int) -> str:
        speed = float(contacts.rows["speed"][loads.row[row]])
        return (
            f"exerts up to {loads.force[row]:.3g} N on {contacts.obstacle(loads.row[row])!r}, {loads.impact[row]:.3g} N"
            f" of it by its speed of up to {speed:.3g} m/s; allowed: {loads.most_force[row]:g} N"
        )

    too_much = np.flatnonzero(loads.force > loads.most_force)
    yield from _worst(robot, contacts, too_much, loads.force[too_much], force_in_words)

    bending = np.flatnonzero(stresses.stress > stresses.most)
    by_row = {_strongest(contacts, stresses.loads(group)): group for group in bending.tolist()}

    def stress_in_words(row: int) -> str:
        group, begin_s = by_row[row], float(contacts.rows["begin_s"][loads.row[row]])
        return (
            f"and others bend {contacts.obstacle(loads.row[row])!r} by up to {1e-6 * stresses.stress[group]:.3g} MPa "
            f"at {begin_s:.6g} s; allowed: {1e-6 * stresses.most[group]:g} MPa"
        )

    rows = np.array(list(by_row), dtype=np.int64)
    yield from _worst(robot, contacts, rows, stresses.stress[bending], stress_in_words)
    pinched = dict(_squeezing(robot, contacts))

    def sides_in_words(row: int) -> str:
        one, other = (int(loads.row[each]) for each in (row, pinched[row]))
        return (
            f"and {contacts.link(other)!r} may squeeze {contacts.obstacle(one)!r} and {contacts.obstacle(other)!r} "
            f"from two sides at {contacts.rows['begin_s'][one]:.6g} s"
        )

    rows = np.array(list(pinched), dtype=np.int64)
    yield from _worst(robot, contacts, rows, np.zeros(len(rows)), sides_in_words)


def _worst(
    robot: Robot, contacts: SegmentContacts, rows: IntArray, sizes: FloatArray, in_words: Callable[[int], str]
) -> Iterator[str]:
    """Message about the largest violation of each link and obstacle.

    Args:
        robot: The arm.
        contacts: The contacts.
        rows: (k,) numbers of their loads.
        sizes: (k,) sizes of the violations.
        in_words: The message about a load, after the name of the link.
    """
    worst = dict[tuple[str, str], tuple[float, int]]()
    for row, size in zip(rows.tolist(), sizes.tolist(), strict=True):
        contact = int(contacts.loads.row[row])
        key = contacts.link(contact), contacts.obstacle(contact)
        if key not in worst or size > worst[key][0]:
            worst[key] = size, row
    for (link, _), (_, row) in worst.items():
        yield f"{robot.link_in_words(link)} {in_words(row)}"


def _strongest(contacts: SegmentContacts, group: IntArray) -> int:
    """The load with the largest stress of some."""
    return int(group[contacts.loads.stress[group].argmax()])


def _squeezing(robot: Robot, contacts: SegmentContacts) -> Iterator[tuple[int, int]]:
    """Loads on limbs with one root, at one time, by links that share no joint: two for each root and time."""
    stresses, parents = contacts.stresses, robot.model.parents
    joint = contacts.rows["joint"][contacts.loads.row]
    if not len(stresses.first):
        return
    least, most = (each.reduceat(joint[stresses.order], stresses.first) for each in (np.minimum, np.maximum))
    for group in np.flatnonzero(least < most).tolist():
        loads = stresses.loads(group)
        for one, other in combinations(loads.tolist(), 2):
            a, b = int(joint[one]), int(joint[other])
            if a != b and parents[a] != b and parents[b] != a:
                yield other, one
                break


def shared_limb_violations(contacts: Mapping[str, SegmentContacts]) -> Iterator[str]:
    """Messages about limbs that two arms of a workcell push at the same time.

    Args:
        contacts: Contacts of each arm within single segments of its motion, by the name of the arm; limbs have the same
            numbers for all arms.
    """
    for (one, first), (other, second) in combinations(contacts.items(), 2):
        (root, begin_s, end_s), (roots, begins_s, ends_s) = (
            (own.loads.root, own.rows["begin_s"][own.loads.row], own.rows["end_s"][own.loads.row])
            for own in (first, second)
        )
        for row in np.flatnonzero(root >= 0).tolist():
            meets = np.flatnonzero((roots == root[row]) & (begin_s[row] <= ends_s) & (begins_s <= end_s[row]))
            if len(meets):
                names = first.obstacle(first.loads.row[row]), second.obstacle(second.loads.row[meets[0]])
                limbs = f"{names[0]!r} and {names[1]!r}"
                yield f"{one!r} and {other!r} push {limbs}, which share a limb, at {begin_s[row]:.6g} s"
                break


def gentle_speeds(
    contacts: SegmentContacts, duration_s: float, ease_s: float, slower: tuple[IntArray, FloatArray] | None = None
) -> FloatArray | None:
    """Fractions of a motion's speed over time with which impacts keep the limits of force and stress.

    Args:
        contacts: Contacts within single segments of the motion.
        duration_s: Its duration [s].
        ease_s: Time before and after a contact with the reduced speed, for braking [s].
        slower: (k,) numbers of contacts, and (k,) fractions of their speeds that other limits allow.

    Returns:
        (n, 2) times [s] and fractions, as for `Trajectory.scale_speed`; None if the motion need not be slower, or if no
        speed helps.
    """
    loads, stresses = contacts.loads, contacts.stresses
    room = loads.most_force - loads.static
    hard = np.flatnonzero(loads.impact > room)
    fraction = np.maximum(0.0, room[hard]) / loads.impact[hard]
    fraction = np.where(loads.is_fruit[hard], np.sqrt(fraction), fraction)  # with the square of the speed
    left = stresses.most - (stresses.stress - stresses.impact)
    bending = np.flatnonzero(stresses.impact > left)
    fraction = np.append(fraction, np.maximum(0.0, left[bending]) / stresses.impact[bending])
    rows = loads.row[np.append(hard, stresses.order[stresses.first[bending]]).astype(np.int64)]
    if slower is not None:
        rows, fraction = np.append(rows, slower[0]), np.append(fraction, slower[1])
    if not len(fraction) or fraction.min() < _SLOWEST:
        return None
    begin_s, end_s = contacts.rows["begin_s"][rows] - ease_s, contacts.rows["end_s"][rows] + ease_s
    times = np.linspace(0.0, duration_s, max(2, round(duration_s / _SPEED_STEP_S) + 1))
    near = (times[:, None] >= begin_s) & (times[:, None] <= end_s)
    return np.column_stack([times, np.where(near, _SPARE * fraction, 1.0).min(axis=1)])


#: Minimum fraction of its speed to which a motion is slowed down for impacts.
_SLOWEST: Final = 0.1

#: Part of the speed that impacts allow which is used: the bound of a slower motion's speed is not as sharp.
_SPARE: Final = 0.93

#: Step of the speeds [s].
_SPEED_STEP_S: Final = 0.02
