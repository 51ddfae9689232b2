"""What is compared with which effort."""

from __future__ import annotations

import math
from pathlib import Path

import hplan
from hplan.planning.options import PlanOptions
from hplan.robot.family import ArmSpec, write_robot
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere


def test_coarse_grids_that_are_too_large_are_left_out(tmp_path: Path) -> None:
    """A chain of six links that turn all around has no grid that fits."""
    six = (1.0,) * 6
    spec = ArmSpec(
        name="chain", link_lengths=(0.4,) * 6, link_half_widths=(0.01,) * 6, link_masses=six,
        lower=(-math.pi,) * 6, upper=(math.pi,) * 6, velocity=six, effort=(500.0,) * 6, acceleration=six, jerk=None,
        shoulder_height=3.0, has_yaw=False, base_mass=40.0, turret_mass=12.0,
    )  # fmt: skip
    write_robot(spec, tmp_path / "chain.urdf")
    robot = hplan.load_robot(tmp_path / "chain.urdf")
    scene = Scene(
        name="ball",
        start=Start(joints_rad=(0.5, 0.1, 0.1, 0.1, 0.1, 0.1)),
        goal=Goal(joints_rad=(-0.5, 0.1, 0.1, 0.1, 0.1, 0.1)),
        obstacles=(Sphere(name="ball", center=(2.2, 0.0, 2.6), radius=0.1),),
    )
    assert hplan.plan(robot, scene).motion.origin == "trees"


def test_another_seed_may_lead_to_another_motion_and_each_is_the_same_every_time(robot: Robot) -> None:
    ball = Sphere(name="ball", center=[1.6, 0.0, 1.6], radius=0.25)
    ends = {"start": Start(joints_rad=[0.0, 1.2, 0.3, 0.3]), "goal": Goal(joints_rad=[0.0, 0.1, 0.3, 0.3])}
    scene = Scene(name="ball", clearance=0.005, obstacles=[ball], **ends)
    found = [hplan.plan(robot, scene, PlanOptions(effort="quick", seed=seed)) for seed in (0, 1, 1)]
    assert all(result.certificate.verified for result in found)
    first, other, again = (result.certificate.digests for result in found)
    assert first != other == again
