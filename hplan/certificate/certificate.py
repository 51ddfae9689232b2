r"""Certificate of a trajectory, valid for all times.

Between two samples the controller follows a polynomial (`Trajectory.interpolation`): the cubic through the positions
and velocities (trajectories of hplan), the quintic that also matches the accelerations, or a straight line. On it

- **clearance** is proved over continuous time, to obstacles and between bodies of the arm that can touch each other
  (conservative advancement; the bound is in `hplan.certificate.clearance_proof`). Pairs of one arm with a rule of their
  own are excepted and listed (`hplan.certificate.pair_rules`); bodies of different arms always keep the clearance;
- the **goal fruit** may be touched by the last link only, and only on a straight approach to the grasp and in the
  retreat (`hplan.certificate.goal_contact`). All other fruits are obstacles, except in given time windows, for fruits
  that the motion approached or left before it was replanned;
- **position, velocity, acceleration and torque** are bounded for all times (`hplan.certificate.limit_use`,
  `hplan.certificate.torque_bound`);
- along straight lines the velocity jumps at the samples, which violates every acceleration and torque limit: such a
  motion is verified only if `velocity_jumps` restricts the requirements to position, velocity and clearance;
- the acceleration and torque columns, which a controller may feed forward, must keep the limits too;
- the **tilt** of a tool that has to stay upright is bounded for all times (`hplan.certificate.tool_bounds`);
- the motion starts and ends at rest and solves the scene's task (`hplan.certificate.task_check`), unless the caller
  disables these checks; if the scene's start is in motion, it starts in that state (`hplan.certificate.start_state`).

If obstacles or the base move, the proof is in space and time: at each time each obstacle is at the pose of its track.
The proof covers the motion from its start to its end; `clear_until_s` is the time until which the arm may rest at the
end.

The work is bounded by a multiple of the number of samples, at any values. A motion that exceeds the bound is not
verified.

Assumptions: links are rigid and inside their capsules or collision bodies; obstacles are at the poses and times of the
scene; the tracking error is within its model (`hplan.robot.tracking`; it reduces the clearance; the limits are those of
the commanded motion). Not covered: flexing, motion of the base other than its track, inertial forces on the arm of a
base that turns or accelerates (its tilt is covered), contact forces, obstacles that are not in the scene, visual links
without collision shapes (`Certificate.uncovered_links`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from hplan.base import ties
from hplan.base.arguments import by_name, check_between, instance, list_of, number, one_of, truth
from hplan.base.arrays import FloatArray
from hplan.base.units import FARTHEST_JOINT
from hplan.certificate.clearance_curve import (
    ClearanceCurve,
    ProvedMotion,
    ProvedStretch,
    Subject,
    joined_subjects,
)
from hplan.certificate.clearance_proof import Proof, prove_clearance
from hplan.certificate.digests import Digests
from hplan.certificate.goal_contact import REST, FruitContact, arrival_distance, contact_window
from hplan.certificate.goal_displacement import capture_violations, goal_displacement
from hplan.certificate.limb_loads import load_violations
from hplan.certificate.limit_use import LimitUse, limit_use
from hplan.certificate.motion_bound import fastest, largest_deviations
from hplan.certificate.moving_obstacles import (
    checker_in_time,
    clear_until,
    end_violations,
    moving_base_contacts,
    prediction_violations,
)
from hplan.certificate.pair_rules import PairRule, joined_rules, pair_rules
from hplan.certificate.segment_contacts import Push, SegmentContacts
from hplan.certificate.start_state import start_violations
from hplan.certificate.task_check import task_violations
from hplan.certificate.tilted_base import use_on_track
from hplan.certificate.tool_bounds import tilt_violations, tool_bounds
from hplan.certificate.touch_risk import TouchRisk, touch_risk
from hplan.certificate.turning_in_place import clearance_in_place
from hplan.collision.coal_scene import CoalScene, Contact, OwnContact
from hplan.collision.compliant_solids import check_yield_links
from hplan.collision.far_obstacles import warn_of_far_obstacles
from hplan.collision.held_objects import holding
from hplan.errors import InputError, MovingObstacleError, OptionError
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.fruit import Fruit
from hplan.scene.limits import LEAST_RISK
from hplan.scene.model import Scene, checked_scene
from hplan.scene.obstacle_kind import Sigmas
from hplan.trajectory.cubics import Interpolation
from hplan.trajectory.trajectory import Trajectory, check_trajectory_joints

#: Maximum use of a limit that counts as keeping it.
LIMIT_TOLERANCE = 1.001

#: When the last link may touch the goal fruit: on a straight approach and its retreat, or during the whole motion.
GoalContact: TypeAlias = Literal["approach", "motion"]

#: A range of the motion's segments and the collision checker that is valid there.
Stretch: TypeAlias = tuple[slice, CoalScene]


class MotionRates(NamedTuple):
    """Limit use and speeds of the motions in a trajectory.

    They are kept so that the samples added by the assembly do not change them.

    Attributes:
        limit_use: Use of each limit.
        speeds: (pieces, dof) bound of each joint's |velocity| between the samples of the trajectory [rad/s, m/s].
    """

    limit_use: LimitUse
    speeds: FloatArray


@dataclass(frozen=True)
class Certificate:
    """The result of certifying a trajectory.

    Attributes:
        verified: True if every requirement is proved.
        min_clearance_m: If the clearance is proved, a lower bound of every distance, at all times and tracking errors
            included, between obstacles and links that a joint moves, and between bodies of the arm that are checked
            [m]; inf without such pairs. The base, which no joint moves, is not counted. It is below the scene's
            clearance if a pair in `pair_rules` comes nearer. If the clearance is not proved, the minimum distance
            found, negative in contact. The distance of a compliant obstacle is offset so that its maximum deflection
            leaves exactly the required clearance (`pushes` has the deflection).
        nearest: The pair that came closest to its required distance, and its distance, at the evaluated configurations:
            at least `min_clearance_m` if the motion is verified, except for compliant obstacles. `hplan.check` reports
            the same pair for single configurations.
        limit_use: Upper bound of the use of each limit.
        checks: Number of evaluated configurations.
        violations: One message for each requirement that is not verified; empty if all are.
        goal_contact: When the last link may touch the goal fruit; None without a goal fruit, or if `certify` had a
            checker.
        contacts: All time windows in which the last link may touch a fruit, in order of time: for the goal fruit, and
            for fruits that the motion approached or left before it was replanned.
        digests: Digests of the robot, the scene and the trajectory; None for a part of a motion.
        risk: Bound of the probability that the motion touches anything; None unless `certify` was given a risk.
        subject: The certified motions, for `clearance_curve`; None for a certificate that was made by hand.
        each: The certificate of each motion of the subject by itself; empty if they do not hold for parts of it.
        nearest_s: Time of `nearest` on the clock of the tracks [s]; None if only the arm moves.
        pair_rules: Pairs of links of the arm, or of a link that turns in place and an obstacle, that do not keep the
            scene's clearance: each with its own rule and its own bound, or not checked; see
            `hplan.certificate.pair_rules`. Bodies that do not move relative to each other are not listed.
        clear_until_s: Time until which the arm is certified to keep its clearance while it rests at the end of the
            motion, on the clock of the tracks [s]; inf for no limit. None if no obstacle moves, or if the motion is not
            verified.
        uncovered_links: Names of the visual links that no collision shape covers: nothing is proved about them.
        max_tilt_rad: Upper bound of the tilt of a tool that has to stay upright, at all times, tracking errors
            included [rad]; None in scenes without `upright`.
        goal_displacement_m: Upper bound of the displacement of a grasped fruit by all earlier contacts with it and its
            limb, swinging included (`hplan.certificate.goal_displacement`) [m]; None in scenes without `wood`, and
            without a fruit to grasp.
    """

    verified: bool
    min_clearance_m: float
    nearest: Contact | None
    limit_use: LimitUse
    checks: int
    violations: tuple[str, ...]
    goal_contact: GoalContact | None = None
    contacts: tuple[FruitContact, ...] = ()
    digests: Digests | None = None
    nearest_s: float | None = None
    clear_until_s: float | None = None
    risk: TouchRisk | None = None
    subject: Subject | None = field(default=None, compare=False, repr=False)
    each: tuple[Certificate, ...] = field(default=(), compare=False, repr=False)
    pair_rules: tuple[PairRule, ...] = ()
    uncovered_links: tuple[str, ...] = ()
    goal_displacement_m: float | None = None
    max_tilt_rad: float | None = None

    @property
    def contact_s(self) -> tuple[float, float] | None:
        """Start and end of the last of `contacts` [s]; None without contacts."""
        return self.contacts[-1].span_s if self.contacts else None

    @property
    def clearance_curve(self) -> ClearanceCurve | None:
        """Clearance over time, computed on first access.

        None for a certificate that was made by hand. The computation takes as long as the certificate or several times
        as long: if the arm is far from everything, the proof does not need the distance itself.
        """
        return None if self.subject is None else self.subject.curve

    @property
    def pushes(self) -> tuple[Push, ...] | None:
        """Contacts with compliant obstacles: link, maximum deflection and time.

        Computed on first access.

        Empty if nothing is touched. None for a certificate made by hand or derived from the certificate of its path.
        """
        return None if self.subject is None else self.subject.pushes

    @property
    def pushes_by_segment(self) -> SegmentContacts:
        """Contacts with compliant obstacles within single segments; empty if they are unknown."""
        return SegmentContacts.none() if self.subject is None else self.subject.pushes_by_segment

    @property
    def reversal(self) -> Certificate:
        """Certificate of the motion in reverse, without task and contact times.

        Distances and torques are the same in both directions.

        Raises:
            MovingObstacleError: An obstacle moves; its track is not reversed.
        """
        if self.nearest_s is not None:
            raise MovingObstacleError(None if self.nearest is None else self.nearest.obstacle)
        subject = None if self.subject is None else self.subject.reversal
        return replace(self, subject=subject, each=self.each[::-1], contacts=(), digests=None)


# Fifteen parameters: robot, scene and trajectory, and keyword-only options.
def certify(
    robot: Robot,
    scene: Scene,
    trajectory: Trajectory,
    *,
    tracking_error: float = 0.0,
    tracking_delay_s: float = 0.0,
    sigmas: Sigmas = 3.0,
    risk: float | None = None,
    goal_contact: GoalContact = "approach",
    contacts: Sequence[FruitContact] = (),
    check_ends: bool = True,
    rest_to_rest: bool = True,
    checker: CoalScene | None = None,
    begin_s: float = 0.0,
    interpolation: Interpolation | None = None,
    velocity_jumps: bool = False,
) -> Certificate:
    """Certify a trajectory from any source, as `plan` certifies its own.

    Args:
        robot: The arm.
        scene: Obstacles, required clearance and task.
        trajectory: The timed motion; its joints are the robot's.
        tracking_error: Maximum deviation of any joint from the trajectory at rest [rad; m for prismatic joints].
        tracking_delay_s: Increase of this deviation per unit of the joint's velocity (rad/s or m/s) [s].
        sigmas: Growth of an obstacle in standard deviations of its position, if the scene gives a covariance.
        risk: Maximum probability that the motion touches anything; None for no bound. With a risk, obstacles are not
            grown: the clearance is to their observed poses, and the bound accounts for their position errors
            (`hplan.certificate.touch_risk`).
        goal_contact: `approach`: the last link may touch the goal fruit on a straight approach and on the retreat,
            which are detected in the motion. `motion`: it may touch the fruit during the whole motion; `plan` certifies
            with this value if no straight approach is collision-free.
        contacts: Additional time windows in which the last link may touch fruits, as in the certificate of a motion
            that was replanned (`Certificate.contacts`). They are used unchanged; a fruit that is no longer in the
            scene, equal in every value, stays an obstacle.
        check_ends: Whether the motion must solve the scene's task: start at its start, reach its goal, keep its locked
            joints fixed.
        rest_to_rest: Whether the motion must start and end at rest; if the scene's start is in motion, only end.
        checker: Collision checker of the arm among other solids than the scene's. They are used unchanged: `sigmas`,
            `goal_contact` and `contacts` have no effect, and contacts of the base are not checked.
        begin_s: Start time of the motion on the clock of the scene's tracks [s]: a motion that starts later, or takes
            over from a running one, meets moving obstacles from that time on.
        interpolation: Curve that the controller runs between samples: `cubic`, `quintic` or `linear`; None for the
            trajectory's own.
        velocity_jumps: Whether the velocity may jump, for controllers that take positions only. Along straight lines
            between samples, acceleration and torque (their `limit_use` is inf) and rest at the ends are then not
            required.

    Returns:
        The certificate; read `verified`.

    Raises:
        InputError: The trajectory's joints are not the robot's; the robot has prismatic joints and the trajectory does
            not state which joints are in metres; start or goal of the scene do not fit the robot.
        MovingObstacleError: Anything moves and `risk` is given.
        OptionError: `begin_s` is not finite; a tracking error or delay, or `sigmas`, is negative or not finite; `risk`
            is out of range or given with a `checker`; `goal_contact` or `interpolation` has an unknown value;
            `velocity_jumps` is set for a motion that is not linear between samples.
    """
    instance("robot", robot, Robot, "load_robot")
    robot = holding(robot, checked_scene(scene).attached)
    check_yield_links(robot, scene.yield_links)
    instance("trajectory", trajectory, Trajectory, "plan or read_csv")
    truth("check_ends", check_ends)
    truth("rest_to_rest", rest_to_rest)
    if interpolation is not None:
        trajectory = replace(trajectory, interpolation=interpolation)
    if truth("velocity_jumps", velocity_jumps) and trajectory.interpolation != "linear":
        raise OptionError(
            "velocity_jumps", True, f"False: between its samples the motion is {trajectory.interpolation}"
        )
    tracking = TrackingModel(tracking_error, tracking_delay_s)
    by_name("sigmas", sigmas, "a finite number >= 0", lambda value: value >= 0.0)
    warn_of_far_obstacles(robot, scene)
    if risk is not None:
        sigmas = 0.0
        check_between("risk", risk, LEAST_RISK, 1.0)
        if checker is not None:
            raise OptionError("risk", risk, "None if the checker has other solids than the scene")
        if scene.moves:
            raise MovingObstacleError(scene.first_moving, "a risk bound takes scenes without moving bodies")
    one_of("goal_contact", goal_contact, get_args(GoalContact))
    number("begin_s", begin_s, "a finite number of seconds")
    check_trajectory_joints(trajectory, robot)
    robot = robot.about(0.5 * (trajectory.position.min(axis=0) + trajectory.position.max(axis=0)))
    if any(robot.slides) and not trajectory.slides:
        joint = robot.joint_names[robot.slides.index(True)]
        missing = f"the trajectory does not say which of its joints are in metres, and {joint!r} is prismatic"
        raise InputError(f"{missing}: give Trajectory(..., slides=robot.slides) if the prismatic ones are", joint=joint)
    allowed, violations, fruit = list[FruitContact](), list[str](), None
    is_scene = checker is None
    if checker is None:
        checker, fruit, resting = checker_in_time(robot, scene, sigmas), scene.goal_fruit, scene.resting_goal_fruit
        if fruit is not None and resting is not None:
            at, rests_s = resting[0].center, resting[1] - begin_s
            allowed += goal_contacts(robot, trajectory, fruit, goal_contact, at=at, rests_s=rests_s)
        for contact in list_of("contacts", contacts, FruitContact, "contact windows, as from Certificate.contacts"):
            if contact.is_with(scene.fruits) and not any(known.covers(contact) for known in allowed):
                allowed.append(contact)
        allowed.sort(key=lambda contact: contact.span_s)
        violations += base_violations(robot, checker, trajectory, begin_s)
        violations += end_violations(checker, trajectory.position[-1], scene.clearance)
    instance("checker", checker, CoalScene, "CoalScene")
    if check_ends:
        violations += [
            *task_violations(robot, scene, _pieces(trajectory), begin_s + trajectory.time),
            *start_violations(robot, scene, trajectory),
        ]
    if rest_to_rest and scene.start.is_moving:
        violations += rest_violations(robot, trajectory, {"ends": -1}, velocity_jumps=velocity_jumps)
    certificate = certify_among(
        robot,
        trajectory,
        stretches(checker, trajectory.time, allowed, begin_s + trajectory.time),
        clearance=scene.clearance,
        tracking=tracking,
        rest_to_rest=rest_to_rest and not scene.start.is_moving,
        begin_s=begin_s,
        velocity_jumps=velocity_jumps,
    )
    certificate = on_track(certificate, robot, scene, begin_s, trajectory.duration)
    if risk is not None and certificate.subject is not None:
        touch = touch_risk(certificate.subject, scene, risk)
        certificate = replace(certificate, risk=touch)
        if touch.bound > risk:
            violations.append(touch.violation)
    found = replace(
        certificate,
        verified=certificate.verified and not violations,
        violations=(*violations, *certificate.violations),
        goal_contact=None if fruit is None else goal_contact,
        contacts=tuple(allowed),
        clear_until_s=None if violations else certificate.clear_until_s,
        digests=Digests(robot, scene, trajectory),
    )
    if found.verified or scene.wood is None or not is_scene or not checker.has_limbs:
        return found
    # Limbs reach farther as pushing links meet them. A motion that touches none is verified among rigid ones.
    again = certify(
        robot, scene.with_values(wood=scene.wood.as_rigid), trajectory,
        tracking_error=tracking_error, tracking_delay_s=tracking_delay_s, sigmas=sigmas, risk=risk,
        goal_contact=goal_contact, contacts=contacts, check_ends=check_ends, rest_to_rest=rest_to_rest,
        begin_s=begin_s, velocity_jumps=velocity_jumps,
    )  # fmt: skip
    return replace(again, digests=found.digests) if again.verified else found


def goal_contacts(
    robot: Robot,
    trajectory: Trajectory,
    fruit: Fruit,
    goal_contact: GoalContact,
    *,
    at: tuple[float, float, float] | None = None,
    rests_s: float = -math.inf,
) -> tuple[FruitContact, ...]:
    """Time window in which the last link may touch the goal fruit.

    Empty if the motion never reaches the fruit while it rests.

    Args:
        at: Centre of the fruit at rest, in `base_link`; None for its listed one [m].
        rests_s: Time from which it rests, from the start of the motion [s].
    """
    time, last = trajectory.time, trajectory.samples - 1
    first = int(np.searchsorted(time, rests_s))
    pieces: slice | None = slice(first, last) if first <= last else None
    if goal_contact != "motion" and pieces is not None:
        bezier = _pieces(trajectory)[min(first, max(0, last - 1)) :]
        found = contact_window(robot, bezier, at or fruit.center, arrival_distance(fruit))
        pieces = None if found is None else slice(found.start + first, found.stop + first)
    if pieces is None:
        return ()
    return (FruitContact(fruit, float(time[min(pieces.start, last)]), float(time[min(pieces.stop, last)])),)


def _pieces(trajectory: Trajectory) -> FloatArray:
    """Bezier points of a motion, (segments, 4 or 6, dof).

    Clipped to +-`FARTHEST_JOINT`.
    """
    bezier: FloatArray = np.clip(trajectory.segments[0], -FARTHEST_JOINT, FARTHEST_JOINT)
    return bezier


def base_violations(robot: Robot, checker: CoalScene, trajectory: Trajectory, begin_s: float) -> Iterator[str]:
    """Messages about obstacles that penetrate the base during a motion.

    Args:
        checker: Collision checker of the arm among the obstacles.
        trajectory: The motion.
        begin_s: Start time of the motion on the clock of the obstacles' movements [s].
    """
    if checker.moving is not None:
        yield from moving_base_contacts(robot, checker.moving, begin_s, begin_s + trajectory.duration)
    for found in checker.base_contacts:
        depth = f"{-1e3 * found.distance_m:.3g} mm deep in the robot's {found.link!r}, which does not move"
        yield f"obstacle {found.obstacle!r} is {depth}"


def stretches(
    checker: CoalScene, clock: FloatArray, contacts: Iterable[FruitContact], times: FloatArray | None = None
) -> list[Stretch]:
    """Split a motion at its fruit contacts into ranges with collision checkers.

    A moving fruit may be touched only once it rests.

    Args:
        clock: (n,) times of the motion's samples, on the clock of the contacts [s].
        times: (n,) times of the samples on the clock of the obstacles' movements; None for `clock` [s].
    """
    times = clock if times is None else times
    inside = list[tuple[slice, Fruit]]()
    for each in contacts:
        pieces, first = each.pieces(clock), int(np.searchsorted(times, checker.rests_from(each.fruit.name)))
        if pieces is not None and first < pieces.stop:
            inside.append((slice(max(first, pieces.start), pieces.stop), each.fruit))
    ends = {end for pieces, _ in inside for end in (pieces.start, pieces.stop)}
    found = []
    for first, last in pairwise(sorted({0, max(1, len(clock) - 1), *ends})):
        among = checker
        for pieces, fruit in inside:
            if pieces.start <= first and last <= pieces.stop:
                among = among.allow_touch(fruit.name, fruit.hangs_from)
        found.append((slice(first, last), among))
    return found


def certify_among(
    robot: Robot,
    trajectory: Trajectory,
    among: Sequence[Stretch],
    *,
    clearance: float,
    tracking: TrackingModel,
    rest_to_rest: bool = True,
    begin_s: float = 0.0,
    rates: MotionRates | None = None,
    velocity_jumps: bool = False,
    measured: bool = True,
) -> Certificate:
    """Certify a trajectory, or part of one, with given collision checkers.

    Args:
        trajectory: The timed motion; its joints are the robot's.
        among: Ranges of segments that cover the whole motion, each with its collision checker.
        clearance: Required clearance [m].
        tracking: Model of the covered joint deviations.
        rest_to_rest: Whether the motion must start and end at rest.
        begin_s: Start time of the motion on the clock of the obstacles' movements [s].
        rates: Limit use and speeds, if the motion is assembled from others; None computes both.
        velocity_jumps: Whether the velocity may jump along straight lines between samples (see `certify`).
        measured: Whether the minimum distance is searched if the clearance is not proved; otherwise the certificate of
            such a motion has a distance that is too small for the clearance, but need not be the minimum.

    Raises:
        InputError: The trajectory's joints are not the robot's.
    """
    check_trajectory_joints(trajectory, robot)
    bezier, duration = trajectory.segments
    use = limit_use(robot, trajectory, bezier, duration) if rates is None else rates.limit_use
    violations = list(limit_violations(use, velocity_jumps=velocity_jumps))
    if rest_to_rest:
        violations += rest_violations(robot, trajectory, {"begins": 0, "ends": -1}, velocity_jumps=velocity_jumps)
    speeds = np.zeros((1, robot.dof))
    if tracking.delay_s > 0.0:
        speeds = fastest(bezier, duration) if rates is None else rates.speeds
    deviations, at_rest = (largest_deviations(robot, tracking, at) for at in (speeds, np.zeros((1, robot.dof))))
    clock = begin_s + (trajectory.time if trajectory.samples > 1 else np.zeros(2))
    seen_s, rules = list[float | None](), list[tuple[PairRule, ...]]()
    proved, wanted = [], f"more than {1e3 * clearance:.3g} mm at a tracking error of {tracking.summary(robot.slides)}"
    for part, checker in among:
        own = deviations if len(deviations) == 1 else deviations[part]
        times = clock[part.start : part.stop + 1]
        proof = prove_clearance(bezier[part], checker, own, clearance, times, measured=measured)
        rules.append(pair_rules(checker.with_margins(float(own.max()), clearance), proof, clearance))
        proved.append(ProvedStretch(part, checker, own, proof, times))
        seen_s.append(None if checker.moving is None else _time_of(proof, times))
        violations += _not_shown(robot, proof, trajectory, part.start, wanted, seen_s[-1])
    proofs = [stretch.proof for stretch in proved]
    last = among[-1][1]
    if last.moving is not None:
        violations += prediction_violations(last.moving, float(clock[-1]))
    tilt = None
    if last.upright is not None:
        tilt = tool_bounds(robot, trajectory, last.upright, tracking).tilt_rad
        violations += tilt_violations(last.upright, tilt)
    missing = [proof.clearance_m for proof in proofs if not proof.is_certified]
    least = min(missing or (proof.clearance_m for proof in proofs))
    motion = ProvedMotion(robot, trajectory, tuple(proved), clearance)
    subject, moved = Subject(((motion, False),)), None
    if not violations and subject.has_limbs:
        violations += load_violations(robot, subject.pushes_by_segment)
        moved = goal_displacement(subject)
        violations += capture_violations(moved)
    in_place = clearance_in_place(last, (float(clock[0]), float(clock[-1])), clearance, least)
    found = Certificate(
        verified=not violations,
        min_clearance_m=min(least, in_place.distance_m),
        nearest=_nearest_of(proof.nearest for proof in proofs),
        limit_use=use,
        checks=sum(proof.checks for proof in proofs),
        violations=tuple(violations),
        nearest_s=_nearest_s([proof.nearest for proof in proofs], seen_s),
        pair_rules=joined_rules([*rules, in_place.rules]),
        clear_until_s=None
        if last.moving is None or violations
        else clear_until(bezier[-1, -1], last, at_rest, clearance, clock[-1]),
        uncovered_links=robot.uncovered_links,
        goal_displacement_m=None if moved is None else moved.moved_m,
        max_tilt_rad=tilt,
    )
    holds_for_parts = found.verified and last.moving is None and not subject.has_limbs
    return replace(found, subject=subject, each=(found,) if holds_for_parts else ())


def certificate_of_part(whole: Certificate, begin_s: float, end_s: float) -> Certificate | None:
    """Certificate of a motion between two of its samples, from the certificate of the whole.

    Its bounds are those of the motions that the part is from. Like the parts of a sequence (`all_of`), it has neither
    task nor contact times.

    Args:
        whole: Certificate of the motion.
        begin_s: Time of the first sample [s].
        end_s: Time of the last sample [s].

    Returns:
        The certificate; None if the whole is not verified, its subject is unknown, something moves or bends, or the
        part has no segment.
    """
    if not whole.verified or whole.subject is None or len(whole.each) < len(whole.subject.motions):
        return None
    subject, numbers = whole.subject.cut(begin_s, end_s)
    each = tuple(whole.each[number] for number in numbers)
    return replace(all_of(each), checks=0, subject=subject, each=each) if each else None


def rest_violations(
    robot: Robot, trajectory: Trajectory, ends: Mapping[str, int], *, velocity_jumps: bool = False
) -> Iterator[str]:
    """Messages about ends of a motion that are not at rest.

    Both the sample velocities and the end velocities of the curve between samples are checked.

    Args:
        ends: Verb of the message ("begins" or "ends"), and the sample: 0 for the first, -1 for the last.
        velocity_jumps: Whether the velocity may jump at the ends, along straight lines between samples.
    """
    leaving = trajectory.end_velocities
    for where, row in ends.items():
        if velocity_jumps:
            continue
        speeds = np.maximum(np.abs(trajectory.velocity[row]), np.abs(leaving[row]))
        joint = int(speeds.argmax())
        if speeds[joint] > REST:
            name, unit = robot.joint_names[joint], robot.units[joint].velocity
            yield f"the motion {where} with joint {name!r} at {speeds[joint]:.4g} {unit}, not at rest"


def with_violations(certificate: Certificate, more: Iterable[str]) -> Certificate:
    """Certificate with additional violations; not verified if there are any."""
    found = tuple(more)
    if not found:
        return certificate
    return replace(certificate, verified=False, violations=(*certificate.violations, *found), clear_until_s=None)


def on_track(certificate: Certificate, robot: Robot, scene: Scene, begin_s: float, duration: float) -> Certificate:
    """Certificate with the limit use of a base that tilts (`hplan.certificate.tilted_base`)."""
    use = use_on_track(certificate.limit_use, robot, scene, begin_s, duration)
    known = set(limit_violations(certificate.limit_use))
    more = (f"{broken}, as the base tilts" for broken in limit_violations(use) if broken not in known)
    return with_violations(replace(certificate, limit_use=use), more)


def limit_violations(use: LimitUse, *, velocity_jumps: bool = False) -> Iterator[str]:
    """Messages about limits that are not verified.

    With `velocity_jumps`, only the limits of position and velocity are checked.
    """
    for what, fraction in vars(use).items():
        if velocity_jumps and what in ("acceleration", "torque"):
            continue
        if not fraction <= (LIMIT_TOLERANCE if what != "position" else 1.0 + 1e-6):
            yield f"{what} reaches {fraction:{'.4f' if fraction < 1e4 else '.4g'}} of its limit"


def all_of(parts: Sequence[Certificate]) -> Certificate:
    """Certificate of a sequence of motions.

    If obstacles move, all parts use the same clock. What one part does to a fruit counts for its grasp in a later one.
    """
    if len(parts) == 1:
        return parts[0]
    subject, moved = joined_subjects(part.subject for part in parts), None
    each = tuple(alone for part in parts for alone in part.each) if all(part.each for part in parts) else ()
    if subject is not None and subject.has_limbs:
        moved = goal_displacement(subject)
    violations = dict.fromkeys(violation for part in parts for violation in part.violations)
    violations |= dict.fromkeys(capture_violations(moved))
    return Certificate(
        verified=not violations and all(part.verified for part in parts),
        min_clearance_m=min(part.min_clearance_m for part in parts),
        nearest=_nearest_of(part.nearest for part in parts),
        limit_use=LimitUse.largest(part.limit_use for part in parts),
        checks=sum(part.checks for part in parts),
        violations=tuple(violations),
        subject=subject,
        each=each,
        nearest_s=_nearest_s([part.nearest for part in parts], [part.nearest_s for part in parts]),
        clear_until_s=parts[-1].clear_until_s if all(part.verified for part in parts) else None,
        pair_rules=joined_rules(part.pair_rules for part in parts),
        uncovered_links=tuple(dict.fromkeys(name for part in parts for name in part.uncovered_links)),
        goal_displacement_m=None if moved is None else moved.moved_m,
        max_tilt_rad=max((p.max_tilt_rad for p in parts if p.max_tilt_rad is not None), default=None),
    )


def _not_shown(
    robot: Robot, proof: Proof, trajectory: Trajectory, first: int, wanted: str, seen_s: float | None
) -> Iterator[str]:
    """Messages about clearance that a proof does not verify.

    They name the first unverified segment, and the nearest pair with its distance and time.
    """
    if proof.is_certified:
        return
    piece = first + int(proof.end)
    begin = trajectory.time[min(piece, trajectory.samples - 1)]
    end = trajectory.time[min(piece + 1, trajectory.samples - 1)]
    if proof.outcome == "travel":
        yield f"clearance cannot be proved: from {begin:.6g} s to {end:.6g} s the motion is too fast to be bounded"
    elif proof.outcome == "checks":
        at = begin + (proof.end - int(proof.end)) * (end - begin)
        yield f"clearance is not proved after {at:.6g} s, where the {proof.checks:,} distance queries are used up"
    if proof.nearest is not None:
        near, when = proof.nearest, "" if seen_s is None else f" at {seen_s:.6g} s"
        other = robot.link_in_words(near.obstacle) if isinstance(near, OwnContact) else near.other_name
        yield (
            f"{robot.link_in_words(near.link)} comes to {1e3 * near.distance_m:.3g} mm of {other}{when}; "
            f"required: {wanted}"
        )


def _nearest_s(contacts: Sequence[Contact | None], seen_s: Sequence[float | None]) -> float | None:
    """Time of the nearest contact [s]; None if unknown."""
    nearest = _nearest_of(contacts)
    return next((at for contact, at in zip(contacts, seen_s, strict=True) if contact is nearest), None)


def _time_of(proof: Proof, clock: FloatArray) -> float:
    """Time of the nearest pair found by a proof [s]."""
    return float(np.interp(proof.nearest_at, np.arange(len(clock)), clock))


def _nearest_of(contacts: Iterable[Contact | None]) -> Contact | None:
    """Contact with the minimum distance; None without contacts."""
    found = [contact for contact in contacts if contact is not None]
    return found[ties.argmin([contact.distance_m for contact in found])] if found else None
