"""Inspects a robot file: all its faults, its joints, tool frames, shapes and touching links."""

from __future__ import annotations

import itertools
import os
import tempfile
import time
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from hplan.base.arrays import FloatArray
from hplan.errors import HplanWarning, RobotFileError, RobotFileWarning
from hplan.robot.faults import Faults
from hplan.robot.files import RobotFiles, robot_files
from hplan.robot.limits_file import ACCELERATION_SCALE, LIMIT_KEYS, LIMITS_FORMAT
from hplan.robot.mesh_files import MeshFinder
from hplan.robot.mjcf import VELOCITY_GUESS
from hplan.robot.model import Robot, load_robot
from hplan.robot.urdf_adaptation import joints_up_to, tool_frames
from hplan.robot.urdf_file import Joint, Urdf, check_inertias, read_urdf
from hplan.robot.urdf_xml import read_urdf_xml
from hplan.robot.xml_element import Element


@dataclass(frozen=True)
class TouchingLinks:
    """Two links that touch at a configuration at which an arm should be free.

    Attributes:
        first: Name of one link.
        second: Name of the other link.
        at: `zero`, `middle` or `zero and middle`: of the joint ranges.
        are_neighbours: Whether there is one joint between them.
    """

    first: str
    second: str
    at: str
    are_neighbours: bool


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a robot file holds, and what it lacks.

    Attributes:
        path: The URDF or xacro file.
        name: Name of the robot; the file's if it has none.
        urdf: Content of the file.
        faults: All faults that prevent loading, each with its line and remedy.
        warnings: What was read differently than it is written, or is not covered.
        joints: The joints that move, from the base on; if the robot cannot be loaded, those up to `tool_frame`.
        tool_frame: The tool frame that is or would be taken.
        tool_frames: Links that may be the tool frame, the likeliest first.
        without_shape: Names of links with a mass or a visual, but without a collision shape.
        touching: Pairs of links that touch at the zero or the middle configuration.
        robot: The robot; with guessed limits if limits are all that is missing, None if it cannot be loaded.
        load_s: Time to load it [s].
    """

    path: Path
    name: str
    urdf: Urdf
    faults: tuple[str, ...]
    warnings: tuple[str, ...]
    joints: tuple[Joint, ...]
    tool_frame: str
    tool_frames: tuple[str, ...]
    without_shape: tuple[str, ...]
    touching: tuple[TouchingLinks, ...]
    robot: Robot | None
    load_s: float


def inspect_robot(path: Path | str, *, tool_frame: str | None = None, **options: Any) -> Inspection:
    """Inspect a robot file; its faults are part of the result.

    Args:
        path: URDF or xacro file, or a name, as for `load_robot`.
        tool_frame: Frame at the end of the arm; None for the default of `load_robot`.
        options: Other arguments of `load_robot`.

    Raises:
        RobotFileError: The file is missing or no URDF.
        InputError: An option does not fit the file, such as a joint to hold that does not exist.
    """
    files = robot_files(path)
    start = time.perf_counter()
    robot, faults, messages = _load_collecting(path, tool_frame=tool_frame, **options)
    load_s = time.perf_counter() - start
    root = _read_root(files, options)
    read = Faults(files.urdf)
    urdf = _without_assumed(read_urdf(files.urdf, root, faults=read), root.assumed)
    frames, _ = tool_frames(urdf)
    frame = tool_frame or (files.tool_frame if files.tool_frame in urdf.links else frames[0])
    joints = joints_up_to(urdf, frame)
    if robot is not None:
        frame, joints = robot.tool_frame, [urdf.joints[name] for name in robot.joint_names]
    elif options.get("limits") is None:
        robot = _with_guessed_limits(path, urdf, joints, tool_frame=frame, **options)
    return Inspection(
        files.urdf,
        str(root.get("name") or files.urdf.name),
        urdf,
        faults,
        messages or tuple(read.mended),
        tuple(joints),
        frame,
        frames,
        tuple(name for name, link in urdf.links.items() if not link.shapes and _has_body(link.element)),
        () if robot is None else _touching_links(robot),
        robot,
        load_s,
    )


def _without_assumed(urdf: Urdf, assumed: Mapping[str, Collection[str]]) -> Urdf:
    """Return the content of a file without the limits that were assumed."""
    joints = {
        name: replace(joint, limits={k: v for k, v in joint.limits.items() if k not in assumed.get(name, ())})
        for name, joint in urdf.joints.items()
    }
    return Urdf(urdf.links, joints)


def _load_collecting(path: Path | str, **options: Any) -> tuple[Robot | None, tuple[str, ...], tuple[str, ...]]:
    """Robot, faults and warnings of loading a file."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", HplanWarning)
        robot, faults = None, tuple[str, ...]()
        try:
            robot = load_robot(path, **options)
        except RobotFileError as error:
            faults = error.faults
    messages = list[str]()
    for warning in found:
        text = str(warning.message)
        if issubclass(warning.category, RobotFileWarning):
            messages += text.partition(": ")[2].split("\n  ")
        elif issubclass(warning.category, HplanWarning):
            messages.append(text.partition(": ")[2])
    return robot, faults, tuple(messages)


