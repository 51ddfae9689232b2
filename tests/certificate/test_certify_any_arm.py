"""Certificates of general (non-planar) arms against coal; prismatic joints in metres."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from any_arms import ARMS, GANTRY, loaded_arm
from planned import straight

import hplan
from hplan.apps.cli.main import main
from hplan.apps.execution.simulation import read_motion
from hplan.base.arrays import FloatArray
from hplan.certificate import goal_contact
from hplan.certificate.certificate import certify
from hplan.certificate.clearance_proof import point_at, prove_clearance
from hplan.certificate.goal_contact import OFFSET, TURN, contact_window, instant_at
from hplan.certificate.motion_bound import largest_deviations, motion_of_movers
from hplan.collision.coal_scene import CoalScene
from hplan.collision.coal_shapes import solid_shape
from hplan.collision.collision_bodies import body_shapes, collision_bodies
from hplan.collision.motion_coefficients import ON_AXIS, is_moved, joints_between, reach, workspace_ball
from hplan.collision.self_pairs import required_distances, self_pairs
from hplan.errors import InputError, JointLimitError, RobotFileError
from hplan.geometry.cloud import Cloud
from hplan.online.arm_shape import arm_solids
from hplan.robot.model import Robot, load_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Sphere
from hplan.scene.tracks import Track
from hplan.trajectory import read_waypoints
from hplan.trajectory.trajectory import Trajectory


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    return lambda name: loaded_arm(name, tmp_path_factory)


def free_configurations(robot: Robot, count: int, seed: int, clearance: float = 0.01) -> np.ndarray:
    """Random configurations without self-collision."""
    rng, checker = np.random.default_rng(seed), CoalScene(robot, ())
    found: list[np.ndarray] = []
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    while len(found) < count:
        q = rng.uniform(low, high)
        if (checker.pair_distances(q) - checker.required_distance(clearance) > 1e-3).all():
            found.append(q)
    return np.array(found)


def motion_between(robot: Robot, start: np.ndarray, end: np.ndarray, samples: int = 40) -> Trajectory:
    """A rest-to-rest motion, straight in joint space, within all limits but torque."""
    way = end - start
    fastest = max(
        (1.875 * np.abs(way) / robot.velocity_limit).max(),
        np.sqrt((5.8 * np.abs(way) / robot.acceleration_limit).max()),
        1e-2,
    )
    duration = 1.1 * float(fastest)
    motion = straight(robot, start, end, duration, (samples - 1) / duration)
    return replace(motion, torque=np.zeros((samples, robot.dof)))


def scene_of(robot: Robot, trajectory: Trajectory, obstacles, clearance: float) -> Scene:
    first, last = trajectory.position[0], trajectory.position[-1]
    return Scene(name="any", start=Start(joints_rad=tuple(first)), goal=Goal(joints_rad=tuple(last)),
                 obstacles=tuple(obstacles), clearance=clearance)  # fmt: skip


def random_obstacles(rng: np.random.Generator, count: int) -> list:
    """Obstacles around the arm; it may touch some of them."""
    found = []
    for number in range(count):
        direction = rng.normal(size=3)
        centre = direction / np.linalg.norm(direction) * rng.uniform(0.4, 1.2)
        kind = number % 3
        if kind == 0:
            found.append(Sphere(name=f"ball {number}", center=tuple(centre), radius=rng.uniform(0.03, 0.2)))
        elif kind == 1:
            size = tuple(rng.uniform(0.05, 0.4, 3))
            found.append(
                Box(name=f"box {number}", center=tuple(centre), size=size, rpy_deg=tuple(rng.uniform(-90, 90, 3)))
            )
        else:
            end = centre + rng.normal(size=3) * 0.2
            found.append(
                Capsule(name=f"stick {number}", start=tuple(centre), end=tuple(end), radius=rng.uniform(0.01, 0.06))
            )
    return found


def least_distances(robot: Robot, obstacles, bezier: np.ndarray, looks: int) -> tuple[float, float, float]:
    """Minimum distances at many samples of a motion, by coal alone.

    From obstacles; of checked self-pairs with the clearance; of self-pairs that only must not touch.
    """
    shapes, pairs = body_shapes(robot), self_pairs(robot)
    geometry = pin.GeometryModel()
    for shape in (*shapes, *map(solid_shape, obstacles)):
        geometry.addGeometryObject(shape)
    moving = [number for number, shape in enumerate(shapes) if shape.parentJoint > 0]
    for pair in (*itertools.product(moving, range(len(shapes), geometry.ngeoms)), *pairs.checked):
        geometry.addCollisionPair(pin.CollisionPair(*pair))
    arm, data = robot.model.createData(), geometry.createData()
    first, only_touch = len(moving) * len(obstacles), required_distances(pairs.farthest, 1e-3) == 0.0
    from_obstacles = own = closer = np.inf
    for place in np.linspace(0.0, len(bezier), looks):
        pin.computeDistances(robot.model, arm, geometry, data, point_at(bezier, place))
        found = np.array([result.min_distance for result in data.distanceResults])
        from_obstacles = min(from_obstacles, found[:first].min())
        own = min(own, found[first:][~only_touch].min(initial=np.inf))
        closer = min(closer, found[first:][only_touch].min(initial=np.inf))
    return from_obstacles, own, closer


@pytest.mark.parametrize("name", ARMS)
def test_verified_motions_are_clear_at_close_times(load, name):
    """Certified clearances are below the sampled ones; some motions are in contact."""
    robot, rng = load(name), np.random.default_rng(8)
    ends = free_configurations(robot, 6, seed=9)
    outcomes = set()
    for start, end in itertools.pairwise(ends):
        trajectory = motion_between(robot, start, end)
        obstacles = random_obstacles(rng, 5)
        certificate = certify(robot, scene_of(robot, trajectory, obstacles, 0.005), trajectory)
        bezier, _ = trajectory.segments
        around, own, closer = least_distances(robot, obstacles, bezier, 200)
        clear = not [line for line in certificate.violations if "limit" not in line and "deep" not in line]
        if clear:
            assert min(around, own, closer) >= certificate.min_clearance_m - 1e-9
            bounds = [rule.clearance_m for rule in certificate.pair_rules if rule.clearance_m is not None]
            assert certificate.min_clearance_m > min([0.005, *(0.999 * bound for bound in bounds)])
        else:
            assert certificate.min_clearance_m <= min(around, own) + 2e-2
        if min(around, own) <= 0.005 or closer <= 0.0:
            assert not clear
        outcomes.add(clear)
    assert outcomes == {True, False}


def least_by_meshes(checker, pairs, configurations):
    """Minimum distance of some pairs over configurations, by closed meshes where these are farther than their hulls."""
    least, by_hulls = np.inf, np.array([checker.pair_distances(q)[pairs].min() for q in configurations])
    for row in np.argsort(by_hulls).tolist():
        if by_hulls[row] < least:
            checker.place(configurations[row])
            found = checker.distances_of(pairs)
            close = found < least
            found[close] = np.maximum(found[close], checker.mesh_distances(pairs[close]))
            least = min(least, float(found.min()))
    return least


@pytest.mark.parametrize("name", ARMS)
def test_grazing_motions_are_never_verified(load, name):
    """The arm violates a ball's clearance by 0.1 to 5 mm between samples."""
    robot, rng = load(name), np.random.default_rng(10)
    ends = free_configurations(robot, 5, seed=11)
    refused = 0
    for start, end in itertools.pairwise(ends):
        trajectory = motion_between(robot, start, end, samples=12)
        bezier, _ = trajectory.segments
        place = rng.uniform(4.2, 6.8)
        tip = robot.tool_positions(point_at(bezier, place))
        free = scene_of(robot, trajectory, [], 0.0)
        if [line for line in certify(robot, free, trajectory).violations if "comes to" in line]:
            continue
        for nearer in (1e-4, 1e-3, 5e-3):
            direction = rng.normal(size=3)
            radius = 0.05
            centre = tip + direction / np.linalg.norm(direction) * 0.3
            ball = Sphere(name="ball", center=tuple(centre), radius=radius)
            looks = np.linspace(0.0, len(bezier), 1500)
            checker = CoalScene(robot, [ball])
            first = len(checker.pairs) - len(checker.parts.own)
            least = least_by_meshes(checker, np.arange(first), [point_at(bezier, at) for at in looks])
            if not 1e-3 < least < 0.3:
                continue
            scene = scene_of(robot, trajectory, [ball], least + nearer)
            certificate = certify(robot, scene, trajectory)
            assert any("comes to" in line for line in certificate.violations)
            refused += 1
    assert refused >= 4


