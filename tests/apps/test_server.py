"""Live views: the page's server, reached from this machine alone, and viser's."""

from __future__ import annotations

import contextlib
import socket
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from urllib.parse import urlsplit

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.apps.view import server
from hplan.apps.view.live import LiveScene
from hplan.apps.view.page import serve
from hplan.apps.view.playback import Playback
from hplan.apps.view.server import LiveView
from hplan.errors import HplanError, InputError
from hplan.scene.obstacles import PointCloud
from hplan.trajectory.trajectory import Trajectory


@pytest.fixture
def view() -> Iterator[LiveView]:
    robot, scene = hplan.load_robot(), hplan.load_scene()
    row = scene.start.configuration[None]
    with serve(robot, scene, Playback(Trajectory(robot.joint_names, [0.0], row, 0 * row, 0 * row, 0 * row))) as view:
        yield view


def accepts(host: str, port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection((host, port), timeout=5):
        return True
    return False


def test_listens_on_this_machines_own_address_alone(view: LiveView) -> None:
    """A server that listens on all interfaces answers at 127.0.0.2 too."""
    address = urlsplit(view.url)
    assert address.hostname == "127.0.0.1"
    assert address.port is not None
    assert accepts("127.0.0.1", address.port)
    assert not accepts("127.0.0.2", address.port)


def test_serves_the_page_until_it_is_closed(view: LiveView) -> None:
    with urllib.request.urlopen(view.url, timeout=10) as answer:
        assert b"<html" in answer.read()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"{view.url}other", timeout=10)
    view.wait(0.05)
    assert view.is_running
    view.close()
    assert not view.is_running
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(view.url, timeout=10)
    view.close()


def test_server_that_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError("no port is free")

    monkeypatch.setattr(server, "ThreadingHTTPServer", refused)
    robot, row = hplan.load_robot(), [[0.0] * 4]
    with pytest.raises(HplanError, match="the page's server does not start: no port is free"):
        serve(robot, hplan.load_scene(), Playback(Trajectory(robot.joint_names, [0.0], row, row, row, row)))


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
        cloud = PointCloud.from_points("seen", np.ones((5, 3)), 0.01)
        live.set_scene(scene.with_obstacles([cloud]))
        drawn = live.server.scene._handle_from_node_name
        assert "/scene/seen" in drawn
        assert f"/scene/{scene.obstacles[0].name}" not in drawn
