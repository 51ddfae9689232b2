r"""The proof that comes with a trajectory.

Between two rows the controller is taken to follow the cubic that has the rows' positions and velocities (`cubic
Hermite`); a trajectory of hplan is exactly that curve. On it

- **clearance** is shown over continuous time: coal gives the signed distance of a link from an obstacle at some
  instant, the hull of the cubic's derivative bounds how far any point of the link can move before the next one, and the
  distance minus that bound must stay positive all the way (conservative advancement, each pair at its own pace). Where
  the arm can touch itself, its links from one another and from what carries it too, the motion as seen from there;
- **position, velocity and acceleration** are bounded for all times: the acceleration is linear between rows, the
  velocity has its extremes at rows or where the acceleration is zero, the position lies in the hull of the Bezier
  points;
- **torque** is bounded too: inverse dynamics at both ends of each cubic, and what it can do in between
  (`hplan.torque_bound`);
- the acceleration and torque columns, which a controller may feed forward, must keep the limits too;
- the motion begins and ends at rest, unless that is not asked for.

Assumed: rigid links inside their capsules, obstacles where the scene says, tracking within a model of its error
(`hplan.tracking`; it takes from the clearance; the limits are those of the commanded motion). Not covered: flexing, the
base's own motion, contact forces, what is not in the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hplan import ties
from hplan.arrays import FloatArray
from hplan.clearance_proof import prove_clearance
from hplan.collision import CollisionScene, Contact
from hplan.errors import InputError
from hplan.limit_use import LimitUse, cubic_pieces, limit_use
from hplan.robot import Robot
from hplan.scene import Scene
from hplan.tracking import TrackingModel
from hplan.trajectory import Trajectory

#: Use of a limit up to which it counts as kept.
LIMIT_TOLERANCE = 1.001

#: Speed at the ends that still counts as rest [rad/s].
REST = 1e-6


@dataclass(frozen=True)
class Certificate:
    """What was shown of a trajectory.

    Attributes:
        verified: Whether everything asked for was shown.
        min_clearance_m: Distance that every link is shown to keep at all times from every obstacle, and from every
            part of the arm that it can touch [m]; inf where there is none. Where the clearance is not shown, the
            smallest distance found, negative in contact.
        nearest: Link and obstacle, or part of the arm, at the smallest distance that was evaluated.
        limit_use: Upper bound of the use of each limit.
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
    tracking_delay_s: float = 0.0,
    rest_to_rest: bool = True,
    judge: CollisionScene | None = None,
) -> Certificate:
    """Judge a trajectory, wherever it comes from.

    Args:
        robot: The arm.
        scene: Obstacles and the clearance to keep.
        trajectory: The timed motion; its joints are the robot's.
        tracking_error: Largest deviation of any joint from the trajectory at rest [rad].
        tracking_delay_s: What comes to it for each rad/s of the joint's velocity [s].
        rest_to_rest: Whether the motion has to begin and end at rest.
        judge: The scene in coal, where it is already there.

    Returns:
        The certificate; read `verified`.

    Raises:
        InputError: The trajectory has other joints than the robot.
        OptionError: A tracking error or delay that is negative or not finite.
    """
    if trajectory.joint_names != robot.joint_names:
        raise InputError(
            f"the trajectory moves {', '.join(trajectory.joint_names)}; the robot has {', '.join(robot.joint_names)}"
        )
    tracking = TrackingModel(tracking_error, tracking_delay_s)
    judge = CollisionScene(robot, scene.solids) if judge is None else judge
    bezier, duration = cubic_pieces(trajectory)
    use = limit_use(robot, trajectory, bezier, duration)
    violations = [
        f"{what} reaches {share:.4f} of its limit"
        for what, share in vars(use).items()
        if not share <= (LIMIT_TOLERANCE if what != "position" else 1.0 + 1e-6)
    ]
    if rest_to_rest:
        for where, velocity in (("begins", trajectory.velocity[0]), ("ends", trajectory.velocity[-1])):
            if np.abs(velocity).max() > REST:
                violations.append(f"the motion {where} at {np.abs(velocity).max():.4g} rad/s, not at rest")
    speeds = _fastest(bezier, duration) if tracking.delay_s > 0.0 else np.zeros((1, robot.dof))
    proof = prove_clearance(robot, bezier, judge, tracking.deviations(speeds), scene.clearance)
    if not proof.shown:
        nearest = proof.nearest or Contact("", "", 0.0)
        violations.append(
            f"link {nearest.link!r} comes to {1e3 * nearest.distance_m:.3g} mm of {nearest.other}; to be shown: more "
            f"than {1e3 * scene.clearance:.3g} mm at a tracking error of {tracking}"
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
        nearest=contacts[ties.argmin([contact.distance_m for contact in contacts])] if contacts else None,
        limit_use=LimitUse(
            **{name: max(getattr(part.limit_use, name) for part in parts) for name in vars(parts[0].limit_use)}
        ),
        checks=sum(part.checks for part in parts),
        violations=tuple(violation for part in parts for violation in part.violations),
    )


def _fastest(bezier: FloatArray, duration: FloatArray) -> FloatArray:
    """(pieces, dof) bounds of |velocity| within each cubic: it lies in the hull of its Bezier points [rad/s]."""
    fastest: FloatArray = 3.0 * np.abs(np.diff(bezier, axis=1)).max(axis=1) / duration[:, None]
    return fastest
