r"""The fastest motion as one nonlinear program, solved by IPOPT (Wächter and Biegler 2006) with exact derivatives.

The motion is a cubic B-spline over time, whose pieces meet at rows in the end. With :math:`c` its control points and
:math:`T` its duration, over a unit of time,

.. math:: \min T \quad \text{s. t.} \quad |V c| \le \bar v T, \; |A c| \le \bar a T^2, \; |J c| \le \bar\jmath T^3,

with the clearance of every link from every obstacle near it at `PLACES` of each piece, and the torques at `TIMES` of
each piece, by the expressions of `studies.symbolic`. Nothing is linearised, and no step is shorter
than what the solver takes. `optimized` solves programs in turn, each from the last one's motion, until no row is
saved. What comes of them is taken to rows, slowed down to a whole number of them, and counts only if hplan's
certificate verifies these rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from studies.peers import world_of
from studies.symbolic import inverse_dynamics, link_distance, links_apart, load_casadi

from hplan.base.arrays import FloatArray, frozen
from hplan.certificate.certificate import certify
from hplan.collision import obstacle_rows as row
from hplan.optimization.timed_spline import RESTING, TimedSpline, breaks_at_rows
from hplan.planning.definition import Problem, check_problem
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Trajectory

#: Places in each piece where clearances are kept, and times where torques are.
PLACES, TIMES = 2, 2

#: Control points move no farther than this from the start in a joint [rad]; of the obstacles nearer to a link than
#: this [m] so many are in the program, the nearest.
TRUST, NEAR, NEAREST = 0.1, 0.2, 4

#: Torques are in the program if one uses more than this part of its limit; of that so much may be used, as between the
#: times looked at it is a little higher.
LOADED, ALLOWED = 0.7, 0.998

#: Most iterations, and CPU time [s].
ITERATIONS, SECONDS = 400, 20.0

#: Rows per second of motions, rows of a piece, and of the shortest motion; pieces are longer where there would be more
#: than so many.
RATE_HZ, ROWS_EACH, FEWEST, MOST_PIECES = 250.0, 3, 30, 200

#: Clearance asked for at the places looked at, tried in turn until the rows are certified [m].
MARGINS = (1e-4, 3e-4, 1e-3)

#: Programs in turn, at most; no more are solved where one is faster than the last by less than this part and saves no
#: row. Starts at most, and how much slower than the fastest of them one may be, and is taken for another motion.
PROGRAMS, GAIN, STARTS, SLOWER, SAME = 5, 5e-4, 2, 1.15, 5e-3


class _Program:
    """The program near a motion from rest to rest, with as many pieces, in the same proportions of time.

    What is unknown, and the constraints, gathered one kind after the other; clearances keep a margin [m] at the places
    looked at.
    """

    def __init__(self, world: World, asked: Problem, margin: float, start: TimedSpline) -> None:
        self._ca = load_casadi()
        self._robot, self._field = world.robot, world.field
        self._asked, self._margin, self._start = asked, margin, start
        n, joints = len(start.control), len(asked.movable)
        self._inner = n - 2 * RESTING
        self._knots = start.knots / start.duration
        self._free = self._ca.MX.sym("c", joints, self._inner)
        self._time = self._ca.MX.sym("T")
        self._control = self._all_controls()
        self._constraints: list[Any] = []
        self._least: list[FloatArray] = []

    def _all_controls(self) -> Any:
        """(dof, n) control points: the outer ones and the joints that stay are numbers."""
        ca, start, movable = self._ca, self._start, self._asked.movable.tolist()
        rows = []
        for joint in range(start.control.shape[1]):
            values = start.control[:, joint]
            moves = joint in movable
            middle = self._free[movable.index(joint), :] if moves else ca.DM(values[RESTING:-RESTING]).T
            rows.append(ca.horzcat(ca.DM(values[:RESTING]).T, middle, ca.DM(values[-RESTING:]).T))
        return ca.vertcat(*rows)

    def _at(self, unit: FloatArray, order: int) -> Any:
        """(n, times) weights of the control points at times in units of the duration, as a sparse matrix."""
        n = len(self._start.control)
        weights = BSpline(self._knots, np.eye(n), 3)(unit, nu=order)
        weights[np.abs(weights) < 1e-14] = 0.0
        return self._ca.DM(self._ca.sparsify(self._ca.DM(weights.T)))

    def _add(self, values: Any, least: FloatArray | float = 0.0) -> None:
        """Values that have to be at least so much."""
        flat = self._ca.vec(values)
        self._constraints.append(flat)
        self._least.append(np.broadcast_to(np.asarray(least, dtype=np.float64), (flat.numel(),)).copy())

    def _add_rates(self) -> None:
        """Limits of velocity, acceleration and jerk, divided by themselves; what holds the derivatives in its hull."""
        robot, movable, n = self._robot, self._asked.movable, len(self._start.control)
        limits = (robot.velocity_limit, robot.acceleration_limit, robot.jerk_limit)
        control = self._control[movable.tolist(), :]
        knots = self._knots
        for order, limit in enumerate(limits, 1):
            # Differences of control points, in turn.
            control = self._difference(control, knots, order)
            if limit is None:
                continue
            used = slice(max(0, 3 - order), min(n - order, n - 3))
            part = control[:, used] / np.asarray(limit)[movable][:, None]
            room = self._time**order
            self._add(room - part)
            self._add(room + part)

    def _difference(self, control: Any, knots: FloatArray, order: int) -> Any:
        """Control points of the next derivative."""
        n = control.shape[1]
        span = knots[4 : n + 3] - knots[order : order + n - 1]
        return (4 - order) * (control[:, 1:] - control[:, :-1]) @ self._ca.diag(self._ca.DM(1.0 / span))

    def _add_clearances(self) -> None:
        """A constraint for each link and obstacle near it at each place."""
        ca, field, robot = self._ca, self._field, self._robot
        breaks = self._knots[3:-3]
        share = np.arange(PLACES) / PLACES
        unit = (breaks[:-1, None] + np.diff(breaks)[:, None] * share).ravel()
        here = BSpline(self._knots, self._start.control, 3)(unit)
        states = ca.mtimes(self._control, self._at(unit, 0))
        solids, widths = field.solids, field.chain[:, 1]
        for link in range(robot.arm.link_count):
            distance = link_distance(robot, link)
            kept = [s for s in range(len(solids)) if solids[s, row.KIND] in (row.POINT, row.SEGMENT)]
            ends = np.array([_ends(solids[s]) for s in kept]).reshape(-1, 6)
            radius = solids[kept, row.RADIUS] + widths[link] + self._margin
            spare = _distances(distance, here, ends) - radius
            rank = np.argsort(np.argsort(spare, axis=1, kind="stable"), axis=1, kind="stable")
            places, which = np.nonzero((spare < NEAR) & (rank < NEAREST))
            if len(places):
                first, second = ca.DM(ends[which, :3].T), ca.DM(ends[which, 3:].T)
                found = distance.map(len(places))(states[:, places.tolist()], first, second)
                self._add(found, radius[which])
        for s in np.flatnonzero(solids[:, row.KIND] == row.PAIR).tolist():
            inner, outer = int(solids[s, row.INNER]), int(solids[s, row.OUTER])
            apart = links_apart(robot, inner, outer)
            places = np.flatnonzero(np.array(apart.map(len(here))(here.T)).ravel() < solids[s, row.TOUCHING] + NEAR)
            if len(places):
                found = apart.map(len(places))(states[:, places.tolist()])
                self._add(found, solids[s, row.TOUCHING] + self._margin)

    def _add_torques(self) -> None:
        robot, limit = self._robot, self._robot.torque_limit
        breaks = self._knots[3:-3]
        share = np.arange(TIMES) / TIMES
        unit = (breaks[:-1, None] + np.diff(breaks)[:, None] * share).ravel()
        curve, pace = BSpline(self._knots, self._start.control, 3), self._start.duration
        told = [curve(unit, nu=order) / pace**order for order in range(3)]
        if np.abs(robot.dynamics.torques(*told) / limit).max() < LOADED:
            return
        states = [ca_at / self._time**order for order, ca_at in enumerate(self._states(unit))]
        torques = inverse_dynamics(robot.model).map(len(unit))(*states) / np.asarray(limit)[:, None]
        self._add(ALLOWED - torques)
        self._add(ALLOWED + torques)

    def _states(self, unit: FloatArray) -> list[Any]:
        return [self._ca.mtimes(self._control, self._at(unit, order)) for order in range(3)]

    def solve(self) -> TimedSpline | None:
        """The solver's motion, whatever it says of it; None where it is not finite."""
        ca, asked, start = self._ca, self._asked, self._start
        self._add_rates()
        self._add_clearances()
        self._add_torques()
        unknown = ca.vertcat(ca.vec(self._free), self._time)
        least = np.concatenate(self._least)
        options = {
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": ITERATIONS,
                "max_cpu_time": SECONDS,
                "tol": 1e-7,
                "acceptable_tol": 1e-6,
                "mu_init": 1e-4,
                "bound_relax_factor": 0.0,
                "constr_viol_tol": 1e-9,
            },
        }
        program = {"x": unknown, "f": self._time, "g": ca.vertcat(*self._constraints)}
        solver = ca.nlpsol("fastest", "ipopt", program, options)
        inner = start.control[RESTING:-RESTING][:, asked.movable]
        low = np.maximum(asked.lower[asked.movable], inner - TRUST).ravel()
        high = np.minimum(asked.upper[asked.movable], inner + TRUST).ravel()
        found = solver(
            x0=np.append(inner.ravel(), start.duration),
            lbx=np.append(low, 0.1 * start.duration),
            ubx=np.append(high, 10.0 * start.duration),
            lbg=least,
            ubg=np.full(len(least), np.inf),
        )
        x = np.array(found["x"]).ravel()
        if not np.isfinite(x).all():
            return None
        control = np.array(start.control)
        control[RESTING:-RESTING, asked.movable] = x[:-1].reshape(self._inner, -1)
        return TimedSpline(frozen(control), frozen(self._knots * x[-1]))


