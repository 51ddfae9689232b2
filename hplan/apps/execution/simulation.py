r"""Execution of a motion by a torque-controlled arm simulated in MuJoCo.

A certificate is a proof about a curve; the execution measures how a machine tracks this curve, for motions of any
planner. MuJoCo reads the same URDF, with the obstacles as solid bodies, and shares no code with planner, certificate or
coal. The controller runs at 1 kHz. Its reference is the curve of a `Trajectory`, and for a `RecordedMotion` the cubic
Hermite interpolant of the samples' positions and velocities. It commands

.. math::
    \tau = \mathrm{rnea}(q_d, \dot q_d, \ddot q_d) + K_p (q_d - q) + K_d (\dot q_d - \dot q)

with gains for the plant's bandwidth and critical damping at each joint's maximum inertia along the motion. Torques
saturate at the motors' limits. Contacts between the arm and an obstacle exert forces and are reported; there are no
self-collisions and no ground. After the last sample the controller holds it for `HOLD` seconds, which reveals a motion
that does not end at rest.

By default the simulated masses are the URDF's, which the controller knows, so all errors are due to the motion itself,
not to model errors, friction or flexibility. With a `Plant` the masses differ from the controller's model and its
commands are delayed. `Execution.is_within` compares the resulting errors with a tracking model.

MuJoCo comes with the extra `execution`: `pip install 'hplan[execution]'`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from hplan.apps.execution.bending_wood import BendingTrees
from hplan.apps.execution.simulated_arm import CONTROL_PERIOD, Plant, SimulatedArm, Touch
from hplan.apps.execution.tree_response import TreeResponse
from hplan.base import ties
from hplan.base.arguments import instance, list_of
from hplan.base.arrays import FloatArray, Record, numbers, readonly
from hplan.base.csv_file import CsvFile
from hplan.base.units import SLIDING, TURNING, joint_unit
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.collision.held_objects import holding
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.model import Goal, Scene, with_limbs
from hplan.trajectory.cubics import evaluate, hermite_pieces
from hplan.trajectory.trajectory import Phase, Trajectory, check_units, joints_of_columns


@dataclass(frozen=True, eq=False)
class RecordedMotion(Record):
    """Positions and velocities over time, of any origin.

    Attributes:
        joint_names: Names of the `joints` joints.
        time: (n,) strictly increasing [s].
        position: (n, joints) [rad, or m if prismatic].
        velocity: (n, joints) [rad/s, or m/s if prismatic].
        slides: For each joint whether it is prismatic; empty if unknown.
    """

    joint_names: tuple[str, ...]
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    slides: tuple[bool, ...] = ()

    @classmethod
    def from_positions(cls, joint_names: Sequence[str], time: FloatArray, position: FloatArray) -> RecordedMotion:
        """Estimate velocities of a rest-to-rest motion through positions.

        The velocity at a sample is the derivative of the parabola through it and its two neighbours. It is zero at the
        first and last sample.

        Args:
            joint_names: Names of the `joints` joints.
            time: (n,) strictly increasing [s], n >= 1.
            position: (n, joints) [rad, or m if prismatic].

        Raises:
            InputError: `time` or `position` has another shape or a value that is not finite, or `time` is empty or
                does not increase.
        """
        joint_names = list_of("joint_names", joint_names, str, "names")
        time = numbers("time", time, (None,))
        if not len(time) or not (np.diff(time) > 0.0).all():
            raise InputError("time: expected at least one value, each later than the one before")
        position = numbers("position", position, (len(time), len(joint_names)))
        velocity = np.zeros_like(position)
        if len(time) > 2:
            before, after = np.diff(time)[:-1, None], np.diff(time)[1:, None]
            slopes = np.diff(position, axis=0) / np.diff(time)[:, None]
            velocity[1:-1] = (after * slopes[:-1] + before * slopes[1:]) / (before + after)
        return cls(tuple(joint_names), readonly(time), readonly(position), readonly(velocity))


#: A motion that can be executed.
Movement: TypeAlias = Trajectory | RecordedMotion


def read_motion(path: Path | str) -> RecordedMotion:
    """Read the CSV of a motion, written by any program.

    The file has one header line. Required columns, in any order: `time_s`, and for each joint `NAME_pos_rad`
    (`NAME_pos_m` if prismatic). Velocities come from the columns `NAME_vel_rad_s` (`NAME_vel_m_s`) if every joint has
    one, and are otherwise estimated by `RecordedMotion.from_positions`. Other columns are ignored, so hplan's own
    files can be read.

    Raises:
        InputError: The file or a required column is missing, a column is repeated, a cell is not a finite number, or
            time does not increase strictly; names the line.
    """
    file = CsvFile.read(path, "motion", "row")
    header = [name.strip() for name in file.header]
    joints, slides = joints_of_columns(header)
    if "time_s" not in header or not joints:
        names = f"NAME_{TURNING.columns[0]} or, if prismatic, NAME_{SLIDING.columns[0]}"
        raise file.fault(1, f"expected a header with the columns time_s and, for each joint, {names}")
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise file.fault(1, f"column {twice[0]!r} occurs twice")
    kinds = [(joint, joint_unit(slide).columns) for joint, slide in zip(joints, slides, strict=True)]
    wanted = ["time_s", *(f"{joint}_{names[0]}" for joint, names in kinds)]
    velocities = [f"{joint}_{names[1]}" for joint, names in kinds]
    if set(velocities) <= set(header):
        wanted += velocities
    table = np.array([row for _, _, row in file.timed_rows([header.index(name) for name in wanted])])
    time, position = table[:, 0], table[:, 1 : len(joints) + 1]
    if len(wanted) == len(joints) + 1:
        return replace(RecordedMotion.from_positions(joints, time, position), slides=slides)
    return RecordedMotion(joints, readonly(time), readonly(position), readonly(table[:, len(joints) + 1 :]), slides)


#: Duration of the hold after the last sample [s].
HOLD = 0.25


#: Poses of limbs are recorded once in this number of control periods.
_RECORD_TICKS = 16

#: Limbs and fruit that come nearer to the arm than this bend and hang [m].
_NEAR_M = 0.1

#: Maximum distance between configurations at which limbs near the arm are searched [rad, or m if prismatic].
_SEARCH_STEP = 0.015


@dataclass(frozen=True, eq=False)
class Execution(Record):
    """Result of executing a motion, with joints in the robot's order.

    For prismatic joints the units are m and N in place of rad and N m, despite the suffixes of the fields.

    Attributes:
        joint_names: Names of the `dof` joints.
        slides: (dof,) whether each joint is prismatic.
        duration_s: Time from the first to the last sample [s].
        contacts: Contacts in order of first touch, without `pushes`.
        pushes: Permitted deflections of compliant obstacles, in order of first touch.
        start_error_rad: (dof,) absolute difference between the first sample and the scene's start [rad]; NaN if the
            start is not given by joints.
        max_tracking_error_rad: (dof,) maximum deviation from the reference, the hold included [rad]; inf if the
            simulation diverged.
        final_error_rad: (dof,) maximum deviation from the goal between the last sample and the end of the hold [rad].
            The goal is the scene's if that is given by joints, else the last sample.
        ended_at_goal: True if `final_error_rad` is at most 0.5 deg, or 5 mm, for every joint.
        needed_torque_nm: (dof,) maximum torque of the motion itself, by inverse dynamics [N m].
        peak_torque_nm: (dof,) maximum torque that the controller commanded [N m]; much larger if an obstacle held up
            the arm.
        torque_limit_nm: (dof,) torque limits of the motors [N m].
        saturated_s: Time during which a commanded torque exceeded its limit [s].
        find_nearest: Function of `position` that computes `nearest`.
        time: (k,) instants of the controller [s].
        position: (k, dof) measured joint positions [rad]; NaN after the simulation diverged.
        reference: (k, dof) reference positions [rad].
        reference_velocity: (k, dof) reference velocities [rad/s].
        torque: (k, dof) commanded torques [N m].
        trees: Response of the trees; None if they are rigid.
    """

    joint_names: tuple[str, ...]
    slides: tuple[bool, ...]
    duration_s: float
    contacts: tuple[Touch, ...]
    pushes: tuple[Touch, ...]
    start_error_rad: tuple[float, ...]
    max_tracking_error_rad: tuple[float, ...]
    final_error_rad: tuple[float, ...]
    ended_at_goal: bool
    needed_torque_nm: tuple[float, ...]
    peak_torque_nm: tuple[float, ...]
    torque_limit_nm: tuple[float, ...]
    saturated_s: float
    find_nearest: Callable[[FloatArray], Contact | None]
    time: FloatArray
    position: FloatArray
    reference: FloatArray
    reference_velocity: FloatArray
    torque: FloatArray
    trees: TreeResponse | None = None

    @cached_property
    def nearest(self) -> Contact | None:
        """Link and obstacle at the minimum distance over all of `time`, by coal with capsule links.

        None without obstacles.
        """
        return self.find_nearest(self.position)

    def is_within(self, tracking: TrackingModel) -> bool:
        """True if all tracking errors are within a tracking model's bounds."""
        off = np.abs(self.position - self.reference)
        return bool((off <= tracking.deviations(self.reference_velocity)).all())

    @property
    def ok(self) -> bool:
        """True if the arm ended at the goal without any of `contacts`, and the trees stayed within their limits."""
        return not self.contacts and self.ended_at_goal and (self.trees is None or self.trees.ok)

    @property
    def trajectory(self) -> Trajectory:
        """Motion of the simulated arm, as long as it did not diverge; derivatives are central differences."""
        count = int(np.isfinite(self.position).all(axis=1).sum())
        time, position = self.time[:count], self.position[:count]
        velocity = np.gradient(position, time, axis=0) if count > 1 else np.zeros_like(position)
        acceleration = np.gradient(velocity, time, axis=0) if count > 1 else np.zeros_like(position)
        return Trajectory(
            self.joint_names, time, position, velocity, acceleration, self.torque[:count], slides=self.slides
        )

    @property
    def torque_exceeded(self) -> tuple[str, ...]:
        """Joints whose commanded torque exceeded the motor's limit."""
        both = zip(self.joint_names, self.peak_torque_nm, self.torque_limit_nm, strict=True)
        return tuple(name for name, peak, limit in both if peak > limit)


