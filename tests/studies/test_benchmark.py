from __future__ import annotations

import importlib.util
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image
from studies.benchmark import growth, in_motion, orchard_scenes, orchards, recheck, replanning
from studies.benchmark.figures import figures
from studies.benchmark.measure import evenly_chosen, fitted_slope, peak_memory_mb, spread
from studies.benchmark.motions import Findings, of_rows, row_cubics, stopping_duration, toppra_motion
from studies.benchmark.moving_scenes import CLOSE, OBSTACLES, ROOM, SHIFT, ObstacleMove, moving_scene, next_move
from studies.benchmark.orchard_scenes import (
    STANDOFF,
    CropProblems,
    OrchardProblem,
    crop_of,
    measured_orchards,
    shipped_orchards,
)
from studies.benchmark.paths import PeerTask, motions_of
from studies.benchmark.planners import Ompl, OmplResult
from studies.benchmark.scenes import APART_DEG, random_scene
from studies.benchmark.tables import number, to_markdown

import hplan
from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.errors import InputError, NoPathError
from hplan.online.planner import Planner
from hplan.problem.world import BASE_DEPTH, World
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.timing.trajectory import Trajectory

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "benchmark.py"
FIGURES = tuple(f"benchmark-{name}.png" for name in ("reference", "clutter", "orchards", "replanning", "growth"))


