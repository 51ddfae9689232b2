"""Real-world URDFs: an adapted robot equals its plain URDF, or is refused."""

from __future__ import annotations

import math
import re
import shutil
import struct
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import hplan
from hplan.apps.cli.main import main
from hplan.base.data_files import urdf_dir
from hplan.certificate.certificate import certify
from hplan.certificate.digests import robot_digest
from hplan.errors import InputError, JointLimitError, RobotFamilyError, RobotFileError, RobotFileWarning
from hplan.planar.family_reader import family_of
from hplan.robot.model import Robot, load_robot
from hplan.robot.urdf_adaptation import CONTINUOUS_RANGE
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere

SHIPPED = (urdf_dir() / "harvester.urdf").read_text()
LIMITS = urdf_dir() / "harvester.limits.yaml"
TAU = math.tau
CONTINUOUS = ('name="base_yaw" type="revolute"', 'name="base_yaw" type="continuous"')

BODY = (
    '<inertial><origin xyz="0.03 0.01 0"/><mass value="{mass}"/><inertia ixx="1e-3" ixy="0" ixz="0" iyy="2e-3" '
    'iyz="0" izz="2e-3"/></inertial><collision><origin xyz="0.03 0 0"/><geometry><box size="0.06 0.01 0.02"/>'
    "</geometry></collision>"
)
JOINT = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>{4}</joint>'
RANGE = '<limit lower="0.01" upper="0.05" velocity="0.1" effort="5"/>'
FINGERS = (
    f'<link name="left">{BODY.format(mass=0.7)}</link><link name="right">{BODY.format(mass=0.4)}</link>'
    + JOINT.format(
        "grip", "prismatic", "hand", "left", f'<origin xyz="0.35 0 0" rpy="0.4 0 0"/><axis xyz="0 2 0"/>{RANGE}'
    )
    + JOINT.format(
        "grip_too",
        "prismatic",
        "hand",
        "right",
        f'<origin xyz="0.35 0 0"/><axis xyz="0 1 0"/>{RANGE}<mimic joint="grip" multiplier="-1.5" offset="0.001"/>',
    )
)
CAMERA = f'<link name="camera">{BODY.format(mass=2)}</link>' + JOINT.format(
    "pan", "revolute", "turret", "camera",
    '<origin xyz="0.02 0.03 0.5" rpy="0.3 0.2 0.1"/><axis xyz="1 2 -1"/>'
    '<limit lower="-2" upper="2" velocity="1" effort="5"/>',
)  # fmt: skip
WORLD = '<link name="world"/>' + JOINT.format(
    "mount", "fixed", "world", "base_link", '<origin xyz="3 -2 0.5" rpy="0 0 0.7"/>'
)

LIFT = WORLD.replace('"fixed"', '"prismatic"').replace("</joint>", f'<axis xyz="0 0 1"/>{RANGE}</joint>')


def edited(*edits: tuple[str, str], more: str = "") -> str:
    text = SHIPPED
    for old, new in edits:
        assert old in text
        text = text.replace(old, new, 1)
    return text.replace("</robot>", f"{more}</robot>")


@pytest.fixture
def load(tmp_path):
    def load_text(text: str, **options) -> Robot:
        path = tmp_path / "robot.urdf"
        path.write_text(text, encoding="utf-8")
        shutil.copy(LIMITS, tmp_path / "robot.limits.yaml")
        return load_robot(path, **options)

    return load_text


@pytest.fixture(scope="module")
def plain():
    return load_robot()


def whole_model(text: str) -> pin.Model:
    """All joints as read by Pinocchio, mimic joints included."""
    return pin.buildModelFromXML(re.sub("<mimic [^>]*/>", "", text))


