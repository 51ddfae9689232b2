"""Model of the simulated machine, and how it differs from what its controller believes."""

from __future__ import annotations

from dataclasses import dataclass

from hplan.base.options import NotNegative, Options, Positive


@dataclass(frozen=True)
class Plant(Options):
    """Parameters of the simulated machine that its controller does not know, and the stiffness of the controller.

    Attributes:
        mass_factor: Masses and inertias of its bodies, as multiples of the URDF's.
        command_delay_s: By how much the controller is late: it follows the reference of so long ago [s].
        bandwidth: Natural frequency of its position loop [rad/s].
        decoupled: Whether errors are fed back as accelerations, through the inertia matrix, and not joint by joint; a
            stiff loop of joints that push one another does not come to rest.
    """

    mass_factor: Positive = 1.0
    command_delay_s: NotNegative = 0.0
    bandwidth: Positive = 40.0
    decoupled: bool = False
