"""Arrays of a robot's bodies, joints and self-collision pairs, for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hplan.base.arrays import BoolArray, FloatArray, Record, TableArray, frozen
from hplan.collision.collision_bodies import GROUND, CollisionBody, ball_about, capsule_about, collision_bodies
from hplan.collision.motion_coefficients import carriers, is_moved, joint_axis, points_reach
from hplan.collision.self_folds import Fold, folds
from hplan.collision.self_pairs import required_distances, self_pairs
from hplan.geometry.convex_distance import corner_table
from hplan.robot.model import Robot, made_once
from hplan.robot.upright import UprightTool

#: Columns of a body: its joint (`dof` for the ground); offsets of the start and end of its points, and of their table
#: (`hplan.geometry.convex_distance`; 0 for none); its rounding radius; centre and radius of a bounding ball; start,
#: vector and radius of a bounding capsule; and whether it is checked against obstacles, because joints move it.
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
#:
#: The tilt of a tool axis is a pair, too: its distance is `tilt_m` [m/rad] times the angle that is left to `most_tilt`
#: [rad]. `axis` is the direction in the frame of the joint `carrier`, and `up` the one in `base_link` from which the
#: tilt is measured. `tilt_m` is 0 for pairs of bodies; both bodies of a tilt are the first one.
PAIR = np.dtype(
    [
        ("outer", np.int64),
        ("inner", np.int64),
        ("hull_distance", np.float64),
        ("ball_distance", np.float64),
        ("axis_distance", np.float64),
        ("tilt_m", np.float64),
        ("most_tilt", np.float64),
        ("carrier", np.int64),
        ("axis", np.float64, 3),
        ("up", np.float64, 3),
    ],
    align=True,
)

#: Distance that the whole permitted tilt counts as [m]: margins of a few millimetres are a few percent of it.
TILT_AS_M = 0.08

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
CAPSULE_COORDINATES = 6


@dataclass(frozen=True, eq=False)
class FlatBodies(Record):
    """Moving bodies of a robot as tables.

    Attributes:
        bodies: (bodies,) rows of `BODY`, in the order of `collision_bodies`, then the parts of neighbouring links that
            must not touch (`hplan.collision.self_folds`).
        pairs: (pairs,) rows of `PAIR`, the checked self-collision pairs, those of the parts last.
        joints: (dof,) rows of `JOINT`.
        reaches: (bodies + pairs, dof) motion-bound coefficients (`hplan.collision.motion_coefficients`).
        points: Coordinates of the points of all bodies, each with its table.
    """

    bodies: TableArray
    pairs: TableArray
    joints: TableArray
    reaches: FloatArray
    points: FloatArray

    @classmethod
    def build(
        cls, robot: Robot, own_clearance: float = 0.0, deviation: float = 0.0, upright: UprightTool | None = None
    ) -> FlatBodies:
        """Flatten the bodies of a robot.

        Args:
            robot: The robot.
            own_clearance: Required clearance of the self-collision pairs [m].
            deviation: Maximum deviation of every joint [rad, m]; bodies are grown by their displacement bound.
            upright: The tool axis that stays upright; None if the tool may tilt.
        """
        parts = folds(robot, deviation, own_clearance)
        still = robot.cache(("flat bodies", parts), lambda: _of_bodies(robot, parts))
        farthest = np.append(self_pairs(robot).farthest, [part.farthest for part in parts])
        kept = np.append(np.zeros(len(still.bodies)), required_distances(farthest, own_clearance))
        if upright is not None:
            still, kept = still._with_tilt(robot, upright), np.append(kept, 0.0)
        bodies, pairs = thicker(still.bodies, still.pairs, deviation * still.reaches.sum(axis=1) + kept)
        return replace(still, bodies=bodies, pairs=pairs)

    def _with_tilt(self, robot: Robot, upright: UprightTool) -> FlatBodies:
        """Return the bodies with the tilt of the tool as the last pair."""
        pairs, carrier = np.zeros(len(self.pairs) + 1, PAIR), robot.tool_joint - 1
        pairs[:-1], row = self.pairs, pairs[-1]
        row["tilt_m"], row["most_tilt"] = TILT_AS_M / upright.max_tilt_rad, upright.max_tilt_rad
        row["ball_distance"] = TILT_AS_M  # as near as bodies can be: the centres of both are one point
        row["carrier"] = robot.dof if carrier < 0 else carrier
        frame = robot.model.frames[robot.frame_number(robot.tool_frame)]
        row["axis"], row["up"] = frame.placement.rotation @ np.array(upright.axis), upright.up
        turns = np.zeros(robot.dof)
        turns[[joint for joint in carriers(robot, carrier) if not robot.slides[joint]]] = row["tilt_m"]
        return replace(self, pairs=frozen(pairs), reaches=frozen(np.vstack([self.reaches, turns])))

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


def _of_bodies(robot: Robot, parts: Sequence[Fold]) -> FlatBodies:
    """Bodies of a robot and parts of neighbours, and the checked pairs."""
    own = collision_bodies(robot)
    bodies = [*own, *(part.body for part in parts)]
    meets = np.append(is_moved(robot), np.zeros(len(parts), dtype=np.bool_))
    pairs = [*self_pairs(robot).checked, *((len(own) + k, part.other) for k, part in enumerate(parts))]
    return _flat(robot, bodies, meets, pairs)


def _flat(
    robot: Robot, bodies: Sequence[CollisionBody], meets: BoolArray, pairs: Sequence[tuple[int, int]]
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
        row["axis_start"], row["axis_vector"], radius = capsule_about(body.core)
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
