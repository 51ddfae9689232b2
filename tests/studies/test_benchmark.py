"""The command of all studies: each runs on a problem or two and finds nothing at fault."""

from __future__ import annotations

import importlib
import io
import json
import math
import sys
import tarfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from script_loader import load_script
from studies import harness, motionbenchmaker, reference, wood_grasps, wood_trial
from studies import trees as among_trees
from studies import wood as bending_wood
from studies.harness import Study, StudyConfig, read_rows
from studies.outside import TimedMotion
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan.apps.execution.wind import Wind
from hplan.errors import InputError
from hplan.planning.failures import REASONS
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Sphere
from hplan.scene.wood import Wood

script = load_script("benchmark")


@pytest.fixture
def six(tmp_path: Path) -> str:
    path = tmp_path / "six.urdf"
    path.write_text(six_axis_arm())
    path.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS)
    return str(path)


@pytest.fixture
def trees(tmp_path: Path) -> str:
    """A trunk with level branches towards the base, a hand's breadth apart, the lower ones out of reach."""
    folder = tmp_path / "trees"
    folder.mkdir()
    rows = ["kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,3,0.03"]
    rows += [f"branch,0,0,{0.3 + 0.1 * i},-0.3,{0.1 * (i % 3 - 1)},{0.3 + 0.1 * i},0.01" for i in range(25)]
    (folder / "t1.csv").write_text("\n".join(rows) + "\n")
    return str(folder)


def rows_of(study: str, out: Path, *options: str) -> list[dict]:
    harness._WARM.add(study)  # skips the warm-up, since times do not matter here
    assert script.main([study, "--count", "1", "--out", str(out), *options]) == 0
    return read_rows(out / f"{study}.jsonl")


@pytest.mark.parametrize("study", ["fastest", "deadlines", "camera", "upright"])
def test_study_runs(study: str, tmp_path: Path) -> None:
    rows = rows_of(study, tmp_path, "--effort", "quick")
    assert rows
    assert not any(row["fault"] for row in rows if "fault" in row)
    assert len({row["name"] for row in rows}) == len(rows)
    assert f"### {study}" in (tmp_path / "benchmark.md").read_text()


def test_retargets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from studies import retargets

    folder = _peers_folder(tmp_path / "xarm6")
    options = ("--only", "still", "drifting", "boxes", "pillars", "--files", str(folder), "--values", "ticks=100")
    # Motions that take too long are dropped: what compiles kernels must not decide, nor the machine's speed.
    monkeypatch.setattr(retargets, "timed", lambda call: (call(), 0.0))
    rows_of("retargets", tmp_path / "first", "--effort", "quick", *options)
    found = rows_of("retargets", tmp_path, "--effort", "quick", *options)
    assert len({row["name"] for row in found}) == len(found)
    assert "### retargets" in (tmp_path / "benchmark.md").read_text()
    rows = {row["kind"][0]: row for row in found}
    assert not any(row["fault"] or row["contacts"] for row in rows.values())
    assert all(len(row["stop_ms"]) == row["retargets"] > 0 for row in rows.values())
    assert sum(row["splices"].get("certified", 0) for row in rows.values()) > 0
    assert rows["boxes"]["success"]
    assert rows["boxes"]["target_s"] < 2.0


def test_retargets_without_files(tmp_path: Path) -> None:
    boxes = ["retargets", "--only", "boxes", "--count", "1", "--out", str(tmp_path)]
    assert script.main(boxes) == script.main([*boxes, "--files", str(tmp_path)]) == 2


