"""A simulated arm with torque motors among a scene's obstacles (MuJoCo), advanced one control period at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.execution.mujoco_model import import_mujoco, mujoco_model
from hplan.apps.execution.plant import Plant
from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, IntArray, numbers
from hplan.errors import InputError
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Period of the controller [s].
CONTROL_PERIOD = 1e-3

#: Steps of the simulation for each of the controller's.
_SUBSTEPS = 4


@dataclass(frozen=True)
class Touch:
    """Contact of a link and an obstacle in a simulation.

    Attributes:
        time_s: When they first did [s].
        link: The link, by its name in the URDF.
        depth_m: Largest depth to which one was pushed into the other [m].
        yields_m: How deep the link may push it [m].
    """

    time_s: float
    link: str
    obstacle: str
    depth_m: float
    yields_m: float = 0.0

    @property
    def is_push(self) -> bool:
        """True if the obstacle gives way to the link, and was not pushed deeper than it may be."""
        return 0.0 < self.yields_m >= self.depth_m


class SimulatedArm:
    """An arm in MuJoCo among the obstacles and fruits of a scene; joints are in the robot's order.

    The motors give no more than their limits. Contacts with obstacles push back, and are noted; what gives way pushes
    back where it is pushed deeper than it yields, what the scene's goal fruit hangs from at any time. The arm does not
    touch itself or the ground. It stands at zero until it is placed.

    Attributes:
        plant: How the simulated machine differs from what its controller believes.
    """

    def __init__(self, robot: Robot, scene: Scene, plant: Plant | None = None) -> None:
        """Build the model.

        Args:
            robot: The arm; MuJoCo reads its URDF.
            scene: The obstacles. The fruit that is its goal is left out.
            plant: How the simulated machine differs; None where it does not.

        Raises:
            InputError: MuJoCo is not installed, or a cloud has too many points for it.
            RobotFileError: MuJoCo refuses the URDF.
        """
        self.robot, self.plant = instance("robot", robot, Robot, "load_robot"), Plant() if plant is None else plant
        self._mujoco = import_mujoco()
        instance("scene", scene, Scene, "load_scene")
        self._model, self._obstacle_of = mujoco_model(self._mujoco, robot, scene, timestep_s=CONTROL_PERIOD / _SUBSTEPS)
        self._model.body_mass[:] *= self.plant.mass_factor
        self._model.body_inertia[:] *= self.plant.mass_factor
        self._data = self._mujoco.MjData(self._model)
        joints = [self._model.joint(name) for name in robot.joint_names]
        self._q_at = np.array([int(joint.qposadr[0]) for joint in joints])
        self._v_at = np.array([int(joint.dofadr[0]) for joint in joints])
        self._motors = np.array([self._model.actuator(name).id for name in robot.joint_names])
        self._pin_data = robot.model.createData()
        self._touched: dict[tuple[str, str], Touch] = {}

    @property
    def time_s(self) -> float:
        """Time since the model was built [s]."""
        return float(self._data.time)

    @property
    def position(self) -> FloatArray:
        """(dof,) where the joints are."""
        return np.array(self._data.qpos[self._q_at])

    @property
    def velocity(self) -> FloatArray:
        """(dof,) how fast they turn [rad/s]."""
        return np.array(self._data.qvel[self._v_at])

    @property
    def is_finite(self) -> bool:
        """False where the simulation ran away."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.velocity).all())

    @property
    def contacts(self) -> tuple[Touch, ...]:
        """Pairs that have touched so far, in the order of their first touch, but for those that are pushes."""
        return tuple(touch for touch in self._touched.values() if not touch.is_push)

    @property
    def pushes(self) -> tuple[Touch, ...]:
        """Links that have pushed what gives way to them so far, no deeper than it may be, in that order."""
        return tuple(touch for touch in self._touched.values() if touch.is_push)

    def place(self, position: ArrayLike, velocity: ArrayLike | None = None) -> None:
        """Put the arm somewhere, at rest unless a velocity is given.

        Args:
            position: (dof,) configuration.
            velocity: (dof,) [rad/s].

        Raises:
            InputError: Another number of joints, or values that are not finite.
        """
        size = (self.robot.dof,)
        self._data.qpos[self._q_at] = numbers("position", position, size)
        self._data.qvel[self._v_at] = 0.0 if velocity is None else numbers("velocity", velocity, size)
        self._mujoco.mj_forward(self._model, self._data)
        self._note_contacts()

    def pass_through(self, names: Sequence[str]) -> None:
        """Let the arm pass through the obstacles or fruits of some names: what it picks, or has picked.

        Raises:
            InputError: There is none of that name.
        """
        for name in names:
            geoms = [geom for geom, obstacle in self._obstacle_of.items() if obstacle == name]
            if not geoms:
                raise InputError(f"the simulated scene has no obstacle {name!r}", name=name)
            self._model.geom_conaffinity[geoms] = 0

    def take_away(self, names: Sequence[str]) -> None:
        """Take obstacles or fruits of some names away: nothing touches them any more, and no ray meets them.

        Raises:
            InputError: There is none of that name.
        """
        self.pass_through(names)
        gone = [geom for geom, obstacle in self._obstacle_of.items() if obstacle in names]
        self._model.geom_rgba[gone, 3] = 0.0  # rays go through what cannot be seen

    def advance(self, torque: FloatArray) -> None:
        """Go on for one control period with (dof,) torques, as far as the motors give them [N m]."""
        limit = self.robot.torque_limit
        self._data.ctrl[self._motors] = np.clip(torque, -limit, limit)
        for _ in range(_SUBSTEPS):
            self._mujoco.mj_step(self._model, self._data)
            self._note_contacts()

    def follow(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Go on for one control period as a computed-torque controller does that follows a (dof,) reference.

        Returns:
            (dof,) torques that it asks for [N m].
        """
        torque = self.feed_forward(position, velocity, acceleration) + self.feedback(position, velocity)
        self.advance(torque)
        return torque

    def feed_forward(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(dof,) torques that a state needs by the controller's own model [N m]."""
        return np.asarray(pin.rnea(self.robot.model, self._pin_data, position, velocity, acceleration))

    def feedback(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """(dof,) torques against the error, which is fed back as an acceleration through the inertia matrix [N m]."""
        bandwidth = self.plant.bandwidth
        error = bandwidth * (position - self.position) + 2.0 * (velocity - self.velocity)
        return self.inertia(position) @ (bandwidth * error)

    def inertia(self, position: FloatArray) -> FloatArray:
        """(dof, dof) inertia matrix that the controller knows, symmetric."""
        upper = np.triu(pin.crba(self.robot.model, self._pin_data, position))
        return np.asarray(upper + np.triu(upper, 1).T)

    def cast_rays(self, origin: ArrayLike, directions: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distances along rays to whatever they meet first, the arm included.

        Args:
            origin: (3,) where all rays begin, in `base_link` [m].
            directions: (n, 3) their directions, of any length.

        Returns:
            (n,) distances [m], infinite where nothing is met, and (n,) 1 where it is an obstacle, else 0.

        Raises:
            InputError: An origin that is no finite point, or directions of another shape.
        """
        point = np.array(numbers("origin", origin, (3,)))
        rays = np.array(numbers("directions", directions, (None, 3)))
        lengths = np.linalg.norm(rays, axis=1)
        geoms, found = np.full(len(rays), -1, dtype=np.int32), np.full(len(rays), -1.0)
        unit = rays / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        self._mujoco.mj_multiRay(
            self._model, self._data, point, unit.ravel(), None, 1, -1, geoms, found, None, len(rays), math.inf
        )
        is_obstacle = np.isin(geoms, list(self._obstacle_of)).astype(np.int64)
        return np.where(geoms >= 0, found, np.inf), is_obstacle

    def _note_contacts(self) -> None:
        """Keep the first time and the largest depth of each pair that touches now."""
        for number in range(self._data.ncon):
            contact = self._data.contact[number]
            geoms = [int(geom) for geom in contact.geom]
            obstacle = next(self._obstacle_of[geom] for geom in geoms if geom in self._obstacle_of)
            other = next(geom for geom in geoms if geom not in self._obstacle_of)
            link = self._model.body(self._model.geom_bodyid[other]).name
            depth = max(0.0, -float(contact.dist))
            yields = max(float(self._model.geom_gap[geom]) for geom in geoms)
            first = self._touched.get((link, obstacle), Touch(float(self._data.time), link, obstacle, 0.0, yields))
            self._touched[link, obstacle] = replace(first, depth_m=max(first.depth_m, depth))
