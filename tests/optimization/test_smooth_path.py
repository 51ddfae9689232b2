"""Smooth paths, and the fastest of several starts."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import CertificationError
from hplan.geometry.polyline import path_length
from hplan.optimization import coarse_profile as coarse
from hplan.optimization import several_starts
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.minimize_time import Level, OptimizerEffort
from hplan.optimization.options import PostprocessOptions
from hplan.optimization.push_clear import clear_spline
from hplan.optimization.several_starts import fastest_motions, optimization_starts
from hplan.optimization.shortcut import shorten
from hplan.optimization.smooth_path import clear_path, short_path
from hplan.optimization.time_problem import TimeProblem
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.limits import Limits
from hplan.scene.obstacles import Sphere
from hplan.trajectory.corner_rounding import clear_rounding
from hplan.trajectory.retime import time_path
from hplan.trajectory.spline import SplinePath

MARGIN = 2e-3
PLANAR = np.array([1, 2, 3])


@pytest.fixture(scope="module")
def field(robot, scene):
    return ClearanceField.build(robot, scene.solids)


@pytest.fixture(scope="module")
def checker(robot, scene):
    return CoalScene(robot, scene.solids)


@pytest.fixture(scope="module")
def grid_path(robot, scene):
    return plan(robot, scene, PlanOptions(objective="length")).grid_path


@pytest.fixture(scope="module")
def options(robot):
    return PostprocessOptions(
        lower=robot.lower,
        upper=robot.upper,
        velocity=robot.velocity_limit,
        acceleration=robot.acceleration_limit,
        movable=PLANAR,
        margin=MARGIN,
    )


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)


def samples_of(path, spacing=2e-3):
    """Configurations along a polyline or a spline, no farther apart than the spacing [rad]."""
    if isinstance(path, SplinePath):
        return path.evaluate(np.linspace(0.0, path.end, 2 + int(path.length / spacing)))
    pieces = [np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / spacing)) for a, b in itertools.pairwise(path)]
    return np.concatenate(pieces)


def assert_kept(robot, checker, path, start, goal):
    """Check ends, joint limits, clearance at dense samples, and the base."""
    samples = samples_of(path)
    if not isinstance(path, SplinePath):
        np.testing.assert_array_equal(path[[0, -1]], [start, goal])
    np.testing.assert_allclose(samples[[0, -1]], [start, goal], rtol=0, atol=1e-15)
    assert (samples >= robot.lower - 1e-12).all()
    assert (samples <= robot.upper + 1e-12).all()
    assert np.abs(samples[:, 0] - start[0]).max() <= 1e-12
    if checker.obstacle_names:
        assert min(checker.distances(q).min() for q in samples) > 0.0
    if isinstance(path, SplinePath):
        assert (path.control[:, 0] == start[0]).all()
        assert (path.control >= robot.lower).all()
        assert (path.control <= robot.upper).all()


def assert_same(first, second):
    if isinstance(first, SplinePath):
        assert first.knots.tobytes() == second.knots.tobytes()
        first, second = first.control, second.control
    assert first.tobytes() == second.tobytes()


def staircase(start, end, steps=20):
    """A clear path in free space that moves one planar joint at a time."""
    q = np.array(start, dtype=float)
    path = [q.copy()]
    for _ in range(steps):
        for joint in PLANAR:
            q[joint] += (end[joint] - start[joint]) / steps
            path.append(q.copy())
    path[-1] = np.array(end, dtype=float)
    return np.array(path)


# Shortening


@pytest.mark.parametrize("margin", [1e-4, MARGIN, 0.01])
def test_shortened_reference_path(robot, field, checker, grid_path, margin):
    taut = shorten(grid_path, field, margin=margin)
    assert_kept(robot, checker, taut, grid_path[0], grid_path[-1])
    assert path_length(taut) < 0.98 * path_length(grid_path)
    assert np.linalg.norm(np.diff(taut, axis=0), axis=1).min() > 0.0
    assert_same(taut, shorten(grid_path, field, margin=margin))
    assert path_length(shorten(taut, field, margin=margin)) <= path_length(taut) * (1 + 1e-12)


def test_shortened_random_paths(robot):
    """Shortened clear paths among random balls stay clear and never grow.

    Locked joints stay.
    """
    rng = np.random.default_rng(5)
    seen = 0
    while seen < 25:
        balls = [
            Sphere(
                name=f"b{i}",
                center=(rng.uniform(-1, 2), rng.uniform(-0.3, 0.3), rng.uniform(0.8, 2.6)),
                radius=rng.uniform(0.03, 0.2),
            )
            for i in range(4)
        ]
        field, checker = ClearanceField.build(robot, balls), CoalScene(robot, balls)
        path = np.clip(
            np.cumsum(np.vstack([rng.uniform(0, 1.5, 4), rng.normal(0, 0.12, (30, 4))]), axis=0), 0, robot.upper
        )
        path[:, 0] = path[0, 0]
        if not field.is_clear(path, 1e-5):
            continue
        seen += 1
        taut = shorten(path, field, margin=1e-5)
        assert_kept(robot, checker, taut, path[0], path[-1])
        assert (taut[:, 0] == path[0, 0]).all()
        assert path_length(taut) <= path_length(path) * (1 + 1e-12)
        assert_kept(robot, checker, clear_rounding(taut, field, margin=1e-5), path[0], path[-1])


# Corners rounded


def test_rounded_reference_path(robot, field, checker, grid_path):
    margin = 1e-4  # of the motions between nodes that stay, some have less than MARGIN
    taut = shorten(grid_path, field, margin=margin)
    assert field.is_clear(taut, margin)
    path = clear_rounding(taut, field, margin=margin)
    assert_kept(robot, checker, path, taut[0], taut[-1])
    assert path.is_clear(field, 0.5 * margin)
    assert path.length < path_length(taut)
    assert_same(path, clear_rounding(taut, field, margin=margin))
    # It stays near the polyline.
    fine = samples_of(taut)
    off = [np.linalg.norm(fine - q, axis=1).min() for q in samples_of(path, 0.02)]
    assert max(off) < 0.1


def test_corner_in_contact_cannot_be_rounded(robot):
    path = np.array([[0, 0.2, 0, 0], [0, 0.8, 0, 0], [0, 0.8, 0.6, 0.0]])
    tip = robot.tool_positions(path[1])
    ball = Sphere(name="ball", center=tuple(map(float, tip)), radius=0.05)
    with pytest.raises(CertificationError, match="corners cannot be rounded"):
        clear_rounding(path, ClearanceField.build(robot, [ball]), margin=1e-3)


# Splines moved away from obstacles, and their speed


def test_pushing_keeps_the_joint_limits(robot, field, grid_path, options):
    """Limits as narrow as the path: without them it would leave the range."""
    taut = shorten(grid_path, field, margin=MARGIN)
    tight = replace(options, lower=taut.min(axis=0), upper=taut.max(axis=0))
    left = 0
    for count in range(6, 31):
        for limited in (options, tight):
            spline = clear_spline(taut, field, limited, count=count, margin=MARGIN)
            if spline is None:
                continue
            outside = np.maximum(spline.control - tight.upper, tight.lower - spline.control).max()
            if limited is tight:
                assert outside <= 0.0
            else:
                left += int(outside > 1e-3)
    assert left > 0


def test_few_control_points_suffice_at_joint_limits(field, grid_path, options):
    """Joints at a limit leave a push to the others: limits do not take more than twice the control points."""
    taut = shorten(grid_path, field, margin=1e-3)
    for lower, upper in ((options.lower, options.upper), (taut.min(axis=0), taut.max(axis=0))):
        limited = replace(options, lower=lower, upper=upper)
        assert all(clear_spline(taut, field, limited, count=count, margin=1e-3) is not None for count in (6, 7, 9, 10))


def test_coarse_profile_is_about_that_of_toppra(robot, field, grid_path, options, limits):
    """Without torque and jerk limits, to a few per cent."""
    pushed = clear_spline(shorten(grid_path, field, margin=MARGIN), field, options, count=8, margin=MARGIN)
    exact = time_path(pushed, robot.model, Limits(limits.velocity, limits.acceleration))
    assert coarse_profile(pushed, options).duration == pytest.approx(exact.duration, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_largest_speeds_at_which_all_joints_can_accelerate(options, seed):
    """Against linear programs: the maximum x with |q' u + q'' x| <= a for some u.

    And |q'|^2 x <= v^2.
    """
    control = np.random.default_rng(seed).uniform(-1.0, 1.0, (9, 4))
    grid = coarse._grid_of(SplinePath.from_control_points(control).knots, 6)
    demands = np.empty((len(grid.first), 9))
    velocity = 100.0 * options.velocity  # for the limits by acceleration alone
    coarse._demands(control, grid, replace(options, velocity=velocity, movable=np.arange(4)).joints, demands)
    for row, (weights, bends) in enumerate(zip(grid.first, grid.second, strict=True)):
        piece = min(row // 8, 5)
        p, c = weights @ control[piece : piece + 4], bends @ control[piece : piece + 4]
        sides = np.stack([p, c], axis=1)
        found = linprog(
            [0.0, -1.0],
            np.vstack([sides, -sides]),
            np.tile(options.acceleration, 2),
            bounds=[(None, None), (0.0, float(((velocity / p) ** 2).min()))],
        )
        assert demands[row, -1] == pytest.approx(found.x[1], rel=1e-6)


# The whole way


@pytest.mark.parametrize("smoothed", [clear_path, short_path])
def test_reference_path(robot, field, checker, grid_path, options, smoothed):
    path = smoothed(grid_path, field, options)
    assert_kept(robot, checker, path, grid_path[0], grid_path[-1])
    assert path.is_clear(field, 0.5 * 0.05 * MARGIN)
    assert path.length < path_length(grid_path)
    assert_same(path, smoothed(grid_path, field, options))
    assert_same(path, smoothed(grid_path.copy(), ClearanceField.build(robot, [*_solids(checker)]), options))


def _solids(checker):
    """The reference obstacle anew: the result hangs on values, not on objects."""
    return [Sphere(name="again", center=(1.0, 0.0, 1.9), radius=0.15)]


def test_short_is_short(field, grid_path, options):
    """The taut string is about 138.3 deg long."""
    assert np.degrees(short_path(grid_path, field, options).length) <= 138.8


@pytest.mark.parametrize("smoothed", [clear_path, short_path])
@pytest.mark.parametrize("case", ["two points", "twins at the start", "twins at the goal", "tiny steps", "tiny"])
def test_small_paths(robot, field, checker, options, smoothed, case):
    start, end = np.array([0.3, 0.0, 0.0, 0.0]), np.array([0.3, 0.4, 0.3, 0.2])
    near = end + np.array([0, 0, 0, 1e-10])
    path = {
        "two points": [start, end],
        "twins at the start": [start, start, end],
        "twins at the goal": [start, end, end],
        "tiny steps": [start, start + np.array([0, 1e-10, 0, 0]), end, near],
        "tiny": [start, start + np.array([0, 1e-7, 0, 0])],
    }[case]
    path = np.array(path)
    found = smoothed(path, field, options)
    assert_kept(robot, checker, found, path[0], path[-1])
    straight = np.linalg.norm(path[-1] - path[0])
    assert straight * (1 - 1e-9) <= found.length <= 1.2 * straight


@pytest.mark.parametrize("smoothed", [clear_path, short_path])
def test_locked_joints_do_not_move(robot, field, options, smoothed):
    path = staircase(np.array([0.4, 0.1, 0.2, 0.5]), np.array([0.4, 0.7, 1.0, 0.5]), 10)
    found = smoothed(path, field, replace(options, movable=np.array([1, 2])))
    assert (found.control[:, [0, 3]] == [0.4, 0.5]).all()


@pytest.mark.parametrize("smoothed", [clear_path, short_path])
def test_random_clear_paths(robot, options, smoothed):
    rng = np.random.default_rng(6)
    seen = 0
    while seen < 12:
        balls = [
            Sphere(name=f"b{i}", center=(rng.uniform(-1, 2), 0.0, rng.uniform(0.8, 2.6)), radius=rng.uniform(0.03, 0.2))
            for i in range(4)
        ]
        field, checker = ClearanceField.build(robot, balls), CoalScene(robot, balls)
        path = np.clip(
            np.cumsum(np.vstack([rng.uniform(0, 1.5, 4), rng.normal(0, 0.12, (25, 4))]), axis=0), 0, robot.upper
        )
        path[:, 0] = 0.0
        if not field.is_clear(path, 1e-3):
            continue
        seen += 1
        found = smoothed(path, field, options)
        assert_kept(robot, checker, found, path[0], path[-1])
        assert_same(found, smoothed(path, field, options))


# Straight motions, and distant obstacles


def test_clear_straight_motion_stays_straight(robot, options):
    """If one joint limits the duration the straight line is optimal: no search."""
    free = replace(options, movable=np.arange(4))
    field = ClearanceField.build(robot, [Sphere(name="far", center=(-1.5, 0.0, 1.0), radius=0.1)])
    start, end = np.array([0.0, 0.4, 0.3, 0.2]), np.array([1.0, 0.7, 0.3, 0.3])
    detour = np.array([start, [0.4, 0.9, 0.3, 0.2], end])
    for path in (np.array([start, end]), detour):
        found = clear_path(path, field, free)
        np.testing.assert_allclose(found.evaluate([0.0, 0.5 * found.end, found.end]), [start, 0.5 * (start + end), end])
        assert found.length == pytest.approx(np.linalg.norm(end - start))


START, GOAL = np.array([0.15, 1.2, 0.3, 0.3]), np.array([0.15, 0.1, 0.3, 0.3])
LEVELS = (Level(0.1, (15, 30), 10, 1e-2, 0.2), Level(0.05, (20, 40), 3, 1e-2, 0.05))
EFFORT = OptimizerEffort(LEVELS, rough=4, others=1)


@pytest.fixture(scope="module")
def problem(robot):
    field = ClearanceField.build(robot, [Sphere(name="ball", center=(1.6, 0.0, 1.6), radius=0.25).solids[0]])
    options = PostprocessOptions(
        lower=robot.lower, upper=robot.upper, velocity=robot.velocity_limit, acceleration=robot.acceleration_limit,
        movable=np.arange(4), margin=2e-3,
    )  # fmt: skip
    limits = Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit, robot.jerk_limit)
    return TimeProblem(field, field, options, limits, robot.dynamics, 250.0)


def paths():
    """On the farther side of the ball, and twice on the nearer one."""
    return [np.stack([START, np.array([yaw, 0.65, 0.3, 0.3]), GOAL]) for yaw in (-0.7, 0.9, 0.8)]


def test_faster_class_wins_in_any_order(problem):
    starts = optimization_starts(paths(), problem)
    assert len(starts) == 3
    times = [start.profile.duration for start in starts]
    assert times == sorted(times)  # none is within the preference for the first
    alone = [fastest_motions([start], EFFORT)[0][1].duration for start in starts]
    assert max(alone) > 1.01 * min(alone)
    for order in (starts, starts[::-1]):
        assert fastest_motions(order, EFFORT)[0][1].duration == pytest.approx(min(alone), rel=0.005)


def test_paths_in_contact_give_no_start(problem):
    straight = np.stack([START, GOAL])
    assert not problem.field.is_clear(straight, 1e-4)
    starts = optimization_starts([straight, *paths()], problem)
    assert sorted(start.number for start in starts) == [1, 2, 3]
    assert all(math.isfinite(start.profile.duration) for start in starts)


def test_starts_are_rounded_polylines_where_no_smoother_one_is_found(problem, monkeypatch):
    smooth = fastest_motions(optimization_starts(paths(), problem), EFFORT)[0][1]
    monkeypatch.setattr(several_starts, "clear_start", lambda *given: None)
    starts = optimization_starts(paths(), problem)
    assert sorted(start.number for start in starts) == [0, 1, 2]
    for start in starts:
        along = start.profile.positions(np.linspace(0.0, start.profile.duration, 500))
        assert problem.field.clearance_along(along).min() > 0.0
    assert fastest_motions(starts, EFFORT)[0][1].duration == pytest.approx(smooth.duration, rel=0.02)
    monkeypatch.setattr(several_starts, "rounded_start", lambda *given: None)
    assert optimization_starts(paths(), problem) == []


@pytest.mark.parametrize(("margin", "proved"), [(2e-3, 1e-4), (4e-4, 3e-5), (1e-5, 5e-6)])
def test_small_margins_are_proved_by_half(problem, margin, proved):
    """Near ends almost in contact; with a twentieth of such a margin, certificates failed."""
    near_contact = replace(problem, options=replace(problem.options, margin=margin))
    assert near_contact.proved_margin == pytest.approx(proved)
