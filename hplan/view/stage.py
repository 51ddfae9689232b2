"""What the page shows, as commands to meshcat's viewer: arm, scene, tool path, ghosts, ground, lights and camera.

The commands are plain dictionaries, the same for the page in a file and for the live server, and the same on every run.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any, assert_never

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from hplan.arrays import FloatArray
from hplan.errors import InputError
from hplan.robot import Robot
from hplan.scene import Box, Capsule, Fruit, Mesh, PointCloud, Scene, Solid, Sphere
from hplan.trajectory import Trajectory
from hplan.view import three
from hplan.view.three import Body, Json

#: Most keyframes for each second of motion.
FRAME_RATE_HZ = 60.0
#: Rest at the goal before the motion starts again [s].
REST_S = 1.0
#: The viewer takes no "for ever"; this is years.
_REPETITIONS = 1_000_000_000

START_COLOR = 0x3D7EFF
GOAL_COLOR = 0x12A150
OBSTACLE_COLOR = 0x7B5EA7
FRUIT_COLOR = 0xD7263D
GOAL_FRUIT_COLOR = 0xFF3B2F
HALO_COLOR = 0xFFC53D

_SKY_TOP = (0.80, 0.86, 0.92)
_SKY_BOTTOM = (0.97, 0.97, 0.96)
_GRID_COLOR = (0.35, 0.42, 0.50)

#: The picture is composed for windows at least this wide (width / height).
ASPECT = 1.3
#: Vertical field of view [deg].
_FIELD_OF_VIEW_DEG = 32.0
_MARGIN = 1.1
#: The camera stands to the side of the arm plane, turned forwards by this and raised by this [deg].
_AZIMUTH_DEG = 32.0
_ELEVATION_DEG = 17.0

#: Most points of a cloud that are drawn.
_MOST_POINTS = 20_000

_ROOT = "/hplan"


def stage(robot: Robot, scene: Scene, trajectory: Trajectory) -> list[Json]:
    """Everything on the page.

    Args:
        robot: The arm.
        scene: What stands around it.
        trajectory: The motion; with a single sample the arm stands still.

    Returns:
        Commands for meshcat's viewer, in the order in which they are to be handled.

    Raises:
        InputError: The trajectory is of other joints than the robot's.
    """
    if trajectory.joint_names != robot.joint_names:
        got, expected = ", ".join(trajectory.joint_names), ", ".join(robot.joint_names)
        raise InputError(
            f"the trajectory moves {got}; the joints of {robot.name!r} are {expected}",
            expected=list(robot.joint_names),
            got=list(trajectory.joint_names),
        )
    view = _frame(robot, scene, trajectory)
    commands = [
        *_lights(view),
        *_camera(view),
        # The viewer's camera can only circle the world's origin, so the world is moved there.
        _set_transform(_ROOT, three.transform(position=-view.target)),
        _set_object(f"{_ROOT}/ground", _ground(view)),
        *_scene_objects(scene),
        *_arm(robot, trajectory.position[0]),
    ]
    if trajectory.samples > 1:
        for name, row, color, layer in (("start", 0, START_COLOR, 1), ("goal", -1, GOAL_COLOR, 2)):
            commands.extend(_ghost(robot, trajectory.position[row], name, color, layer))
        commands.append(_set_object(f"{_ROOT}/tool path", _tool_path(robot.tool_positions(trajectory.position))))
        commands.append(_animation(robot, trajectory))
    return commands


def keyframe_times(trajectory: Trajectory) -> FloatArray:
    """Times of the keyframes, (k,) from 0 to the end, at most `FRAME_RATE_HZ` of them a second."""
    steps = min(trajectory.samples - 1, int(np.ceil(trajectory.duration * FRAME_RATE_HZ)))
    if steps == trajectory.samples - 1:
        return trajectory.time
    times: FloatArray = np.linspace(0.0, trajectory.duration, steps + 1)
    return times


# Commands of meshcat's viewer.


def _set_object(path: str, body: Body | Json) -> Json:
    return {"type": "set_object", "path": path, "object": body.json() if isinstance(body, Body) else body}


def _set_transform(path: str, matrix: FloatArray) -> Json:
    return {"type": "set_transform", "path": path, "matrix": three.numbers(matrix.T)}


def _set_property(path: str, name: str, value: Any) -> Json:
    return {"type": "set_property", "path": path, "property": name, "value": value}


def _node(kind: str, name: str) -> str:
    """A path element: the kind keeps names like `constructor` apart from JavaScript's own, a slash would part it."""
    return f"{kind} {name}".replace("/", "∕")  # noqa: RUF001


