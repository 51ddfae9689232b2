"""A motion to be shown: trajectory, picked fruits, phases, and its certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hplan.base.arguments import instance, list_of, number, text
from hplan.base.arrays import numbers
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Phase, Trajectory

if TYPE_CHECKING:
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.clearance_curve import ClearanceCurve
    from hplan.planning.result import PlanResult
    from hplan.tour.result import TourResult


@dataclass(frozen=True, eq=False)
class Playback:
    """A motion to be shown.

    Attributes:
        trajectory: The motion; with a single sample the arm stands still.
        picked: Fruit and when the tool reaches it [s]; it changes its colour then, and moves with the tool.
        dropped: Fruit and when the tool lets it go [s]; where it is not named, at the end of the retreat.
        phases: Parts of the motion; `approach` is drawn in a colour of its own, `retreat` is its path backwards.
        certificate: What was shown of it; None where that is not known.
        clearance_curve: Its clearance over time; the certificate's own where this is None.
        begin_s: Time at which it begins, as the tracks of the scene count it [s].
    """

    trajectory: Trajectory
    picked: Mapping[str, float] = field(default_factory=dict)
    dropped: Mapping[str, float] = field(default_factory=dict)
    phases: Sequence[Phase] = ()
    certificate: Certificate | None = None
    clearance_curve: ClearanceCurve | None = None
    begin_s: float = 0.0

    def __post_init__(self) -> None:
        """Check what is to be shown.

        Raises:
            InputError: It is no motion, or no times of its fruits and phases.
        """
        instance("trajectory", self.trajectory, Trajectory, "plan or read_csv")
        for option in ("picked", "dropped"):
            times = getattr(self, option)
            if not isinstance(times, Mapping):
                raise OptionError(option, times, "times [s] by the names of fruits")
            for name, time_s in times.items():
                number(option, time_s, f"a time in seconds for {text(option, name)!r}")
        for phase in list_of("phases", self.phases, Phase, "phases with a name, a begin and an end"):
            numbers("phases", [phase.start_s, phase.end_s], (2,))
        number("begin_s", self.begin_s, "a time in seconds")

    @classmethod
    def of(cls, result: PlanResult | TourResult) -> Playback:
        """The motion of a plan or a tour.

        Raises:
            OptionError: It is neither.
        """
        if not isinstance(getattr(result, "trajectory", None), Trajectory) or not hasattr(result, "phases"):
            raise OptionError("result", result, "the result of plan or plan_tour")
        dropped: Mapping[str, float] = getattr(result, "dropped", {})
        return cls(result.trajectory, result.picked, dropped, result.phases, result.certificate)

    @property
    def curve(self) -> ClearanceCurve | None:
        """Clearance over time as it is to be shown; None where it is not known."""
        curve = self.clearance_curve
        if curve is None and self.certificate is not None:
            curve = self.certificate.clearance_curve
        return None if curve is None else curve.shown

    def check(self, robot: Robot) -> None:
        """Check that the motion is one of a robot.

        Raises:
            InputError: The trajectory is of other joints than the robot's.
        """
        if self.trajectory.joint_names != robot.joint_names:
            got, expected = ", ".join(self.trajectory.joint_names), ", ".join(robot.joint_names)
            raise InputError(
                f"the trajectory moves {got}; the joints of {robot.name!r} are {expected}",
                expected=list(robot.joint_names),
                got=list(self.trajectory.joint_names),
            )
