"""Scene files of MoveIt, of both kinds, against the numbers in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hplan.apps.ros import read_moveit_scene
from hplan.errors import SceneError
from hplan.geometry.prism import ERROR
from hplan.scene.file import load_scene, save_scene
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Cylinder, Sphere

NEW = """\
(noname)+
* Box_0
-1.33 0 0.5
0 0 0.7071068 0.7071068
1
box
0.2 0.45 0.3
0 0 0.1
0 0 0 1
0 0 0 0
0
* two cans
1 2 3
0 0 0 1
2
cylinder
0.03 0.14
0 0 0
0 0 0 1
0.5 0.5 0.5 1
sphere
0.05
0 0 0.2
0 0 0 1
0.5 0.5 0.5 1
1
lid
0 0 0.1
0 0 0 1
.
"""

OLD = """\
kitchen+
* shelf
1
box
0.2 0.45 0.3
-1.33 0 0.6
0 0 0.7071068 0.7071068
0.1 0.2 0.3 1
* can
1
cylinder
0.03 0.14
1 2 3
0 0 0 1
0 0 0 0
.
"""

PYRAMID = """\
mesh
4 4
0 0 0
0.2 0 0
0 0.2 0
0 0 0.2
0 2 1
0 1 3
0 3 2
1 2 3
"""


def one(shape: str, pose: str = "0 0 0\n0 0 0 1\n", *, name: str = "it") -> str:
    return f"s\n* {name}\n0 0 0\n0 0 0 1\n1\n{shape}{pose}0 0 0 0\n0\n.\n"


@pytest.fixture
def read(tmp_path: Path) -> Any:
    def read(text: str, **options: Any) -> Any:
        path = tmp_path / "moveit.scene"
        path.write_text(text, encoding="utf-8")
        return read_moveit_scene(path, **options)

    return read


def test_newer_kind(read: Any) -> None:
    box, can, ball = read(NEW)
    assert isinstance(box, Box)
    assert (box.name, box.size) == ("Box_0", (0.2, 0.45, 0.3))
    np.testing.assert_allclose(box.center, (-1.33, 0.0, 0.6))
    np.testing.assert_allclose(box.rpy_deg, (0.0, 0.0, 90.0), atol=1e-9)
    assert can == Cylinder(name="two cans 1", center=(1.0, 2.0, 3.0), length=0.14, radius=0.03)
    assert isinstance(ball, Sphere)
    assert (ball.name, ball.radius) == ("two cans 2", 0.05)
    np.testing.assert_allclose(ball.center, (1.0, 2.0, 3.2))


def test_older_kind_has_no_poses_of_objects(read: Any) -> None:
    box, can = read(OLD)
    new, _, _ = read(NEW)
    assert (box.name, can.name) == ("shelf", "can")
    np.testing.assert_allclose(box.core, new.core, atol=1e-9)
    assert can.center == (1.0, 2.0, 3.0)
    assert read("(noname)\n.\n") == ()


def test_words_need_no_lines(read: Any) -> None:
    """MoveIt reads words, wherever lines end, but for the name of an object and its first number."""
    first, rest = NEW.split("* two cans\n")
    words = " ".join(rest.split("\n"))
    joined = f"{first}* two cans\n1 2 3 {words.removeprefix('1 2 3 ')}\n"
    assert read(joined) == read(NEW)
    assert read(NEW.replace("\n", "\r\n")) == read(NEW)


def test_in_another_frame_and_under_other_names(read: Any, tmp_path: Path, scene: Scene) -> None:
    box, can, ball = read(NEW, position=(10.0, 0.0, 0.0), rpy_deg=(0.0, 0.0, 90.0), prefix="left ")
    assert [item.name for item in (box, can, ball)] == ["left Box_0", "left two cans 1", "left two cans 2"]
    np.testing.assert_allclose(ball.center, (8.0, 1.0, 3.2))
    np.testing.assert_allclose(box.center, (10.0, -1.33, 0.6))
    np.testing.assert_allclose(np.abs(box.rpy_deg), (0.0, 0.0, 180.0), atol=1e-9)
    wedge, *_ = read(one(PYRAMID))
    whole = scene.with_obstacles([box, can, ball, wedge])
    assert load_scene(save_scene(whole, tmp_path / "scene.yaml")).solids[:3] == whole.solids[:3]


@settings(max_examples=30)
@given(arrays(float, (2, 4), elements=st.floats(-1.0, 1.0)), arrays(float, (2, 3), elements=st.floats(-2.0, 2.0)))
def test_poses_of_object_and_shape_one_after_the_other(
    tmp_path_factory: pytest.TempPathFactory, turns: np.ndarray, places: np.ndarray
) -> None:
    turns = np.where(np.linalg.norm(turns, axis=1, keepdims=True) < 0.1, [[0.0, 0.0, 0.0, 1.0]], turns)
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    lines = [" ".join(map(repr, row)) for pair in zip(places.tolist(), turns.tolist(), strict=True) for row in pair]
    text = f"s\n* it\n{lines[0]}\n{lines[1]}\n1\nbox\n0.1 0.2 0.3\n{lines[2]}\n{lines[3]}\n0 0 0 0\n0\n.\n"
    path = tmp_path_factory.mktemp("moveit") / "one.scene"
    path.write_text(text)
    (box,) = read_moveit_scene(path)
    outer, inner = (
        pin.SE3(pin.Quaternion(turn[3], *turn[:3]).toRotationMatrix(), place)
        for turn, place in zip(turns, places, strict=True)
    )
    expected = outer.rotation @ inner.translation + outer.translation
    assert isinstance(box, Box)
    np.testing.assert_allclose(box.center, expected, atol=1e-9)
    np.testing.assert_allclose(box.rotation, outer.rotation @ inner.rotation, atol=1e-9)


def test_open_mesh(read: Any) -> None:
    text = one(PYRAMID.replace("4 4", "4 3").replace("1 2 3\n", ""))
    with pytest.raises(SceneError, match="'it'") as error:
        read(text)
    assert error.value.line == 6
    (hull,) = read(text, open_meshes="hull")
    (closed,) = read(one(PYRAMID))
    assert np.round(hull.solids[0].core, 9).tolist() == np.round(closed.solids[0].core, 9).tolist()
    with pytest.raises(SceneError, match="lies in one plane"):
        read(text.replace("0 0 0.2", "0.2 0.2 0"), open_meshes="hull")
    with pytest.raises(SceneError, match="a triangle refers to vertex 9"):
        read(text.replace("0 3 2", "0 3 9"), open_meshes="hull")


def test_cone_is_held_by_its_pyramid(read: Any) -> None:
    (cone,) = read(one("cone\n0.3 0.8\n"))
    (hull,) = cone.solids
    angles = np.linspace(0.0, 2.0 * np.pi, 500)
    rim = np.column_stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(500, -0.4)])
    heights = np.vstack([rim, [0.0, 0.0, 0.4]]) @ hull.planes[:, :3].T - hull.planes[:, 3]
    assert heights.max() <= hull.rounding + 1e-9
    assert np.hypot(hull.core[:, 0], hull.core[:, 1]).max() <= 0.3 + 2.0 * ERROR
    assert (hull.core[:, 2].min(), hull.core[:, 2].max()) == (-0.4, 0.4)


def changed(old: str, new: str, text: str = NEW) -> str:
    assert old in text
    return text.replace(old, new, 1)


WRONG = {
    "no end": (changed("\n.\n", "\n"), 29, "the file ends where `*`"),
    "no object": (changed("* Box_0\n", "Box_0\n"), 2, "expected `*` and the name of an object"),
    "the same name": (changed("* two cans", "* Box_0"), 12, "object 'Box_0' is already on line 2"),
    "a word for a number": (changed("-1.33 0 0.5", "-1.33 zero 0.5"), 3, "a position, 3 finite numbers; got 'zero'"),
    "no quaternion": (changed("0 0 0.7071068 0.7071068", "0 0 0 0"), 4, "has the length 0, expected 1"),
    "a size of nothing": (changed("0.2 0.45 0.3", "0.2 0 0.3"), 6, "'Box_0': input should be greater than 0"),
    "another kind": (
        changed("box\n", "torus\n"),
        6,
        "expected one of sphere, box, cylinder, cone or mesh, got 'torus'",
    ),
    "a plane": (changed("box\n0.2 0.45 0.3\n", "plane\n0 0 1 0\n"), 6, "'Box_0': a plane is infinite"),
    "an octomap": (changed("* Box_0", "* <octomap>"), 2, "octomaps are not supported"),
    "triangles of nothing": (one("mesh\n3 99999999999\n0 0 0\n1 0 0\n0 1 0\n0 1 2\n"), 16, "a vertex of a triangle"),
}


@pytest.mark.parametrize("case", WRONG)
def test_errors_name_fault_and_line(read: Any, case: str) -> None:
    text, line, reason = WRONG[case]
    with pytest.raises(SceneError) as error:
        read(text)
    assert reason in error.value.reason
    assert error.value.line == line
    assert "moveit.scene" in str(error.value)
