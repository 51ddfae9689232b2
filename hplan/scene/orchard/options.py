"""Options of an orchard, checked: its row of trees, its wires and posts, its fruit."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

from hplan.base.arguments import between, instance, keep_checked, list_between, one_of, text, truth, whole
from hplan.base.data_files import shipped_robots
from hplan.errors import OptionError

#: How the trees are trained: branches all around a leader, or arms along the wires.
Form: TypeAlias = Literal["spindle", "trellis"]

#: Where the harvester waits: upper arm upright, forearm level and to the rear, hand down. Nothing of the arm is more
#: than 5 cm in front of the base's axis then, whatever the row's distance, and a turn of the base sweeps a radius of
#: 0.84 m, against 1.24 m with the hand stretched out.
TUCKED_DEG: Final = (0.0, 90.0, 90.0, 90.0)

#: Largest coordinate of anything in an orchard [m]; beyond it a file is in other units than metres.
FARTHEST: Final = 1000.0


@dataclass(frozen=True)
class FruitZone:
    """Zone of the fruits' centres: a disc about the base's axis, between two heights.

    Attributes:
        low: Least height [m].
        high: Greatest height [m].
        reach: Greatest distance from the base's axis, the z axis of `base_link` [m].
    """

    low: float = -FARTHEST
    high: float = FARTHEST
    reach: float = 2.0 * FARTHEST

    def __post_init__(self) -> None:
        height = between, -FARTHEST, FARTHEST
        keep_checked(self, {"low": height, "high": height, "reach": (between, 1e-3, 2.0 * FARTHEST)})
        if not self.low < self.high:
            raise OptionError("high", self.high, f"more than low, {self.low:g} m")

    def holds(self, x: float, y: float, z: float) -> bool:
        """True if a point is inside."""
        return self.low <= z <= self.high and math.hypot(x, y) <= self.reach


#: Zone of fruit that each shipped robot reaches nearly all of.
REACHED: Final = {"harvester": FruitZone(1.45, 2.05, 1.7), "orchard_harvester": FruitZone(0.35, 2.2, 1.7)}


@dataclass(frozen=True)
class _Row:
    """What rows of grown and of measured trees have in common (`OrchardOptions`)."""

    name: str = "orchard"
    robot: str | None = None
    seed: int = 0
    spacing: float = 1.1
    distance: float = 1.4
    goal: str | None = None
    clearance: float = 0.0
    wood_yields: float = 0.0
    yields_below: float = 0.008
    fruit_yields: float = 0.0
    hangs_within: float | None = None

    def __post_init__(self) -> None:
        keep_checked(self, _COMMON_CHECKS)
        _keep_given(self, "hangs_within")
        if self.robot is not None:
            one_of("robot", self.robot, shipped_robots())
        if self.goal is not None:
            text("goal", self.goal, "the name of a fruit, or None for the first")


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
    trees: int = 3
    tree_height: float = 2.7
    trunk_radius: float = 0.03
    branches: int = 18
    branch_length: float = 0.6
    first_branch: float = 0.6
    shoots: int = 2
    wire_heights: tuple[float, ...] = (0.8, 1.5, 2.2)
    wire_radius: float = 0.0015
    posts: bool = True
    fruits: int = 24
    fruit_radius: float = 0.04
    fruit_zone: FruitZone = REACHED["harvester"]
    picked: tuple[int, ...] = ()
    stem: float = 0.02
    ground: bool = False
    vehicle: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_checked(self, _CHECKS)
        heights = self.wire_heights
        if any(high <= low for low, high in itertools.pairwise(heights)):
            raise OptionError("wire_heights", heights, "heights that increase")
        if self.form == "spindle" and self.first_branch >= self.tree_height:
            raise OptionError("first_branch", self.first_branch, f"less than the tree's height, {self.tree_height:g} m")
        if self.form == "trellis" and not any(height < self.tree_height for height in heights):
            raise OptionError("wire_heights", heights, f"a wire below the tree's height, {self.tree_height:g} m")
        picked = list_between("picked", self.picked, 1, self.fruits)
        if not all(number.is_integer() for number in picked):
            raise OptionError("picked", self.picked, "whole numbers")
        numbers = tuple(map(int, picked))
        object.__setattr__(self, "picked", numbers)
        if len(set(numbers)) < len(numbers) or len(numbers) == self.fruits:
            raise OptionError("picked", numbers, f"numbers that differ, and fewer than {self.fruits}")


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

    name: str = "measured"
    height: float = 0.0
    yaw_deg: float = 0.0
    fruits: int | None = None
    fruit_radius: float | None = None
    fruit_zone: FruitZone | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_checked(self, _MEASURED_CHECKS)
        _keep_given(self, *_FRUIT_CHECKS)


def _keep_given(options: _Row, *keys: str) -> None:
    keep_checked(options, {key: _FRUIT_CHECKS[key] for key in keys if getattr(options, key) is not None})


#: Check of each option, and the least and greatest value; measures in metres.
_COMMON_CHECKS = {
    "name": (text,),
    "seed": (whole, 0),
    "clearance": (between, 0.0, 1.0),
    "wood_yields": (between, 0.0, 1.0),
    "yields_below": (between, 0.0, 10.0),
    "fruit_yields": (between, 0.0, 1.0),
}
_CHECKS = {
    "form": (one_of, get_args(Form)),
    "trees": (whole, 1, 100),
    "branches": (whole, 0, 200),
    "shoots": (whole, 0, 20),
    "fruits": (whole, 1, 1000),
    "spacing": (between, 0.2, 10.0),
    "distance": (between, 0.3, 100.0),
    "tree_height": (between, 0.5, 10.0),
    "trunk_radius": (between, 0.005, 0.3),
    "branch_length": (between, 0.1, 3.0),
    "first_branch": (between, 0.05, 10.0),
    "wire_radius": (between, 0.0001, 0.05),
    "fruit_radius": (between, 0.005, 0.2),
    "stem": (between, 0.0, 0.2),
    "posts": (truth,),
    "ground": (truth,),
    "vehicle": (truth,),
    "fruit_zone": (instance, FruitZone),
    "wire_heights": (list_between, 0.01, 10.0),
}
_MEASURED_CHECKS = {
    "spacing": (between, 0.0, FARTHEST),
    "distance": (between, -FARTHEST, FARTHEST),
    "height": (between, -FARTHEST, FARTHEST),
    "yaw_deg": (between, -FARTHEST, FARTHEST),
}
_FRUIT_CHECKS = {
    "fruits": (whole, 0, 10_000),
    "fruit_radius": (between, 1e-3, 1.0),
    "fruit_zone": (instance, FruitZone),
    "hangs_within": (between, 0.0, 1.0),
}
