"""A depth camera's frames against distances from what it looks at."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from script_loader import load_script
from studies.benchmark import orchard_scenes
from studies.benchmark.depth_camera import NEAREST_M, DepthCamera, camera_of, ground

from hplan.collision.obstacle_rows import solid_rows
from hplan.perception.arm_shape import arm_solids
from hplan.perception.body_distances import distances_from_bodies
from hplan.scene.obstacles import Box, Capsule, Sphere

SOLIDS = (
    Capsule.model_validate({"name": "branch", "from": (1.2, -0.4, 0.8), "to": (1.5, 0.5, 1.3), "radius": 0.03}),
    Capsule.model_validate({"name": "along", "from": (0.6, 0.0, 1.05), "to": (2.0, -0.1, 1.0), "radius": 0.02}),
    Sphere(name="apple", center=(1.1, 0.2, 1.2), radius=0.05),
    Box(name="crate", center=(1.6, 0.0, 0.5), size=(0.4, 0.6, 0.3), rpy_deg=(10.0, 20.0, 30.0)),
)
CAMERA = DepthCamera((0.1, 0.3, 1.2), (1.3, 0.0, 1.0), width=120, height=90, sigma_m=0.0, outliers=0.0)


def in_base(camera: DepthCamera, points: np.ndarray) -> np.ndarray:
    seen = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    return seen @ camera.pose[:3, :3].T + camera.pose[:3, 3]


@pytest.mark.parametrize("near", [False, True])
def test_points_are_on_what_is_nearest(near):
    solids = (*SOLIDS, ground(), *((Sphere(name="close", center=(0.3, 0.2, 1.1), radius=0.1),) if near else ()))
    points = CAMERA.frame(solids, np.random.default_rng(0))
    assert points.dtype == np.float32
    assert points.shape == (120 * 90, 3)
    world, rows = in_base(CAMERA, points), solid_rows(solids, 0.0)
    assert len(world) > 2000
    assert np.abs(distances_from_bodies(world, *rows)).max() < 1e-5
    # Nothing is before them on their rays.
    for share in (0.3, 0.7, 0.95, 0.99):
        before = CAMERA.pose[:3, 3] + share * (world - CAMERA.pose[:3, 3])
        assert distances_from_bodies(before, *rows).min() > -1e-6
    # And rays without a return meet nothing.
    depths = CAMERA.depths(solids)
    assert (np.isfinite(depths).ravel() == np.isfinite(points).all(axis=1)).all()
    assert (depths[np.isfinite(depths)] > NEAREST_M).all()
    across = (np.arange(120) + 0.5 - 60) * 2.0 * np.tan(np.radians(43.5)) / 120
    down = (np.arange(90) + 0.5 - 45) * 2.0 * np.tan(np.radians(43.5)) / 120
    rays = np.stack(np.broadcast_arrays(across, down[:, None], 1.0), axis=-1)[~np.isfinite(depths)]
    for depth in np.linspace(0.2, 4.0, 30):
        there = depth * rays @ CAMERA.pose[:3, :3].T + CAMERA.pose[:3, 3]
        assert distances_from_bodies(there, *rows).min() > 0.0


def test_noise_grows_with_the_square_of_depth_and_some_returns_are_strays(robot):
    wall = Box(name="wall", center=(2.1, 0.0, 1.0), size=(0.2, 9.0, 9.0))
    values = {"position": (0.0, 0.0, 1.0), "target": (2.0, 0.0, 1.0), "sigma_m": 2e-3}
    depth = camera_of(20_000, outliers=0.0, **values).frame([wall], np.random.default_rng(1))[:, 2]
    assert np.std(depth) == pytest.approx(2e-3 * 4.0, rel=0.05)
    strays = camera_of(20_000, outliers=0.02, **values).frame([wall], np.random.default_rng(1))[:, 2]
    assert np.mean(np.abs(strays - 2.0) > 0.1) == pytest.approx(0.02, rel=0.15)
    assert len(arm_solids(robot, np.zeros(robot.dof))) > robot.arm.link_count
    with pytest.raises(TypeError, match="sees no"):
        CAMERA.depths([object()])


def test_the_set_of_the_camera(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(orchard_scenes, "SHIPPED", ("orchard-row",))
    script = load_script("benchmark")
    assert script.main(["--quick", "--sets", "camera", "--out", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "benchmark.json").read_text(encoding="utf-8"))["camera"]
    (of,) = results["sizes"].values()
    assert of["frames"] == len(results["rows"]) == 2
    assert of["returns"] == pytest.approx(10_000, rel=0.05)
    assert 100 < of["balls"] < of["returns"]
    assert all(row["growth_mm"] <= 5.0 for row in results["rows"])
    assert "Camera: frames" in (tmp_path / "benchmark.md").read_text(encoding="utf-8")
