"""Obstacles and fruits of the page: appearance, tracks and picked fruits.

The material of an obstacle is guessed from the words of its name. All capsules of one material are drawn as instances
of one shape, so that a tree of hundreds of capsules costs the viewer no more than one.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from hplan.apps.view import body_motions
from hplan.apps.view import three_js as three
from hplan.apps.view.commands import (
    ROOT,
    clip,
    node,
    rotation_track,
    set_object,
    set_property,
    set_transform,
    translation_track,
    visibility_track,
)
from hplan.apps.view.framing import FIELD_OF_VIEW_DEG
from hplan.apps.view.playback import Playback
from hplan.apps.view.three_js import Body, Json
from hplan.base.arrays import FloatArray
from hplan.collision.coal_shapes import solid_shape
from hplan.errors import InputError
from hplan.scene.fruit import Fruit
from hplan.scene.model import Scene
from hplan.scene.obstacles import AnyObstacle, Box, Capsule, Cylinder, PointCloud, Sphere
from hplan.scene.tracks import Track


@dataclass(frozen=True)
class Appearance:
    """Appearance of the obstacles of one material.

    Attributes:
        label: Name of the material in the legend.
        color: Colour, 0xrrggbb.
        words: Words that identify the material in an obstacle's name.
        opacity: Opacity; 1 is opaque.
    """

    label: str
    color: int
    words: frozenset[str]
    opacity: float = 1.0


LEAVES = Appearance("Leaves", 0x7FA35F, frozenset({"leaf", "leaves", "foliage", "canopy", "crown", "hedge"}))
WOOD = Appearance(
    "Wood",
    0x866349,
    frozenset({"tree", "trunk", "branch", "branches", "shoot", "limb", "twig", "stem", "leader", "wood", "spur"}),
)
METAL = Appearance(
    "Posts and wires", 0x8B949E, frozenset({"wire", "post", "pole", "stake", "cable", "rail", "trellis"})
)
BULK = Appearance(
    "Ground and vehicle",
    0xB4B7B2,
    frozenset({"ground", "floor", "soil", "vehicle", "platform", "cart", "tractor", "trailer", "wall", "bin"}),
)
OTHER = Appearance("Obstacles", 0x7B5EA7, frozenset(), 0.85)

#: Colours of fruits that are not picked, by reason.
UNPICKED_COLORS: Final = {"out_of_reach": 0xAEB6BF, "blocked": 0xF29F05, "no_approach": 0xF2D64B, "no_motion": 0x7D6BA8}

FRUIT_COLOR = 0xD7263D
GOAL_FRUIT_COLOR = 0xFF3B2F
HALO_COLOR = 0xFFC53D
#: Also lighter than the other colours, for viewers who cannot distinguish red from green.
PICKED_COLOR = 0x9BD84A


def look_of(name: str) -> Appearance:
    """Appearance of an obstacle according to the words of its name.

    A plural `s` at the end of a word is ignored.
    """
    words = set(re.findall(r"[a-z]+", name.lower()))
    words |= {word.removesuffix("s") for word in words}
    return next((look for look in (LEAVES, WOOD, METAL, BULK) if words & look.words), OTHER)


def looks(scene: Scene) -> list[Appearance]:
    """Distinct appearances of a scene's obstacles."""
    return list(dict.fromkeys(look_of(item.name) for item in scene.obstacles))


def obstacles(scene: Scene, left_out: Collection[str] = ()) -> list[Json]:
    """Commands that draw the obstacles at their listed poses, except for some capsules.

    Capsules are grouped by appearance; all other obstacles are separate objects.
    """
    commands, capsules, movers = [], defaultdict(list), moving_nodes(scene)
    for item in scene.obstacles:
        look, top = look_of(item.name), movers.get(item.name, f"{ROOT}/obstacles")
        if isinstance(item, Capsule):
            if item.name not in left_out:
                capsules[top, look].append(item)
        else:
            body = Body()
            _add_node(body, item, look)
            commands.append(set_object(f"{top}/{node(item.kind, item.name)}", body))
    for (top, look), items in capsules.items():
        body = Body()
        starts, ends = (np.array([getattr(item, end) for item in items]) for end in ("start", "end"))
        radii = np.array([item.radius for item in items])
        three.add_capsules(body, starts, ends, radii, _surface(look), name=look.label)
        commands.append(set_object(f"{top}/{look.label}", body))
    return commands


def moving_limbs(playback: Playback) -> list[Json]:
    """Commands that draw the limbs that move in a playback."""
    return [] if playback.bodies is None else body_motions.moving_limbs(playback.bodies, _surface(WOOD))


