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
from typing import Any

import numpy as np
import yaml
from studies.harness import Asked, Row, Study
from studies.measure import timed
from studies.peers import peer_row

from hplan.certificate.certificate import certify
from hplan.errors import HplanError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.model import Robot, load_robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Cylinder
from hplan.scene.solids import quaternion_rotation, rpy_of

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
    world, task = (yaml.load(path.read_text(), Loader=yaml.CSafeLoader) for path in (scene, request))
    obstacles = []
    for item in world["world"]["collision_objects"]:
        for number, (shape, pose) in enumerate(zip(item["primitives"], item["primitive_poses"], strict=True)):
            place: dict[str, Any] = {
                "name": f"{item['id']} {number}",
                "center": tuple(map(float, pose["position"])),
                "rpy_deg": rpy_of(quaternion_rotation(pose["orientation"])),
            }
            size = tuple(map(float, shape["dimensions"]))
            solid = (
                Box(**place, size=size) if shape["type"] == "box" else Cylinder(**place, length=size[0], radius=size[1])
            )
            obstacles.append(solid)
    state = task["start_state"]["joint_state"]
    ends = (
        dict(zip(state["name"], state["position"], strict=True)),
        {each["joint_name"]: each["position"] for each in task["goal_constraints"][0]["joint_constraints"]},
    )
    start, goal = (
        tuple(np.clip([end[joint] for joint in robot.joint_names], robot.lower, robot.upper).tolist()) for end in ends
    )
    return Scene(name=name, obstacles=tuple(obstacles), start=Start(joints_rad=start), goal=Goal(joints_rad=goal))


def _row(asked: Asked, problem: tuple[str, Path, Path]) -> Row:
    kind, scene_file, request = problem
    row: Row = {"name": f"{kind} {scene_file.stem}", "kind": kind, "solved": False}
    robot = baxter(asked.files or Path())
    scene = scene_of(robot, scene_file.stem, scene_file, request)
    try:
        result, milliseconds = timed(lambda: plan(robot, scene, PlanOptions(effort=asked.effort)))
    except HplanError as error:
        row |= {"how": error.kind, "message": error.message}
    else:
        certificate, proof_ms = timed(lambda: certify(robot, scene, result.trajectory))
        row |= {
            "solved": certificate.verified, "how": "certified", "s": 1e-3 * milliseconds, "certificate_ms": proof_ms,
            "duration_s": result.trajectory.duration, "fault": not certificate.verified,
        }  # fmt: skip
    row |= peer_row(asked, robot, scene, row.get("duration_s"), PEER_S)
    return row | {"missed": not row["solved"] and row.get("peer_solved", False)}


BAXTER = Study(
    "baxter",
    "both arms of a Baxter among shelves (VAMP's problems; --files)",
    _row,
    ("solved", "how", "missed", "s", "certificate_ms", "duration_s", "peer_solved", "peer_ms", "to_peer"),
    problems,
    by="kind",
    needs=("files",),
)
