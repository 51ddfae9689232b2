"""Digests: equal for equal content, different for any difference."""

from __future__ import annotations

import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
from any_arms import GANTRY

import hplan
from hplan.base.data_files import urdf_dir
from hplan.certificate.digests import Digests, robot_digest, scene_digest, trajectory_digest
from hplan.collision.coal_shapes import triangle_tree
from hplan.robot.model import load_robot
from hplan.scene.file import load_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene
from hplan.scene.obstacles import Mesh, PointCloud, Sphere
from hplan.trajectory.trajectory import Trajectory, read_csv, write_csv

CORNERS = np.array([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
GENERAL = load_robot(GANTRY)


@pytest.fixture(scope="module")
def motion(robot, scene):
    return hplan.plan(robot, scene).trajectory


def test_trajectory(motion, tmp_path):
    again = read_csv(write_csv(motion, tmp_path / "t.csv"))
    assert trajectory_digest(again) == trajectory_digest(motion)
    found = {trajectory_digest(motion)}
    for name in ("position", "velocity", "acceleration", "torque"):
        values = np.array(getattr(motion, name))
        values[17, 2] = np.nextafter(values[17, 2], np.inf)
        found.add(trajectory_digest(replace(motion, **{name: values})))
    time = np.array(motion.time)
    time[-1] = np.nextafter(time[-1], np.inf)
    found.add(trajectory_digest(replace(motion, time=time)))
    found.add(trajectory_digest(replace(motion, joint_names=tuple(reversed(motion.joint_names)))))
    found.add(trajectory_digest(Trajectory(motion.joint_names, np.zeros(1), *(np.zeros((1, 4)),) * 4)))
    assert len(found) == 8
    # Zero has no sign in the file.
    zero, minus = np.zeros((1, 4)), -np.zeros((1, 4))
    assert np.signbit(minus).all()
    still = [Trajectory(motion.joint_names, np.zeros(1), values, *(zero,) * 3) for values in (zero, minus)]
    assert trajectory_digest(still[0]) == trajectory_digest(still[1])


def test_scene(scene):
    assert scene_digest(load_scene()) == scene_digest(scene)
    ball = scene.obstacles[0]
    changed = [
        {"name": "other"},
        {"clearance": 1e-3},
        {"locked_joints": ("elbow",)},
        {"goal": Goal(joints_deg=(0.0, 45.0, 60.0, 70.0001))},
        {"obstacles": ()},
        {"obstacles": (ball.model_copy(update={"radius": np.nextafter(ball.radius, 1.0)}),)},
        {"obstacles": (ball.model_copy(update={"sigma": 1e-3}),)},
        {"obstacles": (*scene.obstacles, Sphere(name="b", center=(3.0, 0.0, 0.0), radius=0.1))},
        {"fruits": (Fruit(name="f", center=(3.0, 0.0, 0.0), radius=0.1),)},
    ]
    found = {scene_digest(scene), *(scene_digest(scene.model_copy(update=change)) for change in changed)}
    assert len(found) == 1 + len(changed)


def test_data_of_meshes_and_clouds_count_their_files_do_not(scene, tmp_path):
    mesh, cloud = Mesh.from_arrays("m", CORNERS, FACES), PointCloud.from_points("p", CORNERS + 1.0, 0.1)
    other_mesh, other_cloud = (
        Mesh.from_arrays("m", 1.001 * CORNERS, FACES),
        PointCloud.from_points("p", CORNERS + 1.001, 0.1),
    )
    found = {scene_digest(scene.with_obstacles([item])) for item in (mesh, cloud, other_mesh, other_cloud)}
    assert len(found) == 4
    texts = []
    for folder in ("here", "there"):
        (tmp_path / folder).mkdir()
        mesh.write(tmp_path / folder / f"{folder}.ply")
        text = (
            "format: hplan-scene/1\nname: s\nstart: {joints_deg: [0, 0, 0, 0]}\ngoal: {joints_deg: [0, 0, 0, 1]}\n"
            f"obstacles: [{{kind: mesh, name: m, file: {folder}.ply}}]\n"
        )
        (tmp_path / folder / "scene.yaml").write_text(text)
        texts.append(scene_digest(load_scene(tmp_path / folder / "scene.yaml")))
    assert texts[0] == texts[1]


def test_robot(robot, tmp_path):
    assert robot_digest(load_robot()) == robot_digest(robot)
    for name in ("harvester.urdf", "harvester.limits.yaml"):
        shutil.copy(urdf_dir() / name, tmp_path / name)
    text, limits = (tmp_path / "harvester.urdf").read_text(), (tmp_path / "harvester.limits.yaml").read_text()
    mass, effort = text.rindex('<mass value="') + 13, text.index('effort="') + 8
    variants = {
        "mass": (text[:mass] + "1" + text[mass:], limits),
        "effort": (text[:effort] + "1" + text[effort:], limits),
        "comment": (text.replace("</robot>", "<!-- a comment --></robot>"), limits),
        "limits": (text, limits.replace(": 3", ": 4", 1)),
    }
    found = {}
    for name, (urdf, yaml) in variants.items():
        (tmp_path / "harvester.urdf").write_text(urdf)
        (tmp_path / "harvester.limits.yaml").write_text(yaml)
        found[name] = robot_digest(load_robot(tmp_path / "harvester.urdf"))
    assert found["comment"] == robot_digest(robot)
    assert len(set(found.values())) == len(found)
    allowed = replace(robot, may_touch=(("hand", "turret", "a test"),))
    assert robot_digest(allowed) != robot_digest(robot)


def test_plan_tour_and_certificate_carry_them(robot, scene, motion):
    result = hplan.plan(robot, scene)
    expected = Digests(robot, scene, result.trajectory)
    assert result.certificate.digests == hplan.certify(robot, scene, result.trajectory).digests == expected
    assert result.report["certificate"]["digests"] == expected.as_dict()
    assert pickle.loads(pickle.dumps(expected)) == expected
    assert len({expected, result.certificate.digests}) == 1
    fruit = Fruit(name="f", center=tuple(robot.tool_positions([0.3, 0.4, 0.5, 0.3]).tolist()), radius=0.04)
    orchard = Scene(name="o", start=scene.start, goal=scene.goal, fruits=(fruit,))
    tour = hplan.plan_tour(robot, orchard)
    assert tour.report["certificate"]["digests"] == Digests(robot, orchard, tour.trajectory).as_dict()


GRIPPER = (
    '<joint name="gripper" type="fixed"><parent link="boom_link"/><child link="fingers"/>'
    '<origin xyz="{0} 0 0"/></joint>'
    '<link name="fingers"/></robot>'
)


def test_of_a_general_arm_every_frame_counts():
    """A goal may use any of them."""
    robots = [load_robot(GANTRY.replace("</robot>", GRIPPER.format(place))) for place in (0.1, 0.1, 0.2)]
    assert robots[0].tool_frame == "tool0"
    first, same, other = (robot_digest(robot) for robot in robots)
    assert first == same != other


def test_triangles_of_meshes_count():
    found = set()
    for faces in (FACES, FACES, FACES[:, ::-1], FACES[[0, 1, 2, 2]]):
        robot = replace(GENERAL, collision_model=GENERAL.collision_model.copy())
        robot.collision_model.geometryObjects[0].geometry = triangle_tree(CORNERS, faces)
        found.add(robot_digest(robot))
    assert len(found) == 3
