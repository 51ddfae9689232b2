"""OMPL's planners, where they are installed, with hplan's compiled clearance kernel as their motion validator."""

from __future__ import annotations

import importlib
import time
from array import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from studies.benchmark.measure import timed
from studies.benchmark.paths import PeerTask

from hplan.base.arrays import FloatArray
from hplan.base.kernels import kernel
from hplan.collision.clearance_field import ClearanceField
from hplan.collision.clearance_kernels import FieldArrays, link_clearances, segment_is_clear
from hplan.robot.model import Robot

#: CPU time that a planner may take to find a path, and again to simplify it [s].
PATIENCE = 1.0


@dataclass(frozen=True, eq=False)
class OmplResult:
    """A path of an OMPL planner.

    Attributes:
        path: (m, dof) waypoints, or None where none was found in time.
        plan_ms: Time to the path.
        simplify_ms: Time to simplify it.
        compiled_ms: Estimate of both with the callbacks compiled: the time spent in Python callbacks taken out, that
            of the kernel alone on the same motions and states put in.
        length_before: Length before simplification [rad].
    """

    path: FloatArray | None
    plan_ms: float
    simplify_ms: float
    compiled_ms: float
    length_before: float

    @property
    def total_ms(self) -> float:
        """Time to the path that is given out [ms]."""
        return self.plan_ms + self.simplify_ms


class Ompl:
    """OMPL's planners on the joints that move, with hplan's compiled clearance kernel as motion validator.

    OMPL calls the kernel once a motion (and once a state) by way of Python; `OmplResult.compiled_ms` tells what is
    left when that is taken out.
    """

    PLANNERS = ("RRTConnect", "BITstar")

    def __init__(self, seed: int) -> None:
        """Load OMPL.

        Raises:
            ImportError: It is not installed.
        """
        base, geometric, util = (importlib.import_module(f"ompl.{name}") for name in ("base", "geometric", "util"))
        util.setLogLevel(util.LOG_ERROR)
        util.RNG.setSeed(seed)
        self._base: Any = base
        self._geometric: Any = geometric

    @classmethod
    def if_installed(cls, seed: int) -> Ompl | None:
        """OMPL with its random numbers seeded, or None where it is not installed."""
        try:
            return cls(seed)
        except ImportError:
            return None

    def plan(
        self,
        task: PeerTask,
        start: FloatArray,
        goal: FloatArray,
        *,
        planner: str = "RRTConnect",
        seconds: float = PATIENCE,
        turns: bool = False,
    ) -> OmplResult:
        """Plan and simplify.

        Args:
            task: Arm and obstacles, and the margin asked for wherever a motion is evaluated.
            start: (dof,) configuration.
            goal: (dof,) configuration; differs from the start in planar joints only, unless the base turns.
            planner: One of `PLANNERS`; RRTConnect stops at its first path, BITstar when time is up.
            seconds: CPU time for planning; other load on the machine takes nothing from it.
            turns: Whether the base may turn.
        """
        robot = task.robot
        joints = slice(0 if turns else robot.arm_slice.start, robot.dof)
        calls = _Calls(task.field, start, joints, task.smallest_margin)
        setup = self._setup(robot, calls, start, goal, joints)
        info = setup.getSpaceInformation()
        setup.setPlanner(getattr(self._geometric, planner)(info))
        end = time.thread_time() + seconds
        enough = self._base.PlannerTerminationCondition(lambda: time.thread_time() >= end)
        _, plan_ms = timed(lambda: setup.solve(enough))
        if not setup.haveExactSolutionPath():
            return OmplResult(None, plan_ms, 0.0, plan_ms, float("nan"))
        before = float(setup.getSolutionPath().length())
        _, simplify_ms = timed(lambda: setup.simplifySolution(PATIENCE))
        path = np.repeat(start[None], setup.getSolutionPath().getStateCount(), axis=0)
        for row, state in zip(path, setup.getSolutionPath().getStates(), strict=True):
            row[joints] = [state[i] for i in range(joints.stop - joints.start)]
        path[0], path[-1] = start, goal
        kernel_ms = calls.kernel_ms()
        compiled = kernel_ms + max(0.0, plan_ms + simplify_ms - 1e3 * calls.seconds)
        return OmplResult(path, plan_ms, simplify_ms, compiled, before)

    def _setup(self, robot: Robot, calls: _Calls, start: FloatArray, goal: FloatArray, joints: slice) -> Any:
        base = self._base

        class Validator(base.MotionValidator):  # type: ignore[misc, name-defined]
            def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802 - OMPL's name
                return calls.motion(first, second)

        lower, upper = robot.lower[joints], robot.upper[joints]
        space = base.RealVectorStateSpace(len(lower))
        bounds = base.RealVectorBounds(len(lower))
        for i, (low, high) in enumerate(zip(lower, upper, strict=True)):
            bounds.setLow(i, float(low))
            bounds.setHigh(i, float(high))
        space.setBounds(bounds)
        setup = self._geometric.SimpleSetup(space)
        setup.setStateValidityChecker(calls.state)
        setup.getSpaceInformation().setMotionValidator(Validator(setup.getSpaceInformation()))
        ends = []
        for q in (start, goal):
            state = space.allocState()
            for i, value in enumerate(q[joints]):
                state[i] = float(value)
            ends.append(state)
        setup.setStartAndGoalStates(*ends)
        return setup


