"""A wrong value is an error of hplan's own that names what is wrong, whatever public function or class is given it."""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hplan
from hplan.apps.cli.job_folder import read_report
from hplan.apps.execution.recorded_motion import RecordedMotion, read_motion
from hplan.apps.execution.simulation import execute
from hplan.apps.ros import read_moveit_scene, read_planning_scene
from hplan.apps.view.page import write_page
from hplan.apps.view.playback import Playback
from hplan.base.files import write_text
from hplan.errors import HplanError, InputError, SceneError
from hplan.grid import dense_search, reachable, slices_with_path, two_level_search
from hplan.grid.grid import Grid, Occupancy
from hplan.robot.family.members import HARVESTER, ArmSpec, cross_check, load_member, write_robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.cell import CellRobot, CellScene
from hplan.scene.file import dump_scene, parse_scene
from hplan.scene.model import Fruit, Goal, Scene, Start
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
from hplan.study.definition import Study
from hplan.study.run import run_study
from hplan.tour.tour import TourOptions
from hplan.trajectory import corner_grid, limit_shares, limits_of, read_machine, read_waypoints, time_waypoints
from hplan.trajectory.corner_rounding import largest_deviation, rounded_path

NAN, INF = math.nan, math.inf

#: What no number is, and no place, text, file or object of hplan's.
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
    return hplan.Cell.of(CellScene(name="c", robots=(CellRobot(name="a", start=start),)), {"a": ROBOT})


START, GOAL = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0, 45.0, 60.0, 70.0))


class NoArray:
    """Says that it is an array, and is none."""

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
    return Occupancy.from_mask(Grid.over([0.0, 0.0], [1.0, 1.0], 0.5), np.zeros((3, 3), dtype=np.bool_))


