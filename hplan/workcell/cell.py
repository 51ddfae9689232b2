"""Workcells: several arms, and the certificates of their motions.

A workcell is one robot (`hplan.robot.several`): a tree of joints in which every two bodies of different arms are a
pair of their own. All functions that plan, certify, stop or splice motions of a robot therefore hold for all arms
together. The certificate has two parts: each arm among the obstacles, with the fruit that it reaches for, and all
bodies of different arms against each other, over continuous time.
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
from hplan.base.units import FARTHEST_JOINT
from hplan.certificate.certificate import (
    Certificate,
    GoalContact,
    MotionRates,
    certify,
    certify_among,
    with_violations,
)
from hplan.certificate.digests import Digests
from hplan.certificate.goal_contact import REST, FruitContact
from hplan.certificate.limb_loads import shared_limb_violations
from hplan.certificate.limit_use import LimitUse, limit_use
from hplan.certificate.motion_bound import fastest
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.collision.collision_bodies import CollisionBody, collision_bodies
from hplan.collision.compiled_field import ClearanceField
from hplan.collision.held_objects import hand_links, holding
from hplan.collision.self_pairs import self_pairs
from hplan.errors import InputError, OptionError
from hplan.geometry.hull import CUBE_CORNERS, whole_hull
from hplan.geometry.rotation import rpy_rotation
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.several import joined_robots
from hplan.scene.attached import Attached
from hplan.scene.cell import ArmLink, CellRobot, CellScene
from hplan.scene.file import read_model
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import transform_fields
from hplan.scene.obstacles import AnyObstacle, Capsule, Mesh, Sphere
from hplan.trajectory.cubics import Rows, evaluate
from hplan.trajectory.trajectory import Retimed, Trajectory, stop_motion

#: How the motions of a workcell were found.
How = Literal["at once", "one later", "around each other"]

#: Samples of planned motions closer in time than this are one [s].
_SAME_S: Final = 1e-6

#: Reason why links of two arms may touch.
BY_SCENE: Final = "the scene says so"

#: An arm whose file ends no faster than `REST` is at rest this long after its end [s].
_STANDS_AFTER_S: Final = 1e-12


@dataclass(frozen=True, eq=False)
class CellArm(Record):
    """One arm of a workcell.

    Attributes:
        name: Its name in the workcell.
        robot: The arm by itself.
        scene: Obstacles and the arm's task in the frame of its base; an arm without a goal has its start as goal.
        joints: (dof,) numbers of its joints in the workcell's robot.
        base: Pose of the frame of `robot` and `scene` in the workcell's frame.
        is_waiting: True if it has no goal and stays at its start.
        drop_off: Where it releases fruit on a tour, in the frame of its base; None if it carries nothing.
        every: Maximum number of fruits that it carries there at a time.
        prefix: Prefix of the names of `robot` in the workcell's robot; empty if the names already have it.
    """

    name: str
    robot: Robot
    scene: Scene
    joints: IntArray
    base: pin.SE3
    is_waiting: bool
    drop_off: Goal | None = None
    every: int = 1
    prefix: str = ""

    @property
    def tool_frame(self) -> str:
        """The tool frame's name in the workcell's robot."""
        return self.prefix + self.robot.tool_frame

    def start_at(self, q: FloatArray) -> CellArm:
        """The arm with another (dof,) start configuration."""
        return replace(self, scene=self.scene.copy_unchecked({"start": Start(joints_rad=tuple(q.tolist()))}))


@dataclass(frozen=True, eq=False)
class Cell(Record):
    """Several arms and their surroundings.

    Attributes:
        scene: The scene as its file describes it.
        robot: All arms as one robot; its base is the workcell's frame.
        arms: The arms, in the order of the file.

    Examples:
        >>> from hplan import Cell, load_robot, load_scene
        >>> from hplan.scene.cell import CellRobot, CellScene
        >>> robot, task = load_robot(), load_scene()
        >>> left = CellRobot(name="left", robot=robot.name, position=(0, 3, 0), start=task.start, goal=task.goal)
        >>> right = CellRobot(name="right", robot=robot.name, position=(0, -3, 0), start=task.start)
        >>> cell = Cell.from_robots(CellScene(name="pair", robots=(left, right)), {"left": robot, "right": robot})
        >>> cell.robot.dof, [arm.is_waiting for arm in cell.arms]
        (8, [False, True])
    """

    scene: CellScene
    robot: Robot
    arms: tuple[CellArm, ...]

    @classmethod
    def from_robots(cls, scene: CellScene, robots: Mapping[str, Robot]) -> Cell:
        """The workcell of robots that are already loaded.

        Args:
            scene: Arms, obstacles and tasks.
            robots: The robot of each arm, by name.

        Raises:
            InputError: A robot is missing, the robots cannot be joined (`joined_robots`), or `may_touch` names a
                link that no robot has.
        """
        instance("scene", scene, CellScene, "load_cell")
        for arm in scene.robots:
            if not isinstance(robots.get(arm.name), Robot):
                raise InputError(f"robots: there is no robot for arm {arm.name!r}", robot=arm.name)
        placed = {arm.name: (robots[arm.name], _base_placement(arm)) for arm in scene.robots}
        key = tuple((name, robot, place.homogeneous.tobytes()) for name, (robot, place) in placed.items())
        declared = [(first, second, BY_SCENE) for first, second in scene.may_touch]
        # Cached with the first robot, so that the next task of the same arms starts sooner.
        whole = key[0][1].cache(("cell", scene.may_touch, *key), lambda: joined_robots(placed, may_touch=declared))
        held = (item for arm in scene.robots for item in _attached_in_cell(arm, robots[arm.name]))
        whole = holding(whole, tuple(held))
        return cls(scene, whole, tuple(_arm(scene, arm, *placed[arm.name], whole) for arm in scene.robots))

    def arm(self, name: str) -> CellArm:
        """The arm of a name.

        Raises:
            InputError: No arm has this name.
        """
        found = next((arm for arm in self.arms if arm.name == name), None)
        if found is None:
            raise InputError(f"the cell has no arm {name!r}; it has {', '.join(arm.name for arm in self.arms)}")
        return found

    def owner(self, link: str) -> str | None:
        """The name of the arm that has a link, or None."""
        return self.robot.owner_of(link)

    def arm_behind(self, obstacle: str | None) -> str | None:
        """The arm that an obstacle represents (`iterate_standing`); None for other obstacles."""
        bodies = collision_bodies(self.robot)
        found = (body for number, body in enumerate(bodies) if obstacle == _standing_name(body, number))
        return next((self.owner(body.name) for body in found), None)

    def start_at(self, q: Mapping[str, FloatArray]) -> Cell:
        """The workcell with other (dof,) start configurations of some arms, by name."""
        arms = tuple(arm.start_at(q[arm.name]) if arm.name in q else arm for arm in self.arms)
        return replace(self, arms=arms)

    def with_goal(self, name: str, goal: Goal) -> Cell:
        """The workcell with another goal of one arm, in the workcell's frame.

        Raises:
            InputError: No arm has this name.
        """
        arm = self.arm(name)
        start = arm.scene.start
        changed = replace(arm, scene=_seen_from(arm.base, self.scene.task(goal, start)), is_waiting=False)
        return replace(self, arms=tuple(changed if each is arm else each for each in self.arms))

    def configuration(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """(..., dof) configurations of all joints, assembled from the arms'.

        An arm that is not in `q` is at its start.
        """
        found = np.empty((*np.broadcast_shapes(*(own.shape[:-1] for own in q.values())), self.robot.dof))
        for arm in self.arms:
            found[..., arm.joints] = q[arm.name] if arm.name in q else arm.robot.joints_of(arm.scene.start, "start")
        return found

    def task(self, goal: FloatArray, start: FloatArray | None = None, *, obstacles: bool = True) -> Scene:
        """The scene of all joints, as of one robot.

        Args:
            goal: (dof,) goal configuration.
            start: (dof,) start configuration; None for the starts of the arms.
            obstacles: False for a scene with the arms alone.
        """
        begin = self.configuration({}) if start is None else start
        ends = Goal(joints_rad=tuple(goal.tolist())), Start(joints_rad=tuple(begin.tolist()))
        found = self.scene.task(*ends, attached=self.robot.attached)
        return found if obstacles else found.copy_unchecked({"obstacles": (), "fruits": ()})

    def join_motions(self, motions: Mapping[str, Trajectory]) -> Trajectory:
        """Join the arms' motions into one motion of all joints.

        An arm without a motion stays at its start; after its motion an arm stays at the end.

        Args:
            motions: The motion of each arm, by name, in its own joints.

        Raises:
            InputError: No arm has a name, a motion has other joints, or one ends in motion before another.
        """
        motions = {name: self.own_motion(name, motion) for name, motion in motions.items()}
        end_s = max((motion.duration for motion in motions.values()), default=0.0)
        for name, motion in motions.items():
            if motion.duration < end_s and (moving := _end_in_motion(name, motion)):
                raise InputError(f"{moving}, and the others go on: its position after that is unknown", arm=name)
        rows = {name: motion.rows for name, motion in motions.items()}
        times = np.unique(np.concatenate([np.zeros(1), *(own.time for own in rows.values())]))
        clock = times[np.concatenate([[True], np.diff(times) > _SAME_S])]
        q, v, a = self._states(rows, clock)
        torque = self.robot.dynamics.torques(q, v, a)
        overtaken = [motion.takes_over_s for motion in motions.values() if motion.takes_over_s is not None]
        takes_over_s = max(overtaken, default=None)
        return Trajectory(self.robot.joint_names, clock, q, v, a, torque, self.robot.slides, takes_over_s=takes_over_s)

    def own_motion(self, name: str, motion: object) -> Trajectory:
        """Check that a motion has the joints of an arm.

        Raises:
            InputError: The workcell has no arm of that name, or the motion has other joints.
            OptionError: `motion` is not a trajectory.
        """
        arm, own = self.arm(name), instance(f"motion of {name}", motion, Trajectory, "plan or read_csv")
        if own.joint_names != arm.robot.joint_names:
            raise InputError(
                f"the motion of arm {name!r} moves {', '.join(own.joint_names)}; "
                f"the arm has {', '.join(arm.robot.joint_names)}",
                arm=name,
            )
        if own.interpolation != "cubic":
            raise InputError(
                f"the motion of arm {name!r} is {own.interpolation} between its samples; "
                "workcells are certified by cubics",
                arm=name,
            )
        return own

    def _states(self, rows: Mapping[str, Rows], clock: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(n, dof) positions, velocities and accelerations of all joints at (n,) times."""
        shape = len(clock), self.robot.dof
        q, v, a = np.tile(self.configuration({}), (shape[0], 1)), np.zeros(shape), np.zeros(shape)
        for name, own in rows.items():
            columns = self.arm(name).joints
            for into, values in zip((q, v, a), _states(own, clock), strict=True):
                into[:, columns] = values
        return q, v, a

    def split_motion(self, motion: Trajectory) -> dict[str, Trajectory]:
        """The motion of each arm, by name, in its own joints.

        Raises:
            InputError: The motion is not one of all joints of the workcell.
        """
        if motion.joint_names != self.robot.joint_names:
            raise InputError(f"the motion moves {', '.join(motion.joint_names)}; it is not a motion of the workcell")
        found, (time, q, v, a, torque) = {}, motion.rows
        for arm in self.arms:
            own = (values[:, arm.joints] for values in (q, v, a, torque))
            slides = tuple(motion.slides[joint] for joint in arm.joints) if motion.slides else ()
            takes_over_s = motion.takes_over_s
            found[arm.name] = Trajectory(arm.robot.joint_names, *Rows(time, *own), slides, takes_over_s=takes_over_s)
        return found


