"""Drawn links without collision shapes: warnings, names, generated shapes."""

from __future__ import annotations

import json
import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import hplan
from hplan.apps.cli.main import main
from hplan.apps.view.page import certificate_words
from hplan.base.data_files import robot_names, shipped_robots
from hplan.certificate.digests import robot_digest
from hplan.errors import MissingVisualWarning, RobotFileError, UncoveredLinkWarning
from hplan.planning.report import certificate_report
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Sphere
from hplan.workcell.cell import load_cell

HERE, THERE, ON_THE_WAY = (0.0, 0.4, 0.9, 0.3, 0.7, 0.0), (1.0, 0.4, 0.9, 0.3, 0.7, 0.0), (0.5, 0.4, 0.9, 0.3, 0.7, 0.0)
TUBE = '<geometry><cylinder radius="0.1" length="0.3"/></geometry>'
FORM = '<geometry><cylinder radius="0.04" length="0.22"/></geometry>'


def body(kind, geometry, xyz="0 0 0.15"):
    return f'<{kind}><origin xyz="{xyz}"/>{geometry}</{kind}>'


def fixed(name, parent, parts, xyz="0 0 0.1"):
    joint = f'<joint name="{name}_mount" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
    return f'<link name="{name}">{parts}</link>{joint}<origin xyz="{xyz}"/></joint>'


def sliding(name, more=""):
    return (
        f'<link name="{name}">{body("visual", FORM)}</link><joint name="{name}_slide" type="prismatic">'
        f'<parent link="l6"/><child link="{name}"/><axis xyz="1 0 0"/>'
        f'<limit lower="0" upper="0.1" velocity="1" effort="2"/>{more}</joint>'
    )


def arm(links=None, more="", base=None):
    """Six joints; `links` replaces the bodies of l1 to l6, `base` the base's."""
    inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    base = body("collision", '<geometry><box size="0.2 0.2 0.1"/></geometry>', "0 0 0") if base is None else base
    found, parent = [f'<robot name="arm"><link name="base_link">{base}</link>'], "base_link"
    for number, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1"), start=1):
        own = (links or {}).get(number, body("collision", FORM))
        own += f'<inertial><origin xyz="0 0 0.15"/><mass value="1"/>{inertia}</inertial>'
        limit = '<limit lower="-2.9" upper="2.9" velocity="2" effort="200" acceleration="8"/>'
        joint = f'<joint name="j{number}" type="revolute"><parent link="{parent}"/><child link="l{number}"/>'
        joint += f'<origin xyz="0 0 {0.12 if number < 3 else 0.32}"/><axis xyz="{axis}"/>{limit}</joint>'
        found.append(f'<link name="l{number}">{own}</link>{joint}')
        parent = f"l{number}"
    return "".join([*found, fixed("tool0", "l6", "", "0 0 0.2"), more, "</robot>"])


def mesh(path):
    return f'<geometry><mesh filename="{path}"/></geometry>'


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A folder with a block in metres, in millimetres, a thousand times smaller, flat, and without triangles."""
    folder = tmp_path_factory.mktemp("meshes")
    for name, scale in (("block", 1.0), ("in_mm", 1e3), ("tiny", 1e-3)):
        trimesh.creation.box(scale * np.array([0.08, 0.08, 0.25])).export(folder / f"{name}.stl")
    flat = trimesh.Trimesh([[0, 0, 0], [0.25, 0, 0], [0, 0.2, 0]], [[0, 1, 2]])
    flat.export(folder / "flat.stl")
    (folder / "empty.stl").write_bytes(bytes(80) + struct.pack("<I", 0))
    return folder


def loaded(text, **options):
    """The robot, and the warnings about it."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        robot = hplan.load_robot(text, **options)
    return robot, [warning for warning in found if warning.category.__module__.startswith("hplan.")]


