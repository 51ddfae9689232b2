"""The C-space held against coal: nothing differs, and what differs would be seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import studies.validation.cspace as validation
import studies.validation.kinds as validation_kinds
from script_loader import load_script
from studies.planar_cspace import arm_sections, joint_grid
from studies.validation.cspace import CONTACT_TOLERANCE, EXAMPLES, Comparison, Validation, validate_cspace
from studies.validation.scenes import KINDS

from hplan.collision.coal_scene import CoalScene, base_contacts
from hplan.collision.coal_shapes import LINK_SHAPES
from hplan.errors import InputError, JointLimitError, OptionError
from hplan.grid.grid import Occupancy
from hplan.grid.occupancy import occupancy
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
        name="test",
        start=Start(joints_rad=rest),
        goal=Goal(joints_rad=rest),
        clearance=clearance,
        obstacles=obstacles,
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
    return validate_cspace(robot, scene)


def test_no_cell_of_the_reference_scene_differs(reference: Validation) -> None:
    assert reference.nodes == 753_571
    assert reference.shape == (91, 91, 91)
    for checker in ("capsule", "urdf"):
        comparison = by(reference, checker)
        assert comparison.occupied == comparison.coal_occupied == 128_891
        assert comparison.faults == comparison.conservative == comparison.in_contact == 0
        assert comparison.fault_examples == comparison.conservative_examples == ()
    assert reference.ok


def test_reference_scene_against_boxes(reference: Validation) -> None:
    # In the arm plane the capsule holds the rectangle, so that coal's boxes find nothing that the capsules do not.
    beams = by(reference, "box")
    assert not beams.decisive
    assert (beams.faults, beams.conservative, beams.coal_occupied) == (0, 1_549, 127_342)
    assert 0.0 < beams.unexplained <= beams.conservative
    rectangle = by(reference, "box", "rectangle")
    assert rectangle.decisive
    assert rectangle.occupied == rectangle.coal_occupied == 127_342
    assert rectangle.faults == rectangle.conservative == 0


def test_the_closed_form_is_a_hundred_times_as_fast_as_coal(reference: Validation) -> None:
    assert by(reference, "capsule").coal_s > 100.0 * reference.analytic_s


def test_examples_are_the_widest_and_can_be_checked(robot: Robot, scene: Scene, reference: Validation) -> None:
    beams = by(reference, "box")
    checker = CoalScene(robot, scene.solids, links="box")
    assert len(beams.conservative_examples) == EXAMPLES
    distances = [example.distance_m for example in beams.conservative_examples]
    assert distances == sorted(distances, reverse=True)
    assert distances[0] == beams.widest_gap_m
    grid = joint_grid(robot.arm, np.radians(1.0))
    for example in beams.conservative_examples:
        assert example.joints_rad == (0.0, *grid.coordinates(example.node))
        nearest = checker.nearest(example.joints_rad)
        assert nearest is not None
        assert (nearest.link, nearest.obstacle) == (example.link, example.obstacle)
        assert nearest.distance_m == pytest.approx(example.distance_m, abs=1e-12)


# Other scenes and robots


@pytest.mark.parametrize("clearance", [0.0, 0.03])
@pytest.mark.parametrize("yaw_deg", [0.0, 1.5])
@pytest.mark.parametrize(
    "obstacles", [(BRANCH,), (WIRE,), (CRATE,), (POST,), (BESIDE,), (BRANCH, WIRE, CRATE, POST, BESIDE)]
)
def test_other_obstacles(robot: Robot, obstacles: tuple[Any, ...], yaw_deg: float, clearance: float) -> None:
    result = validate_cspace(robot, scene_of(*obstacles, clearance=clearance), step=COARSE, yaw=np.radians(yaw_deg))
    assert_sound(result)
    assert result.clearance_m == clearance


def test_clearance_is_that_of_grown_obstacles(robot: Robot) -> None:
    kept = validate_cspace(robot, scene_of(BESIDE, WIRE, clearance=0.04), step=COARSE)
    grown = [obstacle.model_copy(update={"radius": obstacle.radius + 0.04}) for obstacle in (BESIDE, WIRE)]
    touched = validate_cspace(robot, scene_of(*grown), step=COARSE)
    for checker in LINK_SHAPES:
        assert by(kept, checker).coal_occupied == by(touched, checker).coal_occupied
        assert by(kept, checker).occupied == by(touched, checker).occupied
    assert by(kept, "capsule").faults == by(kept, "capsule").conservative == 0


def test_the_capsule_does_not_hold_the_edges_of_the_beam(robot: Robot) -> None:
    # A ball beside the arm plane is met by the beam's edges before the capsule: told, but no fault.
    result = validate_cspace(robot, scene_of(BESIDE), step=float(np.radians(2.0)))
    assert_sound(result)
    beams = by(result, "box")
    assert beams.faults > 0
    assert 0.0 < beams.deepest_fault_m < 0.05 * (np.sqrt(2.0) - 1.0)
    assert by(result, "box", "rectangle").faults == by(result, "box", "rectangle").conservative == 0


def test_rectangles_are_judged_only_among_balls(robot: Robot) -> None:
    result = validate_cspace(robot, scene_of(BESIDE, POST), step=COARSE)
    assert {c.link_model for c in result.comparisons} == {"capsule"}


def test_without_obstacles_everything_is_free(robot: Robot) -> None:
    result = validate_cspace(robot, scene_of(), step=COARSE)
    assert result.ok
    assert all(c.occupied == c.coal_occupied == c.conservative == 0 for c in result.comparisons)


@pytest.mark.parametrize(("links", "has_yaw", "step_deg"), [(1, True, 1), (2, False, 2), (3, False, 5), (4, True, 15)])
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


def space_of(robot: Robot, scene: Scene, step: float = COARSE) -> Occupancy:
    sections = arm_sections(robot, scene.solids, clearance=scene.clearance)
    return occupancy(robot.arm, sections, joint_grid(robot.arm, step))


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


def test_one_wrong_cell_is_caught_either_way(robot: Robot, scene: Scene) -> None:
    space = space_of(robot, scene)
    mask = space.occupied.copy()
    node = tuple(int(i) for i in np.argwhere(mask)[len(np.argwhere(mask)) // 2])
    mask[node] = False
    result = validate_cspace(robot, scene, space=Occupancy.from_mask(space.grid, mask))
    (example,) = by(result, "capsule").fault_examples
    assert by(result, "capsule").faults == 1
    assert example.node == node
    assert example.joints_rad == (0.0, *space.grid.coordinates(node))
    assert not result.ok

    mask = space.occupied.copy()
    mask[0, 0, 0] = True
    result = validate_cspace(robot, scene, space=Occupancy.from_mask(space.grid, mask))
    assert by(result, "capsule").conservative == by(result, "capsule").unexplained == 1
    assert by(result, "capsule").conservative_examples[0].node == (0, 0, 0)
    assert result.ok  # it costs room, not safety


def test_a_forgotten_clearance_is_caught(robot: Robot, scene: Scene) -> None:
    careful = scene.model_copy(update={"clearance": 0.02})
    result = validate_cspace(robot, careful, space=space_of(robot, scene))
    assert by(result, "capsule").faults > 0
    assert by(result, "capsule").deepest_fault_m <= 0.02


def test_cells_in_contact_are_counted_apart(robot: Robot) -> None:
    # The ball lies on the upper arm at shoulder 0: distance zero up to rounding, whatever the other joints do.
    on_top = scene_of(Sphere(name="ball", center=(0.5, 0.0, 0.6 + 0.05 + 0.15), radius=0.15))
    assert abs(CoalScene(robot, on_top.solids).distances(np.zeros(4)).min()) < CONTACT_TOLERANCE
    space = space_of(robot, on_top)
    layer = space.grid.shape[1] * space.grid.shape[2]
    counts = []
    for touching in (False, True):
        mask = space.occupied.copy()
        elsewhere = mask[0] & (CoalScene(robot, on_top.solids).distances(np.zeros(4))[0, 0] < -1.0)
        mask[0] = elsewhere | touching
        comparison = by(validate_cspace(robot, on_top, space=Occupancy.from_mask(space.grid, mask)), "capsule")
        counts.append((comparison.faults, comparison.conservative, comparison.in_contact))
    assert [(faults, gaps) for faults, gaps, _ in counts] == [(0, 0), (0, 0)]
    assert sorted(contact for *_, contact in counts) == [0, layer]


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


def test_beams_are_where_the_links_are(robot: Robot) -> None:
    """coal's boxes against the distance of a ball from a turned beam, in numpy."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = rng.uniform(robot.lower, robot.upper)
        centre, radius = rng.uniform([-1.5, -1.5, 0.0], [1.5, 1.5, 2.0]), 0.05
        ball = Sphere(name="ball", center=tuple(centre), radius=radius)
        found = CoalScene(robot, (ball,), links="box").distances(q)[:, 0]
        origin, axes = robot.plane_at(q[0])
        points = robot.arm.joint_points(q[1:])
        for k in range(robot.arm.link_count):
            along = (points[k + 1] - points[k]) / robot.arm.lengths[k]
            frame = np.stack([along @ axes[:2], np.array([-along[1], along[0]]) @ axes[:2], axes[2]])
            local = frame @ (centre - origin - 0.5 * (points[k] + points[k + 1]) @ axes[:2])
            half = [0.5 * robot.arm.lengths[k], robot.arm.half_widths[k], robot.arm.half_widths[k]]
            outside = np.linalg.norm(np.maximum(np.abs(local) - half, 0.0))
            if outside > 0.0:
                assert found[k] == pytest.approx(outside - radius, abs=1e-9)


