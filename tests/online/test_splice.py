"""A new motion spliced into a running one: the seam, the whole, and failures."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from planned import assert_clear, at, between_rows, fruit, post, task
from spliced import assert_goes_on

from hplan.certificate.certificate import certify
from hplan.certificate.digests import Digests
from hplan.errors import (
    CertificationError,
    InputError,
    NotFoundError,
    NotInTimeError,
    NotOnMotionError,
    ObstacleInTimeError,
    OptionError,
    RunningMotionBlockedError,
)
from hplan.online.planner import Planner
from hplan.online.splice import SplicedResult
from hplan.online.splice import _state_at as state_at
from hplan.optimization.timed_spline import BoundaryState
from hplan.planning import plans, start_in_motion
from hplan.planning.effort import QUICK_START
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.plans import plans_from_rest
from hplan.planning.problem import Problem
from hplan.planning.result import PlanResult
from hplan.planning.solver import motions
from hplan.robot.limits import least_duration_between
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track
from hplan.trajectory.trajectory import Trajectory, join_trajectories

POST = post("post", 0.0, 1.1, 0.0, 1.5)
BALL = Sphere(name="ball", center=at(90.0, 2.0, 1.0), radius=0.05)
BACK = Goal(joints_deg=(-30.0, 60.0, 40.0, 30.0))


def a_planner(robot: Robot, **options: object) -> tuple[Planner, PlanResult]:
    """A planner whose motion goes around a post."""
    scene = task((-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0), [POST, BALL])
    planner = Planner(robot, scene, PlanOptions(**options))
    return planner, planner.plan()


def on_the_way(robot: Robot, trajectory: Trajectory, part: float) -> tuple[float, float, float]:
    """Position of the tool at a fraction of a motion."""
    x, y, z = robot.tool_positions(trajectory.position[[int(part * (trajectory.samples - 1))]])[0].tolist()
    return x, y, z


def assert_spliced(robot: Robot, scene: Scene, before: PlanResult, result: SplicedResult) -> None:
    """Check a splice: samples up to the seam, continuity, certificate, clearance."""
    trajectory = result.trajectory
    assert_goes_on(before, result)
    now = result.scene
    assert now.obstacles == scene.obstacles
    assert now.goal == scene.goal
    assert result.certificate.verified
    assert certify(robot, now, trajectory).verified
    assert_clear(robot, now, between_rows(trajectory, np.arange(trajectory.samples), 1), touched=scene.goal.fruit)
    assert not trajectory.velocity[-1].any()
    assert result.phases[0].start_s == 0.0
    assert result.phases[-1].end_s == pytest.approx(trajectory.duration)
    assert result.motion.problem.scene is now


@pytest.mark.parametrize(
    ("effort", "now", "ahead"),
    [("quick", 0.0, 0.0), ("default", 0.0, 0.3), ("default", 0.3, 0.1), ("quick", 0.45, 0.0012)],
)
def test_to_another_goal(robot, effort, now, ahead):
    planner, before = a_planner(robot, effort=effort)
    planner.aim(goal=BACK)
    result = planner.replan(at=now + ahead, now=now)
    assert not result.is_kept
    assert result is planner.last
    assert_spliced(robot, planner.scene, before, result)
    assert 0.0 <= now - result.begins_s < 4e-3
    assert 0.0 <= result.begins_s + result.seam_s - (now + ahead) < 4e-3


def test_motion_at_its_limits_is_left_without_a_stop(robot):
    """The fastest motions are at their limits up to rounding, which must not count as beyond them."""
    scene = task((-80.0, 45.0, 40.0, 30.0), (80.0, 45.0, 40.0, 30.0), [])
    planner = Planner(robot, scene, PlanOptions(effort="quick"))
    before = planner.plan()
    uses = (np.abs(before.trajectory.acceleration) / robot.acceleration_limit).max(axis=1)
    is_fast = np.abs(before.trajectory.velocity).max(axis=1) > 0.3
    seam = int(np.where(is_fast, uses, 0.0).argmax())
    assert uses[seam] > 1.0
    planner.aim(goal=Goal(joints_deg=(-80.0, 70.0, 20.0, 30.0)))
    result = planner.replan(at=float(before.trajectory.time[seam]))
    assert_spliced(robot, planner.scene, before, result)
    speeds = np.abs(result.trajectory.velocity).max(axis=1)
    first = int(np.searchsorted(result.trajectory.time, result.seam_s))
    assert speeds[first:-20].min() > 0.05


@pytest.fixture
def around(robot) -> Planner:
    """A planner whose running motion leads around a ball, and whose new goal is on the other side of it."""
    ball = Sphere(name="in the way", center=on_the_way(robot, a_planner(robot)[1].trajectory, 0.5), radius=0.3)
    scene = task((-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0), [ball])
    planner = Planner(robot, scene, PlanOptions(effort="quick", at_once=True))
    planner.plan()
    planner.aim(goal=BACK)
    return planner


def test_first_splice_stops_the_arm_and_is_made_faster_while_it_runs(robot, around, monkeypatch):
    planner, before = around, around.last
    now = 0.7 * before.trajectory.duration
    first = planner.replan(at=now + 0.1, now=now)
    assert_spliced(robot, planner.scene, before, first)
    assert not first.is_kept
    assert not first.is_improved
    seam = int(np.searchsorted(first.trajectory.time, first.seam_s))
    assert np.abs(first.trajectory.velocity[seam:-20]).max(axis=1).min() < 1e-6  # it stops first
    end_s = first.begins_s + first.trajectory.duration
    # A motion near it takes over before the stop is complete.
    now = first.begins_s + first.seam_s + 0.02
    faster = planner.replan(at=now + 0.05, now=now)
    assert_spliced(robot, planner.scene, first, faster)
    assert not faster.is_kept
    assert faster.is_improved
    assert faster.begins_s + faster.trajectory.duration < end_s - 0.05
    # It is searched once.
    monkeypatch.setattr("hplan.online.splice.solve_scene", None)
    assert planner.replan(at=now + 0.1, now=now + 0.06).is_kept
    assert planner.last.is_improved


def test_splice_goes_back_along_the_motion_around_an_obstacle(robot, around, monkeypatch):
    planner, before = around, around.last
    monkeypatch.setattr("hplan.planning.path_finder.tree_path", None)  # no trees are needed
    result = planner.replan(at=0.9 * before.trajectory.duration)
    assert_spliced(robot, planner.scene, before, result)
    assert result.motion.origin == "recent"
    # A plan does not depend on earlier ones.
    planner.aim(start=Start(joints_deg=(35.0, 45.0, 40.0, 30.0)))
    with pytest.raises(TypeError):
        planner.plan(begins_s=10.0)


def test_faster_motion_that_is_not_found_in_time_is_searched_again(around, monkeypatch):
    planner, now = around, 0.7 * around.last.trajectory.duration
    first = planner.replan(at=now, now=now)

    def late(*_: object, **__: object) -> PlanResult:
        raise NotInTimeError(0.1, 0.1, [])

    with monkeypatch.context() as patched:
        patched.setattr("hplan.online.splice.solve_scene", late)
        kept = planner.replan(at=now + 0.1, now=now + 0.02)
    assert kept.is_kept
    assert not kept.is_improved
    assert kept.begins_s + kept.trajectory.duration == pytest.approx(first.begins_s + first.trajectory.duration)
    assert planner.replan(at=now + 0.1, now=now + 0.03).is_improved


def test_new_goal_returns_the_stop_to_follow_until_its_motion_is_known(robot):
    planner, before = a_planner(robot)
    aimed = planner.aim(goal=BACK, now=0.3, at=0.4)
    assert planner.scene.goal == BACK
    assert aimed.certificate.verified
    assert aimed.parts_s == pytest.approx(0.4)
    np.testing.assert_array_equal(aimed.trajectory.position[:101], before.trajectory.position[:101])
    assert_clear(robot, planner.scene, between_rows(aimed.trajectory, np.arange(aimed.trajectory.samples), 1))
    assert not aimed.trajectory.velocity[-1].any()
    assert planner.last is before
    assert planner.aim(now=0.3).parts_s == pytest.approx(0.3)
    # In time, a motion takes over where the stop would begin; too late, it continues from the stop.
    assert_spliced(robot, planner.scene, before, planner.replan(at=0.4, now=0.3))
    planner.last = before
    stopped = planner.use(aimed)
    assert_spliced(robot, planner.scene, stopped, planner.replan(at=0.45, now=0.42))


def test_new_goal_of_an_arm_at_rest_has_nothing_to_follow(robot):
    planner, _ = a_planner(robot)
    assert planner.aim(goal=BACK) is None
    with pytest.raises(OptionError, match=r"at .* None without `now`"):
        planner.aim(goal=BACK, at=0.3)
    with pytest.raises(OptionError, match="measured"):
        planner.aim(measured=[0.0, 0.0, 0.0, 0.0])


def test_timeout_before_new_motion_is_planned(robot):
    planner, before = a_planner(robot)
    planner.aim(goal=BACK)
    planner.options = PlanOptions(deadline_s=1e-9)
    with pytest.raises(NotInTimeError, match="the running motion up to the point where a new one may take over"):
        planner.replan(at=0.3)
    assert planner.last is before


def test_motion_still_certified_is_kept(robot):
    planner, before = a_planner(robot)
    planner.move("ball", center=at(100.0, 2.0, 1.0))
    result = planner.replan(at=0.5, now=0.4)
    assert result.is_kept
    assert result.seam_s == result.trajectory.duration
    np.testing.assert_array_equal(result.trajectory.position, before.trajectory.position[100:])
    assert_spliced(robot, planner.scene, before, result)


def test_splice_avoids_new_obstacle(robot):
    planner, before = a_planner(robot)
    planner.move("ball", center=on_the_way(robot, before.trajectory, 0.75))
    result = planner.replan(at=0.25, now=0.2)
    assert not result.is_kept
    assert_spliced(robot, planner.scene, before, result)
    # The next splice starts from the spliced motion.
    planner.aim(goal=BACK)
    again = planner.replan(at=0.5, now=0.4)
    assert_spliced(robot, planner.scene, result, again)


@pytest.mark.parametrize("delay_s", [0.0, 1e-3, 5e-3])
def test_arm_need_not_stop_for_tracking_errors_that_grow_with_velocity(robot, delay_s):
    """The certificate covers the errors."""
    planner, before = a_planner(robot, tracking_error=1e-4, tracking_delay_s=delay_s)
    planner.move("ball", center=on_the_way(robot, before.trajectory, 0.75))
    result = planner.replan(at=0.25, now=0.2)
    assert not result.is_kept
    assert_spliced(robot, planner.scene, before, result)
    tracking = {"tracking_error": 1e-4, "tracking_delay_s": delay_s}
    certificate = certify(robot, result.scene, result.trajectory, check_ends=False, rest_to_rest=False, **tracking)
    assert certificate.verified, certificate.violations
    assert np.abs(result.trajectory.velocity[:-10]).max(axis=1).min() > 0.02


def test_without_a_blend_the_arm_stops_on_its_path_first(robot, monkeypatch):
    for name in ("_move_directly", "_blend_start"):
        monkeypatch.setattr(start_in_motion, name, lambda *_: None)
    planner, before = a_planner(robot, tracking_error=1e-4, tracking_delay_s=1e-3)
    planner.aim(goal=BACK)
    result = planner.replan(at=0.4, now=0.3)
    assert_spliced(robot, planner.scene, before, result)
    stop = before.trajectory.stop_at(0.4, robot)
    seam = int(np.searchsorted(result.trajectory.time, result.seam_s - 1e-9))
    rows = stop.samples - 101
    np.testing.assert_allclose(
        result.trajectory.position[seam : seam + rows], stop.position[100 : 100 + rows], rtol=0, atol=1e-12
    )


def test_stop_and_draft_from_its_end_overlap(robot):
    _, before = a_planner(robot)
    stop = before.trajectory.stop_at(0.4, robot)
    scene = task(tuple(np.degrees(stop.position[-1])), BACK.joints_deg, [])
    onward = plan(robot, scene, PlanOptions(effort="quick")).trajectory
    one_after_other = join_trajectories([stop, onward])
    for part in (0.0, 0.5, 1.0):
        both = start_in_motion._Overlapped(stop, onward, part)
        assert both.duration == pytest.approx(max(stop.duration, part * stop.duration + onward.duration))
        ends = both.positions(np.array([0.0, both.duration]))
        np.testing.assert_allclose(ends, [stop.position[0], onward.position[-1]], rtol=0, atol=1e-12)
        clock = np.linspace(0.0, both.duration, 50)
        if part == 1.0:
            np.testing.assert_allclose(both.positions(clock), one_after_other.positions(clock), rtol=0, atol=1e-12)
        alone = clock[clock <= part * stop.duration]
        np.testing.assert_allclose(both.positions(alone), stop.positions(alone), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("clear", "chosen"), [((True,), 0), ((False, True), 1), ((False, False), 2)])
def test_first_overlap_that_is_collision_free(robot, clear, chosen):
    """The last one is taken without a look: its stop and its draft are clear."""
    _, before = a_planner(robot)
    stop, answers = before.trajectory.stop_at(0.4, robot), list(clear)
    ends = tuple(BoundaryState.of_row(before.trajectory, row) for row in (0, -1))
    program = SimpleNamespace(rate_hz=250.0, ends=ends, is_clear=lambda spline: answers.pop(0))
    motions = [start_in_motion._Overlapped(stop, before.trajectory, part) for part in (0.0, 0.5, 1.0)]
    spline = start_in_motion._first_clear(motions, program, QUICK_START.levels[0])
    assert not answers
    assert spline.duration == pytest.approx(motions[chosen].duration)


def test_effort_to_which_every_motion_is_close_takes_the_first_draft(robot):
    planner, before = a_planner(robot, effort="quick")
    row = int(np.searchsorted(before.trajectory.time, 0.25))
    planner.move("ball", center=on_the_way(robot, before.trajectory, 0.75))
    scene = planner.scene.copy_unchecked({"start": state_at(before.trajectory, row)})
    drafts = []

    def solve(problem):
        drafts.append(problem.is_draft)
        yield next(plans_from_rest(problem))
        pytest.fail("a second draft")

    (found,) = start_in_motion.from_motion(solve)(Problem.from_scene(robot, scene, planner.options))
    assert drafts == [True]
    assert found.transit.certificate.verified
    # The whole begins at the state, and so does what is said of it.
    np.testing.assert_array_equal(found.transit.problem.start, before.trajectory.position[row])
    np.testing.assert_array_equal(found.transit.waypoints[0], before.trajectory.position[row])
    np.testing.assert_array_equal(found.transit.trajectory.velocity[0], before.trajectory.velocity[row])


def test_free_way_is_the_fastest_motion_of_the_joints(robot):
    planner, before = a_planner(robot)
    planner.aim(goal=Goal(joints_deg=(-60.0, 50.0, 30.0, 30.0)))
    result = planner.replan(at=0.4, now=0.3)
    assert_spliced(robot, planner.scene, before, result)
    assert result.motion.origin == "direct"
    q, velocity, _ = before.trajectory.state_at(result.begins_s + result.seam_s)
    speeds = velocity, np.zeros(robot.dof)
    turn = planner.scene.goal.configuration - q
    least_s = least_duration_between(turn, speeds, robot.velocity_limit, robot.acceleration_limit).max()
    assert least_s <= result.trajectory.duration - result.seam_s <= least_s + 0.12


@pytest.mark.parametrize(
    ("errors", "searches"),
    [
        ([NotFoundError(["trees"])], {1}),
        ([CertificationError("the motion is not certified"), NotFoundError(["trees"])], {2}),
        ([ObstacleInTimeError("ball", 1.0, ["waiting"])], range(3, 20)),
    ],
)
def test_path_that_is_not_found_is_searched_once(robot, monkeypatch, errors, searches):
    """Not again from the end of each stop, unless the time matters."""
    searched = []

    def solve(problem):
        searched.append(problem.start)
        raise errors[min(len(searched), len(errors)) - 1]

    planner, before = a_planner(robot)
    monkeypatch.setattr(start_in_motion, "_move_directly", lambda problem, state: None)
    q, velocity, acceleration = (tuple(values.tolist()) for values in before.trajectory.state_at(0.4))
    start = Start(joints_rad=q, velocity_rad_s=velocity, acceleration_rad_s2=acceleration)
    scene = planner.scene.copy_unchecked({"start": start})
    problem = Problem.from_scene(robot, scene, planner.options)
    with pytest.raises(type(errors[0])):
        list(start_in_motion.from_motion(solve)(problem))
    assert len(searched) in searches


def test_to_a_fruit_and_on(robot):
    scene = task(
        (-40.0, 45.0, 40.0, 30.0), Goal(fruit="apple"), [POST, BALL],
        fruits=(fruit("apple", 20.0, 1.5, 1.4), fruit("pear", -20.0, 1.5, 1.4)),
    )  # fmt: skip
    planner = Planner(robot, scene)
    before = planner.plan()
    kept = planner.replan(at=0.4, now=0.3)
    assert kept.is_kept
    assert kept.picked_fruit == pytest.approx({"apple": before.picked_fruit["apple"] - kept.begins_s})
    assert kept.certificate.contact_s == pytest.approx(np.subtract(before.certificate.contact_s, kept.begins_s))
    assert_spliced(robot, planner.scene, before, kept)
    planner.aim(goal=Goal(fruit="pear"))
    result = planner.replan(at=0.5, now=0.4)
    assert_spliced(robot, planner.scene, kept, result)
    assert list(result.picked_fruit) == ["pear"]


def test_while_the_arm_goes_back_from_a_fruit(robot):
    scene = task((-40.0, 45.0, 40.0, 30.0), Goal(fruit="apple"), fruits=(fruit("apple", 20.0, 1.5, 1.4),))
    planner = Planner(robot, scene)
    before = planner.plan()
    late = before.trajectory.duration - 0.02
    result = planner.replan(at=late, now=late)
    assert result.is_kept
    assert result.picked_fruit == {"apple": 0.0}


def test_obstacle_directly_ahead_gives_stop(robot):
    """The running motion is not clear up to the seam: the stop before it, if there is one."""
    planner, before = a_planner(robot)
    last = planner.last
    ball = on_the_way(robot, before.trajectory, 0.6)
    planner.move("ball", center=ball)
    hit = 0.6 * before.trajectory.duration
    with pytest.raises(RunningMotionBlockedError, match=r"ball.*the arm can stop on its path") as caught:
        planner.replan(at=hit, now=0.1)
    error = caught.value
    assert error.certificate.verified
    np.testing.assert_array_equal(error.stop.position[0], before.trajectory.position[25])
    assert error.begins_s == before.trajectory.time[25]
    assert not error.stop.velocity[-1].any()
    assert_clear(robot, planner.scene, error.stop.position)
    assert error.data["can_stop"]
    assert pickle.loads(pickle.dumps(error)).stop.samples == error.stop.samples
    with pytest.raises(RunningMotionBlockedError, match=r"no stop on its path") as caught:
        planner.replan(at=hit, now=hit - 0.05)
    assert caught.value.stop is None
    assert not caught.value.certificate.verified
    assert planner.last is last


def test_stops_of_the_running_motion(robot):
    """Certified among the obstacles as they are now, from now on."""
    planner, before = a_planner(robot)
    found = planner.stop_at(0.3)
    assert found.certificate.verified
    assert found.certificate.digests is not None
    assert found.trajectory.duration < before.trajectory.duration
    assert planner.last is before
    planner.move("ball", center=on_the_way(robot, before.trajectory, 0.3))
    assert not planner.stop_at(0.6).certificate.verified
    late = 0.6 * before.trajectory.duration
    assert planner.stop_at(late, now=late).certificate.verified


@pytest.mark.parametrize("begins_s", [0.0, 1e4])
def test_planner_follows_a_speed_override(robot: Robot, begins_s: float) -> None:
    """At 30 % from 0.3 s on, the arm is where the planner takes it to be."""
    planner, _ = a_planner(robot)
    first = planner.plan(begins_s=begins_s)
    slow = first.scale_speed([(0.0, 1.0), (0.3, 1.0), (0.3, 0.3)])
    now, at_s = begins_s + 1.2, begins_s + 1.4
    measured = slow.trajectory.state_at(now - begins_s)[0]
    with pytest.raises(NotOnMotionError):
        planner.replan(at=at_s, now=now, measured=measured)
    used = planner.use(slow)
    assert planner.last is used
    assert (used.begins_s, used.certificate.verified) == (begins_s, True)
    assert used.phases[-1].end_s == slow.trajectory.duration > first.trajectory.duration
    planner.move("ball", center=on_the_way(robot, slow.trajectory, 0.6))
    spliced = planner.replan(at=at_s, now=now, measured=measured)
    assert not spliced.is_kept
    np.testing.assert_allclose(spliced.trajectory.state_at(now - spliced.begins_s)[0], measured, atol=1e-6)
    assert_spliced(robot, planner.scene.starting_at(spliced.begins_s), used, spliced)
    again = planner.use(spliced.scale_speed(0.5))
    assert isinstance(again, SplicedResult)
    assert again.seam_s > spliced.seam_s


def test_planner_continues_after_a_stop_that_it_uses(robot: Robot) -> None:
    planner, first = a_planner(robot)
    stop = planner.stop_at(0.4, now=0.2)
    used = planner.use(stop)
    assert used.phases[-1].end_s == stop.trajectory.duration < first.trajectory.duration
    assert used.certificate.digests == Digests(robot, used.scene, used.trajectory)
    with pytest.raises(OptionError):
        planner.replan(at=stop.trajectory.duration + 0.1)
    end = planner.replan(at=stop.trajectory.duration, now=stop.trajectory.duration - 0.05)
    assert end.certificate.verified
    np.testing.assert_allclose(end.trajectory.position[-1], first.trajectory.position[-1], atol=1e-9)


def test_only_the_last_motion_can_be_used_at_another_speed(robot: Robot) -> None:
    planner, first = a_planner(robot)
    slow = first.scale_speed(0.5)
    planner.aim(goal=BACK)
    planner.plan()
    with pytest.raises(InputError, match="not on the path"):
        planner.use(slow)
    planner.plan(begins_s=3.0)
    with pytest.raises(InputError, match="begins at"):
        planner.use(slow)
    with pytest.raises(OptionError, match="scale_speed"):
        planner.use(first)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="plan one first"):
        Planner(robot, planner.scene).use(slow)


@pytest.mark.parametrize("change", ["obstacle", "clearance", "tracking"])
def test_stop_of_a_certified_motion_is_certified_anew_after_a_change(robot, change):
    planner, before = a_planner(robot, effort="quick")
    assert planner.stop_at(0.4, now=0.2).certificate.verified
    if change == "obstacle":
        planner.add(Sphere(name="new", center=on_the_way(robot, before.trajectory, 0.3), radius=0.05))
    elif change == "clearance":
        planner.scene = planner.scene.with_values(clearance=1.0)
    else:
        planner.options = PlanOptions(tracking_error=0.5)
    assert not planner.stop_at(0.4, now=0.2).certificate.verified


@pytest.mark.parametrize(
    ("options", "moves", "grow_on"),
    [
        ({"at_once": True}, False, True),
        ({"deadline_s": 30.0}, False, True),
        ({}, False, False),
        ({"at_once": True}, True, False),
    ],
)
def test_trees_grow_on_if_a_first_motion_is_wanted_soon(robot, monkeypatch, options, moves, grow_on):
    x, y, z = robot.tool_positions(np.radians([[0.0, 45.0, 40.0, 30.0]]))[0].tolist()
    ball = Sphere(name="ball", center=(x, y, z), radius=0.3)
    if moves:
        ball = ball.model_copy(
            update={"track": Track(times_s=(0.0, 60.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 0.1)))}
        )
    scene = task((-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0), [ball])
    planner, given = Planner(robot, scene, PlanOptions(effort="quick", **options)), []
    before = planner.plan()

    def remembered(problem: Problem):
        given.append(problem.memory.pairs)
        return motions(problem)

    monkeypatch.setattr(plans, "motions", remembered)
    planner.scene = planner.scene.with_values(goal=Goal(joints_deg=(45.0, 50.0, 40.0, 30.0)))
    at_s = 0.2 * before.trajectory.duration
    for _ in range(2):
        assert planner.replan(at=at_s, now=0.1).certificate.verified
        planner.last = before
    assert given
    if not grow_on:
        assert given == [None] * len(given)
    else:
        assert given[0] is not None
        assert all(pairs is given[0] for pairs in given)
