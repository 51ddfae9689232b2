"""RRT-Connect with edges verified collision-free over continuous time.

Two rapidly-exploring random trees grow from start and goal (Kuffner and LaValle 2000, "RRT-Connect: an efficient
approach to single-query path planning"). An edge extends as far as conservative advancement verifies it, so it ends
close to the obstacle that blocks it, and no resolution has to be chosen. The cost depends on the obstacles between
start and goal, not on the joint ranges: there is no grid.

In a narrow passage nearly all extensions fail. A tree that is trapped there samples around its own nodes, and slides
along the obstacles that stop it (compare Rodriguez et al. 2006, "An obstacle-based rapidly-exploring random tree").
Most extensions fail near a node at which others have failed. Once the gradients of the clearances are known there,
edges into an obstacle are refused without a distance query.

Samples come from a seeded generator and the effort is counted in distance queries, so that the same problem gives the
same path on every machine. If no path is found, nothing is proved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hplan.base.arrays import FloatArray, IntArray, frozen
from hplan.base.deadline import check_deadline, is_up
from hplan.base.kernels import any_int, kernel
from hplan.collision.compiled_clearance import body_slopes
from hplan.collision.compiled_motions import shown_part, straight_piece
from hplan.collision.compiled_obstacles import FieldArrays
from hplan.kinematics.damped_steps import Chain, solve
from hplan.planning.growing_trees import MOST_NODES, Pair, Pairs, Tree
from hplan.planning.problem import Problem
from hplan.planning.upright_paths import upright_chain

#: Number of samples drawn at a time.
_CHUNK = 500

#: Fraction of the distance queries with which trees grow on for another start.
_AGAIN = 0.125

#: Maximum and minimum length of an edge, as displacement of the arm [m].
EDGE_M, LEAST_M = 0.3, 0.002

#: The same if the tool has to stay upright, in time at the velocity limits: straight edges between upright
#: configurations tilt it [s].
UPRIGHT_EDGE_S, _LEAST_S = 0.15, 0.002

#: Minimum weight of a joint, as a fraction of the largest: a roll of the hand displaces nearly nothing.
_LEAST_WEIGHT = 0.05

#: Maximum number of distance queries along one edge.
LOOKS = any_int(64)

#: Of this number of samples one is drawn from the box of start and goal, larger by the margin on all sides [rad], and
#: one around either of them within 1 rad, half of it, and so on, at a number of scales. More of them lead out of simple
#: problems sooner, but starve trees whose way leads far around.
_TURN, _ASIDE, _SCALES = 12, 0.6, 7

#: Fractions of failed extensions beyond which a tree slides along obstacles, and draws three of four samples around its
#: nodes, within 1 rad, half of it, and so on, at a number of scales. The fraction is a moving average; the last
#: extension has this weight.
_SLIDING, _TRAPPED, _LOCAL_SCALES, _LAST = 0.7, 0.9, any_int(3), 0.02

#: Clearance below which a body keeps off when a tree slides, and the clearance that it heads for [m]; number of bodies,
#: the nearest first; and the cost of the gradients, in distance queries.
_SLIDE_NEAR, _SLIDE_CLEAR, _SLIDE_BODIES, _SLIDE_LOOKS = 0.05, 0.04, any_int(2), any_int(3)

#: Number of bodies whose gradients are known at a node, the nearest to obstacles first. An obstacle that they predict
#: within this multiple of the minimum length of edges refuses an edge: short edges clutter the tree.
_NEAR_BODIES, _AHEAD = any_int(4), 25.0

#: Spreads consecutive numbers evenly over the nodes: the golden ratio.
_GOLDEN = 0.6180339887498949

#: Maximum distance of a sample beyond start and goals in any joint [rad, m].
_FAR_SAMPLE = 4.0 * np.pi


class Metric(NamedTuple):
    """Distances between configurations, and lengths of edges.

    Nearest nodes have the least Euclidean distance of weighted joints. The length of an edge is that of its longest
    weighted joint.

    Attributes:
        weight: (dof,) weight of each joint.
        longest: Maximum length of an edge.
        shortest: Minimum length of an edge.
    """

    weight: FloatArray
    longest: float
    shortest: float


class Surroundings(NamedTuple):
    """Arm and obstacles for the verification of edges.

    Attributes:
        metric: Distances and lengths of edges.
        field: Arm and obstacles.
        margin: Clearance required beyond the scene's own during motions [m].
        lower: (dof,) lower ends of the samples' box.
        upper: (dof,) upper ends of the samples' box.
        joints: (dof,) numbers of the joints.
    """

    metric: Metric
    field: FieldArrays
    margin: float
    lower: FloatArray
    upper: FloatArray
    joints: IntArray


def tree_path(
    problem: Problem, margin: float, evaluations: int, seed: int, *, goals: FloatArray | None = None,
    pairs: Pairs | None = None,
) -> tuple[FloatArray | None, int]:  # fmt: skip
    """A collision-free path of straight motions from start to goal.

    If the tool has to stay upright, the ends of the edges are projected onto that constraint (Berenson et al. 2009,
    "Manipulation planning on constraint manifolds"), and the edges between them are verified to keep it.

    Args:
        problem: Start, goals and the joint limits of the motion to the first goal.
        margin: Clearance required beyond the scene's own during motions [m].
        evaluations: Maximum number of distance queries, each of all links at one configuration.
        seed: Seed of the samples.
        goals: (k, dof) alternative goals, whichever is reached first; None for the problem's first goal.
        pairs: Pairs of trees to the same goals that have not met yet. This pair grows on with what is left of the
            budget, or from another start with a part of it, and stays there if its trees do not meet, also after a
            deadline. None to start from the roots.

    Returns:
        (m, dof) waypoints, m >= 2, or None if no path was found; and the number of distance queries.

    Raises:
        TimeIsUpError: The deadline has passed.
    """
    ends = np.array(problem.goal[None] if goals is None else goals)
    key = seed, margin, id(problem.field), b"".join(part.tobytes() for part in (ends, problem.lower, problem.upper))
    known = None if pairs is None else pairs.pop(key, None)
    chain = upright_chain(problem)
    metric = displacement_metric(problem) if len(chain) == 0 else upright_metric(problem)
    joints = frozen(np.arange(len(problem.start)))
    arm = Surroundings(metric, problem.field.arrays, margin, *_sample_box(problem, ends), joints)
    if known is None:
        generator, nothing = np.random.Generator(np.random.PCG64(seed)), np.zeros((0, len(problem.start)))
        looks = np.zeros(2, dtype=np.int64)
        known = Pair(_tree(problem.start[None]), _tree(ends), generator, nothing, looks, 0, problem.field)
    first, second, generator, samples, looks, before, _ = known
    given = evaluations
    looks[0] += max(0, evaluations - before)
    if (first.points[_root(first)] != problem.start).any():
        looks[0] += round(_AGAIN * evaluations)
        given, first = int(looks[0]), _from_start(first, problem, margin)
    path = None
    try:
        while path is None and looks[0] > 0 and max(first.size[0], second.size[0]) < MOST_NODES - _CHUNK:
            if looks[1] == len(samples):
                samples, looks[1] = _samples(generator, problem, ends, arm), 0
            joined = _grow(samples, first, second, arm, chain, looks)
            check_deadline()
            if joined[0] >= 0:
                there = np.concatenate([_branch(first, int(joined[0]))[::-1], _branch(second, int(joined[1]))])
                path = frozen(there[np.append(True, (np.diff(there, axis=0) != 0.0).any(axis=1))])
    finally:
        if path is None and pairs is not None:
            pairs[key] = Pair(first, second, generator, samples, looks, max(before, evaluations), problem.field)
    return path, given - int(looks[0])


def _from_start(tree: Tree, problem: Problem, margin: float) -> Tree:
    """The tree with the problem's start as its root if the way from there to its root is clear, else a new one."""
    size, root = int(tree.size[0]), _root(tree)
    if size == MOST_NODES or not problem.field.is_clear(np.stack([problem.start, tree.points[root]]), margin):
        return _tree(problem.start[None])
    tree.points[size], tree.clear[size] = problem.start, np.nan
    tree.parents[root] = tree.parents[size] = size
    tree.size[0] += 1
    return tree


