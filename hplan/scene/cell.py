"""A workcell: several robots among the same obstacles.

Scene files describe it under the key `robots`. All coordinates, position goals included, are in the workcell frame
`base_link`, whose z axis is vertical.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from hplan.base.checked import StrictModel, fault
from hplan.scene.attached import Attached
from hplan.scene.fruit import Fruit
from hplan.scene.limits import FARTHEST_M, MOST_ATTACHED, MOST_OBSTACLES, Vector
from hplan.scene.model import FORMAT, Goal, Scene, Start
from hplan.scene.obstacle_kind import Name
from hplan.scene.obstacles import Obstacle
from hplan.scene.robot_source import RobotSource
from hplan.scene.wood import Wood

#: Maximum number of robots of a workcell.
MOST_ROBOTS = 16

#: A link of one robot: the robot's name, and the link's name in its URDF.
ArmLink: TypeAlias = tuple[Name, Name]


class CellRobot(StrictModel):
    """One robot of a workcell: its model, base pose and task.

    Attributes:
        name: Name in the workcell, prefix of its joint and link names.
        robot: Name of a robot, or a URDF next to the scene file, for `load_robot`, alone or with options; None for the
            harvester.
        limits: Limits file, or name of a robot, for `load_robot`; None for the default limits.
        tool_frame: Frame at the end of the arm, for `load_robot`; None for the default frame.
        hold: Values of fixed joints [rad, m].
        collision_from_visual: True, or the names of the links, to build collision shapes from visuals (`load_robot`).
        xacro_args: Values of the arguments of a xacro file, by name.
        position: Position of its base [m].
        rpy_deg: Rotation of its base by roll, pitch and yaw [deg].
        start: Start configuration, at rest.
        goal: Goal; None if the robot stays, or if its task is to pick fruit on a tour.
        drop_off: Place where fruit is released on a tour: joints, a position or a pose; None if the robot stores fruit.
        every: Maximum number of fruits carried to the drop-off at a time.
        attached: Objects that it holds; their frames and links are named as in its own file.
    """

    name: Name
    robot: str | RobotSource | None = None
    limits: str | None = None
    tool_frame: Name | None = None
    hold: Mapping[str, float] = {}
    collision_from_visual: bool | tuple[Name, ...] = False
    xacro_args: Mapping[str, str] = {}
    position: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    start: Start
    goal: Goal | None = None
    drop_off: Goal | None = None
    every: Annotated[int, Field(ge=1)] = 1
    attached: Annotated[tuple[Attached, ...], Field(max_length=MOST_ATTACHED)] = ()

    @model_validator(mode="after")
    def _begins_at_rest(self) -> CellRobot:
        if self.start.is_moving:
            raise fault("a robot of a workcell must begin at rest", "start")
        if self.start.contact_depth is not None:
            raise fault("a robot of a workcell must begin clear of obstacles", "start", "contact_depth")
        if self.drop_off is not None and self.drop_off.fruit is not None:
            raise fault("a drop-off is given by joints, a position or a pose, not by a fruit", "drop_off", "fruit")
        if self.every > 1 and self.drop_off is None:
            raise fault("fruits are carried to a drop-off: give drop_off too", "every")
        return self


class CellScene(StrictModel):
    """Several robots and their environment.

    Attributes:
        name: Name of the workcell.
        robots: The robots.
        clearance: Minimum distance of each robot from every obstacle [m].
        obstacles: Obstacles.
        fruits: Fruit; obstacles too, except for the robot whose goal it is.
        wood: Limits of force and stress for limbs, as in a scene; two robots do not push one limb at the same time.
        may_touch: Pairs of links of different robots that touch by design, for example bases on one plate. They are not
            checked, and every certificate and report lists them.
    """

    format: Literal["hplan-scene/1"] = FORMAT
    name: Name
    robots: Annotated[tuple[CellRobot, ...], Field(min_length=1, max_length=MOST_ROBOTS)]
    clearance: Annotated[float, Field(ge=0.0, le=FARTHEST_M)] = 0.0
    obstacles: Annotated[tuple[Obstacle, ...], Field(max_length=MOST_OBSTACLES)] = ()
    fruits: Annotated[tuple[Fruit, ...], Field(max_length=MOST_OBSTACLES)] = ()
    wood: Annotated[Wood | None, Field(exclude=True)] = None

    may_touch: tuple[tuple[ArmLink, ArmLink], ...] = ()

    @model_validator(mode="after")
    def _names_are_unique(self) -> CellScene:
        names = [robot.name for robot in self.robots]
        for place, robot in enumerate(self.robots):
            if robot.name in names[:place]:
                raise fault(f"{robot.name!r} is already the name of another robot", "robots", place, "name")
            fruit = None if robot.goal is None else robot.goal.fruit
            if fruit is not None and fruit not in {each.name for each in self.fruits}:
                raise fault(f"{fruit!r} is not among the fruits", "robots", place, "goal", "fruit")
        for place, pair in enumerate(self.may_touch):
            for end, (robot_name, _) in enumerate(pair):
                if robot_name not in names:
                    raise fault(f"{robot_name!r} is not among the robots", "may_touch", place, end)
            if pair[0][0] == pair[1][0]:
                raise fault(f"both links belong to {pair[0][0]!r}; a pair has links of two robots", "may_touch", place)
        held = tuple(item for robot in self.robots for item in robot.attached)
        self.task(Goal(joints_rad=(0.0,)), self.robots[0].start, attached=held)  # checks that all names differ
        return self

    def task(self, goal: Goal, start: Start, **more: Any) -> Scene:
        """Return the scene of a robot based at the workcell frame."""
        shared = {key: getattr(self, key) for key in ("name", "clearance", "obstacles", "fruits", "wood")}
        return Scene(**{**shared, "start": start, "goal": goal, **more})