def _ends(solid: FloatArray) -> FloatArray:
    """Both ends of a ball's or a capsule's axis."""
    first = solid[row.SHAPE : row.SHAPE + 3]
    second = solid[row.SECOND_END : row.SECOND_END + 3] if solid[row.KIND] == row.SEGMENT else first
    return np.concatenate([first, second])


def _distances(distance: Any, configurations: FloatArray, ends: FloatArray) -> FloatArray:
    """(n, solids) distances of a link's axis from the axes of solids."""
    if not len(ends):
        return np.zeros((len(configurations), 0))
    n, m = len(configurations), len(ends)
    q, both = np.repeat(configurations, m, axis=0), np.tile(ends, (n, 1))
    return np.array(distance.map(n * m)(q.T, both[:, :3].T, both[:, 3:].T)).reshape(n, m)


def optimized(robot: Robot, scene: Scene, starts: Sequence[Trajectory]) -> Trajectory | None:
    """The fastest certified motion that IPOPT finds near some; None where it finds none.

    Args:
        robot: The arm.
        scene: Balls and capsules, start and goal.
        starts: Motions to begin with; the fastest few are taken, those of about the same duration once.

    Raises:
        InputError: CasADi is not installed.
    """
    kept: list[Trajectory] = []
    for start in sorted(starts, key=lambda motion: motion.duration):
        if not kept or kept[-1].duration * (1.0 + SAME) < start.duration < SLOWER * kept[0].duration:
            kept.append(start)
    found = [motion for start in kept[:STARTS] if (motion := _near(robot, scene, start)) is not None]
    return min(found, key=lambda motion: motion.duration, default=None)


