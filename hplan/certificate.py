r"""The proof that comes with a trajectory.

Between two rows the controller is taken to follow the cubic that has the rows' positions and velocities (`cubic
Hermite`); a trajectory of hplan is exactly that curve. On it

- **clearance** is shown over continuous time: coal gives the signed distance of a link from an obstacle at some
  instant, the hull of the cubic's derivative bounds how far any point of the link can move before the next one, and the
  distance minus that bound must stay positive all the way (conservative advancement, each pair at its own pace). Where
  the arm can touch itself, its links from one another and from what carries it too, the motion as seen from there;
- **position, velocity and acceleration** are bounded exactly: the acceleration is linear between rows, the velocity
  has its extremes at rows or where the acceleration is zero, the position within the hull of the Bezier points;
- **torque** is inverse dynamics at the rows and in between, at most 2 ms apart: a fine sample, not a bound;
- the acceleration and torque columns, which a controller may feed forward, must keep the limits too;
- the motion begins and ends at rest, unless that is not asked for.

Assumed: rigid links inside their capsules, obstacles where the scene says, tracking within `tracking_error` [rad] a
joint (it takes from the clearance; the limits are those of the commanded motion). Not covered: flexing, the base's own
motion, contact forces, what is not in the scene.
"""

from __future__ import annotations

import bisect
import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hplan.arrays import FloatArray
from hplan.collision import CollisionScene, Contact
from hplan.dynamics import InverseDynamics
from hplan.errors import InputError, OptionError
from hplan.kernels import kernel
from hplan.robot import Robot
from hplan.scene import Scene
from hplan.self_contact import pair_rates, pair_sway
from hplan.trajectory import Trajectory

#: Use of a limit up to which it counts as kept.
LIMIT_TOLERANCE = 1.001

#: Spare clearance below which the proof gives up [m]: its steps, half of what is spare, would become too small.
SMALLEST_STEP = 1e-5

#: Largest share of what a pair has to spare that its link may travel before the next look: where coal iterates (hulls),
#: its distances are good to a few micrometres.
MOST_TRAVEL = 0.99

#: Longest time between two looks at the torque [s].
TORQUE_PERIOD = 2e-3

#: Speed at the ends that still counts as rest [rad/s].
REST = 1e-6


@dataclass(frozen=True)
class LimitUse:
    """Largest share of each limit that the trajectory uses; position: 1 at a limit, over 1 outside.

    Attributes:
        position: Largest distance from the middle of the joint range, as a share of half the range.
        velocity: Largest |velocity| / limit.
        acceleration: Largest |acceleration| / limit.
        torque: Largest |torque| / limit.
    """

    position: float
    velocity: float
    acceleration: float
    torque: float


@dataclass(frozen=True)
class Certificate:
    """What was shown of a trajectory.

    Attributes:
        verified: Whether everything asked for was shown.
        min_clearance_m: Distance that every link is shown to keep at all times from every obstacle, and from every
            part of the arm that it can touch [m]; inf where there is none. Where the clearance is not shown, the
            smallest distance found, negative in contact.
        nearest: Link and obstacle, or part of the arm, at the smallest distance that was evaluated.
        limit_use: Largest use of each limit.
        checks: Number of configurations at which distances were evaluated.
        violations: What was not shown, in words; empty when verified.
    """

    verified: bool
    min_clearance_m: float
    nearest: Contact | None
    limit_use: LimitUse
    checks: int
    violations: tuple[str, ...]


def certify(
    robot: Robot,
    scene: Scene,
    trajectory: Trajectory,
    *,
    tracking_error: float = 0.0,
    rest_to_rest: bool = True,
    judge: CollisionScene | None = None,
) -> Certificate:
    """Judge a trajectory, wherever it comes from.

    Args:
        robot: The arm.
        scene: Obstacles and the clearance to keep.
        trajectory: The timed motion; its joints are the robot's.
        tracking_error: Largest deviation of any joint from the trajectory [rad].
        rest_to_rest: Whether the motion has to begin and end at rest.
        judge: The scene in coal, where it is already there.

    Returns:
        The certificate; read `verified`.

    Raises:
        InputError: The trajectory has other joints than the robot.
        OptionError: A tracking error that is negative or not finite.
    """
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; the robot has {', '.join(robot.joint_names)}"
        )
    if not (np.isfinite(tracking_error) and tracking_error >= 0.0):
        raise OptionError("tracking_error", tracking_error, "a finite number of radians >= 0")
    judge = CollisionScene(robot, scene.solids) if judge is None else judge
    bezier = _bezier(trajectory)
    use = _limit_use(robot, trajectory, bezier)
    violations = [
        f"{what} reaches {share:.4f} of its limit"
        for what, share in vars(use).items()
        if not share <= (LIMIT_TOLERANCE if what != "position" else 1.0 + 1e-6)
    ]
    if rest_to_rest:
        for where, velocity in (("begins", trajectory.velocity[0]), ("ends", trajectory.velocity[-1])):
            if np.abs(velocity).max() > REST:
                violations.append(f"the motion {where} at {np.abs(velocity).max():.4g} rad/s, not at rest")
    proof = _prove_clearance(robot, bezier, judge, tracking_error, scene.clearance)
    if not proof.shown:
        nearest = proof.nearest or Contact("", "", 0.0)
        violations.append(
            f"link {nearest.link!r} comes to {1e3 * nearest.distance_m:.3g} mm of {nearest.other}; to be shown: more "
            f"than {1e3 * scene.clearance:.3g} mm at a tracking error of {tracking_error:g} rad"
        )
    return Certificate(not violations, proof.clearance_m, proof.nearest, use, proof.checks, tuple(violations))