@dataclass(frozen=True)
class CellCertificate:
    """Certificate of a workcell's motion.

    Attributes:
        between: The arms against each other, and each against itself, without obstacles.
        arms: Each arm among the obstacles, by name.
        may_touch: Pairs of links of different arms, by arm and link, that touch by design and were not checked.
    """

    between: Certificate
    arms: Mapping[str, Certificate]
    may_touch: tuple[tuple[ArmLink, ArmLink], ...] = ()

    @property
    def parts(self) -> tuple[Certificate, ...]:
        """All certificates: between the arms, then of each arm."""
        return (self.between, *self.arms.values())

    @property
    def verified(self) -> bool:
        """True if the whole motion is certified."""
        return all(part.verified for part in self.parts)

    @property
    def min_clearance_m(self) -> float:
        """Minimum clearance of all certificates [m]."""
        return min(part.min_clearance_m for part in self.parts)

    @property
    def violations(self) -> tuple[str, ...]:
        """Messages, one for each property that is not verified."""
        own = (f"{name}: {message}" for name, each in self.arms.items() for message in each.violations)
        return (*(f"between arms: {message}" for message in self.between.violations), *own)


@dataclass(frozen=True, eq=False)
class CellResult(Record, InNotebook):
    """The motion of a workcell.

    Attributes:
        cell: The arms.
        trajectory: All joints on one clock.
        certificate: The certificate of the trajectory.
        how: `at once`: each arm's own motion; `one later`: the same motions, some starting later; `around each other`.
        alone: The plan of each arm by itself.
        later_s: Start delay of each arm's motion [s].
        options: The options of the plan.
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
        """All certificates: between the arms, then of each arm."""
        return self.certificate.parts

    @cached_property
    def trajectories(self) -> dict[str, Trajectory]:
        """The motion of each arm, by name, on one common clock."""
        return self.cell.split_motion(self.trajectory)

    def stop_at(self, t: float, arm: str | None = None) -> CellResult:
        """The motion with a stop of one arm or all arms.

        Each arm stops on its own path, as quickly as it can. If all arms stop, they stop along their common path, so
        that their distances stay as certified.

        Args:
            t: The time on the motion's clock [s].
            arm: The arm to stop; None for all. If its stop and the motions of the others are not certified together,
                all arms stop.

        Raises:
            OptionError: `t` is before or after the motion.
            InputError: No arm has this name.
            TimingError: No stop was found.
        """
        if arm is not None:
            own = stop_motion(self.trajectories[self.cell.arm(arm).name], t, self.cell.arm(arm).robot)
            motion = self.cell.join_motions({**self.trajectories, arm: own.trajectory})
            found = self._with_stops(motion, {arm: own}, (arm,))
            if found.certificate.verified:
                return found
        whole = stop_motion(self.trajectory, t, self.cell.robot)
        names = tuple(each.name for each in self.cell.arms if not each.is_waiting)
        return self._with_stops(whole.trajectory, dict.fromkeys(names, whole), names)

    def _with_stops(self, motion: Trajectory, stops: Mapping[str, Retimed], names: tuple[str, ...]) -> CellResult:
        return replace(self.with_motion(self.cell, motion, stops, check_ends=False), stopped=names)

    def with_motion(
        self, cell: Cell, motion: Trajectory, stops: Mapping[str, Retimed], *, check_ends: bool
    ) -> CellResult:
        """Another motion that starts like this one, with its certificate.

        Args:
            cell: The arms, with their goals of that motion.
            motion: The motion of all joints.
            stops: The stop of each arm that stops on its path; the contact windows with fruit are mapped to its clock.
            check_ends: True if each arm must reach its goal.
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
            "uncovered_links": list(self.certificate.between.uncovered_links),
            **may_touch_report(self.certificate.may_touch),
        }


