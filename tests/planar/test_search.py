"""Grids and their searches: nodes, floods, two levels, layers of yaw, blockers."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from arm_variants import load_variant, random_obstacles
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import assert_path, component, make_occupancy, neighbours, path_cost, shortest, slice_paths, union_mask
from studies.planar_cspace import arm_sections, joint_grid
from studies.planar_problems import random_scene

from hplan.base.arrays import BoolArray, FloatArray, IntArray, readonly
from hplan.errors import OptionError
from hplan.planar.family_reader import family_of
from hplan.planar.grid import SearchResult, dense_search, reachable_nodes, slices_with_path, two_level_search
from hplan.planar.grid.astar import bound
from hplan.planar.grid.blockers import _dilate, blockers
from hplan.planar.grid.flood import flood_slices
from hplan.planar.grid.grid import MAX_NODES, Grid, Occupancy, words_for
from hplan.planar.grid.lattice import Lattice
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.grid.prepared_obstacles import prepare_obstacles
from hplan.planar.grid.sections import LinkModel, sections_at
from hplan.planar.grid.yaw_layers import LayerCache, YawAxis, turning_occupancy, yaw_axis
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere

STEPS = [1.0, 1.0, 0.3, 2.5, 0.01]


def check(free: BoolArray, start: IntArray, goal: IntArray, step: FloatArray, *, octile: bool) -> None:
    """Everything that must hold of the searches on one mask."""
    space = make_occupancy(free, step)
    best, _ = shortest(free, start, goal, step)
    dense = dense_search(space, start, goal, octile=octile)
    two_level = two_level_search(space, start, goal, octile=octile)
    assert (dense.path is None) == (best == math.inf)
    assert (two_level.path is None) == (best == math.inf)
    if dense.path is not None and two_level.path is not None:
        assert dense.cost == pytest.approx(best, abs=1e-9)
        assert two_level.cost >= best - 1e-9
        for result in (dense, two_level):
            assert_path(free, result.path, start, goal)
            assert path_cost(result.path, step) == pytest.approx(result.cost, abs=1e-9)

    # Each slice has a shortest path if and only if a path exists.
    expected = slice_paths(free, start, goal, step)
    own = {number: path for number, path in two_level.slice_paths.items() if number in expected}
    assert own.keys() == expected.keys()
    for number, path in two_level.slice_paths.items():
        ends = [[*start[:-1], number], [*goal[:-1], number]]
        assert_path(free, path, *ends)
    for number, path in own.items():
        cost, least = path_cost(path, step), path_cost(expected[number], step)
        assert cost == pytest.approx(least, abs=1e-9)
    assert two_level.layers is not None
    searched = range(two_level.layers.first, two_level.layers.first + len(two_level.layers.begins) - 1)
    connected = slices_with_path(space, start, goal)
    for number in range(free.shape[-1]):
        here = free[(*start[:-1], number)] and component(free[..., number], start[:-1])[tuple(goal[:-1])]
        assert connected[number] == here
        assert two_level.layers.feasible[number] == (here and number in searched)

    # The sparse graph is the plain one, and its search is exact.
    union = union_mask(free, own, start, goal)
    on_union, _ = shortest(union, start, goal, step)
    assert (two_level.fallback == "none") == (on_union < math.inf)
    if two_level.fallback == "none":
        assert two_level.cost == pytest.approx(on_union, abs=1e-9)
        assert two_level.sparse_nodes == union.sum()


def random_case(
    rng: np.random.Generator, shape: tuple[int, ...], density: float
) -> tuple[BoolArray, IntArray, IntArray, FloatArray]:
    """Free mask, two free nodes, steps."""
    free = rng.random(shape) >= density
    start, goal = (np.array([rng.integers(count) for count in shape]) for _ in range(2))
    free[tuple(start)] = free[tuple(goal)] = True
    return free, start, goal, rng.choice(STEPS, len(shape))


@settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(
    shape=st.one_of(
        st.tuples(st.integers(1, 14), st.integers(1, 14)),
        st.tuples(st.integers(1, 7), st.integers(1, 7), st.integers(1, 7)),
        st.tuples(*[st.integers(1, 4)] * 4),
    ),
    density=st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.6]),
    octile=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_small_masks(shape: tuple[int, ...], density: float, octile: bool, seed: int) -> None:
    check(*random_case(np.random.default_rng(seed), shape, density), octile=octile)


@pytest.mark.parametrize("length", [62, 63, 64, 65, 130])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_word_boundaries(axis: int, length: int) -> None:
    rng = np.random.default_rng([axis, length])
    shape = [4, 4, 4]
    shape[axis] = length
    for density in (0.2, 0.45):
        free, start, goal, step = random_case(rng, tuple(shape), density)
        start[axis], goal[axis] = rng.permutation([int(rng.integers(3)), length - 1 - int(rng.integers(3))])
        free[tuple(start)] = free[tuple(goal)] = True
        check(free, start, goal, step, octile=True)


@pytest.mark.parametrize("seed", range(6))
def test_rooms_and_discs(seed: int) -> None:
    """Larger planes with walls, holes and round obstacles, where scans are long and corners many."""
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(20, 70)), int(rng.integers(20, 70)), 3)
    free = np.ones(shape, dtype=bool)
    i, j = np.indices(shape[:2])
    for number in range(shape[2]):
        for _ in range(int(rng.integers(2, 12))):
            if rng.random() < 0.5:
                along = int(rng.integers(2))
                place = int(rng.integers(shape[along]))
                wall = (i, j)[along] == place
                wall &= np.abs((j, i)[along] - int(rng.integers(shape[1 - along]))) > int(rng.integers(3))
                free[wall, number] = False
            else:
                centre, radius = rng.uniform(0, shape[:2]), rng.uniform(1, 12)
                free[(i - centre[0]) ** 2 + (j - centre[1]) ** 2 < radius**2, number] = False
    nodes = np.argwhere(free)
    start, goal = nodes[rng.integers(len(nodes), size=2)]
    start[2], goal[2] = 0, 2
    free[tuple(start)] = free[tuple(goal)] = True
    check(free, start, goal, rng.choice(STEPS, 3), octile=True)


@pytest.mark.parametrize("shape", [(30, 40), (7, 9, 70), (9, 66, 5), (4, 3, 5, 6)])
@pytest.mark.parametrize("density", [0.0, 0.4, 0.7])
def test_reachable_is_the_component(shape: tuple[int, ...], density: float) -> None:
    free, start, _, step = random_case(np.random.default_rng(len(shape)), shape, density)
    assert np.array_equal(reachable_nodes(make_occupancy(free, step), start), component(free, start))


# Slices without a path, where each kind of restoration is needed: built on purpose, in both directions


STEP = np.array([1.0, 0.7, 1.3])


def search(free: BoolArray, start: list[int], goal: list[int], *, octile: bool) -> SearchResult:
    result = two_level_search(make_occupancy(free, STEP), start, goal, octile=octile)
    best, _ = shortest(free, np.array(start), np.array(goal), STEP)
    if result.path is None:
        assert best == math.inf
    else:
        assert_path(free, result.path, np.array(start), np.array(goal))
        assert result.cost >= best - 1e-9
        if result.fallback == "dense":
            assert result.cost == pytest.approx(best, abs=1e-9)
    return result


# The bounds: admissible, consistent, and the octile one exact where no obstacle is


SPACES = [
    ((6, 7), [1.0, 1.0]),
    ((6, 7), [0.4, 1.7]),
    ((5, 4, 6), [1.0, 1.0, 1.0]),
    ((5, 4, 6), [2.0, 0.3, 1.1]),
    ((3, 4, 3, 4), [1.0, 0.5, 2.0, 0.8]),
]


def octile(lattice: Lattice, node: tuple[int, ...], goal: tuple[int, ...]) -> float:
    here, target = lattice.node(np.array(node)), lattice.node(np.array(goal))
    return float(bound(lattice.row_coordinates, lattice.step, *here, target, True))


@pytest.mark.parametrize(("shape", "step"), SPACES)
def test_octile_bound_is_exact_on_an_empty_grid(shape: tuple[int, ...], step: list[float]) -> None:
    free = np.ones(shape, dtype=bool)
    lattice = Lattice.build(shape, np.array(step))
    goal = tuple(count // 3 for count in shape)
    for node in itertools.islice(np.ndindex(shape), 0, None, 3):
        cost, _ = shortest(free, np.array(node), np.array(goal), np.array(step))
        assert octile(lattice, node, goal) == pytest.approx(cost, abs=1e-12)


@pytest.mark.parametrize(("shape", "step"), SPACES)
def test_octile_bound_is_consistent(shape: tuple[int, ...], step: list[float]) -> None:
    free = np.ones(shape, dtype=bool)
    lattice = Lattice.build(shape, np.array(step))
    goal = tuple(count - 1 for count in shape)
    assert octile(lattice, goal, goal) == 0.0
    for node in np.ndindex(shape):
        for other, move in neighbours(free, node):
            cost = float(np.linalg.norm(np.array(move) * step))
            assert octile(lattice, node, goal) <= cost + octile(lattice, other, goal) + 1e-12


# Values of the reference scene and of the paper's demonstration, and invariants of all results


START, GOAL = [0, 0, 0], [45, 60, 70]


def reference(robot: Robot, scene: Scene, model: LinkModel = "capsule") -> Occupancy:
    sections = arm_sections(robot, scene.solids, link_model=model)
    return occupancy(family_of(robot).arm, sections, joint_grid(family_of(robot).arm, np.radians(1.0)))


@pytest.fixture(scope="module")
def demonstration() -> Occupancy:
    """The paper's workspace: a ball in the middle of 21 layers."""
    grid = Grid.from_limits([0, 0, 5], [60, 60, 25], 1.0)
    mesh = np.stack(np.meshgrid(*(grid.axis(k) for k in range(3)), indexing="ij"), axis=-1)
    return Occupancy.from_mask(grid, np.linalg.norm(mesh - [30, 30, 15], axis=-1) <= 7.5)


