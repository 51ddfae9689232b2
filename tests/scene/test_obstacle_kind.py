"""Kinds of obstacles: a new one, prisms, solids, points."""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from shapes import ball, distances, uncovered

from hplan.apps.ros.marked_scene import scene_markers
from hplan.apps.view import scenery
from hplan.base.arrays import readonly
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_field import ClearanceField
from hplan.errors import SceneError
from hplan.geometry.cloud import MERGE_ERROR, Cloud
from hplan.geometry.hull import HULL_VERTICES, hull_of
from hplan.geometry.prism import ERROR, FEWEST_SIDES, MOST_SIDES
from hplan.scene.file import dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.limits import Angles, Size, Vector
from hplan.scene.obstacle_kind import Convex, Name, Sigma, Turned
from hplan.scene.obstacles import KINDS, Box, Cylinder, Mesh, PointCloud
from hplan.scene.tracks import Sway

#: The links of the harvester among its bodies: pedestal and turret come first, pairs last.
LINKS = slice(2, 5)


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
        same = Mesh.from_arrays("same", *wedge.hull.surface)
        field, coal = ClearanceField.build(robot, wedge.solids), CoalScene(robot, wedge.solids)
        mesh = CoalScene(robot, same.solids)
        for q in rng.uniform(robot.lower, robot.upper, (30, robot.dof)):
            true = coal.distances(q)[:, 0]
            apart = true > 1e-3
            np.testing.assert_allclose(field.link_clearances(q, 100.0)[LINKS][apart], true[apart], atol=5e-5)
            if wedge.name == "sharp":
                np.testing.assert_allclose(mesh.distances(q)[:, 0][apart], true[apart], atol=5e-5)


def test_it_is_drawn_by_its_surface(scene):
    sharp, round_, _ = wedges()
    scene = scene.copy_unchecked({"obstacles": (sharp, round_), "fruits": ()})
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


ANGLES = st.floats(-360.0, 360.0)


@settings(max_examples=40)
@given(st.floats(1e-3, 5.0), st.floats(1e-4, 5.0), st.tuples(ANGLES, ANGLES, ANGLES))
def test_a_prism_holds_its_cylinder_and_little_more(length, radius, rpy):
    can = Cylinder(name="can", center=(1.0, -2.0, 3.0), length=length, radius=radius, rpy_deg=rpy)
    found, excess = can.hull, can.excess
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    rim = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(721)])
    ends = np.concatenate([rim + np.array([0.0, 0.0, side * 0.5 * length]) for side in (-1.0, 1.0)])
    points = ends @ can.rotation.T + np.array(can.center)
    heights = points @ found.planes[:, :3].T - found.planes[:, 3]
    assert heights.max() <= 1e-12
    assert heights.max(axis=0).min() >= -1e-4 * radius  # every facet touches it
    local = (found.core - can.center) @ can.rotation
    np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius + excess, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.abs(local[:, 2]), 0.5 * length, rtol=1e-9, atol=1e-12)
    sides = len(found.core) // 2
    assert FEWEST_SIDES <= sides <= MOST_SIDES
    assert excess <= (ERROR if sides < MOST_SIDES else 1.3e-3 * radius)
    assert can.solids == (can,)


def test_facets_and_edges_are_those_of_the_hull():
    can = Cylinder(name="can", center=(0.3, 0.2, 0.1), length=0.2, radius=0.03, rpy_deg=(10.0, 20.0, 30.0))
    found, hull = can.hull, hull_of(can.core)

    def rounded(rows):
        return sorted(map(tuple, np.round(rows, 9) + 0.0))

    assert rounded(found.planes) == rounded(hull.planes)
    middles = [edges[:, :3] + 0.5 * edges[:, 3:] for edges in (found.edges, hull.edges)]
    assert rounded(middles[0]) == rounded(middles[1])
    corners = found.core[found.faces]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    spanned = ((corners.mean(axis=1) - can.center) * outward).sum(axis=1) / 6.0
    assert spanned.min() > 0.0
    assert spanned.sum() == pytest.approx(ConvexHull(can.core).volume, rel=1e-9)
    assert not any(array.flags.writeable for array in (found.core, found.planes, found.edges))
    assert can.hull is found


