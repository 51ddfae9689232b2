"""Parts of an arm that can touch: C-space, distances, checker and certificate against coal."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from arm_variants import coal_distances, from_obstacles, link_axes
from fitted_arms import fitted, quintic, scene_of
from segments import segment_distances
from studies.planar_cspace import arm_sections, joint_grid

from hplan.certificate.certificate import certify
from hplan.certificate.motion_bound import motion_of_movers
from hplan.collision.coal_scene import CoalScene
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.self_pairs import required_distances, self_pairs
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.grid.occupancy import occupancy
from hplan.planar.self_contact import radius_in_plane, self_contact
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot
from hplan.scene.obstacles import Sphere

#: Maximum protrusion of the section of a body that carries the arm [m].
STANDS_OUT = 2.5e-3

#: Where signed distances are this near to zero, either side may call it contact [m].
TOUCH = 1e-6


def arm_of(folder, low, high, *, has_yaw=True, height=0.6, **more) -> Robot:
    """A member of the family whose planar joints turn from `low` to `high` [deg], each alike or one by one."""
    yaw_deg = 180.0 if has_yaw else None
    return fitted(folder, low=low, high=high, yaw_deg=yaw_deg, name="wide", shoulder_height=height, **more)


@pytest.fixture(scope="module")
def wide(tmp_path_factory) -> Robot:
    """The harvester, its planar joints free to turn by 150 deg either way."""
    return arm_of(tmp_path_factory.mktemp("arm"), -150.0, 150.0)


class Truth:
    """Distances by coal without hplan: capsule links, and the bodies of the URDF that carry the arm."""

    def __init__(self, robot: Robot) -> None:
        self.robot, self.data = robot, robot.model.createData()
        self.links = [
            coal.Capsule(float(w), float(length))
            for w, length in zip(family_of(robot).arm.half_widths, family_of(robot).arm.lengths, strict=True)
        ]
        self.moving = 2 if family_of(robot).has_yaw else 1
        shapes = enumerate(robot.collision_model.geometryObjects)
        self.base = {str(number): g for number, g in shapes if g.parentJoint < self.moving}

    def distances(self, q):
        """By (link, other): numbers of links, or of a shape of the base as a text, without adjacent parts."""
        robot, data = self.robot, self.data
        pin.forwardKinematics(robot.model, data, np.asarray(q, dtype=float))
        axes = link_axes(robot, q)
        placed = []
        for a, b in axes:
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (b - a) / np.linalg.norm(b - a))
            placed.append(coal.Transform3s(turn.toRotationMatrix(), 0.5 * (a + b)))
        found = {}
        for j, i in itertools.combinations(range(len(self.links)), 2):
            if i - j >= 2:
                found[i, j] = self._distance(self.links[i], placed[i], self.links[j], placed[j])
        for number, shape in self.base.items():
            at = data.oMi[shape.parentJoint] * shape.placement
            at = coal.Transform3s(at.rotation, at.translation)
            shoulder = (
                coal.Sphere(float(family_of(robot).arm.half_widths[0])),
                coal.Transform3s(np.eye(3), axes[0, 0]),
            )
            carries = self._distance(*shoulder, shape.geometry, at) <= 0.0
            for link in range(1 if carries else 0, len(self.links)):
                found[link, number] = self._distance(self.links[link], placed[link], shape.geometry, at)
        return found

    def clearance(self, q):
        return min(self.distances(q).values())

    @staticmethod
    def _distance(*pair):
        return coal.distance(*pair, coal.DistanceRequest(), coal.DistanceResult())


def random_arms(rng, folder, count):
    """Arms of two to four links whose joints may turn far, or not so far; half of them with offsets."""
    aside = np.random.default_rng(count)
    for number in range(count):
        links = int(rng.integers(2, 5))
        low, high = -rng.uniform(0.0, 160.0, links), rng.uniform(20.0, 160.0, links)
        lengths = tuple(rng.uniform(0.25, 1.0, links).round(3).tolist())
        widths = tuple(np.sort(rng.uniform(0.02, 0.07, links))[::-1].round(3).tolist())
        has_yaw, height = bool(rng.random() < 0.7), round(float(rng.uniform(0.3, 1.2)), 3)
        offsets = {}
        if number % 2:
            place, side, *beside = aside.uniform(-1.0, 1.0, (links + 2, 2)).round(3)
            offsets = {"yaw_axis": (0.4 * place).tolist(), "shoulder_offset": 0.3 * side[0]}
            offsets["link_offsets"] = [0.08 * each[0] if each[1] > -0.2 else 0.0 for each in beside]
        yield arm_of(folder, low, high, lengths=lengths, widths=widths, has_yaw=has_yaw, height=height, **offsets)


def key_of(robot, one, other):
    """The key of two of the robot's bodies in `Truth.distances`; None for parts of bodies, and for two of the base."""
    keys = []
    for body in sorted((one, other), key=lambda body: -body.joint):
        is_link = body.name in family_of(robot).arm.link_names
        keys.append(family_of(robot).arm.link_names.index(body.name) if is_link else str(body.shapes[0]))
    return None if isinstance(keys[0], str) or not (one.shapes and other.shapes) else tuple(keys)