@pytest.mark.parametrize(
    ("model", "cost", "first"),
    [("capsule", 145.2149523784, 45), ("paper", 145.2149523784, 45), ("rectangle", 143.558098, 40)],
)
def test_reference_scene(robot: Robot, scene: Scene, model: LinkModel, cost: float, first: int) -> None:
    space = reference(robot, scene, model)
    free = ~space.occupied_mask
    for octile in (True, False):
        result = two_level_search(space, START, GOAL, octile=octile)
        assert result.path is not None
        assert result.feasible_slices is not None
        assert np.degrees(result.cost) == pytest.approx(cost, abs=1e-6)
        assert len(result.path) == 107
        assert_path(free, result.path, START, GOAL)
        assert np.flatnonzero(result.feasible_slices).tolist() == list(range(first, 71))
        assert np.flatnonzero(slices_with_path(space, START, GOAL)).tolist() == list(range(first, 91))
        assert sorted(result.slice_paths) == list(range(first, 71))
        assert result.restored_slices == tuple(range(first))
        assert result.fallback == "none"


def test_workspace_demonstration(demonstration: Occupancy) -> None:
    start, goal = demonstration.grid.nearest_node([5, 10, 5]), demonstration.grid.nearest_node([55, 50, 25])
    dense = dense_search(demonstration, start, goal)
    for octile in (True, False):
        result = two_level_search(demonstration, start, goal, octile=octile)
        assert result.path is not None
        assert_path(~demonstration.occupied_mask, result.path, start, goal)
        assert len(result.slice_paths) == 21
        assert result.fallback == "none"
        assert dense.cost - 1e-9 <= result.cost <= 1.05 * dense.cost


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 6), (3, 4, 3, 5)])
@pytest.mark.parametrize("octile", [True, False])
def test_start_is_the_goal(shape: tuple[int, ...], octile: bool) -> None:
    space = make_occupancy(np.ones(shape, dtype=bool), np.ones(len(shape)))
    node = [1] * len(shape)
    for search in (two_level_search, dense_search):
        result = search(space, node, node, octile=octile)
        assert result.path is not None
        assert result.path.tolist() == [node]
        assert result.cost == 0.0