def test_hull_of_a_block():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)], dtype=float)
    inner = np.random.default_rng(0).uniform(0, 1, (50, 3))
    hull = hull_of(np.vstack([inner, corners]), "block")
    assert (hull.name, hull.rounding, hull.is_point_set, hull.sigma) == ("block", 0.0, False, 0.0)
    assert sorted(map(tuple, hull.core)) == sorted(map(tuple, corners))
    assert sorted(map(tuple, hull.planes)) == sorted(
        [(1, 0, 0, 1), (-1, 0, 0, 0), (0, 1, 0, 2), (0, -1, 0, 0), (0, 0, 1, 3), (0, 0, -1, 0)]
    )
    # Twelve edges, without the diagonals of the sides.
    assert sorted(np.linalg.norm(hull.edges[:, 3:], axis=1)) == [1] * 4 + [2] * 4 + [3] * 4
    assert not hull.core.flags.writeable
    assert not hull.planes.flags.writeable


@pytest.mark.parametrize("most", [14, 40, HULL_VERTICES])
def test_many_vertices_are_simplified_from_outside(most):
    points, _ = ball(0.2)
    hull = hull_of(points, most=most)
    assert len(hull.core) <= most
    assert 0.0 < hull.rounding < 0.2 * 4.0 / most + 0.03
    assert uncovered((hull,), points) <= 1e-7
    # Nothing of the grown hull is farther outside than the rounding, and the rounding is needed.
    exact = hull_of(points, most=10_000)
    assert exact.rounding == 0.0
    assert distances(exact, hull.core).max() <= 1e-7
    assert distances(hull, points).max() > -0.1 * hull.rounding
    assert {tuple(point) for point in hull.core} <= {tuple(point) for point in points}


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.integers(4, 300), st.floats(0.01, 1.0))
def test_hulls_hold_their_points(seed, count, flatness):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [1.0, flatness, flatness**2]
    hull = hull_of(points, most=20)
    assert uncovered((hull,), points) <= 1e-6
    rotation, shift = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([1.0, 2.0, 3.0])
    turned = hull.transform(rotation, shift, name="other", sigma=0.1)
    assert (turned.name, turned.sigma, turned.rounding) == ("other", 0.1, hull.rounding)
    np.testing.assert_allclose(turned.core[:, 0], 1.0 - hull.core[:, 1])
    assert (turned.core @ turned.planes[:, :3].T <= turned.planes[:, 3] + 1e-9).all()
    assert len(turned.edges) == len(turned.core) + len(turned.planes) - 2  # Euler


@settings(max_examples=40)
@given(st.integers(0, 10_000), st.integers(1, 400), st.sampled_from([1e-3, 0.02, 1.0]))
def test_balls_after_merging_hold_those_before(seed, count, size):
    points = np.random.default_rng(seed).uniform(0.0, size, (count, 3))
    cloud = Cloud.from_points("cloud", points, 0.01, 0.5)
    growth = cloud.rounding - 0.01
    assert 0.0 <= growth <= MERGE_ERROR + 1e-12
    gaps = np.linalg.norm(points[:, None] - cloud.core, axis=2).min(axis=1)
    assert gaps.max() <= growth + 1e-12
    assert (cloud.name, cloud.is_point_set, cloud.sigma) == ("cloud", True, 0.5)
    if size == 1.0:
        assert growth == 0.0
        assert sorted(map(tuple, cloud.core)) == sorted(map(tuple, points))


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


def test_comment_before_the_format_of_a_ply_file_is_refused(tmp_path):
    """trimesh reads the text after such a header as binary numbers, all of them tiny."""
    head = b"ply\n%sformat ascii 1.0\n%selement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    comment, rest = b"comment made by a scanner\n", b"end_header\n0.5 0 0.5\n"
    assert read(head % (b"", comment) + rest, tmp_path).points.tolist() == [[0.5, 0.0, 0.5]]
    with pytest.raises(SceneError, match=r"line 2: expected the format of the PLY file, got 'comment made by"):
        read(head % (comment, b"") + rest, tmp_path)


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
        (ply(POINTS, "binary_little_endian")[:-5], "radius: 1", "file", "is not a complete .ply file"),
        (ply(np.array([[0, 0, np.inf]] * 2), "binary_little_endian"), "radius: 1", "file", "none of 2 points"),
        (ply(POINTS * 1e8, "ascii"), "radius: 1", "file", "expected metres"),
        (ply(POINTS, "ascii"), "{radius: 1, scale: 2}", "scale", "unknown key"),
    ],
)  # fmt: skip
def test_faults(content, entry, where, message, tmp_path):
    with pytest.raises(SceneError, match=message) as caught:
        read(content, tmp_path, entry.strip("{}"))
    assert (caught.value.line, caught.value.where) == (6, f"obstacles[0].{where}")


