"""Bounds of durations: exact where that is known, below every certified motion, and of use."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from planned import fruit, post, task
from studies.planar import random_scene

import hplan.planning.lower_bound.duration_bound as module
from hplan.apps.cli.main import main
from hplan.certificate.certificate import LIMIT_TOLERANCE
from hplan.errors import BoundError, HplanError
from hplan.planning.lower_bound.duration_bound import DurationBound, duration_bound
from hplan.planning.motion import motion_limits
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.limits import rest_to_rest
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene

BOUND = PlanOptions(bound=True)


def bound_of(result: PlanResult, duration_s: float | None = None) -> DurationBound:
    """The bound for the transit of a plan, by itself."""
    motion = result.motion
    duration = motion.trajectory.duration if duration_s is None else duration_s
    return duration_bound(motion.task.world, motion.task.problem, motion_limits(motion.task), duration)


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds on coarse grids alone, which take a tenth of the time."""
    monkeypatch.setattr(module, "EACH_JOINT", (24,))
    monkeypatch.setattr(module, "ONE_JOINT", (36,))


def tolerated(distance: float, velocity: float, acceleration: float, jerk: float | None) -> float:
    """Duration of the fastest motion of a joint that the certificate just lets pass."""
    limits = [None if limit is None else LIMIT_TOLERANCE * limit for limit in (velocity, acceleration, jerk)]
    return rest_to_rest(np.array([distance]), *limits).item()


def test_the_reference_motion_is_near_its_bound(robot: Robot, scene: Scene) -> None:
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


def test_the_base_counts_by_its_own_fastest_motion_with_jerk(robot: Robot) -> None:
    scene = task([0, 10, 10, 10], [90, 40, 20, 30], [post("trunk", 45.0, 1.6, 0.0, 1.2)])
    bounds = [plan(arm, scene, BOUND).bound for arm in (robot, replace(robot, jerk_limit=None))]
    limits = robot.velocity_limit[0], robot.acceleration_limit[0]
    for bound, jerk in zip(bounds, (robot.jerk_limit[0], None), strict=True):
        assert bound is not None
        assert (bound.method, bound.joint) == ("joints", "base_yaw")
        exact = tolerated(0.5 * np.pi, *limits, jerk)
        assert 0.9999 * exact < bound.seconds <= exact


def test_a_motion_that_is_too_fast_to_exist_is_an_error(robot: Robot, scene: Scene) -> None:
    result = plan(robot, scene)
    for duration in (1.0, 1.4):  # by the slowest joint alone, by reachability
        with pytest.raises(BoundError, match="impossible") as error:
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
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.01, 0.03]))
def test_no_certified_motion_is_below_its_bound(number: int, clearance: float) -> None:
    robot = load_robot()
    scene = random_scene(robot, 7, number).scene.model_copy(update={"clearance": clearance})
    try:
        result = plan(robot, scene, BOUND)
    except BoundError:
        raise
    except HplanError:
        return
    assert result.bound is not None
    assert 0.0 < result.bound.joints_s <= result.bound.seconds <= result.trajectory.duration


@pytest.mark.usefixtures("coarse")
def test_the_command_says_how_far_from_the_fastest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "--bound", "--out", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    bound = json.loads((tmp_path / "report.json").read_text())["bound"]
    percents = float(said.partition("at most ")[2].partition(" %")[0])
    assert bound["gap"] <= percents / 100.0 < bound["gap"] + 0.002
    assert f"none is shorter than {bound['bound_s']:.3f} s" in said