SEEN = body("visual", TUBE)
UNCOVERED = {
    "a link that moves": (arm({3: SEEN}), ["l3"]),
    "the base": (arm(base=body("visual", TUBE)), ["base_link"]),
    "a camera on a link": (arm(more=fixed("camera", "l6", SEEN)), ["camera"]),
    "a hand on a hand": (arm(more=fixed("hand", "tool0", "") + fixed("finger", "hand", SEEN)), ["finger"]),
    "a finger that is held": (arm(more=sliding("finger")), ["finger"]),
    "a finger that mimics": (arm(more=sliding("one") + sliding("two", '<mimic joint="one_slide"/>')), ["one", "two"]),
    "a link with half a shape": (arm({6: body("collision", FORM) + body("visual", TUBE, "0 0 0.5")}), ["l6"]),
    "a small shape": (arm({3: SEEN + body("collision", '<geometry><sphere radius="1e-4"/></geometry>')}), ["l3"]),
}


@pytest.mark.parametrize("case", UNCOVERED)
def test_drawn_links_without_shapes_are_named_and_can_be_given_some(case):
    text, names = UNCOVERED[case]
    robot, found = loaded(text)
    assert list(robot.uncovered_links) == names
    assert [warning.category for warning in found] == [UncoveredLinkWarning]
    assert all(repr(name) in str(found[0].message) for name in names)
    assert "collision_from_visual=True (--collision-from-visual)" in str(found[0].message)
    for choice in (True, names):
        covered, found = loaded(text, collision_from_visual=choice)
        assert (covered.uncovered_links, found) == ((), [])
        assert robot_digest(covered) != robot_digest(robot)
        shapes = {
            str(covered.model.frames[shape.parentFrame].name) for shape in covered.collision_model.geometryObjects
        }
        assert shapes >= set(names)


def test_frames_and_covered_links_are_not_named():
    within = body("visual", '<geometry><sphere radius="0.02"/></geometry>')
    for text in (
        arm(),
        arm(more=fixed("frame", "l6", "")),
        arm({3: body("collision", TUBE) + SEEN}),
        arm(more=fixed("board", "l3", within, "0 0 0")),  # inside the shape of the link that it is fixed to
        arm({3: body("collision", TUBE) + body("visual", FORM)}),
    ):
        robot, found = loaded(text)
        assert (robot.shape_faults, found) == ((), [])


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_are_covered(name):
    robot, found = loaded(name)
    assert (robot.shape_faults, found) == ((), [])


@pytest.mark.parametrize("name", sorted(set(robot_names()) - set(shipped_robots())))
def test_robots_by_name_are_covered(name):
    try:
        robot, found = loaded(name)
    except hplan.errors.InputError as error:
        pytest.skip(str(error))
    assert (robot.shape_faults, found) == ((), [])


@pytest.mark.parametrize(("mesh_name", "words"), [("tiny", "other units"), ("flat", "flat collision shape")])
def test_shapes_of_other_size_are_reported(meshes, mesh_name, words):
    drawn = body("visual", mesh(meshes / "block.stl"))
    text = arm({3: drawn + body("collision", mesh(meshes / f"{mesh_name}.stl"))})
    robot, found = loaded(text)
    assert robot.uncovered_links == ("l3",)
    assert words in str(found[0].message)
    covered, found = loaded(text, collision_from_visual=True)
    assert (covered.shape_faults, found) == ((), [])
    assert covered.collision_model.ngeoms == robot.collision_model.ngeoms  # it takes the wrong one's place


def test_oversized_shapes_are_reported_and_cover(meshes):
    """A collision mesh in millimetres holds the link: nothing is missed, but nothing can be planned either."""
    drawn = body("visual", mesh(meshes / "block.stl"))
    robot, found = loaded(arm({3: drawn + body("collision", mesh(meshes / "in_mm.stl"))}))
    assert robot.uncovered_links == ()
    assert "0.274 m across as drawn, but its collision shape is 274 m" in str(found[0].message)


def test_empty_collision_meshes_are_refused_or_built_anew(meshes):
    drawn, empty = (
        body(kind, mesh(meshes / name)) for kind, name in (("visual", "block.stl"), ("collision", "empty.stl"))
    )
    with pytest.raises(RobotFileError, match=re.escape("collision_from_visual=['l3']")):
        hplan.load_robot(arm({3: drawn + empty}))
    for choice in (True, ["l3"]):
        robot, found = loaded(arm({3: drawn + empty}), collision_from_visual=choice)
        assert (robot.shape_faults, found) == ((), [])