def assert_is_part_of(robot: Robot, text: str) -> None:
    """Torques and link poses equal the whole model's with its other joints held."""
    whole, rng = whole_model(text), np.random.default_rng(3)
    data, part = whole.createData(), robot.model.createData()
    own = [whole.joints[whole.getJointId(name)].idx_v for name in robot.joint_names]
    for _ in range(20):
        q, v, a = rng.uniform(-1.0, 1.0, (3, robot.dof))
        full = np.zeros((3, whole.nv))
        full[:, own] = q, v, a
        for name, value in robot.held.items():
            full[0, whole.joints[whole.getJointId(name)].idx_q] = value
        torque = robot.dynamics.torques(q[None], v[None], a[None])[0]
        np.testing.assert_allclose(torque, pin.rnea(whole, data, *full)[own], rtol=1e-12, atol=1e-11)
        pin.framesForwardKinematics(whole, data, full[0])
        pin.framesForwardKinematics(robot.model, part, q)
        for frame in robot.model.frames:
            if frame.type == pin.FrameType.BODY:
                there = data.oMf[whole.getFrameId(frame.name, pin.FrameType.BODY)]
                here = part.oMf[robot.model.getFrameId(frame.name, pin.FrameType.BODY)]
                np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-14)


# Shipped robots


def test_shipped_robots_are_not_changed(plain):
    """Read by Pinocchio from the file itself, with the digest of all frames and shapes that it has there."""
    assert plain.urdf_text is None
    assert not plain.held
    assert not plain.continuous.any()
    assert robot_digest(plain) == "sha256:a15767b8f996b98196c459d32ee20f8ffd07c2285c13d6d9af02399d4658bfd5"


# Fixed joints


def test_fingers_are_held_with_their_mass_and_shapes(load, plain):
    text = edited(more=FINGERS)
    robot = load(text)
    # At the limit nearest to 0, and as it mimics.
    assert robot.held == {"grip": 0.01, "grip_too": pytest.approx(-0.014)}
    assert robot.joint_names == plain.joint_names
    np.testing.assert_array_equal(family_of(robot).arm.lengths, family_of(plain).arm.lengths)
    assert_is_part_of(robot, text)
    # Corners of the boxes: 0.35 to 0.41 m along the hand of 0.4 m, 5 mm beyond the finger, 10 mm high.
    assert family_of(robot).arm.half_widths.tolist() == pytest.approx([0.05, 0.04, 0.03], rel=1e-12)
    wide = load(text, hold={"grip": 0.05})
    assert wide.held == {"grip": 0.05, "grip_too": pytest.approx(-0.074)}
    # One reaches 79 mm to one side, the other, which is turned, about 50 mm to the other: the capsule is between.
    beside = abs(float(family_of(wide).arm.lateral[2]))
    assert beside == pytest.approx(0.012, abs=3e-3)
    assert family_of(wide).arm.half_widths[2] == pytest.approx(math.hypot(0.01, 0.01, 0.079 - beside), rel=1e-6)
    assert_is_part_of(wide, text)


def test_turned_side_branch(load, plain):
    text = edited(more=CAMERA)
    for value in (0.0, 0.7, -1.9):
        robot = load(text, hold={"pan": value})
        assert robot.held == {"pan": value}
        assert_is_part_of(robot, text)
        np.testing.assert_array_equal(family_of(robot).arm.half_widths, family_of(plain).arm.half_widths)
        assert len(robot.collision_model.geometryObjects) == len(plain.collision_model.geometryObjects) + 1


@pytest.mark.parametrize("options", [{"hold": {"wrist": 0.5}}, {"joints": ["base_yaw", "shoulder", "elbow"]}])
def test_joint_of_the_chain_is_held(load, options):
    robot = load(SHIPPED, **options)
    bend = options.get("hold", {}).get("wrist", 0.0)
    assert robot.joint_names == ("base_yaw", "shoulder", "elbow")
    assert robot.held == {"wrist": bend}
    assert family_of(robot).arm.lengths[1] == pytest.approx(abs(0.8 + 0.4 * np.exp(1j * bend)), rel=1e-14)
    assert_is_part_of(robot, SHIPPED)


def test_joints_beyond_the_tool_are_held(load):
    """The tool frame is on the forearm, or the shoulder is no part of the chain: refused before."""
    inner = load(
        edited(('<parent link="hand"/>\n    <child link="tool0"/>', '<parent link="forearm"/><child link="tool0"/>'))
    )
    assert (inner.joint_names[-1], inner.held) == ("elbow", {"wrist": 0.0})
    aside = load(edited(('<parent link="upper_arm"/>', '<parent link="turret"/>')))
    assert (aside.joint_names, aside.held) == (("base_yaw", "elbow", "wrist"), {"shoulder": 0.0})


