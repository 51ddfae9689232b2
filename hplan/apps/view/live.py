"""Live view of arm and scene in a browser.

The view uses viser (extra `viser`).

It shows the state of a running program; the page of a finished motion needs neither server nor network. Pinocchio draws
the arm (`pinocchio.visualize.ViserVisualizer`).
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.view import scenery
from hplan.apps.view.playback import playable
from hplan.base.arguments import check_integer, instance, number
from hplan.base.arrays import numbers
from hplan.base.lazy_import import extra
from hplan.collision.held_objects import holding
from hplan.robot.model import Robot
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene
from hplan.scene.obstacles import AnyObstacle, PointCloud

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown


class LiveScene:
    """A viser server with an arm and a scene.

    `close`, or the end of a `with` block, stops the server.

    Attributes:
        server: The `viser.ViserServer`, to draw more objects.
        url: Address of the server for a browser on this machine.
    """

    def __init__(self, robot: Robot, scene: Scene, *, port: int = 8080) -> None:
        """Start the server; draw the scene and the arm at its start.

        Args:
            robot: The arm.
            scene: The scene.
            port: Port of the server; the next free one if it is in use.

        Raises:
            InputError: viser is not installed, or the start does not fit the robot.
            OptionError: An argument of another type, or a port outside 0 to 65535.
        """
        instance("robot", robot, Robot, "load_robot")
        instance("scene", scene, Scene, "load_scene")
        check_integer("port", port, 0, 65535)
        with extra("viser", "a live view needs viser"):
            import viser
            from pinocchio.visualize import ViserVisualizer
        robot, start = holding(robot, scene.attached).about_start(scene.start)
        self._robot = robot
        self.server: Any = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
        self.url = f"http://127.0.0.1:{self.server.get_port()}"
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/ground", width=8.0, height=8.0)
        self._arm = ViserVisualizer(robot.model, pin.GeometryModel(), robot.visual_model)
        self._arm.initViewer(viewer=self.server, loadModel=True)
        self.set_scene(scene)
        self.show(start)

    def set_scene(self, scene: Scene, time_s: float = 0.0) -> None:
        """Draw a scene in place of the previous one.

        Args:
            scene: The scene.
            time_s: Time of the moving obstacles, on the clock of their tracks [s].

        Raises:
            OptionError: `time_s` is not a number.
        """
        still, draw = scene.snapshot(number("time_s", time_s, "a time in seconds")), self.server.scene
        draw.remove_by_name("/scene")  # and all nodes below it
        draw.add_frame("/scene", show_axes=False)
        for item in (*still.obstacles, *still.fruits):
            self.draw_item(item)

    def draw_item(self, item: AnyObstacle | Fruit) -> None:
        """Draw an obstacle or a fruit in place of the one of the same name."""
        draw, name = self.server.scene, f"/scene/{item.name.replace('/', ' ')}"
        if isinstance(item, Fruit):
            draw.add_icosphere(name, radius=item.radius, color=(215, 38, 61), position=item.center)
            return
        look = scenery.look_of(item.name)
        color = tuple(look.color.to_bytes(3))
        if isinstance(item, PointCloud):
            points = np.concatenate([solid.core for solid in item.solids])
            size = 2.0 * max(solid.rounding for solid in item.solids)
            draw.add_point_cloud(name, points, color, point_size=size, point_shape="circle")
        else:
            draw.add_mesh_simple(name, *item.surface, color=color, opacity=look.opacity, flat_shading=True)

    def show(self, q: ArrayLike) -> None:
        """Show the arm at a (dof,) configuration, without checking joint limits.

        Raises:
            InputError: `q` does not have `dof` finite numbers.
        """
        self._arm.display(np.array(numbers("q", q, (self._robot.dof,))))

    def play(self, result: Shown, speed: float = 1.0) -> None:
        """Play a motion once; return when it ends.

        Args:
            result: The result of a planner.
            speed: Playback speed relative to real time.

        Raises:
            OptionError: `result` has no motion, or `speed` is not positive.
        """
        number("speed", speed, "a positive number", lambda value: value > 0.0)
        trajectory = playable(result)[2].trajectory
        begin = time.monotonic()
        while (now := speed * (time.monotonic() - begin)) < trajectory.duration:
            self.show(trajectory.state_at(now)[0])
            time.sleep(0.02)
        self.show(trajectory.position[-1])

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