def named_pairs(robot):
    contact = self_contact(robot)
    links = {(j, i) for i, j in contact.links}
    bodies = {(k, str(body.number)) for body in contact.bodies for k in body.links}
    return links | bodies


# Which pairs can touch


def test_harvester_cannot_touch_itself(robot, scene):
    contact = self_contact(robot)
    assert contact.links == contact.bodies == ()
    sections = arm_sections(robot, scene.solids)
    assert len(sections.own_pairs) == sections.own_names == 0
    assert sections.obstacle_names == tuple(solid.name for solid in scene.solids)


def test_pairs_are_those_that_sampling_finds(tmp_path):
    rng = np.random.default_rng(0)
    seen, apart = 0, 0
    for robot in random_arms(rng, tmp_path, 12):
        truth, known = Truth(robot), named_pairs(robot)
        least = {}
        for q in rng.uniform(robot.lower, robot.upper, (300, robot.dof)):
            for pair, distance in truth.distances(q).items():
                least[pair] = min(distance, least.get(pair, np.inf))
        touching = {pair for pair, distance in least.items() if distance < 0.0}
        assert touching <= known
        assert all(least[pair] < 0.3 for pair in known)  # 300 looks come near at least
        seen += len(touching)
        apart += len(least) - len(known)
    assert seen > 15
    assert apart > 5


# C-space


def test_cspace_against_coal(tmp_path):
    rng = np.random.default_rng(5)
    contacts = 0
    for robot in random_arms(rng, tmp_path, 8):
        step = math.radians({2: 6.0, 3: 15.0, 4: 16.0}[family_of(robot).arm.link_count])
        grid = joint_grid(family_of(robot).arm, step)
        ours = {
            clearance: occupancy(
                family_of(robot).arm, arm_sections(robot, [], clearance=clearance), grid
            ).occupied_mask.ravel()
            for clearance in (0.0, 0.02)
        }
        truth, yaw, known = Truth(robot), rng.uniform(-3.0, 3.0), named_pairs(robot)
        some = rng.permutation(grid.size)[:2000]
        for number, node in zip(some, nodes_of(grid)[some], strict=True):
            found = truth.distances([yaw, *node] if family_of(robot).has_yaw else node)
            distance = min((d for pair, d in found.items() if pair in known), default=np.inf)
            for clearance, occupied in ours.items():
                if distance - clearance < -TOUCH:
                    assert occupied[number]
                    contacts += 1
                elif distance - clearance > STANDS_OUT:
                    assert not occupied[number]
    assert contacts > 200