# The arm.


def _joint_paths(model: pin.Model, top: str) -> list[str]:
    """Path of the viewer's node for each joint of the model; a joint's node stands in its parent's."""
    paths = [f"{_ROOT}/{top}"]
    for joint in range(1, model.njoints):
        paths.append(f"{paths[model.parents[joint]]}/{_node('joint', model.names[joint])}")
    return paths


def _arm(robot: Robot, q: FloatArray) -> list[Json]:
    bodies: dict[int, Body] = defaultdict(Body)
    for item in robot.visual_model.geometryObjects:
        surface = three.material(three.color_of(item.meshColor), opacity=float(item.meshColor[3]))
        shape, pose = item.geometry, item.placement.homogeneous
        three.add_shape(bodies[item.parentJoint], shape, surface, pose, name=item.name)
    return _posed(robot, q, "arm", bodies)


def _ghost(robot: Robot, q: FloatArray, name: str, color: int, layer: int) -> list[Json]:
    surface = three.ghost_material(color, 0.28, layer)
    bodies: dict[int, Body] = defaultdict(Body)
    # What stands below the shoulder is left out: at most it turns in place.
    first = robot.model.getJointId(robot.arm.joint_names[0])
    for item in robot.visual_model.geometryObjects:
        if item.parentJoint >= first:
            shape, pose = item.geometry, item.placement.homogeneous
            three.add_shape(bodies[item.parentJoint], shape, surface, pose, name=item.name, shadow=False, order=2)
    return _posed(robot, q, f"{name} pose", bodies)


def _posed(robot: Robot, q: FloatArray, top: str, bodies: dict[int, Body]) -> list[Json]:
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, q)
    commands = []
    for joint, path in enumerate(_joint_paths(model, top)):
        if joint > 0:
            commands.append(_set_transform(path, data.liMi[joint].homogeneous))
        if len(bodies[joint]) > 0:
            commands.append(_set_object(path, bodies[joint]))
    return commands


def _animation(robot: Robot, trajectory: Trajectory) -> Json:
    """Every joint's turn over time, in seconds of the motion, again and again."""
    model, data = robot.model, robot.model.createData()
    times = keyframe_times(trajectory)
    columns = [np.interp(times, trajectory.time, column) for column in trajectory.position.T]
    turns = np.empty((model.njoints, len(times), 4))
    for k, q in enumerate(np.column_stack(columns)):
        pin.forwardKinematics(model, data, q)
        for joint in range(1, model.njoints):
            turns[joint, k] = pin.Quaternion(data.liMi[joint].rotation).coeffs()
    # A revolute joint moves in its parent's frame by turning alone: between keyframes the viewer's interpolation of
    # the turn is exact. The last key is repeated, so that the arm rests at the goal.
    key_times = three.numbers([*times, trajectory.duration + REST_S])
    clips = [
        {
            "path": path,
            "clip": {
                "name": "motion",
                "fps": 1,
                "tracks": [
                    {
                        "name": ".quaternion",
                        "type": "quaternion",
                        "times": key_times,
                        "values": three.numbers(np.vstack([turns[joint], turns[joint, -1:]])),
                    }
                ],
            },
        }
        for joint, path in enumerate(_joint_paths(model, "arm"))
        if joint > 0
    ]
    return {
        "type": "set_animation",
        "path": "",
        "animations": clips,
        "options": {"play": True, "repetitions": _REPETITIONS},
    }


