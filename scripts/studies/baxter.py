"""Both arms of a Baxter among shelves: problems of `KavrakiLab/vamp`, as one robot of 14 joints.

Read from a copy of its `resources/baxter` with `problems.tar.bz2` unpacked beside the URDF (`--files DIR`).
The robot is its URDF of balls, as some meshes are not stored there; the balls stand out of the meshes, so that pairs
that its SRDF says never touch are left out. Acceleration limits are not published: 5 rad/s^2 for all joints.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from studies.harness import Asked, Row, Study
from studies.measure import planned, timed
from studies.peers import peer_row

from hplan.apps.ros.planning_scene import read_planning_scene
from hplan.certificate.certificate import certify
from hplan.planning.options import PlanOptions
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start

#: Kinds of problems, and which of each 600 are looked at: every so many.
KINDS, EVERY = ("easy", "medium", "hard"), 10

_ACCELERATION = 5.0

#: What a planner beside hplan has for each problem [s].
PEER_S = 20.0


@cache
def baxter(folder: Path) -> Robot:
    """The robot, with the root that scenes are in called as hplan does."""
    root = ET.fromstring((folder / "baxter_spherized.urdf").read_text())
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for element in root.iter():
        for key in ("name", "link"):
            if element.tag in ("link", "parent", "child") and element.get(key) == "base":
                element.set(key, "base_link")
    names = [joint.get("name", "") for joint in root.iter("joint") if joint.get("type") == "revolute"]
    limits = {"format": "hplan-limits/1", "acceleration_rad_s2": dict.fromkeys(names, _ACCELERATION)}
    srdf = (folder / "baxter.srdf").read_text().replace('="base"', '="base_link"').replace('"Never"', '"By its meshes"')
    with TemporaryDirectory() as scratch:
        files = Path(scratch, "baxter.limits.yaml"), Path(scratch, "baxter.srdf")
        files[0].write_text(yaml.safe_dump(limits))
        files[1].write_text(srdf)
        text, joints = ET.tostring(root, encoding="unicode"), sorted(names, key=lambda name: name[:4] != "left")
        return load_robot(text, joints=joints, tool_frame="left_gripper", limits=files[0], srdf=files[1])


def problems(asked: Asked) -> list[tuple[str, Path, Path]]:
    """Kind, scene and request of each problem."""
    found = []
    for kind in KINDS:
        folder = (asked.files or Path()) / "problems" / f"bookshelf_tall_both_arms_{kind}_baxter"
        scenes = sorted(folder.glob("scene*.yaml"))[::EVERY][: asked.count]
        found += [(kind, scene, scene.with_name(scene.name.replace("scene", "request"))) for scene in scenes]
    return found


def scene_of(robot: Robot, name: str, scene: Path, request: Path) -> Scene:
    """The scene of a problem; ends are moved into the limits where they are a rounding error outside."""
    task = yaml.load(request.read_text(), Loader=yaml.CSafeLoader)
    state = task["start_state"]["joint_state"]
    ends = (
        dict(zip(state["name"], state["position"], strict=True)),
        {each["joint_name"]: each["position"] for each in task["goal_constraints"][0]["joint_constraints"]},
    )
    start, goal = (
        tuple(np.clip([end[joint] for joint in robot.joint_names], robot.lower, robot.upper).tolist()) for end in ends
    )
    obstacles = read_planning_scene(scene)
    return Scene(name=name, obstacles=obstacles, start=Start(joints_rad=start), goal=Goal(joints_rad=goal))


def _row(asked: Asked, problem: tuple[str, Path, Path]) -> Row:
    kind, scene_file, request = problem
    robot = baxter(asked.files or Path())
    scene = scene_of(robot, scene_file.stem, scene_file, request)
    found, row = planned(robot, scene, PlanOptions(effort=asked.effort))
    row |= {"name": f"{kind} {scene_file.stem}", "kind": kind}
    if found is not None:
        _, row["certificate_ms"] = timed(lambda: certify(robot, scene, found.trajectory))
    row |= peer_row(asked, robot, scene, row.get("duration_s"), PEER_S)
    return row | {"missed": not row["solved"] and row.get("peer_solved", False)}


BAXTER = Study(
    "baxter",
    "both arms of a Baxter among shelves (VAMP's problems; --files)",
    _row,
    ("certified", "origin", "missed", "ms", "certificate_ms", "duration_s", "peer_solved", "peer_ms", "to_peer"),
    problems,
    by="kind",
    needs=("files",),
)