ASCII = ply(np.arange(9.0).reshape(3, 3), "ascii")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        # trimesh read these as 600 points at other places.
        ("c.xyz", "0,123 0,456 0,789\n1,0 2,0 3,0\n", "line 1: '0,123' is not a number; use decimal points"),
        ("c.xyz", "1 2 3\n4 5,5 6\n", "line 2: '5,5' is not a number"),
        ("c.xyz", "0.1,0.2,0.3\n", "line 1: '0.1,0.2,0.3' is not a number; .* spaces between columns"),
        ("c.xyz", "0.1;0.2;0.3\n", "line 1: .* spaces between columns"),
        ("c.xyz", "1.234,5 2 3\n", "line 1"),
        ("c.xyz", "x y z\n1 2 3\n", "line 1: 'x' is not a number"),
        ("c.xyz", "1 2 3\n\n4 5\n6 7 8 9\n", "line 3 has 2 columns, the lines before have 3"),
        ("c.xyz", "2\n1 2 3\n4 5 6\n", "line 2 has 3 columns, the lines before have 1"),
        ("c.xyz", "1 2 3 4\n5 6 # 7 8\n", "line 2 has 2 columns"),
        ("c.xyz", "1 2\n3 4\n", "has 2 columns; expected x y z"),
        ("c.xyz", "# nothing\n", "there are no points"),
        ("c.xyz", "0x1 1_0 3\n", "line 1"),
        ("c.ply", ASCII.replace(b"6.0 7.0 8.0\n", b"").decode(), "expected 3 rows after the header, got 2"),
        ("c.ply", (ASCII + b"9 9 9\n").decode(), "expected 3 rows after the header, got 4"),
        ("c.ply", ASCII.replace(b"3.0 4.0 5.0", b"3.0 4.0 5.0 9.0").decode(), "row 2 .* has 4 columns, expected 3"),
        ("c.ply", ASCII.replace(b"2.0\n3.0 4.0", b"2.0 3.0\n4.0").decode(), "row 1 .* has 4 columns"),
        ("c.ply", ASCII.replace(b"4.0", b"4,0").decode(), "is not a complete .ply file"),
    ],
)
def test_point_files_with_wrong_rows_are_refused(name, content, message, tmp_path):
    with pytest.raises(SceneError, match=message):
        read(content.encode(), tmp_path, name=name)


def test_xyz_with_comments_and_more_columns(tmp_path):
    text = "\ufeff# x y z r g b\r\n//comment\r\n1 2\t3 255 0 0\r\n\r\n-4.5e-1 .5 +6. 1 2 3  # last\r\n"
    assert read(text.encode(), tmp_path, name="cloud.xyz").points.tolist() == [[1.0, 2.0, 3.0], [-0.45, 0.5, 6.0]]


def test_other_formats_and_missing_files(tmp_path):
    with pytest.raises(SceneError, match=r"'cloud.pcd' is not a readable point file.*one of .ply, .xyz"):
        read(b"# .PCD v.7", tmp_path, name="cloud.pcd")
    with pytest.raises(SceneError, match=r"line 6, obstacles\[0\].file: cannot read .*gone.ply"):
        parse_scene(HEAD + "- {name: a, kind: points, file: gone.ply, radius: 1}\n", path=tmp_path / "scene.yaml")


def test_large_cloud_is_fast(tmp_path):
    """A hundred thousand points in a file: none in the scene's text, one tree."""
    points = np.random.default_rng(0).uniform(0, 1, (100_000, 3))
    cloud = PointCloud.from_points("canopy", points, 0.01)
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


def test_thinned_points_stay_unchanged():
    close = np.random.default_rng(0).uniform(0.0, 1e-3, (50, 3))
    cloud = PointCloud.from_thinned("c", close, 0.01)
    (solid,) = cloud.solids
    assert solid.rounding == 0.01
    assert sorted(map(tuple, solid.core)) == sorted(map(tuple, close))
    assert len(PointCloud.from_points("c", close, 0.01).solids[0].core) < 50
