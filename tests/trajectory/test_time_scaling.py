"""Stops and other timings on a motion's path: limits, path, rest, and what is refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.errors import OptionError, TimingError
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.trajectory.time_scaling import OFF_PATH
from hplan.trajectory.time_steps import AHEAD
from hplan.trajectory.trajectory import Retimed, Trajectory, cubic_pieces, scaled, stopped

#: By so much a limit may be passed, of acceleration and torque, and of jerk.
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
    """At rows and, for what is linear between them, everywhere."""
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
    """The cubics between rows have the rows' accelerations at both ends: the acceleration is continuous."""
    if trajectory.samples == 1:
        return
    bezier, duration = cubic_pieces(trajectory)
    bent = 6.0 * np.diff(bezier, n=2, axis=1) / duration[:, None, None] ** 2
    np.testing.assert_allclose(bent[:, 0], trajectory.acceleration[:-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(bent[:, 1], trajectory.acceleration[1:], rtol=0, atol=1e-6)


def assert_on_path(robot: Robot, retimed: Retimed, motion: Trajectory) -> None:
    """The tool is where it is at some time of the motion, to a tenth of a millimetre, between rows too."""
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
    assert off.max() <= OFF_PATH + 1e-5  # the places that are looked at are a little apart


@settings(max_examples=30)
@given(motion=with_motion(), part=st.floats(0.0, 1.0))
def test_a_stop_is_on_the_path_within_limits_and_ends_at_rest(robot, motion, part):
    t = part * motion.duration
    found = stopped(motion, t, robot)
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
    """What a limit is passed by does not add up."""
    first = stopped(motion, part * motion.duration, robot)
    begin = motion.time[min(first.row, motion.samples - 1)]
    again = stopped(first.trajectory, begin + later * (first.trajectory.duration - begin), robot)
    trajectory = again.trajectory
    assert not trajectory.velocity[-1].any()
    assert (np.abs(trajectory.acceleration) <= robot.acceleration_limit * 1.001).all()
    slower = scaled(first.trajectory, [(0.0, 1.0), (begin + 0.04, 1.0), (begin + 0.04, 0.5)], robot)
    assert (np.abs(slower.trajectory.acceleration) <= robot.acceleration_limit * 1.001).all()


@settings(max_examples=20)
@given(motion=with_motion(), part=st.floats(0.05, 0.6))
def test_a_stop_is_about_as_quick_as_limits_allow(robot, motion, part):
    """Beside the least time that one joint alone needs, the jerk's ramps and what the other joints do come to it."""
    found = stopped(motion, part * motion.duration, robot)
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
    found = scaled(motion, rows, robot)
    trajectory = found.trajectory
    np.testing.assert_allclose(trajectory.position[-1], motion.position[-1], rtol=0, atol=1e-9)
    assert not trajectory.velocity[-1].any()
    assert_within_limits(robot, trajectory)
    assert_smooth(trajectory)
    assert_on_path(robot, found, motion)
    assert (np.diff(found.clock) >= 0.0).all()


def test_a_factor_is_followed(robot):
    motion = motions()[1]
    slow = scaled(motion, 0.5, robot)
    assert slow.trajectory.duration == pytest.approx(2.0 * motion.duration, rel=0.02)
    later = scaled(motion, lambda time: 1.0 if time < 0.3 else 0.25, robot)
    assert motion.time[later.row] == pytest.approx(0.296)
    pace = np.diff(later.clock) / np.diff(later.trajectory.time)
    assert (pace[later.trajectory.time[1:] > 0.6] < 0.2501).all()


def test_a_pause_and_on(robot):
    motion = motions()[1]
    found = scaled(motion, [(0.0, 1.0), (0.3, 1.0), (0.3, 0.0), (1.5, 0.0), (1.5, 1.0)], robot)
    paused = np.abs(found.trajectory.velocity).max(axis=1) == 0.0
    assert paused[(found.trajectory.time > 1.0) & (found.trajectory.time < 1.49)].all()
    np.testing.assert_allclose(found.trajectory.position[-1], motion.position[-1], rtol=0, atol=1e-9)
    ended = scaled(motion, [(0.3, 1.0), (0.3, 0.0)], robot)
    assert ended.trajectory.duration == pytest.approx(stopped(motion, 0.3, robot).trajectory.duration, abs=0.01)


def test_more_than_full_speed_where_there_is_room(robot):
    slow = scaled(motions()[1], 0.5, robot).trajectory
    quicker = scaled(slow, 1.2, robot).trajectory
    assert quicker.duration == pytest.approx(slow.duration / 1.2, rel=0.02)
    assert_within_limits(robot, quicker)
    with pytest.raises(OptionError, match=r"factors up to .* joint .* is at its .* limit"):
        scaled(slow, 3.0, robot)


def test_how_far_it_is_off_the_path_whatever_the_accelerations_say(robot):
    """A file of another program may have zeros there."""
    motion = motions()[1]
    rows = np.append(np.arange(0, motion.samples - 1, 10), motion.samples - 1)
    names = ("time", "position", "velocity", "torque")
    time, position, velocity, torque = (getattr(motion, name)[rows] for name in names)
    untold = Trajectory(motion.joint_names, time, position, velocity, np.zeros_like(position), torque)
    found = scaled(untold, 0.6, robot)
    off = np.abs(found.trajectory.position - untold.positions(found.clock)).max(axis=0)
    assert (off <= found.off_path).all()
    assert off.max() > 1e-7


def test_a_motion_that_does_not_end_at_rest(robot):
    motion = motions()[1]
    begun = motion.until(40)
    assert not stopped(begun, 0.0, robot).trajectory.velocity.any()
    with pytest.raises(TimingError, match="does not end at rest"):
        stopped(begun, begun.duration, robot)


def test_a_pause_without_an_end_is_refused(robot):
    with pytest.raises(OptionError, match="has not"):
        scaled(motions()[1], lambda time: 0.0, robot)
