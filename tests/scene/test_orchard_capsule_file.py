from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.errors import InputError, OptionError
from hplan.scene.orchard import MeasuredOptions, import_capsules, import_tree, measured_orchard

HEADER = "kind,x1,y1,z1,x2,y2,z2,radius\n"
TREE = HEADER + "trunk,0,0,0,0,0,1.2,0.02\nbranch,0,0,0.5,0.3,0,0.6,0.005\ntrunk,0,0,1.2,0.1,0,2,0.01\n"


@pytest.fixture
def write(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "tree.csv"
        path.write_bytes(text.encode())
        return path

    return write


@settings(max_examples=50)
@given(
    ends=st.lists(st.floats(-10, 10), min_size=6, max_size=6),
    position=st.tuples(*[st.floats(-100, 100)] * 3),
    yaw_deg=st.floats(-720, 720),
)
def test_a_capsule_keeps_its_shape(tmp_path_factory, ends, position, yaw_deg):
    if ends[:3] == ends[3:]:
        return
    path = tmp_path_factory.mktemp("tree") / "tree.csv"
    path.write_text(HEADER + "trunk," + ",".join(map(repr, ends)) + ",0.01\n")
    core = import_capsules(path, position=position, yaw_deg=yaw_deg)[0].core
    before = np.array(ends).reshape(2, 3)
    turn = complex(math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg)))
    expected = (before[:, 0] + 1j * before[:, 1]) * turn + complex(position[0], position[1])
    np.testing.assert_allclose(core[:, 0] + 1j * core[:, 1], expected, atol=1e-12)
    np.testing.assert_allclose(core[:, 2], before[:, 2] + position[2], atol=1e-12)


def test_columns_in_any_order_among_others(write):
    path = write("\ufeffradius, z2,y2,x2,note,z1,y1,x1,kind \r\n0.01,6,5,4,old,3,2,1, side  branch\r\n")
    (capsule,) = import_capsules(path)
    assert (capsule.name, capsule.start, capsule.end) == ("side branch 1", (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "column 'kind' is missing; expected kind,x1,y1,z1,x2,y2,z2,radius"),
        (TREE.replace("radius", "width"), 1, "column 'radius' is missing"),
        (HEADER, 1, "no capsules follow the header"),
        (TREE.replace("0.005", "nan"), 3, "radius is 'nan', expected a finite number"),
        (TREE.replace("0.3", "1,5"), 3, "9 values, expected 8"),
        (TREE.replace("1.2,0.02", "1598,0.02"), 2, "z2 is 1598, expected metres, at most 1000"),
        (TREE.replace("branch", " "), 3, "kind is empty"),
        (TREE.replace("0,0,0,0,0,1.2", "0,0,1.2,0,0,1.2"), 2, "both ends are in the same place"),
    ],
)
def test_faults_name_the_line(write, text, line, message):
    with pytest.raises(InputError, match=rf"capsule file .*tree\.csv, line {line}: {message}") as caught:
        import_capsules(write(text))
    assert caught.value.data["line"] == line


def test_fruit_that_hung_on_a_tree_is_read_with_it(write):
    text = TREE + "fruit,0.2,0,1.2,0.2,0,1.2,0.035\nfruit,0,0.3,1.4,0,0.3,1.4,0.03\n"
    wood, fruits = import_tree(write(text), position=(1.0, 0.0, 0.0), yaw_deg=90.0, prefix="tree 1 ")
    assert wood == import_capsules(write(TREE), position=(1.0, 0.0, 0.0), yaw_deg=90.0, prefix="tree 1 ")
    assert [fruit.name for fruit in fruits] == ["tree 1 fruit 1", "tree 1 fruit 2"]
    np.testing.assert_allclose([fruit.center for fruit in fruits], [(1.0, 0.2, 1.2), (0.7, 0.0, 1.4)], atol=1e-12)
    with pytest.raises(InputError, match="not in the same place"):
        import_tree(write(TREE + "fruit,0,0,1,0,0,1.1,0.03\n"))


def test_nearest_fruit_of_tree_is_used_first_and_compliant_on_request(write):
    path = write(TREE + "fruit,0.2,0,1.2,0.2,0,1.2,0.035\nfruit,-0.3,0.1,1.4,-0.3,0.1,1.4,0.03\n")
    options = MeasuredOptions(wood_yields=0.02, yields_below=0.02, fruit_yields=0.01, grasp_offset=0.033)
    scene = measured_orchard([path], options)
    assert [(fruit.name, fruit.radius, fruit.yields, fruit.grasp_offset) for fruit in scene.fruits] == [
        ("fruit 2", 0.03, 0.01, 0.03), ("fruit 1", 0.035, 0.01, 0.033),
    ]  # fmt: skip
    assert {piece.yields for piece in scene.obstacles if piece.radius >= 0.02} == {0.0}
    assert {piece.yields for piece in scene.obstacles if piece.radius < 0.02} == {0.02}
    assert [fruit.name for fruit in measured_orchard([path], MeasuredOptions(fruits=1)).fruits] == ["fruit 2"]
    with pytest.raises(OptionError, match="their own fruits"):
        measured_orchard([path], MeasuredOptions(fruit_radius=0.03))
