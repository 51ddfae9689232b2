"""Picking tours: order, drop-offs, deadlines, and certificates of the whole."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from script_loader import load_script

from hplan.base import ties
from hplan.certificate.certificate import Certificate
from hplan.certificate.limit_use import LimitUse
from hplan.collision.coal_scene import CoalScene
from hplan.collision.held_objects import holding
from hplan.errors import BlockedError, DetourError, TourError, UnreachableError
from hplan.planar.family_reader import family_of
from hplan.planning.motion import Motion
from hplan.planning.options import PlanOptions
from hplan.planning.problem import Problem
from hplan.robot.model import Robot
from hplan.scene.file import save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere
from hplan.tour import ordering
from hplan.tour.motions import CARRIED, carried_fruit
from hplan.tour.moves import Joins, Moves, Stop
from hplan.tour.ordering import SEGMENT, Costs, Visits, best, nearest_tour, order_grasps
from hplan.tour.tour import TourOptions, TourPlanner, TourResult, plan_tour
from hplan.trajectory.trajectory import Trajectory, read_csv

OPTIONS = PlanOptions(rate_hz=100.0)
DROP = Goal(joints_deg=(100.0, 60.0, 80.0, 60.0))


def fruit(robot: Robot, name: str, joints_deg: Sequence[float], radius: float = 0.04) -> Fruit:
    """A fruit at the tool's position at these joints."""
    x, y, z = robot.tool_positions(np.radians(joints_deg)).tolist()
    return Fruit(name=name, center=(x, y, z), radius=radius)


def orchard(robot: Robot, *more: Fruit, obstacles: Sequence[Any] = (), fruits: bool = True) -> Scene:
    """Four fruits, left and right by turns, and a post between them."""
    yaws = {"a": 40.0, "b": -40.0, "c": 60.0, "d": -20.0}
    hanging = [fruit(robot, name, (yaw, 30.0, 40.0, 20.0)) for name, yaw in yaws.items()] if fruits else []
    return Scene(
        name="small orchard",
        start=Start(joints_deg=(0.0, 80.0, 80.0, 60.0)),
        goal=Goal(joints_deg=(0.0, 80.0, 80.0, 60.0)),
        obstacles=(Box(name="post", center=(1.0, 0.1, 1.0), size=(0.05, 0.05, 2.0)), *obstacles),
        fruits=(*hanging, *more),
    )


@pytest.fixture(scope="module")
def scene(robot: Robot) -> Scene:
    return orchard(robot)


@pytest.fixture(scope="module")
def tour(robot: Robot, scene: Scene) -> TourResult:
    return plan_tour(robot, scene, OPTIONS, tour=TourOptions(compare=True))


@pytest.fixture(scope="module")
def carried(robot: Robot, scene: Scene) -> TourResult:
    return plan_tour(robot, scene, OPTIONS, tour=TourOptions(drop_off=DROP, every=2, back=True))


def times_of_contact(result: TourResult) -> dict[str, tuple[float, float]]:
    """Times when the last link may touch the goal's fruit, by fruit.

    From the stand-off on; without one, during the whole leg.
    """
    return {
        leg.fruit: (
            next((phase.start_s for phase in leg.phases if phase.name == "approach"), leg.begin_s),
            result.picked[leg.fruit],
        )
        for leg in result.legs
        if leg.fruit is not None
    }


def rests_of(result: TourResult) -> list[float]:
    """When the arm is at rest for certain: at both ends, at each fruit and at the drop-off."""
    return sorted({0.0, *result.picked.values(), *result.dropped.values(), result.duration})


def rows_at(motion: Trajectory, times: Sequence[float]) -> list[int]:
    return [int(np.argmin(np.abs(motion.time - at))) for at in times]