MIMIC = ('<limit effort="30"', '<mimic joint="elbow"/><limit effort="30"')
REFUSED = {
    "no such joint held": (SHIPPED, {"hold": {"knee": 0.0}}, InputError, "no moving joint 'knee'; it has base_yaw"),
    "held and moved": (SHIPPED, {"hold": {"wrist": 0.0}, "joints": ["wrist"]}, InputError, "both move and be held"),
    "held outside": (SHIPPED, {"hold": {"wrist": 2.0}}, JointLimitError, "hold: joint 'wrist' is at 2 rad"),
    "another order": (SHIPPED, {"joints": ["elbow", "shoulder"]}, InputError, "the robot's order: shoulder, elbow"),
    "a finger that leads": (edited(more=FINGERS), {"joints": ["grip"]}, RobotFileError, "mimics it and would"),
    "a follower held": (edited(more=FINGERS), {"hold": {"grip_too": 0.0}}, InputError, "mimics 'grip'; hold that"),
    "a follower in the chain": (edited(MIMIC), {}, RobotFileError,
        "joint 'wrist' mimics another joint; every joint must move by itself, but hold={'elbow': 0.0} "
        "(--hold elbow=0) locks it and this joint"),
    "a leader in the chain": (
        edited(more=FINGERS.replace('mimic joint="grip"', 'mimic joint="wrist"')), {}, RobotFileError,
        "joint 'wrist': joint 'grip_too' mimics it and would have to move with it; hold={'wrist': 0.0}",
    ),
    "mimics nothing": (
        edited(more=FINGERS.replace('mimic joint="grip"', 'mimic joint="gripper"')), {}, RobotFileError,
        "mimics 'gripper', which is not a moving joint",
    ),
    "roll in the chain": (
        edited(('<axis xyz="0 -1 0"/>\n    <limit effort="30"', '<axis xyz="1 0 0"/>\n    <limit effort="30"')), {},
        RobotFamilyError, "joint 'wrist': it is not parallel to joint 'shoulder'; hold={'wrist': 0.0}",
    ),
    "continuous, no velocity": (
        edited(CONTINUOUS, ('velocity="1.5"', "")), {}, RobotFileError,
        "joint 'base_yaw': it is continuous, and its <limit> has no velocity; a motion requires both",
    ),
    "moving base": (
        edited(more=LIFT), {}, RobotFileError,
        "joint 'mount': it is prismatic and carries 'base_link', the frame of scenes; only fixed joints may",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refusal_names_the_remedy(load, case):
    text, options, kind, message = REFUSED[case]
    with pytest.raises(kind) as caught:
        assert family_of(load(text, **options))
    assert type(caught.value) is kind
    assert message in str(caught.value)


def test_advice_works(load):
    """The advice of the messages above is accepted."""
    assert load(edited(MIMIC), hold={"elbow": 0.3}).held == {"elbow": 0.3, "wrist": 0.3}
    assert family_of(load(edited(CONTINUOUS, ('velocity="1.5"', "")), hold={"base_yaw": 1.0})).has_yaw is False
    lifted = load(edited(more=LIFT), hold={"mount": 0.02})
    assert lifted.held == {"mount": 0.02}
    base = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.7), np.array([3.0, -2.0, 0.52]))
    world = lifted.model.frames[lifted.model.getFrameId("world")].placement
    np.testing.assert_allclose(world.homogeneous, base.inverse().homogeneous, atol=1e-14)


def test_hanging_arm_is_in_frame_of_its_mount(load, plain):
    hanging = edited(more=WORLD.replace("0 0 0.7", f"{math.pi!r} 0 0"))
    with pytest.warns(RobotFileWarning, match=r"tilts 'base_link' by 180 deg; gravity pulls along -z of 'world', and"):
        robot = load(hanging)
    q = np.array([0.3, 0.5, 0.2, 0.4])
    there, here = robot.forward_kinematics(q), plain.forward_kinematics(q)
    np.testing.assert_allclose(there[:3, 3], np.array([3.0, -2.0, 0.5]) + here[:3, 3] * [1.0, -1.0, -1.0], atol=1e-12)
    # Gravity pulls the arm away from its base.
    zeros = np.zeros((1, 4))
    torque = robot.dynamics.torques(q[None], zeros, zeros)[0]
    np.testing.assert_allclose(torque, -plain.dynamics.torques(q[None], zeros, zeros)[0], atol=1e-9)