@pytest.mark.parametrize("name", ARMS)
def test_no_body_travels_farther_than_its_bound(load, name):
    """Points of the bodies along random cubics, also relative to another body."""
    robot, rng = load(name), np.random.default_rng(12)
    checker = CoalScene(robot, [Sphere(name="far", center=(9.0, 0.0, 0.0), radius=0.1)])
    bodies, pairs = collision_bodies(robot), self_pairs(robot)
    far = np.geomspace(1e-3, 0.3, 6).repeat(4)[:, None, None]
    bezier = rng.uniform(robot.lower, robot.upper)[None, None] + rng.normal(size=(24, 4, robot.dof)) * far
    bezier[::2] = bezier[::2, :1] + np.linspace(0.0, 1.0, 4)[:, None] * (bezier[::2, -1:] - bezier[::2, :1])
    bezier = np.clip(bezier, robot.lower, robot.upper)
    mover_of, moved, _ = motion_of_movers(checker, bezier, np.zeros((1, robot.dof)))
    first, second = robot.model.createData(), robot.model.createData()
    moving, matters = np.flatnonzero(is_moved(robot)).tolist(), reach(robot) > ON_AXIS
    used = np.zeros(len(moving))

    def place_both(ends: FloatArray, joints: FloatArray) -> None:
        """Place both models; joints that do not matter stand still."""
        pin.forwardKinematics(robot.model, first, ends[0])
        pin.forwardKinematics(robot.model, second, np.where(joints, ends[1], ends[0]))

    for piece in range(len(bezier)):
        at = rng.uniform(0.0, 0.9) + np.array([0.0, 0.1]) if piece % 2 else np.array([0.0, 1.0])
        part = float(at[1] - at[0])
        ends = np.array([point_at(bezier[piece : piece + 1], float(place)) for place in at])
        for row, number in enumerate(moving):
            body = bodies[number]
            place_both(ends, matters[number])
            places = [data.oMi[body.joint + 1] for data in (first, second)]
            a, b = (body.core @ place.rotation.T + place.translation for place in places)
            went = np.linalg.norm(b - a, axis=1).max()
            assert went <= part * moved[mover_of[row], piece] + 1e-9
            used[row] = max(used[row], went / (part * moved[mover_of[row], piece]))
        for row, (i, j) in enumerate(pairs.checked):
            seen = []
            place_both(ends, np.isin(np.arange(robot.dof), joints_between(robot, bodies[i], bodies[j])))
            for data in (first, second):
                relative = data.oMi[bodies[i].joint + 1].inverse() * data.oMi[bodies[j].joint + 1]
                seen.append(bodies[j].core @ relative.rotation.T + relative.translation)
            went = np.linalg.norm(seen[1] - seen[0], axis=1).max()
            serial = bodies[i].joint < bodies[j].joint
            assert not serial or went <= part * moved[mover_of[len(moving) + row], piece] + 1e-9
    assert used.max() > 0.9


