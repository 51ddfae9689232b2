"""Duration bounds: exact in known cases, below all certified motions; their parts.

The parts are joints, cells and searches.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planned import fruit, post, problem_between, task
from scipy.optimize import linprog
from studies.planar_problems import random_scene

import hplan.planning.lower_bound.duration_bound as module
from hplan.apps.cli.main import main
from hplan.base.arrays import BoolArray, FloatArray
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.collision.coal_scene import CoalScene
from hplan.errors import BoundError, HplanError
from hplan.planning.lower_bound.cells import Samples, is_reachable
from hplan.planning.lower_bound.duration_bound import (
    DurationBound,
    _excess,
    _joint_motions,
    _obstacles,
    duration_bound,
)
from hplan.planning.lower_bound.grid_search import GridSearch, TimedGrid
from hplan.planning.lower_bound.joint_tubes import JointMotions
from hplan.planning.motion import motion_limits
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.planning.world import World
from hplan.robot.limits import Limits, rest_to_rest
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere

BOUND = PlanOptions(bound=True)


def bound_of(result: PlanResult, duration_s: float | None = None) -> DurationBound:
    """The bound for the transit of a plan, by itself."""
    motion = result.motion
    duration = motion.trajectory.duration if duration_s is None else duration_s
    return duration_bound(motion.problem.world, motion.problem, motion_limits(motion.problem), duration)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds on coarse grids alone, which take a tenth of the time."""
    monkeypatch.setattr(module, "SAMPLES", ((48, 0.01),))


def tolerated(distance: float, velocity: float, acceleration: float, jerk: float | None) -> float:
    """Duration of a joint's fastest motion within the certificate's tolerances."""
    limits = [None if limit is None else LIMIT_TOLERANCE * limit for limit in (velocity, acceleration, jerk)]
    return rest_to_rest(np.array([distance]), *limits).item()


def test_reference_motion_is_near_its_bound(robot: Robot, scene: Scene) -> None:
    result = plan(robot, scene, BOUND)
    bound = result.bound
    assert bound is not None
    assert bound.method == "planar"
    assert 1.70 < bound.seconds < 1.752 < bound.duration_s  # 1.752 s: the fastest certified motion that is known
    assert bound.joints_s < 0.65 * bound.seconds
    assert result.report["bound"] == {
        "phases": ["transit"],
        "bound_s": bound.seconds,
        "duration_s": result.trajectory.duration,
        "gap": bound.duration_s / bound.seconds - 1.0,
        "method": "planar",
        "joint": bound.joint,
        "joints_s": bound.joints_s,
    }
    assert list(result.report["time_ms"]).index("bound") < list(result.report["time_ms"]).index("export")


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_one_joint_alone_is_bounded_by_its_own_fastest_motion(robot: Robot, joint: int) -> None:
    goal = np.zeros(4)
    goal[joint] = 60.0
    far = [post("far", 180.0, 2.0, 0.0, 1.0)]
    bound = plan(robot, task([0, 0, 0, 0], goal, far, locked_joints=("base_yaw",)), BOUND).bound
    limits = robot.velocity_limit[joint], robot.acceleration_limit[joint], robot.jerk_limit[joint]
    exact = tolerated(np.radians(60.0), *limits)
    assert bound is not None
    assert bound.joint == robot.joint_names[joint]
    assert 0.9999 * exact < bound.seconds <= exact
    assert bound.gap < 0.02


def test_base_counts_by_its_own_fastest_motion_with_jerk(robot: Robot) -> None:
    scene = task([0, 10, 10, 10], [90, 40, 20, 30], [post("trunk", 45.0, 1.6, 0.0, 1.2)])
    bounds = [plan(arm, scene, BOUND).bound for arm in (robot, replace(robot, jerk_limit=None))]
    limits = robot.velocity_limit[0], robot.acceleration_limit[0]
    for bound, jerk in zip(bounds, (robot.jerk_limit[0], None), strict=True):
        assert bound is not None
        assert (bound.method, bound.joint) == ("joints", "base_yaw")
        exact = tolerated(0.5 * np.pi, *limits, jerk)
        assert 0.9999 * exact < bound.seconds <= exact