class Pick(NamedTuple):
    """A fruit that a motion picks.

    Attributes:
        fruit: Name of the fruit.
        touched_s: Time from which the hand may touch it: it hangs, but exerts no force [s].
        picked_s: Time when it is taken off its stalk [s].
    """

    fruit: str
    touched_s: float
    picked_s: float


def picks_in(picked: Mapping[str, float], phases: Sequence[Phase]) -> list[Pick]:
    """The fruit that a motion picks.

    A fruit may be touched during its approach, or during the whole motion to it without one.

    Args:
        picked: Picking times of the fruit, by name [s].
        phases: Phases of the motion.
    """
    found = []
    for fruit, picked_s in picked.items():
        begins = [phase.start_s for phase in phases if phase.start_s < picked_s]
        found.append(Pick(fruit, max(begins, default=0.0), picked_s))
    return found


def execute(
    robot: Robot,
    scene: Scene,
    motion: Movement,
    plant: Plant | None = None,
    trees: BendingTrees | None = None,
    *,
    picks: Sequence[Pick] = (),
    bending: Collection[str] | None = None,
) -> Execution:
    """Execute a motion on a simulated arm among a scene's obstacles.

    The arm starts at the position and velocity of the motion's first sample. All links take part: a turret that strikes
    an obstacle is a contact.

    Args:
        robot: The arm; MuJoCo reads its URDF.
        scene: The obstacles, start and goal.
        motion: The motion; its joints are the robot's, in any order.
        plant: Deviation of the simulated machine from the controller's model; None for an exact model.
        trees: Properties of limbs that bend and fruit that hang, near the motion; None for rigid and yielding ones.
        picks: The fruit that the motion picks, each an obstacle until it may be touched, as in a tour. Without any, the
            goal fruit touches nothing.
        bending: Names of the limbs that bend, and of the fruit that hang; None for those near the motion.

    Raises:
        InputError: MuJoCo is not installed; a fruit to pick is not in the scene; the motion has other joints than the
            robot, time that does not increase or values that are not finite; the scene's start or goal does not fit the
            robot; a cloud has more than 2,000 balls.
        MovingObstacleError: An obstacle of the scene moves.
        OptionError: An argument of another type.
        RobotFileError: MuJoCo refuses the URDF.
        SceneError: `trees` is given for a scene without limbs.
    """
    instance("scene", scene, Scene, "load_scene")
    robot = holding(instance("robot", robot, Robot, "load_robot"), scene.attached)
    if not all(hasattr(motion, name) for name in ("joint_names", "time", "position", "velocity")):
        raise OptionError("motion", motion, "a Trajectory, as from plan, or a Motion, as from read_motion")
    reference = _Reference.build(robot, motion)
    start, goal = (_joints(robot, scene, which, reference.position[-1]) for which in ("start", "goal"))
    if trees is not None:
        instance("trees", trees, BendingTrees)
        scene = scene if scene.wood is not None else with_limbs(scene)
    end = reference.position[-1] if goal is None else goal
    if picks:
        known = {fruit.name for fruit in scene.fruits}
        unknown = next((pick.fruit for pick in picks if pick.fruit not in known), None)
        if unknown is not None:
            raise InputError(f"the scene has no fruit {unknown!r} to pick", fruit=unknown)
        scene = scene.copy_unchecked({"goal": Goal(joints_rad=tuple(end.tolist()))})
    if trees is not None and bending is None:
        bending = find_near(robot, scene, reference.position)
    arm = SimulatedArm(robot, scene, plant, trees=trees, bending=bending, picked=[pick.fruit for pick in picks])
    return _track_reference(arm, reference, scene, start, end, picks)


