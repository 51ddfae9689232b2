"""A new kind of obstacle is its class: kernels, certificate, pages, messages and MuJoCo take it from there."""

from __future__ import annotations

from typing import Literal

import numpy as np

from hplan.apps.ros.marked_scene import scene_markers
from hplan.apps.view import scenery
from hplan.base.arrays import readonly
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.coal_scene import CoalScene
from hplan.scene.limits import Angles, Size, Vector
from hplan.scene.obstacle_kind import Convex, Name, Sigma, Turned
from hplan.scene.obstacles import KINDS, Mesh
from hplan.scene.tracks import Sway


class Wedge(Turned, Convex):
    """A block cut along a diagonal, all of it grown by a radius."""

    kind: Literal["wedge"] = "wedge"
    name: Name
    center: Vector
    size: tuple[Size, Size, Size]
    radius: float = 0.0
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    sigma: Sigma = 0.0

    @property
    def core(self):
        corners = [(x, y, z) for y in (-0.5, 0.5) for x, z in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5))]
        return readonly(np.array(self.center) + corners * np.array(self.size) @ self.rotation.T)

    @property
    def rounding(self):
        return self.radius


def wedges():
    sway = Sway(amplitude_m=0.05, direction=(0.0, 0.6, 0.8))
    keys = {"center": (1.0, 0.3, 1.1), "size": (0.3, 0.5, 0.2), "rpy_deg": (20.0, -50.0, 70.0)}
    return Wedge(name="sharp", **keys), Wedge(name="round", radius=0.04, **keys), Wedge(name="sways", sway=sway, **keys)


def test_kernels_and_coal_see_the_same_hull(robot):
    rng = np.random.default_rng(3)
    for wedge in wedges():
        same = Mesh.of("same", *wedge.hull.surface)
        field, coal = ClearanceField.of(robot, wedge.solids), CoalScene(robot, wedge.solids)
        mesh = CoalScene(robot, same.solids)
        for q in rng.uniform(robot.lower, robot.upper, (30, robot.dof)):
            true = coal.distances(q)[:, 0]
            apart = true > 1e-3
            np.testing.assert_allclose(field.link_clearances(q, 100.0)[apart], true[apart], atol=5e-5)
            if wedge.name == "sharp":
                np.testing.assert_allclose(mesh.distances(q)[:, 0][apart], true[apart], atol=5e-5)


def test_it_is_drawn_by_its_surface(scene):
    sharp, round_, _ = wedges()
    scene = scene.model_copy(update={"obstacles": (sharp, round_), "fruits": ()})
    markers = [np.array([[p["x"], p["y"], p["z"]] for p in m["points"]]) for m in scene_markers(scene) if "points" in m]
    assert {tuple(p) for p in markers[0].round(9)} == {tuple(p) for p in sharp.core.round(9)}
    # The grown one holds the other with room to spare.
    low, high = markers[1].min(axis=0), markers[1].max(axis=0)
    assert (sharp.core.min(axis=0) - low >= 0.04 - 1e-9).all()
    assert (high - sharp.core.max(axis=0) >= 0.04 - 1e-9).all()
    assert len(scenery.obstacles(scene)) == 2


def test_kinds_are_listed_once():
    assert [kind.model_fields["kind"].default for kind in KINDS] == [
        "sphere", "capsule", "cylinder", "box", "mesh", "points",
    ]  # fmt: skip
