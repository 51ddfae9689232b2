"""Timing along a path against toppra, and a motion's path at other speeds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import toppra
from hypothesis import given, settings
from hypothesis import strategies as st
from toppra import algorithm, constraint

from hplan.errors import OptionError, TimingError
from hplan.planning.plan import plan
from hplan.robot.dynamics import InverseDynamics
from hplan.robot.limits import Limits
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.spline import SplinePath
from hplan.trajectory.time_scaling import OFF_PATH
from hplan.trajectory.time_steps import AHEAD
from hplan.trajectory.topp import PathView, fastest_speed, half_planes, passes
from hplan.trajectory.trajectory import Retimed, Trajectory, scale_motion, stop_motion


@pytest.fixture(scope="module")
def limits(robot):
    return Limits(robot.velocity_limit, robot.acceleration_limit, robot.torque_limit)


@pytest.fixture(scope="module")
def dynamics(robot):
    return InverseDynamics.build(robot.model)


class HalfPlanes(constraint.LinearConstraint):
    """Half-planes as one of toppra's own constraints: the bounds of x, and all others."""

    def __init__(self, rows):
        super().__init__()
        self.rows = rows

    def compute_constraint_params(self, path, gridpoints):
        bounds = self.rows[:, 2:4, 2] * (1.0, -1.0)
        a, b, c = np.moveaxis(self.rows[:, 6:], 2, 0)
        faces = np.tile(np.eye(a.shape[1]), (len(a), 1, 1))
        return a, b, c, faces, np.zeros(a.shape), None, bounds


def toppras(rows, grid, rates):
    """Speeds, accelerations and sets by toppra, or None; and its return code."""
    line = toppra.SplineInterpolator(grid[[0, -1]], np.array([[0.0], [1.0]]))
    own = algorithm.TOPPRA([HalfPlanes(rows)], line, gridpoints=grid, solver_wrapper="seidel")
    u, speed, _, sets = own.compute_parameterization(*rates, return_data=True)
    return None if speed is None else (speed, u, sets), own.problem_data.return_code.name


def compared(rows, grid, rates):
    """The code of both, which agree: the sets to rounding, speeds to toppra's tolerance of half-planes (1e-10)."""
    expected, code = toppras(rows.copy(), grid, rates)
    try:
        found = passes(rows, np.diff(grid), rates)
    except TimingError as error:
        assert expected is None
        return error.cause, code
    if expected is None:
        # Where toppra gives up for rounding there may be a motion; it is one if every half-plane is kept.
        speed, u, _ = found
        a, b, c = np.moveaxis(rows[:-1, 6:], 2, 0)
        use = a * u[:, None] + b * speed[:-1, None] ** 2 + c
        assert (use <= 1e-6 * np.abs(c) + 1e-9).all()
        return "Ok", code
    peak = expected[0].max()
    np.testing.assert_allclose(found[2], expected[2], rtol=1e-9, atol=1e-12 * peak**2)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-9, atol=1e-9 * peak)
    return "Ok", code


def spline(rng, span, locked):
    control = 0.8 + rng.uniform(-0.7, 0.7, 4) + span * rng.uniform(-0.7, 0.7, (int(rng.integers(4, 12)), 4))
    if locked is not None:
        control[:, locked] = 0.3
    return SplinePath.from_control_points(control)


def cosine(end, points):
    grid = 0.5 * end * (1.0 - np.cos(np.linspace(0.0, np.pi, points)))
    grid[-1] = end
    return grid


@settings(max_examples=80)
@given(
    seed=st.integers(0, 10**6),
    span=st.sampled_from([1.0, 1.0, 0.3, 1e-2]),
    locked=st.sampled_from([None, None, 0, 2]),
    torque=st.sampled_from([None, 0.97, 1.01, 1.3, 10.0]),
    faster=st.sampled_from([0.1, 1.0, 10.0]),
    rates=st.sampled_from([(0.0, 0.0), (0.0, 0.0), (0.1, 0.3), (1.0, 0.0), (0.0, 2.0), (30.0, 0.0)]),
    points=st.integers(10, 400),
)
def test_passes_are_toppras(dynamics, limits, seed, span, locked, torque, faster, rates, points):
    path = spline(np.random.default_rng(seed), span, locked)
    static = np.abs(dynamics.gravity(path.evaluate(np.linspace(0.0, path.end, 200)))).max(axis=0)
    most = None if torque is None else np.maximum(torque * static, 3.0)
    kept, grid = Limits(limits.velocity, faster * limits.acceleration, most), cosine(path.end, points)
    rows = half_planes(PathView(path, 4, 1.0), dynamics, kept, grid)
    ours, own = compared(rows, grid, np.array(rates))
    assert ours == own or own != "Ok"


