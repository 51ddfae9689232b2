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
from hplan.base.units import FARTHEST_JOINT
from hplan.certificate.certificate import (
    REST,
    Certificate,
    GoalContact,
    MotionRates,
    certify,
    certify_among,
    with_violations,
)
from hplan.certificate.digests import Digests
from hplan.certificate.goal_contact import FruitContact
from hplan.certificate.limit_use import LimitUse, limit_use
from hplan.certificate.motion_bound import fastest
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.collision_bodies import CollisionBody, collision_bodies
from hplan.collision.flat_bodies import BODIES
from hplan.collision.touching_pairs import self_pairs
from hplan.errors import InputError, OptionError
from hplan.planning.options import PlanOptions
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot, load_robot
from hplan.robot.several import joined_robots
from hplan.scene.cell import ArmLink, CellRobot, CellScene
from hplan.scene.file import read_model
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacle_kind import moved
from hplan.scene.obstacles import AnyObstacle, Capsule, Mesh, Sphere
from hplan.scene.solids import CUBE_CORNERS, rpy_rotation, whole_hull
from hplan.trajectory.cubics import Rows, evaluate
from hplan.trajectory.trajectory import Retimed, Trajectory, stopped

#: How a cell's motions were found.
How = Literal["at once", "one later", "around each other"]

#: Samples of planned motions nearer to each other than this are one [s].
_SAME_S: Final = 1e-6

#: Why links of two arms may touch.
BY_SCENE: Final = "the scene says so"

