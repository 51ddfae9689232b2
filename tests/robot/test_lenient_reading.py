"""Files as vendors write them are read; a fault that a motion depends on is reported with all others."""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from toy_urdf import SIX_AXIS_LIMITS, six_axis_arm

from hplan.certificate.digests import robot_digest
from hplan.errors import InputError, MissingVisualWarning, RobotFileError, RobotFileWarning
from hplan.robot.model import Robot, load_robot

ARM = six_axis_arm()
#: The same arm without accelerations in a file next to it.
WITH_ACCELERATIONS = ARM.replace('effort="150"', 'effort="150" acceleration="5"')
ELBOW = '<link name="elbow_link">'
INERTIA = '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
DRAWN = '<visual><geometry><box size="0.07 0.07 0.38"/></geometry>{}</visual>'
BOX = '<geometry><box size="0.07 0.07 0.38"/></geometry>'


def of_elbow(old: str, new: str) -> str:
    """The arm with one edit in its elbow link."""
    before, link, after = WITH_ACCELERATIONS.partition(ELBOW)
    assert old in after
    return before + link + after.replace(old, new, 1)


def write(folder: Path, text: str | bytes, name: str = "arm.urdf") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def quiet(source: Path | str, **options: object) -> Robot:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_robot(source, **options)


def told(source: Path | str, **options: object) -> list[str]:
    """Messages of the warnings about a file that is read."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        load_robot(source, **options)
    return [str(warning.message) for warning in found if warning.category is RobotFileWarning]


HARMLESS = {
    "a second material": (
        ("<collision>", DRAWN.format('<material name="grey"/><material name="red"/>') + "<collision>"),
        "link 'elbow_link': a second <material> in <visual>; one of them would be ignored; it is left out",
    ),
    "a material of a link": (("<collision>", '<material name="grey"/><collision>'), "<material> in <link> has no"),
    "a visual of no size": (
        ("<collision>", '<visual><geometry><box size="0 0,1 0"/></geometry></visual><collision>'),
        "size of <box> is '0 0,1 0', expected 3 finite numbers separated by spaces; the <visual> is left out",
    ),
    "an inertia off by 0.7 %": (
        (INERTIA, INERTIA.replace('izz="0.01"', 'izz="0.0403"')), "larger than the sum of the others; they count"
    ),
    "a tiny inertia": (
        (INERTIA, '<inertia ixx="1e-9" iyy="1e-9" izz="1e-7" ixy="0" ixz="0" iyz="0"/>'), "they count as they are"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HARMLESS)
def test_faults_that_no_motion_depends_on_are_warnings(case):
    edit, message = HARMLESS[case]
    text = of_elbow(*edit)
    (warning,) = told(text)
    assert message in warning
    assert re.match(r"robot file URDF text: line \d+: ", warning)
    plain, robot = load_robot(WITH_ACCELERATIONS), quiet(text)
    assert len(robot.collision_model.geometryObjects) == len(plain.collision_model.geometryObjects)
    if "inertia" not in case:
        assert robot_digest(robot) == robot_digest(plain)


@pytest.mark.parametrize("inertia", ['ixx="0.02" iyy="0.02" izz="0.05"', 'ixx="-0.01" iyy="0.02" izz="0.02"'])
def test_inertia_far_off_is_refused(inertia):
    with pytest.raises(RobotFileError, match="larger than the sum of the others"):
        load_robot(of_elbow('ixx="0.02" iyy="0.02" izz="0.01"', inertia))
    with pytest.warns(RobotFileWarning, match="the smaller ones were raised to"):
        robot = load_robot(of_elbow('ixx="0.02" iyy="0.02" izz="0.01"', inertia), repair_inertia=True)
    assert len([words for words in robot.assumptions if "repair_inertia" in words]) == 1
    plain = load_robot(of_elbow('ixx="0.02" iyy="0.02" izz="0.01"', 'ixx="0.02" iyy="0.02" izz="0.02"'))
    before, after = (
        np.concatenate([np.linalg.eigvalsh(body.inertia) for body in one.model.inertias]).reshape(-1, 3)
        for one in (plain, robot)
    )
    changed = np.flatnonzero(np.abs(before - after).max(axis=1) > 1e-9)
    assert len(changed) == 1  # one joint carries the link
    assert (after[:, 2] <= after[:, 0] + after[:, 1] + 1e-12).all()


def test_malformed_dynamics_are_left_out():
    text = WITH_ACCELERATIONS.replace("<axis", '<dynamics damping="0,5"/><axis', 1)
    assert "the <dynamics> is left out" in told(text)[0]
    assert robot_digest(quiet(text)) == robot_digest(load_robot(WITH_ACCELERATIONS))


def test_collision_shapes_must_be_readable():
    with pytest.raises(RobotFileError, match=r"size of <box> is '0\.07 0,07 0\.38'"):
        load_robot(of_elbow('"0.07 0.07 0.38"', '"0.07 0,07 0.38"'))
    with pytest.raises(RobotFileError, match="a second <inertial> in <link>"):
        load_robot(of_elbow("<inertial>", "<inertial/><inertial>"))


def test_all_faults_are_reported_together(tmp_path):
    text = ARM.replace('velocity="3"', 'velocity="0"', 2).replace('effort="150"/>', "/>", 1)
    text = text.replace('<mass value="2"/>', '<mass value="2,5"/>', 1).replace("<collision>", "<colision>", 1)
    text = text.replace("</collision>", "</colision>", 1).replace('"tool0"', '"flange"')
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, text), tool_frame="tool0")
    faults = caught.value.faults
    for part in (
        "<colision> in <link> has no meaning",
        "'shoulder_pan': <limit> has no effort; a limits file may give it (hplan",
        "'shoulder_pan': velocity of <limit> is '0', expected a positive finite number; a limits file may give",
        "'shoulder_lift': velocity of <limit> is '0'", "value of <mass> is '2,5'", "frame 'tool0': it marks the end",
    ):  # fmt: skip
        assert sum(part in fault for fault in faults) == 1, part
    assert len(faults) == 6
    assert str(caught.value).startswith(f"robot file {tmp_path}/arm.urdf: it has 6 faults:\n  ")
    assert caught.value.data["faults"] == list(faults)
    lines = [int(found[1]) for fault in faults if (found := re.match(r"line (\d+): ", fault))]
    assert lines == sorted(lines)
    assert len(lines) == 5


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "latin-1", "iso-8859-1", "windows-1252"])
def test_other_encodings(tmp_path, encoding):
    text = WITH_ACCELERATIONS.replace('"shoulder_pan"', '"größe"')
    declared = "utf-8" if encoding == "utf-8-sig" else encoding
    path = write(tmp_path, f'<?xml version="1.0" encoding="{declared}"?>{text}'.encode(encoding))
    robot = load_robot(path)
    assert robot.joint_names[0] == "größe"
    assert robot_digest(robot) == robot_digest(load_robot(text))


def test_the_only_frame_at_the_end_is_the_tool_frame():
    text = WITH_ACCELERATIONS.replace('"tool0"', '"tcp"')
    (warning,) = told(text)
    assert "there is no frame 'tool0' at the end of the arm; 'tcp' is taken, the only one; tool_frame=NAME" in warning
    assert quiet(text).tool_frame == "tcp"
    fingers = "".join(
        f'<joint name="{name}" type="prismatic"><parent link="wrist_3_link"/><child link="{name}"/><axis xyz="1 0 0"/>'
        f'<limit lower="0" upper="0.03" velocity="1" effort="9"/></joint><link name="{name}"/>' for name in ("f1", "f2")
    )  # fmt: skip
    gripped = text.replace("</robot>", f"{fingers}</robot>")
    robot = quiet(gripped)
    assert (robot.tool_frame, robot.dof) == ("tcp", 6)
    with pytest.raises(RobotFileError, match=r"selects another frame, for example 'wrist_3_link'"):
        load_robot(gripped.replace('<link name="tcp"/>', "").replace('<child link="tcp"/>', '<child link="f3"/>')
                   .replace("</robot>", '<link name="f3"><collision><geometry><sphere radius="0.01"/></geometry>'
                            "</collision></link></robot>"))  # fmt: skip


# Limits that the URDF lacks


def test_limits_file_gives_velocities_and_efforts(tmp_path):
    path = write(tmp_path, ARM.replace('velocity="3"', 'velocity="0"', 1).replace('effort="150"', 'effort="0"', 1))
    write(tmp_path, SIX_AXIS_LIMITS + "velocity_rad_s: {shoulder_pan: 2.5}\neffort_nm: {shoulder_pan: 80}\n",
          "arm.limits.yaml")  # fmt: skip
    robot = load_robot(path)
    assert robot.velocity_limit.tolist() == [2.5, 3.0, 3.0, 3.0, 3.0, 3.0]
    assert robot.torque_limit.tolist() == [80.0, 150.0, 150.0, 150.0, 150.0, 150.0]
    write(tmp_path, SIX_AXIS_LIMITS + "velocity_rad_s: {shoulder_pam: 2.5}\n", "arm.limits.yaml")
    with pytest.raises(RobotFileError, match=r"velocity of joint 'shoulder_pam': did you mean 'shoulder_pan'\?"):
        load_robot(path)


MOVEIT = """\
default_velocity_scaling_factor: 0.1
joint_limits:
""" + "".join(
    f"  {name}: {{has_velocity_limits: true, max_velocity: 2.0, has_acceleration_limits: true, max_acceleration: 4}}\n"
    for name in re.findall(r"(\w+): 5", SIX_AXIS_LIMITS)
)


def test_joint_limits_of_moveit(tmp_path):
    path, limits = write(tmp_path, ARM), write(tmp_path, MOVEIT + "  finger: {has_velocity_limits: false}\n", "l.yaml")
    robot = load_robot(path, limits=limits)
    assert robot.velocity_limit.tolist() == [2.0] * 6
    assert robot.acceleration_limit.tolist() == [4.0] * 6
    limits.write_text(MOVEIT.replace("has_acceleration_limits: true", "has_acceleration_limits: false", 1))
    with pytest.raises(
        RobotFileError, match=r"joints \['shoulder_pan'\] need has_acceleration_limits: true and a posit"
    ):
        load_robot(path, limits=limits)


# Meshes


def stl(path: Path, corners: np.ndarray) -> Path:
    """Write a tetrahedron."""
    path.parent.mkdir(parents=True, exist_ok=True)
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    rows = [struct.pack("<12fH", 0, 0, 0, *corners[list(face)].ravel(), 0) for face in faces]
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows))
    return path


CORNERS = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.3]])
DAE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="12">{}</float_array>
<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>
"""


