"""Content of the scene page as commands to meshcat's viewer.

The commands create arm, scene, tool path, ghosts, ground, lights and camera. They are plain dictionaries, identical for
the page in a file and for the live server, and deterministic.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from hplan.apps.view import framing, scenery
from hplan.apps.view import three_js as three
from hplan.apps.view.commands import (
    ROOT,
    animation,
    clip,
    node,
    rotation_track,
    set_object,
    set_transform,
    translation_track,
)
from hplan.apps.view.framing import ViewFrame
from hplan.apps.view.playback import Playback
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray
from hplan.collision.collision_bodies import collision_bodies
from hplan.collision.held_objects import holding
from hplan.collision.motion_coefficients import workspace_ball
from hplan.geometry.hull import CUBE_CORNERS
from hplan.geometry.polyline import stations
from hplan.robot.dynamics import joint_axis
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.scene.obstacles import Solid
from hplan.trajectory.trajectory import Phase, Trajectory

#: Maximum number of keyframes per second and per motion; they keep pages of long tours small.
FRAME_RATE_HZ = 60.0
_MOST_FRAMES = 2400
#: Rest at the goal before the motion starts again [s].
REST_S = 1.0

START_COLOR = 0x3D7EFF
GOAL_COLOR = 0x12A150
APPROACH_COLOR = 0xF08A1D

#: Approximate total number of rings in the tool path's tubes, and the minimum spacing of the rings [m].
_RINGS, _RING_SPACING = 900, 0.02

#: Maximum number of triangles of an arm's meshes; a page takes about 400 bytes for each of them.
_MOST_TRIANGLES = 6_000

#: Markers have their full size at arms with at least this reach, and shrink with smaller ones [m].
_FULL_SIZE_REACH = 0.8


def build_stage(robot: Robot, scene: Scene, playback: Playback) -> list[Json]:
    """Build all content of the page.

    Returns:
        Commands for meshcat's viewer, in execution order.

    Raises:
        InputError: The trajectory is for other joints than the robot's; `picked` names a fruit that the scene does not
            have, or a time outside the motion.
    """
    playback.check(robot)
    robot = holding(robot, scene.attached)
    trajectory, picks = playback.trajectory, scenery.picks(scene, playback)
    stands = _stands(scene, playback)
    floor = _floor(robot, stands)
    view = _frame(robot, stands, trajectory, [_row_at(trajectory, pick.since) for pick in picks], floor)
    commands = [
        *framing.lights(view),
        *framing.camera(view),
        # The viewer's camera can only circle the world's origin, so the world is moved there.
        set_transform(ROOT, three.transform(position=-view.target)),
        set_object(f"{ROOT}/ground", framing.ground(view, floor)),
        *scenery.obstacles(scene, frozenset() if playback.bodies is None else playback.bodies.limb_names),
        *scenery.moving_limbs(playback),
        *scenery.fruits(scene, scene.goal.fruit if len(picks) < 2 else None, playback.unpicked),
        *scenery.placed_movers(scene, playback.begin_s),
        *_draw_robot(robot, trajectory.position[0], "arm"),
    ]
    if trajectory.samples > 1:
        # A single ghost would not represent several goals.
        if len(picks) < 2:
            last = _row_at(trajectory, picks[0].since if picks else trajectory.duration)
            for layer, name, row, color in ((1, "start", 0, START_COLOR), (2, "goal", last, GOAL_COLOR)):
                ghost = three.ghost_material(color, 0.28, layer)
                commands += _draw_robot(robot, trajectory.position[row], f"{name} pose", ghost, shadow=False, order=2)
        body = Body()
        for name, tool in playback.frames.items() or [("", robot.tool_frame)]:
            _add_tool_path(body, robot, playback, tool, playback.arms.get(name, playback.phases))
        commands.append(set_object(f"{ROOT}/tool path", body))
        commands.extend(scenery.picked_fruits(picks))
        commands.append(_animation(robot, scene, playback, picks))
    return commands


def keyframe_times(trajectory: Trajectory) -> FloatArray:
    """(k,) times of the keyframes from 0 to the end [s].

    There are at most `FRAME_RATE_HZ` keyframes per second, and at most `_MOST_FRAMES` in all.
    """
    steps = min(trajectory.samples - 1, int(np.ceil(trajectory.duration * FRAME_RATE_HZ)), _MOST_FRAMES)
    if steps == trajectory.samples - 1:
        return trajectory.time
    times: FloatArray = np.linspace(0.0, trajectory.duration, steps + 1)
    return times


# The arm.


def _joint_paths(model: pin.Model, top: str) -> list[str]:
    """Path of the viewer's node for each joint of the model.

    The nodes nest like the joints.
    """
    paths = [f"{ROOT}/{top}"]
    for joint in range(1, model.njoints):
        paths.append(f"{paths[model.parents[joint]]}/{node('joint', model.names[joint])}")
    return paths


def _mesh_share(robot: Robot) -> float:
    """Fraction of the triangles of a robot's visual meshes that is drawn."""
    triangles = sum(getattr(item.geometry, "num_tris", 0) for item in robot.visual_model.geometryObjects)
    return min(1.0, _MOST_TRIANGLES / triangles) if triangles else 1.0


