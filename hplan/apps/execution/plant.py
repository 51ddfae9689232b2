"""Model of the simulated machine, and how it differs from what its controller believes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hplan.errors import OptionError


@dataclass(frozen=True)
class Plant:
    """Parameters of the simulated machine that its controller does not know, and the stiffness of the controller.

    Attributes:
        mass_factor: Masses and inertias of its bodies, as multiples of the URDF's.
        command_delay_s: By how much the controller is late: it follows the reference of so long ago [s].
        bandwidth: Natural frequency of its position loop [rad/s].
        decoupled: Whether errors are fed back as accelerations, through the inertia matrix, and not joint by joint; a
            stiff loop of joints that push one another does not come to rest.
    """

    mass_factor: float = 1.0
    command_delay_s: float = 0.0
    bandwidth: float = 40.0
    decoupled: bool = False

    def __post_init__(self) -> None:
        for option, least in (("mass_factor", 0.0), ("command_delay_s", None), ("bandwidth", 0.0)):
            value = getattr(self, option)
            if not (np.isfinite(value) and (value >= 0.0 if least is None else value > least)):
                raise OptionError(option, value, f"a finite number {'>= 0' if least is None else '> 0'}")