#: An arm whose file ends no faster than `REST` stands so soon after it [s].
_STANDS_AFTER_S: Final = 1e-12


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
        prefix: What names of `robot` begin with in the cell's robot; empty if they have it already.
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
        """The tool frame's name in the cell's robot."""
        return self.prefix + self.robot.tool_frame

    def starting(self, q: FloatArray) -> CellArm:
        """The arm where it begins at another (dof,) configuration."""
        return replace(self, scene=self.scene.copy_unchecked({"start": Start(joints_rad=tuple(q.tolist()))}))


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
            InputError: A robot is missing, those given cannot be joined (`joined_robots`), or one has no link that the
                scene says may touch another.
        """
        instance("scene", scene, CellScene, "load_cell")
        for arm in scene.robots:
            if not isinstance(robots.get(arm.name), Robot):
                raise InputError(f"robots: there is none for {arm.name!r}", robot=arm.name)
        placed = {arm.name: (robots[arm.name], _placement(arm)) for arm in scene.robots}
        key = tuple((name, robot, place.homogeneous.tobytes()) for name, (robot, place) in placed.items())
        declared = [(first, second, BY_SCENE) for first, second in scene.may_touch]
        # Kept with the first robot: the next task of the same arms begins sooner.
        whole = key[0][1].cached(("cell", scene.may_touch, *key), lambda: joined_robots(placed, may_touch=declared))
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
        """The arm that a link of the cell's robot is of, by name; None for a link of no arm."""
        return self.robot.owner_of(link)

    def blocking(self, obstacle: str | None) -> str | None:
        """The arm that stands as an obstacle of this name (`standing`); None for the scene's own obstacles."""
        bodies = collision_bodies(self.robot)
        found = (body for number, body in enumerate(bodies) if obstacle == _standing_name(body, number))
        return next((self.owner(body.name) for body in found), None)

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
        return found if obstacles else found.copy_unchecked({"obstacles": (), "fruits": ()})

    def together(self, motions: Mapping[str, Trajectory]) -> Trajectory:
        """Motions of arms on one clock: who has none stays at its start, who has arrived where it is.

        Args:
            motions: The motion of each arm, by name, in its own joints.

        Raises:
            InputError: No arm of that name, a motion of other joints, or one that ends in motion before another.
        """
        motions = {name: self.own_motion(name, motion) for name, motion in motions.items()}
        end_s = max((motion.duration for motion in motions.values()), default=0.0)
        for name, motion in motions.items():
            if motion.duration < end_s and (moving := _end_in_motion(name, motion)):
                raise InputError(f"{moving}, and the others go on: where it is then is not known", arm=name)
        rows = {name: motion.rows for name, motion in motions.items()}
        times = np.unique(np.concatenate([np.zeros(1), *(own.time for own in rows.values())]))
        clock = times[np.concatenate([[True], np.diff(times) > _SAME_S])]
        q, v, a = self._states(rows, clock)
        torque = self.robot.dynamics.torques(q, v, a)
        overtaken = [motion.takes_over_s for motion in motions.values() if motion.takes_over_s is not None]
        takes_over_s = max(overtaken, default=None)
        return Trajectory(self.robot.joint_names, clock, q, v, a, torque, self.robot.slides, takes_over_s=takes_over_s)

    def own_motion(self, name: str, motion: object) -> Trajectory:
        """The motion of an arm, checked to move its joints.

        Raises:
            InputError: The cell has no arm of that name, or the motion moves other joints.
            OptionError: `motion` is no trajectory.
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
            slides = tuple(motion.slides[joint] for joint in arm.joints) if motion.slides else ()
            takes_over_s = motion.takes_over_s
            found[arm.name] = Trajectory(arm.robot.joint_names, *Rows(time, *own), slides, takes_over_s=takes_over_s)
        return found


@dataclass(frozen=True)
class CellCertificate:
    """What was shown of a cell's motion.

    Attributes:
        between: The arms against one another, and each against itself; nothing else is there.
        arms: Each arm among the obstacles, by name.
        may_touch: Pairs of links of different arms, by arm and link, that touch by design and were not checked.
    """

    between: Certificate
    arms: Mapping[str, Certificate]
    may_touch: tuple[tuple[ArmLink, ArmLink], ...] = ()

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
            "uncovered_links": list(self.certificate.between.uncovered_links),
            **may_touch_report(self.certificate.may_touch),
        }


def may_touch_report(pairs: Sequence[tuple[ArmLink, ArmLink]]) -> dict[str, Any]:
    """The pairs of links that a scene lets touch, as reports list them; nothing if there are none."""
    return {"may_touch": [[list(link) for link in pair] for pair in pairs]} if pairs else {}


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
    """Certify a motion of a workcell, wherever it comes from.

    Each arm is judged among the obstacles by `hplan.certify` on its own samples, with its own columns and its own last
    velocity. All arms are judged against one another on one clock that has the samples of all of them.

    Args:
        cell: The arms and their tasks, from `load_cell`.
        motion: A motion of all joints (`Cell.together`); or that of each arm by name, all from the same instant on. An
            arm that is not named stays at its start.
        options: For the tracking error and delay, of every arm, and `sigmas`.
        goal_contact: For each arm, by name, when it may touch its fruit, as `certify` takes it.
        contacts: For each arm windows of time in which it may touch fruits besides, as `certify` takes them.
        check_ends: Whether each arm has to begin at its start and reach its goal.

    Raises:
        InputError: A motion moves other joints than its arm, or the cell has no arm of a name.
        OptionError: `cell` is no cell, or `motion` no trajectory.
    """
    instance("cell", cell, Cell, "load_cell")
    options = PlanOptions() if options is None else instance("options", options, PlanOptions)
    options.check_for(None)
    if isinstance(motion, Trajectory):
        files = cell.apart(motion)
    elif isinstance(motion, Mapping) and motion:
        files = {name: cell.own_motion(name, own) for name, own in motion.items()}
    else:
        raise OptionError("motion", motion, "a trajectory of all joints, or one of each arm by its name")
    for option, by_arm in (("goal_contact", goal_contact), ("contacts", contacts)):
        if not isinstance(by_arm, Mapping | None):
            raise OptionError(option, by_arm, "a mapping by the names of arms")
        for name in by_arm or {}:
            cell.arm(name)
    files = {arm.name: files.get(arm.name) or _standing_still(arm) for arm in cell.arms}
    arms, end_s = {}, max(own.duration for own in files.values())
    for arm in cell.arms:
        contact, windows = (goal_contact or {}).get(arm.name, "approach"), (contacts or {}).get(arm.name, ())
        own = certify(
            arm.robot, arm.scene, files[arm.name],
            goal_contact=contact, contacts=windows, check_ends=check_ends, **_covered(options),
        )  # fmt: skip
        arms[arm.name] = with_violations(own, _meetings_at_rest(own, files[arm.name].duration, end_s))
    return CellCertificate(certify_between(cell, files, options), arms, cell.scene.may_touch)


def certify_between(cell: Cell, files: Mapping[str, Trajectory], options: PlanOptions) -> Certificate:
    """Certify the arms of a cell against one another alone, as if nothing else were there.

    The clock has the samples of all files, so that the motion of all joints is each file's own between any two of them.
    Limits are those of the files.

    Args:
        files: The motion of every arm, by name; who has arrived stays where its file ends.
        options: For the tracking error and delay, and `sigmas`.
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
        digests=Digests.of(cell.robot, alone, motion),
    )


def _not_compared(
    files: Mapping[str, Trajectory],
    states: tuple[FloatArray, ...],
    moving: Collection[str],
    span_s: tuple[float, float],
) -> Iterator[str]:
    """Messages: times at which the place of an arm is not known, or is no number."""
    known_s, end_s = span_s
    if known_s < end_s:
        ends = "; ".join(_end_in_motion(name, files[name]) for name in moving if files[name].duration == known_s)
        yield f"{ends}; where it is then is not known, and others go on until {end_s:.6g} s"
    if not all((np.abs(values) <= FARTHEST_JOINT).all() for values in states[:2]):
        yield f"joints go, or move, beyond {FARTHEST_JOINT:.3g} rad, and are not followed there"


