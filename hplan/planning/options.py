"""Options of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

from hplan.base.arguments import between, by_name, keep_checked, list_between, number, one_of, truth, whole
from hplan.errors import OptionError
from hplan.grid.sections import LINK_MODELS, LinkModel
from hplan.robot.limits import check_rate, check_speed
from hplan.robot.model import Robot
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M, LEAST_RISK
from hplan.scene.obstacle_kind import Sigmas

Method = Literal["two-level", "dense"]

#: What is asked of a motion.
Objective = Literal["duration", "length"]

#: Length of the straight approach to a fruit or a point, where none is asked for [m].
STANDOFF = 0.1

#: Finest joint grid that can be asked for [deg]: of a single joint that turns once, more nodes than any grid may have.
_FINEST_DEG: Final = 1e-7

#: How much is spent on a faster motion.
EffortName = Literal["quick", "default", "best"]
EFFORT_NAMES: tuple[EffortName, ...] = ("quick", "default", "best")


@dataclass(frozen=True)
class PlanOptions:
    """Options of a plan, checked.

    Attributes:
        method: `two-level`, or `dense` for the baseline.
        step_deg: Largest spacing of the joint grid [deg].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        effort: `quick` for the first certified motion, `default` for one optimised together with its timing, `best` for
            the quickest along more paths, optimised for longer. Each gives the same motion every time.
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
    step_deg: float = 1.0
    objective: Objective = "duration"
    effort: EffortName = "default"
    link_model: LinkModel = "capsule"
    rate_hz: float = 250.0
    speed: float = 1.0
    tracking_error: float = 0.0
    tracking_delay_s: float = 0.0
    sigmas: Sigmas = 3.0
    risk: float | None = None
    standoff: float | None = None
    capture_m: tuple[float, float] | None = None
    certify: bool = True
    bound: bool = False
    seed: int = 0
    deadline_s: float | None = None

    def __post_init__(self) -> None:
        keep_checked(self, _CHECKS)
        if self.risk is not None:
            keep_checked(self, {"risk": (between, LEAST_RISK, 1.0)})
            if not self.certify:
                raise OptionError("risk", self.risk, "None where motions need not be certified")
        if self.standoff is not None:
            keep_checked(self, {"standoff": (number, "a finite number >= 0", lambda value: value >= 0.0)})
        if self.capture_m is not None:
            keep_checked(self, {"capture_m": (list_between, 0.0, FARTHEST_M)})
            if len(self.capture_m) != 2:
                raise OptionError("capture_m", self.capture_m, "two lengths, across the approach and along it")
        if self.deadline_s is not None:
            keep_checked(self, {"deadline_s": (number, "a positive number of seconds", lambda value: value > 0.0)})
            if self.bound:
                raise OptionError("bound", self.bound, "False where there is a deadline: a bound may take seconds")
        check_rate(self.rate_hz)
        check_speed(self.speed)
        TrackingModel(self.tracking_error, self.tracking_delay_s)

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


_CHECKS = {
    "method": (one_of, get_args(Method)),
    "objective": (one_of, get_args(Objective)),
    "effort": (one_of, EFFORT_NAMES),
    "link_model": (one_of, LINK_MODELS),
    "step_deg": (number, f"a number of degrees >= {_FINEST_DEG:g}", lambda step: step >= _FINEST_DEG),
    "sigmas": (by_name, "a finite number >= 0", lambda value: value >= 0.0),
    "seed": (whole, 0, 2**31),
    **dict.fromkeys(("certify", "bound"), (truth,)),
}
