"""URDFs are read strictly, and Pinocchio's model equals the file."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_urdf import seven_axis_arm

from hplan.base.data_files import urdf_dir
from hplan.errors import RobotFileError
from hplan.robot.files import read_models
from hplan.robot.model import load_robot
from hplan.robot.urdf_check import check_models
from hplan.robot.urdf_file import Urdf, read_urdf
from hplan.robot.urdf_xml import read_urdf_xml

SHIPPED = (urdf_dir() / "harvester.urdf").read_text()
TOOL = (
    '<link name="tool0"><inertial><origin xyz="0.1 0 0"/><mass value="3"/>'
    '<inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
    '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
    '<collision><origin xyz="0 0 0" rpy="0 0.5 0"/><geometry><box size="0.05 0.1 0.02"/></geometry></collision></link>'
)
GRIPPER = SHIPPED.replace('<link name="tool0"/>', TOOL)
GRIPPER_LINE = GRIPPER[: GRIPPER.index(TOOL)].count("\n") + 1


def write(folder: Path, text: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    shutil.copy(urdf_dir() / "harvester.limits.yaml", folder / "robot.limits.yaml")
    return path


def said(path: Path) -> Urdf:
    return read_urdf(path, read_urdf_xml(path))


def test_gripper_counts(tmp_path):
    load_robot(write(tmp_path, SHIPPED))
    robot = load_robot(write(tmp_path, GRIPPER))
    plain = load_robot()
    zeros = np.zeros((1, 4))
    heavier = robot.dynamics.torques(zeros, zeros, zeros) - plain.dynamics.torques(zeros, zeros, zeros)
    # 3 kg, 0.1 m beyond the tool frame.
    np.testing.assert_allclose(heavier[0], [0.0, *(3 * 9.81 * np.array([2.3, 1.3, 0.5]))], rtol=1e-9)


FAULTS = {
    # Formerly accepted, or lost without a message; now refused.
    "decimal comma in an inertial's origin": ('"0.1 0 0"', '"0,1 0 0"', "link 'tool0': xyz of <origin> is '0,1 0 0'"),
    "decimal comma in a mass": ('mass value="3"', 'mass value="3,5"', "value of <mass> is '3,5', expected a finite"),
    "decimal comma in a size": ('"0.05 0.1 0.02"', '"0,05 0.1 0.02"', "size of <box> is '0,05 0.1 0.02', expected 3"),
    "four numbers of three": ('xyz="0.1 0 0"', 'xyz="0.1 0 0 0"', "expected 3 finite numbers"),
    "full-width space": ('xyz="0.1 0 0"', 'xyz="0.1\u30000\u30000"', "xyz of <origin>"),
    "a place beyond all": ('xyz="0.1 0 0"', 'xyz="1e200 0 0"', "3 finite numbers of at most 10000 m"),
    "a size beyond all": ('"0.05 0.1 0.02"', '"0.05 0.1 1e308"', "a positive finite number, at most 10000 m"),
    "no mass": ('<mass value="3"/>', "", "<inertial> has no <mass>"),
    "an inertia with a number missing": ('iyz="0" ', "", "<inertia> has no iyz"),
    "negative inertia": ('ixx=".01"', 'ixx="-.01"', "principal moments -0.01, 0.01, 0.01 kg m^2; those of a body are"),
    "an inertia of no body": ('izz=".01"', 'izz=".03"', "principal moments 0.01, 0.01, 0.03"),
    "misspelled collision": ("<collision>", "<colision>", "<colision> in <link> has no meaning"),
    "misspelled attribute": ('<origin xyz="0.1', '<origin xzy="0.1', "xzy of <origin> has no meaning"),
    "unknown shape": ('<box size="0.05 0.1 0.02"/>', '<cone radius="1" length="1"/>', "<cone> in <geometry>"),
    "two shapes": ('<box size="0.05', '<sphere radius="1"/><box size="0.05', "a <geometry> has 2 shapes"),
    "mesh of scale 0": ('<box size="0.05 0.1 0.02"/>', '<mesh filename="a.stl" scale="1 0 1"/>', "scale of <mesh> is"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_content_that_urdf_readers_ignore_is_refused(tmp_path, case):
    old, new, message = FAULTS[case]
    assert old in TOOL
    text = GRIPPER.replace(TOOL, TOOL.replace(old, new, 1).replace("</collision>", f"</{new[1:-1]}>", 1)
                           if case == "misspelled collision" else TOOL.replace(old, new, 1))  # fmt: skip
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, text))
    assert message in caught.value.reason
    assert caught.value.faults[0].startswith(f"line {GRIPPER_LINE}: link 'tool0': ")


WRIST = SHIPPED[SHIPPED.index('<joint name="wrist"') :].split("</joint>")[0]
JOINT_FAULTS = {
    "decimal comma in the origin": ('xyz="0.8 0 0"', 'xyz="0,8 0 0"', "xyz of <origin> is '0,8 0 0'", 3),
    "decimal comma in the axis": ('"0 -1 0"', '"0 -1,0 0"', "xyz of <axis> is '0 -1,0 0'", 4),
    "axis without numbers": ('<axis xyz="0 -1 0"/>', "<axis/>", "<axis> has no xyz", 4),
    "misspelled limit": ('lower="0"', 'low="0"', "low of <limit> has no meaning", 5),
    "unreadable mimic": ("<axis", '<mimic joint="elbow" multiplier="1,5"/><axis', "multiplier of <mimic> is", 4),
    "unknown type": ('"revolute"', '"Revolute"', "its type is 'Revolute', expected one of revolute, continuous", 0),
    "two axes": ("<axis", '<axis xyz="0 1 0"/><axis', "a second <axis> in <joint>", 4),
}  # fmt: skip


@pytest.mark.parametrize("case", JOINT_FAULTS)
def test_faults_of_joints_name_line_and_element(tmp_path, case):
    old, new, message, below = JOINT_FAULTS[case]
    assert old in WRIST
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, SHIPPED.replace(WRIST, WRIST.replace(old, new, 1))))
    line = SHIPPED[: SHIPPED.index(WRIST)].count("\n") + 1 + below
    assert message in caught.value.reason
    assert caught.value.reason.startswith(f"line {line}: joint 'wrist': ")


@pytest.mark.parametrize("name", ["", "wr&#10;ist", "wr\u2028ist", "wrist "])
@pytest.mark.parametrize("what", ["joint", "link", "robot"])
def test_names_that_break_lines_are_refused(tmp_path, what, name):
    old = {"joint": '"wrist"', "link": '"hand"', "robot": '"harvester"'}[what]
    with pytest.raises(RobotFileError, match=r"has no name|a name has no line break"):
        load_robot(write(tmp_path, SHIPPED.replace(old, f'"{name}"')))


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ('<?xml version="1.0" encoding="utf-16"?>', "malformed XML"),
        ('<?xml version="1.0" encoding="klingon"?>', "malformed XML"),
        ('<!DOCTYPE robot [<!ENTITY m "3">]>', "line 1: it has a document type"),
        ('<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>', "line 1: it has a document type"),
    ],
)
def test_xml_that_readers_differ_on_is_refused(tmp_path, head, message):
    text = re.sub(r"^<\?xml.*\?>", lambda _: head, GRIPPER)
    with pytest.raises(RobotFileError, match=re.escape(message)):
        load_robot(write(tmp_path, text))


def test_elements_of_others_may_stay(tmp_path):
    more = '<gazebo reference="hand"><mu1>0,2</mu1></gazebo><transmission name="t"><type>x</type></transmission>'
    text = GRIPPER.replace("</robot>", more + "</robot>")
    text = text.replace("</inertial>", '</inertial><contact><stiffness value="1,0"/></contact>', 1)
    text = text.replace("<collision>", "<collision><drake:proximity_properties/>", 1)
    sphere = "<self_collision_checking><geometry><sphere/></geometry></self_collision_checking>"
    text = text.replace("</collision>", f"</collision>{sphere}", 1)
    text = text.replace("<collision>", '<self_filter/><origin xyz="0 0 0"/><collision><material name="grey"/>', 1)
    load_robot(write(tmp_path, text))


def test_origin_of_a_link_is_refused_unless_it_is_the_links_own(tmp_path):
    text = GRIPPER.replace("<collision>", '<origin xyz="0 0 0.1"/><collision>', 1)
    with pytest.raises(RobotFileError, match="<origin> in <link> has no meaning"):
        load_robot(write(tmp_path, text))


def test_joint_may_be_called_as_a_link(tmp_path):
    """As of the SO-100, whose jaw is moved by the joint `gripper` on the link `gripper`."""
    path = write(tmp_path, SHIPPED.replace('"wrist"', '"tool0"'))
    limits = path.with_suffix(".limits.yaml")
    limits.write_text(limits.read_text().replace("wrist", "tool0"))
    robot = load_robot(path)
    np.testing.assert_allclose(robot.forward_kinematics(np.zeros(4)), load_robot().forward_kinematics(np.zeros(4)))


def test_inertias_count_where_a_joint_moves_them(tmp_path):
    """The base of an ANYmal, a sensor of a TIAGo.

    Exporters write impossible inertias, and no result depends on them.
    """
    body, none = 'izz="0.392"', 'izz="3.92"'
    assert SHIPPED.index(body) < SHIPPED.index('<link name="turret">')
    load_robot(write(tmp_path, SHIPPED.replace(body, none, 1)))


def test_accelerations_may_be_drakes():
    """The URDF's own counts where both are there; one that cannot be read is refused."""
    arm = seven_axis_arm().replace(' acceleration="', ' drake:acceleration="')
    np.testing.assert_array_equal(load_robot(arm).acceleration_limit, load_robot(seven_axis_arm()).acceleration_limit)
    both = arm.replace(' drake:acceleration="8.57"', ' drake:acceleration="8.57" acceleration="4"')
    assert load_robot(both).acceleration_limit[:3].tolist() == [4.0, 4.0, 8.74]
    with pytest.raises(RobotFileError, match="drake:acceleration of <limit> is '8,57'"):
        load_robot(arm.replace('"8.57"', '"8,57"', 1))
    with pytest.raises(RobotFileError, match="acceleration of <limit> is '-1', expected a positive finite number"):
        load_robot(arm.replace('"8.57"', '"-1"', 1))


