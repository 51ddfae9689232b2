"""Numerical inverse kinematics of any robot with a frame at a pose.

Damped least squares (`hplan.kinematics.damped_steps`) runs from several fixed starts: the given start configuration,
the middle of the joint ranges, and others spread over the ranges. Every solution returned reaches the pose, but a pose
without a solution need not be out of reach. An arm with more joints than the pose has constraints has more solutions
than those returned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arguments import check_integer, list_of, truth
from hplan.base.arrays import FloatArray, frozen, numbers
from hplan.collision.compiled_bodies import joint_table
from hplan.collision.motion_coefficients import carriers, joint_axis
from hplan.errors import InputError, UnreachableError
from hplan.kinematics.damped_steps import ABOUT_Z, KEPT, Chain, solve_all, solve_each
from hplan.robot.model import Robot

#: Default and maximum number of starts.
_SEEDS, MOST_SEEDS = 64, 100_000

#: Solutions that differ by less in every joint are duplicates [rad, m].
SAME = 1e-3


def inverse_kinematics(
    robot: Robot,
    pose: ArrayLike,
    *,
    start: ArrayLike | None = None,
    frame: str | None = None,
    seeds: int = _SEEDS,
    free_turn: bool = False,
    rotation_tolerance_rad: ArrayLike | None = None,
    locked: Sequence[str] = (),
    seed: int = 0,
) -> FloatArray:
    """Return configurations with a frame at a pose, within the joint limits.

    Each one reaches the pose within 1e-6 m and 1e-6 rad.

    Args:
        pose: (4, 4) homogeneous matrix in `base_link` [m].
        start: (dof,) start configuration; None for the middle of the joint ranges. Joints that do not carry the frame
            keep its values.
        frame: Name of the frame; None for the tool frame.
        seeds: Number of starts.
        free_turn: Whether rotation about the frame's z axis is free.
        rotation_tolerance_rad: (3,) maximum components, about x, y and z of the pose, of the rotation vector from the
            pose to the frame [rad]. Each start but the first two has an orientation of its own within them. None for
            the exact orientation.
        locked: Names of joints that keep their start values.
        seed: Random seed of the starts beyond the first two.

    Returns:
        (k, dof) configurations, k >= 1, pairwise different by at least 1e-3 in some joint. Each revolute joint is
        at the whole turn nearest to the start. Sorted by the time to reach them from the start at maximum velocity.

    Raises:
        UnreachableError: No start led to a solution; this does not prove that none exists.
        InputError: A pose, start, frame or joint is invalid.
        JointLimitError: The start is outside the joint limits.
        OptionError: An option is invalid.
    """
    middle = 0.5 * (robot.lower + robot.upper)
    robot = robot.about(middle if start is None else start)
    begin = robot.check_configuration(middle if start is None else start, "start")
    count = check_integer("seeds", seeds, 1, MOST_SEEDS)
    free = truth("free_turn", free_turn)
    keeps = robot.locked_mask(list_of("locked", locked, str, "names"))
    chain = chain_of(robot, checked_pose(pose), ABOUT_Z if free else KEPT, frame)
    chain.moves[keeps] = 0.0
    starts = spread_starts(robot, begin, chain, count, check_integer("seed", seed, 0))
    solutions, found = np.empty(starts.shape), np.zeros(len(starts), dtype=np.bool_)
    if rotation_tolerance_rad is None:
        solve_all(starts, chain, solutions, found)
    else:
        largest = numbers("rotation_tolerance_rad", rotation_tolerance_rad, (3,), most=math.pi)
        solve_each(starts, _turned_poses(chain.pose, largest, count), chain, solutions, found)
    if not found.any():
        asked = "this pose" if not free else "this pose, with any rotation about its z axis"
        held = f", with {', '.join(locked)} locked" if keeps.any() else ""
        detail = f"{asked} was not reached from any of {count} starts{held}; this does not prove it unreachable"
        joints = np.count_nonzero(chain.moves)
        if joints < (5 if free else 6):
            detail += f"; {joints} joints reach few poses exactly; give other goals as positions"
        raise UnreachableError(chain.pose[9:].tolist(), "not_found", detail, joints=list(robot.joint_names))
    return distinct(robot, solutions[found], begin, chain)


def _turned_poses(pose: FloatArray, largest: FloatArray, count: int) -> FloatArray:
    """Return a (12,) pose twice, and evenly spread rotations of it by up to (3,) angles [rad], (count, 12) in all."""
    # Multiples of the inverse powers of the root of x^4 = x + 1, modulo 1, fill a cube evenly.
    even = (0.5 + np.arange(count)[:, None] * 1.2207440846057596 ** -np.arange(1.0, 4.0)) % 1.0
    vectors = (2.0 * even - 1.0) * np.abs(largest)
    vectors[:2] = 0.0
    turns = [(pose[:9].reshape(3, 3) @ pin.exp3(vector)).ravel() for vector in vectors]
    return np.column_stack([turns, np.tile(pose[9:], (count, 1))])


def spread_starts(robot: Robot, begin: FloatArray, chain: Chain, count: int, seed: int = 0) -> FloatArray:
    """Return (count, dof) seeded starts: the given one, mid-range, and random others.

    Locked joints, and joints that do not move the frame, keep the values of the first start.
    """
    spread = np.random.default_rng(seed).random((max(0, count - 2), robot.dof))
    middle = 0.5 * (robot.lower + robot.upper)
    starts = np.concatenate([begin[None], middle[None], robot.lower + spread * (robot.upper - robot.lower)])[:count]
    return np.where(chain.moves > 0.0, starts, begin)


def checked_pose(pose: ArrayLike, name: str = "pose") -> FloatArray:
    """Return the pose as an array.

    Args:
        name: Name of the pose in the error message.

    Raises:
        InputError: The pose is not a homogeneous matrix of a rotation and a position.
    """
    matrix = numbers(name, pose, (4, 4))
    turn = matrix[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(turn.T @ turn - np.eye(3)).max())
        # Tolerance on the orthonormality of the rotation's columns.
        right_handed = off <= 1e-6 and float(np.linalg.det(turn)) > 0.0
    if not right_handed or np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 0.0:
        raise InputError(f"{name}: expected a (4, 4) homogeneous matrix of a rotation and a position", option=name)
    return matrix


def chain_of(robot: Robot, pose: FloatArray, turn: float, name: str | None = None) -> Chain:
    """Return the kernel arrays of the chain from base to frame.

    Args:
        pose: (4, 4) homogeneous matrix in `base_link`.
        turn: Orientation constraint: `KEPT`, `ABOUT_Z`, `ANY_TURN` or `UPRIGHT`.
        name: Name of the frame; None for the tool frame.
    """
    frame = robot.model.frames[robot.frame_number(robot.tool_frame if name is None else name)]
    carrier = int(frame.parentJoint) - 1
    moves = np.zeros(robot.dof)
    moves[list(carriers(robot, carrier))] = 1.0
    return Chain(
        joints=joint_table(robot),
        moves=moves,
        lower=np.array(robot.lower),
        upper=np.array(robot.upper),
        carrier=np.array([float(robot.dof if carrier < 0 else carrier)]),
        placement=np.concatenate([np.array(frame.placement.rotation).ravel(), frame.placement.translation]),
        pose=np.concatenate([pose[:3, :3].ravel(), pose[:3, 3]]),
        free_turn=np.array([turn, 0.0]),
    )


def with_direction(chain: Chain, axis: FloatArray) -> Chain:
    """Return the chain with the frame's z axis along a vector.

    The (3,) unit vector is in the present frame.
    """
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
    rotation = chain.placement[:9].reshape(3, 3) @ turn
    return chain._replace(placement=np.append(rotation.ravel(), chain.placement[9:]))


def distinct(robot: Robot, solutions: FloatArray, start: FloatArray, chain: Chain) -> FloatArray:
    """Return distinct (k, dof) solutions, shifted towards the start, nearest first."""
    near = solutions.copy()
    for joint in np.flatnonzero(chain.moves).tolist():
        if not joint_axis(robot, joint)[1]:
            first = np.ceil((robot.lower[joint] - near[:, joint]) / math.tau)
            last = np.floor((robot.upper[joint] - near[:, joint]) / math.tau)
            turns = np.clip(np.round((start[joint] - near[:, joint]) / math.tau), first, last)
            near[:, joint] += math.tau * turns
    near = np.clip(near, robot.lower, robot.upper)
    times = (np.abs(near - start) / robot.velocity_limit).max(axis=1)
    near = near[ties.argsort(times.tolist())]
    left = np.ones(len(near), dtype=np.bool_)
    for row in range(len(near)):
        if left[row]:
            left[row + 1 :] &= np.abs(near[row + 1 :] - near[row]).max(axis=1) >= SAME
    return frozen(near[left])
