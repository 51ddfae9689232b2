"""What an arm's optimisation leaves out: steps that gain nothing, rows that cannot matter, pieces that meet at rows."""

from __future__ import annotations

import numpy as np
import pytest
from any_arms import loaded_arm

from hplan.base.arrays import FloatArray
from hplan.collision.clearance_field import ClearanceField
from hplan.optimization.coarse_profile import coarse_profile
from hplan.optimization.first_order import MotionArrays, MotionLimits, first_order
from hplan.optimization.minimize_time import minimize_time, rough_motion
from hplan.optimization.time_problem import TimeProblem
from hplan.planning.effort import EFFORTS_OF_BODIES
from hplan.planning.motion import motion_limits, smoothing_options
from hplan.planning.options import PlanOptions
from hplan.planning.task import PlanningCache, PlanningTask
from hplan.scene.model import Scene
from hplan.scene.obstacles import Sphere
from hplan.trajectory.speed_profile import SpeedProfile
from hplan.trajectory.spline import SplinePath

DEFAULT = EFFORTS_OF_BODIES["default"].starts
assert DEFAULT is not None
EFFORT = DEFAULT.optimization


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> PlanningTask:
    arm = loaded_arm("toy", tmp_path_factory)
    ends = {key: {"joints_rad": place} for key, place in (("start", (0.3,) * arm.dof), ("goal", (1.2,) * arm.dof))}
    scene = Scene.model_validate({"format": "hplan-scene/1", "name": "nothing", "obstacles": (), **ends})
    context = PlanningCache(arm).context(scene, PlanOptions())
    return context.task(scene.start.configuration, scene.goal.configuration)


def problem_of(task: PlanningTask) -> TimeProblem:
    options, robot = smoothing_options(task, task.margin()), task.robot
    return TimeProblem(task.field, task.field, options, motion_limits(task), robot.dynamics, task.options.rate_hz)


def bent(task: PlanningTask, seed: int) -> SpeedProfile:
    """A start that is a detour."""
    ends: FloatArray = np.linspace(task.problem.start, task.problem.goal, 7)
    ends[1:-1] += np.random.default_rng(seed).uniform(-0.3, 0.3, ends[1:-1].shape)
    return coarse_profile(SplinePath.through(ends), smoothing_options(task, task.margin()))


@pytest.mark.parametrize("seed", [1, 2])
def test_no_motion_falls_below_what_its_pieces_allow(task: PlanningTask, seed: int) -> None:
    problem, turn = problem_of(task), task.problem.goal - task.problem.start
    rough = rough_motion(bent(task, seed), problem, EFFORT)
    assert rough is not None
    found = minimize_time(bent(task, seed), problem, EFFORT, rough=rough)
    assert found is not None
    for spline, level in zip((rough, found), EFFORT.levels, strict=True):
        least = problem.least_duration(turn, len(spline.control) - 3)
        assert least <= spline.duration * (1.0 + 1e-6)
        assert spline.duration <= (1.0 + 2.0 * level.enough) * least + 1.0 / problem.rate_hz
    assert problem.least_duration(turn, 20) > problem.least_duration(turn, 50) > 0.0


def test_rows_that_cannot_be_active_are_left_out(tmp_path_factory: pytest.TempPathFactory) -> None:
    arm = loaded_arm("toy", tmp_path_factory)
    ball = Sphere(name="ball", center=(0.5, 0.1, 0.6), radius=0.1)
    field = ClearanceField.of(arm, [ball])
    generator = np.random.default_rng(5)
    control = np.cumsum(generator.uniform(-0.02, 0.1, (17, arm.dof)), axis=0)
    control[:3], control[-3:] = control[2], control[-3]
    motion = MotionArrays(control, np.concatenate([np.zeros(3), np.linspace(0.0, 1.2, 15), [1.2] * 3]), 0.0 * control)
    rates = np.stack([arm.velocity_limit, arm.acceleration_limit, np.full(arm.dof, 1e4)])
    limits = MotionLimits(np.array(arm.lower), np.array(arm.upper), rates, np.arange(arm.dof), np.empty((0, arm.dof)))

    def clearance_rows(trust: float) -> dict[tuple[float, ...], tuple[float, float]]:
        rows = first_order(motion, limits, field.arrays, 2e-3, trust)
        spans = [slice(*rows.starts[row : row + 2]) for row in range(len(rows.lower), len(rows.upper))]
        sides = rows.upper[len(rows.lower) :].tolist()
        keys = [(*rows.columns[span].tolist(), *rows.entries[span].tolist()) for span in spans]
        largest = [float(np.abs(rows.entries[span]).sum()) for span in spans]
        return dict(zip(keys, zip(sides, largest, strict=True), strict=True))

    whole = clearance_rows(10.0)
    for trust in (0.05, 0.2):
        kept = clearance_rows(trust)
        assert kept.items() <= whole.items()
        assert 0 < len(kept) < len(whole)
        assert all(largest * trust <= side for key, (side, largest) in whole.items() if key not in kept)
