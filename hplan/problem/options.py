"""How to plan: what a user may choose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hplan.base.arguments import number, one_of, truth
from hplan.cspace.sections import LinkModel, check_link_model
from hplan.robot.limits import check_rate, check_speed
from hplan.robot.tracking import TrackingModel
from hplan.smoothing.options import OBJECTIVES, Objective

Method = Literal["two-level", "dense"]
METHODS: tuple[Method, ...] = ("two-level", "dense")


@dataclass(frozen=True)
class PlanOptions:
    """How to plan.

    Attributes:
        method: `two-level`, or `dense` for the baseline.
        step_deg: Largest spacing of the joint grid [deg].
        objective: `duration` for the fastest motion, `length` for the shortest path.
        link_model: Link model of the C-space; motions are always certified for capsules.
        rate_hz: Rows of the trajectory per second.
        speed: Share of the velocity limits to use, in (0, 1].
        tracking_error: Deviation from the trajectory to be covered by the certificate, each joint, at rest [rad].
        tracking_delay_s: What comes to it for each rad/s of the joint's velocity [s].
        sigmas: How many standard deviations of its place an obstacle is grown by, where the scene gives one.
        standoff: Length of the straight approach to a fruit or a point [m]; shorter where it cannot be had.
        certify: False exports what was not certified, and says so.
    """

    method: Method = "two-level"
    step_deg: float = 1.0
    objective: Objective = "duration"
    link_model: LinkModel = "capsule"
    rate_hz: float = 250.0
    speed: float = 1.0
    tracking_error: float = 0.0
    tracking_delay_s: float = 0.0
    sigmas: float = 3.0
    standoff: float = 0.1
    certify: bool = True

    def __post_init__(self) -> None:
        """Check the values."""
        one_of("method", self.method, METHODS)
        one_of("objective", self.objective, OBJECTIVES)
        check_link_model(self.link_model)
        number("step_deg", self.step_deg, "a positive number of degrees", lambda step: step > 0.0)
        check_rate(self.rate_hz)
        check_speed(self.speed)
        TrackingModel(self.tracking_error, self.tracking_delay_s)
        for name in ("sigmas", "standoff"):
            number(name, getattr(self, name), "a finite number >= 0", lambda value: value >= 0.0)
        truth("certify", self.certify)

    @property
    def tracking(self) -> TrackingModel:
        """The deviation that motions make room for: none where they need not be certified."""
        return TrackingModel(self.tracking_error, self.tracking_delay_s) if self.certify else TrackingModel()
