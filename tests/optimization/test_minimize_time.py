"""Faster motions: the optimizer, its linear programs, and its termination."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from any_arms import loaded_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.optimize import linprog

import hplan
import hplan.optimization.minimize_time as minimize_time_module
from hplan.base.arrays import FloatArray
from hplan.base.deadline import NEVER
from hplan.certificate.limit_use import limit_use
from hplan.collision.compiled_field import ClearanceField
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.constraint_rows import ALLOWED, TorqueUse, torque_rows
from hplan.optimization.first_order import (
    APART,
    CUT_PLACES,
    NEAR,
    SCALE,
    MotionArrays,
    MotionLimits,
    basis,
    clearance_cuts,
    first_order,
    least_time_scale,
    sample_places,
)
from hplan.optimization.interior_point import ProgramRows, solve_program
from hplan.optimization.minimize_time import minimize_time, rough_motion
from hplan.optimization.time_problem import TimeProblem
from hplan.optimization.timed_spline import TimedSpline, even_breaks
from hplan.planning.effort import EFFORTS
from hplan.planning.motion import motion_limits, smoothing_options
from hplan.planning.options import EFFORT_NAMES, PlanOptions
from hplan.planning.problem import Problem
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere
from hplan.trajectory.speed_profile import SpeedProfile
from hplan.trajectory.spline import SplinePath


@pytest.fixture(scope="module")
def plans(robot, scene):
    return {effort: hplan.plan(robot, scene, PlanOptions(effort=effort)) for effort in EFFORT_NAMES}


def test_more_effort_is_quicker(plans):
    durations = {effort: plan.trajectory.duration for effort, plan in plans.items()}
    # An offline optimum of the motion is at about 1.75 s.
    assert durations["default"] <= 1.77
    assert durations["best"] <= 1.755
    assert durations["best"] <= durations["default"] <= durations["quick"]
    assert all(plan.certificate.verified for plan in plans.values())


def test_limits_hold_at_and_between_samples(plans, robot):
    for effort in ("default", "best"):
        trajectory = plans[effort].trajectory
        jerk = np.diff(trajectory.acceleration, axis=0) * 250.0
        assert (np.abs(jerk) <= robot.jerk_limit * (1.0 + 1e-5)).all()
        use = limit_use(robot, trajectory, *trajectory.segments)
        assert max(use.velocity, use.acceleration, use.torque) <= 1.0 + 1e-5
        assert use.position <= 1.0 + 1e-6


def test_torque_limits_hold(robot, scene):
    weak = np.array(robot.torque_limit)
    largest = np.abs(hplan.plan(robot, scene).trajectory.torque).max(axis=0)
    weak[1] = 0.97 * largest[1]
    arm = replace(robot, torque_limit=weak)
    plan = hplan.plan(arm, scene)
    assert plan.certificate.verified
    assert np.abs(plan.trajectory.torque[:, 1]).max() <= weak[1] * 1.001


def test_torque_rows_follow_the_torques(robot):
    def motion(clock):
        t = np.clip(clock / 0.8, 0.0, 1.0)
        return 0.3 + np.outer(t**3 * (10.0 - 15.0 * t + 6.0 * t**2), [0.0, 0.6, 0.4, -0.2])

    spline = TimedSpline.approximate(motion, even_breaks(0.8, 14))
    limit = np.abs(TorqueUse.sample(spline, robot.dynamics, np.ones(4)).use).max(axis=0) + 1e-6
    use = TorqueUse.sample(spline, robot.dynamics, limit)
    movable = np.array([1, 2, 3])
    limits = MotionLimits(np.array(robot.lower), np.array(robot.upper), np.ones((3, 4)), movable, np.empty((0, 4)))
    rows = torque_rows(use, spline, robot.dynamics, limits)
    rng = np.random.default_rng(1)
    change, time_scale = rng.uniform(-1e-5, 1e-5, (len(spline.control) - 6, 3)), 1.0 + 1e-5
    control = np.array(spline.control)
    control[3:-3, movable] += change
    after = TorqueUse.sample(TimedSpline(control, spline.knots).at_time_scale(time_scale), robot.dynamics, limit)
    times, joints = np.nonzero(np.abs(use.use) > 0.75)
    sign = np.sign(use.use[times, joints])
    gravity = sign * (robot.dynamics.gravity(use.states[0]) / limit)[times, joints]
    before, later = (sign * found.use[times, joints] - np.maximum(ALLOWED, gravity + 0.05) for found in (use, after))
    actual = time_scale**2 * later - before
    matrix = np.zeros((len(rows.upper), change.size))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        matrix[row, rows.columns[start:end]] = rows.entries[start:end]
    np.testing.assert_allclose(matrix @ change.ravel() + rows.time_scale * (time_scale - 1.0), actual, atol=2e-7)
    assert len(rows.upper) > 5


PIECES, MARGIN, TRUST = 12, 2e-3, 0.1


@pytest.fixture
def limits(robot):
    rates = np.stack([robot.velocity_limit, robot.acceleration_limit, robot.jerk_limit])
    return MotionLimits(np.array(robot.lower), np.array(robot.upper), rates, np.array([1, 3]), np.empty((0, 4)))


@pytest.fixture
def motion():
    rng = np.random.default_rng(3)
    breaks = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.15, PIECES))])
    knots = np.concatenate([np.zeros(3), breaks, np.full(3, breaks[-1])])
    control = np.cumsum(rng.uniform(0.0, 0.05, (PIECES + 3, 4)), axis=0) + 0.3
    control[:3], control[-3:] = control[2], control[-3]
    control[:, [0, 2]] = control[0, [0, 2]]
    return control, knots


def at_rest(control, knots):
    return MotionArrays(control, knots, np.zeros_like(control))


def dense(rows, count):
    matrix = np.zeros((len(rows.upper), count + 1))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        np.add.at(matrix[row], rows.columns[start:end], rows.entries[start:end])
    matrix[:, -1] = rows.time_scale
    return matrix


def field_of(robot, radius=0.1):
    return ClearanceField.build(robot, [Sphere(name="ball", center=(1.0, 0.35, 1.35), radius=radius).solids[0]])


def moved(control, unknowns, movable):
    result = control.copy()
    result[3:-3, movable] += unknowns.reshape(-1, len(movable))
    return result


def test_basis_is_that_of_the_b_spline(motion):
    _, knots = motion
    weight = np.empty(4)
    for piece in range(PIECES):
        for t in (0.0, 0.3, 0.9):
            basis(knots, piece, t, weight)
            at = knots[piece + 3] + t * (knots[piece + 4] - knots[piece + 3])
            expected = BSpline(knots, np.eye(PIECES + 3), 3)(at)
            np.testing.assert_allclose(weight, expected[piece : piece + 4], atol=1e-13)


def test_least_time_scale_holds_for_every_time(motion, limits):
    control, knots = motion
    time_scale = least_time_scale(control, knots, limits)
    clock = np.linspace(0.0, knots[-1], 4001)[:-1]
    spline = BSpline(knots, control, 3)
    uses = [np.abs(spline(clock, nu=order) / time_scale**order)[:, limits.movable] for order in (1, 2, 3)]
    largest = [use.max(axis=0) / limits.rates[order][limits.movable] for order, use in enumerate(uses)]
    assert np.max(largest) <= 1.0 + 1e-9
    # Acceleration and jerk are exact; velocity is in the hull of its control points.
    assert np.max(largest) > 0.9


def test_motion_that_keeps_the_program_keeps_the_limits(motion, limits, robot):
    control, knots = motion
    rng = np.random.default_rng(4)
    count = (PIECES - 3) * 2
    rows = first_order(at_rest(control, knots), limits, field_of(robot).arrays, MARGIN, TRUST)
    matrix = dense(rows, count)
    both = len(rows.lower)
    for _ in range(200):
        unknowns = rng.uniform(-TRUST, TRUST, count)
        # Minimum time-scaling factor that satisfies the program's limits.
        value = matrix[:both, :-1] @ unknowns
        with np.errstate(divide="ignore", invalid="ignore"):
            needed = np.maximum(value - rows.upper[:both], -value - rows.lower) / -rows.time_scale[:both]
        time_scale = needed[rows.time_scale[:both] < 0.0].max()
        if time_scale > 0.0:
            assert least_time_scale(moved(control, unknowns, limits.movable), knots, limits) <= time_scale * (
                1.0 + 1e-9
            )


#: Of pedestal, turret and links of the harvester, then of its five pairs of these.
SWAY = np.zeros((10, 4))
SWAY[1:5] = [1e-3, 0.0, 0.0, 0.0], [2e-3, 1e-3, 0.0, 0.0], [2e-3, 2e-3, 1e-3, 0.0], [3e-3, 2e-3, 2e-3, 1e-3]
SWAY[5:] = 0.5e-3


@pytest.mark.parametrize("sway", [np.zeros((0, 4)), SWAY], ids=["exact", "tracking errors"])
def test_clearances_minus_tracking_displacement_follow_step_and_time_scale(motion, limits, robot, sway):
    """Velocity-dependent tracking errors reduce clearance; a slower motion gains some."""
    control, knots = motion
    field, count, by = field_of(robot), (PIECES - 3) * 2, 1e-4
    assert len(SWAY) == field.count
    rows = first_order(at_rest(control, knots), limits._replace(sway=sway), field.arrays, MARGIN, TRUST)
    matrix, both = dense(rows, count), len(rows.lower)
    lever = sway if len(sway) else 0.0 * SWAY

    def left(values, time_scale):
        """Clearances in the order of the constraint rows."""
        spline, (piece, part) = BSpline(knots, values, 3), sample_places(control, knots, field.arrays).T
        clock = np.interp(piece + part, np.arange(PIECES + 1), knots[3:-3])
        return (field.clearance_along(spline(clock)) - np.abs(spline(clock, 1)) @ lever.T / time_scale).ravel()

    here = left(control, 1.0)
    # A step does not change the start.
    touched = np.flatnonzero((here < NEAR) & (np.arange(len(here)) >= field.count))
    assert len(rows.upper) - both == len(touched) >= 5
    unknowns = np.random.default_rng(5).uniform(-1e-5, 1e-5, count)
    change = left(moved(control, unknowns, limits.movable), 1.0 + by) - here
    expected = -(matrix[both:, :-1] @ unknowns + matrix[both:, -1] * by) * SCALE
    np.testing.assert_allclose(change[touched], expected, atol=2e-9 + 1e-3 * np.abs(expected).max())
    assert (np.abs(matrix[both:, -1]).max() > 0.0) == (len(sway) > 0)
    if not len(sway):  # the margin is required if the clearance exceeds it
        spare = (here[touched] - rows.upper[both:] * SCALE)[here[touched] > 2.0 * MARGIN]
        np.testing.assert_allclose(spare, MARGIN, atol=1e-12)


def test_sample_points_are_no_farther_apart_than_the_arm_may_move(motion, robot):
    control, knots = motion
    field = field_of(robot)
    piece, part = sample_places(control, knots, field.arrays).T
    clock = np.append(np.interp(piece + part, np.arange(PIECES + 1), knots[3:-3]), knots[-1])
    turns = np.abs(np.diff(BSpline(knots, control, 3)(clock), axis=0))
    farthest = (turns @ field.reaches[: len(field.arrays.bodies)].T).max(axis=1)
    counts = np.bincount(piece.astype(int))
    assert set(counts) <= {1, 2, 3}
    assert len(set(counts)) > 1
    few = counts[piece.astype(int)] < 3
    assert (farthest[few] < 1.5 * APART).all()  # nearly: joints do not turn evenly within a piece


def test_cuts_are_the_clearances_about_the_motion_after_the_step(motion, limits, robot):
    control, knots = motion
    field, count = field_of(robot), (PIECES - 3) * 2
    change = np.random.default_rng(6).uniform(-0.02, 0.02, count)
    after, blocked = moved(control, change, limits.movable), np.arange(PIECES) % 3 == 0
    rows = clearance_cuts(at_rest(after, knots), change, blocked, limits, field.arrays, MARGIN)
    matrix = dense(rows, count)
    breaks, parts = knots[3:-3], (np.arange(CUT_PLACES) + 0.5) / CUT_PLACES
    clock = (breaks[:-1, None] + np.diff(breaks)[:, None] * parts)[blocked].ravel()

    def left(values):
        return field.clearance_along(BSpline(knots, values, 3)(clock)).ravel()

    assert len(rows.lower) == 0
    assert 0 < len(rows.upper) < len(clock) * field.count
    # Each row is the clearance of some body at some sample point, beyond the margin, and its derivative.
    spare = (rows.upper - matrix[:, :-1] @ change) * SCALE + MARGIN
    here = left(after)
    which = np.abs(here[:, None] - spare).argmin(axis=0)
    np.testing.assert_allclose(here[which], spare, atol=1e-12)
    by = np.random.default_rng(7).uniform(-1e-5, 1e-5, count)
    gained = left(moved(after, by, limits.movable))[which] - here[which]
    expected = -(matrix[:, :-1] @ by) * SCALE
    np.testing.assert_allclose(gained, expected, atol=2e-9 + 1e-3 * np.abs(expected).max())


def test_control_points_outside_the_joint_limits_come_back(motion, limits, robot):
    control, knots = motion
    control[6, 1] = limits.upper[1] + 0.01
    rows = first_order(at_rest(control, knots), limits, field_of(robot).arrays, MARGIN, TRUST)
    kinematic = np.count_nonzero(rows.time_scale)
    bound = rows.upper[kinematic + (6 - 3) * 2]
    assert bound == pytest.approx(-0.01 / TRUST)


ACCURACY = 1e-8, 0.0


def drawn(seed: int, count: int, band: int, one_sided: int) -> tuple[ProgramRows, np.ndarray, np.ndarray]:
    """A program with a solution: rows, dense matrix, right-hand sides.

    The time scale is the last column.
    """
    rng = np.random.default_rng(seed)
    both = 3 * count
    # Every two one-sided rows have the same columns, like clearances at one configuration.
    first = np.append(np.tile(np.arange(count), 3), np.repeat(np.arange(count), 2)[:one_sided])
    first = np.minimum(first, max(0, count - band - 1))
    width = min(band + 1, count)
    entries = rng.normal(size=(both + one_sided, width))
    entries[rng.random(entries.shape) < 0.3] = 0.0
    time_scale = np.concatenate([-rng.integers(1, 4, both).astype(float), np.zeros(one_sided)])
    upper = rng.uniform(-0.5, 0.5, both + one_sided)
    upper[both:] = rng.uniform(0.05, 0.5, one_sided)
    lower = rng.uniform(-0.5, 0.5, both)
    # Changes are bounded, as by the step limit.
    columns = first[:, None] + np.arange(width)
    rows = ProgramRows(
        np.concatenate([np.arange(both + 1) * width, both * width + np.arange(1, count + 1),
                        both * width + count + np.arange(1, one_sided + 1) * width]).astype(np.int32),
        np.concatenate([columns[:both].ravel(), np.arange(count), columns[both:].ravel()]).astype(np.int32),
        np.concatenate([entries[:both].ravel(), np.full(count, 1.0), entries[both:].ravel()]),
        np.concatenate([time_scale[:both], np.zeros(count), time_scale[both:]]),
        np.concatenate([upper[:both], np.ones(count), upper[both:]]),
        np.concatenate([lower, np.ones(count)]),
    )  # fmt: skip
    dense = np.zeros((len(rows.upper), count + 1))
    for row, (start, end) in enumerate(zip(rows.starts[:-1], rows.starts[1:], strict=True)):
        np.add.at(dense[row], rows.columns[start:end], rows.entries[start:end])
    dense[:, -1] = rows.time_scale
    opposite = -dense[: len(rows.lower)]
    opposite[:, -1] *= -1.0
    return rows, np.vstack([dense, opposite]), np.concatenate([rows.upper, rows.lower])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 25), st.integers(0, 11), st.integers(0, 30))
def test_the_time_scale_is_the_least_that_highs_finds(seed, count, band, one_sided):
    rows, matrix, right = drawn(seed, count, band, min(one_sided, count))
    found, x = solve_program(rows, count, band, ACCURACY, NEVER)
    cost = np.append(np.zeros(count), 1.0)
    best = linprog(cost, A_ub=matrix, b_ub=right, bounds=(None, None))
    assert best.status == 0
    assert found
    assert (matrix @ x - right).max() < 1e-6
    # The squares of the changes, at most 1 each, have a small weight.
    assert best.fun - 1e-6 <= x[-1] <= best.fun + 0.5e-4 * count + 1e-6


def test_of_equal_paces_the_smallest_change_is_taken():
    # One of two unknowns is free to move.
    rows = ProgramRows(
        np.array([0, 1, 2], dtype=np.int32), np.array([0, 1], dtype=np.int32), np.array([1.0, 1.0]),
        np.array([-1.0, 0.0]), np.array([-0.5, 1.0]), np.array([-0.5, 1.0]),
    )  # fmt: skip
    found, x = solve_program(rows, 2, 0, ACCURACY, NEVER)
    assert found
    assert x == pytest.approx([0.0, 0.0, 0.5], abs=1e-6)


def test_program_without_solution_is_not_solved():
    rows = ProgramRows(
        np.array([0, 1, 2], dtype=np.int32), np.array([0, 0], dtype=np.int32), np.array([1.0, -1.0]),
        np.array([0.0, 0.0]), np.array([-1.0, -1.0]), np.array([1.0]),
    )  # fmt: skip
    assert not solve_program(rows, 1, 0, ACCURACY, NEVER)[0]


EFFORT = EFFORTS["default"].starts


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Problem:
    arm = loaded_arm("toy", tmp_path_factory)
    ends = {key: {"joints_rad": place} for key, place in (("start", (0.3,) * arm.dof), ("goal", (1.2,) * arm.dof))}
    scene = Scene.model_validate({"format": "hplan-scene/1", "name": "nothing", "obstacles": (), **ends})
    return Problem.from_scene(arm, scene, PlanOptions()).from_configurations(
        scene.start.configuration, scene.goal.configuration
    )


def problem_of(task: Problem) -> TimeProblem:
    options, robot = smoothing_options(task, task.margin), task.robot
    return TimeProblem(task.field, task.field, options, motion_limits(task), robot.dynamics, task.options.rate_hz)


def bent(task: Problem, seed: int) -> SpeedProfile:
    """A start that is a detour."""
    ends: FloatArray = np.linspace(task.start, task.goal, 7)
    ends[1:-1] += np.random.default_rng(seed).uniform(-0.3, 0.3, ends[1:-1].shape)
    return coarse_profile(SplinePath.from_control_points(ends), smoothing_options(task, task.margin))


@pytest.mark.parametrize("seed", [1, 2])
def test_no_motion_is_faster_than_its_segments_allow(task: Problem, seed: int) -> None:
    problem, turn = problem_of(task), task.goal - task.start
    rough = rough_motion(bent(task, seed), problem, EFFORT)
    assert rough is not None
    found = minimize_time(bent(task, seed), problem, EFFORT, rough=rough)
    assert found is not None
    for spline, level in zip((rough, found), EFFORT.levels, strict=True):
        least = problem.least_duration(turn, len(spline.control) - 3)
        assert least <= spline.duration * (1.0 + 1e-6)
        assert spline.duration <= (1.0 + 2.0 * level.enough) * least + 1.0 / problem.rate_hz
    assert problem.least_duration(turn, 20) > problem.least_duration(turn, 50) > 0.0


def test_rows_that_cannot_be_active_are_left_out(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("toy", tmp_path_factory)
    ball = Sphere(name="ball", center=(0.5, 0.1, 0.6), radius=0.1)
    field = ClearanceField.build(arm, [ball])
    generator = np.random.default_rng(5)
    control = np.cumsum(generator.uniform(-0.02, 0.1, (17, arm.dof)), axis=0)
    control[:3], control[-3:] = control[2], control[-3]
    motion = MotionArrays(control, np.concatenate([np.zeros(3), np.linspace(0.0, 1.2, 15), [1.2] * 3]), 0.0 * control)
    rates = np.stack([arm.velocity_limit, arm.acceleration_limit, np.full(arm.dof, 1e4)])
    limits = MotionLimits(np.array(arm.lower), np.array(arm.upper), rates, np.arange(arm.dof), np.empty((0, arm.dof)))

    def clearance_rows(trust: float) -> dict[tuple[float, ...], tuple[float, float]]:
        rows = first_order(motion, limits, field.arrays, 2e-3, trust)
        spans = [slice(*rows.starts[row : row + 2]) for row in range(len(rows.lower), len(rows.upper))]
        sides = rows.upper[len(rows.lower) :].tolist()
        keys = [(*rows.columns[span].tolist(), *rows.entries[span].tolist()) for span in spans]
        largest = [float(np.abs(rows.entries[span]).sum()) for span in spans]
        return dict(zip(keys, zip(sides, largest, strict=True), strict=True))

    whole = clearance_rows(10.0)
    for trust in (0.05, 0.2):
        kept = clearance_rows(trust)
        assert kept.items() <= whole.items()
        assert 0 < len(kept) < len(whole)
        assert all(largest * trust <= side for key, (side, largest) in whole.items() if key not in kept)


def test_level_ends_at_a_program_without_a_solution(task: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """A smaller trust region admits no more; steps that lead into contact are tried again within one."""
    solve, solved = TimeProblem.solve, list[object]()
    monkeypatch.setattr(TimeProblem, "solve", lambda *program: solved.append(None))
    assert rough_motion(bent(task, 1), problem_of(task), EFFORT) is None
    assert len(solved) == 1
    solved.clear()
    monkeypatch.setattr(TimeProblem, "solve", lambda *program: solved.append(None) or solve(*program))
    monkeypatch.setattr(TimeProblem, "cuts", lambda *step: ProgramRows(*np.zeros((6, 0))))
    monkeypatch.setattr(TimeProblem, "is_clear", lambda *motion: False)
    monkeypatch.setattr(minimize_time_module, "with_rows", lambda rows, more: rows)
    assert rough_motion(bent(task, 1), problem_of(task), EFFORT) is None
    assert len(solved) == 2 * 2


def test_level_after_another_ends_at_its_first_step_if_that_gains_little(
    task: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its start counts as the step before, but not where a path alone is the start."""
    problem, effort, steps = problem_of(task), EFFORTS["default"].starts, list[float]()
    coarse, step = rough_motion(bent(task, 0), problem, effort), minimize_time_module._step
    assert coarse is not None
    monkeypatch.setattr(
        minimize_time_module, "_step", lambda spline, *rest: steps.append(spline.duration) or step(spline, *rest)
    )
    for start, gain, is_one in ((coarse, 0.5, True), (coarse, 1e-9, False), (bent(task, 0), 0.5, False)):
        level = replace(effort.levels[-1], gain=gain, enough=0.0)
        found = minimize_time_module._of_level(start, problem, level)
        assert found is not None
        assert found.duration < start.duration
        assert (len(steps) == 1) == is_one
        steps.clear()
