"""C-space at one yaw, and a motion projected into it.

The forbidden region is the set of configurations with negative clearance. Clearance is evaluated at the nodes of a
grid, and the region's surface is interpolated between them. For a motion that turns the base, the picture is valid only
near that yaw, because the region changes with the yaw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hplan.apps.view.framing import view_axes
from hplan.apps.view.playback import Playback
from hplan.base.arrays import FloatArray, frozen
from hplan.collision.distance_checker import DistanceChecker
from hplan.errors import InputError, OptionError
from hplan.geometry.polyline import stations
from hplan.planar.family_reader import family_of
from hplan.planar.grid.grid import Grid
from hplan.planar.pages.cspace_surface import hidden_by_surface
from hplan.planning.options import PlanOptions
from hplan.planning.world import World
from hplan.robot.model import Robot
from hplan.scene.model import Scene

#: Spacing of the region's grid, and its approximate maximum number of nodes.
_STEP_DEG, _MOST_NODES = 2.0, 100_000

#: Number of points of the projected motion, and the yaw distance within which they count for the choice of the view.
_POINTS, _NEAR = 400, math.radians(10.0)


@dataclass(frozen=True, eq=False)
class YawSection:
    """C-space of the planar joints at one yaw, with a motion.

    Attributes:
        field: (N1, N2, N3) clearance of the arm at the grid's nodes [m]; negative in the forbidden region.
        path: (m, 3) planar joints along the motion, evenly spaced, from the start to the goal.
        yaw_distance: (m,) distance of the motion's yaw from `yaw` at these points.
        times: (m,) times of these points [s].
        joint_names: Names of the planar joints.
    """

    yaw: float
    grid: Grid
    field: FloatArray
    path: FloatArray
    yaw_distance: FloatArray
    times: FloatArray
    joint_names: tuple[str, ...]

    @property
    def view(self) -> tuple[float, float]:
        """Azimuth and elevation of the best view [deg].

        The region hides the least of the motion, and the motion appears long. Points near the yaw have the most weight.
        """
        nodes = self.grid.position(self.path)
        size = (nodes - nodes.mean(axis=0)) / (np.array(self.grid.shape) - 1.0)
        weights = np.where(self.yaw_distance <= _NEAR, 1.0, 0.1)
        best, chosen = math.inf, (0.0, 0.0)
        # Candidate view directions, not along any axis [deg].
        azimuths, elevations = (30, 60, 120, 150, 210, 240, 300, 330), (18, 28, 40)
        for elevation in elevations:
            for azimuth in azimuths:
                towards = view_axes(math.radians(azimuth), math.radians(elevation))[2]
                behind = float(weights @ hidden_by_surface(self.field, nodes, towards) / weights.sum())
                across = size - np.outer(size @ towards, towards)
                cost = behind - 0.2 * float(np.sqrt(np.square(across).sum(axis=1)).max())
                if cost < best:
                    best, chosen = cost, (float(azimuth), float(elevation))
        return chosen


def yaw_section(
    robot: Robot, scene: Scene, playback: Playback, options: PlanOptions | None = None, *, yaw: float | None = None
) -> YawSection:
    """Compute the C-space at one yaw, with a motion in it.

    Args:
        robot: Arm with three planar joints.
        scene: Obstacles and fruits; the goal fruit is omitted, because it may be touched.
        playback: The motion; the phases after the first approach and the picked fruits are omitted.
        options: The motion's planning options: tracking error and uncertainty grow the region.
        yaw: The yaw; None for the goal's.

    Raises:
        InputError: The arm does not have three planar joints, or the trajectory is for other joints.
        OptionError: The yaw is not finite, is beyond the limits, or is nonzero for an arm without yaw.
    """
    family = family_of(robot)
    check_yaw(robot, yaw)
    playback.check(robot)
    trajectory = playback.trajectory
    end = min((phase.end_s for phase in playback.phases if phase.name == "approach"), default=trajectory.duration)
    rows = trajectory.time <= end + 1e-9
    motion, times = trajectory.position[rows], trajectory.time[rows]
    at = family.yaw_of(motion[-1]) if yaw is None else yaw
    choice = PlanOptions() if options is None else options
    world = World.build(
        robot,
        [solid for solid in scene.solids if solid.name not in playback.picked],
        clearance=scene.clearance,
        tracking_error=choice.tracking.still_rad,
        sigmas=choice.sigmas,
        yield_links=scene.yield_links,
    )
    planar = family.arm_slice
    along = stations(motion)
    # Samples coincide while the arm rests.
    moving = np.concatenate([[True], np.diff(along) > 0.0])
    evenly = np.linspace(0.0, along[-1], _POINTS)
    path = np.column_stack([np.interp(evenly, along[moving], column) for column in motion[moving].T])
    grid = _grid(robot)
    return YawSection(
        yaw=at,
        grid=grid,
        field=_field(robot, world.field, grid, at),
        path=frozen(np.ascontiguousarray(path[:, planar])),
        yaw_distance=frozen(np.abs(path[:, 0] - at) if family.has_yaw else np.zeros(len(path))),
        times=frozen(np.interp(evenly, along[moving], times[moving])),
        joint_names=robot.joint_names[planar],
    )


def check_yaw(robot: Robot, yaw: float | None) -> None:
    """Check that an arm's C-space can be drawn at a yaw.

    None for the goal's yaw.

    Raises:
        InputError: The arm does not have three planar joints.
        OptionError: The yaw is not finite, is beyond the limits, or is nonzero for an arm without yaw.
    """
    family = family_of(robot)
    if family.arm.link_count != 3:
        raise InputError(
            f"the C-space view requires three planar joints; {robot.name!r} has {family.arm.link_count}",
            expected=3, got=family.arm.link_count,
        )  # fmt: skip
    low, high = (float(robot.lower[0]), float(robot.upper[0])) if family.has_yaw else (0.0, 0.0)
    if yaw is not None and not low - 1e-9 <= yaw <= high + 1e-9:
        words = f"degrees from {math.degrees(low):.6g} to {math.degrees(high):.6g}"
        raise OptionError("yaw", math.degrees(yaw), words)


def _grid(robot: Robot) -> Grid:
    family = family_of(robot)
    span = family.arm.upper - family.arm.lower
    step = max(math.radians(_STEP_DEG), float(np.prod(span) / _MOST_NODES) ** (1.0 / 3.0))
    return Grid.from_limits(family.arm.lower, family.arm.upper, step)


def _field(robot: Robot, checker: DistanceChecker, grid: Grid, yaw: float) -> FloatArray:
    """Spare clearance at the grid's nodes, capped at 1e3 m."""
    q = np.full((grid.size, robot.dof), yaw)
    q[:, family_of(robot).arm_slice] = grid.coordinates(np.stack(list(np.ndindex(*grid.shape))))
    field = checker.spare_clearances(q)
    # Interpolating the surface needs finite values, and clearance is infinite without obstacles.
    return frozen(np.minimum(field, 1e3).reshape(grid.shape))
