"""MotionBenchMaker's problems for Panda, UR5 and Fetch, as VAMP distributes them.

The folder of `--files` is `resources` of the repository `KavrakiLab/vamp`: robots, meshes, and 7 sets of 100 problems a
robot. A problem has a start and a goal in joint space. Its variants have the goal as a pose (by forward kinematics),
and a load of `LOAD_KG` in the hand. Even numbers are for the final table alone: tune on odd ones (`--first 1 --step
2`).

UR5 (with a Robotiq hand) and Fetch (torso and arm) are VAMP's, with inertias mended, and rolls of Fetch by half a turn
permitted in spite of rounding. The Panda is
example-robot-data's, since VAMP's has no masses. Its fingers are farther apart in the problems than its URDF permits,
and some goals have joint 4 up to 0.07 rad beyond its limit, so both limits are widened.

An outside judge (`studies.outside`) looks at each motion every millisecond, with the meshes of the URDF. Times are also
given in units of the harvester's reference plan, computed in the same process after each problem.
"""

from __future__ import annotations

import re
import tarfile
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import yaml
from studies.harness import Row, Study, StudyConfig
from studies.measure import planned, ratio, timed
from studies.outside import findings, path_is_clear, polyline_is_clear
from studies.peers import RESOLUTION, ompl_path, roboplan_row, seed_ompl, toppra_motion, world_of

from hplan.base.arrays import FloatArray
from hplan.errors import InputError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.robot.files import named_robot
from hplan.robot.model import Robot, load_robot
from hplan.scene.file import load_scene
from hplan.scene.model import Scene
from hplan.scene.obstacles import Box, Cylinder, Obstacle, Sphere

SETS = ("bookshelf_small", "bookshelf_tall", "bookshelf_thin", "box", "cage", "table_pick", "table_under_pick")
GOALS, LOADS = ("joints", "pose"), ("unloaded", "loaded")

#: Problems of a set; mass of the load, and radius of the ball that it fills [kg, m].
COUNT, LOAD_KG, LOAD_M = 100, 3.0, 0.05

#: Use of a limit that counts as a violation: differences of positions a millisecond apart have rounding errors.
OVER = 1.005

#: Distance of an end beyond a joint limit that counts as rounding [rad, m].
ROUNDING = 1e-6

#: Time limit of OMPL [s]; number of reference plans whose median time is the unit.
FIND_S, UNITS = 5.0, 15


@dataclass(frozen=True)
class Model:
    """How to load a robot.

    Attributes:
        tool_frame: Frame of the hand, which carries the load.
        limits: Limits that its URDF lacks, as text or the name of a robot that ships with hplan.
        mended: Patterns of its URDF, and what takes their place.
        hold: Positions of held joints [m].
        is_shipped: True for the URDF of example-robot-data.
    """

    tool_frame: str
    limits: str
    mended: tuple[tuple[str, str], ...]
    hold: Mapping[str, float] | None = None
    is_shipped: bool = False


#: Accelerations of Fetch are those of its MoveIt configuration (`joint_limits.yaml` of `fetch_moveit_config`).
_FETCH_LIMITS = """\
format: hplan-limits/1
acceleration_rad_s2:
  torso_lift_joint: 0.5
  shoulder_pan_joint: 1.5
  shoulder_lift_joint: 1.0
  upperarm_roll_joint: 1.5
  elbow_flex_joint: 1.5
  forearm_roll_joint: 1.5
  wrist_flex_joint: 2.5
  wrist_roll_joint: 2.5
"""

MODELS = {
    "panda": Model(
        "panda_hand",
        "panda",
        (('lower="0.0" upper="0.04"', 'lower="0.0" upper="0.08"'), ('upper="-0.0698"', 'upper="0.0873"')),
        {"panda_finger_joint1": 0.065},
        is_shipped=True,
    ),
    "ur5": Model(
        "robotiq_85_base_link",
        "ur5",
        (
            ('"meshes/', '"package://meshes/'),
            (r' (iyx|izx|izy)="[^"]*"', ""),
        ),
    ),
    "fetch": Model(
        "gripper_link",
        _FETCH_LIMITS,
        (('iyy="0" iyz="0" izz="0"', 'iyy="0.002" iyz="0" izz="0.002"'), (r'3\.14159"', '3.1416"')),
    ),
}