def _rates(cell: Cell, files: Mapping[str, Trajectory], clock: FloatArray) -> MotionRates:
    """Use of limits by files, and (pieces, dof) bounds of the velocity of all joints between the times of a clock."""
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
    """Message: with what speed an arm's motion ends; empty if it ends at rest."""
    speeds = np.abs(motion.velocity[-1])
    joint = int(speeds.argmax())
    if speeds[joint] <= REST:
        return ""
    moves = f"joint {motion.joint_names[joint]!r} at a speed of {speeds[joint]:.4g}"
    return f"the motion of arm {name!r} ends at {motion.duration:.6g} s with {moves}"


def _meetings_at_rest(own: Certificate, arrives_s: float, end_s: float) -> Iterator[str]:
    """Message: a moving obstacle comes to an arm that has arrived, while others still move."""
    if own.clear_until_s is not None and arrives_s < end_s and own.clear_until_s < end_s:
        yield (
            f"where it rests from {arrives_s:.6g} s on it is clear until {own.clear_until_s:.6g} s, "
            f"and other arms move until {end_s:.6g} s"
        )


def _standing_still(arm: CellArm) -> Trajectory:
    """An arm's motion of one sample, at its start."""
    q = arm.robot.joints_of(arm.scene.start, "start")[None]
    still = np.zeros_like(q)
    torque = arm.robot.dynamics.torques(q, still, still)
    return Trajectory(arm.robot.joint_names, np.zeros(1), q, still, still, torque, arm.robot.slides)


def check_options(options: PlanOptions, what: str) -> None:
    """Refuse options that have no meaning for plans of several arms.

    Args:
        what: The plans, for messages: "motions of several arms".

    Raises:
        OptionError: A risk, a bound, or motions that need not be certified are asked for.
    """
    options.check_for(None)
    if options.bound:
        raise OptionError("bound", options.bound, f"False: {what} have no bound but the longest alone")
    if not options.certify:
        raise OptionError("certify", options.certify, f"True: {what} are always certified")


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
    """The arms of a cell but one where they stand, and as much thicker [m], as obstacles in the frame of that one.

    Links that may touch one of that arm are left out.
    """
    may_touch = [dict(pair) for pair in cell.scene.may_touch]
    beside = {f"{arm}_{pair[arm]}" for pair in may_touch if name in pair for arm in pair if arm != name}
    robot, base = cell.robot, cell.arm(name).base
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, cell.configuration({}))
    solids = robot.cached(("solids", thicker), lambda: _solids(robot, thicker))
    for body, solid in zip(collision_bodies(robot), solids, strict=True):
        if cell.owner(body.name) != name and body.name not in beside:
            place = base.actInv(data.oMi[body.joint + 1])
            yield solid.copy_unchecked(moved(solid, place.rotation, place.translation))


def _states(rows: Rows, clock: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration of a motion at times: at its samples theirs, at rest after it."""
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


def _standing_name(body: CollisionBody, number: int) -> str:
    return f"{body.name} {number}"


def _solids(robot: Robot, thicker: float) -> list[AnyObstacle]:
    """Obstacles that hold the bodies of a robot, and as much more [m], each in the frame of its joint."""
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
            found.append(Mesh.of(name, hull.core, hull.faces))
    return found


def _arm(scene: CellScene, given: CellRobot, robot: Robot, placement: pin.SE3, whole: Robot) -> CellArm:
    """An arm of a cell; one whose base is tilted is planned for in the cell's frame, where gravity is as it is."""
    goal = given.goal
    if goal is None:
        goal = Goal(**{key: value for key, value in given.start.model_dump().items() if key.startswith("joints")})
    task, prefix = scene.task(goal, given.start), f"{given.name}_"
    if placement.rotation[2, 2] < 1.0:
        robot, placement = joined_robots({given.name: (robot, placement)}, given.name), pin.SE3.Identity()
        prefix = ""
    drop = given.drop_off and _seen_from(placement, scene.task(given.drop_off, given.start)).goal
    task = _seen_from(placement, task)
    joints = readonly([whole.joint_names.index(prefix + joint) for joint in robot.joint_names], np.int64)
    return CellArm(given.name, robot, task, joints, placement, given.goal is None, drop, given.every, prefix)


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
        collision_from_visual=arm.collision_from_visual,
    )


def _mm(distance: float) -> float | None:
    return 1e3 * distance if math.isfinite(distance) else None
