"""Sequences of tool poses: continuous line and tilt constraints, and refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from any_arms import loaded_arm

import hplan
from hplan.base.arrays import FloatArray
from hplan.certificate.tool_bounds import tool_bounds
from hplan.errors import CertificationError, InputError, NotFoundError, NotInTimeError
from hplan.planning import pose_sequence
from hplan.planning.options import PlanOptions
from hplan.planning.pose_sequence import pose_matrices
from hplan.planning.result import PlanResult
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.robot.upright import UprightTool
from hplan.scene import Box, Goal, Scene, Sphere, Start
from hplan.scene.obstacles import Obstacle
from hplan.trajectory.trajectory import Trajectory

BEGIN = {"picker": (0.0, 0.3, 1.2, 0.1, -1.5, 0.0), "panda": (0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8)}
TILT = np.radians(10.0)


@pytest.fixture(params=list(BEGIN))
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return loaded_arm(request.param, tmp_path_factory)


def begin_of(robot: Robot) -> FloatArray:
    return np.array(BEGIN["panda" if robot.dof == 7 else "picker"])


def scene_of(robot: Robot, *obstacles: Obstacle, begin: FloatArray | None = None, **more: Any) -> Scene:
    start = Start(joints_rad=tuple((begin_of(robot) if begin is None else begin).tolist()))
    return Scene(name="poses", start=start, goal=Goal(joints_rad=start.joints_rad), obstacles=obstacles, **more)


def moved(pose: FloatArray, x: float, y: float, z: float, *, yaw: float = 0.0, lean: float = 0.0) -> FloatArray:
    """A pose shifted, turned about the vertical, tilted."""
    other = np.array(pose)
    other[:3, :3] = pin.rpy.rpyToMatrix(lean, 0.0, yaw) @ pose[:3, :3]
    other[:3, 3] += (x, y, z)
    return other


def seen(robot: Robot, result: PlanResult, poses: list[FloatArray], straight: list[bool]) -> list[tuple[float, float]]:
    """For each phase the largest distance from its line and the largest tilt, at many times."""
    begin, found = robot.forward_kinematics(result.trajectory.position[0]), []
    for number, phase in enumerate(result.phases):
        clock = np.linspace(phase.start_s, phase.end_s, 2_001)
        tool = robot.forward_kinematics(result.trajectory.positions(clock))
        assert np.abs(tool[-1] - poses[number]).max() < 1e-6
        first = (begin, *poses)[number][:3, 3]
        line = poses[number][:3, 3] - first
        along = np.clip((tool[:, :3, 3] - first) @ line / (line @ line), 0.0, 1.0)
        off = np.linalg.norm(tool[:, :3, 3] - first - along[:, None] * line, axis=1).max() if straight[number] else 0.0
        up = (tool[:, :3, :3] @ begin[2, :3])[:, 2]
        found.append((float(off), float(np.arccos(np.clip(up, -1.0, 1.0)).max())))
    return found


def test_lines_and_tilt_hold(arm: Robot) -> None:
    here = arm.forward_kinematics(begin_of(arm))
    poses = [moved(here, 0.0, 0.0, -0.12), moved(here, -0.1, 0.3, 0.0, yaw=0.8), moved(here, -0.1, 0.3, -0.1, yaw=1.0)]
    straight = [True, False, True]
    scene = scene_of(arm, Sphere(name="far", center=(-0.6, -0.6, 0.5), radius=0.1), clearance=0.002)
    result = hplan.plan_poses(arm, scene, poses, straight=straight, tilt_rad=TILT)
    assert result.certificate.verified
    assert hplan.certify(arm, result.scene, result.trajectory).verified
    told = result.report["poses"]["phases"]
    assert [phase["phase"] for phase in told] == ["pose 1", "pose 2", "pose 3"] == [p.name for p in result.phases]
    for (off, tilt), phase in zip(seen(arm, result, poses, straight), told, strict=True):
        assert off <= (phase["deviation_m"] or 0.0) <= 1e-3
        assert tilt <= np.radians(phase["tilt_deg"]) <= TILT


def test_trees_go_around_and_stay_upright(arm: Robot) -> None:
    here = arm.forward_kinematics(begin_of(arm))
    x, y, z = here[:3, 3]
    wall = Box(name="wall", center=(x, y + 0.2, z - 0.15), size=(0.5, 0.04, 0.4))
    pose = moved(here, 0.0, 0.4, 0.0)
    with pytest.raises(NotFoundError, match="straight"):
        hplan.plan_poses(arm, scene_of(arm, wall), [pose])
    result = hplan.plan_poses(arm, scene_of(arm, wall), [pose], straight=False, tilt_rad=TILT)
    ((_, tilt),) = seen(arm, result, [pose], [False])
    assert 0.0 < tilt <= np.radians(result.report["poses"]["phases"][0]["tilt_deg"]) <= TILT


@pytest.mark.parametrize(("name", "gain"), [("panda", 0.1), ("picker", 0.0)])
def test_upright_motions_are_made_quicker(tmp_path_factory: pytest.TempPathFactory, name: str, gain: float) -> None:
    arm = loaded_arm(name, tmp_path_factory)
    here = arm.forward_kinematics(begin_of(arm))
    height = 0.6 if name == "panda" else 0.4
    wall = Box(name="wall", center=here[:3, 3] + (0.0, 0.2, 0.5 * height - 0.35), size=(0.5, 0.04, height))
    pose = moved(here, 0.0, 0.4, 0.0)
    for seed in range(3):
        durations = []
        for objective in ("duration", "length"):
            options = PlanOptions(seed=seed, objective=objective)
            result = hplan.plan_poses(arm, scene_of(arm, wall), [pose], options, straight=False, tilt_rad=TILT)
            ((_, tilt),) = seen(arm, result, [pose], [False])
            assert tilt <= np.radians(result.report["poses"]["phases"][0]["tilt_deg"]) <= TILT
            durations.append(result.trajectory.duration)
        assert durations[0] <= (1.0 - gain) * durations[1]


def test_where_a_path_cannot_be_certified_another_one_is_taken(arm: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    certified, refused = pose_sequence._certify_leg, []

    def refusing_one(task: Any, leg: Any) -> Any:
        if not refused:
            refused.append(leg)
            raise CertificationError("refused")
        return certified(task, leg)

    monkeypatch.setattr(pose_sequence, "_certify_leg", refusing_one)
    pose = moved(arm.forward_kinematics(begin_of(arm)), 0.0, 0.3, 0.0)
    result = hplan.plan_poses(arm, scene_of(arm), [pose], straight=False, tilt_rad=TILT)
    assert result.certificate.verified
    assert refused


def test_without_a_tilt_a_motion_is_that_of_a_plan(arm: Robot) -> None:
    pose, scene = moved(arm.forward_kinematics(begin_of(arm)), -0.1, 0.3, 0.0, yaw=0.8), scene_of(arm)
    free, upright = (hplan.plan_poses(arm, scene, [pose], straight=False, tilt_rad=tilt) for tilt in (None, TILT))
    quaternion = tuple(pin.Quaternion(pose[:3, :3]).coeffs().tolist())
    goal = Goal(position=tuple(pose[:3, 3].tolist()), quaternion_xyzw=quaternion)
    planned = hplan.plan(arm, scene.model_copy(update={"goal": goal}))
    assert (free.trajectory.position == planned.trajectory.position).all()
    assert free.trajectory.duration <= upright.trajectory.duration


def test_locked_joint_stays_still(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("panda", tmp_path_factory)
    pose, name = moved(arm.forward_kinematics(begin_of(arm)), 0.0, 0.05, -0.05), arm.joint_names[2]
    result = hplan.plan_poses(arm, scene_of(arm, locked_joints=(name,)), [pose])
    assert np.ptp(result.trajectory.position[:, 2]) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_bounds_hold_between_rows(arm: Robot, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = begin_of(arm) + 0.05 * np.cumsum(rng.normal(size=(8, arm.dof)), axis=0)
    time = np.cumsum(np.append(0.0, rng.uniform(0.01, 0.08, 7)))
    motion = Trajectory(arm.joint_names, time, q, rng.normal(size=q.shape), *np.zeros((2, *q.shape)))
    direction, up = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    tool_axis = UprightTool(tuple(direction), tuple(up), np.pi)
    exact = tool_bounds(arm, motion, tool_axis, TrackingModel())
    tool = arm.forward_kinematics(motion.positions(np.linspace(0.0, time[-1], 4_001)))
    away, line = tool[:, :3, 3] - tool[0, :3, 3], tool[-1, :3, 3] - tool[0, :3, 3]
    along = np.clip(away @ line / (line @ line), 0.0, 1.0)
    off = np.linalg.norm(away - along[:, None] * line, axis=1).max()
    tilt = np.arccos(np.clip(tool[:, :3, :3] @ direction @ up, -1.0, 1.0)).max()
    assert off <= exact.deviation_m <= off + 0.05
    assert tilt <= exact.tilt_rad <= min(np.pi, tilt + 0.4)
    late = tool_bounds(arm, motion, tool_axis, TrackingModel(0.001, 0.002))
    assert late.deviation_m > exact.deviation_m + 0.001
    assert late.tilt_rad > exact.tilt_rad + 0.001 * arm.dof


def test_impossible_requests_are_refused(arm: Robot) -> None:
    begin = begin_of(arm)
    here, scene = arm.forward_kinematics(begin), scene_of(arm)
    tilted = moved(here, 0.0, 0.0, -0.05, lean=np.radians(12.0))
    with pytest.raises(InputError, match=r"poses\[1\]: tilted by 12 deg") as refused:
        hplan.plan_poses(arm, scene, [moved(here, 0.0, 0.0, -0.05), tilted], tilt_rad=TILT)
    assert refused.value.data["pose"] == 1
    with pytest.raises(NotFoundError, match="the straight line to pose 1"):
        hplan.plan_poses(arm, scene, [moved(here, 0.0, 0.0, 3.0)])
    with pytest.raises(CertificationError, match="from its line"):
        hplan.plan_poses(arm, scene, [moved(here, 0.0, 0.0, -0.05)], PlanOptions(tracking_error=0.01), deviation_m=1e-3)
    with pytest.raises(NotInTimeError):
        hplan.plan_poses(arm, scene, [moved(here, 0.0, 0.0, -0.05)], PlanOptions(deadline_s=1e-5))
    with pytest.raises(InputError, match="all"):
        hplan.plan_poses(arm, scene, [here])


@pytest.mark.parametrize(
    ("poses", "options"),
    [
        (np.eye(4), {}),
        ([], {}),
        ([2.0 * np.eye(4)], {}),
        ([np.eye(4)], {"straight": [True, False]}),
        ([np.eye(4)], {"straight": ["yes"]}),
        ([np.eye(4)], {"tilt_rad": 0.0}),
        ([np.eye(4)], {"deviation_m": -1.0}),
    ],
)
def test_wrong_values(tmp_path_factory: pytest.TempPathFactory, poses: Any, options: dict[str, Any]) -> None:
    arm = loaded_arm("picker", tmp_path_factory)
    with pytest.raises(InputError):
        hplan.plan_poses(arm, scene_of(arm), poses, **options)


def test_poses_of_a_file() -> None:
    turn = pin.rpy.rpyToMatrix(0.3, -0.4, 2.0)
    (pose,) = pose_matrices(np.array([[1.0, 2.0, 3.0, *pin.Quaternion(turn).coeffs()]]))
    assert pose[:3, :3] == pytest.approx(turn)
    assert pose[:3, 3].tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(InputError, match=r"pose 1: .* length 2"):
        pose_matrices(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]]))
