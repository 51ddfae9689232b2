"""Tree rows for any arm: placed and sized by its workspace, with a start beside them.

The workspace is sampled. It only places trees; what a plan proves does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.base.arrays import BoolArray, FloatArray
from hplan.certificate.configuration_check import check
from hplan.errors import HplanError, InputError, OptionError
from hplan.planning.options import PlanOptions
from hplan.planning.plan import plan
from hplan.planning.reachable import FruitReach, reachable
from hplan.planning.stages import Progress, no_progress
from hplan.robot.model import Robot
from hplan.scene.model import Goal, Scene, Start
from hplan.scene.orchard import FruitZone, OrchardOptions, generate

#: Reach of the arm for which the default sizes of an orchard are meant [m].
_USUAL_REACH: Final = 1.7

#: Number of configurations that are sampled, for the workspace and for the start.
_SAMPLES: Final = (20_000, 2_000)

#: Fruits of a grown row, and fewer if there is no room for as many.
_FRUITS: Final = (18, 12, 8, 5, 3)

#: Minimum distances of the start from the trees and the ground, as shares of the reach; tried in turn.
_START_ROOMS: Final = (0.05, 0.02, 0.005)


@dataclass(frozen=True)
class Workspace:
    """Where the tool of an arm reaches with its axis outwards: heights and distances from the base's axis.

    Attributes:
        near: Minimum distance [m].
        far: Maximum distance [m].
        low: Minimum height [m].
        high: Maximum height [m].
    """

    near: float
    far: float
    low: float
    high: float


def measure_workspace(robot: Robot) -> Workspace:
    """Sample where the tool reaches in front of the base.

    Of the distances and heights that the tool reaches within 60 deg of the x axis, pointing outwards, it is the largest
    rectangle of which nine tenths are reached. It is above the base of a standing arm, and below that of a hanging one.

    Raises:
        InputError: The tool does not reach to the front of the base.
    """
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (_SAMPLES[0], robot.dof))
    poses = robot.forward_kinematics(q)
    points, axes = poses[:, :3, 3], poses[:, :3, :3] @ robot.tool_axis
    distances = np.hypot(points[:, 0], points[:, 1])
    front = (distances > 1e-3) & (np.abs(np.arctan2(points[:, 1], points[:, 0])) <= math.radians(60.0))
    outward = (points[:, :2] * axes[:, :2]).sum(axis=1) >= 0.5 * distances
    # Tools that only point down, as of a SCARA, reach from above. Fewer samples say nothing.
    fewest = 100
    usable = front & outward if (front & outward).sum() >= fewest else front
    if usable.sum() < fewest:
        reason = "its tool does not reach to the front of its base, x > 0 in base_link; turn the base in the URDF"
        raise InputError(f"robot {robot.name!r}: {reason}", robot=robot.name)
    distances, heights = distances[usable], points[usable, 2]
    cell = float(np.quantile(distances, 0.99)) / 12.0
    lowest = math.floor(float(heights.min()) / cell)
    rows = np.floor(heights / cell).astype(int) - lowest
    counts = np.zeros((13, int(rows.max()) + 1))
    np.add.at(counts, (np.minimum((distances / cell).astype(int), 12), rows), 1)
    reached = counts >= 2
    reached[:3] = False  # where the trees would stand in the base
    whole = _largest_rectangle(reached)
    levels = np.arange(reached.shape[1]) + lowest
    chosen = _largest_rectangle(reached & (levels < -1 if _hangs(robot) else levels >= 1))
    first, last, bottom, top = whole if _area(chosen) < 0.3 * _area(whole) else chosen
    if _area(whole) == 0:
        reason = "its tool reaches hardly anywhere with its axis outwards; tool_frame (--tool-frame) selects another"
        raise InputError(f"robot {robot.name!r}: {reason}", robot=robot.name)
    return Workspace(first * cell, last * cell, (bottom + lowest) * cell, (top + lowest) * cell)


def _hangs(robot: Robot) -> bool:
    """True if the base is upside down."""
    base = "base_link"
    is_given = robot.model.existFrame(base)
    return is_given and float(robot.forward_kinematics(np.zeros(robot.dof), base)[2, 2]) < -0.5


def _area(rectangle: tuple[int, int, int, int]) -> int:
    first, last, bottom, top = rectangle
    return (last - first) * (top - bottom)


def _largest_rectangle(cells: BoolArray) -> tuple[int, int, int, int]:
    """Largest rectangle of cells, nine tenths of them True: first and last + 1 of rows and of columns."""
    sums = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1))
    sums[1:, 1:] = cells.cumsum(axis=0).cumsum(axis=1)
    best = (0, 0, 0, 0)
    heights = np.arange(sums.shape[1])
    size = heights[None, :] - heights[:, None]
    for first in range(cells.shape[0]):
        for last in range(first + 1, cells.shape[0] + 1):
            column = sums[last] - sums[first]
            filled = column[None, :] - column[:, None]
            fits = np.where((size > 0) & (filled >= 0.9 * size * (last - first)), size, 0)
            bottom, top = np.unravel_index(int(fits.argmax()), fits.shape)
            found = first, last, int(bottom), int(top)
            if _area(found) > _area(best):
                best = found
    return best


def grown_options(space: Workspace, wanted: Mapping[str, Any]) -> OrchardOptions:
    """Options of a grown row in a workspace.

    Args:
        space: The workspace.
        wanted: Options of the row that are given.

    Raises:
        OptionError: A given option is invalid.
    """
    scale = min(1.0, space.far / _USUAL_REACH)
    distance = 0.85 * space.far
    foot = 0.0 if space.low > 0.0 else space.low - 0.1 * space.far
    top = space.high - foot
    height = min(max(top + 0.15 * space.far, 0.5), 3.0)
    sizes: dict[str, Any] = {
        "distance": max(distance, 0.3),
        "spacing": max(1.1 * scale, 0.2),
        "height": round(foot, 3),
        "tree_height": height,
        "trunk_radius": max(0.03 * scale, 0.005),
        "branches": 16,
        "shoots": 1,
        "branch_length": min(max(distance - space.near, 0.1), 0.6),
        "first_branch": min(max(space.low - foot, 0.05), 0.6 * height),
        "wire_heights": tuple(round(share * height, 3) for share in (0.3, 0.55, 0.8)),
        "fruit_radius": max(0.04 * scale, 0.01),
        "fruit_zone": zone_of(space),
        "stem": 0.02 * scale,
    }
    return OrchardOptions(**{key: _rounded(value) for key, value in sizes.items()} | dict(wanted))


def measured_defaults(space: Workspace) -> dict[str, Any]:
    """Options of a measured row in a workspace."""
    return {"distance": _rounded(0.85 * space.far), "fruit_zone": zone_of(space)}


def zone_of(space: Workspace) -> FruitZone:
    """Fruit zone of a workspace."""
    return FruitZone(round(space.low, 3), round(space.high, 3), round(space.far, 3))


def _rounded(value: Any) -> Any:
    return round(value, 3) if isinstance(value, float) else value


def grow_fitted(space: Workspace, wanted: Mapping[str, Any], start_deg: Sequence[float]) -> Scene:
    """Grow a row in a workspace, with as many fruits as there is room for unless their number is given.

    Args:
        space: The workspace.
        wanted: Options of the row that are given.
        start_deg: Start configuration [deg].

    Raises:
        OptionError: A given option is invalid, or there is no room for the fruits.
    """
    *counts, last = (wanted["fruits"],) if "fruits" in wanted else _FRUITS
    for count in counts:
        try:
            return generate(grown_options(space, {**wanted, "fruits": count}), start_deg=start_deg)
        except OptionError as error:
            if error.option != "fruits":
                raise
    return generate(grown_options(space, {**wanted, "fruits": last}), start_deg=start_deg)


def with_pickable_goal(
    robot: Robot, scene: Scene, progress: Progress = no_progress
) -> tuple[Scene, Mapping[str, FruitReach]]:
    """Return a scene whose goal is the first fruit to which a quick plan leads, and which fruits can be picked.

    If none of some plans leads to a fruit, the goal is the first fruit that can be picked.

    Raises:
        InputError: No fruit can be picked.
    """
    found = reachable(robot, scene, progress=progress)
    pickable = [name for name, reach in found.items() if reach.can_be_picked]
    # Fruits that are tried: if every motion to these fails, the trees do not suit the arm.
    most = 6
    for name in pickable[:most]:
        progress(f"plan to {name}")
        aimed = scene.with_values(goal=Goal(fruit=name))
        try:
            plan(robot, aimed, PlanOptions(effort="quick", deadline_s=20.0))
        except HplanError:
            continue
        return aimed, found
    if pickable:
        return scene.with_values(goal=Goal(fruit=pickable[0])), found
    reasons = [reach.detail for reach in found.values()]
    advice = "the tool frame must project from the arm: tool_tube_m (--tool-tube 0.18) adds a tube at it"
    raise InputError(f"robot {robot.name!r} can pick none of {len(found)} fruits, for example: {reasons[0]}; {advice}")


def find_start(robot: Robot, scene: Scene, reach: float) -> Start:
    """Return a free start beside the trees: the arm drawn back, above its base.

    Args:
        robot: The arm.
        scene: The trees; its own start is ignored.
        reach: Reach of the arm [m].

    Raises:
        InputError: No sampled configuration is free.
    """
    low, high = np.maximum(robot.lower, -math.pi), np.minimum(robot.upper, math.pi)
    q = np.random.default_rng(1).uniform(low, high, (_SAMPLES[1], robot.dof))
    slides = np.array(robot.slides)
    q = np.where(slides, np.round(q, 3), np.radians(np.round(np.degrees(q))))
    q = q[((robot.lower <= q) & (q <= robot.upper)).all(axis=1)]
    points = _joint_positions(robot, q)
    forward = points[:, :, 0].max(axis=1)
    wide = np.hypot(points[:, :, 0], points[:, :, 1]).max(axis=1)
    heights = points[:, :, 2]
    below = -np.minimum(heights, 0.0).min(axis=1) if np.median(heights) > 0.0 else np.zeros(len(q))
    from_middle = np.abs((q - 0.5 * (low + high)) / np.maximum(high - low, 1e-9)).mean(axis=1)
    order = np.argsort(forward + 0.5 * wide + 3.0 * below + 0.3 * reach * from_middle, kind="stable")
    # Configurations that are checked before the next smaller room is tried.
    most = 300
    for room in _START_ROOMS:
        wider = scene.with_values(clearance=max(scene.clearance, room * reach))
        for row in q[order[:most]]:
            if check(robot, wider, row).valid:
                values = tuple(row.tolist())
                if slides.any():
                    return Start(joints_rad=values)
                return Start(joints_deg=tuple(round(math.degrees(value)) * 1.0 for value in values))
    raise InputError(
        f"robot {robot.name!r}: none of {most} starts beside the trees is free; give one (--start), or a larger "
        "distance (--distance)",
        robot=robot.name,
    )


def _joint_positions(robot: Robot, q: FloatArray) -> FloatArray:
    """(n, dof + 1, 3) positions of the joints after the first, and of the tool [m]."""
    data, tool = robot.model.createData(), robot.frame_number(robot.tool_frame)
    found = np.empty((len(q), robot.dof + 1, 3))
    for row, values in enumerate(q):
        pin.framesForwardKinematics(robot.model, data, values)
        found[row, :-1] = [data.oMi[joint].translation for joint in range(1, robot.dof + 1)]
        found[row, -1] = data.oMf[tool].translation
    return found
