"""Interface packages that have no wheels, built from their fields with ROS's own generators.

The wheels of ROS 2 have the generators and headers, but no build system of ROS. The table below has the fields of the
interfaces that hplan's nodes use; the code that is generated from it serializes them as the packages of a ROS
installation do, so that the messages of the tests are those on the wire. It needs a C++ compiler.

    python tests/ros_interfaces.py FOLDER     # for other programs: put FOLDER on PYTHONPATH
"""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

#: Fields by package and interface, as in the repositories of the packages at the beginning of 2026. A semicolon ends a
#: field; `---` separates the parts of an interface.
FIELDS = {
    "object_recognition_msgs": {"msg/ObjectType": "string key; string db"},
    "tf2_msgs": {"msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"},
    "octomap_msgs": {
        "msg/Octomap": "std_msgs/Header header; bool binary; string id; float64 resolution; int8[] data",
        "msg/OctomapWithPose": "std_msgs/Header header; geometry_msgs/Pose origin; octomap_msgs/Octomap octomap",
    },
    "control_msgs": {
        "msg/JointTolerance": "string name; float64 position; float64 velocity; float64 acceleration",
        "msg/JointComponentTolerance": "string joint_name; uint16 component; float64 position; float64 velocity; "
        "float64 acceleration",
        "action/FollowJointTrajectory": "trajectory_msgs/JointTrajectory trajectory; "
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory; JointTolerance[] path_tolerance; "
        "JointComponentTolerance[] component_path_tolerance; JointTolerance[] goal_tolerance; "
        "JointComponentTolerance[] component_goal_tolerance; builtin_interfaces/Duration goal_time_tolerance; ---; "
        "int32 error_code; string error_string; ---; std_msgs/Header header; string[] joint_names; "
        "trajectory_msgs/JointTrajectoryPoint desired; trajectory_msgs/JointTrajectoryPoint actual; "
        "trajectory_msgs/JointTrajectoryPoint error; int32 index; string[] multi_dof_joint_names; "
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired; "
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual; "
        "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error; int32 multi_dof_index",
    },
    "moveit_msgs": {
        "msg/AllowedCollisionEntry": "bool[] enabled",
        "msg/AllowedCollisionMatrix": "string[] entry_names; AllowedCollisionEntry[] entry_values; "
        "string[] default_entry_names; bool[] default_entry_values",
        "msg/CollisionObject": "std_msgs/Header header; geometry_msgs/Pose pose; string id; "
        "object_recognition_msgs/ObjectType type; shape_msgs/SolidPrimitive[] primitives; "
        "geometry_msgs/Pose[] primitive_poses; shape_msgs/Mesh[] meshes; geometry_msgs/Pose[] mesh_poses; "
        "shape_msgs/Plane[] planes; geometry_msgs/Pose[] plane_poses; string[] subframe_names; "
        "geometry_msgs/Pose[] subframe_poses; byte operation",
        "msg/AttachedCollisionObject": "string link_name; CollisionObject object; string[] touch_links; "
        "trajectory_msgs/JointTrajectory detach_posture; float64 weight",
        "msg/LinkPadding": "string link_name; float64 padding",
        "msg/LinkScale": "string link_name; float64 scale",
        "msg/ObjectColor": "string id; std_msgs/ColorRGBA color",
        "msg/PlanningSceneComponents": "uint32 components",
        "msg/PlanningSceneWorld": "CollisionObject[] collision_objects; octomap_msgs/OctomapWithPose octomap",
        "msg/RobotState": "sensor_msgs/JointState joint_state; sensor_msgs/MultiDOFJointState multi_dof_joint_state; "
        "AttachedCollisionObject[] attached_collision_objects; bool is_diff",
        "msg/RobotTrajectory": "trajectory_msgs/JointTrajectory joint_trajectory; "
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory",
        "msg/DisplayTrajectory": "string model_id; RobotTrajectory[] trajectory; RobotState trajectory_start",
        "msg/PlanningScene": "string name; RobotState robot_state; string robot_model_name; "
        "geometry_msgs/TransformStamped[] fixed_frame_transforms; AllowedCollisionMatrix allowed_collision_matrix; "
        "LinkPadding[] link_padding; LinkScale[] link_scale; ObjectColor[] object_colors; PlanningSceneWorld world; "
        "bool is_diff",
        "srv/GetPlanningScene": "PlanningSceneComponents components; ---; PlanningScene scene",
    },
}

