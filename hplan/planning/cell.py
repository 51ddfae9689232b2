"""Cells: several arms beside one another, and what is certified of their motions.

A cell is one robot (`hplan.robot.several`): a tree of joints in which every body of one arm against every body of
another is a pair of its own, so that what is planned, certified, stopped or spliced for any robot holds for all arms
at once. What is certified is shown twice: each arm among the obstacles, with the fruit that it reaches for, and all
bodies of different arms against one another, over continuous time.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pinocchio as pin

from hplan.base.arguments import file_path, instance
from hplan.base.arrays import FloatArray, IntArray, Record, readonly
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate, GoalContact, certify
from hplan.certificate.goal_contact import FruitContact
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.flat_bodies import BODIES
from hplan.collision.touching_pairs import self_pairs
from hplan.errors import InputError, OptionError
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.several import joined_robots
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.file import read_model
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import moved
from hplan.scene.obstacles import AnyObstacle, Capsule, Mesh, Sphere
from hplan.scene.solids import CUBE_CORNERS, rpy_rotation, whole_hull
from hplan.trajectory.cubics import Rows, evaluate
from hplan.trajectory.trajectory import Retimed, Trajectory, stopped

#: How a cell's motions were found.
How = Literal["at once", "one later", "around each other"]

#: Rows nearer to each other than this are one [s].
_SAME_S: Final = 1e-6


@dataclass(frozen=True, eq=False)
class CellArm(Record):
    """One arm of a cell.

    Attributes:
        name: Its name in the cell.
        robot: The arm by itself.
        scene: The cell as the arm's base sees it, and the arm's task; its goal is where it starts, if it has none.
        joints: (dof,) which joints of the cell's robot are its own.
        base: Where the frame of `robot` and `scene` is in the cell's.
        is_waiting: True if it has no goal and stays where it is.
        drop_off: Where on a tour it lets fruit go, as its base sees it; None where it carries nothing.
        every: How many fruits it carries there at most.
    """

    name: str
    robot: Robot
    scene: Scene
    joints: IntArray
    base: pin.SE3
    is_waiting: bool
    drop_off: Goal | None = None
    every: int = 1

    @property
    def tool_frame(self) -> str:
        """The tool frame's name in the cell's robot."""
        return f"{self.name}_{self.robot.tool_frame.removeprefix(f'{self.name}_')}"

    def starting(self, q: FloatArray) -> CellArm:
        """The arm where it begins at another (dof,) configuration."""
        return replace(self, scene=self.scene.model_copy(update={"start": Start(joints_rad=tuple(q.tolist()))}))


@dataclass(frozen=True, eq=False)
class Cell(Record):
    """Several arms and everything around them.

    Attributes:
        scene: As its file describes it.
        robot: All arms as one robot, whose base is the cell's frame.
        arms: The arms, in the order of the file.
    """

    scene: CellScene
    robot: Robot
    arms: tuple[CellArm, ...]

    @classmethod
    def of(cls, scene: CellScene, robots: Mapping[str, Robot]) -> Cell:
        """A cell of robots that are loaded.

        Args:
            scene: What it is made of.
            robots: The robot of each name.

        Raises:
            InputError: A robot is missing, or those given cannot be joined (`joined_robots`).
        """
        instance("scene", scene, CellScene, "load_cell")
        for arm in scene.robots:
            if not isinstance(robots.get(arm.name), Robot):
                raise InputError(f"robots: there is none for {arm.name!r}", robot=arm.name)
        placed = {arm.name: (robots[arm.name], _placement(arm)) for arm in scene.robots}
        key = tuple((name, robot, place.homogeneous.tobytes()) for name, (robot, place) in placed.items())
        # Kept with the first robot: the next task of the same arms begins sooner.
        whole = key[0][1].cached(("cell", *key), lambda: joined_robots(placed))
        return cls(scene, whole, tuple(_arm(scene, arm, *placed[arm.name], whole) for arm in scene.robots))

    def arm(self, name: str) -> CellArm:
        """The arm of a name.

        Raises:
            InputError: There is none.
        """
        found = next((arm for arm in self.arms if arm.name == name), None)
        if found is None:
            raise InputError(f"the cell has no arm {name!r}; it has {', '.join(arm.name for arm in self.arms)}")
        return found

    def owner(self, link: str) -> str | None:
        """Name of the arm that a link, or an obstacle called after one, is of; None where it is nobody's."""
        return next((arm.name for arm in self.arms if link.startswith(f"{arm.name}_")), None)

    def starting(self, q: Mapping[str, FloatArray]) -> Cell:
        """The cell with some of its arms, by name, at other (dof,) configurations at first."""
        arms = tuple(arm.starting(q[arm.name]) if arm.name in q else arm for arm in self.arms)
        return replace(self, arms=arms)

    def with_goal(self, name: str, goal: Goal) -> Cell:
        """The cell in which an arm has another goal, in the cell's frame.

        Raises:
            InputError: No arm of that name.
        """
        arm = self.arm(name)
        start = arm.scene.start
        changed = replace(arm, scene=_seen_from(arm.base, self.scene.task(goal, start)), is_waiting=False)
        return replace(self, arms=tuple(changed if each is arm else each for each in self.arms))

    def configuration(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """(..., dof) configurations of all joints, from those of the arms; where none is given, its start."""
        found = np.empty((*np.broadcast_shapes(*(own.shape[:-1] for own in q.values())), self.robot.dof))
        for arm in self.arms:
            found[..., arm.joints] = q[arm.name] if arm.name in q else arm.robot.joints_of(arm.scene.start, "start")
        return found

    def task(self, goal: FloatArray, start: FloatArray | None = None, *, obstacles: bool = True) -> Scene:
        """The scene of all joints as one robot's.

        Args:
            goal: (dof,) where they are to be.
            start: (dof,) where they begin; None for the starts of the arms.
            obstacles: False leaves nothing but the arms.
        """
        begin = self.configuration({}) if start is None else start
        found = self.scene.task(Goal(joints_rad=tuple(goal.tolist())), Start(joints_rad=tuple(begin.tolist())))
        return found if obstacles else found.model_copy(update={"obstacles": (), "fruits": ()})

    def together(self, motions: Mapping[str, Trajectory]) -> Trajectory:
        """Motions of arms on one clock: who has none stays at its start, who has arrived where it is.

        Args:
            motions: The motion of each arm, by name, in its own joints.

        Raises:
            InputError: No arm of that name, or a motion of other joints.
        """
        rows = {}
        for name, motion in motions.items():
            arm, motion = self.arm(name), instance(f"motion of {name}", motion, Trajectory, "plan or read_csv")
            if motion.joint_names != arm.robot.joint_names:
                raise InputError(f"the motion of arm {name!r} moves {', '.join(motion.joint_names)}", arm=name)
            if motion.interpolation != "cubic":
                raise InputError(f"the motion of arm {name!r} is {motion.interpolation} between its rows; several arms "
                    "are certified by cubics", arm=name)  # fmt: skip
            rows[name] = motion.rows
        times = np.unique(np.concatenate([np.zeros(1), *(own.time for own in rows.values())]))
        clock = times[np.concatenate([[True], np.diff(times) > _SAME_S])]
        shape = len(clock), self.robot.dof
        q, v, a = np.tile(self.configuration({}), (shape[0], 1)), np.zeros(shape), np.zeros(shape)
        for name, own in rows.items():
            columns = self.arm(name).joints
            for into, values in zip((q, v, a), _states(own, clock), strict=True):
                into[:, columns] = values
        taken = [motion.takes_over_s for motion in motions.values() if motion.takes_over_s is not None]
        torque, takes_over_s = self.robot.dynamics.torques(q, v, a), max(taken, default=None)
        return Trajectory(self.robot.joint_names, clock, q, v, a, torque, self.robot.slides, takes_over_s=takes_over_s)

    def apart(self, motion: Trajectory) -> dict[str, Trajectory]:
        """The motion of each arm, by name, in its own joints, of one of all joints.

        Raises:
            InputError: A motion of other joints.
        """
        if motion.joint_names != self.robot.joint_names:
            raise InputError(f"the motion moves {', '.join(motion.joint_names)}; it is none of the cell's")
        found, (time, q, v, a, torque) = {}, motion.rows
        for arm in self.arms:
            own = (values[:, arm.joints] for values in (q, v, a, torque))
            found[arm.name] = Trajectory(
                arm.robot.joint_names, *Rows(time, *own), arm.robot.slides, takes_over_s=motion.takes_over_s
            )
        return found


@dataclass(frozen=True)
class CellCertificate:
    """What was shown of a cell's motion.

    Attributes:
        between: The arms against one another, and each against itself; nothing else is there.
        arms: Each arm among the obstacles, by name.
    """

    between: Certificate
    arms: Mapping[str, Certificate]

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """All of them."""
        return (self.between, *self.arms.values())

    @property
    def verified(self) -> bool:
        """True if everything was shown."""
        return all(part.verified for part in self.parts)

    @property
    def min_clearance_m(self) -> float:
        """The smallest distance that is kept [m]."""
        return min(part.min_clearance_m for part in self.parts)

    @property
    def violations(self) -> tuple[str, ...]:
        """A message for everything that was not verified."""
        own = (f"{name}: {message}" for name, each in self.arms.items() for message in each.violations)
        return (*(f"between arms: {message}" for message in self.between.violations), *own)


@dataclass(frozen=True, eq=False)
class CellResult(Record, InNotebook):
    """The motion of a cell.

    Attributes:
        cell: The arms.
        trajectory: All joints on one clock.
        certificate: What was shown of it.
        how: `at once`: each arm's own motion; `one later`: these, some begun later; `around each other`.
        alone: What was planned for each arm by itself.
        later_s: By how much the motion of each arm begins later [s].
        options: How it was planned.
        stopped: Names of the arms that stop before their goals.
    """

    cell: Cell
    trajectory: Trajectory
    certificate: CellCertificate
    how: How
    alone: Mapping[str, PlanResult]
    later_s: Mapping[str, float]
    options: PlanOptions
    stopped: tuple[str, ...] = ()

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """All certificates: of the arms against one another, and of each among the obstacles."""
        return self.certificate.parts

    @cached_property
    def trajectories(self) -> dict[str, Trajectory]:
        """The motion of each arm in its own joints, by name, all on one clock."""
        return self.cell.apart(self.trajectory)

    def stop_at(self, t: float, arm: str | None = None) -> CellResult:
        """The motion with a stop, of all arms or, where the others can go on as planned, of one.

        An arm stops on its own path, as quickly as it can. All of them stop together on the path that they have
        together, so that they stay apart as they were.

        Args:
            t: The time on the motion's clock [s].
            arm: The one that stops; None for all. Where its stop and the others' motions are not certified together,
                all stop.

        Raises:
            OptionError: A time before the motion or after it.
            InputError: No arm of that name.
            TimingError: No stop was found.
        """
        if arm is not None:
            own = stopped(self.trajectories[self.cell.arm(arm).name], t, self.cell.arm(arm).robot)
            motion = self.cell.together({**self.trajectories, arm: own.trajectory})
            found = self._stopped(motion, {arm: own}, (arm,))
            if found.certificate.verified:
                return found
        whole = stopped(self.trajectory, t, self.cell.robot)
        names = tuple(each.name for each in self.cell.arms if not each.is_waiting)
        return self._stopped(whole.trajectory, dict.fromkeys(names, whole), names)

    def _stopped(self, motion: Trajectory, stops: Mapping[str, Retimed], names: tuple[str, ...]) -> CellResult:
        return replace(self.running(self.cell, motion, stops, check_ends=False), stopped=names)

    def running(self, cell: Cell, motion: Trajectory, stops: Mapping[str, Retimed], *, check_ends: bool) -> CellResult:
        """Another motion that has begun as this one, certified.

        Args:
            cell: The arms, with the goals that they have then.
            motion: Of all joints.
            stops: For arms that stop on their paths how; the windows of time in which they may touch fruit follow.
            check_ends: Whether each arm has to reach its goal.
        """
        windows = {name: _windows(each.contacts, stops.get(name)) for name, each in self.certificate.arms.items()}
        certificate = certify_cell(cell, motion, self.options, contacts=windows, check_ends=check_ends)
        return replace(self, cell=cell, trajectory=motion, certificate=certificate)

    @property
    def report(self) -> dict[str, Any]:
        """The numbers of `report.json`."""
        alone = {name: result.trajectory.duration for name, result in self.alone.items()}
        makespan = self.trajectory.duration
        return {
            "how": self.how,
            "makespan_s": makespan,
            "alone_s": alone,
            "one_after_the_other_s": sum(alone.values()),
            "later_s": dict(self.later_s),
            "stopped": list(self.stopped),
            "idle_s": {name: makespan - own for name, own in alone.items()},
            "verified": self.certificate.verified,
            "min_clearance_mm": _mm(self.certificate.min_clearance_m),
            "between_arms_mm": _mm(self.certificate.between.min_clearance_m),
            "arms_mm": {name: _mm(each.min_clearance_m) for name, each in self.certificate.arms.items()},
            "violations": list(self.certificate.violations),
        }


def load_cell(path: Path | str) -> Cell:
    """Read a scene file with `robots`, and the robots that it names.

    Args:
        path: The file; files that it names are looked for beside it.

    Raises:
        SceneError: As `load_scene`; the file has no `robots`.
        InputError: As `load_robot`; or the robots cannot be joined.
    """
    scene, folder = read_model(CellScene, file_path("path", path)), Path(path).parent
    return Cell.of(scene, {arm.name: _loaded(arm, folder) for arm in scene.robots})


def certify_cell(
    cell: Cell,
    motion: Trajectory | Mapping[str, Trajectory],
    options: PlanOptions | None = None,
    *,
    goal_contact: Mapping[str, GoalContact] | None = None,
    contacts: Mapping[str, Sequence[FruitContact]] | None = None,
    check_ends: bool = True,
) -> CellCertificate:
    """Certify a motion of a cell, wherever it comes from: each arm among the obstacles, and all against one another.

    Args:
        cell: The arms and their tasks, from `load_cell`.
        motion: Of all joints (`Cell.together`); or of each arm by name, all from the same instant on.
        options: For the tracking error and delay, of every arm, and `sigmas`.
        goal_contact: For each arm, by name, when it may touch its fruit, as `certify` takes it.
        contacts: For each arm windows of time in which it may touch fruits besides, as `certify` takes them.
        check_ends: Whether each arm has to begin at its start and reach its goal.

    Raises:
        InputError: A motion of other joints.
        OptionError: No cell.
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    options.check_for(None)
    if not isinstance(motion, Trajectory):
        if not (isinstance(motion, Mapping) and motion):
            raise OptionError("motion", motion, "a trajectory of all joints, or one of each arm by its name")
        motion = cell.together(motion)
    arms, own = {}, cell.apart(motion)
    for arm in cell.arms:
        contact, windows = (goal_contact or {}).get(arm.name, "approach"), (contacts or {}).get(arm.name, ())
        arms[arm.name] = certify(
            arm.robot, arm.scene, own[arm.name],
            goal_contact=contact, contacts=windows, check_ends=check_ends, **_covered(options),
        )  # fmt: skip
    return CellCertificate(certify_between(cell, motion, options), arms)


def certify_between(cell: Cell, motion: Trajectory, options: PlanOptions) -> Certificate:
    """Certify all arms of a cell against one another alone, as if nothing else were there.

    Args:
        motion: Of all joints.
        options: For the tracking error and delay.
    """
    alone = cell.task(motion.position[-1], motion.position[0], obstacles=False)
    return certify(cell.robot, alone, motion, check_ends=False, **_covered(options))  # the ends are its own


def _covered(options: PlanOptions) -> dict[str, Any]:
    """What certificates of these options cover, as `certify` takes it."""
    return {key: getattr(options, key) for key in ("tracking_error", "tracking_delay_s", "sigmas")}


def between(cell: Cell, q: FloatArray, name: str, others: Collection[str]) -> FloatArray:
    """(n,) least distance of an arm from others at (n, dof) configurations of all [m]; inf from none."""
    field = cell.robot.cached(("between", name, frozenset(others)), lambda: _field_between(cell, name, others))
    pairs = field.along(q)[:, int(field.numbers[BODIES]) :]
    least: FloatArray = pairs.min(axis=1, initial=math.inf)
    return least


def _field_between(cell: Cell, name: str, others: Collection[str]) -> ClearanceField:
    """The field of all arms without obstacles, and of the pairs of one arm with others alone."""
    bodies = collision_bodies(cell.robot)
    arms = [cell.owner(body.name) for body in bodies]
    pairs: list[set[str | None]] = [{name, other} for other in others]
    asked = [{arms[i], arms[j]} in pairs for i, j in self_pairs(cell.robot).checked]
    field = ClearanceField.of(cell.robot, [])
    before = int(field.numbers[BODIES])  # capsules that stand for several bodies come before pairs
    return replace(field, movers=readonly(field.movers[[*range(before), *(before + np.flatnonzero(asked))]]))


def standing(cell: Cell, name: str, thicker: float) -> Iterator[AnyObstacle]:
    """The arms of a cell but one where they stand, and as much thicker [m], as obstacles in the frame of that one."""
    robot, base = cell.robot, cell.arm(name).base
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, cell.configuration({}))
    solids = robot.cached(("solids", thicker), lambda: _solids(robot, thicker))
    for body, solid in zip(collision_bodies(robot), solids, strict=True):
        if cell.owner(body.name) != name:
            place = base.actInv(data.oMi[body.joint + 1])
            yield solid.model_copy(update=moved(solid, place.rotation, place.translation))


def _states(rows: Rows, clock: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration of a motion at times; at rest after it."""
    q = rows.positions(clock)
    v, a = np.zeros_like(q), np.zeros_like(q)
    inside = clock < rows.duration
    if len(rows.time) > 1 and inside.any():
        pieces, _ = rows.pieces
        v[inside], a[inside] = (evaluate(pieces, rows.time, clock[inside], order) for order in (1, 2))
    return q, v, a


def _windows(contacts: Sequence[FruitContact], stop: Retimed | None) -> list[FruitContact]:
    """Windows of contact on the clock of a motion that stops; None for one that goes on."""
    if stop is None:
        return list(contacts)
    found = []
    for contact in contacts:
        inside = np.flatnonzero((contact.begin_s - _SAME_S <= stop.clock) & (stop.clock <= contact.end_s + _SAME_S))
        if len(inside):
            begin, end = stop.trajectory.time[inside[[0, -1]]].tolist()
            found.append(replace(contact, begin_s=begin, end_s=end))
    return found


def _solids(robot: Robot, thicker: float) -> list[AnyObstacle]:
    """Obstacles that hold the bodies of a robot, and as much more [m], each in the frame of its joint."""
    found: list[AnyObstacle] = []
    for number, body in enumerate(collision_bodies(robot)):
        name, radius = f"{body.name} {number}", body.rounding + thicker
        (start, *others) = body.core.tolist()
        if not others:
            found.append(Sphere(name=name, center=tuple(start), radius=radius))
        elif len(others) == 1:
            found.append(Capsule(name=name, start=tuple(start), end=tuple(others[0]), radius=radius))
        else:
            hull = whole_hull((body.core[:, None] + radius * CUBE_CORNERS).reshape(-1, 3))
            found.append(Mesh.of(name, hull.core, hull.faces))
    return found


def _arm(scene: CellScene, given: CellRobot, robot: Robot, placement: pin.SE3, whole: Robot) -> CellArm:
    """An arm of a cell; one whose base is tilted is planned for in the cell's frame, where gravity is as it is."""
    goal = given.goal
    if goal is None:
        goal = Goal(**{key: value for key, value in given.start.model_dump().items() if key.startswith("joints")})
    task = scene.task(goal, given.start)
    if placement.rotation[2, 2] < 1.0:
        robot, placement = joined_robots({given.name: (robot, placement)}, given.name), pin.SE3.Identity()
    drop = given.drop_off and _seen_from(placement, scene.task(given.drop_off, given.start)).goal
    task = _seen_from(placement, task)
    names = [joint.removeprefix(f"{given.name}_") for joint in robot.joint_names]
    joints = readonly([whole.joint_names.index(f"{given.name}_{joint}") for joint in names], np.int64)
    return CellArm(given.name, robot, task, joints, placement, given.goal is None, drop, given.every)


def _seen_from(base: pin.SE3, task: Scene) -> Scene:
    """A task in the cell's frame as an upright base sees it."""
    if base.isIdentity(0.0):
        return task
    yaw = math.atan2(base.rotation[1, 0], base.rotation[0, 0])
    return task.shifted(-base.rotation.T @ base.translation, -math.degrees(yaw))


def _placement(arm: CellRobot) -> pin.SE3:
    return pin.SE3(rpy_rotation(*np.radians(arm.rpy_deg)), np.array(arm.position))


def _loaded(arm: CellRobot, folder: Path) -> Robot:
    """The robot that a scene names."""
    beside = None if arm.robot is None else folder / arm.robot
    limits = None if arm.limits is None else folder / arm.limits
    return load_robot(
        beside if beside is not None and beside.is_file() else arm.robot,
        limits=limits if limits is not None and limits.is_file() else arm.limits,
        tool_frame=arm.tool_frame,
        hold=arm.hold,
    )


def _mm(distance: float) -> float | None:
    return 1e3 * distance if math.isfinite(distance) else None