@dataclass(frozen=True, eq=False)
class _Reference:
    """A motion with joints in the robot's order and time from 0."""

    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    bezier: FloatArray

    @classmethod
    def build(cls, robot: Robot, motion: Movement) -> _Reference:
        names = tuple(motion.joint_names)
        if sorted(names) != sorted(robot.joint_names):
            missing = [name for name in robot.joint_names if name not in names]
            unknown = [name for name in names if name not in robot.joint_names]
            reason = f"missing {', '.join(missing) or 'none'}; unknown {', '.join(unknown) or 'none'}"
            raise InputError(f"the motion does not move the joints of {robot.name!r}: {reason}", joints=list(names))
        check_units(dict(zip(names, getattr(motion, "slides", ()), strict=False)), robot)
        order = [names.index(name) for name in robot.joint_names]
        time = np.asarray(motion.time, dtype=np.float64)
        position, velocity = (np.asarray(values, dtype=np.float64) for values in (motion.position, motion.velocity))
        shape = (len(time), len(names))
        if time.ndim != 1 or len(time) == 0 or position.shape != shape or velocity.shape != shape:
            shapes = f"{time.shape}, {position.shape} and {velocity.shape}"
            raise InputError(f"motion: time, position and velocity have the shapes {shapes}, which do not match")
        if not all(np.isfinite(values).all() for values in (time, position, velocity)):
            raise InputError("motion: it holds a value that is not finite")
        if not (np.diff(time) > 0.0).all():
            raise InputError(f"motion: time does not increase at sample {int(np.argmin(np.diff(time) > 0.0)) + 1}")
        bezier = motion.segments[0] if isinstance(motion, Trajectory) else hermite_pieces(time, position, velocity)[0]
        return cls(time - time[0], position[:, order], velocity[:, order], bezier[:, :, order])

    def sample(self, clock: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration at (k,) times, each (k, dof).

        After the end of the motion it is the last position at rest.
        """
        if len(self.time) == 1:
            q = np.repeat(self.position, len(clock), axis=0)
            return q, np.zeros_like(q), np.zeros_like(q)
        q, v, a = (evaluate(self.bezier, self.time, clock, order) for order in range(3))
        over = (clock > self.time[-1])[:, None]
        return np.where(over, self.position[-1], q), np.where(over, 0.0, v), np.where(over, 0.0, a)


def _track_reference(
    arm: SimulatedArm, reference: _Reference, scene: Scene, start: FloatArray | None, goal: FloatArray,
    picks: Sequence[Pick],
) -> Execution:  # fmt: skip
    """Track the reference and hold its end."""
    robot, plant = arm.robot, arm.plant
    duration = float(reference.time[-1])
    ticks = math.ceil(duration / CONTROL_PERIOD - 1e-9) + math.ceil(HOLD / CONTROL_PERIOD)
    clock: FloatArray = CONTROL_PERIOD * np.arange(ticks + 1, dtype=np.float64)
    q_ref, v_ref, _ = reference.sample(clock)
    # The controller tracks the delayed reference. Until its first sample, extrapolate it at the initial velocity.
    late = clock - plant.command_delay_s
    q_late, v_late, a_late = reference.sample(np.maximum(late, 0.0))
    q_late = q_late + np.minimum(late, 0.0)[:, None] * v_late
    a_late[late < 0.0] = 0.0
    feed = np.array([arm.feed_forward(*row) for row in zip(q_late, v_late, a_late, strict=True)])
    stiffness, damping = _gains(arm, q_ref)
    arm.settle(q_ref[0])
    arm.place(q_ref[0], v_ref[0])
    position = np.full_like(q_ref, np.nan)
    torque = np.zeros_like(q_ref)
    displacement: dict[str, float] = {}
    ended = int(np.flatnonzero(clock <= duration + 1e-9)[-1])
    changes = [(pick.touched_s, arm.ignore_contacts, pick.fruit) for pick in picks]
    changes += [(pick.picked_s, arm.pass_through, pick.fruit) for pick in picks]
    changes.sort(key=itemgetter(0), reverse=True)
    for k in range(len(clock)):
        if not arm.is_finite:
            break
        position[k] = arm.position
        is_due = bool(changes) and changes[-1][0] <= clock[k] + 1e-9
        if arm.trees is not None:
            if is_due or k % _RECORD_TICKS == 0:
                arm.trees.record()
            if ended == k:
                displacement = arm.trees.fruit_displacement_m()
        while changes and changes[-1][0] <= clock[k] + 1e-9:
            _, change, fruit = changes.pop()
            change([fruit])
        if k == ticks:
            break
        if plant.decoupled:
            torque[k] = feed[k] + arm.feedback(q_late[k], v_late[k])
        else:
            torque[k] = feed[k] + stiffness * (q_late[k] - position[k]) + damping * (v_late[k] - arm.velocity)
        arm.advance(torque[k])
    # A diverged simulation has infinite errors.
    error = np.nan_to_num(np.abs(position - q_ref), nan=np.inf).max(axis=0)
    resting = clock >= duration - 1e-9
    final = np.nan_to_num(np.abs(position[resting] - goal), nan=np.inf).max(axis=0)
    limit = robot.torque_limit
    measured = frozenset() if arm.trees is None else arm.trees.measured
    # The goal counts as reached up to this error of a revolute [rad] or prismatic joint [m].
    goal_tolerance, goal_tolerance_m = math.radians(0.5), 0.005
    return Execution(
        joint_names=robot.joint_names,
        slides=robot.slides,
        duration_s=duration,
        contacts=arm.contacts,
        pushes=arm.pushes,
        start_error_rad=tuple(np.abs(q_ref[0] - (math.nan if start is None else start)).tolist()),
        max_tracking_error_rad=tuple(error.tolist()),
        final_error_rad=tuple(final.tolist()),
        ended_at_goal=bool((final <= np.where(robot.slides, goal_tolerance_m, goal_tolerance)).all()),
        needed_torque_nm=tuple(np.abs(feed).max(axis=0).tolist()),
        peak_torque_nm=tuple(np.abs(torque).max(axis=0).tolist()),
        torque_limit_nm=tuple(limit.tolist()),
        saturated_s=float((np.abs(torque) > limit).any(axis=1).sum() * CONTROL_PERIOD),
        find_nearest=partial(_nearest_contact, robot, scene, measured | {pick.fruit for pick in picks}),
        time=readonly(clock),
        position=readonly(position),
        reference=readonly(q_ref),
        reference_velocity=readonly(v_ref),
        torque=readonly(torque),
        trees=None if arm.trees is None else arm.trees.response(displacement),
    )


def find_near(
    robot: Robot, scene: Scene, positions: FloatArray, sway_m: Mapping[str, float] | None = None
) -> dict[str, list[tuple[int, int]]]:
    """Obstacles and fruit whose place at rest is near the arm along (n, dof) configurations.

    Near is closer than 0.1 m; about half of it allows for the motion between the configurations that are searched.

    Args:
        robot: The arm.
        scene: The obstacles and fruit.
        positions: The configurations.
        sway_m: Further distance by which each obstacle or fruit may move, by name [m].

    Returns:
        First and last rows of the configurations near each of them, by name.
    """
    steps = np.abs(np.diff(positions, axis=0)).max(axis=1, initial=0.0)
    stations = np.append(0.0, np.cumsum(steps))
    at = np.linspace(0.0, stations[-1], 2 + int(stations[-1] / _SEARCH_STEP))
    rows = np.unique(np.searchsorted(stations, at).clip(0, len(stations) - 1))
    checker = CoalScene(robot, scene.copy_unchecked({"wood": None}).solids_with_goal)
    solids = slice(0, checker.own_first)
    names = checker.obstacle_names[solids]
    margin = _NEAR_M + np.array([0.0 if sway_m is None else sway_m.get(name, 0.0) for name in names])
    is_near = np.array([checker.distances(q)[:, solids].min(axis=0) < margin for q in positions[rows]])
    found = dict[str, list[tuple[int, int]]]()
    for name, column in zip(names, is_near.T, strict=True):
        edges = np.flatnonzero(np.diff(column.astype(np.int64), prepend=0, append=0)).reshape(-1, 2)
        # Each searched configuration counts for the motion to its neighbours.
        spans = [(int(rows[max(first - 1, 0)]), int(rows[min(last, len(rows) - 1)])) for first, last in edges.tolist()]
        if spans:
            found[name] = [*found.get(name, []), *spans]
    return found


def _gains(arm: SimulatedArm, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(dof,) stiffness [N m/rad] and damping [N m s/rad] of the joints."""
    # The inertia is evaluated at no more than this number of samples, enough for its maximum along the motion.
    inertia_samples = 50
    rows = np.unique(np.linspace(0, len(q) - 1, inertia_samples).astype(np.int64))
    inertia = np.max([np.diag(arm.inertia(q[row])) for row in rows], axis=0)
    bandwidth = arm.plant.bandwidth
    return bandwidth**2 * inertia, 2.0 * bandwidth * inertia


def _joints(robot: Robot, scene: Scene, which: str, end: FloatArray) -> FloatArray | None:
    """Joints of a scene's start or goal; None if given otherwise.

    Continuous joints of the goal are shifted by whole turns to the values nearest to the motion's end.
    """
    joints = robot.joints_of(scene.start if which == "start" else scene.goal, which, scene.start)
    if joints is None:
        return None
    robot = robot.about(end)
    return robot.check_configuration(robot.turned_near(joints, end) if which == "goal" else joints, which)


def _nearest_contact(robot: Robot, scene: Scene, left_out: Collection[str], position: FloatArray) -> Contact | None:
    """Contact at the minimum distance over all finite configurations.

    None without obstacles other than those left out.
    """
    solids = [solid for solid in scene.solids if solid.name not in left_out]
    checker = CoalScene(robot, solids, yield_links=scene.yield_links)
    found = [contact for q in position if np.isfinite(q).all() and (contact := checker.nearest_contact(q)) is not None]
    return found[ties.argmin([contact.distance_m for contact in found])] if found else None
