"""Paths of OMPL's RRTConnect among a scene's obstacles, simplified, with hplan's compiled distances as its checker.

OMPL checks configurations along each motion, so many fractions of the space's extent apart (a hundredth unless it is
told otherwise). A path may so touch something between two configurations that were checked.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

from hplan.base.arrays import FloatArray
from hplan.base.lazy_import import extra
from hplan.problem.world import World
from hplan.scene.model import Scene

#: What OMPL may take to find a path, and again to simplify it [s].
FIND_S, SIMPLIFY_S = 5.0, 1.0

#: Fraction of the space's extent by which OMPL steps along motions unless it is told otherwise.
RESOLUTION = 0.01


def seed_ompl(seed: int) -> None:
    """Seed OMPL's random numbers, once a process.

    Raises:
        InputError: OMPL is not installed.
    """
    with extra("bench", "the study needs OMPL"):
        util = importlib.import_module("ompl.util")
    util.setLogLevel(util.LOG_ERROR)
    util.RNG.setSeed(seed)


def ompl_path(world: World, scene: Scene, goal: FloatArray, resolution: float = RESOLUTION) -> FloatArray | None:
    """(m, dof) the simplified path of RRTConnect from the scene's start; None where it found none in time.

    Args:
        world: Arm and obstacles.
        scene: Start, and joints that are locked.
        goal: (dof,) configuration.
        resolution: Distance between configurations that are checked, as a fraction of the space's extent.
    """
    base, geometric = (importlib.import_module(f"ompl.{name}") for name in ("base", "geometric"))
    robot, start = world.robot, scene.start.configuration
    joints = np.flatnonzero(~robot.locked_mask(scene.locked_joints)).tolist()
    space, bounds = base.RealVectorStateSpace(len(joints)), base.RealVectorBounds(len(joints))
    for axis, joint in enumerate(joints):
        bounds.setLow(axis, float(robot.lower[joint]))
        bounds.setHigh(axis, float(robot.upper[joint]))
    space.setBounds(bounds)
    setup, q = geometric.SimpleSetup(space), np.array(start)

    def is_free(state: Any) -> bool:
        q[joints] = [state[axis] for axis in range(len(joints))]
        return world.field.clearance(q) > 0.0

    setup.setStateValidityChecker(is_free)
    setup.getSpaceInformation().setStateValidityCheckingResolution(resolution)
    ends = []
    for end in (start, goal):
        state = space.allocState()
        for axis, joint in enumerate(joints):
            state[axis] = float(end[joint])
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
    world.field.clearance(q)  # compiling it must not take of OMPL's time
    until_s = time.thread_time() + FIND_S
    setup.solve(base.PlannerTerminationCondition(lambda: time.thread_time() >= until_s))
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution(SIMPLIFY_S)
    states = setup.getSolutionPath().getStates()
    path = np.repeat(start[None], len(states), axis=0)
    path[:, joints] = [[state[axis] for axis in range(len(joints))] for state in states]
    path[-1] = goal
    return path
