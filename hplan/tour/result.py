"""What comes of a picking tour: its legs, the fruits that are not picked, and the whole motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hplan.base.arrays import Record
from hplan.base.lazy_import import InNotebook
from hplan.certificate.certificate import Certificate
from hplan.errors import HplanError
from hplan.planning.grasps import Grasp
from hplan.robot.model import Robot
from hplan.scene.model import Scene
from hplan.trajectory.trajectory import Phase, Trajectory


@dataclass(frozen=True, eq=False)
class Leg(Record):
    """A part of a tour: to a fruit and, where it is next, to the drop-off; or back to the start.

    It is at rest at both ends but where the retreat from a fruit is blended with the next leg.

    Attributes:
        fruit: Name of the fruit; None for the leg back.
        grasp: How it is taken; None for the leg back.
        begin_s: When it begins, in the tour [s].
        phases: Its parts, by their times in the tour: `transit`, `approach`, `retreat`, `drop`, `return`.
        trajectory: Its motion, from time 0 on.
        certificate: What was shown of it.
    """

    fruit: str | None
    grasp: Grasp | None
    begin_s: float
    phases: tuple[Phase, ...]
    trajectory: Trajectory
    certificate: Certificate

    @property
    def name(self) -> str:
        """The fruit, or `return`."""
        return "return" if self.fruit is None else self.fruit


@dataclass(frozen=True, eq=False)
class Unreached:
    """A fruit that is not picked."""

    fruit: str
    error: HplanError


@dataclass(frozen=True, eq=False)
class TourResult(Record, InNotebook):
    """A tour.

    Attributes:
        order: The fruits that are picked, in their order.
        legs: One for each, and the leg back where there is one.
        trajectory: The whole motion; the arm rests at the fruits, and wherever a stop is quicker.
        certificate: What was shown of it.
        picked: When the tool is at each fruit [s].
        dropped: When each fruit is let go at the drop-off [s]; empty where there is none.
        unreached: The fruits that are not picked.
        report: The numbers of `tour.json`.
        robot: The arm.
        scene: Obstacles and fruits, as they were given.
    """

    order: tuple[str, ...]
    legs: tuple[Leg, ...]
    trajectory: Trajectory
    certificate: Certificate
    picked: Mapping[str, float]
    dropped: Mapping[str, float]
    unreached: tuple[Unreached, ...]
    report: dict[str, Any]
    robot: Robot
    scene: Scene

    @property
    def phases(self) -> tuple[Phase, ...]:
        """The parts of all legs."""
        return tuple(phase for leg in self.legs for phase in leg.phases)

    @property
    def duration(self) -> float:
        """Of the whole tour [s]."""
        return self.trajectory.duration