def all_of(parts: Sequence[Certificate]) -> Certificate:
    """The certificate of motions one after the other."""
    if len(parts) == 1:
        return parts[0]
    contacts = [part.nearest for part in parts if part.nearest is not None]
    return Certificate(
        verified=all(part.verified for part in parts),
        min_clearance_m=min(part.min_clearance_m for part in parts),
        nearest=min(contacts, key=lambda contact: contact.distance_m, default=None),
        limit_use=LimitUse(
            **{name: max(getattr(part.limit_use, name) for part in parts) for name in vars(parts[0].limit_use)}
        ),
        checks=sum(part.checks for part in parts),
        violations=tuple(violation for part in parts for violation in part.violations),
    )


def _bezier(trajectory: Trajectory) -> FloatArray:
    """(rows - 1, 4, dof) Bezier points of the cubics between rows; one constant piece for a single row."""
    q, v = trajectory.position, trajectory.velocity
    if len(q) == 1:
        return np.repeat(q[:, None, :], 4, axis=1)
    third = np.diff(trajectory.time)[:, None] / 3.0
    return np.stack([q[:-1], q[:-1] + third * v[:-1], q[1:] - third * v[1:], q[1:]], axis=1)


def _limit_use(robot: Robot, trajectory: Trajectory, bezier: FloatArray) -> LimitUse:
    middle, half = 0.5 * (robot.lower + robot.upper), 0.5 * (robot.upper - robot.lower)
    position = np.abs(bezier - middle).max(axis=(0, 1)) / half
    duration = np.diff(trajectory.time)[:, None] if len(trajectory.time) > 1 else np.ones((1, 1))
    # Derivatives of the cubic: velocity (quadratic, three Bezier points), acceleration (linear, its two ends).
    velocity = 3.0 * np.diff(bezier, axis=1) / duration[:, None]
    acceleration = 2.0 * np.diff(velocity, axis=1) / duration[:, None]
    peak = np.abs(velocity[:, [0, 2]]).max(axis=(0, 1))
    start, end = acceleration[:, 0], acceleration[:, 1]
    turning = start * end < 0.0
    share = np.where(turning, start / np.where(turning, start - end, 1.0), 0.0)
    inner = velocity[:, 0] + duration * share * (start + 0.5 * share * (end - start))
    peak = np.maximum(peak, np.abs(inner).max(axis=0))
    peak_acceleration = np.maximum(np.abs(acceleration).max(axis=(0, 1)), np.abs(trajectory.acceleration).max(axis=0))
    torque = _torques(robot.dynamics, bezier, velocity, acceleration, float(duration.max()))
    return LimitUse(
        position=float(position.max()),
        velocity=_share(np.maximum(peak, np.abs(trajectory.velocity).max(axis=0)), robot.velocity_limit),
        acceleration=_share(peak_acceleration, robot.acceleration_limit),
        torque=_share(np.maximum(torque, np.abs(trajectory.torque).max(axis=0)), robot.torque_limit),
    )


def _share(peak: FloatArray, limit: FloatArray) -> float:
    """Largest share of a limit; a joint that does not move may have a limit of zero."""
    idle = (peak <= 1e-9) & (limit <= 0.0)
    return float(np.where(idle, 0.0, peak / np.where(limit > 0.0, limit, 1e-300)).max())


