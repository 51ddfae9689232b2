"""Closed meshes in place of their hulls and pieces: distances, and motions that these alone would refuse."""

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from shapes import crate, torus
from toy_urdf import urdf

from hplan import certify, load_robot
from hplan.collision.coal_cloud import BareShape, PointBlocks
from hplan.collision.coal_meshes import ClosedMesh
from hplan.collision.collision_bodies import body_shapes, closed_meshes, collision_bodies
from hplan.geometry.cloud import LEAF
from hplan.geometry.cloud_tree import tree_of
from hplan.geometry.coal_hull import convex_hull_shape
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Capsule
from hplan.trajectory.trajectory import Trajectory


def closest(points, triangles):
    """(n,) distances of points from the nearest triangle: of the plane where its foot is inside, else of the edges."""
    a, b, c = (triangles[None, :, k] for k in range(3))
    p = points[:, None]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    inside, edges = np.ones(np.broadcast_shapes(p.shape, a.shape)[:2], dtype=bool), []
    for first, second in ((a, b), (b, c), (c, a)):
        along = second - first
        inside &= (np.cross(along, p - first) * normal).sum(axis=2) >= 0.0
        share = np.clip(((p - first) * along).sum(axis=2) / (along * along).sum(axis=2), 0.0, 1.0)
        edges.append(np.linalg.norm(p - first - share[..., None] * along, axis=2))
    plane = np.where(inside, np.abs(((p - a) * normal).sum(axis=2)), np.inf)
    return np.min([plane, *edges], axis=0).min(axis=1)


def closed(surface):
    vertices, faces = surface
    return ClosedMesh(vertices, faces, np.zeros(len(faces), dtype=np.int64)), vertices[faces]


def random_place(rng, size):
    return pin.SE3(pin.Quaternion(*rng.normal(size=4)).normalized().toRotationMatrix(), rng.uniform(-size, size, 3))


