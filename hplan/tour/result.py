"""Results of a picking tour: legs, unpicked fruits, and the whole motion."""

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
    """Leg of a tour, to a fruit or back to the start.

    A leg to a fruit may continue to the drop-off. It is at rest at both ends, unless the retreat from a fruit is
    blended with the next leg.

    Attributes:
        fruit: Name of the fruit; None for the leg back.
        grasp: Grasp of the fruit; None for the leg back.
        begin_s: Start time in the tour [s].
        phases: Its phases, at their times in the tour: `transit`, `approach`, `retreat`, `drop`, `return`.
        trajectory: Its motion, starting at time 0.
        certificate: Certificate of the motion.
    """

    fruit: str | None
    grasp: Grasp | None
    begin_s: float
    phases: tuple[Phase, ...]
    trajectory: Trajectory
    certificate: Certificate

    @property
    def name(self) -> str:
        """Name of the fruit, or `return`."""
        return "return" if self.fruit is None else self.fruit


@dataclass(frozen=True, eq=False)
class Unreached:
    """Fruit that is not picked, with the error."""

    fruit: str
    error: HplanError


@dataclass(frozen=True, eq=False)
class TourResult(Record, InNotebook):
    """Picking tour of one arm.

    Attributes:
        order: Names of the picked fruits, in order.
        legs: One leg for each of them, and the leg back if there is one.
        trajectory: The whole motion; the arm rests at the fruits, and wherever a stop is faster.
        certificate: Certificate of the whole motion.
        picked: Picking time of each fruit [s].
        dropped: Release time of each fruit at the drop-off [s]; empty without a drop-off.
        unreached: Fruits that are not picked.
        report: Contents of `tour.json`.
        robot: The arm.
        scene: The given obstacles and fruits.
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
        """Phases of all legs."""
        return tuple(phase for leg in self.legs for phase in leg.phases)

    @property
    def duration(self) -> float:
        """Duration of the whole tour [s]."""
        return self.trajectory.duration
