"""Sequences of tool poses among random obstacles, the tool upright within 10 deg, straight and free in turn.

Each pose is taken by some clear configuration; whether there is a motion through all of them nobody knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
from studies.arms import random_scene, reach_of
from studies.harness import Asked, Row, Study
from studies.measure import or_error, outcome, ratio, timed
from studies.outside import TimedMotion, contacts

from hplan.base.arrays import FloatArray
from hplan.collision.coal_scene import CoalScene
from hplan.errors import HplanError
from hplan.kinematics.inverse_kinematics import inverse_kinematics
from hplan.planning.options import PlanOptions
from hplan.planning.pose_sequence import plan_poses
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.scene.model import Scene, Start

#: Poses of a sequence, how far the tool may tilt, and does at most at poses, and how far it may leave its lines.
POSES, TILT_RAD, LEAN_RAD, DEVIATION_M = 3, np.radians(10.0), np.radians(5.0), 1e-3

#: Which motions are straight, by the number of the sequence; lengths of these [m].
WAYS = ((False, True, True), (False, False, False), (False, True, False))
LENGTHS = (0.05, 0.25)

#: How far the tool turns on a straight line, at most [rad].
TURN_RAD = np.radians(45.0)

#: So many obstacles of each scene stay, the floor among them; clearance of poses and kept [m].
KEPT, CLEARANCE_M, FREE_M = 6, 0.002, 5e-3

#: Places of a motion that are looked at from outside.
LOOKS_HZ = 2_000.0


def sequence(robot: Robot, seed: int, number: int) -> tuple[Scene, FloatArray, tuple[bool, ...]]:
    """A scene with its start, (POSES, 4, 4) poses, and which motions are straight."""
    rng = np.random.default_rng([seed, number, 28])
    scene = random_scene(robot, seed, number)
    scene = scene.with_obstacles(scene.obstacles[:KEPT]).with_(clearance=CLEARANCE_M)
    checker, extent = CoalScene(robot, scene.solids), reach_of(robot, rng)
    ways = WAYS[number % len(WAYS)]
    while True:
        turn = pin.rpy.rpyToMatrix(np.pi - rng.choice([0.0, 0.5 * np.pi]), 0.0, 0.0)  # downwards, or level
        yaw = rng.uniform(-np.pi, np.pi)
        begin = _taken(robot, rng, checker, _pose(rng, turn, yaw, _place(rng, extent)))
        if begin is None:
            continue
        found = [robot.forward_kinematics(begin)]
        for straight in ways:
            for _ in range(20):
                place, turned = _place(rng, extent), rng.uniform(-np.pi, np.pi)
                if straight:
                    turned = yaw + TURN_RAD / np.pi * turned
                    away = place - found[-1][:3, 3]
                    place = found[-1][:3, 3] + away / np.linalg.norm(away) * rng.uniform(*LENGTHS)
                pose = _pose(rng, turn, turned, place)
                if _taken(robot, rng, checker, pose) is not None:
                    yaw = turned
                    found.append(pose)
                    break
        if len(found) == POSES + 1:
            start = Start(joints_rad=tuple(begin.tolist()))
            return scene.with_(start=start), np.array(found[1:]), ways


def _place(rng: np.random.Generator, extent: float) -> FloatArray:
    angle, far, height = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 0.75) * extent, rng.uniform(0.05, 0.6) * extent
    return np.array([far * np.cos(angle), far * np.sin(angle), height])


def _pose(rng: np.random.Generator, turn: FloatArray, yaw: float, place: FloatArray) -> FloatArray:
    """A pose at a place: a frame turned about the vertical, and tilted a little."""
    axis = np.append(rng.normal(size=2), 0.0)
    pose = np.eye(4)
    lean = pin.exp3(rng.uniform(0.0, 0.5 * LEAN_RAD) * axis / np.linalg.norm(axis))
    pose[:3, :3], pose[:3, 3] = lean @ pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ turn, place
    return pose


def _taken(robot: Robot, rng: np.random.Generator, checker: CoalScene, pose: FloatArray) -> FloatArray | None:
    """A clear configuration at a pose; None where none is found."""
    found = or_error(lambda: inverse_kinematics(robot, pose))
    if isinstance(found, HplanError):
        return None
    for q in rng.permutation(found):
        if (checker.pair_distances(q) - checker.kept(FREE_M) > 0.0).all():
            return np.array(q)
    return None


def tool_along(
    robot: Robot, start: FloatArray, motions: Sequence[TimedMotion], poses: FloatArray, ways: Sequence[bool]
) -> Row:
    """Largest tilt, distance from straight lines and from poses, by Pinocchio at many places of a motion to each."""
    data, model, frame = robot.model.createData(), robot.model, robot.frame_number(robot.tool_frame)

    def at(q: FloatArray) -> FloatArray:
        pin.framesForwardKinematics(model, data, q)
        return np.array(data.oMf[frame].homogeneous)

    begin = at(start)
    row = {"tilt_deg": 0.0, "off_line_mm": 0.0, "off_pose_mm": 0.0}
    places = [begin[:3, 3], *poses[:, :3, 3]]
    for number, motion in enumerate(motions, start=1):
        clock = np.linspace(0.0, motion.duration, max(3, int(LOOKS_HZ * motion.duration)))
        tool = np.array([at(q) for q in motion.positions(clock)])
        up = tool[:, :3, :3] @ begin[2, :3]
        row["tilt_deg"] = max(row["tilt_deg"], float(np.degrees(np.arccos(np.clip(up[:, 2], -1.0, 1.0))).max()))
        row["off_pose_mm"] = max(row["off_pose_mm"], 1e3 * float(np.linalg.norm(tool[-1, :3, 3] - places[number])))
        if ways[number - 1]:
            line = places[number] - places[number - 1]
            away = tool[:, :3, 3] - places[number - 1]
            along = np.clip(away @ line / (line @ line), 0.0, 1.0)
            off = np.linalg.norm(away - along[:, None] * line, axis=1)
            row["off_line_mm"] = max(row["off_line_mm"], 1e3 * float(off.max()))
    return row


def _sequence_row(asked: Asked, number: int) -> Row:
    robot = asked.arm("ur5")
    scene, poses, ways = sequence(robot, asked.seed, number)
    options = PlanOptions(effort=asked.effort)
    found, ms = timed(
        lambda: or_error(
            lambda: plan_poses(robot, scene, poses, options, straight=ways, tilt_rad=TILT_RAD, deviation_m=DEVIATION_M)
        )
    )
    row = outcome(found, ms) | {"name": f"poses {asked.seed}-{number}", "ways": f"{sum(ways)} of {POSES} straight"}
    row.pop("origin" if row["solved"] else "", None)
    if not isinstance(found, HplanError):
        row |= tool_along(robot, scene.start.configuration, _phases(found), poses, ways)
        told = found.report["poses"]["phases"]
        row["touches"] = any(contacts(robot, scene, found.trajectory))
        row["fault"] = bool(
            row["fault"] or row["touches"]
            or row["tilt_deg"] > max(phase["tilt_deg"] for phase in told)
            or row["off_line_mm"] > 1e3 * max([phase["deviation_m"] or 0.0 for phase in told])
            or row["tilt_deg"] > np.degrees(TILT_RAD) or row["off_line_mm"] > 1e3 * DEVIATION_M
        )  # fmt: skip
    if asked.peer is not None:
        row |= _peer_row(asked, robot, scene, poses, ways, row.get("duration_s"))
    return row


def _phases(found: PlanResult) -> list[TimedMotion]:
    """The motion to each pose."""

    def from_start_of(begin_s: float) -> Callable[[FloatArray], FloatArray]:
        return lambda t: found.trajectory.positions(begin_s + t)

    return [TimedMotion(phase.end_s - phase.start_s, from_start_of(phase.start_s)) for phase in found.phases]


def _peer_row(
    asked: Asked, robot: Robot, scene: Scene, poses: FloatArray, ways: Sequence[bool], duration_s: float | None
) -> Row:
    """What a peer makes of a sequence; roboplan has roll and pitch, within the half-width of the square in the tilt."""
    start, seed, within = scene.start.configuration, asked.seed + 1, TILT_RAD - 0.5 * LEAN_RAD
    if asked.peer == "roboplan":
        from studies.roboplan_peer import RoboplanArm

        arm = or_error(lambda: RoboplanArm(robot, scene, seed))
        if isinstance(arm, HplanError):  # clouds
            return {"peer_solved": None}
        motions, ms = timed(lambda: arm.pose_motions(start, poses, ways, within / np.sqrt(2.0)))
    else:
        from studies.projected_peer import projected_motions

        motions, ms = timed(lambda: projected_motions(robot, scene, poses, ways, TILT_RAD, seed))
    if motions is None:
        return {"peer_solved": False, "peer_ms": ms}
    told = tool_along(robot, start, motions, poses, ways)
    return {
        "peer_solved": True,
        "peer_ms": ms,
        "to_peer": ratio(duration_s, sum(motion.duration for motion in motions)),
        "peer_tilt_deg": told["tilt_deg"],
        "peer_off_line_mm": told["off_line_mm"],
        "peer_touches": any(any(contacts(robot, scene, motion)) for motion in motions),
    }


POSE_SEQUENCES = Study(
    "poses",
    "sequences of poses, the tool upright within 10 deg, and within 1 mm of straight lines",
    _sequence_row,
    (
        *("certified", "ms", "duration_s", "origin", "tilt_deg", "off_line_mm", "off_pose_mm", "touches"),
        *("peer_solved", "peer_ms", "to_peer", "peer_tilt_deg", "peer_off_line_mm", "peer_touches"),
    ),
    by="ways",
    count=(100, 3),
    peers=("RRTConnect", "roboplan"),
    warm=3,
)
