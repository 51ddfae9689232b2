"""RRT-Connect on the compiled clearance field: one pair of trees, and several."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from planned import problem_between

import hplan.planning.path_finder
from hplan.base.arrays import FloatArray
from hplan.base.deadline import TimeIsUpError, time_limit
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_clearance import body_slopes
from hplan.optimization.shortcut import shorten
from hplan.optimization.smooth_path import START_SHORTCUTS
from hplan.planning.growing_trees import Pairs
from hplan.planning.path_finder import (
    LongTrees,
    Path,
    Trees,
    long_trees,
    path_time,
    promising_paths,
    straight_path,
    tree_paths,
)
from hplan.planning.problem import Problem
from hplan.planning.rrt_connect import (
    EDGE_M,
    Surroundings,
    _extend,
    _find_near_bodies,
    _move_near_node,
    _slide,
    _tree,
    displacement_metric,
    tree_path,
)
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene import Box, Scene

MARGIN = 2e-4
START, GOAL = np.array([0.0, 1.2, 0.3, 0.3]), np.array([0.0, 0.1, 0.3, 0.3])


def path_of(problem: Problem, evaluations: int, seed: int = 0) -> FloatArray | None:
    return tree_path(problem, MARGIN, evaluations, seed)[0]


@pytest.fixture
def blocked(robot: Robot) -> tuple[Problem, World]:
    wall = Box(name="wall", center=(1.6, 0.0, 1.6), size=(1.2, 3.0, 0.3))
    world = World.build(robot, [wall], clearance=0.005)
    assert not world.field.is_clear(np.stack([START, GOAL]), MARGIN)
    return problem_between(world, START, GOAL), world


@pytest.mark.parametrize("seed", range(4))
def test_path_is_clear_everywhere(robot: Robot, blocked: tuple[Problem, World], seed: int) -> None:
    problem, world = blocked
    path = path_of(problem, 50_000, seed)
    assert path is not None
    assert (path[0] == problem.start).all()
    assert (path[-1] == problem.goal).all()
    assert world.field.is_clear(path, 0.5 * MARGIN)
    assert (path >= problem.lower[0] - 1e-12).all()
    assert (path <= problem.upper[0] + 1e-12).all()
    # An edge is no longer than it may be, and not of no length.
    lengths = (np.abs(np.diff(path, axis=0)) * displacement_metric(problem).weight).max(axis=1)
    assert (lengths > 0.0).all()
    assert lengths.max() <= EDGE_M * (1.0 + 1e-9)
    # coal, which shares no formula with the kernels, agrees at points in between.
    checker = CoalScene(robot, world.solids)
    dense = np.concatenate([np.linspace(a, b, 5) for a, b in itertools.pairwise(path)])
    assert min(checker.distances(q).min() for q in dense) >= 0.005


def test_nothing_is_found_through_a_plate(robot: Robot) -> None:
    """A plate in front of the shoulder, which the first link would have to pass: the trees end with their effort."""
    plate = Box(name="plate", center=(0.9, 0.0, 1.5), size=(2.0, 3.0, 0.02), rpy_deg=(0.0, -45.0, 0.0))
    world = World.build(robot, [plate])
    start, goal = np.array([0.0, 1.5, 0.1, 0.1]), np.array([0.0, 0.0, 0.1, 0.1])
    problem = problem_between(world, start, goal, locked_joints=("base_yaw",))
    assert path_of(problem, 20_000) is None


@pytest.mark.parametrize("seed", range(4))
def test_trees_grown_in_steps_equal_trees_grown_in_one_call(blocked: tuple[Problem, World], seed: int) -> None:
    problem, _ = blocked
    arguments, pairs = (problem, MARGIN), Pairs()
    at_once, used = tree_path(*arguments, 50_000, seed)
    assert at_once is not None
    for less in (used // 8, used // 4):
        path, so_far = tree_path(*arguments, less, seed, pairs=pairs)
        assert path is None
        assert so_far >= less
    (pair,) = pairs.values()
    before = int(pair.first.size[0] + pair.second.size[0])
    path, in_all = tree_path(*arguments, 50_000, seed, pairs=pairs)
    assert path is not None
    assert np.array_equal(path, at_once)
    assert in_all == used
    assert pair.first.size[0] + pair.second.size[0] > before > 2
    assert not pairs


@pytest.mark.parametrize("seed", range(3))
def test_trees_grow_on_from_another_start(blocked: tuple[Problem, World], seed: int) -> None:
    problem, world = blocked
    _, needed = tree_path(problem, MARGIN, 50_000, seed)
    pairs, budget, path, calls = Pairs(), needed // 3, None, 0
    while path is None and calls < 30:
        start = START + calls * np.array([0.002, 0.0, 0.002, 0.0])
        path, used = tree_path(problem_between(world, start, GOAL), MARGIN, budget, seed, pairs=pairs)
        assert used < 1.5 * budget
        calls += 1
    assert path is not None
    assert 2 < calls < 30
    np.testing.assert_array_equal(path[[0, -1]], [start, GOAL])
    assert world.field.is_clear(path, 0.5 * MARGIN)
    assert not pairs


def test_trees_from_a_start_out_of_sight_grow_anew_and_those_at_the_goal_on(blocked: tuple[Problem, World]) -> None:
    problem, world = blocked
    pairs = Pairs()
    assert tree_path(problem, MARGIN, 100, 0, pairs=pairs)[0] is None
    (before,) = pairs.values()
    beyond = GOAL + np.array([0.2, 0.0, 0.0, 0.0])
    assert not world.field.is_clear(np.stack([beyond, START]), MARGIN)
    tree_path(problem_between(world, beyond, GOAL), MARGIN, 100, 0, pairs=pairs)
    for pair in pairs.values():
        np.testing.assert_array_equal(pair.first.points[0], beyond)
        assert pair.second is before.second


def test_trees_of_other_joint_limits_do_not_grow_on(blocked: tuple[Problem, World]) -> None:
    problem, world = blocked
    pairs = Pairs()
    for other in (problem, problem_between(world, START, GOAL, locked_joints=("base_yaw",))):
        assert tree_path(other, MARGIN, 100, 0, pairs=pairs)[0] is None
    assert len(pairs) == 2
    turned = [np.ptp(pair.first.points[: pair.first.size[0], 0]) for pair in pairs.values()]
    assert turned[0] > 0.0 == turned[1]


def test_trees_are_kept_when_the_deadline_is_over(blocked: tuple[Problem, World]) -> None:
    problem, _ = blocked
    pairs, trees = Pairs(), list[int]()
    for _ in range(2):
        with pytest.raises(TimeIsUpError), time_limit(0.0):
            tree_path(problem, MARGIN, 50_000, 0, pairs=pairs)
        (pair,) = pairs.values()
        trees.append(int(pair.looks[0]))
    assert trees[0] > 0
    assert trees[1] <= trees[0]
    assert tree_path(problem, MARGIN, 50_000, 0, pairs=pairs)[0] is not None


def slot(robot: Robot) -> Problem:
    """A straight arm between two plates, with 1.5 mm of room on either side of its second link."""
    goal, shoulder = np.array([0.0, 0.4, 0.0, 0.0]), np.array([0.0, 0.0, 0.6])
    along = robot.forward_kinematics(goal)[:3, 3] - shoulder
    along /= np.linalg.norm(along)
    middle, normal = shoulder + 1.75 * along, np.array([-along[2], 0.0, along[0]])
    plates = [
        Box(
            name=name, center=tuple(middle + side * (0.083 / 2.0 + 0.02) * normal), size=(1.1, 0.3, 0.04),
            rpy_deg=(0.0, float(-np.degrees(np.arcsin(along[2]))), 0.0),
        )
        for name, side in (("above", 1.0), ("below", -1.0))
    ]  # fmt: skip
    return problem_between(World.build(robot, plates), np.array([0.9, 1.2, 0.6, 0.3]), goal)


def test_trapped_trees_slide_out_of_a_slot(robot: Robot) -> None:
    """Without sliding and samples near nodes, four of these five pairs need more than 20,000 distance queries."""
    problem = slot(robot)
    for seed in range(5):
        path = path_of(problem, 6_000, seed)
        assert path is not None
        assert problem.field.is_clear(path, 0.5 * MARGIN)


def test_sliding_keeps_off_the_nearest_bodies(robot: Robot) -> None:
    """Compared with NumPy at random configurations: the new node is on the way to the moved target."""
    problem, rng, slid = slot(robot), np.random.default_rng(3), 0
    metric = displacement_metric(problem)
    arm = Surroundings(metric, problem.field.arrays, MARGIN, problem.lower[0], problem.upper[0], problem.movable)
    joints = np.arange(robot.dof)
    while slid < 20:
        q = np.clip(problem.goal + rng.normal(0.0, 0.02, robot.dof), robot.lower, robot.upper)
        if problem.field.spare_clearance(q) < 1e-3:
            continue
        target = rng.uniform(robot.lower, robot.upper)
        clear, slopes = np.empty(problem.field.count), np.empty((problem.field.count, robot.dof))
        body_slopes(q, problem.field.arrays, joints, 0.05, clear, slopes)
        along = target.copy()
        for body in np.argsort(clear)[:2]:
            missing, scaled = 0.04 - clear[body] - slopes[body] @ (along - q), slopes[body] / metric.weight
            if clear[body] < 0.05 and scaled.any() and missing > 0.0:
                along += missing * scaled / metric.weight / (scaled @ scaled)
        along = np.clip(along, robot.lower, robot.upper)
        tree, other = _tree(q[None]), _tree(q[None])
        _find_near_bodies(other, 0, arm)
        node = _slide(tree, 0, target, arm, (), np.array([1_000, 0]))
        expected = _extend(other, 0, along, arm, (), np.array([1_000, 0])) if (along != target).any() else -1
        assert node == expected
        if node > 0:
            slid += 1
            assert tree.points[1] == pytest.approx(other.points[1], abs=1e-9)


def test_edges_into_an_obstacle_are_refused_once_its_gradient_is_known(robot: Robot) -> None:
    """Compared with central differences of the clearances; without known gradients nothing is refused."""
    problem, rng = slot(robot), np.random.default_rng(5)
    metric, field = displacement_metric(problem), problem.field
    arm = Surroundings(metric, field.arrays, MARGIN, problem.lower[0], problem.upper[0], problem.movable)
    refused = free = 0
    while min(refused, free) < 20:
        q = np.clip(problem.goal + rng.normal(0.0, 0.02, robot.dof), robot.lower, robot.upper)
        clear, target = field.link_clearances(q, 0.05), rng.uniform(robot.lower, robot.upper)
        if clear.min() < 1e-3 or np.partition(clear, 4)[4] < 0.05:  # of five near bodies one is not looked at
            continue
        turn = target - q
        turn *= min(1.0, metric.longest / (np.abs(turn) * metric.weight).max())
        ahead = turn * min(1.0, 25.0 * metric.shortest / (np.abs(turn) * metric.weight).max())
        step = 1e-6 * ahead
        rate = (field.link_clearances(q + step, 0.06) - field.link_clearances(q - step, 0.06)) / 2e-6
        left = np.where(clear < 0.05, clear + rate, np.inf).min() - MARGIN
        if abs(left) < 1e-5:
            continue
        tree, looks = _tree(q[None]), np.array([1_000, 0])
        _extend(tree, 0, target, arm, (), looks)
        assert looks[0] < 1_000
        tree, looks = _tree(q[None]), np.array([1_000, 0])
        _find_near_bodies(tree, 0, arm)
        node = _extend(tree, 0, target, arm, (), looks)
        if left < 0.0:
            refused += 1
            assert (node, looks[0], tree.size[0]) == (-1, 999, 1)
        else:
            # What is not refused is as without known gradients.
            free += 1
            other, again = _tree(q[None]), np.array([1_000, 0])
            assert _extend(other, 0, target, arm, (), again) == node
            assert again[0] == looks[0]


def test_gradients_are_computed_where_an_extension_has_failed(robot: Robot) -> None:
    problem, rng = slot(robot), np.random.default_rng(6)
    arm = Surroundings(
        displacement_metric(problem), problem.field.arrays, MARGIN, problem.lower[0], problem.upper[0], problem.movable
    )
    failed = np.zeros(2, dtype=np.int64)
    for _ in range(40):
        tree = _tree(problem.goal[None])
        node = _extend(tree, 0, rng.uniform(robot.lower, robot.upper), arm, (), np.array([1_000, 0]))
        failed[int(node < 0)] += 1
        assert np.isnan(tree.clear[0, 0]) == (node > 0)
        assert node < 0 or np.isnan(tree.clear[node, 0])
    assert failed.all()


def test_samples_near_nodes_are_within_their_boxes(robot: Robot) -> None:
    problem, rng = slot(robot), np.random.default_rng(4)
    arm = Surroundings(
        displacement_metric(problem), problem.field.arrays, MARGIN, problem.lower[0], problem.upper[0], problem.movable
    )
    nodes = rng.uniform(robot.lower, robot.upper, (50, robot.dof))
    tree, chosen = _tree(nodes), set[int]()
    for number in range(300):
        sample = rng.uniform(robot.lower, robot.upper)
        offset = 2.0 * (sample - robot.lower) / (robot.upper - robot.lower) - 1.0
        node = int((number * 0.6180339887498949) % 1.0 * len(nodes))
        expected = np.clip(nodes[node] + offset / 2.0 ** (number // 12 % 3), robot.lower, robot.upper)
        _move_near_node(tree, number, sample, arm)
        assert sample == pytest.approx(expected, abs=1e-12)
        chosen.add(node)
    assert len(chosen) == len(nodes)


def test_locked_joints_stay(robot: Robot, scene: Scene) -> None:
    world = World.build(robot, scene.solids, clearance=scene.clearance)
    ends = scene.start.configuration, scene.goal.configuration
    problem = problem_between(world, *ends, locked_joints=("base_yaw",))
    path = path_of(problem, 100_000)
    assert path is not None
    assert (path[:, 0] == problem.start[0]).all()


def test_of_several_each_pair_is_one_that_grows_alone(robot: Robot, blocked: tuple[Problem, World]) -> None:
    """The fastest path of every class first."""
    (problem, world), velocity = blocked, robot.velocity_limit
    grown = (path_of(problem, 50_000, seed) for seed in range(3))
    alone = [path for path in grown if path is not None]
    times = [path_time(shorten(path, world.field, margin=MARGIN, rounds=START_SHORTCUTS), velocity) for path in alone]
    paths = tree_paths(problem, 3, queries=50_000)
    shorter = (shorten(path.waypoints, world.field, margin=MARGIN, rounds=START_SHORTCUTS) for path in paths)
    assert [path_time(points, velocity) for points in shorter] == pytest.approx(sorted(times), abs=1e-9)
    assert all(any(np.array_equal(path.waypoints, other) for other in alone) for path in paths)


def with_others(problem: Problem, others: int) -> Problem:
    """The problem with an optimizer that takes at least so many paths."""
    return replace(problem, effort=replace(problem.effort, starts=replace(problem.effort.starts, others=others)))


def test_second_path_has_to_promise_a_faster_motion(
    blocked: tuple[Problem, World], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nearer the optimized motion is to its bound, the faster the second path has to be."""
    problem, finder, times = blocked[0], hplan.planning.path_finder, [1.0, 0.5, 0.9, 1.1, 3.0]
    optimized, *paths = (straight_path(problem) for _ in range(5))
    numbers = {id(path): number for number, path in enumerate(paths)}
    for is_all, factor, count in ((True, 1.0, 4), (False, 1.0, 0), (False, 1.2, 1), (False, 1.5, 2), (False, 1.7, 3)):
        along = iter(times)
        monkeypatch.setattr(finder, "path_time", lambda *_, along=along: next(along))
        chosen = with_others(problem, 4 if is_all else 0)
        found = promising_paths(chosen, paths, optimized, factor * problem.least_duration)
        assert [numbers[id(path)] for path in found] == list(range(count))


