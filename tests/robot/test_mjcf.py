"""MuJoCo models, groups of SRDFs and robot_descriptions: the same robot as in MuJoCo and in the URDF."""

from __future__ import annotations

import sys
import types
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.apps.execution.simulation import execute
from hplan.base.arrays import FloatArray
from hplan.errors import InputError, OptionError, RobotFileError, RobotFileWarning
from hplan.planning.options import PlanOptions
from hplan.robot.inspection import inspect_robot, limits_template
from hplan.robot.mjcf import urdf_of_mjcf
from hplan.robot.model import Robot
from hplan.scene import Goal, Scene, Sphere, Start

mujoco = pytest.importorskip("mujoco")

#: Joints off their bodies' origins, two in one body, a reference angle, a mesh, all geoms.
ARM = """
<mujoco model="odd arm">
  <compiler angle="degree" eulerseq="xyz"/>
  <default>
    <joint armature="0.05" damping="1"/>
    <geom density="700"/>
    <default class="drawn"><geom contype="0" conaffinity="0"/></default>
  </default>
  <asset><mesh name="wedge" file="wedge.obj" scale="0.1 0.12 0.08"/></asset>
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    <body name="foot" pos="0.1 -0.2 0.05" euler="0 0 30">
      <geom type="box" size="0.1 0.1 0.05"/>
      <body name="column" pos="0 0 0.1">
        <joint name="rail" type="slide" axis="0 0.6 0.8" range="0 0.4" actuatorfrcrange="-400 400"/>
        <joint name="pan" axis="0 0 1" pos="0.02 0.03 0" range="-170 170" ref="20"/>
        <geom type="cylinder" size="0.05 0.1" pos="0 0 0.1"/>
        <geom class="drawn" type="sphere" size="0.06"/>
        <body name="upper" pos="0.05 0 0.25" quat="0.9 0.1 0.3 -0.2">
          <joint name="lift" axis="1 1 0" pos="0 0.01 -0.02" range="-100 90"/>
          <geom type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.03"/>
          <body name="lower" pos="0.28 0 0.1">
            <joint name="elbow" axis="0 1 0" range="-120 120"/>
            <geom type="mesh" mesh="wedge" pos="0.1 0.02 0" euler="10 20 30"/>
            <geom type="ellipsoid" size="0.02 0.03 0.05" pos="0.05 0 0"/>
            <body name="hand" pos="0.3 0 0" euler="0 90 0">
              <joint name="roll" axis="0 0 1"/>
              <geom type="box" size="0.03 0.03 0.02"/>
              <site name="tip" pos="0 0 0.15" euler="0 0 45"/>
              <body name="left" pos="0.03 0 0.05">
                <joint name="left_finger" type="slide" axis="1 0 0" range="0 0.04"/>
                <geom type="box" size="0.005 0.01 0.03"/>
              </body>
              <body name="right" pos="-0.03 0 0.05">
                <joint name="right_finger" type="slide" axis="-1 0 0" range="0 0.04"/>
                <geom type="box" size="0.005 0.01 0.03"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right_finger" joint2="left_finger" polycoef="0.001 0.9 0 0 0"/></equality>
  <actuator>
    <motor joint="pan" gear="50" ctrlrange="-2 2"/>
    <position joint="lift" kp="500" forcerange="-90 90"/>
    <general joint="elbow" forcerange="-60 60" biastype="affine"/>
    <motor joint="roll" forcerange="-12 12"/>
  </actuator>
</mujoco>
"""

