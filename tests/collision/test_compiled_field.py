"""Clearances against coal and brute force, motion bounds and proofs against dense sampling."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from arm_variants import VARIANTS, coal_distances, from_obstacles, link_axes, load_variant, random_obstacles

from hplan.collision import compiled_obstacles
from hplan.collision.coal_scene import CoalScene
from hplan.collision.compiled_clearance import body_clearances
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.distance_checker import FAR
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import hull_of
from hplan.planar.family_reader import family_of
from hplan.scene.obstacles import Box, Cylinder, Sphere

#: Clearances beyond all of the scenes [m].
ALL = 100.0

#: Where signed distances are this near to zero, either side may call it contact [m].
TOUCH = 1e-6


@pytest.fixture(params=VARIANTS)
def variant(request, tmp_path):
    return load_variant(request.param, tmp_path)


def assert_clearances_match(robot, obstacles, configurations):
    field = ClearanceField.build(robot, obstacles)
    contacts = 0
    for q in configurations:
        expected = coal_distances(robot, q, obstacles).min(axis=1)
        found = field.link_clearances(q, ALL)
        apart = expected > TOUCH
        np.testing.assert_allclose(found[apart], expected[apart], atol=1e-6, rtol=0)
        assert (found[~apart] <= 2 * TOUCH).all()
        assert field.spare_clearance(q) == min(found.min(), FAR)
        contacts += int((~apart).sum())
    return contacts


# Clearance at a configuration


def test_clearances_are_those_of_coal(variant):
    rng = np.random.default_rng(1)
    contacts = 0
    for _ in range(12):
        configurations = rng.uniform(variant.lower, variant.upper, (12, variant.dof))
        contacts += assert_clearances_match(variant, random_obstacles(rng), configurations)
    assert contacts > 0


def random_hull(rng, index, count=12):
    points = rng.normal(size=(count, 3)) * rng.uniform(0.02, 0.3, 3)
    name, place = f"h{index}", rng.uniform([-1.2, -1.2, 0.0], [1.2, 1.2, 1.6])
    return hull_of(points + place, name)


def by_points(robot, q, cloud):
    """(links,) distances from every ball, one by one."""
    axes = link_axes(robot, q)
    found = []
    for k, width in enumerate(family_of(robot).arm.half_widths):
        start, along = axes[k, 0], axes[k, 1] - axes[k, 0]
        t = np.clip((cloud.core - start) @ along / (along @ along), 0.0, 1.0)
        found.append(np.linalg.norm(cloud.core - start - t[:, None] * along, axis=1).min() - cloud.rounding - width)
    return np.array(found)


@pytest.mark.parametrize("count", [4, 12, 300])
def test_hulls_are_those_of_coal(variant, count):
    rng = np.random.default_rng(count)
    free = 0
    for index in range(6):
        hull = random_hull(rng, index, count)
        field, checker = ClearanceField.build(variant, [hull]), CoalScene(variant, [hull])
        for q in rng.uniform(variant.lower, variant.upper, (12, variant.dof)):
            expected, found = checker.distances(q)[:, 0], field.link_clearances(q, ALL)
            apart = expected > TOUCH
            np.testing.assert_allclose(found[apart], expected[apart], atol=1e-6, rtol=0)
            assert (found[~apart] <= 2 * TOUCH).all()
            free += int(apart.sum())
    assert free > 50


@pytest.mark.parametrize("count", [1, 2, 17, 2000])
def test_clouds_ball_by_ball(variant, count):
    rng = np.random.default_rng(count)
    for spread in (0.05, 1.0):
        points = rng.normal(size=(count, 3)) * spread * [1.0, 1.0, 0.2] + rng.uniform(-1, 1, 3)
        cloud = Cloud.from_points("cloud", points, 0.02)
        field = ClearanceField.build(variant, [cloud], clearance=0.01)
        for q in rng.uniform(variant.lower, variant.upper, (15, variant.dof)):
            np.testing.assert_allclose(field.link_clearances(q, ALL), by_points(variant, q, cloud) - 0.01, atol=1e-9)


def test_cylinders_from_outside(robot):
    """Of a cylinder the kernels see the prism about it: never farther than it is, nor much nearer."""
    rng, excess = np.random.default_rng(8), []
    for _ in range(40):
        center = tuple(rng.uniform([0.2, -0.6, 0.2], [1.8, 0.6, 1.8]))
        length, radius = np.exp(rng.uniform(np.log(0.02), np.log(0.4), 2))
        rpy = tuple(rng.choice([0.0, 90.0, 33.0], 3))
        can = Cylinder(name="can", center=center, length=length, radius=radius, rpy_deg=rpy)
        field, checker = ClearanceField.build(robot, can.solids), CoalScene(robot, can.solids)
        for q in rng.uniform(robot.lower, robot.upper, (20, 4)):
            true, found = from_obstacles(checker, q)[:, 0], field.link_clearances(q, ALL)[LINKS]
            apart = true > 1e-3
            assert (found[apart] <= true[apart] + 1e-9).all()
            assert (found[apart] >= true[apart] - can.excess - 1e-5).all()
            assert (found[true < 0.0] < can.excess).all()
            excess += [*(true - found)[apart] / can.excess]
    assert max(excess) > 0.9


#: The links of the harvester among its bodies: pedestal and turret come first, pairs last.
LINKS = slice(2, 5)


def crowd(rng):
    """Solids of all kinds, clouds between others, and a clearance for each."""
    clouds = [
        Cloud.from_points(f"c{i}", rng.uniform([0.3, -0.9, 0.3], [1.7, 0.9, 1.9], (120, 3)), 0.01) for i in range(2)
    ]
    solids = [*random_obstacles(rng, 6), random_hull(rng, 0), *clouds, random_hull(rng, 1)]
    solids = [solids[i] for i in rng.permutation(len(solids))]
    return solids, rng.uniform(0.0, 0.1, len(solids))


def test_each_obstacle_grown_by_its_own_clearance(robot):
    rng = np.random.default_rng(9)
    for _ in range(4):
        solids, keep = crowd(rng)
        field = ClearanceField.build(robot, solids, clearance=keep, own_clearance=0.0)
        alone = [
            ClearanceField.build(robot, [solid], clearance=each, own_clearance=0.0)
            for solid, each in zip(solids, keep, strict=True)
        ]
        for q in rng.uniform(robot.lower, robot.upper, (15, 4)):
            expected = np.min([one.link_clearances(q, ALL) for one in alone], axis=0)
            np.testing.assert_allclose(np.maximum(field.link_clearances(q, ALL), 0), np.maximum(expected, 0), atol=1e-9)


def test_only_some_of_the_solids(robot):
    """The field of some is the field made of these alone, clouds and hulls among them."""
    rng = np.random.default_rng(10)
    for _ in range(6):
        solids, keep = crowd(rng)
        field = ClearanceField.build(robot, solids, clearance=keep, own_clearance=0.0)
        kept = rng.random(len(solids)) < 0.5
        some = field.select(kept)
        made = ClearanceField.build(
            robot,
            [solid for solid, wanted in zip(solids, kept, strict=True) if wanted],
            clearance=keep[kept],
            own_clearance=0.0,
        )
        assert set(some.owner.tolist()) == set(np.flatnonzero(kept).tolist())
        for q in rng.uniform(robot.lower, robot.upper, (15, 4)):
            np.testing.assert_array_equal(some.link_clearances(q, ALL), made.link_clearances(q, ALL))
    assert field.select(np.zeros(len(solids), dtype=bool)).spare_clearance(np.zeros(4)) == FAR
    np.testing.assert_array_equal(field.select(np.ones(len(solids), dtype=bool)).solids, field.solids)
    assert not some.solids.flags.writeable


def test_ignored_solids_do_not_count_for_last_link(robot):
    """Including clouds and hulls."""
    rng = np.random.default_rng(13)
    for _ in range(6):
        solids, keep = crowd(rng)
        field, touched = ClearanceField.build(robot, solids, clearance=keep), rng.random(len(solids)) < 0.5
        spared, without = field.ignoring_last_link(touched), field.select(~touched)
        for q in rng.uniform(robot.lower, robot.upper, (15, 4)):
            expected = field.link_clearances(q, ALL)
            expected[LINKS.stop - 1] = without.link_clearances(q, ALL)[LINKS.stop - 1]
            np.testing.assert_array_equal(spared.link_clearances(q, ALL), expected)
        np.testing.assert_array_equal(field.ignoring_last_link(np.zeros(len(solids), dtype=bool)).solids, field.solids)
    nothing = ClearanceField.build(robot, [])
    assert nothing.ignoring_last_link(np.zeros(0, dtype=bool)).spare_clearance(np.zeros(4)) == FAR


# Bounds on motion


def bounds_of(field, turns):
    return field.reaches @ np.abs(turns)


def test_no_axis_point_moves_farther_than_the_bound(variant):
    rng = np.random.default_rng(7)
    field = ClearanceField.build(variant, [])
    closest = 0.0
    for _ in range(25):
        start, end = rng.uniform(variant.lower, variant.upper, (2, variant.dof))
        if family_of(variant).has_yaw and rng.random() < 0.3:
            end[1:] = start[1:]
        end = start + rng.choice([1.0, 0.01]) * (end - start)
        bounds = bounds_of(field, end - start)
        before = link_axes(variant, start)
        for t in np.linspace(0.0, 1.0, 41):
            moved = np.linalg.norm(link_axes(variant, start + t * (end - start)) - before, axis=2)
            farthest = moved.max(axis=1)  # on a segment the displacement is maximal at an end
            assert (farthest <= t * bounds + 1e-12).all()
            closest = max(closest, (farthest / np.maximum(t * bounds, 1e-12)).max())
    assert closest > 0.5


# Motions verified collision-free


def dense_clearance(checker, start, end, samples=240):
    return min(checker.distances(start + t * (end - start)).min() for t in np.linspace(0.0, 1.0, samples))


def random_motions(robot, rng, count):
    """Motions that pass close to obstacles, with smaller clearances than random ones."""
    found = 0
    while found < count:
        obstacles = random_obstacles(rng, 3)
        checker, field = CoalScene(robot, obstacles), ClearanceField.build(robot, obstacles)
        for _ in range(20):
            start = rng.uniform(robot.lower, robot.upper)
            end = np.clip(start + rng.uniform(-0.5, 0.5, robot.dof), robot.lower, robot.upper)
            near = field.spare_clearance(0.5 * (start + end))
            if -0.05 < near < 0.2 and field.spare_clearance(start) > 0.0:
                found += 1
                yield field, checker, start, end


def test_no_motion_in_contact_is_accepted_and_few_others_refused(robot):
    rng = np.random.default_rng(8)
    margin = 2e-3
    accepted = refused = 0
    for field, checker, start, end in random_motions(robot, rng, 500):
        sampled = dense_clearance(checker, start, end)
        if field.is_clear(np.stack([start, end]), margin):
            accepted += 1
            assert sampled >= 0.5 * margin
        else:
            refused += 1
            # A refused motion comes closer than the margin, at least between the samples.
            assert sampled < margin + bounds_of(field, end - start).max() / 400
    assert min(accepted, refused) > 100


def test_contact_for_a_moment_is_refused(robot):
    """A bead grazed by the tip between free configurations, and one just missed."""
    start, end = np.array([0, 0.3, 0.0, 0.0]), np.array([0, 0.9, 0.0, 0.0])
    for depth, at in itertools.product((1e-4, 1e-2), (0.31, 0.455, 0.6037, 0.88)):
        for gap, clear in ((-depth, False), (depth, True)):
            reach = 2.2 + 0.03 + 0.001 + gap
            bead = Sphere(name="bead", center=(reach * np.cos(at), 0, 0.6 + reach * np.sin(at)), radius=0.001)
            field = ClearanceField.build(robot, [bead])
            assert field.is_clear([start, end], 0.5e-4) is clear
            assert field.is_clear([end, start], 0.5e-4) is clear


@pytest.mark.parametrize("joint", [0, 1, 3])
def test_motion_that_is_not_a_number_is_not_clear(robot, scene, joint):
    path = np.radians([[0.0, 0, 0, 0], [0, 10, 0, 0]])
    path[1, joint] = np.nan
    assert not ClearanceField.build(robot, scene.solids).is_clear(path, 1e-3)


def test_groups_of_solids_change_no_distance(robot, monkeypatch):
    """Groups change no digit of any distance; each contains all its members.

    The depth in several obstacles depends on which of them comes first.
    """
    rng = np.random.default_rng(23)
    for count in (15, 31, 300):
        solids = random_obstacles(rng, 2 * count)
        solids = [solid for solid in solids if not isinstance(solid, Box)]
        solids = [*solids[:count], random_hull(rng, 7), *solids[count:]]
        field = ClearanceField.build(robot, solids)
        with monkeypatch.context() as patched:
            patched.setattr(compiled_obstacles, "_MANY", math.inf)
            alone = ClearanceField.build(robot, solids)
        assert (len(solids) < 32) == (len(field.solids) == len(alone.solids))
        assert sorted(field.owner[field.owner >= 0].tolist()) == alone.owner.tolist()
        for s in np.flatnonzero(field.solids["kind"] == compiled_obstacles.NODE).tolist():
            node, last = field.solids[s], int(field.solids["next"][s])
            below = field.solids[s + 1 : last][field.owner[s + 1 : last] >= 0]
            assert len(below)
            assert (np.linalg.norm(below["centre"] - node["centre"], axis=1) + below["bound"] <= node["bound"]).all()
        kept, q = rng.random(len(solids)) < 0.5, rng.uniform(robot.lower, robot.upper, (60, 4))
        for one, other in (
            (field, alone),
            (field.select(kept), alone.select(kept)),
            (field.ignoring_last_link(kept), alone.ignoring_last_link(kept)),
            (field.select(kept, arm=False), alone.select(kept, arm=False)),
        ):
            np.testing.assert_array_equal(*(np.maximum(found.clearance_along(q), 0.0) for found in (one, other)))


def test_without_idle_pairs_near_ones_stay(variant):
    field = ClearanceField.build(variant, [])
    path = np.random.default_rng(5).uniform(variant.lower, variant.upper, (20, variant.dof))
    movable = np.arange(variant.dof)
    for turn in (1e9, 0.0):
        left = field.without_idle_pairs(path, movable, 0.06, turn)
        for q in path:
            whole, found = np.empty((2, field.count))
            body_clearances(q, field.arrays, 0.06, whole)
            body_clearances(q, left.arrays, 0.06, found)
            shown = whole <= 0.0 if turn == 0.0 else whole < 0.06
            assert np.array_equal(found[shown], whole[shown])
