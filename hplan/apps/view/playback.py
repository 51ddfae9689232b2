"""A motion to visualize: trajectory, picked fruits, phases and certificate."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from hplan.base.arguments import instance, list_of, number, text
from hplan.base.arrays import numbers
from hplan.errors import InputError, OptionError
from hplan.robot.model import Robot
from hplan.trajectory.trajectory import Phase, Trajectory

if TYPE_CHECKING:
    from hplan.apps.view.body_motions import BodyMotions
    from hplan.certificate.certificate import Certificate
    from hplan.certificate.clearance_curve import ClearanceCurve
    from hplan.certificate.retimed_certificate import CertifiedMotion
    from hplan.planning.result import PlanResult
    from hplan.scene.model import Scene
    from hplan.tour.cell_tour import CellTour
    from hplan.tour.tour import TourResult
    from hplan.workcell.cell import CellResult

    #: Results that have a motion to visualize.
    Shown: TypeAlias = PlanResult | CertifiedMotion | TourResult | CellResult | CellTour


@dataclass(frozen=True, eq=False)
class Playback:
    """A motion to visualize.

    Attributes:
        trajectory: The motion; the arm is at rest if it has a single sample.
        picked: Picking time of each picked fruit, by name [s]. From then on it has another colour and moves with the
            tool.
        dropped: Release time of picked fruits, by name [s]; a fruit that is not listed is released at the end of the
            retreat.
        phases: Segments of the motion. `approach` has its own colour; `retreat` is the approach reversed.
        certificate: Certificate of the motion; None if unknown.
        clearance_curve: Clearance over time; None for the certificate's own.
        begin_s: Start time on the clock of the scene's tracks [s].
        arms: For several arms, the phases of each arm, by name.
        frames: For several arms, the tool frame of each arm, by name.
        pickers: For several arms, the name of the arm that picks each fruit.
        unpicked: Reason of each fruit that a tour does not pick (`hplan.planning.failures.Reason`), by name, without
            those left out.
        bodies: Motions of limbs and fruit, as of `hplan.apps.execution.simulation.execute`; None for a tree at rest.
        outcome: For a simulated motion True if all went well, and a sentence about it, in place of a certificate.
    """

    trajectory: Trajectory
    picked: Mapping[str, float] = field(default_factory=dict)
    dropped: Mapping[str, float] = field(default_factory=dict)
    phases: Sequence[Phase] = ()
    certificate: Certificate | None = None
    clearance_curve: ClearanceCurve | None = None
    begin_s: float = 0.0
    arms: Mapping[str, Sequence[Phase]] = field(default_factory=dict)
    frames: Mapping[str, str] = field(default_factory=dict)
    pickers: Mapping[str, str] = field(default_factory=dict)
    unpicked: Mapping[str, str] = field(default_factory=dict)
    bodies: BodyMotions | None = None
    outcome: tuple[bool, str] | None = None

    def __post_init__(self) -> None:
        instance("trajectory", self.trajectory, Trajectory, "plan or read_csv")
        for option in ("picked", "dropped"):
            times = getattr(self, option)
            if not isinstance(times, Mapping):
                raise OptionError(option, times, "a mapping from names of fruits to times [s]")
            for name, time_s in times.items():
                number(option, time_s, f"a time in seconds for {text(option, name)!r}")
        for phases in (self.phases, *self.arms.values()):
            for phase in list_of("phases", phases, Phase, "phases with a name, a start and an end"):
                numbers("phases", [phase.start_s, phase.end_s], (2,))
        number("begin_s", self.begin_s, "a time in seconds")

    @classmethod
    def from_result(cls, result: Shown) -> Playback:
        """Return the motion of a plan, stop, tour or multi-arm result.

        Raises:
            OptionError: `result` has no motion.
        """
        return playable(result)[2]

    @property
    def every_phase(self) -> tuple[Phase, ...]:
        """Phases of all arms."""
        return (*self.phases, *itertools.chain(*self.arms.values()))

    @property
    def curve(self) -> ClearanceCurve | None:
        """Clearance over time, thinned for display; None if unknown."""
        curve = self.clearance_curve
        if curve is None and self.certificate is not None:
            curve = self.certificate.clearance_curve
        return None if curve is None else curve.report_curve

    def check(self, robot: Robot) -> None:
        """Check that the trajectory has the robot's joints.

        Raises:
            InputError: The joints of the trajectory are not the robot's.
        """
        if self.trajectory.joint_names != robot.joint_names:
            got, expected = ", ".join(self.trajectory.joint_names), ", ".join(robot.joint_names)
            raise InputError(
                f"the trajectory moves {got}; the joints of {robot.name!r} are {expected}",
                expected=list(robot.joint_names),
                got=list(self.trajectory.joint_names),
            )


def playable(result: Shown) -> tuple[Robot, Scene, Playback]:
    """Robot, scene and motion of a result.

    For several arms it is the composite robot of all their joints.

    Raises:
        OptionError: `result` has no motion: it is not a plan, stop, tour or multi-arm result.
    """
    given: Any = result
    shows = hasattr(result, "certificate") or hasattr(result, "between")
    if not (shows and isinstance(getattr(result, "trajectory", None), Trajectory)):
        raise OptionError("result", result, "a result with a motion, as from plan or plan_tour")
    # A plan computes its picking time (`PlanResult.picked_fruit`); tours have theirs as a field.
    picked = getattr(given, "picked_fruit", getattr(given, "picked", {}))
    dropped = getattr(given, "dropped", {})
    unpicked = {one.fruit: one.reason for one in getattr(given, "unreached", ()) if one.reason is not None}
    if not hasattr(result, "cell"):
        phases = getattr(given, "phases", ())
        motion = Playback(given.trajectory, picked, dropped, phases, given.certificate, unpicked=unpicked)
        return given.robot, given.scene, motion
    arms = getattr(given, "phases", {})
    tours = getattr(given, "tours", {})
    pickers = {fruit: name for name, own in tours.items() for tour in own for fruit in tour.order if fruit in picked}
    frames = {arm.name: arm.tool_frame for arm in given.cell.arms}
    # Merge the certificates of all arms into one, without clearance over time.
    least = min(given.parts, key=lambda part: part.min_clearance_m)
    violations = tuple(violation for part in given.parts for violation in part.violations)
    whole = replace(least, verified=all(part.verified for part in given.parts), violations=violations, subject=None)
    scene = given.cell.task(given.trajectory.position[-1], given.trajectory.position[0])
    motion = Playback(
        given.trajectory, picked, dropped, certificate=whole, arms=arms, frames=frames, pickers=pickers,
        unpicked=unpicked,
    )  # fmt: skip
    return given.cell.robot, scene, motion
