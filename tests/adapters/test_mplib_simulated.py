"""ManiSkill's tasks through mplib's calls, the motions run in MuJoCo.

Each task is written as ManiSkill's solutions are: a reaching motion to a pose, straight motions with the tool, and an
attached box for what is held. Poses are those that the arm can have with the tool pointing down. The simulated arm
follows the answers' samples at the control period, next to a table and the objects that stay.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import least_squares

from hplan.adapters import mplib
from hplan.base.arrays import FloatArray
from hplan.robot.files import named_robot
from hplan.robot.model import Robot
from hplan.scene import Box, Goal, Scene, Start

pytest.importorskip("mujoco", reason="MuJoCo is not installed (extra `execution`)")
cmeel: Any = pytest.importorskip("cmeel", reason="example-robot-data is not installed (extra `robots`)")
execution: Any = pytest.importorskip("hplan.apps.execution.simulated_arm")

SHARE = Path(cmeel.__path__[0]).parent / "cmeel.prefix" / "share" / "example-robot-data" / "robots"


class Arm(NamedTuple):
    """An arm, and where it works.

    Attributes:
        urdf: File below example-robot-data's robots; empty for the Panda.
        group: Link of the tool.
        reach: Distance from the base to the objects [m].
        forward: Direction from the base to the table, in degrees about z.
        home: Configuration from which the poses are sought.
        axis: Direction of the tool in the frame of the last joint, by the sign of its axis.
        tip: Distance of the tool's tip from the link's origin along the tool [m].
        cube: Edge of a cube [m].
    """

    urdf: str
    group: str
    reach: float
    forward: float
    home: tuple[float, ...]
    axis: float = 1.0
    tip: float = 0.0
    cube: float = 0.04


ARMS = {
    "panda": Arm("", "panda_hand_tcp", 0.5, 0.0, (0.0, 0.4, 0.0, -2.2, 0.0, 2.6, 0.785)),
    "xarm7": Arm("xarm_description/urdf/xarm7.urdf", "link_eef", 0.4, 0.0, (0.0, 0.2, 0.0, 1.2, 0.0, 1.0, 0.0)),
    "so100": Arm(
        "so_arm_description/urdf/so100.urdf", "gripper", 0.2, -90.0, (0.0, 1.6, -1.4, -1.4, 0.0), -1.0, 0.1, 0.02
    ),
}


@dataclass
class Bench:
    """A planner behind mplib's interface, the simulated arm, and the times of the calls.

    Attributes:
        arm: The arm.
        planner: Its planner.
        q: Present configuration.
        cpu_ms: CPU time of each call [ms].
        answers: The calls' answers.
    """

    arm: Arm
    planner: mplib.Planner
    q: FloatArray
    cpu_ms: list[float] = field(default_factory=list)
    answers: list[dict[str, Any]] = field(default_factory=list)

    @property
    def robot(self) -> Robot:
        return self.planner._full.robot

    def place(self, aside: float, height: float) -> FloatArray:
        """A point above the table, `aside` [m] across the reach, `height` [m] up, in the base frame."""
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(self.arm.forward))
        return np.asarray(turn @ [self.arm.reach, aside, height])

    def pose_over(self, point: FloatArray) -> FloatArray:
        """A pose with the tip at a point, and the tool down, as a row."""

        def off(q: FloatArray) -> FloatArray:
            tip, down, _ = self.tool(q)
            return np.concatenate([10.0 * (tip - point), down - [0.0, 0.0, -1.0], 1e-3 * (q - self.arm.home)])

        robot = self.robot
        found = least_squares(off, self.arm.home, bounds=(robot.lower, robot.upper), xtol=1e-14, ftol=1e-14)
        tip, down, pose = self.tool(found.x)
        assert np.linalg.norm(tip - point) < 2e-3
        assert down[2] < -0.999
        return np.concatenate([pose.translation, np.roll(pin.Quaternion(pose.rotation).coeffs(), 1)])

    def tool(self, q: FloatArray) -> tuple[FloatArray, FloatArray, pin.SE3]:
        """Tip, direction and pose of the tool."""
        robot = self.robot
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        pose = data.oMf[robot.model.getFrameId(robot.tool_frame, pin.FrameType.BODY)]
        last = robot.model.joints[robot.model.njoints - 1]
        down = self.arm.axis * (data.oMi[robot.model.njoints - 1].rotation @ joint_axis(last))
        return pose.translation + self.arm.tip * down, down, pose

    def move(self, point: FloatArray, *, straight: bool = False, **options: Any) -> None:
        """Plan to a point with the tool down, and go on from there."""
        row, call = self.pose_over(point), self.planner.plan_screw if straight else self.planner.plan_qpos_to_pose
        begin = time.thread_time()
        answer = call(row, self.q, time_step=execution.CONTROL_PERIOD, **options)
        self.cpu_ms.append(1e3 * (time.thread_time() - begin))
        assert answer["status"] == "Success", answer["status"]
        self.answers.append(answer)
        self.q = answer["position"][-1]


def joint_axis(joint: pin.JointModel) -> FloatArray:
    """The axis of a revolute joint in its frame."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq), np.ones(joint.nv))
    return np.asarray(data.S).reshape(6)[3:]


