"""Frames of a depth camera against NumPy and coal."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from arm_variants import link_axes, random_obstacles
from hypothesis import given, settings
from hypothesis import strategies as st

from hplan.collision.coal_cloud import distance_from
from hplan.collision.compiled_obstacles import solid_rows
from hplan.collision.motion_coefficients import tight_reach_ball
from hplan.errors import InputError
from hplan.geometry.cloud import Cloud
from hplan.geometry.hull import hull_of
from hplan.geometry.rotation import rpy_rotation
from hplan.online.arm_shape import arm_solids
from hplan.online.body_distances import distance_from_bodies, distances_from_bodies
from hplan.online.frame import CloudOptions, Frame, filter_frame
from hplan.online.frame_kernels import Scratch
from hplan.planar.family_reader import family_of
from hplan.robot.model import load_robot
from hplan.scene.obstacles import Sphere

RADIUS = 0.005
TUCKED = np.radians([20.0, 90.0, 90.0, 90.0])


def cloud_about_the_arm(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in and around the arm's reach, dense in places; some are not finite."""
    blobs = rng.uniform(-1.5, 1.5, (8, 3)) + np.array([0.0, 0.0, 0.6])
    points = blobs[rng.integers(0, 8, count)] + rng.normal(size=(count, 3)) * 0.02
    points[::3] = rng.uniform(-3.0, 3.0, (len(points[::3]), 3))
    points[1::9] = rng.uniform(-0.3, 0.3, (len(points[1::9]), 3)) + np.array([0.0, 0.0, 0.7])  # the tucked arm
    points[5::50] = rng.choice([np.nan, np.inf, -np.inf], (len(points[5::50]), 3))
    return points


def apart(points: np.ndarray, solids) -> np.ndarray:
    """(n,) distances of points from the nearest solid, by coal."""
    bead, found = coal.Sphere(1e-3), np.full(len(points), np.inf)
    for solid in solids:
        distance = distance_from(solid)
        away = [distance(bead, pin.SE3(np.eye(3), point)) for point in points]
        found = np.minimum(found, np.array(away) + 1e-3)
    return found


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([np.float32, np.float64]), st.sampled_from([2e-3, 5e-3, 0.03]))
def test_every_point_is_accounted_for(robot, seed, kind, growth_m):
    rng = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rpy_rotation(*rng.uniform(-2, 2, 3)), rng.uniform(-0.5, 0.5, 3)
    wanted = cloud_about_the_arm(rng, 600)
    with np.errstate(invalid="ignore"):
        seen = ((wanted - pose[:3, 3]) @ pose[:3, :3]).astype(kind)
        seen[rng.random(600) < 0.05] = 0.0  # pixels without a return
        seen[rng.random(600) < 0.05] *= 1e3
        world = seen.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    options = CloudOptions(growth_m=growth_m)
    fruit = Sphere(name="fruit", center=(0.2, 0.1, 0.9), radius=0.1)
    frame = Frame.validate(robot, seen, radius=RADIUS, pose=pose, joints=TUCKED)
    found = filter_frame(robot, frame, options, ignored=[fruit], clearance_m=0.01)
    report = found.report

    empty = (seen == 0.0).all(axis=1)
    finite = np.isfinite(seen).all(axis=1) & ~empty
    x, y, z, radius = tight_reach_ball(robot)
    near = np.linalg.norm(world - [x, y, z], axis=1) <= radius + RADIUS + growth_m + 0.1 + 0.01
    arm, ignored = (distances_from_bodies(np.nan_to_num(world, posinf=9.0, neginf=9.0), *solid_rows(s, p))
                    for s, p in ((arm_solids(robot, TUCKED), 0.03), ([fruit], 0.02)))  # fmt: skip
    in_arm, in_fruit = arm <= 0.0, ignored <= 0.0
    assert report.given == 600
    assert report.not_finite == (~finite & ~empty).sum()
    assert report.no_return == empty.sum() > 0
    assert report.out_of_reach == (finite & ~near).sum()
    with np.errstate(over="ignore"):
        ranges = np.sqrt((seen.astype(np.float64) ** 2).sum(axis=1))
    assert report.far == (finite & ~near & (ranges > 100.0)).sum()
    assert report.of_arm == (finite & near & in_arm).sum()
    assert report.ignored == (finite & near & ~in_arm & in_fruit).sum()
    stays = world[finite & near & ~in_arm & ~in_fruit]
    gaps = np.linalg.norm(stays[:, None] - found.points, axis=2)
    # Every kept point is in a ball, and the growth is the maximum required.
    cells = np.floor((stays - [x, y, z]) / (2.0 * growth_m / np.sqrt(3.0)))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    boxes = [stays[cell.ravel() == number] for number in range(len(first))]
    middles = np.array([0.5 * (box.min(axis=0) + box.max(axis=0)) for box in boxes])
    assert sorted(map(tuple, found.points.round(9))) == sorted(map(tuple, middles.round(9)))
    needed = max(np.linalg.norm(box - middle, axis=1).max() for box, middle in zip(boxes, middles, strict=True))
    assert report.growth_m == pytest.approx(needed, abs=1e-12)
    assert report.growth_m <= growth_m + 1e-12
    assert gaps.min(axis=1).max() <= report.growth_m + 1e-12
    assert report.kept == len(found.points) == len(first)
    assert report.radius_m == RADIUS + report.growth_m