# The base turns on


def scene_of(start: tuple[float, ...], goal: tuple[float, ...]) -> Scene:
    return Scene(name="small", start=Start(joints_rad=start), goal=Goal(joints_rad=goal),
                 obstacles=(Sphere(name="ball", center=(-1.5, 0.0, 1.2), radius=0.3),))  # fmt: skip


def test_continuous_joint_has_a_turn_to_either_side(load, plain):
    robot = load(edited(CONTINUOUS))
    assert robot.continuous.tolist() == [True, False, False, False]
    assert (robot.lower[0], robot.upper[0]) == (-CONTINUOUS_RANGE, CONTINUOUS_RANGE)
    wide = load(SHIPPED.replace("3.141592653589793", repr(TAU)))
    assert robot_digest(robot) == robot_digest(wide)
    assert not wide.continuous.any()


@pytest.mark.parametrize(("lower", "upper"), [("-1e8", "1e8"), ("-1e16", "1.7976931348623157e308")])
def test_range_that_no_joint_has_is_that_of_a_continuous_joint(load, plain, lower, upper):
    one, other = 'lower="-3.141592653589793" upper="3.141592653589793"', f'lower="{lower}" upper="{upper}"'
    robot = load(SHIPPED.replace(one, other))
    like = load(edited(CONTINUOUS))
    assert robot.continuous.tolist() == like.continuous.tolist() == [True, False, False, False]
    assert robot_digest(robot) == robot_digest(like)
    found = hplan.plan(robot, scene_of((0.0, 1.5, 1.5, 1.5), (6.0, 1.5, 1.5, 1.2)), hplan.PlanOptions(effort="quick"))
    assert found.trajectory.position[-1, 0] == pytest.approx(6.0 - TAU)
    with pytest.raises(JointLimitError, match="joint 'base_yaw' is at 40 rad"):
        robot.check_configuration((40.0, 1.5, 1.5, 1.5), "start")


@pytest.mark.parametrize(
    ("start", "goal", "reached"),
    [(0.0, 350.0, -10.0), (0.0, 170.0, 170.0), (170.0, -170.0, 190.0), (300.0, 30.0, 30.0), (-350.0, 350.0, -10.0),
     (0.0, 400.0, 40.0), (340.0, 10.0, 10.0), (0.0, 360.0, 0.0), (-200.0, 360.0, -360.0)],
)  # fmt: skip
def test_goal_is_moved_by_whole_turns(load, start, goal, reached):
    robot = load(edited(CONTINUOUS))
    rest = (0.2, 0.3, 0.4)
    found = robot.turned_near((math.radians(goal), *rest), (math.radians(start), *rest))
    np.testing.assert_allclose(found, (math.radians(reached), *rest), atol=1e-12)


def test_goal_is_reached_the_short_way(load):
    robot = load(edited(CONTINUOUS))
    rest = (0.3, 0.4, 0.5)
    scene = scene_of((0.0, *rest), (math.radians(350.0), 0.5, 0.2, 0.4))
    result = hplan.plan(robot, scene)
    assert result.trajectory.position[-1, 0] == pytest.approx(math.radians(-10.0))
    assert result.trajectory.position[:, 0].min() > math.radians(-20.0)
    assert result.trajectory.position[:, 0].max() < math.radians(10.0)
    assert result.certificate.verified
    assert certify(robot, scene, result.trajectory).verified
    # A joint that is not continuous goes all the way.
    wide = load(SHIPPED.replace("3.141592653589793", repr(TAU)))
    far = hplan.plan(wide, scene)
    assert far.trajectory.position[-1, 0] == pytest.approx(math.radians(350.0))
    assert far.trajectory.duration > 2.0 * result.trajectory.duration
    assert not certify(wide, scene, result.trajectory).verified


# The parent of base_link