def may_touch_report(pairs: Sequence[tuple[ArmLink, ArmLink]]) -> dict[str, Any]:
    """The allowed contacts between arms, for reports; empty without any."""
    return {"may_touch": [[list(link) for link in pair] for pair in pairs]} if pairs else {}


def load_cell(path: Path | str) -> Cell:
    """Read a scene file with `robots`, and the robots that it names.

    Args:
        path: The scene file; relative paths in it start at its folder.

    Raises:
        SceneError: As in `load_scene`, or the file has no `robots`.
        InputError: As in `load_robot`, or the robots cannot be joined.

    Examples:
        >>> from hplan import load_cell
        >>> load_cell("missing.yaml")
        Traceback (most recent call last):
        ...
        hplan.errors.bad_input.SceneError: scene file missing.yaml: No such file or directory
    """
    scene, folder = read_model(CellScene, file_path("path", path)), Path(path).parent
    return Cell.from_robots(scene, {arm.name: _load_arm(arm, folder) for arm in scene.robots})


def certify_cell(
    cell: Cell,
    motion: Trajectory | Mapping[str, Trajectory],
    options: PlanOptions | None = None,
    *,
    goal_contact: Mapping[str, GoalContact] | None = None,
    contacts: Mapping[str, Sequence[FruitContact]] | None = None,
    check_ends: bool = True,
) -> CellCertificate:
    """Certify a motion of a workcell, from any source.

    Each arm is checked among the obstacles by `hplan.certify`, with its own samples, its own columns and its own last
    velocity. All arms are checked against each other on one clock that has the samples of all of them.

    Args:
        cell: The arms and their tasks, from `load_cell`.
        motion: A motion of all joints (`Cell.join_motions`), or the motion of each arm by name, all with the same start
            time. An arm without a motion stays at its start.
        options: Tracking error and delay, for every arm, and `sigmas`.
        goal_contact: For each arm, by name, when it may touch its fruit, as in `certify`.
        contacts: For each arm, by name, additional contact windows with fruits, as in `certify`.
        check_ends: True if each arm must begin at its start and reach its goal.

    Raises:
        InputError: A motion has other joints than its arm, or the workcell has no arm of that name.
        OptionError: `cell` is not a workcell, or `motion` is not a trajectory.

    Examples:
        >>> from hplan import Cell, certify_cell, load_robot, load_scene
        >>> from hplan.scene.cell import CellRobot, CellScene
        >>> robot, task = load_robot(), load_scene()
        >>> left = CellRobot(name="left", robot=robot.name, position=(0, 3, 0), start=task.start)
        >>> right = CellRobot(name="right", robot=robot.name, position=(0, -3, 0), start=task.start)
        >>> cell = Cell.from_robots(CellScene(name="pair", robots=(left, right)), {"left": robot, "right": robot})
        >>> certificate = certify_cell(cell, cell.join_motions({}))  # both arms at rest
        >>> certificate.verified
        True
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    options.refuse_risk()
    if isinstance(motion, Trajectory):
        files = cell.split_motion(motion)
    elif isinstance(motion, Mapping) and motion:
        files = {name: cell.own_motion(name, own) for name, own in motion.items()}
    else:
        raise OptionError(
            "motion", motion, "a trajectory of all joints, or a mapping from each arm's name to its trajectory"
        )
    for option, by_arm in (("goal_contact", goal_contact), ("contacts", contacts)):
        if not isinstance(by_arm, Mapping | None):
            raise OptionError(option, by_arm, "a mapping from names of arms")
        for name in by_arm or {}:
            cell.arm(name)
    files = {arm.name: files.get(arm.name) or _standing_still(arm) for arm in cell.arms}
    arms, end_s = {}, max(own.duration for own in files.values())
    for arm in cell.arms:
        contact, windows = (goal_contact or {}).get(arm.name, "approach"), (contacts or {}).get(arm.name, ())
        own = certify(
            arm.robot, arm.scene, files[arm.name],
            goal_contact=contact, contacts=windows, check_ends=check_ends, **_certify_arguments(options),
        )  # fmt: skip
        arms[arm.name] = with_violations(own, _meetings_at_rest(own, files[arm.name].duration, end_s))
    between = certify_between(cell, files, options)
    if cell.scene.wood is not None:
        pushes = {name: own.pushes_by_segment for name, own in arms.items()}
        between = with_violations(between, shared_limb_violations(pushes))
    return CellCertificate(between, arms, cell.scene.may_touch)


def certify_between(cell: Cell, files: Mapping[str, Trajectory], options: PlanOptions) -> Certificate:
    """Certify the arms of a workcell against each other, without obstacles.

    The clock has the samples of all files, so that each arm follows its own file exactly between any two of them.
    The use of limits is taken from the files.

    Args:
        files: The motion of every arm, by name; an arm stays where its file ends.
        options: Tracking error and delay, and `sigmas`.
    """
    end_s = max(own.duration for own in files.values())
    moving = {name: own.duration for name, own in files.items() if _end_in_motion(name, own)}
    known_s = min((end_s, *moving.values()))
    rows = {name: own.rows for name, own in files.items()}
    stands = [
        own.duration + max(_STANDS_AFTER_S, float(np.spacing(own.duration)))
        for own in rows.values()
        if own.velocity[-1].any()
    ]
    clock = np.unique(np.concatenate([*(own.time for own in rows.values()), stands]))
    clock = clock[clock <= known_s]
    states = cell._states(rows, clock)
    q, v, a = (np.clip(np.nan_to_num(values), -FARTHEST_JOINT, FARTHEST_JOINT) for values in states)
    motion = Trajectory(cell.robot.joint_names, clock, q, v, a, np.zeros_like(q), cell.robot.slides)
    alone = cell.task(motion.position[-1], motion.position[0], obstacles=False)
    found = certify_among(
        cell.robot,
        motion,
        [(slice(0, max(1, len(clock) - 1)), checker_in_time(cell.robot, alone, options.sigmas))],
        clearance=alone.clearance,
        tracking=options.certified_tracking,
        rates=_rates(cell, files, clock),
    )
    return replace(
        with_violations(found, _not_compared(files, states, moving, (known_s, end_s))),
        digests=Digests(cell.robot, alone, motion),
    )


def _not_compared(
    files: Mapping[str, Trajectory],
    states: tuple[FloatArray, ...],
    moving: Collection[str],
    span_s: tuple[float, float],
) -> Iterator[str]:
    """Messages about times with an unknown or implausible arm position."""
    known_s, end_s = span_s
    if known_s < end_s:
        ends = "; ".join(_end_in_motion(name, files[name]) for name in moving if files[name].duration == known_s)
        yield f"{ends}; its position after that is unknown, and others go on until {end_s:.6g} s"
    if not all((np.abs(values) <= FARTHEST_JOINT).all() for values in states[:2]):
        yield f"joints go, or move, beyond {FARTHEST_JOINT:.3g} rad, and are not followed there"


def _rates(cell: Cell, files: Mapping[str, Trajectory], clock: FloatArray) -> MotionRates:
    """Use of limits, and joint speed bounds between the clock's times.

    The use of limits is taken from the files; the bounds are (segments, dof).
    """
    speeds, uses = np.zeros((max(1, len(clock) - 1), cell.robot.dof)), []
    for name, own in files.items():
        arm, (bezier, duration) = cell.arm(name), own.segments
        uses.append(limit_use(arm.robot, own, bezier, duration))
        piece = np.searchsorted(own.time, clock[:-1], side="right") - 1
        moves = np.flatnonzero(piece < own.samples - 1)
        speeds[np.ix_(moves, arm.joints)] = fastest(bezier, duration)[piece[moves]]
    most = {key: max(getattr(use, key) for use in uses) for key in vars(uses[0])}
    return MotionRates(LimitUse(**most), speeds)


def _end_in_motion(name: str, motion: Trajectory) -> str:
    """Message with an arm's final speed; empty if it ends at rest."""
    speeds = np.abs(motion.velocity[-1])
    joint = int(speeds.argmax())
    if speeds[joint] <= REST:
        return ""
    moves = f"joint {motion.joint_names[joint]!r} at a speed of {speeds[joint]:.4g}"
    return f"the motion of arm {name!r} ends at {motion.duration:.6g} s with {moves}"


