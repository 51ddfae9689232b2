"""A wrong value is an error of hplan's own that names what is wrong, whatever public function or class is given it."""

from __future__ import annotations

import importlib
import math
import warnings
from collections.abc import Callable, Iterator
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
from hplan.base.arguments import decimal
from hplan.base.files import write_text
from hplan.errors import HplanError, InputError, SceneError
from hplan.grid import dense_search, reachable, slices_with_path, two_level_search
from hplan.grid.grid import Grid, Occupancy
from hplan.robot.family.members import HARVESTER, ArmSpec, cross_check, write_robot
from hplan.robot.tracking import TrackingModel
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
    measured_orchard,
)
from hplan.scene.tracks import Sway, Track
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

START, GOAL = Start(joints_deg=(0.0,) * 4), Goal(joints_deg=(0.0, 45.0, 60.0, 70.0))


class NoArray:
    """Says that it is an array, and is none."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no array")


class NoList:
    """Says that it is a list, and is none."""

    def __iter__(self) -> Any:
        raise RuntimeError("no list")


def a_scene(**changes: Any) -> Scene:
    return Scene(**{"name": "a", "start": START, "goal": GOAL, **changes})


def a_planner() -> hplan.Planner:
    obstacles = (
        Sphere(name="ball", center=(1.0, 0.0, 1.9), radius=0.1),
        Sphere(name="b", center=(3.0, 0, 0), radius=1.0),
    )
    return hplan.Planner(hplan.load_robot(), a_scene(obstacles=obstacles))


def a_running_planner() -> hplan.Planner:
    planner = hplan.Planner(hplan.load_robot(), a_scene(), hplan.PlanOptions(effort="quick"))
    planner.plan()
    return planner


def a_trajectory(**changes: Any) -> hplan.Trajectory:
    rows = np.zeros((2, 4))
    fields = {"joint_names": hplan.load_robot().joint_names, "time": [0.0, 1.0],
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

#: A function, what it is given, and for each argument values that it cannot have.
Case = tuple[Callable[..., Any], dict[str, Any], dict[str, tuple[Any, ...]]]
NO_LENGTH = (*NO_POSITIVE, 1e308)
CASES: dict[str, Case] = {
    "Sphere": (
        Sphere,
        BALL,
        {
            "name": NO_NAME,
            "center": NO_VECTOR,
            "radius": NO_LENGTH,
            "sigma": (*NO_NUMBER, -1.0),
            "kind": ("box", None),
            "colour": ("red",),
        },
    ),
    "Capsule": (Capsule, ROD, {"name": NO_NAME, "start": NO_VECTOR, "end": NO_VECTOR, "radius": NO_LENGTH}),
    "Box": (
        Box,
        BOX,
        {"name": NO_NAME, "center": NO_VECTOR, "size": (*NO_VECTOR, (0.0, 1.0, 1.0)), "rpy_deg": NO_VECTOR[:-3]},
    ),
    "Cylinder": (
        Cylinder,
        CAN,
        {
            "name": NO_NAME,
            "center": NO_VECTOR,
            "length": NO_LENGTH,
            "radius": NO_LENGTH,
            "rpy_deg": NO_VECTOR[:-3],
        },
    ),
    "Track": (
        Track,
        {"times_s": (0.0, 1.0), "shifts_m": ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))},
        {
            "times_s": (*NO_VECTOR[:2], 1.0, (), (0.0,), (1.0, 0.0), (0.0, 0.0), (0.0, NAN), (0.0, "1"), (0.0, 1e9)),
            "shifts_m": (
                None,
                "12",
                (),
                ((0.0, 0.0, 0.0),),
                ((0.0, 0.0, 0.0), None),
                ((0.0, 0.0, 0.0), (0.0, NAN, 0.0)),
            ),
            "rpy_deg": ("up", ((0.0, 0.0, 0.0),), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
            "about": NO_VECTOR[1:],
            "speed": (1.0,),
        },
    ),
    "Sway": (
        Sway,
        {"direction": (0.0, 1.0, 0.0), "amplitude_m": 0.1},
        {"direction": (*NO_VECTOR, (0.0, 0.0, 0.0)), "amplitude_m": NO_LENGTH},
    ),
    "Fruit": (Fruit, BALL, {"name": NO_NAME, "center": NO_VECTOR, "radius": NO_LENGTH}),
    "Mesh.of": (
        Mesh.of,
        {"name": "m", "vertices": TETRA[0], "faces": TETRA[1]},
        {
            "name": NO_NAME,
            "vertices": NO_MATRIX,
            "faces": (*NO_MATRIX, [(0, 1, 9)], [(0, 1, 2)]),
            "scale": NO_LENGTH,
            "position": NO_VECTOR,
            "colour": ("red",),
        },
    ),
    "Mesh": (
        Mesh,
        {"name": "m", "file": "m.stl"},
        {"file": (None, "", "a\0b", 1, "nowhere.stl", "."), "name": NO_NAME},
    ),
    "PointCloud.of": (
        PointCloud.of,
        {"name": "p", "points": TETRA[0], "radius": 0.1},
        {"points": NO_MATRIX, "name": NO_NAME, "radius": NO_LENGTH},
    ),
    "PointCloud": (
        PointCloud,
        {"name": "p", "file": "p.ply", "radius": 0.1},
        {"file": (None, "", "a\0b", 1, "nowhere.ply", ".")},
    ),
    "Mesh.write": (Mesh.of("m", *TETRA).write, {"path": "m.ply"}, {"path": (*NO_PATH, "/nowhere/m.ply", ".")}),
    "Start": (
        Start,
        {"joints_deg": (0.0,)},
        {"joints_deg": (None, "0", 1.0, (NAN,), ("a",), (INF,)), "joints_rad": ((0.0,),)},
    ),
    "Goal": (Goal, {"fruit": "apple"}, {"fruit": (None, 1), "position": NO_VECTOR[1:], "approach_deg": NO_NUMBER[1:5]}),
    "Scene": (
        a_scene,
        {},
        {
            "name": NO_NAME,
            "start": (None, "start", (0.0,)),
            "goal": (None, "apple"),
            "clearance": NO_LENGTH[:4],
            "obstacles": (None, "post", 1.0, (None,), ("post",), (START,)),
            "fruits": (None, (Sphere(**BALL),)),
            "locked_joints": (None, "yaw", (1,)),
        },
    ),
    "Scene.with_obstacles": (
        a_scene().with_obstacles,
        {"obstacles": ()},
        {"obstacles": (("post",), (None,), (START,), (Sphere(**BALL),) * 2, None, "ball", 1.0, np.array(3.0))},
    ),
    "Scene.model_validate": (Scene.model_validate, {"obj": {}}, {"obj": ({}, None, "scene", [], {"name": 1})}),
    "PlanOptions": (
        hplan.PlanOptions,
        {},
        {
            "method": (None, "fast", 1, [], np.zeros(2)),
            "objective": (None, "fun"),
            "link_model": (None, "x", []),
            "step_deg": NO_POSITIVE,
            "rate_hz": (*NO_POSITIVE, 1e308),
            "speed": (*NO_POSITIVE, 1.5),
            "tracking_error": (*NO_NUMBER, -1.0),
            "tracking_delay_s": (*NO_NUMBER, -1.0),
            "sigmas": (*NO_NUMBER, -1.0),
            "standoff": (*NO_NUMBER[1:], -1.0),
            "certify": (None, "no", 1.0, []),
        },
    ),
    "TrackingModel": (TrackingModel, {}, {"still_rad": (*NO_NUMBER, -1.0), "delay_s": (*NO_NUMBER, -1.0)}),
    "TourOptions": (
        TourOptions,
        {"drop_off": GOAL},
        {
            "drop_off": ("there", 1.0, Goal(fruit="apple")),
            "every": (0, -1, 1.5, "2", True),
            "order": (None, "worst", []),
            "grasps": (*NO_WHOLE, 0),
            "back": (None, "yes"),
            "compare": (None, 1.0),
        },
    ),
    "Trajectory": (
        a_trajectory,
        {},
        {
            "joint_names": (None, "abcd", 1, [1, 2, 3, 4], ["a"]),
            "time": (None, "01", [], [0.0], [1.0, 2.0], [0.0, NAN], [0.0, 0.0], [[0.0, 1.0]], ["0", "1"], [0.0, INF]),
            **dict.fromkeys(("position", "velocity", "acceleration", "torque"), NO_MATRIX),
        },
    ),
    "RecordedMotion.from_positions": (
        RecordedMotion.from_positions,
        {"joint_names": ["a"], "time": [0.0, 1.0], "position": [[0.0], [1.0]]},
        {
            "joint_names": (None, "a", [1]),
            "time": (None, [], [1.0, 0.0], ["a", "b"], [0.0, NAN]),
            "position": NO_MATRIX,
        },
    ),
    "plan": (
        lambda **given: hplan.plan(**given),
        {"robot": None, "scene": None},
        {"robot": NO_OBJECT, "scene": NO_OBJECT, "options": NO_OBJECT[1:]},
    ),
    "finish": (
        lambda **given: hplan.finish(**given),
        {"robot": hplan.load_robot(), "scene": a_scene(), "waypoints": ([0.0] * 4, [0.1] * 4)},
        {
            "robot": NO_OBJECT,
            "scene": NO_OBJECT,
            "waypoints": (*NO_MATRIX, [[0.0] * 4], [[0.0] * 4] * 3, [[0.0] * 5] * 2, [[0.0] * 4, [9.0] * 4]),
            "options": NO_OBJECT[1:],
            "keep_within_rad": (*NO_POSITIVE[1:], 1e-5),
        },
    ),
    "plan_tour": (
        lambda **given: hplan.plan_tour(**given),
        {"robot": None, "scene": None},
        {
            "robot": NO_OBJECT,
            "scene": NO_OBJECT,
            "options": NO_OBJECT[1:],
            "tour": NO_OBJECT[1:],
            "fruits": ("apple", 1, [1], ["nothing"], [], [None], NoList()),
        },
    ),
    "Planner": (
        hplan.Planner,
        {"robot": None, "scene": None},
        {"robot": NO_OBJECT, "scene": NO_OBJECT, "options": NO_OBJECT[1:]},
    ),
    "Planner.add": (
        a_planner().add,
        {"obstacle": Sphere(**BALL)},
        {"obstacle": (*NO_OBJECT, Sphere(**BALL), Fruit(**BALL), a_scene())},
    ),
    "Planner.remove": (a_planner().remove, {"name": "ball"}, {"name": (*NO_NAME, "nothing")}),
    "Planner.move": (
        a_planner().move,
        {"name": "ball"},
        {"name": (*NO_NAME, "nothing"), "center": NO_VECTOR, "radius": NO_LENGTH, "size": (1.0,), "kind": ("box",)},
    ),
    "Planner.set_cloud": (
        a_planner().set_cloud,
        {"name": "seen", "points": [[1.0, 0.5, 1.0]], "radius": 0.01},
        {
            "name": (*NO_NAME, "ball"),
            "points": ("points", 1.0, [1.0], [[1.0, 2.0]], [["a", "b", "c"]]),
            "radius": NO_LENGTH,
            "pose": ("pose", 1.0, [1.0] * 5, [[0.0] * 4] * 4),
            "joints": ("joints", 1.0, [0.0], [float("nan")] * 4, [1e308] * 4),
            "ignore": ("ball", 1, [1], ["nothing"], ["seen"]),
            "keep_s": (-1.0, float("nan"), "1"),
            "time_s": (float("nan"), "1"),
            "options": NO_OBJECT[1:],
        },
    ),
    "Planner.aim": (
        a_planner().aim,
        {},
        {
            "start": ("start", 1.0, GOAL.model_copy(update={"joints_deg": None}), (0.0,) * 4),
            "goal": ("goal", 1.0, (0.0,) * 4),
        },
    ),
    "Planner.replan": (
        a_running_planner().replan,
        {"at": 0.1},
        {"at": (*NO_NUMBER[1:], -1.0, 99.0), "now": (*NO_NUMBER[1:], -1.0, 0.2), "cancel": (1.0, "stop")},
    ),
    "Planner.stop_at": (
        a_running_planner().stop_at,
        {"t": 0.1},
        {"t": (*NO_NUMBER, -1.0, 99.0), "now": (*NO_NUMBER[1:], -1.0, 99.0)},
    ),
    "Trajectory.stop_at": (
        a_trajectory().stop_at,
        {"t": 0.5, "robot": hplan.load_robot()},
        {"t": (*NO_NUMBER, -1.0, 1.1), "robot": NO_OBJECT},
    ),
    "Trajectory.scaled": (
        a_trajectory().scaled,
        {"profile": 0.5, "robot": hplan.load_robot()},
        {"profile": (*NO_POSITIVE, [(0.0, -1.0)], [(0.0, NAN)], [(1.0, 1.0), (0.5, 1.0)]), "robot": NO_OBJECT},
    ),
    "certify": (
        lambda **given: hplan.certify(**given),
        {"robot": None, "scene": None, "trajectory": None},
        {
            "robot": NO_OBJECT,
            "scene": NO_OBJECT,
            "trajectory": NO_OBJECT,
            "tracking_error": (*NO_NUMBER, -1.0),
            "tracking_delay_s": (*NO_NUMBER, -1.0),
            "checker": NO_OBJECT[1:],
            "rest_to_rest": (None, "no", 1.0),
            "check_ends": (None, "no"),
            "sigmas": (*NO_NUMBER, -1.0),
            "goal_contact": (None, "never", []),
        },
    ),
    "execute": (
        execute,
        {"robot": None, "scene": None, "motion": None},
        {"robot": NO_OBJECT, "scene": NO_OBJECT, "motion": NO_OBJECT},
    ),
    "load_robot": (
        hplan.load_robot,
        {},
        {"path": NO_FILE, "limits": NO_FILE, "srdf": NO_FILE, "tool_frame": (*NO_NAME[1:], "nothing")},
    ),
    "load_scene": (hplan.load_scene, {}, {"path": NO_FILE}),
    "parse_scene": (parse_scene, {"text": ""}, {"text": (None, b"", 1, "", "[]", "a: [", "\x00")}),
    "dump_scene": (dump_scene, {"scene": a_scene()}, {"scene": NO_OBJECT}),
    "save_scene": (
        hplan.save_scene,
        {"scene": a_scene(), "path": "a.yaml"},
        {"scene": NO_OBJECT, "path": (*NO_PATH, "/nowhere/a.yaml", ".")},
    ),
    "read_csv": (hplan.read_csv, {"path": "a"}, {"path": NO_FILE}),
    "read_motion": (read_motion, {"path": "a"}, {"path": NO_FILE}),
    "write_csv": (
        hplan.write_csv,
        {"trajectory": a_trajectory(), "path": "a.csv"},
        {"trajectory": NO_OBJECT, "path": (*NO_PATH, "/nowhere/a.csv", "."), "robot": NO_OBJECT[1:]},
    ),
    "write_text": (write_text, {"path": "a", "text": ""}, {"path": (*NO_PATH, "."), "text": ("\ud800", None, b"", 1)}),
    "Robot.check_configuration": (
        hplan.load_robot().check_configuration,
        {"q": [0.0] * 4, "which": "start"},
        {
            "q": (
                None,
                "0000",
                1.0,
                [],
                [0.0] * 3,
                [NAN] * 4,
                [9.0] * 4,
                [["a"]],
                [None] * 4,
                [[0.0] * 4],
                ["0"] * 4,
                [1j] * 4,
                [[0.0], 0.0, 0.0, 0.0],
            )
        },
    ),
    "FruitZone": (FruitZone, {}, {"low": (*NO_NUMBER, 1e308), "high": (*NO_NUMBER, 1e308), "reach": NO_LENGTH}),
    "OrchardOptions": (
        OrchardOptions,
        {},
        {
            "name": NO_NAME,
            "seed": NO_WHOLE,
            "form": (None, "bush", []),
            "trees": (*NO_WHOLE, 0, 10**9),
            "spacing": NO_LENGTH,
            "wire_heights": (None, "12", 1.0, (NAN,), (2.0, 1.0)),
            "fruit_zone": NO_OBJECT,
            "picked": (None, "1", (0,), (1.5,)),
            "goal": (1, ""),
            "robot": (1, "", "arm"),
            "posts": (None, 1),
            "clearance": (*NO_NUMBER, -1.0),
        },
    ),
    "generate": (generate, {}, {"options": NO_OBJECT[1:], "start_deg": (None, "0", 1.0, (NAN,), ("a",))}),
    "MeasuredOptions": (
        MeasuredOptions,
        {},
        {
            "fruits": NO_WHOLE,
            "name": NO_NAME,
            "distance": NO_NUMBER,
            "spacing": NO_NUMBER,
            "height": NO_NUMBER,
            "yaw_deg": NO_NUMBER,
            "fruit_radius": NO_LENGTH,
            "fruit_zone": NO_OBJECT,
            "seed": NO_WHOLE,
            "clearance": NO_NUMBER,
            "goal": (1, ""),
        },
    ),
    "measured_orchard": (
        measured_orchard,
        {"paths": None, "options": MeasuredOptions(fruits=2)},
        {
            "paths": (None, "p1.csv", [], [1], [None], ["a\0b"], ["nowhere.csv"], 1.0),
            "options": NO_OBJECT[1:],
            "start_deg": (None, "0"),
        },
    ),
    "import_capsules": (
        import_capsules,
        {"path": "p.csv"},
        {"path": NO_FILE, "position": NO_VECTOR, "yaw_deg": NO_NUMBER, "prefix": (None, 1)},
    ),
    "fruit_at_tips": (
        fruit_at_tips,
        {"capsules": [Capsule(**ROD)], "count": 1},
        {
            "capsules": (None, "rod", [None], 1.0, [Sphere(**BALL)]),
            "count": NO_WHOLE,
            "radius": NO_LENGTH,
            "seed": NO_WHOLE,
            "zone": NO_OBJECT[1:],
        },
    ),
    "ArmSpec": (
        ArmSpec,
        SPEC,
        {
            "name": (*NO_NAME, "a b"),
            "link_lengths": (None, "12", 1.0, (), (NAN,), (0.0, 1.0, 1.0), ("a",) * 3),
            "lower": (None, (NAN,) * 4, (0.0,)),
            "has_yaw": (None, "yes", 2, []),
            "shoulder_height": (*NO_POSITIVE[:6], 0.0, -1.0),
            "base_mass": NO_POSITIVE[:6],
        },
    ),
    "write_robot": (
        write_robot,
        {"spec": HARVESTER, "urdf_path": "a.urdf"},
        {"spec": NO_OBJECT, "urdf_path": (*NO_PATH, "a.txt", "/nowhere/a.urdf")},
    ),
    "cross_check": (
        cross_check,
        {"urdf_path": "a.urdf"},
        {"urdf_path": NO_FILE, "samples": (*NO_WHOLE, 0), "seed": NO_WHOLE},
    ),
    "Grid.over": (
        Grid.over,
        {"lower": [0.0], "upper": [1.0], "step": 0.1},
        {
            "lower": (None, "0", 1.0, ["a"], [NAN], [[0.0], [0.0, 1.0]], [2.0], [-1e308], [0.0, 0.0]),
            "upper": (None, [NAN], [INF], [1e308], "1"),
            "step": (None, "1", NAN, 0.0, -1.0, INF, [0.1, 0.1], [], "a", 1e-300),
        },
    ),
    "Occupancy.from_mask": (
        Occupancy.from_mask,
        {"grid": free().grid, "occupied": np.zeros((3, 3), dtype=np.bool_)},
        {"grid": NO_OBJECT, "occupied": (None, np.zeros((3, 3)), [[False]], np.zeros((2, 2), dtype=np.bool_), "000")},
    ),
    **{
        function.__name__: (
            function,
            {"occupancy": free(), "start": (0, 0), **({} if function is reachable else {"goal": (2, 2)})},
            {
                "occupancy": NO_OBJECT,
                "start": (
                    None,
                    "00",
                    (0,),
                    (0, 0, 0),
                    (0.0, 0.0),
                    (9, 9),
                    (-1, 0),
                    (NAN, 0),
                    [[0], [0, 1]],
                    0,
                    NoArray(),
                ),
                **({"octile": (None, 1, [], "yes")} if function in (dense_search, two_level_search) else {}),
            },
        )
        for function in (dense_search, reachable, slices_with_path, two_level_search)
    },
    "rounded_path": (
        rounded_path,
        {"waypoints": [[0.0] * 4], "deviation_rad": 0.1},
        {"waypoints": NO_MATRIX, "deviation_rad": NO_POSITIVE},
    ),
    "largest_deviation": (
        largest_deviation,
        {"positions": [[0.0] * 4], "waypoints": [[0.0] * 4]},
        {"positions": NO_MATRIX, "waypoints": NO_MATRIX},
    ),
    "limits_of": (
        limits_of,
        {"model": hplan.load_robot().model, "acceleration": 1.0},
        {
            "model": NO_OBJECT,
            "acceleration": (None, "a", NAN, -1.0, INF, [1.0, 2.0], [[]], [1.0, "a", 1.0, 1.0], [1.0, [2.0], 1.0, 1.0]),
            "jerk": ("a", NAN, -1.0),
            "torque": (None, "no"),
        },
    ),
    "limit_shares": (
        limit_shares,
        {"trajectory": a_trajectory(), "limits": limits_of(hplan.load_robot().model, 1.0)},
        {"trajectory": NO_OBJECT, "limits": NO_OBJECT},
    ),
    "time_waypoints": (
        time_waypoints,
        {
            "model": hplan.load_robot().model,
            "waypoints": [[0.0] * 4, [0.1] * 4],
            "limits": limits_of(hplan.load_robot().model, 1.0),
        },
        {
            "model": NO_OBJECT,
            "waypoints": (*NO_MATRIX, [[9.0] * 4], [[0.0] * 3]),
            "limits": NO_OBJECT,
            "deviation_rad": NO_POSITIVE,
            "rate_hz": NO_POSITIVE,
            "speed": (*NO_POSITIVE, 2.0),
        },
    ),
    "read_machine": (
        read_machine,
        {"path": str(hplan.load_robot().urdf_path)},
        {
            "path": NO_FILE,
            "joints": ("wrist", 1, [1], ["nothing"], [], [None]),
            "hold": (
                1,
                "wrist",
                {"wrist": "a"},
                {"wrist": NAN},
                {"wrist": None},
                {"nothing": 0.0},
                {"wrist": 99.0},
                [("wrist", 0.0)],
            ),
        },
    ),
    "read_waypoints": (
        read_waypoints,
        {"path": "w.csv", "joint_names": ["a"]},
        {"path": NO_FILE, "joint_names": (None, "a", [1], 1.0)},
    ),
    "Trajectory.since": (a_trajectory().since, {"row": 1}, {"row": (*NO_WHOLE, 2, 10**30)}),
    "Trajectory.until": (a_trajectory().until, {"row": 1}, {"row": (*NO_WHOLE, 2, 10**30)}),
    "Trajectory.positions": (a_trajectory().positions, {"clock": [0.0]}, {"clock": (*NO_MATRIX[:3], [NAN], [[0.0]])}),
    "Robot.tool_positions": (
        hplan.load_robot().tool_positions,
        {"q": [0.0] * 4},
        {"q": (None, "1234", 1.0, [1.0], [NAN] * 4, [INF] * 4, [1e308] * 4, [[1.0], [1.0, 2.0]], object(), NoArray())},
    ),
    "Robot.tool_poses": (
        hplan.load_robot().tool_poses,
        {"q": [0.0] * 4},
        {"q": (None, [1.0, 2.0], [NAN] * 4, [1e308] * 4)},
    ),
    "Robot.yaw_of": (
        hplan.load_robot().yaw_of,
        {"q": [0.0] * 4},
        {"q": (None, "0000", 1.0, [], ["a"] * 4, [None] * 4, [NAN] * 4, [1e308] * 4, {}, object(), NoArray())},
    ),
    "Robot.plane_at": (hplan.load_robot().plane_at, {"yaw": 0.0}, {"yaw": NO_NUMBER}),
    "Robot.sway": (
        hplan.load_robot().sway,
        {"deviation": 0.1},
        {"deviation": (None, "0.1", NAN, INF, [0.1], [0.1, 0.1], ["a"] * 4, [NAN] * 4, {}, object(), NoArray())},
    ),
    "plan progress": (hplan.plan, {"robot": None, "scene": None}, {"progress": (None, 5, "print", [])}),
    "Playback.of": (Playback.of, {"result": None}, {"result": (*NO_OBJECT, a_trajectory())}),
    "Playback": (
        Playback,
        {"trajectory": None},
        {
            "trajectory": NO_OBJECT,
            "picked": (None, [], {1: 0.0}, {"a": "b"}, {"a": NAN}),
            "phases": (None, 1.0, [None], ["approach"]),
            "begin_s": NO_NUMBER,
        },
    ),
    "write_page": (
        write_page,
        {"robot": None, "scene": None, "playback": Playback(a_trajectory()), "path": "a.html"},
        {"robot": NO_OBJECT, "scene": NO_OBJECT, "playback": NO_OBJECT, "path": NO_PATH},
    ),
    "Robot.frame_number": (hplan.load_robot().frame_number, {"name": "tool0"}, {"name": (None, 1, "\ud800")}),
    "Robot.check_configuration, no array": (
        hplan.load_robot().check_configuration,
        {"q": None, "which": "start"},
        {"q": (NoArray(), None, [1j] * 4, [10**400] * 4)},
    ),
    "corner_grid": (corner_grid, {}, {"path": NO_OBJECT}),
    "Planner.remove name": (a_planner().remove, {}, {"name": (None, 1, np.array([1.0, 2.0]))}),
    "set_cloud pose": (
        a_planner().set_cloud,
        {"name": "c", "points": [[1.0, 0.0, 1.0]], "radius": 0.01},
        {"pose": ([[1.0], [1.0, 2.0]], NoArray()), "points": (NoArray(),)},
    ),
    "PlanOptions.step_deg": (hplan.PlanOptions, {}, {"step_deg": (*NO_POSITIVE, 1e-308)}),
    "read_planning_scene": (
        read_planning_scene,
        {"source": {"world": {}}},
        {"source": (*NO_FILE, {})},
    ),
    "write_report": (
        lambda **given: importlib.import_module("hplan.planning.report").write_report(**given),
        {"report": {}, "path": "a.json"},
        {"path": (*NO_PATH, ".")},
    ),
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
    for name, (function, good, bad) in CASES.items():
        for argument, values in bad.items():
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
        "robot": hplan.load_robot(),
        "scene": a_scene(),
        "trajectory": a_trajectory(),
        "motion": a_trajectory(),
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

NO_DECIMAL = (
    "",
    " ",
    "a",
    "1_0",
    "１",  # noqa: RUF001
    "٣",
    "0x1p3",
    "0x10",
    "infinity",
    "inf",
    "nan",
    "NaN",
    "1e999",
    "1,5",
    "1.0.0",
    "--1",
    "1e",
    "1d3",
    "+-1",
)


@pytest.mark.parametrize("text", NO_DECIMAL)
def test_what_is_no_number_in_a_file(text: str) -> None:
    assert decimal(text) is None


@pytest.mark.parametrize("text", ["0", "-1", "+1.5", ".5", "5.", "1e3", "1E-3", " 1.0 ", "-0.0", "1e-400"])
def test_what_is_a_number_in_a_file(text: str) -> None:
    assert decimal(text) == float(text)


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
        (whole, lambda: read_waypoints(path, hplan.load_robot().joint_names)),
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


def test_a_row_of_a_csv_is_bounded_too(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for text in ("a," * 600_000, '"a\n",' * 300_000):
        path.write_text(text)
        with pytest.raises(InputError, match="the row has more than 1,000,000 characters"):
            hplan.read_csv(path)


def test_names_longer_than_a_files(tmp_path: Path) -> None:
    cloud = PointCloud.of("ö" * 300, [[1.0, 0.0, 2.0]], 0.01)
    taken = PointCloud.of("b", [[1.0, 0.0, 2.0]], 0.01)
    hplan.save_scene(a_scene(obstacles=(taken, cloud)), tmp_path / "s.yaml")
    loaded = hplan.load_scene(tmp_path / "s.yaml")
    assert [item.name for item in loaded.obstacles] == ["b", "ö" * 300]
    # A new cloud does not take the file of one that has it.
    new, old = PointCloud.of("b", [[1.5, 0.0, 2.0]], 0.01), loaded.obstacles[0].model_copy(update={"name": "c"})
    hplan.save_scene(loaded.with_obstacles([new, old]), tmp_path / "s.yaml")
    first, second = hplan.load_scene(tmp_path / "s.yaml").obstacles
    assert (first.file, second.file) == ("s-0-b-2.ply", "s-0-b.ply")


def test_csv_of_other_systems(tmp_path: Path) -> None:
    """A byte order mark and other line ends are no fault."""
    path = tmp_path / "a.csv"
    hplan.write_csv(a_trajectory(), path)
    plain = path.read_bytes().replace(b"\r\n", b"\n")
    for content in (plain, b"\xef\xbb\xbf" + plain, plain.replace(b"\n", b"\r\n")):
        path.write_bytes(content)
        assert hplan.read_csv(path).samples == read_motion(path).time.size == 2


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
    results = {"Certificate", "HplanError", "PlanResult", "Robot", "TourResult", "LimitShares", "Machine", "CrossCheck",
        "Expansions", "SearchResult", "StageTimes"}  # fmt: skip
    values = {"AT_LIMIT", "DEVIATION", "Fallback", "HARVESTER", "SHIPPED", "TUCKED_DEG"}
    assert names - results - values <= set(CASES)