BALL: dict[str, Any] = {"name": "ball", "center": (0.0, 0.0, 0.0), "radius": 0.1}
ROD: dict[str, Any] = {"name": "rod", "start": (0.0, 0.0, 0.0), "end": (0.0, 0.0, 1.0), "radius": 0.1}
BOX: dict[str, Any] = {"name": "box", "center": (0.0, 0.0, 0.0), "size": (0.1, 0.1, 0.1)}
CAN: dict[str, Any] = {"name": "can", "center": (0.0, 0.0, 0.0), "length": 0.2, "radius": 0.03}
TETRA = ([(0.0, 0, 0), (1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
SPEC = {name: getattr(HARVESTER, name) for name in HARVESTER.__dataclass_fields__}

NO_LENGTH = (*NO_POSITIVE, 1e308)
#: Values that are none of a kind.
KINDS: dict[str, tuple[Any, ...]] = {"number": NO_NUMBER, "positive": NO_POSITIVE, "vector": NO_VECTOR,
    "name": NO_NAME, "path": NO_PATH, "file": NO_FILE, "whole": NO_WHOLE, "matrix": NO_MATRIX, "object": NO_OBJECT,
    "length": NO_LENGTH, "size": (*NO_NUMBER, -1.0)}  # fmt: skip
A_STUDY = {"name": "small", "arms": ("harvester",), "trees": ("tree.csv",)}
#: A function, what it is given, the kind of each argument, and values that others cannot have.
Case = tuple[Callable[..., Any], dict[str, Any], str, dict[str, tuple[Any, ...]]]
CASES: dict[str, Case] = {
    "Sphere": (
        Sphere,
        BALL,
        "name:name center:vector radius:length sigma:size",
        {"kind": ("box", None), "colour": ("red",)},
    ),
    "Capsule": (Capsule, ROD, "name:name start:vector end:vector radius:length", {}),
    "Box": (Box, BOX, "name:name center:vector size:vector", {"rpy_deg": NO_VECTOR[:-3]}),
    "Cylinder": (Cylinder, CAN, "name:name center:vector length:length radius:length", {"rpy_deg": NO_VECTOR[:-3]}),
    "Track": (
        Track,
        {"times_s": (0.0, 1.0), "shifts_m": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))},
        "",
        {
            "times_s": (*NO_VECTOR[:2], 1.0, ()),
            "shifts_m": (None, "12", ()),
            "rpy_deg": ("up", ((0.0, 0.0, 0.0),), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
            "about": NO_VECTOR[1:],
            "speed": (1.0,),
        },
    ),
    "Sway": (Sway, {"direction": (0.0, 1.0, 0.0), "amplitude_m": 0.1}, "direction:vector amplitude_m:length", {}),
    "Fruit": (Fruit, BALL, "name:name center:vector radius:length", {}),
    "Mesh.of": (
        Mesh.of,
        {"name": "m", "vertices": TETRA[0], "faces": TETRA[1]},
        "name:name vertices:matrix faces:matrix scale:length position:vector",
        {"colour": ("red",)},
    ),
    "PointCloud.of": (
        PointCloud.of,
        {"name": "p", "points": TETRA[0], "radius": 0.1},
        "points:matrix name:name radius:length",
        {},
    ),
    "Mesh.write": (Mesh.of("m", *TETRA).write, {"path": "m.ply"}, "path:path", {}),
    "Start": (Start, {"joints_deg": (0.0,)}, "", {"joints_deg": (None, "0", 1.0), "joints_rad": ((0.0,),)}),
    "Goal": (
        Goal,
        {"fruit": "apple"},
        "",
        {"fruit": (None, 1), "position": NO_VECTOR[1:], "approach_deg": NO_NUMBER[1:5]},
    ),
    "Scene": (
        a_scene,
        {},
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
    "Scene.with_obstacles": (
        a_scene().with_obstacles,
        {"obstacles": ()},
        "",
        {"obstacles": (("post",), (None,), (START,))},
    ),
    "PlanOptions": (
        hplan.PlanOptions,
        {},
        "step_deg:positive rate_hz:length speed:positive tracking_error:size tracking_delay_s:size sigmas:size",
        {
            "method": (None, "fast", 1),
            "objective": (None, "fun"),
            "link_model": (None, "x", []),
            "standoff": (*NO_NUMBER[1:], -1.0),
            "certify": (None, "no", 1.0),
        },
    ),
    "TrackingModel": (TrackingModel, {}, "still_rad:size delay_s:size", {}),
    "TourOptions": (
        TourOptions,
        {"drop_off": GOAL},
        "grasps:whole",
        {
            "drop_off": ("there", 1.0, Goal(fruit="apple")),
            "every": (0, -1, 1.5),
            "order": (None, "worst", []),
            "back": (None, "yes"),
            "compare": (None, 1.0),
        },
    ),
    "Trajectory": (
        a_trajectory,
        {},
        "",
        {
            "joint_names": (None, "abcd", 1),
            "time": (None, "01", []),
            **dict.fromkeys(("position", "velocity", "acceleration", "torque"), NO_MATRIX),
        },
    ),
    "RecordedMotion.from_positions": (
        RecordedMotion.from_positions,
        {"joint_names": ["a"], "time": [0.0, 1.0], "position": [[0.0], [1.0]]},
        "position:matrix",
        {"joint_names": (None, "a", [1]), "time": (None, [], [1.0, 0.0])},
    ),
    "plan": (
        lambda **given: hplan.plan(**given),
        {"robot": None, "scene": None},
        "robot:object scene:object",
        {"options": NO_OBJECT[1:]},
    ),
    "finish": (
        lambda **given: hplan.finish(**given),
        {"robot": ROBOT, "scene": a_scene(), "waypoints": ([0.0] * 4, [0.1] * 4)},
        "robot:object scene:object waypoints:matrix",
        {"options": NO_OBJECT[1:], "keep_within_rad": (*NO_POSITIVE[1:], 1e-5)},
    ),
    "plan_poses": (
        lambda **given: hplan.plan_poses(**given),
        {"robot": None, "scene": None, "poses": None},
        "robot:object scene:object",
        {"options": NO_OBJECT[1:]},
    ),
    "plan_tour": (
        lambda **given: hplan.plan_tour(**given),
        {"robot": None, "scene": None},
        "robot:object scene:object",
        {"options": NO_OBJECT[1:], "tour": NO_OBJECT[1:], "fruits": ("apple", 1, [1])},
    ),
    "reachable": (
        lambda **given: hplan.reachable(**given),
        {"robot": None, "scene": None, "motions": False},
        "robot:object scene:object",
        {"options": NO_OBJECT[1:], "motions": ("yes", 2, None)},
    ),
    "load_cell": (hplan.load_cell, {"path": "cell.yaml"}, "path:file", {}),
    "plan_cell": (
        lambda **given: hplan.plan_cell(**given),
        {"cell": a_cell()},
        "cell:object",
        {"options": NO_OBJECT[1:]},
    ),
    "plan_cell_tour": (
        lambda **given: hplan.plan_cell_tour(**given),
        {"cell": a_cell()},
        "cell:object",
        {"options": NO_OBJECT[1:]},
    ),
    "certify_cell": (
        lambda **given: hplan.certify_cell(**given),
        {"cell": a_cell(), "motion": a_cell().together({})},
        "cell:object motion:object",
        {"options": NO_OBJECT[1:], "check_ends": NO_OBJECT[1:]},
    ),
    "replan_cell": (
        lambda **given: hplan.replan_cell(**given),
        {"result": None, "t": 0.5, "arm": "a"},
        "result:object",
        {},
    ),
    "check": (
        lambda **given: hplan.check(**given),
        {"robot": None, "scene": None, "q": [0.0, 0.0, 0.0, 0.0]},
        "robot:object scene:object",
        {"q": (None, "0", [0.0], [NAN] * 4), "time_s": ("0", NAN), "sigmas": (-1.0, "3", NAN)},
    ),
    "warm_up": (hplan.warm_up, {"robot": None}, "robot:object", {}),
    "Planner": (hplan.Planner, {"robot": None, "scene": None}, "robot:object scene:object", {"options": NO_OBJECT[1:]}),
    "Planner.add": (a_planner().add, {"obstacle": Sphere(**BALL)}, "obstacle:object", {}),
    "Planner.remove": (a_planner().remove, {"name": "ball"}, "name:name", {}),
    "Planner.move": (
        a_planner().move,
        {"name": "ball"},
        "name:name center:vector radius:length",
        {"size": (1.0,), "kind": ("box",)},
    ),
    "Planner.set_cloud": (
        a_planner().set_cloud,
        {"name": "seen", "points": [[1.0, 0.5, 1.0]], "radius": 0.01},
        "name:name radius:length",
        {
            "points": ("points", 1.0, [1.0]),
            "pose": ("pose", 1.0, [1.0] * 5),
            "joints": ("joints", 1.0, [0.0]),
            "ignore": ("ball", 1, [1]),
            "keep_s": (-1.0, float("nan"), "1"),
            "time_s": (float("nan"), "1"),
            "options": NO_OBJECT[1:],
        },
    ),
    "Planner.aim": (
        a_planner().aim,
        {},
        "",
        {"start": ("start", 1.0, GOAL.model_copy(update={"joints_deg": None})), "goal": ("goal", 1.0, (0.0,) * 4)},
    ),
    "Planner.replan": (
        lambda **given: a_running_planner().replan(**given),
        {"at": 0.1},
        "",
        {"at": (*NO_NUMBER[1:], -1.0, 99.0), "now": (*NO_NUMBER[1:], -1.0, 0.2), "cancel": (1.0, "stop")},
    ),
    "Planner.stop_at": (
        lambda **given: a_running_planner().stop_at(**given),
        {"t": 0.1},
        "t:size",
        {"now": (*NO_NUMBER[1:], -1.0, 99.0)},
    ),
    "Trajectory.stop_at": (a_trajectory().stop_at, {"t": 0.5, "robot": ROBOT}, "t:size robot:object", {}),
    "Trajectory.scaled": (
        a_trajectory().scaled,
        {"profile": 0.5, "robot": ROBOT},
        "profile:positive robot:object",
        {},
    ),
    "certify": (
        lambda **given: hplan.certify(**given),
        {"robot": None, "scene": None, "trajectory": None},
        "robot:object scene:object trajectory:object tracking_error:size tracking_delay_s:size sigmas:size",
        {
            "checker": NO_OBJECT[1:],
            "rest_to_rest": (None, "no", 1.0),
            "check_ends": (None, "no"),
            "goal_contact": (None, "never", []),
        },
    ),
    "execute": (execute, {"robot": None, "scene": None, "motion": None}, "robot:object scene:object motion:object", {}),
    "load_robot": (hplan.load_robot, {}, "path:file limits:file srdf:file", {"tool_frame": (*NO_NAME[1:], "nothing")}),
    "load_scene": (hplan.load_scene, {}, "path:file", {}),
    "parse_scene": (parse_scene, {"text": ""}, "", {"text": (None, b"", 1)}),
    "dump_scene": (dump_scene, {"scene": a_scene()}, "scene:object", {}),
    "save_scene": (hplan.save_scene, {"scene": a_scene(), "path": "a.yaml"}, "scene:object path:path", {}),
    "read_csv": (hplan.read_csv, {"path": "a"}, "path:file", {}),
    "read_motion": (read_motion, {"path": "a"}, "path:file", {}),
    "write_csv": (
        hplan.write_csv,
        {"trajectory": a_trajectory(), "path": "a.csv"},
        "trajectory:object path:path",
        {"robot": NO_OBJECT[1:]},
    ),
    "write_text": (write_text, {"path": "a", "text": ""}, "path:path", {"text": ("\ud800", None, b"")}),
    "Robot.check_configuration": (
        ROBOT.check_configuration,
        {"q": [0.0] * 4, "which": "start"},
        "",
        {"q": (None, "0000", 1.0)},
    ),
    "FruitZone": (FruitZone, {}, "low:number high:number reach:length", {}),
    "OrchardOptions": (
        OrchardOptions,
        {},
        "name:name seed:whole trees:whole spacing:length fruit_zone:object clearance:size",
        {
            "form": (None, "bush", []),
            "wire_heights": (None, "12", 1.0),
            "picked": (None, "1", (0,)),
            "goal": (1, ""),
            "robot": (1, "", "arm"),
            "posts": (None, 1),
        },
    ),
    "generate": (generate, {}, "", {"options": NO_OBJECT[1:], "start_deg": (None, "0", 1.0)}),
    "MeasuredOptions": (
        MeasuredOptions,
        {},
        "name:name distance:number spacing:number height:number yaw_deg:number seed:whole clearance:number "
        "wood_yields:size yields_below:size fruit_yields:size",
        {"goal": (1, ""), "fruits": NO_WHOLE[1:], "fruit_radius": NO_LENGTH[1:], "fruit_zone": NO_OBJECT[1:]},
    ),
    "measured_orchard": (
        measured_orchard,
        {"paths": None, "options": MeasuredOptions(fruits=2)},
        "",
        {"paths": (None, "p1.csv", []), "options": NO_OBJECT[1:], "start_deg": (None, "0")},
    ),
    "import_capsules": (
        import_capsules,
        {"path": "p.csv"},
        "path:file position:vector yaw_deg:number",
        {"prefix": (None, 1)},
    ),
    "import_tree": (import_tree, {"path": "p.csv"}, "path:file position:vector yaw_deg:number", {"prefix": (None, 1)}),
    "fruit_at_tips": (
        fruit_at_tips,
        {"capsules": [Capsule(**ROD)], "count": 1},
        "count:whole radius:length seed:whole",
        {"capsules": (None, "rod", [None]), "zone": NO_OBJECT[1:]},
    ),
    "ArmSpec": (
        ArmSpec,
        SPEC,
        "name:name",
        {
            "link_lengths": (None, "12", 1.0),
            "lower": (None, (NAN,) * 4, (0.0,)),
            "has_yaw": (None, "yes", 2),
            "shoulder_height": (*NO_POSITIVE[:6], 0.0, -1.0),
            "base_mass": NO_POSITIVE[:6],
        },
    ),
    "write_robot": (write_robot, {"spec": HARVESTER, "urdf_path": "a.urdf"}, "spec:object urdf_path:path", {}),
    "load_member": (load_member, {"spec": HARVESTER}, "spec:object", {}),
    "Study": (Study, A_STUDY, "name:name", {"arms": (None, "arm", 1.0, ()), "trees": (None, "tree", 1.0, ((),))}),
    "run_study": (
        run_study,
        {"study": None},
        "rows:path",
        {"workers": NO_WHOLE[1:], "study": (3, "missing.yaml", ()), "executor": (3, "pool")},
    ),
    "RowOptions": (
        hplan.RowOptions,
        {},
        "distance:positive step:positive speed:positive acceleration:positive lift_speed:positive",
        {
            "share": NO_POSITIVE,
            "settling": NO_NUMBER,
            "detaching": NO_NUMBER,
            "heights": (None, "up", (), (NAN,)),
            "objective": (None, "best"),
            "both": (None, 1),
            "carried": (None, "vehicle", (1,)),
        },
    ),
    "plan_row": (
        hplan.plan_row,
        {"robot": None, "scene": None},
        "robot:object scene:object",
        {"row": (3, "row"), "tour": (3, "tour"), "workers": NO_WHOLE[1:], "executor": (3, "pool")},
    ),
    "cross_check": (cross_check, {"urdf_path": "a.urdf"}, "urdf_path:file samples:whole seed:whole", {}),
    "Grid.over": (
        Grid.over,
        {"lower": [0.0], "upper": [1.0], "step": 0.1},
        "",
        {"lower": (None, "0", 1.0), "upper": (None, [NAN], [INF]), "step": (None, "1", NAN)},
    ),
    "Occupancy.from_mask": (
        Occupancy.from_mask,
        {"grid": free().grid, "occupied": np.zeros((3, 3), dtype=np.bool_)},
        "grid:object",
        {"occupied": (None, np.zeros((3, 3)), [[False]])},
    ),
    **{
        function.__name__: (
            function,
            {"occupancy": free(), "start": (0, 0), **({} if function is reachable else {"goal": (2, 2)})},
            "occupancy:object",
            {"start": (None, "00", (0,), (0.0, 0.0), (9, 9), (NAN, 0), [[0], [0, 1]], 0, NoArray())},
        )
        for function in (dense_search, reachable, slices_with_path, two_level_search)
    },
    "rounded_path": (
        rounded_path,
        {"waypoints": [[0.0] * 4], "deviation_rad": 0.1},
        "waypoints:matrix deviation_rad:positive",
        {},
    ),
    "largest_deviation": (
        largest_deviation,
        {"positions": [[0.0] * 4], "waypoints": [[0.0] * 4]},
        "positions:matrix waypoints:matrix",
        {},
    ),
    "limits_of": (
        limits_of,
        {"model": ROBOT.model, "acceleration": 1.0},
        "model:object",
        {"acceleration": (None, "a", NAN), "jerk": ("a", NAN, -1.0), "torque": (None, "no")},
    ),
    "limit_shares": (
        limit_shares,
        {"trajectory": a_trajectory(), "limits": limits_of(ROBOT.model, 1.0)},
        "trajectory:object limits:object",
        {},
    ),
    "time_waypoints": (
        time_waypoints,
        {
            "model": ROBOT.model,
            "waypoints": [[0.0] * 4, [0.1] * 4],
            "limits": limits_of(ROBOT.model, 1.0),
        },
        "model:object waypoints:matrix limits:object deviation_rad:positive rate_hz:positive speed:positive",
        {},
    ),
    "read_machine": (
        read_machine,
        {"path": str(ROBOT.urdf_path)},
        "path:file",
        {"joints": ("wrist", 1, [1]), "hold": (1, "wrist", {"wrist": "a"})},
    ),
    "read_waypoints": (
        read_waypoints,
        {"path": "w.csv", "joint_names": ["a"]},
        "path:file",
        {"joint_names": (None, "a", [1])},
    ),
    "Trajectory.since": (a_trajectory().since, {"row": 1}, "row:whole", {}),
    "Trajectory.until": (a_trajectory().until, {"row": 1}, "row:whole", {}),
    "Trajectory.positions": (
        a_trajectory().positions,
        {"clock": [0.0]},
        "",
        {"clock": (*NO_MATRIX[:3], [NAN], [[0.0]])},
    ),
    "Robot.tool_positions": (ROBOT.tool_positions, {"q": [0.0] * 4}, "", {"q": (None, "1234", 1.0)}),
    "Robot.yaw_of": (ROBOT.yaw_of, {"q": [0.0] * 4}, "", {"q": (None, "0000", 1.0)}),
    "Robot.plane_at": (ROBOT.plane_at, {"yaw": 0.0}, "yaw:number", {}),
    "Robot.sway": (ROBOT.sway, {"deviation": 0.1}, "", {"deviation": (None, "0.1", NAN)}),
    "plan progress": (hplan.plan, {"robot": None, "scene": None}, "", {"progress": (None, 5, "print")}),
    "Playback.of": (Playback.of, {"result": None}, "result:object", {}),
    "Playback": (
        Playback,
        {"trajectory": None},
        "trajectory:object begin_s:number",
        {"picked": (None, [], {1: 0.0}), "phases": (None, 1.0, [None])},
    ),
    "write_page": (
        write_page,
        {"robot": None, "scene": None, "playback": Playback(a_trajectory()), "path": "a.html"},
        "robot:object scene:object playback:object path:path",
        {},
    ),
    "corner_grid": (corner_grid, {}, "path:object", {}),
    "read_planning_scene": (read_planning_scene, {"source": {"world": {}}}, "source:file", {}),
}


#: Other words by which an argument may be called, or what it does not fit.
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
    """Whether an error says on one line which argument is wrong, or what was given for it."""
    words = (argument, argument.removesuffix("s"), str(value), repr(value), *WORDS.get(argument, ()))
    return "\n" not in str(error) and any(word in str(error) for word in words)


def calls() -> Iterator[Any]:
    for name, (function, good, kinds, bad) in CASES.items():
        of_kinds = {argument: KINDS[kind] for argument, _, kind in (word.partition(":") for word in kinds.split())}
        for argument, values in {**of_kinds, **bad}.items():
            yield pytest.param(function, good, argument, values, id=f"{name} {argument}")


@pytest.mark.parametrize(("function", "good", "argument", "values"), list(calls()))
def test_a_wrong_value_is_an_error_of_our_own(
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
    objects = {
        "paths": [tree],
        "robot": ROBOT,
        "scene": a_scene(),
        "trajectory": a_trajectory(),
        "motion": a_trajectory(),
        "study": Study(**A_STUDY),
    }
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
    """One of a terabyte, none of which is on the disk; and a name that no file can have."""
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(HplanError, match=r"1,099,511,627,776 bytes or more; at most \d+,000,000 are read|more than 16"):
        read(path)
    with pytest.raises(HplanError):
        read(tmp_path / ("n" * 300 + path.suffix))


def test_far_too_large_numbers_are_refused_without_a_warning(tmp_path: Path) -> None:
    """What overflows where it is squared."""
    text = dump_scene(a_scene(obstacles=(Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.125),)))
    for wrong in ("1e308", "1.0e+200", "-1e155"):
        (tmp_path / "scene.yaml").write_text(text.replace("0.125", wrong).replace("1.9", wrong))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(SceneError):
                hplan.load_scene(tmp_path / "scene.yaml")


def test_a_scenes_errors_are_value_errors_too() -> None:
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
        "hplan.grid",
        "hplan.robot.family.members",
    ]
    names = {name for module in modules for name in getattr(importlib.import_module(module), "__all__", ())}
    results = {"Cell", "CellResult", "CellTour", "Certificate", "ConfigurationCheck",
        "FruitReach", "HplanError", "PlanResult", "Robot", "TourResult", "LimitShares", "Machine",
        "CrossCheck", "Expansions", "SearchResult", "RowResult", "StageTimes", "StudyResult"}  # fmt: skip
    values = {"AT_LIMIT", "DEVIATION", "Fallback", "HARVESTER", "SHIPPED", "TUCKED_DEG"}
    assert names - results - values <= set(CASES)