def _draw_robot(robot: Robot, q: FloatArray, top: str, surface: Json | None = None, **settings: Any) -> list[Json]:
    """Draw the robot at a configuration, in colour or as a ghost.

    A ghost omits the base, and bodies that turn about the vertical in place.
    """
    bodies: dict[int, Body] = defaultdict(Body)
    first = 0 if surface is None else 2 if robot.dof > 1 and _turns_upright(robot) else 1
    share = _mesh_share(robot)
    for item in robot.visual_model.geometryObjects:
        if item.parentJoint >= first:
            look = surface or three.material(three.color_of(item.meshColor), opacity=float(item.meshColor[3]))
            shape, pose = item.geometry, item.placement.homogeneous
            three.add_shape(bodies[item.parentJoint], shape, look, pose, share, name=item.name, **settings)
    model, data = robot.model, robot.model.createData()
    pin.forwardKinematics(model, data, q)
    commands = []
    for joint, path in enumerate(_joint_paths(model, top)):
        if joint > 0:
            commands.append(set_transform(path, data.liMi[joint].homogeneous))
        if len(bodies[joint]) > 0:
            commands.append(set_object(path, bodies[joint]))
    return commands


def _turns_upright(robot: Robot) -> bool:
    """True if the first joint turns about the vertical."""
    axis, slides = joint_axis(robot.model, 1)
    return not slides and abs(float(robot.model.jointPlacements[1].rotation[2] @ axis)) > 1.0 - 1e-9


def _animation(robot: Robot, scene: Scene, playback: Playback, picks: Sequence[scenery.Pick]) -> Json:
    """Looping animation of joints, tracked obstacles and picked fruits.

    Its time is that of the motion [s].
    """
    model, data, trajectory = robot.model, robot.model.createData(), playback.trajectory
    times = keyframe_times(trajectory)
    configurations = np.column_stack([np.interp(times, trajectory.time, column) for column in trajectory.position.T])
    turns, places = np.empty((model.njoints, len(times) + 1, 4)), np.empty((model.njoints, len(times) + 1, 3))
    # The last key is repeated, so that the arm rests at the goal.
    for k, q in enumerate(np.vstack([configurations, configurations[-1:]])):
        pin.forwardKinematics(model, data, q)
        for joint in range(1, model.njoints):
            turns[joint, k] = pin.Quaternion(data.liMi[joint].rotation).coeffs()
            places[joint, k] = data.liMi[joint].translation
    end = trajectory.duration + REST_S
    # A joint rotates or translates in its parent's frame; the viewer interpolates both exactly between keyframes.
    # Joints whose origin moves by more than this in their parent's frame are prismatic, the others revolute [m].
    slid = 1e-9
    clips = [
        clip(
            path,
            translation_track([*times, end], places[joint])
            if np.ptp(places[joint], axis=0).max() > slid
            else rotation_track([*times, end], turns[joint]),
        )
        for joint, path in enumerate(_joint_paths(model, "arm"))
        if joint > 0
    ]
    clips += scenery.moving_clips(scene, times, playback.begin_s, end)
    clips += scenery.tree_clips(playback, end)
    tools = {tool: robot.forward_kinematics(configurations, tool)[:, :3, 3] for tool in {pick.tool for pick in picks}}
    return animation([*clips, *scenery.picked_clips(picks, times, tools, end)])


def _row_at(trajectory: Trajectory, time: float) -> int:
    """Index of the trajectory sample nearest to a time [s]."""
    return int(np.argmin(np.abs(trajectory.time - time)))


