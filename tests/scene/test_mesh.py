"""Meshes, and convex pieces that hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import blocks, crate, surface_points, torus, turned, uncovered

from hplan import PlanOptions, certify, plan
from hplan.errors import SceneError
from hplan.geometry.convex_decomposition import winding_numbers
from hplan.scene.file import dump_scene, load_scene, parse_scene, save_scene
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Mesh
from hplan.scene.shape_data import MOST_TRIANGLES, Surface, write_shape

HEAD = "format: hplan-scene/1\nname: a\nstart: {joints_deg: [0]}\ngoal: {joints_deg: [1]}\nobstacles:\n"
BLOCK = Box(name="block", center=(0.5, 1.0, 1.5), size=(1.0, 2.0, 3.0))
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def a_scene(*obstacles, **changes) -> Scene:
    return Scene(name="a", start=Start(joints_deg=(0,)), goal=Goal(joints_deg=(1,)), obstacles=obstacles, **changes)


def export(kind: str, folder: Path, vertices=None, faces=None) -> Path:
    import trimesh

    vertices, faces = torus(n=12) if vertices is None else (vertices, faces)
    path = folder / f"shape-{kind.replace(' ', '-')}.{kind.split()[-1]}"
    options = {"encoding": "ascii"} if kind.startswith("ascii ply") else {}
    if kind == "ascii stl":
        options = {"file_type": "stl_ascii"}
    trimesh.Trimesh(vertices, faces, process=False).export(path, **options)
    return path


@pytest.mark.parametrize("kind", ["stl", "ascii stl", "ply", "ascii ply", "obj", "off"])
def test_formats(kind, tmp_path):
    path = export(kind, tmp_path)
    (tmp_path / "scene.yaml").write_text(HEAD + f"- {{name: ring, kind: mesh, file: {path.name}}}\n")
    (mesh,) = load_scene(tmp_path / "scene.yaml").obstacles
    vertices, faces = mesh.surface
    expected, _ = torus(n=12)
    assert (vertices.shape, faces.shape) == (expected.shape, (288, 3))
    order, theirs = np.lexsort(vertices.round(5).T), np.lexsort(expected.round(5).T)
    np.testing.assert_allclose(vertices[order], expected[theirs], atol=1e-6)


def test_placement():
    pose = {"position": (1.0, 2.0, 3.0), "rpy_deg": (10.0, 20.0, 30.0)}
    rest = Mesh.from_arrays("m", 1000.0 * BLOCK.core, FACES, scale=1e-3, sigma=0.02, **pose)
    (hull,) = rest.solids
    turn = Box(name="b", center=(0, 0, 0), size=(1, 1, 1), rpy_deg=pose["rpy_deg"]).rotation
    expected = BLOCK.core @ turn.T + pose["position"]
    np.testing.assert_allclose(np.sort(hull.core.round(9), axis=0), np.sort(expected.round(9), axis=0), atol=1e-9)
    vertices, faces = rest.surface
    np.testing.assert_allclose(np.sort(vertices, axis=0), np.sort(expected, axis=0), atol=1e-9)
    assert faces.shape == FACES.shape
    assert (hull.sigma, hull.rounding, hull.is_point_set, rest.excess) == (0.02, 0.0, False, 0.0)
    assert not hull.core.flags.writeable


def faulty():
    vertices, faces = torus(n=8)
    nan = vertices.copy()
    nan[3, 1] = np.nan
    turned = faces.copy()
    turned[5] = turned[5, ::-1]
    flat = BLOCK.core * [1, 1, 0]
    return {
        "open": (vertices, faces[1:], "the mesh is open: 3 edges"),
        "inside out": (vertices, faces[:, ::-1], "inside out: its volume is -.*flip its faces"),
        "not a number": (nan, faces, r"1 of 64 vertices are not finite; the first is number 3"),
        "turned": (vertices, turned, "no consistent orientation: at 3 edges"),
        "flat": (flat, FACES, "the mesh is flat"),
        "all but flat": (BLOCK.core * [1, 1, 1e-7], FACES, "the mesh is flat"),
        "no triangles": (vertices, np.zeros((0, 3), dtype=int), "the mesh is empty"),
        "no vertices": (np.zeros((0, 3)), faces, "there are no vertices"),
        "all one": (np.zeros((64, 3)), faces, "the mesh is empty: all of its triangles are points or lines"),
        "beyond": (vertices, faces + 1, "refers to vertex 64, but the mesh has 64"),
        "before": (vertices, faces - 1, "refers to vertex"),
        "fractions": (vertices, faces.astype(float), "whole numbers"),
        "shape": (vertices[:, :2], faces, r"\(n, 3\)"),
        "text": ([["a", "b", "c"]], faces, r"\(n, 3\) numbers"),
        "far": (vertices * 1e9, faces, "expected metres"),
        "small": (vertices * 1e-9, faces, "m across; expected 0.1 mm"),
        "huge": (vertices, np.zeros((MOST_TRIANGLES + 1, 3), dtype=int), "simplify it"),
    }


@pytest.mark.parametrize("name", faulty())
def test_faulty_arrays(name):
    vertices, faces, message = faulty()[name]
    with pytest.raises(SceneError, match=message) as caught:
        Mesh.from_arrays("ring", vertices, faces)
    assert caught.value.where == "ring" or "m across" in caught.value.reason


@pytest.mark.parametrize(
    ("entry", "content", "where", "message"),
    [
        ("file: no.stl", None, "file", "cannot read .*no.stl: No such file"),
        ("file: empty.stl", b"", "file", "empty.stl is empty"),
        ("file: junk.stl", b"this is no mesh", "file", "empty: it has no triangles"),
        ("file: cut.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "file", "ply"),
        ("file: crate.dae", b"<xml/>", "file", "'crate.dae' is not a readable mesh file.*convert it to one of .stl"),
        ("scale: 2.0", None, "file", "this key is missing"),
        ("{file: ring.ply, scale: 0}", None, "scale", "greater than 0"),
        ("{file: ring.ply, scale: 1.0e+7}", None, "file", "check its scale"),
    ],
)  # fmt: skip
def test_faulty_entries(entry, content, where, message, tmp_path):
    write_shape(Surface.from_arrays(*torus(n=8)), tmp_path / "ring.ply")
    if content is not None:
        (tmp_path / entry.split()[1]).write_bytes(content)
    inner = entry.strip("{}")
    text = HEAD + f"- {{name: ring, kind: mesh, {inner}}}\n"
    with pytest.raises(SceneError, match=message) as caught:
        parse_scene(text, path=tmp_path / "scene.yaml")
    assert caught.value.line == 6
    assert caught.value.where.startswith(f"obstacles[0].{where}")


def test_saved_and_read_again(tmp_path):
    (tmp_path / "deep").mkdir()
    write_shape(Surface.from_arrays(*crate()), tmp_path / "crate.ply")
    scene = parse_scene(
        HEAD + "- {name: crate, kind: mesh, file: crate.ply, position: [1, 0, 0], sigma: 0.01}\n",
        path=tmp_path / "scene.yaml",
    )
    assert "file: crate.ply\n" in dump_scene(scene)
    assert parse_scene(dump_scene(scene), path=tmp_path / "scene.yaml") == scene
    assert load_scene(save_scene(scene, tmp_path / "again.yaml")) == scene
    assert "file: crate.ply\n" in (tmp_path / "again.yaml").read_text()
    there = load_scene(save_scene(scene, tmp_path / "deep" / "scene.yaml"))
    assert there.obstacles[0].file == "../crate.ply"
    assert there.obstacles[0].surface[0].tolist() == scene.obstacles[0].surface[0].tolist()


def test_arrays_are_written_next_to_the_scene(tmp_path):
    scene = a_scene(Mesh.from_arrays("a/b", *torus(n=8)), Mesh.from_arrays("a-b", *crate()))
    with pytest.raises(SceneError, match="has no file; save_scene writes one") as caught:
        dump_scene(scene)
    assert caught.value.where == "obstacles[0].file"
    again = load_scene(save_scene(scene, tmp_path / "scene.yaml"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene-0-a-b.ply", "scene-1-a-b.ply", "scene.yaml"]
    for mine, theirs in zip(scene.obstacles, again.obstacles, strict=True):
        assert mine.surface[0].tolist() == theirs.surface[0].tolist()
        assert mine.surface[1].tolist() == theirs.surface[1].tolist()


#: The arm is lifted, from 20 to 60 deg.
MOTION = Scene(name="lift", start=Start(joints_deg=(0.0, 20.0, 0.0, 0.0)), goal=Goal(joints_deg=(0.0, 60.0, 0.0, 0.0)))


def sheet(rng: np.random.Generator, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with holes and notches: of no thickness as two faces back to back, flat or bent, any way up."""
    filled = rng.random((rng.integers(1, 4), rng.integers(1, 4), 1)) < 0.7
    filled[0, 0] = True
    x, y = (np.cumsum(rng.uniform(0.05, 0.3, size + 1)) for size in filled.shape[:2])
    vertices, faces = blocks(filled, x, y, np.array([0.0, 1.0]))
    bend = rng.choice([0.0, 0.2]) * (vertices[:, 0] ** 2 - vertices[:, 1])
    if thickness == 0.0:  # the lower faces, and the same from above
        low = faces[(vertices[faces][:, :, 2] == 0.0).all(axis=1)]
        faces = np.concatenate([low, low[:, ::-1]])
    vertices = np.column_stack([vertices[:, :2], thickness * vertices[:, 2] + bend])[:, rng.permutation(3)]
    return turned(vertices) if rng.random() < 0.4 else vertices, faces


