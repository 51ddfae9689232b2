"""A torque-controlled arm among obstacles, simulated in MuJoCo step by step."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.execution.bending_wood import BendingTrees, WoodBodies, set_solver
from hplan.apps.execution.tree_response import TreeMonitor
from hplan.base.arguments import instance
from hplan.base.arrays import FloatArray, IntArray, numbers
from hplan.base.checked import NotNegative, Options, Positive
from hplan.base.lazy_import import extra
from hplan.collision.compliant_solids import maximum_deflection, pushing_links
from hplan.collision.held_objects import held_inertia, holding
from hplan.errors import InputError, RobotFileError
from hplan.geometry.cloud import Cloud
from hplan.robot.model import Robot
from hplan.scene.limb_contacts import limbs_of
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere
from hplan.scene.wood import Wood


@dataclass(frozen=True)
class Plant(Options):
    """Model errors unknown to the controller, and the controller's gains.

    Attributes:
        mass_factor: Ratio of the true masses and inertias to the URDF's.
        command_delay_s: Delay of the controller, which tracks the reference of this time before [s].
        bandwidth: Natural frequency of the position loop [rad/s].
        decoupled: Feed back errors as accelerations through the inertia matrix (computed torque), instead of joint by
            joint. Stiff independent loops of strongly coupled joints may not come to rest.
    """

    mass_factor: Positive = 1.0
    command_delay_s: NotNegative = 0.0
    bandwidth: Positive = 40.0
    decoupled: bool = False


#: Contact bits of the links that may not push compliant obstacles, and of the links that may.
_FIRM, _PUSHES = 1, 2


def import_mujoco() -> ModuleType:
    """Import the module `mujoco`.

    Raises:
        InputError: MuJoCo is not installed.
    """
    with extra("execution", "executing a motion needs MuJoCo"):
        import mujoco
    module: ModuleType = mujoco
    return module


def mujoco_model(
    mujoco: ModuleType,
    robot: Robot,
    scene: Scene,
    *,
    timestep_s: float,
    trees: BendingTrees | None = None,
    bending: Collection[str] | None = None,
    picked: Collection[str] = (),
) -> tuple[Any, dict[int, str], WoodBodies | None]:
    """Build the MuJoCo model of the arm, with motors, among the obstacles.

    Args:
        mujoco: The module.
        robot: The arm; MuJoCo reads its URDF. Each joint gets a motor limited to the joint's torque limit.
        scene: The obstacles.
        timestep_s: Step of the simulation [s].
        trees: Properties of limbs that bend and fruit that hang; None for rigid ones.
        bending: Names of the limbs that bend, and of the fruit that hang; None for all.
        picked: Names of fruit that is picked besides the goal fruit.

    Returns:
        The compiled `MjModel`, the obstacle's name by the number of each of its geometries, and the bodies of limbs and
        fruit, if they bend.

    Raises:
        InputError: A cloud has more than 2,000 balls.
        MovingObstacleError: An obstacle of the scene moves.
        RobotFileError: MuJoCo refuses the URDF.
    """
    try:
        text = robot.urdf_text
        spec = mujoco.MjSpec.from_file(str(robot.urdf_path)) if text is None else mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise RobotFileError(robot.urdf_path, f"MuJoCo refuses it: {error}") from error
    for mesh in spec.meshes:
        mesh.file = _mesh_file(mesh.file, robot.urdf_path.parent)
    spec.option.timestep = timestep_s
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    # Limbs that bend have no permitted depth.
    solids = (scene if trees is None else scene.copy_unchecked({"wood": None})).solids
    goals = [fruit for fruit in scene.fruits if fruit.name == scene.goal.fruit or fruit.name in picked]
    hanging = {name for fruit in goals for name in fruit.hangs_from}
    depths = maximum_deflection(robot, solids, scene.yield_links, hanging)
    pushing = () if depths is None else pushing_links(robot, scene.yield_links)
    _add_held(mujoco, spec, robot)
    for geom in spec.geoms:
        # MuJoCo checks two geometries if contype of one and conaffinity of the other share a bit. Links have a contype
        # only and obstacles a conaffinity only, so contacts are between the arm and obstacles.
        meets = _PUSHES if geom.parent.name in pushing else _FIRM
        geom.contype, geom.conaffinity = meets if geom.contype or geom.conaffinity else 0, 0
    # Links between two joints of one MJCF body have no mass, which MuJoCo does not compile.
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-12, 1e-14
    rotors = np.array(robot.model.armature).tolist()
    for name, limit, rotor in zip(robot.joint_names, robot.torque_limit.tolist(), rotors, strict=True):
        spec.joint(name).armature = rotor
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)  # a motor, of gain 1
        motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]
    names = {}
    wood = None if trees is None else _add_wood(mujoco, spec, scene, trees, bending)
    if trees is not None:
        set_solver(mujoco, spec, sleeps=True)
    bent = set() if wood is None else set(wood.obstacle_of.values())
    for number, obstacle in enumerate(solids):
        if obstacle.name in bent:
            continue
        # A compliant obstacle resists a link that may push it only from the permitted depth on: MuJoCo applies forces
        # at distances below the margin, and reports contacts at distances below margin + gap, which is 0 here.
        yields = 0.0 if depths is None else float(depths[number])
        sides = [(_FIRM, 0.0), (_PUSHES, yields)] if yields > 0.0 else [(_FIRM | _PUSHES, 0.0)]
        if obstacle.meets != "all":  # a limb has solids of its own for the links that may push it, and for the others
            sides = [(_FIRM, 0.0)] if obstacle.meets == "others" else [(_PUSHES, yields)]
        for part, (shape, (meets, gap)) in enumerate(product(_shapes(mujoco, spec, obstacle, number), sides)):
            label = f"obstacle:{number}:{part}"
            names[label] = obstacle.name
            spec.worldbody.add_geom(name=label, contype=0, conaffinity=meets, margin=-gap, gap=gap, **shape)
    try:
        model = spec.compile()
    except ValueError as error:
        raise RobotFileError(robot.urdf_path, f"MuJoCo refuses it: {error}") from error
    names |= {} if wood is None else wood.obstacle_of
    return model, {model.geom(label).id: name for label, name in names.items()}, wood


def _add_held(mujoco: ModuleType, spec: Any, robot: Robot) -> None:
    """Add the objects that the arm holds to the bodies that carry them, with their masses."""
    for number, item in enumerate(robot.attached):
        frame = robot.model.frames[robot.frame_number(item.name)]
        carrier = spec.worldbody
        if frame.parentJoint > 0:
            carrier = spec.joint(robot.joint_names[frame.parentJoint - 1]).parent
        body = carrier.add_body(name=item.name, **_pose(frame.placement))
        for solid in item.object.solids:
            for shape in _shapes(mujoco, spec, solid, f"held:{number}"):
                body.add_geom(mass=0.0, **shape)
        inertia = held_inertia(item)
        if inertia.mass > 0.0:
            body.explicitinertial, body.mass, body.ipos = True, inertia.mass, inertia.lever
            # The diagonal, then the three values above it.
            body.fullinertia = inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _pose(place: pin.SE3) -> dict[str, Any]:
    """A pose as arguments of a MuJoCo body."""
    turn = pin.Quaternion(place.rotation)
    return {"pos": place.translation, "quat": [turn.w, turn.x, turn.y, turn.z]}


def _add_wood(
    mujoco: ModuleType, spec: Any, scene: Scene, trees: BendingTrees, bending: Collection[str] | None
) -> WoodBodies:
    """Add limbs and fruit; the goal fruit hangs on its limb, but touches nothing."""
    limbs = limbs_of(scene.obstacles, scene.wood or Wood())
    if bending is None:
        bending = {*limbs.names, *(fruit.name for fruit in scene.fruits)}
    goal = scene.goal_fruit
    wood = WoodBodies(mujoco, spec, limbs, scene.wood or Wood(), trees, meets=_FIRM | _PUSHES)
    wood.add_limbs(bending)
    wood.add_fruits(scene.fruits, bending, without_contact=() if goal is None else (goal.name,))
    return wood


def _mesh_file(name: str, folder: Path) -> str:
    """Path of a URDF mesh, resolved as Pinocchio does.

    MuJoCo does not resolve URLs, and its parser keeps only one slash after the scheme.
    """
    scheme, colon, rest = name.partition(":")
    if colon and scheme == "package":
        return str((folder / rest.lstrip("/")).resolve())
    if colon and scheme == "file":
        return "/" + rest.lstrip("/")
    return str((folder / name).resolve())


def _shapes(mujoco: ModuleType, spec: Any, obstacle: Solid, number: int | str) -> list[dict[str, Any]]:
    """Arguments of the MuJoCo geometries that represent an obstacle."""
    kinds = mujoco.mjtGeom
    if isinstance(obstacle, Sphere):
        return [{"type": kinds.mjGEOM_SPHERE, "pos": obstacle.center, "size": [obstacle.radius, 0.0, 0.0]}]
    if isinstance(obstacle, Capsule):
        size = [obstacle.radius, 0.0, 0.0]
        if math.dist(obstacle.start, obstacle.end) < 1e-9:
            return [{"type": kinds.mjGEOM_SPHERE, "pos": obstacle.start, "size": size}]
        return [{"type": kinds.mjGEOM_CAPSULE, "fromto": [*obstacle.start, *obstacle.end], "size": size}]
    if isinstance(obstacle, Box | Cylinder):
        turn = pin.Quaternion(obstacle.rotation)
        if isinstance(obstacle, Box):
            kind, size = kinds.mjGEOM_BOX, [0.5 * side for side in obstacle.size]
        else:
            kind, size = kinds.mjGEOM_CYLINDER, [obstacle.radius, 0.5 * obstacle.length, 0.0]
        return [{"type": kind, "pos": obstacle.center, "quat": [turn.w, turn.x, turn.y, turn.z], "size": size}]
    # Maximum number of balls of a cloud, which bounds the cost of the simulation.
    most_balls = 2_000
    if isinstance(obstacle, Cloud):
        if len(obstacle.core) > most_balls:
            raise InputError(
                f"obstacle {obstacle.name!r} has {len(obstacle.core)} balls, too many for MuJoCo; downsample it to "
                f"at most {most_balls} points to execute the motion",
                obstacle=obstacle.name,
                balls=len(obstacle.core),
            )
        size = [obstacle.rounding, 0.0, 0.0]
        return [{"type": kinds.mjGEOM_SPHERE, "pos": center, "size": size} for center in obstacle.core]
    name = f"obstacle:{number}"
    mesh = spec.add_mesh(name=name, uservert=obstacle.hull.grown_corners.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # small hulls have too little volume for a solid inertia
    return [{"type": kinds.mjGEOM_MESH, "meshname": name}]


#: Period of the controller [s].
CONTROL_PERIOD = 1e-3

#: Trees settle in the wind in longer steps until this time before the motion, and these steps [s].
_SETTLES_FINELY_S, _COARSE_STEP_S = 2.0, 4e-3


@dataclass(frozen=True)
class Touch:
    """Contact of a link and an obstacle in a simulation.

    Attributes:
        time_s: Time of the first contact [s].
        link: Name of the link in the URDF.
        obstacle: Name of the obstacle.
        depth_m: Maximum penetration depth [m].
        yields_m: Permitted deflection of the obstacle by this link [m]; 0 if it is rigid.
    """

    time_s: float
    link: str
    obstacle: str
    depth_m: float
    yields_m: float = 0.0

    @property
    def is_push(self) -> bool:
        """True if the obstacle is compliant and its deflection stayed permitted."""
        return 0.0 < self.yields_m >= self.depth_m


class SimulatedArm:
    """An arm in MuJoCo among the obstacles and fruits of a scene.

    Joints are in the robot's order. Torques saturate at the motors' limits. Contacts with obstacles exert forces and
    are recorded. A compliant obstacle exerts forces only beyond its permitted deflection; the obstacles that picked
    fruit hangs from are compliant at all times. The simulation has no self-collisions and no ground. The
    arm is at the zero configuration until it is placed. With `trees`, limbs bend and fruit hang instead
    (`hplan.apps.execution.bending_wood`); contacts with them are not among `contacts` and `pushes`.

    Attributes:
        robot: The arm.
        plant: Deviation of the simulated machine from the controller's model.
        trees: Measurements of limbs that bend and of fruit that hangs; None if they are rigid.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        plant: Plant | None = None,
        *,
        trees: BendingTrees | None = None,
        bending: Collection[str] | None = None,
        picked: Collection[str] = (),
        substeps: int = 4,
    ) -> None:
        """Build the model.

        Args:
            robot: The arm; MuJoCo reads its URDF.
            scene: The obstacles. Its goal fruit is left out.
            plant: Deviation of the simulated machine from the controller's model; None for an exact model.
            trees: Properties of limbs that bend and fruit that hang; None for rigid and yielding obstacles.
            bending: Names of the limbs that bend, and of the fruit that hang; None for all. Others are rigid.
            picked: Names of fruit that is picked besides the goal fruit.
            substeps: Simulation steps for each control period.

        Raises:
            InputError: MuJoCo is not installed, or a cloud has more than 2,000 balls.
            MovingObstacleError: An obstacle of the scene moves.
            RobotFileError: MuJoCo refuses the URDF.
        """
        instance("scene", scene, Scene, "load_scene")
        self.robot = robot = holding(instance("robot", robot, Robot, "load_robot"), scene.attached)
        self.plant = Plant() if plant is None else plant
        self._mujoco = import_mujoco()
        self._model, self._obstacle_of, wood = mujoco_model(
            self._mujoco, robot, scene, timestep_s=CONTROL_PERIOD / substeps, trees=trees, bending=bending,
            picked=picked,
        )  # fmt: skip
        factor = np.full(self._model.nbody, self.plant.mass_factor)
        factor[[self._model.body(name).id for name in (() if wood is None else wood.body_names)]] = 1.0
        self._model.body_mass[:] *= factor
        self._model.body_inertia[:] *= factor[:, None]
        self._data = self._mujoco.MjData(self._model)
        self.trees = None if wood is None else TreeMonitor(self._mujoco, self._model, self._data, wood)
        joints = [self._model.joint(name) for name in robot.joint_names]
        self._q_at = np.array([int(joint.qposadr[0]) for joint in joints])
        self._v_at = np.array([int(joint.dofadr[0]) for joint in joints])
        self._link_of = [self._model.body(body).name for body in self._model.geom_bodyid.tolist()]
        self._motors = np.array([self._model.actuator(name).id for name in robot.joint_names])
        self._pin_data = robot.model.createData()
        self._is_lower = np.tri(robot.dof, k=-1, dtype=np.bool_)
        self._touched: dict[tuple[str, str], Touch] = {}
        self._substeps = substeps

    @property
    def time_s(self) -> float:
        """Time since the model was built [s]."""
        return float(self._data.time)

    @property
    def position(self) -> FloatArray:
        """(dof,) joint positions [rad, or m if prismatic]."""
        return np.array(self._data.qpos[self._q_at])

    @property
    def velocity(self) -> FloatArray:
        """(dof,) joint velocities [rad/s, or m/s if prismatic]."""
        return np.array(self._data.qvel[self._v_at])

    @property
    def is_finite(self) -> bool:
        """False if the simulation diverged."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.velocity).all())

    @property
    def contacts(self) -> tuple[Touch, ...]:
        """Recorded contacts in order of first touch, without permitted deflections."""
        return tuple(touch for touch in self._touched.values() if not touch.is_push)

    @property
    def pushes(self) -> tuple[Touch, ...]:
        """Recorded permitted deflections of compliant obstacles, in order of first touch."""
        return tuple(touch for touch in self._touched.values() if touch.is_push)

    def place(self, position: ArrayLike, velocity: ArrayLike | None = None) -> None:
        """Set the state of the arm and record contacts there.

        Args:
            position: (dof,) configuration [rad, or m if prismatic].
            velocity: (dof,) joint velocities [rad/s, or m/s if prismatic]; None for rest.

        Raises:
            InputError: `position` or `velocity` has another shape or a value that is not finite.
        """
        size = (self.robot.dof,)
        self._data.qpos[self._q_at] = numbers("position", position, size)
        self._data.qvel[self._v_at] = 0.0 if velocity is None else numbers("velocity", velocity, size)
        self._mujoco.mj_forward(self._model, self._data)
        self._note_contacts()

    def settle(self, position: ArrayLike) -> None:
        """Hold a configuration until trees sway in the wind, which is the time 0.

        Args:
            position: (dof,) configuration [rad, or m if prismatic].

        Raises:
            InputError: `position` has another shape or a value that is not finite.
        """
        self.place(position)
        if self.trees is not None and self.trees.settle_s > 0.0:
            rest, hold, settle_s = np.zeros(self.robot.dof), self.position, self.trees.settle_s
            ticks = math.ceil(min(settle_s, _SETTLES_FINELY_S) / CONTROL_PERIOD)
            steps = math.ceil((settle_s - ticks * CONTROL_PERIOD) / _COARSE_STEP_S - 1e-9)
            self._data.time = -ticks * CONTROL_PERIOD - steps * _COARSE_STEP_S
            fine_s = self.trees.change_step(_COARSE_STEP_S)
            for _ in range(steps):
                self.trees.blow()
                self._mujoco.mj_step(self._model, self._data)
                self._note_contacts()
                self._data.qpos[self._q_at], self._data.qvel[self._v_at] = hold, 0.0
            self.trees.change_step(fine_s)
            for _ in range(ticks):
                self.follow(hold, rest, rest)
        self._data.time = 0.0
        self.place(position)

    def pass_through(self, names: Sequence[str]) -> None:
        """Disable contacts with obstacles or fruits, for example with a picked fruit.

        Fruit that hangs is taken off its stalk.

        Raises:
            InputError: The simulated scene has no obstacle or fruit of that name.
        """
        self.ignore_contacts(names)
        if self.trees is not None:
            self.trees.release(names)

    def ignore_contacts(self, names: Sequence[str]) -> None:
        """Disable contacts with obstacles or fruits, for example with a fruit to be picked; it still hangs.

        Raises:
            InputError: The simulated scene has no obstacle or fruit of that name.
        """
        for name in names:
            self._model.geom_conaffinity[self._geoms(name)] = 0

    def _geoms(self, name: str) -> list[int]:
        """Numbers of the geometries of an obstacle or fruit."""
        geoms = [geom for geom, obstacle in self._obstacle_of.items() if obstacle == name]
        if not geoms:
            raise InputError(f"the simulated scene has no obstacle {name!r}", name=name)
        return geoms

    def distance_to_fruit(self, name: str) -> float:
        """Distance of the tool from the centre of a fruit [m]; infinite if it is off its stalk.

        Raises:
            InputError: The simulated scene has no fruit of that name.
        """
        (geom,) = self._geoms(name)
        if self.trees is not None and self.trees.is_released(name):
            return math.inf
        return math.dist(self.robot.tool_positions(self.position), self._data.geom_xpos[geom])

    def take_away(self, names: Sequence[str]) -> None:
        """Remove obstacles or fruits: contacts and rays ignore them.

        Raises:
            InputError: The simulated scene has no obstacle or fruit of that name.
        """
        self.pass_through(names)
        gone = [geom for geom, obstacle in self._obstacle_of.items() if obstacle in names]
        self._model.geom_rgba[gone, 3] = 0.0  # MuJoCo's rays ignore geometries of opacity 0

    def advance(self, torque: FloatArray) -> None:
        """Simulate one control period with constant torques.

        Args:
            torque: (dof,) motor torques, clipped to the motors' limits [N m, or N if prismatic].
        """
        limit = self.robot.torque_limit
        self._data.ctrl[self._motors] = np.clip(torque, -limit, limit)
        if self.trees is not None:
            self.trees.blow()
        for step in range(self._substeps):
            self._mujoco.mj_step(self._model, self._data)
            self._note_contacts(if_touched=step < self._substeps - 1)

    def follow(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Simulate one control period of a computed-torque controller.

        Args:
            position: (dof,) reference [rad, or m if prismatic].
            velocity: (dof,) its velocity.
            acceleration: (dof,) its acceleration.

        Returns:
            (dof,) commanded torques, before clipping to the limits [N m, or N if prismatic].
        """
        torque = self.feed_forward(position, velocity, acceleration) + self.feedback(position, velocity)
        self.advance(torque)
        return torque

    def feed_forward(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        """(dof,) inverse dynamics of a state in the controller's model [N m]."""
        return np.asarray(pin.rnea(self.robot.model, self._pin_data, position, velocity, acceleration))

    def feedback(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        r"""(dof,) torques of the feedback through the inertia matrix [N m].

        .. math::
            \tau = M(q_d) \left( \omega^2 (q_d - q) + 2 \omega (\dot q_d - \dot q) \right)

        with the plant's bandwidth :math:`\omega`.
        """
        bandwidth = self.plant.bandwidth
        error = bandwidth * (position - self.position) + 2.0 * (velocity - self.velocity)
        return self.inertia(position) @ (bandwidth * error)

    def inertia(self, position: FloatArray) -> FloatArray:
        """(dof, dof) symmetric inertia matrix of the controller's model."""
        found = np.asarray(pin.crba(self.robot.model, self._pin_data, position))
        return np.where(self._is_lower, found.T, found)  # Pinocchio computes the upper triangle

    def cast_rays(self, origin: ArrayLike, directions: FloatArray) -> tuple[FloatArray, IntArray]:
        """Distances along rays to the first hit, the arm included.

        Args:
            origin: (3,) common origin of the rays, in `base_link` [m].
            directions: (n, 3) directions, of any length.

        Returns:
            (n,) distances [m], infinite without a hit, and (n,) labels, 1 if the hit is an obstacle, else 0.

        Raises:
            InputError: `origin` or `directions` has another shape or a value that is not finite.
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

    def _note_contacts(self, *, if_touched: bool = False) -> None:
        """Record the first time and the maximum depth of all current contacts; those with wood go to `trees`.

        Args:
            if_touched: True to measure trees only if they are touched.
        """
        wood: dict[tuple[str, str], list[int]] = {}
        for number in range(self._data.ncon):
            contact = self._data.contact[number]
            geoms = contact.geom.tolist()
            one, other = geoms if geoms[0] in self._obstacle_of else geoms[::-1]
            obstacle, link = self._obstacle_of[one], self._link_of[other]
            if self.trees is not None and obstacle in self.trees.measured:
                wood.setdefault((link, obstacle), []).append(number)
                continue
            depth = max(0.0, -float(contact.dist))
            yields = max(float(self._model.geom_gap[geom]) for geom in geoms)
            first = self._touched.get((link, obstacle), Touch(float(self._data.time), link, obstacle, 0.0, yields))
            self._touched[link, obstacle] = replace(first, depth_m=max(first.depth_m, depth))
        if self.trees is not None and (wood or not if_touched):
            self.trees.note(wood)
