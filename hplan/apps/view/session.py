"""An interactive session: a configuration and a scene that change, with clearance, plans and a scene file."""

from __future__ import annotations

from pathlib import Path
from threading import RLock

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import file_path, instance, nearest_name
from hplan.base.arrays import FloatArray, numbers
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.collision.held_objects import holding
from hplan.errors import InputError, OutputError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.robot.upright import with_fixed_axis
from hplan.scene.file import save_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import transform_fields
from hplan.scene.obstacles import AnyObstacle


class Session:
    """An arm among obstacles, changed step by step.

    Methods may be called from different threads.

    Attributes:
        robot: The arm.
        scene: The scene: its obstacles as they were moved, and its goal. Its start is that of the file.
        q: (dof,) configuration.
        result: The last plan; None before the first one or after a change.

    Examples:
        >>> from hplan import load_robot, load_scene
        >>> from hplan.apps.view.session import Session
        >>> session = Session(load_robot(), load_scene())
        >>> session.nearest_contact().distance_m > 0.0
        True
    """

    def __init__(self, robot: Robot, scene: Scene, options: PlanOptions | None = None) -> None:
        """Begin at the start of a scene.

        Args:
            robot: The arm.
            scene: The scene; moving obstacles are where they are at time 0.
            options: Planning options; None for the defaults.

        Raises:
            InputError: The start does not fit the robot.
            OptionError: An argument has another type.
        """
        instance("robot", robot, Robot, "load_robot")
        instance("scene", scene, Scene)
        self.robot, start = holding(robot, scene.attached).about_start(scene.start)
        self.q: FloatArray = start
        self.scene = with_fixed_axis(self.robot, scene.snapshot(0.0) if scene.moves else scene)
        self.result: PlanResult | None = None
        self._options = PlanOptions() if options is None else instance("options", options, PlanOptions)
        self._checker: CoalScene | None = None
        self._lock = RLock()

    def set_joints(self, q: ArrayLike) -> None:
        """Move the arm; joint values beyond the limits are clipped.

        Args:
            q: (dof,) configuration.

        Raises:
            InputError: `q` does not have `dof` finite numbers.
        """
        self.q = np.clip(numbers("q", q, (self.robot.dof,)), self.robot.lower, self.robot.upper)

    def nearest_contact(self) -> Contact | None:
        """Return the link and obstacle at the minimum distance; None without obstacles."""
        with self._lock:
            if self._checker is None:
                self._checker = CoalScene(self.robot, self.scene.solids, yield_links=self.scene.yield_links)
            return self._checker.nearest_contact(self.q)

    def item(self, name: str) -> AnyObstacle | Fruit:
        """Return the obstacle or fruit of a name.

        Raises:
            InputError: There is none.
        """
        items = {item.name: item for item in (*self.scene.obstacles, *self.scene.fruits)}
        if name not in items:
            raise InputError(f"no obstacle or fruit {name!r}; {nearest_name(name, items)}", name=name)
        return items[name]

    def shift(self, name: str, by: ArrayLike) -> None:
        """Shift an obstacle or a fruit.

        Args:
            name: Its name.
            by: (3,) shift [m].

        Raises:
            InputError: There is no such name, or `by` is not three finite numbers.
            SceneError: It would be too far away.
        """
        moved, offset = self.item(name), numbers("by", by, (3,))
        other = moved.with_values(**transform_fields(moved, np.eye(3), offset))
        with self._lock:
            key = "fruits" if isinstance(moved, Fruit) else "obstacles"
            items = tuple(other if item.name == name else item for item in getattr(self.scene, key))
            self._change(self.scene.with_values(**{key: items}))

    def aim(self, goal: Goal) -> None:
        """Set the goal.

        Raises:
            SceneError: It is a fruit that the scene does not have.
        """
        self._change(self.scene.with_values(goal=goal))

    def plan(self) -> PlanResult:
        """Plan from the present configuration to the goal, and keep the result.

        Raises:
            HplanError: As in `hplan.plan`.
        """
        self.result = plan(self.robot, self.scene_from_here, self._options)
        return self.result

    @property
    def scene_from_here(self) -> Scene:
        """The scene with the present configuration as its start, at rest."""
        return self.scene.with_values(start=Start(joints_rad=tuple(self.q.tolist())))

    def save(self, path: Path | str, *, replaces: bool = False) -> Path:
        """Save the scene, with the present configuration as its start; return the path.

        Args:
            path: The file.
            replaces: True to replace an existing file.

        Raises:
            OutputError: The file exists and is not to be replaced, or cannot be written.
        """
        file = file_path("path", path)
        if file.exists() and not replaces:
            raise OutputError(file, "it exists; choose another name, or replace it")
        return save_scene(self.scene_from_here, file)

    def _change(self, scene: Scene) -> None:
        with self._lock:
            self.scene, self._checker, self.result = scene, None, None


def contact_words(contact: Contact | None) -> str:
    """Describe a distance to the nearest obstacle in one sentence."""
    if contact is None:
        return "Nothing is near."
    millimetres = 1e3 * abs(contact.distance_m)
    if contact.distance_m > 0.0:
        return f"Link {contact.link!r} is clear of {contact.other_name} by {millimetres:.1f} mm."
    return f"CONTACT: link {contact.link!r} is {millimetres:.1f} mm deep in {contact.other_name}."