def test_wall_that_all_joints_have_to_pass_is_seen_where_the_base_turns(robot: Robot) -> None:
    wall = Box(name="wall", center=(1.3, 0.0, 1.2), size=(1.6, 0.3, 2.4))
    bound = plan(robot, task([-25, 30, 40, 30], [25, 30, 40, 30], [wall]), BOUND).bound
    assert bound is not None
    assert bound.method == "spatial"
    assert bound.joints_s < 0.7 * bound.seconds
    assert bound.gap < 0.15


def test_motion_that_is_too_fast_to_exist_is_an_error(robot: Robot, scene: Scene) -> None:
    result = plan(robot, scene)
    for duration in (1.0, 1.4):  # by the slowest joint alone, by reachability
        with pytest.raises(BoundError, match="excludes") as error:
            bound_of(result, duration)
        assert error.value.duration_s == duration


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("locked", [(), ("base_yaw",)])
def test_transit_and_approach_are_bounded_together_where_one_flows_into_the_other(
    robot: Robot, locked: tuple[str, ...]
) -> None:
    yaw = 0.0 if locked else 40.0
    scene = task([0, 10, 20, 10], Goal(fruit="apple"), fruits=(fruit("apple", yaw, 1.5, 1.5),), locked_joints=locked)
    result = plan(robot, scene, BOUND)
    flows = np.abs(result.motion.trajectory.velocity[-1]).max() > 0.0
    assert [phase.name for phase in result.phases] == ["transit", "approach", "retreat"]
    assert result.report["bound"]["phases"] == ["transit", "approach"][: 2 if flows else 1]
    ends = result.phases[1 if flows else 0].end_s
    assert result.bound is not None
    assert result.bound.duration_s == pytest.approx(ends)
    assert 0.0 < result.bound.gap < 1.0


@pytest.mark.usefixtures("coarse")
@settings(max_examples=16, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.03]), st.sampled_from([None, 0.0, 0.4]))
def test_no_certified_motion_is_below_its_bound(number: int, clearance: float, yaw: float | None) -> None:
    robot = load_robot()
    scene = random_scene(robot, 7, number).scene.model_copy(update={"clearance": clearance})
    if yaw is not None:
        goal = Goal(joints_rad=(yaw, *scene.goal.configuration[1:].tolist()))
        scene = scene.model_copy(update={"goal": goal, "locked_joints": ()})
    try:
        result = plan(robot, scene, BOUND)
    except BoundError:
        raise
    except HplanError:
        return
    assert result.bound is not None
    assert 0.0 < result.bound.joints_s <= result.bound.seconds <= result.trajectory.duration


@pytest.mark.usefixtures("coarse")
def test_command_reports_ratio_to_duration_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--bound", "--out", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    bound = json.loads((tmp_path / "report.json").read_text())["bound"]
    percents = float(said.partition("at most ")[2].partition(" %")[0])
    assert bound["gap"] <= percents / 100.0 < bound["gap"] + 0.002
    assert f"no motion is shorter than {bound['bound_s']:.3f} s" in said


def joint(goal: float, velocity: float, acceleration: float, jerk: float = np.inf, *, wide: float = 100.0):
    """One joint that moves from 0."""
    values = {"start": 0.0, "goal": goal, "lower": -wide, "upper": wide}
    limits = {"velocity": velocity, "acceleration": acceleration, "jerk": jerk}
    return JointMotions(**{name: np.array([value]) for name, value in (values | limits).items()})


def largest_place(motion: JointMotions, total: float, when: int, pieces: int = 60) -> float:
    """The maximum position at a sample by linear programming, with piecewise constant jerk.

    A subset of all motions, so that it is a lower bound of the maximum.
    """
    h = total / pieces
    state, rows = np.zeros((3, pieces)), [np.zeros((3, pieces))]  # position, velocity, acceleration over the jerks
    for k in range(pieces):
        q, v, a = state
        jerk = np.eye(pieces)[k]
        state = np.array([q + h * v + h * h / 2 * a + h**3 / 6 * jerk, v + h * a + h * h / 2 * jerk, a + h * jerk])
        rows.append(state)
    table = np.array(rows)
    limits = np.array([motion.velocity[0], motion.acceleration[0]])
    most = np.concatenate([table[:, 1], -table[:, 1], table[:, 2], -table[:, 2]])
    bounds = np.repeat(limits, 2 * (pieces + 1))
    jerk = motion.jerk[0] if np.isfinite(motion.jerk[0]) else None
    found = linprog(
        -table[when, 0],
        A_ub=most,
        b_ub=bounds,
        A_eq=table[-1],
        b_eq=[motion.goal[0], 0.0, 0.0],
        bounds=(None if jerk is None else -jerk, jerk),
    )
    return float(-found.fun) if found.success else -np.inf


