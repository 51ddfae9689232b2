"""Start times of a workcell's arms: each as early as possible."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, IntArray
from hplan.base.deadline import check_deadline
from hplan.base.kernels import kernel
from hplan.planning.options import PlanOptions
from hplan.trajectory.cubics import Rows
from hplan.trajectory.trajectory import Trajectory, join_trajectories
from hplan.workcell.cell import Cell, distances_between

#: Sampling strides for distance queries, coarse first, until a pair is too close.
_COARSE: Final = (32, 4, 1)

#: Distances between arms beyond the required one at samples, tried in turn until the whole motion is certified [m].
SPARES: Final = (5e-4, 1.5e-3, 4e-3, 2e-2)


class Timetable:
    """Motions of arms, scheduled one by one; a heuristic, not a proof.

    A motion is scheduled if the arm keeps clear of everything that the others do from then on, and of them at its final
    configuration, too. There is no deadlock: at worst a motion has no feasible start time.

    Attributes:
        legs: For each arm its motions with their start times [s].
        places: For each arm (n, dof) configurations at multiples of the step, up to its final rest.
    """

    def __init__(self, cell: Cell, options: PlanOptions, spare: float) -> None:
        """Start with all arms at their starts.

        Args:
            cell: The arms.
            options: Options with the sampling rate; motions start at samples.
            spare: Distance between arms beyond the required one at samples [m]; inf runs one arm at a time without
                distance queries.
        """
        start = cell.configuration({})
        self._cell, self._least = cell, cell.scene.clearance + spare
        # Time between distance queries before certification [s].
        self._step = max(1, round(0.005 * options.rate_hz)) / options.rate_hz
        self.places = {arm.name: start[arm.joints][None] for arm in cell.arms}
        self.legs: dict[str, list[tuple[float, Trajectory]]] = {arm.name: [] for arm in cell.arms}

    @property
    def duration(self) -> float:
        """End time of the last motion [s]."""
        return max((begin + motion.duration for legs in self.legs.values() for begin, motion in legs), default=0.0)

    @property
    def begins_s(self) -> dict[str, float]:
        """Start time of the first motion of each arm that moves [s]."""
        return {name: legs[0][0] for name, legs in self.legs.items() if legs}

    @property
    def motions(self) -> dict[str, Trajectory]:
        """The motion of each arm that moves, from the common start on."""
        return {name: self._join(name) for name, legs in self.legs.items() if legs}

    def _join(self, name: str) -> Trajectory:
        parts, now = [], 0.0
        for begin, motion in self.legs[name]:
            if begin > now + 1e-9:
                parts.append(_rest_motion(motion, begin - now))
            parts.append(motion)
            now = begin + motion.duration
        return join_trajectories(parts) if len(parts) > 1 else parts[0]

    def run(self, name: str, motion: Trajectory) -> None:
        """Let an arm run a motion from the start, without distance queries."""
        self.places[name] = self._sample(motion)
        self.legs[name].append((0.0, motion))

    def _sample(self, motion: Trajectory) -> FloatArray:
        count = max(1, math.ceil(motion.duration / self._step - 1e-9))
        return motion.positions(np.minimum(np.arange(count + 1) * self._step, motion.duration))

    def run_together(
        self,
        motions: Mapping[str, Sequence[Trajectory]],
        sooner_than: float,
        known: dict[tuple[str, str], FloatArray],
        backward: Collection[str],
    ) -> bool:
        """Schedule several motions of each arm so that all end soonest.

        Arms wait only where their motions end. The progress of two arms at a time is a point in a rectangle, and a
        schedule is a path through it that avoids the points with too small a distance. Further arms are added one by
        one.

        Args:
            motions: The motions of each arm, from its start on.
            sooner_than: Duration that the schedule must stay below [s].
            known: Cache of the distances of each pair of arms, for the next call.
            backward: Arms whose motions are reversed since the distances were cached.

        Returns:
            False if no such schedule was found.
        """
        # Stride of the samples, and extra distances at them, tried in turn: the arms move on between the samples [m].
        every, beyond = 15, (0.02, 0.01, 0.003, 0.0)
        step = every * self._step
        arms = sorted(motions, key=lambda name: -sum(motion.duration for motion in motions[name]))
        ends, rests, places = dict[str, list[int]](), dict[str, BoolArray](), dict[str, FloatArray]()
        for name in arms:
            whole = join_trajectories(motions[name])
            done = np.rint(np.cumsum([motion.duration for motion in motions[name]]) / step).astype(int)
            ends[name] = [0, *done.tolist()]
            places[name] = whole.positions(np.linspace(0.0, whole.duration, done[-1] + 1))
            rests[name] = np.isin(np.arange(done[-1] + 1), ends[name])
        for more in beyond:
            at = {arms[0]: np.arange(len(places[arms[0]]))}
            for name in arms[1:]:
                apart = np.min(
                    [self._cached_distances(other, name, places, known, backward)[at[other]] for other in at], axis=0
                )
                still = np.all([rests[other][at[other]] for other in at], axis=0)
                way = _fastest_progress(apart > self._least + more, still, rests[name])
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
                    own += [np.repeat(own[-1][-1:], waits, axis=0), self._sample(motion)[1:]]
                self.places[name] = np.concatenate(own)
            if all(self._is_clear(name, self.places[name], 0) for name in arms):
                return True
            self.places, self.legs = start, {name: [] for name in self.legs}
        return False

    def _cached_distances(
        self, first: str, name: str, places: Mapping[str, FloatArray], known: dict[tuple[str, str], FloatArray],
        backward: Collection[str],
    ) -> FloatArray:  # fmt: skip
        """(n, m) cached distances between the configurations of two arms [m].

        `known` and `backward` as in `run_together`.
        """
        turns = tuple(slice(None, None, -1 if each in backward else 1) for each in (first, name))
        if (first, name) not in known:
            known[first, name] = self._distances(first, name, places)[turns]
        return known[first, name][turns]

    def _distances(self, first: str, name: str, places: Mapping[str, FloatArray]) -> FloatArray:
        """(n, m) distances between the configurations of two arms [m].

        Pairs that are far apart have inf.
        """
        n, m = len(places[first]), len(places[name])

        def distances_of(i: IntArray, j: IntArray) -> FloatArray:
            q = self._cell.configuration({first: places[first][i], name: places[name][j]})
            return distances_between(self._cell, q, name, [first])

        # Query the centers of blocks of this size first: a block whose center is this far apart is far apart as a whole
        # [m].
        size, far = 4, 0.3
        i, j = np.meshgrid(np.arange(0, n, size), np.arange(0, m, size), indexing="ij")
        middle = distances_of(np.minimum(i + size // 2, n - 1).ravel(), np.minimum(j + size // 2, m - 1).ravel())
        near = np.kron((middle <= far).reshape(i.shape), np.ones((size, size), dtype=np.bool_))[:n, :m]
        found = np.full((n, m), math.inf)
        for begin in range(0, n, 64):  # bounds the memory for tours of any length
            check_deadline()
            rows, columns = np.nonzero(near[begin : begin + 64])
            found[rows + begin, columns] = distances_of(rows + begin, columns)
        return found

    def set_out(self, name: str, motion: Trajectory) -> bool:
        """Let an arm run a motion as soon as there is room.

        Returns:
            False if there is no feasible start time.
        """
        own = self.places[name]
        moving = self._sample(motion)[1:]
        last = max(map(len, self.places.values()))
        one_by_one = math.isinf(self._least)
        # Number of samples between two start times that are tried.
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
        """True if an arm keeps clear of the others from `first` on.

        At its final configuration it must keep clear of everything that they do later.
        """
        last = max(first + len(planned), *(len(places) for places in self.places.values()))
        others = [arm.name for arm in self._cell.arms if arm.name != name]
        for coarse in _COARSE:
            some = np.arange(0, last - first, coarse)
            q = np.empty((len(some), self._cell.robot.dof))
            for arm in self._cell.arms:
                places = planned if arm.name == name else self.places[arm.name][first:]
                places = places if len(places) else self.places[arm.name][-1:]
                q[:, arm.joints] = places[np.minimum(some, len(places) - 1)]
            if not (distances_between(self._cell, q, name, others) > self._least).all():
                return False
        return True


def _rest_motion(motion: Trajectory, seconds: float) -> Trajectory:
    """A motion that rests at the start of another one."""
    position, torque = (np.repeat(values[:1], 2, axis=0) for values in (motion.position, motion.torque))
    still = np.zeros_like(position)
    rows = Rows(np.array([0.0, seconds]), position, still, still, torque)
    return Trajectory(motion.joint_names, *rows, motion.slides)


def _fastest_progress(clear: BoolArray, first: BoolArray, then: BoolArray) -> IntArray:
    """(k, 2) fastest joint progress of two arms; (0, 2) if infeasible.

    Args:
        clear: (n, m) True if the arms keep clear at these configurations.
        first: (n,) True if the first arm may wait.
        then: (m,) True if the second arm may wait.
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
    """(n, m) minimum number of steps to each pair; negative if unreachable."""
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