def test_nothing_farther_from_the_arm_than_the_padding_is_taken_away(robot):
    rng = np.random.default_rng(4)
    for _ in range(4):
        q = rng.uniform(robot.lower, robot.upper)
        solids = arm_solids(robot, q)
        on = np.concatenate([solid.core[rng.integers(0, len(solid.core), 60)] for solid in solids])
        points = on + rng.normal(size=on.shape) * 0.06
        options = CloudOptions(growth_m=1e-3, arm_padding_m=0.03)
        found = filter_frame(robot, Frame.validate(robot, points, radius=RADIUS, joints=q), options)
        away = apart(points, solids)
        assert found.report.of_arm <= (away <= 0.03 + 1e-6).sum()
        assert found.report.of_arm >= (away <= 0.03 - 1e-6).sum() > 50
        assert found.report.of_arm + found.report.kept <= len(points)
        assert apart(found.points, solids).min() > 0.03 - 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_distances_of_points_from_solids_of_all_kinds(seed):
    rng = np.random.default_rng(seed)
    cloud = Cloud.from_points("cloud", rng.uniform([0.4, -0.6, 0.5], [1.8, 0.6, 1.7], (90, 3)), 0.02)
    points = rng.uniform([-0.2, -1.2, 0.0], [2.2, 1.2, 2.2], (150, 3))
    hull = hull_of(rng.normal(size=(12, 3)) * 0.3 + [1.0, 0.0, 1.1], "hull")
    for solids in ([cloud], [hull], random_obstacles(rng, 6), [*random_obstacles(rng, 6), hull, cloud]):
        expected, found = apart(points, solids), distances_from_bodies(points, *solid_rows(solids, 0.0))
        outside = expected > 1e-5
        np.testing.assert_allclose(found[outside], expected[outside], atol=3e-6)
        assert (found[~outside] <= 2e-5).all()
    assert (distances_from_bodies(points, *solid_rows([], 0.0)) == np.inf).all()


def test_distance_up_to_limit_is_exact_or_missing():
    rng = np.random.default_rng(0)
    solids = [hull_of(rng.normal(size=(12, 3)) * 0.3 + [1.0, 0.0, 1.1], "hull"), *random_obstacles(rng, 4)]
    rows, data = solid_rows(solids, 0.03)
    points = np.concatenate([solid.core for solid in solids])
    points = points[rng.integers(0, len(points), 5000)] + rng.normal(0.0, 0.05, (5000, 3))
    expected = distances_from_bodies(points, rows, data)
    assert ((expected > 0.0) & (expected < 0.01)).sum() > 100
    for limit in (0.0, 0.05):
        found = np.array([distance_from_bodies(tuple(point), rows, data, limit) for point in points])
        np.testing.assert_allclose(found, np.where(expected <= limit, expected, np.inf), atol=1e-12)