@pytest.mark.parametrize("jerk", [np.inf, 40.0, 8.0])
@pytest.mark.parametrize("goal", [0.8, 0.2, 0.0])
def test_places_hold_the_optima_and_are_near_them(goal: float, jerk: float) -> None:
    motion = joint(goal, 1.2, 3.0, jerk)
    total = 1.15 * max(float(motion.least_durations[0]), 0.9)
    for when in (3, 10, 25, 40, 55):
        lower, upper = (end.item() for end in motion.places(np.array([[when / 60.0 * total]]), total))
        top = largest_place(motion, total, when)
        bottom = goal - largest_place(motion, total, 60 - when)  # the motion turned about its middle
        assert lower <= bottom + 1e-6
        assert top - 1e-6 <= upper
        assert upper - top < (0.02 if jerk > 30.0 else 0.12)


def profile(draws: FloatArray, velocity: float, acceleration: float) -> tuple[FloatArray, FloatArray]:
    """Times and positions of a motion from rest to rest that is made of drawn accelerations."""
    h = 0.02
    speeds = [0.0]
    for push in draws:
        speeds.append(float(np.clip(speeds[-1] + h * push * acceleration, -velocity, velocity)))
    while abs(speeds[-1]) > 0.0:
        speeds.append(float(np.sign(speeds[-1]) * max(0.0, abs(speeds[-1]) - h * acceleration)))
    v = np.array(speeds)
    q = np.concatenate([[0.0], np.cumsum(0.5 * h * (v[1:] + v[:-1]))])
    return h * np.arange(len(v)), q


@given(st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=80), st.floats(0.2, 3.0), st.floats(0.5, 10.0))
def test_any_motion_is_within_its_bounds(draws: list[float], velocity: float, acceleration: float) -> None:
    time, q = profile(np.sign(draws) * np.sqrt(np.abs(draws)), velocity, acceleration)
    motion, total = joint(float(q[-1]), velocity, acceleration), float(time[-1])
    assert motion.least_durations[0] <= total + 1e-9
    lower, upper = motion.places(time[:, None], total)
    assert (lower[:, 0] <= q + 1e-12).all()
    assert (q <= upper[:, 0] + 1e-12).all()


def test_motion_that_is_just_too_short_is_excluded_by_its_own_bounds() -> None:
    motion = joint(1.0, 1.2, 3.0)
    least = float(rest_to_rest(np.ones(1), 1.2, 3.0)[0])
    time = np.linspace(0.0, 1.0, 21)[:, None]
    lower, upper = motion.places(least * time, least)
    assert (lower <= upper).all()
    lower, upper = motion.places(0.999 * least * time, 0.999 * least)
    assert (lower > upper).any()


def bits(search: GridSearch) -> BoolArray:
    """(counts) True for cells that are not excluded."""
    words = search.free.view(np.uint8)
    found = np.unpackbits(words, axis=-1, bitorder="little")[..., : search.grid.counts[0]]
    return np.moveaxis(found, -1, 0).astype(np.bool_)


def search_of(
    robot: Robot, scene: Scene, order: list[int], longest: float, samples: int
) -> tuple[GridSearch, JointMotions]:
    """The search over a grid of some joints, and the motions of all joints."""
    world = World.of_scene(robot, scene, PlanOptions())
    ends = scene.start.configuration, scene.goal.configuration
    problem = problem_between(world, *ends, locked_joints=scene.locked_joints)
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, jerk=robot.jerk_limit)
    motions, obstacles = _joint_motions(world, problem, limits), _obstacles(world)
    grid = TimedGrid.build(motions.select(order), longest, samples)
    search = GridSearch.build(obstacles, _excess(robot, obstacles), motions, np.array(order), grid)
    return search, motions


