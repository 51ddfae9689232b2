"""General (non-planar) arms, and a planar one, by name.

Arms of example-robot-data are included if it is installed.
"""

from __future__ import annotations

import pytest
from toy_urdf import SIX_AXIS_LIMITS, seven_axis_arm, six_axis_arm, six_axis_picker

from hplan.errors import InputError, RobotFamilyError
from hplan.planar.family_reader import FAMILY
from hplan.robot.model import Robot, load_robot
from hplan.scene.fruit import Fruit
from hplan.scene.obstacles import Box, Capsule, Cylinder, Solid, Sphere

#: Six and seven axes of simple shapes; joints that slide and turn; two of example-robot-data.
ARMS = ("toy", "seven", "lift", "panda", "ur5")

#: A trunk behind fruits that six and seven axes reach.
TRUNK = Capsule.model_validate(
    {"name": "trunk", "kind": "capsule", "from": (0.75, 0.0, -0.3), "to": (0.75, 0.1, 1.2), "radius": 0.04}
)
FRUITS = tuple(
    Fruit(name=f"apple {number}", center=center, radius=0.035)
    for number, center in enumerate([(0.5, 0.15, 0.5), (0.55, -0.2, 0.6), (0.5, 0.0, 0.35)])
)

#: Obstacles around an arm; it may touch some of them.
SOLIDS: tuple[Solid, ...] = (
    Sphere(name="ball", center=(0.5, 0.1, 0.6), radius=0.12),
    Capsule.model_validate({"name": "branch", "from": (0.2, -0.5, 0.2), "to": (0.7, -0.2, 0.9), "radius": 0.03}),
    Box(name="crate", center=(-0.4, 0.4, 0.5), size=(0.3, 0.2, 0.5), rpy_deg=(20.0, -30.0, 50.0)),
    Box(name="shelf", center=(0.0, 0.0, -0.3), size=(2.0, 2.0, 0.02)),
    Cylinder(name="post", center=(-0.5, -0.4, 0.4), length=0.8, radius=0.1, rpy_deg=(10.0, 20.0, 0.0)),
)

_KNOWN: dict[str, Robot] = {}


def limb(name: str, parent: str, kind: str, axis: str, xyz: str, shape: str, limit: str = "-2 2") -> str:
    low, high = limit.split()
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{xyz}" '
        f'rpy="0.3 -0.2 0.5"/><axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="1" effort="50" '
        f'acceleration="3"/></joint><link name="{name}_link"><inertial><origin xyz="0.05 0.02 0.1"/><mass value="1.5"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><origin xyz="0.05 0.02 0.1" rpy="0.1 0.4 0"/>'
        f"<geometry>{shape}</geometry></collision></link>"
    )


#: A lift that slides, a yaw on it, an arm that slides out, and a wrist.
LIFT = (
    '<robot name="lift"><link name="base_link"><collision><geometry><box size="0.3 0.3 0.1"/></geometry></collision>'
    "</link>"
    + limb("column", "base_link", "prismatic", "0 0 1", "0 0 0.1", '<box size="0.1 0.1 0.4"/>', "0 0.6")
    + limb("turn", "column_link", "revolute", "0 1 1", "0.1 0 0.2", '<sphere radius="0.08"/>')
    + limb("out", "turn_link", "prismatic", "1 0 0.2", "0.1 0 0", '<cylinder radius="0.04" length="0.3"/>', "-0.1 0.4")
    + limb("wrist", "out_link", "revolute", "0 1 0", "0.2 0.1 0", '<box size="0.05 0.1 0.2"/>')
    + '<joint name="flange" type="fixed"><parent link="wrist_link"/><child link="tool0"/></joint><link name="tool0"/>'
    "</robot>"
)


def link(name: str, parent: str, kind: str, axis: str, xyz: str, size: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="2" effort="500" acceleration="5"/></joint>'
        f'<link name="{name}_link"><inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" '
        f'ixz="0" iyz="0"/></inertial><collision><geometry><box size="{size}"/></geometry></collision></link>'
    )


#: A trolley on a rail along x, and a boom that turns on it; the static obstacles are far away.
GANTRY = (
    '<robot name="gantry"><link name="base_link"/>'
    + link("rail", "base_link", "prismatic", "1 0 0", "0 0 1", "0.1 0.1 0.1")
    + link("boom", "rail_link", "revolute", "0 0 1", "0 0 0.2", "0.3 0.05 0.05")
    + '<joint name="flange" type="fixed"><parent link="boom_link"/><child link="tool0"/></joint><link name="tool0"/>'
    "</robot>"
)


def loaded_arm(name: str, folders: pytest.TempPathFactory) -> Robot:
    """A robot by name, read once: one of `ARMS`, `picker`, six axes with a tool of some length, or `capsules`."""
    if name not in _KNOWN:
        if name in ("toy", "picker"):
            path = folders.mktemp(name) / "six.urdf"
            path.write_text(six_axis_arm() if name == "toy" else six_axis_picker())
            path.with_suffix(".limits.yaml").write_text(SIX_AXIS_LIMITS)
            _KNOWN[name] = load_robot(path)
        elif name == "capsules":
            # The harvester as any other arm: tubes with balls at their ends.
            _KNOWN[name] = robot = load_robot()
            robot.cache(FAMILY, lambda: RobotFamilyError(robot.name, "robot", "to be of no family"))
        elif name in ("lift", "seven"):
            _KNOWN[name] = load_robot(LIFT if name == "lift" else seven_axis_arm())
        else:
            try:
                _KNOWN[name] = load_robot(name)
            except InputError as error:
                if error.data.get("extra") != "robots":
                    raise
                pytest.skip("example-robot-data is not installed (extra `robots`)")
    return _KNOWN[name]