def nodes_of(grid):
    return grid.coordinates(np.stack(np.unravel_index(np.arange(grid.size), grid.shape), axis=-1))


@pytest.mark.parametrize("lengths", [(0.5, 0.6, 0.6, 0.4), (0.9, 0.5, 0.5, 0.3), (0.4, 0.8, 0.7, 0.9)])
def test_four_links_in_the_cspace_are_exact(tmp_path, lengths):
    """Every pair, tips along the axis of another link among them: where bounding discs are as large as they must be."""
    robot = arm_of(
        tmp_path, [0.0] + [-150.0] * 3, [10.0] + [150.0] * 3, lengths=lengths, widths=(0.05, 0.05, 0.05, 0.05)
    )
    arm = family_of(robot).arm
    grid = Grid.from_limits(arm.lower, arm.upper, np.radians([10.0, 6.0, 6.0, 6.0]))
    sections = arm_sections(robot, [])
    pairs = {(int(link), int(other)) for link, other, _ in sections.own_pairs}
    assert pairs == {(2, 0), (3, 0), (3, 1)}
    empty = replace(sections, own_pairs=sections.own_pairs[:0], own_radii=sections.own_radii[:0])
    alone = occupancy(arm, empty, grid).occupied_mask  # the base
    points = arm.joint_points(nodes_of(grid))
    for number, (link, other) in enumerate(sections.own_pairs[:, :2].tolist()):
        one = replace(
            sections,
            own_pairs=sections.own_pairs[number : number + 1],
            own_radii=sections.own_radii[number : number + 1],
        )
        ours = occupancy(arm, one, grid).occupied_mask & ~alone
        distances = segment_distances(points[:, link], points[:, link + 1], points[:, other], points[:, other + 1])
        apart = (distances - sections.own_radii[number]).reshape(grid.shape)
        sure = (np.abs(apart) > TOUCH) & ~alone
        np.testing.assert_array_equal(ours[sure], apart[sure] < 0.0)
        assert (apart[sure] < 0.0).any()


# Distances


def own_clearances(robot, field, truth, q, found):
    """Distances of the arm's own pairs as coal has them, and as they were found."""
    bodies, pairs = collision_bodies(robot), self_pairs(robot)
    distances, first = truth.distances(q), len(field.arm.bodies)
    keys = [key_of(robot, bodies[i], bodies[j]) for i, j in pairs.checked]
    known = np.array([key in distances for key in keys], dtype=bool)
    expected = np.array([distances[key] for key in keys if key in distances])
    required = required_distances(pairs.farthest, 0.01)[known]
    return expected - required, found[first : first + len(keys)][known]


def test_distances_from_bodies_that_carry_the_arm(tmp_path):
    rng = np.random.default_rng(12)
    near = 0
    for robot in random_arms(rng, tmp_path, 12):
        field, truth = ClearanceField.build(robot, [], own_clearance=0.01), Truth(robot)
        for q in rng.uniform(robot.lower, robot.upper, (100, robot.dof)):
            lower, found = own_clearances(robot, field, truth, q, field.link_clearances(q, 100.0))
            # Nothing nearer than coal says is missed, and little is made up.
            apart = lower > 0.0
            assert (found[apart] <= lower[apart] + TOUCH).all()
            assert (found[apart] >= lower[apart] - STANDS_OUT).all()
            assert (found[~apart] <= TOUCH).all()
            near += int((lower < 0.05).sum())
    assert near > 100


def test_certified_clearances_are_clear(wide):
    rng = np.random.default_rng(13)
    field, truth = ClearanceField.build(wide, []), Truth(wide)
    shown = refused = 0
    for start in rng.uniform(wide.lower, wide.upper, (150, 4)):
        end = np.clip(start + rng.uniform(-1.2, 1.2, 4), wide.lower, wide.upper)
        least = min(truth.clearance(start + t * (end - start)) for t in np.linspace(0.0, 1.0, 60))
        if field.is_clear([start, end], 1e-3):
            assert least > 0.0
            shown += 1
        else:
            assert least < 5e-3
            refused += 1
    assert shown > 30
    assert refused > 30