def _tool_path(tool: FloatArray) -> Body:
    """The tool's way as a tube that turns from the start's colour to the goal's, a ball at each end."""
    body = Body()
    start, goal = _rgb(START_COLOR), _rgb(GOAL_COLOR)
    for name, point, color in (("start", tool[0], START_COLOR), ("goal", tool[-1], GOAL_COLOR)):
        body.add(three.sphere(0.022), three.material(color), three.transform(position=point), name=name, shadow=False)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tool, axis=0), axis=1))])
    if along[-1] > 1e-3:
        # Evenly spaced along the way, 2 cm or so apart: slow stretches do not crowd.
        count = int(np.clip(np.ceil(along[-1] / 0.02), 16, 400))
        stations = np.linspace(0.0, along[-1], count + 1)
        points = np.column_stack([np.interp(stations, along, column) for column in tool.T])
        share = stations[:, None] / along[-1]
        colors = (1.0 - share) * start + share * goal
        surface = three.material(0xFFFFFF, kind="MeshLambertMaterial", vertexColors=True)
        body.add(three.tube(points, 0.009, colors), surface, name="way", shadow=False)
    return body


# The scene.


def _scene_objects(scene: Scene) -> list[Json]:
    surface = three.material(OBSTACLE_COLOR, opacity=0.85)
    commands = []
    for item in scene.obstacles:
        body = Body()
        _add_obstacle(body, item, surface)
        commands.append(_set_object(f"{_ROOT}/obstacles/{_node(item.kind, item.name)}", body))
    for fruit in scene.fruits:
        path = f"{_ROOT}/fruits/{_node('fruit', fruit.name)}"
        commands.append(_set_object(path, _fruit(fruit, is_goal=fruit.name == scene.goal.fruit)))
    return commands