def test_paths_near_optimized_ones_are_left_out(blocked: tuple[Problem, World]) -> None:
    """The optimized path itself, and a path along which it takes as long, if its motion is near the bound."""
    problem = with_others(blocked[0], 0)
    first, least_s = tree_paths(problem, 1, queries=50_000), problem.least_duration
    assert tree_paths(problem, 1, queries=50_000, known=first, grown=1, known_s=9.0 * least_s) == []
    _, grown = tree_paths(problem, 1, queries=50_000, known=first)
    for times_bound, count in ((1.2, 0), (1.7, 1)):
        found = tree_paths(problem, 1, queries=50_000, known=first, known_s=times_bound * least_s)
        assert len(found) == count
        assert all(np.array_equal(path.waypoints, grown.waypoints) for path in found)
    assert len(tree_paths(problem, 1, queries=50_000, known=first)) == 2


@pytest.mark.parametrize("is_long", [False, True])
def test_of_two_pairs_the_faster_path_is_optimized_first_if_the_way_is_long(
    blocked: tuple[Problem, World], monkeypatch: pytest.MonkeyPatch, is_long: bool
) -> None:
    """The other one follows only if it is promising."""
    problem, times = with_others(blocked[0], 0), [5.0, 3.0]
    problem = replace(problem, effort=replace(problem.effort, long_stops_early=True, pairs=2))
    monkeypatch.setattr(hplan.planning.path_finder, "LONG_WAY", 0.0 if is_long else math.inf)
    asked = list[int]()

    def grow(_: Problem, queries: int, seed: int, __: Pairs) -> tuple[Path | None, int]:
        asked.append(seed)
        return straight_path(problem)._replace(least_s=times[len(asked) - 1]), queries

    monkeypatch.setattr(hplan.planning.path_finder, "tree_to_any", grow)
    for bound_times, more in ((1.5, [] if is_long else [3.0]), (9.0, [5.0] if is_long else [3.0])):
        asked.clear()
        finder = LongTrees()
        finder.durations, seen = np.array([math.inf]), list[float | None]()
        for (path,) in finder.paths(problem):
            assert len(asked) == 2 if is_long else len(asked) == len(seen) + 1
            seen.append(path.least_s)
            finder.durations[0] = bound_times * problem.least_duration
        assert seen == [3.0 if is_long else 5.0, *more]
    seeded = (replace(problem, effort=replace(problem.effort, seed=seed)) for seed in range(20))
    both = ((each, tree_paths(each, 1)[0], tree_paths(each, 2)[0]) for each in seeded)
    problem, of_one, of_two = next(each for each in both if not np.array_equal(each[1].waypoints, each[2].waypoints))
    finder = Trees()
    finder.durations = np.array([math.inf])
    (first,) = next(finder.paths_to(problem, 0))
    expected = of_two if is_long else of_one
    assert np.array_equal(first.waypoints, expected.waypoints)