def test_outcomes_of_many_paths(dynamics, limits):
    """Paths that toppra times are timed, the others are not."""
    rng, outcomes = np.random.default_rng(4), set()
    for _ in range(60):
        path, rates = spline(rng, 1.0, None), rng.choice([0.0, 0.0, 0.5, 50.0], 2)
        kept, grid = replace(limits, torque=rng.uniform(0.2, 1.0) * limits.torque), cosine(path.end, 60)
        outcomes.add(compared(half_planes(PathView(path, 4, 1.0), dynamics, kept, grid), grid, rates))
    assert outcomes >= {("Ok", "Ok"), ("FailUncontrollable", "FailUncontrollable")}


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), span=st.sampled_from([1.0, 1e-2, 1e-4, 1e-6]))
def test_speeds_use_a_limit_and_pass_none(dynamics, limits, seed, span):
    """Checked at the middles of the grid's intervals, for any length."""
    path = spline(np.random.default_rng(seed), span, None)
    grid = cosine(path.end, 300)
    speed = fastest_speed(path, dynamics, limits, grid)
    push = 0.5 * np.diff(speed**2) / np.diff(grid)
    square, middle = 0.5 * (speed[1:] ** 2 + speed[:-1] ** 2), 0.5 * (grid[1:] + grid[:-1])
    first, second = path.evaluate(middle, 1), path.evaluate(middle, 2)
    acceleration = first * push[:, None] + second * square[:, None]
    torque = dynamics.torques(path.evaluate(middle), first * np.sqrt(square)[:, None], acceleration)
    velocity = path.evaluate(grid, 1) * speed[:, None]
    use = [(np.abs(velocity) / limits.velocity)[:-1], np.abs(acceleration) / limits.acceleration]
    use.append(np.abs(torque) / limits.torque)
    largest = np.max(use, axis=(0, 2))
    assert largest.max() < 1.01
    assert np.median(largest) > 0.95


@pytest.mark.parametrize(
    ("a", "c"), [(0.0, (1.0, 0.0)), (1.0, (1.0, 1.0)), (1.0, (2.0, -1.0)), (1.0, (0.0, np.nan)), (np.nan, (0.0, 0.0))]
)
@pytest.mark.parametrize("at", [slice(None), slice(5, 6)])
def test_half_planes_without_a_point(dynamics, limits, a, c, at):
    """a u + c <= 0 and -a u + c <= 0, everywhere or at one point."""
    path = SplinePath.from_control_points(np.linspace(np.zeros(4), np.full(4, 0.5), 5))
    grid = cosine(path.end, 20)
    rows = half_planes(PathView(path, 4, 1.0), dynamics, limits, grid)
    rows[at, 6:8, 0], rows[at, 6:8, 1], rows[at, 6:8, 2] = (a, -a), 0.0, c
    with pytest.raises(TimingError) as caught:
        passes(rows, np.diff(grid), np.zeros(2))
    assert caught.value.cause == "FailUncontrollable"


#: Maximum ratio to the limit, of acceleration and torque, and of jerk.
TOLERANCE, JERK_TOLERANCE = 1.001, 1.035


@cache
def motions() -> tuple[Trajectory, ...]:
    """The reference scene's motion, and some among nothing."""
    robot, random = load_robot(), np.random.default_rng(3)
    scenes = [load_scene()]
    for _ in range(3):
        start, goal = random.uniform((-45.0, 5.0, 5.0, 5.0), (45.0, 85.0, 85.0, 85.0), (2, 4)).tolist()
        scenes.append(Scene(name="free", start=Start(joints_deg=tuple(start)), goal=Goal(joints_deg=tuple(goal))))
    return tuple(plan(robot, scene).trajectory for scene in scenes)


def with_motion() -> st.SearchStrategy[Trajectory]:
    return st.sampled_from(range(4)).map(lambda number: motions()[number])


def assert_within_limits(robot: Robot, trajectory: Trajectory) -> None:
    """At samples, and everywhere for quantities linear between them."""
    for values, limit, most in (
        (trajectory.velocity, robot.velocity_limit, TOLERANCE),
        (trajectory.acceleration, robot.acceleration_limit, TOLERANCE),
        (trajectory.torque, robot.torque_limit, TOLERANCE),
        (
            np.diff(trajectory.acceleration, axis=0) / np.diff(trajectory.time)[:, None],
            robot.jerk_limit,
            JERK_TOLERANCE,
        ),
    ):
        assert (np.abs(values) <= limit * most + 1e-9).all()


