"""Planar arms: reading and writing URDFs of the family, and refusals."""

from __future__ import annotations

import math
import re
import shutil
import struct
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm
from turret_shapes import radius, turning_shapes

from hplan.base.data_files import urdf_dir
from hplan.certificate.digests import robot_digest
from hplan.errors import JointLimitError, OptionError, RobotFamilyError, RobotFileError
from hplan.planar.family_reader import family_of, is_planar
from hplan.robot.family import HARVESTER, ORCHARD_HARVESTER, cross_check
from hplan.robot.family.members import ArmSpec, write_robot
from hplan.robot.files import read_models
from hplan.robot.limits_file import read_limits
from hplan.robot.model import Robot, load_robot

HALF_PI = math.pi / 2
SHIPPED = (urdf_dir() / "harvester.urdf").read_text()


@pytest.fixture
def load_edited(tmp_path):
    """Load the shipped robot with texts of its URDF replaced, each from the shoulder joint on."""
    shutil.copy(urdf_dir() / "harvester.limits.yaml", tmp_path)

    def load(*edits: tuple[str, str]) -> Robot:
        text = SHIPPED
        for old, new in edits:
            start = text.index(old, text.index('<joint name="shoulder"'))
            text = text[:start] + new + text[start + len(old) :]
        (tmp_path / "harvester.urdf").write_text(text)
        return load_robot(tmp_path / "harvester.urdf")

    return load


def origin_of(child: str, new: str) -> tuple[str, str]:
    """The edit that places a joint anew; `new` holds the attributes of its origin."""
    old = re.search(rf'<child link="{child}"/>\s*<origin [^>]*/>', SHIPPED)
    return old.group(), f'<child link="{child}"/><origin {new}/>'


def collision_of_hand(new: str) -> tuple[str, str]:
    old = re.search(r'<collision name="hand.*</collision>', SHIPPED, re.DOTALL)
    return old.group(), new


def assert_kinematics_match(robot: Robot) -> None:
    """Joint and tool positions equal Pinocchio's, at random configurations and yaw.

    The tool is in the plane; a joint's position is the intersection of its axis with the plane.
    """
    rng = np.random.default_rng(0)
    data = robot.model.createData()
    tool = robot.model.getFrameId(robot.tool_frame)
    first = 2 if family_of(robot).has_yaw else 1
    q = rng.uniform(robot.lower, robot.upper, (50, robot.dof))
    tools = robot.tool_positions(q)
    points = family_of(robot).arm.joint_points(q[:, family_of(robot).arm_slice])
    for i in range(len(q)):
        pin.framesForwardKinematics(robot.model, data, q[i])
        world = [data.oMi[j].translation for j in range(first, robot.model.njoints)] + [data.oMf[tool].translation]
        origin, axes = family_of(robot).plane_at(family_of(robot).yaw_of(q[i]))
        in_plane = (np.array(world) - origin) @ axes.T
        np.testing.assert_allclose(in_plane[:, :2], points[i], atol=1e-12)
        np.testing.assert_allclose(in_plane[-1, 2], 0.0, atol=1e-12)
        np.testing.assert_allclose(tools[i], world[-1], atol=1e-12)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(axes) == pytest.approx(1.0)
    np.testing.assert_array_equal(robot.tool_positions(q[3]), tools[3])


def test_robot_is_its_name_and_joints(robot):
    assert repr(robot) == "<Robot 'harvester': 4 joints (base_yaw, shoulder, elbow, wrist), tool frame 'tool0'>"


# The family


