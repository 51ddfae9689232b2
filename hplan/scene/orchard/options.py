"""Options of an orchard, checked: its row of trees, its wires and posts, its fruit."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import Field

from hplan.base.arguments import one_of
from hplan.base.data_files import shipped_robots
from hplan.base.options import Options, Text
from hplan.errors import OptionError

#: How the trees are trained: branches all around a leader, or arms along the wires.
Form: TypeAlias = Literal["spindle", "trellis"]

#: Where the harvester waits: upper arm upright, forearm level and to the rear, hand down. Nothing of the arm is more
#: than 5 cm in front of the base's axis then, whatever the row's distance, and a turn of the base sweeps a radius of
#: 0.84 m, against 1.24 m with the hand stretched out.
TUCKED_DEG: Final = (0.0, 90.0, 90.0, 90.0)

#: Largest coordinate of anything in an orchard [m]; beyond it a file is in other units than metres.
FARTHEST: Final = 1000.0

#: A coordinate, and a length that something may give way or be kept away by [m].
_Coordinate: TypeAlias = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST)]
_UpToOne: TypeAlias = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True)
class FruitZone(Options):
    """Zone of the fruits' centres: a disc about the base's axis, between two heights.

    Attributes:
        low: Least height [m].
        high: Greatest height [m].
        reach: Greatest distance from the base's axis, the z axis of `base_link` [m].
    """

    low: _Coordinate = -FARTHEST
    high: _Coordinate = FARTHEST
    reach: Annotated[float, Field(ge=1e-3, le=2.0 * FARTHEST)] = 2.0 * FARTHEST

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise OptionError("high", self.high, f"more than low, {self.low:g} m")

    def holds(self, x: float, y: float, z: float) -> bool:
        """True if a point is inside."""
        return self.low <= z <= self.high and math.hypot(x, y) <= self.reach


#: Zone of fruit that each shipped robot reaches nearly all of.
REACHED: Final = {"harvester": FruitZone(1.45, 2.05, 1.7), "orchard_harvester": FruitZone(0.35, 2.2, 1.7)}


@dataclass(frozen=True)
class _Row(Options):
    """What rows of grown and of measured trees have in common (`OrchardOptions`)."""

    name: Text = "orchard"
    robot: str | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    spacing: Annotated[float, Field(ge=0.2, le=10.0)] = 1.1
    distance: Annotated[float, Field(ge=0.3, le=100.0)] = 1.4
    goal: Text | None = None
    clearance: _UpToOne = 0.0
    wood_yields: _UpToOne = 0.0
    yields_below: Annotated[float, Field(ge=0.0, le=10.0)] = 0.008
    fruit_yields: _UpToOne = 0.0
    hangs_within: _UpToOne | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.robot is not None:
            one_of("robot", self.robot, shipped_robots())


@dataclass(frozen=True)
class OrchardOptions(_Row):
    """A row of trees in front of the arm: across its view, along y, at `distance` along x.

    Wires run along the row through the trunks, from post to post; the posts stand half a spacing beyond the outer
    trees. The defaults are an apple orchard's, and the harvester's zone of fruit.

    Attributes:
        name: Name of the scene.
        robot: Name of the shipped robot that it is meant for; None for the default one.
        seed: What is left to chance follows from this number alone.
        form: `spindle`: branches all around the trunk; `trellis`: arms along the wires, with branches on them.
        trees: Number of trees, the row's middle in front of the base.
        spacing: Distance of neighbouring trunks [m].
        distance: Distance of the row from the base's axis [m].
        tree_height: Height of the trees [m].
        trunk_radius: Radius of a trunk at the ground; it tapers [m].
        branches: Branches of each tree.
        branch_length: Length of the longest branches [m].
        first_branch: Height of the lowest branch of a spindle [m].
        shoots: Side shoots on each branch.
        wire_heights: Heights of the wires [m]; a trellis has a pair of arms at each that its trunk reaches.
        wire_radius: Radius of a wire [m].
        posts: True if posts stand at the row's ends.
        fruits: Number of fruits in all.
        fruit_radius: Radius of a fruit [m].
        fruit_zone: Where their centres may be.
        picked: Numbers of the fruits that hang no more, as all were counted; the rest is counted anew.
        goal: Name of the fruit to reach for; None for the first.
        stem: Greatest gap between a fruit and the wood that it hangs from [m].
        ground: True if the ground is an obstacle.
        vehicle: True if the body of a vehicle, behind the arm, is one.
        clearance: Distance that a motion is to keep from everything [m].
        wood_yields: How deep thin wood may be pushed [m].
        yields_below: Radius below which wood is thin [m].
        fruit_yields: How deep fruit may be pushed [m].
        hangs_within: How far fruit is at most from the wood that it is said to hang from [m]; None says nothing.
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
            raise OptionError("wire_heights", heights, "heights that increase")
        if self.form == "spindle" and self.first_branch >= self.tree_height:
            raise OptionError("first_branch", self.first_branch, f"less than the tree's height, {self.tree_height:g} m")
        if self.form == "trellis" and not any(height < self.tree_height for height in heights):
            raise OptionError("wire_heights", heights, f"a wire below the tree's height, {self.tree_height:g} m")
        picked = set(self.picked)
        if len(picked) < len(self.picked) or len(picked) == self.fruits or max(picked, default=0) > self.fruits:
            expected = f"numbers from 1 to {self.fruits} that differ, and not all of them"
            raise OptionError("picked", self.picked, expected)


@dataclass(frozen=True)
class MeasuredOptions(_Row):
    """A row of measured trees in front of the arm; what is not told here is as `OrchardOptions` describes it.

    Attributes:
        name: Name of the scene.
        seed: Shuffles the tips of branches that fruit hangs at.
        height: Height of the trees' feet above that of the base [m].
        yaw_deg: Turn of every tree about its own trunk [deg].
        fruits: Number of fruits on all trees together; None for all that the files have, or 20.
        fruit_radius: Radius of a fruit [m]; None for the files', or 0.04.
        fruit_zone: Where their centres may be; None for anywhere, or where fruit is put that no file has.
    """

    name: Text = "measured"
    spacing: Annotated[float, Field(ge=0.0, le=FARTHEST)] = 1.1
    distance: _Coordinate = 1.4
    height: _Coordinate = 0.0
    yaw_deg: _Coordinate = 0.0
    fruits: Annotated[int, Field(ge=0, le=10_000)] | None = None
    fruit_radius: Annotated[float, Field(ge=1e-3, le=1.0)] | None = None
    fruit_zone: FruitZone | None = None
