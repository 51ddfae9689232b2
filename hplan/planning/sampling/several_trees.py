"""Several pairs of trees, of which each may find another path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hplan.base import ties
from hplan.base.arrays import FloatArray, Record, frozen
from hplan.collision.clearance_field import ClearanceField
from hplan.optimization.path_classes import PARTS, class_numbers
from hplan.optimization.shortcut import shorten
from hplan.optimization.smooth_path import START_SHORTCUTS
from hplan.planning.sampling.rrt_connect import Pairs, SamplingProblem, TreeEffort, tree_path

#: So many paths of a class are of use, as smoothing may fail.
OF_A_CLASS = 3


@dataclass(frozen=True)
class TreesEffort:
    """Effort of several pairs of trees.

    Attributes:
        each: Evaluations of the clearance by each of them, at most.
        seed: Of the first of them; those of the others follow it.
    """

    pairs: int
    each: int
    seed: int = 0


@dataclass(frozen=True, eq=False)
class PromisingPath(Record):
    """A clear path, and what it may come to, which is found when it is first asked for: beside others.

    Attributes:
        waypoints: (m, dof) its waypoints as they were found.
        field: What it is clear of.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked for wherever a motion is evaluated [m].
    """

    waypoints: FloatArray
    field: ClearanceField
    velocity: FloatArray
    margin: float

    @cached_property
    def _shorter(self) -> FloatArray:
        return shorten(self.waypoints, self.field, margin=self.margin, rounds=START_SHORTCUTS)

    @property
    def seconds(self) -> float:
        """Its time after shortcuts [s]."""
        return path_time(self._shorter, self.velocity)

    @property
    def points(self) -> FloatArray:
        """(k, dof) points of what shortcuts leave of it, at `PARTS` of its time."""
        return _evenly(self._shorter, self.velocity)


def promising_paths(
    problem: SamplingProblem,
    field: ClearanceField,
    velocity: FloatArray,
    margin: float,
    effort: TreesEffort,
    known: Sequence[PromisingPath] = (),
    grown: int = 0,
    pairs: Pairs | None = None,
) -> list[PromisingPath]:
    """Clear paths of straight motions from start to goal, the most promising of every class.

    Args:
        problem: Start, goal and joint limits.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance asked for wherever a motion is evaluated [m].
        grown: How many of the pairs have grown already, and found these.
        pairs: As `hplan.planning.sampling.rrt_connect.tree_path`.

    Returns:
        The paths, those that are known among them, the quickest first; of each class
        (`hplan.optimization.path_classes`) `OF_A_CLASS` at most.
    """
    found = list(known)
    for seed in range(grown, effort.pairs):
        each = TreeEffort(effort.each, effort.seed + seed)
        path, _ = tree_path(problem, field, velocity, margin, each, pairs=pairs)
        if path is not None:
            found.append(PromisingPath(path, field, velocity, margin))
    if len(found) < 2:
        return found
    found = [found[number] for number in ties.argsort([path.seconds for path in found]).tolist()]
    if len(found) <= OF_A_CLASS:
        return found
    number = class_numbers(np.stack([path.points for path in found]), field)
    return [path for k, path in enumerate(found) if np.count_nonzero(number[:k] == number[k]) < OF_A_CLASS]


def path_time(path: FloatArray, velocity: FloatArray) -> float:
    """About how long a motion along waypoints takes: at the velocity limits, and 0.02 s for each corner [s]."""
    return float((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1).sum() + 0.02 * (len(path) - 2))


def _evenly(path: FloatArray, velocity: FloatArray) -> FloatArray:
    """(k, dof) points of a path, at `PARTS` of its time at the velocity limits."""
    clock = np.concatenate([[0.0], np.cumsum((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1))])
    return frozen(np.stack([np.interp(PARTS * clock[-1], clock, joint) for joint in path.T], axis=1))
