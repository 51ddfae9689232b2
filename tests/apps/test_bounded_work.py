"""`certify` accepts any finite numbers, with time and memory linear in the samples."""

from __future__ import annotations

import time
import tracemalloc
import warnings
from dataclasses import replace

import numpy as np
import pytest

import hplan
from hplan.certificate import clearance_proof
from hplan.scene.obstacles import Sphere
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv


@pytest.fixture(scope="module")
def motion(robot, scene):
    return hplan.plan(robot, scene).trajectory


@pytest.fixture(autouse=True)
def quiet():
    """Silence NumPy's warnings about overflow."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def longer(motion, seconds):
    """The motion, then a pause at its end."""
    rows = (np.vstack([values, values[-1:]]) for values in (
        motion.position, motion.velocity, motion.acceleration, motion.torque
    ))  # fmt: skip
    return Trajectory(motion.joint_names, np.append(motion.time, motion.time[-1] + seconds), *rows)


def certified_as_required(*arguments, **options):
    begin = time.process_time()
    certificate = hplan.certify(*arguments, **options)
    assert time.process_time() - begin < 5.0
    return certificate


@pytest.mark.parametrize("value", [1e9, -1e300, 1.7e308])
@pytest.mark.parametrize("column", ["position", "velocity", "acceleration", "torque"])
def test_one_cell(robot, scene, motion, tmp_path, column, value):
    values = np.array(getattr(motion, column))
    values[100, 1] = value
    certificate = certified_as_required(
        robot, scene, read_csv(write_csv(replace(motion, **{column: values}), tmp_path / "t.csv"))
    )
    assert not certificate.verified
    said = {violation.split()[0] for violation in certificate.violations}
    assert {"position": "position", "velocity": "velocity"}.get(column, column) in said


def test_unboundable_speed_is_located(robot, scene, motion):
    velocity = np.array(motion.velocity)
    velocity[100, 1] = 1e300
    certificate = certified_as_required(robot, scene, replace(motion, velocity=velocity))
    assert any("from 0.396 s to 0.4 s the motion is too fast to be bounded" in text for text in certificate.violations)
    assert np.isfinite(certificate.min_clearance_m)


@pytest.mark.parametrize("seconds", [1e3, 1e6, 1e300])
def test_pause_is_verified(robot, scene, motion, seconds):
    tracemalloc.start()
    certificate = certified_as_required(robot, scene, longer(motion, seconds))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert certificate.verified, certificate.violations
    assert peak < 2e7


@pytest.mark.parametrize("gap", [1e-300, 1e-12, 1e-6])
def test_rows_hardly_apart(robot, scene, motion, gap):
    again = longer(motion, 1.0)
    time = np.array(again.time)
    time[200:] += gap - (time[200] - time[199])
    if not (np.diff(time) > 0.0).all():
        time[199], time[200] = 0.796, np.nextafter(0.796, 1.0)
        time[201:] = np.maximum(time[201:], time[200] + 4e-3 * np.arange(1, len(time) - 200))
    assert not certified_as_required(robot, scene, replace(again, time=time)).verified


def test_exhausted_budget_is_reported(robot, scene, monkeypatch):
    """A motion 0.1 mm from an obstacle, with distance queries every 50 um."""
    distance = 2.2 + 0.03 + 0.05 + 1e-4
    wall = [
        Sphere(name=f"bead {k}", center=(distance * np.cos(a), 0.0, 0.6 + distance * np.sin(a)), radius=0.05)
        for k, a in enumerate(np.linspace(0.3, 0.9, 7).tolist())
    ]
    rows = np.linspace(0.0, 1.0, 251)
    position, velocity = np.zeros((251, 4)), np.zeros((251, 4))
    position[:, 1] = 0.3 + 0.6 * rows
    velocity[:, 1] = 0.6
    swing = Trajectory(robot.joint_names, rows, position, velocity, 0 * position, 0 * position)
    world = scene.with_obstacles(wall)
    options = {"check_ends": False, "rest_to_rest": False}
    whole = certified_as_required(robot, world, swing, **options)
    assert whole.verified
    monkeypatch.setattr(clearance_proof, "CHECKS", 60)
    monkeypatch.setattr(clearance_proof, "CHECKS_PER_PIECE", 0)
    certificate = certified_as_required(robot, world, swing, **options)
    assert not certificate.verified
    assert certificate.violations[0].startswith("clearance is not proved after 0.")
    assert whole.checks > 60
    at = float(certificate.violations[0].split()[5])
    assert 0.0 < at < 1.0
    assert certificate.min_clearance_m == pytest.approx(1e-4, abs=1e-5)  # the minimum distance found, all the same


def test_time_grows_with_the_rows(robot, scene, motion):
    """A hundred times back and forth: 90,000 samples."""
    there = [motion, motion.reversal] * 100
    long = hplan.trajectory.trajectory.join_trajectories(there)
    certificate = certified_as_required(robot, scene, long, check_ends=False)
    assert certificate.verified
    assert certificate.checks < 100_000
