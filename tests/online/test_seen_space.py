"""Observed space: freed space is in view, its boundary is closed, motions stay inside."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError, InputError, OptionError
from hplan.online.arm_shape import arm_solids
from hplan.online.frame import CloudOptions
from hplan.online.hidden_points import CELLS
from hplan.online.planner import Planner
from hplan.online.seen_space import UNSEEN, SeenSpace, shows
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Sphere

HOME = np.radians([0.0, 60.0, 60.0, 40.0])
BALLS = np.array([[1.3, 0.2, 1.6, 0.15], [0.9, -0.8, 1.2, 0.1], [-0.6, 0.9, 1.4, 0.2]])

#: All is in a ball about the arm.
ROOM = np.array([0.0, 0.0, 1.0, 5.0])


def directions() -> FloatArray:
    """A ray through the middle of each cell of directions that a camera ahead has, in its frame."""
    slopes = (np.arange(CELLS) + 0.5) / (0.5 * CELLS) - 1.0
    u, v = np.meshgrid(slopes, slopes)
    return np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)


def depths(start: FloatArray, rays: FloatArray) -> FloatArray:
    """(n,) how far along (n, 3) unit vectors from a point the first of the balls, or the room, is."""
    found = np.full(len(rays), np.inf)
    for x, y, z, radius in (*BALLS, ROOM):
        off = np.array([x, y, z]) - start
        along, square = rays @ off, float(off @ off) - radius**2
        root = np.sqrt(np.maximum(along**2 - square, 0.0))
        hit = np.where(along**2 >= square, along - root if square > 0.0 else along + root, np.inf)
        found = np.where((hit > 0.0) & (hit < found), hit, found)
    return found


def look(pose: FloatArray) -> FloatArray:
    """Points of a camera, in its frame."""
    rays = directions() / np.linalg.norm(directions(), axis=1, keepdims=True)
    return depths(pose[:3, 3], rays @ pose[:3, :3].T)[:, None] * rays


def poses() -> list[FloatArray]:
    """Cameras all round, looking in."""
    found = []
    for yaw in (0.0, 90.0, 180.0, 270.0):
        for up in (0.2, 2.6):
            pose = np.eye(4)
            pose[:3, 2] = -np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0])
            pose[:3, 0] = np.cross([0.0, 0.0, 1.0], pose[:3, 2])
            pose[:3, 1] = np.cross(pose[:3, 2], pose[:3, 0])
            pose[:3, 3] = 3.5 * np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0]) + [0.0, 0.0, up]
            found.append(pose)
    return found


def middles_of(space: SeenSpace, wanted: FloatArray) -> FloatArray:
    return space._middles(np.argwhere(wanted))


def test_freed_space_is_in_view(robot: Robot) -> None:
    random = np.random.default_rng(0)
    for pose in poses()[:3]:
        space = SeenSpace(robot, 0.06)
        space.see(look(pose), (pose[:3, :3].copy(), pose[:3, 3].copy()), 1.0, 0.01)
        middles = middles_of(space, space.times == 1.0)
        assert len(middles) > 20_000
        within = random.normal(size=middles.shape)
        within *= space.radius * random.uniform(0.0, 1.0, (len(middles), 1)) / np.linalg.norm(within, axis=1)[:, None]
        rays = middles + within - pose[:3, 3]
        away = np.linalg.norm(rays, axis=1)
        # Less than the width of a cell at the rim of a ball may be wrong.
        assert (depths(pose[:3, 3], rays / away[:, None]) >= away).mean() > 0.9995
        for x, y, z, radius in BALLS:
            assert np.linalg.norm(middles - (x, y, z), axis=1).min() > radius
    nothing = SeenSpace(robot, 0.06)
    nothing.see(np.full((5, 3), np.nan), (np.eye(3), np.zeros(3)), 1.0, 0.01)
    assert not np.isfinite(nothing.times).any()


def test_no_way_leads_past_the_border(robot: Robot) -> None:
    random, space = np.random.default_rng(1), SeenSpace(robot, 0.25)
    shape, half = space.times.shape, len(space.times) // 2
    halves = [part for place in np.indices(shape) for part in (place < half, place > half)]
    for wanted in (*halves, random.uniform(size=shape) < 0.5):
        space.times[...] = np.where(wanted, 3.0, 1.0)
        known, other, border = middles_of(space, wanted), middles_of(space, ~wanted), space.border(3.0)
        for _ in range(10):
            ends = known[random.integers(len(known))], other[random.integers(len(other))]
            line = ends[0] + np.linspace(0.0, 1.0, 400)[:, None] * (ends[1] - ends[0])
            apart = np.linalg.norm(line[:, None] - border, axis=2).min(axis=1)
            assert apart.min() <= space.radius


def seen(robot: Robot, cameras: list[FloatArray], goal: Goal, **more: object) -> Planner:
    planner = Planner(robot, Scene(name="seen", start=Start(joints_rad=HOME), goal=goal))
    for number, pose in enumerate(cameras):
        planner.set_cloud(
            f"camera {number}", look(pose), radius=0.01, pose=pose, joints=HOME, keep_s=9.0, time_s=0.1 * number,
            unknown="solid", **more,
        )  # fmt: skip
    return planner


GOAL = Goal(joints_rad=tuple(np.radians([70.0, 40.0, 70.0, 30.0]).tolist()))


def test_motions_stay_in_known_space(robot: Robot) -> None:
    planner = seen(robot, poses(), GOAL)
    found = planner.plan()
    assert found.certificate.verified
    space, since = planner._space, planner._known_since_s
    assert space is not None
    for q in found.trajectory.position[::4]:
        assert space.holds(arm_solids(robot, q), since)
    # From one of the cameras the goal is not in view.
    with pytest.raises(HplanError, match=UNSEEN):
        seen(robot, poses()[:1], GOAL).plan()
    # A frame that is older than is kept frees nothing: the last one alone counts.
    planner.set_cloud("camera 0", look(poses()[0]), radius=0.01, pose=poses()[0], joints=HOME, time_s=60.0,
        unknown="solid")  # fmt: skip
    with pytest.raises(HplanError, match=UNSEEN):
        planner.plan()


def test_start_has_to_be_known(robot: Robot) -> None:
    planner = Planner(robot, Scene(name="blind", start=Start(joints_rad=HOME), goal=GOAL))
    options = CloudOptions(allow_empty=True)
    nothing = np.full((5, 3), np.nan)
    planner.set_cloud("camera", nothing, radius=0.01, joints=HOME, keep_s=9.0, unknown="solid", options=options)
    with pytest.raises(HplanError, match=UNSEEN):
        planner.plan()
    planner.aim(start=Start(joints_rad=tuple(np.radians([180.0, 40.0, 70.0, 30.0]).tolist())))
    with pytest.raises(InputError, match="unseen space"):
        planner.plan()
    again = pickle.loads(pickle.dumps(seen(robot, poses(), GOAL)))
    with pytest.raises(InputError, match="unseen space"):
        again.plan()
    with pytest.raises(OptionError, match="joints"):
        planner.set_cloud("camera", np.zeros((1, 3)), radius=0.01, unknown="solid")
    with pytest.raises(OptionError, match="unknown"):
        planner.set_cloud("camera", np.zeros((1, 3)), radius=0.01, joints=HOME, unknown="wood")  # type: ignore[arg-type]


def test_fruit_hides_only_space_behind_it(robot: Robot) -> None:
    pose, (x, y, z, radius) = poses()[0], BALLS[0]
    fruit = np.array([[x, y, z, radius + 1e-3]])
    found = []
    for through in (None, fruit):
        space = SeenSpace(robot, 0.03)
        space.see(look(pose), (pose[:3, :3].copy(), pose[:3, 3].copy()), 1.0, 0.0, through)
        found.append(space.times == 1.0)
    more = middles_of(space, found[1] & ~found[0])
    assert (found[1] | ~found[0]).all()
    apart = np.linalg.norm(more - (x, y, z), axis=1)
    # All of the fruit that faces the camera, and next to nothing else: no farther than a voxel, none behind.
    assert apart.min() < 0.5 * radius
    assert apart.max() < radius + 2.0 * space.radius + 0.03
    ahead = (more - (x, y, z)) @ pose[:3, 2]
    assert ahead.max() < radius
    assert len(more) > 0.2 * 4.0 / 3.0 * np.pi * radius**3 / space.edge**3


def test_known_free_space_need_not_be_seen(robot: Robot) -> None:
    everywhere = Box(name="hall", center=(0.0, 0.0, 1.0), size=(9.0, 9.0, 9.0))
    found = seen(robot, poses()[:1], GOAL, options=CloudOptions(known_free=(everywhere,))).plan()
    assert found.certificate.verified
    with pytest.raises(OptionError, match="known_free"):
        CloudOptions(known_free=("lane",))  # type: ignore[arg-type]


def test_next_view_frees_the_way(robot: Robot) -> None:
    planner, left, shares = seen(robot, poses()[:1], GOAL), poses()[1:], []
    with pytest.raises(HplanError, match=UNSEEN):
        planner.plan()
    while view := planner.next_view(left, field_of_view_deg=(90.0, 90.0), farthest_m=9.0):
        pose = left.pop(view.number)
        np.testing.assert_allclose(view.pose, pose)
        planner.set_cloud("more", look(pose), radius=0.01, pose=pose, joints=HOME, keep_s=9.0, time_s=1.0,
            unknown="solid")  # fmt: skip
        assert planner._space is not None
        places = np.floor((view.unseen - planner._space._corner) / planner._space.edge).astype(int)
        known = planner._space.times[tuple(places.T)] >= planner._known_since_s
        assert known.mean() >= 0.9 * view.shown  # as promised
        shares.append(known.mean())
    assert shares[0] > 0.3
    assert len(shares) <= 3
    assert planner.plan().certificate.verified


def test_view_covers_unoccluded_space() -> None:
    random, pose = np.random.default_rng(2), poses()[0]
    balls = [Sphere(name=f"ball {n}", center=tuple(ball[:3]), radius=ball[3]) for n, ball in enumerate(BALLS)]
    middles = random.uniform([-2.0, -2.0, 0.0], [2.0, 2.0, 3.0], (4000, 3))
    shown = shows(middles, 0.02, pose, [solid for ball in balls for solid in ball.solids], (60.0, 50.0), 5.0)
    rays = middles - pose[:3, 3]
    away = np.linalg.norm(rays, axis=1)
    ahead = rays @ pose[:3, :3]
    slopes = np.abs(ahead[:, :2] / ahead[:, 2:]) / np.tan(np.radians([30.0, 25.0]))
    clear = (depths(pose[:3, 3], rays / away[:, None]) > away) & (slopes < 1.0).all(axis=1) & (away < 5.0)
    assert clear[shown].all()
    assert 0.9 * clear.sum() < shown.sum() < clear.sum()


def test_arm_goes_to_where_its_camera_sees_most(robot: Robot) -> None:
    planner, turned = seen(robot, poses()[:1], GOAL), HOME - np.radians([20.0, 0.0, 0.0, 0.0])
    eye = {"field_of_view_deg": (120.0, 120.0), "farthest_m": 9.0}
    ahead = [0.0, 0.0, 0.0, -90.0, 0.0, 0.0]  # of the hand, to the side that the goal is on
    mounted = np.eye(4)
    mounted[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]
    there = [robot.forward_kinematics(q) @ mounted for q in (turned, HOME)]
    best = planner.next_view(there, **eye)
    view = planner.next_view([turned, HOME], carried_by="tool0", mount=ahead, **eye)
    # Turned it would see more, but no known space leads there.
    assert best is not None
    assert view is not None
    assert (best.number, best.motion, view.number) == (0, None, 1)
    assert best.shown > view.shown
    np.testing.assert_allclose(view.pose, there[1], atol=1e-9)
    assert view.motion is not None
    assert view.motion.certificate.verified
    np.testing.assert_allclose(view.motion.trajectory.position[-1], HOME, atol=1e-6)
    with pytest.raises(InputError, match="solid"):
        Planner(robot, Scene(name="new", start=Start(joints_rad=HOME), goal=GOAL)).next_view(
            poses(), field_of_view_deg=(90.0, 90.0), farthest_m=9.0
        )
    with pytest.raises(OptionError, match="field_of_view_deg"):
        planner.next_view(poses(), field_of_view_deg=(90.0, 200.0), farthest_m=9.0)


def test_memory_stays(robot: Robot) -> None:
    planner = seen(robot, poses()[:2], GOAL)
    assert planner._space is not None
    times, frame = planner._space.times, look(poses()[0])
    sizes = set()
    for number in range(5):
        planner.set_cloud("camera 0", frame, radius=0.01, pose=poses()[0], joints=HOME, keep_s=9.0, time_s=1.0 + number,
            unknown="solid")  # fmt: skip
        sizes.add(len(planner.scene.obstacles[-1].solids[0].core))
    assert planner._space.times is times
    assert len(sizes) == 1
