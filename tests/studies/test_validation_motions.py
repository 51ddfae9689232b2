"""The independent check of certified motions: it counts right, and it would find what it looks for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import studies.validation.member_motions as validation
import trimesh
from script_loader import load_script
from studies.validation.checker import PlacedBodies, between_rows, read_rows, solids_of
from studies.validation.member_motions import MemberMotions, MotionCounts
from studies.validation.members import write_member, write_stl
from studies.validation.motions import validate_motions

from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.timing.trajectory import read_csv, write_csv


@pytest.fixture(scope="module")
def small() -> MotionCounts:
    return validate_motions(members=2, motions=4, grazing=4, seed=3)


def test_nothing_is_wrong(small: MotionCounts) -> None:
    assert small.ok
    assert (small.certified, small.grazing, small.clear) == (4, 4, 4)
    assert small.asked == small.certified + sum(small.refused.values())
    assert small.looks > 1000 * small.certified
    assert sum(small.grazed.values()) == 4
    assert json.loads(json.dumps(small.as_dict()))["ok"]


def test_the_same_whatever_the_number_of_jobs(small: MotionCounts) -> None:
    assert validate_motions(members=2, motions=4, grazing=4, seed=3, jobs=2).as_dict() == small.as_dict()


def scene_file(folder: Path, start: Any, goal: Any, *obstacles: dict[str, Any]) -> Path:
    path = folder / "scene.json"
    numbers = {"format": "hplan-scene/1", "name": "test", "obstacles": list(obstacles)}
    ends = {"start": {"joints_rad": list(start)}, "goal": {"joints_rad": list(goal)}}
    path.write_text(json.dumps({**numbers, **ends}), "utf-8")
    return path


@pytest.mark.parametrize(
    "obstacle",
    [
        {"kind": "sphere", "radius": 0.05},
        {"kind": "box", "size": [0.4, 0.4, 0.4], "rpy_deg": [10.0, 20.0, 30.0]},
        {"kind": "capsule", "radius": 0.02},
        {"kind": "mesh", "file": "rock.stl"},
        {"kind": "points", "file": "cloud.xyz", "radius": 0.02},
    ],
    ids=lambda item: item["kind"],
)
def test_contact_with_an_obstacle_is_found(robot: Robot, tmp_path: Path, obstacle: dict[str, Any]) -> None:
    """A motion planned without the obstacle: from top to bottom, as deep as it may be."""
    start, goal = (0.0, 0.2, 0.3, 0.4), (1.0, 1.0, 0.9, 0.8)
    planned = plan(robot, load_scene(scene_file(tmp_path, start, goal)))
    middle = robot.tool_positions(planned.trajectory.position[planned.trajectory.samples // 2])
    corners = 0.1 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    write_stl(tmp_path / "rock.stl", corners)
    np.savetxt(tmp_path / "cloud.xyz", corners * 0.2)
    place = {"from": middle.tolist(), "to": (middle + 0.3).tolist()} if obstacle["kind"] == "capsule" else {}
    where = "center" if obstacle["kind"] in ("sphere", "box") else "position"
    item = {"name": "o", **obstacle, **(place or {where: middle.tolist()})}
    path = scene_file(tmp_path, start, goal, item)
    assert load_scene(path).obstacles[0].kind == obstacle["kind"]
    tally = MotionCounts()
    member = MemberMotions(robot, tmp_path, np.random.default_rng(0), tally, "test")
    member.look_at(planned, path)
    assert [case["second"] for case in tally.contacts] == ["o"]
    assert tally.contacts[0]["depth_m"] > 0.0
    away = [value + 3.0 for value in middle.tolist()]
    aside = {**item, **({"from": away, "to": [value + 0.3 for value in away]} if place else {where: away})}
    member.look_at(planned, scene_file(tmp_path, start, goal, aside))
    assert len(tally.contacts) == 1


def test_deep_contact_is_found(robot: Robot, tmp_path: Path) -> None:
    """A link wholly inside a box: coal's own default request does not see it."""
    q = np.array([0.0, 0.5, 0.5, 0.5])
    box = {"name": "o", "kind": "box", "center": [0.0, 0.0, 0.6], "size": [8.0, 8.0, 8.0]}
    bodies = PlacedBodies(robot.urdf_path, scene_file(tmp_path, q, q, box))
    for body in range(bodies.count):
        touch = bodies.first_touch(np.zeros(1), q[None], [(body, bodies.count)])
        assert touch is not None
        assert touch.second == "o"


def test_own_bodies_are_looked_at(tmp_path: Path) -> None:
    """Of straight lines between configurations that touch nothing, some lead through the arm itself."""
    found: set[str] = set()
    for seed in range(6):
        rng = np.random.default_rng(seed)
        robot = load_robot(write_member(tmp_path, rng))
        member = MemberMotions(robot, tmp_path, rng, MotionCounts(), "test")
        bodies, shapes = member.bodies, member.bodies.geometry.geometryObjects
        assert all(shapes[a].parentJoint != shapes[b].parentJoint for a, b in member.pairs)
        for _ in range(10):
            line = np.linspace(member.configuration(), member.configuration(), 200)
            touch = bodies.first_touch(np.arange(200.0), line, member.pairs)
            if touch is not None:
                found |= {touch.first.split("_")[0], touch.second.split("_")[0]}
    assert {"link"} < found
    assert found & {"mast", "counterweight", "cabinet", "gripper", "turret"}