@settings(max_examples=8)
@given(st.integers(0, 10_000))
def test_sheets_among_solids_are_held(seed):
    """All points of panels and leaves, next to, through and on solids."""
    rng = np.random.default_rng(seed)
    filled = rng.random((2, 2, 2)) < 0.6
    filled[0, 0, 0] = True
    vertices, faces = blocks(filled, *(np.cumsum(rng.uniform(0.05, 0.3, 3)) for _ in range(3)))
    for _ in range(rng.integers(1, 4)):
        more, its_faces = sheet(rng, rng.choice([0.0, 5e-8, 3e-7, 2e-6, 1e-3]))
        shift = rng.uniform(-1.0, 1.0, 3)
        on = rng.integers(3)  # a sheet's corner in the plane of a side of a block
        shift[on] = rng.choice([shift[on], vertices[0, on] - more[0, on]])
        faces = np.concatenate([faces, its_faces + len(vertices)])
        vertices = np.concatenate([vertices, more + shift])
    mesh = Mesh.from_arrays("tree", vertices, faces)
    points, triangles = mesh.surface
    covered = np.vstack([points, surface_points(points, triangles, 200)])
    assert uncovered(mesh.solids, covered) <= 1e-6
    # No point of a piece is farther from the surface than is said.
    near = surface_points(points, triangles, 4000)
    mixed = np.vstack([rng.dirichlet(np.full(len(hull.core), 0.2), 10) @ hull.core for hull in mesh.solids])
    outside = mixed[np.abs(winding_numbers(mixed, points[triangles])) < 0.5]
    gaps = [np.linalg.norm(near - point, axis=1).min() for point in outside]
    assert max(gaps, default=0.0) <= mesh.excess + 0.05  # `near` is not everywhere