@pytest.mark.parametrize(("times_bound", "seconds"), [(None, 2), (1.0, 0), (2.0, 1)])
def test_long_trees_grow_in_turn_until_a_motion_is_near_its_bound(
    blocked: tuple[Problem, World], monkeypatch: pytest.MonkeyPatch, times_bound: float | None, seconds: int
) -> None:
    """The second pair's trees meet; a slow motion lets one more pair grow, for about as long."""
    problem, asked = blocked[0], list[tuple[int, int]]()
    problem = replace(problem, effort=replace(problem.effort, long_stops_early=True))

    def grow(_: Problem, queries: int, seed: int, __: Pairs) -> tuple[Path | None, int]:
        asked.append((seed, queries))
        return (None if times_bound is None or seed == 0 else straight_path(problem)), 9_000

    monkeypatch.setattr(hplan.planning.path_finder, "tree_to_any", grow)
    (first, *_), queries = long_trees(problem)
    finder = LongTrees()
    finder.durations = np.array([math.inf])
    for _ in finder.paths(problem):
        assert times_bound is not None
        finder.durations[0] = times_bound * problem.least_duration
    early = queries // 3
    again = [queries, queries] if times_bound is None else [early + 13_500]
    later = [(first + number, budget) for number, budget in enumerate(again)][:seconds]
    assert asked == [(first, early), (first + 1, early), *later]