# The arm among random discs: the two levels say "no path" exactly when the dense search does


def test_two_level_agrees_with_dense_on_random_scenes(robot: Robot) -> None:
    ratios, fallbacks = [], []
    for number in range(80):
        drawn = random_scene(robot, 7, number)
        fast = two_level_search(drawn.space, drawn.start, drawn.goal)
        dense = dense_search(drawn.space, drawn.start, drawn.goal, octile=True)
        assert (fast.path is None) == (dense.path is None)
        if fast.path is not None:
            fallbacks.append(fast.fallback)
            ratios.append(fast.cost / dense.cost)
    assert 45 < len(ratios) < 80
    assert fallbacks.count("none") > 0.9 * len(ratios)
    assert np.median(ratios) < 1.001
    assert max(ratios) < 1.6


@pytest.mark.parametrize("shape", [(7,), (6, 5), (5, 6, 4), (3, 4, 3, 4)])
def test_grown_takes_in_all_neighbours(shape: tuple[int, ...]) -> None:
    mask = np.random.default_rng(0).random(shape) < 0.05
    mask[(0,) * len(shape)] = True
    expected = np.zeros(shape, dtype=bool)
    for node in np.argwhere(mask):
        expected[tuple(slice(max(0, i - 1), i + 2) for i in node)] = True
    np.testing.assert_array_equal(_dilate(mask), expected)


