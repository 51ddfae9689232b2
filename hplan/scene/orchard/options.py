"""Checked options of an orchard: tree row, wires and posts, fruit."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import Field

from hplan.base.arguments import one_of
from hplan.base.checked import Options, Text
from hplan.base.data_files import robot_names
from hplan.errors import OptionError
from hplan.scene.robot_source import RobotSource

#: Training form of the trees: branches all around a leader, or arms along the wires.
Form: TypeAlias = Literal["spindle", "trellis"]

#: Tucked configuration of the harvester: upper arm upright, forearm level and to the rear, hand down. No part of the
#: arm is more than 5 cm in front of the base's axis, so it suits any row distance. A rotation of the base sweeps a
#: radius of 0.84 m, compared with 1.24 m with the hand stretched out.
TUCKED_DEG: Final = (0.0, 90.0, 90.0, 90.0)

#: Maximum coordinate in an orchard [m]; larger values indicate a file in other units than metres.
FARTHEST: Final = 1000.0

#: A coordinate; a length for deflection, clearance or attachment [m].
_Coordinate: TypeAlias = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
_UpToOne: TypeAlias = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True)
class FruitZone(Options):
    """Zone of the fruits' centres: a vertical cylinder about the base's axis.

    Attributes:
        low: Minimum height [m].
        high: Maximum height [m].
        reach: Maximum distance from the base's axis, the z axis of `base_link` [m].
    """

    low: _Coordinate = -FARTHEST
    high: _Coordinate = FARTHEST
    reach: Annotated[float, Field(ge=1e-3, le=2.0 * FARTHEST)] = 2.0 * FARTHEST

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise OptionError("high", self.high, f"more than low, {self.low:g} m")

    def holds(self, x: float, y: float, z: float) -> bool:
        """True if a point is in the zone [m]."""
        return self.low <= z <= self.high and math.hypot(x, y) <= self.reach

    def lift(self, height: float) -> FruitZone:
        """Return the zone, higher by a height [m]."""
        low, high = (min(max(end + height, -FARTHEST), FARTHEST) for end in (self.low, self.high))
        return FruitZone(low, high, self.reach)


#: Fruit zone of each shipped robot; nearly all of it is reachable.
REACHED: Final = {"harvester": FruitZone(1.45, 2.05, 1.7), "orchard_harvester": FruitZone(0.35, 2.2, 1.7)}


@dataclass(frozen=True)
class _Row(Options):
    """Common options of grown and measured tree rows (`OrchardOptions`)."""

    name: Text = "orchard"
    robot: str | RobotSource | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    spacing: Annotated[float, Field(ge=0.2, le=10.0)] = 1.1
    distance: Annotated[float, Field(ge=0.1, le=100.0)] = 1.4
    height: _Coordinate = 0.0
    goal: Text | None = None
    clearance: _UpToOne = 0.0
    wood_yields: _UpToOne = 0.0
    yields_below: Annotated[float, Field(ge=0.0, le=10.0)] = 0.008
    fruit_yields: _UpToOne = 0.0
    grasp_offset: _UpToOne = 0.0
    hangs_within: _UpToOne | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.robot, str):
            one_of("robot", self.robot, robot_names())


@dataclass(frozen=True)
class OrchardOptions(_Row):
    """A tree row along y, at x = `distance`.

    Wires run along the row through the trunks, from post to post; the posts are half a spacing beyond the outer trees.
    The defaults describe an apple orchard, with the harvester's fruit zone.

    Attributes:
        name: Name of the scene.
        robot: The intended robot, as in a scene; None for the default robot.
        seed: Random seed; all randomness follows from it.
        form: `spindle`: branches all around the trunk; `trellis`: arms along the wires, with branches on them.
        trees: Number of trees; the middle of the row is in front of the base.
        spacing: Distance of neighbouring trunks [m].
        distance: Distance of the row from the base's axis [m].
        height: Height of the trees' feet above the base [m]; the other heights of the row, but not those of the fruit
            zone, count from there.
        tree_height: Height of the trees [m].
        trunk_radius: Radius of a tapered trunk at the ground [m].
        branches: Number of branches of each tree.
        branch_length: Length of the longest branches [m].
        first_branch: Height of the lowest branch of a spindle [m].
        shoots: Number of side shoots of each branch.
        wire_heights: Heights of the wires [m]; a trellis has a pair of arms at each wire below the tree height.
        wire_radius: Radius of a wire [m].
        posts: True for posts at the ends of the row.
        fruits: Total number of fruits.
        fruit_radius: Radius of a fruit [m].
        fruit_zone: Zone of the fruits' centres.
        picked: Numbers of removed fruits, in the numbering of all fruits; the rest is renumbered.
        goal: Name of the goal fruit; None for the first.
        stem: Maximum gap between a fruit and its wood [m].
        ground: True if the ground is an obstacle.
        vehicle: True if a vehicle body behind the arm is an obstacle.
        clearance: Required clearance of motions [m].
        wood_yields: Maximum deflection of thin wood [m].
        yields_below: Radius below which wood is thin [m].
        fruit_yields: Maximum deflection of fruit [m].
        grasp_offset: Maximum distance of the tool from the centre of a fruit at the grasp [m]; its radius if that is
            less.
        hangs_within: Maximum distance of a fruit from wood that it is attached to [m]; None for no attachments.
    """

    form: Form = "spindle"
    trees: Annotated[int, Field(ge=1, le=100)] = 3
    tree_height: Annotated[float, Field(ge=0.5, le=10.0)] = 2.7
    trunk_radius: Annotated[float, Field(ge=0.005, le=0.3)] = 0.03
    branches: Annotated[int, Field(ge=0, le=200)] = 18
    branch_length: Annotated[float, Field(ge=0.1, le=3.0)] = 0.6
    first_branch: Annotated[float, Field(ge=0.05, le=10.0)] = 0.6
    shoots: Annotated[int, Field(ge=0, le=20)] = 2
    wire_heights: tuple[Annotated[float, Field(ge=0.01, le=10.0)], ...] = (0.8, 1.5, 2.2)
    wire_radius: Annotated[float, Field(ge=0.0001, le=0.05)] = 0.0015
    posts: bool = True
    fruits: Annotated[int, Field(ge=1, le=1000)] = 24
    fruit_radius: Annotated[float, Field(ge=0.005, le=0.2)] = 0.04
    fruit_zone: FruitZone = REACHED["harvester"]
    picked: tuple[Annotated[int, Field(ge=1)], ...] = ()
    stem: Annotated[float, Field(ge=0.0, le=0.2)] = 0.02
    ground: bool = False
    vehicle: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        heights = self.wire_heights
        if any(high <= low for low, high in itertools.pairwise(heights)):
            raise OptionError("wire_heights", heights, "increasing heights")
        if self.form == "spindle" and self.first_branch >= self.tree_height:
            raise OptionError("first_branch", self.first_branch, f"less than the tree's height, {self.tree_height:g} m")
        if self.form == "trellis" and not any(height < self.tree_height for height in heights):
            raise OptionError("wire_heights", heights, f"a wire below the tree's height, {self.tree_height:g} m")
        picked = set(self.picked)
        if len(picked) < len(self.picked) or len(picked) == self.fruits or max(picked, default=0) > self.fruits:
            expected = f"different numbers from 1 to {self.fruits}, and not all of them"
            raise OptionError("picked", self.picked, expected)


@dataclass(frozen=True)
class MeasuredOptions(_Row):
    """A row of measured trees in front of the arm.

    Attributes not listed here are described in `OrchardOptions`.

    Attributes:
        name: Name of the scene.
        seed: Seed of the order of branch tips for fruit.
        yaw_deg: Rotation of every tree about its own trunk [deg].
        fruits: Total number of fruits; None for all fruits of the files, or 20 if they have none.
        fruit_radius: Radius of a fruit [m], only for files without fruit; None for the radii of the files, or 0.04.
        fruit_zone: Zone of the fruits' centres; None for anywhere.
    """

    name: Text = "measured"
    spacing: Annotated[float, Field(ge=0.0, le=FARTHEST)] = 1.1
    distance: _Coordinate = 1.4
    yaw_deg: _Coordinate = 0.0
    fruits: Annotated[int, Field(ge=0, le=10_000)] | None = None
    fruit_radius: Annotated[float, Field(ge=1e-3, le=1.0)] | None = None
    fruit_zone: FruitZone | None = None


_ORCHARDS = (
    OrchardOptions(name="orchard-row", seed=1),
    OrchardOptions(
        name="trellis",
        seed=2,
        form="trellis",
        tree_height=2.4,
        branches=28,
        branch_length=0.3,
        shoots=1,
        wire_heights=(0.6, 1.05, 1.5, 1.95),
    ),
    OrchardOptions(
        name="dense-canopy",
        seed=3,
        spacing=1.0,
        branches=30,
        branch_length=0.7,
        shoots=3,
        fruits=45,
        posts=False,
        goal="fruit 18",
    ),
    OrchardOptions(
        name="tour",
        seed=4,
        form="trellis",
        tree_height=2.2,
        branches=28,
        branch_length=0.3,
        shoots=0,
        wire_heights=(0.6, 1.05, 1.5, 1.95),
        fruits=46,
        fruit_zone=FruitZone(1.4, 2.05, 1.7),
        # The remaining fruits are reachable: each has a collision-free motion with the base turned towards it first.
        picked=(4, 5, 7, 9, 11, 14, 15, 16, 17, 18, 20, 21, 22, 24, 25, 26, 27, 30, 33, 34, 36, 37, 39, 40, 42, 46),
        vehicle=True,
    ),
    # For the arm that bends both ways: fruit from knee height to above the trees' middle, with the ground.
    OrchardOptions(
        name="orchard-arm-row",
        robot="orchard_harvester",
        seed=5,
        distance=1.35,
        first_branch=0.45,
        branches=16,
        branch_length=0.5,
        shoots=1,
        fruits=26,
        fruit_zone=REACHED["orchard_harvester"],
        ground=True,
        goal="fruit 20",
    ),
    OrchardOptions(
        name="orchard-arm-tour",
        robot="orchard_harvester",
        seed=8,
        form="trellis",
        distance=1.35,
        tree_height=2.3,
        branches=24,
        branch_length=0.3,
        shoots=0,
        wire_heights=(0.5, 0.95, 1.4, 1.85),
        fruits=22,
        fruit_zone=REACHED["orchard_harvester"],
        ground=True,
        vehicle=True,
    ),
)

#: Options of each shipped orchard, by the name of its scene; `generate` gives the scene.
SHIPPED: Final[dict[str, OrchardOptions]] = {options.name: options for options in _ORCHARDS}
