r"""Additional torque from a base that tilts on its track.

Gravity then pulls along a different axis of the arm. Torques are computed for an upright base. They are linear in
gravity: if it is off by :math:`\Delta g`, the torque of a revolute joint is off by at most

.. math:: |\Delta g| \sum_{i} m_i \, r_{ij},

over the bodies i that the joint carries, of mass :math:`m_i`, with :math:`r_{ij}` the maximum distance of the centre of
mass from the joint's axis over all configurations (`hplan.collision.motion_coefficients`); 1 for a prismatic joint. If
the base's vertical is at an angle :math:`\theta` to the world's, :math:`|\Delta g| = 2 g \sin(\theta / 2)`.

A track rotates from one time to the next about one axis, so the height of the vertical's tip is a sine of the rotation
angle, and its minimum is known.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hplan.base.arrays import FloatArray, frozen
from hplan.certificate.limit_use import LimitUse, fraction_of
from hplan.collision.motion_coefficients import points_reach
from hplan.robot.model import Robot, made_once
from hplan.scene.model import Scene
from hplan.scene.tracks import Poses

#: A vertical that is off by at most this is upright: the cosine cannot resolve smaller angles [rad].
_UPRIGHT = 1e-6


def use_on_track(use: LimitUse, robot: Robot, scene: Scene, begin_s: float, duration: float) -> LimitUse:
    """Limit use of the arm on its track.

    Unchanged if the base stays upright.

    Args:
        use: Limit use of an arm on an upright base.
        robot: The arm.
        scene: The scene, with the base's track.
        begin_s: Start time of the motion on the clock of the track [s].
        duration: Duration of the motion [s].
    """
    if scene.base_track is None:
        return use
    tilt = largest_tilt(Poses.from_track(scene.base_track), begin_s, begin_s + duration)
    if tilt <= _UPRIGHT:
        return use
    more = 2.0 * float(np.linalg.norm(robot.model.gravity.linear)) * math.sin(0.5 * tilt) * first_moments(robot)
    return replace(use, torque=use.torque + fraction_of(more, robot.torque_limit))


def largest_tilt(base: Poses, begin_s: float, end_s: float) -> float:
    """Maximum angle between the base's vertical and the world's [rad].

    The maximum is over the times from `begin_s` to `end_s` of the base's track.
    """
    up = np.array([0.0, 0.0, 1.0])
    first = max(int(np.searchsorted(base.times, begin_s, side="right")) - 1, 0)
    last = min(int(np.searchsorted(base.times, end_s, side="left")), len(base.times) - 1)
    lowest = float(base.rotations[min(first, last) : max(first, last) + 1, 2, 2].min())
    for piece in range(first, last):
        # The vertical of R exp(a axis), seen from the base, has the height constant + even cos a + odd sin a.
        turn = base.turns[piece]
        angle = float(np.linalg.norm(turn))
        if angle > 0.0:
            axis, seen = turn / angle, base.rotations[piece][2]
            constant = float(seen @ axis) * float(up @ axis)
            even, odd = float(up @ seen) - constant, float(seen @ np.cross(axis, up))
            if math.atan2(-odd, -even) % math.tau <= angle:
                lowest = min(lowest, constant - math.hypot(even, odd))
    return math.acos(min(max(lowest, -1.0), 1.0))


@made_once
def first_moments(robot: Robot) -> FloatArray:
    """(dof,) first mass moments about the joint axes [kg m].

    Sums over the carried bodies of mass times maximum distance of the centre of mass from the axis. For a prismatic
    joint the sum of the masses alone [kg].
    """
    rows = [
        inertia.mass * points_reach(robot, np.array(inertia.lever)[None], joint)
        for joint, inertia in enumerate(robot.model.inertias.tolist()[1:])
    ]
    return frozen(np.sum(rows, axis=0))