def _read_root(files: RobotFiles, options: Mapping[str, Any]) -> Element:
    folders = [*(Path(folder) for folder in options.get("package_dirs", ())), *files.package_dirs]
    return read_urdf_xml(files.urdf, None, folders, {**files.xacro_args, **(options.get("xacro_args") or {})})


def _has_body(link: ET.Element) -> bool:
    return link.find("visual") is not None or link.find("inertial") is not None


def _with_guessed_limits(path: Path | str, urdf: Urdf, joints: Sequence[Joint], **options: Any) -> Robot | None:
    """Load a robot with the limits of `limits_template`; None if it has other faults."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "guessed.limits.yaml")
        file.write_text(limits_template("guessed", urdf, joints), encoding="utf-8")
        return _load_collecting(path, **{**options, "limits": file})[0]


def _touching_links(robot: Robot) -> tuple[TouchingLinks, ...]:
    """Pairs of links on different joints whose shapes touch at the zero or the middle configuration."""
    model, shapes = robot.model, robot.collision_model
    geometries = pin.GeometryData(shapes)
    middle = 0.5 * (robot.lower + robot.upper)
    found: dict[tuple[str, str], list[str]] = {}
    for name, q in (("zero", np.clip(np.zeros(robot.dof), robot.lower, robot.upper)), ("middle", middle)):
        pin.updateGeometryPlacements(model, model.createData(), shapes, geometries, q)
        for i, j in itertools.combinations(range(shapes.ngeoms), 2):
            first, second = shapes.geometryObjects[i], shapes.geometryObjects[j]
            pair = _link_of(first), _link_of(second)
            known = found.get(pair, [])
            if first.parentJoint == second.parentJoint or name in known:
                continue
            request, result = coal.CollisionRequest(), coal.CollisionResult()
            places = [coal.Transform3s(p.rotation, p.translation) for p in (geometries.oMg[i], geometries.oMg[j])]
            if coal.collide(first.geometry, places[0], second.geometry, places[1], request, result):
                found[pair] = [*known, name]
    return tuple(TouchingLinks(*pair, " and ".join(at), _are_neighbours(robot, *pair)) for pair, at in found.items())


def _link_of(shape: pin.GeometryObject) -> str:
    return str(shape.name.rpartition("_")[0])


def _are_neighbours(robot: Robot, first: str, second: str) -> bool:
    joints = [int(robot.model.frames[robot.frame_number(name)].parentJoint) for name in (first, second)]
    parents = robot.model.parents
    return bool(joints[0] == parents[joints[1]] or joints[1] == parents[joints[0]])


def limits_template(name: str, urdf: Urdf, joints: Sequence[Joint]) -> str:
    """Text of a limits file for an arm, with a guess for each limit that the URDF lacks.

    Args:
        name: Name of the robot.
        urdf: The content of its file.
        joints: The joints that move.
    """
    rows: dict[str, list[str]] = {}

    def put(joint: Joint, quantity: str, value: float, why: str) -> None:
        key = LIMIT_KEYS[quantity][joint.kind == "prismatic"]
        rows.setdefault(key, []).append(f"  {joint.name}: {value:.3g}" + (f"  # guess: {why}" if why else ""))

    for joint in joints:
        velocity, effort = joint.limits.get("velocity", 0.0), joint.limits.get("effort", 0.0)
        if not velocity > 0.0:
            velocity = VELOCITY_GUESS[joint.kind == "prismatic"]
            put(joint, "velocity", velocity, "the URDF has no positive velocity")
        if not effort > 0.0:
            put(joint, "effort", _effort_guess(urdf, joint), "twice what its load weighs; the URDF has no effort")
        acceleration = joint.limits.get("acceleration", 0.0)
        guessed = "" if acceleration > 0.0 else f"full speed in {1.0 / ACCELERATION_SCALE:g} s"
        put(joint, "acceleration", acceleration or ACCELERATION_SCALE * velocity, guessed)
        if joint.limits.get("jerk", 0.0) > 0.0:
            put(joint, "jerk", joint.limits["jerk"], "")
    head = f"# Limits of {name}: replace each guess by the number of the data sheet.\nformat: {LIMITS_FORMAT}\n"
    return head + "".join(f"{key}:\n" + "\n".join(lines) + "\n" for key, lines in rows.items())


def _effort_guess(urdf: Urdf, joint: Joint) -> float:
    """Twice an upper bound on the torque or force of gravity at a joint, at least 10 [N m, N]."""
    below: dict[str, list[Joint]] = {}
    for other in urdf.joints.values():
        below.setdefault(other.parent, []).append(other)
    total, waiting = 0.0, [(joint.child, 0.0)]
    for _ in range(len(urdf.links)):
        if not waiting:
            break
        name, away = waiting.pop()
        inertial = urdf.links[name].inertial
        if inertial is not None:
            lever = 1.0 if joint.kind == "prismatic" else away + float(np.linalg.norm(inertial.placement.translation))
            total += 9.81 * inertial.mass * lever
        waiting += [
            (other.child, away + float(np.linalg.norm(other.placement.translation))) for other in below.get(name, ())
        ]
    return max(10.0, 2.0 * total)


def repair_urdf(path: Path, out: Path, **options: Any) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Mend the faults of a URDF that have an obvious remedy.

    Decimal commas, misspelled names, second materials, stray elements, malformed and missing visuals, and inertias that
    no body has are mended. Comments are lost; relative meshes are named from the copy's folder.

    Args:
        path: The URDF or xacro file.
        out: The file that the text is for.
        options: `package_dirs` and `xacro_args` of `load_robot`.

    Returns:
        The text, what was mended, and the faults that remain.

    Raises:
        RobotFileError: The file is missing or no URDF.
    """
    root, faults = _read_root(RobotFiles(path), options), Faults(path, repairs=True)
    meshes = MeshFinder(path, [Path(folder) for folder in options.get("package_dirs", ())])
    urdf = read_urdf(path, root, faults=faults)
    check_inertias(faults, urdf)
    for link, name in meshes.drop_missing_visuals(root, tries=False):
        faults.mend(f"link {link!r}: the visual mesh {name!r} is missing; the <visual> is left out")
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        file = meshes.find(name)
        if "://" not in name and file is not None:
            mesh.set("filename", Path(os.path.relpath(file.resolve(), out.resolve().parent)).as_posix())
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n", tuple(faults.mended), tuple(faults.found)