@pytest.mark.parametrize("links", LINK_SHAPES)
def test_margin_of_the_compiled_call_is_the_distance(robot: Robot, links: Any) -> None:
    checker = CoalScene(robot, (BESIDE, BRANCH, CRATE), links=links)
    q = np.random.default_rng(1).uniform(robot.lower, robot.upper, (300, 4)) * [0.1, 1.0, 1.0, 1.0]
    distances = np.array([checker.distances(row).min() for row in q])
    for margin in (0.0, 0.03, -0.02):
        assert (checker.in_collision(q, margin=margin) == (distances <= margin)).all()


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


def test_distances_are_by_link_whatever_its_shapes(robot: Robot, scene: Scene) -> None:
    # The harvester's URDF has three shapes for each link, which make up its capsule.
    q = np.radians([0.0, 40.0, 30.0, 20.0])
    shapes = {links: CoalScene(robot, scene.solids, links=links).distances(q) for links in LINK_SHAPES}
    assert shapes["urdf"].shape == shapes["capsule"].shape == (3, 1)
    np.testing.assert_allclose(shapes["urdf"], shapes["capsule"], atol=1e-9)


def test_meshes_are_solid(tmp_path: Path, robot: Robot) -> None:
    urdf = robot.urdf_path.read_text()
    begin = urdf.index('<collision name="hand_capsule_side">')
    end = urdf.index("</link>", begin)
    mesh = '<collision name="hand"><geometry><mesh filename="package://hand.stl"/></geometry></collision>'
    path = tmp_path / "meshed.urdf"
    path.write_text(urdf[:begin] + mesh + urdf[end:])
    path.with_suffix(".limits.yaml").write_text(robot.urdf_path.with_suffix(".limits.yaml").read_text())
    (tmp_path / "hand.stl").write_text(box_stl((0.0, -0.03, -0.03), (0.4, 0.03, 0.03)))
    meshed = load_robot(path)
    inside = Sphere(name="seed", center=(2.0, 0.0, 0.6), radius=0.005)
    assert CoalScene(meshed, (inside,), links="urdf").in_collision(np.zeros((1, 4)))[0]
    result = validate_cspace(meshed, scene_of(BESIDE), step=COARSE)
    assert result.ok
    assert by(result, "capsule").conservative == 0
    assert by(result, "urdf").conservative > 0  # the capsule is wider than the mesh


