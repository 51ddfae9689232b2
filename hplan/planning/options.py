"""Options of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field

from hplan.base.checked import NotNegative, Options, Positive
from hplan.errors import OptionError
from hplan.robot.tracking import TrackingModel
from hplan.scene.limits import FARTHEST_M, LEAST_RISK

Method = Literal["two-level", "dense"]

#: Link models of grids: the capsule, the paper's three cases verbatim, or the exact rectangle.
LinkModel = Literal["capsule", "paper", "rectangle"]

#: Cost to minimize.
Objective = Literal["duration", "length"]

#: Default length of the straight approach to a fruit or a point [m].
STANDOFF = 0.1

#: Presets of the search and optimization budget.
EffortName = Literal["quick", "default", "best"]
EFFORT_NAMES: tuple[EffortName, ...] = ("quick", "default", "best")

_CaptureRange = Annotated[float, Field(ge=0.0, le=FARTHEST_M)]


@dataclass(frozen=True)
class PlanOptions(Options):
    """Options of a plan, validated.

    Attributes:
        method: `two-level`, or `dense` for the baseline.
        step_deg: Maximum spacing of the joint grid [deg].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        effort: `quick` for the motion near the first path, `default` for the fastest near several paths, `best` for the
            fastest near more paths, optimized for longer. Each is deterministic.
        link_model: Link model of the C-space; motions are always certified for capsules.
        rate_hz: Samples of the trajectory per second.
        speed: Fraction of the velocity limits to use, in (0, 1].
        tracking_error: Tracking error of each joint at rest that the certificate covers [rad; m for prismatic joints].
        tracking_delay_s: Additional tracking error per unit of the joint's velocity [s].
        sigmas: Growth of uncertain obstacles, in standard deviations of their positions; or this number
            for each obstacle by name, 0 for the others.
        risk: Maximum probability of contact due to the position errors of the scene, instead of `sigmas`: the growths
            are found together with the motion (`hplan.certificate.touch_risk`). None to use `sigmas`.
        standoff: Length of the straight approach [m]; shorter if it is obstructed. None for `STANDOFF` to a fruit or a
            point, and for no approach to a pose.
        capture_m: Maximum offset of a fruit's center from where the gripper expects it: across the approach, and along
            it [m]. Only the grasps with the best approach for the position error are kept, within half a percent, and
            reports give the probability to catch each fruit (`hplan.planning.grasps`). None for neither.
        gentle: True for the motion that pushes limbs with the least force, of those that take at most 5 % longer than
            the fastest (`hplan.planning.less_force`).
        certify: False to export motions that are not certified; the report says so.
        bound: True to compute a lower bound of the duration of all motions, too (`hplan.planning.lower_bound`). It
            takes seconds if the base does not turn and obstacles block the way. Tours have no bound.
        seed: Random seed of the sampling-based planner; each seed is deterministic, but may lead to another motion.
        at_once: True for the first certified motion, however slow. `Planner.replan` makes it faster while it runs.
        deadline_s: Maximum planning time, from the call; None for no limit [s]. The number of motions certified by then
            depends on the machine, so plans with a deadline are not reproducible.

    Examples:
        >>> from hplan import PlanOptions
        >>> PlanOptions().rate_hz
        250.0
        >>> PlanOptions(speed=2.0)
        Traceback (most recent call last):
        ...
        hplan.errors.bad_input.OptionError: speed = 2.0: expected less than or equal to 1
    """

    method: Method = "two-level"
    # For a single joint with one turn, a finer grid exceeds the maximum number of nodes.
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
    gentle: bool = False
    certify: bool = True
    bound: bool = False
    seed: Annotated[int, Field(ge=0, le=2**31)] = 0
    at_once: bool = False
    deadline_s: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.risk is not None and not self.certify:
            raise OptionError("risk", self.risk, "None if motions need not be certified")
        if self.deadline_s is not None and self.bound:
            raise OptionError("bound", self.bound, "False with a deadline: a bound may take seconds")

    def refuse_risk(self) -> None:
        """Refuse a risk for tasks other than single plans at rest.

        Raises:
            OptionError: The options have a risk.
        """
        if self.risk is not None:
            raise OptionError("risk", self.risk, "None: only single plans from rest to rest have a risk bound")

    @property
    def standoff_m(self) -> float:
        """Length of the straight approach to a fruit or a point [m]."""
        return STANDOFF if self.standoff is None else self.standoff

    @property
    def tracking(self) -> TrackingModel:
        """Tracking error that motions allow for; none if they need no certificate."""
        return self.certified_tracking if self.certify else TrackingModel()

    @cached_property
    def certified_tracking(self) -> TrackingModel:
        """Tracking error that certificates cover, even if motions need no certificate."""
        return TrackingModel(self.tracking_error, self.tracking_delay_s)