@pytest.mark.parametrize("name", ["panda", "lift"])
def test_common_bound_of_short_segments_bounds_travel(load, name):
    """A smooth motion with samples so close that several segments share one bound."""
    robot, rng = load(name), np.random.default_rng(16)
    checker = CoalScene(robot, [Sphere(name="far", center=(9.0, 0.0, 0.0), radius=0.1)])
    bodies, data = collision_bodies(robot), robot.model.createData()
    moving = [number for number, body in enumerate(bodies) if body.joint >= 0]
    used = 0.0
    for _ in range(4):
        rows, waves = np.linspace(0.0, 0.5, 60)[:, None], rng.uniform(0.5, 6.0, (2, robot.dof))
        middle = rng.uniform(robot.lower, robot.upper)
        position = middle + 0.1 * np.sin(waves[0] * rows + waves[1])
        velocity = 0.1 * waves[0] * np.cos(waves[0] * rows + waves[1]) * (rows[1] - rows[0])
        ends = (position[:-1], velocity[:-1] / 3.0), (position[1:], velocity[1:] / 3.0)
        bezier = np.stack([ends[0][0], ends[0][0] + ends[0][1], ends[1][0] - ends[1][1], ends[1][0]], axis=1)
        mover_of, moved, _ = motion_of_movers(checker, bezier, np.zeros((1, robot.dof)))
        assert (moved[:, 0] == moved[:, 1]).all()  # several have one bound
        travel = np.column_stack([np.zeros(len(moved)), np.cumsum(moved, axis=1)])
        for _ in range(30):
            seen, upto = [], []
            for at in rng.uniform(0.0, len(bezier), 2):
                pin.forwardKinematics(robot.model, data, point_at(bezier, float(at)))
                seen.append([data.oMi[bodies[number].joint + 1].copy() for number in moving])
                upto.append([np.interp(at, np.arange(len(bezier) + 1), travel[mover]) for mover in mover_of])
            allowed = np.abs(np.subtract(*upto))
            for row, (number, first, second) in enumerate(zip(moving, *seen, strict=True)):
                a, b = (bodies[number].core @ place.rotation.T + place.translation for place in (first, second))
                went = np.linalg.norm(b - a, axis=1).max()
                assert went <= allowed[row] + 1e-9
                used = max(used, went / (allowed[row] + 1e-12))
    assert used > 0.9


