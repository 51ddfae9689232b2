"""One clock for all input of a planner, and one state at the handover of a motion."""

from __future__ import annotations

import functools
import math
import pickle
from typing import Any

import numpy as np
import pytest
from planned import at, post, task
from spliced import assert_goes_on

from hplan.errors import InputError, NotOnMotionError, OptionError
from hplan.online.planner import Planner
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track

BALL = Sphere(name="ball", center=at(90.0, 2.0, 1.0), radius=0.05)
PASSING = BALL.model_copy(update={"track": Track(times_s=(0.0, 9.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))})
BACK = Goal(joints_deg=(-30.0, 60.0, 40.0, 30.0))
QUICK = PlanOptions(effort="quick")


def a_scene(ball: Sphere = BALL) -> Scene:
    return task((-40.0, 45.0, 40.0, 30.0), (40.0, 45.0, 40.0, 30.0), [post("post", 0.0, 1.1, 0.0, 1.5), ball])


@functools.cache
def planned(robot: Robot) -> PlanResult:
    return plan(robot, a_scene(), QUICK)


def a_planner(robot: Robot, begins_s: float | None = 0.0) -> Planner:
    """A planner with a motion that starts at a time."""
    planner = Planner(robot, a_scene(), QUICK)
    planner.last = planned(robot)
    if begins_s is not None:
        planner.set_start_time(begins_s)
    return planner


@pytest.mark.parametrize("begins_s", [0.0, 1e3, 1.7e9])
def test_loop_by_the_controllers_clock_is_where_it_should_be(robot: Robot, begins_s: float) -> None:
    """Five calls as in the README; a kept motion is followed like the first one."""
    planner, first = a_planner(robot, begins_s), planned(robot)
    result: PlanResult = planner.last
    for tick in range(5):
        clock = begins_s + 0.1 * (tick + 1)
        q = first.trajectory.state_at(clock - begins_s)[0]
        result = planner.replan(at=clock + 0.2, now=clock, measured=q)
        assert result.is_kept
        np.testing.assert_allclose(result.trajectory.state_at(clock - result.begins_s)[0], q, atol=1e-5)
        assert -1e-6 <= clock - result.begins_s < 5e-3
    stop = planner.stop_at(begins_s + 0.6, now=begins_s + 0.5, measured=q)
    assert stop.begins_s == result.begins_s
    np.testing.assert_allclose(stop.trajectory.state_at(begins_s + 0.5 - stop.begins_s)[0], q, atol=1e-5)
    # As before; and a splice continues from the kept motion.
    planner.aim(goal=BACK)
    spliced = planner.replan(at=begins_s + 0.7, now=begins_s + 0.6)
    assert not spliced.is_kept
    assert_goes_on(result, spliced)
    assert -1e-6 < spliced.begins_s + spliced.seam_s - (begins_s + 0.7) < 5e-3


def test_times_of_an_earlier_motions_clock_are_refused(robot: Robot) -> None:
    planner = a_planner(robot)
    planner.replan(at=0.5, now=0.4)
    with pytest.raises(OptionError, match=r"now = 0\.1: expected a time from 0\.4 s to .* began at 0\.4 s"):
        planner.replan(at=0.3, now=0.1)
    with pytest.raises(OptionError, match=r"expected a time from 0\.5 s"):
        planner.stop_at(0.4, now=0.5)


@pytest.mark.parametrize("joint", range(4))
def test_arm_that_is_elsewhere_is_refused(robot: Robot, joint: int) -> None:
    planner = a_planner(robot, 10.0)
    q = planned(robot).trajectory.state_at(0.3)[0].copy()
    q[joint] += 5e-3
    last = planner.last
    for ask in (
        lambda: planner.replan(at=10.4, now=10.3, measured=q),
        lambda: planner.stop_at(10.4, now=10.3, measured=q),
    ):
        with pytest.raises(NotOnMotionError) as caught:
            ask()
        error = caught.value
        assert (error.joint, error.covered, error.at_s) == (robot.joint_names[joint], 0.0, pytest.approx(10.3))
        assert error.off_by == pytest.approx(5e-3)
        assert "covers a tracking error of 0 rad" in error.message
    assert planner.last is last
    planner.options = PlanOptions(effort="quick", tracking_error=4e-3, tracking_delay_s=2e-3)
    rate = float(abs(planned(robot).trajectory.state_at(0.3)[1][joint]))
    if rate > 0.5:
        assert planner.stop_at(10.4, now=10.3, measured=q).trajectory.samples
    else:
        with pytest.raises(NotOnMotionError) as caught:
            planner.stop_at(10.4, now=10.3, measured=q)
        assert caught.value.covered == pytest.approx(4e-3 + 2e-3 * rate)


@pytest.mark.parametrize(
    ("how", "option"),
    [
        ({"now": 0.1}, "now"),
        ({"measured": (0.0, 0.0, 0.0, 0.0)}, "measured"),
        ({"at": 0.3, "measured": (0.0, 0.0, 0.0, 0.0)}, "now"),
        ({"at": 0.3, "begins_s": 1.0}, "begins_s"),
        ({"begins_s": math.nan}, "begins_s"),
        ({"begins_s": "1"}, "begins_s"),
    ],
)
def test_all_arguments_are_used(robot: Robot, how: dict[str, Any], option: str) -> None:
    planner = a_planner(robot)
    with pytest.raises(OptionError) as caught:
        planner.replan(**how)
    assert caught.value.option == option


def test_planner_with_clock_requires_start_times(robot: Robot) -> None:
    planner = Planner(robot, a_scene(), QUICK)
    assert planner.plan().begins_s == 0.0
    planner.replan(at=0.2, now=0.1)
    unknown = planner.plan()
    assert math.isnan(unknown.begins_s)
    for ask in (lambda: planner.replan(at=5.2, now=5.1), lambda: planner.stop_at(5.2)):
        with pytest.raises(InputError, match="the start time of the running motion is unknown"):
            ask()
    planner = pickle.loads(pickle.dumps(planner))
    assert planner.set_start_time(5.0) is planner.last
    assert planner.replan(at=5.2, now=5.1).begins_s == pytest.approx(5.1)
    with pytest.raises(InputError, match=r"begins at 5\.1 s on the controller's clock and at no other"):
        planner.set_start_time(5.0)
    with pytest.raises(InputError, match="plan one first"):
        Planner(robot, a_scene()).set_start_time(1.0)
    with pytest.raises(OptionError, match="at_s"):
        planner.set_start_time(math.inf)


def test_moving_obstacles_count_from_start_of_motion(robot: Robot) -> None:
    planner = Planner(robot, a_scene(PASSING), QUICK)
    result = planner.plan(begins_s=4.0)
    assert planner.scene.obstacles[1].track.times_s == (0.0, 9.0)
    assert result.scene.obstacles[1].track.times_s == (-4.0, 5.0)
    with pytest.raises(OptionError, match="begins_s = None: expected a time on the controller's clock"):
        planner.plan()
    with pytest.raises(InputError, match="at no other time"):
        planner.set_start_time(4.5)
    kept = planner.replan(at=4.5, now=4.3)
    assert kept.scene.obstacles[1].track.times_s == pytest.approx((-4.3, 4.7), abs=5e-3)
    assert planner.scene.obstacles[1].track.times_s == (0.0, 9.0)