def _add_obstacle(body: Body, item: Sphere | Capsule | Box | Mesh | PointCloud, surface: Json) -> None:
    match item:
        case Sphere():
            body.add(three.sphere(item.radius), surface, three.transform(position=item.center), name=item.name)
        case Capsule():
            three.add_capsule(body, item.start, item.end, item.radius, surface, name=item.name)
        case Box():
            body.add(three.box(item.size), surface, three.transform(item.rotation, item.center), name=item.name)
        case Mesh():
            body.add(three.facets(*item.surface), surface, name=item.name)
        case PointCloud():
            for cloud in item.solids:
                some = cloud.core[:: -(-len(cloud.core) // _MOST_POINTS)]
                # The viewer takes a dot's size as if the field of view were 90 degrees.
                wide = 2.0 * cloud.rounding / np.tan(np.radians(0.5 * _FIELD_OF_VIEW_DEG))
                dots = three.dots_material(OBSTACLE_COLOR, float(wide))
                body.add(three.points(some), dots, name=item.name, kind="Points", shadow=False)
        case _:
            assert_never(item)


def _fruit(fruit: Fruit, *, is_goal: bool) -> Body:
    body = Body()
    pose = three.transform(position=fruit.center)
    color = GOAL_FRUIT_COLOR if is_goal else FRUIT_COLOR
    body.add(three.sphere(fruit.radius), three.material(color, roughness=0.35), pose, name=fruit.name)
    if is_goal:
        halo = three.material(HALO_COLOR, opacity=0.3, kind="MeshBasicMaterial", depthWrite=False)
        body.add(three.sphere(1.5 * fruit.radius), halo, pose, name="goal", shadow=False, order=3)
    return body


# Ground, lights, camera.


@dataclass(frozen=True)
class _Frame:
    """Where the camera stands and what it looks at.

    Attributes:
        target: (3,) point in the middle of the picture [m].
        camera: (3,) camera position [m].
        radius: Size of what is to be seen [m].
        ground: (2,) middle of the ground [m].
    """

    target: FloatArray
    camera: FloatArray
    radius: float
    ground: FloatArray


def _frame(robot: Robot, scene: Scene, trajectory: Trajectory) -> _Frame:
    """Place the camera so that arm and scene fill the picture and the arm plane is seen from the side."""
    rows = np.unique(np.linspace(0, trajectory.samples - 1, 25).astype(int))
    points = _visible_points(robot, scene, trajectory.position[rows])
    yaws = [robot.yaw_of(q) for q in trajectory.position[rows]]
    yaw = 0.5 * (min(yaws) + max(yaws))
    azimuth = yaw + np.radians(_AZIMUTH_DEG - 90.0)
    elevation = np.radians(_ELEVATION_DEG)
    toward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(toward, right)
    # A camera at (a0, b0, d) in the axes (right, up, toward) sees the point (a, b, c) within half-angle tangents t, u
    # exactly if |a - a0| <= (d - c) t and |b - b0| <= (d - c) u: the smallest d has a closed form.
    a, b, c = points @ right, points @ up, points @ toward
    u = np.tan(np.radians(0.5 * _FIELD_OF_VIEW_DEG)) / _MARGIN
    t = u * ASPECT
    left, rightmost = float((c * t - a).max()), float((c * t + a).max())
    low, high = float((c * u - b).max()), float((c * u + b).max())
    depth = max((left + rightmost) / (2.0 * t), (low + high) / (2.0 * u))
    camera = 0.5 * (rightmost - left) * right + 0.5 * (high - low) * up + depth * toward
    middle = 0.5 * float(c.min() + c.max())
    target = camera - (depth - middle) * toward
    low_corner, high_corner = points.min(axis=0), points.max(axis=0)
    return _Frame(
        target=target,
        camera=camera,
        radius=float(0.5 * np.linalg.norm(high_corner - low_corner)),
        ground=0.5 * (low_corner + high_corner)[:2],
    )


def _visible_points(robot: Robot, scene: Scene, configurations: FloatArray) -> FloatArray:
    """Points that the picture must hold, (n, 3) [m]: the moving arm, its foot, obstacles near the arm, fruits."""
    arm: list[NDArray[np.float64]] = []
    for q in configurations:
        origin, axes = robot.plane_at(robot.yaw_of(q))
        arm.append(origin + robot.arm.joint_points(q[robot.arm_slice]) @ axes[:2])
    points = np.vstack(arm)
    width = float(robot.arm.half_widths.max())
    points = np.vstack([points - width, points + width, _footprint(robot)])
    reach = float(robot.arm.lengths.sum())
    for core, rounding in (
        *((_outline(solid), solid.rounding) for item in scene.obstacles for solid in item.solids),
        *((np.array([fruit.center]), fruit.radius) for fruit in scene.fruits),
    ):
        corners = np.vstack([core - rounding, core + rounding])
        # A long wire or a distant wall may leave the picture; what the arm can touch may not.
        points = np.vstack([points, np.clip(corners, robot.plane_origin - reach, robot.plane_origin + reach)])
    points[:, 2] = np.maximum(points[:, 2], 0.0)
    return points


def _outline(solid: Solid) -> FloatArray:
    """Points of a solid that speak for its extent, (k, 3) [m]."""
    return np.stack([solid.core.min(axis=0), solid.core.max(axis=0)]) if solid.loose else solid.core


def _footprint(robot: Robot) -> FloatArray:
    """A square on the ground about the foot, (4, 3) [m]."""
    side = 0.16 * np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)])
    return side * max(1.0, float(robot.arm.lengths[0]))