#: Interface packages of the wheels that the table refers to.
BASES = (
    *("action_msgs", "builtin_interfaces", "geometry_msgs", "sensor_msgs", "service_msgs", "shape_msgs", "std_msgs"),
    *("trajectory_msgs", "unique_identifier_msgs"),
)


def missing_tool() -> str:
    """What the generation lacks here; empty if nothing."""
    for module in (
        "rclpy",
        "shape_msgs",
        "rosidl_generator_py",
        "rosidl_typesupport_fastrtps_c",
        "rosidl_adapter",
        "lark",
    ):
        if importlib.util.find_spec(module) is None:
            return f"the Python package {module} is not installed (pip install 'hplan[ros2]')"
    if importlib.util.find_spec("em") is None:
        return "the Python package em is not installed (pip install empy)"
    return "" if shutil.which("g++") else "there is no g++"


def build(folder: Path) -> Path:
    """Generate and compile the packages into a folder, unless they are there; return the folder of this table."""
    table = json.dumps([FIELDS, sys.version_info[:2], Path(__file__).read_text(encoding="utf-8")], sort_keys=True)
    target = folder / f"interfaces-{hashlib.sha256(table.encode()).hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not target.is_dir():
            with tempfile.TemporaryDirectory(dir=folder) as work:
                _build(Path(work), Path(work, "python"))
                Path(work, "python").rename(target)
    return target


def _build(work: Path, python: Path) -> None:
    share = Path(sys.prefix, "share")
    idl = {package: work / "idl" / package for package in FIELDS}
    includes = [f"{name}:{share / name}" for name in BASES] + [f"{name}:{path}" for name, path in idl.items()]
    sources: dict[str, list[Path]] = {"c": [], "cpp": []}
    for package, interfaces in FIELDS.items():
        for kind, source in _generate(work, package, interfaces, idl[package], includes, python):
            sources[kind].append(source)
    flags = ["-O1", "-w", "-fPIC", f"-I{sysconfig.get_path('include')}", f"-I{work / 'c'}", f"-I{work / 'python'}"]
    import numpy as np

    include = Path(sys.prefix, "include")
    flags += [f"-I{np.get_include()}", f"-I{include}", *(f"-I{path}" for path in include.iterdir() if path.is_dir())]
    # Headers take most of the time, so files are compiled together, except those with static names that repeat.
    units = [[path] for path in sources["c"] if path.stem.endswith("__description")]
    units += [[path for path in sources["c"] if not path.stem.endswith("__description")]]
    units += _parts(sources["cpp"], 2)
    jobs = []
    for number, part in enumerate(units):
        compiler, suffix = ("gcc", "c") if part[0].suffix == ".c" else ("g++", "cpp")
        unit = work / f"unit{number}.{suffix}"
        unit.write_text("".join(f'#include "{path}"\n' for path in part), encoding="utf-8")
        jobs.append(subprocess.Popen([compiler, *flags, "-c", str(unit), "-o", f"{unit}.o"]))
    for job in jobs:
        if job.wait():
            raise RuntimeError(f"the compiler failed: {job.args!r}")
    lib = Path(sys.prefix, "lib")
    kinds = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c")
    links = [f"-l{name}__{kind}" for name in BASES for kind in kinds]
    links += ["-lrosidl_runtime_c", "-lrosidl_typesupport_c", "-lrosidl_typesupport_fastrtps_c", "-lrmw", "-lfastcdr"]
    links += ["-lrosidl_typesupport_fastrtps_cpp", f"-L{lib}", f"-Wl,-rpath,{lib}"]
    objects = [str(path) for path in work.glob("unit*.o")]
    library = python / "libhplan_test_interfaces.so"
    subprocess.run(["g++", "-shared", "-o", str(library), *objects, *links], check=True)
    for package in FIELDS:
        entry = python / package / f"_{package}_s.ep.rosidl_typesupport_c.c"
        module = python / package / f"{package}_s__rosidl_typesupport_c.so"
        own = [f"-L{python}", "-lhplan_test_interfaces", "-Wl,-rpath,$ORIGIN/.."]
        subprocess.run(["gcc", *flags, "-shared", "-o", str(module), str(entry), *own, *links], check=True)
    for path in python.rglob("*.c"):
        path.unlink()


