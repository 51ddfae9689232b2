"""An arm in CasADi's expressions: distances of its links from obstacles, and its torques.

Links are segments with a radius, obstacles balls and capsules; both formulas are written anew here from the geometry
and the inertias, and share nothing with hplan's kernels, which the tests hold them to.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from hplan.errors import InputError
from hplan.robot.model import Robot

#: What keeps square roots and quotients off zero, in squares of metres.
_TINY = 1e-12


def load_casadi() -> Any:
    """The package.

    Raises:
        InputError: It is not installed.
    """
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise InputError("ipopt: CasADi is not installed (pip install 'hplan[bench]')") from error


def joint_points(robot: Robot, q: Any) -> list[Any]:
    """The shoulder, the other joints and the tool as expressions of a configuration, (3,) each [m].

    Links beside the arm plane are taken as if they lay in it (`PlanarArm.lateral` is not looked at).
    """
    ca, arm = load_casadi(), robot.arm
    yaw = q[0] if robot.has_yaw else ca.SX(0.0)
    c, s = ca.cos(yaw), ca.sin(yaw)
    turn = ca.vertcat(ca.horzcat(c, -s, 0.0), ca.horzcat(s, c, 0.0), ca.horzcat(0.0, 0.0, 1.0))
    axis = np.append(robot.yaw_axis, 0.0)
    point = axis + turn @ (robot.plane_origin - axis)
    points, angle = [point], ca.SX(0.0)
    for link in range(arm.link_count):
        angle = angle + float(arm.signs[link]) * q[robot.yaw_joints + link] + float(arm.offsets[link])
        along = ca.cos(angle) * robot.plane_axes[0] + ca.sin(angle) * robot.plane_axes[1]
        point = point + float(arm.lengths[link]) * (turn @ along)
        points.append(point)
    return points


def segment_distance(p: Any, u: Any, a: Any, v: Any) -> Any:
    """Distance of the segments p + [0, 1] u and a + [0, 1] v; v may be zero.

    As in Ericson, Real-Time Collision Detection (2005), 5.1.9: the nearest points of the lines, clamped in turn.
    """
    ca = load_casadi()

    def clamp(x: Any) -> Any:
        return ca.fmin(1.0, ca.fmax(0.0, x))

    apart = p - a
    uu, vv, uv = ca.dot(u, u), ca.dot(v, v) + _TINY, ca.dot(u, v)
    up, vp = ca.dot(u, apart), ca.dot(v, apart)
    s = clamp((uv * vp - up * vv) / (uu * vv - uv * uv + _TINY))
    t = clamp((uv * s + vp) / vv)
    s = clamp((t * uv - up) / uu)
    off = apart + s * u - t * v
    return ca.sqrt(ca.dot(off, off) + _TINY)


def link_distance(robot: Robot, link: int) -> Any:
    """The function (q, first end, second end) -> distance of a link's axis from a segment [m]."""
    ca = load_casadi()
    q, a, b = ca.SX.sym("q", robot.dof), ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    points = joint_points(robot, q)
    p = points[link]
    return ca.Function(f"link_{link}", [q, a, b], [segment_distance(p, points[link + 1] - p, a, b - a)])


def links_apart(robot: Robot, inner: int, outer: int) -> Any:
    """The function q -> distance of the axes of two links [m]."""
    ca = load_casadi()
    q = ca.SX.sym("q", robot.dof)
    points = joint_points(robot, q)
    ends = [(points[link], points[link + 1] - points[link]) for link in (inner, outer)]
    return ca.Function(f"links_{inner}_{outer}", [q], [segment_distance(*ends[0], *ends[1])])


def inverse_dynamics(model: pin.Model) -> Any:
    """The function (q, v, a) -> torques of a chain of joints that turn about a fixed axis [N m].

    The recursive Newton-Euler algorithm (Featherstone, Rigid Body Dynamics Algorithms, 2008, table 5.1) in vectors of
    each body's own frame; gravity is an acceleration of the base.

    Raises:
        InputError: The model is no such chain.
    """
    ca = load_casadi()
    joints = model.joints.tolist()[1:]
    if any(not joint.shortname().startswith("JointModelR") or joint.nv != 1 for joint in joints):
        raise InputError("ipopt: torques are known of joints that turn about a fixed axis only")
    if [model.parents[number] for number in range(1, model.njoints)] != list(range(model.njoints - 1)):
        raise InputError("ipopt: torques are known of a chain of joints only")
    q, v, a = (ca.SX.sym(name, model.nv) for name in "qva")
    omega, alpha, push = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX(-np.array(model.gravity.linear))
    bodies = []
    for i, joint in enumerate(joints):
        place, inertia = model.jointPlacements[i + 1], model.inertias[i + 1]
        axis = _axis_of(joint)
        # The joint's frame seen from its parent's, by Rodrigues' formula.
        cross = pin.skew(axis)
        turn = np.eye(3) + ca.sin(q[i]) * cross + (1.0 - ca.cos(q[i])) * (cross @ cross)
        frame, at = ca.mtimes(ca.SX(place.rotation), turn), np.array(place.translation)
        push = frame.T @ (push + ca.cross(alpha, at) + ca.cross(omega, ca.cross(omega, at)))
        outer = frame.T @ omega
        alpha = frame.T @ alpha + ca.cross(outer, v[i] * axis) + a[i] * axis
        omega = outer + v[i] * axis
        centre, tensor = np.array(inertia.lever), np.array(inertia.inertia)
        at_centre = push + ca.cross(alpha, centre) + ca.cross(omega, ca.cross(omega, centre))
        force = inertia.mass * at_centre
        moment = tensor @ alpha + ca.cross(omega, tensor @ omega) + ca.cross(centre, force)
        bodies.append((frame, at, axis, force, moment))
    return ca.Function("torques", [q, v, a], [_inward(bodies, a, np.array(model.armature))])


def _axis_of(joint: Any) -> Any:
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    return np.array(data.S).reshape(2, 3)[1]


def _inward(bodies: Sequence[tuple[Any, ...]], a: Any, armature: Any) -> Any:
    """Torques of forces and moments at each body's joint, each added to those of its parent."""
    ca = load_casadi()
    force, moment, found = ca.SX.zeros(3), ca.SX.zeros(3), []
    for i, (frame, at, axis, own_force, own_moment) in reversed(list(enumerate(bodies))):
        force, moment = own_force + force, own_moment + moment
        found.append(ca.dot(axis, moment) + float(armature[i]) * a[i])
        force = frame @ force
        moment = frame @ moment + ca.cross(at, force)
    return ca.vertcat(*reversed(found))
