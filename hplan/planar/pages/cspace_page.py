"""Interactive page of the C-space at one yaw.

It shows the forbidden region and the motion.

A ball moves along the motion. The joints' ranges map to a cube: the first joint to the right, the second backwards, the
third up. The region has the same surface as in the figures. The line is pale if the motion's yaw is far from the
region's.
"""

from __future__ import annotations

import math

import numpy as np

from hplan.apps.view import framing
from hplan.apps.view import three_js as three
from hplan.apps.view.commands import ROOT, animation, clip, node, set_object, set_transform, translation_track
from hplan.apps.view.page import document
from hplan.apps.view.scene_stage import GOAL_COLOR, REST_S, START_COLOR
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray
from hplan.geometry.polyline import stations
from hplan.planar.pages.cspace_surface import surface_net
from hplan.planar.pages.yaw_section import YawSection

_REGION_COLOR = 0xE07B39
_FAR_COLOR = np.array([0.72, 0.79, 0.85])
_NEAR = np.array([0.133, 0.188, 0.235])
_BOX_COLOR = np.array([0.40, 0.46, 0.52, 0.8])
_FAINT_COLOR = np.array([0.40, 0.46, 0.52, 0.25])

#: Edge of the cube of the joints' ranges [m].
_EDGE = 2.0
_RINGS = 240


def render_cspace_page(section: YawSection, title: str) -> str:
    """Render the page as self-contained HTML.

    The ball moves in real time in a loop.

    Raises:
        HplanError: meshcat, which provides the viewer, is not installed.
    """
    words = f"C-space at yaw {math.degrees(section.yaw):.1f}°"
    far = math.degrees(float(section.yaw_distance.max()))
    entries = [("Forbidden", [_REGION_COLOR]), ("Motion", [0x22303C])]
    if far > 0.5:
        entries.append((f"Motion at a yaw {far:.0f}° away", [three.color_of(_FAR_COLOR)]))
    entries += [("Start", [START_COLOR]), ("Goal", [GOAL_COLOR])]
    return document(title, words, entries, _commands(section))


def _commands(section: YawSection) -> list[Json]:
    half = 0.5 * _EDGE
    corners = half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    azimuth, elevation = np.radians(section.view)
    # The labels are outside the cube.
    view = framing.frame(1.2 * corners, float(azimuth), float(elevation))
    motion = _cube_positions(section, section.grid.position(section.path))
    commands = [
        *framing.lights(view),
        *framing.camera(view),
        set_transform(ROOT, three.transform(position=-view.target)),
        set_object(f"{ROOT}/box", _box(section)),
        *_labels(section),
        set_object(f"{ROOT}/motion", _motion(section, motion)),
    ]
    vertices, faces = surface_net(section.field)
    if len(faces):
        body = Body()
        # The wall is invisible from inside the region, which only a motion at another yaw can enter.
        look = three.material(_REGION_COLOR, opacity=0.88, roughness=0.8)
        body.add(three.surface(_cube_positions(section, vertices), faces), look, name="forbidden", shadow=False)
        commands.append(set_object(f"{ROOT}/forbidden", body))
    ball, path = Body(), f"{ROOT}/arm"
    ball.add(three.sphere(0.035), three.material(0xFFC53D), name="arm", shadow=False)
    commands += [set_object(path, ball), set_transform(path, three.transform(position=motion[0]))]
    if section.times[-1] > 0.0:
        end = section.times[-1] + REST_S
        commands.append(
            animation([clip(path, translation_track([*section.times, end], np.vstack([motion, motion[-1:]])))])
        )
    return commands


def _cube_positions(section: YawSection, nodes: FloatArray) -> FloatArray:
    """Positions in the cube of (n, 3) grid positions [m].

    Grid positions are in units of nodes.
    """
    return _EDGE * (nodes / (np.array(section.grid.shape) - 1.0) - 0.5)


