"""Space that was seen: what a frame frees is in view, what closes off the rest has no gap, motions stay within."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError, InputError, OptionError
from hplan.online.arm_shape import arm_solids
from hplan.online.hidden_points import CELLS
from hplan.online.planner import Planner
from hplan.online.seen_space import UNSEEN, SeenSpace
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start

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


def test_what_a_frame_frees_is_in_view(robot: Robot) -> None:
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
    # From half of the cameras the goal is not in view.
    with pytest.raises(HplanError, match=UNSEEN):
        seen(robot, poses()[:1], GOAL).plan()
    # A frame that is older than is kept frees nothing: the last one alone counts.
    planner.set_cloud("camera 0", look(poses()[0]), radius=0.01, pose=poses()[0], joints=HOME, time_s=60.0,
        unknown="solid")  # fmt: skip
    with pytest.raises(HplanError, match=UNSEEN):
        planner.plan()


def test_the_start_has_to_be_known(robot: Robot) -> None:
    planner = Planner(robot, Scene(name="blind", start=Start(joints_rad=HOME), goal=GOAL))
    planner.set_cloud("camera", np.full((5, 3), np.nan), radius=0.01, joints=HOME, keep_s=9.0, unknown="solid")
    with pytest.raises(HplanError, match=UNSEEN):
        planner.plan()
    planner.aim(start=Start(joints_rad=tuple(np.radians([180.0, 40.0, 70.0, 30.0]).tolist())))
    with pytest.raises(InputError, match="not seen"):
        planner.plan()
    again = pickle.loads(pickle.dumps(seen(robot, poses(), GOAL)))
    with pytest.raises(InputError, match="not seen"):
        again.plan()
    with pytest.raises(OptionError, match="joints"):
        planner.set_cloud("camera", np.zeros((1, 3)), radius=0.01, unknown="solid")
    with pytest.raises(OptionError, match="unknown"):
        planner.set_cloud("camera", np.zeros((1, 3)), radius=0.01, joints=HOME, unknown="wood")  # type: ignore[arg-type]


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