def test_pairs_that_are_one_mover_count_as_the_farthest_of_them(load, monkeypatch):
    robot, rng = load("panda"), np.random.default_rng(15)
    parts = (checker := CoalScene(robot, [])).parts
    bezier = rng.uniform(robot.lower, robot.upper, (10, 1, robot.dof)) + 0.05 * rng.normal(size=(10, 4, robot.dof))
    alike, deviations = parts.motion_groups, np.full((1, robot.dof), 0.01)
    together = motion_of_movers(checker, bezier, deviations)[1:]
    monkeypatch.setitem(vars(parts), "motion_groups", np.arange(len(alike)))
    alone = motion_of_movers(checker, bezier, deviations)[1:]
    assert alike.max() + 1 < len(alike)
    for of_mover, of_pair in zip(together, alone, strict=True):
        farthest = [of_pair[alike == number].max(axis=0) for number in range(alike.max() + 1)]
        assert of_mover.tolist() == np.array(farthest).tolist()


@pytest.mark.parametrize("name", ["toy", "lift"])
def test_tracking_errors_take_from_the_clearance(load, name):
    robot = load(name)
    start, end = free_configurations(robot, 2, seed=13)
    trajectory = motion_between(robot, start, end)
    tip = robot.tool_positions(trajectory.position).mean(axis=0)
    ball = Sphere(name="ball", center=tuple(tip + np.array([0.0, 0.0, 1.0])), radius=0.1)
    scene = scene_of(robot, trajectory, [ball], 0.0)
    exact = certify(robot, scene, trajectory, tracking_error=0.0)
    loose = certify(robot, scene, trajectory, tracking_error=0.01, tracking_delay_s=0.01)
    assert loose.min_clearance_m < exact.min_clearance_m
    # Configurations with this tracking error keep the certified clearance.
    if not [line for line in loose.violations if "comes to" in line]:
        bezier, _ = trajectory.segments
        checker, rng = CoalScene(robot, [ball]), np.random.default_rng(14)
        for place in np.linspace(0.0, len(bezier), 50):
            off = rng.choice([-1.0, 1.0], robot.dof) * 0.01
            distances = checker.pair_distances(point_at(bezier, float(place)) + off)
            assert distances.min() >= loose.min_clearance_m - 1e-9


