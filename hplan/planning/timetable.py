"""When the arms of a cell set out: each motion as soon as what the others are already to do leaves room for it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.deadline import check_deadline
from hplan.planning.cell import Cell, between
from hplan.planning.options import PlanOptions
from hplan.trajectory.cubics import Rows
from hplan.trajectory.trajectory import Trajectory, joined

#: Of so many samples one is looked at, in turn until a pair is too near.
_COARSE: Final = (32, 4, 1)

#: Distances between arms that samples have beyond the one to keep, in turn until the whole is certified [m].
SPARES: Final = (5e-4, 1.5e-3, 4e-3, 2e-2)


class Timetable:
    """Motions of arms, one set out after the other; nothing here is a proof.

    A motion is set out where it keeps clear of all that the others are to do from then on, and the arm where it then
    rests as well: there is no deadlock, at worst a motion that never can.

    Attributes:
        legs: For each arm its motions, and when each begins [s].
        places: For each arm (n, dof) where it is at multiples of the step, up to where it rests for good.
    """

    def __init__(self, cell: Cell, options: PlanOptions, spare: float) -> None:
        """Begin with all arms at their starts.

        Args:
            options: For the rows of motions: arms set out at one.
            spare: Distance between arms at samples beyond the one to keep [m]; inf lets one move at a time, unseen.
        """
        start = cell.configuration({})
        self._cell, self._least = cell, cell.scene.clearance + spare
        # Times at which arms are compared before they are certified [s].
        self._step = max(1, round(0.005 * options.rate_hz)) / options.rate_hz
        self.places = {arm.name: start[arm.joints][None] for arm in cell.arms}
        self.legs: dict[str, list[tuple[float, Trajectory]]] = {arm.name: [] for arm in cell.arms}

    @property
    def duration(self) -> float:
        """When the last motion ends [s]."""
        return max((begin + motion.duration for legs in self.legs.values() for begin, motion in legs), default=0.0)

    @property
    def begins_s(self) -> dict[str, float]:
        """When the first motion of each arm that moves begins [s]."""
        return {name: legs[0][0] for name, legs in self.legs.items() if legs}

    @property
    def motions(self) -> dict[str, Trajectory]:
        """The motion of each arm that moves, from the common begin on."""
        return {name: self._joined(name) for name, legs in self.legs.items() if legs}

    def free_from(self, name: str) -> float:
        """When an arm has done all that it is to do so far [s]."""
        return (len(self.places[name]) - 1) * self._step

    def _joined(self, name: str) -> Trajectory:
        parts, now = [], 0.0
        for begin, motion in self.legs[name]:
            if begin > now + 1e-9:
                parts.append(_standing(motion, begin - now))
            parts.append(motion)
            now = begin + motion.duration
        return joined(parts) if len(parts) > 1 else parts[0]

    def run(self, name: str, motion: Trajectory) -> None:
        """Let an arm run a motion from the begin on, without a look at the others."""
        self.places[name] = self._sampled(motion)
        self.legs[name].append((0.0, motion))

    def _sampled(self, motion: Trajectory) -> FloatArray:
        count = max(1, math.ceil(motion.duration / self._step - 1e-9))
        return motion.positions(np.minimum(np.arange(count + 1) * self._step, motion.duration))

    def set_out(self, name: str, motion: Trajectory) -> bool:
        """Let an arm run a motion from where it is, as soon as there is room; False where there never is."""
        own = self.places[name]
        moving = self._sampled(motion)[1:]
        last = max(map(len, self.places.values()))
        one_by_one = math.isinf(self._least)
        # How many of them a motion begins later at a time.
        later = 8
        for begin in [last] if one_by_one else range(len(own), max(len(own), last) + later + 1, later):
            check_deadline()
            planned = np.concatenate([np.repeat(own[-1:], begin - len(own), axis=0), moving])
            if one_by_one or self._is_clear(name, planned, len(own)):
                self.places[name] = np.concatenate([own, planned])
                self.legs[name].append(((begin - 1) * self._step, motion))
                return True
        return False

    def _is_clear(self, name: str, planned: FloatArray, first: int) -> bool:
        """True if an arm keeps clear of the others from a sample on, and where it then rests from all they will do."""
        last = max(first + len(planned), *(len(places) for places in self.places.values()))
        others = [arm.name for arm in self._cell.arms if arm.name != name]
        for coarse in _COARSE:
            some = np.arange(0, last - first, coarse)
            q = np.empty((len(some), self._cell.robot.dof))
            for arm in self._cell.arms:
                places = planned if arm.name == name else self.places[arm.name][first:]
                places = places if len(places) else self.places[arm.name][-1:]
                q[:, arm.joints] = places[np.minimum(some, len(places) - 1)]
            if not (between(self._cell, q, name, others) > self._least).all():
                return False
        return True


def _standing(motion: Trajectory, seconds: float) -> Trajectory:
    """Standing for a time where a motion begins."""
    position, torque = (np.repeat(values[:1], 2, axis=0) for values in (motion.position, motion.torque))
    still = np.zeros_like(position)
    rows = Rows(np.array([0.0, seconds]), position, still, still, torque)
    return Trajectory(motion.joint_names, *rows, motion.slides)