WEDGE = """
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""

MOVING = ("rail", "pan", "lift", "elbow", "roll")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "wedge.obj").write_text(WEDGE)
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


def load(path: Path | str, **options: Any) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return hplan.load_robot(path, **options)


def state_of(model: Any, robot: Robot, q: FloatArray, others: dict[str, float]) -> Any:
    """MuJoCo's state with the robot's joints at q."""
    data = mujoco.MjData(model)
    values = dict(zip(robot.joint_names, q, strict=True)) | others
    for name, value in values.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    return data


def mass_matrix(model: Any, data: Any, names: tuple[str, ...]) -> FloatArray:
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    columns = [int(model.joint(name).dofadr[0]) for name in names]
    return whole[np.ix_(columns, columns)]


@pytest.mark.parametrize("finger", [0.0, 0.03])
def test_kinematics_and_mass_matrix_are_those_of_mujoco(file: Path, finger: float) -> None:
    robot, model = load(file, hold={"left_finger": finger}), mujoco.MjModel.from_xml_path(str(file))
    assert robot.joint_names == MOVING
    assert robot.tool_frame == "tip"
    rng, own = np.random.default_rng(1), robot.model.createData()
    for _ in range(40):
        q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi))
        data = state_of(model, robot, q, {"left_finger": finger, "right_finger": 0.001 + 0.9 * finger})
        for frame in ("foot", "column", "upper", "lower", "hand", "left", "right", "tip"):
            pose, there = robot.forward_kinematics(q, frame), data.site("tip") if frame == "tip" else data.body(frame)
            assert pose[:3, 3] == pytest.approx(there.xpos, abs=1e-12)
            assert pose[:3, :3].ravel() == pytest.approx(there.xmat, abs=1e-12)
        upper = np.triu(pin.crba(robot.model, own, q))
        assert upper + np.triu(upper, 1).T == pytest.approx(mass_matrix(model, data, MOVING), abs=1e-10)
        gravity = [data.qfrc_bias[int(model.joint(name).dofadr[0])] for name in MOVING]
        assert robot.dynamics.gravity(q[None])[0] == pytest.approx(gravity, abs=1e-9)


def test_limits_are_those_of_the_file(file: Path) -> None:
    robot = load(file)
    assert robot.torque_limit.tolist() == [400.0, 100.0, 90.0, 60.0, 12.0]
    assert robot.velocity_limit.tolist() == [0.1, 1.0, 1.0, 1.0, 1.0]
    assert robot.lower[1:4] == pytest.approx(np.radians([-170.0, -100.0, -120.0]))
    assert robot.continuous.tolist() == [False, False, False, False, True]
    assert [words.partition(" ")[0] for words in robot.assumptions] == ["velocity", "velocity", "it"]
    with pytest.warns(RobotFileWarning, match="velocity limits assumed: 0.1 per second for rail"):
        hplan.load_robot(file)


def test_shapes_are_where_mujoco_has_them(file: Path) -> None:
    """Centres of the shapes, and the corners of the mesh, are those of MuJoCo's geoms."""
    robot, model = load(file), mujoco.MjModel.from_xml_path(str(file))
    q = np.array([0.2, 0.4, -0.3, 0.5, 0.1])
    data = state_of(model, robot, q, {"right_finger": 0.001})
    placed = {}
    shapes, own = robot.collision_model, robot.model.createData()
    geometry = pin.GeometryData(shapes)
    pin.updateGeometryPlacements(robot.model, own, shapes, geometry, q)
    for number, shape in enumerate(shapes.geometryObjects):
        placed.setdefault(shape.name.rpartition("_")[0], []).append(geometry.oMg[number])
    for geom in range(model.ngeom):
        kind = int(model.geom_type[geom])
        name = model.body(int(model.geom_bodyid[geom])).name
        if kind in (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_MESH)) or not model.geom_contype[geom]:
            continue
        apart = [np.linalg.norm(place.translation - data.geom_xpos[geom]) for place in placed[name]]
        assert min(apart) < 1e-9, name
    mesh = next(shape for shape in shapes.geometryObjects if "wedge" in shape.meshPath)
    place = geometry.oMg[shapes.getGeometryId(mesh.name)]
    found = np.asarray(mesh.geometry.vertices()) @ place.rotation.T + place.translation
    number = int(np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))[0])
    first, count = int(model.mesh_vertadr[0]), int(model.mesh_vertnum[0])
    expected = model.mesh_vert[first : first + count] @ data.geom_xmat[number].reshape(3, 3).T + data.geom_xpos[number]
    for corner in expected:
        assert np.linalg.norm(found - corner, axis=1).min() < 1e-6


