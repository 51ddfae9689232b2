"""Straight approaches and retreats: from rest, or blended with the adjacent motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from hplan.base.deadline import check_deadline
from hplan.certificate.certificate import Stretch, goal_contacts, stretches
from hplan.errors import TimingError
from hplan.kinematics.straight_line import lines_back
from hplan.optimization.minimize_time import minimize_time
from hplan.optimization.timed_spline import BoundaryState, TimedSpline
from hplan.planning.grasps import Grasp, Target
from hplan.planning.motion import (
    Motion,
    certificate_of,
    certified_trajectory,
    seconds,
    time_along,
    time_problem,
)
from hplan.planning.problem import Problem
from hplan.planning.stages import stage
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Trajectory

#: Extra starting distance of a non-stop approach beyond the stand-off, as a fraction of the approach length. A larger
#: value allows a higher speed at the stand-off, but lengthens the transit.
LEADS: Final = (0.02, 0.05, 0.15, 0.3, 0.45)


def retreat_of(approach: Motion) -> Motion:
    """The approach reversed in time; accelerations, torques and distances are unchanged."""
    return replace(approach.reversal, name="retreat")


@dataclass(frozen=True, eq=False)
class Approach:
    """Approaches to one grasp: from rest, or non-stop through the stand-off.

    Attributes:
        problem: The arm in its world, the scene, options and budget.
        target: The fruit, point or pose to reach.
        grasp: The grasp to approach.
    """

    problem: Problem
    target: Target
    grasp: Grasp
    _known: dict[float, Trajectory | None] = field(init=False, default_factory=dict)
    _shown: dict[int, Motion | None] = field(init=False, default_factory=dict)

    @cached_property
    def touching_problem(self) -> Problem:
        """The problem in which the last link may touch the fruit (`hplan.certificate.goal_contact`)."""
        return self.problem.in_world(self.target.world_touching)

    @cached_property
    def from_rest(self) -> Motion | None:
        """The approach from rest to rest; None for a grasp without one.

        Raises:
            TimingError: No timing of the approach satisfies the limits.
            CertificationError: A certificate is required, and the approach is not certified.
        """
        path = self.grasp.path(self.problem.robot, self.problem.scene.locked_joints)
        if path is None:
            return None
        return Motion(
            "approach", *certified_trajectory(self.touching_problem, path, self._contact_stretches), self.problem
        )

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The approach from rest and, from a fruit, the retreat.

        Raises:
            TimingError: No timing of the approach satisfies the limits.
            CertificationError: A certificate is required, and the approach is not certified.
        """
        there = self.from_rest
        if there is None:
            return ()
        return (there,) if self.target.fruit is None else (there, retreat_of(there))

    @cached_property
    def maximum_length(self) -> float:
        """Maximum distance of a clear straight approach [m].

        At least the stand-off distance, at most `LEADS` beyond it.
        """
        grasp, robot, locked = self.grasp, self.problem.robot, self.problem.scene.locked_joints
        longest = (1.0 + LEADS[-1]) * grasp.distance
        lines = lines_back(robot, grasp.goal[None], longest, locked=locked, keeps_turn=grasp.keeps_turn)
        possible = float(lines.distances[lines.reached[0] - 1])
        if possible <= grasp.distance:
            return grasp.distance
        check_deadline()
        path = grasp.line(robot, locked, possible)
        away = np.linspace(grasp.distance, possible, 16)
        field = self.target.transit_world(grasp).field
        touching = np.flatnonzero(field.spare_clearances(path.evaluate((1.0 - away / possible) * path.end)) < 0.0)
        return float(away[max(0, touching[0] - 1)]) if len(touching) else possible

    def non_stop(self, lead: float) -> Trajectory | None:
        """The approach in motion at the stand-off; None if impossible.

        It is the last segment of an approach from rest that starts farther away. The arm therefore passes the stand-off
        at a speed that it can reach on the straight line, where all joint limits hold; the transit's motion before the
        stand-off need not follow that line.

        Args:
            lead: Extra starting distance, as a fraction of the approach length.
        """
        longer = min(self.maximum_length, (1.0 + lead) * self.grasp.distance)
        if longer not in self._known:
            self._known[longer] = self._non_stop(longer)
        return self._known[longer]

    def certify_lead(self, approach: Trajectory) -> Motion | None:
        """A non-stop approach with its certificate; None if it is not certified."""
        if id(approach) not in self._shown:
            shown = certificate_of(
                self.touching_problem, approach, self._contact_stretches(approach), rest_to_rest=False
            )
            self._shown[id(approach)] = Motion("approach", approach, shown, self.problem) if shown.verified else None
        return self._shown[id(approach)]

    def _non_stop(self, longer: float) -> Trajectory | None:
        """The last segment of an approach that starts at a distance [m]."""
        grasp, robot = self.grasp, self.problem.robot
        if longer < grasp.distance + 1e-3:
            return None
        path = grasp.line(robot, self.problem.scene.locked_joints, longer)
        try:
            whole = time_along(self.touching_problem, path)
        except TimingError:
            return None
        check_deadline()
        tool = robot.tool_positions(whole.position)
        beyond = np.linalg.norm(tool - tool[-1], axis=1) >= grasp.distance - 1e-9
        there = whole.cut_before(int(np.flatnonzero(beyond)[-1]))
        return there if _line_deviation(robot, there, grasp) <= 1e-4 else None

    def _contact_stretches(self, approach: Trajectory) -> list[Stretch]:
        """The segments and obstacles to certify an approach against.

        The last link may touch the fruit while it moves straight.
        """
        fruit = self.target.fruit
        contacts = () if fruit is None else goal_contacts(self.problem.robot, approach, fruit, "approach")
        return stretches(self.target.world.checker, approach.time, contacts)