def test_only_joined_pairs_and_those_that_always_touch_are_left_out(tmp_path: Path) -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        robot = load_robot(write_member(tmp_path, rng))
        bodies = PlacedBodies(robot.urdf_path)
        kept, shapes, frames = bodies.own_pairs(rng), bodies.geometry.geometryObjects, bodies.model.frames
        for a in range(bodies.count):
            for b in range(a + 1, bodies.count):
                if (a, b) in kept or shapes[a].parentJoint == shapes[b].parentJoint:
                    continue
                names = sorted(frames[shapes[k].parentFrame].name for k in (a, b))
                if "mast" in names or "cabinet" in names or "counterweight" in names:
                    q = rng.uniform(robot.lower, robot.upper, (50, robot.dof))
                    assert (bodies.distances(q, [(a, b)]) < 0.0).all()
                    continue
                chain = [
                    "base_link", *(["turret"] if robot.has_yaw else []), *robot.arm.link_names,
                ]  # fmt: skip
                if names[0] in chain and names[1] in chain:
                    assert (
                        abs(chain.index(names[0]) - chain.index(names[1])) == 1
                        or (
                            bodies.distances(rng.uniform(robot.lower, robot.upper, (50, robot.dof)), [(a, b)]) < 0.0
                        ).all()
                    )


@pytest.mark.parametrize("verified", [True, False])
def test_a_wrong_certificate_is_counted(monkeypatch: pytest.MonkeyPatch, verified: bool) -> None:
    always = SimpleNamespace(verified=verified, violations=())
    monkeypatch.setattr(validation, "certify", lambda *_: always)
    tally = validate_motions(members=1, motions=0, grazing=5, seed=0)
    assert (tally.grazing, tally.clear, tally.ok) == (5, 5, False)
    assert len(tally.verified) == (5 if verified else 0)
    assert len(tally.unverified) == (0 if verified else 5)


def test_obstacles_stand_where_they_are_said_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Least distance of every one that was placed, asked anew of its numbers in the scene."""
    placed: list[tuple[float, float]] = []
    rng = np.random.default_rng(5)
    robot = load_robot(write_member(tmp_path, rng))
    member = MemberMotions(robot, tmp_path, rng, MotionCounts(), "test")
    original: Callable[..., Any] = MemberMotions.placed

    def watched(self: Any, shapes: Any, target: int, q: Any, distance: float) -> Any:
        found = original(self, shapes, target, q, distance)
        if found is not None:
            (_, body, place) = solids_of(scene_file(tmp_path, q[0], q[0], found[0]))[0]
            placed.append((self._least(shapes, q, body, place)[0], distance))
        return found

    monkeypatch.setattr(MemberMotions, "placed", watched)
    member.grazing_motions(4, 4)
    assert len(placed) >= 8
    for real, asked in placed:
        assert abs(real - asked) <= 0.05 * abs(asked) + 2e-6


def test_rows_are_read_and_filled_in_as_cubics(robot: Robot, tmp_path: Path) -> None:
    motion = plan(robot, load_scene(scene_file(tmp_path, (0.0, 0.2, 0.3, 0.4), (0.5, 0.4, 0.6, 0.8)))).trajectory
    path = write_csv(motion, tmp_path / "t.csv")
    names, time, position, velocity = read_rows(path)
    assert tuple(names) == robot.joint_names
    np.testing.assert_array_equal(position, read_csv(path).position)
    np.testing.assert_array_equal(velocity, read_csv(path).velocity)
    ticks, q = between_rows(time, position, velocity)
    assert np.diff(ticks).max() < 1.001e-3
    np.testing.assert_array_equal(q[np.searchsorted(ticks, time)], position)
    cubic = np.polynomial.Polynomial([0.1, -0.3, 2.0, -1.5])
    knots = np.array([0.0, 0.3, 0.4, 1.0])
    ticks, q = between_rows(knots, cubic(knots)[:, None], cubic.deriv()(knots)[:, None])
    np.testing.assert_allclose(q[:, 0], cubic(ticks), atol=1e-12)


def test_stl_is_the_closed_hull(tmp_path: Path) -> None:
    write_stl(tmp_path / "g.stl", np.random.default_rng(0).uniform(-1.0, 1.0, (20, 3)))
    mesh = trimesh.load(tmp_path / "g.stl")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(mesh.convex_hull.volume)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = load_script("validate_motions")
    arguments = ["--members", "1", "--motions", "1", "--grazing", "1", "--out", str(tmp_path)]
    assert script.main(arguments) == 0
    numbers = json.loads((tmp_path / script.RESULT).read_text())
    assert (numbers["ok"], numbers["certified"], numbers["grazing"], numbers["clear"]) == (True, 1, 1, 1)
    assert "with contact: 0" in capsys.readouterr().out
    assert script.main(["--members", "0"]) == 2