def test_arm_is_in_its_reach_ball(robot):
    rng = np.random.default_rng(1)
    *centre, radius = tight_reach_ball(robot)
    for q in rng.uniform(robot.lower, robot.upper, (50, robot.dof)):
        solids = arm_solids(robot, q)
        far = max(np.linalg.norm(solid.core - centre, axis=1).max() + solid.rounding for solid in solids)
        assert far <= radius + 1e-3  # prisms protrude from the cylinders
        assert apart(robot.tool_positions(q)[None], solids)[0] <= 0.0
    assert radius < 2.3


def _with_thin_upper_arm(folder):
    """The harvester, its upper arm a bar of 10 mm between two balls of 50."""
    text = load_robot().urdf_path.read_text()
    bar = '<cylinder radius="0.05" length="1"/>'
    assert text.count(bar) == 1
    (folder / "thin.urdf").write_text(text.replace(bar, bar.replace("0.05", "0.01")))
    return load_robot(folder / "thin.urdf", limits="harvester")


@pytest.mark.parametrize(("make", "link", "off_m"), [
    (lambda folder: load_robot("orchard_harvester"), 2, 0.033), (_with_thin_upper_arm, 0, 0.03),
], ids=["hand thinner than the gripper", "bar between balls"])  # fmt: skip
def test_points_next_to_link_are_kept_though_inside_its_capsule(make, link, off_m, tmp_path):
    robot = make(tmp_path)
    q = np.array([0.3, 0.4, 0.5, 0.6])
    axis = link_axes(robot, q)[link]
    along = axis[1] - axis[0]
    beside = np.cross(along, [0.3, 0.5, 0.8])
    point = axis[0] + 0.3 * along + off_m * beside / np.linalg.norm(beside)
    assert family_of(robot).arm.half_widths[link] > off_m + 1e-3
    options = CloudOptions(growth_m=1e-3, arm_padding_m=0.0)
    found = filter_frame(robot, Frame.validate(robot, point[None], radius=RADIUS, joints=q), options)
    assert (found.report.of_arm, found.report.kept) == (0, 1)


@pytest.mark.parametrize("count", [1, 6])
def test_all_that_is_to_be_ignored_is_left_out_and_nothing_else(robot, count):
    rng = np.random.default_rng(count)
    fruits = [Sphere(name=f"fruit {n}", center=(1.0, 0.3 * n - 0.7, 1.2), radius=0.04) for n in range(count)]
    at = np.array([fruit.center for fruit in fruits])[rng.integers(0, count, 3000)]
    points = at + rng.normal(size=at.shape) * 0.03
    found = filter_frame(robot, Frame.validate(robot, points, radius=RADIUS), CloudOptions(), ignored=fruits)
    assert found.report.ignored == (np.linalg.norm(points - at, axis=1) <= 0.06).sum()


def test_isolated_points_are_outliers_on_request(robot):
    rng = np.random.default_rng(2)
    patch = np.array([1.2, 0.0, 1.0]) + rng.uniform(-0.02, 0.02, (200, 3)) * [0, 1, 1]
    strays = np.array([[0.9, 0.5, 1.0], [0.9, -0.5, 1.0], [0.9, -0.5, 1.001]])
    frame = Frame.validate(robot, np.concatenate([patch, strays]), radius=RADIUS)
    for least, left_out in ((1, 0), (2, 1), (3, 3)):
        report = filter_frame(robot, frame, CloudOptions(least_points=least)).report
        assert report.isolated == left_out
    everything = filter_frame(robot, frame, CloudOptions(least_points=1000)).report
    assert (everything.isolated, everything.kept, everything.growth_m) == (203, 0, 0.0)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([1e-3, 0.02, 0.1]), st.integers(2, 6))