def test_clouds_and_static_bodies_are_certified(load):
    robot = load("toy")
    start, end = free_configurations(robot, 2, seed=15)
    trajectory = motion_between(robot, start, end)
    points = np.random.default_rng(16).normal(size=(500, 3))
    cloud = Cloud("leaves", 1.5 * points / np.linalg.norm(points, axis=1)[:, None], 0.02, np.zeros((0, 7)))
    bezier, _ = trajectory.segments
    checker = CoalScene(robot, [cloud])
    proof = prove_clearance(bezier, checker, np.zeros((1, robot.dof)), 0.0)
    first = len(checker.pairs) - len(checker.parts.own)
    seen = min(checker.pair_distances(point_at(bezier, at))[:first].min() for at in np.linspace(0.0, len(bezier), 100))
    assert proof.is_certified == (seen > 0.0)
    pole = Sphere(name="pole", center=(0.0, 0.0, -0.1), radius=0.05)
    certificate = certify(robot, scene_of(robot, trajectory, [pole], 0.0), trajectory)
    assert any("'pole'" in line and "'base_link', which does not move" in line for line in certificate.violations)


def straight_in(robot: Robot, grasp: np.ndarray, length: float, aside: float = 0.0) -> Trajectory:
    """To a grasp along the tool's z axis, turning about it, and back; from a place `aside` of that line."""
    data, frame = robot.model.createData(), robot.model.getFrameId(robot.tool_frame)
    goal = robot.forward_kinematics(grasp)
    q, rows, count = grasp.copy(), [grasp], 60
    for number in range(1, count + 1):
        part = (number / count) ** 2 * (3.0 - 2.0 * number / count)  # slow at both ends
        target = pin.SE3(goal[:3, :3] @ pin.utils.rotate("z", 0.3 * part), goal[:3, 3] - part * length * goal[:3, 2])
        target.translation += part * aside * goal[:3, 0]
        for _ in range(8):
            pin.framesForwardKinematics(robot.model, data, q)
            error = pin.log(data.oMf[frame].inverse() * target).vector
            jacobian = pin.computeFrameJacobian(robot.model, data, q, frame)
            q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-8 * np.eye(6), error)
        rows.append(q)
    position = np.array([*rows[::-1], *rows[1:]])
    time = 0.05 * np.arange(len(position))
    velocity = np.gradient(position, time, axis=0)
    velocity[[0, count, -1]] = 0.0
    zero = np.zeros_like(position)
    return Trajectory(robot.joint_names, time, position, velocity, zero, zero, robot.slides)


@pytest.mark.parametrize("name", ["toy", "panda", "ur5"])
def test_fruit_may_be_touched_on_straight_approach_along_tool_axis(load, name):
    """Within the window, between samples too, all motions keep line and direction.

    Motions from the side have no window.
    """
    robot = load(name)
    grasp = np.array([0.3, -0.6, 0.5, -1.6, 0.2, 1.2, 0.4] if name == "panda" else [0.3, -1.2, 1.4, -0.6, 1.1, 0.4])
    length, found = 0.12, []
    for aside in (0.0, 0.03):
        motion = straight_in(robot, grasp, length, aside)
        bezier, _ = motion.segments
        goal = robot.forward_kinematics(grasp)
        window = contact_window(robot, bezier, goal[:3, 3])
        assert window is not None
        assert window.start <= 60 <= window.stop
        places = np.linspace(window.start, window.stop, 400)
        poses = robot.forward_kinematics(np.array([point_at(bezier, float(place)) for place in places]))
        row, _ = instant_at(robot, np.vstack([bezier[:, 0], bezier[-1:, 3]]), goal[:3, 3])
        there = robot.forward_kinematics(bezier[row, 0])
        away = poses[:, :3, 3] - there[:3, 3]
        behind = np.maximum(-(away @ there[:3, 2]), 0.0)
        assert np.linalg.norm(away + behind[:, None] * there[:3, 2], axis=1).max() <= OFFSET
        assert np.arccos(np.clip(poses[:, :3, 2] @ there[:3, 2], -1.0, 1.0)).max() <= TURN + 1e-6
        found.append(behind.max())
    assert found[0] > 0.9 * length
    assert found[1] < 0.03