def test_only_obstacles_at_the_reached_region_count(robot: Robot) -> None:
    """One ball stops the upper arm; another is behind it, not adjacent to the reached region."""
    balls = [
        Sphere(name="near", center=(0.5, 0.0, 0.85), radius=0.1),
        Sphere(name="behind", center=(-1.0, 0.0, 1.6), radius=0.1),
    ]
    sections = arm_sections(robot, balls)
    grid = joint_grid(family_of(robot).arm, np.radians(3.0))
    reached = ~occupancy(family_of(robot).arm, sections, grid).occupied_mask
    reached[10:] = False  # the start's side of the near ball
    found = blockers(family_of(robot).arm, sections, grid, reached)
    assert {blocker["obstacle"] for blocker in found} == {"near"}
    assert found[0]["link"] == "upper_arm"
    assert found[0]["slices_deg"] == [0.0, 90.0]
    assert [blocker["cells"] for blocker in found] == sorted((blocker["cells"] for blocker in found), reverse=True)


def test_slices_are_those_of_the_occupied_border(robot: Robot) -> None:
    sections = arm_sections(robot, [Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.15)])
    grid = joint_grid(family_of(robot).arm, np.radians(3.0))
    free = ~occupancy(family_of(robot).arm, sections, grid).occupied_mask
    free[..., 11:] = False
    found = blockers(family_of(robot).arm, sections, grid, free)
    assert found
    for blocker in found:
        low, high = blocker["slices_deg"]
        assert 0.0 <= low <= high <= 33.0


LOWER, UPPER = -3.0, 3.0


def free_nodes(space: Occupancy) -> BoolArray:
    """One truth value for each node."""
    bits = np.unpackbits(space.free_words.view(np.uint8), axis=1, bitorder="little")
    return bits[:, : space.grid.shape[-1]].reshape(space.grid.shape).astype(bool)