def _parts(files: list[Path], count: int) -> list[list[Path]]:
    return [part for part in (files[number::count] for number in range(count)) if part]


def _generate(
    work: Path, package: str, interfaces: dict[str, str], idl: Path, includes: list[str], python: Path
) -> Iterator[tuple[str, Path]]:
    """Write the code of a package; yields the language and the path of each file to compile."""
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c import generate_c
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as generate_typesupport
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c

    for name, fields in interfaces.items():
        part, stem = name.split("/")
        text = Path(part, f"{stem}.{part}")
        (idl / part).mkdir(parents=True, exist_ok=True)
        (idl / text).write_text("\n".join(line.strip() for line in fields.split(";")) + "\n", encoding="utf-8")
        convert_to_idl(idl, package, text, idl)
    tuples = [f"{idl}:{name}.idl" for name in interfaces]
    shared: dict[str, Any] = {"package_name": package, "idl_tuples": tuples, "include_paths": includes}
    shared |= {"ros_interface_dependencies": [], "ros_interface_files": [], "target_dependencies": [__file__]}
    shared |= {"type_description_tuples": [f"{name}.idl:{idl / name}.json" for name in interfaces]}

    def arguments(generator: str, output: Path) -> str:
        path = work / f"{package}-{generator}.json"
        template = Path(sys.prefix, "share", generator, "resource")
        content = {**shared, "output_dir": str(output), "template_dir": str(template)}
        path.write_text(json.dumps(content), encoding="utf-8")
        return str(path)

    code = work / "c" / package
    _write_visibility(code, package)
    generate_type_hash(arguments("rosidl_generator_type_description", idl))
    found = [*generate_c(arguments("rosidl_generator_c", code))]
    found += generate_typesupport_fastrtps_c(arguments("rosidl_typesupport_fastrtps_c", code))
    found += generate_typesupport(arguments("rosidl_typesupport_c", code), ["rosidl_typesupport_fastrtps_c"])
    (python / package).mkdir(parents=True)
    (python / package / "__init__.py").touch()
    for part in {name.split("/")[0] for name in interfaces}:
        (python / package / part).mkdir()
    python_arguments = arguments("rosidl_generator_py", python / package)
    found += generate_py(python_arguments, ["rosidl_typesupport_c"])
    for path in map(Path, found):
        if ".ep." not in path.name and path.suffix in (".c", ".cpp"):
            yield path.suffix[1:], path


def _write_visibility(code: Path, package: str) -> None:
    """The headers that CMake configures."""
    folder = code / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("rosidl_generator_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c"):
        macros = "\n".join(
            f"#define {name.upper()}_{word}{package}" for word in ("PUBLIC_", "EXPORT_", "IMPORT_", "LOCAL_")
        )
        (folder / f"{name}__visibility_control.h").write_text(f"#pragma once\n{macros}\n", encoding="utf-8")


def default_folder() -> Path:
    """Folder of built packages, kept between runs."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"), "hplan", "ros")


if __name__ == "__main__":
    sys.stdout.write(f"{build(Path(sys.argv[1]) if len(sys.argv) > 1 else default_folder())}\n")