def configurations(
    search: GridSearch, joints: list[int], cells: FloatArray, others: tuple[FloatArray, FloatArray], seed: int
) -> FloatArray:
    """Configurations at places counted in cells along the axes, other joints anywhere in their ranges."""
    q = np.random.default_rng(seed).uniform(*others, (len(cells), len(others[0])))
    q[:, joints] = (search.grid.lower + cells * search.grid.sizes)[:, : len(joints)]
    return q


OBSTACLES = {
    "sphere": Sphere(name="a", center=(1.0, 0.0, 1.9), radius=0.15),
    "capsule": Capsule(name="a", start=(0.9, -0.5, 1.5), end=(1.2, 0.6, 1.9), radius=0.06),
    "cylinder": Cylinder(name="a", center=(1.1, 0.0, 1.7), length=0.3, radius=0.1, rpy_deg=(20.0, 40.0, 0.0)),
    "box": Box(name="a", center=(1.2, 0.0, 1.6), size=(0.3, 0.4, 0.2), rpy_deg=(10.0, 20.0, 30.0)),
}


@pytest.mark.parametrize(
    ("kind", "first"), [("sphere", 0), ("capsule", 1), ("cylinder", 2), ("box", 0), ("sphere", 1), ("box", 2)]
)
def test_excluded_cells_are_in_contact_whole_and_most_others_are_not(robot: Robot, kind: str, first: int) -> None:
    scene = task([0, 5, 5, 5], [0, 80, 85, 85], [OBSTACLES[kind]], locked_joints=("base_yaw",), clearance=0.01)
    order = [first + 1, *(k + 1 for k in range(3) if k != first)]
    search, motions = search_of(robot, scene, order, 2.5, 60)
    free, in_contact = excluded_are_in_contact(robot, scene, (search, motions, order), 2.5, 0.02)
    assert free.mean() > 0.1
    assert in_contact < 0.25  # those at the surface


@pytest.mark.parametrize(("kind", "first"), [("sphere", 0), ("capsule", 1), ("box", 1), ("cylinder", 2)])
def test_excluded_cells_are_in_contact_with_turning_base(robot: Robot, kind: str, first: int) -> None:
    scene = task([-20, 5, 5, 5], [20, 80, 85, 85], [OBSTACLES[kind]], clearance=0.01)
    order = [first, *(k for k in range(4) if k != first)][:3]
    search, motions = search_of(robot, scene, order, 2.5, 64)
    excluded_are_in_contact(robot, scene, (search, motions, order), 2.5, 0.0005)


def test_excluded_cells_are_in_contact_for_all_free_joints(robot: Robot) -> None:
    shelf = Box(name="shelf", center=(1.9, 0.0, 0.9), size=(1.6, 2.0, 0.9))
    scene = task([-2, 40, 5, 5], [2, 60, 20, 10], [shelf], clearance=0.01)
    search, motions = search_of(robot, scene, [1, 2], 1.6, 60)
    excluded_are_in_contact(robot, scene, (search, motions, [1, 2]), 1.6, 0.01)


def test_excluded_cells_are_in_contact_for_arm_of_meshes() -> None:
    """Its depths are between hulls, and some joints have no axis."""
    arm, order = load_robot("panda"), [0, 1, 3]
    start, goal = (tuple(np.radians(q)) for q in ([-10, 20, 0, -90, 0, 100, 0], [10, 25, 5, -80, 5, 105, 5]))
    board = Box(name="board", center=(0.4, 0.0, 1.0), size=(0.8, 0.5, 0.5))
    scene = Scene(name="board", start=Start(joints_rad=start), goal=Goal(joints_rad=goal), obstacles=(board,))
    search, motions = search_of(arm, scene, order, 0.6, 48)
    excluded_are_in_contact(arm, scene, (search, motions, order), 0.6, 0.01)


def excluded_are_in_contact(
    robot: Robot, scene: Scene, found: tuple[GridSearch, JointMotions, list[int]], longest: float, least: float
) -> tuple[BoolArray, float]:
    """Excluded cells that coal does not confirm, and the fraction in contact."""
    search, motions, order = found
    free, random = bits(search), np.random.default_rng(order[0])
    checker, others = CoalScene(robot, scene.solids), motions.ranges(longest, 30)
    excluded = np.argwhere(~free)
    assert least * free.size < len(excluded) < 0.9 * free.size
    some = excluded[random.integers(len(excluded), size=300)]
    corner = np.round(random.uniform(size=(300, 3)) * 2.0) / 2.0  # corners and middles of edges, faces and the cell
    q = configurations(search, order, some + np.clip(corner, 1e-6, 1.0 - 1e-6), others, 1)
    assert all(checker.distances(one).min() < scene.clearance for one in q)
    kept = np.argwhere(free)
    middles = configurations(search, order, kept[random.integers(len(kept), size=300)] + 0.5, others, 2)
    return free, float(np.mean([checker.distances(one).min() < scene.clearance for one in middles]))