def assert_sound(robot: Robot, scene: Scene, result: TourResult) -> None:
    """Continuous, at rest at fruits and drop-off, clear of everything that is still there, the tool at each fruit."""
    motion = result.trajectory
    assert result.certificate.verified
    assert result.duration == pytest.approx(sum(leg.trajectory.duration for leg in result.legs), abs=1e-9)
    np.testing.assert_allclose(motion.position[0], scene.start.configuration, rtol=0, atol=1e-9)
    ends = [0.0, *(phase.end_s for leg in result.legs for phase in leg.phases)]
    rows = rows_at(motion, ends)
    np.testing.assert_allclose(motion.time[rows], ends, rtol=0, atol=1e-9)
    assert ends == sorted(ends)
    np.testing.assert_allclose(motion.velocity[rows_at(motion, rests_of(result))], 0.0, rtol=0, atol=1e-9)
    # Seams in motion are as smooth as the rest: velocity and acceleration go on, and jerk keeps its limit.
    jerk = np.diff(motion.acceleration, axis=0) / np.diff(motion.time)[:, None]
    assert (np.abs(jerk) <= robot.jerk_limit * 1.001).all()
    mean = 0.5 * (motion.velocity[1:] + motion.velocity[:-1])
    slip = np.diff(motion.position, axis=0) / np.diff(motion.time)[:, None] - mean
    assert (np.abs(slip) <= robot.jerk_limit * np.diff(motion.time)[:, None] ** 2 / 12.0 + 1e-6).all()
    for one, other in itertools.pairwise(phase for leg in result.legs for phase in leg.phases):
        assert one.end_s == other.start_s
    turned = np.abs(np.diff(motion.position, axis=0))
    assert (turned <= robot.velocity_limit * np.diff(motion.time)[:, None] * 1.001 + 1e-9).all()
    centers = {hanging.name: np.array(hanging.center) for hanging in scene.fruits}
    for name, at in result.picked.items():
        row = int(np.argmin(np.abs(motion.time - at)))
        np.testing.assert_allclose(robot.tool_positions(motion.position[row]), centers[name], rtol=0, atol=1e-6)
    contact = times_of_contact(result)
    assert all(
        (leg.grasp.distance > 0.0) == any(phase.name == "approach" for phase in leg.phases)
        for leg in result.legs
        if leg.grasp is not None
    )
    checker_at = checkers(robot, scene, result)
    for row in range(0, motion.samples, 3):
        checker = checker_at(motion.time[row])
        distances = checker.distances(motion.position[row])
        for column, name in enumerate(checker.obstacle_names):
            begin, end = contact.get(name, (math.inf, -math.inf))
            touching = begin - 1e-9 <= motion.time[row] <= end
            assert distances[: -1 if touching else None, column].min() > 0.0, (name, motion.time[row])


def checkers(robot: Robot, scene: Scene, result: TourResult) -> Callable[[float], CoalScene]:
    """The remaining obstacles at a time, in coal."""
    made: dict[int, CoalScene] = {}

    def at(time: float) -> CoalScene:
        here = [solid for solid in scene.solids_with_goal if result.picked.get(solid.name, math.inf) > time]
        if len(here) not in made:  # fruits go one by one
            made[len(here)] = CoalScene(robot, here)
        return made[len(here)]

    return at


def test_tours_over_other_fruits_have_the_motions_of_those_before(robot, scene):
    options = TourOptions(drop_off=DROP, every=2, back=True)
    planner = TourPlanner(robot, scene, OPTIONS, options, "abcd")
    counts = []
    for names in ("abc", "bcd", "dab", "abcd", "bc"):
        result = planner.run(names)
        assert set(result.order) == set(names)
        assert_sound(robot, scene, result)
        counts.append(result.report["planner"]["motions_planned"])
    alone = plan_tour(robot, scene, OPTIONS, fruits=list("bcd"), tour=options).report["planner"]["motions_planned"]
    assert counts[1] - counts[0] < 0.75 * alone


def test_order_is_best_and_certified(robot: Robot, scene: Scene, tour: TourResult) -> None:
    assert_sound(robot, scene, tour)
    assert set(tour.order) == {"a", "b", "c", "d"}
    assert tour.unreached == ()
    assert [leg.fruit for leg in tour.legs] == list(tour.order)
    assert all([phase.name for phase in leg.phases] == ["transit", "approach", "retreat"] for leg in tour.legs)
    totals = tour.report["totals_s"]
    assert totals["best"] == pytest.approx(tour.duration, abs=1e-6)
    assert totals["best"] <= totals["nearest"] + 1e-9
    assert totals["best"] < totals["given"] - 1.0  # left and right by turns
    assert tour.order[:2] in {("b", "d"), ("d", "b"), ("a", "c"), ("c", "a")}


