"""Fruits that a base position can pick, in a feasible order."""

from __future__ import annotations

from hplan.collision.reach import reach_ball
from hplan.errors import InputError
from hplan.planning.options import PlanOptions
from hplan.planning.reachable import FruitReach, reachable
from hplan.planning.world import without_inside
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene


def within_reach(robot: Robot, scene: Scene) -> Scene:
    """Crop a scene to the robot's workspace.

    Fruits and compliant obstacles inside the base are removed. The returned scene has no fruit as its goal.

    Raises:
        InputError: A rigid obstacle is inside the base.
    """
    scene = scene.copy_unchecked({"goal": Goal(position=(0.0, 0.0, 0.0), approach_deg=scene.goal.approach_deg)})
    ball = reach_ball(robot)
    cropped = scene.cropped(float(ball[3]) + scene.clearance, ball[:3])
    near, inside = without_inside(robot, cropped)
    rigid = next((one.name for one in cropped.obstacles if one.name in inside and not one.yields), None)
    if rigid is not None:
        raise InputError(f"obstacle {rigid!r} is inside the robot's pedestal or turret", obstacle=rigid)
    return near


def pickable(robot: Robot, scene: Scene, options: PlanOptions | None = None) -> dict[str, FruitReach]:
    """The fruits that can be picked, in a feasible order (`hplan.reachable`).

    Fruits blocked by others are checked again once those are picked.

    Args:
        robot: The arm.
        scene: Scene cropped to the workspace (`within_reach`).
        options: Planning options; None for the defaults.

    Raises:
        HplanError: An error of `hplan.reachable`.
    """
    found: dict[str, FruitReach] = {}
    while scene.fruits:
        now = {name: one for name, one in reachable(robot, scene, options).items() if one.can_be_picked}
        if not now:
            break
        found |= now
        scene = scene.copy_unchecked({"fruits": tuple(fruit for fruit in scene.fruits if fruit.name not in now)})
    return found
