"""Plans with a deadline or a cancellation; tasks for static scenes alone."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from planned import post, task

import hplan
from hplan.apps.cli.main import main
from hplan.apps.execution.simulation import execute
from hplan.base.deadline import current, time_limit
from hplan.errors import MovingObstacleError, NotFoundError, NotInTimeError, OptionError, PlanCancelledError
from hplan.planning.motion import Plan
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan, solver
from hplan.planning.plans import plans_from_rest, with_all_efforts
from hplan.planning.problem import Problem
from hplan.planning.world import World, without_inside
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.scene.tracks import Track

#: Generous maximum for calls that must return at once; only a hanging call takes longer [s].
SOON = 10.0

#: Time for everything, kernels to be compiled among it [s].
ENOUGH_S = 1e6


def blocked() -> Scene:
    """A post between start and goal."""
    return task((-40.0, 30.0, 30.0, 30.0), (40.0, 30.0, 30.0, 30.0), [post("post", 0.0, 1.2, 0.3, 2.0)])


def test_bound_takes_too_long_for_a_deadline() -> None:
    with pytest.raises(OptionError, match="bound"):
        hplan.PlanOptions(deadline_s=1.0, bound=True)


def test_nothing_is_found_in_no_time(robot: Robot) -> None:
    with pytest.raises(NotInTimeError) as error:
        hplan.plan(robot, blocked(), hplan.PlanOptions(deadline_s=1e-9))
    assert isinstance(error.value, NotFoundError)
    assert error.value.exit_status == 6
    assert error.value.deadline_s == 1e-9
    assert error.value.elapsed_s >= 1e-9
    assert current() is None


def time_is_up(*_: object) -> None:
    limit = current()
    assert limit is not None
    limit.keep(2.0 * ENOUGH_S)


def test_error_lists_attempts(robot: Robot) -> None:
    """Time is up in the first stage."""
    options = hplan.PlanOptions(deadline_s=ENOUGH_S)
    with pytest.raises(NotInTimeError) as error:
        hplan.plan(robot, hplan.load_scene("orchard-row"), options, progress=time_is_up)
    assert [words.split(" for ")[0] for words in error.value.tried] == ["grasps"]
    assert "within 1e+09 ms; tried: grasps for" in error.value.message


def test_plan_is_cancelled_from_another_thread(robot: Robot) -> None:
    event = threading.Event()
    with pytest.raises(PlanCancelledError) as error:
        hplan.plan(robot, blocked(), cancel=event, progress=lambda _: event.set())
    assert error.value.elapsed_s < SOON
    with pytest.raises(PlanCancelledError):
        hplan.plan(robot, blocked(), cancel=lambda: True)
    with pytest.raises(PlanCancelledError):
        hplan.plan_tour(robot, hplan.load_scene("tour"), cancel=lambda: True)


def test_plan_that_is_cancelled_in_a_long_flood_comes_back(robot: Robot) -> None:
    """One kernel searches a grid of 3e7 nodes by brute force; a timer's thread sets the event meanwhile, or before."""
    event, locked = threading.Event(), hplan.load_scene()
    hplan.plan(robot, locked, hplan.PlanOptions(method="dense", step_deg=3.0))  # loads the kernels
    options = hplan.PlanOptions(method="dense", step_deg=0.3)
    threading.Timer(0.05, event.set).start()
    with pytest.raises(PlanCancelledError):
        hplan.plan(robot, locked, options, cancel=event)


def test_exceptions_of_callbacks_propagate(robot: Robot) -> None:
    def broken() -> bool:
        raise ZeroDivisionError("broken")

    with pytest.raises(ZeroDivisionError, match="broken"):
        hplan.plan(robot, blocked(), cancel=broken)
    with pytest.raises(OptionError) as error:
        hplan.plan(robot, blocked(), cancel=3)  # type: ignore[arg-type]
    assert error.value.option == "cancel"


def test_tour_has_to_be_complete_in_time(robot: Robot) -> None:
    with pytest.raises(NotInTimeError, match="a tour over 20 fruits"):
        hplan.plan_tour(robot, hplan.load_scene("tour"), hplan.PlanOptions(deadline_s=0.01))


def test_command_reports_timeout(tmp_path: Path) -> None:
    assert main(["plan", "--deadline", "1e-6", "--quiet", "--out", str(tmp_path)]) == 6
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (report["status"], report["error"]["kind"]) == ("failed", "NotInTimeError")
    assert report["error"]["deadline_s"] == pytest.approx(1e-9)
    assert not (tmp_path / "trajectory.csv").exists()


@pytest.mark.parametrize("name", ["table-1", "orchard-row"])
def test_anytime_result_converges_to_result_without_deadline(robot: Robot, name: str) -> None:
    scene = hplan.load_scene(name)
    alone, in_time = hplan.plan(robot, scene), hplan.plan(robot, scene, hplan.PlanOptions(deadline_s=ENOUGH_S))
    assert in_time.certificate.verified
    assert [phase.name for phase in in_time.phases] == [phase.name for phase in alone.phases]
    assert in_time.trajectory.duration <= alone.trajectory.duration + 1e-9
    told = in_time.report["deadline"]
    assert (told["deadline_s"], told["cut_short"]) == (ENOUGH_S, False)
    assert told["motions"] >= 1
    assert 0.0 < told["first_s"] <= told["elapsed_s"] < ENOUGH_S


