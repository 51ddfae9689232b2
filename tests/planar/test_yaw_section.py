from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pages import animation_of, commands_of, objects, orchard, steady_motion

from hplan.apps.cli.main import main
from hplan.apps.view.playback import Playback
from hplan.collision.coal_scene import CoalScene
from hplan.collision.distance_checker import FAR
from hplan.errors import InputError
from hplan.planar.pages.cspace_page import render_cspace_page
from hplan.planar.pages.yaw_section import YawSection, yaw_section
from hplan.planning.options import PlanOptions
from hplan.robot.family.members import HARVESTER, write_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Capsule, Sphere
from hplan.trajectory.trajectory import Trajectory

GOAL = (math.radians(30.0), math.pi / 4, math.pi / 3, math.radians(70.0))


FRUITS = (
    Fruit(name="ripe", center=(0.8, 0.46, 1.3), radius=0.04),
    Fruit(name="green", center=(0.6, 0.35, 1.5), radius=0.04),
)
OBSTACLES = (
    Sphere(name="ball", center=(0.87, 0.5, 1.9), radius=0.15),
    Capsule(name="branch", start=(1.0, -0.5, 0.9), end=(1.0, 0.8, 1.1), radius=0.02),
)


def motion(robot: Robot) -> Trajectory:
    return steady_motion(robot, GOAL, rows=101)


def scene(**changes: Any) -> Scene:
    return orchard(**{"obstacles": OBSTACLES, "fruits": FRUITS, **changes})


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    """A grid of an eighth of the nodes, for speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hplan.planar.pages.yaw_section._STEP_DEG", 4.0)
        yield


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot()


@pytest.fixture(scope="module")
def section(robot: Robot, coarse: None) -> YawSection:
    return yaw_section(robot, scene(), Playback(motion(robot)))


def test_region_is_where_coal_finds_the_arm_in_collision(robot: Robot, section: YawSection) -> None:
    assert section.yaw == pytest.approx(GOAL[0])
    checker = CoalScene(robot, scene().solids)
    random = np.random.default_rng(0)
    decided = 0
    for index in random.integers(0, section.grid.shape, (400, 3)):
        value = section.field[tuple(index)]
        nearest = checker.nearest_contact(np.array([section.yaw, *section.grid.coordinates(index)]))
        assert nearest is not None
        if abs(value) > 1e-6:
            assert (nearest.distance_m < 0.0) == (value < 0.0)
            decided += value < 0.0
    assert decided > 20


def test_clearance_uncertainty_and_tracking_error_grow_the_region(robot: Robot, section: YawSection) -> None:
    grown = yaw_section(robot, scene(clearance=0.02), Playback(motion(robot)))
    near = section.field < FAR - 0.02  # larger distances are clamped
    np.testing.assert_allclose(grown.field[near], section.field[near] - 0.02, atol=1e-9)
    assert near.any()
    assert (grown.field[~near] >= FAR - 0.04 - 1e-9).all()
    vague = scene(obstacles=tuple(item.model_copy(update={"sigma": 0.01}) for item in scene().obstacles), fruits=(),
                  goal=Goal(position=(0.8, 0.46, 1.3)))  # fmt: skip
    sure = yaw_section(robot, vague, Playback(motion(robot)), PlanOptions(sigmas=0.0))
    unsure = yaw_section(robot, vague, Playback(motion(robot)), PlanOptions(sigmas=2.0))
    near = sure.field < FAR - 0.02
    np.testing.assert_allclose(unsure.field[near], sure.field[near] - 0.02, atol=1e-9)
    is_point_set = yaw_section(robot, vague, Playback(motion(robot)), PlanOptions(sigmas=0.0, tracking_error=0.001))
    assert (is_point_set.field[near] < sure.field[near]).all()


def test_arm_of_two_links_and_a_foreign_trajectory(robot: Robot, tmp_path: Path) -> None:
    names = ("link_lengths", "link_half_widths", "link_masses")
    names += ("lower", "upper", "velocity", "effort", "acceleration", "jerk")
    fewer = {name: getattr(HARVESTER, name)[:-1] for name in names}
    urdf, limits = write_robot(replace(HARVESTER, name="two", **fewer), tmp_path / "two.urdf")
    with pytest.raises(InputError, match="requires three planar joints; 'two' has 2"):
        yaw_section(load_robot(urdf, limits=limits), scene(), Playback(motion(robot)))
    with pytest.raises(InputError, match="the trajectory moves a, b, c, d"):
        yaw_section(robot, scene(), Playback(replace(motion(robot), joint_names=("a", "b", "c", "d"))))


def test_page_holds_region_motion_and_labels(section: YawSection) -> None:
    page = render_cspace_page(section, "a <b> page")
    assert page == render_cspace_page(section, "a <b> page")
    assert len(page) < 2_500_000
    assert "<b>" not in page.split('<script type="application/json"')[0]
    commands = commands_of(page)
    found = objects(commands)
    attributes = found["/hplan/forbidden"]["geometries"][0]["data"]["attributes"]
    corners = np.reshape(attributes["position"]["array"], (-1, 3))
    assert np.abs(corners).max() <= 1.0 + 1e-6
    # In the cube as on the grid: the corner of the angle ranges is the corner of the cube.
    start, goal = found["/hplan/motion"]["object"]["children"][:2]
    np.testing.assert_allclose(start["matrix"][12:15], [-1.0] * 3, atol=1e-6)
    np.testing.assert_allclose(goal["matrix"][12:15], np.degrees(GOAL[1:]) / 45.0 - 1.0, atol=1e-6)
    texts = [item["textures"][0]["text"] for path, item in found.items() if path.startswith("/hplan/labels")]
    assert sorted(texts) == sorted(
        [*("0", "30", "60", "90") * 2, "30", "60", "90", *(f"{name} [deg]" for name in section.joint_names)]
    )
    (track,) = animation_of(commands)["animations"][0]["clip"]["tracks"]
    np.testing.assert_allclose(track["values"][-3:], goal["matrix"][12:15], atol=1e-6)


def test_command_line_writes_the_view(tmp_path: Path) -> None:
    assert main(["--cspace-yaw", "10", "--out", str(tmp_path), "--quiet"]) == 0
    files = {"trajectory.csv", "report.json", "scene.html", "cspace.html", "cspace.png"}
    assert {path.name for path in tmp_path.iterdir()} == files
    assert "C-space at yaw 10.0°" in (tmp_path / "cspace.html").read_text(encoding="utf-8")
    # Files of another job do not count as this one's; a yaw beyond the limits is refused before any work.
    assert main(["--cspace-yaw", "200", "--out", str(tmp_path), "--quiet"]) == 2
    assert {path.name for path in tmp_path.iterdir()} == files