@settings(max_examples=200)
@given(
    start=st.floats(LOWER, UPPER), goal=st.floats(LOWER, UPPER), step=st.floats(0.01, 1.0), beyond=st.floats(0.0, 7.0)
)
def test_the_axis_holds_start_and_goal_within_the_limits(start: float, goal: float, step: float, beyond: float) -> None:
    first, spacing, count = yaw_axis(start, goal, step, LOWER, UPPER, beyond)
    yaws = first + spacing * np.arange(count)
    assert spacing <= step * (1.0 + 1e-12)
    assert yaws[0] >= LOWER - 1e-6
    assert yaws[-1] <= UPPER + 1e-6
    assert np.abs(yaws - start).min() < 1e-6
    assert np.abs(yaws - goal).min() < 1e-6 or abs(start - goal) < 0.5 * step
    for end, towards in ((min(start, goal), -1.0), (max(start, goal), 1.0)):
        wanted = min(beyond, (UPPER - end) if towards > 0.0 else (end - LOWER))
        reached = towards * ((yaws[-1] if towards > 0.0 else yaws[0]) - end)
        assert wanted - step - 1e-6 < reached < wanted + 0.5 * step + 1e-6


@pytest.mark.parametrize("count", [1, 2, 63, 64, 65, 130])
@pytest.mark.parametrize("step", [1.0, 0.08])
def test_each_layer_is_the_planar_problem_at_its_yaw(tmp_path, count, step) -> None:
    """Grids of less than a word, and of one and more, in either direction."""
    robot = load_variant("one link on a yaw" if step < 0.1 else "upright on a yaw", tmp_path)
    bodies = prepare_obstacles(random_obstacles(np.random.default_rng(count), 9))
    planar = joint_grid(family_of(robot).arm, step)
    first, turn = -0.7, 0.03
    space = turning_occupancy(robot, bodies, planar, YawAxis(first, turn, count), layers=LayerCache())
    assert space.grid.shape == (*planar.shape, count)
    np.testing.assert_allclose(
        space.grid.coordinates(np.array([0] * len(planar.shape) + [count - 1]))[-1], first + turn * (count - 1)
    )
    free = free_nodes(space)
    assert free.any()
    for layer in range(count):
        sections = sections_at(robot, bodies, first + turn * layer)
        np.testing.assert_array_equal(free[..., layer], free_nodes(occupancy(family_of(robot).arm, sections, planar)))
    spare = np.unpackbits(space.free_words.view(np.uint8), axis=1, bitorder="little")[:, count:]
    assert not spare.any()


# Nodes


@given(st.floats(-10, 10), st.floats(1e-3, 20), st.floats(0.01, 30))
def test_first_and_last_node_are_the_limits(lower, width, step):
    grid = Grid.from_limits([lower], [lower + width], step)
    axis = grid.axis(0)
    assert axis[0] == lower
    assert axis[-1] == pytest.approx(lower + width, abs=1e-12)
    assert len(axis) == grid.shape[0] >= 2
    assert np.diff(axis).max() <= step * (1 + 1e-6)


def test_coordinates_and_places_are_inverse():
    grid = Grid.from_limits([0.0, -3.0], [1.0, 4.0], [0.1, 0.7])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1)
    coordinates = grid.coordinates(index)
    assert coordinates.shape == (11, 11, 2)
    np.testing.assert_allclose(grid.position(coordinates), index, atol=1e-12)
    np.testing.assert_array_equal(grid.nearest_node(coordinates[3, 7] + [0.049, -0.34]), [3, 7])
    np.testing.assert_array_equal(grid.nearest_node([-5.0, 99.0]), [0, 10])


@pytest.mark.parametrize(
    ("lower", "upper"), [([0.0], [-1.0]), ([0.0], [math.inf]), ([math.nan], [1.0]), ([0.0, 0.0], [1.0]), (0.0, 1.0)]
)
def test_bad_limits(lower, upper):
    with pytest.raises(OptionError, match=r"limits = .*: expected finite lower"):
        Grid.from_limits(lower, upper, 0.1)