def with_mesh(name: str, more: str = "") -> str:
    return of_elbow(BOX, f'<geometry><mesh filename="{name}"{more}/></geometry>')


def extent(robot: Robot) -> np.ndarray:
    """Extent of the elbow's mesh [m]."""
    shape = next(shape for shape in robot.collision_model.geometryObjects if shape.name.startswith("elbow_link"))
    return np.ptp(np.asarray(shape.geometry.vertices()), axis=0)


def test_unit_of_collada_counts(tmp_path):
    (tmp_path / "part.dae").write_text(DAE.format(" ".join(f"{1e3 * number:g}" for number in CORNERS.ravel())))
    np.testing.assert_allclose(extent(load_robot(write(tmp_path, with_mesh("part.dae")))), [0.1, 0.1, 0.3], rtol=1e-6)
    doubled = load_robot(write(tmp_path, with_mesh("part.dae", ' scale="1 1 2"')))
    np.testing.assert_allclose(extent(doubled), [0.1, 0.1, 0.6], rtol=1e-6)


def test_vertices_that_no_arm_has(tmp_path):
    stl(tmp_path / "broken.stl", np.where(CORNERS == 0.3, np.nan, CORNERS))
    with pytest.raises(RobotFileError, match=r"'elbow_link': mesh \S+broken.stl has \d+ vertices that are not finite"):
        load_robot(write(tmp_path, with_mesh("broken.stl")))
    stl(tmp_path / "mm.stl", 1e4 * CORNERS)
    with pytest.raises(RobotFileError, match=r'reaches to 3000 m, expected at most 1000 m; scale="0.001 0.001 0.001"'):
        load_robot(write(tmp_path, with_mesh("mm.stl")))
    np.testing.assert_allclose(
        extent(load_robot(write(tmp_path, with_mesh("mm.stl", ' scale="1e-4 1e-4 1e-4"')))), [0.1, 0.1, 0.3],
        rtol=1e-6,
    )  # fmt: skip
    drawn = of_elbow("<collision>", '<visual><geometry><mesh filename="broken.stl"/></geometry></visual><collision>')
    with pytest.warns(MissingVisualWarning, match="broken.stl"):
        load_robot(write(tmp_path, drawn))


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("meshes/a.stl", "elsewhere/meshes/a.stl"),
        ("package://arm_description/meshes/a.stl", "elsewhere/cloned/meshes/a.stl"),
        ("model://arm_description/meshes/a.stl", "elsewhere/arm_description/meshes/a.stl"),
        ("meshes\\a.stl", "elsewhere/meshes/a.stl"),
    ],
)
def test_meshes_in_a_given_folder(tmp_path, name, place):
    """Relative, in a package whose folder has another name, of Gazebo, and as Windows writes it."""
    file = stl(tmp_path / place, CORNERS)
    write(file.parents[1], "<package><name>arm_description</name></package>", "package.xml")
    path = write(tmp_path / "robot", with_mesh(name))
    robot = load_robot(path, package_dirs=[tmp_path / "elsewhere"])
    np.testing.assert_allclose(extent(robot), [0.1, 0.1, 0.3], rtol=1e-6)


