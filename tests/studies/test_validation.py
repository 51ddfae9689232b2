"""The C-space held against coal: nothing differs, and what differs would be seen."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from script_loader import load_script
from studies.planar_cspace import joint_grid
from studies.validation.cspace import EXAMPLES, Comparison, Validation, validate_cspace

from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.collision.coal_shapes import LINK_SHAPES
from hplan.grid.grid import Occupancy
from hplan.grid.sections import SECTION_ERROR
from hplan.robot.family.members import ArmSpec, write_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere

COARSE = float(np.radians(5.0))

BRANCH = Capsule(name="branch", start=(1.2, -0.5, 0.9), end=(1.5, 0.6, 1.4), radius=0.03)
WIRE = Capsule(name="wire", start=(1.1, 0.0, 1.2), end=(1.5, 0.0, 1.9), radius=0.01)
CRATE = Box(name="crate", center=(0.4, 0.05, 2.0), size=(0.3, 0.2, 0.3), rpy_deg=(10.0, 20.0, 30.0))
POST = Box(name="post", center=(1.6, 0.0, 1.0), size=(0.1, 0.1, 1.0))
BESIDE = Sphere(name="beside", center=(1.0, 0.12, 1.6), radius=0.15)

script = load_script("validate_cspace")


def scene_of(*obstacles: Sphere | Capsule | Box, clearance: float = 0.0, joints: int = 4) -> Scene:
    rest = (0.0,) * joints
    return Scene(
        name="test", start=Start(joints_rad=rest), goal=Goal(joints_rad=rest), clearance=clearance, obstacles=obstacles
    )


def by(result: Validation, links: str, model: str = "capsule") -> Comparison:
    (found,) = [c for c in result.comparisons if (c.links, c.link_model) == (links, model)]
    return found


def assert_sound(result: Validation) -> None:
    """No fault, and no more conservatism than sections explain."""
    assert result.ok
    for checker in ("capsule", "urdf"):
        comparison = by(result, checker)
        assert comparison.decisive
        assert comparison.faults == 0
        assert comparison.unexplained == 0
        assert comparison.widest_gap_m <= SECTION_ERROR
        assert comparison.occupied == comparison.coal_occupied + comparison.conservative + comparison.in_contact
        assert comparison.coal_occupied > 0


# The reference scene


@pytest.fixture(scope="module")
def reference(robot: Robot, scene: Scene) -> Validation:
    return validate_cspace(robot, scene, step=float(np.radians(3.0)))


def test_no_cell_of_the_reference_scene_differs(reference: Validation) -> None:
    """At every degree, too: `tests/studies/test_benchmark.py` looks at those."""
    assert reference.ok
    for links, model in (("capsule", "capsule"), ("urdf", "capsule"), ("box", "rectangle")):
        comparison = by(reference, links, model)
        assert comparison.decisive
        assert comparison.occupied == comparison.coal_occupied > 0
        assert comparison.faults == comparison.conservative == comparison.in_contact == 0
        assert comparison.fault_examples == comparison.conservative_examples == ()
    # In the arm plane the capsule holds the rectangle, so that coal's boxes find nothing that the capsules do not.
    beams = by(reference, "box")
    assert not beams.decisive
    assert beams.faults == 0 < beams.unexplained <= beams.conservative


# Other scenes and robots


@pytest.mark.parametrize("clearance", [0.0, 0.03])
@pytest.mark.parametrize("yaw_deg", [0.0, 1.5])
@pytest.mark.parametrize("obstacles", [(BRANCH, WIRE, CRATE, POST, BESIDE)])
def test_other_obstacles(robot: Robot, obstacles: tuple[Any, ...], yaw_deg: float, clearance: float) -> None:
    result = validate_cspace(robot, scene_of(*obstacles, clearance=clearance), step=COARSE, yaw=np.radians(yaw_deg))
    assert_sound(result)
    assert result.clearance_m == clearance


@pytest.mark.parametrize(("links", "has_yaw", "step_deg"), [(2, False, 2), (4, True, 15)])
def test_other_robots(tmp_path: Path, links: int, has_yaw: bool, step_deg: float) -> None:
    joints = links + has_yaw
    spec = ArmSpec(
        name="other",
        link_lengths=tuple(0.7 - 0.1 * i for i in range(links)),
        link_half_widths=tuple(0.06 - 0.01 * i for i in range(links)),
        link_masses=(2.0,) * links,
        lower=(-1.0,) * joints,
        upper=(1.3,) * joints,
        velocity=(1.0,) * joints,
        effort=(200.0,) * joints,
        acceleration=(2.0,) * joints,
        has_yaw=has_yaw,
    )
    robot = load_robot(write_robot(spec, tmp_path / "other.urdf")[0])
    obstacles = (
        Sphere(name="ball", center=(0.6, 0.0, 0.8), radius=0.1),
        Capsule(name="branch", start=(0.5, -0.4, 0.1), end=(0.7, 0.5, 0.6), radius=0.03),
    )
    result = validate_cspace(robot, scene_of(*obstacles, joints=joints), step=float(np.radians(step_deg)))
    assert_sound(result)
    assert len(result.shape) == links
    assert result.joint_names == robot.joint_names


# What is wrong is seen


def test_a_cspace_without_the_obstacle_is_caught(robot: Robot, scene: Scene) -> None:
    grid = joint_grid(robot.arm, COARSE)
    blind = Occupancy.from_mask(grid, np.zeros(grid.shape, dtype=bool))
    result = validate_cspace(robot, scene, space=blind)
    honest = by(validate_cspace(robot, scene, step=COARSE), "capsule")
    comparison = by(result, "capsule")
    assert not result.ok
    assert comparison.faults == honest.coal_occupied
    assert comparison.deepest_fault_m > 0.1
    assert len(comparison.fault_examples) == EXAMPLES
    depths = [example.distance_m for example in comparison.fault_examples]
    assert depths == sorted(depths)
    assert depths[0] == -comparison.deepest_fault_m
    assert comparison.fault_examples[0].obstacle == "ball"
    assert result.faults == comparison.faults + by(result, "urdf").faults


def test_obstacles_at_pedestal_and_turret_are_told(robot: Robot, scene: Scene) -> None:
    stone = Box(name="stone", center=(0.2, 0.0, 0.1), size=(0.3, 0.2, 0.2))
    nut = Sphere(name="nut", center=(0.0, 0.13, 0.5), radius=0.01)
    (contact,) = base_contacts(robot, (stone, nut))
    assert (contact.link, contact.obstacle) == ("base_link", "stone")
    assert contact.distance_m < 0.0
    assert {c.link for c in base_contacts(robot, (stone, nut), margin=0.02)} == {"base_link", "turret"}
    assert validate_cspace(robot, scene, step=COARSE).base_contacts == ()
    assert validate_cspace(robot, scene_of(stone), step=COARSE).base_contacts == (contact,)


# The judge's links


def test_deep_collisions_are_not_missed(robot: Robot) -> None:
    # Axes of links in the faces of boxes, and boxes amid beams: coal 3.0 says no to some, asked for yes or no alone.
    boxes = [
        Box(name=f"box {i}", center=(x, y, 0.6 + z), size=(0.2, 0.1, 0.04))
        for i, (x, y, z) in enumerate((x, y, z) for x in (0.5, 1.0, 1.1, 2.1) for y in (0.0, 0.05) for z in (0.0, 0.02))
    ]
    missed = []
    for links in LINK_SHAPES:
        for box in boxes:
            checker = CoalScene(robot, (box,), links=links)
            assert checker.distances(np.zeros(4)).min() < -0.01
            if not checker.in_collision(np.zeros((1, 4)))[0]:
                missed.append((links, box.center))
    assert missed == []


# Bad input


# The command


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "scene.yaml"
    path.write_text(
        "format: hplan-scene/1\nname: 'two [balls]'\n"
        "start: {joints_deg: [0, 0, 0, 0]}\ngoal: {joints_deg: [0, 0, 0, 0]}\n"
        "obstacles:\n  - {name: 'ball [1]', kind: sphere, center: [1.0, 0.1, 1.6], radius: 0.15}\n"
        "  - {name: stone, kind: box, center: [0.2, 0.0, 0.1], size: [0.3, 0.2, 0.2]}\n"
    )
    return path


def test_command_finds_no_fault(scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "out"
    assert script.main([str(scene_file), "--step", "5", "--yaw", "3", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "no fault at 6,859 nodes" in text
    assert "two [balls]" in text
    assert "ball [1]" in text
    assert "stone and base_link overlap" in text
    content = json.loads((out / script.RESULT).read_text())
    assert content["ok"] is True
    assert content["nodes"] == 6_859
    assert content["yaw_rad"] == pytest.approx(np.radians(3.0))
    assert [c["links"] for c in content["comparisons"]] == list(LINK_SHAPES)
    assert content["base_contacts"][0]["obstacle"] == "stone"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--step", "1e-6"], "step"), (["--kinds", "ball"], "ball"), (["--kinds", "--step", "2"], "--step")],
)
def test_command_on_bad_input(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stale = tmp_path / (script.KINDS_RESULT if "--kinds" in arguments else script.RESULT)
    stale.write_text("{}")
    assert script.main([*arguments, "--out", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert message in captured.err
    assert not stale.exists()


# Random scenes of kinds


def test_command_on_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--kinds", "sphere", "box", "--scenes", "2", "--configurations", "2000", "--seed", "3"]
    assert script.main([*arguments, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "2 random scenes of each kind" in text
    assert "nothing missed" in text
    rows = [line.split()[:2] for line in text.splitlines() if line.split()[:1] in (["sphere"], ["box"])]
    assert rows == [["sphere", "4,000"], ["box", "4,000"]]
    content = json.loads((tmp_path / script.KINDS_RESULT).read_text())
    assert content["ok"] is True
    assert (content["scenes"], content["configurations"], content["seed"]) == (2, 2000, 3)
    assert [(row["kind"], row["missed"]) for row in content["results"]] == [("sphere", 0), ("box", 0)]
    assert not (tmp_path / script.RESULT).exists()