def _add_tool_path(body: Body, robot: Robot, playback: Playback, frame: str, phases: Sequence[Phase]) -> None:
    """Draw a tool's path as a tube with balls at its ends.

    Its colour changes from the start's to the goal's; approaches are drawn separately.
    """
    trajectory = playback.trajectory
    tool = robot.forward_kinematics(trajectory.position, frame)[:, :3, 3]
    stretches = [
        (phase.name, _row_at(trajectory, phase.start_s), _row_at(trajectory, phase.end_s))
        for phase in phases
        if phase.name != "retreat"  # it retraces the approach's path
    ] or [("transit", 0, trajectory.samples - 1)]
    last = stretches[-1][2]
    size = min(1.0, float(workspace_ball(robot)[3]) / _FULL_SIZE_REACH)
    for name, point, color in (("start", tool[0], START_COLOR), ("goal", tool[last], GOAL_COLOR)):
        body.add(
            three.sphere(0.022 * size), three.material(color), three.transform(position=point), name=name, shadow=False
        )
    along = stations(tool)
    surface = three.material(0xFFFFFF, kind="MeshLambertMaterial", vertexColors=True)
    # The many paths of a tour are thinner.
    radius, sides = (0.009 * size, 10) if len(stretches) <= 3 else (0.005 * size, 6)
    for name, first, end in stretches:
        length = float(along[end] - along[first])
        if length > 1e-3:
            # Evenly spaced along the path, so that rings do not crowd in slow segments.
            count = max(int(np.ceil(length / max(_RING_SPACING, along[-1] / _RINGS))), 8)
            evenly = np.linspace(along[first], along[end], count + 1)
            rows = slice(first, end + 1)
            points = np.column_stack([np.interp(evenly, along[rows], axis) for axis in tool[rows].T])
            fraction = evenly[:, None] / along[last]
            colors = (1.0 - fraction) * three.rgb(START_COLOR) + fraction * three.rgb(GOAL_COLOR)
            if name == "approach":
                colors = np.tile(three.rgb(APPROACH_COLOR), (count + 1, 1))
            tube = three.tube(points, 1.2 * radius if name == "approach" else radius, colors, sides=sides)
            body.add(tube, surface, name="way" if name == "transit" else name, shadow=False)


# Ground and camera.


def _stands(scene: Scene, playback: Playback) -> list[Scene]:
    """Scenes at several times of a motion, for framing.

    One scene if only the arm moves.
    """
    if not scene.moves:
        return [scene]
    return [
        scene.snapshot(playback.begin_s + part * playback.trajectory.duration) for part in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]


def _floor(robot: Robot, stands: Sequence[Scene]) -> float:
    """Height of the ground [m].

    0, or the bottom of furniture below the arm's foot.

    Such furniture is a table, shelf or platform that extends below the foot.
    """
    solids = [_outline(solid) for scene in stands for item in scene.obstacles for solid in item.solids]
    lowest = min((float(core[:, 2].min()) for core in solids if not _is_ground(robot, core)), default=0.0)
    return min(0.0, max(lowest, -float(workspace_ball(robot)[3])))


def _is_ground(robot: Robot, corners: FloatArray) -> bool:
    """True if a body does not extend above the arm's foot and is wider than the arm can span."""
    if corners[:, 2].max() > 0.0:
        return False
    return bool(np.ptp(corners[:, :2], axis=0).max() > 2.0 * workspace_ball(robot)[3])


