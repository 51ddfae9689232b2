"""Random scenes: reproducible, of the kind asked for, and where the arm passes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import studies.validation.scenes as validation_scenes
from arm_variants import VARIANTS, load_variant
from studies.validation.scenes import KINDS, Kind, random_scene

from hplan.errors import OptionError
from hplan.robot.model import Robot
from hplan.scene.obstacles import Box, Capsule, Mesh, PointCloud, Sphere
from hplan.scene.shape_data import Surface

CLASSES = {"sphere": Sphere, "capsule": Capsule, "box": Box, "mesh": Mesh, "points": PointCloud}


@pytest.mark.parametrize("kind", KINDS)
def test_scenes_of_a_kind(robot: Robot, kind: Kind) -> None:
    reach = robot.arm.lengths.sum()
    counts, clearances = set(), []
    for number in range(12):
        made = random_scene(robot, kind, number)
        scene = made.scene
        items = scene.fruits if kind == "fruits" else scene.obstacles
        assert scene.name == f"{kind} {number}"
        if kind != "fruits":
            assert scene.fruits == ()
            assert all(isinstance(item, CLASSES[kind]) for item in items)
            assert 1 <= len(items) <= 4
        counts.add(len(items))
        clearances.append(scene.clearance)
        low, high = made.sector
        assert robot.lower[0] <= low < high <= robot.upper[0]
        places = [item.center for item in items if isinstance(item, (Sphere, Box))]
        places += [item.position for item in items if isinstance(item, (Mesh, PointCloud))]
        for place in places:
            assert np.linalg.norm(np.array(place) - robot.plane_origin) <= reach + 0.8
        assert random_scene(robot, kind, number) == made
        assert random_scene(robot, kind, number, seed=1) != made
    assert len(counts) > 1
    assert 0.0 in clearances
    assert max(clearances) > 0.0


def test_shapes_are_closed_and_differ() -> None:
    rng = np.random.default_rng(0)
    makers = (validation_scenes._bucket, validation_scenes._ring, validation_scenes._notched)
    for _ in range(30):
        for make in (*makers, validation_scenes._convex_surface):
            surface = Surface.of(*make(rng))  # refuses what is open or inside out
            assert 0.03 < np.ptp(surface.vertices, axis=0).max() < 1.0
    made = [Surface.of(*make(rng)) for make in makers for _ in range(2)]
    assert all(a != b for i, a in enumerate(made) for b in made[:i])


@pytest.mark.parametrize("variant", VARIANTS)
def test_any_arm(variant: str, tmp_path: Path) -> None:
    robot = load_variant(variant, tmp_path)
    made = random_scene(robot, "capsule", 0)
    assert made.scene.start.configuration.shape == (robot.dof,)
    if not robot.has_yaw:
        assert made.sector == (0.0, 0.0)


def test_bad_input(robot: Robot) -> None:
    with pytest.raises(OptionError, match="one of sphere"):
        random_scene(robot, "ball", 0)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="number"):
        random_scene(robot, "sphere", -1)
    with pytest.raises(OptionError, match="seed"):
        random_scene(robot, "sphere", 0, seed=-1)
