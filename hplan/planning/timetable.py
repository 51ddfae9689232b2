"""When the arms of a cell set out: each motion as soon as what the others are already to do leaves room for it."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
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

    def run_together(
        self,
        motions: Mapping[str, Sequence[Trajectory]],
        sooner_than: float,
        known: dict[tuple[str, str], FloatArray],
        backward: Collection[str],
    ) -> bool:
        """Let arms that stand at their starts run motions one after the other so that all are done soonest.

        Each waits where it rests alone: what two arms have done at an instant is a place in a square, and how they go
        on a path through it, around where they are too near to each other. Further arms are put in one by one.

        Args:
            known: Distances in the squares of each two, for the next call.
            backward: Arms whose motions are reversed since these were taken.

        Returns:
            False where no such way was found that is done sooner than a time [s].
        """
        # Samples of the square, and what is kept at them beyond the rest, in turn: arms go on between them [m].
        every, beyond = 15, (0.02, 0.01, 0.003, 0.0)
        step = every * self._step
        arms = sorted(motions, key=lambda name: -sum(motion.duration for motion in motions[name]))
        ends, rests, places = dict[str, list[int]](), dict[str, BoolArray](), dict[str, FloatArray]()
        for name in arms:
            whole = joined(motions[name])
            done = np.rint(np.cumsum([motion.duration for motion in motions[name]]) / step).astype(int)
            ends[name] = [0, *done.tolist()]
            places[name] = whole.positions(np.linspace(0.0, whole.duration, done[-1] + 1))
            rests[name] = np.isin(np.arange(done[-1] + 1), ends[name])
        for more in beyond:
            at = {arms[0]: np.arange(len(places[arms[0]]))}
            for name in arms[1:]:
                apart = np.min([self._apart(other, name, places, known, backward)[at[other]] for other in at], axis=0)
                still = np.all([rests[other][at[other]] for other in at], axis=0)
                way = _soonest(apart > self._least + more, still, rests[name])
                at = {other: at[other][way[:, 0]] for other in at} | {name: way[:, 1]}
            if not 0.0 <= (len(at[arms[0]]) - 1) * step < sooner_than:
                continue
            start = dict(self.places)
            for name in arms:
                begin, own = 0.0, [start[name]]
                for rest, motion in zip(ends[name], motions[name], strict=False):
                    waits = every * (np.count_nonzero(at[name] == rest) - 1)
                    begin += waits * self._step
                    self.legs[name].append((begin, motion))
                    begin += motion.duration
                    own += [np.repeat(own[-1][-1:], waits, axis=0), self._sampled(motion)[1:]]
                self.places[name] = np.concatenate(own)
            if all(self._is_clear(name, self.places[name], 0) for name in arms):
                return True
            self.places, self.legs = start, {name: [] for name in self.legs}
        return False

    def _apart(
        self, first: str, name: str, places: Mapping[str, FloatArray], known: dict[tuple[str, str], FloatArray],
        backward: Collection[str],
    ) -> FloatArray:  # fmt: skip
        """(n, m) distances of an arm at each of its places from another at each of its, as for `run_together` [m]."""
        turns = tuple(slice(None, None, -1 if each in backward else 1) for each in (first, name))
        if (first, name) not in known:
            known[first, name] = self._distances(first, name, places)[turns]
        return known[first, name][turns]

    def _distances(self, first: str, name: str, places: Mapping[str, FloatArray]) -> FloatArray:
        """(n, m) of an arm at each of its places from another at each of its; inf where they are far apart [m]."""
        n, m = len(places[first]), len(places[name])

        def apart(i: IntArray, j: IntArray) -> FloatArray:
            q = self._cell.configuration({first: places[first][i], name: places[name][j]})
            return between(self._cell, q, name, [first])

        # Of squares of so many samples the middles first: what is so far apart there is far apart in all of it [m].
        size, far = 4, 0.3
        i, j = np.meshgrid(np.arange(0, n, size), np.arange(0, m, size), indexing="ij")
        middle = apart(np.minimum(i + size // 2, n - 1).ravel(), np.minimum(j + size // 2, m - 1).ravel())
        near = np.kron((middle <= far).reshape(i.shape), np.ones((size, size), dtype=np.bool_))[:n, :m]
        found = np.full((n, m), math.inf)
        for begin in range(0, n, 64):  # as many as fit the memory, whatever the tours
            check_deadline()
            rows, columns = np.nonzero(near[begin : begin + 64])
            found[rows + begin, columns] = apart(rows + begin, columns)
        return found

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


def _soonest(clear: BoolArray, first: BoolArray, then: BoolArray) -> IntArray:
    """(k, 2) how far two have come step by step, both done soonest; (0, 2) where there is no way.

    Args:
        clear: (n, m) where both may be at once.
        first: (n,) where the first may wait.
        then: (m,) where the second may.
    """
    steps = _steps(clear, first, then)
    i, j = clear.shape[0] - 1, clear.shape[1] - 1
    found = [(i, j)] if len(steps) and steps[i, j] >= 0 else []
    while found and (i or j):
        before = steps[i, j] - 1
        if i and j and steps[i - 1, j - 1] == before:
            i, j = i - 1, j - 1
        elif i and then[j] and steps[i - 1, j] == before:
            i -= 1
        else:
            j -= 1
        found.append((i, j))
    return np.array(found[::-1], dtype=np.int64).reshape(-1, 2)


@kernel
def _steps(clear: BoolArray, first: BoolArray, then: BoolArray) -> IntArray:
    """(n, m) the least number of steps in which two come as far; below 0 where they never do."""
    n, m = clear.shape
    steps, never = np.full((n, m), -1), n + m
    for i in range(n):
        for j in range(m):
            least = 0 if i + j == 0 else never
            if i > 0 and j > 0 and steps[i - 1, j - 1] >= 0:
                least = steps[i - 1, j - 1] + 1
            if i > 0 and then[j] and steps[i - 1, j] >= 0:
                least = min(least, steps[i - 1, j] + 1)
            if j > 0 and first[i] and steps[i, j - 1] >= 0:
                least = min(least, steps[i, j - 1] + 1)
            if clear[i, j] and least < never:
                steps[i, j] = least
    return steps
