"""Camera, lights and ground of the animated page.

The camera is as close as possible with all points in the picture. `hidden_fraction` measures how much a view direction
hides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.apps.view import three_js as three
from hplan.apps.view.commands import set_object, set_property
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray

#: Minimum aspect ratio (width / height) of the windows that the picture is composed for.
ASPECT = 1.3
#: Vertical field of view [deg].
FIELD_OF_VIEW_DEG = 32.0


@dataclass(frozen=True)
class ViewFrame:
    """Position and target of the camera, and extent of the scene.

    Attributes:
        target: (3,) point in the middle of the picture [m].
        camera: (3,) camera position [m].
        radius: Half of the diagonal of the points' bounding box [m].
        ground: (2,) centre of the ground [m].
    """

    target: FloatArray
    camera: FloatArray
    radius: float
    ground: FloatArray


def frame(points: FloatArray, azimuth: float, elevation: float) -> ViewFrame:
    """Place the camera as close as possible with all points in view.

    Args:
        points: (n, 3) points to show [m].
        azimuth: Azimuth of the camera as seen from the scene [rad].
        elevation: Elevation of the camera [rad].
    """
    right, up, toward = view_axes(azimuth, elevation)
    # A camera at (a0, b0, d) in the axes (right, up, toward) sees the point (a, b, c) within half-angle tangents t, u
    # exactly if |a - a0| <= (d - c) t and |b - b0| <= (d - c) u: the smallest d has a closed form.
    a, b, c = points @ right, points @ up, points @ toward
    u = np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG)) / 1.1  # leaves a margin at the border
    t = u * ASPECT
    left, rightmost = float((c * t - a).max()), float((c * t + a).max())
    low, high = float((c * u - b).max()), float((c * u + b).max())
    depth = max((left + rightmost) / (2.0 * t), (low + high) / (2.0 * u))
    camera = 0.5 * (rightmost - left) * right + 0.5 * (high - low) * up + depth * toward
    middle = 0.5 * float(c.min() + c.max())
    low_corner, high_corner = points.min(axis=0), points.max(axis=0)
    return ViewFrame(
        target=camera - (depth - middle) * toward,
        camera=camera,
        radius=float(0.5 * np.linalg.norm(high_corner - low_corner)),
        ground=0.5 * (low_corner + high_corner)[:2],
    )


def hidden_fraction(
    points: FloatArray, before: FloatArray, widths: FloatArray, azimuth: float, elevation: float
) -> float:
    """Fraction of points hidden by others in a parallel projection.

    Args:
        points: (m, 3) points to show [m].
        before: (n, 3) points that may hide them [m].
        widths: (n,) radii of these [m].
        azimuth: Azimuth of the camera as seen from the scene [rad].
        elevation: Elevation of the camera [rad].
    """
    if not len(before):
        return 0.0
    right, up, toward = view_axes(azimuth, elevation)
    flat = np.column_stack([right, up])
    seen, others = points @ flat, before @ flat
    apart = np.hypot(*(seen[:, None, axis] - others[None, :, axis] for axis in range(2)))
    # A point is hidden by another one that is 0.08 m closer to the camera and overlaps it, within 0.03 m, in the image.
    nearer = (before @ toward)[None] > (points @ toward)[:, None] + 0.08
    return float((nearer & (apart < 0.03 + widths)).any(axis=1).mean())


def view_axes(azimuth: float, elevation: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors right and up in the picture, and towards the camera.

    Args:
        azimuth: Azimuth of the camera as seen from the scene [rad].
        elevation: Elevation of the camera [rad].
    """
    cos = np.cos(elevation)
    toward = np.array([np.cos(azimuth) * cos, np.sin(azimuth) * cos, np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return right, np.cross(toward, right), toward


def camera(view: ViewFrame) -> list[Json]:
    """Commands that place the camera.

    The world's origin must have been moved to `view.target` before.
    """
    path = "/Cameras/default/rotated"
    lens = {
        "uuid": "camera",
        "type": "PerspectiveCamera",
        "fov": FIELD_OF_VIEW_DEG,
        "aspect": ASPECT,
        "near": 0.05,
        "far": 200.0,
    }
    x, y, z = view.camera - view.target
    return [
        set_object(path, {"metadata": {"version": 4.5, "type": "Object"}, "object": lens}),
        # The camera's frame has y up.
        set_property(f"{path}/<object>", "position", three.flatten_numbers([x, z, -y])),
    ]


def lights(view: ViewFrame) -> list[Json]:
    """Commands for sky light, key light with shadows, and fill light.

    Meshcat's own lights, grid and axes are hidden.
    """
    commands = [
        set_property(path, "visible", False)
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
    commands.append(set_property("/Background", "top_color", [0.80, 0.86, 0.92]))
    commands.append(set_property("/Background", "bottom_color", [0.97, 0.97, 0.96]))
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
        matrix = three.flatten_numbers(three.transform(position=place).T)
        data = {"metadata": {"version": 4.5, "type": "Object"}, "object": {"uuid": name, **light, "matrix": matrix}}
        commands.append(set_object(f"/Lights/{name}", data))
        commands.append(set_property(f"/Lights/{name}/<object>", "castShadow", throws))
    return commands


def ground(view: ViewFrame, floor: float) -> Body:
    """Ground with a fading grid, 0.5 m wide, and shadows.

    Args:
        view: The camera's frame, which gives centre and size of the ground.
        floor: Height of the ground [m].
    """
    body = Body()
    spacing = 0.5
    extent = spacing * np.ceil((2.2 * view.radius + 1.0) / spacing)
    middle = spacing * np.round(view.ground / spacing)
    ticks = np.arange(-extent, extent + 0.5 * spacing, spacing)
    n = len(ticks)
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, ticks, indexing="ij"))
    fade = np.clip(1.0 - np.hypot(x, y) / extent, 0.0, 1.0)
    colors = np.column_stack([np.tile((0.35, 0.42, 0.50), (n * n, 1)), 0.55 * fade * fade * (3.0 - 2.0 * fade)])
    index = np.arange(n * n).reshape(n, n)
    pairs = np.vstack(
        [
            np.column_stack([index[:-1].ravel(), index[1:].ravel()]),
            np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()]),
        ]
    )
    seen = (colors[pairs, 3] > 0.0).any(axis=1)
    points = np.column_stack([x + middle[0], y + middle[1], np.full(n * n, floor)])
    lines = three.material(0xFFFFFF, opacity=0.999, kind="LineBasicMaterial", vertexColors=True, depthWrite=False)
    body.add(
        three.line_segments(points, pairs[seen], colors),
        lines,
        name="grid",
        kind="LineSegments",
        shadow=False,
        order=-1,
    )
    # This plane is invisible except for the shadows on it.
    catcher = three.material(0x1F2A3A, opacity=0.22, kind="ShadowMaterial", depthWrite=False)
    plane = {"type": "PlaneGeometry", "width": float(2.0 * extent), "height": float(2.0 * extent)}
    pose = three.transform(position=[*middle, floor])
    body.add(plane, catcher, pose, name="shadows", shadow=False, order=-2)
    return body