def _frame(
    robot: Robot, stands: Sequence[Scene], trajectory: Trajectory, picks: Sequence[int], floor: float
) -> ViewFrame:
    """Place the camera to view the arm from the side.

    The scene fills the picture. The side is that of the vertical plane through the first joint and the tool; for
    several picked fruits, of the plane in the middle of the picks. Among four candidate directions, in front of and
    behind the arm, it takes the one that hides the least of the arm and its path.
    """
    count = min(25 * max(1, len(picks)), 100)
    rows = np.unique([*np.linspace(0, trajectory.samples - 1, count).astype(int), *picks])
    configurations = trajectory.position[rows]
    tool = robot.tool_positions(trajectory.position[picks] if len(picks) > 1 else configurations)
    out = tool[:, :2] - robot.model.jointPlacements[1].translation[:2]
    headings = np.unwrap(np.arctan2(out[:, 1], out[:, 0]))
    heading = 0.5 * float(headings.min() + headings.max())
    # Camera directions: to the side of the arm plane, turned forwards or backwards, and raised [deg].
    aside, elevation = 32.0, np.radians(17.0)
    arm = _arm_points(robot, configurations)
    blocking = [_blocking_points(scene) for scene in stands]
    before, widths = (np.concatenate(values) for values in zip(*blocking, strict=True))
    sides = heading + np.radians([turn for side in (-90.0, 90.0) for turn in (side + aside, side - aside)])
    hidden = [framing.hidden_fraction(arm, before, widths, azimuth, elevation) for azimuth in sides]
    visible = _visible_points(robot, stands, np.vstack([arm, _corners(robot, configurations)]), floor)
    return framing.frame(visible, float(sides[int(np.argmin(hidden))]), elevation)


def _arm_points(robot: Robot, configurations: FloatArray) -> FloatArray:
    """(n, 3) positions of joints, tool and link midpoints [m].

    Those of all configurations, in sequence.
    """
    points, (model, data) = [np.zeros((0, 3))], (robot.model, robot.model.createData())
    frame = robot.frame_number(robot.tool_frame)
    for q in configurations:
        pin.framesForwardKinematics(model, data, q)
        tool = data.oMf[frame].translation
        joints = np.array([*(data.oMi[joint].translation for joint in range(1, model.njoints)), tool])
        points += [joints, 0.5 * (joints[1:] + joints[:-1])]
    return np.vstack(points)


def _corners(robot: Robot, configurations: FloatArray) -> FloatArray:
    """(n, 3) corners of the arm bodies' bounding boxes [m].

    Those of all configurations, in sequence.
    """
    bodies = [body for body in collision_bodies(robot) if body.joint >= 0]
    ends = [(body.core.min(axis=0) - body.rounding, body.core.max(axis=0) + body.rounding) for body in bodies]
    boxes = [np.where(CUBE_CORNERS < 0.0, low, high) for low, high in ends]
    points, data = [np.zeros((0, 3))], robot.model.createData()
    for q in configurations:
        pin.forwardKinematics(robot.model, data, q)
        for body, box in zip(bodies, boxes, strict=True):
            place = data.oMi[body.joint + 1]
            points.append(box @ place.rotation.T + place.translation)
    return np.vstack(points)


def _blocking_points(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Points of solids and extents about them [m].

    The points are (n, 3); the (n,) extents are the radius of each point's solid about it.
    """
    points, widths = [np.zeros((0, 3))], [np.zeros(0)]
    for solid in scene.solids:
        core = solid.core
        if solid.is_point_set:
            core = core[:: -(-len(core) // 500)]
        elif len(core) > 1:
            fraction = np.linspace(0.0, 1.0, 5)[:, None, None]
            core = ((1.0 - fraction) * core + fraction * core[::-1]).reshape(-1, 3)
        points.append(core)
        widths.append(np.full(len(core), solid.rounding))
    return np.vstack(points), np.concatenate(widths)


def _visible_points(robot: Robot, stands: Sequence[Scene], arm: FloatArray, floor: float) -> FloatArray:
    """(n, 3) points that the picture must include [m].

    They belong to the moving arm, its foot, obstacles near the arm, and fruits.
    """
    ball = workspace_ball(robot)
    # A square on the ground about the foot.
    points = [arm, 0.16 * np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)])]
    for core, rounding in (
        *((_outline(solid), solid.rounding) for scene in stands for item in scene.obstacles for solid in item.solids),
        *((np.array([fruit.center]), fruit.radius) for scene in stands for fruit in scene.fruits),
    ):
        corners = np.vstack([core - rounding, core + rounding])
        if _is_ground(robot, corners):
            continue  # ground may extend beyond the picture
        # A long wire or a distant wall may leave the picture; bodies within the arm's reach may not.
        points.append(np.clip(corners, ball[:3] - ball[3], ball[:3] + ball[3]))
    result = np.vstack(points)
    result[:, 2] = np.maximum(result[:, 2], floor)
    return result


def _outline(solid: Solid) -> FloatArray:
    """(k, 3) points that represent a solid's extent [m]."""
    return np.stack([solid.core.min(axis=0), solid.core.max(axis=0)]) if solid.is_point_set else solid.core