@pytest.mark.parametrize("file", ["missing.stl", "package://nowhere/missing.stl", "empty.stl"])
def test_missing_visual_meshes_are_warnings(meshes, file):
    path = file if ":" in file else str(meshes / file)
    robot, found = loaded(arm({3: body("collision", FORM) + body("visual", mesh(path))}))
    assert [warning.category for warning in found] == [MissingVisualWarning]
    assert path in str(found[0].message)
    assert robot_digest(robot) == robot_digest(loaded(arm())[0])
    # A link whose mesh is unreadable still has its generated shape in the certificate.
    robot, found = loaded(arm({3: body("visual", mesh(path))}), collision_from_visual=True)
    assert robot.uncovered_links == ("l3",)
    assert [warning.category for warning in found] == [MissingVisualWarning, UncoveredLinkWarning]
    with pytest.raises(RobotFileError, match="no <visual>, or none whose mesh file exists"):
        loaded(arm({3: body("visual", mesh(path))}), collision_from_visual=["l3"])


def test_missing_collision_meshes_are_still_refused(meshes):
    with pytest.raises(RobotFileError, match=r"missing\.stl' is not found"):
        hplan.load_robot(arm({3: body("collision", mesh(meshes / "missing.stl"))}))


@pytest.mark.parametrize(
    ("names", "words"), [(["l33"], "no link 'l33'; did you mean 'l3'"), (["l2"], "'l2' has no <visual>")]
)
def test_links_that_cannot_be_shaped_are_refused(names, words):
    with pytest.raises(RobotFileError, match=re.escape(words)):
        hplan.load_robot(arm({3: SEEN}), collision_from_visual=names)


def branch(robot, points, q, frame):
    """A ball at one of (n, 3) points of a link, and the motion through it."""
    pose = robot.forward_kinematics(np.array(q), frame)
    far = points[np.linalg.norm(points, axis=1).argmax()]
    return Sphere(name="branch", center=tuple(pose[:3, :3] @ far + pose[:3, 3]), radius=0.01)


def test_certificate_report_and_page_name_uncovered_shapes():
    robot, _ = loaded(arm({3: SEEN}))
    points = np.array([[0.1, 0.0, 0.3], [0.1, 0.0, 0.0]])
    ball = branch(robot, points, ON_THE_WAY, "l3")
    scene = Scene(name="s", start=Start(joints_rad=HERE), goal=Goal(joints_rad=THERE), obstacles=(ball,))
    result = hplan.plan(robot, scene)
    again = hplan.certify(robot, scene, result.trajectory)
    for certificate in (result.certificate, again, again.reversal):
        assert certificate.uncovered_links == ("l3",)
    report = certificate_report(again, hplan.PlanOptions(), scene)
    assert report["uncovered_links"] == ["l3"]
    assert result.report["certificate"]["uncovered_links"] == ["l3"]
    assert "Not covered, because drawn without a matching collision shape: l3" in certificate_words(again)[1]
    # With shapes from the visual the same motion is refused.
    covered, _ = loaded(arm({3: SEEN}), collision_from_visual=True, allow_neighbours=True)
    refused = hplan.certify(covered, scene, result.trajectory)
    assert (refused.verified, refused.nearest.link, refused.uncovered_links) == (False, "l3", ())


def test_commands_name_uncovered_shapes_and_build_shapes(tmp_path, capfd):
    (tmp_path / "arm.urdf").write_text(arm({3: SEEN}))
    (tmp_path / "scene.yaml").write_text(
        f"format: hplan-scene/1\nname: s\nstart: {{joints_rad: {list(HERE)}}}\ngoal: {{joints_rad: {list(THERE)}}}\n"
    )
    of = ["plan", str(tmp_path / "scene.yaml"), "--robot", str(tmp_path / "arm.urdf"), "--allow-neighbours"]
    assert main([*of, "--out", str(tmp_path / "a")]) == 0
    out, err = capfd.readouterr()
    assert "not covered" in out
    assert "warning: robot 'arm'" in err
    assert json.loads((tmp_path / "a" / "report.json").read_text())["certificate"]["uncovered_links"] == ["l3"]
    again = ["certify", str(tmp_path / "a" / "trajectory.csv"), *of[1:]]
    assert main(again) == 0
    assert "not covered" in capfd.readouterr().out
    for more in (["--collision-from-visual"], ["--collision-from-visual", "l3"]):
        folder = tmp_path / f"b{len(more)}"
        assert main([*of, *more, "--out", str(folder)]) == 0
        out, err = capfd.readouterr()
        assert ("not covered" in out, err) == (False, "")
        assert "uncovered_links" not in json.loads((folder / "report.json").read_text())["certificate"]