@pytest.mark.parametrize(
    ("effort", "changes", "searches"),
    [
        ("quick", {}, 2),
        ("quick", {"obstacles": ()}, 1),
        ("quick", {"start": Start(joints_deg=(0.0, 0.0, 0.0, 0.0), velocity_rad_s=(0.1, 0.0, 0.0, 0.0))}, 1),
        ("default", {"obstacles": ()}, 2),
    ],
    ids=["far from its bound", "close to its bound", "moving", "another effort"],
)
def test_quick_search_ends_with_its_first_plans(
    robot: Robot, effort: Any, changes: dict[str, Any], searches: int
) -> None:
    """With a deadline, if they suffice: if they are close to their bound, or the arm is moving."""
    seen = []

    def solve(problem: Problem) -> Iterator[Plan]:
        seen.append(problem.effort.at_once)
        return plans_from_rest(problem)

    options = hplan.PlanOptions(effort=effort, deadline_s=ENOUGH_S)
    problem = Problem.from_scene(robot, hplan.load_scene("table-1").with_values(**changes), options)
    with time_limit(ENOUGH_S):
        assert list(with_all_efforts(solve)(problem))
    assert seen == [True, False][:searches]


def test_best_so_far_is_handed_out_at_the_deadline(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is up after the first motion."""
    found = []

    def one(problem: Problem) -> Iterator[Plan]:
        for each in solver()(problem):
            found.append(each.duration)
            yield each
            time_is_up()

    monkeypatch.setattr("hplan.planning.plan.solver", lambda *_: one)
    result = hplan.plan(robot, hplan.load_scene("orchard-row"), hplan.PlanOptions(deadline_s=ENOUGH_S))
    assert result.certificate.verified
    assert len(found) == 1
    assert result.trajectory.duration == pytest.approx(found[0])
    told = result.report["deadline"]
    assert (told["cut_short"], told["motions"]) == (True, 1)
    assert told["first_s"] <= told["elapsed_s"]


def test_each_motion_in_time_is_certified_and_quicker_than_the_one_before(robot: Robot) -> None:
    problem = Problem.from_scene(robot, hplan.load_scene("tour"), hplan.PlanOptions(deadline_s=ENOUGH_S))
    found = list(solver()(problem))
    assert len(found) > 1
    assert all(motion.certificate.verified for plan in found for motion in plan.motions)
    durations = [plan.duration for plan in found]
    assert durations == sorted(set(durations), reverse=True)


def test_robot_keeps_the_last_world_that_was_planned_in() -> None:
    robot, scene, asked = hplan.load_robot(), hplan.load_scene("tour"), hplan.PlanOptions()

    def world(scene: Scene, options: hplan.PlanOptions = asked) -> World:
        return World.of_scene(robot, scene, options)

    kept = world(scene)
    assert world(scene.model_copy(update={"goal": Goal(fruit=scene.fruits[1].name)})) is kept
    assert world(hplan.load_scene("tour")) is kept  # the same solids, read again
    for changed in (
        {"obstacles": scene.obstacles[1:]},
        {"fruits": scene.fruits[:-1]},
        {"clearance": scene.clearance + 1e-3},
    ):
        other = scene.model_copy(update=changed)
        found = world(other)
        assert found is not kept
        assert (found.solids, found.clearance) == (other.solids_with_goal, other.clearance)
        kept = world(scene)
    for options in (hplan.PlanOptions(tracking_error=1e-3), hplan.PlanOptions(sigmas=1.0)):
        assert world(scene, options) is not kept
        kept = world(scene)


AWAY = Track(times_s=(0.0, 1.0), shifts_m=((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
SCENE = task(
    (0.0, 0.0, 0.0, 0.0),
    (0.0, 45.0, 60.0, 70.0),
    [Sphere(name="bird", center=(1.0, 1.0, 1.0), radius=0.1, track=AWAY)],
    fruits=(Fruit(name="apple", center=(1.2, 0.4, 1.9), radius=0.04),),
    locked_joints=("base_yaw",),
)


def refused(ask) -> None:
    with pytest.raises(MovingObstacleError) as caught:
        ask()
    assert caught.value.obstacle == "bird"
    assert caught.value.exit_status == 2


def test_tours_bounds_worlds_and_execution(robot):
    refused(lambda: hplan.plan_tour(robot, SCENE))
    refused(lambda: plan(robot, SCENE, PlanOptions(bound=True)))
    refused(lambda: World.of_scene(robot, SCENE, PlanOptions()))
    refused(lambda: without_inside(robot, SCENE))
    result = plan(robot, SCENE)
    assert result.certificate.verified
    refused(lambda: execute(robot, SCENE, result.trajectory))


def test_planner_plans_among_moving_obstacles_until_they_rest(robot):
    planner = hplan.Planner(robot, SCENE)
    assert planner.plan().certificate.verified
    assert planner.replan().certificate.nearest_s is not None
    planner.move("bird", track=None)
    assert not planner.scene.moves
    assert planner.plan().certificate.nearest_s is None
    planner.move("bird", track=AWAY)
    assert planner.plan().certificate.nearest_s is not None