@pytest.mark.parametrize("thickness", [0.0, 5e-8, 9e-8, 2e-7, 1e-6])
def test_motion_through_a_sheet_is_not_certified(robot, thickness):
    """A trunk out of reach, and a panel across the arm, which was dropped once: the motion was verified."""
    trunk, its_faces = blocks(np.ones((1, 1, 1), dtype=bool), *(np.array([0.0, size]) for size in (0.1, 0.1, 1.0)))
    panel, faces = blocks(np.ones((1, 1, 1), dtype=bool), *(np.array([0.0, size]) for size in (1.0, 0.6, 0.6)))
    if thickness == 0.0:
        faces = faces[(panel[faces][:, :, 0] == 0.0).all(axis=1)]
        faces = np.concatenate([faces, faces[:, ::-1]])
    panel = panel * [thickness, 1.0, 1.0] + [1.2, -0.3, 1.3]
    vertices = np.concatenate([trunk + np.array([2.6, 0.0, 0.0]), panel])
    tree = Mesh.from_arrays("tree", vertices, np.concatenate([its_faces, faces + len(trunk)]))
    assert len(tree.solids) == 2
    assert 0.0 < tree.excess < 0.1
    motion = plan(robot, MOTION, PlanOptions(certify=False)).trajectory
    assert certify(robot, MOTION, motion).verified
    certificate = certify(robot, MOTION.with_obstacles([tree]), motion)
    assert not certificate.verified
    assert certificate.min_clearance_m < 0.0


def a_tetrahedron(name: str, corners: list[str]) -> str:
    """A mesh file by the text of its corners."""
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    listed = "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n"
    head += "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    rows = "\n".join(corners) + "\n"
    loops = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {corners[k]}\n" for k in face) + "endloop\nendfacet\n"
        for face in faces
    )
    return {
        "a.obj": "".join(f"v {row}\n" for row in corners)
        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces),
        "a.off": f"OFF\n4 4 0\n{rows}{listed}",
        "a.stl": f"solid a\n{loops}endsolid a\n",
        "a.ply": head + rows + listed,
    }[name]


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.stl", "a.ply"])
@pytest.mark.parametrize(
    "corners",
    [
        ["0 0 0 9", "1 0", "0 1 0", "0 0 1"],
        ["0 0 0", "1 0 0 0", "1 0", "0 0 1"],
        ["0,0 0 0", "1,5 0 0", "0 1,5 0", "0 0 1,5"],
    ],
)
def test_mesh_files_with_wrong_rows_are_refused(name: str, corners: list[str], tmp_path: Path) -> None:
    """Ragged rows with the right total of numbers, and decimal commas."""
    file = tmp_path / name
    file.write_text(a_tetrahedron(name, ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]))
    assert Mesh(name="a", file=str(file)).surface[0].max() == 1.0
    file.write_text(a_tetrahedron(name, corners))
    with pytest.raises(SceneError):
        Mesh(name="a", file=str(file))
