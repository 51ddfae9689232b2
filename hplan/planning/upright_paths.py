"""Projection of configurations onto the constraint that the tool stays upright."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from hplan.kinematics.damped_steps import UPRIGHT, Chain
from hplan.kinematics.inverse_kinematics import chain_of, with_direction
from hplan.planning.problem import Problem

#: Projected configurations use at most this fraction of the permitted tilt; motions between them may use the rest.
OF_TILT = 0.7


def upright_chain(problem: Problem) -> Chain | tuple[()]:
    """Return the constraint for kernels, within the joint ranges of a motion; empty if the tool may tilt."""
    tool = problem.world.upright
    if tool is None:
        return ()
    pose = np.eye(4)
    pose[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(tool.up)).toRotationMatrix()
    chain = with_direction(chain_of(problem.robot, pose, UPRIGHT), np.array(tool.axis))
    fixed = problem.lower[0] == problem.upper[0]
    return chain._replace(
        moves=np.where(fixed, 0.0, chain.moves),
        lower=np.array(problem.lower[0]),
        upper=np.array(problem.upper[0]),
        free_turn=np.array([UPRIGHT, OF_TILT * tool.max_tilt_rad]),
    )