#: Folder of the URDFs: the judge reads them from files.
_FOLDER = TemporaryDirectory()


class Problem(NamedTuple):
    """Robot, set, number from 1, kind of goal and load of a problem."""

    robot: str
    set_name: str
    number: int
    goal: str
    load: str


@cache
def robot_of(folder: Path, name: str, load: str) -> Robot:
    """A robot, with or without the load."""
    model, home = MODELS[name], Path(mkdtemp(dir=_FOLDER.name))
    files = named_robot(name) if model.is_shipped else None
    source = folder / name / f"{name}.urdf" if files is None else files.urdf
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{source}: {error.strerror}", path=str(source)) from error
    for before, after in model.mended:
        text = re.sub(before, after, text)
    if load == "loaded":
        text = text.replace("</robot>", f"{_load(model.tool_frame)}</robot>")
    urdf, limits = home / f"{name}.urdf", model.limits
    urdf.write_text(text, encoding="utf-8")
    if "\n" in limits:
        (home / f"{name}.limits.yaml").write_text(limits, encoding="utf-8")
    if files is None:
        (home / "meshes").symlink_to((folder / name / "meshes").resolve())
    return load_robot(
        urdf,
        limits=None if "\n" in limits else limits,
        tool_frame=model.tool_frame,
        hold=model.hold,
        package_dirs=(home,) if files is None else files.package_dirs,
        srdf=folder / name / f"{name}.srdf" if files is None else None,
    )


def _load(frame: str) -> str:
    """URDF elements of the load, a ball without a shape in the hand."""
    inertia = 0.4 * LOAD_KG * LOAD_M**2
    return f"""<link name="load"><inertial><mass value="{LOAD_KG}"/><inertia ixx="{inertia}" iyy="{inertia}"
        izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="load_joint" type="fixed">
        <parent link="{frame}"/><child link="load"/></joint>"""