def _line_deviation(robot: Robot, approach: Trajectory, grasp: Grasp) -> float:
    """Maximum distance of the tool from the straight approach line [m].

    Evaluated at the samples and at three points between any two of them.
    """
    clock = np.linspace(0.0, approach.duration, 4 * (approach.samples - 1) + 1)
    tip, standoff = robot.tool_positions(np.stack([grasp.goal, grasp.standoff]))
    line = standoff - tip
    away = robot.tool_positions(approach.positions(clock)) - tip
    away -= (away @ line / (line @ line))[:, None] * line
    return float(np.linalg.norm(away, axis=1).max())


def blend(
    problem: Problem, transit: Motion, before: Approach | None, after: Approach | None
) -> tuple[Motion | None, Motion, Motion | None] | None:
    """The fastest motion without a stop at the stand-offs.

    None if it is not faster than the motion with stops.

    Args:
        before: The approach whose retreat precedes the transit; None if the transit starts at rest.
        after: The approach that follows the transit; None if the transit ends at rest.

    Returns:
        The retreat before the transit, the transit, and the approach after it; None for a side that is not blended.

    Raises:
        HplanError: As in `Approach.from_rest`.
    """
    if problem.optimization is None or transit.trajectory.samples == 1:
        return None
    sides = before, after
    at_rest = [None if side is None else side.from_rest for side in sides]
    stops_s = seconds([motion for motion in at_rest if motion is not None])
    # Minimum difference in duration for a motion to count as faster [s].
    least_gain_s = 1e-6
    limit_s = transit.trajectory.duration + stops_s - least_gain_s
    found: list[tuple[float, TimedSpline, list[Trajectory | None]]] = []
    number, step = 2, 0
    known: list[Trajectory | None] = []
    for _ in range(problem.effort.leads):
        check_deadline()
        approaches = [None if side is None else side.non_stop(LEADS[number]) for side in sides]
        if known and all(one is other for one, other in zip(known, approaches, strict=True)):
            break  # the stand-offs leave no more room
        known = approaches
        spline = _blend_between(problem, transit.trajectory, approaches)
        if spline is not None:
            pairs = zip(at_rest, approaches, strict=True)
            saved_s = sum(
                rest.trajectory.duration - other.duration for rest, other in pairs if rest and other is not None
            )
            total_s = spline.duration + stops_s - saved_s
            if found and total_s > found[-1][0] - least_gain_s:
                break
            found.append((total_s, spline, approaches))
            # If the longer transit costs more than half of the time that approach and retreat save, try a shorter lead.
            step = step or (1 if limit_s - total_s > 0.5 * saved_s else -1)
            if step > 0 and None in sides and problem.effort.leads <= 2:
                break  # with one stand-off another lead gains little
        number += step or -1
        if number not in range(len(LEADS)):
            break
    for total_s, spline, approaches in reversed(found):  # fastest first
        if total_s > limit_s:
            break
        certified = _certify_blend(problem, transit, spline, [*zip(sides, approaches, strict=True)])
        if certified is not None:
            return certified
    return None


def _certify_blend(
    problem: Problem,
    transit: Motion,
    spline: TimedSpline,
    sides: Sequence[tuple[Approach | None, Trajectory | None]],
) -> tuple[Motion | None, Motion, Motion | None] | None:
    """The motions with their certificates; None if one is not certified."""
    shown: list[Motion | None] = []
    for side, approach in sides:
        shown.append(None if side is None or approach is None else side.certify_lead(approach))
        if shown[-1] is None and approach is not None:
            return None
    trajectory = spline.trajectory(problem.robot.dynamics, problem.options.rate_hz)
    certificate = certificate_of(problem, trajectory, rest_to_rest=False)
    if not certificate.verified:
        return None
    leaving, coming = shown
    retreat = None if leaving is None else retreat_of(leaving)
    return retreat, replace(transit, trajectory=trajectory, certificate=certificate, path=spline.path), coming


def _blend_between(
    problem: Problem, transit: Trajectory, approaches: Sequence[Trajectory | None]
) -> TimedSpline | None:
    """The fastest motion between non-stop approaches; None if not found.

    It is near the transit; an end without a non-stop approach is at rest.
    """
    leaving, coming = approaches
    if leaving is None and coming is None:
        return None
    first, last = (BoundaryState.at_rest(transit.position[end]) for end in (0, -1))
    if leaving is not None:
        first = BoundaryState.of_row(leaving.reversal, -1)
    if coming is not None:
        last = BoundaryState.of_row(coming, 0)
    with stage("timing"):
        return minimize_time(transit, time_problem(problem, (first, last)), problem.effort.blended)