@pytest.mark.parametrize("name", ["toy", "panda", "ur5"])
def test_bends_of_the_tool_are_bounded(load, name):
    robot, rng = load(name), np.random.default_rng(19)
    for scale in (0.02, 0.3):
        bezier = rng.uniform(0.5 * robot.lower, 0.5 * robot.upper) + scale * rng.normal(size=(6, 4, robot.dof))
        rates, pushes = goal_contact.largest_rates(bezier)
        bent, turned = goal_contact.tool_bends(robot, rates, pushes)
        for piece in range(len(bezier)):
            places = np.linspace(0.0, 1.0, 401)
            poses = robot.forward_kinematics(
                np.array([point_at(bezier[piece : piece + 1], float(at)) for at in places])
            )
            for values, bound in ((poses[:, :3, 3], bent[piece]), (poses[:, :3, 2], turned[piece])):
                curved = np.linalg.norm(np.diff(values, 2, axis=0), axis=1).max() * 400.0**2
                assert curved <= bound + 1e-6


@pytest.mark.parametrize("name", ["seven", "lift"])
def test_obstacles_that_move(load, name):
    """A ball flies past, or through, a slowly moving arm; against coal."""
    robot, rng = load(name), np.random.default_rng(20)
    start, end = free_configurations(robot, 2, seed=21)
    trajectory = motion_between(robot, start, start + 0.1 * (end - start))
    duration, bezier = trajectory.duration, trajectory.segments[0]
    outcomes = set()
    for _ in range(12):
        middle = robot.tool_positions(trajectory.position[20]) + rng.normal(size=3) * 0.25
        way = rng.normal(size=3) * 0.5
        track = Track(times_s=(0.0, duration), shifts_m=(tuple(-way), tuple(way)))
        ball = Sphere(name="ball", center=tuple(middle), radius=0.05, track=track)
        certificate = certify(robot, scene_of(robot, trajectory, [ball], 0.002), trajectory)
        least = np.inf
        for part in np.linspace(0.0, 1.0, 200):
            there = Sphere(name="ball", center=tuple(middle - way + 2.0 * part * way), radius=0.05)
            checker = CoalScene(robot, [there])
            of_ball = len(checker.pairs) - len(checker.parts.own)
            q = point_at(bezier, float(np.interp(part * duration, trajectory.time, np.arange(trajectory.samples))))
            least = min(least, float(checker.pair_distances(q)[:of_ball].min()))
        clear = not [line for line in certificate.violations if "comes" in line]
        if clear:
            assert least >= certificate.min_clearance_m - 1e-9
        if least <= 0.002:
            assert not clear
        outcomes.add(clear)
    assert outcomes == {True, False}


@pytest.mark.parametrize("name", ["seven", "lift", "panda"])
def test_ball_of_all_bodies_holds_them(load, name):
    robot, rng = load(name), np.random.default_rng(22)
    *centre, radius = workspace_ball(robot)
    for q in rng.uniform(robot.lower, robot.upper, (50, robot.dof)):
        for solid in arm_solids(robot, q):
            away = np.linalg.norm(solid.core - centre, axis=1).max() + solid.rounding
            assert away <= radius + 1e-9
    assert len(arm_solids(robot, q)) == len(collision_bodies(robot))


ROBOT = load_robot(GANTRY)
BEGIN, END = np.array([0.2, 0.3]), np.array([0.7, 0.5])


def motion() -> Trajectory:
    return straight(ROBOT, BEGIN, END, 4.0, 5.0)


def scene(*obstacles: Sphere) -> Scene:
    ends = Start(joints_rad=tuple(BEGIN.tolist())), Goal(joints_rad=tuple(END.tolist()))
    return Scene(name="rail", start=ends[0], goal=ends[1], obstacles=obstacles)