def test_further_pairs_begin_after_the_first_have_used_their_budget(
    blocked: tuple[Problem, World], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[tuple[int, int]]()

    def grow(_: Problem, queries: int, seed: int, __: Pairs) -> tuple[Path | None, int]:
        asked.append((seed, queries))
        return None, queries

    monkeypatch.setattr(hplan.planning.path_finder, "tree_to_any", grow)
    problem = replace(blocked[0], movable=np.arange(8))
    seeds, queries = long_trees(problem)
    finder = LongTrees()
    finder.durations = np.array([math.inf])
    assert not list(finder.paths(problem))
    together = problem.effort.long_pairs
    assert asked[: 2 * together] == [(seed, most) for most in (queries // 3, queries) for seed in seeds[:together]]
    assert asked[2 * together] == (seeds[together], queries // 3)
    assert len(asked) == 2 * len(seeds)


def test_more_joints_have_more_pairs(blocked: tuple[Problem, World]) -> None:
    problem = blocked[0]
    seeds = [len(long_trees(replace(problem, movable=np.arange(joints)))[0]) for joints in (6, 7, 8)]
    assert seeds[0] == seeds[1] < seeds[2]


def test_displacement_metric_bounds_the_motion_of_the_tool(blocked: tuple[Problem, World], robot: Robot) -> None:
    metric = displacement_metric(blocked[0])
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.lower, robot.upper, (200, robot.dof))
    moved = q + rng.uniform(-0.1, 0.1, q.shape)
    shift = np.linalg.norm(robot.tool_positions(q) - robot.tool_positions(moved), axis=1)
    assert (shift <= np.abs(moved - q) @ metric.weight + 1e-9).all()
    assert (metric.weight >= 0.05 * metric.weight.max()).all()
