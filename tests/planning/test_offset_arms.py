"""An arm whose yaw axis stands off the origin, whose plane passes it, and whose links lie beside the plane."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from fitted_arms import Bodies

from hplan.errors import UnreachableError
from hplan.planning.plan import plan
from hplan.robot.family import ORCHARD_HARVESTER, write_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Fruit, Goal, Scene, Start
from hplan.scene.obstacles import Capsule

FRUIT = (0.5, 1.3, 1.2)

#: A trunk and two branches before the fruit, and a wire over the way.
BRANCHES = tuple(
    Capsule.model_validate({"name": name, "from": start, "to": end, "radius": radius})
    for name, start, end, radius in (
        ("trunk", (0.9, 1.4, 0.0), (0.9, 1.4, 2.0), 0.05),
        ("left", (0.9, 1.4, 0.9), (0.2, 1.1, 1.0), 0.02),
        ("right", (0.9, 1.4, 1.5), (0.3, 1.2, 1.6), 0.02),
        ("wire", (1.5, 0.4, 1.4), (-1.0, 0.9, 1.7), 0.005),
    )
)


@pytest.fixture(scope="module")
def aside(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    spec = replace(
        ORCHARD_HARVESTER, name="aside", yaw_axis=(0.3, -0.2), shoulder_offset=0.15, link_offsets=(0.06, -0.03, 0.0)
    )
    return load_robot(write_robot(spec, Path(tmp_path_factory.mktemp("arm")) / "aside.urdf")[0])


def scene_to(fruit: tuple[float, float, float]) -> Scene:
    return Scene(
        name="aside",
        start=Start(joints_deg=(-40.0, 70.0, -60.0, 0.0)),
        goal=Goal(fruit="apple"),
        clearance=0.003,
        obstacles=BRANCHES,
        fruits=(Fruit(name="apple", center=fruit, radius=0.035),),
    )


def test_a_fruit_is_picked_and_nothing_touched(aside: Robot) -> None:
    """By Pinocchio and coal, for everything that the URDF describes, at every other row."""
    result = plan(aside, scene_to(FRUIT))
    assert result.certificate.verified
    rows, model, data = result.trajectory.position, aside.model, aside.model.createData()
    tool, bodies = model.getFrameId(aside.tool_frame), Bodies(aside)
    away = []
    for q in rows:
        pin.framesForwardKinematics(model, data, q)
        away.append(np.linalg.norm(data.oMf[tool].translation - FRUIT))
    assert min(away) < 1e-6
    branches = []
    for branch in BRANCHES:
        start, end = np.array(branch.start), np.array(branch.end)
        length = np.linalg.norm(end - start)
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), (end - start) / length).matrix()
        branches.append((coal.Capsule(branch.radius, length), coal.Transform3s(turn, 0.5 * (start + end))))
    nearest = min(bodies.from_obstacles(q, branches) for q in rows[::2])
    assert 0.003 < nearest < 0.2
    assert nearest >= result.certificate.min_clearance_m
    assert min(bodies.distances(q).min(initial=np.inf) for q in rows[::2]) > 0.0


def test_a_fruit_at_the_yaw_axis_is_out_of_reach(aside: Robot) -> None:
    with pytest.raises(
        UnreachableError, match=r"nearer to the yaw axis than the arm plane, which passes that at 0\.15 m"
    ):
        plan(aside, scene_to((0.3, -0.15, 1.9)))
