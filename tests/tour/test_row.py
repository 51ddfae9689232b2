"""Rows: stops chosen by set cover, tours at each, and their report."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_tree import TREE

import hplan
from hplan.apps.cli.main import main
from hplan.base.arrays import FloatArray
from hplan.certificate.certificate import Certificate, all_of
from hplan.errors import InputError, OptionError, TourError
from hplan.robot.model import Robot, load_robot
from hplan.scene import Wood, with_limbs
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box
from hplan.scene.orchard import MeasuredOptions, measured_orchard
from hplan.tour import tour as touring
from hplan.tour.row import BaseStop, RowOptions, RowResult, cover, plan_row, reach_in_turn, within_reach
from hplan.tour.tour import plan_tour

QUICK = hplan.PlanOptions(effort="quick")
COARSE = RowOptions(distance=1.2, step=0.8)


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("orchard_harvester")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    file = tmp_path_factory.mktemp("row") / "tree.csv"
    file.write_text(TREE)
    return measured_orchard([file, file], MeasuredOptions(distance=1.2, spacing=1.6, wood_yields=0.02))


@pytest.fixture(scope="module")
def row(arm: Robot, scene: Scene) -> RowResult:
    return plan_row(arm, scene, QUICK, row=COARSE)


# Set cover


def by_trying_all(costs: list[dict[str, float]], each: float, need: int) -> tuple[int, float]:
    """Minimum number of sets that hold enough, and minimum cost, by brute force."""
    names = sorted({name for held in costs for name in held})
    fewest, cost = len(costs), math.inf
    for some in itertools.product((False, True), repeat=len(costs)):
        chosen = [held for held, taken in zip(costs, some, strict=True) if taken]
        prices = sorted(min(held[name] for held in chosen if name in held) for name in names
                        if any(name in held for held in chosen))  # fmt: skip
        if len(prices) >= need:
            fewest, cost = min(fewest, len(chosen)), min(cost, each * len(chosen) + sum(prices[:need]))
    return fewest, cost


@pytest.mark.parametrize("seed", range(25))
def test_covers_are_those_of_trying_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    fruits = [f"fruit {i}" for i in range(int(rng.integers(1, 11)))]
    draw = lambda: {name: float(rng.uniform(0.5, 3.0)) for name in fruits if rng.random() < 0.35}  # noqa: E731
    costs = [draw() for _ in range(int(rng.integers(1, 9)))]
    names = {name for held in costs for name in held}
    for each, share in ((math.inf, 1.0), (math.inf, 0.8), (1.5, 1.0), (0.1, 0.7)):
        need = math.ceil(share * len(names))
        chosen, is_best = cover(costs, each, need)
        taken = [name for listed in chosen.values() for name in listed]
        assert is_best
        assert len(taken) == len(set(taken)) >= need
        assert all(name in costs[i] for i, listed in chosen.items() for name in listed)
        if not names:
            continue
        fewest, cost = by_trying_all(costs, each, need)
        if math.isinf(each):
            assert len(chosen) == fewest
        else:
            paid = each * len(chosen) + sum(costs[i][name] for i, listed in chosen.items() for name in listed)
            assert paid == pytest.approx(cost, rel=1e-4)


# Places


@pytest.mark.parametrize("place", [BaseStop(1, 0.3, 0.0), BaseStop(2, -0.4, 0.2)])
def test_fruit_seen_from_a_position(scene: Scene, place: BaseStop) -> None:
    """A base at the place, facing the row, has the fruits ahead at their distance."""
    seen = place.see_scene(scene, COARSE)
    base = np.array([2.0 * COARSE.distance if place.side == 2 else 0.0, place.along, place.height])
    ahead: FloatArray = np.array([-1.0 if place.side == 2 else 1.0, 0.0, 0.0])
    for before, after in zip(scene.fruits, seen.fruits, strict=True):
        away = np.array(before.center) - base
        assert after.name == before.name
        assert after.center[0] == pytest.approx(away @ ahead)
        assert after.center[2] == pytest.approx(away[2])
        assert math.hypot(*after.center) == pytest.approx(np.linalg.norm(away))


def test_obstacles_on_vehicle_move_with_base(scene: Scene) -> None:
    bin_ = Box(name="bin", center=(-0.9, 0.0, 0.2), size=(0.4, 0.4, 0.4))
    seen = BaseStop(2, 1.0, 0.0).see_scene(
        scene.with_obstacles([*scene.obstacles, bin_]), replace(COARSE, carried=("bin",))
    )
    assert [one for one in seen.obstacles if one.name == "bin"] == [bin_]


def test_fruit_behind_others_can_be_picked_once_they_are(arm: Robot, scene: Scene) -> None:
    near = within_reach(arm, scene)
    fruit = near.fruits[0]
    shell = [
        fruit.model_copy(update={"name": f"shell {i}", "center": tuple(np.add(fruit.center, 0.075 * np.array(way)))})
        for i, way in enumerate(itertools.product((-1, 0, 1), repeat=3)) if any(way)
    ]  # fmt: skip
    dense = near.model_copy(update={"fruits": (fruit, *shell), "obstacles": ()})
    order = [name for name, one in reach_in_turn(arm, dense).items() if one.can_be_picked]
    assert not hplan.reachable(arm, dense)[fruit.name].can_be_picked
    assert fruit.name in order[1:]


# Rows


def test_row_is_picked_from_as_few_stops_as_can_be(row: RowResult) -> None:
    hanging = [fruit.name for fruit in row.scene.fruits]
    assert 0 < len(row.picked) == len(set(row.picked)) <= len(hanging)
    assert set(row.picked) <= set(row.reachable) == set().union(*row.candidates.values())
    assert sorted(row.picked) == sorted(name for stop in row.stops for name in stop.tour.order)
    costs = [dict.fromkeys(names, 1.0) for names in row.candidates.values()]
    assert row.report["planner"]["cover_stops"] == len(cover(costs, math.inf)[0])
    assert row.report["planner"]["cover_is_best"]
    assert sum(stop.way == 1 for stop in row.stops) <= row.report["planner"]["cover_stops"]


def test_each_tour_is_certified_among_remaining_fruit(arm: Robot, row: RowResult) -> None:
    gone: set[str] = set()
    for stop in row.stops:
        assert stop.tour.certificate.verified
        assert not gone & {fruit.name for fruit in stop.tour.scene.fruits}
        np.testing.assert_allclose(stop.tour.trajectory.position[-1], row.scene.start.configuration, atol=1e-9)
        seen = {fruit.name: fruit.center for fruit in stop.place.see_scene(row.scene, row.options).fruits}
        for leg in stop.tour.legs:
            if leg.fruit is not None and leg.grasp is not None:
                place = arm.tool_positions(leg.grasp.goal[None])[0]
                np.testing.assert_allclose(place, seen[leg.fruit], atol=1e-6)
        gone |= set(stop.tour.order)


def test_report_adds_up(row: RowResult) -> None:
    report = row.report
    assert json.loads(json.dumps(report))["picked"] == len(row.picked)
    assert report["share_picked"] == len(row.picked) / len(row.scene.fruits)
    assert report["motion_s"] == pytest.approx(sum(stop.tour.duration for stop in row.stops))
    assert report["driving_s"] >= sum(stop.arrival_s for stop in row.stops)
    assert report["detaching_s"] == len(row.picked)
    parts = report["motion_s"] + report["driving_s"] + report["detaching_s"]
    assert report["fruit_per_hour"] == pytest.approx(3600.0 * len(row.picked) / parts)
    assert {name: one["fruits"] for name, one in report["trees"].items()} == {"tree 1": 4, "tree 2": 4}
    assert sum(one["picked"] for one in report["trees"].values()) == len(row.picked)


def test_every_fruit_is_picked_or_has_a_reason(row: RowResult) -> None:
    assert {*row.picked, *row.unpicked} == {fruit.name for fruit in row.scene.fruits}
    high = {fruit.name for fruit in row.scene.fruits if fruit.center[2] > 5.0}
    assert high
    assert {name for name, one in row.unpicked.items() if one.reason == "out_of_reach"} == high
    assert sum(row.report["not_picked"].values()) == len(row.unpicked)
    for one in row.unpicked.values():
        assert (one.reason == "blocked") <= (one.obstacle in row.report["obstacles"])


def test_of_a_share_no_pass_takes_more_than_it_needs(arm: Robot, scene: Scene, row: RowResult) -> None:
    need = math.ceil(0.5 * len(row.reachable))
    some = plan_row(arm, scene, QUICK, row=replace(COARSE, both=False, share=0.5))
    assert need <= len(some.picked) < len(row.picked)
    assert some.report["not_picked"]["left_out"] == len(some.reachable) - len(some.picked) > 0


def test_a_stop_for_one_fruit_is_left_out(arm: Robot, tmp_path: Path) -> None:
    (tmp_path / "tree.csv").write_text(TREE)
    trees = [tmp_path / "tree.csv"] * 2
    scene = measured_orchard(trees, MeasuredOptions(distance=1.2, spacing=5.0, wood_yields=0.02))
    lonely = "tree 2 fruit 1"
    kept = tuple(one for one in scene.fruits if one.name.startswith("tree 1") or one.name == lonely)
    scene = scene.with_values(fruits=kept)
    row = plan_row(arm, scene, QUICK, row=COARSE)
    (alone,) = (stop.tour.duration for stop in row.stops if stop.tour.order == (lonely,))
    (beside,) = (stop.tour.duration / 3 for stop in row.stops if len(stop.tour.order) == 3)
    limit = touring.TourOptions(max_detour_s=0.5 * (alone + beside))
    some = plan_row(arm, scene, QUICK, row=COARSE, tour=limit)
    assert set(some.picked) == set(row.picked) - {lonely}
    assert some.unpicked[lonely].reason is None
    assert some.report["not_picked"]["left_out"] == 1
    with pytest.raises(TourError, match="too long a detour"):
        plan_row(arm, scene, QUICK, row=COARSE, tour=touring.TourOptions(max_detour_s=0.1))


def test_stops_with_base_in_contact_are_excluded(arm: Robot, scene: Scene) -> None:
    post = Box(name="post", center=(0.0, 0.8, 0.2), size=(0.1, 0.1, 0.4))
    with_post = scene.with_obstacles([*scene.obstacles, post])
    found = plan_row(arm, with_post, QUICK, row=replace(COARSE, both=False))
    assert BaseStop(1, 0.8, 0.0) not in found.candidates
    assert BaseStop(1, 0.0, 0.0) in found.candidates


def test_nothing_in_reach(arm: Robot, scene: Scene) -> None:
    with pytest.raises(TourError, match="from any of 10 stops: out of reach"):
        plan_row(arm, scene, QUICK, row=replace(COARSE, heights=(4.5,), step=1.6))


def test_invalid_rows_are_refused(arm: Robot, scene: Scene) -> None:
    with pytest.raises(OptionError, match="deadline"):
        plan_row(arm, scene, hplan.PlanOptions(deadline_s=1.0))
    with pytest.raises(OptionError, match="carried"):
        plan_row(arm, scene, row=RowOptions(carried=("nothing",)))
    with pytest.raises(OptionError, match="candidate stops"):
        plan_row(arm, scene, row=RowOptions(step=0.01, heights=tuple(0.01 * i for i in range(100))))
    with pytest.raises(InputError):
        plan_row(arm, 3)  # type: ignore[arg-type]


def test_command(scene: Scene, row: RowResult, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra `figures` is not installed")
    hplan.save_scene(scene.model_copy(update={"robot": "orchard_harvester"}), tmp_path / "row.yaml")
    words = ["--distance", "1.2", "--step", "0.8", "--effort", "quick", "--out", str(tmp_path / "out")]
    assert main(["row", str(tmp_path / "row.yaml"), *words]) == 0
    report = json.loads((tmp_path / "out" / "row.json").read_text())
    assert report["picked"] == len(row.picked)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {*report["files"], "row.json", "row.png", "scene.html", "stop-01.html"} <= names
    assert hplan.read_csv(tmp_path / "out" / "stop-01.csv").duration == pytest.approx(row.stops[0].tour.duration)
    page = (tmp_path / "out" / "scene.html").read_text()
    assert page.count('target="stop"') == len(row.stops)


# Limbs


def test_row_among_limbs_keeps_the_limits(arm: Robot, scene: Scene) -> None:
    # With this clearance not every fruit is picked without pushing.
    bending = with_limbs(scene, Wood(contact_force=6.0, wood_stress_mpa=20.0)).with_values(clearance=0.03)
    found = plan_row(arm, bending, QUICK, row=replace(COARSE, both=False))
    assert all(stop["verified"] for stop in found.report["stops"])
    assert 0.0 < found.report["max_force_n"] <= 8.0  # 6 N on limbs, 8 N on stalks
    assert 0.0 < found.report["max_stress_mpa"] <= 20.0
    assert found.report["max_force_n"] == max(stop["max_force_n"] for stop in found.report["stops"])


def test_tour_pushes_limbs_only_for_fruit_that_need_it(arm: Robot, scene: Scene) -> None:
    limbs = with_limbs(scene)
    assert limbs.wood is not None
    bending, rigid = (plan_tour(arm, each, QUICK) for each in (limbs, limbs.with_values(wood=limbs.wood.as_rigid)))
    assert bending.certificate.verified
    assert bending.order == rigid.order
    assert bending.duration == rigid.duration
    assert not bending.certificate.pushes


def test_tour_that_is_not_certified_as_a_whole_leaves_fruit(
    arm: Robot, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What earlier legs push may displace the fruit of later ones."""
    bending = with_limbs(scene, Wood(contact_force=6.0, wood_stress_mpa=20.0)).with_values(clearance=0.03)
    stops = plan_row(arm, bending, QUICK, row=replace(COARSE, both=False)).stops
    pushing = next(stop.tour for stop in stops if stop.tour.certificate.pushes)

    def displaced(parts: list[Certificate]) -> Certificate:
        found = all_of(parts)
        return replace(found, verified=False, violations=("displaced",)) if found.pushes else found

    monkeypatch.setattr(touring, "all_of", displaced)
    found = plan_tour(arm, pushing.scene, QUICK, fruits=pushing.order)
    assert found.certificate.verified
    assert not found.certificate.pushes
    assert set(found.order) < set(pushing.order)
    left = {item.fruit for item in found.unreached if "displaced" in item.error.message}
    assert left == set(pushing.order) - set(found.order)


def test_reversed_tour_is_certified_as_a_whole(arm: Robot, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [fruit.name for fruit in scene.fruits][:2]
    planner = touring.TourPlanner(arm, scene, QUICK, touring.TourOptions(), names)
    tour = planner.run(names)
    turned = planner.reverse(tour)
    assert turned is not None
    assert turned.certificate.verified
    assert turned.order == tour.order[::-1]
    monkeypatch.setattr(touring, "all_of", lambda parts: replace(all_of(parts), verified=False))
    assert planner.reverse(tour) is None