def test_world_below_the_base_does_not_count(load, plain):
    """It adds its frames, which goals may name, and so the digest differs; all else is where it was."""
    robot = load(edited(more=WORLD))
    assert robot_digest(robot) != robot_digest(plain)
    frames, before = ({each.name: each for each in one.model.frames} for one in (robot, plain))
    assert frames.keys() - before.keys() == {"world", "mount"}
    assert all(frames[name].placement == each.placement for name, each in before.items())
    assert list(robot.model.jointPlacements) == list(plain.model.jointPlacements)
    assert list(robot.model.inertias) == list(plain.model.inertias)
    shapes, others = (one.collision_model.geometryObjects for one in (robot, plain))
    assert [(each.name, each.placement) for each in shapes] == [(each.name, each.placement) for each in others]
    placed = robot.model.frames[robot.model.getFrameId("base_link")].placement
    assert placed.isIdentity(1e-15)
    scene = scene_of((-0.5, 0.3, 0.4, 0.5), (0.5, 0.5, 0.2, 0.4))
    there, here = hplan.plan(robot, scene), hplan.plan(plain, scene)
    assert there.certificate.verified
    np.testing.assert_array_equal(there.trajectory.position, here.trajectory.position)


def test_shapes_of_mount_are_kept(load):
    cart = f'<link name="cart">{BODY.format(mass=30)}</link><link name="world"/>'
    cart += JOINT.format("top", "fixed", "cart", "base_link", '<origin xyz="0.2 0.1 0.4" rpy="0 0 0.5"/>')
    cart += JOINT.format("wheels", "fixed", "world", "cart", '<origin xyz="5 5 0" rpy="0 0 1"/>')
    robot = load(edited(more=cart))
    (shape,) = [s for s in robot.collision_model.geometryObjects if s.name.startswith("cart")]
    top = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5), np.array([0.2, 0.1, 0.4]))
    expected = top.inverse() * pin.SE3(np.eye(3), np.array([0.03, 0.0, 0.0]))
    np.testing.assert_allclose(shape.placement.homogeneous, expected.homogeneous, atol=1e-15)
    # Not from one link to the other: the whole tilts by nothing, where one tilts and the next tilts back.
    tilted = cart.replace('rpy="0 0 0.5"', 'rpy="0 0.3 0"').replace('rpy="0 0 1"', 'rpy="0 -0.3 0"')
    assert family_of(load(edited(more=tilted))).has_yaw


# Meshes of packages


def write_stl(path: Path) -> None:
    corners = [(0, 0, 0), (0.4, 0, 0), (0, 0.02, 0), (0, 0, 0.06)]
    faces = [[corners[i] for i in face] for face in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    triangles = b"".join(struct.pack("<12fH", *(0, 0, 0), *np.ravel(face), 0) for face in faces)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(faces)) + triangles)


MESH = re.sub(
    r'<collision name="hand.*</collision>',
    '<collision><geometry><mesh filename="package://arm_description/meshes/hand.stl"/></geometry></collision>',
    SHIPPED,
    flags=re.DOTALL,
)


@pytest.mark.parametrize(
    ("stl", "options"),
    [
        ("arm_description/meshes/hand.stl", {}),
        ("../../../../meshes/hand.stl", {}),
        ("elsewhere/arm_description/meshes/hand.stl", {"package_dirs": ["elsewhere"]}),
    ],
)
def test_mesh_of_a_package_is_a_capsule_about_its_link(tmp_path, stl, options):
    folder = tmp_path / "a" / "b" / "c" / "arm" / "urdf"
    write_stl(folder / stl)
    (folder / "robot.urdf").write_text(MESH)
    shutil.copy(LIMITS, folder / "robot.limits.yaml")
    dirs = [folder / name for name in options.get("package_dirs", ())]
    robot = load_robot(folder / "robot.urdf", package_dirs=dirs)
    assert family_of(robot).arm.half_widths[2] == pytest.approx(0.06, rel=1e-6)
    (folder / "robot.urdf").write_text(MESH.replace("package://arm_description/meshes/hand.stl", stl))
    assert family_of(load_robot(folder / "robot.urdf")).arm.half_widths[2] == family_of(robot).arm.half_widths[2]


