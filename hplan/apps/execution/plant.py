"""Model of the simulated machine and its deviation from the controller's model."""

from __future__ import annotations

from dataclasses import dataclass

from hplan.base.options import NotNegative, Options, Positive


@dataclass(frozen=True)
class Plant(Options):
    """Model errors unknown to the controller, and the controller's gains.

    Attributes:
        mass_factor: Ratio of the true masses and inertias to the URDF's.
        command_delay_s: Delay of the controller, which tracks the reference of this time before [s].
        bandwidth: Natural frequency of the position loop [rad/s].
        decoupled: Feed back errors as accelerations through the inertia matrix (computed torque), instead of joint by
            joint. Stiff independent loops of strongly coupled joints may not come to rest.
    """

    mass_factor: Positive = 1.0
    command_delay_s: NotNegative = 0.0
    bandwidth: Positive = 40.0
    decoupled: bool = False