def _motion(section: YawSection, motion: FloatArray) -> Body:
    body = Body()
    for name, point, color in (("start", motion[0], START_COLOR), ("goal", motion[-1], GOAL_COLOR)):
        body.add(three.sphere(0.045), three.material(color), three.transform(position=point), name=name, shadow=False)
    along = stations(motion)
    if along[-1] > 1e-3:
        evenly = np.linspace(0.0, along[-1], _RINGS + 1)
        points = np.column_stack([np.interp(evenly, along, axis) for axis in motion.T])
        farthest = max(float(section.yaw_distance.max()), math.radians(0.5))
        fraction = np.interp(evenly, along, section.yaw_distance / farthest)
        colors = _NEAR + fraction[:, None] * (_FAR_COLOR - _NEAR)
        look = three.material(0xFFFFFF, kind="MeshLambertMaterial", vertexColors=True)
        body.add(three.tube(points, 0.014, colors), look, name="way", shadow=False)
    return body


def _ticks(section: YawSection, axis: int) -> list[float]:
    """Angles of the labels along an axis [deg]."""
    low, high = (math.degrees(float(section.grid.axis(axis)[end])) for end in (0, -1))
    spacing = 30.0 * max(1, math.ceil((high - low) / 180.0))
    ticks = spacing * np.arange(math.ceil(low / spacing - 1e-9), math.floor(high / spacing + 1e-9) + 1)
    return [float(tick) for tick in ticks]


def _edge_position(section: YawSection, axis: int, degrees: float) -> float:
    """Position of an angle along its edge of the cube [m]."""
    grid = section.grid
    fraction = (math.radians(degrees) - grid.lower[axis]) / (grid.step[axis] * (grid.shape[axis] - 1))
    return float(_EDGE * (fraction - 0.5))


def _box(section: YawSection) -> Body:
    """Edges of the cube, and lines at the labels.

    The lines are on its floor and walls.
    """
    half = 0.5 * _EDGE
    points: list[FloatArray] = []
    colors: list[FloatArray] = []

    def line(start: FloatArray, end: FloatArray, color: FloatArray) -> None:
        points.extend([start, end])
        colors.extend([color, color])

    for axis in range(3):
        first, second = [other for other in range(3) if other != axis]
        for a in (-half, half):
            for b in (-half, half):
                ends = np.zeros((2, 3))
                ends[:, axis], ends[:, first], ends[:, second] = (-half, half), a, b
                line(ends[0], ends[1], _BOX_COLOR)
    for axis in range(2):
        for tick in _ticks(section, axis):
            ends = np.zeros((2, 3))
            ends[:, axis], ends[:, 1 - axis], ends[:, 2] = _edge_position(section, axis, tick), (-half, half), -half
            line(ends[0], ends[1], _FAINT_COLOR)
    body = Body()
    look = three.material(0xFFFFFF, opacity=0.999, kind="LineBasicMaterial", vertexColors=True, depthWrite=False)
    pairs = np.arange(len(points)).reshape(-1, 2)
    lines = three.line_segments(np.array(points), pairs, np.array(colors))
    body.add(lines, look, name="edges", kind="LineSegments", shadow=False, order=-1)
    return body


def _labels(section: YawSection) -> list[Json]:
    """Angles and names along three front edges of the cube."""
    half, outside = 0.5 * _EDGE, 1.13 * 0.5 * _EDGE
    azimuth = math.radians(section.view[0])
    near = np.sign([math.cos(azimuth), math.sin(azimuth)])
    right = np.array([-math.sin(azimuth), math.cos(azimuth)])
    # Theta 3 along the upright edge farthest to the right.
    corner = max(((x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)), key=lambda place: float(right @ place))
    lines = (
        (0, lambda t, out: (t, near[1] * out, -half)),
        (1, lambda t, out: (near[0] * out, t, -half)),
        (2, lambda t, out: (corner[0] * (out - 0.03), corner[1] * (out - 0.03), t)),
    )
    commands = []
    for axis, place in lines:
        texts = [(f"{tick:g}", _edge_position(section, axis, tick), outside) for tick in _ticks(section, axis)]
        if axis == 2:
            del texts[:1]  # it would overlap the label of the second joint's end
        texts.append((f"{section.joint_names[axis]} [deg]", 0.0, outside + 0.26 * half))
        for text, along, out in texts:
            path = f"{ROOT}/labels/{node(f'joint {axis + 1}', text)}"
            commands.append(set_object(path, three.label(text, 0.06)))
            commands.append(set_transform(path, three.transform(position=place(along, out))))
    return commands
