"""Which fruit can be picked from where the base stands, those that are in the way picked before."""

from __future__ import annotations

from hplan.collision.reach import reach_ball
from hplan.errors import BlockedError, UnreachableError
from hplan.planning.grasps import Target, grasps
from hplan.planning.options import PlanOptions
from hplan.planning.task import PlanningCache
from hplan.planning.world import without_inside
from hplan.robot.model import Robot
from hplan.scene.model import Scene


def within_reach(robot: Robot, scene: Scene) -> Scene:
    """The scene without what no configuration reaches, and without what stands in the base."""
    centre, radius = reach_ball(robot)[:3], float(reach_ball(robot)[3])
    return without_inside(robot, scene.cropped(radius + scene.clearance, centre))[0]


def pickable(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> tuple[str, ...]:
    """Names of the fruits that have a grasp, in the order in which they can be picked.

    Fruit that others are in the way of is looked at again once those are picked.
    """
    options = options or PlanOptions()
    left, cache, found = within_reach(robot, scene), PlanningCache(robot), list[str]()
    start = robot.joints_of(scene.start, "start")
    tried = left.fruits
    while tried:
        world = cache.context(left, options).world
        gone, blocked = set[str](), []
        for fruit in tried:
            try:
                grasps(Target.of_fruit(world, fruit, scene.goal.approach_deg), start, standoff=options.standoff_m)
            except BlockedError:
                blocked.append(fruit)
            except UnreachableError:
                continue
            else:
                gone.add(fruit.name)
                found.append(fruit.name)
        left = left.model_copy(update={"fruits": tuple(fruit for fruit in left.fruits if fruit.name not in gone)})
        tried = tuple(blocked) if gone else ()
    return tuple(found)
