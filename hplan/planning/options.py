"""Options of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from hplan.base.options import NotNegative, Options, Positive
from hplan.errors import OptionError
from hplan.grid.sections import LinkModel
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M, LEAST_RISK

Method = Literal["two-level", "dense"]

#: What is asked of a motion.
Objective = Literal["duration", "length"]

#: Length of the straight approach to a fruit or a point, where none is asked for [m].
STANDOFF = 0.1

#: How much is spent on a faster motion.
EffortName = Literal["quick", "default", "best"]
EFFORT_NAMES: tuple[EffortName, ...] = ("quick", "default", "best")

_CaptureRange = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]


@dataclass(frozen=True)
class PlanOptions(Options):
    """Options of a plan, checked.

    Attributes:
        method: `two-level`, or `dense` for the baseline.
        step_deg: Largest spacing of the joint grid [deg].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        effort: `quick` for the motion near the first path, `default` for the quickest near several, `best` for that
            near more of them, optimised for longer. Each gives the same motion every time.
        link_model: Link model of the C-space; motions are always certified for capsules.
        rate_hz: Rows of the trajectory per second.
        speed: Fraction of the velocity limits to use, in (0, 1].
        tracking_error: Deviation from the trajectory to be covered by the certificate, each joint, at rest [rad; of
            joints that slide, m].
        tracking_delay_s: What comes to it for each rad/s of the joint's velocity [s].
        sigmas: How many standard deviations of its place an obstacle is grown by, where the scene gives one; or of each
            by name, none of those that are not named.
        risk: Largest probability that the motion touches anything, by the errors that the scene gives, in place of
            `sigmas`: the growths are found with the motion (`hplan.certificate.touch_risk`). None for `sigmas`.
        standoff: Length of the straight approach [m]; shorter where it cannot be had. None for `STANDOFF` to a fruit or
            a point, and for no approach to a pose.
        capture_m: How far the middle of a fruit may be off for the gripper to take it: across the approach, and along
            it [m]. Of all grasps those are left whose approach is best against the error of the fruit's place, within
            half a percent, and reports say how likely each fruit is caught (`hplan.planning.capture`). None asks for
            neither.
        certify: False exports what was not certified, and says so.
        bound: True also bounds the durations of all motions from below (`hplan.planning.lower_bound`), which takes
            seconds where the base does not turn and something is in the way. Tours have no bound.
        seed: Of the samples by which trees grow: another one may lead to other motions, each the same every time.
        deadline_s: How long planning may take, counted from the call; None for as long as it takes [s]. What is
            certified by then depends on the machine: with a deadline the same input need not give the same motion.
    """

    method: Method = "two-level"
    # Of a single joint that turns once, a finer grid has more nodes than any may have.
    step_deg: Annotated[float, Field(ge=1e-7)] = 1.0
    objective: Objective = "duration"
    effort: EffortName = "default"
    link_model: LinkModel = "capsule"
    rate_hz: Annotated[float, Field(ge=1.0, le=100_000.0)] = 250.0
    speed: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    tracking_error: NotNegative = 0.0
    tracking_delay_s: NotNegative = 0.0
    sigmas: NotNegative | Annotated[dict[str, NotNegative], Field(min_length=1)] = 3.0
    risk: Annotated[float, Field(ge=LEAST_RISK, le=1.0)] | None = None
    standoff: NotNegative | None = None
    capture_m: tuple[_CaptureRange, _CaptureRange] | None = None
    certify: bool = True
    bound: bool = False
    seed: Annotated[int, Field(ge=0, le=2**31)] = 0
    deadline_s: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.risk is not None and not self.certify:
            raise OptionError("risk", self.risk, "None where motions need not be certified")
        if self.deadline_s is not None and self.bound:
            raise OptionError("bound", self.bound, "False where there is a deadline: a bound may take seconds")

    def check_for(self, robot: Robot | None, *, takes_risk: bool = False) -> None:
        """Refuse the dense search for robots without a grid, and a risk where there is more than a single plan.

        Args:
            robot: The robot; None for several.
            takes_risk: Whether a risk may be asked for.

        Raises:
            OptionError: It is asked for.
        """
        if self.risk is not None and not takes_risk:
            raise OptionError("risk", self.risk, "None: a risk is of a single plan from rest to rest")
        if robot is None:
            return
        if self.method == "dense" and robot.planar is None:
            expected = f"'two-level' for {robot.name!r}, which is no planar arm: there is no grid to be searched"
            raise OptionError("method", self.method, expected)

    @property
    def standoff_m(self) -> float:
        """Length of the straight approach to a fruit or a point [m]."""
        return STANDOFF if self.standoff is None else self.standoff

    @property
    def tracking(self) -> TrackingModel:
        """The deviation that motions make room for: none where they need not be certified."""
        return self.certified_tracking if self.certify else TrackingModel()

    @property
    def certified_tracking(self) -> TrackingModel:
        """The deviation that certificates cover, whether motions need to be certified or not."""
        return TrackingModel(self.tracking_error, self.tracking_delay_s)