def _near(robot: Robot, scene: Scene, start: Trajectory) -> Trajectory | None:
    """The fastest certified motion near one; None where none is found."""
    world = world_of(robot, scene)
    ends = scene.start.configuration, scene.goal.configuration
    asked = check_problem(world, *ends, locked_joints=scene.locked_joints)
    rows = max(FEWEST, round(start.duration * RATE_HZ))
    spline = TimedSpline.near(start.positions, _breaks(rows))
    best: Trajectory | None = None
    for margin in MARGINS:
        verified = False
        for found, meets_rows in _programs(partial(_Program, world, asked, margin), spline, rows):
            motion = found.trajectory(robot.dynamics, RATE_HZ)
            if best is not None and best.duration <= motion.duration:
                continue
            is_verified = certify(robot, scene, motion, checker=world.checker).verified
            best = motion if is_verified else best
            verified = is_verified if meets_rows else verified
        if verified:
            break
    return best


def _programs(
    near: Callable[[TimedSpline], _Program], start: TimedSpline, rows: int
) -> Iterator[tuple[TimedSpline, bool]]:
    """Motions of programs, each from the last, of whole numbers of rows; and whether their pieces meet at rows.

    They do where that is the number of rows that the program was made for; else the rows are only near the motion.
    """
    before, spline = math.inf, start
    for _ in range(PROGRAMS):
        found = near(spline).solve()
        if found is None:
            return
        needed = max(FEWEST, math.ceil(found.duration * RATE_HZ - 1e-6))
        slower = found.at_pace(needed / RATE_HZ / found.duration)
        if needed <= rows:
            yield found.at_pace(rows / RATE_HZ / found.duration), True
        if needed != rows:
            yield slower, False
        if needed >= rows and found.duration > (1.0 - GAIN) * before:
            return
        before, rows = found.duration, needed
        spline = TimedSpline.near(slower.path.evaluate, _breaks(rows))


def _breaks(rows: int) -> FloatArray:
    """Times at which pieces of a motion of so many rows meet [s]."""
    return breaks_at_rows(rows, min(max(rows // ROWS_EACH, 2 * RESTING), MOST_PIECES), RATE_HZ)