def test_plans_and_certificates(file: Path) -> None:
    robot = load(file)
    start, goal = (0.1, 0.0, -0.5, 0.5, 0.0), (0.3, 1.2, 0.3, -0.2, 0.4)
    middle = robot.forward_kinematics(0.5 * np.add(start, goal))[:3, 3]
    scene = Scene(
        name="odd",
        robot={"urdf": str(file)},
        start=Start(joints_rad=start),
        goal=Goal(joints_rad=goal),
        obstacles=(Sphere(name="ball", center=tuple(middle), radius=0.05),),
    )
    result = hplan.plan(robot, scene, PlanOptions(effort="quick"))
    assert result.certificate.verified
    assert result.report["assumptions"] == list(robot.assumptions)
    assert load(scene.robot).dof == 5
    executed = execute(robot, scene, result.trajectory)
    assert max(executed.max_tracking_error_rad) < 5e-3  # the rotors of the file turn with the simulated arm


def test_inspection_writes_limits(file: Path) -> None:
    found = inspect_robot(file)
    text = limits_template(found.name, found.urdf, found.joints)
    limits = file.with_name("mine.limits.yaml")
    limits.write_text(text)
    robot = load(file, limits=limits)
    assert robot.assumptions == ()


def test_command_line_takes_it(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hplan.apps.cli.main import main

    assert main(["inspect", str(file)]) == 0
    assert "elbow" in capsys.readouterr().out


def test_faults_are_named(tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = tmp_path / "broken.xml"
    broken.write_text(ARM.replace('mesh="wedge"', 'mesh="none"'))
    with pytest.raises(RobotFileError, match="MuJoCo refuses it"):
        load(broken)
    broken.write_text(ARM.replace('<motor joint="roll" forcerange="-12 12"/>', ""))
    with pytest.raises(RobotFileError, match="joint 'roll': no actuator gives its effort"):
        load(broken)
    broken.write_text(
        ARM.replace(
            '<joint name="pan" axis="0 0 1" pos="0.02 0.03 0" range="-170 170" ref="20"/>',
            '<joint name="pan" type="ball"/>',
        ).replace('<motor joint="pan" gear="50" ctrlrange="-2 2"/>', "")
    )
    with pytest.raises(RobotFileError, match="joint 'pan': it is a JointModelFreeFlyer"):
        load(broken)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(
        InputError, match=r"MJCF needs mujoco, which is not installed: pip install 'hplan\[execution\]'"
    ):
        load(file)


SRDF = """
<robot name="odd arm">
  <group name="arm"><chain base_link="column" tip_link="hand"/></group>
  <group name="listed"><joint name="lift"/><joint name="elbow"/><joint name="roll"/></group>
  <group name="whole"><group name="arm"/></group>
  <group name="gripper"><link name="left"/><link name="right"/></group>
  <group_state name="open" group="gripper"><joint name="left_finger" value="0.02"/></group_state>
  <group_state name="open" group="column"><joint name="pan" value="0.5"/></group_state>
  <group_state name="bad" group="gripper"><joint name="left_finger" value="wide"/></group_state>
</robot>
"""


@pytest.mark.parametrize(
    ("group", "joints", "tool"),
    [
        ("arm", ("lift", "elbow", "roll"), "hand"),
        ("whole", ("lift", "elbow", "roll"), "hand"),
        ("listed", ("lift", "elbow", "roll"), "hand"),
    ],
)
def test_groups_pick_the_joints(file: Path, group: str, joints: tuple[str, ...], tool: str) -> None:
    srdf = file.with_name("arm.srdf")
    srdf.write_text(SRDF)
    robot = load(file, srdf=srdf, group=group, group_state="open")
    assert robot.joint_names == joints
    assert robot.tool_frame == tool
    assert robot.held["left_finger"] == 0.02
    assert robot.held["pan"] == 0.5
    assert robot.held["rail"] == 0.0
    other = load(file, srdf=srdf, group=group, group_state="open", hold={"pan": 0.1}, tool_frame="tip")
    assert other.held["pan"] == 0.1
    assert other.tool_frame == "tip"
    model = mujoco.MjModel.from_xml_path(str(file))
    q = np.array([0.3, -0.4, 0.2])
    data = state_of(model, robot, q, {"rail": 0.0, "pan": 0.5})
    assert robot.forward_kinematics(q)[:3, 3] == pytest.approx(data.body("hand").xpos, abs=1e-12)


def test_wrong_groups_are_refused(file: Path) -> None:
    srdf = file.with_name("arm.srdf")
    srdf.write_text(SRDF.replace('tip_link="hand"', 'tip_link="hnd"'))
    for options, words in (
        ({"group": "arn"}, "group 'arn'"),
        ({"group": "gripper"}, "has link; expected one <chain>, or <joint>s"),
        ({"group": "arm"}, "names link 'hnd'"),
        ({"group_state": "close"}, "group state 'close'"),
        ({"group_state": "bad"}, "value of joint 'left_finger' is 'wide'"),
    ):
        with pytest.raises(RobotFileError, match=words):
            load(file, srdf=srdf, **options)
    with pytest.raises(OptionError, match="without an SRDF"):
        load(file, group="arm")


def test_robots_of_robot_descriptions(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"odd_description|robot_descriptions, which is not installed"):
        load("robot_descriptions:odd")
    package, module = types.ModuleType("robot_descriptions"), types.ModuleType("robot_descriptions.odd_mj_description")
    package.__path__ = []
    module.MJCF_PATH, module.PACKAGE_PATH = str(file), str(file.parent)
    monkeypatch.setitem(sys.modules, "robot_descriptions", package)
    monkeypatch.setitem(sys.modules, "robot_descriptions.odd_mj_description", module)
    for name in ("robot_descriptions:odd_mj", Path("robot_descriptions:odd_mj_description")):
        assert load(name).joint_names == MOVING


def test_efforts_are_those_of_the_weaker_direction(tmp_path: Path) -> None:
    """A URDF has one effort for both directions; an actuator of one direction only has none."""
    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco><worldbody><body name="a"><joint name="one" range="-1 1" actuatorfrcrange="-9 50"/>
        <geom type="sphere" size="0.1"/><body name="b" pos="0.5 0 0"><joint name="two" range="-1 1"/>
        <geom type="sphere" size="0.1"/><body name="c" pos="0.5 0 0"><joint name="three" range="-1 1"/>
        <geom type="sphere" size="0.1"/></body></body></body></worldbody>
        <actuator><motor joint="two" gear="2" forcerange="-30 8"/><motor joint="three" ctrlrange="0 7"/></actuator>
        </mujoco>"""
    )
    efforts = {
        joint.get("name"): float(limit.get("effort", "nan"))
        for joint in urdf_of_mjcf(file).iter("joint")
        for limit in joint.iter("limit")
    }
    assert efforts == {"one": 9.0, "two": 16.0, "three": 1.0}
    assert urdf_of_mjcf(file).assumed["three"] == ["velocity", "effort"]


def test_another_gravity_is_told(file: Path) -> None:
    file.write_text(ARM.replace("<default>", '<option gravity="0 0 -3.7"/><default>', 1))
    with pytest.warns(RobotFileWarning, match=r"option gravity 0 0 -3\.7 is not taken over: expected 0 0 -9\.81"):
        hplan.load_robot(file)
    assert not any("gravity" in assumption for assumption in load_text(file, ARM).assumptions)


def load_text(file: Path, text: str) -> Robot:
    file.write_text(text)
    return load(file)


def test_signed_distance_fields_are_refused_where_they_collide(file: Path) -> None:
    shape = '<geom name="blob" type="sdf" mesh="wedge"{}/><geom type="cylinder" size="0.05 0.1" pos="0 0 0.1"/>'
    plain = '<geom type="cylinder" size="0.05 0.1" pos="0 0 0.1"/>'
    with pytest.raises(RobotFileError, match="geom 'blob' is an sdf; expected primitives or a mesh"):
        load_text(file, ARM.replace(plain, shape.format("")))
    load_text(file, ARM.replace(plain, shape.format(' contype="0" conaffinity="0"')))