def _torques(
    dynamics: InverseDynamics, bezier: FloatArray, velocity: FloatArray, acceleration: FloatArray, longest: float
) -> FloatArray:
    """(dof,) largest |torque| at the rows and, `TORQUE_PERIOD` apart, between them."""
    parts = max(1, int(np.ceil(longest / TORQUE_PERIOD - 1e-9)))
    t = (np.arange(parts) / parts)[:, None, None]
    u = 1.0 - t
    q = _cubic(np.moveaxis(bezier, 1, 0)[:, None], t)
    v = u**2 * velocity[:, 0] + 2.0 * u * t * velocity[:, 1] + t**2 * velocity[:, 2]
    a = u * acceleration[:, 0] + t * acceleration[:, 1]
    rows = [values.reshape(-1, bezier.shape[2]) for values in (q, v, a)]
    rows = [
        np.vstack([inner, end[-1]])
        for inner, end in zip(rows, (bezier[:, 3], velocity[:, 2], acceleration[:, 1]), strict=True)
    ]
    return np.asarray(np.abs(dynamics.torques(*rows)).max(axis=0))


@dataclass(frozen=True)
class _Proof:
    """Clearance over the whole motion: whether it is shown, how much, the nearest pair, looks taken."""

    shown: bool
    clearance_m: float
    nearest: Contact | None
    checks: int


def _prove_clearance(
    robot: Robot, bezier: FloatArray, judge: CollisionScene, tracking_error: float, needed: float
) -> _Proof:
    """Conservative advancement along the cubics, for each pair of link and obstacle on its own.

    Each pair has a mover: that of an obstacle is the link, and each pair of parts of the arm has one of its own, the
    link as seen from the other part.

    What a pair has to spare when coal is asked, less what has been shown so far (at most half of what any pair had to
    spare), its mover may travel before the pair is asked again; so at least what is shown remains at all times. Places
    are counted in rows. Where the proof has to give up, the rest of the motion is searched for the worst.
    """
    rows, movers = len(bezier), _movers(judge)
    sway = _sways(robot, judge, tracking_error)
    bounds = np.column_stack([_piece_bounds(robot, bezier), *_own_bounds(robot, bezier, judge)])
    travel = np.concatenate([np.zeros((1, bounds.shape[1])), np.cumsum(bounds, axis=0)]).T.tolist()
    if not judge.pairs:
        return _Proof(True, math.inf, None, 0)
    # At the start all pairs at once; those that cannot come near in the whole motion are not asked again.
    distances = judge.pair_distances(bezier[0, 0])
    mover_of = np.array(movers)
    spares = distances - np.array(sway)[mover_of] - needed
    nearest, checks = (float(distances.min()), int(distances.argmin())), 1
    if not spares.min() > SMALLEST_STEP:
        return _worst(bezier, judge, travel, sway, nearest, checks, 0)
    shown = 0.5 * float(spares.min())
    if shown == math.inf:
        return _Proof(True, math.inf, _contact(judge, nearest), checks)  # all may touch
    parts = np.minimum(spares - shown, MOST_TRAVEL * spares)
    due = [
        (_advance(travel[mover_of[pair]], 0.0, parts[pair]), int(pair))
        for pair in np.flatnonzero(parts < np.array([steps[-1] for steps in travel])[mover_of])
    ]
    heapq.heapify(due)
    while due:
        at = due[0][0]
        judge.place(_point(bezier, at))
        checks += 1
        following, asked = math.inf, []
        # Together with the pair that is due, those that would be before it is due again.
        while due and due[0][0] < following:
            pair = heapq.heappop(due)[1]
            mover = movers[pair]
            distance = judge.pair_distance(pair)
            nearest = min(nearest, (distance, pair))
            spare = distance - sway[mover] - needed
            if not spare > SMALLEST_STEP:
                return _worst(bezier, judge, travel, sway, nearest, checks, min(int(at), rows - 1))
            shown = min(shown, 0.5 * spare)
            if spare == math.inf:
                continue  # these two may touch
            part = min(spare - shown, MOST_TRAVEL * spare)
            place = max(_advance(travel[mover], at, part), math.nextafter(at, math.inf))
            following = min(following, place)
            if place <= rows:
                asked.append((place, pair))
        for entry in asked:
            heapq.heappush(due, entry)
    return _Proof(True, needed + shown, _contact(judge, nearest), checks)


def _advance(travel: list[float], at: float, part: float) -> float:
    """The place up to which a link travels no farther than `part`; `travel` grows linearly within a row.

    Infinite where that is the end.
    """
    row = min(int(at), len(travel) - 2)
    limit = travel[row] + (at - row) * (travel[row + 1] - travel[row]) + part
    row = bisect.bisect_right(travel, limit) - 1
    if row >= len(travel) - 1:
        return math.inf
    return row + (limit - travel[row]) / (travel[row + 1] - travel[row])


