r"""Inverse kinematics of any robot for a tool position, from any direction.

The tool approaches along its axis (`Robot.tool_axis`); rotation about this axis is free. The *approach angle* is the
angle of the axis against the horizontal: 0 is outward from the base, 90 degrees straight up, 180 back towards the base.
With :math:`\hat\rho` the horizontal direction from the first joint to the point and :math:`\hat z` upward, the
direction with the angle :math:`\alpha` and the heading :math:`\psi \in [-90, 90)` degrees is

.. math:: \cos\alpha (\cos\psi \, \hat\rho + \sin\psi \, \hat z \times \hat\rho) + \sin\alpha \, \hat z.

A fixed set of directions is spread evenly over the sphere, or over the requested part of it. For each direction the
configurations are computed from several starts (`hplan.kinematics.damped_steps`). A further search ignores the
direction: an arm with fewer than five joints cannot choose it, nor can any arm near the boundary of its workspace.
Every configuration returned reaches the point, but a point without one need not be out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hplan.base.arguments import check_integer, list_of
from hplan.base.arrays import BoolArray, FloatArray, frozen, numbers
from hplan.collision.motion_coefficients import carriers, joint_axis
from hplan.errors import UnreachableError
from hplan.kinematics.approach_angles import Window
from hplan.kinematics.damped_steps import ABOUT_Z, ANY_TURN, Chain, solve_each
from hplan.kinematics.inverse_kinematics import MOST_SEEDS, chain_of, distinct, spread_starts, with_direction
from hplan.robot.model import Robot

#: Number of directions, and number of starts for each.
_COUNT, _STARTS = 64, 6

#: Step between successive headings, as a fraction of half a turn (golden ratio).
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)

#: Distance from the joint axis below which a tool counts as on the axis: the accuracy of its position [m].
_ON_AXIS = 1e-6


def tool_at_point(
    robot: Robot,
    position: ArrayLike,
    *,
    approach_deg: float | tuple[float, float] | None = None,
    count: int = _COUNT,
    start: ArrayLike | None = None,
    locked: Sequence[str] = (),
) -> FloatArray:
    """Return (k, dof) configurations with the tool frame at a position, or at one of several, within 1e-6 m.

    Args:
        position: (3,), or (p, 3) for several, in `base_link` [m].
        approach_deg: Approach angle, or an interval (low, high) [deg]; None for all.
        count: Number of directions, for each position.
        start: (dof,) start configuration; None for the middle of the joint ranges.
        locked: Names of joints that keep their start values.

    Raises:
        UnreachableError: The position is farther away than the stretched arm is long, or no configuration was found;
            only the former is a proof.
        InputError: A position, start or joint is invalid.
        JointLimitError: The start is outside the joint limits.
        OptionError: An option is invalid.
    """
    places = numbers("position", position, (3,) if np.ndim(position) < 2 else (..., 3)).reshape(-1, 3)
    window, directions = Window.from_degrees(approach_deg), check_integer("count", count, 1, MOST_SEEDS)
    middle = 0.5 * (robot.lower + robot.upper)
    robot = robot.about(middle if start is None else start)
    begin = robot.check_configuration(middle if start is None else start, "start")
    keeps = robot.locked_mask(list_of("locked", locked, str, "names"))
    found, failures = list[FloatArray](), list[UnreachableError]()
    for place in places:
        try:
            found.append(_solve_position(robot, place, window, directions, begin, keeps))
        except UnreachableError as error:
            failures.append(error.with_traceback(None))
    if not found:
        raise failures[0]
    return frozen(np.concatenate(found))


def _solve_position(
    robot: Robot, place: FloatArray, window: Window | None, directions: int, begin: FloatArray, keeps: BoolArray
) -> FloatArray:
    """(k, dof) configurations with the tool at a (3,) position.

    Args:
        directions: Number of directions.
        begin: (dof,) start configuration.
        keeps: (dof,) mask of the joints that keep their start values.
    """
    _check_reach(robot, place)
    pose = np.eye(4)
    pose[:3, 3] = place
    outward = _outward_directions(robot, place)
    found: list[FloatArray] = []
    # Minimum number of joints for a position and a tool direction.
    directed = 5
    for turn, towards in ((ABOUT_Z, _directions(outward, window, directions)), (ANY_TURN, outward[None])):
        chain = with_direction(chain_of(robot, pose, turn), robot.tool_axis)
        chain.moves[keeps] = 0.0
        if turn == ANY_TURN or np.count_nonzero(chain.moves) >= directed:
            found.append(_solve_directions(robot, begin, chain, towards, directions if turn == ANY_TURN else _STARTS))
    solutions = distinct(robot, np.concatenate(found), begin, chain)
    if window is not None:
        solutions = solutions[window.holds(approach_angles(robot, solutions))]
    if len(solutions) == 0:
        asked = "" if window is None else f" with an approach angle of {window.describe()}"
        locked = [name for name, kept in zip(robot.joint_names, keeps, strict=True) if kept]
        held = f", with {', '.join(locked)} locked" if locked else ""
        detail = (
            f"no configuration{asked} was found for any of {directions} directions of the tool{held}; this does not "
            "prove that none exists"
        )
        raise UnreachableError(place.tolist(), "not_found", detail, joints=list(robot.joint_names))
    return solutions


def approach_angles(robot: Robot, configurations: FloatArray) -> FloatArray:
    """(k,) approach angles of the tool in (k, dof) configurations, in (-pi, pi]."""
    poses = robot.forward_kinematics(configurations)
    along, outward = poses[:, :3, :3] @ robot.tool_axis, _outward_directions(robot, poses[:, :3, 3])
    level = np.copysign(np.hypot(along[:, 0], along[:, 1]), (along * outward).sum(axis=1))
    angles: FloatArray = np.arctan2(along[:, 2], level)
    return angles


def _check_reach(robot: Robot, place: FloatArray) -> None:
    """Refuse a (3,) position beyond the length of the stretched arm."""
    model = robot.model
    chain = carriers(robot, robot.tool_joint - 1)
    if not chain:
        return
    links = [model.frames[robot.frame_number(robot.tool_frame)].placement]
    links += [model.jointPlacements[joint + 1] for joint in chain[:-1]]
    longest = sum(float(np.linalg.norm(link.translation)) for link in links)
    for joint in chain:
        if joint_axis(robot, joint)[1]:
            longest += float(np.abs([robot.lower[joint], robot.upper[joint]]).max())
    excess = math.dist(place, model.jointPlacements[chain[-1] + 1].translation) - longest
    if excess > 0.0:
        detail = f"it is {excess:.4g} m beyond the reach of the stretched arm"
        raise UnreachableError(place.tolist(), "too_far", detail, excess_m=excess)


def _outward_directions(robot: Robot, places: FloatArray) -> FloatArray:
    """(..., 3) horizontal unit vectors from the first joint to (..., 3) positions.

    It is the x axis of the base if the position is on the vertical through the joint.
    """
    away: FloatArray = places - robot.model.jointPlacements[1].translation
    away[..., 2] = 0.0
    length = np.linalg.norm(away, axis=-1, keepdims=True)
    return np.where(length > _ON_AXIS, away / np.maximum(length, _ON_AXIS), (1.0, 0.0, 0.0))


def _directions(outward: FloatArray, window: Window | None, count: int) -> FloatArray:
    """(count, 3) unit vectors spread evenly over a window of approach angles.

    See the module docstring for the parametrization.
    """
    low, width = (-np.pi, 2.0 * np.pi) if window is None else (window.low, window.width)
    # Angles for the numerical integration of the density of directions.
    angles = low + width * np.linspace(0.0, 1.0, 721)
    # Lower bound on the density: otherwise a requested window near the vertical would get very few directions.
    least_cosine = 0.05
    density = np.maximum(np.abs(np.cos(angles)), least_cosine)
    share = np.concatenate([[0.0], np.cumsum(density[:-1] + density[1:])])
    numbered = np.arange(count) + 0.5
    angle = np.interp(numbered / count, share / share[-1], angles)
    heading = np.pi * ((numbered * _GOLDEN) % 1.0 - 0.5)
    across = np.array([-outward[1], outward[0], 0.0])
    level = np.cos(heading)[:, None] * outward + np.sin(heading)[:, None] * across
    found: FloatArray = np.cos(angle)[:, None] * level + np.sin(angle)[:, None] * [0.0, 0.0, 1.0]
    return found


def _solve_directions(robot: Robot, begin: FloatArray, chain: Chain, directions: FloatArray, count: int) -> FloatArray:
    """(k, dof) configurations at the chain's position along given directions.

    The tool axis points along one of the directions.

    Args:
        begin: (dof,) start configuration.
        chain: The robot as arrays, with the position.
        directions: (n, 3) unit vectors.
        count: Number of starts for each direction.
    """
    starts = spread_starts(robot, begin, chain, 1 + len(directions) * (count - 1))
    starts = np.concatenate([np.broadcast_to(begin, (len(directions), robot.dof)), starts[1:]])
    spinning = _spin_joint(robot, chain)
    starts[:, spinning] = begin[spinning]
    poses = np.zeros((len(starts), 12))
    poses[:, [2, 5, 8]] = directions[np.arange(len(starts)) % len(directions)]
    poses[:, 9:] = chain.pose[9:]
    solutions, found = np.empty(starts.shape), np.zeros(len(starts), dtype=np.bool_)
    solve_each(np.ascontiguousarray(starts), poses, chain, solutions, found)
    return solutions[found]


def _spin_joint(robot: Robot, chain: Chain) -> list[int]:
    """Return the joint that only spins the tool, if any.

    It rotates the tool about its axis and can keep its value.
    """
    carrier = int(chain.carrier[0])
    if carrier == robot.dof:
        return []
    axis, slides = joint_axis(robot, carrier)
    z, place = chain.placement[[2, 5, 8]], chain.placement[9:]
    off = max(float(np.linalg.norm(np.cross(axis, vector))) for vector in (z, place))
    return [carrier] if not slides and off <= _ON_AXIS else []
