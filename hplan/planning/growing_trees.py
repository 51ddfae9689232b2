"""Trees of searches, which can grow on in later ones."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.base.arrays import FloatArray, IntArray
from hplan.collision.compiled_field import ClearanceField

#: Maximum number of nodes of a tree.
MOST_NODES = 20_000


class Tree(NamedTuple):
    """Nodes of one tree.

    Attributes:
        points: (capacity, dof) configurations.
        parents: (capacity,) numbers of the parent nodes.
        size: (1,) number of nodes.
        failed: (1,) moving average of the fraction of failed extensions toward samples.
        clear: (capacity, bodies) clearances of the bodies nearest to obstacles at a node, the nearest first; the first
            is NaN as long as no extension from the node has failed [m].
        slopes: (capacity, bodies, dof) their gradients [m/rad, m/m].
    """

    points: FloatArray
    parents: IntArray
    size: IntArray
    failed: FloatArray
    clear: FloatArray
    slopes: FloatArray


class Pair(NamedTuple):
    """Two trees that have not met yet and can grow on.

    Attributes:
        first: The tree at the start.
        second: The tree at the goals.
        generator: Generator of the samples.
        samples: The current samples; those before the second entry of `looks` are used up.
        looks: (2,) remaining distance queries, and number of the next sample.
        evaluations: Total budget of distance queries up to now.
        field: Arm and obstacles among which they have grown.
    """

    first: Tree
    second: Tree
    generator: np.random.Generator
    samples: FloatArray
    looks: IntArray
    evaluations: int
    field: ClearanceField


#: Pairs by seed, margin, identity of the field, and both goals and joint limits.
Pairs: TypeAlias = dict[tuple[int, float, int, bytes], Pair]