def displacement_metric(problem: Problem) -> Metric:
    """Weights by which distances bound the displacement of any point of the arm [m].

    Clearance is used up by displacement, whatever time a joint takes: a slow torso is no farther away than a shoulder,
    and turns of the hand are near.
    """
    field = problem.field
    weight = field.reaches[: len(field.arrays.bodies)].max(axis=0)
    return Metric(frozen(np.maximum(weight, _LEAST_WEIGHT * weight.max())), EDGE_M, LEAST_M)


def upright_metric(problem: Problem) -> Metric:
    """Weights by which distances are times at the velocity limits [s]: turns of the hand tilt it, too."""
    return Metric(frozen(1.0 / problem.robot.velocity_limit), UPRIGHT_EDGE_S, _LEAST_S)


def _sample_box(problem: Problem, goals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper ends of the samples' box, (dof,) each: the joint limits, at most `_FAR_SAMPLE` away."""
    first, last = np.minimum(problem.start, goals.min(axis=0)), np.maximum(problem.start, goals.max(axis=0))
    lower, upper = np.maximum(problem.lower[0], first - _FAR_SAMPLE), np.minimum(problem.upper[0], last + _FAR_SAMPLE)
    return frozen(lower), frozen(upper)


def _samples(generator: np.random.Generator, problem: Problem, goals: FloatArray, arm: Surroundings) -> FloatArray:
    """(_CHUNK, dof) samples: anywhere, some near start and goals.

    Of `_TURN` samples one is in the box of start and goals, and one around start or a goal at all scales.
    """
    first, last = np.minimum(problem.start, goals.min(axis=0)), np.maximum(problem.start, goals.max(axis=0))
    lower, upper = arm.lower, arm.upper
    samples: FloatArray = generator.random((_CHUNK, len(lower)))
    low, high = np.maximum(first - _ASIDE, lower), np.minimum(last + _ASIDE, upper)
    between, around = slice(_TURN // 3, None, _TURN), slice(2 * _TURN // 3, None, _TURN)
    inside, offset = low + samples[between] * (high - low), 2.0 * samples[around] - 1.0
    chosen = goals[generator.integers(0, len(goals), len(offset))]
    about = np.where(generator.random((len(chosen), 1)) < 0.5, problem.start, chosen)
    scale = np.ldexp(1.0, -generator.integers(0, _SCALES, (len(chosen), 1)))
    samples = lower + samples * (upper - lower)
    samples[between], samples[around] = inside, np.clip(about + scale * offset, lower, upper)
    return samples


def _tree(roots: FloatArray) -> Tree:
    """A tree with roots alone, each its own parent."""
    count, dof = roots.shape
    parents, size = np.zeros(MOST_NODES, dtype=np.int64), np.array([count], dtype=np.int64)
    near = MOST_NODES, int(_NEAR_BODIES)
    tree = Tree(np.empty((MOST_NODES, dof)), parents, size, np.zeros(1), np.empty(near), np.empty((*near, dof)))
    tree.points[:count], tree.parents[:count], tree.clear[:count] = roots, np.arange(count), np.nan
    return tree


def _branch(tree: Tree, node: int) -> FloatArray:
    """Configurations from a node to its root."""
    nodes = [node]
    while (parent := int(tree.parents[nodes[-1]])) != nodes[-1]:
        nodes.append(parent)
    return np.array(tree.points[nodes])


def _root(tree: Tree) -> int:
    """Number of the root of a tree's first node."""
    node = 0
    while tree.parents[node] != node:
        node = int(tree.parents[node])
    return node


@kernel
def _grow(
    samples: FloatArray, first: Tree, second: Tree, arm: Surroundings, chain: Chain | tuple[()], looks: IntArray
) -> IntArray:
    """Grow both trees by samples; the nodes where they meet."""
    joined = np.full(2, -1, dtype=np.int64)
    while looks[1] < samples.shape[0] and looks[0] > 0 and not is_up(arm.field.until):
        s = looks[1]
        looks[1] += 1
        forward = first.size[0] <= second.size[0]
        tree, towards = (first, second) if forward else (second, first)
        sample = samples[s]
        if tree.failed[0] > _TRAPPED and s % (_TURN // 3) != 0:
            _move_near_node(tree, s, sample, arm)
        near = _nearest_node(tree, sample, arm)
        new = _extend(tree, near, sample, arm, chain, looks)
        if tree.failed[0] > _SLIDING:
            slid = _slide(tree, new if new >= 0 else near, sample, arm, chain, looks)
            new = slid if slid >= 0 else new
        tree.failed[0] += _LAST * ((1.0 if new < 0 else 0.0) - tree.failed[0])
        if new < 0:
            continue
        target = tree.points[new]
        here = _nearest_node(towards, target, arm)
        while (
            here >= 0
            and not is_up(arm.field.until)
            and _edge_length(towards.points[here], target, arm.metric.weight) > 0.0
        ):
            here = _extend(towards, here, target, arm, chain, looks)
        if here >= 0:
            joined[0], joined[1] = (new, here) if forward else (here, new)
            break
    return joined


@kernel
def _move_near_node(tree: Tree, number: int, sample: FloatArray, arm: Surroundings) -> None:
    """Move a sample of the whole joint range into a box around a node, chosen by the sample's number."""
    node = tree.points[int((number * _GOLDEN) % 1.0 * tree.size[0])]
    scale = 0.5 ** (number // _TURN % _LOCAL_SCALES)
    for i in range(len(sample)):
        lower, upper = arm.lower[i], arm.upper[i]
        if upper > lower:
            offset = 2.0 * (sample[i] - lower) / (upper - lower) - 1.0
            sample[i] = min(upper, max(lower, node[i] + scale * offset))


@kernel
def _slide(
    tree: Tree, node: int, target: FloatArray, arm: Surroundings, chain: Chain | tuple[()], looks: IntArray
) -> int:
    """Extend a tree from a node toward a target, along the nearest obstacles; the new node, or -1.

    The target is moved by as little as possible, to first order, so that the bodies nearest to the obstacles get clear
    of them.
    """
    q, weight = tree.points[node], arm.metric.weight
    dof = len(q)
    along = np.empty(dof)
    _find_near_bodies(tree, node, arm)
    looks[0] -= _SLIDE_LOOKS
    for i in range(dof):
        along[i] = target[i]
    is_moved = False
    for body in range(_SLIDE_BODIES):
        clear, slope = tree.clear[node, body], tree.slopes[node, body]
        missing, square = _SLIDE_CLEAR - clear, 0.0
        for i in range(dof):
            missing -= slope[i] * (along[i] - q[i])
            square += (slope[i] / weight[i]) ** 2
        if clear < _SLIDE_NEAR and square > 0.0 and missing > 0.0:
            is_moved = True
            for i in range(dof):
                along[i] += missing * slope[i] / weight[i] ** 2 / square
    for i in range(dof):
        along[i] = min(arm.upper[i], max(arm.lower[i], along[i]))
    return _extend(tree, node, along, arm, chain, looks) if is_moved else -1


@kernel
def _find_near_bodies(tree: Tree, node: int, arm: Surroundings) -> None:
    """Write the clearances of the bodies nearest to obstacles at a node, and their gradients, unless they are known."""
    if not math.isnan(tree.clear[node, 0]):
        return
    q, field = tree.points[node], arm.field
    count, dof = len(field.bodies) + len(field.pairs), len(q)
    clear, slopes = np.empty(count), np.empty((count, dof))
    body_slopes(q, field, arm.joints, _SLIDE_NEAR, clear, slopes)
    for body in range(_NEAR_BODIES):
        nearest = int(np.argmin(clear))
        tree.clear[node, body] = clear[nearest]
        for i in range(dof):
            tree.slopes[node, body, i] = slopes[nearest, i]
        clear[nearest] = np.inf


@kernel
def _is_blocked(tree: Tree, node: int, end: FloatArray, length: float, arm: Surroundings) -> bool:
    """True if, by the gradients that are known at a node, an edge of a length soon meets an obstacle (`_AHEAD`)."""
    if math.isnan(tree.clear[node, 0]):
        return False
    start, part = tree.points[node], min(1.0, _AHEAD * arm.metric.shortest / length)
    for body in range(_NEAR_BODIES):
        slope, lost = tree.slopes[node, body], 0.0
        for i in range(len(end)):
            lost -= slope[i] * (end[i] - start[i])
        if lost > 0.0 and tree.clear[node, body] - arm.margin < part * lost:
            return True
    return False


@kernel
def _nearest_node(tree: Tree, target: FloatArray, arm: Surroundings) -> int:
    """The node nearest to a target, by the metric.

    The first of several with the same distance.
    """
    nearest, least, weight = 0, np.inf, arm.metric.weight
    for n in range(tree.size[0]):
        square = 0.0
        for i in range(len(target)):
            square += ((tree.points[n, i] - target[i]) * weight[i]) ** 2
        if square < least:
            nearest, least = n, square
    return nearest


@kernel
def _extend(
    tree: Tree, node: int, target: FloatArray, arm: Surroundings, chain: Chain | tuple[()], looks: IntArray
) -> int:
    """Extend a tree toward a target; the new node, or -1.

    The edge ends at the last verified configuration. With a chain its end is first projected onto the constraint, at a
    distance of at most half of the step. An edge that is refused by gradients counts as one distance query.
    """
    if tree.size[0] >= tree.points.shape[0]:
        return -1
    dof = len(target)
    start = tree.points[node]
    end = np.empty(dof)
    weight, shortest = arm.metric.weight, arm.metric.shortest
    length = _edge_length(start, target, weight)
    part = min(1.0, arm.metric.longest / length) if length > 0.0 else 1.0
    for i in range(dof):
        end[i] = target[i] if part == 1.0 else start[i] + part * (target[i] - start[i])
    if len(chain) > 0 and (not solve(chain, end) or _edge_length(end, target, weight) > length * (1.0 - 0.5 * part)):
        return -1
    if length > 0.0 and _is_blocked(tree, node, end, part * length, arm):
        looks[0] -= 1
        return -1
    least = 0.5 * shortest / (part * length) if length > 0.0 else 0.0
    shown, used = shown_part(straight_piece(start, end), arm.field, arm.margin, least, LOOKS)
    looks[0] -= used
    if shown * part * length < shortest and not (shown == 1.0 and part == 1.0):
        _find_near_bodies(tree, node, arm)
        return -1
    new = int(tree.size[0])
    for i in range(dof):
        tree.points[new, i] = end[i] if shown == 1.0 else start[i] + shown * (end[i] - start[i])
    tree.parents[new], tree.clear[new, 0] = node, math.nan
    tree.size[0] = new + 1
    return new


@kernel
def _edge_length(start: FloatArray, end: FloatArray, weight: FloatArray) -> float:
    """Length of an edge: that of its longest weighted joint."""
    length = 0.0
    for k in range(len(start)):
        length = max(length, abs(end[k] - start[k]) * weight[k])
    return length