def test_too_many_nodes():
    with pytest.raises(OptionError, match=f"at most {MAX_NODES} nodes"):
        Grid.from_limits([0.0] * 3, [1.0] * 3, 1e-3 / 2)


# Occupancy


@pytest.mark.parametrize("last", [1, 2, 63, 64, 65, 128, 129])
@pytest.mark.parametrize("before", [(), (3,), (2, 4)])
def test_mask_round_trip(before, last):
    shape = (*before, last)
    grid = Grid(readonly(np.zeros(len(shape))), readonly(np.ones(len(shape))), shape)
    mask = np.random.default_rng(last).random(shape) < 0.4
    result = Occupancy.from_mask(grid, mask)
    np.testing.assert_array_equal(result.occupied_mask, mask)
    assert result.occupied_count == mask.sum()
    assert result.free_words.shape == (math.prod(before), words_for(last))
    for index in np.ndindex(shape):
        row = int(np.ravel_multi_index(index[:-1], before)) if before else 0
        bit = (int(result.free_words[row, index[-1] // 64]) >> (index[-1] % 64)) & 1
        assert result.is_free(index) == bool(bit) == (not mask[index])


#: Slices on either side of where one word ends and the next begins, and the ends of the axis.
EDGES = (0, 62, 63, 64, 65, 127, 128, 129)


@pytest.mark.parametrize("shape", [(4, 130), (3, 4, 130), (3, 3, 3, 130), (3, 4, 64)])
def test_two_neighbours_are_joined(shape: tuple[int, ...]) -> None:
    middle = [count // 2 for count in shape[:-1]]
    for bit in (bit for bit in EDGES if bit < shape[-1]):
        first = np.array([*middle, bit])
        for move in itertools.product((-1, 0, 1), repeat=len(shape)):
            second = first + move
            if not any(move) or not (0 <= second[-1] < shape[-1]):
                continue
            free = np.zeros(shape, dtype=bool)
            free[tuple(first)] = free[tuple(second)] = True
            reached = reachable_nodes(make_occupancy(free, np.ones(len(shape))), first)
            np.testing.assert_array_equal(reached, free, err_msg=f"{first} and {second}")


@pytest.mark.parametrize("bit", EDGES)
@pytest.mark.parametrize("apart", [(2, 0, 0), (0, 2, 0), (0, 0, 2), (2, 2, 2), (1, 1, 2), (1, 2, -1)])
def test_nodes_two_apart_are_not(bit: int, apart: tuple[int, int, int]) -> None:
    shape = (4, 4, 132)
    first = np.array([1, 1, bit])
    second = first + apart
    if second[-1] < 0:
        return
    free = np.zeros(shape, dtype=bool)
    free[tuple(first)] = free[tuple(second)] = True
    reached = reachable_nodes(make_occupancy(free, np.ones(3)), first)
    assert reached.sum() == 1
    assert reached[tuple(first)]


def test_slices_are_flooded_separately() -> None:
    rng = np.random.default_rng(0)
    free = rng.random((6, 7, 130)) < 0.6
    start = np.array([2, 3, 0])
    free[2, 3] = True
    space = make_occupancy(free, np.ones(3))
    lattice = Lattice.build(space.grid.shape, space.grid.step)
    words = lattice.add_border(space.free_words)
    reached, count = flood_slices(lattice, words, lattice.row_of(start), lattice.mask(range(130)))
    bits = np.unpackbits(lattice.remove_border(reached).view(np.uint8), axis=1, bitorder="little")
    ours = bits[:, :130].reshape(free.shape).astype(bool)
    for number in range(130):
        np.testing.assert_array_equal(ours[..., number], component(free[..., number], start[:2]))
    assert count == ours.sum()
