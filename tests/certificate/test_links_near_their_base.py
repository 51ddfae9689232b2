"""Links of planar arms that begin close to their base: capsules and true shapes.

As capsules they always touch the base; their true shapes may not touch it. A boom is 3 cm above a cabinet's plate, or a
turret's: it passes over the plate's edge, but may not go below it.
"""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from planned import straight

from hplan.certificate.certificate import certify
from hplan.certificate.motion_bound import motion_of_movers
from hplan.collision.coal_scene import CoalScene
from hplan.errors import ConfigurationInCollisionError, NoPathError
from hplan.planar.family_reader import family_of, is_planar
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start

LIMIT = '<limit lower="-2.5" upper="2.5" velocity="2" effort="500" acceleration="5"/>'
INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'


def box(size: str, xyz: str) -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'


def joint(name: str, parent: str, child: str, xyz: str, axis: str = "0 -1 0") -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/>{LIMIT}</joint>'
    )


def crane(*, turns: bool) -> Robot:
    """A plate, which turns or not, with a boom of two links."""
    plate = box("0.6 0.4 0.3", "0 0 0.15")
    carrier = f'<link name="base_link">{plate}</link>'
    if turns:
        mast = box("0.1 0.1 0.1", "0 0 -0.3")
        yaw = joint("yaw", "base_link", "plate", "0 0 0", axis="0 0 1")
        carrier = f'<link name="base_link">{mast}</link><link name="plate">{INERTIAL}{plate}</link>{yaw}'
    return load_robot(
        f'<robot name="crane">{carrier}'
        + joint("lift", "plate" if turns else "base_link", "boom", "0 0 0.33")
        + f'<link name="boom">{INERTIAL}{box("0.5 0.05 0.05", "0.3 0 0")}</link>'
        + joint("bend", "boom", "tip", "0.6 0 0")
        + f'<link name="tip">{INERTIAL}{box("0.3 0.05 0.05", "0.2 0 0")}</link>'
        + '<joint name="end" type="fixed"><parent link="tip"/><child link="tool0"/><origin xyz="0.35 0 0"/></joint>'
        '<link name="tool0"/></robot>'
    )


ROBOTS = {turns: crane(turns=turns) for turns in (False, True)}


def scene(start: np.ndarray, goal: np.ndarray, clearance: float = 0.0) -> Scene:
    ends = {"start": Start(joints_rad=tuple(start.tolist())), "goal": Goal(joints_rad=tuple(goal.tolist()))}
    return Scene(name="s", clearance=clearance, **ends)


def depth(robot: Robot, q: np.ndarray) -> float:
    """Distance of boom and plate by coal alone."""
    data, model = robot.model.createData(), robot.collision_model
    placed = model.createData()
    pin.updateGeometryPlacements(robot.model, data, model, placed, q)
    named = {robot.model.frames[shape.parentFrame].name: number for number, shape in enumerate(model.geometryObjects)}
    plate = named["plate"] if "plate" in named else named["base_link"]
    sides = [(model.geometryObjects[number].geometry, placed.oMg[number]) for number in (named["boom"], plate)]
    (a, at), (b, other) = ((shape, coal.Transform3s(place.rotation, place.translation)) for shape, place in sides)
    return float(coal.distance(a, at, b, other, coal.DistanceRequest(), coal.DistanceResult()))


def lifted(robot: Robot, lift: float, bend: float = 0.3) -> np.ndarray:
    return np.array([*([0.4] if family_of(robot).has_yaw else []), lift, bend])


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("lift", [-0.8, -0.1, 0.0, 0.1, 0.5])
def test_boom_over_its_own_plate_is_checked_exactly(turns, lift):
    robot = ROBOTS[turns]
    assert is_planar(robot)
    start, goal = lifted(robot, 1.0), lifted(robot, lift)
    found = certify(robot, scene(start, goal), straight(robot, start, goal, 5.0, 6.0))
    least = min(depth(robot, q) for q in np.linspace(start, goal, 200))
    assert found.verified == (least > 0.0)
    assert found.min_clearance_m <= least + 1e-9
    if not found.verified:
        assert (found.nearest.link, found.nearest.obstacle) == ("boom", "plate" if turns else "base_link")


@pytest.mark.parametrize("turns", [False, True])
def test_plan_knows_where_the_plate_begins(turns):
    """A goal in the plate is refused, and one on its other side as out of reach; one just above it is reached."""
    robot = ROBOTS[turns]
    start = lifted(robot, 1.0)
    with pytest.raises(ConfigurationInCollisionError, match=r"'boom' is .* deep in link"):
        plan(robot, scene(start, lifted(robot, -0.5)))
    reached = plan(robot, scene(start, lifted(robot, 0.02)))
    assert reached.certificate.verified
    assert min(depth(robot, q) for q in reached.trajectory.position) >= reached.certificate.min_clearance_m - 1e-9


def test_way_under_the_plate_is_barred():
    """At -100 degrees the boom hangs behind the plate: from above it no motion leads there."""
    robot = load_robot(
        f'<robot name="shelf"><link name="base_link">{box("0.6 0.4 0.02", "0 0 0")}</link>'
        + joint("lift", "base_link", "boom", "-0.33 0 0.025")
        + f'<link name="boom">{INERTIAL}{box("0.5 0.05 0.05", "0.3 0 0")}</link>'
        + '<joint name="end" type="fixed"><parent link="boom"/><child link="tool0"/><origin xyz="0.6 0 0"/></joint>'
        '<link name="tool0"/></robot>'
    )
    start, goal = np.array([1.0]), np.radians([-100.0])
    assert depth(robot, goal) > 0.01
    with pytest.raises(NoPathError, match="'boom' is in link 'base_link'"):
        plan(robot, scene(start, goal))


@pytest.mark.parametrize("turns", [False, True])
def test_motion_and_displacement_of_exact_bodies_are_bounded(turns):
    """No point of the boom travels farther, seen from the plate."""
    robot, random = ROBOTS[turns], np.random.default_rng(1)
    checker = CoalScene(robot, ())
    plate = "plate" if turns else "base_link"
    (row,) = [k for k, pair in enumerate(checker.parts.own) if (pair.mover_name, pair.other_name) == ("boom", plate)]
    for _ in range(200):
        q = lifted(robot, random.uniform(-2.5, 2.5))
        turn = np.zeros(robot.dof)
        turn[family_of(robot).arm_slice.start] = random.uniform(-0.3, 0.3)
        changed = abs(depth(robot, q + turn) - depth(robot, q))
        bezier = q + np.linspace(0.0, 1.0, 4)[None, :, None] * turn
        mover_of, moved, sways = motion_of_movers(checker, bezier, np.abs(turn)[None])
        assert changed <= moved[mover_of[row], 0] + 1e-6
        assert changed <= sways[mover_of[row], 0] + 1e-6


def test_clearance_is_kept_as_far_as_possible():
    robot = ROBOTS[False]
    start, goal = lifted(robot, 1.0), lifted(robot, 0.3)
    assert certify(robot, scene(start, goal, 0.01), straight(robot, start, goal, 5.0, 6.0)).verified
    assert not certify(
        robot, scene(start, lifted(robot, 0.0), 0.01), straight(robot, start, lifted(robot, 0.0), 5.0, 6.0)
    ).verified
    # They never keep that clearance: only contact is checked.
    assert certify(robot, scene(start, goal, 0.2), straight(robot, start, goal, 5.0, 6.0)).verified
    error = certify(robot, scene(start, goal), straight(robot, start, goal, 5.0, 6.0), tracking_error=0.4)
    assert not error.verified
