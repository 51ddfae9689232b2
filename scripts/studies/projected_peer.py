"""OMPL's RRT-Connect in projected spaces: joint spaces in which the tool stays upright, and on its line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from studies.outside import TimedMotion
from studies.peers import MARGIN_M, SIMPLIFY_S, ompl, seed_ompl, solve, toppra_motion, world_of

from hplan.base.arrays import FloatArray
from hplan.errors import HplanError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: What projections reach [m, rad], and how far apart states along a motion are [rad].
_TOLERANCE, _DELTA = 1e-4, 0.05

#: How far beyond the ends of its line the tool may be [m].
_BEYOND_M = 1e-3

#: How far a tree steps [rad]: by OMPL's own choice, a fifth of the extent, hardly a step of the tested ones succeeds.
_RANGE = 0.5

#: What it has for each motion [s of CPU]; residuals are Python's here, 20 us each.
_PATIENCE_S = 30.0


class ToolConstraint:
    """Residuals of a configuration: how far the tool tilts beyond an angle, and its offsets from a line.

    Attributes:
        up: Direction in the tool's frame that is to point upwards.
        tilt_rad: How far it may lean.
        line: Two points, between which the tool stays straight; None where it moves freely.
    """

    def __init__(self, robot: Robot, up: FloatArray, tilt_rad: float, line: FloatArray | None) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._frame = robot.frame_number(robot.tool_frame)
        self._up, self._tilt_rad = up, tilt_rad
        self._line, self._across, self._begin = line, np.zeros((0, 3)), np.zeros(3)
        if line is not None:
            # Two directions at right angles to the line.
            self._across, self._begin = np.linalg.svd((line[1] - line[0])[None])[2][1:], line[0]
        self.count = 1 + len(self._across)

    def is_between(self, q: FloatArray) -> bool:
        """Whether the tool is between the ends of its line, which no equation says."""
        if self._line is None:
            return True
        along = self._line[1] - self._line[0]
        pin.framesForwardKinematics(self._model, self._data, q)
        offset = (self._data.oMf[self._frame].translation - self._begin) @ along / np.linalg.norm(along)
        return bool(-_BEYOND_M <= offset <= np.linalg.norm(along) + _BEYOND_M)

    def residuals(self, q: FloatArray) -> FloatArray:
        """(count,) what is to be none at (dof,) joints [rad, m]."""
        pin.framesForwardKinematics(self._model, self._data, q)
        tool = self._data.oMf[self._frame]
        tilt = np.arccos(np.clip((tool.rotation @ self._up)[2], -1.0, 1.0))
        return np.append(max(0.0, tilt - self._tilt_rad), self._across @ (tool.translation - self._begin))

    def jacobian(self, q: FloatArray) -> FloatArray:
        """(count, dof) how the residuals change with the joints."""
        moved = pin.computeFrameJacobian(
            self._model, self._data, q, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        up = self._data.oMf[self._frame].rotation @ self._up
        turned = np.cross(moved[3:].T, up)[:, 2]  # how fast the height of the upward direction changes
        sine = max(np.sqrt(max(0.0, 1.0 - up[2] ** 2)), 1e-9)
        beyond = np.arccos(np.clip(up[2], -1.0, 1.0)) > self._tilt_rad
        return np.vstack([-turned / sine if beyond else np.zeros(len(q)), self._across @ moved[:3]])


def projected_motions(
    robot: Robot, scene: Scene, poses: FloatArray, straight: Sequence[bool], tilt_rad: float, seed: int
) -> list[TimedMotion] | None:
    """A motion to each pose, timed by toppra on a spline through the states of the path; None where one is not found.

    Args:
        poses: (n, 4, 4) of the tool.
        straight: Which motions are along straight lines.
        tilt_rad: Of the tool from the vertical, at most.
    """
    seed_ompl(seed)
    world, start, found = world_of(robot, scene), scene.start.configuration, []
    begin = robot.forward_kinematics(start)
    for pose, is_straight in zip(poses, straight, strict=True):
        line = np.stack([robot.forward_kinematics(start)[:3, 3], pose[:3, 3]]) if is_straight else None
        constraint = ToolConstraint(robot, begin[2, :3], tilt_rad - 2.0 * _TOLERANCE, line)
        path = _path(world, start, pose, constraint)
        motion = None if path is None else toppra_motion(robot, path)
        if path is None or motion is None:
            return None
        found.append(motion)
        start = path[-1]
    return found


def _path(world: World, start: FloatArray, pose: FloatArray, constraint: ToolConstraint) -> FloatArray | None:
    """(m, dof) states of a simplified path to one of the clear configurations at a pose."""
    base, geometric, _ = ompl()
    robot = world.robot
    try:
        ends = [q for q in inverse_kinematics(robot, pose) if world.field.clearance(q) > MARGIN_M]
    except HplanError:
        return None
    if not ends:
        return None

    class Constraint(base.Constraint):  # type: ignore[misc, name-defined]
        def function(self, x: FloatArray, out: FloatArray) -> None:
            out[:] = constraint.residuals(np.array(x))

        def jacobian(self, x: FloatArray, out: FloatArray) -> None:
            out[:, :] = constraint.jacobian(np.array(x))

    ambient, bounds = base.RealVectorStateSpace(robot.dof), base.RealVectorBounds(robot.dof)
    for joint in range(robot.dof):
        bounds.setLow(joint, float(robot.lower[joint]))
        bounds.setHigh(joint, float(robot.upper[joint]))
    ambient.setBounds(bounds)
    held = Constraint(robot.dof, constraint.count)
    held.setTolerance(_TOLERANCE)
    space = base.ProjectedStateSpace(ambient, held)
    information = base.ConstrainedSpaceInformation(space)
    space.setup()
    space.setDelta(_DELTA)
    setup = geometric.SimpleSetup(information)

    def state_at(q: FloatArray) -> Any:
        state = space.allocState()
        state.copy(q.tolist())
        return state

    def configuration(state: Any) -> FloatArray:
        return np.array([state[joint] for joint in range(robot.dof)])

    def is_free(state: Any) -> bool:
        q = configuration(state)
        return constraint.is_between(q) and world.field.clearance(q) > 0.0

    setup.setStateValidityChecker(is_free)
    setup.setStartState(state_at(start))
    goal = base.GoalStates(information)
    for q in ends:
        goal.addState(state_at(q))
    setup.setGoal(goal)
    planner = geometric.RRTConnect(information)
    planner.setRange(_RANGE)
    setup.setPlanner(planner)
    if not solve(setup, _PATIENCE_S):
        return None
    setup.simplifySolution(SIMPLIFY_S)
    path = setup.getSolutionPath()
    path.interpolate()
    return np.array([configuration(state) for state in path.getStates()])
