"""Which fruit can be picked from where the base stands, those that are in the way picked before."""

from __future__ import annotations

from hplan.collision.reach import reach_ball
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import FruitReach, reachable
from hplan.planning.world import without_inside
from hplan.robot.model import Robot
from hplan.scene.model import Scene


def within_reach(robot: Robot, scene: Scene) -> Scene:
    """The scene without what no configuration comes near to, and without what stands in the base."""
    centre, radius = reach_ball(robot)[:3], float(reach_ball(robot)[3])
    return without_inside(robot, scene.cropped(radius + scene.clearance, centre))[0]


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
        left = tuple(fruit for fruit in scene.fruits if fruit.name not in now)
        goal = scene.goal.model_copy(update={"fruit": left[0].name}) if left and scene.goal.fruit else scene.goal
        scene = scene.model_copy(update={"fruits": left, "goal": goal})
    return found