class _Calls:
    """The callbacks, what they took in all, and the motions and states they were asked about."""

    def __init__(self, field: ClearanceField, template: FloatArray, joints: slice, margin: float) -> None:
        self._field, self._margin = field, margin
        self._joints, self._count = joints, joints.stop - joints.start
        self._a, self._b = np.array(template), np.array(template)
        self._clear = np.empty(len(field.chain))
        self._template = template
        self._motions, self._states = array("d"), array("d")
        self.seconds = 0.0

    def motion(self, first: Any, second: Any) -> bool:
        """True if the straight motion is shown clear."""
        begin = time.perf_counter()
        field, axes = self._field, range(self._count)
        ends = [first[i] for i in axes], [second[i] for i in axes]
        self._a[self._joints], self._b[self._joints] = ends
        clear = bool(segment_is_clear(self._a, self._b, field.arrays, self._margin))
        self._motions.extend(ends[0])
        self._motions.extend(ends[1])
        self.seconds += time.perf_counter() - begin
        return clear

    def state(self, state: Any) -> bool:
        """True if a configuration keeps the margin."""
        begin = time.perf_counter()
        field = self._field
        values = [state[i] for i in range(self._count)]
        self._a[self._joints] = values
        link_clearances(self._a, field.arrays, self._clear)
        clear = bool(self._clear.min() >= self._margin)
        self._states.extend(values)
        self.seconds += time.perf_counter() - begin
        return clear

    def kernel_ms(self) -> float:
        """Time of the kernels alone on all that they were asked [ms]."""
        motions = self._whole(self._motions).reshape(-1, 2, len(self._template))
        states = self._whole(self._states)
        field = self._field
        _ask(motions[:0], states[:0], field.arrays, self._margin)  # loads it
        return timed(lambda: _ask(motions, states, field.arrays, self._margin))[1]

    def _whole(self, values: array[float]) -> FloatArray:
        """(n, dof) configurations of the values of the joints that move."""
        rows = np.array(values).reshape(-1, self._count)
        whole = np.repeat(self._template[None], len(rows), axis=0)
        whole[:, self._joints] = rows
        return whole


@kernel
def _ask(motions: FloatArray, states: FloatArray, field: FieldArrays, margin: float) -> int:
    count = 0
    result = np.empty(field.chain.shape[0])
    for i in range(motions.shape[0]):
        count += segment_is_clear(motions[i, 0], motions[i, 1], field, margin)
    for i in range(states.shape[0]):
        link_clearances(states[i], field, result)
        count += result.min() >= margin
    return count