def _meetings_at_rest(own: Certificate, arrives_s: float, end_s: float) -> Iterator[str]:
    """Message if an obstacle reaches an arm that has arrived early."""
    if own.clear_until_s is not None and arrives_s < end_s and own.clear_until_s < end_s:
        yield (
            f"at rest from {arrives_s:.6g} s on, it is clear until {own.clear_until_s:.6g} s, "
            f"and other arms move until {end_s:.6g} s"
        )


def _standing_still(arm: CellArm) -> Trajectory:
    """A motion of one sample, at the arm's start."""
    q = arm.robot.joints_of(arm.scene.start, "start")[None]
    still = np.zeros_like(q)
    torque = arm.robot.dynamics.torques(q, still, still)
    return Trajectory(arm.robot.joint_names, np.zeros(1), q, still, still, torque, arm.robot.slides)


def check_options(options: PlanOptions, what: str) -> None:
    """Refuse options that have no meaning for plans of several arms.

    Args:
        what: The plans, for messages: "motions of several arms".

    Raises:
        OptionError: The options request a risk, a bound, or motions without a certificate.
    """
    options.refuse_risk()
    if options.bound:
        raise OptionError("bound", options.bound, f"False: {what} have no bound but the longest alone")
    if not options.certify:
        raise OptionError("certify", options.certify, f"True: {what} are always certified")