def box_stl(low: tuple[float, ...], high: tuple[float, ...]) -> str:
    """A box as ASCII STL, facets outward."""
    corners = np.array([[(low, high)[(i >> axis) & 1][axis] for axis in range(3)] for i in range(8)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    facets = [(a, b, c) for quad in quads for a, b, c in ((quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3]))]
    lines = ["solid box"]
    for facet in facets:
        vertices = "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners[list(facet)])
        lines.append(f"facet normal 0 0 0\nouter loop\n{vertices}endloop\nendfacet")
    return "\n".join([*lines, "endsolid box\n"])


# Bad input


def test_bad_input(robot: Robot, scene: Scene) -> None:
    with pytest.raises(OptionError, match="links"):
        validate_cspace(robot, scene, links=("sphere",))  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="links"):
        validate_cspace(robot, scene, links=())
    with pytest.raises(OptionError, match="links"):
        CoalScene(robot, scene.solids, links="sphere")  # type: ignore[arg-type]
    for step in (0.0, -1.0, float("nan")):
        with pytest.raises(OptionError, match="step"):
            validate_cspace(robot, scene, step=step)
    for yaw in (4.0, float("nan")):
        with pytest.raises(OptionError, match="yaw"):
            validate_cspace(robot, scene, yaw=yaw)
    flat = joint_grid(replace(robot.arm, lower=robot.arm.lower[:2], upper=robot.arm.upper[:2]), COARSE)
    with pytest.raises(InputError, match="2 axes"):
        validate_cspace(robot, scene, space=Occupancy.from_mask(flat, np.zeros(flat.shape, dtype=bool)))
    outside = scene.model_copy(update={"start": Start(joints_deg=(0.0, 100.0, 0.0, 0.0))})
    with pytest.raises(JointLimitError):
        validate_cspace(robot, outside)


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