def test_costs_are_on_a_raster(robot: Robot, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions last whole periods, so that sums tie in any order of addition."""
    seen: list[Costs] = []
    monkeypatch.setattr("hplan.tour.tour.nearest_tour", lambda costs: seen.append(costs) or nearest_tour(costs))
    plan_tour(robot, scene, OPTIONS, tour=TourOptions(order="nearest", drop_off=DROP, back=True))
    assert seen
    for costs in seen:
        for values in (costs.first, costs.onward, costs.drop, costs.away, costs.last):
            np.testing.assert_array_equal(values, ties.on_raster(values))


def test_report_is_json_with_times(tour: TourResult) -> None:
    report = json.loads(json.dumps(tour.report))
    assert report["order"] == list(tour.order)
    assert [leg["picked_s"] for leg in report["legs"]] == list(tour.picked.values())
    ends = [leg["begin_s"] + leg["duration_s"] for leg in report["legs"]]
    np.testing.assert_allclose([leg["begin_s"] for leg in report["legs"]], [0.0, *ends[:-1]], atol=1e-9)
    assert report["trajectory"]["duration_s"] == tour.duration
    for leg, data in zip(tour.legs, report["legs"], strict=True):
        assert leg.begin_s < tour.picked[leg.fruit] < leg.begin_s + leg.trajectory.duration
        assert leg.trajectory.time[0] == 0.0
        assert data["verified"]


# Carrying


def test_drop_off_after_two(robot: Robot, scene: Scene, carried: TourResult) -> None:
    assert_sound(robot, scene, carried)
    words = [[phase.name for phase in leg.phases] for leg in carried.legs]
    to_fruit = ["transit", "approach", "retreat"]
    assert words == [to_fruit, [*to_fruit, "drop"], to_fruit, [*to_fruit, "drop"], ["return"]]
    assert carried.legs[-1].fruit is None
    motion, drop = carried.trajectory, DROP.listed_joints()
    first, second = (carried.legs[i].trajectory.position[-1] for i in (1, 3))
    np.testing.assert_allclose([first, second], [drop, drop], rtol=0, atol=1e-9)
    np.testing.assert_allclose(motion.position[-1], scene.start.configuration, rtol=0, atol=1e-9)
    times = list(carried.dropped.values())
    assert list(carried.dropped) == list(carried.order)
    assert times[0] == times[1] < times[2] == times[3] < carried.duration
    assert all(carried.picked[name] < carried.dropped[name] for name in carried.order)


def test_carried_fruit_is_clear(robot: Robot, scene: Scene, carried: TourResult) -> None:
    """Between picking and letting go there is a fruit at the tool."""
    thick = holding(robot, [carried_fruit(0.04)])
    np.testing.assert_allclose(family_of(thick).arm.half_widths, [0.05, 0.04, 0.04], rtol=0, atol=1e-12)
    motion, contact = carried.trajectory, times_of_contact(carried)
    checker_at = checkers(thick, scene, carried)
    for name in carried.order:
        inside = (motion.time >= carried.picked[name]) & (motion.time <= carried.dropped[name])
        for row in np.flatnonzero(inside)[::4]:
            checker = checker_at(motion.time[row])
            distances = checker.distances(motion.position[row])
            for column, other in enumerate(checker.obstacle_names):
                begin, end = contact.get(other, (math.inf, -math.inf))
                touching = begin - 1e-9 <= motion.time[row] <= end
                rows = [name not in ("hand", "tool0", CARRIED) or not touching for name in checker.mover_names]
                assert distances[rows, column].min() > 0.0


def test_gap_that_only_the_empty_arm_fits_into(robot: Robot) -> None:
    """Next to the fruit, 35 mm from the last link's axis on both sides.

    The link is 30 mm thick empty, 40 mm with a fruit.
    """
    x, y, z = fruit(robot, "a", (0.0, 30.0, 40.0, 20.0)).center
    sides = [Sphere(name=f"side {s}", center=(x, y + s * 0.085, z), radius=0.05) for s in (-1, 1)]
    between = fruit(robot, "between", (0.0, 30.0, 40.0, 20.0))
    scene = orchard(robot, between, obstacles=sides)
    assert plan_tour(robot, scene, OPTIONS, fruits=["between"]).unreached == ()
    result = plan_tour(robot, scene, OPTIONS, fruits=["a", "between"], tour=TourOptions(drop_off=DROP))
    assert result.order == ("a",)
    assert isinstance(result.unreached[0].error, BlockedError)
    assert {o["obstacle"] for o in result.unreached[0].error.obstacles} <= {"side -1", "side 1"}


# Fruits that are not picked


def test_unreachable_fruits_are_listed_with_reasons(robot: Robot) -> None:
    boxed = fruit(robot, "boxed", (20.0, 30.0, 40.0, 20.0))
    far = Fruit(name="far", center=(5.0, 0.0, 1.0), radius=0.04)
    wall = Box(name="crate", center=boxed.center, size=(0.3, 0.3, 0.3))
    scene = orchard(robot, boxed, far, obstacles=[wall])
    result = plan_tour(robot, scene, OPTIONS, fruits=["far", "a", "boxed"])
    assert_sound(robot, scene, result)
    assert result.order == ("a",)
    why = {item.fruit: item.error for item in result.unreached}
    assert set(why) == {"far", "boxed"}
    assert isinstance(why["far"], UnreachableError)
    assert why["far"].reason == "too_far"
    assert isinstance(why["boxed"], BlockedError)
    assert why["boxed"].obstacles[0]["obstacle"] == "crate"
    listed = {item["fruit"]: item["error"]["kind"] for item in result.report["unreached"]}
    assert listed == {"far": "UnreachableError", "boxed": "BlockedError"}


@pytest.mark.parametrize("options", [TourOptions(), TourOptions(drop_off=DROP, back=True)], ids=["kept", "carried"])
def test_fruit_behind_another_comes_once_that_is_picked(robot: Robot, options: TourOptions) -> None:
    big = fruit(robot, "big", (20.0, 30.0, 40.0, 20.0), 0.12)
    x, y, z = big.center
    behind = Fruit(name="behind", center=(x, y, z + 0.135), radius=0.01)
    scene = orchard(robot, behind, big, fruits=False)
    alone = plan_tour(robot, scene, OPTIONS, fruits=["big"])
    assert alone.order == ("big",)
    with pytest.raises(TourError) as error:
        plan_tour(robot, scene, OPTIONS, fruits=["behind"])
    assert "big" in str(error.value)
    result = plan_tour(robot, scene, OPTIONS, tour=options)
    assert result.order == ("big", "behind")
    assert result.unreached == ()
    assert result.report["planner"]["stages"] == 2
    assert_sound(robot, scene, result)
    if options.back:
        np.testing.assert_allclose(result.trajectory.position[-1], scene.start.configuration, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("far", "allowed"), [("e", 3.0), ("ef", 2.4)])
def test_fruits_that_lengthen_a_tour_too_much_are_left_out(robot: Robot, far: str, allowed: float) -> None:
    """One fruit far from all others, and two that share the way: without one of them it would be hardly shorter."""
    yaws = {"e": 168.0, "f": 176.0}
    scene = orchard(robot, *(fruit(robot, name, (yaws[name], 30.0, 40.0, 20.0)) for name in far))

    def cost_s(*fruits: str) -> float:
        """Duration with stops at stand-offs."""
        planner = TourPlanner(robot, scene, OPTIONS, TourOptions(back=True), fruits)
        return planner._stage(planner._whole, [one for one in scene.fruits if one.name in fruits]).visits.cost

    adds_s = (cost_s(*"abcd", *far) - cost_s(*"abcd")) / len(far)
    assert adds_s > allowed > max(2.0, cost_s(*"abcd", *far) - cost_s(*"bcd", *far))
    result = plan_tour(robot, scene, OPTIONS, tour=TourOptions(back=True, max_detour_s=allowed))
    assert set(result.order) == set("abcd")
    assert [(item.fruit, item.reason) for item in result.unreached] == [(name, None) for name in far]
    for item in result.unreached:
        assert isinstance(item.error, DetourError)
        assert (item.error.adds_s, item.error.allowed_s) == (pytest.approx(adds_s, abs=0.02), allowed)
    assert_sound(robot, scene, result)
    assert set(plan_tour(robot, scene, OPTIONS, tour=TourOptions(back=True, max_detour_s=9.0)).order) == {*"abcd", *far}


def test_a_tour_of_detours_only_is_an_error(robot: Robot, scene: Scene) -> None:
    with pytest.raises(TourError, match=r"'a': it would lengthen the tour by .* s; 0\.1 s are allowed") as caught:
        plan_tour(robot, scene, OPTIONS, tour=TourOptions(max_detour_s=0.1))
    assert all(isinstance(error, DetourError) for _, error in caught.value.reasons)
    assert len(caught.value.reasons) == 4


def test_no_fruit_at_all_is_an_error_with_all_reasons(robot: Robot) -> None:
    far = [Fruit(name=f"far {i}", center=(5.0 + i, 0.0, 1.0), radius=0.04) for i in range(5)]
    with pytest.raises(TourError, match="none of 5 fruits can be picked; 'far 0': the tool cannot reach") as error:
        plan_tour(robot, orchard(robot, *far, fruits=False), OPTIONS)
    assert error.value.exit_status == 3
    assert [name for name, _ in error.value.reasons] == [item.name for item in far]
    assert json.loads(json.dumps(error.value.as_dict()))["unreached"][4]["error"]["reason"] == "too_far"


def moves_of_seconds(robot: Robot, seconds: dict[tuple[int, int], float], stops: Sequence[Stop]) -> Moves:
    """Moves among stops; some motions are known, named by their ends."""
    scene = orchard(robot, fruits=False)
    problem = Problem.from_scene(robot, scene, OPTIONS)
    moves = Moves(problem, None)
    for stop in stops:
        moves.add(stop)
    shown = Certificate(True, math.inf, None, LimitUse(0.0, 0.0, 0.0, 0.0), 0, ())
    for (a, b), duration in seconds.items():
        there, back = (SimpleNamespace(duration=duration, ends=ends) for ends in ((a, b), (b, a)))
        there.reversal, back.reversal = back, there
        moves.keep(a, b, False, Motion("transit", there, shown, problem))  # type: ignore[arg-type]
    return moves


def test_motions_are_joined_where_that_is_quicker(robot: Robot) -> None:
    stops = [Stop(np.radians([turn, 80.0, 80.0, 60.0])) for turn in (0.0, 10.0, 20.0, 30.0)]
    seconds = {(0, 1): 1.0, (2, 1): 1.5, (0, 2): 3.0, (2, 3): 0.5, (0, 3): 2.9}

    def path(moves: Moves, a: int, b: int) -> tuple[float, list[tuple[int, int]]]:
        taken = moves.take(a, b, False) or []
        assert [ends for ends, _ in taken] == [motion.trajectory.ends for _, motion in taken]
        return sum(motion.trajectory.duration for _, motion in taken), [ends for ends, _ in taken]

    moves = moves_of_seconds(robot, seconds, stops)
    assert path(moves, 0, 2) == (2.5, [(0, 1), (1, 2)])
    assert path(moves, 2, 0) == (2.5, [(2, 1), (1, 0)])
    assert path(moves, 0, 3) == (2.9, [(0, 3)])
    assert moves.seconds(np.array([3, 0, 2]), False)[1, 2] == 2.5
    # At a stop at a fruit, no motion to other places passes by.
    moves = moves_of_seconds(robot, seconds, [*stops[:1], Stop(stops[1].configuration, "a"), *stops[2:]])
    assert path(moves, 0, 2) == (3.0, [(0, 2)])


def test_joins_equal_joint_optimum_over_stops() -> None:
    """Against sweeps over all stops, as motions arrive in sequence, some of them twice."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        stops = rng.permutation(60)[:18].tolist()
        shut = set(stops[:4])
        joins, direct = Joins(lambda stop, shut=shut: stop not in shut), np.full((60, 60), math.inf)
        np.fill_diagonal(direct, 0.0)
        for a, b in (rng.choice(stops, 2, replace=False).tolist() for _ in range(50)):
            seconds = math.inf if rng.random() < 0.1 else float(rng.uniform(0.5, 3.0))
            joins.add(a, b, seconds)
            direct[a, b] = direct[b, a] = min(direct[a, b], seconds)
        whole = direct.copy()
        for stop in set(stops) - shut:
            whole = np.minimum(whole, whole[:, stop, None] + whole[stop])
        pairs = np.array(list(itertools.permutations(stops, 2)))
        np.testing.assert_allclose(joins.seconds(*pairs.T), whole[tuple(pairs.T)], atol=1e-4)
        for a, b in pairs.tolist():
            way = joins.way(a, b)
            assert (way is None) == math.isinf(whole[a, b])
            if way is not None:
                assert (way[0], way[-1]) == (a, b)
                assert not shut & set(way[1:-1])
                assert sum(direct[pair] for pair in itertools.pairwise(way)) <= joins.duration_between(a, b) + 1e-9


def test_motions_flow_where_that_is_quicker(robot: Robot, scene: Scene, tour: TourResult) -> None:
    stopping = plan_tour(
        robot, scene, replace(OPTIONS, effort="quick"), fruits=list(tour.order), tour=TourOptions(order="given")
    )
    assert_sound(robot, scene, stopping)
    assert moving_seams(stopping) == []
    assert len(moving_seams(tour)) >= 4
    assert tour.duration < 0.95 * stopping.duration
    # With stops between legs only approaches flow, and each leg can be run by itself.
    legs = plan_tour(robot, scene, OPTIONS, tour=TourOptions(stops=True))
    assert_sound(robot, scene, legs)
    assert {second for _, second in moving_seams(legs)} == {"approach"}
    assert tour.duration <= legs.duration <= stopping.duration
    for leg in legs.legs:
        assert not leg.trajectory.velocity[[0, -1]].any()


def moving_seams(result: TourResult) -> list[tuple[str, str]]:
    """Between which phases the arm is in motion."""
    phases = [phase for leg in result.legs for phase in leg.phases]
    rows = rows_at(result.trajectory, [phase.end_s for phase in phases])
    moving = np.abs(result.trajectory.velocity[rows]).max(axis=1) > 1e-3
    return [(one.name, other.name) for one, other, moves in zip(phases, phases[1:], moving, strict=False) if moves]


def test_approaches_and_retreats_in_motion_are_straight(robot: Robot, tour: TourResult) -> None:
    for leg in tour.legs:
        assert leg.grasp is not None
        for phase in leg.phases:
            if phase.name not in ("approach", "retreat"):
                continue
            first, last = rows_at(tour.trajectory, (phase.start_s, phase.end_s))
            clock = np.linspace(phase.start_s, phase.end_s, 10 * (last - first) + 1)
            tool = robot.tool_positions(tour.trajectory.positions(clock))
            tip = robot.tool_positions(leg.grasp.goal)
            line = robot.tool_positions(leg.grasp.standoff) - tip
            line /= np.linalg.norm(line)
            along = (tool - tip) @ line
            off = np.linalg.norm(tool - tip - along[:, None] * line, axis=1)
            assert off.max() < 1e-4
            assert along.max() >= leg.grasp.distance - 1e-4


# The command


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("plan_tour")


@pytest.fixture(scope="module")
def scene_path(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "orchard.yaml"
    save_scene(scene, path)
    return path


def test_command_writes_one_csv(
    script: ModuleType, scene_path: Path, tmp_path: Path, tour: TourResult, capsys: pytest.CaptureFixture[str]
) -> None:
    own = "tour-01-own.csv"  # no tour's: there is no report of one
    (tmp_path / own).touch()
    assert script.main([str(scene_path), "--out", str(tmp_path), "--rate", "100", "--compare"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.html", own, "tour.csv", "tour.json"]
    written = read_csv(tmp_path / "tour.csv")
    np.testing.assert_array_equal(written.position, tour.trajectory.position)
    report = json.loads((tmp_path / "tour.json").read_text())
    assert report["order"] == list(tour.order)
    assert report["files"] == ["tour.csv"]
    shown = capsys.readouterr().out
    for text in (
        *tour.order,
        "transit",
        "approach",
        "retreat",
        f"{tour.duration:.3f} s",
        "nearest",
        "given",
        "verified",
    ):
        assert text in shown
    assert "drop" not in shown


def test_command_writes_one_csv_for_each(script: ModuleType, scene_path: Path, tmp_path: Path) -> None:
    drop = ["--drop-off-joints", "100", "60", "80", "60", "--every", "2", "--back", "--csv", "each"]
    options = [*drop, "--fruits", "b", "d", "--rate", "100", "--quiet", "--order", "given"]
    assert script.main([str(scene_path), "--out", str(tmp_path), *options]) == 0
    names = ["tour-01-b.csv", "tour-02-d.csv", "tour-03-return.csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.html", *names, "tour.json"]
    legs = [read_csv(tmp_path / name) for name in names]
    report = json.loads((tmp_path / "tour.json").read_text())
    assert report["files"] == names
    assert sum(leg.duration for leg in legs) == pytest.approx(report["trajectory"]["duration_s"], abs=1e-9)
    for one, other in itertools.pairwise(legs):
        np.testing.assert_allclose(one.position[-1], other.position[0], rtol=0, atol=1e-9)


def test_command_lists_unpicked_fruit(
    script: ModuleType, robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = Fruit(name="far [one]", center=(5.0, 0.0, 1.0), radius=0.04)
    save_scene(orchard(robot, far), tmp_path / "some.yaml")
    save_scene(orchard(robot, far, fruits=False), tmp_path / "none.yaml")
    out = tmp_path / "out"
    run = ["--out", str(out), "--rate", "100", "--fruits"]
    assert script.main([str(tmp_path / "some.yaml"), *run, "a", "far [one]"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(
        r"not picked reason obstacle or detail ─+ far \[one\] out of reach the tool cannot reach \(5, 0, 1\)", shown
    )
    assert script.main([str(tmp_path / "none.yaml"), *run, "far [one]"]) == 3
    assert "far [one]" in capsys.readouterr().err
    assert [path.name for path in out.iterdir()] == ["tour.json"]
    report = json.loads((out / "tour.json").read_text())
    assert (report["status"], report["error"]["kind"]) == ("failed", "TourError")


def test_drop_off_at_pose_names_alternative(robot: Robot, scene: Scene) -> None:
    pose = Goal(position=(1.0, 0.0, 1.0), quaternion_xyzw=(0.0, 0.0, 0.0, 1.0))
    with pytest.raises(UnreachableError, match="give other goals as positions"):
        plan_tour(robot, scene, OPTIONS, fruits=["a"], tour=TourOptions(drop_off=pose))


def random_costs(
    seed: int, n: int, *, capacity: int, absent: float = 0.0, round_numbers: bool = False, most: int = 3
) -> Costs:
    """Costs without symmetry or triangle inequality; some of them infinite."""
    random = np.random.default_rng(seed)
    begin = np.concatenate([[0], np.cumsum(random.integers(1, most + 1, n))])
    m = int(begin[-1])

    def entries(*shape: int) -> np.ndarray:
        values = random.integers(1, 4, shape).astype(float) if round_numbers else random.uniform(0.1, 3.0, shape)
        values[random.uniform(size=shape) < absent] = np.inf
        return values

    drop = entries(m) if capacity else np.full(m, np.inf)
    return Costs(begin, entries(m), entries(m, m), drop, entries(m), entries(m), capacity)


def cost_of(costs: Costs, visits: Visits) -> float:
    """Cost of a tour, leg by leg; infinite if it exceeds the capacity."""
    total, load = costs.first[visits.places[0]], 1
    for a, b, over in zip(visits.places, visits.places[1:], visits.dropped, strict=False):
        total += costs.drop[a] + costs.away[b] if over else costs.onward[a, b]
        load = 1 if over else load + 1
        if costs.capacity and load > costs.capacity:
            return math.inf
    return float(total + costs.last[visits.places[-1]])


def brute_force(costs: Costs, orders: list[tuple[int, ...]]) -> float:
    """Minimum cost over some orders, all places and all drop-offs."""
    n, least = costs.fruits, math.inf
    for order in orders:
        choices = [range(costs.begin[f], costs.begin[f + 1]) for f in order]
        for places in itertools.product(*choices):
            for over in itertools.product((False, True) if costs.capacity else (False,), repeat=n - 1):
                least = min(least, cost_of(costs, Visits(0.0, np.array(places), np.array([*over, False]))))
    return least


CASES = [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.2), (0, 0.3), (2, 0.4)]


@pytest.mark.parametrize(("capacity", "absent"), CASES)
@pytest.mark.parametrize("seed", range(5))
def test_few_fruits_are_exact(seed: int, capacity: int, absent: float) -> None:
    costs = random_costs(seed, 4, capacity=capacity, absent=absent)
    found = best(costs)
    wanted = brute_force(costs, list(itertools.permutations(range(4))))
    assert found.cost == pytest.approx(wanted, rel=1e-12) or found.cost == wanted == math.inf
    if math.isfinite(wanted):
        assert cost_of(costs, found) == pytest.approx(found.cost, rel=1e-12)
        assert sorted(costs.fruit_of[found.places]) == [0, 1, 2, 3]


@pytest.mark.parametrize(("capacity", "absent"), CASES)
@pytest.mark.parametrize("seed", range(5))
def test_configurations_and_drop_offs_of_an_order_are_optimal(seed: int, capacity: int, absent: float) -> None:
    costs = random_costs(seed, 5, capacity=capacity, absent=absent, round_numbers=seed % 2 == 1)
    order = tuple(np.random.default_rng(seed).permutation(5).tolist())
    found = order_grasps(costs, order)
    wanted = brute_force(costs, [order])
    assert found.cost == pytest.approx(wanted, rel=1e-12) or found.cost == wanted == math.inf
    if math.isfinite(wanted):
        assert tuple(costs.fruit_of[found.places]) == order
        assert cost_of(costs, found) == pytest.approx(found.cost, rel=1e-12)


@pytest.mark.parametrize("capacity", [0, 1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_local_search_comes_near_the_optimum(monkeypatch: pytest.MonkeyPatch, seed: int, capacity: int) -> None:
    costs = random_costs(seed, 8, capacity=capacity, absent=0.1)
    exact = best(costs)
    monkeypatch.setattr(ordering, "EXACT", 0)
    first = best(costs)
    again = best(costs, costs.fruit_of[first.places])
    assert cost_of(costs, again) == pytest.approx(again.cost, rel=1e-12)
    assert exact.cost <= again.cost * (1 + 1e-12)
    assert again.cost <= first.cost <= order_grasps(costs, costs.fruit_of[nearest_tour(costs).places]).cost
    assert again.cost <= 1.1 * exact.cost


@pytest.mark.parametrize("capacity", [0, 1])
def test_cost_of_change_equals_cost_of_changed_order(capacity: int) -> None:
    for seed, n, most in itertools.product(range(3), (3, 4, 7), (1, 3)):
        costs = random_costs(seed, n, capacity=capacity, absent=0.2, most=most)
        order, places = (
            np.array([n, *np.random.default_rng(seed).permutation(n), n + 1]),
            int(np.diff(costs.begin).max()),
        )
        ends, shapes = ordering._with_ends(costs), ((2, n + 2, n + 2, places, places), (2, n + 2, n + 2))
        known, steps = ordering.Segments(*map(np.empty, shapes)), np.full((n + 2, n + 2), np.inf)
        ordering._fill_steps(ends, steps)
        ordering._fill_segments(order, ends, (0, n + 2), known)
        single = (np.diff(costs.begin) == 1).all()
        table, here, other = np.empty((len(costs.first), 1)), np.empty((2, places)), order.copy()
        for kind, i, j in itertools.product(range(2 * SEGMENT + 1), range(1, n + 1), range(1, n + 1)):
            size = (kind - 1) % SEGMENT + 1
            if (j <= i) if kind == 0 else (i == j or max(i, j) + size > n + 1):
                continue
            ordering._change_of_order(order, (kind, i, j), other)
            assert (other[0], sorted(other[1:-1]), other[-1]) == (n, list(range(n)), n + 1)
            trial = ordering._trial(order, ends, (kind, i, j), known, here)
            assert trial == pytest.approx(ordering._cost(other[1:-1], costs, table), rel=1e-12)
            # Updating the changed part equals computing everything.
            anew = ordering.Segments(*(array.copy() for array in known))
            whole = ordering.Segments(*(np.full(shape, np.nan) for shape in shapes))
            ordering._fill_segments(other, ends, (min(i, j), ordering._end_of_change((kind, i, j))), anew)
            ordering._fill_segments(other, ends, (0, n + 2), whole)
            assert all((a[~np.isnan(b)] == b[~np.isnan(b)]).all() for a, b in zip(anew, whole, strict=True))
            bound = ordering._bound_tour(order, (kind, i, j), steps, known)
            assert bound == pytest.approx(trial, rel=1e-12) if single else bound <= trial * (1.0 + 1e-12)


@pytest.mark.parametrize("n", [12, 25])
def test_many_fruits_on_a_circle(n: int) -> None:
    """The best open tour over points on a circle follows it."""
    angles = 2.0 * np.pi * np.random.default_rng(0).permutation(n) / n
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    onward = np.linalg.norm(points[:, None] - points, axis=2)
    none = np.full(n, np.inf)
    costs = Costs(np.arange(n + 1), np.zeros(n), onward, none, none, np.zeros(n), 0)
    found = best(costs)
    assert found.cost == pytest.approx(2.0 * math.sin(math.pi / n) * (n - 1), rel=1e-12)


def test_nearest_goes_on_to_the_nearest() -> None:
    x = np.array([1.0, -1.1, 2.2, -4.0])
    onward, none = np.abs(x[:, None] - x), np.full(4, np.inf)
    costs = Costs(np.arange(5), np.abs(x), onward, none, none, np.zeros(4), 0)
    found = nearest_tour(costs)
    assert found.places.tolist() == [0, 2, 1, 3]
    assert found.cost == pytest.approx(1.0 + 1.2 + 3.3 + 2.9)
    carried = Costs(np.arange(5), np.abs(x), onward, np.abs(x), np.abs(x), np.abs(x), 2)
    found = nearest_tour(carried)
    assert found.places.tolist() == [0, 2, 1, 3]
    assert found.dropped.tolist() == [False, True, False, False]
    assert found.cost == pytest.approx(cost_of(carried, found))


@pytest.mark.parametrize("capacity", [1, 2, 3, 7])
@pytest.mark.parametrize("seed", range(3))
def test_nearest_never_carries_more_than_it_can(seed: int, capacity: int) -> None:
    found = nearest_tour(random_costs(seed, 13, capacity=capacity))
    ends = [*np.flatnonzero(found.dropped).tolist(), 12]
    loads = np.diff([-1, *ends]).tolist()
    assert loads == [capacity] * (13 // capacity) + [13 % capacity] * (13 % capacity > 0)


@pytest.mark.parametrize("find", [best, nearest_tour, lambda costs: order_grasps(costs, [1, 0, 2])])
def test_no_tour_costs_infinity(find: object) -> None:
    none = np.full(3, np.inf)
    costs = Costs(np.arange(4), np.ones(3), np.full((3, 3), np.inf), none, none, np.zeros(3), 0)
    found = find(costs)  # type: ignore[operator]
    assert found.cost == math.inf
    assert sorted(found.places) == [0, 1, 2]