def bench_of(name: str) -> Bench:
    """A planner for an arm at home, with the table as points."""
    arm = ARMS[name]
    urdf = SHARE / arm.urdf if arm.urdf else named_robot("panda").urdf
    planner = planner_of(str(urdf), arm.group)
    bench = Bench(arm, planner, np.array(arm.home))
    planner.set_base_pose([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    side = 3.0 * arm.cube
    grid = np.stack(np.meshgrid(np.linspace(-side, side, 9), np.linspace(-2 * side, 2 * side, 17), [0.0]), axis=-1)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, np.radians(arm.forward))
    points = (grid.reshape(-1, 3) + np.array([arm.reach, 0.0, -0.02])) @ turn.T
    planner.update_point_cloud(points, radius=0.01)
    return bench


@cache
def planner_of(urdf: str, group: str) -> mplib.Planner:
    return mplib.Planner(urdf, group, package_keyword_replacement=str(SHARE.parents[1]))


def pick_cube(bench: Bench) -> Iterator[Box]:
    """Reach over a cube, go down, and carry it to a goal in the air."""
    cube, table = bench.arm.cube, bench.planner
    bench.move(bench.place(-2.0 * cube, 4.0 * cube), use_point_cloud=True)
    bench.move(bench.place(-2.0 * cube, 0.5 * cube), straight=True)
    table.update_attached_box([cube] * 3, held(bench))
    bench.move(bench.place(-2.0 * cube, 4.0 * cube), straight=True)
    bench.move(bench.place(2.0 * cube, 5.0 * cube), use_point_cloud=True, use_attach=True)
    return iter(())


def stack_cube(bench: Bench) -> Iterator[Box]:
    """Pick a cube and set it down on another one, which stays."""
    cube = bench.arm.cube
    pick_cube(bench)
    bench.move(bench.place(2.0 * cube, 1.6 * cube), straight=True)
    bench.move(bench.place(2.0 * cube, 4.0 * cube), straight=True)
    yield box_at(bench, "lower cube", bench.place(2.0 * cube, 0.5 * cube), (cube, cube, cube))


def insert_peg(bench: Bench) -> Iterator[Box]:
    """Pick a peg and lower it between two walls in three straight steps."""
    cube = bench.arm.cube
    pick_cube(bench)
    for height in (3.0, 2.4, 2.0):
        bench.move(bench.place(2.0 * cube, height * cube), straight=True)
    for number, side in enumerate((-1.0, 1.0)):
        at = bench.place((2.0 + 0.8 * side) * cube, 0.25 * cube)
        yield box_at(bench, f"wall {number}", at, (cube, 0.4 * cube, 0.5 * cube))


def held(bench: Bench) -> FloatArray:
    """Pose of a box about the tool's tip, in its link."""
    tip, _, pose = bench.tool(bench.q)
    at = pose.inverse() * pin.SE3(np.eye(3), tip)
    return np.concatenate([at.translation, np.roll(pin.Quaternion(at.rotation).coeffs(), 1)])


def box_at(bench: Bench, name: str, center: FloatArray, size: tuple[float, float, float]) -> Box:
    return Box(name=name, center=tuple(center.tolist()), size=size, rpy_deg=(0.0, 0.0, bench.arm.forward))


TASKS = {"PickCube": pick_cube, "StackCube": stack_cube, "PegInsertion": insert_peg}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ARMS)
def test_certified_motions_run_in_mujoco(name: str, task: str) -> None:
    bench = bench_of(name)
    boxes = list(TASKS[task](bench))
    boxes.append(box_at(bench, "table", bench.place(0.0, -0.02), (6.0 * bench.arm.cube, 12.0 * bench.arm.cube, 0.02)))
    assert all(answer["certificate"].verified for answer in bench.answers)
    first, last = (tuple(bench.answers[k]["position"][k].tolist()) for k in (0, -1))
    scene = Scene(name=task, start=Start(joints_rad=first), goal=Goal(joints_rad=last), obstacles=tuple(boxes))
    # The stiff loop makes up for the friction of the URDFs, which MuJoCo simulates.
    simulated = execution.SimulatedArm(bench.robot, scene, execution.Plant(bandwidth=150.0))
    simulated.place(first)
    for answer in bench.answers:
        for sample in zip(answer["position"], answer["velocity"], answer["acceleration"], strict=True):
            simulated.follow(*sample)
        here, there = (bench.tool(q)[0] for q in (simulated.position, answer["position"][-1]))
        assert np.linalg.norm(here - there) < 2e-3
    assert not simulated.contacts