@cache
def problems_of(folder: Path, robot: str) -> dict[tuple[str, int], tuple[dict[str, Any], dict[str, Any]]]:
    """Scene and request of each problem of a robot, by set and number."""
    file, found = folder / robot / "problems.tar.bz2", defaultdict[tuple[str, int], dict[str, Any]](dict)
    try:
        with tarfile.open(file, "r:bz2") as archive:
            for member in archive.getmembers():
                path = Path(member.name)
                if path.suffix == ".yaml" and (stream := archive.extractfile(member)) is not None:
                    key = path.parent.name.removesuffix(f"_{robot}"), int(path.stem[-4:])
                    found[key][path.stem[:-4]] = yaml.load(stream.read(), getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (OSError, tarfile.TarError) as error:
        raise InputError(f"{file}: {error}", path=str(file)) from error
    return {key: (parts["scene"], parts["request"]) for key, parts in found.items()}


def scene_of(folder: Path, problem: Problem) -> Scene:
    """A problem as a scene; obstacles of one name are numbered."""
    robot = robot_of(folder, problem.robot, problem.load)
    scene, request = problems_of(folder, problem.robot)[problem.set_name, problem.number]
    state = request["start_state"]["joint_state"]
    start = dict(zip(state["name"], state["position"], strict=True))
    goal = {each["joint_name"]: each["position"] for each in request["goal_constraints"][0]["joint_constraints"]}
    begin, end = (np.array([values[joint] for joint in robot.joint_names]) for values in (start, goal))
    obstacles = obstacles_in(scene, _to_base(robot))
    return Scene.model_validate(
        {
            "format": "hplan-scene/1",
            "name": " ".join(map(str, problem)),
            "start": {"joints_rad": tuple(begin.tolist())},
            "goal": _pose(robot, end) if problem.goal == "pose" else {"joints_rad": tuple(end.tolist())},
            "obstacles": tuple(obstacles),
        }
    )


def obstacles_in(scene: dict[str, Any], place: pin.SE3) -> list[Obstacle]:
    """The obstacles of a problem's scene in another frame, by the pose of the problems' frame in it."""
    items = enumerate(scene["world"]["collision_objects"])
    return [obstacle for number, item in items for obstacle in _obstacles(item, f"{item['id']} {number}", place)]


def _pose(robot: Robot, q: FloatArray) -> dict[str, Any]:
    """Pose of the tool frame at (dof,) joints, as a goal."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    place = data.oMf[robot.model.getFrameId(robot.tool_frame)]
    turn = pin.Quaternion(place.rotation).coeffs()
    return {"position": tuple(place.translation.tolist()), "quaternion_xyzw": tuple(turn.tolist())}


def _to_base(robot: Robot) -> pin.SE3:
    """Pose of the problems' frame, the root of the URDF, in the robot's base frame."""
    root = pin.buildModelFromUrdf(str(robot.urdf_path))
    base = root.getFrameId("base_link") if root.existFrame("base_link") else 0
    return root.frames[base].placement.inverse()


def _obstacles(item: dict[str, Any], name: str, to_base: pin.SE3) -> Iterator[Obstacle]:
    """The primitives of a collision object."""
    own = _placement(item["pose"]) if "pose" in item else pin.SE3.Identity()
    for number, (primitive, pose) in enumerate(zip(item["primitives"], item["primitive_poses"], strict=True)):
        place, size = to_base * own * _placement(pose), primitive["dimensions"]
        keys: dict[str, Any] = {
            "name": f"{name} {number}" if number else name,
            "center": tuple(place.translation.tolist()),
        }
        if primitive["type"] == "sphere":
            yield Sphere(radius=size[0], **keys)
            continue
        keys["rpy_deg"] = tuple(np.degrees(pin.rpy.matrixToRpy(place.rotation)).tolist())
        if primitive["type"] == "box":
            yield Box(size=tuple(size), **keys)
        elif primitive["type"] == "cylinder":
            yield Cylinder(length=size[0], radius=size[1], **keys)
        else:
            raise InputError(f"{name}: unknown primitive {primitive['type']!r}", obstacle=name)


def _placement(pose: dict[str, Any]) -> pin.SE3:
    x, y, z, w = pose.get("orientation", (0.0, 0.0, 0.0, 1.0))
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix(), np.array(pose["position"], dtype=float))


def problems(config: StudyConfig) -> list[Problem]:
    """The problems of a run: robots, sets, goals and loads of `--only`, numbers of `--first`, `--step`, `--count`."""
    numbers = range(max(1, config.first), COUNT + 1, config.step)[: config.count]
    return [
        Problem(robot, set_name, number, goal, load)
        for robot in config.chosen(MODELS)
        for goal in config.chosen(GOALS)
        for load in config.chosen(LOADS)
        for set_name in config.chosen(SETS)
        for number in numbers
    ]


#: Times of the last reference plans in this process [ms].
_REFERENCE: deque[float] = deque(maxlen=UNITS)


@cache
def _reference() -> tuple[Robot, Scene]:
    """Robot and scene of the reference plan, after a first plan: their loading is no part of the unit."""
    robot, scene = load_robot(), load_scene()
    plan(robot, scene)
    return robot, scene


def _unit_ms() -> float:
    """Median time of the harvester's reference plan, with one more run [ms]."""
    for _ in range(1 if _REFERENCE else 3):
        _REFERENCE.append(timed(lambda: plan(*_reference()))[1])
    return float(np.median(_REFERENCE))


def row_of(config: StudyConfig, problem: Problem) -> Row:
    """Results of hplan, and of a peer, for a problem."""
    folder = config.files or Path()
    robot, scene = robot_of(folder, problem.robot, problem.load), scene_of(folder, problem)
    joints = scene if problem.goal == "joints" else scene_of(folder, problem._replace(goal="joints"))
    ends = np.stack([joints.start.configuration, joints.goal.configuration])
    within = bool(((ends > robot.lower - ROUNDING) & (ends < robot.upper + ROUNDING)).all())
    found, row = planned(robot, scene, PlanOptions(effort=config.effort, seed=config.seed))
    variant = [word for word in (problem.goal, problem.load) if word in ("pose", "loaded")]
    title = " ".join([problem.robot, *variant])
    row |= {
        "name": scene.name,
        "group": [title, f"{title}, {problem.set_name}"],
        "free": within and path_is_clear(robot, joints, ends),
        "units": row["ms"] / (unit_ms := _unit_ms()),
        "unit_ms": unit_ms,
    }
    row["missed"] = row["free"] and not row["certified"]
    if found is not None:
        seen = findings(robot, scene, found.trajectory)
        row["contacts"] = seen["contacts"]
        row["limits"] = max(seen["velocity"], seen["acceleration"], seen["torque"])
        row["fault"] |= seen["contacts"] > 0 or seen["outside_deg"] > 1e-6 or row["limits"] > OVER
    if config.peer is None or problem.goal == "pose" or not row["free"]:
        return row
    if config.peer == "roboplan":
        return row | roboplan_row(config, robot, scene, row.get("duration_s"))
    search = _vamp_search(folder, problem, scene) if config.peer == "vamp" else _ompl_search(config, robot, scene)
    path, row["peer_ms"] = timed(search)
    spline, timing_ms = timed(lambda: None if path is None else toppra_motion(robot, path))
    row["peer_solved"], row["peer_motion_ms"] = spline is not None, row["peer_ms"] + timing_ms
    if path is not None:
        row["path_touches"] = not polyline_is_clear(robot, joints, path)
    if spline is not None:
        row["spline_touches"] = findings(robot, scene, spline)["contacts"] > 0
        row["to_spline"] = ratio(row.get("duration_s"), spline.duration)
    return row


def _ompl_search(config: StudyConfig, robot: Robot, scene: Scene) -> Callable[[], FloatArray | None]:
    """The search of RRTConnect for a path."""
    seed_ompl(config.seed + 1)
    world, goal = world_of(robot, scene), scene.goal.configuration
    return lambda: ompl_path(world, scene, goal, seconds=FIND_S, resolution=RESOLUTION)


def _vamp_search(folder: Path, problem: Problem, scene: Scene) -> Callable[[], FloatArray | None]:
    """The search of vamp-planner for a path."""
    from studies.vamp_peer import VampArm

    given, _ = problems_of(folder, problem.robot)[problem.set_name, problem.number]
    obstacles, ends = obstacles_in(given, pin.SE3.Identity()), (scene.start.configuration, scene.goal.configuration)
    arm = VampArm(problem.robot, obstacles, boxes=problem.set_name == "box")
    return lambda: arm.path(*ends)


MOTIONBENCHMAKER = Study(
    "motionbenchmaker",
    "MotionBenchMaker's problems for Panda, UR5, Fetch (--files, VAMP's resources); --peer: roboplan, OMPL, vamp",
    row_of,
    (
        *("free", "certified", "missed", "ms", "units", "duration_s", "contacts", "limits"),
        *("peer_solved", "peer_ms", "peer_motion_ms", "to_spline", "path_touches", "spline_touches"),
        *("to_peer", "peer_touches", "peer_over_limits"),
    ),
    problems=problems,
    by="group",
    count=(None, 1),
    needs=("files",),
    peers=("RRTConnect", "roboplan", "vamp"),
    warm=8,
    choices=(tuple(MODELS), GOALS, LOADS, SETS),
    percentiles=(50, 98, 100),
)