def tree_clips(playback: Playback, end: float) -> list[Json]:
    """Animation of limbs and fruit that move in a playback, up to the end of the animation [s]."""
    bodies, duration = playback.bodies, playback.trajectory.duration
    if bodies is None:
        return []
    tracks = body_motions.fruit_tracks(bodies, duration, end)
    fruits = [clip(_fruit_path(name), track) for name, track in tracks.items()]
    return body_motions.limb_clips(bodies, duration, end) + fruits


def moving_nodes(scene: Scene) -> dict[str, str]:
    """Viewer node of each moving obstacle or fruit, by name.

    Items with the same track share a node.
    """
    items = [item for item in (*scene.obstacles, *scene.fruits) if scene.base_track is not None or item.track]
    numbers: dict[Track | None, int] = {}
    return {item.name: f"{ROOT}/moving {numbers.setdefault(item.track, len(numbers))}" for item in items}


def _node_poses(scene: Scene, times: ArrayLike) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Poses of the moving nodes at (k,) times [s].

    Times are on the clock of the tracks.

    Returns:
        (k, 3, 3) rotations and (k, 3) translations [m], by the path of the node.
    """
    poses = scene.poses_at(times)
    return {path: poses[name] for name, path in moving_nodes(scene).items()}


def placed_movers(scene: Scene, time_s: float) -> list[Json]:
    """Commands that set the poses of moving obstacles and fruits.

    `time_s` is on the clock of the tracks [s].
    """
    return [
        set_transform(path, three.transform(turns[0], shifts[0]))
        for path, (turns, shifts) in _node_poses(scene, [time_s]).items()
    ]


def moving_clips(scene: Scene, times: FloatArray, begin_s: float, end: float) -> list[Json]:
    """Animation of moving obstacles and fruits.

    Args:
        scene: The scene.
        times: (k,) times of the keyframes, on the motion's clock; the viewer interpolates between them [s].
        begin_s: Start time of the motion on the tracks' clock [s].
        end: End of the animation; after the motion everything is at rest [s].
    """
    clock = [*times.tolist(), end]
    clips = []
    for path, (turns, shifts) in _node_poses(scene, begin_s + np.append(times, times[-1])).items():
        quaternions = np.array([pin.Quaternion(turn).coeffs() for turn in turns])
        clips.append(clip(path, rotation_track(clock, quaternions), translation_track(clock, shifts)))
    return clips


def _surface(look: Appearance) -> Json:
    return three.material(look.color, opacity=look.opacity, roughness=0.55 if look in (OTHER, METAL) else 0.85)


def _add_node(body: Body, item: AnyObstacle, look: Appearance) -> None:
    surface = _surface(look)
    # Maximum number of points of a cloud that are drawn.
    most_points = 20_000
    match item:
        case PointCloud():
            for cloud in item.solids:
                some = cloud.core[:: -(-len(cloud.core) // most_points)]
                # The viewer scales dots for a field of view of 90 degrees, independent of the camera.
                wide = 2.0 * cloud.rounding / np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG))
                dots = three.dots_material(look.color, float(wide))
                body.add(three.points(some), dots, name=item.name, kind="Points", shadow=False)
        case Sphere() | Cylinder() | Box():
            shape = solid_shape(item)
            three.add_shape(body, shape.geometry, surface, shape.placement.homogeneous, name=item.name)
        case _:
            body.add(three.facets(*item.surface), surface, name=item.name)


def fruits(scene: Scene, goal: str | None, unpicked: Mapping[str, str] = MappingProxyType({})) -> list[Json]:
    """Commands that draw the fruits on the trees.

    Args:
        scene: The scene.
        goal: Name of the fruit to highlight; None for no highlight.
        unpicked: Reason of each fruit that is not picked, by name; it decides the colour.
    """
    commands, movers = [], moving_nodes(scene)
    for fruit in scene.fruits:
        path = f"{movers[fruit.name]}/{node('fruit', fruit.name)}" if fruit.name in movers else _fruit_path(fruit.name)
        commands.append(set_object(path, _fruit(fruit, unpicked.get(fruit.name), is_goal=fruit.name == goal)))
        commands.append(set_transform(path, three.transform(position=fruit.center)))
    return commands


def _fruit_path(name: str) -> str:
    return f"{ROOT}/fruits/{node('fruit', name)}"


def _fruit(fruit: Fruit, reason: str | None, *, is_goal: bool) -> Body:
    body = Body()
    color = GOAL_FRUIT_COLOR if is_goal else UNPICKED_COLORS.get(reason or "", FRUIT_COLOR)
    body.add(three.sphere(fruit.radius), three.material(color, roughness=0.35), name=fruit.name)
    if is_goal:
        halo = three.material(HALO_COLOR, opacity=0.3, kind="MeshBasicMaterial", depthWrite=False)
        body.add(three.sphere(1.5 * fruit.radius), halo, name="goal", shadow=False, order=3)
    return body


# Picking.


@dataclass(frozen=True, eq=False)
class Pick:
    """A fruit that is picked.

    Attributes:
        fruit: The fruit.
        since: Picking time [s].
        until: Release time [s]; inf if the tool keeps it.
        tool: Name of the frame that holds it; None for the robot's tool frame.
    """

    fruit: Fruit
    since: float
    until: float
    tool: str | None = None


def picks(scene: Scene, playback: Playback) -> list[Pick]:
    """Picked fruits in order of picking, with their release times.

    A fruit is released at its time in `dropped`, or else at the end of its retreat, and at the latest when the tool
    picks the next one. A fruit not released before the end of the motion stays in the tool.

    Raises:
        InputError: A picked fruit is not in the scene, or its time is outside the motion.
    """
    known = {fruit.name: fruit for fruit in scene.fruits}
    retreats = [phase for phase in playback.every_phase if phase.name == "retreat"]
    duration = playback.trajectory.duration
    result = []
    for name, time in sorted(playback.picked.items(), key=lambda item: item[1]):
        if name not in known:
            raise InputError(f"picked contains {name!r}, which is not among the scene's fruits", fruit=name)
        if not 0.0 <= time <= duration + 1e-9:
            raise InputError(
                f"{name!r} is picked at {time} s; the motion lasts from 0 to {duration:.6g} s", fruit=name, time=time
            )
        until = min((retreat.end_s for retreat in retreats if abs(retreat.start_s - time) < 1e-3), default=math.inf)
        until = float(playback.dropped.get(name, until))
        until = until if until < duration - 1e-9 else math.inf
        result.append(Pick(known[name], float(time), until, playback.frames.get(playback.pickers.get(name, ""))))
    for number, pick in enumerate(result):  # each tool holds one fruit at a time
        following = next((other.since for other in result[number + 1 :] if other.tool == pick.tool), math.inf)
        result[number] = replace(pick, until=min(pick.until, following))
    return result


def picked_fruits(picks: Sequence[Pick]) -> list[Json]:
    """Commands that draw picked fruits, initially hidden.

    Each one is drawn in another colour in the tool, and translucent at its former place on the tree.
    """
    commands = []
    for pick in picks:
        for top, opacity in (("picked", 1.0), ("places", 0.35)):
            body, path = Body(), _picked_path(top, pick)
            surface = three.material(PICKED_COLOR, opacity=opacity, roughness=0.35)
            body.add(three.sphere(pick.fruit.radius), surface, name=pick.fruit.name, shadow=opacity == 1.0)
            commands += [
                set_object(path, body),
                set_transform(path, three.transform(position=pick.fruit.center)),
                set_property(path, "visible", False),
            ]
    return commands


def picked_clips(
    picks: Sequence[Pick], times: FloatArray, tools: Mapping[str | None, FloatArray], end: float
) -> list[Json]:
    """Animation of picked fruits: visibility and motion with the tool.

    Args:
        picks: The picked fruits.
        times: (k,) times of the keyframes [s].
        tools: (k, 3) positions of each tool's frame, by its name [m].
        end: End of the animation [s].
    """
    clips = []
    for pick in picks:
        held = (times > pick.since) & (times < pick.until)
        stations = np.unique([0.0, pick.since, *times[held], min(pick.until, times[-1]), end])
        tool = tools[pick.tool].T
        at, taken = (np.column_stack([np.interp(t, times, axis) for axis in tool]) for t in (stations, [pick.since]))
        path = np.array(pick.fruit.center) + np.where(stations[:, None] > pick.since, at - taken, 0.0)
        clips += [
            clip(_fruit_path(pick.fruit.name), visibility_track(0.0, pick.since, end)),
            clip(
                _picked_path("picked", pick),
                visibility_track(pick.since, pick.until, end),
                translation_track(stations, path),
            ),
            clip(_picked_path("places", pick), visibility_track(pick.since, math.inf, end)),
        ]
    return clips


def _picked_path(top: str, pick: Pick) -> str:
    return f"{ROOT}/{top}/{node('fruit', pick.fruit.name)}"