def _peers_folder(folder: Path) -> Path:
    """A folder as RPMPLv2's `data/xarm6`, with another arm: a box flies to its side, and a pillar goes round it."""
    # The last link is farther out, so that the gripper is clear of the others.
    text = six_axis_arm().replace("wrist_3_link", "link6").replace("tool0", "link_eef").replace("0 0 0.095", "0 0 0.3")
    pillar, flying = {"pos": [0.0, 1.2, 0.5], "dim": [0.2, 0.2, 1.0]}, {"pos": [0.0, -1.2, 0.5], "vel": [0.5, 0.0, 0.0]}
    ends = {"q_start": [0.0, -1.0, 1.0, 0.0, 0.5, 0.0], "q_goal": [0.5, -1.0, 1.2, 0.0, 0.5, 0.0]}
    limits = {"max_vel": [3.0] * 6, "max_acc": [10.0] * 6, "max_jerk": [500.0] * 6}
    space = {"capsules_radius": [0.05, 0.1], "WS_center": [0.0, 0.0, 0.3], "WS_radius": 1.5}
    files = {
        "scenario1": {"environment": [{"box": {"pos": [0.0, 0.0, -0.5], "dim": [1.0, 1.0, 0.1]}}, {"box": pillar}],
                      "robot": {**ends, **limits}, "testing": {"max_vel_obs": 0.3}},
        "scenario_random_obstacles": {"environment": [], "robot": {**limits, **space},
                                      "random_obstacles": {"dim": [0.01] * 3, "max_vel": 1.6}},
    }  # fmt: skip
    for name, content in files.items():
        (folder / name).mkdir(parents=True)
        (folder / name / f"{name}.yaml").write_text(yaml.safe_dump(content))
    runs = {"scenario_10": {"run_0": {"start": ends["q_start"], "goal": ends["q_goal"], "object_0": flying}}}
    (folder / "scenario_random_obstacles/random_scenarios.yaml").write_text(yaml.safe_dump(runs))
    (folder / "xarm6.urdf").write_text(text)
    return folder


def test_reference_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "REPETITIONS", 1)
    rows = {row["name"]: row for row in rows_of("reference", tmp_path)}
    assert rows["grid path, toppra"]["ratio"] > 2.0
    assert rows["hplan"]["contacts"] == 0 < rows["shortened, toppra's defaults"]["contacts"]


