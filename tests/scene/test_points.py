"""Point clouds in a scene: files, faults, placement, size."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from hplan.errors import SceneError
from hplan.scene.file import dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.obstacles import Box, PointCloud
from hplan.scene.solids import Cloud

HEAD = "format: hplan-scene/1\nname: a\nstart: {joints_deg: [0]}\ngoal: {joints_deg: [1]}\nobstacles:\n"
POINTS = np.random.default_rng(0).uniform(-1, 1, (40, 3))


def ply(points: np.ndarray, form: str, kind: str = "double", colors: bool = False) -> bytes:
    """A PLY file byte by byte."""
    header = f"ply\nformat {form} 1.0\ncomment by hand\nelement vertex {len(points)}\n"
    header += "".join(f"property {kind} {axis}\n" for axis in "xyz")
    header += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue")) * colors + "end_header\n"
    if form == "ascii":
        rows = [" ".join([*(repr(float(x)) for x in point), *(["7"] * 3 * colors)]) for point in points]
        return (header + "\n".join(rows) + "\n").encode()
    order = "<" if form == "binary_little_endian" else ">"
    letter = {"double": "d", "float": "f"}[kind]
    body = b"".join(struct.pack(f"{order}3{letter}", *point) + b"\7" * 3 * colors for point in points)
    return header.encode() + body


def read(content: bytes, folder, entry="radius: 0.02", name="cloud.ply") -> PointCloud:
    (folder / name).write_bytes(content)
    text = HEAD + f"- {{name: canopy, kind: points, file: {name}, {entry}}}\n"
    (cloud,) = parse_scene(text, path=folder / "scene.yaml").obstacles
    return cloud


@pytest.mark.parametrize("colors", [False, True])
@pytest.mark.parametrize("kind", ["double", "float"])
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply(form, kind, colors, tmp_path):
    (solid,) = read(ply(POINTS, form, kind, colors), tmp_path).solids
    assert isinstance(solid, Cloud)
    assert (solid.name, solid.is_point_set, solid.rounding, solid.sigma) == ("canopy", True, 0.02, 0.0)
    theirs = solid.core[np.lexsort(solid.core.round(5).T)]
    tolerance = 0.0 if kind == "double" else 1e-7
    np.testing.assert_allclose(theirs, POINTS[np.lexsort(POINTS.round(5).T)], atol=tolerance, rtol=0)
    assert not solid.core.flags.writeable


def test_xyz_and_placement(tmp_path):
    content = "\n".join(" ".join(map(repr, point)) for point in POINTS.tolist()).encode()
    entry = "radius: 0.02, position: [1, 2, 3], rpy_deg: [10, 20, 30], sigma: 0.005"
    cloud = read(content, tmp_path, entry, "cloud.xyz")
    (solid,) = cloud.solids
    turn = Box(name="b", center=(0, 0, 0), size=(1, 1, 1), rpy_deg=(10.0, 20.0, 30.0)).rotation
    expected = POINTS @ turn.T + [1, 2, 3]
    np.testing.assert_allclose(np.sort(solid.core, axis=0), np.sort(expected, axis=0), atol=1e-12)
    assert solid.sigma == 0.005


@pytest.mark.parametrize(
    ("content", "entry", "where", "message"),
    [
        (ply(POINTS[:0], "ascii"), "radius: 1", "file", "there are no points"),
        (b"", "radius: 1", "file", "is empty"),
        (ply(POINTS, "binary_little_endian")[:-5], "radius: 1", "file", "is no whole .ply file"),
        (ply(np.array([[0, 0, np.inf]] * 2), "binary_little_endian"), "radius: 1", "file", "none of 2 points"),
        (ply(POINTS * 1e8, "ascii"), "radius: 1", "file", "expected metres"),
        (ply(POINTS, "ascii"), "{radius: 1, scale: 2}", "scale", "unknown key"),
    ],
)  # fmt: skip
def test_faults(content, entry, where, message, tmp_path):
    with pytest.raises(SceneError, match=message) as caught:
        read(content, tmp_path, entry.strip("{}"))
    assert (caught.value.line, caught.value.where) == (6, f"obstacles[0].{where}")


def test_other_formats_and_missing_files(tmp_path):
    with pytest.raises(SceneError, match=r"'cloud.pcd' is no point file .*one of .ply, .xyz"):
        read(b"# .PCD v.7", tmp_path, name="cloud.pcd")
    with pytest.raises(SceneError, match=r"line 6, obstacles\[0\].file: cannot read .*gone.ply"):
        parse_scene(HEAD + "- {name: a, kind: points, file: gone.ply, radius: 1}\n", path=tmp_path / "scene.yaml")


def test_a_large_cloud_is_no_burden(tmp_path):
    """A hundred thousand points in a file, and no trace of them in the scene's text; the tree is built once."""
    points = np.random.default_rng(0).uniform(0, 1, (100_000, 3))
    cloud = PointCloud.of("canopy", points, 0.01)
    assert cloud.solids[0] is cloud.solids[0]
    scene = parse_scene(HEAD.replace("obstacles:", "obstacles: []")).with_obstacles([cloud])
    again = load_scene(save_scene(scene, tmp_path / "scene.yaml"))
    assert len(dump_scene(again)) < 400
    assert again.obstacles[0].solids[0].core.tolist() == cloud.solids[0].core.tolist()
    assert again == load_scene(tmp_path / "scene.yaml")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_rows_of_a_file_that_are_not_finite_are_left_out_and_counted(encoding, tmp_path):
    rows = np.vstack([POINTS, [[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]], POINTS + 1.0])
    cloud = read(ply(rows, encoding), tmp_path)
    assert cloud.left_out == 2
    assert sorted(map(tuple, cloud.points)) == sorted(map(tuple, np.vstack([POINTS, POINTS + 1.0])))
    (tmp_path / "c.xyz").write_text("1 2 3\nnan nan nan\n4 5 6\n", encoding="utf-8")
    assert PointCloud(name="c", file=str(tmp_path / "c.xyz"), radius=0.1).left_out == 1
    assert read(ply(POINTS, encoding), tmp_path).left_out == 0


def test_points_that_were_thinned_before_stay_as_they_are():
    close = np.random.default_rng(0).uniform(0.0, 1e-3, (50, 3))
    cloud = PointCloud.thinned("c", close, 0.01)
    (solid,) = cloud.solids
    assert solid.rounding == 0.01
    assert sorted(map(tuple, solid.core)) == sorted(map(tuple, close))
    assert len(PointCloud.of("c", close, 0.01).solids[0].core) < 50