def shape_triangles(robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    """(n, 3, 3) triangles of each link's shapes at a configuration, in the frame of scenes [m].

    Visual shapes are taken; collision shapes of a link without them.
    """
    import trimesh

    found: dict[str, list[FloatArray]] = {}
    for shapes in (robot.visual_model, robot.collision_model):
        places, done = pin.GeometryData(shapes), set(found)
        pin.updateGeometryPlacements(robot.model, robot.model.createData(), shapes, places, q)
        for shape, place in zip(shapes.geometryObjects, places.oMg, strict=True):
            if _link_of(shape) in done:
                continue
            geometry, kind = shape.geometry, type(shape.geometry).__name__
            if isinstance(geometry, coal.BVHModelBase):
                faces = np.array([[geometry.tri_indices(i)[k] for k in range(3)] for i in range(geometry.num_tris)])
                mesh = trimesh.Trimesh(np.asarray(geometry.vertices()), faces, process=False)
            elif kind == "Box":
                mesh = trimesh.creation.box(2.0 * np.asarray(geometry.halfSide))
            elif kind == "Sphere":
                mesh = trimesh.creation.icosphere(2, geometry.radius)
            elif kind == "Cylinder":
                mesh = trimesh.creation.cylinder(geometry.radius, 2.0 * geometry.halfLength)
            else:
                continue
            triangles = mesh.triangles @ place.rotation.T + place.translation
            found.setdefault(_link_of(shape), []).append(np.asarray(triangles, dtype=np.float64))
    return {name: np.concatenate(parts) for name, parts in found.items()}
