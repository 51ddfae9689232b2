"""Wrong values raise typed errors that name them, in every public function."""

from __future__ import annotations

import importlib
import inspect
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import hplan
from hplan.apps.cli.job_folder import read_report
from hplan.apps.execution.simulated_arm import Plant
from hplan.apps.execution.simulation import RecordedMotion, execute, read_motion
from hplan.apps.ros import cloud_points, read_bag_cloud, read_moveit_scene, read_octomap, read_planning_scene
from hplan.apps.view.page import write_page
from hplan.apps.view.playback import Playback
from hplan.base.checked import Options
from hplan.base.files import write_text
from hplan.errors import HplanError, InputError, SceneError
from hplan.online.frame import CloudOptions
from hplan.planar.grid import dense_search, reachable_nodes, slices_with_path, two_level_search
from hplan.planar.grid.grid import Grid, Occupancy
from hplan.robot.family.members import HARVESTER, ArmSpec, cross_check, load_member, write_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.file import dump_scene, parse_scene
from hplan.scene.fruit import Fruit
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.obstacles import Box, Capsule, Cylinder, Mesh, PointCloud, Sphere
from hplan.scene.orchard import (
    FruitZone,
    MeasuredOptions,
    OrchardOptions,
    fruit_at_tips,
    generate,
    import_capsules,
    import_tree,
    measured_orchard,
)
from hplan.scene.tracks import Sway, Track
from hplan.study.batch import run_batch
from hplan.study.definition import Study
from hplan.study.run import run_study
from hplan.tour.tour import TourOptions
from hplan.trajectory import corner_grid, limit_shares, limits_of, read_kinematics, read_waypoints, time_waypoints
from hplan.trajectory.corner_rounding import largest_path_deviation, rounded_path

NAN, INF = math.nan, math.inf

#: Values that are not a number, place, text, file or object of hplan.
NO_NUMBER: tuple[Any, ...] = (
    None,
    "1",
    NAN,
    INF,
    -INF,
    [],
    [1.0],
    (),
    {},
    object(),
    True,
    1j,
    np.array([1.0, 2.0]),
    b"1",
)
NO_POSITIVE: tuple[Any, ...] = (*NO_NUMBER, 0.0, -1.0)
NO_VECTOR: tuple[Any, ...] = (None, "123", "abc", 1.0, (), (1.0,), (1.0, 2.0), (1.0, 2.0, 3.0, 4.0), (1.0, 2.0, NAN),
    (1.0, 2.0, INF), (1.0, 2.0, "3"), (1.0, 2.0, None), (1e308, 0.0, 0.0), {"x": 1.0}, object())  # fmt: skip
NO_NAME: tuple[Any, ...] = (None, "", 1, b"name", ["name"], object())
NO_PATH: tuple[Any, ...] = ("", "a\0b", 1, 1.5, b"a", ["a"], object(), NAN)
NO_FILE: tuple[Any, ...] = (*NO_PATH, "/nowhere/at.all", ".")
NO_WHOLE: tuple[Any, ...] = (*NO_NUMBER, 1.5, -1)
NO_MATRIX: tuple[Any, ...] = (None, "12", 1.0, [], [[]], [1.0, 2.0], [[1.0], [1.0, 2.0]], [["a", "b"]], [[NAN] * 4],
    [[INF] * 4], [[None] * 4], [[1j] * 4], np.zeros((2, 3, 4)), {}, object(), np.array([[object()]]))  # fmt: skip
NO_OBJECT: tuple[Any, ...] = (None, "scene", 1.0, [], {}, object(), Path("scene.yaml"))

ROBOT = hplan.load_robot()


def a_cell() -> hplan.Cell:
    start = Start(joints_deg=(0.0, 60.0, 60.0, 60.0))
    return hplan.Cell.from_robots(CellScene(name="c", robots=(CellRobot(name="a", start=start),)), {"a": ROBOT})


START, GOAL = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0, 45.0, 60.0, 70.0))