@settings(deadline=None, max_examples=150, derandomize=True)
@given(
    st.text(st.sampled_from("0123456789.eE+-_, xinf"), min_size=1, max_size=8)
    | st.floats(1e-6, 1e6).map(repr)
    | st.sampled_from(
        ["1.", ".5", "+1", "1e3", "1E-3", "1e+2", "1e-400", "00012", "1f", "1d3", "0b1", "\u0661", " 3", "3 "]
    )
)
def test_a_number_is_refused_or_is_pinocchios(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("urdf") / "r.urdf"
    path.write_text(GRIPPER.replace('mass value="3"', f'mass value="{text}"'), encoding="utf-8")
    try:
        model, *_ = read_models(path)
    except RobotFileError:
        return
    assert model.inertias[4].mass == pytest.approx(1.2 + float(text), rel=1e-12)
    assert re.fullmatch(r"[-+.0-9eE]+", text.strip(" "))


# Pinocchio's models against the file


def edited(collision_model: pin.GeometryModel, number: int, **attributes: object) -> pin.GeometryModel:
    """A copy with a shape changed."""
    copy = pin.GeometryModel()
    for index, shape in enumerate(collision_model.geometryObjects):
        other = shape.copy()
        for name, value in attributes.items() if index == number else ():
            setattr(other, name, value)
        copy.addGeometryObject(other)
    return copy


def test_differences_are_found(tmp_path):
    """Each number that Pinocchio has, changed by a little."""
    path = write(tmp_path, GRIPPER)
    urdf, (clean, shapes, _) = said(path), read_models(path)

    def expect(message: str, model: pin.Model = clean, collision_model: pin.GeometryModel = shapes) -> None:
        with pytest.raises(RobotFileError, match=message):
            check_models(path, urdf, model, collision_model)

    check_models(path, urdf, clean, shapes)
    model = clean.copy()
    model.inertias[4] = pin.Inertia(model.inertias[4].mass - 3.0, model.inertias[4].lever, model.inertias[4].inertia)
    expect("joint 'wrist': Pinocchio reads the inertia of its moving bodies as", model)
    model = clean.copy()
    model.inertias[2] = pin.Inertia(6.0, model.inertias[2].lever + 1e-6, model.inertias[2].inertia)
    expect("joint 'shoulder': Pinocchio reads the inertia", model)
    model = clean.copy()
    model.inertias[0] = pin.Inertia.Zero()
    expect("link 'base_link': Pinocchio reads the inertia of the fixed bodies", model)
    model = clean.copy()
    model.jointPlacements[3] = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 1e-6), model.jointPlacements[3].translation)
    expect("line [0-9]+: joint 'elbow': Pinocchio reads its placement", model)
    for limit in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        model = clean.copy()
        values = getattr(model, limit).copy()
        values[1] += 1e-6
        setattr(model, limit, values)
        expect(f"joint 'shoulder': Pinocchio reads its {limit.split('Pos')[0].removesuffix('Limit')} limit", model)
    model = clean.copy()
    frame = model.frames[model.getBodyId("tool0")]
    frame.placement = frame.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, 1e-6]))
    expect("link 'tool0': Pinocchio reads its place", model)
    model = pin.buildReducedModel(clean, [4], pin.neutral(clean))
    expect("Pinocchio reads 3 moving joints, the file has 4", model)
    flipped = write(tmp_path, GRIPPER.replace(WRIST, WRIST.replace('"0 -1 0"', '"0 1 0"')))
    with pytest.raises(RobotFileError, match=r"'wrist': Pinocchio reads its axis as \[0.0, -1.0, 0.0\], the"):
        check_models(flipped, said(flipped), clean, shapes)

    last = len(shapes.geometryObjects) - 1
    place = shapes.geometryObjects[last].placement
    moved = place * pin.SE3(np.eye(3), np.array([0.0, 1e-6, 0.0]))
    expect(
        "link 'tool0': Pinocchio reads the placement of its box", collision_model=edited(shapes, last, placement=moved)
    )
    expect("the carrier of its box as 3", collision_model=edited(shapes, last, parentJoint=3))
    ball = shapes.geometryObjects[3].geometry
    expect("reads a sphere, the file says box", collision_model=edited(shapes, last, geometry=ball))
    expect("the size of its sphere", collision_model=edited(shapes, 10, geometry=ball))
    fewer = pin.GeometryModel()
    for shape in list(shapes.geometryObjects)[:-1]:
        fewer.addGeometryObject(shape)
    expect("link 'tool0': Pinocchio reads no such <collision>", collision_model=fewer)
    more = edited(shapes, 0)
    more.addGeometryObject(pin.GeometryObject("another", 1, pin.SE3.Identity(), ball))
    expect(f"Pinocchio reads {last + 2} collision shapes, the file has {last + 1}", collision_model=more)