def test_motions_among_trees(tmp_path: Path, trees: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(among_trees, "FRUITS", 6)
    monkeypatch.setattr(among_trees, "SHIPPED", ("tour",))  # the others take long
    rows = rows_of("trees", tmp_path, "--trees", trees)
    assert {row["group"] for row in rows} >= {"measured at 1.4 m", "measured at 1 m", "tour"}
    assert all(row["certified"] and row["contacts"] == 0 for row in rows if row["solved"])
    config = "--values", "stands=0", "fruits=6", "--effort", "quick"
    (together,) = rows_of("cell_trees", tmp_path, "--trees", trees, *config)
    assert together["solved"]
    assert together["contacts"] == together["with_wood"] == 0
    (tour,) = rows_of("tours", tmp_path, "--trees", trees)
    assert (tour["fruits"], tour["solved"]) == (6, True)


def test_rows_of_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(among_trees, "ROW_STEP", 4.0)
    rows = ["kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,2,0.03", "branch,0,0,1.2,-0.5,0,1.2,0.004"]
    rows += [f"fruit,{x},0.0,{z},{x},0.0,{z},0.03" for x, z in ((-0.45, 1.165), (-0.2, 1.3))]
    (tmp_path / "t1.csv").write_text("\n".join(rows) + "\n")
    found = rows_of("rows", tmp_path / "out", "--trees", str(tmp_path), "--effort", "quick")
    expected = [f"{wood}, {grasps}" for wood in among_trees.WOODS for grasps in among_trees.OFFSETS]
    assert [row["kind"] for row in found] == expected
    for row in found:
        assert row["fruits"] == 2 == row["picked"] + sum(row[key] for key in REASONS)
    assert found[-1]["picked"] > 0
    widest = among_trees._tree_row(tmp_path / "t1.csv", "forces", "30 mm off").scene
    assert widest.wood is not None
    assert (widest.wood.capture_range, widest.fruits[0].grasp_offset) == (0.03, 0.03)


def test_any_arm(tmp_path: Path, six: str) -> None:
    (row,) = rows_of("random", tmp_path, "--robot", six, "--first", "3", "--effort", "quick")
    assert row["certified"]


def test_peers(tmp_path: Path, trees: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ompl")
    for name, value in {"FRUITS": 6, "SHIPPED": (), "DISTANCES": (1.4,)}.items():
        monkeypatch.setattr(among_trees, name, value)
    (row,) = rows_of("trees", tmp_path, "--trees", trees, "--peer")
    assert row["peer_solved"]
    assert row["to_peer"] < 1.05


def _problems(folder: Path) -> Path:
    """A folder of problems as VAMP's `resources`: one for the Panda, with a box between its ends."""
    names = [f"panda_joint{number}" for number in range(1, 8)]
    start, goal = (-0.6, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8), (0.6, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8)
    pose = {"position": [0.55, 0.0, 0.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
    block = {"primitives": [{"type": "box", "dimensions": [0.2, 0.04, 0.2]}], "primitive_poses": [pose]}
    place = {"position": [0.0, 0.0, 0.45], "orientation": [0.0, 0.0, 0.0, 1.0]}
    constraints = [{"joint_name": name, "position": q} for name, q in zip(names, goal, strict=True)]
    files = {
        "scene0001": {"world": {"collision_objects": [{"id": "block", "pose": place, **block}]}},
        "request0001": {
            "start_state": {"joint_state": {"name": names, "position": list(start)}},
            "goal_constraints": [{"joint_constraints": constraints}],
        },
    }
    (folder / "panda").mkdir(parents=True)
    with tarfile.open(folder / "panda" / "problems.tar.bz2", "w:bz2") as archive:
        for name, content in files.items():
            text = yaml.safe_dump(content).encode()
            member = tarfile.TarInfo(f"problems/box_panda/{name}.yaml")
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
    return folder


def test_motionbenchmaker(tmp_path: Path) -> None:
    public = Path(__file__).parents[3] / "shared" / "data" / "vamp"
    files, robots = (public, ("panda", "ur5", "fetch")) if public.is_dir() else (_problems(tmp_path), ("panda",))
    try:
        peer = ["--peer", "roboplan"] if find_spec("roboplan") else []
        options = "--files", str(files), "--only", "box", *robots, "--effort", "quick", *peer
        rows = rows_of("motionbenchmaker", tmp_path, *options)
    except InputError as error:
        pytest.skip(error.message)
    assert [row["group"][0] for row in rows] == [
        robot + words for robot in robots for words in ("", " loaded", " pose", " pose loaded")
    ]
    assert all(row["free"] and row["certified"] and row["contacts"] == 0 and row["limits"] < 1.005 for row in rows)
    assert all(row["peer_solved"] and row["to_peer"] < 1.3 for row in rows if peer and "pose" not in row["name"])


def test_motionbenchmaker_reads_the_scene(tmp_path: Path) -> None:
    problem = motionbenchmaker.Problem("panda", "box", 1, "joints", "unloaded")
    try:
        scene = motionbenchmaker.scene_of(_problems(tmp_path), problem)
    except InputError as error:
        pytest.skip(error.message)
    (block,) = scene.obstacles
    assert block.center == pytest.approx((0.55, 0.0, 0.45), abs=1e-12)
    assert block.size == (0.2, 0.04, 0.2)
    assert scene.goal.configuration[0] == 0.6
    config = StudyConfig(files=tmp_path, first=1, step=2, count=2, only=frozenset({"panda", "box", "pose", "loaded"}))
    assert [problem.number for problem in motionbenchmaker.problems(config)] == [1, 3]


def test_exit_status_reports_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = Study("toy", "", lambda config, n: {"name": f"{n}", "ms": np.float64(n), "fault": n == 2}, ("ms",))
    monkeypatch.setattr(script, "import_module", lambda _: SimpleNamespace(FASTEST=study))
    assert script.main(["fastest", "--count", "2", "--out", str(tmp_path / "a")]) == 0
    assert script.main(["fastest", "--count", "3", "--out", str(tmp_path / "b")]) == 5
    first = json.loads((tmp_path / "b" / "toy.jsonl").read_text().splitlines()[0])
    assert (first["study"], first["count"]) == ("toy", 3)
    assert script.main(["fastest", "--compare", str(tmp_path / "a"), str(tmp_path / "b")]) == 0


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path)]
    for options, needed in (
        (["fastest", "--count", "0"], "--count"),
        (["everything"], "one of reference"),
        (["random"], "needs --robot"),
        (["motionbenchmaker", "--files", "x", "--only", "baxter"], "--only"),
        (["fastest", "--only", "cage"], "one of none for fastest"),
        (["fastest", "--peer", "roboplan"], "one of RRTConnect, BITstar for fastest"),
        (["deadlines", "--values", "deadlines"], "--values"),
        (["cells", "--compare", str(tmp_path), str(tmp_path)], "no study is in both"),
        (["trees", "--trees", str(tmp_path)], "the folder has no CSV"),
    ):
        assert script.main([*options, *out]) == 2
        assert needed in " ".join(capsys.readouterr().err.split())


def test_trees_that_bend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco", reason="the extra `execution` is not installed")
    for name, value in (("PICK_DISTANCES", 1.6), ("PICK_SIDES", 0.0), ("PICK_TURNS", 180.0)):
        monkeypatch.setattr(bending_wood, name, (value, value))
    rows = ["kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,3,0.03"]
    rows += [f"branch,0,0,{0.3 * i},0.5,0,{0.3 * i},0.005" for i in range(1, 8)]
    rows += ["fruit,0.45,0,1.45,0.45,0,1.45,0.04"]
    (tmp_path / "t1.csv").write_text("\n".join(rows) + "\n")
    trees = str(tmp_path)
    (static,) = rows_of("wood_static", tmp_path, "--trees", trees)
    assert static["at_rest_error"] < 0.05
    moving = rows_of("wood_moving", tmp_path, "--trees", trees, "--count", "4")
    assert all(0.0 < row["force_ratio"] < 1.0 for row in moving if row["touched"])
    assert any(row["touched"] for row in moving)
    (pick,) = rows_of("wood_picks", tmp_path, "--trees", trees, "--count", "1")
    assert pick["certified"]
    assert pick["rigid_contacts"] == pick["broken"] == pick["knocked_off"] == 0
    monkeypatch.setattr(wood_grasps, "GRASPS", 1)
    grasped = rows_of("wood_grasps", tmp_path, "--trees", trees, "--count", "1")
    assert grasped
    assert all(row["pushes"] > 0 and 0.0 <= row["goal_ratio"] < 1.0 for row in grasped)


def test_motions_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ompl")
    from studies import others

    monkeypatch.setattr(others, "ROBOTS", ("ur5",))
    rows = rows_of("others", tmp_path)
    planners = [f"{name}, ur5" for name in others.PLANNERS for _ in range(others.MOTIONS)]
    assert [row["planner"] for row in rows] == planners
    assert any(row["solved"] for row in rows)
    assert not any(row["fault"] for row in rows if row["solved"])


def test_both_judges_see_the_contacts_of_straight_motions(monkeypatch: pytest.MonkeyPatch) -> None:
    from studies import others

    monkeypatch.setattr(others, "_motion", lambda robot, scene, *_: straight_motion(scene))
    straight = [others._row(harness.StudyConfig(), ("ur5", number, "straight", 0)) for number in range(3)]
    assert any(row is not None and row["collides"] for row in straight)
    assert not any(row is None or (row["collides"] and row["verified"]) for row in straight)


def straight_motion(scene: Scene) -> TimedMotion:
    start, goal = scene.start.configuration, scene.goal.configuration
    return TimedMotion(4.0, lambda t: start + np.outer(t / 4.0, goal - start))


def test_streams_by_the_rules_of_libfranka(tmp_path: Path) -> None:
    rows = rows_of("franka", tmp_path, "--effort", "quick")
    assert {row["kind"] for row in rows} >= {"motion"}
    assert all(row["accepted"] for row in rows)


def test_a_trial_in_the_wind(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the extra `execution` is not installed")
    rows = ["kind,x1,y1,z1,x2,y2,z2,radius", "trunk,0,0,0,0,0,3,0.03"]
    rows += [f"branch,0,0,{0.3 * i},0.5,0,{0.3 * i},0.005" for i in range(1, 8)]
    rows += ["fruit,0.45,0,1.45,0.45,0,1.45,0.04"]
    (tmp_path / "t1.csv").write_text("\n".join(rows) + "\n")
    # Of the errors covered by default, those of base and camera alone leave no room at this branch.
    values = ("planners=0", "distance=1.6", "sigmas=0", "tracking=0.0005")
    (trial,) = rows_of("wood_trial", tmp_path, "--trees", str(tmp_path), "--values", *values)
    (moving,) = rows_of("wood_trial", tmp_path, "--trees", str(tmp_path), "--values", *values, "moves_all=1")
    for name in ("planned", "picked", "broken", "knocked_off", "rigid_contacts", "held_contacts"):
        assert trial[name] == moving[name]
    assert trial["miss_mm"] == pytest.approx(moving["miss_mm"], abs=1.0)
    assert trial["held_contacts"] == 0
    assert trial["planned"] == trial["picked"] == 1
    assert trial["broken"] == trial["knocked_off"] == trial["rigid_contacts"] == 0
    assert not trial["diverged"]
    assert trial["tracking_mrad"] < 0.5  # the tracking error that the certificate covers


def test_a_trial_of_minutes_sums_up_its_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    def at_stop(config: StudyConfig, trial: wood_trial.Trial, stop: int | None) -> dict[str, object]:
        if stop == 1:  # nothing is within reach
            return {"name": trial.name, "planned": 0, "picked": 0, "ms": 1.0}
        row = {"planned": 3, "picked": 2, "ms": 1.0, "worked_s": 25.0, "limb_force_n": float(stop or 0), "broken": 1}
        return {"name": trial.name, **row}

    monkeypatch.setattr(wood_trial, "_at_stop", at_stop)
    trial = wood_trial.Trial("tree", Path("tree.csv"), 0, "hplan")
    found = wood_trial._try(StudyConfig(values={"minutes": (1.0,)}), trial)
    assert (found["stops"], found["picked"], found["broken"], found["limb_force_n"]) == (4, 6, 3, 3.0)
    assert found["fruit_per_hour"] == pytest.approx(3600.0 * 6 / 75.0)
    assert wood_trial._try(StudyConfig(values={"stops": (2.0,)}), trial)["stops"] == 2
    later = wood_trial._try(StudyConfig(values={"stops": (2.0, 5.0)}), trial)
    assert (later["stops"], later["limb_force_n"]) == (3, 4.0)


def test_sway_of_a_limb_in_a_gust_is_that_of_a_cantilever(robot: Robot) -> None:
    pytest.importorskip("mujoco", reason="the extra `execution` is not installed")
    trunk = Capsule(name="trunk", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 3.0), radius=0.03)
    shoot = Capsule(name="shoot", start=(0.0, 0.0, 1.0), end=(0.0, 0.8, 1.0), radius=0.003, parent="trunk")
    rest = Start(joints_deg=(0.0,)), Goal(joints_deg=(0.0,))
    scene = Scene(name="tree", start=rest[0], goal=rest[1], obstacles=(trunk, shoot), wood=Wood())
    sway = wood_trial._sway(scene, Wind(speed_m_s=1.0, intensity=1.0 / 3.0, leaf_width_m=0.02))
    load = 0.5 * 1.2 * 2.0**2 * (2.0 * 0.003 + 0.02)  # newton per metre
    rigidity = 5e9 * 0.25 * math.pi * 0.003**4
    assert sway["shoot"] == pytest.approx([load * 0.8**4 / (8.0 * rigidity), 0.0, 0.0], rel=0.05, abs=1e-3)

    # It sweeps all places between its own and the displaced one.
    away = scene.shift((1.0, 0.0, 0.0))
    trunk, shoot = wood_trial._swaying(robot, away, sway).obstacles
    assert trunk == away.obstacles[0]
    assert shoot.sway is not None
    ends = np.array([[1.0, 0.0, 1.0], [1.0, 0.8, 1.0]])
    np.testing.assert_allclose(shoot.core - shoot.sway.reach, ends, atol=1e-9)
    np.testing.assert_allclose(shoot.core + shoot.sway.reach, ends + sway["shoot"], atol=1e-9)
    # One that swings against the robot's base stays where it is.
    assert wood_trial._swaying(robot, scene, {"shoot": np.array([0.0, 0.0, -0.9])}).obstacles == scene.obstacles


class _Placed(SimpleNamespace):
    """vamp-planner's functions that its peer calls; obstacles are tuples."""

    def __init__(self) -> None:
        kinds = {"Sphere": _of("sphere"), "Cuboid": _of("box"), "Cylinder": _of("can")}
        super().__init__(placed=[], Environment=lambda: self, **kinds)
        self.add_sphere = self.add_cuboid = self.add_capsule = self.placed.append

    def configure_robot_and_planner_with_kwargs(self, name: str, planner: str) -> tuple[object, ...]:
        assert (name, planner) == ("panda", "rrtc")
        halfway = SimpleNamespace(numpy=lambda: np.array([[0.1], [0.5], [0.9]], dtype=np.float32))
        arm = SimpleNamespace(halton=list, simplify=lambda *_: SimpleNamespace(path=halfway))
        return arm, lambda start, goals, *_: SimpleNamespace(solved=bool(goals[0] > start), path=None), None, None


def _of(kind: str) -> Callable[..., tuple[object, ...]]:
    return lambda *values: (kind, *(np.round(value, 9).tolist() for value in values))


def test_vamp_gets_boxes_balls_and_capsules(monkeypatch: pytest.MonkeyPatch) -> None:
    placed = _Placed()
    monkeypatch.setitem(sys.modules, "vamp", placed)
    monkeypatch.delitem(sys.modules, "studies.vamp_peer", raising=False)
    vamp_arm = importlib.import_module("studies.vamp_peer").VampArm
    monkeypatch.delitem(sys.modules, "studies.vamp_peer")
    turned = {"center": (1.0, 2.0, 3.0), "rpy_deg": (90.0, 0.0, 0.0)}
    ball, box = Sphere(name="a", center=(1.0, 0.0, 0.0), radius=0.1), Box(name="b", size=(0.2, 0.4, 0.6), **turned)
    can = Cylinder(name="c", radius=0.1, length=0.5, **turned)
    arm = vamp_arm("panda", [ball, box, can])
    vamp_arm("panda", [can], boxes=True)
    place = [1.0, 2.0, 3.0], [round(math.pi / 2.0, 9), 0.0, 0.0]
    assert placed.placed == [
        ("sphere", [1.0, 0.0, 0.0], 0.1),
        ("box", *place, [0.1, 0.2, 0.3]),
        ("can", *place, 0.1, 0.5),
        ("box", *place, [0.1, 0.1, 0.25]),
    ]
    assert arm.path(np.zeros(1), np.ones(1)).ravel().tolist() == [0.0, 0.5, 1.0]
    assert arm.path(np.ones(1), np.zeros(1)) is None
    with pytest.raises(InputError, match="vamp-planner is given"):
        vamp_arm("panda", [Capsule(name="d", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.0), radius=0.1)])


def test_a_missing_vamp_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "vamp", None)
    monkeypatch.delitem(sys.modules, "studies.vamp_peer", raising=False)
    with pytest.raises(InputError, match="pip install vamp-planner"):
        importlib.import_module("studies.vamp_peer")