def test_mesh_that_is_nowhere(tmp_path):
    write_stl(tmp_path / "arm_description" / "meshes" / "hand.stl")
    folder = tmp_path / "1" / "2" / "3" / "4" / "5"
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text(MESH)
    (tmp_path / "given").mkdir()
    with pytest.raises(RobotFileError) as caught:
        load_robot(folder / "robot.urdf", limits=LIMITS, package_dirs=[tmp_path / "given"])
    for word in ("package://arm_description/meshes/hand.stl", str(tmp_path / "given"), str(folder), "--package-dir"):
        assert word in str(caught.value)
    assert re.search(r"line \d+: mesh", str(caught.value))
    assert family_of(load_robot(folder / "robot.urdf", limits=LIMITS, package_dirs=[tmp_path])).arm.link_count == 3


# Texts, xacro, limits


def test_text_is_a_urdf(plain):
    for text in (SHIPPED, "\n  " + SHIPPED, SHIPPED[SHIPPED.index("<robot") :]):
        robot = load_robot(text, limits=LIMITS)
        assert robot_digest(robot) == robot_digest(plain)


def with_limits(jerk: bool = True) -> str:
    return re.sub("<limit ", '<limit acceleration="2.5" ' + ('jerk="90" ' if jerk else ""), SHIPPED)


def test_limits_of_urdf_1_2():
    robot = load_robot(with_limits())
    assert robot.acceleration_limit.tolist() == [2.5] * 4
    assert robot.jerk_limit.tolist() == [90.0] * 4
    assert load_robot(with_limits(jerk=False)).jerk_limit is None
    assert load_robot(with_limits(), limits=LIMITS).acceleration_limit.tolist() == [3.0, 3.0, 4.0, 6.0]


def test_xacro_without_its_package(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    (tmp_path / "robot.urdf.xacro").write_text(SHIPPED)
    with pytest.raises(InputError, match=r"xacro needs xacrodoc, which is not installed: pip install 'hplan\[xacro\]'"):
        load_robot(tmp_path / "robot.urdf.xacro")


def test_xacro_itself(tmp_path):
    pytest.importorskip("xacrodoc")
    text = SHIPPED.replace('<robot name="harvester">', '<robot name="harvester" xmlns:xacro="http://ros.org/wiki/xacro">'
        '<xacro:property name="hand" value="${0.2 * 2.5}"/>')  # fmt: skip
    text = text.replace('<origin xyz="0.4 0 0"/>\n  </joint>', '<origin xyz="${hand} 0 0"/></joint>')
    (tmp_path / "robot.urdf.xacro").write_text(text)
    robot = load_robot(tmp_path / "robot.urdf.xacro", limits=LIMITS)
    assert family_of(robot).arm.lengths.tolist() == pytest.approx([1.0, 0.8, 0.5])


# Where robots go


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_commands_pass_it_on(tmp_path, capsys):
    folder = tmp_path / "arm"
    write_stl(tmp_path / "arm_description" / "meshes" / "hand.stl")
    folder.mkdir()
    (folder / "robot.urdf").write_text(MESH.replace("</robot>", f"{FINGERS}</robot>"))
    shutil.copy(LIMITS, folder / "robot.limits.yaml")
    out, robot = tmp_path / "out", ("--robot", folder / "robot.urdf")
    assert run("plan", "--out", out, "--quiet", *robot) == 0  # around the URDF
    (tmp_path / "far").mkdir()
    (tmp_path / "arm_description").rename(tmp_path / "far" / "arm_description")
    assert run("plan", "--out", out, "--quiet", *robot) == 2
    assert "is not found" in capsys.readouterr().err
    held = (*robot, "--hold", "grip=0.02", "--package-dir", tmp_path / "far")
    assert run("plan", "--out", out, "--quiet", *held) == 0
    assert run("certify", out, "--quiet", *held) == 0
    assert run("view", out, "--no-serve", "--quiet", *held) == 0
    # Another robot, with the fingers in another position.
    assert run("certify", out, "--quiet", *robot, "--hold", "grip=0.03", "--package-dir", tmp_path / "far") == 5
    capsys.readouterr()
    assert run("plan", "--out", out, "--quiet", *robot, "--hold", "grip") == 2
    assert "--hold = 'grip': expected NAME=RAD" in capsys.readouterr().err
