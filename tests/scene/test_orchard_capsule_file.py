from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.errors import InputError, OptionError
from hplan.scene.orchard import import_capsules

HEADER = "kind,x1,y1,z1,x2,y2,z2,radius\n"
TREE = HEADER + "trunk,0,0,0,0,0,1.2,0.02\nbranch,0,0,0.5,0.3,0,0.6,0.005\ntrunk,0,0,1.2,0.1,0,2,0.01\n"

MEASURED = Path(__file__).parents[3] / "shared" / "data" / "measured_trees"


@pytest.fixture
def write(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "tree.csv"
        path.write_bytes(text.encode())
        return path

    return write


def test_as_it_stands(write):
    capsules = import_capsules(write(TREE))
    assert [capsule.name for capsule in capsules] == ["trunk 1", "branch 1", "trunk 2"]
    assert capsules[1].start == (0.0, 0.0, 0.5)
    assert capsules[1].end == (0.3, 0.0, 0.6)
    assert [capsule.radius for capsule in capsules] == [0.02, 0.005, 0.01]


def test_turned_then_moved(write):
    _, branch, top = import_capsules(write(TREE), position=(1.4, -2.0, 0.1), yaw_deg=90.0, prefix="tree 2 ")
    assert branch.name == "tree 2 branch 1"
    np.testing.assert_allclose(branch.core, [[1.4, -2.0, 0.6], [1.4, -1.7, 0.7]], atol=1e-12)
    np.testing.assert_allclose(top.core, [[1.4, -2.0, 1.3], [1.4, -1.9, 2.1]], atol=1e-12)


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
        (TREE.replace("y2", "x2"), 1, "column 'x2' is there twice"),
        (HEADER, 1, "no capsules follow the header"),
        (TREE.replace("0.005", "nan"), 3, "radius is 'nan', expected a finite number"),
        (TREE.replace("0.005", "-0.005"), 3, "radius is -0.005, expected a positive number"),
        (TREE.replace("0.005", "0"), 3, "radius is 0, expected a positive number"),
        (TREE.replace("0.005", ""), 3, "radius is '', expected a finite number"),
        (TREE.replace("0.3", "inf"), 3, "x2 is 'inf', expected a finite number"),
        (TREE.replace("0.3", "1,5"), 3, "9 values, expected 8"),
        (TREE.replace("1.2,0.02", "1598,0.02"), 2, "z2 is 1598, expected metres, 1000 at most"),
        (TREE.replace("0.3", "1e308"), 3, "x2 is 1e[+]308, expected metres"),
        (TREE.replace("0.01", "1001"), 4, "radius is 1001, expected metres"),
        (TREE.replace("branch", " "), 3, "kind is empty"),
        (TREE.replace("0,0,0,0,0,1.2", "0,0,1.2,0,0,1.2"), 2, "both ends are in the same place"),
        (TREE + "\n", 5, "0 values, expected 8"),
    ],
)
def test_faults_name_the_line(write, text, line, message):
    with pytest.raises(InputError, match=rf"capsule file .*tree\.csv, line {line}: {message}") as caught:
        import_capsules(write(text))
    assert caught.value.data["line"] == line


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        import_capsules(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8"):
        import_capsules(tmp_path / "b.csv")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"position": (1.0, 2.0)}, "three numbers"),
        ({"position": 1.0}, "position = 1.0: expected a list of numbers"),
        ({"position": (1.0, math.nan, 0.0)}, r"position\[1\] = nan"),
        ({"position": "abc"}, "list of numbers"),
        ({"yaw_deg": math.inf}, "yaw_deg = inf"),
        ({"yaw_deg": "90"}, "yaw_deg = '90'"),
        ({"prefix": None}, "prefix = None"),
    ],
)
def test_options_out_of_range(write, options, message):
    with pytest.raises(OptionError, match=message):
        import_capsules(write(TREE), **options)


@pytest.mark.skipif(not MEASURED.is_dir(), reason="the measured trees are not beside the project")
def test_measured_trees():
    files = sorted(MEASURED.glob("*.csv"))
    assert files
    for path in files:
        capsules = import_capsules(path, position=(1.4, 0.0, 0.0), yaw_deg=30.0)
        assert len(capsules) == len(path.read_text().splitlines()) - 1
        assert {capsule.name.split()[0] for capsule in capsules} == {"trunk", "branch"}
        assert capsules[0].start == (1.4, 0.0, 0.0)