# Judge


def test_judge_against_coal(tmp_path):
    rng = np.random.default_rng(21)
    contacts = 0
    for robot in random_arms(rng, tmp_path, 10):
        obstacles = [Sphere(name="turret", center=(2.0, 0.5, 1.0), radius=0.2)]  # a name that the arm has too
        checker = CoalScene(robot, obstacles)
        truth, own = Truth(robot), checker.parts.own
        assert checker.own_first == 1
        configurations = rng.uniform(robot.lower, robot.upper, (40, robot.dof))
        for q, touching in zip(configurations, checker.in_collision(configurations), strict=True):
            rows = [checker.link_names.index(name) for name in family_of(robot).arm.link_names]
            expected = coal_distances(robot, q, obstacles)[:, 0]
            np.testing.assert_allclose(
                from_obstacles(checker, q)[rows, 0].clip(min=0.0), expected.clip(min=0.0), atol=1e-5
            )
            table, distances = checker.pair_distances(q), truth.distances(q)
            for pair, found in zip(own, table[len(table) - len(own) :], strict=True):
                true = distances.get(key_of(robot, *pair.bodies))
                if true is not None:
                    # Depths are coal's by iteration, and depend on who comes first.
                    assert found == pytest.approx(true, abs=1e-5 if true > 0.0 else 1e-3)
                    contacts += int(found < 0.0)
            assert touching == (table.min() <= 0.0) or abs(table.min()) < 1e-5
            nearest = checker.nearest_contact(q)
            assert nearest.distance_m == pytest.approx(table.min(), abs=1e-5 if table.min() > 0.0 else 1e-3)
    assert contacts > 20


# Bounds on motion, as seen from another part


@pytest.mark.parametrize(
    ("has_yaw", "offsets"),
    [
        (True, {}),
        (False, {}),
        (True, {"yaw_axis": (1.0, -0.5), "shoulder_offset": 0.4, "link_offsets": (0.3, 0.0, -0.1, 0.0)}),
    ],
)
def test_bounds_contain_motion_of_points(tmp_path, has_yaw, offsets):
    """Ends of links' axes, and of a pair's axes beyond a joint, as seen from the other part of the pair."""
    lengths = (0.6, 0.5, 0.4, 0.3)
    robot = arm_of(tmp_path, -150, 150, lengths=lengths, widths=(0.04,) * 4, has_yaw=has_yaw, height=0.4, **offsets)
    rng, checker, data = np.random.default_rng(31), CoalScene(robot, []), robot.model.createData()
    parts, seen_joints = checker.parts, set()
    both, counts = parts.movers
    assert len(parts.own) >= 3

    def ends(q, first, second):
        pin.forwardKinematics(robot.model, data, q)
        place = data.oMi[parts.bodies[first].joint + 1]
        if second >= 0:
            place = data.oMi[parts.bodies[second].joint + 1].inverse() * place
        return parts.bodies[first].core @ place.rotation.T + place.translation

    for _ in range(60):
        start, turn = rng.uniform(-1.0, 1.0, (2, robot.dof))
        bezier = start + np.linspace(0.0, 1.0, 4)[None, :, None] * turn
        _, moved, sways = motion_of_movers(checker, bezier, np.abs(turn)[None])
        for number, (first, second), matters in zip(parts.motion_groups, both.tolist(), counts, strict=True):
            # A joint about whose axis one of the two is round does not change their distance.
            end = start + turn * matters
            went = np.linalg.norm(ends(end, first, second) - ends(start, first, second), axis=1).max()
            assert went <= moved[number, 0] + 1e-9
            assert moved[number, 0] <= sways[number, 0] + 1e-9
            seen_joints.add(parts.bodies[second].joint if second >= 0 else None)
    assert len(seen_joints) > 2


# Certificate


