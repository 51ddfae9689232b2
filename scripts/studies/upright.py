"""Motions of a UR5 and a Panda that keep the tool upright among random obstacles.

A problem has boxes, balls and capsules as the study `random`. Its ends are drawn uniformly from the joint ranges and
projected onto configurations in which an axis of the tool is vertical, tilted by up to `ENDS_DEG`; they are `FREE_M`
clear of everything. The goal is given as the pose of the tool there: of the configurations at a pose, only some can be
reached with the tool upright. The axis is z of the tool frame upside down, as of a hand that holds a tray from above,
or x of it, as of a hand that holds a cup from the side. Odd numbers are the Panda's.

The tilt is measured from outside: forward kinematics of Pinocchio at samples of 1 ms.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from studies.arms import _obstacles, _ranges, free_ends_of, reach_of, scene_between
from studies.harness import Row, Study, StudyConfig
from studies.measure import planned, ratio
from studies.outside import EVERY_S, contacts

from hplan.base.arrays import FloatArray
from hplan.kinematics.damped_steps import UPRIGHT, solve_all
from hplan.kinematics.inverse_kinematics import chain_of, with_direction
from hplan.planning.options import PlanOptions
from hplan.planning.pose_goal import goal_at
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Obstacle
from hplan.scene.upright import Upright
from hplan.trajectory.trajectory import Trajectory

#: The arms; axes that stay upright, in the tool frame; numbers of boxes, balls and capsules, in turn.
ARMS, AXES, KINDS = ("ur5", "panda"), ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0)), ((4, 4, 4, 0), (6, 0, 0, 0), (0, 8, 4, 0))

#: Maximum tilt of a motion, and of its ends [deg].
TILT_DEG, ENDS_DEG = 10.0, 5.0

#: Configurations drawn for the ends, before the obstacles are drawn again.
DRAWS = 200


def upright_scene(robot: Robot, seed: int, number: int) -> Scene:
    """The problem with a number."""
    rng = np.random.default_rng([seed, number])
    extent, axis = reach_of(robot, rng), AXES[number // len(ARMS) % len(AXES)]
    while True:
        obstacles = _obstacles(robot, rng, KINDS[number // 4 % len(KINDS)], extent)
        ends = _upright_ends(robot, rng, obstacles, extent, axis)
        if ends is not None:
            scene = scene_between(f"upright {robot.name} {seed}-{number}", *ends, obstacles)
            goal = goal_at(robot.forward_kinematics(ends[1]))
            return scene.with_values(goal=goal, upright=Upright(max_tilt_deg=TILT_DEG, axis=axis))


def _upright_ends(
    robot: Robot, rng: np.random.Generator, obstacles: list[Obstacle], extent: float, axis: tuple[float, float, float]
) -> tuple[FloatArray, FloatArray] | None:
    """(dof,) start and goal, upright and clear of obstacles; None if too few draws are."""
    chain = with_direction(chain_of(robot, np.eye(4), UPRIGHT), np.array(axis))
    chain = chain._replace(free_turn=np.array([UPRIGHT, np.radians(ENDS_DEG)]))
    drawn = rng.uniform(*_ranges(robot), (DRAWS, robot.dof))
    upright, found = np.empty(drawn.shape), np.zeros(DRAWS, dtype=np.bool_)
    solve_all(drawn, chain, upright, found)
    low, high = _ranges(robot)
    upright = upright[found]
    inside = ((upright >= low) & (upright <= high)).all(axis=1)
    return free_ends_of(robot, upright[inside], obstacles, extent)


def largest_tilt_deg(robot: Robot, scene: Scene, motion: Trajectory) -> float:
    """Largest tilt at samples of 1 ms, by Pinocchio [deg]."""
    clock = np.append(np.arange(0.0, motion.duration, EVERY_S), motion.duration)
    data, frame, largest = robot.model.createData(), robot.model.getFrameId(robot.tool_frame), 0.0
    axis = np.array([0.0, 0.0, 1.0] if scene.upright is None else scene.upright.axis)
    for q in motion.positions(clock):
        pin.framesForwardKinematics(robot.model, data, q)
        up = data.oMf[frame].rotation @ (axis / np.linalg.norm(axis))
        largest = max(largest, float(np.arctan2(np.hypot(up[0], up[1]), up[2])))
    return float(np.degrees(largest))


def _row(config: StudyConfig, number: int) -> Row:
    """Upright and free motions of one problem."""
    robot = load_robot(ARMS[number % len(ARMS)])
    scene = upright_scene(robot, config.seed, number)
    found, row = planned(robot, scene, PlanOptions(effort=config.effort))
    free, plain = planned(robot, scene.with_values(upright=None), PlanOptions(effort=config.effort))
    row |= {"name": scene.name, "arm": robot.name, "free_certified": plain["certified"]}
    row |= {"free_ms": plain["ms"], "to_free": ratio(row.get("duration_s"), plain.get("duration_s"))}
    if free is not None:
        row["free_tilt_deg"] = largest_tilt_deg(robot, scene, free.trajectory)
    if found is not None:
        row["tilt_deg"] = largest_tilt_deg(robot, scene, found.trajectory)
        row["bound_deg"] = float(np.degrees(found.certificate.max_tilt_rad or np.inf))
        row["contacts"] = sum(contacts(robot, scene, found.trajectory))
        row["fault"] |= row["contacts"] > 0 or not row["tilt_deg"] <= row["bound_deg"] <= TILT_DEG
    return row


STUDY = Study(
    "upright",
    f"motions of UR5 and Panda among obstacles that tilt the tool by at most {TILT_DEG:g} deg, by Pinocchio at 1 ms",
    _row,
    (
        *("certified", "ms", "duration_s", "to_free", "tilt_deg", "bound_deg", "contacts", "origin"),
        *("free_certified", "free_ms", "free_tilt_deg"),
    ),
    by="arm",
    count=(300, 4),
    peers=(),
    warm=8,
)
