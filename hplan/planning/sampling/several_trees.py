"""Paths of several pairs of trees, in several homotopy classes."""

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

#: Maximum number of paths of one homotopy class; more than one, since smoothing may fail.
OF_A_CLASS = 3


@dataclass(frozen=True)
class TreesEffort:
    """Effort of several pairs of trees.

    Attributes:
        pairs: Number of pairs.
        each: Maximum number of distance queries of each pair.
        seed: Seed of the first pair; the others have the following ones.
    """

    pairs: int
    each: int
    seed: int = 0


@dataclass(frozen=True, eq=False)
class PromisingPath(Record):
    """A collision-free path with its length after shortcuts, computed on demand.

    Attributes:
        waypoints: (m, dof) waypoints as found.
        field: The obstacles that it avoids.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance required beyond the scene's own during motions [m].
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
        """Its duration after shortcuts [s]."""
        return path_time(self._shorter, self.velocity)

    @property
    def points(self) -> FloatArray:
        """(k, dof) points of the shortened path, at `PARTS` of its duration."""
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
    """Collision-free paths from start to goal, the fastest of every class.

    Args:
        problem: Start, goal and joint limits.
        field: Arm and obstacles.
        velocity: (dof,) velocity limits [rad/s].
        margin: Clearance required beyond the scene's own during motions [m].
        effort: Number of pairs, budget and seed.
        known: Paths that are known already.
        grown: Number of pairs that have grown already and found the known paths.
        pairs: Trees that can grow on, as in `hplan.planning.sampling.rrt_connect.tree_path`.

    Returns:
        The paths, known ones included, fastest first; at most `OF_A_CLASS` of each homotopy class
        (`hplan.optimization.path_classes`).
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
    """Approximate duration of a motion along waypoints [s].

    Time at the velocity limits, plus 0.02 s for each corner.
    """
    return float((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1).sum() + 0.02 * (len(path) - 2))


def _evenly(path: FloatArray, velocity: FloatArray) -> FloatArray:
    """(k, dof) points of a path, at `PARTS` of its duration."""
    clock = np.concatenate([[0.0], np.cumsum((np.abs(np.diff(path, axis=0)) / velocity).max(axis=1))])
    return frozen(np.stack([np.interp(PARTS * clock[-1], clock, joint) for joint in path.T], axis=1))
