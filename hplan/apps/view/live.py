"""A live view in viser (extra `viser`): the arm among a scene, in a browser, put wherever a program says.

The page of a motion needs neither server nor network; this is for looking on while a program runs. Pinocchio draws the
arm (`pinocchio.visualize.ViserVisualizer`).
"""

from __future__ import annotations

import time
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.view import scenery
from hplan.apps.view.playback import playable
from hplan.base.arguments import instance, number, whole
from hplan.base.arrays import numbers
from hplan.base.lazy_import import extra
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import PointCloud

if TYPE_CHECKING:
    from hplan.apps.view.playback import Shown


class LiveScene(AbstractContextManager["LiveScene"]):
    """A viser server with an arm and a scene; `close` ends it, as does leaving a `with` block.

    Attributes:
        server: The `viser.ViserServer`, for whatever else is to be drawn.
        url: Its address, for a browser on this machine.
    """

    def __init__(self, robot: Robot, scene: Scene, *, port: int = 8080) -> None:
        """Start the server and draw what stands still; the arm is at the scene's start.

        Args:
            port: Where it listens, or at the next one that is free.

        Raises:
            InputError: viser is not installed, or the start does not fit the robot.
            OptionError: No robot, scene or port.
        """
        instance("robot", robot, Robot, "load_robot")
        instance("scene", scene, Scene, "load_scene")
        whole("port", port, 0, 65535)
        with extra("viser", "a live view needs viser"):
            import viser
            from pinocchio.visualize import ViserVisualizer
        start = robot.check_configuration(robot.joints_of(scene.start, "start"), "start")
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
        """Draw a scene in place of the one that is there.

        Args:
            time_s: Time at which what moves is drawn, as its tracks count it [s].
        """
        still, draw = scene.at(number("time_s", time_s, "a time in seconds")), self.server.scene
        draw.remove_by_name("/scene")  # with all below it
        draw.add_frame("/scene", show_axes=False)
        for item in still.obstacles:
            look, name = scenery.look_of(item.name), f"/scene/{item.name.replace('/', ' ')}"
            color = tuple(look.color.to_bytes(3))
            if isinstance(item, PointCloud):
                points = np.concatenate([solid.core for solid in item.solids])
                size = 2.0 * max(solid.rounding for solid in item.solids)
                draw.add_point_cloud(name, points, color, point_size=size, point_shape="circle")
            else:
                draw.add_mesh_simple(name, *item.surface, color=color, opacity=look.opacity, flat_shading=True)
        for fruit in still.fruits:
            name = f"/scene/{fruit.name.replace('/', ' ')}"
            draw.add_icosphere(name, radius=fruit.radius, color=(215, 38, 61), position=fruit.center)

    def show(self, q: ArrayLike) -> None:
        """Put the arm at a (dof,) configuration, wherever its joint limits are.

        Raises:
            InputError: No list of as many finite numbers.
        """
        self._arm.display(np.array(numbers("q", q, (self._robot.dof,))))

    def play(self, result: Shown, speed: float = 1.0) -> None:
        """Run a motion once, in real time or so many times as fast; returns at its end.

        Raises:
            OptionError: No result with a motion, or a speed that is not positive.
        """
        number("speed", speed, "a positive number", lambda value: value > 0.0)
        trajectory = playable(result)[2].trajectory
        begin = time.monotonic()
        while (now := speed * (time.monotonic() - begin)) < trajectory.duration:
            self.show(trajectory.state_at(now)[0])
            time.sleep(0.02)
        self.show(trajectory.position[-1])

    def close(self) -> None:
        """End the server."""
        self.server.stop()

    def __exit__(self, *_: object) -> None:
        self.close()