def test_second_reader_has_the_same(tmp_path):
    """yourdfpy shares no line with our reading, nor with Pinocchio's."""
    yourdfpy = pytest.importorskip("yourdfpy")
    text = GRIPPER.replace('<origin xyz="0.8 0 0"/>', '<origin xyz="0.8 0 0.1" rpy="0.3 -0.2 1.1"/>', 1)
    path = write(tmp_path, text)
    ours = said(path)
    theirs = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=False)
    assert set(theirs.link_map) == set(ours.links)
    assert set(theirs.joint_map) == set(ours.joints)
    for name, joint in ours.joints.items():
        other = theirs.joint_map[name]
        origin = np.eye(4) if other.origin is None else other.origin
        np.testing.assert_allclose(joint.placement.homogeneous, origin, atol=1e-12)
        assert (joint.kind, joint.parent, joint.child) == (other.type, other.parent, other.child)
        if joint.kind != "fixed":
            np.testing.assert_array_equal(joint.axis, other.axis)
            assert joint.limits == {key: getattr(other.limit, key) for key in ("lower", "upper", "velocity", "effort")}
    for name, link in ours.links.items():
        other = theirs.link_map[name]
        assert len(link.shapes) == len(other.collisions)
        for shape, collision in zip(link.shapes, other.collisions, strict=True):
            origin = np.eye(4) if collision.origin is None else collision.origin
            np.testing.assert_allclose(shape.placement.homogeneous, origin, atol=1e-12)
            solid = getattr(collision.geometry, shape.kind)
            size = {"box": ["size"], "sphere": ["radius"], "cylinder": ["radius", "length"]}[shape.kind]
            np.testing.assert_array_equal(np.hstack([getattr(solid, key) for key in size]), shape.size)
        assert (link.inertial is None) == (other.inertial is None)
        if link.inertial is not None:
            assert link.inertial.mass == other.inertial.mass
            np.testing.assert_array_equal(link.inertial.inertia, other.inertial.inertia)
            np.testing.assert_allclose(link.inertial.placement.homogeneous, other.inertial.origin, atol=1e-12)