def test_all_missing_meshes_are_named(tmp_path):
    text = with_mesh("nowhere.stl").replace('<sphere radius="0.07"/>', '<mesh filename="package://a/b.stl"/>')
    with pytest.raises(RobotFileError) as caught:
        load_robot(write(tmp_path, text))
    assert [re.search(r"mesh '(\S+)' is not found", fault)[1] for fault in caught.value.faults] == [
        "package://a/b.stl", "nowhere.stl"
    ]  # fmt: skip


# Xacro


def xacro(text: str) -> str:
    return text.replace('<robot name="six_axes">', '<robot name="six_axes" xmlns:xacro="http://ros.org/wiki/xacro">'
        '<xacro:arg name="speed" default="3"/><xacro:include filename="$(find parts)/p.xacro"/>'
    ).replace('velocity="3"', 'velocity="$(arg speed)"').replace("six_axes", "six_axes_$(arg kind)")  # fmt: skip


def test_arguments_and_packages_of_xacro(tmp_path):
    pytest.importorskip("xacrodoc")
    parts = tmp_path / "cloned"
    write(parts, "<package><name>parts</name></package>", "package.xml")
    write(parts, '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:property name="unused" value="1"/></robot>',
          "p.xacro")  # fmt: skip
    path = write(tmp_path / "robots", xacro(WITH_ACCELERATIONS), "arm.urdf.xacro")
    robot = load_robot(path, xacro_args={"kind": "a", "speed": 2})
    assert robot.name == "six_axes_a"
    assert robot.velocity_limit.tolist() == [2.0] * 6
    assert load_robot(path, xacro_args={"kind": "b"}).velocity_limit.tolist() == [3.0] * 6
    with pytest.raises(RobotFileError, match=r"arguments are speed; xacro_args=\{NAME: VALUE\}"):
        load_robot(path)
    (parts / "package.xml").unlink()
    with pytest.raises(RobotFileError, match=r"Package not found: parts; package_dirs=\[FOLDER\]"):
        load_robot(path, xacro_args={"kind": "a"})


def test_arguments_belong_to_xacro(tmp_path):
    with pytest.raises(RobotFileError, match="it is not xacro, and takes no arguments such as 'kind'"):
        load_robot(write(tmp_path, WITH_ACCELERATIONS), xacro_args={"kind": "a"})
    with pytest.raises(InputError, match="xacro_args"):
        load_robot(WITH_ACCELERATIONS, xacro_args=["kind"])
