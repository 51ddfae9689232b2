"""Collision bodies, their travel per joint and pairs, against samples and Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from any_arms import ARMS, limb, loaded_arm
from shapes import torus

from hplan.collision.collision_bodies import MOST_BODY_POINTS, body_shapes, collision_bodies
from hplan.collision.compiled_bodies import FlatBodies
from hplan.collision.motion_coefficients import ON_AXIS, carriers, joint_axis, reach
from hplan.collision.self_pairs import required_distances, self_pairs
from hplan.robot.model import load_robot


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    return lambda name: loaded_arm(name, tmp_path_factory)


def surface_points(geometry: coal.CollisionGeometry, rng: np.random.Generator) -> np.ndarray:
    """Points on the surface of a shape, including the outermost ones."""
    if isinstance(geometry, coal.BVHModelBase):
        corners = np.array(geometry.vertices())
        faces = [geometry.tri_indices(number) for number in range(geometry.num_tris)]
        weights = rng.dirichlet(np.ones(3), len(faces))
        return np.vstack([corners, [w @ corners[[f[0], f[1], f[2]]] for w, f in zip(weights, faces, strict=True)]])
    if isinstance(geometry, coal.Sphere):
        return geometry.radius * trimesh.unitize(rng.normal(size=(200, 3)))
    if isinstance(geometry, coal.Box):
        return rng.choice([-1.0, 1.0], (50, 3)) * np.array(geometry.halfSide)
    angles, ends = rng.uniform(0.0, 2.0 * np.pi, 200), rng.choice([-1.0, 1.0], 200)
    rim = geometry.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.c_[rim, ends * geometry.halfLength]
    if isinstance(geometry, coal.Capsule):
        points = np.vstack([points, [[0, 0, geometry.halfLength + geometry.radius]]])
    return points


@pytest.mark.parametrize("name", [*ARMS, "harvester"])
def test_bodies_hold_the_urdfs_shapes(load, name):
    """Each point of a shape is in one of its bodies, in every direction."""
    robot, rng = load(name), np.random.default_rng(1)
    directions = trimesh.unitize(rng.normal(size=(1000, 3)))
    bodies = collision_bodies(robot)
    for number, shape in enumerate(robot.collision_model.geometryObjects):
        points = surface_points(shape.geometry, rng) @ shape.placement.rotation.T + shape.placement.translation
        heights, least = points @ directions.T, np.full(len(points), np.inf)
        own = [body for body in bodies if number in body.shapes]
        for body in own:
            assert 1 <= len(body.core) <= MOST_BODY_POINTS
            assert body.joint == shape.parentJoint - 1
            support = (directions @ body.core.T).max(axis=1) + body.rounding
            least = np.minimum(least, (heights - support).max(axis=1))
            if body.exact and len(body.shapes) == 1:
                assert (heights.max(axis=0) - support).max() >= -2e-2 * np.ptp(points, axis=0).max()
        assert least.max() <= (1e-9 if len(own) == 1 else 1e-6)


@pytest.mark.parametrize("name", [*ARMS, "harvester"])
def test_bodies_protrude_beyond_coal_shapes_by_at_most_the_bound(load, name):
    robot = load(name)
    directions = trimesh.unitize(np.random.default_rng(2).normal(size=(2000, 3)))
    for body, judged in zip(collision_bodies(robot), body_shapes(robot), strict=True):
        support = (directions @ body.core.T).max(axis=1) + body.rounding
        local = directions @ judged.placement.rotation
        geometry = judged.geometry
        if isinstance(geometry, coal.Convex):
            true = (local @ np.array(geometry.points()).T).max(axis=1) + geometry.getSweptSphereRadius()
        elif isinstance(geometry, coal.Sphere):
            true = np.full(len(local), geometry.radius)
        elif isinstance(geometry, coal.Box):
            true = np.abs(local) @ np.array(geometry.halfSide)
        elif isinstance(geometry, coal.Capsule):
            true = np.abs(local[:, 2]) * geometry.halfLength + geometry.radius
        else:
            true = np.abs(local[:, 2]) * geometry.halfLength + np.hypot(*local[:, :2].T) * geometry.radius
        stands_out = support - true - directions @ judged.placement.translation
        assert stands_out.min() >= -1e-9
        assert stands_out.max() <= body.growth + 1e-9


def test_meshes_are_cut_or_made_hulls(tmp_path, monkeypatch):
    """A ring is far from convex; without one triangle it is a single hull."""
    ring = trimesh.Trimesh(*torus(n=12))
    ring.export(tmp_path / "ring.stl")
    trimesh.Trimesh(ring.vertices, ring.faces[1:]).export(tmp_path / "torn.stl")
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "block.stl")
    shapes = [f'<mesh filename="{tmp_path}/{name}.stl"/>' for name in ("ring", "block", "torn")]
    robot = load_robot(
        '<robot name="two"><link name="base_link"/>'
        + limb("a", "base_link", "revolute", "0 0 1", "0 0 0", shapes[0])
        + limb("b", "a_link", "revolute", "0 0 1", "0 0 3", shapes[1])
        + limb("c", "b_link", "revolute", "0 0 1", "0 0 0", shapes[2]).replace("c_link", "tool0")
        + "</robot>"
    )
    *ring, second, torn = collision_bodies(robot)
    assert [(piece.kind, piece.exact, piece.shapes) for piece in ring] == [("mesh piece", False, (0,))] * 4
    assert (torn.kind, torn.exact) == ("mesh hull", False)
    assert (second.kind, second.exact, second.growth, len(second.core)) == ("mesh", True, 0.0, 8)
    monkeypatch.setattr("hplan.collision.collision_bodies.convex_pieces", None)
    again = load_robot(robot.urdf_text)  # the same meshes, not cut again
    for one, other in zip(collision_bodies(robot), collision_bodies(again), strict=True):
        np.testing.assert_array_equal(one.core, other.core)


@pytest.mark.parametrize("scale", ["1 1 1", "-1 1 1", "0.2 -0.5 -1"])
@pytest.mark.parametrize("kind", ["ring", "one part inside out", "flat, with two faces"])
def test_mirrored_and_inverted_meshes_contain_their_surface(tmp_path, kind, scale):
    """Mirrored by a scale, a mesh has its faces the other way round: cut as a hollow it would be its hull."""
    mesh = trimesh.Trimesh(*torus(n=12))
    if kind == "one part inside out":
        mesh = trimesh.util.concatenate(
            [mesh, trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((0.0, 0.0, 0.4))]
        )
        faces = mesh.faces.copy()
        faces[-12:] = faces[-12:, ::-1]
        mesh = trimesh.Trimesh(mesh.vertices, faces, process=False)
    if kind == "flat, with two faces":
        corners, faces = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.5)], [(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)]
        mesh = trimesh.Trimesh(corners, faces, process=False)
    mesh.export(tmp_path / "mesh.obj")
    shape = f'<mesh filename="{tmp_path}/mesh.obj" scale="{scale}"/>'
    link = limb("a", "base_link", "revolute", "0 0 1", "0 0 0", shape).replace("a_link", "tool0")
    robot = load_robot(f'<robot name="one"><link name="base_link"/>{link}</robot>')
    shapes, place = body_shapes(robot), robot.collision_model.geometryObjects[0].placement
    sizes = np.array([float(number) for number in scale.split()])
    on_surface = trimesh.sample.sample_surface(mesh, 200, seed=1)[0] * sizes
    for point in np.vstack([mesh.vertices * sizes, on_surface]) @ place.rotation.T + place.translation:
        at = coal.Transform3s(np.eye(3), point)
        away = [
            coal.distance(
                shape.geometry,
                coal.Transform3s(shape.placement.rotation, shape.placement.translation),
                coal.Sphere(1e-5),
                at,
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            for shape in shapes
        ]
        assert min(away) <= 1e-6
    assert len(shapes) == (4 if kind != "flat, with two faces" else 1)
    hull = mesh.convex_hull.volume * abs(sizes.prod())
    if kind == "ring":
        assert sum(shape.geometry.computeVolume() for shape in shapes) < 0.8 * hull


def points_of(body, shape):
    """Points of a body's core, and the mesh vertices of coal, in its joint's frame."""
    if not isinstance(shape.geometry, coal.Convex):
        return body.core
    vertices = np.array(shape.geometry.points()) @ shape.placement.rotation.T + shape.placement.translation
    return np.vstack([body.core, vertices])


@pytest.mark.parametrize(("name", "most"), [*((name, MOST_BODY_POINTS) for name in [*ARMS, "harvester"]), ("ur5", 24)])
def test_reach_is_never_exceeded_and_nearly_attained(load, name, most, monkeypatch):
    """Distances of points from the joints' axes, at random configurations."""
    monkeypatch.setattr("hplan.collision.collision_bodies.MOST_BODY_POINTS", most)
    robot, rng = replace(load(name)), np.random.default_rng(3)
    bodies, bounds = collision_bodies(robot), reach(robot)
    judged = [points_of(*each) for each in zip(bodies, body_shapes(robot), strict=True)]
    assert bounds.shape == (len(bodies), robot.dof)
    found = np.zeros_like(bounds)
    data = robot.model.createData()
    axes = [joint_axis(robot, joint) for joint in range(robot.dof)]
    for q in rng.uniform(robot.lower, robot.upper, (300, robot.dof)):
        pin.forwardKinematics(robot.model, data, q)
        for row, body in enumerate(bodies):
            place = data.oMi[body.joint + 1]
            points = judged[row] @ place.rotation.T + place.translation
            for joint in carriers(robot, body.joint):
                axis, slides = axes[joint]
                frame = data.oMi[joint + 1]
                away = np.linalg.norm(np.cross(points - frame.translation, frame.rotation @ axis), axis=1)
                found[row, joint] = 1.0 if slides else max(found[row, joint], away.max())
    for row, body in enumerate(bodies):
        if body.kind == "cylinder" and body.joint >= 0 and bounds[row, body.joint] <= ON_AXIS:
            found[row, body.joint] = bounds[row, body.joint]  # its points move, the cylinder does not
    assert (found <= bounds + 1e-9).all()
    assert ((bounds > 1e-9) == (found > 1e-9)).all()
    last = len(bodies) - 1
    assert found[last].sum() >= 0.75 * bounds[last].sum()


