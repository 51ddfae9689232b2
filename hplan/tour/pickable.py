"""Which fruit can be picked from where the base stands, those that are in the way picked before."""

from __future__ import annotations

from hplan.collision.reach import reach_ball
from hplan.errors import InputError
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import FruitReach, reachable
from hplan.planning.world import without_inside
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene


def within_reach(robot: Robot, scene: Scene) -> Scene:
    """What a robot may come near to; fruit and what gives way is left out of its base.

    No fruit is the goal of what is returned.

    Raises:
        InputError: Something that does not give way stands in the base.
    """
    scene = scene.copy_unchecked({"goal": Goal(position=(0.0, 0.0, 0.0), approach_deg=scene.goal.approach_deg)})
    ball = reach_ball(robot)
    cropped = scene.cropped(float(ball[3]) + scene.clearance, ball[:3])
    near, inside = without_inside(robot, cropped)
    rigid = next((one.name for one in cropped.obstacles if one.name in inside and not one.yields), None)
    if rigid is not None:
        raise InputError(f"obstacle {rigid!r} stands in the robot's pedestal or turret", obstacle=rigid)
    return near


def pickable(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> dict[str, FruitReach]:
    """The fruits that can be picked (`hplan.reachable`), in the order in which they can.

    Fruit that others are in the way of is looked at again once those are picked.

    Args:
        scene: What is within reach (`within_reach`).

    Raises:
        HplanError: As `hplan.reachable`.
    """
    found: dict[str, FruitReach] = {}
    while scene.fruits:
        now = {name: one for name, one in reachable(robot, scene, options).items() if one.can_be_picked}
        if not now:
            break
        found |= now
        scene = scene.copy_unchecked({"fruits": tuple(fruit for fruit in scene.fruits if fruit.name not in now)})
    return found
