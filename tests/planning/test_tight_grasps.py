"""Grasps with little room: planned and certified down to a fraction of a millimetre, else refused with that number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from planned import assert_sound

from hplan.errors import BlockedError
from hplan.planning.grasps import ROOMS, Target, grasps
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.task import PlanningCache
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Fruit, Goal, Scene, Start
from hplan.scene.obstacles import Capsule, Sphere

#: How thick what stands beside the last link is [m].
THICK = 0.01

APPLE = Fruit(name="apple", center=(1.1, 0.6, 1.3), radius=0.035)
TUCKED = {"harvester": (0.0, 90.0, 90.0, 90.0), "orchard_harvester": (0.0, 110.0, -140.0, 60.0)}


def scene(robot: Robot, approach_deg: float, *obstacles: Capsule | Sphere) -> Scene:
    """The apple at one approach angle."""
    return Scene(
        name="tight",
        start=Start(joints_deg=TUCKED[robot.name]),
        goal=Goal(fruit="apple", approach_deg=approach_deg),
        obstacles=obstacles,
        fruits=(APPLE,),
    )


def slot(robot: Robot, approach_deg: float, room: float) -> Scene:
    """Two wires across the arm plane, above and below the last link at the fruit."""
    yaw, angle = math.atan2(APPLE.center[1], APPLE.center[0]), math.radians(approach_deg)
    _, (outward, upward, normal) = robot.plane_at(yaw)
    along = math.cos(angle) * outward + math.sin(angle) * upward
    across = math.cos(angle) * upward - math.sin(angle) * outward
    wires = []
    for side in (-1.0, 1.0):
        aside = side * (float(robot.arm.half_widths[-1]) + room + THICK)
        middle = np.array(APPLE.center) - 0.03 * along + aside * across
        ends = {"from": tuple((middle - 0.5 * normal).tolist()), "to": tuple((middle + 0.5 * normal).tolist())}
        wires.append(Capsule.model_validate({"name": f"wire {side:+g}", "radius": THICK, **ends}))
    return scene(robot, approach_deg, *wires)


@pytest.fixture(scope="module")
def orchard_arm() -> Robot:
    return load_robot("orchard_harvester")


@pytest.mark.parametrize(("approach_deg", "room"), [(-20.0, 1e-4), (35.0, 1e-4), (-20.0, 3e-4), (35.0, 6e-4)])
def test_a_slot_with_little_room_is_entered(orchard_arm: Robot, room: float, approach_deg: float) -> None:
    """Straight, certified, and the grasp says what room it has."""
    posed = slot(orchard_arm, approach_deg, room)
    found = plan(orchard_arm, posed)
    assert_sound(orchard_arm, posed, found)
    assert [phase.name for phase in found.phases] == ["transit", "approach", "retreat"]
    assert found.grasp is not None
    assert found.grasp.room == pytest.approx(room, abs=1e-6)


def test_a_slot_with_less_is_refused_with_the_room_there_is(orchard_arm: Robot) -> None:
    room = 0.5 * ROOMS[-1]
    with pytest.raises(BlockedError, match=r"spare clearance 0\.025 mm at the best of them.*0\.05 mm are needed") as no:
        plan(orchard_arm, slot(orchard_arm, 35.0, room))
    assert no.value.best_clearance_m == pytest.approx(room, abs=1e-6)
    assert no.value.needed_clearance_m == ROOMS[-1]


def test_a_stand_off_with_little_room_is_better_than_none(orchard_arm: Robot) -> None:
    """A ball behind the wrist at the stand-off: the fruit is touched on the approach only, not on the whole motion."""
    free, room = scene(orchard_arm, 10.0), 3e-4
    options = PlanOptions(standoff=0.0)  # the shortest approach alone
    target = Target.of_fruit(PlanningCache(orchard_arm).world(free, options), APPLE, 10.0)
    grasp = grasps(target, free.start.configuration, standoff=0.0)[0]
    origin, axes = orchard_arm.plane_at(grasp.standoff[0])
    elbow, wrist, tool = origin + orchard_arm.arm.joint_points(grasp.standoff[1:])[-3:] @ axes[:2]
    back = sum((wrist - end) / np.linalg.norm(wrist - end) for end in (elbow, tool))
    center = wrist + (float(orchard_arm.arm.half_widths[1]) + THICK + room) * back / np.linalg.norm(back)
    posed = scene(orchard_arm, 10.0, Sphere(name="ball", center=tuple(center.tolist()), radius=THICK))
    found = plan(orchard_arm, posed, options)
    assert_sound(orchard_arm, posed, found)
    assert [phase.name for phase in found.phases] == ["transit", "approach", "retreat"]
    assert found.grasp is not None
    assert found.grasp.room == pytest.approx(room, abs=1e-6)