class NoArray:
    """Claims to be an array, and is not."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no array")


def a_scene(**changes: Any) -> Scene:
    return Scene(**{"name": "a", "start": START, "goal": GOAL, **changes})


def a_planner() -> hplan.Planner:
    obstacles = (
        Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.1),
        Sphere(name="b", center=(3.0, 0, 0), radius=1.0),
    )
    return hplan.Planner(ROBOT, a_scene(obstacles=obstacles))


@cache
def a_running_planner() -> hplan.Planner:
    planner = hplan.Planner(ROBOT, a_scene(), hplan.PlanOptions(effort="quick"))
    planner.plan()
    return planner


def a_trajectory(**changes: Any) -> hplan.Trajectory:
    rows = np.zeros((2, 4))
    fields = {"joint_names": ROBOT.joint_names, "time": [0.0, 1.0],
        "position": rows, "velocity": rows, "acceleration": rows, "torque": rows}  # fmt: skip
    return hplan.Trajectory(**{**fields, **changes})


def free() -> Occupancy:
    return Occupancy.from_mask(Grid.from_limits([0.0, 0.0], [1.0, 1.0], 0.5), np.zeros((3, 3), dtype=np.bool_))


BALL: dict[str, Any] = {"name": "ball", "center": (0.0, 0.0, 0.0), "radius": 0.1}
ROD: dict[str, Any] = {"name": "rod", "start": (0.0, 0.0, 0.0), "end": (0.0, 0.0, 1.0), "radius": 0.1}
BOX: dict[str, Any] = {"name": "box", "center": (0.0, 0.0, 0.0), "size": (0.1, 0.1, 0.1)}
CAN: dict[str, Any] = {"name": "can", "center": (0.0, 0.0, 0.0), "length": 0.2, "radius": 0.03}
TETRA = ([(0.0, 0, 0), (1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
SPEC = {name: getattr(HARVESTER, name) for name in HARVESTER.__dataclass_fields__}

NO_LENGTH = (*NO_POSITIVE, 1e308)
#: Values that are not of a kind.
KINDS: dict[str, tuple[Any, ...]] = {"number": NO_NUMBER, "positive": NO_POSITIVE, "vector": NO_VECTOR,
    "name": NO_NAME, "path": NO_PATH, "file": NO_FILE, "whole": NO_WHOLE, "matrix": NO_MATRIX, "object": NO_OBJECT,
    "length": NO_LENGTH, "size": (*NO_NUMBER, -1.0), "other": NO_OBJECT[1:], "real": NO_NUMBER[1:],
    "count": NO_WHOLE[1:], "place": NO_VECTOR[1:], "turn": NO_VECTOR[:-3]}  # fmt: skip
#: Default arguments by name, unless a case has its own.
USUAL = {
    argument: kind
    for kind, arguments in {
        "name": "name", "vector": "center", "length": "radius", "file": "path", "matrix": "waypoints", "whole": "seed",
        "turn": "rpy_deg", "size": "sigma sigmas tracking_error tracking_delay_s", "positive": "speed deviation_rad",
        "number": "yaw_deg", "count": "workers", "other": "options tour zone fruit_zone",
        "object": "cell grid model motion obstacle occupancy playback result robot scene spec trajectory",
    }.items()
    for argument in arguments.split()
}  # fmt: skip
A_STUDY = {"name": "small", "arms": ("harvester",), "trees": ("tree.csv",)}
#: Replacements for None among valid arguments, and for each argument that must be an object.
OBJECTS = {
    "robot": ROBOT, "scene": a_scene(), "trajectory": a_trajectory(), "motion": a_trajectory(),
    "study": Study(**A_STUDY),
}  # fmt: skip

#: A function, its arguments, and invalid values for each argument.
Case = tuple[Callable[..., Any], dict[str, Any], dict[str, tuple[Any, ...]]]


def case(
    function: Callable[..., Any],
    kinds: str = "",
    bad: Mapping[str, tuple[Any, ...]] = MappingProxyType({}),
    **good: Any,
) -> Case:
    """A function with valid arguments, the unusual kinds, and invalid values."""
    arguments = inspect.signature(function).parameters
    usual = {name: kind for name, kind in USUAL.items() if name in arguments and name not in bad}
    named = usual | dict(word.split(":") for word in kinds.split())
    known = {argument: None for argument, kind in named.items() if kind == "object" and argument in OBJECTS}
    return function, known | good, {argument: KINDS[kind] for argument, kind in named.items()} | dict(bad)


def of_options(kind: type[Options], **good: Any) -> Case:
    """A class of options, with values that the type of each field does not have."""
    return kind, good, {name: wrong_for(hint) for name, hint in get_type_hints(kind).items()}


#: Values that are not of a type.
NONE_OF: dict[Any, tuple[Any, ...]] = {float: NO_NUMBER, int: NO_WHOLE, bool: (None, "no", 1.0, 2), str: NO_NAME,
    tuple: (None, "12", 1.0, (NAN,), (None,)), Literal: (None, "nothing", 1, [])}  # fmt: skip


def wrong_for(hint: Any) -> tuple[Any, ...]:
    members = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kinds = (get_origin(member) or member for member in members)
    values = next((NONE_OF[kind] for kind in kinds if kind in NONE_OF), NO_OBJECT)
    return tuple(value for value in values if value is not None or NoneType not in members)


CASES: dict[str, Case] = {
    **{
        kind.__name__: of_options(kind, **good)
        for kind, good in (
            (hplan.PlanOptions, {}),
            (TourOptions, {"drop_off": GOAL}),
            (hplan.RowOptions, {}),
            (FruitZone, {}),
            (OrchardOptions, {}),
            (MeasuredOptions, {}),
            (ArmSpec, SPEC),
            (CloudOptions, {}),
            (Plant, {}),
        )
    },
    "Sphere": case(Sphere, bad={"kind": ("box", None), "colour": ("red",)}, **BALL),
    "Capsule": case(Capsule, "start:vector end:vector", **ROD),
    "Box": case(Box, "size:vector", **BOX),
    "Cylinder": case(Cylinder, "length:length", **CAN),
    "Track": case(
        Track,
        "about:place",
        {
            "times_s": (*NO_VECTOR[:2], 1.0, ()),
            "shifts_m": (None, "12", ()),
            "rpy_deg": ("up", ((0.0, 0.0, 0.0),), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
            "speed": (1.0,),
        },
        times_s=(0.0, 1.0),
        shifts_m=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
    ),
    "Sway": case(Sway, "direction:vector amplitude_m:length", direction=(0.0, 1.0, 0.0), amplitude_m=0.1),
    "Fruit": case(Fruit, **BALL),
    "Mesh.from_arrays": case(
        Mesh.from_arrays,
        "vertices:matrix faces:matrix scale:length position:vector",
        {"colour": ("red",)},
        name="m",
        vertices=TETRA[0],
        faces=TETRA[1],
    ),
    "PointCloud.of": case(PointCloud.from_points, "points:matrix", name="p", points=TETRA[0], radius=0.1),
    "Mesh.write": case(Mesh.from_arrays("m", *TETRA).write, "path:path", path="m.ply"),
    "Start": case(Start, bad={"joints_deg": (None, "0", 1.0), "joints_rad": ((0.0,),)}, joints_deg=(0.0,)),
    "Goal": case(Goal, "position:place", {"fruit": (None, 1), "approach_deg": NO_NUMBER[1:5]}, fruit="apple"),
    "Scene": case(
        a_scene,
        "name:name",
        {
            "start": (None, "start", (0.0,)),
            "goal": (None, "apple"),
            "clearance": NO_LENGTH[:4],
            "obstacles": (None, "post", 1.0),
            "fruits": (None, (Sphere(**BALL),)),
            "locked_joints": (None, "yaw", (1,)),
        },
    ),
    "Scene.with_obstacles": case(
        a_scene().with_obstacles, bad={"obstacles": (("post",), (None,), (START,))}, obstacles=()
    ),
    "TrackingModel": case(TrackingModel, "still_rad:size delay_s:size"),
    "Trajectory": case(
        a_trajectory,
        "position:matrix velocity:matrix acceleration:matrix torque:matrix",
        {"joint_names": (None, "abcd", 1), "time": (None, "01", [])},
    ),
    "RecordedMotion.from_positions": case(
        RecordedMotion.from_positions,
        "position:matrix",
        {"joint_names": (None, "a", [1]), "time": (None, [], [1.0, 0.0])},
        joint_names=["a"],
        time=[0.0, 1.0],
        position=[[0.0], [1.0]],
    ),
    "plan": case(hplan.plan, bad={"progress": (None, 5, "print")}),
    "finish": case(
        hplan.finish,
        bad={"keep_within_rad": (*NO_POSITIVE[1:], 1e-5)},
        robot=ROBOT,
        scene=a_scene(),
        waypoints=([0.0] * 4, [0.1] * 4),
    ),
    "plan_tour": case(hplan.plan_tour, bad={"fruits": ("apple", 1, [1])}),
    "plan_poses": case(hplan.plan_poses, poses=None),
    "reachable": case(hplan.reachable, bad={"motions": ("yes", 2, None)}, motions=False),
    "load_cell": case(hplan.load_cell, path="cell.yaml"),
    "plan_cell": case(hplan.plan_cell, cell=a_cell()),
    "plan_cell_tour": case(hplan.plan_cell_tour, cell=a_cell()),
    "certify_cell": case(hplan.certify_cell, "check_ends:other", cell=a_cell(), motion=a_cell().join_motions({})),
    "replan_cell": case(hplan.replan_cell, result=None, t=0.5, arm="a"),
    "check": case(
        hplan.check,
        bad={
            "q": (None, "0", [0.0], [NAN] * 4, [[0.0] * 5], [[0.0] * 4, [0.0]]),
            "time_s": ("0", NAN),
            "sigmas": (-1.0, "3", NAN),
        },
        q=[0.0, 0.0, 0.0, 0.0],
    ),
    "warm_up": case(hplan.warm_up),
    "Planner": case(hplan.Planner),
    "Planner.add": case(a_planner().add, obstacle=Sphere(**BALL)),
    "Planner.remove": case(a_planner().remove, name="ball"),
    "Planner.move": case(
        a_planner().move, "center:vector radius:length", {"size": (1.0,), "kind": ("box",)}, name="ball"
    ),
    "Planner.set_cloud": case(
        a_planner().set_cloud,
        bad={
            "points": ("points", 1.0, [1.0]),
            "pose": ("pose", 1.0, [1.0] * 5),
            "joints": ("joints", 1.0, [0.0]),
            "ignore": ("ball", 1, [1]),
            "keep_s": (-1.0, float("nan"), "1"),
            "yields": (-0.001, NAN, "1"),
            "time_s": (float("nan"), "1"),
        },
        name="seen",
        points=[[1.0, 0.5, 1.0]],
        radius=0.01,
    ),
    "Planner.aim": case(
        a_planner().aim,
        bad={"start": ("start", 1.0, GOAL.copy_unchecked({"joints_deg": None})), "goal": ("goal", 1.0, (0.0,) * 4)},
    ),
    "Planner.replan": case(
        lambda **given: a_running_planner().replan(**given),
        bad={"at": (*NO_NUMBER[1:], -1.0, 99.0), "now": (*NO_NUMBER[1:], -1.0, 0.2), "cancel": (1.0, "stop")},
        at=0.1,
    ),
    "Planner.stop_at": case(
        lambda **given: a_running_planner().stop_at(**given), "t:size", {"now": (*NO_NUMBER[1:], -1.0, 99.0)}, t=0.1
    ),
    "Trajectory.stop_at": case(a_trajectory().stop_at, "t:size", t=0.5, robot=ROBOT),
    "Trajectory.scale_speed": case(a_trajectory().scale_speed, "profile:positive", profile=0.5, robot=ROBOT),
    "certify": case(
        hplan.certify,
        "checker:other",
        {
            "rest_to_rest": (None, "no", 1.0),
            "check_ends": (None, "no"),
            "goal_contact": (None, "never", []),
            "begin_s": (None, "1", NAN, math.inf),
        },
    ),
    "execute": case(execute),
    "load_robot": case(hplan.load_robot, "limits:file srdf:file", {"tool_frame": (*NO_NAME[1:], "nothing")}),
    "load_scene": case(hplan.load_scene),
    "parse_scene": case(parse_scene, bad={"text": (None, b"", 1)}, text=""),
    "dump_scene": case(dump_scene, scene=a_scene()),
    "save_scene": case(hplan.save_scene, "path:path", scene=a_scene(), path="a.yaml"),
    "read_csv": case(hplan.read_csv, path="a"),
    "read_motion": case(read_motion, path="a"),
    "write_csv": case(hplan.write_csv, "path:path robot:other", trajectory=a_trajectory(), path="a.csv"),
    "write_text": case(write_text, "path:path", {"text": ("\ud800", None, b"")}, path="a", text=""),
    "Robot.check_configuration": case(
        ROBOT.check_configuration, bad={"q": (None, "0000", 1.0)}, q=[0.0] * 4, which="start"
    ),
    "generate": case(generate, bad={"start_deg": (None, "0", 1.0)}),
    "measured_orchard": case(
        measured_orchard,
        bad={"paths": (None, "p1.csv", []), "start_deg": (None, "0")},
        paths=None,
        options=MeasuredOptions(fruits=2),
    ),
    "import_capsules": case(import_capsules, "position:vector", {"prefix": (None, 1)}, path="p.csv"),
    "import_tree": case(import_tree, "position:vector", {"prefix": (None, 1)}, path="p.csv"),
    "fruit_at_tips": case(
        fruit_at_tips, "count:whole", {"capsules": (None, "rod", [None])}, capsules=[Capsule(**ROD)], count=1
    ),
    "write_robot": case(write_robot, "urdf_path:path", spec=HARVESTER, urdf_path="a.urdf"),
    "load_member": case(load_member, spec=HARVESTER),
    "Study": case(Study, bad={"arms": (None, "arm", 1.0, ()), "trees": (None, "tree", 1.0, ((),))}, **A_STUDY),
    "run_study": case(run_study, "rows:path", {"study": (3, "missing.yaml", ()), "executor": (3, "pool")}, study=None),
    "run_batch": case(
        run_batch,
        "robot:other rows:path trajectories:path",
        {"scenes": (None, 3, [], "table-1", [3], ["missing.yaml"], ["table-1"] * 2), "executor": (3, "pool")},
        scenes=["table-1"],
    ),
    "plan_row": case(hplan.plan_row, bad={"row": (3, "row"), "tour": (3, "tour"), "executor": (3, "pool")}),
    "cross_check": case(cross_check, "urdf_path:file samples:whole", urdf_path="a.urdf"),
    "Grid.from_limits": case(
        Grid.from_limits,
        bad={"lower": (None, "0", 1.0), "upper": (None, [NAN], [INF]), "step": (None, "1", NAN)},
        lower=[0.0],
        upper=[1.0],
        step=0.1,
    ),
    "Occupancy.from_mask": case(
        Occupancy.from_mask,
        bad={"occupied": (None, np.zeros((3, 3)), [[False]])},
        grid=free().grid,
        occupied=np.zeros((3, 3), dtype=np.bool_),
    ),
    **{
        function.__name__: case(
            function,
            bad={"start": (None, "00", (0,), (0.0, 0.0), (9, 9), (NAN, 0), [[0], [0, 1]], 0, NoArray())},
            occupancy=free(),
            start=(0, 0),
            **({} if function is reachable_nodes else {"goal": (2, 2)}),
        )
        for function in (dense_search, reachable_nodes, slices_with_path, two_level_search)
    },
    "rounded_path": case(rounded_path, waypoints=[[0.0] * 4], deviation_rad=0.1),
    "largest_path_deviation": case(
        largest_path_deviation, "positions:matrix", positions=[[0.0] * 4], waypoints=[[0.0] * 4]
    ),
    "limits_of": case(
        limits_of,
        bad={"acceleration": (None, "a", NAN), "jerk": ("a", NAN, -1.0), "torque": (None, "no")},
        model=ROBOT.model,
        acceleration=1.0,
    ),
    "limit_shares": case(limit_shares, "limits:object", trajectory=a_trajectory(), limits=limits_of(ROBOT.model, 1.0)),
    "time_waypoints": case(
        time_waypoints,
        "limits:object rate_hz:positive",
        model=ROBOT.model,
        waypoints=[[0.0] * 4, [0.1] * 4],
        limits=limits_of(ROBOT.model, 1.0),
    ),
    "read_kinematics": case(
        read_kinematics,
        bad={"joints": ("wrist", 1, [1]), "hold": (1, "wrist", {"wrist": "a"})},
        path=str(ROBOT.urdf_path),
    ),
    "read_waypoints": case(read_waypoints, bad={"joint_names": (None, "a", [1])}, path="w.csv", joint_names=["a"]),
    "Trajectory.since": case(a_trajectory().cut_before, "row:whole", row=1),
    "Trajectory.until": case(a_trajectory().cut_after, "row:whole", row=1),
    "Trajectory.positions": case(
        a_trajectory().positions, bad={"clock": (*NO_MATRIX[:3], [NAN], [[0.0]])}, clock=[0.0]
    ),
    "Robot.tool_positions": case(ROBOT.tool_positions, bad={"q": (None, "1234", 1.0)}, q=[0.0] * 4),
    "Playback.from_result": case(Playback.from_result, result=None),
    "Playback": case(Playback, "begin_s:number", {"picked": (None, [], {1: 0.0}), "phases": (None, 1.0, [None])}),
    "write_page": case(write_page, "path:path", playback=Playback(a_trajectory()), path="a.html"),
    "corner_grid": case(corner_grid, "path:object"),
    "read_planning_scene": case(read_planning_scene, "source:file", source={"world": {}}),
    "PlanOptions of an unknown name": case(hplan.PlanOptions, bad={"efort": ("quick", None)}),
    "read_octomap": case(
        read_octomap,
        "source:file name:name position:vector rpy_deg:vector depth:positive",
        source="map.bt",
        name="map",
        position=(0.0, 0.0, 0.0),
        rpy_deg=(0.0, 0.0, 0.0),
        depth=16,
    ),
    "read_bag_cloud": case(
        read_bag_cloud,
        "radius:positive path:file name:name frame:name",
        {"topic": NO_NAME[1:], "time_s": (*NO_NUMBER, -1.0), "rpy_deg": NO_VECTOR[1:-3]},
        path="run.mcap",
        radius=0.01,
        name="c",
        frame="base",
    ),
    "cloud_points": case(cloud_points, bad={"message": (None, {}, 1, "cloud", object())}, message=None),
    "Planner.use": case(a_running_planner().use, "motion:object", motion=None),
    "check of masked values": case(
        hplan.check, bad={"q": (np.ma.masked_array(np.zeros((2, 4)), mask=np.eye(2, 4)),)}, q=[0.0] * 4
    ),
    "Trajectory of a joint twice": case(
        hplan.Trajectory,
        bad={"joint_names": (("a", "a"),)},
        joint_names=("a", "b"),
        time=[0.0],
        position=[[0.0] * 2],
        velocity=[[0.0] * 2],
        acceleration=[[0.0] * 2],
        torque=[[0.0] * 2],
    ),
}


#: Other words for an argument, or for the thing that it does not fit.
WORDS: dict[str, tuple[str, ...]] = {
    "obj": ("scene",),
    "text": ("scene",),
    "faces": ("triangle", "the mesh"),
    "joint_names": ("trajectory: position",),
    "time": ("trajectory: position",),
    "urdf_path": ("limits.yaml",),
    "occupied": ("occupancy mask",),
    "hold": ("joint",),
    "paths": ("capsule file",),
    "q": ("start: ",),
    "source": ("planning scene", "scene", "world", "collision_objects"),
}


def _names(error: HplanError, argument: str, value: Any) -> bool:
    """True if a one-line error names the wrong argument or its value."""
    words = (argument, argument.removesuffix("s"), str(value), repr(value), *WORDS.get(argument, ()))
    return "\n" not in str(error) and any(word in str(error) for word in words)


def calls() -> Iterator[Any]:
    for name, (function, good, bad) in CASES.items():
        for argument, values in bad.items():
            yield pytest.param(function, good, argument, values, id=f"{name} {argument}")


@pytest.mark.parametrize(("function", "good", "argument", "values"), list(calls()))
def test_wrong_value_is_an_error_of_our_own(
    function: Callable[..., Any],
    good: dict[str, Any],
    argument: str,
    values: tuple[Any, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    tree = tmp_path.parent / f"{tmp_path.name}.csv"
    tree.write_text("kind,x1,y1,z1,x2,y2,z2,radius\ntrunk,0,0,0,0,0,1,0.05\nbranch,0,0,1,0.5,0,1.5,0.02\n")
    objects = OBJECTS | {"paths": [tree]}
    given = {name: objects.get(name) if value is None else value for name, value in good.items()}
    wrong = []
    for value in values:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # NumPy's, of numbers too large
                function(**{**given, argument: value})
        except HplanError as error:
            if not _names(error, argument, value):
                wrong.append((value, f"says {error}"))
        except Exception as error:
            wrong.append((value, f"{type(error).__name__}: {error}"))
        else:
            wrong.append((value, "is taken"))
    assert wrong == []
    assert list(tmp_path.iterdir()) == []  # nothing half-written


# Numbers in CSV files


@pytest.mark.parametrize("text", ["1_0", "１", "infinity", "NaN", ""])  # noqa: RUF001
def test_csv_readers_take_plain_decimal_numbers_only(text: str, tmp_path: Path) -> None:
    """Each reader of a CSV, with one cell of it changed."""
    path = tmp_path / "a.csv"
    hplan.write_csv(a_trajectory(), path)
    whole = path.read_text()
    tree = "kind,x1,y1,z1,x2,y2,z2,radius\nbranch,0,0,0,0,0,1,0.0\n"
    readers: list[tuple[str, Callable[[], object]]] = [
        (whole, lambda: hplan.read_csv(path)),
        (whole, lambda: read_motion(path)),
        (whole, lambda: read_waypoints(path, ROBOT.joint_names)),
        (tree, lambda: import_capsules(path)),
    ]
    for content, read in readers:
        head, _, rest = content.partition("\n")
        path.write_text(f"{head}\n{rest.replace('0.0', text, 2)}", encoding="utf-8")
        with pytest.raises(InputError, match=r"line 2: \w+ is '.*', expected a finite number"):
            read()


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.csv", hplan.read_csv),
        ("a.csv", read_motion),
        ("a.csv", lambda path: read_waypoints(path, ["a"])),
        ("a.csv", import_capsules),
        ("a.yaml", lambda path: hplan.load_robot(limits=path)),
        ("a.urdf", hplan.load_robot),
        ("a.yaml", hplan.load_scene),
        ("a.yaml", read_planning_scene),
        ("a.scene", read_moveit_scene),
        ("report.json", read_report),
    ],
)
def test_files_are_read_up_to_a_size(name: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    """A sparse file of a terabyte; and an impossible file name."""
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(
        HplanError, match=r"at least 1,099,511,627,776 bytes; at most \d+,000,000 are read|more than 16"
    ):
        read(path)
    with pytest.raises(HplanError):
        read(tmp_path / ("n" * 300 + path.suffix))


def test_far_too_large_numbers_are_refused_without_a_warning(tmp_path: Path) -> None:
    """Numbers that overflow if squared."""
    text = dump_scene(a_scene(obstacles=(Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.125),)))
    for wrong in ("1e308", "1.0e+200", "-1e155"):
        (tmp_path / "scene.yaml").write_text(text.replace("0.125", wrong).replace("1.9", wrong))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(SceneError):
                hplan.load_scene(tmp_path / "scene.yaml")


def test_scenes_errors_are_value_errors_too() -> None:
    """As pydantic's were, which such code may have expected."""
    with pytest.raises(ValueError, match=r"scene, radius: input should be greater than 0 \(got -1\)") as caught:
        Sphere(name="ball", center=(0.0, 0.0, 0.0), radius=-1)
    assert isinstance(caught.value, SceneError)
    assert (caught.value.where, caught.value.value) == ("radius", -1)
    with pytest.raises(SceneError, match=r"obstacles\[0\]") as caught:
        a_scene(obstacles=({"kind": "sphere", "name": "ball"},))
    assert caught.value.where == "obstacles[0].center"


def test_every_public_function_is_among_the_cases() -> None:
    modules = [
        "hplan",
        "hplan.scene.model",
        "hplan.scene.orchard",
        "hplan.trajectory.timing",
        "hplan.planar.grid",
        "hplan.robot.family.members",
    ]
    names = {name for module in modules for name in getattr(importlib.import_module(module), "__all__", ())}
    results = {"BatchRow", "Cell", "CellResult", "CellTour", "Certificate", "ConfigurationCheck",
        "FruitReach", "HplanError", "PlanResult", "Robot", "TourResult", "LimitShares", "Machine",
        "CrossCheck", "Expansions", "SearchResult", "RowResult", "StageTimes", "StudyResult"}  # fmt: skip
    values = {"AT_LIMIT", "DEVIATION", "Fallback", "HARVESTER", "SHIPPED", "TUCKED_DEG"}
    assert names - results - values <= set(CASES)
