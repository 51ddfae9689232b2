"""Loads on limbs and fruit: whether the contacts of a motion keep the limits of force and stress.

Each contact alone keeps them by its depth (`hplan.scene.limb_depths`) and speed. Several contacts at a time add up:

- Contacts of one link, or of links that share a joint, are on one side of a limb. A displacement by one of them never
  increases the force that another one needs for its own, so each force is at most its depth over its compliance.
- Their stresses add up, on all limbs that share the first bending segment from the clamp. On one segment, the largest
  counts: of contacts on one side, the bending moment lies between those that each would cause alone.
- Other links might squeeze a limb from two sides, which no depth bounds. Such contacts are refused.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.certificate.pushes import Load, Push
from hplan.robot.model import Robot


def load_violations(robot: Robot, pushes: Sequence[Push]) -> Iterator[str]:
    """Messages about limits of force and stress that contacts do not keep.

    Args:
        robot: The arm.
        pushes: Contacts within single segments of a motion, as from `hplan.certificate.pushes.pushes_along`.
    """
    by_time: dict[float, list[tuple[Push, Load]]] = defaultdict(list)
    worst = dict[tuple[str, str, str], tuple[float, str]]()
    for push in pushes:
        if push.load is None:
            continue
        by_time[push.begin_s].append((push, push.load))
        if push.load.force > push.load.limit.most_force:
            words = f"exerts up to {push.load.force:.3g} N on {push.obstacle!r}, {_speed_in_words(push.load)}"
            _note(worst, (push.link, push.obstacle, "force"), push.load.force,
                  f"{words}; allowed: {push.load.limit.most_force:g} N")  # fmt: skip
    for begin_s, found in by_time.items():
        roots: dict[int, list[tuple[Push, Load]]] = defaultdict(list)
        for push, load in found:
            if load.limit.root >= 0:
                roots[load.limit.root].append((push, load))
        for loads in roots.values():
            stress, allowed = _stress(loads), min(load.limit.most_stress for _, load in loads)
            if stress > allowed:
                push = max(loads, key=lambda pair: pair[1].stress)[0]
                _note(worst, (push.link, push.obstacle, "stress"), stress,
                      f"and others bend {push.obstacle!r} by up to {1e-6 * stress:.3g} MPa at {begin_s:.6g} s; "
                      f"allowed: {1e-6 * allowed:g} MPa")  # fmt: skip
            pinched = _squeezing(robot, loads)
            if pinched is not None:
                one, other = pinched
                _note(worst, (one.link, one.obstacle, "side"), 0.0,
                      f"and {other.link!r} may squeeze {one.obstacle!r} and {other.obstacle!r} from two sides at "
                      f"{begin_s:.6g} s")  # fmt: skip
    for (link, _, _), (_, words) in worst.items():
        yield f"{robot.link_in_words(link)} {words}"


def shared_limb_violations(pushes: Mapping[str, Sequence[Push]]) -> Iterator[str]:
    """Messages about limbs that two arms of a workcell push at the same time.

    Args:
        pushes: Contacts of each arm within single segments of its motion, by the name of the arm; limbs have the same
            numbers for all arms.
    """
    for (one, first), (other, second) in combinations(pushes.items(), 2):
        for push in first:
            meeting = (each for each in second if _share_limb(push, each))
            found = next(meeting, None)
            if found is not None:
                limbs = f"{push.obstacle!r} and {found.obstacle!r}"
                yield f"{one!r} and {other!r} push {limbs}, which share a limb, at {push.begin_s:.6g} s"
                break


def _share_limb(one: Push, other: Push) -> bool:
    """True if two contacts are on limbs with one root, at the same time."""
    if one.load is None or other.load is None or one.load.limit.root != other.load.limit.root:
        return False
    return one.load.limit.root >= 0 and one.begin_s <= other.end_s and other.begin_s <= one.end_s


def gentle_speeds(pushes: Sequence[Push], duration_s: float, ease_s: float) -> FloatArray | None:
    """Fractions of a motion's speed over time with which impacts keep the limits of force and stress.

    Args:
        pushes: Contacts within single segments of the motion.
        duration_s: Its duration [s].
        ease_s: Time before and after a contact with the reduced speed, for braking [s].

    Returns:
        (n, 2) times [s] and fractions, as for `Trajectory.scale_speed`; None if the motion need not be slower, or if no
        speed helps.
    """
    slower = list[tuple[float, float, float]]()
    by_root: dict[tuple[float, int], list[tuple[Push, Load]]] = defaultdict(list)
    for push in pushes:
        load = push.load
        if load is None:
            continue
        by_root[push.begin_s, load.limit.root].append((push, load))
        room = load.limit.most_force - load.share * load.limit.force
        if load.impact > room:
            fraction = max(0.0, room) / load.impact
            slower.append((push.begin_s, push.end_s, math.sqrt(fraction) if load.limit.swing > 0.0 else fraction))
    for (_, root), loads in by_root.items():
        impact = max(load.impact_stress for _, load in loads)
        room = min(load.limit.most_stress for _, load in loads) - (_stress(loads) - impact)
        if root >= 0 and impact > room:
            push = loads[0][0]
            slower.append((push.begin_s, push.end_s, max(0.0, room) / impact))
    if not slower or min(fraction for *_, fraction in slower) < _SLOWEST:
        return None
    times = np.linspace(0.0, duration_s, max(2, round(duration_s / _SPEED_STEP_S) + 1))
    fractions = np.ones(len(times))
    for begin_s, end_s, fraction in slower:
        near = (times >= begin_s - ease_s) & (times <= end_s + ease_s)
        fractions[near] = np.minimum(fractions[near], _SPARE * fraction)
    return np.column_stack([times, fractions])


#: Minimum fraction of its speed to which a motion is slowed down for impacts.
_SLOWEST: Final = 0.1

#: Part of the speed that impacts allow which is used: the bound of a slower motion's speed is not as sharp.
_SPARE: Final = 0.93

#: Step of the speeds [s].
_SPEED_STEP_S: Final = 0.02


def _note(
    worst: dict[tuple[str, str, str], tuple[float, str]], key: tuple[str, str, str], size: float, words: str
) -> None:
    """Keep the message of the largest violation of a kind."""
    if key not in worst or size > worst[key][0]:
        worst[key] = size, words


def _speed_in_words(load: Load) -> str:
    return f"{load.impact:.3g} N of it by its speed of up to {load.speed:.3g} m/s"


def _stress(loads: Sequence[tuple[Push, Load]]) -> float:
    """Bending stress by simultaneous contacts of limbs with one root [Pa]."""
    of_segment: dict[tuple[int, bool], float] = defaultdict(float)
    for _, load in loads:
        key = load.limit.segment, load.limit.swing > 0.0
        of_segment[key] = max(of_segment[key], load.stress)
    return sum(of_segment.values()) + max(load.impact_stress for _, load in loads)


def _squeezing(robot: Robot, loads: Sequence[tuple[Push, Load]]) -> tuple[Push, Push] | None:
    """Two contacts by links that share no joint, or None."""
    parents = robot.model.parents
    for n, (push, load) in enumerate(loads):
        for other, second in loads[:n]:
            a, b = load.joint, second.joint
            if a != b and parents[a] != b and parents[b] != a:
                return push, other
    return None