def clearance_is_shown(certificate):
    return not any("comes to" in violation for violation in certificate.violations)


def test_certificates_agree_with_dense_sampling(tmp_path):
    rng = np.random.default_rng(41)
    shown = refused = 0
    for robot in random_arms(rng, tmp_path, 14):
        truth, known = Truth(robot), named_pairs(robot)
        if not known:
            continue
        scene = scene_of((0.0,) * 4)
        for start in rng.uniform(robot.lower, robot.upper, (5, robot.dof)):
            end = rng.uniform(robot.lower, robot.upper)
            trajectory = quintic(robot, np.degrees(start), np.degrees(end), count=401)
            least = min(
                distance
                for q in trajectory.position[::8]
                for pair, distance in truth.distances(q).items()
                if pair in known
            )
            certificate, checker = certify(robot, scene, trajectory, check_ends=False), CoalScene(robot, [])
            least = min(least, *(checker.pair_distances(q).min() for q in trajectory.position[::8]))
            if clearance_is_shown(certificate):
                assert least >= certificate.min_clearance_m > 0.0
                shown += 1
            else:
                assert least < 1e-3
                assert certificate.min_clearance_m <= least + 1e-9 or certificate.min_clearance_m < 1e-4
                refused += 1
    assert shown > 15
    assert refused > 15


def test_fold_is_refused_and_named(wide):
    rest = (0.0,) * 4
    certificate = certify(wide, scene_of(rest), quintic(wide, rest, (0.0, 60.0, 150.0, 120.0)), check_ends=False)
    assert not certificate.verified
    (violation,) = [violation for violation in certificate.violations if "comes to" in violation]
    assert "link 'hand' comes to" in violation
    assert "of link 'upper_arm'" in violation
    assert (certificate.nearest.link, certificate.nearest.obstacle) == ("hand", "upper_arm")
    # A smaller fold is certified; the yaw takes nothing from the clearance of links, the tracking error does.
    nearly = np.radians([90.0, 0.0, 120.0, 100.0])
    spare = Truth(wide).distances(nearly)[2, 0]
    assert 0.02 < spare < 0.5
    for clearance, tracking_error, expected in ((0.0, 0.0, True), (spare + 1e-3, 0.0, False), (0.0, 0.2, False)):
        scene, motion = scene_of(rest, clearance=clearance), quintic(wide, rest, np.degrees(nearly))
        certificate = certify(wide, scene, motion, tracking_error=tracking_error, check_ends=False)
        assert clearance_is_shown(certificate) == expected


# Planning


@pytest.mark.parametrize("locked", [("base_yaw",), ()])
@pytest.mark.parametrize(
    ("start", "goal"),
    [
        ((-34.0, -33.0, -101.0, 106.0), (-34.0, 5.0, -109.0, -124.0)),
        ((96.0, 125.0, 108.0, 137.0), (96.0, 12.0, 148.0, 61.0)),
    ],
)
def test_arm_goes_around_itself(tmp_path, start, goal, locked):
    robot = arm_of(tmp_path, [-60, -160, -160], [150, 160, 160], lengths=(0.7, 0.6, 0.5))
    truth = Truth(robot)
    assert min(truth.clearance(q) for q in np.linspace(np.radians(start), np.radians(goal), 100)) < -0.01
    result = plan(robot, scene_of(start, goal, locked_joints=locked), PlanOptions(step_deg=5.0))
    assert result.certificate.verified
    assert min(truth.clearance(q) for q in result.trajectory.position[::5]) >= result.certificate.min_clearance_m > 0.0


@pytest.mark.parametrize(("aside", "left"), [(0.0, 0.05), (0.03, 0.04), (-0.04, 0.03), (0.05, 0.0), (0.06, 0.0)])
def test_displaced_links_are_near_only_within_ball_radius(aside, left):
    assert radius_in_plane(0.05, aside) == pytest.approx(left, abs=1e-12)