def load_script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("benchmark", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


script = load_script()


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A quick run of all sets on few scenes, growth on its smallest cases, no planners from elsewhere."""
    folder = tmp_path_factory.mktemp("benchmark") / "new" / "folder"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(growth, "STEPS_DEG", (6.0, 3.0))
        patch.setattr(growth, "COUNTS", (1, 2, 4))
        patch.setattr(growth, "LINKS", (2, 3))
        patch.setattr(growth, "LINK_STEP_DEG", 6.0)
        patch.setattr(orchard_scenes, "SHIPPED", ("tour",))
        patch.setattr(Ompl, "if_installed", classmethod(lambda cls, seed: None))
        assert script.main(["--quick", "--scenes", "3", "--out", str(folder), "--seed", "4"]) == 0
    return folder


@pytest.fixture(scope="module")
def results(out: Path) -> Any:
    return json.loads((out / "benchmark.json").read_text(encoding="utf-8"))


def test_writes_everything(out: Path, results: Any) -> None:
    assert {path.name for path in out.iterdir()} == {"benchmark.json", "benchmark.md", *FIGURES}
    for name in FIGURES:
        with Image.open(out / name) as image:
            assert min(image.size) > 500
    assert results["format"] == "hplan-benchmark/1"
    assert results["settings"] == {
        "sets": [*script.SETS],
        "quick": True,
        "seed": 4,
    }
    assert {"processor", "cores", "python", "versions"} <= set(results["environment"])


def test_reference_numbers(results: Any) -> None:
    r = results["reference"]
    assert r["searches"]["two_level"]["cost_deg"] == pytest.approx(r["searches"]["dense"]["cost_deg"])
    assert r["searches"]["dense"]["points"] == 107
    assert r["cspace"]["occupied"] == 128_891
    assert r["cspace"]["differing_nodes"] == 0
    assert {"cspace", "layers", "sparse", "postprocess", "timing", "certificate", "total"} <= set(r["stages_ms"])
    rows = r["motions"]["rows"]
    assert rows["hplan"]["certified"]
    assert rows["hplan_length"]["length_deg"] < rows["hplan"]["length_deg"]
    assert not rows["hplan"]["collides"]
    assert rows["grid_spline"]["ratio"] == pytest.approx(1.0 / r["motions"]["hplan_to_grid_spline"])
    assert rows["taut_stops"]["certified"]
    assert r["planners"] is None


def test_clutter_numbers(results: Any) -> None:
    c = results["clutter"]
    assert c["scenes"] == 3
    assert c["with_path"] + c["blocked"] == 3
    assert c["planned"] == c["certified"] == len(c["rows"])
    assert c["disagreeing"] == 0
    assert all(row["cost_ratio"] > 1.0 - 1e-9 for row in c["rows"])


def test_recheck_numbers(results: Any) -> None:
    r = results["recheck"]
    assert r["with_path"] == r["planned"] == r["certified"] == 3
    assert r["violations"] == []
    assert 0 <= r["around"] <= 3
    assert set(r["violation_counts"]) == set(recheck.CHECKS)
    assert r["least_clearance_beyond_certificate_mm"] >= 0.0
    assert 0.0 < r["reference"]["hplan"]["any"] <= 1.0


def test_bound_numbers(results: Any) -> None:
    b = results["bound"]
    assert b["violations"] == []
    assert b["best_checked"] >= 1
    assert b["groups"]["all"]["motions"] == len(b["rows"]) == 3
    assert b["groups"]["joints"]["motions"] + b["groups"]["planar"]["motions"] == 3
    assert all(0.0 < row["joints_s"] <= row["seconds"] <= row["duration_s"] for row in b["rows"])
    assert 0.0 < b["reference"]["gap"] < 0.05


def test_orchard_numbers(results: Any) -> None:
    o = results["orchards"]
    fruits = o["fruits"]["tour"]
    assert fruits["fruits"] == fruits["goals"] + sum(fruits["without"].values()) == 20
    assert list(o["groups"]) == ["tour"]
    everything = o["all"]
    assert everything["problems"] == everything["solved"] == everything["certified"] == len(o["rows"]) == 3
    assert sum(everything["routes"].values()) == 3
    assert everything["missed"] == everything["failed"] == o["at_fault"] == []
    assert o["planners"] is None
    assert all(0.0 < row["duration_s"] < 10.0 for row in o["rows"])


def test_replanning_numbers(results: Any) -> None:
    r = results["replanning"]
    assert r["scenes"] == 3 <= r["drawn"]
    assert r["steps"] == len(r["rows"]) == sum(r["outcomes"].values()) == 3 * replanning.QUICK_STEPS
    assert r["replanned"] == r["certified"] == r["all"]["steps"] > 0
    assert r["outcomes"]["kept"] > 0
    assert sum(group["steps"] for group in r["by_move"].values()) == r["replanned"]
    assert r["at_fault"] == r["only_from_nothing"] == r["failed"] == []
    assert r["per_second"] == pytest.approx(1e3 / r["all"]["ms"]["median"])
    kept = [row for row in r["rows"] if row["outcome"] == "kept"]
    assert all(row["ratio"] == pytest.approx(row["from_nothing_ms"] / row["ms"]) for row in kept)
    # What is kept is the motion of the step before.
    for before, row in pairwise(r["rows"]):
        if row["outcome"] == "kept" and row["step"] and "duration_s" in before:
            assert row["duration_s"] == before["duration_s"]


def test_in_motion_numbers(results: Any) -> None:
    r = results["in_motion"]
    assert r["scenes"] == 3 <= r["drawn"]
    assert r["steps"] == len(r["rows"]) == sum(r["outcomes"].values()) == 3 * in_motion.QUICK_STEPS
    assert r["splices"] == r["certified"] > 0
    assert r["colliding"] == 0 < r["least_clearance_mm"]
    assert all(jump <= most for jump, most in zip(r["largest_jumps"], (1e-9, 1e-9, 1e-6), strict=True))
    stops = r["stops"]
    assert stops["count"] == stops["certified"] > 0
    assert stops["largest_off_path_mm"] <= stops["largest_bound_mm"] <= 0.1
    assert r["at_fault"] == r["failed"] == []


def test_growth_numbers(results: Any) -> None:
    for axis, sizes in (("step", [6.0, 3.0]), ("obstacles", [1, 4]), ("links", [2, 3])):
        cases = results["growth"][axis]["cases"]
        assert [case["size"] for case in cases] == sizes
        assert all(case["cspace_ms"] > 0.0 and case["dense_ms"] > 0.0 for case in cases)
        assert set(results["growth"][axis]["slopes"]) == set(growth.QUANTITIES)


def test_markdown(out: Path) -> None:
    text = (out / "benchmark.md").read_text(encoding="utf-8")
    blocks = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) >= 10
    for block in blocks:
        assert len({line.replace("\\|", "").count("|") for line in block}) == 1, block[0]
    assert "nan" not in text
    assert text.count("not installed |") == 6
    assert "No measured trees: no folder of measured trees was given." in text


def test_some_sets_only(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script.main(["--quick", "--sets", "recheck", "--scenes", "1", "--out", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))
    assert "reference" not in results
    assert "Recheck" in capsys.readouterr().out


def test_violation_is_told_by_the_exit_status(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recheck, "LIMIT_TOLERANCE", 0.5)
    assert script.main(["--quick", "--sets", "recheck", "--scenes", "1", "--out", str(tmp_path)]) == script.FAULT


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script.main(["--scenes", "0", "--out", str(tmp_path)]) == 2
    (tmp_path / "file").touch()
    assert script.main(["--out", str(tmp_path / "file")]) == 2
    assert "scenes" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        script.main(["--sets", "everything"])
    assert stop.value.code == 2


def test_scenes_depend_on_seed_and_number_alone(robot: Robot) -> None:
    once, again, other = random_scene(robot, 1, 2), random_scene(robot, 1, 2), random_scene(robot, 2, 2)
    assert once.scene == again.scene != other.scene
    assert 1 <= len(once.scene.obstacles) <= 12
    ends = once.space.grid.coordinates(np.stack([once.start, once.goal]))
    assert np.degrees(np.linalg.norm(ends[1] - ends[0])) >= APART_DEG
    assert once.space.is_free(once.start)
    assert once.spare_clearance_m > 0.0


@pytest.mark.parametrize("number", [101, 163, 174])
def test_base_stands_free_of_discs(robot: Robot, number: int) -> None:
    """Of these, the discs that are drawn first stand in the turret."""
    drawn = random_scene(robot, 0, number)
    assert base_contacts(robot, drawn.scene.solids, margin=-BASE_DEPTH) == ()
    assert not drawn.has_path or hplan.plan(robot, drawn.scene).certificate.verified


def test_scenes_with_a_free_base_are_drawn_as_if_it_were_not_looked_at(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = {number: random_scene(robot, 0, number) for number in (0, 1, 2, 3, 101)}
    monkeypatch.setattr(World, "check_base", lambda *_: None)
    same = [number for number, drawn in looked.items() if random_scene(robot, 0, number).scene == drawn.scene]
    assert same == [0, 1, 2, 3]


def test_moving_scenes_depend_on_seed_and_number_alone(robot: Robot) -> None:
    scene = moving_scene(robot, 1, 2)
    assert scene == moving_scene(robot, 1, 2)
    assert scene != moving_scene(robot, 2, 2).model_copy(update={"name": scene.name})
    assert scene != moving_scene(robot, 1, 3).model_copy(update={"name": scene.name})
    assert len(scene.obstacles) == OBSTACLES == 40
    assert {type(obstacle) for obstacle in scene.obstacles} == {Sphere, Capsule}
    assert scene.locked_joints == ()
    assert_room(robot, scene)


def assert_room(robot: Robot, scene: Scene) -> None:
    """The base stands free, and start and goal have room."""
    checker = CoalScene(robot, scene.solids)
    for end in (scene.start, scene.goal):
        assert checker.distances(end.configuration).min() >= ROOM
    yaw = robot.yaw_of(scene.start.configuration)
    assert base_contacts(robot, scene.solids, yaw, margin=-BASE_DEPTH) == ()


def test_moves_follow_from_the_motion_and_leave_room(robot: Robot) -> None:
    scene = moving_scene(robot, 0, 0)
    motion = hplan.plan(robot, scene).trajectory.position
    moves = draw_moves(robot, scene, motion)
    assert draw_moves(robot, scene, motion) == moves
    obstacles = {obstacle.name: obstacle for obstacle in scene.obstacles}
    certified_as_required = {True: [], False: []}  # type: dict[bool, list[float]]
    for move in moves:
        piece, before = move.piece, obstacles[move.piece.name]
        assert isinstance(before, (Sphere, Capsule))
        shift = piece.core - before.core
        np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-12)
        assert before.model_copy(update=move.changes) == piece
        assert move.close or SHIFT[0] <= np.linalg.norm(shift[0]) <= SHIFT[1]
        assert_room(robot, scene.with_obstacles([piece]))
        checker = CoalScene(robot, [piece])
        certified_as_required[move.close].append(min(float(checker.distances(q).min()) for q in motion[::4]))
    assert len(certified_as_required[True]) >= 20
    assert max(certified_as_required[True]) <= CLOSE
    assert min(certified_as_required[True]) < 0.0 < max(certified_as_required[False])


def draw_moves(robot: Robot, scene: Scene, motion: Any) -> list[ObstacleMove]:
    random = np.random.default_rng(5)
    return [next_move(robot, scene, motion, random) for _ in range(100)]


def test_only_fruit_and_branches_move(robot: Robot, scene: Scene) -> None:
    box = Box(name="crate", center=(1.0, -1.0, 0.1), size=(0.2, 0.2, 0.2))
    with pytest.raises(InputError, match="'crate' is neither fruit nor branch"):
        next_move(robot, scene.with_obstacles([box]), np.zeros((1, 4)), np.random.default_rng(0))


def test_row_cubics_are_hermite() -> None:
    time, clock = np.array([0.0, 0.5, 2.0]), np.linspace(0.0, 2.0, 41)
    cubic = np.polynomial.Polynomial([0.3, -1.0, 0.7, 0.2])
    rows = cubic(time)[:, None], cubic.deriv()(time)[:, None]
    np.testing.assert_allclose(row_cubics(time, *rows, clock)[:, 0], cubic(clock), atol=1e-12)


@pytest.mark.parametrize(("turn", "duration"), [(0.3, 2.0 * math.sqrt(0.1)), (1.2, 1.0 + 0.4)])
def test_stopping_duration_is_that_of_trapezoids(robot: Robot, turn: float, duration: float) -> None:
    """The shoulder alone: 1.2 rad/s and 3 rad/s^2."""
    path = np.zeros((3, 4))
    path[1:, 1] = turn
    assert stopping_duration(robot, path) == pytest.approx(duration)
    assert stopping_duration(robot, np.vstack([path, path[:1]])) == pytest.approx(2.0 * duration)


def test_toppra_keeps_limits_as_advised_on_a_straight_path(robot: Robot) -> None:
    path = np.zeros((2, 4))
    path[1, 1:] = 0.5
    motion = toppra_motion(robot, path)
    assert motion is not None
    assert motion.duration == pytest.approx(stopping_duration(robot, path), rel=2e-3)


def test_recheck_sees_a_trajectory_at_fault(robot: Robot, tmp_path: Path) -> None:
    """A motion at twice its pace, and one certified for more clearance than it has."""
    drawn = next(d for number in range(50) if (d := random_scene(robot, 0, number)).has_path)
    result = hplan.plan(robot, drawn.scene)
    slow = result.trajectory
    quick = Trajectory(
        slow.joint_names, slow.time / 2, slow.position, slow.velocity * 2, slow.acceleration * 4, slow.torque
    )
    seen = recheck.look_again(robot, drawn, hplan.write_csv(quick, tmp_path / "quick.csv"), 1e-6)
    assert {"velocity", "acceleration"} & {item["check"] for item in seen["violations"]}
    file = hplan.write_csv(slow, tmp_path / "slow.csv")
    assert recheck.look_again(robot, drawn, file, result.certificate.min_clearance_m)["violations"] == []
    boast = recheck.look_again(robot, drawn, file, 1.0)
    assert [item["check"] for item in boast["violations"]] == ["certified clearance"]


def test_small_helpers() -> None:
    assert number(float("nan")) == "-"
    assert number(0.01234) == "0.0123"
    assert number(12345.6) == "12,346"
    assert fitted_slope([1, 10, 100], [2, 200, 20000]) == pytest.approx(2.0)
    assert math.isnan(fitted_slope([1, 1], [2, 3]))
    assert math.isnan(spread([])["median"])
    array, rise = peak_memory_mb(lambda: np.ones(50_000_000))
    assert array.sum() == 50_000_000
    # 400 MB, less what the process had left of earlier peaks; nothing else here takes a tenth of that.
    assert math.isnan(rise) or 300.0 < rise < 440.0


def test_planners_where_installed(robot: Robot, scene: Scene) -> None:
    pytest.importorskip("ompl")
    ompl = Ompl.if_installed(1)
    assert ompl is not None
    task = PeerTask.of(robot, scene)
    run = ompl.plan(task, task.problem.start, task.problem.goal)
    assert run.path is not None
    assert task.field.is_clear(run.path, task.smallest_margin)
    assert run.compiled_ms <= run.total_ms * 1.5
    ways = motions_of(task, run.path)
    assert ways.processed_s is not None
    result = hplan.plan(robot, scene)
    assert of_rows(result.trajectory).duration == result.trajectory.duration


def test_markdown_of_nothing_measured() -> None:
    where = {"processor": "p", "cores": 1, "system": "s", "python": "3", "versions": {}}
    text = to_markdown({"environment": where, "settings": {"seed": 0, "quick": False}})
    assert text.startswith("p, 1 cores")


@pytest.fixture(scope="module")
def crop(robot: Robot) -> CropProblems:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(orchard_scenes, "SHIPPED", ("tour",))
        return crop_of(robot, shipped_orchards()[0])


def test_orchard_goals_are_where_straight_approaches_begin(robot: Robot, crop: CropProblems) -> None:
    """The hand points at the fruit from the stand-off, touching nothing; coal and Pinocchio judge."""
    scene = crop.orchard.scene
    checker = CoalScene(robot, scene.solids_with_goal)
    centres = {fruit.name: np.array(fruit.center) for fruit in scene.fruits}
    assert len(crop.goals) + sum(crop.without.values()) == len(centres)
    assert set(crop.without) <= {"blocked", "no_approach", "joint_limit", "too_far"}
    assert len(crop.goals) >= 5
    for name, q in crop.goals.items():
        assert checker.distances(q).min() > 0.0
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        tool = data.oMf[robot.model.getFrameId("tool0")].translation
        wrist = data.oMi[robot.model.njoints - 1].translation
        ahead = centres[name] - tool
        assert np.linalg.norm(ahead) == pytest.approx(STANDOFF, abs=1e-6)
        np.testing.assert_allclose(ahead / STANDOFF, (tool - wrist) / np.linalg.norm(tool - wrist), atol=1e-5)


def test_orchard_problems_go_from_home_and_from_fruit_to_fruit(crop: CropProblems) -> None:
    problems, goals, home = crop.problems(), list(crop.goals), crop.orchard.scene.start.configuration
    assert len(problems) == 2 * len(goals) - 1
    for problem, name in zip(problems, goals, strict=False):
        assert problem.name == f"tour: home to {name}"
        np.testing.assert_array_equal(problem.scene.start.configuration, home)
        np.testing.assert_array_equal(problem.scene.goal.configuration, crop.goals[name])
    for problem, (before, after) in zip(problems[len(goals) :], pairwise(goals), strict=True):
        assert problem.name == f"tour: {before} to {after}"
        np.testing.assert_array_equal(problem.scene.start.configuration, crop.goals[before])
        np.testing.assert_array_equal(problem.scene.goal.configuration, crop.goals[after])
        assert len(problem.scene.fruits) == len(crop.orchard.scene.fruits)
    blocked = replace(crop, home_is_clear=False)
    assert [problem.name for problem in blocked.problems()] == [problem.name for problem in problems[len(goals) :]]


def write_tree(file: Path, branches: int) -> Path:
    """A trunk with level branches towards the base, a hand's breadth apart, the lower ones out of reach."""
    rows = ["kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,3,0.03"]
    rows += [f"branch,0,0,{0.3 + 0.1 * i},-0.3,{0.1 * (i % 3 - 1)},{0.3 + 0.1 * i},0.01" for i in range(branches)]
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


def test_measured_trees_bear_fruit_within_reach_first(robot: Robot, tmp_path: Path) -> None:
    write_tree(tmp_path / "t1.csv", 25)
    found = measured_orchards(robot, tmp_path)
    assert [orchard.name for orchard in found] == ["t1 at 1.4 m", "t1 at 1 m", "t1 at 1.8 m"]
    crop = crop_of(robot, found[0])
    fruits = crop.orchard.scene.fruits
    assert len(fruits) == 20
    assert {fruit.radius for fruit in fruits} == {0.04}
    heights = np.array([fruit.center[2] for fruit in fruits])
    # 25 tips from 0.3 to 2.7 m; the arm reaches those from about 1.3 m on, and the others fill up what is missing.
    reached = (heights > 1.45) & (heights < 2.3)
    assert reached.sum() == 8
    assert not (heights[:8] < 1.2).any()
    assert crop.without["joint_limit"] + crop.without["too_far"] < 20
    assert crop.home_is_clear


def test_measured_tree_with_no_room_for_its_fruit_is_named(robot: Robot, tmp_path: Path) -> None:
    file = write_tree(tmp_path / "bare.csv", 1)
    with pytest.raises(InputError, match=r"bare\.csv: count = 20"):
        measured_orchards(robot, file.parent)


@pytest.mark.parametrize(
    ("folder", "reason"), [(None, "no folder"), ("nowhere", "there is no folder"), ("", "there is no CSV in")]
)
def test_why_there_are_no_trees(robot: Robot, tmp_path: Path, folder: str | None, reason: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(orchard_scenes, "SHIPPED", ())
        trees = None if folder is None else tmp_path / folder
        numbers = orchards.measure(robot, trees=trees, most=1, ompl=None, progress=lambda *_: None)
    assert numbers["without_trees"].startswith(reason)
    assert numbers["all"]["problems"] == 0


def test_chosen_problems_are_spread_over_each_group(scene: Scene) -> None:
    problems = [OrchardProblem(f"{group} {i}", group, scene) for group in "ab" for i in range(9)]
    assert [problem.name for problem in evenly_chosen(problems, 3)] == ["a 1", "a 4", "a 7", "b 1", "b 4", "b 7"]
    assert evenly_chosen(problems, None) == evenly_chosen(problems, 100) == problems


def test_what_a_peer_alone_solves_is_named(robot: Robot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Planning fails wherever the base has to turn; OMPL is a stand-in that finds the straight motion."""

    def fails(robot: Robot, scene: Scene) -> None:
        raise NoPathError("closed", reached_cells=1)

    class Straight:
        def plan(self, task: Any, start: Any, goal: Any, **asked: Any) -> OmplResult:
            assert asked["turns"]
            assert asked["seconds"] == orchards.PATIENCE
            path = np.stack([start, goal])
            return OmplResult(path if asked["planner"] == "BITstar" else None, 1.0, 1.0, 1.0, 1.0)

    monkeypatch.setattr(orchard_scenes, "SHIPPED", ())
    monkeypatch.setattr(orchards, "plan", fails)
    monkeypatch.setattr(Ompl, "if_installed", classmethod(lambda cls, seed: Straight()))
    trees = write_tree(tmp_path / "t1.csv", 25).parent
    options = ["--sets", "orchards", "--scenes", "2", "--trees", str(trees), "--out", str(tmp_path)]
    assert script.main(options) == 0
    o = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))["orchards"]
    assert o["all"]["solved"] == 0
    assert {group: n["problems"] for group, n in o["groups"].items()} == {
        "measured at 1.4 m": 2,
        "measured at 1 m": 2,
        "measured at 1.8 m": 2,
    }
    assert o["all"]["planners"] == {"RRTConnect": 0, "BITstar": 6}
    assert o["all"]["missed"] == [row["name"] for row in o["rows"]]
    assert [row["error"] for row in o["all"]["failed"]] == 6 * ["NoPathError"]
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert f"| {o['all']['missed'][0]} | missed | NoPathError |" in text


def test_orchard_motion_that_touches_is_told_by_the_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orchard_scenes, "SHIPPED", ("tour",))
    monkeypatch.setattr(Ompl, "if_installed", classmethod(lambda cls, seed: None))
    monkeypatch.setattr(orchards, "look_at", lambda *_: Findings(1.0, 0.5, 0.0, 0.5, 0.5, 0.5))
    assert script.main(["--sets", "orchards", "--scenes", "1", "--out", str(tmp_path)]) == script.FAULT


def step_row(step: int, outcome: str, from_nothing: str, **more: Any) -> dict[str, Any]:
    """A step that took 2 ms to replan, and 20 ms from nothing."""
    row = {"scene": 7, "step": step, "close": step % 2 == 1, "outcome": outcome, "from_nothing": from_nothing}
    times = {"ms": 2.0, "from_nothing_ms": 20.0, "ratio": 10.0, "to_from_nothing": math.nan}
    if outcome not in (replanning.NO_PATH, replanning.FAILED):
        times |= {"certified": True, "collides": False, "duration_s": 1.0}
    return {**row, **times, **more}


def test_steps_are_counted_by_what_becomes_of_the_motion() -> None:
    rows = [
        step_row(0, "kept", "search", to_from_nothing=1.5, ms=1.0),
        step_row(1, "kept", "no_path"),
        step_row(2, "mended", "search", to_from_nothing=1.01, certified=False),
        step_row(3, "search", "search", to_from_nothing=0.5, collides=True, ms=50.0),
        step_row(4, "no_path", "no_path", ms=100.0),
        step_row(5, "no_path", "roadmap"),
        step_row(6, "failed", "failed", error="TimingError", message="not to be timed"),
    ]
    n = replanning.numbers(rows)
    assert n["steps"] == 7
    assert n["outcomes"] == {"kept": 2, "mended": 1, "search": 1, "no_path": 2, "failed": 1}
    assert (n["replanned"], n["certified"], n["colliding"]) == (4, 3, 1)
    assert n["at_fault"] == ["7.2", "7.3"]
    assert n["only_replanned"] == ["7.1"]
    assert n["only_from_nothing"] == ["7.5"]
    assert n["all"]["ms"]["median"] == 2.0
    assert n["all"]["ms"]["max"] == 50.0
    assert n["per_second"] == 500.0
    assert n["in_all_s"] == pytest.approx(0.159)
    assert n["by_outcome"]["no_path"]["ms"]["max"] == 100.0
    assert [n["by_move"][name]["steps"] for name in ("shifted", "close")] == [2, 2]
    durations = n["all"]["to_from_nothing"]
    assert [durations[key] for key in ("count", "longer", "shorter", "median")] == [3, 1, 1, 1.01]
    shown = {"seed": 0, "scenes": 1, "drawn": 1, "obstacles": 40, "close_share": 0.3, "shift_m": (0.01, 0.05)}
    where = {"processor": "p", "cores": 1, "system": "s", "python": "3", "versions": {}}
    text = to_markdown(
        {
            "environment": where,
            "settings": {"seed": 0, "quick": False},
            "replanning": {**shown, "room_m": 0.02, **n},
        }
    )
    assert "| motion kept | 10 x | 2 | 1.5 |" in text
    assert "| no path | 10 x | 2 |" in text
    assert "| 7.6 | TimingError | - | not to be timed |" in text
    assert "by replanning alone: 1; from nothing alone: 1." in text


def test_obstacle_that_leaves_no_path_goes_back(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = []

    def replan(planner: Planner) -> Any:
        scenes.append(planner.scene)
        raise NoPathError("closed", reached_cells=1)

    monkeypatch.setattr(Planner, "replan", replan)
    n = replanning.measure(robot, seed=0, scenes=1, quick=True, progress=lambda *_: None)
    first = moving_scene(robot, 0, n["rows"][0]["scene"])
    assert n["outcomes"] == {"no_path": replanning.QUICK_STEPS}
    assert len(n["only_from_nothing"]) == replanning.QUICK_STEPS
    for scene in scenes:
        assert sum(now != before for now, before in zip(scene.obstacles, first.obstacles, strict=True)) == 1
    assert math.isnan(n["per_second"])
    assert "benchmark-replanning" not in figures({"replanning": n})


def test_replanned_motion_that_touches_is_told_by_the_exit_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replanning, "look_at", lambda *_: Findings(1.0, 0.5, 0.0, 0.5, 0.5, 0.5))
    options = ["--quick", "--sets", "replanning", "--scenes", "1", "--out", str(tmp_path)]
    assert script.main(options) == script.FAULT


def test_planners_turn_the_base_where_installed(robot: Robot, crop: CropProblems) -> None:
    pytest.importorskip("ompl")
    ompl = Ompl.if_installed(1)
    assert ompl is not None
    tasks = (PeerTask.of(robot, problem.scene) for problem in crop.problems())
    task = next(t for t in tasks if not t.field.is_clear(np.stack([t.problem.start, t.problem.goal]), 1e-3))
    ends = task.problem.start, task.problem.goal
    run = ompl.plan(task, *ends, turns=True, seconds=10.0)
    assert run.path is not None
    np.testing.assert_array_equal(run.path[[0, -1]], ends)
    assert np.ptp(run.path[:, 0]) > 0.0
    assert task.field.is_clear(run.path, task.smallest_margin)
    assert motions_of(task, run.path).processed_s is not None