@pytest.mark.parametrize(("far", "clear"), [(0.05, True), (6.0, True), (8.0, False), (1e3, False), (1e300, False)])
@pytest.mark.parametrize("kind", ["at rest", "of velocity"])
def test_trolley_may_deviate_by_tracking_error(kind: str, far: float, clear: bool) -> None:
    """For any kind of joint: more than 2 pi is a full turn of a revolute joint alone."""
    ball = Sphere(name="ball", center=(9.0, 0.0, 1.0), radius=0.1)
    # The fastest sample is at 0.1875 m/s, and its cubic's bound is slightly larger.
    options = {"tracking_error": far} if kind == "at rest" else {"tracking_delay_s": far / 0.19}
    assert certify(ROBOT, scene(ball), motion(), **options).verified == clear


def test_turn_that_is_off_by_more_than_a_whole_one_is_where_it_is() -> None:
    largest = largest_deviations(ROBOT, TrackingModel(1e9), np.zeros((1, 2)))
    assert largest[0].tolist() == pytest.approx([1e6, math.tau])
    assert (largest_deviations(ROBOT, TrackingModel(0.1, 2.0), np.full((1, 2), 0.5)) == 1.1).all()


def test_arm_at_rest_may_be_off_as_far_too() -> None:
    coming = Track(times_s=(0.0, 60.0), shifts_m=((0.0, 0.0, 0.0), (-5.0, 0.0, 0.0)))
    ball = Sphere(name="ball", center=(15.0, 0.0, 1.0), radius=0.1, track=coming)
    assert certify(ROBOT, scene(ball), motion(), tracking_error=6.0).clear_until_s == math.inf
    found = certify(ROBOT, scene(ball), motion(), tracking_error=10.0)
    assert found.verified
    assert 4.0 < found.clear_until_s < 60.0


def test_position_beyond_rail_is_reported_in_metres() -> None:
    with pytest.raises(JointLimitError, match=r"'rail' is at 2.5 m, outside its limits \[-2, 2\] m"):
        ROBOT.check_configuration([2.5, 0.0], "start")
    with pytest.raises(JointLimitError, match=r"'boom' is at 2.5 rad, outside its limits \[-2, 2\] rad"):
        ROBOT.check_configuration([0.0, 2.5], "start")
    with pytest.raises(JointLimitError, match=r"hold: joint 'rail' is at 2.5 m"):
        load_robot(GANTRY, hold={"rail": 2.5})


def test_degrees_of_prismatic_joints_are_refused() -> None:
    ends = Start(joints_rad=(0.2, 0.3)), Goal(joints_rad=(0.7, 0.5))
    degrees = {"start": Start(joints_deg=(0.2, 17.0))}, {"goal": Goal(joints_deg=(0.7, 28.0))}
    for given in degrees:
        asked = Scene(name="rail", **{"start": ends[0], "goal": ends[1], **given})
        which = next(iter(given))
        for call in (lambda asked=asked: hplan.plan(ROBOT, asked), lambda asked=asked: certify(ROBOT, asked, motion())):
            with pytest.raises(
                InputError, match=f"{which}: joints_deg, but joint 'rail' is prismatic; give joints_rad"
            ):
                call()


def test_columns_of_prismatic_joints_are_in_metres(tmp_path: Path) -> None:
    found = hplan.plan(ROBOT, scene()).trajectory
    path = hplan.write_csv(found, tmp_path / "motion.csv")
    header = path.read_text().splitlines()[0]
    rail, boom = "rail_pos_m,rail_vel_m_s,rail_acc_m_s2,rail_force_n", "boom_pos_rad,boom_vel_rad_s,boom_acc_rad_s2"
    assert header == f"time_s,{rail},{boom},boom_torque_nm"
    again = hplan.read_csv(path)
    assert again.slides == found.slides == again.cut_after(3).cut_before(1).reversal.slides == (True, False)
    assert certify(ROBOT, scene(), again).digests == certify(ROBOT, scene(), found).digests
    np.testing.assert_array_equal(read_motion(path).position, found.position)
    np.testing.assert_array_equal(read_waypoints(path, ROBOT.joint_names, ROBOT.slides), found.position)