@pytest.mark.parametrize("name", [*ARMS, "harvester"])
def test_no_body_moves_farther_than_its_coefficient(load, name):
    robot, rng = load(name), np.random.default_rng(4)
    bodies, bounds = collision_bodies(robot), reach(robot)
    first, second = robot.model.createData(), robot.model.createData()
    for q in rng.uniform(robot.lower, robot.upper, (200, robot.dof)):
        step = rng.normal(size=robot.dof) * rng.choice([1e-3, 0.1, 1.0])
        other = np.clip(q + step, robot.lower, robot.upper)
        pin.forwardKinematics(robot.model, first, q)
        for row, body in enumerate(bodies):
            there = other.copy()
            if body.kind == "cylinder" and body.joint >= 0 and bounds[row, body.joint] <= ON_AXIS:
                there[body.joint] = q[body.joint]  # its points move, the cylinder does not
            pin.forwardKinematics(robot.model, second, there)
            places = [data.oMi[body.joint + 1] for data in (first, second)]
            a, b = (body.core @ place.rotation.T + place.translation for place in places)
            assert np.linalg.norm(b - a, axis=1).max() <= bounds[row] @ np.abs(other - q) + 1e-9


@pytest.mark.parametrize("name", ["toy", "lift", "panda", "ur5"])
def test_pairs_that_are_left_out(load, name):
    """Every pair is in one list; pairs that never, or always, touch do so."""
    robot, rng = load(name), np.random.default_rng(5)
    bodies, shapes, pairs = collision_bodies(robot), body_shapes(robot), self_pairs(robot)
    listed = [*pairs.checked, *(pair[:2] for pair in pairs.allowed)]
    assert sorted(listed) == [(i, j) for i in range(len(bodies)) for j in range(i + 1, len(bodies))]
    bounds = FlatBodies.build(robot).reaches[-len(pairs.checked) :]
    geometry = pin.GeometryModel()
    for shape in shapes:
        geometry.addGeometryObject(shape)
    for i, j in listed:
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    arm, data = robot.model.createData(), geometry.createData()

    def distances(q):
        pin.computeDistances(robot.model, arm, geometry, data, q)
        return np.array([result.min_distance for result in data.distanceResults])

    checked, still = len(pairs.checked), {}
    for q in rng.uniform(robot.lower, robot.upper, (100, robot.dof)):
        found = distances(q)
        for distance, (i, j, reason) in zip(found[checked:], pairs.allowed, strict=True):
            if reason.startswith("they cannot touch"):
                assert distance > 0.0
            elif reason.startswith("they touch"):
                assert distance <= 0.0
            elif reason.startswith("they are the two sides"):
                assert distance <= 0.02 + 1e-9
            elif reason.startswith("they do not move"):
                assert bodies[i].joint == bodies[j].joint
            elif reason.startswith("no joint changes"):
                assert distance == pytest.approx(still.setdefault((i, j), distance), abs=1e-6)
            else:
                assert reason.startswith("may touch: ")
        step = rng.normal(size=robot.dof) * 0.05
        other = np.clip(q + step, robot.lower, robot.upper)
        assert (np.abs(distances(other) - found)[:checked] <= bounds @ np.abs(other - q) + 1e-5).all()


def test_pairs_of_panda_are_in_srdf_or_checked(load):
    robot = load("panda")
    bodies, pairs = collision_bodies(robot), self_pairs(robot)
    reasons = {(bodies[i].name, bodies[j].name): reason for i, j, reason in pairs.allowed}
    assert reasons["panda_link5", "panda_link7"] == "may touch: Default"
    checked = {(bodies[i].name, bodies[j].name) for i, j in pairs.checked}
    assert ("panda_link0", "panda_link2") in checked  # `Never` of an SRDF is no proof
    assert ("panda_link0", "panda_hand") in checked


def test_pairs_never_far_apart_are_checked_for_contact_only(load):
    pairs = self_pairs(load("toy"))
    assert required_distances(pairs.farthest, 0.0).tolist() == [0.0] * len(pairs.checked)
    far = pairs.farthest[np.isfinite(pairs.farthest) & (pairs.farthest > 0.02)]
    keep = float(far.min()) + 1e-3
    wanted = required_distances(pairs.farthest, keep)
    assert (wanted == np.where(pairs.farthest > keep, keep, 0.0)).all()
    assert 0.0 in wanted
    assert keep in wanted