def test_no_obstacle_is_taken_for_larger_than_it_is(robot: Robot) -> None:
    """Least of all a cylinder, which the kernels enclose in a prism."""
    random = np.random.default_rng(9)
    for solid in OBSTACLES.values():
        scene = task([0, 5, 0, 0], [0, 80, 5, 5], [solid], clearance=0.01)
        field, checker = _obstacles(World.of_scene(robot, scene, PlanOptions())), CoalScene(robot, scene.solids)
        for q in random.uniform(robot.lower, robot.upper, (200, 4)) * [0.05, 1.0, 1.0, 1.0]:
            apart = checker.distances(q)[:, 0]
            assert (field.link_clearances(q)[2:] >= np.minimum(apart - 0.01, 0.1) - 1e-9 - 2e-6)[apart > 0.0].all()


def plain(free: BoolArray, samples: Samples) -> bool:
    """Reachability by its definition."""
    first, last = samples
    cells = {tuple(cell) for cell in np.argwhere(free).tolist()}

    def inside(k: int, some: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
        return {cell for cell in some if all(first[k, a] <= cell[a] <= last[k, a] for a in range(3))}

    reached = inside(0, cells)
    for k in range(1, len(first)):
        next_to = {tuple(np.add(cell, step)) for cell in reached for step in product((-1, 0, 1), repeat=3)}
        reached = inside(k, cells & next_to)
    return bool(reached)


def packed(free: BoolArray):
    """Rows of bits along the first axis."""
    wide = np.zeros((*free.shape[1:], 64 * (-(-free.shape[0] // 64))), dtype=np.uint8)
    wide[..., : free.shape[0]] = np.moveaxis(free, 0, -1)
    return np.packbits(wide, axis=-1, bitorder="little").view(np.uint64)


def drawn(random: np.random.Generator, count: int) -> tuple[BoolArray, Samples]:
    """A grid of few free cells, and bounds that shrink to one cell at both ends."""
    shape = np.array([count, *random.integers(1, [5, 4])])
    free = random.random(shape) < random.uniform(0.3, 1.0)
    samples = int(random.integers(3, 8))
    walk = np.cumsum(random.integers(-1, 2, size=(samples, 3)), axis=0)
    low = np.clip(random.integers(0, shape) + walk, 0, shape - 1)
    first = np.maximum(low - random.integers(0, shape, size=(samples, 3)), 0)
    last = np.minimum(low + random.integers(0, shape, size=(samples, 3)), shape - 1)
    first[[0, -1]] = last[[0, -1]] = low[[0, -1]]
    free[tuple(first[0])] = free[tuple(first[-1])] = True
    return free, Samples(first, last)


@pytest.mark.parametrize("count", [7, 64, 140])
def test_as_by_sets_of_states(count: int) -> None:
    random, found = np.random.default_rng(count), []
    for _ in range(60 if count < 64 else 12):
        free, samples = drawn(random, count)
        found.append(is_reachable(packed(free), samples))
        assert found[-1] == plain(free, samples)
    assert 0.05 < np.mean(found) < 0.95


def test_wall_has_to_be_passed_by_its_gap_and_takes_the_time_for_it() -> None:
    free = np.ones((9, 9, 1), dtype=np.bool_)
    free[:, 4] = False
    free[0, 4] = True

    def reaches(samples: int) -> bool:
        first, last = np.zeros((samples, 3), dtype=np.int64), np.tile([8, 8, 0], (samples, 1))
        first[0] = last[0] = (8, 0, 0)
        first[-1] = last[-1] = (8, 8, 0)
        return is_reachable(packed(free), Samples(first, last))

    # Eight steps to the gap, and eight back.
    assert next(samples for samples in range(2, 24) if reaches(samples)) == 17
