"""Collision and limit checks of configurations, for use in other planners."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hplan.base import ties
from hplan.base.arguments import instance, number
from hplan.base.arrays import BoolArray, FloatArray, Record, numbers, readonly
from hplan.base.units import FARTHEST_JOINT
from hplan.certificate.moving_obstacles import checker_in_time
from hplan.collision.coal_scene import CoalScene, Contact
from hplan.collision.compliant_solids import check_yield_links
from hplan.collision.held_objects import holding
from hplan.errors import InputError, OptionError, TiltedError
from hplan.robot.model import Robot
from hplan.scene.model import Scene, checked_scene


@dataclass(frozen=True, eq=False)
class ConfigurationCheck(Record):
    """Results of a configuration check.

    Arrays have shape (...) for (..., dof) configurations, and () for one configuration.

    Attributes:
        valid: True if the joints are within their limits, all distances exceed the required clearance, and the tool is
            upright if it has to be.
        in_contact: True if the arm touches an obstacle or itself, or exceeds the allowed deflection of a compliant
            obstacle.
        distance_m: Signed distance of the nearest pair, the one with the minimum distance beyond its required
            clearance; negative for penetration depth, inf without any pair [m].
        contacts: That pair for each configuration in turn: link, and obstacle or other link; None without any pair.
        limit_faults: For each configuration in turn the message about the first joint outside its limits, or about a
            tool that is not upright; None without any.
    """

    valid: BoolArray
    in_contact: BoolArray
    distance_m: FloatArray
    contacts: tuple[Contact | None, ...]
    limit_faults: tuple[str | None, ...]

    @property
    def nearest_contact(self) -> Contact | None:
        """The nearest pair over all configurations; None without any pair."""
        found = [contact for contact in self.contacts if contact is not None]
        return found[ties.argmin([contact.distance_m for contact in found])] if found else None


def check(
    robot: Robot, scene: Scene, q: ArrayLike, *, time_s: float | None = None, sigmas: float = 3.0
) -> ConfigurationCheck:
    """Check joint limits and distances of configurations.

    Distances come from coal, as in the certificate. All fruits count as obstacles, the goal fruit included. Overlaps of
    obstacles with pedestal and turret are not checked, because no joint changes them. A path between valid
    configurations may still collide: `finish` certifies a path. The checker is cached for the next call with the same
    robot and scene.

    Args:
        robot: The arm.
        scene: Obstacles, fruit, and the required clearance.
        q: (dof,) configuration, or (..., dof) configurations [rad; m for prismatic joints].
        time_s: Time of the check for moving obstacles, on the clock of their tracks [s].
        sigmas: Inflation of obstacles with uncertain positions, in standard deviations.

    Raises:
        InputError: `q` is not an array of finite numbers with the robot's number of joints.
        MovingObstacleError: The scene has moving obstacles, but no time is given.
        OptionError: The robot or the scene is of the wrong type, the time is not finite or an obstacle is not predicted
            up to then, `sigmas` is negative, or `yield_links` names an unknown link.
        SceneError: A value of the scene was changed without validation.
    """
    instance("robot", robot, Robot, "load_robot")
    robot = holding(robot, checked_scene(scene).attached)
    check_yield_links(robot, scene.yield_links)
    if time_s is not None:
        number("time_s", time_s, "a finite number of seconds")
    number("sigmas", sigmas, "a finite number >= 0", lambda value: value >= 0.0)
    values = numbers("q", q, (..., robot.dof), most=FARTHEST_JOINT)
    rows, shape = values.reshape(-1, robot.dof), values.shape[:-1]
    checker = _checker(robot, scene, sigmas)
    known_until_s, name = (math.inf, "") if checker.moving is None else checker.moving.known_until
    if time_s is not None and time_s > known_until_s:
        raise OptionError("time_s", time_s, f"at most {known_until_s:g} s: {name!r} is predicted until then")
    found = [_looked_at(checker, row, scene.clearance, time_s) for row in rows]
    names = ["q" if not shape else f"q[{', '.join(map(str, index))}]" for index in np.ndindex(shape)]
    faults = [
        robot.about(row).limit_fault(row, name) or _tilt_fault(checker, row, name)
        for row, name in zip(rows, names, strict=True)
    ]
    return ConfigurationCheck(
        readonly(
            [valid and fault is None for (valid, _, _), fault in zip(found, faults, strict=True)], np.bool_
        ).reshape(shape),
        readonly([touches for _, touches, _ in found], np.bool_).reshape(shape),
        readonly([math.inf if near is None else near.distance_m for _, _, near in found]).reshape(shape),
        tuple(near for _, _, near in found),
        tuple(None if fault is None else fault.message for fault in faults),
    )


def _tilt_fault(checker: CoalScene, q: FloatArray, name: str) -> InputError | None:
    """The error about a tool that is not upright; None if it is, or need not be."""
    if checker.upright is not None:
        try:
            checker.upright.check(checker.robot, q, name)
        except TiltedError as error:
            return error.with_traceback(None)
    return None


def _checker(robot: Robot, scene: Scene, sigmas: float) -> CoalScene:
    """The collision checker of a scene; the robot caches the last one."""
    kept: deque[tuple[Scene, float, CoalScene]] = robot.cache("last checker", lambda: deque(maxlen=1))
    for known, growth, checker in tuple(kept):
        if known is scene and growth == sigmas:
            return checker
    checker = checker_in_time(robot, scene, sigmas).with_margins(0.0, scene.clearance)
    kept.append((scene, sigmas, checker))
    return checker


def _looked_at(
    checker: CoalScene, q: FloatArray, clearance: float, time_s: float | None
) -> tuple[bool, bool, Contact | None]:
    """Return validity, contact flag and nearest pair of a configuration."""
    if not checker.pairs:
        return True, False, None

    def query_nearest(clearance: float) -> tuple[bool, int, float]:
        kept = np.broadcast_to(np.asarray(checker.required_distance(clearance)), (len(checker.pairs),))
        pair, distance = checker.nearest_pair(q, kept, time_s)
        return bool(distance > kept[pair]), pair, distance

    valid, pair, distance = query_nearest(clearance)
    touches = not valid and (clearance == 0.0 or not query_nearest(0.0)[0])
    return valid, touches, checker.contact(*checker.pairs[pair], distance)