def _certify_arguments(options: PlanOptions) -> dict[str, Any]:
    """The arguments of `certify` that the options determine."""
    return {key: getattr(options, key) for key in ("tracking_error", "tracking_delay_s", "sigmas")}


def distances_between(cell: Cell, q: FloatArray, name: str, others: Collection[str]) -> FloatArray:
    """(n,) minimum distance of an arm from others [m].

    `q` has (n, dof) configurations of all joints; inf without a pair of bodies.
    """
    field = cell.robot.cache(("between", name, frozenset(others)), lambda: _field_between(cell, name, others))
    pairs = field.clearance_along(q)[:, len(field.arm.bodies) :]
    least: FloatArray = pairs.min(axis=1, initial=math.inf)
    return least


def _field_between(cell: Cell, name: str, others: Collection[str]) -> ClearanceField:
    """The field of all arms without obstacles, with one arm's pairs alone."""
    bodies = collision_bodies(cell.robot)
    arms = [cell.owner(body.name) for body in bodies]
    pairs: list[set[str | None]] = [{name, other} for other in others]
    asked = [{arms[i], arms[j]} in pairs for i, j in self_pairs(cell.robot).checked]
    field = ClearanceField.build(cell.robot, [])
    chosen = np.zeros(len(field.arm.pairs), dtype=np.bool_)
    chosen[: len(asked)] = asked
    return replace(field, arm=field.arm.with_pairs(chosen))