def test_radians_of_prismatic_joints_are_refused(tmp_path: Path) -> None:
    path = hplan.write_csv(hplan.plan(ROBOT, scene()).trajectory, tmp_path / "motion.csv")
    as_before = tmp_path / "before.csv"
    as_before.write_text(
        path.read_text().replace("rail_pos_m,rail_vel_m_s,rail_acc_m_s2,rail_force_n",
                                 "rail_pos_rad,rail_vel_rad_s,rail_acc_rad_s2,rail_torque_nm")
    )  # fmt: skip
    with pytest.raises(InputError, match="'rail' slides, but the motion has it in radians; its columns are rail_pos_m"):
        certify(ROBOT, scene(), hplan.read_csv(as_before))
    with pytest.raises(InputError, match="joint 'rail' has no column; expected rail_pos_m or rail"):
        read_waypoints(as_before, ROBOT.joint_names, ROBOT.slides)


def test_limits_of_prismatic_joints_are_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "a.limits.yaml"
    for text, names in (
        ("acceleration_rad_s2: {boom: 4}\nacceleration_m_s2: {rail: 3}", None),
        ("acceleration_rad_s2: {rail: 3, boom: 4}", None),
        (
            "acceleration_rad_s2: {rail: 3, boom: 4}\nacceleration_m_s2: {rail: 3}",
            "'rail' is also in acceleration_rad_s2",
        ),
        ("acceleration_rad_s2: {boom: 4}", r"joints missing \['rail'\]"),
        (
            "acceleration_m_s2: {rail: 3, boom: 4}",
            "acceleration_m_s2: joint 'boom' is revolute; .* acceleration_rad_s2",
        ),
        ("jerk_m_s3: {rail: 3}", "acceleration_rad_s2 is missing"),
    ):
        path.write_text(f"format: hplan-limits/1\n{text}\n")
        if names is None:
            assert load_robot(GANTRY, limits=path).acceleration_limit.tolist() == [3.0, 4.0]
        else:
            with pytest.raises(RobotFileError, match=names):
                load_robot(GANTRY, limits=path)


def test_trajectory_without_units_of_prismatic_joints_is_refused() -> None:
    with pytest.raises(InputError, match="'rail' is prismatic: give Trajectory"):
        certify(ROBOT, scene(), replace(motion(), slides=()))


def test_trajectory_made_by_hand_is_written_in_the_robots_units(tmp_path: Path) -> None:
    by_hand = replace(motion(), slides=())
    path = hplan.write_csv(by_hand, tmp_path / "motion.csv", ROBOT)
    assert path.read_text().startswith("time_s,rail_pos_m,")
    assert by_hand.stop_at(1.0, ROBOT).slides == (True, False)
    with pytest.raises(InputError, match="'rail' slides, but the motion has it in radians"):
        hplan.write_csv(replace(motion(), slides=(False, False)), path, ROBOT)


def test_degrees_alone_are_no_tracking_error_of_prismatic_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf, ends = tmp_path / "gantry.urdf", tmp_path / "scene.yaml"
    urdf.write_text(GANTRY)
    hplan.save_scene(scene(Sphere(name="ball", center=(9.0, 0.0, 1.0), radius=0.1)), ends)
    path = hplan.write_csv(motion(), tmp_path / "motion.csv", ROBOT)
    given = ["certify", str(path), str(ends), "--robot", str(urdf)]
    for options, says in (
        (
            ["--tracking-error", "0.5"],
            "--tracking-error-m = None: expected a length in metres: joint 'rail' is prismatic",
        ),
        (
            ["--tracking-error-m", "0.01"],
            "--tracking-error = None: expected an angle in degrees: joint 'boom' is revolute",
        ),
    ):
        assert main([*given, *options]) == 2
        assert says in " ".join(capsys.readouterr().err.split())
    assert main([*given, "--tracking-error", "0.5", "--tracking-error-m", "0.01"]) == 0
    assert "tracking error 0.573 deg, 10 mm for prismatic joints" in " ".join(capsys.readouterr().out.split())