def assert_smooth(trajectory: Trajectory) -> None:
    """Check that the acceleration is continuous, equal to the samples' at both ends."""
    if trajectory.samples == 1:
        return
    bezier, duration = trajectory.segments
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    np.testing.assert_allclose(bent[:, 0], trajectory.acceleration[:-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(bent[:, 1], trajectory.acceleration[1:], rtol=0, atol=1e-6)


def assert_on_path(robot: Robot, retimed: Retimed, motion: Trajectory) -> None:
    """The tool passes the motion's positions within 0.1 mm, between samples too."""
    trajectory, row = retimed.trajectory, retimed.row
    assert retimed.off_path_m <= OFF_PATH
    for field in ("time", "position", "velocity", "acceleration", "torque"):
        np.testing.assert_array_equal(getattr(trajectory, field)[: row + 1], getattr(motion, field)[: row + 1])
    clock = np.linspace(trajectory.time[row], trajectory.duration, 61)
    about = np.interp(clock, trajectory.time, retimed.clock)
    near = about[:, None] + np.linspace(-4e-3, 4e-3, 201)
    there = robot.tool_positions(motion.positions(np.clip(near, 0.0, motion.duration).ravel()))
    here = robot.tool_positions(trajectory.positions(clock))
    off = np.linalg.norm(there.reshape(*near.shape, 3) - here[:, None], axis=2).min(axis=1)
    assert off.max() <= OFF_PATH + 1e-5  # the checked places are a little apart


def test_a_course_holds_what_is_left_of_a_motion(robot):
    motion = motions()[0]
    course, (bezier, duration) = motion.course, motion.segments
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    jumps, jerks = np.abs(bent[1:, 0] - bent[:-1, 1]), np.abs(bent[:, 1] - bent[:, 0]) / duration[:, None]
    for row in (0, 1, 57, motion.samples - 2):
        highest = np.abs(bent[row:]).max(axis=(0, 1))
        left = motion.cut_before(row)
        expected = [
            np.abs(left.velocity).max(axis=0),
            np.maximum(highest, np.abs(left.acceleration).max(axis=0)),
            np.abs(left.torque).max(axis=0),
            jumps[row:].max(axis=0, initial=0.0),
            jerks[row:].max(axis=0),
            highest,
            left.position.max(axis=0),
        ]
        np.testing.assert_array_equal(course.largest[:, row], expected)
        np.testing.assert_array_equal(course.least[row], left.position.min(axis=0))


def test_a_stop_keeps_torque_limits_that_bind(robot):
    """Limits that a motion itself just keeps; without them some stops would need more."""
    free, needed = replace(robot, torque_limit=100.0 * robot.torque_limit), list[float]()
    for motion in motions():
        tight = replace(robot, torque_limit=np.abs(motion.torque).max(axis=0) + 1e-3)
        for t in motion.time[5:-5:17].tolist():
            found = stop_motion(motion, t, tight).trajectory
            assert (np.abs(found.torque) <= tight.torque_limit * TOLERANCE).all()
            assert_smooth(found)
            needed.append(float((np.abs(stop_motion(motion, t, free).trajectory.torque) / tight.torque_limit).max()))
    assert max(needed) > 1.1


@settings(max_examples=30)
@given(motion=with_motion(), part=st.floats(0.0, 1.0))
def test_a_stop_is_on_the_path_within_limits_and_ends_at_rest(robot, motion, part):
    t = part * motion.duration
    found = stop_motion(motion, t, robot)
    trajectory = found.trajectory
    assert not trajectory.velocity[-1].any()
    assert not trajectory.acceleration[-1].any()
    assert trajectory.duration <= motion.duration + 1e-9
    assert motion.time[found.row] - t < motion.time[1] or found.row == motion.samples - 1
    assert_within_limits(robot, trajectory)
    assert_smooth(trajectory)
    assert_on_path(robot, found, motion)


@settings(max_examples=20)
@given(motion=with_motion(), part=st.floats(0.2, 0.8), later=st.floats(0.0, 1.0))
def test_a_stop_of_a_stop_keeps_limits_too(robot, motion, part, later):
    """Excesses over a limit do not accumulate."""
    first = stop_motion(motion, part * motion.duration, robot)
    begin = motion.time[min(first.row, motion.samples - 1)]
    again = stop_motion(first.trajectory, begin + later * (first.trajectory.duration - begin), robot)
    trajectory = again.trajectory
    assert not trajectory.velocity[-1].any()
    assert (np.abs(trajectory.acceleration) <= robot.acceleration_limit * 1.001).all()
    slower = scale_motion(first.trajectory, [(0.0, 1.0), (begin + 0.04, 1.0), (begin + 0.04, 0.5)], robot)
    assert (np.abs(slower.trajectory.acceleration) <= robot.acceleration_limit * 1.001).all()


@settings(max_examples=20)
@given(motion=with_motion(), part=st.floats(0.05, 0.6))
def test_a_stop_is_about_as_quick_as_limits_allow(robot, motion, part):
    """Minimum time of one joint alone, plus jerk ramps and the other joints' needs."""
    found = stop_motion(motion, part * motion.duration, robot)
    seconds = found.trajectory.duration - motion.time[found.row]
    speed, push = np.abs(motion.velocity[found.row]), robot.acceleration_limit
    alone = float((speed / push).max())
    assert alone - 1e-9 <= seconds
    assert seconds <= min(2.0 * alone + 4.0 * float((push / robot.jerk_limit).max()) / AHEAD, motion.duration)


@settings(max_examples=25)
@given(motion=with_motion(), times=st.lists(st.floats(0.0, 2.0), min_size=1, max_size=6), data=st.data())
def test_speed_factors_keep_path_and_limits(robot, motion, times, data):
    factors = data.draw(st.lists(st.floats(0.0, 1.0), min_size=len(times), max_size=len(times)))
    rows = [*zip(sorted(times), factors, strict=True), (3.0, 0.7)]
    found = scale_motion(motion, rows, robot)
    trajectory = found.trajectory
    np.testing.assert_allclose(trajectory.position[-1], motion.position[-1], rtol=0, atol=1e-9)
    assert not trajectory.velocity[-1].any()
    assert_within_limits(robot, trajectory)
    assert_smooth(trajectory)
    assert_on_path(robot, found, motion)
    assert (np.diff(found.clock) >= 0.0).all()


def test_factor_is_followed(robot):
    motion = motions()[1]
    slow = scale_motion(motion, 0.5, robot)
    assert slow.trajectory.duration == pytest.approx(2.0 * motion.duration, rel=0.02)
    later = scale_motion(motion, lambda time: 1.0 if time < 0.3 else 0.25, robot)
    assert motion.time[later.row] == pytest.approx(0.296)
    pace = np.diff(later.clock) / np.diff(later.trajectory.time)
    assert (pace[later.trajectory.time[1:] > 0.6] < 0.2501).all()


def test_pause_and_on(robot):
    motion = motions()[1]
    found = scale_motion(motion, [(0.0, 1.0), (0.3, 1.0), (0.3, 0.0), (1.5, 0.0), (1.5, 1.0)], robot)
    paused = np.abs(found.trajectory.velocity).max(axis=1) == 0.0
    assert paused[(found.trajectory.time > 1.0) & (found.trajectory.time < 1.49)].all()
    np.testing.assert_allclose(found.trajectory.position[-1], motion.position[-1], rtol=0, atol=1e-9)
    ended = scale_motion(motion, [(0.3, 1.0), (0.3, 0.0)], robot)
    assert ended.trajectory.duration == pytest.approx(stop_motion(motion, 0.3, robot).trajectory.duration, abs=0.01)


def test_speed_factor_above_one_within_limits(robot):
    slow = scale_motion(motions()[1], 0.5, robot).trajectory
    quicker = scale_motion(slow, 1.2, robot).trajectory
    assert quicker.duration == pytest.approx(slow.duration / 1.2, rel=0.02)
    assert_within_limits(robot, quicker)
    with pytest.raises(OptionError, match=r"factors up to .* joint .* reaches its .* limit"):
        scale_motion(slow, 3.0, robot)


def test_deviation_from_path_is_independent_of_accelerations(robot):
    """A file of another program may have zeros there."""
    motion = motions()[1]
    rows = np.append(np.arange(0, motion.samples - 1, 10), motion.samples - 1)
    names = ("time", "position", "velocity", "torque")
    time, position, velocity, torque = (getattr(motion, name)[rows] for name in names)
    untold = Trajectory(motion.joint_names, time, position, velocity, np.zeros_like(position), torque)
    found = scale_motion(untold, 0.6, robot)
    off = np.abs(found.trajectory.position - untold.positions(found.clock)).max(axis=0)
    assert (off <= found.off_path).all()
    assert off.max() > 1e-7


def test_motion_that_does_not_end_at_rest(robot):
    motion = motions()[1]
    begun = motion.cut_after(40)
    assert not stop_motion(begun, 0.0, robot).trajectory.velocity.any()
    with pytest.raises(TimingError, match="does not end at rest"):
        stop_motion(begun, begun.duration, robot)


def test_pause_without_an_end_is_refused(robot):
    with pytest.raises(OptionError, match="has not"):
        scale_motion(motions()[1], lambda time: 0.0, robot)