def test_cells_name_the_links_of_each_robot(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm({3: SEEN}))
    robot = f"robot: arm.urdf, start: {{joints_rad: {list(HERE)}}}"
    (tmp_path / "cell.yaml").write_text(
        f"format: hplan-scene/1\nname: cell\nrobots:\n- {{name: a, {robot}}}\n"
        f"- {{name: b, {robot}, position: [3, 0, 0], collision_from_visual: true}}\n"
    )
    with pytest.warns(UncoveredLinkWarning) as found:
        cell = load_cell(tmp_path / "cell.yaml")
    assert len(found) == 1
    assert cell.robot.uncovered_links == ("a_l3",)


def data_folder():
    cmeel = pytest.importorskip("cmeel", reason="example-robot-data is not installed (extra `robots`)")
    folder = Path(cmeel.__file__).parents[1] / "cmeel.prefix/share/example-robot-data/robots"
    if not folder.is_dir():
        pytest.skip("example-robot-data is not installed (extra `robots`)")
    return folder


def test_hand_of_a_public_robot(tmp_path):
    """SO-100: gripper and jaw are drawn only; a branch in the plastic was certified without a word."""
    folder = data_folder() / "so_arm_description"
    joints = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    (tmp_path / "limits.yaml").write_text(
        "format: hplan-limits/1\nacceleration_rad_s2: {" + ", ".join(f"{name}: 5" for name in joints) + "}\n"
    )
    options = {"tool_frame": "gripper", "limits": tmp_path / "limits.yaml"}
    robot, found = loaded(folder / "urdf/so100.urdf", **options)
    assert robot.uncovered_links == ("gripper", "jaw")
    assert len(found) == 1
    hand = trimesh.load(folder / "meshes/so100/Fixed_Jaw.stl", force="mesh").vertices
    ball = branch(robot, 0.75 * hand, (0, 1.6, -1.6, 0, 0), "gripper")
    ends = {"start": Start(joints_rad=(-1, 1.6, -1.6, 0, 0)), "goal": Goal(joints_rad=(1, 1.6, -1.6, 0, 0))}
    scene = Scene(name="branch", obstacles=(ball,), **ends)
    result = hplan.plan(robot, scene)
    assert result.certificate.uncovered_links == ("gripper", "jaw")
    covered, found = loaded(folder / "urdf/so100.urdf", **options, collision_from_visual=True, allow_neighbours=True)
    assert (covered.shape_faults, found) == ((), [])
    refused = hplan.certify(covered, scene, result.trajectory)
    assert (refused.verified, refused.nearest.link) == (False, "gripper")


PUBLIC = {
    "z1_description/urdf/z1.urdf": {"link01", "link05"},
    "xarm_description/urdf/xarm7.urdf": set(),
    "kinova_description/robots/kinova.urdf": set(),
    "so_arm_description/urdf/so101.urdf": set(),
    "ur_description/urdf/ur5_gripper.urdf": set(),
    "talos_data/robots/talos_left_arm.urdf": set(),
    "panda_description/urdf/panda_collision.urdf": set(),
}


@pytest.mark.parametrize("file", PUBLIC)
def test_public_robots(file):
    import pinocchio as pin

    from hplan.robot.drawn_links import find_shape_faults

    folder = data_folder()
    models = pin.buildModelsFromUrdf(str(folder / file), package_dirs=[str(folder.parents[1]), str(folder.parent)])
    assert {fault.link for fault in find_shape_faults(*models)} == PUBLIC[file]


def test_size_of_a_drawn_link_is_compared_in_any_pose():
    """A shape and a visual of one size fit, however each is turned about the link."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        rpy, size = rng.uniform(-3, 3, 3), rng.uniform(0.05, 0.4, 3)
        turn, edges = (" ".join(map(str, numbers)) for numbers in (rpy, size))
        block = f'<origin xyz="0 0 0.15" rpy="{turn}"/><geometry><box size="{edges}"/></geometry>'
        text = arm({3: f"<collision>{block}</collision><visual>{block}</visual>"})
        assert loaded(text)[0].shape_faults == ()
