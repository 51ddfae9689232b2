"""The live view in viser: what is drawn stands where coal and the scene have it."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.apps.view.live import LiveScene
from hplan.errors import InputError
from hplan.scene.obstacles import PointCloud


def test_without_viser_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r"pip install 'hplan\[viser\]'"):
        LiveScene(hplan.load_robot(), hplan.load_scene())


def test_arm_and_scene_are_where_they_are() -> None:
    pytest.importorskip("viser", reason="the extra `viser` is not installed")
    robot, scene = hplan.load_robot(), hplan.load_scene("trellis")
    result = hplan.plan(robot, scene, hplan.PlanOptions(effort="quick"))
    with LiveScene(robot, scene, port=0) as live:
        drawn = live.server.scene._handle_from_node_name
        assert {f"/scene/{item.name}" for item in (*scene.obstacles, *scene.fruits)} <= set(drawn)
        live.play(result, speed=20.0)
        model, shapes = robot.model, robot.visual_model
        data, places = model.createData(), shapes.createData()
        pin.updateGeometryPlacements(model, data, shapes, places, result.trajectory.position[-1])
        for number, shape in enumerate(shapes.geometryObjects):
            node = live._arm.frames[f"pinocchio/visual/{shape.name}"]
            np.testing.assert_allclose(node.position, places.oMg[number].translation, atol=1e-6)
        cloud = PointCloud.of("seen", np.ones((5, 3)), 0.01)
        live.set_scene(scene.with_obstacles([cloud]))
        drawn = live.server.scene._handle_from_node_name
        assert "/scene/seen" in drawn
        assert f"/scene/{scene.obstacles[0].name}" not in drawn