def test_what_has_enough_about_it_is_no_outlier(robot, seed, distance, least):
    points = np.random.default_rng(seed).uniform([0.5, -0.3, 0.5], [1.0, 0.3, 1.0], (400, 3))
    options = CloudOptions(growth_m=1e-3, least_points=least, neighbour_m=distance)
    found = filter_frame(robot, Frame.validate(robot, points, radius=RADIUS), options)
    about = (np.linalg.norm(points[:, None] - points, axis=2) <= distance).sum(axis=1)
    gaps = np.linalg.norm(points[:, None] - found.points, axis=2).min(axis=1, initial=9.0)
    assert gaps[about >= least].max(initial=0.0) <= found.report.growth_m + 1e-12
    alone = (np.linalg.norm(points[:, None] - points, axis=2) <= distance + 5e-3).sum(axis=1) < least
    assert (gaps[alone] > 1e-9).all()
    assert found.report.isolated <= (about < least).sum()


def test_many_voxels_and_the_memory_of_frames_before(robot):
    rng = np.random.default_rng(0)
    points = np.repeat(rng.uniform([0.5, -1, 0.2], [1.5, 1, 1.2], (20_000, 3)), 3, axis=0)
    points = rng.permutation(points + rng.normal(0.0, 2e-3, points.shape))
    frame, scratch = Frame.validate(robot, points, radius=RADIUS), Scratch()
    found = filter_frame(robot, frame, CloudOptions(), scratch=scratch)
    filter_frame(robot, Frame.validate(robot, points[:99] + 0.1, radius=RADIUS), CloudOptions(), scratch=scratch)
    again = filter_frame(robot, frame, CloudOptions(), scratch=scratch)
    np.testing.assert_array_equal(again.points, found.points)
    assert again.report == found.report
    cells = np.floor((points - tight_reach_ball(robot)[:3]) / (2.0 * 5e-3 / np.sqrt(3.0)))
    blocks = len(np.unique(cells // 4, axis=0))
    _, number, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    low, high = np.full((len(count), 3), np.inf), np.full((len(count), 3), -np.inf)
    np.minimum.at(low, number.ravel(), points)
    np.maximum.at(high, number.ravel(), points)
    assert sorted(map(tuple, found.points.round(9))) == sorted(map(tuple, (0.5 * (low + high)).round(9)))
    growth = np.linalg.norm(points - (0.5 * (low + high))[number.ravel()], axis=1).max()
    assert found.report.growth_m == pytest.approx(growth, abs=1e-12)
    assert blocks > 4096  # so that room for them grew
    assert len(count) < len(points)


# Accepted input


@pytest.mark.parametrize(
    "points",
    [
        [],
        np.zeros((0, 3)),
        np.zeros((0, 3), np.float32),
        np.full((5, 3), np.nan),
        np.full((4, 3), 1e308),
        [[-1e300] * 3],
    ],
)
def test_frames_without_anything(robot, points):
    found = filter_frame(robot, Frame.validate(robot, points, radius=RADIUS, joints=TUCKED), CloudOptions())
    assert found.points.shape == (0, 3)
    assert found.report.kept == found.report.growth_m == 0.0
    assert found.report.not_finite + found.report.out_of_reach == found.report.given == np.size(points) // 3


def test_arrays_of_all_kinds(robot):
    points = np.round(np.random.default_rng(0).uniform(0.5, 1.5, (60, 3)) * 8.0) / 8.0
    options = CloudOptions()
    expected = filter_frame(robot, Frame.validate(robot, points, radius=RADIUS), options).points
    for given_ in (
        points.tolist(),
        points.astype(np.float16),
        points.astype(np.longdouble),
        np.asfortranarray(points),
        points.reshape(6, 10, 3),
        np.column_stack([points, points])[:, :3],
        points.astype(">f4"),
    ):
        found = filter_frame(robot, Frame.validate(robot, given_, radius=RADIUS), options).points
        np.testing.assert_array_equal(found, expected)
    whole = filter_frame(robot, Frame.validate(robot, np.ones((2, 3), dtype=int), radius=RADIUS), options)
    assert whole.points.tolist() == [[1.0, 1.0, 1.0]]


def test_pose_is_a_matrix_or_six_numbers(robot):
    turn, shift = rpy_rotation(0.1, -0.2, 0.3), [0.4, 0.5, 0.6]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, shift
    frames = [
        Frame.validate(robot, np.zeros((1, 3)), radius=RADIUS, pose=pose)
        for pose in (matrix, matrix.astype(np.float32), [*shift, *np.degrees([0.1, -0.2, 0.3])])
    ]
    for frame in frames:
        np.testing.assert_allclose(frame.rotation, turn, atol=1e-6)
        np.testing.assert_allclose(frame.position, shift, atol=1e-6)
    mirrored, scaled, projective = matrix * [-1, 1, 1, 1], 2.0 * matrix, matrix.copy()
    projective[3, 0] = 0.1
    huge = np.diag([1e200, 1e200, 1.0, 1.0])  # its products are no numbers
    huge[0, 1], huge[1, 0] = -1e200, 1e200
    for pose in (mirrored, scaled, projective, huge, np.zeros((4, 4)), matrix.T):
        with pytest.raises(InputError, match="not a rigid transform"):
            Frame.validate(robot, np.zeros((1, 3)), radius=RADIUS, pose=pose)
    for pose in (np.full((4, 4), np.nan), np.eye(3), [1, 2, 3], "pose"):
        with pytest.raises(InputError, match="pose"):
            Frame.validate(robot, np.zeros((1, 3)), radius=RADIUS, pose=pose)


# Memory

CAMERA = (0.0, 0.0, 1.0)


def wall(x: float, step: float = 0.004, half: float = 0.2) -> np.ndarray:
    """Points of a square across the camera's axis, which is x here, on rays of the camera."""
    side = np.arange(-half, half, step)
    return np.stack(np.broadcast_arrays(x, *(x * s for s in np.meshgrid(side, side))), axis=-1).reshape(-1, 3)


def take(robot, points, time_s, before=None, **values):
    options = values.pop("options", CloudOptions())
    frame = Frame.validate(robot, points, radius=RADIUS, pose=[*CAMERA, 0, 0, 0], keep_s=1.0, time_s=time_s, **values)
    return filter_frame(robot, frame, options, before=before)


def test_hidden_points_are_remembered_for_their_time(robot):
    post = wall(1.4, half=0.05)
    first = take(robot, post, 0.0)
    hidden = take(robot, wall(0.8, half=0.15), 0.5, first.seen)
    assert hidden.report.remembered == first.report.kept
    assert hidden.report.radius_m >= RADIUS + first.report.growth_m
    later = take(robot, wall(0.8, half=0.15), 1.0, hidden.seen)
    assert later.report.remembered == first.report.kept  # when it was seen counts, not when it was kept
    assert later.report.kept == hidden.report.kept
    too_late = take(robot, wall(0.8, half=0.15), 1.01, later.seen)
    assert too_late.report.remembered == 0


def test_remembered_points_keep_their_radius(robot):
    """A large ball stays large among the next frames' smaller balls."""
    first = take(robot, wall(1.4, half=0.05), 0.0)
    seen, kept = first.seen, first.report.kept
    for time_s, radius in ((0.2, 0.3 * RADIUS), (0.4, 0.1 * RADIUS), (0.6, 0.5 * RADIUS)):
        frame = Frame.validate(
            robot, wall(0.8, half=0.15), radius=radius, pose=[*CAMERA, 0, 0, 0], keep_s=1.0, time_s=time_s
        )
        found = filter_frame(robot, frame, CloudOptions(), before=seen)
        assert found.report.remembered == kept
        assert found.report.radius_m >= RADIUS + first.report.growth_m - 1e-12
        seen = found.seen


def test_points_that_the_camera_sees_through_are_forgotten(robot):
    first = take(robot, wall(0.8, half=0.1), 0.0)
    assert take(robot, wall(1.4), 0.1, first.seen).report.remembered == 0  # it sees past the previous position
    assert take(robot, wall(0.79), 0.1, first.seen).report.remembered == 0  # and sees it again, but for noise
    unseen = take(robot, wall(1.4, half=0.02), 0.1, first.seen).report.remembered
    assert 0.8 * first.report.kept < unseen < first.report.kept  # at the rim nothing was measured
    assert take(robot, [], 0.1, first.seen).report.remembered == first.report.kept


@pytest.mark.parametrize("axis", range(3))
def test_view_of_turned_camera(robot, axis):
    """To all six sides: points behind the camera say nothing about points ahead."""

    def look(points, time_s, before=None):
        pose = [*CAMERA, 20.0, -30.0, 100.0]
        frame = Frame.validate(robot, points, radius=RADIUS, pose=pose, keep_s=1.0, time_s=time_s)
        return filter_frame(robot, frame, CloudOptions(), before=before)

    near, far = (np.roll(wall(x, half=half), axis, axis=1) for x, half in ((0.8, 0.1), (1.4, 0.2)))
    for sign in (1.0, -1.0):
        first = look(sign * near, 0.0)
        assert look(sign * far, 0.1, first.seen).report.remembered == 0
        assert look(-sign * far, 0.1, first.seen).report.remembered == first.report.kept


def test_where_the_arm_is_nothing_is_remembered(robot):
    reaching = np.zeros(robot.dof)
    at_the_tool = robot.tool_positions(reaching) - CAMERA + np.random.default_rng(0).normal(size=(99, 3)) * 5e-3
    first = take(robot, at_the_tool, 0.0)
    assert first.report.kept > 10
    there = take(robot, [], 0.1, first.seen, joints=reaching)
    assert there.report.remembered == 0
    assert take(robot, [], 0.1, first.seen, joints=TUCKED).report.remembered == first.report.kept


@pytest.mark.parametrize(("beyond_m", "stays"), [(-1e-3, False), (1e-3, True)])
def test_growth_counts_for_balls_at_the_arm(robot, beyond_m, stays):
    reaching = np.zeros(robot.dof)
    x, y, z = robot.tool_positions(reaching) - CAMERA
    pair = np.array([[x - 0.1, y, z], [x - 0.096, y, z]])  # one ball in the middle of both, grown by 2 mm
    pair[:, 1] += family_of(robot).arm.half_widths[-1] + RADIUS + 2e-3 + beyond_m
    first = take(robot, pair, 0.0, options=CloudOptions(growth_m=0.05))
    assert first.report.growth_m == pytest.approx(2e-3)
    assert take(robot, [], 0.1, first.seen, joints=reaching).report.remembered == stays


def test_points_hidden_by_padding_are_remembered(robot):
    """A branch 25 mm from the arm counts as the arm in the next frame, but is kept."""
    reaching = np.zeros(robot.dof)
    x, y, z = robot.tool_positions(reaching) - CAMERA
    beside = family_of(robot).arm.half_widths[-1] + 0.025
    branch = np.column_stack([np.linspace(x - 0.3, x - 0.1, 50), np.full(50, y + beside), np.full(50, z)])
    first = take(robot, branch, 0.0)
    again = take(robot, branch, 0.1, first.seen, joints=reaching)
    assert again.report.of_arm == 50
    assert again.report.remembered == first.report.kept
    assert (again.seen.seen_s == 0.0).all()


def test_memory_is_bounded_and_the_oldest_go_first(robot):
    few = CloudOptions(most_remembered=50)
    first = take(robot, wall(0.8, half=0.03), 0.0)
    second = take(robot, wall(0.8, half=0.03) + np.array([0.0, 0.5, 0.0]), 0.2, first.seen)
    assert second.report.remembered == first.report.kept > 50
    third = take(robot, [], 0.3, second.seen, options=few)
    assert (third.report.remembered, third.report.forgotten) == (50, len(second.points) - 50)
    assert (third.seen.seen_s == 0.2).all()
    assert (third.points[:, 1] > 0.25).all()