def iterate_standing(cell: Cell, name: str, thicker: float) -> Iterator[AnyObstacle]:
    """The other arms at their starts, as obstacles for one arm.

    They are in that arm's frame and grown by `thicker` [m]. Links that may touch a link of that arm are left out.
    """
    may_touch = [dict(pair) for pair in cell.scene.may_touch]
    beside = {f"{arm}_{pair[arm]}" for pair in may_touch if name in pair for arm in pair if arm != name}
    robot, base = cell.robot, cell.arm(name).base
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, cell.configuration({}))
    solids = robot.cache(("solids", thicker), lambda: _solids(robot, thicker))
    for body, solid in zip(collision_bodies(robot), solids, strict=True):
        if cell.owner(body.name) != name and body.name not in beside:
            place = base.actInv(data.oMi[body.joint + 1])
            yield solid.copy_unchecked(transform_fields(solid, place.rotation, place.translation))


def _states(rows: Rows, clock: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration of a motion at some times.

    At a sample they are the sample's; after the end the arm is at rest.
    """
    q = rows.positions(clock)
    v, a = np.zeros_like(q), np.zeros_like(q)
    place = np.minimum(np.searchsorted(rows.time, clock), len(rows.time) - 1)
    sampled = rows.time[place] == clock
    for into, values in zip((q, v, a), rows[1:4], strict=True):
        into[sampled] = values[place[sampled]]
    inside = ~sampled & (clock < rows.duration)
    if inside.any():
        pieces, _ = rows.pieces
        v[inside], a[inside] = (evaluate(pieces, rows.time, clock[inside], order) for order in (1, 2))
    return q, v, a


def _windows(contacts: Sequence[FruitContact], stop: Retimed | None) -> list[FruitContact]:
    """Contact windows on the clock of a stop; unchanged without one."""
    if stop is None:
        return list(contacts)
    found = []
    for contact in contacts:
        inside = np.flatnonzero((contact.begin_s - _SAME_S <= stop.clock) & (stop.clock <= contact.end_s + _SAME_S))
        if len(inside):
            begin, end = stop.trajectory.time[inside[[0, -1]]].tolist()
            found.append(replace(contact, begin_s=begin, end_s=end))
    return found


def _standing_name(body: CollisionBody, number: int) -> str:
    return f"{body.name} {number}"


def _solids(robot: Robot, thicker: float) -> list[AnyObstacle]:
    """Obstacles that enclose a robot's bodies, each in its joint's frame.

    Each is larger than its body by `thicker` [m].
    """
    found: list[AnyObstacle] = []
    for number, body in enumerate(collision_bodies(robot)):
        name, radius = _standing_name(body, number), body.rounding + thicker
        (start, *others) = body.core.tolist()
        if not others:
            found.append(Sphere(name=name, center=tuple(start), radius=radius))
        elif len(others) == 1:
            found.append(Capsule(name=name, start=tuple(start), end=tuple(others[0]), radius=radius))
        else:
            hull = whole_hull((body.core[:, None] + radius * CUBE_CORNERS).reshape(-1, 3))
            found.append(Mesh.from_arrays(name, hull.core, hull.faces))
    return found


def _arm(scene: CellScene, given: CellRobot, robot: Robot, placement: pin.SE3, whole: Robot) -> CellArm:
    """An arm of a workcell.

    An arm with a tilted base is planned in the workcell's frame, in which gravity is vertical.
    """
    goal = given.goal
    if goal is None:
        goal = Goal(**{key: value for key, value in given.start.model_dump().items() if key.startswith("joints")})
    prefix, attached = f"{given.name}_", given.attached
    if placement.rotation[2, 2] < 1.0:
        attached = _attached_in_cell(given, robot)
        robot, placement = joined_robots({given.name: (robot, placement)}, given.name), pin.SE3.Identity()
        prefix = ""
    robot, task = holding(robot, attached), scene.task(goal, given.start, attached=attached)
    drop = given.drop_off and _seen_from(placement, scene.task(given.drop_off, given.start)).goal
    task = _seen_from(placement, task)
    joints = readonly([whole.joint_names.index(prefix + joint) for joint in robot.joint_names], np.int64)
    return CellArm(given.name, robot, task, joints, placement, given.goal is None, drop, given.every, prefix)


def _attached_in_cell(arm: CellRobot, robot: Robot) -> tuple[Attached, ...]:
    """Objects that an arm holds, with the names of frames and links in the workcell's robot."""
    links = {str(frame.name) for frame in robot.model.frames}

    def change(item: Attached) -> Attached:
        permitted = hand_links(robot, item) if item.may_touch is None else item.may_touch
        touched = tuple(f"{arm.name}_{name}" if name in links else name for name in permitted)
        return item.copy_unchecked({"frame": f"{arm.name}_{item.frame or robot.tool_frame}", "may_touch": touched})

    return tuple(map(change, arm.attached))


def _seen_from(base: pin.SE3, task: Scene) -> Scene:
    """Transform a task from the workcell's frame to an upright base."""
    if base.isIdentity(0.0):
        return task
    yaw = math.atan2(base.rotation[1, 0], base.rotation[0, 0])
    return task.shift(-base.rotation.T @ base.translation, -math.degrees(yaw))


def _base_placement(arm: CellRobot) -> pin.SE3:
    return pin.SE3(rpy_rotation(*np.radians(arm.rpy_deg)), np.array(arm.position))


def _load_arm(arm: CellRobot, folder: Path) -> Robot:
    """Load the robot that a scene names."""
    beside = folder / arm.robot if isinstance(arm.robot, str) else None
    limits = None if arm.limits is None else folder / arm.limits
    return load_robot(
        beside if beside is not None and beside.is_file() else arm.robot,
        limits=limits if limits is not None and limits.is_file() else arm.limits,
        tool_frame=arm.tool_frame,
        hold=arm.hold,
        collision_from_visual=arm.collision_from_visual,
        xacro_args=arm.xacro_args,
    )


def _mm(distance: float) -> float | None:
    return 1e3 * distance if math.isfinite(distance) else None