def surface_of(triangles, n):
    """Points on triangles, n to a side, and the maximum distance of a surface point from the nearest of them."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    share = np.stack([i, j, n - i - j], axis=-1)[i + j <= n] / n
    side = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max()
    return np.einsum("km,tmx->tkx", share, triangles).reshape(-1, 3), side / n


@pytest.mark.parametrize("surface", [torus(n=12), crate()], ids=["torus", "crate"])
def test_distances_are_those_of_the_triangles(surface):
    """From balls, capsules, boxes, hulls, clouds and another mesh, at random poses."""
    mesh, triangles = closed(surface)
    other, other_triangles = closed(torus(0.12, 0.02, n=8))
    rng, touched = np.random.default_rng(1), 0
    hull = convex_hull_shape(rng.uniform(-0.08, 0.08, (12, 3)))
    axis = np.linspace(-0.1, 0.1, 201)[:, None] * np.array([[0.0, 0.0, 1.0]])
    box = trimesh.creation.box((0.1, 0.06, 0.2)).triangles
    hull_triangles = trimesh.convex.convex_hull(np.array(hull.points()).reshape(-1, 3)).triangles
    solids = [
        (coal.Sphere(0.03), np.zeros((1, 3)), 0.03, 1e-9),
        (coal.Capsule(0.02, 0.2), axis, 0.02, 1e-3),
        (coal.Box(0.1, 0.06, 0.2), *surface_of(box, 4)),
        (hull, *surface_of(hull_triangles, 4)),
    ]
    for _ in range(10):
        place, other_place = random_place(rng, 0.1), random_place(rng, 0.3)
        for geometry, points, *rest in solids:
            radius, coarse = rest if len(rest) == 2 else (0.0, rest[0])
            found = mesh.distance(place, BareShape.strip(geometry), other_place)
            there = (points @ other_place.rotation.T + other_place.translation - place.translation) @ place.rotation
            true = closest(there, triangles).min() - radius
            if found == -np.inf:
                touched += 1
                assert true <= coarse or mesh.contains(there)
            else:
                assert true - coarse <= found <= true + 2e-6
                assert not mesh.contains(there)
        found = mesh.distance(place, other, other_place)
        points, coarse = surface_of(other_triangles, 2)
        there = (points @ other_place.rotation.T + other_place.translation - place.translation) @ place.rotation
        true = closest(there, triangles).min()
        assert (found == -np.inf and true <= coarse) or true - coarse <= found <= true + 2e-6
        points = rng.uniform(-0.5, 0.5, (40, 3))
        cloud = PointBlocks(*tree_of(points, LEAF))
        local = (points - place.translation) @ place.rotation
        if mesh.contains(local):
            assert mesh.cloud_distance(place, cloud) == -np.inf
        else:
            assert mesh.cloud_distance(place, cloud) == pytest.approx(closest(local, triangles).min(), abs=1e-6)
    assert touched > 5


def test_what_is_inside_is_in_contact():
    """It touches no triangle."""
    tube, (small, _) = closed(torus(0.3, 0.1))[0], closed(torus(0.02, 0.005, n=12))
    inside, in_hole = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), pin.SE3.Identity()
    for solid in (BareShape.strip(coal.Sphere(0.02)), BareShape.strip(coal.Box(0.04, 0.04, 0.04)), small):
        assert tube.distance(pin.SE3.Identity(), solid, inside) == -np.inf
        assert tube.distance(pin.SE3.Identity(), solid, in_hole) > 0.15
    assert small.distance(inside, tube, pin.SE3.Identity()) == -np.inf
    point = PointBlocks(*tree_of(np.array([[0.3, 0.0, 0.0], [2.0, 0.0, 0.0]]), LEAF))
    assert tube.cloud_distance(pin.SE3.Identity(), point) == -np.inf
    assert tube.cloud_distance(pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.5])), point) > 0.3


@pytest.fixture
def ring(tmp_path):
    """An arm of two joints whose last link is a ring in the plane of its joints."""
    vertices, faces = torus(0.2, 0.02)
    trimesh.Trimesh(vertices @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]).T, faces).export(tmp_path / "ring.stl")
    shape = '<collision><origin xyz="0.4 0 0"/><geometry><mesh filename="ring.stl"/></geometry></collision>'
    text = urdf().replace('<link name="l2">', f'<link name="l2">{shape}')
    (tmp_path / "ring.urdf").write_text(text)
    limits = "format: hplan-limits/1\nacceleration_rad_s2: {a: 5, b: 5}\n"
    (tmp_path / "ring.limits.yaml").write_text(limits)
    return load_robot(tmp_path / "ring.urdf", tool_frame="l2")


def turn(robot, angle):
    """The second joint turns there and back."""
    time = np.linspace(0.0, 4.0, 81)
    position, velocity, acceleration = np.zeros((3, 81, robot.dof))
    w = 0.5 * np.pi
    position[:, 1] = 0.5 * angle * (1.0 - np.cos(w * time))
    velocity[:, 1] = 0.5 * angle * w * np.sin(w * time)
    acceleration[:, 1] = 0.5 * angle * w * w * np.cos(w * time)
    return Trajectory(robot.joint_names, time, position, velocity, acceleration, np.zeros_like(position), robot.slides)


def among(*obstacles):
    return Scene(
        name="post",
        start=Start(joints_rad=(0.0, 0.0)),
        goal=Goal(joints_rad=(0.0, 0.0)),
        obstacles=obstacles,
        clearance=0.0,
    )


def test_post_in_a_ring(ring):
    """The ring's hull holds the post, its pieces nearly touch it; the ring is verified until it meets the post."""
    post = Capsule(name="post", start=(0.8, -0.5, 0.0), end=(0.8, 0.5, 0.0), radius=0.09)
    assert {body.kind for body in collision_bodies(ring)} == {"mesh piece"}
    assert len(closed_meshes(ring)) == len(body_shapes(ring))
    for angle, is_free in ((0.05, True), (0.2, True), (0.3, False)):
        # The link is 0.4 m from the joint: the ring is displaced by so much, and 0.18 - 0.09 m are left.
        assert (2.0 * 0.4 * np.sin(0.5 * angle) < 0.09) == is_free
        found = certify(ring, among(post), turn(ring, angle), check_ends=False)
        assert found.verified == is_free, found.violations
        if is_free:
            # The pieces are a lower bound as well, where they are apart.
            left, curve = 0.09 - 2.0 * 0.4 * np.sin(0.5 * angle), found.subject.curve
            assert 0.0 < found.min_clearance_m <= curve.distance_m.min() <= left + 1e-3
            assert (curve.clearance_m <= curve.distance_m + 1e-6).all()