@pytest.mark.parametrize("has_yaw", [True, False])
@pytest.mark.parametrize("links", [1, 3, 5])
def test_family(tmp_path, links, has_yaw):
    joints = links + has_yaw
    spec = ArmSpec(
        name="cousin",
        link_lengths=[0.7 - 0.1 * k for k in range(links)],
        link_half_widths=[0.06 - 0.01 * k for k in range(links)],
        link_masses=[2.0] * links,
        lower=[-2.0 - k for k in range(joints)],
        upper=[0.5 + k for k in range(joints)],
        velocity=[1.0 + k for k in range(joints)],
        effort=[200.0 + k for k in range(joints)],
        acceleration=[2.0 + k for k in range(joints)],
        shoulder_height=0.75,
        has_yaw=has_yaw,
    )
    robot = load_robot(write_robot(spec, tmp_path / "cousin.urdf")[0])
    assert family_of(robot).has_yaw is has_yaw
    assert robot.joint_names == spec.joint_names
    assert family_of(robot).arm.link_names == spec.arm_link_names
    np.testing.assert_allclose(family_of(robot).arm.lengths, spec.link_lengths, rtol=1e-14)
    np.testing.assert_allclose(family_of(robot).arm.half_widths, spec.link_half_widths, rtol=1e-14)
    assert robot.lower.tolist() == list(spec.lower)
    assert robot.upper.tolist() == list(spec.upper)
    assert robot.velocity_limit.tolist() == list(spec.velocity)
    assert robot.torque_limit.tolist() == list(spec.effort)
    assert robot.acceleration_limit.tolist() == list(spec.acceleration)
    assert robot.jerk_limit is None
    np.testing.assert_allclose(family_of(robot).plane_origin, [0.0, 0.0, 0.75], rtol=1e-15)
    assert_kinematics_match(robot)


AXIS = '<axis xyz="0 -1 0"/>'
TURNED_ELBOW = origin_of("forearm", 'xyz="1 0 0" rpy="0 -0.3 0"')


@pytest.mark.parametrize(
    ("edits", "signs", "offsets"),
    [
        ([(AXIS, '<axis xyz="0 1 0"/>')], [-1, 1, 1], [0, 0, 0]),
        ([(AXIS, '<axis xyz="0 1 0"/>'), (AXIS, '<axis xyz="0 3 0"/>')], [-1, -1, 1], [0, 0, 0]),
        ([TURNED_ELBOW], [1, 1, 1], [0, 0.3, 0]),
        ([(AXIS, '<axis xyz="0 1 0"/>'), TURNED_ELBOW], [-1, 1, 1], [0, 0.3, 0]),
        ([origin_of("upper_arm", 'xyz="0.2 0 0.5"')], [1, 1, 1], [0, 0, 0]),
        ([origin_of("upper_arm", 'xyz="0 0 0.6" rpy="0 0 0.4"')], [1, 1, 1], [0, 0, 0]),
        ([origin_of("upper_arm", 'xyz="-0.1 0 0.6" rpy="0 0 3.141592653589793"')], [1, 1, 1], [0, 0, 0]),
        ([origin_of("upper_arm", 'xyz="0 0 0.6" rpy="0 -1.2 0"')], [1, 1, 1], [1.2, 0, 0]),
        ([origin_of("upper_arm", 'xyz="0 0 0.6" rpy="0 -1.5707963267948966 0"')], [1, 1, 1], [HALF_PI, 0, 0]),
        ([origin_of("hand", 'xyz="0.6 0 0.3"')], [1, 1, 1], [0, 0.463647609, -0.463647609]),
    ],
    ids=["+y", "two +y, one of length 3", "turned joint", "+y and turned joint", "shoulder beside the yaw axis",
         "arm turned about z", "arm backwards", "arm raised at zero", "arm upright at zero", "cranked link"],
)  # fmt: skip
def test_members_with_other_zeros(load_edited, edits, signs, offsets):
    robot = load_edited(*edits)
    assert family_of(robot).arm.signs.tolist() == signs
    np.testing.assert_allclose(family_of(robot).arm.offsets, offsets, atol=1e-9)
    assert_kinematics_match(robot)


# Half-widths

CYLINDER = '<geometry><cylinder radius="%g" length="%g"/></geometry>'