@kernel
def _point(bezier: FloatArray, at: float) -> FloatArray:
    """Configuration at a place counted in rows."""
    piece = min(int(at), bezier.shape[0] - 1)
    t = at - piece
    u = 1.0 - t
    q = np.empty(bezier.shape[2])
    for j in range(len(q)):
        q[j] = (
            u * u * u * bezier[piece, 0, j]
            + 3.0 * u * u * t * bezier[piece, 1, j]
            + 3.0 * u * t * t * bezier[piece, 2, j]
            + t * t * t * bezier[piece, 3, j]
        )
    return q


def _contact(judge: CollisionScene, nearest: tuple[float, int]) -> Contact | None:
    """A distance and the pair it belongs to, by name; None without pairs."""
    distance, pair = nearest
    if not judge.pairs:
        return None
    return judge.contact(*judge.pairs[pair], distance)


def _movers(judge: CollisionScene) -> list[int]:
    """The number of each pair's mover: the link, and beyond the links one for each pair of parts of the arm."""
    first, links = len(judge.pairs) - len(judge.own_others), len(judge.link_names)
    return [link for link, _ in judge.pairs[:first]] + list(range(links, links + len(judge.own_others)))


def _own_pairs(judge: CollisionScene) -> list[tuple[int, int]]:
    """The link of each pair of parts of the arm, and the other part."""
    first = len(judge.pairs) - len(judge.own_others)
    return [(link, other) for (link, _), other in zip(judge.pairs[first:], judge.own_others, strict=True)]


def _sways(robot: Robot, judge: CollisionScene, tracking_error: float) -> list[float]:
    """What the tracking error may take from the distances of each mover [m]."""
    sway: list[float] = robot.sway(tracking_error).tolist()
    return sway + [pair_sway(robot, link, other, tracking_error) for link, other in _own_pairs(judge)]


def _own_bounds(robot: Robot, bezier: FloatArray, judge: CollisionScene) -> list[FloatArray]:
    """As `_piece_bounds`, for each pair of parts of the arm."""
    if not judge.own_others:
        return []
    rates = 3.0 * np.diff(bezier, axis=1)
    return [pair_rates(robot, link, other, rates) for link, other in _own_pairs(judge)]


def _worst(
    bezier: FloatArray,
    judge: CollisionScene,
    travel: list[list[float]],
    sway: list[float],
    nearest: tuple[float, int],
    checks: int,
    first: int,
) -> _Proof:
    """What a proof that gave up in row `first` reports: the smallest distance at the rows from there on.

    A pair is not asked where its mover has not yet travelled what it was farther away than the nearest.
    """
    rows, least, movers = len(bezier), math.inf, _movers(judge)
    due = [(first, pair) for pair in range(len(judge.pairs))]
    while due:
        row = due[0][0]
        judge.place(_point(bezier, float(row)))
        checks += 1
        while due and due[0][0] == row:
            pair = heapq.heappop(due)[1]
            mover = movers[pair]
            distance = judge.pair_distance(pair)
            nearest = min(nearest, (distance, pair))
            least = min(least, distance - sway[mover])
            ahead = _advance(travel[mover], row, min(distance - nearest[0], distance - sway[mover] - least))
            following = max(math.ceil(min(ahead, rows + 1.0)), row + 1)
            if following <= rows:
                heapq.heappush(due, (following, pair))
    return _Proof(False, min(least, nearest[0]), _contact(judge, nearest), checks)


def _cubic(points: FloatArray, t: float | FloatArray) -> FloatArray:
    """Cubics with the given four Bezier points (first axis) at their parameters."""
    u = 1.0 - t
    value: FloatArray = u**3 * points[0] + 3.0 * u * u * t * points[1] + 3.0 * u * t * t * points[2] + t**3 * points[3]
    return value


def _piece_bounds(robot: Robot, bezier: FloatArray) -> FloatArray:
    """(pieces, links) largest distance that any axis point of a link can travel within each cubic [m].

    A point of link k moves by no more than the sum over links i <= k of length times turn of the absolute angle, plus
    yaw times the largest distance from the yaw axis; the turns are bounded by the hull of the derivative.
    """
    arm = robot.arm
    rates = 3.0 * np.abs(np.cumsum(arm.signs * np.diff(bezier[..., robot.arm_slice], axis=1), axis=2)).max(axis=1)
    bounds: FloatArray = np.cumsum(arm.lengths * rates, axis=1)
    if robot.has_yaw:
        swing = 3.0 * np.abs(np.diff(bezier[..., 0], axis=1)).max(axis=1)
        bounds = bounds + swing[:, None] * robot.yaw_radius
    return bounds