def test_command_finds_a_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def blind(_arm: Any, _sections: Any, grid: Any) -> Occupancy:
        return Occupancy.from_mask(grid, np.zeros(grid.shape, dtype=bool))

    monkeypatch.setattr(validation, "occupancy", blind)
    assert script.main(["--step", "5", "--out", str(tmp_path)]) == 5
    text = capsys.readouterr().out
    assert "FAULTS" in text
    assert "base_yaw" in text
    content = json.loads((tmp_path / script.RESULT).read_text())
    assert content["ok"] is False
    assert content["comparisons"][0]["fault_examples"][0]["distance_m"] < 0.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.yaml"], "missing.yaml"),
        (["--step", "0"], "--step"),
        (["--step", "nan"], "--step"),
        (["--step", "1e-6"], "step"),
        (["--yaw", "181"], "-180 and 180"),
        (["--robot", "missing.urdf"], "missing.urdf"),
        (["--kinds", "ball"], "ball"),
        (["--kinds", "box", "--scenes", "0"], "scenes"),
        (["--kinds", "box", "--seed", "-1"], "seed"),
        (["--kinds", "--step", "2"], "--step"),
        (["--scenes", "3"], "--scenes"),
    ],
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


def test_command_cannot_write(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert script.main(["--out", str(tmp_path / "file")]) == 2
    assert "it is a file" in capsys.readouterr().err


# Random scenes of kinds


def test_command_on_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--kinds", "sphere", "box", "--scenes", "2", "--configurations", "2000", "--seed", "3"]
    assert script.main([*arguments, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "2 random scenes of each kind" in text
    assert "nothing missed" in text
    rows = [line.split()[:2] for line in text.splitlines() if line.split()[:1] in (["sphere"], ["box"])]
    assert rows == [["sphere", "4,000"], ["box", "4,000"], ["sphere", "~"], ["box", "~"]]
    content = json.loads((tmp_path / script.KINDS_RESULT).read_text())
    assert content["ok"] is True
    assert (content["scenes"], content["configurations"], content["seed"]) == (2, 2000, 3)
    assert [(row["kind"], row["layers"], row["missed"]) for row in content["results"]] == [
        ("sphere", False, 0),
        ("box", False, 0),
        ("sphere", True, 0),
        ("box", True, 0),
    ]
    assert not (tmp_path / script.RESULT).exists()


def test_command_finds_what_is_missed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def blind(_arm: Any, _sections: Any, grid: Any) -> Occupancy:
        return Occupancy.from_mask(grid, np.zeros(grid.shape, dtype=bool))

    monkeypatch.setattr(validation_kinds, "occupancy", blind)
    assert script.main(["--kinds", "sphere", "--scenes", "2", "--configurations", "2000"]) == 5
    text = capsys.readouterr().out
    assert "FAULTS" in text
    assert "sphere 0: intervals, coal -" in text


def test_all_kinds_where_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def noted(_robot: Robot, kinds: Any, **_options: Any) -> None:
        asked.append(tuple(kinds))
        raise OptionError("kinds", kinds, "to be noted")

    monkeypatch.setattr(validation_kinds, "validate_kinds", noted)
    assert script.main(["--kinds"]) == 2
    assert asked == [KINDS]