@pytest.mark.parametrize(
    ("collision", "half_width", "tolerance"),
    [
        ('<geometry><sphere radius="0.05"/></geometry><origin xyz="0.2 0 0"/>', 0.05, 1e-15),
        ('<geometry><sphere radius="0.05"/></geometry><origin xyz="0.43 0 0.04"/>', 0.1, 1e-15),
        ('<geometry><sphere radius="0.05"/></geometry><origin xyz="0.43 0.04 0"/>', 0.08, 1e-15),
        ('<geometry><box size="0.4 0.06 0.08"/></geometry><origin xyz="0.2 0 0"/>', 0.05, 1e-15),
        ('<geometry><box size="0.46 0.06 0.08"/></geometry><origin xyz="0.2 0 0"/>', math.hypot(0.03, 0.05), 1e-15),
        (f'{CYLINDER % (0.03, 0.4)}<origin xyz="0.2 0 0" rpy="0 {HALF_PI} 0"/>', 0.03, 1e-15),
        (f'{CYLINDER % (0.03, 0.48)}<origin xyz="0.2 0 0" rpy="0 {HALF_PI} 0"/>', 0.05, 1e-15),
        (f'{CYLINDER % (0.03, 0.08)}<origin xyz="0.2 0 0"/>', 0.05, 2e-3),
        (f'{CYLINDER % (0.02, 0.4)}<origin xyz="0.2 0.03 0.04" rpy="0 {HALF_PI} 0"/>', 0.06, 2e-3),
        (f'{CYLINDER % (0.02, 0.4)}<origin xyz="0.2 0.13 0" rpy="0 {HALF_PI} 0"/>', 0.02, 1e-15),
        ('<geometry><mesh filename="wedge.stl" scale="1 1 2"/></geometry>', 0.06, 1e-6),
    ],
    ids=["sphere", "sphere above", "sphere aside", "box", "long box", "cylinder", "long cylinder", "upright cylinder",
         "cylinder aside and above", "cylinder aside", "mesh"],
)  # fmt: skip
def test_half_width_holds_the_collision_geometry(load_edited, tmp_path, collision, half_width, tolerance):
    """Never smaller than the geometry needs, and larger by no more than the tolerance."""
    corners = [(0, 0, 0), (0.4, 0, 0), (0, 0.02, 0), (0, 0, 0.03)]
    faces = [[corners[i] for i in face] for face in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    triangles = b"".join(struct.pack("<12fH", *(0, 0, 0), *np.ravel(face), 0) for face in faces)
    (tmp_path / "wedge.stl").write_bytes(bytes(80) + struct.pack("<I", len(faces)) + triangles)
    robot = load_edited(collision_of_hand(f"<collision>{collision}</collision>"))
    assert half_width * (1 - 1e-7) <= family_of(robot).arm.half_widths[2] <= half_width * (1 + 1e-7 + tolerance)
    assert family_of(robot).arm.half_widths[:2] == pytest.approx([0.05, 0.04], rel=1e-14)


# Robots that are not of the family

FAMILY_FAULTS = {
    "continuous joint": (
        [('type="revolute"', 'type="continuous"'), ('effort="250"', "")], "joint 'shoulder': it is continuous"
    ),
    "prismatic joint": ([('type="revolute"', 'type="prismatic"')], "joint 'shoulder': it is a JointModelPrismatic"),
    "axis not parallel": (
        [origin_of("forearm", 'xyz="1 0 0" rpy="0.1 0 0"')],
        "joint 'elbow': it is not parallel to joint 'shoulder'",
    ),
    "axis not horizontal": (
        [origin_of("upper_arm", 'xyz="0 0 0.6" rpy="0.1 0 0"')],
        "joint 'shoulder': it is not perpendicular to the yaw axis",
    ),
    "axis without direction": ([(AXIS, '<axis xyz="0 0 0"/>')], "joint 'shoulder': its axis has no direction"),
    "no tool frame": (
        [
            ('<child link="tool0"/>', '<child link="tcp"/>'),
            ('<link name="tool0"', '<link name="eye"/><joint name="mount" type="fixed"><parent link="hand"/>'
             '<child link="eye"/></joint><link name="tcp"'),
        ],
        "frame 'tool0': it marks the end of the arm and is missing",
    ),
    "link of no length": ([origin_of("hand", 'xyz="0 0 0"')], "link 'forearm': it has no length"),
    "no collision geometry": ([collision_of_hand("")], "link 'hand': it has no collision geometry"),
    "limits swapped": ([('lower="0"', 'lower="2"')], "'shoulder': its lower limit 2 rad is not below its upper"),
    "limits equal": ([('upper="1.5707963267948966"', 'upper="0"')], "lower limit 0 rad is not below its upper limit 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAMILY_FAULTS)
def test_family_faults_name_the_element(load_edited, case):
    edits, message = FAMILY_FAULTS[case]
    # Faults that make it invalid as a robot.
    no_robot = ("continuous joint", "axis without direction", "no tool frame", "limits swapped", "limits equal")
    of_any_robot = case in no_robot
    with pytest.raises(RobotFileError if of_any_robot else RobotFamilyError) as caught:
        assert family_of(load_edited(*edits))
    assert message in caught.value.message
    assert of_any_robot or caught.value.robot == "harvester"
    assert caught.value.exit_status == 2


def test_yaw_axis_down(load_edited, tmp_path):
    load_edited()
    path = tmp_path / "harvester.urdf"
    path.write_text(SHIPPED.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 -1"/>'))
    with pytest.raises(RobotFamilyError, match="the yaw axis points down"):
        assert family_of(load_robot(path)).has_yaw
    path.write_text(SHIPPED.replace('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>'))
    with pytest.raises(
        RobotFamilyError, match="joint 'base_yaw': it is neither parallel to the next joint nor vertical"
    ):
        assert family_of(load_robot(path)).has_yaw


TILTS = {
    "yaw": (
        '<axis xyz="0 0 1"/>',
        '<axis xyz="{} 0 1"/>',
        "joint 'base_yaw': it is neither parallel to the next joint",
    ),
    "shoulder": ('<axis xyz="0 -1 0"/>', '<axis xyz="0 -1 {}"/>', "joint 'shoulder': it is not perpendicular to the"),
    "wrist": (
        '<axis xyz="0 -1 0"/>\n    <limit effort="30"',
        '<axis xyz="{} -1 0"/>\n    <limit effort="30"',
        "joint 'wrist': it is not parallel to joint 'shoulder'",
    ),
}


@pytest.mark.parametrize("tilt", [4.4e-3, 3.673e-6, 2e-9])
@pytest.mark.parametrize("axis", TILTS)
def test_slightly_tilted_axes_are_refused_with_advice(load_edited, tmp_path, axis, tilt):
    """0.25 deg passed for vertical once, and 4e-5 rad for parallel: a bound of the proof was then none."""
    old, new, message = TILTS[axis]
    load_edited()
    path = tmp_path / "harvester.urdf"
    path.write_text(SHIPPED.replace(old, new.format(repr(tilt)), 1))
    with pytest.raises(RobotFamilyError) as caught:
        assert family_of(load_robot(path)).has_yaw
    assert message in caught.value.message
    assert f" by {tilt:.3g} rad, more than the tolerance of 1e-09: write angles in full" in caught.value.message
    path.write_text(SHIPPED.replace(old, new.format("1e-10"), 1))
    assert family_of(load_robot(path)).has_yaw


def test_yaw_axis_off_the_origin(load_edited, tmp_path):
    load_edited()
    old = re.search(r'<child link="turret"/>\s*<origin xyz="0 0 0"/>', SHIPPED).group()
    path = tmp_path / "harvester.urdf"
    path.write_text(SHIPPED.replace(old, '<child link="turret"/><origin xyz="0.3 0 0.1"/>'))
    robot = load_robot(path)
    assert family_of(robot).yaw_axis.tolist() == [0.3, 0.0]
    assert family_of(robot).shoulder_from_axis == (0.0, 0.0)
    assert_kinematics_match(robot)
    path.write_text(SHIPPED.replace(old, '<child link="turret"/><origin xyz="0 0 0.1" rpy="0 0 0.7"/>'))
    assert_kinematics_match(load_robot(path))


ASIDE = {
    # The edit; how far the tool and each link are to the left of the yaw axis [m].
    "joint beside the others": (origin_of("forearm", 'xyz="1 0.01 0"'), 0.01, [0.0, 0.01, 0.01]),
    "tool beside the joints": (origin_of("tool0", 'xyz="0.4 -0.02 0"'), -0.02, [0.0, 0.0, 0.0]),
    "shoulder beside the yaw axis": (origin_of("upper_arm", 'xyz="0 0.2 0.6"'), 0.2, [0.2, 0.2, 0.2]),
}


@pytest.mark.parametrize("case", ASIDE)
def test_displaced_links_belong_to_planar_family(load_edited, case):
    """The plane is the tool's; the bodies of links that are not in it keep their thickness."""
    edit, left, links = ASIDE[case]
    robot = load_edited(edit)
    assert family_of(robot).plane_origin == pytest.approx([0.0, left, 0.6], abs=1e-15)
    assert family_of(robot).shoulder_from_axis == pytest.approx((0.0, -left), abs=1e-15)
    assert family_of(robot).arm.lateral == pytest.approx(
        [left - place for place in links], abs=1e-15
    )  # the normal is -y
    assert family_of(robot).arm.half_widths == pytest.approx([0.05, 0.04, 0.03], rel=1e-12)
    assert family_of(robot).yaw_radius == pytest.approx(np.hypot([1.0, 1.8, 2.2], links), rel=1e-12)
    assert_kinematics_match(robot)


def test_six_axis_arm_with_offsets_is_not_planar(tmp_path):
    (tmp_path / "six.urdf").write_text(six_axis_arm())
    (tmp_path / "six.limits.yaml").write_text(SIX_AXIS_LIMITS)
    robot = load_robot(tmp_path / "six.urdf")
    assert not is_planar(robot)
    with pytest.raises(RobotFamilyError) as caught:
        assert family_of(robot).arm
    assert caught.value.message == (
        "robot 'six_axes' is not a planar arm on an optional yaw: joint 'wrist_2': it is not parallel to joint "
        "'shoulder_lift'; hold={'wrist_2': 0.0} (--hold wrist_2=0) locks it"
    )


# Files that cannot be read


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot name='a'><link></robot>", "malformed XML: mismatched tag: line 1"),
        ("<sdf/>", "the root element is <sdf>, expected <robot>"),
        ("<robot name='a'/>", "Pinocchio refuses it"),
    ],
)
def test_text_that_is_not_a_urdf(tmp_path, text, message):
    (tmp_path / "bad.urdf").write_text(text)
    with pytest.raises(RobotFileError) as caught:
        read_models(tmp_path / "bad.urdf")
    assert message in caught.value.reason


LIMIT = '<limit effort="250" velocity="1.2" lower="0" upper="1.5707963267948966"/>'

FILE_FAULTS = {
    "joint twice": (('<joint name="elbow"', '<joint name="shoulder"'), "joint 'shoulder' is defined twice"),
    "no such link": (('<child link="hand"/>', '<child link="paw"/>'), "joint 'wrist': its child link 'paw' does not"),
    "mimic": ((AXIS, f'{AXIS}<mimic joint="base_yaw"/>'), "joint 'shoulder' mimics another"),
    "no limit": ((LIMIT, ""), "joint 'shoulder': it has no <limit>"),
    "velocity of zero": (('velocity="1.2"', 'velocity="0"'), "'shoulder': velocity of <limit> is '0', expected"),
    "negative mass": (('<mass value="6"/>', '<mass value="-6"/>'), "link 'upper_arm': value of <mass> is '-6'"),
    "flat box": (collision_of_hand('<collision><geometry><box size="1 0 1"/></geometry></collision>'), "is '1 0 1'"),
    "collision of nothing": (collision_of_hand("<collision><geometry/></collision>"), "a <collision> has no geometry"),
    "missing mesh": (
        collision_of_hand('<collision><geometry><mesh filename="nowhere.stl"/></geometry></collision>'),
        "mesh 'nowhere.stl' is not found; looked for in",
    ),
}


@pytest.mark.parametrize("case", FILE_FAULTS)
def test_file_faults_name_the_element(load_edited, case):
    edit, message = FILE_FAULTS[case]
    with pytest.raises(RobotFileError) as caught:
        load_edited(edit)
    assert message in caught.value.reason


# The limits file

GOOD_LIMITS = """\
format: hplan-limits/1
acceleration_rad_s2: {a: 1, b: 2.5}
jerk_rad_s3: {b: 20, a: 1e1}
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (GOOD_LIMITS, "", "expected a mapping of keys"),
        ("{a: 1", "{a: 0", "line 2: acceleration_rad_s2.a: input should be greater than 0 (got 0)"),
        ("{a: 1", "{a: .nan", "finite number (got nan)"),
        ("{a: 1, ", "{", "acceleration_rad_s2: joints missing ['a'], unknown []"),
        ("{a: 1", "{a: 1, a: 9", "line 2: malformed YAML: key 'a' is already on line 2"),
        ("acceleration_rad_s2: {a: 1, b: 2.5}", "", "acceleration_rad_s2 is missing"),
        ("format: hplan-limits/1", "", "format: this key is missing; expected format: hplan-limits/1"),
        ("jerk_rad_s3", "snap", "line 3: snap: unknown key"),
        ("hplan-limits/1", "hplan-limits/2", "format: input should be 'hplan-limits/1' (got 'hplan-limits/2')"),
    ],
)
def test_bad_limits(tmp_path, old, new, message):
    path = tmp_path / "limits.yaml"
    path.write_text(GOOD_LIMITS.replace(old, new))
    with pytest.raises(RobotFileError) as caught:
        read_limits(path, ("a", "b"), (False, False))
    assert message in caught.value.reason
    assert caught.value.path == path


# Configurations


def test_configuration_a_rounding_error_outside_is_clipped(robot):
    q = robot.check_configuration([math.pi + 1e-12, HALF_PI + 1e-10, -1e-10, 0.0], "start")
    assert q.tolist() == [math.pi, HALF_PI, 0.0, 0.0]


def test_a_start_a_little_outside_is_clipped(robot):
    """Encoders and rounding report a joint at its limit as beyond it; a goal or waypoint is chosen within."""
    reported = [math.pi + 9e-5, HALF_PI, -9e-5, 0.0]
    assert robot.check_configuration(reported, "start").tolist() == [math.pi, HALF_PI, 0.0, 0.0]
    with pytest.raises(JointLimitError, match=r"goal: joint 'base_yaw' is at 3\.14168 rad, outside .*3\.14159\] rad"):
        robot.check_configuration(reported, "goal")
    with pytest.raises(JointLimitError, match=r"at 3\.14159266 rad, outside .*, 3\.14159265\] rad"):
        robot.check_configuration([math.pi + 1e-8, HALF_PI, 0.0, 0.0], "goal")
    with pytest.raises(JointLimitError, match="start: joint 'base_yaw'"):
        robot.check_configuration([math.pi + 2e-4, HALF_PI, 0.0, 0.0], "start")


@pytest.mark.parametrize(("joint", "value"), [(0, 3.2), (1, -0.01), (3, 1.6)])
def test_configuration_outside_the_limits(robot, joint, value):
    q = np.zeros(4)
    q[joint] = value
    with pytest.raises(JointLimitError) as caught:
        robot.check_configuration(q, "goal")
    error = caught.value
    assert error.joint == robot.joint_names[joint]
    assert (error.value, error.lower, error.upper) == (value, robot.lower[joint], robot.upper[joint])
    assert f"goal: joint {error.joint!r} is at {value} rad" in error.message


URDF = urdf_dir() / "harvester.urdf"


def arm(n: int, *, has_yaw: bool = True, name: str = "test_arm") -> ArmSpec:
    joints = n + has_yaw
    return ArmSpec(
        name=name,
        link_lengths=tuple(0.6 - 0.05 * i for i in range(n)),
        link_half_widths=(0.03,) * n,
        link_masses=(2.0,) * n,
        lower=(-1.0,) * joints,
        upper=(1.5,) * joints,
        velocity=(1.0,) * joints,
        effort=(200.0,) * joints,
        acceleration=(2.0,) * joints,
        has_yaw=has_yaw,
    )


# The shipped robot


@pytest.mark.parametrize("spec", [HARVESTER, ORCHARD_HARVESTER], ids=lambda spec: spec.name)
def test_shipped_robots_equal_written_files(tmp_path, spec):
    """Inertia, joints, limits and collision shapes; only drawn shapes differ."""
    written = load_robot(write_robot(spec, tmp_path / f"{spec.name}.urdf")[0])
    assert robot_digest(written) == robot_digest(load_robot(spec.name))
    seen, checked = written.visual_model.geometryObjects, written.collision_model.geometryObjects
    assert [shape.placement for shape in seen] == [shape.placement for shape in checked]


def test_shipped_robot_reads_alike_everywhere():
    check = cross_check(URDF)
    assert check.frames == ("base_link", "turret", "upper_arm", "forearm", "hand", "tool0")
    assert check.samples == 100
    assert check.max_position_deviation < 1e-12
    assert check.max_rotation_deviation < 1e-12
    assert check.limits_equal
    assert check.masses_equal


# The family


positive = st.floats(1e-3, 1e3)


@st.composite
def specs(draw: st.DrawFn) -> ArmSpec:
    n = draw(st.integers(1, 6))
    has_yaw = draw(st.booleans())

    def values(elements: st.SearchStrategy[float], count: int) -> list[float]:
        return draw(st.lists(elements, min_size=count, max_size=count))

    joints = n + has_yaw
    lower = values(st.floats(-3.0, 3.0), joints)
    return ArmSpec(
        name=draw(st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)),
        link_lengths=tuple(values(st.floats(0.01, 10.0), n)),
        link_half_widths=tuple(values(st.floats(0.001, 1.0), n)),
        link_masses=tuple(values(positive, n)),
        lower=tuple(lower),
        upper=tuple(low + span for low, span in zip(lower, values(positive, joints), strict=True)),
        velocity=tuple(values(positive, joints)),
        effort=tuple(values(positive, joints)),
        acceleration=tuple(values(positive, joints)),
        jerk=draw(st.none() | st.just(tuple(values(positive, joints)))),
        shoulder_height=draw(st.floats(0.01, 3.0)),
        has_yaw=has_yaw,
        yaw_axis=tuple(values(st.floats(-2.0, 2.0), 2)),
        shoulder_offset=draw(st.floats(-0.5, 0.5)),
        link_offsets=draw(st.none() | st.just(tuple(values(st.floats(-0.3, 0.3), n)))),
    )


@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spec=specs())
def test_any_spec_survives_the_files(spec, tmp_path):
    urdf, limits_path = write_robot(spec, tmp_path / "arm.urdf")
    model, collision_model, _ = pin.buildModelsFromUrdf(str(urdf))
    assert tuple(model.names)[1:] == spec.joint_names
    assert tuple(model.lowerPositionLimit) == spec.lower
    assert tuple(model.upperPositionLimit) == spec.upper
    assert tuple(model.velocityLimit) == spec.velocity
    assert tuple(model.effortLimit) == spec.effort
    for k, link in enumerate(spec.arm_link_names):
        shapes = [g.geometry for g in collision_model.geometryObjects if g.name[:-2] == link]
        side, *ends = shapes
        assert [sphere.radius for sphere in ends] == [spec.link_half_widths[k]] * 2
        assert side.radius == spec.link_half_widths[k]
        assert 2 * side.halfLength == spec.link_lengths[k]
    limits = yaml.safe_load(limits_path.read_text())
    assert tuple(limits["acceleration_rad_s2"]) == spec.joint_names
    assert tuple(limits["acceleration_rad_s2"].values()) == spec.acceleration
    if spec.jerk is not None:
        assert tuple(limits["jerk_rad_s3"].values()) == spec.jerk
    assert cross_check(urdf, samples=3).max_position_deviation < 1e-10


def test_offsets_survive_writing_and_reading(tmp_path):
    spec = replace(HARVESTER, name="aside", yaw_axis=(0.3, -0.2), shoulder_offset=0.15, link_offsets=(0.06, -0.02, 0.0))
    robot = load_robot(write_robot(spec, tmp_path / "aside.urdf")[0])
    assert family_of(robot).yaw_axis.tolist() == [0.3, -0.2]
    assert family_of(robot).plane_origin == pytest.approx([0.3, -0.2 + 0.15, 0.6], abs=1e-15)
    assert family_of(robot).plane_axes.tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    assert family_of(robot).shoulder_from_axis == pytest.approx((0.0, -0.15), abs=1e-15)
    assert family_of(robot).arm.lateral.tolist() == [-0.06, 0.02, 0.0]  # the plane's normal is -y
    assert family_of(robot).arm.half_widths == pytest.approx(HARVESTER.link_half_widths, rel=1e-9)
    (axle,) = turning_shapes(robot)  # the pedestal and the turret's body are round about the yaw axis
    assert radius(axle) == pytest.approx(math.hypot(0.15 + 0.06, 0.8 * 0.05), rel=2e-3)


# Faults


@pytest.mark.parametrize(
    ("change", "option"),
    [
        ({"name": "a--b"}, "name"),
        ({"name": "a<b"}, "name"),
        ({"link_lengths": ()}, "link_lengths"),
        ({"link_lengths": (1.0, 0.0)}, "link_lengths[1]"),
        ({"link_half_widths": (0.1,)}, "link_half_widths"),
        ({"link_masses": (1.0, 1.0, 1.0)}, "link_masses"),
        ({"velocity": (1.0, 1.0)}, "velocity"),
        ({"effort": (1.0, math.inf, 1.0)}, "effort[1]"),
        ({"acceleration": (0.0, 1.0, 1.0)}, "acceleration[0]"),
        ({"jerk": (1.0, 1.0)}, "jerk"),
        ({"lower": (-1.0, 1.5, -1.0)}, "lower[joint_1]"),
        ({"upper": (-2.0, 1.5, 1.0)}, "lower[base_yaw]"),
        ({"yaw_axis": (0.1,)}, "yaw_axis"),
        ({"link_offsets": (0.1,)}, "link_offsets"),
    ],
)
def test_bad_specs_name_the_field(change, option):
    with pytest.raises(OptionError) as caught:
        replace(arm(2), **change)
    assert caught.value.option == option
