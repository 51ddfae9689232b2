"""Arrays of a robot's bodies, joints and self-collision pairs, for kernels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record, TableArray, frozen
from hplan.collision.arm_pairs import ArmParts, arm_parts
from hplan.collision.collision_bodies import GROUND, CollisionBody, ball_about, collision_bodies
from hplan.collision.reach import carriers, joint_axis, points_reach
from hplan.collision.touching_pairs import required_distances, self_pairs
from hplan.geometry.convex_distance import corner_table
from hplan.robot.model import Robot, made_once

#: Columns of a body: its joint (`dof` for the ground); offsets of the start and end of its points, and of their table
#: (`hplan.geometry.convex_distance`; 0 for none); its rounding radius; centre and radius of a bounding ball; start,
#: vector and radius of a bounding capsule; and whether it is checked against obstacles, because joints move it and no
#: other body contains it.
BODY = np.dtype(
    [
        ("joint", np.int64),
        ("first", np.int64),
        ("last", np.int64),
        ("table", np.int64),
        ("rounding", np.float64),
        ("ball", np.float64, 3),
        ("ball_radius", np.float64),
        ("axis_start", np.float64, 3),
        ("axis_vector", np.float64, 3),
        ("axis_radius", np.float64),
        ("is_checked", np.bool_),
    ],
    align=True,
)

#: Columns of a pair: its bodies, first the one whose motion relative to the other is considered; the distances of their
#: hulls, of their ball centres and of their segments at which contact is excluded.
PAIR = np.dtype(
    [
        ("outer", np.int64),
        ("inner", np.int64),
        ("hull_distance", np.float64),
        ("ball_distance", np.float64),
        ("axis_distance", np.float64),
    ],
    align=True,
)

#: Columns of a joint with value q: three 3x3 matrices A, B, C by rows, for its rotation A + B cos(q) + C sin(q) in the
#: parent's frame; its position and the direction of its shift by q; its parent's index (`dof` for the base); its
#: rotation axis in its own frame, zeros for a prismatic joint; and whether it is prismatic.
JOINT = np.dtype(
    [
        ("constant", np.float64, 9),
        ("cosine", np.float64, 9),
        ("sine", np.float64, 9),
        ("position", np.float64, 3),
        ("shift", np.float64, 3),
        ("parent", np.int64),
        ("axis", np.float64, 3),
        ("slides", np.bool_),
    ],
    align=True,
)

#: A body with at most this number of coordinates is exactly its bounding capsule.
THIN = 6


@dataclass(frozen=True, eq=False)
class FlatBodies(Record):
    """Moving bodies of a robot as tables.

    Attributes:
        bodies: (bodies,) rows of `BODY`, in the order of `collision_bodies`, then capsules that replace cylinders with
            a ball at either end; for a planar arm the capsules of its links, then the shapes of turret and pedestal
            that they can touch.
        pairs: (pairs,) rows of `PAIR`, the checked self-collision pairs.
        joints: (dof,) rows of `JOINT`.
        reaches: (bodies + pairs, dof) motion-bound coefficients (`hplan.collision.reach`).
        points: Coordinates of the points of all bodies, each with its table.
    """

    bodies: TableArray
    pairs: TableArray
    joints: TableArray
    reaches: FloatArray
    points: FloatArray

    @classmethod
    def of(cls, robot: Robot, own_clearance: float = 0.0, deviation: float = 0.0) -> FlatBodies:
        """Flatten the bodies of a robot.

        Args:
            robot: The robot.
            own_clearance: Required clearance of the self-collision pairs [m].
            deviation: Maximum deviation of every joint [rad, m]; bodies are grown by their displacement bound.
        """
        if robot.planar is None:
            still = robot.cached("flat bodies", lambda: _of_any_arm(robot))
            farthest = self_pairs(robot).farthest
        else:
            parts = arm_parts(robot, "capsule", deviation, own_clearance, single_joint_pairs=False)
            still = robot.cached(("flat bodies", *parts.key), lambda: _of_parts(parts))
            farthest = np.full(len(parts.own), np.inf)
        kept = np.append(np.zeros(len(still.bodies)), required_distances(farthest, own_clearance))
        bodies, pairs = thicker(still.bodies, still.pairs, deviation * still.reaches.sum(axis=1) + kept)
        return replace(still, bodies=bodies, pairs=pairs)

    def with_pairs(self, chosen: BoolArray) -> FlatBodies:
        """Return the bodies with some of the pairs, by a (pairs,) mask."""
        kept = np.append(np.ones(len(self.bodies), dtype=np.bool_), chosen)
        return replace(self, pairs=frozen(self.pairs[chosen]), reaches=frozen(self.reaches[kept]))


def thicker(bodies: TableArray, pairs: TableArray, by: FloatArray) -> tuple[TableArray, TableArray]:
    """Grow bodies and required distances by (bodies + pairs,) [m]."""
    bodies, pairs = bodies.copy(), pairs.copy()
    for name in ("rounding", "ball_radius", "axis_radius"):
        bodies[name] += by[: len(bodies)]
    for name in ("hull_distance", "ball_distance", "axis_distance"):
        pairs[name] += by[len(bodies) :]
    return frozen(bodies), frozen(pairs)


def _of_any_arm(robot: Robot) -> FlatBodies:
    """Bodies of a general (non-planar) arm, and its checked pairs."""
    own, pairs = collision_bodies(robot), self_pairs(robot)
    capsules = list(_capsules(own))
    bodies = [*own, *(capsule for capsule, _ in capsules)]
    held = {part for _, parts in capsules for part in parts}
    meets = [body.joint != GROUND and number not in held for number, body in enumerate(bodies)]
    return _flat(robot, bodies, meets, pairs.checked)


def _of_parts(parts: ArmParts) -> FlatBodies:
    """Shapes of a planar arm, and base shapes it can touch."""
    (both, _), links = parts.movers, len(parts.shapes)
    return _flat(parts.robot, parts.bodies, np.arange(len(parts.bodies)) < links, both[links:].tolist())


def _flat(
    robot: Robot, bodies: Sequence[CollisionBody], meets: Sequence[bool] | BoolArray, pairs: Sequence[tuple[int, int]]
) -> FlatBodies:
    """Flatten bodies and pairs.

    `meets` marks the bodies that are checked against obstacles.
    """
    alone = np.array([points_reach(robot, body.core, body.joint) for body in bodies]).reshape(-1, robot.dof)
    carried = [carriers(robot, body.joint) for body in bodies]
    rows, points, first = np.zeros(len(bodies), BODY), list[FloatArray](), 0
    for row, body, is_checked in zip(rows, bodies, meets, strict=True):
        end = first + body.core.size
        table = corner_table(body.core, first, end)
        row["joint"] = robot.dof if body.joint == GROUND else body.joint
        row["first"], row["last"], row["table"] = first, end, end if len(table) else 0
        points += [body.core.ravel(), table]
        first = end + len(table)
        row["rounding"], row["is_checked"] = body.rounding, is_checked
        row["ball"], radius = ball_about(body.core)
        row["ball_radius"] = radius * (1.0 + 1e-12) + body.rounding
        row["axis_start"], row["axis_vector"], radius = _axis(body.core)
        row["axis_radius"] = radius * (1.0 + 1e-12) + body.rounding
    both, of_pairs = np.zeros(len(pairs), PAIR), np.zeros((len(pairs), robot.dof))
    for row, reach, (i, j) in zip(both, of_pairs, pairs, strict=True):
        row["outer"], row["inner"] = (i, j) if len(carried[i]) > len(carried[j]) else (j, i)
        row["hull_distance"] = bodies[i].rounding + bodies[j].rounding
        row["ball_distance"] = rows[i]["ball_radius"] + rows[j]["ball_radius"]
        row["axis_distance"] = rows[i]["axis_radius"] + rows[j]["axis_radius"]
        between = sorted(set(carried[i]) ^ set(carried[j]))
        reach[between] = (alone[i] + alone[j])[between]
    reaches = np.concatenate([alone, of_pairs])
    return FlatBodies(
        frozen(rows), frozen(both), joint_table(robot), frozen(reaches), frozen(np.concatenate([np.zeros(0), *points]))
    )


def _capsules(bodies: Sequence[CollisionBody]) -> Iterator[tuple[CollisionBody, tuple[int, ...]]]:
    """Capsules around a cylinder with a ball at either end.

    URDFs describe capsules in this way. Each capsule comes with the indices of the three bodies that it contains. Only
    the capsule is checked against obstacles, because it is smooth.
    """
    for number, tube in enumerate(bodies):
        if tube.kind != "cylinder" or tube.joint == GROUND:
            continue
        ends = tube.core.reshape(2, -1, 3).mean(axis=1)
        radius = float(np.linalg.norm(tube.core[0] - ends[0])) - tube.growth
        parts, away = [number], 0.0
        for end in ends:
            for other, ball in enumerate(bodies):
                off = float(np.linalg.norm(ball.core[0] - end)) + abs(ball.rounding - radius)
                # Tolerance of centre and radius of a ball at the end of a cylinder [m].
                if ball.kind == "sphere" and ball.joint == tube.joint and off <= 1e-9:
                    parts.append(other)
                    away = max(away, off)
                    break
        if len(parts) == 3:
            yield replace(tube, core=frozen(ends), rounding=radius + away, kind="capsule", growth=0.0), tuple(parts)


@made_once
def joint_table(robot: Robot) -> TableArray:
    """(dof,) rows of `JOINT`, cached."""
    table = np.zeros(robot.dof, JOINT)
    for j, row in enumerate(table):
        axis, slides = joint_axis(robot, j)
        place = robot.model.jointPlacements[j + 1]
        # Rodrigues' formula; the rotation of a prismatic joint is constant.
        along = np.eye(3) if slides else np.outer(axis, axis)
        across = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
        row["constant"] = (place.rotation @ along).ravel()
        row["cosine"] = (place.rotation @ (np.eye(3) - along)).ravel()
        row["sine"] = np.zeros(9) if slides else (place.rotation @ across).ravel()
        row["position"] = place.translation
        row["shift"] = place.rotation @ axis if slides else 0.0
        parent = int(robot.model.parents[j + 1]) - 1
        row["parent"] = robot.dof if parent < 0 else parent
        row["axis"], row["slides"] = 0.0 if slides else axis, slides
    return frozen(table)


def _axis(core: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Start, vector and radius of a bounding capsule of some points.

    The segment has the direction of the maximum spread of the points; its ends are moved inward by the radius.
    """
    middle = core.mean(axis=0)
    direction = np.linalg.svd(core - middle, full_matrices=False)[2][0]
    along = (core - middle) @ direction
    aside = core - middle - np.outer(along, direction)
    centre = 0.5 * (aside.min(axis=0) + aside.max(axis=0))
    radius = float(np.linalg.norm(aside - centre, axis=1).max())
    low, high = float(along.min()) + radius, float(along.max()) - radius
    if len(core) <= 2:
        low, high = float(along.min()), float(along.max())
    if low > high:
        low = high = 0.5 * (low + high)
    start = middle + centre + low * direction
    vector = (high - low) * direction
    length = high - low
    at = np.clip((core - start) @ direction, 0.0, length)
    needed = float(np.linalg.norm(core - start - np.outer(at, direction), axis=1).max())
    return start, vector, needed