def _ground(view: _Frame) -> Body:
    """Faint lines 0.5 m apart on the ground z = 0 that fade with distance, and the shadows between them."""
    body = Body()
    spacing = 0.5
    extent = spacing * np.ceil((2.2 * view.radius + 1.0) / spacing)
    middle = spacing * np.round(view.ground / spacing)
    ticks = np.arange(-extent, extent + 0.5 * spacing, spacing)
    n = len(ticks)
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks, indexing="ij"))
    fade = np.clip(1.0 - np.hypot(x, y) / extent, 0.0, 1.0)
    colors = np.column_stack([np.tile(_GRID_COLOR, (n * n, 1)), 0.55 * fade * fade * (3.0 - 2.0 * fade)])
    index = np.arange(n * n).reshape(n, n)
    pairs = np.vstack(
        [
            np.column_stack([index[:-1].ravel(), index[1:].ravel()]),
            np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()]),
        ]
    )
    seen = (colors[pairs, 3] > 0.0).any(axis=1)
    points = np.column_stack([x + middle[0], y + middle[1], np.zeros(n * n)])
    lines = three.material(0xFFFFFF, opacity=0.999, kind="LineBasicMaterial", vertexColors=True, depthWrite=False)
    body.add(
        three.line_segments(points, pairs[seen], colors),
        lines,
        name="grid",
        kind="LineSegments",
        shadow=False,
        order=-1,
    )
    # Only the shadows of this plane are drawn.
    catcher = three.material(0x1F2A3A, opacity=0.22, kind="ShadowMaterial", depthWrite=False)
    plane = {"type": "PlaneGeometry", "width": float(2.0 * extent), "height": float(2.0 * extent)}
    pose = three.transform(position=[*middle, 0.0])
    body.add(plane, catcher, pose, name="shadows", shadow=False, order=-2)
    return body


def _lights(view: _Frame) -> list[Json]:
    """A soft sky, a key light that throws shadows, a weak light from the other side; meshcat's own are put out."""
    commands = [
        _set_property(path, "visible", False)
        for path in (
            "/Grid",
            "/Axes",
            "/Lights/SpotLight",
            "/Lights/PointLightNegativeX",
            "/Lights/PointLightPositiveX",
            "/Lights/AmbientLight",
            "/Lights/FillLight",
        )
    ]
    commands.append(_set_property("/Background", "top_color", list(_SKY_TOP)))
    commands.append(_set_property("/Background", "bottom_color", list(_SKY_BOTTOM)))
    toward = view.camera - view.target
    across = np.array([-toward[1], toward[0], 0.0]) / np.hypot(toward[0], toward[1])
    level = np.array([toward[0], toward[1], 0.0]) / np.hypot(toward[0], toward[1])
    up = np.array([0.0, 0.0, 1.0])
    far = 3.0 * view.radius
    span = 2.0 * view.radius
    shadow = {
        "mapSize": [2048, 2048],
        "radius": 4,
        "bias": -0.0004,
        "normalBias": 0.01,
        "camera": {
            "type": "OrthographicCamera",
            "left": -span,
            "right": span,
            "top": span,
            "bottom": -span,
            "near": 0.1,
            "far": far + 2.0 * span,
        },
    }
    sky = {"type": "HemisphereLight", "color": 0xFFFFFF, "groundColor": 0xB9B2A8, "intensity": 0.58}
    key = {"type": "DirectionalLight", "color": 0xFFF6EA, "intensity": 0.68, "shadow": shadow}
    fill = {"type": "DirectionalLight", "color": 0xDCE9FF, "intensity": 0.25}
    for name, light, place, throws in (
        ("sky", sky, up, False),
        ("key", key, far * (0.45 * level - 0.5 * across + 0.85 * up), True),
        ("fill", fill, far * (0.3 * level + 0.9 * across + 0.3 * up), False),
    ):
        matrix = three.numbers(three.transform(position=place).T)
        data = {"metadata": {"version": 4.5, "type": "Object"}, "object": {"uuid": name, **light, "matrix": matrix}}
        commands.append(_set_object(f"/Lights/{name}", data))
        commands.append(_set_property(f"/Lights/{name}/<object>", "castShadow", throws))
    return commands


def _camera(view: _Frame) -> list[Json]:
    path = "/Cameras/default/rotated"
    lens = {
        "uuid": "camera",
        "type": "PerspectiveCamera",
        "fov": _FIELD_OF_VIEW_DEG,
        "aspect": ASPECT,
        "near": 0.05,
        "far": 200.0,
    }
    x, y, z = view.camera - view.target
    return [
        _set_object(path, {"metadata": {"version": 4.5, "type": "Object"}, "object": lens}),
        # The camera's frame has y upwards.
        _set_property(f"{path}/<object>", "position", three.numbers([x, z, -y])),
    ]


def _rgb(color: int) -> FloatArray:
    return np.array([(color >> shift & 0xFF) / 255.0 for shift in (16, 8, 0)])
